"""What may stand in a config: the keys with their ranges and units, and the rules that tie one key to another.

A *document* is a config as plain tables, lists and values. The rules take whatever in it makes sense and pass over the
rest, so that one wrong key does not hide what is wrong with another.
"""

import math
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from clunk.study.configfile import Place, dotted, nearest, parse_place, shorten
from clunk.study.distributions import BOUNDS, NEEDS, NUMBERS

Document = Mapping[str, Any]
Finding = tuple[Place, str]

LARGEST_GRID = 2**31  # cells
LONGEST_AXIS = 10_000_000  # values; known before any array is made
MOST_DRAWS = 1_000_000  # of a sample
MOST_STEPS = 1e9  # of one run; about ten seconds of nothing but stepping
LARGEST_SIZE = 1e30  # of inertias, stiffnesses, dampings and the radius, and the smallest is its inverse
WIDEST_SPREAD = 1e12  # of the inertias and of the springs of one driveline: four digits are left where they add up
FASTEST_RATE = 1e12  # 1/s, of stiffness or damping on an inertia; atoms swing ten times faster

STEP_TORQUES = ("initial_torque", "final_torque")
RATIO_TORQUES = ("static_torque", "ratio")


@dataclass(frozen=True)
class Quantity:
    """What a numeric key measures.

    name, symbol : for people, e.g. ``load ratio`` and ``σr = Td/Ts``; ``{}`` stands for an item's number
    unit : as udunits reads it, ``1`` for none
    """

    name: str
    symbol: str
    unit: str


@dataclass(frozen=True)
class MustBe:
    """What is allowed in a field, in words, where its type does not say it well."""

    words: str


@dataclass(frozen=True)
class Key:
    """What may stand at one place of a config.

    must_be : what is allowed, to follow "must be"
    children : the keys of a table
    choices : the words that are allowed, if only some are
    quantity : of a number that may be swept
    whole : whether only integers are allowed
    lowest, highest : bounds of a number, which it may reach unless `above` says otherwise
    above : whether the lowest bound itself is excluded
    """

    must_be: str
    children: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()
    quantity: Quantity | None = None
    whole: bool = False
    lowest: float = -math.inf
    highest: float = math.inf
    above: bool = False

    def allows(self, value: float) -> bool:
        """Whether a number lies within the bounds."""
        return (self.lowest < value if self.above else self.lowest <= value) and value <= self.highest

    @property
    def suffix(self) -> str:
        """The unit, in parentheses."""
        return "" if self.quantity is None or self.quantity.unit == "1" else f" ({self.quantity.unit})"


Schema = Mapping[Place, Key]
ITEM = "#"  # stands in a schema's places for any item of a list


def schema_of(model: type[BaseModel], place: Place = ()) -> dict[Place, Key]:
    """The keys of a model and of the models in it, from its fields' types, bounds and quantities."""
    schema = {place: Key("a table", children=tuple(model.model_fields))}
    for name, field in model.model_fields.items():
        schema |= _keys_of((*place, name), field.annotation, field.metadata)
    return schema


def _keys_of(place: Place, annotation: Any, metadata: Sequence[Any]) -> dict[Place, Key]:
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        annotation, *more = typing.get_args(annotation)
        return _keys_of(place, annotation, [*metadata, *more])
    if origin in (typing.Union, types.UnionType):  # in a config, None means that the key is left out
        return _keys_of(place, next(arg for arg in typing.get_args(annotation) if arg is not type(None)), metadata)
    keys = _keys_of_type(place, annotation, metadata)
    words = [mark.words for mark in metadata if isinstance(mark, MustBe)]
    return keys | {place: replace(keys[place], must_be=words[0])} if words else keys


def _keys_of_type(place: Place, annotation: Any, metadata: Sequence[Any]) -> dict[Place, Key]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return schema_of(annotation, place)
    if typing.get_origin(annotation) is Literal:
        choices = typing.get_args(annotation)
        listed = " or ".join(shorten(choice) for choice in choices)
        return {place: Key(listed, choices=choices)}
    if typing.get_origin(annotation) is tuple:
        quantity = [mark for mark in metadata if isinstance(mark, Quantity)]
        items = _keys_of((*place, ITEM), typing.get_args(annotation)[0], quantity)
        item = items[(*place, ITEM)]
        if item.children:
            return {place: Key(f"an array of tables, [[{dotted(place)}]]"), **items}
        plural = item.must_be.replace("a number", "numbers").replace("a finite number", "finite numbers")
        return {place: Key(f"a list of {plural}"), **items}
    if annotation in (int, float):
        return {place: _number_key(annotation, metadata)}
    return {place: Key("text on one line")}


