"""Rules that tie keys of different tables to one another, for configs whose tables are sound by themselves.

Some hold for each run. They are tried on the config itself, and then at the least and greatest values that its sweep,
draws, fit and optimisation give to keys, one key and two keys at a time.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import chain, combinations, product
from typing import Any, NamedTuple

import numpy as np

from clunk.study.arrays import Floats
from clunk.study.axes import variable_of
from clunk.study.document import Place, dotted, with_value
from clunk.study.errors import listing, shorten
from clunk.study.keys import validated
from clunk.study.loads import PROFILES, TORQUES, Load, uses
from clunk.study.models import NOT_OF_A_RUN, OF_IMPACTS, Config, Part, part_of
from clunk.study.parameters import complaint, located, plain_number
from clunk.study.sweeps import Axis, Draw
from clunk.study.tables import Finding, allowed_inertias, misnamed

# Names in results files, and words for what is drawn or compared, that no measure can have
_TAKEN = {
    *("sequence", "severity", "approach_velocity", "primary_impacts", "touches", "last_event_time", "status"),
    *("quality", "initial_side", "margin", "impact_time", "impact_flank", "impact_closing_speed", "impact_severity"),
    *(*OF_IMPACTS, *(f"impact_{name}" for name in OF_IMPACTS)),
    *("regimes", "label", "double_sided", "chatter", "nominal_label", "run", "impact", "lash"),
}
MOST_STEPS = 1e9  # of one run; about ten seconds of nothing but stepping
MOST_PERIODS = 1e6  # of the load in one run; the exact method takes some steps in each
MOST_REGIMES = 30_000  # of one driveline, which take some 5 s to prepare
WIDEST_SPREAD = 1e12  # of the inertias and of the springs of one driveline: four digits are left where they add up
FASTEST_RATE = 1e12  # 1/s, of stiffness or damping on an inertia; atoms swing ten times faster


def broken_rules(config: Config) -> list[Finding]:
    """Findings of all rules on a config; values of swept and drawn keys are only looked at where nothing is wrong."""
    rules = (_of_a_run, _swept, _fitted, _optimised, _measured)
    return [finding for rule in rules for finding in rule(config)] or list(_reached(config))


def _of_a_run(config: Config) -> Iterator[Finding]:
    """Findings of the rules that each run must keep."""
    for rule in (_inertias, _lashes, _regimes, _steps, _sizes):
        yield from rule(config)


def load_complaint(parameter: str, config: Config) -> str | None:
    """Reason why a key of the load cannot be swept: its profile has none, or its torques are the other two."""
    table, _, key = parameter.partition("[")[0].partition(".")
    if table == "load" and not uses(config.load.profile, key):
        profiles = listing([shorten(profile) for profile in PROFILES if uses(profile, key)], "or")
        return f"{parameter} does not apply: the profile is {shorten(config.load.profile)}, and not {profiles}"
    for pair, other in (TORQUES, TORQUES[::-1]):
        if parameter in {f"load.{key}" for key in pair} and getattr(config.load, other[0]) is not None:
            return (
                f"{parameter} does not apply: the load is given by {listing(other)}; give load.{pair[0]} and "
                f"load.{pair[1]} instead, or sweep one of the former"
            )
    return None


def _unsweepable(parameter: str, config: Config) -> str | None:
    """Reason why a key cannot be swept in this config; None where it can."""
    return complaint(parameter, config.model_dump(exclude=NOT_OF_A_RUN)) or load_complaint(parameter, config)


# --- Inertias, steps, sizes ------------------------------------------------------------------------------------------


def _inertias(config: Config) -> Iterator[Finding]:
    """Require a name for each inertia or for none, and that shafts, lash, load and severity refer to inertias."""
    pairs: list[tuple[Place, tuple[int | str, ...]]] = [
        ((*place, "between"), lash.between) for place, lash in zip(config.lash_places, config.lashes, strict=True)
    ]
    pairs += [(("driveline", "shafts", k, "between"), s.between) for k, s in enumerate(config.driveline.shafts)]
    references: list[tuple[Place, int | str | None, bool]] = [
        ((*place, k), end, True) for place, ends in pairs for k, end in enumerate(ends)
    ]
    references.append((("load", "on"), config.load.on, False))
    references.append((("impacts", "acceleration_of"), config.impacts.acceleration_of, False))
    count, names = len(config.driveline.inertias), config.driveline.names
    if names is not None and len(names) != count:
        text = f"found {len(names)} names for {count} inertias; give each its name, or leave names out"
        yield ("driveline", "names"), text
    for place, number, ground in references:
        if isinstance(number, int) and not 1 <= number <= count:
            allowed = allowed_inertias(count, names or (), ground)
            yield place, f"there is no inertia {shorten(number)}; must be {allowed}"


def _lashes(config: Config) -> Iterator[Finding]:
    """Require lashes whose names differ from each other and from numbers, and that have one contact model."""
    yield from (((*config.lash_places[k], "name"), text) for k, text in misnamed(config.lash_names, "lash"))
    first = config.lashes[0].contact.model
    for place, lash in zip(config.lash_places, config.lashes, strict=True):
        if lash.contact.model != first:
            text = f"found {shorten(lash.contact.model)} beside {shorten(first)} of lash 1"
            yield (*place, "contact", "model"), f"{text}; all lashes of a driveline have one contact model"


def count_of_regimes(config: Config) -> int:
    """Number of combinations of the states of lashes, staged shafts and frictions."""
    return _combinations(config, 3)  # a lash is open or on one of two flanks, a friction sticks or slips either way


def count_of_flows(config: Config) -> int:
    """Number of these that differ in which springs act and which parts move together."""
    return _combinations(config, 2)


def _combinations(config: Config, states: int) -> int:
    shafts = config.driveline.shafts
    joints = len(config.lashes) + sum(shaft.friction > 0.0 for shaft in shafts)
    return int(states**joints) * math.prod(len(shaft.stages) for shaft in shafts)


def _regimes(config: Config) -> Iterator[Finding]:
    """Require no more regimes than can be prepared."""
    regimes = count_of_regimes(config)
    if regimes > MOST_REGIMES:
        text = f"the states of lashes, staged shafts and frictions combine to {regimes:,} regimes"
        yield ("driveline", "shafts"), f"{text}; at most {MOST_REGIMES:,} are allowed"


def _steps(config: Config) -> Iterator[Finding]:
    """Require a run of at least one step and not absurdly many, nor of absurdly many periods of the load."""
    step, end, frequency = config.solver.step, config.solver.end_time, config.load.frequency or 0.0
    if step > end:
        yield ("solver", "step"), f"a step of {step:g} s is longer than the run, end_time = {end:g} s"
    elif end / step > MOST_STEPS:
        text = f"a run of {end:g} s in steps of {step:g} s has {end / step:.2g} of them"
        yield ("solver", "step"), f"{text}; at most {MOST_STEPS:g} are allowed"
    elif end * frequency > MOST_PERIODS:
        text = f"a run of {end:g} s at {frequency:g} Hz has {end * frequency:.2g} periods of the load"
        yield ("load", "frequency"), f"{text}; at most {MOST_PERIODS:g} are allowed"


Size = tuple[float, Place]  # a positive number, and the key that has it


def _sizes(config: Config) -> Iterator[Finding]:
    """Require inertias, springs and dampers that double precision can add to one another."""
    masses: list[Size] = [(mass, ("driveline", "inertias", k)) for k, mass in enumerate(config.driveline.inertias)]
    springs: list[Size] = []
    dampers: list[Size] = []
    for k, shaft in enumerate(config.driveline.shafts):
        at: Place = ("driveline", "shafts", k)
        gear = abs(shaft.ratio), (*at, "ratio")
        stiffness: Place = (*at, "stiffness")
        places = [(*stiffness, n) for n in range(len(shaft.stages))] if len(shaft.stages) > 1 else [stiffness]
        for sizes, joints in (
            (springs, zip(shaft.stages, places, strict=True)),
            (dampers, [(shaft.damping, (*at, "damping"))]),
        ):
            sizes += [size for joint in joints if joint[0] > 0.0 for size in (joint, _levered(joint, gear))]
    for at, lash in zip(config.lash_places, config.lashes, strict=True):
        radius, gear = (lash.radius, (*at, "radius")), (abs(lash.ratio), (*at, "ratio"))
        for sizes, key in ((springs, "stiffness"), (dampers, "damping")):
            if number := getattr(lash.contact, key):
                contact = _levered((number, (*at, "contact", key)), radius)
                sizes += [contact, _levered(contact, gear)]
    for sizes, unit in ((masses, "kg m2"), (springs, "N m/rad")):
        (smallest, at_smallest), (largest, at_largest) = min(sizes, default=(1.0, ())), max(sizes, default=(1.0, ()))
        if largest > WIDEST_SPREAD * smallest:
            yield (
                at_largest,
                f"{largest:g} {unit} here and {smallest:g} {unit} at {dotted(at_smallest)} are more than a factor of "
                f"{WIDEST_SPREAD:g} apart; the smaller one is lost in rounding",
            )
            return
    lightest, at_lightest = min(masses)
    for sizes, power, unit in ((springs, 0.5, "N m/rad"), (dampers, 1.0, "N m s/rad")):
        largest, at_largest = max(sizes, default=(0.0, ()))
        rate = (largest / lightest) ** power
        if rate > FASTEST_RATE:
            text = f"{largest:g} {unit} on the {lightest:g} kg m2 of {dotted(at_lightest)} is a rate of {rate:.2g} 1/s"
            yield at_largest, f"{text}; at most {FASTEST_RATE:g} 1/s is allowed"


def _levered(joint: Size, lever: Size) -> Size:
    """A radius or a gear ratio, squared, times a stiffness or damping, at the place of whichever is further from 1."""
    (size, at), (length, at_lever) = joint, lever
    return length**2 * size, at if abs(math.log(size)) > abs(2.0 * math.log(length)) else at_lever


# --- Measures --------------------------------------------------------------------------------------------------------


def _is_impulsive(part: Part, config: Config) -> bool:
    """Whether a part is at a lash whose touches are impulses."""
    rigid = [lash for lash in config.lashes if lash.contact.model == "restitution"]
    if part.element == "inertia":
        return any(part.number + 1 in lash.between for lash in rigid)
    return part.element == "lash" and bool(rigid)


def _measured(config: Config) -> Iterator[Finding]:
    """Require names that differ, and parts that there are; and no acceleration that an impulse makes infinite."""
    names = [measure.name for measure in config.measures]
    taken = _TAKEN | {variable_of(axis.parameter) for axis in (config.sweep.axes if config.sweep is not None else ())}
    for k, measure in enumerate(config.measures):
        place: Place = ("measures", k)
        if measure.name in names[:k]:
            yield (*place, "name"), f"measure {names.index(measure.name) + 1} has the name {shorten(measure.name)} too"
        if measure.name in taken or measure.name.startswith(("boundary", "junction", "region", "ring")):
            yield (*place, "name"), f"results files have another variable {shorten(measure.name)}; choose another name"
        part = part_of(measure, config)
        if isinstance(part, str):
            yield (*place, "of"), part
        elif _is_impulsive(part, config) and measure.quantity != "twist":
            text = f"under the restitution model a touch makes the {measure.quantity} infinite"
            yield (*place, "quantity"), f"{text}; twists and shaft torques stay finite"


# --- Swept and drawn keys --------------------------------------------------------------------------------------------


def _swept(config: Config) -> Iterator[Finding]:
    """Require that a swept or drawn key is a parameter, in one place only."""
    if config.sweep is None:
        return
    swept: dict[str, Place] = {}
    drawn: dict[str, Place] = {}
    for name, taken, verb in (("axes", swept, "swept"), ("samples", drawn, "drawn"), ("tolerances", drawn, "drawn")):
        entries = getattr(config.sweep, name)
        for k, entry in enumerate(entries):
            at: Place = ("sweep", name, k)
            parameter = entry.parameter
            text = _unsweepable(parameter, config)
            if text is None and name != "axes":
                text = _undrawable(entry, name, swept, config)
            before = [each for each in entries[:k] if each.parameter == parameter]
            if text is None and parameter in taken and not (name == "tolerances" and _go_together(*before, entry)):
                text = f"{parameter} is {verb} by {dotted(taken[parameter])} already"
            if text is not None:
                yield (*at, "parameter"), text
            else:
                taken[parameter] = at


def _go_together(*draws: Draw) -> bool:
    """Whether tolerances of one key are a factor and an offset, one applied after the other."""
    return sorted(each.draws for each in draws) == ["factor", "offset"]


def _undrawable(draw: Draw, table: str, swept: Mapping[str, Place], config: Config) -> str | None:
    parameter = draw.parameter
    _, key, value = located(config, parameter)
    if key.whole:
        return f"{parameter} is an inertia's number, which cannot be drawn"
    if parameter in swept and table == "samples":
        return f"{parameter} is swept by {dotted(swept[parameter])} already"
    if parameter in swept and draw.draws == "value":
        return f'{parameter} is swept: its tolerance must be around the swept value; set draws = "factor" or "offset"'
    needs_nominal = draw.draws != "value" or any(map(math.isnan, draw.numbers(math.nan).values()))
    if parameter not in swept and math.isnan(value) and needs_nominal:
        return f"{parameter} has no value in this config that its distribution could be around"
    return None


def _fitted(config: Config) -> Iterator[Finding]:
    """Require fitted parameters that can be drawn."""
    for k, prior in enumerate(config.fit.parameters if config.fit is not None else ()):
        text = _unsweepable(prior.parameter, config) or _undrawable(prior, "fit", {}, config)
        if text is not None:
            yield ("fit", "parameters", k, "parameter"), text


def _optimised(config: Config) -> Iterator[Finding]:
    """Require free parameters that can be swept and are no whole numbers; robustness with tolerances only."""
    optimize = config.optimize
    for k, free in enumerate(optimize.parameters if optimize is not None else ()):
        for parameter in free.keys:
            text = _unsweepable(parameter, config)
            if text is None and located(config, parameter)[1].whole:
                text = f"{parameter} is an inertia's number, which cannot be searched"
            if text is not None:
                yield ("optimize", "parameters", k, "parameter"), text
    if optimize is not None and optimize.robust is not None and not (config.sweep and config.sweep.tolerances):
        yield ("optimize", "robust"), "a share of drawn drivelines needs [[sweep.tolerances]], and there are none"


# --- Values of swept, drawn, fitted and free keys ---------------------------------------------------------------------


class Reach(NamedTuple):
    """A value that a key has in some runs.

    at : place in the config of what gives it this value
    words : for people, what gives it this value
    """

    value: float
    at: Place
    words: str


Case = Mapping[str, Reach]  # by parameter


def _reached(config: Config) -> Iterator[Finding]:
    """Require the rules of a run where swept, drawn, fitted and free keys have their least and greatest values.

    Of swept and drawn keys every two have theirs together, too.
    """
    document = config.model_dump(exclude=NOT_OF_A_RUN)
    together = [*_axes(config), *_draws(config)]
    pairs = (one | other for first, second in combinations(together, 2) for one, other in product(first, second))
    refused: set[Place] = set()
    for case in chain(*together, _priors(config), _bounds(config), pairs):
        places = {reach.at[:3] for reach in case.values()}
        if refused.isdisjoint(places) and (finding := _broken_at(case, config, document)) is not None:
            refused.add(finding[0][:3])
            yield finding


def _broken_at(case: Case, config: Config, document: Mapping[str, Any]) -> Finding | None:
    """The first rule that a run breaks in which some keys have other values."""
    keys = {parameter: located(config, parameter) for parameter in case}
    for parameter, (place, key, _) in keys.items():
        document = with_value(document, place, plain_number(key, case[parameter].value))
    run, findings = validated(Config, document)
    broken, text = next(iter(findings if run is None else _of_a_run(run)), (None, ""))
    if broken is None:
        return None
    reach = next((case[parameter] for parameter, (place, *_) in keys.items() if place == broken), [*case.values()][-1])
    return reach.at, f"{' and '.join(dict.fromkeys(each.words for each in case.values()))}: {text}"


def _axes(config: Config) -> Iterator[list[dict[str, Reach]]]:
    """The least and greatest values of each axis; of axes that are walked together, those of all."""
    axes = [*enumerate(config.sweep.axes)] if config.sweep is not None else []
    for group in [axes] if config.sweep is not None and config.sweep.design == "zip" else [[each] for each in axes]:
        positions = [
            position for _, axis in group for position in _extremes(axis.grid, located(config, axis.parameter)[1].whole)
        ]
        for (_, one), (_, other) in combinations(group, 2):  # two times may not change places
            positions += _extremes(one.grid - other.grid)
        yield [
            {axis.parameter: _on_axis(axis, k, position) for k, axis in group} for position in dict.fromkeys(positions)
        ]


def _extremes(values: Floats, whole: bool = False) -> list[int]:
    """Positions of the least and the greatest value, of that nearest to zero, and of one that is no whole number."""
    fraction = [int((values % 1.0 != 0.0).argmax())] if whole else []
    return [int(values.argmin()), int(values.argmax()), int(np.abs(values).argmin()), *fraction]


def _on_axis(axis: Axis, number: int, position: int) -> Reach:
    """The value at a position of an axis."""
    end = {0: ("start",), axis.count_of_values - 1: ("stop",)}.get(position, ())
    where: Place = ("values", position) if axis.values is not None else end
    return Reach(float(axis.grid[position]), ("sweep", "axes", number, *where), axis.parameter)


def _draws(config: Config) -> Iterator[list[dict[str, Reach]]]:
    """The least and greatest values of each drawn key; the sample is known beforehand."""
    sweep = config.sweep
    if sweep is None or not (sweep.samples or sweep.tolerances):
        return
    table, draws = ("samples", sweep.samples) if sweep.samples else ("tolerances", sweep.tolerances)
    points = sweep.sampling.points(len(draws))
    reached = {axis.parameter: axis.grid for axis in sweep.axes}
    for k, draw in enumerate(draws):
        parameter = draw.parameter
        before = reached.get(parameter, np.array([located(config, parameter)[2]]))
        drawn = draw.sample(points[:, k], float(before.flat[0]))  # around a swept value it does not use this
        values = reached[parameter] = draw.applied(drawn[:, None], np.array([before.min(), before.max()]))
        if any(each.parameter == parameter for each in draws[k + 1 :]):
            continue
        reaches = []
        for position in dict.fromkeys(_extremes(values.ravel())):
            value = float(values.flat[position])
            words = f"draw {position // 2 + 1} of {len(drawn)} makes {parameter} {value:.6g}"
            reaches.append({parameter: Reach(value, ("sweep", table, k), f"{words} (low and high bound it)")})
        yield reaches


def _priors(config: Config) -> Iterator[dict[str, Reach]]:
    """The least and greatest values that a fit allows.

    A measured key's factor or offset acts on measured values, which are not known here.
    """
    for k, prior in enumerate(config.fit.parameters if config.fit is not None else ()):
        nominal = located(config, prior.parameter)[2]
        for value in map(float, prior.applied(prior.quantiles([0.0, 1.0], nominal), nominal)):
            if not math.isnan(nominal):
                words = f"it allows {prior.parameter} = {value:.6g}"
                yield {prior.parameter: Reach(value, ("fit", "parameters", k), words)}


def _bounds(config: Config) -> Iterator[dict[str, Reach]]:
    """The least and greatest values of an optimisation's parameters."""
    for k, free in enumerate(config.optimize.parameters if config.optimize is not None else ()):
        for name, value in (("low", free.low), ("high", free.high)):
            at: Place = ("optimize", "parameters", k, name)
            yield {key: Reach(value, at, key) for key in free.keys}


