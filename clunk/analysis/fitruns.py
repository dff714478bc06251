"""Runs of candidate drivelines at measured operating points: their sequences, and how far these are from the measured.

A candidate that misses a measured label is run at neighbouring operating points too, along one axis: the
measured value with which labels change most is a little smaller or greater. The least such change, in its logarithm,
that brings about the measured label is the distance: unlike a run's margin, which says how near *any* other label is,
and saturates, it speaks of the measured one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from difflib import SequenceMatcher

import numpy as np
import numpy.typing as npt

from clunk.analysis.measurements import Experiment
from clunk.core.sequence import OPPOSITE, label
from clunk.core.status import Status
from clunk.core.tile import LONGEST_PATTERN
from clunk.results.labels import FAILED, flanks_of_label
from clunk.results.quantities import measuring
from clunk.study.arrays import Floats, Patterns, Positions, Records
from clunk.study.axes import variable_of
from clunk.study.document import dotted
from clunk.study.errors import ClunkError
from clunk.study.keys import key_at
from clunk.study.parameters import located, nominal_value, parameters
from clunk.study.study import Study
from clunk.study.sweeps import Draw
from clunk.sweeping.progress import Progress
from clunk.sweeping.reduction import flanks_of
from clunk.sweeping.runner import Runner

# A candidate's run at a measured operating point: the flanks as bits behind a leading 1 (0: failed), the distance to
# the measured label, the signed change that brings it about (0: none does), the misfit of the impacts' measured
# quantities, and the run's status.
MATCH = np.dtype([("pattern", "u8"), ("distance", "f8"), ("change", "f8"), ("misfit", "f8"), ("status", "u1")])

# Logarithms of the changes at which the measured label is looked for, then closer by, and farther out
_FIRST, _CLOSER, _FARTHER = 0.3, (0.05, 0.1, 0.2), (0.45, 0.65, 0.9)
_TRIED = 16  # draws of the prior that tell along which axis labels change most
_EDIT = 0.5  # distance of each impact too many or too few, beyond the last ring
_OUTLIERS = 0.02  # share of measured quantities that are far off
_OUTLIER_SCALE = 10.0  # of these, in standard deviations


class CandidateRuns:
    """Runs of candidates, each a value for every prior's number, at the operating points of an experiment.

    study : Study
    experiment : Experiment
    priors : of the numbers that make a candidate
    engine : of threads
    lash : position of the one that was measured
    progress, planned : called with the number of candidates so far, and this number in all
    candidates : number of them so far
    axes : dotted keys of the measured columns
    axis : number of the one along which labels change most
    wanted : patterns of the measured labels
    """

    def __init__(
        self,
        study: Study,
        experiment: Experiment,
        priors: Sequence[Draw],
        engine: Executor,
        lash: int = 0,
        progress: Progress | None = None,
        planned: int = 0,
    ) -> None:
        self.study = measuring(study, ()).model_copy(update={"sweep": None, "fit": None})
        self.experiment, self.priors, self.lash = experiment, tuple(priors), lash
        self.axes = axes_of(self.study, experiment)
        self.points = np.array([each.values for each in experiment.measurements])
        self._speeds = np.array([each.detection_speed for each in experiment.measurements])
        self._engine, self._progress, self._planned = engine, progress, planned
        self.candidates = 0
        self.wanted = patterns_of(experiment)
        self._flanks = [flanks_of_label(each.label) for each in experiment.measurements]
        self._numbers = tuple(dict.fromkeys(name for each in experiment.measurements for name in each.impacts))
        self.axis = self._telling_axis() if len(self.axes) > 1 else 0

    def __call__(self, candidates: Floats) -> Records:
        """Run candidates, (n, priors), at all operating points.

        Returns MATCH, (n, points).
        """
        runner = self._runner()  # for these candidates only: there are too many drivelines to keep
        matches = np.zeros((len(candidates), len(self.points)), MATCH)
        every = np.indices(matches.shape).reshape(2, -1)
        patterns, status, impacts = self._run(candidates, every, self.points[every[1]], runner)
        matches["pattern"], matches["status"] = (each.reshape(matches.shape) for each in (patterns, status))
        matches["misfit"] = self._misfits(every[1], patterns, impacts).reshape(matches.shape)
        missed = np.flatnonzero(patterns != self.wanted[every[1]])
        self._look_around(candidates, matches.reshape(-1), missed, every, runner)
        self.candidates += len(candidates)
        if self._progress is not None:
            self._progress(self.candidates, max(self._planned, self.candidates))
        return matches

    def _look_around(
        self, candidates: Floats, matches: Records, missed: Positions, every: Positions, runner: Runner
    ) -> None:
        """Find the distances of runs that missed the measured label, on either side of the point.

        First at one change. Then, on the side where the label is there, closer by; if it is on none, closer by where
        the label there is another one, and farther out where it is no less like the measured one.
        """
        if not missed.size:
            return
        runs, computed = every[:, missed], matches["pattern"][missed]

        def edits_at(rows: Positions, changes: Floats) -> tuple[Patterns, Floats]:
            point = runs[1, rows]
            patterns = self._run(candidates, runs[:, rows], self._beside(point, self.axis, changes), runner)[0]
            return patterns, self._edits(point, patterns)

        row, side = np.repeat(np.arange(missed.size), 2), np.tile([-1.0, 1.0], missed.size)
        patterns, edits = edits_at(row, side * _FIRST)
        hits = edits == 0.0
        hit = np.repeat(hits.reshape(-1, 2).any(axis=1), 2)
        closer = np.where(hit, hits, patterns != computed[row])
        farther = ~hit & (edits <= self._edits(runs[1], computed)[row])
        steps = np.array([*_CLOSER, *_FARTHER])
        again, step = np.nonzero(np.where(steps < _FIRST, closer[:, None], farther[:, None]))
        changes = np.concatenate([side * _FIRST, side[again] * steps[step]])
        edits = np.concatenate([edits, edits_at(row[again], changes[row.size :])[1]])
        row = np.concatenate([row, row[again]])
        distances = np.where(edits == 0.0, np.abs(changes), _FARTHER[-1] + _EDIT * edits)
        order = np.lexsort((changes, distances, row))
        nearest = order[np.searchsorted(row[order], np.arange(missed.size))]
        matches["distance"][missed] = distances[nearest]
        matches["change"][missed] = np.where(edits[nearest] == 0.0, changes[nearest], 0.0)

    def _beside(self, point: Positions, axis: int, changes: Floats) -> Floats:
        """Measured values of points, (n, axes), with changes of the logarithm of the one along an axis."""
        measured = self.points[point]
        measured[:, axis] *= np.exp(changes)
        return measured

    def _telling_axis(self) -> int:
        """Number of the axis along which labels change most, by some draws of the prior."""
        normal = np.random.default_rng(0).standard_normal((_TRIED, len(self.priors)))
        candidates, runner = numbers_at(self.study, self.priors, normal), self._runner()
        runs = np.indices((_TRIED, len(self.points))).reshape(2, -1)
        at = self._run(candidates, runs, self.points[runs[1]], runner)[0]
        changed = [
            sum(
                int((self._run(candidates, runs, self._beside(runs[1], axis, change), runner)[0] != at).sum())
                for change in (np.array(-_FIRST), np.array(_FIRST))
            )
            for axis in range(len(self.axes))
        ]
        return int(np.argmax(changed))

    def _run(
        self, candidates: Floats, runs: Positions, measured: Floats, runner: Runner
    ) -> tuple[Patterns, npt.NDArray[np.uint8], Records]:
        """Run candidates at measured values: patterns, statuses, and seen impacts with their run's number.

        runs : (2, n) numbers of candidates and of points
        measured : (n, axes)
        """
        candidate, point = runs
        values = self.values(candidates[candidate], measured)
        allowed = np.ones(candidate.size, bool)
        for parameter, column in values.items():
            key = key_at(located(self.study, parameter)[0])
            assert key is not None
            allowed &= (column <= key.highest) & ((column > key.lowest) if key.above else (column >= key.lowest))
        ran = np.flatnonzero(allowed)
        patterns, status = np.zeros(candidate.size, np.uint64), np.full(candidate.size, Status.NON_FINITE, np.uint8)
        if not ran.size:
            return patterns, status, np.zeros(0, [("run", "i8")])
        results = runner(runner.values({key: column[ran] for key, column in values.items()}))
        results = results.of_lash(str(self.lash + 1))
        status[ran] = results.status
        row = ran[np.repeat(np.arange(ran.size), results.primary_impacts)]
        seen = results.impact_closing_speed >= self._speeds[point[row]]
        row, flanks = row[seen], results.impact_flank[seen]
        counts = np.bincount(row, minlength=candidate.size)
        behind = np.repeat(np.cumsum(counts), counts) - 1 - np.arange(row.size)  # impacts of the run behind each
        bits = np.where(flanks == OPPOSITE, np.uint64(1), np.uint64(0)) << np.minimum(behind, 63).astype(np.uint64)
        patterns[ran] = np.uint64(1) << np.minimum(counts[ran], LONGEST_PATTERN).astype(np.uint64)
        np.add.at(patterns, row, bits)
        patterns[(status != Status.OK) | (counts > LONGEST_PATTERN)] = 0
        numbered = np.zeros(row.size, [("run", "i8"), *((name, "f8") for name in self._numbers)])
        numbered["run"] = row
        for name in self._numbers:
            numbered[name] = results.values(name)[seen]
        return patterns, status, numbered

    def _runner(self) -> Runner:
        keys = dict.fromkeys([*self.axes, *(prior.parameter for prior in self.priors)])
        return Runner(self.study, [*keys], engine=self._engine)

    def values(self, candidates: Floats, measured: Floats) -> dict[str, Floats]:
        """Values of every parameter in runs of candidates, (n, priors), at measured values, (n, axes)."""
        values = {key: measured[:, k] for k, key in enumerate(self.axes)}
        for prior, numbers in zip(self.priors, candidates.T, strict=True):
            before = values.get(prior.parameter, nominal_value(self.study, prior.parameter))
            values[prior.parameter] = prior.applied(numbers, before)
        return values

    def _misfits(self, point: Positions, patterns: Patterns, impacts: Records) -> Floats:
        """Misfit of the impacts' quantities in some runs: minus the logarithm of their relative likelihood."""
        misfits = np.zeros(point.size)
        if not self._numbers:
            return misfits
        begins = np.searchsorted(impacts["run"], np.arange(point.size))
        for at, computed, runs in _alike(point, patterns):
            measurement, partner = self.experiment.measurements[at], partners(self._flanks[at], computed)
            for name, measured in measurement.impacts.items():
                for number, value in measured.items():
                    values = impacts[name][begins[runs] + partner[number]] if number in partner else 0.0
                    misfits[runs] += outlier_misfit((value - values) / measurement.std[name])
        return misfits

    def _edits(self, point: Positions, patterns: Patterns) -> Floats:
        """Number of impacts too many or too few of patterns at some points; of a failed run, of all."""
        edits = np.zeros(point.size)
        for at, computed, runs in _alike(point, patterns):
            flanks = self._flanks[at]
            edits[runs] = len(flanks) + len(computed) - 2.0 * len(partners(flanks, computed))
        return edits


