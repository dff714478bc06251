"""The exact flows' tables against the matrix exponential, and the bounds that the exact method rests on.

Every case is a driveline whose open and closed side are compared: modes, drifts and flows that have no eigenbasis.
"""

from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy.linalg import expm

from clunk import driveline
from clunk.config import study_from_text
from clunk.core.flows import BLOCK, CROSS, JERK, LONG, SPANS, SWAY, TERMS
from clunk.core.modal import expand, extremes, jump, measure, move, observe, within
from clunk.core.regimes import ACCELERATION

# Rounding of a few products of tables that are each good to some 1e-15; |λ| T reaches 1e3 in the longest span compared,
# and an angle that large is known to 1e3 eps, a modal basis to its condition (up to 1e4) times eps.
TIGHT = 1e-11
OPEN, CLOSED = 0, 1


def work_for(size):
    """Scratch of `modal.Work`."""
    rows = np.zeros((4, size))
    return (rows[0], rows[1], rows[2], np.zeros(LONG), np.zeros(TERMS), np.zeros((TERMS, TERMS)), rows[3])


def sizes(y):
    """(…, C): the amplitude of each pair, in both its places."""
    halves = y.reshape(*y.shape[:-1], -1, 2, BLOCK)
    return np.repeat(np.hypot(halves[..., :1, :], halves[..., 1:, :]), 2, axis=-2).reshape(y.shape)


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
    """One flow's tables, with the affine system that they stand for."""

    def __init__(self, plant, flow):
        study = study_from_text(reference.config_of(plant, method="exact"))
        system, flows = driveline.prepare(study)
        for field in flows._fields:
            setattr(self, field, getattr(flows, field)[flow])
        self.rates, self.inputs = system.rates[flow], system.inputs[flow]
        self.functionals, self.feedthrough = system.functionals[flow], system.feedthrough[flow]
        self.size = self.rates.shape[0]
        self.origin = self.origin.transpose(0, 2, 1)[:, : self.size]
        self.fastest = np.abs(np.linalg.eigvals(self.rates)).max()
        self.pace = max(self.fastest, 1.0)
        self.impulsive = bool(system.impulsive)
        self.lash = system.lash[self.size // 2 :]

    @property
    def is_modal(self):
        return bool(self.modal)

    def starts(self, count=5):
        """Random states and inputs; on the constraint, where the flow has one."""
        random = np.random.default_rng(1)
        for _ in range(count):
            x, u = random.normal(size=self.size), random.normal(size=2)
            n = self.size // 2
            x[n:] *= self.pace * 0.1
            if self.impulsive and not np.any(self.rates[n:].T @ self.lash):  # locked: q = s φ/2 and q' = 0
                x[:n] -= self.lash * (self.lash @ x[:n] - u[1]) / (self.lash @ self.lash)
                x[n:] -= self.lash * (self.lash @ x[n:]) / (self.lash @ self.lash)
            yield x, u

    def moved(self, x, u, time):
        """exp of the augmented matrix: the state after a time."""
        size = self.size
        augmented = np.zeros((size + 1, size + 1))
        augmented[:size, :size], augmented[:size, size] = self.rates, self.inputs @ u
        return (expm(augmented * time) @ [*x, 1.0])[:size]

    def trajectory(self, x, u, length, count=500):
        """(count + 1, 2n): the states over a time, evenly spaced."""
        size = self.size
        augmented = np.zeros((size + 1, size + 1))
        augmented[:size, :size], augmented[:size, size] = self.rates, self.inputs @ u
        across, z = expm(augmented * length / count), [np.array([*x, 1.0])]
        for _ in range(count):
            z.append(across @ z[-1])
        return np.array(z)[:, :size]

    def enter(self, x, u):
        return (x - self.origin[0] @ u) @ self.coordinates

    def leave(self, y, u, time):
        value, slope, curvature = self.origin @ u
        return value + time * (slope + 0.5 * time * curvature) + (y @ self.basis)[: self.size]

    def output_origin(self, u, time):
        """(3, F): value, slope and curvature of the functionals' origins."""
        value, slope, curvature = self.origin_output @ u
        return np.array([value + time * (slope + 0.5 * time * curvature), slope + time * curvature, curvature])

    def scale(self, *states):
        """(2n,): as large as angles and velocities get, the origin included."""
        n = self.size // 2
        together = np.abs(np.array(states))
        return np.repeat([together[:, :n].max(), together[:, n:].max()], n)

    def derivatives(self, x, u, count):
        """(count, F): the functionals and their derivatives."""
        rows, values = x, [self.functionals @ x + self.feedthrough @ u]
        rate = self.rates @ rows + self.inputs @ u
        for _ in range(1, count):
            values.append(self.functionals @ rate)
            rate = self.rates @ rate
        return np.array(values)


@pytest.fixture(params=[(name, which) for name in PLANTS for which in (OPEN, CLOSED)], ids=lambda p: f"{p[0]}, {p[1]}")
def flow(request):
    name, which = request.param
    return Flow(PLANTS[name], which)


def test_entering_and_leaving_changes_nothing(flow):
    for x, u in flow.starts():
        scale = flow.scale(x, flow.origin[0] @ u)
        assert np.all(np.abs(flow.leave(flow.enter(x, u), u, 0.0) - x) <= 1e-12 * scale)


def test_a_span_is_the_matrix_exponential(flow):
    """Spans up to a thousand radians of the fastest mode; a flow without modes knows the shortest only."""
    spans = range(SPANS) if flow.is_modal else [0]
    for x, u in flow.starts(2):
        for k in spans:
            if flow.span[k] * flow.fastest > 1e3:
                continue
            y = flow.enter(x, u)
            amplitude = np.zeros(y.size)
            if flow.is_modal:
                jump(flow.propagator, k, y, amplitude)
            else:
                move(flow.power, flow.generator, False, 1.0, y, work_for(y.size))
            exact = flow.moved(x, u, flow.span[k])
            scale = flow.scale(x, exact, flow.origin[0] @ u)
            assert np.all(np.abs(flow.leave(y, u, flow.span[k]) - exact) <= TIGHT * scale)


@pytest.mark.parametrize("part", [0.0, 1e-9, 0.3, 1.0])
def test_a_part_of_the_shortest_span_is_too(flow, part):
    for x, u in flow.starts(2):
        y = flow.enter(x, u)
        move(flow.power, flow.generator, flow.is_modal, part, y, work_for(y.size))
        exact = flow.moved(x, u, part * flow.span[0])
        scale = flow.scale(x, exact, flow.origin[0] @ u)
        assert np.all(np.abs(flow.leave(y, u, part * flow.span[0]) - exact) <= 1e-12 * scale)


def test_spans_are_two_an_octave(flow):
    assert flow.span[2:] == pytest.approx(2.0 * flow.span[:-2], rel=0.0)
    assert np.all(np.diff(flow.span) > 0.0)


def test_value_slope_and_curvature_are_the_functionals(flow):
    """At entry and after a while, against C A^k (A x + B u) of the state."""
    for x, u in flow.starts():
        for time in (0.0, 0.7 * flow.span[0], flow.span[0]):
            y = flow.enter(x, u)
            move(flow.power, flow.generator, flow.is_modal, time / flow.span[0], y, work_for(y.size))
            exact = flow.derivatives(flow.moved(x, u, time), u, 3)
            rest = flow.output_origin(u, time)
            size = np.abs(flow.functionals) @ flow.scale(x, flow.origin[0] @ u) + np.abs(flow.feedthrough @ u)
            for f in range(len(flow.watch)):
                found = np.array(observe(flow.watch[f], y)) + rest[:, f]
                rounding = TIGHT * (size[f] + np.abs(rest[0, f])) * flow.pace ** np.arange(3)
                assert np.all(np.abs(found - exact[:, f]) <= rounding)


def test_the_series_is_the_functional_over_the_shortest_span(flow):
    c = np.zeros(LONG)
    for x, u in flow.starts():
        y, rest = flow.enter(x, u), flow.output_origin(u, 0.0)
        for f in range(len(flow.watch)):
            expand(flow.series[f], y, flow.span[0], *rest[:, f], c)
            size = np.abs(flow.functionals[f]) @ flow.scale(x, flow.origin[0] @ u) + np.abs(flow.feedthrough[f] @ u)
            for s in (0.0, 0.25, 1.0):
                exact = flow.functionals[f] @ flow.moved(x, u, s * flow.span[0]) + flow.feedthrough[f] @ u
                assert np.polynomial.polynomial.polyval(s, c) == pytest.approx(exact, abs=TIGHT * size)


def drifts(flow):
    """(C,) whether a pair is a drift, whose displacement has no bound."""
    cross = flow.propagator[SPANS - 1, :, CROSS].reshape(-1, 2, BLOCK)
    drift = (cross[:, 0] != 0.0) & (cross[:, 1] == 0.0) & flow.is_modal
    return np.repeat(drift[:, None], 2, axis=1).ravel()


def test_amplitudes_never_grow(flow):
    """Of every pair of modes; without modes, of all coordinates together, drifts left out."""
    for x, u in flow.starts(3):
        homogeneous = x - flow.origin[0] @ u
        times = [flow.trajectory(homogeneous, np.zeros(2), length) for length in (10.0 / flow.pace, 300.0 / flow.pace)]
        y = np.concatenate(times) @ flow.coordinates
        if flow.is_modal:
            amplitude = sizes(y)
            rounding = TIGHT * np.abs(flow.coordinates).max() * np.abs(homogeneous).max()
            assert np.all((amplitude <= amplitude[0] * (1.0 + 1e-9) + rounding) | drifts(flow))
        else:
            moves = np.any(flow.generator != 0.0, axis=0)  # what anything depends on
            amplitude = np.linalg.norm(y[:, moves], axis=1)
            assert np.all(amplitude <= amplitude[0] * (1.0 + 1e-9))


def test_the_tabulated_decay_bounds_the_amplitude(flow):
    if not flow.is_modal:
        pytest.skip("knows no modes")
    for x, u in flow.starts(3):
        for k in range(SPANS):
            y = flow.enter(x, u)
            amplitude = np.zeros(y.size)
            measure(y, amplitude)
            jump(flow.propagator, k, y, amplitude)
            now = sizes(y)
            assert np.all((now <= amplitude * (1.0 + 1e-12) + 1e-300) | drifts(flow))  # denormal numbers round


def test_jerk_bounds_the_third_derivative_for_ever(flow):
    third = flow.functionals @ np.linalg.matrix_power(flow.rates, 2)
    for x, u in flow.starts(3):
        y = flow.enter(x, u)
        amplitude = np.zeros(y.size)
        measure(y, amplitude)
        states = flow.trajectory(x, u, 100.0 / flow.pace)
        values = (states @ flow.rates.T + flow.inputs @ u) @ third.T
        scale = np.abs(flow.functionals) @ flow.scale(*states, flow.origin[0] @ u) * flow.pace**3
        for f in range(len(flow.watch)):
            assert np.abs(values[:, f]).max() <= within(flow.watch[f], JERK, amplitude) + TIGHT * scale[f]


def test_sway_bounds_what_is_off_the_origin_for_ever(flow):
    """Of the acceleration always; of the others where nothing drifts."""
    for x, u in flow.starts(3):
        y = flow.enter(x, u)
        amplitude = np.zeros(y.size)
        measure(y, amplitude)
        states, times = flow.trajectory(x, u, 100.0 / flow.pace), np.linspace(0.0, 100.0 / flow.pace, 501)
        origin = np.array([flow.output_origin(u, time)[0] for time in times])
        away = states @ flow.functionals.T + flow.feedthrough @ u - origin
        scale = np.abs(flow.functionals) @ flow.scale(*states, flow.origin[0] @ u)
        for f in range(len(flow.watch)):
            if f == ACCELERATION or flow.steady:
                assert np.abs(away[:, f]).max() <= within(flow.watch[f], SWAY, amplitude) + TIGHT * scale[f]


def test_located_extremes_are_those_of_dense_samples(flow):
    """Over thirty radians of the fastest mode; a sample misses a peak by its curvature times h²/8, here 1e-4 of it."""
    length = 30.0 / flow.pace
    longest = int(np.flatnonzero(flow.span <= length)[-1]) if flow.span[0] <= length else -1
    longest = longest if flow.is_modal else min(longest, 0)
    count = flow.coordinates.shape[1]
    for x, u in flow.starts(2):
        y, rest = flow.enter(x, u), flow.output_origin(u, 0.0)
        states = flow.trajectory(x, u, length, 1000)
        for f in range(len(flow.watch)):
            samples = states @ flow.functionals[f] + flow.feedthrough[f] @ u
            work = work_for(count)
            high, low = extremes(
                flow.span, flow.propagator, flow.power, flow.generator, flow.watch[f], flow.series[f], flow.is_modal,
                work, y, rest[:, f].copy(), length, longest, samples[-1], samples[-1],
            )  # fmt: skip
            swing, scale = np.ptp(samples), np.abs(flow.functionals[f]) @ flow.scale(*states, flow.origin[0] @ u)
            for one, other in ((high, samples.max()), (-low, -samples.min())):
                assert -TIGHT * scale <= one - other <= 1e-3 * swing + TIGHT * scale


@pytest.mark.parametrize(
    ("name", "which", "modal", "steady"),
    [
        ("nominal", OPEN, True, False),  # the motor and its shafts drift against a damper
        ("nominal", CLOSED, True, True),
        ("locked", CLOSED, True, True),
        ("free and undamped when open", OPEN, True, False),
        ("free chain, damped inside", OPEN, True, False),
        ("both sides free", CLOSED, True, False),
        ("critically damped", OPEN, False, True),
        ("overdamped", OPEN, True, True),
        ("no damping anywhere", CLOSED, True, True),
        ("one inertia, the lash to ground", OPEN, True, False),
        ("two alike", OPEN, True, True),
    ],
)
def test_what_kind_of_flow_it_is(name, which, modal, steady):
    flow = Flow(PLANTS[name], which)
    assert (bool(flow.modal), bool(flow.steady)) == (modal, steady)
