"""The load of a run against the definitions of the profiles, and values of its keys that are swept."""

import numpy as np
import pytest

from clunk.api import sweep
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text

T0, T1, D = -6.0, -1.0, 0.2
PROFILES = {  # lines of a config, T(t), and where it has a jump
    "step": ("", lambda t: np.full(t.size, T1), []),
    "ramp": (f"duration = {D}", lambda t: T0 + (T1 - T0) * np.minimum(t / D, 1.0), []),
    "smooth": (f"duration = {D}", lambda t: T0 + (T1 - T0) * (1.0 - np.cos(np.pi * np.minimum(t / D, 1.0))) / 2, []),
    "lag": ("time_constant = 0.03", lambda t: T0 + (T1 - T0) * (1.0 - np.exp(-t / 0.03)), []),
    "pulse": (f"duration = {D}", lambda t: np.where(t < D, T1, T0), [D]),
    "sine": ("amplitude = 2.0\nfrequency = 3.0", lambda t: T1 + 2.0 * np.sin(6.0 * np.pi * t), []),
    "steps": (
        "durations = [0.1, 0.0, 0.1]\nlevels = [0.4, 0.7, 1.2]",
        lambda t: np.where(t < 0.1, T0 + 0.4 * (T1 - T0), np.where(t < 0.2, T0 + 1.2 * (T1 - T0), T1)),
        [0.1, 0.2],
    ),
    "table": (
        "times = [0.0, 0.0, 0.1, 0.25, 0.25]\ntorques = [-6.0, -4.0, 1.0, 3.0, -1.0]",
        lambda t: np.where(t < 0.1, -4.0 + 50.0 * t, np.where(t < 0.25, 1.0 + (t - 0.1) / 0.075, -1.0)),
        [0.25],
    ),
}
SWEPT = {
    "step": ("initial_torque", [-8.0, -2.0]),
    "ramp": ("final_torque", [0.5, -2.0]),
    "smooth": ("initial_torque", [-8.0, -2.0]),
    "lag": ("final_torque", [0.5, -2.0]),
    "sine": ("amplitude", [0.5, 3.0]),
    "steps": ("levels[3]", [0.5, -0.1]),
    "table": ("times[3]", [0.05, 0.12]),
}


def config(profile, method="exact"):
    torques = "" if profile == "table" else f"initial_torque = {T0}\nfinal_torque = {T1}\n"
    text = f'[driveline]\npreset = "boere-2008"\n[load]\nprofile = "{profile}"\n{torques}{PROFILES[profile][0]}\n'
    return f'{text}[solver]\nmethod = "{method}"\n'


@pytest.mark.parametrize("method", ["exact", "rk4"])
@pytest.mark.parametrize("profile", PROFILES)
def test_the_torque_of_a_run_is_that_of_its_profile(profile, method):
    history = sample(simulate(study_from_text(config(profile, method))), step=1e-3, until=0.6)
    _, torque, jumps = PROFILES[profile]
    before, t = history.after_step < 0.0, history.after_step
    assert history.torque[before] == pytest.approx(T0)
    clear = (t > 0.0) & (np.abs(t[:, None] - np.array([-1.0, *jumps])) > 1e-9).all(axis=1)
    # 1e-15 of the largest torque an operation; a wave is carried over 600 samples, each some 3e-15
    assert history.torque[clear] == pytest.approx(torque(t[clear]), abs=2e-12)


@pytest.mark.parametrize("profile", SWEPT)
def test_swept_values_take_the_place_of_the_configs(profile):
    key, values = SWEPT[profile]
    axis = f'[[sweep.axes]]\nparameter = "load.{key}"\nvalues = {values}\n'
    results = sweep(study_from_text(config(profile) + axis))
    for k, value in enumerate(values):
        run = simulate(study_from_text(config(profile), overrides=[f"load.{key}={value}"]))
        assert (results.label_map[k], results.severity[k]) == (run.label, run.severity)


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_a_run_under_steps_is_one_under_the_table_that_jumps_as_they_do(method):
    steps = ["load.durations=[0.06, 0.0, 0.05]", "load.levels=[0.5, 3.0, 0.8]"]
    jumps = ["load.times=[0.0, 0.0, 0.06, 0.06, 0.11, 0.11]", "load.torques=[-6.0, -3.5, -3.5, -2.0, -2.0, -1.0]"]
    one, other = (
        simulate(study_from_text(config(profile, method), overrides=changes))
        for profile, changes in (("steps", steps), ("table", jumps))
    )
    assert one.events["kind"].tolist() == other.events["kind"].tolist()
    # pieces that begin at 0.06 + 0.05 and at 0.11 differ by one rounding, 1e-17 s
    assert one.events["time"] == pytest.approx(other.events["time"], abs=1e-12)
