"""The command line as a person meets it: exit codes, what goes where, and what is left behind."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from conftest import EXACT, axis
from matplotlib.text import Text

from clunk.api import draw
from clunk.cli import cli, tables
from clunk.core.status import QUALITY_COMPLETE
from clunk.results.store import read_results
from clunk.study.config import load_study
from clunk.study.records import table

ROOT = Path(__file__).parent.parent
SMALL = f'title = "Small"\n{EXACT}[sweep]\nboundaries = false\n'
SMALL += axis("load.ratio", 0.0, 10.0, 6) + axis("lash.backlash_deg", 0.0, 20.0, 5)
LOOSE = """
driveline = {inertias = [1.0, 1.0, 2.0], shafts = [{between = [1, "ground"], stiffness = 0.0, damping = 0.1}]}
lash = {between = [1, 2], backlash_deg = 1.0, radius = 1.0, contact = {stiffness = 1e4, damping = 1.0}}
load = {on = 2, static_torque = -1.0, ratio = 5.0}
"""
AXES = SMALL[SMALL.index("[sweep]") :]


@pytest.fixture
def small(here):
    path = here / "small.toml"
    path.write_text(SMALL)
    return path


def test_sweep_plot_and_info_work_on_a_small_grid(command, small, here):
    code, out, err = command("sweep", small)
    assert code == 0
    assert "DS(1)SS(1)" in out
    assert "30 cells" in err
    assert "results/small.h5" in err
    code, out, _ = command("info", "results/small.h5")
    assert code == 0
    assert "load.ratio: 0 to 10, 6 values" in out
    assert re.search(r"^load .*ideal torque step.*, Ts = -1 N m$", out, flags=re.MULTILINE)
    code, out, _ = command("plot", "results/small.h5")
    assert code == 0
    assert out.split() == ["results/small-regimes.png", "results/small-severity.png"]
    assert all((here / name).stat().st_size > 10_000 for name in out.split())


def test_the_files_of_a_front_are_not_what_it_reads(command, here):
    """Nor any other file that none may be written in place of; told before the search."""
    text = (ROOT / "configs/shaped_release.toml").read_text("utf-8")
    (here / "best-1.toml").write_text(text, "utf-8")
    code, _, err = command("optimize", "best-1.toml", "--front", "severity", "-o", "best.toml")
    assert (code, (here / "best-1.toml").read_text("utf-8")) == (2, text)
    assert "best-1.toml is what the command reads" in err
    (here / "other-9.toml").mkdir()
    code, _, err = command("optimize", "best-1.toml", "--front", "severity", "-o", "other.toml")
    assert code == 2
    assert "other-9.toml is a directory" in err


@pytest.mark.parametrize("name", ["plot", "report"])
def test_a_folder_is_no_results_file(command, name):
    assert command(name, ".")[::2] == (2, ". cannot be read: is a directory.\n")


def test_a_results_file_stands_for_its_config(command, small):
    command("sweep", small, "-o", "small.h5")
    words = "--along", "load.ratio", "--at", "lash.backlash_deg=8"
    code, out, _ = command("thresholds", "small.h5", *words)
    assert code == 0
    assert out == command("thresholds", small, *words)[1]
    code, _, err = command("sweep", "small.h5", "-o", "small.h5")
    assert code == 2
    assert "is what the command reads" in err


@pytest.mark.parametrize("words", [("simulate",), ("thresholds", "--along", "lash.backlash_deg")])
def test_the_trace_of_the_load_is_what_a_command_reads(command, here, words):
    trace = "time,torque\n0,-1\n0.1,0.5\n0.2,1\n"
    (here / "trace.csv").write_text(trace)
    load = '[load]\nprofile = "table"\nfile = "trace.csv"\n'
    (here / "rig.toml").write_text(EXACT + load + axis("lash.backlash_deg", 0.0, 20.0, 5))
    code, _, err = command(words[0], "rig.toml", *words[1:], "-o", f"../{here.name}/trace.csv")
    assert (code, (here / "trace.csv").read_text()) == (2, trace)
    assert "trace.csv is what the command reads" in err


@pytest.mark.parametrize(
    "words", [("sweep", "small.toml", "-o"), ("info",), ("plot",), ("init",), ("simulate", "small.toml", "-o")]
)
def test_a_name_that_no_file_can_have_is_answered_by_a_sentence(command, small, words):
    name = "a" * 260 + (".toml" if words == ("init",) else ".csv" if words[0] == "simulate" else ".h5")
    code, _, err = command(*words, name)
    assert code == 2
    assert f"{name} cannot be used: File name too long." in "".join(err.splitlines())


def test_runs_that_are_cut_off_are_announced(command, small):
    """A hundredth of a second after the load step nothing has happened; without a change of load nothing will."""
    for times in range(2):
        code, out, err = command("sweep", small, "--set", "solver.end_time=0.01")
        assert code == 0
        assert "NI" in out
        assert "25 of 30 runs ended at solver.end_time with more to follow" in err, times
    assert "25 of 30 runs ended at solver.end_time with more to follow" in command("info", "results/small.h5")[1]
    results = read_results("results/small.h5")
    assert np.array_equal((results.quality & QUALITY_COMPLETE == 0).any(axis=1), results.axes[0].values > 0.0)
    texts = [" ".join(text.get_text().split()) for text in draw(results).findobj(Text)]
    assert any(results.caveats[0] in text for text in texts)
    assert "end_time" not in command("sweep", small, "--force")[2]


def test_a_finished_sweep_is_not_run_again(command, small, here):
    command("sweep", small)
    before = (here / "results/small.h5").read_bytes()
    code, _, err = command("sweep", small)
    assert code == 0
    assert "already complete" in err
    assert (here / "results/small.h5").read_bytes() == before
    code, _, err = command("sweep", small, "--restart")
    assert code == 0
    assert "already complete" not in err


def test_results_of_another_config_are_not_overwritten_without_force(command, small, here):
    command("sweep", small)
    before = (here / "results/small.h5").read_bytes()
    code, _, err = command("sweep", small, "--set", "load.static_torque=-2.0")
    assert code == 2
    assert "--force" in err
    assert "load.static_torque = -1.0 there, -2.0 here)" in " ".join(err.split())
    assert (here / "results/small.h5").read_bytes() == before
    code, _, _ = command("sweep", small, "--set", "load.static_torque=-2.0", "--force")
    assert code == 0
    assert (here / "results/small.h5").read_bytes() != before


def test_restart_takes_no_part_of_a_stopped_sweep(command, small, here):
    directory = here / "results/small.h5.partial"
    directory.mkdir(parents=True)
    other = {"config_digest": "ab", "versions": {}, "config": "load.ratio = 7.0"}
    (directory / "manifest.json").write_text(json.dumps(other))
    (directory / "part-000001").write_bytes(b"of another sweep")
    code, _, err = command("sweep", small)
    assert code == 2
    assert "another config" in " ".join(err.split())
    assert "--restart" in err
    assert command("sweep", small, "--restart")[0] == 0
    assert [path.name for path in (here / "results").iterdir()] == ["small.h5"]


def test_restart_of_a_sweep_that_is_refused_takes_nothing_away(command, small, here):
    command("sweep", small, "-o", "map.h5")
    (here / "map.h5.partial").mkdir()
    (here / "map.h5.partial/part-000001").write_bytes(b"work")
    code, _, err = command("sweep", small, "-o", "map.h5", "--set", "load.static_torque=-2.0", "--restart")
    assert code == 2
    assert "--force" in err
    assert (here / "map.h5.partial/part-000001").read_bytes() == b"work"


def test_info_checks_a_file_and_names_a_damaged_one(command, small, here):
    command("sweep", small)
    path = here / "results/small.h5"
    code, out, _ = command("info", path, "--check")
    assert code == 0
    assert "the bytes match their checksum" in out
    assert json.loads(command("info", path, "--check", "--json")[1])["checked"] == {"data": True, "bytes": True}
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    for arguments in (["info", path], ["info", path, "--check"], ["plot", path], ["sweep", small]):
        code, _, err = command(*arguments)
        assert code == 2
        assert "do not match their checksum" in " ".join(err.split())


def test_failed_cells_exit_3_and_name_their_cause_also_where_the_sweep_was_finished_before(command, small):
    moved = ["--set", "sweep.axes[1].start=-1.0", "--set", "sweep.axes[1].stop=9.0", "--json"]
    (first, out, err), (second, again, _) = command("sweep", small, *moved), command("sweep", small, *moved)
    assert first == second == 3
    assert json.loads(out)["counts"] == json.loads(again)["counts"]
    assert "5 cells failed: no initial flank" in err
    assert "load.ratio = -1" in err


def test_simulate_prints_events_letters_and_label(command):
    code, out, _ = command("simulate", ROOT / "configs/nominal.toml")
    assert code == 0
    assert "primary impacts      O I I" in out
    assert "q': rate of the gap just before the event" in " ".join(out.split())
    assert "label                DS(1)SS(1)" in out
    assert max(map(len, out.splitlines())) <= 80


def test_simulate_runs_a_cell_of_a_results_file(command, small):
    command("sweep", small)
    code, out, _ = command(
        "simulate", "results/small.h5", "--at", "load.ratio=4", "--at", "lash.backlash_deg=5", "--json"
    )
    assert code == 0
    assert json.loads(out)["label"] == "DS(1)SS(1)"
    code, _, err = command("simulate", "results/small.h5", "--at", "load.ratio=4")
    assert code == 2
    assert "by --at KEY=VALUE: lash.backlash_deg: 0 to 20 degrees" in err


def test_simulate_of_a_sweep_takes_the_config_s_own_values_where_none_are_named(command, small):
    code, out, err = command("simulate", small)
    assert code == 0
    assert "load.ratio = 5, lash.backlash_deg = 6" in err
    assert "DS(1)SS(1)" in out
    code, out, _ = command("simulate", small, "--at", "load.ratio=2")
    assert code == 0
    assert "SS(1)" in out


def test_of_many_labels_those_of_most_cells_are_printed(command, small, monkeypatch):
    _, whole, _ = command("sweep", small)
    assert "more" not in whole
    assert "labels of" not in whole
    monkeypatch.setattr(tables, "_MOST_LABELS", 2)
    _, out, _ = command("info", "results/small.h5")
    counts = json.loads(command("info", "results/small.h5", "--json")[1])["counts"]
    ordered = sorted((count for count in counts.values() if count), reverse=True)
    rows = re.findall(r"^  (\S+) +(\d+) .*%$", out, flags=re.MULTILINE)
    assert [int(cells) for _, cells in rows] == [count for count in counts.values() if count >= ordered[1]]
    assert f"and {len(ordered) - 2} labels of no more cells each" in out


def test_a_label_too_long_for_a_row_comes_last_in_it_and_breaks_between_groups():
    long = "OS(1)DS(12)SS(3)" * 4
    told = table([{"label": "NI", "cells": "12"}, {"label": long, "cells": "3"}], width=40)
    head, *lines = "\n".join(told).splitlines()
    assert head.split() == ["cells", "label"]
    assert max(map(len, lines)) <= 40
    assert lines[0].split() == ["12", "NI"]
    assert all(line.endswith(")") for line in lines[1:])
    assert "".join(lines[1:]).replace(" ", "") == f"3{long}"


def test_simulate_draws_and_saves_runs_and_overlays(command, here):
    config = ROOT / "configs/nominal.toml"
    for figure in ("everything", "angles", "backlash", "closeup", "acceleration", "small-gap"):
        overlay = ["--overlay", "load.ratio=2,5"] if figure == "angles" else []
        code, _, err = command("simulate", config, *overlay, "--figure", figure, "-o", "run.png")
        assert code == 0
        assert "-> run.png" in err
    assert (here / "run.png").stat().st_size > 10_000
    assert command("simulate", config, "-o", "RUN.CSV")[0] == 0
    header, first = (here / "RUN.CSV").read_text().splitlines()[:2]
    assert header.startswith("time_s,")
    assert first.startswith("0.0,-0.1,")
    code, out, _ = command("simulate", config, "--overlay", "lash.contact.model=indentation,restitution", "--json")
    assert code == 0
    assert [run["severity"] is None for run in json.loads(out)] == [False, True]


def test_a_swept_key_is_overlaid_with_values_of_its_own(command, small, here):
    overlay = ("--overlay", "load.ratio=2,5.5")
    code, out, err = command("simulate", small, *overlay, "--at", "lash.backlash_deg=5", "--json")
    assert (code, err) == (0, "")
    runs = json.loads(out)
    assert [run["run"] for run in runs] == ["load.ratio=2", "load.ratio=5.5"]
    (here / "one.toml").write_text(EXACT)
    one = ("simulate", "one.toml", "--set", "lash.backlash_deg=5")
    alone = [json.loads(command(*one, "--set", run["run"], "--json")[1]) for run in runs]
    assert [run["severity"] for run in runs] == [run["severity"] for run in alone]
    code, _, err = command("simulate", small, "--overlay", "load.ratoi=2,5")
    assert code == 2
    assert "--overlay load.ratoi: unknown key" in err
    err = command("simulate", small, "--overlay", "load.profile=step,ramp")[2]
    assert "\n  load.duration: missing" in err  # without the line of a text that nobody sees


def test_a_cell_is_named_by_the_names_of_inertias(command, here):
    axes = '[[sweep.axes]]\nparameter = "load.on"\nvalues = ["motor", "flange"]\n' + axis("load.ratio", 1.0, 5.0, 2)
    (here / "loaded.toml").write_text(EXACT + axes)
    runs = [command("simulate", "loaded.toml", "--at", f"load.on={on}", "--at", "load.ratio=5") for on in ("flange", 2)]
    assert runs[0] == runs[1]
    assert runs[0][::2] == (0, "")
    assert command("simulate", "loaded.toml", "--at", "load.on=1", "--at", "load.ratio=ring")[0] == 2


def test_compare_tells_equal_from_different(command, small, here):
    command("sweep", small)
    command("sweep", small, "--set", "lash.contact.model=restitution", "-o", "rcm.h5")
    assert command("compare", "results/small.h5", "results/small.h5", "--expect-equal")[0] == 0
    command("sweep", small, "--set", "lash.contact.stiffness=1e4", "-o", "soft.h5")
    code, out, _ = command("compare", "results/small.h5", "soft.h5", "--expect-equal", "-o", "difference.png")
    assert code == 4
    assert "lash.contact.stiffness" in out
    assert (here / "difference.png").stat().st_size > 10_000
    code, out, _ = command("compare", "results/small.h5", "table_4_1", "--json")
    assert code == 0
    assert json.loads(out)


def test_a_terminal_without_greek_letters_gets_question_marks():
    command = [sys.executable, "-m", "clunk", "modes", str(ROOT / "configs/nominal.toml")]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert done.returncode == 0
    assert b"258.3" in done.stdout


def test_messages_keep_within_80_columns(command, small):
    three = [
        "--set",
        'sweep.axes=[{parameter="load.ratio",values=[2.0,5.0]},'
        '{parameter="lash.backlash_deg",values=[2.0,5.0]},{parameter="lash.radius",values=[0.07,0.08]}]',
    ]
    command("sweep", small, *three)
    for words in (["plot", "results/small.h5"], ["sweep", small], ["simulate", small, "--at", "load.torque=1"]):
        code, _, err = command(*words)
        assert code == 2
        assert max(map(len, err.splitlines())) <= 80


def test_modes_prints_the_report_s_numbers_and_names_what_each_mode_moves(command):
    code, out, _ = command("modes", ROOT / "configs/nominal.toml")
    assert code == 0
    for number in ("3.2", "16.2", "30.8", "258.3", "1.46", "3.13", "6.69", "14.32"):
        assert f" {number}" in out
    assert re.search("shuffle +mode 1", out)
    assert "pinion 39 %, ring 39 %" in out
    record = json.loads(command("modes", ROOT / "configs/nominal.toml", "--json")[1])
    assert record["shuffle"] == 1
    assert record["inertias"] == ["motor", "flange", "pinion", "ring"]
    assert [sum(shares) for shares in record["closed"]["kinetic_energy_share"]] == pytest.approx([1.0] * 4)


def test_modes_of_rigid_flanks_and_of_what_does_not_swing_are_told_in_words(command, here):
    (here / "study.toml").write_text(
        '[driveline]\ninertias = [1.0, 2.0]\nshafts = [{ between = [2, "ground"], damping = 1.0 }]\n'
        "[lash]\nbetween = [1, 2]\nbacklash_deg = 1.0\nradius = 0.1\n"
        'contact = { model = "restitution", restitution = 0.5 }\n'
        "[load]\non = 1\ninitial_torque = 5.0\nfinal_torque = -1.0\n[solver]\nend_time = 1.0\n"
    )
    code, out, _ = command("modes", "study.toml")
    assert code == 0
    assert out.count("  nothing oscillates") == 2
    assert re.search("T_c +none: rigid flanks stick where they lock", out)
    assert "\n\n\n" not in out


@pytest.mark.parametrize("name", ["modes", "simulate"])
def test_tables_of_a_long_driveline_fit_a_terminal(command, name):
    _, out, err = command(name, ROOT / "configs/car_tip_out.toml")
    assert max(map(len, (out + err).splitlines())) <= 80


def test_a_step_that_is_too_coarse_for_the_contact_is_warned_of(command):
    # 258 Hz damped by 0.196 swing at 253 Hz: 3.9 steps of 1 ms a period, 39.5 of 0.1 ms
    _, _, err = command("simulate", ROOT / "configs/nominal.toml", "--set", "solver.step=1e-3")
    assert "3.9 steps a period" in " ".join(err.split())
    assert max(map(len, err.splitlines())) <= 80
    _, _, err = command("simulate", ROOT / "configs/nominal.toml")
    assert "warning" not in err


@pytest.mark.parametrize("words", [["sweep"], ["optimize"], ["thresholds", "--along", "lash.contact.restitution"]])
def test_keys_that_change_nothing_are_told(command, here, words):
    free = '[[optimize.parameters]]\nparameter = "load.step_time"\nlow = 0.1\nhigh = 0.2\n'
    searched = f'[optimize]\nminimize = "severity"\n{free}'
    (here / "rig.toml").write_text(EXACT + searched + axis("lash.contact.restitution", 0.1, 0.9, 2))
    code, _, err = command(words[0], "rig.toml", *words[1:])
    assert code == 0
    for key in ("lash.contact.restitution", "load.step_time"):
        assert f"note: {key} changes nothing in this model\n" in err


def test_shafts_that_replace_those_of_a_preset_are_warned_of(command, here):
    (here / "car.toml").write_text(
        '[driveline]\npreset = "car"\n[[driveline.shafts]]\nbetween = [4, 5]\nstiffness = 1e4\ndamping = 9.0\n'
    )
    _, out, err = command("modes", "car.toml")
    assert err.startswith("warning: the file's [[driveline.shafts]] replace all 6 shafts of preset")
    assert "no shaft and no lash joins body to the lash or to ground" in " ".join(err.split())
    assert "warning" not in out


def test_modes_warns_where_there_is_no_steady_motion_whose_stages_it_could_tell(command, here):
    assert command("init", "car.toml", "--from", "car")[0] == 0
    clutch = "driveline.shafts[1].{}".format
    staged = "--set", clutch("stiffness=[900.0, 0.0]"), "--set", clutch("breakpoints_deg=[2.0]")
    code, _, err = command("modes", "car.toml", *staged)
    assert code == 0
    assert "a staged shaft carries a torque at which a stage of it has no stiffness" in " ".join(err.split())
    assert "steady motion" not in command("modes", "car.toml")[2]


@pytest.mark.parametrize("origin", [(), ("--from", "car")], ids=["rig", "car"])
def test_init_writes_a_config_that_runs_and_spares_what_is_there(command, here, origin):
    assert command("init", "study.toml", *origin)[0] == 0
    text = (here / "study.toml").read_text()
    code, _, err = command("init", "study.toml")
    assert code == 2
    assert "--force" in err
    assert (here / "study.toml").read_text() == text
    assert command("modes", "study.toml")[0] == 0
    assert "study.toml" in text or origin
    assert load_study("study.toml").title != "Untitled"


def test_a_starter_taken_for_a_file_name_is_answered_with_the_command(command, here):
    code, _, err = command("init", "car")
    assert code == 2
    assert "clunk init car.toml --from car" in err
    assert command("init", "--from", "car")[0] == 0
    assert [path.name for path in here.iterdir()] == ["car.toml"]


# (config, what the message must name); all that a config can have wrong is in test_config
BROKEN = [
    (SMALL.replace("preset", "prest"), "preset"),
    (SMALL.replace("count = 6", "count = 40000").replace("count = 5", "count = 40000"), "memory"),
    (SMALL[: SMALL.index("[sweep]")], "sweep.axes"),
    ("title = \n", "TOML"),
    ("", "driveline"),
    (LOOSE + AXES, "inertia 3"),
]


@pytest.mark.parametrize(("text", "named"), BROKEN, ids=range(len(BROKEN)))
def test_a_broken_config_gives_one_clear_message_and_leaves_files_alone(command, here, text, named):
    (here / "broken.toml").write_text(text)
    (here / "results").mkdir()
    (here / "results/broken.h5").write_bytes(b"precious")
    code, out, err = command("sweep", "broken.toml", "--force")
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert out == ""
    assert (here / "results/broken.h5").read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["sweep", "nowhere.toml"], "nowhere.toml"),
        (["sweep", "small.toml", "-o", "folder"], "directory"),
        (["sweep", "small.toml", "-o", "notes.txt"], "notes.txt"),
        (["sweep", "small.toml", "-o", "notes.txt/map.h5"], "notes.txt"),
        (["sweep", "small.toml", "--set", "load.ratio=7"], "load.ratio"),
        (["sweep", "small.toml", "--workers", "0"], "--workers"),
        (["info", "notes.txt"], "notes.txt"),
        (["sweep", "small.toml", "-o", "small.toml", "--force"], ".h5"),
        (["sweep", "small.toml", "-o", "map.png"], ".h5"),
        (["simulate", "small.toml", "-o", "run.docx"], ".csv"),
        (["simulate", "small.toml", "-o", "results/small.h5"], "results/small.h5"),
        (["simulate", "small.toml", "--figure", "closeup"], "-o"),
        (["simulate", "small.toml", "--overlay", "load.ratio", "-o", "run.png"], "--overlay"),
        (["simulate", "small.toml", "--overlay", "lash.radius=1,2", "-o", "run.csv"], "one run"),
        (["simulate", "small.toml", "--overlay", "lash.radius=1,2", "--figure", "small-gap", "-o", "a.png"], "one run"),
        (["simulate", "small.toml", "--at", "load.ratio=11"], "0 to 10"),
        (["compare", "notes.txt", "table_4_1", "-o", "map.csv"], ".png"),
        (["reproduce", "-o", "notes.txt"], "notes.txt"),
        (["simulate", "small.toml", "--at", "load.ratio=x", "--at", "lash.backlash_deg=6"], "load.ratio"),
        (["simulate", "small.toml", "--at", "load.ratio"], "must be KEY=VALUE"),
        (["init", "folder"], "folder"),
        (["swep", "small.toml"], "did you mean sweep?"),
        (["sweep", "smal.toml"], "did you mean small.toml?"),
        (["sweep", "one.toml"], "clunk simulate runs it once"),
        (["plot", "small.toml"], "clunk sweep small.toml makes one"),
        (["plot", "smal.h5"], "did you mean results/small.h5?"),
        (["simulate", "small.toml", "--at", "load.rato=1"], "must be KEY=VALUE of what is swept: load.ratio: 0 to"),
        (["simulate", "small.toml", "--at", "load.ratio=2", "--at", "load.ratio=4"], "values; each once."),
        (["thresholds", "small.toml"], "Missing option '--along'"),
        (["help", "configs"], "did you mean config?"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_usage_gives_one_clear_message(command, here, small, arguments, named):
    (here / "folder").mkdir()
    (here / "notes.txt").write_text("not a results file")
    (here / "one.toml").write_text('driveline.preset = "boere-2008"')
    (here / "results").mkdir()
    (here / "results/small.h5").touch()
    code, _, err = command(*arguments)
    assert code == 2
    assert named in " ".join(err.split())
    assert "Traceback" not in err
    assert (here / "notes.txt").read_text() == "not a results file"


def test_an_unknown_quantity_or_picture_format_is_refused_by_name(command, small):
    command("sweep", small)
    code, _, err = command("plot", "results/small.h5", "--quantity", "severty")
    assert code == 2
    assert "severty" in err
    code, _, err = command("plot", "results/small.h5", "-o", "map.docx")
    assert code == 2
    assert "png" in err


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX")
@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, 130, "interrupted"),
        (signal.SIGTERM, 143, "terminated"),
        (getattr(signal, "SIGHUP", signal.SIGTERM), 143, "terminated"),  # the terminal is closed
    ],
)
def test_a_signal_stops_a_sweep_and_keeps_what_is_done(tmp_path, number, code, word):
    command = [
        sys.executable,
        "-c",
        "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also where the tests run by nohup\n"
        "from clunk.sweeping import progress; progress._LINE_EVERY = 0.2\nfrom clunk.cli import main; main()",
        "sweep",
        str(ROOT / "configs/figure_3_4.toml"),
    ]
    command += ["--set", "sweep.axes[1].count=2001", "--set", "sweep.axes[2].count=2001", "-o", "map.h5"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    line = process.stderr.readline()  # "compiling …", or the first progress line: the sweep runs
    while "cells" not in line:
        line = process.stderr.readline()
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert word in err
    assert "Traceback" not in err
    assert "the same command goes on" in " ".join(err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["map.h5.partial"]
    assert {path.name for path in (tmp_path / "map.h5.partial").iterdir()} >= {"manifest.json", "part-000001"}


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX")
def test_a_signal_in_the_midst_of_a_line_of_progress_ends_a_sweep_too(tmp_path):
    """A stream that is being written to takes nothing from a handler."""
    script = """
