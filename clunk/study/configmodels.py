"""A validated config as frozen values: `Study` and its parts, with the type, range and unit of every key.

The units are the config's (degrees, N/m at a radius); `driveline` converts. Inertias are numbered from 1.
"""

import functools
import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from clunk.study.configfile import Place, dotted
from clunk.study.configrules import (
    LONGEST_AXIS,
    MOST_DRAWS,
    Key,
    MustBe,
    Quantity,
    findings,
    key_at,
    place_of,
    schema_of,
    sweep_findings,
    value_at,
    with_value,
)
from clunk.study.distributions import NUMBERS, Distribution, Kind, Sampler, unit_points
from clunk.study.summaries import Rows, as_html, as_text, html_table

FloatArray = npt.NDArray[np.float64]
End = int | Literal["ground"]
Ends = Annotated[tuple[End, End], MustBe('two inertias, or one and "ground", for example [1, 2]')]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Shaft(_Frozen):
    """A massless linear spring and damper between two inertias, or between one and ground.

    between : two of an inertia's number from 1 and "ground"
    stiffness : float  [N m/rad]
    damping : float  [N m s/rad]
    """

    between: Ends
    stiffness: Annotated[NotNegative, Quantity("stiffness of shaft {}", "k{}", "N m/rad")]
    damping: Annotated[NotNegative, Quantity("damping of shaft {}", "c{}", "N m s/rad")]


class DrivelineConfig(_Frozen):
    """Inertias and the shafts that join them.

    inertias : (n,) float  [kg m2]
    names : (n,) str, optional
    """

    inertias: Annotated[tuple[Positive, ...], Field(min_length=1), Quantity("inertia {}", "J{}", "kg m2")]
    names: Annotated[tuple[str, ...], MustBe("a list of names, one for each inertia")] | None = None
    shafts: tuple[Shaft, ...]


class Contact(_Frozen):
    """What happens where the flanks touch.

    stiffness : float  [N/m], at the radius
    damping : float  [N s/m], at the radius
    separation : the flanks part when the gap opens, or when the contact force would turn tensile
    restitution : float, speed after an impact over the speed before; the indentation model does not use it
    locking_speed : float or None  [rad/s], a slower rebound locks; the indentation model does not use it
    """

    model: Literal["indentation", "restitution"] = "indentation"
    stiffness: Annotated[Positive, Quantity("contact stiffness", "k", "N/m")]
    damping: Annotated[NotNegative, Quantity("contact damping", "c", "N s/m")]
    separation: Literal["gap", "force"] = "gap"
    restitution: Annotated[float, Field(ge=0, le=1), Quantity("coefficient of restitution", "e", "1")] = 0.5
    locking_speed: Annotated[Positive | None, Quantity("locking speed", "v", "rad/s")] = None


class Lash(_Frozen):
    """The backlash, between two inertias or between one and ground.

    backlash_deg : float  [degrees], the whole gap
    radius : float  [m], at which the flanks touch
    """

    between: Ends
    backlash_deg: Annotated[float, Field(ge=0, le=360), Quantity("backlash", "φθ", "degrees")]
    radius: Annotated[Positive, Quantity("radius of the flanks", "r", "m")]
    contact: Contact


class Load(_Frozen):
    """The torque on one inertia: an ideal step (report Eqs. 2.2 and 2.4).

    Either static_torque Ts and ratio σr, for Ts (1 + σr) before the load step and Ts after it; or the two torques.

    on : int, number from 1 of the loaded inertia
    static_torque, initial_torque, final_torque : float or None  [N m]
    ratio : float or None
    step_time : float  [s], of the load step on the time axis of plots
    """

    profile: Literal["tip-out"] = "tip-out"
    on: Annotated[int, Field(ge=1), Quantity("loaded inertia", "i", "1"), MustBe("an inertia's number or name")]
    static_torque: Annotated[float | None, Quantity("static torque", "Ts", "N m")] = None
    ratio: Annotated[float | None, Quantity("load ratio", "σr = Td/Ts", "1")] = None
    initial_torque: Annotated[float | None, Quantity("torque before the load step", "T(0⁻)", "N m")] = None
    final_torque: Annotated[float | None, Quantity("torque after the load step", "T(0⁺)", "N m")] = None
    step_time: Annotated[NotNegative, Quantity("time of the load step", "t0", "s")] = 0.1


