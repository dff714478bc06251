"""Tolerance maps: every cell is a plain loop of single runs, and what a figure and a file say is what was counted."""

import re

import numpy as np
import pytest
import xarray
from conftest import EXACT, axis, drawn, values
from helpers.maps import with_arrays
from matplotlib.colors import to_rgb

import clunk as clunk_api
from clunk import plot
from clunk.core.status import Status
from clunk.plot import PlotError, save
from clunk.plot.layers import Layers
from clunk.plot.plane import View
from clunk.plot.style import colour_of
from clunk.results import store
from clunk.results.labels import double_sided, primary_impacts
from clunk.results.maps import QUANTILES
from clunk.results.netcdf import StoreError
from clunk.results.quantities import quantity_of
from clunk.results.store import read_results
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.designs import nominal
from clunk.study.errors import ClunkError
from clunk.study.parameters import drawn_numbers, nominal_value
from clunk.study.study import replace_values, to_toml
from clunk.sweeping import parts as keeping, tolerances
from clunk.sweeping.engines import run_tiles
from clunk.sweeping.parts import PartsError, WorkingDirectory
from clunk.sweeping.sweep import Job, engine_of, sweep

DRIVELINE = f'title = "Small"\n{EXACT}'
AXES = axis("load.ratio", 0.0, 10.0, 21) + axis("lash.backlash_deg", 0.5, 18.5, 7)


def tolerance(parameter, std=0.05, draws="factor"):
    return drawn("tolerances", parameter, "normal", draws=draws, std=std)


def study(*tolerances, axes=AXES, count=16, base=DRIVELINE, seed=1):
    return study_from_text(f"{base}{axes}[sweep.sampling]\ncount = {count}\nseed = {seed}\n{''.join(tolerances)}")


def equal(one, other):
    """Whether two tolerance maps agree to the last bit; NaN equals NaN."""
    names = ("runs", "nominal_sequence", "severity_mean", "severity_quantiles", "status")
    return one.labels == other.labels and all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=name.startswith("severity"))
        for name in names
    )


def single_runs(toleranced, cell):
    """Labels and severities of a plain loop over the draws, at these values of the axes."""
    draws = toleranced.sweep.tolerances
    all_numbers = drawn_numbers(toleranced, draws)
    bare = replace_values(nominal(toleranced).model_copy(update={"sweep": None}), cell)
    labels, severities = [], []
    for k in range(toleranced.sweep.sampling.count):
        own_values = {}
        for draw, numbers in zip(draws, all_numbers, strict=True):
            own = nominal_value(bare, draw.parameter)
            own_values[draw.parameter] = numbers[k] * own if draw.draws == "factor" else own + numbers[k]
        try:
            run = simulate(replace_values(bare, own_values))
        except ClunkError:
            labels.append("failed")
            continue
        labels.append(run.label)
        severities.append(run.severity)
    return labels, severities


def same_as_single_runs(found, toleranced, at):
    cell = {axis.parameter: float(axis.values[k]) for axis, k in zip(found.axes, at, strict=True)}
    labels, severities = single_runs(toleranced, cell)
    counted = dict(zip((*found.labels, "failed"), found.runs[at].tolist(), strict=True))
    assert {label: count for label, count in counted.items() if count} == {
        label: labels.count(label) for label in labels
    }
    if severities:
        assert found.severity_mean[at] == np.mean(severities)
        assert np.array_equal(found.severity_quantiles[at], np.quantile(severities, QUANTILES))
    else:
        assert np.isnan(found.severity_mean[at])


@pytest.fixture(scope="module")
def toleranced():
    """Keys that make a new system, one that does not, and one of a swept key."""
    return study(
        tolerance("lash.contact.stiffness"),
        tolerance("driveline.inertias[4]"),
        tolerance("lash.backlash_deg"),
        tolerance("load.static_torque", 0.2, "offset"),
    )


@pytest.fixture(scope="module")
def found(toleranced):
    return clunk_api.tolerance_map(toleranced)


