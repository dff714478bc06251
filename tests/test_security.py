"""A config or a results file is data: nothing in it is run, fetched, or turned into a path."""

import ast
from pathlib import Path

import pytest

import clunk
from clunk.study.config import study_from_text
from clunk.study.keys import keys

PACKAGE = Path(clunk.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
# What runs text or bytes as code, and what talks to other machines or starts other programs.
MODULES = {
    *("pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib", "code", "codeop", "runpy", "yaml"),
    *("socket", "ssl", "http", "urllib", "ftplib", "smtplib", "telnetlib", "xmlrpc", "requests", "httpx", "aiohttp"),
    *("dask", "distributed", "subprocess", "pty", "webbrowser", "ctypes", "cffi", "multiprocessing"),
}
# A scheduler that the user names is trusted: dask's own messages are pickles, and so is what a worker gets of a study.
ALLOWED = {PACKAGE / "sweeping" / "distributed.py": {"dask", "distributed", "pickle"}}
CALLS = {"eval", "exec", "compile", "__import__", "breakpoint", "input"}
OF_OS = {"system", "popen", "execv", "execve", "execvp", "spawnv", "spawnl", "startfile", "fork"}
KEYWORDS = {"allow_pickle", "shell"}


def offences(source):
    """Line and name of everything in a source that runs data, starts a program or opens a connection."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = {alias.name.split(".")[0] for alias in node.names} & MODULES
        elif isinstance(node, ast.ImportFrom):
            names = {(node.module or "").split(".")[0]} & MODULES
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            names = {node.func.id} & CALLS
        elif isinstance(node, ast.Attribute):
            names = {node.attr} & OF_OS if isinstance(node.value, ast.Name) and node.value.id == "os" else set()
        elif isinstance(node, ast.keyword):
            names = {node.arg} & KEYWORDS
        else:
            continue
        yield from ((getattr(node, "lineno", 0), name) for name in names)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_nothing_in_the_package_runs_data_or_opens_a_connection(path):
    found = {name for _, name in offences(path.read_text(encoding="utf-8"))}
    assert found == ALLOWED.get(path, set())


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from urllib.request import urlopen",
        "import os.path, socket",
        "eval('1')",
        "os.system('ls')",
        "np.load(file, allow_pickle=True)",
        "def f():\n    from subprocess import run",
    ],
)
def test_the_search_finds_what_it_looks_for(source):
    assert list(offences(source))


def test_no_key_of_a_config_is_a_path():
    """Its texts are a title, names of inertias, parameters of axes, and words to choose from."""
    free = {place for place, key in keys().items() if key.must_be == "text on one line"}
    assert free == {("title",), ("driveline", "names", "#")}


@pytest.mark.parametrize("title", ["../../escaped", "/tmp/escaped", "C:\\escaped", "a/b", "$(touch escaped)", "~"])
def test_a_title_names_no_file(tmp_path, monkeypatch, title):
    """Sweeps, runs and pictures are named by the file of the config and by -o."""
    from click.testing import CliRunner

    from clunk.cli import cli

    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    monkeypatch.chdir(inside)
    axes = '[[sweep.axes]]\nparameter = "load.ratio"\nvalues = [2.0, 5.0]\n'
    text = f"title = '{title}'\n[driveline]\npreset = \"boere-2008\"\nnames = ['../x', 'y/', 'z', 'w']\n{axes}"
    assert study_from_text(text).title == title
    Path("study.toml").write_text(text)
    for arguments in (["sweep", "study.toml"], ["simulate", "study.toml", "-o", "run.csv"]):
        assert CliRunner().invoke(cli, arguments).exit_code == 0
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert found == ["a/b/results/study.h5", "a/b/run.csv", "a/b/study.toml"]
