"""Load profiles in a config: what is read, what is refused and with which sentence."""

import re
import tomllib
import warnings

import numpy as np
import pytest
from conftest import BOERE as PRESET, drawn, values
from jsonschema import Draft202012Validator

from clunk.core.runs import LEVEL
from clunk.core.tables import TORQUE
from clunk.simulation.load import run_load
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkWarning, ConfigError
from clunk.study.keys import json_schema
from clunk.study.loads import PROFILES
from clunk.study.study import replace_values, to_toml
from clunk.sweeping.cells import leaves_system

NEEDED = {
    "ramp": "duration = 0.1",
    "smooth": "duration = 0.1",
    "lag": "time_constant = 0.1",
    "pulse": "duration = 0.1",
    "table": "times = [0.0, 0.1]\ntorques = [-6.0, -1.0]",
    "sine": "amplitude = 1.0\nfrequency = 2.0",
    "steps": "durations = [0.1, 0.05]\nlevels = [0.6, 0.8]",
}
TABLE = 'profile = "table"\ntimes = [0.0, 0.1, 0.2]\ntorques = [-6.0, -3.0, -1.0]'


ZIPPED = f'[sweep]\ndesign = "zip"\n{values("load.times[2]", [0.1, 0.3])}{values("load.times[3]", [0.2, 0.4])}'


def config(load: str, sweep: str = "") -> str:
    return f"{PRESET}[load]\n{load}\n{sweep}"


def problems(text: str, *overrides: str, folder=".") -> list[tuple[str, str]]:
    with pytest.raises(ConfigError) as caught:
        study_from_text(text, overrides=overrides, folder=folder)
    return [(problem.key, problem.message) for problem in caught.value.problems]


# --- What is right ---------------------------------------------------------------------------------------------------


def test_a_tip_out_is_a_step():
    torques = "static_torque = -1.0\nratio = 5.0"
    texts = [config(f'profile = "{each}"\n{torques}') for each in ("step", "tip-out")]
    step, tip_out = map(study_from_text, texts)
    assert tip_out == step
    Draft202012Validator(json_schema()).validate(tomllib.loads(texts[1]))


@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_is_read_and_written(profile):
    text = config(f'profile = "{profile}"\n{NEEDED.get(profile, "")}')
    study = study_from_text(text)
    assert study_from_text(to_toml(study)) == study
    assert profile in repr(study)
    Draft202012Validator(json_schema()).validate(tomllib.loads(text))


def test_a_table_takes_the_place_of_the_presets_torques():
    study = study_from_text(config(TABLE))
    assert (study.load.static_torque, study.load.ratio) == (None, None)
    before, pieces = run_load(study)
    assert (before[TORQUE], pieces[-1, LEVEL]) == (-6.0, -1.0)


def test_keys_that_a_profile_does_not_use_make_no_difference_to_it():
    with pytest.warns(ClunkWarning, match="a load of profile") as warned:
        assert study_from_text(config("duration = 0.3\ntimes = [0.0]\nfrequency = 3")).load.duration == 0.3
    assert len(warned) == 3


# --- What is wrong ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", NEEDED)
def test_a_profile_says_what_it_needs(profile):
    names = [line.split(" = ")[0] for line in NEEDED[profile].splitlines()]
    reported = problems(config(f'profile = "{profile}"'))
    assert reported
    for key, message in reported:
        assert key.removeprefix("load.") in names
        assert f'missing; a "{profile}" needs' in message


