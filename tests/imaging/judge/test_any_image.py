"""Images that nobody made for contacts do no harm; `tests/fuzz/fuzz_images.py` runs hundreds."""

import numpy as np
import pytest
from any_images import METHODS, faults, look_at, made_images, photographs, reference_of, sized, stored_as
from contact_frames import Optics, render, scatter

from contactimg.imaging.fit.work import Work
from contactimg.imaging.judge import review
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