def _number_key(kind: type, metadata: Sequence[Any]) -> Key:
    quantity = next((mark for mark in metadata if isinstance(mark, Quantity)), None)
    bounds: dict[str, float] = {}
    for mark in metadata:
        for bound in getattr(mark, "metadata", [mark]):  # a Field holds its bounds as annotated_types marks
            bounds |= {name: getattr(bound, name) for name in ("gt", "ge", "le") if hasattr(bound, name)}
    key = Key(
        must_be="",
        quantity=quantity,
        whole=kind is int,
        lowest=bounds.get("gt", bounds.get("ge", -math.inf)),
        highest=bounds.get("le", math.inf),
        above="gt" in bounds,
    )
    noun = "a whole number" if key.whole else "a number"
    if "gt" in bounds:
        span = f" greater than {key.lowest:g}"
    elif "le" in bounds:
        span = f" from {key.lowest:g} to {key.highest:.12g}"
    elif "ge" in bounds:
        span = f", {key.lowest:g} or greater"
    else:
        noun, span = "a finite number", ""
    return replace(key, must_be=noun + span + key.suffix)


def key_at(schema: Schema, place: Place) -> Key | None:
    """The key at a place, if there is one."""
    return schema.get(tuple(ITEM if isinstance(step, int) else step for step in place))


# --- Values in a document that may hold anything ---------------------------------------------------------------------


def value_at(document: Any, place: Place) -> Any:
    """What stands at a place; None where nothing does."""
    for step in place:
        if isinstance(step, int):
            items = items_of(document)
            document = items[step] if step < len(items) else None
        else:
            document = document.get(step) if isinstance(document, Mapping) else None
    return document


def items_of(value: Any) -> Sequence[Any]:
    """The items of a list; none of anything else."""
    return value if isinstance(value, list | tuple) else ()


