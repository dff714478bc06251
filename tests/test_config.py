import contextlib
import hashlib
import json
import pickle
import re
import tomllib
import warnings
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from click.testing import CliRunner
from hypothesis import assume, example, given, settings, strategies as st
from jsonschema import Draft202012Validator
from jsonschema.protocols import Validator
from scipy import stats

from clunk.cli import cli
from clunk.study.config import load_study, study_from_text
from clunk.study.designs import design_of
from clunk.study.errors import ClunkWarning, ConfigError
from clunk.study.keys import json_schema
from clunk.study.loads import Load
from clunk.study.models import DrivelineConfig, Fit, FreeParameter, Impacts, Lash, Measure, Optimize, Shaft
from clunk.study.parameters import nominal_value
from clunk.study.study import Study, digest, replace_values, to_toml
from clunk.study.sweeps import Axis, Draw, Sampling, Sweep

CONFIGS = sorted((Path(__file__).parent.parent / "configs").glob("*.toml"))
STARTER = files("clunk.study.presets").joinpath("starter.toml").read_text(encoding="utf-8")
PRESET = '[driveline]\npreset = "boere-2008"\n'

# Numbered, so that a broken line can be named by its number.
WHOLE = """\
title = "Whole"
[driveline]
inertias = [0.024, 0.002, 0.002, 0.002]
names = ["motor", "flange", "pinion", "ring"]
[[driveline.shafts]]
between = [1, 2]
stiffness = 31.3
damping = 0.08
[[driveline.shafts]]
between = [2, 3]
stiffness = 31.3
damping = 0.04
[[driveline.shafts]]
between = [4, "ground"]
stiffness = 31.3
damping = 0.1
[lash]
between = [3, 4]
backlash_deg = 6.0
radius = 0.08
[lash.contact]
model = "indentation"
stiffness = 4.092e5
damping = 94.0
separation = "gap"
restitution = 0.5
[load]
profile = "step"
on = 1
static_torque = -1.0
ratio = 5.0
step_time = 0.1
[solver]
method = "rk4"
step = 1e-4
end_time = 2.0
max_events = 512
[impacts]
sticking_time = 0.004
acceleration_of = 3
[[sweep.axes]]
parameter = "load.ratio"
start = 0.0
stop = 10.0
count = 11
[[sweep.axes]]
parameter = "lash.backlash_deg"
values = [1.0, 2.0, 5.0]
"""
ONE_RUN = WHOLE[: WHOLE.index("[[sweep.axes]]")]


def with_line(number: int, line: str) -> str:
    lines = WHOLE.splitlines()
    lines[number - 1] = line
    return "\n".join(lines) + "\n"


LASH_AND_LOAD = """[lash]
between = [1, 2]
backlash_deg = 1.0
radius = 1.0
contact = { stiffness = 100.0, damping = 0.0 }
[load]
static_torque = -1.0
ratio = 5.0
"""


