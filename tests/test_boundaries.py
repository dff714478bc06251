"""Boundaries are where single runs change their labels, close to regions, and meet where linear theory has them."""

import dataclasses
import json
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from conftest import NOMINAL, axis
from helpers.feet import feet_of_figure_3_4
from helpers.studies import random_study
from matplotlib.path import Path as Outline

import clunk
from clunk.analysis import lines
from clunk.analysis.boundaries import boundaries
from clunk.analysis.search import POINT
from clunk.results.boundaries import Boundaries
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.rules import count_of_regimes

ROOT = Path(__file__).parents[1]
EXACT = "solver.method='exact'"


def study(*axes, of=(EXACT,)):
    return study_from_text(NOMINAL + "".join(axes), overrides=of)


def figure(count):
    return study(axis("load.ratio", 0.0, 10.0, count), axis("lash.backlash_deg", 0.0, 20.0, count))


RANGE = np.array([10.0, 20.0])


@pytest.fixture(scope="module")
def coarse():
    return clunk.sweep(figure(41), boundaries=True).boundaries


@pytest.fixture(scope="module")
def finer():
    return clunk.sweep(figure(61), boundaries=True).boundaries


def label_at(swept, point):
    """Label of a single run."""
    values = {axis.parameter: value for axis, value in zip(swept.sweep.axes, point.tolist(), strict=True)}
    return clunk.simulate(clunk.replace_values(swept, values)).label


def across(curve, k):
    """A vertex and the unit normal to the left of its curve, both in shares of the map."""
    along = np.diff(curve.vertices[[k - 1, k + 1]] / RANGE, axis=0)[0]
    return curve.vertices[k] / RANGE, np.array([-along[1], along[0]]) / np.hypot(*along)


def is_within(region, point):
    """Whether a point is within a region's outer ring and in none of its holes."""
    inside = [Outline(ring).contains_point(point) for ring in region.rings]
    return inside[0] and not any(inside[1:])


def test_each_vertex_is_where_single_runs_change(coarse):
    """Bisection across the curve, to 1e-13 of the map, ends within 1e-9 of it."""
    swept, generator = figure(41), np.random.default_rng(0)
    long = [curve for curve in coarse.curves if len(curve.vertices) > 4]
    assert len(long) > 5
    for curve in long[:8]:
        k = int(generator.integers(len(curve.vertices) // 3, len(curve.vertices) - 1))
        if min(np.abs((point - curve.vertices[k]) / RANGE).max() for point, _ in coarse.meetings) < 1e-6:
            continue  # where a third label is next to both
        vertex, left = across(curve, k)
        low, high = -1e-7, 1e-7
        assert label_at(swept, (vertex + high * left) * RANGE) == curve.left
        assert label_at(swept, (vertex + low * left) * RANGE) == curve.right
        while high - low > 1e-13:
            middle = 0.5 * (low + high)
            is_left = label_at(swept, (vertex + middle * left) * RANGE) == curve.left
            low, high = (low, middle) if is_left else (middle, high)
        assert abs(low) <= 1e-9


@pytest.mark.parametrize(("width", "values"), [(8e-4, 9), (2e-3, 13)])
def test_beside_a_chord_that_is_not_unresolved_a_label_changes(width, values):
    """Bent bands in parallel, thinner than the cells that they cross: what parts one from another is no chord."""

    def run(points):
        across = 3.0 * (points[:, 1] - 0.9 * points[:, 0] - 0.05 * np.sin(5.0 * points[:, 0])) % 1.0
        runs = np.zeros(len(points), POINT)
        runs["outcome"] = across < 3.0 * width
        runs["measure"] = np.minimum(across, abs(across - 3.0 * width))
        return runs

    shares = np.linspace(0.0, 1.0, values)
    nodes = np.stack(np.meshgrid(shares, shares, indexing="ij"), axis=-1).reshape(-1, 2)
    traced = lines.Lines(lines.Triangles(shares, shares, run(nodes).reshape(values, values)), run, 25, 0)
    traced.trace()
    ends = traced.position(traced.segments()[0].ravel()).reshape(-1, 2, 2)
    ends = ends[np.hypot(*np.diff(ends, axis=1)[:, 0].T) > 1e-3]
    middle, along = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0]
    normal = along[:, ::-1] * [-1.0, 1.0] / np.hypot(*along.T)[:, None]
    beside = middle + np.linspace(-2e-4, 2e-4, 41)[:, None, None] * normal
    labels = run(beside.reshape(-1, 2))["outcome"].reshape(41, -1)
    in_cell = {*map(tuple, (traced.unresolved * (values - 1)).astype(int).tolist())}
    is_told = [tuple(cell) not in in_cell for cell in (middle * (values - 1)).astype(int).tolist()]
    assert sum(is_told) > 50
    assert (labels != labels[0]).any(axis=0)[is_told].all()


def test_triangles_whose_height_rounding_would_take_are_not_cut_and_are_told_as_unresolved():
    """Cut further, they turned over, and made regions without area."""

    def run(points):
        runs = np.zeros(len(points), POINT)
        runs["outcome"], runs["measure"] = 10.0 * points[:, 0], np.nan
        return runs

    across, upward = np.linspace(0.0, 1.0, 3), np.array([0.0, 5e-12, 1.0])
    grid = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1).reshape(-1, 2)
    triangles = lines.Triangles(across, upward, run(grid).reshape(3, 3))
    traced = lines.Lines(triangles, run, 20, 0)
    traced.trace()
    assert triangles.positions[9:, 1].min() > 5e-12
    assert traced.unresolved[:, 1].min() < 5e-12
    assert traced.unresolved[:, 1].max() < 5e-11  # above them all lines are told


