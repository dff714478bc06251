"""Maps over swept parameters: what regime maps and tolerance maps have in common."""

from __future__ import annotations

import tomllib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from clunk.results.boundaries import Boundaries
from clunk.results.dataset import COUNTED_BY
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import Quantity
from clunk.study.arrays import Array, Floats, Integers
from clunk.study.axes import LASH, RUN, ResultAxis
from clunk.study.models import lash_name, lash_position
from clunk.study.records import Rows, as_text, counted

Index = tuple[slice | int, ...]


@lru_cache(maxsize=4)
def tables_of(config: str) -> dict[str, Any]:
    """The tables of a config's TOML, parsed once for all maps of a runner; none of what is no TOML."""
    try:
        return tomllib.loads(config)
    except tomllib.TOMLDecodeError:
        return {}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Map(ABC):
    """A map over one or more swept parameters, base of `Results` and `ToleranceMap`.

    "Shape" is the axes' counts in order. Of several lashes the last axis is `lash`, and each lash of a cell counts as a
    cell; see `of_lash`.

    title : str
    axes : one or more `ResultAxis`; of several lashes the last is `lash`
    coordinates : the parameters that change together along the axis `run`, if there is one; each as long as it
    labels : code -> label; the code -1 is a failed cell
    config, config_digest : the resolved TOML and its digest
    attributes : versions, date and machine, by name
    arrays : by the names of `quantities`, which are attributes of the map, too: over the axes and the quantity's
        dimension; what each primary impact has, of the impacts of all cells in C order
    sample : of a tolerance map, one `ResultAxis` for each toleranced parameter; its values are what was drawn, (N,):
        the parameter's values, factors on its nominal value or offsets from it
    boundaries : of a regime map, the curves between the labels, if they have been traced

    Raises ValueError where these do not belong together: where the arrays are not those of the map's quantities, an
    array's shape or dtype is not its quantity's, or a code has no label.
    """

    title: str
    axes: tuple[ResultAxis, ...]
    labels: tuple[str, ...]
    config: str
    config_digest: str
    attributes: dict[str, str]
    arrays: Mapping[str, Array]
    coordinates: tuple[ResultAxis, ...] = ()
    sample: tuple[ResultAxis, ...] = ()
    boundaries: Boundaries | None = None

    def __post_init__(self) -> None:
        if set(self.arrays) != set(self.quantities):
            raise ValueError("the arrays are not those of the quantities that the config asks for")
        for name, quantity in self.quantities.items():
            shape = (*self.shape, len(self.entries[quantity.dimension])) if quantity.dimension else self.shape
            if quantity.dimension in COUNTED_BY:
                shape = (int(self.first_impact[-1]),)
            require_array(name, self.arrays[name], shape, quantity.dtype)
        require_codes(self.labels, self.arrays["sequence"])

    @property
    def shape(self) -> tuple[int, ...]:
        """The axes' counts in order."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def parameters(self) -> tuple[ResultAxis, ...]:
        """The swept parameters: the axes, and in the place of `run` its coordinates."""
        return parameters_of(self.axes, self.coordinates)

    @property
    def lashes(self) -> tuple[str, ...]:
        """The names of the lashes that the axis `lash` is for; none without it."""
        return self.axes[-1].words if self.axes[-1].parameter == LASH else ()

    @property
    def lash_names(self) -> tuple[str, ...]:
        """The names of the lashes, also of an only one."""
        return self.lashes or (self.setting("lash.name") or lash_name(0, None),)

    def setting(self, key: str) -> Any:
        """Value of a dotted key of the resolved config; None where it has none."""
        table: Any = tables_of(self.config)
        for name in key.split("."):
            table = table.get(name) if isinstance(table, dict) else None
        return table

    if not TYPE_CHECKING:  # the subclasses say which attributes there are

        def __getattr__(self, name: str) -> Array:
            """A quantity's array."""
            try:
                return self.__dict__["arrays"][name]
            except KeyError:
                raise AttributeError(f"{type(self).__name__} has no {name}") from None

    def with_arrays(self, **arrays: Array) -> Self:
        """The map with other values of some quantities."""
        return replace(self, arrays={**self.arrays, **arrays})

    @property
    @abstractmethod
    def quantities(self) -> dict[str, Quantity]:
        """The quantities of the map, in the order of their file."""

    @property
    @abstractmethod
    def quantities_of_cells(self) -> dict[str, Quantity]:
        """The quantities that each cell has, by the names that options take; see `clunk.results.quantities`."""

    def plot_label(self, quantity: Quantity) -> str:
        """Name of one of `quantities_of_cells`, with symbol and unit, beside an axis or a colour bar."""
        return quantity.plot_label

    @abstractmethod
    def of_labels(self, numbers: Sequence[float]) -> Floats:
        """What follows from the label of each cell; NaN where it failed. numbers : of the labels, in their order"""

    @abstractmethod
    def numbers(self, name: str) -> Floats:
        """A number of `quantities_of_cells` in each cell as float64, NaN where it failed or it is not defined."""

    @property
    @abstractmethod
    def entries(self) -> dict[str, Array]:
        """Entries of the dimensions behind the axes: of ``impact`` numbers, of ``label`` the labels and so on."""

    def values(self, name: str) -> Array:
        """Values of one of the quantities, in cells; those of impacts in a flat array."""
        return self.arrays[name]

    @cached_property
    def first_impact(self) -> Integers:
        """Position of each cell's first impact in the flat arrays, and last their number: (cells + 1,), in C order."""
        return np.concatenate(([0], np.cumsum(self.arrays["primary_impacts"], dtype=np.int64)))

    def at(self, values: Mapping[str, float]) -> Self:
        """Slice at some axes' values, the nearest of each: ``results.at({"lash.contact.stiffness": 4e5})``.

        Those axes stay, with one value; of `run` a run's number, and its coordinates stay with theirs. Labels and codes
        are those of the whole.

        Raises ValueError where a name is not an axis, or a value lies beyond it.
        """
        names = [axis.parameter for axis in self.axes]
        index: list[slice] = [slice(None)] * len(names)
        for parameter, value in values.items():
            if parameter not in names:
                raise ValueError(f"{parameter!r} is no axis of these results; their axes are {', '.join(names)}")
            k = names.index(parameter)
            position = self.axes[k].nearest(value)
            index[k] = slice(position, position + 1)
        run = index[names.index(RUN)] if RUN in names else slice(None)
        axes = tuple(axis.part(places) for axis, places in zip(self.axes, index, strict=True))
        return self._part(tuple(index), axes, tuple(axis.part(run) for axis in self.coordinates))

    def at_lash(self, name: str | None = None) -> Self:
        """Slice at one lash, by name or number; by default at the first. The map itself where there is only one.

        Raises ConfigError where there is no such lash.
        """
        position = lash_position(name, self.lash_names)
        return self.at({LASH: self.axes[-1].values[position]}) if self.lashes else self

    def counts(self) -> dict[str, int]:
        """Number of cells of each label, in the labels' order, and last of ``failed`` (also where it is 0).

        Of a tolerance map, cells in which the label is the most likely one.
        """
        sequence = self.arrays["sequence"].ravel().astype(np.intp)
        cells = np.bincount(sequence - FAILED_CODE, minlength=len(self.labels) + 1).tolist()
        return dict(zip((*self.labels, FAILED), (*cells[1:], cells[0]), strict=True))

    def by_lash(self) -> dict[str, Self]:
        """The map of each lash, by name."""
        return {name: self.of_lash(name) for name in self.lash_names}

    def of_lash(self, name: str | None = None) -> Self:
        """Map of one lash, by name or number, without the axis `lash`; by default of the first, or the only one.

        Raises ConfigError where there is no such lash.
        """
        position = lash_position(name, self.lash_names)
        if not self.lashes:
            return self
        places: Index = (*[slice(None)] * len(self.axes[1:]), position)
        return self._part(places, self.axes[:-1], self.coordinates)

    def _part(self, index: Index, axes: tuple[ResultAxis, ...], coordinates: tuple[ResultAxis, ...]) -> Self:
        """The slice at these positions on the axes; of a whole map of their lash, with the boundaries."""
        arrays = {
            name: np.ascontiguousarray(self.arrays[name][index])
            for name, each in self.quantities.items()
            if each.dimension not in COUNTED_BY
        }
        if "primary_impacts" in arrays:
            cells = np.arange(self.first_impact.size - 1).reshape(self.shape)[index].ravel()
            count, first = np.diff(self.first_impact)[cells], self.first_impact[cells]
            begin = np.cumsum(count) - count  # of each cell's impacts in the slice
            impacts = np.arange(count.sum()) + np.repeat(first - begin, count)
            arrays |= {name: self.arrays[name][impacts] for name in self.quantities if name not in arrays}
        lash = np.array(self.lashes)[index[-1:]].ravel().tolist() if self.lashes else [""]
        is_whole = all(places == slice(None) for places in index[: len(self.axes) - bool(self.lashes)])
        is_theirs = self.boundaries is not None and lash == [self.boundaries.lash]
        boundaries = self.boundaries if is_whole and is_theirs else None
        return replace(self, axes=axes, coordinates=coordinates, arrays=arrays, boundaries=boundaries)

    def summary(self) -> Rows:
        """Pairs of a name and a value on what was swept and drawn, for people."""
        rows = [("axis", f"{axis.parameter}: {axis.spread}") for axis in self.axes]
        rows += [("along run", f"{axis.parameter}: {axis.spread}") for axis in self.coordinates]
        return rows + [("drawn", f"{each.name}: {each.spread}") for each in self.sample]

    @abstractmethod
    def label_table(self) -> list[dict[str, str]]:
        """A row for each label that occurs, with its part of the map, for people: texts by heading."""

    @property
    @abstractmethod
    def facts(self) -> Rows:
        """Pairs of a name and a value on what the labels leave out, for people."""

    def __repr__(self) -> str:
        labels = [tuple(row.values()) for row in self.label_table()]
        rows = [*self.summary(), *self.facts, *((label, ", ".join(numbers)) for label, *numbers in labels)]
        return as_text(f"clunk.{type(self).__name__} {self.title!r}", rows)


