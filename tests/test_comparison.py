"""Comparisons: maps against maps, maps against measurements, and the figures of both."""

import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from helpers.maps import map_of
from hypothesis import given, strategies as st
from test_plot import assert_texts_do_not_overlap, box_of, notes

from clunk.analysis.comparison import (
    Difference,
    DifferingCell,
    Transition,
    compare,
)
from clunk.analysis.measurements import (
    CAVEAT,
    TABLES,
    Experiment,
    ExperimentComparison,
    Measurement,
    compare_experiment,
    is_experiment,
    read_experiment,
)
from clunk.plot import PlotError
from clunk.plot.analyses import difference_map, experiment_map
from clunk.results.labels import normalised_label
from clunk.results.maps import Results
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError
from clunk.study.records import plain, text_of

RATIO = ResultAxis("load.ratio", np.linspace(0.0, 10.0, 41), "load ratio", "σr = Td/Ts", "1")
BACKLASH = ResultAxis("lash.backlash_deg", np.linspace(0.0, 20.0, 31), "backlash", "φθ", "degrees")
CONFIG = """
title = "Map"
[driveline]
inertias = [0.024, 0.002]
[lash.contact]
model = "indentation"
"""
IMPACTS = {"NI": 0, "SS(1)": 1, "SS(2)": 2, "DS(1)": 2, "DS(1)SS(1)": 3, "DS(2)": 4, "DS(2)SS(1)": 5, "DS(3)": 6}


def make(names: Any, axes: Sequence[ResultAxis], order: Sequence[str] | None = None, **changes: Any) -> Results:
    """Results with these labels; "failed" is a failed cell, and Q = V = 0 where there are no impacts."""
    names = np.asarray(names, dtype=object)
    labels = tuple(order or dict.fromkeys(name for name in names.ravel() if name != "failed"))
    code = {label: k for k, label in enumerate(labels)} | {"failed": -1}
    shape = names.shape
    sequence = np.array([code[name] for name in names.ravel()], np.int16).reshape(shape)
    severity = np.array([1000.0 * IMPACTS.get(name, 1) for name in names.ravel()]).reshape(shape)
    severity[sequence < 0] = np.nan
    given: dict[str, Any] = {
        "config": CONFIG,
        "digest": "a1",
        "attributes": {"clunk_version": "0.1.0", "created": "2026-01-02"},
        "severity": severity,
        "approach_velocity": severity / 500.0,
        "quality": np.zeros(shape, np.uint8),
    }
    return map_of(axes, labels, sequence, **(given | changes))


def regimes(ratio: float, backlash: float, shift: float = 0.0) -> str:
    """Something like Figure 3.4: more double-sided impacts at higher load ratios and smaller backlash."""
    double = int(max(0.0, (ratio - 0.2 * backlash - 1.0 + shift) / 2.5))
    if not double:
        return "NI" if ratio < 1.4 else "SS(1)"
    return f"DS({double})SS(1)" if double < 3 and backlash > 8.0 else f"DS({double})"


def like_figure_3_4(shift: float = 0.0, **changes: Any) -> Results:
    names = [[regimes(ratio, backlash, shift) for backlash in BACKLASH.values] for ratio in RATIO.values]
    return make(names, (RATIO, BACKLASH), **changes)


def small(names: Sequence[Sequence[str]], **changes: Any) -> Results:
    names = np.asarray(names, dtype=object)
    x = replace(RATIO, values=np.arange(names.shape[0], dtype=float))
    y = replace(BACKLASH, values=2.0 * np.arange(names.shape[1]))
    return make(names, (x, y), **changes)


def place(ratio: float, backlash: float) -> dict[str, float]:
    return {"load.ratio": ratio, "lash.backlash_deg": backlash}


A = [["NI", "SS(1)", "DS(1)"], ["SS(1)", "SS(1)", "DS(2)"]]


# --- maps against maps


