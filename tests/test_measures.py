"""Impulse, peak torque and energy of impacts, and measures of one's own, beside the sampled motion and exact laws."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from test_store import BACKLASH, RATIO, example

import clunk
from clunk.analysis.thresholds import thresholds
from clunk.cli import cli
from clunk.cli.simulate import run_record
from clunk.core import measures
from clunk.core.events import REJOIN, SEPARATION, TOUCH
from clunk.results.quantities import OF_RUNS, REGIME_QUANTITIES, quantity_of
from clunk.results.store import read_results, write_results
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError, ConfigError
from clunk.study.study import digest, replace_values
from clunk.sweeping.sweep import sweep

CLOSE = 1e-6  # relative: three times what lies between two samples
SHORT = ["solver.end_time=0.4", 'solver.method="exact"']
NAMED = 'title = "measured"\n[driveline]\npreset = "boere-2008"\nnames = ["motor", "flange", "pinion", "ring"]\n'
MEASURES = {
    "shuffle": ("acceleration", "motor", "largest"),
    "pinion": ("acceleration", 3, "peak-to-peak"),
    "wound_up": ("shaft torque", 2, "largest"),
    "wind_up": ("twist", 2, "peak-to-peak"),
    "play": ("twist", "lash 1", "peak-to-peak"),
    "hit": ("contact torque", "lash 1", "largest"),
}
RIGID = ["wound_up", "wind_up", "play", "shuffle"]  # of a run with impulses
STAGES = ["driveline.shafts[1].stiffness=[31.3, 10.0, 31.3]", "driveline.shafts[1].breakpoints_deg=[-4.0, 2.0]"]
POINT = {"load.ratio": 5.0, "lash.backlash_deg": 6.0}
OF_IMPACTS = ["impulse", "peak_torque", "energy"]
MAP = [
    "sweep.axes=[{parameter='load.ratio', start=0.0, stop=10.0, count=5}, "
    "{parameter='lash.backlash_deg', start=1.0, stop=19.0, count=4}]",
    f"impacts.quantities={OF_IMPACTS}",
]


def config(*names):
    """The report's driveline with some of `MEASURES`."""
    tables = ((name, *MEASURES[name]) for name in names)
    return NAMED + "".join(
        f'[[measures]]\nname = "{name}"\nquantity = "{quantity}"\nof = {of!r}\nreduce = "{reduce}"\n'
        for name, quantity, of, reduce in tables
    )


def measured(run):
    """Measures of a run's lash by name, and impulse, peak torque and energy of its impacts."""
    impacts = run.study.impacts.model_copy(update={"quantities": tuple(OF_IMPACTS)})
    record = run_record(replace(run, study=run.study.model_copy(update={"impacts": impacts})))
    record = record["lashes"][run.study.lash_names[run.lash]] if "lashes" in record else record
    measures = record["measures"]
    return (
        {name: value for name, value in measures.items() if not name.startswith("impact_")},
        {name: measures[f"impact_{name}"].tolist() for name in OF_IMPACTS},
    )


def measuring(*overrides, names=tuple(MEASURES)):
    return study_from_text(config(*names), overrides=overrides)


