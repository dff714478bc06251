"""The page on a results file needs nothing but itself, holds texts as text, and tells how to make it again."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from conftest import RUBBING
from helpers.maps import with_arrays
from test_cli import SMALL
from test_store import BACKLASH, INERTIA, RATIO, example as example_without_config
from test_sweeping import digest_of

from clunk.analysis.marks import thresholds_of
from clunk.plot import draw
from clunk.plot.page import page
from clunk.plot.style import MOST_POINTS, save
from clunk.results import store
from clunk.study.axes import ResultAxis, run_axis

CONFIG = SMALL[: SMALL.index("[sweep]")]
LINE = CONFIG + SMALL[SMALL.index("[[sweep") : SMALL.rindex("[[sweep")] + "[lash]\nbacklash_deg = 6.0\n"


class Page(HTMLParser):
    """The elements of a page with their attributes, and the texts within each kind of element."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.texts, self._open = [], {}, []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag != "meta":
            self._open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if self._open:
            self.texts.setdefault(self._open[-1], []).append(data)

    @property
    def tags(self):
        return [tag for tag, _ in self.elements]


def example(*axes):
    """Results of cells that were all run."""
    results = example_without_config(*axes)
    return replace(with_arrays(results, quality=np.zeros(results.shape, np.uint8)), config=CONFIG)


def page_of(results):
    return Page(page(results, [("content digest", "cd" * 32)]))


@pytest.fixture(scope="module")
def read():
    return page_of(example(RATIO, BACKLASH))


def test_a_page_asks_for_nothing_and_runs_nothing(read):
    assert read.tags.count("svg") == 2
    assert not {"script", "link", "iframe", "object", "embed", "form", "a", "base"} & set(read.tags)
    sources = [value for _, each in read.elements for name, value in each.items() if name.endswith(("href", "src"))]
    assert sources
    assert all(source.startswith(("#", "data:image/png")) for source in sources)
    assert not [name for _, each in read.elements for name in each if name.startswith("on")]
    assert not [text for text in read.texts["style"] if "url(" in text or "@import" in text]
    (policy,) = (each["content"] for _, each in read.elements if each.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")


def test_a_page_has_the_numbers_and_the_config_of_its_results(read):
    results = example(RATIO, BACKLASH)
    cells = read.texts["td"]
    for label, count in results.counts().items():
        assert cells[cells.index(label) + 1] == str(count)
    assert cells[cells.index("the state became infinite or undefined") - 1] == "1"
    assert cells[cells.index("cpu") + 1] == results.attributes["cpu"]
    assert cells[cells.index("content digest") + 1] == "cd" * 32
    assert read.texts["pre"] == [results.config]


@pytest.mark.parametrize("text", ["<script>alert(1)</script>", "</title></svg><img src=x onerror=alert(1)>", "--><b>&"])
def test_texts_of_a_file_are_text(text):
    lashes = ResultAxis("lash", np.array([1.0, 2.0]), "lash", "", "1", (text, "second"))
    results, config = example(RATIO, lashes), f"{CONFIG}# {text}"
    read = page_of(replace(results, title=text, config=config, attributes={"cpu": text}))
    assert read.texts["title"] == read.texts["h1"] == [text]
    assert text in read.texts["h2"]
    assert text in read.texts["td"]
    assert read.texts["pre"][-1] == config
    assert not {"script", "img", "b"} & set(read.tags)
    assert read.tags.count("svg") == len(lashes.words)


def test_the_config_of_a_page_makes_the_same_results_and_page(command, here):
    (here / "first.toml").write_text(LINE)
    assert command("sweep", "first.toml", "-o", "first.h5")[0] == 0
    assert command("report", "first.h5")[0] == 0
    read = Page((here / "first.html").read_text("utf-8"))
    (config,) = read.texts["pre"]
    (here / "first.toml").write_text(config)
    digest = digest_of(here / "first.h5")
    (here / "first.h5").unlink()
    assert command("sweep", "first.toml", "-o", "first.h5")[0] == 0
    assert command("report", "first.h5")[0] == 0
    assert digest_of(here / "first.h5") == digest
    assert digest in read.texts["td"]
    again = Page((here / "first.html").read_text("utf-8"))
    assert again.texts["pre"] == read.texts["pre"]


def test_three_axes_are_a_family_of_maps_and_a_slice_is_one(command, here):
    store.write_results(here / "map.h5", example(INERTIA, RATIO, BACKLASH))
    at = ["--at", "driveline.inertias[4]=0.002", "--at", "load.ratio=5"]
    for name, options, swept in (("out/family.html", [], (3, 5, 4)), ("slice.html", at, (1, 1, 4))):
        assert command("report", "map.h5", "-o", name, *options)[0] == 0
        read = Page((here / name).read_text("utf-8"))
        counts = [re.search(r"(\d+) values", text) for text in read.texts["td"]]
        assert tuple(int(count[1]) for count in counts if count) == swept
        assert read.tags.count("svg") == (1 if options else 2)


def test_bad_usage_gives_one_sentence_and_writes_nothing(command, here):
    further = [ResultAxis(f"driveline.inertias[{k}]", np.array([1.0, 2.0]), "", "", "kg m2") for k in (1, 2, 3)]
    store.write_results(here / "five.h5", example(RATIO, BACKLASH, *further))
    (here / "folder.html").mkdir()
    for arguments, sentence in {
        ("five.h5", "-o", "map.pdf"): "map.pdf cannot be written: its name must end in .html.",
        ("five.h5", "-o", "folder.html"): "folder.html is a directory; name a file in it.",
        ("nothing.h5",): "nothing.h5 cannot be read",
        ("five.h5",): "choose one value of",
        ("five.h5", "--at", "load.ratio=50"): "load.ratio is swept from 0 to 10; 50 is not on it",
    }.items():
        code, _, err = command("report", *arguments)
        assert code == 2
        assert sentence in " ".join(err.split())
    assert not [path for path in here.glob("*.html") if path.is_file()]


def test_thresholds_of_a_driveline_with_friction_are_not_told():
    """Those of the linear view without friction would be too low."""
    results = example(RATIO, BACKLASH)
    assert len(thresholds_of(results)) > 6  # also where another impact appears beyond those of the report
    assert not thresholds_of(replace(results, config=RUBBING))


@pytest.mark.parametrize("count", [100, MOST_POINTS + 1])
def test_a_cloud_of_points_is_not_a_path_for_each(tmp_path, count):
    rng = np.random.default_rng(1)
    x, y = (replace(axis, values=rng.uniform(0.5, 10.0, count)) for axis in (RATIO, BACKLASH))
    results = with_arrays(example(run_axis([x, y])), quality=np.zeros(count, np.uint8))
    save(draw(results, "regimes", x=x.parameter, y=y.parameter), tmp_path / "cloud.svg")
    text = (tmp_path / "cloud.svg").read_text("utf-8")
    assert (text.count("<use") > count) == (count == 100)
    assert ("<image" in text) == (count > 100)
