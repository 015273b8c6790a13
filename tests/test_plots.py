"""Plots: what is drawn, where, and with which labels."""

import numpy as np
import pandas as pd
import pytest

from contactimg.plots import (
    image_axes,
    legend_of_circles,
    plot_area,
    plot_circles,
    plot_image,
    plot_scale_bar,
)
from contactimg.pose import Pose


def test_image_axes_have_one_screen_pixel_a_pixel():
    figure = image_axes((900, 1200)).figure
    assert tuple(figure.canvas.get_width_height()) == (1200, 900)


def test_image_spans_its_pixels_with_centres_at_integers():
    ax = plot_image(np.arange(20.0).reshape(4, 5))
    assert ax.get_xlim() == (-0.5, 4.5)
    assert ax.get_ylim() == (3.5, -0.5)  # y runs down


def test_image_of_holes_and_constant_image_draw():
    plot_image(np.full((4, 5), np.nan)).figure.canvas.draw()
    plot_image(np.zeros((4, 5))).figure.canvas.draw()


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
