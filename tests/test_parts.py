"""Sweeps that are stopped, killed or get in each other's way: what is done stays, and the results are the same bits."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import BOERE, axis
from test_sweeping import digest_of, equal, figure_3_4

import clunk
from clunk.study.config import study_from_text
from clunk.study.study import replace_values
from clunk.sweeping import engines, parts as keeping, sweep as sweeping
from clunk.sweeping.engines import Threads
from clunk.sweeping.machine import versions
from clunk.sweeping.parts import PartsError, WorkingDirectory
from clunk.sweeping.sweep import Job, sweep

PACKAGE = Path(keeping.__file__).parents[1]
CONFIG = f"{BOERE}[solver]\nstep = 2e-4\n[sweep]\nboundaries = false\n"
CONFIG += axis("load.ratio", 0.0, 10.0, 41) + axis("lash.backlash_deg", 0.0, 20.0, 31)
SWEEP = "sweep", "map.toml", "-o", "map.h5", "--workers", "2"


@pytest.fixture
def target(tmp_path):
    return tmp_path / "map.h5"


@pytest.fixture
def often(monkeypatch):
    """A part for every tile."""
    for name in ("_PART", "_SHARE"):
        monkeypatch.setattr(keeping, name, 0.0)


@pytest.fixture(scope="module")
def study():
    return figure_3_4(17, step=2e-4)


@pytest.fixture(scope="module")
def whole(study):
    return sweep(study)


@pytest.fixture(autouse=True)
def by_threads(monkeypatch):
    """Small sweeps, too, are run in many tiles, as large ones are."""
    monkeypatch.setattr(engines, "_MOMENT", 0.0)


def stopped(study, target, after, error=KeyboardInterrupt, *, engine=None):
    """Start a sweep and stop it when so many cells are done; how many are kept."""

    def progress(done, _total):
        if done >= after:
            raise error

    with WorkingDirectory(target) as directory:
        job = Job(study, directory=directory)
        with pytest.raises(error):
            job.run(engine or Threads(2), progress=progress)  # their number decides the tiles
        return job.parts.kept


def resumed(study, target, engine=None):
    """Go on, and the parts; the directory is removed."""
    with WorkingDirectory(target) as directory:
        job = Job(study, directory=directory)
        results = job.run(engine)
        directory.remove()
    assert not directory.path.exists()
    return results, job.parts


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_a_stopped_sweep_goes_on_where_it_was_and_ends_with_the_same_bits(study, whole, target, error):
    first = stopped(study, target, 60, error)
    foreign = target.parent / f"{target.name}.partial" / "part-000001 (copy of another program)"
    foreign.touch()
    second = stopped(study, target, 150, error)
    foreign.unlink()
    assert 60 <= first < second < 289
    results, parts = resumed(study, target, Threads(1))
    assert parts.taken_up == second
    assert parts.discarded == 0
    assert equal(results, whole)


def test_a_finished_sweep_leaves_no_directory_and_a_short_one_no_parts(study, target):
    with WorkingDirectory(target) as directory:
        Job(study, directory=directory).run()
        assert directory.parts() == []
    assert list(target.parent.iterdir()) == []


def test_stopped_behind_its_last_cell_a_sweep_keeps_all(study, whole, target, monkeypatch):
    def interrupted(_engine):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, WorkingDirectory(target) as directory:
        patched.setattr(sweeping, "provenance", interrupted)
        with pytest.raises(KeyboardInterrupt) as raised:
            Job(study, directory=directory).run()
    assert raised.value.__notes__ == [f"289 cells are kept in {directory.path}; the same command goes on from there"]
    results, parts = resumed(study, target)
    assert parts.taken_up == 289
    assert equal(results, whole)


@pytest.mark.parametrize("name", ["part-000001", "manifest.json"])
def test_what_cannot_be_read_for_now_stays(study, whole, target, often, monkeypatch, name):
    kept = stopped(study, target, 60)
    read_bytes = Path.read_bytes

    def failing(path):
        if path.name == name:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read_bytes(path)

    with monkeypatch.context() as patched, WorkingDirectory(target) as directory:
        patched.setattr(Path, "read_bytes", failing)
        with pytest.raises(PartsError, match=rf"{name} cannot be read: input/output error"):
            Job(study, directory=directory).run()
    results, parts = resumed(study, target)
    assert (parts.taken_up, parts.discarded) == (kept, 0)
    assert equal(results, whole)


def test_parts_of_another_config_are_refused_with_what_differs(study, target):
    stopped(study, target, 60)
    other = replace_values(study, {"load.static_torque": -2.0, "solver.end_time": 1.5})
    with WorkingDirectory(target) as directory, pytest.raises(PartsError) as raised:
        _ = Job(other, directory=directory).parts
    assert "load.static_torque = -1.0 there, -2.0 here" in str(raised.value)
    assert "solver.end_time = 2.0 there, 1.5 here" in str(raised.value)
    assert "--restart" in str(raised.value)
    with WorkingDirectory(target) as directory:
        directory.clear()
        _ = Job(other, directory=directory).parts


def damage(path, how):
    raw = bytearray(path.read_bytes())
    if how == "cut":
        raw = raw[: len(raw) // 2]
    elif how == "emptied":
        raw = b""
    else:
        raw[len(raw) // 2] ^= 4
    path.write_bytes(raw)


@pytest.mark.parametrize("how", ["cut", "emptied", "a bit changed"])
def test_damaged_parts_are_run_again(study, whole, target, often, how):
    stopped(study, target, 150)
    with WorkingDirectory(target) as directory:
        names = directory.parts()
        damage(names[1], how)
        damage(names[-1], how)
        (directory.path / ".part-000009.1-ab.tmp").write_bytes(b"half")  # of a process that was killed
    results, parts = resumed(study, target)
    assert parts.discarded == 2
    assert 0 < parts.taken_up < 289
    assert equal(results, whole)


def test_parts_of_other_versions_are_run_again(study, whole, target, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(keeping, "versions", lambda: {"numba": "0.1"})
        stopped(study, target, 150)
    results, parts = resumed(study, target)
    assert (parts.discarded, parts.taken_up) == (1, 0)
    assert equal(results, whole)


def test_only_an_edit_of_what_decides_the_numbers_is_another_version(tmp_path):
    package = tmp_path / "clunk"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    before = versions(package)
    assert before == versions()
    for room in ("results", "analysis", "plot", "report", "cli"):
        source = next((package / room).glob("*.py"))
        source.write_text(source.read_text() + "# an edit\n")
        versions.cache_clear()
        assert versions(package) == before, room
    for room in ("core", "core/exact", "study", "simulation", "sweeping"):
        source = next((package / room).glob("[a-z]*.py"))
        source.write_text(source.read_text() + "# an edit\n")
        versions.cache_clear()
        assert versions(package) != before, room
        before = versions(package)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"config": 1}', '{"config_digest": 2, "config": 3, "versions": 4}'])
def test_parts_without_a_readable_manifest_still_tell_what_they_are(study, whole, target, text):
    kept = stopped(study, target, 150)
    other = replace_values(study, {"load.static_torque": -2.0})
    manifest = target.parent / "map.h5.partial" / "manifest.json"
    manifest.write_text(text)
    results, parts = resumed(study, target)
    assert parts.taken_up == kept
    assert equal(results, whole)
    stopped(study, target, 150)
    manifest.write_text(text)
    _, parts = resumed(other, target)
    assert (parts.discarded, parts.taken_up) == (1, 0)


def test_a_second_writer_is_refused_at_once(study, target):
    with WorkingDirectory(target):
        with pytest.raises(PartsError, match="another sweep"), WorkingDirectory(target):
            pass
        link = target.with_name("link.h5")
        target.touch()
        link.symlink_to(target)
        with pytest.raises(PartsError, match="another sweep"), WorkingDirectory(link):
            pass
        with WorkingDirectory(target.with_name("other.h5")):
            pass
    with WorkingDirectory(target):
        pass


# --- killed

RUN = """
import os, signal, sys, time
from clunk.sweeping import parts
from clunk.results import store
parts._PART = parts._SHARE = 0.0
moment = sys.argv.pop(1)
die = lambda: os.kill(os.getpid(), signal.SIGKILL)
count = 0
def at(module, name, wanted, before):
    original = getattr(module, name)
    def patched(*arguments, **options):
        global count
        count += 1
        if before and count == wanted:
            die()
        value = original(*arguments, **options)
        if count == wanted:
            die()
        return value
    setattr(module, name, patched)
