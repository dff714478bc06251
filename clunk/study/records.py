"""Records: results of an analysis or a command, declared once and rendered for people and for scripts.

A record is a frozen dataclass derived from `Record`. Its fields made by `told` and its properties decorated by `tells`
carry a heading, a unit and a number format (`Told`); only these are rendered: as text for 80 columns (`text_of`), as
JSON (`plain`) and as repr. Values may be numbers, texts, dictionaries, records, and sequences of these.

In a text, sentences come first (their heading is `SENTENCE`), then single values, a line each, and then records and
tables of records, each under its heading. Values without a heading are for scripts alone.
"""

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from html import escape
from typing import Any, TypeVar, dataclass_transform

SENTENCE = "."
WIDTH = 80  # columns of a terminal
Rows = Sequence[tuple[str, str]]
Getter = TypeVar("Getter", bound=Callable[[Any], Any])

_LEFT = ' style="text-align: left"'  # browsers centre the headings of tables
_MOST_BESIDE = 0.7  # largest share of a table's width for all columns but the widest
_MOST = 30  # most rows of a table in a text; JSON has all rows


@dataclass(frozen=True)
class Told:
    """Heading, unit and format of a value.

    heading : for people; empty where the value is for scripts alone
    unit : as people write it; empty where there is none
    form : format specification of a number, e.g. ``.3f``
    key : name in JSON; empty where it is the name of the field or property
    """

    heading: str = ""
    unit: str = ""
    form: str = ""
    key: str = ""


def told(*how: str, **named: str) -> Any:
    """A field of a record that is rendered; the arguments are those of `Told`."""
    return field(metadata={"told": Told(*how, **named)})


def tells(*how: str, **named: str) -> Callable[[Getter], Getter]:
    """Decorate the getter of a record's property that is rendered; the arguments are those of `Told`."""

    def decorate(getter: Getter) -> Getter:
        getter.__dict__["told"] = Told(*how, **named)
        return getter

    return decorate


@dataclass_transform(frozen_default=True, field_specifiers=(told,))
class Record:
    """Results of an analysis or a command, for people and for scripts.

    A class derived from it is a frozen dataclass; options of `dataclass` follow the base: `(Record, eq=False)`.
    """

    def __init_subclass__(cls, **options: bool) -> None:
        dataclass(frozen=True, **options)(cls)

    def told(self) -> Iterator[tuple[str, Told, Any]]:
        """Yield name, `Told` and value of everything that is rendered: fields, then properties."""
        for each in fields(self):  # type: ignore[arg-type]  # records are dataclasses
            if "told" in each.metadata:
                yield each.name, each.metadata["told"], getattr(self, each.name)
        for name, member in vars(type(self)).items():
            if isinstance(member, property) and "told" in vars(member.fget):
                yield name, vars(member.fget)["told"], getattr(self, name)

    def rows(self) -> Rows:
        """Heading and text of each single value for people, without sentences, tables and empty values."""
        return [
            (each.heading, words(value, each))
            for _, each, value in self.told()
            if each.heading not in ("", SENTENCE) and not _is_empty(value) and not _is_block(value)
        ]

    def __repr__(self) -> str:
        return as_text(f"clunk.{type(self).__name__} {getattr(self, 'title', '')!r}".removesuffix(" ''"), self.rows())


Row = Record | Mapping[str, Any] | tuple[str, Record | Mapping[str, Any]]


def plain(value: Any) -> Any:
    """A value in JSON's types: None for NaN and infinities, lists for tuples and arrays, text for any other object."""
    if isinstance(value, Record):
        return {each.key or name: plain(inner) for name, each, inner in value.told()}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # numpy arrays and scalars, without importing numpy, which would slow --help
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def text_of(record: Record) -> str:
    """A record as text for 80 columns, which ends with a line feed."""
    return "\n".join(line.rstrip() for line in _lines(record)) + "\n"


