"""Crowds, thousands of contacts, scattered light and soft slopes; hard frames are in `test_measure.py`."""

import cv2
import numpy as np
import pandas as pd
import pytest
from contact_frames import FINITE, Optics, match, render, scatter

from contactimg.imaging.measure import measure_image

CROWD = (420, 560)
"""Rows and columns of a frame of some hundred contacts."""


def test_threshold_counts_pixels_and_shrinks_as_it_rises(rng):
    optics = Optics(shape=(260, 340), dust=0)
    truth = scatter(30, optics, rng, radii=(5.0, 8.0), pairs=0, touching=0)
    frame, reference = render(truth, optics, rng)
    sums = []
    for threshold in (0.3, 0.5, 0.7):
        measurement = measure_image(frame, reference, method="threshold", threshold=threshold)
        assert measurement.threshold == threshold
        assert len(measurement.disks) == len(truth)
        # an area of whole pixels
        pixels = np.pi * measurement.disks["radius_px"] ** 2
        np.testing.assert_allclose(pixels, pixels.round(), atol=1e-6)
        sums.append(pixels.sum())
    assert sums[0] > sums[1] > sums[2]


def test_light_scattered_far_makes_no_contacts():
    rng, optics = np.random.default_rng(1), Optics(shape=(600, 800), halo=0.2)
    truth = scatter(125, optics, rng)
    frame, reference = render(truth, optics, rng)
    found = measure_image(frame, reference, polarity="bright", full_scale=255.0)
    assert found.optics.halo.fraction == pytest.approx(0.2, abs=0.02)
    pairs = match(truth, found.disks)
    assert len(pairs) == len(found.disks) >= len(truth) - 1
    # what stood for some of the scattered light before it was known is said to have been looked at
    assert found.rejected["reason"].str.contains("not needed to explain").any()


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "count", "bias"), [((760, 1012), 2000, 0.005), ((540, 720), 1000, 0.01)])
def test_thousands_of_contacts(rng, shape, count, bias):
    """The medians of the rows of the smaller, denser frame change by chance nearly as by flicker.

    Taken for flicker, they bias the radii by 0.06 px.
    """
    optics = Optics(shape=shape)
    truth = scatter(count, optics, rng, radii=(1.5, 5.0))
    assert len(truth) == count
    frame, reference = render(truth, optics, rng)
    found = measure_image(frame, reference, polarity="bright", full_scale=255.0).disks
    pairs = match(truth, found)
    assert len(pairs) >= 0.999 * max(len(found), len(truth))
    assert np.isfinite(found[list(FINITE)].to_numpy(float)).all()
    error = found["radius_px"].to_numpy()[pairs[:, 1]] - truth["radius_px"].to_numpy()[pairs[:, 0]]
    assert abs(error.mean()) < bias
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_medians_of_columns_that_contacts_move_are_no_flicker():
    """Wide contacts behind a wide blur leave a seventh of the frame free, and move the medians by chance."""
    optics, rng = Optics(shape=(900, 1200), sigma=4.0), np.random.default_rng([7001, 1300, 4, 119, 101])
    truth = scatter(650, optics, rng, radii=(3, 25))
    frame, _ = render(truth, optics, rng)
    found = measure_image(frame, polarity="bright", full_scale=255.0).disks
    assert len(match(truth, found)) >= 0.99 * max(len(found), len(truth))
    assert found.visible_area_px2.sum() == pytest.approx(np.pi * (truth.radius_px**2).sum(), rel=0.01)


def test_noise_makes_no_areas_disagree(rng):
    """Noise lifts more pixels about a faint disk above half of its height than it lowers in it: 1 % here."""
    optics = Optics(shape=(900, 1200), contrast=0.15)
    frame, reference = render(scatter(1300, optics, rng, radii=(1.5, 12)), optics, rng)
    assert measure_image(frame, reference, full_scale=255.0).status == "ok"


