"""What a sweep runs: its dimensions, and the parameters that change along each.

A grid has a dimension for each axis. Axes that are walked together (a zip design) and keys that are drawn together (a
sampled one) lie along one dimension, `run`, each a coordinate on it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clunk.study.axes import RUN, ResultAxis
from clunk.study.config import Axis, ConfigError, Draw, Problem, Study, Sweep, get_value, quantity
from clunk.study.configfile import dotted, report
from clunk.study.configmodels import schema
from clunk.study.configrules import (
    findings,
    key_at,
    parameter_complaint,
    place_of,
    sweep_findings,
    value_at,
    with_value,
)

FloatArray = npt.NDArray[np.float64]
Cells = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Column:
    """A parameter's values along one dimension.

    parameter : dotted key
    dimension : its number in the design
    values : (length of the dimension,) float64, in the key's unit
    """

    parameter: str
    dimension: int
    values: FloatArray

    @property
    def axis(self) -> ResultAxis:
        """The parameter as an axis or a coordinate of results."""
        known = quantity(self.parameter)
        return ResultAxis(self.parameter, self.values, known.name, known.symbol, known.unit)


@dataclass(frozen=True, eq=False)
class Design:
    """The cells of a sweep: the product of its dimensions.

    shape : length of each dimension
    columns : the parameters that change; one along each dimension, any number along `run`
    run : number of the dimension of what is walked or drawn together, if there is one
    """

    shape: tuple[int, ...]
    columns: tuple[Column, ...]
    run: int | None = None

    @property
    def cells(self) -> int:
        """How many cells there are."""
        return math.prod(self.shape)

    @property
    def axes(self) -> tuple[ResultAxis, ...]:
        """One for each dimension; along `run` the runs' numbers from 1."""
        own = {column.dimension: column for column in self.columns}
        numbers = [np.arange(1.0, length + 1.0) for length in self.shape]
        return tuple(
            ResultAxis(RUN, numbers[k], "run", "", "1") if k == self.run else own[k].axis
            for k in range(len(self.shape))
        )

    @property
    def coordinates(self) -> tuple[ResultAxis, ...]:
        """The parameters along `run`."""
        return tuple(column.axis for column in self.columns if column.dimension == self.run)

    def at(self, cells: Cells) -> dict[str, FloatArray]:
        """Parameter -> its value in each of these cells, which are numbers in C order."""
        positions = np.unravel_index(cells, self.shape)
        return {column.parameter: column.values[positions[column.dimension]] for column in self.columns}


def design_of(study: Study) -> Design:
    """The design of a study's sweep, tolerances aside; of no dimension and one cell without axes and samples."""
    sweep = study.sweep
    if sweep is None:
        return Design((), ())
    if sweep.design == "zip" and sweep.axes:
        together = tuple(Column(axis.parameter, 0, axis.grid) for axis in sweep.axes)
        return Design((sweep.axes[0].count_of_values,), together, run=0)
    shape = tuple(axis.count_of_values for axis in sweep.axes)
    columns = [Column(axis.parameter, k, axis.grid) for k, axis in enumerate(sweep.axes)]
    if not sweep.samples:
        return Design(shape, tuple(columns))
    for draw, drawn in zip(sweep.samples, drawn_numbers(study, sweep.samples), strict=True):
        columns.append(Column(draw.parameter, len(shape), draw.applied(drawn, _nominal(study, draw))))
    return Design((*shape, sweep.sampling.count), tuple(columns), run=len(shape))


