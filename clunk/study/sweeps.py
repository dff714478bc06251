"""Tables of a sweep: axes, drawn keys with their distributions, and how these are sampled.

Points of a space-filling design in the unit cube go through each distribution's quantile function: the marginals are
exact, and the same seed gives the same sample.
"""

import functools
import math
import warnings
from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, WithJsonSchema, model_validator

from clunk.study.arrays import Floats
from clunk.study.errors import listing
from clunk.study.tables import LONGEST_AXIS, DrawCount, Findings, NotEmpty, Positive, Seed, Table

LARGEST_GRID = 2**31  # cells
_SPAN = ("start", "stop", "count", "scale")  # keys of an axis that replace its values
_NEAREST_TO_EDGE = 2.0**-54  # least probability, and half of 1 less the largest: at 0 and 1 quantiles may be infinite

# a file may give an inertia by its name, which is replaced by its number before validation
_Value = Annotated[float, WithJsonSchema({"type": ["number", "string"]})]


class Varied(Table):
    """A key that takes several values: base of swept keys (`Axis`) and drawn or fitted keys (`Draw`).

    parameter : str, dotted key
    """

    parameter: Annotated[str, Field(description='a dotted numeric key, for example "load.ratio"')]

    @property
    def keys(self) -> tuple[str, ...]:
        """The parameter as a tuple of one key, as `clunk.study.models.FreeParameter` may have several."""
        return (self.parameter,)


class Axis(Varied):
    """A swept key with the values that it takes, in the key's unit: spaced evenly or geometrically, or listed.

    start, stop, count, scale : float, float, int, "linear" or "log"; or else
    values : (count,) float
    """

    start: float | None = None
    stop: float | None = None
    count: Annotated[int, Field(ge=1, le=LONGEST_AXIS)] | None = None
    scale: Literal["linear", "log"] | None = None
    values: Annotated[NotEmpty[_Value], Field(max_length=LONGEST_AXIS)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, axis: Any) -> Any:
        if not isinstance(axis, dict) or axis.get("values") is not None or axis.get("start") is None:
            return axis
        stop = {"stop": axis["start"]} if axis.get("count") == 1 else {}
        return {"scale": "linear", **stop, **{key: value for key, value in axis.items() if value is not None}}

    def contradictions(self) -> Findings:
        """Require either values, or a start, stop, count and scale that agree with one another."""
        start, stop, count = self.start, self.stop, self.count
        given = tuple(key for key in ("values", *_SPAN) if getattr(self, key) is not None)
        if given not in (("values",), _SPAN):
            yield (), f"found {listing(given) or 'no values'}; give either start, stop and count, or values"
        elif start is None or stop is None or count is None:
            return
        elif self.scale == "log" and min(start, stop) <= 0.0:
            yield (), f'found {start:g} to {stop:g}; both must be greater than 0 on an axis of scale "log"'
        elif (count == 1) != (start == stop):
            text = f"found {start:g} to {stop:g} in {count:,}"
            yield ("count",), f"{text}; one value has the start as its stop, and several have another"
        elif not math.isfinite((stop - start) * count) or (self.scale == "log" and stop / start == math.inf):
            yield (), f"the span from {start:g} to {stop:g} is beyond the range of numbers"

    @property
    def count_of_values(self) -> int:
        """Number of values that the axis has."""
        return len(self.values) if self.values is not None else self.count or 0

    def place_of(self, position: int) -> tuple[str | int, ...]:
        """Place, in the axis's table, of the key that gives the value at a position: an item of values, start or stop.

        Empty for values between start and stop, which no key gives alone.
        """
        if self.values is not None:
            return "values", position
        return {0: ("start",), self.count_of_values - 1: ("stop",)}.get(position, ())

    @property
    def grid(self) -> Floats:
        """(count,) float64, the values in order; read-only."""
        return _grid(self)


