"""Thresholds are where runs by themselves change, where linear theory has them, and said in every form."""

import csv
import json
import re
from itertools import pairwise

import numpy as np
import pytest
from conftest import NOMINAL, axis
from helpers.feet import feet_of_figure_3_4
from helpers.loads import ramp
from helpers.oddities import odd_table, study_of_table
from helpers.reference import THRESHOLDS

import clunk
from clunk.analysis import thresholds as analysis
from clunk.analysis.search import POINT, TOLERANCE, PointRuns, narrow
from clunk.analysis.thresholds import thresholds
from clunk.cli.analyses import print_thresholds
from clunk.plot.analyses import threshold_figure
from clunk.plot.style import PlotError
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import quantity_of
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.sweeping.sweep import engine_of

RAMP = ("load.profile=ramp", "solver.method=exact")


DURATION, RATIO, LASH = (
    axis("load.duration", 0.0, 0.6, 61),
    axis("load.ratio", 0.0, 15.0, 31),
    axis("lash.backlash_deg", 0.0, 20.0, 41),
)


def study(*axes, of=()):
    return study_from_text(NOMINAL + "".join(axes), overrides=of)


def changes(result, cell=0):
    """Values and outcomes of a cell, without slivers, which a coarser scan may miss."""
    wide = [(end, result.word(code)) for begin, end, code in result.intervals(cell) if end - begin > 1e-4]
    merged = [(end, word) for (end, word), (_, after) in pairwise([*wide, (None, None)]) if word != after]
    return [end for end, _ in merged[:-1]], [word for _, word in merged]


def bisected(at, low, high, word):
    """Value at which single runs cease to have this label, to 1e-12."""
    while high - low > 1e-12:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if at(middle) == word else (low, middle)
    return low


@pytest.mark.parametrize("method", ["exact", "rk4"])
@pytest.mark.parametrize("row", [row for row in THRESHOLDS if row[1] is ramp], ids=lambda row: row[0])
def test_ramps_change_labels_at_known_durations_and_outcomes_come_back(row, method):
    """From 0.2 s on for a load ratio of 10, of which the table has no more; by rk4 to its error of some 1e-6 s."""
    ratio, _, *sequence = row
    start = 0.2253 if ratio == 10.0 else 0.0
    duration = axis("load.duration", start, 0.6, 61)
    overrides = (*RAMP, f"load.ratio={ratio}", f"solver.method={method}")
    where, words = changes(thresholds(study(duration, of=overrides), along="load.duration"))
    assert words == sequence[::2]
    assert where == pytest.approx(sequence[1::2], abs=1e-5)


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_each_is_where_single_runs_change(method):
    swept = study(DURATION, of=(*RAMP, f"solver.method={method}"))
    result = thresholds(swept, along="load.duration")

    def label_at(duration):
        return clunk.simulate(clunk.replace_values(swept, {"load.duration": duration})).label

    for k in range(result.value.size):
        value, below, above = result.value[k], result.word(result.below[k]), result.word(result.above[k])
        near = 1e-9 * 0.6  # the promise; slivers next to it are wider
        assert (label_at(value - near), label_at(value + near)) == (below, above)
        assert bisected(label_at, value - near, value + near, below) == pytest.approx(value, abs=near)


def test_the_feet_of_figure_3_4_are_those_of_the_linear_chain():
    """At no backlash the flanks change where the overlap 1 + σr g changes sign: first at σr = -1/min g, and so on."""
    feet = feet_of_figure_3_4()
    result = thresholds(study(RATIO, of=("lash.backlash_deg=0.0", "solver.method=exact")), along="load.ratio")
    where, words = changes(result)
    assert words == ["NI", "DS(1)", "DS(2)", "DS(3)", "DS(4)"]
    assert where == pytest.approx([1.43, 3.07, 6.61, 14.21], abs=0.01)
    assert where == pytest.approx(feet[:4].tolist(), rel=1e-7)


def test_cells_do_not_depend_on_each_other_nor_on_the_order_of_axes_and_workers():
    """Alone, a cell's brackets get more runs at a time, and end elsewhere within the tolerance of 1e-9 of the axis."""
    few = axis("load.ratio", 2.0, 10.0, 3)
    both = thresholds(study(few, LASH, of=RAMP[1:]), along="lash.backlash_deg", workers=1)
    turned = thresholds(study(LASH, few, of=RAMP[1:]), along="lash.backlash_deg", workers=2)
    assert both.rows() == turned.rows()
    for cell, ratio in enumerate((2.0, 6.0, 10.0)):
        alone = thresholds(study(LASH, of=(*RAMP[1:], f"load.ratio={ratio}")), along="lash.backlash_deg")
        assert both.value[both.cell == cell] == pytest.approx(alone.value, abs=20.0 * 1e-9)


