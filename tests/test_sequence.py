"""Which touches are primary impacts, and what a sequence of them is called (report §3.2)."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st

from clunk.core.events import EVENT, LOAD_STEP, OPENING, REJOIN, SEPARATION, TOUCH
from clunk.core.sequence import COURSE, label, take_event

STICKING = 0.004  # s


def primaries(*happened, initial=-1, sticking_time=STICKING):
    """Indices of the primary impacts among (time, kind, side), counted from 1: event 0 is the load step."""
    events = np.zeros(len(happened) + 1, EVENT)
    events[0]["kind"], events[0]["lash"] = LOAD_STEP, -1
    for k, (time, kind, side) in enumerate(happened, start=1):
        events[k]["time"], events[k]["kind"], events[k]["side"] = time, kind, side
    course = np.zeros(1, COURSE).view(np.recarray)[0]
    course.last_side, course.contact_began = initial, -np.inf
    return [k for k, event in enumerate(events.view(np.recarray)) if take_event(course, event, sticking_time)]


@pytest.mark.parametrize(
    ("flanks", "name"),
    [
        ("", "NI"),
        ("I", "SS(1)"),
        ("II", "SS(2)"),
        ("OI", "DS(1)"),
        ("OII", "DS(1)SS(1)"),
        ("OIII", "DS(1)SS(2)"),
        ("OIOI", "DS(2)"),
        ("OIOII", "DS(2)SS(1)"),
        ("OIOIOI", "DS(3)"),
        ("IOI", "SS(1)DS(1)"),
        ("OIIOI", "DS(1)SS(1)DS(1)"),
        # what the report does not meet
        ("O", "CR(1)"),
        ("IO", "SS(1)CR(1)"),
        ("OIO", "DS(1)CR(1)"),
        ("OOI", "OS(1)DS(1)"),
        ("OOOII", "OS(2)DS(1)SS(1)"),
        ("OIOOI", "DS(1)OS(1)DS(1)"),
        ("OO", "OS(1)CR(1)"),
    ],
)
def test_labels_are_run_lengths_of_excursions(flanks, name):
    """OS: left the opposite flank and came back to it. CR: a crossing that the run does not complete."""
    assert label(1 if flank == "O" else -1 for flank in flanks) == name


@given(st.lists(st.sampled_from([1, -1]), max_size=60))
def test_a_label_counts_every_primary_impact(flanks):
    """DS stands for two of them, SS, OS and CR for one."""
    name = label(flanks)
    runs = [] if name == "NI" else [run.split("(") for run in name.rstrip(")").split(")")]
    assert sum((2 if kind == "DS" else 1) * int(length) for kind, length in runs) == len(flanks)
    kinds = [kind for kind, _ in runs]
    assert all(one != other for one, other in pairwise(kinds))
    assert ("CR" in kinds) == (bool(flanks) and flanks[-1] == 1)


def test_the_preloaded_contact_counts_as_sticking():
    """Left at 0.1 ms and touched again: primary, though the contact lasted less than the sticking time."""
    assert primaries((1e-4, SEPARATION, -1), (0.01, TOUCH, -1)) == [2]


def test_a_crossing_out_of_chatter_is_primary():
    assert primaries((0.01, SEPARATION, -1), (0.020, TOUCH, 1), (0.022, SEPARATION, 1), (0.025, TOUCH, -1)) == [2, 4]


@pytest.mark.parametrize(("length", "found"), [(0.999, [2]), (1.001, [2, 4])])
@pytest.mark.parametrize("flank", [1, -1])
def test_a_touch_after_sticking_is_primary(length, found, flank):
    """Sticking is an episode longer than the sticking time; just below it, the same touch is chatter."""
    left = 0.02 + length * STICKING
    happened = [(0.01, SEPARATION, -1), (0.02, TOUCH, flank), (left, SEPARATION, flank), (0.05, TOUCH, flank)]
    assert primaries(*happened) == found


def test_an_episode_that_rejoins_before_the_gap_opens_goes_on():
    """Separation by force: parted and closed again without a gap is one episode from its touch on, hence sticking."""
    happened = [
        (0.010, SEPARATION, -1),
        (0.011, OPENING, -1),
        (0.020, TOUCH, 1),
        (0.022, SEPARATION, 1),
        (0.0221, REJOIN, 1),
        (0.0245, SEPARATION, 1),  # 4.5 ms after the touch, 2.4 ms after the rejoin
        (0.0246, OPENING, 1),
        (0.030, TOUCH, 1),
    ]
    assert primaries(*happened) == [3, 8]
    assert primaries(*happened, sticking_time=0.0046) == [3]
