"""Every clunk command and Python example of the README and the pages beside it runs as printed."""

import doctest
import io
import re
import shlex
import shutil
import signal
import sys
from pathlib import Path

import pytest
from rich.console import Console

from clunk import fit, load_study, simulate, study_from_text
from clunk.cli import cli, main
from clunk.cli.help import show
from clunk.core.status import Status
from clunk.results.quantities import REGIME_QUANTITIES, TOLERANCE_QUANTITIES, measured_quantities
from clunk.study.document import dotted
from clunk.study.keys import ITEM, keys
from clunk.study.models import OF_IMPACTS
from clunk.study.parameters import quantity

ROOT = Path(__file__).parent.parent
TOPICS = sorted((ROOT / "clunk/cli/help").glob("*.md"))
LANGUAGES = {"sh", "python", "toml", "csv", "text", "bash"}  # bash: to be run by hand, on other machines
PAGES = [ROOT / "README.md", *TOPICS, ROOT / "results/README.md", ROOT / "tests/benchmarks/README.md"]


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def commands(page):
    for block in blocks(page, "sh"):
        yield from commands_of(block)


def commands_of(block):
    for line in block.replace("\\\n", " ").splitlines():
        command = line.split(" #")[0].split(" > ")[0].strip()  # what is printed need not go to a file
        if command.startswith("clunk "):
            yield command


def named(pages):
    return [pytest.param(page, id=str(page.relative_to(ROOT))) for page in pages]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """The directory in which a reader goes through all pages, and what the commands that were run there have printed.

    With an eighth of the draws, in which sensitivities take 2 s instead of 16 s.
    """
    directory = tmp_path_factory.mktemp("checkout")
    shutil.copytree(ROOT / "configs", directory / "configs")
    toleranced = directory / "configs/tolerance.toml"
    text = toleranced.read_text(encoding="utf-8")
    assert "count = 256 " in text
    toleranced.write_text(text.replace("count = 256 ", "count = 32 "), encoding="utf-8")
    return directory, {}


@pytest.mark.parametrize("page", named(page for page in PAGES if any(commands(page)) or blocks(page, "python")))
def test_the_commands_and_then_the_python_of_a_page_do_as_printed(page, checkout, monkeypatch, capsys):
    """A command that is on an earlier page too is not run again: `clunk reproduce` alone takes 14 s."""
    directory, done = checkout
    monkeypatch.chdir(directory)
    for command in commands(page):
        if command in done:
            continue
        code, (out, err) = _run(command, monkeypatch), capsys.readouterr()
        assert code == 0, f"{command}\n{err}"
        done[command] = out
    source = "\n".join(blocks(page, "python"))
    examples = doctest.DocTestParser().get_doctest(source, {}, page.name, str(page), 0)
    report = io.StringIO()
    failed, _ = doctest.DocTestRunner(verbose=False).run(examples, out=report.write)
    assert not failed, report.getvalue()


