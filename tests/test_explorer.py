"""The explorer without a browser: what it computes, and what its server refuses."""

import http.client
import queue
import subprocess
import sys
import threading
import time
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the explorer's page needs Bokeh")
from bokeh.document import Document
from bokeh.events import DocumentReady
from click.testing import CliRunner
from conftest import NOMINAL, axis, drawn, values
from hypothesis import given, strategies as st

from clunk import ClunkError, load_study, simulate, sweep, tolerance_map
from clunk.analysis.boundaries import with_boundaries
from clunk.cli import cli
from clunk.explorer.controls import Controls, adjustable, slider_range
from clunk.explorer.figures import MapFigure, Message, thinned
from clunk.explorer.newest import Newest
from clunk.explorer.server import explore
from clunk.explorer.subject import Subject
from clunk.explorer.workbench import Workbench
from clunk.plot.style import PlotError, colour_of
from clunk.study.config import study_from_text
from clunk.study.designs import Design, with_cells
from clunk.study.parameters import located
from clunk.sweeping.sweep import sweep as sweep_cells

CONFIGS = Path(__file__).parent.parent / "configs"
AXES = values("lash.backlash_deg", [2.0, 6.0, 10.0]) + axis("load.ratio", 0.0, 10.0, 5)
EXACT = '[solver]\nmethod = "exact"\n'
CELL = {"load.ratio": 5.0, "lash.backlash_deg": 6.0}


@pytest.fixture(scope="module")
def subject():
    return Subject(sweep(study_from_text(NOMINAL + EXACT + AXES)), "nominal")


def picture(results, quantity):
    """What a map changes on the page: name of a model -> property -> value."""
    return MapFigure(Subject(results).plane).changes(results, quantity)


def pixels(changes):
    """Colours of an image's pixels as `#rrggbb`, rows upwards."""
    (image,) = changes["image"]["data"]["image"]
    packed = image.ravel().tolist()
    return np.array([f"#{pixel.to_bytes(4, 'little').hex()[:6]}" for pixel in packed]).reshape(image.shape)


