"""A damaged cache of compiled kernels, and another numba than the usual, cost a compilation, and nothing else."""

import importlib.util
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

from clunk.core import jit  # points numba at its cache, which tests then move
from clunk.sweeping.machine import remove_old_kernels

ROOT = Path(__file__).parent.parent


def files(directory, suffix):
    found = sorted(directory.rglob(f"*{suffix}"))
    assert found
    return found


def truncate(directory):
    """Every file ends in its middle, as after a crash or on a full disk."""
    for path in files(directory, ".nbi") + files(directory, ".nbc"):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def fill_with_garbage(directory):
    for path in files(directory, ".nbi") + files(directory, ".nbc"):
        path.write_bytes(bytes(range(256)) * 40)


def lose_machine_code(directory):
    for path in files(directory, ".nbc"):
        path.unlink()


DAMAGES = [truncate, fill_with_garbage, lose_machine_code]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_kernel_whose_cache_is_damaged_is_compiled_anew(tmp_path, monkeypatch, damage):
    """One small kernel, loaded three times as by three processes: compiled, compiled anew, and taken from the cache."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "kernel.py").write_text(
        "from clunk.core.jit import compiled\n@compiled\ndef double(x):\n    return 2.0 * x\n"
    )

    def load():
        spec = importlib.util.spec_from_file_location("kernel", tmp_path / "kernel.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.double

    first = load()
    assert first(1.5) == 3.0
    damage(tmp_path / "cache")
    again, last = load(), load()
    assert again(1.5) == 3.0
    assert sum(again.stats.cache_hits.values()) == 0
    assert last(1.5) == 3.0
    assert sum(last.stats.cache_hits.values()) == 1


def test_every_installation_has_kernels_of_its_own(tmp_path, monkeypatch):
    """So that one whose kernels are yet to be compiled says so, though those of the same code elsewhere are there."""
    here = jit._digest()
    shutil.copytree(ROOT / "clunk/core", tmp_path / "core")
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "core/jit.py"))
    assert jit._digest() != here


def test_kernels_that_nothing_has_used_for_long_are_removed(tmp_path, monkeypatch):
    """Those of other sources, after a month; neither those of late nor anything else."""
    cache = tmp_path / "clunk"
    for name, days in (("kernels-old", 31), ("kernels-late", 29), ("results", 400)):
        (cache / name).mkdir(parents=True)
        os.utime(cache / name, (time.time() - days * 86400,) * 2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    jit._configure()
    remove_old_kernels()
    own = Path(numba.config.CACHE_DIR)
    assert {path.name for path in cache.iterdir()} == {"kernels-late", "results", own.name}
    os.utime(own, (0, 0))
    jit._configure()
    assert own.stat().st_mtime > time.time() - 60


HIDING = """
import numba.core.codegen
del numba.core.codegen.JITCodeLibrary
from clunk.core import jit
assert jit.partial is None
"""
ONE_PART = """
from clunk.core.jit import compiled, inlined_part, part
from clunk.core.references import refer
import typing, numpy
class Pair(typing.NamedTuple):
    ends: numpy.ndarray
    share: float
@part
def twice(x):
    return x + x
@inlined_part
def between(pair):
    return pair.ends[0] + pair.share * (pair.ends[1] - twice(pair.ends[0]))
@compiled
def calculate(pair):
    return between(refer(pair))
print(calculate(Pair(numpy.array([0.1, 0.7]), 1.0 / 3.0)).hex())
"""
RUN = f"""
import sys
from clunk.cli import main
sys.argv[1:] = ["simulate", {str(ROOT / "configs/nominal.toml")!r}]
main()
"""


def printed_by(program, tmp_path, **environment):
    """What a program prints in a process of its own, with another cache."""
    (tmp_path / "program.py").write_text(program)
    kept = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    command = [sys.executable, str(tmp_path / "program.py")]
    done = subprocess.run(command, env=kept | environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "program", [pytest.param(ONE_PART, id="part"), pytest.param(RUN, id="run", marks=pytest.mark.slow)]
)
def test_without_the_inner_parts_of_numba_the_bits_are_the_same(tmp_path, program):
    """Where numba has others than those that `partial` reaches for, its documented interface alone will do."""
    whole, hidden = (printed_by(each + program, tmp_path, XDG_CACHE_HOME=str(tmp_path)) for each in ("", HIDING))
    assert whole == hidden != ""


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_a_cache_that_takes_no_files_is_done_without(tmp_path, variable):
    (tmp_path / "cache").write_text("not a directory")
    assert printed_by(ONE_PART, tmp_path, **{variable: str(tmp_path / "cache")})
    assert (tmp_path / "cache").read_text() == "not a directory"


@pytest.mark.skipif(jit.partial is None, reason="numba's own cache prepares for compiling first")
def test_kernels_that_are_kept_run_without_what_compiles_them():
    """Importing how numba compiles the functions of arrays, and with it scipy's linear algebra, takes half a second."""
    script = """
import sys
from clunk import load_study, sweep
for method in ("rk4", "exact"):
    sweep(load_study("configs/smoke.toml", [f'solver.method = "{method}"', "solver.end_time = 0.1"]), boundaries=False)
print(sorted({"numba.np.arraymath", "scipy.linalg"} & set(sys.modules)))
"""
    for _ in range(2):  # of which the first may compile
        done = subprocess.run(
            [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=600, check=True
        )
    assert done.stdout == "[]\n"
