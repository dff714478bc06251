"""The load of a config: its profile, the profile's torques and times, and traces of a torque in files.

`PROFILES` is the one list of the keys that each profile uses. `clunk.simulation.load` makes the pieces that are
simulated from a profile.
"""

import contextlib
import csv
import math
import re
import warnings
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from clunk.study.document import Document, read_text
from clunk.study.errors import ClunkWarning, ConfigError, listing, shorten
from clunk.study.tables import Bounded, Findings, Inertia, NotEmpty, NotNegative, Positive, Quantity, Table, Text

# The torques before and after the load step are given by both keys of the first pair, or by both of the second.
TORQUES = (("static_torque", "ratio"), ("initial_torque", "final_torque"))
LONGEST_TABLE = 100_000  # points in time


class Profile(NamedTuple):
    """A load profile: its name for people, and the keys that it uses besides `on` and `step_time`."""

    name: str
    keys: tuple[str, ...]


STEP_KEYS = (*TORQUES[0], *TORQUES[1])
PROFILES = {
    "step": Profile("ideal torque step", STEP_KEYS),
    "ramp": Profile("torque ramp", (*STEP_KEYS, "duration")),
    "smooth": Profile("smooth torque change", (*STEP_KEYS, "duration")),
    "lag": Profile("lagging torque change", (*STEP_KEYS, "time_constant")),
    "pulse": Profile("torque pulse", (*STEP_KEYS, "duration")),
    "table": Profile("tabulated torque", ("times", "torques", "scale")),
    "sine": Profile("sinusoidal torque", (*STEP_KEYS, "amplitude", "frequency")),
    "steps": Profile("torque change in steps", (*STEP_KEYS, "durations", "levels")),
}
_NEEDED = {"duration": "s", "time_constant": "s", "amplitude": "N m", "frequency": "Hz"}
_NEEDED |= {"durations": "s", "levels": "shares of the change"}
_MOST_LEVELS = 1000
_COLUMNS = "time (s) and torque (N m), separated by commas, semicolons or tabs"
# meaning of each column, and headings' spellings of its unit in lower case, letters only
_MEANT = ("time in s", ("s", "sec", "seconds")), ("torque in N m", ("nm",))
# unit in a heading: short, in brackets at its end; or a usual unit alone in its cell, as in a line of units of a log
_UNIT = re.compile(
    r"(\[[^\]]{1,15}\]|\([^)]{1,5}\))\s*$"
    r"|^\s*([mµu]?s|min|h|[mk]?N ?[·*.]?c?m|(in|ft)[ ·*.-]?lbf?|lbf?[ ·*.-]?(in|ft))\s*$",
    re.IGNORECASE,
)
_NUMBER = re.compile(r"[-+]?(\.?\d|(nan|inf(inity)?)\b)", re.IGNORECASE)