def _run(command, monkeypatch):
    """Run a command here; returns its exit code."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # main's handler must not outlive a test
    monkeypatch.setattr(sys, "argv", shlex.split(command))
    with pytest.raises(SystemExit) as stopped:
        main()
    return stopped.value.code


@pytest.mark.parametrize("page", named(PAGES))
def test_other_code_of_a_page_is_sound_too(page, checkout, monkeypatch):
    """Tables of configs become a study, measurements are fitted to, and what has no other machine here is parsed."""
    monkeypatch.chdir(checkout[0])
    assert set(re.findall(r"^```(\w+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)) <= LANGUAGES
    for block in blocks(page, "toml"):
        axes = [f"{{parameter = '{key}', values = [2.0, 5.0]}}" for key in ("load.ratio", "lash.backlash_deg")]
        study = study_from_text(
            f'driveline.preset = "boere-2008"\n{block}', overrides=[f"sweep.axes = [{', '.join(axes)}]"]
        )
        assert simulate(study).label
    for k, block in enumerate(blocks(page, "csv")):
        Path(f"measured{k}.csv").write_text(block, encoding="utf-8")
        few = ["fit.candidates = 1", "fit.draws = 64", "fit.effective_draws = 1"]
        fitted = fit(load_study("configs/fit_table_4_1.toml", few), f"measured{k}.csv")
        assert len(fitted.points) == len(block.splitlines()) - 1
    for block in blocks(page, "python"):
        if ">>>" not in block:
            compile(block, page.name, "exec")
    for command in [command for block in blocks(page, "bash") for command in commands_of(block)]:
        name, *words = shlex.split(command)[1:]
        assert cli.get_command(None, name).make_context(name, words)


@pytest.mark.parametrize("page", named(TOPICS))
def test_output_that_a_topic_shows_has_the_words_of_what_its_commands_print(page, checkout, monkeypatch, capsys):
    """Numbers are of more draws than a test takes."""
    directory, done = checkout
    monkeypatch.chdir(directory)
    shown = [set(re.findall(r"[a-zA-Z][\w.]+", block)) for block in blocks(page, "text")]
    for words in shown:
        printed = set()
        for command in commands(page):
            if words <= printed:
                break
            if command not in done:
                _run(command, monkeypatch)
                done[command] = capsys.readouterr().out
            printed |= set(re.findall(r"[a-zA-Z][\w.]+", done[command]))
        assert words <= printed


@pytest.mark.parametrize("page", named(TOPICS))
def test_code_of_a_topic_is_not_wrapped_in_a_terminal(page):
    """80 columns, less a blank at either side, with which rich sets code off; nor is a table cut short."""
    code = "".join(blocks(page, r"\w*")).splitlines()
    assert [line for line in code if len(line) > 78] == []
    terminal = io.StringIO()
    show(page.read_text(encoding="utf-8"), Console(file=terminal, width=80))
    assert terminal.getvalue().count("…") == page.read_text(encoding="utf-8").count("…")


@pytest.mark.parametrize("page", named(PAGES))
def test_the_links_of_a_page_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def test_the_readme_is_short_and_names_every_topic():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.encode()) <= 8 * 1024
    assert set(re.findall(r"\(clunk/cli/help/([\w-]+)\.md\)", text)) == {page.stem for page in TOPICS}


def test_the_readme_tells_the_durations_at_which_ramps_change_their_labels():
    """Those that `test_thresholds` finds, to 1 ms."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f"{limit:.3f}" in text for limit in (0.143, 0.188, 0.240, 0.283, 0.375, 0.511))


def test_enough_is_run_to_notice_a_fence_that_is_not_found():
    assert sum(len(list(commands(page))) for page in PAGES) >= 35
    assert sum(block.count(">>>") for page in PAGES for block in blocks(page, "python")) >= 15


def test_the_words_have_every_symbol_with_its_quantity_key_and_unit():
    text = (ROOT / "clunk/cli/help/words.md").read_text(encoding="utf-8")
    described = re.findall(r"^\| (.*) \| (.*) \| `(.*)` \| (.*?) ?\|$", text, flags=re.MULTILINE)
    quantities = (REGIME_QUANTITIES | measured_quantities(OF_IMPACTS, [])).values()
    expected = [(each.symbol, each.words, each.name, each.unit_symbol) for each in quantities if each.symbol]
    places = [place for place, key in keys().items() if key.quantity and place[:2] != ("lash", ITEM)]
    for key in (dotted(tuple(0 if step == ITEM else step for step in place)) for place in places):
        known = quantity(key)
        expected.append((known.symbol, known.name, key, known.unit if known.unit != "1" else ""))
    assert described == expected


def test_the_file_format_has_every_variable_with_its_type_unit_and_dimension():
    text = (ROOT / "clunk/cli/help/file-format.md").read_text(encoding="utf-8")
    regimes, tolerances = text[text.index("## Variables of a regime") :].split("## Variables of a tolerance map")
    described = re.findall(r"^\| `(\w+)` \| (\w+) \| (.*?) ?\| ", regimes, flags=re.MULTILINE)
    assert described == [(each.name, each.dtype.__name__, each.unit.lstrip("1")) for each in REGIME_QUANTITIES.values()]
    described = re.findall(r"^\| `(\w+)` \| `?(.*?)`? ?\| (.*?) ?\| ", tolerances, flags=re.MULTILINE)
    assert described == [(each.name, each.dimension, each.unit.lstrip("1")) for each in TOLERANCE_QUANTITIES.values()]
    statuses = re.findall(r"^\| (\d+) \| `(\w+)` \| ", regimes, flags=re.MULTILINE)
    assert statuses == [(str(status.value), status.name.lower()) for status in Status]