class TestCells:
    def test_the_probabilities_of_a_cell_add_up_to_one(self, found):
        assert np.array_equal(found.runs.sum(axis=-1), np.full(found.shape, 16))
        assert np.array_equal(found.probability.sum(axis=-1), np.ones(found.shape))  # exact: 16 is a power of two
        assert sum(found.shares().values()) == pytest.approx(1.0, abs=1e-12)
        assert sum(found.counts().values()) == 147

    def test_what_is_compared_has_the_probability_of_its_labels_or_is_refused(self, found):
        np.testing.assert_allclose(found.values("double_sided=0"), 1.0 - found.values("double_sided"), rtol=1e-12)
        of_label = found.probability[..., found.labels.index("SS(1)")]
        assert np.array_equal(found.values("label=SS(1)"), of_label)
        for compared in ("severity<=8000", "severity_95<=8000"):
            with pytest.raises(ClunkError, match=f"no {compared}: it keeps"):
                found.values(compared)

    def test_a_cell_is_a_plain_loop_of_single_runs(self, found, toleranced):
        """At 20 cells, half of them the least certain ones: the same counts, mean and quantiles to the last bit."""
        order = np.argsort(found.certainty, axis=None, kind="stable")
        cells = [*order[:10], *np.random.default_rng(3).choice(order[10:], 10, replace=False)]
        assert found.certainty.ravel()[cells].min() < 0.7
        for cell in cells:
            same_as_single_runs(found, toleranced, np.unravel_index(cell, found.shape))

    def test_the_nominal_label_is_that_of_the_map_without_tolerances(self, found, toleranced):
        plain = sweep(nominal(toleranced))
        labels = np.array([*found.labels, "failed"])
        assert np.array_equal(labels[found.nominal_sequence], np.array([*plain.labels, "failed"])[plain.sequence])


def test_rk4_and_axes_walked_together():
    axes = values("load.ratio", [2.0, 3.3, 8.5]) + values("lash.backlash_deg", [1.0, 9.0, 9.5])
    axes = f'[sweep]\ndesign = "zip"\n{axes}'
    base = study(tolerance("lash.contact.damping", 0.1), axes=axes, count=4, base=DRIVELINE.replace("exact", "rk4"))
    found = clunk_api.tolerance_map(base)
    assert found.shape == (3,)
    assert [each.parameter for each in found.coordinates] == ["load.ratio", "lash.backlash_deg"]
    for k in range(3):
        cell = {each.parameter: float(each.values[k]) for each in found.coordinates}
        labels, severities = single_runs(base, cell)
        assert found.labels[found.sequence[k]] == max(labels, key=labels.count)
        assert found.severity_mean[k] == np.mean(severities)
    (points,) = plot.draw(found, "regimes").axes[0].collections
    np.testing.assert_array_equal(points.get_offsets(), np.column_stack([each.values for each in found.coordinates]))


def test_sequences_longer_than_a_pattern_are_told_apart():
    """With no more than 1e-9 s of contact every touch is primary: a hundred, of which a pattern holds 62."""
    base = (
        DRIVELINE.replace('"exact"', '"exact"\nmax_events = 2000\nend_time = 10.0')
        + "[lash.contact]\ndamping = 5.0\n[impacts]\nsticking_time = 1e-9\n"
    )
    long = study(tolerance("driveline.inertias[4]", 0.3), axes=AXES.replace("= 21", "= 3"), count=4, base=base)
    found = clunk_api.tolerance_map(long)
    assert max(primary_impacts(label) for label in found.labels) > 62
    for at in [(1, 0), (2, 0), (2, 3)]:
        same_as_single_runs(found, long, at)


@pytest.fixture(scope="module")
def failing():
    return study(
        tolerance("load.ratio", 1.5, "offset"),
        axes=values("load.ratio", [1.0, 3.0, 5.0]),
        base=DRIVELINE.replace('"exact"', '"exact"\nmax_events = 14'),
    )