class Solver(_Frozen):
    """How a run is computed.

    method : "rk4", fixed-step with bisection, or "exact", by the modes of each regime
    step : float  [s], of rk4; the exact method does not use it
    end_time : float  [s after the load step]
    margin_tolerance : float, a run of the exact method that came nearer than this to another label is undecided
    max_events : int, touches and separations
    """

    method: Literal["rk4", "exact"] = "rk4"
    step: Annotated[Positive, Quantity("time step", "h", "s")] = 1e-4
    end_time: Annotated[Positive, Quantity("end time", "t_end", "s")] = 2.0
    max_events: Annotated[int, Field(ge=1, le=100_000)] = 512
    margin_tolerance: Annotated[float, Field(ge=0, le=0.25)] = 1e-4


class Impacts(_Frozen):
    """How impacts are told apart and measured.

    sticking_time : float or None  [s], a longer contact is sticking; None stands for the contact period
    acceleration_of : int, number from 1 of the inertia whose acceleration gives the severity
    """

    sticking_time: Annotated[Positive | None, Quantity("sticking time", "t_s", "s")] = None
    acceleration_of: Annotated[
        int, Field(ge=1), Quantity("inertia of the severity", "i", "1"), MustBe("an inertia's number or name")
    ]


class Axis(_Frozen):
    """One swept key and the values that it takes, in the key's unit: evenly spaced, or listed.

    parameter : str, dotted key
    start, stop, count, scale : float, float, int, "linear" or "log"; or else
    values : (count,) float
    """

    parameter: Annotated[str, MustBe('a dotted numeric key, for example "load.ratio"')]
    start: float | None = None
    stop: float | None = None
    count: Annotated[int, Field(ge=1, le=LONGEST_AXIS)] | None = None
    scale: Literal["linear", "log"] | None = None
    values: Annotated[tuple[float, ...], Field(min_length=1, max_length=LONGEST_AXIS)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, axis: Any) -> Any:
        if not isinstance(axis, dict) or axis.get("values") is not None or axis.get("start") is None:
            return axis
        filled = {"scale": "linear"} | {key: value for key, value in axis.items() if value is not None}
        if axis.get("count") == 1:
            filled.setdefault("stop", axis["start"])
        return filled

    @property
    def count_of_values(self) -> int:
        """How many values the axis has."""
        if self.values is not None:
            return len(self.values)
        assert self.count is not None
        return self.count

    @property
    def grid(self) -> FloatArray:
        """(count,) float64, the values in order; read-only."""
        return _grid(self)


@functools.lru_cache(maxsize=16)  # not kept in the axis itself, where it would count when two are compared
def _grid(axis: Axis) -> FloatArray:
    if axis.values is not None:
        grid = np.array(axis.values, dtype=np.float64)
    else:
        assert axis.start is not None
        assert axis.stop is not None
        k, last = np.arange(axis.count_of_values), max(axis.count_of_values - 1, 1)
        if axis.scale == "log":
            grid = axis.start * (axis.stop / axis.start) ** (k / last)
        else:  # multiplied before divided: 0 to 10 in 201 values has 0.15 in it, not 0.15000000000000002
            grid = axis.start + (axis.stop - axis.start) * k / last
        # rounding must not carry a value out of a range that allows both ends
        grid = np.clip(grid, min(axis.start, axis.stop), max(axis.start, axis.stop))
        grid[-1] = axis.stop
    grid += 0.0  # no negative zeros, which are equal to positive ones and would share their place
    grid.flags.writeable = False
    return grid


