"""Maps in the formats of other programs hold what the results file holds."""

import csv

import numpy as np
import pytest
from conftest import BOERE
from test_store import BACKLASH, INERTIA, RATIO, example
from test_tolerances import study, tolerance

import clunk as clunk_api
from clunk.results import store
from clunk.results.export import save
from clunk.results.maps import QUANTILES
from clunk.study.config import study_from_text


@pytest.fixture(scope="module")
def probabilities():
    return clunk_api.tolerance_map(study(tolerance("load.ratio"), count=4, base=BOERE))


@pytest.mark.parametrize("axes", [(RATIO,), (RATIO, BACKLASH), (INERTIA, RATIO, BACKLASH)], ids=len)
def test_each_cell_is_a_row_of_the_table_with_its_words_and_numbers(tmp_path, axes):
    results = example(*axes)
    save(tmp_path / "map.csv", results)
    rows = list(csv.DictReader((tmp_path / "map.csv").read_text("utf-8").splitlines()))
    assert len(rows) == results.sequence.size
    for row, cell in zip(rows, np.ndindex(results.shape), strict=True):
        at = {axis.parameter: axis.values[k] for axis, k in zip(axes, cell, strict=True)}
        expected = results.cell(at)
        assert row["sequence"] == expected["label"]
        assert row["status"] == expected["status"]
        assert row["quality"].split() == expected["quality"]
        assert float(row["severity [rad s-2]"] or "nan") == pytest.approx(expected["severity"], rel=0.0, nan_ok=True)
        times = [row[f"impact_time[{k}] [s]"] for k in results.entries["impact"]]
        assert [float(time) for time in times if time] == expected["impact_time"].tolist()
    assert "load.ratio" in rows[0]
    assert len(axes) == 1 or "lash.backlash_deg [degrees]" in rows[0]


def test_probabilities_and_draws_are_exported(tmp_path, probabilities):
    save(tmp_path / "map.csv", probabilities)
    first = next(csv.DictReader((tmp_path / "map.csv").read_text("utf-8").splitlines()))
    label = probabilities.labels[probabilities.sequence[0, 0]]
    assert (first["sequence"], float(first[f"probability[{label}]"])) == (label, probabilities.certainty[0, 0])
    assert all(f"severity_quantiles[{quantile}] [rad s-2]" in first for quantile in QUANTILES)


def test_runs_of_a_path_have_their_coordinates(tmp_path):
    base = study_from_text(BOERE)
    save(tmp_path / "runs.csv", clunk_api.run_points(base, {"load.ratio": [1.0, 5.0], "lash.backlash_deg": [2.0, 6.0]}))
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text("utf-8").splitlines()))
    assert [(row["run"], row["load.ratio"], row["sequence"]) for row in rows] == [
        ("1.0", "1.0", "NI"),
        ("2.0", "5.0", "DS(1)SS(1)"),
    ]


def test_the_command_exports_and_refuses_other_formats(command, here):
    store.write_results(here / "map.h5", example(RATIO))
    assert command("export", "map.h5", "out/map.csv")[0] == 0
    assert (here / "out/map.csv").read_text().startswith("load.ratio,sequence,")
    code, _, err = command("export", "map.h5", "map.xlsx")
    assert code == 2
    assert "must end in .csv, .geojson" in err
    code, _, err = command("export", "nothing.h5", "map.csv")
    assert code == 2
    assert "nothing.h5 cannot be read" in err
