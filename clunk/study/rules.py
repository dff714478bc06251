"""Rules that tie keys of different tables to one another, for configs whose tables are sound by themselves.

Rules that each run must keep are checked on the config itself, and then at the extreme values that sweep, draws, fit
and optimisation give to keys: one key at a time, and those of sweep and draws also two at a time.
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

# Names that no measure can have: variables and dimensions of a regime map's file, and quantities of runs, as
# results/quantities.csv lists them
_TAKEN = {
    *("sequence", "severity", "approach_velocity", "primary_impacts", "touches", "last_event_time", "status"),
    *("quality", "initial_side", "margin", "impact_time", "impact_flank", "impact_closing_speed", "impact_severity"),
    *(*OF_IMPACTS, *(f"impact_{name}" for name in OF_IMPACTS)),
    *("regimes", "label", "double_sided", "single_sided", "opposite_sided", "crossed", "chatter", "nominal_label"),
    *("double_sided_impacts", "run", "impact", "lash"),
}
_OF_BOUNDARIES = "boundary", "junction", "region", "ring", "unresolved"  # prefixes of boundaries' variables
# Tables of swept, drawn, fitted and free keys -> phrase for messages
_VARIED: dict[tuple[str, str], str] = {
    ("sweep", "axes"): "swept by",
    ("sweep", "samples"): "drawn by",
    ("sweep", "tolerances"): "drawn by",
    ("fit", "parameters"): "fitted by",
    ("optimize", "parameters"): "free as",
}
MOST_STEPS = 1e9  # time steps of one run by rk4; the stepping alone takes about ten seconds
MOST_PERIODS = 1e6  # periods of the load in one run; the exact method takes some steps in each
MOST_REGIMES = 30_000  # regimes of one driveline; as many take some 5 s to prepare
# Largest ratio of two inertias and of two stiffnesses in one driveline. Where these are added, double precision leaves
# four digits of the smallest inertia and six of the softest spring. At a ratio of stiffnesses a hundred times as large,
# soft modes have no digits left.
WIDEST_OF_INERTIAS, WIDEST_OF_SPRINGS = 1e12, 1e10
FASTEST_RATE = 1e12  # 1/s, largest sqrt(k/J) and c/J on the lightest inertia; atoms vibrate ten times faster


def broken_rules(config: Config) -> list[Finding]:
    """Findings of all rules on a config; extreme values of varied keys are only tried if these find nothing."""
    return [*_joined(config), *_of_a_run(config), *_varied(config), *_measured(config)] or [*_reached(config)]


def _of_a_run(config: Config) -> Findings:
    """Findings of the rules that each run must keep."""
    for rule in (_lashes, _limits, _sizes):
        yield from rule(config)


def complaint(parameter: str, config: Config) -> str | None:
    """Reason why a key cannot be swept, drawn, fitted or free; None where it can.

    A key of the load must be one that its profile uses, and a torque one of the pair that the config gives.
    """
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


# --- Parts, lashes, limits, sizes -------------------------------------------------------------------------------------


def _joined(config: Config) -> Findings:
    """Require inertias that shafts and lashes join to each other or to ground."""
    ends = [lash.between for lash in config.lashes] + [shaft.between for shaft in config.driveline.shafts]
    joined = {"ground", *ends[0]}
    for _ in ends:
        joined.update(*filter(joined.intersection, ends))
    for k, name in enumerate(config.driveline.all_names):
        if k + 1 not in joined:
            yield ("driveline", "inertias", k), f"no shaft and no lash joins {name} to the lash or to ground"


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
    # open or on either flank; with separation by force, also overlapping on either without contact force
    for contact in (lash.contact for lash in config.lashes):
        states *= 5 if contact.model == "indentation" and contact.separation == "force" else 3
    return states * 3 ** _frictions(config) * _stages(config)  # a friction sticks or slips either way


def count_of_flows(config: Config) -> int:
    """Number of regimes with different flows: contact springs that act, frictions that stick, and stages of shafts."""
    return 2 ** (len(config.lashes) + _frictions(config)) * _stages(config)


def _frictions(config: Config) -> int:
    return sum(shaft.friction > 0.0 for shaft in config.driveline.shafts)


def _stages(config: Config) -> int:
    return math.prod(len(shaft.stages) for shaft in config.driveline.shafts)


def _limits(config: Config) -> Findings:
    """Require a run of at least one step by rk4, and no more steps, periods of the load and regimes than can be run."""
    end, frequency = config.solver.end_time, config.load.frequency or 0.0
    step = config.solver.step if config.solver.method == "rk4" else end  # the exact method has no time step
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
    """Require distinct names that files do not use, parts that exist, and quantities that stay finite.

    Under the restitution model a touch makes contact torques, and accelerations of a lash's inertias, infinite.
    """
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
    """Require parameters that can be swept, drawn, fitted or free, each in one table entry only.

    One key may have a factor and an offset, and in a fit also a value. A share of drawn drivelines (optimize.robust)
    needs tolerances.
    """
    swept = parameters_of(config.swept.axes)
    for table, verb in _VARIED.items():
        taken: dict[str, dict[str, Place]] = {}  # key -> "value", "factor" or "offset" -> place of the entry
        for k, entry in enumerate(items_of(value_at(config, table))):
            at = (*table, k)
            # a factor and an offset of a key act one after the other; in a fit also on a value that is fitted
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
    needs_value = True  # for the run without sweep, fit and optimisation
    if not isinstance(entry, FreeParameter):
        if is_swept and table[1] == "samples":
            return f"{parameter} is swept already"
        if is_swept and table[1] == "tolerances":
            around = 'its tolerance must be around the swept value; set draws = "factor" or "offset"'
            return f"{parameter} is swept: {around}" if entry.draws == "value" else None
        is_around = entry.draws != "value" or any(map(math.isnan, entry.numbers(math.nan).values()))
        needs_value = is_around or table[1] != "samples"
    if needs_value and math.isnan(value):
        return f"{parameter} needs a value in this config: for the nominal run, or as the centre of other values"
    return None


# --- Values of swept, drawn, fitted and free keys --------------------------------------------------------------------


class Given(NamedTuple):
    """A value that a table of the sweep, the fit or the optimisation gives to a key.

    value : [unit of the key]
    at : place of the table, or of a key in it, in the config
    words : phrase on key and value for messages
    """

    value: float
    at: Place
    words: str


Case = dict[str, Given]  # parameter -> value; one run with other values of some keys


def _reached(config: Config) -> Findings:
    """Yield findings of the rules of a run where a swept, drawn, fitted or free key has an extreme value.

    Extreme values of every two swept or drawn keys are also tried together. An axis, draw or parameter has one at most.
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
    """First finding on a run with the values of a case, at the place that gives the value; None where all is right."""
    document, parameter_at = with_values(config, {parameter: given.value for parameter, given in case.items()})
    run, findings = validated(Config, document)
    broken, text = next(iter(findings if run is None else _of_a_run(run)), (None, ""))
    if broken is None:
        return None
    words = dict.fromkeys(given.words for given in case.values())
    culprit = case[parameter_at.get(broken, [*case][-1])]
    return culprit.at, f"{' and '.join(words)}: {text}"


