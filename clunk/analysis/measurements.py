"""Measured sequences of impacts: read from CSV files, and compared with a map, label by label and in their trends."""

import csv
import math
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np

from clunk.results.labels import FAILED, double_sided, flanks_of_label, normalised_label
from clunk.results.maps import Results
from clunk.results.quantities import REGIME_QUANTITIES
from clunk.study.axes import ResultAxis, parameters_of, variable_of
from clunk.study.document import FilePath, read_text
from clunk.study.errors import ClunkError, shorten
from clunk.study.parameters import quantity, spellings
from clunk.study.records import SENTENCE, Record, counted, tells, told

CAVEAT = "trend comparison, unless the rig's parameters are the model's"


IMPACT_QUANTITIES = ("impact_time", "impact_closing_speed", "impact_severity")  # as in results files
_OF_IMPACTS = re.compile(rf"({'|'.join(IMPACT_QUANTITIES)})_([1-9]\d{{0,2}}|std)")


@dataclass(frozen=True)
class Measurement:
    """A measured point: values of the parameters, and the label of its impacts.

    line : of the file, from 1
    values : in the order of the experiment's columns, in the parameters' units
    label : in clunk's notation, for example DS(1)SS(1)
    impacts : quantity -> its measured values by primary impact from 0, of `IMPACT_QUANTITIES`, in their units
    std : quantity -> standard deviation of its measured values
    """

    line: int
    values: tuple[float, ...]
    label: str
    impacts: Mapping[str, Mapping[int, float]]
    std: Mapping[str, float]


@dataclass(frozen=True)
class Experiment:
    """Measured points of one file.

    name : of the file
    columns : names of the parameters as they are in results files, for example load_ratio
    measurements : one or more
    caveat : what keeps the measurements from being a test of the model; from a comment that begins with "caveat:"
    """

    name: str
    columns: tuple[str, ...]
    measurements: tuple[Measurement, ...]
    caveat: str


TABLES = {"table_4_1": files(__package__) / "table_4_1.csv"}  # measured tables of the report, which come with clunk


def is_experiment(path: FilePath) -> bool:
    """Whether a path names measurements rather than a results file: a .csv, or one of `TABLES`, also misspelt."""
    suffix = Path(path).suffix.lower()
    return suffix == ".csv" or (suffix != ".h5" and not Path(path).exists())


def read_experiment(path: FilePath) -> Experiment:
    """Read measurements from a CSV file in UTF-8, or from one of `TABLES` by its name, unless a file has that name.

    Semicolons or tabs may separate the columns; commas are then decimal commas.
    The first line that is no comment (#) names the columns: one for each parameter, as in a results file
    (``load_ratio``) or in a config (``load.ratio``), in the parameter's unit, and ``label``. There may be measured
    quantities of the primary impacts besides, ``impact_time_1`` and so on (also ``impact_closing_speed_1`` and
    ``impact_severity_1``), blank where they were not measured, with their standard deviation, ``impact_time_std``.

    Raises ClunkError where the file cannot be read, with the number of the line that is wrong.
    """
    if str(path) in TABLES and not Path(path).exists():
        return experiment_of(TABLES[str(path)].read_text("utf-8"), path)
    known = f"; the experiments that come with clunk are: {', '.join(TABLES)}."
    return experiment_of(read_text(path, "an experiment", "a CSV file", known), path)


def experiment_of(text: str, path: FilePath) -> Experiment:
    """Measurements in the text of a CSV file, in the format of `read_experiment`, with the same errors.

    path : of the file, whose name is the experiment's
    """
    lines = text.splitlines(keepends=True)
    comments = [line.strip("# \t\n") for line in lines if line.lstrip().startswith("#")]
    caveats = [each.split(":", 1)[1].strip() for each in comments if each.lower().startswith("caveat:")]
    # Comments become blank lines, so that the reader's count of lines is that of the file.
    rows = ["\n" if line.lstrip().startswith("#") else line for line in lines]
    headings = next(filter(str.strip, rows), "")
    mark = next((each for each in ",;\t" if each in headings), ",")
    point = "." if mark == "," else ","
    reader = csv.reader(rows, delimiter=mark, strict=True)
    columns: list[str] = []
    measurements = []
    try:
        for row in reader:
            cells = [cell.strip().replace(point, ".") for cell in row]
            if not any(cells):
                continue
            where = f"{path}, line {reader.line_num}"
            while not cells[-1] and len(cells) > len(columns):  # blank cells after separators at the end
                cells.pop()
            if not columns:
                columns = _columns(cells, where)
            else:
                measurements.append(_measurement(columns, cells, where, reader.line_num))
    except csv.Error as error:
        raise ClunkError(f"{path}, line {reader.line_num}: this is not CSV ({error}).") from error
    if not measurements:
        raise ClunkError(f"{path} holds no measurements{', only column names' if columns else ''}.")
    return Experiment(
        name=Path(path).name,
        columns=tuple(column for column in columns if not _is_measured(column)),
        measurements=tuple(measurements),
        caveat=next(iter(caveats), "") or CAVEAT,
    )


