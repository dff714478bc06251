"""Config documents as plain tables, lists and values: TOML and `key=value` overrides, places, and lines of keys.

A place in a config is a tuple of keys and of list positions from 0, ``("driveline", "shafts", 2, "damping")``. Its
dotted key, which people read and write, numbers items from 1: ``driveline.shafts[3].damping``.
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

READ: set[Path] = set()
"""Text files that this process has read: configs, traces and measurements, in whose place no command writes."""

_LARGEST_FILE = 64 * 2**20  # bytes; a device or a results file must not fill the memory before it is refused
_DEEPEST = 32  # levels; a config has four, and walking one must not exhaust the stack
_SEGMENT = re.compile(r"([A-Za-z0-9_-]+)((?:\[[^\[\]]+\])*)")
_ITEM_NUMBER = re.compile(r"[0-9]{1,9}")
_PLAIN_WORD = re.compile(r"(?:[^\W\d]|[./~])(?:[\w./~-]|\[\d+\])*")  # also a path or a dotted key
_WORDS_OF_TOML = {"true", "false", "inf", "nan"}


# --- Text -> tables --------------------------------------------------------------------------------------------------


def read_text(path: FilePath, noun: str = "a config", form: str = "a TOML file", known: str | None = None) -> str:
    """Read a text file in UTF-8; raise ConfigError where it is missing, unreadable, larger than 64 MiB or not UTF-8.

    noun, form : what the file is read as and its format, for the text of an error
    known : end of the error's sentence where the file does not exist; by default a hint at the config with the most
        similar name
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
        READ.add(Path(path).resolve())
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
    """Parse TOML into tables; raise ConfigError where it is not valid, or nested more than `_DEEPEST` levels deep."""
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
    """Place and value of an override `key=value`; the value is TOML, or a word, path or dotted key without quotes.

    Raises
    ------
    ValueError
        Where the override is malformed; the text is a sentence for the user.
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
        parsed = tomllib.loads(f"value = {value}".encode().decode())  # encode() refuses bytes that were not UTF-8
    except (ValueError, RecursionError):
        parsed = {}
    if parsed.keys() != {"value"} or _is_too_deep(parsed):
        raise ValueError(f"{shorten(value)} is no TOML value; text needs double quotes inside the shell's own")
    return place, parsed["value"]


def _refusal(sentence: str, line: int | None = None) -> ConfigError:
    return ConfigError(sentence, [Problem("", line, sentence)])


def nearest_file(path: Path, suffix: str, usual: str) -> str:
    """Hint at a file whose name resembles that of a missing one: ``; did you mean configs/smoke.toml?``, or empty.

    suffix : of the files that are considered
    usual : folder in which they usually are, searched after the folder of the missing file, beside which it lies
    """
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
    """Key and value of `key=value`; the value is None where the text has no equals sign outside of brackets."""
    match = re.fullmatch(r"((?:[^=\[]|\[[^\]]*\])*)=(.*)", text, re.DOTALL)  # a name in brackets may contain "="
    return (match[1].strip(), match[2].strip()) if match else (text.strip(), None)


# --- Places ----------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=1024)
def parse_place(key: str) -> Place | None:
    """Place of a dotted key, whose items are numbered from 1; None where the key is malformed.

    An item may be given by name instead, ``driveline.inertias[ring]``: its step in the place is then ``"[ring]"``.
    """
    place = []
    for part in re.split(r"\.(?![^\[\]]*\])", key):  # a dot in brackets belongs to a name
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
    """Dotted key of a place, with items numbered from 1, e.g. ``driveline.shafts[3].damping``."""
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
    """The items of a list or tuple; empty for any other value."""
    return value if isinstance(value, list | tuple) else ()


def value_at(document: Any, place: Place) -> Any:
    """The value at a place of a document, valid or not, or of a config's model; None where there is no value."""
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
    """Yield the dotted key and the value of each leaf of a document; an empty table or list is a leaf.

    whole_lists : whether a list of plain values is one leaf; otherwise each of its items is
    """
    is_whole = whole_lists and not any(isinstance(item, Mapping) for item in items_of(node))
    steps = [*node.items()] if isinstance(node, Mapping) else [] if is_whole else [*enumerate(items_of(node))]
    for step, value in steps:
        yield from leaves(value, (*place, step), whole_lists=whole_lists)
    if not steps:
        yield dotted(place), node


def with_value(node: Any, place: Place, value: Any) -> Any:
    """A copy of a document with another value at a place; missing tables are added, but list items must exist."""
    if not place:
        return value
    step = place[0]
    if isinstance(step, int):
        return (*node[:step], with_value(node[step], place[1:], value), *node[step + 1 :])
    return {**node, step: with_value(node.get(step), place[1:], value)}


def assign(document: Document, place: Place, value: Any) -> bool:
    """Set a value at a place of a document, adding missing tables; return whether the document has such a place.

    It has none where a list lacks the item, or where a step is a key of something other than a table.
    """
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
    """Line numbers, from 1, of table headers and of keys at the start of a line in a TOML text.

    tomllib gives no line numbers.
    """
    lines: dict[Place, int] = {}
    last_items: dict[Place, int] = {}  # array of tables -> position of its latest item
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
