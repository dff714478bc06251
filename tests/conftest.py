"""What every test may use."""

import gc
import os
import signal
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest
import tomli_w
from hypothesis import settings

from clunk.cli import main
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.study import Study
from clunk.sweeping.sweep import sweep

# The first call of a kernel compiles it, which takes longer than any deadline; the same examples on every machine.
settings.register_profile("clunk", deadline=None, derandomize=True)
settings.load_profile("clunk")
# Seldom: each time, Python goes through the thousands of tests that stay in memory.
gc.set_threshold(100_000)
# In the background of a shell it is ignored, by what tests start and interrupt too.
signal.signal(signal.SIGINT, signal.default_int_handler)

BOERE = '[driveline]\npreset = "boere-2008"\n'
EXACT = BOERE + '[solver]\nmethod = "exact"\n'
NOMINAL = '[driveline]\npreset = "boere-2008"\n[lash]\nbacklash_deg = 6.0\n[load]\nratio = 5.0\n'
SHAFT = "[[driveline.shafts]]\nbetween = {}\nstiffness = 31.3\ndamping = 0.04\n"
SPELLED_OUT = NOMINAL.replace("preset", "inertias = [0.024, 0.002, 0.002, 0.002]\npreset")
RUBBING = SPELLED_OUT + SHAFT.format([1, 2]) + SHAFT.format([2, 3]) + "friction = 0.3\n" + SHAFT.format('[4, "ground"]')


def axis(parameter, start, stop, count, more=""):
    """A table [[sweep.axes]]."""
    return f'[[sweep.axes]]\nparameter = "{parameter}"\nstart = {start}\nstop = {stop}\ncount = {count}\n{more}'


def values(parameter, numbers):
    """A table [[sweep.axes]] of these values."""
    return f'[[sweep.axes]]\nparameter = "{parameter}"\nvalues = {numbers}\n'


def drawn(table, parameter, distribution, **numbers):
    """A table [[sweep.samples]] or [[sweep.tolerances]]."""
    return f"[[sweep.{table}]]\n" + tomli_w.dumps({"parameter": parameter, "distribution": distribution, **numbers})


def pytest_configure(config: pytest.Config) -> None:
    """Before the workers start: compile the kernels that each would compile, and leave each one thread of BLAS.

    Whether all of them are compiled is known by using them: another checkout with the same core may have kernels too.
    Matrices are small, and threads of several workers that wait for each other take longer than all of their work.
    """
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        if any(argument.endswith(".py") or "::" in argument for argument in config.args):
            return  # of some files, each worker compiles what it needs
        with ProcessPoolExecutor(2, get_context("spawn")) as processes:
            list(processes.map(_compile, ("exact", "rk4")))


@pytest.hookimpl(tryfirst=True)
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Leave out the slow values of a parameter unless slow tests are asked for.

    There are 15,000 tests with them: each worker would take 3 s to make them, and then deselect them.
    """
    if metafunc.config.getoption("markexpr") == "not slow":
        parametrize = metafunc.parametrize

        def without_slow_values(names, values, **options):
            parametrize(names, [value for value in values if not _is_slow(value)], **options)

        metafunc.parametrize = without_slow_values


def _is_slow(value) -> bool:
    return any(mark.name == "slow" for mark in getattr(value, "marks", ()))


def _compile(method: str) -> None:
    """Use all kernels of a method."""
    for driveline in (NOMINAL, RUBBING):
        simulate(study_from_text(f'{driveline}[solver]\nmethod = "{method}"\n'))
        sweep(study_from_text(f'{driveline}[solver]\nmethod = "{method}"\n{axis("load.ratio", 0.0, 10.0, 121)}'))


@pytest.fixture(scope="session")
def nominal() -> Study:
    """The report's driveline at σr = 5, φθ = 6°: its Figures 3.1 and 3.2."""
    return study_from_text(NOMINAL)


@pytest.fixture(scope="session")
def as_printed() -> Study:
    """The same with J2, J3 and J4 as the report's Table 2.2 prints them, ten times too large."""
    return study_from_text('[driveline]\npreset = "boere-2008-as-printed"\n')


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty directory, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def command(here, monkeypatch, capsys):
    """A command of the program, run in this process by its words: exit code, stdout, stderr."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # main's handler must not outlive a test

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["clunk", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        return stopped.value.code, out, err

    return run