def from_history(run):
    """Impacts' values, (impacts, 3), and measures of `MEASURES`, from samples of the motion and Newton's law of J4.

    Between samples 1e-6 s apart a peak of the contact's mode (ω = 1623 1/s) is (ωh)²/8 = 3e-7 higher at most.
    """
    study = run.study
    history = sample(run, step=1e-6, until=study.load.step_time + study.solver.end_time)
    time, angle, rate, accelerations = history.after_step, history.angle, history.velocity, history.acceleration
    ring, lash = study.driveline.shafts[2], study.lash
    torque = (
        study.driveline.inertias[3] * accelerations[:, 3] + ring.damping * rate[:, 3] + ring.stiffness * angle[:, 3]
    )
    q, speed = angle[:, 2] - angle[:, 3], rate[:, 2] - rate[:, 3]
    stored = lash.radius**2 * lash.contact.stiffness * (np.abs(q) - np.deg2rad(lash.backlash_deg) / 2) ** 2 / 2.0
    damped = (history.contacts[:, 0] != 0) * lash.radius**2 * lash.contact.damping * speed**2
    impacts, rigid = [], history.study.has_rigid_flanks
    limits = [*np.flatnonzero(np.isin(history.event, run.primaries)), history.time.size]
    for rows in map(slice, limits[:-1], limits[1:]):
        events = rows.start + np.flatnonzero(history.event[rows] >= 0)
        kinds, pressing = run.events["kind"][history.event[events]], run.events["side"][history.event[rows.start]]
        impulse, energy = (
            abs(np.trapezoid(torque[rows], time[rows])),
            0.0 if rigid else np.trapezoid(damped[rows], time[rows]),
        )
        if rigid:
            struck, mass = events[kinds == TOUCH], 1.0 / sum(1.0 / np.array(study.driveline.inertias[2:]))
            before, after = run.events["speed"][history.event[struck]], speed[struck]
            impulse += mass * np.abs(before - after).sum()
            energy += mass / 2.0 * np.sum(before**2 - after**2)
        else:
            energy += stored[events[kinds == SEPARATION]].sum() - stored[events[kinds == REJOIN]].sum()
        impacts.append([impulse, np.nan if rigid else (pressing * torque[rows]).max(), energy])
    whole, wound_up = slice(int(np.flatnonzero(history.event == 0)[0]), None), angle[:, 1] - angle[:, 2]
    shaft = study.driveline.shafts[1]
    channels = (
        accelerations[:, 0],
        accelerations[:, 2],
        shaft.stiffness * wound_up + shaft.damping * (rate[:, 1] - rate[:, 2]),
    )
    channels = [each[whole] for each in (*channels, wound_up, q, torque)]
    reduced = [
        np.abs(each).max() if reduce == "largest" else np.ptp(each)
        for each, (_, _, reduce) in zip(channels, MEASURES.values(), strict=True)
    ]
    return np.array(impacts), dict(zip(MEASURES, reduced, strict=True))


@pytest.mark.parametrize(
    ("names", "overrides"),
    [
        (MEASURES, []),
        (MEASURES, ["lash.contact.separation=force", "load.profile=ramp", "load.duration=0.02"]),
        (RIGID, ["lash.contact.model=restitution", "load.profile=lag", "load.time_constant=0.01"]),
    ],
    ids=["by gap", "by force, ramp", "restitution, lag"],
)
def test_measures_are_those_of_the_sampled_motion(names, overrides):
    run = simulate(measuring(*SHORT, *overrides, names=names))
    assert run.primaries.size >= 2
    impacts, measures = from_history(run)
    totals, of_impacts = measured(run)
    assert pytest.approx(impacts, rel=CLOSE, nan_ok=True) == np.array([of_impacts[name] for name in OF_IMPACTS]).T
    roots = dict(zip(OF_IMPACTS, np.sqrt(np.sum(impacts**2, axis=0)), strict=True))
    roots["peak_torque"] = impacts[:, 1].max(initial=0.0)
    assert totals == pytest.approx(roots | {name: measures[name] for name in names}, rel=CLOSE, nan_ok=True)


@pytest.mark.parametrize("stiffness", [3e4, 1e6, 2e7])
def test_an_undamped_pair_that_a_step_excites_swings_between_zero_and_twice_its_mean(stiffness):
    """x2'' = ΔT/(J1 + J2) (1 - cos ωt), all through the run: every other term of its series from rest is zero."""
    study = study_from_text(f"""
    driveline = {{inertias = [0.25, 1.5], shafts = []}}
    lash = {{between = [1, 2], backlash_deg = 2.0, radius = 0.05, contact = {{stiffness = {stiffness}, damping = 0.0}}}}
    load = {{initial_torque = 100.0, final_torque = 95.0}}
    solver = {{method = "exact", end_time = 1.0}}
    measures = [{{name = "swing", quantity = "acceleration", of = 2, reduce = "peak-to-peak"}}]
    """)
    swing = clunk.run_points(study, {"load.final_torque": [95.0]}).values("swing")
    assert swing == pytest.approx(2.0 * (100.0 - 95.0) / (0.25 + 1.5), rel=1e-8)  # the rolling angle's rounding


