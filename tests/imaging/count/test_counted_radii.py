"""Radii of counted pixels: what they are uncertain by, and a second look at their light."""

import numpy as np
import pytest
from contact_frames import Optics, coverage, match, render, scatter
from scipy import ndimage

from contactimg.forces import SHARED_SHIFTS
from contactimg.imaging.measure import measure_image
from contactimg.tables import Flag, Status

OPTICS = Optics(shape=(600, 800), dust=0)


@pytest.fixture(scope="module")
def shown():
    rng = np.random.default_rng(4711)
    truth = scatter(90, OPTICS, rng, touching=0.0)
    return truth, *render(truth, OPTICS, rng)


def errors_and_shifts(truth, found):
    pairs = match(truth, found.disks)
    disks = found.disks.iloc[pairs[:, 1]]
    error = disks["radius_px"].to_numpy() - truth["radius_px"].to_numpy()[pairs[:, 0]]
    return error, disks


@pytest.mark.parametrize("threshold", [0.5, 0.3])
def test_uncertainties_cover_contacts_and_their_sum(shown, threshold):
    """The error that all contacts share is stated as such: it is as large as it is, not twice nor half."""
    truth, frame, reference = shown
    found = measure_image(frame, reference, method="threshold", threshold=threshold)
    error, disks = errors_and_shifts(truth, found)
    std, radius = disks["radius_std_px"].to_numpy(), disks["radius_px"].to_numpy()
    assert found.status == "ok"
    assert f"{threshold:g} of the contrast" in found.message
    for low, high in ((0, 4), (4, 10), (10, 99)):
        some = (radius >= low) & (radius < high)
        assert np.mean(np.abs(error[some]) < 2 * std[some]) > 0.9
    shared = disks[list(SHARED_SHIFTS)].to_numpy()
    own = std**2 - np.sum(shared**2, axis=1)
    sum_std = np.sqrt(np.sum(radius**2 * own) + np.sum((radius @ shared) ** 2))
    assert 0.6 < abs(radius @ error) / sum_std < 1.5


def test_the_radius_is_that_of_the_pixels_whatever_the_blur(shown):
    _, frame, reference = shown
    found = measure_image(frame, reference, method="threshold", threshold=0.4)
    labels, _ = ndimage.label(found.difference > 0.4 * found.contrast, np.ones((3, 3)))
    areas = np.bincount(labels.ravel())
    whole = found.disks[found.disks["flags"] == 0]
    rows, columns = (np.rint(whole[name]).astype(int) for name in ("y_px", "x_px"))
    np.testing.assert_allclose(np.pi * whole["radius_px"] ** 2, areas[labels[rows, columns]], rtol=1e-9)


@pytest.mark.parametrize("blur", [0.0, 1.0, 2.0])
def test_shift_is_that_of_a_blurred_disk(blur, rng):
    """At half height -(s^2 + 1/12)/(2 a); an image of two levels has none that pixels would not make."""
    x, y = (
        part.ravel() + rng.uniform(-0.5, 0.5, 12) for part in np.meshgrid([40, 90, 140, 190], [40, 90, 140])
    )
    yy, xx = np.mgrid[0:180, 0:230]
    if blur:
        optics = Optics(shape=(180, 230), sigma=blur)
        cover = coverage(x, y, np.full(12, 8.0), np.ones(12), optics)
    else:
        cover = (np.hypot(xx[..., None] - x, yy[..., None] - y) <= 8.0).any(axis=2)
    image = (50 + 100 * cover + rng.normal(0, 1, cover.shape)).round().astype(np.uint8)
    found = measure_image(image, np.full_like(image, 50), method="threshold", polarity="bright")
    expected = -(blur**2 + 1 / 12) / (2 * 8.0)
    assert found.disks["edge_shift_px"].mean() == pytest.approx(expected, rel=0.25)


def test_spread_of_the_contrasts_counts_once_contacts_show_it(rng):
    truth = scatter(60, OPTICS, rng, radii=(12.0, 25.0), touching=0.0)
    own = []
    for spread in (0.0, 0.06):
        optics = Optics(shape=(600, 800), dust=0, spread=spread)
        frame, reference = render(truth, optics, np.random.default_rng(5))
        found = measure_image(frame, reference, method="threshold")
        error, disks = errors_and_shifts(truth, found)
        shared = np.sum(disks[list(SHARED_SHIFTS)].to_numpy() ** 2, axis=1)
        own.append(np.sqrt(disks["radius_std_px"].to_numpy() ** 2 - shared))
        assert np.std(error) == pytest.approx(np.median(own[-1]), rel=0.4)
    # half of 6 % over the slope of the rim, C/(sqrt(2 pi) s)
    assert np.median(own[1]) == pytest.approx(0.5 * 0.06 * np.sqrt(2 * np.pi) * 1.43, rel=0.35)


