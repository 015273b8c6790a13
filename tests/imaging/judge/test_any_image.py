"""Images that nobody made for contacts do no harm; `tests/fuzz/fuzz_images.py` runs hundreds."""

import numpy as np
import pytest
from any_images import (
    METHODS,
    faults,
    look_at,
    made_images,
    more_images,
    odd_images,
    photographs,
    reference_of,
    sized,
    stored_as,
)
from contact_frames import Optics, render, scatter
from contactimg.imaging.fit.settings import FIRST_STEP_RATIO, WORK_PER_FIT
from contactimg.imaging.fit.work import TooMuchWork, Work
from contactimg.imaging.judge import review

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.disks import FitControl, fit_disks
from contactimg.imaging.fit.problem import ContrastPrior, FitProblem
from contactimg.imaging.measure import measure_image
from contactimg.tables import Flag, Status

IMAGES = made_images(96)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", IMAGES)
def test_any_image_is_measured_without_harm(name, method):
    names = sorted(IMAGES)
    other = IMAGES[names[(names.index(name) + 3) % len(names)]]
    number = names.index(name)
    kind, polarity = ("none", "right", "wrong")[number % 3], ("bright", "dark")[number % 2]
    assert not faults(IMAGES[name], reference_of(kind, IMAGES[name], other), method=method, polarity=polarity)


def test_no_contact_of_a_fit_that_was_cut_off_is_spared_for_its_crowd():
    """Coins as a dark float image: among 136 contacts stayed five that no ring shows."""
    coins = sized(photographs()["coins"], 393_000, np.random.default_rng(117))
    assert not look_at(stored_as("float32", coins), None, method="disk", polarity="dark").faults


@pytest.fixture(scope="module")
def crowd():
    """Frame, reference and truth of thirty contacts."""
    rng, optics = np.random.default_rng(13), Optics(shape=(240, 320))
    truth = scatter(30, optics, rng, radii=(6.0, 12.0))
    return *render(truth, optics, rng), truth


def test_a_frame_that_may_not_cost_more_says_so(crowd, monkeypatch):
    assert measure_image(*crowd[:2], polarity="bright").status == Status.OK
    monkeypatch.setattr(Work, "of_frame", classmethod(lambda cls, pixels: cls(1e5)))
    result = measure_image(*crowd[:2], polarity="bright")
    assert result.status == Status.UNRESOLVED
    assert "cut off" in result.message


def test_a_contact_whose_fit_was_cut_off_covers_the_area_of_its_light(crowd, monkeypatch):
    frame, reference, _ = crowd
    fitted = measure_image(frame, reference, polarity="bright").disks
    monkeypatch.setattr(review, "unfinished", lambda found: np.ones(len(found.contacts["x_px"]), np.bool_))
    disks = measure_image(frame, reference, polarity="bright").disks
    assert (disks["flags"].to_numpy() & int(Flag.POOR_FIT) > 0).all()
    assert (disks["radius_px"] == fitted["radius_px"]).all()
    assert (disks["radius_std_px"] > fitted["radius_std_px"]).all()


@pytest.mark.parametrize(("name", "polarity"), [("coins", "dark"), ("astronaut", "bright")])
def test_counted_shades_that_are_as_wide_as_their_rims_are_not_ok(name, polarity):
    """Of 258 and 38 regions on a photograph half do not exceed the scatter around them."""
    image = sized(photographs()[name], 60_000, np.random.default_rng(len(name)))
    result = measure_image(image, method="threshold", polarity=polarity)
    assert len(result.disks) > 20
    assert result.status == Status.SOFT
    assert "either these are no contacts" in result.message


def test_counted_contacts_behind_narrow_rims_are_ok(crowd):
    result = measure_image(*crowd[:2], method="threshold", polarity="bright")
    assert result.status == Status.OK
    assert "no contacts" not in result.message


