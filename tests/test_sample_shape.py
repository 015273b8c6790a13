"""Curved samples and tilted lenses: effective radius, shifted apex, invariances, their way into predict."""

import numpy as np
import pandas as pd
import pytest

from contactimg.effects.plan import make_plan
from contactimg.errors import InputError, ModelRangeError
from contactimg.pipeline.inputs import contact_sites
from contactimg.pipeline.predict import predict_loads
from contactimg.prediction import solve_scene
from contactimg.sample_shape import shaped_asperities
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities

LENS, APEX = 0.05, (1e-3, 1.2e-3)


@pytest.fixture(scope="module")
def patch():
    return generate_asperities("SA", side=2e-3, rng=np.random.default_rng(9))


def scene_with(indenter=None, **sections):
    indenter = {"radius_m": LENS, "apex_m": list(APEX)} | (indenter or {})
    return scene_from_dict({"indenter": indenter, "elastic": {"young_modulus_Pa": 3e6}} | sections)


def solve(scene, table, coupling="full", load=0.02):
    return solve_scene(scene, table, load=load, coupling=coupling)


def test_a_spherical_sample_below_the_apex_is_a_smaller_lens(patch):
    # 1/R = 1/R1 + 1/R2
    other = 0.3
    curved = solve(
        scene_with(sample={"radius_x_m": other, "radius_y_m": other, "summit_m": list(APEX)}), patch
    )
    lens = solve(scene_with({"radius_m": 1 / (1 / LENS + 1 / other)}), patch)
    np.testing.assert_allclose(curved.force, lens.force, atol=1e-9 * 0.02)
    assert curved.indentation == pytest.approx(lens.indentation, rel=1e-9)
    # the gap between the planes counts from the sample below each asperity
    plane = solve(scene_with(), patch)
    assert abs(curved.force - plane.force).sum() > 0.05 * 0.02
    assert curved.validity.base_gap > 0


def test_a_hollow_sample_flattens_the_lens_and_its_summit_moves_the_apex(patch):
    # two paraboloids: the apex lies at their mean, weighted with the curvatures
    hollow = {"radius_x_m": -0.2, "radius_y_m": -0.2, "summit_m": [1.3e-3, 0.9e-3]}
    total = 1 / LENS - 1 / 0.2
    apex = [(a / LENS - s / 0.2) / total for a, s in zip(APEX, (1.3e-3, 0.9e-3), strict=True)]
    curved = solve(scene_with(sample=hollow), patch)
    lens = solve(scene_with({"radius_m": 1 / total, "apex_m": apex}), patch)
    np.testing.assert_allclose(curved.force, lens.force, atol=1e-9 * 0.02)


@pytest.mark.parametrize("direction", [0.0, 90.0, 210.0])
def test_a_tilted_lens_is_a_shifted_one(patch, direction):
    angle, turn = np.radians(0.4), np.radians(direction)
    tilted = solve(scene_with({"tilt_deg": 0.4, "tilt_direction_deg": direction}), patch)
    shift = LENS * np.tan(angle) * np.array([np.cos(turn), np.sin(turn)])
    shifted = solve(scene_with({"apex_m": list(np.array(APEX) + shift)}), patch)
    np.testing.assert_allclose(tilted.force, shifted.force, atol=1e-9 * 0.02)
    upright = solve(scene_with(), patch)
    assert abs(tilted.force - upright.force).sum() > 0.05 * 0.02


def test_a_cylinder_curves_the_gap_in_one_direction():
    # asperities on a line: along the axis all alike, across it lowered by x^2/(2 R)
    at = np.linspace(-4e-4, 4e-4, 9)
    radius, flat = 0.05, {"radius_m": 1e6, "apex_m": [0.0, 0.0]}
    scene = scene_with(flat, sample={"radius_x_m": radius})
    along = pd.DataFrame({"x_m": 0.0, "y_m": at, "height_m": 4e-5, "radius_m": 1e-4})
    across = pd.DataFrame({"x_m": at, "y_m": 0.0, "height_m": 4e-5, "radius_m": 1e-4})
    even = solve(scene, along, "none", load=1e-3)
    np.testing.assert_allclose(even.force, 1e-3 / 9, rtol=1e-6)
    lowered = across.assign(height_m=4e-5 - at**2 / (2 * (radius + 1e-4)))
    curved, level = solve(scene, across, "none", 1e-3), solve(scene_with(flat), lowered, "none", 1e-3)
    np.testing.assert_allclose(curved.force, level.force, atol=1e-6)  # the radii differ by R/(2 Rx), 0.1 %
    assert curved.force[4] > 3 * curved.force[0]


def test_change_of_units_and_a_flat_sample_that_runs_no_code(patch):
    sections = {"sample": {"radius_x_m": 0.2, "summit_m": [1e-3, 1e-3]}}
    shaped = shaped_asperities(patch, scene_with({"tilt_deg": 0.3}, **sections))
    sections = {"sample": {"radius_x_m": 1.4, "summit_m": [7e-3, 7e-3]}}
    apex = [7 * APEX[0], 7 * APEX[1]]
    larger = shaped_asperities(7 * patch, scene_with({"tilt_deg": 0.3, "apex_m": apex}, **sections))
    np.testing.assert_allclose(larger, 7 * shaped, rtol=1e-12, atol=1e-18)
    assert shaped_asperities(patch, scene_with(sample={})) is patch


def test_plan_sites_and_models_know_the_shape(patch):
    scene = scene_with(sample={"radius_x_m": 0.2, "radius_y_m": 0.2, "summit_m": list(APEX)})
    same = scene_with({"radius_m": 0.04})
    plans = [make_plan(one, patch, load=0.02) for one in (scene, same)]
    for first, second in zip(plans[0].decisions, plans[1].decisions, strict=True):
        assert first.change == pytest.approx(second.change, rel=1e-6, abs=1e-12)
    sites, others = contact_sites(patch, scene), contact_sites(patch, same)
    for name in ("x_m", "y_m", "radius_m"):
        np.testing.assert_allclose(sites[name], others[name], rtol=1e-12)
    with pytest.raises(InputError, match='model "gt" takes a flat sample'):
        predict_loads(scene, [0.1], model="gt", coupling="auto", annulus=1e-4)
    with pytest.raises(ModelRangeError, match="contacts would not be circles"):
        shaped_asperities(patch, scene_with(sample={"radius_x_m": 5e-4}))
    with pytest.raises(InputError, match="must not be 0"):
        scene_with(sample={"radius_x_m": 0.0})
