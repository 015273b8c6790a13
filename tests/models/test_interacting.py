"""Interacting asperities: identities, limits, invariances, and every level of coupling against the others."""

import functools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize

from contactimg import Flag, InputError, generate_asperities, hertz, solve_interacting, solve_loads, sphere
from contactimg.models.composite_summits import CompositeSummits

LENS = {"indenter_radius": 0.1288, "contact_modulus": 4e6}
FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}
TIGHT = 1e-10  # what the residual of 1e-12 leaves after a sum over contacts


def caps(x, y=0.0, height=4e-5, radius=1e-4):
    x = np.asarray(x, dtype=float)
    columns = {"x_m": x, "y_m": y, "height_m": height, "radius_m": radius}
    return pd.DataFrame({name: np.broadcast_to(np.asarray(v, float), x.shape) for name, v in columns.items()})


@pytest.fixture(scope="module")
def patch():
    return generate_asperities("SA", side=4e-3, rng=np.random.default_rng(11))


MIDDLE = (2e-3, 2e-3)


def forces(table, coupling="asymptotic", **options):
    return solve_interacting(table, coupling=coupling, apex=MIDDLE, **{**LENS, **options})


@pytest.mark.parametrize("coupling", ["none", "asymptotic", "hertz", "full"])
@pytest.mark.parametrize("load", [1e-15, 1e-3, 1.0])
def test_one_asperity_is_hertz(coupling, load):
    solution = solve_interacting(caps([1e-3]), load=load, coupling=coupling, **LENS)
    composite = 1e-4 * 0.1288 / (0.1288 + 1e-4)
    where = {"sphere_radius": composite, "contact_modulus": 4e6}
    assert solution.radius[0] == pytest.approx(float(hertz.radius(load, **where)), rel=TIGHT)
    assert solution.indentation == pytest.approx(float(hertz.indentation(load, **where)), rel=TIGHT)
    assert solution.x[0] == pytest.approx(1e-3 * 0.1288 / (0.1288 + 1e-4), rel=1e-14)


def test_one_exact_sphere():
    load = 1e-2
    solution = solve_interacting(caps([0.0]), load=load, law="sphere", **FLAT)
    assert solution.radius[0] == pytest.approx(
        float(sphere.radius(load, sphere_radius=1e-4, contact_modulus=4e6)), rel=TIGHT
    )


@pytest.mark.parametrize("coupling", ["none", "asymptotic", "hertz", "full"])
@pytest.mark.parametrize("options", [{}, {"law": "sphere"}, {"thickness": 5e-3}])
def test_load_and_indentation_are_two_ways_to_one_solution(patch, coupling, options):
    by_load = forces(patch, coupling, load=0.1, **options)
    by_depth = forces(patch, coupling, indentation=by_load.indentation, **options)
    assert by_load.load == pytest.approx(0.1, rel=TIGHT)
    assert by_load.force.sum() == pytest.approx(0.1, rel=TIGHT)
    np.testing.assert_allclose(by_depth.force, by_load.force, atol=TIGHT * 0.1)


def test_bordered_solve_is_the_root_search(patch):
    bordered = forces(patch, load=0.05)
    error = lambda depth: forces(patch, indentation=depth).load - 0.05  # noqa: E731
    root = brentq(error, 1e-6, 1e-4, xtol=1e-20, rtol=1e-14)
    assert bordered.indentation == pytest.approx(root, rel=TIGHT)