@pytest.mark.parametrize("method", METHODS)
def test_contacts_that_only_the_reference_shows_are_not_ok(crowd, method):
    """Bright contacts in a reference are dust, or dark contacts of an empty frame."""
    frame, reference, _ = crowd
    result = measure_image(reference, frame, method=method, polarity="dark")
    assert len(result.disks) >= 3
    assert result.status == Status.WRONG_REFERENCE
    assert "are in the reference, not in the frame" in result.message


def test_contacts_without_background_around_them_are_not_ok():
    """The cube of a photograph of a cell as the reference of noise: 3 % of the pixels are left, the cell."""
    noise = made_images(200)["noise"]
    cell = reference_of("wrong", noise, photographs()["cell"])
    frame, reference = ((image / 255.0) ** 3 for image in (noise, cell))
    result = measure_image(frame, reference, method="threshold", polarity="dark")
    assert len(result.disks) > 10
    assert result.status == Status.LITTLE_BACKGROUND


@pytest.mark.parametrize("rows", [1, 4])
def test_a_frame_of_a_few_rows_is_not_ok(crowd, rows):
    frame, reference, truth = crowd
    row = int(truth["y_px"].iloc[0])
    strip = slice(row, row + rows)
    result = measure_image(frame[strip], reference[strip], method="threshold", polarity="bright")
    assert len(result.disks)
    assert result.status == Status.LITTLE_BACKGROUND
    assert f"the frame has {rows} x 320 pixels" in result.message


ODD = odd_images(96)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ODD)
def test_what_a_laboratory_may_save_is_measured_without_harm(name, method):
    number = sorted(ODD).index(name)
    other, kind = ODD[sorted(ODD)[number - 7]], ("none", "right", "wrong")[number % 3]
    for polarity in ("bright", "dark"):
        assert not faults(ODD[name], reference_of(kind, ODD[name], other), method=method, polarity=polarity)


def test_a_rejected_disk_of_a_group_is_no_contact_by_itself():
    """A Bayer mosaic behind a photograph: a group of which only rejected disks were left had no row."""
    mosaic, photograph = odd_images(200)["bayer"], photographs()["color"]
    pair = (stored_as("uint16", part) for part in (mosaic, reference_of("wrong", mosaic, photograph)))
    assert not faults(*pair, method="disk", polarity="bright")


def test_disks_of_which_one_step_would_take_too_long_are_not_fitted(monkeypatch):
    """A fine checkerboard behind a photograph: a thousand disks that overlap as deeply as they are wide."""
    works, usual = [], Work.of_frame.__func__

    def of_frame(cls, pixels):
        works.append(usual(cls, pixels))
        return works[-1]

    monkeypatch.setattr(Work, "of_frame", classmethod(of_frame))
    image = stored_as("binary", more_images(200)["plain checkerboard"])
    result = measure_image(image, reference_of("wrong", image, photographs()["phantom"]), polarity="bright")
    assert works[0].refused
    assert works[0].done < FIRST_STEP_RATIO * works[0].limit + 20 * WORK_PER_FIT
    assert not len(result.disks)
    assert result.status == Status.LIGHT_CHANGED
    assert not result.measurable
    assert "nothing was fitted" in result.message


def test_a_fit_is_not_begun_without_work_for_its_first_step():
    """Two disks of 20 px that coincide but for 1 px: by hand, a lens of 1,400 pixels at eight to 13 nodes."""
    image = np.full((64, 64), 10.0, np.float32)
    disks = np.array([[31.0, 32.0, 20.0, 100.0], [32.0, 32.0, 20.0, 100.0]])
    apart = disks + np.array([[0.0, -60.0, 0.0, 0.0], [0.0, 60.0, 0.0, 0.0]])
    taken = {}
    for name, places in (("apart", apart), ("overlap", disks)):
        work = Work(1e9)
        problem = FitProblem(image, Noise(1.0), ContrastPrior.loose(100.0), work=work)
        fit_disks(problem, places, blur=1.4, control=FitControl(free_blur=False, iterations=1))
        taken[name] = work.done + work.deep - WORK_PER_FIT
    assert taken["overlap"] > 3 * taken["apart"]
    least = Work(0.99 * taken["apart"] / FIRST_STEP_RATIO)
    with pytest.raises(TooMuchWork):
        fit_disks(FitProblem(image, Noise(1.0), ContrastPrior.loose(100.0), work=least), apart, blur=1.4)


