"""Tables of regimes: one for each combination of states of the driveline's elements: lashes, staged shafts, frictions.

For the indentation model (report §2.3.2) a lash has

    state       flow     guards                       successor
    open        open     φ/2 - q,  q + φ/2            closed on the flank reached (touch)
    closed, s   closed   separation by gap:   s q - φ/2        open (separation)
                         separation by force: contact force    parted (separation)
    parted, s   open     s q - φ/2                    open (opening)
                         minus the contact force      closed (rejoin)

where q = twist · θ = θi - ratio θj, and the contact torque is k (s q - φ/2) + c s q'. *Parted* exists only for
separation by force: the flanks still overlap, but no longer press on each other.

The restitution model (report §2.3.1) has the states open and closed too, but closed is the chain with q locked at
s φ/2, a constraint whose torque is the guard, and a touch *resets* the velocities (report Eq. 2.9): it rebounds into
the open state, or, below the locking speed and under a compressive torque, locks.

A staged shaft's torque is continuous and piecewise linear in its twist. In stage i the twist lies between breakpoints
i - 1 and i, each of which makes a guard; where a guard turns negative, the neighbouring stage follows, and nothing else
changes. Each stage extends by BEYOND past its breakpoints. A twist that comes to rest at a breakpoint, or that friction
holds there, is therefore within both stages, and rounding makes it leave neither; and after a change of stage, the
twist has to go back by twice BEYOND before the stage can change again.

A friction across a shaft (Coulomb's, static and kinetic alike) either sticks, its twist held as a true constraint whose
torque is at most F either way, or slips with a torque of F against the rate of twist; `clunk.core.rubbing` chooses
which state follows.

A regime is one state of each element. Its guards are those of all these states, and a guard that turns negative changes
the state of its own element. The number of a regime changes fastest with the first lash's state, then with the other
lashes' and the stages, and slowest with the frictions' states.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray, record_of
from clunk.core.batches import alike
from clunk.core.events import OPENING, REJOIN, SEPARATION, STAGE, TOUCH

Number = float | FloatArray  # of a driveline, or of each in a batch, (D,)

OPEN, CLOSED_POSITIVE, CLOSED_NEGATIVE, PARTED_POSITIVE, PARTED_NEGATIVE = range(5)
TORQUE, HALF_GAP, TORQUE_RATE = range(3)
# The inputs of a driveline with one lash; behind them come the half gaps of the other lashes, a 1 for each staged
# shaft, and for each friction a 1 and the twist at which it sticks.
INPUTS = 3
OF_FRICTION = 2  # inputs of each friction, and also its functionals
# The functionals of a lash: q, θ'' of one inertia, and the contact torque, signed like q: k q + c q', or the torque
# that locks q. The torque is left out where no guard needs it, which makes steps cheaper. Behind the functionals of the
# last lash come the twists of the staged shafts, and for each friction the rate of twist and the torque that holds it
# where it sticks.
GAP, ACCELERATION, FORCE = range(3)
RATE, HOLDING = range(2)
STICKS, SLIPS_FORWARD, SLIPS_BACKWARD = range(3)  # states of a friction
ABOVE = 1e-9  # share of F that a sticking friction holds above F: more than rounding, less than can be measured
BEYOND = 1e-12  # rad, by which a stage extends past its breakpoints: more than rounding, less than can be measured

REGIME = record_of(
    flow="i8",
    guards="i8",  # how many guards end it
    watched="i8",  # how many rows it has among the guards: those that end it, then those that make a margin only
    group="i8",  # runs in regimes with one flow and, but for the sides, the same guards step together
)

CONTACT = record_of(
    closed="i8",  # whether the flanks press on each other
    side="i8",  # s, the flank in contact; 0 for none
)

GUARD = record_of(
    functional="i8",  # guard = sign · functional + offsets · d
    sign="f8",
    # the regime that follows where the guard turns negative, as far as the state of its own element decides; -1 for
    # frictions, whose states `clunk.core.rubbing` chooses, and in rows that end nothing
    successor="i8",
    event_kind="i8",  # the kind of event where the guard turns negative, or -1
    lash="i8",  # the lash that the event concerns, or -1
    side="i8",  # the flank of that lash that the event concerns
    zero_guard="i8",  # the successor's guard that is zero on entry, or -1
    zero_order="i8",  # how many of that guard's derivatives are zero on entry, the guard itself included
    makes_margin="i8",  # whether the guard's turns and its depth make margins
    first_alike="i8",  # the regime's first guard with the same functional
)


class Lashes(NamedTuple):
    """The L lashes of a driveline: their contacts, what counts as sticking, and the accelerations that are watched.

    twists : (L, n) float64, q of each = row · θ
    stiffness, damping : (L,) float64, of each contact  [N m/rad], [N m s/rad]
    are_rigid : bool, whether contacts are of the restitution model; else they are springs and dampers (indentation)
    separation_by_force : (L,) of bool
    restitution : (L,) float64, e of the restitution model
    locking_speed : (L,) float64, a rebound not faster than this locks, see `regimes.System`  [rad/s]
    sticking_time : (L,) float64, a longer contact is sticking  [s]
    acceleration_of : (L,) of int, index from 0 of the inertia whose acceleration is watched

    In a batch of drivelines float64 arrays have one more axis in front; twists may have it.
    """

    twists: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    are_rigid: bool
    separation_by_force: Sequence[bool]
    restitution: FloatArray
    locking_speed: FloatArray
    sticking_time: FloatArray
    acceleration_of: Sequence[int]


class StagedShaft(NamedTuple):
    """A massless shaft whose torque is continuous and piecewise linear in its twist, and zero at twist 0.

    twist : (n,) float64, its twist is twist · θ
    stiffness : (m + 1,) float64, the slope in each stage  [N m/rad]
    breakpoints : (m,) float64, the twists between stages, increasing  [rad]

    In a batch of drivelines the arrays have one more axis in front.
    """

    twist: FloatArray
    stiffness: FloatArray
    breakpoints: FloatArray

    @property
    def torques(self) -> FloatArray:
        """(m + 1,) the torque at twist 0 of the line that each stage is on  [N m]."""
        rest = np.count_nonzero(alike(self.breakpoints < 0.0))
        jumps = np.zeros(self.stiffness.shape)
        np.cumsum(-np.diff(self.stiffness) * self.breakpoints, axis=-1, out=jumps[..., 1:])
        return jumps - jumps[..., rest, None]


class Friction(NamedTuple):
    """Coulomb friction across a shaft.

    twist : (n,) float64, its twist is twist · θ
    torque : float or (D,) float64 in a batch of drivelines, F  [N m]
    """

    twist: FloatArray
    torque: Number

    @property
    def most(self) -> Number:
        """Largest torque that it holds where it sticks, F (1 + ABOVE), so that a load of F starts no slip  [N m]."""
        return self.torque * (1.0 + ABOVE)


class _Guard(NamedTuple):
    """A guard, sign · functional + offset · input of an element, and what follows where the guard turns negative."""

    functional: int
    sign: float
    offset: Number
    successor: int = -1  # state of the element
    event_kind: int = -1
    zero_guard: int = -1  # among the guards of the successor
    zero_order: int = 0
    makes_margin: bool = False


class _State(NamedTuple):
    """A state of an element: its guards, and functionals that end nothing, but whose turns make margins."""

    flow: int  # number among the flows that the element distinguishes
    weight: Number  # of the element's input in u; of a lash the side
    guards: list[_Guard]
    watched: tuple[_Guard, ...] = ()


class _Element(NamedTuple):
    """A lash, a staged shaft or a friction: in each of its states the torques are linear."""

    states: list[_State]
    functional: int  # its first functional
    input: int  # the input that is its half gap, or 1


def _lash_states(lashes: Lashes, k: int) -> list[_State]:
    by_force, stiffness = lashes.separation_by_force[k], lashes.stiffness[..., k]
    # At a touch the overlap is zero, but the contact force is c q' > 0, if there is damping. After a touch of rigid
    # flanks, `rigid.strike` finds the next regime. Rigid flanks part with value, slope and curvature of the gap zero.
    order = 0 if lashes.are_rigid or (by_force and np.all(lashes.damping[..., k] > 0.0)) else 1
    touches = [
        _Guard(GAP, -side, 1.0, closed, TOUCH, 0 if order else -1, order, makes_margin=True)
        for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE))
    ]
    states, parted_states = [_State(0, 0, touches)], []
    for reached, side in enumerate((1, -1)):  # `reached` is the open state's guard for that flank
        overlap = _Guard(GAP, side, -1.0, OPEN, SEPARATION, reached, 1, makes_margin=True)
        if lashes.are_rigid:
            states.append(_State(1, side, [overlap._replace(functional=FORCE, offset=0.0, zero_order=3)]))
        elif by_force:
            # the contact force may turn tensile while the flanks overlap: the overlap, not the force, makes the margin
            closed, parted = CLOSED_POSITIVE + reached, PARTED_POSITIVE + reached
            force = _Guard(FORCE, side, -stiffness, parted, SEPARATION, 1, 1)
            states.append(_State(1, side, [force], (_Guard(GAP, side, -1.0, makes_margin=True),)))
            rejoin = _Guard(FORCE, -side, stiffness, closed, REJOIN, 0, 1)
            parted_states.append(_State(0, side, [overlap._replace(event_kind=OPENING), rejoin]))
        else:
            states.append(_State(1, side, [overlap]))
    return states + parted_states


def _stages(shaft: StagedShaft) -> list[_State]:
    """The stages of a shaft as states: the twist lies between two breakpoints, or at most BEYOND past one of them."""
    states = []
    for stage, torque in enumerate(np.moveaxis(shaft.torques, -1, 0)):
        guards = []
        if stage < shaft.breakpoints.shape[-1]:
            guards.append(_Guard(0, -1.0, BEYOND + shaft.breakpoints[..., stage], stage + 1, STAGE))
        if stage > 0:
            guards.append(_Guard(0, 1.0, BEYOND - shaft.breakpoints[..., stage - 1], stage - 1, STAGE))
        states.append(_State(stage, torque, guards))
    return states


def _slips(friction: Friction) -> list[_State]:
    """The states of a friction, which sticks, or slips either way; `clunk.core.rubbing` chooses which one follows."""
    torque = friction.torque
    sticks = _State(1, 0.0, [_Guard(HOLDING, -way, friction.most, event_kind=STAGE) for way in (1, -1)])
    return [sticks, *(_State(0, way * torque, [_Guard(RATE, way, 0.0, event_kind=STAGE)]) for way in (1, -1))]


def half_gap_of(lash: int) -> int:
    """The input that is the half gap of a lash."""
    return HALF_GAP if lash == 0 else INPUTS + lash - 1


def functionals_of(lashes: Lashes) -> int:
    """Number of functionals of each lash."""
    return 3 if lashes.are_rigid or any(lashes.separation_by_force) else 2


def combinations(counts: Sequence[int]) -> list[tuple[int, ...]]:
    """All combinations of numbers, each below its count, in the order of regimes: the first number changes fastest."""
    return [chosen[::-1] for chosen in itertools.product(*map(range, reversed(counts)))]


class FlowOf(NamedTuple):
    """Key of a flow: whether each lash is closed, the stage of each staged shaft, and whether each friction sticks."""

    closed: tuple[int, ...]
    stages: tuple[int, ...]
    stuck: tuple[int, ...]


def build_tables(
    lashes: Lashes, staged: Sequence[StagedShaft], frictions: Sequence[Friction], batch: Sequence[int]
) -> dict[str, Any]:
    """The fields of `regimes.System` that are tables of all combinations of states.

    batch : (D,) of a batch of drivelines, else ()
    """
    count, stride = lashes.twists.shape[-2], functionals_of(lashes)
    constants = INPUTS + count - 1
    rates, rubbing = count * stride + len(staged), constants + len(staged)
    elements = [
        *(_Element(_lash_states(lashes, k), k * stride, half_gap_of(k)) for k in range(count)),
        *(_Element(_stages(shaft), count * stride + k, constants + k) for k, shaft in enumerate(staged)),
        *(
            _Element(_slips(friction), rates + OF_FRICTION * k, rubbing + OF_FRICTION * k)
            for k, friction in enumerate(frictions)
        ),
    ]
    counts = [len(element.states) for element in elements]
    chosen, strides = np.array(combinations(counts)), _strides(counts)
    flow_strides = _strides([1 + max(state.flow for state in element.states) for element in elements])
    # how many guards each element has in each regime: first those that end it, and then those that make a margin only
    lengths = [
        np.array([len(getattr(state, rows)) for state in element.states])[chosen[:, e]]
        for rows in ("guards", "watched")
        for e, element in enumerate(elements)
    ]
    ends = np.cumsum(lengths, axis=0)
    begins = ends - lengths
    regimes, contacts = np.zeros(len(chosen), REGIME), np.zeros((len(chosen), count), CONTACT)
    regimes["guards"], regimes["watched"] = ends[len(elements) - 1], ends[-1]
    guards = np.zeros((len(chosen), ends[-1].max()), GUARD)
    turned = np.zeros(guards.shape)  # the guards' signs, times the sides of their lashes
    offsets = np.zeros((*batch, *guards.shape, rubbing + OF_FRICTION * len(frictions)))
    weights = np.ones((*batch, len(chosen), offsets.shape[-1]))
    for e, element in enumerate(elements):
        for number, state in enumerate(element.states):
            at = np.flatnonzero(chosen[:, e] == number)
            side = int(state.weight) if e < count else 0
            regimes["flow"][at] += state.flow * flow_strides[e]
            weights[..., at, element.input] = np.expand_dims(state.weight, -1)
            if e < count:
                contacts[at, e] = (state.flow, side)
            of_state = zip((begins[e], begins[len(elements) + e]), (state.guards, state.watched), strict=True)
            for row, guard in ((first[at] + k, guard) for first, some in of_state for k, guard in enumerate(some)):
                fields = (
                    element.functional + guard.functional,
                    guard.sign,
                    at + strides[e] * (guard.successor - number) if guard.successor >= 0 else -1,
                    guard.event_kind,
                    e if e < count else -1,
                    (side or (1 if guard.successor == CLOSED_POSITIVE else -1)) if e < count else 0,
                    begins[e, at] + guard.zero_guard if min(guard.successor, guard.zero_guard) >= 0 else -1,
                    guard.zero_order,
                    guard.makes_margin,
                )
                for name, value in zip(GUARD.names or (), fields, strict=False):
                    guards[name][at, row] = value
                turned[at, row] = guard.sign * (side or 1)
                offsets[..., at, row, element.input] = np.expand_dims(guard.offset, -1)
    functionals = guards["functional"]
    guards["first_alike"] = (functionals[:, :, None] == functionals[:, None]).argmax(axis=2)
    groups = np.column_stack([regimes["flow"], contacts["side"] != 0, functionals, turned])
    _, first, group_of = np.unique(groups.view(f"V{groups[0].nbytes}").ravel(), return_index=True, return_inverse=True)
    leaders, regimes["group"] = np.unique(first[group_of], return_inverse=True)
    return {
        "regimes": regimes,
        "contacts": contacts,
        "guards": guards,
        "offsets": offsets,
        "weights": weights,
        "leaders": leaders,
        "regime_strides": strides,
        "friction_states": chosen[:, len(elements) - len(frictions) :].copy(),
    }


def _strides(counts: Sequence[int]) -> IntArray:
    """By how much a combination's place changes with each of its numbers, and at last the number of combinations."""
    return np.cumprod([1, *counts])