def _columns(cells: list[str], where: str) -> list[str]:
    """Names of the columns as they are in results files, "label" among them."""
    cells = [_without_unit(cell, where) for cell in cells]
    columns = [cell if _is_measured(cell) else variable_of(cell) for cell in cells]
    if "label" not in columns or all(map(_is_measured, columns)):
        raise ClunkError(
            f"{where}: there must be columns, separated by commas, semicolons or tabs, of parameters, as load_ratio, "
            "and one named label."
        )
    twice = [name for name in columns if columns.count(name) > 1]
    if twice:
        raise ClunkError(f"{where}: there is more than one column {twice[0]}.")
    return columns


def _without_unit(heading: str, where: str) -> str:
    """The name in a heading that may end with a unit in brackets. Raises ClunkError where it is not the name's unit."""
    name, bracket, unit = heading.partition(" [")
    if bracket:
        measured = _OF_IMPACTS.fullmatch(name)
        meant = REGIME_QUANTITIES[measured[1]].unit if measured else quantity(name).unit
        stated, known = (re.sub("[^a-z]", "", each.lower()) for each in (unit, meant))
        if stated != known:
            raise ClunkError(f"{where}: {name} is in {meant}, not in {shorten(unit.strip('] '))}.")
    return name


def _is_measured(column: str) -> bool:
    """Whether a column holds what was measured, rather than the operating point's parameters."""
    return column == "label" or _OF_IMPACTS.fullmatch(column) is not None


def _measurement(columns: list[str], cells: list[str], where: str, line: int) -> Measurement:
    if len(cells) != len(columns):
        raise ClunkError(f"{where}: there are {len(cells)} columns here and {len(columns)} names of columns.")
    texts = dict(zip(columns, cells, strict=True))
    try:
        label = normalised_label(texts.pop("label"))
        count = len(flanks_of_label(label))
    except ValueError as error:
        raise ClunkError(f"{where}: {error}; labels are written like NI, SS(1), DS(1)SS(1) or D(1)+S(1).") from None
    values, impacts, std = [], defaultdict[str, dict[int, float]](dict), dict[str, float]()
    for column, text in texts.items():
        words = _OF_IMPACTS.fullmatch(column)
        if words and not text:
            continue
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (words and value <= 0.0):
            above = " greater than 0" if words else ""
            raise ClunkError(f"{where}: {column} must be a finite number{above}, not {shorten(text)}.")
        if words is None:
            values.append(value)
            continue
        quantity, number = words.groups()
        if number == "std":
            std[quantity] = value
        elif int(number) > count:
            raise ClunkError(f"{where}: {column} is given, and {label} has {counted(count, 'primary impact')}.")
        else:
            impacts[quantity][int(number) - 1] = value
    times = [time for _, time in sorted(impacts.get("impact_time", {}).items())]
    if times != sorted(times):
        raise ClunkError(f"{where}: of two impacts the later one has the smaller impact_time.")
    for quantity in impacts.keys() - std.keys():
        raise ClunkError(f"{where}: {quantity} is given without its standard deviation, {quantity}_std.")
    return Measurement(line, tuple(values), label, dict(impacts), std)


class Point(Record):
    """A measured point and the cell nearest to it.

    at : parameter -> measured value; NaN on an axis of one value that has no column
    measured : label
    computed : label of the nearest cell, ``failed``, or None where the point lies outside the swept range
    cell : the nearest cell's parameters, None outside
    """

    at: dict[str, float] = told("at")
    measured: str = told("measured")
    computed: str | None = told("computed")
    cell: dict[str, float | str] | None = told()

    @property
    def counts(self) -> bool:
        """Whether the nearest cell has a label to compare with."""
        return self.computed not in (None, FAILED)

    @property
    @tells("agrees")
    def agrees(self) -> bool | None:
        """Whether the labels are the same; None where there is no cell."""
        return None if self.computed is None else self.measured == self.computed


