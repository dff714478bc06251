"""Sweeps: the report's map, the same bits for any number of workers, and every cell a single run."""

import h5py
import numpy as np
import pytest
from helpers.maps import CELL_QUANTITIES, IMPACT_QUANTITIES
from helpers.studies import random_study

from clunk.core.status import QUALITY_UNDECIDED, Status
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import replace_values
from clunk.sweeping.cells import compiling_note, warm_up
from clunk.sweeping.sweep import sweep

# in the order of their codes: by the number of primary impacts and then the label, whichever cell finished first
TOLERANCE = 1e-4  # of a margin
FIGURE_3_4 = ("NI", "SS(1)", "DS(1)", "SS(2)", "DS(1)SS(1)", "DS(1)SS(2)", "DS(2)", "DS(2)SS(1)", "DS(3)")


def study(*axes, preset="boere-2008", separation="gap", step=1e-4):
    text = f"""
    [driveline]
    preset = "{preset}"
    [lash.contact]
    separation = "{separation}"
    [solver]
    step = {step}
    """
    for parameter, values in axes:
        text += f'[[sweep.axes]]\nparameter = "{parameter}"\nvalues = {[float(v) for v in values]}\n'
    return study_from_text(text)


def figure_3_4(count, **options):
    return study(
        ("load.ratio", np.linspace(0.0, 10.0, count)), ("lash.backlash_deg", np.linspace(0.0, 20.0, count)), **options
    )


def digest_of(path):
    """The digest of the data in a results file."""
    with h5py.File(path) as file:
        return file.attrs["content_digest"].decode()


def regimes(results):
    """Each cell's label."""
    return np.array([*results.labels, "failed"])[results.sequence]


def equal(one, other):
    """Whether two results agree to the last bit; NaN equals NaN."""
    return one.labels == other.labels and all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=name not in ("sequence",))
        for name in [*CELL_QUANTITIES, *IMPACT_QUANTITIES]
    )


def same_as_single_run(results, at, study_of_cell):
    """Whether a cell holds what `simulate` finds at its parameters, to the last bit."""
    trajectory = simulate(study_of_cell)
    cell = np.ravel_multi_index(at, results.shape)
    mine = slice(results.first_impact[cell], results.first_impact[cell + 1])
    assert regimes(results)[at] == trajectory.label
    assert results.severity[at] == trajectory.severity
    assert results.approach_velocity[at] == trajectory.approach_velocity
    assert results.touches[at] == trajectory.touches
    assert results.initial_side[at] == trajectory.initial_side
    assert bool(results.quality[at] & 1) == trajectory.complete
    assert np.array_equal(results.impact_time[mine], trajectory.events["time"][trajectory.primaries])
    assert np.array_equal(results.impact_flank[mine], trajectory.flanks)
    assert np.array_equal(results.impact_closing_speed[mine], np.abs(trajectory.events["speed"][trajectory.primaries]))
    assert np.array_equal(results.impact_severity[mine], trajectory.impact_severity)
    if len(trajectory.events) > 1:
        assert results.last_event_time[at] == trajectory.events["time"][-1]
    else:
        assert np.isnan(results.last_event_time[at])


@pytest.fixture(scope="module")
def figure():
    return sweep(figure_3_4(41))


class TestTheMapOfTheReport:
    def test_labels_are_those_of_figure_3_4_in_order_of_their_impacts(self, figure):
        assert figure.labels == FIGURE_3_4
        assert set(regimes(figure).ravel()) == set(FIGURE_3_4)

    def test_the_inertias_as_printed_give_other_labels(self):
        """Table 2.2 as printed cannot have made Figure 3.4: DS(3)SS(1) and DS(4) appear, which it does not show."""
        labels = set(sweep(figure_3_4(41, preset="boere-2008-as-printed")).labels)
        assert {"DS(3)SS(1)", "DS(4)"} <= labels - set(FIGURE_3_4)

    def test_every_run_is_proved_complete_within_a_second(self, figure):
        """The last event of the whole map is at 0.99 s, and no run has more than 38 events, two for a touch."""
        assert np.all(figure.quality == 1)
        assert np.all(figure.status == Status.OK)
        assert np.nanmax(figure.last_event_time) == pytest.approx(0.99, abs=0.01)
        assert figure.touches.max() <= 19

    def test_the_severest_cell_is_at_16_degrees(self, figure):
        """20374 at σr = 10, φθ = 16°, computed exactly; RK4's own error is 2e-5 of it."""
        at = np.unravel_index(np.argmax(figure.severity), figure.shape)
        assert figure.axes[0].values[at[0]] == 10.0
        assert figure.axes[1].values[at[1]] == pytest.approx(16.0, abs=0.5)
        assert figure.severity[40, 32] == pytest.approx(20374.3, rel=2e-5)

    def test_separation_by_force_has_the_same_labels_and_softer_impacts(self, figure):
        """It moves the boundaries by a cell here and there (under 1 % of the cells); re-arming too early moves 10 %."""
        by_force = sweep(figure_3_4(41, separation="force"))
        assert by_force.labels == FIGURE_3_4
        assert 0 < np.count_nonzero(regimes(figure) != regimes(by_force)) <= 8
        assert by_force.severity.max() == pytest.approx(17355, rel=1e-4)  # exact propagator: 17355.1 at 15.5°

    def test_labels_do_not_depend_on_the_step(self):
        coarse, fine = (sweep(figure_3_4(21, step=step)) for step in (2e-4, 5e-5))
        assert np.array_equal(regimes(coarse), regimes(fine))
        # Q_i of weak impacts carry the most of RK4's error, (hλ)⁵/120 a step: 6e-4 over a contact period at h = 2e-4
        assert coarse.severity == pytest.approx(fine.severity, rel=6e-4)


