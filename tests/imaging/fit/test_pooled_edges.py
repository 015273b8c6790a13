"""Edges that frames with many contacts show, pooled and lent to frames with few."""

import numpy as np
import pytest
from edge_frames import edge_frame
from frame_sums import total_area

from contactimg.imaging.fit.pooling import pool_edges
from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.edge_shape import PARAMETERS, RESPONSE
from contactimg.imaging.profile.optics import EdgeKnowledge, SharedOptics

WINDOW = (slice(0, 170), slice(0, 230))  # a sixteenth of the frame, too few contacts to learn an edge from


def knowledge(families, best, count, tight=1e4):
    """Of an edge with some response."""
    shape = np.zeros(len(PARAMETERS))
    shape[RESPONSE] = best
    information = tight * np.eye(len(PARAMETERS))
    return EdgeKnowledge(families, 1.4, shape, information, information @ shape, count)


def test_edges_are_pooled_over_the_frames_that_agree_on_them():
    frames = [knowledge(("response",), 0.5, 40), knowledge(("response",), 0.52, 60), knowledge((), 0.0, 30)]
    pooled = pool_edges(frames)
    assert pooled.families == ("response",)
    assert pooled.shape[RESPONSE] == pytest.approx(0.51)
    # two that differ by 0.02 at 0.01 each: chi-square 2 with one degree of freedom
    assert pooled.information[RESPONSE, RESPONSE] == pytest.approx(2e4 / 2)
    assert pool_edges([knowledge((), 0.0, 2)]) is None


@pytest.fixture(scope="module")
def gamma():
    """A frame of a camera of gamma 0.45, and a part of it with few contacts."""
    frame, reference, truth = edge_frame("gamma", seed=21)
    rows, columns = WINDOW
    inside = truth["x_px"].lt(columns.stop) & truth["y_px"].lt(rows.stop)
    cut = (truth["x_px"] + truth["radius_px"]).gt(columns.stop - 8) & truth["x_px"].lt(columns.stop + 40)
    cut |= (truth["y_px"] + truth["radius_px"]).gt(rows.stop - 8) & truth["y_px"].lt(rows.stop + 40)
    return measure_image(frame, reference), frame[WINDOW], reference[WINDOW], truth[inside & ~cut]


def error_of_area(result, truth):
    """Error of the summed area of the contacts of the truth, relative to it, and its stated uncertainty."""
    place = truth[["x_px", "y_px"]].to_numpy()[:, None] - result.disks[["x_px", "y_px"]].to_numpy()
    found = result.disks.iloc[np.argmin(np.hypot(*place.transpose(2, 0, 1)), axis=1)]
    as_metres = {"radius_m": found["radius_px"], "radius_std_m": found["radius_std_px"]}
    total = total_area(found.assign(area_m2=np.pi * found["radius_px"] ** 2, **as_metres))
    area = np.pi * np.sum(truth["radius_px"] ** 2)
    return total.value / area - 1, total.std / area


def test_a_part_with_few_contacts_takes_the_edge_of_the_frame(gamma):
    whole, frame, reference, truth = gamma
    assert "response" in whole.own_optics.edge.families
    alone, lent = (
        measure_image(frame, reference, optics=optics, absent=("film",))
        for optics in (None, SharedOptics(edge=whole.own_optics.edge))
    )
    assert alone.own_optics.edge.count < 20 < whole.own_optics.edge.count
    error, std = error_of_area(alone, truth)
    assert abs(error) < 3 * std  # it does not know its edge, and says so
    better, smaller = error_of_area(lent, truth)
    assert lent.own_optics.edge.families == whole.own_optics.edge.families
    assert abs(better) < min(0.5 * abs(error), 3 * smaller)
    assert smaller < 0.5 * std
