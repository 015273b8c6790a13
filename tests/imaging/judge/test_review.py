"""What a frame says of itself where it is not what the method assumes."""

import cv2
import numpy as np
import pandas as pd
import pytest
from contact_frames import Optics, expose, match, scatter
from contactimg.imaging.judge import review as review_module
from contactimg.imaging.judge.agreement import Agreement
from contactimg.imaging.judge.review import _with_disagreement
from contactimg.imaging.reject.detections import PLACE, Detections
from degraded_frames import degraded_pair

from contactimg.forces import SHARED_SHIFTS
from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.optics import SharedOptics
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
    # sixty contacts exclude most other edges
    assert (result.disks["edge_shift_px"] < 0.7 * result.disks["radius_std_px"]).all()
    assert len(match(truth, result.disks)) == len(result.disks) == len(truth)


NOT_OK = {
    "soft in proportion": {Status.POOR_FIT, Status.DISAGREES},
    "small ones dim": {Status.POOR_FIT, Status.DISAGREES},
    "dome": {Status.POOR_FIT, Status.DISAGREES},
    "bowl": {Status.POOR_FIT, Status.DISAGREES},
    "interlaced": {Status.INTERLACED},
    "ghosts": {Status.WRONG_REFERENCE},
    "wrong reference": {Status.NOT_REGISTERED},
}


@pytest.mark.parametrize("name", NOT_OK)
def test_a_wrong_sum_is_not_ok(truth, name):
    result = measure_image(*degraded_pair(name, truth, OPTICS, 5), polarity="bright")
    assert result.status in NOT_OK[name] or abs(sum_error(truth, result.disks)) < 3
    assert result.message


def test_uncertainties_cover_a_difference_that_all_contacts_share(truth):
    result = measure_image(*degraded_pair("dome", truth, OPTICS, 5), polarity="bright")
    if result.disks["edge_shift_px"].any():
        assert (result.disks["radius_std_px"] >= result.disks["edge_shift_px"]).all()
        assert abs(sum_error(truth, result.disks)) < 4


def test_what_all_contacts_share_is_no_error_of_each():
    """Areas of JPEG frames differ from the fit alike in all contacts; that had counted twice."""
    n = 6
    contacts = {name: np.zeros(n) for name in ("edge_shift_px", *PLACE)}
    contacts |= {"radius_std_px": np.full(n, 0.03), "flags": np.zeros(n, np.int64)}
    shared = np.full(n, -0.4)
    agreement = Agreement(shared + np.array([0.1, 0, 0, 0, 0, 0]), np.ones(n, bool), shared)
    after = _with_disagreement(Detections(contacts, {}, SharedOptics(), SharedOptics(), 1.0), agreement)
    own = np.sqrt(after.contacts["radius_std_px"] ** 2 - after.contacts["edge_shift_px"] ** 2)
    assert own == pytest.approx([np.hypot(0.1, 0.03)] + [0.03] * 5)
    assert after.contacts["edge_shift_px"] == pytest.approx(0.4)


def scratched(truth, *, fraction=0.42):
    """A frame with a scratch across it, at a fraction of the contrast."""
    rng = np.random.default_rng(8)
    line = np.zeros((OPTICS.shape[0] * 4, OPTICS.shape[1] * 4), np.float32)
    cv2.line(line, (60, 1100), (1800, 900), 1.0, 5)
    line = (
        cv2.GaussianBlur(line, (0, 0), 5.6).reshape(OPTICS.shape[0], 4, OPTICS.shape[1], 4).mean(axis=(1, 3))
    )
    far = np.abs(truth.y_px - (275 - 0.115 * (truth.x_px - 15))) > truth.radius_px + 10
    kept = truth[far].reset_index(drop=True)
    frame, reference = degraded_pair("as assumed", kept, OPTICS, 5)
    light = frame + 80 * fraction * OPTICS.contrast * line / line.max()
    return kept, expose(light, Optics(camera=(1e6, 0.0)), rng), reference


def test_a_scratch_is_no_chain_of_contacts(truth):
    kept, frame, reference = scratched(truth)
    result = measure_image(frame, reference, polarity="bright")
    wrong = len(result.disks) - len(match(kept, result.disks))
    assert wrong <= 3 or result.status != "ok"
    assert {Reason.SCRATCH, Reason.LONG, Reason.INVISIBLE} & set(result.rejected.reason) or not wrong


def test_a_row_of_small_contacts_is_no_scratch():
    y, x = np.mgrid[40:320:9, 60:420:60]
    rows = pd.DataFrame({"x_px": x.ravel() * 1.0, "y_px": y.ravel() * 1.0, "radius_px": 2.5})
    result = measure_image(*degraded_pair("as assumed", rows, OPTICS, 5), polarity="bright")
    assert len(match(rows, result.disks)) == len(rows)
    assert Reason.SCRATCH not in set(result.rejected.reason)


def test_what_a_look_left_as_it_was_need_not_be_looked_at_again(truth, monkeypatch):
    pair = degraded_pair("as assumed", truth, OPTICS, 5)
    looks, looked = [], review_module._is_outshone

    def count(*arguments):
        looks.append(arguments)
        return looked(*arguments)

    monkeypatch.setattr(review_module, "_is_outshone", count)
    once = measure_image(*pair, polarity="bright")
    assert len(looks) == 1
    look_at_fit = review_module._look_at_fit

    def look_at_all(*arguments, looked_at, **options):
        assert looked_at is not None
        return look_at_fit(*arguments, looked_at=None, **options)

    monkeypatch.setattr(review_module, "_look_at_fit", look_at_all)
    pd.testing.assert_frame_equal(measure_image(*pair, polarity="bright").disks, once.disks)
    assert len(looks) == 3