def test_differing_cells_are_counted_by_transition_and_found_by_their_values() -> None:
    b = [["NI", "DS(1)", "DS(1)"], ["DS(1)", "SS(1)", "NI"]]
    comparison = compare(small(A), small(b))
    assert comparison.differing == 3
    assert comparison.cells == 6
    assert comparison.transitions == (Transition("SS(1)", "DS(1)", 2), Transition("DS(2)", "NI", 1))
    np.testing.assert_array_equal(comparison.differs, [[False, True, False], [True, False, True]])
    assert comparison.differing_cells == [
        DifferingCell((0, 1), place(0.0, 2.0), "SS(1)", "DS(1)", False),
        DifferingCell((1, 0), place(1.0, 0.0), "SS(1)", "DS(1)", False),
        DifferingCell((1, 2), place(1.0, 4.0), "DS(2)", "NI", False),
    ]
    assert not comparison.same_regimes
    assert "3 of 6 cells differ (50 %)" in text_of(comparison)


@pytest.mark.parametrize("flagged", [(0, 1), (1, 0)])
def test_a_cell_that_either_map_leaves_undecided_is_flagged(flagged: tuple[int, int]) -> None:
    a, b = (
        small(names, quality=np.full((2, 3), 2 * each, np.uint8))
        for names, each in zip((A, A[::-1]), flagged, strict=True)
    )
    comparison = compare(a, b)
    assert comparison.differing > comparison.differing_elsewhere == 0


def test_a_difference_is_a_share_of_the_largest_and_of_nothing_none() -> None:
    still = small([["NI"] * 3] * 2)
    moved, slower = small(A), small(A, approach_velocity=0.9 * small(A).approach_velocity)
    flagged = small([["NI"] * 3] * 2, quality=np.full((2, 3), 2, np.uint8))
    zeros = {each.quantity: each.over_largest for each in compare(still, flagged).largest_differences}
    assert zeros["severity"] == 0.0
    (slow,) = [each for each in compare(slower, moved).largest_differences if each.quantity == "approach_velocity"]
    assert slow.over_largest == pytest.approx(0.1)


def test_a_cell_at_zeros_is_told_and_counts_of_nothing_are_not() -> None:
    difference = Difference("severity", 1.0, "rad/s²", 0.5, place(0.0, 0.0))
    told = " ".join(text_of(difference).split())
    assert all(f"{key} = 0" in told for key in place(0.0, 0.0))
    a = small([["SS(1)", "DS(1)", "DS(1)"], ["SS(1)", "SS(1)", "DS(2)"]])
    assert "not compared" not in text_of(compare(a, a))


labels_of_a_map = st.lists(st.sampled_from(["NI", "SS(1)", "DS(1)", "failed"]), min_size=6, max_size=6)


@given(labels_of_a_map, labels_of_a_map)
def test_comparing_the_other_way_round_turns_every_transition_round(first: list[str], second: list[str]) -> None:
    a, b = (small(np.array(names, dtype=object).reshape(2, 3)) for names in (first, second))
    there, back = compare(a, b), compare(b, a)
    np.testing.assert_array_equal(there.differs, back.differs)
    turned = {(found.b, found.a, found.cells) for found in back.transitions}
    assert {(found.a, found.b, found.cells) for found in there.transitions} == turned
    assert there.differing == sum(found.cells for found in there.transitions)
    assert (there.failed["a_only"], there.failed["b_only"]) == (back.failed["b_only"], back.failed["a_only"])
    assert there.cells + sum(there.failed.values()) == 6
    expected = sum(x != y for x, y in zip(first, second, strict=True) if "failed" not in (x, y))
    assert there.differing == expected


def test_what_is_no_regime_map_is_refused_in_a_sentence() -> None:
    found = small([["NI", "NI", "DS(1)"], ["SS(1)", "SS(1)", "DS(2)"]])
    with pytest.raises(ClunkError, match="a str is none"):
        compare(found, "map.h5")


def test_failed_cells_are_not_compared_but_reported() -> None:
    a = small([["failed", "failed", "DS(1)"], ["SS(1)", "SS(1)", "DS(2)"]])
    b = small([["failed", "SS(1)", "failed"], ["failed", "SS(1)", "DS(2)"]])
    comparison = compare(a, b)
    assert comparison.failed == {"a_only": 1, "b_only": 2, "both": 1}
    assert (comparison.cells, comparison.differing) == (2, 0)
    assert not comparison.same_regimes
    assert "a_only = 1, b_only = 2, both = 1" in text_of(comparison)
    assert compare(a, a).same_regimes