def test_junctions_do_not_depend_on_the_start(coarse, finer):
    """Figure 3.4 has three feet, at which three labels meet on the frame, and two crossings of boundaries, of four.

    A junction is within a triangle of 1e-7 of the map.
    """
    for other in (finer, clunk.sweep(figure(121), boundaries=True).boundaries):
        for one, again in zip(coarse.meetings, other.meetings, strict=True):
            assert one[1] == again[1]
            assert one[0] / RANGE == pytest.approx(again[0] / RANGE, abs=2e-7)
    assert sorted(len(labels) for _, labels in coarse.meetings) == [3, 3, 3, 4, 4]


def test_feet_are_those_of_the_linear_chain(coarse):
    feet = [point for point, labels in coarse.meetings if len(labels) == 3]
    assert [ratio for ratio, _ in feet] == pytest.approx(feet_of_figure_3_4()[:3].tolist(), rel=1e-6)
    assert max(gap for _, gap in feet) <= 1e-7 * 20.0


def test_feet_are_located_with_the_runs_that_rk4_has():
    """At a foot runs have touches without end, each 50 of which count as a run: there are none to spare."""
    network = clunk.sweep(clunk.load_study(ROOT / "configs/smoke.toml"), boundaries=True).boundaries
    feet = [point for point, labels in network.meetings if len(labels) == 3]
    assert [ratio for ratio, _ in feet] == pytest.approx(feet_of_figure_3_4()[:3].tolist(), rel=1e-6)