@functools.lru_cache(maxsize=16)  # an attribute of the axis would take part in comparisons
def _grid(axis: Axis) -> Floats:
    if axis.values is not None:
        grid = np.array(axis.values, dtype=np.float64)
    else:
        assert axis.start is not None
        assert axis.stop is not None
        k, last = np.arange(axis.count_of_values), max(axis.count_of_values - 1, 1)
        if axis.scale == "log":
            grid = axis.start * (axis.stop / axis.start) ** (k / last)
        else:  # multiplied before divided: 0 to 10 in 201 values has 0.15 in it, not 0.15000000000000002
            grid = axis.start + (axis.stop - axis.start) * k / last
        # rounding must not carry a value out of a range that allows both ends
        grid = grid.clip(min(axis.start, axis.stop), max(axis.start, axis.stop))
        grid[-1] = axis.stop
    grid += 0.0  # no negative zeros, which are equal to positive ones and would share their place
    grid.flags.writeable = False
    return grid


# --- Drawn keys ------------------------------------------------------------------------------------------------------


# Distribution -> the numbers that it needs, and those that it may have
_NUMBERS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "uniform": (("low", "high"), ()),
    "normal": (("std",), ("mean", "low", "high")),
    "lognormal": (("sigma",), ("median", "low", "high")),
    "triangular": (("low", "mode", "high"), ()),
}


class Draw(Varied):
    """A key that is drawn at random, in the key's unit.

    distribution : "uniform" from low to high; "normal" by mean and std, or "lognormal" by its median and sigma, the
        standard deviation of its logarithm, which low and high truncate; or "triangular" from low to high, whose
        density peaks at mode
    draws : what the number is: the key's value, a factor on its nominal value, or an offset from that
    """

    distribution: Literal["uniform", "normal", "lognormal", "triangular"]
    draws: Literal["value", "factor", "offset"] = "value"
    low: float | None = None
    high: float | None = None
    mean: float | None = None
    std: Positive | None = None
    median: Positive | None = None
    sigma: Positive | None = None
    mode: float | None = None

    def contradictions(self) -> Findings:
        """Require the numbers of the distribution and no others, low < high, and the mode from low to high."""
        needed, possible = _NUMBERS[self.distribution]
        given = [*self.model_dump(exclude={"parameter", "distribution", "draws"}, exclude_none=True)]
        if not {*needed} <= {*given} <= {*needed, *possible}:
            numbers = listing([*needed, *possible])
            yield (), f"found {listing(given) or 'no number'}; a {self.distribution} distribution is given by {numbers}"
        low, mode, high = self.low, self.mode, self.high
        if low is not None and high is not None and not low < high:
            yield ("high",), f"found {high:g}; must be greater than low = {low:g}"
        elif mode is not None and low is not None and high is not None and not low <= mode <= high:
            yield ("mode",), f"found {mode:g}; must be from low to high"
        elif self.distribution == "lognormal" and high is not None and high <= 0.0:
            yield ("high",), f"found {high:g}; a lognormal number is greater than 0"

    def numbers(self, nominal: float) -> dict[str, float]:
        """Parameters of the distribution, by name; a mean or median that is left out is the nominal value."""
        middle = {"value": nominal, "factor": 1.0, "offset": 0.0}[self.draws]
        known = {"mean": middle, "median": middle} | self.model_dump(exclude_none=True)
        return {name: known[name] for names in _NUMBERS[self.distribution] for name in names if name in known}

    @np.errstate(invalid="ignore")
    def quantiles(self, probability: npt.ArrayLike, nominal: float) -> Floats:
        """Quantiles of the drawn number at these probabilities; NaN where it has no probability from low to high.

        nominal : value of the key, in its unit: mean or median of a drawn value whose own is left out
        """
        numbers = self.numbers(nominal)
        low, high = numbers.get("low", -math.inf), numbers.get("high", math.inf)
        distribution = _distribution(self.distribution, numbers)
        u = np.clip(probability, _NEAREST_TO_EDGE, 1.0 - 2.0 * _NEAREST_TO_EDGE)
        below, within = distribution.cdf([low, high])
        beyond, above = distribution.sf([low, high])
        if below > 0.5:  # probabilities above a number keep their digits here
            share, values = beyond - above, distribution.isf(beyond + u * (above - beyond))
        else:
            share = 1.0 - below - above if above <= 0.5 else within - below
            values = distribution.ppf(below + u * share)
        if not share > 0.0:
            values = np.full_like(values, np.nan)  # the distribution has no probability from low to high
        # rounding of the inverse distribution function must not carry a value out of the bounds
        return values.clip(low, high)

    def applied(self, drawn: npt.ArrayLike, nominal: npt.ArrayLike) -> Floats:
        """Values of the key from drawn numbers and nominal values, in the shape to which the two broadcast."""
        drawn, nominal = np.asarray(drawn, np.float64), np.asarray(nominal, np.float64)
        if self.draws == "factor":
            return nominal * drawn
        if self.draws == "offset":
            return nominal + drawn
        return drawn + np.zeros_like(nominal)


