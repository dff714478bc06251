"""Fixed-step RK4 with zero-crossing bisection through the regimes of a switched linear system.

In a linear regime a fixed number of full steps is one precomputed matrix product. A stride of 64 steps is taken where
the amplitudes of the modes bound how far guards and accelerations can be from their chords over it, and so prove that
no guard turns negative, and no acceleration exceeds its extremes. Elsewhere one step is taken, whose product yields
each guard's value and a bound on how far the guard bends within the step (`_coast`). Where that bound proves nothing
either, and right after every event, a step is expanded into its quartics, zeros are located by bisection, and the rest
of the step is finished in the successor regime, so that the time grid stays at multiples of the step. Where another
piece of the load begins, a step is cut short, and the grid begins anew.
"""

from typing import NamedTuple

import numpy as np

from clunk.core import rigid
from clunk.core.arrays import FloatArray, StopFlag
from clunk.core.events import INSTANT
from clunk.core.jit import inlined_part, part
from clunk.core.regimes import System, turn_back
from clunk.core.rk4 import quartic
from clunk.core.rk4.propagator import BEND, IN_PLACE, STEP, STRIDE, STRIDES, Steps
from clunk.core.rk4.step import Room, enter, expand, finish, first_event, widen_extremes
from clunk.core.rubbing import OF_STEPS, WITHIN, tolerance_after
from clunk.core.runs import BEGIN, Entry, Log, Moment, Outcome, Start, begin_windows, end_of_piece, go_on, roll_states
from clunk.core.status import EVENT_BUFFER_FULL, INTERRUPTED, NON_FINITE, OK, QUALITY_COMPLETE
from clunk.core.sums import combine, copy, weigh
from clunk.core.switching import begin_run, chooses, is_instant, may_switch, recheck, switch
from clunk.core.tables import ACCELERATION

_BETWEEN_LOOKS = 256  # full steps between checks of whether the run is settled, and of the stop flag
_BEFORE_NEXT_STRIDE = 16  # steps taken one by one after a stride in doubt
# A remainder of a step shorter than this share of it is merged with the next one: right after an event the guard grows
# from zero, and needs some time to stand clear of rounding.
_SHORTEST = 0.01
_Eight = tuple[float, float, float, float, float, float, float, float]


class _Grid(NamedTuple):
    """The time grid of a piece of the load: multiples of the step up to the end of the piece, or the end time."""

    full: int  # how many full steps there are
    rest: float  # s, length of the shorter step behind these
    last: int  # how many steps there are with the shorter one, if it is longer than rounding