def other_axes(*axes: ResultAxis) -> Results:
    return make(np.full([len(axis.values) for axis in axes], "NI", dtype=object), axes)


X = replace(RATIO, values=np.array([0.0, 1.0, 2.0]))
Y = replace(BACKLASH, values=np.array([0.0, 5.0]))


@pytest.mark.parametrize(
    ("axes", "found"),
    [
        ((Y, X), "in A and lash.backlash_deg (2 values), load.ratio (3 values) in B"),
        (
            (X, replace(Y, parameter="lash", words=("gear", "drive"))),
            "in A and load.ratio (3 values), lash (gear, drive) in B",
        ),
        ((X,), "they sweep load.ratio (3 values), lash.backlash_deg (2 values) in A and load.ratio (3 values) in B"),
        ((replace(X, values=np.array([0.0, 2.0])), Y), "load.ratio (2 values), lash.backlash_deg (2 values) in B"),
        ((X, replace(Y, values=np.array([0.0, 5.001]))), "value 2 of lash.backlash_deg is 5 in A and 5.001 in B"),
    ],
)
def test_maps_of_other_grids_are_refused_in_one_sentence(axes: tuple[ResultAxis, ...], found: str) -> None:
    with pytest.raises(ClunkError) as caught:
        compare(other_axes(X, Y), other_axes(*axes))
    assert found in str(caught.value)
    assert str(caught.value).endswith(".")
    assert "\n" not in str(caught.value)


def test_configs_and_versions_are_compared_key_by_key_and_titles_and_dates_decide_nothing() -> None:
    other = CONFIG.replace("0.002", "0.02").replace('"indentation"', '"restitution"\nrestitution = 0.5')
    versions = {"clunk_version": "0.2.0", "created": "2027-01-02"}
    comparison = compare(small(A), small(A, config=other, digest="b2", attributes=versions))
    assert comparison.provenance_differences == {"clunk_version": {"a": "0.1.0", "b": "0.2.0"}}
    assert comparison.config_differences == {
        "driveline.inertias[2]": {"a": 0.002, "b": 0.02},
        "lash.contact.model": {"a": "indentation", "b": "restitution"},
        "lash.contact.restitution": {"a": None, "b": 0.5},
    }
    assert not comparison.configs_equal
    text = text_of(comparison)
    assert re.search(r"lash\.contact\.model +indentation +restitution", text)
    assert re.search(r"lash\.contact\.restitution +- +0\.5", text)
    assert re.search(r"clunk_version +0\.1\.0 +0\.2\.0", text)
    titled = compare(small(A), small(A, config=CONFIG.replace('"Map"', '"Other"')))
    assert titled.configs_equal
    assert [*titled.config_differences] == ["title"]


def awkward() -> tuple[Results, Results]:
    """Many transitions between labels as long as they get, long config values, failed cells."""
    rng = np.random.default_rng(5)
    labels = [*IMPACTS, "failed", "OS(1)DS(1)SS(1)DS(1)SS(1)DS(1)SS(1)DS(1)SS(1)DS(1)"]
    maps = []
    for title in ("x" * 70, "y" * 70):
        config = CONFIG.replace("Map", title).replace("0.002", "2e-3" if title[0] == "x" else "3e-3")
        names = rng.choice(np.array(labels, dtype=object), (12, 9))
        maps.append(small(names, title=title, config=config, digest=title[0]))
    return maps[0], maps[1]


def test_reports_fit_80_columns_and_records_are_json() -> None:
    a, b = awkward()
    comparison = compare(a, b)
    assert len(comparison.differing_cells) > 30
    text = text_of(comparison)
    assert max(map(len, text.splitlines())) <= 80
    assert f"and {len(comparison.differing_cells) - 30} more" in text
    record = json.loads(json.dumps(plain(comparison), allow_nan=False))
    assert record["cells_differing"] == len(record["differing_cells"]) == comparison.differing
    assert sum(found["cells"] for found in record["transitions"]) == comparison.differing
    measured = compare_experiment(a, read_experiment("table_4_1"))
    assert max(map(len, text_of(measured).splitlines())) <= 80
    json.dumps(plain(measured), allow_nan=False)