def _alike(point: Positions, patterns: Patterns) -> Iterator[tuple[int, tuple[int, ...], Positions]]:
    """Yield groups of runs at the same point with the same pattern: the point, the flanks and the runs' numbers."""
    pairs, of_pair = np.unique(np.stack([point.astype(np.uint64), patterns]), axis=1, return_inverse=True)
    order = np.argsort(of_pair.reshape(-1), kind="stable")
    ends = np.cumsum(np.bincount(of_pair.reshape(-1)))
    for (at, pattern), runs in zip(pairs.T.tolist(), np.split(order, ends)[:-1], strict=True):
        yield at, flanks_of(pattern) if pattern else (), runs


def numbers_at(study: Study, priors: Sequence[Draw], coordinates: Floats) -> Floats:
    """Numbers of some priors at coordinates, (n, priors), in which they are standard normal."""
    from scipy.stats import norm

    columns = [
        prior.quantiles(norm.cdf(column), nominal_value(study, prior.parameter))
        for prior, column in zip(priors, coordinates.T, strict=True)
    ]
    return np.stack(columns, axis=1)


def axes_of(study: Study, experiment: Experiment) -> tuple[str, ...]:
    """Dotted keys of the measured columns. Raises ClunkError where the study has no such parameter."""
    known = {variable_of(name): name for name in parameters(study.model_dump(exclude_none=True))}
    for column in experiment.columns:
        if column not in known:
            raise ClunkError(f"The column {column} of {experiment.name} is no parameter of this config.")
    return tuple(dotted(located(study, known[column])[0]) for column in experiment.columns)