class TestFailedRuns:
    def test_they_are_counted_under_a_label_of_their_own(self, failing):
        found = clunk_api.tolerance_map(failing)
        assert 0 < found.failed < 48
        assert np.all((found.status == Status.EVENT_BUFFER_FULL) == (found.runs[:, -1] > 0))
        for k in range(3):
            same_as_single_runs(found, failing, (k,))

    def test_probabilities_are_of_the_others_and_pictures_say_so(self, failing):
        found = clunk_api.tolerance_map(failing)
        crossing = ["DS" in label for label in found.labels]
        finished = found.runs[:, :-1].sum(axis=-1)
        shares = quantity_of("double_sided", found).of_runs(found)
        assert shares == pytest.approx(found.runs[:, :-1][:, crossing].sum(axis=-1) / finished)
        assert found.certainty == pytest.approx(found.runs[:, :-1].max(axis=-1) / finished)
        (caveat,) = found.caveats
        assert "maps show the other runs" in caveat
        titles = [ax.get_title(loc="left") for ax in clunk_api.draw(found).axes]
        assert any(caveat in " ".join(title.split()) for title in titles)

    def test_the_command_says_where_and_exits_with_3(self, failing, command, here):
        (here / "failing.toml").write_text(to_toml(failing))
        code, out, err = command("sweep", "failing.toml", "-o", "map.h5")
        assert code == 3
        assert "of 48 runs, in" in out
        assert "failed for some draws: more events" in " ".join(err.split())
        code, _, err = command("sweep", "failing.toml", "-o", "map.h5")
        assert code == 3
        assert "already complete" in err


class TestTiles:
    def test_results_are_the_same_bits_for_any_number_of_workers_and_any_tiles(self, found, toleranced, monkeypatch):
        assert equal(found, clunk_api.tolerance_map(toleranced, workers=1))
        for runs in (1, 150, 900):
            monkeypatch.setattr(tolerances, "_TILE_RUNS", runs)
            assert equal(found, clunk_api.tolerance_map(toleranced, workers=3))

    def test_a_stopped_sweep_goes_on_where_it_was(self, found, toleranced, tmp_path, monkeypatch):
        monkeypatch.setattr(tolerances, "_TILE_RUNS", 160)
        for name in ("_PART", "_SHARE"):
            monkeypatch.setattr(keeping, name, 0.0)

        def stop(done, _total):
            if done >= 50:
                raise KeyboardInterrupt

        with WorkingDirectory(tmp_path / "map.h5") as directory:
            first = Job(toleranced, directory=directory)
            with pytest.raises(KeyboardInterrupt):
                first.run(progress=stop)
            assert 50 <= first.parts.kept < 147
            with pytest.raises(PartsError, match="another config"):
                _ = Job(nominal(toleranced), directory=directory).parts
            second = Job(toleranced, directory=directory)
            again = second.run()
            assert 50 <= second.parts.taken_up < 147
            monkeypatch.setattr(tolerances, "_TILE_RUNS", 1)
            third = Job(toleranced, directory=directory)
            assert equal(found, third.run())  # nothing is left to run
            assert third.parts.taken_up == 147
            directory.remove()
        assert equal(found, again)


@pytest.fixture(scope="module")
def path(found, tmp_path_factory):
    path = tmp_path_factory.mktemp("file") / "map.h5"
    store.write_results(path, found)
    return path


class TestFile:
    def test_what_was_written_is_read(self, found, path):
        again = store.read_map(path)
        assert equal(found, again)
        assert again.config == found.config
        for one, other in zip((*found.axes, *found.sample), (*again.axes, *again.sample), strict=True):
            assert (one.parameter, one.name, one.symbol, one.unit) == (
                other.parameter,
                other.name,
                other.symbol,
                other.unit,
            )
            assert np.array_equal(one.values, other.values)

    def test_xarray_finds_labels_by_their_name(self, found, path):
        with xarray.open_dataset(path, engine="h5netcdf") as data:
            assert data["probability"].dims == ("load_ratio", "lash_backlash_deg", "label")
            assert np.array_equal(
                data["probability"].sel(label="DS(2)"), found.probability[..., found.labels.index("DS(2)")]
            )
            assert np.all(data["probability"].sum("label") == 1.0)
            assert np.array_equal(data["sequence"], found.sequence)
            assert data["sequence"].attrs["flag_meanings"].split()[:2] == list(found.labels[:2])
            median = data["severity_quantiles"].sel(quantile=0.5)
            assert np.array_equal(median, found.severity_quantiles[..., 1])
            assert np.array_equal(data["drawn_driveline_inertias_4"], found.sample[1].values)
            assert data["drawn_driveline_inertias_4"].dims == ("draw",)
            for name, variable in data.variables.items():
                assert "long_name" in variable.attrs, name

    def test_it_is_not_read_as_a_regime_map(self, path):
        with pytest.raises(StoreError, match="holds a tolerance map, where a regime map is needed"):
            read_results(path)


