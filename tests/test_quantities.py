"""Quantities of runs: described once, found by their words, and the same whether runs or a map are asked."""

import numpy as np
import pytest

import clunk
from clunk.results.labels import double_sided
from clunk.results.quantities import measuring, quantities_of, quantity_of
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError

RIG = '[driveline]\npreset = "boere-2008"\n[lash]\nbacklash_deg = 6.0\n[solver]\nmethod = "exact"\n'
AXIS = '[[sweep.axes]]\nparameter = "load.ratio"\nvalues = [0.0, 2.0, 5.0, 8.0]\n'
LARGEST = '[[measures]]\nname = "hit"\nquantity = "contact torque"\nof = 1\nreduce = "largest"\n'
SPREAD = '[sweep.sampling]\ncount = 8\n[[sweep.tolerances]]\nparameter = "lash.contact.stiffness"\nstd = 0.05\n'
SPREAD += 'draws = "factor"\ndistribution = "normal"\n'


@pytest.fixture(scope="module")
def results():
    """A few runs, whose torque was measured, and one of which fails for want of events."""
    return clunk.sweep(study_from_text(RIG + 'max_events = 60\n[impacts]\nquantities = ["energy"]\n' + LARGEST + AXIS))


def test_every_quantity_of_a_map_has_a_value_in_each_of_its_cells(results):
    asked = {text: quantity_of(text, results) for text in quantities_of(results)}
    assert {"label", "severity", "margin", "hit", "energy", "chatter", "double_sided"} <= set(asked)
    for text, quantity in asked.items():
        values = quantity.of_runs(results)
        assert (quantity.name, values.shape) == (text, results.shape)
        assert quantity.heading
        if quantity.type == "yes/no":
            assert set(values[results.sequence >= 0]) <= {0.0, 1.0}
        elif quantity.type == "label":
            assert np.array_equal(values, results.label_map)
        elif text == "double_sided_impacts":
            assert values.tolist() == [double_sided(label) for label in results.label_map]
        else:
            assert np.array_equal(values, np.where(results.sequence < 0, np.nan, results.values(text)), equal_nan=True)


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("severity<=8000", lambda runs: runs.severity <= 8000.0),
        ("hit > 10", lambda runs: runs.values("hit") > 10.0),
        ("touches=0", lambda runs: runs.touches == 0),
        ("last_event_time<0.5", lambda runs: np.nan_to_num(runs.last_event_time) < 0.5),
        ("label = D(1)+S(1)", lambda runs: runs.label_map == "DS(1)SS(1)"),
        ("NI", lambda runs: runs.label_map == "NI"),
        ("SS", lambda runs: np.strings.find(runs.label_map, "SS") >= 0),
        ("ds", lambda runs: np.strings.find(runs.label_map, "DS") >= 0),
        (" ds =0", lambda runs: np.strings.find(runs.label_map, "DS") < 0),
        ("OS", lambda runs: np.zeros(runs.shape, bool)),  # for these the torque would have to reverse
        ("CR", lambda runs: np.zeros(runs.shape, bool)),
        ("chatter", lambda runs: runs.touches > runs.primary_impacts),
    ],
)
def test_a_relation_holds_where_its_number_or_label_does(results, text, holds):
    values = quantity_of(text, results).of_runs(results)
    finished = results.sequence >= 0
    assert np.array_equal(values[finished] == 1.0, holds(results)[finished])
    assert np.isnan(values[~finished]).all()


def test_a_study_is_measured_by_what_its_quantities_need_and_by_nothing_else():
    study = study_from_text(RIG + LARGEST + AXIS)
    asked = [quantity_of(text, study) for text in ("energy<=1", "severity")]
    wanted = measuring(study, asked)
    assert (wanted.impacts.quantities, wanted.measures) == (("energy",), ())
    assert [each.name for each in measuring(study, [quantity_of("hit", study)]).measures] == ["hit"]


def test_what_holds_for_labels_has_a_probability_in_a_tolerance_map():
    tolerances = clunk.tolerance_map(study_from_text(RIG + AXIS + SPREAD))
    probabilities = [quantity_of(f"label={each}", tolerances).of_runs(tolerances) for each in tolerances.labels]
    assert sum(probabilities) == pytest.approx(1.0, abs=1e-12)  # nothing failed
    quantiles = [quantity_of(f"severity_{level}", tolerances).of_runs(tolerances) for level in (5, 50, 95)]
    assert (np.diff(quantiles, axis=0) >= 0.0).all()
    with pytest.raises(ClunkError, match='no quantity "touches"'):
        quantity_of("touches", tolerances)


def test_a_label_alone_is_no_quantity_and_is_named_as_it_was_written(results):
    with pytest.raises(ClunkError, match=r'no quantity "DS\(2\)" here.*label=DS\(1\)SS\(1\)'):
        quantity_of("DS(2)", results)


def test_an_unmeasured_quantity_says_how_to_measure_it(results):
    with pytest.raises(ClunkError, match=r"impacts\.quantities = \['impulse'\]"):
        quantity_of("impulse", results)
    for name in ("impulse", "peak_shaft_torque"):
        with pytest.raises(ClunkError, match=rf'no quantity "{name}" here; there are label, severity'):
            results.values(name)