def test_chords_are_near_their_curves(coarse):
    """Beside the middle of a chord, 2e-4 of the map away, the labels are those of its sides."""
    swept = figure(41)
    curves = [curve for curve in coarse.curves if "OS" not in curve.left + curve.right]  # these are thinner than that
    ends = [np.stack([curve.vertices[:-1], curve.vertices[1:]], axis=1) / RANGE for curve in curves]
    chords = np.concatenate(ends)
    sides = np.concatenate([[(curve.left, curve.right)] * len(part) for curve, part in zip(curves, ends, strict=True)])
    along = chords[:, 1] - chords[:, 0]
    length = np.hypot(*along.T)
    middle = chords.mean(axis=1)
    inside = (length > 1e-3) & (np.abs(middle - 0.5) < 0.499).all(axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)[inside] / length[inside, None]
    for side, sign in enumerate((2e-4, -2e-4)):
        points = (middle[inside] + sign * normal) * RANGE
        runs = clunk.run_points(swept, {"load.ratio": points[:, 0], "lash.backlash_deg": points[:, 1]})
        assert (runs.label_map == sides[inside, side]).mean() > 0.99  # beside junctions a third label may be there


def test_regions_fill_the_map_and_have_the_labels_of_runs_in_them(coarse):
    assert coarse.region_area.sum() == pytest.approx(1.0, abs=1e-12)
    points = np.random.default_rng(1).random((300, 2)) * RANGE
    runs = clunk.run_points(figure(41), {"load.ratio": points[:, 0], "lash.backlash_deg": points[:, 1]})
    for point, label, margin in zip(points, runs.label_map, runs.margin, strict=True):
        labels = [region.label for region in coarse.regions if is_within(region, point)]
        assert labels == [label] or abs(margin) < 1e-3


def test_no_line_is_lost_between_others_on_an_edge():
    """Between two cells a longer ramp leaves double-sided impacts, a single-sided one, none, and a single-sided one."""
    ramp = [EXACT, 'load.profile="ramp"']
    swept = study(axis("load.duration", 0.2, 0.45, 2), axis("load.ratio", 9.5, 10.5, 2), of=ramp)
    network = clunk.sweep(swept).boundaries
    assert "NI" in {region.label for region in network.regions}
    points = [0.2, 9.5] + [0.25, 1.0] * np.random.default_rng(3).random((300, 2))
    runs = clunk.run_points(swept, {"load.duration": points[:, 0], "load.ratio": points[:, 1]})
    found = [[region.label for region in network.regions if is_within(region, point)] for point in points]
    wrong = sum(labels != [label] for labels, label in zip(found, runs.label_map, strict=True))
    assert wrong <= 1  # within a chord's distance of a line; 115 lay in the lost region


def test_thin_regions_are_found_between_cells_of_one_label(finer):
    cells = set(clunk.sweep(figure(61), boundaries=False).labels)
    thin = [region for region in finer.regions if region.label not in cells]
    assert {"OS(1)DS(1)", "DS(1)OS(1)DS(1)"} <= {region.label for region in thin}
    assert max(region.area for region in thin) < 1e-4
    generator, points, labels = np.random.default_rng(4), [], []
    for region in thin:
        ring = region.rings[0][:-1]
        corners = generator.integers(len(ring), size=2000)[:, None] + [0, 1, 2]
        inner = generator.dirichlet([1.0, 1.0, 1.0], 2000)[:, None] @ ring[corners % len(ring)]
        inner = [point for point in inner[:, 0] if is_within(region, point)][:100]
        points += inner
        labels += [region.label] * len(inner)
    ratios, gaps = np.transpose(points)
    runs = clunk.run_points(figure(61), {"load.ratio": ratios, "lash.backlash_deg": gaps})
    assert (runs.label_map == labels).mean() > 0.8  # the ends are cut where they are thinner than a chord is off


