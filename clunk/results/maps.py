"""Maps over swept parameters: regime maps, with the outcome of every cell, and tolerance maps, with probabilities."""

import tomllib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from clunk.core.status import QUALITY_COMPLETE, QUALITY_MEANINGS, Status
from clunk.results.boundaries import Boundaries
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.netcdf import COUNTED_BY
from clunk.results.quantities import (
    CHATTER,
    LABEL,
    NOMINAL,
    OF_RUNS,
    REGIME_QUANTITIES,
    TEXT,
    TOLERANCE_QUANTITIES,
    YES_NO,
    Quantities,
    Quantity,
    measured_quantities,
    named_numbers,
    quantity_of,
)
from clunk.study.arrays import Array, Counts, Floats, Integers
from clunk.study.axes import LASH, ResultAxes, parameters_of
from clunk.study.designs import Design
from clunk.study.document import Document, value_at
from clunk.study.errors import ClunkError
from clunk.study.loads import PROFILES, numbers
from clunk.study.models import WhichLash, lash_name, lash_position
from clunk.study.parameters import numbered
from clunk.study.records import Rows, as_text, counted, percent


@lru_cache(maxsize=4)
def tables_of(config: str) -> Document:
    """The tables of a config's TOML, cached, since all maps of a runner have one config; empty where it is no TOML."""
    try:
        return tomllib.loads(config)
    except tomllib.TOMLDecodeError:
        return {}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Map(Design, ABC):
    """A map over one or more swept parameters, base of `Results` and `ToleranceMap`.

    "Shape" is the axes' counts in order. Of several lashes the last axis is `lash`, and each lash of a cell counts as a
    cell; see `of_lash`.

    title : str
    axes : one or more `ResultAxis`; of several lashes the last is `lash`
    labels : code -> label; the code -1 is a failed cell
    config, config_digest : the resolved TOML and its digest
    attributes : versions, date and machine, by name
    arrays : name in `quantities` -> array, which is also an attribute of the map. Its shape is the map's, followed by
        the length of the quantity's dimension, if any; quantities of primary impacts are flat, with the impacts of
        all cells in C order
    sample : of a tolerance map, one `ResultAxis` for each toleranced parameter; its values are the drawn numbers, (N,):
        the parameter's values, factors on its nominal value or offsets from it
    boundaries : of a regime map, the curves between the labels, if they have been traced

    Raises ValueError where these do not belong together: where the arrays are not those of the map's quantities, an
    array's shape or dtype is not its quantity's, or a code has no label.
    """

    title: str
    labels: tuple[str, ...]
    config: str
    config_digest: str
    attributes: dict[str, str]
    arrays: Mapping[str, Array]
    sample: ResultAxes = ()
    boundaries: Boundaries | None = None

    def __post_init__(self) -> None:
        if set(self.arrays) != set(self.quantities):
            raise ValueError("the arrays are not those of the quantities that the config asks for")
        of_cells, entries = self.shape, self.entries
        for name, quantity in self.quantities.items():
            shape = (*of_cells, len(entries[quantity.dimension])) if quantity.dimension else of_cells
            if quantity.dimension in COUNTED_BY:
                shape = (int(self.first_impact[-1]),)
            array = self.arrays[name]
            if array.shape != shape or array.dtype != quantity.dtype:
                raise ValueError(f"{name} must be {np.dtype(quantity.dtype)} {shape}, not {array.dtype} {array.shape}")
        if self.sequence.min() < FAILED_CODE or self.sequence.max() >= len(self.labels):
            raise ValueError("sequence holds a code without a label")

    @property
    def lashes(self) -> tuple[str, ...]:
        """The names of the lashes along the axis `lash`; empty where the map has no such axis."""
        return self.axes[-1].words if self.axes[-1].parameter == LASH else ()

    @property
    def lash_names(self) -> tuple[str, ...]:
        """The names of the lashes, also of a single one."""
        return self.lashes or (lash_name(0, value_at(self.tables, ("lash", "name"))),)

    @property
    def tables(self) -> Document:
        """The resolved config; not to be changed."""
        return tables_of(self.config)

    def load_phrase(self, without: Sequence[str] = ()) -> str:
        """The load in words, by its profile and numbers; shown with a map, since an ideal step is a worst case.

        Keys of [load] that are swept or in `without` are left out.
        """
        load = self.tables.get("load", {})
        if load.get("profile") not in PROFILES:
            return ""
        swept = [axis.parameter.removeprefix("load.") for axis in self.parameters]
        return ", ".join([PROFILES[load["profile"]].name, *numbers(load, [*without, *swept])])

    def __getattr__(self, name: str) -> Array:
        """A quantity's array."""
        array: Array | None = self.__dict__.get("arrays", {}).get(name)
        if array is None:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        return array

    @property
    @abstractmethod
    def quantities(self) -> Quantities:
        """The quantities of the map, in the order of their file."""

    @property
    @abstractmethod
    def entries(self) -> dict[str, Array]:
        """Coordinate values of the dimensions behind the axes, by dimension, such as the labels along ``label``."""

    def values(self, name: str) -> Array:
        """Values of a quantity in the shape of the map; those of primary impacts in a flat array.

        Raises ClunkError where the map has no quantity of this name.
        """
        this: Any = self  # for mypy: a map is always one of `AnyMap`
        return self.arrays[name] if name in self.arrays else quantity_of(name, this).of_runs(this)

    def plot_label(self, quantity: Quantity) -> str:
        """Name of a quantity of cells, with symbol and unit, beside an axis or a colour bar.

        In a tolerance map a yes/no quantity is named as the probability of the condition.
        """
        return f"Probability that {quantity.words}" if self.sample and quantity.type == YES_NO else quantity.plot_label

    @cached_property
    def first_impact(self) -> Integers:
        """Position of each cell's first impact in the flat arrays, in C order, then the number of all: (cells + 1,)."""
        return np.concatenate(([0], self.primary_impacts.cumsum(dtype=np.int64)))

    def at(self, values: Mapping[str, float | str]) -> Self:
        """Slice of the map at the nearest values of some axes: ``results.at({"lash.contact.stiffness": 4e5})``.

        The slice keeps these axes, with one value each. A lash is given by name or number, a run of the axis `run` by
        number; the coordinates along `run` are then those of the run. Labels and codes are those of the whole map.

        Raises ClunkError where a name is not an axis, or a value lies beyond its axis.

        values : parameter of an axis -> value, in its unit
        """
        names = parameters_of(self.axes)
        index = [slice(None)] * len(names)
        for parameter, value in zip(numbered(values, self.tables), values.values(), strict=True):
            if parameter not in names:
                raise ClunkError(f"{parameter!r} is no axis of these results; their axes are {', '.join(names)}.")
            k = names.index(parameter)
            position = self.axes[k].nearest(value)
            index[k] = slice(position, position + 1)
        return self._part(tuple(index))

    def place(self, cell: Sequence[int]) -> dict[str, float | str]:
        """Values of the parameters in a cell, for the axis `lash` the name; cell : positions on the axes, from 0."""
        return {
            each.parameter: each.words[position] if each.words else float(each.values[position])
            for axis, position in zip(self.axes, cell, strict=True)
            for each in axis.parameters
        }

    def at_lash(self, name: WhichLash = None) -> Self:
        """Slice at one lash, by name or number, which keeps the axis `lash`; by default at the first lash.

        A map without the axis `lash` is returned as it is.

        Raises ConfigError where there is no such lash.
        """
        position = lash_position(name, self.lash_names)
        return self.at({LASH: self.axes[-1].values[position]}) if self.lashes else self

    @property
    def coded_labels(self) -> tuple[str, ...]:
        """The label of each code; the last one is ``failed``, so that the code -1 finds it."""
        return (*self.labels, FAILED)

    @property
    def label_map(self) -> npt.NDArray[np.str_]:
        """Label of each cell, shape; ``failed`` where the run failed. Of a tolerance map, the most likely one."""
        return np.array(self.coded_labels)[self.sequence]

    def counts(self) -> dict[str, int]:
        """Number of cells of each label, in the labels' order, and last of ``failed`` (also where it is 0).

        Of a tolerance map, cells in which the label is the most likely one.
        """
        sequence = self.sequence.ravel().astype(np.intp)
        cells = np.bincount(sequence - FAILED_CODE, minlength=len(self.coded_labels))
        return dict(zip(self.coded_labels, np.roll(cells, -1).tolist(), strict=True))

    def by_lash(self) -> dict[str, Self]:
        """The map of each lash, by name."""
        return {name: self.of_lash(name) for name in self.lash_names}

    def of_lash(self, name: WhichLash = None) -> Self:
        """Map of one lash, by name or number, without the axis `lash`; by default of the first lash.

        Raises ConfigError where there is no such lash.
        """
        position = lash_position(name, self.lash_names)
        if not self.lashes:
            return self
        return self._part((*[slice(None)] * len(self.axes[1:]), position))

    def _part(self, index: tuple[slice | int, ...]) -> Self:
        """The map at these positions on the axes: a slice keeps its axis, a number drops it.

        Boundaries are kept where the slices of all axes but `lash` are whole, and their lash is in the part.
        """
        pairs = zip(self.axes, index, strict=True)
        axes = tuple(axis.part(places) for axis, places in pairs if isinstance(places, slice))
        arrays = {
            name: np.ascontiguousarray(self.arrays[name][index])
            for name, each in self.quantities.items()
            if each.dimension not in COUNTED_BY
        }
        if "primary_impacts" in arrays:
            is_part = np.zeros(self.shape, bool)
            is_part[index] = True
            impacts = is_part.ravel().repeat(self.primary_impacts.ravel())
            arrays |= {name: self.arrays[name][impacts] for name in self.quantities if name not in arrays}
        lash = np.array(self.lashes)[index[-1:]].ravel().tolist() if self.lashes else [""]
        is_whole = all(places == slice(None) for places in index[: len(self.axes) - bool(self.lashes)])
        is_theirs = self.boundaries is not None and self.boundaries.lash in lash
        boundaries = self.boundaries if is_whole and is_theirs else None
        return replace(self, axes=axes, arrays=arrays, boundaries=boundaries)

    def summary(self) -> Rows:
        """Pairs of a name and a text on the axes and the drawn parameters, for people."""
        rows = [("axis", f"{axis.parameter}: {axis.spread}") for axis in self.axes]
        rows += [("along run", f"{axis.parameter}: {axis.spread}") for axis in self.coordinates]
        return rows + [("drawn", f"{each.name}: {each.spread}") for each in self.sample]

    @abstractmethod
    def label_table(self) -> list[dict[str, str]]:
        """A row for each label that occurs, with its part of the map, for people: texts by heading."""

    @property
    @abstractmethod
    def facts(self) -> Rows:
        """Pairs of a name and a text on properties of the map that the label table lacks, for people."""

    def __repr__(self) -> str:
        labels = [row.values() for row in self.label_table()]
        rows = [*self.summary(), *self.facts, *((label, ", ".join(numbers)) for label, *numbers in labels)]
        return as_text(f"clunk.{type(self).__name__} {self.title!r}", rows)


