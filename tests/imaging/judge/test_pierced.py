"""Contacts with holes that the blur fills."""

import numpy as np
import pytest
from contactimg.imaging.judge import pierced
from edge_frames import edge_frame
from shape_frames import ellipse, frame

from contactimg.imaging.measure import measure_image


def pierced_disk(offset, share=0.1):
    """A circle with a hole of a share of its area at a distance from the centre."""
    circle = ellipse(1.0)[0]
    return [circle, np.sqrt(share) * circle + [offset, 0.0]]


def pierced_frame(rng, *, share=0.1, count=(6, 5)):
    """Contacts of 3.5 to 6.5 px, each with one hole, which reaches no level line."""
    places = [
        (30 + 35 * i, 30 + 35 * j, rng.uniform(3.5, 6.5)) for i in range(count[0]) for j in range(count[1])
    ]
    shapes = [pierced_disk(0.5 * np.sqrt(rng.uniform()), share) for _ in places]
    angles = rng.uniform(-1.5, 1.5, len(places))
    shape = (60 + 35 * (count[1] - 1), 60 + 35 * (count[0] - 1))
    return frame(shapes, places, angles=angles, rng=rng, shape=shape)


@pytest.mark.parametrize("seed", [1, 2])
def test_areas_with_holes_are_those_of_the_light_beside_them(seed, monkeypatch):
    image, reference, areas = pierced_frame(np.random.default_rng(seed))
    found = measure_image(image, reference)
    assert "holes that the blur fills" in found.message
    assert found.contrast == pytest.approx(1600.0, rel=0.03)  # 100 levels of sixteen
    assert found.disks["area_px2"].sum() == pytest.approx(areas.sum(), rel=0.03)
    shift = found.disks["radius_px"] @ found.disks["contrast_shift_px"]
    # the sum owes its uncertainty to the contrast: 2 %, of which nobody knows better how round holes are
    assert 2 * np.pi * abs(shift) == pytest.approx(0.02 * areas.sum(), rel=0.2)
    monkeypatch.setattr("contactimg.imaging.measure.may_have_holes", lambda _: False)
    assert measure_image(image, reference).disks["area_px2"].sum() > 1.1 * areas.sum()


def test_frames_without_holes_are_not_looked_at(monkeypatch):
    monkeypatch.setattr(pierced, "_settled", lambda *_: pytest.fail("holes were fitted"))
    rng = np.random.default_rng(3)
    places = [(30 + 35 * i, 30 + 35 * j, rng.uniform(4.0, 8.0)) for i in range(5) for j in range(4)]
    image, reference, _ = frame([ellipse(1.0)] * 20, places, angles=np.zeros(20), rng=rng, shape=(165, 200))
    assert measure_image(image, reference).disks["shape"].eq("disk").all()


@pytest.mark.parametrize(("case", "ratio"), [("coma", 1.0), ("bowl", 1.0), ("plain", 1.35), ("dome", 1.6)])
def test_what_contacts_share_and_ellipses_are_no_holes(case, ratio):
    image, reference, _ = edge_frame(case, seed=12, ratio=ratio, n=60, radii=(3.0, 6.0))
    assert "holes" not in measure_image(image, reference).message


def test_a_contact_finds_its_holes_and_what_the_optics_are():
    """The derivatives lead to the contrast and blur with which the pixels were made."""
    truth = np.array([[12.3, 11.8, 7.0], [10.0, 12.5, 1.8], [15.2, 9.0, 1.3]])
    y, x = np.mgrid[:25, :25].astype(float)
    optics = np.array([np.log(80.0), 1.4])
    blank = pierced._Pierced(x.ravel(), y.ravel(), np.zeros(625), (1.0, 0.0), truth, truth[0, :2])
    level, slopes = blank._model(optics)
    for k, step in ((6, 1e-4), (9, 1e-4), (10, 1e-4)):
        moved, away = truth.copy(), optics.copy()
        if k < truth.size:
            moved.ravel()[k] += step
        else:
            away[k - truth.size] += step
        other, _ = pierced.replace(blank, shapes=moved)._model(away)
        # tables of 1/32 blur width: derivatives to a few parts in a thousand of the largest
        assert np.abs((other - level) / step - slopes[k]).max() < 0.02 * np.abs(slopes[k]).max()
    contact = pierced.replace(blank, level=level, shapes=truth[:1] + np.array([0.3, -0.2, -0.3]))
    start = optics + np.array([-0.05, 0.05])
    contact = contact.fitted(start).with_holes(start)
    for _ in range(8):
        score, information = contact.shared(start)
        start = start + np.linalg.solve(information, score)
        contact = contact.fitted(start)
    np.testing.assert_allclose(start, optics, atol=0.01)
    order = np.argsort(-contact.shapes[:, 2])[:3]
    np.testing.assert_allclose(contact.shapes[order], truth, atol=0.1)
