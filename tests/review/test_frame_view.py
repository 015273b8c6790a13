"""Contacts drawn for the residual picture, against masks of 16 times as many pixels each way."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from contactimg.review.frame_view import draw_contacts
from contactimg.tables.outlines import Outline

FINE, SIDE, MARGIN = 16, 32, 8


def drawn_finely(inside, blur):
    """The blurred mask of a shape, averaged over pixels."""
    count = (SIDE + 2 * MARGIN) * FINE
    y, x = (np.mgrid[:count, :count] + 0.5) / FINE - 0.5 - MARGIN
    blurred = gaussian_filter(inside(x, y).astype(float), blur * FINE, truncate=6)
    pixels = blurred.reshape(SIDE + 2 * MARGIN, FINE, -1, FINE).mean(axis=(1, 3))
    return pixels[MARGIN:-MARGIN, MARGIN:-MARGIN]


@pytest.mark.parametrize("blur", [0.4, 1.5])
@pytest.mark.parametrize("place", [(15.3, 14.8), (0.4, 31.2)])  # inside, and cut by the window
def test_ellipses_are_what_a_blurred_ellipse_shows(blur, place):
    shape = Outline(1, *place, 6.0, 3.5, 0.4)

    def inside(x, y):
        dx, dy = x - place[0], y - place[1]
        along, across = dx * np.cos(0.4) + dy * np.sin(0.4), dy * np.cos(0.4) - dx * np.sin(0.4)
        return np.hypot(along / 6.0, across / 3.5) < 1

    drawn = draw_contacts([shape], blur, (0, 0), (SIDE, SIDE))
    # the mask's edge is right to half of 1/16 px, and light rises by so much a pixel at most
    steepest = 1 / np.sqrt(2 * np.pi * (blur**2 + 1 / 12))
    np.testing.assert_allclose(drawn, drawn_finely(inside, blur), atol=steepest / 32)


def test_a_free_shape_has_its_holes():
    turn = np.linspace(0, 2 * np.pi, 400)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    lines = (16 + 9 * circle, 17 + 3 * circle[::-1])
    ring = draw_contacts([Outline(1, 16.0, 16.0, 9.0, 9.0, lines=lines)], 1.2, (0, 0), (SIDE, SIDE))
    expected = drawn_finely(lambda x, y: (np.hypot(x - 16, y - 16) < 9) & (np.hypot(x - 17, y - 17) > 3), 1.2)
    # lines are drawn to 1/8 px, and light rises by at most 1/sqrt(2 pi (1.2^2 + 1/12)) = 0.32 a pixel
    np.testing.assert_allclose(ring, expected, atol=0.32 / 8)


def test_a_window_shows_its_part():
    shapes = [Outline(1, 15.0, 14.0, 6.0, 6.0), Outline(2, 40.0, 14.0, 5.0, 5.0)]
    whole = draw_contacts(shapes, 1.0, (0, 0), (32, 48))
    part = draw_contacts(shapes, 1.0, (20, 8), (12, 20))
    np.testing.assert_allclose(part, whole[8:20, 20:40], atol=1e-5)
