"""How much of the report's map hangs on what the report leaves open: contact damping, sticking time, separation rule.

    python -m clunk.report.openchoices              prints the table of the README, from ten maps of 101 x 101 cells

The damping is given as the damping ratio ζ4 of the closed driveline's fastest mode; the report says that all ratios lie
between 10 and 20 %, and that its chatter is that of a restitution of 0.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from clunk.core.events import SEPARATION
from clunk.report.claims import NOMINAL_BACKLASH, NOMINAL_RATIO, report_map, ridge
from clunk.results.results import Results
from clunk.simulation.driveline import Driveline
from clunk.simulation.trajectory import simulate
from clunk.study.config import Study, replace_values
from clunk.sweeping.progress import Progress
from clunk.sweeping.sweep import cell_count, sweep

COUNT = 101  # values an axis
DAMPING_RATIOS = (0.10, 0.13, 0.16, 0.23, 0.26)
STICKING_TIMES = (0.7, 0.85, 1.2, 1.5)  # of the contact period


@dataclass(frozen=True)
class Variant:
    """A map with one thing changed, beside the nominal one.

    name : what was changed, and to what
    changed, cells : int, cells with another label, and all
    labels : labels that only one of the two maps has
    nominal_severity : float  [rad/s2], Q at σr = 5, φθ = 6°
    largest_severity : float  [rad/s2], of the map
    """

    name: str
    changed: int
    cells: int
    labels: tuple[str, ...]
    nominal_severity: float
    largest_severity: float

    @property
    def share(self) -> float:
        """Of the cells, whose label changes."""
        return self.changed / self.cells


@dataclass(frozen=True)
class Separation:
    """What the separation rule does beside the labels.

    name : the rule
    nominal_severity : float  [rad/s2], Q at σr = 5, φθ = 6°
    largest_severity : float  [rad/s2], of the map
    ridge : (2,) float  [degrees], the backlash of the largest Q, at σr = 5 and σr = 10
    nominal_tension, largest_tension : float  [N m], with which the contact damper pulls just before the flanks part
    """

    name: str
    nominal_severity: float
    largest_severity: float
    ridge: tuple[float, float]
    nominal_tension: float
    largest_tension: float


@dataclass(frozen=True)
class OpenChoices:
    """The variants of the map, and both separation rules."""

    variants: tuple[Variant, ...]
    separations: tuple[Separation, ...]


def base_study(count: int = COUNT) -> Study:
    """The report's map with `count` values an axis."""
    return report_map(count, "What the report leaves open")


def contact_damping(study: Study, ratio: float) -> float:
    """The c34 with which the closed driveline's fastest mode has a damping ratio  [N s/m]."""

    def excess(damping: float) -> float:
        damped = replace_values(study, {"lash.contact.damping": damping})
        return float(Driveline.from_study(damped).modes(closed=True).damping_ratio[-1]) - ratio

    return float(brentq(excess, 0.0, 4.0 * study.lash.contact.damping, xtol=1e-9))


def variants(study: Study) -> dict[str, Study]:
    """The studies to compare with `study`, each with one thing changed, by name."""
    found = {}
    for ratio in DAMPING_RATIOS:
        damping = contact_damping(study, ratio)
        name = f"ζ4 = {ratio:.2f} (c34 = {damping:.0f} N s/m)"
        found[name] = replace_values(study, {"lash.contact.damping": damping})
    period = Driveline.from_study(study).contact_period
    for share in STICKING_TIMES:
        found[f"sticking time {share:g} T_c"] = replace_values(study, {"impacts.sticking_time": share * period})
    found["separation by force"] = by_force(study)
    return found


def by_force(study: Study) -> Study:
    """The same with separation by force."""
    contact = study.lash.contact.model_copy(update={"separation": "force"})
    return study.model_copy(update={"lash": study.lash.model_copy(update={"contact": contact})})


def tension(study: Study, ratio: float, backlash: float) -> float:
    """The largest tensile contact torque of a run  [N m].

    The contact's swing pulls hardest when the gap opens: the spring is slack by then, and the damper pulls with c q'.
    """
    single = replace_values(
        study.model_copy(update={"sweep": None}), {"load.ratio": ratio, "lash.backlash_deg": backlash}
    )
    if single.lash.contact.separation == "force":
        return 0.0  # they part before it
    events = simulate(single).events
    speeds = np.abs(events["speed"][events["kind"] == SEPARATION])
    return Driveline.from_study(single).contact_damping * float(np.max(speeds, initial=0.0))


