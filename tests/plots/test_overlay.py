"""Pictures of frames with contacts drawn on them."""

import cv2
import numpy as np
import pandas as pd
import pytest

from contactimg.files import write_palette_image
from contactimg.pipeline import pictures
from contactimg.pipeline.frame import FrameTables
from contactimg.pipeline.overlay import compare_frame
from contactimg.pipeline.pictures import INSET_ZOOM, MARKS, PREDICTED, draw_measured, draw_predicted
from contactimg.plots.overlay import GREYS, Layer, View, draw_overlay, grey_indices
from contactimg.tables import CONTACTS, OUTLINES, REJECTED, Flag
from contactimg.tables.outlines import (
    CONTACT_COLOUR,
    FLAGGED_COLOUR,
    MANUAL_COLOUR,
    REJECTED_COLOUR,
    Outline,
    contact_outlines,
)

VIEW = View((0.0, 100.0), title="frame_1.tif, 5 mN", pixel_size=6e-6)
RADIUS = 20.0


@pytest.fixture
def frame():
    """Disks of level 100 on 20, 400 x 300 px."""
    image = np.full((300, 400), 20.0)
    y, x = np.mgrid[:300, :400]
    for centre in (100.0, 200.0, 300.0):
        image[np.hypot(x - centre, y - 150.0) < RADIUS] = 100.0
    return image


def contacts(flags):
    table = pd.DataFrame({"label": range(1, len(flags) + 1), "x_px": 100.0 * np.arange(1, len(flags) + 1)})
    return CONTACTS.conform(table.assign(y_px=150.0, radius_px=RADIUS, frame="a", flags=flags))


def shown(flags, rejected=()):
    table = pd.DataFrame(rejected, columns=["x_px", "y_px", "radius_px"]).assign(frame="a", reason="dust: 1")
    return FrameTables(contacts(flags), REJECTED.conform(table), OUTLINES.empty())


def share_of(picture, colour):
    rgb = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return np.mean(np.all(picture.palette[picture.indices] == rgb, axis=2))


def test_contacts_have_the_colour_of_their_flags(frame):
    plain = draw_measured(frame, shown([0, 0, 0]), VIEW)
    flagged = draw_measured(frame, shown([0, int(Flag.POOR_FIT), int(Flag.MANUAL | Flag.POOR_FIT)]), VIEW)
    assert share_of(plain, FLAGGED_COLOUR) == share_of(plain, MANUAL_COLOUR) == 0
    assert share_of(flagged, FLAGGED_COLOUR) > 0
    assert share_of(flagged, MANUAL_COLOUR) > share_of(flagged, FLAGGED_COLOUR)  # the flagged one is dashed
    assert share_of(flagged, CONTACT_COLOUR) < share_of(plain, CONTACT_COLOUR)


@pytest.mark.parametrize("name", ["x_px", "radius_px"])
@pytest.mark.parametrize("dashes", [(), (4.0, 2.0)])
@pytest.mark.parametrize("value", [1e12, np.nan])
def test_contacts_that_no_picture_can_show_are_left_out(frame, name, dashes, value):
    sound = {"label": 1, "x": 100.0, "y": 150.0, "semi_major": RADIUS, "semi_minor": RADIUS}
    keys = ["x"] if name == "x_px" else ["semi_major", "semi_minor"]
    wrong = Outline(**sound | dict.fromkeys(keys, value))
    layer = Layer([Outline(**sound), wrong], "#112233", "contacts", dashes)
    alone = Layer([Outline(**sound)], "#112233", "contacts", dashes)
    pictures = [draw_overlay(frame, [one], VIEW) for one in (layer, alone)]
    assert share_of(pictures[0], "#112233") == share_of(pictures[1], "#112233") > 0


def test_rejected_candidates_are_squares(frame):
    assert share_of(draw_measured(frame, shown([0]), VIEW), REJECTED_COLOUR) == 0
    assert share_of(draw_measured(frame, shown([0], [(50.0, 50.0, 4.0)]), VIEW), REJECTED_COLOUR) > 0


def test_the_ring_leaves_the_rim_free(frame):
    picture = draw_measured(frame, shown([0, 0, 0]), VIEW)
    zoom = picture.indices.shape[1] // frame.shape[1]
    y, x = (np.mgrid[: 300 * zoom, : 400 * zoom] + 0.5) / zoom - 0.5
    distance = np.min([np.hypot(x - centre, y - 150.0) for centre in (100.0, 200.0, 300.0)], axis=0)
    drawn = picture.indices[: 300 * zoom] >= GREYS
    assert distance[drawn].min() > RADIUS + 1.4  # a blur width beyond the rim
    assert distance[drawn].max() < RADIUS + 4.0
    ring = (distance > RADIUS + 2.1) & (distance < RADIUS + 2.3)
    assert drawn[ring].mean() > 0.9


