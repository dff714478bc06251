"""Parameters: the keys that measure something, by their dotted names; they can be swept, drawn, read and replaced.

Items of a list go by number from 1, inertias and lashes also by name: ``driveline.inertias[ring]``. The loaded inertia
and the inertia of the severity are among them, by number. ``solver.max_events`` is not: it is a limit, not physics.
Neither are the ends of shafts and lashes: another topology is another study.
"""

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from clunk.study.arrays import Floats
from clunk.study.document import Place, dotted, items_of, parse_place, value_at, with_value
from clunk.study.errors import ConfigError, Problem, nearest, shorten
from clunk.study.keys import ITEM, Key, key_at, keys
from clunk.study.models import NOT_OF_A_RUN, Config, lash_name
from clunk.study.sweeps import Draw
from clunk.study.tables import OTHER_UNITS, Quantity

_NAMED_ITEMS = 100  # of a list, among which a misspelt parameter is looked for


Names = Mapping[str, Sequence[Any]]  # of the items of driveline.inertias, driveline.shafts and lash


def place_of(parameter: str, names: Names) -> Place | None:
    """Place that a dotted key names, a name in brackets resolved; None where it is malformed, or there is no such name.

    The only lash may be numbered or named, too: ``lash[1].radius`` is then ``lash.radius``.
    """
    place = parse_place(parameter) or ()
    for k, step in enumerate(place):
        if isinstance(step, str) and step.startswith("["):
            listed = names.get(dotted(place[:k]), ())
            if step[1:-1] not in listed:
                return None
            place = (*place[:k], listed.index(step[1:-1]), *place[k + 1 :])
    is_only_lash = place[:2] == ("lash", 0) and len(names.get("lash", ())) == 1
    return ("lash", *place[2:]) if is_only_lash else place or None


def names_of(document: Mapping[str, Any]) -> Names:
    """The names of a document's inertias, shafts and lashes."""
    lashes = items_of(document.get("lash")) or (document.get("lash"),)
    shafts = items_of(value_at(document, ("driveline", "shafts")))
    return {
        "driveline.inertias": items_of(value_at(document, ("driveline", "names"))),
        "driveline.shafts": [value_at(shaft, ("name",)) for shaft in shafts],
        "lash": [lash_name(k, value_at(lash, ("name",))) for k, lash in enumerate(lashes)],
    }


def parameters(document: Mapping[str, Any]) -> list[str]:
    """The parameters of a document, given or left out; of long lists the first."""
    known: list[Place] = []
    for pattern in (pattern for pattern, key in keys().items() if key.quantity is not None):
        places: list[Place] = [()]
        for step in pattern:
            if step != ITEM:  # a list has items, and no keys
                places = [at for at in places if not items_of(value_at(document, at))]
            places = [(*at, each) for at in places for each in (_items(document, at) if step == ITEM else [step])]
        known += places
    return [dotted(place) for place in known]


def _items(document: Mapping[str, Any], place: Place) -> range:
    return range(min(len(items_of(value_at(document, place))), _NAMED_ITEMS))


def complaint(parameter: str, document: Mapping[str, Any]) -> str | None:
    """Reason why a key cannot be swept in a document; None where it can."""
    place = place_of(parameter, names_of(document))
    key = None if place is None else key_at(place)
    if place is not None and key is not None and key.quantity is not None:
        for k, step in enumerate(place):
            count = len(items_of(value_at(document, place[:k])))
            if isinstance(step, str) and count:
                return f"there are {count} lashes; name one, {dotted((*place[:k], 0, *place[k:]))} for example"
            if isinstance(step, int) and step >= count:
                if value_at(document, place[:k]) is not None and not count:
                    return f"there is no {parameter}; {dotted(place[:k])} is one number"
                return f"there is no {parameter}; {dotted(place[:k])} has {count} items" if count else None
        if items_of(value_at(document, place)):
            return f"{parameter} has {len(items_of(value_at(document, place)))} stages; name one, {parameter}[1]"
        return None
    if place is not None and place[-1] in OTHER_UNITS:
        instead = dotted((*place[:-1], OTHER_UNITS[str(place[-1])]))
        return f"{parameter} cannot be swept; sweep {instead} instead, which it becomes"
    known = parameters(document)
    leaf = parameter.rsplit(".", 1)[-1]
    same_leaf = [name for name in known if name.rsplit(".", 1)[-1] == leaf or name.startswith(f"{parameter}[")]
    in_use = [name for name in same_leaf if value_at(document, place_of(name, {}) or ()) is not None]
    likely = next(iter(in_use or same_leaf), nearest(parameter, known))
    hint = f"; did you mean {shorten(likely)}?" if likely else "; a key such as load.ratio or driveline.inertias[4] can"
    if key is not None:
        return f"{shorten(parameter)} is no quantity that can be swept{hint}"
    return f"the config has no key {shorten(parameter)}{'' if likely else ' that can be swept'}{hint}"


