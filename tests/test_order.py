"""A cell's bits depend on its own parameters alone: not on who computes it, when, or beside what."""

import numpy as np
import pytest

from clunk.results.quantities import CELL_QUANTITIES, IMPACT_QUANTITIES
from clunk.study.config import study_from_text
from clunk.sweeping.sweep import sweep

RATIOS, BACKLASHES = np.linspace(0.0, 10.0, 29), np.linspace(0.0, 20.0, 23)
CONTACTS = ['separation = "gap"', 'separation = "force"', 'model = "restitution"']


def run(contact, ratios, backlashes, *, workers=None, backlash_first=False):
    axes = [("load.ratio", ratios), ("lash.backlash_deg", backlashes)]
    text = f'[driveline]\npreset = "boere-2008"\n[lash.contact]\n{contact}\n'
    for parameter, values in reversed(axes) if backlash_first else axes:
        text += f'[[sweep.axes]]\nparameter = "{parameter}"\nvalues = {[float(value) for value in values]}\n'
    return sweep(study_from_text(text), workers=workers)


def cells(results, backlash_first=False):
    """What each cell holds, by its parameters, as bytes; a label by its name."""
    content = {}
    for at in np.ndindex(results.shape):
        k = np.ravel_multi_index(at, results.shape)
        mine = slice(results.first_impact[k], results.first_impact[k + 1])
        code = int(results.sequence[at])
        fields = [getattr(results, name)[at].tobytes() for name in CELL_QUANTITIES if name != "sequence"]
        fields += [getattr(results, name)[mine].tobytes() for name in IMPACT_QUANTITIES if name != "first_impact"]
        values = tuple(float(axis.values[i]) for axis, i in zip(results.axes, at, strict=True))
        content[values[::-1] if backlash_first else values] = (results.labels[code] if code >= 0 else "failed", *fields)
    return content


@pytest.fixture(scope="module", params=CONTACTS)
def contact(request):
    return request.param


@pytest.fixture(scope="module")
def alone(contact):
    """The cells as one worker finds them, in order."""
    return cells(run(contact, RATIOS, BACKLASHES, workers=1))


@pytest.mark.parametrize("workers", [2, 4])
def test_any_number_of_workers_finds_the_same_bits(contact, alone, workers):
    assert cells(run(contact, RATIOS, BACKLASHES, workers=workers)) == alone


@pytest.mark.parametrize("workers", [1, 4])
@pytest.mark.parametrize("seed", [0, 1])
def test_any_order_of_the_cells_finds_the_same_bits(contact, alone, workers, seed):
    """Shuffled axes take every cell to another tile, to other neighbours in it and to another moment."""
    shuffle = np.random.default_rng(seed).permutation
    assert cells(run(contact, shuffle(RATIOS), shuffle(BACKLASHES), workers=workers)) == alone


def test_either_axis_may_come_first(contact, alone):
    assert cells(run(contact, RATIOS, BACKLASHES, workers=2, backlash_first=True), backlash_first=True) == alone


def test_a_part_of_the_map_has_the_bits_of_the_whole(contact, alone):
    part = cells(run(contact, RATIOS[5:11], BACKLASHES[::7], workers=2))
    assert part == {at: alone[at] for at in part}
