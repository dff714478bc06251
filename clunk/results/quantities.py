"""The quantities of runs and of maps, described once, in quantities.csv, for files, plots and tables.

To add a quantity of each run, add a field of `core.tile.CELL`, compute it there, and add a row of quantities.csv with
the field's name. Then reserve the name in `study.rules`, raise `netcdf.SCHEMA_VERSION`, and list the quantity in the
help on the file format.

`quantity_of` reads a quantity of runs in the words that options such as --of and --quantity take:

label, regimes                       the label
severity, touches, margin, …         a number, see `quantities_of`
impulse, peak_torque, energy         numbers, see `clunk help measures`; of a study, also if its config does not ask for
                                     them (impacts.quantities), of a map only if it does
shuffle                              a measure of the config, by its name (here "shuffle")
severity<=8000, touches=4            whether a quantity is <=, <, >=, > or = a number
double_sided=0                       whether a condition does not hold; with 1, whether it holds
single_sided, double_sided, …        whether the label has an SS, a DS, an OS (opposite_sided), a CR (crossed)
NI, SS, DS, OS, CR                   short for label=NI, single_sided and so on
chatter                              whether a run has touches that are no primary impacts
label=DS(1)SS(1)                     whether the label is this one
nominal_label                        whether the label is that of the run without tolerances, see `Quantity.named`

>>> import clunk
>>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
>>> severity = quantity_of("severity", results)
>>> severity.type, severity.heading_with_unit, severity.of_runs(results).max() > 2e4
('number', 'severity Q [rad/s²]', np.True_)
>>> hard = quantity_of("severity<=8000", results)
>>> hard.type, hard.heading, int(hard.of_runs(results).sum())
('yes/no', 'severity Q is at most 8000 rad/s²', 244)
"""

from __future__ import annotations

import contextlib
import csv
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clunk.core.status import QUALITY_MEANINGS, Status
from clunk.results.labels import FAILED, FAILED_CODE, double_sided, normalised_label, primary_impacts
from clunk.study.arrays import Array
from clunk.study.errors import ClunkError, listing, nearest, shorten
from clunk.study.models import OF_IMPACTS
from clunk.study.records import capital, with_unit
from clunk.study.study import Study

if TYPE_CHECKING:
    from clunk.results.maps import AnyMap

TEXT, NUMBER, WHOLE, YES_NO = "label", "number", "whole number", "yes/no"  # types of quantities
LABEL, CHATTER, NOMINAL = "label", "chatter", "nominal_label"
_SIDED = {"single_sided": "SS", "double_sided": "DS", "opposite_sided": "OS", "crossed": "CR"}  # -> the word in labels
_SHORT = {word: name for name, word in _SIDED.items()} | {"NI": "label=NI", "REGIMES": LABEL}
_RELATIONS: dict[str, tuple[Callable[[Any, Any], Any], str]] = {
    "<=": (operator.le, "is at most"),
    "<": (operator.lt, "is less than"),
    ">=": (operator.ge, "is at least"),
    ">": (operator.gt, "is greater than"),
    "=": (operator.eq, "is"),
}
WHY_UNDEFINED = {  # quantity -> end of a sentence on why runs or cells have no value
    "severity": "; under the restitution model accelerations are impulsive, and approach_velocity is the measure",
    "peak_torque": "; under the restitution model torques are impulsive, and impulse is the measure",
    "margin": "; only the exact method knows it (solver.method)",
}
_REQUEST = re.compile(r"\s*([^<>=\s]+)\s*(?:(<=|>=|<|>|=)\s*(.*?)\s*)?", re.DOTALL)

_UNIT_SYMBOLS = {"1": "", "rad s-1": "rad/s", "rad s-2": "rad/s²"}
_WORDS: dict[str, Mapping[int, str]] = {  # coding -> code or bit -> word
    "": {},
    "labels": {FAILED_CODE: FAILED},  # `Quantity.meanings` adds the labels of a map
    "status": {status.value: status.name.lower() for status in Status},
    "quality": QUALITY_MEANINGS,
    "flank": {-1: "initial", 0: "none", 1: "opposite"},
}


