"""Figures in files: formats, bytes, captions; and figures of the calibrations."""

import re

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from contactimg.analysis.estimates import CoverageEstimate
from contactimg.files import write_figures
from contactimg.files.figures import FIGURE_FORMATS as FORMATS  # before the tests choose one of them
from contactimg.plots import CAPTIONS, caption_of, plot_forces, plot_jkr, plot_plateau
from contactimg.plots.numbers import number_with_interval, number_with_std, plain_number

THRESHOLDS = np.linspace(0.1, 0.9, 9)


def plateau(n=6, names=True):
    areas = np.linspace(1e-7, 1e-6, n) * np.exp(-THRESHOLDS)[:, None]
    called = [f"{k} mN" for k in range(n)] if names else []
    return plot_plateau(THRESHOLDS, areas, low=0.3, high=0.6, names=called)


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_a_figure_has_three_formats_with_the_same_bytes_each_time(tmp_path, monkeypatch):
    monkeypatch.setattr("contactimg.files.figures.FIGURE_FORMATS", FORMATS)
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_figures(plateau(), tmp_path / folder, "plateau", caption=CAPTIONS["plateau"])
    first, second = (sorted((tmp_path / folder).iterdir()) for folder in ("one", "two"))
    assert [path.name for path in first] == ["plateau.pdf", "plateau.png", "plateau.svg"]
    for one, two in zip(first, second, strict=True):
        assert one.read_bytes() == two.read_bytes(), one.name
    with Image.open(first[1]) as image:
        assert image.text["Description"] == CAPTIONS["plateau"]
        assert image.width >= 1000  # 300 pixels an inch in a column of 85 mm
    assert CAPTIONS["plateau"] in first[2].read_text(encoding="utf-8")


def test_captions_are_sentences():
    for name, caption in CAPTIONS.items():
        assert re.fullmatch(r"[A-Z].{30,}\.", caption), name
        assert re.search("rror bars|standard uncertainty", caption), name
    assert caption_of("profile_12") == CAPTIONS["profile"]


def test_curves_of_a_plateau_are_named_and_few():
    assert texts(plateau())[1:7] == ["5 mN", "4 mN", "3 mN", "2 mN", "1 mN", "0 mN"]
    named = [text for text in texts(plateau(200)) if text.endswith("mN")]
    assert len(named) == 8
    assert {"0 mN", "199 mN"} <= set(named)
    assert len(texts(plateau(names=False))) == 1  # the shade


def test_forces_show_the_fitted_slope_and_what_is_left():
    load = np.array([0.1, 0.2])
    ax = plot_forces(load, 1.1 * load, slope=CoverageEstimate(1.1, 0.01, 1.08, 1.12))
    assert "slope 1.100 (1.080 to 1.120)" in texts(ax)
    assert ax.figure.axes[1].lines[-1].get_ydata().tolist() == pytest.approx([10, 20])


def test_jkr_has_its_residuals_below_and_marks_what_is_not_used():
    points = pd.DataFrame({"load_N": [0.1, 0.2, 0.1], "radius_m": [1e-3, 2e-3, 1e-3], "residual_N": 1e-3})
    points = points.assign(branch=["loading", "loading", "unloading"], used=[True, False, True])
    curve = points[["load_N", "radius_m"]]
    ax = plot_jkr(points, curve, fitted=["E = 3.01 MPa"])
    assert texts(ax) == ["JKR fit\nE = 3.01 MPa", "loading", "unloading", "not used in the fit"]
    below = ax.figure.axes[1]
    assert [line.get_ydata().tolist() for line in below.lines[1:]] == [[1.0]] * 3
    assert "mN" in below.get_xlabel()


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (3.011e6, np.nan, "3011000"),
        (0.83897, 0.00037, "0.83897 ± 0.00037"),
        (0.04947, 8.1e-5, "0.049470 ± 0.000081"),
        (1.0, 0.0999, "1.00 ± 0.10"),
        (-0.0004, 0.01, "0.000 ± 0.010"),
        (1234.0, 99.6, "1230 ± 100"),
        (1e-12, 0.0, "1 × 10^-12"),
        (9.99996e-9, 0.0, "1 × 10^-8"),
        (np.inf, 1.0, "∞"),
    ],
)
def test_numbers_are_written_as_a_person_writes_them(value, std, text):
    assert number_with_std(value, std) == text


def test_an_interval_that_too_few_data_leave_open_is_not_passed_off_as_one():
    assert number_with_interval(CoverageEstimate(1.5, 0.02, -np.inf, np.inf)) == "1.500 ± 0.020 (no interval)"
    assert number_with_interval(CoverageEstimate(1.5, 0.0, 1.5, 1.5)) == "1.5"
    assert plain_number(np.nan) == "nan"
