"""The bounds that the exact method rests on, and runs of drivelines with modes, drifts and flows without an eigenbasis.

Every case is a driveline with its open and its closed side. Each lane has a state of its own.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import margins, reference
from helpers.starts import started
from numpy.polynomial.polynomial import polyval
from scipy.linalg import expm

import clunk
from clunk.core.exact import curves, moving, taylor
from clunk.core.exact.flows import CROSS, PAIRS, SPANS, TERMS
from clunk.core.jit import compiled
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import WIDTH
from clunk.core.tables import ACCELERATION, INPUTS, TORQUE_RATE
from clunk.simulation.batches import of_system, prepare_one
from clunk.simulation.driveline import Driveline
from clunk.simulation.energy import balance
from clunk.simulation.system import prepare

# Rounding of a few products of tables that are each good to some 1e-15, and a modal basis to its condition (up to 1e4).
TIGHT = 1e-11
OPEN, CLOSED = 0, 1
CONFIGS = Path(__file__).parent.parent / "configs"
BRAKED = """
driveline = {inertias = [0.024, 0.002, 0.002, 0.002], shafts = [
    {between = [1, 2], stiffness = 31.3, damping = 0.08},
    {between = [2, 3], stiffness = 31.3, damping = 0.04},
    {between = [4, "ground"], damping = 0.1},
]}
lash = {between = [3, 4], backlash_deg = 6.0, radius = 0.08, contact = {stiffness = 4.092e5, damping = 94.0}}
load = {initial_torque = -6.0, final_torque = 1.0}
solver = {method = "exact", end_time = 2.0}
"""


@compiled
def measure(work, size, amplitudes):
    moving.measure(work, size, amplitudes)


@compiled
def jump(propagated, work, size):
    moving.move_modes(propagated, False, vectors.splat(0.0), work, size)


@compiled
def bound(watch, work, amplitudes, size, results):
    seen, sway = curves.evaluate(watch, work, amplitudes, size)
    vectors.store(results, 0, (seen.third_bound, seen.sixth_bound, sway))


@compiled
def find_low(guard, h, results):
    vectors.store(results, 0, curves.low(curves.load_curve(guard, 0), vectors.load(h, 0)))
    vectors.store(results, 1, curves.guess(curves.load_curve(guard, 0), vectors.load(h, 0)))


@compiled
def find_first_zero(c, part, results):
    crosses, s, _, _, known = taylor.first_zero(c, -1, vectors.load(part, 0))
    vectors.store(results, 0, s)
    vectors.store(results, 1, known)
    return crosses


def test_a_decay_much_faster_than_what_lasts_is_alone_in_its_pair():
    """A stiff damper makes one of 4e5/s, and beside it one of 0.08/s, which would be bounded by the rate of both."""
    plant = reference.boere(5.0, 6.0)
    first, second, *others = plant.shafts
    study = reference.study_of(replace(plant, shafts=(first, (*second[:3], 400.0), *others)))
    _, flows = prepare(study, Driveline.from_study(study))
    assert flows.modal.all()
    rates = np.abs(np.diagonal(flows.generator, axis1=-2, axis2=-1)).reshape(-1, 2, PAIRS)
    slower, faster = rates.min(axis=1), rates.max(axis=1)
    assert (faster[slower > 0.0] < 1e3 * slower[slower > 0.0]).all()
    assert faster.max() > 1e3 * slower[slower > 0.0].min()


def test_spans_reach_the_end_of_a_run_however_fast_a_part_is_braked():
    study = clunk.load_study(CONFIGS / "nominal.toml", ["driveline.shafts[4].damping=1e8", 'solver.method="exact"'])
    assert (prepare_one(of_system(study)).tables.span[..., -1] > study.solver.end_time).all()


def test_a_part_that_only_a_bearing_brakes_stands_still_at_last():
    """Its displacement, which lasts, is not bounded by the rate of its speed, of up to 5e8 /s."""
    study = clunk.study_from_text(BRAKED)
    events = [
        clunk.simulate(clunk.replace_values(study, {"driveline.shafts[3].damping": c})).events for c in (1e5, 1e6, 1e7)
    ]
    one, other, last = (each["time"][:20] for each in events)
    assert last == pytest.approx(other, abs=1e-6)
    assert np.abs(one - last).max() == pytest.approx(11.0 * np.abs(other - last).max(), rel=0.05)


def test_parts_that_bearings_brake_fast_and_slowly_have_modes():
    """Of two parts in the open gap one stops within 1e-4 s, the other in 30 s: each displacement has its own size."""
    free = [f"driveline.shafts[{shaft}].stiffness=0" for shaft in (1, 2, 3)]
    dampings = [f"driveline.shafts[{shaft}].damping={c}" for shaft, c in ((1, 0.0), (2, 5.0), (3, 1e-4), (4, 200.0))]
    study = clunk.load_study(CONFIGS / "nominal.toml", ['solver.method="exact"', *free, *dampings])
    assert prepare_one(of_system(study)).tables.modal.all()


TYRES = """
driveline.inertias = [1.2, 0.03, 0.05, 0.03617526747469467, 0.6, 8.0, 5.815442965351766, 4500.0]
driveline.shafts = [
    { between = [1, 2], stiffness = 2291.831180523293, damping = 78.95491894422973 },
    { between = [4, 5], ratio = 3.7, stiffness = 640e3, damping = 50.0 },
    { between = [3, 4], stiffness = 12e3, damping = 393.1468289123689 },
    { between = [5, 6], stiffness = 25e3, damping = 977.6986079972975 },
    { between = [5, 7], stiffness = 25e3, damping = 550.0 },
    { between = [6, 8], stiffness = 1.0e5, damping = 3500.0 },
    { between = [7, 8], stiffness = 1.0e5, damping = 2300.0 },
    { between = [8, "ground"], damping = 200.0 },
]
lash.between = [2, 3]
lash.ratio = 6.5
lash.gap_mm = 0.1
lash.radius = 0.045
lash.contact = { stiffness = 1.9369e11, damping = 5e3 }
load = { profile = "ramp", duration = 0.08, initial_torque = 450.0, final_torque = -64.0 }
solver = { method = "exact", end_time = 0.2 }
"""


@pytest.mark.parametrize("damping", [3400.0, 3460.0, 3500.0, 3550.0, 3600.0])
def test_an_eigenvalue_that_two_guesses_lead_to_is_no_two_beside_a_fast_mode(damping):
    """Beside a contact of 6e5 rad/s they differ by rounding, 5e-12 of them: there were no modes then, 12 s a run."""
    study = clunk.study_from_text(TYRES, overrides=[f"driveline.shafts[6].damping={damping}"])
    assert prepare_one(of_system(study)).tables.modal.all()


@pytest.mark.parametrize("damping", [1e-12, 1e-11, 1e-10, 1e-9, 1e-8])
def test_a_bearing_that_all_but_brakes_nothing_changes_next_to_nothing(damping):
    """The speed that it would allow at last, of up to 1e12 rad/s, is no origin to measure speeds from."""
    study = clunk.load_study(CONFIGS / "nominal.toml", ['solver.method="exact"', "driveline.shafts[4].damping=0"])
    free, braked = map(clunk.simulate, (study, clunk.replace_values(study, {"driveline.shafts[4].damping": damping})))
    # what it takes itself: c t/J of a speed; and the rounding of speeds from where they are steady at last
    assert braked.events["time"] == pytest.approx(free.events["time"], abs=1e-7 + 100.0 * damping)
    assert balance(braked).relative_residual < 1e-7


@pytest.mark.parametrize("inertia", [3e6, 1e8, 1e9])
def test_the_bearings_of_a_heavy_part_drag_what_rolls_with_it_however_slowly_it_is_braked_itself(inertia):
    """Counted as undamped, it carried a share of the torque that its bearing does: 17 % here, and nothing touched."""
    springs = (1, 2, 31.3, 0.08), (2, 3, 31.3, 0.04), (4, 5, 31.3, 0.1)
    shafts, runs = (*springs, (1, "ground", 0.0, 0.1), (4, "ground", 0.0, 0.02)), []
    for heavy in (1e6, inertia):
        plant = reference.Plant((0.024, 0.002, 0.002, 0.002, heavy), shafts, before=-6.0, after=-1.0)
        runs.append(clunk.simulate(reference.study_of(plant, method="exact", end_time=1.0)))
    one, other = (run.events["time"] for run in runs)
    assert other.size == 7
    assert other == pytest.approx(one, abs=3e-7)  # its speed changes by the torque over 1e6 kg m²
    assert balance(runs[1]).relative_residual < 1e-12


STOPPED = """
driveline.inertias = [0.024, 0.002, 0.002, 0.003]
driveline.shafts = [
    { between = [1, 2], stiffness = 31.3, damping = 0.08 },
    { between = [1, "ground"], damping = 0.1 },
    { between = [4, "ground"], stiffness = 31.3, damping = 1e7 },
]
lash = [
    { between = [2, 3], backlash_deg = 6.0, radius = 0.08, contact = { stiffness = 4.092e5, damping = 94.0 } },
    { between = [3, 4], backlash_deg = 3.0, radius = 0.08, contact = { stiffness = 4.092e5, damping = 94.0 } },
]
load = { initial_torque = -6.0, final_torque = 1.0 }
solver = { method = "exact", end_time = 1.0 }
"""


@pytest.mark.parametrize("damping", [1e8, 1e9])
def test_a_spring_whose_rate_rounding_takes_beside_that_of_its_damper_does_not_move(damping):
    """The slow one is 31.3/1e8 1/s, 1e-17 of the fast one: LAPACK has 0 for it, which is no drift.

    It moves by what rounding of the fast rate makes, 7e-6 1/s at 1e8.
    """
    study = clunk.study_from_text(STOPPED)
    runs = [clunk.simulate(clunk.replace_values(study, {"driveline.shafts[3].damping": c})) for c in (1e7, damping)]
    one, other = (run.events["time"] for run in runs)
    assert other == pytest.approx(one, abs=1e-14 * damping)


def sizes(y):
    """(…, C/2, W): the amplitude of each pair."""
    halves = y.reshape(*y.shape[:-2], -1, 2, PAIRS, y.shape[-1])
    return np.hypot(halves[..., 0, :, :], halves[..., 1, :, :]).reshape(*y.shape[:-2], -1, y.shape[-1])


def holds(bits):
    """(W,): of each lane its bit."""
    return np.array([bits >> k & 1 for k in range(WIDTH)], bool)


def plant(inertias, shafts, lash, contact_damping=0.6, **values):
    return reference.Plant(inertias, shafts, lash, contact_damping=contact_damping, **{"acceleration_of": 1, **values})


NOMINAL = reference.Plant()
EIGHT = (0.02, 0.01, 0.005, 0.003, 0.004, 0.01, 0.02, 0.05)
CHAIN = tuple((k, k + 1, 20.0 + 3.0 * k, 0.02) for k in (1, 2, 3, 5, 6, 7))
PLANTS = {
    "nominal": NOMINAL,
    "locked": reference.boere(5.0, 6.0, restitution=0.5),
    "by force": reference.boere(5.0, 6.0, separation="force"),
    "free and undamped when open": plant((0.02, 0.01), ((2, "ground", 30.0, 0.1),), (1, 2)),
    "two free and undamped when open": plant((0.02, 0.01, 0.03), ((2, 3, 30.0, 0.0), (3, "ground", 5.0, 0.1)), (1, 2)),
    "free chain, undamped": plant((0.02, 0.01, 0.03), ((1, 2, 30.0, 0.0), (3, "ground", 5.0, 0.1)), (2, 3)),
    "free chain, damped inside": plant((0.02, 0.01, 0.03), ((1, 2, 30.0, 0.1), (3, "ground", 5.0, 0.1)), (2, 3)),
    "drifting against a damper": plant((0.02, 0.01), ((1, "ground", 0.0, 0.3), (2, "ground", 30.0, 0.1)), (1, 2)),
    "drifting against a weak damper": plant((0.02, 0.01), ((1, "ground", 0.0, 3e-4), (2, "ground", 30.0, 0.1)), (1, 2)),
    "both sides drifting": plant(
        (0.02, 0.01, 0.03), ((1, "ground", 0.0, 0.3), (2, 3, 30.0, 0.2), (3, "ground", 0.0, 0.02)), (1, 2)
    ),
    "both sides free": plant((0.02, 0.01), (), (1, 2)),
    "both sides free, one damped": plant((0.02, 0.01), ((1, "ground", 0.0, 0.3),), (1, 2)),
    "overdamped": plant((0.02, 0.01), ((1, "ground", 2.0, 3.0), (2, "ground", 3.0, 5.0)), (1, 2), 80.0),
    "critically damped": plant((0.02, 0.01), ((1, "ground", 2.0, 0.4), (2, "ground", 3.0, 0.1)), (1, 2)),
    "two inertias": plant((0.02, 0.01), ((1, "ground", 20.0, 0.05), (2, "ground", 30.0, 0.1)), (1, 2)),
    "one inertia, the lash to ground": plant((0.5,), (), (1, "ground")),
    "one inertia on a spring, the lash to ground": plant((0.5,), ((1, "ground", 3.0, 0.0),), (1, "ground"), 0.0),
    "no damping anywhere": plant(
        NOMINAL.inertias, tuple((*shaft[:3], 0.0) for shaft in NOMINAL.shafts), (3, 4), contact_damping=0.0
    ),
    "eight inertias": plant(EIGHT, (*CHAIN, (8, "ground", 20.0, 0.1)), (4, 5)),
    "two alike": plant((0.01, 0.01), ((1, "ground", 20.0, 0.05), (2, "ground", 20.0, 0.05)), (1, 2)),
}  # fmt: skip
for name in ("two inertias", "free chain, undamped", "one inertia on a spring, the lash to ground"):
    PLANTS[f"{name}, locked"] = replace(PLANTS[name], restitution=0.5)


class Flow:
    """One flow's tables, with the affine system that they stand for; of states and inputs, each column is a lane's."""

    def __init__(self, plant, which):
        study = reference.study_of(plant)
        system, flows = prepare(study, Driveline.from_study(study))
        for field in flows._fields:
            setattr(self, field, getattr(flows, field)[0, which])
        self.which, self.system, self.flows = which, system, flows
        self.rates, self.inputs = system.rates[which], system.inputs[which]
        self.functionals, self.feedthrough = system.functionals[which], system.feedthrough[which]
        self.size, self.count = self.coordinates.shape
        self.origin = self.origin.transpose(0, 2, 1)[:, : self.size]
        self.fastest = np.abs(np.linalg.eigvals(self.rates)).max()
        self.pace = max(self.fastest, 1.0)
        # velocities by what makes them as large as angles: the exponential is then scaled, and squared, least
        self.units = np.ones((self.size + INPUTS, 1))
        self.units[self.size // 2 : self.size] = 2.0 ** np.round(np.log2(self.pace))
        self.augmented = np.zeros((self.size + INPUTS, self.size + INPUTS))
        self.augmented[: self.size] = np.hstack((self.rates, self.inputs))
        self.augmented *= self.units.T / self.units
        self.impulsive = bool(system.impulsive)
        self.lash = system.lashes[0, self.size // 2 :]
        self.rolling = system.drift[:, :1]  # (2n, 0 or 1)
        self.first = int(np.argmax(self.rolling != 0.0)) if self.rolling.size else 0

    @property
    def is_modal(self):
        return bool(self.modal)

    def starts(self):
        """(2n, W), (INPUTS, W): random states and inputs, on the constraint, if there is one, and not yet rolled."""
        random = np.random.default_rng(1)
        x, u = random.normal(size=(self.size, WIDTH)), np.zeros((INPUTS, WIDTH))
        u[:TORQUE_RATE] = random.normal(size=(2, WIDTH))
        n = self.size // 2
        x[n:] *= self.pace * 0.1
        if self.impulsive and not np.any(self.rates[n:].T @ self.lash):  # locked: q = s φ/2 and q' = 0
            x[:n] -= np.outer(self.lash, self.lash @ x[:n] - u[1]) / (self.lash @ self.lash)
            x[n:] -= np.outer(self.lash, self.lash @ x[n:]) / (self.lash @ self.lash)
        return self.rolled(x, -x[self.first]), u

    def rolled(self, x, angles):
        """States turned by angles of the first inertia that rolls, (W,)."""
        return x + np.outer(self.rolling[:, 0], angles) if self.rolling.size else x

    def trajectory(self, x, u, length, count=500):
        """(count + 1, 2n, W): the states over a time, evenly spaced."""
        across, z = expm(self.augmented * length / count), [np.vstack((x, u)) / self.units]
        for _ in range(count):
            z.append(across @ z[-1])
        return (self.units * np.array(z))[:, : self.size]

    def apart(self, x):
        """Angles and speeds less what they have rolled by, which stands at the first inertia that rolls."""
        if not self.rolling.size:
            return x
        n, shape = self.size // 2, self.rolling[: self.size // 2]
        first = x.reshape(2, n, -1)[:, self.first, None]
        return (x.reshape(2, n, -1) - first * (shape - np.eye(n)[:, [self.first]])).reshape(x.shape)

    def enter(self, x, u):
        return self.coordinates.T @ (self.apart(x) - self.origin[0] @ u)

    def amplitudes(self, work):
        """(C/2, W), of coordinates."""
        amplitudes = np.zeros((self.count // 2, WIDTH))
        measure(work, self.count, amplitudes)
        return amplitudes

    def jump(self, work, k):
        """Each lane by another span."""
        jump(np.ascontiguousarray(self.propagator[k].reshape(WIDTH, -1).T), work, self.count)

    def bounds(self, f, work):
        """(3, W): of the third and the sixth derivative, and of the value less its origin."""
        results = np.zeros((3, WIDTH))
        bound(self.watch[f], work, self.amplitudes(work), self.count, results)
        return results

    def output(self, x, u):
        """(…, F, W): the functionals."""
        return self.functionals @ x + self.feedthrough @ u

    def output_origin(self, u, times):
        """(4, F, W): the functionals' origins and their derivatives."""
        value, slope, curvature, jerk = self.origin_output @ u
        value = value + times * (slope + 0.5 * times * curvature)
        return np.array([value, slope + times * curvature, curvature, jerk])

    def scale(self, *states):
        """(2n, W): as large as angles and velocities get, the origin included."""
        n = self.size // 2
        together = np.abs(np.array(states))
        return np.repeat([together[:, :n].max(axis=(0, 1)), together[:, n:].max(axis=(0, 1))], n, axis=0)


