"""The whole measurement of one frame: accuracy, invariances, the threshold's contract, hard frames."""

import dataclasses
import re
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from contact_frames import FINITE, Optics, expose, match, render, scatter

from contactimg.errors import FrameError, InputError
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.measure import ImageMeasurement, measure_image
from contactimg.imaging.profile.blurred_disk import blurred_disk
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.tables import Flag

OPTICS = Optics(shape=(260, 340), dust=3)


def disks(*rows):
    return pd.DataFrame(rows, columns=["x_px", "y_px", "radius_px"], dtype=float).assign(kind=0)


def scene(seed=0, count=18, radii=(1.5, 14), **options):
    optics = dataclasses.replace(OPTICS, **options)
    rng = np.random.default_rng(seed)
    truth = scatter(count, optics, rng, radii=radii, pairs=0, touching=0)
    return truth, *render(truth, optics, rng)


@pytest.fixture(scope="module")
def usual():
    return scene()


@pytest.fixture(scope="module")
def measured(usual):
    """What each method makes of the usual frame."""
    return {method: measure_image(*usual[1:], method=method) for method in ("disk", "threshold")}


def assert_sound(result):
    """Every row finite, flags known, labels 1, 2, ..., types as promised."""
    assert isinstance(result, ImageMeasurement)
    assert np.isfinite(result.disks[list(FINITE)].to_numpy(float)).all()
    assert (result.disks.radius_std_px > 0).all()
    assert (result.disks.radius_px > 0).all()
    assert list(result.disks.label) == list(range(1, len(result.disks) + 1))
    assert np.isfinite(result.rejected[["x_px", "y_px", "radius_px"]].to_numpy(float)).all()
    assert np.isfinite([result.contrast, result.noise]).all()
    assert result.status == "ok" or result.message
    assert result.difference.dtype == np.float32


def test_radii_are_right_within_their_errors(usual, measured):
    truth, _, reference = usual
    result = measured["disk"]
    assert_sound(result)
    pairs = match(truth, result.disks)
    assert len(pairs) == len(truth) == len(result.disks)
    pull = (
        result.disks.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    ) / result.disks.radius_std_px.to_numpy()[pairs[:, 1]]
    # 18 normal deviates: none beyond 4, and the sum of squares below the 99.9 % point of chi-square, 42.3
    assert np.abs(pull).max() < 4
    assert np.sum(pull**2) < 42.3
    assert result.blur_px == pytest.approx(1.4, abs=0.02)
    # median level of the reference times 1.25: 80/1.02 with vignetting of 20 % towards the corners
    assert result.contrast == pytest.approx(1.25 * np.median(reference), rel=0.02)
    assert np.hypot(result.shift_x_px + 0.4, result.shift_y_px - 0.3) < 0.2
    assert (result.polarity, result.status, result.message) == ("bright", "ok", "")
    assert np.isnan(result.threshold)


def test_dark_contacts_are_measured_alike(usual, measured):
    truth, frame, reference = usual
    bright = measured["disk"]
    dark = measure_image(2 * reference.astype(float) - frame, reference.astype(float))
    assert dark.polarity == "dark"
    assert dark.contrast == pytest.approx(-bright.contrast, rel=0.05)
    pairs = match(truth, dark.disks)
    assert len(pairs) == len(truth)
    # twice the reference brings in its noise, and the texture is that of a bright contact: some 0.02 px
    error = dark.disks.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    assert np.abs(error).max() < 0.15


TURNS = {
    "mirrored": lambda image: image[:, ::-1],
    "upside down": lambda image: image[::-1],
    "transposed": lambda image: image.T,
}


@pytest.mark.parametrize(
    ("turn", "method"), [("mirrored", "disk"), ("transposed", "disk"), ("upside down", "threshold")]
)
def test_a_turned_frame_has_the_same_contacts(turn, method, usual, measured):
    turned = measure_image(*(np.ascontiguousarray(TURNS[turn](image)) for image in usual[1:]), method=method)
    before, after = (np.sort(one.disks["radius_px"].to_numpy()) for one in (measured[method], turned))
    assert len(after) == len(before)
    # pixels are summed in another order, and blocks begin at another border; counts differ by a pixel
    if method == "disk":
        np.testing.assert_allclose(after, before, atol=0.03)
    else:
        np.testing.assert_allclose(np.pi * after**2, np.pi * before**2, rtol=0.005, atol=2.0)


