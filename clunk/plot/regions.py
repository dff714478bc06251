"""Regions between samples: smooth boundaries with every sample on the side of its label."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from clunk.plot.plane import Codes, View, ruler
from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Bools, Floats

Scores = npt.NDArray[np.float32]
Window = tuple[slice, slice]


class Regions:
    """Labels between the samples: smooth boundaries, and every sample on the side of its label.

    Each label has a score at each sample, the smoothed indicator of its cells; between samples scores are interpolated
    and the highest wins. A sample that smoothing would hand to another label pushes its own score up until it does not;
    where that is not enough, and on lines and specks, nothing is smoothed. So a boundary never leaves the gap between
    two samples: what the data leave open is all that is smoothed. Where the samples are as fine as the picture can
    show, nothing is.
    """

    _BLUR = 2.0  # standard deviation in cells
    _REACH = 0.8  # likewise, of a push: how far a boundary gives way for a sample on its wrong side
    _CUT = 3.0  # standard deviations: a label's score is zero further away from its cells
    _LEAD = 0.02  # score by which a pushed sample's own label wins
    _TIP_LEAD = 0.05  # and more on lines and tips, or they would shrink to nothing between their neighbours

    def __init__(self, codes: Codes, points: int = 700) -> None:
        self.codes = codes  # (nx, ny)
        self.present: list[int] = [int(code) for code in np.unique(codes)]
        boxes = ndimage.find_objects(codes.astype(np.int32) - self.present[0] + 1)
        self._boxes: dict[int, Window] = {code: boxes[code - self.present[0]] for code in self.present}
        # As fine as the picture can show, at least the samples themselves.
        self.factor = tuple(int(np.clip(math.ceil(points / count), 1, 8)) for count in codes.shape)
        self._push = np.zeros(codes.shape, np.float32)
        self._bare = np.ones(codes.shape, np.bool_)
        if self.factor != (1, 1):
            self._smooth()
        for attempt in range(9):
            self.label, self._best, self._second = self._compete()
            wrong = self._wrong()
            if not wrong.any():
                break
            self._bare |= wrong | (attempt == 7)  # the last attempt smooths nothing

    def margin(self, code: int) -> tuple[Window, Scores]:
        """The fine points among which a label's cells are, and by how much it wins (positive) or loses at each."""
        around = self._around(code, 1)
        window = self._fine(around)
        score = self._score(code, around)
        margin: Scores = score - np.where(self.label[window] == code, self._second[window], self._best[window])
        return window, margin

    def fine_values(self, view: View) -> tuple[Floats, ...]:
        """The parameter at the fine points, along each axis."""
        values = []
        for axis, size in zip(view.axes, self.label.shape, strict=True):
            to, back = ruler(axis)
            samples = np.arange(len(axis.values))
            values.append(back(np.interp(np.linspace(0.0, samples[-1], size), samples, to(axis.values))))
        return tuple(values)

    def _smooth(self) -> None:
        """Find where samples have to push, and how hard, and where nothing can be smoothed."""
        specks, tips = self._specks()
        self._bare = specks | ndimage.binary_dilation(self.codes == FAILED_CODE)
        for _ in range(8):
            deficit = self._deficit() + np.where(tips, self._TIP_LEAD, 0.0)
            if deficit.max() <= 0.0:
                break
            self._push += np.where(deficit > 0.0, deficit + self._LEAD, 0.0)
        self._bare |= self._deficit() > 0.0

    def _around(self, code: int, cells: int) -> Window:
        """The samples within a number of cells of a label's bounding box."""
        sides = zip(self._boxes[code], self.codes.shape, strict=True)
        rows, columns = (slice(max(box.start - cells, 0), min(box.stop + cells, count)) for box, count in sides)
        return rows, columns

    def _fine(self, window: Window) -> Window:
        """The fine points from the first of these samples to the last."""
        sides = zip(window, self.factor, strict=True)
        rows, columns = (slice(side.start * factor, (side.stop - 1) * factor + 1) for side, factor in sides)
        return rows, columns

    def _specks(self) -> tuple[Bools, Bools]:
        """Cells in no 2 x 2 block of their label: of regions without one, and of lines and tips of the rest."""
        specks, tips = np.zeros((2, *self.codes.shape), np.bool_)
        for code in self.present:
            window = self._around(code, 2)
            cells = self.codes[window] == code
            block = ndimage.binary_opening(cells, np.ones((2, 2)))
            parts, count = ndimage.label(cells, np.ones((3, 3)))
            thick = np.zeros(count + 1, np.bool_)
            thick[parts[block]] = True
            specks[window] |= cells & ~thick[parts]
            tips[window] |= cells & thick[parts] & ~block
        return specks, tips

    def _support(self, code: int) -> Window:
        """The samples on whose border, and beyond, a label's score is zero."""
        return self._around(code, int(self._CUT * self._BLUR + 0.5) + 1)

    def _sample_score(self, code: int) -> Scores:
        """A label's score at the samples of its support."""
        window = self._support(code)
        indicator: Scores = (self.codes[window] == code).astype(np.float32)
        bare = self._bare[window]
        if bare.all():
            return indicator
        score = ndimage.gaussian_filter(indicator, self._BLUR, mode="nearest", truncate=self._CUT)
        push = indicator * self._push[window]
        if push.any():
            peak = 1.0 / (2.0 * math.pi * self._REACH**2)  # of the kernel
            score += ndimage.gaussian_filter(push, self._REACH, mode="constant", truncate=self._CUT) / peak
        chosen: Scores = np.where(bare, indicator, score)
        return chosen

    def _deficit(self) -> Scores:
        """Score that each sample's label lacks to reach the highest of the other labels there."""
        score_of_label, score_of_rival = np.zeros((2, *self.codes.shape), np.float32)
        for code in self.present:
            window, score = self._support(code), self._sample_score(code)
            cells = self.codes[window] == code
            np.copyto(score_of_label[window], score, where=cells)
            np.maximum(score_of_rival[window], score, out=score_of_rival[window], where=~cells)
        deficit: Scores = score_of_rival - score_of_label
        return deficit

    def _score(self, code: int, around: Window) -> Scores:
        """A label's score at the fine points between the samples of a window."""
        window, known = self._support(code), self._sample_score(code)
        score = np.zeros([samples.stop - samples.start for samples in around], np.float32)
        shared = [slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(window, around, strict=True)]
        score[_relative(shared, around)] = known[_relative(shared, window)]
        for axis, factor in enumerate(self.factor):
            score = _refine(score, factor, axis)
        return score

    def _compete(self) -> tuple[Codes, Scores, Scores]:
        """The label with the highest score at each fine point, that score and the next one."""
        shape = tuple((count - 1) * factor + 1 for count, factor in zip(self.codes.shape, self.factor, strict=True))
        label = np.full(shape, self.present[0], np.int16)
        best, second = np.zeros((2, *shape), np.float32)
        for code in self.present:
            around = self._support(code)
            window = self._fine(around)
            score, former = self._score(code, around), best[window]
            wins = score > former
            second[window] = np.where(wins, former, np.maximum(second[window], score))
            label[window][wins] = code
            best[window] = np.maximum(former, score)
        return label, best, second

    def _wrong(self) -> Bools:
        """Samples that another label took, and corners of cells where a label won that none of the four has."""
        fx, fy = self.factor
        wrong: Bools = self.label[::fx, ::fy] != self.codes
        corner = [
            np.minimum(np.arange(size) // factor, count - 2)
            for size, factor, count in zip(self.label.shape, self.factor, self.codes.shape, strict=True)
        ]
        foreign = np.ones(self.label.shape, np.bool_)
        for dx, dy in np.ndindex(2, 2):
            foreign &= self.label != self.codes[np.ix_(corner[0] + dx, corner[1] + dy)]
        i, j = np.nonzero(foreign)
        for dx, dy in np.ndindex(2, 2):
            wrong[corner[0][i] + dx, corner[1][j] + dy] = True
        return wrong


def _relative(window: Sequence[slice], base: Window) -> Window:
    """A window counted from the first samples of another one."""
    rows, columns = (slice(w.start - b.start, w.stop - b.start) for w, b in zip(window, base, strict=True))
    return rows, columns


def regions_of(codes: Codes, points: int) -> Regions:
    """The regions of some codes; those of the last ones are kept, for another picture of the same map."""
    return _regions(codes.tobytes(), codes.shape, points)


@functools.lru_cache(maxsize=1)
def _regions(raw: bytes, shape: tuple[int, ...], points: int) -> Regions:
    return Regions(np.frombuffer(raw, np.int16).reshape(shape), points)


def _refine(samples: Scores, factor: int, axis: int) -> Scores:
    """Linear interpolation at `factor` points per cell along one axis; the samples themselves are among them."""
    if factor == 1 or samples.shape[axis] == 1:
        return samples
    rows = np.moveaxis(samples, axis, 0)
    fine = np.empty(((len(rows) - 1) * factor + 1, *rows.shape[1:]), np.float32)
    for step in range(factor):
        weight = np.float32(step / factor)
        fine[step:-1:factor] = rows[:-1] * (1 - weight) + rows[1:] * weight
    fine[-1] = rows[-1]
    refined: Scores = np.moveaxis(fine, 0, axis)
    return refined