@pytest.fixture(params=[(name, which) for name in PLANTS for which in (OPEN, CLOSED)], ids=lambda p: f"{p[0]}, {p[1]}")
def flow(request):
    name, which = request.param
    return Flow(PLANTS[name], which)


def drifts(flow):
    """(C/2, 1) whether a pair is a drift, whose displacement has no bound."""
    cross = flow.propagator[SPANS - 1, :, CROSS].reshape(-1, 2, PAIRS)
    return ((cross[:, 0] != 0.0) & (cross[:, 1] == 0.0) & flow.is_modal).reshape(-1, 1)


def test_no_amplitude_grows_over_a_span(flow):
    if not flow.is_modal:
        pytest.skip("knows no modes")
    x, u = flow.starts()
    for first in range(0, SPANS, WIDTH // 2):
        work = flow.enter(x, u)
        before = flow.amplitudes(work)
        flow.jump(work, (first + np.arange(WIDTH)) % SPANS)
        # what is multiplied is rounded, and so are denormal numbers
        assert np.all((sizes(work) <= before * (1.0 + 1e-12) + 1e-300) | drifts(flow))


def test_bounds_of_derivatives_and_of_what_is_off_the_origin_hold_for_ever(flow):
    """Of the third and the sixth derivative; of the value of the acceleration, of the others where nothing drifts."""
    x, u = flow.starts()
    length = 100.0 / flow.pace
    work, states = flow.enter(x, u), flow.trajectory(x, u, length)
    scale = np.abs(flow.functionals) @ flow.scale(*states, flow.origin[0] @ u)
    origin = [flow.output_origin(u, time)[0] for time in np.linspace(0.0, length, len(states))]
    bounded = []
    for order in (3, 6):
        derivative = flow.functionals @ np.linalg.matrix_power(flow.rates, order - 1)
        bounded.append((order, derivative @ (flow.rates @ states + flow.inputs @ u)))
    bounded.append((0, flow.output(states, u) - origin))
    for f in range(len(flow.watch)):
        for limit, (order, values) in zip(flow.bounds(f, work), bounded, strict=True):
            if order > 0 or f == ACCELERATION or flow.steady:
                assert np.all(np.abs(values[:, f]).max(axis=0) <= limit + TIGHT * scale[f] * flow.pace**order)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_runs_have_the_events_severities_and_margins_of_the_reference(plant):
    """From a random state in the gap, as far as the searches for extremes, turns and depths are exact to rounding."""
    random, n, end = np.random.default_rng(2), plant.n, 0.5
    state = np.concatenate([random.uniform(-0.1, 0.1, n), random.uniform(-3.0, 3.0, n)])
    state[:n] += plant.twist * (0.2 * plant.backlash - plant.twist @ state[:n]) / (plant.twist @ plant.twist)
    events, _ = reference.run(plant, end, state)
    run = started(reference.study_of(plant, end_time=end), state)
    assert [(run.kind_name(k), side) for k, side in enumerate(run.events["side"])] == [
        (event.kind, event.side) for event in events
    ]
    # 1e-12 s; where nothing is damped, the last of 60 touches and separations have been magnified a little
    assert run.events["time"] == pytest.approx([event.time for event in events], abs=1e-11)
    if plant.restitution is None:
        assert run.impact_severity == pytest.approx(reference.severities(events, list(run.primaries)), rel=1e-9)
    sticking = plant.contact_period() if plant.restitution is None else 0.0
    nearest = margins.margin(plant, events, 3.0 if run.complete else end, sticking)
    assert run.margin == pytest.approx(nearest.margin, abs=1e-9), nearest


def random_guards(random):
    """(5, W): value, slope, curvature, bounds of the third and the sixth derivative; in every fourth lane, no value."""
    least = [[-2.0], [-6.0], [-10.0], [-14.0], [-26.0]]
    guard = random.choice([-1.0, 1.0], (5, WIDTH)) * 10.0 ** random.uniform(least, 2.0, (5, WIDTH))
    guard[[0, 3, 4]] = np.abs(guard[[0, 3, 4]])
    guard[0, ::4] = 0.0
    return guard


def test_where_low_is_positive_a_guard_stays_so():
    """Its third derivative jumps from one bound to the other on the way."""
    random, kept = np.random.default_rng(1), 0
    for _ in range(1600 // WIDTH):
        guard, h, found = random_guards(random), 10.0 ** random.uniform(-2.0, 4.0, WIDTH), np.zeros((2, WIDTH))
        find_low(guard, h, found)
        positive = found[0] > 0.0
        kept += np.count_nonzero(positive)
        third, jumps_at = guard[3] * random.choice([-1.0, 1.0], WIDTH), h * random.uniform(0.0, 1.0, WIDTH)
        for t in np.linspace(0.0, h, 20):
            late = np.maximum(t - jumps_at, 0.0)
            bent = (t**3 / 6.0 - late**3 / 3.0) * third
            terms = np.array([guard[0], t * guard[1], t**2 / 2.0 * guard[2], bent])
            value, least = terms.sum(axis=0), np.minimum(guard[0], found[0])
            assert np.all((value >= least - 1e-14 * np.abs(terms).sum(axis=0))[positive])
    assert kept > 250


def wavy_series(random):
    """(TERMS, W), of five zeros and no more within (0, 1): simple, or double to 1e-3, 1e-6, or the last bit."""
    c = np.zeros((TERMS, WIDTH))
    for lane in range(WIDTH):
        roots = random.uniform(-0.5, 1.5, 5)
        roots[1] = roots[0] + random.choice([0.2, 1e-3, 1e-6, 0.0])
        c[:6, lane] = np.poly(roots)[::-1]
    return c * np.where(c[0] < 0.0, -1.0, 1.0) * np.where(random.uniform(size=WIDTH) < 0.1, -1.0, 1.0)


def test_a_series_is_not_negative_before_its_first_zero_or_as_far_as_is_known():
    """Checked at many places, to rounding; of a zero the sign behind it too; and a part is left where none is found."""
    random, crossed, shortened = np.random.default_rng(3), 0, 0
    for _ in range(1600 // WIDTH):
        c, part, results = wavy_series(random), random.uniform(0.1, 1.0, WIDTH), np.zeros((2, WIDTH))
        crosses = holds(find_first_zero(c, part, results))
        s, known = results
        rounding = 1e-14 * np.abs(c).sum(axis=0)
        places = np.linspace(0.0, 1.0, 300)[:, None] * np.where(crosses, s, known)
        assert np.all(polyval(places, c, tensor=False) >= -rounding - np.where(crosses & (s == 0.0), np.inf, 0.0))
        assert np.all((known > 0.0) & (known <= part))
        behind = polyval(s + 1e-6, c, tensor=False)
        assert np.all((behind < rounding) | ~crosses)
        assert np.all((c[0] >= 0.0) | (crosses & (s == 0.0)))
        crossed, shortened = crossed + crosses.sum(), shortened + (~crosses & (known < part)).sum()
    assert crossed > 400
    assert shortened > 50