def _lines(record: Record, width: int = WIDTH) -> Iterator[str]:
    sentences = [
        fill(str(value), width=width) for _, each, value in record.told() if each.heading == SENTENCE and value
    ]
    rows = [*value_lines(record.rows(), width)]
    yield from sentences
    yield from [""] * bool(sentences and rows)
    yield from rows
    for _, each, value in record.told():
        if each.heading in ("", SENTENCE) or _is_empty(value) or not _is_block(value):
            continue
        yield from [""] * bool(sentences or rows)
        yield each.heading
        if isinstance(value, Record):
            yield from _indented(value, width)
        elif isinstance(value, Mapping) and any(map(_has_tables, value.values())):
            for key, item in value.items():
                yield from ["", f"  {key}", *_indented(item, width, "    ")]
        else:
            yield from table([*value.items()] if isinstance(value, Mapping) else value, width=width)


def _indented(record: Record, width: int, indent: str = "  ") -> list[str]:
    return textwrap.indent("\n".join(_lines(record, width - len(indent))), indent).split("\n")


def _has_tables(value: Any) -> bool:
    return isinstance(value, Record) and any(each.heading and _is_block(inner) for _, each, inner in value.told())


def value_lines(rows: Iterable[tuple[str, str]], width: int = WIDTH) -> Iterator[str]:
    """Yield a line for each heading and text, wrapped to a width, with the texts aligned in one column."""
    rows = list(rows)
    indent = max((len(heading) for heading, _ in rows), default=0) + 2
    for heading, text in rows:
        yield fill(text, f"{heading:<{indent}}", " " * indent, width)


def table(rows: Sequence[Row], most: int = _MOST, width: int = WIDTH) -> Iterator[str]:
    """Yield the lines of a table: columns two blanks apart, indented by two, numbers aligned to the right.

    A row is a record, a dictionary, or a tuple of a name and one of these; the name is the first column. In a table
    that is too wide the widest column comes last and is wrapped. If the other columns take more than `_MOST_BESIDE` of
    the width, each row becomes a wrapped list of ``heading: text``.

    most : rows that are shown; a last line counts the others
    """
    shown = rows[:most]
    columns = [*zip(*columns_of(shown), strict=True)]
    widths = [max(map(len, column)) for column in columns]
    widest = max(widths, default=0)
    indent = 2 * len(widths) + sum(widths) - widest
    if indent > _MOST_BESIDE * width and indent + widest > width:
        for row in shown:
            named = [(each.heading, words(value, each)) for each, value in _entries(row) if not _is_empty(value)]
            yield fill(", ".join(f"{heading}: {text}".lstrip(": ") for heading, text in named), "  ", "    ", width)
    else:
        if indent + widest > width:
            columns.append(columns.pop(widths.index(widest)))
            widths.remove(widest)
            widths.append(widest)
        right = [all(map(_is_number, column[1:])) for column in columns]
        for line in zip(*columns, strict=True):
            cells = zip(line, widths, right, strict=True)
            *first, last = (f"  {cell:{'>' if is_right else '<'}{wide}}" for cell, wide, is_right in cells)
            whole = "".join((*first, last)).rstrip()
            yield whole if len(whole) <= width else fill(last.strip(), "".join(first) + "  ", " " * indent, width)
    if len(rows) > len(shown):
        yield f"  and {len(rows) - len(shown):,} more"


def columns_of(rows: Sequence[Row]) -> list[list[str]]:
    """Lists of texts of a table: headings, then each row; a dictionary in a row has one column for each key."""
    texts = []
    for row in rows:
        cells: dict[str, str] = {}
        for each, value in _entries(row):
            if isinstance(value, Mapping):
                cells |= {key: words(inner, each) for key, inner in value.items()}
            else:
                cells[with_unit(each.heading, each.unit)] = words(value, Told(form=each.form))
        texts.append(cells)
    heads = list(dict.fromkeys(head for cells in texts for head in cells))
    return [heads, *([cells.get(head, "") for head in heads] for cells in texts)]


