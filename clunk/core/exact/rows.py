"""Positions of the numbers of a run in its row of `Workspace.numbers`, and of a search in that of `Workspace.searches`.

A row begins with the run's coordinates in its flow; from the beginning of a stretch to the first step it holds the
state there instead. Positions are counted from the end of these, `Workspace.behind`. In `Pool.work`, whose columns are
lanes, a position is a row.
"""

from clunk.core.jit import inlined_part

# A run's numbers that steps change, and LIMIT and KINK, which they do not.
ELAPSED = 0  # s, since the stretch began
# The guard that is zero as the stretch begins, or -1, and how many of its derivatives are zero there, itself included:
# 0 once a step has been taken.
ZERO_GUARD, ZERO_ORDER = 1, 2
TRY = 3  # s, the longest span that may be proposed next
LIMIT = 4  # s, from the stretch's beginning to the end of the run, or of the load's piece
KINK = 5  # 1 while another piece of the load is still to come, else 0
_FIRST = 6
# Then the numbers of each lash, counted from `of_lash`.
WINDOW_MAX, WINDOW_MIN = 0, 1  # rad/s2, extremes of the acceleration since the last primary impact, as in `runs.Log`
# A step writes back the numbers up to the last lash's window, and does not change those behind it. It reads 8 numbers
# of a row at a time: four inertias with one lash, under a load without a wave, have no more than 32.
MARGIN = 2
HELD_FROM = 3  # s, from the stretch's beginning until a contact has held for the sticking time; -inf without contact
SIDE = 4  # 1 or -1, times which the guards of the group's first regime have this regime's signs
SCALE = 5  # rad or N m, of which the margins of the lash's guards are shares
_OF_LASH = 6
# Behind the numbers of the last lash: the shift of each guard, see `shift`; and the regime's inputs u as the stretch
# began.

# The numbers of a search: first those that change while it goes on.
TIME_LEFT = 0  # s, still to be searched
STRETCH_TIME = 1  # s, since the stretch began
TOP, BOTTOM = 2, 3  # the extremes so far: a turn above TOP or below BOTTOM is looked for, and takes its place
BY_SIGN, BY_SHIFT = 4, 5  # sign and shift that make a guard of the functional
COUNTS = 6  # s: a turn counts only where TIME_LEFT is at most this
UNTIL = 7  # the search ends where the guard is no larger, or at its first turn; -inf: only when no time is left
OF_A_SEARCH = 8  # how many these are; behind them lie the inputs u of the regime, as in the run's row
# The searches of a run are numbered in this order: the extremes of each lash's acceleration; the lowest turn of each
# guard; how deep the guard of an event would go.

# How a step ended.
GOES_ON = 0  # the next step takes a span
NEARS = 1  # the next step takes a part of the shortest span: a guard is near zero, or the flow has no modes
AT_END = 2  # the run, or the load's piece, is over
SETTLED = 3  # it is proved that nothing follows: no event, and no extreme or margin that counts
LOST = 4  # a guard is no longer finite
BY_EVENT = 5  # a guard turned negative: RUN's `guard`


@inlined_part
def of_lash(lash: int) -> int:
    """Position of the first number of a lash."""
    return _FIRST + _OF_LASH * lash


@inlined_part
def shift(guard: int, lashes: int) -> int:
    """Position of the shift of a guard."""
    return of_lash(lashes) + guard
