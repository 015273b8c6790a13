"""The slow light under a crowd: from the gaps between contacts where no block is free, and only there."""

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from contactimg.imaging.background.find_illumination import (
    find_background_level,
    find_illumination,
    neighbour_scatter,
)
from contactimg.imaging.background.illumination import fit_illumination
from contactimg.imaging.background.subtract import remove_background, subtract_reference
from contactimg.imaging.pixels.blocks import BLOCK, block_means, side_of
from contactimg.imaging.profile.limits import SQUARE_PX

SHAPE = (480, 640)
Y, X = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
LEVEL, NOISE = 1.1, 0.03


def crowd(pitch, radius):
    """Coverage by blurred disks in a square lattice."""
    distance = np.hypot((X + 0.3) % pitch - pitch / 2, (Y + 0.2) % pitch - pitch / 2)
    return ndtr((radius - distance) / 1.4)


def means_of(ratio, rng):
    """Means over squares of a noisy ratio, and the scatter of one."""
    image = (ratio + NOISE * rng.standard_normal(SHAPE)).astype(np.float32)

    def means(side, rows=None):
        return block_means(image if rows is None else image[rows], side=side), NOISE / side

    return means


def coarse_light(means):
    blocks, _ = means(BLOCK)
    scatter = neighbour_scatter(blocks)
    level, scatter = find_background_level(blocks, background_is="lowest", scatter=scatter)
    return fit_illumination(blocks, SHAPE, level=level, scatter=scatter)


def side_and_level(light):
    return side_of(light.background.shape, SHAPE), light.at_blocks((60, 80), SHAPE).mean()


def test_background_is_found_between_contacts_that_leave_no_block_free(rng):
    means = means_of(LEVEL + 0.05 * X / SHAPE[1] + 1.2 * crowd(15, 4), rng)
    side, level = side_and_level(find_illumination(means, SHAPE, background_is="lowest"))
    assert side == SQUARE_PX
    # half-way between two contacts 0.006 x 2 x 1.2 of their light is left, and light within the noise passes
    assert level == pytest.approx(LEVEL + 0.025, abs=0.02)
    assert side_and_level(coarse_light(means))[1] > LEVEL + 0.1


def test_blocks_do_where_some_are_free(rng):
    means = means_of(LEVEL + 1.2 * crowd(60, 8), rng)
    found, blocks = find_illumination(means, SHAPE, background_is="lowest"), coarse_light(means)
    assert side_and_level(found)[0] == BLOCK
    np.testing.assert_array_equal(found.coefficients, blocks.coefficients)


def test_uneven_light_is_no_crowd(rng):
    dome = np.exp(-((X - 320) ** 2 + (Y - 240) ** 2) / (2 * 90.0**2))
    assert (
        side_and_level(find_illumination(means_of(LEVEL + dome, rng), SHAPE, background_is="lowest"))[0]
        == BLOCK
    )


