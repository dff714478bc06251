"""Tables of an optimisation: the parameters that are free, what is minimised, and what must hold."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, Tag

from clunk.study.tables import ONE, SEVERAL, Finding, OneOrSeveral, Table, Text


class FreeParameter(Table):
    """A number that is searched from low to high, in its key's unit.

    parameter : dotted key, or several keys that all take the number
    """

    parameter: Annotated[
        Annotated[Text, Tag(ONE)] | Annotated[tuple[Text, ...], Field(min_length=1), Tag(SEVERAL)],
        OneOrSeveral,
        Field(description='a dotted numeric key, or a list of keys that take one value, ["load.levels[1]"]'),
    ]
    low: float
    high: float

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that take the number."""
        return self.parameter if isinstance(self.parameter, tuple) else (self.parameter,)

    def contradictions(self) -> Iterator[Finding]:
        """Require low < high."""
        if not self.low < self.high:
            yield ("high",), f"found {self.high:g}; must be greater than low = {self.low:g}"


class Optimize(Table):
    """The values of some keys that minimise a key or a quantity while others hold.

    minimize : one of the parameters' keys, or a quantity of runs: over axes its worst value
    subject_to : quantities that must hold, such as ``label=NI`` or ``severity<=8000``, in every cell of the axes
    robust : share of the drawn drivelines in which they hold; with sweep.tolerances only
    seed : int, the same one gives the same answer
    """

    minimize: Text
    subject_to: tuple[Text, ...] = ()
    robust: Annotated[float | None, Field(gt=0, le=1)] = None
    seed: Annotated[int, Field(ge=0)] = 0
    parameters: Annotated[tuple[FreeParameter, ...], Field(min_length=1)]

    def contradictions(self) -> Iterator[Finding]:
        """Require that no key is free twice."""
        taken: dict[str, int] = {}
        for k, each in enumerate(self.parameters):
            for key in each.keys:
                if taken.setdefault(key, k) != k:
                    text = f"{key} is free as optimize.parameters[{taken[key] + 1}] already"
                    yield ("parameters", k, "parameter"), text