BROKEN = {
    "unknown profile": ('profile = "rampe"', "load.profile", 'did you mean "ramp"?'),
    "negative": ('profile = "ramp"\nduration = -1', "load.duration", "found -1; must be a number, 0 or greater (s)"),
    "negative, unused": ("duration = -1", "load.duration", "0 or greater (s)"),
    "nan": ('profile = "lag"\ntime_constant = nan', "load.time_constant", "found nan; must be a number"),
    "no frequency": ('profile = "sine"\namplitude = 1\nfrequency = 0', "load.frequency", "greater than 0 (Hz)"),
    "very fast": ('profile = "sine"\namplitude = 1\nfrequency = 1e9', "load.frequency", "2e+09 periods of the load"),
    "ground": ('on = "ground"', "load.on", 'there is no inertia "ground"; it must be'),
    "lengths": (f"{TABLE[:-7]}]", "load.torques", "found 2 torques for 3 times"),
    "back": (TABLE.replace("0.2", "0.05"), "load.times[3]", "found 0.05 after 0.1; times must not decrease"),
    "late": (TABLE.replace("[0.0", "[0.01"), "load.times[1]", "the first time must be 0"),
    "nan among times": (TABLE.replace("0.2", "nan"), "load.times[3]", "found nan; must be a number"),
    "infinite torque": (TABLE.replace("-3.0", "inf"), "load.torques[2]", "must be a finite number (N m)"),
    "no list": ("times = 0.0", "load.times", "found 0.0; must be a list of times (s)"),
    "other torques": (f"{TABLE}\nratio = 5", "load.ratio", 'given beside profile = "table"'),
    "two sources": (f'{TABLE}\nfile = "trace.csv"', "load.file", "given beside times or torques"),
}
BROKEN["empty"] = ('profile = "table"\ntimes = []\ntorques = [1.0]', "load.times", "found []; must be a list of times")
BROKEN["three"] = (TABLE.replace("[0.0, 0.1", "[0.0, 0.0").replace("0.2", "0.0"), "load.times[3]", "for the third time")


@pytest.mark.parametrize("case", BROKEN.values(), ids=BROKEN)
def test_a_broken_load_is_reported_in_one_sentence(case):
    load, *expected = case
    ((key, message),) = problems(config(load))
    assert key == expected[0]
    assert expected[1] in message


# --- Traces ----------------------------------------------------------------------------------------------------------

TRACE = "time [s],torque [N m],note\n# measured\n0,-6,a\n 0.1 , -3.5\n\n0.2,-1\n"
BROKEN_TRACES = {
    "one column": ("t\n0\n1\n", 'line 2: found "0"; must be finite numbers, time (s) and torque (N m)'),
    "nan": ("0,-6\n0.1,nan\n", 'line 2: found "0.1,nan"'),
    "nan time": ("0,-6\nnan,1\n", 'line 2: found "nan,1"'),
    "text": ("0,-6\n0.1,x\n", 'line 2: found "0.1,x"'),
    "decimal commas in columns of commas": ("0,0 -6,0\n0,1 -1,0\n", 'line 1: found "0,0 -6,0"'),
    "digits in groups": ("0,-6\n0.1,1_000\n", 'line 2: found "0.1,1_000"'),
    "thousands": ("0;1.000,5\n", 'line 1: found "0;1.000,5"'),
    "back in time": ("t,T\n0,-6\n0.2,1\n0.1,3\n", "line 4: found 0.1 after 0.2; times must not decrease"),
    "late": ("0.5,-6\n0.6,1\n", "line 1: found 0.5; the first time must be 0"),
    "three": ("0,1\n1,2\n1,3\n1,4\n", "line 4: found 1 for the third time"),
    "empty": ("", "has no lines that begin with a number"),
    "headings": ("time,torque\n", "has no lines that begin with a number"),
}


def test_a_trace_is_read_once_and_kept_in_the_config(tmp_path):
    (tmp_path / "trace.csv").write_text(TRACE)
    (tmp_path / "study.toml").write_text(config('profile = "table"\nfile = "trace.csv"'))
    study = load_study(tmp_path / "study.toml")
    assert (study.load.times, study.load.torques) == ((0.0, 0.1, 0.2), (-6.0, -3.5, -1.0))
    (tmp_path / "trace.csv").unlink()
    assert study_from_text(to_toml(study)) == study