@pytest.mark.parametrize("contact", ["separation=force", "model=restitution"])
@pytest.mark.parametrize("stages", [[], STAGES], ids=["plain", "staged"])
def test_the_energy_of_impacts_is_what_the_balance_says_the_contact_took(contact, stages):
    """Before the first impact flanks that pressed from the start damp a little; rigid ones take nothing then."""
    run = simulate(measuring(f"lash.contact.{contact}", "solver.method=exact", *stages, names=()))
    taken, ledger = sum(measured(run)[1]["energy"]), balance(run)
    lost = ledger.damped_in_contact + ledger.lost_at_impacts + ledger.dropped - ledger.regained
    if contact == "model=restitution":
        assert taken == pytest.approx(lost, rel=1e-10)
    else:
        assert 0.998 * lost < taken < lost  # released in 19 ms, in which the contact's torque falls evenly


@pytest.mark.parametrize("stages", [[], STAGES], ids=["plain", "staged"])
def test_both_methods_have_the_same_measures(stages):
    """They end where they prove that nothing follows, at different times; RK4's step leaves 1e-7 of the states."""
    runs = [simulate(measuring(f"solver.method={method}", "solver.step=2e-5", *stages)) for method in ("exact", "rk4")]
    exact, rk4 = map(measured, runs)
    assert runs[0].end != runs[1].end
    assert rk4[0] == pytest.approx(exact[0], rel=1e-6)
    assert rk4[1]["energy"] == pytest.approx(exact[1]["energy"], rel=1e-6)


def test_the_torque_of_a_staged_shaft_is_that_of_its_history():
    study = study_from_text(
        NAMED + '[[measures]]\nname = "damper"\nquantity = "shaft torque"\nof = 1\nreduce = "largest"\n',
        overrides=["solver.method=exact", *STAGES],
    )
    run = simulate(study)
    history = sample(run, step=2e-5)
    after = history.after_step >= 0.0
    twist, rate = (values[after, 0] - values[after, 1] for values in (history.angle, history.velocity))
    nodes = np.deg2rad([-60.0, -4.0, 0.0, 2.0, 60.0])
    k = study.driveline.shafts[0].stages
    torques = [k[1] * nodes[1] - k[0] * (nodes[1] - nodes[0]), k[1] * nodes[1], 0.0, k[1] * nodes[3]]
    torques.append(torques[-1] + k[2] * (nodes[4] - nodes[3]))
    damping = study.driveline.shafts[0].damping
    largest = np.abs(np.interp(twist, nodes, torques) + damping * rate).max()
    assert measured(run)[0]["damper"] == pytest.approx(largest, rel=1e-7)  # its samples are 2e-5 s apart


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_a_map_has_the_measures_of_its_runs_and_all_else_as_without_them(method, tmp_path):
    plain = sweep(measuring(*MAP[:1], f"solver.method={method}", names=()))
    study = measuring(*MAP, f"solver.method={method}")
    write_results(tmp_path / "map.h5", sweep(study))
    results = read_results(tmp_path / "map.h5")
    besides = results.quantities.keys() - REGIME_QUANTITIES.keys()
    assert besides == {*OF_IMPACTS, *MEASURES, *(f"impact_{name}" for name in OF_IMPACTS)}
    for name in plain.quantities:
        assert results.values(name).tobytes() == plain.values(name).tobytes()
    at = {"load.ratio": 7.5, "lash.backlash_deg": 7.0}
    cell, (single, of_impacts) = results.cell(at), measured(simulate(replace_values(study, at)))
    assert {name: cell[name] for name in single} == pytest.approx(single, rel=1e-12)
    for name, values in of_impacts.items():
        assert cell[f"impact_{name}"] == pytest.approx(values, rel=1e-12)


def test_changes_of_stage_take_no_room_of_touches():
    """With states kept they are written too; solver.max_events is of the others."""
    limit = ["solver.max_events=18", *STAGES, "solver.method=exact"]
    plain = sweep(measuring(MAP[0], *limit, names=()))
    results = sweep(measuring(*MAP, *limit, names=["hit"]))
    done, failed = plain.status == 0, results.status != 0
    assert 0 < np.count_nonzero(failed) < failed.size
    assert not np.any(failed & done)
    for name in ("touches", "severity", "margin", "last_event_time"):
        assert np.array_equal(results.values(name)[done], plain.values(name)[done], equal_nan=True)
    assert np.array_equal(np.isnan(results.values("hit")), failed)