def lattice(across, down):
    """Contacts of 1.5-5 px on a jittered lattice that fills the frame of a crowd."""

    def make(rng):
        x, y = np.meshgrid(np.arange(8.0, CROWD[1], across), np.arange(12.0, CROWD[0], down))
        x, y = x.ravel(), y.ravel()
        x, y = x + rng.uniform(-1, 1, x.size), y + rng.uniform(-5, 5, y.size)
        return pd.DataFrame({"x_px": x, "y_px": y, "radius_px": rng.uniform(1.5, 5.0, x.size), "kind": 0})

    return make


def hexagons(pitch, radius, shape=CROWD):
    """Contacts in a triangular lattice that fills a frame, their radii a tenth apart."""

    def make(rng):
        rows = np.arange(pitch / 2, shape[0], pitch * np.sqrt(0.75))
        x = [np.arange(pitch / 2 * (1 + k % 2), shape[1], pitch) for k in range(len(rows))]
        y = np.repeat(rows, [len(row) for row in x])
        radii = radius * rng.uniform(0.9, 1.1, len(y))
        return pd.DataFrame({"x_px": np.concatenate(x), "y_px": y, "radius_px": radii, "kind": 0})

    return make


def radius_errors(truth, disks):
    """Errors of the radii of contacts, all of which must have been found."""
    pairs = match(truth, disks)
    assert len(pairs) == len(disks) == len(truth)
    return disks["radius_px"].to_numpy()[pairs[:, 1]] - truth["radius_px"].to_numpy()[pairs[:, 0]]


CROWDS = {
    "a lattice without a free block": (lattice(16, 24), 1.25),
    "rows in step with the blocks": (hexagons(24.0, 5.0), 1.25),
    "58 per cent covered": (hexagons(25.0, 10.0), 1.25),
    "85 per cent covered": (hexagons(41.5, 18.3), 1.25),
    "darker than the background": (hexagons(25.0, 10.0), -0.5),
}


def test_the_faint_light_about_many_contacts_is_no_background(rng):
    """The blocks that the light is fitted to hold 0.3 % of the contrast of the contacts that are near."""
    optics = Optics(shape=(900, 1200), sigma=1.9, camera="low")
    truth = scatter(1300, optics, rng, radii=(1.5, 12.0))
    frame, reference = render(truth, optics, rng)
    disks = measure_image(frame, reference).disks
    pairs = match(truth, disks)
    error = disks.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    assert abs(error.mean()) < 0.004


@pytest.mark.parametrize("crowd", CROWDS)
def test_contacts_may_cover_most_of_the_frame(crowd, rng):
    """Where no 8 x 8 pixels are free of contacts' light, the gaps between them tell the background."""
    make, contrast = CROWDS[crowd]
    optics = Optics(shape=CROWD, contrast=contrast)
    truth = make(rng)
    frame, reference = render(truth, optics, rng)
    polarity = "bright" if contrast > 0 else "dark"
    error = radius_errors(truth, measure_image(frame, reference, polarity=polarity, full_scale=255.0).disks)
    assert abs(error.mean()) < 0.01
    assert np.sqrt(np.mean(error**2)) < (0.03 if contrast > 0 else 0.045)


def crowd(rng, pitch=18.0, radius=5.0, shape=CROWD, **options):
    """Truth, frame and reference of a lattice that fills the frame."""
    optics = Optics(shape=shape, **options)
    truth = hexagons(pitch, radius, shape)(rng)
    return truth, *render(truth, optics, rng)


def test_a_crowd_behind_a_wide_blur(rng):
    truth, frame, reference = crowd(rng, 60.0, 20.0, sigma=4.0)
    found = measure_image(frame, reference, polarity="bright", full_scale=255.0)
    error = radius_errors(truth, found.disks)
    assert abs(error.mean()) < 0.01
    assert np.sqrt(np.mean(error**2)) < 0.04


