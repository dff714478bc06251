"""`clunk modes`: natural frequencies, damping ratios and small-gap thresholds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import json_option, study_argument

if TYPE_CHECKING:
    from clunk.simulation.driveline import Modes
    from clunk.study.study import Study


@click.command()
@study_argument
@json_option
def modes(study: Study, as_json: bool, **_: Any) -> None:
    """Print natural frequencies and damping ratios.

    Also prints, for each mode, the two inertias with most of its kinetic energy (--json: the share of each inertia),
    and the thresholds: load ratios at which one more impact appears as the backlash vanishes. The lowest mode of the
    closed lash is the shuffle. Several lashes are all closed or all open. There are no thresholds for several lashes or
    for shafts with stages.

    Example: clunk modes configs/nominal.toml
    """
    from clunk.core.status import Status
    from clunk.simulation.load import run_load
    from clunk.simulation.small_gap import one_mode_thresholds, rigid_contact_thresholds
    from clunk.simulation.system import build, explained, preload, steady_driveline, steady_stages

    driveline, stages = steady_driveline(study), steady_stages(study)
    system = build(study)
    if Status.NO_EQUILIBRIUM in (system.status, preload(system, run_load(study)[0]).status):
        terminal.complain(f"warning: {explained(study, Status.NO_EQUILIBRIUM)}")
    views = {state: driveline.modes(closed=state == "closed") for state in ("closed", "open")}
    several, shuffle = len(study.lashes) > 1, 1 if views["closed"].frequency.size else None
    thresholds = {"lowest mode": one_mode_thresholds, "all modes": rigid_contact_thresholds}
    ratios = {name: of(study).tolist() for name, of in thresholds.items() if not (several or stages)}
    periods = dict(zip(study.lash_names, driveline.contact_periods.tolist(), strict=True))
    if as_json:
        tables.print_record(
            {
                **views,
                "thresholds": ratios,
                "inertias": driveline.names,
                "shuffle": shuffle,
                "stages": stages,
                "contact_period": tables.of_lashes(periods),
            }
        )
        return
    for k, stage in stages.items():
        click.echo(f"shaft {k} in stage {stage}, as before the load step")
    for state, view in views.items():
        click.echo(f"{'all lashes' if several else 'lash'} {state}")
        if view.frequency.size:
            tables.print_table(_rows(view, driveline.names))
        else:
            click.echo("  nothing oscillates")
        if rates := view.overdamped.tolist():
            click.echo(f"  not oscillating, decay rates [1/s]: {', '.join(f'{rate:.4g}' for rate in rates)}")
        click.echo()
    values = [("shuffle", f"mode {shuffle} of the closed lash" if shuffle else "none")]
    for name, time in periods.items():
        period = f"{1e3 * time:.2f} ms" if time else "none: rigid flanks stick where they lock"
        values.append((f"contact period T_c{f', {name}' * several}", period))
    tables.print_values(values)
    if ratios:
        click.echo(
            "\nload ratio σr of an ideal step above which one more impact appears as the\n"
            "backlash vanishes, with the lash locked and no shaft's friction"
        )
        tables.print_table(
            [
                {"impacts": name} | {str(n): f"{ratio:.2f}" for n, ratio in enumerate(of, 1)}
                for name, of in ratios.items()
            ]
        )
        click.echo("(lowest mode: σr = exp(2π ζ1 (n - 1/2)); all modes: with the lash locked)")


def _rows(modes: Modes, names: tuple[str, ...]) -> list[dict[str, str]]:
    """A row for each mode, with the two inertias that have most of its kinetic energy."""
    rows = []
    of_modes = zip(modes.frequency, modes.damping_ratio, modes.energy_shares, strict=True)
    for k, (frequency, ratio, shares) in enumerate(of_modes, 1):
        largest_first = sorted(zip(shares, names, strict=True), reverse=True)[:2]
        moved = ", ".join(f"{name} {100.0 * share:.0f} %" for share, name in largest_first)
        values = {"frequency [Hz]": f"{frequency:.1f}", "damping ζ": f"{ratio:.3f}", "share of kinetic energy": moved}
        rows.append({"mode": str(k), **values})
    return rows