class Trend(Record):
    """Change of the number of double-sided impacts along one parameter, from each point to its neighbour.

    parameter, symbol : of the axis
    pairs : number of pairs of neighbours that have computed labels
    alike : pairs in which the measured and the computed number both rise, both stay or both fall
    opposed : pairs in which one rises and the other falls
    """

    parameter: str = told("along")
    symbol: str = told()
    pairs: int = told("pairs")
    alike: int = told("alike")
    opposed: int = told("opposed")


class ExperimentComparison(Record, eq=False, repr=False):
    """Comparison of measurements with a map.

    title : of the results
    points : in the file's order
    trends : one for each axis of more than one value
    caveat : what keeps the measurements from being a test of the model
    experiment : name of the file of the measurements
    counted : number of points with a computed label
    agreeing : number of points whose labels are the same
    outside, failed : number of points outside the swept range, and of those whose nearest cell failed
    same_regimes : whether every point inside the swept range agrees; never if there is none
    """

    title: str = told()
    points: tuple[Point, ...] = told("measured points")
    trends: tuple[Trend, ...] = told("rise and fall of double-sided impacts from a point to the next")
    caveat: str = told(SENTENCE)
    experiment: str = told()
    counted: int = told("points with a computed label", key="points_counted")
    agreeing: int = told("labels agree at", key="points_agreeing")
    outside: int = told("outside the swept range", key="points_outside")
    failed: int = told("nearest to a failed cell", key="points_failed")
    same_regimes: bool = told()


def compare_experiment(results: Results, experiment: Experiment) -> ExperimentComparison:
    """Compare each measurement with the nearest cell of a map, and measured with computed trends along each axis.

    Raises
    ------
    ClunkError
        Where the measurements' columns are not the results' axes; an axis of one value needs no column.
    """
    parameter_of = {variable_of(name): key for name, key in spellings(results.tables).items()}
    parameters = tuple(parameter_of.get(column, column) for column in experiment.columns)
    for parameter in parameters:
        if parameter not in parameters_of(results.axes):
            raise ClunkError(
                f"The column {shorten(variable_of(parameter))} of {experiment.name} is no axis of the results, which "
                f"sweep {', '.join(axis.variable for axis in results.axes)}."
            )
    for axis in results.axes:
        if axis.parameter not in parameters and len(axis) > 1:
            raise ClunkError(f"The results sweep {axis.parameter}, and {experiment.name} has no column for it.")
    points = tuple(_point(results, parameters, measurement) for measurement in experiment.measurements)
    trends = tuple(_trend(axis, points) for axis in results.axes if len(axis) > 1)
    inside = [point for point in points if point.counts]
    agreeing, failed = sum(point.agrees is True for point in inside), sum(point.computed == FAILED for point in points)
    return ExperimentComparison(
        title=results.title,
        points=points,
        trends=trends,
        caveat=experiment.caveat,
        experiment=experiment.name,
        counted=len(inside),
        agreeing=agreeing,
        outside=sum(point.computed is None for point in points),
        failed=failed,
        same_regimes=0 < len(inside) == agreeing and not failed,
    )


def _point(results: Results, parameters: tuple[str, ...], measurement: Measurement) -> Point:
    measured = dict(zip(parameters, measurement.values, strict=True))
    values = {axis.parameter: measured.get(axis.parameter, math.nan) for axis in results.axes}
    try:
        cell = results.nearest(measured)
    except ClunkError:  # beyond an axis
        return Point(values, measurement.label, None, None)
    computed = results.coded_labels[results.sequence[cell]]
    return Point(values, measurement.label, computed, results.place(cell))


def _trend(axis: ResultAxis, points: tuple[Point, ...]) -> Trend:
    """Trend between neighbours: points that differ in this parameter only, with no measured point between them."""
    lines: dict[tuple[str, ...], dict[float, list[Point]]] = defaultdict(lambda: defaultdict(list))
    for point in points:
        # as text, so that NaN, a parameter that was not measured, is equal to itself
        fixed = tuple(repr(value) for key, value in point.at.items() if key != axis.parameter)
        lines[fixed][point.at[axis.parameter]].append(point)
    changes = [
        (
            double_sided(second.measured) - double_sided(first.measured),
            double_sided(str(second.computed)) - double_sided(str(first.computed)),
        )
        for line in lines.values()
        for lower, upper in pairwise(sorted(line))
        for first in line[lower]
        for second in line[upper]
        if first.counts and second.counts
    ]
    measured, computed = np.sign(np.array(changes, int)).reshape(-1, 2).T
    return Trend(
        parameter=axis.parameter,
        symbol=axis.symbol,
        pairs=len(changes),
        alike=int((measured == computed).sum()),
        opposed=int((measured * computed < 0).sum()),
    )
