"""Areas of an ensemble and the band that they fill."""

import numpy as np
import pytest

from contactimg import InputError, area_bands, fit_power_law, solve_ensemble, tabulate_areas

PRESS = {"loads": [0.01, 0.1], "side": 4e-3, "contact_modulus": 4e6, "seed": 2, "patterns": 6}


def areas_under(lens, kind="SA"):
    return tabulate_areas(solve_ensemble(kind, indenter_radius=lens, **PRESS))


def test_bands_hold_the_areas_of_the_patterns():
    areas = areas_under(0.1288)
    assert len(areas) == 6 * 2 * 2
    bands = area_bands(areas, share=0.6).set_index(["coupling", "load_N"])
    for key, part in areas.groupby(["coupling", "load_N"]):
        low, mean, high = bands.loc[key]
        # of six ordered values the quantiles 0.2 and 0.8 are the second and the fifth
        assert (low, high) == pytest.approx(tuple(np.sort(part["area_m2"])[[1, 4]]))
        assert mean == pytest.approx(part["area_m2"].mean())
    # coupled contacts are more and smaller, and bear the load on a larger area
    assert bands.loc[("asymptotic", 0.1), "mean_m2"] > bands.loc[("none", 0.1), "mean_m2"]


def test_the_flatter_lens_gives_the_larger_exponent():
    exponents = []
    for lens in (0.013, 0.1288):
        bands = area_bands(areas_under(lens, "RA-"))
        coupled = bands[bands["coupling"] == "asymptotic"]
        exponents.append(fit_power_law(coupled["load_N"], coupled["mean_m2"]).exponent.value)
    assert 0.7 < exponents[0] < exponents[1] < 1


@pytest.mark.parametrize("share", [0.0, 1.0, np.nan])
def test_a_share_is_between_0_and_1(share):
    with pytest.raises(InputError, match="share must be between 0 and 1"):
        area_bands(areas_under(0.1288).iloc[:1], share=share)
