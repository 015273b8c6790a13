"""A scripted browser on the page: random edits, and tables like those of `process`."""

import json
import re
import threading

import numpy as np
import pandas as pd
import pytest
from browser import BROWSER, CONTROL, Browser
from review_runs import moved, process

from contactimg.files import read_edits
from contactimg.review import ReviewServer, Session

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
READY = "window.review && review.state.contacts.length && review.state.curves"
TABLES = ("contacts.csv", "frames.csv", "rejected.csv")
SHIFT = 8


@pytest.fixture(scope="module")
def review(small_run, tmp_path_factory):
    """Series, folder of it and its run, and the address of the page."""
    top = moved(small_run, tmp_path_factory.mktemp("page") / "top")
    session = Session(top / "run", workers=1)
    with ReviewServer(session) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield top / "series", top, server.address
        server.shutdown()
    session.close()


@pytest.fixture(scope="module")
def browser(review, tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("browser"), size=(1000, 700)) as page:
        page.open(review[2], READY)
        yield page


class Hand:
    """Edits by mouse and keyboard, chosen by chance."""

    def __init__(self, page, rng):
        self.page, self.rng = page, rng

    def places(self):
        """Places of the contacts on the page and their radii, px of the screen."""
        code = """(() => { const box = document.getElementById('view').getBoundingClientRect();
            return review.state.contacts.map((one) => { const [x, y] = review.toScreen(one.x, one.y);
                return [x + box.left, y + box.top, one.minor * review.state.view.scale]; }); })()"""
        return np.array(self.page.evaluate(code))

    def some(self, count):
        places = self.places()
        return places[self.rng.choice(len(places), count, replace=False)]

    def exclude(self):
        self.page.click(*self.some(1)[0, :2])
        self.page.key("e")

    def add(self):
        (x, y, radius) = self.some(1)[0]
        x, y = x + self.rng.normal(0, 40), y + self.rng.normal(0, 40)
        self.page.key("a")
        self.page.drag((x, y), (x + radius / 2, y), (x + max(radius, 8), y + 1))
        self.page.key("v")

    def split(self):
        (x, y, radius) = self.some(1)[0]
        self.page.click(x, y)
        self.page.key("s")
        if self.rng.random() < 0.5:
            self.page.click(x - radius / 2, y)
            self.page.click(x + radius / 2, y + 2)
        self.page.key("Enter")

    def merge(self):
        (first, second) = self.some(2)
        self.page.click(*first[:2])
        self.page.click(*second[:2], modifiers=SHIFT)
        self.page.key("g")

    def mask(self):
        (x, y, radius) = self.some(1)[0]
        self.page.key("k")
        for angle in self.rng.uniform(0, 0.5) + np.arange(4) * np.pi / 2:
            self.page.click(x + 0.8 * radius * np.cos(angle), y + 0.8 * radius * np.sin(angle))
        self.page.key("Enter")
        self.page.key("v")

    def undo(self):
        self.page.key("z", modifiers=CONTROL)

    def redo(self):
        self.page.key("y", modifiers=CONTROL)


ACTIONS = {
    "exclude": 0.35,
    "add": 0.25,
    "split": 0.12,
    "merge": 0.1,
    "mask": 0.05,
    "undo": 0.09,
    "redo": 0.04,
}


@pytest.mark.slow
def test_a_selected_contact_shows_its_pixels_and_numbers(browser):
    """Of an image as it was measured: the tests below edit it."""
    browser.key("v")
    browser.click(*Hand(browser, np.random.default_rng(1)).some(1)[0, :2])
    browser.wait_for("document.getElementById('residual-caption').textContent.includes('%')")
    numbers = browser.evaluate("document.getElementById('numbers').innerText")
    assert re.search(r"radius \(px\)\s+[\d.]+ ± [\d.]+", numbers)
    spread = "(() => { const one = document.getElementById('%s'); return new Set(one.getContext('2d')"
    spread += ".getImageData(0, 0, one.width, one.height).data).size; })()"
    assert all(browser.evaluate(spread % name) > 10 for name in ("pixels", "model", "residual"))


