"""Sobol indices: which toleranced parameters the spread of an outcome comes from, at one operating point.

The variance of an outcome Y over independent parameters divides into shares. The first-order index of parameter i,
S_i = Var(E(Y | x_i)) / Var(Y), is its share alone; its total index, ST_i = 1 - Var(E(Y | x_~i)) / Var(Y), includes its
interactions with the others. Both are estimated from n samples A and B and the samples AB_i, A with column i
from B, n (d + 2) runs for d parameters (Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018).
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from clunk.core.status import Status
from clunk.results.maps import QUANTILES, Results
from clunk.results.quantities import TEXT, WHY_UNDEFINED, Quantity, measuring, quantity_of
from clunk.study.arrays import Floats, Positions
from clunk.study.axes import parameters_of
from clunk.study.document import dotted
from clunk.study.errors import ClunkError, ConfigError
from clunk.study.loads import PROFILES
from clunk.study.models import WhichLash, lash_position
from clunk.study.parameters import nominal_value
from clunk.study.records import Record, tells, told, words
from clunk.study.study import Study, takes_study
from clunk.sweeping.progress import ShowProgress, reporting
from clunk.sweeping.runner import Runner

CONFIDENCE = 0.95  # of the intervals

_ROUNDING = 1e-12  # of the largest value: runs no further from the median differ from it by rounding
_RARE = 10  # least number of runs that differ from the others for shares to be estimated
_RESAMPLES = 999
_FEWEST = 16


class Share(Record):
    """Share of a parameter in the variance of a quantity: alone (S), and in all, with its interactions (ST).

    first_interval, total_interval : low and high end of each, by the percentile bootstrap
    """

    first: float = told("alone", form=".3f")
    first_interval: list[float] = told(f"alone {CONFIDENCE:.0%}", form=".3f")
    total: float = told("in all", form=".3f")
    total_interval: list[float] = told(f"in all {CONFIDENCE:.0%}", form=".3f")


class Indices(Record):
    """Sobol indices of one quantity: the shares of parameters in its variance.

    quantity : its name, see `sensitivity`
    heading : name for people, with symbol and unit
    nominal : float, in the run without tolerances
    mean, std : float, over the 2 n runs of A and B; the mean of an indicator is its probability
    quantiles : at `QUANTILES`
    indices : dotted key -> share, by falling total index; None where fewer than `_RARE` of those runs differ from the
        others, too few to estimate shares from
    """

    quantity: str
    heading: str
    nominal: float = told("without tolerances")
    mean: float = told("mean")
    std: float = told("standard deviation", form=".4g")
    quantiles: dict[str, float] = told("quantiles")
    indices: dict[str, Share] | None = told("share of the variance, alone (S) and in all (ST)")


class Sensitivity(Record, eq=False, repr=False):
    """The Sobol indices of some quantities at one operating point.

    study : Study, at that point, with its tolerances
    parameters : (d,) str, dotted keys
    samples : int, n
    runs : int, n (d + 2)
    lash : name of the lash whose outcome it is; empty where there is one
    label : of the run without tolerances
    labels : each label's share of the 2 n runs of A and B, the most frequent first
    indices : of each quantity
    """

    study: Study
    parameters: tuple[str, ...]
    indices: tuple[Indices, ...]
    samples: int = told("samples")
    runs: int = told("runs")
    lash: str = told("lash")
    label: str = told("label without tolerances")
    labels: dict[str, float] = told("labels with tolerances", form=".2%")

    @property
    @tells()
    def title(self) -> str:
        """The study's title."""
        return self.study.title

    @property
    @tells("where the spread comes from")
    def quantities(self) -> dict[str, Indices]:
        """The indices of each quantity, by its name."""
        return {each.quantity: each for each in self.indices}

    @property
    @tells("operating point")
    def at(self) -> dict[str, float]:
        """The operating point: load and backlash, by parameter, in their units."""
        load = self.study.load
        keys = [
            f"load.{key}"
            for key in PROFILES[load.profile].keys
            if key != "static_torque" and isinstance(getattr(load, key), float)
        ]
        keys += [dotted((*place, "backlash_deg")) for place in self.study.lash_places]
        return {key: nominal_value(self.study, key) for key in keys}


