"""Designs: the dimensions of a sweep, and the parameters that change along each.

A grid has a dimension for each axis. Axes that are walked together (a zip design) and keys that are drawn together
(samples) share one dimension, `run`; each is a coordinate on it.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clunk.study.arrays import Cells, Floats
from clunk.study.axes import ResultAxes, ResultAxis, run_axis
from clunk.study.document import dotted
from clunk.study.errors import Problem, report
from clunk.study.keys import validated, with_tuples
from clunk.study.parameters import distinct, drawn_numbers, quantity, with_draws
from clunk.study.rules import broken_rules, varied_tables
from clunk.study.study import Study
from clunk.study.sweeps import Axis, Sweep


@dataclass(frozen=True, eq=False)
class Design:
    """The cells of a sweep: the product of its axes.

    axes : one for each dimension; parameters that are walked or drawn together share the axis `run`, whose values are
        the runs' numbers from 1
    """

    axes: ResultAxes = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each axis."""
        return tuple(len(axis) for axis in self.axes)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def parameters(self) -> ResultAxes:
        """The parameters that change: the axes, with the axis `run` replaced by its coordinates."""
        return tuple(each for axis in self.axes for each in axis.parameters)

    @property
    def coordinates(self) -> ResultAxes:
        """The parameters that change together along the axis `run`, each as long as the axis; empty without `run`."""
        return tuple(each for axis in self.axes for each in axis.along)

    def nearest(self, values: Mapping[str, float]) -> tuple[int, ...]:
        """Positions on the axes of the cell nearest to some values; 0 on an axis without a value.

        Raises ClunkError where a value lies beyond its axis.

        values : parameter of an axis -> value, in its unit
        """
        return tuple(axis.nearest(values.get(axis.parameter, axis.values[0])) for axis in self.axes)

    def columns(self, cells: Cells) -> dict[str, Floats]:
        """Values of each parameter in some cells, parameter -> (n,) float64.

        cells : (n,) numbers of the cells in C order
        """
        positions = np.unravel_index(cells, self.shape) if self.axes else ()
        pairs = zip(self.axes, positions, strict=True)
        return {each.parameter: each.values[places] for axis, places in pairs for each in axis.parameters}


def axis_of(parameter: str, values: Floats) -> ResultAxis:
    """Axis of a parameter, (n,) float64 in its key's unit."""
    known = quantity(parameter)
    return ResultAxis(parameter, values, known.name, known.symbol, known.unit)


def along_run(columns: Iterable[tuple[str, Floats]]) -> Design:
    """Design of parameters that are walked together, each with its values, all (n,) float64."""
    return Design((run_axis(axis_of(parameter, values) for parameter, values in columns),))


def design_of(study: Study) -> Design:
    """The design of a study's sweep without its tolerances; without axes and samples it has no axis and one cell."""
    sweep = study.swept
    swept = [(axis.parameter, axis.grid) for axis in sweep.axes]
    if sweep.design == "zip" and sweep.axes:
        return along_run(swept)
    axes = tuple(axis_of(*each) for each in swept)
    if not sweep.samples:
        return Design(axes)
    drawn = with_draws(study, {}, sweep.samples, drawn_numbers(study, sweep.samples))
    return Design((*axes, *along_run(drawn.items()).axes))


def design_of_points(study: Study, points: Mapping[str, npt.ArrayLike]) -> Design:
    """Design of arbitrary points of a study: one dimension, `run`, and a column for each parameter.

    Parameters
    ----------
    study : Study
        Its sweep is left aside.
    points : parameter -> (n,) float, in the key's unit
        For example ``{"load.ratio": ratios, "lash.backlash_deg": gaps}``; n is 1 or more, the same for all parameters.

    Raises
    ------
    ConfigError
        Where a parameter is unknown or given twice, lengths differ, or a value breaks the rules of a config.
    """
    lists = (with_tuples(np.asarray(values).tolist()) for values in points.values())
    columns = dict(zip(distinct(study, points), lists, strict=True))
    axes = tuple({"parameter": parameter, "values": values} for parameter, values in columns.items())
    sweep, findings = validated(Sweep, {"design": "zip", "axes": axes}, ("sweep",))
    if sweep is not None:
        walked = study.alone.but(sweep=sweep)
        findings = broken_rules(walked)
        if not findings:
            return design_of(walked)
    problems = []
    for place, message in findings:
        key, point = dotted(place), ""
        if place[:2] == ("sweep", "axes") and len(place) > 2:
            key = [*columns][int(place[2])]
            point = f"point {int(place[4]) + 1}: " if len(place) > 4 else ""
        problems.append(Problem(key, None, point + message.removeprefix(f"{key}: ")))
    raise report("this set of points", problems)


def nominal(study: Study) -> Study:
    """The study without its tolerances."""
    if study.sweep is None:
        return study
    return study.but(sweep=study.sweep.but(tolerances=()))


def with_cells(study: Study) -> Study:
    """The study without its tolerances, and with at least one cell, so that it has results.

    A study without axes and samples gets an axis of one value, the backlash of its first lash.
    """
    if study.swept.axes or study.swept.samples:
        return nominal(study)
    parameter = dotted((*study.lash_places[0], "backlash_deg"))  # any key does that every study has
    axis = Axis(parameter=parameter, values=(study.lashes[0].backlash_deg,))
    return study.but(sweep=Sweep(axes=(axis,)))


def with_axes_at(study: Study, values: Mapping[str, float]) -> Study:
    """The study with some axes cut down to one value each; values : parameter -> value, in the key's unit."""
    axes = tuple(
        Axis(parameter=axis.parameter, values=(values[axis.parameter],)) if axis.parameter in values else axis
        for axis in study.swept.axes
    )
    return study.but(sweep=study.swept.but(axes=axes))


def unused_parameters(study: Study) -> list[str]:
    """Swept, drawn, fitted or free keys that change nothing in the study's contact model."""
    keys = [key for _, table in varied_tables(study) for key in table.keys]
    return [key for key in keys if is_unused(study, key)]


def is_unused(study: Study, parameter: str) -> bool:
    """Whether a key has no effect on runs under the study's contact model; load.step_time never has one."""
    if study.has_rigid_flanks:
        unused = {
            "lash.radius",
            "lash.contact.stiffness",
            "lash.contact.damping",
            "impacts.sticking_time",
            "impacts.acceleration_of",
        }
    else:
        unused = {"lash.contact.restitution", "lash.contact.locking_speed"}
    return re.sub(r"^lash\[\d+\]", "lash", parameter) in unused | {"load.step_time"}
