"""Status of a finished run, an integer in the core with a sentence for the user, and the flags of its quality."""

from enum import IntEnum


class Status(IntEnum):
    """Status of one run, as stored in the results file's `status`; anything but `OK` is a failed cell."""

    OK = 0
    NO_EQUILIBRIUM = 1
    NO_INITIAL_FLANK = 2
    NON_FINITE = 3
    EVENT_BUFFER_FULL = 4
    UNSTABLE_STEP = 5

    @property
    def sentence(self) -> str:
        """The status as a phrase for the user."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "the run finished",
    Status.NO_EQUILIBRIUM: (
        "no steady motion: two parts or more can turn by themselves, joined by no stiffness, a friction slips in it, "
        "a stage without stiffness carries a torque in it, or so little resists it that a part would turn faster than "
        "10⁷ rad/s or by more than 10⁶ rad per N m"
    ),
    Status.NO_INITIAL_FLANK: "no initial flank: the lash carries no torque in the steady motion before the load step",
    Status.NON_FINITE: "the state became infinite or undefined",
    Status.EVENT_BUFFER_FULL: (
        "more events than solver.max_events allows, or more changes of stage, or of what sticks, than are followed; "
        "shorten solver.end_time, or raise a solver.max_events of less than 100,000"
    ),
    Status.UNSTABLE_STEP: (
        "RK4 is unstable with this solver.step; shorten it (clunk modes tells the fastest mode; a load may be faster)"
    ),
}

# The same values as plain integers, which kernels compare.
OK, NO_EQUILIBRIUM, NO_INITIAL_FLANK, NON_FINITE, EVENT_BUFFER_FULL, UNSTABLE_STEP = map(int, Status)
INTERRUPTED = 255  # never stored: the cell has to be run again

# Bits of the results file's `quality`.
QUALITY_COMPLETE = 1  # proved that no event and no larger acceleration can follow
QUALITY_UNDECIDED = 2  # a margin is below its tolerance, or rounding decides the outcome
QUALITY_GRAZING = 8  # a tangency was decided within its tolerance
QUALITY_MEANINGS = {QUALITY_COMPLETE: "complete", QUALITY_UNDECIDED: "undecided", QUALITY_GRAZING: "grazing"}
