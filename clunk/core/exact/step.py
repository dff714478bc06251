"""One step of the runs in the lanes: over a span in which no guard turns negative, or up to an event.

A span is proposed by an estimate, and all runs are moved over it. It counts only for runs whose guards are proved to
have stayed positive all through it; any other run stays where it was, and tries a shorter span next. Where not even the
shortest span will probably pass this proof, the guards are expanded over it into their Taylor series, whose first zero
is the event.

Not done, since it gains too little: to leave the fastest pairs of modes out of the guards, and subtract a bound of what
they can add instead. Longer spans then pass, but that costs about as much time as it saves (load x lash and a car take
0.96 of the time, ramps 1.05, two lashes 1.04).

Between its parts a step keeps OF_SEEN rows of lanes in `Workspace.seen` for each functional that it evaluates: those of
the regime's table, which are its guards and what else makes a margin, and behind these each lash's acceleration.
"""

import numpy as np

from clunk.core.events import INSTANT
from clunk.core.exact import curves, functionals, moving, rows, taylor
from clunk.core.exact.curves import load_curve
from clunk.core.exact.flows import TERMS
from clunk.core.exact.margins import label_hangs_on_depth
from clunk.core.exact.workspace import GRAZING, OF_SEEN, Workspace, field, field_of, set_field, shortest_span, system_of
from clunk.core.jit import inlined_part, part
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import push, push_all, put_back
from clunk.core.lanes.vectors import Vector
from clunk.core.regimes import ROUNDING, lash_of
from clunk.core.rubbing import WITHIN
from clunk.core.status import QUALITY_GRAZING
from clunk.core.sums import copy
from clunk.core.tables import ACCELERATION, GAP

_ALL_BUT_ZERO = 1e-9  # of the gap: rigid flanks that are nearer as a stretch begins rest on each other
_NEXT_TRY = 0.4  # the longest span that is proposed after one whose proof failed, as a share of that one

# Rows of a functional in `seen`: from _START and _END on its `Curve` at the step's beginning and end, its sway, and the
# least and the greatest of `curves.between`.
_START, _SWAY, _END, _LEAST, _GREATEST = 0, 5, 6, 11, 12


