"""Contacts of another brightness than the others: found with the right radius, flagged, never dropped."""

import numpy as np
import pytest
from camera_worlds import (
    Layout,
    World,
    field_stop,
    in_stop,
    make_scene,
    odd_one,
    scaled,
    spread,
)
from contact_frames import match

from contactimg.imaging.measure import measure_image
from contactimg.tables import Flag


def pulls(truth, disks, rows=slice(None)):
    """Errors of the radii over their standard uncertainties, and flags; all contacts must be found."""
    pairs = dict(match(truth, disks))
    wanted = np.arange(len(truth))[rows]
    assert set(wanted) <= set(pairs)
    found = disks.iloc[[pairs[i] for i in wanted]]
    error = found["radius_px"].to_numpy() - truth["radius_px"].to_numpy()[wanted]
    return error / found["radius_std_px"].to_numpy(), found["flags"].to_numpy()


@pytest.mark.parametrize("factor", [0.2, 0.5, 1.5])
def test_one_odd_contact_has_its_radius_and_a_flag(factor):
    world = World(layout=Layout(radii=(4, 20), pairs=0), alter=odd_one(factor))
    seen = []
    for seed in range(12):
        scene = world(25, np.random.default_rng([31, seed]))
        disks = measure_image(scene.frame, scene.reference).disks
        pull, flags = pulls(scene.truth, disks, np.flatnonzero(scene.truth.odd))
        assert flags[0] & int(Flag.BRIGHTNESS)
        seen.append(abs(pull[0]))
        others, flags = pulls(scene.truth, disks, np.flatnonzero(~scene.truth.odd))
        assert not (flags & int(Flag.BRIGHTNESS)).any()
        assert np.mean(np.abs(others) < 2) > 0.8
    # of twelve normal deviates fewer than 4 within one in 1e-3, fewer than 9 within two in 2e-3 of cases
    assert np.count_nonzero(np.array(seen) < 1) >= 4
    assert np.count_nonzero(np.array(seen) < 2) >= 9
    assert max(seen) < 4


@pytest.mark.parametrize("factor", [0.26, 0.3, 0.34])
def test_a_faint_contact_that_noise_tears_is_no_line(factor):
    """Above the level of lines it is a net of pixels; at half of its own height it is a disk."""
    world = World(layout=Layout(radii=(12, 18), pairs=0), alter=odd_one(factor))
    for seed in range(6):
        scene = world(8, np.random.default_rng([41, seed]))
        result = measure_image(scene.frame, scene.reference)
        assert len(result.disks) == len(scene.truth)
        pull, _ = pulls(scene.truth, result.disks)
        assert np.abs(pull).max() < 4


UNEQUAL = {
    "spread of 30 %": spread(0.3),
    "a fifth at half": scaled(0.2, 0.5),
    "15 % at 0.35": scaled(0.15, 0.35),
}


@pytest.mark.parametrize("name", UNEQUAL)
def test_contacts_of_many_brightnesses_are_all_found_and_right_within_their_errors(name):
    world = World(layout=Layout(radii=(3, 16), pairs=0), alter=UNEQUAL[name])
    seen = []
    for seed in range(4):
        scene = world(25, np.random.default_rng([37, seed]))
        result = measure_image(scene.frame, scene.reference)
        pull, _ = pulls(scene.truth, result.disks)
        assert len(result.disks) == len(scene.truth)
        seen.append(np.abs(pull))
    seen = np.concatenate(seen)
    # 100 normal deviates: 68 +- 4.7 % and 95 +- 2.1 %, three times that
    assert np.mean(seen < 1) > 0.54
    assert np.mean(seen < 2) > 0.885


@pytest.mark.parametrize(("electrons", "contrast", "factor"), [(3.0, 20.0, 0.5), (8.0, 22.0, 0.35)])
def test_faint_contacts_that_noise_tears_are_one_contact_each(electrons, contrast, factor):
    """At the level of the others, and in squares of 2 px, noise is as high as they are."""
    world = World(
        layout=Layout(radii=(5, 22), pairs=0),
        alter=scaled(0.2, factor),
        electrons=electrons,
        contrast=contrast,
    )
    for seed in range(3):
        scene = world(25, np.random.default_rng([9, 1 + round(electrons), seed]))
        result = measure_image(scene.frame, scene.reference)
        wide = scene.truth[scene.truth.radius_px > 6].reset_index(drop=True)
        assert len(result.disks) <= len(scene.truth)
        pull, _ = pulls(wide, result.disks)
        assert np.abs(pull).max() < 4


def test_the_texture_of_the_surface_makes_no_faint_contacts():
    """Texture is as high in coarse squares as in fine ones, noise is not."""
    world = World(
        layout=Layout(radii=(6, 18), pairs=0),
        texture=0.05,
        electrons=20.0,
        contrast=31.0,
        reference=False,
    )
    for seed in range(3):
        scene = world(4, np.random.default_rng([7, seed]))
        assert len(measure_image(scene.frame).disks) == 4


@pytest.mark.parametrize("polarity", ["auto", "dark"])
def test_dark_contacts_that_cover_most_of_a_field_stop_are_found(polarity):
    """Scattered as all blocks are, the light of none of them would stand out."""
    world = World(layout=Layout(radii=(7, 29), covered=0.3, region=in_stop), light=field_stop, contrast=-40.0)
    scene = world(60, np.random.default_rng(3))
    result = measure_image(scene.frame, scene.reference, polarity=polarity)
    assert result.polarity == "dark"
    assert len(match(scene.truth, result.disks)) >= 0.95 * len(scene.truth)


def test_the_message_tells_how_many_contacts_have_a_brightness_of_their_own():
    scene = make_scene("20 % at half", 25, 13)
    result = measure_image(scene.frame, scene.reference)
    own = int(np.count_nonzero(result.disks["flags"] & int(Flag.BRIGHTNESS)))
    assert own >= 1
    assert f"{own} of {len(result.disks)} contacts have a brightness of their own" in result.message


def test_equal_contacts_have_no_brightness_of_their_own():
    scene = make_scene("plain", 25, 13)
    disks = measure_image(scene.frame, scene.reference).disks
    assert len(disks) == len(scene.truth)
    assert not (disks["flags"] & int(Flag.BRIGHTNESS)).any()


def test_contacts_darker_than_the_background_among_bright_ones_are_said():
    scene = make_scene("20 % dark", 25, 13)
    result = measure_image(scene.frame, scene.reference)
    assert result.status != "ok"
    bright = scene.truth[scene.truth.brightness > 0].reset_index(drop=True)
    assert len(match(bright, result.disks)) == len(bright)