def errors_of(text: str, *overrides: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        study_from_text(text, "study.toml", overrides)
    return caught.value


def axis(body: str) -> str:
    return f"{PRESET}[[sweep.axes]]\n{body}\n"


# --- What is right ---------------------------------------------------------------------------------------------------


def test_preset_is_the_corrected_table_2_2():
    bearing = '[[driveline.shafts]]\nbetween = [1, "ground"]\ndamping = 0.1\n[lash]\n'
    spelled_out = ONE_RUN.replace("[lash]\n", bearing, 1)
    for line in ('title = "Whole"\n', "sticking_time = 0.004\n", "max_events = 512\n"):
        spelled_out = spelled_out.replace(line, "")
    study = study_from_text(PRESET)
    assert study == study_from_text(spelled_out)
    # r² k34 = 2618.88 N m/rad and r² c34 = 0.6016 N m s/rad
    assert study.lash.radius**2 * study.lash.contact.stiffness == pytest.approx(2618.88, rel=1e-12)
    assert study.lash.radius**2 * study.lash.contact.damping == pytest.approx(0.6016, rel=1e-12)


def test_as_printed_preset_differs_only_in_its_inertias():
    corrected = study_from_text(PRESET)
    printed = study_from_text(PRESET.replace("boere-2008", "boere-2008-as-printed"))
    assert printed.driveline.inertias == (0.024, 0.02, 0.02, 0.02)
    inertias = {"inertias": corrected.driveline.inertias}
    assert printed.model_copy(update={"driveline": printed.driveline.model_copy(update=inertias)}) == corrected


def test_what_the_file_gives_goes_before_the_preset():
    study = study_from_text(f"{PRESET}inertias = [1.0, 2.0, 3.0, 4.0]\n[lash.contact]\ndamping = 9\n[load]\nratio = 7")
    assert study.driveline.inertias == (1.0, 2.0, 3.0, 4.0)
    assert (study.lash.contact.damping, study.lash.contact.stiffness) == (9.0, 4.092e5)
    assert (study.load.ratio, study.load.static_torque) == (7.0, -1.0)


IN_MM = ONE_RUN.replace("backlash_deg = 6.0", "gap_mm = 8.0")
PER_DEGREE = ONE_RUN.replace("stiffness = 31.3", "stiffness_per_deg = 0.5", 1)
BY_STEP = ONE_RUN.replace("static_torque = -1.0\nratio = 5.0", "initial_torque = -6.0\nfinal_torque = -1.0")
BY_TABLE = ONE_RUN.replace("static_torque = -1.0\nratio = 5.0", "times = [0, 1]\ntorques = [-6, -1]")
BY_TABLE = BY_TABLE.replace('profile = "step"', 'profile = "table"')


@pytest.mark.parametrize(
    ("text", "overrides", "same"),
    [
        (ONE_RUN, ["lash.gap_mm=8.0"], IN_MM),
        (IN_MM, ["lash.backlash_deg=6.0"], ONE_RUN),
        (ONE_RUN, ["driveline.shafts[1].stiffness_per_deg=0.5"], PER_DEGREE),
        (PER_DEGREE, ["driveline.shafts[1].stiffness=31.3"], ONE_RUN),
        (BY_STEP, ["load.ratio=5.0", "load.static_torque=-1.0"], ONE_RUN),
        (ONE_RUN, ["load.final_torque=-1.0", "load.initial_torque=-6.0"], BY_STEP),
        (ONE_RUN, ["load.profile=table", "load.times=[0, 1]", "load.torques=[-6, -1]"], BY_TABLE),
        (
            WHOLE,
            ["sweep.axes[1].values=[0.0, 5.0]"],
            WHOLE.replace("start = 0.0\nstop = 10.0\ncount = 11", "values = [0.0, 5.0]"),
        ),
        (
            WHOLE,
            ["sweep.axes[2].start=1", "sweep.axes[2].stop=5", "sweep.axes[2].count=9"],
            WHOLE.replace("values = [1.0, 2.0, 5.0]", "start = 1\nstop = 5\ncount = 9"),
        ),
    ],
)
def test_a_key_that_is_set_replaces_those_that_may_be_given_instead_of_it(text, overrides, same):
    assert study_from_text(text, overrides=overrides) == study_from_text(same)


def test_a_gap_in_mm_is_the_backlash_at_the_radius_and_a_stiffness_per_degree_the_stiffness():
    in_mm, per_degree = study_from_text(IN_MM), study_from_text(PER_DEGREE)
    assert in_mm.lash.backlash_deg == pytest.approx(np.rad2deg(8e-3 / 0.08), rel=1e-15)
    assert per_degree.driveline.shafts[0].stiffness == pytest.approx(90.0 / np.pi, rel=1e-15)
    assert not {"gap_mm", "stiffness_per_deg"} & {*re.findall(r"\w+", to_toml(in_mm) + to_toml(per_degree))}
    preset = study_from_text(PRESET, overrides=["lash.gap_mm=8.0"])
    assert preset.lash == in_mm.lash
    assert study_from_text(f"{PRESET}[lash]\ngap_mm = 4\nradius = 0.04\n").lash.backlash_deg == in_mm.lash.backlash_deg
    assert study_from_text(WHOLE.replace("backlash_deg = 6.0", "gap_mm = 8.0")).lash == in_mm.lash
    assert "sweep.axes[2] sweeps lash.backlash_deg" in str(errors_of(WHOLE, "lash.gap_mm=8.0"))


def test_keys_that_are_set_beside_each_other_are_refused():
    assert "given together" in str(errors_of(ONE_RUN, "lash.gap_mm=8.0", "lash.backlash_deg=6.0"))
    assert "found ratio and initial_torque" in str(errors_of(ONE_RUN, "load.ratio=3.0", "load.initial_torque=6.0"))


def test_shafts_that_replace_more_of_a_preset_are_warned_of():
    shaft = "[[driveline.shafts]]\nbetween = [1, 2]\nstiffness = 30.0\ndamping = 0.1\n"
    shaft += shaft.replace("[1, 2]", "[2, 3]")
    with pytest.warns(ClunkWarning, match=r"\[\[driveline\.shafts\]\] replace all 4 shafts of preset"):
        study_from_text(PRESET + shaft)
    study_from_text(PRESET + 2 * shaft)  # a driveline that is spelled out
    study_from_text(PRESET + "inertias = [1.0, 1.0, 1.0, 1.0]\n" + shaft)


def test_a_bearing_has_damping_or_friction_alone_and_the_first_inertia_is_loaded():
    bearings = 'shafts = [{between = [1, "ground"], damping = 0.1}, {between = ["ground", 2], friction = 0.2}]\n'
    study = study_from_text(f"[driveline]\ninertias = [1.0, 1.0]\n{bearings}" + LASH_AND_LOAD)
    assert [(s.stiffness, s.damping, s.friction) for s in study.driveline.shafts] == [(0.0, 0.1, 0.0), (0.0, 0.0, 0.2)]
    assert study.load.on == 1
    text = "[driveline]\ninertias = [1.0, 1.0]\nshafts = [{between = [1, 2], damping = 0.1}]\n" + LASH_AND_LOAD
    assert "driveline.shafts[1].stiffness: missing" in str(errors_of(text))


def test_flanks_that_indent_need_stiffness_and_damping_and_rigid_ones_do_not():
    text = "[driveline]\ninertias = [1.0, 1.0]\n" + LASH_AND_LOAD  # and inertias that a lash joins need no shaft
    assert study_from_text(text, overrides=["lash.contact={model='restitution'}"]).lash.contact.stiffness is None
    error = errors_of(text, "lash.contact={model='indentation'}")
    assert [problem.key for problem in error.problems] == ["lash.contact.stiffness", "lash.contact.damping"]


def test_names_become_numbers():
    text = ONE_RUN.replace("between = [3, 4]", 'between = ["pinion", "ring"]').replace("on = 1", 'on = "motor"')
    text = text.replace("between = [4, ", 'between = ["ring", ').replace(
        "acceleration_of = 3", 'acceleration_of="pinion"'
    )
    assert study_from_text(text) == study_from_text(ONE_RUN)


@pytest.mark.parametrize(("between", "inertia"), [("[3, 4]", 3), ('["ground", 2]', 2), ('["ring", "ground"]', 4)])
def test_severity_is_that_of_the_lash_s_first_inertia(between, inertia):
    assert study_from_text(f"{PRESET}[lash]\nbetween = {between}").impacts.acceleration_of == inertia


def test_figure_3_4_is_the_report_s_grid():
    study = load_study(next(path for path in CONFIGS if path.stem == "figure_3_4"))
    assert study.sweep is not None
    assert [a.parameter for a in study.sweep.axes] == ["load.ratio", "lash.backlash_deg"]
    assert [a.count_of_values for a in study.sweep.axes] == [201, 201]
    np.testing.assert_array_equal(study.sweep.axes[0].grid, np.round(np.arange(201) * 0.05, 10))
    np.testing.assert_array_equal(study.sweep.axes[1].grid, np.round(np.arange(201) * 0.1, 10))


def test_starter_spells_the_preset_out():
    study = study_from_text(STARTER)
    assert study.sweep is not None
    one_run = study.model_copy(update={"sweep": None, "title": "Untitled"})
    assert to_toml(one_run) == to_toml(study_from_text(PRESET))
    assert digest(one_run) == digest(study_from_text(PRESET))


def test_starter_names_every_key():
    keys = set(re.findall(r"^(?:# )?([a-z_]+) = ", STARTER, re.MULTILINE))
    models = (Study, DrivelineConfig, Shaft, Lash, Load, Impacts, Measure, Axis, Sweep, Sampling, Draw)
    models += (Fit, Optimize, FreeParameter, *(Study.model_fields[name].annotation for name in ("solver",)))
    models += (Lash.model_fields["contact"].annotation,)
    tables = {"driveline", "lash", "load", "solver", "impacts", "measures", "sweep", "shafts", "contact"}
    tables |= {"axes", "samples", "tolerances", "sampling", "fit", "optimize", "parameters"}
    assert keys == {name for model in models for name in model.model_fields} - tables | {"preset"}


def test_a_gear_ratio_of_1_is_the_ratio_of_what_has_none():
    plain, unit = study_from_text(ONE_RUN), study_from_text(ONE_RUN.replace("[lash]", "[lash]\nratio = 1"))
    assert plain == unit
    assert digest(plain) == digest(unit)
    for key in ("lash.ratio", "driveline.shafts[2].ratio"):
        geared = replace_values(plain, {key: -3.7})
        assert nominal_value(geared, key) == -3.7
        assert digest(geared) != digest(plain)
        assert study_from_text(to_toml(geared)) == geared


def test_a_gear_ratio_can_be_swept_drawn_and_toleranced():
    over_ratio = "[[sweep.axes]]\nparameter = 'lash.ratio'\nvalues = [-2.0, 3.0]\n"
    draw = "[[sweep.{}]]\nparameter = 'driveline.shafts[1].ratio'\ndistribution = 'uniform'\nlow = {}\nhigh = 2.0\n"
    for table in ("samples", "tolerances"):
        study = study_from_text(PRESET + over_ratio + draw.format(table, 1.5))
        assert study.sweep is not None
        assert study_from_text(to_toml(study)) == study
    across_zero = draw.replace("low", "draws = 'factor'\nlow").format("samples", -2.0)
    with pytest.raises(ConfigError, match="lost in rounding"):
        study_from_text(f"{PRESET}{across_zero}[sweep.sampling]\ncount = 1\n{over_ratio}".replace("3.0]", "1e7]"))


# --- The JSON Schema -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def schema() -> Validator:
    Draft202012Validator.check_schema(json_schema())
    return Draft202012Validator(json_schema())


TEXTS = {
    "whole": WHOLE,
    "one run": ONE_RUN,
    "table": BY_TABLE,
    "starter": STARTER,
    "preset": PRESET,
    **{path.stem: path.read_text("utf-8") for path in CONFIGS},
}


@pytest.mark.parametrize("name", TEXTS)
def test_the_schema_allows_a_config_and_its_resolved_text_which_is_an_equal_study_without_doubts(schema, name):
    schema.validate(tomllib.loads(TEXTS[name]))
    study = study_from_text(TEXTS[name])
    resolved = to_toml(study)
    schema.validate(tomllib.loads(resolved))
    assert "preset" not in resolved
    with warnings.catch_warnings():
        if name in ("one run", "whole", "table"):  # what the defaults fill in is never in doubt
            warnings.simplefilter("error", ClunkWarning)
        again = study_from_text(resolved)
    assert again == study
    assert (to_toml(again), digest(again)) == (resolved, digest(study))


@pytest.mark.parametrize(
    "text",
    [
        with_line(1, 'titel = "x"'),
        with_line(14, "between = [1]"),
        with_line(15, "stiffness = 31.3\nratio = 0"),
        with_line(20, 'radius = "x"'),
        with_line(22, 'model = "hertz"'),
        with_line(42, "parameter = 1"),
        f"{ONE_RUN}[[sweep.tolerances]]\nparameter = 'lash.radius'\ndistribution = 'gaussian'\nlow = 1\n",
        '[driveline]\npreset = "boere"\n',
        "",
    ],
)
def test_schema_refuses_what_a_config_may_not_hold(schema, text):
    assert not schema.is_valid(tomllib.loads(text))
    errors_of(text)


def test_init_prints_the_schema_that_the_starter_names():
    assert STARTER.startswith("#:schema ./clunk.schema.json\n")
    printed = CliRunner().invoke(cli, ["init", "--schema"])
    assert printed.exit_code == 0
    assert json.loads(printed.output) == json_schema()


# --- What is wrong ---------------------------------------------------------------------------------------------------

BROKEN = [
    # text, key, line, what the message must say
    (with_line(1, "title = 3"), "title", 1, "found 3; must be text"),
    (with_line(1, 'title = "a\\u0000b"'), "title", 1, "text on one line"),
    (with_line(3, "inertias = [0.024, 0.0, 0.002, 0.002]"), "driveline.inertias[2]", 3, r"greater than 0 (kg m2)"),
    (with_line(3, "inertias = [0.024, true, 0.002, 0.002]"), "driveline.inertias[2]", 3, "found true"),
    (with_line(3, 'inertias = [\n0.024, # "\n"x",\n1,1]'), "driveline.inertias[2]", 3, 'found "x"; must be a number'),
    (with_line(3, "inertias = 0.024"), "driveline.inertias", 3, "must be a list of numbers greater than 0 (kg m2)"),
    (with_line(3, "inertias = [1, 1, 1, 1, 1]"), "driveline.names", 4, "4 names for 5 inertias"),
    (with_line(3, ""), "driveline.inertias", 2, "missing"),
    (with_line(6, 'between = ["ground", 2]'), "driveline.inertias[1]", 3, "no shaft and no lash joins motor to"),
    (with_line(4, 'names = ["motor", "ring", "pinion", "ring"]'), "driveline.names[4]", 4, "taken by inertia 2"),
    (with_line(4, 'names = ["ground", "a", "b", "c"]'), "driveline.names[1]", 4, "kept for the ground"),
    (with_line(4, 'names = ["a", "2", "b", "c"]'), "driveline.names[2]", 4, 'found "2"'),
    (with_line(6, "between = [1, 5]"), "driveline.shafts[1].between[2]", 6, "there is no inertia 5"),
    (with_line(10, "between = [2, 2]"), "driveline.shafts[2].between", 10, "both ends are 2"),
    (with_line(14, 'between = ["ground", "ground"]'), "driveline.shafts[3].between", 14, 'both ends are "ground"'),
    (with_line(14, "between = [1]"), "driveline.shafts[3].between", 14, "found [1]; must be two inertias"),
    (with_line(15, "stiffness = 31.3\nratio = 0"), "driveline.shafts[3].ratio", 16, "found 0; must be a finite number"),
    (with_line(15, "stiffness = 31.3\nratio = 1e7"), "driveline.shafts[3].stiffness", 15, "lost in rounding"),
    (with_line(15, "stiffness = 3\nstiffness_per_deg = 1"), "driveline.shafts[3]", 13, "given together; give one of"),
    (with_line(15, "stiffness_per_deg = -1"), "driveline.shafts[3].stiffness_per_deg", 15, "0 or greater (N m/degree)"),
    (with_line(18, 'between = ["pinion", "rign"]'), "lash.between[2]", 18, 'did you mean "ring"?'),
    (with_line(18, "between = [3, 4.0]"), "lash.between[2]", 18, "there is no inertia 4.0; it must be"),
    (with_line(19, "backlsh_deg = 6.0"), "lash.backlsh_deg", 19, 'did you mean "backlash_deg"?'),
    (with_line(19, "backlash_deg = 361"), "lash.backlash_deg", 19, "from 0 to 360 (degrees)"),
    (with_line(19, "backlash_deg = 6.0\ngap_mm = 8.4"), "lash", 17, "backlash_deg and gap_mm are given together; give"),
    (ONE_RUN.replace("backlash_deg = 6.0", "gap_mm = 8e2"), "lash.gap_mm", 19, "is 572.958 degrees, and at most"),
    (ONE_RUN.replace("backlash_deg = 6.0", "gap_mm = -1"), "lash.gap_mm", 19, "a number, 0 or greater (mm)"),
    (ONE_RUN.replace("backlash_deg = 6.0\nradius = 0.08", "gap_mm = 8"), "lash.radius", 17, "missing"),
    (with_line(42, 'parameter = "lash.gap_mm"'), "sweep.axes[1].parameter", 42, 'did you mean "lash.backlash_deg"?'),
    (with_line(42, 'parameter = "driveline.shafts[2].stiffness_per_deg"'), "sweep.axes[1].parameter", 42,
     'did you mean "driveline.shafts[2].stiffness"?'),
    (with_line(42, 'parameter = "lash.ratio"'), "sweep.axes[1].start", 43, "found 0; must be a finite number other"),
    (with_line(42, 'parameter = "lash.ratio"').replace("start = 0.0", "start = -10.0"), "sweep.axes[1]", 41,
     "lash.ratio: found 0; must be a finite number other"),
    (with_line(48, "values = [-1, 0, 2]").replace("lash.backlash_deg", "driveline.shafts[1].ratio"),
     "sweep.axes[2].values[2]", 48, "ratio: found 0; must be"),
    (with_line(48, "values = [1, 1e8]").replace("lash.backlash_deg", "lash.ratio"),
     "sweep.axes[2].values[2]", 48, "lost in"),
    (with_line(47, "values = [0.1, 0.2]").replace("backlash_deg = 6.0", "gap_mm = 8")
     .replace('"lash.backlash_deg"', '"lash.radius"').replace("values = [1.0, 2.0, 5.0]", 'parameter = "lash.radius"'),
     "sweep.axes[2].parameter", 48, "changes the angle of its gap_mm"),
    (with_line(20, "radius = 1979-05-27"), "lash.radius", 20, "found 1979-05-27"),
    (with_line(20, f"radius = 0x{'f' * 6000}"), "lash.radius", 20, "beyond 64 bits"),
    (with_line(20, "radius = 0.08\nstifness = 3"), "lash.stifness", 21, '"stiffness" in [lash.contact]'),
    (with_line(22, 'model = "indentatoin"'), "lash.contact.model", 22, 'did you mean "indentation"?'),
    (with_line(23, "stiffness = 0"), "lash.contact.stiffness", 23, "greater than 0 (N/m)"),
    (with_line(26, "restitution = 1.1"), "lash.contact.restitution", 26, "from 0 to 1"),
    (with_line(29, 'on = "ground"'), "load.on", 29, 'there is no inertia "ground"; it must be'),
    (with_line(30, ""), "load", 27, "found ratio; must be static_torque and ratio or initial_torque and"),
    (with_line(31, "initial_torque = 2"), "load", 27, "found static_torque and initial_torque; must be"),
    (ONE_RUN.replace("static_torque = -1.0\nratio", "final_torque"), "load", 27, "found final_torque; must be"),
    (with_line(32, "[foo]\nx = 1"), "foo", 32, "unknown key; allowed here: title, driveline"),
    (with_line(35, "step = 3.0"), "solver.step", 35, "longer than the run, end_time = 2 s"),
    (with_line(35, "step = 1e-10"), "solver.step", 35, "at most 1e+09"),
    (with_line(20, "radius = 1e-300"), "lash.radius", 20, "found 1e-300; must be from 1e-30 to 1e+30"),
    (with_line(30, "static_torque = -1e155"), "load.static_torque", 30, "must be from -1e+30 to 1e+30"),
    (with_line(15, "stiffness = 1e12"), "driveline.shafts[3].stiffness", 15, "more than a factor of 1e+10 apart"),
    (with_line(20, "radius = 5e7"), "lash.contact.stiffness", 23, "1.023e+21 N m/rad here (with"),
    (with_line(3, "inertias = [1e11, 0.002, 0.002, 0.002]"), "driveline.inertias[1]", 3, "lost in rounding"),
    (with_line(16, "damping = 1e11"), "driveline.shafts[3].damping", 16, "a rate of 5e+13 1/s"),
    (with_line(16, "damping = 0.1" + 9 * '\n[[driveline.shafts]]\nbetween = [4, "ground"]\nfriction = 0.1'),
     "driveline", 2, "combine to 59,049 regimes; at most 30,000"),
    (with_line(42, 'parameter = "driveline.shafts[2].stiffness"').replace("stop = 10.0", "stop = 1e18"),
     "sweep.axes[1].stop", 44, "lost in rounding"),
    (with_line(37, "max_events = 100001"), "solver.max_events", 37, "a whole number from 1 to 100000"),
    (with_line(42, 'parameter = "load.ration"'), "sweep.axes[1].parameter", 42, 'did you mean "load.ratio"?'),
    (with_line(42, 'parameter = "driveline.inertias"'), "sweep.axes[1].parameter", 42, "driveline.inertias[4]"),
    (with_line(42, 'parameter = "lash.contact.model"'), "sweep.axes[1].parameter", 42, 'number "lash.contact.model"'),
    (with_line(42, 'parameter = "lash.backlash_deg"'), "sweep.axes[2].parameter", 47, "swept by sweep.axes[1] already"),
    (with_line(42, 'parameter = "load.initial_torque"'), "sweep.axes[1].parameter", 42, "given by static_torque and"),
    (with_line(42, 'parameter = "driveline.shafts[2].damping"\nstart = -1').replace("start = 0.0\n", ""),
     "sweep.axes[1].start", 43, "damping: found -1.0; must be a number, 0 or greater"),
    (with_line(42, 'parameter = "load.ratio"\nscale = "log"'), "sweep.axes[1]", 41, 'on an axis of scale "log"'),
    (with_line(42, 'parameter = "solver.step"').replace("start = 0.0", "start = 1e-4"), "sweep.axes[1].stop", 44,
     "a step of 10 s is longer than the run"),
    (with_line(42, 'parameter = "load.on"\nstart = 1').replace("start = 0.0\nstop = 10.0", "stop = 11.0"),
     "sweep.axes[1].stop", 44, "there is no inertia 11; it must be a number from 1 to 4"),
    (with_line(45, "count = 1"), "sweep.axes[1].count", 45, "found 0 to 10 in 1; one value has the start as its stop"),
    (with_line(45, f"count = {10**12}"), "sweep.axes[1].count", 45, "from 1 to 10000000"),
    (with_line(45, ""), "sweep.axes[1]", 41, "found start, stop and scale; give"),
    (with_line(44, "stop = 0.0"), "sweep.axes[1].count", 45, "found 0 to 0 in 11"),
    (with_line(44, "stop = 1e308"), "sweep.axes[1]", 41, "beyond the range of numbers"),
    (with_line(45, "count = 3\nvalues = [1.0]"), "sweep.axes[1]", 41, "found values, start, stop and count; give"),
    (with_line(45, 'count = 3\nscale = "cubic"'), "sweep.axes[1].scale", 46, '"linear" or "log"'),
    (with_line(48, "values = [1.0,\n 2, 1]"), "sweep.axes[2].values", 48, "the value 1 occurs 2 times"),
    (with_line(48, "values = [1.0, inf]"), "sweep.axes[2].values[2]", 48, "found inf"),
    (with_line(48, ""), "sweep.axes[2]", 46, "found no values; give"),
    (f"{WHOLE}[sweep.axis]\n", "sweep.axis", 49, 'did you mean "axes"?'),
    (f"{ONE_RUN}[sweep]\naxes = []\n", "sweep.axes", 42, "an array of tables, [[sweep.axes]]"),
    ('preset = "boere-2008"\n', "preset", 1, '"preset" in [driveline]'),
    (f'{PRESET}title = "Rig"\n', "driveline.title", 3, 'did you mean "title" above the first table?'),
    ('[driveline]\npreset = "boere-2080"\n', "driveline.preset", 2, 'did you mean "boere-2008"?'),
    (f"{PRESET}inertias = [1, 1, 1]\n", "lash.between[2]", None, "there is no inertia 4"),
    ("lash = 3\n", "lash", 1, "found 3; must be a table"),
    ("", "driveline", None, "give driveline.preset"),
    (f"{PRESET}[load]\ninitial_torque = 1\n", "load", 3, "found initial_torque; must be"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "key", "line", "message"), BROKEN, ids=[f"{case[1]}-{case[3]}" for case in BROKEN])
def test_broken_config_is_reported_where_it_is_broken(text, key, line, message):
    error = errors_of(text)
    found = {problem.key: problem for problem in error.problems}
    assert key in found, str(error)
    assert len(found) == 1 or text.count("\n") <= 20  # one mistake in a whole config is one error
    assert message in found[key].message
    assert found[key].line == line
    where = f"line {line}, {key}:" if line is not None else f"  {key}:"
    assert where in str(error)


def test_whole_config_is_valid():
    """Without this, every broken config above could be broken for another reason."""
    assert study_from_text(WHOLE).sweep is not None
    assert study_from_text(ONE_RUN).sweep is None


@pytest.mark.parametrize("override", ["solver.end_time=5e-5", "solver.step=1e-12"])
def test_the_step_of_rk4_is_no_limit_of_the_exact_method(override):
    with pytest.raises(ConfigError, match="step"):
        study_from_text(WHOLE, overrides=[override])
    assert study_from_text(WHOLE, overrides=[override, 'solver.method="exact"']).solver.method == "exact"


def test_all_errors_are_reported_at_once_in_the_order_of_their_lines():
    text = WHOLE
    for old, new in {
        "title =": "titel =",
        "between = [2, 3]": 'between = [2, "gear"]',
        "backlash_deg = 6.0": "backlash_deg = -6.0",
        'separation = "gap"': 'separation = "force!"',
        "on = 1": 'on = "moter"',
        "step = 1e-4": 'step = "small"',
        "acceleration_of = 3": "acceleration_of = 3.5",
        '"lash.backlash_deg"\n': '"lash.backlsh_deg"\n',
        "count = 11": "count = -1",
    }.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    error = errors_of(text, "solver.max_events=0", "nonsense")
    assert [(problem.line, problem.key) for problem in error.problems] == [
        (1, "titel"),
        (10, "driveline.shafts[2].between[2]"),
        (19, "lash.backlash_deg"),
        (25, "lash.contact.separation"),
        (29, "load.on"),
        (35, "solver.step"),
        (40, "impacts.acceleration_of"),
        (45, "sweep.axes[1].count"),
        (47, "sweep.axes[2].parameter"),
        (None, "solver.max_events"),
        (None, '"nonsense"'),
    ]
    assert str(error).startswith("study.toml has 11 errors:\n  line 1, titel: unknown key")


def test_report_fits_eighty_columns():
    error = errors_of(WHOLE.replace("[3, 4]", '["' + "x" * 500 + '", 4]').replace("on = 1", 'on = "moter"'))
    assert max(len(line) for line in str(error).splitlines()) <= 80
    assert "…" in str(error)


def test_wrong_value_of_a_preset_says_so():
    error = errors_of(f"{PRESET}inertias = [1, 1, 1]\n")
    assert all('preset "boere-2008"' in problem.message for problem in error.problems)


def test_error_survives_pickling():
    error = errors_of("lash = 3")
    copied = pickle.loads(pickle.dumps(error))
    assert str(copied) == str(error)
    assert copied.problems == error.problems


# --- Files that are no configs ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"title = \xff", "is not UTF-8 text: byte 0xff on line 1"),
        (b"\x89HDF\r\n\x1a\n", "is not UTF-8 text: byte 0x89 on line 1; a config is a TOML file"),
        (b"title = 1\n= 2\n", "is not valid TOML: Invalid statement (at line 2, column 1)"),
        (b"title = 1\ntitle = 2\n", "is not valid TOML"),
        (b"x = " + b"[" * 5000 + b"]" * 5000, "is nested too deeply"),
        (b"x" + b".x" * 5000 + b" = 1", "is nested too deeply"),
        (b"x = " + b"9" * 5000, "an integer of thousands of digits"),
    ],
)
def test_file_that_is_no_config_is_one_sentence(tmp_path, content, message):
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_study(path)
    assert str(caught.value).startswith(f"{path} ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(caught.value.problems) == 1


def test_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "figure.toml").write_text(PRESET)
    with pytest.raises(ConfigError, match=r"figrue\.toml does not exist; did you mean .*figure\.toml\?"):
        load_study(tmp_path / "figrue.toml")
    (tmp_path / "TRUCK-6X4.toml").write_text(PRESET)
    with pytest.raises(ConfigError, match=r"did you mean .*TRUCK-6X4\.toml\?"):
        load_study(tmp_path / "truck-6x2.toml")
    with pytest.raises(ConfigError, match=r"nothing\.txt does not exist\.$"):
        load_study(tmp_path / "away" / "nothing.txt")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory; a config is a TOML file"):
        load_study(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_study("nul\0.toml")


def test_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path):
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xef\xbb\xbf" + WHOLE.replace("\n", "\r\n").encode())
    assert load_study(path) == study_from_text(WHOLE)
    path.write_bytes(with_line(20, "radius = -1").replace("\n", "\r\n").encode())
    with pytest.raises(ConfigError) as caught:
        load_study(path)
    assert [problem.line for problem in caught.value.problems] == [20]