# --- measurements


def test_table_4_1_is_the_reports() -> None:
    experiment = read_experiment("table_4_1")
    table = {
        0.7: "S(1) D(1)+S(1) D(1)+S(1) D(2)+S(1) D(3)+S(1)",
        2.1: "S(1) D(1)+S(1) D(1)+S(2) D(2)+S(1) D(2)+S(1)",
        3.6: "S(1) D(1)+S(1) D(1)+S(1) D(1)+S(2) D(1)+S(2)",
        4.8: "S(1) S(1) D(1)+S(1) D(1)+S(1) D(1)+S(2)",
    }
    expected = {
        (ratio, backlash): label.replace("D", "DS").replace("S(", "SS(").replace("DSS", "DS").replace("+", "")
        for backlash, row in table.items()
        for ratio, label in zip((2.5, 4.6, 6.7, 8.5, 10.3), row.split(), strict=True)
    }
    assert expected[4.6, 2.1] == "DS(1)SS(1)"
    assert experiment.columns == ("load_ratio", "lash_backlash_deg")
    assert {found.values: found.label for found in experiment.measurements} == expected
    assert "rig's parameters are not the model's" in experiment.caveat
    assert "DCT 2008.116" in TABLES["table_4_1"].read_text("utf-8")


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("D(1)+S(1)", "DS(1)SS(1)"),
        ("S(1)", "SS(1)"),
        (" DS(1) SS(1) ", "DS(1)SS(1)"),
        ("d(2)+s(1)", "DS(2)SS(1)"),
        ("S(1)+S(1)", "SS(2)"),
        ("OS(1)DS(1)CR(1)", "OS(1)DS(1)CR(1)"),
        ("NI", "NI"),
    ],
)
def test_labels_of_the_report_are_labels(text: str, label: str) -> None:
    assert normalised_label(text) == label


@pytest.mark.parametrize("text", ["", "D", "D(0)", "D(1)+", "+D(1)", "X(1)", "D(1)-S(1)", "NI+S(1)", "D(-1)", "S(1.5)"])
def test_what_is_no_label_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no label"):
        normalised_label(text)


def written(folder: Path, content: str | bytes) -> Path:
    path = folder / "rig.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_columns_may_be_dotted_and_the_file_may_come_from_a_spreadsheet(tmp_path: Path) -> None:
    content = '\ufeff# Rig 2\r\n\r\nlabel, load.ratio ,driveline.shafts[3].damping\r\n"S(1)",2.5,1e-1\r\n,,\r\n'
    experiment = read_experiment(written(tmp_path, content))
    assert experiment.columns == ("load_ratio", "driveline_shafts_3__damping")
    assert experiment.measurements == (Measurement(4, (2.5, 0.1), "SS(1)", {}, {}),)
    assert experiment.caveat == CAVEAT


@pytest.mark.parametrize("mark", [";", "\t"])
def test_semicolons_or_tabs_may_separate_and_commas_be_the_points(mark: str, tmp_path: Path) -> None:
    content = "# Rig 2, Tip-out\nload.ratio;label;impact_time_1;impact_time_std\n2,5;SS(1);0,262;0,002\n5;DS(1);;\n"
    one, other = read_experiment(written(tmp_path, content.replace(";", mark))).measurements
    assert one == Measurement(3, (2.5,), "SS(1)", {"impact_time": {0: 0.262}}, {"impact_time": 0.002})
    assert other == Measurement(4, (5.0,), "DS(1)", {}, {})


def test_headings_may_end_with_their_unit_and_lines_with_separators(tmp_path: Path) -> None:
    heading = "load.ratio [1],lash.backlash_deg [degrees],label,impact_time_1 [s],impact_time_std,,"
    (one,) = read_experiment(written(tmp_path, f"{heading}\n2.5,6,SS(1),0.262,0.002,\n")).measurements
    assert one == Measurement(2, (2.5, 6.0), "SS(1)", {"impact_time": {0: 0.262}}, {"impact_time": 0.002})


HEADER = "# a comment\nload_ratio,lash_backlash_deg,label\n"


