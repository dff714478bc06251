"""A config or a results file is data: nothing in it is run, fetched, or turned into a path.

ruff's S rules and a contract of import-linter hold the package to it; these tests state what a user sees.
"""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from clunk.cli import cli
from clunk.cli.terminal import safe
from clunk.results.store import write_results
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.keys import keys
from clunk.sweeping.sweep import sweep


def test_no_key_of_a_config_is_a_path():
    """Its texts are a title, names, parameters of axes, and words to choose from."""
    free = {place for place, key in keys().items() if key.must_be == "text on one line"}
    lashes = {("lash", "name"), ("lash", "#", "name")}
    shafts = {("driveline", "names", "#"), ("driveline", "shafts", "#", "name")}
    of_optimum = {("optimize", "minimize"), ("optimize", "subject_to", "#")}
    of_optimum |= {("optimize", "parameters", "#", "parameter", *item) for item in ((), ("#",))}
    assert free - of_optimum == {("title",), *lashes, *shafts, ("measures", "#", "name")}


@pytest.mark.parametrize("title", ["../../escaped", "/tmp/escaped", "C:\\escaped", "a/b", "$(touch escaped)", "~"])
def test_a_title_names_no_file(tmp_path, monkeypatch, title):
    """Sweeps, runs and pictures are named by the file of the config and by -o."""
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


def test_bytes_that_are_no_text_are_refused():
    with pytest.raises(ClunkError, match="is no TOML value"):
        study_from_text('driveline.preset = "boere-2008"', overrides=['title="\udcff"'])


HOSTILE = "\x1b]0;owned\x07 \x1b[2J\x9b31m \u202egnp.exe"


def test_text_of_a_results_file_reaches_a_terminal_as_text(tmp_path, monkeypatch):
    """A title and a lash's name may come from anybody: escape sequences are shown, and not obeyed."""
    monkeypatch.chdir(tmp_path)
    axes = '[[sweep.axes]]\nparameter = "load.ratio"\nvalues = [2.0, 5.0]\n'
    results = sweep(study_from_text(f'[driveline]\npreset = "boere-2008"\n{axes}'))
    config = results.config.replace('title = "Untitled"', f'title = "{HOSTILE}"')
    write_results("map.h5", replace(results, title=HOSTILE, config=config))
    for arguments in (["info", "map.h5"], ["info", "map.h5", "--config"]):
        shown = CliRunner().invoke(cli, arguments, color=True).output
        assert not set(shown) & set("\x1b\x07\x9b\u202e"), arguments
        assert "\\x1b]0;owned\\x07" in shown, arguments
    assert safe("load ratio σr\t5 °\n") == "load ratio σr\t5 °\n"
