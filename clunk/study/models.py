"""Tables of a config as frozen, typed values: the type, range and unit of every key.

The units are the config's (degrees, N/m at a radius); `clunk.simulation` converts. Inertias are numbered from 1. A
validator here looks at one table; the rules that tie tables to one another are in `clunk.study.rules`.
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

OF_IMPACTS = ("impulse", "peak_torque", "energy")  # of each primary impact
_PARTS = {  # of a driveline, that a quantity can be of
    "acceleration": ("inertia",),
    "twist": ("shaft", "lash"),
    "shaft torque": ("shaft",),
    "contact torque": ("lash",),
}
WhichLash = str | int | None  # of several, by name or number from 1; None is the first
_NO_SWEEP = Sweep.model_construct()
NOT_OF_A_RUN = {"sweep", "fit", "optimize"}  # tables that say which runs there are, and nothing of one

_Stages = NotEmpty[Annotated[NotNegative, Quantity("stiffness of shaft {0} in stage {1}", "k{0},{1}", "N m/rad")]]


class Shaft(Table):
    """A massless spring and damper between two inertias, or between one and ground.

    Its torque is linear in the twist, or piecewise linear and continuous, with a stiffness for each stage between
    breakpoints and beyond them, and zero at twist 0.

    name : str or None, by which measures may refer to it
    between : two of an inertia's number from 1 and "ground"
    ratio : float, i of a gear: the twist is θ of the first end less i θ of the second
    stiffness : float, or one for each stage
    breakpoints_deg : twists between the stages, ascending
    stiffness_per_deg : float or None, instead of stiffness, which it becomes
    friction : float, Coulomb torque against the rate of twist, and anything up to that while it sticks

    A bearing, a shaft to ground, has damping or friction alone where nothing else is given.
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
        """The stiffness is given once."""
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
        """The stiffness of each stage; of a linear shaft, its only one."""
        stages = self.stiffness
        return stages if isinstance(stages, tuple) else (stages,)


class DrivelineConfig(Table):
    """Inertias, with or without names, and the shafts that join them."""

    inertias: NotEmpty[Annotated[Positive, Quantity("inertia {}", "J{}", "kg m2")]]
    names: Annotated[tuple[Text, ...], Field(description="a list of names, one for each inertia")] | None = None
    shafts: tuple[Shaft, ...] = ()

    def contradictions(self) -> Findings:
        """Require a name for each inertia or for none, which differ from each other, from numbers and from ground."""
        count, names = len(self.inertias), self.names
        if names is not None and len(names) != count:
            text = f"found {len(names)} names for {count} inertias; give each its name, or leave names out"
            yield ("names",), text
        yield from ((("names", k), text) for k, text in misnamed(names or (), "inertia"))
        shafts = [shaft.name for shaft in self.shafts]
        yield from ((("shafts", k, "name"), text) for k, text in misnamed(shafts, "shaft"))


class Contact(Table):
    """Contact of the flanks: a spring and damper, or impacts of rigid flanks.

    Keys that the model does not use are checked all the same.

    stiffness, damping : float or None, at the radius; the restitution model does not use them
    separation : the flanks part when the gap opens, or when the contact force would turn tensile
    restitution : float, speed after an impact over the speed before; the indentation model does not use it
    locking_speed : float or None, a slower rebound locks; the indentation model does not use it
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
    """The backlash, which is the whole gap, between two inertias or between one and ground.

    name : str or None, of one of several lashes; by default its number, as in ``lash 1``
    ratio : float, i of a gear: the gap is measured in θ of the first end less i θ of the second
    gap_mm : float or None, the whole gap at the radius, instead of backlash_deg, which it becomes
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
        radius = number if is_number(number) and number > 0.0 else math.inf  # else it has an error of its own
        return converted(lash, "gap_mm", "backlash_deg", lambda gap: _degrees(gap, radius), 360.0)

    def contradictions(self) -> Findings:
        """The gap is given once, and is no more than a turn."""
        if self.gap_mm is None:
            return
        degrees = _degrees(self.gap_mm, self.radius)
        if degrees > 360.0:
            text = f"found {self.gap_mm:g}; at a radius of {self.radius:g} m that is {degrees:g} degrees"
            yield ("gap_mm",), f"{text}, and at most 360 are allowed"
        else:
            yield (), "backlash_deg and gap_mm are given together; give one of the two"


def _degrees(gap_mm: float, radius: float) -> float:
    """Angle of a gap in mm at a radius in m."""
    return math.degrees(gap_mm / (1e3 * radius))


class Solver(Table):
    """Method, step and limits of a run. Keys that the method does not use are checked all the same.

    method : "rk4", fixed-step with bisection, or "exact", by the modes of each regime
    step : float, of rk4; the exact method does not use it
    end_time : float, after the load step
    margin_tolerance : float, a run of the exact method that came nearer than this to another label is undecided
    max_events : int, touches and separations of a run; one with more has failed
    """

    method: Literal["rk4", "exact"] = "rk4"
    step: Annotated[Positive, Quantity("time step", "h", "s")] = 1e-4
    end_time: Annotated[Positive, Quantity("end time", "t_end", "s")] = 2.0
    max_events: Annotated[int, Field(ge=1, le=100_000)] = 100_000
    margin_tolerance: Annotated[float, Field(ge=0, le=0.25)] = 1e-4


