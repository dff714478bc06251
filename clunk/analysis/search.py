"""Searches for the values at which an outcome of runs changes: many cells side by side, one batch of runs per step.

A cell is the set of runs that differ in the searched value alone: those of one driveline, or on one line across a map.
`with_hidden` goes through the known points of each cell in the order of their values, and runs further points where the
outcome may change and change back between two of them. Two neighbours of different outcome are a bracket, and `narrow`
narrows the brackets.

The outcomes at its ends decide what becomes of a bracket; the measure, a number of the runs such as the margin or the
excess of a severity over its bound, says where to run next. Where it changes sign between the ends, the next two runs
are on either side of the zero of the secant through them, else one is in the middle. As the measure may belong to
another change, or jump at this one, a bracket that a step has not halved is bisected in the next.
A bracket with further outcomes in it becomes several. A caller that knows more about the place of a change may guess it
first.

A search ends: of two steps in a row one halves a bracket at least, but for `_GUESSES` guesses for each two outcomes;
and where a bracket becomes more brackets than a number that is given beforehand, these are left as they are. In search
of hidden outcomes, at most `_LOOKED` runs are made between two points, and those of one more halving.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor

import numpy as np

from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import Results
from clunk.results.quantities import CHATTER, TEXT, YES_NO, Quantity, measuring
from clunk.study.arrays import Array, Bools, Codes, Floats, Records, record_of
from clunk.study.axes import ResultAxes, ResultAxis
from clunk.study.designs import design_of
from clunk.study.errors import ClunkError, ConfigError
from clunk.study.parameters import located
from clunk.study.rules import count_of_flows, count_of_regimes
from clunk.study.study import Study
from clunk.sweeping.progress import Progress, unseen
from clunk.sweeping.runner import Runner

# A run of a cell at a value: the code of its outcome; its measure, a number that changes sign where the outcome does,
# NaN where none is known; and its number of touches.
POINT = record_of(cell="i8", value="f8", outcome="i8", measure="f8", touches="i8")
Points = Records  # POINT
Run = Callable[
    [Codes, Floats], Points
]  # runs cells at values, (n,) each; it need not set these two fields of its points

TOLERANCE = 1e-9  # of the span, the greatest width of a narrowed bracket
# likewise with a failed run at one end: where runs begin to fail says how far they were followed, which is no physics,
# and runs of 10⁵ events take half a second each
OFF_FAILURES = 1e-3
_TOUCHES_OF_A_RUN = 50  # touches that count as one more run
_TOUCHES = 2  # difference in touches of two neighbours from which on thresholds may be hidden between them
_STEEPER = 2.0  # times the slope between known points, as the measure may be steeper between them
_LOOKED = 64  # most runs between two points in search of hidden outcomes, but for those of the last halving
_BESIDE = 0.45  # tolerances, least distance of two runs from the expected place: a bracket of the two is narrow enough
_BENT = 0.2  # times the bracket's width squared over the span, by which the zero of a secant may be off
_GUESSES, _FURTHER = 2, 10.0  # guesses for the same two outcomes; factor on the distance of runs from the second
_STALLED = 0.5  # of its width, to which a step has to narrow a bracket; otherwise the next step is a bisection


# --- Axes of a search


def grid_axes(study: Study, what: str) -> ResultAxes:
    """Axes of a study's grid, between whose values thresholds or boundaries lie.

    what : these, as a message's first word

    Raises ClunkError where the study sweeps no grid.
    """
    swept = study.swept
    if not swept.axes or swept.samples or swept.design == "zip":
        raise ClunkError(
            f"{what} lie between the values of a grid: the config needs [[sweep.axes]], and neither [[sweep.samples]] "
            'nor design = "zip".'
        )
    return design_of(study).axes


def check_axis(study: Study, axis: ResultAxis, what: str) -> None:
    """Raise ClunkError where an axis is of whole numbers, or has one value or the same one twice."""
    is_whole = located(study, axis.parameter)[1].whole
    if is_whole or len(np.unique(axis.values)) < max(len(axis), 2):
        lies = "is a whole number, between whose values nothing lies" if is_whole else "has one value, or one twice"
        raise ClunkError(f"{what} along {axis.parameter} lie between two values or more, and it {lies}.")


# --- Brackets


def with_hidden(
    points: Points, run: Run, halvings: int, may_run: Callable[[], bool] = lambda: True
) -> tuple[Points, Codes]:
    """Add points between neighbours of the same outcome where other outcomes may be hidden.

    Returns the points with the added ones, (m,), in the same order, and the number of the given point at or before each
    of them, (m,).

    points : (n,) in the order of cells and, in each, of values
    halvings : most halvings of the spacing between two points
    may_run : called before each batch; once it returns False no more points are added
    """
    before, looked = np.arange(points.size), np.zeros(points.size, np.int64)
    for _ in range(halvings):
        between = np.flatnonzero(_may_hide(points))
        between = between[looked[before[between]] < _LOOKED]
        if not between.size or not may_run():
            break
        cells, middles = points["cell"][between], 0.5 * (points["value"][between] + points["value"][between + 1])
        runs = run(cells, middles)
        runs["cell"], runs["value"] = cells, middles
        np.add.at(looked, before[between], 1 + runs["touches"] // _TOUCHES_OF_A_RUN)
        points, before = np.insert(points, between + 1, runs), np.insert(before, between + 1, before[between])
    return points, before


def _may_hide(points: Points) -> Bools:
    """Whether thresholds may be hidden between each point and the next, (n - 1,): both of one cell and one outcome."""
    left, right = points[:-1], points[1:]
    alike = (left["cell"] == right["cell"]) & (left["outcome"] == right["outcome"]) & (left["outcome"] != FAILED_CODE)
    hidden = abs(right["touches"] - left["touches"]) >= _TOUCHES
    width, least = right["value"] - left["value"], abs(points["measure"])
    with np.errstate(invalid="ignore"):  # 0/0 where a bracket begins at a known point
        slope = abs(np.diff(least)) / width
    # whatever the signs: across a sliver a margin may pass from an event not reached to one that was passed
    is_dip = alike[:-1] & alike[1:] & (least[1:-1] <= np.minimum(least[:-2], least[2:]))
    slope = _STEEPER * np.maximum(slope[:-1], slope[1:])
    hidden[:-1] |= is_dip & (least[1:-1] < slope * width[:-1])
    hidden[1:] |= is_dip & (least[1:-1] < slope * width[1:])
    return alike & hidden


def _changes(points: Points, parts: Codes) -> Codes:
    """Positions of the points (n,) whose outcome differs from that of the next point, if both are in one part (n,)."""
    return np.flatnonzero((parts[:-1] == parts[1:]) & (points["outcome"][:-1] != points["outcome"][1:]))


def narrow(
    points: Points,
    run: Run,
    most: int,
    span: float = 1.0,
    may_run: Callable[[], bool] = lambda: True,
    tolerances: Floats | None = None,
    guess: Callable[[Points], Floats] | None = None,
) -> tuple[Points, Points]:
    """Narrow the brackets between neighbouring points of different outcome to `TOLERANCE` of the span.

    Returns the lower and the upper ends of the narrowed brackets, in the order of cells and values. Brackets with a
    failed run at one end are narrowed to `OFF_FAILURES` of the span only.

    points : (n,) in the order of cells and, in each, of values
    most : brackets that one of the first brackets may become; where it becomes more, all are returned as wide as they
        are then
    may_run : called before each batch; once it returns False, all brackets are returned as wide as they are then
    tolerances : greatest width of a narrowed bracket in each cell, in place of `TOLERANCE` of the span
    guess : returns, for brackets, (n, 2) POINT, the values at which outcomes are expected to change and how far off
        these may be, (n, 2), NaN where unknown; called `_GUESSES` times at most for the same two outcomes
    """
    ends = points.take(_changes(points, points["cell"])[:, None] + np.arange(2))
    may_guess = 0 if guess is None else _GUESSES
    guesses = np.full(len(ends), may_guess)  # guesses left for each bracket
    is_slow, narrowed = np.zeros(len(ends), bool), [ends[:0]]
    origin, begun = np.arange(len(ends)), len(ends)  # the first bracket that each bracket is a part of
    finished = np.zeros(begun, np.int64)  # finished parts of each first bracket
    while True:
        low, high = ends["value"].T
        width, middle = high - low, 0.5 * (low + high)
        has_failed = (ends["outcome"] == FAILED_CODE).any(axis=1)
        tolerance = TOLERANCE * span if tolerances is None else tolerances[ends["cell"][:, 0]]
        wide = width > np.where(has_failed, OFF_FAILURES * span, tolerance)
        wide &= (low < middle) & (middle < high) & may_run()
        rest = np.flatnonzero(wide)  # of records, `take` needs a tenth of the time of indexing
        finished += np.bincount(origin[~wide], minlength=begun)
        crowded = finished + np.bincount(origin[rest], minlength=begun) > most
        rest = rest[~crowded[origin[rest]]]
        narrowed.append(np.delete(ends, rest, axis=0))
        ends, is_slow, guesses, origin = ends.take(rest, axis=0), is_slow[rest], guesses[rest], origin[rest]
        low, high, width, middle = (each[rest] for each in (low, high, width, middle))
        tolerance = np.broadcast_to(tolerance, wide.shape)[rest]
        if not len(ends):
            break
        first, last = ends["measure"].T
        with np.errstate(invalid="ignore", divide="ignore"):  # the zero of the secant through the ends
            place = np.where(first * last <= 0.0, low - first * width / (last - first), np.nan)
        off = np.maximum(_BENT / span * width**2, _BESIDE * tolerance)
        halved = is_slow | np.isnan(place)
        if guess is not None and guesses.any():
            asked = np.flatnonzero(guesses)
            guessed, apart = guess(ends[asked]).T
            apart = np.maximum(apart, _BESIDE * tolerance[asked]) * _FURTHER ** (_GUESSES - guesses[asked])
            is_within = (low[asked] < guessed + apart) & (guessed - apart < high[asked]) & (apart < 0.25 * width[asked])
            asked, guessed, apart = asked[is_within], guessed[is_within], apart[is_within]
            place[asked], off[asked] = guessed, apart
            halved[asked] = False
        values = place[:, None] + off[:, None] * [-1.0, 1.0]
        values[halved] = middle[halved, None] * [1.0, np.nan]
        rows, columns = np.nonzero((low[:, None] < values) & (values < high[:, None]))
        cells, new = ends["cell"][rows, 0], values[rows, columns]
        runs = run(cells, new)
        runs["cell"], runs["value"] = cells, new
        points, bracket = np.concatenate([ends.ravel(), runs]), np.append(np.arange(len(ends)).repeat(2), rows)
        order = np.lexsort((points["value"], bracket))
        points, bracket = points.take(order), bracket[order]
        at = _changes(points, bracket)
        former, bracket = ends, bracket[at]
        ends = points.take(at[:, None] + np.arange(2))
        is_other = (ends["outcome"] != former["outcome"][bracket]).any(axis=1)
        guesses = np.where(is_other, may_guess, np.maximum(guesses[bracket] - 1, 0))
        is_slow = ends["value"][:, 1] - ends["value"][:, 0] > _STALLED * width[bracket]
        origin = origin[bracket]
    ends = np.concatenate(narrowed)
    low, high = ends[np.lexsort((ends["value"][:, 0], ends["cell"][:, 0]))].T
    return low, high


# --- Runs


Word = str | bool | int  # an outcome: a label, whether something holds, or a count

_STEPS = 100  # time steps of a run that take as long as one unit of `PointRuns.cost`


def in_halves(run: Callable[[Floats], Array], points: Floats, refused: Array) -> Array:
    """Results of `run` at points, halved where it raises ConfigError; for one that no config may hold, `refused`.

    Between two allowed values there may be one that is not allowed, such as a ratio of zero.
    """
    try:
        return run(points)
    except ConfigError:
        if len(points) == 1:
            return refused
        return np.concatenate([in_halves(run, part, refused) for part in np.array_split(points, 2)])


def _failed(count: int) -> Points:
    points = np.zeros(count, POINT)
    points["outcome"], points["measure"] = FAILED_CODE, np.nan
    return points


class PointRuns:
    """Runs at points of some parameters, and the codes of their outcomes.

    study : Study
    parameters : dotted keys
    outcome : Quantity
    lash : position of the lash whose outcome it is
    engine : of threads
    words : outcomes whose codes are their positions here; further outcomes get the next codes
    progress : called as a batch begins, and after each part of it, with the number of points that have been run, and
        with 0 for their total, which is not known
    """

    def __init__(
        self,
        study: Study,
        parameters: Sequence[str],
        outcome: Quantity,
        lash: int,
        engine: Executor,
        *,
        words: Sequence[Word] = (),
        progress: Progress = unseen,
    ) -> None:
        self.runner = Runner(measuring(study, [outcome]), parameters, engine=engine)
        self.outcome, self._lash = outcome, lash + 1
        self._progress, self.count = progress, 0
        self.failures = Counter[Status]()  # number of runs by cause
        self._codes = {word: code for code, word in enumerate(words)}

    @property
    def cost(self) -> int:
        """Cost of a run without touches, relative to other studies; 23 for one lash by gap, no friction and no stages.

        The cost is greater where a run has more than `_STEPS` steps for each unit.
        """
        grid = self.runner.grid
        return max(round(grid.steps() / _STEPS), 20 + count_of_regimes(grid.study))

    @property
    def preparing(self) -> int:
        """Cost of preparing a driveline, in runs without touches; 0 where all runs share one driveline."""
        study = self.runner.study
        return bool(self.runner.grid.structural) * count_of_flows(study) * len(study.driveline.inertias) ** 2 // 6

    def __call__(self, values: Floats) -> Points:
        """Run points, (n, parameters), in their units."""
        return in_halves(self._run, values, _failed(1)) if len(values) else _failed(0)

    def _run(self, values: Floats) -> Points:
        results = self.runner.run(values, lambda done, _: self._progress(self.count + done, 0)).of_lash(self._lash)
        points = _failed(len(values))
        is_cut = results.status == Status.EVENT_BUFFER_FULL  # cut off after the most events that a run may have
        points["touches"] = np.where(is_cut, self.runner.study.solver.max_events, results.touches)
        finished = results.status == Status.OK
        outcomes = self.outcome.of_runs(results)[finished]
        # a condition on a quantity that is not defined is NaN, and does not hold
        words, inverse = np.unique(outcomes == 1.0 if self.outcome.type == YES_NO else outcomes, return_inverse=True)
        words = words.astype({TEXT: str, YES_NO: bool}.get(self.outcome.type, int))
        known = [self._codes.setdefault(word, len(self._codes)) for word in words.tolist()]
        points["outcome"][finished] = np.array(known, np.int64)[inverse]
        points["measure"][finished] = self._measure(results)[finished]
        self.failures.update(map(Status, results.status[~finished].tolist()))
        self.count += len(values)
        return points

    def _measure(self, results: Results) -> Floats:
        """Number of each run that changes sign where the outcome changes; NaN where none is known."""
        if self.outcome.name == CHATTER:
            return results.touches - results.primary_impacts - 0.5
        base = self.outcome.base
        if base is None or base.type in (TEXT, YES_NO):
            return results.margin
        return base.compared(results) - float(self.outcome.bound)

    @property
    def words(self) -> tuple[Word, ...]:
        """The outcome of each code."""
        return tuple(self._codes)
