"""The page of a run: its parts, nothing from outside, hostile names, and a browser if there is one."""

import base64
import io
import json
import re
import tempfile
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from browser import BROWSER, Browser
from PIL import Image
from small_series import TINY, copy_of, write_small_series

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import read_run
from contactimg.report import build_report
from contactimg.report.page import LEAST_WIDTH_PX, embed_picture
from contactimg.report.summary import headlines

HOSTILE = '<script>alert(1)<b>&".tif'  # the name of a frame of the run
SECTIONS = ["summary", "frames", "overlays", "flags", "failed", "provenance"]


class Page(HTMLParser):
    """Tags with their attributes, and the text outside scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.inside = [], [], None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.inside = tag

    def handle_endtag(self, tag):
        self.inside = None

    def handle_data(self, data):
        if self.inside not in ("script", "style"):
            self.text.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def sections(self):
        return [attributes["id"] for attributes in self.all("section")]


def process(series, target):
    assert main(["process", str(series), "-o", str(target), "--quiet", "--workers", "1"]) in (0, 1)
    return target


@pytest.fixture(scope="module")
def run(finished):
    return finished


@pytest.fixture(scope="module")
def html(run):
    """The report as it is written."""
    return build_report(run)


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_frames_whose_contacts_lack_forces_do_not_enter_the_slope(run):
    def slope(run):
        name, text, _ = headlines(run)[0]
        return name, float(text.split()[0])

    whole = read_run(run)
    last, contacts = whole.contacts["frame"] == "frame_3.tif", whole.contacts.copy()
    contacts.loc[contacts.index[last][::3], "force_N"] = np.nan  # of a third: said in its message
    assert slope(replace(whole, contacts=contacts)) == slope(whole) == ("ΣF/P", pytest.approx(1, abs=0.02))
    contacts.loc[last & (contacts["label"] > 10), "force_N"] = np.nan
    frames = whole.frames.assign(
        force_sum_N=whole.frames["force_sum_N"].mask(whole.frames["load_N"] > 0.03, 0.01)
    )
    assert slope(replace(whole, contacts=contacts, frames=frames)) == ("ΣF/P", pytest.approx(1, abs=0.02))


def test_every_part_is_there(page):
    assert page.sections == [*SECTIONS[:3], "predicted", "analysis", *SECTIONS[3:]]
    text = " ".join(page.text)
    for part in ("A ~ P", "frame_2.tif", "BEYOND_HERTZ", "area_exponent", "coupled", "schema_version"):
        assert part in text
    # two pictures of frames, two with predictions, figures of the analysis, the viewer's empty one
    sources = [attributes.get("src") for attributes in page.all("img")]
    assert sum(str(source).startswith("data:image/jpeg;base64,") for source in sources) == 4
    assert sum(str(source).startswith("data:image/svg+xml;base64,") for source in sources) >= 3
    assert sources.count(None) == 1


def test_a_page_is_made_without_temporary_files(run, monkeypatch):
    # a command that is killed leaves them
    monkeypatch.setattr(tempfile, "mkdtemp", lambda *_, **__: pytest.fail("a temporary folder"))
    assert "data:image/svg+xml" in build_report(run)


def test_the_first_page_says_what_was_measured_and_what_is_wrong(html):
    first = " ".join(Page(html[: html.index('id="frames"')]).text)
    assert "Smooth lens of radius 128.8 mm on textured rubber: 3 frames" in first
    for part in ("E = 3.000 ± 0.030 MPa", "exponent m of A ~ P", "95 % interval", "real contact area", "mm²"):
        assert part in first
    # the reason as it is, with the name of the file as the file is called
    assert "1 of 3 frames has the status “failed” (frame_2.tif): frame_2.tif" in first


def test_area_is_drawn_once_and_captions_are_sentences(html):
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", html)
    assert sum("area A against load P" in caption for caption in captions) == 1
    assert all(caption.endswith(".") for caption in captions)
    shown = " ".join(Page(html[: html.index('id="provenance"')]).text)
    assert not re.search(r"\d[eE][+-]?\d", shown)  # numbers as a person writes them


def test_pictures_share_a_limited_size(tmp_path):
    noise = np.random.default_rng(1).integers(0, 255, (600, 800), np.uint8)
    path = tmp_path / "noise.png"
    Image.fromarray(noise).save(path)
    for most in (400_000, 150_000):
        source = embed_picture(path, caption="", most_bytes=most).source
        content = base64.b64decode(source.split(",", maxsplit=1)[1])
        with Image.open(io.BytesIO(content)) as image:
            assert len(content) <= most or image.width == LEAST_WIDTH_PX
            assert image.width / image.height == pytest.approx(4 / 3, rel=0.01)


def test_the_page_refers_to_nothing_outside(html, page):
    for tag, attributes in page.tags:
        for name in ("src", "href", "action", "data", "poster", "srcset"):
            if name in attributes:
                assert attributes[name].startswith(("data:", "#")), (tag, name)
    assert not page.all("link")
    policy = next(a for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy["content"]
    assert not re.search(r"url\(|@import|fetch\(|XMLHttpRequest", html)


def test_links_lead_to_parts_of_the_page(page):
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names))
    targets = {attributes["href"].removeprefix("#") for attributes in page.all("a")}
    assert targets <= set(names)


def test_hostile_names_stay_text(html, page):
    assert HOSTILE in " ".join(page.text)
    assert len(page.all("script")) == 1  # the viewer's own
    assert not page.all("b") or all(tag != "alert" for tag, _ in page.tags)
    assert "<script>alert" not in html
    captions = [attributes.get("alt") for attributes in page.all("img")]
    assert any(HOSTILE in str(caption) for caption in captions)


def test_failed_frames_are_named_with_their_reason(page):
    text = " ".join(page.text)
    failed = text[text.index("Failed frames", text.index("Flags and rejected")) :]
    assert "frame_2.tif" in failed
    assert "None." not in failed[:200]


def test_a_run_without_failures_pictures_or_loads(small_series, tmp_path):
    series = copy_of(small_series, tmp_path / "series")
    (series / "loads.csv").unlink()
    scene = (series / "scene.toml").read_text(encoding="utf-8").replace('loads = "loads.csv"\n', "")
    (series / "scene.toml").write_text(scene, encoding="utf-8")
    folder = tmp_path / "run"
    assert main(["process", str(series), "-o", str(folder), "--quiet", "--no-pictures"]) == 0
    page = Page(build_report(folder))
    text = " ".join(page.text)
    assert page.sections == SECTIONS
    assert "0 of 0 pictures" in text
    assert "No frame has both a load and an area" in text
    assert "None." in text
    record = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    del record["pose"]  # as after a run without a pixel size
    (folder / "provenance.json").write_text(json.dumps(record), encoding="utf-8")
    assert "µm per pixel" in text
    assert "µm per pixel" not in " ".join(Page(build_report(folder)).text)


def test_at_most_so_many_pictures_the_first_and_the_last_among_them(run):
    page = Page(build_report(run, max_pictures=1))
    assert "1 of 2 pictures" in " ".join(page.text)


def test_a_calibration_is_shown(run, tmp_path):
    folder = tmp_path / "jkr"
    folder.mkdir()
    numbers = {"young_modulus": {"value": 3.01e6, "std": 2e4, "unit": "Pa"}, "fitted": ["young_modulus"]}
    (folder / "calibration.json").write_text(json.dumps(numbers), encoding="utf-8")
    record = {"command": "contactimg calibrate jkr smooth", "schema_version": 1, "configuration": {}}
    record["outputs"] = ["calibration.json", "fit.png"]
    (folder / "provenance.json").write_text(json.dumps(record), encoding="utf-8")
    picture = base64.b64decode(
        "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNgAAAAAgABSK+kcQAAAABJRU5ErkJggg=="
    )
    (folder / "fit.png").write_bytes(picture)
    page = Page(build_report(run, others=[folder]))
    text = " ".join(page.text)
    assert "calibration" in page.sections
    assert "3.010 ± 0.020 MPa" in text
    assert "MPa" in text
    assert "data:image/png;base64," in str([a.get("src") for a in page.all("img")])


def test_what_is_no_run_is_refused(tmp_path, run):
    with pytest.raises(InputError, match="holds no run"):
        build_report(tmp_path)
    with pytest.raises(InputError, match="holds no output"):
        build_report(run, others=[tmp_path])
    other = tmp_path / "other"
    other.mkdir()
    record = {"command": "contactimg simulate a.toml", "schema_version": 1, "configuration": {}}
    (other / "provenance.json").write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(InputError, match="not of overlay, analyse or calibrate"):
        build_report(run, others=[other])


def test_the_command_writes_the_page_beside_the_run(tmp_path, capsys):
    series = write_small_series(tmp_path / "series", TINY)
    folder = process(series, tmp_path / "run")
    assert main(["report", str(folder)]) == 0
    assert "report.html" in capsys.readouterr().out
    assert (folder / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert main(["report", str(folder), "--quiet", "-o", str(tmp_path / "page.html")]) == 0
    # a second run replaces the first and leaves the page
    process(series, folder)
    assert (folder / "report.html").exists()
    assert len(pd.read_csv(folder / "frames.csv")) == 3


@pytest.fixture(scope="module")
def browser(html, tmp_path_factory):
    """A browser with a fresh profile, and the address of the page."""
    pytest.importorskip("websocket")
    folder = tmp_path_factory.mktemp("browser")
    (folder / "page.html").write_text(html, encoding="utf-8")
    with Browser(folder) as page:
        yield page, (folder / "page.html").as_uri()


def opened(browser, address, ready="document.images.length > 3"):
    """The page's elements after its script has run, on a page that was opened anew."""
    browser.open("about:blank", "true")
    browser.open(address, ready)
    return Page(browser.evaluate("document.documentElement.outerHTML"))


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
def test_a_browser_opens_the_page_and_its_viewer(browser):
    browser, address = browser
    page = opened(browser, address)
    assert [name for name in SECTIONS if name not in page.sections] == []
    assert "open" not in page.all("dialog")[0]
    page = opened(browser, f"{address}#overlay-1", "document.querySelector('#viewer img').style.transform")
    assert "open" in page.all("dialog")[0]
    viewer = page.all("img")[-1]  # the dialog is the last part of the page
    assert viewer["src"].startswith("data:image/jpeg;base64,")
    assert "scale(" in viewer["style"]
    assert HOSTILE in " ".join(page.text)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")
def test_the_page_fits_a_phone_and_a_few_sheets_of_paper(browser):
    browser, address = browser
    browser.resize(390, 844)
    opened(browser, address)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    printed = base64.b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert len(printed) < 5e6
    sheets = len(re.findall(rb"/Type\s*/Page\b(?!s)", printed))
    assert 2 <= sheets <= 3  # one, and one for two frames: of three frames, with predictions and an analysis
