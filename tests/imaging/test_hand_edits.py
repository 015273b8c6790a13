"""Corrections by hand: exclude, add, split, merge, by both methods."""

import numpy as np
import pandas as pd
import pytest
from camera_worlds import make_scene
from contact_frames import Optics, match, render
from shape_frames import ellipse, frame, triangle

from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.tables import Flag, Reason, Status

METHODS = pytest.mark.parametrize("method", ["disk", "threshold"])
OPTICS = Optics(shape=(160, 220), dust=0)
TRUTH = pd.DataFrame(
    [(40, 40, 9.0), (110, 40, 7.0), (122.5, 40, 6.0), (180, 45, 11.0), (50, 110, 8.0), (150, 110, 10.0)],
    columns=["x_px", "y_px", "radius_px"],
)


@pytest.fixture(scope="module")
def pair():
    return render(TRUTH, OPTICS, np.random.default_rng(9))


def edited(pair, method, *edits):
    return measure_image(*pair, method=method, edits=edits)


def at(disks, x, y):
    """The contact nearest to a place."""
    return disks.iloc[int(np.argmin(np.hypot(disks["x_px"] - x, disks["y_px"] - y)))]


@METHODS
def test_an_excluded_contact_is_rejected_by_hand_and_the_others_stay(pair, method):
    alone = edited(pair, method)
    result = edited(pair, method, HandEdit("exclude", 1, 40.0, 41.0))
    assert len(result.disks) == len(alone.disks) - 1
    assert np.hypot(result.disks["x_px"] - 40, result.disks["y_px"] - 40).min() > 20
    assert (result.rejected["reason"] == Reason.BY_HAND).sum() == 1
    others = np.hypot(alone.disks["x_px"] - 40, alone.disks["y_px"] - 40) > 20
    np.testing.assert_allclose(
        result.disks["radius_px"], alone.disks.loc[others, "radius_px"].to_numpy(), atol=0.02
    )


@METHODS
def test_what_is_excluded_is_no_background(method):
    """The light of a large spot that is no contact, as a hand has said, spoils nothing of the frame."""
    scene = make_scene("plain", 25, 3)
    alone = measure_image(scene.frame, scene.reference, method=method)
    x, y, radius = alone.disks.nlargest(1, "radius_px")[["x_px", "y_px", "radius_px"]].to_numpy()[0]
    assert radius > 15.0
    edit = HandEdit("exclude", 1, float(x), float(y))
    found = measure_image(scene.frame, scene.reference, method=method, edits=[edit])
    assert (alone.status, found.status) == (Status.OK, Status.OK)
    assert len(found.disks) == len(alone.disks) - 1
    assert "background" not in found.message
    assert "belong to no contact" not in found.message


@pytest.mark.parametrize(
    "how", [{"method": "threshold"}, *({"shape": x} for x in ("auto", "ellipse", "free"))]
)
def test_a_contact_drawn_where_no_pixel_is_seen_is_named(pair, how):
    frame = pair[0].astype(np.float32)
    frame[100:, :40] = np.nan
    edits = [HandEdit("add", 7, 15.0, 125.0, 6.0), HandEdit("add", 8, -30.0, 50.0, 6.0)]
    found, alone = (measure_image(frame, pair[1], edits=each, **how) for each in (edits, []))
    said = "these edits match no contact: row 7 (add at (15, 125)), row 8 (add at (-30, 50))"
    assert found.message == f"{alone.message}; {said}"
    assert len(found.disks) == len(alone.disks)


@pytest.mark.parametrize("radius", [14.0, 18.0, 26.0])
def test_a_contact_of_several_disks_is_excluded_as_a_whole(radius, rng):
    """The disks that cover a triangle are one contact, and no part of it stays behind."""
    places = [(40, 40, 9.0), (110, 38, 7.0), (45, 110, 8.0), (165, 100, radius)]
    shapes = [ellipse(1.0)] * 3 + [triangle()]
    image, reference, areas = frame(shapes, places, angles=[0.0, 0.0, 0.0, 0.4], rng=rng, shape=(160, 230))
    alone = measure_image(image, reference)
    odd = at(alone.disks, 165, 100)
    assert len(alone.disks) == 4
    assert odd["area_px2"] == pytest.approx(areas[3], rel=0.15)
    edit = HandEdit("exclude", 1, float(odd["x_px"]), float(odd["y_px"]))
    found = measure_image(image, reference, edits=[edit])
    assert len(found.disks) == 3
    excluded = found.rejected[found.rejected["reason"] == Reason.BY_HAND]
    assert excluded["radius_px"].tolist() == pytest.approx([odd["radius_px"]], abs=0.1)


@METHODS
def test_a_contact_drawn_again_is_measured_and_marked(pair, method):
    edits = HandEdit("exclude", 1, 180.0, 45.0), HandEdit("add", 2, 181.0, 44.0, 9.0)
    result = edited(pair, method, *edits)
    assert len(result.disks) == len(edited(pair, method).disks)
    again = at(result.disks, 180, 45)
    assert int(again["flags"]) & int(Flag.MANUAL)
    if method == "disk":
        assert again["radius_px"] == pytest.approx(11.0, abs=4 * again["radius_std_px"])


@METHODS
def test_a_contact_can_be_split_and_two_merged(pair, method):
    count = len(edited(pair, method).disks)
    assert count == len(TRUTH)
    merge = HandEdit("merge", 1, points=((110.0, 40.0), (122.5, 40.0)))
    merged = edited(pair, method, merge)
    assert len(merged.disks) == count - 1
    split = edited(pair, method, merge, HandEdit("split", 2, 116.0, 40.0))
    assert len(split.disks) == count
    for x, radius in ((110.0, 7.0), (122.5, 6.0)):
        part = at(split.disks, x, 40)
        assert int(part["flags"]) & int(Flag.MANUAL)
        assert part["radius_px"] == pytest.approx(radius, abs=0.3)
    one = at(merged.disks, 116, 40)
    assert int(one["flags"]) & int(Flag.MANUAL)
    assert one["area_px2"] == pytest.approx(np.pi * (7.0**2 + 6.0**2), rel=0.3)


@METHODS
def test_edits_that_meet_nothing_are_named(pair, method):
    result = edited(pair, method, HandEdit("exclude", 7, 200.0, 140.0))
    assert "these edits match no contact: row 7 (exclude at (200, 140))" in result.message
    assert len(match(TRUTH, result.disks)) == len(TRUTH)


def test_a_contact_drawn_where_nothing_is_counted_is_named():
    blank = np.random.default_rng(3).normal(100, 2, (60, 80)).clip(0, 255).astype(np.uint8)
    result = measure_image(
        blank,
        np.full_like(blank, 100),
        method="threshold",
        optics=SharedOptics(60.0, 2.0),
        edits=[HandEdit("add", 1, 30.0, 30.0, 5.0)],
    )
    assert len(result.disks) == 0
    assert "these edits match no contact: row 1 (add at (30, 30))" in result.message


def test_a_split_that_the_pixels_do_not_show_changes_nothing(pair):
    """Parts of one round contact would move into each other, and its force would count twice."""
    alone = edited(pair, "disk")
    for x, y in TRUTH.loc[[0, 3, 5], ["x_px", "y_px"]].to_numpy(float):
        result = edited(pair, "disk", HandEdit("split", 3, x, y))
        assert f"these edits match no contact: row 3 (split at ({x:g}, {y:g}))" in result.message
        pd.testing.assert_frame_equal(result.disks, alone.disks)
