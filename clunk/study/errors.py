"""Base classes of all errors that a user can cause and of all warnings; problems of a config, and their report."""

import difflib
import json
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from clunk.study.records import counted, cut, fill

_LONGEST = 40  # characters of a value that a sentence quotes


class ClunkError(Exception):
    """An error that a user can cause and mend: its text says what happened, where, and what to do about it."""


class ClunkWarning(UserWarning):
    """A warning that an input is allowed, but probably not what the user meant."""


class Problem(NamedTuple):
    """An error in a config: its key, its line and a message.

    key : dotted key with items numbered from 1; empty where the error is of the file as a whole
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
        # text from a command line may hold bytes that are not UTF-8, which no terminal can print
        super().__init__(text.encode("utf-8", "backslashreplace").decode("utf-8"))
        self.problems = tuple(problems)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.problems)


def report(subject: str, problems: Sequence[Problem]) -> ConfigError:
    """Error that lists all of a subject's problems in the order of their lines, command-line overrides last.

    subject : beginning of the error's text, e.g. the path of the config
    """
    ordered = sorted(problems, key=lambda p: (p.override, p.line is None, p.line or 0))
    lines = [f"{subject} has {counted(len(ordered), 'error')}:", *(fill(str(each), "  ", "    ") for each in ordered)]
    return ConfigError("\n".join(lines), ordered)


def shorten(value: object) -> str:
    """A value as TOML writes it, cut to 40 characters."""
    if isinstance(value, str):
        return json.dumps(cut(value, _LONGEST), ensure_ascii=False)
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, dict):
        text = "a table"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(map(shorten, value[:_LONGEST])) + "]"
    elif isinstance(value, int) and abs(value) >= 2**63:
        text = "an integer beyond 64 bits"
    else:
        text = str(value)
    return cut(text, _LONGEST)


def nearest(name: object, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The known name most similar to `name`, both in lower case; None where none is similar enough, or it is no text.

    cutoff : least similarity, from 0 to 1, as in `difflib.get_close_matches`
    """
    if not isinstance(name, str):
        return None
    lowered = {each.lower(): each for each in known}
    return next((lowered[each] for each in difflib.get_close_matches(name[:100].lower(), lowered, 1, cutoff)), None)


def listing(names: Sequence[str], last: str = "and") -> str:
    """Names with commas, and a word before the last: ``a, b and c``."""
    return f" {last} ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
