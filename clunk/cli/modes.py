"""`clunk modes`: natural frequencies, damping ratios and small-gap thresholds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import json_option, study_argument
from clunk.study.records import Record, told

if TYPE_CHECKING:
    from clunk.study.study import Study

_FAINTEST = 0.05  # share of a mode's kinetic energy that is printed
_MOST_SHARES = 2


@dataclass(frozen=True)
class Mode(Record):
    """An oscillating mode, numbered from 1, with the share of each inertia in its kinetic energy, by name.

    moves : the inertias that have the largest shares, for people
    """

    lash: str = told("lash")
    mode: int = told("mode")
    frequency: float = told("frequency", "Hz", ".1f", "frequency_hz")
    damping_ratio: float = told("damping ζ", form=".3f")
    moves: str = told("share of kinetic energy")
    kinetic_energy_share: dict[str, float] = told()


@dataclass(frozen=True)
class LinearView(Record):
    """Modes of a driveline, and what follows from them.

    shuffle : number of the mode of the closed lash that is the shuffle; None where there is none
    contact_period : of each lash, by name
    stages : of each staged shaft, by its number, before the load step
    modes, decay_rates : with closed and open lashes; 0 is the rate of a drift
    thresholds : load ratios σr, by the number of impacts that they are for: by the lowest mode alone,
        exp(2π ζ1 (n - 1/2)), and by all modes with the lash locked
    """

    shuffle: int | None = told("shuffle, a mode of the closed lash")
    contact_period: dict[str, float] = told("contact period T_c [s]", form=".4g")
    step: float = told("solver.step", "s")
    steps_a_period: float = told("steps a period of the fastest mode", form=".1f")
    stages: dict[int, int] = told("stages of shafts before the load step")
    decay_rates: dict[str, list[float]] = told("decays [1/s]", form=".4g")
    modes: list[Mode] = told("modes")
    thresholds: dict[str, dict[str, float]] = told("load ratio σr above which one more impact appears at no backlash")


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

    driveline = steady_driveline(study)
    if driveline.rigid_motion.shape.shape[1] > 1:  # parts that turn by themselves
        terminal.complain(f"warning: {explained(study, Status.NO_EQUILIBRIUM)}")
    modes, rates = [], {}
    for lash in ("closed", "open"):
        of_lash = driveline.modes(closed=lash == "closed")
        rates[lash] = of_lash.overdamped.tolist()
        columns = zip(of_lash.frequency.tolist(), of_lash.damping_ratio.tolist(), of_lash.energy_shares, strict=True)
        for number, (frequency, ratio, shares) in enumerate(columns, 1):
            share_of = dict(zip(driveline.names, shares.tolist(), strict=True))
            largest = sorted(share_of, key=share_of.__getitem__, reverse=True)[:_MOST_SHARES]
            moves = ", ".join(f"{name} {share_of[name]:.0%}" for name in largest if share_of[name] >= _FAINTEST)
            modes.append(Mode(lash, number, frequency, ratio, moves, share_of))
    shuffle = shuffle_mode(driveline)
    thresholds = {"lowest mode": one_mode_thresholds, "all modes": rigid_contact_thresholds}
    view = LinearView(
        shuffle=None if shuffle is None else shuffle + 1,
        contact_period=dict(zip(study.lash_names, driveline.contact_periods.tolist(), strict=True)),
        step=study.solver.step,
        steps_a_period=steps_a_period(study),
        stages=steady_stages(study),
        decay_rates=rates,
        modes=modes,
        thresholds={
            name: {str(n): ratio for n, ratio in enumerate(of(study).tolist(), 1)}
            for name, of in thresholds.items()
            if len(study.lashes) == 1
        },
    )
    tables.tell(view, as_json)
