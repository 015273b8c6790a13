"""The apex of the lens as contacts show it: exact solutions, a cut field of view, and what shows none."""

import numpy as np
import pytest

from contactimg.models.interacting import solve_interacting
from contactimg.plausibility import doubts_about_match
from contactimg.pose.apex import Apex, find_apex, find_centre
from contactimg.scene import scene_from_dict
from contactimg.surfaces import composite_apexes, generate_asperities

APEX = (4.6e-3, 5.3e-3)
LENS = 0.1288


def everywhere(x, _y):
    return np.ones(np.shape(x), bool)


@pytest.fixture(scope="module")
def pressed():
    """Position, height, composite radius and contact radius of the asperities in contact."""
    table = generate_asperities("SA", side=0.01, coverage=0.4, rng=np.random.default_rng(5))
    solution = solve_interacting(table, indenter_radius=LENS, contact_modulus=4e6, load=0.2, apex=APEX)
    radii = np.asarray(solution.radius)
    touching = radii > 0
    composite = composite_apexes(table, indenter_radius=LENS, apex=APEX)["radius_m"].to_numpy()
    columns = (table[["x_m", "y_m"]].to_numpy(), table["height_m"].to_numpy(), composite, radii)
    return [column[touching] for column in columns]


def test_the_contacts_of_a_coupled_solution_show_apex_and_lens(pressed):
    found = find_apex(*pressed, in_view=everywhere)
    # the sites of a cap lie R/(R + Rl) = 8e-4 of its distance from the apex nearer to it: 2e-6 m at 2.5 mm
    assert np.hypot(*np.subtract(found.place, APEX)) < 2e-6
    assert found.radius == pytest.approx(LENS + 1e-4, rel=2e-3)  # lens and cap together
    assert found.known == "found from the contacts"


def test_forces_of_the_other_contacts_are_needed(pressed):
    points, heights, radii, a = pressed
    alone = find_apex(points, heights, radii, a, in_view=everywhere)
    far = find_apex(
        points * 1e3, heights, radii, a, in_view=everywhere
    )  # so far apart that no contact lowers another
    assert abs(far.radius / 1e6 / alone.radius - 1) > 0.05


def test_apex_and_lens_are_within_their_uncertainties_where_contacts_lower_each_other(rng):
    """Errors of a radius also change what the other contacts are lowered by."""
    table = generate_asperities("RA-", side=0.004, rng=np.random.default_rng(8))
    apex, lens = (2.1e-3, 1.9e-3), 0.03
    solution = solve_interacting(table, indenter_radius=lens, contact_modulus=4e6, load=0.05, apex=apex)
    a = np.asarray(solution.radius)
    touching = a > 3e-6
    composite = composite_apexes(table, indenter_radius=lens, apex=apex)["radius_m"].to_numpy()
    columns = (table[["x_m", "y_m"]].to_numpy(), table["height_m"].to_numpy(), composite, a)
    points, heights, radii, a = (column[touching] for column in columns)
    pulls = []
    for _ in range(100):
        found = find_apex(points, heights, radii, a * rng.normal(1, 0.02, a.size), in_view=everywhere)
        pulls.append([*np.subtract(found.place, apex) / found.std, (found.radius - lens) / found.radius_std])
    # of 100 each, 1 +- 0.07; independent errors of the gaps would give two to five times too little
    assert np.sqrt(np.mean(np.square(pulls)[:, :2])) < 1.3
    assert np.std(pulls, axis=0)[2] < 1.3


@pytest.mark.parametrize("cut", [4.2e-3, 4.8e-3])
def test_a_region_that_the_view_cuts_is_within_its_uncertainty(pressed, cut):
    points = pressed[0]
    seen = points[:, 0] > cut
    found = find_apex(*(column[seen] for column in pressed), in_view=lambda x, _y: x > cut)
    assert np.hypot(*np.subtract(found.place, APEX)) < 3 * np.hypot(*found.std)
    assert np.hypot(*found.std) < 2e-4
    # so is the radius of the lens; at the second cut it is off by seven times its statistical error
    assert abs(found.radius - LENS - 1e-4) < 3 * found.radius_std < 0.3 * LENS