@pytest.mark.parametrize(
    ("outcome", "ratio"), [("double_sided", 3), ("label=D(2)", 5), ("severity<=8000", 5), ("primary_impacts>4", 10)]
)
def test_an_outcome_changes_where_dense_runs_say(outcome, ratio):
    """1001 runs over the axis have the outcome of the interval that each lies in."""
    swept = study(LASH, of=(*RAMP[1:], f"load.ratio={ratio}.0"))
    result = thresholds(swept, along="lash.backlash_deg", of=outcome)
    gaps = np.linspace(0.0, 20.0, 1001)
    runs = clunk.run_points(swept, {"lash.backlash_deg": gaps})
    expected = result.outcome.of_runs(runs)
    codes = np.concatenate([result.lowest, result.above])[np.searchsorted(result.value, gaps)]
    assert [float(result.word(code)) for code in codes] == expected.tolist()
    assert result.value.size


def test_outcomes_are_asked_for_as_they_are_written_and_what_is_none_is_refused():
    labels = thresholds(study(DURATION, of=RAMP), along="load.duration")
    assert labels.where("DS(1)SS(1)") == labels.where("D(1)+S(1)") == labels.where("DS(1) SS(1)") != []
    with pytest.raises(ClunkError, match="DS1' is no label"):
        labels.where("DS1")
    with pytest.raises(ClunkError, match=r"True is no outcome; these are DS\(1\), DS"):
        labels.where(True)
    crossings = thresholds(study(DURATION, of=RAMP), along="load.duration", of="double_sided")
    with pytest.raises(ClunkError, match="NI is no outcome"):
        crossings.where("NI")


def test_counts_of_impacts_change_where_labels_do():
    """The margin of the runs shows both where impacts come and go between two values of the axis."""
    table, along = odd_table(207), "driveline.inertias[1]"
    first = table["driveline"]["inertias"][0]
    axes = [{"parameter": along, "start": 0.3 * first, "stop": 1.7 * first, "count": 17}]
    swept = study_of_table(table | {"sweep": {"axes": axes}})
    label, count = (thresholds(swept, along=along, of=outcome) for outcome in ("label", "primary_impacts"))
    assert label.value.size > 4
    assert count.value == pytest.approx(label.value, abs=20.0 * 1e-9 * first)


def test_chatter_is_gone_from_a_contact_damping_on():
    """Below it, and only there, a run has touches that are no primary impacts."""
    swept = study(axis("lash.contact.damping", 200.0, 500.0, 4), of=RAMP[1:])
    (value,) = thresholds(swept, along="lash.contact.damping", of="chatter").value
    for damping, chatters in ((value - 3e-7, True), (value + 3e-7, False)):
        run = clunk.simulate(clunk.replace_values(swept, {"lash.contact.damping": damping}))
        assert (run.touches > run.primaries.size) == chatters


def test_failed_runs_are_an_outcome_and_not_invented():
    result = thresholds(study(RATIO, of=("solver.max_events=20", *RAMP[1:])), along="load.ratio")
    words = [result.word(code) for _, _, code in result.intervals(0)]
    assert FAILED in words
    assert sum(result.failures.values()) > 0
    assert not result.unresolved
    edge, off = (each[words.index(FAILED) - 1] for each in (result.value, result.off))
    assert off < 1e-3 * 10.0  # of the axis
    status = clunk.run_points(result.study, {"load.ratio": [edge - off, edge + off]}).status
    assert status.tolist() == [0, next(iter(result.failures))]


