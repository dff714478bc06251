"""Many drivelines prepared at once: the same study with other values of any of its keys, as arrays."""

import functools
from collections.abc import Iterator, Sequence

import numpy as np

from clunk.core.batches import UnlikeError, alike
from clunk.core.exact.flows import Flows
from clunk.core.regimes import driveline_at
from clunk.core.rk4.propagator import build_steps
from clunk.core.tile import Batch
from clunk.simulation.driveline import Driveline, prepare
from clunk.simulation.load import WAVES
from clunk.simulation.measures import channels_of
from clunk.study.arrays import Floats, Positions
from clunk.study.parameters import located
from clunk.study.rules import count_of_flows
from clunk.study.study import Study, replace_values

_MOST = 512  # drivelines of a batch: of two flows 14 MB of tables, and each one's share in 5 ms is small
_MEASURED = 128  # of those whose channels are tabulated, which take some 100 KB each
_ENTRIES = 2**18  # of all matrices of a batch's flows, of some 250 bytes of tables each: 64 MB


@functools.lru_cache(maxsize=4)
def prepare_one(study: Study) -> Batch:
    """The switched linear system of a study, the tables of its method, and the channels of its measures, if any.

    The latest ones are kept: they are a third of the time of a small sweep, and of a call with few points. By a study
    of `of_system` they are kept for other loads and backlashes, too.
    """
    return next(_batches(study, Driveline.from_study(study)))[1]


def of_system(study: Study) -> Study:
    """The study without its load's torques and times, backlashes and sweep: with others it has the same system."""
    kept = {"on", "profile", WAVES.get(study.load.profile)}
    load = study.load.but(**dict.fromkeys(study.load.model_fields_set - kept))
    lashes = tuple(lash.but(backlash_deg=0.0) for lash in study.lashes)
    lash = lashes if isinstance(study.lash, tuple) else lashes[0]
    return study.alone.but(title="", load=load, lash=lash)


def prepare_many(study: Study, parameters: Sequence[str], values: Floats) -> Iterator[tuple[Positions, Batch]]:
    """The switched linear systems of a study with other values, and the tables of its method: see `driveline.prepare`.

    Yields batches of those that are alike but for numbers, each with the positions of its drivelines in `values`. The
    bits of each are those that it has alone.

    Parameters
    ----------
    parameters : of str
        Dotted keys.
    values : (D, parameters) float64, in the keys' units
        Such as a config may hold.

    Raises
    ------
    ConfigError
        Where breakpoints cross.
    """
    if not values.size:
        return
    places, keys, _ = zip(*(located(study, parameter) for parameter in parameters), strict=True)
    # what is no spring, damper or friction where it is zero, no gear where it is 1, and whole numbers, make another
    # kind of driveline
    is_ratio, is_whole = [place[-1] == "ratio" for place in places], [key.whole for key in keys]
    signs = np.where(is_ratio & (abs(values) == 1.0), 2.0, 1.0) * np.sign(values)
    kinds = np.where(is_whole, values, signs)
    most, count = most_prepared(study), len(values)
    waiting = np.split(np.arange(count), range(most, count, most))  # positions of each batch
    while waiting:
        part = waiting.pop(0)
        try:
            alike(kinds[part])
            first = replace_values(study, dict(zip(parameters, values[part[0]].tolist(), strict=True)))
            line = Driveline.from_study(first, {place: values[part, k] for k, place in enumerate(places)})
            batches = [*_batches(first, line)]
        except UnlikeError as unlike:
            waiting = [*(part[some] for some in unlike.parts), *waiting]
        else:
            yield from ((part[some], batch) for some, batch in batches)


def most_prepared(study: Study) -> int:
    """Most drivelines of a batch of a study's: what they take in memory is bounded, however many flows each has."""
    entries = count_of_flows(study) * (2 * len(study.driveline.inertias)) ** 2
    return min(_MEASURED if study.measured else _MOST, max(1, _ENTRIES // entries))


def _batches(study: Study, line: Driveline) -> Iterator[tuple[Positions, Batch]]:
    """The batches of a driveline, or of those with other numbers than a study's: of the exact method one."""
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
        assert isinstance(one.tables, Flows)
        system, tables = build_steps(one.system, Flows._make(table[0] for table in one.tables), steps[k])
        yield np.array([k]), Batch(driveline_at(system, None), tables, one.channels)
