"""Ensembles: reproducible whatever the number of workers, one pattern at a time, and what they average to."""

import numpy as np
import pytest

from contactimg import (
    InputError,
    UniformHeights,
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