class TestCurves:
    @given(st.integers(2, 3000), st.integers(1, 50), st.integers(0, 2**32 - 1))
    def test_a_thinned_curve_keeps_ends_and_extremes_and_no_more_points_than_stated(self, size, spans, seed):
        random = np.random.default_rng(seed)
        time_of, values = np.sort(random.random(size)), random.normal(size=size)
        thin_time, thin = thinned(time_of, values, 0.0, 1.0, spans)
        assert thin.size <= 4 * spans + 3
        assert (thin_time[0], thin_time[-1]) == (time_of[0], time_of[-1])
        length = max(size // spans, 1)
        for start in range(0, size - length + 1, length):
            whole = values[start : start + length]
            part = thin[np.isin(thin_time, time_of[start : start + length])]
            assert (part.min(), part.max()) == (whole.min(), whole.max())


class TestNewest:
    def test_only_the_newest_request_is_finished(self):
        done, began, errors = [], threading.Event(), []
        newest = Newest("test", errors.append)

        def work(number):
            def run(go_on):
                began.set()
                deadline = time.monotonic() + 10.0
                while number == 0 and time.monotonic() < deadline:
                    go_on()
                done.append(number)

            return run

        newest.submit(work(0))
        assert began.wait(10.0)
        finished = threading.Event()
        newest.submit(work(1))
        newest.submit(lambda go_on: (work(2)(go_on), finished.set()))
        assert finished.wait(10.0)
        assert 0 not in done
        assert done[-1] == 2
        newest.submit(lambda go_on: 1 / 0)
        deadline = time.monotonic() + 10.0
        while not errors and time.monotonic() < deadline:
            time.sleep(0.01)
        newest.close()
        assert isinstance(errors[0], ZeroDivisionError)


class TestSubject:
    def test_the_load_ratio_is_x_and_further_axes_are_slices(self, subject):
        assert [axis.parameter for axis in subject.plane] == ["load.ratio", "lash.backlash_deg"]
        text = AXES + values("lash.contact.damping", [50.0, 94.0])
        three = Subject(sweep(study_from_text(NOMINAL + EXACT + text)))
        assert [axis.parameter for axis in three.plane] == ["load.ratio", "lash.backlash_deg"]
        assert [axis.parameter for axis in three.slices] == ["lash.contact.damping"]
        part = three.results.at({"lash.contact.damping": 94.0})
        assert np.array_equal(part.sequence[..., 0], subject.results.sequence)

    def test_a_run_is_that_of_its_cell(self, subject):
        run = subject.run(CELL, {}).trajectory
        cell = subject.results.cell(CELL)
        assert (run.label, run.severity, run.touches) == (cell["label"], cell["severity"], cell["touches"])

    def test_map_boundaries_and_run_with_other_numbers_are_those_of_the_config(self, subject, monkeypatch):
        monkeypatch.setattr("clunk.explorer.subject._LONGEST", 600.0)  # s: boundaries are traced on a slow machine, too
        monkeypatch.setattr("clunk.analysis.lines._ON_ANY_MAP", 100_000)  # with all, either tracing takes 3 s
        numbers, cell = {"lash.contact.damping": 40.0}, {"load.ratio": 7.5, "lash.backlash_deg": 10.0}
        *_, traced = subject.maps({}, numbers, subject.results.lash_names[0], lambda *_: None)
        config = study_from_text(subject.config(cell, numbers))
        again = sweep(config)
        assert again.config_digest == traced.config_digest
        assert np.array_equal(again.severity, traced.severity)
        assert np.array_equal(again.label_map, traced.label_map)
        assert len(traced.boundaries.curves) > 3
        assert np.array_equal(traced.boundaries.vertices, with_boundaries(config, again).boundaries.vertices)
        assert np.array_equal(simulate(config).events, subject.run(cell, numbers).trajectory.events)

    def test_of_runs_of_a_sample_the_map_is_a_strip(self):
        text = NOMINAL + EXACT + drawn("samples", "load.ratio", "uniform", low=2.0, high=8.0)
        results = sweep(study_from_text(text + "[sweep.sampling]\ncount = 4\n"))
        sampled = Subject(results)
        assert [axis.parameter for axis in sampled.plane] == ["run"]
        ratio = float(results.coordinates[0].values[2])
        assert sampled.values({"run": 3.0}) == {"load.ratio": ratio}
        assert sampled.run({"run": 3.0}, {}).trajectory.severity == results.severity[2]
        assert picture(results, "severity")["points"]["data"]["y"].tolist() == results.severity.tolist()

    def test_the_config_of_a_sample_gives_its_map_whichever_run_is_looked_at(self):
        text = NOMINAL + EXACT + drawn("samples", "load.ratio", "normal", draws="factor", std=0.1)
        results = sweep(study_from_text(text + "[sweep.sampling]\ncount = 4\n"))
        again = sweep(study_from_text(Subject(results).config({"run": 3.0}, {})))
        assert np.array_equal(again.severity, results.severity)

    def test_of_one_cell_there_is_a_run_and_no_map(self):
        alone = Subject(sweep(with_cells(study_from_text(NOMINAL + EXACT))))
        assert (alone.plane, alone.slices, alone.swept) == ((), (), ())
        numbers = {"load.ratio": 9.0}
        again = simulate(study_from_text(alone.config({}, numbers)))
        assert np.array_equal(alone.run({}, numbers).trajectory.events, again.events)
        assert again.study.sweep is None


class TestTolerances:
    """A small tolerance map: damping between half and double, in 8 draws."""

    @pytest.fixture
    def subject(self):
        text = AXES + drawn("tolerances", "lash.contact.damping", "uniform", low=47.0, high=188.0)
        return Subject(tolerance_map(study_from_text(NOMINAL + EXACT + text + "[sweep.sampling]\ncount = 8\n")))

    def test_a_cell_has_its_nominal_run_and_the_probability_of_each_label(self, subject):
        run = subject.run(CELL, {}).trajectory
        assert run.label == subject.results.labels[subject.results.nominal_sequence[1, 2]]
        text = subject.likelihood(CELL, subject.results.lash_names[0])
        assert text.startswith("of 8 draws: ")
        shares = [float(part.split()[-2]) for part in text.removeprefix("of 8 draws: ").split(", ")]
        assert shares == sorted(shares, reverse=True)
        assert sum(shares) == pytest.approx(100.0, abs=0.5)  # three figures of each


class TestPictures:
    def test_pixels_have_the_colours_of_the_labels_of_their_cells(self, subject):
        changes, label = picture(subject.results, "label"), subject.results.cell(CELL)["label"]
        colours = pixels(changes)
        assert colours[colours.shape[0] // 2, colours.shape[1] // 2] == colour_of(label)
        assert all(escape(label) in changes["legend"]["text"] for label in subject.results.label_map.ravel())

    def test_a_first_picture_of_few_values_lies_on_the_logarithmic_axis_of_all(self):
        ratio = '[[sweep.axes]]\nparameter = "load.ratio"\nstart = 0.5\nstop = 50.0\ncount = 50\nscale = "log"\n'
        results = sweep(study_from_text(NOMINAL + EXACT + ratio + axis("lash.backlash_deg", 0.0, 20.0, 21)))
        few = tuple(replace(each, values=each.few(31)) for each in results.axes)
        assert results.axes[0].is_geometric
        assert not few[0].is_geometric  # spaced by 1 and 2
        coarse = sweep_cells(study_from_text(results.config), Design(few))
        assert coarse.shape == (31, 21)
        page = MapFigure(Subject(results).plane)
        whole, first = (pixels(page.changes(each, "regimes")) for each in (results, coarse))
        # but for edges of regions, off by half a coarse cell at most: 0.91; where pixels lie elsewhere 0.10
        assert np.mean(whole == first) > 0.85

    def test_where_every_cell_has_failed_the_legend_says_so_and_no_quantity_is_drawn(self):
        of_one = '[solver]\nmethod = "exact"\nmax_events = 1\n' + axis("load.ratio", 2.0, 10.0, 5)
        failed = sweep(study_from_text(NOMINAL + of_one))
        assert "failed: 5 cells" in picture(failed, "regimes")["legend"]["text"]
        with pytest.raises(PlotError, match=r"no severity to draw: .* in any cell; all runs have failed"):
            picture(failed, "severity")
        drawn_too = drawn("tolerances", "lash.radius", "normal", draws="factor", std=0.01)
        no_label = tolerance_map(study_from_text(NOMINAL + of_one + drawn_too + "[sweep.sampling]\ncount = 4\n"))
        assert "failed: 5 cells" in picture(no_label, "regimes")["legend"]["text"]


class TestRuns:
    @pytest.mark.parametrize("axes", ["", AXES[: AXES.rindex("[[")], AXES])
    def test_a_run_comes_with_its_header_and_events_in_one_message(self, axes, monkeypatch):
        """Each message lays the page out again."""
        sent, waiting = [], queue.Queue()
        monkeypatch.setattr(Message, "send", lambda _, changes: sent.append(changes))
        monkeypatch.setattr(Document, "add_next_tick_callback", lambda _, change: waiting.put(change))
        study = study_from_text(NOMINAL + EXACT + axes)
        workbench = Workbench(document := Document(), Subject(sweep(study if axes else with_cells(study))), {})
        try:
            document.callbacks.trigger_event(DocumentReady())
            while not any("curves" in changes for changes in sent):
                waiting.get(timeout=60.0)()
        finally:
            workbench.close()
        (run,) = (changes for changes in sent if "curves" in changes)
        assert "severity Q" in run["header"]["text"]
        assert run["events"]["text"].count("<tr>") > 3
        assert not [changes for changes in sent if "header" in changes and changes is not run]

    def test_where_lines_take_too_long_the_map_is_shown_without_them(self, subject, monkeypatch):
        """What progress there was is not said any more."""
        sent, waiting = [], queue.Queue()
        monkeypatch.setattr(Message, "send", lambda _, changes: sent.append(changes))
        monkeypatch.setattr(Document, "add_next_tick_callback", lambda _, change: waiting.put(change))
        monkeypatch.setattr("clunk.explorer.subject._LONGEST", 0.0)
        monkeypatch.setattr("clunk.explorer.workbench._OFTEN", 0.0)
        workbench = Workbench(document := Document(), subject, {"lash.contact.damping": "50"})
        try:
            document.callbacks.trigger_event(DocumentReady())
            workbench._newest_map._worker.submit(lambda: None).result()  # behind the map
            while not waiting.empty():
                waiting.get()()
        finally:
            workbench.close()
        told = [changes["status"]["text"] for changes in sent if "status" in changes]
        assert any(" runs" in text for text in told)
        assert told[-1].startswith("the map with these numbers")


class TestControls:
    def test_there_is_a_slider_for_each_number_that_is_not_swept_and_changes_something(self, subject):
        keys = adjustable(subject.study, {"load.ratio", "lash.backlash_deg"})
        assert "lash.contact.stiffness" in keys
        assert not {"load.ratio", "lash.contact.restitution", "load.step_time"} & set(keys)

    @pytest.mark.parametrize("name", sorted(path.stem for path in CONFIGS.glob("*.toml")))
    def test_the_numbers_of_every_config_have_sliders(self, name):
        study = load_study(CONFIGS / f"{name}.toml")
        for key, value in adjustable(study, set()).items():
            known = located(study, key)[1]
            assert known.allows(value)
            assert not known.allows(np.inf)
            start, end, step = slider_range(value, known)
            assert start < end
            assert step > 0.0

    def test_numbers_are_whole_where_the_config_s_are_and_of_a_size_that_can_be_meant(self, subject):
        controls = Controls(subject.study, subject.plane, set(CELL), lambda: None, 0)
        controls.set({"load.on": 2.4, "lash.contact.damping": 1e300, "lash.contact.stiffness": 3e5})
        assert controls.numbers == {"load.on": 2.0, "lash.contact.stiffness": 3e5}

    @pytest.mark.parametrize(("typed", "taken"), [(99.0, 10.0), (1e308, 10.0), (-1.0, 2.0), (np.inf, 6.0)])
    def test_the_value_of_an_axis_that_is_nearest_is_taken(self, subject, typed, taken):
        controls = Controls(subject.study, subject.plane, set(CELL), lambda: None, 0)
        controls.set({"lash.backlash_deg": typed})
        assert controls.cell["lash.backlash_deg"] == taken


@pytest.fixture(scope="module")
def explorer(subject):
    running = explore(subject.results, browser=False)
    yield running
    running.stop()


def answer(explorer, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", explorer.port, timeout=10)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    response = connection.getresponse()
    body = response.read() if response.status != 101 else b""
    connection.close()
    return response.status, dict(response.getheaders()), body


class TestServer:
    def test_the_page_comes_from_this_machine_alone(self, explorer):
        token = explorer.url.split("/")[3]
        status, headers, body = answer(explorer, f"/{token}/")
        assert status == 200
        assert headers["Content-Security-Policy"].startswith("default-src 'self'")
        assert b"https://" not in body
        status, headers, body = answer(explorer, f"/{token}/autoload.js?bokeh-autoload-element=page")
        assert status == 200
        assert b"https://" not in body
        assert not [name for name in headers if name.startswith("Access-Control")]
        assert explorer.url.startswith("http://127.0.0.1:")
        assert len(token) >= 20

    @pytest.mark.parametrize("path", ["/", "/ws", "/static/js/bokeh.min.js", "/autoload.js", "/wrong/"])
    def test_without_the_token_there_is_nothing(self, explorer, path):
        assert answer(explorer, path)[0] == 404

    @pytest.mark.parametrize(
        "path",
        ["static/../../../../etc/passwd", "static/%2e%2e/%2e%2e/server/server.py", "static//etc/passwd", "static/js/"],
    )
    def test_no_path_leads_to_another_file(self, explorer, path):
        assert answer(explorer, f"/{explorer.url.split('/')[3]}/{path}")[0] in (403, 404)

    @pytest.mark.parametrize(("origin", "status"), [("http://example.com", 403), (None, 101)])
    def test_a_page_of_another_origin_cannot_connect(self, explorer, origin, status):
        token = explorer.url.split("/")[3]
        headers = {
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec_WebSocket_Version": "13",
            "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec_WebSocket_Protocol": "bokeh, none",
            "Origin": origin or explorer.url.rsplit("/", 2)[0],
        }
        assert answer(explorer, f"/{token}/ws", **headers)[0] == status

    def test_a_port_in_use_is_said_to_be(self, explorer, subject):
        with pytest.raises(ClunkError, match=f"Port {explorer.port} of this machine cannot be used: address already"):
            explore(subject.results, port=explorer.port, browser=False)


def test_titles_and_names_are_text():
    hostile = "<script>alert(1)</script>"
    text = f'title = "{hostile}"\n' + NOMINAL.replace("[lash]", f'[lash]\nname = "{hostile}"')
    Workbench(document := Document(), Subject(sweep(study_from_text(text + EXACT + AXES))), {}).close()
    assert escape(hostile) in document.get_model_by_name("title").text
    assert hostile not in document.get_model_by_name("title").text
    assert not document.get_model_by_name("of lash").visible


def test_what_cannot_be_explored_is_said(tmp_path):
    outcome = CliRunner().invoke(cli, ["explore", str(tmp_path / "none.h5")])
    assert "none.h5 cannot be read" in str(outcome.exception)


def test_without_bokeh_the_command_names_the_package_to_install(tmp_path):
    command = "import sys; sys.modules['bokeh'] = None; from clunk.cli import main; main()"
    arguments = [sys.executable, "-c", command, "explore", str(tmp_path / "map.h5")]
    run = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "pip install 'clunk[explore]'" in " ".join(run.stderr.split())


def test_numbers_that_are_not_allowed_are_refused_by_the_rules_of_a_config(subject):
    with pytest.raises(ClunkError, match="stiffness"):
        subject.run(CELL, {"lash.contact.stiffness": -1.0})