def pattern_of(label: str) -> int:
    """Pattern of a label: its flanks as bits behind a leading 1. Raises ClunkError where it has too many."""
    flanks = flanks_of_label(label)
    if len(flanks) > LONGEST_PATTERN:
        raise ClunkError(f"{label} has {len(flanks)} primary impacts; at most {LONGEST_PATTERN} can be fitted.")
    return int("1" + "".join("1" if flank == OPPOSITE else "0" for flank in flanks), 2)


def patterns_of(experiment: Experiment) -> Patterns:
    """Patterns of the measured labels, (points,)."""
    return np.array([pattern_of(each.label) for each in experiment.measurements], np.uint64)


def label_of(pattern: int) -> str:
    """Label of a pattern."""
    return label(flanks_of(pattern)) if pattern else FAILED


def partners(measured: Sequence[int], computed: Sequence[int]) -> dict[int, int]:
    """Impacts of two sequences that correspond: number of the measured -> number of the computed one."""
    blocks = SequenceMatcher(None, measured, computed, autojunk=False).get_matching_blocks()
    return {a + k: b + k for a, b, size in blocks for k in range(size)}


def outlier_misfit(deviation: Floats | float) -> Floats:
    """Minus the logarithm of a normal density with a few outliers, less that at 0; deviation : in standard deviations.

    It grows as the square near 0 and as the logarithm far away, so that one bad value decides nothing.
    """
    z = np.asarray(deviation, np.float64)
    peak = (1.0 - _OUTLIERS) + _OUTLIERS * np.sqrt(2.0 / np.pi) / _OUTLIER_SCALE
    tail = _OUTLIERS * np.sqrt(2.0 / np.pi) / _OUTLIER_SCALE / (1.0 + (z / _OUTLIER_SCALE) ** 2)
    return np.asarray(-np.log(((1.0 - _OUTLIERS) * np.exp(-(z**2) / 2.0) + tail) / peak))
