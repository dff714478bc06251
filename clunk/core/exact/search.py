"""Searches for turning points: extremes of the acceleration, lowest turns of guards, and depths of events' guards.

Extremes and lowest turns are searched within a step; how deep the guard of an event would go, from the event on. A
search finds the highest turning point above TOP, and the lowest below BOTTOM, of sign · functional + shift. Turning
points are located, not sampled: a span is passed over only if none in it can count, because the function is monotone
over the span, or cannot exceed the extremes known so far, or because the span ends before turning points count.
Elsewhere the function is expanded into its Taylor series over the shortest span, and the series is searched.
"""

from typing import NamedTuple

import numpy as np

from clunk.core.exact import curves, functionals, moving, rows, taylor
from clunk.core.exact.margins import take_margin_of_guard
from clunk.core.exact.workspace import Workspace, field, set_field, shortest_span
from clunk.core.jit import part
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import push, push_all, put_back
from clunk.core.lanes.vectors import Vector

_NARROWEST = 2.0**-16  # of the shortest span: the values of two turns as near as that differ by less than rounding
# Spans taken per call: with fewer, searches are put back into the queue too often; with more, the lanes of finished
# searches idle while others go on.
_AT_ONCE = 4


class _Known(NamedTuple):
    """The function of each search at the time that the search has reached, and the extremes known so far."""

    curve: curves.Curve  # sign times the functional plus shift
    top: Vector
    bottom: Vector
    idle: Vector  # s, until a turn counts
    once: int  # the lanes whose search ends with the first turn


@part
def search(space: Workspace, flow: int, f: int, queue: int, count: int) -> None:
    """Advance the `count` searches taken from a queue by up to `_AT_ONCE` spans; finished ones report to their runs.

    flow, f : the flow and the functional of all these searches
    """
    modal, shortest = space.flows.modal[0, flow] != 0, shortest_span(space, flow)
    present, until, done = (1 << count) - 1, field(space, rows.UNTIL), 0
    sign, shift, inputs_at = field(space, rows.BY_SIGN), field(space, rows.BY_SHIFT), space.behind + rows.OF_A_SEARCH
    for _ in range(_AT_ONCE):
        time_left, elapsed = field(space, rows.TIME_LEFT), field(space, rows.STRETCH_TIME)
        moving.measure(space.pool.work, space.behind, space.amplitudes)
        origin = functionals.origin(space, flow, f, inputs_at, elapsed)
        seen, _ = functionals.evaluate(space, flow, f)
        curve = curves.as_guard(seen, origin, sign, shift)
        top, bottom = field(space, rows.TOP), field(space, rows.BOTTOM)
        done |= (curve.value <= until) & present
        known = _Known(curve, top, bottom, time_left - field(space, rows.COUNTS), until > -np.inf)

        h, k, near = _longest_empty(known, shortest, space.flows.span.shape[2] if modal else 0)
        near &= present & ~done
        if near:
            functionals.expand(space, flow, f, sign, shift, origin)
            top, bottom, finished = _search_series(space, known, shortest, time_left, near)
            done |= finished
            set_field(space, rows.TOP, top)
            set_field(space, rows.BOTTOM, bottom)
        done |= (time_left <= h) & present
        if done == present:
            break
        moving.move(space, flow, not modal, k, vectors.splat(1.0))
        set_field(space, rows.TIME_LEFT, time_left - h)
        set_field(space, rows.STRETCH_TIME, elapsed + h)
    put_back(space.pool, space.pool.work, space.searches, space.behind + rows.BY_SIGN, present & ~done)
    push_all(space.pool, queue, present & ~done)
    lashes = space.system.lash_count
    while done:
        lane = vectors.first_of(done)
        done &= done - 1
        item = space.pool.items[lane]
        slot, number = item // space.searches_each, item % space.searches_each
        run = space.runs[slot]
        numbers = space.pool.work[space.behind :, lane]
        if number < lashes:
            lash_fields = space.of_lashes[slot, number]
            lash_fields[rows.WINDOW_MAX], lash_fields[rows.WINDOW_MIN] = numbers[rows.TOP], numbers[rows.BOTTOM]
        else:
            deep = number == space.searches_each - 1
            take_margin_of_guard(space, slot, run.guard if deep else number - lashes, numbers[rows.BOTTOM], deep)
        run.searches -= 1
        if not run.searches:
            push(space.pool, space.queues.follow, slot)


@part
def _longest_empty(known: _Known, shortest: Vector, spans: int) -> tuple[Vector, Vector, int]:
    """The longest span of the ladder in which no turn can count, its number, and the lanes without such a span.

    spans : length of the ladder; 0 for a flow without modes, of which only the shortest span is tried
    """
    h, k, rungs = shortest, vectors.splat(0.0), spans // 2
    near = ~_is_empty(known, h)
    while rungs > 0:  # bisection of the ladder, which has two spans an octave
        longer = h * (float(1 << rungs // 2) if rungs > 1 else 1.5)
        passes = _is_empty(known, longer) & ~near
        h, k = vectors.choose(passes, longer, h), vectors.choose(passes, k + float(rungs), k)
        rungs //= 2
    return h, k, near


@part
def _is_empty(known: _Known, h: Vector) -> int:
    """Lanes where no turn can count within a time h; then none can within a shorter time either."""
    value, slope, curvature, third, _ = known.curve
    # bound of the distance from the tangent, over h
    off_tangent = h * (0.5 * vectors.magnitude(curvature) + h * (third * curves.A_SIXTH))
    against = vectors.choose(slope > 0.0, -curvature, curvature)
    monotone = h * (against + h * (0.5 * third)) < vectors.magnitude(slope)
    within = value - known.top + h * (vectors.larger(slope, 0.0) + off_tangent) <= 0.0
    within &= known.bottom - value + h * (vectors.larger(-slope, 0.0) + off_tangent) <= 0.0
    return within | monotone | (h <= known.idle)


@part
def _search_series(
    space: Workspace, known: _Known, shortest: Vector, time_left: Vector, near: int
) -> tuple[Vector, Vector, int]:
    """Search the shortest span, over which `Workspace.series` is the series of the function.

    near : the lanes to search

    Returns
    -------
    top, bottom : Vector
        The extremes known now.
    done : int
        The lanes whose search ends with the first turn, and has come to it, or to where the function does not fall.
    """
    c, top, bottom = space.series, known.top, known.bottom
    left = vectors.smaller(time_left / shortest, 1.0)
    done = near & known.once & ~(vectors.load(c, 1) < 0.0)
    near &= ~done
    begin, width = 0.0 * left, left
    while near:  # more than one round only where the series may turn more than once
        falls = vectors.load(c, 1) < 0.0
        turns, straight, s = taylor.turning(c, space.moved, width)
        value, _, _ = taylor.derivatives(c, s)
        passes = turns | straight | (width <= _NARROWEST)
        counts = near & turns & (time_left - (begin + s) * shortest <= field(space, rows.COUNTS))
        top = vectors.choose(counts & ~falls, vectors.larger(value, top), top)
        bottom = vectors.choose(counts & falls, vectors.smaller(value, bottom), bottom)
        done |= counts & known.once
        passed = vectors.choose(passes, width, 0.0)
        begin += passed
        near &= ~done & (begin < left)
        if near:
            taylor.shift(c, passed)
            width = vectors.smaller(vectors.choose(passes, 2.0 * width, 0.5 * width), left - begin)
    return top, bottom, done