def number(value: Any) -> float | None:
    """A finite number; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def with_value(node: Any, place: Place, value: Any) -> Any:
    """A copy of a document with another value at a place."""
    if not place:
        return value
    step = place[0]
    if isinstance(step, int):
        return (*node[:step], with_value(node[step], place[1:], value), *node[step + 1 :])
    return {**node, step: with_value(node.get(step), place[1:], value)}


# --- Inertias and their names ----------------------------------------------------------------------------------------


class _Reference(NamedTuple):
    place: Place
    value: Any
    ground: bool  # whether it may be "ground"


def references(document: Document) -> Iterator[_Reference]:
    """Every place that names an inertia, and what stands there."""
    for place in _pairs(document):
        for k, value in enumerate(items_of(value_at(document, place))):
            yield _Reference((*place, k), value, ground=True)
    for place in (("load", "on"), ("impacts", "acceleration_of")):
        value = value_at(document, place)
        if value is not None:
            yield _Reference(place, value, ground=False)


def _pairs(document: Document) -> Iterator[Place]:
    for k, shaft in enumerate(items_of(value_at(document, ("driveline", "shafts")))):
        if isinstance(shaft, Mapping):
            yield ("driveline", "shafts", k, "between")
    yield ("lash", "between")


def number_of(document: Document, name: str) -> int | None:
    """The number from 1 of the inertia of this name."""
    names = list(items_of(value_at(document, ("driveline", "names"))))
    return names.index(name) + 1 if name in names else None


def _inertia_rule(document: Document) -> Iterator[Finding]:
    """Shafts, lash, load and severity refer to inertias that exist; whatever lies between two of them has two ends."""
    inertias = value_at(document, ("driveline", "inertias"))
    count = len(items_of(inertias)) if items_of(inertias) else None
    names = [name for name in items_of(value_at(document, ("driveline", "names"))) if isinstance(name, str)]
    for place, value, ground in references(document):
        if ground and value == "ground":
            continue
        allowed = _inertias_allowed(count, names, ground)
        if isinstance(value, str):
            likely = nearest(value, [*names, "ground"] if ground else names)
            hint = f"did you mean {shorten(likely)}? It" if likely else "it"
            yield place, f"no inertia is named {shorten(value)}; {hint} must be {allowed}"
        elif isinstance(value, bool) or not isinstance(value, int):
            yield place, f"found {shorten(value)}; must be {allowed}"
        elif count is not None and not 1 <= value <= count:
            yield place, f"there is no inertia {shorten(value)}; must be {allowed}"
    for place in _pairs(document):
        between = value_at(document, place)
        if between is None:
            continue
        ends = items_of(between)
        if len(ends) != 2:
            yield place, f'found {shorten(between)}; must be two inertias, or one and "ground", for example [1, 2]'
        elif ends[0] == ends[1]:
            yield place, f'both ends are {shorten(ends[0])}; must be two inertias, or one and "ground"'


def _inertias_allowed(count: int | None, names: Sequence[str], ground: bool) -> str:
    choices = ["an inertia's number" if count is None else f"an inertia's number from 1 to {count}"]
    if names:
        choices.append(f"its name ({', '.join(shorten(name) for name in names[:8])}{', …' * (len(names) > 8)})")
    if ground:
        choices.append('"ground"')
    return " or ".join([", ".join(choices[:-1]), choices[-1]] if len(choices) > 1 else choices)


def _names_rule(document: Document) -> Iterator[Finding]:
    """Every inertia has a name of its own, or none has."""
    place: Place = ("driveline", "names")
    names = items_of(value_at(document, place))
    inertias = items_of(value_at(document, ("driveline", "inertias")))
    if value_at(document, place) is not None and inertias and len(names) != len(inertias):
        yield place, f"found {len(names)} names for {len(inertias)} inertias; give each its name, or leave names out"
    for k, name in enumerate(names):
        if not isinstance(name, str):
            continue
        if name == "ground":
            yield (*place, k), 'found "ground"; that name is kept for the ground itself'
        elif not name or name.isdigit() or set(name) & set("[]"):
            yield (*place, k), f"found {shorten(name)}; a name must not be empty, a number, or have brackets in it"
        elif name in names[:k]:
            yield (*place, k), f"the name {shorten(name)} is taken by inertia {list(names).index(name) + 1}"


# --- Load and solver -------------------------------------------------------------------------------------------------


def _lash_rule(document: Document) -> Iterator[Finding]:
    if isinstance(document.get("lash"), list):
        yield ("lash",), "several lashes are not supported yet; write one, [lash] instead of [[lash]]"


def _torque_rule(document: Document) -> Iterator[Finding]:
    """The torque is given once: by what stays and a ratio, or by what it is before and after."""
    load = document.get("load")
    if not isinstance(load, Mapping):
        return
    given = [key for key in (*RATIO_TORQUES, *STEP_TORQUES) if load.get(key) is not None]
    by_ratio, by_step = ([key for key in pair if key in given] for pair in (RATIO_TORQUES, STEP_TORQUES))
    if by_ratio and by_step:
        yield (
            ("load",),
            (
                f"{' and '.join(given)} are given together; give either static_torque and ratio, or initial_torque and "
                "final_torque"
            ),
        )
    elif not given:
        yield ("load",), "no torque is given; give static_torque and ratio, or initial_torque and final_torque (N m)"
    elif len(given) == 1:
        pair = RATIO_TORQUES if by_ratio else STEP_TORQUES
        other = pair[1 - pair.index(given[0])]
        yield ("load", other), f"missing; {given[0]} needs {other} beside it"


def _steps_rule(document: Document) -> Iterator[Finding]:
    """A run is at least one step long and not absurdly many, at every value that an axis gives either."""
    step, end_time = ("solver", "step"), ("solver", "end_time")
    steps, ends = list(_extent(document, step)), list(_extent(document, end_time))
    if not steps or not ends:
        return
    (longest, at_longest), (shortest, at_shortest) = max(steps), min(steps)
    (earliest, at_earliest), (latest, at_latest) = min(ends), max(ends)
    if longest > earliest:
        complaint = f"a step of {longest:g} s is longer than the run, end_time = {earliest:g} s"
        yield _axis_first(at_longest, at_earliest), complaint
    elif latest / shortest > MOST_STEPS:
        complaint = f"a run of {latest:g} s in steps of {shortest:g} s has {latest / shortest:.2g} of them"
        yield _axis_first(at_shortest, at_latest), f"{complaint}; at most {MOST_STEPS:g} are allowed"


def _size_rule(document: Document) -> Iterator[Finding]:
    """Inertias, springs and dampers are of sizes that double precision can multiply, and add to one another."""
    shafts = range(len(items_of(value_at(document, ("driveline", "shafts")))))
    inertias = range(len(items_of(value_at(document, ("driveline", "inertias")))))
    contact: Place = ("lash", "contact")
    masses = [size for k in inertias for size in _extent(document, ("driveline", "inertias", k))]
    springs, dampers = (
        [size for k in shafts for size in _extent(document, ("driveline", "shafts", k, key))]
        for key in ("stiffness", "damping")
    )
    radii = list(_extent(document, ("lash", "radius")))
    at_radius = {key: list(_extent(document, (*contact, key))) for key in ("stiffness", "damping")}
    absurd = [
        (place, f"found {size:g}; must be from {1.0 / LARGEST_SIZE:g} to {LARGEST_SIZE:g}")
        for size, place in [*masses, *springs, *dampers, *radii, *at_radius["stiffness"], *at_radius["damping"]]
        if not 1.0 / LARGEST_SIZE <= size <= LARGEST_SIZE
    ]
    yield from absurd
    if absurd:
        return
    springs += _torsional(at_radius["stiffness"], radii)
    dampers += _torsional(at_radius["damping"], radii)
    for sizes, unit in ((masses, "kg m2"), (springs, "N m/rad")):
        (smallest, at_smallest), (largest, at_largest) = min(sizes, default=(1.0, ())), max(sizes, default=(1.0, ()))
        if largest > WIDEST_SPREAD * smallest:
            yield (
                _axis_first(at_largest, at_smallest),
                f"{largest:g} {unit} here and {smallest:g} {unit} at {dotted(at_smallest)} are more than a factor of "
                f"{WIDEST_SPREAD:g} apart; the smaller one is lost in rounding",
            )
            return
    lightest, at_lightest = min(masses, default=(math.inf, ()))
    for sizes, power, unit in ((springs, 0.5, "N m/rad"), (dampers, 1.0, "N m s/rad")):
        largest, at_largest = max(sizes, default=(0.0, ()))
        rate = (largest / lightest) ** power
        if rate > FASTEST_RATE:
            complaint = (
                f"{largest:g} {unit} on the {lightest:g} kg m2 of {dotted(at_lightest)} is a rate of {rate:.2g} 1/s"
            )
            yield at_largest, f"{complaint}; at most {FASTEST_RATE:g} 1/s is allowed"


def _torsional(sizes: Sequence[tuple[float, Place]], radii: Sequence[tuple[float, Place]]) -> list[tuple[float, Place]]:
    """r² times a stiffness or damping at the radius, at the place of whichever of the two is further from 1."""
    return [
        (radius**2 * size, at if abs(math.log(size)) > abs(2.0 * math.log(radius)) else at_radius)
        for size, at in sizes
        for radius, at_radius in radii
    ]


def _axis_first(*places: Place) -> Place:
    """Whichever of these places lies on an axis, since that is the less obvious one."""
    return next((place for place in places if place[0] == "sweep"), places[0])


def _extent(document: Document, place: Place) -> Iterator[tuple[float, Place]]:
    """A key's own value and those at the ends of an axis over it, each with its place; positive ones only."""
    value = number(value_at(document, place))
    if value is not None and value > 0.0:
        yield value, place
    for k, axis in axes_of(document):
        if axis.get("parameter") == dotted(place):
            for where, end in _axis_ends(axis):
                if end > 0.0:
                    yield end, ("sweep", "axes", k, *where)


