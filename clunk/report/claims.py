"""Claims of the report: its numbers and statements, clunk's beside them, and where the report contradicts itself.

S.W. Boere, *Transient response in torsional systems with backlash*, report DCT 2008.116, TU Eindhoven, 2008.

Each claim states the verdict that it is known to deserve. A claim that is known to agree and no longer does is a
failure.
"""

from collections.abc import Iterator
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np

from clunk.analysis.marks import ridge_of
from clunk.core.events import TOUCH
from clunk.report.evidence import CONTACTS, NOMINAL_RATIO, RATIOS, Evidence, acceleration_range
from clunk.results.labels import double_sided
from clunk.results.maps import Results
from clunk.simulation.driveline import Driveline, Modes
from clunk.simulation.history import sample
from clunk.simulation.small_gap import one_mode_thresholds, periods_in_envelope, rigid_contact_thresholds
from clunk.simulation.trajectory import Trajectory
from clunk.study.arrays import Array, Floats
from clunk.study.records import Record, tells, told

NINE = ("NI", "SS(1)", "SS(2)", "DS(1)", "DS(1)SS(1)", "DS(1)SS(2)", "DS(2)", "DS(2)SS(1)", "DS(3)")


class Verdict(StrEnum):
    """Outcome of comparing a claim with the computation."""

    AGREES = "agrees"
    DIFFERS = "differs"
    CONTRADICTS = "the report contradicts itself"


class Claim(Record):
    """A number or statement of the report beside clunk's.

    where : place in the report
    report : what the report says there
    ours : what clunk finds
    shown : whether clunk's finding shows the report to be right or, of a known contradiction, to contradict itself
    known : the verdict that the claim is known to deserve
    """

    where: str = told("where")
    report: str = told("the report")
    ours: str = told("clunk", key="clunk")
    shown: bool = told()
    known: Verdict = told()

    @property
    @tells("verdict")
    def verdict(self) -> Verdict:
        """The verdict of the comparison, in a word."""
        if not self.shown:
            return Verdict.DIFFERS
        return Verdict.CONTRADICTS if self.known == Verdict.CONTRADICTS else Verdict.AGREES

    @property
    def failed(self) -> bool:
        """Whether a claim that is known to agree no longer does."""
        return self.known == Verdict.AGREES and not self.shown


_agrees, _differs, _contradicts = (partial(Claim, known=verdict) for verdict in Verdict)


def claims(evidence: Evidence) -> list[Claim]:
    """Check every claim of the report that can be checked, in its order."""
    sections = (_driveline, _models, _time_histories, _linear_view, _regimes, _severity, _experiment)
    return [claim for section in sections for claim in section(evidence)]


def _driveline(e: Evidence) -> Iterator[Claim]:
    expected = [3.2, 16.2, 30.8, 258.3]
    zeta = e.modes.damping_ratio

    def fits(modes: Modes) -> bool:
        return [round(f, 1) for f in modes.frequency] == expected

    yield _agrees(
        "§2.2",
        f"natural frequencies {_numbers(expected)} Hz",
        f"{_numbers(e.modes.frequency)} Hz with J2, J3, J4 = 0.0020 kg m²",
        fits(e.modes),
    )
    yield _contradicts(
        "Table 2.2",
        "J2, J3, J4 = 0.020 kg m²",
        f"these give {_numbers(e.printed_modes.frequency)} Hz, not §2.2's; a tenth of them does",
        not fits(e.printed_modes),
    )
    yield _agrees(
        "§2.2",
        "damping ratios ζ of 10 to 20 %",
        f"{_numbers(100 * zeta)} %; as printed {_numbers(100 * e.printed_modes.damping_ratio)} %",
        0.10 <= zeta.min() <= zeta.max() <= 0.20,
    )
    yield _contradicts(
        "Table 2.2",
        "stiffness in N/m, damping in Ns/m",
        "they multiply angles in Eq. 2.5: N m/rad and N m s/rad, which give §2.2's frequencies; N/m at the lash's "
        f"radius would give {_numbers(e.modes_of_forces.frequency)} Hz",
        fits(e.modes) and not fits(e.modes_of_forces),
    )


