"""Impulse, peak torque and energy of impacts, and measures of one's own, beside SciPy's integrator and exact laws."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner
from helpers.general import OneLash, kinks
from helpers.reference import Plant, lag, ramp
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import clunk
from clunk.analysis.thresholds import thresholds
from clunk.cli import cli
from clunk.cli.simulate import run_record
from clunk.results.quantities import REGIME_QUANTITIES
from clunk.results.store import read_results, write_results
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError, ConfigError
from clunk.study.study import replace_values
from clunk.sweeping.sweep import sweep

CLOSE = 1e-8  # relative, to SciPy's DOP853 at 1e-12 a step
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
    return record["measures"], record["impact_measures"]


def measuring(*overrides, names=tuple(MEASURES)):
    return study_from_text(config(*names), overrides=overrides)


def integrated(run, plant):
    """Impacts' values and measures of `MEASURES` by DOP853 between the events, with extremes of its dense output."""
    study = run.study
    motion, n, rows = OneLash(plant), plant.n, list(plant.joints())
    names = {0: ("open", 0), 1: ("closed", 1), 2: ("closed", -1), 3: ("parted", 1), 4: ("parted", -1)}
    impacts = np.zeros((run.primaries.size, 3))
    ranges = np.tile([np.inf, -np.inf], (6, 1))
    times = np.append(run.events["time"], study.solver.end_time)
    for k, event in enumerate(run.events):
        regime, x = names[event["regime"]], run.states[k]
        impact = int(np.searchsorted(run.primaries, k, side="right")) - 1

        def contact(t, x, regime=regime):
            return motion.contact(t, x, regime[1]) if regime[0] == "closed" else 0.0

        def channels(t, x, regime=regime):
            twists = [row @ x[:n] for row, _, _ in rows]
            wound_up = rows[1][1] * twists[1] + rows[1][2] * (rows[1][0] @ x[n : 2 * n])
            accelerations = motion.slope(t, x[: 2 * n], regime)[n:]
            return [accelerations[0], accelerations[2], wound_up, twists[1], motion.q @ x[:n], contact(t, x[: 2 * n])]

        def slope(t, z, regime=regime):
            x = z[: 2 * n]
            pressing = regime[0] == "closed"
            damped = 0.0 if motion.rigid else plant.contact_damping * (motion.q @ x[n:]) ** 2
            return np.concatenate([motion.slope(t, x, regime), [contact(t, x), damped * pressing]])

        if impact >= 0 and event["kind"] in (2, 3) and not motion.rigid:  # separation, rejoin
            stored = plant.contact_stiffness * motion.overlap(x, event["side"]) ** 2 / 2.0
            impacts[impact, 2] += stored if event["kind"] == 2 else -stored
        if impact >= 0 and event["kind"] == 1 and motion.rigid:
            mobility, after = motion.q**2 @ motion.inverse, motion.q @ x[n:]
            impacts[impact, 0] += abs(event["speed"] - after) / mobility
            impacts[impact, 2] += (event["speed"] ** 2 - after**2) / 2.0 / mobility
        cuts = [times[k], *(kink for kink in kinks(plant) if times[k] < kink < times[k + 1]), times[k + 1]]
        z = np.append(x, [0.0, 0.0])
        for begin, end in pairwise(cuts):
            if begin == end:
                continue
            motion.until = min((kink for kink in kinks(plant) if kink > begin), default=np.inf)
            fastest = 0.3 / motion.fastest()
            flight = solve_ivp(
                slope, (begin, end), z, "DOP853", rtol=1e-12, atol=1e-13, max_step=fastest, dense_output=True
            )
            samples = np.array([channels(t, x) for t, x in zip(flight.t, flight.y.T, strict=True)]).T
            for c, values in enumerate(samples):
                for sign, at in ((1.0, int(values.argmin())), (-1.0, int(values.argmax()))):
                    bounds = flight.t[max(at - 1, 0)], flight.t[min(at + 1, values.size - 1)]
                    tuned = minimize_scalar(
                        lambda t, c=c, sign=sign, flight=flight: sign * channels(t, flight.sol(t))[c],
                        bounds=bounds,
                        method="bounded",
                        options={"xatol": 1e-12},
                    )
                    best = sign * min(tuned.fun, sign * values[at])
                    ranges[c] = min(ranges[c, 0], best), max(ranges[c, 1], best)
                    if c == 5 and impact >= 0:
                        impacts[impact, 1] = max(impacts[impact, 1], best)
            z = flight.y[:, -1]
        if impact >= 0:
            impacts[impact, [0, 2]] += z[2 * n :]
        motion.until = np.inf
    reduced = [np.abs(low_high).max() if c in (0, 2, 5) else np.ptp(low_high) for c, low_high in enumerate(ranges)]
    return impacts, dict(zip(MEASURES, reduced, strict=True))


@pytest.mark.parametrize(
    ("names", "plant", "overrides"),
    [
        (MEASURES, Plant(), []),
        (MEASURES, Plant(separation="force", profile=ramp(0.02)), ["load.profile=ramp", "load.duration=0.02"]),
        (RIGID, Plant(restitution=0.5, profile=lag(0.01)), ["load.profile=lag", "load.time_constant=0.01"]),
    ],
    ids=["by gap", "by force, ramp", "restitution, lag"],
)
def test_measures_are_those_of_a_general_integrator(names, plant, overrides):
    model = "indentation" if plant.restitution is None else "restitution"
    contact = [f"lash.contact.separation={plant.separation}", f"lash.contact.model={model}"]
    run = simulate(measuring(*SHORT, *contact, *overrides, names=names))
    assert run.primaries.size >= 2
    impacts, measures = integrated(run, plant)
    totals, of_impacts = measured(run)
    if "hit" not in names:  # impulses have no peak
        impacts[:, 1] = np.nan
    assert pytest.approx(impacts, rel=CLOSE, nan_ok=True) == np.array([of_impacts[name] for name in OF_IMPACTS]).T
    roots = dict(zip(OF_IMPACTS, np.sqrt(np.sum(impacts**2, axis=0)), strict=True))
    assert totals == pytest.approx(roots | {name: measures[name] for name in names}, rel=CLOSE, nan_ok=True)


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
        ("quantity = 'shaft torque'\nof = 9", "its number from 1 to 4"),
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
    for name in (*REGIME_QUANTITIES, "load_ratio", "boundary_left"):
        with pytest.raises(ConfigError, match="another variable"):
            measuring(MAP[0], f"measures=[{{name='{name}', quantity='twist', of=1, reduce='largest'}}]", names=())


def test_a_tolerance_map_with_measures_is_refused():
    study = load_study("configs/tolerance.toml", ["impacts.quantities=['energy']"])
    with pytest.raises(ClunkError, match="has Q alone"):
        clunk.tolerance_map(study)


def test_commands_tell_measures():
    at = [text for key, value in POINT.items() for text in ("--at", f"{key}={value}")]
    printed = CliRunner().invoke(cli, ["simulate", "configs/measures.toml", *at, "--json"])
    record, run = json.loads(printed.stdout), simulate(replace_values(load_study("configs/measures.toml"), POINT))
    assert record["measures"] == pytest.approx(measured(run)[0])
    assert np.sqrt(np.sum(np.square(record["impact_measures"]["energy"]))) == pytest.approx(
        record["measures"]["energy"]
    )
    assert "shaft_torque         6 N m" in CliRunner().invoke(cli, ["simulate", "configs/measures.toml", *at]).stdout


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
