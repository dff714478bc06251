"""Every benchmark runs, in its quick form: without a package to compare with, the rest of it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "benchmarks"
SCRIPTS = sorted(path for path in FOLDER.glob("*.py") if "__main__" in path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_benchmark_prints_its_table(script):
    if "import mpmath" in script.read_text(encoding="utf-8"):
        pytest.importorskip("mpmath", reason="the table of events is computed by mpmath, of the extra `bench`")
    done = subprocess.run(
        [sys.executable, str(script), "--quick"],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"\d", done.stdout)
    assert "nan" not in done.stdout.split()
    assert "DIFFERENT" not in done.stdout
    assert script.name in (FOLDER / "README.md").read_text(encoding="utf-8")
