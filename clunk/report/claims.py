"""Every number and claim of the report, ours beside it, and where the report contradicts itself.

S.W. Boere, *Transient response in torsional systems with backlash*, report DCT 2008.116, TU Eindhoven, 2008.

A claim has the verdict that it is known to deserve. One that is known to agree and no longer does is a failure.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.analysis.measurements import read_experiment
from clunk.analysis.ridge import ridge_of
from clunk.analysis.trends import compare_experiment
from clunk.core.events import TOUCH
from clunk.report.tables import TABLES
from clunk.results.labels import double_sided
from clunk.results.regimemap import Results
from clunk.simulation.driveline import Driveline, Modes
from clunk.simulation.linear import one_mode_thresholds, periods_in_envelope, rigid_contact_thresholds
from clunk.simulation.load import load_step
from clunk.simulation.trajectory import Trajectory, simulate
from clunk.study.config import Study, study_from_text
from clunk.sweeping.sweep import cell_count, sweep

FloatArray = npt.NDArray[np.float64]

NINE = ("NI", "SS(1)", "SS(2)", "DS(1)", "DS(1)SS(1)", "DS(1)SS(2)", "DS(2)", "DS(2)SS(1)", "DS(3)")
RATIOS = (1.0, 2.0, 5.0)  # of Figure 3.2
NOMINAL_RATIO, NOMINAL_BACKLASH = 5.0, 6.0  # of Figures 3.1, 3.3 and 3.6

_MAP = """
title = "{title}"
[driveline]
preset = "{preset}"
[lash.contact]
model = "{model}"
separation = "{separation}"
[[sweep.axes]]
parameter = "load.ratio"
start = 0.0
stop = 10.0
count = {count}
[[sweep.axes]]
parameter = "lash.backlash_deg"
start = 0.0
stop = 20.0
count = {count}
"""


class Verdict(Enum):
    """What comparing a claim with the computation shows."""

    AGREES = "agrees"
    DIFFERS = "differs"
    CONTRADICTS = "the report contradicts itself"


@dataclass(frozen=True)
class Claim:
    """A number or statement of the report beside ours.

    where : place in the report
    report : what it says
    ours : what clunk finds
    verdict : what the comparison shows
    known : the verdict that it is known to deserve
    """

    where: str
    report: str
    ours: str
    verdict: Verdict
    known: Verdict = Verdict.AGREES

    @property
    def failed(self) -> bool:
        """Whether a claim that is known to agree no longer does."""
        return self.known == Verdict.AGREES and self.verdict != Verdict.AGREES

    def record(self) -> dict[str, str]:
        """The claim for JSON."""
        return {
            "where": self.where,
            "report": self.report,
            "clunk": self.ours,
            "verdict": self.verdict.value,
            "known": self.known.value,
        }


@dataclass(frozen=True)
class Maps:
    """The sweeps behind Figures 3.4 and 3.7 and their variants."""

    indentation: Results
    restitution: Results
    by_force: Results
    as_printed: Results


MAPS = {
    "indentation": ("Indentation Force Model", "boere-2008", "indentation", "gap", 201),
    "restitution": ("Restitution Coefficient Model, e = 0.5", "boere-2008", "restitution", "gap", 201),
    "by_force": ("Indentation Force Model, separation by force", "boere-2008", "indentation", "force", 101),
    "as_printed": ("Inertias of Table 2.2 as printed", "boere-2008-as-printed", "indentation", "gap", 101),
}


def map_studies(coarsen: int = 1) -> dict[str, Study]:
    """The studies of `Maps` by field name, on 1/`coarsen` of their values an axis."""
    studies = {}
    for name, (title, preset, model, separation, count) in MAPS.items():
        studies[name] = report_map((count - 1) // coarsen + 1, title, preset, model, separation)
    return studies


def report_map(
    count: int,
    title: str = "Figure 3.4",
    preset: str = "boere-2008",
    model: str = "indentation",
    separation: str = "gap",
) -> Study:
    """The report's map, load ratio 0 to 10 and backlash 0 to 20 degrees, with `count` values an axis."""
    text = _MAP.format(title=title, preset=preset, model=model, separation=separation, count=count)
    return study_from_text(text, source=f"the config of {title}")


