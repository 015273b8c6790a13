"""Asperity tables with ellipsoids and unequal moduli, from the model through frames to measured forces."""

import numpy as np
import pandas as pd
import pytest

from contactimg.errors import InputError
from contactimg.files import open_experiment, read_scene, write_table
from contactimg.forces import local_forces, sphere_radii
from contactimg.pipeline.analyse.places import radius_ratios
from contactimg.pipeline.calibrate.thresholds import measure_thresholds
from contactimg.pipeline.inputs import contact_sites, scene_of_defined_laws
from contactimg.pipeline.overlay import compare_run
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import simulate_series, write_simulation
from contactimg.pipeline.tradeoff import prepare_tradeoff
from contactimg.plausibility import doubts_about_scene
from contactimg.prediction import predict_contacts
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities
from contactimg.tables import ASPERITIES, CONTACTS, Flag

SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [6e-4, 4.5e-4]},
    "elastic": {"young_modulus_Pa": 3e6, "young_modulus_std_Pa": 1e5},
    "asperities": {"file": "asperities.csv", "side_m": 1.2e-3},
    "camera": {"pixel_size_m": 2.5e-6, "centre_m": [6e-4, 4.5e-4], "rotation_deg": 3.0},
    "simulate": {
        "loads_N": [0.02],
        "shape": [320, 420],
        "blur_px": 1.2,
        "read_noise_electrons": 20.0,
        "electrons_per_level": 100.0,
    },
    "measure": {"shape": "auto", "hertz": "ellipse"},
}


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(21)
    caps = generate_asperities("SA", side=1.2e-3, coverage=0.25, rng=rng)
    moduli = np.where(np.arange(len(caps)) % 2, np.nan, 6e6)
    return caps.assign(
        radius_2_m=caps["radius_m"] * np.where(np.arange(len(caps)) % 3, 1.0, 2.5),
        azimuth_rad=rng.uniform(-1.5, 1.5, len(caps)),
        young_modulus_Pa=moduli,
    )


@pytest.mark.parametrize("measured", ["equal_area", "ellipse"])
def test_the_forces_of_true_contacts_are_the_model_s(table, measured):
    scene = scene_from_dict(SCENE | {"measure": {"hertz": measured}})
    sites = contact_sites(table, scene)
    truth = predict_contacts(scene, table, load=0.02).contacts
    assert {"disk", "ellipse"} == set(truth["shape"])
    seen = truth.assign(
        semi_major_px=truth["semi_major_m"] / 2.5e-6, semi_minor_px=truth["semi_minor_m"] / 2.5e-6
    )
    scene = scene_of_defined_laws(scene, sites)
    found, exponent = local_forces(scene, CONTACTS.conform(seen.assign(force_N=np.nan, flags=0)), sites)
    np.testing.assert_allclose(found["force_N"], truth["force_N"], rtol=1e-9)
    assert (exponent == 3.0).all()
    np.testing.assert_array_equal(
        found["flags"] & int(Flag.BEYOND_HERTZ), truth["flags"] & int(Flag.BEYOND_HERTZ)
    )
    plain = sphere_radii(truth, scene, contact_sites(table[list(ASPERITIES.first)], scene))
    changed = sphere_radii(truth, scene_from_dict(SCENE | {"measure": {"hertz": "equal_area"}}), sites)
    assert np.ptp(plain) < 1e-3 * plain.mean()
    assert np.ptp(changed) > plain.mean()  # halved by the moduli, 1.58 times by the ellipsoids


def test_laws_that_are_not_defined_are_refused_or_left_out(table):
    sites = contact_sites(table, scene_from_dict(SCENE))
    left = scene_of_defined_laws(scene_from_dict(SCENE), sites)
    assert (left.effects.adhesion, left.effects.sphere_profile) == ("off", "off")
    ordered = scene_from_dict(SCENE | {"effects": {"adhesion": "on"}})
    with pytest.raises(
        InputError, match="adhesion is not defined for asperities of ellipsoidal shape and of"
    ):
        scene_of_defined_laws(ordered, sites)
    plain = scene_from_dict(SCENE)
    assert scene_of_defined_laws(plain, contact_sites(table[list(ASPERITIES.first)], plain)) is plain


