"""Contacts on a thin bonded layer, against axisymmetric boundary elements with the layer's own response."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import ellipe, ellipk, j0, j1, roots_legendre

from contactimg.errors import ModelRangeError
from contactimg.mechanics import jkr
from contactimg.models.adhesive import solve_adhesive
from contactimg.models.interacting import solve_interacting

CAP = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}


def ring_matrix(edges, thickness, poisson_ratio):
    """Displacement (E* = 1) at the middle of rings by unit pressure on each.

    Of the half-space in elliptic integrals (Johnson, Contact Mechanics, 3.4), of the support as a Hankel
    transform with the layer's response in sinh and cosh, as it is usually printed.
    """
    r = 0.5 * (edges[1:] + edges[:-1])[:, None]
    c = edges[None, 1:]

    def half_space(c):
        larger, m = np.maximum(r, c), np.minimum((np.minimum(r, c) / np.maximum(r, c)) ** 2, 1 - 1e-14)
        return 4 / np.pi * larger * np.where(r < c, ellipe(m), ellipe(m) - (1 - m) * ellipk(m))

    kappa = 3 - 4 * poisson_ratio
    node, weight = roots_legendre(300)
    q = 10 * (node + 1)
    response = (2 * kappa * np.sinh(2 * q) - 4 * q) / (2 * kappa * np.cosh(2 * q) + 1 + kappa**2 + 4 * q**2)
    k = q / thickness
    discs = edges[1:, None] * j1(edges[1:, None] * k) / k
    support = 2 * (j0(r * k) * (1 - response) * 10 * weight / thickness) @ discs.T
    by_disc = half_space(c) - support
    by_disc[:, 1:] -= by_disc[:, :-1].copy()
    return r[:, 0], by_disc


def boundary_elements(indentation, thickness, poisson_ratio, count=160):
    """Force over E* (m^2) on a paraboloid of 100 um: pressures are not negative."""
    edges = np.linspace(0.0, 1.6 * np.sqrt(1e-4 * indentation), count + 1)
    r, matrix = ring_matrix(edges, thickness, poisson_ratio)
    gap, active = indentation - r**2 / 2e-4, r < np.sqrt(2e-4 * indentation)
    for _ in range(100):
        pressure = np.zeros(count)
        pressure[active] = np.linalg.solve(matrix[np.ix_(active, active)], gap[active])
        wrong = active & (pressure < 0)
        overlapping = ~active & (gap - matrix @ pressure > 0)
        if not wrong.any() and not overlapping.any():
            break
        active = (active & ~wrong) | overlapping
    return float(np.pi * np.diff(edges**2) @ pressure)


@pytest.mark.parametrize("poisson_ratio", [0.5, 0.49, 0.3])
@pytest.mark.parametrize("thickness", [2e-4, 8e-5, 5e-5, 2e-5])
def test_force_at_an_indentation_agrees_with_boundary_elements(thickness, poisson_ratio):
    indentation = 1.2e-5 if thickness > 3e-5 else 6e-6
    solution = solve_interacting(
        CAP, indentation=indentation, thickness=thickness, poisson_ratio=poisson_ratio, **FLAT
    )
    expected = 4e6 * boundary_elements(indentation, thickness, poisson_ratio)
    # the edge of the contact is known to a ring, 1 % of the radius, where pressures are low
    assert solution.load == pytest.approx(expected, rel=3e-3)
    assert solution.status == "converged"


def test_area_of_a_thin_layer_is_that_of_the_stiffness():
    """dP/dD is what a flat punch of the contact radius has on the layer."""
    thickness, step = 5e-5, 1e-9
    where = FLAT | {"thickness": thickness, "poisson_ratio": 0.3}
    low, middle, high = (solve_interacting(CAP, indentation=1e-5 + k * step, **where) for k in (-1, 0, 1))
    r, matrix = ring_matrix(np.linspace(0.0, float(middle.radius[0]), 200), thickness, 0.3)
    edges = np.linspace(0.0, float(middle.radius[0]), 200)
    punch = 4e6 * float(np.pi * np.diff(edges**2) @ np.linalg.solve(matrix, np.ones_like(r)))
    assert (high.load - low.load) / (2 * step) == pytest.approx(punch, rel=5e-3)


def test_thick_layers_are_half_spaces_with_and_without_adhesion():
    plain = solve_interacting(CAP, load=1e-3, **FLAT)
    thick = solve_interacting(CAP, load=1e-3, thickness=1.0, poisson_ratio=0.4, **FLAT)
    assert thick.radius[0] == pytest.approx(plain.radius[0], rel=1e-9)
    sticky = solve_adhesive(CAP, load=1e-3, thickness=1.0, work_of_adhesion=0.05, **FLAT)
    closed = jkr.radius(1e-3, sphere_radius=1e-4, contact_modulus=4e6, work_of_adhesion=0.05)
    assert sticky.radius[0] == pytest.approx(float(closed), rel=1e-8)


def test_adhesion_on_a_thin_layer_has_its_force_and_vanishes():
    layer = {"thickness": 6e-5, "poisson_ratio": 0.45}
    plain = solve_interacting(CAP, load=2e-3, **FLAT, **layer)
    nearly = solve_adhesive(CAP, load=2e-3, work_of_adhesion=1e-12, **FLAT, **layer)
    # sqrt(6 pi w R p)/p on a^3
    assert nearly.radius[0] == pytest.approx(plain.radius[0], rel=2e-5)
    sticky = solve_adhesive(CAP, load=2e-3, work_of_adhesion=0.05, **FLAT, **layer)
    assert sticky.status == "converged"
    assert sticky.radius[0] > 1.05 * plain.radius[0]


def test_neighbours_on_a_thin_layer_balance_in_every_coupling():
    rng = np.random.default_rng(4)
    places = 1e-4 * np.stack([v.ravel() for v in np.meshgrid(np.arange(8.0), np.arange(8.0))])
    table = pd.DataFrame(
        {"x_m": places[0], "y_m": places[1], "height_m": 4e-5 + 3e-6 * rng.random(64), "radius_m": 1e-4}
    )
    for coupling in ("asymptotic", "full"):
        for law in ("hertz", "sphere"):
            where = {"thickness": 6e-5, "poisson_ratio": 0.48, "coupling": coupling, "law": law}
            dense, fast = (
                solve_interacting(table, load=0.03, method=m, **where, **FLAT) for m in ("dense", "fast")
            )
            np.testing.assert_allclose(fast.radius, dense.radius, rtol=1e-8)
            if coupling == "full":
                continue
            sticky = solve_adhesive(table, load=0.03, work_of_adhesion=1e-9, **where, **FLAT)
            np.testing.assert_allclose(sticky.radius, dense.radius, rtol=2e-3)


def test_contacts_wider_than_the_law_are_refused():
    with pytest.raises(ModelRangeError, match="law of a layer holds up to 2 thicknesses"):
        solve_interacting(CAP, load=5e-3, thickness=1e-5, **FLAT)
