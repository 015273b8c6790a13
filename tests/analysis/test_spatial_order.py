"""Spatial order: counts by hand, the closed form of random points, false alarms, order that must be found."""

import numpy as np
import pytest
from scipy import stats

from contactimg import generate_asperities
from contactimg.analysis.spatial_order import (
    choose_in_rings,
    count_pairs,
    nearest_distances,
    pair_correlation,
    turn_points,
)
from contactimg.errors import InputError

LATTICE = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
EDGES = np.linspace(0.0, 0.3, 7)


def random_counts(count, points, rng):
    return np.array([count_pairs(rng.random((points, 2)), edges=EDGES) for _ in range(count)])


def test_pairs_of_a_lattice():
    # 3 x 3 points: 12 sides, 8 diagonals, 6 pairs two apart, 8 knight's moves, 2 long diagonals: 36 in all
    assert count_pairs(LATTICE, edges=[0, 1.2, 1.7, 2.1, 2.5, 3]).tolist() == [12, 8, 6, 8, 2]
    assert count_pairs(LATTICE, edges=[0.5, 1.2]).tolist() == [12]
    assert count_pairs(1e-6 * LATTICE, edges=[0, 1.2e-6]).tolist() == [12]  # change of units
    assert nearest_distances(LATTICE).tolist() == [1.0] * 9


def test_coincident_points_count():
    assert count_pairs([[0, 0], [0, 0], [1, 0]], edges=[0, 0.5, 2]).tolist() == [1, 2]
    assert nearest_distances([[0, 0], [0, 0]]).tolist() == [0.0, 0.0]


def test_few_points_have_no_pairs():
    assert count_pairs(np.empty((0, 2)), edges=[0, 1]).tolist() == [0]
    assert count_pairs([[1, 2]], edges=[0, 1]).tolist() == [0]
    with pytest.raises(InputError, match="two points at least"):
        nearest_distances([[1, 2]])


def test_random_points_have_the_distances_of_the_square(rng):
    """Two points of a unit square are nearer than r <= 1 with probability pi r^2 - 8/3 r^3 + r^4/2."""
    made = random_counts(100, 100, rng)
    share = np.diff(np.pi * EDGES**2 - 8 / 3 * EDGES**3 + EDGES**4 / 2)
    expected = 100 * 99 / 2 * share
    assert made.mean(axis=0) == pytest.approx(expected, rel=4 * (1 / np.sqrt(100 * expected)).max())
    found = pair_correlation(100 * expected, [made[k::20].sum(axis=0) * 20 for k in range(20)], edges=EDGES)
    assert found.table["correlation"].to_numpy() == pytest.approx(1.0, abs=0.03)  # g = 1


def test_random_points_raise_as_few_alarms_as_stated(rng):
    made = random_counts(400, 60, rng).reshape(20, 20, -1)  # of 20 patterns, one against 19
    p_values = [pair_correlation(part[0], part[1:], edges=EDGES).p_value for part in made]
    assert stats.kstest(p_values, "uniform").pvalue > 0.001
    outside = [
        not pair_correlation(part[0], part[1:], edges=EDGES).table.eval("low <= correlation <= high").all()
        for part in made
    ]
    assert stats.binomtest(sum(outside), len(outside), 0.05).pvalue > 0.001


def test_discs_without_overlap_are_found_apart(rng):
    pattern = generate_asperities("SA", side=2e-3, rng=rng)
    points = pattern[["x_m", "y_m"]].to_numpy()
    edges = np.linspace(0, 400e-6, 9)
    made = [count_pairs(2e-3 * rng.random(points.shape), edges=edges) for _ in range(99)]
    found = pair_correlation(count_pairs(points, edges=edges), made, edges=edges)
    assert found.p_value == 0.01
    g = found.table["correlation"]
    assert g[:2].tolist() == [0.0, 0.0]  # discs have radii of 71 um and more
    assert (g[:2] < found.table["low"][:2]).all()


def test_clusters_are_found(rng):
    parents = rng.random((20, 2))
    points = np.repeat(parents, 4, axis=0) + 0.01 * rng.standard_normal((80, 2))
    found = pair_correlation(count_pairs(points, edges=EDGES), random_counts(99, 80, rng), edges=EDGES)
    assert found.p_value == 0.01
    assert found.table["correlation"][0] > found.table["high"][0]


def test_turning_keeps_distances_and_nothing_else(rng):
    points = rng.random((50, 2))
    turned = turn_points(points, centre=(0.3, 0.2), rng=rng)
    away = [np.hypot(*(places - [0.3, 0.2]).T) for places in (points, turned)]
    assert away[1] == pytest.approx(away[0])
    assert not np.allclose(turned, points)


def test_choice_keeps_the_number_of_each_ring(rng):
    points = rng.uniform(-1, 1, (500, 2))
    touching = rng.random(500) < np.exp(-3 * np.hypot(*points.T))
    chosen = choose_in_rings(touching, points, centre=(0, 0), width=0.25, rng=rng)
    ring = (np.hypot(*points.T) / 0.25).astype(int)
    assert (np.bincount(ring, chosen) == np.bincount(ring, touching)).all()
    assert (chosen != touching).any()


def test_bad_input_is_refused(rng):
    with pytest.raises(InputError, match="two finite coordinates"):
        count_pairs([1.0, 2.0], edges=[0, 1])
    with pytest.raises(InputError, match="must increase"):
        count_pairs(LATTICE, edges=[1, 0])
    with pytest.raises(InputError, match="19 random"):
        pair_correlation([1.0], [[1.0]] * 5, edges=[0, 1])
    with pytest.raises(InputError, match="columns"):
        pair_correlation([1.0, 2.0], [[1.0]] * 30, edges=[0, 1])
    with pytest.raises(InputError, match="one value for each"):
        choose_in_rings([True], LATTICE, centre=(0, 0), width=1.0, rng=rng)
    with pytest.raises(InputError, match="width of a ring"):
        choose_in_rings([True] * 9, LATTICE, centre=(0, 0), width=0.0, rng=rng)
