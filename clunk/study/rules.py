"""Rules that tie keys of different tables to one another, for configs whose tables are sound by themselves."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

import numpy as np

from clunk.study.arrays import Floats
from clunk.study.document import Place, dotted, with_value
from clunk.study.loads import PROFILES, TORQUES, uses
from clunk.study.measures import broken_measures
from clunk.study.models import NOT_OF_A_RUN, Config
from clunk.study.parameters import complaint, located
from clunk.study.problems import listing, shorten
from clunk.study.sweeps import Axis, Draw
from clunk.study.tables import Finding, allowed_inertias

MOST_STEPS = 1e9  # of one run; about ten seconds of nothing but stepping
MOST_PERIODS = 1e6  # of the load in one run; the exact method takes some steps in each
LARGEST_SIZE = 1e30  # of inertias, stiffnesses, dampings and the radius, and the smallest is its inverse
WIDEST_SPREAD = 1e12  # of the inertias and of the springs of one driveline: four digits are left where they add up
FASTEST_RATE = 1e12  # 1/s, of stiffness or damping on an inertia; atoms swing ten times faster

Sizes = Sequence[tuple[float, Place]]  # positive numbers, each with its place


def broken_rules(config: Config) -> list[Finding]:
    """Findings of all rules on a config; draws are only looked at where nothing else is wrong."""
    rules = (_inertias, _lashes, _steps, _sizes, _swept, _times, _fitted, _optimised, broken_measures)
    findings = [finding for rule in rules for finding in rule(config)]
    return findings or list(_drawn(config))


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
    names, models = config.lash_names, [lash.contact.model for lash in config.lashes]
    for k, (place, lash) in enumerate(zip(config.lash_places, config.lashes, strict=True)):
        if lash.name is not None and (lash.name.isdigit() or not lash.name.strip() or set(lash.name) & set("[]")):
            text = f"found {shorten(lash.name)}; a name must not be empty, a number, or have brackets in it"
            yield (*place, "name"), text
        elif names[k] in names[:k]:
            text = f"the name {shorten(names[k])} is taken by lash {names.index(names[k]) + 1}"
            yield (*place, "name"), text
        if models[k] != models[0]:
            text = f"found {shorten(models[k])} beside {shorten(models[0])}"
            yield (*place, "contact", "model"), f"{text} of lash 1; all lashes of a driveline have one contact model"


def _steps(config: Config) -> Iterator[Finding]:
    """Require runs of at least one step and not absurdly many, also at every value that an axis gives."""
    steps, ends = (list(_extent(config, ("solver", key))) for key in ("step", "end_time"))
    frequency, at_frequency = max(_extent(config, ("load", "frequency")), default=(0.0, ()))
    (longest, at_longest), (shortest, at_shortest) = max(steps), min(steps)
    (earliest, at_earliest), (latest, at_latest) = min(ends), max(ends)
    if longest > earliest:
        text = f"a step of {longest:g} s is longer than the run, end_time = {earliest:g} s"
        yield _axis_first(at_longest, at_earliest), text
    elif latest / shortest > MOST_STEPS:
        text = f"a run of {latest:g} s in steps of {shortest:g} s has {latest / shortest:.2g} of them"
        yield _axis_first(at_shortest, at_latest), f"{text}; at most {MOST_STEPS:g} are allowed"
    elif latest * frequency > MOST_PERIODS:
        text = f"a run of {latest:g} s at {frequency:g} Hz has {latest * frequency:.2g} periods of the load"
        yield _axis_first(at_frequency, at_latest), f"{text}; at most {MOST_PERIODS:g} are allowed"


def _sizes(config: Config) -> Iterator[Finding]:
    """Require inertias, springs and dampers that double precision can multiply, and add to one another."""
    inertias, shafts = range(len(config.driveline.inertias)), range(len(config.driveline.shafts))
    masses = [size for k in inertias for size in _extent(config, ("driveline", "inertias", k))]
    springs = [[size for place in _stages(config, k) for size in _extent(config, place)] for k in shafts]
    dampers = [list(_extent(config, ("driveline", "shafts", k, "damping"))) for k in shafts]
    lashes = config.lash_places
    places: list[Place] = [*(("driveline", "shafts", k) for k in shafts), *lashes]
    ratios = [list(_ratios(config, (*place, "ratio"))) for place in places]
    radii = [list(_extent(config, (*place, "radius"))) for place in lashes]
    stiffnesses, dampings = (
        [list(_extent(config, (*place, "contact", key))) for place in lashes] for key in ("stiffness", "damping")
    )
    absurd = [
        (place, f"found {size:g}; must be from {1.0 / LARGEST_SIZE:g} to {LARGEST_SIZE:g}")
        for size, place in [*masses, *chain(*springs, *dampers, *ratios, *radii, *stiffnesses, *dampings)]
        if not 1.0 / LARGEST_SIZE <= size <= LARGEST_SIZE
    ]
    yield from absurd
    if absurd:
        return
    at_springs, at_dampers = (
        [size for sizes, gears in zip(joints, ratios, strict=True) for size in (*sizes, *_levered(sizes, gears))]
        for joints in (
            [*springs, *map(_levered, stiffnesses, radii)],
            [*dampers, *map(_levered, dampings, radii)],
        )
    )
    for sizes, unit in ((masses, "kg m2"), (at_springs, "N m/rad")):
        (smallest, at_smallest), (largest, at_largest) = min(sizes, default=(1.0, ())), max(sizes, default=(1.0, ()))
        if largest > WIDEST_SPREAD * smallest:
            yield (
                _axis_first(at_largest, at_smallest),
                f"{largest:g} {unit} here and {smallest:g} {unit} at {dotted(at_smallest)} are more than a factor of "
                f"{WIDEST_SPREAD:g} apart; the smaller one is lost in rounding",
            )
            return
    lightest, at_lightest = min(masses)
    for sizes, power, unit in ((at_springs, 0.5, "N m/rad"), (at_dampers, 1.0, "N m s/rad")):
        largest, at_largest = max(sizes, default=(0.0, ()))
        rate = (largest / lightest) ** power
        if rate > FASTEST_RATE:
            text = f"{largest:g} {unit} on the {lightest:g} kg m2 of {dotted(at_lightest)} is a rate of {rate:.2g} 1/s"
            yield at_largest, f"{text}; at most {FASTEST_RATE:g} 1/s is allowed"


def _stages(config: Config, shaft: int) -> list[Place]:
    """Places of a shaft's stiffness, or of its stiffness in each stage."""
    place: Place = ("driveline", "shafts", shaft, "stiffness")
    stages = config.driveline.shafts[shaft].stages
    return [(*place, k) for k in range(len(stages))] if len(stages) > 1 else [place]


