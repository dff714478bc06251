"""`clunk modes`: natural frequencies, damping ratios and small-gap thresholds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import json_option, study_argument

if TYPE_CHECKING:
    from clunk.study.study import Study

_FAINTEST = 0.05  # share of a mode's kinetic energy that is printed
_MOST_SHARES = 2


@click.command()
@study_argument
@json_option
def modes(study: Study, as_json: bool, **_: Any) -> None:
    """Print natural frequencies and damping ratios.

    Also the thresholds of a vanishing backlash, the share of each inertia in the kinetic energy of each mode, and which
    mode is the shuffle: the lowest in which all inertias swing in phase or, where nothing holds the driveline, the
    engine's side against the vehicle's. Of several lashes, all are closed or open, and there are no thresholds, nor of
    shafts with stages.

    Example: clunk modes configs/nominal.toml
    """
    from clunk.core.status import Status
    from clunk.simulation.driveline import explained, steady_driveline, steady_stages, steps_a_period
    from clunk.simulation.shapes import shuffle_mode
    from clunk.simulation.small_gap import one_mode_thresholds, rigid_contact_thresholds

    driveline, stages = steady_driveline(study), steady_stages(study)
    if driveline.rigid_motion.shape.shape[1] > 1:  # parts that turn by themselves
        terminal.complain(f"warning: {explained(study, Status.NO_EQUILIBRIUM)}")
    record: dict[str, Any] = {}
    for state in ("closed", "open"):
        eigen = driveline.modes(closed=state == "closed")
        record[state] = {
            "frequency_hz": eigen.frequency.tolist(),
            "damping_ratio": eigen.damping_ratio.tolist(),
            "decay_rate_per_s": eigen.overdamped.tolist(),
            "kinetic_energy_share": eigen.energy_shares.tolist(),
        }
    several, shuffle = len(study.lashes) > 1, shuffle_mode(driveline)
    thresholds = {"lowest mode": one_mode_thresholds, "all modes": rigid_contact_thresholds}
    record["thresholds"] = {name: of(study).tolist() for name, of in thresholds.items() if not several}
    record |= {"inertias": driveline.names, "shuffle": None if shuffle is None else shuffle + 1}
    record |= {"stages": stages} if stages else {}
    periods = dict(zip(study.lash_names, driveline.contact_periods.tolist(), strict=True))
    if as_json:
        tables.print_record(record | {"contact_period": tables.of_lashes(periods)})
        return
    for k, stage in stages.items():
        click.echo(f"shaft {k} in stage {stage}, as before the load step")
    for state in ("closed", "open"):
        click.echo(f"{'all lashes' if several else 'lash'} {state}")
        tables.print_table(_rows(record[state], driveline.names))
        rates = record[state]["decay_rate_per_s"]
        drifting = sum(rate <= 0.0 for rate in rates)
        if drifting:
            click.echo(f"  not oscillating: drifts (zero eigenvalues: {drifting})")
        for rate in rates:
            if rate > 0.0:
                click.echo(f"  not oscillating: decays at {rate:.4g} 1/s")
        click.echo()
    values = [("shuffle", "none" if shuffle is None else f"mode {shuffle + 1} of the closed lash")]
    values += [(f"contact period T_c{f', {name}' * several}", f"{1e3 * time:.2f} ms") for name, time in periods.items()]
    if study.solver.method == "rk4":
        steps = f"{study.solver.step:g} s, {steps_a_period(study):.1f} steps a period of the fastest mode"
        values.append(("solver.step", steps))
    tables.print_values(values)
    if several:
        return
    click.echo()
    if stages:
        click.echo("no thresholds of a vanishing backlash: they hold for shafts without stages")
        return
    click.echo("load ratio σr of an ideal step above which one more impact appears as the\nbacklash vanishes")
    ratios_above = record["thresholds"].items()
    tables.print_table(
        [{"impacts": name} | {str(n): f"{ratio:.2f}" for n, ratio in enumerate(of, 1)} for name, of in ratios_above]
    )
    click.echo("(lowest mode: σr = exp(2π ζ1 (n - 1/2)); all modes: with the lash locked)")


def _rows(state: dict[str, Any], names: tuple[str, ...]) -> list[dict[str, str]]:
    """A row for each mode, with the inertias that have most of its kinetic energy."""
    rows = []
    of_modes = zip(state["frequency_hz"], state["damping_ratio"], state["kinetic_energy_share"], strict=True)
    for k, (frequency, ratio, shares) in enumerate(of_modes, 1):
        largest_first = sorted(zip(shares, names, strict=True), reverse=True)[:_MOST_SHARES]
        moved = ", ".join(f"{name} {100.0 * share:.0f} %" for share, name in largest_first if share >= _FAINTEST)
        row = {"mode": str(k), "frequency [Hz]": f"{frequency:.1f}", "damping ζ": f"{ratio:.3f}"}
        rows.append(row | {"share of kinetic energy": moved})
    return rows