def run_maps(coarsen: int = 1, workers: int | None = None, progress: Callable[[int, int], None] | None = None) -> Maps:
    """Run the sweeps of `map_studies`; `progress` gets the cells done and all cells."""
    studies = map_studies(coarsen)
    total = sum(cell_count(study) for study in studies.values())
    done = 0
    found: dict[str, Results] = {}
    for name, study in studies.items():
        before = done

        def advance(cells: int, _total: int, before: int = before) -> None:
            if progress is not None:
                progress(before + cells, total)

        found[name] = sweep(study, workers=workers, progress=advance)
        done += cell_count(study)
    return Maps(**found)


def run_of(ratio: float, backlash: float, model: str = "indentation", preset: str = "boere-2008") -> Trajectory:
    """One run of the report's driveline."""
    overrides = [f"load.ratio={ratio!r}", f"lash.backlash_deg={backlash!r}", f'lash.contact.model="{model}"']
    text = f'title = "σr = {ratio:g}, φθ = {backlash:g}°"\n[driveline]\npreset = "{preset}"\n'
    return simulate(study_from_text(text, source="the nominal config", overrides=overrides))


class Evidence:
    """What the claims are held against, computed once."""

    def __init__(self, maps: Maps) -> None:
        self.maps = maps
        self.nominal = run_of(NOMINAL_RATIO, NOMINAL_BACKLASH)
        self.runs = {
            model: {ratio: run_of(ratio, NOMINAL_BACKLASH, model) for ratio in RATIOS}
            for model in ("indentation", "restitution")
        }
        self.study = self.nominal.study

    @cached_property
    def modes(self) -> Modes:
        """Of the corrected driveline, lash closed."""
        return Driveline.from_study(self.study).modes(closed=True)

    @cached_property
    def printed_modes(self) -> Modes:
        """Of the driveline as printed, lash closed."""
        study = study_from_text('[driveline]\npreset = "boere-2008-as-printed"\n')
        return Driveline.from_study(study).modes(closed=True)


def claims(evidence: Evidence) -> list[Claim]:
    """Every claim of the report that can be checked, in its order."""
    found: list[Claim] = []
    for section in (_driveline, _models, _time_histories, _linear_view, _regimes, _severity, _experiment):
        found += section(evidence)
    return found


def _driveline(e: Evidence) -> list[Claim]:
    ours, printed = e.modes.frequency, e.printed_modes.frequency
    zeta, printed_zeta = e.modes.damping_ratio, e.printed_modes.damping_ratio
    expected = [3.2, 16.2, 30.8, 258.3]
    return [
        _claim(
            "§2.2",
            f"natural frequencies {_numbers(expected)} Hz",
            f"{_numbers(ours)} Hz with J2, J3, J4 = 0.0020 kg m²",
            [round(f, 1) for f in ours] == expected,
        ),
        _contradiction(
            "Table 2.2",
            "J2, J3, J4 = 0.020 kg m²",
            f"these give {_numbers(printed)} Hz, not §2.2's; a tenth of them does",
            [round(f, 1) for f in printed] != expected,
        ),
        _claim(
            "§2.2",
            "damping ratios ζ of 10 to 20 %",
            f"{_numbers(100 * zeta)} %; as printed {_numbers(100 * printed_zeta)} %",
            bool(np.all((zeta >= 0.10) & (zeta <= 0.20))),
        ),
        _contradiction(
            "Table 2.2",
            "stiffness in N/m, damping in Ns/m",
            "they multiply angles in Eq. 2.5: N m/rad and N m s/rad",
            True,
        ),
    ]


def _models(e: Evidence) -> list[Claim]:
    run = e.runs["restitution"][NOMINAL_RATIO]
    touches = np.flatnonzero(run.events["kind"] == TOUCH)
    n = run.states.shape[1] // 2
    lash = Driveline.from_study(run.study).lash
    after = run.states[touches, n:] @ lash
    rebounds = np.abs(after) > 0.0  # not those that lock
    ratio = after[rebounds] / run.events["speed"][touches][rebounds]
    return [
        _contradiction(
            "Eq. 2.5",
            "c34 acts in the gap",
            "Eq. 2.6 and the text uncouple the two sides: no contact torque in the gap",
            True,
        ),
        _contradiction(
            "Eq. 2.8",
            "velocity before = -e times after",
            f"Eq. 2.9 gives after = -e times before: ours {ratio.mean():.3f} at {ratio.size} rebounds (e = 0.5)",
            bool(np.allclose(ratio, -0.5, rtol=1e-12)),
        ),
    ]


