"""Ellipsoidal caps and caps of unequal modulus: closed forms, limits, boundary elements, refusals."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize

from contactimg import InputError, ModelRangeError, generate_asperities, solve_adhesive, solve_interacting
from contactimg.mechanics import hertz_ellipse
from contactimg.models.asperity_laws import Caps, HertzLaw
from contactimg.models.cap_shapes import CapShapes
from contactimg.surfaces import base_radius, composite_apexes
from contactimg.tables import Flag

E = 4e6
LENS = {"indenter_radius": 0.1288, "contact_modulus": E, "apex": (1e-3, 1e-3)}
FLAT = {"indenter_radius": np.inf, "contact_modulus": E}

# Timoshenko, Goodier, Theory of Elasticity, section 140: the angle with cos = (B - A)/(B + A), m and n; the
# entry for 70 degrees is 0.35 % off the integrals of the next test and left out
TABULATED = [
    (30, 2.731, 0.493), (40, 2.136, 0.567), (50, 1.754, 0.641), (60, 1.486, 0.717), (80, 1.128, 0.893),
    (90, 1.0, 1.0),
]  # fmt: skip


@pytest.fixture(scope="module")
def patch():
    return generate_asperities("SA", side=2e-3, rng=np.random.default_rng(4))


def cap(**columns):
    values = {"x_m": 0.0, "y_m": 0.0, "height_m": 4e-5, "radius_m": 1e-4} | columns
    return pd.DataFrame({name: [value] for name, value in values.items()})


def elongated(table, ratio, rng):
    return table.assign(
        radius_2_m=ratio * table["radius_m"], azimuth_rad=rng.uniform(-np.pi, np.pi, len(table))
    )


# one contact


@pytest.mark.parametrize(("angle", "m", "n"), TABULATED)
def test_the_half_axes_are_the_tabulated_ones(angle, m, n):
    cosine = np.cos(np.radians(angle))
    ratio = (1 + cosine) / (1 - cosine)
    found = hertz_ellipse.axis_ratio(ratio)
    assert found == pytest.approx(n / m, rel=2e-3)  # three decimals
    # a = m [3 P/(4 E* (A + B))]^(1/3), b with n: c^3 = (m n)^(3/2) ..., and F1^3 = that over 3 P Re/(4 E*)
    mean = (1 + ratio) / (2 * np.sqrt(ratio))  # (A + B) Re
    assert hertz_ellipse.area_factor(found) == pytest.approx((m * n) ** 1.5 / mean, rel=3e-3)


@pytest.mark.parametrize("ratio", [1.0, 2.04, 30.0])
def test_indentation_and_curvatures_follow_from_the_pressure_by_integration(ratio):
    """Under ``p0 sqrt(1 - x^2/a^2 - y^2/b^2)`` the surface sinks by ``(L - M x^2 - N y^2)/(pi E*)``."""
    a, b = 1.0, float(hertz_ellipse.axis_ratio(ratio))

    def integral(powers):
        return quad(lambda t: 2 / ((a**2 + t * t) ** powers[0] * (b**2 + t * t) ** powers[1]), 0, np.inf)[0]

    force = 2 * np.pi * a * b / 3  # p0 = E* = 1
    depth = a * b / 2 * integral((0.5, 0.5))
    larger, smaller = (1 / (a * b * integral(powers)) for powers in ((1.5, 0.5), (0.5, 1.5)))
    assert larger / smaller == pytest.approx(ratio, rel=1e-7)
    table = cap(radius_m=smaller, radius_2_m=larger, height_m=0.1 * smaller)
    found = solve_interacting(table, indenter_radius=np.inf, contact_modulus=1.0, load=force)
    assert found.indentation == pytest.approx(depth, rel=1e-7)
    row = found.contacts().iloc[0]
    assert (row["semi_major_m"], row["semi_minor_m"]) == pytest.approx((a, b), rel=1e-7)
    assert abs(row["angle_rad"]) == pytest.approx(np.pi / 2 if ratio > 1 else np.nan, nan_ok=True)
    assert row["radius_m"] ** 2 == pytest.approx(a * b)


def test_extreme_ratios_keep_their_digits():
    ratio = np.array([1.0, 1 + 1e-13, 1 + 1e-6, 1e2, 1e6, 1e12])
    found = hertz_ellipse.axis_ratio(ratio)
    assert found[0] == 1.0
    assert found[2] - 1 == pytest.approx(-2e-6 / 3, rel=1e-5)
    assert (np.diff(found) < 0).all()
    # long contacts: R'/R" = (a/b)^2/(ln(4 a/b) - 1)
    long = 1 / found[-2:]
    np.testing.assert_allclose(long**2 / (np.log(4 * long) - 1) / ratio[-2:], 1, rtol=1e-5)
    with pytest.raises(InputError, match="from 1 on"):
        hertz_ellipse.axis_ratio(0.5)


def based(modulus_ratio, base=8e-5, radius=1e-4):
    one = np.ones(1)
    return CapShapes(radius * one, one, 0 * one, modulus_ratio * one, base * one)


@pytest.mark.parametrize("m", [1e-3, 0.3, 3.0, 1e6])
def test_the_stiffness_on_a_base_is_the_slope_of_the_force(m):
    shapes = based(m)
    caps = Caps(np.repeat(shapes.depth_radius, 200), np.repeat(shapes.bases, 200, axis=0))
    a = m * 8e-5 * np.linspace(0.01, 0.99, 200)  # Hertz part of the stiffness
    depth = a**2 / caps.radius + 4 / 3 * caps.bases[:, 0] * a**3 / caps.radius
    step = 1e-7 * depth
    force, stiffness = HertzLaw().respond(depth, caps)
    np.testing.assert_allclose(force, 4 / 3 * a**3 / caps.radius, rtol=1e-9)
    slope = (HertzLaw().respond(depth + step, caps)[0] - HertzLaw().respond(depth - step, caps)[0]) / step / 2
    np.testing.assert_allclose(2 * stiffness, slope, rtol=1e-6)
    # the contact that covers the base has the stiffness of a punch of that radius, whatever the modulus
    widest = HertzLaw().respond(10 * depth[-1:], caps[-1:])[1]
    assert widest == pytest.approx(8e-5, rel=1e-12)


def test_a_rigid_asperity_is_a_punch_of_the_radius_of_its_base():
    base = float(base_radius(4e-5, 1e-4))
    found = solve_interacting(cap(modulus_ratio=1e9), load=1e-3, **FLAT)
    # the Hertz part of the indentation goes with m^(-2/3)
    assert found.indentation == pytest.approx(1e-3 / (2 * E * base), rel=1e-5)
    assert found.area == pytest.approx(np.pi * (3 * 1e-3 * 1e-4 / (4 * E * 1e9)) ** (2 / 3))


@pytest.mark.parametrize("m", [0.5, 2.0])
def test_the_area_of_a_cap_of_own_modulus_is_that_of_hertz_with_it(m):
    found = solve_interacting(cap(modulus_ratio=m), load=1e-4, **FLAT)
    a = np.cbrt(3 * 1e-4 * 1e-4 / (4 * m * E))
    assert found.radius[0] == pytest.approx(a, rel=1e-12)
    base = float(base_radius(4e-5, 1e-4))
    expected = a**2 / 1e-4 + 1e-4 * (1 - 1 / m) / (2 * base * E)
    assert found.indentation == pytest.approx(expected, rel=1e-12)


# patterns


def test_circular_caps_and_equal_moduli_are_the_plain_model(patch):
    plain = solve_interacting(patch, load=0.05, **LENS)
    same = solve_interacting(patch.assign(modulus_ratio=1.0), load=0.05, **LENS)
    np.testing.assert_array_equal(same.force, plain.force)
    np.testing.assert_array_equal(same.radius, plain.radius)
    round_ = elongated(patch, 1.0, np.random.default_rng(1))
    circular = solve_interacting(round_, load=0.05, **LENS)
    np.testing.assert_allclose(circular.force, plain.force, rtol=1e-12, atol=0)
    nearly = solve_interacting(elongated(patch, 1 + 1e-9, np.random.default_rng(1)), load=0.05, **LENS)
    assert nearly.shapes is not None
    np.testing.assert_allclose(nearly.force, plain.force, rtol=1e-7, atol=0)
    np.testing.assert_allclose(nearly.radius, plain.radius, rtol=1e-7, atol=0)


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
def test_change_of_units(patch, coupling):
    rng = np.random.default_rng(2)
    table = elongated(patch, 3.0, rng).assign(modulus_ratio=rng.uniform(0.5, 3, len(patch)))
    found = solve_interacting(table, load=0.05, coupling=coupling, **LENS)
    length, pressure = 7e3, 3e-4
    lengths = [name for name in table if name.endswith("_m")]
    other = solve_interacting(
        table.assign(**{name: length * table[name] for name in lengths}),
        indenter_radius=length * 0.1288,
        contact_modulus=pressure * E,
        apex=(length * 1e-3, length * 1e-3),
        load=0.05 * pressure * length**2,
        coupling=coupling,
    )
    np.testing.assert_allclose(other.force, found.force * pressure * length**2, rtol=1e-9, atol=0)
    np.testing.assert_allclose(other.radius, found.radius * length, rtol=1e-9, atol=0)
    assert other.indentation == pytest.approx(found.indentation * length)


def test_turning_sample_and_caps_turns_the_contacts(patch):
    turn, middle = 0.7, 1e-3
    table = elongated(patch, 4.0, np.random.default_rng(3))
    x, y = table["x_m"] - middle, table["y_m"] - middle
    turned = table.assign(
        x_m=middle + np.cos(turn) * x - np.sin(turn) * y,
        y_m=middle + np.sin(turn) * x + np.cos(turn) * y,
        azimuth_rad=table["azimuth_rad"] + turn,
    )
    one, other = (
        solve_interacting(t, load=0.05, **(LENS | {"indenter_radius": 2e-3})) for t in (table, turned)
    )
    np.testing.assert_allclose(other.force, one.force, rtol=1e-9, atol=0)
    angles = other.contacts()["angle_rad"] - one.contacts()["angle_rad"]
    np.testing.assert_allclose(np.exp(2j * angles), np.exp(2j * turn), rtol=1e-9)


def test_the_composite_summit_is_where_the_gap_is_least():
    table = cap(x_m=4e-4, y_m=-3e-4, radius_2_m=7e-4, azimuth_rad=0.4)
    radius = 2e-3
    apexes = composite_apexes(table, indenter_radius=radius).iloc[0]

    def gap(place):
        x, y = place * 1e-4
        dx, dy = x - 4e-4, y + 3e-4
        first, second = np.cos(0.4) * dx + np.sin(0.4) * dy, np.cos(0.4) * dy - np.sin(0.4) * dx
        return ((x**2 + y**2) / (2 * radius) - 4e-5 + first**2 / 2e-4 + second**2 / 1.4e-3) * 1e4

    least = minimize(gap, np.array([4.0, -3.0]), tol=1e-14)
    assert (apexes["x_m"], apexes["y_m"]) == pytest.approx(tuple(least.x * 1e-4), rel=1e-6)
    assert apexes["height_m"] == pytest.approx(-least.fun * 1e-4, rel=1e-9)
    first, second = 1 / (1 / 1e-4 + 1 / radius), 1 / (1 / 7e-4 + 1 / radius)
    assert apexes["radius_m"] == pytest.approx(np.sqrt(first * second))
    assert apexes["radius_ratio"] == pytest.approx(second / first)
    assert apexes["azimuth_rad"] == pytest.approx(0.4 - np.pi / 2)


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
@pytest.mark.parametrize("ratio", [1e-3, 1e6])
def test_extreme_moduli_and_shapes_converge(patch, ratio, coupling):
    rng = np.random.default_rng(5)
    table = elongated(patch, 100.0, rng).assign(modulus_ratio=np.where(np.arange(len(patch)) % 2, ratio, 1.0))
    found = solve_interacting(table, load=1e-3, coupling=coupling, **LENS)
    assert found.status == "converged"
    assert found.load == pytest.approx(1e-3)
    nothing = solve_interacting(table, indentation=0.0, coupling=coupling, **LENS)
    assert not nothing.area
    assert nothing.contacts().empty


def test_stiffer_asperities_bear_more_and_their_neighbours_less(patch):
    plain = solve_interacting(patch, load=0.05, **LENS)
    stiff = np.arange(len(patch)) % 2 == 0
    found = solve_interacting(patch.assign(modulus_ratio=np.where(stiff, 2.0, 1.0)), load=0.05, **LENS)
    both = (found.force > 0) & (plain.force > 0)
    assert (found.force[both & ~stiff] < plain.force[both & ~stiff]).all()
    assert found.force[stiff].sum() > plain.force[stiff].sum()
    assert found.area < plain.area


# against boundary elements


def displacement_of_square(x, y, side):
    """Displacement at (x, y) by a unit pressure on a square about the origin, E* = 1 (Love)."""
    total = np.zeros_like(x)
    for i in (-1, 1):
        for j in (-1, 1):
            u, v = x + i * side / 2, y + j * side / 2
            r = np.hypot(u, v)
            total += i * j * (u * np.log(v + r) + v * np.log(u + r))
    return total / np.pi


def boundary_elements(x, y, gap, side, force):
    """Pressures on small squares under a flat indenter, with the active set solved directly."""
    matrix = displacement_of_square(x[:, None] - x, y[:, None] - y, side)
    active = np.ones(x.size, bool)
    while True:
        parts = np.linalg.solve(
            matrix[np.ix_(active, active)], np.column_stack([np.ones(active.sum()), gap[active]])
        )
        ones, gaps = parts.sum(axis=0) * side**2
        pressure = (force + gaps) / ones * parts[:, 0] - parts[:, 1]
        if (pressure >= 0).all():
            return active, pressure, (force + gaps) / ones
        active[np.flatnonzero(active)[pressure < 0]] = False


def test_an_ellipsoid_and_a_sphere_against_boundary_elements():
    table = pd.concat([cap(), cap(x_m=1.4e-4, height_m=4.02e-5)], ignore_index=True)
    table = table.assign(radius_2_m=[3e-4, 1e-4], azimuth_rad=[0.5, 0.0])
    load, side = 3e-4, 1.5e-6
    found, alone = (
        solve_interacting(table, load=load, coupling=coupling, **FLAT) for coupling in ("asymptotic", "none")
    )
    contacts, points = found.contacts(), []
    for row, (asperity, reach) in enumerate(zip(table.itertuples(), contacts["semi_major_m"], strict=True)):
        offsets = np.arange(-1.15 * reach, 1.15 * reach, side)
        u, v = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
        turn = asperity.azimuth_rad
        first, second = np.cos(turn) * u + np.sin(turn) * v, np.cos(turn) * v - np.sin(turn) * u
        gap = first**2 / (2 * asperity.radius_m) + second**2 / (2 * asperity.radius_2_m)
        near = gap < 1.4 * float(found.penetration[row])
        gap += 4.02e-5 - asperity.height_m
        points.append(np.stack([asperity.x_m + u, asperity.y_m + v, gap, np.full(gap.size, row)])[:, near])
    x, y, gap, owner = np.concatenate(points, axis=1)
    active, pressure, depth = boundary_elements(x, y, gap, side, load / E)
    force = np.bincount(owner[active].astype(int), pressure * side**2) * E
    # measured: 6e-5 of the forces, 3e-4 of the indentation; half of that is the grid
    np.testing.assert_allclose(found.force, force, rtol=2e-4)
    assert found.indentation == pytest.approx(depth, rel=1e-3)
    assert not np.allclose(alone.force, force, rtol=2e-3)  # coupling does act
    # second moments of an elliptic Hertz pressure: a^2/5 and b^2/5; a pixel is 6 % of the half-axis
    moments = 5 * np.cov(x[active & (owner == 0)], y[active & (owner == 0)],
                         aweights=pressure[owner[active] == 0], bias=True)  # fmt: skip
    values, vectors = np.linalg.eigh(moments)
    row = contacts.iloc[0]
    assert np.sqrt(values) == pytest.approx(row[["semi_minor_m", "semi_major_m"]].to_numpy(float), rel=5e-3)
    assert np.tan(row["angle_rad"]) == pytest.approx(vectors[1, 1] / vectors[0, 1], rel=5e-3)


# what is refused


def test_what_is_not_defined_is_refused_in_one_sentence(patch):
    long = elongated(patch, 2.0, np.random.default_rng(6))
    for coupling in ("full", "hertz"):
        with pytest.raises(InputError, match=r'these are of ellipsoidal shape; take "asymptotic"'):
            solve_interacting(long, load=0.05, coupling=coupling, **LENS)
    with pytest.raises(InputError, match=r"of unequal modulus, for which only Hertz's law"):
        solve_interacting(patch.assign(modulus_ratio=2.0), load=0.05, law="sphere", **LENS)
    with pytest.raises(InputError, match="adhesion is defined for spherical caps of one modulus"):
        solve_adhesive(long, load=0.05, work_of_adhesion=0.05, **LENS)
    with pytest.raises(InputError, match=r"hand over the column modulus_ratio"):
        solve_interacting(patch.assign(young_modulus_Pa=1e6), load=0.05, **LENS)
    with pytest.raises(InputError, match="row 0, column 'height_m' must be positive for an asperity with"):
        solve_interacting(cap(height_m=0.0, modulus_ratio=2.0), load=1e-4, **FLAT)
    for name, value in (("radius_2_m", -1.0), ("radius_2_m", np.inf), ("modulus_ratio", 0.0)):
        with pytest.raises(InputError, match=f"row 0, column '{name}' must be"):
            solve_interacting(cap(**{name: value}), load=1e-4, **FLAT)


def test_a_contact_that_covers_its_base_is_refused():
    with pytest.raises(ModelRangeError, match=r"row 0 has a modulus of its own, and its contact"):
        solve_interacting(cap(modulus_ratio=0.2), load=6e-3, **FLAT)


def test_long_contacts_side_by_side_overlap_by_their_half_axes():
    pair = pd.concat([cap(), cap(x_m=9e-5)], ignore_index=True).assign(
        radius_2_m=1e-3, azimuth_rad=[np.pi / 2, 0]
    )
    found = solve_interacting(pair, load=1e-3, coupling="none", **FLAT)
    contacts = found.contacts()
    major = contacts["semi_major_m"]
    assert contacts["radius_m"].sum() < 9e-5 < major.sum()
    assert (contacts["flags"] & int(Flag.OVERLAP)).all()
    assert found.validity.n_overlapping == 2
    # the strain of an ellipse is the larger of a/R' and b/R"
    strain = np.maximum(major / 1e-3, contacts["semi_minor_m"] / 1e-4)
    assert found.validity.max_strain == pytest.approx(strain.max())