def test_nothing_but_holes_is_no_crowd():
    def holes(side, _rows):
        return np.full([-(-size // side) for size in SHAPE], np.nan), 0.0

    assert not find_illumination(holes, SHAPE, background_is="lowest").background.any()


def test_contacts_in_step_with_the_blocks_do_not_hide_the_background(rng):
    """Every third block of every third row is covered, as if the sample of blocks were drawn from them."""
    for phase in range(3):
        blocks = (LEVEL + 0.001 * rng.standard_normal((240, 320))).astype(np.float32)
        blocks[phase::3] += 0.4
        blocks[:, phase::3] += 0.4
        light = fit_illumination(blocks, (1920, 2560), level=LEVEL, scatter=0.003)
        assert light.background.mean() == pytest.approx(4 / 9, abs=0.01)


@pytest.mark.parametrize("sign", [1, -1])
def test_light_that_changed_by_a_fifth_is_followed(rng, sign):
    """What is left of it in the difference image is below a hundredth of the level."""
    light = LEVEL * (1 + 0.2 * (2 * X / SHAPE[1] - 1) + 0.1 * (Y / SHAPE[0]) ** 2)
    contacts = crowd(64, 14)
    frame, reference = (
        (80.0 * image + rng.normal(0, 1.5, SHAPE)).astype(np.float32)
        for image in (light * (1 + sign * 0.6 * contacts), np.full(SHAPE, LEVEL))
    )
    found = subtract_reference(frame, reference, background_is="lowest" if sign > 0 else "highest")
    left = np.where(contacts == 0, found.image, 0.0)
    assert np.abs(cv2.blur(left, (63, 63))).max() < 0.01 * found.level
    assert found.illumination.background.mean() > 0.6


@pytest.mark.parametrize("fall", [0.5, 0.8])
@pytest.mark.parametrize("along", ["x", "y"])
def test_light_that_falls_across_the_image_is_followed_with_a_reference(rng, fall, along):
    """No single level is that of the background: it is what differs from its neighbours by little."""
    place = X / SHAPE[1] if along == "x" else Y / SHAPE[0]
    contacts = crowd(64, 14)
    frame = 80.0 * LEVEL * (1 - fall * place) * (1 + 0.6 * contacts) + rng.normal(0, 0.8, SHAPE)
    reference = 80.0 * LEVEL + rng.normal(0, 0.8, SHAPE)
    found = subtract_reference(frame.astype(np.float32), reference.astype(np.float32))
    left = np.where(contacts == 0, found.image, 0.0)
    assert np.abs(cv2.blur(left, (63, 63))).max() < 0.01 * found.level
    assert found.illumination.background.mean() > 0.6


@pytest.mark.parametrize("fall", [0.0, 0.3])
def test_light_halved_under_wide_contacts_is_that_between_them(rng, fall):
    """The contacts have the level nearest to the reference; the background encloses them."""
    light = LEVEL * 0.5 * (1 - fall * X / SHAPE[1])
    contacts = crowd(90, 30)
    frame = 80.0 * light * (1 + 0.3 * contacts) + rng.normal(0, 0.4, SHAPE)
    reference = 80.0 * LEVEL + rng.normal(0, 0.4, SHAPE)
    found = subtract_reference(frame.astype(np.float32), reference.astype(np.float32))
    expected = 0.3 * found.level
    inside = cv2.erode(contacts.astype(np.float32), np.ones((9, 9))) > 0.99
    assert found.image[inside].mean() == pytest.approx(expected, rel=0.03)
    assert abs(found.image[contacts < 1e-3].mean()) < 0.01 * found.level


def test_wide_contacts_that_fill_the_image_are_no_background(rng):
    """They are flat and fill more of it than the gaps between them, which are as bright as the reference."""
    contacts = crowd(126, 60)
    frame = 80.0 * LEVEL * (1 + 0.5 * contacts) + rng.normal(0, 0.8, SHAPE)
    reference = 80.0 * LEVEL + rng.normal(0, 0.8, SHAPE)
    found = subtract_reference(frame.astype(np.float32), reference.astype(np.float32))
    assert contacts.mean() > 0.6
    assert abs(np.median(found.image[contacts < 1e-3])) < 0.01 * found.level


@pytest.mark.parametrize("contrast", [0.5, -0.5])
def test_wide_contacts_in_a_packing_are_no_other_light(rng, contrast):
    """Little is background, and more blocks agree with the level of the contacts; they enclose nothing."""
    contacts = crowd(124, 60)
    frame = 80.0 * LEVEL * (1 + contrast * contacts) + rng.normal(0, 0.8, SHAPE)
    reference = 80.0 * LEVEL + rng.normal(0, 0.8, SHAPE)
    found, sign = remove_background(frame.astype(np.float32), reference.astype(np.float32))
    assert sign == np.sign(contrast)
    assert abs(np.median(found.image[contacts < 1e-3])) < 0.01 * found.level
