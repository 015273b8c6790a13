"""Asperities of a stated profile from the model through frames to forces; what takes caps refuses."""

import numpy as np
import pandas as pd
import pytest

from contactimg import PowerLawProfile
from contactimg.errors import InputError
from contactimg.files import open_experiment, read_scene
from contactimg.forces import local_forces
from contactimg.mechanics.contact_force import force_exponents, pressing_force
from contactimg.mechanics.profiles import ProfileUnderLens
from contactimg.pipeline.calibrate.thresholds import measure_thresholds
from contactimg.pipeline.frame import film_setting
from contactimg.pipeline.inputs import contact_sites, scene_of_defined_laws
from contactimg.pipeline.overlay import compare_run
from contactimg.pipeline.predict import plan_effects
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import simulate_series, write_simulation
from contactimg.pipeline.tradeoff import prepare_tradeoff
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities
from contactimg.tables import CONTACTS

POWER = {"profile_exponent": 4.0, "profile_width_m": 3e-5, "profile_drop_m": 4e-6}
POINTS = {"profile_points_m": [[0.0, 0.0], [1e-5, 1e-7], [2e-5, 8e-7], [4e-5, 1e-5]]}
COMMANDS = {
    "`effects`": lambda scene: plan_effects(scene, load=0.02),
    "`tradeoff`": lambda scene: prepare_tradeoff(scene, load=0.02),
}
SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [6e-4, 4.5e-4]},
    "elastic": {"young_modulus_Pa": 3e6},
    "asperities": {"file": "asperities.csv", "side_m": 1.2e-3} | POWER,
    "camera": {"pixel_size_m": 2.5e-6, "centre_m": [6e-4, 4.5e-4]},
    "simulate": {"loads_N": [0.02], "shape": [480, 500], "blur_px": 1.2},
}


@pytest.fixture(scope="module")
def asperities():
    return generate_asperities("SA", side=1.2e-3, coverage=0.25, rng=np.random.default_rng(21))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, asperities):
    folder = tmp_path_factory.mktemp("profile")
    write_simulation(scene_from_dict(SCENE), asperities, folder)
    return folder


def test_rendered_contacts_are_measured_and_bear_the_forces_of_the_profile(folder, asperities):
    truth = pd.read_csv(folder / "truth.csv")
    run = measure_series(read_scene(folder), workers=1)
    row = run.frames.iloc[0]
    assert (row["status"], row["law"]) == ("ok", "profile")
    found = run.contacts.assign(asperity=run.contacts["asperity"].astype(int))
    pairs = truth.merge(found, on="asperity", suffixes=("", "_found"))
    assert len(pairs) == len(found) == 11
    # p ~ a^5; measured: 0.03 % of a radius, 0.14 % of a force at the worst
    np.testing.assert_allclose(pairs["force_N_found"], pairs["force_N"], rtol=0.005)
    hertz = pairs["force_hertz_N_found"] / pairs["force_N"]
    assert hertz.max() / hertz.min() > 1.5  # a law of another exponent
    np.testing.assert_allclose(
        pairs["force_std_N_found"] / pairs["force_N_found"],
        5 * pairs["radius_std_m_found"] / pairs["radius_m_found"],
        rtol=0.01,
    )
    assert compare_run(run, asperities).scores.set_index("model").loc["coupled", "f1"] == 1


def test_a_parabola_as_a_profile_gives_hertz_s_forces(folder, asperities):
    truth = CONTACTS.conform(pd.read_csv(folder / "truth.csv").assign(flags=0))
    parabola = {"profile_exponent": 2.0, "profile_width_m": 1e-4, "profile_drop_m": 5e-5}
    caps = scene_from_dict(SCENE | {"asperities": {}})
    sites = contact_sites(asperities, caps)
    expected, exponent = local_forces(caps, truth, sites)
    found, same = local_forces(scene_from_dict(SCENE | {"asperities": parabola}), truth, sites)
    np.testing.assert_allclose(found["force_N"], expected["force_N"], rtol=1e-9)
    np.testing.assert_allclose(same, exponent, rtol=1e-9)


def test_forces_of_a_profile_where_it_is_described():
    profile = ProfileUnderLens(PowerLawProfile(4.0, width=3e-5, drop=4e-6), np.inf)
    radius = np.array([0.0, 1e-5, np.nan])
    force = pressing_force(radius, np.nan, contact_modulus=4e6, law=profile)
    assert force[0] == 0
    assert np.isnan(force[2])
    # kappa = 8/3: delta = (8/3) drop (a/width)^4, P = (8/5) E* a delta
    assert force[1] == pytest.approx(8 / 5 * 4e6 * 1e-5 * 8 / 3 * 4e-6 / 81)
    assert force_exponents(radius, np.nan, law=profile)[1] == pytest.approx(5)


def test_thresholds_are_calibrated_with_the_profile(folder):
    found = measure_thresholds(open_experiment(read_scene(folder)), [0.5], workers=1)
    truth = pd.read_csv(folder / "truth.csv")
    # counted pixels miss 1.3 % of the area here; p ~ a^5 = (a^2)^2.5
    counted = found.areas[0, 0] / truth["area_m2"].sum()
    assert 0.95 < counted < 1
    assert found.forces[0, 0] == pytest.approx(truth["force_N"].sum() * counted**2.5, rel=0.01)


@pytest.mark.parametrize("profile", [POWER, POINTS], ids=["power law", "table"])
@pytest.mark.parametrize("command", COMMANDS)
def test_what_compares_models_of_caps_refuses_a_stated_profile(small_series, command, profile):
    plain = read_scene(small_series)
    data = {section: dict(keys) for section, keys in plain.source.items()}
    data["asperities"] = data["asperities"] | profile
    with pytest.raises(InputError, match=rf"states a profile, and {command} takes caps"):
        COMMANDS[command](scene_from_dict(data, folder=plain.folder))


def test_what_is_not_defined_for_a_profile_is_refused(asperities):
    film = scene_from_dict(SCENE | {"effects": {"film": "on"}})
    with pytest.raises(InputError, match='film = "on" takes caps'):
        next(simulate_series(film, asperities))
    sites = contact_sites(asperities, film)
    with pytest.raises(InputError, match=r"states a profile, and .* takes caps"):
        film_setting(film, sites)
    assert film_setting(scene_from_dict(SCENE), sites) is None
    ordered = scene_from_dict(SCENE | {"effects": {"sphere_profile": "on"}})
    with pytest.raises(InputError, match="sphere_profile is not defined for asperities of a stated profile"):
        scene_of_defined_laws(ordered, sites)
    with pytest.raises(InputError, match='hertz = "ellipse" takes caps'):
        scene_of_defined_laws(scene_from_dict(SCENE | {"measure": {"hertz": "ellipse"}}), sites)
    long = contact_sites(asperities.assign(radius_2_m=3e-4), film)
    with pytest.raises(InputError, match="states a profile, and the table caps of ellipsoidal shape"):
        scene_of_defined_laws(scene_from_dict(SCENE), long)