# --- Overrides -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "parameter", "value"),
    [
        ("load.ratio=7", "load.ratio", 7.0),
        (" load.ratio = 7.5 ", "load.ratio", 7.5),
        ("driveline.inertias[4]=0.003", "driveline.inertias[4]", 0.003),
        ("driveline.inertias[ring]=0.003", "driveline.inertias[4]", 0.003),
        ("driveline.inertias=[1.0, 2.0, 3.0, 4.0]", "driveline.inertias[3]", 3.0),
        ("driveline.shafts[3].damping=0", "driveline.shafts[3].damping", 0.0),
        ("impacts.sticking_time=1e-3", "impacts.sticking_time", 1e-3),
        ("load.on=ring", "load.on", 4.0),
        ('load.on="ring"', "load.on", 4.0),
        ("driveline.preset=boere-2008-as-printed", "driveline.inertias[4]", 0.02),
    ],
)
def test_override_sets_its_key(override, parameter, value):
    study = study_from_text(PRESET, overrides=[override])
    assert study == study_from_text(PRESET, overrides=override)  # one needs no list
    assert nominal_value(study, parameter) == value
    assert nominal_value(study_from_text(PRESET), "load.static_torque") == -1.0


@pytest.mark.parametrize(
    ("override", "key", "message"),
    [
        ("load.ratio", '"load.ratio"', "must be KEY=VALUE"),
        ("=7", '"=7"', "must be KEY=VALUE"),
        ("load..ratio=7", '"load..ratio=7"', "must be KEY=VALUE"),
        ("driveline.inertias[0]=7", '"driveline.inertias[0]=7"', "from 1"),
        ("load.ratio=", '"load.ratio="', "no TOML value"),
        ("load.ratio=7\nx=8", '"load.ratio=7\\nx=8"', "no TOML value"),
        ("load.ration=7", "load.ration", 'did you mean "ratio"?'),
        ("driveline.inertias[9]=1", "driveline.inertias[9]", "no such place"),
        ("driveline.inertias[rign]=1", "driveline.inertias[rign]", "no such place"),
        ("driveline.shafts.damping=1", "driveline.shafts.damping", "no such place"),
        ("title.x=1", "title.x", "no such place"),
        ("lash.backlash_deg=7", "lash.backlash_deg", "sweep.axes[2] sweeps lash.backlash_deg"),
        ("sweep.axes[2].values=[500.0]", "sweep.axes[2].values[1]", "from 0 to 360"),
    ],
)
def test_broken_override_is_reported_as_an_override(override, key, message):
    text = WHOLE.replace('"load.ratio"', '"lash.radius"').replace("start = 0.0", "start = 1.0")
    error = errors_of(text, override)
    assert [problem.key for problem in error.problems] == [key]
    assert message in error.problems[0].message
    assert error.problems[0].line is None
    assert f"--set {key}:" in str(error)