def _models(e: Evidence) -> Iterator[Claim]:
    low, high = acceleration_range(e.damped_in_the_gap)
    yield _contradicts(
        "Eq. 2.5",
        "c34 acts in the gap",
        "the text uncouples the two sides, and Eq. 2.6 does but for r²c34 on its diagonals: no contact torque in the "
        "gap; with Eq. 2.5's Figure 3.6 would range "
        f"from {low:.0f} to {high:.0f} rad/s²",
        low > -0.6 * 5000 and high < 0.6 * 4000,
    )
    run = e.runs["restitution"][NOMINAL_RATIO]
    touches = np.flatnonzero(run.events["kind"] == TOUCH)
    after = run.states[touches, run.states.shape[1] // 2 :] @ Driveline.from_study(run.study).lashes[0]
    rebounds = abs(after) > 0.0  # touches after which the flanks do not lock
    ratio = after[rebounds] / run.events["speed"][touches][rebounds]
    yield _contradicts(
        "Eq. 2.8",
        "velocity before = -e times after",
        f"Eq. 2.9 gives after = -e times before: ours {ratio.mean():.3f} at {ratio.size} rebounds (e = 0.5)",
        np.allclose(ratio, -0.5, rtol=1e-12),
    )


_FIGURE_3_2 = (
    ("stays in contact", "NI"),
    ("one single-sided impact", "SS(1)"),
    ("one double- and one single-sided impact", "DS(1)SS(1)"),
)


def _time_histories(e: Evidence) -> Iterator[Claim]:
    history = sample(e.nominal)
    before, angle, gap = history.torque[0], history.angle, 1e3 * history.backlash_coordinate
    yield _agrees(
        "Figure 3.1",
        "T steps from -6 to -1 N m at σr = 5; rotation between -0.7 and 0.3 rad",
        f"T(0⁻) = {before:g} N m; {angle.min():.3f} to {angle.max():.3f} rad",
        before == -6.0 and -0.7 < angle.min() < -0.6 and angle.max() < 0.3,
    )
    yield _agrees(
        "Figures 3.2, 3.3",
        "x_b at σr = 5 on an axis of ±5 mm, and around the first impact up to 4.8 mm",
        f"{gap.min():.2f} to {gap.max():.2f} mm, with r = 0.08 m",
        gap.min() > -5.0 and 4.2 < gap.max() < 4.8,
    )
    for ratio, (words, label) in zip(RATIOS, _FIGURE_3_2, strict=True):
        by_ifm, by_rcm = (e.runs[contact][ratio].label for contact in CONTACTS)
        labels = f"{by_ifm} (IFM), {by_rcm} (RCM)"
        yield _agrees("Figure 3.2", f"σr = {ratio:g}: {words}", labels, by_ifm == by_rcm == label)
    (time_ifm, speed_ifm), (time_rcm, speed_rcm) = (_chatter(e.runs[contact][NOMINAL_RATIO]) for contact in CONTACTS)
    count_ifm, count_rcm = (np.count_nonzero(speed > 0.1 * speed[0]) for speed in (speed_ifm, speed_rcm))
    yield _agrees(
        "Figure 3.3",
        "e = 0.5 gives essentially the same chatter as the IFM",
        f"touches that matter (faster than a tenth of the first): {count_ifm} IFM, {count_rcm} RCM",
        bool(abs(count_ifm - count_rcm) <= 1),
    )
    delay = time_ifm[1:3] - time_rcm[1:3]
    yield _agrees(
        "§3.1",
        "the IFM's chatter impacts have a slight delay",
        f"second and third touch {1e3 * delay[0]:.1f} and {1e3 * delay[1]:.1f} ms later",
        0.0 < delay.min() <= delay.max() < 5e-3,
    )


def _chatter(run: Trajectory) -> tuple[Floats, Floats]:
    """Times [s] and speeds [rad/s] of the touches from the first primary impact up to the next."""
    events = run.events[run.primaries[0] : run.primaries[1]]
    touches = events[events["kind"] == TOUCH]
    return touches["time"], abs(touches["speed"])


def _linear_view(e: Evidence) -> Iterator[Claim]:
    expected, levels = [1.46, 3.13, 6.69, 14.32], np.arange(4) + 0.5  # thresholds σr, and n_c at each
    lowest = e.modes.damping_ratio[0]
    one_mode, exact = one_mode_thresholds(e.study), rigid_contact_thresholds(e.study)
    without = np.exp(lowest * levels)
    periods = periods_in_envelope(NOMINAL_RATIO, lowest)
    holds = [round(ratio, 2) for ratio in one_mode] == expected
    yield _contradicts(
        "Eq. 3.1",
        "n_c = ln(σr)/ζ",
        f"needs 2π: at σr = 5 it gives {2 * np.pi * periods:.1f} periods, ln(σr)/(2π ζ1) gives {periods:.2f}; "
        f"Table 3.1 is computed with 2π: without, its thresholds would be {_numbers(without, 2)}",
        holds and abs(without / expected - 1.0).min() > 0.1,
    )
    yield _agrees("Table 3.1", f"thresholds σr = {_numbers(expected, 2)}", _numbers(one_mode, 2), holds)
    apart = abs(exact / one_mode - 1.0).max()
    yield _agrees(
        "§3.2",
        "Table 3.1 agrees with the transitions on Figure 3.4's horizontal axis",
        f"all modes: {_numbers(exact, 2)}; within {apart:.1%}",
        apart < 0.03,
    )
    first, second = (periods_in_envelope(ratio, lowest) for ratio in expected[:2])
    yield _contradicts(
        "§3.2",
        "0.5 < n_c > 1.5",
        f"reads 0.5 < n_c < 1.5 in Table 3.1: n_c = {first:.2f} and {second:.2f} at its σr = 1.46 and 3.13",
        abs(first - 0.5) < 0.01 and abs(second - 1.5) < 0.01,
    )


def _regimes(e: Evidence) -> Iterator[Claim]:
    ours, printed, restitution = e.maps["indentation"], e.maps["as_printed"], e.maps["restitution"]
    unlike = sorted(set(ours.labels) ^ set(NINE))
    yield _agrees(
        "Figure 3.4",
        "nine regions: " + " ".join(NINE),
        "also " + " ".join(unlike) if unlike else "exactly these on this grid; finer ones meet slivers of others",
        not unlike,
    )
    counts = printed.counts()
    extra = sorted((label for label in printed.labels if label not in NINE), key=lambda label: -counts[label])
    yield _contradicts(
        "Table 2.2",
        "Figure 3.4 with the inertias as printed",
        f"they give {len(extra)} labels that the figure does not have, most often {', '.join(extra[:4])}",
        bool(extra),
    )
    pairs = np.array([*map(double_sided, ours.labels), 0])[ours.sequence]
    rising, falling = _ordered(pairs, axis=0), _ordered(-pairs, axis=1)
    yield _agrees(
        "§3.2, §5.1",
        "more double-sided impacts at higher load ratios and smaller gaps",
        f"never fewer in {rising:.1%} of the steps up in σr, never more in {falling:.1%} of the steps up in φθ",
        rising > 0.99 and falling > 0.99,
    )
    without_gap = " ".join(dict.fromkeys(ours.label_map[:, 0]))
    yield _agrees(
        "Table 3.1",
        "0, 1, 2, 3 impacts, by rising load ratio, where the gap vanishes",
        f"{without_gap} at φθ = 0: a pair of impacts each",
        without_gap == "NI DS(1) DS(2) DS(3)",
    )
    same, nine = np.mean(ours.label_map == restitution.label_map), set(restitution.labels) == set(NINE)
    yield _agrees(
        "§3.1",
        "both models predict the primary impacts equally",
        f"same label in {same:.2%} of {ours.sequence.size:,} cells; RCM has "
        + ("the same nine" if nine else "other labels too"),
        same >= 0.99 and nine,
    )


def _severity(e: Evidence) -> Iterator[Claim]:
    ours = e.maps["indentation"]
    ratios, gaps = (axis.values for axis in ours.axes)
    low, high = acceleration_range(e.nominal)
    yield _differs(
        "Figure 3.6",
        "acceleration between -5000 and 4000",
        f"{low:.0f} to {high:.0f} rad/s²: {low / -5000 - 1:.0%} and {high / 4000 - 1:.0%} beyond the axis",
        low > -5000 and high < 4000,
    )
    radius = e.study.lashes[0].radius
    yield _contradicts(
        "Figure 3.6",
        "unit m/s²",
        f"θ''3 is angular: rad/s²; at the lash's radius it is {radius * low:.0f} to {radius * high:.0f} m/s²",
        radius * low > -0.6 * 5000 and radius * high < 0.6 * 4000,
    )
    largest, by_force = ours.severity.max(), e.maps["by_force"].severity.max()
    row, column = np.unravel_index(ours.severity.argmax(), ours.shape)
    yield _differs(
        "Figure 3.7",
        "colour bar up to 18000: a maximum of 18000 to 20000",
        f"{largest:.0f} rad/s² at σr = {ratios[row]:g}, φθ = {gaps[column]:g}° "
        f"({largest / 18000 - 1:.0%} beyond); {by_force:.0f} with separation by force",
        18000 <= largest <= 20000,
    )
    rising, (fall, place) = _ordered(ours.severity, axis=0), _largest_fall(ours)
    yield _agrees(
        "§3.3.2, §4.2.2, §5.1",
        "global trend: severity rises with the load ratio, in the experiment monotonically",
        f"in {rising:.1%} of the steps up in σr"
        + (f"; in one it falls by {fall:.0%} at most, {place}" if fall > 0.0 else ""),
        rising > 0.9 and fall < 0.2,
    )
    ridge = ridge_of(ours.severity)  # for each σr the place of a maximum inside; NaN where Q is largest at an end
    crossing = np.flatnonzero(ratios > 3.2)  # beyond the second threshold every ratio has a crossing
    inside = bool(np.isfinite(ridge[crossing]).all())
    shown = [k for k in crossing[:: max(1, crossing.size // 3)] if np.isfinite(ridge[k])]
    listed = ", ".join(f"{gaps[int(ridge[k])]:.1f}° at σr = {ratios[k]:g}" for k in shown)
    yield _agrees(
        "§3.3.2, §4.2.2, §5.1",
        "severity has a maximum over the backlash, in the experiment too",
        f"for every σr above 3.2: {listed}" if inside else "not for every σr",
        inside,
    )
    nominal = ours.axes[0].nearest(NOMINAL_RATIO)
    marks = [ours.axes[1].nearest(1.0), ours.severity[nominal].argmax(), -1]
    profile = ", ".join(f"Q = {ours.severity[nominal, k]:.0f} at {gaps[k]:g}°" for k in marks)
    yield _agrees(
        "§3.3.2",
        "severity rises with small backlash (Krenz) and falls with large (Crowther and Singh)",
        f"at σr = 5: {profile}",
        np.isfinite(ridge[nominal]),
    )


def _experiment(e: Evidence) -> Iterator[Claim]:
    ours, measured = e.maps["indentation"], e.measured
    alike = ", ".join(f"{trend.alike} of {trend.pairs} along {trend.symbol.split()[0]}" for trend in measured.trends)
    opposed = sum(trend.opposed for trend in measured.trends)
    yield _agrees(
        "§4.2.1",
        "experiment and model agree in their trends: more double-sided impacts at higher σr and smaller gaps",
        f"neighbouring points of Table 4.1 ordered alike, or equal in both: {alike}; opposed: {opposed}",
        opposed == 0,
    )
    yield _differs(
        "Table 4.1",
        "measured sequences",
        f"{measured.agreeing} of {measured.counted} equal the nearest cell's: a trend comparison, since the rig's "
        "parameters are not the model's",
        measured.same_regimes,
    )
    fitted, count = e.fitted, len(e.fitted.points)
    factor, offset = fitted.estimate
    predicted, majority, nearest = (fitted.predictions[0][rule] for rule in ("predicted", "majority", "nearest"))
    at_reversal = (fitted.points[:, 0] == 6.7) & (fitted.points[:, 1] < 4.0)
    agrees = fitted.estimate_matches["label"] == fitted.wanted
    appears = "appears" if agrees[at_reversal].all() else "does not appear"
    yield _differs(
        "Table 4.1",
        "measured sequences, with the rig's gaps in the model matched: a factor and an offset",
        f"{fitted.met} of {count} with gaps of {factor:.1f} times the measured ones and {offset:.1f}° more; each label "
        f"predicted from the other {count - 1}: {predicted} of {count} (by the most frequent label {majority}, by the "
        f"nearest measurement {nearest}); the reversal at σr = 6.7 {appears}",
        fitted.met == count,
    )
    is_single = ours.label_map[ours.axes[0].nearest(2.5)] == "SS(1)"  # by rising backlash
    single_from = np.append(ours.axes[1].values, np.nan)[np.flatnonzero(~is_single).max(initial=-1) + 1]
    yield _differs(
        "§4.2.1",
        "only single-sided impacts at small load ratios (σr = 2.5), in Table 4.1 and in Figure 3.4",
        f"in the map of Figure 3.4 from φθ = {single_from:g}° up; below it is DS(1)",
        single_from == 0.0,
    )
    claimed = ["DS(1)SS(1) to SS(1)", "DS(2)SS(1) to DS(1)SS(2)", "DS(3)SS(1) to DS(2)SS(1)"]
    texts = ours.label_map
    steps = {f"{before} to {after}" for before, after in zip(texts[:, :-1].flat, texts[:, 1:].flat, strict=True)}
    present = [step for step in claimed if step in steps]
    yield _differs(
        "§4.2.1",
        f"Figure 3.4 has Table 4.1's transitions with rising gap: {', '.join(claimed)}",
        f"has {', '.join(present) or 'none'}",
        present == claimed,
    )
    yield _contradicts(
        "Figure 4.3",
        "initial, opposite, initial side impacts make one D and one S",
        f"the label means opposite, initial, initial: Figure 3.2, σr = 5, is {e.nominal.letters}",
        e.nominal.letters == "O I I",
    )
    column = [point.measured for point in measured.points if point.at["load.ratio"] == 6.7]  # by rising backlash
    yield _contradicts(
        "Table 4.1",
        "text: from D(1)+S(1) to D(1)+S(2) and back to D(1)+S(2)",
        f"the table goes back to D(1)+S(1): at σr = 6.7 it has {', '.join(column)}",
        column[:3] == ["DS(1)SS(1)", "DS(1)SS(2)", "DS(1)SS(1)"],
    )


def _ordered(values: Array, axis: int) -> float:
    """Share of the steps along an axis in which the values do not fall."""
    return (np.diff(values, axis=axis) >= 0).mean()


def _largest_fall(results: Results) -> tuple[float, str]:
    """The largest relative fall of Q in one step up in the load ratio, and the label and load ratio before the step."""
    before, after = results.severity[:-1], results.severity[1:]
    fall = 1.0 - np.divide(after, before, out=np.ones_like(before), where=before > 0.0)
    at = np.unravel_index(fall.argmax(), fall.shape)
    return fall[at], f"in {results.labels[results.sequence[at]]} near σr = {results.axes[0].values[at[0]]:.2g}"


def _numbers(values: Any, digits: int = 1) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