@pytest.mark.parametrize(
    "view",
    [
        lambda x, y: (x > APEX[0] + 1e-4) & (y > APEX[1] + 1e-4),
        lambda x, y: (x > APEX[0] - 3e-4) & (y > APEX[1] - 3e-4),
        lambda x, _y: x > APEX[0] + 6e-4,
    ],
    ids=["corner", "quarter", "apex out of view"],
)
def test_a_view_of_a_smaller_part_of_the_region_is_within_its_uncertainty(pressed, view):
    seen = view(*pressed[0].T)
    found = find_apex(*(column[seen] for column in pressed), in_view=view)
    assert (np.abs(np.subtract(found.place, APEX)) < 2.5 * np.array(found.std)).all()
    assert np.hypot(*found.std) < 5e-4


def test_few_contacts_and_a_gap_that_does_not_open_show_none(pressed):
    assert find_apex(*(column[:9] for column in pressed), in_view=everywhere) is None
    points, _, radii, a = pressed
    bowl = np.sum((points - np.array(APEX)) ** 2, axis=1) / (2 * LENS)
    assert find_apex(points, -2 * bowl, radii, 1e-3 * a, in_view=everywhere) is None


@pytest.mark.parametrize(("cut", "shown"), [(-1.0, 300), (-0.5, 0)])
def test_without_asperities_the_contacts_show_the_centre_of_a_region_that_is_in_view(cut, shown, rng):
    errors = []
    for _ in range(300):
        r, turn = np.sqrt(rng.uniform(0, 1, 200)), rng.uniform(0, 2 * np.pi, 200)
        points = np.column_stack([r * np.cos(turn), r * np.sin(turn)])
        areas = np.maximum(1 - r**2, 0) * rng.uniform(0.2, 1, 200) ** 2
        seen = points[:, 0] > cut
        found = find_centre(points[seen], areas[seen], in_view=lambda x, _y: x > 1.001 * cut)
        errors += [] if found is None else (np.array(found.place) / found.std).tolist()
    assert len(errors) == 2 * shown
    if shown:
        # 68 and 95 % of 600 components, each within four standard deviations (theory: binomial)
        assert abs(np.mean(np.abs(errors) < 1) - 0.683) < 4 * 0.019
        assert abs(np.mean(np.abs(errors) < 2) - 0.954) < 4 * 0.0086


def test_in_a_dense_pattern_the_apex_that_the_contacts_show_decides(pressed):
    found, spacing = find_apex(*pressed, in_view=everywhere), 2.3e-4
    counts = {"measured": 160, "predicted": 160, "matched": 130, "shown": found, "spacing": spacing}
    for away, count in ((0.3 * spacing, 0), (2 * spacing, 1)):
        scene = scene_from_dict({"indenter": {"radius_m": LENS, "apex_m": (APEX[0] + away, APEX[1])}})
        assert len(list(doubts_about_match(scene, **counts))) == count


def test_a_mismatch_names_its_likely_cause():
    scene = scene_from_dict({"indenter": {"radius_m": LENS}})
    shown = Apex(APEX, (1e-6, 1e-6), "found from the contacts", LENS, 1e-5)
    counts = {"measured": 100, "predicted": 90, "matched": 10}
    assert (
        "apex_m, or the centre of the calibration used: the contacts show the apex at (0.0046, 0.0053) m"
        in next(doubts_about_match(scene, **counts, shown=shown))
    )
    right = scene_from_dict({"indenter": {"radius_m": 2 * LENS, "apex_m": APEX}})
    assert "a lens of 0.129 m" in next(doubts_about_match(right, **counts, shown=shown))
    assert "mirrored" in next(doubts_about_match(right, **counts, shown=None))
    assert "grams" in next(doubts_about_match(right, measured=100, predicted=300, matched=90, shown=None))
    assert list(doubts_about_match(scene, measured=100, predicted=90, matched=60, shown=shown)) == []