def _distribution(name: str, n: Mapping[str, float]) -> Any:
    """Frozen scipy distribution of this name with these parameters, not truncated."""
    from scipy import stats  # the import takes most of a second, and is needed for draws only

    if name == "uniform":
        return stats.uniform(n["low"], n["high"] - n["low"])
    if name == "normal":
        return stats.norm(n["mean"], n["std"])
    if name == "lognormal":
        return stats.lognorm(n["sigma"], scale=n["median"])
    return stats.triang((n["mode"] - n["low"]) / (n["high"] - n["low"]), n["low"], n["high"] - n["low"])


Draws = NotEmpty[Draw]


class Sampling(Table):
    """Sample of the drawn keys, all together: its method, size and seed.

    method : scrambled Sobol points, best in powers of two, or a Latin hypercube
    count : int, size of the sample
    seed : int; the same seed gives the same sample
    """

    method: Literal["sobol", "latin-hypercube"] = "sobol"
    count: DrawCount = 256
    seed: Seed = 0

    def points(self, dimensions: int) -> Floats:
        """Points of the sample in the unit cube, (count, dimensions) float64 in [0, 1)."""
        from scipy.stats import qmc

        sampler = {"sobol": qmc.Sobol, "latin-hypercube": qmc.LatinHypercube}[self.method]
        with warnings.catch_warnings():
            # scipy warns of Sobol points whose count is no power of two
            warnings.filterwarnings("ignore", "The balance properties of Sobol", UserWarning)
            return sampler(dimensions, seed=np.random.default_rng(self.seed)).random(self.count)


class Sweep(Table):
    """Runs of a sweep: swept keys, and drawn ones.

    design : the product of the axes ("grid"), or axes of equal length walked together ("zip")
    axes : swept keys, in order
    samples : keys drawn together, a further dimension of the results
    tolerances : keys drawn around every cell; the results have statistics of each cell's outcomes
    sampling : method, size and seed of the samples or tolerances
    boundaries : whether boundaries between the labels are traced after the sweep; None: where its map can have them
    """

    design: Literal["grid", "zip"] = "grid"
    axes: NotEmpty[Axis] = ()
    samples: Draws = ()
    tolerances: Draws = ()
    sampling: Sampling = Sampling()
    boundaries: bool | None = None

    def contradictions(self) -> Findings:
        """Require axes or draws, tables that go together, and at most `LARGEST_GRID` cells.

        Axes of a zip design must be equally long, and values on an axis of a grid distinct. Samples go with neither
        tolerances nor a zip design.
        """
        if not (self.axes or self.samples or self.tolerances):
            yield ("axes",), "missing; must be an array of tables, [[sweep.axes]], or else [[sweep.samples]]"
        counts = [axis.count_of_values for axis in self.axes]
        for k, count in enumerate(counts):
            if self.design == "zip" and count != counts[0]:
                text = f"found {count} values, and {self.axes[0].parameter} has {counts[0]}"
                yield ("axes", k), f"{text}; what is walked together must be equally long"
            values = self.axes[k].values
            if self.design == "grid" and values is not None and len(set(values)) < count:
                ((value, times),) = Counter(values).most_common(1)
                yield ("axes", k, "values"), f"the value {value:g} occurs {times} times"
        if self.samples and self.tolerances:
            yield ("samples",), "samples and tolerances are given together; give one of the two"
        elif self.samples and self.design == "zip":
            yield ("samples",), 'samples do not go with design = "zip"; give one of the two'
        cells = math.prod(counts if self.design == "grid" else counts[:1])
        cells *= self.sampling.count if self.samples else 1
        if cells > LARGEST_GRID:
            yield ("axes",), f"the grid has {cells:,} cells; at most {LARGEST_GRID:,} are allowed"