def test_the_first_tile_has_one_cell_as_nobody_knows_how_long_its_draws_take():
    """An interrupt within the first seconds of a slow map finds cells that are done."""
    grid = tolerances.SampleGrid(study(tolerance("lash.contact.stiffness")))
    tiles = run_tiles(grid, np.arange(grid.design.cells), engine_of(None, 1))
    assert next(tiles).cells.size == 1
    assert grid.pace[0] < 1.0
    tiles.close()


class TestCommands:
    @pytest.fixture
    def config(self, here):
        text = (
            DRIVELINE + AXES.replace("21", "11") + "[sweep.sampling]\ncount = 8\n" + tolerance("lash.backlash_deg", 0.1)
        )
        (here / "small.toml").write_text(text)
        return "small.toml"

    def test_sweep_info_plot_and_simulate(self, config, command, here):
        code, out, err = command("sweep", config)
        assert code == 0
        assert "77 cells x 8 draws in" in err
        assert "no label has 95% of the 8 draws" in " ".join(out.split())
        assert all(len(line) <= 80 for line in (out + err).splitlines())
        code, again, err = command("sweep", config)
        assert (code, again) == (0, out)
        assert "already complete" in err
        code, shown, _ = command("info", "results/small.h5", "--check")
        assert code == 0
        assert re.search("drawn +backlash: factor on its nominal value", shown)
        assert shown.endswith(out)
        code, shown, _ = command("info", "results/small.h5", "--json")
        assert '"uncertain_cells"' in shown
        code, shown, _ = command("plot", "results/small.h5")
        assert [line.rsplit("-", 1)[1] for line in shown.split()] == ["regimes.png", "double_sided.png", "severity.png"]
        assert (here / "results" / "small-regimes.png").exists()
        code, shown, _ = command("plot", "results/small.h5", "--at", "lash.backlash_deg=6.5", "-o", "slice.png")
        assert (code, shown) == (0, "slice-severity.png\n")
        code, shown, err = command(
            "simulate", "results/small.h5", "--at", "load.ratio=5", "--at", "lash.backlash_deg=6.5"
        )
        assert "DS(1)SS(1)" in shown
        assert "this is the nominal run" in err

    @pytest.mark.parametrize(
        ("arguments", "sentence"),
        [
            (("plot", "small.h5", "--x", "load.ratio"), "x and y are for axes that are walked together"),
            (("compare", "small.h5", "small.h5"), "small.h5 holds a tolerance map, where a regime map is needed"),
            (("plot", "small.h5", "--quantity", "touches"), 'There is no quantity "touches" here; there are label'),
        ],
    )
    def test_what_does_not_go_is_a_sentence(self, config, command, found, arguments, sentence):
        store.write_results("small.h5", found)
        code, out, err = command(*arguments)
        assert (code, out) == (2, "")
        assert sentence in " ".join(err.split())

    def test_each_function_refuses_the_other_ones_study(self, toleranced):
        with pytest.raises(ClunkError, match=r"clunk\.tolerance_map runs it"):
            sweep(toleranced)
        with pytest.raises(ClunkError, match=r"clunk\.sweep runs it"):
            clunk_api.tolerance_map(nominal(toleranced))
        with pytest.raises(ClunkError, match="nothing to sweep"):
            clunk_api.tolerance_map(study(tolerance("lash.backlash_deg"), axes=""))


