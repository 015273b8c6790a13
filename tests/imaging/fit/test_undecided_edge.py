"""Edges that few contacts do not exclude: in the uncertainty, and lent by frames with more contacts."""

import numpy as np
import pytest
from contactimg.imaging.fit.undecided_edge import USUAL_SIZE, EdgeEvidence, undecided_modes
from edge_frames import edge_frame

from contactimg.forces import total_area
from contactimg.imaging.fit.edge_scores import SHARED, Edge
from contactimg.imaging.fit.pooling import pool_edges
from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.edge_shape import PARAMETERS, RESPONSE
from contactimg.imaging.profile.optics import EdgeKnowledge, SharedOptics

SIZE = SHARED + len(PARAMETERS)
WINDOW = (slice(0, 260), slice(0, 300))  # an eighth of the frame
NO_OPTICS = (np.zeros(2), np.diag([1.0, 1.0]))


def evidence_of(contacts, response=0.0):
    """Contacts of which each knows each parameter to its usual size, at a best defect of the response."""
    information = contacts * np.diag(np.append(np.ones(SHARED), USUAL_SIZE**-2))
    score = np.zeros(SIZE)
    score[SHARED + RESPONSE] = information[SHARED + RESPONSE, SHARED + RESPONSE] * response
    ones = np.ones(3)
    return EdgeEvidence(
        Edge.plain(1.4), score, information, np.array([2.0, 4.0, 8.0]), np.outer(ones, np.ones(SIZE))
    )


def undecided(contacts, response=0.0):
    """Root of the summed squares of the modes of one contact."""
    radius, field = np.full(1, 4.0), np.zeros((1, 5))
    modes = undecided_modes(evidence_of(contacts, response), (), NO_OPTICS, radius=radius, field=field)
    return float(np.linalg.norm(modes))


def test_what_is_undecided_falls_faster_than_the_noise():
    # the noise falls as n^(-1/2): a hundred times more contacts leave less than a tenth
    few, many = undecided(1.0), undecided(100.0)
    assert few > 0
    assert many < 0.1 * few


def test_residuals_that_hint_at_an_edge_widen_by_its_shift():
    # 0.5 +- 0.08: six standard uncertainties, so the shift of 0.5 px for an exponent of 0.5 counts in full
    assert undecided(100.0, 0.5) == pytest.approx(0.5, rel=0.25)
    assert undecided(100.0, 0.0) < 0.05


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
    alone = measure_image(frame, reference)
    lent = measure_image(frame, reference, optics=SharedOptics(edge=whole.own_optics.edge))
    assert alone.own_optics.edge.count < 20 < whole.own_optics.edge.count
    error, std = error_of_area(alone, truth)
    assert abs(error) < 3 * std  # it does not know its edge, and says so
    better, smaller = error_of_area(lent, truth)
    assert lent.own_optics.edge.families == whole.own_optics.edge.families
    assert abs(better) < min(0.5 * abs(error), 3 * smaller)
    assert smaller < 0.5 * std
