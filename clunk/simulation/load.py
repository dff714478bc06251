"""The load: a steady torque until the load step, and from then on a profile that consists of pieces."""

from collections.abc import Mapping
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np

from clunk.core.runs import BEGIN, LEVEL, PIECE, SLOPE
from clunk.core.tables import INPUTS, TORQUE, Number, half_gap_of
from clunk.core.tile import Cases
from clunk.study.arrays import Floats
from clunk.study.document import Place, dotted
from clunk.study.errors import ConfigError
from clunk.study.loads import Load
from clunk.study.study import Study

# s; a shorter duration or time constant counts as 0: on so steep a slope, rounding would move events by more than this
_SHORTEST = 1e-9
# s; a shorter line counts as a step in its middle, which moves events by some 1e-10 s: rounding would move them by more
# where the driveline rolls with next to no drag
_STEEPEST = 1e-7


def loads_of(load: Load, count: int, **swept: Number) -> tuple[Floats, Floats]:
    """Torques on the loaded inertia in `count` runs.

    Returns the torque before the load step, (count,)  [N m], and the pieces of the load after it, (1 or count, P,
    PIECE), see `clunk.core.runs`; they have one row where they are the same in all runs.

    `swept` values, (count,) each or one for all, replace those of the config's keys with the same names,
    ``torques[n]`` and ``durations[n]`` among them; values that the profile does not use make no difference. Raises
    ConfigError where times of a table decrease.
    """
    values = dict(load) | swept
    before: Number
    if load.profile == "table":
        torques = _entries(values, "torques", count) * np.reshape(values["scale"], (-1, 1))
        before, pieces = torques[:, 0], _lines(_entries(values, "times", count), torques)
    elif load.profile == "steps":
        column, rest = (np.reshape(torque, (-1, 1)) for torque in _torques(values))
        durations, levels = _span(_entries(values, "durations", count)), _entries(values, "levels", count)
        before, pieces = column[:, 0], _held(durations, column + (rest - column) * levels, rest)
    else:
        before, pieces = _profile(values)
    return np.broadcast_to(before, count).astype(np.float64), pieces


def _entries(values: Mapping[str, Any], key: str, count: int) -> Floats:
    """Values of a list in the config: for each run, (count, P), if any of its items is swept, else (1, P)."""
    swept = [name for name in values if name.startswith(f"{key}[")]
    entries = np.array(values[key], dtype=np.float64)[np.newaxis].repeat(count if swept else 1, axis=0)
    for name in swept:
        entries[:, int(name[len(key) + 1 : -1]) - 1] = values[name]
    return entries


def _lines(times: Floats, torques: Floats) -> Floats:
    """Pieces, (rows, P, PIECE), of straight lines between points in time; two points at the same time are a jump.

    So are two that are less than `_STEEPEST` apart, in the middle between them. Raises ConfigError where the times of a
    row decrease.
    """
    times, torques = np.broadcast_arrays(times, torques)
    between = np.diff(times)
    if (between < 0.0).any():  # where swept, times have been checked one by one only
        raise ConfigError("load.times decrease in one of the runs.")
    is_steep = between < _STEEPEST
    pieces = np.zeros((*times.shape, PIECE))
    pieces[:, :-1, SLOPE] = np.diff(torques) / np.where(is_steep, np.inf, between)
    pieces[..., BEGIN], pieces[..., LEVEL] = times, torques
    earlier = 0.5 * np.where(is_steep, between, 0.0)
    pieces[:, 1:, BEGIN] -= earlier
    pieces[:, 1:, LEVEL] -= earlier * pieces[:, 1:, SLOPE]
    return pieces


def _held(durations: Floats, torques: Floats, rest: Floats) -> Floats:
    """Pieces, (rows, P + 1, PIECE), that hold each torque for its duration, (rows, P), and then `rest`, (rows, 1)."""
    begins = np.pad(durations, ((0, 0), (1, 0))).cumsum(axis=1)
    pieces = np.zeros((max(len(begins), len(torques), len(rest)), begins.shape[1], PIECE))
    pieces[..., BEGIN], pieces[:, :-1, LEVEL], pieces[:, -1:, LEVEL] = begins, torques, rest
    return pieces


