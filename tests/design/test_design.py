"""Designed surfaces: Abel's relation, closed forms of the density, laws that coupled contacts follow."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from contactimg import InputError, WantedLaw, design_heights, solve_interacting, solve_loads
from contactimg.design import independent
from contactimg.design.independent import find_density
from contactimg.design.refine import area_gradient
from contactimg.design.surface import square_grid

RADIUS, MODULUS = 500e-6, 1.36e6 / 0.75
CAPS = {"cap_radius": RADIUS, "contact_modulus": MODULUS}
STRENGTH = 0.3e6


def power(text, largest, *, decades=1.0):
    return WantedLaw.parse(text, least=largest / 10**decades, largest=largest, shear_strength=STRENGTH)


LAWS = {
    "linear": power("A = 5e-6 P", 0.3),
    "power": power("A = 4e-6 P^0.8", 0.4),
    # friction 1.2 N/N up to 0.1 N, 1.4 above
    "two slopes": WantedLaw(np.array([0.03, 0.1, 0.3]), np.array([0.036, 0.12, 0.4])).over(STRENGTH),
}


def test_abels_relation_holds_for_any_heights(rng):
    """P(d) = E*/(pi sqrt R) int A(u) (d - u)^(-1/2) du; with u = d - s^2 the integrand is smooth."""
    heights, d = np.sort(rng.uniform(0, 1, 7)), 1.3
    area = lambda u: np.pi * RADIUS * np.maximum(u - heights, 0).sum()  # noqa: E731
    corners = np.sqrt(d - heights)
    integral = quad(lambda s: 2 * area(d - s**2), 0, np.sqrt(d), points=corners, epsrel=1e-12)[0]
    load = 4 / 3 * MODULUS * np.sqrt(RADIUS) * np.sum((d - heights) ** 1.5)
    assert MODULUS / (np.pi * np.sqrt(RADIUS)) * integral == pytest.approx(load, rel=1e-9)


@pytest.mark.parametrize(("exponent", "decades"), [(0.75, 5), (0.8, 5), (0.9, 12)])
def test_density_of_a_power_law_is_a_power_of_the_depth(exponent, decades):
    """n ~ u^k gives m = (k + 2)/(k + 5/2), hence the number above a depth ~ u^(k + 1)."""
    law = power(f"A = 3e-6 P^{exponent}", 10.0 ** (decades - 3), decades=decades)
    density = find_density(law, count=10**12, **CAPS)
    k = (2.5 * exponent - 2) / (1 - exponent)
    far = density.depth > 0.3 * density.depth[-1]
    slope = np.polyfit(np.log(density.depth[far]), np.log(np.cumsum(density.caps)[far]), 1)[0]
    # the caps that touch first shift the depth, by less of the last one the more decades there are
    assert slope == pytest.approx(k + 1, rel=0.03)
    assert np.abs(density.excess[far]).max() < 1e-9


def test_density_of_a_linear_law_is_exponential():
    """A/P = sqrt(pi R/l)/E* with the mean l."""
    factor = 5e-6
    density = find_density(power(f"A = {factor} P", 30.0, decades=3), count=10**9, **CAPS)
    sums = np.cumsum(density.caps)
    late = sums > 0.05 * sums[-1]
    mean = 1 / np.polyfit(density.depth[late], np.log(sums[late]), 1)[0]
    assert mean == pytest.approx(np.pi * RADIUS / (MODULUS * factor) ** 2, rel=0.01)


def test_march_is_of_first_order(monkeypatch):
    depths = []
    for step in (0.02, 0.01, 0.005):
        monkeypatch.setattr(independent, "LOAD_STEP", step)
        density = find_density(LAWS["linear"], count=10**6, **CAPS)
        depths.append(np.interp(0.25, density.load, density.depth))
    assert (depths[0] - depths[1]) / (depths[1] - depths[2]) == pytest.approx(2, abs=0.4)


def test_units_of_a_law_may_change():
    """Lengths by l, pressures by p: loads by p l^2, depths by l, the same numbers of caps."""
    length, pressure, law = 1e3, 7.0, LAWS["linear"]
    other = WantedLaw(law.load * pressure * length**2, law.area * length**2, law.power)
    one = find_density(law, count=64, **CAPS)
    two = find_density(other, count=64, cap_radius=RADIUS * length, contact_modulus=MODULUS * pressure)
    np.testing.assert_allclose(two.depth, one.depth * length, rtol=1e-9)
    np.testing.assert_allclose(two.caps, one.caps, rtol=1e-6, atol=1e-9)


@pytest.fixture
def few_loads(monkeypatch):
    """Surfaces are designed at nine loads, not 33."""
    monkeypatch.setattr("contactimg.design.surface.LOADS", 9)


@pytest.mark.parametrize("name", LAWS)
def test_coupled_contacts_follow_the_law_and_those_designed_as_independent_do_not(name, request):
    """64 caps over a decade: within 3 % at any load, by the accurate coupling; else off by more."""
    law = LAWS[name]
    if name != "linear":
        request.getfixturevalue("few_loads")
    found = design_heights(law, count=64, spacing=0.8e-3, rng=np.random.default_rng(0), **CAPS)
    how = {"indenter_radius": np.inf, "contact_modulus": MODULUS, "coupling": "full", "law": "sphere"}
    loads = law.loads(14)
    off = {}
    for kind, table in (("coupled", found.asperities), ("independent", found.independent_asperities)):
        areas = [one.area for one in solve_loads(table, loads=loads, **how)]
        off[kind] = np.abs(areas / law.at(loads) - 1).max()
    assert off["coupled"] < 0.03 < off["independent"]
    assert found.residual < 0.01
    assert found.asperities["height_m"].min() == pytest.approx(RADIUS / 10)
    assert (found.law["n_contacts"].diff().dropna() >= 0).all()


def test_gradient_is_the_change_of_the_area(rng):
    table = square_grid(9, 0.4e-3).assign(height_m=rng.uniform(100e-6, 110e-6, 9), radius_m=RADIUS)
    how = {"indenter_radius": np.inf, "contact_modulus": MODULUS, "load": 0.05}
    gradient = area_gradient(solve_interacting(table, **how))
    for cap in range(9):
        step = 1e-9 * (np.arange(9) == cap)
        high, low = (solve_interacting(table.assign(height_m=table["height_m"] + s), **how).area
                     for s in (step, -step))  # fmt: skip
        assert gradient[cap] == pytest.approx(
            (np.log(high) - np.log(low)) / 2e-9, abs=1e-4 * np.abs(gradient).max()
        )


def test_scatter_is_that_of_solved_surfaces(rng):
    """40 surfaces with errors of 1 um: a root mean square over 40 draws is good to 1/sqrt(80), 11 %."""
    found = design_heights(
        LAWS["power"], count=64, spacing=0.8e-3, profile="hertz", tolerance=0.1, rng=rng, **CAPS
    )
    loads = found.law["load_N"].to_numpy()[[0, 16, 32]]
    how = {"loads": loads, "indenter_radius": np.inf, "contact_modulus": MODULUS}
    areas = []
    for _ in range(40):
        heights = found.asperities["height_m"] + 1e-6 * rng.standard_normal(64)
        areas.append([one.area for one in solve_loads(found.asperities.assign(height_m=heights), **how)])
    table = found.law.iloc[[0, 16, 32]]
    solved = np.sqrt(np.mean((np.array(areas) - table["coupled_area_m2"].to_numpy()) ** 2, axis=0))
    np.testing.assert_allclose(table["coupled_std_m2"], solved, rtol=0.4)


def test_one_cap_follows_its_own_law_only():
    """A = pi (3 P R/(4 E*))^(2/3)."""
    factor = np.pi * (0.75 * RADIUS / MODULUS) ** (2 / 3)
    how = {"count": 1, "spacing": 1e-3, "profile": "hertz", "rng": np.random.default_rng(0)} | CAPS
    found = design_heights(power(f"A = {factor} P^{2 / 3}", 0.01), **how)
    assert found.status == "ok"
    assert found.residual < 1e-3
    with pytest.raises(InputError, match=r"the law needs 3 caps, and there are 1; from 0\.001"):
        design_heights(power(f"A = {1.5 * factor} P^0.7", 0.01), **how)
    found = design_heights(power(f"A = {1.5 * factor} P^0.7", 0.01), nearest=True, **how)
    assert found.status.startswith("the wanted law is not possible: the law needs 3 caps")
    alone = factor * found.law["load_N"] ** (2 / 3)
    np.testing.assert_allclose(found.law["coupled_area_m2"], alone, rtol=1e-9)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        # an area that grows more slowly than the load to the 2/3
        (power("A = 2e-6 P^0.55", 0.3), "from 0.0\\d+ N on the area would have to grow more slowly"),
        # friction that rises less steeply from 0.1 N on
        (
            WantedLaw(np.array([0.03, 0.1, 0.3]), np.array([0.036, 0.12, 0.2])).over(STRENGTH),
            "from 0.10\\d N on the area would have to grow more slowly",
        ),
        # 64 are too few
        (power("A = 5e-6 P", 3.0), "the law needs \\d+ caps, and there are 64; from 0.47"),
        # discrete: even one cap has more area at the first load than is wanted
        (power("A = 5e-6 P", 0.3, decades=3), "one cap alone has .* take caps of a radius below"),
        (power("A = 1 P^20", 0.3), "one cap alone has .* m2 are wanted; take a larger first load"),
        (power("A = 1 P", 0.3), "the law needs over 1e\\+09 caps"),
    ],
)
def test_laws_that_are_not_possible_are_refused_with_the_reason(law, said):
    with pytest.raises(InputError, match=f"the law is not possible: {said}"):
        design_heights(law, count=64, spacing=0.8e-3, rng=np.random.default_rng(0), **CAPS)


@pytest.mark.usefixtures("few_loads")
def test_the_nearest_possible_law_may_be_designed(rng):
    law = WantedLaw(np.array([0.03, 0.1, 0.3]), np.array([0.045, 0.15, 0.39])).over(STRENGTH)
    found = design_heights(law, count=64, spacing=1.5e-3, nearest=True, rng=rng, **CAPS)
    assert found.status.startswith("the wanted law is not possible: from 0.1")
    assert found.residual < 0.03
    excess = found.law["coupled_area_m2"] / found.law["wanted_area_m2"] - 1
    assert excess.max() > 0.01  # what is possible has more area after the bend


@pytest.mark.parametrize(
    ("text", "least", "largest", "said"),
    [
        ("A = -2e-6 P", 0.1, 1.0, "needs a positive factor and exponent, got -2e-06 and 1"),
        ("A = 2e-6 P^-1", 0.1, 1.0, "needs a positive factor and exponent"),
        ("A = two P", 0.1, 1.0, "the law 'A = two P' is not understood; write"),
        ("A = 2e-6 P + 1", 0.1, 1.0, "is not understood"),
        ("", 0.1, 1.0, "is not understood"),
        ("A = 2e-6 P^900", 0.1, 1.0, "a law needs positive numbers, got area_m2 ="),
        ("A = 2e-6 P", 1.0, 0.1, "a range of positive loads, the least below the largest"),
        ("A = 2e-6 P", -1.0, 0.1, "a range of positive loads"),
        ("A = 2e-6 P", 0.1, np.inf, "a range of positive loads"),
        ("F = 0.8 P", 0.1, 1.0, "needs the shear strength"),
    ],
)
def test_texts_that_are_no_law_are_refused(text, least, largest, said):
    with pytest.raises(InputError) as error:
        WantedLaw.parse(text, least=least, largest=largest)
    assert said in str(error.value)


@pytest.mark.parametrize("text", ["A=5e-6P", "A = 5e-6*P**1", " A = .5E-5 * P ^ 1.0 "])
def test_a_law_may_be_written_in_several_ways(text):
    assert WantedLaw.parse(text, least=0.1, largest=1.0).at(0.5) == pytest.approx(2.5e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"count": 0}, "needs 1 to 10000 caps"),
        ({"count": 100_000}, "needs 1 to 10000 caps"),
        ({"lowest": 6e-4}, "600 um high cannot stand"),
        ({"cap_radius": np.nan}, "cap_radius must be positive and finite"),
        ({"spacing": 0.0}, "spacing must be positive and finite"),
        ({"contact_modulus": -1.0}, "contact_modulus must be positive and finite"),
        ({"tolerance": 0.0}, "a tolerance between 0 and 1"),
        ({"spacing": 50e-6}, "50 um high cannot stand 50 um apart; their discs are 435.9 um wide"),
    ],
)
def test_arguments_that_break_a_rule_are_refused(change, said):
    arguments = {"count": 64, "spacing": 1e-3, "rng": np.random.default_rng(0)} | CAPS | change
    with pytest.raises(InputError, match=said):
        design_heights(LAWS["linear"], **arguments)


def test_a_range_too_wide_is_refused():
    with pytest.raises(InputError, match="take a narrower range"):
        find_density(WantedLaw.parse("A = 1e9 P^0.8", least=1e-20, largest=1e9), count=10**9, **CAPS)


def test_points_of_a_law_increase():
    for load, area in (([1.0], [1.0]), ([1.0, 1.0], [1.0, 2.0]), ([1.0, 2.0], [2.0, 1.0]), ([], [])):
        with pytest.raises(InputError, match="two points or more"):
            WantedLaw(np.array(load), np.array(area))
    assert isinstance(LAWS["linear"].at(pd.Series([0.1])), np.ndarray)


@pytest.mark.parametrize("kind", [list, tuple, np.array, pd.Series])
def test_points_of_a_law_may_come_in_any_kind_of_list(kind):
    assert WantedLaw(kind([1, 2, 4]), kind([1, 3, 4])).at([1.5, 3.0]).tolist() == [2.0, 3.5]
    with pytest.raises(InputError, match="an area for each load, got 2 areas and 3 loads"):
        WantedLaw(kind([1, 2, 4]), kind([1, 3]))
