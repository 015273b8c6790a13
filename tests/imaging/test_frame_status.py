"""What a frame says of itself where it is not what the method assumes."""

import cv2
import numpy as np
import pandas as pd
import pytest
from contact_frames import Optics, expose, match, render, scatter
from degraded_frames import degraded_pair

from contactimg.forces import SHARED_SHIFTS
from contactimg.imaging.measure import measure_image
from contactimg.tables import Flag, Reason, Status

OPTICS = Optics(shape=(360, 480), dust=4)


@pytest.fixture(scope="module")
def truth():
    return scatter(60, OPTICS, np.random.default_rng(11), radii=(2, 20), pairs=0.1, touching=0.0)


def sum_error(truth, disks):
    """Error of the sum of the areas, in its stated standard uncertainties."""
    a, slope = disks.radius_px.to_numpy(), 2 * np.pi * disks.radius_px.to_numpy()
    shared = disks[list(SHARED_SHIFTS)].to_numpy()
    own = np.maximum(disks.radius_std_px.to_numpy() ** 2 - (shared**2).sum(axis=1), 0)
    std = np.sqrt(slope**2 @ own + np.sum((slope @ shared) ** 2))
    return (np.pi * (a**2).sum() - np.pi * (truth.radius_px**2).sum()) / std


@pytest.mark.parametrize("name", ["as assumed", "dim reference", "row noise"])
def test_frames_as_assumed_are_ok_and_not_flagged(truth, name):
    result = measure_image(*degraded_pair(name, truth, OPTICS, 5), polarity="bright")
    assert result.status == "ok"
    assert not (result.disks["flags"] & int(Flag.DISAGREES)).any()
    assert len(match(truth, result.disks)) == len(result.disks) == len(truth)
    assert abs(sum_error(truth, result.disks)) < 3


@pytest.mark.parametrize("name", ["soft in proportion", "small ones dim", "dome", "bowl", "coma", "gamma"])
def test_a_sum_is_right_within_its_error_or_said_not_to_be(truth, name):
    result = measure_image(*degraded_pair(name, truth, OPTICS, 5), polarity="bright")
    error = sum_error(truth, result.disks)
    assert abs(error) < 3 or result.status != "ok", (error, result.status)


NOT_OK = {"ghosts": Status.WRONG_REFERENCE, "wrong reference": Status.NOT_REGISTERED}


@pytest.mark.parametrize("name", NOT_OK)
def test_a_reference_of_another_place_is_named(truth, name):
    result = measure_image(*degraded_pair(name, truth, OPTICS, 5), polarity="bright")
    assert result.status == NOT_OK[name]
    assert result.message


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_contacts_that_only_the_reference_shows_are_not_ok(truth, method):
    """Bright contacts in a reference are dust, or dark contacts of an empty frame."""
    frame, reference = degraded_pair("as assumed", truth, OPTICS, 5)
    result = measure_image(reference, frame, method=method, polarity="dark")
    assert result.status != Status.OK
    assert not result.measurable or not len(result.disks)
    assert len(result.rejected) >= 3


@pytest.mark.parametrize("rows", [1, 4])
def test_a_frame_of_a_few_rows_is_not_ok(truth, rows):
    frame, reference = degraded_pair("as assumed", truth, OPTICS, 5)
    row = int(truth.loc[truth.radius_px.idxmax(), "y_px"])
    strip = slice(row, row + rows)
    result = measure_image(frame[strip], reference[strip], method="threshold", polarity="bright")
    assert result.status != "ok"
    assert result.message


@pytest.mark.parametrize("method", ["disk", "threshold"])
def test_one_contact_that_fits_is_ok(method):
    rng, optics = np.random.default_rng(3), Optics(shape=(240, 320))
    truth = scatter(1, optics, rng, radii=(10.0, 14.0), pairs=0.0, touching=0.0)
    assert measure_image(*render(truth, optics, rng), method=method, polarity="bright").status == Status.OK


def test_counted_contacts_that_touch_are_ok():
    rng, optics = np.random.default_rng(17), Optics(shape=(360, 480))
    truth = scatter(60, optics, rng, radii=(5.0, 14.0), pairs=0.5, touching=0.3)
    result = measure_image(*render(truth, optics, rng), method="threshold", polarity="bright")
    assert result.status == Status.OK


def scratched(truth, *, fraction=0.42):
    """A frame with a scratch across it, at a fraction of the contrast."""
    rng = np.random.default_rng(8)
    line = np.zeros((OPTICS.shape[0] * 4, OPTICS.shape[1] * 4), np.float32)
    cv2.line(line, (60, 1100), (1800, 900), 1.0, 5)
    line = cv2.GaussianBlur(line, (0, 0), 5.6)
    line = line.reshape(OPTICS.shape[0], 4, OPTICS.shape[1], 4).mean(axis=(1, 3))
    far = np.abs(truth.y_px - (275 - 0.115 * (truth.x_px - 15))) > truth.radius_px + 10
    kept = truth[far].reset_index(drop=True)
    frame, reference = degraded_pair("as assumed", kept, OPTICS, 5)
    light = frame + 80 * fraction * OPTICS.contrast * line / line.max()
    return kept, expose(light, Optics(camera=(1e6, 0.0)), rng), reference


def test_a_scratch_is_no_chain_of_contacts(truth):
    kept, frame, reference = scratched(truth)
    result = measure_image(frame, reference, polarity="bright")
    pairs = match(kept, result.disks)
    assert len(pairs) == len(kept)
    assert len(result.disks) - len(pairs) <= 3 or result.status != "ok"


def test_a_row_of_small_contacts_is_no_scratch():
    y, x = np.mgrid[40:320:9, 60:420:60]
    rows = pd.DataFrame({"x_px": x.ravel() * 1.0, "y_px": y.ravel() * 1.0, "radius_px": 2.5})
    result = measure_image(*degraded_pair("as assumed", rows, OPTICS, 5), polarity="bright")
    assert len(match(rows, result.disks)) == len(rows)
    assert Reason.SCRATCH not in set(result.rejected.reason)