if moment == "first fsync":
    at(os, "fsync", 2, True)
elif moment == "fifth part":
    at(os, "fsync", 10, False)
elif moment == "assembly":
    import h5py
    at(h5py.Group, "create_dataset", 5, False)
elif moment == "file on disk":
    at(store, "write", 1, False)
elif moment == "trailer":
    from clunk.results import netcdf
    at(netcdf, "_trailer", 1, False)
from clunk.cli import main
sys.argv[0] = "clunk"
main()
"""
posix = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is POSIX")


def start(directory, moment):
    (directory / "map.toml").write_text(CONFIG)
    command = [sys.executable, "-c", RUN, moment, *SWEEP]
    return subprocess.Popen(command, cwd=directory, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(directory):
    process = start(directory, "never")
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert sorted(path.name for path in directory.iterdir()) == ["map.h5", "map.toml"]
    return digest_of(directory / "map.h5"), out, err


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    path = tmp_path_factory.mktemp("undisturbed") / "map.h5"
    clunk.sweep(study_from_text(CONFIG), path)
    return digest_of(path)


@posix
@pytest.mark.parametrize(
    "moments",
    [
        ("first fsync", "assembly", "file on disk"),
        pytest.param(("first fsync", "fifth part", "assembly", "trailer", "file on disk"), marks=pytest.mark.slow),
    ],
    ids=len,
)
def test_killed_at_any_moment_the_same_command_gives_the_same_bits(tmp_path, undisturbed, moments):
    """One sweep killed several times: while a part is written, while it is assembled, and at its end."""
    for moment in moments:
        process = start(tmp_path, moment)
        _, err = process.communicate(timeout=120)
        assert process.returncode == -signal.SIGKILL, (moment, err)
        assert (tmp_path / "map.h5.partial").is_dir(), moment
        assert (tmp_path / "map.h5").exists() == (moment == "file on disk")
    digest, _, err = finish(tmp_path)
    assert digest == undisturbed
    assert "already complete" in err


@posix
def test_a_second_command_on_the_same_file_is_refused_and_the_lock_dies_with_its_process(tmp_path, undisturbed):
    process = start(tmp_path, "never")
    while not (tmp_path / "map.h5.partial" / "lock").exists():
        time.sleep(0.005)
    time.sleep(0.05)  # it is locked a moment after it is there
    process.send_signal(signal.SIGSTOP)
    second = start(tmp_path, "never")
    _, err = second.communicate(timeout=60)
    assert second.returncode == 2
    assert "written by another sweep" in " ".join(err.split())
    process.kill()
    process.communicate()
    assert finish(tmp_path)[0] == undisturbed


@posix
def test_where_files_cannot_grow_the_command_ends_with_a_sentence_and_can_go_on(tmp_path, undisturbed):
    (tmp_path / "map.toml").write_text(CONFIG)
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)){RUN}"
    command = [sys.executable, "-c", limit, "never", *SWEEP]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "cannot be written: file too large" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert "step = 0.0002" in json.loads((tmp_path / "map.h5.partial" / "manifest.json").read_text())["config"]
    assert Path(tmp_path / "map.h5.partial" / "part-000001").exists()
    digest, _, err = finish(tmp_path)
    assert digest == undisturbed
    assert "1,271 cells were finished before" in err


def test_where_the_results_cannot_be_written_all_cells_are_kept(study, whole, target):
    with sweeping.opened(target, study) as job:
        result = job.run()
        target.mkdir()
        with pytest.raises(clunk.ClunkError) as raised:
            job.finish(result)
    assert "289 cells are kept" in raised.value.__notes__[-1]
    target.rmdir()
    with sweeping.opened(target, study) as job:
        assert equal(job.run(), whole)
        assert job.parts.taken_up == 289