def test_light_that_is_not_behind_the_rims_is_said(rng):
    """Contacts brighter in the middle by 40 %: light over contrast is no area."""
    truth = scatter(60, OPTICS, rng, radii=(8.0, 25.0), touching=0.0)
    frame, reference = render(truth, OPTICS, rng)
    yy, xx = np.mgrid[0:600, 0:800]
    light = frame.astype(float)
    for x, y, a in truth[["x_px", "y_px", "radius_px"]].to_numpy():
        inside = np.clip(1.0 - ((xx - x) ** 2 + (yy - y) ** 2) / a**2, 0.0, 1.0)
        light += 40.0 * inside
    found = measure_image(np.clip(light, 0, 255).round().astype(np.uint8), reference, method="threshold")
    assert found.status == Status.DISAGREES
    assert "pixel count" in found.message
    error, disks = errors_and_shifts(truth, found)
    assert np.mean(np.abs(error) < 2 * disks["radius_std_px"].to_numpy()) > 0.9


@pytest.mark.parametrize("blur", [0.8, 4.0])
def test_the_smallest_contact_counted_reaches_the_threshold_behind_its_blur(blur, rng):
    """``1 - exp(-a^2/(2 s^2)) = 1/2`` at the centre: a = 1.18 s."""
    optics = Optics(shape=(600, 800), dust=0, sigma=blur)
    truth = scatter(40, optics, rng, radii=(14.0, 30.0), touching=0.0)
    frame, reference = render(truth, optics, rng)
    found = measure_image(frame, reference, method="threshold")
    assert found.smallest_px == pytest.approx(1.18 * blur, rel=0.15)
    given = measure_image(frame, reference, method="threshold", blur_px=blur)
    assert given.smallest_px == pytest.approx(1.1774 * np.hypot(blur, 12**-0.5), rel=1e-4)


@pytest.mark.parametrize("noise", [30.0, 40.0])
def test_pixels_that_noise_takes_are_in_the_uncertainty(noise, rng):
    """At a contrast of two to three standard deviations noise takes 5 to 20 % of the pixels inside."""
    optics = Optics(shape=(300, 400), dust=0, texture=0.0)
    truth = scatter(20, optics, rng, radii=(8, 20), pairs=0, touching=0)
    clean = np.mean([render(truth, optics, rng)[0] for _ in range(4)], axis=0)
    frame = clean + rng.normal(0.0, noise, clean.shape)
    disks = measure_image(frame, method="threshold", full_scale=255.0).disks
    pairs = match(truth, disks)
    error = np.array([disks["radius_px"][j] - truth["radius_px"][i] for i, j in pairs])
    std = np.array([disks["radius_std_px"][j] for _, j in pairs])
    assert len(pairs) == len(truth)
    assert error.mean() < -0.01 * truth["radius_px"].mean()
    assert np.mean(np.abs(error) < 2.0 * std) > 0.8


@pytest.mark.parametrize("seed", [0, 6])
def test_noise_does_not_cut_up_a_faint_contact(seed):
    optics, rng = Optics(shape=(300, 400), dust=0, texture=0.0), np.random.default_rng(seed)
    truth = scatter(15, optics, rng, radii=(8, 20), pairs=0, touching=0)
    light = np.where(np.arange(len(truth)) == 3, 0.6, 1.0)
    cover = coverage(truth.x_px, truth.y_px, truth.radius_px, light, optics)
    frame = 60.0 + 60.0 * cover + rng.normal(0.0, 5.0, cover.shape)
    disks = measure_image(frame, method="threshold", full_scale=255.0).disks
    assert len(disks) == len(truth)
    (odd,) = (j for i, j in match(truth, disks, reach=5.0) if i == 3)
    assert disks["flags"][odd] & int(Flag.BRIGHTNESS)
    assert abs(disks["radius_px"][odd] - truth["radius_px"][3]) < 2.0 * disks["radius_std_px"][odd]


@pytest.mark.parametrize("brightness", [0.55, 1.8])
def test_one_contact_of_another_brightness_says_so(brightness, rng):
    optics = Optics(shape=(300, 400), dust=0, texture=0.0)
    truth = scatter(15, optics, rng, radii=(8, 20), pairs=0, touching=0)
    light = np.ones(len(truth))
    light[3] = brightness
    cover = coverage(truth.x_px, truth.y_px, truth.radius_px, light, optics)
    frame = 60.0 + 60.0 * cover + rng.normal(0.0, 5.0, cover.shape)
    disks = measure_image(frame, method="threshold", full_scale=255.0).disks
    (odd,) = (j for i, j in match(truth, disks, reach=5.0) if i == 3)
    flagged = (disks["flags"] & int(Flag.BRIGHTNESS)).to_numpy() > 0
    assert flagged[odd]
    assert flagged.sum() == 1
    error = abs(disks["radius_px"][odd] - truth["radius_px"][3])
    assert error < 2.0 * disks["radius_std_px"][odd] + 0.1
