"""Whatever stands in a config, the command line answers: with a run, or with exit code 2 and what is wrong where.

    pytest -m slow tests/test_fuzz.py

The short form is part of every test run; the long one tries 1,000 configs.
"""

import contextlib
import io
import re
import signal
import sys

import pytest
from hypothesis import HealthCheck, event, given, settings, strategies as st
from test_config import ONE_RUN, PRESET, STARTER, WHOLE

from clunk.cli import main
from clunk.core.status import Status
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ConfigError
from clunk.study.study import to_toml

# Sizes at the edge of double precision may overflow on the way to the answer; it is the answer that counts.
pytestmark = pytest.mark.filterwarnings("ignore:(overflow|invalid|divide)")

MOST_STEPS = 1e6  # of a run that is tried: 20 ms
VALUES = [
    *("nan", "-nan", "inf", "-inf", "0", "-0.0", "-1", "1e308", "-1e308", "1.8e308", "1e-308", "5e-324", "1e16"),
    *("1e5", "1e-9", str(10**400), "0x" + "f" * 5000, str(2**63), "-1e-300", "1e150", "1e-160", "3.5", "2", "1_000"),
    *('""', '"x"', '"σr"', r'"\u0000"', '"' + "y" * 300 + '"', "'''\na\n'''", "true", "1979-05-27", "07:32:00"),
    *("[]", "[[]]", "[1, 2, 3]", '["a", 1, []]', "{}", "{a = 1}", "[{}]", "[1, 4]", "[4, 'ground']", "[2, 1]"),
    *('"ground"', '"rk4"', '"exact"', '"log"', '"load.ratio"', '"driveline.inertias[4]"', '"force"', '"restitution"'),
    *("[1e300, 1e-300, 1, 1]", "[0.024, nan, 0.002, 0.002]", "[0.024, 0.002]", "[" * 60 + "]" * 60),
]
BREAKING = [
    *("9" * 5000, r'"\ud800"', "null", "False", "01", "[" * 4000 + "]" * 4000, "", "=", "#", "σ", "\t", "1 2", '"'),
]
DEEP = ["a." * 3000 + "a = 1", "[" + "a." * 3000 + "a]", "{a = " * 500 + "1" + "}" * 500, "[[a]]\n" * 500]
_LINE = re.compile(r"^([\w.\[\]]+ *= *)(.*)$")

WRITES = {
    "value": st.sampled_from(VALUES),
    "broken": st.sampled_from(BREAKING) | st.text(max_size=8),
    "number": (st.floats() | st.integers() | st.floats(-9.0, 9.0).map(lambda digits: 10.0**digits)).map(str),
}


