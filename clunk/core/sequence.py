"""Primary impacts, and the label of a sequence of them.

A touch is *primary* on the flank other than the last one, or on the same flank after separation from sticking (a
contact episode longer than the sticking time; the preloaded contact counts as sticking). Every other touch is
*secondary*, chatter. Report §3.2. In the restitution model, whose rebounds take no time, an episode begins with the
lock, and its sticking time is zero: the locked state is sticking.
"""

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from clunk.core.arrays import record_of
from clunk.core.events import LOCK, SEPARATION, TOUCH
from clunk.core.jit import inlined_part

INITIAL = -1
OPPOSITE = 1

COURSE = record_of(  # what the flanks of one lash have done so far in a run
    last_side="i8",  # the flank of the last touch, at first the preloaded one (0: none)
    from_sticking="i8",  # whether they have separated from sticking since
    contact_began="f8",  # s, of the last contact; -inf of the preloaded one
    static="f8",  # by exact: the overlap of its flanks at rest, rad, or the torque between rigid ones
    fastest="f8",  # rad/s, of the touches of rigid flanks
    least="f8",  # the margin of the run, see clunk.core.exact.margins; NaN by rk4
    margin="f8",  # of the last touch of rigid flanks, which counts if the next one is of the same flank
)


@inlined_part
def is_primary(side: int, last_side: int, from_sticking: bool) -> bool:
    """Whether a touch of a flank is primary, after one of another flank or a separation from sticking."""
    return side != last_side or from_sticking


@inlined_part
def take_event(course: Any, event: Any, sticking_time: float) -> bool:
    """Take an event of a lash into its COURSE; return whether it is a primary impact.

    sticking_time : float  [s]
    """
    primary = False
    if event.kind == TOUCH:
        primary = is_primary(event.side, course.last_side, course.from_sticking != 0)
        course.last_side, course.contact_began, course.from_sticking = event.side, event.time, 0
    elif event.kind == LOCK:
        course.contact_began = event.time
    elif event.kind == SEPARATION:
        course.from_sticking = event.time - course.contact_began > sticking_time
    return primary


def label(flanks: Iterable[int]) -> str:
    """The run-length label of the primaries' flanks, for example O I I (+1, -1, -1) -> DS(1)SS(1).

    Parameters
    ----------
    flanks : of int
        +1 opposite, -1 initial, in order of time.

    Notes
    -----
    From the initial flank, I is a single-sided impact (SS) and O begins a crossing that the next I completes to a
    double-sided one (DS). O again from the opposite flank is OS, written before its DS or CR; a crossing without its I
    is CR.
    """
    excursions = []
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
