"""Outcomes of runs, in the words of `--of`: the label, a number, or whether something holds.

label                                the label
severity, touches and other numbers  see `MEASURED`
impulse, peak_torque, energy         see `clunk help measures`; the config need not ask for them
shuffle                              a measure of the config, by its name
severity<=8000, touches=4            whether a number is <=, <, >=, > or = another
single_sided, double_sided, …        whether the label has an SS, a DS, an OS (opposite_sided), a CR (crossed)
NI, SS, DS, OS, CR                   short for label=NI, single_sided and so on
chatter                              whether touches follow that are no primary impacts
label=DS(1)SS(1)                     whether it is this one
nominal_label                        whether it is that of the run without tolerances
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clunk.results.labels import normalised_label
from clunk.results.quantities import CELL_QUANTITIES, Quantity, likely_name, measured_quantities
from clunk.study.arrays import Floats
from clunk.study.errors import ClunkError
from clunk.study.measures import OF_IMPACTS
from clunk.study.problems import listing, shorten
from clunk.study.study import Study

if TYPE_CHECKING:
    from clunk.results.regimemap import Results

MEASURED = ("severity", "approach_velocity", "primary_impacts", "touches", "last_event_time")
LABEL, CHATTER, NOMINAL = "label", "chatter", "nominal_label"
SIDED = {"single_sided": "SS", "double_sided": "DS", "opposite_sided": "OS", "crossed": "CR"}  # -> the word in labels
_SHORT = {word: name for name, word in SIDED.items()} | {"NI": "label=NI"}
_RELATIONS: dict[str, tuple[Callable[[Any, Any], Any], str]] = {
    "<=": (operator.le, "is at most"),
    "<": (operator.lt, "is less than"),
    ">=": (operator.ge, "is at least"),
    ">": (operator.gt, "is greater than"),
    "=": (operator.eq, "is"),
}
_UNDEFINED = {"severity": "approach_velocity", "peak_torque": "impulse"}  # of impulsive touches, and what is
_WORDS = re.compile(r"\s*([^<>=\s]+)\s*(?:(<=|>=|<|>|=)\s*(.*?)\s*)?", re.DOTALL)


@dataclass(frozen=True)
class Outcome:
    """An outcome of runs.

    quantity : a number's name, or `LABEL`, `CHATTER`, `NOMINAL` or one of `SIDED`
    relation : of the quantity to the bound, if the outcome is whether that holds; else empty
    bound : a number, or a label
    number : description of a quantity that is a number
    """

    quantity: str
    relation: str = ""
    bound: float | str = math.nan
    number: Quantity | None = None

    @property
    def name(self) -> str:
        """The outcome as it is written after `--of`."""
        bound = self.bound if isinstance(self.bound, str) else f"{self.bound:.15g}"
        return f"{self.quantity}{self.relation}{bound if self.relation else ''}"

    @property
    def is_indicator(self) -> bool:
        """Whether the outcome is 1 where something holds and else 0."""
        return bool(self.relation) or self.quantity in (*SIDED, CHATTER, NOMINAL)

    def heading(self, nominal: str = "") -> str:
        """Name for people, of numbers with symbol and unit; nominal : the label without tolerances."""
        if (quantity := self.number) is not None:
            if not self.relation:
                return quantity.heading_with_unit
            return (
                f"{quantity.heading} {_RELATIONS[self.relation][1]} {self.bound:.15g} {quantity.unit_symbol}".rstrip()
            )
        if self.quantity in SIDED:
            return f"the label has {'an' if self.quantity[0] == 'o' else 'a'} {self.quantity.replace('_', '-')} impact"
        if self.quantity == CHATTER:
            return "a primary impact chatters"
        if self.quantity == NOMINAL:
            return f"the label is the nominal {nominal}"
        return f"the label is {self.bound}" if self.relation else "the label"

    def of_runs(self, results: Results, nominal: str = "") -> Floats:
        """A number, or an indicator's 1 and 0, in each cell: float64 of the results' shape; failed cells count not.

        Where nothing happens, no event is later than the load step: in a relation its time counts as 0.

        nominal : the label without tolerances
        """
        if self.number is not None:
            numbers = np.asarray(results.values(self.quantity), np.float64)
            if not self.relation:
                return numbers
            if self.quantity == "last_event_time":
                numbers = np.nan_to_num(numbers)
            return np.asarray(_RELATIONS[self.relation][0](numbers, self.bound), np.float64)
        if self.quantity == CHATTER:
            return np.asarray(results.touches > results.primary_impacts, np.float64)
        wanted = nominal if self.quantity == NOMINAL else self.bound
        word = SIDED.get(self.quantity)
        holds = [label == wanted if word is None else f"{word}(" in label for label in results.labels]
        return np.array([*holds, math.nan])[results.sequence]  # the code of failed cells, -1, is the last


def outcome_of(text: str, study: Study, without: Mapping[str, str], error: type[ClunkError]) -> Outcome:
    """Outcome in the words of `--of`.

    Parameters
    ----------
    text : str
    study : Study
        Of whose runs it is.
    without : quantity -> sentence
        Quantities that cannot be asked for alone, and why; an empty sentence where the quantity is not known there.
    error : type of ClunkError
        What is raised where there is no such outcome.
    """
    text = _SHORT.get(text.strip().upper(), text)
    words = _WORDS.fullmatch(text)
    quantity, relation, bound = words.groups("") if words else (text, "", "")
    numbers = numbers_of(study)
    if without.get(quantity) == "" or quantity not in (LABEL, *numbers, *SIDED, CHATTER, NOMINAL):
        raise error(_unknown(text, quantity, without, numbers))
    if quantity in _UNDEFINED and any(lash.contact.model == "restitution" for lash in study.lashes):
        raise error(f"{quantity} is not defined for the restitution model; {_UNDEFINED[quantity]} is.")
    if not relation:
        if quantity in without:
            raise error(without[quantity])
        return Outcome(quantity, number=numbers.get(quantity))
    if quantity == LABEL and relation == "=":
        try:
            return Outcome(LABEL, "=", normalised_label(bound))
        except ValueError:
            raise error(f"{shorten(text)} names no label; an example is 'label=DS(1)SS(1)'.") from None
    if quantity not in numbers:
        example = "label=DS(1)SS(1)" if quantity == LABEL else quantity
        raise error(f"{shorten(text)}: only numbers are compared so; {example!r} is an outcome.")
    try:
        number = float(bound)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise error(f"{shorten(text)}: {shorten(bound)} is not a number to compare {quantity} with.")
    return Outcome(quantity, relation, number, numbers[quantity])


def numbers_of(study: Study) -> dict[str, Quantity]:
    """The numbers that outcomes of a study's runs can be."""
    of_every_run = {name: CELL_QUANTITIES[name] for name in MEASURED}
    measured = measured_quantities(OF_IMPACTS, [dict(each) for each in study.measures])
    return of_every_run | {name: each for name, each in measured.items() if not each.dimension}


def measuring(study: Study, outcomes: Iterable[Outcome]) -> Study:
    """The study whose runs are measured by what these outcomes need, and by nothing else."""
    names = {outcome.quantity for outcome in outcomes}
    impacts = study.impacts.model_copy(update={"quantities": tuple(name for name in OF_IMPACTS if name in names)})
    measures = tuple(measure for measure in study.measures if measure.name in names)
    return study.model_copy(update={"impacts": impacts, "measures": measures})


def _unknown(text: str, quantity: str, without: Mapping[str, str], numbers: Iterable[str]) -> str:
    known = [name for name in (LABEL, *numbers, *SIDED, CHATTER, NOMINAL) if name not in without]
    examples = ["severity<=8000", "label=DS(1)SS(1)"]
    likely = likely_name(quantity, [*known, *(name for name, sentence in without.items() if sentence)])
    hint = f"; did you mean {likely}?" if likely else "."
    return f"There is no outcome {shorten(text)}; there are {listing([*known, *examples])}{hint}"
