"""Outlines of ellipses: their light has area, half-axes and direction of the ellipse, rough or not."""

import numpy as np
import pytest

from contactimg.optics.psf import gaussian_psf
from contactimg.optics.spots import Spots, elliptic_outlines, rough_outlines, spots_image


@pytest.mark.parametrize("rms", [0.0, 0.3])
@pytest.mark.parametrize(("a", "b", "angle"), [(9.0, 6.0, 0.4), (14.0, 2.5, -1.1), (5.0, 5.0, 0.0)])
def test_moments_of_the_light_are_those_of_the_ellipse(a, b, angle, rms):
    circle = np.sqrt(a * b)
    waves = rough_outlines([circle], rms_px=rms, rng=np.random.default_rng(3)) if rms else np.zeros((1, 1))
    outline = elliptic_outlines([a], [b], [angle], outline_px=waves)
    one, shape = np.ones(1), (40, 50)
    spots = Spots(24.3 * one, 18.8 * one, circle * one, one, outline)
    image = spots_image(spots, shape=shape, psf=gaussian_psf(0.6, sampling=8))
    assert image.sum() == pytest.approx(np.pi * a * b, rel=2e-3)
    y, x = np.indices(shape)
    dx, dy = x - 24.3, y - 18.8
    along, across = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
    # second moments a^2/4 and b^2/4, and those of blur and pixel; waves change them by rms/b
    for place, half_axis in ((along, a), (across, b)):
        moment = (image * place**2).sum() / image.sum() - 0.6**2 - 1 / 12
        assert 2 * np.sqrt(moment) == pytest.approx(half_axis, rel=0.01 + rms / b)