@pytest.mark.parametrize("method", ["disk", "threshold"])
@pytest.mark.parametrize("unit", [1e-6, 257.0])
def test_grey_levels_may_have_any_unit(usual, measured, unit, method):
    _, frame, reference = usual
    plain = measured[method]
    scaled = measure_image(frame * unit, reference * unit, method=method, full_scale=255 * unit)
    assert scaled.contrast == pytest.approx(plain.contrast * unit, rel=1e-3)
    assert scaled.noise == pytest.approx(plain.noise * unit, rel=1e-3)
    assert np.allclose(scaled.disks.radius_px, plain.disks.radius_px, rtol=1e-3)
    assert list(scaled.disks["flags"]) == list(plain.disks["flags"])


def test_twelve_bits_in_sixteen(usual):
    truth, frame, reference = usual
    result = measure_image(frame.astype(np.uint16) * 16, reference.astype(np.uint16) * 16, full_scale=4095)
    assert len(result.disks) == len(truth)
    assert result.contrast > 1000


def test_nested_lists_are_an_image():
    image = np.full((24, 24), 50, np.uint8)
    assert measure_image(image.tolist(), image.tolist()).status == measure_image(image, image).status


def test_result_does_not_depend_on_memory_layout(usual, measured):
    _, frame, reference = usual
    other = measure_image(np.asfortranarray(frame), np.asfortranarray(reference))
    assert other.disks.equals(measured["disk"].disks)


def test_threshold_is_a_fraction_of_one_plateau():
    # noiseless frame of one large disk: radius against threshold follows the blurred edge a + s Phi^-1(1 - t)
    optics = dataclasses.replace(
        OPTICS, texture=0, dust=0, vignetting=0, camera=(1e6, 1.0), gain=1.0, full_scale=65535.0
    )
    frame, reference = render(disks((170.3, 130.4, 60)), optics, np.random.default_rng(0))
    frame, reference = frame.astype(float), reference.astype(float)
    y, x = np.mgrid[0:260, 0:340]
    profile = blurred_disk(np.hypot(x - 170.3, y - 130.4), 60.0, np.hypot(1.4, 12**-0.5))
    for threshold in (0.2, 0.5, 0.8):
        result = measure_image(frame, reference, method="threshold", threshold=threshold)
        assert result.threshold == threshold
        assert result.contrast == pytest.approx(100.0, abs=0.6)
        # levels are whole numbers of a hundred: half a level is 0.5/100 sqrt(2 pi) 1.43 = 0.02 px of the rim
        expected = np.sqrt(np.count_nonzero(profile > threshold) / np.pi)
        assert result.disks.radius_px.iloc[0] == pytest.approx(expected, abs=0.025)


def test_automatic_threshold_lies_between_the_classes(usual):
    _, frame, reference = usual
    result = measure_image(frame, reference, method="threshold", threshold="auto")
    assert 0.3 < result.threshold < 0.7


def test_half_height_loses_small_contacts_that_the_fit_finds():
    truth = disks((60, 60, 1.5), (160, 60, 1.4), (60, 160, 9), (200, 150, 12), (260, 60, 7))
    frame, reference = render(truth, OPTICS, np.random.default_rng(5))
    assert len(match(truth, measure_image(frame, reference, method="threshold").disks)) == 3
    assert len(match(truth, measure_image(frame, reference).disks)) == 5


def test_faint_contacts_are_found_and_noise_is_not():
    truth, frame, reference = scene(seed=2, radii=(3, 14), contrast=14 / 80, camera=(20.0, 10.0))
    result = measure_image(frame, reference)
    pairs = match(truth, result.disks)
    assert len(pairs) == len(truth) == len(result.disks)
    rng = np.random.default_rng(0)
    empty = [expose(np.full(OPTICS.shape, 80.0), OPTICS, rng) for _ in range(6)]
    for frame, reference in zip(empty[::2], empty[1::2], strict=True):
        for method in ("disk", "threshold"):
            assert not len(measure_image(frame, reference, method=method).disks)


def test_a_given_blur_is_exact(usual, measured):
    given = measure_image(*usual[1:], blur_px=1.38)
    assert given.blur_px == pytest.approx(1.38, abs=1e-6)
    alone = measured["disk"].disks
    assert given.disks["blur_shift_px"].abs().max() < 0.1 * alone["blur_shift_px"].abs().max()


