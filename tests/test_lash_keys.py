"""Keys of several lashes: arrays of tables, names and numbers of them, and what is refused."""

import tomllib

import pytest

import clunk
from clunk.analysis.measurements import compare_experiment, read_experiment
from clunk.study.keys import json_schema
from clunk.study.parameters import nominal_value, parameters, quantity
from clunk.study.study import content, digest, to_toml

GEAR = """
name = "gear"
between = ["pinion", "ring"]
backlash_deg = 6.0
radius = 0.08
contact = {stiffness = 4e5, damping = 94.0}
"""
JOINT = """
between = [2, "ground"]
backlash_deg = 3.0
radius = 0.05
ratio = 2.0
contact = {stiffness = 3e5, damping = 50.0, separation = "force"}
"""
ONE = f'driveline.preset = "boere-2008"\n[[lash]]{GEAR}'
TWO = f"{ONE}[[lash]]{JOINT}"
SWEPT = '[[sweep.axes]]\nparameter = "{}"\nvalues = [1.0, 2.0]\n'


@pytest.fixture(scope="module")
def two():
    return clunk.study_from_text(TWO)


def test_an_array_of_one_lash_is_the_lash_itself():
    one, plain = (clunk.study_from_text(text) for text in (ONE, ONE.replace("[[lash]]", "[lash]")))
    assert one == plain
    assert (to_toml(one), digest(one)) == (to_toml(plain), digest(plain))
    named = clunk.study_from_text('driveline.preset = "boere-2008"', overrides=["lash[1].backlash_deg=3"])
    assert named.lashes[0].backlash_deg == 3.0


def test_an_array_replaces_the_lash_of_a_preset_and_the_inertia_that_goes_with_it(two):
    assert two.lash_names == ("gear", "lash 2")
    assert [lash.between for lash in two.lashes] == [(3, 4), (2, "ground")]
    car = f'driveline.preset = "car"\n[[lash]]{GEAR}[[lash]]{JOINT}'.replace('"pinion", "ring"', "2, 3")
    assert clunk.study_from_text(car).watched == (2, 2)
    assert clunk.study_from_text(car, overrides=["impacts.acceleration_of=5"]).watched == (5, 5)
    assert clunk.study_from_text('driveline.preset = "car"').watched == (3,)


def test_a_study_of_several_lashes_survives_its_own_text(two):
    again = clunk.study_from_text(to_toml(two))
    assert again == two
    assert digest(again) == digest(two)
    assert len(tomllib.loads(to_toml(two))["lash"]) == 2
    assert "gear" in str(two)
    assert "lash 2" in str(two)


def test_names_of_lashes_decide_nothing(two):
    assert digest(clunk.study_from_text(TWO.replace("gear", "mesh"))) == digest(two)
    assert digest(clunk.replace_values(two, {"lash[2].ratio": 3.0})) != digest(two)


def test_keys_of_a_lash_go_by_number_or_name(two):
    for key in ("lash[1].contact.stiffness", "lash[gear].contact.stiffness"):
        assert nominal_value(two, key) == 4e5
        assert clunk.replace_values(two, {key: 1e5}).lashes[0].contact.stiffness == 1e5
    known = quantity("lash[2].backlash_deg")
    assert (known.name, known.symbol, known.unit) == ("backlash of lash 2", "φθ2", "degrees")
    swept = clunk.study_from_text(TWO + SWEPT.format("lash[gear].backlash_deg"), overrides=["lash[lash 2].radius=0.06"])
    assert swept.sweep.axes[0].parameter == "lash[1].backlash_deg"
    assert swept.lashes[1].radius == 0.06


def test_every_key_of_every_lash_is_a_parameter(two):
    of_one = parameters(content(clunk.study_from_text(ONE)))
    lash = [key.removeprefix("lash.") for key in of_one if key.startswith("lash.")]
    expected = {f"lash[{number}].{key}" for number in (1, 2) for key in lash}
    assert {key for key in parameters(two.model_dump()) if key.startswith("lash")} == expected


def test_the_schema_allows_one_lash_and_several():
    one, several = json_schema()["properties"]["lash"]["oneOf"]
    assert several["items"] == one


