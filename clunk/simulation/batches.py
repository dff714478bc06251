"""Batches of drivelines, prepared together as arrays: one study with many sets of values of any of its keys."""

import functools
from collections.abc import Iterator, Sequence

import numpy as np

from clunk.core.batches import UnlikeError, alike
from clunk.core.exact.flows import Flows
from clunk.core.regimes import driveline_at
from clunk.core.rk4.propagator import build_steps
from clunk.core.tile import Batch
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import WAVES
from clunk.simulation.measures import channels_of
from clunk.simulation.system import prepare
from clunk.study.arrays import Floats, Positions
from clunk.study.parameters import located
from clunk.study.rules import count_of_flows
from clunk.study.study import Study, replace_values

_MOST = 512  # drivelines in a batch, with two flows 14 MB of tables: each has a small share in the batch's 5 ms
_MEASURED = 128  # drivelines in a batch with channels, whose tables take some 100 KB for each driveline
_ENTRIES = 2**18  # of the matrices of all flows in a batch, with some 250 bytes of tables for each entry: 64 MB


@functools.lru_cache(maxsize=4)
def prepare_one(study: Study) -> Batch:
    """The switched linear system of a study, the tables of its method, and the channels of its measures, if any.

    The latest results are cached, as preparing takes a third of the time of a small sweep or of a call with few points.
    Studies that differ only in loads and backlashes share a result if it is asked for by their `of_system`.
    """
    return next(_batches(study, Driveline.from_study(study)))[1]


def of_system(study: Study) -> Study:
    """Study without its load's torques and times, its backlashes, title and sweep, which do not change its system."""
    kept = {"on", "profile", WAVES.get(study.load.profile)}
    load = study.load.but(**dict.fromkeys(study.load.model_fields_set - kept))
    lashes = tuple(lash.but(backlash_deg=0.0) for lash in study.lashes)
    lash = lashes if isinstance(study.lash, tuple) else lashes[0]
    return study.alone.but(title="", load=load, lash=lash)


def prepare_many(study: Study, parameters: Sequence[str], values: Floats) -> Iterator[tuple[Positions, Batch]]:
    """Switched linear systems of a study with many sets of values, and the tables of its method: `system.prepare`.

    Yields batches of drivelines of the same structure, each with the positions of its drivelines in `values`. The
    numbers of a driveline are bit for bit those that it has when prepared alone.

    Parameters
    ----------
    parameters : of str
        Dotted keys of the config.
    values : (D, parameters) float64, in the keys' units
        A row of values for each driveline, each of which a config may hold.

    Raises
    ------
    ConfigError
        Where breakpoints cross.
    ClunkError
        Where rigid lashes are in a ring or side by side.
    """
    if not values.size:
        return
    places, keys, _ = zip(*(located(study, parameter) for parameter in parameters), strict=True)
    # Drivelines differ in structure where one value is zero and another is not (a spring, damper or friction or none),
    # where one is a ratio of 1 and another is not (no gear or one), and where whole numbers differ.
    is_ratio, is_whole = [place[-1] == "ratio" for place in places], [key.whole for key in keys]
    signs = np.where(is_ratio & (abs(values) == 1.0), 2.0, 1.0) * np.sign(values)
    structures = np.where(is_whole, values, signs)
    most, count = most_prepared(study), len(values)
    waiting = np.split(np.arange(count), range(most, count, most))  # positions of each batch
    while waiting:
        part = waiting.pop(0)
        try:
            alike(structures[part])
            first = replace_values(study, dict(zip(parameters, values[part[0]].tolist(), strict=True)))
            line = Driveline.from_study(first, {place: values[part, k] for k, place in enumerate(places)})
            batches = [*_batches(first, line)]
        except UnlikeError as unlike:
            waiting = [*(part[some] for some in unlike.parts), *waiting]
        else:
            yield from ((part[some], batch) for some, batch in batches)


def most_prepared(study: Study) -> int:
    """Most drivelines in a batch of a study, so that their memory is bounded however many flows each has."""
    entries = count_of_flows(study) * (2 * len(study.driveline.inertias)) ** 2
    return min(_MEASURED if study.measured else _MOST, max(1, _ENTRIES // entries))


def _batches(study: Study, line: Driveline) -> Iterator[tuple[Positions, Batch]]:
    """Batches of one driveline or of many, with positions: one batch for the exact method, one a driveline for rk4."""
    systems, flows = prepare(study, line)
    systems = systems if line.varied else driveline_at(systems, None)
    batch = Batch(systems, flows, channels_of(study, line, systems) if study.measured else None)
    count = len(flows.modal)
    if study.solver.method == "exact":
        yield np.arange(count), batch
        return
    steps = np.broadcast_to(line.varied.get(("solver", "step"), study.solver.step), count)
    for k in range(count):
        one = batch.at([k])
        system, tables = build_steps(one.system, Flows._make(table[k] for table in flows), steps[k])
        yield np.array([k]), Batch(driveline_at(system, None), tables, one.channels)
