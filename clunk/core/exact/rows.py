"""The rows of numbers by which runs take steps, and searches look for something.

A row begins with the modal coordinates of a run, C of them, and the amplitudes of their pairs; what is named
here comes behind them.
"""

from clunk.core.jit import unowned_inlined
from clunk.core.regimes import INPUTS

# A run's numbers that steps change: the time in the phase; how many of the fastest pairs are left out of its guards;
# the extremes of its window and of its phase; which guard is zero, with so many derivatives; the acceleration, its
# slope and curvature; how long a span may be that is tried next.
(
    ELAPSED, LEVEL, HIGH, LOW, LARGEST, SMALLEST, ZERO_GUARD, ZERO_ORDER, SEEN, SEEN_SLOPE, SEEN_CURVATURE, TRY,
) = range(12)  # fmt: skip
CHANGING = 12
# And those that they do not: the margin; the time from the phase's beginning to the end of the run, and until a contact
# has held for the sticking time; the inputs of the regime's flow, INPUTS of them; of each guard the sign, the shift and
# the scale of its margin.
MARGIN, LIMIT, HELD_FROM, INPUT = range(12, 16)
GUARDS = INPUT + INPUTS
SIGN, SHIFT, SCALE = range(3)
OF_A_GUARD = 3

# A search's numbers, those that change most often first: the time left; the largest and the smallest value so far; the
# origin's value, slope and curvature; the sign and shift that make a guard of the functional; within how much of the
# time left a turn counts.
REST, TOP, BOTTOM, AT, AT_SLOPE, AT_CURVATURE, BY_SIGN, BY_SHIFT, COUNTS = range(9)
OF_A_SEARCH = 9
# Which of a run's searches that is: of the acceleration's extremes, or of a depth; of a turn of each guard.
EXTREMES_SEARCH = DEPTH_SEARCH = 0
TURN_SEARCH = 1  # and those behind it

# How a step ends: it goes on, and a span will probably pass, or none will; or its phase does, for the end of the run,
# because nothing can follow, because nothing is finite any more, or by an event.
GOES_ON, NEARS, AT_END, SETTLED, LOST, BY_EVENT = range(6)


@unowned_inlined
def of_guard(guard: int) -> int:
    """Where a guard's numbers begin among those of a run."""
    return GUARDS + OF_A_GUARD * guard