@inlined_part
def take_step(space: Workspace, group: int, short: bool, count: int) -> None:
    """Take a step with the `count` runs taken from a queue: over a span or, if `short`, a part of the shortest one.

    Each lane has coordinates y at a time t of the stretch. With a functional's row c in the flow, its origin p and the
    inputs u, a guard is g(t) = sign (c · y + p(t) · u) + shift. From t on, the amplitudes of y give a bound of |c · y|,
    the sway, and bounds of the third and the sixth derivative of g. A span h is chosen for which an estimate from these
    stays positive; y becomes exp(Λ h) y; and h counts if the values, slopes and curvatures of g at t and t + h, and the
    bound of its sixth derivative, prove that g was positive in between. A part of the shortest span ends at the first
    zero of the Taylor series of g or, without one, where it was to end.

    Each run then waits in the queue of its next step, or in `follow`, or for its searches to finish; in the last two
    cases RUN's `ended` says how the step ended. A run whose proof failed stays where it was, and tries a shorter span
    next.

    group : the group of regimes that all these runs are in
    """
    system, flows, pool = space.system, space.flows, space.pool
    regime = system.leaders[group]
    flow = system.regimes[regime].flow
    zero, present = vectors.splat(0.0), (1 << count) - 1
    shortest, elapsed = shortest_span(space, flow), field(space, rows.ELAPSED)
    time_left = field(space, rows.LIMIT) - elapsed

    moving.measure(pool.work, space.behind, space.amplitudes)
    _evaluate(space, regime, _START)
    kinks, at_most = 0, field(space, rows.TRY)
    settled = _stays(space, regime) & present if flows.steady[0, flow] else 0
    if space.loads.shape[1] > 1:
        kinks = field(space, rows.KINK) > 0.0
        settled &= ~kinks
        at_most = vectors.choose(kinks, vectors.smaller(at_most, time_left), at_most)
    there = present & ~settled

    event, part, k, ends, lost, grazing, blocked = zero - 1.0, zero, zero, 0, 0, 0, 0
    if short:
        left = vectors.smaller(time_left / shortest, 1.0)
        event, part, lost, grazing = _find_event(space, regime, there, left)
        ends = (time_left <= shortest) & (part == left) & there
        h = shortest * part
    else:
        h, k, blocked = _propose_span(space, regime, at_most)
        blocked &= there
    advancing = there & ~blocked & ~lost

    # All lanes are moved, also those that will not be put back. Until `put_back`, `pool.work` holds the step's end, and
    # `space.numbers` its beginning, where the searches of this step begin.
    moving.move(space, flow, short, k, part)
    elapsed += h
    set_field(space, rows.ELAPSED, elapsed)

    failed, close = _prove(space, regime, h)
    # A part of the shortest span was proved by `_find_event`. A span beyond the end of the run counts as failed, so
    # that no event depends on where that end is; beyond a kink of the load no span is proposed.
    failed = 0 if short else (failed | (h > time_left)) & advancing
    advancing &= ~failed
    searching = _find_turns(space, regime, event, h, advancing)
    set_field(space, rows.ZERO_ORDER, zero)
    next_try = vectors.choose(failed, _NEXT_TRY * h, np.inf)
    set_field(space, rows.TRY, next_try)
    happened = (event >= 0.0) & advancing
    arrived = ends & kinks & ~lost
    if happened | arrived:
        moving.to_states(space, flow, happened | arrived)
    changing = space.behind + rows.of_lash(system.lash_count - 1) + rows.MARGIN
    put_back(pool, pool.work, space.numbers, changing, advancing)
    if happened:
        searching |= _find_depths(space, regime, event, happened)

    special = (settled | lost | ends | grazing | happened | searching) & present
    close = close if flows.modal[0, flow] else -1  # without modes only the shortest span can be taken
    push_all(pool, space.queues.short + group, (blocked | close & advancing) & ~special)
    push_all(pool, space.queues.span + group, (advancing & ~close | failed) & ~special)
    push_all(pool, space.queues.follow, special & ~searching)
    noted = special | failed
    if not noted:
        return
    # how the step ended: by the first of settled, lost, event, end and near zero that holds
    ended = vectors.choose(close, float(rows.NEARS), float(rows.GOES_ON))
    ended = vectors.choose(happened, float(rows.BY_EVENT), vectors.choose(ends, float(rows.AT_END), ended))
    ended = vectors.choose(settled, float(rows.SETTLED), vectors.choose(lost, float(rows.LOST), ended))
    vectors.store(space.notes, 0, (ended, event, next_try))
    while noted:
        lane = vectors.first_of(noted)
        noted &= noted - 1
        slot = pool.items[lane]
        run = space.runs[slot]
        run.ended, run.guard = int(space.notes[0, lane]), int(space.notes[1, lane])
        run.quality |= QUALITY_GRAZING * (grazing >> lane & 1)
        space.fields[slot, rows.TRY] = space.notes[2, lane]


@inlined_part
def _evaluate(space: Workspace, regime: int, row: int) -> None:
    """Evaluate the functionals at the step's beginning or end, and widen the windows by the accelerations there.

    A guard that is known to be zero at the beginning, with a slope that is not, is set to zero to the last bit. Bounds
    of derivatives, which hold from the beginning on, are used from the end on, too.

    row : _START or _END, where in `seen` the results are written
    """
    system, seen, entered = space.system, _functionals_seen(space, regime), space.system.regimes[regime]
    for n in range(seen):
        f = _functional(space, regime, n)
        if n < entered.watched and system.guards[regime, n].first_alike < n:
            continue
        away, sway = functionals.evaluate(space, entered.flow, f)
        origin = _origin(space, entered.flow, f)
        for m in range(n, seen):  # all guards of the same functional
            if _functional(space, regime, m) == f:
                curve = curves.as_guard(away, origin, _sign(space, regime, m), _shift(space, regime, m))
                vectors.store(space.seen, m * OF_SEEN + row, curve)
                if row == _START:
                    vectors.store(space.seen, m * OF_SEEN + _SWAY, sway)
                    zero = _zero_order(space, m) == 1.0
                    vectors.store(space.seen, m * OF_SEEN + row, vectors.choose(zero, 0.0, curve.value))
        if n >= entered.watched:
            window, value = rows.of_lash(n - entered.watched), vectors.load(space.seen, n * OF_SEEN + row)
            high, low = window + rows.WINDOW_MAX, window + rows.WINDOW_MIN
            set_field(space, high, vectors.larger(field(space, high), value))
            set_field(space, low, vectors.smaller(field(space, low), value))


