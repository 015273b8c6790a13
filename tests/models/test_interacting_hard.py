"""Where the problem is nasty: converged within 30 Newton steps or an error that says why; never NaN."""

import numpy as np
import pandas as pd
import pytest

from contactimg import (
    ContactimgError,
    ConvergenceError,
    InputError,
    ModelRangeError,
    generate_asperities,
    solve_interacting,
)
from contactimg.models import contact_solver
from contactimg.models.fast_coupling import FastCoupling

COUPLINGS = ("none", "asymptotic", "hertz", "full")
FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}


def caps(x, y=0.0, height=4e-5, radius=1e-4):
    x = np.asarray(x, dtype=float)
    columns = {"x_m": x, "y_m": y, "height_m": height, "radius_m": radius}
    return pd.DataFrame({name: np.broadcast_to(np.asarray(v, float), x.shape) for name, v in columns.items()})


def lattice(pitch, *, hexagonal, size=12):
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    x = pitch * (column + (0.5 * (row % 2) if hexagonal else 0))
    return caps(x.ravel(), (pitch * row * (np.sqrt(3) / 2 if hexagonal else 1)).ravel())


def solved(table, **options):
    """A solution that is sound, in a dense check of its own equations for point forces."""
    solution = solve_interacting(table, **options)
    assert solution.iterations <= 30
    assert np.all(np.isfinite(solution.force))
    assert np.all((solution.force > 0) == (solution.radius > 0))
    if options.get("load") is not None:
        assert solution.load == pytest.approx(options["load"], rel=1e-10)
    return solution


@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("law", ["hertz", "sphere"])
@pytest.mark.parametrize("exponent", range(-15, 7, 3))
def test_any_load_on_one(coupling, law, exponent):
    assert solved(caps([1e-3]), load=10.0**exponent, coupling=coupling, law=law, **FLAT).touching.size == 1


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_any_load_on_a_pattern(coupling):
    table = generate_asperities("SA", side=3e-3, rng=np.random.default_rng(3))
    where = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (1.5e-3, 1.5e-3)}
    for exponent in np.arange(-15, 7, 1.5):
        try:
            solved(table, load=10.0**exponent, coupling=coupling, **where)
        except (ModelRangeError, ConvergenceError) as error:
            assert exponent > 1
            assert "overlap" in str(error)  # noqa: PT017


@pytest.mark.parametrize("coupling", ["asymptotic", "full"])
@pytest.mark.parametrize("modulus", [1.0, 1e4, 1e8, 1e12])
def test_any_modulus(coupling, modulus):
    table = generate_asperities("SA", side=3e-3, rng=np.random.default_rng(3))
    where = {"indenter_radius": 0.1288, "apex": (1.5e-3, 1.5e-3), "coupling": coupling}
    soft = solved(table, load=0.1, contact_modulus=4e6, **where)
    other = solved(table, load=0.1 * modulus / 4e6, contact_modulus=modulus, **where)
    np.testing.assert_allclose(other.radius, soft.radius, atol=1e-10 * soft.radius.max())


@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("hexagonal", [False, True])
def test_ties_on_lattices(coupling, hexagonal):
    table = lattice(2e-4, hexagonal=hexagonal)
    for load in (1e-9, 1e-3, 0.2, 2.0):
        force = solved(table, load=load, coupling=coupling, **FLAT).force
        if not hexagonal:  # the square keeps its eight symmetries
            square = force.reshape(12, 12)
            np.testing.assert_allclose(square, square.T, rtol=1e-9)
            np.testing.assert_allclose(square, square[::-1], rtol=1e-9)
    for depth in (1e-12, 1e-7, 2e-5):
        solved(table, indentation=depth, coupling=coupling, **FLAT)


@pytest.mark.parametrize("coupling", COUPLINGS[1:])
def test_duplicates_and_engulfed_asperities_are_named(coupling):
    with pytest.raises(ModelRangeError, match="rows 1 and 2 are at the same place"):
        solve_interacting(caps([1e-3, 0, 0]), load=1e-3, coupling=coupling, **FLAT)
    for r in (1e-12, 1e-9, 1e-6, 1e-5):
        for height in (4e-5, [4e-5, 3.9e-5]):
            with pytest.raises(ModelRangeError, match=r"rows 0 and 1, .* would overlap"):
                solve_interacting(caps([0, r], height=height), load=1e-3, coupling=coupling, **FLAT)


def test_duplicates_without_coupling_share_the_load():
    force = solved(caps([0, 0, 1e-3]), load=3e-3, coupling="none", **FLAT).force
    np.testing.assert_allclose(force, 1e-3, rtol=1e-10)


def test_pair_at_the_limit_of_uniqueness():
    """Two equal contacts become unstable where 2 a = pi r, that is r/a = 0.637."""
    where = {"coupling": "asymptotic", **FLAT}
    a = 2e-5
    # a(load) of the coupled pair at given load is Hertz's at half of it
    load = 2 * 4 / 3 * 4e6 * a**3 / 1e-4
    assert solved(caps([0, 0.645 * a]), load=load, **where).radius[0] == pytest.approx(a, rel=1e-9)
    with pytest.raises(ModelRangeError, match="rows 0 and 1"):
        solve_interacting(caps([0, 0.63 * a]), load=load, **where)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_radii_over_six_decades(coupling):
    rng = np.random.default_rng(8)
    radius = 10 ** rng.uniform(-7, -1, 200)
    x, y = rng.random((2, 200)) * 0.1
    solved(caps(x, y, rng.random(200) * 1e-6, radius), load=1e-4, coupling=coupling, **FLAT)
    solved(caps(x, y, 0.3 * radius, radius), load=1e-2, coupling=coupling, **FLAT)


