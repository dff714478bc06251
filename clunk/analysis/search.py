"""Searches for the values at which an outcome of runs changes, in many cells side by side, a batch of runs a step.

A cell is whatever the runs differ in besides: a driveline, a line across a map. Known points of each, in the order of
their values, are looked through (`with_hidden`): where outcomes may change and change back between two of them, further
ones are run. Between neighbours of different outcome lies a bracket, which is narrowed (`narrow`).

What decides is the outcomes of a bracket's two ends. Where to look is said by a number of the runs (the margin, or how
much a severity exceeds its bound), if it changes sign with them: on either side of the place where the secant through
the ends is zero. As the number may belong to another change, or jump at this one, a bracket that has not been halved so
is halved next.
Where further outcomes lie within a bracket, it becomes several. Who knows more about where to look may say so first.

It ends: of two steps in a row one halves a bracket at least, but for `_GUESSES` of two outcomes, and where a bracket
becomes more than a number that is stated beforehand, those are given up as they are. Between two points `_LOOKED` runs,
and those of one halving more at most, look for what is hidden.
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

# A run of a cell at a value: the code of its outcome, a number that changes sign where that does, NaN where none is
# known, and its number of touches.
POINT = record_of(cell="i8", value="f8", outcome="i8", measure="f8", touches="i8")
Points = Records  # POINT
Run = Callable[[Codes, Floats], Points]  # runs cells at values, (n,) each; these need not be in its points

TOLERANCE = 1e-9  # of the span, the widest that a bracket ends
# likewise where runs begin to fail: that says how far they were followed, no physics, and runs of 10⁵ events take half
# a second each
OFF_FAILURES = 1e-3
_TOUCHES_OF_A_RUN = 50  # for so many more touches a run counts as one more run
_TOUCHES = 2  # by which neighbours differ where something may be hidden between them
_STEEPER = 2.0  # than between known values, as the number of the runs may fall between them
_LOOKED = 64  # runs between two points that look for what is hidden, but for those of the last halving
_BESIDE = 0.45  # tolerances from the expected place, so that a bracket of two such values is narrow
_BENT = 0.2  # times the bracket's width squared, by which a secant may be off
_GUESSES, _FURTHER = 2, 10.0  # times that a guess is tried, the second time so much further off
_STALLED = 0.5  # of its width, which a bracket is expected to fall below


# --- Axes along which is searched


def grid_axes(study: Study, what: str) -> ResultAxes:
    """Axes of a study's grid, between whose values thresholds or boundaries lie. Raises ClunkError where it is none."""
    swept = study.swept
    if not swept.axes or swept.samples or swept.design == "zip":
        raise ClunkError(
            f"{what} lie between the values of a grid: the config needs [[sweep.axes]], and neither [[sweep.samples]] "
            'nor design = "zip".'
        )
    return design_of(study).axes


def check_axis(study: Study, axis: ResultAxis, what: str) -> None:
    """Raise ClunkError where nothing lies between the values of an axis."""
    is_whole = located(study, axis.parameter)[1].whole
    if is_whole or len(np.unique(axis.values)) < max(len(axis), 2):
        lies = "is a whole number, between whose values nothing lies" if is_whole else "has one value, or one twice"
        raise ClunkError(f"{what} along {axis.parameter} lie between two values or more, and it {lies}.")


# --- Brackets