@part
def run(system: System, steps: Steps, start: Start, log: Log, room: Room, stop: StopFlag) -> Outcome:
    """Run from the load step to the end time, or until it is proved that nothing can follow.

    Parameters
    ----------
    start : Start
        Its state is overwritten by the one at the end, less what the driveline rolled by.
    log : Log
        Output.
    room : Room
        Scratch.
    stop : (1,) uint8
        Set to non-zero from another thread to abandon the run.
    """
    x, inputs, load = start.x, room.inputs, start.loads[start.load]
    inputs[:] = 1.0
    room.z[:] = 0.0  # an earlier run may have left NaN in the padding, and 0 times NaN is NaN
    entry = Entry(1, start.regime, -1, 0)
    begin, written = 0.0, entry.written
    piece, rolled = begin_run(system, start, inputs, log)
    begin_windows(log, 0)
    grid = _grid_of(system, steps, load, piece)
    index, offset, stages = 0, 0.0, 0  # the time is begin + index · step + offset
    guard, is_chosen = -1, False  # the guard that ended the last phase, and whether `switching.chooses` for it
    while True:
        time = begin + index * steps.step + offset
        if not is_chosen:
            entry = recheck(Moment(system, time, x, inputs, WITHIN, OF_STEPS), log, entry, guard < 0)
        roll_states(system, rolled, log, written, entry.written)
        for k in range(written, entry.written):
            begin_windows(log, k)
        flow, zero_guard = system.regimes[entry.regime].flow, entry.zero_guard
        enter(room, system, entry.regime)
        combine(steps.by_inputs[flow], room.weighed, room.by_inputs)
        extremes = log.extremes[entry.written - 1]
        while True:  # one expanded step, then full ones while nothing can happen in them, until a guard ends the phase
            length, spanned = (steps.step if index < grid.full else grid.rest) - offset, 1
            if length < _SHORTEST * steps.step and index + 1 < grid.last:
                length, spanned = length + (steps.step if index + 1 < grid.full else grid.rest), 2
            rigid.keep_locked(system, entry.regime, x, inputs)
            expand(system, flow, x, room)
            length = max(length, 0.0)
            s, guard = first_event(system, entry.regime, room, length, zero_guard, entry.zero_order)
            if length - s < INSTANT and index + spanned >= grid.last and piece + 1 < load.shape[0]:
                s, guard = length, -1  # the next piece of the load decides whether the event happens
            widen_extremes(system, flow, room, s, extremes)
            if not finish(room, s, x):
                return Outcome(NON_FINITE, entry.written, 0, begin + index * steps.step + offset)
            rolled += turn_back(system, x)
            if guard >= 0:
                offset += s
                break
            index, offset, zero_guard = index + spanned, 0.0, -1

            # full steps as long as nothing can happen in them
            copy(x, room.z)
            _advance(steps.transfer[flow, IN_PLACE], room.affine[IN_PLACE], room.z, room.after)
            copy(room.after, room.z)
            clear, over = True, False
            while clear and not over and index < grid.full:
                budget = min(_BETWEEN_LOOKS, grid.full - index)
                taken = _coast(system, steps, entry.regime, room, budget, extremes)
                rolled += turn_back(system, room.z)
                index += taken
                clear = taken == budget
                if stop[0]:
                    return Outcome(INTERRUPTED, entry.written, 0, begin + index * steps.step)
                if clear and (taken == _BETWEEN_LOOKS or index == grid.full) and piece + 1 == load.shape[0]:
                    over = _is_settled(system, steps, entry.regime, room, extremes)
            copy(room.z[: x.size], x)
            if over:
                return Outcome(OK, entry.written, QUALITY_COMPLETE, begin + index * steps.step)
            if index >= grid.last:
                end = end_of_piece(system, load, piece)
                if end == system.end_time[0]:
                    return Outcome(OK, entry.written, 0, end)
                piece = go_on(system, load, piece, end, x, inputs)
                begin, index, offset, grid = end, 0, 0.0, _grid_of(system, steps, load, piece)
                break
        written = entry.written
        rigid.keep_locked(system, entry.regime, x, inputs)
        began, time = time, begin + index * steps.step + offset
        if not may_switch(system, log, written, stages):
            return Outcome(EVENT_BUFFER_FULL, written, 0, time)
        if guard < 0:  # another piece of the load
            entry, is_chosen = Entry(written, entry.regime, -1, 0), False
            continue

        at = Moment(system, time, x, inputs, tolerance_after(time - began), OF_STEPS)
        if is_instant(at, log, written):
            begin_windows(log, written - 1)
        is_chosen = chooses(system, entry.regime, guard)
        entry = switch(at, log, entry.regime, guard, written)
        stages += entry.written == written
        if spanned == 2 and offset >= steps.step:
            index, offset = index + 1, offset - steps.step


@part
def _is_settled(system: System, steps: Steps, regime: int, room: Room, extremes: FloatArray) -> bool:
    """Whether no event can follow, and no acceleration beyond the extremes of the open windows, (L, 2).

    From now on every functional stays within its value in steady motion plus or minus the sum of its modes' present
    amplitudes. That is proved for whole steps; within a step it is checked in eight places, by `propagator._bounds`.
    """
    flow, reach = system.regimes[regime].flow, room.reach
    if not steps.settles[flow]:
        return False
    reach[:] = 0.0
    _reach(steps.mode_rows[flow], steps.mode_reach[flow], room)
    for guard in range(system.regimes[regime].guards):
        functional = system.guards[regime, guard].functional
        at_rest = room.sign[guard] * weigh(steps.rest_functional[flow, functional], room.weighed)
        if not at_rest + room.shift[guard] > (1.0 + 1e-9) * reach[functional]:
            return False
    for lash in range(0 if system.impulsive else system.lash_count):  # impulsive touches have no acceleration
        acceleration = lash * system.functionals_per_lash + ACCELERATION
        at_rest = weigh(steps.rest_functional[flow, acceleration], room.weighed)
        swing = (1.0 + 1e-9) * reach[acceleration]
        if not (extremes[lash, 0] >= at_rest + swing and extremes[lash, 1] <= at_rest - swing):
            return False
    return True


@inlined_part
def _reach(rows: FloatArray, by_mode: FloatArray, room: Room) -> None:
    """Add to each functional's `room.reach` the modes' amplitudes in state `room.z`, each times its `by_mode`."""
    modes, reach = room.modes, room.reach
    _advance(rows, room.modes_affine, room.z, modes)
    for m in range(by_mode.shape[1]):
        amplitude = np.sqrt(modes[m] ** 2 + modes[by_mode.shape[1] + m] ** 2)
        for functional in range(by_mode.shape[0]):
            reach[functional] += amplitude * by_mode[functional, m]


@part
def _grid_of(system: System, steps: Steps, load: FloatArray, piece: int) -> _Grid:
    """The time grid of a piece of the load."""
    length = end_of_piece(system, load, piece) - load[piece, BEGIN]
    full = int(np.floor(length / steps.step + 1e-9))
    rest = length - full * steps.step
    return _Grid(full, rest, full + (rest > 1e-9 * steps.step))