def _extremes(config: Config, columns: Mapping[str, Floats]) -> list[int]:
    """Positions of the extremes of keys that change together.

    These are the least and the greatest value of each key and the one nearest to zero; of a key of whole numbers, the
    value with the largest fractional part; and of every two keys the extremes of their difference, since two times may
    not change their order.

    columns : parameter -> (n,) float64, in its key's unit
    """
    extremes = [*columns.values(), *(one - other for one, other in combinations(columns.values(), 2))]
    positions = [int(at) for each in extremes for at in (each.argmin(), each.argmax(), abs(each).argmin())]
    wholes = [values for parameter, values in columns.items() if located(config, parameter)[1].whole]
    return list(dict.fromkeys([*positions, *(int((values % 1.0).argmax()) for values in wholes)]))


def _cases_of_sweep(config: Config) -> Iterator[list[Case]]:
    """Yield the list of extreme cases of each axis, or of all axes of a zip design together, then of each drawn key.

    Drawn keys are tried at the extremes of the sweep's own sample, which its seed determines.
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
    """Yield a case for each end of a fit's priors and of an optimisation's free parameters.

    A prior is tried around the key's nominal value only: in a fit, a factor or an offset of a measured key acts on the
    measured values, which are not known here.
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


LARGEST_RADIUS = 10.0  # m; gears of mills and radio telescopes have radii of some meters
DEEPEST = 6.28  # rad, a whole turn; overlap of flanks under the load that is still plausible; gears have some 1e-3
LONGEST_CHANGE = 20.0  # end times that a load's change may take, except a table's; a run then shows 5 % of it


def doubts(config: Config, given: Collection[str]) -> Iterator[str]:
    """Yield sentences on values in a config that are allowed but implausible.

    given : names of the keys of [load] that the user has given
    """
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
        is_default = getattr(load, key) == Load.model_fields[key].default  # a resolved config gives defaults, too
        if users and not uses(load.profile, key) and not is_default:
            yield f"load.{key} is given, but a load of profile {shorten(load.profile)} has none; {users} would use it"
    times = {"load.duration", "load.time_constant", "load.times", "solver.end_time"}
    time, end = _time_of_change(load), config.solver.end_time
    longest = end if load.profile == "table" else LONGEST_CHANGE * end
    if time > longest and not times & {key.partition("[")[0] for key in swept}:
        ends = f"a run ends after {end:g} s (solver.end_time)"
        yield f"the load takes {time:g} s to change, and {ends}; times are in seconds"


def _largest_torque(load: Load) -> float:
    """Larger magnitude of the torques before and after the load step, or the largest of a table  [N m]."""
    if load.profile == "table":
        return abs(load.scale) * max(map(abs, load.torques or (0.0,)))
    if load.ratio is not None and load.static_torque is not None:
        return abs(load.static_torque) * max(1.0, abs(1.0 + load.ratio))
    return max(abs(load.initial_torque or 0.0), abs(load.final_torque or 0.0))


def _time_of_change(load: Load) -> float:
    """Time in which a load changes, of a lag its time constant  [s]; 0 of other profiles and of a constant table."""
    if load.profile == "table" and load.times and load.torques:
        changes = zip(load.times[1:], pairwise(load.torques), strict=True)
        return max((time for time, (one, other) in changes if one != other), default=0.0)
    return {"ramp": load.duration, "smooth": load.duration, "lag": load.time_constant}.get(load.profile) or 0.0
