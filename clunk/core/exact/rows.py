"""The rows of numbers by which runs take their steps.

A row begins with the modal coordinates, C of them, and the amplitudes of their pairs; what follows is named here.
"""

# Of a run. The first are those that change within a phase: how many of the fastest pairs are left out of its guards;
# its margin; the extremes of its window and of its phase; which guard is zero, +n the first with n - 1 derivatives, -n
# the second; the acceleration and its derivatives; how long a span may be that is tried next.
(
    ELAPSED, LEVEL, MARGIN, HIGH, LOW, LARGEST, SMALLEST, ZERO, SEEN, SEEN_SLOPE, SEEN_CURVATURE, TRY,
    TORQUE, HALF_GAP, SIDE, LIMIT, HELD_FROM, STATIC,
) = range(18)  # fmt: skip
CHANGING, OF_A_RUN = 12, 18

# Of what a run looks for within a step, what changes most often first: the time left, the bars, the origin's value,
# slope and curvature, the sign and shift that make a guard of the functional, and within which of the time left a turn
# counts.
REST, TOP, BOTTOM, AT, AT_SLOPE, AT_CURVATURE, SIGN, SHIFT, COUNTS = range(9)
OF_A_SEARCH = 9
# Which of a run's rows that is: of the extremes of the acceleration, of the lowest turn of either guard, and of how
# deep a guard would go after an event.
EXTREMES_TASK = DEPTH_TASK = 0
TURN_TASK = 1  # and the next
TASKS = 4  # places for them; a power of two is quicker
