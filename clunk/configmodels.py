"""A validated config as frozen values: `Study` and its parts, with the type, range and unit of every key.

The units are the config's (degrees, N/m at a radius); `driveline` converts. Inertias are numbered from 1.
"""

import functools
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from clunk.configfile import Place, dotted
from clunk.configrules import LONGEST_AXIS, Key, MustBe, Quantity, axis_findings, findings, schema_of

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

    @functools.cached_property
    def grid(self) -> FloatArray:
        """(count,) float64, the values in order; read-only."""
        if self.values is not None:
            grid = np.array(self.values, dtype=np.float64)
        else:
            assert self.start is not None
            assert self.stop is not None
            k, last = np.arange(self.count_of_values), max(self.count_of_values - 1, 1)
            if self.scale == "log":
                grid = self.start * (self.stop / self.start) ** (k / last)
            else:  # multiplied before divided: 0 to 10 in 201 values has 0.15 in it, not 0.15000000000000002
                grid = self.start + (self.stop - self.start) * k / last
            # rounding must not carry a value out of a range that allows both ends
            grid = np.clip(grid, min(self.start, self.stop), max(self.start, self.stop))
            grid[-1] = self.stop
        grid.flags.writeable = False
        return grid


class Sweep(_Frozen):
    """The grid of a study: the product of its axes, in order."""

    axes: Annotated[tuple[Axis, ...], Field(min_length=1)]


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
        found = [*findings(document), *axis_findings(document, schema())]
        if found:
            text = "; ".join(f"{dotted(place)}: {message}" for place, message in found)
            raise PydanticCustomError("clunk_rules", "{text}", {"text": text, "findings": found})
        return self


@functools.cache
def schema() -> dict[Place, Key]:
    """The keys of a config."""
    return schema_of(Study)