# --- Numbers that cannot be meant ------------------------------------------------------------------------------------


LARGEST_RADIUS = 10.0  # m; the gears of mills and radio telescopes have some meters
DEEPEST = 6.28  # rad, a whole turn, of flanks pressed together by the load: of gears it is some 1e-3
LEAST_CHANGE = 0.05  # of the change of a load, that a run should see


def doubts(config: Config, given: Collection[str]) -> Iterator[str]:
    """Sentences on what is odd in a config; given : keys of its load that a user has given, by name."""
    swept = {axis.parameter for axis in (config.sweep.axes if config.sweep is not None else ())}
    for place, lash in zip(config.lash_places, config.lashes, strict=True):
        radius = dotted((*place, "radius"))
        if lash.radius > LARGEST_RADIUS:
            yield f"{radius} = {lash.radius:g} m; it is in meters, and {lash.radius / 1e3:g} if that was in mm"
        stiffness, torque = lash.contact.stiffness, _largest_torque(config.load)
        key = dotted((*place, "contact", "stiffness"))
        if lash.contact.model == "restitution" or stiffness is None or {key, radius} & swept:
            continue
        if (overlap := torque / (lash.radius**2 * stiffness)) > DEEPEST:
            yield (
                f"{key} = {stiffness:g} N/m at a radius of {lash.radius:g} m: {torque:g} N m press the flanks "
                f"{overlap:,.3g} rad into each other; gears have 1e7 to 1e9 N/m"
            )
    load = config.load
    for key in sorted(given):
        users = [shorten(name) for name in PROFILES if uses(name, key)]
        is_default = getattr(load, key) == Load.model_fields[key].default  # as of a resolved config
        if users and not uses(load.profile, key) and not is_default:
            others = listing(users, "or")
            yield f"load.{key} is given, but a load of profile {shorten(load.profile)} has none; {others} would use it"
    times = {"load.duration", "load.time_constant", "load.times", "solver.end_time"}
    if not times & {key.partition("[")[0] for key in swept}:
        share = _share_of_change(load, config.solver.end_time)
        if share < LEAST_CHANGE:
            yield (
                f"only {100.0 * share:.2g} % of the change of the load come before solver.end_time = "
                f"{config.solver.end_time:g} s; times are in seconds"
            )


def _largest_torque(load: Load) -> float:
    """The larger of the torques before and after, or the largest of a table  [N m]."""
    if load.profile == "table":
        return abs(load.scale) * max(map(abs, load.torques or (0.0,)))
    if load.ratio is not None and load.static_torque is not None:
        return abs(load.static_torque) * max(1.0, abs(1.0 + load.ratio))
    return max(abs(load.initial_torque or 0.0), abs(load.final_torque or 0.0))


def _share_of_change(load: Load, end_time: float) -> float:
    """The share of a load's change from its first torque that comes before the end; 1 where that cannot be said."""
    if load.profile in ("ramp", "smooth") and load.duration:
        return min(1.0, end_time / load.duration)
    if load.profile == "lag" and load.time_constant:
        return -math.expm1(-end_time / load.time_constant)
    if load.profile != "table" or not load.torques or not load.times:
        return 1.0
    changes = [abs(torque - load.torques[0]) for torque in load.torques]
    within = [change for time, change in zip(load.times, changes, strict=True) if time <= end_time]
    within.append(float(np.interp(end_time, load.times, changes)))
    return max(within) / max(changes) if any(changes) else 1.0