class TestCells:
    def test_results_are_the_same_bits_for_any_number_of_workers(self):
        """And for any cut into tiles, which depends on that number."""
        one, two, four = (sweep(figure_3_4(17), workers=workers) for workers in (1, 2, 4))
        assert equal(one, two)
        assert equal(one, four)

    def test_the_order_of_the_axes_does_not_matter(self):
        axes = [("driveline.inertias[4]", [0.001, 0.002, 0.02]), ("load.ratio", np.linspace(1.0, 9.0, 9))]
        one, other = sweep(study(*axes)), sweep(study(*axes[::-1]))
        assert one.labels == other.labels
        for name in CELL_QUANTITIES:
            assert np.array_equal(getattr(one, name), getattr(other, name).T, equal_nan=True), name

    @pytest.mark.parametrize(
        "axes",
        [
            [("lash.contact.damping", [0.0, 94.0, 200.0])],
            [("lash.contact.stiffness", [2e5, 4e5])],
            [("lash.radius", [0.05, 0.08])],
            [("driveline.shafts[3].damping", [0.01, 0.1])],
            [("load.static_torque", [-2.0, 0.5])],
            [("impacts.sticking_time", [1e-9, 0.0039, 10.0])],
            [("impacts.acceleration_of", [1.0, 4.0])],
            [("solver.step", [5e-5, 2e-4])],
            [("solver.end_time", [0.15, 0.4, 1.5])],
            [("load.on", [1.0, 3.0])],
            [("driveline.inertias[4]", [0.001, 0.002, 0.02]), ("load.ratio", [2.0, 5.0, 9.0])],
            [("driveline.inertias[1]", [0.02, 0.024, 0.04]), ("driveline.shafts[1].damping", [0.05, 0.1])],
            [("load.ratio", [2.0, 8.0]), ("driveline.inertias[1]", [0.02, 0.03]), ("lash.backlash_deg", [1, 6])],
        ],
        ids=lambda axes: axes[-1][0],
    )
    def test_whatever_is_swept_a_cell_is_a_single_run(self, axes):
        base = study(*axes)
        results = sweep(base, workers=2)
        assert results.shape == tuple(len(values) for _, values in axes)
        for at in np.ndindex(results.shape):
            values = {axis.parameter: axis.values[k] for axis, k in zip(results.axes, at, strict=True)}
            same_as_single_run(results, at, replace_values(base, values))


