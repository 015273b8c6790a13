"""What a reference contact has told of the edge: a shift taken off all radii, with its uncertainty."""

import numpy as np
import pytest
from edge_frames import edge_frame

from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.tables import Status


def test_a_known_edge_moves_all_radii_and_settles_soft_edges():
    frame, reference, _ = edge_frame("soft", seed=41)[:3]
    soft = measure_image(frame, reference, polarity="bright")
    assert soft.status == Status.SOFT
    known = SharedOptics().with_edge(0.3, 0.05)
    settled = measure_image(frame, reference, polarity="bright", optics=known)
    assert settled.status != Status.SOFT
    moved = soft.disks["radius_px"].to_numpy() - settled.disks["radius_px"].to_numpy()
    assert moved == pytest.approx(np.full(len(moved), 0.3), abs=1e-9)
    assert (settled.disks["radius_std_px"] < soft.disks["radius_std_px"]).mean() > 0.9
    assert (settled.disks["edge_shift_px"].abs() >= 0.05).all()
    area = np.pi * settled.disks["radius_px"] ** 2
    assert settled.disks["area_px2"].to_numpy() == pytest.approx(area.to_numpy())
    # an area pi a^2 has the uncertainty 2 pi a da, and the disk of that radius the perimeter 2 pi a
    disk = settled.disks[settled.disks["shape"] == "disk"]
    perimeter = 2.0 * np.pi * disk["radius_px"]
    assert disk["perimeter_px"].to_numpy() == pytest.approx(perimeter.to_numpy())
    assert disk["area_std_px2"].to_numpy() == pytest.approx((perimeter * disk["radius_std_px"]).to_numpy())


def test_without_an_uncertainty_nothing_is_known():
    assert SharedOptics().with_edge(0.3, None).known_edge is None


def test_a_shift_as_wide_as_contacts_is_said():
    frame, reference, _ = edge_frame("soft", seed=41)[:3]
    radius = measure_image(frame, reference, polarity="bright").disks["radius_px"]
    for shift, status in ((1.5 * float(radius.median()), Status.SOFT), (0.3, Status.OK)):
        known = SharedOptics().with_edge(shift, 0.05)
        found = measure_image(frame, reference, polarity="bright", optics=known)
        assert found.status == status
        assert ("the shift of the edge" in found.message) == (status == Status.SOFT)
