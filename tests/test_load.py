"""The load's pieces against the definitions of the profiles."""

import numpy as np
import pytest
from scipy.linalg import expm

from clunk.core.runs import LEVEL, SLOPE, WAVE, WAVE_PARTNER
from clunk.simulation.load import is_moving, load_step, loads_of, torque_at, wave_rates
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study
from clunk.study.document import with_value
from clunk.study.loads import Load

T0, T1, D = -6.0, -1.0, 0.2
TIMES, TORQUES = (0.0, 0.0, 0.1, 0.25, 0.25), (-6.0, -4.0, 1.0, 3.0, -1.0)
t = np.array([0.0, 1e-3, 0.05, 0.1, 0.17, 0.1999, 0.2, 0.25, 0.3, 2.0])

PROFILES = {
    "step": ({}, np.full(t.size, T1)),
    "ramp": ({"duration": D}, T0 + (T1 - T0) * np.minimum(t / D, 1.0)),
    "smooth": ({"duration": D}, T0 + (T1 - T0) * (1.0 - np.cos(np.pi * np.minimum(t / D, 1.0))) / 2),
    "lag": ({"time_constant": 0.03}, T0 + (T1 - T0) * (1.0 - np.exp(-t / 0.03))),
    "pulse": ({"duration": D}, np.where(t < D, T1, T0)),
    "sine": ({"amplitude": 2.0, "frequency": 3.0}, T1 + 2.0 * np.sin(6.0 * np.pi * t)),
    "steps": (
        {"durations": (0.1, 0.0, 0.1), "levels": (0.4, 0.7, 1.2)},
        np.where(t < 0.1, T0 + 0.4 * (T1 - T0), np.where(t < 0.2, T0 + 1.2 * (T1 - T0), T1)),
    ),
    "table": (
        {"times": TIMES, "torques": TORQUES, "scale": 1.0},
        np.where(t < 0.1, -4.0 + 50.0 * t, np.where(t < 0.25, 1.0 + (t - 0.1) / 0.075, -1.0)),
    ),
}


def load(profile: str, **keys) -> Load:
    pair = {} if profile == "table" else {"initial_torque": T0, "final_torque": T1}
    return Load.model_validate({"profile": profile, "on": 1} | pair | PROFILES[profile][0] | keys)


def torques(config: Load, times=t) -> np.ndarray:
    return torque_at(loads_of(config, 1).pieces[0], wave_rates(config), times)


@pytest.mark.parametrize("profile", PROFILES)
def test_the_pieces_are_the_profile(profile):
    config = load(profile)
    assert loads_of(config, 3).before == pytest.approx([T0] * 3)
    # 1e-15 of the largest torque per operation, of which there are ten; the tail that a lag leaves is 4e-18
    assert torques(config) == pytest.approx(PROFILES[profile][1], abs=6e-14)
    assert is_moving(config) == (profile not in ("step", "pulse", "steps"))


@pytest.mark.parametrize("profile", ["smooth", "lag", "sine"])
def test_waves_obey_their_rates(profile):
    config = load(profile)
    piece, rates = loads_of(config, 1).pieces[0, 0], wave_rates(config)
    waves = [(expm(rates * time) @ piece[[WAVE, WAVE_PARTNER]])[0] for time in t[:6]]
    assert piece[SLOPE] == 0.0
    assert torques(config, t[:6]) == pytest.approx(piece[LEVEL] + np.array(waves), abs=6e-14)


@pytest.mark.parametrize("span", [0.0, 1e-13])
@pytest.mark.parametrize(
    ("profile", "key", "rest"),
    [("ramp", "duration", T1), ("smooth", "duration", T1), ("lag", "time_constant", T1), ("pulse", "duration", T0)],
)
def test_a_profile_that_takes_no_time_is_a_step_and_a_pulse_none(profile, key, rest, span):
    config = load(profile, **{key: span})
    assert np.all(np.isfinite(loads_of(config, 1).pieces))
    assert np.all(torques(config) == rest)


@pytest.mark.parametrize(
    ("profile", "swept"),
    [
        ("step", {"initial_torque": [1.0, 2.0]}),
        ("ramp", {"duration": [0.0, 0.3], "final_torque": [0.0, 5.0]}),
        ("smooth", {"initial_torque": [1.0, 2.0]}),
        ("lag", {"final_torque": [1.0, 2.0]}),
        ("pulse", {"duration": [0.0, 0.3]}),
        ("sine", {"amplitude": [0.0, 3.0]}),
        ("steps", {"durations[1]": [0.0, 0.3], "levels[3]": [0.5, -0.1], "final_torque": [0.0, 5.0]}),
        ("table", {"torques[2]": [-3.0, 2.0], "times[3]": [0.05, 0.12], "scale": [1.0, -2.0]}),
    ],
)
def test_swept_values_take_the_place_of_the_configs(profile, swept):
    loads = loads_of(load(profile), 2, **{key: np.array(values) for key, values in swept.items()})
    for k in range(2):
        keys = dict(PROFILES[profile][0])
        for name, values in swept.items():
            key, _, item = name.rstrip("]").partition("[")
            keys[key] = with_value(keys[key], (int(item) - 1,), values[k]) if item else values[k]
        single = loads_of(load(profile, **keys), 1)
        assert loads.before[k] == single.before[0]
        assert np.array_equal(loads.pieces[min(k, len(loads.pieces) - 1)], single.pieces[0])


@pytest.mark.parametrize(
    ("profile", "after"), [("ramp", T1), ("pulse", T0), ("sine", T1), ("steps", T1), ("table", -1.0)]
)
def test_the_load_step_leads_to_where_the_load_rests(profile, after):
    assert load_step(load(profile)) == pytest.approx((T0, after))


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_a_run_under_steps_is_one_under_the_table_that_jumps_as_they_do(method):
    steps = {"durations": (0.06, 0.0, 0.05), "levels": (0.5, 3.0, 0.8)}
    jumps = {"times": (0.0, 0.0, 0.06, 0.06, 0.11, 0.11), "torques": (T0, -3.5, -3.5, -2.0, -2.0, T1)}
    nominal = load_study("configs/nominal.toml", [f"solver.method={method}"])
    runs = [
        simulate(nominal.model_copy(update={"load": load(profile, **keys)}))
        for profile, keys in (("steps", steps), ("table", jumps))
    ]
    assert [event["kind"] for event in runs[0].events] == [event["kind"] for event in runs[1].events]
    # pieces that begin at 0.06 + 0.05 and at 0.11 differ by one rounding, 1e-17 s
    assert runs[0].events["time"] == pytest.approx(runs[1].events["time"], abs=1e-12)
