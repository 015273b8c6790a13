"""What is given to a measurement from outside, and what must not change its result."""

import numpy as np
import pandas as pd
import pytest
from camera_worlds import make_scene

from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.optics import SharedOptics


@pytest.fixture(scope="module")
def plain():
    scene = make_scene("plain", 25, 13)
    return scene, measure_image(scene.frame, scene.reference)


def radii(disks):
    """Radii, ordered by size: contacts of a frame may change their place."""
    return np.sort(disks["radius_px"].to_numpy())


TURNS = {
    "mirrored": lambda image: image[:, ::-1],
    "upside down": lambda image: image[::-1],
    "transposed": lambda image: image.T,
}


@pytest.mark.parametrize(
    ("turn", "method"), [("mirrored", "disk"), ("transposed", "disk"), ("upside down", "threshold")]
)
def test_a_turned_frame_has_the_same_contacts(turn, method, plain):
    scene, _ = plain
    pair = scene.frame, scene.reference
    straight = measure_image(*pair, method=method).disks
    turned = measure_image(*(np.ascontiguousarray(TURNS[turn](image)) for image in pair), method=method).disks
    assert len(turned) == len(straight)
    # pixels are summed in another order, and blocks begin at another border; counts differ by a pixel
    if method == "disk":
        limit = 0.5 * np.median(straight["radius_std_px"])
        np.testing.assert_allclose(radii(turned), radii(straight), atol=limit)
    else:
        pixels, before = (np.pi * radii(disks) ** 2 for disks in (turned, straight))
        np.testing.assert_allclose(pixels, before, rtol=0.005, atol=2.0)


@pytest.mark.parametrize(
    ("dtype", "method"), [(np.uint16, "threshold"), (np.float32, "disk"), (np.float64, "disk")]
)
def test_a_frame_in_other_units_has_the_same_contacts(dtype, method, plain):
    scene, _ = plain
    alone = measure_image(scene.frame, scene.reference, method=method)
    pair = (image.astype(dtype) * dtype(257) for image in (scene.frame, scene.reference))
    scaled = measure_image(*pair, method=method, full_scale=257.0 * 255)
    np.testing.assert_allclose(scaled.disks["radius_px"], alone.disks["radius_px"], rtol=1e-3)
    assert scaled.contrast == pytest.approx(257 * alone.contrast, rel=1e-3)


def test_optics_of_other_frames_narrow_the_uncertainty(plain):
    scene, alone = plain
    prior = SharedOptics(
        contrast=alone.contrast, contrast_std=1e-4 * alone.contrast, blur_px=alone.blur_px, blur_std_px=1e-4
    )
    helped = measure_image(scene.frame, scene.reference, optics=prior)
    assert len(helped.disks) == len(alone.disks)
    assert (
        helped.disks["contrast_shift_px"].abs().mean() < 0.5 * alone.disks["contrast_shift_px"].abs().mean()
    )
    assert (helped.disks["radius_std_px"] <= 1.01 * alone.disks["radius_std_px"].to_numpy()).all()


def test_a_given_blur_is_exact(plain):
    scene, alone = plain
    given = measure_image(scene.frame, scene.reference, blur_px=1.38)
    assert given.blur_px == pytest.approx(1.38, abs=1e-6)
    assert given.disks["blur_shift_px"].abs().max() < 0.1 * alone.disks["blur_shift_px"].abs().max()


def test_measuring_twice_gives_the_same(plain):
    scene, alone = plain
    pd.testing.assert_frame_equal(measure_image(scene.frame, scene.reference).disks, alone.disks)
