"""The explorer's page in a real browser, as a user sees it: headless Chromium, driven by selenium."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from html import escape
from pathlib import Path

import numpy as np
import pytest

from clunk import load_study, replace_values, simulate, sweep, write_results
from clunk.plot.plane import value_text
from clunk.study.config import study_from_text
from clunk.study.study import digest

pytest.importorskip("bokeh", reason="the explorer's page needs Bokeh")
webdriver = pytest.importorskip("selenium.webdriver", reason="a browser is driven by selenium")
ActionChains = webdriver.ActionChains
Keys = pytest.importorskip("selenium.webdriver.common.keys").Keys
Service = pytest.importorskip("selenium.webdriver.chrome.service").Service
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="there is no Chromium with its chromedriver")

CONFIG = Path(__file__).parent.parent / "configs/figure_3_4.toml"
CELLS = ((2.0, 2.0), (9.0, 1.0), (5.0, 6.0))  # load ratio, backlash in degrees; the first run is that of the last
PATIENCE = 60.0  # s
HELPERS = """
window.model = (name) => window.Bokeh?.documents[0]?.get_model_by_name(name) ?? null;
window.place = (name, x, y) => {
  const view = Bokeh.index.find_one(model(name));
  const box = view.el.getBoundingClientRect();
  return [box.left + view.frame.x_scale.compute(x), box.top + view.frame.y_scale.compute(y)].map(Math.round);
};
"""


# Of the lines, the points whose load ratio is no edge between two cells of 0.05.
OFF_EDGES = """
const x = Array.from(model("map").renderers[1].data_source.data.x);
return x.filter((at) => Number.isFinite(at) && Math.abs(at / 0.05 - Math.floor(at / 0.05) - 0.5) > 1e-6).length;
"""


class Browser:
    """A headless browser, and what the tests do with it."""

    def __init__(self, folder: Path) -> None:
        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        flags = ("headless=new", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-sync")
        flags += ("disable-background-networking", "disable-component-update", "window-size=1280,800")
        for flag in (*flags, f"user-data-dir={folder / 'profile'}"):
            options.add_argument(f"--{flag}")
        options.add_experimental_option("prefs", {"download.default_directory": str(folder)})
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options, Service(DRIVER))
        self.driver.get("about:blank")
        self.requests()

    def open(self, url: str) -> None:
        self.driver.get(url)
        self.driver.execute_script(HELPERS)

    def requests(self) -> list[str]:
        messages = (json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance"))
        sent = [each["params"]["request"]["url"] for each in messages if each["method"] == "Network.requestWillBeSent"]
        return [url for url in sent if not url.startswith(("data:", "blob:", "chrome:"))]

    def problems(self) -> list[str]:
        return [each["message"] for each in self.driver.get_log("browser") if each["level"] == "SEVERE"]

    def text(self, name: str) -> str:
        return self.driver.execute_script("return model(arguments[0])?.text ?? ''", name)

    def wait(self, what, *, message: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not what():
            assert time.monotonic() < deadline, f"{message}; {self.problems()}"
            time.sleep(0.01)

    def wait_for(self, name: str, *parts: str) -> None:
        self.wait(lambda: all(part in self.text(name) for part in parts), message=f"no {parts} in {name}")

    def point(self, x: float, y: float, *, click: bool = False, name: str = "map") -> None:
        left, top = self.driver.execute_script("return place(...arguments)", name, x, y)
        actions = ActionChains(self.driver, duration=0)
        actions.w3c_actions.pointer_action.move_to_location(left, top)
        if click:
            actions.w3c_actions.pointer_action.click()
        actions.perform()


@pytest.fixture(scope="module")
def study():
    return load_study(CONFIG, ["solver.method='exact'"])


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.driver.quit()


@pytest.fixture(scope="module")
def running(study, tmp_path_factory):
    """`clunk explore` of a stored 201 x 201 map, and its address."""
    file = tmp_path_factory.mktemp("explored") / "map.h5"
    write_results(file, sweep(study))
    # -P: the package that is installed, as in this process, whose kernels are compiled
    command = [sys.executable, "-P", "-c", "from clunk.cli import main; main()"]
    command += ["explore", str(file), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process, process.stdout.readline().strip()
        process.kill()


@pytest.fixture(scope="module")
def page(browser, running):
    """The page with its first map and run."""
    _, url = running
    browser.open(url)
    browser.wait_for("legend", "DS(1)SS(1)")
    browser.wait_for("header", "severity Q")
    return browser


def expected(study, numbers):
    """Texts of the page on the run of a cell."""
    run = simulate(replace_values(study.model_copy(update={"sweep": None}), numbers))
    rows = run.outcome()
    return [f">{run.label}<", *(escape(f"{name} {text}") for name, text in rows if name != "label")]


def cell(ratio, backlash):
    return {"load.ratio": ratio, "lash.backlash_deg": backlash}


class TestPage:
    def test_a_click_shows_the_run_that_clunk_simulate_makes_of_the_cell(self, page, study):
        for ratio, backlash in CELLS:
            page.point(ratio, backlash, click=True)
            page.wait_for(
                "header", f"σr = {ratio:g}, φθ = {backlash:g} degrees", *expected(study, cell(ratio, backlash))
            )
        events = simulate(replace_values(study, cell(*CELLS[-1]))).event_table()
        page.wait_for("events", *events[1], *events[-1][:2])

    def test_the_run_under_the_pointer_is_shown_while_it_is_on_the_map(self, page):
        page.point(5.0, 6.0, click=True)
        page.wait_for("header", "σr = 5, φθ = 6 degrees")
        page.point(7.5, 12.0)
        page.wait_for("header", "σr = 7.5, φθ = 12 degrees")
        page.point(0.5, 0.0, name="torque")
        page.wait_for("header", "σr = 5, φθ = 6 degrees")

    def test_two_more_runs_are_pinned_and_keys_move_and_unpin(self, page):
        page.point(2.0, 2.0, click=True)
        page.wait_for("header", "σr = 2, φθ = 2 degrees")
        body = page.driver.find_element("tag name", "body")
        body.send_keys("p")
        page.wait_for("compared", "σr = 2, φθ = 2 degrees: DS(1)")
        page.point(9.0, 1.0, click=True)
        page.wait_for("header", "σr = 9, φθ = 1 degrees")
        body.send_keys("p")
        page.wait_for("compared", "σr = 2, φθ = 2 degrees", "σr = 9, φθ = 1 degrees: DS(3)")
        page.point(0.5, 0.0, name="torque")
        body.send_keys(Keys.ARROW_RIGHT)
        body.send_keys(Keys.ARROW_UP)
        body.send_keys(Keys.ARROW_UP)
        page.wait_for("header", "σr = 9.05, φθ = 1.2 degrees")
        body.send_keys("u")
        page.wait(lambda: not page.text("compared"), message="runs stay pinned")

    @pytest.mark.parametrize(("typed", "shown"), [(3.04, 3), (-1, 0), (None, 0), (99, 20), (6, 6)])
    def test_a_cell_is_also_named_by_its_numbers(self, page, typed, shown):
        """The nearest one is taken, and what is no number changes nothing."""
        box = "model('number lash.backlash_deg').value"
        page.driver.execute_script(f"{box} = arguments[0]", typed)
        page.wait(lambda: page.driver.execute_script(f"return {box}") == shown, message=str(typed))
        page.wait_for("header", f"φθ = {shown} degrees")

    def test_a_number_changes_the_run_at_once_and_then_the_map(self, page, study):
        page.point(5.0, 6.0, click=True)
        page.wait_for("header", "σr = 5, φθ = 6 degrees")
        for damping in (60.0, 47.0):
            page.driver.execute_script("model('number lash.contact.damping').value = arguments[0]", damping)
            page.wait_for("header", f"lash.contact.damping = {damping:g}")
        numbers = {"lash.contact.damping": damping}
        page.wait_for("header", "lash.contact.damping = 47", *expected(study, cell(5.0, 6.0) | numbers))
        changed = sweep(replace_values(study, numbers), boundaries=False)
        shares = {label: f"{100.0 * count / changed.sequence.size:.2g} %" for label, count in changed.counts().items()}
        page.wait_for("legend", *(f"{label}: {share}" for label, share in shares.items() if label != "failed"))
        page.driver.execute_script("model('slider lash.contact.damping').value = 94.0")
        page.wait_for("status", "the config's own numbers")

    def test_lines_follow_a_slider(self, page, study):
        """After the map with other numbers come its boundaries: their points are no edges of cells."""
        page.driver.execute_script("model('number lash.contact.damping').value = 120.0")
        page.wait_for("status", "in no file")
        page.wait(lambda: page.driver.execute_script(OFF_EDGES) > 100, message="lines along cells")
        assert "lash.contact.damping=120" in page.driver.current_url
        page.driver.execute_script("model('slider lash.contact.damping').value = 94.0")
        page.wait_for("status", "the config's own numbers")

    def test_the_label_under_the_pointer_is_beside_it(self, page, study):
        pointed = "return model('map').select_one('pointed').data_source.data.text[0]"
        page.point(7.5, 12.0)
        label = simulate(replace_values(study.model_copy(update={"sweep": None}), cell(7.5, 12.0))).label
        page.wait(lambda: page.driver.execute_script(pointed) == label, message=label)
        page.point(0.5, 0.0, name="torque")
        page.wait(lambda: page.driver.execute_script(pointed) is None, message="the label stays")

    def test_a_link_holds_the_quantity_the_cell_and_the_numbers(self, page):
        show(page, "severity")
        page.driver.execute_script("model('number lash.contact.damping').value = 60.0")
        page.point(9.0, 1.0, click=True)
        page.wait_for("header", "σr = 9, φθ = 1 degrees")
        page.wait_for("status", "in no file")
        parts = ("quantity=severity", "load.ratio=9&", "lash.backlash_deg=1&", "lash.contact.damping=60")
        page.wait(lambda: all(part in page.driver.current_url for part in parts), message="no link")
        url = page.driver.current_url
        page.driver.get("about:blank")
        page.open(url)
        page.wait_for("header", "σr = 9, φθ = 1 degrees", "lash.contact.damping = 60")
        page.wait_for("status", "in no file")
        assert page.driver.execute_script("return model('quantity').value") == "severity"
        assert page.driver.current_url == url
        page.driver.execute_script("model('quantity').value = 'label'")
        page.driver.execute_script("model('slider lash.contact.damping').value = 94.0")
        page.wait_for("status", "the config's own numbers")

    def test_quantities_are_drawn_and_what_is_seen_is_saved(self, page, study):
        show(page, "severity")
        whole = sweep(study, boundaries=False)
        at = np.unravel_index(int(np.argmax(whole.severity)), whole.shape)
        cell = ", ".join(value_text(axis, axis.values[k], symbol=True) for axis, k in zip(whole.axes, at, strict=True))
        page.wait_for("legend", f"largest: {whole.severity.max():.6g} at {cell}")
        show(page, "label")
        page.point(5.0, 6.0, click=True)
        page.wait_for("header", "σr = 5, φθ = 6 degrees")
        page.driver.execute_script("Bokeh.index.find_one(model('save')).click()")
        config = "return (model('download').data.text ?? [''])[0]"
        page.wait(lambda: page.driver.execute_script(config).startswith("title = "), message="no config")
        config = study_from_text(page.driver.execute_script(config))
        assert digest(config) == digest(study)
        assert simulate(config).label == "DS(1)SS(1)"

    def test_nothing_came_from_another_host_and_nothing_went_wrong(self, page, running):
        _, url = running
        requests = page.requests()
        assert len(requests) > 3
        assert all(each.startswith(url.rsplit("/", 2)[0] + "/") for each in requests)
        assert page.problems() == []

    @pytest.mark.skipif(os.name != "posix", reason="signals are POSIX")
    def test_after_ctrl_c_the_page_says_that_the_explorer_has_ended(self, page, running):
        process, _ = running
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
        page.wait(lambda: page.driver.find_elements("id", "ended"), message="nothing is said")


def show(page, quantity):
    """Draw a quantity, and wait for the map's width, which a colour bar changes: clicks before would miss."""
    page.driver.execute_script(f"model('quantity').value = '{quantity}'")
    bar = "return model('map').right.some((each) => each.visible && each.title)"
    page.wait(lambda: page.driver.execute_script(bar) == (quantity != "label"), message="another colour bar")
    narrow = "return Bokeh.index.find_one(model('map')).frame.bbox.width"
    width = None
    while width != (width := page.driver.execute_script(narrow)):
        time.sleep(0.1)
