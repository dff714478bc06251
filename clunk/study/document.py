"""A config as plain tables, lists and values: TOML and `key=value` overrides read, and the lines on which keys stand.

A place in a config is a tuple of keys and of list positions from 0, ``("driveline", "shafts", 2, "damping")``; people
read and write it with items from 1, ``driveline.shafts[3].damping``.
"""

import contextlib
import functools
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from clunk.study.errors import ConfigError, Problem, nearest, shorten

Place = tuple[str | int, ...]
FilePath = str | PathLike[str]
Document = dict[str, Any]  # tables of a config, as TOML has them

_LARGEST_FILE = 64 * 2**20  # bytes; a device or a results file must not fill the memory before it is refused
_DEEPEST = 32  # levels; a config has four, and walking one must not exhaust the stack
_SEGMENT = re.compile(r"([A-Za-z0-9_-]+)((?:\[[^\[\]]+\])*)")
_ITEM_NUMBER = re.compile(r"[0-9]{1,9}")
_PLAIN_WORD = re.compile(r"(?:[^\W\d]|[./~])(?:[\w./~-]|\[\d+\])*")  # or a path, or a key
_WORDS_OF_TOML = {"true", "false", "inf", "nan"}


# --- Text -> tables --------------------------------------------------------------------------------------------------


def read_text(path: FilePath, noun: str = "a config", form: str = "a TOML file", known: str | None = None) -> str:
    """Read a text file in UTF-8; raise ConfigError where there is no such file, or it is no text.

    noun, form : what is to be read, for the error's text
    known : end of the sentence on a file that does not exist; by default it names the nearest config
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
    except FileNotFoundError:
        known = nearest_file(Path(path), ".toml", "configs") or "." if known is None else known
        raise _refusal(f"{path} does not exist{known}") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise _refusal(f"{path} cannot be read: {reason}; {noun} is {form}.") from None
    if len(data) > _LARGEST_FILE:
        raise _refusal(f"{path} is larger than {_LARGEST_FILE // 2**20} MiB; that is not {noun}.")
    try:
        return data.decode("utf-8-sig")  # some editors write a byte order mark
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        text = f"{path} is not UTF-8 text: byte 0x{data[error.start]:02x} on line {line}; {noun} is {form}."
        raise _refusal(text, line) from None


def parse_toml(text: str, source: str) -> Document:
    """Parse TOML into tables; raise ConfigError where it is none."""
    try:
        document = tomllib.loads(text)
    except RecursionError:
        document = None
    except ValueError as error:  # also where Python refuses to read an integer of more than 4300 digits
        why = str(error) if isinstance(error, tomllib.TOMLDecodeError) else "it has an integer of thousands of digits"
        line = re.search(r"at line (\d+)", why)
        raise _refusal(f"{source} is not valid TOML: {why}.", int(line[1]) if line else None) from None
    if document is None or _is_too_deep(document):
        raise _refusal(f"{source} is nested too deeply for a config.")
    return document


def parse_override(text: str) -> tuple[Place, Any]:
    """Place and value of `key=value`; the value is TOML, or a plain word or path without its quotes.

    Raises
    ------
    ValueError
        With a sentence on what is malformed.
    """
    key, value = assigned(text)
    place = parse_place(key)
    if value is None or place is None:
        raise ValueError(
            "must be KEY=VALUE with a dotted key, list items by number from 1, for example driveline.inertias[4]=0.003"
        )
    if _PLAIN_WORD.fullmatch(value) and value not in _WORDS_OF_TOML:
        return place, value
    try:
        parsed = tomllib.loads(f"value = {value}".encode().decode())  # bytes that are no text were escaped
    except (ValueError, RecursionError):
        parsed = {}
    if parsed.keys() != {"value"} or _is_too_deep(parsed):
        raise ValueError(f"{shorten(value)} is no TOML value; text needs double quotes inside the shell's own")
    return place, parsed["value"]


def _refusal(sentence: str, line: int | None = None) -> ConfigError:
    return ConfigError(sentence, [Problem("", line, sentence)])


def nearest_file(path: Path, suffix: str, usual: str) -> str:
    """Question after a file of a similar name, beside one that does not exist or in the usual folder; or nothing."""
    if path.exists():
        return ""
    for folder in (path.parent, path.parent / usual):
        with contextlib.suppress(OSError):
            name = nearest(path.name, [entry.name for entry in folder.iterdir() if entry.suffix == suffix])
            if name:
                return f"; did you mean {folder / name}?"
    return ""


def _is_too_deep(node: object, room: int = _DEEPEST) -> bool:
    children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return room < 0 or any(_is_too_deep(child, room - 1) for child in children)


def assigned(text: str) -> tuple[str, str | None]:
    """Key and value of `key=value`; the value is None where there is none."""
    match = re.fullmatch(r"((?:[^=\[]|\[[^\]]*\])*)=(.*)", text, re.DOTALL)  # brackets of a key hold a name
    return (match[1].strip(), match[2].strip()) if match else (text.strip(), None)


# --- Places ----------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=1024)
def parse_place(key: str) -> Place | None:
    """Place that a dotted key names, items by number from 1; None where it is malformed.

    An item may have a name instead, ``driveline.inertias[ring]``; it comes back as ``"[ring]"``.
    """
    place = []
    for part in re.split(r"\.(?![^\[\]]*\])", key):  # brackets hold a name
        match = _SEGMENT.fullmatch(part)
        if match is None:
            return None
        place.append(match[1])
        for item in re.findall(r"\[([^\[\]]+)\]", match[2]):
            is_number = _ITEM_NUMBER.fullmatch(item)
            if is_number and int(item) == 0:
                return None
            place.append(int(item) - 1 if is_number else f"[{item}]")
    return tuple(place)


def dotted(place: Place) -> str:
    """The key of a place as people write it."""
    text = ""
    for step in place:
        if isinstance(step, int):
            text += f"[{step + 1}]"
        elif step.startswith("["):
            text += step
        else:
            bare = step if re.fullmatch(r"[A-Za-z0-9_-]+", step) else shorten(step)
            text += f".{bare}" if text else bare
    return text


def items_of(value: Any) -> Sequence[Any]:
    """The items of a list; none of anything else."""
    return value if isinstance(value, list | tuple) else ()


def value_at(document: Any, place: Place) -> Any:
    """The value at a place of a document that may hold anything, or of a config's model; None where there is none."""
    for step in place:
        if isinstance(step, int):
            items = items_of(document)
            document = items[step] if step < len(items) else None
        elif isinstance(document, BaseModel):
            document = getattr(document, step, None)
        else:
            document = document.get(step) if isinstance(document, Mapping) else None
    return document


