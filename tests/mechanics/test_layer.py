"""The bonded layer's kernel: its transform, the limits of a thick and of a thin layer, the table."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from contactimg import InputError
from contactimg.mechanics import layer
from contactimg.models.coupling import Kernel, layer_deficit


def test_response_is_the_published_ratio():
    q = np.array([0.3, 1.0, 4.0])
    published = (np.sinh(2 * q) - 2 * q) / (np.cosh(2 * q) + 1 + 2 * q**2)
    np.testing.assert_allclose(layer.response(q), published, rtol=1e-13)
    # long waves: L -> (2/3) q^3; next term relative to it is of order q^2
    assert layer.response(1e-2) == pytest.approx(2 / 3 * 1e-6, rel=3e-4)


@pytest.mark.parametrize("s", [0.0, 0.7, 6.0, 31.0])
def test_deficit_is_the_transform(s):
    missing = lambda q: float(1 - layer.response(q)) * j0(q * s)  # noqa: E731
    direct = quad(missing, 0, 24, limit=2000, epsabs=1e-11)[0]
    assert layer.deficit(s) == pytest.approx(direct, abs=1e-9)  # 1 - L cancels to 1e-16 a unit of q


def test_half_space_when_thick_and_still_when_thin():
    where = {"load": 1e-3, "contact_modulus": 4e6}
    free = 1e-3 / (np.pi * 4e6 * 1e-4)
    thick = [float(layer.surface_displacement(1e-4, thickness=t, **where)) / free - 1 for t in (1.0, 0.1)]
    # the deficit is phi(0) r/t to first order: 1.77e-4 and ten times that
    assert thick[0] == pytest.approx(-1.7702e-4, rel=1e-3)
    assert thick[1] == pytest.approx(10 * thick[0], rel=1e-3)
    assert abs(float(layer.surface_displacement(1e-4, thickness=4e-6, **where))) < 1e-7 * free
    with pytest.raises(InputError, match="r must be positive"):
        layer.surface_displacement(0.0, thickness=1.0, **where)


def test_table_reproduces_value_slope_and_laplacian():
    kernel = Kernel.of_thickness(2.0)
    for s in (0.0013, 0.4237, 3.3391, 12.005):
        value, slope, laplacian = layer_deficit(2.0 * s, kernel.thinness, kernel.value, kernel.slope)
        h = 1e-3
        near = layer.deficit(np.array([abs(s - h), s, s + h])) / 2
        first = (near[2] - near[0]) / (2 * h * 2) if s > h else slope
        # cubic interpolation of step 0.01: h^4/384 phi'''' in value, h^2/12 phi'''' in the second derivative
        assert value == pytest.approx(near[1], abs=1e-9)
        assert slope == pytest.approx(first, abs=1e-6)
        second = (near[2] - 2 * near[1] + near[0]) / (4 * h**2) if s > h else laplacian / 2
        assert laplacian == pytest.approx(second + first / (2 * s) if s > h else laplacian, abs=2e-4)


@pytest.mark.parametrize("ratio", [-1.0, 0.6, 2.0])
def test_a_ratio_that_no_body_has_is_refused(ratio):
    where = {"load": 1e-3, "contact_modulus": 4e6, "thickness": 1e-3}
    with pytest.raises(InputError, match=r"poisson_ratio must be above -1 and at most 0\.5, got"):
        layer.surface_displacement(1e-4, poisson_ratio=ratio, **where)
    with pytest.raises(InputError, match="poisson_ratio must be above -1"):
        layer.layer_factors(0.5, poisson_ratio=ratio)


def test_indentation_of_a_hertz_contact_drops_as_published():
    # delta falls by (4 a/(3 pi t)) phi(0) = 0.751 a/t; Dimitriadis et al., Biophys. J. 82 (2002) 2798, have
    # F ~ 1 + 1.133 a/t at a depth, that is (2/3) 1.133 = 0.755 at a load
    assert 4 / (3 * np.pi) * float(layer.deficit(0.0)) == pytest.approx(2 / 3 * 1.133, rel=0.01)
