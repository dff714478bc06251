"""Validation of tables by their models, with every error as a sentence at its place."""

from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from clunk.study.document import Place, dotted
from clunk.study.keys import ITEM, PRESETS, key_at, keys
from clunk.study.problems import listing, nearest, shorten
from clunk.study.tables import ONE, SEVERAL, Finding

Model = TypeVar("Model", bound=BaseModel)


def validated(model: type[Model], table: Any, driveline: Any = None) -> tuple[Model | None, list[Finding]]:
    """Validate the tables of a config: their model, or what is wrong with them.

    table : with tuples for lists, see `with_tuples`
    driveline : the table of the inertias and their names, by which other tables may refer to them
    """
    try:
        return model.model_validate(table, context=driveline), []
    except ValidationError as error:
        errors = [(*_place(detail["loc"]), detail) for detail in error.errors(include_url=False)]
    unknown = {place: _likely_key(place) for place, _, detail in errors if detail["type"] == "extra_forbidden"}
    findings: list[Finding] = []
    for place, variant, detail in errors:
        # one mistake, one error: a misspelt key is not missing too, nor a list of wrong items too short
        inner = [other for other, _, _ in errors if len(other) > len(place) and other[: len(place)] == place]
        is_list_of_wrong = detail["type"] == "too_short" and bool(inner)
        if detail["type"] == "clunk":
            findings += [((*place, *below), message) for below, message in detail["ctx"]["findings"]]
        elif place in unknown:
            findings.append((place, _unknown_key(place, variant, unknown[place])))
        elif place not in unknown.values() and not is_list_of_wrong:
            findings.append(_wrong_value(place, variant, detail))
    return None, sorted(findings, key=lambda finding: finding[0] not in unknown)


def with_tuples(node: Any) -> Any:
    """A table with lists as tuples: strict models take no lists for tuples."""
    if isinstance(node, dict):
        return {key: with_tuples(value) for key, value in node.items()}
    if isinstance(node, list | tuple) and any(isinstance(item, dict | list | tuple) for item in node):
        return tuple(with_tuples(item) for item in node)
    return tuple(node) if isinstance(node, list) else node


def _place(location: Place) -> tuple[Place, str]:
    """Place of an error, and the word of the variant of the table around it, which pydantic has among the keys."""
    place: Place = ()
    variant = ""
    for step in location:
        if step in (ONE, SEVERAL):
            continue
        key = key_at(place)
        if key is not None and step in key.variants and not variant:
            variant = str(step)
        else:
            place = (*place, step)
    return place, variant


def _likely_key(place: Place) -> Place | None:
    """The key that an unknown one was meant to be: a neighbour, or one that is more like it elsewhere."""
    name, around = str(place[-1]), key_at(place[:-1])
    if beside := nearest(name, around.children if around is not None else ()):
        return (*place[:-1], beside)
    table = tuple(ITEM if isinstance(step, int) else step for step in place[:-1])
    # first those below this table
    elsewhere = sorted((known for known in keys() if known), key=lambda known: known[: len(table)] != table)
    likely = nearest(name, {str(known[-1]) for known in elsewhere}, cutoff=0.77)
    return next((known for known in elsewhere if known[-1] == likely), None)


def _unknown_key(place: Place, variant: str, likely: Place | None) -> str:
    around = key_at(place[:-1])
    if variant and around is not None and place[-1] in around.children:
        return f"a {variant} {around.word} has no {place[-1]}; {_keys_of(place, variant)}"
    if likely is None:
        return f"unknown key; allowed here: {', '.join(around.children) if around is not None else 'none'}"
    if likely[:-1] == place[:-1]:
        return f"unknown key; did you mean {shorten(likely[-1])}?"
    table = dotted(tuple(step for step in likely[:-1] if step != ITEM))
    return f"unknown key; did you mean {shorten(likely[-1])} in {f'[[{table}]]' if ITEM in likely else f'[{table}]'}?"


def _keys_of(place: Place, variant: str) -> str:
    """Sentence on the keys that a variant of the table around a place has for itself."""
    around = key_at(place[:-1])
    assert around is not None
    # those of the base class come first in every variant
    shared = [len(set(keys)) == 1 for keys in zip(*around.variants.values(), strict=False)].index(False)
    return f"a {variant} {around.word} is given by {listing(around.variants[variant][shared:])}"


def _wrong_value(place: Place, variant: str, detail: ErrorDetails) -> Finding:
    key, value = key_at(place), detail["input"]
    if key is not None and detail["type"] in {"union_tag_invalid", "union_tag_not_found"}:
        value = value.get(key.word)
        place = (*place, key.word)
        key = key_at(place)
    must_be = key.must_be if key is not None else detail["msg"].lower()
    if detail["type"] in {"missing", "union_tag_not_found"}:
        if place == ("driveline",):
            return place, f"missing; give driveline.preset ({' or '.join(PRESETS)}), or inertias and shafts"
        if key is not None and key.children:
            return place, f"missing; a config needs the table [{dotted(place)}]"
        return place, f"missing; {_keys_of(place, variant)}" if variant else f"missing; must be {must_be}"
    if detail["type"] == "finite_number":
        must_be = must_be.replace("a number", "a finite number")
    likely = nearest(value, key.choices) if key is not None and isinstance(value, str) else None
    hint = f"; did you mean {shorten(likely)}?" if likely else ""
    return place, f"found {shorten(value)}; must be {must_be}{hint}"
