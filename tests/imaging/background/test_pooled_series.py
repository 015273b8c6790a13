"""The background of a series: the mean of all other frames, free of contacts, quieter than one reference."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from contactimg.imaging.background.series import PooledBackground
from contactimg.imaging.measure import measure_image

SHAPE = (260, 340)
LEVEL, CONTRAST, NOISE, BLUR = 80.0, 50.0, 2.0, 1.4
FRAMES = 12
Y, X = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float32)
PLACES = np.array([(x, y) for y in range(30, 240, 50) for x in range(30, 330, 56)], float)


def surface(rng):
    """A texture of 2 %, 20 px wider than the frame on each side."""
    wide = rng.standard_normal([size + 40 for size in SHAPE])
    smooth = cv2.GaussianBlur(wide, (0, 0), 1.7)
    return LEVEL * (1.0 + 0.02 * smooth / smooth.std())


def shifted(texture, x, y):
    return ndimage.shift(texture, (y, x), order=5)[20:-20, 20:-20]


def contacts(rng):
    """x, y, radius, in another place and of another size in each frame."""
    return np.column_stack([PLACES + rng.uniform(-12, 12, PLACES.shape), rng.uniform(4.0, 9.0, len(PLACES))])


def blurred_disks(disks):
    """Coverage, painted on quarter pixels, blurred there and averaged over each pixel."""
    fine = np.zeros((4 * SHAPE[0], 4 * SHAPE[1]), np.float32)
    y, x = (np.arange(size) / 4 - 0.375 for size in fine.shape)
    for cx, cy, a in disks:
        near = np.ix_(np.abs(y - cy) < a + 1, np.abs(x - cx) < a + 1)
        distance = np.hypot(x[near[1]] - cx, y[near[0]] - cy)
        fine[near] = np.maximum(fine[near], np.clip(4 * (a - distance) + 0.5, 0, 1))
    fine = cv2.GaussianBlur(fine, (0, 0), 4 * BLUR)
    return cv2.resize(fine, SHAPE[::-1], interpolation=cv2.INTER_AREA)


def expose(light, disks, rng):
    cover = blurred_disks(disks)
    grey = light * (1.0 + CONTRAST / LEVEL * cover) + rng.normal(0.0, NOISE, SHAPE)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def series():
    """A reference, and frames with their contacts."""
    rng = np.random.default_rng(5)
    texture = surface(rng)
    frames = []
    for k in range(FRAMES):
        disks = contacts(rng)
        light = (1.0 + 0.01 * k) * shifted(texture, *rng.uniform(-0.5, 0.5, 2))
        frames.append((expose(light, disks, rng), disks))
    return expose(shifted(texture, 0.0, 0.0), np.empty((0, 3)), rng), frames, shifted(texture, 0.0, 0.0)


def pooled_from(reference, frames):
    pooled, views = PooledBackground(reference), []
    for frame, disks in frames:
        views.append(pooled.view(frame, disks))
        pooled.add(views[-1])
    return pooled, views


def errors(frame, background, disks):
    found = measure_image(frame, background).disks
    places = found[["x_px", "y_px"]].to_numpy()
    distance = np.hypot(*(places[None] - disks[:, None, :2]).transpose(2, 0, 1))
    assert (distance.min(axis=1) < 1.0).all()
    return found.radius_px.to_numpy()[distance.argmin(axis=1)] - disks[:, 2]


def test_mean_of_the_others_has_the_noise_of_a_mean(series):
    """Of 12 images 0.29 of the noise of one; 0.33 with the contacts masked and the shifts uncertain."""
    reference, frames, truth = series
    pooled, views = pooled_from(reference, frames)
    error = pooled.without(views[0]) - truth
    assert error.std() < 0.36 * NOISE
    assert (reference - truth).std() > 0.95 * NOISE
    assert np.abs(cv2.blur(error, (15, 15))).max() < 0.5


def test_a_view_is_taken_out_again(series):
    reference, frames, _ = series
    pooled, views = pooled_from(reference, frames[:3])
    fewer, _ = pooled_from(reference, frames[:2])
    np.testing.assert_allclose(pooled.without(views[2]), fewer.without(), atol=1e-3)


def test_where_no_frame_shows_the_background_the_reference_remains(series):
    reference, frames, _ = series
    frame, disks = frames[0]
    pooled, _ = pooled_from(reference, [(frame, disks)])
    x, y, a = disks[len(disks) // 2]
    inside = np.hypot(X - x, Y - y) < a
    np.testing.assert_allclose(pooled.without()[inside], reference[inside], atol=1e-4)


def test_an_overlooked_contact_is_left_out(series):
    reference, frames, truth = series
    pooled, _ = pooled_from(reference, [(frame, disks[1:]) for frame, disks in frames[:1]])
    x, y, a = frames[0][1][0]
    inside = np.hypot(X - x, Y - y) < a + 3.0
    assert abs(float((pooled.without() - truth)[inside].mean())) < 1.0


def test_another_surface_gives_no_view(series):
    reference, frames, _ = series
    other = expose(
        shifted(surface(np.random.default_rng(9)), 0.0, 0.0), frames[0][1], np.random.default_rng(1)
    )
    view = PooledBackground(reference).view(other, frames[0][1])
    assert view is None


@pytest.mark.slow
def test_radii_are_better_than_with_one_reference(series):
    """Twelve frames: the root mean square error is at most 0.95 of that with the reference alone."""
    reference, frames, _ = series
    pooled, views = pooled_from(reference, frames)
    single, better = (
        np.concatenate([errors(frame, background(k), disks) for k, (frame, disks) in enumerate(frames)])
        for background in (lambda k: reference, lambda k: pooled.without(views[k]))
    )
    assert np.sqrt(np.mean(better**2)) < 0.95 * np.sqrt(np.mean(single**2))
