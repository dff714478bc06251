"""Tables of regimes: one for each state of the lash and each combination of stages of the staged shafts.

For the indentation model (report §2.3.2) the lash has

    regime      flow     guards                       successor
    open        open     φ/2 - q,  q + φ/2            closed on the flank reached (touch)
    closed, s   closed   separation by gap:   s q - φ/2        open (separation)
                         separation by force: contact force    parted (separation)
    parted, s   open     s q - φ/2                    open (opening)
                         minus the contact force      closed (rejoin)

where q = lash · θ = θi - ratio θj, and the contact torque is k (s q - φ/2) + c s q'. *Parted* exists only for
separation by force: the flanks still overlap, but no longer press on each other.

The restitution model (report §2.3.1) has the regimes open and closed too, but closed is the chain with q locked at
s φ/2, a constraint whose torque is the guard, and a touch *resets* the velocities (report Eq. 2.9): it rebounds into
the open regime, or, below the locking speed and under a compressive torque, locks.

A staged shaft's torque is continuous and piecewise linear in its twist. In stage i the twist lies between breakpoints
i - 1 and i, which are two guards more; where one turns negative, the neighbouring stage follows, and nothing else
changes. Regimes are numbered by the lash first: regime = state of the lash + states · combination of stages.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.events import OPENING, REJOIN, SEPARATION, STAGE, TOUCH

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

OPEN, CLOSED_POSITIVE, CLOSED_NEGATIVE, PARTED_POSITIVE, PARTED_NEGATIVE = range(5)
TORQUE, HALF_GAP, TORQUE_RATE = range(3)
INPUTS = 3  # and behind them a 1 for each staged shaft
# The functionals: q, θ'' of one inertia, and the contact torque, signed like q: k q + c q', or the torque that locks q,
# which is left out where no guard needs it, a functional less to step; then the twists of the staged shafts.
GAP, ACCELERATION, FORCE = range(3)

REGIME = np.dtype(
    [
        ("flow", np.int64),
        ("closed", np.int64),  # whether the flanks press on each other
        ("side", np.int64),  # s
        ("guards", np.int64),  # how many end it
        ("watched", np.int64),  # how many rows it has: those that end it, then those that make a margin only
        ("group", np.int64),  # runs in regimes with one flow and, but for the side, the same guards step together
        ("of_gap", np.float64),  # margins in it are relative to of_gap · φ/2 + of_rest · what is at rest
        ("of_rest", np.float64),
    ],
    align=True,
)


GUARD = np.dtype(
    [
        ("functional", np.int64),  # guard = sign · functional + offsets · d
        ("sign", np.float64),
        ("successor", np.int64),  # the regime that follows where it turns negative, or -1
        ("event_kind", np.int64),  # the event that this is, or -1
        ("side", np.int64),  # and the flank that the event concerns
        ("zero_guard", np.int64),  # the successor's guard that is zero on entry, or -1
        ("zero_order", np.int64),  # and how many of its derivatives, itself included, are
        ("makes_margin", np.int64),  # whether its turning back or its depth does
        ("alike", np.int64),  # the regime's first guard of the same functional
    ],
    align=True,
)


class StagedShaft(NamedTuple):
    """A massless shaft whose torque is continuous and piecewise linear in its twist, and zero at twist 0.

    twist : (n,) float64, its twist is twist · θ
    stiffness : (m + 1,) float64, the slope in each stage  [N m/rad]
    breakpoints : (m,) float64, the twists between stages, increasing  [rad]
    """

    twist: FloatArray
    stiffness: FloatArray
    breakpoints: FloatArray

    @property
    def torques(self) -> FloatArray:
        """(m + 1,) the torque at twist 0 of the line that each stage is on  [N m]."""
        rest = int(np.searchsorted(self.breakpoints, 0.0))
        jumps = np.concatenate([[0.0], np.cumsum(-np.diff(self.stiffness) * self.breakpoints)])
        return np.asarray(jumps - jumps[rest], np.float64)

    def energy(self, twist: float) -> float:
        """Energy stored at a twist  [J]."""
        low, high = min(twist, 0.0), max(twist, 0.0)
        nodes = np.array([low, *(b for b in self.breakpoints.tolist() if low < b < high), high])
        stages = np.searchsorted(self.breakpoints, nodes)
        torques = self.stiffness[stages] * nodes + self.torques[stages]
        return float(np.sign(twist) * np.sum((torques[1:] + torques[:-1]) * np.diff(nodes)) / 2.0)


class _Guard(NamedTuple):
    """A guard, sign · functional + offset · (an input of the run), and what follows where it turns negative."""

    functional: int
    sign: float
    offset: float
    successor: int = -1
    event_kind: int = -1
    zero_guard: int = -1
    zero_order: int = 0
    makes_margin: bool = False
    offset_by: int = HALF_GAP


class _Regime(NamedTuple):
    """A regime, its guards, and those functionals that end nothing, but whose turning back makes a margin."""

    closed: bool
    side: int
    guards: list[_Guard]
    watched: tuple[_Guard, ...] = ()
    of_gap: float = 0.0
    of_rest: float = 1.0


def _indentation_states(stiffness: float, damping: float, separation_by_force: bool) -> list[_Regime]:
    # at a touch the overlap is zero, but the contact force is c q' > 0, if there is damping
    order = 0 if separation_by_force and damping > 0.0 else 1
    regimes = [_open(0 if order else -1, order)]
    for side, parted in ((1, PARTED_POSITIVE), (-1, PARTED_NEGATIVE)):
        if separation_by_force:
            # the flanks may press less than nothing on each other; a miss is near where they all but cease to overlap
            force = _Guard(FORCE, side, -stiffness, parted, SEPARATION, 1, 1)
            regimes.append(_Regime(True, side, [force], (_Guard(GAP, side, -1.0, makes_margin=True),)))
        else:
            overlap = _Guard(GAP, side, -1.0, OPEN, SEPARATION, _reached(side), 1, makes_margin=True)
            regimes.append(_Regime(True, side, [overlap]))
    for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE)):
        if separation_by_force:
            opening = _Guard(GAP, side, -1.0, OPEN, OPENING, _reached(side), 1, makes_margin=True)
            rejoin = _Guard(FORCE, -side, stiffness, closed, REJOIN, 0, 1)
            regimes.append(_Regime(False, side, [opening, rejoin]))
    return regimes


def _restitution_states() -> list[_Regime]:
    # What follows a touch is decided at the touch; a separation leaves with value, slope and curvature of the gap zero.
    return [_open(-1, 0)] + [
        _Regime(
            True,
            side,
            [_Guard(FORCE, side, 0.0, OPEN, SEPARATION, _reached(side), zero_order=3, makes_margin=True)],
        )
        for side in (1, -1)
    ]


def _open(zero_guard: int, zero_order: int) -> _Regime:
    """The open regime, by the guard of a closed one that is zero at a touch, and its order; margins are of the gap."""
    return _Regime(
        False,
        0,
        [
            _Guard(GAP, -side, 1.0, closed, TOUCH, zero_guard, zero_order, makes_margin=True)
            for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE))
        ],
        of_gap=2.0,
        of_rest=0.0,
    )


def _reached(side: int) -> int:
    """The open regime's guard of the flank of `side`."""
    return 0 if side > 0 else 1