def test_rendered_ellipses_are_measured_and_bear_their_forces(table, tmp_path):
    scene = scene_from_dict(SCENE)
    write_simulation(scene, table, tmp_path)
    truth = pd.read_csv(tmp_path / "truth.csv")
    run = measure_series(read_scene(tmp_path), workers=1)
    found = run.contacts[run.contacts["asperity"].notna()]
    found = found.assign(asperity=found["asperity"].astype(int))
    pairs = truth.merge(found, on="asperity", suffixes=("", "_found"))
    assert len(pairs) == run.frames["n_contacts"][0] == 8  # three lie outside the frame
    assert run.frames["law"][0] == "hertz+ellipse+modulus"
    # measured: forces 1.2 %, half-axes 1 %, angles 2 mrad at the worst of the wide ellipses
    wide = pairs[(pairs["shape"] == "ellipse") & (pairs["radius_px"] > 4)]
    assert len(wide) == 3
    for name in ("semi_major_px", "semi_minor_px"):
        np.testing.assert_allclose(wide[f"{name}_found"], wide[name], rtol=0.02)
    np.testing.assert_allclose(wide["angle_rad_found"], wide["angle_rad"], atol=0.01)
    np.testing.assert_allclose(pairs["force_N_found"], pairs["force_N"], rtol=0.05, atol=1e-5)
    scores = compare_run(run, table).scores.set_index("model")
    assert scores.loc["coupled", "f1"] == 1
    assert scores.loc["coupled", "radius_rms_m"] < 0.1 * scores.loc["uncoupled", "radius_rms_m"]


def test_the_film_surrounds_circles_only(table):
    with pytest.raises(InputError, match="the air film is rendered around circular contacts"):
        list(simulate_series(scene_from_dict(SCENE | {"effects": {"film": "on"}}), table))


def test_a_modulus_is_calibrated_where_all_asperities_have_it(table, tmp_path):
    scene = scene_from_dict(SCENE)
    write_simulation(scene, table.drop(columns=["radius_2_m", "azimuth_rad"]), tmp_path)
    with pytest.raises(InputError, match="calibrate takes asperities of one modulus; leave the column young"):
        measure_thresholds(open_experiment(read_scene(tmp_path)), [0.5], workers=1)


def test_tradeoff_takes_spherical_caps(table, tmp_path):
    write_table(table, ASPERITIES, tmp_path / "asperities.csv")
    scene = scene_from_dict(SCENE, folder=tmp_path)
    with pytest.raises(InputError, match="tradeoff takes spherical caps of one modulus; leave the column"):
        prepare_tradeoff(scene, load=0.02)


def test_moduli_and_radii_in_another_unit_are_doubted(table):
    scene = scene_from_dict(SCENE)
    assert not list(doubts_about_scene(scene, table))
    slips = table.assign(young_modulus_Pa=6.0, radius_2_m=250.0)
    doubts = " ".join(doubts_about_scene(scene, slips))
    assert "the median of young_modulus_Pa of the asperities = 6 is outside" in doubts
    assert "the median of radius_2_m of the asperities = 250 is outside" in doubts
    empty = table.assign(young_modulus_Pa=np.nan, radius_2_m=np.nan)
    assert not list(doubts_about_scene(scene, empty))


def test_a_over_r_of_ellipsoids_takes_the_geometric_mean(table):
    scene = scene_from_dict(SCENE)
    truth = predict_contacts(scene, table, load=0.02).contacts
    second = table["radius_2_m"].to_numpy()[truth["asperity"].to_numpy(int)]
    np.testing.assert_allclose(radius_ratios(truth, scene, table), truth["radius_m"] / np.sqrt(1e-4 * second))