import io, os, signal, sys
class Stream(io.FileIO):
    killed = False
    def write(self, content):
        if b"cells" in bytes(content) and not self.killed:
            self.killed = True
            os.kill(os.getpid(), signal.SIGTERM)
        return super().write(content)
sys.stderr = io.TextIOWrapper(io.BufferedWriter(Stream(2, "w", closefd=False)), write_through=True)
from clunk.cli import main
main()
"""
    command = [sys.executable, "-c", script, "sweep", str(ROOT / "configs/smoke.toml"), "-o", "map.h5"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 143, done.stderr
    assert "terminated" in done.stderr
    assert "Traceback" not in done.stderr


COMMANDS = cli.list_commands(click.Context(cli))
HEAVY = {"numba", "matplotlib", "pydantic", "numpy", "scipy", "h5py", "rich"}


def test_the_list_of_commands_cuts_no_sentence_short(command):
    listed = command("--help")[1].partition("Commands:")[2].splitlines()[1:]
    assert len(listed) == len(COMMANDS)
    assert [line for line in listed if not line.endswith(".") or line.endswith("...")] == []


def test_help_and_version_import_nothing_heavy():
    """Nor do the topics, where no terminal has them drawn."""
    script = f"""
import sys
from clunk.cli import cli, main
for arguments in (["--help"], ["--version"], ["help"], ["help", "method"], *([name, "--help"] for name in {COMMANDS})):
    sys.argv = ["clunk", *arguments]
    try:
        main()
    except SystemExit as stopped:
        assert not stopped.code, arguments
    assert not {HEAVY} & set(sys.modules), arguments
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_and_an_example_whose_options_are_real(command, name):
    code, out, _ = command(name, "--help")
    assert code == 0
    description = out.split("Options:")[0].split("\n", 2)[2].replace("\\\n", " ")
    examples = re.findall(rf"clunk ({name} .*|{name}$)", description, flags=re.MULTILINE)
    assert examples
    assert max(map(len, out.splitlines())) <= 80
    for line in examples:
        arguments = shlex.split(line.partition(" > ")[0])[1:]
        cli.get_command(None, name).make_context(name, arguments)  # raises UsageError