# --- Axes ------------------------------------------------------------------------------------------------------------


def axes_of(document: Document) -> Iterator[tuple[int, dict[str, Any]]]:
    """The axes that are tables, each with its position."""
    for k, axis in enumerate(items_of(value_at(document, ("sweep", "axes")))):
        if isinstance(axis, dict):
            yield k, axis


def _axis_ends(axis: Document) -> list[tuple[Place, float]]:
    """The values of an axis that reach furthest, each with its place in the axis."""
    values = [(("values", k), number(value)) for k, value in enumerate(items_of(axis.get("values")))]
    ends: list[tuple[Place, float]] = [(place, value) for place, value in values if value is not None]
    if ends:
        return [min(ends, key=lambda end: end[1]), max(ends, key=lambda end: end[1])]
    found = [((key,), number(axis.get(key))) for key in ("start", "stop")]
    return [(place, value) for place, value in found if value is not None]


def first_value(axis: Document) -> float | None:
    """The first value of an axis, if it has one."""
    values = items_of(axis.get("values"))
    return number(values[0] if values else axis.get("start"))


def place_of(parameter: str, document: Document) -> Place | None:
    """The place that a parameter names, an inertia's name in brackets resolved; None where it is malformed."""
    place = parse_place(parameter)
    if place is None:
        return None
    steps: list[str | int] = []
    for step in place:
        if isinstance(step, str) and step.startswith("["):
            item = number_of(document, step[1:-1]) if steps == ["driveline", "inertias"] else None
            if item is None:
                return None
            steps.append(item - 1)
        else:
            steps.append(step)
    return tuple(steps)


