"""The events of a run in order, each with the regime that follows it.

Event 0 is the load step itself. Every event opens a phase that lasts to the next one. Beside each event are kept the
extremes of each lash's acceleration over its window up to the end of that phase, one-sided limits at all events
included: those beside the last event before the next primary impact are the extremes of the whole window. Where there
is more than one element, a phase shorter than INSTANT does not count for the extremes: simultaneous events of several
elements are written one after the other, and the states between them are not real, in whichever order rounding puts
the events.
"""

from clunk.core.arrays import record_of

LOAD_STEP = 0
TOUCH = 1  # the gap closes
SEPARATION = 2  # the contact ends: the gap opens, or the contact force turns tensile
REJOIN = 3  # separation by force only: the force turns compressive while the flanks still overlap
OPENING = 4  # separation by force only: the flanks stop overlapping
LOCK = 5  # restitution only, after a touch at the same time: the flanks stay together
# A shaft's twist passes a breakpoint, or frictions or flanks at rest change their states without another event; written
# only where states are kept.
STAGE = 6

KIND_NAMES = ("load step", "touch", "separation", "rejoin", "opening", "lock", "stage")

INSTANT = 1e-12  # s: events closer than this are at the same time

EVENT = record_of(
    time="f8",  # s after the load step
    speed="f8",  # rad/s, q' = θ'i - ratio θ'j just before the event
    kind="i8",
    regime="i8",  # the regime that follows, see clunk.core.regimes
    side="i8",  # the flank concerned: sign of q on it; at the load step the first lash's, 0 if it is open
    lash="i8",  # the lash concerned, or -1 for none
    primary="i8",  # whether it is a primary impact, see clunk.core.sequence
)
