"""Every clunk command and Python example of the README runs as printed, from a copy of what they need."""

import doctest
import io
import re
import shlex
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
        run = [sys.executable, "-c", "from clunk.cli import main; main()", *shlex.split(command)[1:]]
        done = subprocess.run(run, cwd=here, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}\n{done.stderr}"


def test_the_readme_s_python_says_what_is_printed(here, monkeypatch):
    monkeypatch.chdir(here)
    blocks = [block for language, block in BLOCKS if language == "python"]
    assert blocks
    examples = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, "README.md", "README.md", 0)
    report = io.StringIO()
    failed, tried = doctest.DocTestRunner(verbose=False).run(examples, out=report.write)
    assert tried >= 10
    assert not failed, report.getvalue()