def share(count: int, cells: int) -> str:
    """A number of cells and their part of all cells, for people: ``21 cells, 4.8 %``."""
    return f"{counted(count, 'cell')}, {100.0 * count / cells:.1f} %"


# --- Regime maps -----------------------------------------------------------------------------------------------------


class Results(Map):
    """A regime map: a label for each cell, its quantities and its primary impacts.

    Its fields are those of `Map`. Its arrays are the following, and those of the quantities and measures that the
    config asks for in addition, see `values`.

    sequence : shape, codes into `labels`
    severity : shape, Q  [rad/s²], NaN where it is not defined
    approach_velocity : shape, V  [rad/s]
    last_event_time : shape  [s after the load step], NaN where nothing happened
    primary_impacts, touches : shape, their numbers; touches include chatter
    status, quality : shape; see `clunk.core.status`
    initial_side : shape, sign of the gap coordinate on the initial flank, 0 without an initial flank
    margin : shape, dimensionless: how near the run came to another label, positive for what did not happen and negative
        for what did (see `clunk.core.exact.margins`); NaN where the method gives no margin
    impact_time : (N,)  [s after the load step]; cells in C order, cell k has `primary_impacts[k]` consecutive entries
    impact_flank : (N,), +1 opposite, -1 initial
    impact_closing_speed : (N,)  [rad/s]
    impact_severity : (N,) Q_i  [rad/s²]
    """

    @cached_property
    def quantities(self) -> Quantities:
        """The quantities of these results, in the order of their file."""
        return quantities_of_config(self.config)

    @cached_property
    def quantities_of_cells(self) -> Quantities:
        """The label, the stored quantities that are numbers, and the other ones of `OF_RUNS`, mostly conditions."""
        holding = {name: each for name, each in OF_RUNS.items() if name != NOMINAL}
        return {LABEL: OF_RUNS[LABEL]} | named_numbers(self.quantities) | holding

    def of_labels(self, numbers: Sequence[float]) -> Floats:
        """The number of each cell's label, shape; NaN in failed cells. numbers : one for each of `labels`"""
        return np.array([*numbers, np.nan])[self.sequence]  # the code of failed cells, -1, is the last

    def numbers(self, name: str) -> Floats:
        """A quantity of cells as float64, NaN where the run failed."""
        return np.where(self.sequence == FAILED_CODE, np.nan, self.values(name).astype(np.float64))

    @property
    def caveats(self) -> list[str]:
        """Phrases that qualify the labels: how many runs ended before it was proved that nothing more happens."""
        run = self.of_lash()  # all lashes of a run end together
        count = np.count_nonzero((run.status == Status.OK) & (run.quality & QUALITY_COMPLETE == 0))
        cells = counted(run.sequence.size, "run")
        return [f"{count:,} of {cells} ended at solver.end_time with more to follow"] if count else []

    @property
    def entries(self) -> dict[str, Array]:
        """Numbers of primary impacts along ``impact``: up to the most that a cell has, and at least 1."""
        return {"impact": np.arange(1, max(1, self.primary_impacts.max()) + 1, dtype=np.int32)}

    def cell(self, values: Mapping[str, float | str]) -> dict[str, Any]:
        """Label, quantities and primary impacts of the cell nearest to these values, by name.

        Parameters
        ----------
        values : by parameter, for every axis, in its unit; a lash by name or number

        Returns
        -------
        dict
            The value of each parameter in this cell; its `label`; each quantity of a cell, by name; the names of its
            `status` and `quality` in the place of their codes; and each quantity of its primary impacts, in arrays.

        Raises
        ------
        ClunkError
            Where an axis is missing, a name is no axis, or a value lies beyond its axis.

        Examples
        --------
        >>> import clunk
        >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
        >>> cell = results.cell({"load.ratio": 5.0, "lash.backlash_deg": 6.0})
        >>> cell["label"], cell["touches"], cell["quality"]
        ('DS(1)SS(1)', 9, ['complete'])
        >>> cell["impact_time"].round(4)  # s after the load step
        array([0.1191, 0.2613, 0.565 ])
        """
        names = parameters_of(self.axes)
        if set(numbered(values, self.tables)) != set(names):
            raise ClunkError(f"A cell is named by {' and '.join(names)}, not by {', '.join(values) or 'nothing'}.")
        part = self.at(values)
        cell: dict[str, Any] = {axis.parameter: axis.values.item() for axis in (*part.axes, *part.coordinates)}
        cell["label"] = part.label_map.item()
        for name, quantity in self.quantities.items():
            cell[name] = part.arrays[name] if quantity.dimension else part.arrays[name].item()
        cell["status"] = Status(cell["status"]).name.lower()
        cell["quality"] = [name for bit, name in QUALITY_MEANINGS.items() if cell["quality"] & bit]
        return cell

    def label_table(self) -> list[dict[str, str]]:
        """See `Map.label_table`: the number of cells, and their share."""
        return [
            {"label": label, "cells": f"{n:,}", "share": f"{n / self.sequence.size:.1%}"}
            for label, n in self.counts().items()
            if n
        ]

    @property
    def facts(self) -> Rows:
        """See `Map.facts`: the range of the severity, and how many cells have each quality."""
        rows = []
        if np.isfinite(self.severity).any():
            quantity = REGIME_QUANTITIES["severity"]
            spread = f"{np.nanmin(self.severity):.0f} to {np.nanmax(self.severity):.0f} {quantity.unit_symbol}"
            rows.append((quantity.heading, spread))
        counts = {name: int(np.count_nonzero(self.quality & bit)) for bit, name in QUALITY_MEANINGS.items()}
        rows += [(name, share(count, self.sequence.size)) for name, count in counts.items() if count]
        return rows if self.boundaries is None else [*rows, *self.boundaries.summary()]


