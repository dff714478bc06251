"""Keys of a config, as the models describe them: JSON Schema of a file, and each key's bounds, words and unit.

Tables are validated by their models, with every error as a sentence at its place.
"""

import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from clunk.study.document import Document, Place, dotted, value_at
from clunk.study.errors import listing, nearest, shorten
from clunk.study.models import Config
from clunk.study.tables import ONE, SEVERAL, Finding, Quantity

PRESETS = ("boere-2008", "boere-2008-as-printed", "car")
ITEM = "#"  # stands in a pattern for any position in a list

# Required keys of tables in the JSON Schema of a file, which may leave out what a preset or an axis gives.
_REQUIRED: dict[str, list[str]] = {"Config": ["driveline"], "Shaft": ["between"]}
_REQUIRED |= {table: [] for table in ("DrivelineConfig", "Lash", "Contact", "Load", "Impacts")}


class Key(NamedTuple):
    """The values that one place of a config allows.

    must_be : allowed values in words, to follow "must be"
    children : the keys of a table; else empty
    choices : the words that are allowed; empty where words are not restricted
    quantity : name, symbol and unit of a number that can be swept; else None
    whole : whether only integers are allowed
    lowest, highest : bounds of a number, which it may reach unless `above` says otherwise
    above : whether the lowest bound itself is excluded
    not_zero : whether zero is excluded
    is_optional : whether the key has a default value
    """

    must_be: str
    children: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()
    quantity: Quantity | None = None
    whole: bool = False
    lowest: float = -math.inf
    highest: float = math.inf
    above: bool = False
    not_zero: bool = False
    is_optional: bool = False

    def allows(self, value: float) -> bool:
        """Whether a number is finite and lies within the bounds."""
        above = self.lowest < value if self.above else self.lowest <= value
        return above and value <= self.highest and math.isfinite(value) and not (self.not_zero and value == 0.0)


@functools.cache
def json_schema() -> Document:
    """JSON Schema of config files; not to be changed in place."""
    schema = Config.model_json_schema()
    for name, table in [("Config", schema), *schema["$defs"].items()]:
        table["required"] = _REQUIRED.get(name, table.get("required", []))
    schema["$defs"]["Load"]["properties"]["profile"]["enum"].append("tip-out")  # which becomes "step"
    driveline = schema["$defs"]["DrivelineConfig"]
    preset = {"enum": list(PRESETS), "description": "fills in the keys that the file leaves out"}
    driveline["properties"] = {"preset": preset, **driveline["properties"]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "Config of clunk"}


@functools.cache
def keys() -> dict[Place, Key]:
    """Keys of a config by their pattern: a place with `ITEM` for positions in lists."""
    return dict(_keys((), json_schema()))


def key_at(place: Place) -> Key | None:
    """The key at a place, if there is one."""
    return keys().get(_pattern_of(place))


def _pattern_of(place: Place) -> Place:
    return tuple(ITEM if isinstance(step, int) else step for step in place)


def _keys(place: Place, node: Mapping[str, Any]) -> Iterator[tuple[Place, Key]]:
    node = _resolved(node)
    if "oneOf" in node:  # one number or table, or several
        one, several = map(_resolved, node["oneOf"])
        if "properties" in one:
            table, *inner = _keys(place, one)
            yield place, table[1]._replace(must_be=f"a table, or an array of tables, [[{dotted(place)}]]")
            yield from inner
            yield from ((at, _of_item(key, dotted(place))) for at, key in _keys((*place, ITEM), several["items"]))
            return
        leaf = _leaf({**one, **node})
        yield place, leaf._replace(must_be=f"{leaf.must_be}, or a list of such numbers")
        yield (*place, ITEM), _leaf(_resolved(several["items"]))
        return
    if "properties" in node:
        yield place, Key("a table", children=tuple(node["properties"]))
        for name, child in node["properties"].items():
            yield from _keys((*place, name), child)
    elif node.get("type") == "array":
        items = dict(_keys((*place, ITEM), node["items"]))
        item = items[(*place, ITEM)]
        plural = item.must_be.replace("a number", "numbers").replace("a finite number", "finite numbers")
        must_be = f"an array of tables, [[{dotted(place)}]]" if item.children else f"a list of {plural}"
        yield place, Key(node.get("description", must_be))
        yield from items.items()
    else:
        yield place, _leaf(node)


def _of_item(key: Key, table: str) -> Key:
    """Key of a table in an array of tables: in its quantity's name and symbol ``{}`` stands for the table's number."""
    if key.quantity is None:
        return key
    name, symbol, unit = key.quantity.name.removesuffix(f" at the {table}"), key.quantity.symbol, key.quantity.unit
    return key._replace(quantity=Quantity(f"{name} of {table} {{}}", f"{symbol}{{}}", unit))


def _resolved(node: Mapping[str, Any]) -> Mapping[str, Any]:
    """Node of the schema with references resolved, and without null, since a config leaves out a key without value."""
    inner = [each for each in node.get("anyOf", node.get("allOf", ())) if each.get("type") != "null"]
    if "$ref" in node:
        inner = [json_schema()["$defs"][node["$ref"].rsplit("/", 1)[-1]]]
    return {**_resolved(inner[0]), **node} if len(inner) == 1 else node