def test_thin_regions_are_found_beside_lines():
    """Beside the line between a car's DS(1)OS(1)CR(1) and its OS(2)CR(1) are strips with a single-sided impact more."""
    swept = clunk.load_study(
        ROOT / "configs/car_tip_out.toml",
        [
            *("sweep.axes[1].start=0.135", "sweep.axes[1].stop=0.15", "sweep.axes[1].count=4"),
            *("sweep.axes[2].start=78", "sweep.axes[2].stop=81", "sweep.axes[2].count=4"),
        ],
    )
    results = clunk.sweep(swept)
    assert {*results.label_map.ravel().tolist()} == {"DS(1)OS(1)CR(1)", "OS(2)CR(1)"}
    of_label = "DS(1)SS(1)OS(1)CR(1)"
    places = np.random.default_rng(0).random((2000, 2))
    points = {
        each.parameter: each.values[0] + places[:, k] * np.ptp(each.values) for k, each in enumerate(results.axes)
    }
    share = (clunk.run_points(swept, points).label_map == of_label).mean()
    found = sum(region.area for region in results.boundaries.regions if region.label == of_label)
    # not looked for beside lines, a third of the strips was found; those that meet no edge with a crossing are missed
    # still, and a share of 3 % of 2,000 points is known to a tenth
    assert 0.5 * share < found < 1.1 * share


BANDS = """
[driveline]
inertias = [0.03, 0.02]
[[driveline.shafts]]
between = [1, 2]
stiffness = 80.0
damping = 0.15
[[driveline.shafts]]
between = [1, "ground"]
stiffness = 0.0
damping = 0.05
[lash]
between = ["ground", 2]
backlash_deg = 2.0
radius = 0.03
ratio = -1.5
contact.model = "restitution"
contact.restitution = 0.7
[load]
profile = "lag"
initial_torque = 5.0
final_torque = -1.0
time_constant = 0.05
[solver]
method = "exact"
end_time = 1.5
"""


def test_bands_across_cells_of_one_label_are_no_slits():
    """Three bands that a coefficient of restitution does not bend lie between nodes of a map with the same label.

    An edge that they all cross, with one label at both ends, was left as it was, and triangles became thin beside it.
    """
    axes = axis("load.time_constant", 0.2, 0.7 / 3, 3), axis("lash.contact.restitution", 0.0, 0.075, 3)
    network = clunk.sweep(study_from_text(BANDS + "".join(axes)), boundaries=True).boundaries
    regions = sorted(network.regions, key=lambda region: region.rings[0][:, 0].min())
    labels = [region.label for region in regions]
    assert labels == ["CR(1)", "SS(1)CR(1)", "SS(1)OS(1)CR(1)", "OS(1)CR(1)", "CR(1)"]
    assert network.region_area.sum() == pytest.approx(1.0, abs=1e-12)  # hundreds of roundings; 1.107 of the slits
    assert not len(network.unresolved)


