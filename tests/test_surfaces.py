"""Asperity tables: the patterns, their check at the door, the composite plane."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.distance import pdist

from contactimg import (
    DropletCaps,
    GaussianCaps,
    InputError,
    UniformCaps,
    check_asperities,
    composite_apexes,
    generate_asperities,
)
from contactimg.surfaces import base_radius


@pytest.mark.parametrize(("kind", "coverage"), [("SA", 0.4), ("SA", 0.1), ("RA-", 0.34), ("RA+", 0.41)])
def test_patterns_cover_without_overlap(kind, coverage, rng):
    side = 2e-3
    table = generate_asperities(kind, side=side, coverage=coverage, rng=rng)
    disc = base_radius(table["height_m"], table["radius_m"])
    x, y = table["x_m"].to_numpy(), table["y_m"].to_numpy()
    reach = pdist(disc[:, None], metric=lambda a, b: a[0] + b[0]) if len(table) < 200 else None
    gaps = pdist(np.column_stack([x, y]))
    if reach is None:
        i, j = np.triu_indices(len(table), 1)
        reach = disc[i] + disc[j]
    assert np.all(gaps >= reach * (1 - 1e-12))
    assert np.all((x >= disc) & (x <= side - disc) & (y >= disc) & (y <= side - disc))
    assert np.all(np.diff(disc) <= 0)
    # the count is rounded to the nearest: half of the last disc drawn, at most half of the largest
    assert abs(np.pi * np.sum(disc**2) - coverage * side**2) <= 0.5 * np.pi * disc.max() ** 2 * (1 + 1e-9)


def test_patterns_follow_their_laws():
    rng = np.random.default_rng(5)
    sa = generate_asperities("SA", side=2e-2, rng=rng)
    n = len(sa)
    assert set(sa["radius_m"]) == {100e-6}
    # mean of a uniform law of width 30 um: standard error 30/sqrt(12 n); four of them
    assert abs(sa["height_m"].mean() - 45e-6) < 4 * 30e-6 / np.sqrt(12 * n)
    ra = generate_asperities("RA-", side=1e-2, rng=rng)
    m = len(ra)
    assert abs(ra["height_m"].mean() - 9.0e-6) < 4 * 2.4e-6 / np.sqrt(m)
    assert abs(ra["radius_m"].mean() - 49.6e-6) < 4 * 12.8e-6 / np.sqrt(m)
    assert abs(np.corrcoef(ra["height_m"], ra["radius_m"])[0, 1]) < 4 / np.sqrt(m)
    plus = generate_asperities("RA+", side=1e-2, rng=rng)
    np.testing.assert_allclose(plus["height_m"] / plus["radius_m"], 1 - np.cos(np.radians(57)), rtol=1e-12)


def test_same_seed_same_pattern():
    one, two = (generate_asperities("SA", side=3e-3, rng=np.random.default_rng(9)) for _ in range(2))
    pd.testing.assert_frame_equal(one, two)


@pytest.mark.parametrize(
    ("kind", "coverage", "law"),
    [
        ("SA", 0.4, UniformCaps(30e-6, 60e-6, radius=100e-6)),
        ("RA-", 0.34, GaussianCaps(9.0e-6, 2.4e-6, radius_mean=49.6e-6, radius_std=12.8e-6)),
        ("RA+", 0.41, DropletCaps(29.6e-6, 10.1e-6, contact_angle=np.radians(57))),
    ],
)
def test_a_named_surface_is_its_law(kind, coverage, law):
    named, lawful = (
        generate_asperities(surface, side=1e-3, coverage=coverage, rng=np.random.default_rng(4))
        for surface in (kind, law)
    )
    pd.testing.assert_frame_equal(named, lawful)


def test_caps_of_a_law_are_caps(rng):
    height, radius = GaussianCaps(9e-6, 9e-6, radius_mean=12e-6, radius_std=12e-6).draw(1000, rng)
    assert np.all(height > 0)  # a sixth of the normal law lies below zero
    assert np.all(radius > height)


def test_laws_refuse_what_is_no_cap(rng):
    with pytest.raises(InputError, match="0 <= height_low < height_high"):
        UniformCaps(6e-5, 3e-5, radius=1e-4)
    with pytest.raises(InputError, match="radius must be positive and finite"):
        UniformCaps(3e-5, 6e-5, radius=0.0)
    with pytest.raises(InputError, match="height_std must be positive"):
        DropletCaps(3e-5, -1e-5, contact_angle=1.0)
    with pytest.raises(InputError, match="contact_angle must lie below pi"):
        DropletCaps(3e-5, 1e-5, contact_angle=57.0)
    with pytest.raises(InputError, match="height_mean below radius_mean"):
        GaussianCaps(5e-5, 1e-5, radius_mean=4e-5, radius_std=1e-5)
    with pytest.raises(InputError, match="coverage must be given"):
        generate_asperities(UniformCaps(3e-5, 6e-5, radius=1e-4), side=1e-3, rng=rng)


def test_places_are_uniform(rng):
    x = np.concatenate(
        [generate_asperities("SA", side=1e-2, coverage=0.05, rng=rng)["x_m"] for _ in range(5)]
    )
    counts = np.histogram(x, bins=5, range=(0, 1e-2))[0]
    expected = x.size / 5
    # counts vary by sqrt(n); the edge keeps discs of up to 92 um out: 1 % of the area of the outer bins
    assert np.all(np.abs(counts - expected) < 4 * np.sqrt(expected) + 0.03 * expected)


def test_what_cannot_be_placed_is_said(rng):
    with pytest.raises(InputError, match=r"coverage 0\.9 cannot be reached"):
        generate_asperities("SA", side=2e-3, coverage=0.9, rng=rng, max_tries=200)
    with pytest.raises(InputError, match="kind must be one of"):
        generate_asperities("SB", side=2e-3, rng=rng)
    with pytest.raises(InputError, match="coverage must lie between"):
        generate_asperities("SA", side=2e-3, coverage=1.5, rng=rng)
    with pytest.raises(InputError, match="cannot be reached"):
        generate_asperities("SA", side=1e-4, rng=rng)


def table(**columns):
    base = {"x_m": [0.0, 1e-3], "y_m": [0.0, 0.0], "height_m": [4e-5, 3e-5], "radius_m": [1e-4, 2e-4]}
    return pd.DataFrame({**base, **columns})


def test_check_names_row_and_column():
    with pytest.raises(InputError, match=r"row 1, column 'height_m' must be finite"):
        check_asperities(table(height_m=[1e-5, np.nan]))
    with pytest.raises(InputError, match=r"row 0, column 'radius_m' must be positive, got -1"):
        check_asperities(table(radius_m=[-1.0, 1.0]))
    with pytest.raises(InputError, match=r"row 1, column 'x_m' must be a number, got 'abc'"):
        check_asperities(table(x_m=["1e-3", "abc"]))
    with pytest.raises(InputError, match="column 'y_m' is missing"):
        check_asperities(table().drop(columns="y_m"))
    with pytest.raises(InputError, match="must be a DataFrame"):
        check_asperities([1, 2, 3])


def test_composite_is_the_highest_point_of_cap_minus_lens():
    """Against a search of the maximum of h - |s - x|^2/(2 R) - |s|^2/(2 Rl)."""
    lens, apex = 9e-3, (2e-4, -3e-4)
    caps = table(x_m=[1e-3, -7e-4], y_m=[5e-4, 2e-4])
    found = composite_apexes(caps, indenter_radius=lens, apex=apex)
    for (_, cap), (_, top) in zip(caps.iterrows(), found.iterrows(), strict=True):

        def surface(x, y, cap=cap):
            bump = ((x - cap.x_m) ** 2 + (y - cap.y_m) ** 2) / (2 * cap.radius_m)
            return cap.height_m - bump - ((x - apex[0]) ** 2 + (y - apex[1]) ** 2) / (2 * lens)

        step = 1e-5
        height = surface(top.x_m, top.y_m)
        assert top.height_m == pytest.approx(height, abs=1e-18)
        around = [
            surface(top.x_m + step * np.cos(t), top.y_m + step * np.sin(t)) for t in np.arange(0, 6, 0.5)
        ]
        # equal drops all around: the summit, and its curvature; rounding 1e-20 over a drop of 5e-7
        np.testing.assert_allclose(height - np.array(around), step**2 / (2 * top.radius_m), rtol=1e-10)


def test_asperities_beside_the_indenter_are_refused():
    caps = pd.DataFrame({"x_m": [1.4, 1.5], "y_m": 0.0, "height_m": 4e-5, "radius_m": 1e-4})
    with pytest.raises(InputError, match=r"nearest is 1.4 m from its apex .* check x_m, y_m and the apex"):
        composite_apexes(caps, indenter_radius=0.1288)
    assert len(composite_apexes(caps, indenter_radius=np.inf)) == 2
    assert len(composite_apexes(caps, indenter_radius=0.1288, apex=(1.4, 0.0))) == 2


def test_composite_under_a_flat_is_the_cap():
    caps = table()
    pd.testing.assert_frame_equal(composite_apexes(caps, indenter_radius=np.inf, apex=(3.0, 4.0)), caps)
    with pytest.raises(InputError, match="indenter_radius must be positive"):
        composite_apexes(caps, indenter_radius=0.0)
    with pytest.raises(InputError, match="apex must be two finite"):
        composite_apexes(caps, indenter_radius=1.0, apex=(np.nan, 0.0))