def test_a_name_that_there_is_not_is_refused_with_those_that_there_are():
    lashes = "".join(
        f'[[lash]]\nname = "{name}"\nbetween = {between}\nbacklash_deg = 3.0\nradius = 0.08\n'
        "contact = { stiffness = 4e5, damping = 90.0 }\n"
        for name, between in (("spline", '["motor", "flange"]'), ("gear", '["pinion", "ring"]'))
    )
    text = f'[driveline]\npreset = "boere-2008"\n{lashes}'
    assert study_from_text(text, overrides="lash[gear].backlash_deg=5").lashes[1].backlash_deg == 5.0
    with pytest.raises(ConfigError, match=r'by name: "spline" and "gear"'):
        study_from_text(text, overrides="lash[gaer].backlash_deg=5")


def test_text_of_an_override_may_hold_brackets_and_equals_signs():
    assert study_from_text(WHOLE, overrides=['title="a]b = [c"']).title == "a]b = [c"


STAGED = ["driveline.shafts[1].stiffness=[31.3, 10.0, 31.3]", "driveline.shafts[1].breakpoints_deg=[-4.0, 2.0]"]
OVER_SHAFT = "sweep.axes=[{{parameter='driveline.shafts[{}', start={}, stop=2.0, count=3}}]"
WRONG_SHAFTS = [
    (STAGED[:1], "there is one stiffness more than there are breakpoints_deg"),
    (STAGED[1:], "there is one stiffness more than there are breakpoints_deg"),
    ([STAGED[0], "driveline.shafts[1].breakpoints_deg=[2.0, -4.0]"], "must be in ascending order"),
    ([STAGED[0], "driveline.shafts[1].breakpoints_deg=[2.0, 2.0]"], "must be in ascending order"),
    (["driveline.shafts[1].stiffness=[1.0, -1.0, 1.0]", STAGED[1]], "0 or greater"),
    ([*STAGED, "driveline.shafts[1].stiffness_per_deg=1.0"], "give one of the two"),
    ([*STAGED, OVER_SHAFT.format("1].stiffness", 1.0)], 'did you mean "driveline.shafts[1].stiffness[3]"?'),
    ([OVER_SHAFT.format("2].stiffness[1]", 1.0)], 'did you mean "driveline.shafts[2].stiffness"?'),
    ([*STAGED, OVER_SHAFT.format("1].breakpoints_deg[1]", -5)], "breakpoints must be in ascending order"),
    (["driveline.shafts[1].friction=-0.1"], "driveline.shafts[1].friction: found -0.1; must be a number, 0 or greater"),
    (["driveline.shafts[1].friktion=0.1"], 'did you mean "friction"?'),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "message"), WRONG_SHAFTS)
