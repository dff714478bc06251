"""Recovery of known parameters by `clunk fit`: how often its 90 % intervals hold them.

    python tests/benchmarks/recovery.py driveline|axes [SETS] [FIRST] [--quick]

Each set is the report's driveline with three parameters drawn from their priors (`driveline`: scales of the gap, of a
damping and of an inertia; `axes`: scale and offset of the gap, and scale of the load ratio), measured at 20 operating
points: labels, of which 5 % are wrong, and the times of all primary impacts with 1 ms of noise. It is fitted
by labels and times, and by labels alone. Of 200 sets, a right interval holds the true number in 86 to 94 % (two
standard errors).
"""

import argparse
import time

import numpy as np

from clunk.analysis.fitted import INTERVAL, effective_size, weights_of
from clunk.analysis.fitting import Candidates, sample
from clunk.analysis.measurements import experiment_of
from clunk.api import run_points
from clunk.results.labels import flanks_of_label
from clunk.study.config import study_from_text
from clunk.study.parameters import nominal_value
from clunk.sweeping.sweep import engine_of

PRIOR = '[[fit.parameters]]\nparameter = "{}"\ndistribution = "uniform"\ndraws = "{}"\nlow = {}\nhigh = {}\n'
PARAMETERS = {
    "driveline": [
        ("lash.backlash_deg", "factor", 0.7, 1.3),
        ("driveline.shafts[3].damping", "factor", 0.7, 1.3),
        ("driveline.inertias[4]", "factor", 0.7, 1.3),
    ],
    "axes": [
        ("lash.backlash_deg", "factor", 0.7, 1.3),
        ("lash.backlash_deg", "offset", -1.0, 1.0),
        ("load.ratio", "factor", 0.8, 1.2),
    ],
}
CONFIG = '[driveline]\npreset = "boere-2008"\n[solver]\nmethod = "exact"\nend_time = 1.0\n[fit]\n'
CONFIG += "effective_draws = 100\ndraws = 6144\n"
RATIOS, GAPS = (2.5, 4.6, 6.7, 8.5, 10.3), (2.0, 5.0, 9.0, 14.0)
NOISE, WRONG = 1e-3, 0.05  # s, and a share


def synthetic(study, number):
    """True numbers of a set, and its measurements as the text of a CSV file."""
    generator = np.random.default_rng([number, 2026])
    priors = study.fit.parameters
    true = np.array([generator.uniform(prior.low, prior.high) for prior in priors])
    ratios, gaps = (each.ravel() for each in np.meshgrid(RATIOS, GAPS))
    values = {"load.ratio": ratios, "lash.backlash_deg": gaps}
    for prior, number in zip(priors, true, strict=True):
        nominal = np.full(ratios.size, nominal_value(study, prior.parameter))
        values[prior.parameter] = prior.applied(number, values.get(prior.parameter, nominal))
    runs = run_points(study, values)
    most = int(runs.primary_impacts.max()) + 2
    rows = [
        "load_ratio,lash_backlash_deg,label,impact_time_std," + ",".join(f"impact_time_{k + 1}" for k in range(most))
    ]
    for k in range(ratios.size):
        label = str(runs.label_map[k])
        if generator.random() < WRONG:
            label = str(generator.choice([other for other in runs.labels if other != label]))
        times = runs.impact_time[runs.first_impact[k] : runs.first_impact[k + 1]]
        times = np.abs(times + NOISE * generator.standard_normal(times.size))[: len(flanks_of_label(label))]
        cells = [f"{each:.6f}" for each in times] + [""] * (most - times.size)
        rows.append(",".join([repr(float(ratios[k])), repr(float(gaps[k])), label, repr(NOISE), *cells]))
    return true, "\n".join(rows)


def without_times(text):
    """The measurements with their labels alone."""
    return "\n".join(",".join(line.split(",")[:3]) for line in text.splitlines())


def intervals(study, text, engine):
    """90 % intervals of the ensemble, (parameters, 2), its effective size and number of draws."""
    candidates = Candidates(study, experiment_of(text, "synthetic.csv"), study.lash_names[0], engine)
    fit = study.fit
    draws, values, density = sample(candidates, len(fit.parameters), fit.effective_draws, fit.draws, fit.seed)
    weights = weights_of(values, density)
    bounds = np.quantile(candidates.numbers(draws), INTERVAL, axis=0, weights=weights, method="inverted_cdf").T
    return bounds, effective_size(weights), len(draws)


def main(which, sets, first, overrides=()):
    """Print the share of the sets in which each interval holds the true number, and how wide it is."""
    parameters = PARAMETERS[which]
    study = study_from_text(CONFIG + "".join(PRIOR.format(*each) for each in parameters), overrides=list(overrides))
    spans = np.array([high - low for *_, low, high in parameters])
    held, widths, sizes = ({"times": [], "labels": []} for _ in range(3))
    began = time.perf_counter()
    with engine_of(None) as engine:
        for number in range(first, first + sets):
            true, text = synthetic(study, number)
            for data, measured in (("times", text), ("labels", without_times(text))):
                bounds, size, draws = intervals(study, measured, engine)
                held[data].append((bounds[:, 0] <= true) & (true <= bounds[:, 1]))
                widths[data].append(bounds[:, 1] - bounds[:, 0])
                sizes[data].append((size, draws))
            if (number + 1 - first) % 10 == 0 or number + 1 == first + sets:
                seconds = time.perf_counter() - began
                print(f"{number + 1 - first} sets, {seconds:.0f} s")
                for data, each in held.items():
                    share, width = np.mean(each, axis=0), np.median(widths[data], axis=0) / (0.9 * spans)
                    worth, draws = np.median(sizes[data], axis=0)
                    print(f"  {data:6}  held {share.round(3)}  median width over the prior's {width.round(3)}  "
                          f"worth {worth:.0f} of {draws:.0f} draws", flush=True)  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", nargs="?", choices=PARAMETERS, default="driveline")
    parser.add_argument("sets", nargs="?", type=int, default=200)
    parser.add_argument("first", nargs="?", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="one set with few draws")
    options = parser.parse_args()
    if options.quick:
        main(options.which, 1, options.first, ["fit.draws=64", "fit.effective_draws=4"])
    else:
        main(options.which, options.sets, options.first)
