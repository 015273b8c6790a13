"""Matching: one-to-one pairs, and the pose from contacts alone."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from contactimg.errors import InputError
from contactimg.pose import Pose
from contactimg.pose.fit import fit_pose
from contactimg.pose.pairs import match_contacts, pair_points
from contactimg.tables import CONTACTS

SHAPE = (1200, 1600)
SHIFT = 3e-4


@pytest.fixture
def asperities(rng):
    """Points on 1 cm^2 at the density of SA+, not closer than 140 um."""
    kept = np.empty((0, 2))
    for point in rng.uniform(0, 0.01, size=(6000, 2)):
        if len(kept) == 0 or np.min(np.linalg.norm(kept - point, axis=1)) > 140e-6:
            kept = np.vstack([kept, point])
    return kept[:1800]


def seen(asperities, pose, rng, *, radius=3.3e-3, share=0.6, jitter_px=0.0):
    """Pixel positions of a random share of the asperities within a radius of the middle."""
    inside = np.linalg.norm(asperities - 0.005, axis=1) < radius
    chosen = asperities[inside & (rng.random(len(asperities)) < share)]
    x, y = pose.to_pixels(*chosen.T)
    return x + jitter_px * rng.standard_normal(len(x)), y + jitter_px * rng.standard_normal(len(y))


def brute_force_cost(points, targets, limit):
    """Least cost over all one-to-one assignments, by trying them all."""
    if len(points) == 0:
        return 0.0
    rest = brute_force_cost(points[1:], targets, limit) + limit**2
    for k, target in enumerate(targets):
        squared = float(np.sum((points[0] - target) ** 2))
        if squared <= limit**2:
            others = np.delete(targets, k, axis=0)
            rest = min(rest, squared + brute_force_cost(points[1:], others, limit))
    return rest


def test_pairs_have_the_least_cost_of_all_assignments(rng):
    for _ in range(20):
        points, targets = rng.random((5, 2)), rng.random((4, 2))
        _, _, distance = pair_points(points, targets, max_distance=0.4)
        cost = np.sum(distance**2) + 0.4**2 * (len(points) - len(distance))
        assert cost == pytest.approx(brute_force_cost(points, targets, 0.4), rel=1e-12)


@pytest.mark.parametrize("limit", [1.0, 1e6, np.inf])
def test_a_limit_far_beyond_all_distances_does_not_blur_them(limit, rng):
    places, order = rng.uniform(0, 1e-4, (40, 2)), rng.permutation(40)
    i, j, distance = pair_points(places, places[order] + 1e-7, max_distance=limit)
    assert len(i) == 40
    np.testing.assert_array_equal(order[j], i)
    np.testing.assert_allclose(distance, np.sqrt(2) * 1e-7, rtol=1e-6)


@pytest.mark.parametrize("limit", [None, 1e-5])
@pytest.mark.parametrize("side", [0, 1])
def test_a_contact_without_a_place_is_refused_on_either_side(side, limit):
    tables = [pd.DataFrame({"x_m": [0.0, 1e-4], "y_m": 0.0, "radius_m": 1e-5}) for _ in range(2)]
    tables[side].loc[1, "x_m"] = np.nan
    with pytest.raises(InputError, match="each contact needs its place"):
        match_contacts(*tables, max_distance=limit)


def test_a_pose_needs_finite_places():
    guess = Pose(SHAPE, 6e-6, (0.0, 0.0))
    with pytest.raises(InputError, match="finite x_px, y_px and targets, got nan"):
        fit_pose([1.0, np.nan, 7.0], [1.0, 2.0, 3.0], np.eye(4, 2), guess, largest_shift=1e-4)


def test_pairs_are_one_to_one_and_within_reach(rng):
    points, targets = rng.random((200, 2)), rng.random((150, 2))
    i, j, distance = pair_points(points, targets, max_distance=0.05)
    assert len(set(i)) == len(i)
    assert len(set(j)) == len(j)
    assert distance.max() <= 0.05


def test_no_points_or_no_targets_is_no_pair():
    assert [len(part) for part in pair_points([], [[0, 0]], max_distance=1)] == [0, 0, 0]
    assert [len(part) for part in pair_points([[0, 0]], [], max_distance=1)] == [0, 0, 0]


@pytest.mark.parametrize("mirrored", [False, True])
def test_pose_round_trip(mirrored, rng):
    pose = Pose(SHAPE, 6e-6, (0.004, 0.0061), 0.3, mirrored)
    x, y = rng.uniform(0, 0.01, (2, 50))
    back = pose.to_sample(*pose.to_pixels(x, y))
    np.testing.assert_allclose(back, [x, y], atol=1e-15)


def test_pose_conventions_on_a_non_square_image():
    pose = Pose((100, 300), 1e-6, (0.0, 0.0))
    x_px, y_px = pose.to_pixels([10e-6, 0], [0, 10e-6])
    np.testing.assert_allclose(x_px, [149.5 + 10, 149.5])  # +x to the right
    np.testing.assert_allclose(y_px, [49.5, 49.5 + 10])  # +y down
    assert replace(pose, mirrored=True).to_pixels(0, 10e-6)[1] == pytest.approx(49.5 - 10)
    turned = replace(pose, rotation=np.pi / 2).to_pixels(10e-6, 0)
    np.testing.assert_allclose(turned, [149.5, 49.5 + 10])  # +x turns towards +y


@pytest.mark.parametrize("pixel_size", [0.0, -1e-6, np.nan, 6.0])
def test_pose_refuses_a_pixel_size_that_is_no_length(pixel_size):
    with pytest.raises(InputError, match="pixel size must be a positive length"):
        Pose(SHAPE, pixel_size)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("spurious", [0, 20])
def test_pose_is_found_from_contacts_alone(asperities, rng, mirrored, spurious):
    truth = Pose(SHAPE, 6e-6 * 1.01, (0.00503, 0.00497), np.deg2rad(0.5), mirrored)
    guess = Pose(SHAPE, 6e-6, (0.005, 0.005))
    x_px, y_px = seen(asperities, truth, rng, jitter_px=0.1)
    x_px = np.append(x_px, rng.uniform(0, 1599, spurious))
    y_px = np.append(y_px, rng.uniform(0, 1199, spurious))
    fit = fit_pose(x_px, y_px, asperities, guess, largest_shift=SHIFT)
    assert fit.fitted
    assert fit.pose.mirrored is mirrored
    # similarity through n pairs of scatter s: shift s sqrt(2/n), rotation and scale s/(arm sqrt(n))
    n = fit.n_matched
    assert n >= len(x_px) - spurious
    scatter, arm = 0.1 * 6e-6, 2.2e-3
    assert np.hypot(*np.subtract(fit.pose.centre, truth.centre)) < 5 * scatter * np.sqrt(2 / n)
    assert abs(fit.pose.rotation - truth.rotation) < 5 * scatter / arm / np.sqrt(n)
    assert abs(fit.pose.pixel_size / truth.pixel_size - 1) < 5 * scatter / arm / np.sqrt(n)


def test_a_patch_of_dirt_does_not_hide_the_pose(asperities, rng):
    truth = Pose(SHAPE, 6e-6, (0.00503, 0.00497), np.deg2rad(0.5))
    x_px, y_px = seen(asperities, truth, rng, jitter_px=0.1)
    dirt = rng.uniform(200, 260, (2, 60))  # denser than the contacts
    everywhere = np.append(x_px, dirt[0]), np.append(y_px, dirt[1])
    fit = fit_pose(*everywhere, asperities, Pose(SHAPE, 6e-6, (0.005, 0.005)), largest_shift=SHIFT)
    assert fit.n_matched >= len(x_px)
    assert fit.pose.rotation == pytest.approx(truth.rotation, abs=1e-5)


def test_pose_at_the_far_corner_of_the_search(asperities, rng):
    truth = Pose(SHAPE, 6e-6 * 0.975, (0.0052, 0.0048), np.deg2rad(-2.8))
    x_px, y_px = seen(asperities, truth, rng, share=0.15)
    fit = fit_pose(x_px, y_px, asperities, Pose(SHAPE, 6e-6, (0.005, 0.005)), largest_shift=SHIFT)
    assert fit.pose.rotation == pytest.approx(truth.rotation, abs=1e-9)
    assert fit.residual < 1e-12


def test_guess_is_kept_when_points_have_nothing_to_do_with_the_asperities(asperities, rng):
    guess = Pose(SHAPE, 6e-6, (0.005, 0.005))
    fit = fit_pose(*rng.uniform(0, 1000, (2, 150)), asperities, guess, largest_shift=SHIFT)
    assert not fit.fitted
    assert fit.pose == guess


@pytest.mark.parametrize("n", [0, 1, 2])
def test_guess_is_kept_with_too_few_points(asperities, n):
    guess = Pose(SHAPE, 6e-6, (0.005, 0.005))
    fit = fit_pose(np.arange(n), np.arange(n), asperities, guess, largest_shift=SHIFT)
    assert (fit.fitted, fit.pose, fit.n_matched) == (False, guess, 0)


def test_few_contacts_replace_the_guess_only_if_so_many_matches_are_no_chance(asperities, rng):
    # by chance a contact falls on one of 18 asperities per mm^2 with a probability of 2 %, and hundreds of
    # shifts are tried near the guess: matches of four may be chance, those of eight are none
    truth, guess = Pose(SHAPE, 6e-6, (0.0051, 0.0049)), Pose(SHAPE, 6e-6, (0.005, 0.005))
    x_px, y_px = truth.to_pixels(*asperities[np.argsort(np.hypot(*(asperities - 0.005).T))[:8]].T)
    for count, fitted in ((4, False), (8, True)):
        fit = fit_pose(x_px[:count], y_px[:count], asperities, guess, largest_shift=SHIFT)
        assert fit.fitted is fitted
        assert fit.pose.centre == pytest.approx((truth if fitted else guess).centre, abs=1e-8)


def test_a_symmetric_lattice_keeps_the_guessed_mirror():
    lattice = np.stack(np.meshgrid(np.arange(9), np.arange(7)), -1).reshape(-1, 2) * 2.5e-3
    truth = Pose((480, 640), 6e-5, (10e-3, 7.5e-3), 0.01)
    x_px, y_px = truth.to_pixels(*lattice.T)
    fit = fit_pose(x_px, y_px, lattice, replace(truth, rotation=0.0), largest_shift=1e-3)
    assert fit.pose.mirrored is False
    assert fit.pose.rotation == pytest.approx(0.01, abs=1e-9)


def contacts(x, y, radius=1e-5):
    n = len(x)
    return CONTACTS.conform(
        {
            "frame": ["f"] * n,
            "label": range(1, n + 1),
            "x_m": x,
            "y_m": y,
            "radius_m": [radius] * n,
            "asperity": range(n),
        }
    )


def test_match_contacts_names_label_and_asperity():
    measured, predicted = contacts([0.0, 1e-3], [0.0, 0.0]), contacts([1.001e-3, 5e-3, 1e-6], [0.0, 0.0, 0.0])
    matches = match_contacts(measured, predicted, max_distance=1e-5)
    assert matches["measured_label"].tolist() == [1, 2]
    assert matches["asperity"].tolist() == [2, 0]
    np.testing.assert_allclose(matches["distance_m"], [1e-6, 1e-6])


def test_match_contacts_of_empty_tables_is_an_empty_table():
    assert len(match_contacts(CONTACTS.empty(), contacts([0.0], [0.0]))) == 0
    assert len(match_contacts(contacts([0.0], [0.0]), CONTACTS.empty())) == 0


def test_match_contacts_refuses_a_negative_distance():
    with pytest.raises(InputError, match="max_distance must be a positive length"):
        match_contacts(contacts([0.0], [0.0]), contacts([0.0], [0.0]), max_distance=-1.0)


def test_tables_made_by_hand_need_no_more_than_places():
    named = {"mine": ["a", "b"], "flags": ["BEYOND_HERTZ", ""]}
    measured = pd.DataFrame({"x_m": [0, 1e-3], "y_m": [0, 0]} | named, index=[7, 3])
    pairs = match_contacts(measured, measured.iloc[::-1], max_distance=1e-4)
    assert pairs["distance_m"].tolist() == [0, 0]
    assert pairs["measured_label"].isna().all()
    for wrong in (measured.assign(x_m=[0, np.nan]), measured.drop(columns="y_m")):
        with pytest.raises(InputError, match="place"):
            match_contacts(wrong, measured)
