"""Plots: what is drawn, where, and with which labels."""

import numpy as np
import pandas as pd

import contactimg
from contactimg import plots
from contactimg.plots import crop_to, plot_area, plot_circles, plot_image


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
    shown[: len(shown) // 20], shown[-len(shown) // 20 :] = 0, 0  # the white rim of the figure
    rows, columns = np.nonzero(shown > 128)
    x, y = ax.transData.inverted().transform(np.column_stack([columns, len(shown) - 1 - rows])).T
    inside = (np.abs(x - 39.5) < 38) & (np.abs(y - 29.5) < 28)
    radius = np.hypot(x - 40, y - 20)[inside]
    np.testing.assert_allclose(radius, 10, atol=0.5)
    assert np.ptp(x[inside]) > 19


def test_area_has_units_and_leaves_out_frames_without_load():
    frames = pd.DataFrame({"load_N": [0.1, np.nan], "area_m2": [1e-7, 2e-7], "area_std_m2": [1e-9, 1e-9]})
    ax = plot_area(frames)
    assert "mN" in ax.get_xlabel()
    assert "mm²" in ax.get_ylabel()
    assert ax.lines[0].get_xdata().tolist() == [100.0]


def test_plots_is_reached_from_the_package(monkeypatch):
    monkeypatch.delattr(contactimg, "plots")  # which is there once it was imported
    assert "plots" in dir(contactimg)
    assert contactimg.plots is plots