HARD = {
    "black": (lambda f, r: (np.zeros_like(f), r), "black"),
    "white": (lambda f, r: (np.full_like(f, 255), r), "white"),
    "constant": (lambda f, r: (np.full_like(f, 90), r), "constant"),
    "identical to its reference": (lambda f, r: (r, r.copy()), "identical to reference"),
    "without a finite pixel": (lambda f, r: (f * np.nan, r), "all holes"),
    "black reference": (lambda f, r: (f, np.zeros_like(r)), "reference without light"),
    "white reference": (lambda f, r: (f, np.full_like(r, 255)), "reference without light"),
    "one pixel": (lambda f, r: (f[:1, :1], r[:1, :1]), "constant"),
    "one row": (lambda f, r: (f[90:91], r[90:91]), None),
    "a few pixels": (lambda f, r: (f[:5, :7], r[:5, :7]), "no contact"),
    "black without reference": (lambda f, r: (np.zeros_like(f), None), "black"),
    "constant without reference": (lambda f, r: (np.full_like(f, 80), None), "constant"),
    "a line without reference": (lambda f, r: (f[90:91], None), None),
    "contacts that fill it": (lambda f, r: ((r * 2.2).astype(np.uint8), r), "light changed"),
    "background subtracted before": (lambda f, r: (f - 80.0, r - 80.0), "ok"),
}


@pytest.mark.parametrize("method", ["disk", "threshold"])
@pytest.mark.parametrize("name", HARD)
def test_hard_frames_are_named(usual, name, method):
    make, status = HARD[name]
    _, frame, reference = usual
    result = measure_image(*make(frame, reference), method=method)
    assert_sound(result)
    if status:
        assert result.status == status


def test_a_frame_with_holes_and_without_contacts_has_no_contact(usual, rng):
    _, _, reference = usual
    holed = reference.astype(np.float32) + rng.normal(0, 1, reference.shape).astype(np.float32)
    holed[100:130, 200:240] = np.nan
    result = measure_image(holed, reference)
    assert result.status == "no contact"
    assert "without a finite value" in result.message


def test_masked_pixels_are_holes_and_full_scale_is_that_of_the_type(usual):
    _, frame, reference = usual
    masked, holed = np.ma.array(frame), frame.astype(float)
    masked[100:130, 200:240], holed[100:130, 200:240] = np.ma.masked, np.nan
    found, known = measure_image(masked, reference), measure_image(holed, reference, full_scale=255)
    assert found.status == "holes"
    pd.testing.assert_frame_equal(found.disks, known.disks)


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_holes_are_left_out(usual, method):
    truth, frame, reference = usual
    holed = frame.astype(np.float32)
    holed[100:130, 200:240] = np.nan
    cut = truth.iloc[0]
    holed[int(cut.y_px), int(cut.x_px) : int(cut.x_px + cut.radius_px + 3)] = np.inf
    other = reference.astype(float)
    other[0] = np.nan
    result = measure_image(holed, other, method=method)
    assert_sound(result)
    assert result.status == "holes"
    seen = np.array(
        [
            np.isfinite(
                holed[max(int(y - a - 4), 0) : int(y + a + 5), max(int(x - a - 4), 0) : int(x + a + 5)]
            ).all()
            for x, y, a in truth[["x_px", "y_px", "radius_px"]].to_numpy()
        ]
    )
    whole = truth[seen & (truth.radius_px > 2.5)].reset_index(drop=True)
    assert len(match(whole, result.disks)) == len(whole)
    if method == "disk":
        nearest = np.hypot(result.disks.x_px - cut.x_px, result.disks.y_px - cut.y_px).idxmin()
        assert int(result.disks["flags"][nearest]) & Flag.EDGE
        assert result.disks.radius_px[nearest] == pytest.approx(cut.radius_px, abs=0.1)


def test_contacts_cut_by_the_border_are_flagged_and_right():
    truth = disks((0, 60, 12), (335, 200, 10), (170, 259, 20), (100, 120, 9))
    images = render(truth, OPTICS, np.random.default_rng(1))
    for method in ("threshold", "disk"):
        result = measure_image(*images, method=method)
        assert_sound(result)
        edge = result.disks["flags"].to_numpy() & int(Flag.EDGE) > 0
        assert edge.sum() == 3
    pairs = match(truth, result.disks)
    assert len(pairs) == 4
    radii = result.disks.radius_px.to_numpy()[pairs[:, 1]]
    assert np.abs(radii - truth.radius_px.to_numpy()[pairs[:, 0]]).max() < 0.15