@pytest.fixture(scope="module")
def plain_crowd():
    return crowd(np.random.default_rng(20140801), shape=(600, 800))


def test_a_crowd_with_holes_behind_a_field_stop(plain_crowd):
    truth, frame, reference = plain_crowd
    frame, reference = frame.astype(np.float32), reference.astype(np.float32)
    frame[100:160, 200:300] = np.nan
    frame[400:] = reference[400:] = 0.0
    found = measure_image(frame, reference, polarity="bright", full_scale=255.0)
    assert found.status == "holes"
    x, y = truth["x_px"], truth["y_px"]
    clear = truth[(y < 385) & ~((x > 185) & (x < 315) & (y > 85) & (y < 175))]
    pairs = match(clear, found.disks)
    assert len(pairs) == len(clear)
    error = found.disks["radius_px"].to_numpy()[pairs[:, 1]] - clear["radius_px"].to_numpy()[pairs[:, 0]]
    assert abs(error.mean()) < 0.02


def test_a_crowd_before_a_constant_reference(rng):
    truth, frame, _ = crowd(rng, texture=0.0, dust=0, vignetting=0.0)
    found = measure_image(frame, np.full_like(frame, 80), polarity="bright", full_scale=255.0)
    assert abs(radius_errors(truth, found.disks).mean()) < 0.01


def test_a_crowd_without_a_reference(plain_crowd):
    """Texture of 2 % stays in the frame: some 0.07 px of a rim."""
    truth, frame, _ = plain_crowd
    found = measure_image(frame, polarity="bright", full_scale=255.0)
    assert np.sqrt(np.mean(radius_errors(truth, found.disks) ** 2)) < 0.1


@pytest.mark.parametrize("size", [16, 40, 64, 100])
def test_a_small_part_of_a_crowd_stays_finite(size, plain_crowd):
    _, frame, reference = plain_crowd
    part = (slice(200, 200 + size), slice(400, 400 + size))
    found = measure_image(frame[part], reference[part], polarity="bright", full_scale=255.0)
    assert np.isfinite(found.disks[list(FINITE)].to_numpy(float)).all()


def test_a_dark_crowd_of_unknown_polarity_is_measured(rng):
    """58 per cent covered; the texture of the gaps is too faint to tell the shift."""
    truth, frame, reference = crowd(rng, 25.0, 10.0, contrast=-0.5)
    found = measure_image(frame, reference, polarity="auto", full_scale=255.0)
    assert found.status == "ok"
    assert len(match(truth, found.disks)) == len(found.disks) == len(truth)
    assert found.disks["visible_area_px2"].sum() == pytest.approx(
        np.pi * (truth.radius_px**2).sum(), rel=0.005
    )


def test_a_crowd_that_is_too_much_is_not_said_to_be_fine(rng):
    """58 per cent covered, and a fifth of the light scattered far."""
    _, frame, reference = crowd(rng, 25.0, 10.0, halo=0.2)
    assert measure_image(frame, reference, polarity="bright", full_scale=255.0).status != "ok"


def test_noise_on_a_soft_slope_is_no_contact(rng):
    """Pixels that noise lifts over the threshold beside it: without a look at their surroundings, 30 more."""
    y, x = np.mgrid[0:480, 0:640]
    distance = np.hypot(x % 160 - 80, y % 120 - 60)
    soft = 14 / (1 + np.exp((distance - 25) / 4))
    frame, reference = (80 + part + rng.normal(0, 1.0, x.shape) for part in (soft, 0.0))
    found = measure_image(frame.astype(np.float32), reference.astype(np.float32), method="threshold")
    assert len(found.disks) == 16


def test_a_crowd_without_gaps_is_not_said_to_be_fine(rng):
    """Disks of 5 px packed 11.5 px apart: nowhere less than a quarter of their light."""
    optics = Optics(shape=CROWD)
    frame, reference = render(hexagons(11.5, 5.0)(rng), optics, rng)
    found = measure_image(frame, reference, polarity="bright", full_scale=255.0)
    assert found.status == "light changed"
    assert "fill" in found.message