def _leaf(node: Mapping[str, Any]) -> Key:
    choices = tuple(node.get("enum", [node["const"]] if "const" in node else ()))
    if choices:
        return Key(listing([shorten(choice) for choice in choices], "or"), choices=choices)
    if node["type"] == "string":
        return Key(node.get("description", "text on one line"))
    if node["type"] == "boolean":
        return Key("true or false")
    above = "exclusiveMinimum" in node
    lowest = node.get("exclusiveMinimum", node.get("minimum", -math.inf))
    highest = node.get("maximum", math.inf)
    whole = "integer" in node["type"]
    noun = "a whole number" if whole else "a number"
    not_zero = node.get("not") == {"const": 0}
    if not_zero:
        must_be = "a finite number other than 0"
    elif above:
        must_be = f"{noun} greater than {lowest:g}"
    elif highest < math.inf:
        must_be = f"{noun} from {lowest:g} to {highest:.12g}"
    else:
        must_be = f"{noun}, {lowest:g} or greater" if lowest > -math.inf else "a finite number"
    quantity = Quantity(node["quantity"], node["symbol"], node["unit"]) if "quantity" in node else None
    unit = f" ({node['unit']})" if node.get("unit", "1") != "1" else ""
    must_be = node.get("description", must_be + unit)
    return Key(
        must_be,
        quantity=quantity,
        whole=whole,
        lowest=lowest,
        highest=highest,
        above=above,
        not_zero=not_zero,
        is_optional=node.get("default") is not None,
    )


# --- Validation of tables --------------------------------------------------------------------------------------------


Model = TypeVar("Model", bound=BaseModel)


def validated(model: type[Model], table: Any, at: Place = ()) -> tuple[Model | None, list[Finding]]:
    """Validate a table of a config, or a whole config: return its model, or None, and the findings.

    table : with tuples for lists, see `with_tuples`; where it has a table `driveline`, that is the context in which
        numbers and names of inertias and shafts are validated
    at : the place of the table in a config; places of findings begin with it
    """
    try:
        return model.model_validate(table, context=value_at(table, ("driveline",))), []
    except ValidationError as error:
        errors = [((*at, *_place(detail["loc"])), detail) for detail in error.errors(include_url=False)]
    unknown = {place: _likely_key(place) for place, detail in errors if detail["type"] == "extra_forbidden"}
    findings = []
    for place, detail in errors:
        # one mistake, one error: a misspelt key is not missing too, nor a list of wrong items too short
        inner = [other for other, _ in errors if len(other) > len(place) and other[: len(place)] == place]
        is_list_of_wrong = detail["type"] == "too_short" and inner
        if detail["type"] == "clunk":
            findings += [((*place, *below), message) for below, message in detail["ctx"]["findings"]]
        elif place in unknown:
            findings.append((place, _unknown_key(place, unknown[place])))
        elif place not in unknown.values() and not is_list_of_wrong:
            findings.append((place, wrong_value(place, detail["input"], is_missing=detail["type"] == "missing")))
    return None, sorted(findings, key=lambda finding: finding[0] not in unknown)


def with_tuples(node: Any) -> Any:
    """A table with tuples in place of lists, which strict models do not accept for tuples."""
    if isinstance(node, dict):
        return {key: with_tuples(value) for key, value in node.items()}
    if not isinstance(node, list | tuple):
        return node
    # for long lists of numbers, checking all types at once takes a tenth of the time of converting each item
    return tuple(node if {dict, list, tuple}.isdisjoint(map(type, node)) else map(with_tuples, node))


def _place(location: Place) -> Place:
    """Place of an error: pydantic's location without the tags of a key's variants."""
    return tuple(step for step in location if step not in (ONE, SEVERAL))


def _likely_key(place: Place) -> Place | None:
    """The key that an unknown one probably means: a similar one in its table, or a very similar one elsewhere."""
    name, table = str(place[-1]), _pattern_of(place[:-1])
    if beside := nearest(name, keys()[table].children):
        return (*place[:-1], beside)
    # keys below this table come first, and so are preferred where several tables have the name
    elsewhere = sorted((known for known in keys() if known), key=lambda known: known[: len(table)] != table)
    likely = nearest(name, {str(known[-1]) for known in elsewhere}, cutoff=0.77)
    return next((known for known in elsewhere if known[-1] == likely), None)


def _unknown_key(place: Place, likely: Place | None) -> str:
    if likely is None:
        return f"unknown key; allowed here: {', '.join(keys()[_pattern_of(place[:-1])].children)}"
    if likely[:-1] == place[:-1]:
        return f"unknown key; did you mean {shorten(likely[-1])}?"
    table = dotted(tuple(step for step in likely[:-1] if step != ITEM))
    where = (f"in [[{table}]]" if ITEM in likely else f"in [{table}]") if table else "above the first table"
    return f"unknown key; did you mean {shorten(likely[-1])} {where}?"


def wrong_value(place: Place, value: Any, *, is_missing: bool = False) -> str:
    """Sentence on a value that the key at a place does not allow, or on a missing value."""
    if is_missing and place == ("driveline",):
        return f"missing; give driveline.preset ({' or '.join(PRESETS)}), or inertias, and the shafts that join them"
    key = keys()[_pattern_of(place)]
    likely = nearest(value, key.choices)
    hint = f"; did you mean {shorten(likely)}?" if likely else ""
    return f"{'missing' if is_missing else f'found {shorten(value)}'}; must be {key.must_be}{hint}"