class Tables(NamedTuple):
    """The tables of `System`: R regimes in U groups, G guards at most, I inputs; see there."""

    regimes: npt.NDArray[np.void]
    guards: npt.NDArray[np.void]
    offsets: FloatArray
    weights: FloatArray
    leaders: IntArray
    lash_states: int


def stages_of(staged: Sequence[StagedShaft]) -> list[tuple[int, ...]]:
    """The combinations of stages, one for each shaft, in the order in which regimes have them."""
    return list(itertools.product(*(range(shaft.stiffness.size) for shaft in staged)))


def indentation_tables(
    stiffness: float, damping: float, separation_by_force: bool, staged: Sequence[StagedShaft]
) -> Tables:
    """Tables for a contact that is a spring and a damper; their numbers are the contact's  [N m/rad], [N m s/rad]."""
    return _tables(
        _indentation_states(stiffness, damping, separation_by_force), staged, 3 if separation_by_force else 2
    )


def restitution_tables(staged: Sequence[StagedShaft]) -> Tables:
    """Tables for impacts of rigid flanks."""
    return _tables(_restitution_states(), staged, 3)


def _tables(states: list[_Regime], staged: Sequence[StagedShaft], first_twist: int) -> Tables:
    """The tables for a list of the lash's states and some staged shafts, whose twists are functionals from one on."""
    combinations = stages_of(staged)
    table = [
        (stage, row._replace(guards=[*_in_stage(row.guards, stage * len(states)), *passing]))
        for stage, stages in enumerate(combinations)
        for state, row in enumerate(states)
        for passing in [_breakpoints(staged, stages, first_twist, state, states, combinations)]
    ]
    rows = [[*row.guards, *row.watched] for _, row in table]
    most, inputs = max(map(len, rows)), INPUTS + len(staged)
    regimes, guards = np.zeros(len(table), REGIME), np.zeros((len(table), most), GUARD)
    offsets, weights = np.zeros((len(table), most, inputs)), np.ones((len(table), inputs))
    alike = [_but_for_side(stage, row) for stage, row in table]
    leaders = [k for k, key in enumerate(alike) if alike.index(key) == k]
    for k, (stage, row) in enumerate(table):
        flow = stage + row.closed * len(combinations)
        group = leaders.index(alike.index(alike[k]))
        regimes[k] = (flow, row.closed, row.side, len(row.guards), len(rows[k]), group, row.of_gap, row.of_rest)
        weights[k, HALF_GAP] = row.side
        weights[k, INPUTS:] = [shaft.torques[i] for shaft, i in zip(staged, combinations[stage], strict=True)]
        for g, guard in enumerate(rows[k]):
            side = row.side or (1 if guard.successor % len(states) == CLOSED_POSITIVE else -1)
            first = [other.functional for other in rows[k]].index(guard.functional)
            guards[k, g] = (*guard[:2], *guard[3:5], side, *guard[5:8], first)
            offsets[k, g, guard.offset_by] = guard.offset
    return Tables(regimes, guards, offsets, weights, np.array(leaders), len(states))


