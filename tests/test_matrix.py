"""Every study by every command: random drivelines and all shipped configs, by both methods.

pytest -m slow tests/test_matrix.py       1,000 random studies in the place of 40
"""

import tomllib
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pytest
import tomli_w
from helpers.maps import CELL_QUANTITIES
from helpers.studies import random_study

import clunk
from clunk.analysis.comparison import METHODS
from clunk.core.status import Status
from clunk.simulation.energy import balance
from clunk.study.config import study_from_text
from clunk.study.rules import count_of_regimes
from clunk.study.study import replace_values, to_toml
from clunk.study.sweeps import Axis
from clunk.sweeping.cells import MANY_TOUCHES

CONFIGS = sorted((Path(__file__).parent.parent / "configs").glob("*.toml"))
ENERGY = {"exact": 1e-9, "rk4": 1e-3}  # of the largest term: exact to rounding, rk4 as its step is
REFINEMENTS = (4, 16, 64)  # of rk4's step, where labels differ
LAST_EVENT = 1e-5  # s, to which the last event's time is the same where rk4 has converged
TOO_LARGE = (586, 920, 985)  # of more regimes than a config may have
REFUSED = ("no steady motion before the load step",)  # what a study may be refused for
MOST_REGIMES = 30  # of a driveline whose parameters are fitted
RUNS_OF_A_CELL = 20_000  # of a search for thresholds, at most
DRAWN = '[[sweep.tolerances]]\nparameter = "{}"\ndistribution = "normal"\ndraws = "factor"\nstd = 0.01\n'
FITTED = """
[fit]
candidates = 16
draws = 64
effective_draws = 4
[[fit.parameters]]
parameter = "solver.end_time"
distribution = "uniform"
draws = "factor"
low = 0.9
high = 1.1
"""

STUDIES = [
    *(pytest.param(path, id=path.stem) for path in CONFIGS),
    *range(40),
    *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(40, 1000) if seed not in TOO_LARGE),
]


class Ran(NamedTuple):
    """A study of few cells, by rk4 and by exact; `refusal` is why it could not run, and then there is no comparison."""

    study: clunk.Study
    comparison: clunk.Comparison | None
    refusal: str

    @property
    def maps(self):
        """Results by the method."""
        return dict(zip(METHODS, self.comparison.maps, strict=True))


def with_method(study, method):
    return study.but(solver=study.solver.but(method=method))


def shipped(path):
    """A shipped config with three values an axis, and as few draws."""
    study = clunk.load_study(path)
    if study.sweep is None:
        return clunk.load_study(path, ["sweep.axes=[{parameter='lash.backlash_deg', values=[2.0, 6.0]}]"])
    few = [f"sweep.axes[{k}].count=3" for k, axis in enumerate(study.sweep.axes, 1) if axis.values is None]
    few += ["sweep.sampling.count=8"] if study.swept.tolerances else []
    return clunk.load_study(path, few)


@pytest.fixture(scope="module", params=STUDIES)
def ran(request):
    study = random_study(request.param) if isinstance(request.param, int) else shipped(request.param)
    try:
        return Ran(study, clunk.verify(study, workers=1), "")
    except clunk.ClunkError as refusal:
        return Ran(study, None, str(refusal))


@pytest.fixture
def verified(ran):
    """A study that is not refused."""
    if ran.comparison is None:
        pytest.skip("refused, as another test looks at")
    return ran


def test_a_study_runs_or_is_refused_in_a_sentence(ran):
    if ran.comparison is None:
        assert any(reason in ran.refusal for reason in REFUSED), ran.refusal
        assert ran.refusal.endswith(".")


def test_no_cell_fails(verified):
    for results in verified.maps.values():
        assert {Status(code).name for code in np.unique(results.status)} == {"OK"}


def test_labels_of_the_methods_differ_in_flagged_cells_only(verified):
    """Where rk4 has converged: once two step sizes agree in a run's label and last event, its label is exact's.

    Of a thousand touches of undamped flanks each magnifies an error, from rounding to the size of the gap: there is no
    step at which rk4 converges.
    """
    cells = [cell for cell in verified.comparison.differing_cells if not cell.flagged]
    names = list(verified.study.lash_names)
    before = [None] * len(cells)
    for refinement in REFINEMENTS:
        if not cells:
            break
        points = {key: [cell.at[key] for cell in cells] for key in cells[0].at if key != "lash"}
        finer = {"solver.step": verified.study.solver.step / refinement}
        runs = clunk.run_points(replace_values(with_method(verified.study, "rk4"), finer), points, workers=1)
        lash = [names.index(cell.at["lash"]) for cell in cells] if len(names) > 1 else None
        at = np.arange(len(cells)) if lash is None else (np.arange(len(cells)), lash)
        last = np.round(runs.last_event_time[at] / LAST_EVENT).tolist()
        outcomes = list(zip(runs.label_map[at].tolist(), last, strict=True))
        for cell, outcome, earlier in zip(cells, outcomes, before, strict=True):
            assert outcome[0] == cell.b or outcome != earlier, f"{cell}, by steps of a {refinement}th"
        left = [k for k, (cell, outcome) in enumerate(zip(cells, outcomes, strict=True)) if outcome[0] != cell.b]
        cells, before = [cells[k] for k in left], [outcomes[k] for k in left]