@inlined_part
def _advance(transfer: FloatArray, affine: FloatArray, z: FloatArray, out: FloatArray) -> None:
    """out = affine + transferᵀ z. Eight columns at a time, which LLVM vectorises."""
    x = _eight(z, 0)
    for r in range(affine.size):
        out[r] = affine[r] + _sum_of_eight(transfer, 0, r, x)
    for b in range(8, transfer.shape[0], 8):
        x = _eight(z, b)
        for r in range(affine.size):
            out[r] += _sum_of_eight(transfer, b, r, x)


@inlined_part
def _eight(z: FloatArray, b: int) -> _Eight:
    """Eight numbers from number b on."""
    return z[b], z[b + 1], z[b + 2], z[b + 3], z[b + 4], z[b + 5], z[b + 6], z[b + 7]


@inlined_part
def _sum_of_eight(transfer: FloatArray, b: int, r: int, x: _Eight) -> float:
    """Sum of column r of eight rows from row b on, each times its number of x; added up in pairs."""
    return (
        (transfer[b, r] * x[0] + transfer[b + 1, r] * x[1]) + (transfer[b + 2, r] * x[2] + transfer[b + 3, r] * x[3])
    ) + (
        (transfer[b + 4, r] * x[4] + transfer[b + 5, r] * x[5])
        + (transfer[b + 6, r] * x[6] + transfer[b + 7, r] * x[7])
    )


@part
def _coast(system: System, steps: Steps, regime: int, room: Room, budget: int, extremes: FloatArray) -> int:
    """Take up to `budget` full steps, and return how many: stops before a step in which a guard might turn negative.

    Within a step or a stride, a functional leaves the range between its end values by its sag at most: for a step, the
    bend of `propagator.BEND`; for a stride, a bound by the amplitudes of the modes. Where a stride is in doubt, or may
    change extremes, steps are taken one by one.

    extremes : (L, 2) float64  [rad/s2]
        Of each lash's acceleration; updated, unless touches are impulsive.
    """
    row, z, after, sag = system.regimes[regime], room.z, room.after, room.reach
    columns, taken = steps.transfer.shape[2], 0
    next_stride = 0 if steps.strides[row.flow] else budget  # how many steps are taken before a stride is tried
    while taken < budget:
        is_stride = next_stride <= taken <= budget - STRIDE
        if is_stride:
            _bound_stride(steps, row.flow, 2 * system.inertias, room)
        else:
            for functional in range(sag.size):
                at = columns + 4 * functional
                sag[functional] = abs(z[at + 1]) + abs(z[at + 2]) + abs(z[at + 3])
        clear = _guards_exceed(room, row.guards, columns, z)
        if clear:
            table = STRIDES if is_stride else STEP
            _advance(steps.transfer[row.flow, table], room.affine[table], z, after)
            clear = _guards_exceed(room, row.guards, columns, after)
        for lash in range(system.lash_count * (1 - system.impulsive) if clear else 0):
            functional = lash * system.functionals_per_lash + ACCELERATION
            at, wide = columns + 4 * functional, extremes[lash]
            if max(z[at], after[at]) + sag[functional] > wide[0] or min(z[at], after[at]) - sag[functional] < wide[1]:
                clear = not is_stride
                if clear:
                    c2, c3, c4 = z[at + 1] / BEND[1], z[at + 2] / BEND[2], z[at + 3] / BEND[3]
                    high, low = quartic.extremes((z[at], after[at] - z[at] - c2 - c3 - c4, c2, c3, c4), 1.0)
                    wide[0], wide[1] = max(wide[0], after[at], high), min(wide[1], after[at], low)
        if clear:
            copy(after, z)
            taken += STRIDE if is_stride else 1
        elif is_stride:
            next_stride = taken + _BEFORE_NEXT_STRIDE
        else:
            break
    return taken


@inlined_part
def _bound_stride(steps: Steps, flow: int, wave: int, room: Room) -> None:
    """Set `room.reach` to bounds of the distances of functionals from their chords over a stride from `room.z`.

    wave : index in a state of the first number of the load's wave
    """
    ramp, sag, z = steps.ramp_sag[flow], room.reach, room.z
    for which in range(sag.size):
        sag[which] = abs(room.steady_sag[which])
        if ramp.shape[0] > 0:
            steady = room.steady_sag[which] + ramp[0, which] * z[wave] + ramp[1, which] * z[wave + 1]
            sag[which] = abs(steady) + abs(ramp[2, which] * z[wave + 1])
    _reach(steps.mode_rows[flow], steps.mode_sag[flow], room)


@inlined_part
def _guards_exceed(room: Room, guards: int, columns: int, z: FloatArray) -> bool:
    """Whether all guards exceed their sag, in `room.reach`, at one end of a step; false where a guard is NaN."""
    for g in range(guards):
        if not room.sign[g] * z[columns + room.at[g]] + room.shift[g] > room.reach[room.at[g] // 4]:
            return False
    return True