def design_of_points(study: Study, points: Mapping[str, npt.ArrayLike]) -> Design:
    """Design of arbitrary points of a study: one dimension, `run`, and a column for each parameter.

    Parameters
    ----------
    study : Study
        Its sweep is left aside.
    points : parameter -> (n,) float, in the key's unit
        As ``{"load.ratio": ratios, "lash.backlash_deg": gaps}``; n is 1 or more, and of all columns the same.

    Raises
    ------
    ConfigError
        Where a value is not one that a config may hold.
    """
    document = study.model_dump() | {"sweep": None}
    columns: list[Column] = []
    problems: list[Problem] = []
    for parameter, values in points.items():
        place = place_of(parameter, document)
        key = None if place is None else key_at(schema(), place)
        complaint = parameter_complaint(parameter, schema(), document)
        if complaint is not None or place is None or key is None:
            problems.append(Problem(parameter, None, complaint or "is no quantity"))
            continue
        try:
            column = np.array(values, np.float64)
        except (TypeError, ValueError):
            problems.append(Problem(parameter, None, "must be an array of numbers"))
            continue
        if column.ndim != 1 or not column.size:
            problems.append(Problem(parameter, None, f"found shape {column.shape}; must be one-dimensional, not empty"))
            continue
        allowed = np.isfinite(column) & (column >= key.lowest) & (column <= key.highest)
        allowed &= (column > key.lowest) if key.above else True
        allowed &= (column == np.floor(column)) if key.whole else True
        if not allowed.all():
            first = int(np.argmin(allowed))
            must_be = key.must_be if np.isfinite(column[first]) else "a finite number"
            problems.append(
                Problem(parameter, None, f"found {column[first]:g} at point {first + 1}; must be {must_be}")
            )
        elif columns and column.size != columns[0].values.size:
            words = f"found {column.size} values, and {columns[0].parameter} has {columns[0].values.size}"
            problems.append(Problem(parameter, None, f"{words}; the columns must be equally long"))
        else:
            columns.append(Column(dotted(place), 0, column + 0.0))
            if value_at(document, place) is None and place[0] != "load":
                document = with_value(document, place, float(column[0]))
    if not points:
        problems.append(Problem("", None, "no parameter is given; give one or more, such as load.ratio"))
    if not problems:
        # rules that tie keys together look at the ends of an axis: here at each column's least and largest value
        ends = [(column.parameter, (float(column.values.min()), float(column.values.max()))) for column in columns]
        axes = tuple(Axis(parameter=parameter, values=values) for parameter, values in ends)
        document["sweep"] = Sweep(design="zip", axes=axes).model_dump()
        for place, message in [*sweep_findings(document, schema()), *findings(document)]:
            parameter = columns[int(place[2])].parameter if place[:2] == ("sweep", "axes") else dotted(place)
            problems.append(Problem(parameter, None, message))
    if problems:
        raise report("this set of points", problems)
    return Design((columns[0].values.size,), tuple(columns), run=0)


def has_tolerances(study: Study) -> bool:
    """Whether each cell of a study is to be run for a sample of toleranced parameters."""
    return study.sweep is not None and bool(study.sweep.tolerances)


def nominal(study: Study) -> Study:
    """The study without its tolerances."""
    if study.sweep is None:
        return study
    return study.model_copy(update={"sweep": study.sweep.model_copy(update={"tolerances": ()})})


def drawn_numbers(study: Study, draws: Sequence[Draw]) -> list[FloatArray]:
    """What the study's sampling draws for each of these, (count,) each: a value, a factor or an offset."""
    assert study.sweep is not None
    points = study.sweep.sampling.points(len(draws))
    return [draw.distributed(_nominal(study, draw)).ppf(points[:, k]) for k, draw in enumerate(draws)]


def _nominal(study: Study, draw: Draw) -> float:
    """The study's own value; NaN for a key that has none, or that is swept: nothing is drawn around it then."""
    if study.sweep is not None and any(axis.parameter == draw.parameter for axis in study.sweep.axes):
        return math.nan
    return own_value(study, draw.parameter)


def own_value(study: Study, parameter: str) -> float:
    """A parameter's value in its own unit, tolerances aside; NaN where it has none."""
    try:
        return get_value(study, parameter)
    except ConfigError:
        return math.nan
