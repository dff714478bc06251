"""Tables of a config as frozen, typed values: the type, range and unit of every key.

The units are the config's (degrees, N/m at a radius); `clunk.simulation` converts them. Inertias are numbered from 1. A
validator here checks one table; the rules that tie tables to one another are in `clunk.study.rules`.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, PlainValidator, ValidationInfo, WithJsonSchema, model_validator

from clunk.study.document import Place, items_of, value_at
from clunk.study.errors import ConfigError, shorten
from clunk.study.loads import Load
from clunk.study.sweeps import Draws, Sweep
from clunk.study.tables import (
    MOST_DRAWS,
    DrawCount,
    Ends,
    Findings,
    Inertia,
    NotEmpty,
    NotNegative,
    NotZero,
    OneOrSeveral,
    Positive,
    Quantity,
    Seed,
    Table,
    Text,
    converted,
    is_number,
    misnamed,
    numbered_inertia,
    position_of,
    refusal,
)

OF_IMPACTS = ("impulse", "peak_torque", "energy")  # quantities of each primary impact
_PARTS = {  # quantity of a measure -> elements of a driveline that have it
    "acceleration": ("inertia",),
    "twist": ("shaft", "lash"),
    "shaft torque": ("shaft",),
    "contact torque": ("lash",),
}
WhichLash = str | int | None  # a lash by name or number from 1; None is the first
_NO_SWEEP = Sweep.model_construct()
NOT_OF_A_RUN = {"sweep", "fit", "optimize"}  # tables that choose runs; no single run depends on them

_Stages = NotEmpty[Annotated[NotNegative, Quantity("stiffness of shaft {0} in stage {1}", "k{0},{1}", "N m/rad")]]


class Shaft(Table):
    """A massless spring and damper between two inertias, or between one and ground.

    Its torque is linear in the twist, or piecewise linear and continuous, with a stiffness for each stage between
    breakpoints and beyond them, and zero at twist 0.

    name : str or None, by which measures may refer to the shaft
    between : its two ends: numbers of inertias from 1, or one and "ground"
    ratio : float, i of a gear: the twist is θ of the first end less i θ of the second
    stiffness : float, or one for each stage  [N m/rad]
    breakpoints_deg : twists between the stages, ascending  [degrees]
    stiffness_per_deg : float or one for each stage, or None; converted into stiffness, which it replaces  [N m/degree]
    damping : float  [N m s/rad]
    friction : float, Coulomb torque against the rate of twist; at most as large while the shaft sticks  [N m]

    A shaft to ground, a bearing, may be given by damping or friction alone: stiffness is then 0, and beside friction
    damping is 0 by default.
    """

    name: Text | None = None
    between: Ends
    ratio: Annotated[NotZero, Quantity("gear ratio of shaft {}", "i{}", "1")] = 1.0
    stiffness: Annotated[
        OneOrSeveral[NotNegative, _Stages],
        Quantity("stiffness of shaft {}", "k{}", "N m/rad"),
    ]
    stiffness_per_deg: Annotated[
        OneOrSeveral[NotNegative, tuple[NotNegative, ...]] | None,
        Field(json_schema_extra={"unit": "N m/degree"}),
    ] = None
    breakpoints_deg: (
        NotEmpty[Annotated[float, Quantity("breakpoint {1} of shaft {0}", "θ{0},{1}", "degrees")]] | None
    ) = None
    damping: Annotated[NotNegative, Quantity("damping of shaft {}", "c{}", "N m s/rad")]
    friction: Annotated[NotNegative, Quantity("friction of shaft {}", "F{}", "N m")] = 0.0

    @model_validator(mode="before")
    @classmethod
    def _convert(cls, shaft: Any) -> Any:
        shaft = converted(shaft, "stiffness_per_deg", "stiffness", math.degrees)
        if not isinstance(shaft, dict) or "ground" not in items_of(shaft.get("between")):
            return shaft
        of_bearing = {"stiffness": 0.0} if shaft.keys() & {"damping", "friction"} else {}
        of_bearing |= {"damping": 0.0} if "friction" in shaft else {}
        return of_bearing | shaft

    def contradictions(self) -> Findings:
        """Require one key for the stiffness, one stage more than breakpoints, and these in ascending order.

        Not all of several stages may have stiffness 0.
        """
        if self.stiffness_per_deg is not None:
            yield (), "stiffness and stiffness_per_deg are given together; give one of the two"
        stages, breakpoints = self.stages, self.breakpoints_deg or ()
        if len(stages) != len(breakpoints) + 1:
            text = f"found {len(stages)} stiffnesses and {len(breakpoints)} breakpoints"
            yield ("stiffness",), f"{text}; there is one stiffness more than there are breakpoints_deg"
        if breakpoints and not any(stages):
            yield ("stiffness",), "found 0 in all stages; without a spring there are none: leave out breakpoints_deg"
        for k, (one, following) in enumerate(pairwise(breakpoints)):
            if following <= one:
                text = f"found {following:g} after {one:g}; breakpoints must be in ascending order"
                yield ("breakpoints_deg", k + 1), text

    @property
    def stages(self) -> tuple[float, ...]:
        """The stiffness of each stage  [N m/rad]; a linear shaft has one stage."""
        stages = self.stiffness
        return stages if isinstance(stages, tuple) else (stages,)


class DrivelineConfig(Table):
    """Inertias, with or without names, and the shafts that join them."""

    inertias: NotEmpty[Annotated[Positive, Quantity("inertia {}", "J{}", "kg m2")]]
    names: Annotated[tuple[Text, ...], Field(description="a list of names, one for each inertia")] | None = None
    shafts: tuple[Shaft, ...] = ()

    def contradictions(self) -> Findings:
        """Require names of all inertias or of none, and names that are distinct, no numbers and not "ground"."""
        count, names = len(self.inertias), self.names
        if names is not None and len(names) != count:
            text = f"found {len(names)} names for {count} inertias; give each its name, or leave names out"
            yield ("names",), text
        yield from ((("names", k), text) for k, text in misnamed(names or (), "inertia"))
        shafts = [shaft.name for shaft in self.shafts]
        yield from ((("shafts", k, "name"), text) for k, text in misnamed(shafts, "shaft"))

    @property
    def all_names(self) -> tuple[str, ...]:
        """The name of each inertia; by default, without names in the config, as ``inertia 1``."""
        return self.names or tuple(f"inertia {k}" for k in range(1, len(self.inertias) + 1))


class Contact(Table):
    """Contact of the flanks: a spring and damper, or impacts of rigid flanks.

    Keys that the model does not use are checked all the same.

    model : "indentation", a spring and damper, or "restitution", impacts of rigid flanks
    stiffness, damping : float or None, at the radius  [N/m, N s/m]; not used by the restitution model
    separation : flanks part when the gap opens ("gap"), or when the contact force would turn tensile ("force")
    restitution : float, speed after an impact over the speed before; not used by the indentation model
    locking_speed : float or None, speed below which a rebound locks  [rad/s]; not used by the indentation model
    """

    model: Literal["indentation", "restitution"] = "indentation"
    stiffness: Annotated[Positive | None, Quantity("contact stiffness", "k", "N/m")] = None
    damping: Annotated[NotNegative | None, Quantity("contact damping", "c", "N s/m")] = None
    separation: Literal["gap", "force"] = "gap"
    restitution: Annotated[float, Field(ge=0, le=1), Quantity("coefficient of restitution", "e", "1")] = 0.5
    locking_speed: Annotated[Positive | None, Quantity("locking speed", "v", "rad/s")] = None

    def contradictions(self) -> Findings:
        """Require stiffness and damping of flanks that indent."""
        for key, unit in (("stiffness", "N/m"), ("damping", "N s/m")):
            if self.model == "indentation" and getattr(self, key) is None:
                yield (key,), f"missing; an indentation contact needs it ({unit})"


class Lash(Table):
    """A lash between two inertias, or between one and ground; its backlash is the whole gap.

    name : str or None, by default made of the lash's number, as in ``lash 1``
    ratio : float, i of a gear: the gap is measured in θ of the first end less i θ of the second
    gap_mm : float or None, the whole gap at the radius  [mm]; converted into backlash_deg, which it replaces
    """

    name: Text | None = None
    between: Ends
    ratio: Annotated[NotZero, Quantity("gear ratio at the lash", "i", "1")] = 1.0
    backlash_deg: Annotated[float, Field(ge=0, le=360), Quantity("backlash", "φθ", "degrees")]
    gap_mm: Annotated[NotNegative | None, Field(json_schema_extra={"unit": "mm"})] = None
    radius: Annotated[Positive, Quantity("radius of the flanks", "r", "m")]
    contact: Contact

    @model_validator(mode="before")
    @classmethod
    def _convert(cls, lash: Any) -> Any:
        number = value_at(lash, ("radius",))
        radius = number if is_number(number) and number > 0.0 else math.inf  # a wrong radius is an error of its own
        return converted(lash, "gap_mm", "backlash_deg", lambda gap: _degrees(gap, radius), 360.0)

    def contradictions(self) -> Findings:
        """Require either backlash_deg or gap_mm, and a gap of at most a turn."""
        if self.gap_mm is None:
            return
        degrees = _degrees(self.gap_mm, self.radius)
        if degrees > 360.0:
            text = f"found {self.gap_mm:g}; at a radius of {self.radius:g} m that is {degrees:g} degrees"
            yield ("gap_mm",), f"{text}, and at most 360 are allowed"
        else:
            yield (), "backlash_deg and gap_mm are given together; give one of the two"


def _degrees(gap_mm: float, radius: float) -> float:
    """Angle  [degrees] of a gap in mm at a radius in m."""
    return math.degrees(gap_mm / (1e3 * radius))


class Solver(Table):
    """Method, step and limits of a run. Keys that the method does not use are checked all the same.

    method : "rk4", fixed-step with bisection of events, or "exact", by the modes of each regime
    step : float, time step of rk4  [s]; not used by the exact method
    end_time : float, end of a run after the load step  [s]
    margin_tolerance : float, a run of the exact method is undecided where the magnitude of its margin is smaller
    max_events : int, most touches and separations of a run; a run with more fails
    """

    method: Literal["rk4", "exact"] = "rk4"
    step: Annotated[Positive, Quantity("time step", "h", "s")] = 1e-4
    end_time: Annotated[Positive, Quantity("end time", "t_end", "s")] = 2.0
    max_events: Annotated[int, Field(ge=1, le=100_000)] = 100_000
    margin_tolerance: Annotated[float, Field(ge=0, le=0.25)] = 1e-4


class Impacts(Table):
    """Sticking time, inertia and quantities by which impacts are classified and measured.

    sticking_time : float or None, a longer contact is sticking  [s]; None stands for the contact period
    acceleration_of : int or None, number from 1 of the inertia whose acceleration gives the severity; None stands for
        the first inertia of each lash
    quantities : that are measured of each primary impact, besides its severity and its closing speed
    """

    sticking_time: Annotated[Positive | None, Quantity("sticking time", "t_s", "s")] = None
    acceleration_of: Annotated[Inertia | None, Quantity("inertia of the severity", "i", "1")] = None
    quantities: tuple[Literal["impulse", "peak_torque", "energy"], ...] = ()


class Part(NamedTuple):
    """An inertia, a shaft or a lash."""

    element: str  # "inertia", "shaft" or "lash"
    number: int  # from 0


def _identifier(name: str) -> str:
    if not (name.isascii() and name.isidentifier() and name[0] != "_"):
        raise refusal(f"found {shorten(name)}; must be a letter, then letters, digits or _, as in shuffle_torque")
    return name


def _numbered_part(value: Any, info: ValidationInfo) -> Any:
    """Validate the part of a measure: a named inertia or shaft becomes its number, other values are returned as given.

    An unknown inertia is refused here; `clunk.study.rules` checks whether shafts and lashes exist.
    """
    if info.data.get("quantity") == "acceleration":
        return numbered_inertia(value, info)
    names = [value_at(shaft, ("name",)) for shaft in items_of(value_at(info.context, ("shafts",)))]
    return names.index(value) + 1 if isinstance(value, str) and value in names else value


class Measure(Table):
    """An extreme of a quantity over a run, from the load step to the end time.

    name : str, name of the variable in results files
    of : int or str, number from 1 or name of an inertia or a shaft, or name of a lash
    reduce : "peak-to-peak", the largest value less the smallest, or "largest", the largest magnitude
    """

    name: Annotated[Text, AfterValidator(_identifier)]
    quantity: Literal["acceleration", "twist", "shaft torque", "contact torque"]
    of: Annotated[
        int | str,
        PlainValidator(_numbered_part),
        WithJsonSchema({"type": ["integer", "string"], "minimum": 1, "description": "a number from 1, or a name"}),
    ]
    reduce: Literal["peak-to-peak", "largest"]


class Fit(Table):
    """Parameters that are fitted to measurements.

    parameters : fitted keys with their priors; a factor or an offset of a measured key acts on its measured values
    candidates : int, most candidates in the search for the best fit
    effective_draws : int, effective size at which the ensemble is large enough
    draws : int, most draws for the ensemble
    seed : int; the same seed gives the same fit
    wrong_labels : float, expected share of measured labels that are wrong or that no parameters could meet
    scatter : float, scale of the distances of labels that are not met: the changes, as shares of the operating point's
        values, that would bring the labels about
    """

    parameters: Draws
    candidates: DrawCount = 3000
    effective_draws: DrawCount = 400
    draws: Annotated[int, Field(ge=64, le=MOST_DRAWS)] = 8192
    seed: Seed = 0
    wrong_labels: Annotated[float, Field(gt=0, lt=1, description="a number above 0 and below 1")] = 0.1
    scatter: Positive = 0.2


class FreeParameter(Table):
    """A number that an optimisation varies from low to high, in its key's unit.

    parameter : dotted key, or several keys that all take the number
    """

    parameter: Annotated[
        OneOrSeveral[Text, NotEmpty[Text]],
        Field(description='a dotted numeric key, or a list of keys that all take the same value, ["load.levels[1]"]'),
    ]
    low: float
    high: float

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that take the number."""
        return self.parameter if isinstance(self.parameter, tuple) else (self.parameter,)

    def contradictions(self) -> Findings:
        """Require low < high."""
        if not self.low < self.high:
            yield ("high",), f"found {self.high:g}; must be greater than low = {self.low:g}"