def test_a_file_is_written_and_then_read_instead_of_run(toleranced, found, tmp_path):
    told = []
    for cells in ([147], []):
        again = clunk_api.tolerance_map(toleranced, tmp_path / "map.h5", progress=lambda done, _: told.append(done))
        assert told[-1:] == cells
        assert equal(again, found)
        told.clear()
    data = clunk_api.open_results(tmp_path / "map.h5")
    assert np.array_equal(data["most_likely_label"], np.array([*found.labels, "failed"])[found.sequence])


class TestFigures:
    def test_a_certain_cell_has_its_label_s_colour_and_an_uncertain_one_is_paler(self, found, tmp_path):
        """Within NI, and at the cell that is least certain of all."""
        figure = plot.draw(found, "regimes")
        save(figure, tmp_path / "map.png")
        ax = figure.axes[0]
        image = np.asarray(figure.canvas.buffer_rgba())[..., :3] / 255.0

        def colour(at):
            x, y = ax.transData.transform([axis.values[k] for axis, k in zip(found.axes, at, strict=True)])
            return image[len(image) - 1 - int(y), int(x)]

        certain = (1, 3)
        assert found.certainty[certain] == 1.0
        assert colour(certain) == pytest.approx(to_rgb(colour_of(found.labels[found.sequence[certain]])), abs=0.02)
        least = np.unravel_index(np.argmin(found.certainty[1:-1, 1:-1]), (19, 5))
        least = (least[0] + 1, least[1] + 1)
        own = np.array(to_rgb(colour_of(found.labels[found.sequence[least]])))
        assert np.sum(1.0 - colour(least)) < 0.6 * np.sum(1.0 - own)
        notes = [text.get_text() for text in figure.legends[0].get_texts()]
        assert f"paler: less than 95 % likely, {found.uncertain} cells" in notes
        strip = plot.draw(found.at({found.axes[1].parameter: found.axes[1].values[least[1]]}), "regimes")
        cells = strip.axes[0].collections[0].get_array()[0]
        np.testing.assert_allclose(cells[least[0]] / 255.0, colour(least), atol=0.02)  # 8 bits, and edges smoothed

    def test_of_grouped_labels_the_likeliest_group_is_shown_and_by_how_much(self, found):
        layers = Layers.of(found, View.of(found), most=1)
        groups = np.array([-1 if name == "NI" else double_sided(name) for name in found.labels])
        likely = np.stack([found.runs[..., :-1][..., groups == each].sum(axis=-1) for each in np.unique(groups)])
        assert np.array_equal(layers.codes, likely.argmax(axis=0))
        uncertain = np.count_nonzero(likely.max(axis=0) < 0.95 * found.runs[..., :-1].sum(axis=-1))
        assert 0 < uncertain < found.uncertain
        assert [note.text for note in layers.notes] == [f"paler: less than 95 % likely, {uncertain} cells"]

    def test_over_a_quantity_lines_are_drawn_between_the_likeliest_groups(self, found):
        one, two, other = map(found.labels.index, ["DS(1)", "DS(1)SS(1)", "NI"])
        probability, sequence = found.probability.copy(), found.sequence.copy()
        probability[0, 0], sequence[0, 0] = 0.0, other
        probability[0, 0, [one, two, other]] = 0.3, 0.3, 0.4  # the likeliest label is not in the likeliest group
        split = with_arrays(found, probability=probability, sequence=sequence)
        layers = Layers.of(split, View.of(split), "severity", most=1)
        assert layers.names[layers.codes[0, 0]] == "1 double-sided"
        assert np.array_equal(layers.codes, Layers.of(split, View.of(split), most=1).codes)

    def test_under_the_restitution_model_there_is_no_severity_to_draw(self):
        base = DRIVELINE + '[lash.contact]\nmodel = "restitution"\n'
        found = clunk_api.tolerance_map(
            study(tolerance("lash.backlash_deg"), axes=AXES.replace("21", "3"), count=2, base=base)
        )
        assert plot.default_quantities(found) == ["regimes", "double_sided"]
        with pytest.raises(PlotError, match="no severity to draw"):
            plot.draw(found, "severity")
        assert plot.draw(found.at({"lash.backlash_deg": 9.5}), "double_sided").axes
