"""`clunk modes`: natural frequencies, damping ratios and small-gap thresholds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import PATH, json_option, set_option
from clunk.study.records import fill

if TYPE_CHECKING:
    from collections.abc import Sequence

_FAINTEST = 0.05  # share of a mode's kinetic energy that is printed


@click.command()
@click.argument("config", type=PATH)
@set_option
@json_option
def modes(config: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Print natural frequencies and damping ratios.

    Also the thresholds of a vanishing backlash, the share of each inertia in the kinetic energy of each mode, and which
    mode is the shuffle: the lowest in which all inertias swing in phase or, where nothing holds the driveline, the
    engine's side against the vehicle's. Of several lashes, all are closed or open, and there are no thresholds.

    Example: clunk modes configs/nominal.toml
    """
    import numpy as np

    from clunk.core.status import Status
    from clunk.simulation.driveline import explained, steady_driveline, steady_stages, steps_a_period
    from clunk.simulation.linear import one_mode_thresholds, rigid_contact_thresholds
    from clunk.simulation.shapes import kinetic_energy_shares, mode_shapes, shuffle_mode
    from clunk.study.config import load_study

    study = load_study(config, overrides)
    driveline, stages = steady_driveline(study), steady_stages(study)
    states = {"closed": driveline.modes(closed=True), "open": driveline.modes(closed=False)}
    shares = {
        state: kinetic_energy_shares(driveline, mode_shapes(driveline, closed=state == "closed")) for state in states
    }
    if driveline.rigid_motion.shape.shape[1] > 1:  # parts that turn by themselves
        terminal.complain(f"warning: {explained(study, Status.NO_EQUILIBRIUM)}")
    names = driveline.names
    shuffle = shuffle_mode(driveline)
    several = len(study.lashes) > 1
    periods = dict(zip(study.lash_names, driveline.contact_periods.tolist(), strict=True))
    thresholds = {"lowest mode": one_mode_thresholds, "all modes": rigid_contact_thresholds}
    ratios_above = {name: of(study) for name, of in thresholds.items() if not several}
    if as_json:
        record: dict[str, Any] = {
            state: {
                "frequency_hz": eigen.frequency.tolist(),
                "damping_ratio": eigen.damping_ratio.tolist(),
                "decay_rate_per_s": eigen.overdamped.tolist(),
                "kinetic_energy_share": shares[state].tolist(),
            }
            for state, eigen in states.items()
        }
        record["thresholds"] = {name: ratios.tolist() for name, ratios in ratios_above.items()}
        record |= {"inertias": names, "shuffle": None if shuffle is None else shuffle + 1}
        record |= {"stages": stages} if stages else {}
        tables.print_record(record | {"contact_period": tables.of_lashes(periods)})
        return
    for k, stage in stages.items():
        click.echo(f"shaft {k} in stage {stage}, as before the load step")
    for state, eigen in states.items():
        click.echo(f"{'all lashes' if several else 'lash'} {state}")
        click.echo("  mode  frequency [Hz]  damping ζ [-]  share of kinetic energy")
        for k, (frequency, ratio) in enumerate(zip(eigen.frequency, eigen.damping_ratio, strict=True), 1):
            moved = _largest_shares(shares[state][k - 1].tolist(), names)
            named = "shuffle: " if state == "closed" and shuffle == k - 1 else ""
            numbers = f"  {k:>4}  {frequency:>14.1f}  {ratio:>13.3f}  "
            click.echo(fill(named + moved, numbers, " " * len(numbers)))
        rates = eigen.overdamped
        drifting = int(np.count_nonzero(rates <= 0.0))
        if drifting:
            click.echo(f"     -  does not oscillate; drifts (zero eigenvalues: {drifting})")
        for rate in rates[rates > 0.0]:
            click.echo(f"     -  does not oscillate; decays at {rate:.4g} 1/s")
        click.echo()
    for name, period in periods.items():
        click.echo(f"contact period T_c  {1e3 * period:.2f} ms{f', {name}' if several else ''}")
    steps = steps_a_period(study)
    click.echo(f"solver.step         {study.solver.step:g} s, {steps:.1f} steps a period of the fastest mode")
    if several:
        return
    click.echo()
    if stages:
        click.echo("no thresholds of a vanishing backlash: they hold for shafts without stages")
        return
    click.echo("load ratio σr of an ideal step above which one more impact appears as the\nbacklash vanishes")
    click.echo("  impacts       " + "".join(f"{n:>8}" for n in range(1, 5)))
    for name, ratios in ratios_above.items():
        click.echo(f"  {name:<14}" + ("".join(f"{ratio:>8.2f}" for ratio in ratios) or "    none"))
    click.echo("(lowest mode: σr = exp(2π ζ1 (n - 1/2)); all modes: with the lash locked)")


def _largest_shares(shares: Sequence[float], names: Sequence[str]) -> str:
    """The inertias that have most of a mode's kinetic energy, for example motor 93 %, flange 5 %."""
    largest_first = sorted(zip(shares, names, strict=True), reverse=True)
    return ", ".join(
        f"{name} {share:.0%}".replace("%", " %") for share, name in largest_first[:3] if share >= _FAINTEST
    )