def quantities_of_config(config: str) -> Quantities:
    """Quantities of the results of a resolved config: those of all runs, then those that the config asks for."""
    tables = tables_of(config)
    measured = measured_quantities(tables.get("impacts", {}).get("quantities", ()), tables.get("measures", ()))
    return REGIME_QUANTITIES | measured


# --- Tolerance maps --------------------------------------------------------------------------------------------------


QUANTILES = (0.05, 0.5, 0.95)
_QUANTILE_NAMES = [f"severity_{100 * level:g}" for level in QUANTILES]
CERTAIN = 0.95  # a cell whose most likely label is less probable lies in the band between regimes


class ToleranceMap(Map):
    """A map whose every cell was run for the same sample of the toleranced parameters.

    Its fields are those of `Map`. N is the size of the sample.

    probability : shape + (labels + 1,), share of each label in the N runs of a cell, and last of the failed ones;
        other probabilities are of the runs that did not fail
    sequence : shape, codes of the most likely labels; of equally likely ones the first in the labels' order
    nominal_sequence : shape, codes of the runs without tolerances
    severity_mean : shape, mean Q of the runs that did not fail  [rad/s²]; without impacts Q is 0. NaN where it is not
        defined
    severity_quantiles : shape + (3,), the `QUANTILES` of the same Q, linear between order statistics (type 7 of
        Hyndman and Fan, doi:10.2307/2684934)
    status : shape, how the first run that failed ended (see `clunk.core.status`), 0 where none did
    """

    @property
    def quantities(self) -> Quantities:
        """The quantities of a tolerance map, in the order of their file."""
        return TOLERANCE_QUANTITIES

    @cached_property
    def quantities_of_cells(self) -> Quantities:
        """The most likely label, probabilities of conditions on labels, and the severity's mean and quantiles."""
        of_labels = {
            name: each
            for name, each in OF_RUNS.items()
            if each.type in (TEXT, YES_NO) and name not in (CHATTER, NOMINAL)
        }
        quantile = self.quantities["severity_quantiles"]._replace(dimension="")
        quantiles = {
            name: quantile._replace(name=name, words=f"{100 * level:g} % {quantile.words}")
            for name, level in zip(_QUANTILE_NAMES, QUANTILES, strict=True)
        }
        mean = self.quantities["severity_mean"]._replace(name="severity")
        return of_labels | {"severity": mean} | quantiles

    def of_labels(self, numbers: Sequence[float]) -> Floats:
        """Mean number of the labels of a cell's runs that did not fail, shape; NaN where all failed.

        numbers : one for each of `labels`; with 1 and 0, the mean is the share of the runs with a 1
        """
        return self._of_finished(self.runs[..., :FAILED_CODE] @ np.asarray(numbers, np.float64))

    def _of_finished(self, runs: Counts | Floats) -> Floats:
        """Numbers of runs, or sums over runs, divided by the number of the cell's runs that did not fail."""
        finished = self.draws - self.runs[..., FAILED_CODE]
        return np.divide(runs, finished, out=np.full(self.shape, np.nan), where=finished > 0)

    def numbers(self, name: str) -> Floats:
        """The severity's mean or one of its quantiles in each cell."""
        if name in _QUANTILE_NAMES:
            return np.ascontiguousarray(self.severity_quantiles[..., _QUANTILE_NAMES.index(name)])
        return self.severity_mean

    @property
    def entries(self) -> dict[str, Array]:
        """Labels and last ``failed`` along ``label``, levels along ``quantile``, numbers along ``draw``."""
        draws = np.arange(1, self.draws + 1, dtype=np.int32)
        return {"label": np.array(self.coded_labels), "quantile": np.array(QUANTILES), "draw": draws}

    @property
    def draws(self) -> int:
        """Size of the sample, N."""
        return len(self.sample[0])

    @cached_property
    def runs(self) -> Counts:
        """Number of a cell's N runs with each label, and last of those that failed: shape + (labels + 1,)."""
        return np.rint(self.probability * self.draws).astype(np.int32)

    @property
    def certainty(self) -> Floats:
        """Probability of the most likely label among the runs that did not fail, shape; NaN where all failed."""
        return self._of_finished(self.runs[..., :FAILED_CODE].max(axis=-1, initial=0))

    @property
    def caveats(self) -> list[str]:
        """Phrases that qualify the probabilities: how many runs failed and are left out of them."""
        cells = self.of_lash().runs[..., FAILED_CODE]  # all lashes of a run fail together
        if not cells.any():
            return []
        affected, most = counted(int(np.count_nonzero(cells)), "cell"), percent(cells.max(), self.draws)
        return [f"failed: up to {most} of the runs in {affected}; maps show the other runs"]

    @property
    def failed(self) -> int:
        """Number of runs that failed, of all cells."""
        return int(self.runs[..., FAILED_CODE].sum(dtype=np.int64))

    @property
    def uncertain(self) -> int:
        """Number of cells whose most likely label is less probable than `CERTAIN`."""
        return int(np.count_nonzero(self.certainty < CERTAIN))

    def shares(self) -> dict[str, float]:
        """Share of each label in all runs; last that of ``failed``."""
        total = self.runs.reshape(-1, self.runs.shape[-1]).sum(axis=0, dtype=np.int64)
        return dict(zip(self.coded_labels, (total / total.sum()).tolist(), strict=True))

    def label_table(self) -> list[dict[str, str]]:
        """See `Map.label_table`: the cells in which a label is the most likely one, and its share of all runs."""
        counts = self.counts()
        return [
            {"label": label, "cells, most likely": f"{counts[label]:,}", "share of runs": f"{part:.4%}"}
            for label, part in self.shares().items()
            if part
        ]

    @property
    def facts(self) -> Rows:
        """See `Map.facts`: how many cells are uncertain, have another label than the nominal one, or failed runs."""
        cells = self.sequence.size
        moved = (self.sequence != self.nominal_sequence).sum()
        draws = f"{self.draws:,} draws" + " that did not fail" * bool(self.failed)
        rows = [
            ("uncertain", f"{share(self.uncertain, cells)}: no label has {CERTAIN:.0%} of the {draws}"),
            ("moved", f"{share(moved, cells)}: another most likely label than without tolerances"),
        ]
        affected = counted((self.runs[..., FAILED_CODE] > 0).sum(), "cell")
        failed = ("failed", f"{self.failed:,} of {cells * self.draws:,} runs, in {affected}")
        return [*rows, failed] if self.failed else rows


AnyMap = Results | ToleranceMap
