"""Parameters: the numeric keys of a config that have a quantity; they can be swept, drawn, read and replaced.

A parameter is named by its dotted key. Items of a list are numbered from 1; inertias, shafts and lashes may be given by
name instead: ``driveline.inertias[ring]``. The numbers of the loaded inertia and of the severity's inertia are
parameters, too. ``solver.max_events`` is none, since it is a limit and not physics. Neither are the ends of shafts and
lashes, since another topology is another study.
"""

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from clunk.study.arrays import Floats
from clunk.study.document import Document, Place, dotted, items_of, parse_place, value_at, with_value
from clunk.study.errors import ConfigError, Problem, nearest, shorten
from clunk.study.keys import ITEM, Key, key_at, keys
from clunk.study.models import NOT_OF_A_RUN, Config, lash_name
from clunk.study.sweeps import Draw
from clunk.study.tables import OTHER_UNITS, Quantity

_NAMED_ITEMS = 100  # most items of a list that `parameters` enumerates


Names = Mapping[str, Sequence[Any]]  # "driveline.inertias", "driveline.shafts", "lash" -> names of the items


def place_of(parameter: str, names: Names) -> Place | None:
    """Place of a dotted key, with item names resolved to positions; None where it is malformed or a name is unknown.

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


def names_of(document: Any) -> Names:
    """The names of the inertias, shafts and lashes of a document or a config."""
    lash = value_at(document, ("lash",))
    lashes = items_of(lash) or ((lash,) if lash is not None else ())
    return {
        "driveline.inertias": items_of(value_at(document, ("driveline", "names"))),
        "driveline.shafts": [
            value_at(shaft, ("name",)) for shaft in items_of(value_at(document, ("driveline", "shafts")))
        ],
        "lash": [lash_name(k, value_at(each, ("name",))) for k, each in enumerate(lashes)],
    }


def parameters(document: Any) -> list[str]:
    """Dotted keys of the parameters that a document or a config can have, with or without a value.

    Of a list only the first `_NAMED_ITEMS` items are among them.
    """
    known = []
    for pattern, key in keys().items():
        places: list[Place] = [()] if key.quantity is not None else []
        for step in pattern:
            places = [(*at, each) for at in places for each in _steps(value_at(document, at), step)]
        known += [dotted(at) for at in places if not items_of(value_at(document, at))]
    return known


def spellings(document: Any) -> dict[str, str]:
    """Spellings of the parameters of a document or a config, with numbers or names of items -> the parameter."""
    known = parameters(document)
    written = {parameter: parameter for parameter in known}
    for listed, names in names_of(document).items():
        for number, name in enumerate(names, 1):
            item = listed if (listed, len(names)) == ("lash", 1) else f"{listed}[{number}]"
            for parameter in known:
                if parameter == item or parameter.startswith(f"{item}."):
                    leaf = parameter.removeprefix(item)
                    written |= {f"{listed}[{way}]{leaf}": parameter for way in (number, name) if way is not None}
    return written


def numbered(parameters: Iterable[str], document: Any) -> list[str]:
    """Parameters as a sweep writes them, with numbers of items in the place of names; unknown ones as they are."""
    written = spellings(document)
    return [written.get(parameter, parameter) for parameter in parameters]


def _steps(value: Any, step: str | int) -> Sequence[str | int]:
    """Steps by which a place can continue from a value along a pattern: positions for `ITEM`, else the key itself.

    There are none for a key where the value is a list with items.
    """
    items = items_of(value)
    if step == ITEM:
        return range(min(len(items), _NAMED_ITEMS))
    return () if items else (step,)


def parameter_at(parameter: str, document: Any) -> tuple[Place, Key]:
    """Place and key of a parameter in a document or a config.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    place = place_of(parameter, names_of(document) if "[" in parameter else {}) or ()  # (): a table without quantity
    key = key_at(place)
    if key is not None and key.quantity is not None and _is_there(place, document):
        return place, key
    table, _, leaf = parameter.rpartition(".")
    meant, known = f"{table}.{OTHER_UNITS.get(leaf, leaf)}", parameters(document)
    likely = nearest(meant, [name for name in known if name.startswith(f"{meant}[")] or known)
    hint = f"did you mean {shorten(likely)}?" if likely else "load.ratio and driveline.inertias[4] are such keys"
    text = f"a config has no number {shorten(parameter)} that can be swept; {hint}"
    raise ConfigError(text, [Problem(parameter, None, text)])


