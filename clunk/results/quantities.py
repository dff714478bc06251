"""The quantities of maps, described once, in quantities.csv: what files, plots and tables say of each."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

import numpy as np

from clunk.core.status import QUALITY_MEANINGS, Status
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.study.problems import nearest

_UNIT_SYMBOLS = {"1": "", "rad s-1": "rad/s", "rad s-2": "rad/s²"}
_WORDS: dict[str, Mapping[int, str]] = {  # integer -> word
    "": {},
    "labels": {FAILED_CODE: FAILED},  # of a map's own labels, and of what failed
    "status": {status.value: status.name.lower() for status in Status},
    "quality": QUALITY_MEANINGS,
    "flank": {-1: "initial", 0: "none", 1: "opposite"},
}


@dataclass(frozen=True)
class Quantity:
    """A quantity of each cell of a map, or of each primary impact, label or quantile of a cell.

    name : of the attribute of `Results` or `ToleranceMap` and of the variable in the file
    dtype : numpy scalar type
    unit : in the notation of UDUNITS, ``1`` where there is none
    dimension : the dimension behind the map's axes: ``impact``, ``label``, ``quantile``; empty where there is none
    of : ``lash``, or ``cell`` where all lashes of a cell have the same
    coded : ``labels``, ``status``, ``quality`` or ``flank``, where the integers are codes or bits of these
    words, symbol : name and symbol for people; empty where the values are not drawn or printed as numbers
    title : name in plots, where that is not `words`
    long_name : description in the file
    """

    name: str
    dtype: type[np.generic]
    unit: str
    dimension: str
    of: str
    coded: str
    words: str
    symbol: str
    title: str
    long_name: str

    @property
    def unit_symbol(self) -> str:
        """The unit as people write it, e.g. ``rad/s²``; empty where there is none."""
        return _UNIT_SYMBOLS.get(self.unit, self.unit)

    @property
    def heading(self) -> str:
        """Name and symbol, e.g. ``severity Q``."""
        return f"{self.words} {self.symbol}".rstrip()

    @property
    def heading_with_unit(self) -> str:
        """Name, symbol and unit, e.g. ``severity Q [rad/s²]``."""
        return self.heading + (f" [{self.unit_symbol}]" if self.unit_symbol else "")

    @property
    def plot_label(self) -> str:
        """Name, symbol and unit beside an axis or a colour bar, e.g. ``Severity Q [rad/s²]``."""
        title = self.title or self.words[:1].upper() + self.words[1:]
        return title + self.heading_with_unit.removeprefix(self.words)

    def meanings(self, labels: Sequence[str]) -> dict[int, str]:
        """Word of each code or bit, in a map with these labels; empty where the values are numbers."""
        # The failed code comes last: flag_meanings.split()[code] is then right for -1, too.
        return (dict(enumerate(labels)) if self.coded == "labels" else {}) | dict(_WORDS[self.coded])


def likely_name(text: str, names: Iterable[str]) -> str | None:
    """The name that a word most likely means: that of the quantity with this symbol, or the nearest one, if any."""
    names = list(names)
    symbols = {name: each.symbol for quantities in _MAPS.values() for name, each in quantities.items()}
    return next((name for name in names if symbols.get(name) == text.strip()), None) or nearest(text, names)


def _read() -> dict[str, dict[str, Quantity]]:
    """Read the table: map -> name -> quantity, in the order of the variables in a file and in its digest."""
    maps: dict[str, dict[str, Quantity]] = {}
    text = files(__package__).joinpath("quantities.csv").read_text("utf-8")
    for row in csv.DictReader(text.splitlines()):
        quantities = maps.setdefault(row.pop("map"), {})
        dtype = np.dtype(row.pop("dtype")).type
        quantities[row["name"]] = Quantity(dtype=dtype, **row)
    return maps


_MAPS = _read()
REGIME_QUANTITIES = _MAPS["regimes"]
CELL_QUANTITIES = {name: each for name, each in REGIME_QUANTITIES.items() if not each.dimension}
IMPACT_QUANTITIES = {name: each for name, each in REGIME_QUANTITIES.items() if each.dimension == "impact"}
TOLERANCE_QUANTITIES = _MAPS["tolerances"]


def measured_quantities(of_impacts: Sequence[str], measures: Sequence[Mapping[str, Any]]) -> dict[str, Quantity]:
    """Quantities that a config asks for, of cells and then of impacts.

    of_impacts : impacts.quantities
    measures : the tables [[measures]], each with its name, quantity, part and reduction
    """
    table = _MAPS["measures"]
    measured = {name: table[name] for name in of_impacts}
    for measure in measures:
        of, described = measure["of"], table[measure["quantity"]]
        about = f"{described.words} of {of}" if isinstance(of, str) else f"{described.long_name} {of}"
        words = f"{measure['reduce']} {about}"
        measured[measure["name"]] = replace(described, name=measure["name"], words=words, long_name=words)
    return measured | {f"impact_{name}": table[f"impact_{name}"] for name in of_impacts}
