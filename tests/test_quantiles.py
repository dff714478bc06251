"""Thresholds under tolerances are those of single drawn drivelines, and their quantiles what counting them gives."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import NOMINAL, axis, drawn
from test_thresholds import DURATION, LASH, RAMP

import clunk as clunk_api
from clunk.analysis.thresholds import threshold_quantiles, thresholds
from clunk.plot.analyses import threshold_figure
from clunk.plot.style import PlotError
from clunk.results.quantities import quantity_of
from clunk.study.axes import ResultAxis
from clunk.study.config import study_from_text
from clunk.study.designs import nominal
from clunk.study.errors import ClunkError
from clunk.study.parameters import drawn_numbers, nominal_value

RAMPED = NOMINAL.replace("ratio = 5.0", 'profile = "ramp"\nratio = 5.0')
FEW = axis("load.ratio", 4.0, 8.0, 3)
COARSE = axis("load.duration", 0.0, 0.6, 31)
STIFFNESS = drawn("tolerances", "lash.contact.stiffness", "normal", draws="factor", std=0.05)
INERTIA = drawn("tolerances", "driveline.inertias[4]", "normal", draws="factor", std=0.05)
SHIFT = drawn("tolerances", "lash.backlash_deg", "normal", draws="offset", std=0.2)


def study(*tables, draws=8, of=()):
    text = f"{NOMINAL}{''.join(tables)}[sweep.sampling]\ncount = {draws}\nseed = 1\n"
    return study_from_text(text, overrides=("solver.method=exact", *of))


@pytest.fixture(scope="module")
def ramps():
    swept = study(FEW, COARSE, STIFFNESS, INERTIA, of=RAMP)
    return thresholds(swept, along="load.duration", of="double_sided")


def driveline(swept, draw, **at):
    """The study of one draw."""
    tolerances = swept.sweep.tolerances
    numbers = zip(tolerances, drawn_numbers(swept, tolerances), strict=True)
    values = {each.parameter: each.applied(n[draw], nominal_value(swept, each.parameter)).item() for each, n in numbers}
    return clunk_api.replace_values(swept, values | at)


def test_each_draw_changes_where_its_driveline_alone_changes(ramps):
    near = 1e-9 * 0.6  # the promise
    assert ramps.value.size >= 24
    for k in range(0, ramps.value.size, 5):
        at = ramps.at(int(ramps.cell[k]))
        draw = int(at.pop("draw")) - 1
        for value, code in ((ramps.value[k] - near, ramps.below[k]), (ramps.value[k] + near, ramps.above[k])):
            run = clunk_api.simulate(driveline(ramps.study, draw, **at, **{"load.duration": value}))
            assert ("DS" in run.label) == ramps.word(code)


def test_shares_of_the_draws_are_the_probabilities_of_a_tolerance_map(ramps):
    by_cell = clunk_api.tolerance_map(ramps.study)
    values, draws = ramps.along.values[1:-1], len(ramps.axes[0].values)
    for cell in range(3):
        drawn = [[*ramps.intervals(3 * draw + cell)] for draw in range(draws)]
        holds = [[ramps.word(code) for x in values for begin, end, code in each if begin < x <= end] for each in drawn]
        expected = quantity_of("double_sided", by_cell).of_runs(by_cell)[cell, 1:-1]
        assert np.mean(holds, axis=0).tolist() == expected.tolist()


def test_a_tolerance_of_the_key_itself_shifts_its_thresholds():
    """The nominal lash is what is asked for; a driveline with 0.1° more changes at 0.1° less."""
    swept = study(axis("lash.backlash_deg", 1.0, 20.0, 20), SHIFT, of=("load.ratio=2.0",))
    drawn = thresholds(swept, along="lash.backlash_deg", of="double_sided")
    (value,) = thresholds(nominal(swept), along="lash.backlash_deg", of="double_sided").value
    (offsets,) = drawn_numbers(swept, swept.sweep.tolerances)
    assert drawn.value == pytest.approx(value - offsets, abs=2e-9 * 20.0)


def test_quantiles_of_single_thresholds_are_those_of_numpy(ramps):
    """With one threshold a draw, 95 % of the drivelines are safe from the 95 % quantile on, an order statistic."""
    shares = [0.5, 0.6, 0.75, 0.95, 1.0]
    result = threshold_quantiles(ramps, shares)
    for cell, ratio in enumerate(ramps.axes[1].values):
        values = ramps.value[ramps.cell % 3 == cell]
        assert values.size == 8
        for share in shares:
            ((begin, end),) = result.where(False, load_ratio=ratio, quantile=share)
            assert begin == np.quantile(values, share, method="inverted_cdf")
            assert end == 0.6
            if share > 0.5:  # of half and half, what is safe goes before
                ((begin, end),) = result.where(True, load_ratio=ratio, quantile=share)
                assert (begin, -end) == (0.0, np.quantile(-values, share, method="inverted_cdf"))


@pytest.mark.parametrize(
    ("quantiles", "message"),
    [([0.05], "found 0.05"), ([95.0], "found 95"), ([], "found none"), ([0.5, 0.5], "found 0.5 and 0.5")],
)
def test_what_is_no_quantile_is_refused(ramps, quantiles, message):
    with pytest.raises(ClunkError, match=message):
        threshold_quantiles(ramps, quantiles)


def test_quantiles_need_draws(ramps):
    without = replace(ramps, axes=ramps.axes[1:])
    with pytest.raises(ClunkError, match=r"no \[\[sweep.tolerances\]\]"):
        threshold_quantiles(without)


def test_pictures_have_curves_of_each_quantile(ramps):
    result = threshold_quantiles(ramps, [0.5, 0.95])
    undrawn = thresholds(nominal(ramps.study), along="load.duration", of="double_sided")
    (ax,) = threshold_figure(result, undrawn).axes
    values = [set(result.value[result.cell % 2 == k]) for k in (0, 1)] + [set(undrawn.value)]
    colours = dict.fromkeys(line.get_color() for line in ax.lines)  # in the order in which they are drawn
    drawn = [{y for line in ax.lines if line.get_color() == colour for y in line.get_ydata()} for colour in colours]
    for curve, located in zip(drawn, values, strict=True):
        assert curve <= located
        assert all(min(abs(value - each) for each in curve) < 0.001 for value in located)  # what can be seen apart
    names = ["no", "yes", "in 50 %", "in 95 %", "without tolerances"]
    assert [text.get_text() for text in ax.figure.legends[0].get_texts()] == names
    more = (*ramps.axes, ResultAxis("lash.radius", np.array([1.0, 2.0]), "", "", "m"))
    with pytest.raises(PlotError, match="over one other axis"):
        threshold_figure(result, replace(undrawn, axes=more))


def test_the_command_says_and_writes_quantiles_or_draws(command, here):
    text = f"{RAMPED}{FEW}{COARSE}{STIFFNESS}{INERTIA}[sweep.sampling]\ncount = 8\n"
    (here / "config.toml").write_text(text, encoding="utf-8")
    words = ("thresholds", "config.toml", "--along", "load.duration", "--of", "double_sided")
    words = (*words, "--set", "solver.method=exact")
    code, out, err = command(*words, "--quantiles", "0.5,0.95", "-o", "t.csv")
    assert code == 0
    assert "in 24 drawn cells" in err
    assert "uncertain" in out
    _, out, _ = command(*words, "--json")
    listed = json.loads(out)
    rows = list(csv.DictReader((here / "t.csv").read_text().splitlines()))
    assert [(float(row["quantile"]), float(row["load.duration"])) for row in rows] == [
        (row["quantile"], row["load.duration"]) for row in listed
    ]
    assert command(*words, "-o", "t.png")[0] == 0


@pytest.mark.parametrize(
    ("tables", "arguments", "message"),
    [
        (DURATION, ("--quantiles", "0.9"), "need [[sweep.tolerances]]"),
        (DURATION + INERTIA, ("--quantiles", "0.9,x"), "no list of numbers"),
        (DURATION + INERTIA, ("--quantiles", "0.05"), "from 0.5 to 1"),
        (DURATION + FEW + LASH + INERTIA, ("-o", "t.png"), "over one other axis"),
        ("duration = 0.1\n" + INERTIA, (), "the config needs [[sweep.axes]]"),
    ],
)
def test_the_command_refuses_before_it_runs(command, here, tables, arguments, message):
    (here / "config.toml").write_text(RAMPED + tables, encoding="utf-8")
    code, _, err = command("thresholds", "config.toml", "--along", "load.duration", *arguments)
    assert code == 2
    assert message in " ".join(err.split())
