"""A sphere on a bonded layer: energy balance, limits, and the table that is interpolated."""

import numpy as np
import pytest

from contactimg.errors import ModelRangeError
from contactimg.mechanics.layer import _contact_nodes, layer_factors, layer_factors_at


def flat_and_parabola(ratio):
    """Mean and edge value of ``g`` under a flat and a parabolic indenter, solved by iteration instead."""
    x, weight, q, missing = _contact_nodes()
    kernel = 2 / np.pi * ratio * (np.cos(ratio * np.outer(x, q)) * missing) @ np.cos(ratio * np.outer(q, x))
    edge = 2 / np.pi * ratio * (np.cos(ratio * q) * missing) @ np.cos(ratio * np.outer(q, x))
    found = []
    for side in (np.ones_like(x), x**2):
        g = side.copy()
        for _ in range(400):
            g = side + kernel @ (weight * g)
        found += [weight @ g, 1 + edge @ (weight * g)]
    return found


@pytest.mark.parametrize("ratio", [0.1, 0.4, 0.8])
def test_factors_come_from_the_two_responses(ratio):
    flat, flat_edge, parabola, parabola_edge = flat_and_parabola(ratio)
    pressing, adhesive = layer_factors(ratio)
    assert pressing == pytest.approx(1.5 * (flat * parabola_edge / flat_edge - parabola), rel=1e-8)
    assert adhesive == pytest.approx(flat / flat_edge, rel=1e-8)


@pytest.mark.parametrize("ratio", [0.2, 0.7, 1.5])
def test_the_load_does_the_work_of_the_stiffness(ratio):
    """Without adhesion dP/da = S ddelta/da, S = 2 E* a G1 being the stiffness at a fixed radius."""
    step = 1e-4

    def load_and_depth(a):  # E* = R = t = 1
        flat, flat_edge, parabola, parabola_edge = flat_and_parabola(a)
        depth = a**2 * parabola_edge / flat_edge
        return 2 * a * (depth * flat - a**2 * parabola), depth, 2 * a * flat

    (low, shallow, _), (_, _, stiffness), (high, deep, _) = map(
        load_and_depth, (ratio - step, ratio, ratio + step)
    )
    assert (high - low) / (deep - shallow) == pytest.approx(stiffness, rel=1e-6)  # step^2 terms
    assert layer_factors(ratio)[0] * 4 / 3 * ratio**3 == pytest.approx((low + high) / 2, rel=1e-6)


def test_a_thick_layer_is_a_half_space_and_the_support_acts_with_the_cube():
    pressing, adhesive = layer_factors([0.0, 0.01, 0.02])
    assert (pressing[0], adhesive[0]) == pytest.approx((1.0, 1.0), abs=1e-12)
    assert (pressing[2] - 1) / (pressing[1] - 1) == pytest.approx(8, rel=0.05)
    # radius at a given force, as computed for a single contact: 0.03, 0.2, 0.7, 2.6, 7.7 %
    larger = layer_factors([0.1, 0.2, 0.3, 0.5, 0.8])[0] ** (1 / 3) - 1
    assert larger == pytest.approx([3e-4, 2e-3, 7e-3, 2.6e-2, 7.7e-2], rel=0.15)


def test_the_table_is_exact_between_its_nodes_and_ends_where_it_says():
    for ratio in (0.0531, 0.777, 1.993):
        assert np.ravel(layer_factors(ratio)) == pytest.approx(layer_factors_at(ratio)[:2], rel=1e-8)
    with pytest.raises(ModelRangeError, match="up to 2 thicknesses"):
        layer_factors(2.1)