def test_stages_and_frictions_that_cannot_be_are_refused(overrides, message):
    assert message in " ".join(str(errors_of(ONE_RUN, *overrides)).split())


# --- Axes ------------------------------------------------------------------------------------------------------------


def test_linear_axis_has_the_round_numbers_in_it():
    grid = Axis(parameter="load.ratio", start=0.0, stop=10.0, count=201).grid
    assert grid.dtype == np.float64
    assert grid[3] == 0.15
    assert grid[[0, -1]].tolist() == [0.0, 10.0]
    assert not grid.flags.writeable


def test_log_axis_has_a_constant_ratio():
    grid = Axis(parameter="lash.radius", start=0.01, stop=10.0, count=4, scale="log").grid
    # four multiplications and a power: a few units in the last place
    np.testing.assert_allclose(grid, [0.01, 0.1, 1.0, 10.0], rtol=1e-14)
    assert grid[[0, -1]].tolist() == [0.01, 10.0]


@example(start=203.33966460944185, stop=203.33966460944188, count=15, log=True)  # rounding alone would leave the ends
@given(start=st.floats(-1e6, 1e6), stop=st.floats(-1e6, 1e6), count=st.integers(2, 300), log=st.booleans())
def test_axis_stays_between_its_ends(start, stop, count, log):
    if log:
        start, stop = max(abs(start), 1e-6), max(abs(stop), 1e-6)
    assume(start != stop)
    grid = Axis(parameter="x", start=start, stop=stop, count=count, scale="log" if log else "linear").grid
    assert grid.size == count
    assert (grid[0], grid[-1]) == (start, stop)
    assert grid.min() >= min(start, stop)
    assert grid.max() <= max(start, stop)


