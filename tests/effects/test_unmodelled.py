"""What no switch computes: the rows of finite strain and of the slope of the lens."""

import importlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from effect_scenes import mechanical_scene

from contactimg import solve_interacting
from contactimg.effects.plan import make_plan, unmodelled_effects
from contactimg.mechanics import hertz, sphere
from contactimg.mechanics.finite_strain import OVER_HERTZ, OVER_SPHERE, STRAIN_RATIO

FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}


def one_cap(ratio, **where):
    table = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [6e-5], "radius_m": [1e-4]})
    load = hertz.load(ratio * 1e-4, sphere_radius=1e-4, contact_modulus=4e6)
    return solve_interacting(table, load=float(load), **(FLAT | where))


def test_the_two_ratios_of_the_table_differ_by_the_two_laws():
    s = np.array(STRAIN_RATIO[1:])
    expected = sphere.scaled_load(s) / (4 / 3 * s**3)
    np.testing.assert_allclose(np.divide(OVER_HERTZ[1:], OVER_SPHERE[1:]), expected, rtol=2e-3)


def test_one_contact_by_hand():
    """At a/R = 0.209 rubber bears 0.971 of the load: at the same load the radius is 0.971^(-1/3) wider."""
    strain, slope = unmodelled_effects(one_cap(0.209), law="sphere", output="all")
    assert strain.changes["radius"] == pytest.approx(0.971 ** (-1 / 3) - 1)
    assert strain.changes["area"] == pytest.approx(0.971 ** (-2 / 3) - 1)
    assert strain.change == strain.changes["hertz"] == pytest.approx(1 / 0.971 - 1)
    assert strain.changes["force"] == 0  # a single contact bears the load
    assert slope.change == 0  # under a flat
    assert "a/R up to 0.21: rubber bears 0.971" in strain.reason


def test_it_vanishes_with_the_load_and_only_requested_outputs_count():
    small, _ = unmodelled_effects(one_cap(1e-4), law="hertz", output="all")
    assert small.change < 1e-5
    area, _ = unmodelled_effects(one_cap(0.5), law="hertz", output="area")
    assert area.change == area.changes["area"]


def test_the_plan_lists_what_is_not_modelled_for_the_law_that_it_takes():
    scene, table, load = mechanical_scene("RA+ dry")
    plan = make_plan(scene, table, load=load)
    rows = plan.table().set_index("effect")
    assert list(rows.index[rows["decision"] == "not modelled"]) == ["finite_strain", "cap_slope"]
    assert np.isnan(rows.loc["cap_slope", "change_radius"])  # not estimated
    # two caps beside the apex of a lens of 13 mm: slopes of some hundredths, their squares below 1e-2
    assert 1e-5 < rows.loc["cap_slope", "change_force"] < rows.loc["cap_slope", "change_area"] < 1e-2
    off = scene.model_copy(update={"effects": scene.effects.model_copy(update={"sphere_profile": "off"})})
    hertzian = make_plan(off, table, load=load).table().set_index("effect")
    assert hertzian.loc["finite_strain", "change_hertz"] < rows.loc["finite_strain", "change_hertz"]


@pytest.mark.slow
def test_the_stored_ratios_are_those_of_finite_elements(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    a, over_hertz, over_sphere = importlib.import_module("finite_strain").ratios(0.4, 10)
    # ten elements along the radius instead of thirty
    assert over_hertz == pytest.approx(np.interp(a, STRAIN_RATIO, OVER_HERTZ), rel=1.5e-2)
    assert over_sphere == pytest.approx(np.interp(a, STRAIN_RATIO, OVER_SPHERE), rel=1.5e-2)