def test_the_energy_of_its_nominal_run_closes(verified):
    """By one method or the other: with a run of either it takes as long as all runs of its map."""
    method = METHODS[_turn(verified.study, len(METHODS))]
    energy = balance(clunk.simulate(with_method(verified.study, method)))
    assert abs(energy.residual) <= ENERGY[method] * energy.largest + 1e-20  # J, where nothing moves at all


def mirrored(study):
    """The study under the load with the other sign, whose staged shafts have their stages the other way round."""
    table = tomllib.loads(to_toml(study.model_copy(update={"sweep": None, "fit": None, "optimize": None})))
    load = table["load"]
    for key in {"initial_torque", "final_torque", "static_torque", "amplitude"} & set(load):
        load[key] = -load[key]
    if "torques" in load:
        load["torques"] = [-torque for torque in load["torques"]]
    for shaft in table["driveline"].get("shafts", []):
        if "breakpoints_deg" in shaft:
            shaft["stiffness"] = shaft["stiffness"][::-1]
            shaft["breakpoints_deg"] = [-twist for twist in shaft["breakpoints_deg"][::-1]]
    return clunk.study_from_text(tomli_w.dumps(table))


@pytest.mark.parametrize("method", METHODS)
def test_a_mirrored_load_swaps_the_flanks_and_changes_nothing_else(verified, method):
    """Of a dozen events, after which touches may have magnified the rounding of angles."""
    study = with_method(verified.study, method)
    one, other = clunk.simulate(study), clunk.simulate(mirrored(study))
    assert other.initial_sides.tolist() == [-side for side in one.initial_sides]
    count = min(len(one.events), 12)
    assert other.events["kind"][:count].tolist() == one.events["kind"][:count].tolist()
    assert other.events["side"][:count].tolist() == (-one.events["side"][:count]).tolist()
    assert other.events["time"][:count] == pytest.approx(one.events["time"][:count], abs=1e-9)


def test_its_results_file_has_the_same_bits(verified, tmp_path):
    for results in verified.maps.values():
        clunk.write_results(tmp_path / "map.h5", results)
        read = clunk.read_results(tmp_path / "map.h5")
        assert (read.labels, read.axes[0].parameter) == (results.labels, results.axes[0].parameter)
        for name in results.arrays:
            np.testing.assert_array_equal(read.arrays[name], results.arrays[name], strict=True)


def test_single_runs_are_those_of_its_cells(verified):
    """A run alone is the cell's, to the last bit: the one in the middle of the grid, by its values."""
    for method, results in verified.maps.items():
        of_lash = results.of_lash()
        number = of_lash.sequence.size // 2
        at = np.unravel_index(number, of_lash.sequence.shape)
        points = {each.parameter: float(np.broadcast_to(grid, of_lash.shape)[at]) for each, grid in _values(of_lash)}
        runs = clunk.run_points(
            with_method(verified.study, method), {key: [value] for key, value in points.items()}, workers=1
        )
        alone = clunk.simulate(replace_values(with_method(verified.study, method), points))
        assert runs.of_lash().label_map[0] == of_lash.label_map[at] == alone.label
        for name in CELL_QUANTITIES.keys() - {"sequence"}:
            assert getattr(runs.of_lash(), name)[0].tobytes() == getattr(of_lash, name)[at].tobytes(), name


def _values(results):
    """Each parameter of a map with its values, in a shape that broadcasts to the map's."""
    for k, axis in enumerate(results.axes):
        of_axis = results.coordinates if axis.parameter == "run" else (axis,)
        for each in of_axis:
            yield each, each.values.reshape([-1 if j == k else 1 for j in range(len(results.axes))])