class Load(Table):
    """The torque on one inertia: steady until the load step, and from then on as its profile says.

    T0 is the torque before the load step and T1 the one to which it changes: T0 = Ts (1 + σr) and T1 = Ts for
    static_torque Ts and ratio σr (report Eqs. 2.2 and 2.4), or initial_torque and final_torque. t is the time after the
    load step.

    profile : "step": T1. "ramp": a straight line from T0 to T1 over the duration.
        "smooth": half a cosine from T0 to T1 over the duration. "lag": T1 + (T0 - T1) exp(-t / time_constant).
        "pulse": T1 for the duration, then T0 again. "table": straight lines between the torques at the times, times
        scale; the torque jumps at two equal times, and the first torque is T0. "sine": T1 + amplitude
        sin(2π frequency t). "steps": T0 + (T1 - T0) levels[k] during the k-th of the durations, and T1 after them
    on : int, number from 1 of the loaded inertia
    scale : float, factor on the torques of a table
    file : path or None, of a trace that becomes times and torques when a config is read; see `read_trace`
    step_time : float, time of the load step on the time axis of plots; without effect on a run
    """

    profile: Literal["step", "ramp", "smooth", "lag", "pulse", "table", "sine", "steps"] = "step"
    on: Annotated[Inertia, Quantity("loaded inertia", "i", "1")] = 1
    static_torque: Annotated[Bounded | None, Quantity("static torque", "Ts", "N m")] = None
    ratio: Annotated[Bounded | None, Quantity("load ratio", "σr = Td/Ts", "1")] = None
    initial_torque: Annotated[Bounded | None, Quantity("torque before the load step", "T0", "N m")] = None
    final_torque: Annotated[Bounded | None, Quantity("torque after the load change", "T1", "N m")] = None
    duration: Annotated[NotNegative | None, Quantity("duration of the load change", "d", "s")] = None
    time_constant: Annotated[NotNegative | None, Quantity("time constant of the load", "τ", "s")] = None
    amplitude: Annotated[Bounded | None, Quantity("amplitude of the load", "A", "N m")] = None
    frequency: Annotated[Positive | None, Quantity("frequency of the load", "f", "Hz")] = None
    durations: Annotated[
        NotEmpty[Annotated[NotNegative, Quantity("duration {} of the load", "d{}", "s")]] | None,
        Field(max_length=_MOST_LEVELS, description="a list of durations (s), one for each level"),
    ] = None
    levels: Annotated[
        NotEmpty[Annotated[Bounded, Quantity("level {} of the load", "λ{}", "1")]] | None,
        Field(
            max_length=_MOST_LEVELS, description="a list of shares of the change from the initial to the final torque"
        ),
    ] = None
    times: Annotated[
        NotEmpty[Annotated[NotNegative, Quantity("time {} of the load", "t{}", "s")]] | None,
        Field(max_length=LONGEST_TABLE, repr=False, description="a list of times (s), from 0 on"),
    ] = None
    torques: Annotated[
        NotEmpty[Annotated[Bounded, Quantity("torque {} of the load", "T[{}]", "N m")]] | None,
        Field(max_length=LONGEST_TABLE, repr=False, description="a list of torques (N m)"),
    ] = None
    scale: Annotated[Bounded, Quantity("scale of the load", "sT", "1")] = 1.0
    file: Annotated[Text | None, Field(description="the path of a trace: lines of time (s), torque (N m)")] = None
    step_time: Annotated[NotNegative, Quantity("time of the load step", "t0", "s")] = 0.1

    def contradictions(self) -> Findings:
        """Require the profile's keys, one pair of torques, as many levels as durations, and times in order."""
        given = tuple(key for key in STEP_KEYS if getattr(self, key) is not None)
        if self.profile == "table":
            text = 'given beside profile = "table", which has torques of its own; leave it out'
            yield from (((key,), text) for key in given)
        elif given not in TORQUES:
            pairs = " or ".join(map(listing, TORQUES))
            yield (), f"found {listing(given) or 'no torque'}; must be {pairs}, and no other of these (N m)"
        for key in PROFILES[self.profile].keys:
            if key in _NEEDED and getattr(self, key) is None:
                yield (key,), f"missing; a {shorten(self.profile)} needs it ({_NEEDED[key]})"
        if self.durations and self.levels and len(self.durations) != len(self.levels):
            text = f"found {len(self.levels)} levels for {len(self.durations)} durations; must be one for each"
            yield ("levels",), text
        yield from self._points()

    def _points(self) -> Findings:
        """Require as many torques as times, in order, or a file in place of both."""
        times, torques = self.times, self.torques
        if self.file is not None:
            together = "given beside times or torques; give file alone, or both of these"
            yield ("file",), together if times or torques else "must be read by load_study or study_from_text"
        elif times is None or torques is None:
            if self.profile == "table":
                yield ("times" if times is None else "torques",), 'missing; a "table" needs times and torques, or file'
        elif len(times) != len(torques):
            yield ("torques",), f"found {len(torques)} torques for {len(times)} times; must be one for each"
        if times is not None:
            yield from ((("times", k), text) for k, text in disorder(times))


def uses(profile: str, key: str) -> bool:
    """Whether a load of this profile uses a key."""
    return key in ("on", "step_time", *(PROFILES[profile].keys if profile in PROFILES else ()))