def _in_stage(guards: list[_Guard], first: int) -> list[_Guard]:
    """Guards whose successors are numbered from the first regime of a combination of stages on."""
    return [guard._replace(successor=guard.successor + first) for guard in guards]


def _breakpoints(
    staged: Sequence[StagedShaft],
    stages: tuple[int, ...],
    first_twist: int,
    state: int,
    states: list[_Regime],
    combinations: list[tuple[int, ...]],
) -> list[_Guard]:
    """The guards of a combination of stages: each shaft's twist below the breakpoint above it, and above the one below.

    Where one is passed, the guard of the way back is zero on entry.
    """
    passing = []
    for k, (shaft, stage) in enumerate(zip(staged, stages, strict=True)):
        for way in (1, -1):
            if not 0 <= stage + way < shaft.stiffness.size:
                continue
            following = (*stages[:k], stage + way, *stages[k + 1 :])
            before = sum(
                (i > 0) + (i + 1 < other.stiffness.size) for other, i in zip(staged[:k], stages[:k], strict=True)
            )
            back = len(states[state].guards) + before + int(way > 0 and stage + way + 1 < shaft.stiffness.size)
            passing.append(
                _Guard(
                    first_twist + k,
                    -way,
                    way * shaft.breakpoints[stage if way > 0 else stage - 1],
                    state + len(states) * combinations.index(following),
                    STAGE,
                    back,
                    1,
                    offset_by=INPUTS + k,
                )
            )
    return passing


def _but_for_side(stage: int, row: _Regime) -> tuple[Any, ...]:
    """What regimes of a group have in common: their flow, and guards of the same functionals and signs but for side."""
    guards = [(guard.functional, (row.side or 1) * guard.sign) for guard in (*row.guards, *row.watched)]
    return stage, row.closed, row.side != 0, guards
