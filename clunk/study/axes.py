"""An axis of a sweep: a parameter, and the values that it takes."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clunk.study.arrays import Floats
from clunk.study.errors import ClunkError
from clunk.study.sweeps import Varied

RUN = "run"  # name of the dimension along which parameters are walked or drawn together
LASH = "lash"  # name of the last dimension of results of several lashes


def variable_of(parameter: str) -> str:
    """Name of a parameter in the results file: ``load_ratio``, ``driveline_inertias_4``."""
    return re.sub(r"[.\[\]]", "_", parameter).rstrip("_")


@dataclass(frozen=True, eq=False)
class ResultAxis:
    """A swept parameter with the values that it took; or the dimension `run` or `lash`, whose values number from 1.

    parameter : dotted key of the config, e.g. ``load.ratio`` or ``driveline.inertias[4]``; or ``run`` or ``lash``
    values : (count,) float64  [unit]
    name, symbol, unit : for people, e.g. ``load ratio``, ``σr = Td/Ts``, ``1``
    words : texts of the values, of `lash` the names of the lashes; empty where the values are numbers
    along : of `run`, the parameters that change together along it, each as long as `run`; else empty
    """

    parameter: str
    values: Floats
    name: str
    symbol: str
    unit: str
    words: tuple[str, ...] = ()
    along: tuple["ResultAxis", ...] = ()

    def __len__(self) -> int:
        """Number of values."""
        return len(self.values)

    @property
    def parameters(self) -> tuple["ResultAxis", ...]:
        """The parameters that change along the axis: those along `run`, otherwise the axis itself alone."""
        return self.along or (self,)

    @property
    def variable(self) -> str:
        """Name of the axis in the results file: ``load_ratio``, ``driveline_inertias_4``."""
        return variable_of(self.parameter)

    @property
    def spread(self) -> str:
        """Least and largest value, unit and count, for people: ``0 to 20 degrees, 21 values``; or the words."""
        if self.words:
            return ", ".join(self.words)
        lowest, highest = self.ends
        return f"{lowest:g} to {highest:g}{self.unit_after}, {len(self)} values"

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the largest value."""
        return self.values.min(), self.values.max()

    @property
    def ascending(self) -> "ResultAxis":
        """The axis with its values in ascending order, and without words."""
        return replace(self, values=np.sort(self.values), words=())

    @property
    def unit_after(self) -> str:
        """The unit behind a value, after a space; empty where there is none."""
        return "" if self.unit == "1" else f" {self.unit}"

    def part(self, places: slice) -> "ResultAxis":
        """The axis restricted to a slice of its positions."""
        along = tuple(each.part(places) for each in self.along)
        return replace(self, values=self.values[places], words=self.words[places], along=along)

    def nearest(self, value: float | str) -> int:
        """Index of the axis's value nearest to a number, or index of a word.

        On a geometric axis the nearest logarithm counts. Of two values that are equally near, the first is taken.

        Raises ClunkError where a number lies beyond the axis, or the axis has no such word.
        """
        if isinstance(value, str):
            if value not in self.words:
                there = " or ".join(self.words) or "a number"
                raise ClunkError(f"{self.parameter} must be {there}, not {value!r}.")
            return self.words.index(value)
        lowest, highest = self.ends
        if not lowest <= value <= highest:  # also where it is not a number
            raise ClunkError(f"{self.parameter} is swept from {lowest:g} to {highest:g}; {value:g} is not on it.")
        apart = np.log(self.values / value) if self.is_geometric else self.values - value
        return int(abs(apart).argmin())

    def few(self, most: int) -> Floats:
        """At most `most` values of the axis in ascending order, at evenly spread ranks, with the least and largest."""
        places = np.linspace(0, len(self) - 1, min(most, len(self)))
        return np.sort(self.values)[np.rint(places).astype(np.intp)]

    @cached_property
    def is_geometric(self) -> bool:
        """Whether there are 3 or more values, all positive, evenly spaced in their logarithm over a factor above 3."""
        ascending = np.sort(self.values)
        if len(ascending) < 3 or ascending[0] <= 0.0:
            return False
        steps = np.diff(np.log(ascending))
        return np.allclose(steps, steps.mean(), rtol=1e-6) and ascending[-1] / ascending[0] > 3.0


ResultAxes = tuple[ResultAxis, ...]


def parameters_of(varied: Iterable[ResultAxis | Varied]) -> list[str]:
    """The parameter of each axis, or of each key that is drawn."""
    return [each.parameter for each in varied]


def run_axis(along: Iterable[ResultAxis]) -> ResultAxis:
    """The dimension of runs along which these parameters change together."""
    along = tuple(along)
    return ResultAxis(RUN, np.arange(1.0, len(along[0]) + 1.0), RUN, "", "1", along=along)


def lash_axis(names: Sequence[str]) -> ResultAxis:
    """The axis `lash` of lashes with these names."""
    return ResultAxis(LASH, np.arange(1.0, len(names) + 1.0), LASH, "", "1", tuple(names))
