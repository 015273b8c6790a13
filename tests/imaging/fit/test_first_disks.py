"""What every attempt on a frame begins with is found once."""

import numpy as np
import pytest
from edge_frames import edge_frame

from contactimg.imaging.fit.method import FirstDisks, measure_by_fit
from contactimg.imaging.measure import measure_image


@pytest.mark.parametrize("learns_edge", [True, False])
def test_measured_again_from_the_same_disks_it_is_the_same(learns_edge):
    frame, reference, _ = edge_frame("defocus", seed=3, ratio=1.3, n=120, radii=(2.5, 9.0))
    prepared = measure_image(frame, reference).prepared
    parts = prepared.foreground, prepared.difference
    first = FirstDisks.of(*parts)
    measure_by_fit(*parts, film=None, first=first)
    again = measure_by_fit(*parts, film=None, first=first, learns_edge=learns_edge)
    alone = measure_by_fit(*parts, film=None, learns_edge=learns_edge)
    assert np.array_equal(again.contacts["radius_px"], alone.contacts["radius_px"])
    assert bool(again.frame_fit.edge.families) == learns_edge
    assert again.frame_fit.problem.work == alone.frame_fit.problem.work