def test_saturated_contacts_are_flagged_and_their_rims_still_fitted():
    truth = disks((60, 60, 12), (200, 70, 8), (120, 180, 15), (260, 190, 10))
    frame, reference = render(truth, dataclasses.replace(OPTICS, contrast=3.0), np.random.default_rng(1))
    result = measure_image(frame, reference)
    assert_sound(result)
    assert all(result.disks["flags"].to_numpy() & int(Flag.SATURATED))
    pairs = match(truth, result.disks)
    assert len(pairs) == 4
    error = result.disks.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    # cut at 255 of 320 levels, half height of what is seen lies 0.4 blur widths further out than that of the
    # light
    assert np.abs(error).max() < 0.5


@pytest.mark.parametrize("radius", [0.5, 0.8, 1.0])
def test_radii_below_a_pixel_stay_finite_and_flagged(radius):
    truth = disks((60.3, 60, radius), (200, 70.5, radius), (120, 180, radius))
    result = measure_image(*render(truth, OPTICS, np.random.default_rng(1)))
    assert_sound(result)
    assert all(result.disks["flags"].to_numpy() & int(Flag.TOO_SMALL))


def test_blur_wider_than_the_contacts():
    truth = disks((60, 60, 4), (200, 70, 3), (120, 180, 5), (260, 190, 4))
    for method in ("disk", "threshold"):
        result = measure_image(
            *render(truth, dataclasses.replace(OPTICS, sigma=6.0), np.random.default_rng(1)), method=method
        )
        assert_sound(result)
        assert len(result.disks) <= 8


def test_one_hot_pixel_is_no_contact(usual):
    rng = np.random.default_rng(3)
    frame, reference = (expose(np.full(OPTICS.shape, 80.0), OPTICS, rng) for _ in range(2))
    frame[100, 150] = 255
    for method in ("disk", "threshold"):
        result = measure_image(frame, reference, method=method)
        assert_sound(result)
        assert not len(result.disks)
    truth, frame, reference = usual
    frame = frame.copy()
    assert (np.hypot(truth.x_px - 310, truth.y_px - 150) > truth.radius_px + 10).all()
    frame[150, 310] = 255
    for method in ("disk", "threshold"):
        result = measure_image(frame, reference, method=method)
        assert not (np.hypot(result.disks.x_px - 310, result.disks.y_px - 150) < 4).any()


def test_dust_that_moved_is_no_contact(usual):
    truth, frame, reference = usual
    y, x = np.mgrid[0:260, 0:340]
    speck = 1 - 0.3 * np.exp(-((x - 250) ** 2 + (y - 30) ** 2) / (2 * 2.0**2))
    only_before = np.clip(np.rint(reference * speck), 0, 255).astype(np.uint8)
    only_after = np.clip(np.rint(frame * speck), 0, 255).astype(np.uint8)
    near = lambda table: np.hypot(table.x_px - 250, table.y_px - 30) < 6  # noqa: E731
    for image, background in ((frame, only_before), (only_after, reference)):
        result = measure_image(image, background)
        assert len(match(truth, result.disks)) == len(truth)
        assert not near(result.disks).any()
    assert "dust in the reference" in set(measure_image(frame, only_before).rejected.reason)


def test_light_drift_does_no_harm():
    truth, frame, reference = scene(seed=6, drift=0.02)
    result = measure_image(frame, reference)
    pairs = match(truth, result.disks)
    assert len(pairs) == len(truth)
    pull = (
        result.disks.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    ) / result.disks.radius_std_px.to_numpy()[pairs[:, 1]]
    assert np.sum(pull**2) < 42.3  # as above


def test_without_reference_it_is_said(usual):
    truth, frame, _ = usual
    result = measure_image(frame)
    assert "no reference" in result.message
    assert np.isnan(result.shift_x_px)
    assert len(match(truth[truth.radius_px > 2].reset_index(drop=True), result.disks)) == np.sum(
        truth.radius_px > 2
    )