def with_hidden(
    points: Points, run: Run, halvings: int, may_run: Callable[[], bool] = lambda: True
) -> tuple[Points, Codes]:
    """Points (n,) and further ones where other outcomes may be hidden between two of them, in the same order.

    points : in the order of cells and, in each, of values
    halvings : of the spacing between two points
    may_run : asked before each batch

    Also returns the number of the point at or before each, (m,).
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
    """Whether thresholds may be hidden between each point and the next, of one cell and of the same outcome."""
    left, right = points[:-1], points[1:]
    alike = (left["cell"] == right["cell"]) & (left["outcome"] == right["outcome"]) & (left["outcome"] != FAILED_CODE)
    hidden = abs(right["touches"] - left["touches"]) >= _TOUCHES
    width, least = right["value"] - left["value"], abs(points["measure"])
    with np.errstate(invalid="ignore"):  # where a bracket begins at a known point
        slope = abs(np.diff(least)) / width
    # whatever the signs: across a sliver a margin may pass from what did not happen to what did
    is_dip = alike[:-1] & alike[1:] & (least[1:-1] <= np.minimum(least[:-2], least[2:]))
    slope = _STEEPER * np.maximum(slope[:-1], slope[1:])
    hidden[:-1] |= is_dip & (least[1:-1] < slope * width[:-1])
    hidden[1:] |= is_dip & (least[1:-1] < slope * width[1:])
    return alike & hidden


def _changes(points: Points, parts: Codes) -> Codes:
    """Positions of the points (n,) whose outcome differs from the next one's, where that is in the same part (n,)."""
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
    """Narrow the brackets between points of different outcome to `TOLERANCE` of the span, by cell and value.

    Returns their lower and their upper ends. Those of which one end is a failed run are narrowed to `OFF_FAILURES`.

    points : (n,) in the order of cells and, in each, of values
    most : that one of the brackets may become; those of one that becomes more are returned as wide as they are
    may_run : asked before each batch; once it says no, all brackets are returned as wide as they are
    tolerances : of each cell, in place of `TOLERANCE` of the span
    guess : of brackets, (n, 2) POINT, where outcomes are expected to change and how far off that may be, (n, 2), NaN
        where that is unknown; asked `_GUESSES` times for the same two outcomes
    """
    ends = points.take(_changes(points, points["cell"])[:, None] + np.arange(2))
    may_guess = 0 if guess is None else _GUESSES
    guesses = np.full(len(ends), may_guess)  # that are left
    is_slow, narrowed = np.zeros(len(ends), bool), [ends[:0]]
    origin, begun = np.arange(len(ends)), len(ends)  # of each bracket the one that it is a part of
    finished = np.zeros(begun, np.int64)  # parts of each
    while True:
        low, high = ends["value"].T
        width, middle = high - low, 0.5 * (low + high)
        has_failed = (ends["outcome"] == FAILED_CODE).any(axis=1)
        tolerance = TOLERANCE * span if tolerances is None else tolerances[ends["cell"][:, 0]]
        wide = width > np.where(has_failed, OFF_FAILURES * span, tolerance)
        wide &= (low < middle) & (middle < high) & may_run()
        rest = np.flatnonzero(wide)  # `take` does with records in a tenth of the time what indexing does
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
        with np.errstate(invalid="ignore", divide="ignore"):  # where the measure, linear between the ends, is zero
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

_STEPS = 100  # of a run that take as long as a unit of `PointRuns.cost`


def in_halves(run: Callable[[Floats], Array], points: Floats, refused: Array) -> Array:
    """Results of `run` at points, in parts where it raises ConfigError; of one that no config may hold it is `refused`.

    Between values that are allowed there may be some that are not, such as a ratio of zero.
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
    lash : position of the one whose outcome it is
    engine : of threads
    words : outcomes that have codes already; others get the next ones
    progress : called as a batch begins and after each part of it with the number of points that have been run, and 0
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
        """Cost of a run, relative to other studies': 23 of one lash by gap, without friction or stages."""
        grid = self.runner.grid
        return max(round(grid.steps() / _STEPS), 20 + count_of_regimes(grid.study))

    @property
    def preparing(self) -> int:
        """Cost of preparing a driveline, in runs without touches, where each run has its own."""
        study = self.runner.study
        return bool(self.runner.grid.structural) * count_of_flows(study) * len(study.driveline.inertias) ** 2 // 6

    def __call__(self, values: Floats) -> Points:
        """Run points, (n, parameters), in their units."""
        return in_halves(self._run, values, _failed(1)) if len(values) else _failed(0)

    def _run(self, values: Floats) -> Points:
        results = self.runner.run(values, lambda done, _: self._progress(self.count + done, 0)).of_lash(self._lash)
        points = _failed(len(values))
        is_cut = results.status == Status.EVENT_BUFFER_FULL  # after as many as there may be
        points["touches"] = np.where(is_cut, self.runner.study.solver.max_events, results.touches)
        finished = results.status == Status.OK
        found = self.outcome.of_runs(results)[finished]
        # what is not defined is NaN, of which nothing holds
        words, inverse = np.unique(found == 1.0 if self.outcome.type == YES_NO else found, return_inverse=True)
        words = words.astype({TEXT: str, YES_NO: bool}.get(self.outcome.type, int))
        known = [self._codes.setdefault(word, len(self._codes)) for word in words.tolist()]
        points["outcome"][finished] = np.array(known, np.int64)[inverse]
        points["measure"][finished] = self._measure(results)[finished]
        self.failures.update(map(Status, results.status[~finished].tolist()))
        self.count += len(values)
        return points

    def _measure(self, results: Results) -> Floats:
        """A number of each run that changes sign where the outcome changes, as far as one is known; else NaN."""
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
