"""Results of several lashes: their axis in memory, files and exports, the map of each alone, and commands on them."""

import csv
import json
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from helpers.maps import CELL_QUANTITIES, map_of
from test_store import padded

import clunk
from clunk.analysis import lines
from clunk.results import export
from clunk.results.export import save_history
from clunk.results.quantities import REGIME_QUANTITIES
from clunk.simulation.history import sample
from clunk.study.axes import ResultAxis, lash_axis
from clunk.study.study import to_toml

NAMES = ("gear", "differential")


def made(seed=1, shape=(5, 4), lashes=2):
    """A regime map of several lashes whose numbers are drawn."""
    rng = np.random.default_rng(seed)
    axes = (
        ResultAxis("load.ratio", np.linspace(0.0, 10.0, shape[0]), "load ratio", "σr = Td/Ts", "1"),
        ResultAxis("load.duration", np.linspace(0.0, 1.0, shape[1]), "duration of the load change", "d", "s"),
        lash_axis(NAMES[:lashes]),
    )
    sequence = rng.integers(0, 4, (*shape, lashes)).astype(np.int16)
    impacts = np.array([0, 1, 1, 2], np.int32)[sequence]
    arrays = {
        name: rng.random(sequence.shape) for name in ("severity", "approach_velocity", "last_event_time", "margin")
    }
    arrays |= {name: rng.random(impacts.sum()) for name in ("impact_time", "impact_closing_speed", "impact_severity")}
    arrays["quality"] = np.repeat(rng.integers(0, 4, (*shape, 1)).astype(np.uint8), lashes, axis=-1)
    return map_of(
        axes,
        ("NI", "SS(1)", "DS(1)", "DS(1)SS(1)"),
        sequence,
        title="Two lashes",
        config='title = "Two lashes"\n',
        digest="0" * 64,
        primary_impacts=impacts,
        touches=impacts + np.int32(1),
        impact_flank=rng.choice([-1, 1], impacts.sum()).astype(np.int8),
        **arrays,
    )


def equal(one, two):
    return all(getattr(one, name).tobytes() == getattr(two, name).tobytes() for name in REGIME_QUANTITIES)


@pytest.fixture(scope="module")
def two():
    return made()


@pytest.fixture
def path(two, tmp_path):
    clunk.write_results(tmp_path / "two.h5", two)
    return tmp_path / "two.h5"


def test_the_dimension_lash_lies_behind_the_axes_and_before_the_impacts(path):
    with h5py.File(path) as file:
        names = [name.decode() for name in file["lash"][()]]
        dimensions = {name: [dim.keys()[0] for dim in file[name].dims] for name in REGIME_QUANTITIES}
    assert names == list(NAMES)
    axes = ["load_ratio", "load_duration"]
    for name, quantity in REGIME_QUANTITIES.items():
        of_lash = [] if name in ("status", "quality") else ["lash"]
        assert dimensions[name] == [*axes, *of_lash, *([quantity.dimension] if quantity.dimension else [])]


@pytest.mark.parametrize("lash", NAMES)
def test_one_lash_is_a_map_without_the_axis(two, lash, tmp_path):
    part, k = two.of_lash(lash), NAMES.index(lash)
    assert part.shape == two.shape[:-1]
    for name in CELL_QUANTITIES:
        np.testing.assert_array_equal(getattr(part, name), getattr(two, name)[..., k])
    for name in ("impact_time", "impact_flank"):
        np.testing.assert_array_equal(padded(part, name)[..., 0], padded(two, name)[..., k, 0])
    clunk.write_results(tmp_path / "one.h5", part)
    assert equal(clunk.read_results(tmp_path / "one.h5"), part)


def test_a_lash_is_taken_by_name_or_number_and_by_default_the_first(two):
    assert equal(two.of_lash(), two.of_lash("gear"))
    assert equal(two.of_lash("2"), two.of_lash("differential"))
    assert equal(two.of_lash(2), two.of_lash("differential"))
    alone = two.of_lash()
    assert alone.of_lash() is alone
    part = two.at({"load.ratio": 5.0})
    assert part.lashes == NAMES
    assert equal(part.of_lash("differential"), two.of_lash("differential").at({"load.ratio": 5.0}))
    for map_, sentence in ((two, r'no lash "rear"; did you mean "gear"\? It'), (alone, r'must be 1 or "lash 1"\.')):
        with pytest.raises(clunk.ConfigError, match=sentence):
            map_.of_lash("rear")