@pytest.mark.parametrize(
    ("content", "line", "found"),
    [
        ("load_ratio,lash_backlash_deg\n1,2\n", 1, "one named label"),
        ("label\nNI\n", 1, "must be columns"),
        ("load_ratio,load.ratio,label\n1,1,NI\n", 1, "more than one column load_ratio"),
        ("load_ratio:label\n1:NI\n", 1, "separated by commas, semicolons or tabs"),
        ("lash.backlash_deg [rad],label\n1,NI\n", 1, 'lash.backlash_deg is in degrees, not in "rad"'),
        ("load.ratio,label,impact_time_1 [ms]\n1,NI,\n", 1, 'impact_time_1 is in s, not in "ms"'),
        (HEADER + "1,2,NI\n\n1,two,NI\n", 5, 'lash_backlash_deg must be a finite number, not "two"'),
        (HEADER + "nan,2,NI\n", 3, "load_ratio must be a finite number"),
        (HEADER + "1,2,D(1)*S(1)\n", 3, "'D(1)*S(1)' is no label"),
        (HEADER + "1,2,\n", 3, "is no label"),
        (HEADER + "1,2\n", 3, "2 columns here and 3 names"),
        (HEADER + '1,2,"NI\n', 3, "not CSV"),
        ("load_ratio,label\n1,NI\n2,\xe9\n".encode("latin-1"), 3, "UTF-8"),
    ],
)
def test_what_is_wrong_with_measurements_is_a_sentence_with_its_line(
    tmp_path: Path, content: str | bytes, line: int, found: str
) -> None:
    path = written(tmp_path, content)
    with pytest.raises(ClunkError) as caught:
        read_experiment(path)
    assert f"{path}, line {line}: " in str(caught.value) or f"on line {line};" in str(caught.value)
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_measurements_a_missing_one_and_a_directory_are_sentences(tmp_path: Path) -> None:
    for content, found in (("", "no measurements"), (HEADER, "only column names")):
        with pytest.raises(ClunkError, match=found):
            read_experiment(written(tmp_path, content))
    with pytest.raises(ClunkError, match=r"does not exist; .* table_4_1"):
        read_experiment(tmp_path / "none.csv")
    assert is_experiment("table_4_2")  # misspelt: of a results file nobody thinks there
    with pytest.raises(ClunkError, match=r"table_4_2 does not exist; .* table_4_1"):
        read_experiment("table_4_2")
    with pytest.raises(ClunkError, match="Is a directory"):
        read_experiment(tmp_path)
    with pytest.raises(ClunkError, match="cannot be read"):
        read_experiment("a\0b")


def measured(points: dict[tuple[float, ...], str], columns: Sequence[str] = ("load_ratio", "lash_backlash_deg")) -> Any:
    found = tuple(Measurement(k, values, label, {}, {}) for k, (values, label) in enumerate(points.items(), 2))
    return Experiment("rig.csv", tuple(columns), found, CAVEAT)


def test_each_point_is_compared_with_the_nearest_cell() -> None:
    results = small(A)  # load ratio 0, 1; backlash 0, 2, 4
    comparison = compare_experiment(results, measured({(0.4, 1.2): "SS(1)", (0.6, 3.2): "DS(2)", (0.0, 0.0): "SS(1)"}))
    assert [(point.cell, point.computed) for point in comparison.points] == [
        (place(0.0, 2.0), "SS(1)"),
        (place(1.0, 4.0), "DS(2)"),
        (place(0.0, 0.0), "NI"),
    ]
    assert (comparison.agreeing, comparison.counted) == (2, 3)


def test_on_a_logarithmic_axis_the_nearest_is_the_one_whose_cell_is_drawn_there() -> None:
    values = np.geomspace(1.0, 100.0, 5)  # 1, 3.16, 10, …: edges at 1.78 and 5.62
    axis = ResultAxis("load.ratio", values, "load ratio", "σr = Td/Ts", "1")
    assert [axis.values[axis.nearest(value)] for value in (1.7, 2.0, 6.0)] == pytest.approx([1.0, 10**0.5, 10.0])


