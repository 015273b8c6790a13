"""Bright dots on a dark and uneven field, without a reference: they shine by themselves, and not equally."""

import cv2
import numpy as np
import pytest

from contactimg.imaging.measure import measure_image
from contactimg.tables import Status

SHAPE = (400, 560)


def glow():
    """A field that is three times as bright on one side."""
    x = np.arange(SHAPE[1]) / SHAPE[1]
    return np.broadcast_to(20 + 40 * x, SHAPE).astype(np.float32)


def dots(rng, spread):
    """Light of 90 dots that differ in brightness, x, y, radius and height of each."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float32)
    light, table = np.zeros(SHAPE, np.float32), []
    for place in rng.permutation(140)[:90]:
        cx = 40 * (place % 14) + 20 + rng.uniform(-6, 6)
        cy = 40 * (place // 14) + 20 + rng.uniform(-6, 6)
        radius, height = rng.uniform(3.0, 8.0), 90.0 * np.exp(spread * rng.standard_normal())
        light += height * np.clip(radius - np.hypot(x - cx, y - cy) + 0.5, 0, 1)
        table.append((cx, cy, radius, height))
    return light, np.array(table)


def found_share(image, table, **options):
    """Share of the dots that are found, disks that are none, and the measurement."""
    found = measure_image(image, polarity="bright", **options)
    places = found.disks[["x_px", "y_px"]].to_numpy()
    distance = np.hypot(*(places[None] - table[:, None, :2]).transpose(2, 0, 1))
    return np.mean(distance.min(axis=1) < 1.5), np.count_nonzero(distance.min(axis=0) > 3.0), found


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_dots_of_unequal_brightness_on_an_uneven_glow(method, rng):
    """Brightness scatters by 30 %, each fifteenth is at full scale: nine tenths are found, none invented."""
    light, table = dots(rng, 0.3)
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float32)
    for cx, cy, radius, height in table[::15]:
        light += max(300.0 - height, 0.0) * np.clip(radius - np.hypot(x - cx, y - cy) + 0.5, 0, 1)
    image = cv2.GaussianBlur(glow() + light, (0, 0), 1.1)
    image += rng.standard_normal(SHAPE) * np.sqrt(1.0 + image / 20.0)
    frame = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    share, invented, found = found_share(frame, table, method=method)
    assert share >= 0.9
    assert invented == 0
    assert found.status != Status.NO_CONTACT