def _is_there(place: Place, document: Any) -> bool:
    """Whether a document can hold a number at a place, whose lists and tables it may leave out.

    It cannot where a list lacks the item, or where the value at the place, or a table on the way, is a list instead.
    """
    value = document
    for step in (*place, ""):
        count = len(items_of(value))
        if value is not None and not (step < count if isinstance(step, int) else count == 0):
            return False
        value = value_at(value, (step,))
    return True


def located(config: Config, parameter: str) -> tuple[Place, Key, float]:
    """Place, key and value of a parameter; the value is NaN where the config has none.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    place, key = parameter_at(parameter, config)
    value = value_at(config, place)
    return place, key, math.nan if value is None else float(value)


def distinct(config: Config, keys: Iterable[str]) -> tuple[str, ...]:
    """Dotted keys with item names replaced by numbers. Raises ConfigError where a key is unknown or given twice."""
    known = tuple(dotted(located(config, key)[0]) for key in keys)
    if len({*known}) < len(known):
        raise ConfigError(f"One of these keys is given twice: {', '.join(known)}.")
    return known


def with_values(config: Config, values: Mapping[str, Any]) -> tuple[Document, dict[Place, str]]:
    """Tables of one run of a config with other values of some parameters; and place -> parameter of these.

    The tables of sweep, fit and optimisation are left out.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    document, parameter_at = config.model_dump(exclude=NOT_OF_A_RUN), {}
    for parameter, value in values.items():
        place, key, _ = located(config, parameter)
        plain = value.item() if hasattr(value, "item") else value  # numpy scalars become Python numbers
        is_whole = key.whole and isinstance(plain, float) and plain.is_integer()
        document = with_value(document, place, int(plain) if is_whole else plain)
        parameter_at[place] = parameter
    return document, parameter_at


def drawn_numbers(config: Config, draws: Sequence[Draw]) -> list[Floats]:
    """Numbers that the sweep's sampling draws for each of these draws, (count,) each: values, factors or offsets."""
    if not draws:
        return []
    # tolerances of swept keys are factors or offsets, which need no nominal value
    swept = {axis.parameter for axis in config.swept.axes}
    points = zip(draws, config.swept.sampling.points(len(draws)).T, strict=True)
    return [
        draw.quantiles(each, math.nan if draw.parameter in swept else nominal_value(config, draw.parameter))
        for draw, each in points
    ]


def with_draws(
    config: Config, values: Mapping[str, Floats], draws: Sequence[Draw], numbers: Iterable[Floats]
) -> dict[str, Floats]:
    """Values of parameters after draws have been applied in order.

    A draw acts on the key's value so far: at first that in `values`, or else the nominal value of the config.

    values : parameter -> values, in its key's unit
    numbers : of each draw, values, factors or offsets, see `drawn_numbers`
    """
    drawn = dict(values)
    for draw, each in zip(draws, numbers, strict=True):
        around = drawn.get(draw.parameter, nominal_value(config, draw.parameter))
        drawn[draw.parameter] = draw.applied(each, around)
    return drawn


def nominal_value(config: Config, parameter: str) -> float:
    """The value of a parameter in a config, in its key's unit; NaN where the config gives none.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    return located(config, parameter)[2]


@functools.lru_cache(maxsize=1024)
def quantity(parameter: str) -> Quantity:
    """Quantity of a parameter: name and symbol with the numbers of its items, and unit in the notation of udunits.

    Raises
    ------
    ConfigError
        Where there is no such parameter.
    """
    place, key = parameter_at(parameter, {})
    assert key.quantity is not None
    items = [step + 1 for step in place if isinstance(step, int)]
    return Quantity(key.quantity.name.format(*items), key.quantity.symbol.format(*items), key.quantity.unit)