@pytest.mark.parametrize(
    ("ratio", "computed"),
    [(0.0, "SS(1)"), (-0.01, None), (10.0, "DS(1)"), (10.01, None), (4.9, "SS(1)"), (8.0, "DS(1)")],
)
def test_what_is_beyond_the_outermost_cells_is_outside(ratio: float, computed: str | None) -> None:
    axis = replace(RATIO, values=np.arange(11.0))
    for turn in (slice(None), slice(None, None, -1)):
        names = np.array(["SS(1)"] * 6 + ["DS(1)"] * 5, dtype=object)[turn]
        results = make(names, [replace(axis, values=axis.values[turn].copy())])
        point = compare_experiment(results, measured({(ratio,): "SS(1)"}, ["load_ratio"])).points[0]
        assert point.computed == computed


def test_points_outside_or_at_failed_cells_are_reported_and_not_counted() -> None:
    results = small([["failed", "SS(1)"], ["DS(1)", "SS(1)"]])
    points = {(0.0, 0.0): "SS(1)", (0.0, 2.0): "SS(1)", (7.0, 2.0): "SS(1)", (1.0, 40.0): "SS(1)"}
    comparison = compare_experiment(results, measured(points))
    assert (comparison.counted, comparison.agreeing, comparison.failed, comparison.outside) == (1, 1, 1, 2)
    assert not comparison.same_regimes  # a failed cell is no agreement
    assert compare_experiment(results, measured({(0.0, 2.0): "SS(1)", (7.0, 2.0): "SS(1)"})).same_regimes
    assert sum(trend.pairs for trend in comparison.trends) == 0
    text = text_of(comparison)
    assert re.search("outside the swept range +2\n", text)
    assert re.search("nearest to a failed cell +1\n", text)


def test_columns_and_axes_must_match() -> None:
    with pytest.raises(ClunkError, match=r"sweep lash\.backlash_deg, and rig\.csv has no column for it"):
        compare_experiment(small(A), measured({(1.0,): "NI"}, ["load_ratio"]))
    with pytest.raises(
        ClunkError,
        match=r"load_step_time.? of rig\.csv is no axis.*sweep load_ratio, lash_",
    ):
        compare_experiment(small(A), measured({(1.0, 1.0): "NI"}, ["load_ratio", "load_step_time"]))


def test_trend_counts_neighbours_that_are_ordered_alike() -> None:
    computed = small([["SS(1)", "NI"], ["DS(1)", "SS(1)"], ["DS(2)SS(1)", "DS(1)"]])
    points = {
        **{(0.0, 0.0): "SS(1)", (1.0, 0.0): "DS(1)", (2.0, 0.0): "DS(1)SS(1)"},  # rises, same; computed: rises, rises
        **{(0.0, 2.0): "SS(1)", (1.0, 2.0): "DS(1)", (2.0, 2.0): "SS(2)"},  # rises, falls; computed: same, rises
    }
    ratio, backlash = compare_experiment(computed, measured(points)).trends
    assert (ratio.parameter, ratio.pairs) == ("load.ratio", 4)
    assert (ratio.alike, ratio.opposed) == (1, 1)
    assert backlash.pairs == 3
    assert (backlash.alike, backlash.opposed) == (2, 0)


def test_table_4_1_has_the_trends_of_a_map_like_figure_3_4() -> None:
    comparison = compare_experiment(like_figure_3_4(), read_experiment("table_4_1"))
    ratio, backlash = comparison.trends
    for trend in (ratio, backlash):  # it rises with the load ratio, and falls with the backlash
        assert 0 == trend.opposed < trend.alike <= trend.pairs
    assert comparison.outside == 4  # σr = 10.3
    text = text_of(comparison)
    assert "trend comparison: the rig's parameters are not the model's" in text
    assert re.search(r"load\.ratio +12 ", text)


# --- figures


def coloured(figure: Any, results: Results) -> list[tuple[float, ...]]:
    """Values of the cells that a difference map shows in the colour of a note."""
    ax = figure.axes[0]
    marks = [patch.get_facecolor() for each in figure.legends for patch in each.get_patches()]
    (picture,) = [np.asarray(each.get_array()) / 255.0 for each in ax.collections if each.get_gid() == "cells"]
    x, y = (np.sort(axis.values) for axis in results.axes)
    return [
        (float(x[column]), float(y[row]))
        for column, row in itertools.product(range(len(x)), range(len(y)))
        if any(np.allclose(picture[row, column], mark[:3], atol=0.003) for mark in marks)  # 8 bits
    ]