@pytest.mark.parametrize(
    "parameter",
    ["impacts.sticking_time", "lash.contact.locking_speed", "load.step_time", "driveline.shafts[3].damping"],
)
def test_optional_and_nested_keys_can_be_swept(parameter):
    study = study_from_text(axis(f'parameter = "{parameter}"\nvalues = [0.5, 1]'))
    assert nominal_value(replace_values(study, {parameter: 0.5}), parameter) == 0.5


def test_axis_may_name_an_inertia_and_sweep_its_number():
    study = study_from_text(axis('parameter = "driveline.inertias[ring]"\nvalues = [0.5, 1]'))
    assert study.sweep.axes[0].parameter == "driveline.inertias[4]"
    for values in ("[1, 2, 3]", "[1.0, 4.0]"):
        assert study_from_text(axis(f'parameter = "load.on"\nvalues = {values}')).sweep is not None
    named = study_from_text(axis('parameter = "load.on"\nvalues = ["ring", 2, "motor"]'))
    assert named.sweep.axes[0].values == (4.0, 2.0, 1.0)
    (problem,) = errors_of(axis('parameter = "load.on"\nvalues = ["motor", "rimg"]')).problems
    assert (problem.key, problem.message[:51]) == (
        "sweep.axes[1].values[2]",
        'there is no inertia "rimg"; did you mean "ring"? It',
    )
    error = errors_of(axis('parameter = "load.on"\nstart = 1\nstop = 4\ncount = 3'))
    assert "there is no inertia 2.5; it must be a number" in error.problems[0].message


def test_swept_key_may_be_left_out():
    text = "\n".join(line for line in WHOLE.splitlines() if not line.startswith(("ratio", "backlash_deg")))
    study = study_from_text(text)
    assert (study.load.ratio, study.lash.backlash_deg) == (0.0, 1.0)


def test_a_swept_key_that_is_left_out_keeps_its_default():
    axes = axis('parameter = "driveline.shafts[1].friction"\nvalues = [0.3]')
    axes += '[[sweep.axes]]\nparameter = "impacts.acceleration_of"\nvalues = [4, 2]\n'
    study = study_from_text(axes)
    assert (study.driveline.shafts[0].friction, study.impacts.acceleration_of) == (0.0, 3)


def test_wrong_axis_over_a_left_out_key_is_one_error():
    text = WHOLE.replace("backlash_deg = 6.0\n", "").replace("values = [1.0,", "values = [-1.0,")
    assert [problem.key for problem in errors_of(text).problems] == ["sweep.axes[2].values[1]"]
    text = WHOLE.replace("backlash_deg = 6.0\n", "").replace("values = [1.0, 2.0, 5.0]", 'values = ["a"]')
    assert [problem.key for problem in errors_of(text).problems] == ["sweep.axes[2].values[1]"]


def test_absurd_grids_are_refused_before_anything_is_allocated():
    three = "".join(
        f'[[sweep.axes]]\nparameter = "{parameter}"\nstart = 1\nstop = 2\ncount = 10000\n'
        for parameter in ("load.ratio", "lash.backlash_deg", "lash.radius")
    )
    error = errors_of(PRESET + three)
    assert [problem.key for problem in error.problems] == ["sweep.axes"]
    assert "1,000,000,000,000 cells" in error.problems[0].message
    longest = study_from_text(axis('parameter = "load.ratio"\nstart = 1\nstop = 2\ncount = 10000000'))
    assert longest.sweep is not None
    assert longest.sweep.axes[0].count_of_values == 10_000_000


