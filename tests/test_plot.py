"""Figures: what they say is what the results hold, and they can be read."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from helpers.maps import map_of, with_arrays
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

from clunk import plot
from clunk.analysis.marks import ridge_of
from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.layers import Layers
from clunk.plot.maps import shades_of
from clunk.plot.plane import View
from clunk.plot.style import FAILED_FILL, INK, colour_of, group_colour, symbol_text
from clunk.results.maps import Results
from clunk.results.quantities import quantity_of
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError

LABELS = ("NI", "SS(1)", "DS(1)", "SS(2)", "DS(1)SS(1)", "DS(1)SS(2)", "DS(2)", "DS(2)SS(1)", "DS(3)")
PRIMARIES = np.array([0, 1, 2, 2, 3, 4, 4, 5, 6])
THRESHOLDS = (1.46, 3.13, 6.69)
RATIO = ResultAxis("load.ratio", np.linspace(0.0, 10.0, 61), "load ratio", "σr = Td/Ts", "1")
BACKLASH = ResultAxis("lash.backlash_deg", np.linspace(0.0, 20.0, 61), "backlash", "φθ", "degrees")
CONFIG = '[load]\nprofile = "step"\n'


def make(axes: tuple[ResultAxis, ...], labels: tuple[str, ...], sequence: np.ndarray, severity: np.ndarray) -> Results:
    return map_of(
        axes,
        labels,
        sequence,
        title="Regimes of the nominal driveline",
        config=CONFIG,
        severity=severity.astype(float),
        last_event_time=np.where(severity > 0.0, 0.5, np.nan),
    )


def regime_map(results: Results, thresholds: tuple[float, ...] = ()) -> Figure:
    return plot.draw(results, "regimes", thresholds)


def nine_regions(ratio: ResultAxis = RATIO, backlash: ResultAxis = BACKLASH) -> Results:
    """A map with the regions of Figure 3.4 in about their places."""
    s, p = np.meshgrid(ratio.values, backlash.values, indexing="ij")
    sequence = np.zeros(s.shape, np.int16)
    # Each label beyond its line, later ones over earlier ones.
    sequence[s > 1.46] = 1
    sequence[s > 3.2] = 3
    sequence[s > 1.46 + 0.19 * p] = 2
    sequence[s > 3.2 + 0.075 * p] = 4
    sequence[s > 8.0 + 0.07 * p] = 5
    sequence[s > 3.13 + 0.52 * p] = 6
    sequence[(s > 6.69 + 0.17 * np.minimum(p, 10.0)) & (s > 3.13 + 0.52 * p)] = 7
    sequence[s > 6.69 + 1.2 * p] = 8
    present, sequence = np.unique(sequence, return_inverse=True)
    severity = np.where(PRIMARIES[present][sequence] > 0, 2000.0 * s * np.exp(-(((p - 1.6 * s) / 9.0) ** 2)), 0.0)
    return make((ratio, backlash), tuple(LABELS[code] for code in present), sequence, severity)


@pytest.fixture(scope="module")
def nine() -> Results:
    return nine_regions()


@pytest.fixture(scope="module")
def nine_map(nine: Results) -> Figure:
    return regime_map(nine, THRESHOLDS)


def with_cells(results: Results, cells: list[tuple[slice, slice]], code: int, label: str | None = None) -> Results:
    sequence = results.sequence.copy()
    for cell in cells:
        sequence[cell] = code
    labels = results.labels if label is None else (*results.labels, label)
    severity = np.where(sequence < 0, np.nan, results.severity)
    return make(results.axes, labels, sequence, severity)


def label_at(results: Results, x: float, y: float) -> str:
    """Label of the cell nearest to a place on a map with the results' axes."""
    cell = tuple(int(np.argmin(np.abs(axis.values - at))) for axis, at in zip(results.axes, (x, y), strict=True))
    code = int(results.sequence[cell])
    return results.labels[code] if code >= 0 else "failed"


def box_of(text: Text) -> np.ndarray:
    """(4, 2) corners of the text itself, turned as it is, in display pixels."""
    angle = text.get_rotation()
    text.set_rotation(0.0)
    box = Text.get_window_extent(text)
    text.set_rotation(angle)
    middle = np.array([box.x0 + box.x1, box.y0 + box.y1]) / 2
    corners = np.array([[box.x0, box.y0], [box.x1, box.y0], [box.x1, box.y1], [box.x0, box.y1]]) - middle
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return corners @ np.array([[c, s], [-s, c]]) + middle


