"""Views of a background, where they agree, their sums, and the radii of contacts in them."""

import cv2
import numpy as np
import pytest

from contactimg.imaging.background.alignment import Alignment
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.pooled import (
    Contacts,
    Placement,
    PooledBackground,
    RimSums,
    View,
    average_references,
    compare_views,
    correct_radii,
    excess_variance,
)
from contactimg.imaging.profile.blurred_disk import blurred_disk
from contactimg.optics.synthetic_background import surface_texture

SHAPE = (240, 320)
LEVEL, NOISE, CONTRAST, BLUR = 80.0, 2.0, 1.2, 1.4
NO_DISKS = np.empty((0, 3))


def surface(shift=(0.0, 0.0)):
    texture = surface_texture(SHAPE, rms=0.03, blur_px=BLUR, shift_px=shift, seed=5)
    return LEVEL * (1.0 + texture)


def exposed(rng, *, shift=(0.0, 0.0), light=1.0):
    return light * surface(shift) + rng.normal(0.0, NOISE, SHAPE)


def spot(x, y, radius):
    image, reach = np.zeros(SHAPE), int(radius + 6 * BLUR)
    rows, columns = (slice(max(int(c) - reach, 0), int(c) + reach + 1) for c in (y, x))
    part = np.hypot(np.arange(SHAPE[1])[columns] - x, (np.arange(SHAPE[0])[rows] - y)[:, None])
    image[rows, columns] = blurred_disk(part, radius, BLUR)
    return image


def still(light=1.0):
    grid = np.zeros((4, 4))
    grid[0, 0] = light
    illumination = Illumination(grid, np.ones((30, 40), np.bool_), 0.0)
    return Placement(Alignment(0.0, 0.0, 0.0), illumination)


@pytest.fixture
def shifted_views(rng):
    """Twelve views of a surface that has moved and whose light has changed, and the surface."""
    anchor = exposed(rng)
    views = [View.plain(anchor)]
    for _ in range(12):
        shift = tuple(rng.uniform(-3.0, 3.0, 2))
        gradient = 1.05 + 0.04 * np.linspace(-1, 1, SHAPE[1])
        frame = exposed(rng, shift=shift, light=gradient)
        views.append(Placement.of(frame, anchor, background_is="lowest").view(frame, NO_DISKS))
    return views


def pooled_of(views, sign=1):
    agreement = compare_views([view.squares() for view in views], sign=sign)
    pooled = PooledBackground.empty(SHAPE)
    for view, used, light in zip(views, agreement.used, agreement.light, strict=True):
        pooled = pooled.plus(view.restricted(used, light))
    return pooled, agreement


def test_any_number_of_views_may_be_summed(rng):
    view = View.plain(exposed(rng))
    pooled = PooledBackground.empty(SHAPE).plus(view, 300)
    assert (pooled.count == 300).all()
    # the sum has single precision
    assert pooled.mean() == pytest.approx(view.image, rel=1e-6)
    assert (pooled.plus(view, -45).count == 255).all()


def test_mean_of_shifted_views_has_the_noise_of_a_mean(shifted_views):
    pooled, _ = pooled_of(shifted_views)
    inner = (slice(10, -10), slice(10, -10))
    error = (pooled.mean() - surface())[inner]
    # noise sigma/sqrt(13), less what interpolation smooths; a registration to 0.02 px and a cubic of the
    # light leave less than a tenth of that
    assert 0.85 < np.std(error) / (NOISE / np.sqrt(13)) < 1.1
    assert abs(np.mean(error)) < 0.1
    assert pooled.count[inner].min() >= 12


def test_a_view_is_taken_out_again(shifted_views):
    pooled, agreement = pooled_of(shifted_views)
    own = shifted_views[3].restricted(agreement.used[3], agreement.light[3])
    rest, _ = pooled_of([*shifted_views[:3], *shifted_views[4:]])
    inner = (slice(10, -10), slice(10, -10))
    np.testing.assert_allclose(pooled.plus(own, -1).mean()[inner], rest.mean()[inner], atol=0.1)


def test_what_one_view_alone_shows_is_left_out(rng):
    views = [View.plain(exposed(rng)) for _ in range(6)]
    ghost = exposed(rng) * (1.0 + CONTRAST * spot(150, 100, 6.0))
    pooled, _ = pooled_of([View.plain(ghost), *views])
    place = (slice(97, 104), slice(147, 154))
    assert pooled.count[place].max() == 6
    np.testing.assert_allclose(pooled.mean()[place].mean(), surface()[place].mean(), atol=0.5)


def test_overlooked_contacts_do_not_outvote_the_background(rng):
    """Most views show a contact that was not found; the background is where two do not show it."""
    views = [View.plain(exposed(rng)) for _ in range(3)]
    views += [View.plain(exposed(rng) * (1.0 + CONTRAST * spot(150, 100, 6.0))) for _ in range(6)]
    pooled, _ = pooled_of(views)
    np.testing.assert_allclose(
        pooled.mean()[97:104, 147:154].mean(), surface()[97:104, 147:154].mean(), atol=1.0
    )
    dark = [View.plain(2 * LEVEL - view.image) for view in views]
    pooled, _ = pooled_of(dark, sign=-1)
    mirrored = 2 * LEVEL - surface()
    np.testing.assert_allclose(
        pooled.mean()[97:104, 147:154].mean(), mirrored[97:104, 147:154].mean(), atol=1.0
    )