# --- Values, text, digest --------------------------------------------------------------------------------------------


def test_digest_is_of_what_decides_the_results():
    same = [
        WHOLE.replace('"Whole"', '"Other"'),
        WHOLE.replace('["motor"', '["engine"'),
        WHOLE.replace("ratio = 5.0", "ratio = 6.0"),  # swept
        WHOLE.replace("start = 0.0", "start = -0.0"),
        WHOLE.replace("between = [3, 4]", 'between = ["pinion", "ring"]'),
    ]
    other = [
        WHOLE.replace("step = 1e-4", "step = 2e-4"),
        WHOLE.replace("count = 11", "count = 12"),
        WHOLE.replace("0.024", "0.025"),
        WHOLE.replace("static_torque = -1.0", "static_torque = -2.0"),
        WHOLE.replace("[1.0, 2.0, 5.0]", "[1.0, 5.0, 2.0]"),
        ONE_RUN,
    ]
    assert {digest(study_from_text(text)) for text in same} == {digest(study_from_text(WHOLE))}
    assert len({digest(study_from_text(text)) for text in [WHOLE, *other]}) == 1 + len(other)
    assert len(digest(study_from_text(WHOLE))) == hashlib.sha256().digest_size * 2


def test_replaced_values_are_those_of_the_study():
    study = study_from_text(WHOLE)
    values = {"load.ratio": 3.0, "driveline.inertias[4]": 0.003, "lash.contact.stiffness": 1e5, "load.on": 2.0}
    replaced = replace_values(study, values)
    assert {parameter: nominal_value(replaced, parameter) for parameter in values} == values
    assert nominal_value(study, "load.ratio") == 5.0
    assert replaced.driveline.inertias == (0.024, 0.002, 0.002, 0.003)
    assert (replaced.load.on, type(replaced.load.on)) == (2, int)
    assert replaced.sweep == study.sweep
    assert replace_values(study, {}) == study
    assert type(replace_values(study, {"load.ratio": np.float64(2.0)}).load.ratio) is float


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"driveline.inertias[5]": 1.0}, 'no number "driveline.inertias[5]"'),
        ({"driveline.inertias[4]": 0.0}, "driveline.inertias[4]: found 0.0; must be a number greater than 0"),
        ({"load.on": 5.0}, "there is no inertia 5"),
        ({"solver.step": 3.0}, "longer than the run"),
        ({"load.initial_torque": 3.0}, "found static_torque, ratio and initial_torque; must be"),
        ({"lash.radius": 0.0, "lash.backlash_deg": -1.0, "solver.step": 0.0}, "has 3 errors"),
    ],
)
def test_replaced_values_obey_the_rules_of_a_file(values, message):
    with pytest.raises(ConfigError) as caught:
        replace_values(study_from_text(WHOLE), values)
    assert message in str(caught.value).replace("\n    ", " ")


# --- Whatever comes --------------------------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=30), st.text(max_size=30))
def test_any_text_and_any_override_is_a_study_or_a_config_error(text, override):
    with pytest.raises(ConfigError):
        study_from_text(text, overrides=[override])
    with contextlib.suppress(ConfigError):
        study_from_text(PRESET, overrides=[override])


# --- Designs: axes walked together, drawn keys -----------------------------------------------------------------------


def drawn(*tables: str, sweep: str = "", sampling: str = "count = 16") -> str:
    """The preset with some [[sweep.samples]]."""
    return "\n".join(
        [PRESET, f"[sweep]\n{sweep}" if sweep else "", f"[sweep.sampling]\n{sampling}"]
        + [f"[[sweep.samples]]\n{table}" for table in tables]
    )


def sample(parameter: str, distribution: str, **numbers: float | str) -> str:
    return tomli_w.dumps({"parameter": parameter, "distribution": distribution, **numbers})


def toleranced(*draws: str, low: float = 1.0) -> str:
    """The preset with some tolerances of its backlash, 6 degrees."""
    tables = (sample("lash.backlash_deg", "uniform", draws=each, low=low, high=1.5) for each in draws)
    return "\n".join([PRESET, "[sweep.sampling]\ncount = 16", *(f"[[sweep.tolerances]]\n{each}" for each in tables)])


