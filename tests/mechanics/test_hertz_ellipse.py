"""The load of an elliptic contact against that of the circle of equal area."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from contactimg.errors import InputError
from contactimg.forces import assign_forces
from contactimg.mechanics import hertz, hertz_ellipse

RATIOS = [1.01, 1.3, 2.0, 4.0]


def test_a_circle_has_hertz_s_load_exactly():
    assert hertz_ellipse.load_ratio(3.0, 3.0) == 1.0
    # the closed form joins it: the first difference is of fourth order in the eccentricity
    assert hertz_ellipse.load_ratio(1.0 + 1e-5, 1.0) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("ratio", RATIOS)
def test_the_ratio_follows_from_the_curvatures_by_integration(ratio):
    """Johnson (4.25): ``1/(2 R1) = (p0/E*) b M/..`` with integrals over the pressure, done by quadrature.

    Under ``p0 sqrt(1 - x^2/a^2 - y^2/b^2)`` the surface sinks by ``(L - M x^2 - N y^2)/(pi E*)`` with
    ``M = (pi p0 a b/2) int_0^inf dw/[(a^2 + w)^(3/2) (b^2 + w)^(1/2) w^(1/2)]`` and N with a and b exchanged.
    The relative curvatures are ``1/R1 = 2 M/(pi E*)`` and ``1/R2 = 2 N/(pi E*)``; ``P = 2 pi a b p0/3``.
    """
    a, b, modulus, p0 = np.sqrt(ratio), 1 / np.sqrt(ratio), 3.0, 0.7

    def curvature(one, other):
        # w = t^2 removes the root at 0
        value, _ = quad(lambda t: 2 / ((one**2 + t * t) ** 1.5 * np.sqrt(other**2 + t * t)), 0, np.inf)
        return 2 / (np.pi * modulus) * np.pi * p0 * a * b / 2 * value

    radius = 1 / np.sqrt(curvature(a, b) * curvature(b, a))
    load = 2 * np.pi * a * b * p0 / 3
    circle = hertz.load(1.0, sphere_radius=radius, contact_modulus=modulus)
    assert hertz_ellipse.load_ratio(a, b) == pytest.approx(load / circle, rel=1e-7)


def test_a_wrong_order_of_the_half_axes_is_refused():
    with pytest.raises(InputError, match="half-axes must be positive"):
        hertz_ellipse.load_ratio(1.0, 2.0)


def test_the_switch_moves_the_forces_of_ellipses_and_of_nothing_else():
    table = pd.DataFrame(
        {
            "radius_m": [3e-5] * 3,
            "radius_std_m": [3e-7] * 3,
            "flags": [0] * 3,
            "shape": ["disk", "ellipse", "free"],
            "semi_major_px": [5.0, 5.0 * np.sqrt(2.0), 9.0],
            "semi_minor_px": [5.0, 5.0 / np.sqrt(2.0), 4.0],
        }
    )
    plain, own = (
        assign_forces(table, 1e-4, contact_modulus=4e6, elliptic=elliptic) for elliptic in (False, True)
    )
    ratio = float(hertz_ellipse.load_ratio(2.0, 1.0))
    assert (own["force_N"] / plain["force_N"]).tolist() == pytest.approx([1.0, ratio, 1.0])
    assert (own["force_std_N"] / plain["force_std_N"]).tolist() == pytest.approx([1.0, ratio, 1.0])
    assert own["force_hertz_N"].tolist() == plain["force_hertz_N"].tolist()