def _levered(sizes: Sizes, levers: Sizes) -> Sizes:
    """A radius or a gear ratio, squared, times a stiffness or damping, at the place of whichever is further from 1."""
    return [
        (lever**2 * size, at if abs(math.log(size)) > abs(2.0 * math.log(lever)) else at_lever)
        for size, at in sizes
        for lever, at_lever in levers
    ]


def _axis_first(*places: Place) -> Place:
    """The first of these places that lies on an axis, as the less obvious one; else the first."""
    return next((place for place in places if place[0] == "sweep"), places[0])


def _ratios(config: Config, place: Place) -> Iterator[tuple[float, Place]]:
    """A gear ratio's size and the least and largest that an axis gives it, each with its place; none that are 1."""
    value = abs(located(config, dotted(place))[2])
    if value != 1.0:
        yield value, place
    for k, axis in enumerate(config.sweep.axes if config.sweep is not None else ()):
        if axis.parameter == dotted(place):
            sizes = np.abs(axis.grid[axis.grid != 0.0])  # zero has an error of its own
            if sizes.size:
                yield from ((float(size), ("sweep", "axes", k)) for size in (sizes.min(), sizes.max()))


def _extent(config: Config, place: Place) -> Iterator[tuple[float, Place]]:
    """Value of a key and of the ends of an axis over it, each with its place; positive ones only."""
    parameter = dotted(place)
    value = located(config, parameter)[2]
    if value > 0.0:
        yield value, place
    for k, axis in enumerate(config.sweep.axes if config.sweep is not None else ()):
        if axis.parameter == parameter:
            yield from ((end, ("sweep", "axes", k, *where)) for where, end in axis.ends if end > 0.0)


# --- Swept and drawn keys --------------------------------------------------------------------------------------------