def test_events_are_what_differs_between_the_two_runs(coarse):
    """At a grazing a run has one touch more, of almost no speed; at a sticking time both runs have the same events."""
    swept = figure(41)
    events = Counter(curve.event for curve in coarse.curves)
    assert {"grazing_of_the_opposite_flank", "end_of_sticking"} <= set(events)
    for curve in coarse.curves:
        if len(curve.vertices) < 6 or "OS" in curve.left + curve.right:  # thinner than the pair is apart
            continue
        vertex, left = across(curve, len(curve.vertices) // 2)
        pair = [(vertex + sign * 2e-9 * left) * RANGE for sign in (1.0, -1.0)]
        runs = [clunk.simulate(clunk.replace_values(swept, {"load.ratio": x, "lash.backlash_deg": y})) for x, y in pair]
        assert {run.label for run in runs} == {curve.left, curve.right}
        same = np.array_equal(*(run.events["kind"][: min(len(each.events) for each in runs)] for run in runs))
        assert (curve.event == "sticking_time_reached") == (same and runs[0].touches == runs[1].touches)


def test_a_curve_that_is_not_located_has_no_event(monkeypatch):
    """Any number of other labels may lie between the two that it parts."""
    monkeypatch.setattr(lines, "_ON_ANY_MAP", 1)
    monkeypatch.setattr(lines, "_RUNS_PER_CELL", 0)
    found = clunk.sweep(figure(6), boundaries=True).boundaries
    assert len(found.unresolved)
    assert {curve.event for curve in found.curves} == {"unknown"}


def test_a_line_beside_failed_cells_is_told_to_less_and_not_unresolved():
    """Without a torque before the load step there is no initial flank: a line of failed runs, of no width."""
    axes = axis("load.initial_torque", -6.0, 6.0, 5), axis("lash.backlash_deg", 2.0, 6.0, 3)
    swept = clunk.sweep(study(*axes, of=(EXACT, "load.final_torque=-1")), boundaries=True)
    assert (swept.status[2] != 0).all()
    assert not len(swept.boundaries.unresolved)
    assert swept.boundaries.areas[FAILED] < 2e-3


def test_failed_cells_are_a_label_whose_regions_are_filled_and_a_slice_has_no_boundaries():
    axes = axis("load.ratio", 2.0, 6.0, 9), axis("lash.backlash_deg", 2.0, 6.0, 9)
    failing = clunk.sweep(study(*axes, of=(EXACT, "solver.max_events=16")), boundaries=True)
    assert FAILED in failing.boundaries.areas
    assert sum(failing.boundaries.areas.values()) == pytest.approx(1.0)
    (ax,) = clunk.draw(failing).axes[:1]
    assert [patch for patch in ax.patches if patch.get_gid() == "region failed"]
    assert failing.at({"load.ratio": 4.0}).boundaries is None


def test_rk4_has_the_boundaries_of_the_exact_method():
    """Its impact times are within 3.5e-6 s, of runs of 1 s."""
    axes = axis("load.ratio", 2.0, 4.0, 9), axis("lash.backlash_deg", 9.0, 11.0, 9)
    (exact,), (rk4,) = (
        clunk.sweep(study(*axes, of=(f"solver.method={method}",)), boundaries=True).boundaries.meetings
        for method in ("exact", "rk4")
    )
    assert exact[1] == rk4[1]
    assert exact[0] == pytest.approx(rk4[0], abs=1e-4)


def test_any_order_of_axes_has_the_same_network():
    across, upward = axis("load.ratio", 4.0, 9.0, 61), axis("lash.backlash_deg", 9.0, 12.0, 61)
    whole = clunk.sweep(study(across, upward), boundaries=True).boundaries
    turned = clunk.sweep(study(upward, across), boundaries=True).boundaries
    assert [labels for _, labels in whole.meetings] == [labels for _, labels in turned.meetings]
    for (one, _), (other, _) in zip(whole.meetings, turned.meetings, strict=True):
        # each lies in a triangle of at most 5e-8 of the axes, of which the longer one spans 5
        assert one == pytest.approx(other[::-1], abs=5e-7)
    assert whole.areas == pytest.approx(turned.areas, abs=2e-5)  # a chord may be off by 1e-4


# Maps with a label without width, chaos, rest at a breakpoint of a shaft, or hundreds of touches.
HARD = {
    "car_tip_out": ("car_tip_out", ()),
    "two_lashes": ("two_lashes", ()),
    "rig_with_friction": ("rig_with_friction", ()),
    "damping": ("", ("lash.contact.damping", 0.05, 3.0)),
    "restitution": ('model = "restitution"\n', ("lash.contact.restitution", 0.0, 0.96)),
}
# Studies of staged shafts, frictions, gears, all profiles but the report's step.
RANDOM = (20, 23, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (10, 29, 39)))


def hard_study(name):
    """A study of 13 values an axis."""
    counts = [f"sweep.axes[{k}].count=13" for k in (1, 2)]
    if isinstance(name, int):
        return random_study(name, EXACT, *counts)
    given, swept_to = HARD[name]
    if not swept_to:
        return clunk.load_study(ROOT / f"configs/{given}.toml", counts)
    text = NOMINAL.replace("[load]", f"[lash.contact]\n{given}[load]")
    return study_from_text(text + axis("load.ratio", 0.0, 10.0, 13) + axis(*swept_to, 13), overrides=(EXACT,))