@pytest.mark.parametrize(
    ("text", "along", "of", "message"),
    [
        (RATIO, "load.raito", "label", r"\"load.raito\" is none of the.*did you mean load.ratio"),
        ("", "load.ratio", "label", "needs .*sweep.axes"),
        (RATIO, "load.ratio", "lable", "no quantity.*did you mean label"),
        (RATIO, "load.ratio", "severity", "changes everywhere; give a bound"),
        (RATIO, "load.ratio", "severity<=much", "compares nothing"),
        (RATIO, "load.ratio", "double_sided<2", "compares nothing"),
        (RATIO, "load.ratio", "label=DS", "compares nothing"),
        (RATIO, "load.ratio", "nominal_label=1", "compares nothing"),
        (RATIO, "load.ratio", "margin<=0.1", "only the exact method knows it"),  # and this is rk4
        (RATIO, "load.ratio", "nominal_label", "no thresholds"),
        (axis("load.ratio", 5.0, 5.0, 1), "load.ratio", "label", "has one value"),
        (axis("impacts.acceleration_of", 1.0, 4.0, 4), "impacts.acceleration_of", "touches", "whole number"),
        ('[sweep]\ndesign = "zip"\n' + RATIO, "load.ratio", "label", "neither"),
        (
            f'{RATIO}[[sweep.samples]]\nparameter = "lash.backlash_deg"\ndistribution = "normal"\nstd = 0.1\n',
            "load.ratio",
            "label",
            r"sweep\.samples",
        ),
    ],
)
def test_what_has_no_thresholds_is_refused_in_a_sentence(text, along, of, message):
    with pytest.raises(ClunkError, match=message):
        thresholds(study(text), along=along, of=of)


def test_a_bracket_of_noise_is_given_up_and_another_beside_it_is_not():
    ran = []

    def run(cells, values):
        ran.append(values.size)
        points = np.zeros(values.size, POINT)
        noise = np.modf(1e12 * np.sin(1e9 * values))[0] > 0.0
        points["cell"], points["value"], points["outcome"] = cells, values, np.where(cells == 0, noise, values > 0.3)
        points["measure"] = points["outcome"] - 0.5
        return points

    ends = np.zeros((2, 2), POINT)
    ends["cell"], ends["value"], ends["outcome"] = np.array([[0], [1]]), [0.0, 1.0], [0, 1]
    ends["measure"] = ends["outcome"] - 0.5
    low, high = narrow(ends.ravel(), run, most=8)
    wide, sharp = low["cell"] == 0, low["cell"] == 1
    assert 8 < wide.sum() < 8 * 20  # one step may make as many of each as it has runs
    assert sharp.sum() == 1
    assert high["value"][sharp] - low["value"][sharp] <= TOLERANCE
    assert low["value"][sharp] <= 0.3 <= high["value"][sharp]
    assert sum(ran) < 2 * 2 * 30 + 8 * 20  # a sharp one is halved by every second step, with two runs, 30 times


def test_where_the_label_changes_too_often_the_place_is_told(monkeypatch):
    monkeypatch.setattr(analysis, "_MOST", 1)
    few = thresholds(study(axis("load.ratio", 0.0, 10.0, 2), of=RAMP[1:]), along="load.ratio")
    ((cell, begin, end),) = few.unresolved
    assert (cell, few.at(cell)) == (0, {})
    assert 0.0 <= begin < end <= 10.0
    monkeypatch.undo()
    every = thresholds(study(axis("load.ratio", 0.0, 10.0, 2), of=RAMP[1:]), along="load.ratio")
    assert not every.unresolved
    assert every.value.size > 1
    assert ((begin <= every.value) & (every.value <= end)).all()


def test_each_place_lies_between_two_values_of_the_axis_and_is_printed_with_the_digits_known(monkeypatch, capsys):
    monkeypatch.setattr(analysis, "_MOST", 1)
    few = thresholds(study(axis("load.ratio", 0.0, 10.0, 3), of=RAMP[1:]), along="load.ratio")
    assert len(few.unresolved) > 1
    for _, begin, end in few.unresolved:
        assert end - begin <= 5.0
        assert begin // 5.0 == np.nextafter(end, 0.0) // 5.0
    print_thresholds(few)
    wide = few.value[few.off > 1e-3]
    assert wide.size
    printed = re.findall(r"^ +(\d[\d.]*) ", capsys.readouterr().out, flags=re.MULTILINE)
    for value, off, text in zip(few.value, few.off, printed, strict=True):
        digits = len(text.partition(".")[2])
        assert abs(float(text) - value) <= 0.5 * 10.0**-digits
        assert 10.0**-digits >= 1e-2 * off  # one digit more than are known, and a leading one that is small


@pytest.fixture
def command(command, here):
    def run(text, *arguments):
        (here / "config.toml").write_text(NOMINAL + text, encoding="utf-8")
        code, out, err = command("thresholds", "config.toml", *arguments)
        assert max(map(len, err.splitlines())) <= 80
        return code, out, err

    return run


