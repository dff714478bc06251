"""A config as text: TOML and `key=value` overrides in, the lines on which keys stand, the report of what is wrong.

A place in a config is a tuple of keys and of list positions from 0, ``("driveline", "shafts", 2, "damping")``; people
read and write it with items from 1, ``driveline.shafts[3].damping``.
"""

import contextlib
import difflib
import json
import re
import textwrap
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from clunk.study.errors import ClunkError

Place = tuple[str | int, ...]

_LARGEST_FILE = 64 * 2**20  # bytes; a device or a results file must not fill the memory before it is refused
_DEEPEST = 32  # levels; a config has four, and walking one must not exhaust the stack
_WIDTH = 80
_SEGMENT = re.compile(r"([A-Za-z0-9_-]+)((?:\[[^\[\]]+\])*)")
_ITEM_NUMBER = re.compile(r"[0-9]{1,9}")
_PLAIN_WORD = re.compile(r"[^\W\d][\w-]*")


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    key : dotted key, items by number from 1; empty where the file as a whole is meant
    line : number from 1 of the line in the file, None where there is none
    message : what was found and what is allowed
    override : whether the key was set on the command line
    """

    key: str
    line: int | None
    message: str
    override: bool = False

    def __str__(self) -> str:
        where = f"--set {self.key}" if self.override else self.key
        if self.line is not None:
            where = f"line {self.line}, {where}" if where else f"line {self.line}"
        return f"{where}: {self.message}" if where else self.message


class ConfigError(ClunkError):
    """A config that cannot be used; its text reports everything that is wrong with it, ready to print.

    problems : tuple of Problem
    """

    def __init__(self, text: str, problems: Iterable[Problem] = ()) -> None:
        # what came from a command line may hold bytes that no terminal can print
        super().__init__(text.encode("utf-8", "backslashreplace").decode("utf-8"))
        self.problems = tuple(problems)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.problems)


def report(subject: str, problems: Sequence[Problem]) -> ConfigError:
    """The error that lists all of a subject's problems, in the order of their lines."""
    ordered = sorted(problems, key=lambda p: (p.override, p.line is None, p.line or 0))
    count = "1 error" if len(ordered) == 1 else f"{len(ordered)} errors"
    lines = [
        textwrap.fill(
            str(problem),
            _WIDTH,
            initial_indent="  ",
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        for problem in ordered
    ]
    return ConfigError("\n".join([f"{subject} has {count}:", *lines]), ordered)


def read_text(path: str | PathLike[str]) -> str:
    """The text of a config file.

    Raises
    ------
    ConfigError
        Where there is no such file, or it is no text.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
    except FileNotFoundError:
        raise _refusal(f"{path} does not exist{_nearest_file(Path(path))}") from None
    except IsADirectoryError:
        raise _refusal(f"{path} is a directory; a config is a file.") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise _refusal(f"{path} cannot be read: {reason}.") from None
    if data.startswith(b"\x89HDF"):
        raise _refusal(f"{path} is an HDF5 file, not a config; a config is a TOML file.")
    if len(data) > _LARGEST_FILE:
        raise _refusal(f"{path} is larger than {_LARGEST_FILE // 2**20} MiB; that is no config.")
    try:
        return data.decode("utf-8-sig")  # some editors write a byte order mark
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise _refusal(f"{path} is not UTF-8 text: byte 0x{data[error.start]:02x} on line {line}.", line) from None


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises
    ------
    ConfigError
        Where it is no TOML.
    """
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise _refusal(f"{source} is nested too deeply for a config.") from None
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"at line (\d+)", str(error))
        raise _refusal(f"{source} is not valid TOML: {error}.", int(found[1]) if found else None) from None
    except ValueError:  # Python refuses to read integers of more than 4300 digits
        raise _refusal(f"{source} holds an integer of thousands of digits.") from None
    if _is_too_deep(document):
        raise _refusal(f"{source} is nested too deeply for a config.")
    return document


def parse_override(text: str) -> tuple[Place, Any]:
    """The place and the value of `key=value`; the value is TOML, or a plain word without its quotes.

    Raises
    ------
    ValueError
        With a sentence on what is malformed.
    """
    key, equals, value = text.partition("=")
    if not equals:
        raise ValueError("must be KEY=VALUE, for example load.ratio=7")
    place = parse_place(key.strip())
    if place is None:
        raise ValueError(
            "must be KEY=VALUE with a dotted key, list items by number from 1, for example driveline.inertias[4]=0.003"
        )
    value = value.strip()
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        if not _PLAIN_WORD.fullmatch(value):
            raise ValueError(
                f"{shorten(value)} is no TOML value; text needs double quotes inside the shell's own"
            ) from None
        return place, value
    if parsed.keys() != {"value"} or _is_too_deep(parsed):
        raise ValueError(f"{shorten(value)} is not one TOML value")
    return place, parsed["value"]


def parse_place(key: str) -> Place | None:
    """The place that a dotted key names, items by number from 1; None where it is malformed.

    An item may have a name instead, ``driveline.inertias[ring]``; it comes back as ``"[ring]"``.
    """
    place: list[str | int] = []
    for part in key.split("."):
        match = _SEGMENT.fullmatch(part)
        if match is None:
            return None
        place.append(match[1])
        for item in re.findall(r"\[([^\[\]]+)\]", match[2]):
            number = _ITEM_NUMBER.fullmatch(item)
            if number and int(item) == 0:
                return None
            place.append(int(item) - 1 if number else f"[{item}]")
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