class Draw(_Frozen):
    """A key that is drawn at random: its distribution (see `clunk.study.distributions`), in the key's unit.

    parameter : str, dotted key
    draws : what the number is: the key's value, a factor on its nominal value, or an offset from that
    low, mode, high, mean, std, median, sigma : float or None; a mean or median that is left out is the nominal value
    """

    parameter: Annotated[str, MustBe('a dotted numeric key, for example "lash.contact.stiffness"')]
    distribution: Kind
    draws: Literal["value", "factor", "offset"] = "value"
    low: float | None = None
    mode: float | None = None
    high: float | None = None
    mean: float | None = None
    std: Positive | None = None
    median: Positive | None = None
    sigma: Positive | None = None

    def distributed(self, nominal: float) -> Distribution:
        """The distribution of what is drawn, where the key's nominal value is this."""
        numbers: dict[str, float | None] = {name: getattr(self, name) for name in NUMBERS}
        middle = {"normal": "mean", "lognormal": "median"}.get(self.distribution)
        if middle is not None and numbers[middle] is None:
            numbers[middle] = {"value": nominal, "factor": 1.0, "offset": 0.0}[self.draws]
        return Distribution(self.distribution, **numbers)

    def applied(self, drawn: npt.ArrayLike, nominal: npt.ArrayLike) -> FloatArray:
        """The key's values, from what was drawn and its nominal value."""
        drawn, nominal = np.asarray(drawn, np.float64), np.asarray(nominal, np.float64)
        if self.draws == "factor":
            values = nominal * drawn
        elif self.draws == "offset":
            values = nominal + drawn
        else:
            values = drawn + np.zeros_like(nominal)
        return np.asarray(values, np.float64)


class Sampling(_Frozen):
    """How the drawn keys are drawn, all together.

    method : scrambled Sobol points, best in powers of two, or a Latin hypercube
    count : int, of the sample
    seed : int, the same one gives the same sample
    """

    method: Sampler = "sobol"
    count: Annotated[int, Field(ge=1, le=MOST_DRAWS)] = 256
    seed: Annotated[int, Field(ge=0)] = 0

    def points(self, dimensions: int) -> FloatArray:
        """(count, dimensions) float64 in [0, 1)."""
        return unit_points(self.method, self.count, dimensions, self.seed)


class Sweep(_Frozen):
    """What is run.

    design : the product of the axes, or ("zip") the axes of equal length walked together
    axes : in order
    samples : keys drawn together, a further dimension of the results
    tolerances : keys drawn for every cell, of which a cell gets the outcome's statistics
    sampling : of samples or tolerances
    """

    design: Literal["grid", "zip"] = "grid"
    axes: Annotated[tuple[Axis, ...], Field(min_length=1)] = ()
    samples: Annotated[tuple[Draw, ...], Field(min_length=1)] = ()
    tolerances: Annotated[tuple[Draw, ...], Field(min_length=1)] = ()
    sampling: Sampling = Sampling()