@inlined_part
def _functionals_seen(space: Workspace, regime: int) -> int:
    """Number of functionals that a step evaluates: the regime's, and the accelerations unless touches are impulsive."""
    return space.system.regimes[regime].watched + space.system.lash_count * (1 - space.system.impulsive)


@inlined_part
def _functional(space: Workspace, regime: int, n: int) -> int:
    """The functional that is number n in `Workspace.seen`."""
    system, watched = space.system, space.system.regimes[regime].watched
    if n < watched:
        return system.guards[regime, n].functional
    return (n - watched) * system.functionals_per_lash + ACCELERATION


@inlined_part
def _origin(space: Workspace, flow: int, f: int) -> curves.Origin:
    """The origin of a functional at the time ELAPSED."""
    return functionals.origin(space, flow, f, space.inputs_at, field(space, rows.ELAPSED))


@inlined_part
def _sign(space: Workspace, regime: int, n: int) -> Vector:
    """The sign of the functional in guard n; 1 for an acceleration."""
    if n >= space.system.regimes[regime].watched:
        return vectors.splat(1.0)
    lash, sign = lash_of(space.system, regime, n), space.system.guards[regime, n].sign
    return field_of(space, rows.SIDE, lash) * sign if lash >= 0 else vectors.splat(sign)


@inlined_part
def _shift(space: Workspace, regime: int, n: int) -> Vector:
    """The shift of guard n; 0 for an acceleration."""
    if n >= space.system.regimes[regime].watched:
        return vectors.splat(0.0)
    return field(space, rows.shift(n, space.system.lash_count))


@inlined_part
def _lash(space: Workspace, regime: int, n: int) -> int:
    """The lash whose margin guard n makes; 0, with no meaning, for a guard of no lash."""
    return max(lash_of(space.system, regime, n), 0)


@inlined_part
def _scale(space: Workspace, regime: int, n: int) -> Vector:
    """The scale of the margin of guard n; 0 where it makes none."""
    return field_of(space, rows.SCALE, _lash(space, regime, n)) * float(space.system.guards[regime, n].makes_margin)


@inlined_part
def _bar(space: Workspace, regime: int, n: int) -> Vector:
    """The margin's magnitude in units of guard n.

    Only a guard that turns back below it, or that goes less deep than it at an event, makes the margin smaller.
    """
    return vectors.magnitude(field_of(space, rows.MARGIN, _lash(space, regime, n))) * _scale(space, regime, n)


@inlined_part
def _zero_order(space: Workspace, n: int) -> Vector:
    """Number of derivatives of guard n, itself included, that are zero at the step's beginning."""
    return vectors.choose(field(space, rows.ZERO_GUARD) == float(n), field(space, rows.ZERO_ORDER), 0.0)


@inlined_part
def _stays(space: Workspace, regime: int) -> int:
    """Lanes where nothing that counts can follow: no event, no near miss, and no acceleration beyond its window.

    Proved, for as long as the load does not change, from the origins and sways.
    """
    stays, watched = -1, space.system.regimes[regime].watched
    for n in range(_functionals_seen(space, regime)):
        if not stays:
            break
        origin = _origin(space, space.system.regimes[regime].flow, _functional(space, regime, n))
        sway = vectors.load(space.seen, n * OF_SEEN + _SWAY)
        if n < watched:
            least = _sign(space, regime, n) * origin.value + _shift(space, regime, n) - sway
            stays &= (least > 0.0) & (least >= _bar(space, regime, n))
        else:
            stays &= origin.value + sway <= field_of(space, rows.WINDOW_MAX, n - watched)
            stays &= origin.value - sway >= field_of(space, rows.WINDOW_MIN, n - watched)
    return stays