def drawn(figure: Any, gid: str) -> list[tuple[float, float]]:
    ax = figure.axes[0]
    scattered = [tuple(xy) for each in ax.collections if each.get_gid() == gid for xy in each.get_offsets().tolist()]
    plotted = [tuple(xy) for line in ax.lines if line.get_gid() == gid for xy in line.get_xydata().tolist()]
    return scattered + plotted


def assert_readable(figure: Any) -> None:
    """Large letters, and no text on another one or on a point."""
    ax = figure.axes[0]
    legend = [text for each in figure.legends for text in each.get_texts()]
    assert min(text.get_fontsize() for text in [*ax.texts, *legend, ax.title]) >= 8.0
    assert_texts_do_not_overlap(ax)
    points = drawn(figure, "agrees") + drawn(figure, "differs")
    for text in ax.texts if points else ():
        assert not matplotlib.path.Path(box_of(text)).contains_points(ax.transData.transform(points)).any()


def test_difference_map_marks_every_differing_cell_once() -> None:
    a, b = like_figure_3_4(), like_figure_3_4(0.3, config=CONFIG.replace("0.002", "0.003"), digest="b2")
    comparison = compare(a, b)
    assert 10 < comparison.differing < 0.1 * a.sequence.size
    figure = difference_map(comparison)
    assert coloured(figure, a) == sorted(tuple(cell.at.values()) for cell in comparison.differing_cells)
    assert_readable(figure)
    title = figure.subfigs[0].get_suptitle()
    assert f"{comparison.differing} of 1,271 cells differ" in title
    assert "configs differ in driveline.inertias[2]" in title
    first = comparison.transitions[0]
    assert f"{first.a} → {first.b}: {first.cells} cells" in notes(figure)


def table_on_the_map() -> tuple[Results, ExperimentComparison]:
    results = like_figure_3_4()
    return results, compare_experiment(results, read_experiment("table_4_1"))


def test_experiment_map_shows_every_point_inside_filled_where_it_agrees() -> None:
    results, comparison = table_on_the_map()
    figure = experiment_map(results, comparison)
    inside = [point for point in comparison.points if point.computed is not None]
    assert comparison.agreeing
    assert sorted(drawn(figure, "agrees")) == sorted(tuple(point.at.values()) for point in inside if point.agrees)
    assert sorted(drawn(figure, "differs")) == sorted(tuple(point.at.values()) for point in inside if not point.agrees)
    texts = [text.get_text() for text in figure.axes[0].texts if text.get_gid() == "measured"]
    assert sorted(texts) == sorted(point.measured for point in inside)
    assert_readable(figure)
    assert "rig's parameters are not the model's" in figure.subfigs[0].get_suptitle()
    assert any(f"{comparison.agreeing} of {comparison.counted}" in note for note in notes(figure))
    assert "outside the map, not counted: 4" in notes(figure)


def test_panels_keep_their_size_where_all_points_agree_or_none_does() -> None:
    """A line of no points has its place at the corner of the figure, and pushed the panels apart."""
    results, comparison = table_on_the_map()
    widths = []
    for agree in (comparison.points[0].agrees, True, False):
        points = tuple(replace(point, computed=point.measured if agree else "NI") for point in comparison.points)
        (ax,) = experiment_map(results, replace(comparison, points=points)).axes
        widths.append(ax.get_position().width)
    assert max(widths) - min(widths) < 0.02
    assert min(widths) > 0.8


def test_figures_need_two_axes() -> None:
    results = make(["NI", "SS(1)"], [replace(X, values=np.array([0.0, 1.0]))])
    with pytest.raises(PlotError, match="needs two axes"):
        difference_map(compare(results, results))
    with pytest.raises(PlotError, match="needs two axes"):
        experiment_map(results, compare_experiment(results, measured({(1.0,): "NI"}, ["load_ratio"])))