@takes_study
def sensitivity(
    study: Study,
    *,
    of: str | Sequence[str] = (),
    lash: WhichLash = None,
    workers: int | None = None,
    progress: ShowProgress = False,
) -> Sensitivity:
    """The first-order and total Sobol indices of an operating point's outcome.

    Parameters
    ----------
    study : Study
        With tolerances whose draws are independent; its axes are ignored. The sampling's count is n, a
        power of two.
    of : str or sequence of str, optional
        Quantities, in the words of `clunk.results.quantities`: numbers, or conditions, which are 1 where they hold and
        else 0, such as `nominal_label` (the label is that of the run without tolerances), `double_sided` and
        `severity<=8000`. By default `severity` and `nominal_label`; for the restitution model, which has no severity,
        `approach_velocity` and `nominal_label`.
    lash : str, optional
        Of several lashes, the one whose outcome is meant, by name or number; by default the first.
    workers, progress
        As in `clunk.sweep`.

    Raises
    ------
    ClunkError
        Where the study has no tolerances with Sobol indices, a drawn value is not allowed, or a run failed or has no
        value of a quantity.
    ClunkError, KeyboardInterrupt
        As `clunk.sweep`.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/tolerance.toml", ["sweep.sampling.count=64"])
    >>> sensitivity = clunk.sensitivity(study, of=["severity"])
    >>> sensitivity.label, sensitivity.runs
    ('DS(1)SS(1)', 384)
    >>> next(iter(sensitivity.indices[0].indices))
    'lash.contact.stiffness'
    """
    point = operating_point(study)
    position = lash_position(lash, study.lash_names)  # a lash that does not exist is refused before any run
    hardness = "approach_velocity" if point.has_rigid_flanks else "severity"
    names = [of] if isinstance(of, str) else of or (hardness, "nominal_label")
    parameters = tuple(parameters_of(point.swept.tolerances))
    quantities = tuple(dict.fromkeys(quantity_of(name, point) for name in names))
    if any(each.type == TEXT for each in quantities):
        raise ClunkError("The label is no number; nominal_label, double_sided and label=DS(1)SS(1) are 1 or 0.")
    sample, without = saltelli_sample(point), [nominal_value(point, parameter) for parameter in parameters]
    n, pages, d = sample.shape
    runner = Runner(measuring(point, quantities), parameters, workers=workers)
    try:
        with reporting(progress, runner.study, what="runs") as report:
            runs = runner([*sample.reshape(-1, d), without], progress=report).of_lash(lash)
    except ConfigError as error:
        raise ClunkError(
            f"A draw is not allowed: {error.problems[0].key}, {error.problems[0].message}; bound its distribution with "
            "low and high."
        ) from None
    failed = np.flatnonzero(runs.status != Status.OK)
    if failed.size:
        raise ClunkError(
            f"{failed.size:,} of {runs.status.size:,} runs failed, and the indices need all of them. The first is at "
            f"{words(runs.place(failed[:1].tolist()))}: {Status(runs.status[failed[0]]).sentence}."
        )
    label = str(runs.label_map[-1])
    indices = tuple(_indices(each.named(label), runs, parameters, point.swept.sampling.seed) for each in quantities)
    base = runs.label_map[:-1].reshape(n, pages)[:, :2]
    labels = Counter(sorted(base.ravel().tolist())).most_common()  # equally frequent ones in alphabetical order
    return Sensitivity(
        study=point,
        parameters=parameters,
        samples=n,
        runs=n * pages,
        lash=study.lash_names[position] * (len(study.lashes) > 1),
        label=label,
        labels={text: count / base.size for text, count in labels},
        indices=indices,
    )