@pytest.mark.parametrize(
    "text",
    [
        "Zeit;Moment\ns;Nm\n0,0;-6,0\n0,1;-3,5\n0,2;-1\n",
        "\ufefft\tT\tn\n0\t-6\t5000\n0.1\t-3.5\t4000\n0.2\t-1\t3000\n",
        '"0,0","-6,0"\n"0,1","-3,5"\n"0,2","-1,0"\n',
        " 0 ; -6.0\r\n 0.1 ; -3.5\r\n 0.2 ; -1.0\r\n",
        "Info: of release 3\nNano drive\n0,-6,hold; then\n0.1,-3.5,\n0.2,-1,end\nInfluence of load\n",
        "0,\t-6\n0.1,\t-3.5\n0.2,\t-1\n",
    ],
)
def test_a_trace_may_be_written_as_loggers_do(text, tmp_path):
    (tmp_path / "trace.csv").write_text(text, encoding="utf-8", newline="")
    study = study_from_text(config('profile = "table"\nfile = "trace.csv"'), folder=tmp_path)
    assert (study.load.times, study.load.torques) == ((0.0, 0.1, 0.2), (-6.0, -3.5, -1.0))


@pytest.mark.parametrize(
    ("heading", "told"),
    [
        ("time [ms],torque [Nm]", [' line 1: a column headed "time [ms]" is taken for time in s']),
        ("t (s),speed [1/min],torque [Nm]", [' line 1: a column headed "speed [1/min]" is taken for torque in N m']),
        ("time (s),torque of the engine (N·m) ,gear [-]", []),
        ("Time [seconds],T [lbf.ft]", [' line 1: a column headed "T [lbf.ft]" is taken for torque in N m']),
        ("bench (3 of 4)\ntime,torque (engine)", []),
        ("Time,Torque\nms,Nm", [' line 2: a column headed "ms" is taken for time in s']),
        ("times,runs\ns, ft-lb ", [' line 2: a column headed " ft-lb " is taken for torque in N m']),
        ("times,runs\n s ,N·m", []),
    ],
)
def test_a_trace_whose_headings_have_other_units_is_warned_of(heading, told, tmp_path):
    (tmp_path / "trace.csv").write_text(f"{heading}\n0,-6\n1,-1\n", encoding="utf-8")
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        study_from_text(config('profile = "table"\nfile = "trace.csv"'), folder=tmp_path)
    assert [str(each.message).partition(",")[2] for each in warned] == told


def test_a_trace_can_be_changed_on_the_command_line(tmp_path, monkeypatch):
    (tmp_path / "trace.csv").write_text(TRACE)
    (tmp_path / "study.toml").write_text(config('profile = "table"\nfile = "trace.csv"'))
    study = load_study(tmp_path / "study.toml", ["load.torques[2]=-4.0"])
    assert study.load.torques == (-6.0, -4.0, -1.0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "study.toml").write_text(PRESET)
    overrides = ["load.profile=table", "load.file=./trace.csv", "load.torques[2]=-4.0"]
    assert load_study("other/study.toml", overrides).load == study.load  # the path begins in the current directory


@pytest.mark.parametrize("case", BROKEN_TRACES.values(), ids=BROKEN_TRACES)
def test_a_broken_trace_is_reported_with_its_line(case, tmp_path):
    text, message = case
    (tmp_path / "trace.csv").write_text(text)
    ((key, reported),) = problems(config('profile = "table"\nfile = "trace.csv"'), folder=tmp_path)
    assert key == "load.file"
    assert message in reported


def test_a_trace_that_is_no_file_is_refused(tmp_path):
    (tmp_path / "trace.csv").write_bytes(b"0,1\n\xff")
    for file, message in (("gone.csv", "does not exist"), (".", "Is a directory"), ("trace.csv", "line 2")):
        ((key, reported),) = problems(config(f'profile = "table"\nfile = "{file}"'), folder=tmp_path)
        assert key == "load.file"
        assert message in reported