def measure(count: int = COUNT, workers: int | None = None, progress: Progress | None = None) -> OpenChoices:
    """Run the maps; `progress` gets the cells done and all cells."""
    base = base_study(count)
    studies = {"nominal": base, **variants(base)}
    cells = cell_count(base)
    total = (len(studies) + 1) * cells  # and every cell once more, for its tension

    def advance(before: int) -> Progress | None:
        return None if progress is None else lambda done, _all: progress(before + done, total)

    maps = {
        name: sweep(study, workers=workers, progress=advance(k * cells))
        for k, (name, study) in enumerate(studies.items())
    }
    nominal = maps.pop("nominal")
    ratios, backlashes = (axis.values for axis in nominal.axes)
    tensions = []
    for ratio in ratios:
        tensions += [tension(base, float(ratio), float(backlash)) for backlash in backlashes]
        if progress is not None:
            progress(len(studies) * cells + len(tensions), total)
    return OpenChoices(
        variants=tuple(_variant(name, found, nominal) for name, found in maps.items()),
        separations=(
            _separation("by gap", nominal, base, max(tensions)),
            _separation("by force", maps["separation by force"], by_force(base), 0.0),
        ),
    )


def _variant(name: str, found: Results, nominal: Results) -> Variant:
    one, other = _labels(found), _labels(nominal)
    return Variant(
        name=name,
        changed=int(np.count_nonzero(one != other)),
        cells=one.size,
        labels=tuple(sorted(set(one.ravel()) ^ set(other.ravel()))),
        nominal_severity=_nominal(found),
        largest_severity=float(found.severity.max()),
    )


def _separation(name: str, found: Results, study: Study, largest_tension: float) -> Separation:
    crest = ridge(found)
    ratios = found.axes[0].values
    at_five, at_ten = (float(crest[np.argmin(np.abs(ratios - ratio))]) for ratio in (NOMINAL_RATIO, 10.0))
    return Separation(
        name=name,
        nominal_severity=_nominal(found),
        largest_severity=float(found.severity.max()),
        ridge=(at_five, at_ten),
        nominal_tension=tension(study, NOMINAL_RATIO, NOMINAL_BACKLASH),
        largest_tension=largest_tension,
    )


def _labels(results: Results) -> npt.NDArray[np.str_]:
    return np.array([*results.labels, "failed"])[results.sequence]


def _nominal(results: Results) -> float:
    at = tuple(
        int(np.argmin(np.abs(axis.values - value)))
        for axis, value in zip(results.axes, (NOMINAL_RATIO, NOMINAL_BACKLASH), strict=True)
    )
    return float(results.severity[at])


def markdown(found: OpenChoices) -> str:
    """Both tables as the README has them."""
    lines = ["| changed | cells with another label | Q at σr = 5, φθ = 6° | largest Q |", "| --- | --- | --- | --- |"]
    for variant in found.variants:
        share = f"{variant.changed:,} of {variant.cells:,}, {variant.share:.2%}"
        lines.append(_row(variant.name, share, f"{variant.nominal_severity:.0f}", f"{variant.largest_severity:.0f}"))
    lines += ["", "| separation | Q at σr = 5, φθ = 6° | largest Q | ridge at σr = 5, 10 | largest tensile torque |"]
    lines += ["| --- | --- | --- | --- | --- |"]
    for rule in found.separations:
        pull = f"{rule.largest_tension:.2f} N m ({rule.nominal_tension:.2f} at σr = 5, φθ = 6°)"
        crest = f"{rule.ridge[0]:.1f}°, {rule.ridge[1]:.1f}°"
        severities = f"{rule.nominal_severity:.0f}", f"{rule.largest_severity:.0f}"
        lines.append(_row(rule.name, *severities, crest, pull if rule.largest_tension else "none"))
    return "\n".join(lines) + "\n"


def _row(*entries: str) -> str:
    return f"| {' | '.join(entries)} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m clunk.report.openchoices", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=COUNT, help="values an axis [%(default)s]")
    parser.add_argument("--workers", type=int, help="threads [one for each core]")
    options = parser.parse_args(arguments)
    print(markdown(measure(options.count, options.workers)), end="")


if __name__ == "__main__":
    main()
