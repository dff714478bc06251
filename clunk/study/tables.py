"""Building blocks of a config's tables: their base class, quantities with units, and types of texts and inertias."""

import math
import sys
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PlainValidator,
    Tag,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

from clunk.study.document import Place, dotted, items_of, value_at
from clunk.study.errors import listing, nearest, shorten

Finding = tuple[Place, str]  # a place, and what is wrong there
Findings = Iterator[Finding]
LONGEST_AXIS = 10_000_000  # values; checked before any array is made
MOST_DRAWS = 1_000_000  # draws of a sample
LARGEST_SIZE = 1e30  # largest magnitude of a number; its inverse is the smallest of positive and non-zero keys
OTHER_UNITS = {"gap_mm": "backlash_deg", "stiffness_per_deg": "stiffness"}  # key in another unit -> key that it becomes
ONE, SEVERAL = "<one number>", "<several numbers>"  # tags of a key's variants, only in locations of pydantic's errors
One = TypeVar("One")
Several = TypeVar("Several")
Item = TypeVar("Item")


def refusal(text: str, findings: Sequence[Finding] = ()) -> PydanticCustomError:
    """Error that a validator raises.

    findings : places below the validated value, each with what is wrong there; by default the text, at the value itself
    """
    return PydanticCustomError("clunk", "{text}", {"text": text, "findings": findings or [((), text)]})