def parameters(schema: Schema, document: Document) -> list[str]:
    """The keys of this document that may be swept."""
    found: list[str] = []
    for pattern, key in schema.items():
        if key.quantity is None:
            continue
        if ITEM not in pattern:
            found.append(dotted(pattern))
            continue
        at = pattern.index(ITEM)
        count = len(items_of(value_at(document, pattern[:at])))
        found += [dotted((*pattern[:at], k, *pattern[at + 1 :])) for k in range(count)]
    return found


def parameter_complaint(parameter: str, schema: Schema, document: Document) -> str | None:
    """Why a parameter cannot be swept in this document; None where it can."""
    place = place_of(parameter, document)
    key = None if place is None else key_at(schema, place)
    if place is not None and key is not None and key.quantity is not None:
        for k, step in enumerate(place):
            count = len(items_of(value_at(document, place[:k])))
            if isinstance(step, int) and step >= count:
                return f"there is no {parameter}; {dotted(place[:k])} has {count} items" if count else None
        return None
    known = parameters(schema, document)
    leaf = parameter.rsplit(".", 1)[-1]
    same_leaf = [name for name in known if name.rsplit(".", 1)[-1] == leaf or name.startswith(f"{parameter}[")]
    likely = same_leaf[0] if same_leaf else nearest(parameter, known)
    hint = f"; did you mean {shorten(likely)}?" if likely else "; a key such as load.ratio or driveline.inertias[4] can"
    if key is not None:
        return f"{shorten(parameter)} is no quantity that can be swept{hint}"
    return (
        f"the config has no key {shorten(parameter)}{hint}"
        if likely
        else (f"the config has no key {shorten(parameter)} that can be swept{hint}")
    )


def sweep_findings(document: Document, schema: Schema) -> Iterator[Finding]:
    """Every swept or drawn key is a numeric one, in one place only, and gets values that it allows."""
    sweep = document.get("sweep")
    if not isinstance(sweep, Mapping):
        return
    if not any(sweep.get(key) for key in ("axes", "samples", "tolerances")) and "axes" not in sweep:
        yield ("sweep", "axes"), "missing; must be an array of tables, [[sweep.axes]], or else [[sweep.samples]]"
    taken: dict[str, Place] = {}
    together = sweep.get("design") == "zip"
    counts: list[tuple[int, int]] = []
    for k, axis in axes_of(document):
        at: Place = ("sweep", "axes", k)
        parameter = axis.get("parameter")
        if isinstance(parameter, str):
            complaint = parameter_complaint(parameter, schema, document) or _wrong_torque(parameter, document)
            if complaint is None and parameter in taken:
                complaint = f"{parameter} is swept by {dotted(taken[parameter])} already"
            if complaint is not None:
                yield (*at, "parameter"), complaint
            else:
                taken[parameter] = at
                yield from _axis_range(axis, at, parameter, schema, document)
        yield from _axis_form(axis, at, repeats=together)
        count = axis.get("count") if axis.get("values") is None else len(items_of(axis.get("values")))
        if isinstance(count, int) and 1 <= count <= LONGEST_AXIS:
            counts.append((k, count))
    if together:
        yield from _zip_findings(counts)
    yield from _draws_findings(document, schema, taken)
    cells = math.prod(count for _, count in counts[:1] if together) if together else math.prod(n for _, n in counts)
    drawn = number(value_at(document, ("sweep", "sampling", "count")))
    if sweep.get("samples") and drawn is not None and drawn >= 1.0:
        cells *= int(drawn)
    if cells > LARGEST_GRID:
        yield ("sweep", "axes"), f"the grid has {cells:,} cells; at most {LARGEST_GRID:,} are allowed"