def test_thresholds_are_where_labels_change(verified):
    """By every fifth study, between two values of the first axis: runs at either end of what a threshold may be off by.

    Where the least change of a value changes the label, rounding of the ends may do so: twice in a hundred at most, but
    for runs of so many touches that a sweep repeats them, by which it may be magnified to the size of the gap.
    """
    study = with_method(verified.study, "exact")
    results = verified.maps["exact"].of_lash()
    if _turn(study) != 1 or study.swept.tolerances or results.coordinates or len(results.axes) < 2:
        pytest.skip("another one's turn, or no grid of nominal drivelines")
    axes = [each for each in results.axes if each.parameter != "lash"]
    few = [each.values[: 1 if k else 2].tolist() for k, each in enumerate(axes)]
    only = [Axis(parameter=each.parameter, values=tuple(part)) for each, part in zip(axes, few, strict=True)]
    study = study.but(sweep=study.sweep.but(axes=tuple(only)))
    found = clunk.thresholds(study, along=results.axes[0].parameter, workers=1)
    assert found.runs <= RUNS_OF_A_CELL * found.lowest.size
    at = [found.at(cell) for cell in found.cell.tolist()]
    for codes, sign in ((found.below, -1.0), (found.above, 1.0)):
        if at:
            points = {key: [each[key] for each in at] for key in at[0]}
            points[found.along.parameter] = found.value + sign * found.off
            runs = clunk.run_points(study, points, workers=1)
            few = runs.touches.reshape(len(at), -1).sum(axis=1) < MANY_TOUCHES
            told = np.array([found.word(code) for code in codes.tolist()])
            assert np.count_nonzero((runs.of_lash().label_map != told) & few) <= max(1, 0.02 * few.sum())


def test_a_sensitivity_is_of_its_nominal_run_and_a_fit_of_its_own_labels_meets_them(verified, tmp_path):
    """Every fifth study: its numbers drawn around their values, and labels of its map, as if they were measured.

    Those of every third cell: with all of them, a fit takes three times as long.
    """
    study, results = with_method(verified.study, "exact"), verified.maps["exact"].of_lash()
    many = count_of_regimes(study) > MOST_REGIMES
    if _turn(study) != 3 or study.swept.tolerances or len(results.axes) < 2 or many:
        pytest.skip("another one's turn, or more regimes than a thousand drivelines are prepared with at once")
    keys = [axis.parameter for axis in results.axes]
    drawn = "".join(DRAWN.format(key) for key in keys)
    text = to_toml(study.model_copy(update={"sweep": None}))
    around = study_from_text(f"{text}\n[sweep]\nsampling = {{ count = 16 }}\n{drawn}")
    sensitivity = clunk.sensitivity(around, workers=1)
    assert sensitivity.label == clunk.simulate(study.model_copy(update={"sweep": None})).label
    assert sensitivity.runs == 16 * (len(keys) + 2)
    grid = np.meshgrid(*(axis.values for axis in results.axes), indexing="ij")
    rows = [*zip(*(each.ravel()[::3].tolist() for each in (*grid, results.label_map)), strict=True)]
    lines = [",".join([*keys, "label"]), *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "measured.csv").write_text("\n".join(lines), encoding="utf-8")
    fitted = clunk.fit(study_from_text(f"{text}\n{FITTED}"), tmp_path / "measured.csv", workers=1)
    assert fitted.met_by_config == len(rows)
    assert fitted.met > 0


COMMANDS = (
    ("plot", "map.h5", "-o", "map.svg"),
    ("info", "map.h5", "--check"),
    ("simulate", "study.toml", "-o", "run.png"),
    ("modes", "study.toml"),
    ("report", "map.h5", "-o", "page.html"),
    ("export", "map.h5", "map.csv"),
    ("verify", "study.toml"),
    ("compare", "map.h5", "map.h5"),
    ("simulate", "study.toml", "--set", "solver.end_time=0.2", "-o", "run.csv"),  # a row for each step
)
OF_MAPS_OF_TWO_AXES = ("plot", "report")  # of more axes a picture is a slice, which the user chooses


def test_commands_answer(ran, here, command):
    """A command by each study: it does what it says, or refuses in a sentence."""
    (here / "study.toml").write_text(to_toml(ran.study), encoding="utf-8")
    if ran.comparison is None:
        code, _, errors = command("sweep", "study.toml", "-o", "map.h5")
        assert code == 2
        assert "Traceback" not in errors
        return
    if ran.study.swept.tolerances:
        code, output, errors = command("sweep", "study.toml", "-o", "map.h5")
        assert code == 0, errors
    else:
        clunk.write_results("map.h5", ran.maps["exact"])
    words = COMMANDS[_turn(ran.study, len(COMMANDS))]
    if words[0] in OF_MAPS_OF_TWO_AXES and len(ran.maps["exact"].of_lash().axes) > 2:
        return
    code, output, errors = command(*words)
    plt.close("all")
    agrees = words[0] != "verify" or not ran.comparison.differing_elsewhere
    assert code == (0 if agrees else 4), f"{words}\n{errors}"
    assert output or Path(words[-1]).stat().st_size, words


def _turn(study, of=5):
    """A number of a study, below `of`: one in so many has the same."""
    return sum(map(ord, study.title)) % of