@st.composite
def texts(draw):
    """A valid config after a few accidents."""
    lines = draw(st.sampled_from([WHOLE, ONE_RUN, PRESET + "[load]\nratio = 5.0\n", STARTER])).splitlines()
    accidents = st.sampled_from(["value"] * 6 + ["number"] * 6 + ["broken", "typo", "line"])
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 3, 4]))):
        k = draw(st.integers(0, len(lines) - 1))
        here, accident = lines[k], draw(accidents)
        if accident in WRITES:
            assignments = [number for number, line in enumerate(lines) if _LINE.match(line)]
            if assignments:
                k = draw(st.sampled_from(assignments))
                lines[k] = _LINE.match(lines[k])[1] + draw(WRITES[accident])
        elif accident == "typo" and here:
            at = draw(st.integers(0, len(here) - 1))
            typo = draw(st.sampled_from(["", here[at] * 2, "x", "é", "\u202e", "]", '"', ".", " "]))
            lines[k] = here[:at] + typo + here[at + 1 :]
        else:
            other = draw(st.integers(0, len(lines) - 1))
            changed = draw(st.sampled_from(["drop", "twice", "swap", "insert", "cut"]))
            if changed == "drop" and len(lines) > 1:
                del lines[k]
            elif changed == "twice":
                lines.insert(other, here)
            elif changed == "swap":
                lines[k], lines[other] = lines[other], lines[k]
            elif changed == "insert":
                lines.insert(k, draw(st.sampled_from([*DEEP, "[foo]", "[[lash]]", "[sweep]", "x = 1", "\x00", "\r"])))
            else:
                lines = lines[: k + 1]
                lines[k] = here[: len(here) // 2]
    return draw(st.sampled_from(["\n"] * 6 + ["\r\n", "\r"])).join(lines) + "\n"


junk = st.binary(max_size=200) | st.text(max_size=100).map(lambda text: text.encode("utf-8", "surrogatepass"))
mark = st.sampled_from([b""] * 3 + [b"\xef\xbb\xbf"])  # of the byte order
accidental = st.tuples(mark, texts().map(lambda text: text.encode("utf-8", "replace")))
files = st.sampled_from([accidental] * 8 + [st.tuples(junk), st.tuples(st.just(WHOLE[:300].encode()), junk)])
files = files.flatmap(lambda parts: parts).map(b"".join)


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Run a command on a config of these bytes: exit code, stdout, stderr."""
    path = tmp_path_factory.mktemp("fuzz") / "fuzzed.toml"

    def run(name, content):
        path.write_bytes(content)
        out, err = io.StringIO(), io.StringIO()
        argv, handler = sys.argv, signal.getsignal(signal.SIGTERM)
        sys.argv = ["clunk", name, str(path)]
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                main()
        except SystemExit as stopped:
            code = stopped.code
        finally:
            sys.argv = argv
            signal.signal(signal.SIGTERM, handler)
        return code, out.getvalue(), err.getvalue()

    run.path = path
    path.write_text(ONE_RUN)
    simulate(load_study(path))  # compiles, if it has to
    return run


def is_small(path):
    """Whether a run of this config is over soon; also where it is none, which the command has to find out."""
    try:
        study = load_study(path)
    except ConfigError:
        return True
    return study.solver.end_time / study.solver.step <= MOST_STEPS and len(study.driveline.inertias) < 20


def says_what_is_wrong(err):
    """Names the key and its line, or the file and what in it is no config, or why such a driveline cannot be run."""
    text = " ".join(err.split())
    sentences = [" ".join(status.sentence.split()).lower() for status in Status]
    if any(sentence and sentence in text.lower() for sentence in sentences):
        return "a run that cannot be"
    if "fuzzed.toml" not in text:
        return None
    if re.search(r"^  (line \d+, )?\S.*: ", err, re.MULTILINE):
        return "keys"
    if re.search(r"not valid TOML: .*(line \d+|end of document)|is not UTF-8 text: .* line \d+", text):
        return "syntax"
    if re.search(r"nested too deeply|integer of thousands of digits|is an HDF5 file", text):
        return "no config"
    return None


def hold_to_the_contract(command, content):
    """What came of each command."""
    came_of_it = []
    for name in ("modes", "simulate"):
        command.path.write_bytes(content)
        if name == "simulate" and not is_small(command.path):
            continue
        code, out, err = command(name, content)
        assert code in (0, 2), err
        assert "Traceback" not in err
        if code == 2:
            assert out == ""
            kind = says_what_is_wrong(err)
            assert kind, err
            came_of_it.append(f"{name}: {kind}")
        else:
            assert out
            study = load_study(command.path)
            assert study_from_text(to_toml(study)) == study
            came_of_it.append(f"{name}: done")
    return came_of_it


HARD = [b"", b"\x00", b"\xff\xfe", b"\x89HDF\r\n\x1a\n", b"[" * 100_000, b"a=" + b"[" * 100_000, b"=" * 1000]


@pytest.mark.parametrize("content", HARD, ids=range(len(HARD)))
def test_junk_is_answered(command, content):
    hold_to_the_contract(command, content)


@settings(max_examples=100, suppress_health_check=list(HealthCheck))
@given(content=files)
def test_a_hundred_accidents_are_answered(command, content):
    hold_to_the_contract(command, content)


@pytest.mark.slow
@settings(max_examples=1000, suppress_health_check=list(HealthCheck))
@given(content=files)
def test_a_thousand_accidents_are_answered(command, content):
    for outcome in hold_to_the_contract(command, content):
        event(outcome)