def test_all_frames_of_a_series_have_one_stretch(frame):
    dim = draw_overlay(0.5 * frame, [], VIEW)
    bright = draw_overlay(frame, [], VIEW)
    assert int(dim.indices[0, 0]) == pytest.approx(int(bright.indices[0, 0]) / 2, abs=1)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_levels_beyond_the_stretch_and_pixels_without_value(dtype):
    image = np.array([[0, 50, 100, 200]]).astype(dtype)
    np.testing.assert_array_equal(grey_indices(image, (0.0, 100.0)), [[0, GREYS // 2, GREYS - 1, GREYS - 1]])
    assert grey_indices(np.array([[np.nan, np.inf]]), (0.0, 100.0)).tolist() == [[0, GREYS - 1]]


def test_shapes_are_drawn_along_their_rims(frame):
    turn = np.linspace(0, 2 * np.pi, 90)
    around = np.column_stack([np.cos(turn), np.sin(turn)])
    ring = (200 + 40 * around @ np.eye(2) + [0, -50], 200 + 15 * around[::-1] + [0, -50])
    free = Outline(1, 200.0, 150.0, 40.0, 40.0, lines=ring)
    for outline in (free, Outline(1, 200.0, 150.0, 40.0, 20.0, 0.5)):
        for gap in (0.0, 2.0):
            picture = draw_overlay(frame, [Layer([outline], CONTACT_COLOUR, "contact", gap_px=gap)], VIEW)
            assert share_of(picture, CONTACT_COLOUR) > 1e-3


def test_a_picture_is_a_png_of_the_same_pixels(frame, tmp_path):
    picture = draw_measured(frame, shown([0, int(Flag.MANUAL)]), VIEW)
    write_palette_image(picture.indices, picture.palette, tmp_path / "a.png")
    np.testing.assert_array_equal(
        cv2.imread(str(tmp_path / "a.png"))[:, :, ::-1], picture.palette[picture.indices]
    )


def test_marks_tell_matched_missed_and_false_contacts_and_count_as_the_scores_do(frame):
    measured = contacts([0, 0, 0]).assign(x_m=[1e-3, 2e-3, 3e-3], y_m=1e-3, radius_m=2e-5, asperity=[0, 1, 2])
    predicted = measured.assign(x_m=[1e-3, 2e-3, 4e-3], asperity=[0, 1, 3], radius_m=[2e-5, 1e-6, 2e-5])
    stated = {"pixel_size": 6e-6, "min_radius_px": 1.0}
    _, kinds, score = compare_frame(measured, predicted, **stated)
    marks = {kind: contact_outlines(table) for kind, table in kinds.items()}
    labels = {kind: [one.label for one in outlines] for kind, outlines in marks.items()}
    # the second is predicted too small to be seen: it counts neither for nor against
    assert labels == dict(zip(labels, ([1], [3], [3], [1, 2, 3]), strict=True))
    counts = [len(marks[kind]) for kind in MARKS]
    assert [score["n_matched"], score["n_measured"], score["n_predicted"]] == [
        1,
        sum(counts[:2]),
        counts[0] + counts[2],
    ]
    picture = draw_predicted(frame, {"coupled": marks, "uncoupled": marks}, view=VIEW)
    shares = [share_of(picture, colour) for colour, *_ in MARKS.values()]
    assert min(shares) > 0
    assert picture.indices[150, 100] < 0.6 * GREYS  # dimmed: lines on the rim stand out


def test_the_inset_shows_where_most_contacts_are_missed(frame, monkeypatch):
    views = []

    def drawn(image, layers, view):
        views.append((image.shape, view))
        return draw_overlay(image, layers, view)

    monkeypatch.setattr(pictures.overlay, "draw_overlay", drawn)
    one, *others = contact_outlines(contacts([0, 0, 0]))
    kinds = dict.fromkeys([*MARKS, PREDICTED], ()) | {"matched": others, "measured, not predicted": [one]}
    draw_predicted(frame, {"coupled": kinds}, view=VIEW)
    (rows, columns), view = views[1]
    assert view.left <= one.x <= view.left + columns
    assert view.top <= one.y <= view.top + rows
    assert view.zoom == INSET_ZOOM * views[0][1].zoom


def test_predicted_ellipses_are_drawn_as_ellipses():
    table = contacts([0, 0]).assign(shape=["disk", "ellipse"], x_m=[0, 1e-3], y_m=0.0, asperity=[0, 1])
    table = table.assign(radius_m=1e-4, semi_major_px=30.0, semi_minor_px=10.0, angle_rad=0.3)
    _, kinds, _ = compare_frame(table[:0], table, pixel_size=6e-6, min_radius_px=1.0)
    false = contact_outlines(kinds["predicted, not measured"])
    axes = [(one.semi_major, one.semi_minor, one.angle) for one in false]
    assert axes == [(RADIUS, RADIUS, 0.0), (30.0, 10.0, 0.3)]