STIFFNESS = "lash.contact.stiffness"
DAMPING_AXIS = '[[sweep.axes]]\nparameter = "lash.contact.damping"\nvalues = [50.0, 94.0]\n'
ZIP = PRESET + (
    '[sweep]\ndesign = "zip"\n[[sweep.axes]]\nparameter = "load.ratio"\nvalues = [1, 2, 5]\n'
    '[[sweep.axes]]\nparameter = "lash.backlash_deg"\nstart = 1\nstop = 9\ncount = 3\n'
)
WRONG_DESIGNS = {
    "zip lengths": (ZIP.replace("count = 3", "count = 4"), "sweep.axes[2]", "found 4 values, and load.ratio has 3"),
    "unknown design": (ZIP.replace('"zip"', '"zipped"'), "sweep.design", 'did you mean "zip"?'),
    "zip with samples": (ZIP + f"[[sweep.samples]]\n{sample(STIFFNESS, 'uniform', low=1.0, high=2.0)}",
                         "sweep.samples", 'do not go with design = "zip"'),
    "misspelt number": (drawn(sample(STIFFNESS, "uniform", low=1.0, hihg=2.0)), "sweep.samples[1].hihg",
                        'did you mean "high"?'),
    "missing number": (drawn(sample(STIFFNESS, "uniform", low=1.0)), "sweep.samples[1]",
                       "found low; a uniform distribution is given by low and high"),
    "superfluous number": (drawn(sample(STIFFNESS, "triangular", low=1.0, mode=2.0, high=3.0, std=1.0)),
                           "sweep.samples[1]", "a triangular distribution is given by low, mode and high"),
    "low above high": (drawn(sample(STIFFNESS, "uniform", low=2.0, high=1.0)), "sweep.samples[1].high",
                       "found 1; must be greater than low = 2"),
    "mode outside": (drawn(sample(STIFFNESS, "triangular", low=1.0, mode=4.0, high=3.0)), "sweep.samples[1].mode",
                     "must be from low to high"),
    "drawn twice": (drawn(*2 * [sample(STIFFNESS, "normal", draws="factor", std=0.1)]), "sweep.samples[2].parameter",
                    "drawn by sweep.samples[1] already"),
    "two offsets": (toleranced("factor", "offset", "offset"), "sweep.tolerances[3].parameter",
                    "drawn by sweep.tolerances[2] already"),
    "value and factor": (toleranced("value", "factor"), "sweep.tolerances[2].parameter",
                         "drawn by sweep.tolerances[1] already"),
    "factor and offset": (toleranced("factor", "offset", low=-8.0), "sweep.tolerances[2]",
                          "makes lash.backlash_deg -"),
    "drawn and swept": (drawn(sample("lash.contact.damping", "uniform", low=1.0, high=2.0)) + DAMPING_AXIS,
                        "sweep.samples[1].parameter", "is swept already"),
    "wrong torque": (drawn(sample("load.final_torque", "normal", std=1.0)), "sweep.samples[1].parameter",
                     "load.final_torque does not apply"),
    "nothing to be around": (drawn(sample("lash.contact.locking_speed", "normal", std=1.0)),
                             "sweep.samples[1].parameter", "needs a value in this config"),
    "negative inertia": (drawn(sample("driveline.inertias[4]", "normal", draws="factor", std=0.6)),
                         "sweep.samples[1]", "(low and high bound it): found -"),
    "samples and tolerances": (drawn(sample(STIFFNESS, "normal", std=1.0))
                               + f"[[sweep.tolerances]]\n{sample('lash.radius', 'normal', std=1e-4)}",
                               "sweep.samples", "give one of the two"),
    "no draws": (drawn(sample(STIFFNESS, "normal", std=1.0), sampling="count = 0"), "sweep.sampling.count",
                 "from 1 to 1000000"),
    "grid too large": (drawn(sample(STIFFNESS, "normal", std=1.0), sampling="count = 1000000")
                       + DAMPING_AXIS.replace("values = [50.0, 94.0]", "start = 1.0\nstop = 2.0\ncount = 10000"),
                       "sweep.axes", "10,000,000,000 cells"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_DESIGNS)
def test_wrong_design_is_reported_where_it_is_wrong(case):
    text, key, message = WRONG_DESIGNS[case]
    (found,) = errors_of(text).problems
    assert found.key == key
    assert message in found.message
    assert found.line is not None


def test_design_survives_the_round_trip_and_counts_in_the_digest():
    text = drawn(sample(STIFFNESS, "normal", draws="factor", std=0.1))
    study = study_from_text(text)
    assert study_from_text(to_toml(study)) == study
    assert digest(study_from_text(to_toml(study))) == digest(study)
    others = [["sweep.sampling.seed=1"], ["sweep.samples[1].std=0.2"], ["sweep.sampling.count=17"]]
    assert len({digest(study), *(digest(study_from_text(text, "x", each)) for each in others)}) == 4
    assert digest(study_from_text(ZIP)) != digest(study_from_text(ZIP.replace("zip", "grid")))


def columns(*tables: str, count: int = 1024, method: str = "sobol", seed: int = 0) -> list[np.ndarray]:
    sampling = f'count = {count}\nseed = {seed}\nmethod = "{method}"'
    return [axis.values for axis in design_of(study_from_text(drawn(*tables, sampling=sampling))).coordinates]


DISTRIBUTIONS = {
    "uniform": (sample(STIFFNESS, "uniform", low=3e5, high=5e5), stats.uniform(3e5, 2e5)),
    "normal": (sample(STIFFNESS, "normal", mean=4e5, std=2e4), stats.norm(4e5, 2e4)),
    "normal around the nominal value": (sample(STIFFNESS, "normal", std=2e4), stats.norm(4.092e5, 2e4)),
    "normal factor": (sample(STIFFNESS, "normal", draws="factor", std=0.05), stats.norm(4.092e5, 0.05 * 4.092e5)),
    "lognormal": (sample(STIFFNESS, "lognormal", median=4e5, sigma=0.2), stats.lognorm(0.2, scale=4e5)),
    "lognormal factor": (sample(STIFFNESS, "lognormal", draws="factor", sigma=0.2),
                         stats.lognorm(0.2, scale=4.092e5)),
    "triangular": (sample(STIFFNESS, "triangular", low=3e5, mode=3.5e5, high=5e5), stats.triang(0.25, 3e5, 2e5)),
    "triangular offset": (sample(STIFFNESS, "triangular", draws="offset", low=-1e4, mode=0.0, high=2e4),
                          stats.triang(1 / 3, 4.092e5 - 1e4, 3e4)),
    "truncated normal": (sample(STIFFNESS, "normal", mean=4e5, std=2e4, low=3.9e5, high=4.5e5),
                         stats.truncnorm(-0.5, 2.5, 4e5, 2e4)),
}  # fmt: skip


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube"])
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_drawn_values_have_their_distribution(name, method):
    """Each of n equal shares of the unit interval holds one point: the empirical distribution is off by 1/n at most."""
    table, distribution = DISTRIBUTIONS[name]
    (values,) = columns(table, method=method)
    assert stats.ks_1samp(values, distribution.cdf).statistic <= 1 / 1024 + 1e-9


def test_truncation_holds_in_the_far_tail():
    """Bounds that lie on one side of the mean, where rounding is coarse."""
    (values,) = columns(sample(STIFFNESS, "normal", mean=4e5, std=1e4, low=4.4e5, high=4.41e5))
    assert values.min() >= 4.4e5
    assert values.max() <= 4.41e5
    assert np.unique(values).size == values.size


DAMPER = 'name = "clutch damper"\nbetween = [1, 2]\nstiffness = 31.3\ndamping = 0.08\n'
NAMED_SHAFT = (
    f'[driveline]\npreset = "boere-2008"\ninertias = [0.024, 0.002, 0.002, 0.002]\n[[driveline.shafts]]\n{DAMPER}'
    "[[driveline.shafts]]\nbetween = [2, 3]\nstiffness = 30.0\ndamping = 0.1\n"
)


def test_keys_of_a_shaft_go_by_its_name():
    key = "driveline.shafts[clutch damper].stiffness"
    axis = f'[[sweep.axes]]\nparameter = "{key}"\nvalues = [20.0, 30.0]\n'
    study = study_from_text(NAMED_SHAFT + axis, overrides=["driveline.shafts[clutch damper].damping=0.2"])
    assert study.sweep.axes[0].parameter == "driveline.shafts[1].stiffness"
    assert study.driveline.shafts[0].damping == 0.2
    assert replace_values(study, {key: 25.0}).driveline.shafts[0].stiffness == 25.0
    with pytest.raises(ConfigError, match=r"no such place"):
        study_from_text(NAMED_SHAFT, overrides=["driveline.shafts[gear].damping=0.2"])


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["lash.contact.stiffness=0.4"], "press the flanks 2.34e+03 rad into each other"),
        (["lash.radius=80"], "lash.radius = 80 m; it is in meters"),
        (["load.duration=0.1"], 'a load of profile "step" has none; "ramp", "smooth" or "pulse" would use it'),
        (["load.profile=ramp", "load.duration=150"], "the load takes 150 s to change"),
        (["load.profile=lag", "load.time_constant=80"], "the load takes 80 s to change"),
        (["load.profile=table", "load.times=[0,10,50]", "load.torques=[5,5,1]"], "the load takes 50 s to change"),
        (["load.profile=table", "load.times=[0,1,3]", "load.torques=[5,6,1]"], "the load takes 3 s to change"),
    ],
)
def test_numbers_that_can_hardly_be_meant_are_warned_of(overrides, words):
    """A trace in ms, a radius in mm, a stiffness in N/µm: each is allowed, and has its sentence."""
    with pytest.warns(ClunkWarning) as warned:
        study_from_text('[driveline]\npreset = "boere-2008"\n', overrides=overrides)
    assert words in str(warned[0].message)


def test_inertias_without_springs_may_be_as_far_apart_as_those_with():
    """The limit of springs, which is narrower, is not theirs."""
    study_from_text(
        "[driveline]\ninertias = [0.02, 1e9]\n[lash]\nbetween = [1, 2]\nbacklash_deg = 6.0\nradius = 0.08\n"
        '[lash.contact]\nmodel = "restitution"\nrestitution = 0.5\n[load]\ninitial_torque = 6.0\nfinal_torque = 1.0\n'
    )