@pytest.mark.parametrize("offset", [-1e-15, 0.0, 1e-15])
def test_grazing(offset):
    depth, r = 5e-6, 2e-4
    sag = 4 / 3 * np.sqrt(1e-4) * depth**1.5 / (np.pi * r)
    table = caps([0, r], height=[4e-5, 4e-5 - depth + sag + offset])
    solution = solved(table, indentation=depth, **FLAT)
    # 1e-15 m on top of rounding (heights of 4e-5 m are known to 7e-21 m)
    assert solution.penetration[1] == pytest.approx(offset, abs=2e-20)
    assert solution.radius[1] == pytest.approx(np.sqrt(1e-4 * max(offset, 0)), abs=2e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_crowds_converge_or_say_why(seed, coupling):
    rng = np.random.default_rng(seed)
    x, y = rng.random((2, 200)) * 2e-3
    table = caps(x, y, rng.normal(4e-5, 1e-6, 200), 3e-5)
    try:
        solved(table, load=10 ** rng.uniform(-4, 0), coupling=coupling, **FLAT)
    except ContactimgError as error:
        assert "overlap" in str(error)  # noqa: PT017


def test_indefinite_iterates_are_overcome():
    """A cold start whose first iterates overlap: tall asperities that later share the load."""
    table = lattice(6e-5, hexagonal=True)
    table.loc[[40, 41, 52, 53], "height_m"] += 3e-6
    solved(table, load=0.4, coupling="asymptotic", **FLAT)


def test_too_few_steps_is_an_error():
    table = generate_asperities("SA", side=3e-3, rng=np.random.default_rng(3))
    with pytest.raises(ConvergenceError, match=r"residual .* after 1 Newton steps, tolerance 1e-12"):
        solve_interacting(table, load=0.3, indenter_radius=0.1288, contact_modulus=4e6, max_iterations=1)


@pytest.mark.parametrize("law", ["hertz", "sphere"])
@pytest.mark.parametrize("thickness", [np.inf, 2e-3])
def test_screening_does_not_change_full_coupling(law, thickness, monkeypatch):
    """Asperities far from contact are left out of the field corrections, and nothing else changes."""
    table = generate_asperities("RA+", side=4e-3, rng=np.random.default_rng(914))
    where = {"indenter_radius": 0.013, "contact_modulus": 4e6, "load": 0.1, "apex": (2e-3, 2e-3)}
    options = {"coupling": "full", "law": law, "thickness": thickness}
    screened = solve_interacting(table, **where, **options)
    monkeypatch.setattr(contact_solver, "MIN_SCREENED_CANDIDATES", len(table) + 1)
    complete = solve_interacting(table, **where, **options)
    assert np.isneginf(screened.penetration).sum() > np.isneginf(complete.penetration).sum()
    np.testing.assert_array_equal(screened.touching, complete.touching)
    np.testing.assert_allclose(screened.force, complete.force, rtol=1e-10, atol=1e-12 * 0.1)
    assert screened.indentation == pytest.approx(complete.indentation, rel=1e-12)


def test_asperities_far_apart_on_a_thin_layer_do_not_fill_the_memory(rng):
    """Found by random problems: 300 asperities along 4 km of a layer of 0.2 m asked for 62 GB."""
    table = caps(rng.uniform(0, 4000, 300), height=30.0, radius=76.0)
    layered = FLAT | {"indentation": 2e-6, "thickness": 0.23, "coupling": "full"}
    with pytest.raises(InputError, match='use method "dense"'):
        solve_interacting(table, method="fast", **layered)
    assert np.all(np.isfinite(solve_interacting(table, method="dense", **layered).force))


def test_a_load_at_which_most_contacts_overlap_is_refused_at_once(monkeypatch):
    """Half the modulus as mean pressure: contacts that would merge take thousands of sums."""
    side, sums, exact = 0.03, [], FastCoupling.displacement
    pattern = generate_asperities("SA", side=side, coverage=0.3, rng=np.random.default_rng(5))
    where = {"indenter_radius": 1e5, "contact_modulus": 4e6, "apex": (side / 2, side / 2)}
    monkeypatch.setattr(FastCoupling, "displacement", lambda *a: sums.append(1) or exact(*a))
    with pytest.raises(ModelRangeError, match="would overlap a neighbour") as refused:
        solve_interacting(pattern, load=0.5 * 4e6 * side**2, **where)
    assert len(sums) <= 2
    bearable = float(str(refused.value).split("to some ")[1].split(" N")[0])
    assert 0.05 < bearable / (4e6 * side**2) < 0.5
    assert solve_interacting(pattern, load=0.3 * bearable, **where).status == "converged"
