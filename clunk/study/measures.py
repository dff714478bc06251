"""Measures: quantities of a run besides Q and V, of each primary impact or over the whole run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, PlainValidator, ValidationInfo, WithJsonSchema

from clunk.study.axes import variable_of
from clunk.study.document import Place, items_of
from clunk.study.problems import listing, nearest, shorten
from clunk.study.tables import Finding, Table, Text, numbered_inertia, refusal

if TYPE_CHECKING:
    from clunk.study.models import Config

OF_IMPACTS = ("impulse", "peak_torque", "energy")  # of each primary impact
# Names in results files, and words for what is drawn or compared, that no measure can have
_TAKEN = {
    *("sequence", "severity", "approach_velocity", "primary_impacts", "touches", "last_event_time", "status"),
    *("quality", "initial_side", "margin", "impact_time", "impact_flank", "impact_closing_speed", "impact_severity"),
    *(*OF_IMPACTS, *(f"impact_{name}" for name in OF_IMPACTS)),
    *("regimes", "label", "double_sided", "chatter", "nominal_label", "run", "impact", "lash"),
}
_PARTS = {  # of a driveline, that a quantity can be of
    "acceleration": ("inertia",),
    "twist": ("shaft", "lash"),
    "shaft torque": ("shaft",),
    "contact torque": ("lash",),
}


class Part(NamedTuple):
    """An inertia, a shaft or a lash."""

    element: str  # "inertia", "shaft" or "lash"
    number: int  # from 0


def _identifier(name: str) -> str:
    if not (name.isascii() and name.isidentifier() and name[0] != "_"):
        raise refusal(((), f"found {shorten(name)}; must be a letter, then letters, digits or _, as in shuffle_torque"))
    return name


def _numbered(value: Any, info: ValidationInfo) -> Any:
    """Number of an inertia or a shaft that is given by its name; else the value, which a rule of the config judges."""
    if info.data.get("quantity") == "acceleration":
        return numbered_inertia(value, info)
    if not isinstance(value, int | str) or isinstance(value, bool):
        raise refusal(((), f"found {shorten(value)}; must be a number from 1, or a name"))
    driveline = info.context if isinstance(info.context, Mapping) else {}
    names = [shaft.get("name") for shaft in items_of(driveline.get("shafts")) if isinstance(shaft, dict)]
    return names.index(value) + 1 if isinstance(value, str) and value in names else value


class Measure(Table):
    """An extreme of a quantity over a run, from the load step to the end time.

    name : str, of the variable in results files
    of : int or str, number from 1 or name of an inertia or a shaft, or name of a lash
    reduce : the largest value less the smallest, or the largest magnitude
    """

    name: Annotated[Text, AfterValidator(_identifier)]
    quantity: Literal["acceleration", "twist", "shaft torque", "contact torque"]
    of: Annotated[
        int | str,
        PlainValidator(_numbered),
        WithJsonSchema({"type": ["integer", "string"], "minimum": 1, "description": "a number from 1, or a name"}),
    ]
    reduce: Literal["peak-to-peak", "largest"]


def part_of(measure: Measure, config: Config) -> Part | str:
    """The part of the driveline that a measure is of, or what is wrong with its name."""
    elements = _PARTS[measure.quantity]
    names: dict[str, Sequence[str | None]] = {
        "inertia": config.driveline.names or (None,) * len(config.driveline.inertias),
        "shaft": [shaft.name for shaft in config.driveline.shafts],
        "lash": config.lash_names,
    }
    for element in elements:
        if measure.of in names[element]:
            return Part(element, names[element].index(str(measure.of)))
    count = len(names[elements[0]])
    if isinstance(measure.of, int) and 1 <= measure.of <= count:
        return Part(elements[0], measure.of - 1)
    known = [name for element in elements for name in names[element] if name is not None]
    likely = nearest(measure.of, known) if isinstance(measure.of, str) else None
    hint = f"did you mean {shorten(likely)}? It" if likely else "it"
    article = "an" if elements[0] == "inertia" else "a"
    choices = [f"the number of {article} {elements[0]}, from 1 to {count}", *map(shorten, known)]
    return f"there is no {' or '.join(elements)} {shorten(measure.of)}; {hint} must be {listing(choices, 'or')}"


def parts_of(config: Config) -> list[Part]:
    """The parts of the driveline that the measures of a sound config are of."""
    return [part for measure in config.measures if isinstance(part := part_of(measure, config), Part)]


def _is_impulsive(part: Part, config: Config) -> bool:
    """Whether a part is at a lash whose touches are impulses."""
    rigid = [lash for lash in config.lashes if lash.contact.model == "restitution"]
    if part.element == "inertia":
        return any(part.number + 1 in lash.between for lash in rigid)
    return part.element == "lash" and bool(rigid)


def broken_measures(config: Config) -> Iterator[Finding]:
    """Require names that differ, and parts that there are; and no acceleration that an impulse makes infinite."""
    names = [measure.name for measure in config.measures]
    taken = _TAKEN | {variable_of(axis.parameter) for axis in (config.sweep.axes if config.sweep is not None else ())}
    for k, measure in enumerate(config.measures):
        place: Place = ("measures", k)
        if measure.name in names[:k]:
            yield (*place, "name"), f"measure {names.index(measure.name) + 1} has the name {shorten(measure.name)} too"
        if measure.name in taken or measure.name.startswith(("boundary", "junction", "region", "ring")):
            yield (*place, "name"), f"results files have another variable {shorten(measure.name)}; choose another name"
        part = part_of(measure, config)
        if isinstance(part, str):
            yield (*place, "of"), part
        elif _is_impulsive(part, config) and measure.quantity != "twist":
            text = f"under the restitution model a touch makes the {measure.quantity} infinite"
            yield (*place, "quantity"), f"{text}; twists and shaft torques stay finite"