def outline(corners: np.ndarray) -> np.ndarray:
    steps = np.linspace(0.0, 1.0, 25)[:, None]
    return np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise([*corners, corners[0]])])


def notes(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def line_under(figure: Figure) -> str:
    """The line under the title of a map."""
    return figure.subfigs[0].get_suptitle()


def assert_labels_are_where_they_belong(results: Results, ax: Axes) -> None:
    for text in ax.texts:
        for point in ax.transData.inverted().transform(outline(box_of(text))):
            assert label_at(results, *point) == text.get_text()


def assert_texts_do_not_overlap(ax: Axes) -> None:
    boxes = {text: matplotlib.path.Path(box_of(text)) for text in ax.texts}
    for one, other in itertools.combinations(boxes.values(), 2):
        assert not one.intersects_path(other, filled=True)


# --- the regime map


@pytest.mark.parametrize("count", [21, 61, 101])
def test_every_label_is_inside_its_region_or_in_a_note(count: int) -> None:
    results = nine_regions(
        replace(RATIO, values=np.linspace(0.0, 10.0, count)), replace(BACKLASH, values=np.linspace(0.0, 20.0, count))
    )
    figure = regime_map(results)
    named = [*(text.get_text() for text in figure.axes[0].texts), *(note.split(":")[0] for note in notes(figure))]
    assert sorted(named) == sorted(results.labels)
    assert_labels_are_where_they_belong(results, figure.axes[0])
    assert_texts_do_not_overlap(figure.axes[0])


def test_a_region_too_small_for_its_name_has_a_note(nine: Results) -> None:
    small = with_cells(nine, [np.s_[14:15, 45:47]], len(nine.labels), "DS(4)")
    figure = regime_map(small)
    assert notes(figure) == ["DS(4): 0.054 %"]
    assert sorted([*(text.get_text() for text in figure.axes[0].texts), "DS(4)"]) == sorted(small.labels)


def colours_at(ax: Axes, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n, 3) colours of the picture of the cells at places in data coordinates, 0 to 255."""
    (picture,) = [cells for cells in ax.collections if cells.get_gid() == "cells"]
    edges = picture.get_coordinates()
    columns = np.searchsorted(edges[0, :, 0], x) - 1
    rows = np.searchsorted(edges[:, 0, 1], y) - 1
    return np.asarray(picture.get_array())[rows, columns]


def cell_places(results: Results) -> tuple[np.ndarray, np.ndarray]:
    """Places of all cells but those on the border, of which a picture has half."""
    x, y = np.meshgrid(*(axis.values[1:-1] for axis in results.axes), indexing="ij")
    return x.ravel(), y.ravel()


def test_every_cell_has_the_colour_of_its_label_and_lines_run_along_cells(nine: Results, nine_map: Figure) -> None:
    ax = nine_map.axes[0]
    fills = np.array([to_rgb(colour_of(label)) for label in nine.labels])[nine.sequence[1:-1, 1:-1].ravel()]
    np.testing.assert_allclose(colours_at(ax, *cell_places(nine)) / 255.0, fills, atol=0.003)  # 8 bits
    (lines,) = [each for each in ax.collections if each.get_gid() == "boundaries"]
    for line in lines.get_segments():
        for here, values in zip(line.T, (RATIO.values, BACKLASH.values), strict=True):
            middles = 0.5 * (values[1:] + values[:-1])
            assert np.ptp(here) > 0.0 or np.abs(middles - here[0]).min() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_lines_between_cells_part_exactly_the_cells_that_differ(seed: int) -> None:
    codes = np.random.default_rng(seed).integers(0, 3, (9, 7)).astype(np.int16)
    axes = tuple(
        replace(axis, values=np.arange(float(n))) for axis, n in zip((RATIO, BACKLASH), codes.shape, strict=True)
    )
    results = make(axes, ("NI", "SS(1)", "DS(1)"), codes, np.ones(codes.shape))
    layers = Layers.of(results, View.of_grid(results))
    length = sum(float(np.hypot(*np.diff(line, axis=0)[0])) for line in layers.lines)
    assert length == np.count_nonzero(np.diff(codes, axis=0)) + np.count_nonzero(np.diff(codes, axis=1))


def test_axes_carry_name_symbol_and_unit(nine_map: Figure) -> None:
    ax = nine_map.axes[0]
    plain = [label.replace(r"$_\mathregular{", "").replace("}$", "") for label in (ax.get_xlabel(), ax.get_ylabel())]
    assert plain == ["Load ratio σr = Td/Ts", "Backlash φθ [degrees]"]
    assert line_under(nine_map) == "ideal torque step"
    assert nine_map.get_suptitle() == "Regimes of the nominal driveline"


@pytest.mark.parametrize(
    ("symbol", "subscripts"),
    [("φθ", ["θ"]), ("φθ2", ["θ2"]), ("k12", ["12"]), ("σr = Td/Ts", ["r", "d", "s"]), ("τ", [])],
)
def test_all_that_follows_the_letter_of_a_symbol_is_its_subscript(symbol: str, subscripts: list[str]) -> None:
    text = symbol_text(symbol)
    assert re.findall(r"\$_\\mathregular{(\w+)}\$", text) == subscripts
    assert re.sub(r"\$_\\mathregular{(\w+)}\$", r"\1", text) == symbol


def threshold_marks(ax: Axes) -> list[float]:
    return [float(x) for line in ax.lines if line.get_marker() == "^" for x in line.get_xdata()]


def test_thresholds_on_the_map_are_marked_and_noted(nine: Results) -> None:
    figure = regime_map(nine, (*THRESHOLDS, 14.32))
    assert threshold_marks(figure.axes[0]) == list(THRESHOLDS)
    assert notes(figure) == ["vanishing backlash: 1.46, 3.13, 6.69"]


@pytest.mark.parametrize(
    "title", ["Regimes of a nominal driveline " * 5, "Short", "Nine words of which none may leave the page"]
)
def test_a_title_is_wrapped_to_the_figure(nine: Results, title: str) -> None:
    figure = plot.draw(replace(nine, title=title), "severity")
    (drawn,) = [text for text in figure.texts if text.get_text() == figure.get_suptitle()]
    box = drawn.get_window_extent(figure.canvas.get_renderer())
    assert box.x1 <= figure.bbox.width
    assert box.x0 == pytest.approx(figure.axes[0].get_window_extent().x0, abs=2.0)
    assert box.y0 > figure.axes[0].get_window_extent().y1


def test_failed_cells_are_grey_counted_and_never_labelled(nine: Results) -> None:
    results = with_cells(nine, [np.s_[30:42, 42:52], np.s_[6:7, 6:7]], -1)
    for figure in (regime_map(results), plot.draw(results, "severity")):
        assert "failed: 121 cells" in notes(figure)
        failed = colours_at(figure.axes[0], RATIO.values[[35]], BACKLASH.values[[45]])
        np.testing.assert_allclose(failed[0] / 255.0, to_rgb(FAILED_FILL), atol=0.003)  # 8 bits
    assert_labels_are_where_they_belong(results, regime_map(results).axes[0])


def test_a_map_that_failed_everywhere_is_still_drawn(nine: Results) -> None:
    results = with_cells(nine, [np.s_[:, :]], -1)
    assert notes(regime_map(results))[-1] == "failed: 3,721 cells"
    with pytest.raises(plot.PlotError, match="not defined in any cell"):
        plot.draw(results, "severity")
    row = results.at({"load.ratio": 5.0})
    assert plot.default_quantities(row) == ["regimes"]
    assert notes(plot.draw(row, "regimes")) == ["failed: 61 cells"]


def test_a_geometric_axis_is_drawn_as_one() -> None:
    results = nine_regions(backlash=replace(BACKLASH, values=np.geomspace(0.2, 20.0, 41)))
    ax = regime_map(results).axes[0]
    assert ax.get_yscale() == "log"
    assert ax.get_xscale() == "linear"
    for text in ax.texts:
        x, y = text.get_position()
        cell = (np.argmin(np.abs(RATIO.values - x)), np.argmin(np.abs(np.log(results.axes[1].values / y))))
        assert results.labels[results.sequence[cell]] == text.get_text()


def test_an_axis_of_one_value_is_named_instead_of_drawn(nine: Results) -> None:
    third = ResultAxis("lash.contact.damping", np.array([94.0]), "contact damping", "c34", "N s/m")
    results = make((third, *nine.axes), nine.labels, nine.sequence[None], nine.severity[None])
    ax = regime_map(results).axes[0]
    assert "contact damping = 94 N s/m" in line_under(ax.get_figure(root=True))
    assert_labels_are_where_they_belong(nine, ax)


def test_three_axes_are_refused_with_a_way_out(nine: Results) -> None:
    third = ResultAxis("lash.contact.damping", np.array([94.0, 95.0]), "contact damping", "c34", "N s/m")
    results = make((third, *nine.axes), nine.labels, np.stack([nine.sequence] * 2), np.stack([nine.severity] * 2))
    for quantity in ("regimes", "severity", "double_sided"):
        with pytest.raises(
            plot.PlotError, match=r"sweep 3 axes .*: choose one value of lash.contact.damping .*, or draw a map"
        ):
            plot.draw(results, quantity)


def test_dollar_signs_are_only_dollar_signs(nine: Results, tmp_path: Path) -> None:
    axes = (replace(RATIO, name="price $x^{"), BACKLASH)
    results = make(axes, nine.labels, nine.sequence, nine.severity)
    for title in ("5 $ and 6 $_{", "2 $ (no. #1) or 3 $"):
        figure = regime_map(replace(results, title=title))
        plot.save(figure, tmp_path / "map.svg")
        drawn = [text.get_text() for text in figure.findobj(Text)]
        assert title.replace("$", r"\$") in drawn
        assert any(r"Price \$x^{" in text for text in drawn)


# --- colours: simulated colour blindness after Machado, Oliveira and Fernandes (2009), severity 1

VISION = {
    "full": np.eye(3),
    "deuteranopia": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "protanopia": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "tritanopia": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}


def _lightness_a_b(rgb: np.ndarray) -> np.ndarray:
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(to_xyz @ rgb / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def _linear(colour: str) -> np.ndarray:
    rgb = np.array(to_rgb(colour))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def test_any_labels_have_colours_of_their_own_that_text_can_be_read_on() -> None:
    labels = ("NI", *(f"DS({n})SS({m})" for n in range(1, 6) for m in range(1, 5)), "OS(1)DS(1)", "DS(1)CR")
    colours = set(map(colour_of, labels))
    assert len(colours) == len(labels)
    ink = _linear(INK) @ [0.2126, 0.7152, 0.0722]
    for colour in colours:
        assert (_linear(colour) @ [0.2126, 0.7152, 0.0722] + 0.05) / (ink + 0.05) > 4.5  # WCAG 2.2, level AA


NEIGHBOURS = (  # in maps of cars and of the nominal driveline
    ("CR(1)", "OS(1)CR(1)"),
    ("OS(1)CR(1)", "OS(2)CR(1)"),
    ("CR(1)", "SS(1)CR(1)"),
    ("DS(1)OS(1)CR(1)", "DS(1)OS(2)CR(1)"),
    ("DS(1)OS(2)CR(1)", "DS(1)SS(1)OS(1)CR(1)"),
    ("DS(1)OS(1)CR(1)", "OS(2)CR(1)"),
    ("DS(2)OS(1)CR(1)", "DS(1)OS(2)CR(1)"),
    ("OS(1)DS(1)", "DS(1)OS(1)"),
)


@pytest.mark.parametrize("vision", VISION)
def test_neighbours_and_groups_differ_in_colour_for_everybody(vision: str) -> None:
    """Two fills with a line between them: 2.3 is just noticeable; numbers of impacts are told apart without a line."""

    def seen(colour: str) -> np.ndarray:
        return _lightness_a_b(np.clip(np.array(VISION[vision]) @ _linear(colour), 0.0, 1.0))

    neighbours = [(colour_of(one), colour_of(other)) for one, other in NEIGHBOURS]
    for one, other in (*neighbours, *itertools.combinations(map(group_colour, range(14)), 2)):
        assert np.linalg.norm(seen(one) - seen(other)) > 2.3, (one, other)
    of_figure_3_4, groups = [*map(colour_of, LABELS)], [colour_of("NI"), *map(group_colour, range(6))]
    for one, other in (*itertools.combinations(of_figure_3_4, 2), *itertools.combinations(groups, 2)):
        assert np.linalg.norm(seen(one) - seen(other)) > 5.0, (one, other)


# --- many labels, and quantities that labels tell


def many_labels() -> Results:
    """A map of twenty labels, each in a column: NI, and up to four double-sided impacts with what follows."""
    labels = ("NI", *(f"DS({n})SS({m})" for n in range(1, 4) for m in range(1, 7)), "SS(1)")
    codes = np.repeat(np.arange(20), 3)[:, None].repeat(30, axis=1)
    x = replace(RATIO, values=np.linspace(0.0, 10.0, 60))
    return make((x, replace(BACKLASH, values=np.linspace(0.0, 20.0, 30))), labels, codes, np.ones(codes.shape))


def test_more_labels_than_can_be_read_are_grouped_and_that_is_said() -> None:
    figure = regime_map(many_labels())
    ax = figure.axes[0]
    assert "labels grouped by their number of double-sided impacts" in line_under(figure)
    written = {text.get_text() for text in ax.texts} | {note.split(":")[0] for note in notes(figure)}
    assert written == {"NI", "no double-sided", *(f"{n} double-sided" for n in (1, 2, 3))}
    (lines,) = [each for each in ax.collections if each.get_gid() == "boundaries"]
    assert len({float(line[0, 0]) for line in lines.get_segments()}) == 4  # between labels of one group there is none


@pytest.mark.parametrize(
    ("quantity", "words"),
    [
        ("double_sided_impacts", {"0", "1", "2", "3"}),
        ("primary_impacts", {str(count) for count in range(7)}),
        ("double_sided", {"no", "yes"}),
        ("label=DS(2)", {"no", "yes"}),
        ("severity<=8000", {"no", "yes"}),
    ],
)
def test_what_labels_tell_and_what_holds_are_regions_with_lines_between(
    nine: Results, quantity: str, words: set[str]
) -> None:
    figure = plot.draw(nine, quantity)
    ax = figure.axes[0]
    values = quantity_of(quantity, nine).of_runs(nine)
    for text in ax.texts:
        x, y = text.get_position()
        cell = np.argmin(np.abs(RATIO.values - x)), np.argmin(np.abs(BACKLASH.values - y))
        assert {"no": 0.0, "yes": 1.0}.get(text.get_text()) == values[cell] or text.get_text() == f"{values[cell]:g}"
    assert {text.get_text() for text in ax.texts} | {note.split(":")[0] for note in notes(figure)} == words
    parted = np.count_nonzero(np.diff(values, axis=0)) + np.count_nonzero(np.diff(values, axis=1))
    (lines,) = [each for each in ax.collections if each.get_gid() == "boundaries"]
    steps = RATIO.values[1] - RATIO.values[0], BACKLASH.values[1] - BACKLASH.values[0]
    length = sum(float(np.abs(np.diff(line, axis=0)[0] / steps).sum()) for line in lines.get_segments())
    assert length == pytest.approx(parted)


# --- severity and other quantities


def test_the_ridge_is_the_largest_severity_of_each_load_ratio(nine: Results) -> None:
    ridge = ridge_of(nine.severity)
    known = np.isfinite(ridge)
    assert known.sum() > 30
    np.testing.assert_array_equal(ridge[known], np.argmax(nine.severity, axis=1)[known])


def test_the_colours_of_the_severity_map_are_the_severity(nine: Results) -> None:
    figure = plot.draw(with_cells(nine, [np.s_[30:40, 30:40]], -1), "severity")
    shades = shades_of([Layers.of(nine, View.of_grid(nine), "severity")]).to_rgba(nine.severity)[..., :3]
    shades[30:40, 30:40] = to_rgb(FAILED_FILL)
    expected = shades[1:-1, 1:-1].reshape(-1, 3)
    np.testing.assert_allclose(colours_at(figure.axes[0], *cell_places(nine)) / 255.0, expected, atol=0.005)  # 8 bits
    assert figure.axes[1].get_ylabel() == "Severity Q [rad/s²]"


@pytest.mark.parametrize(
    ("quantity", "lacks", "message"),
    [
        ("loudness", "margin", "severity, approach_velocity"),
        ("severity", "severity", "approach_velocity"),  # as under the restitution model
        ("margin", "margin", r"only the exact method knows it \(solver\.method\)"),
    ],
)
def test_what_cannot_be_drawn_is_answered_with_what_can(nine: Results, quantity: str, lacks: str, message: str) -> None:
    results = with_arrays(nine, **{lacks: np.full(nine.shape, np.nan)})
    with pytest.raises(ClunkError, match=message):
        plot.draw(results, quantity)
    assert plot.draw(results, "regimes").axes[0].texts


def test_undecided_cells_are_blurred_and_counted(nine: Results) -> None:
    quality = nine.quality.copy()
    cells = [(3, 40), (30, 7), (55, 0)]
    for cell in cells:
        quality[cell] |= QUALITY_UNDECIDED
    figure = regime_map(with_arrays(nine, quality=quality))
    assert notes(figure)[-1] == "blurred, undecided: 3 cells"
    (dots,) = [line for line in figure.axes[0].lines if line.get_gid() == "undecided"]
    expected = [(RATIO.values[i], BACKLASH.values[j]) for i, j in cells]
    np.testing.assert_allclose(dots.get_xydata(), expected)
    assert not [line for line in regime_map(nine).axes[0].lines if line.get_gid() == "undecided"]


# --- one axis


def one_axis(codes: list[int], severity: np.ndarray | None = None) -> Results:
    ratio = replace(RATIO, values=np.linspace(0.0, 10.0, len(codes)) if len(codes) > 1 else np.array([5.0]))
    severity = 100.0 * ratio.values if severity is None else severity
    return make((ratio,), LABELS[: max(codes) + 1], np.array(codes), severity)


def test_a_strip_names_the_regimes_over_the_curve() -> None:
    results = one_axis([0] * 30 + [1] * 40 + [4] * 60 + [7] * 70 + [8] * 1)
    results = replace(results, labels=("NI", "SS(1)", *LABELS[2:]))
    figure = plot.draw(results, "severity")
    band, curve = figure.axes
    for text in band.texts:
        x = band.transData.inverted().transform(outline(box_of(text)))[:, 0]
        for cell in np.rint(x * 20).astype(int):
            assert results.labels[results.sequence[cell]] == text.get_text()
    assert {text.get_text() for text in band.texts} == {"NI", "SS(1)", "DS(1)SS(1)", "DS(2)SS(1)"}
    assert "DS(3): 0.5 %" in notes(figure)
    points = np.concatenate([line.get_xydata() for line in curve.lines if len(line.get_xdata()) != 2])
    np.testing.assert_array_equal(points, np.column_stack((results.axes[0].values, results.severity))[: len(points)])
    assert curve.get_ylabel() == "Severity Q [rad/s²]"


def test_a_strip_of_answers_jumps_between_no_and_yes() -> None:
    figure = plot.draw(one_axis([0] * 5 + [4] * 5, 1000.0 * np.arange(10.0)), "severity<=6500")
    curve = figure.axes[1]
    assert [text.get_text() for text in curve.get_yticklabels()] == ["no", "yes"]
    heights = [set(line.get_ydata()) for line in curve.lines if line.get_marker() == "o"]
    assert heights == [{1.0}, {1.0}, {0.0}]  # no line slopes from one to the other


def test_a_strip_of_counts_has_whole_ticks() -> None:
    results = one_axis([0] * 3 + [4] * 3)
    figure = plot.draw(results, "double_sided_impacts")
    ticks = figure.axes[1].get_yticks()
    assert np.array_equal(ticks, np.rint(ticks))


def test_a_single_cell_is_drawn_as_a_strip(tmp_path: Path) -> None:
    figure = plot.draw(one_axis([4]), "regimes")
    assert [text.get_text() for text in figure.axes[0].texts] == ["DS(1)SS(1)"]
    plot.save(figure, tmp_path / "cell.png")


def test_a_map_of_one_axis_is_refused() -> None:
    with pytest.raises(plot.PlotError, match="needs two axes, and here is one: "):
        View.of_plane(one_axis([0, 1]))


# --- files


def test_figures_are_saved_by_suffix_and_always_the_same(nine: Results, nine_map: Figure, tmp_path: Path) -> None:
    again = regime_map(nine, THRESHOLDS)
    for suffix, start in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
        plot.save(nine_map, one)
        plot.save(again, two)
        assert one.read_bytes().startswith(start)
        assert one.read_bytes() == two.read_bytes()
    assert len(list(tmp_path.iterdir())) == 6


def test_an_unknown_suffix_is_answered_with_the_known(nine_map: Figure, tmp_path: Path) -> None:
    for name in ("map.jpg", "map"):
        with pytest.raises(ClunkError, match=r"must end in \.png, \.svg, \.pdf"):
            plot.save(nine_map, tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(ClunkError, match="cannot be written: "):
        plot.save(nine_map, tmp_path / "file" / "map.png")


def test_a_users_settings_neither_change_the_figure_nor_are_changed(tmp_path: Path) -> None:
    results = one_axis([0, 0, 1, 1])
    plot.save(plot.draw(results, "regimes"), tmp_path / "one.png")
    with matplotlib.rc_context({"font.size": 30.0, "axes.facecolor": "red", "savefig.dpi": 30.0}):
        before = dict(matplotlib.rcParams)
        plot.save(plot.draw(results, "regimes"), tmp_path / "two.png")
        assert dict(matplotlib.rcParams) == before
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def of_two_frequencies(first: float, second: float, *, fails: bool = False) -> Results:
    """Maps of two frequencies with so many touches and so large a severity in each cell; the first may have failed."""
    axis = ResultAxis("load.frequency", np.array([3.0, 4.0]), "frequency", "f", "Hz")
    few = [replace(each, values=each.values[:4]) for each in (RATIO, BACKLASH)]
    values = np.tile(np.array([first, second])[:, None, None], (1, 4, 4))
    sequence = np.zeros(values.shape, np.int16)
    sequence[0] -= fails
    results = make((axis, *few), ("SS(1)",), sequence, np.where(sequence < 0, np.nan, values))
    return with_arrays(results, touches=values.astype(np.int32))


def test_a_panel_of_one_answer_has_its_colour_and_units_are_no_symbols() -> None:
    results = of_two_frequencies(3.0, 30.0)
    figure = plot.draw(results, "touches<=16", facets=["load.frequency"])
    panels = figure.subfigs[0].axes
    assert [panel.get_title(loc="left") for panel in panels] == [f"f = {f} Hz" for f in (3, 4)]
    (pale,), (deep,) = ({*map(tuple, colours_of(results, frequency))} for frequency in (4.0, 3.0))  # no, yes
    mixed = with_arrays(results, touches=np.where(np.arange(4) < 2, 3, 30).astype(np.int32) + 0 * results.touches)
    assert {*map(tuple, colours_of(mixed, 4.0))} == {pale, deep}


def colours_of(results: Results, frequency: float) -> np.ndarray:
    """Colours of the cells of one panel, by whether there are at most 16 touches."""
    part = results.at({"load.frequency": frequency})
    layers = Layers.of(part, View.of_plane(part), "touches<=16")
    return layers.colours_of(layers.codes).reshape(-1, 3)


def test_a_legend_of_several_panels_has_the_order_of_labels() -> None:
    axis = ResultAxis("load.frequency", np.array([3.0, 4.0]), "frequency", "f", "Hz")
    shape = (2, len(RATIO), len(BACKLASH))
    sequence = np.where(np.indices(shape).sum(axis=0) % 2, 0, [[[1]], [[2]]]).astype(np.int16)  # no name has room
    results = make((axis, RATIO, BACKLASH), ("DS(3)", "SS(2)", "SS(1)"), sequence, np.ones(shape))
    texts = notes(plot.draw(results, "regimes", facets=["load.frequency"]))
    assert [text for text in texts if text in results.labels] == ["SS(1)", "SS(2)", "DS(3)"]


def test_a_panel_without_any_value_is_grey_beside_others() -> None:
    figure = plot.draw(of_two_frequencies(3.0, 30.0, fails=True), "severity", facets=["load.frequency"])
    assert [panel.get_title(loc="left") for panel in figure.subfigs[0].axes[:2]] == [f"f = {f} Hz" for f in (3, 4)]
    with pytest.raises(plot.PlotError, match="all runs have failed"):
        plot.draw(of_two_frequencies(3.0, 3.0, fails=True).at({"load.frequency": 3.0}), "severity")