def _torques(values: Mapping[str, Any]) -> tuple[Number, Number]:
    """Torques before the load step and after the change; the dynamic torque Td = σr Ts is released (report Eq. 2.4)."""
    if values["ratio"] is None:
        return values["initial_torque"], values["final_torque"]
    return values["static_torque"] * (1.0 + values["ratio"]), values["static_torque"]


def _profile(values: Mapping[str, Any]) -> tuple[Number, Floats]:
    """Torque before the load step and pieces, (rows, P, PIECE), of a profile from one torque to another."""
    before, after = _torques(values)
    change, rest = after - before, (after, 0.0, 0.0, 0.0)
    match values["profile"]:
        case "ramp":
            points = _rows((0.0, before), (_span(values["duration"]), after))
            return before, _lines(points[..., 0], points[..., 1])
        case "smooth":
            end = _span(values["duration"])
            return before, _rows((0.0, before + change / 2, 0.0, -change / 2, 0.0), (end, *rest))
        case "lag":
            return before, _rows((0.0, after, 0.0, np.where(_span(values["time_constant"]) > 0.0, -change, 0.0), 0.0))
        case "pulse":
            return before, _rows((0.0, *rest), (_span(values["duration"]), before, 0.0, 0.0, 0.0))
        case "sine":
            return before, _rows((0.0, after, 0.0, 0.0, values["amplitude"]))
    return before, _rows((0.0, *rest))


def _span(time: Number) -> Floats:
    return np.where(time < _SHORTEST, 0.0, time)


def _divisor(time: Floats) -> Floats:
    """Times to divide by, infinite where they count as 0: the quotient, a rate, is then 0."""
    return np.where(time < _SHORTEST, np.inf, time)


def _rows(*pieces: tuple[Number, ...]) -> Floats:
    """Pieces or points, (rows, P, columns), from columns broadcast against each other; one row if all are numbers."""
    return np.stack(np.broadcast_arrays(*chain(*pieces)), axis=-1).reshape(-1, len(pieces), len(pieces[0]))


WAVES = {"smooth": "duration", "lag": "time_constant", "sine": "frequency"}  # profile -> key of the wave's rate


def wave_rates(load: Load, varied: Mapping[Place, Floats]) -> Floats | None:
    """The matrix S of a load's wave, w' = S w, (2, 2)  [1/s]; None where the profile has no wave.

    varied : values of keys that differ in a batch of D drivelines; S is (D, 2, 2) if the key of its rate is one of them
    """
    if load.profile not in WAVES:
        return None
    key = WAVES[load.profile]
    value = np.asarray(varied.get(("load", key), getattr(load, key) or 0.0), np.float64)
    swing = decay = np.zeros(value.shape)
    if load.profile == "smooth":
        swing = np.pi / _divisor(value)
    elif load.profile == "sine":
        swing = 2.0 * np.pi * value
    else:
        decay = 1.0 / _divisor(value)
    decay = np.where((swing == 0.0) & (decay == 0.0), 1.0, decay)  # a step: its wave, zero, may have any rate
    return np.stack([-decay, swing, -swing, -decay], axis=-1).reshape(*value.shape, 2, 2)


def cases_of(study: Study, values: Mapping[str, Number] = MappingProxyType({}), count: int = 1) -> Cases:
    """Torques and gaps of `count` runs with these values of parameters, (count,) each or one for all runs.

    Raises ConfigError where times of a table decrease.
    """
    swept = {key.removeprefix("load."): values[key] for key in values if key.startswith("load.")}
    torque, pieces = loads_of(study.load, count, **swept)
    before = np.zeros((count, INPUTS + len(study.lashes) - 1))
    before[:, TORQUE] = torque
    for k, (place, lash) in enumerate(study.placed_lashes):
        gap = values.get(dotted((*place, "backlash_deg")), lash.backlash_deg)
        before[:, half_gap_of(k)] = np.deg2rad(gap) / 2
    return Cases(before, pieces, np.zeros(1, np.int64))


def run_load(study: Study) -> tuple[Floats, Floats]:
    """Inputs d of a run before its load step  [N m, rad, N m/s], and the pieces of its load, (P, PIECE)."""
    cases = cases_of(study)
    return cases.before[0], cases.loads[0]
