"""The rows of numbers by which runs take steps, and searches look for something.

A row begins with the modal coordinates of a run, C of them, and the amplitudes of their pairs; what is named
here comes behind them.
"""

from clunk.core.jit import unowned_inlined
from clunk.core.regimes import INPUTS

# A run's numbers that steps change.
ELAPSED = 0  # s, in the phase
LEFT_OUT = 1  # how many of the fastest pairs are left out of the guards
WINDOW_MAX, WINDOW_MIN = 2, 3  # extremes of the acceleration since the last primary impact
PHASE_MAX, PHASE_MIN = 4, 5  # and in the phase
ZERO_GUARD, ZERO_ORDER = 6, 7  # the guard that is zero, or -1, and how many of its derivatives are, itself included
SEEN, SEEN_SLOPE, SEEN_CURVATURE = 8, 9, 10  # the acceleration at the end of the last step
TRY = 11  # s, the longest span that is proposed next
CHANGING = 12
# And those that they do not change.
MARGIN = 12
LIMIT = 13  # s, from the phase's beginning to the end of the run, or of the load's piece
HELD_FROM = 14  # s, from the phase's beginning until a contact has held for the sticking time
KINK = 15  # whether the load, which may change at LIMIT, has not come to rest
INPUT = 16  # the inputs of the regime's flow, INPUTS of them, when the phase or the load's piece began
GUARDS = INPUT + INPUTS
SIGN, SHIFT, SCALE = range(3)  # of each guard; the scale is that of its margin
OF_A_GUARD = 3

# A search's numbers, those that change most often first.
TIME_LEFT = 0  # s; of a depth, in shortest spans
TOP, BOTTOM = 1, 2  # extremes: largest and smallest value so far; turn: both the lowest; depth: the bar, and the depth
AT, AT_SLOPE, AT_CURVATURE, AT_JERK = 3, 4, 5, 6  # the origin's value and first three derivatives
BY_SIGN, BY_SHIFT = 7, 8  # what makes a guard of the functional
COUNTS = 9  # s, how much of the time left there is when turns begin to count
OF_A_SEARCH = 10
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