def test_shells_complete_commands_and_options_by_what_click_has():
    """As the README's line has them ask, and without what makes Tab wait."""
    for words, found in (("clunk thr", "thresholds"), ("clunk sweep --rest", "--restart")):
        asked = {"_CLUNK_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        script = f"""
import sys, atexit
from clunk.cli import main
atexit.register(lambda: print(sorted({HEAVY} & set(sys.modules))))
sys.argv = ["clunk"]
main()
"""
        done = subprocess.run(
            [sys.executable, "-c", script], env=os.environ | asked, capture_output=True, text=True, check=False
        )
        assert done.stdout.splitlines() == [f"plain,{found}", "[]"], done.stderr


def test_help_lists_its_topics_and_prints_one_as_it_is_where_no_terminal_is(command):
    code, out, _ = command("help")
    assert code == 0
    topics = [line.split()[0] for line in out.splitlines()]
    assert topics == sorted(page.stem for page in (ROOT / "clunk/cli/help").glob("*.md"))
    for topic in topics:
        assert command("help", topic)[1] == (ROOT / f"clunk/cli/help/{topic}.md").read_text(encoding="utf-8")
    code, _, err = command("help", "metod")
    assert code == 2
    assert "method" in err


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_a_stream_that_is_closed_takes_what_is_written(tmp_path, closed):
    """As ``>&-`` and the starters of services close them."""
    code = f"import sys; sys.{closed} = None; sys.argv[:] = ['clunk', 'help', 'config']; import clunk.cli as program"
    done = subprocess.run([sys.executable, "-c", f"{code}; program.main()"], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_is_to_be_written_is_written_though_nobody_reads_on(tmp_path):
    """As ``| head -1`` does not."""
    command = [sys.executable, "-m", "clunk", "simulate", ROOT / "configs/nominal.toml", "-o", "run.csv"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    _, errors = process.communicate(timeout=120)
    assert (process.returncode, errors) == (0, b"-> run.csv\n")
    assert (tmp_path / "run.csv").stat().st_size > 1000


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a file that takes nothing is Linux's")
def test_a_map_is_written_though_what_is_told_of_it_cannot_be(tmp_path):
    config = [f"--set=sweep.axes[{k}].count=3" for k in (1, 2)]
    command = [sys.executable, "-m", "clunk", "sweep", ROOT / "configs/smoke.toml", *config, "-o", "map.h5"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, timeout=120, check=False)
    assert done.returncode == 2
    assert read_results(tmp_path / "map.h5").shape == (3, 3)