@pytest.mark.parametrize("name", [*HARD, *RANDOM])
def test_tracing_of_hard_maps_ends_and_its_regions_have_the_labels_of_runs_in_them(name, monkeypatch):
    """Outside of unresolved cells 2 % of the points may lie in regions smaller than a cell, 1/12 of the map.

    With a twelfth of the runs that such coarse maps have, which end likewise.
    """
    monkeypatch.setattr(lines, "_ON_ANY_MAP", lines._ON_ANY_MAP // 12)
    swept = hard_study(name)
    results, told = clunk.sweep(swept, boundaries=False), []
    network = boundaries(swept, results, progress=lambda *numbers: told.append(numbers))
    batches, totals = zip(*told, strict=True)
    assert set(totals) == {0}  # unknown
    cells = 13 * 13 + int(results.touches.sum()) // 10  # ten touches count as a run
    assert batches[-1] <= lines.most_runs(cells, 20 + count_of_regimes(swept)) + max(np.diff([0, *batches]))
    assert network.region_area.sum() == pytest.approx(1.0, abs=1e-9)
    low, span = (np.array([of(each.values) for each in network.axes]) for of in (np.min, np.ptp))
    shares = np.random.default_rng(2).random((300, 2))
    unresolved = {*map(tuple, ((network.unresolved - low) / span * 12.0).astype(int).tolist())}
    points = low + shares * span
    points_by_key = dict(zip((each.parameter for each in network.axes), points.T, strict=True))
    runs = clunk.run_points(swept, points_by_key).of_lash()
    labels = [next(region.label for region in network.regions if is_within(region, point)) for point in points]
    is_clear = [tuple(cell) not in unresolved for cell in (shares * 12.0).astype(int).tolist()]
    assert (np.array(labels) != runs.label_map)[is_clear].sum() <= 6


def test_a_logarithmic_axis_is_measured_in_its_logarithm():
    gap = axis("lash.backlash_deg", 1.0, 16.0, 33, 'scale = "log"\n')
    network = clunk.sweep(study(axis("load.ratio", 2.0, 8.0, 33), gap), boundaries=True).boundaries
    assert network.region_area.sum() == pytest.approx(1.0)
    corners = np.concatenate([ring for region in network.regions for ring in region.rings])
    assert corners.min(axis=0).tolist() == [2.0, 1.0]
    assert corners.max(axis=0).tolist() == [8.0, 16.0]


def test_geojson_has_closed_rings_in_the_right_sense(coarse):
    features = json.loads(json.dumps(coarse.geojson()))["features"]
    assert "lash" not in coarse.geojson()  # of one; of several it names theirs
    assert dataclasses.replace(coarse, lash="gearbox").geojson()["lash"] == "gearbox"
    counts = Counter(feature["geometry"]["type"] for feature in features)
    assert counts == {
        "Polygon": len(coarse.regions),
        "LineString": len(coarse.curves),
        "Point": len(coarse.meetings) + len(coarse.unresolved),
    }
    for feature in features:
        for k, ring in enumerate(
            feature["geometry"]["coordinates"] if feature["geometry"]["type"] == "Polygon" else ()
        ):
            x, y = np.array(ring).T
            assert ring[0] == ring[-1]
            assert (np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0.0) == (k == 0)


RATIO, LASH = axis("load.ratio", 2.0, 6.0, 3), axis("lash.backlash_deg", 2.0, 6.0, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs .*sweep.axes"),
        (axis("load.ratio", 2.0, 6.0, 3), "a map of two axes, .* clunk thresholds --along load.ratio"),
        (RATIO + axis("lash.backlash_deg", 2.0, 2.0, 1), "along lash.backlash_deg .* has one value"),
        (RATIO + LASH + axis("driveline.inertias[4]", 0.001, 0.002, 3), "the config has 3"),
        (RATIO + axis("impacts.acceleration_of", 1.0, 3.0, 3), "whole number"),
        ('[sweep]\ndesign = "zip"\n' + RATIO + LASH, "neither"),
        *(
            (
                f'{RATIO}[[sweep.{table}]]\nparameter = "lash.backlash_deg"\ndistribution = "normal"\nstd = 0.1\n',
                message,
            )
            for table, message in (("samples", "neither"), ("tolerances", "tolerance map"))
        ),
    ],
)
def test_what_has_no_boundaries_is_refused_in_a_sentence_before_anything_runs(text, message):
    with pytest.raises(ClunkError, match=message):
        boundaries(study(text), None)