@pytest.mark.parametrize(
    ("text", "overrides", "key", "message"),
    [
        (TWO, ["lash.backlash_deg=3"], "lash.backlash_deg", "no such place"),
        (TWO, ["lash[3].backlash_deg=3"], "lash[3].backlash_deg", "no such place"),
        (TWO, ["lash[rear].radius=3"], "lash[rear].radius", "no such place"),
        (TWO, ["lash[2].name='gear'"], "lash[2].name", 'the name "gear" is taken by lash 1'),
        (TWO, ["lash[1].name='lash 2'"], "lash[2].name", 'the name "lash 2" is taken by lash 1'),
        (TWO, ["lash[1].name='2'"], "lash[1].name", "must not be empty, a number"),
        (TWO, ["lash[1].name=''"], "lash[1].name", "must not be empty, a number"),
        (TWO, ["lash[2].contact.model='restitution'"], "lash[2].contact.model", "have one contact model"),
        (TWO, ["lash[2].radious=1"], "lash[2].radious", 'did you mean "radius"?'),
        (TWO, ["lash[2].between=[2, 9]"], "lash[2].between[2]", "there is no inertia 9"),
        (TWO.replace("radius = 0.05\n", ""), [], "lash[2].radius", "missing; must be a number greater than 0"),
        (TWO + SWEPT.format("lash.radius"), [], "sweep.axes[1].parameter", 'did you mean "lash[2].radius"?'),
        (TWO + SWEPT.format("lash[rear].radius"), [], "sweep.axes[1].parameter", 'did you mean "lash[2].radius"?'),
        (TWO + SWEPT.format("lash[3].radius"), [], "sweep.axes[1].parameter", 'no number "lash[3].radius"'),
        (
            TWO.replace("backlash_deg = 3.0", "gap_mm = 3.0") + SWEPT.format("lash[2].radius"),
            [],
            "sweep.axes[1].parameter",
            "changes the angle of its gap_mm; give its backlash_deg",
        ),
        ("lash = []\ndriveline.preset = 'car'", [], "lash", "a table, or an array of tables, [[lash]]"),
    ],
)
def test_what_names_no_lash_or_is_no_lash_is_one_sentence(text, overrides, key, message):
    with pytest.raises(clunk.ConfigError) as caught:
        clunk.study_from_text(text, overrides=overrides)
    assert [problem.key for problem in caught.value.problems] == [key]
    assert message in caught.value.problems[0].message
    assert "preset" not in str(caught.value)


def test_a_missing_key_of_an_only_lash_is_not_said_to_be_the_presets():
    with pytest.raises(clunk.ConfigError) as caught:
        clunk.study_from_text(ONE.replace("radius = 0.08\n", ""))
    assert "preset" not in str(caught.value)


def test_a_name_stands_for_the_number_wherever_a_key_does(command, here):
    """On axes, in --at, --along, --facet and --overlay, in the columns of measurements, and from Python."""
    gaps, stiffnesses = SWEPT.format("lash[gear].backlash_deg"), SWEPT.format("driveline.shafts[clutch].stiffness")
    shaft = '[[driveline.shafts]]\nname = "clutch"\nbetween = [1, 2]\nstiffness = 31.3\ndamping = 0.08\n'
    joined = "[[driveline.shafts]]\nbetween = [2, 3]\nstiffness = 31.3\ndamping = 0.04\n"
    held = '[[driveline.shafts]]\nbetween = [4, "ground"]\nstiffness = 31.3\ndamping = 0.1\n'
    text = f"{TWO}{shaft}{joined}{held}[solver]\nmethod = 'exact'\n{gaps}{stiffnesses}"
    (here / "two.toml").write_text(text, encoding="utf-8")
    results = clunk.sweep(clunk.study_from_text(text), "two.h5", boundaries=False)
    by_name = {"lash[gear].backlash_deg": 2.0, "driveline.shafts[clutch].stiffness": 1.0}
    by_number = {"lash[1].backlash_deg": 2.0, "driveline.shafts[1].stiffness": 1.0}
    assert results.at(by_name).arrays.keys() == results.at(by_number).arrays.keys()
    assert results.of_lash("gear").cell(by_name).keys() == results.of_lash("gear").cell(by_number).keys()
    at = [word for key, value in by_name.items() for word in ("--at", f"{key}={value}")]
    (here / "measured.csv").write_text(",".join([*by_name, "label"]) + "\n2.0,1.0,NI\n", encoding="utf-8")
    for words in (
        ("simulate", "two.toml", *at),
        ("simulate", "two.h5", *at),
        ("thresholds", "two.toml", "--along", "lash[gear].backlash_deg", *at[2:]),
        ("plot", "two.h5", "--lash", "gear", *at[:2], "-o", "map.svg"),
        ("compare", "two.h5", "measured.csv"),
        ("report", "two.h5", *at[:2], "-o", "page.html"),
    ):
        code, _, errors = command(*words)
        assert code == 0, f"{words}\n{errors}"


@pytest.mark.parametrize("name", ["gear 2.1", "i = 3.9", "Zahnräder"])
def test_a_name_may_have_any_signs_but_brackets(command, here, name):
    """Also dots, which stand between the steps of a key, and the sign behind which its value stands."""
    key = f"lash[{name}]"
    text = TWO.replace('"gear"', f'"{name}"') + '[solver]\nmethod = "exact"\n' + SWEPT.format(f"{key}.backlash_deg")
    (here / "two.toml").write_text(text, encoding="utf-8")
    assert clunk.study_from_text(text, overrides=[f"{key}.radius=0.06"]).lashes[0].radius == 0.06
    at, overlay = ("--at", f"{key}.backlash_deg=2"), ("--overlay", f"{key}.radius=0.05,0.06", "-o", "run.svg")
    for words in (at, (*at, *overlay)):
        code, _, errors = command("simulate", "two.toml", *words)
        assert code == 0, errors


def test_the_only_lash_may_be_numbered_in_the_columns_of_measurements(here):
    study = clunk.study_from_text(ONE + SWEPT.format("lash.backlash_deg"))
    (here / "measured.csv").write_text("lash[1].backlash_deg,label\n2.0,DS(1)SS(1)\n", encoding="utf-8")
    compared = compare_experiment(clunk.sweep(study), read_experiment("measured.csv"))
    assert compared.points[0].at == {"lash.backlash_deg": 2.0}