def operating_point(study: Study) -> Study:
    """The study with its tolerances and without axes. Raises ClunkError where the tolerances have no Sobol indices."""
    swept = study.swept
    if not swept.tolerances:
        raise ClunkError(
            "There is no spread to divide: the config has no [[sweep.tolerances]], one for each parameter that is "
            "drawn (clunk help tolerances)."
        )
    parameters = parameters_of(swept.tolerances)
    if twice := next((each for each in parameters if parameters.count(each) > 1), None):
        raise ClunkError(f"{twice} has two tolerances; Sobol indices are those of parameters with one each.")
    count = swept.sampling.count
    if count < _FEWEST or count & (count - 1):
        raise ClunkError(f"sweep.sampling.count = {count}: Sobol indices need a power of two, {_FEWEST} or more.")
    return study.but(sweep=swept.but(axes=(), design="grid"))


def saltelli_sample(study: Study) -> Floats:
    """Parameters of the runs, (n, d + 2, d) float64.

    Each sample has a row of A, one of B, and for each of the d columns the row of A with that column from B.
    """
    draws = study.swept.tolerances
    d = len(draws)
    points = study.swept.sampling.points(2 * d)
    sample = np.empty((len(points), d + 2, d))
    for k, draw in enumerate(draws):
        nominal = nominal_value(study, draw.parameter)
        a, b = (draw.applied(draw.quantiles(points[:, j], nominal), nominal) for j in (k, k + d))
        sample[:, :, k] = a[:, None]
        sample[:, 1, k] = sample[:, 2 + k, k] = b
    return sample


def first_and_total(values: Floats, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """First-order and total indices, (d,) each, and their intervals, (2, d) each.

    The intervals are those of the percentile bootstrap, which takes the samples as independent: indices of Sobol points
    scatter less. BCa intervals are not defined for a parameter that changes nothing.

    Parameters
    ----------
    values : (n, d + 2) float64
        The quantity at each of the rows of `saltelli_sample`; n a power of two, not all equal.
    seed : int
        Of the bootstrap.
    """
    from scipy.stats import sobol_indices  # takes most of a second

    def estimate(rows: Positions) -> Floats:
        f_a, f_b, *f_ab = values[rows].T[:, None, :]
        # with one more parameter, which changes nothing: scipy computes no indices of a single one
        estimates = sobol_indices(func={"f_A": f_a, "f_B": f_b, "f_AB": np.array([*f_ab, f_a])}, n=rows.size)
        return np.array([estimates.first_order, estimates.total_order])[:, :-1]

    n, generator = len(values), np.random.default_rng([seed, 1])  # not the stream that scrambled the points
    resampled = [estimate(generator.integers(n, size=n)) for _ in range(_RESAMPLES)]
    ends = np.quantile(resampled, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE], axis=0)
    first, total = estimate(np.arange(n))
    return first, total, ends[:, 0], ends[:, 1]


def _indices(quantity: Quantity, runs: Results, parameters: Sequence[str], seed: int) -> Indices:
    """Sobol indices of a quantity.

    runs : those of `saltelli_sample`, and last the run without tolerances

    Raises ClunkError where the quantity is not defined in a run.
    """
    values = quantity.compared(runs)
    pages = values[:-1].reshape(-1, len(parameters) + 2)
    if undefined := np.count_nonzero(np.isnan(pages)):
        why = WHY_UNDEFINED.get(quantity.name, "")
        raise ClunkError(f"{quantity.name} is not defined in {undefined:,} of {pages.size:,} runs{why}.")
    base, shares = pages[:, :2], None
    apart = abs(base - np.median(base)) > _ROUNDING * abs(base).max()
    if np.count_nonzero(apart) >= _RARE:
        first, total, of_first, of_total = first_and_total(pages, seed)
        shares = {
            parameters[k]: Share(float(first[k]), of_first[:, k].tolist(), float(total[k]), of_total[:, k].tolist())
            for k in np.argsort(-total, kind="stable")
        }
    return Indices(
        quantity=quantity.name,
        heading=quantity.heading_with_unit,
        nominal=float(values[-1]),
        mean=float(base.mean()),
        std=float(base.std()) if apart.any() else 0.0,
        quantiles={f"{q:g}": float(value) for q, value in zip(QUANTILES, np.quantile(base, QUANTILES), strict=True)},
        indices=shares,
    )