def located(config: Config, parameter: str) -> tuple[Place, Key, float]:
    """Place, key and value of a parameter; the value is NaN where the config has none.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    shafts, inertias = [shaft.name for shaft in config.driveline.shafts], config.driveline.names or ()
    names = {"driveline.inertias": inertias, "driveline.shafts": shafts, "lash": config.lash_names}
    place = place_of(parameter, names)
    key = None if place is None else key_at(place)
    value: Any = config if key is not None and key.quantity is not None else None
    for step in place or ():
        if isinstance(step, int):
            value = value[step] if step < len(items_of(value)) else None
        else:
            value = getattr(value, step, None)
    if isinstance(value, tuple):  # one for each stage
        value = None
    message = complaint(parameter, config.model_dump(exclude_defaults=True)) if value is None else None
    if place is None or key is None or message is not None:
        raise _refusal(parameter, message)
    return place, key, math.nan if value is None else float(value)


def with_values(config: Config, values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[Place, str]]:
    """Tables of a config's run with other values of some parameters, and the parameters by their places.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    document, parameter_at = config.model_dump(exclude=NOT_OF_A_RUN), {}
    for parameter, value in values.items():
        place, key, _ = located(config, parameter)
        plain = value.item() if hasattr(value, "item") else value  # no scalar of numpy
        is_whole = key.whole and isinstance(plain, float) and plain.is_integer()
        document = with_value(document, place, int(plain) if is_whole else plain)
        parameter_at[place] = parameter
    return document, parameter_at


def drawn_numbers(config: Config, draws: Sequence[Draw]) -> list[Floats]:
    """Numbers that the sweep's sampling draws for each of these, (count,) each: values, factors or offsets."""
    if config.sweep is None or not draws:
        return []
    points = config.sweep.sampling.points(len(draws)).T
    return [draw.sample(each, unswept_value(config, draw.parameter)) for draw, each in zip(draws, points, strict=True)]


def with_draws(
    config: Config, values: Mapping[str, Floats], draws: Sequence[Draw], numbers: Iterable[Floats]
) -> dict[str, Floats]:
    """Values of parameters after draws, one after the other: of a key without any, on its nominal value."""
    drawn = dict(values)
    for draw, each in zip(draws, numbers, strict=True):
        around = drawn.get(draw.parameter, nominal_value(config, draw.parameter))
        drawn[draw.parameter] = draw.applied(each, around)
    return drawn


def unswept_value(config: Config, parameter: str) -> float:
    """The nominal value of a parameter; NaN for one that has none, or is swept: nothing is drawn around it then."""
    axes = config.sweep.axes if config.sweep is not None else ()
    return math.nan if any(axis.parameter == parameter for axis in axes) else nominal_value(config, parameter)


def nominal_value(config: Config, parameter: str) -> float:
    """The value of a parameter, in its own unit; NaN where it has none in this config.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    return located(config, parameter)[2]


@functools.lru_cache(maxsize=1024)
def quantity(parameter: str) -> Quantity:
    """Name, symbol and unit of what a parameter measures; the unit is one that udunits reads.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    place = place_of(parameter, {})
    key = None if place is None else key_at(place)
    if place is None or key is None or key.quantity is None:
        raise _refusal(parameter)
    items = [step + 1 for step in place if isinstance(step, int)]
    return Quantity(key.quantity.name.format(*items), key.quantity.symbol.format(*items), key.quantity.unit)


def _refusal(parameter: str, message: str | None = None) -> ConfigError:
    message = message or "is no numeric key of a config"
    return ConfigError(f"{parameter}: {message}", [Problem(parameter, None, message)])
