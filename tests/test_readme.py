"""Every clunk command and the Python example of the README run as printed, from a copy of what they need."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    directory = tmp_path_factory.mktemp("readme")
    shutil.copytree(ROOT / "configs", directory / "configs")
    return directory


def commands():
    for language, block in BLOCKS:
        if language == "sh":
            for line in block.replace("\\\n", " ").splitlines():
                command = line.split("#")[0].strip()
                if command.startswith("clunk "):
                    yield command


def test_the_readme_s_commands_run(here):
    found = list(commands())
    assert len(found) >= 8
    for command in found:
        run = [sys.executable, "-c", "from clunk.cli import main; main()", *command.split()[1:]]
        done = subprocess.run(run, cwd=here, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}\n{done.stderr}"


def test_the_readme_s_python_runs(here):
    (example,) = [block for language, block in BLOCKS if language == "python"]
    done = subprocess.run([sys.executable, "-c", example], cwd=here, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "DS(1)SS(1) 9300 O I I" in done.stdout
