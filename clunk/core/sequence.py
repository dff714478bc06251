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

COURSE = record_of(  # the history of one lash's contact in a run so far
    last_side="i8",  # the flank of the last touch, at first the preloaded one (0: none)
    from_sticking="i8",  # whether the flanks have separated from sticking since that touch
    contact_began="f8",  # s, begin of the last contact; -inf for the preloaded one
    static="f8",  # exact only: overlap of the flanks at rest, rad, or torque that locks rigid flanks at rest, N m
    fastest="f8",  # rad/s, speed of the fastest touch of rigid flanks
    least="f8",  # the lash's margin, written when the run ends, see clunk.core.exact.margins; NaN by rk4
    margin="f8",  # exact only: margin of the last touch of rigid flanks; it counts if the next is of the same flank
)


@inlined_part
def is_primary(side: int, last_side: int, from_sticking: bool) -> bool:
    """Whether a touch is primary: not of the flank of the last touch, or after a separation from sticking."""
    return side != last_side or from_sticking


@inlined_part
def take_event(course: Any, event: Any, sticking_time: float) -> bool:
    """Update the COURSE of a lash by one of its events; return whether the event is a primary impact.

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