def test_exports_have_a_row_for_each_lash_of_each_cell(two, tmp_path):
    export.save(tmp_path / "two.csv", two)
    with (tmp_path / "two.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["lash"] for row in rows] == [*NAMES] * 20
    assert [row["sequence"] for row in rows] == two.label_map.ravel().tolist()


# --- Runs of several lashes ------------------------------------------------------------------------------------------

RIG = """
[driveline]
preset = "boere-2008"
shafts = [
    {between = [1, 2], stiffness = 31.3, damping = 0.08},
    {between = [4, "ground"], stiffness = 31.3, damping = 0.1},
    {between = [1, "ground"], stiffness = 0.0, damping = 0.1},
]
[solver]
method = "exact"
end_time = 1.0
[[lash]]
name = "gear"
between = ["pinion", "ring"]
backlash_deg = 6.0
radius = 0.08
contact = {stiffness = 4.092e5, damping = 94.0}
[[lash]]
name = "joint"
between = ["flange", "pinion"]
backlash_deg = 3.0
radius = 0.08
contact = {stiffness = 4.092e5, damping = 94.0}
"""


def axes(ratios, gaps, lash=2):
    """Axes of so many load ratios up to 4 and, if any, so many gaps of a lash."""
    text = f'[[sweep.axes]]\nparameter = "load.ratio"\nstart = 0.0\nstop = 4.0\ncount = {ratios}\n'
    values = np.linspace(1.0, 5.0, gaps).tolist()
    return text + f'[[sweep.axes]]\nparameter = "lash[{lash}].backlash_deg"\nvalues = {values}\n' * (gaps > 0)


def rig(*counts):
    return clunk.study_from_text(RIG + (axes(*counts) if counts else ""))


@pytest.mark.parametrize("lash", ["gear", "joint"])
def test_thresholds_are_those_of_the_lash_that_is_named(lash):
    study = rig(9, 1)
    located = clunk.thresholds(study, along="load.ratio", of="double_sided", lash=lash)
    assert located.lash == lash
    assert located.value.size
    for value in located.value:
        run = {
            side: clunk.simulate(clunk.replace_values(study, {"load.ratio": value + side, "lash[2].backlash_deg": 1.0}))
            for side in (-1e-6, 1e-6)
        }
        k = study.lash_names.index(lash)
        assert ["DS" in each.lashes[k].label for each in run.values()] == [False, True]


def test_boundaries_of_a_lash_stay_with_it(tmp_path, monkeypatch):
    monkeypatch.setattr(lines, "_ON_ANY_MAP", 100_000)  # a few hundred runs
    results = clunk.sweep(rig(9, 5), boundaries=True, lash="joint")
    assert results.boundaries.lash == "joint"
    clunk.write_results(tmp_path / "traced.h5", results)
    again = clunk.read_results(tmp_path / "traced.h5")
    assert again.of_lash("joint").boundaries.vertices.tolist() == results.boundaries.vertices.tolist()
    assert again.of_lash("gear").boundaries is None
    assert again.at_lash("joint").boundaries is not None
    assert again.at({"lash": "joint"}).lash_names == ("joint",)
    with pytest.raises(clunk.ClunkError, match="lash must be gear or joint, not 'jiont'"):
        again.at({"lash": "jiont"})
    assert again.at({}).boundaries is not None  # as `clunk plot` and `clunk report` without --at take it


def test_a_sweep_with_the_lines_of_another_lash_tells_of_these_only(tmp_path, monkeypatch, command):
    monkeypatch.setattr(lines, "_ON_ANY_MAP", 100_000)
    (tmp_path / "two.toml").write_text(to_toml(rig(9, 5)))
    sweep = "sweep", tmp_path / "two.toml", "-o", tmp_path / "two.h5", "--boundaries", "--lash"
    for lash in ("gear", "joint"):
        code, out, err = command(*sweep, lash)
        assert code == 0
        assert "boundaries" not in out
        assert "boundaries: " in err


def test_tolerances_and_sensitivities_know_the_lashes():
    draw = (
        '[[sweep.tolerances]]\nparameter = "lash[{}].backlash_deg"\ndistribution = "uniform"\nlow = 2.0\nhigh = 4.0\n'
    )
    drawn = f"{draw.format(1)}{draw.format(2)}[sweep.sampling]\ncount = 16\n"
    study = clunk.study_from_text(RIG + axes(3, 0) + drawn)
    tolerances = clunk.tolerance_map(study)
    assert tolerances.runs.shape == (3, 2, len(tolerances.labels) + 1)
    alone = tolerances.of_lash("joint")
    np.testing.assert_array_equal(alone.severity_mean, tolerances.severity_mean[..., 1])
    shares = clunk.sensitivity(study, of=["severity"], lash="joint").indices[0]
    assert shares.nominal == clunk.simulate(rig()).lashes[1].severity


def test_commands_take_a_lash_by_name(path, command):
    code, out, _ = command("info", path)
    assert code == 0
    assert "lash: gear, differential" in out
    code, out, _ = command(
        "plot", path, "--lash", "differential", "--quantity", "regimes", "-o", path.with_name("one.svg")
    )
    assert code == 0
    assert "differential" in path.with_name("one.svg").read_text("utf-8")
    code, out, err = command("plot", path, "--lash", "rear")
    assert code == 2
    assert 'a number from 1 to 2, "gear" or "differential"' in " ".join(err.split())
    config = path.with_name("rig.toml")
    config.write_text(RIG)
    code, out, _ = command("simulate", config, "--set", "load.ratio=2.0")
    assert code == 0
    assert re.search(r"touch +joint +\w+", out)
    assert re.search(r"^gear +\S+ \(", out, re.MULTILINE)
    code, out, _ = command("simulate", config, "--json", "--set", "load.ratio=2.0")
    assert list(json.loads(out)["lashes"]) == ["gear", "joint"]
    code, out, _ = command("modes", config)
    assert "all lashes closed" in out
    assert "load ratio" not in out  # of one impact more: lashes do not change sides together


@pytest.mark.parametrize("names", [("a b", "a/b"), ("x" * 300, "x" * 299 + "y")], ids=["signs", "long"])
def test_pictures_of_all_lashes_are_kept_though_their_names_are_alike_in_files(names, two, tmp_path, command):
    axis = replace(two.axes[-1], words=names)
    clunk.write_results(tmp_path / "two.h5", replace(two, axes=(*two.axes[:-1], axis)))
    code, out, err = command("plot", tmp_path / "two.h5", "--quantity", "regimes")
    assert (code, err) == (0, "")
    assert out.split() == [str(tmp_path / f"two-{number}-regimes.png") for number in (1, 2)]


def test_the_picture_of_a_comparison_is_that_of_the_first_lash(path, tmp_path, command):
    clunk.write_results(tmp_path / "other.h5", made(seed=2))
    code, _, _ = command("compare", path, tmp_path / "other.h5", "-o", tmp_path / "differences.svg")
    assert code == 0
    first = clunk.compare(clunk.read_results(path).of_lash(), made(seed=2).of_lash())
    assert f"{first.differing} of 20 cells differ" in (tmp_path / "differences.svg").read_text("utf-8")


def test_a_history_has_the_backlash_of_each_lash(tmp_path):
    run = clunk.simulate(clunk.replace_values(rig(), {"load.ratio": 2.0}))
    history = sample(run, step=1e-3)
    for k, (view, lash) in enumerate(zip(history.lashes, run.study.lashes, strict=True)):
        one, other = (int(end) - 1 for end in lash.between)
        q = history.angle[:, one] - history.angle[:, other]
        np.testing.assert_allclose(view.backlash_coordinate, lash.radius * q, rtol=1e-12, atol=1e-15)
        touched = np.abs(view.backlash_coordinate[view.touches.row])
        np.testing.assert_allclose(touched, view.half_gap, rtol=1e-9)
        assert view.touches.row.size == run.lashes[k].touches
    save_history(tmp_path / "run.csv", history)
    head, first = (tmp_path / "run.csv").read_text().splitlines()[:2]
    assert head.endswith("backlash_coordinate_1_m,backlash_coordinate_2_m,contact_1,contact_2,event,lash,flank")
    assert len(first.split(",")) == len(head.split(","))