class Study(_Frozen):
    """Everything that decides what a run or a sweep computes.

    Made by `load_study`, `study_from_text` and `replace_values`; built by hand, it is held to the same rules.
    """

    title: Annotated[str, Field(min_length=1)] = "Untitled"
    driveline: DrivelineConfig
    lash: Lash
    load: Load
    solver: Solver = Solver()
    impacts: Impacts
    sweep: Sweep | None = None

    @model_validator(mode="after")
    def _hold_to_rules(self) -> Self:
        document = self.model_dump()
        found = [*findings(document), *sweep_findings(document, schema())] or list(_drawn_findings(self, document))
        if found:
            text = "; ".join(f"{dotted(place)}: {message}" for place, message in found)
            raise PydanticCustomError("clunk_rules", "{text}", {"text": text, "findings": found})
        return self

    def summary(self) -> Rows:
        """What is computed, for people: (name, value) pairs."""
        lash, load, solver = self.lash, self.load, self.solver
        contact = lash.contact
        if contact.model == "restitution":
            model = f"restitution, e = {contact.restitution:g}"
        else:
            model = f"indentation, separation by {contact.separation}"
        swept = {axis.parameter for axis in self.sweep.axes} if self.sweep is not None else set()
        gap = "swept" if "lash.backlash_deg" in swept else f"{lash.backlash_deg:g} degrees"
        torques = []
        for symbol, key in (
            ("Ts", "static_torque"),
            ("σr", "ratio"),
            ("T(0⁻)", "initial_torque"),
            ("T(0⁺)", "final_torque"),
        ):
            value, unit = getattr(load, key), "" if key == "ratio" else " N m"
            if value is not None:
                torques.append(f"{symbol} swept" if f"load.{key}" in swept else f"{symbol} = {value:g}{unit}")
        step = f", step {solver.step:g} s" if solver.method == "rk4" else ""
        rows = [
            ("driveline", f"{len(self.driveline.inertias)} inertias, {len(self.driveline.shafts)} shafts"),
            ("backlash", f"between {lash.between[0]} and {lash.between[1]}: {gap}"),
            ("contact", model),
            ("load", f"{load.profile} on inertia {load.on}: {', '.join(torques)}"),
            ("solver", f"{solver.method}{step}, to {solver.end_time:g} s"),
        ]
        if self.sweep is not None:
            for axis in self.sweep.axes:
                spread = f"{axis.grid[0]:g} to {axis.grid[-1]:g}, {axis.count_of_values} values"
                rows.append(("swept", f"{axis.parameter}: {spread}"))
            for draw in (*self.sweep.samples, *self.sweep.tolerances):
                rows.append(("drawn", f"{draw.parameter}: {draw.distribution}, {self.sweep.sampling.count} draws"))
        return rows

    def __repr__(self) -> str:
        return as_text(f"clunk.Study {self.title!r}", self.summary())

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return as_html(self.title, html_table(self.summary()))


def _drawn_findings(study: Study, document: dict[str, Any]) -> Iterator[tuple[Place, str]]:
    """Whatever is drawn is allowed: the sample is known beforehand, and its least and largest values are looked at."""
    sweep = study.sweep
    if sweep is None or not (sweep.samples or sweep.tolerances):
        return
    table = "samples" if sweep.samples else "tolerances"
    draws = sweep.samples or sweep.tolerances
    points = sweep.sampling.points(len(draws))
    axes = {axis.parameter: axis.grid for axis in sweep.axes}
    for k, draw in enumerate(draws):
        at: Place = ("sweep", table, k)
        place = place_of(draw.parameter, document)
        assert place is not None
        key = key_at(schema(), place)
        assert key is not None
        own = value_at(document, place)
        nominal = axes.get(draw.parameter, np.array([np.nan if own is None else own]))
        drawn = draw.distributed(float(nominal[0])).ppf(points[:, k])  # around a swept value it does not use this
        values = draw.applied(drawn[:, None], np.array([nominal.min(), nominal.max()]))
        for extreme in (values.min(), values.max()):
            value = float(extreme)
            number = int(np.nonzero(values == extreme)[0][0]) + 1 if math.isfinite(value) else 1
            which = f"draw {number} of {len(drawn)} makes {draw.parameter} {value:.6g}"
            if not math.isfinite(value) or not key.allows(value):
                bound = "; bound the distribution with low and high" if draw.distribution != "uniform" else ""
                yield at, f"{which}; it must be {key.must_be}{bound}"
                break
            complaint = next(findings(with_value(document, place, value)), None)
            if complaint is not None:
                yield at, f"{which}; {complaint[1]}"
                break


@functools.cache
def schema() -> dict[Place, Key]:
    """The keys of a config."""
    return schema_of(Study)
