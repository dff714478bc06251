"""Designs: what is walked or drawn together, and grids of many axes; their cells, slices, files and figures."""

import json

import numpy as np
import pytest
from conftest import EXACT, NOMINAL, axis, drawn, values
from helpers.maps import IMPACT_QUANTITIES
from scipy.stats import truncnorm
from test_store import assert_same
from test_sweeping import equal, regimes, same_as_single_run

from clunk import plot
from clunk.analysis.comparison import compare
from clunk.results.store import read_map, read_results, write_results
from clunk.study.axes import RUN
from clunk.study.config import study_from_text
from clunk.study.designs import design_of
from clunk.study.errors import ConfigError
from clunk.study.records import plain, text_of
from clunk.study.study import replace_values
from clunk.study.sweeps import Draw
from clunk.sweeping.sweep import sweep

ZIP = f'{EXACT}[sweep]\ndesign = "zip"\n{values("load.ratio", [1, 2, 5, 5, 8])}{axis("lash.backlash_deg", 1, 9, 5)}'
ZIP += values("driveline.inertias[4]", [0.003, 0.002, 0.001, 0.002, 0.001])
DRAWS = (
    "[sweep.sampling]\ncount = {}\nseed = 3\n"
    + drawn("samples", "lash.contact.stiffness", "normal", draws="factor", std=0.15)
    + drawn("samples", "driveline.inertias[4]", "lognormal", sigma=0.3)
)
SAMPLE = EXACT + DRAWS.format(32) + drawn("samples", "load.ratio", "uniform", low=0, high=10)
AXES = {
    "load.ratio": [0.0, 1.0, 2.5, 4.6, 7.0, 10.0],
    "lash.backlash_deg": [0.0, 2.0, 6.0, 15.0],
    "lash.contact.stiffness": [1e5, 4.092e5, 1.6e6],
    "driveline.shafts[1].damping": [0.04, 0.16],
}


def grid(*names: str) -> str:
    return "".join(values(name, AXES[name]) for name in names)


@pytest.fixture(scope="module")
def zipped():
    return sweep(study_from_text(ZIP))


@pytest.fixture(scope="module")
def sampled():
    return sweep(study_from_text(SAMPLE))


@pytest.fixture(scope="module")
def mixed():
    """A grid of two axes for each of six drawn drivelines."""
    return sweep(study_from_text(EXACT + DRAWS.format(6) + grid("load.ratio", "lash.backlash_deg")))


@pytest.fixture(scope="module")
def four():
    return sweep(study_from_text(EXACT + grid(*AXES)))


class TestCells:
    @pytest.mark.parametrize("text", [ZIP, SAMPLE], ids=["zip", "sample"])
    def test_each_is_the_single_run_of_its_parameters(self, text):
        study = study_from_text(text)
        results = sweep(study)
        assert results.shape == (design_of(study).cells,)
        assert [axis.parameter for axis in results.axes] == [RUN]
        for k in range(*results.shape):
            values = {axis.parameter: float(axis.values[k]) for axis in results.coordinates}
            assert len(values) == 3
            same_as_single_run(results, (k,), replace_values(study, values))

    def test_those_of_a_grid_of_samples_too(self, mixed):
        study = study_from_text(mixed.config)
        assert mixed.shape == (6, 4, 6)
        for cell in np.ndindex(mixed.shape):
            values = {axis.parameter: float(axis.values[cell[k]]) for k, axis in enumerate(mixed.axes[:2])}
            values |= {axis.parameter: float(axis.values[cell[2]]) for axis in mixed.coordinates}
            same_as_single_run(mixed, cell, replace_values(study, values))

    def test_a_seed_reproduces_the_sweep_whatever_the_number_of_workers(self, sampled):
        assert equal(sampled, sweep(study_from_text(SAMPLE), workers=1))
        other = sweep(study_from_text(SAMPLE, "x", ["sweep.sampling.seed=4"]))
        assert not np.array_equal(sampled.severity, other.severity)


