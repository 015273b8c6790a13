"""Contacts below the detection limit: what they add, and how well that is known."""

import numpy as np
import pandas as pd
import pytest
from frame_sums import unseen_area, unseen_force
from scipy import integrate, stats

from contactimg.forces import NOTHING, fill_forces
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA
from contactimg.scene import scene_from_dict
from contactimg.tables import CONTACTS, FRAMES


def drawn(density, rng, *, slope=0.0):
    """Contacts with u = a^2 even (or falling) from 0 to 30, of which those below u = 1 are hardly found."""
    u = 30 * rng.random(rng.poisson(30 * density))
    u = u[rng.random(len(u)) < 1 - slope * u]
    found = rng.random(len(u)) < stats.norm.cdf(FALSE_ALARM_SIGMA * (u - 1))
    table = pd.DataFrame({"radius_m": np.sqrt(u), "force_N": 2 * u**1.5})
    return table[found], table[~found]


def test_of_an_even_density_the_integral_of_what_is_missed_is_estimated():
    u = np.arange(1.5, 30, 1e-3)  # a thousand contacts per unit of u, dense enough that chance is no matter
    found = pd.DataFrame({"radius_m": np.sqrt(u), "force_N": 2 * u**1.5})
    for total, power, factor in ((unseen_area, 1.0, np.pi), (unseen_force, 1.5, 2.0)):
        missed, _ = integrate.quad(lambda x, p=power: x**p * stats.norm.sf(FALSE_ALARM_SIGMA * (x - 1)), 0, 3)
        # fourth order of the moment: 3/6^4 = 2e-3; half a contact of the prior: 1e-4
        assert total(found, 1.0).value == pytest.approx(1e3 * factor * missed, rel=3e-3)


@pytest.mark.parametrize(("density", "slope"), [(20, 0.0), (3, 0.0), (40, 0.03)])
def test_what_was_missed_is_estimated_with_its_uncertainty(density, slope, rng):
    errors, inside = [], []
    for _ in range(60):
        found, missed = drawn(density, rng, slope=slope)
        area, force = unseen_area(found, 1.0), unseen_force(found, 1.0)
        true_area, true_force = np.pi * (missed["radius_m"] ** 2).sum(), missed["force_N"].sum()
        errors.append(area.value - true_area)
        inside.append((abs(errors[-1]) < 2 * area.std, abs(force.value - true_force) < 2 * force.std))
    # unbiased within 40 % of what is missing, 0.51 pi density
    assert abs(np.mean(errors)) < 0.4 * 0.51 * np.pi * density
    # 95 % of 60 are 57; 49 or fewer have a probability below 1e-3
    assert np.sum(inside, axis=0).min() >= 50


@pytest.mark.parametrize(
    "fall", [lambda rng, n: rng.exponential(2.0, n), lambda rng, n: np.abs(rng.normal(0.0, 2.5, n))]
)
def test_where_few_contacts_are_large_those_below_the_limit_are_not_underestimated(fall, rng):
    """Of small caps at a low load most contacts are missed: a straight line falls short of them."""
    errors, inside = [], []
    for _ in range(60):
        u = fall(rng, 400)
        found = rng.random(len(u)) < stats.norm.cdf(FALSE_ALARM_SIGMA * (u - 1))
        table = pd.DataFrame({"radius_m": np.sqrt(u), "force_N": 2 * u**1.5})
        area, true = unseen_area(table[found], 1.0), np.pi * u[~found].sum()
        errors.append(area.value / true - 1)
        inside.append(abs(area.value - true) < 2 * area.std)
    assert abs(np.mean(errors)) < 0.4
    assert sum(inside) >= 50  # as above


def test_units():
    found, _ = drawn(10, np.random.default_rng(1))
    scaled = found.assign(radius_m=1e-6 * found["radius_m"], force_N=1e-3 * found["force_N"])
    area, force = unseen_area(scaled, 1e-6), unseen_force(scaled, 1e-6)
    assert (area.value, area.std) == pytest.approx(
        tuple(1e-12 * v for v in (unseen_area(found, 1.0).value, unseen_area(found, 1.0).std))
    )
    assert force.value == pytest.approx(1e-3 * unseen_force(found, 1.0).value)


def test_nothing_is_known_without_contacts_or_limit():
    found, _ = drawn(10, np.random.default_rng(1))
    assert unseen_area(found.iloc[:0], 2.0) == NOTHING
    assert unseen_area(found, np.nan) == NOTHING
    assert unseen_force(found.assign(force_N=np.nan), 1.0) == NOTHING
    assert unseen_force(found.iloc[:0], 1.0) == NOTHING
    # no small contact at all: none is expected below, but it is not excluded
    large = unseen_area(found[found["radius_m"] > 3], 1.0)
    assert 0 < large.value < large.std < np.pi


def test_without_contacts_one_at_the_limit_is_not_excluded():
    frames = FRAMES.conform({"frame": ["a"], "n_contacts": [0], "smallest_px": [2.0]})
    _, filled = fill_forces(scene_from_dict({}), CONTACTS.empty(), frames, None, pixel_size=1e-6)
    row = filled.iloc[0]
    assert (row["area_m2"], row["unseen_area_m2"]) == (0.0, 0.0)
    assert row["area_std_m2"] == row["unseen_area_std_m2"] == pytest.approx(4e-12 * np.pi)
