"""Primary impacts, and the label of a sequence of them.

A touch is *primary* on the flank other than the last one, or on the same flank after separation from sticking (a
contact episode longer than the sticking time; the preloaded contact counts as sticking). Every other touch is
*secondary*, chatter. Report §3.2. In the restitution model, whose rebounds take no time, an episode begins with the
lock, and its sticking time is zero: the locked state is sticking.
"""

from collections.abc import Iterable
from itertools import groupby

import numpy as np

from clunk.core.arrays import IntArray, Records
from clunk.core.events import LOCK, SEPARATION, TOUCH
from clunk.core.jit import compiled, inlined_part

INITIAL = -1
OPPOSITE = 1


@inlined_part
def is_primary(side: int, last_side: int, from_sticking: bool) -> bool:
    """Whether a touch of a flank is primary, after one of another flank or a separation from sticking."""
    return side != last_side or from_sticking


@inlined_part
def is_sticking(lasted: float, sticking_time: float) -> bool:
    """Whether a contact that lasted so long counts as sticking  [s]."""
    return lasted > sticking_time


@compiled
def find_primaries(
    events: Records,
    count: int,
    lash: int,
    initial_side: int,
    sticking_time: float,
    primaries: IntArray,
) -> int:
    """Write the indices of a lash's primary impacts among `events[:count]` to `primaries`; return how many there are.

    Parameters
    ----------
    events : (capacity,) EVENT
        In order of time; event 0 is the load step.
    initial_side : int
        The lash's preloaded flank (0: none).
    sticking_time : float  [s]
    primaries : (capacity,) int64
        Output.
    """
    last_side = initial_side
    episode_began = -np.inf  # the preloaded contact has lasted for ever
    from_sticking = False
    impacts = 0
    for k in range(1, count):
        event = events[k]
        if event.lash != lash:
            continue
        if event.kind == TOUCH:
            if is_primary(event.side, last_side, from_sticking):
                primaries[impacts] = k
                impacts += 1
            last_side = event.side
            episode_began = event.time
            from_sticking = False
        elif event.kind == LOCK:
            episode_began = event.time
        elif event.kind == SEPARATION:
            from_sticking = is_sticking(event.time - episode_began, sticking_time)
    return impacts


def label(flanks: Iterable[int]) -> str:
    """The run-length label of the primaries' flanks, for example O I I (+1, -1, -1) -> DS(1)SS(1).

    Parameters
    ----------
    flanks : of int
        +1 opposite, -1 initial, in order of time.

    Notes
    -----
    From the initial flank, I is a single-sided impact (SS) and O begins a crossing that the next I completes to a
    double-sided one (DS). O again from the opposite flank is OS, written before its DS; a crossing without its I is CR.
    """
    excursions: list[str] = []
    on_opposite = False
    for flank in flanks:
        if on_opposite:
            excursions.append("DS" if flank == INITIAL else "OS")
            on_opposite = flank == OPPOSITE
        elif flank == INITIAL:
            excursions.append("SS")
        else:
            on_opposite = True
    if on_opposite:
        excursions.append("CR")
    return "".join(f"{excursion}({len(list(run))})" for excursion, run in groupby(excursions)) or "NI"
