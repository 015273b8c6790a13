"""Predictions of a scene: every switch moves the output as predicted, averages agree with rows."""

import numpy as np
import pandas as pd
import pytest

from contactimg.errors import InputError, ModelRangeError
from contactimg.mechanics import hertz, jkr
from contactimg.mechanics.layer import layer_factors
from contactimg.pipeline.predict import predict_loads
from contactimg.pose import Pose
from contactimg.prediction import (
    asperity_density,
    hertz_circle,
    load_name,
    predict_average,
    predict_contacts,
)
from contactimg.render.contacts import see_contacts
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities

LENS = 0.1288
SCENE = {
    "indenter": {"radius_m": LENS, "apex_m": [0.002, 0.002]},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"side_m": 0.004},
    "camera": {"pixel_size_m": 6e-6},
    "effects": {"model": "paper"},
}


@pytest.fixture(scope="module")
def asperities():
    return generate_asperities("SA", side=0.004, coverage=0.4, rng=np.random.default_rng(5))


def scene_with(**sections):
    data = {name: dict(keys) for name, keys in SCENE.items()}
    for name, keys in sections.items():
        data[name] = data.get(name, {}) | keys
    return scene_from_dict(data)


def area(prediction):
    return prediction.frames["area_m2"][0]


def test_row_sums_its_contacts_and_the_profile(asperities):
    prediction = predict_contacts(scene_with(), asperities, load=0.05)
    row = prediction.frames.iloc[0]
    assert row["n_contacts"] == len(prediction.contacts)
    assert row["area_m2"] == pytest.approx(prediction.contacts["area_m2"].sum(), rel=1e-12)
    assert row["force_sum_N"] == pytest.approx(0.05, rel=1e-10)
    rings = np.pi * np.diff((2.5e-4 * np.arange(len(prediction.profile) + 1)) ** 2)
    assert np.sum(prediction.profile["pressure_Pa"] * rings) == pytest.approx(0.05, rel=1e-10)


def test_coupling_switched_off_underestimates_the_area(asperities):
    # the paper, sec. 6: with alpha = 0 the area is underestimated, more so at higher loads
    loss = []
    for load in (0.005, 0.1):
        coupled = area(predict_contacts(scene_with(), asperities, load=load))
        off = area(predict_contacts(scene_with(effects={"coupling": "off"}), asperities, load=load))
        loss.append(1 - off / coupled)
    assert 0 < loss[0] < loss[1]


def test_an_option_of_coupling_overrules_the_scene(asperities):
    off = scene_with(effects={"coupling": "off"})
    asked = area(predict_contacts(off, asperities, load=0.05, coupling="asymptotic"))
    assert asked == area(predict_contacts(scene_with(), asperities, load=0.05))


def test_layer_switched_on_stiffens_the_contact(asperities):
    def at(thickness, **effects):
        scene = scene_with(elastic={"thickness_m": thickness}, effects=effects)
        return predict_contacts(scene, asperities, load=0.1).frames.iloc[0]

    half_space, thin, thick = at(2e-3), at(2e-3, layer="on"), at(1.0, layer="on")
    # PHYSICS, sec. 7: at a/t of 0.6 the indentation drops by much, area and forces change little
    assert thin["indentation_m"] < 0.8 * half_space["indentation_m"]
    assert thin["area_m2"] == pytest.approx(half_space["area_m2"], rel=0.06)
    assert thick["indentation_m"] == pytest.approx(half_space["indentation_m"], rel=1e-2)


def test_sphere_profile_switched_on_makes_contacts_of_a_given_force_smaller(asperities):
    parabola = predict_contacts(scene_with(), asperities, load=0.1)
    sphere = predict_contacts(scene_with(effects={"sphere_profile": "on"}), asperities, load=0.1)
    # Hertz forces from the true radii of spheres sum to less than the load: 98 to 95 % of it on SA+
    radius = 100e-6 * LENS / (100e-6 + LENS)
    forces = hertz.load(sphere.contacts["radius_m"].to_numpy(), sphere_radius=radius, contact_modulus=4e6)
    assert 0.94 < forces.sum() / 0.1 < 0.99
    assert area(sphere) < area(parabola)


def test_adhesion_switched_on_enlarges_the_area_as_jkr_says():
    cap = pd.DataFrame({"x_m": [0.002], "y_m": [0.002], "height_m": [4e-5], "radius_m": [1e-4]})
    scene = scene_with(elastic={"work_of_adhesion_J_m2": 0.05}, effects={"adhesion": "on"})
    contact = predict_contacts(scene, cap, load=1.7e-3).contacts.iloc[0]
    composite = 1e-4 * LENS / (1e-4 + LENS)
    expected = jkr.radius(1.7e-3, sphere_radius=composite, contact_modulus=4e6, work_of_adhesion=0.05)
    assert contact["radius_m"] == pytest.approx(float(expected), rel=1e-6)
    plain = predict_contacts(scene_with(), cap, load=1.7e-3).contacts.iloc[0]
    # PHYSICS, sec. 7: for w = 50 mJ/m^2, R = 100 um and p = 1.7 mN adhesion adds 26 % to a^3
    assert (contact["radius_m"] / plain["radius_m"]) ** 3 == pytest.approx(1.26, abs=0.01)


