"""What is searched for within a step: extremes of the acceleration, the lowest turn of a guard, how deep one would go.

Located, not sampled: a span is passed in which there can be nothing, since the functional is monotone, or cannot exceed
what is known. Elsewhere the shortest span is expanded into its Taylor series and searched.

TOP and BOTTOM are the extremes that are known. A turn counts below TOP, and is then both. A depth, of a guard that
falls, is BOTTOM, and need not be known beyond TOP.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.exact import curves, functionals, moving, polynomial, rows, taylor
from clunk.core.exact.flows import TERMS
from clunk.core.exact.step import GRAZING
from clunk.core.exact.workspace import (
    Workspace,
    field,
    is_still,
    number_of,
    scale_of,
    set_field,
    set_number_of,
    shortest_span,
    size_of,
    turn_search,
)
from clunk.core.jit import part
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import push, push_all, put_back
from clunk.core.lanes.vectors import WIDTH, Vector
from clunk.core.regimes import lash_of
from clunk.core.status import QUALITY_GRAZING

FloatArray = npt.NDArray[np.float64]

EXTREMES, TURN, DEPTH = range(3)


class _Known(NamedTuple):
    """A functional where a search is, and what is known of what is searched for."""

    curve: curves.Curve  # sign times the functional plus shift
    top: Vector
    bottom: Vector
    idle: Vector  # the time left before a turn counts


@part
def search(space: Workspace, sought: int, flow: int, f: int, count: int) -> int:
    """Take one span of the `count` searches that have been taken; return the lanes of those that are through.

    sought : EXTREMES, TURN or DEPTH
    flow, f : the flow, and the functional searched in
    """
    still, modal, shortest = is_still(space, flow), space.flows.modal[0, flow] != 0, shortest_span(space, flow)
    zero, present = vectors.splat(0.0), (1 << count) - 1
    time_left, sign, shift = field(space, rows.TIME_LEFT), field(space, rows.BY_SIGN), field(space, rows.BY_SHIFT)
    origin = curves.load_origin(space.pool.work, space.behind + rows.AT)
    jerk, sixth, _ = functionals.bounds(space, flow, f)
    seen = functionals.evaluate(space, flow, f, jerk, sixth)
    value = sign * (seen.value + origin.value) + shift
    slope, curvature = sign * (seen.slope + origin.slope), sign * (seen.curvature + origin.curvature)
    curve = curves.Curve(value, slope, curvature, jerk + vectors.magnitude(origin.jerk), sixth)
    top, bottom, done = field(space, rows.TOP), field(space, rows.BOTTOM), 0
    if sought == DEPTH:
        bottom = -value
        done = bottom >= top
    elif sought == EXTREMES:
        top, bottom = vectors.larger(top, value), vectors.smaller(bottom, value)
    known = _Known(curve, top, bottom, time_left - field(space, rows.COUNTS))

    h, k, near = _longest_empty(known, sought, shortest, space.flows.propagator.shape[2], modal)
    near &= present & ~done
    if near != 0:
        functionals.expand(space, flow, f, sign, shift, origin)
        top, bottom, through = _search_series(space, known, sought, shortest, time_left, near)
        done |= through

    if sought == DEPTH:  # whose spans are counted
        time_left -= 1.0
        done |= time_left <= 0.0
    else:
        done |= time_left <= h
        time_left -= h
    done &= present
    if done != present:
        if modal:
            moving.move_by_spans(space, flow, k)
        else:
            moving.move_by_parts(space, flow, zero + 1.0)
            moving.measure(space.pool.work, size_of(space))
        if not still:
            bent = 0.5 * h * (origin.curvature + h * curves.A_THIRD * origin.jerk)
            set_field(space, rows.AT, origin.value + h * (origin.slope + bent))
            set_field(space, rows.AT_SLOPE, origin.slope + h * (origin.curvature + 0.5 * h * origin.jerk))
            set_field(space, rows.AT_CURVATURE, origin.curvature + h * origin.jerk)
    set_field(space, rows.TIME_LEFT, time_left)
    set_field(space, rows.TOP, top)
    set_field(space, rows.BOTTOM, bottom)
    put_back(space.pool, space.searches, space.behind + (rows.AT if still else rows.AT_JERK), present & ~done)
    return int(done)


@part
def _longest_empty(known: _Known, sought: int, shortest: Vector, spans: int, modes: bool) -> tuple[Vector, Vector, int]:
    """The longest span of the ladder with nothing to be found, its number, and the lanes where there is none.

    Without modes there is but the shortest span.
    """
    h, k = shortest, vectors.splat(0.0)
    near = ~_is_empty(known, sought, h)
    if modes:
        step = spans // 4
        while step > 0:
            longer = h * float(1 << step)
            passes = _is_empty(known, sought, longer)
            h, k = vectors.choose(passes, longer, h), vectors.choose(passes, k + 2.0 * step, k)
            step //= 2
        longer = h * 1.5
        passes = _is_empty(known, sought, longer) & ~near
        h, k = vectors.choose(passes, longer, h), vectors.choose(passes, k + 1.0, k)
        h, k = vectors.choose(near, shortest, h), vectors.choose(near, 0.0, k)
    return h, k, near


@part
def _is_empty(known: _Known, sought: int, h: Vector) -> int:
    """Where there is nothing to be found within times h; if so, not within shorter ones either."""
    value, slope, curvature, jerk, _ = known.curve
    if sought == DEPTH:
        return int(-slope > h * (curvature + h * (0.5 * jerk)))
    zero = vectors.splat(0.0)
    off_tangent = h * (0.5 * vectors.magnitude(curvature) + h * (jerk * curves.A_SIXTH))  # over h
    against = vectors.choose(slope > 0.0, -curvature, curvature)
    monotone = h * (against + h * (0.5 * jerk)) < vectors.magnitude(slope)
    if sought == TURN:
        above = known.top - value + h * (vectors.larger(-slope, zero) + off_tangent) <= 0.0
        return int(above | monotone | (curvature + h * jerk < 0.0) | (h <= known.idle))
    within = value - known.top + h * (vectors.larger(slope, zero) + off_tangent) <= 0.0
    within &= known.bottom - value + h * (vectors.larger(-slope, zero) + off_tangent) <= 0.0
    return int(within | monotone)


@part
def _search_series(
    space: Workspace, known: _Known, sought: int, shortest: Vector, time_left: Vector, near: int
) -> tuple[Vector, Vector, int]:
    """Search the shortest span, whose series is `space.series`, in some lanes.

    Returns
    -------
    top, bottom : Vector
        What is known now.
    done : int
        The lanes whose depth is known.
    """
    c, top, bottom, done, zero = space.series, known.top, known.bottom, 0, vectors.splat(0.0)
    falls, length = vectors.load(c, 1) < 0.0, zero + 1.0
    if sought == DEPTH:
        done = near & ~falls
        near &= falls
    else:
        length = vectors.smaller(time_left / shortest, length)
    turns, straight, s = taylor.turning(c, space.moved, length)
    value, unclear = taylor.value(c, s), near & ~turns & ~straight
    turns &= near
    if sought == TURN:
        turns &= falls & (value < top) & (time_left - s * shortest <= field(space, rows.COUNTS))
        top, bottom = vectors.choose(turns, value, top), vectors.choose(turns, value, bottom)
    elif sought == DEPTH:
        bottom = vectors.choose(turns, -value, bottom)
        done |= turns
    else:
        top = vectors.choose(turns, vectors.larger(top, value), top)
        bottom = vectors.choose(turns, vectors.smaller(bottom, value), bottom)
    if unclear != 0:
        notes = space.notes
        vectors.store(notes, 0, (top, bottom, length, known.idle / shortest))
        done |= _search_one_by_one(space, sought, unclear)
        top, bottom = vectors.load(notes, 0), vectors.load(notes, 1)
    return top, bottom, done


@part
def _search_one_by_one(space: Workspace, sought: int, mask: int) -> int:
    """Search all turning points of some lanes' series; TOP and BOTTOM are in the first two notes.

    The third one says up to where, the fourth from where on a turn counts. Returns the lanes whose depth is known.
    """
    notes, c, points, done = space.notes, space.alone[0], space.alone[1], 0
    while mask != 0:
        lane = vectors.first_of(mask)
        mask &= mask - 1
        for j in range(TERMS):
            c[j] = vectors.number(space.series, j * WIDTH + lane)
        falls = c[1] < 0.0
        for k in range(polynomial.turning_points(c, notes[2, lane], points, space.ladder)):
            value = polynomial.value_of(c, TERMS, points[k])
            if sought == DEPTH:
                notes[1, lane] = -value
                done |= 1 << lane
                break
            if sought == EXTREMES:
                notes[0, lane], notes[1, lane] = max(notes[0, lane], value), min(notes[1, lane], value)
            elif falls and value < notes[0, lane] and points[k] >= notes[3, lane]:
                notes[0, lane], notes[1, lane] = value, value
            falls = not falls
    return done


@part
def conclude(space: Workspace, sought: int, queue: int, count: int, done: int) -> None:
    """Append those that are not through to their queue again, and take over what the others have found."""
    push_all(space.pool, queue, (1 << count) - 1 & ~done)
    while done != 0:
        lane = vectors.first_of(done)
        done &= done - 1
        item = space.pool.items[lane]
        slot = item // space.searches_each
        run = space.runs[slot]
        top, bottom = space.pool.work[space.behind + rows.TOP, lane], space.pool.work[space.behind + rows.BOTTOM, lane]
        if sought == TURN:
            guard = item - slot * space.searches_each - turn_search(space, 0)
            lash = lash_of(space.system, run.regime, guard)
            nearest = bottom / scale_of(space, slot, guard)
            if nearest < abs(number_of(space, slot, rows.MARGIN, lash)):
                set_number_of(space, slot, rows.MARGIN, lash, max(nearest, 0.0))
                if nearest <= GRAZING:
                    run.quality |= QUALITY_GRAZING
        elif sought == DEPTH:
            scale, lash = scale_of(space, slot, run.guard), lash_of(space.system, run.regime, run.guard)
            if max(bottom, 0.0) < abs(number_of(space, slot, rows.MARGIN, lash)) * scale:
                set_number_of(space, slot, rows.MARGIN, lash, -max(bottom, 0.0) / scale)
            run.depth_known = 1
        else:
            lash = item - slot * space.searches_each - rows.EXTREMES_SEARCH
            set_number_of(space, slot, rows.WINDOW_MAX, lash, top)
            set_number_of(space, slot, rows.WINDOW_MIN, lash, bottom)
            largest, smallest = (
                number_of(space, slot, rows.PHASE_MAX, lash),
                number_of(space, slot, rows.PHASE_MIN, lash),
            )
            set_number_of(space, slot, rows.PHASE_MAX, lash, max(largest, top))
            set_number_of(space, slot, rows.PHASE_MIN, lash, min(smallest, bottom))
        push(space.pool, space.queues.follow, slot)