def test_letters_that_a_program_has_drawn_into_a_frame_are_said(rng):
    """At the full scale of the sensor, and of no shape that contacts have."""
    optics = Optics(shape=(400, 540), contrast=0.75, dust=0)
    truth = scatter(35, optics, rng, radii=(4.0, 12.0), pairs=0, touching=0)
    truth = truth[truth["y_px"] > 60.0]
    frame, reference = render(truth, optics, rng)
    assert measure_image(frame, reference).status == "ok"
    drawn = cv2.putText(frame, "2025-03-14 12:03:27", (12, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 2)
    found = measure_image(drawn, reference)
    assert len(match(truth, found.disks)) == len(truth)
    assert len(found.disks) > 1.1 * len(truth)
    assert found.status != "ok"
    assert "at the full scale of the sensor and no disks" in found.message


def test_thin_letters_of_which_specks_are_left_are_said(rng):
    """Letters one pixel wide pass for small contacts of the wrong shape, not only for regions of one."""
    optics = Optics(shape=(400, 500), contrast=0.75, dust=0)
    truth = scatter(25, optics, rng, radii=(4.0, 12.0), pairs=0, touching=0)
    frame, reference = render(truth[truth["y_px"] < 360.0], optics, rng)
    drawn = cv2.putText(frame, "k  k  k", (6, 392), cv2.FONT_HERSHEY_PLAIN, 0.9, 255, 1)
    found = measure_image(drawn, reference)
    assert np.count_nonzero(found.disks["y_px"] > 372.0) == 3
    assert found.status == "false candidates"


def test_a_few_letters_among_many_contacts_are_said_by_their_area(rng):
    optics = Optics(shape=(600, 800), dust=0)
    frame, reference = render(scatter(140, optics, rng, radii=(2.0, 14.0)), optics, rng)
    assert measure_image(frame, reference).status == "ok"
    drawn = cv2.putText(frame, "200 um  0.5 N", (20, 560), cv2.FONT_HERSHEY_SIMPLEX, 1.0, 255, 2)
    found = measure_image(drawn, reference)
    assert found.status != "ok"
    assert "of the area, are at the full scale of the sensor and no disks" in found.message


@pytest.mark.parametrize("broken", ["frame", "reference"])
def test_contacts_that_only_one_image_lights_are_missed_and_said(broken, rng):
    """The lower rows of one image were lost on the way from the camera; of both, nothing would be missed."""
    optics = Optics(shape=(480, 640), dust=0)
    truth = scatter(40, optics, rng, radii=(4.0, 12.0))
    images = dict(zip(("frame", "reference"), render(truth, optics, rng), strict=True))
    both = {name: image.copy() for name, image in images.items()}
    for image in both.values():
        image[320:] = 0
    alone = images | {broken: both[broken]}
    assert measure_image(both["frame"], both["reference"]).status == "ok"
    found = measure_image(alone["frame"], alone["reference"])
    assert len(match(truth[truth["y_px"] < 290.0], found.disks)) == np.sum(truth["y_px"] < 290.0)
    assert found.status == "unresolved"
    assert "% of the pixels are lit in one of frame and reference alone" in found.message


def test_a_frame_that_is_torn_is_said_not_to_agree_with_its_reference(rng):
    """Half of the rows moved: their contacts are not where they seem to be."""
    optics = Optics(shape=(600, 800))
    frame, reference = render(scatter(120, optics, rng, radii=(2.0, 14.0)), optics, rng)
    assert measure_image(np.roll(frame, 9, axis=1), reference).status == "ok"
    found = measure_image(np.vstack([frame[:300], np.roll(frame[300:], 9, axis=1)]), reference)
    assert found.status == "not registered"
    assert "agree in a part of the image only" in found.message