FIELDS = [field.name for field in dataclasses.fields(Boundaries) if field.name not in ("axes", "labels")]


@pytest.fixture
def command(command):
    def run(*words):
        code, out, err = command(*words)
        return code, out, " ".join(err.split())

    return run


def test_the_command_adds_boundaries_to_a_file_tells_of_them_and_exports_them(command, tmp_path):
    axes = axis("load.ratio", 0.0, 10.0, 21), axis("lash.backlash_deg", 0.0, 20.0, 21)
    (tmp_path / "c.toml").write_text(NOMINAL + "".join(axes), encoding="utf-8")
    sweep = ("sweep", "c.toml", "--set", EXACT, "-o", "r.h5")
    assert command(*sweep, "--no-boundaries")[0] == 0
    code, _, err = command("export", "r.h5", "b.geojson")
    assert code == 2
    assert "has no boundaries; clunk sweep --boundaries adds those of a grid of two axes" in err
    code, _, err = command(*sweep)
    assert code == 0
    assert "already complete" in err
    traced = clunk.read_results("r.h5").boundaries
    swept = clunk.sweep(study(*axes)).boundaries
    assert traced.labels == swept.labels
    for field in FIELDS:
        assert np.array_equal(getattr(traced, field), getattr(swept, field)), field
    _, out, _ = command("info", "r.h5", "--check")
    assert f"{len(traced.curves)} curves" in out
    assert re.search(r"1\.432442\d+ .* NI, SS\(1\), DS\(1\)", out)
    _, out, _ = command("info", "r.h5", "--json")
    assert json.loads(out)["boundaries"]["areas"] == traced.areas
    assert command("export", "r.h5", "b.geojson")[0] == 0
    assert json.loads((tmp_path / "b.geojson").read_text("utf-8")) == json.loads(json.dumps(traced.geojson()))
    assert "must end in .csv, .geojson" in command("export", "r.h5", "b.txt")[2]


def test_a_config_says_whether_its_boundaries_are_traced_and_is_no_other_for_that(command, tmp_path):
    text = NOMINAL + axis("load.ratio", 2.0, 6.0, 9) + axis("lash.backlash_deg", 2.0, 6.0, 9)
    (tmp_path / "c.toml").write_text(text, encoding="utf-8")
    sweep = ("sweep", "c.toml", "--set", EXACT, "-o", "r.h5")
    assert command(*sweep, "--set", "sweep.boundaries=false")[0] == 0
    assert command(*sweep, "--set", "sweep.boundaries=true", "--no-boundaries")[0] == 0
    assert clunk.read_results("r.h5").boundaries is None
    code, _, err = command(*sweep)
    assert code == 0
    assert "already complete" in err
    assert clunk.read_results("r.h5").boundaries.region_area.sum() == pytest.approx(1.0)
    swept = study_from_text(text, overrides=(EXACT,))
    assert clunk.sweep(swept, boundaries=False).boundaries is None
    left_out = study_from_text(text, overrides=(EXACT, "sweep.boundaries=false"))
    assert clunk.sweep(left_out).boundaries is None
    assert clunk.sweep(left_out, boundaries=True).boundaries is not None
    assert "must be true or false" in command(*sweep, "--set", "sweep.boundaries=1")[2]


