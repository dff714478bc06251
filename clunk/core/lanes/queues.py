"""What runs wait for, each by the kind of their regime, turns and depths also by the guard."""

from clunk.core.jit import unowned_inlined

KINDS = 3  # of regimes, that take steps together: open; closed on either side; parted on either side

SPAN, PART, ENTER = 0, KINDS, 2 * KINDS  # a step; a step of a part of the shortest span; entering a regime
EXTREMES, TURN, DEPTH = 3 * KINDS, 4 * KINDS, 6 * KINDS  # what is looked for within a step, or after an event
OVER = 8 * KINDS  # they are over
FOLLOW = OVER + 1  # they have done something, and are to be sent to the next thing


@unowned_inlined
def kind_of(regime: int) -> int:
    """Which kind a regime is of."""
    return (regime + 1) // 2
