"""Optimisation: the values of some keys that minimise a key or a quantity while conditions on quantities hold.

The search is scipy's differential evolution, a generation of runs at a time, from several starts. Each start draws a
random half of the points of a space-filling exploration, and begins with the best of these and some random ones, since
the regions of a label are thin and disconnected.

The search ends by construction: the numbers of starts and of generations are bounded beforehand.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice, product
from typing import Any, NamedTuple

import numpy as np

from clunk.analysis.search import in_halves
from clunk.core.runs import BEGIN, LEVEL, SLOPE
from clunk.core.status import Status
from clunk.results.quantities import TEXT, YES_NO, Quantity, measuring, quantity_of
from clunk.simulation.load import cases_of
from clunk.study.arrays import Array, Bools, Floats
from clunk.study.designs import design_of, nominal
from clunk.study.errors import ClunkError
from clunk.study.models import Optimize, WhichLash, lash_position
from clunk.study.parameters import drawn_numbers, nominal_value, with_draws
from clunk.study.records import SENTENCE, Record, tells, told
from clunk.study.study import Study, replace_values, takes_study
from clunk.sweeping.progress import Progress, ShowProgress, reporting, unseen
from clunk.sweeping.runner import Runner

RELEASE_TIME = "release_time"  # s, time from which on the load rests
_STARTS = 4
_EXPLORED = 1 << 15  # runs of the exploration, or more
_POPULATION = 16  # candidates of a generation for each free number
_GENERATIONS = 300  # most generations of a start
_SAME = 1e-3  # share of the best value: starts whose values are as near to it as this have found the same optimum
FRONT = 9  # most optima of a trade-off: one without a bound, and one for each of eight bounds


class Optimum(Record, repr=False):
    """The best values of the free keys that a search has found, and the results of their runs.

    study : Study with these values
    parameters : key -> value, in its unit
    value : of the minimised key or quantity, in its unit
    quantities : name -> value; of a number the worst of all cells, which the needed share of the drivelines stays
        within; of a condition whether it holds in all cells of the needed share of the drivelines
    margin : least size of the margin to another label, of all runs; NaN where the method knows none
    share : share of the drivelines in which all conditions hold; None without tolerances
    found : number of the starts that found this value, to a thousandth
    runs : number of runs of the search; in a trade-off, with those of the optima before this one
    holds : whether all conditions hold, and no run fails, in the needed share of the drivelines
    changes : a row for each free number and quantity: its name, and its values by the config as it is and at the best
    """

    study: Study
    parameters: dict[str, float] = told()
    value: float = told()
    quantities: dict[str, float | bool] = told()
    margin: float = told("margin to another label", form=".3g")
    share: float | None = told("share of the drivelines", form=".4g")
    found: int = told(f"found by so many of {_STARTS} starts")
    runs: int = told("runs")
    holds: bool = told()
    changes: tuple[dict[str, Any], ...] = told("values")

    @property
    @tells(SENTENCE)
    def sentence(self) -> str:
        """Sentence that not all conditions hold; empty where they do."""
        nearest = "No values were found for which all conditions hold and no run fails; these come nearest."
        return "" if self.holds else nearest


def _rests_from(loads: Floats) -> Floats:
    """Times from which on loads, (n, P, 5), rest  [s]; of a load that never rests, when its last piece begins."""
    rests = (loads[..., LEVEL] == loads[:, -1:, LEVEL]) & (loads[..., SLOPE:] == 0.0).all(axis=-1)
    rests[:, -1] = True
    first = rests.shape[1] - np.logical_and.accumulate(rests[:, ::-1], axis=1).sum(axis=1)
    return loads[np.arange(len(loads)), first, BEGIN]


class Front(Record, repr=False):
    """Trade-off: the optimum without a bound on a quantity, and the optima under bounds on it, which fall."""

    points: tuple[Optimum, ...] = told()

    @property
    def traded(self) -> tuple[str, str]:
        """Names of the minimised value and of the quantity that is bounded."""
        first, *_, last = self.points[0].quantities
        return first, last

    @property
    @tells("trade-off")
    def values(self) -> list[dict[str, float]]:
        """For each optimum, the minimised value, the bounded quantity and the free numbers, by name."""
        return [{name: best.quantities[name] for name in self.traded} | best.parameters for best in self.points]


class Outcomes(NamedTuple):
    """Results of candidates, (n,) each: see `Optimum`.

    excess : how far the needed share of the drivelines is from meeting the conditions, in [0, 2]; 0 where it does
    """

    value: Floats
    excess: Floats
    share: Floats
    margin: Floats
    quantities: dict[str, Floats | Bools]


class Problem:
    """Optimisation problem of a study: runs candidates for the free numbers, and rates them.

    asked : the study, with [optimize]; in a trade-off, with the present bound among its conditions
    lash, workers : as in `optimize`
    traded : quantity that a trade-off bounds, if any; outcomes have its values as well
    bound : present bound on the traded quantity, a condition to hold besides those of the config, if any
    minimized : name of the minimised key or quantity
    progress : called with the number of runs so far, and the most runs of the whole search
    searches : most searches that follow the exploration
    size : scale of the minimised value, in its unit, by which the merit divides it
    as_it_is : (1, parameters) candidate of the config's own values, NaN
    """

    def __init__(
        self,
        study: Study,
        lash: WhichLash = None,
        workers: int | None = None,
        traded: str = "",
    ) -> None:
        self.asked, self.optimize, self.runs = study, _table(study), 0
        self.progress: Progress = unseen
        self.bound: Quantity | None = None
        self.searches = FRONT if traded else 1
        self._lash = lash_position(lash, study.lash_names) + 1
        free, self.minimized = self.optimize.parameters, self.optimize.minimize
        self.low, self.high = np.array([(each.low, each.high) for each in free]).T
        keys = {key for each in free for key in each.keys}
        if self.minimized == RELEASE_TIME and study.load.profile in ("lag", "sine"):
            raise ClunkError(
                f'optimize.minimize = "release_time": a load of profile "{study.load.profile}" never rests.'
            )
        self._numbers = [quantity_of(traded, study)] if traded else []
        with _errors_of("minimize, a free key, release_time or a quantity"):
            if self.minimized not in (*keys, RELEASE_TIME):
                self._numbers.append(quantity_of(self.minimized, study))
                self.minimized = self._numbers[-1].name
            for quantity in self._numbers:
                if quantity.name in ("label", "nominal_label"):
                    raise ClunkError("A label cannot be minimised; severity or double_sided, for example, can.")
        with _errors_of("subject_to"):
            self._conditions = [quantity_of(text, study) for text in self.optimize.subject_to]
            for quantity in self._conditions:
                if quantity.type != YES_NO or quantity.name == "nominal_label":
                    raise ClunkError(f"{quantity.name} is no condition; severity<=8000 or double_sided=0 is one.")
        self.study = measuring(nominal(study), [*self._conditions, *self._numbers])
        design = design_of(self.study)
        self._cells = design.columns(np.arange(design.cells))
        self._tolerances = study.swept.tolerances
        self._drawn = drawn_numbers(study, self._tolerances)
        self.shape = design.cells, len(self._drawn[0]) if self._drawn else 1
        self._needed = math.ceil((self.optimize.robust or 1.0) * self.shape[1] - 1e-9)  # drivelines
        if taken := keys & (
            self._cells.keys() | {each.parameter for each in self._tolerances if each.draws == "value"}
        ):
            raise ClunkError(
                f"{min(taken)} is free, and swept or drawn: leave out its axis, or draw a factor or an offset."
            )
        keys |= self._cells.keys() | {each.parameter for each in self._tolerances}
        self._runner = Runner(self.study, sorted(keys), workers=workers)
        self.as_it_is = np.full((1, self.low.size), np.nan)
        self.size = abs(self(self.as_it_is).value[0])

    @property
    def _filling(self) -> int:
        """Number of points of the exploration, a power of two as Sobol' points need."""
        return 1 << math.ceil(math.log2(max(_EXPLORED // math.prod(self.shape), 2 * _POPULATION * self.low.size)))

    @property
    def most(self) -> int:
        """Most runs that the exploration and all searches may take."""
        of_search = 1 + _STARTS * (self.low.size * _POPULATION * (_GENERATIONS + 1) + 1)
        return (1 + self._filling + self.searches * of_search) * math.prod(self.shape)

    def explore(self) -> tuple[Floats, Floats]:
        """Run space-filling points of the free numbers; returns them, (n, parameters), and the values of their runs."""
        from scipy.stats import qmc

        design = qmc.Sobol(self.low.size, seed=np.random.default_rng(self.optimize.seed))
        points = qmc.scale(design.random(self._filling), self.low, self.high)
        corners = [*islice(product(*zip(self.low, self.high, strict=True)), self._filling // 2)]
        points[: len(corners)] = corners  # a search meets no corner by chance
        values = self._run_allowed(points)
        if not 0.0 < self.size < math.inf:  # the runs of the config as it is fail, or have the value 0
            self.size = np.median(abs(np.nan_to_num(self.outcomes(points, values).value, posinf=1.0))) or 1.0
        return points, values

    def __call__(self, candidates: Floats) -> Outcomes:
        """Run candidates, (n, parameters), and return their outcomes; NaN stands for the config's own values."""
        return self.outcomes(candidates, self._run_allowed(candidates))

    def _run_allowed(self, candidates: Floats) -> Floats:
        """Values of `_run` for candidates, (n, parameters), and NaN for those whose values no config may have."""
        values = np.full(
            (len(candidates), math.prod(self.shape), 2 + len(self._numbers) + len(self._conditions)), np.nan
        )
        # checked by itself, so that all allowed candidates run in one batch
        allowed = in_halves(self._are_allowed, candidates, np.zeros(1, bool))
        if allowed.any():
            values[allowed] = in_halves(self._run, candidates[allowed], values[:1])
        return values

    def outcomes(self, candidates: Floats, values: Floats) -> Outcomes:
        """Outcomes of candidates, (n, parameters), from the values that `_run` has of them, (n, runs, values)."""
        shape = (len(candidates), *self.shape)
        margin, fails, *terms = np.moveaxis(values, 2, 0)

        def worst(values: Floats) -> Floats:
            """Worst value over the cells for each driveline, (n, drivelines); that of a failed run is infinite."""
            return np.nan_to_num(values, nan=np.inf).reshape(shape).max(axis=1)

        lacks = worst(fails)
        quantities: dict[str, Array] = {self.minimized: lacks}  # keeps the first place; its values are set below
        for condition, beyond in zip(self._conditions, terms[len(self._numbers) :], strict=True):
            lacking = worst(beyond)
            lacks += lacking
            quantities[condition.name] = (lacking == 0.0).sum(axis=1) >= self._needed
        numbers = {each.name: worst(values) for each, values in zip(self._numbers, terms, strict=False)}
        parameters = self.parameters(candidates)
        if self.minimized in parameters:
            numbers[self.minimized] = np.tile(parameters[self.minimized][:, None], shape[2])
        elif self.minimized == RELEASE_TIME:
            runs = math.prod(shape)
            loads = cases_of(self.study, self._columns(candidates), runs).loads
            numbers[RELEASE_TIME] = worst(np.broadcast_to(_rests_from(loads), runs))
        if self.bound is not None:
            bound = float(self.bound.bound)
            beyond = numbers[self._numbers[0].name] - bound
            lacking = np.where(beyond > 0.0, 0.1 + beyond / (abs(bound) or 1.0), 0.0)
            lacks += lacking
            quantities[self.bound.name] = (lacking == 0.0).sum(axis=1) >= self._needed
        for name, each in numbers.items():
            quantities[name] = np.sort(each, axis=1)[:, self._needed - 1]
        holds = lacks == 0.0
        share = holds.mean(axis=1)
        graded = (1.0 - 1.0 / (1.0 + lacks)).mean(axis=1)
        excess = np.where(holds.sum(axis=1) < self._needed, 1.0 - share + graded, 0.0)
        margin = abs(margin).min(axis=1)
        return Outcomes(quantities[self.minimized], excess, share, margin, quantities)

    def _are_allowed(self, candidates: Floats) -> Bools:
        """True for each candidate, (n,). Raises ConfigError where no config may have the values of one of them."""
        self._runner.checked(self._runner.values(self._columns(candidates)))
        return np.ones(len(candidates), bool)

    def _run(self, candidates: Floats) -> Floats:
        """Run candidates, (n, parameters), and return values of each run, (n, runs, 2 + numbers + conditions).

        These are its margin, 0 or NaN where it fails, its numbers, and how far it is from meeting each condition.
        """
        results = self._runner.run(self._runner.values(self._columns(candidates)), self._tell).of_lash(self._lash)
        self.runs += results.sequence.size
        fails = np.where(results.status == Status.OK, 0.0, np.nan)
        terms = [results.margin, fails, *(quantity.compared(results) for quantity in self._numbers)]
        for condition in self._conditions:
            # an unmet bound on a number costs the distance from it; any other condition the speed of the impacts
            beyond = results.approach_velocity
            base, bound = condition.base, condition.bound
            if base is not None and base.type != YES_NO and isinstance(bound, float):
                beyond = abs(base.compared(results) - bound) / (abs(bound) or 1.0)
            terms.append(np.where(condition.of_runs(results) == 1.0, 0.0, 0.1 + beyond))  # NaN where a run failed
        return np.stack(terms, axis=-1).astype(np.float64).reshape(len(candidates), -1, len(terms))

    def _tell(self, done: int, _total: int) -> None:
        self.progress(self.runs + done, max(self.runs + done, self.most))

    def parameters(self, candidates: Floats) -> dict[str, Floats]:
        """Values of the free keys, (n,) each, of candidates, (n, parameters); for NaN the config's own value."""
        return {
            key: np.where(np.isnan(column), nominal_value(self.study, key), column)
            for free, column in zip(self.optimize.parameters, candidates.T, strict=True)
            for key in free.keys
        }

    def merit(self, outcomes: Outcomes) -> Floats:
        """Merit that the search minimises, (n,): below 1 where all conditions hold, and from 1 to 3 where not."""
        value = np.minimum(outcomes.value / self.size, 1e300)
        return np.where(outcomes.excess > 0.0, 1.0 + outcomes.excess, value / (1.0 + abs(value)) - 1e-9)

    def _columns(self, candidates: Floats) -> dict[str, Floats]:
        """Values of all keys in the runs of candidates, (n cells draws,) each, in C order of the three."""
        columns = {key: values[:, None, None] for key, values in self.parameters(candidates).items()}
        columns |= {key: values[:, None] for key, values in self._cells.items()}
        columns = with_draws(self.study, columns, self._tolerances, self._drawn)
        shape = len(candidates), *self.shape
        return {key: np.broadcast_to(values, shape).ravel() for key, values in columns.items()}


@contextmanager
def _errors_of(key: str) -> Iterator[None]:
    """Context manager that puts a key of [optimize] before the message of a ClunkError."""
    try:
        yield
    except ClunkError as error:
        raise ClunkError(f"optimize.{key}: {error}") from error


def _table(study: Study) -> Optimize:
    if study.optimize is None:
        raise ClunkError("There is nothing to optimise: the config has no [optimize] (clunk help optimize).")
    return study.optimize


@takes_study
def optimize(
    study: Study,
    *,
    lash: WhichLash = None,
    workers: int | None = None,
    progress: ShowProgress = False,
) -> Optimum:
    """Find the values of a study's free keys that minimise a key or a quantity while its conditions hold.

    Parameters
    ----------
    study : Study
        With [optimize]. With axes, a quantity is its worst value over all cells, and conditions must hold in each of
        them; with tolerances, both are so for the share `robust` of the drawn drivelines.
    lash : str, optional
        Of several lashes, the one whose quantities are meant, by name or number; by default the first.
    workers : int, optional
        Threads; by default one for each core that this process may use.
    progress
        As in `clunk.sweep`; it counts runs, of the most that the search may take.

    Returns
    -------
    Optimum

    Raises
    ------
    ClunkError
        Where the config has no [optimize], or what it names cannot be minimised, bounded or searched.
    KeyboardInterrupt
        With the best so far as its first argument, an Optimum, once the exploration is complete.

    Examples
    --------
    >>> import clunk
    >>> best = clunk.optimize(clunk.load_study("configs/shaped_release.toml"))
    >>> best.value < 0.1275  # s
    True
    """
    problem = Problem(study, lash, workers)
    with reporting(progress, problem.study, what="runs at most") as problem.progress:
        return _best(problem, *problem.explore())


def front(
    study: Study,
    quantity: str,
    *,
    lash: WhichLash = None,
    workers: int | None = None,
    progress: ShowProgress = False,
) -> Front:
    """Find the least minimised value without a bound on another quantity, and under each of several bounds on it.

    Eight bounds fall in equal steps from the quantity at the optimum without a bound to 0. A bound within which the
    optimum before it lies is left out, and the first that cannot be met ends the trade-off. The exploration is run
    once, for all of them.

    quantity : a number, such as severity
    lash, workers, progress : as in `optimize`

    Raises ClunkError where no values are found for which all conditions hold, and KeyboardInterrupt with the Front so
    far as its first argument, or as `optimize` does.
    """
    table = _table(study)
    of = quantity_of(quantity, study)
    quantity = of.name
    if quantity == table.minimize:
        raise ClunkError(f"{quantity} cannot be traded: it is what is minimised.")
    if of.type in (TEXT, YES_NO) or quantity == "margin":
        raise ClunkError(f"{quantity} cannot be traded: less of it is not better; severity, for example, can.")
    problem = Problem(study, lash, workers, quantity)
    with reporting(progress, problem.study, what="runs at most") as problem.progress:
        explored = problem.explore()
        points = [_best(problem, *explored)]
        if not points[0].holds:
            raise ClunkError("No values were found for which all conditions hold: there is nothing to trade.")
        try:
            for bound in np.unique(np.linspace(0.0, points[0].quantities[quantity], FRONT))[-2::-1]:
                if points[-1].quantities[quantity] <= bound:
                    continue  # the best within a wider bound is within this one, too
                condition = f"{quantity}<={bound:.6g}"
                problem.bound = quantity_of(condition, study)
                bounded = table.but(subject_to=(*table.subject_to, condition))
                problem.asked = study.but(optimize=bounded)
                optimum = _best(problem, *explored)
                if not optimum.holds:
                    break  # a tighter bound cannot be met either
                points.append(optimum)
        except KeyboardInterrupt as stopped:
            stopped.args = (Front(tuple(points)),)
            raise
    return Front(tuple(points))


def _best(problem: Problem, points: Floats, values: Floats) -> Optimum:
    """The best optimum of all starts, from explored points and the values of their runs, see `Problem.explore`.

    Raises KeyboardInterrupt as `optimize` does.
    """
    merits, found = problem.merit(problem.outcomes(points, values)), []
    try:
        for start in range(_STARTS):
            found.append(_searched(problem, points, merits, np.random.default_rng([problem.optimize.seed, start])))
    except KeyboardInterrupt as stopped:
        best = _optimum(problem, found or [points[merits.argmin()]])
        stopped.args = (best if found else replace(best, found=0), *stopped.args)
        raise
    return _optimum(problem, found)


def _searched(problem: Problem, points: Floats, merits: Floats, rng: np.random.Generator) -> Floats:
    """The best candidate of one start, (parameters,), from a random half of the explored points and their merits."""
    from scipy.optimize import Bounds, differential_evolution

    size = _POPULATION * problem.low.size
    half = rng.permutation(len(points))[: len(points) // 2]
    order = half[merits[half].argsort(kind="stable")]
    result = differential_evolution(
        lambda columns: problem.merit(problem(columns.T)),
        Bounds(problem.low, problem.high),
        init=points[np.concatenate([order[: size // 2], rng.choice(order, size - size // 2)])],
        maxiter=_GENERATIONS,
        tol=1e-10,
        vectorized=True,
        updating="deferred",
        polish=False,
        seed=rng,
    )
    return result.x


def _optimum(problem: Problem, found: Sequence[Floats]) -> Optimum:
    """Optimum of the best of the candidates that starts have found, (parameters,) each."""
    outcomes = problem(np.array(found))
    k = int(problem.merit(outcomes).argmin())
    holds = bool(outcomes.excess[k] == 0.0 and np.isfinite(outcomes.value[k]))
    least = np.where(outcomes.excess > 0.0, np.inf, outcomes.value) if holds else outcomes.excess
    parameters = {key: values.item() for key, values in problem.parameters(found[k][None]).items()}
    quantities = {name: values[k].item() for name, values in outcomes.quantities.items()}
    before = problem(problem.as_it_is).quantities | problem.parameters(problem.as_it_is)
    return Optimum(
        study=replace_values(problem.asked, parameters),
        parameters=parameters,
        value=float(outcomes.value[k]),
        quantities=quantities,
        margin=float(outcomes.margin[k]),
        share=float(outcomes.share[k]) if problem.shape[1] > 1 else None,
        found=int((least <= least[k] + _SAME * abs(least[k])).sum()),
        runs=problem.runs,
        holds=holds,
        changes=tuple(
            {"name": name, "as it is": before[name].item(), "best": best}
            for name, best in (parameters | quantities).items()
        ),
    )