def test_a_frame_that_differs_everywhere_is_left_out(rng):
    views = [View.plain(exposed(rng)) for _ in range(5)]
    other = LEVEL * (1 + surface_texture(SHAPE, rms=0.03, blur_px=BLUR, shift_px=(0.0, 0.0), seed=6))
    agreement = pooled_of([*views, View.plain(other + rng.normal(0, NOISE, SHAPE))])[1]
    assert agreement.left_out.tolist() == [False] * 5 + [True]


def test_place_that_no_view_shows_is_filled_from_around(rng):
    hidden = np.array([[150.0, 100.0, 10.0]])
    views = [still().view(exposed(rng), hidden) for _ in range(4)]
    pooled, _ = pooled_of(views)
    assert pooled.count[100, 150] == 0
    assert abs(pooled.mean()[100, 150] - LEVEL) < 5.0
    np.testing.assert_allclose(pooled.views_at(*np.array([[150.0], [100.0], [5.0]])), 0.1)
    np.testing.assert_allclose(pooled.views_at(*np.array([[50.0], [100.0], [5.0]])), 4.0)


def grown(rng, errors, *, radii, places):
    """Views in which contacts of wrong radii were divided out, their rims, and the truth."""
    views, rims = [View.plain(exposed(rng))], []
    for radius, error in zip(radii, errors, strict=True):
        light, divided = np.ones(SHAPE), np.ones(SHAPE)
        for (x, y), wrong in zip(places, error, strict=True):
            light += CONTRAST * spot(x, y, radius)
            divided += CONTRAST * spot(x, y, radius + wrong)
        frame = surface() * light + rng.normal(0.0, NOISE, SHAPE)
        views.append(View.plain(frame / divided))
        disks = np.column_stack([places, radius + error, np.full(len(places), 0.1)])
        rims.append(Contacts(disks, NO_DISKS, CONTRAST, BLUR))
    return views, rims


def test_radii_are_corrected_together_with_the_background(rng):
    places = np.array([(x, y) for x in range(30, 300, 60) for y in range(30, 220, 60)], float)
    radii = np.linspace(3.0, 8.0, 10)
    errors = rng.normal(0.0, 0.1, (len(radii), len(places)))
    views, rims = grown(rng, errors, radii=radii, places=places)
    pooled = PooledBackground.empty(SHAPE)
    for view in views:
        pooled = pooled.plus(view)
    smooth = cv2.blur(views[0].image, (33, 33))
    sums = [RimSums.of(rim, view, smooth) for rim, view in zip(rims, views[1:], strict=True)]
    corrections = correct_radii(sums, pooled, smooth, noise=NOISE)
    left = errors + np.stack(corrections)
    # one frame leaves the noise of a rim, sigma/(contrast level) sqrt(2 sqrt(pi) s/(2 pi a)) = 0.02 px
    assert np.std(left) < 0.25 * np.std(errors)
    before = np.std(pooled.mean() - surface())
    for part, correction in zip(sums, corrections, strict=True):
        pooled = pooled.without_rings(part.templates, correction)
    assert np.std(pooled.mean() - surface()) < before


def at_places(*radii):
    """Contacts of these radii at places that are the same each time."""
    disks = [[50.0 * number, 0.0, radius, 0.1] for number, radius in enumerate(radii)]
    return Contacts(np.array(disks), NO_DISKS, CONTRAST, BLUR)


def test_what_the_background_adds_to_a_radius():
    frame = at_places(5.0, 5.0, 5.0)
    others = [at_places(5.0, 12.0), at_places(5.0, 20.0), at_places(5.0)]
    excess = excess_variance(frame, np.array([4.0, 4.0, 4.0]), others)
    # the same rim in three of four other views leaves one that shows the place: 1; rims elsewhere: 1/4
    np.testing.assert_allclose(excess, [1.0, 0.25, 0.25], atol=0.01)
    without = excess_variance(frame, np.array([3.0, 3.0, 3.0]), others[1:])
    assert without[0] == pytest.approx(excess[0], rel=0.05)


def test_the_background_never_takes_from_the_variance_of_a_radius():
    """Contacts of one place in all views, whose rims mask most of the pixels that the views could show."""
    contacts = at_places(4.0, 5.0, 6.0)
    for count in range(1, 12):
        for views in (0.0, 0.2, 1.0, 3.0, 20.0):
            assert (excess_variance(contacts, np.full(3, views), [contacts] * count) > 0).all()


def test_references_are_averaged_without_one_that_shows_a_contact(rng):
    shifts = [(0.0, 0.0), (0.4, -0.3), (-1.6, 0.8), (0.2, 2.3)]
    images = [exposed(rng, shift=shift) for shift in shifts]
    images.insert(2, exposed(rng) * (1.0 + 0.5 * spot(150, 100, 30.0)))
    mean, left_out = average_references(images)
    assert left_out == [2]
    error = (mean - surface())[10:-10, 10:-10]
    assert 0.85 < np.std(error) / (NOISE / np.sqrt(4)) < 1.1


def test_copies_of_a_reference_count_once(rng):
    image = exposed(rng)
    mean, left_out = average_references([image, image.copy()])
    assert left_out == []
    np.testing.assert_allclose(mean, image, rtol=1e-5)