def test_the_command_prints_and_writes_the_same_thresholds(command, tmp_path):
    few = axis("load.ratio", 1.0, 9.0, 3)
    exact = ("--set", "solver.method=exact", "--along", "lash.backlash_deg")
    code, out, err = command(few + LASH, *exact, "-o", "t.csv")
    assert code == 0
    assert max(map(len, out.splitlines())) <= 80
    assert "in 3 cells" in err
    _, out, _ = command(few + LASH, *exact, "--json", "-o", "t.json")
    listed = json.loads(out)
    at_five = json.loads(command(few + LASH, *exact, "--json", "--at", "load.ratio=5.1")[1])
    tolerance = 1e-9 * 20.0  # degrees, as promised
    for row, same in zip(at_five, [row for row in listed if row["load.ratio"] == 5.0], strict=True):
        assert row == {**same, "lash.backlash_deg": pytest.approx(same["lash.backlash_deg"], abs=tolerance)}
    assert [*dict.fromkeys(row["load.ratio"] for row in listed)] == [1.0, 5.0, 9.0]
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert rows[0] == {"load.ratio": "1.0", "lash.backlash_deg": "", "below": "NI", "above": "NI"}
    assert listed[0] == {"load.ratio": 1.0, "lash.backlash_deg": None, "below": "NI", "above": "NI"}
    assert [float(row["lash.backlash_deg"]) for row in rows[1:]] == [row["lash.backlash_deg"] for row in listed[1:]]
    assert [row["above"] for row in rows] == [row["above"] for row in listed]
    assert json.loads((tmp_path / "t.json").read_text()) == listed


def test_what_never_changes_is_said_and_no_error(command):
    code, out, _ = command(LASH, "--along", "lash.backlash_deg", "--of", "severity<=1e9")
    assert code == 0
    assert out.splitlines()[-2:] == ["  lash.backlash_deg  below  above", "                  -  yes    yes"]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["-o", "t.txt"], 2, "must end in .csv, .json, .png, .svg, .pdf"),
        (["-o", "t.png"], 2, "no other axis to draw thresholds over"),
        (["--at", "load.ratio=5"], 2, "nothing is swept; --set load.ratio=5 gives a key its value"),
        (["--of", "severty<=8000"], 2, "did you mean severity?"),
        (["--set", "solver.max_events=8"], 3, "runs failed: more events than solver.max_events allows"),
    ],
)
def test_the_command_tells_what_it_cannot_do(command, arguments, code, message):
    stopped, _, err = command(RATIO, "--along", "load.ratio", *arguments)
    assert stopped == code
    assert message in " ".join(err.split())


def test_pictures_have_a_curve_for_each_threshold():
    few = axis("load.ratio", 4.0, 8.0, 3)
    result = thresholds(study(few, DURATION, of=RAMP), along="load.duration", of="double_sided")
    (ax,) = threshold_figure(result).axes
    assert sorted({y for line in ax.lines for y in line.get_ydata()}) == sorted(result.value.tolist())
    unsorted = '[[sweep.axes]]\nparameter = "load.ratio"\nvalues = [6.0, 4.0, 8.0]\n'
    (ax,) = threshold_figure(
        thresholds(study(unsorted, DURATION, of=RAMP), along="load.duration", of="double_sided")
    ).axes
    assert ax.get_xlim() == (4.0, 8.0)
    gaps = '[[sweep.axes]]\nparameter = "lash.backlash_deg"\nvalues = [4.0, 6.0]\n'
    family = thresholds(study(gaps, few, DURATION, of=RAMP), along="load.duration", of="double_sided")
    with pytest.raises(PlotError, match=r"one value of lash\.backlash_deg and load\.ratio"):
        threshold_figure(family)
    with pytest.raises(PlotError, match="no other axis"):
        threshold_figure(thresholds(study(DURATION, of=RAMP), along="load.duration"))


def test_a_value_between_those_of_an_axis_that_no_config_may_have_is_a_run_that_failed():
    """From a ratio of -1 to one of 1, a search may come to 0."""
    study = clunk.load_study("configs/nominal.toml", ["solver.method='exact'"])
    with engine_of(None, 1) as engine:
        runs = PointRuns(study, ["lash.ratio", "load.ratio"], quantity_of("label", study), 0, engine)
        points = runs(np.array([[-1.0, 5.0], [0.0, 5.0], [1.0, 5.0], [1.0, 1.0], [0.0, 1.0]]))
    failed = points["outcome"] == FAILED_CODE
    assert failed.tolist() == [False, True, False, False, True]
    assert [runs.words[code] for code in points["outcome"][~failed]] == ["DS(1)SS(1)", "DS(1)SS(1)", "NI"]