def _zip_findings(counts: Sequence[tuple[int, int]]) -> Iterator[Finding]:
    """Axes that are walked together are equally long."""
    if not counts:
        return
    first, length = counts[0]
    for k, count in counts[1:]:
        if count != length:
            yield (
                ("sweep", "axes", k),
                f"found {count} values, and sweep.axes[{first + 1}] has {length}; the axes of a zip design are walked "
                "together and must be equally long",
            )


# --- Drawn keys ------------------------------------------------------------------------------------------------------


def draws_of(document: Document) -> Iterator[tuple[Place, dict[str, Any]]]:
    """The samples and tolerances that are tables, each with its place."""
    for table in ("samples", "tolerances"):
        for k, draw in enumerate(items_of(value_at(document, ("sweep", table)))):
            if isinstance(draw, dict):
                yield ("sweep", table, k), draw


def _draws_findings(document: Document, schema: Schema, swept: Mapping[str, Place]) -> Iterator[Finding]:
    """Drawn keys are numeric ones, drawn once, by a distribution that has its numbers."""
    drawn: dict[str, Place] = {}
    for at, draw in draws_of(document):
        parameter = draw.get("parameter")
        if isinstance(parameter, str):
            complaint = parameter_complaint(parameter, schema, document) or _wrong_torque(parameter, document)
            complaint = complaint or _undrawable(at, draw, parameter, swept, schema, document)
            if complaint is None and parameter in drawn:
                complaint = f"{parameter} is drawn by {dotted(drawn[parameter])} already"
            elif complaint is None and at[1] == "samples" and parameter in swept:
                complaint = f"{parameter} is swept by {dotted(swept[parameter])} already"
            if complaint is not None:
                yield (*at, "parameter"), complaint
            else:
                drawn[parameter] = at
        yield from _distribution_findings(draw, at)
    samples, tolerances = (items_of(value_at(document, ("sweep", table))) for table in ("samples", "tolerances"))
    if samples and tolerances:
        yield ("sweep", "samples"), "samples and tolerances are given together; give one of the two"
    if samples and value_at(document, ("sweep", "design")) == "zip":
        yield ("sweep", "samples"), 'samples do not go with design = "zip"; give one of the two'


def _undrawable(
    at: Place, draw: Document, parameter: str, swept: Mapping[str, Place], schema: Schema, document: Document
) -> str | None:
    place = place_of(parameter, document)
    key = None if place is None else key_at(schema, place)
    if key is not None and key.whole:
        return f"{parameter} is an inertia's number, which cannot be drawn"
    if at[1] == "tolerances" and parameter in swept and draw.get("draws", "value") == "value":
        return f'{parameter} is swept: its tolerance must be around the swept value; set draws = "factor" or "offset"'
    if place is not None and parameter not in swept and value_at(document, place) is None and _needs_nominal(draw):
        return f"{parameter} has no value in this config that its distribution could be around"
    return None


def _needs_nominal(draw: Document) -> bool:
    middle = {"normal": "mean", "lognormal": "median"}.get(str(draw.get("distribution")))
    return draw.get("draws", "value") != "value" or (middle is not None and draw.get(middle) is None)


def _distribution_findings(draw: Document, at: Place) -> Iterator[Finding]:
    """A distribution has the numbers that it needs, no others, and in their order."""
    kind = draw.get("distribution")
    needs = NEEDS.get(kind) if isinstance(kind, str) else None
    if needs is None:
        return
    optional = {"normal": ("mean", *BOUNDS), "lognormal": ("median", *BOUNDS)}.get(str(kind), ())
    allowed = {*needs, *optional}
    for name in NUMBERS:
        if draw.get(name) is not None and name not in allowed:
            yield (*at, name), f"a {kind} distribution has no {name}; it is given by {_listing(needs)}"
    missing = [name for name in needs if draw.get(name) is None and name not in optional]
    misspelt = set(draw) - {"parameter", "distribution", "draws", *NUMBERS}
    if missing and not misspelt:  # a misspelt number has an error of its own
        yield at, f"missing {_listing(missing)}; a {kind} distribution is given by {_listing(needs)}"
    found = {name: value for name in ("low", "mode", "high") if (value := number(draw.get(name))) is not None}
    low, high = found.get("low"), found.get("high")
    if low is not None and high is not None and not low < high:
        yield (*at, "high"), f"found {high:g}; must be greater than low = {low:g}"
    elif "mode" in found and not found.get("low", -math.inf) <= found["mode"] <= found.get("high", math.inf):
        yield (*at, "mode"), f"found {found['mode']:g}; must be from low to high"
    elif kind == "lognormal" and high is not None and high <= 0.0:
        yield (*at, "high"), f"found {high:g}; a lognormal number is greater than 0"


