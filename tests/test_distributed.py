"""Sweeps on the workers of a dask scheduler: the same bits, whoever dies meanwhile."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_parts import CONFIG, posix, resumed, stopped
from test_sweeping import digest_of, equal, figure_3_4, study

from clunk.study.config import load_study
from clunk.study.study import replace_values
from clunk.sweeping import distributed
from clunk.sweeping.distributed import Cluster
from clunk.sweeping.engines import EngineError
from clunk.sweeping.parts import WorkingDirectory
from clunk.sweeping.sweep import Job, sweep

ROOT = Path(__file__).parent.parent

# Sockets that dask leaves to be collected as unclosed when a peer was killed.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


class ByHand:
    """`dask scheduler`, and workers that are told one by one to join it."""

    def __init__(self, directory):
        self._directory = directory
        self._processes = []
        self._errors = (directory / "errors").open("w")
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0")
        file = directory / "scheduler.json"
        while not file.exists() or not file.read_text():
            assert self.scheduler.poll() is None
            time.sleep(0.02)
        self.address = json.loads(file.read_text())["address"]

    def worker(self, preload=None, nanny=False, **environment):
        """A worker with one thread; it is there when this returns."""
        before = len(self.workers())
        options = ["--nthreads", "1", "--local-directory", str(self._directory), "--memory-limit", "0"]
        options += [] if nanny else ["--no-nanny"]
        process = self._start("worker", *options, *(["--preload", preload] if preload else []), **environment)
        while len(self.workers()) == before:
            assert process.poll() is None
            time.sleep(0.05)
        return process

    def workers(self):
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            return client.nthreads()

    def end(self):
        for process in self._processes:
            process.kill()
            process.wait()
        self._errors.close()

    def _start(self, kind, *options, **environment):
        file = str(self._directory / "scheduler.json")
        command = [sys.executable, "-m", "dask", kind, *options, "--scheduler-file", file, "--no-dashboard"]
        output = {"stdout": self._errors, "stderr": self._errors, "env": {**os.environ, **environment}}
        # elsewhere, "-m" would take clunk from here if it is here, and compile it anew
        self._processes.append(subprocess.Popen(command, cwd=self._directory, **output))
        return self._processes[-1]


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory):
    by_hand = ByHand(tmp_path_factory.mktemp("dask"))
    by_hand.worker()
    by_hand.worker()
    yield by_hand
    by_hand.end()


@pytest.fixture
def alone(tmp_path):
    """A scheduler that a test may spoil."""
    by_hand = ByHand(tmp_path)
    yield by_hand
    by_hand.end()


@pytest.fixture(scope="module")
def map_17():
    return figure_3_4(17, step=2e-4)


@pytest.fixture(scope="module")
def whole(map_17):
    return sweep(map_17)


def clunk(directory, *arguments, before="pass"):
    """The command itself, in a process group of its own."""
    (directory / "map.toml").write_text(CONFIG)
    code = f"import sys; {before}; sys.argv[0] = 'clunk'; from clunk.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, "sweep", "map.toml", "-o", "map.h5", *arguments],
        cwd=directory,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@pytest.fixture
def swept(command, here):
    """Sweep in this process with such options: exit code, stdout, stderr."""
    (here / "map.toml").write_text(CONFIG)
    return lambda *options: command("sweep", "map.toml", "-o", "map.h5", *options)


def words(text):
    return " ".join(text.split())


class TestTheSameBits:
    def test_as_by_threads(self, two_workers, map_17, whole):
        with Cluster(two_workers.address) as engine:
            assert equal(Job(map_17).run(engine), whole)

    @pytest.mark.parametrize("method", ["rk4", "exact"])
    def test_where_each_cell_has_its_own_system(self, two_workers, method):
        own = study(("driveline.inertias[1]", np.linspace(0.01, 0.05, 12)), ("load.ratio", [2.0, 5.0, 9.0]))
        own = own.model_copy(update={"solver": own.solver.model_copy(update={"method": method})})
        with Cluster(two_workers.address) as engine:
            assert equal(Job(own).run(engine), sweep(own))

    def test_of_a_tolerance_map(self, two_workers):
        toleranced = load_study(
            ROOT / "configs/tolerance.toml",
            ["sweep.sampling.count=5", "sweep.axes[1].count=6", "sweep.axes[2].count=4"],
        )
        here = Job(toleranced).run()
        with Cluster(two_workers.address) as engine:
            there = Job(toleranced).run(engine)
        for name in ("runs", "nominal_sequence", "severity_mean", "severity_quantiles", "status"):
            assert getattr(here, name).tobytes() == getattr(there, name).tobytes()

    def test_by_a_local_cluster_of_the_command_which_leaves_nothing_behind(self, tmp_path, swept):
        local = clunk(tmp_path, "--scheduler", "local", "--workers", "2")
        out, err = local.communicate(timeout=120)
        assert local.returncode == 0, err
        assert all("cells" in line or line == "-> map.h5" for line in err.splitlines()), err
        assert sorted(path.name for path in tmp_path.iterdir()) == ["map.h5", "map.toml"]
        digest = digest_of(tmp_path / "map.h5")
        assert swept("--force")[:2] == (0, out)
        assert digest_of(tmp_path / "map.h5") == digest

    @posix
    def test_when_a_worker_is_killed_and_another_joins(self, two_workers, map_17, whole):
        third = two_workers.worker()

        def progress(done, _total):
            if done >= 100 and third.poll() is None:
                third.kill()
                third.wait()
                two_workers.worker()

        with Cluster(two_workers.address) as engine:
            assert equal(Job(map_17).run(engine, progress=progress), whole)
        assert third.returncode == -signal.SIGKILL


class TestWhatIsRefused:
    def test_no_scheduler(self, tmp_path, swept):
        code, out, err = swept("--scheduler", "tcp://127.0.0.1:9")
        assert code == 2
        assert "No scheduler answers at tcp://127.0.0.1:9" in words(err)
        assert "Traceback" not in err
        assert out == ""
        assert [path.name for path in tmp_path.iterdir()] == ["map.toml"]

    @pytest.mark.parametrize(
        ("arguments", "sentence"),
        [
            (["--scheduler", "somewhere"], "an address such as tcp://host:8786, or local, not 'somewhere'"),
            (["--scheduler", "tcp://127.0.0.1:9", "--workers", "2"], "for a local scheduler; this one has its own"),
        ],
    )
    def test_options_that_make_no_sense(self, swept, arguments, sentence):
        code, _, err = swept(*arguments)
        assert code == 2
        assert sentence in words(err)

    def test_without_dask(self, swept, monkeypatch):
        monkeypatch.delitem(sys.modules, distributed.__name__)
        monkeypatch.setitem(sys.modules, "dask", None)
        code, _, err = swept("--scheduler", "local")
        assert code == 2
        assert "pip install 'clunk[dask]'" in words(err)
        assert "Traceback" not in err

    def test_a_worker_of_other_versions(self, two_workers, map_17, monkeypatch):
        here = {**distributed.versions(), "numba": "0.1"}
        monkeypatch.setattr(distributed, "versions", lambda: here)
        another = r"Worker tcp://.* has another numba: 0\.[0-9.]* there, 0\.1 here"
        with Cluster(two_workers.address) as engine, pytest.raises(EngineError, match=another):
            Job(map_17).run(engine)

    def test_a_worker_without_clunk(self, alone, map_17):
        alone.worker(preload="import sys; sys.modules['clunk'] = None")
        with (
            Cluster(alone.address) as engine,
            pytest.raises(EngineError, match=r"could not run its cells .*the same installation as here"),
        ):
            Job(map_17).run(engine)


class TestAnEndBeforeTheEnd:
    def test_without_a_worker_it_waits_and_says_so_and_one_that_rounds_otherwise_makes_no_difference(
        self, alone, monkeypatch
    ):
        """All cells share a system; OpenBLAS as on an older processor gives other last bits to its eigenvectors."""
        shared = figure_3_4(17)
        shared = shared.model_copy(update={"solver": shared.solver.model_copy(update={"method": "exact"})})

        class Told(io.StringIO):
            def write(self, text):
                if not self.getvalue():
                    alone.worker(OPENBLAS_CORETYPE="Prescott")
                return super().write(text)

        monkeypatch.setattr("sys.stderr", told := Told())
        with Cluster(alone.address) as engine:
            assert equal(Job(shared).run(engine), sweep(shared))
        assert told.getvalue() == f"waiting for a worker of {alone.address} …\n"

    @posix
    def test_a_lost_scheduler_leaves_what_is_done(self, alone, map_17, tmp_path):
        """Of short steps, so that the cells behind the first take far longer than the end of the scheduler."""
        alone.worker()
        study = replace_values(map_17, {"solver.step": 5e-6})
        kept = lost(alone, study, tmp_path / "map.h5")
        assert kept >= 100
        results, parts = resumed(study, tmp_path / "map.h5")
        assert parts.taken_up == kept
        assert equal(results, sweep(study))

    def test_stopped_it_goes_on_by_threads_and_the_other_way_round(self, two_workers, map_17, whole, tmp_path):
        with Cluster(two_workers.address) as engine:
            first = stopped(map_17, tmp_path / "map.h5", 60, engine=engine)
            second = stopped(map_17, tmp_path / "map.h5", 150)
            results, parts = resumed(map_17, tmp_path / "map.h5", engine=engine)
        assert 60 <= first < second == parts.taken_up
        assert equal(results, whole)

    @posix
    @pytest.mark.slow
    def test_cells_that_kill_every_worker_end_in_a_sentence(self, alone, map_17):
        for _ in range(2):
            alone.worker(
                preload="import clunk.sweeping.distributed as there, os; there._run = lambda *_: os._exit(1)",
                nanny=True,
            )
        with Cluster(alone.address) as engine, pytest.raises(EngineError, match="run by 4 workers that died"):
            Job(map_17).run(engine)

    @posix
    @pytest.mark.slow
    @pytest.mark.parametrize("scheduler", ["local", "by hand"])
    def test_ctrl_c_on_the_command_keeps_what_is_done_and_nothing_else(self, alone, tmp_path, scheduler):
        """It goes to the whole process group, as from a terminal."""
        directory = tmp_path / "here"
        directory.mkdir()
        if scheduler == "by hand":
            alone.worker()
            scheduler = alone.address
        often = "from clunk.sweeping import parts; parts._PART = parts._SHARE = 0.0"
        slow = ["--set", "solver.step=1e-6", "--scheduler", scheduler]
        process = clunk(directory, *slow, before=often)
        while not (directory / "map.h5.partial" / "part-000001").exists():
            assert process.poll() is None
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=30)
        assert process.returncode == 130, err
        assert "the same command goes on from there" in words(err)
        assert err.splitlines()[-1] == "interrupted"
        assert "distributed" not in err
        assert "Traceback" not in err
        assert sorted(path.name for path in directory.iterdir()) == ["map.h5.partial", "map.toml"]


def lost(by_hand, study, target):
    """Sweep until its scheduler is killed, after 100 cells; how many are kept."""

    def progress(done, _total):
        if done >= 100:
            by_hand.scheduler.kill()

    with WorkingDirectory(target) as directory, Cluster(by_hand.address) as engine:
        job = Job(study, directory=directory)
        with pytest.raises(EngineError, match=f"The scheduler at {by_hand.address} was lost"):
            job.run(engine, progress=progress)
        return job.parts.kept