def numbers(load: Document, without: Container[str] = ()) -> list[str]:
    """Texts of the numbers that a load's profile uses, without defaults and lists: ``d = 0.1 s``.

    load : the table of a config
    without : keys to leave out
    """
    texts = []
    for key in PROFILES[load["profile"]].keys:
        value, field = load.get(key), Load.model_fields[key]
        if isinstance(value, float) and key not in without and value != field.default:
            quantity = next(each for each in field.metadata if isinstance(each, Quantity))
            unit = "" if quantity.unit == "1" else f" {quantity.unit}"
            texts.append(f"{quantity.symbol.partition(' ')[0]} = {value:g}{unit}")
    return texts


def disorder(times: Sequence[float]) -> Iterator[tuple[int, str]]:
    """Yield the position of the first time of a table that is out of order, if there is one, and what is wrong."""
    if times and times[0] != 0.0:
        yield 0, f"found {times[0]:g}; the first time must be 0, the load step"
        return
    for k in range(1, len(times)):
        if times[k] < times[k - 1]:
            yield k, f"found {times[k]:g} after {times[k - 1]:g}; times must not decrease"
            return
        if k > 1 and times[k] == times[k - 2]:
            yield k, f"found {times[k]:g} for the third time; two equal times are a jump, three are too many"
            return


def read_trace(path: Path) -> tuple[list[float], list[float]]:
    """Read times [s] and torques [N m] from the first two columns of a text file.

    The delimiter is a tab if that splits the first line of numbers into two finite numbers, else likewise a semicolon,
    else a comma. Between tabs or semicolons, numbers may have a decimal comma. Lines that do not begin with a number
    are headings; a ClunkWarning reports a heading with another unit than s and N m, in brackets or alone in its cell.

    Raises
    ------
    ConfigError
        Where the file cannot be read, a line has no two finite numbers, times are out of order, or there are no lines
        of numbers or more than `LONGEST_TABLE`.
    """
    rows = read_text(path, "a trace", f"a text file of {_COLUMNS}", known=".").splitlines()
    numbers = next((row for row in rows if _NUMBER.match(row.strip(' \t"'))), "")
    delimiter = next((mark for mark in "\t;" if _numbers(next(csv.reader([numbers], delimiter=mark), []))), ",")
    reader = csv.reader(rows, delimiter=delimiter)
    lines, points = [], []
    try:
        for row in reader:
            if row and _NUMBER.match(row[0].strip()):
                lines.append(f"{path}, line {reader.line_num}")
                points.append(_numbers(row))
                if not points[-1]:
                    found = shorten(delimiter.join(row))
                    raise ConfigError(f"{lines[-1]}: found {found}; must be finite numbers, {_COLUMNS}.")
                continue
            for cell, (meant, units) in zip(row if len(row) > 1 else (), _MEANT, strict=False):
                headed = _UNIT.search(cell)
                if headed and re.sub(r"\W", "", headed[0]).lower() not in units:
                    text = f"{path}, line {reader.line_num}: a column headed {shorten(cell)} is taken for {meant}"
                    warnings.warn(text, ClunkWarning, stacklevel=2)
    except csv.Error as error:
        raise ConfigError(f"{path}, line {reader.line_num}: {error}.") from None
    if not 1 <= len(points) <= LONGEST_TABLE:
        text = f"{path} has {len(points) or 'no'} lines that begin with a number"
        raise ConfigError(f"{text}; a trace has 1 to {LONGEST_TABLE} lines of {_COLUMNS}.")
    times, torques = map(list, zip(*points, strict=True))
    for k, text in disorder(times):
        raise ConfigError(f"{lines[k]}: {text}.")
    return times, torques


def _numbers(row: Sequence[str]) -> list[float]:
    """The first two cells of a row as numbers, with decimal point or comma; empty where they are no finite numbers."""
    with contextlib.suppress(ValueError):
        time, torque = (float(re.sub(r",(?=\d)", ".", cell).replace("_", "?")) for cell in row[:2])
        if math.isfinite(time) and math.isfinite(torque):
            return [time, torque]
    return []
