"""The Python API: examples that run, sweeps into files, Datasets, what objects say of themselves, and progress."""

import doctest
import importlib
import io
import re
import shutil
import subprocess
import sys
import types
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from conftest import EXACT, axis, values
from helpers.maps import CELL_QUANTITIES, IMPACT_QUANTITIES
from test_store import BACKLASH, RATIO, assert_same, example
from test_sweeping import digest_of

import clunk
from clunk.study.errors import ClunkError
from clunk.study.study import digest
from clunk.sweeping import progress

ROOT = Path(__file__).parent.parent
TITLE = '<script>alert("x")</script> & co'
SMALL = f"title = '{TITLE}'\n{EXACT}{axis('load.ratio', 0.0, 10.0, 6)}"
SMALL += values("lash.backlash_deg", [1.0, 5.0, 10.0, 20.0])


@pytest.fixture(scope="module")
def small():
    return clunk.study_from_text(SMALL)


@pytest.fixture(scope="module")
def results(small):
    return clunk.sweep(small)


# --- names and examples


def test_every_public_name_is_there_and_documented():
    assert set(clunk.__all__) <= set(dir(clunk))
    for name in clunk.__all__:
        assert getattr(clunk, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'swep'"):
        _ = clunk.swep


@pytest.mark.parametrize("name", ["sweep", "simulate", "thresholds", "fit", "optimize", "sensitivity", "verify"])
def test_a_path_in_the_place_of_a_study_is_a_sentence(name):
    with pytest.raises(ClunkError, match=rf"^{name} takes a study, not a str; clunk\.load_study\(path\) reads one\.$"):
        getattr(clunk, name)("study.toml")


def test_import_waits_for_nothing_heavy():
    code = (
        "import sys, clunk; assert not "
        "{'numba', 'matplotlib', 'pydantic', 'xarray', 'h5py', 'numpy', 'IPython'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("module", ["clunk", *sorted({*clunk._HOME.values()})])
def test_the_examples_say_what_is_printed(module, here):
    shutil.copytree(ROOT / "configs", here / "configs")
    found = importlib.import_module(module if module == "clunk" else f"clunk.{module}")
    report = io.StringIO()
    runner = doctest.DocTestRunner(verbose=False)
    for test in doctest.DocTestFinder().find(found):
        runner.run(test, out=report.write)
    assert not runner.failures, report.getvalue()


@pytest.mark.parametrize(
    "name", [name for name in clunk.__all__ if isinstance(getattr(clunk, name), types.FunctionType)]
)
def test_every_public_function_has_an_example(name):
    assert doctest.DocTestFinder().find(getattr(clunk, name), name)[0].examples


# --- sweeps into a file


def test_a_sweep_into_a_file_is_written_once_and_then_read(small, results, here):
    told = []
    found = clunk.sweep(small, "maps/small.h5", progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (24, 24)
    before = (here / "maps/small.h5").read_bytes()
    told.clear()
    again = clunk.sweep(small, "maps/small.h5", progress=lambda *numbers: told.append(numbers))
    assert not told
    assert (here / "maps/small.h5").read_bytes() == before
    assert_same(found, again)
    assert_same(replace(found, attributes={}), replace(results, attributes={}))
    assert [path.name for path in (here / "maps").iterdir()] == ["small.h5"]
    clunk.sweep(small, "maps/small.h5", restart=True, progress=lambda *numbers: told.append(numbers))
    assert told[-1] == (24, 24)


def test_a_sweep_into_a_file_of_something_else_leaves_it_alone(small, here):
    clunk.sweep(small, "small.h5")
    before = (here / "small.h5").read_bytes()
    other = clunk.replace_values(small, {"load.static_torque": -2.0})
    with pytest.raises(clunk.ClunkError, match=r"another config .*force=True"):
        clunk.sweep(other, "small.h5")
    assert (here / "small.h5").read_bytes() == before
    (here / "junk.h5").write_bytes(b"junk")
    with pytest.raises(clunk.ClunkError, match=r"not HDF5.*in the way"):
        clunk.sweep(small, "junk.h5")
    with pytest.raises(clunk.ClunkError, match=re.escape("must end in .h5")):
        clunk.sweep(small, "small.csv")
    clunk.sweep(other, "small.h5", force=True)
    found = clunk.read_results("small.h5")
    assert found.config_digest == digest(other)
    clunk.write_results("slice.h5", found.at({found.axes[0].parameter: found.axes[0].values[0]}))
    with pytest.raises(clunk.ClunkError, match=r"holds a part of this map.*force=True"):
        clunk.sweep(other, "slice.h5")


@pytest.mark.parametrize("workers", [0, -1])
def test_there_is_no_work_without_workers(small, workers):
    keys = ["load.ratio"]
    for work in (
        lambda: clunk.sweep(small, workers=workers),
        lambda: clunk.Runner(small, keys, workers=workers),
        lambda: clunk.verify(small, workers=workers),
        lambda: clunk.thresholds(small, along="load.ratio", workers=workers),
    ):
        with pytest.raises(clunk.ClunkError, match="at least one worker"):
            work()


def test_a_lash_that_there_is_not_is_told_also_where_no_lines_are_traced(small):
    with pytest.raises(clunk.ConfigError, match="nope"):
        clunk.sweep(small, boundaries=False, lash="nope")


# --- Datasets


def test_a_dataset_is_that_of_the_file_with_labels_as_text(tmp_path):
    results = example(RATIO, BACKLASH)
    clunk.write_results(tmp_path / "map.h5", results)
    found = clunk.open_results(tmp_path / "map.h5")
    assert found.attrs["content_digest"] == digest_of(tmp_path / "map.h5")
    (tmp_path / "map.h5").unlink()  # it is in memory
    xarray.testing.assert_identical(clunk.to_dataset(results), found)
    assert set(found.data_vars) == {"label", *CELL_QUANTITIES, *IMPACT_QUANTITIES}
    assert found.label.dims == found.sequence.dims == ("load_ratio", "lash_backlash_deg")
    np.testing.assert_array_equal(found.label, results.label_map)
    assert found.label.where(found.sequence == 2, drop=True).values.flat[0] == "DS(1)SS(1)"


def test_without_xarray_a_dataset_is_refused_with_how_to_install_it(tmp_path, monkeypatch):
    results = example(RATIO, BACKLASH)
    clunk.write_results(tmp_path / "map.h5", results)
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=re.escape("clunk[xarray]")):
        clunk.open_results(tmp_path / "map.h5")
    with pytest.raises(ImportError, match=re.escape("clunk[xarray]")):
        clunk.to_dataset(results)


# --- cells


def test_a_cell_has_all_that_its_own_run_finds(small, results):
    cell = results.cell({"lash.backlash_deg": 5.4, "load.ratio": 6.2})  # the nearest: 5°, 6
    values = {"load.ratio": 6.0, "lash.backlash_deg": 5.0}
    run = clunk.simulate(clunk.replace_values(small, values))
    assert {key: cell[key] for key in values} == values
    assert (cell["label"], cell["severity"], cell["touches"]) == (run.label, run.severity, run.touches)
    assert cell["status"] == "ok"
    assert cell["quality"] == ["complete"]
    np.testing.assert_array_equal(cell["impact_time"], run.events["time"][run.primaries])
    assert set(cell) == {*values, "label", *CELL_QUANTITIES, *IMPACT_QUANTITIES}


def test_a_cell_that_is_not_there_is_refused(results):
    with pytest.raises(clunk.ClunkError, match=r"named by load.ratio and lash.backlash_deg, not by load.ratio\."):
        results.cell({"load.ratio": 5.0})
    for wrong in (11.0, float("nan")):
        with pytest.raises(clunk.ClunkError, match=r"load\.ratio is swept from 0 to 10"):
            results.cell({"load.ratio": wrong, "lash.backlash_deg": 5.0})


# --- what objects say of themselves


def test_summaries_fit_a_terminal(small, results):
    for thing in (small, results, clunk.simulate(small)):
        lines = repr(thing).splitlines()
        assert TITLE[:20] in lines[0]
        assert max(map(len, lines)) <= 80
    assert max(map(len, repr(small.model_copy(update={"title": "long " * 40})).splitlines())) == 80


def test_what_is_drawn_is_a_picture(results, nominal):
    for figure in (clunk.draw(results, "severity"), clunk.draw(clunk.simulate(nominal))):
        assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ClunkError, match='no quantity "speed"'):
        clunk.draw(results, "speed")
    with pytest.raises(TypeError, match=r"not a Dataset; clunk\.read_results"):
        clunk.draw(clunk.to_dataset(results))
    for of_maps in ({"quantity": "severity"}, {"lash": 1}):
        with pytest.raises(ClunkError, match="of all quantities and lashes"):
            clunk.draw(clunk.simulate(nominal), **of_maps)


# --- progress


class Screen(io.StringIO):
    """A terminal that keeps what it shows."""

    def isatty(self):
        return True


@pytest.mark.parametrize("where", ["terminal", "notebook", "elsewhere"])
def test_progress_is_a_line_that_is_rewritten_or_a_line_now_and_then(where, monkeypatch):
    """A notebook keeps the last state, here that of an interrupt."""
    monkeypatch.setattr(sys, "stderr", Screen() if where == "terminal" else io.StringIO())
    if where == "notebook":
        shell = types.ModuleType("IPython")
        shell.get_ipython = lambda: types.SimpleNamespace(kernel=object())
        monkeypatch.setitem(sys.modules, "IPython", shell)
    for name in ("_LINE_EVERY", "_REWRITTEN_EVERY"):
        monkeypatch.setattr(progress, name, 0.0)
    with suppress(KeyboardInterrupt), progress.shown() as tell:
        for done in (10, 20, 60):
            tell(done, 100)
        raise KeyboardInterrupt
    *before, last = sys.stderr.getvalue().replace("\r", "\n").rstrip("\n").splitlines()
    assert any(re.search(r"20 of 100 cells, [\d,]+/s, 0 s left", line) for line in before)
    assert any("█" in line for line in before) == (where != "elsewhere")
    assert ("60 of 100 cells" in last) == (where != "terminal")


def test_errors_that_public_functions_document_are_public():
    raised = {
        error
        for name in clunk.__all__
        if callable(function := getattr(clunk, name))
        for section in re.findall(r"Raises?\n\s*-+\n(.*?)(?:\n\s*\n|\Z)", function.__doc__ or "", flags=re.DOTALL)
        for error in re.findall(r"\b[A-Z]\w+Error\b", section)
    }
    assert {"ConfigError", "ClunkError"} <= raised
    assert raised <= {*clunk.__all__, "ValueError", "TypeError", "ImportError", "KeyError"}