class TestSlices:
    def test_impacts_follow_their_cells(self, four):
        first = four.first_impact
        part = four.at({"lash.backlash_deg": 6.0, "driveline.shafts[1].damping": 0.16})
        assert part.shape == (6, 1, 3, 1)
        assert part.impact_time.size > 10
        for i in range(6):
            for j in range(3):
                whole = np.ravel_multi_index((i, 2, j, 1), four.shape)
                own = np.ravel_multi_index((i, 0, j, 0), part.shape)
                for name in IMPACT_QUANTITIES:
                    mine = getattr(part, name)[part.first_impact[own] : part.first_impact[own + 1]]
                    assert np.array_equal(mine, getattr(four, name)[first[whole] : first[whole + 1]])

    def test_a_run_keeps_its_coordinates(self, mixed):
        part = mixed.at({RUN: 4})
        assert part.shape == (6, 4, 1)
        for whole, own in zip(mixed.coordinates, part.coordinates, strict=True):
            assert own.values.tolist() == [whole.values[3]]
        assert np.array_equal(part.sequence[:, :, 0], mixed.sequence[:, :, 3])


class TestFiles:
    @pytest.mark.parametrize("name", ["zipped", "sampled", "mixed", "four"])
    def test_what_is_written_is_what_is_read(self, name, request, tmp_path):
        results = request.getfixturevalue(name)
        write_results(tmp_path / "results.h5", results)
        again = read_results(tmp_path / "results.h5")
        assert_same(results, again)
        assert [axis.parameter for axis in again.parameters] == [axis.parameter for axis in results.parameters]
        for mine, theirs in zip(results.coordinates, again.coordinates, strict=True):
            assert np.array_equal(mine.values, theirs.values)
            assert (mine.name, mine.symbol, mine.unit) == (theirs.name, theirs.symbol, theirs.unit)


class TestComparison:
    def test_cells_that_differ_are_named_by_their_parameters(self, sampled):
        text = SAMPLE.replace("preset = ", "shafts = [\n" + SHAFTS + "]\npreset = ")
        other = sweep(study_from_text(text))
        found = compare(sampled, other)
        assert 0 < found.differing <= 12
        (cell, *_) = found.differing_cells
        ratio = sampled.coordinates[2].values
        assert cell.at["load.ratio"] in ratio[found.differs]
        assert set(plain(found)["differing_cells"][0]["at"]) == {axis.parameter for axis in sampled.coordinates}
        lines = text_of(found).splitlines()
        assert max(map(len, lines)) <= 80
        assert any("load.ratio = " in line for line in lines)