class Optimize(Table):
    """The values of some keys that minimise a key or a quantity while others hold.

    minimize : one of the parameters' keys, or a quantity of runs, whose worst value over the cells of the axes counts
    subject_to : conditions that must hold in every cell of the axes, such as ``label=NI`` or ``severity<=8000``
    robust : share of the drawn drivelines in which the conditions must hold; needs sweep.tolerances
    seed : int; the same seed gives the same answer
    """

    minimize: Text
    subject_to: tuple[Text, ...] = ()
    robust: Annotated[float | None, Field(gt=0, le=1, description="a number above 0, up to 1")] = None
    seed: Seed = 0
    parameters: NotEmpty[FreeParameter]


class Config(Table):
    """Tables of a config, each sound by itself; of several lashes `lash` is a tuple."""

    title: Annotated[Text, Field(min_length=1)] = "Untitled"
    driveline: DrivelineConfig
    lash: OneOrSeveral[Lash, NotEmpty[Lash]]
    load: Load
    solver: Solver = Solver()
    impacts: Impacts
    measures: tuple[Measure, ...] = ()
    sweep: Sweep | None = None
    fit: Fit | None = None
    optimize: Optimize | None = None

    @property
    def alone(self) -> Self:
        """The config without the tables that choose runs: sweep, fit and optimisation."""
        return self.but(**dict.fromkeys(NOT_OF_A_RUN))

    @property
    def swept(self) -> Sweep:
        """The sweep; where the config has none, a sweep without axes and draws."""
        return self.sweep or _NO_SWEEP

    @property
    def lashes(self) -> tuple[Lash, ...]:
        """The lashes, in order."""
        return self.lash if isinstance(self.lash, tuple) else (self.lash,)

    @property
    def has_rigid_flanks(self) -> bool:
        """Whether touches are impulses of rigid flanks: the restitution model; all lashes have one contact model."""
        return self.lashes[0].contact.model == "restitution"

    @property
    def lash_places(self) -> tuple[Place, ...]:
        """The place of each lash in the config."""
        return tuple(("lash", k) for k in range(len(self.lash))) if isinstance(self.lash, tuple) else (("lash",),)

    @property
    def placed_lashes(self) -> Iterator[tuple[Place, Lash]]:
        """Pairs of place and lash."""
        return zip(self.lash_places, self.lashes, strict=True)

    @property
    def lash_names(self) -> tuple[str, ...]:
        """The name of each lash."""
        return tuple(lash_name(k, lash.name) for k, lash in enumerate(self.lashes))

    @property
    def watched(self) -> tuple[int, ...]:
        """The inertia whose acceleration gives each lash's severity, by number from 1."""
        of_all = self.impacts.acceleration_of
        return tuple(of_all or next(end for end in lash.between if end != "ground") for lash in self.lashes)

    @property
    def measured(self) -> bool:
        """Whether the config asks for quantities besides Q and V: of impacts, or measures."""
        return bool(self.impacts.quantities or self.measures)


def lash_name(position: int, name: str | None) -> str:
    """Name of the lash at a position from 0; by default, without a name in the config, as ``lash 1``."""
    return f"lash {position + 1}" if name is None else name


def lash_position(name: WhichLash, names: Sequence[str]) -> int:
    """Position, from 0, of a lash that is given by name or number from 1; None is the first.

    names : of all lashes, in order

    Raises
    ------
    ConfigError
        Where there is no such lash.
    """
    try:
        number = 1 if name is None else int(name) if str(name).isdecimal() else name
        return position_of(number, len(names), names, "lash")
    except ValueError as error:
        raise ConfigError(f"{error}.") from None


def part_of(measure: Measure, config: Config) -> Part:
    """The inertia, shaft or lash that a measure refers to. Raises ValueError where there is none."""
    elements = _PARTS[measure.quantity]
    names = {
        "inertia": config.driveline.names or (None,) * len(config.driveline.inertias),
        "shaft": [shaft.name for shaft in config.driveline.shafts],
        "lash": config.lash_names,
    }
    parts = [Part(element, k) for element in elements for k in range(len(names[element]))]
    listed = [name for element in elements for name in names[element]]
    return parts[position_of(measure.of, len(names[elements[0]]), listed, " or ".join(elements))]