def leaves(node: Any, place: Place = (), *, whole_lists: bool = False) -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of everything in a document; an empty table or list is a value.

    whole_lists : whether a list of plain values is a value, instead of its items
    """
    is_whole = whole_lists and not any(isinstance(item, Mapping) for item in items_of(node))
    steps = [*node.items()] if isinstance(node, Mapping) else [] if is_whole else [*enumerate(items_of(node))]
    for step, value in steps:
        yield from leaves(value, (*place, step), whole_lists=whole_lists)
    if not steps:
        yield dotted(place), node


def with_value(node: Any, place: Place, value: Any) -> Any:
    """A copy of a document with another value at a place; items of lists must be there."""
    if not place:
        return value
    step = place[0]
    if isinstance(step, int):
        return (*node[:step], with_value(node[step], place[1:], value), *node[step + 1 :])
    return {**node, step: with_value(node.get(step), place[1:], value)}


def assign(document: Document, place: Place, value: Any) -> bool:
    """Put a value at a place of a document, with the tables around it; returns whether there is such a place."""
    node: Any = document
    for k, step in enumerate(place):
        if isinstance(step, str) != isinstance(node, dict) or (isinstance(step, int) and step >= len(items_of(node))):
            return False
        if k == len(place) - 1:
            node[step] = value
        elif isinstance(step, str):
            node = node.setdefault(step, {})
        else:
            node = node[step]
    return True


# --- Lines -----------------------------------------------------------------------------------------------------------


_HEADER = re.compile(r"\s*(\[\[?)([^\[\]]+)\]\]?\s*(#.*)?$")
_ASSIGNMENT = re.compile(r"\s*([^=#\[{]+)=")
_KEY = re.compile(r"[\w-]+|\"[^\"]*\"|'[^']*'")


def key_lines(text: str) -> dict[Place, int]:
    """The lines, from 1, of a TOML text's table headers and of the keys that begin a line; tomllib tells none."""
    lines: dict[Place, int] = {}
    last_items: dict[Place, int] = {}  # of the arrays of tables so far
    table: Place = ()
    for number, line in enumerate(text.split("\n"), 1):
        header, assignment = _HEADER.match(line), _ASSIGNMENT.match(line)
        text_of_keys = header[2] if header else assignment[1] if assignment else ""
        keys = [key.strip("'\"") for key in _KEY.findall(text_of_keys)]
        place = () if header and keys else table
        for k, key in enumerate(keys, 1):
            place = (*place, key)
            lines.setdefault(place, number)
            if header and header[1] == "[[" and k == len(keys):
                last_items[place] = last_items.get(place, -1) + 1
            if header and place in last_items:
                place = (*place, last_items[place])
                lines.setdefault(place, number)
        table = place if header else table
    return lines