class TestChaos:
    def test_where_rounding_decides_the_label_cells_are_undecided(self):
        """Of undamped flanks on both sides of two lashes: 4e-15 of the torque makes another label in most cells."""
        base = random_study(9115)
        other = replace_values(base, {"load.initial_torque": (1.0 + 4e-15) * base.load.initial_torque})
        results, others = sweep(base), sweep(other)
        differ = results.label_map != others.label_map
        assert np.count_nonzero(differ) > differ.size / 2
        assert (results.quality[differ.any(axis=-1)] & QUALITY_UNDECIDED).all()
        unflagged = sweep(random_study(9115, "solver.margin_tolerance=0.0"))
        assert not (unflagged.quality & QUALITY_UNDECIDED).any()

    def test_where_numbers_of_inertias_decide_the_label_cells_are_undecided(self):
        """Hundreds of touches of an undamped shaft's lashes: often as many, with the same label but at other times."""
        text = """
        [driveline]
        inertias = [{}]
        [[driveline.shafts]]
        between = [{}]
        ratio = 2.0
        stiffness = 1100.0
        damping = 0.0
        [[driveline.shafts]]
        between = [{}, "ground"]
        damping = 2.0
        [[lash]]
        between = [{}]
        backlash_deg = 0.8
        radius = 0.05
        contact = {{ stiffness = 7.7e7, damping = 57.0, separation = "force" }}
        [[lash]]
        between = [{}]
        backlash_deg = 3.0
        radius = 0.05
        contact = {{ stiffness = 2.9e5, damping = 118.0, separation = "force" }}
        [load]
        on = {}
        initial_torque = 100.0
        final_torque = -20.0
        [solver]
        method = "exact"
        end_time = 1.0
        [[sweep.axes]]
        parameter = "load.initial_torque"
        start = 60.0
        stop = 140.0
        count = 81
        """
        one, other = (
            sweep(study_from_text(text.format(*numbers)))
            for numbers in (
                ("0.13, 0.0086, 0.12, 67.0", "1, 2", 4, "2, 3", "3, 4", 1),
                ("67.0, 0.12, 0.0086, 0.13", "4, 3", 1, "3, 2", "2, 1", 4),
            )
        )
        differ = one.label_map != other.label_map
        assert differ.any()
        assert ((one.quality | other.quality)[differ] & QUALITY_UNDECIDED).all()

    def test_many_touches_that_damping_makes_forgotten_are_decided_by_the_margin(self):
        """Each touch keeps 0.9 of the speed, hundreds of them none."""
        text = f"""
        [driveline]
        preset = "boere-2008"
        [lash.contact]
        model = "restitution"
        restitution = 0.9
        [solver]
        method = "exact"
        margin_tolerance = {TOLERANCE}
        [[sweep.axes]]
        parameter = "load.ratio"
        values = [1.0, 3.0, 5.0, 7.0, 9.0]
        """
        results = sweep(study_from_text(text))
        assert results.touches.max() > 100
        is_undecided = results.quality & QUALITY_UNDECIDED != 0
        assert is_undecided.tolist() == (np.abs(results.margin) < TOLERANCE).tolist()


class TestFailedCells:
    @pytest.mark.parametrize(
        ("parameter", "values", "status", "labels"),
        [
            # σr = -1 leaves no torque before the step
            (
                "load.ratio",
                [-2.0, -1.0, 0.0, 5.0],
                [Status.OK, Status.NO_INITIAL_FLANK, Status.OK, Status.OK],
                ["OS(1)CR(1)", "failed", "NI", "DS(1)SS(1)"],
            ),
            (
                "solver.step",
                [1e-4, 2e-3, 2e-4, 0.1],  # the last grows beyond double precision within 64 steps
                [Status.OK, Status.UNSTABLE_STEP, Status.OK, Status.UNSTABLE_STEP],
                ["DS(1)SS(1)", "failed", "DS(1)SS(1)", "failed"],
            ),
            (
                "load.ratio",
                [1.0, 5.0, 2.0],
                [Status.OK, Status.EVENT_BUFFER_FULL, Status.OK],
                ["NI", "failed", "SS(1)"],
            ),
            # ended in the middle of something, which is no failure
            ("solver.end_time", [0.15, 2.0], [Status.OK, Status.OK], ["CR(1)", "DS(1)SS(1)"]),
        ],
        ids=["no initial flank", "unstable step", "many events", "cut off"],
    )
    def test_a_cell_fails_alone_and_has_no_numbers(self, parameter, values, status, labels):
        base, few = study((parameter, values)), Status.EVENT_BUFFER_FULL in status
        solver = base.solver.model_copy(update={"max_events": 10} if few else {})
        results = sweep(base.model_copy(update={"solver": solver}))
        assert list(results.status) == status
        assert list(regimes(results)) == labels
        failed = results.status != Status.OK
        assert np.array_equal(np.isnan(results.severity), failed)
        for counts in (results.primary_impacts, results.touches, results.quality):
            assert not counts[failed].any()
        assert np.array_equal(results.quality == 1, ~failed & (np.array(labels) != "CR(1)"))

    def test_a_sweep_in_which_no_cell_can_run_is_refused(self):
        with pytest.raises(ClunkError, match="No cell can run"):
            sweep(figure_3_4(3, step=2e-3))

    def test_without_axes_there_is_nothing_to_sweep(self, nominal):
        with pytest.raises(ClunkError, match="nothing to sweep"):
            sweep(nominal)


@pytest.mark.parametrize("method", ["rk4", "exact"])
def test_a_kernel_that_is_compiled_is_not_announced_again(method):
    study = study_from_text(f'[driveline]\npreset = "boere-2008"\n[solver]\nmethod = "{method}"\n')
    warm_up(study)
    assert compiling_note(study) == ""