def _swept(config: Config) -> Iterator[Finding]:
    """Require that a swept or drawn key is a parameter, in one place only, and gets values that it allows."""
    if config.sweep is None:
        return
    document = config.model_dump(exclude={"sweep"})
    swept: dict[str, Place] = {}
    drawn: dict[str, Place] = {}
    for name, taken, verb in (("axes", swept, "swept"), ("samples", drawn, "drawn"), ("tolerances", drawn, "drawn")):
        entries = getattr(config.sweep, name)
        for k, entry in enumerate(entries):
            at: Place = ("sweep", name, k)
            parameter = entry.parameter
            text = complaint(parameter, document) or load_complaint(parameter, config)
            if text is None and name != "axes":
                text = _undrawable(entry, name, swept, config)
            before = [each for each in entries[:k] if each.parameter == parameter]
            if text is None and parameter in taken and not (name == "tolerances" and _go_together(*before, entry)):
                text = f"{parameter} is {verb} by {dotted(taken[parameter])} already"
            if text is not None:
                yield (*at, "parameter"), text
                continue
            taken[parameter] = at
            if name == "axes":
                yield from (((*at, *where), message) for where, message in _range(entry, config))


def _go_together(*draws: Draw) -> bool:
    """Whether tolerances of one key are a factor and an offset, one applied after the other."""
    return sorted(each.draws for each in draws) == ["factor", "offset"]


def _range(axis: Axis, config: Config) -> Iterator[Finding]:
    """Require values of an axis that the swept key allows."""
    _, key, _ = located(config, axis.parameter)
    inertias = len(config.driveline.inertias)
    for where, end in axis.ends:
        if not key.allows(end):
            yield where, f"found {end:g}; {axis.parameter} must be {key.must_be}"
        elif key.whole and end > inertias:
            yield where, f"found {end:g}; {axis.parameter} is an inertia's number, and there are {inertias}"
    if key.not_zero and all(map(key.allows, axis.grid[[0, -1]])) and not np.all(axis.grid):
        at = ("values", axis.values.index(0.0)) if axis.values is not None else ()
        yield at, f"found 0 among the values; {axis.parameter} must be {key.must_be}"
    crossing = _crossing(config, axis.parameter, axis.grid)
    if crossing is not None:
        yield (), crossing
    if key.whole and np.any(axis.grid % 1.0):
        yield (), f"{axis.parameter} must be {key.must_be} at every value of the axis"


def _crossing(config: Config, parameter: str, values: Floats) -> str | None:
    """Reason why a breakpoint cannot have some values: it would meet one beside it; None of any other key."""
    *shaft, name, k = located(config, parameter)[0]
    if name != "breakpoints_deg":
        return None
    for n in (int(k) - 1, int(k) + 1):
        beside = dotted((*shaft, name, n))
        if 0 <= n < len(config.driveline.shafts[int(shaft[-1])].breakpoints_deg or ()):
            axes = [axis.grid for axis in config.sweep.axes if axis.parameter == beside] if config.sweep else []
            reach = np.concatenate([*axes, values[:0]]) if axes else np.array([located(config, beside)[2]])
            if not (values.max() < reach.min() if n > int(k) else values.min() > reach.max()):
                return f"{parameter} and {beside} are not in ascending order in some runs"
    return None


Reach = tuple[Place, Floats, bool]  # of a time: its place in the sweep, its values, whether axes walk together


def _times(config: Config, drawn: Mapping[int, Reach] | None = None) -> Iterator[Finding]:
    """Require times of the load that are in order in every run; `drawn` are the extremes of those that are drawn."""
    times, sweep = config.load.times or (), config.sweep
    reaches: dict[int, Reach] = {}
    for k, axis in enumerate(sweep.axes if sweep is not None and config.load.profile == "table" else ()):
        place = located(config, axis.parameter)[0]
        if place[:2] == ("load", "times"):
            reaches[int(place[2])] = ("sweep", "axes", k), axis.grid, sweep is not None and sweep.design == "zip"
    reaches |= drawn or {}
    for n, (at, values, _) in reaches.items():
        if n == 0 and np.any(values):
            yield at, "load.times[1] is the load step itself and must stay 0"
        for first, second in ((n - 2, n), (n - 1, n), (n, n + 1), (n, n + 2)):
            if first < 0 or second >= len(times):
                continue
            (_, early, walked), (_, late, too) = (
                reaches.get(m, ((), np.array([times[m]]), True)) for m in (first, second)
            )
            gap = (late - early if walked and too else late.min() - early.max()).min()
            if gap < 0.0 or (gap == 0.0 and second == first + 2):
                names = f"load.times[{first + 1}] and load.times[{second + 1}]"
                yield at, f"{names} are {'out of order' if gap < 0.0 else 'equal, with one between them,'} in some runs"
                break


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


