"""Upper limits where no contact is seen: the light of blurred disks, and limits that hold."""

import numpy as np
import pytest
from scipy import ndimage

from contactimg.shear.unseen import _light_of_disks, limit_radii

BLUR, CONTRAST = 1.4, 100.0


def image_of(places, radii, noise, rng, *, shape=(420, 500), fine=8, blur=BLUR):
    """Blurred disks on noise: drawn on a grid 8 times as fine, blurred, averaged over the pixels."""
    drawn = np.zeros((shape[0] * fine, shape[1] * fine), np.float32)
    for (x, y), radius in zip(places, radii, strict=True):
        reach = int((radius + 1) * fine) + 2
        row, column = round((y + 0.5) * fine - 0.5), round((x + 0.5) * fine - 0.5)
        rows, columns = np.ogrid[row - reach : row + reach + 1, column - reach : column + reach + 1]
        distance = np.hypot((columns + 0.5) / fine - 0.5 - x, (rows + 0.5) / fine - 0.5 - y)
        drawn[rows, columns] += distance <= radius
    blurred = ndimage.gaussian_filter(drawn, blur * fine) if drawn.any() else drawn
    pixels = blurred.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))
    return (CONTRAST * pixels + rng.normal(0, noise, shape)).astype(np.float32)


def test_light_of_a_disk_is_that_of_its_blurred_picture(rng):
    sizes, light = _light_of_disks(2.24, BLUR)
    y, x = np.mgrid[-80:81, -80:81] / 8
    for radius in (0.5, 1.5, 3.0):
        blurred = ndimage.gaussian_filter((np.hypot(x, y) <= radius).astype(float), BLUR * 8)
        seen = blurred[np.hypot(x, y) <= 2.24].sum() / 64
        # a disk of radius 4 on a grid of eighths is known to 2 % of its area, the aperture to 0.5 %
        assert np.interp(radius, sizes, light) == pytest.approx(seen, rel=0.03)
    # a small disk sends 1 - exp(-R^2/(2 s^2)) of its light, pi a^2, into the aperture
    small = np.pi * 0.2**2 * (1 - np.exp(-(2.24**2) / (2 * BLUR**2)))
    assert np.interp(0.2, sizes, light) == pytest.approx(small, rel=0.02)


@pytest.mark.parametrize("radius", [0.0, 0.3, 0.6])
def test_limits_hold_in_95_percent(radius, rng):
    # 300 places between contacts, at any fraction of a pixel
    grid = np.stack(np.meshgrid(np.arange(20, 490, 23), np.arange(20, 410, 26)), -1).reshape(-1, 2)
    places = grid + rng.uniform(-0.5, 0.5, grid.shape)
    image = image_of(places, np.full(len(places), radius), 3.0, rng)
    limits = limit_radii(image, places, contrast=CONTRAST, blur_px=BLUR, contacts=np.empty((0, 3)))
    share = np.mean(limits >= radius)
    # three standard deviations of a share of 95 % of 315; above it only where light below zero counts as zero
    assert share > 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(places))
    if radius == 0.6:
        assert share < 0.95 + 3 * np.sqrt(0.95 * 0.05 / len(places))
        assert np.nanmedian(limits) < 0.8  # and is no more than what the noise calls for


@pytest.mark.parametrize("radius", [0.3, 0.5])
def test_limits_hold_where_the_blur_is_no_wider_than_a_pixel(radius, rng):
    grid = np.stack(np.meshgrid(np.arange(20, 490, 23), np.arange(20, 410, 26)), -1).reshape(-1, 2)
    places = grid + rng.uniform(-0.5, 0.5, grid.shape)
    image = image_of(places, np.full(len(places), radius), 2.0, rng, blur=0.6)
    limits = limit_radii(image, places, contrast=CONTRAST, blur_px=0.6, contacts=np.empty((0, 3)))
    # three standard deviations; without the blur by the pixels 26 % hold at 0.5 px
    assert np.mean(limits >= radius) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(places))


def test_the_background_that_is_left_counts_and_contacts_do_not(rng):
    flat = rng.normal(0, 1, (200, 220)).astype(np.float32)
    place, away = [[100.3, 90.7]], {"contrast": CONTRAST, "blur_px": BLUR}
    without = limit_radii(flat, place, contacts=[], **away)
    # a level that is left everywhere is taken off; contacts elsewhere change nothing
    assert limit_radii(flat + 5, place, contacts=[], **away) == pytest.approx(without, rel=1e-4)
    spot = flat.copy()
    spot[20:40, 20:40] += 100
    with_contact = limit_radii(spot, place, contacts=[[29.5, 29.5, 14.5]], **away)
    assert with_contact == pytest.approx(without, rel=0.1)  # from other places of background
    # waves of texture make the limit larger
    waves = flat + 2 * np.sin(np.arange(220) / 4).astype(np.float32)
    assert limit_radii(waves, place, contacts=[], **away)[0] > 1.3 * without[0]


def test_without_blur_the_limit_goes_over_into_that_of_little_blur(rng):
    flat = rng.normal(0, 1, (200, 220))
    limits = [
        limit_radii(flat, [[50.0, 60.0]], contrast=CONTRAST, blur_px=blur, contacts=[])[0]
        for blur in (0.0, 0.01, 0.1)
    ]
    assert limits[0] == pytest.approx(limits[1], rel=1e-3)
    assert limits[0] == pytest.approx(limits[2], rel=0.1)


def test_places_outside_and_holes_have_no_limit(rng):
    flat = rng.normal(0, 1, (200, 220)).astype(np.float32)
    valid = np.ones(flat.shape, np.uint8)
    valid[90:110, 90:110] = 0
    places = [[-5.0, 50.0], [1.0, 50.0], [100.0, 100.0], [50.0, 50.0], [1e4, 50.0], [np.nan, 50.0]]
    limits = limit_radii(flat, places, contrast=CONTRAST, blur_px=BLUR, contacts=[], valid=valid)
    assert np.isnan(limits).tolist() == [True, True, True, False, True, True]
    # a frame full of contacts has no background to compare with
    full = limit_radii(flat, places, contrast=CONTRAST, blur_px=BLUR, contacts=[[110.0, 100.0, 160.0]])
    assert np.isnan(full).all()