@pytest.mark.parametrize("of", ["peak_torque<=15", "energy<=0.04", "wound_up<=5.5"])
def test_thresholds_of_measures_lie_between_runs_on_either_side(of):
    axis = "sweep.axes=[{parameter='load.ratio', start=0.0, stop=10.0, count=11}]"
    study = measuring(axis, "solver.method=exact", names=["wound_up"])
    found = thresholds(study, along="load.ratio", of=of)
    name, bound = of.split("<=")
    assert found.value.size
    for ratio in found.value:
        sides = [simulate(replace_values(study, {"load.ratio": ratio + by})) for by in (-1e-6, 1e-6)]
        assert len({measured(run)[0][name] <= float(bound) for run in sides}) == 2


def test_sensitivity_knows_measures():
    study = load_study("configs/tolerance.toml", ["sweep.sampling.count=16"])
    energy, severity = clunk.sensitivity(study, of=["energy", "severity"]).indices
    assert energy.nominal == pytest.approx(measured(simulate(study))[0]["energy"])
    assert energy.indices is not None
    assert severity.indices is not None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("quantity = 'acceleratoin'\nof = 1", 'did you mean "acceleration"'),
        ("quantity = 'twist'\nof = 'lash1'", 'no shaft or lash "lash1"; did you mean'),
        ("quantity = 'acceleration'\nof = 'mottor'", 'did you mean "motor"'),
        ("quantity = 'shaft torque'\nof = 9", "a number from 1 to 4"),
        (
            "quantity = 'twist'\nof = 1\n[[measures]]\nname = 'one'\nreduce = 'largest'\nquantity = 'twist'\nof = 2",
            'name "one" too',
        ),
        ("quantity = 'twist'\nof = 1\n[impacts]\nquantities = ['impuls']", 'did you mean "impulse"'),
        ("quantity = 'contact torque'\nof = 1\n[lash]\ncontact.model = 'restitution'", "infinite"),
    ],
)
def test_bad_measures_are_refused_with_a_sentence(text, sentence):
    with pytest.raises(ConfigError) as error:
        study_from_text(f"{NAMED}[[measures]]\nname = 'one'\nreduce = 'largest'\n{text}\n")
    assert sentence in " ".join(str(error.value).split())


def test_no_measure_takes_the_name_of_another_variable():
    for name in (*REGIME_QUANTITIES, *OF_RUNS, "load_ratio", "boundary_left", "unresolved_load_ratio"):
        with pytest.raises(ConfigError, match=r"another variable|begin names of traced boundaries"):
            measuring(MAP[0], f"measures=[{{name='{name}', quantity='twist', of=1, reduce='largest'}}]", names=())


def test_a_tolerance_map_with_measures_is_refused():
    study = load_study("configs/tolerance.toml", ["impacts.quantities=['energy']"])
    with pytest.raises(ClunkError, match="has Q alone"):
        clunk.tolerance_map(study)


def test_commands_tell_measures():
    at = [text for key, value in POINT.items() for text in ("--at", f"{key}={value}")]
    printed = CliRunner().invoke(cli, ["simulate", "configs/measures.toml", *at, "--json"])
    record, run = json.loads(printed.stdout), simulate(replace_values(load_study("configs/measures.toml"), POINT))
    measures = record["measures"]
    assert {name: measures[name] for name in measured(run)[0]} == pytest.approx(measured(run)[0])
    assert np.sqrt(np.sum(np.square(measures["impact_energy"]))) == pytest.approx(measures["energy"])
    assert "shaft_torque         6 N m" in CliRunner().invoke(cli, ["simulate", "configs/measures.toml", *at]).stdout