def test_effects_that_do_not_go_together_are_refused(asperities):
    adhesive = scene_with(elastic={"work_of_adhesion_J_m2": 0.05}, effects={"adhesion": "on"})
    with pytest.raises(InputError, match='does not go with the coupling "hertz"'):
        predict_contacts(adhesive, asperities, load=0.1, coupling="hertz")
    with pytest.raises(InputError, match="needs the work_of_adhesion_J_m2"):
        predict_contacts(scene_with(effects={"adhesion": "on"}), asperities, load=0.1)
    with pytest.raises(InputError, match="needs the thickness_m"):
        predict_contacts(scene_with(effects={"layer": "on"}), asperities, load=0.1)


def test_the_layer_has_the_poisson_ratio_of_the_scene(asperities):
    """A single asperity: force and radius are those of the layer's own factors."""
    one, ratio = asperities.iloc[[asperities["height_m"].argmax()]], 0.3
    layer = {"young_modulus_Pa": 3e6, "thickness_m": 6e-5, "poisson_ratio": ratio}
    radii = {}
    for thickness in (6e-5, None):
        scene = scene_with(
            elastic=layer | {"thickness_m": thickness},
            effects={"layer": "on" if thickness else "off", "sphere_profile": "off"},
        )
        radii[thickness] = predict_contacts(scene, one, load=1e-3).contacts["radius_m"].iloc[0]
    pressing, _ = layer_factors(radii[6e-5] / 6e-5, poisson_ratio=ratio)
    assert pressing > 1.02
    assert radii[None] == pytest.approx(radii[6e-5] * pressing ** (1 / 3), rel=1e-6)


def test_the_area_of_a_pattern_comes_from_its_table(asperities):
    unstated = scene_from_dict(
        {name: keys for name, keys in SCENE.items() if name != "asperities"} | {"asperities": {}}
    )
    # hundreds of caps reach to within a hundredth of each side of their square
    density = asperity_density(unstated.asperities, asperities)
    assert density == pytest.approx(len(asperities) / 0.004**2, rel=0.02)
    for side in (0.01, 0.003):
        with pytest.raises(InputError, match="but the table spans"):
            asperity_density(scene_with(asperities={"side_m": side}).asperities, asperities)
    with pytest.raises(InputError, match="state side_m or density_per_m2"):
        asperity_density(unstated.asperities, asperities.iloc[:1])


def test_adhesion_goes_with_all_others(asperities):
    def at(w, **effects):
        scene = scene_with(elastic={"work_of_adhesion_J_m2": w, "thickness_m": 1e-3}, effects=effects)
        return predict_contacts(scene, asperities, load=0.02)

    others = {"layer": "on", "sphere_profile": "on"}
    plain, nearly = at(0.0, **others), at(1e-10, adhesion="on", **others)
    # sqrt(6 pi w R p)/p on a^3 at the mean contact of 0.5 mN: sqrt(6 pi 1e-10 1e-4/5e-4) = 2e-5, times 2/3 on
    # the area; light contacts more
    assert area(nearly) == pytest.approx(area(plain), rel=1e-4)
    assert area(nearly) > area(plain)
    sticky = at(0.05, adhesion="on", **others)
    for name in others:
        without = at(0.05, adhesion="on", **(others | {name: "off"}))
        assert abs(area(without) / area(sticky) - 1) > 0.01
    with pytest.raises(InputError, match='does not go with the coupling "full"; take "asymptotic"'):
        at(0.05, adhesion="on", full_coupling="on")


def test_touching_planes_stop_the_prediction(asperities):
    with pytest.raises(ModelRangeError, match="the planes touch"):
        predict_contacts(scene_with(effects={"coupling": "off"}), asperities, load=5.0)


def test_stated_and_derived_statistics_agree(asperities):
    stated = scene_with(
        asperities={
            "density_per_m2": len(asperities) / 0.004**2,
            "radius_m": 100e-6,
            "height_law": "uniform",
            "height_min_m": 30e-6,
            "height_max_m": 60e-6,
        }
    )
    # the table's own heights instead of the law they were drawn from: 300 draws, a few per cent
    for model in ("gw", "gt"):
        given = predict_average(stated, None, load=0.05, model=model)
        derived = predict_average(scene_with(), asperities, load=0.05, model=model)
        assert area(derived) == pytest.approx(area(given), rel=0.03)


def test_averages_agree_with_rows_for_many_patterns():
    # the interacting model without coupling, averaged over patterns, is Greenwood-Williamson on rings
    scene = scene_with(effects={"coupling": "off"})
    rows = []
    for seed in range(20):
        table = generate_asperities("SA", side=0.004, coverage=0.4, rng=np.random.default_rng(seed))
        gw = area(predict_average(scene, table, load=0.05, model="gw"))
        rows.append(area(predict_contacts(scene, table, load=0.05)) / gw)
    assert np.mean(rows) == pytest.approx(1, abs=4 * np.std(rows) / np.sqrt(20))


