"""Ensembles: reproducible whatever the number of workers, one pattern at a time, and what they average to."""

from functools import partial

import numpy as np
import pytest

from contactimg import (
    InputError,
    UniformHeights,
    draw_surface,
    solve_ensemble,
    solve_greenwood_tripp,
    solve_greenwood_williamson,
)

WHERE = {"side": 6e-3, "indenter_radius": 0.1288, "contact_modulus": 4e6, "loads": [0.02, 0.1]}


def run(patterns, **options):
    return list(solve_ensemble("SA", patterns=patterns, seed=3, **{**WHERE, **options}))


@pytest.mark.slow
def test_workers_do_not_change_the_answer():
    alone, together = run(4), run(4, workers=2)
    more = run(6)
    assert [member.index for member in together] == [0, 1, 2, 3]
    for one, two, three in zip(alone, together, more, strict=False):
        assert list(one.solutions) == list(two.solutions) == list(three.solutions)
        for key, solution in one.solutions.items():
            np.testing.assert_array_equal(solution.force, two.solutions[key].force)
            np.testing.assert_array_equal(solution.force, three.solutions[key].force)
    assert not np.array_equal(alone[0].solutions["none", 0.1].x, alone[1].solutions["none", 0.1].x)


def test_members_stream():
    stream = solve_ensemble("SA", patterns=10**9, seed=3, **WHERE)
    assert next(stream).index == 0
    stream.close()


def test_averages_are_those_of_the_statistical_models():
    """Uncoupled patterns average to Greenwood-Williamson, coupled ones come close to Greenwood-Tripp."""
    members = run(40)
    density = np.mean([m.solutions["none", 0.1].force.size for m in members]) / WHERE["side"] ** 2
    composite = 1e-4 * 0.1288 / (0.1288 + 1e-4)
    where = {
        "density": density,
        "radius": composite,
        "indenter_radius": 0.1288 + 1e-4,
        "contact_modulus": 4e6,
    }
    heights = UniformHeights(30e-6, 60e-6)
    for level, model, bias in (
        ("none", solve_greenwood_williamson, 0.01),
        ("asymptotic", solve_greenwood_tripp, 0.02),
    ):
        areas = np.array([m.solutions[level, 0.1].area for m in members])
        error = areas.std(ddof=1) / np.sqrt(len(members))
        # at a fixed load instead of a fixed indentation averages differ by the variance of the indentation
        assert abs(areas.mean() - model(heights, load=0.1, **where).area) < 4 * error + bias * areas.mean()


def test_refusals():
    with pytest.raises(InputError, match="patterns must not be negative"):
        run(-1)
    with pytest.raises(InputError, match="couplings must be among"):
        run(1, couplings=["strong"])


AREAS = {"loads": [0.01, 0.1], "side": 4e-3, "contact_modulus": 4e6, "seed": 2, "patterns": 6}


def areas_under(lens, kind="SA", **options):
    members = solve_ensemble(kind, indenter_radius=lens, **(AREAS | options))
    return np.array([solution.area for member in members for solution in member.solutions.values()])


def test_what_table_1_leaves_uncertain_widens_the_band():
    """The spread of the drawn parts adds to that of the patterns: variances of independent causes add up."""
    common = {"loads": [0.1], "patterns": 24, "couplings": ["asymptotic"]}
    nominal = areas_under(0.013, "RA-", **common)
    drawn = areas_under(0.013, partial(draw_surface, "RA-"), contact_modulus_std=0.8e6, **common)
    # A ~ E^-0.85 at a load: 20 % of the modulus alone are 17 % of the area
    assert nominal.std() / nominal.mean() < 0.06
    assert 0.08 < drawn.std() / drawn.mean() < 0.3


def test_drawn_surfaces_scatter_by_the_standard_errors_of_table_1():
    rng = np.random.default_rng(4)
    laws = [draw_surface("RA-", rng) for _ in range(400)]
    heights, radii = ([getattr(law, name) for law, _ in laws] for name in ("height_mean", "radius_mean"))
    # 2.4 and 12.8 um over the root of 293 asperities, 0.02; a standard deviation of 400 is known to 3.5 %
    for values, std in ((heights, 0.1402e-6), (radii, 0.7478e-6), ([c for _, c in laws], 0.02)):
        assert np.std(values) == pytest.approx(std, rel=0.15)
    angles = [np.degrees(draw_surface("RA+", rng)[0].contact_angle) for _ in range(400)]
    assert np.std(angles) == pytest.approx(2, rel=0.15)
    assert draw_surface("SA", rng) == draw_surface("SA", rng)