LOCKED = """
driveline.inertias = [0.02, 0.014, 0.0095]
driveline.shafts = [{between = [3, "ground"], stiffness = 30.0, damping = 0.05}]
load = {profile = "step", initial_torque = -5.0, final_torque = -1.0}
solver = {method = "exact", end_time = 0.2}
[[lash]]
between = [1, 2]
backlash_deg = 1.0
radius = 0.08
contact = {model = "restitution", restitution = 0.5, locking_speed = 1.0}
[[lash]]
between = [2, 3]
backlash_deg = 6.0
radius = 0.08
contact = {model = "restitution", restitution = 0.0, locking_speed = 1.0}
"""


def test_what_a_slow_touch_pulls_through_a_locked_lash_is_taken_from_its_impulse():
    """The second lash is all that holds the first two inertias; their momentum between its two separations tells."""
    run = simulate(study_from_text(LOCKED)).lashes[1]
    kinds, lashes = run.events["kind"], run.events["lash"]
    parted = np.flatnonzero((kinds == SEPARATION) & (lashes == 1))
    (slow,) = np.flatnonzero((kinds == TOUCH) & (lashes == 0) & (np.abs(run.events["speed"]) < 1.0))
    assert parted[0] < run.primaries[0] < slow < parted[1]
    momentum = run.phase_states[np.isin(run.phases["time"], run.events["time"][parted]), 3:5] @ [0.02, 0.014]
    of_load = -1.0 * np.diff(run.events["time"][parted])
    impulse = abs(np.diff(momentum[:: len(momentum) - 1]) - of_load)
    ((found,), *_) = measured(run)[1].values()
    assert found == pytest.approx(impulse.item(), rel=1e-9)


def test_a_measure_may_have_the_name_of_a_short_word():
    results = sweep(study_from_text(config("shuffle").replace('"shuffle"', '"ds"'), "measured", [*SHORT, MAP[0]]))
    assert quantity_of("ds", results).name == "ds"
    assert quantity_of("DS=1", results).base.name == "double_sided"
    assert quantity_of("DS", example(RATIO, BACKLASH)).name == "double_sided"


def test_where_a_lash_is_measured_its_name_makes_another_study():
    def digest_of(names, *overrides):
        named = [f"lash[{k}].name='{name}'" for k, name in enumerate(names, 1)]
        return digest(load_study("configs/two_lashes.toml", [*named, *overrides]))

    twist = "measures=[{name='wound', quantity='twist', of='first', reduce='largest'}]"
    assert digest_of(("first", "second")) == digest_of(("second", "first"))
    assert digest_of(("first", "second"), twist) != digest_of(("second", "first"), twist)
    assert digest_of(("first", "second"), twist) == digest_of(("first", "third"), twist)


def test_each_of_two_lashes_has_its_impacts_and_together_they_take_what_the_balance_says():
    axis = "sweep.axes=[{parameter='load.duration', values=[0.0, 0.1]}]"
    study = load_study("configs/two_lashes.toml", [axis, "impacts.quantities=['energy']"])
    run, results = simulate(replace_values(study, {"load.duration": 0.0})), sweep(study)
    for name, each in zip(results.lash_names, run.lashes, strict=True):
        cell = results.of_lash(name).cell({"load.duration": 0.0})
        assert cell["impact_energy"] == pytest.approx(measured(each)[1]["energy"], rel=1e-9)
    ledger, taken = balance(run), [sum(measured(each)[1]["energy"]) for each in run.lashes]
    lost = ledger.damped_in_contact + ledger.dropped - ledger.regained
    assert min(taken) > 0.01 * lost
    assert sum(taken) == pytest.approx(lost, rel=0.01)  # but for what flanks that pressed from the start took


def test_what_takes_too_many_steps_is_not_defined_and_the_run_is_what_it_is(monkeypatch):
    """With a damper of 1e11 N s/m a run would be followed for days, and no signal ended that."""
    study = study_from_text(config("shuffle"), overrides=[*SHORT, *MAP])
    monkeypatch.setattr(measures, "_MOST_STEPS", 10)
    results = sweep(study)
    plain = sweep(study.but(impacts=study.impacts.but(quantities=()), measures=()))
    np.testing.assert_array_equal(results.sequence, plain.sequence)
    struck = results.primary_impacts > 0
    assert struck.any()
    for name in ("impulse", "energy", "shuffle"):
        assert np.isnan(results.values(name)[struck]).all()