def _drawn(config: Config) -> Iterator[Finding]:
    """Require draws that their keys allow: of the sample, known beforehand, the least and the largest value."""
    sweep = config.sweep
    if sweep is None or not (sweep.samples or sweep.tolerances):
        return
    table, draws = ("samples", sweep.samples) if sweep.samples else ("tolerances", sweep.tolerances)
    points = sweep.sampling.points(len(draws))
    axes = {axis.parameter: axis.grid for axis in sweep.axes}
    drawn_times: dict[int, Reach] = {}
    reached: dict[str, Floats] = {}  # by the draws of a key so far
    for k, draw in enumerate(draws):
        place, key, value_of_study = located(config, draw.parameter)
        nominal = axes.get(draw.parameter, np.array([value_of_study]))
        drawn = draw.sample(points[:, k], float(nominal[0]))  # around a swept value it does not use this
        before = reached.get(draw.parameter, np.array([nominal.min(), nominal.max()]))
        values = reached[draw.parameter] = draw.applied(drawn[:, None], before)
        if any(each.parameter == draw.parameter for each in draws[k + 1 :]):
            continue
        extremes = [values.min(), values.max(), *([values.flat[np.abs(values).argmin()]] if key.not_zero else [])]
        for value in map(float, extremes):
            number = int(np.nonzero(values == value)[0][0]) + 1 if math.isfinite(value) else 1
            text = _forbidden(draw, value, f"draw {number} of {len(drawn)} makes {draw.parameter} {value:.6g}", config)
            if text is not None:
                yield ("sweep", table, k), text
                break
            if place[:2] == ("load", "times"):  # held against the others below
                drawn_times[int(place[2])] = ("sweep", table, k), np.array(extremes), False
    yield from _times(config, drawn_times)


def _forbidden(draw: Draw, value: float, what: str, config: Config) -> str | None:
    """Reason why a drawn key cannot have a value, beginning with `what`; None where it can."""
    place, key, _ = located(config, draw.parameter)
    if not math.isfinite(value) or not key.allows(value):
        bound = "; bound the distribution with low and high" if draw.distribution != "uniform" else ""
        return f"{what}; it must be {key.must_be}{bound}"
    crossing = _crossing(config, draw.parameter, np.array([value]))
    if crossing is not None or place[:2] == ("load", "times"):
        return crossing
    drawn = Config.model_validate(with_value(config.model_dump(exclude=NOT_OF_A_RUN), place, value))
    drawn = drawn.model_copy(update={"sweep": config.sweep})
    return next((f"{what}; {text}" for rule in (_steps, _sizes) for _, text in rule(drawn)), None)


def _fitted(config: Config) -> Iterator[Finding]:
    """Require fitted parameters that can be drawn, with priors that allow nothing that a config may not hold.

    A measured key's factor or offset acts on measured values, which are not known here.
    """
    document = config.model_dump(exclude=NOT_OF_A_RUN)
    for k, prior in enumerate(config.fit.parameters if config.fit is not None else ()):
        parameter = prior.parameter
        text = complaint(parameter, document) or load_complaint(parameter, config)
        text = text or _undrawable(prior, "fit", {}, config)
        if text is not None:
            yield ("fit", "parameters", k, "parameter"), text
            continue
        nominal = located(config, parameter)[2]
        for value in map(float, prior.applied(prior.quantiles([0.0, 1.0], nominal), nominal)):
            text = None if math.isnan(nominal) else _forbidden(prior, value, f"it allows {value:.6g}", config)
            if text is not None:
                yield ("fit", "parameters", k), text
                break


def _optimised(config: Config) -> Iterator[Finding]:
    """Require free parameters that can be swept, over values that they allow; robustness with tolerances only."""
    optimize = config.optimize
    document = config.model_dump(exclude=NOT_OF_A_RUN)
    for k, free in enumerate(optimize.parameters if optimize is not None else ()):
        for parameter in free.keys:
            text = complaint(parameter, document) or load_complaint(parameter, config)
            if text is not None:
                yield ("optimize", "parameters", k, "parameter"), text
                continue
            _, key, _ = located(config, parameter)
            for name in ("low", "high"):
                value = getattr(free, name)
                if key.whole or not key.allows(value):
                    must_be = "a key of numbers, not of whole ones" if key.whole else key.must_be
                    yield ("optimize", "parameters", k, name), f"found {value:g}; {parameter} must be {must_be}"
    if optimize is not None and optimize.robust is not None and not (config.sweep and config.sweep.tolerances):
        yield ("optimize", "robust"), "a share of drawn drivelines needs [[sweep.tolerances]], and there are none"
