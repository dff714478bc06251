"""What a run leaves behind: its events in order, each with what followed it.

Event 0 is the load step itself. Every event opens a phase that lasts to the next one; the extremes of the acceleration
over that phase are kept with it, one-sided limits at both ends included, so that the peak-to-peak value of a primary
impact's window is the extremes of the phases in it. (The exact method locates those that count there, and no others.)
"""

import numpy as np

LOAD_STEP = 0
TOUCH = 1  # the gap closes
SEPARATION = 2  # the contact ends: the gap opens, or the contact force turns tensile
REJOIN = 3  # separation by force only: the force turns compressive while the flanks still overlap
OPENING = 4  # separation by force only: the flanks stop overlapping
LOCK = 5  # restitution only, with the touch before it: the flanks stay together
STAGE = 6  # the twist of a staged shaft passes a breakpoint; written only where the states at events are kept

KIND_NAMES = ("load step", "touch", "separation", "rejoin", "opening", "lock", "stage")

EVENT = np.dtype(
    [
        ("time", np.float64),  # s after the load step
        ("speed", np.float64),  # rad/s, q' = θ'i - θ'j just before
        ("max_acceleration", np.float64),  # rad/s2, over the phase that follows
        ("min_acceleration", np.float64),  # rad/s2
        ("kind", np.int64),
        ("regime", np.int64),  # the one that follows, see clunk.core.regimes
        ("side", np.int64),  # the flank concerned: sign of q on it; at the load step 0 if the gap is open
    ],
    align=True,
)