def test_no_contrast_that_contacts_show_is_beyond_what_the_frame_spans():
    """Sharp dots as floats of no stated full scale: the fit once took 1.6 times the highest pixel."""
    dots = more_images(200)["plain dots"] / np.float32(255)
    result = measure_image(dots, polarity="bright")
    assert len(result.disks) > 100
    assert abs(result.contrast) <= np.ptp(dots) * (1 + 1e-6)


def test_contacts_too_small_to_show_their_contrast_may_have_one_beyond_the_pixels():
    """Radius 1.0-1.3 px behind a blur of 2 px: half of the true contrast is the most that a pixel shows."""
    rng, optics = np.random.default_rng(31), Optics(shape=(240, 320), sigma=2.0, camera="high")
    truth = scatter(40, optics, rng, radii=(1.0, 1.3), pairs=0.0, touching=0.0)
    frame, reference = (part / np.float32(255) for part in render(truth, optics, rng))
    result = measure_image(frame, reference, polarity="bright")
    true = optics.contrast * optics.level / 255
    assert np.ptp(frame) < 0.8 * true
    assert (result.disks["flags"].to_numpy() & int(Flag.NO_PLATEAU) > 0).all()
    assert abs(result.contrast - true) < 2 * result.optics.contrast_std


def test_a_frame_whose_only_contact_does_not_fit_is_not_ok():
    cell = stored_as("uint16", sized(photographs()["cell"], 60_000, np.random.default_rng(4)))
    result = measure_image(cell, polarity="bright")
    assert len(result.disks) == 1
    assert result.disks["flags"].iloc[0] & int(Flag.POOR_FIT)
    assert result.status == Status.POOR_FIT


def test_one_contact_that_fits_is_ok():
    rng, optics = np.random.default_rng(3), Optics(shape=(240, 320))
    truth = scatter(1, optics, rng, radii=(10.0, 14.0), pairs=0.0, touching=0.0)
    assert measure_image(*render(truth, optics, rng), polarity="bright").status == Status.OK


def test_counted_triangles_are_not_ok():
    """Theory: a triangle encloses 0.83 of the ellipse of its second moments."""
    result = measure_image(odd_images(200)["triangles"], method="threshold", polarity="bright")
    assert len(result.disks) > 30
    assert result.status == Status.POOR_FIT
    assert "depart from ellipses" in result.message


def test_counted_squares_that_are_cut_into_disks_are_not_ok():
    board = stored_as("uint16", sized(photographs()["chessboard_GRAY"], 60_000, np.random.default_rng(15)))
    result = measure_image(board, method="threshold", polarity="dark")
    assert len(result.disks) > 30
    assert result.status != Status.OK
    assert "depart from ellipses" in result.message


def test_counted_contacts_that_touch_are_ok():
    rng, optics = np.random.default_rng(17), Optics(shape=(360, 480))
    truth = scatter(60, optics, rng, radii=(5.0, 14.0), pairs=0.5, touching=0.3)
    assert (
        measure_image(*render(truth, optics, rng), method="threshold", polarity="bright").status == Status.OK
    )


def test_one_contact_around_which_nothing_is_seen_is_not_ok():
    """A binary chessboard, over which one circle was laid whose rim leaves the image."""
    board = sized(photographs()["chessboard_GRAY"], 60_000, np.random.default_rng(15))
    result = measure_image(stored_as("binary", board), polarity="bright")
    assert len(result.disks) == 1
    assert result.status == Status.LITTLE_BACKGROUND