def words(value: Any, how: Told = Told()) -> str:
    """Text of a single value for people, with its unit; ``-`` for None, yes or no for a bool."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return ", ".join(f"{key} = {words(item, Told(form=how.form))}" for key, item in value.items())
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        text = " ".join(words(item, Told(form=how.form)) for item in value)
    elif isinstance(value, float):
        text = number(value, how.form or ".6g")
    elif isinstance(value, int):
        text = f"{value:{how.form or ','}}"
    else:
        text = str(value)
    return f"{text} {how.unit}" if text and how.unit else text


def number(value: float, form: str = ".6g") -> str:
    """A number in a format; ``-`` for NaN."""
    return "-" if math.isnan(value) else f"{value:{form}}"


def fill(text: str, first: str = "", rest: str = "", width: int = WIDTH) -> str:
    """Wrap a text to a width, by default `WIDTH`; `first` and `rest` indent the first and the other lines."""
    return _Wrapper(width, initial_indent=first, subsequent_indent=rest, break_on_hyphens=False).fill(text)


class _Wrapper(textwrap.TextWrapper):
    """Text wrapper that can also break a regime label between its groups, as DS(1)|SS(2)."""

    wordsep_simple_re = re.compile(r"(\s+|(?<=\))(?=[A-Z]{2}\())")


def _entries(row: Row) -> list[tuple[Told, Any]]:
    """Headings and values of a row for people: all of a dictionary, those with a heading of a record."""
    if isinstance(row, tuple):
        return [(Told(), row[0]), *_entries(row[1])]
    if isinstance(row, Record):
        return [(each, value) for _, each, value in row.told() if each.heading]
    return [(Told(key), value) for key, value in row.items()]


def _is_number(text: str) -> bool:
    return text in ("", "-") or text.lstrip("+-")[:1].isdigit()


def _is_empty(value: Any) -> bool:
    """Whether a value is left out of texts: None, empty text or list, and a dictionary whose counts are all 0."""
    if isinstance(value, Mapping):
        return all(type(item) is int and not item for item in value.values())  # counts that are all 0
    return value is None or (isinstance(value, str | list | tuple) and not value)


def _is_block(value: Any) -> bool:
    """Whether a value is rendered as a block below its heading: a record, or a table of records or dictionaries."""
    if isinstance(value, Mapping):
        return any(isinstance(item, Mapping | Record) for item in value.values())
    is_table = isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Record | Mapping)
    return isinstance(value, Record) or is_table


# --- summaries of objects, phrases and HTML


def as_text(heading: str, rows: Rows) -> str:
    """A repr: heading in angle brackets, then a line for each pair of a name and a text."""
    lines = "\n".join(value_lines(rows, WIDTH - 2))
    return f"<{cut(heading, WIDTH - 2)}>\n{textwrap.indent(lines, '  ')}"


def html_table(rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """HTML of a table; its texts may come from a config or a file, and are escaped."""
    head = "".join(f"<th{_LEFT}>{escape(text)}</th>" for text in header)
    body = "".join(f"<tr>{''.join(f'<td{_LEFT}>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    return f"<table>{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>{body}</tbody></table>"


def counted(count: int, noun: str) -> str:
    """A number of things, for example 1,024 cells."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def with_unit(name: str, unit: str) -> str:
    """A name with its unit in brackets, e.g. ``severity [rad/s²]``; the name alone where the unit is empty or ``1``."""
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def percent(part: int, whole: int) -> str:
    """A share in percent, with bounds such as ``less than 0.01 %`` where rounding would read as none or all."""
    share = 100.0 * part / whole
    if 0 < share < 0.01:
        return "less than 0.01 %"
    if 99.99 < share < 100:
        return "more than 99.99 %"
    return f"{share:.2g} %" if share < 10 else f"{share:.4g} %" if share > 99 else f"{share:.3g} %"


def capital(text: str) -> str:
    """Text with a capital first letter."""
    return text[:1].upper() + text[1:]


def cut(text: str, width: int) -> str:
    """A text of at most `width` characters, the last of them … where it was longer."""
    return text if len(text) <= width else text[: width - 1] + "…"