def parameters_of(axes: Sequence[ResultAxis], coordinates: Sequence[ResultAxis]) -> tuple[ResultAxis, ...]:
    """The swept parameters: the axes, and in the place of `run` its coordinates."""
    return tuple(each for axis in axes for each in (coordinates if axis.parameter == RUN else [axis]))


def values_at(
    axes: Sequence[ResultAxis], cell: Sequence[int], coordinates: Sequence[ResultAxis] = ()
) -> tuple[float, ...]:
    """Values of the parameters in a cell, in the order of `parameters_of`; of `run` its number without coordinates."""
    return tuple(
        float(each.values[k])
        for axis, k in zip(axes, cell, strict=True)
        for each in (coordinates if axis.parameter == RUN and coordinates else [axis])
    )


def at_cell(parameters: Sequence[ResultAxis], values: Sequence[float]) -> dict[str, float | str]:
    """A cell by its parameters, words for numbers that have them."""
    return {axis.parameter: axis.word(value) or value for axis, value in zip(parameters, values, strict=True)}


def share(count: int, cells: int) -> str:
    """A number of cells and their part of all cells, for people: ``21 cells, 4.8 %``."""
    return f"{counted(count, 'cell')}, {100.0 * count / cells:.1f} %"


def require_codes(labels: tuple[str, ...], sequence: npt.NDArray[np.int16]) -> None:
    """Raise ValueError where a code has no label."""
    if sequence.min() < FAILED_CODE or sequence.max() >= len(labels):
        raise ValueError("sequence holds a code without a label")


def require_array(name: str, array: Array, shape: tuple[int, ...], dtype: type[np.generic]) -> None:
    """Raise ValueError where an array has another shape or dtype."""
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(f"{name} must be {np.dtype(dtype)} {shape}, not {array.dtype} {array.shape}")