def test_a_map_is_kept_whole_where_its_tracing_is_interrupted(command, tmp_path, monkeypatch):
    axes = axis("load.ratio", 2.0, 6.0, 9), axis("lash.backlash_deg", 2.0, 6.0, 9)
    (tmp_path / "c.toml").write_text(NOMINAL + "".join(axes), encoding="utf-8")
    sweep = ("sweep", "c.toml", "--set", EXACT, "-o", "r.h5", "--boundaries")

    def interrupt(*_arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("clunk.analysis.lines.Lines.trace", interrupt)
        code, out, err = command(*sweep)
    assert code == 130
    assert "the map is complete in r.h5, without its boundaries" in err
    assert "DS(1)SS(1)" in out
    assert clunk.read_results("r.h5").boundaries is None
    assert not [*tmp_path.glob("*.partial")]
    code, _, err = command(*sweep)
    assert code == 0
    assert "already complete" in err
    assert clunk.read_results("r.h5").boundaries.region_area.sum() == pytest.approx(1.0)


def test_a_file_without_any_boundary_is_read_back_and_is_netcdf(command, tmp_path):
    xarray = pytest.importorskip("xarray")
    text = NOMINAL + axis("load.ratio", 0.0, 1.0, 5) + axis("lash.backlash_deg", 5.0, 9.0, 5)
    (tmp_path / "c.toml").write_text(text, encoding="utf-8")
    assert command("sweep", "c.toml", "--set", EXACT, "-o", "r.h5")[0] == 0
    traced = clunk.read_results("r.h5").boundaries
    sizes = xarray.load_dataset("r.h5", engine="h5netcdf").sizes
    assert (sizes["boundary"], sizes["region"]) == (0, 1)
    assert not traced.curves
    assert command("info", "r.h5")[0] == 0
    assert [each["geometry"]["type"] for each in traced.geojson()["features"]] == ["Polygon"]


@pytest.mark.parametrize("turned", [False, True])
def test_maps_are_drawn_with_the_traced_curves(turned):
    axes = axis("load.ratio", 0.0, 10.0, 21), axis("lash.backlash_deg", 0.0, 20.0, 21)
    results = clunk.sweep(study(*axes[:: -1 if turned else 1]), boundaries=True)
    (ax,) = clunk.draw(results).axes[:1]
    (lines,) = [each for each in ax.collections if each.get_gid() == "boundaries"]
    turn = slice(None, None, -1 if turned else 1)
    drawn = [line.tolist() for line in lines.get_segments()]
    curves = [curve.vertices[:, turn].tolist() for curve in results.boundaries.curves]
    assert [curve for curve in curves if curve in drawn] == drawn
    small = (each for each in results.boundaries.regions if each.area < 5e-6 and len(each.rings) == 1)
    unseen = [each.rings[0][:, turn].tolist() for each in small]
    for island in (curve for curve in curves if curve not in drawn):
        assert island[0] == island[-1]
        assert any(island[0] in ring for ring in unseen)
    filled = {patch.get_gid().removeprefix("region ") for patch in ax.patches if patch.get_gid()}
    assert filled == set(results.boundaries.areas)
    places = {text.get_text(): text.get_position() for text in ax.texts}
    for label in ("NI", "SS(1)", "DS(1)SS(1)", "DS(2)"):
        point = np.array(places[label][:: -1 if turned else 1])
        assert [region.label for region in results.boundaries.regions if is_within(region, point)] == [label]


def test_runs_beside_a_value_that_no_config_may_hold_fail_and_their_curves_have_no_event():
    """A gear of ratio 0 lies between those that turn its shaft either way."""
    ratios = study(axis("lash.ratio", -1.0, 1.0, 4), axis("load.ratio", 1.0, 3.0, 3))
    found = boundaries(ratios, clunk.sweep(ratios, boundaries=False))
    beside = (found.curve_left == FAILED_CODE) | (found.curve_right == FAILED_CODE)
    assert beside.any()
    assert not found.curve_event[beside].any()
