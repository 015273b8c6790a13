"""Frames of ordinary cameras and files: dark corners, clipped background, white margins, few grey levels."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_worlds import Layout, World, gamma, jpeg, make_scene, thresholded
from contact_frames import match

from contactimg.imaging.fit.disks import fit_disks
from contactimg.imaging.fit.problem import ContrastPrior, FitProblem
from contactimg.imaging.measure import measure_image
from contactimg.imaging.pixels.field_of_view import find_margin, find_unlit
from contactimg.imaging.pixels.noise import Noise
from contactimg.imaging.pixels.sensor_defects import mosaic_gains
from contactimg.tables import Status


@pytest.fixture(scope="module")
def plain():
    return make_scene("plain", 60, 43)


def shares(truth, disks):
    """Share of the contacts that are found, and of the finds that are contacts."""
    pairs, required = match(truth, disks), truth["required"].to_numpy(bool)
    return np.count_nonzero(required[pairs[:, 0]]) / required.sum(), len(pairs) / max(len(disks), 1)


def darker(image, level):
    """The image with the median of its levels moved to another one; what falls below 0 is clipped."""
    return np.clip(image.astype(int) - int(np.median(image)) + level, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("level", [4, 1, -4])
@pytest.mark.parametrize("with_reference", [True, False])
def test_contacts_on_a_background_clipped_at_black_are_found(plain, level, with_reference):
    """Corners that are 0 throughout are no field stop, and show neither noise nor light."""
    frame, reference = (darker(image, level) for image in (plain.frame, plain.reference))
    found = measure_image(frame, reference if with_reference else None, polarity="bright")
    recall, precision = shares(plain.truth, found.disks)
    # below a clipped background the smallest contacts are hidden; only a reference shows where
    assert recall >= (0.85 if level < 0 and not with_reference else 0.95)
    assert precision >= 0.95
    assert recall >= 0.95 or found.status != Status.OK


@pytest.mark.parametrize(("period", "depth"), [(25, 0.03), (40, 0.03), (60, 0.08), (100, 0.08)])
def test_flicker_of_the_light_hides_no_background(period, depth):
    """Mains light and a shutter that reads row by row make bands, of which only the darkest look empty."""

    def bands(rows, rng):
        return 1.0 + depth * np.sin(2 * np.pi * np.arange(rows) / period + rng.uniform(0, 6.3))

    for count in (25, 140):
        scene = World(rows=bands)(count, np.random.default_rng(511 + period))
        disks = measure_image(scene.frame, scene.reference, polarity="bright").disks
        assert shares(scene.truth, disks) == (1.0, 1.0)
        area = (scene.truth.area_px2 * scene.truth.visible).sum()
        assert disks.visible_area_px2.sum() == pytest.approx(area, rel=0.01)


@pytest.mark.parametrize(("world", "count"), [("flicker", 25), ("step", 140)])
def test_flat_blocks_that_scatter_far_more_are_not_the_light(world, count):
    """The light of all flat blocks describes more of a frame with bands or a step, but none of it well."""
    scene = make_scene(world, count, 31)
    disks = measure_image(scene.frame, scene.reference, polarity=scene.polarity).disks
    assert shares(scene.truth, disks) == (1.0, 1.0)


CHANGED_LIGHT = {
    "shadow on half of the frame": lambda u, v, shape: 1.0 - 0.4 / (1.0 + np.exp(-u * shape[1] / 40.0)),
    "broad shadow": lambda u, v, shape: 1.0 - 0.5 * np.exp(-((u - 0.4) ** 2 + (v + 0.4) ** 2) / 0.3),
    "waves": lambda u, v, shape: 1.0 + 0.1 * np.sin(2.0 * np.pi * u) * np.cos(1.5 * np.pi * v),
}


@pytest.mark.parametrize(
    ("light", "count", "seed"),
    [
        ("shadow on half of the frame", 140, 1),
        ("shadow on half of the frame", 25, 3),
        ("broad shadow", 25, 2),
        ("broad shadow", 300, 3),
        ("waves", 300, 3),
    ],
)
def test_light_that_changed_strongly_is_estimated_from_the_difference(light, count, seed):
    """Else the most common level is taken for the background, and darker light for no contact."""
    scene = World(own_light=CHANGED_LIGHT[light])(count, np.random.default_rng([77, count, seed]))
    found = measure_image(scene.frame, scene.reference)
    assert min(shares(scene.truth, found.disks)) >= 0.97
    assert found.status == Status.OK


def test_dark_contacts_nearest_to_the_level_of_the_reference_are_no_background():
    """The light is 1.4 times the reference, and the contacts let through half of it."""
    world = World(own_light=lambda u, v, shape: 1.4 + 0.0 * u, contrast=-35.0, layout=Layout(radii=(6, 40)))
    scene = world(60, np.random.default_rng([77, 1]))
    found = measure_image(scene.frame, scene.reference)
    assert found.polarity == "dark"
    assert min(shares(scene.truth, found.disks)) >= 0.95


def test_a_slow_fall_of_the_light_is_no_field_stop():
    y, x = np.mgrid[:480, :640]
    distance = np.hypot(x - 320, y - 240)
    slow, sharp = (100.0 / (1.0 + np.exp((distance - 260) / width)) for width in (40.0, 2.0))
    assert find_unlit(slow.astype(np.float32), None) is None
    mask = find_unlit(sharp.astype(np.float32), None)
    assert mask is not None
    assert mask[distance > 275].all()
    assert not mask[distance < 245].any()


def falling(u, v, shape):
    """Light that falls from one row to the next by more than the noise of a block."""
    return 1 + 0.1 * v + 0 * u


WITHOUT_REFERENCE = {
    "bright contacts on a fifth of a field stop": lambda: make_scene("wide in a stop, no ref", 25, 11),
    "means rounded by JPEG, noise kept": lambda: make_scene("noisy JPEG 70, no ref", 25, 12),
    "rounded means, faint contacts": lambda: World(
        electrons=4, texture=0.005, contrast=20.0, file=jpeg(70), reference=False
    )(25, np.random.default_rng([5, 25, 12])),
    "quiet rows": lambda: World(
        layout=Layout(radii=(5, 40)), own_light=falling, contrast=40.0, electrons=150.0, texture=0.003,
        dusty=False, reference=False,
    )(25, np.random.default_rng([5, 25, 11])),
}  # fmt: skip


@pytest.mark.parametrize(
    ("quality", "electrons", "texture"), [(85, 150, 0.005), (70, 20, 0.02), (70, 150, 0.02)]
)
def test_three_wide_contacts_in_a_compressed_file_are_found_without_a_reference(quality, electrons, texture):
    """Compression leaves most squares equal, and block means that are equal or a step apart."""
    world = World(
        layout=Layout(radii=(10, 50), shape=(310, 221)), file=jpeg(quality), electrons=electrons,
        texture=texture, contrast=40.0, response=gamma(0.45), dusty=False, reference=False,
    )  # fmt: skip
    for seed in (1, 2):
        scene = world(3, np.random.default_rng(seed))
        found = measure_image(scene.frame, None)
        assert found.polarity == "bright"
        assert shares(scene.truth, found.disks) == (1.0, 1.0)


@pytest.mark.parametrize("name", list(WITHOUT_REFERENCE))
def test_the_background_of_an_ordinary_frame_is_found_without_a_reference(name):
    """With the wrong background or polarity nearly all contacts are lost, or some are cut into parts."""
    scene = WITHOUT_REFERENCE[name]()
    found = measure_image(scene.frame, None)
    assert found.polarity == "bright"
    assert min(shares(scene.truth, found.disks)) >= 0.95
    assert found.status == Status.OK


@pytest.mark.parametrize("with_reference", [True, False])
@pytest.mark.parametrize("level", [255, 128])
def test_a_frame_on_a_page_of_one_level_is_measured_as_without_the_page(plain, level, with_reference):
    def page(image):
        return np.pad(image, ((41, 30), (53, 60)), constant_values=level)

    reference = plain.reference if with_reference else None
    alone = measure_image(plain.frame, reference)
    framed = measure_image(page(plain.frame), None if reference is None else page(reference))
    place = {"x_px": plain.truth["x_px"] + 53, "y_px": plain.truth["y_px"] + 41}
    assert min(shares(plain.truth.assign(**place), framed.disks)) >= min(
        *shares(plain.truth, alone.disks), 0.97
    )


@pytest.mark.parametrize("gain", [3.3, 3.6])
def test_an_overexposed_reference_is_given_up(plain, gain):
    """Where it is at full scale, what light falls on the sample is not known."""
    reference = np.clip(plain.reference * gain, 0, 255).astype(np.uint8)
    assert 0.1 < np.mean(reference == 255) < 1.0
    result = measure_image(plain.frame, reference)
    assert min(shares(plain.truth, result.disks)) >= 0.95
    assert result.status == Status.BAD_REFERENCE


@pytest.mark.parametrize("full_scale", [255 / 999, 255e-6, 4095 / 65535, 1.0])
def test_white_pixels_are_at_any_full_scale(plain, full_scale):
    """Levels that single precision rounds down, as it does half of all, are at full scale as well."""

    def stored(image, gain=1):
        levels = np.clip(image.astype(float) * gain, 0, 255)
        return np.pad(levels, 40, constant_values=255.0) * (full_scale / 255.0)

    page = measure_image(stored(plain.frame), stored(plain.reference), full_scale=full_scale)
    assert page.status == Status.OK
    place = {name: plain.truth[name] + 40 for name in ("x_px", "y_px")}
    assert min(shares(plain.truth.assign(**place), page.disks)) > 0.95
    bright = measure_image(stored(plain.frame, 2), stored(plain.reference, 2), full_scale=full_scale)
    assert bright.status == Status.SATURATED
    white = np.full((24, 32), full_scale)
    assert measure_image(white, full_scale=full_scale).status == Status.WHITE


def test_a_white_contact_at_the_border_is_no_margin():
    """A margin reaches all four sides, and what it surrounds is one convex region."""
    y, x = np.mgrid[:240, :320]
    contact = np.where(np.hypot(x, y) < 90, 255, 60).astype(np.uint8)
    assert find_margin(contact, None, 255.0) is None
    frame = np.full((240, 320), 255, np.uint8)
    frame[20:200, 30:290] = 60
    mask = find_margin(frame, None, 255.0)
    assert mask is not None
    assert mask[frame == 255].all()
    assert not mask[25:195, 35:285].any()
    assert find_margin(frame, None, 65535.0) is None  # background without noise looks like that, too


@pytest.mark.parametrize("hole", ["corner", "band", "lines"])
def test_holes_do_not_hide_a_white_margin(hole):
    scene = make_scene("margin, no ref", 140, 3)
    frame = scene.frame.astype(np.float32)
    frame[{"corner": np.s_[:20, :20], "band": np.s_[:12], "lines": np.s_[:, ::50]}[hole]] = np.nan
    disks = measure_image(frame, full_scale=255.0).disks
    assert min(shares(scene.truth, disks)) > 0.95
    assert disks["visible_area_px2"].sum() == pytest.approx(scene.truth["area_px2"].sum(), rel=0.01)


@pytest.mark.parametrize("count", [60, 140])
def test_a_reference_without_noise_hides_no_contact(count):
    """A reference of one level or a smoothed one says nothing of the noise of the frame."""
    scene = make_scene("plain", count, 43)
    flat = np.full_like(scene.reference, int(np.median(scene.reference)))
    smooth = cv2.GaussianBlur(scene.reference.astype(np.float32), (0, 0), 10)
    for frame, reference in ((scene.frame, flat), (scene.frame.astype(np.float32), smooth)):
        assert min(shares(scene.truth, measure_image(frame, reference).disks)) >= 0.95


@pytest.mark.parametrize("steepness", [20.0, 30.0])
def test_contacts_under_light_that_falls_steeply_are_found_without_a_reference(plain, steepness):
    rows, columns = plain.frame.shape
    y, x = np.mgrid[:rows, :columns]
    circle = 1.0 / (1.0 + np.exp((np.hypot(x - columns / 2, y - rows / 2) - 0.5 * columns) / steepness))
    frame = np.rint(plain.frame * circle).astype(np.uint8)
    light = circle[np.rint(plain.truth["y_px"]).astype(int), np.rint(plain.truth["x_px"]).astype(int)]
    lit = plain.truth.assign(required=plain.truth["required"] & (light > 0.2))
    found = measure_image(frame, polarity="bright")
    assert shares(lit, found.disks)[0] >= 0.93
    assert shares(plain.truth, found.disks)[1] >= 0.95


@pytest.mark.parametrize("kind", ["0 and 255", "0 and 1", "inverted"])
def test_a_thresholded_frame_says_so_and_loses_no_region(plain, kind):
    """What a threshold has left out cannot be seen: such a frame is never "ok"."""
    mask = thresholded(plain.frame)
    frame = {"0 and 255": mask, "0 and 1": mask // 255, "inverted": 255 - mask}[kind]
    found = measure_image(frame, polarity="dark" if kind == "inverted" else "bright")
    regions = cv2.connectedComponentsWithStats(mask)[2][1:, cv2.CC_STAT_AREA]
    assert len(found.disks) >= np.count_nonzero(regions > 9)
    assert found.status != Status.OK
    assert "grey levels apart" in found.message
    assert "grey levels apart" not in measure_image(plain.frame).message


def test_the_optics_of_a_thresholded_frame_serve_others():
    """Its edges are as sharp as its pixels: a blur of 0, which another frame takes as it is."""
    frames = [make_scene("thresholded, no ref", 25, seed).frame for seed in (1, 2)]
    lent = measure_image(frames[0], polarity="bright").own_optics
    assert lent.blur_px == 0.0
    alone, helped = (
        measure_image(frames[1], polarity="bright", optics=optics).disks["radius_px"].to_numpy()
        for optics in (None, replace(lent, edge=None, blur_std_px=0.1))
    )
    assert helped == pytest.approx(alone, rel=0.01)


def test_a_disk_without_a_radius_is_fitted_with_its_neighbour():
    """A candidate as narrow as the blur has no radius of its own; a lens without height stopped the fit."""
    y, x = np.mgrid[:40, :40]
    image = (50.0 * (np.hypot(x - 20, y - 20) < 4)).astype(np.float32)
    problem = FitProblem(image, Noise(1.0), ContrastPrior.loose(50.0))
    start = np.array([[20.0, 20.0, 3.5, 50.0], [21.0, 20.0, 0.0, 50.0]])
    fit = fit_disks(problem, start, blur=1.0)
    assert np.isfinite(fit.disks).all()
    assert (fit.disks[:, 2] > 0).all()


def test_few_grey_levels_are_no_colour_mosaic(plain):
    """The median of whole numbers jumps by one: of a background of two levels that would be a gain of 0.5."""
    for level in (-8, -4, 0, 4):
        assert mosaic_gains(darker(plain.frame, level)) is None
    dim = darker(plain.frame, 40).astype(float)
    dim[::2, ::2] *= 0.8
    gains = mosaic_gains(np.rint(dim).astype(np.uint8))
    assert gains is not None
    assert gains[0, 0] / gains[1, 1] == pytest.approx(0.8, rel=0.03)


def test_a_frame_says_how_much_of_it_shows_nothing(plain):
    """Contacts that no light reaches are missing from the sum of areas."""
    stopped = make_scene("field stop", 25, 43)
    hidden = np.mean(find_unlit(stopped.frame, None))
    assert f"{100 * hidden:.2g} % of the frame were left out" in measure_image(stopped.frame).message
    assert "left out" not in measure_image(plain.frame).message