def test_forces_minimise_the_energy(patch):
    """Against a bound-constrained minimiser that knows the energy alone."""
    table = patch.iloc[:: len(patch) // 25].reset_index(drop=True)
    flat = caps(table["x_m"], table["y_m"], table["height_m"], table["radius_m"])
    solution = solve_interacting(flat, indentation=1.5e-5, **FLAT)
    r = np.hypot(*(flat[c].to_numpy()[:, None] - flat[c].to_numpy() for c in ("x_m", "y_m")))
    np.fill_diagonal(r, np.inf)
    unit = 4e6 * 1e-5 * np.sqrt(1e-4 * 1e-5)  # E* depth length
    C, k = unit / (np.pi * 4e6 * r) / 1e-5, 4 / 3 * 4e6 * np.sqrt(1e-4) * 1e-5**1.5 / unit
    depth = (1.5e-5 - (flat["height_m"].max() - flat["height_m"].to_numpy())) / 1e-5

    def energy(p):
        q = np.maximum(p, 0)
        value = 0.6 * np.sum(q ** (5 / 3)) / k ** (2 / 3) + 0.5 * q @ C @ q - q @ depth
        return value, (q / k) ** (2 / 3) + C @ q - depth

    found = minimize(
        energy, np.full(len(flat), 0.1), jac=True, bounds=[(0, None)] * len(flat), method="L-BFGS-B",
        options={"ftol": 1e-16, "gtol": 1e-11, "maxiter": 5000},
    )  # fmt: skip
    # a gradient below 1e-8 moves forces by less than 1e-8 times the compliance of order 1
    np.testing.assert_allclose(solution.force / unit, found.x, atol=1e-6)


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
def test_energy_is_the_integral_of_the_load(patch, coupling):
    """U = sum (2/5) p delta + (1/2) p C p against int P dD by Gauss-Legendre over smooth pieces."""

    def stored(solution):
        p, delta = solution.force, np.maximum(solution.penetration, 0)
        rows = solution.touching
        r = np.hypot(*(c[rows, None] - c[rows] for c in (solution.x, solution.y)))
        np.fill_diagonal(r, np.inf)
        interaction = 0.5 * p[rows] @ (1 / (np.pi * 4e6 * r)) @ p[rows] if coupling != "none" else 0.0
        return 0.4 * float(p @ np.where(p > 0, delta, 0)) + interaction

    low, high = 1.0e-5, 1.04e-5
    nodes, weights = np.polynomial.legendre.leggauss(12)
    loads = [
        forces(patch, coupling, indentation=d).load for d in 0.5 * (low + high) + 0.5 * (high - low) * nodes
    ]
    work = 0.5 * (high - low) * float(weights @ loads)
    change = stored(forces(patch, coupling, indentation=high)) - stored(
        forces(patch, coupling, indentation=low)
    )
    # a contact that forms in the interval leaves a kink of order (D - D_i)^{5/2}: 1e-7 of the work here
    assert change == pytest.approx(work, rel=1e-6)


def test_jacobian_is_symmetric():
    """dp_i/dg_j by central differences of heights."""
    table, h = caps([0, 1.2e-4, 2.9e-4], [0, 1e-5, 0], [4e-5, 3.9e-5, 3.95e-5]), 1e-10
    columns = []
    for j in range(3):
        raised, lowered = table.copy(), table.copy()
        raised.loc[j, "height_m"] += h
        lowered.loc[j, "height_m"] -= h
        top = table["height_m"].max()
        at = [
            solve_interacting(t, indentation=8e-6 + t["height_m"].max() - top, **FLAT).force
            for t in (raised, lowered)
        ]
        columns.append((at[0] - at[1]) / (2 * h))
    jacobian = np.array(columns)
    # rounding: 1e-12 * 1e-4 N / 1e-10 m against entries of 10-100 N/m
    np.testing.assert_allclose(jacobian, jacobian.T, atol=1e-4)
    assert abs(jacobian[0, 1]) > 1


def test_uncoupled_as_the_spacing_grows():
    spread, base = [], caps([0, 1e-3, 0.3e-3], [0, 0, 1e-3], [4e-5, 3.8e-5, 3.9e-5])
    for factor in (1e3, 1e4):
        table = base.assign(x_m=base["x_m"] * factor, y_m=base["y_m"] * factor)
        difference = [solve_interacting(table, load=3e-3, coupling=c, **FLAT).force for c in ("none", "full")]
        spread.append(np.abs(difference[0] - difference[1]).max())
    assert spread[0] / spread[1] == pytest.approx(10, rel=1e-3)  # as 1/r
    assert spread[1] < 1e-5 * 3e-3


@pytest.mark.parametrize("coupling", ["asymptotic", "full"])
def test_half_space_as_the_layer_thickens(patch, coupling):
    free = forces(patch, coupling, load=0.1).indentation
    drops = [1 - forces(patch, coupling, load=0.1, thickness=t).indentation / free for t in (1.0, 10.0)]
    # -phi(0) P/(pi E* t) to first order in 1/t: 1.7702 * 0.1/(pi 4e6 t)
    assert drops[0] * free == pytest.approx(1.7702 * 0.1 / (np.pi * 4e6), rel=1e-2)
    assert drops[0] / drops[1] == pytest.approx(10, rel=1e-2)


@pytest.mark.parametrize("coupling", ["none", "asymptotic", "hertz", "full"])
def test_permutation_rotation_translation_and_float32(patch, coupling, rng):
    reference = forces(patch, coupling, load=0.1)
    order = rng.permutation(len(patch))
    np.testing.assert_allclose(
        forces(patch.iloc[order], coupling, load=0.1).force, reference.force[order], atol=TIGHT * 0.1
    )
    c, s = np.cos(0.7), np.sin(0.7)
    x, y = patch["x_m"] - MIDDLE[0], patch["y_m"] - MIDDLE[1]
    turned = patch.assign(x_m=c * x - s * y + 5e-3, y_m=s * x + c * y - 7e-3)
    moved = solve_interacting(turned, load=0.1, apex=(5e-3, -7e-3), coupling=coupling, **LENS)
    # shifting coordinates of 1e-2 m rounds distances of 1e-4 m by 1e-14 relative: heights by 1e-12 of D
    np.testing.assert_allclose(moved.force, reference.force, atol=TIGHT * 0.1)
    single = patch.astype(np.float32)
    np.testing.assert_array_equal(
        forces(single, coupling, load=0.1).force, forces(single.astype(float), coupling, load=0.1).force
    )


THREE = caps([0, 2e-4, 5e-4], [0, 1e-4, 0], [4e-5, 3.8e-5, 4.1e-5], [1e-4, 0.8e-4, 1.5e-4])


@functools.cache
def three_on_a_layer(coupling):
    return solve_interacting(THREE, load=5e-3, coupling=coupling, law="sphere", thickness=2e-3, **LENS)


@settings(max_examples=15, deadline=None)
@given(st.floats(-3, 3), st.floats(-5, 5), st.sampled_from(["asymptotic", "full"]))
def test_change_of_units(log_length, log_pressure, coupling):
    length, pressure = 10**log_length, 10**log_pressure
    base = three_on_a_layer(coupling)
    scaled = solve_interacting(
        THREE * length,
        load=5e-3 * pressure * length**2,
        coupling=coupling,
        law="sphere",
        thickness=2e-3 * length,
        indenter_radius=0.1288 * length,
        contact_modulus=4e6 * pressure,
    )
    np.testing.assert_allclose(scaled.force, base.force * pressure * length**2, rtol=TIGHT)
    np.testing.assert_allclose(scaled.radius, base.radius * length, rtol=TIGHT)


def test_load_sweep_equals_cold_starts(patch):
    loads = [0.01, 0.1, 0.0, 0.3]
    for load, warm in zip(loads, solve_loads(patch, loads=loads, apex=MIDDLE, **LENS), strict=True):
        cold = forces(patch, load=load)
        np.testing.assert_allclose(warm.force, cold.force, atol=TIGHT * 0.3)


@pytest.mark.parametrize("coupling", ["none", "full"])
def test_composite_summits_stand_for_the_table_under_their_lens(patch, coupling):
    summits = CompositeSummits.of(patch, indenter_radius=LENS["indenter_radius"], apex=MIDDLE)
    for load in (0.0, 1e-3, 0.2):
        prepared, plain = (forces(table, coupling, load=load) for table in (summits, patch))
        np.testing.assert_array_equal(prepared.force, plain.force)
        assert prepared.indentation == plain.indentation
    with pytest.raises(InputError, match="hand over the table"):
        solve_interacting(summits, load=0.2, apex=(0.0, 0.0), **LENS)
    with pytest.raises(InputError, match="same table of"):
        forces(patch, load=0.1, start=forces(patch.iloc[:-1], load=0.1))


def test_composite_apex_matters(patch):
    """Switch the correction off: caps under a flat with the lens's shape taken off their heights."""
    exact = forces(patch, load=0.1)
    r2 = (patch["x_m"] - MIDDLE[0]) ** 2 + (patch["y_m"] - MIDDLE[1]) ** 2
    naive = patch.assign(height_m=patch["height_m"] - r2 / (2 * 0.1288))
    plain = solve_interacting(naive, load=0.1, **FLAT)
    change = np.abs(plain.force - exact.force).sum() / 0.1
    assert 3e-4 < change < 3e-3


def test_contacts_table(patch):
    solution = forces(patch, load=0.5)
    table = solution.contacts("P")
    rows = solution.touching
    assert list(table["asperity"]) == list(rows)
    assert list(table["label"]) == list(range(1, len(rows) + 1))
    assert set(table["frame"]) == {"P"}
    np.testing.assert_array_equal(table["force_N"], solution.force[rows])
    np.testing.assert_allclose(table["area_m2"].sum(), solution.area, rtol=1e-12)
    beyond = solution.radius[rows] > 0.33 * solution.composite_radius[rows]
    np.testing.assert_array_equal((table["flags"] & int(Flag.BEYOND_HERTZ)) > 0, beyond)
    assert beyond.any()
    assert solution.validity.n_beyond_hertz == beyond.sum()
    assert any("beyond Hertz" in message for message in solution.validity.messages())


def test_overlap_and_touching_planes_are_reported():
    solution = solve_interacting(caps([0, 3e-5, 5e-4], height=5e-6), load=4e-3, **FLAT)
    assert solution.radius[0] + solution.radius[1] > 3e-5
    flags = solution.contacts()["flags"]
    assert [bool(f & Flag.OVERLAP) for f in flags] == [True, True, False]
    assert solution.validity.n_overlapping == 2
    assert solution.validity.planes_touch
    assert any("planes touch" in message for message in solution.validity.messages())


def test_nothing_touches():
    for prescribed in ({"load": 0.0}, {"indentation": 0.0}, {"indentation": -1e-6}):
        solution = solve_interacting(caps([0, 1e-3]), **prescribed, **FLAT)
        assert not solution.force.any()
        assert list(solution.contacts().columns)[:2] == ["frame", "label"]
        assert len(solution.contacts()) == 0
        assert solution.validity.n_contacts == 0
    assert solution.indentation == -1e-6
    assert len(solve_interacting(caps([]), load=0.0, **FLAT).contacts()) == 0


def test_refusals(patch):
    for options, text in (
        ({}, "exactly one of load and indentation"),
        ({"load": 1.0, "indentation": 1.0}, "exactly one"),
        ({"load": -1.0}, "load must not be negative"),
        ({"load": [1.0, 2.0]}, "load must be a number of N"),
        ({"load": np.nan}, "load must be finite"),
        ({"load": 1.0, "coupling": "strong"}, "coupling must be one of"),
        ({"load": 1.0, "law": "cone"}, "law must be one of"),
        ({"load": 1.0, "thickness": 0.0}, "thickness must be positive"),
        ({"load": 1.0, "contact_modulus": -1.0}, "contact_modulus must be"),
    ):
        with pytest.raises(InputError, match=text):
            forces(patch, **options)
    with pytest.raises(InputError, match="start must be a solution of the same table"):
        forces(patch, load=0.1, start=solve_interacting(caps([0.0]), load=0.1, **FLAT))
    with pytest.raises(InputError, match="table is empty"):
        solve_interacting(caps([]), load=1.0, **FLAT)