def _time_histories(e: Evidence) -> list[Claim]:
    start = e.nominal.states[0]
    found = [
        _claim(
            "Figure 3.1",
            "T steps from -6 to -1 N m at σr = 5; rotation between -0.7 and 0.3 rad",
            f"T(0⁻) = {_before(e.study):g} N m; θ1 starts at {start[0]:.3f} rad",
            bool(_before(e.study) == -6.0 and -0.7 < start[0] < -0.6),
        )
    ]
    for ratio, (said, label) in zip(RATIOS, _FIGURE_3_2, strict=True):
        indentation, restitution = e.runs["indentation"][ratio].label, e.runs["restitution"][ratio].label
        ours = f"{indentation} (IFM), {restitution} (RCM)"
        found.append(_claim("Figure 3.2", f"σr = {ratio:g}: {said}", ours, indentation == restitution == label))
    visible = {model: _visible_touches(e.runs[model][NOMINAL_RATIO]) for model in ("indentation", "restitution")}
    first = {model: _first_impact(e.runs[model][NOMINAL_RATIO]) for model in ("indentation", "restitution")}
    delay = first["indentation"][1:3] - first["restitution"][1:3]
    found += [
        _claim(
            "Figure 3.3",
            "e = 0.5 gives essentially the same chatter as the IFM",
            f"touches that matter (faster than a tenth of the first): {visible['indentation']} IFM, "
            f"{visible['restitution']} RCM",
            abs(visible["indentation"] - visible["restitution"]) <= 1,
        ),
        _claim(
            "§3.1",
            "the IFM's chatter impacts have a slight delay",
            f"second and third touch {1e3 * delay[0]:.1f} and {1e3 * delay[1]:.1f} ms later",
            bool(np.all((delay > 0.0) & (delay < 5e-3))),
        ),
    ]
    return found


_FIGURE_3_2 = (
    ("stays in contact", "NI"),
    ("one single-sided impact", "SS(1)"),
    ("one double- and one single-sided impact", "DS(1)SS(1)"),
)


def _linear_view(e: Evidence) -> list[Claim]:
    one_mode, exact = one_mode_thresholds(e.study), rigid_contact_thresholds(e.study)
    expected = [1.46, 3.13, 6.69, 14.32]
    counted = periods_in_envelope(e.study, NOMINAL_RATIO)
    gap = float(np.max(np.abs(exact / one_mode - 1.0)))
    return [
        _contradiction(
            "Eq. 3.1",
            "n_c = ln(σr)/ζ",
            f"needs 2π: at σr = 5 it gives {2 * np.pi * counted:.1f} periods, ln(σr)/(2π ζ1) gives {counted:.2f}; "
            "Table 3.1 is computed with 2π",
            True,
        ),
        _claim(
            "Table 3.1",
            f"thresholds σr = {_numbers(expected, 2)}",
            f"{_numbers(one_mode, 2)}",
            [round(ratio, 2) for ratio in one_mode] == expected,
        ),
        _claim(
            "§3.2",
            "Table 3.1 agrees with the transitions on Figure 3.4's horizontal axis",
            f"all modes: {_numbers(exact, 2)}; within {gap:.1%}",
            gap < 0.03,
        ),
        _contradiction("§3.2", "0.5 < n_c > 1.5", "reads 0.5 < n_c < 1.5 in Table 3.1", True),
    ]


def _regimes(e: Evidence) -> list[Claim]:
    ours, printed = e.maps.indentation, e.maps.as_printed
    counts = printed.counts()
    extra = sorted(set(printed.labels) - set(NINE), key=lambda label: -counts[label])
    pairs = np.array([*map(double_sided, ours.labels), 0])[ours.sequence]
    rising, falling = _ordered(pairs, axis=0), _ordered(-pairs, axis=1)
    same = float(np.mean(_texts(ours) == _texts(e.maps.restitution)))
    return [
        _claim(
            "Figure 3.4",
            "nine regions: " + " ".join(NINE),
            "exactly these" if set(ours.labels) == set(NINE) else "also " + " ".join(set(ours.labels) ^ set(NINE)),
            set(ours.labels) == set(NINE),
        ),
        _contradiction(
            "Table 2.2",
            "Figure 3.4 with the inertias as printed",
            f"they give {len(extra)} labels that the figure does not have, most often {', '.join(extra[:4])}",
            bool(extra),
        ),
        _claim(
            "§3.2, §5.1",
            "more double-sided impacts at higher load ratios and smaller gaps",
            f"never fewer in {rising:.1%} of the steps up in σr, never more in {falling:.1%} of the steps up in φθ",
            rising > 0.99 and falling > 0.99,
        ),
        _claim(
            "§3.1",
            "both models predict the primary impacts equally",
            f"same label in {same:.2%} of {ours.sequence.size:,} cells; RCM has "
            + ("the same nine" if set(e.maps.restitution.labels) == set(NINE) else "other labels too"),
            same >= 0.99 and set(e.maps.restitution.labels) == set(NINE),
        ),
    ]


