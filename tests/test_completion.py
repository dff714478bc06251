"""Shells complete commands, and keys from the file that the line names."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
from click.shell_completion import BashComplete
from test_cli import HEAVY, SMALL
from test_store import BACKLASH, RATIO, example

from clunk.cli import cli
from clunk.results import store
from clunk.study.config import study_from_text
from clunk.study.errors import ConfigError


def completed(line):
    """Candidates for the last word of a line."""
    words = line.split(" ")
    return [item.value for item in BashComplete(cli, {}, "clunk", "").get_completions(words[1:-1], words[-1])]


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "broken.toml").write_text("[driveline\n")
    store.write_results(tmp_path / "map.h5", replace(example(RATIO, BACKLASH), config=SMALL))
    (tmp_path / "map.svg").touch()


@pytest.mark.parametrize(
    ("line", "candidates"),
    [
        ("clunk th", ["thresholds"]),
        ("clunk sweep small.toml --rest", ["--restart"]),
        ("clunk sweep small.toml --set solver.e", ["solver.end_time="]),
        ("clunk sweep --workers 2 small.toml --set load.scale=2 --set solver.me", ["solver.method="]),
        ("clunk modes small.toml --set driveline.shafts[4].da", ["driveline.shafts[4].damping="]),
        ("clunk modes small.toml --set driveline.shafts[5]", []),
        ("clunk sweep small.toml --set sweep.axes[2].co", ["sweep.axes[2].count="]),
        ("clunk sweep small.toml --set load.ratio", []),  # which an axis sweeps
        ("clunk simulate small.toml --overlay lash.contact.mo", ["lash.contact.model="]),
        ("clunk thresholds small.toml --along l", ["load.ratio", "lash.backlash_deg"]),
        ("clunk sensitivity small.toml --at lo", ["load.ratio="]),
        ("clunk simulate map.h5 --at la", ["lash.backlash_deg="]),
        ("clunk plot map.h5 -o map.svg --facet lo", ["load.ratio"]),
        ("clunk sweep broken.toml --set lo", []),
        ("clunk thresholds broken.toml --along lo", []),
        ("clunk plot map.svg --at lo", []),
        ("clunk sweep nowhere.toml --set lo", []),
        ("clunk sweep --set lo", []),
    ],
)
def test_a_line_is_completed_from_its_file(files, line, candidates):
    assert completed(line) == candidates


def test_all_keys_that_are_offered_can_be_set(files):
    """The config has each, and knows what its value must be."""
    keys = completed("clunk modes small.toml --set ")
    assert len(keys) > 60
    for key in keys:
        known = "found a table|there is no inertia a table|sweep.axes"
        with pytest.raises(ConfigError, match=f"--set {re.escape(key.removesuffix('='))}: ({known})"):
            study_from_text(SMALL, overrides=[f"{key}{{}}"])


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell_asks_clunk(command, shell):
    code, script, _ = command("completion", shell)
    assert code == 0
    assert f"_CLUNK_COMPLETE={shell}_complete" in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_a_key_and_imports_no_kernels(files, tmp_path, command):
    program = tmp_path / "clunk"
    program.write_text(
        f"#!{sys.executable}\nimport atexit, sys\nfrom clunk.cli import main\n"
        f"atexit.register(lambda: print('plain', sorted({HEAVY} & set(sys.modules)), sep=','))\nmain()\n"
    )
    program.chmod(0o755)
    (tmp_path / "completion").write_text(command("completion", "bash")[1])
    line = "COMP_WORDS=(clunk sweep small.toml --set solver.e); COMP_CWORD=4"
    ask = f'compopt() {{ echo "$@"; }}; . ./completion; {line}; _clunk_completion clunk; echo "${{COMPREPLY[@]}}"'
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        [shutil.which("bash"), "-c", ask], env=environment, capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.splitlines() == ["solver.end_time= ['numpy', 'pydantic']"]
