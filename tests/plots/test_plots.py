"""Plots: what is drawn, where, and with which labels."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from contactimg.plots import (
    crop_to,
    image_axes,
    legend_of_circles,
    plot_area,
    plot_circles,
    plot_image,
    plot_scale_bar,
)
from contactimg.pose import Pose


def test_image_axes_have_one_screen_pixel_a_pixel():
    assert tuple(image_axes((1200, 1600)).figure.canvas.get_width_height()) == (1600, 1200)
    assert tuple(image_axes((300, 700)).figure.canvas.get_width_height()) == (2100, 900)


def test_crop_holds_the_points_and_a_margin_and_keeps_their_place():
    image = np.arange(5000.0).reshape(50, 100)
    part, top, left = crop_to(image, np.array([20.0, 40.0]), np.array([10.0, 48.0]), margin_px=5)
    assert (top, left, part.shape) == (5, 15, (45, 31))
    assert part[0, 0] == image[5, 15]
    assert crop_to(image, np.array([]), np.array([]), margin_px=5)[0] is image
    nowhere = np.array([np.inf, 20.0, np.nan, 1e300]), np.array([3.0, 10.0, 4.0, 48.0])  # a damaged table
    cut, *corner = crop_to(image, *nowhere, margin_px=5)
    assert (corner, cut.shape) == ([5, 15], (45, 85))
    ax = plot_image(part, top=top, left=left)
    assert ax.get_xlim() == (14.5, 45.5)
    assert ax.get_ylim() == (49.5, 4.5)


def test_image_spans_its_pixels_with_centres_at_integers():
    ax = plot_image(np.arange(20.0).reshape(4, 5))
    assert ax.get_xlim() == (-0.5, 4.5)
    assert ax.get_ylim() == (3.5, -0.5)  # y runs down


def test_image_of_holes_and_constant_image_draw():
    for image in (np.full((4, 5), np.nan), np.zeros((4, 5))):
        ax = plot_image(image)
        ax.figure.canvas.draw()
        low, high = ax.images[0].get_clim()
        assert low < high


def test_circles_are_drawn_where_and_as_large_as_asked():
    ax = plot_image(np.zeros((60, 80)))
    plot_circles([40.0], [20.0], [10.0], ax=ax, color="white", linewidth=2)
    ax.figure.canvas.draw()
    shown = np.asarray(ax.figure.canvas.buffer_rgba())[..., 0].astype(float)
    zoom = shown.shape[1] / 80
    rows, columns = np.nonzero(shown > 128)
    radius = np.hypot(columns / zoom - 40.5, rows / zoom - 20.5)
    np.testing.assert_allclose(radius, 10, atol=0.5)
    assert np.ptp(columns) / zoom > 19


def test_legend_names_each_set_of_circles():
    ax = plot_image(np.zeros((60, 80)))
    sets = [plot_circles([1.0], [1.0], [1.0], ax=ax, label=label) for label in ("measured", "predicted")]
    legend_of_circles(sets, ax=ax, title="frame")
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["measured", "predicted"]


def test_legend_of_no_circles_draws():
    ax = plot_image(np.zeros((60, 80)))
    legend_of_circles([plot_circles([], [], [], ax=ax, label="measured (0)")], ax=ax)
    ax.figure.canvas.draw()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["measured (0)"]


def test_scale_bar_is_a_round_length():
    ax = plot_scale_bar(Pose((1200, 1600), 6e-6), ax=plot_image(np.zeros((1200, 1600))))
    # a sixth of 9.6 mm is 1.6 mm: the round length below is 1 mm, 166.7 pixels
    assert ax.texts[0].get_text() == "1 mm"
    assert np.ptp(ax.lines[0].get_xdata()) == pytest.approx(1e-3 / 6e-6)


def test_area_has_units_and_leaves_out_frames_without_load():
    frames = pd.DataFrame({"load_N": [0.1, np.nan], "area_m2": [1e-7, 2e-7], "area_std_m2": [1e-9, 1e-9]})
    ax = plot_area(frames)
    assert "mN" in ax.get_xlabel()
    assert "mm²" in ax.get_ylabel()
    assert ax.lines[0].get_xdata().tolist() == [100.0]


def test_plots_is_reached_from_the_package():
    code = "import contactimg; assert callable(contactimg.plots.plot_area); assert 'plots' in dir(contactimg)"
    subprocess.run([sys.executable, "-c", code], check=True)  # noqa: S603 - fixed code