class Quantity(NamedTuple):
    """A quantity of each run or cell of a map, or of each primary impact, label or quantile of a cell.

    name : name in options; of a quantity in files also the name of its variable and of the map's attribute
    dtype : numpy scalar type; bool for a condition (yes/no), str for a label
    unit : in the notation of UDUNITS, ``1`` where there is none
    dimension : the dimension behind the map's axes: ``impact``, ``label``, ``quantile``; empty where there is none
    of : ``lash``, or ``cell`` where all lashes of a cell have the same value
    coded : ``labels``, ``status``, ``quality`` or ``flank``, where the integers are codes or bits of these; else empty
    words, symbol : name and symbol for people; empty where the values are not drawn or printed as numbers
    title : name in plots; empty where that is `words`
    long_name : description in the file
    base, relation, bound : of a comparison such as ``severity<=8000``, the quantity that is compared, the operator, and
        the number or label with which it is compared; else None, empty and NaN
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
    base: Quantity | None = None
    relation: str = ""
    bound: float | str = math.nan

    @property
    def type(self) -> str:
        """``label``, ``number``, ``whole number`` or ``yes/no``."""
        if issubclass(self.dtype, np.bool_):
            return YES_NO
        if issubclass(self.dtype, np.str_):
            return TEXT
        return WHOLE if issubclass(self.dtype, np.integer) else NUMBER

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
        return with_unit(self.heading, self.unit_symbol)

    @property
    def plot_label(self) -> str:
        """Name, symbol and unit beside an axis or a colour bar, e.g. ``Severity Q [rad/s²]``."""
        title = self.title or capital(self.words)
        return title + self.heading_with_unit.removeprefix(self.words)

    def meanings(self, labels: Sequence[str]) -> dict[int, str]:
        """Code or bit -> word, in a map with these labels; empty where the values are plain numbers."""
        # The code of failed cells, -1, comes last, so that flag_meanings.split()[code] is right for it, too.
        return (dict(enumerate(labels)) if self.coded == "labels" else {}) | dict(_WORDS[self.coded])

    def of_runs(self, results: AnyMap) -> Array:
        """The quantity in each cell of a map, in the map's shape.

        Numbers are float64, NaN where they are not defined. Conditions are 1 or 0, in a tolerance map probabilities.
        Labels are texts. A cell that failed has NaN, or the label ``failed``.
        """
        if self.type == TEXT:
            return results.label_map
        if self.of_label("NI") is not None:
            return results.of_labels([self.of_label(label) or 0.0 for label in results.labels])
        if self.name == CHATTER:
            holds = results.touches > results.primary_impacts
            return np.where(results.sequence == FAILED_CODE, np.nan, holds)
        if self.base is None:
            return results.numbers(self.name)
        numbers = self.base.compared(results)
        return np.where(np.isnan(numbers), np.nan, _RELATIONS[self.relation][0](numbers, self.bound))

    def compared(self, results: AnyMap) -> Array:
        """Values with which runs are compared, as `of_runs`, except for two quantities.

        Of a margin, the magnitude is compared; the time of the last event is 0 in runs without events.
        """
        values = self.of_runs(results)
        if self.name == "margin":
            return abs(values)
        if self.name == "last_event_time":
            values = np.where(results.sequence == FAILED_CODE, np.nan, np.nan_to_num(values))
        return values

    def of_label(self, label: str) -> float | None:
        """Value of the quantity if it follows from the label alone: a number of impacts, or 1 or 0; else None."""
        if self.name in _SIDED:
            return float(f"{_SIDED[self.name]}(" in label)
        if self.name == NOMINAL or (self.base is not None and self.base.type == TEXT):
            return float(label == self.bound)
        if self.base is not None:
            value = self.base.of_label(label)
            return None if value is None else float(_RELATIONS[self.relation][0](value, self.bound))
        count = {"double_sided_impacts": double_sided, "primary_impacts": primary_impacts}.get(self.name)
        return None if count is None else float(count(label))

    def named(self, nominal: str) -> Quantity:
        """The quantity `nominal_label` bound to the label of the run without tolerances; others are unchanged."""
        if self.name != NOMINAL:
            return self
        return self._replace(words=f"the label is the nominal {nominal}", bound=nominal)


Quantities = dict[str, Quantity]  # by name


def _read() -> dict[str, Quantities]:
    """Read quantities.csv: map -> name -> quantity, in the order of the variables in a file and in its digest."""
    maps: dict[str, Quantities] = {}
    text = files(__package__).joinpath("quantities.csv").read_text("utf-8")
    row: dict[str, Any]
    for row in csv.DictReader(text.splitlines()):
        quantities = maps.setdefault(row.pop("map"), {})
        dtype = np.dtype(row.pop("dtype")).type
        quantities[row["name"]] = Quantity(dtype=dtype, **row)
    return maps


_MAPS = _read()
REGIME_QUANTITIES = _MAPS["regimes"]
TOLERANCE_QUANTITIES = _MAPS["tolerances"]
OF_RUNS = _MAPS["runs"]


def measured_quantities(of_impacts: Sequence[str], measures: Sequence[Mapping[str, Any]]) -> Quantities:
    """Quantities that a config asks for: those of cells, measures among them, then those of primary impacts.

    of_impacts : impacts.quantities of the config
    measures : the tables [[measures]], each with its name, quantity, part (`of`) and reduction (`reduce`)
    """
    table = _MAPS["measures"]
    measured = {name: table[name] for name in of_impacts}
    for measure in measures:
        of, described = measure["of"], table[measure["quantity"]]
        about = f"{described.words} of {of}" if isinstance(of, str) else f"{described.long_name} {of}"
        words = f"{measure['reduce']} {about}"
        measured[measure["name"]] = described._replace(name=measure["name"], words=words, long_name=words)
    return measured | {f"impact_{name}": table[f"impact_{name}"] for name in of_impacts}


def named_numbers(quantities: Quantities) -> Quantities:
    """The quantities among these that are one number for each cell, no codes, and have a name for people."""
    return {name: each for name, each in quantities.items() if each.words and not each.dimension and not each.coded}


def quantities_of(source: Study | AnyMap) -> Quantities:
    """The quantities of a study's runs, or those that a map has in each cell, by the names that options take.

    The label comes first. Comparisons such as ``severity<=8000`` are not among them; see `quantity_of`.
    """
    if not isinstance(source, Study):
        return source.quantities_of_cells
    measured = measured_quantities(OF_IMPACTS, [dict(each) for each in source.measures])
    return {LABEL: OF_RUNS[LABEL]} | named_numbers(REGIME_QUANTITIES | measured) | OF_RUNS


def quantity_of(text: str, source: Study | AnyMap) -> Quantity:
    """The quantity of a study's runs or of a map's cells that a text asks for, in the words of the module's table.

    Raises ClunkError where there is no such quantity, a comparison is malformed or not possible for a tolerance map, or
    the quantity is not defined for the study's contact model or method.
    """
    known, is_drawn = quantities_of(source), not isinstance(source, Study) and len(source.sample) > 0
    text = re.sub(
        r"^\w+(?=\s*([<>=]|$))",
        lambda found: found[0] if found[0] in known else _SHORT.get(found[0].upper(), found[0]),
        text.strip(),
    )
    words = _REQUEST.fullmatch(text)
    name, relation, bound = words.groups("") if words else (text, "", "")
    if name not in known:
        names = [*known, *["severity<=8000"] * (not is_drawn), "label=DS(1)SS(1)"]
        likely = nearest(name, names)
        hint = f"; did you mean {likely}?" if likely else "."
        if name in OF_IMPACTS and "margin" in known:  # a tolerance map has neither margin nor these
            hint = f"; impacts.quantities = [{name!r}] in the config measures it."
        raise ClunkError(f"There is no quantity {shorten(text)} here; there are {listing(names)}{hint}")
    if (
        isinstance(source, Study)
        and name in WHY_UNDEFINED
        and (source.solver.method == "rk4" if name == "margin" else source.has_rigid_flanks)
    ):
        raise ClunkError(f"{name} is not defined{WHY_UNDEFINED[name]}.")
    quantity = known[name]
    if not relation:
        return quantity
    value = _compared(quantity, relation, bound)
    if value is None:
        raise ClunkError(
            f"{shorten(text)} compares nothing: a number is compared with a number, as in severity<=8000, and a label "
            "is one such as label=DS(1)SS(1)."
        )
    bound_text = value if isinstance(value, str) else f"{value:.15g}"
    compared = OF_RUNS[CHATTER]._replace(
        name=f"{name}{relation}{bound_text}", base=quantity, relation=relation, bound=value
    )
    if is_drawn and compared.of_label("NI") is None:
        raise ClunkError(
            f"A tolerance map has no {compared.name}: it keeps the mean and the quantiles of a number over its "
            "draws, not the share of draws in which the number is within a bound."
        )
    meaning = f"{quantity.heading} {_RELATIONS[relation][1]} {bound_text} {quantity.unit_symbol}".rstrip()
    meaning = f"the {meaning}" if quantity.type == TEXT else meaning
    return compared._replace(words=meaning, long_name=f"whether {meaning}")


def _compared(quantity: Quantity, relation: str, bound: str) -> float | str | None:
    """Label or number with which a quantity is compared; None where the quantity cannot be compared with it."""
    with contextlib.suppress(ValueError):
        if quantity.type == TEXT:
            return normalised_label(bound) if relation == "=" else None
        number = float(bound)
        is_whether = relation == "=" and number in (0.0, 1.0)
        if math.isfinite(number) and (quantity.type != YES_NO or is_whether) and quantity.name != NOMINAL:
            return number
    return None


def measuring(study: Study, quantities: Iterable[Quantity]) -> Study:
    """The study with only those measures and quantities of impacts that these quantities need.

    Its margin tolerance is 0, so that no run is marked as undecided by its margin.
    """
    names = {(each.base or each).name for each in quantities}
    impacts = study.impacts.but(quantities=tuple(name for name in OF_IMPACTS if name in names))
    measures = tuple(measure for measure in study.measures if measure.name in names)
    return study.but(impacts=impacts, measures=measures, solver=study.solver.but(margin_tolerance=0.0))