@pytest.mark.slow
def test_tables_after_random_edits_are_those_of_process(review, browser, tmp_path):
    series, top, _ = review
    rng = np.random.default_rng(100)
    hand = Hand(browser, rng)
    for k in range(24):
        if k in (8, 16):
            browser.key("n")
            browser.wait_for(f"review.state.number === {k // 8} && {READY}")
        getattr(hand, str(rng.choice(list(ACTIONS), p=list(ACTIONS.values()))))()
        browser.wait_for("review.state.unsaved === 0")
        if k % 5:
            continue
        # what the page calls saved is on the disk
        assert browser.evaluate("review.state.run.edits.length") == len(read_edits(series / "edits.csv"))
    edits = read_edits(series / "edits.csv")
    assert len(edits) > 12
    assert set(edits["action"]) == {"exclude", "add", "split", "merge", "mask"}
    browser.key("m")
    browser.wait_for("review.state.run.job.number > 0 && !review.state.run.job.running")
    shown = {name: browser.evaluate(f"fetch('tables/{name}').then((one) => one.text())") for name in TABLES}
    batch = process(series, tmp_path / "batch")
    for name in TABLES:
        assert shown[name] == (batch / name).read_text(encoding="utf-8"), name
    assert shown["contacts.csv"] != (top / "run" / "contacts.csv").read_text(encoding="utf-8")
    assert "MANUAL" in shown["contacts.csv"]
    _check_numbers_on_the_page(browser, pd.read_csv(batch / "contacts.csv"))
    assert browser.complaints == []


def _check_numbers_on_the_page(browser, contacts):
    """Every digit that the page holds is that of the table."""
    name = browser.evaluate("review.state.run.frames[review.state.number].name")
    rows = contacts[contacts["frame"] == name]
    shown = json.loads(browser.evaluate("JSON.stringify(review.state.data.contacts)"))
    for column in ("x_px", "y_px", "radius_px", "force_N", "area_m2"):
        assert shown[column] == [None if np.isnan(value) else value for value in rows[column]]


@pytest.mark.slow
def test_the_slider_counts_without_a_request(browser):
    browser.wait_for(READY)
    before = browser.evaluate("performance.getEntriesByType('resource').length")
    move = "(() => { const one = document.getElementById('slider'); one.value = %d; "
    move += "one.dispatchEvent(new Event('input')); "
    move += "return document.getElementById('at-threshold').textContent; })()"
    texts = [browser.evaluate(move % k) for k in (2, 18, 34)]
    assert len(set(texts)) == 3
    assert browser.evaluate("performance.getEntriesByType('resource').length") == before


@pytest.mark.slow
def test_thousands_of_contacts_drag_and_zoom_without_lag(browser):
    """A picture is made in half of 1/60 s or less while 5000 contacts are dragged or zoomed."""
    code = """(() => { const all = review.state.contacts;
        const place = (k) => ({ ...all[k % all.length], x: (k * 37) % 230, y: (k * 91) % 220 });
        review.state.contacts = Array.from({ length: 5000 }, (_, k) => place(k)); review.redrawLayer();
        const middle = (move) => { review.state.drawTimes.length = 0;
            for (let k = 0; k < 31; k++) { move(review.state.view); review.draw(); }
            return review.state.drawTimes.slice().sort((a, b) => a - b)[15]; };
        const times = [middle((view) => { view.x += 1; }), middle((view) => { view.scale *= 1.01; })];
        review.state.contacts = all; review.redrawLayer(); return times; })()"""
    assert max(browser.evaluate(code)) < 8.0


def test_an_edit_can_be_undone_after_a_reload(browser, session):
    server = ReviewServer(session)
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
    browser.open(server.address, READY)
    browser.key("n")
    browser.wait_for(f"review.state.number === 1 && {READY}")
    hand = Hand(browser, np.random.default_rng(3))
    hand.exclude()
    browser.wait_for("review.state.undo.length === 1")
    browser.evaluate("void (window.before = true, location.reload())")
    browser.wait_for(f"!window.before && {READY}")
    assert browser.evaluate("review.state.number") == 1
    hand.undo()
    browser.wait_for("review.state.redo.length === 1")
    assert session.edits.read().empty
    session.insert([{"frame": "*", "action": "mask", "points": "1 1; 9 1; 9 9", "author": "another"}], None)
    browser.evaluate("void (window.before = true, location.reload())")
    browser.wait_for(f"!window.before && {READY}")
    assert browser.evaluate("review.state.redo.length") == 0  # the table is another one now
    server.shutdown()
    server.server_close()


@pytest.mark.slow
def test_an_edit_made_while_the_server_is_away_is_sent_when_it_is_back(browser, session):
    def serve(port=0, token=None):
        server = ReviewServer(session, port)
        server.token = token or server.token
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return server

    def end(server):
        server.shutdown()
        server.server_close()

    first = serve()
    browser.open(first.address, READY)
    end(first)
    # connections that are open are answered by nobody
    Hand(browser, np.random.default_rng(2)).exclude()
    browser.wait_for("document.getElementById('state').textContent.startsWith('NOT SAVED')")
    assert not session.edits.path.exists()
    second = serve(first.server_address[1], first.token)
    browser.wait_for("review.state.unsaved === 0")
    end(second)
    assert session.edits.read()["action"].tolist() == ["exclude"]
    assert browser.evaluate("document.getElementById('state').textContent") == "saved: exclude"