def shorten(value: object, width: int = 40) -> str:
    """A value as TOML writes it, cut to a width."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, str):
        if len(value) > width:
            value = value[: width - 1] + "…"
        return json.dumps(value, ensure_ascii=False)
    elif isinstance(value, dict):
        return "a table"
    elif isinstance(value, list | tuple):
        if value and all(isinstance(item, dict) for item in value):
            return "an array of tables"
        text = "[" + ", ".join(shorten(item, width) for item in value[:width]) + "]"
    elif isinstance(value, int) and abs(value) >= 2**63:
        return "an integer beyond 64 bits"
    else:
        text = str(value)
    return text if len(text) <= width else text[: width - 1] + "…"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that `name` most likely means, if any."""
    found = difflib.get_close_matches(name[:100].lower(), list(known), n=1, cutoff=0.6)
    return found[0] if found else None


class KeyLines:
    """The lines on which the keys of a TOML text stand, found by a small scanner (tomllib tells none).

    Meant for a text that has been parsed. In any other it finds what it can, and never raises.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._lines: dict[Place, int] = {}
        self._arrays: dict[Place, int] = {}
        self._counted = (0, 1)  # up to this offset: this line
        with contextlib.suppress(ValueError, IndexError, RecursionError):
            self._scan()

    def find(self, place: Place) -> int | None:
        """The line of a place, from 1; failing that, of the nearest table or list around it."""
        while place:
            if place in self._lines:
                return self._lines[place]
            place = place[:-1]
        return None

    def _scan(self) -> None:
        table: Place = ()
        at = 0
        while (at := self._skip(at)) < len(self._text):
            if self._text.startswith("[", at):
                is_array = self._text.startswith("[[", at)
                start, (keys, at) = at, self._keys(at + 1 + is_array)
                table = self._enter(keys, is_array, start)
                at += 1 + is_array
            else:
                at = self._assignment(table, at)

    def _enter(self, keys: Place, is_array: bool, at: int) -> Place:
        """The place of a table header; a key of an array of tables means its latest table."""
        table: Place = ()
        for k, key in enumerate(keys):
            table = (*table, key)
            self._note(table, at)
            if is_array and k == len(keys) - 1:
                self._arrays[table] = self._arrays.get(table, 0) + 1
            if table in self._arrays:
                table = (*table, self._arrays[table] - 1)
                self._note(table, at)
        return table

    def _assignment(self, table: Place, at: int) -> int:
        start = at
        keys, at = self._keys(at)
        for k in range(len(keys)):
            self._note(table + keys[: k + 1], start)
        return self._value(table + keys, at + 1)

    def _note(self, place: Place, at: int) -> None:
        offset, line = self._counted
        line += self._text.count("\n", offset, at)
        self._counted = (at, line)
        self._lines.setdefault(place, line)

    _BLANK = re.compile(r"(?:\s|#[^\n]*)*")
    _KEY = re.compile(r"""[ \t]*(?:([A-Za-z0-9_-]+)|"((?:[^"\\\n]|\\.)*)"|'([^'\n]*)')[ \t]*""")
    _SCALAR = re.compile(
        r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|[^,\]}#\n]+''', re.DOTALL
    )

    def _match(self, pattern: re.Pattern[str], at: int) -> re.Match[str]:
        match = pattern.match(self._text, at)
        if match is None:
            raise ValueError
        return match

    def _skip(self, at: int) -> int:
        return self._match(self._BLANK, at).end()

    def _keys(self, at: int) -> tuple[Place, int]:
        keys: list[str | int] = []
        while True:
            match = self._match(self._KEY, at)
            bare, quoted, literal = match.groups()
            keys.append(bare or literal or (json.loads(f'"{quoted}"') if quoted else ""))
            at = match.end()
            if not self._text.startswith(".", at):
                return tuple(keys), at
            at += 1

    def _value(self, place: Place, at: int) -> int:
        at = self._skip(at)
        bracket = self._text[at]
        if bracket not in "[{":
            return self._match(self._SCALAR, at).end()
        at = self._skip(at + 1)
        item = 0
        while self._text[at] not in "]}":
            if bracket == "[":
                self._note((*place, item), at)
                at = self._value((*place, item), at)
                item += 1
            else:
                at = self._assignment(place, at)
            at = self._skip(at)
            if self._text[at] == ",":
                at = self._skip(at + 1)
        return at + 1


def _refusal(sentence: str, line: int | None = None) -> ConfigError:
    return ConfigError(sentence, [Problem("", line, sentence)])


def _nearest_file(path: Path) -> str:
    try:
        names = [entry.name for entry in path.parent.iterdir() if entry.suffix == ".toml"]
    except OSError:
        return "."
    name = nearest(path.name, names)
    return f"; did you mean {path.with_name(name)}?" if name else "."


def _is_too_deep(document: object) -> bool:
    level, depth = [document], 0
    while level:
        if depth > _DEEPEST:
            return True
        depth += 1
        level = [
            child
            for node in level
            if isinstance(node, dict | list)
            for child in (node.values() if isinstance(node, dict) else node)
        ]
    return False