@inlined_part
def _propose_span(space: Workspace, regime: int, at_most: Vector) -> tuple[Vector, Vector, int]:
    """The longest span of the ladder in which, by `curves.guess`, no guard turns negative.

    at_most : the longest span that may be proposed  [s]

    Returns
    -------
    h, k : Vector
        The span, and its number on the ladder.
    blocked : int
        The lanes where not even the shortest span will probably pass.
    """
    count, rungs = space.system.regimes[regime].guards, space.flows.span.shape[2] // 2
    h, k = shortest_span(space, space.system.regimes[regime].flow), vectors.splat(0.0)
    passes = _passes(space, count, h, at_most)
    for n in range(count):  # one that is zero with its slope is left to its series
        passes &= (vectors.load(space.seen, n * OF_SEEN + _START) >= 0.0) & ~(_zero_order(space, n) > 1.0)
    blocked = ~passes
    while rungs > 0:  # bisection of the ladder, which has two spans an octave
        longer = h * (float(1 << rungs // 2) if rungs > 1 else 1.5)
        passes = _passes(space, count, longer, at_most)
        h, k = vectors.choose(passes, longer, h), vectors.choose(passes, k + float(rungs), k)
        rungs //= 2
    return h, k, blocked


@inlined_part
def _passes(space: Workspace, count: int, h: Vector, at_most: Vector) -> int:
    """Lanes where h is at most `at_most`, and the first `count` guards are positive after h by `curves.guess`."""
    passes = h <= at_most
    for n in range(count):
        passes &= curves.guess(load_curve(space.seen, n * OF_SEEN + _START), h) > 0.0
    return passes


@inlined_part
def _find_event(space: Workspace, regime: int, there: int, part: Vector) -> tuple[Vector, Vector, int, int]:
    """Prove that no guard turns negative within a part of the shortest span, or find the first that does.

    A guard whose lower bound `curves.low` is positive stays positive; any other is expanded into its Taylor series. So
    is a guard that a jump of the load has made negative, though it may rise again, or that is zero with its slope.

    there : the lanes to look at
    part : how far to look, as a share of the shortest span

    Returns
    -------
    event, part : Vector
        The guard of the first event, or -1; and the part of the shortest span up to this event, or up to which it is
        proved that there is none.
    lost, grazing : int
        The lanes where a guard is not finite, and where a guard turned back so little below zero that it does not count
        as negative.
    """
    system, flow = space.system, space.system.regimes[regime].flow
    shortest, event, lost, grazing = shortest_span(space, flow), vectors.splat(-1.0), 0, 0
    for n in range(system.regimes[regime].guards):
        guard, order = system.guards[regime, n], _zero_order(space, n)
        start = load_curve(space.seen, n * OF_SEEN + _START)
        near = there & (~(curves.low(start, shortest) > 0.0) | (start.value < 0.0) | (order >= 2.0))
        if not near:
            continue
        sign, shift = _sign(space, regime, n), _shift(space, regime, n)
        scale = _scale(space, regime, n) if guard.lash >= 0 else vectors.magnitude(shift)
        origin = _origin(space, flow, guard.functional)
        noise = ROUNDING * functionals.expand(space, flow, guard.functional, sign, shift, origin)
        if system.element_count > 1:  # an event of another element at the same time may have been located first
            instant = vectors.magnitude(vectors.load(space.series, 1)) * (INSTANT / shortest)
            instant = vectors.choose(field(space, rows.ELAPSED) == 0.0, instant, 0.0)
            noise = vectors.larger(noise, instant)
        of_slope = 4.0 * noise + ROUNDING * vectors.magnitude(shortest * origin.slope)
        crosses, bad, grazes, s, known = _first_zero(space, near, order, noise, of_slope, shift, scale, part)
        lost |= bad
        grazing |= grazes
        event, part = vectors.choose(known < part, -1.0, event), known
        crosses &= (event < 0.0) | (s < part)
        event, part = vectors.choose(crosses, float(n), event), vectors.choose(crosses, s, part)
    return event, part, lost, grazing


@inlined_part
def _first_zero(
    space: Workspace,
    near: int,
    order: Vector,
    noise: Vector,
    of_slope: Vector,
    shift: Vector,
    scale: Vector,
    part: Vector,
) -> tuple[int, int, int, Vector, Vector]:
    """The first zero of a guard, whose series is `Workspace.series`, within a part of the shortest span.

    near : the lanes to look at
    order : how many of the guard's derivatives are zero at the beginning, itself included
    noise, of_slope : rounding of the guard, and of its coefficients c1 to c3 in the series
    shift : of the guard, such as half a gap or a breakpoint  [rad], or a torque  [N m]
    scale : of which GRAZING and `rubbing.WITHIN` are shares; 0 for a lash's guard that makes no margin
    part : how far to look, as a share of the shortest span

    Returns
    -------
    crosses, lost, grazes : int
        The lanes where the guard turns negative; where it is not finite; and where it turns back within GRAZING below
        zero, which does not count as negative.
    s, part : Vector
        The zero; and, where there is none, the part within which this is proved. In shares of the shortest span.
    """
    c = space.series
    start = vectors.load(c, 0)
    lost = near & ~(start - start == 0.0)
    near &= ~lost
    within = vectors.larger(noise, WITHIN * scale)
    rests = within
    if not space.system.impulsive:  # only what rounding leaves of a gap, as overlaps can be much smaller than gaps
        rests = of_slope = 16.0 * ROUNDING * vectors.magnitude(shift)
    known_order = order > 0.0
    starts = known_order | (start <= noise) & (start >= -within)
    order = vectors.choose(starts & ~known_order, 1.0, order)
    still = starts | (vectors.magnitude(start) <= rests)
    # Rigid flanks may part with a slope and a curvature of zero, too: at rest while others rebound, or where the torque
    # that held them is zero. Each coefficient within rounding then raises the order.
    for n in range(1, 4):
        size = vectors.magnitude(vectors.load(c, n))
        still &= size <= vectors.larger(of_slope, rests)
        starts &= -space.system.impulsive & (size <= of_slope)
        order = vectors.choose(starts, vectors.larger(order, n + 1.0), order)
    # Flanks whose guard stays zero move together, and nothing presses them on each other: damping may have left nothing
    # of an overlap. So do those whose guard is so near to zero that the rounding of earlier phases, which `noise` does
    # not know, may have made it.
    near &= ~still
    for n in range(3):  # zeros at the beginning are divided out of the series
        shifted = order > float(n)
        if not shifted:
            break
        for j in range(TERMS):
            vectors.store(c, j, vectors.choose(shifted, vectors.load(c, j + 1), vectors.load(c, j)))
    crosses, s, fall, half, part = taylor.first_zero(c, near, part)
    # a guard that is zero at the beginning can turn back within GRAZING only if it falls at once, by its slope there
    start = vectors.load(c, 0)
    fall = vectors.choose(order > 0.0, start, fall)
    bend = vectors.choose(order > 0.0, 2.0 * vectors.load(c, 1), 2.0 * half)
    tangent = (s > 0.0) | (order > 0.0) | (start >= -within)
    tangent &= (bend > 0.0) & (order < 2.0) & (fall * fall <= 2.0 * bend * GRAZING * scale)
    return crosses & ~tangent, lost, crosses & tangent, s, part


@inlined_part
def _prove(space: Workspace, regime: int, h: Vector) -> tuple[int, int]:
    """Evaluate the functionals at the step's end, and prove that the guards stayed positive over its time h.

    `_propose_span` has checked that they are not negative at the beginning; `curves.between` bounds them in between.

    Returns
    -------
    failed : int
        The lanes where a guard is not proved to have stayed positive.
    close : int
        The lanes where not even the shortest span will probably pass next.
    """
    seen, entered = space.seen, space.system.regimes[regime]
    shortest, failed, close = shortest_span(space, entered.flow), 0, 0
    _evaluate(space, regime, _END)
    for n in range(_functionals_seen(space, regime)):
        row = n * OF_SEEN
        start, end = load_curve(seen, row + _START), load_curve(seen, row + _END)
        least, greatest = curves.between(start, end, h)
        vectors.store(seen, row + _LEAST, (least, greatest))
        if n < entered.guards:
            close |= curves.guess(end, shortest) <= 0.0
            failed |= ~(vectors.smaller(least, end.value) > 0.0)
    return failed, close


@inlined_part
def _find_turns(space: Workspace, regime: int, event: Vector, h: Vector, advancing: int) -> int:
    """Begin the searches for turns that may count within a step of time h; return the lanes that have any.

    A turn counts where an acceleration is beyond its window, or a guard so low that the near miss makes the margin
    smaller. Guards that are zero with their slope at the beginning are passed over, since rounding would make a turn
    there. So are gaps of rigid flanks that are all but zero as a stretch begins: these flanks rest on each other, or
    have been moved apart beside others.

    event : the guard of each lane's event, or -1
    """
    system, elapsed, turns = space.system, field(space, rows.ELAPSED), 0
    watched = system.regimes[regime].watched
    for n in range(_functionals_seen(space, regime)):
        row = n * OF_SEEN
        start, end = load_curve(space.seen, row + _START), load_curve(space.seen, row + _END)
        least, greatest = vectors.load(space.seen, row + _LEAST), vectors.load(space.seen, row + _GREATEST)
        may, counts = advancing, vectors.splat(np.inf)
        if n < watched:
            held_from = field_of(space, rows.HELD_FROM, _lash(space, regime, n))
            counts = elapsed - held_from
            may &= (counts > 0.0) & (_scale(space, regime, n) > 0.0) & ~(event == float(n))
            is_zero = _zero_order(space, n) > 1.0
            if system.impulsive and _functional(space, regime, n) % system.functionals_per_lash == GAP:
                all_but = ~(start.value == 0.0) & (start.value <= _ALL_BUT_ZERO * _scale(space, regime, n))
                is_zero |= all_but & (elapsed <= h)
            may &= ~(is_zero & (held_from <= 0.0))
            may &= vectors.smaller(vectors.smaller(start.value, end.value), least) < _bar(space, regime, n)
        else:
            high = field_of(space, rows.WINDOW_MAX, n - watched)
            low = field_of(space, rows.WINDOW_MIN, n - watched)
            may &= (greatest > high) | (least < low)
        if may:
            monotone, bends_down = curves.turns_not(start, end, h)
            may &= ~(monotone | bends_down if n < watched else monotone)
        if may:
            _begin_search(space, regime, n, may, h, elapsed - h, counts, False)
        turns |= may
    return turns


@part
def _begin_search(
    space: Workspace, regime: int, n: int, mask: int, time_left: Vector, began: Vector, counts: Vector, deep: bool
) -> None:
    """Begin to search, in some lanes, the turns of functional n within the step, or how deep it goes after the step.

    A search begins at the state in the run's row of `Workspace.numbers`: called before `put_back` that is the beginning
    of the step, called after `put_back` its end.

    mask : the lanes
    time_left, began, counts : TIME_LEFT, STRETCH_TIME and COUNTS of the searches, see `rows`  [s]
    deep : whether to search the depth
    """
    system, infinite, watched = space.system, vectors.splat(np.inf), space.system.regimes[regime].watched
    search, top, bottom, until = n - watched, infinite, infinite, -infinite
    if n >= watched:
        top, bottom = field_of(space, rows.WINDOW_MAX, search), field_of(space, rows.WINDOW_MIN, search)
    elif deep:
        search, until = space.searches_each - 1, -_bar(space, regime, n)
    else:
        search, bottom = system.lash_count + n, _bar(space, regime, n)
    sign, shift = _sign(space, regime, n), _shift(space, regime, n)
    vectors.store(space.notes, 0, (time_left, began, top, bottom, sign, shift, counts, until))  # in the order of `rows`
    queue = space.queues.search + system.regimes[regime].flow * space.flows.watch.shape[2]
    while mask:
        lane = vectors.first_of(mask)
        mask &= mask - 1
        slot = space.pool.items[lane]
        item = slot * space.searches_each + search
        copy(space.numbers[slot, : space.behind], space.searches[item])
        for k in range(rows.OF_A_SEARCH):
            space.searches[item, space.behind + k] = space.notes[k, lane]
        copy(space.weighed[slot], space.searches[item, space.behind + rows.OF_A_SEARCH :])
        space.runs[slot].searches += 1
        push(space.pool, queue + _functional(space, regime, n), item)


@inlined_part
def _find_depths(space: Workspace, regime: int, event: Vector, happened: int) -> int:
    """Begin to search how deep the guards of events would go, where a label hangs on that; return these lanes.

    A depth is searched over a time as long as a run: a guard that has not turned back by then is taken never to do so.
    """
    depths, elapsed, infinite = 0, field(space, rows.ELAPSED), vectors.splat(np.inf)
    for n in range(space.system.regimes[regime].guards):
        end, mask = load_curve(space.seen, n * OF_SEEN + _END), 0
        among = happened & (event == float(n)) & (_scale(space, regime, n) > 0.0)
        among &= ~(curves.falls_by(end) >= _bar(space, regime, n))  # others certainly go deeper than the margin so far
        while among:
            lane = vectors.first_of(among)
            among &= among - 1
            slot = space.pool.items[lane]
            mask |= label_hangs_on_depth(space, slot, n) << lane
            space.notes[0, lane] = system_of(space, slot).end_time[0]
        depths |= mask
        if mask:
            _begin_search(space, regime, n, mask, vectors.load(space.notes, 0), elapsed, infinite, True)
    return depths