SHAFTS = """
  { between = [1, 2], stiffness = 31.3, damping = 0.12 },
  { between = [2, 3], stiffness = 31.3, damping = 0.04 },
  { between = [4, "ground"], stiffness = 31.3, damping = 0.1 },
  { between = [1, "ground"], stiffness = 0.0, damping = 0.1 },
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory, four, zipped, sampled, mixed):
    """The results in files, and what a command prints about them: command(*arguments) -> code, stdout, stderr."""
    place = tmp_path_factory.mktemp("designs")
    for name, results in {"four": four, "zip": zipped, "sample": sampled, "mixed": mixed}.items():
        write_results(place / f"{name}.h5", results)
    return place


@pytest.fixture
def command(files, command, monkeypatch):
    monkeypatch.chdir(files)
    return command


FACETS = ["--facet", "lash.contact.stiffness", "--facet", "driveline.shafts[1].damping"]


class TestCommandLine:
    @pytest.mark.parametrize(
        ("arguments", "pictures"),
        [
            (["four.h5", *FACETS, "--quantity", "regimes"], ["four-regimes.png"]),
            (["four.h5", "--at", "lash.contact.stiffness=4e5", "--at", "driveline.shafts[1].damping=0.04"],
             ["four-regimes.png", "four-severity.png"]),
            (["four.h5", "--at", "lash.contact.stiffness=4e5", *FACETS[2:], "--quantity", "touches", "-o", "t.svg"],
             ["t.svg"]),
            (["four.h5", *(f"--at={key}={values[0]:g}" for key, values in list(AXES.items())[1:])],
             ["four-severity.png"]),
            (["zip.h5"], ["zip-regimes.png", "zip-severity.png"]),
            (["zip.h5", "--x", "run", "--quantity", "touches"], ["zip-touches.png"]),
            (["sample.h5"], ["sample-regimes.png", "sample-severity.png"]),
            (["sample.h5", "--x", "load.ratio"], ["sample-severity.png"]),
            (["sample.h5", "--x", "load.ratio", "--y", "driveline.inertias[4]", "--quantity", "margin"],
             ["sample-margin.png"]),
            (["sample.h5", "--at", "run=7"], ["sample-severity.png"]),
            (["mixed.h5", "--facet", "run", "--quantity", "touches"], ["mixed-touches.png"]),
            (["mixed.h5", "--at", "run=3", "--quantity", "regimes"], ["mixed-regimes.png"]),
            (["mixed.h5", "--at", "lash.backlash_deg=6", "--quantity", "severity"], ["mixed-severity.png"]),
        ],
    )  # fmt: skip
    def test_every_design_is_drawn(self, command, files, arguments, pictures):
        code, out, err = command("plot", *arguments)
        assert code == 0, err
        assert out.split() == pictures
        for picture in pictures:
            (files / picture).unlink()

    @pytest.mark.parametrize(
        ("arguments", "found"),
        [
            (["four.h5"], "one value of lash.contact.stiffness and driveline.shafts[1].damping (--at), or draw a map"),
            (["four.h5", *FACETS[:2]], "choose one value of driveline.shafts[1].damping (--at)"),
            (
                ["four.h5", *FACETS, "--facet", "load.ratio"],
                "A facet is an axis of several values, or two are rows and columns",
            ),
            (["four.h5", "--facet", "load.ration"], "or two are rows and columns; these are load.ratio"),
            (
                ["four.h5", *FACETS[:2], *FACETS[:2]],
                "A facet is an axis of several values, or two are rows and columns",
            ),
            (["four.h5", *FACETS, "--at", "load.ratio=1"], "needs two axes"),
            (["four.h5", "--x", "load.ratio"], "x and y are for axes that are walked together and for samples"),
            (["four.h5", "--at", "load.ration=1"], "must be KEY=VALUE of what is swept: load.ratio: "),
            (["four.h5", "--at", "load.ratio=11"], "load.ratio is swept from 0 to 10; 11 is not on it."),
            (["zip.h5", "--x", "lash.radius"], "lash.radius does not change in these results"),
            (["sample.h5", "--x", "lash.radius"], "lash.radius does not change in these results"),
            (["sample.h5", "--facet", "run"], "needs two axes"),
            (["sample.h5", "--at", "load.ratio=5"], "must be KEY=VALUE of what is swept: run: 1 to 32"),
            (["mixed.h5"], "differ in run would lie on each other: choose one value (--at)"),
            (["mixed.h5", "--x", "load.ratio"], "differ in lash.backlash_deg would lie on each other"),
        ],
    )
    def test_what_cannot_be_drawn_is_answered_with_what_to_type(self, command, files, arguments, found):
        before = sorted(files.iterdir())
        code, out, err = command("plot", *arguments)
        assert (code, out) == (2, "")
        assert found in " ".join(err.split())
        assert sorted(files.iterdir()) == before

    def test_nearest_values_are_told(self, command):
        at = ["--at", "lash.contact.stiffness=4e5", "--at", "load.ratio=1"]
        _, _, err = command("plot", "four.h5", *at, "--quantity", "touches")
        assert err.splitlines() == ["lash.contact.stiffness = 409200 is the nearest value of its axis"]

    def test_a_cell_of_a_sample_is_run_again_by_its_run(self, command, sampled):
        code, out, _ = command("simulate", "sample.h5", "--at", "run=17", "--json")
        found = json.loads(out)
        assert code == 0
        assert found["label"] == regimes(sampled)[16]
        assert found["severity"] == sampled.severity[16]
        code, _, err = command("simulate", "sample.h5")
        assert code == 2
        assert "name by --at KEY=VALUE: run: 1 to 32, 32 values" in " ".join(err.split())

    def test_info_tells_what_lies_along_the_runs(self, command, sampled):
        _, out, _ = command("info", "sample.h5")
        ratio = sampled.coordinates[2].values
        assert "run: 1 to 32, 32 values" in out
        assert f"load.ratio: {ratio.min():g} to {ratio.max():g}" in out
        _, out, _ = command("info", "sample.h5", "--json")
        assert [each["parameter"] for each in json.loads(out)["axes"]] == [
            axis.parameter for axis in sampled.coordinates
        ]
        _, out, _ = command("info", "four.h5")
        assert out.count("\naxis ") == 4
        assert read_map("four.h5").coordinates == ()


class TestFigures:
    def test_panels_are_slices_under_one_legend_and_one_palette(self, four):
        figure = plot.draw(four, "regimes", facets=["lash.contact.stiffness", "driveline.shafts[1].damping"])
        panels = figure.subfigs[0].axes
        assert len(panels) == 6
        assert [panel.get_title(loc="left") for panel in panels[:2]] == [
            "k = 100000 N/m\nc$_\\mathregular{1}$ = 0.04 N m s/rad",
            "k = 100000 N/m\nc$_\\mathregular{1}$ = 0.16 N m s/rad",
        ]
        noted = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        assert len(set(noted)) == len(noted)
        assert {text.get_text() for panel in panels for text in panel.texts} | set(noted) >= set(four.labels)
        limits = {(panel.get_xlim(), panel.get_ylim()) for panel in panels}
        assert limits == {((0.0, 10.0), (0.0, 15.0))}

    def test_of_many_values_of_a_facet_evenly_spaced_ones_are_drawn_and_that_is_told(self, four):
        figure = plot.draw(four, "touches", facets=["load.ratio", "driveline.shafts[1].damping"])
        assert len(figure.subfigs[0].axes) == 8 + 1  # four of six load ratios, two dampings, and the colour bar
        titles = [ax.get_title(loc="left") for ax in figure.axes]
        assert "= 0\n" in titles[0]
        assert "= 10\n" in titles[7]
        assert "load ratio: 4 of 6 values" in figure.subfigs[0].get_suptitle()

    def test_runs_are_points_in_a_panel_for_each_cell_of_a_grid(self, mixed):
        x, y = (axis.parameter for axis in mixed.coordinates[:2])
        figure = plot.draw(mixed, "severity", facets=["load.ratio", "lash.backlash_deg"], x=x, y=y)
        panels = [ax for ax in figure.subfigs[0].axes if ax.collections and ax.get_title(loc="left")]
        assert len(panels) == 4 * 4
        expected = np.column_stack([axis.values for axis in mixed.coordinates[:2]])
        for ax in panels:
            np.testing.assert_array_equal(ax.collections[0].get_offsets(), expected)

    def test_a_point_stands_for_each_run_in_its_labels_colour(self, sampled):
        figure = plot.draw(sampled, "regimes", x="load.ratio", y="driveline.inertias[4]")
        ax = figure.axes[0]
        (points,) = ax.collections
        inertia, ratio = (sampled.coordinates[k].values for k in (1, 2))
        np.testing.assert_array_equal(points.get_offsets(), np.column_stack((ratio, inertia)))
        colours = [tuple(colour) for colour in points.get_facecolors()]
        by_label = {
            label: {c for c, own in zip(colours, regimes(sampled), strict=True) if own == label}
            for label in sampled.labels
        }
        assert all(len(own) == 1 for own in by_label.values())
        assert len(set.union(*by_label.values())) == len(sampled.labels)
        assert len(figure.legends[0].get_texts()) == len(sampled.labels)


@pytest.mark.parametrize(
    ("mean", "std", "low", "high"), [(0, 1, 9, 10), (1, 0.1, 3, None), (0, 1, -10, -9), (0, 1, None, -9), (0, 1, -1, 2)]
)
def test_a_truncated_distribution_is_drawn_from_however_far_its_bounds_are(mean, std, low, high):
    """Beyond 8.3 standard deviations the probability below a bound is 1, and the one above it has the digits."""
    u = np.linspace(0.01, 0.99, 9)
    ends = (-np.inf if low is None else (low - mean) / std, np.inf if high is None else (high - mean) / std)
    expected = truncnorm.ppf(u, *ends, mean, std)
    draw = Draw(parameter="load.ratio", distribution="normal", mean=mean, std=std, low=low, high=high)
    assert draw.quantiles(u, 5.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    "numbers", [{"distribution": "normal", "std": 0.1, "low": 9.0}, {"distribution": "lognormal", "sigma": 0.1}]
)
def test_what_nothing_can_be_drawn_of_is_refused(numbers):
    """No number of a normal distribution is 90 standard deviations from its mean; a median of zero is none."""
    text = NOMINAL + drawn("samples", "load.ratio", **numbers)
    with pytest.raises(ConfigError, match=r"nothing can be drawn for load\.ratio"):
        study_from_text(text, overrides=["load.ratio=0"])
