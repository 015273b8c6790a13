"""Corrections by hand: what each does to the contacts, and that nothing else changes."""

import logging
from shutil import copytree

import numpy as np
import pandas as pd
import pytest
from contact_frames import Optics, render

from contactimg import Flag, Frame, InputError, measure_series, scene_from_dict
from contactimg.cli import main
from contactimg.files import write_frame, write_table
from contactimg.tables import EDITS, Reason

ALONE, LARGE, SMALL = (80.3, 70.6, 9.0), (180.2, 80.4, 9.5), (195.1, 83.0, 7.5)  # the last two overlap
OTHERS = [(60.0, 180.0, 7.0), (150.0, 190.0, 11.0), (230.0, 170.0, 8.0), (240.0, 50.0, 6.0)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("edits"), np.random.default_rng(16)
    truth = pd.DataFrame([ALONE, LARGE, SMALL, *OTHERS], columns=["x_px", "y_px", "radius_px"])
    frame, reference = render(truth, Optics(shape=(240, 300), dust=0), rng)
    write_frame(Frame(frame), folder / "frame_1.tif")
    write_frame(Frame(reference), folder / "reference.tif")
    return folder


def measure(folder, *rows, method="disk"):
    """The run with these edits: dicts without the frame."""
    images = {"reference": "reference.tif"}
    if rows:
        write_table(pd.DataFrame([{"frame": "*"} | row for row in rows]), EDITS, folder / "e.csv")
        images["edits"] = "e.csv"
    sections = {"camera": {"pixel_size_m": 1e-6}, "images": images, "measure": {"method": method}}
    return measure_series(scene_from_dict(sections, folder=str(folder)))


def at(action, place, **more):
    return {"action": action, "x_px": place[0] + 1.0, "y_px": place[1] - 1.0} | more


def nearest(run, place):
    contacts = run.contacts
    distance = np.hypot(contacts["x_px"] - place[0], contacts["y_px"] - place[1])
    return contacts.loc[distance.idxmin()] if distance.min() < 5 else None


METHODS = pytest.mark.parametrize("method", ["disk", "threshold"])
PIXELS = ["x_px", "y_px", "radius_px", "flags"]


@METHODS
def test_an_excluded_contact_is_rejected_and_the_others_stay_as_they_are(folder, method):
    before, after = measure(folder, method=method), measure(folder, at("exclude", ALONE), method=method)
    kept = before.contacts[np.abs(before.contacts["x_px"] - ALONE[0]) > 5]
    pd.testing.assert_frame_equal(
        after.contacts[PIXELS].reset_index(drop=True), kept[PIXELS].reset_index(drop=True)
    )
    (row,) = after.rejected[after.rejected["reason"] == Reason.BY_HAND].to_dict("records")
    assert abs(row["x_px"] - ALONE[0]) < 0.3
    assert after.frames["area_m2"].iloc[0] < before.frames["area_m2"].iloc[0]


@METHODS
def test_an_added_contact_is_measured_from_the_pixels(folder, method):
    automatic = nearest(measure(folder, method=method), OTHERS[0])
    drawn = {"action": "add", "x_px": OTHERS[0][0] + 2, "y_px": OTHERS[0][1] - 1, "radius_px": 5.0}
    found = nearest(measure(folder, at("exclude", OTHERS[0]), drawn, method=method), OTHERS[0])
    assert int(found["flags"]) & Flag.MANUAL
    assert found["radius_px"] == pytest.approx(automatic["radius_px"], abs=0.05)
    assert found["radius_std_px"] == pytest.approx(automatic["radius_std_px"], rel=0.2)


def test_a_contact_added_where_no_pixel_is_above_the_threshold_is_named(folder):
    run = measure(folder, at("add", (120.0, 130.0), radius_px=3.0), method="threshold")
    assert nearest(run, (120.0, 130.0)) is None
    assert "row 1 (add at (121, 129))" in run.frames["message"].iloc[0]


def test_a_contact_drawn_by_hand_meets_the_truth(folder):
    automatic = nearest(measure(folder), ALONE)
    merged = {"action": "merge", "points": f"{ALONE[0]} {ALONE[1]};{OTHERS[3][0]} {OTHERS[3][1]}"}
    apart = at("split", (160.0, 60.0), points=f"{ALONE[0] + 3} {ALONE[1] - 2};{OTHERS[3][0]} {OTHERS[3][1]}")
    centre = np.average([ALONE[:2], OTHERS[3][:2]], axis=0, weights=[ALONE[2] ** 2, OTHERS[3][2] ** 2])
    apart |= {"x_px": centre[0], "y_px": centre[1]}
    drawn = nearest(measure(folder, merged, apart), ALONE)
    assert int(drawn["flags"]) & Flag.MANUAL
    assert drawn["radius_px"] == pytest.approx(automatic["radius_px"], abs=0.02)
    assert abs(drawn["radius_px"] - ALONE[2]) < 4 * drawn["radius_std_px"]


@METHODS
def test_split_and_merge_are_inverse(folder, method):
    automatic = measure(folder, method=method)
    merge = {"action": "merge", "points": f"{LARGE[0]} {LARGE[1]};{SMALL[0]} {SMALL[1]}"}
    one = measure(folder, merge, method=method)
    assert len(one.contacts) == len(automatic.contacts) - 1
    (whole,) = one.contacts[one.contacts["flags"] >= int(Flag.MANUAL)].to_dict("records")
    split = {"action": "split", "x_px": whole["x_px"], "y_px": whole["y_px"]}
    two = measure(folder, merge, split, method=method)
    for place in (LARGE, SMALL):
        found = nearest(two, place)
        assert int(found["flags"]) & Flag.MANUAL
        tolerance = 0.05 if method == "disk" else 0.6  # pixels are shared along a line elsewhere
        assert found["radius_px"] == pytest.approx(nearest(automatic, place)["radius_px"], abs=tolerance)


@METHODS
def test_a_masked_disk_hides_its_contact(folder, method):
    run = measure(folder, at("mask", ALONE, radius_px=16.0), method=method)
    assert nearest(run, ALONE) is None
    assert len(run.contacts) == len(OTHERS) + 2
    assert run.frames["status"].iloc[0] == "holes"


@METHODS
def test_an_edit_without_a_contact_is_named(folder, method, caplog):
    run = measure(folder, at("exclude", (120.0, 130.0)), method=method)
    assert "row 1 (exclude at (121, 129))" in run.frames["message"].iloc[0]
    assert "frame_1.tif: these edits match no contact: row 1 (exclude at (121, 129))" in caplog.text
    pd.testing.assert_frame_equal(run.contacts, measure(folder, method=method).contacts)


def test_an_edit_of_all_frames_need_not_match_in_each(folder, tmp_path, caplog):
    copytree(folder, tmp_path, dirs_exist_ok=True)
    truth = pd.DataFrame(OTHERS, columns=["x_px", "y_px", "radius_px"])
    frame, _ = render(truth, Optics(shape=(240, 300), dust=0), np.random.default_rng(17))
    write_frame(Frame(frame), tmp_path / "frame_2.tif")
    run = measure(tmp_path, at("exclude", ALONE), at("exclude", (120.0, 130.0)))
    assert ["row 1" in text for text in run.frames["message"]] == [False, True]
    (said,) = (text for text in caplog.messages if "match no contact" in text)
    assert said.startswith("frame_1.tif, frame_2.tif: these edits match no contact: row 2 (exclude")


def test_an_edit_of_a_frame_that_is_not_there_is_a_warning(folder, caplog):
    with caplog.at_level(logging.WARNING):
        measure(folder, at("exclude", ALONE, frame="frame_9.tif"))
    assert "row 1 (exclude) is for the frame frame_9.tif, which is not there" in caplog.text


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        ({"action": "delete", "x_px": 1.0, "y_px": 1.0}, "row 1 (delete) has an unknown action"),
        ({"action": "exclude", "x_px": 1.0}, "row 1 (exclude) needs x_px and y_px"),
        ({"action": "add", "x_px": 1.0, "y_px": 1.0}, "row 1 (add) needs a positive radius_px, got nan"),
        ({"action": "merge", "points": "1 2"}, "row 1 (merge) needs at least 2 points, got 1"),
        ({"action": "mask", "points": "1 2;3"}, "row 1 (mask) must have points of the form 'x y;x y'"),
    ],
)
def test_a_row_that_says_too_little_gets_one_sentence(folder, row, sentence):
    with pytest.raises(InputError) as caught:
        measure(folder, row)
    assert sentence in str(caught.value)


def test_the_command_applies_edits_of_the_folder_and_counts_them(folder, tmp_path):
    edits = EDITS.conform(pd.DataFrame([{"frame": "frame_1.tif"} | at("exclude", ALONE)]))
    write_table(edits, EDITS, folder / "edits.csv")
    command = ["process", str(folder), "--pixel-size-um", "1", "--no-pictures", "--quiet", "--workers", "1"]
    try:
        assert main([*command, "-o", str(tmp_path / "a")]) == 0
        assert main([*command, "-o", str(tmp_path / "b")]) == 0
    finally:
        (folder / "edits.csv").unlink()
    for name in ("contacts.csv", "frames.csv", "rejected.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert '"exclude": 1' in (tmp_path / "a" / "provenance.json").read_text()
    assert "excluded by hand" in (tmp_path / "a" / "rejected.csv").read_text()
