"""One scene has one area: commands that say the same thing agree to the last digit."""

import re
from html import unescape

import pandas as pd
import pytest
from small_series import copy_of

from contactimg import read_scene
from contactimg.analysis.estimates import Estimate
from contactimg.cli import main
from contactimg.files import write_scene
from contactimg.plots.numbers import number_with_interval, number_with_std

LOADS = (0.005, 0.02, 0.05)


@pytest.fixture(scope="module")
def outputs(small_series, tmp_path_factory):
    """The folder with what predict, process, overlay, analyse and report wrote for one scene."""
    top = tmp_path_factory.mktemp("one")
    series, run = copy_of(small_series, top / "series"), top / "run"
    source = {name: dict(keys) for name, keys in read_scene(series).source.items()}
    source["effects"] |= {"model": "planned"}
    source.pop("tolerance", None)
    write_scene(source, series / "scene.toml")
    loads = [word for load in LOADS for word in ("--load-N", str(load))]
    with_both = ["--with", str(top / "overlay"), "--with", str(top / "analysis")]
    for words in (
        ["predict", str(series), *loads, "-o", str(top / "predicted")],
        ["process", str(series), "-o", str(run), "--no-pictures"],
        ["overlay", str(run), "-o", str(top / "overlay")],
        ["analyse", str(run), "-o", str(top / "analysis")],
        ["report", str(run), *with_both, "-o", str(top / "page.html")],
    ):
        assert main([*words, "--quiet"]) == 0
    return top


def test_the_predicted_area_is_the_same_in_predict_and_analyse(outputs):
    predicted = pd.read_csv(outputs / "predicted" / "frames.csv")
    areas = pd.read_csv(outputs / "analysis" / "area.csv")
    coupled = areas[areas["model"] == "coupled"]
    assert coupled["load_N"].tolist() == predicted["load_N"].tolist()
    assert coupled["area_m2"].tolist() == predicted["area_m2"].tolist()


def test_the_predicted_radii_are_the_same_in_predict_and_overlay(outputs):
    predicted = pd.read_csv(outputs / "predicted" / "contacts.csv")
    matches = pd.read_csv(outputs / "overlay" / "matches.csv")
    frames = sorted(matches["frame"].unique())
    assert len(frames) == len(LOADS)
    for frame, name in zip(frames, predicted["frame"].unique(), strict=True):
        of_predict = predicted[predicted["frame"] == name].set_index("asperity")["radius_m"]
        of_overlay = matches[matches["frame"] == frame].set_index("asperity")["radius_predicted_m"]
        assert len(of_overlay) > 3
        assert of_overlay.tolist() == of_predict.reindex(of_overlay.index).tolist()


def test_the_measured_area_is_the_same_in_process_and_analyse(outputs):
    frames = pd.read_csv(outputs / "run" / "frames.csv")
    contacts = pd.read_csv(outputs / "run" / "contacts.csv")
    areas = pd.read_csv(outputs / "analysis" / "area.csv")
    measured = areas[areas["model"] == "measured"]["area_m2"].tolist()
    assert measured == frames["area_m2"].tolist()
    assert contacts.groupby("frame")["area_m2"].sum().tolist() == pytest.approx(measured, rel=1e-14)


def test_the_report_shows_the_areas_of_process(outputs):
    page = unescape((outputs / "page.html").read_text(encoding="utf-8"))
    frames = pd.read_csv(outputs / "run" / "frames.csv")
    assert len(frames) == len(LOADS)
    for row in frames.itertuples():
        shown = re.search(rf"<tr><td>{re.escape(row.frame)}</td>.*?</tr>", page).group()
        assert f"<td>{number_with_std(1e6 * row.area_m2, 1e6 * row.area_std_m2)}</td>" in shown


def test_the_report_has_the_area_law_of_analyse(outputs):
    results = pd.read_csv(outputs / "analysis" / "results.csv").set_index(["quantity", "model"])
    stated = results.loc[("area_exponent", "measured")]
    page = unescape((outputs / "page.html").read_text(encoding="utf-8"))
    exponent = Estimate(stated["value"], stated["std"], stated["low"], stated["high"])
    assert number_with_interval(exponent) in page
