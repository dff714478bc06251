"""Where each number of a run, or of a search, lies in its row of `Workspace.numbers`, or of `Workspace.searches`.

A row begins with the coordinates in the run's flow, or with its state until the next step has made these of it; places
are counted from `Workspace.behind`, where these end. In the lanes of `Pool.work` they are rows.
"""

from clunk.core.jit import inlined_part

# A run's numbers that steps change, and LIMIT and KINK, which they do not.
ELAPSED = 0  # s, in the phase
ZERO_GUARD, ZERO_ORDER = 1, 2  # which guard is zero, and how many of its derivatives are, itself included; or none
TRY = 3  # s, the longest span that is proposed next
LIMIT = 4  # s, from the phase's beginning to the end of the run, or of the load's piece
KINK = 5  # 1 while another piece of the load is still to come, else 0
_FIRST = 6
# Then those of each lash, see `of_lash`.
WINDOW_MAX, WINDOW_MIN = 0, 1  # extremes of the acceleration since the last primary impact, as in `runs.Log`
# A step writes back all up to the last lash's window, and leaves alone what lies behind it. It reads 8 numbers at a
# time: four inertias with one lash, under a load without a wave, have no more than 32.
MARGIN = 2
HELD_FROM = 3  # s, from the phase's beginning until a contact has held for the sticking time
SIDE = 4  # by which the guards' signs are those of the group's first regime: 1 or -1
SCALE = 5  # of the guards' margins
_OF_LASH = 6
# Behind the last lash's: the SHIFT of each guard, see `shift`; and the regime's inputs, when the phase or the load's
# piece began.

# A search's numbers, those that change first.
TIME_LEFT = 0  # s
PHASE_TIME = 1  # s since the phase began
TOP, BOTTOM = 2, 3  # a turn is looked for that is higher or lower, and becomes that: the extremes so far
BY_SIGN, BY_SHIFT = 4, 5  # what makes a guard of the functional
COUNTS = 6  # s: a turn counts while TIME_LEFT is at most this
UNTIL = 7  # the search ends below that, and with the first turn; -inf: it goes on until no time is left
OF_A_SEARCH = 8  # and then the regime's inputs, as in the run's row
# A run's searches, in this order: of the extremes of each lash's acceleration; of the lowest turn of each guard; of how
# deep the guard of an event would go.

# How a step ended.
GOES_ON = 0  # the next one is of a span
NEARS = 1  # the next one is of a part of the shortest span: a guard is near zero
AT_END = 2  # of the run, or of the load's piece
SETTLED = 3  # it is proved that nothing follows
LOST = 4  # nothing is finite any more
BY_EVENT = 5  # a guard turned negative: RUN's `guard`


@inlined_part
def of_lash(lash: int) -> int:
    """Position of the first number of a lash."""
    return _FIRST + _OF_LASH * lash


@inlined_part
def shift(guard: int, lashes: int) -> int:
    """Place of a guard's SHIFT."""
    return of_lash(lashes) + guard