@pytest.mark.parametrize(
    ("section", "sentence"),
    [
        ({}, r"needs radius_m in \[asperities\]"),
        ({"radius_m": 1e-4}, "needs height_law"),
        ({"radius_m": 1e-4, "height_law": "gaussian"}, "needs height_mean_m and height_std_m"),
    ],
)
def test_what_a_statistical_model_lacks_is_named(section, sentence):
    with pytest.raises(InputError, match=sentence):
        predict_average(scene_with(asperities=section), None, load=0.1, model="gt")


def test_names_of_loads_are_unique():
    loads = [0.1, 0.1 + 1e-16, 0.1 + 2e-16, 1e-9]
    assert len({load_name(load) for load in loads}) == len(set(loads))


@pytest.mark.parametrize("kind", [np.float64, np.float32, int])
def test_the_name_of_a_load_does_not_tell_its_type(kind):
    assert load_name(kind(2)) == "load_2.0N"


def test_seen_contacts_stand_where_the_pose_puts_them(asperities):
    scene = scene_with()
    contacts = predict_contacts(scene, asperities, load=0.02).contacts
    seen = see_contacts(contacts, scene.pose((300, 500)), shift_px=(1.0, -2.0))
    np.testing.assert_allclose(seen["x_px"], (contacts["x_m"] - 0.002) / 6e-6 + 249.5 + 1)
    np.testing.assert_allclose(seen["y_px"], (contacts["y_m"] - 0.002) / 6e-6 + 149.5 - 2)


def test_hertz_circle_of_the_lens():
    x, y, radius = hertz_circle(scene_with(), 0.5)
    # (P Rl/K)^(1/3) = (0.5 * 0.1288 / (16e6/3))^(1/3) = 2.294 mm
    assert (x, y, radius) == (0.002, 0.002, pytest.approx(2.2943e-3, rel=1e-4))
    assert hertz_circle(scene_from_dict({}), 0.5) is None
    flat = {"indenter": {"radius_m": "flat"}, "elastic": {"young_modulus_Pa": 3e6}}
    assert hertz_circle(scene_from_dict(flat), 0.5) is None


def test_a_level_of_coupling_asks_for_the_papers_model():
    """At 0.2 N a/R reaches 0.4: the plan takes the sphere's profile; a level given by hand does not."""
    planned = {"model": "planned"}
    pattern = {"generate": "SA", "coverage": 0.4, "side_m": 0.004, "seed": 5}

    def areas(coupling, **effects):
        scene = scene_with(asperities=pattern, effects=planned | effects)
        found = predict_loads(scene, [0.2], model="interacting", coupling=coupling, annulus=2.5e-4)
        return found[0].frames["area_m2"][0]

    assert areas("asymptotic") == areas("asymptotic", sphere_profile="off")
    assert areas("auto") == areas("asymptotic", sphere_profile="on") < 0.99 * areas("asymptotic")


@pytest.mark.parametrize("model", ["gw", "gt"])
def test_averages_over_few_contacts_say_how_little_they_tell(asperities, model):
    few, many = (
        predict_average(scene_with(), asperities, load=load, model=model).frames["message"].iloc[0]
        for load in (1e-5, 0.5)
    )
    assert "a single pattern scatters about it" in few
    assert "scatters" not in many


@pytest.mark.parametrize("model", ["gw", "gt"])
def test_averages_without_a_load_and_beyond_any_model(asperities, model):
    nothing = predict_average(scene_with(), asperities, load=0.0, model=model)
    assert nothing.frames[["status", "area_m2", "force_sum_N"]].iloc[0].tolist() == ["ok", 0.0, 0.0]
    assert nothing.profile.empty
    with pytest.raises(ModelRangeError, match=r"on asperities of 100 um, outside every asperity model"):
        predict_average(scene_with(), asperities, load=1e5, model=model)


def test_ellipses_are_seen_as_ellipses(asperities):
    contacts = predict_contacts(scene_with(), asperities, load=0.05).contacts
    a = contacts["radius_m"]
    axes = {"semi_major_m": 1.2 * a, "semi_minor_m": a / 1.2, "angle_rad": 0.3}
    pose = Pose((101, 201), 1e-6, (0.0, 0.0), rotation=0.2, mirrored=True)
    seen = see_contacts(contacts.assign(shape="ellipse", **axes), pose)
    ends = pose.to_pixels([0.0, np.cos(0.3)], [0.0, np.sin(0.3)])
    slope = np.diff(ends[1])[0] / np.diff(ends[0])[0]
    np.testing.assert_allclose(np.tan(seen["angle_rad"]), slope, rtol=1e-9)
    np.testing.assert_allclose(seen["semi_major_px"] * seen["semi_minor_px"], seen["radius_px"] ** 2)
    # Ramanujan: pi (3 (p + q) - sqrt((3 p + q) (p + 3 q))), too small by a share of order ((p - q)/(p + q))^6
    p, q = seen["semi_major_px"], seen["semi_minor_px"]
    perimeter = np.pi * (3 * (p + q) - np.sqrt((3 * p + q) * (p + 3 * q)))
    np.testing.assert_allclose(seen["perimeter_px"], perimeter, rtol=3e-5)