class Impacts(Table):
    """Sticking time, inertia and quantities by which impacts are told apart and measured.

    sticking_time : float or None, a longer contact is sticking; None stands for the contact period
    acceleration_of : int or None, number from 1 of the inertia whose acceleration gives the severity; None stands for
        the first inertia of each lash
    quantities : of each primary impact, besides its severity and its closing speed
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
    """Number of an inertia or a shaft that is given by its name; else the value, which a rule of the config judges."""
    if info.data.get("quantity") == "acceleration":
        return numbered_inertia(value, info)
    names = [value_at(shaft, ("name",)) for shaft in items_of(value_at(info.context, ("shafts",)))]
    return names.index(value) + 1 if isinstance(value, str) and value in names else value


class Measure(Table):
    """An extreme of a quantity over a run, from the load step to the end time.

    name : str, of the variable in results files
    of : int or str, number from 1 or name of an inertia or a shaft, or name of a lash
    reduce : the largest value less the smallest, or the largest magnitude
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

    parameters : with their priors; a factor or an offset of a measured key acts on its measured values
    candidates : int, the most of the search for the best fit
    effective_draws : int, effective size that the ensemble is to have
    draws : int, the most of the ensemble
    seed : int, the same one gives the same fit
    wrong_labels : float, expected share of measured labels that are wrong or that no parameters could meet
    scatter : float, scale of the distance, as a share of the operating point's values, of labels that are not met
    """

    parameters: Draws
    candidates: DrawCount = 3000
    effective_draws: DrawCount = 400
    draws: Annotated[int, Field(ge=64, le=MOST_DRAWS)] = 8192
    seed: Seed = 0
    wrong_labels: Annotated[float, Field(gt=0, lt=1, description="a number above 0 and below 1")] = 0.1
    scatter: Positive = 0.2


class FreeParameter(Table):
    """A number that is searched from low to high, in its key's unit.

    parameter : dotted key, or several keys that all take the number
    """

    parameter: Annotated[
        OneOrSeveral[Text, NotEmpty[Text]],
        Field(description='a dotted numeric key, or a list of keys that take one value, ["load.levels[1]"]'),
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

    minimize : one of the parameters' keys, or a quantity of runs: over axes its worst value
    subject_to : quantities that must hold, such as ``label=NI`` or ``severity<=8000``, in every cell of the axes
    robust : share of the drawn drivelines in which they hold; with sweep.tolerances only
    seed : int, the same one gives the same answer
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
        """The config of one run, without the tables that say which runs there are."""
        return self.but(**dict.fromkeys(NOT_OF_A_RUN))

    @property
    def swept(self) -> Sweep:
        """The sweep; one without axes and draws where the config has none."""
        return self.sweep or _NO_SWEEP

    @property
    def lashes(self) -> tuple[Lash, ...]:
        """The lashes, in order."""
        return self.lash if isinstance(self.lash, tuple) else (self.lash,)

    @property
    def has_rigid_flanks(self) -> bool:
        """Whether touches are impulses, by the restitution model, which then all lashes have."""
        return self.lashes[0].contact.model == "restitution"

    @property
    def lash_places(self) -> tuple[Place, ...]:
        """The place of each lash in the config."""
        return tuple(("lash", k) for k in range(len(self.lash))) if isinstance(self.lash, tuple) else (("lash",),)

    @property
    def placed_lashes(self) -> Iterator[tuple[Place, Lash]]:
        """Each lash behind its place."""
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
        """Whether runs are measured by more than Q and V."""
        return bool(self.impacts.quantities or self.measures)


def lash_name(position: int, name: str | None) -> str:
    """Name of the lash at a position in its config, which may leave it out."""
    return name or f"lash {position + 1}"


def lash_position(name: WhichLash, names: Sequence[str]) -> int:
    """Position of the lash of a name or number from 1 among those with these names; of None, the first.

    Raises
    ------
    ConfigError
        Where there is none.
    """
    try:
        number = 1 if name is None else int(name) if str(name).isdecimal() else name
        return position_of(number, len(names), names, "lash")
    except ValueError as error:
        raise ConfigError(f"{error}.") from None


def part_of(measure: Measure, config: Config) -> Part:
    """The part of the driveline that a measure is of. Raises ValueError, with what is wrong, where there is none."""
    elements = _PARTS[measure.quantity]
    names = {
        "inertia": config.driveline.names or (None,) * len(config.driveline.inertias),
        "shaft": [shaft.name for shaft in config.driveline.shafts],
        "lash": config.lash_names,
    }
    parts = [Part(element, k) for element in elements for k in range(len(names[element]))]
    listed = [name for element in elements for name in names[element]]
    return parts[position_of(measure.of, len(names[elements[0]]), listed, " or ".join(elements))]
