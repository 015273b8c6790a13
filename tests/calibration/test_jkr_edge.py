"""The shift of the edge of the JKR reference contact, told by the loads."""

import numpy as np
import pytest

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.jkr import calibrate_jkr
from contactimg.mechanics import jkr

LENS, PIXEL, MODULUS, ADHESION = 0.1288, 12e-6, 3e6, 0.05
LOADS = np.array([0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5])


def calibrated(shift_px, seed=3):
    """A calibration from apparent radii that are too large by a shift, with noise of 0.005 px and 0.002 %."""
    rng = np.random.default_rng(seed)
    law = {"sphere_radius": LENS, "contact_modulus": MODULUS / 0.75, "work_of_adhesion": ADHESION}
    radius = jkr.radius(LOADS, **law) + PIXEL * (shift_px + 0.005 * rng.normal(size=LOADS.size))
    return calibrate_jkr(
        LOADS + 2e-5 * LOADS * rng.normal(size=LOADS.size),
        radius,
        sphere_radius=LENS,
        poisson_ratio=0.5,
        radius_std=0.005 * PIXEL,
        load_cell=LoadCell(zero_std=2e-5, gain_std=1e-3),
        pixel_size=PIXEL,
    )


@pytest.mark.parametrize("shift_px", [1.0, -0.8])
def test_a_shifted_edge_is_seen_and_taken_off(shift_px):
    found = calibrated(shift_px)
    assert found.edge.seen
    assert found.edge.settled
    assert abs(found.edge.shift.value - shift_px) < 3 * found.edge.shift.std < 0.8
    assert abs(found.young_modulus.value - MODULUS) < 3 * found.young_modulus.std
    assert abs(found.work_of_adhesion.value - ADHESION) < 3 * found.work_of_adhesion.std


def test_an_edge_where_it_seems_is_left_there():
    found = calibrated(0.0)
    assert not found.edge.seen
    assert abs(found.edge.shift.value) < 3 * found.edge.shift.std
    assert found.young_modulus.value == pytest.approx(
        MODULUS, rel=3e-3
    )  # the shift is not among what is fitted


@pytest.mark.parametrize(("shift_px", "zero"), [(0.0, 4e-3), (1.0, 0.0)])
def test_a_zero_of_the_loads_that_is_not_stated_is_no_shift_of_the_edge(shift_px, zero):
    law = {"sphere_radius": LENS, "contact_modulus": MODULUS / 0.75, "work_of_adhesion": ADHESION}
    loads = np.array([0.02, 0.05, 0.1, 0.15, 0.2])
    radius = jkr.radius(loads, **law) + PIXEL * shift_px
    found = calibrate_jkr(loads + zero, radius, sphere_radius=LENS, poisson_ratio=0.5, pixel_size=PIXEL)
    assert found.edge.seen == (zero == 0.0)
    assert found.zero_asked is not None  # either way it is an explanation
    if zero:
        assert found.zero_asked == pytest.approx(zero, rel=1e-6)


def test_few_loads_do_not_tell():
    few = calibrate_jkr(
        [0.02, 0.1, 0.5], [4e-4, 7e-4, 1.2e-3], sphere_radius=LENS, poisson_ratio=0.5, pixel_size=PIXEL
    )
    assert few.edge is None