def _severity(e: Evidence) -> list[Claim]:
    ours = e.maps.indentation
    window = e.nominal.events[e.nominal.primaries[0] :]
    low, high = float(window["min_acceleration"].min()), float(window["max_acceleration"].max())
    largest, by_force = float(ours.severity.max()), float(e.maps.by_force.severity.max())
    rising = _ordered(ours.severity, axis=0)
    fall, where = _largest_fall(ours)
    at = np.unravel_index(int(ours.severity.argmax()), ours.shape)
    worst = ridge(ours)
    inside = np.isfinite(worst)
    hit = ours.axes[0].values > 3.2  # beyond the second threshold every ratio has a crossing
    sample = [
        f"{worst[k]:.1f}° at σr = {ours.axes[0].values[k]:g}" for k in np.flatnonzero(hit)[:: max(1, hit.sum() // 3)]
    ]
    return [
        _claim(
            "Figure 3.6",
            "acceleration between -5000 and 4000",
            f"{low:.0f} to {high:.0f} rad/s²: {low / -5000 - 1:.0%} and {high / 4000 - 1:.0%} beyond the axis",
            low > -5000 and high < 4000,
            known=Verdict.DIFFERS,
        ),
        _contradiction("Figure 3.6", "unit m/s²", "θ''3 is angular: rad/s²", True),
        _claim(
            "Figure 3.7",
            "colour bar up to 18000: a maximum of 18000 to 20000",
            f"{largest:.0f} rad/s² at σr = {ours.axes[0].values[at[0]]:g}, φθ = {ours.axes[1].values[at[1]]:g}° "
            f"({largest / 18000 - 1:.0%} beyond); {by_force:.0f} with separation by force",
            18000 <= largest <= 20000,
            known=Verdict.DIFFERS,
        ),
        _claim(
            "§3.3.2, §5.1",
            "global trend: severity rises with the load ratio",
            f"in {rising:.1%} of the steps up in σr; it falls by {fall:.0%} at most, {where}",
            rising > 0.9 and fall < 0.2,
        ),
        _claim(
            "§3.3.2, §5.1",
            "severity has a maximum over the backlash",
            f"for every σr above 3.2: {', '.join(sample)}" if inside[hit].all() else "not for every σr",
            bool(inside[hit].all()),
        ),
        _claim(
            "§3.3.2",
            "severity rises with small backlash (Krenz) and falls with large (Crowther and Singh)",
            f"at σr = 5: {_profile(ours, 5.0)}",
            bool(inside[np.argmin(np.abs(ours.axes[0].values - 5.0))]),
        ),
    ]


def _experiment(e: Evidence) -> list[Claim]:
    letters = e.nominal.letters
    measured = compare_experiment(e.maps.indentation, read_experiment("table_4_1", TABLES))
    alike = ", ".join(f"{trend.alike} of {trend.pairs} along {trend.symbol.split()[0]}" for trend in measured.trends)
    opposed = sum(trend.opposed for trend in measured.trends)
    single_from = _least_backlash(e.maps.indentation, 2.5, "SS(1)")
    steps = _steps_up_in_backlash(e.maps.indentation)
    transitions = (("DS(1)SS(1)", "SS(1)"), ("DS(2)SS(1)", "DS(1)SS(2)"), ("DS(3)SS(1)", "DS(2)SS(1)"))
    present = [pair for pair in transitions if pair in steps]
    return [
        _claim(
            "§4.2.1",
            "experiment and model agree in their trends: more double-sided impacts at higher σr and smaller gaps",
            f"neighbouring points of Table 4.1 ordered alike: {alike}; opposed: {opposed}",
            opposed == 0,
        ),
        _claim(
            "Table 4.1",
            "measured sequences",
            f"{measured.agreeing} of {measured.counted} equal the nearest cell's: a trend comparison, since the rig's "
            "parameters are not the model's",
            measured.same_regimes,
            known=Verdict.DIFFERS,
        ),
        _claim(
            "§4.2.1",
            "only single-sided impacts at small load ratios (σr = 2.5), in Table 4.1 and in Figure 3.4",
            f"in the map of Figure 3.4 from φθ = {single_from:g}° up; below it is DS(1)",
            single_from == 0.0,
            known=Verdict.DIFFERS,
        ),
        _claim(
            "§4.2.1",
            "Figure 3.4 has Table 4.1's transitions with rising gap: "
            + ", ".join(f"{before} to {after}" for before, after in transitions),
            "has " + (", ".join(f"{before} to {after}" for before, after in present) or "none"),
            len(present) == len(transitions),
            known=Verdict.DIFFERS,
        ),
        _contradiction(
            "Figure 4.3",
            "initial, opposite, initial side impacts make one D and one S",
            f"the label means opposite, initial, initial: Figure 3.2, σr = 5, is {letters}",
            letters == "O I I",
        ),
        _contradiction(
            "Table 4.1",
            "text: from D(1)+S(1) to D(1)+S(2) and back to D(1)+S(2)",
            "the table goes back to D(1)+S(1)",
            True,
        ),
    ]


# --- what the claims are made of


def _claim(where: str, report: str, ours: str, holds: bool, known: Verdict = Verdict.AGREES) -> Claim:
    return Claim(where, report, ours, Verdict.AGREES if holds else Verdict.DIFFERS, known)


def _contradiction(where: str, report: str, ours: str, shown: bool) -> Claim:
    """A place where the report contradicts itself, if the evidence still shows it."""
    return Claim(where, report, ours, Verdict.CONTRADICTS if shown else Verdict.DIFFERS, Verdict.CONTRADICTS)


def ridge(results: Results) -> FloatArray:
    """The backlash of largest Q for each load ratio, NaN where `ridge_of` has none."""
    at = ridge_of(results.severity)
    known = np.isfinite(at)
    return np.where(known, results.axes[1].values[np.where(known, at, 0.0).astype(np.intp)], np.nan)


def _ordered(values: npt.NDArray[Any], axis: int) -> float:
    """The share of neighbours along an axis that do not fall."""
    return float(np.mean(np.diff(values, axis=axis) >= 0))


def _largest_fall(results: Results) -> tuple[float, str]:
    """The largest relative fall of Q in one step up in the load ratio, and in which label."""
    before, after = results.severity[:-1], results.severity[1:]
    fall = 1.0 - after / np.where(before > 0.0, before, np.inf)
    fall = np.where(before > 0.0, fall, 0.0)
    at = np.unravel_index(int(fall.argmax()), fall.shape)
    return float(fall[at]), f"in {results.labels[results.sequence[at]]} near σr = {results.axes[0].values[at[0]]:.2g}"


def _least_backlash(results: Results, ratio: float, label: str) -> float:
    """The backlash from which on a load ratio has this label; NaN where its largest one has not."""
    row = _texts(results)[int(np.argmin(np.abs(results.axes[0].values - ratio)))]
    other = np.flatnonzero(row != label)
    first = int(other[-1]) + 1 if other.size else 0
    return float(results.axes[1].values[first]) if first < row.size else float("nan")


def _steps_up_in_backlash(results: Results) -> set[tuple[str, str]]:
    """The pairs of different labels of neighbouring cells, in the direction of rising backlash."""
    texts = _texts(results)
    pairs = zip(texts[:, :-1].ravel().tolist(), texts[:, 1:].ravel().tolist(), strict=True)
    return {(before, after) for before, after in pairs if before != after}


def _texts(results: Results) -> npt.NDArray[np.str_]:
    return np.array([*results.labels, "failed"])[results.sequence]


def _profile(results: Results, ratio: float) -> str:
    """Q at the first, the worst and the last backlash of a load ratio."""
    row = results.severity[int(np.argmin(np.abs(results.axes[0].values - ratio)))]
    gaps = results.axes[1].values
    marks = [int(np.argmin(np.abs(gaps - 1.0))), int(row.argmax()), len(gaps) - 1]
    return ", ".join(f"Q = {row[k]:.0f} at {gaps[k]:g}°" for k in marks)


def _before(study: Study) -> float:
    return float(load_step(study.load).before)


def _first_impact(run: Trajectory) -> FloatArray:
    """Times of the touches from the first primary impact up to the next, s after the load step."""
    events = run.events[run.primaries[0] : run.primaries[1]]
    return np.asarray(events["time"][events["kind"] == TOUCH], dtype=np.float64)


def _visible_touches(run: Trajectory) -> int:
    events = run.events[run.primaries[0] : run.primaries[1]]
    speed = np.abs(events["speed"][events["kind"] == TOUCH])
    return int(np.count_nonzero(speed > 0.1 * speed[0]))


def _numbers(values: Any, digits: int = 1) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