def _listing(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else "".join(names)


def _wrong_torque(parameter: str, document: Document) -> str | None:
    pairs = {f"load.{key}": pair for pair in (RATIO_TORQUES, STEP_TORQUES) for key in pair}
    pair = pairs.get(parameter)
    if pair is None:
        return None
    other = STEP_TORQUES if pair is RATIO_TORQUES else RATIO_TORQUES
    load = document.get("load")
    if not isinstance(load, Mapping) or all(load.get(key) is None for key in other):
        return None
    if any(load.get(key) is not None for key in pair):  # both pairs are given, which is an error of its own
        return None
    return (
        f"{parameter} does not apply: the load is given by {' and '.join(other)}; give load.{pair[0]} and "
        f"load.{pair[1]} instead, or sweep one of the former"
    )


def _axis_form(axis: Document, at: Place, *, repeats: bool) -> Iterator[Finding]:
    """Either start, stop and count, or values; a value occurs once unless `repeats`."""
    start, stop, count = (number(axis.get(key)) for key in ("start", "stop", "count"))
    spans = [key for key in ("start", "stop", "count", "scale") if axis.get(key) is not None]
    if axis.get("values") is not None:
        if spans:
            yield at, f"values and {', '.join(spans)} are given together; give either values, or start, stop and count"
        seen: set[float] = set()
        for k, value in enumerate(items_of(axis["values"])):
            if number(value) is not None:
                if float(value) in seen and not repeats:
                    yield (*at, "values", k), f"the value {shorten(value)} occurs twice"
                seen.add(float(value))
        return
    missing = [key for key in ("start", "stop", "count") if axis.get(key) is None]
    if count == 1.0 and "stop" in missing:
        missing.remove("stop")
    if missing:
        given = f"missing {' and '.join(missing)}" if spans else "no values are given"
        yield at, f"{given}; give start, stop and count, or values"
        return
    if axis.get("scale") == "log":
        for key, end in (("start", start), ("stop", stop)):
            if end is not None and end <= 0.0:
                yield (*at, key), f'found {shorten(axis[key])}; must be greater than 0 on an axis of scale "log"'
    if start is None or stop is None or count is None:
        return
    if count == 1.0 and start != stop:
        yield (*at, "count"), f"one value cannot span {start:g} to {stop:g}; count must be 2 or greater"
    elif count > 1.0 and start == stop:
        yield at, f"start and stop are both {start:g}; give count = 1, or a stop other than the start"
    elif not math.isfinite((stop - start) * count) or (axis.get("scale") == "log" and _overflows(start, stop)):
        yield at, f"the span from {start:g} to {stop:g} is beyond the range of numbers"


def _overflows(start: float, stop: float) -> bool:
    return start > 0.0 and stop / start == math.inf


def _axis_range(axis: Document, at: Place, parameter: str, schema: Schema, document: Document) -> Iterator[Finding]:
    """The values lie in the swept key's own range."""
    place = place_of(parameter, document)
    key = None if place is None else key_at(schema, place)
    if key is None:
        return
    for where, end in _axis_ends(axis):
        if not key.allows(end):
            yield (*at, *where), f"found {shorten(end)}; {parameter} must be {key.must_be}"
    if not key.whole:
        return
    inertias = len(items_of(value_at(document, ("driveline", "inertias"))))
    for where, end in _axis_ends(axis):
        if inertias and end > inertias:
            yield (*at, *where), f"found {end:g}; {parameter} is an inertia's number, and there are {inertias}"
    values = [number(value) for value in items_of(axis.get("values"))]
    start, stop, count = (number(axis.get(name)) for name in ("start", "stop", "count"))
    if start is not None and stop is not None and count is not None and count > 1 and not values:
        values = [start, stop, (stop - start) / (count - 1)]
    if any(value is not None and not value.is_integer() for value in values) or axis.get("scale") == "log":
        yield at, f"{parameter} must be {key.must_be} at every value of the axis"


def findings(document: Document) -> Iterator[Finding]:
    """Where keys contradict each other, or name what is not there; axes aside."""
    for rule in (_lash_rule, _names_rule, _inertia_rule, _torque_rule, _steps_rule, _size_rule):
        yield from rule(document)