def test_a_long_trace_floods_nothing(tmp_path):
    times = np.arange(3000) * 1e-4
    np.savetxt(tmp_path / "trace.csv", np.column_stack((times, -1.0 - np.exp(-times))), delimiter=",")
    text = config('profile = "table"\nfile = "trace.csv"')
    study = study_from_text(text, folder=tmp_path)
    assert len(repr(study)) + len(repr(study.load)) < 1000
    assert study_from_text(to_toml(study)) == study
    ((_, message),) = problems(to_toml(study), "load.torques[2999]='none'")
    assert len(message) < 200
    ((_, message),) = problems(text + values("load.torqes[3]", [1.0]), folder=tmp_path)
    assert len(message) < 200


# --- Swept and drawn -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("load", "sweep", "refused"),
    [
        ('profile = "ramp"', values("load.duration", [0.0, 0.1]), ""),
        (TABLE, values("load.torques[2]", [-4.0, 2.0]), ""),
        (TABLE, values("load.times[2]", [0.0, 0.2]), ""),
        (TABLE, drawn("samples", "load.scale", "uniform", low=0.5, high=1.5), ""),
        (TABLE, drawn("samples", "load.times[2]", "uniform", low=0.05, high=0.15), ""),
        (
            TABLE,
            f'[sweep]\ndesign = "zip"\n{values("load.times[2]", [0.1, 0.3])}{values("load.times[3]", [0.2, 0.4])}',
            "",
        ),
        ("", values("load.duration", [0.1]), 'the profile is "step", and not "ramp", "smooth" or "pulse"'),
        ("", values("load.times[2]", [0.1]), 'the profile is "step", and not "table"'),
        (TABLE, values("load.ratio", [1.0]), 'the profile is "table", and not "step"'),
        (TABLE, values("load.torques[4]", [1.0]), 'no number "load.torques[4]"'),
        (
            'profile = "ramp"',
            values("load.duration", [-0.1, 0.1]),
            "load.duration: found -0.1; must be a number, 0 or",
        ),
        (TABLE, values("load.times[2]", [0.1, 0.3]), "load.times[2]: found 0.2 after 0.3; times must not decrease"),
        (TABLE, values("load.times[1]", [0.0, 0.1]), "found 0.1; the first time must be 0"),
        (
            TABLE.replace("0.1", "0.0"),
            values("load.times[3]", [0.0, 0.1]),
            "load.times[3]: found 0 for the third time",
        ),
        (
            TABLE,
            values("load.times[2]", [0.1, 0.15]) + values("load.times[3]", [0.12, 0.2]),
            "load.times[2] and load.times[3]: found 0.12 after 0.15",
        ),
        (TABLE, drawn("samples", "load.times[2]", "uniform", low=0.05, high=0.25), "found 0.2 after 0.2"),
        (
            TABLE,
            values("load.times[3]", [0.1, 0.2]) + drawn("tolerances", "load.times[2]", "uniform", low=0.05, high=0.15),
            "times must not decrease",
        ),
    ],
)
def test_sweeps_of_a_load_are_checked_before_anything_runs(load, sweep, refused):
    if not refused:
        assert study_from_text(config(load, sweep)).sweep is not None
    else:
        assert all(refused in message for _, message in problems(config(load, sweep)))


def test_items_of_a_table_can_be_replaced():
    study = study_from_text(config(TABLE))
    assert replace_values(study, {"load.times[2]": 0.15, "load.scale": 2.0}).load.times == (0.0, 0.15, 0.2)
    with pytest.raises(ConfigError, match=re.escape("times must not decrease")):
        replace_values(study, {"load.times[2]": 0.25})


@pytest.mark.parametrize(
    ("profile", "structural"),
    [
        *((profile, []) for profile in ("step", "ramp", "pulse", "table")),
        ("smooth", ["duration"]),
        ("lag", ["time_constant"]),
        ("sine", ["frequency"]),
    ],
)
def test_only_the_rate_of_a_wave_is_part_of_the_system(profile, structural):
    study = study_from_text(config(f'profile = "{profile}"\n{NEEDED.get(profile, "")}'))
    keys = [*PROFILES[profile].keys, "step_time", "torques[2]", "on"]
    assert [key for key in keys if not leaves_system(study, f"load.{key}")] == [*structural, "on"]
