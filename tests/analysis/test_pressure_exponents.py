import numpy as np
import pandas as pd
import pytest

from contactimg import InputError
from contactimg.analysis.contacts_against_pressure import fit_contact_law

SECTORS = 8
EXPONENT = 0.4
LOADS = (4e4, 1e5, 2.5e5)
"""Pressures at the centre, Pa."""


def regular_place(rng, *, exponent=EXPONENT):
    """Annuli of three loads whose numbers fluctuate half as much as independent ones: eta ~ p^exponent.

    The pressure falls exponentially with the distance; each force is drawn, so that both axes have errors,
    and these have a covariance.
    """
    loads = []
    for centre in LOADS:
        pressure = np.repeat(centre * np.exp(-0.3 * np.arange(10)), SECTORS)
        area = np.full(pressure.size, 2.5e-7)
        expected = 2e7 * (pressure / 1e5) ** exponent * area
        n = rng.binomial(np.round(2 * expected).astype(int), expected / np.round(2 * expected))
        mean = pressure * area / expected
        one = np.repeat(np.arange(n.size), n)
        force = mean[one] * rng.exponential(size=one.size)
        p, pp = (np.bincount(one, force**power, n.size) for power in (1, 2))
        ring = np.repeat(np.arange(10.0), SECTORS)
        a = 1e-5 * n * (pressure / 1e5) ** 0.2 * rng.normal(1.0, 0.05, n.size)
        sums = {"n": 1.0 * n, "n_forces": 1.0 * n, "a": a, "aa": 1e-10 * n, "p": p, "pp": pp, "ap": 1e-5 * p}
        ends = {"inner": ring, "outer": ring + 1, "sector": np.tile(np.arange(SECTORS), 10), "area": area}
        loads.append(pd.DataFrame(ends | sums))
    return loads


P_STAR = 3e4
"""Pressure at which the law of `broken_place` breaks, Pa."""


def broken_place(rng):
    """As `regular_place`, but with the exponent 0.9 below `P_STAR`."""
    loads = regular_place(rng)
    for centre, table in zip(LOADS, loads, strict=True):
        share = np.minimum(centre * np.exp(-0.3 * table["inner"]) / P_STAR, 1.0) ** 0.5
        table[["n", "n_forces"]] = table[["n", "n_forces"]].mul(share, axis=0)
    return loads


def fitted(places, quantity="density", **options):
    loads = [{str(k): place[load] for k, place in enumerate(places)} for load in range(len(LOADS))]
    return fit_contact_law(loads, quantity, **options)


@pytest.fixture(scope="module")
def surfaces():
    """50 surfaces of one place, and their exponents."""
    rng = np.random.default_rng(77)
    places = [regular_place(rng) for _ in range(50)]
    return places, [fitted([place]) for place in places]


def test_errors_of_both_axes_do_not_bias_the_exponent(surfaces):
    found = np.array([law.single.exponent.value for law in surfaces[1]])
    assert abs(found.mean() - EXPONENT) < 3 * found.std(ddof=1) / np.sqrt(found.size)


def test_least_squares_would_be_biased_where_the_instrument_is_not(surfaces):
    def least_squares(place):
        rings = [table[["n", "a", "p"]].to_numpy().reshape(10, SECTORS, 3).sum(axis=1) for table in place]
        n, a, p = np.concatenate(rings).T
        return np.polyfit(np.log(p), np.log(a / n), 1)[0]

    places = surfaces[0][:40]
    plain = np.array([least_squares(place) for place in places])
    found = np.array([fitted([place], "mean_radius").single.exponent.value for place in places])
    for values, biased in ((plain, True), (found, False)):
        error = values.std(ddof=1) / np.sqrt(values.size)
        assert (abs(values.mean() - 0.2) > 3 * error) == biased


def test_intervals_hold_the_law(surfaces):
    laws = [law.single for law in surfaces[1]]
    held = np.mean([law.exponent.low <= EXPONENT <= law.exponent.high for law in laws])
    # three binomial standard deviations of 50 at 95 %
    assert abs(held - 0.95) < 0.093


def test_a_break_is_seen_where_there_is_one_and_rarely_where_there_is_none(surfaces):
    # 5 % of 50 are 2.5; three binomial standard deviations more are 7.1
    assert sum(law.supported for law in surfaces[1]) <= 7
    rng = np.random.default_rng(79)
    broken = [fitted([broken_place(rng) for _ in range(8)]) for _ in range(10)]
    assert all(law.supported for law in broken)
    for name, truth in (("break_x", P_STAR), ("low_exponent", 0.9), ("high_exponent", EXPONENT)):
        found = [getattr(law, name) for law in broken]
        # two of ten outside the 95 % have a probability of 9 %, three of 1 %
        assert sum(e.low <= truth <= e.high for e in found) >= 8


def test_places_and_their_sectors_tell_the_same_uncertainty():
    rng = np.random.default_rng(78)
    places = [regular_place(rng) for _ in range(12)]
    together = fitted(places).single
    assert together.n_places == 12
    alone = [fitted([place]).single.exponent for place in places]
    mean_square = np.mean([estimate.std**2 for estimate in alone])
    # a variance from 11 degrees of freedom is known to sqrt(2/11) = 43 %, a standard deviation to 21 %
    assert together.exponent.std == pytest.approx(np.sqrt(mean_square / 12), rel=3 * 0.21)
    assert fitted(places[:3]).single.n_places == 1


def test_order_of_places_loads_and_rows_does_not_matter(rng):
    places = [regular_place(rng) for _ in range(4)]
    one = fitted(places).single
    shuffled = [[table.sample(frac=1.0, random_state=1) for table in place] for place in places[::-1]]
    loads = [{str(3 - k): place[load] for k, place in enumerate(shuffled)} for load in (2, 0, 1)]
    other = fit_contact_law(loads, "density").single
    assert other.exponent.value == pytest.approx(one.exponent.value, rel=1e-12)
    assert other.exponent.std == pytest.approx(one.exponent.std, rel=1e-9)


def test_a_change_of_units_changes_the_amplitude_alone(rng):
    place = regular_place(rng)
    length, force = 1e3, 1e-2
    power = {"area": 2, "inner": 1, "outer": 1, "a": 1, "aa": 2, "ap": 1}
    scaled = []
    for table in place:
        longer = table.assign(**{name: length**k * table[name] for name, k in power.items()})
        scaled.append(longer.assign(p=force * table["p"], pp=force**2 * table["pp"], ap=force * longer["ap"]))
    pressure = force / length**2
    loads = [{"0": table} for table in scaled]
    for quantity, unit in (("density", length**-2), ("mean_radius", length)):
        one = fitted([place], quantity).single
        other = fit_contact_law(loads, quantity).single
        assert other.reference == pytest.approx(pressure * one.reference, rel=1e-12)
        assert other.exponent.value == pytest.approx(one.exponent.value, abs=1e-12)
        assert other.exponent.std == pytest.approx(one.exponent.std, rel=1e-9)
        assert other.amplitude.value == pytest.approx(unit * one.amplitude.value, rel=1e-9)


def test_without_sectors_or_places_the_scatter_is_unknown(rng):
    place = [table[table["sector"] == 0] for table in regular_place(rng)]
    alone = fitted([place], min_contacts=1)
    assert np.isnan(alone.single.exponent.std)
    assert alone.single.exponent.high == np.inf
    assert not alone.supported


def test_annuli_that_cannot_tell_are_refused(rng):
    place = regular_place(rng)
    with pytest.raises(InputError, match="annuli of different pressure"):
        fitted([place], min_contacts=1e6)