class Table(BaseModel):
    """A table of a config: frozen, strict, without unknown keys, NaN or infinities."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    def contradictions(self) -> Findings:
        """Yield findings on keys that contradict one another although each is valid, at places in this table."""
        yield from ()

    def but(self, **values: Any) -> Self:
        """A copy of the table with other values of these keys, which are not validated."""
        return self.model_copy(update=values)

    @model_validator(mode="after")
    def _refuse_contradictions(self) -> Self:
        findings = tuple(self.contradictions())
        if findings:
            text = "; ".join(f"{dotted(place)}: {message}" if place else message for place, message in findings)
            raise refusal(text, findings)
        return self


@dataclass(frozen=True)
class Quantity:
    """Name, symbol and unit of what a numeric key measures; only such keys can be swept, drawn or replaced.

    name, symbol : for people, e.g. ``load ratio`` and ``σr = Td/Ts``; ``{}`` stands for an item's number
    unit : as udunits reads it, ``1`` for none
    """

    name: str
    symbol: str
    unit: str

    def __get_pydantic_json_schema__(self, core_schema: Any, handler: Any) -> dict[str, Any]:
        """JSON Schema of the key, with its quantity as further keywords."""
        return {**handler(core_schema), "quantity": self.name, "symbol": self.symbol, "unit": self.unit}


def is_number(value: Any) -> bool:
    """Whether a value is a finite number."""
    return type(value) in {int, float} and abs(value) <= sys.float_info.max


def converted(table: Any, key: str, target: str, convert: Callable[[float], float], highest: float = math.inf) -> Any:
    """A table whose number, or list of numbers, in another unit is converted into the key `target`.

    Where both keys are given the table is unchanged: its validation refuses them. A number that cannot be converted,
    or is converted to more than `highest`, stays, so that the error is reported at its key; `target` is then 0, which
    is valid.
    """
    if not isinstance(table, dict) or table.get(key) is None or table.get(target) is not None:
        return table
    values = [
        convert(each) if is_number(each) and each >= 0 else math.inf for each in items_of(table[key]) or (table[key],)
    ]
    if max(values) > highest or math.inf in values:
        return {**table, target: 0.0}
    value = tuple(values) if isinstance(table[key], list | tuple) else values[0]
    return {**{name: each for name, each in table.items() if name != key}, target: value}


def _one_line(text: str) -> str:
    # control characters and broken Unicode can be written neither to a terminal nor to a results file
    if any(unicodedata.category(character) in {"Cc", "Cs"} for character in text):
        raise refusal(f"found {shorten(text)}; must be text on one line")
    return text


def misnamed(names: Sequence[str | None], noun: str) -> Iterator[tuple[int, str]]:
    """Yield position and reason of each name that is empty, a number, "ground", taken, or has brackets in it."""
    for k, name in enumerate(names):
        if name is not None and (not name.strip() or name.isdigit() or set(name) & set("[]")):
            yield k, f"found {shorten(name)}; a name must not be empty, a number, or have brackets in it"
        elif name == "ground":
            yield k, 'found "ground"; that name is kept for the ground itself'
        elif name is not None and name in names[:k]:
            yield k, f"the name {shorten(name)} is taken by {noun} {names.index(name) + 1}"


def position_of(value: Any, count: int, names: Sequence[str | None], noun: str) -> int:
    """Position, from 0, of the item with a number from 1 to `count` or with a name.

    Raises ValueError where there is no such item; the text says what is allowed.

    names : of the items, None for an item without a name
    noun : what an item is called in the error's text
    """
    if type(value) is int and 1 <= value <= count:
        return value - 1
    known = [name for name in names if isinstance(name, str)]
    if value in known:
        return names.index(value)
    likely = nearest(value, known)
    hint = f"did you mean {shorten(likely)}? It" if likely else "it"
    numbers = [f"a number from 1 to {count}" if count > 1 else "1"] if count else []
    choices = listing([*numbers, *map(shorten, known)], "or")
    raise ValueError(f"there is no {noun} {shorten(value)}; {hint} must be {choices}")


def numbered_inertia(value: Any, info: ValidationInfo) -> Any:
    """Validate an inertia given by number or name, and return its number from 1.

    The context of the validation is the table [driveline], with the inertias and their names.
    """
    inertias, names = (items_of(value_at(info.context, (key,))) for key in ("inertias", "names"))
    if type(value) is int and not inertias:  # missing inertias are an error of their own
        return value
    try:
        return position_of(value, len(inertias), names, "inertia") + 1
    except ValueError as error:
        raise refusal(str(error)) from None


def _distinct(ends: tuple[Any, ...]) -> tuple[Any, ...]:
    if ends[0] == ends[1]:
        raise refusal(f'both ends are {shorten(ends[0])}; must be two inertias, or one and "ground"')
    return ends


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise refusal("found 0; must be a finite number other than 0")
    return value


def _sizeable(value: float) -> float:
    # products of several such numbers stay within the range of double precision
    if value != 0.0 and not 1.0 / LARGEST_SIZE <= abs(value) <= LARGEST_SIZE:
        raise refusal(f"found {value:g}; must be from {1.0 / LARGEST_SIZE:g} to {LARGEST_SIZE:g}")
    return value


def _bounded(value: float) -> float:
    if abs(value) > LARGEST_SIZE:
        raise refusal(f"found {value:g}; must be from {-LARGEST_SIZE:g} to {LARGEST_SIZE:g}")
    return value


OneOrSeveral = Annotated[
    Annotated[One, Tag(ONE)] | Annotated[Several, Tag(SEVERAL)],
    Discriminator(lambda value: SEVERAL if isinstance(value, list | tuple) else ONE),
]
Bounded = Annotated[float, AfterValidator(_bounded)]
NotEmpty = Annotated[tuple[Item, ...], Field(min_length=1)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_sizeable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_sizeable)]
NotZero = Annotated[
    float, AfterValidator(_not_zero), AfterValidator(_sizeable), WithJsonSchema({"type": "number", "not": {"const": 0}})
]
Text = Annotated[str, AfterValidator(_one_line)]
Seed = Annotated[int, Field(ge=0)]
DrawCount = Annotated[int, Field(ge=1, le=MOST_DRAWS)]
Inertia = Annotated[
    int,
    PlainValidator(numbered_inertia),
    WithJsonSchema({"type": ["integer", "string"], "minimum": 1, "description": "an inertia's number or name"}),
]
End = Annotated[
    int | Literal["ground"],
    PlainValidator(lambda value, info: value if value == "ground" else numbered_inertia(value, info)),
    WithJsonSchema({"type": ["integer", "string"]}),
]
Ends = Annotated[
    tuple[End, ...],
    Field(min_length=2, max_length=2, description='two inertias, or one and "ground", for example [1, 2]'),
    AfterValidator(_distinct),
]