def test_what_cannot_be_measured_is_refused(usual):
    _, frame, reference = usual
    with pytest.raises(
        FrameError, match="the reference must have the size of the frame, 340 x 260 pixels, got 339 x 260"
    ):
        measure_image(frame, reference[:, :-1])
    with pytest.raises(FrameError, match="two dimensions"):
        measure_image(frame[..., None])
    with pytest.raises(InputError, match='method must be "disk" or "threshold"'):
        measure_image(frame, reference, method="hough")
    with pytest.raises(InputError, match='polarity must be "bright", "dark" or "auto"'):
        measure_image(frame, reference, polarity="grey")
    with pytest.raises(InputError, match='registration must be "strips" or "whole", got \'all\''):
        measure_image(frame, reference, registration="all")
    for wrong, said in (("a.tif", "'a.tif'"), (frame + 0j, "complex128"), (np.array([[None]]), "object")):
        with pytest.raises(FrameError, match=f"an array of grey levels, got .*{said}"):
            measure_image(frame, wrong)
    with pytest.raises(InputError, match="blur_px must be a number of px, got 'sharp'"):
        measure_image(frame, reference, blur_px="sharp")
    with pytest.raises(InputError, match="a given blur_px must be a positive number, got 0"):
        measure_image(frame, reference, blur_px=0)
    with pytest.raises(InputError, match="linearity must be a fraction of the contrast"):
        measure_image(frame, reference, linearity=None)
    with pytest.raises(InputError, match=r"0 <= threshold_std < 1, got -0\.1"):
        measure_image(frame, reference, method="threshold", threshold_std=-0.1)
    for wrong in (0, "8 bit", float("nan")):
        with pytest.raises(InputError, match="full_scale must be a grey level above zero"):
            measure_image(frame, reference, full_scale=wrong)
    edit = HandEdit("exclude", 1, 50.0, 60.0)
    for name, wrong, said in (
        ("optics", 1.5, "optics must be of type SharedOptics, got 1.5"),
        ("film", "on", "film must be of type FilmSetting or FilmRim, got 'on'"),
        ("edits", edit, "edits must be of type Sequence, got HandEdit"),
        ("edits", [edit, "exclude"], "edits[1] must be of type HandEdit, got 'exclude'"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            measure_image(frame, reference, **{name: wrong})
    for wrong in (0.0, 1.0, -0.2, "otsu", [0.5], np.full(2, 0.5)):
        with pytest.raises(InputError, match="threshold must be a fraction"):
            measure_image(frame, reference, threshold=wrong)


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_real_pins_are_63_in_a_lattice(method):
    folder = Path(__file__).parents[2] / "sample_data" / "pins"
    frame, reference = (
        cv2.imread(str(folder / f"{name}.png")).mean(axis=2).astype(np.float32)
        for name in ("frame_1", "reference")
    )
    result = measure_image(frame, reference, method=method, polarity="auto")
    assert result.polarity == "dark"
    assert len(result.disks) == 63
    # nine columns of seven: sorted by column, the rows of each are apart by more than half a pitch
    table = result.disks.sort_values("x_px")
    for column in np.array_split(table.y_px.to_numpy(), 9):
        assert np.diff(np.sort(column)).min() > 25


@pytest.mark.slow
def test_accuracy_on_whole_frames():
    """The figures of the documentation, with room for the scatter of two frames."""
    bounds = {(0, 3): 0.0215, (3, 6): 0.0163, (6, 15): 0.0120, (15, 40): 0.0077}
    errors, stds, radii = [], [], []
    for seed in (1, 2):
        optics, rng = Optics(), np.random.default_rng(seed)
        truth = scatter(400, optics, rng)
        result = measure_image(*render(truth, optics, rng))
        pairs = match(truth, result.disks)
        assert 2 * len(pairs) / (len(truth) + len(result.disks)) >= 0.99
        total = (result.disks.radius_px**3).sum() / (truth.radius_px**3).sum()
        assert total == pytest.approx(1.0, abs=0.002)
        alone = truth.kind.to_numpy()[pairs[:, 0]] == 0
        a = truth.radius_px.to_numpy()[pairs[:, 0]][alone]
        radii.append(a)
        errors.append(result.disks.radius_px.to_numpy()[pairs[:, 1]][alone] - a)
        # of the error that a contact and a frame show; what no fit can see comes on top
        variance = result.disks.radius_std_px**2 - result.disks.edge_shift_px**2
        stds.append(np.sqrt(variance.to_numpy())[pairs[:, 1]][alone])
    error, std, radius = map(np.concatenate, (errors, stds, radii))
    for (low, high), bound in bounds.items():
        part = (radius >= low) & (radius < high)
        # 1.3 times the bound at the lower end of the bin, and 3/sqrt(2 n) = 15 % for n = 200
        assert np.sqrt(np.mean(error[part] ** 2)) < 1.15 * 1.3 * bound
        assert abs(error[part].mean()) < (0.02 if low < 3 else 0.01)
    # 68.3 % within one standard deviation, +-3 sqrt(0.22/700) = 5 %, and 4 % that the documentation allows
    # itself
    assert np.mean(np.abs(error) < std) == pytest.approx(0.683, abs=0.09)
    assert np.mean(np.abs(error) < 2 * std) == pytest.approx(0.954, abs=0.04)


@pytest.mark.parametrize("method", ["disk", "threshold"])
@pytest.mark.parametrize("factor", [0.1, 0.5])
def test_a_contrast_that_the_frame_contradicts_is_refused_and_said(usual, measured, method, factor):
    _, frame, reference = usual
    alone = measured[method]
    known = SharedOptics(factor * alone.contrast, 0.01 * alone.contrast)
    result = measure_image(frame, reference, method=method, optics=known)
    assert "which were not used" in result.message
    pd.testing.assert_frame_equal(result.disks, alone.disks)


@pytest.mark.parametrize("contrast", [0.9, 1.0, 1.15])
@pytest.mark.parametrize("blur", [0.7, 1.0, 1.5])
def test_optics_of_other_frames_are_used_only_where_the_frame_agrees(usual, measured, contrast, blur):
    _, frame, reference = usual
    alone = measured["disk"]
    known = SharedOptics(contrast * alone.contrast, 1e-3 * alone.contrast, np.nan, blur * alone.blur_px, 2e-3)
    result = measure_image(frame, reference, optics=known)
    refused = "which were not used" in result.message
    assert refused == ((contrast, blur) != (1.0, 1.0))
    if refused:
        pd.testing.assert_frame_equal(result.disks, alone.disks)
        assert f"{known.blur_px:.3g} given or shown" in result.message


def test_an_exact_blur_is_used_whatever_the_frame_shows(usual, measured):
    _, frame, reference = usual
    blur = 1.3 * measured["disk"].blur_px
    result = measure_image(frame, reference, blur_px=blur)
    assert "not used" not in result.message
    assert result.blur_px == pytest.approx(blur, rel=1e-3)


@pytest.mark.parametrize("factor", [2.0, 10.0])
def test_a_contrast_that_the_frame_does_not_reach_is_doubted(usual, measured, factor):
    _, frame, reference = usual
    contrast = factor * measured["disk"].contrast
    message = measure_image(frame, reference, optics=SharedOptics(contrast, 0.01 * contrast)).message
    doubts = (
        "which were not used", "radii depend on a contrast of", "do not look like disks",
        "no contact for the assumed optics",
    )  # fmt: skip
    assert any(doubt in message for doubt in doubts)


def test_optics_of_other_frames_narrow_the_uncertainty(usual, measured):
    alone = measured["disk"]
    prior = SharedOptics(
        contrast=alone.contrast, contrast_std=1e-4 * alone.contrast, blur_px=alone.blur_px, blur_std_px=1e-4
    )
    helped = measure_image(*usual[1:], optics=prior)
    assert len(helped.disks) == len(alone.disks)
    assert (
        helped.disks["contrast_shift_px"].abs().mean() < 0.5 * alone.disks["contrast_shift_px"].abs().mean()
    )
    assert (helped.disks["radius_std_px"] <= 1.01 * alone.disks["radius_std_px"].to_numpy()).all()


def test_a_contrast_that_the_frame_confirms_is_used(usual, measured):
    _, frame, reference = usual
    alone = measured["disk"]
    result = measure_image(
        frame, reference, optics=SharedOptics(1.02 * alone.contrast, 0.01 * alone.contrast)
    )
    assert "not used" not in result.message
    assert alone.contrast < result.contrast < 1.02 * alone.contrast


def test_a_blur_that_the_frame_contradicts_is_said(usual):
    _, frame, reference = usual
    assert (
        "not described by blurred disks or ellipses behind a blur of 3 px"
        in measure_image(frame, reference, blur_px=3.0).message
    )


@pytest.mark.parametrize(("polarity", "other"), [("dark", "brighter"), ("bright", "darker")])
def test_the_wrong_polarity_is_suspected(usual, polarity, other):
    _, frame, reference = usual
    if polarity == "bright":
        frame, reference = 255 - frame, 255 - reference
    result = measure_image(frame, reference, polarity=polarity)
    assert result.status == "no contact"
    assert f"but something {other}: is the polarity right?" in result.message
