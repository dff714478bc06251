"""Designs: the dimensions of a sweep, and the parameters that change along each.

A grid has a dimension for each axis. Axes that are walked together (a zip design) and keys that are drawn together (a
sampled one) lie along one dimension, `run`, each a coordinate on it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clunk.study.arrays import Cells, Floats
from clunk.study.axes import RUN, ResultAxis
from clunk.study.document import dotted
from clunk.study.errors import ConfigError, Problem, report
from clunk.study.keys import validated, with_tuples
from clunk.study.models import NOT_OF_A_RUN
from clunk.study.parameters import located, nominal_value, quantity
from clunk.study.study import Study
from clunk.study.sweeps import Axis, Draw


@dataclass(frozen=True, eq=False)
class Column:
    """A parameter's values along one dimension.

    parameter : dotted key
    dimension : its number in the design
    values : (length of the dimension,) float64, in the key's unit
    """

    parameter: str
    dimension: int
    values: Floats

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
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def axes(self) -> tuple[ResultAxis, ...]:
        """Axis of each dimension; along `run` the runs' numbers from 1."""
        columns = {column.dimension: column for column in self.columns}
        numbers = [np.arange(1.0, length + 1.0) for length in self.shape]
        return tuple(
            ResultAxis(RUN, numbers[k], "run", "", "1") if k == self.run else columns[k].axis
            for k in range(len(self.shape))
        )

    @property
    def coordinates(self) -> tuple[ResultAxis, ...]:
        """The parameters along `run`."""
        return tuple(column.axis for column in self.columns if column.dimension == self.run)

    def at(self, cells: Cells) -> dict[str, Floats]:
        """Values of each parameter in some cells, (n,) float64; cells : their numbers in C order."""
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
        columns.append(Column(draw.parameter, len(shape), draw.applied(drawn, _unswept_value(study, draw.parameter))))
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
    columns = {
        dotted(located(study, key)[0]): with_tuples(np.asarray(values).tolist()) for key, values in points.items()
    }
    axes = tuple({"parameter": parameter, "values": values} for parameter, values in columns.items())
    document = {**study.model_dump(exclude=NOT_OF_A_RUN), "sweep": {"design": "zip", "axes": axes}}
    walked, findings = validated(Study, document)
    if walked is not None:
        return design_of(walked)
    problems = []
    for place, message in findings:
        key, point = dotted(place), ""
        if place[:2] == ("sweep", "axes") and len(place) > 2:
            key = [*columns][int(place[2])]
            point = f"point {int(place[4]) + 1}: " if len(place) > 4 else ""
        problems.append(Problem(key, None, point + message.removeprefix(f"{key}: ")))
    raise report("this set of points", problems)


def refuse_points(study: Study, parameters: Sequence[str], values: Floats) -> None:
    """Refuse points of a study, (n, parameters), whose values are not allowed. Raises ConfigError.

    All are looked at together, by the least and the greatest of each parameter; the points themselves only where one of
    these may not be.
    """
    ends = np.stack([values.min(axis=0), values.max(axis=0)], axis=1)
    try:
        design_of_points(study, dict(zip(parameters, ends, strict=True)))
    except ConfigError:
        design_of_points(study, dict(zip(parameters, values.T, strict=True)))


def has_tolerances(study: Study) -> bool:
    """Whether each cell of a study is to be run for a sample of toleranced parameters."""
    return study.sweep is not None and bool(study.sweep.tolerances)


def nominal(study: Study) -> Study:
    """The study without its tolerances."""
    if study.sweep is None:
        return study
    return study.model_copy(update={"sweep": study.sweep.model_copy(update={"tolerances": ()})})


def with_axes_at(study: Study, values: Mapping[str, float]) -> Study:
    """The study with some axes cut down to one value each; values : parameter -> value, in the key's unit."""
    assert study.sweep is not None
    axes = tuple(
        Axis(parameter=axis.parameter, values=(values[axis.parameter],)) if axis.parameter in values else axis
        for axis in study.sweep.axes
    )
    return study.model_copy(update={"sweep": study.sweep.model_copy(update={"axes": axes})})


def drawn_numbers(study: Study, draws: Sequence[Draw]) -> list[Floats]:
    """Numbers that the study's sampling draws for each of these, (count,) each: values, factors or offsets."""
    assert study.sweep is not None
    points = study.sweep.sampling.points(len(draws))
    return [draw.sample(points[:, k], _unswept_value(study, draw.parameter)) for k, draw in enumerate(draws)]


def _unswept_value(study: Study, parameter: str) -> float:
    """The nominal value of a parameter; NaN for one that has none, or is swept: nothing is drawn around it then."""
    assert study.sweep is not None
    is_swept = any(axis.parameter == parameter for axis in study.sweep.axes)
    return math.nan if is_swept else nominal_value(study, parameter)


def unused_parameters(study: Study) -> list[str]:
    """Swept, drawn or fitted keys that change nothing in the study's contact model."""
    sweep = study.sweep
    swept = [each.parameter for each in (*sweep.axes, *sweep.samples, *sweep.tolerances)] if sweep else []
    swept += [each.parameter for each in study.fit.parameters] if study.fit else []
    return [parameter for parameter in swept if is_unused(study, parameter)]


def is_unused(study: Study, parameter: str) -> bool:
    """Whether a key changes nothing in the study's contact model."""
    if study.lashes[0].contact.model == "restitution":
        unused = {"lash.contact.stiffness", "lash.contact.damping", "impacts.sticking_time", "impacts.acceleration_of"}
    else:
        unused = {"lash.contact.restitution", "lash.contact.locking_speed"}
    return re.sub(r"^lash\[\d+\]", "lash", parameter) in unused | {"load.step_time"}
