"""Rules that tie keys of different tables to one another, for configs whose tables are sound by themselves.

Some hold for each run. They are tried on the config itself, and then at the least and greatest values that its sweep,
draws, fit and optimisation give to keys, one key and two keys at a time.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import chain, combinations, pairwise, product
from typing import Any, NamedTuple

import numpy as np

from clunk.study.arrays import Floats
from clunk.study.axes import parameters_of, variable_of
from clunk.study.document import Place, dotted, items_of, value_at
from clunk.study.errors import ConfigError, listing, shorten
from clunk.study.keys import validated
from clunk.study.loads import PROFILES, TORQUES, Load, uses
from clunk.study.models import OF_IMPACTS, Config, FreeParameter, part_of
from clunk.study.parameters import drawn_numbers, located, nominal_value, with_values
from clunk.study.sweeps import Draw
from clunk.study.tables import Finding, Findings, Table, misnamed

# Names in results files and of quantities, all of results/quantities.csv among them, that no measure can have
_TAKEN = {
    *("sequence", "severity", "approach_velocity", "primary_impacts", "touches", "last_event_time", "status"),
    *("quality", "initial_side", "margin", "impact_time", "impact_flank", "impact_closing_speed", "impact_severity"),
    *(*OF_IMPACTS, *(f"impact_{name}" for name in OF_IMPACTS)),
    *("regimes", "label", "double_sided", "single_sided", "opposite_sided", "crossed", "chatter", "nominal_label"),
    *("double_sided_impacts", "run", "impact", "lash"),
}
_OF_BOUNDARIES = "boundary", "junction", "region", "ring", "unresolved"  # with these begin those of traced lines
# Tables of what is swept, drawn, fitted and free, with how they are told
_VARIED: dict[tuple[str, str], str] = {
    ("sweep", "axes"): "swept by",
    ("sweep", "samples"): "drawn by",
    ("sweep", "tolerances"): "drawn by",
    ("fit", "parameters"): "fitted by",
    ("optimize", "parameters"): "free as",
}
MOST_STEPS = 1e9  # of one run; about ten seconds of nothing but stepping
MOST_PERIODS = 1e6  # of the load in one run; the exact method takes some steps in each
MOST_REGIMES = 30_000  # of one driveline, which take some 5 s to prepare
# Of one driveline: four digits of an inertia, and six of a spring, are left where they add up. Soft modes have none
# beside springs that are a hundred times as stiff as that.
WIDEST_OF_INERTIAS, WIDEST_OF_SPRINGS = 1e12, 1e10
FASTEST_RATE = 1e12  # 1/s, of stiffness or damping on an inertia; atoms swing ten times faster


def broken_rules(config: Config) -> list[Finding]:
    """Findings of all rules on a config; values of swept and drawn keys are only looked at where nothing is wrong."""
    return [*_of_a_run(config), *_varied(config), *_measured(config)] or [*_reached(config)]


def _of_a_run(config: Config) -> Findings:
    """Findings of the rules that each run must keep."""
    for rule in (_lashes, _limits, _sizes):
        yield from rule(config)


def complaint(parameter: str, config: Config) -> str | None:
    """Reason why a key cannot be swept; None where it can. Of the load, its profile must have it, in these torques."""
    try:
        located(config, parameter)
    except ConfigError as error:
        return str(error)
    table, _, key = parameter.partition("[")[0].partition(".")
    if table == "load" and not uses(config.load.profile, key):
        return f"{parameter} does not apply: the profile is {shorten(config.load.profile)}, and not {_users(key)}"
    for pair, other in (TORQUES, TORQUES[::-1]):
        if table == "load" and key in pair and getattr(config.load, other[0]) is not None:
            return f"{parameter} does not apply: the load is given by {listing(other)}, and not by {listing(pair)}"
    return None


def _users(key: str) -> str:
    """The load profiles that use a key, with an "or"; empty where none does."""
    return listing([shorten(profile) for profile in PROFILES if uses(profile, key)], "or")


# --- Lashes, limits, sizes --------------------------------------------------------------------------------------------


def _lashes(config: Config) -> Findings:
    """Require lashes whose names differ from each other and from numbers, and that have one contact model."""
    yield from (((*config.lash_places[k], "name"), text) for k, text in misnamed(config.lash_names, "lash"))
    first = config.lashes[0].contact.model
    for place, lash in config.placed_lashes:
        if lash.contact.model != first:
            text = f"found {shorten(lash.contact.model)} beside {shorten(first)} of lash 1"
            yield (*place, "contact", "model"), f"{text}; all lashes of a driveline have one contact model"


def count_of_regimes(config: Config) -> int:
    """Number of combinations of the states of lashes, staged shafts and frictions."""
    states = 1
    for contact in (lash.contact for lash in config.lashes):  # open or on a flank, which by force may overlap unpressed
        states *= 5 if contact.model == "indentation" and contact.separation == "force" else 3
    return states * 3 ** _frictions(config) * _stages(config)  # a friction sticks or slips either way


def count_of_flows(config: Config) -> int:
    """Number of these that differ in which springs act and which parts move together."""
    return 2 ** (len(config.lashes) + _frictions(config)) * _stages(config)


def _frictions(config: Config) -> int:
    return sum(shaft.friction > 0.0 for shaft in config.driveline.shafts)


def _stages(config: Config) -> int:
    return math.prod(len(shaft.stages) for shaft in config.driveline.shafts)


def _limits(config: Config) -> Findings:
    """Require a run of at least one step by rk4, and no more steps, periods of the load and regimes than can be run."""
    end, frequency = config.solver.end_time, config.load.frequency or 0.0
    step = config.solver.step if config.solver.method == "rk4" else end  # exact takes none
    limits = (
        (step, end, ("solver", "step"), "a step of {:g} s is longer than the run, end_time = {:g} s"),
        (end / step, MOST_STEPS, ("solver", "step"), "a run has {:.2g} steps; at most {:g} are allowed"),
        (end * frequency, MOST_PERIODS, ("load", "frequency"), "a run has {:.2g} periods of the load; at most {:g}"),
        (count_of_regimes(config), MOST_REGIMES, ("driveline",), "the states of lashes, staged shafts and "
         "frictions combine to {:,} regimes; at most {:,} are allowed"),
    )  # fmt: skip
    yield from ((place, text.format(value, most)) for value, most, place, text in limits if value > most)


def _sizes(config: Config) -> Findings:
    """Require inertias, springs and dampers that double precision can add to one another."""
    masses = [(mass, ("driveline", "inertias", k)) for k, mass in enumerate(config.driveline.inertias)]
    springs = []
    dampers = []
    for k, shaft in enumerate(config.driveline.shafts):
        at: Place = ("driveline", "shafts", k)
        for lever in (1.0, shaft.ratio**2):
            springs += [(lever * stiffness, (*at, "stiffness")) for stiffness in shaft.stages]
            dampers.append((lever * shaft.damping, (*at, "damping")))
    for at, lash in config.placed_lashes:
        for lever in (lash.radius**2, (lash.radius * lash.ratio) ** 2):
            springs.append((lever * (lash.contact.stiffness or 0.0), (*at, "contact", "stiffness")))
            dampers.append((lever * (lash.contact.damping or 0.0), (*at, "contact", "damping")))
    stiff = [spring for spring in springs if spring[0] > 0.0]
    both = (masses, "kg m2", WIDEST_OF_INERTIAS), (stiff or masses[:1], "N m/rad", WIDEST_OF_SPRINGS)
    for sizes, unit, widest in both:
        (smallest, at_smallest), (largest, at_largest) = min(sizes), max(sizes)
        if largest > widest * smallest:
            text = f"{largest:g} {unit} here (with ratio and radius) and {smallest:g} {unit} at {dotted(at_smallest)}"
            text += f" are more than a factor of {widest:g} apart; the smaller is lost in rounding"
            yield at_largest, text
            return
    lightest, at_lightest = min(masses)
    for sizes, power, unit in ((springs, 0.5, "N m/rad"), (dampers, 1.0, "N m s/rad")):
        largest, at_largest = max(sizes)
        rate = (largest / lightest) ** power
        if rate > FASTEST_RATE:
            text = f"{largest:g} {unit} on the {lightest:g} kg m2 of {dotted(at_lightest)} is a rate of {rate:.2g} 1/s"
            yield at_largest, f"{text}; at most {FASTEST_RATE:g} 1/s is allowed"


# --- Measures --------------------------------------------------------------------------------------------------------


def _measured(config: Config) -> Findings:
    """Require names that differ, and parts that there are; and no acceleration that an impulse makes infinite."""
    names = [measure.name for measure in config.measures]
    taken = _TAKEN | {variable_of(axis.parameter) for axis in config.swept.axes}
    for k, measure in enumerate(config.measures):
        place = ("measures", k)
        if measure.name in names[:k]:
            yield (*place, "name"), f"measure {names.index(measure.name) + 1} has the name {shorten(measure.name)} too"
        if measure.name in taken:
            yield (*place, "name"), f"results files have another variable {shorten(measure.name)}; choose another name"
        if measure.name.startswith(_OF_BOUNDARIES):
            text = f"found {shorten(measure.name)}; {listing(_OF_BOUNDARIES)} begin names of traced boundaries"
            yield (*place, "name"), text
        try:
            part = part_of(measure, config)
        except ValueError as error:
            yield (*place, "of"), str(error)
            continue
        is_struck = measure.quantity == "contact torque" or (
            measure.quantity == "acceleration" and any(part.number + 1 in lash.between for lash in config.lashes)
        )
        if config.has_rigid_flanks and is_struck:
            text = f"under the restitution model a touch makes the {measure.quantity} infinite"
            yield (*place, "quantity"), f"{text}; twists and shaft torques stay finite"


# --- Swept, drawn, fitted and free keys ------------------------------------------------------------------------------


def varied_tables(config: Any) -> list[tuple[Place, Any]]:
    """The axes, samples, tolerances, fitted and free parameters of a config that are tables, each with its place."""
    return [
        ((*place, k), table)
        for place in _VARIED
        for k, table in enumerate(items_of(value_at(config, place)))
        if isinstance(table, dict | Table)
    ]


def _varied(config: Config) -> Findings:
    """Require that what is swept, drawn, fitted or free is a parameter, in one place only."""
    swept = parameters_of(config.swept.axes)
    for table, verb in _VARIED.items():
        taken: dict[str, dict[str, Place]] = {}  # key -> what is drawn of it -> where
        for k, entry in enumerate(items_of(value_at(config, table))):
            at = (*table, k)
            # a factor and an offset of a key act one after the other, in a fit on a value, too
            draws = getattr(entry, "draws", "value") if table != ("sweep", "samples") else "value"
            for parameter in entry.keys:
                text = complaint(parameter, config)
                if text is None and table != ("sweep", "axes"):
                    text = _undrawable(parameter, entry, table, parameter in swept, config)
                before = taken.setdefault(parameter, {})
                is_again = draws in before or (before and table[0] != "fit" and "value" in (draws, *before))
                if text is None and is_again:
                    text = f"{parameter} is {verb} {dotted(before.get(draws, next(iter(before.values()))))} already"
                if text is not None:
                    yield (*at, "parameter"), text
                else:
                    before[draws] = at
    optimize = config.optimize
    if optimize is not None and optimize.robust is not None and not config.swept.tolerances:
        yield ("optimize", "robust"), "a share of drawn drivelines needs [[sweep.tolerances]], and there are none"


def _undrawable(
    parameter: str, entry: Draw | FreeParameter, table: Place, is_swept: bool, config: Config
) -> str | None:
    """Reason why a key cannot be drawn, fitted or free; None where it can."""
    _, key, value = located(config, parameter)
    if key.whole:
        return f"{parameter} is an inertia's number, which cannot be drawn"
    needs_value = True  # of the run as it is
    if not isinstance(entry, FreeParameter):
        if is_swept and table[1] == "samples":
            return f"{parameter} is swept already"
        if is_swept and table[1] == "tolerances":
            around = 'its tolerance must be around the swept value; set draws = "factor" or "offset"'
            return f"{parameter} is swept: {around}" if entry.draws == "value" else None
        is_around = entry.draws != "value" or any(map(math.isnan, entry.numbers(math.nan).values()))
        needs_value = is_around or table[1] != "samples"
    if needs_value and math.isnan(value):
        return f"{parameter} needs a value in this config, for the run as it is or for values around it"
    return None


# --- Values of swept, drawn, fitted and free keys --------------------------------------------------------------------


class Given(NamedTuple):
    """A value that something in a config gives to a key.

    value : [unit of the key]
    at : place in the config of what gives it
    words : of key and value, for people
    """

    value: float
    at: Place
    words: str


Case = dict[str, Given]  # by parameter


def _reached(config: Config) -> Findings:
    """Require the rules of a run where swept, drawn, fitted and free keys have their least and greatest values.

    Of swept and drawn keys every two have theirs together, too.
    """
    together = [*_cases_of_sweep(config)]
    pairs = (one | other for first, second in combinations(together, 2) for one, other in product(first, second))
    refused: set[Place] = set()
    for case in chain(*together, _cases_of_searches(config), pairs):
        places = {given.at[:3] for given in case.values()}
        if refused.isdisjoint(places) and (finding := _broken_at(case, config)) is not None:
            refused.add(finding[0][:3])
            yield finding


def _broken_at(case: Case, config: Config) -> Finding | None:
    """The first rule that a run breaks in which some keys have other values."""
    document, parameter_at = with_values(config, {parameter: given.value for parameter, given in case.items()})
    run, findings = validated(Config, document)
    broken, text = next(iter(findings if run is None else _of_a_run(run)), (None, ""))
    if broken is None:
        return None
    words = dict.fromkeys(given.words for given in case.values())
    culprit = case[parameter_at.get(broken, [*case][-1])]
    return culprit.at, f"{' and '.join(words)}: {text}"


def _extremes(config: Config, columns: Mapping[str, Floats]) -> list[int]:
    """Positions of the extremes of keys whose values, (n,) by parameter, go together.

    These are the least and the greatest value of each, that nearest to zero, and of a whole number one that is none;
    and of each two keys the extremes of their difference, as two times may not change places.
    """
    extremes = [*columns.values(), *(one - other for one, other in combinations(columns.values(), 2))]
    positions = [int(at) for each in extremes for at in (each.argmin(), each.argmax(), abs(each).argmin())]
    wholes = [values for parameter, values in columns.items() if located(config, parameter)[1].whole]
    return list(dict.fromkeys([*positions, *(int((values % 1.0).argmax()) for values in wholes)]))


def _cases_of_sweep(config: Config) -> Iterator[list[Case]]:
    """Extreme cases of each axis and drawn key, of axes that are walked together all at once.

    The sample is known beforehand.
    """
    sweep = config.swept
    columns = {axis.parameter: axis.grid for axis in sweep.axes}
    axes = [*enumerate(sweep.axes)]
    for group in [axes] if sweep.design == "zip" else ([each] for each in axes):
        yield [
            {
                axis.parameter: Given(axis.grid[at], ("sweep", "axes", k, *axis.place_of(at)), axis.parameter)
                for k, axis in group
            }
            for at in _extremes(config, {axis.parameter: axis.grid for _, axis in group})
        ]
    table, draws = ("samples", sweep.samples) if sweep.samples else ("tolerances", sweep.tolerances)
    drawn = {}
    for k, (draw, numbers) in enumerate(zip(draws, drawn_numbers(config, draws), strict=True)):
        key = draw.parameter
        around = columns.get(key, np.array([nominal_value(config, key)]))
        columns[key] = draw.applied(numbers[:, None], np.array([around.min(), around.max()])).ravel()
        values = columns[key][_extremes(config, {key: columns[key]})].tolist()
        words = f"a draw makes {key} {{:.6g}} (low and high bound it)"
        if np.isnan(values).any():
            words = f"nothing can be drawn for {key}: its distribution has no number from low to high, or no median"
        drawn[key] = [{key: Given(value, ("sweep", table, k), words.format(value))} for value in values]
    yield from drawn.values()


def _cases_of_searches(config: Config) -> Iterator[Case]:
    """The ends of what a fit and an optimisation allow.

    A measured key's factor or offset acts on measured values, which are not known here.
    """
    for k, prior in enumerate(config.fit.parameters if config.fit is not None else ()):
        nominal = nominal_value(config, prior.parameter)
        ends = prior.applied(prior.quantiles([0.0, 1.0], nominal), nominal) if not math.isnan(nominal) else np.empty(0)
        for value in ends.tolist():
            yield {
                prior.parameter: Given(value, ("fit", "parameters", k), f"it allows {prior.parameter} = {value:.6g}")
            }
    for k, free in enumerate(config.optimize.parameters if config.optimize is not None else ()):
        for key, end in product(free.keys, ("low", "high")):
            yield {key: Given(getattr(free, end), ("optimize", "parameters", k, end), key)}


# --- Numbers that cannot be meant ------------------------------------------------------------------------------------


LARGEST_RADIUS = 10.0  # m; the gears of mills and radio telescopes have some meters
DEEPEST = 6.28  # rad, a whole turn, of flanks pressed together by the load: of gears it is some 1e-3
LONGEST_CHANGE = 20.0  # times the run, that all loads but tables may take to change: less than 5 % of it are seen then


def doubts(config: Config, given: Collection[str]) -> Iterator[str]:
    """Sentences on what is odd in a config; given : keys of its load that a user has given, by name."""
    swept = {axis.parameter for axis in config.swept.axes}
    for place, lash in config.placed_lashes:
        radius = dotted((*place, "radius"))
        if lash.radius > LARGEST_RADIUS:
            yield f"{radius} = {lash.radius:g} m; it is in meters, and {lash.radius / 1e3:g} if that was in mm"
        stiffness, torque = lash.contact.stiffness, _largest_torque(config.load)
        key = dotted((*place, "contact", "stiffness"))
        if config.has_rigid_flanks or stiffness is None or {key, radius} & swept:
            continue
        if (overlap := torque / (lash.radius**2 * stiffness)) > DEEPEST:
            yield (
                f"{key} = {stiffness:g} N/m at a radius of {lash.radius:g} m: {torque:g} N m press the flanks "
                f"{overlap:,.3g} rad into each other; gears have 1e7 to 1e9 N/m"
            )
    load = config.load
    for key in sorted(given):
        users = _users(key)
        is_default = getattr(load, key) == Load.model_fields[key].default  # as of a resolved config
        if users and not uses(load.profile, key) and not is_default:
            yield f"load.{key} is given, but a load of profile {shorten(load.profile)} has none; {users} would use it"
    times = {"load.duration", "load.time_constant", "load.times", "solver.end_time"}
    time, end = _time_of_change(load), config.solver.end_time
    longest = end if load.profile == "table" else LONGEST_CHANGE * end
    if time > longest and not times & {key.partition("[")[0] for key in swept}:
        ends = f"a run ends after {end:g} s (solver.end_time)"
        yield f"the load takes {time:g} s to change, and {ends}; times are in seconds"


def _largest_torque(load: Load) -> float:
    """The larger of the torques before and after, or the largest of a table  [N m]."""
    if load.profile == "table":
        return abs(load.scale) * max(map(abs, load.torques or (0.0,)))
    if load.ratio is not None and load.static_torque is not None:
        return abs(load.static_torque) * max(1.0, abs(1.0 + load.ratio))
    return max(abs(load.initial_torque or 0.0), abs(load.final_torque or 0.0))


def _time_of_change(load: Load) -> float:
    """Time until which a load changes  [s]; 0 of a profile that has none, and of a table that does not."""
    if load.profile == "table" and load.times and load.torques:
        changes = zip(load.times[1:], pairwise(load.torques), strict=True)
        return max((time for time, (one, other) in changes if one != other), default=0.0)
    return {"ramp": load.duration, "smooth": load.duration, "lag": load.time_constant}.get(load.profile) or 0.0
