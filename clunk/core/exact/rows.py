"""The rows of numbers by which runs take steps, and searches look for something.

A row begins with the modal coordinates of a run, C of them, and the amplitudes of their pairs; what is named
here comes behind them.
"""

from clunk.core.jit import unowned_inlined

# A run's numbers that steps change.
ELAPSED = 0  # s, in the phase
LEFT_OUT = 1  # how many of the fastest pairs are left out of the guards
WINDOW_MAX, WINDOW_MIN = 2, 3  # extremes of the acceleration since the last primary impact
PHASE_MAX, PHASE_MIN = 4, 5  # and in the phase
ZERO = 6  # which guard is zero, and how many of its derivatives are, see `zero_of`
SEEN, SEEN_SLOPE, SEEN_CURVATURE = 7, 8, 9  # the acceleration at the end of the last step
TRY = 10  # s, the longest span that is proposed next
CHANGING = 11
# And those that they do not change. A step reads 8 numbers at a time: with 32 in all it is 2 % quicker than with 40.
MARGIN = 11
LIMIT = 12  # s, from the phase's beginning to the end of the run, or of the load's piece
HELD_FROM = 13  # s, from the phase's beginning until a contact has held for the sticking time
SIDE = 14  # by which the guards' signs are those of the group's first regime: 1 or -1
SCALE = 15  # of the guards' margins
SHIFT = 16  # of each guard
# Behind the last guard's: the regime's inputs, INPUTS of them, when the phase or the load's piece began, and whether
# the load, which may change at LIMIT, has not come to rest. Without ramps and kinks, a step does not read the last two.

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
def zero_of(guard: int, order: int) -> float:
    """The number for a guard, of which so many derivatives are zero, itself included, at most 3; without any, 0."""
    return float(4 * guard + order) if guard >= 0 and order > 0 else 0.0


@unowned_inlined
def guard_and_order(zero: float) -> tuple[int, int]:
    """The guard and the order of `zero_of`; without any, -1 and 0."""
    return (int(zero) // 4, int(zero) % 4) if zero > 0.0 else (-1, 0)
