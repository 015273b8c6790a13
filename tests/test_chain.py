"""The whole chain on the sample data: accuracy, an unknown pose, corrections switched off."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from contactimg.files import open_experiment, read_scene
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.overlay import compare_run
from contactimg.pipeline.series import measure_parts, measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.pose.pairs import pair_points
from contactimg.scene import scene_from_dict

SAMPLES = Path(__file__).parents[1] / "sample_data"
PIXEL = 6e-6


@pytest.fixture(scope="module")
def sample_series():
    return measure_parts(open_experiment(read_scene(SAMPLES / "sa_plus")))


@pytest.fixture(scope="module")
def sample_run(sample_series):
    return sample_series.run


@pytest.fixture(scope="module")
def truth():
    return pd.read_csv(SAMPLES / "sa_plus" / "truth.csv")


def pairs_with_truth(run, truth, frame):
    """Measured and true contacts of a frame, and the rows of each that belong together."""
    measured = run.contacts[run.contacts["frame"] == frame].reset_index(drop=True)
    true = truth[truth["frame"] == frame].reset_index(drop=True)
    columns = ["x_px", "y_px"]
    i, j, _ = pair_points(measured[columns], true[columns], max_distance=2.0)
    return measured, true, i, j


def last_frame_seen_by(series, camera, *, flipped=None, **sections):
    """The run of the sample's last frame, measured as ever, its image flipped, under another [camera]."""
    part, source = series.parts[-1], read_scene(SAMPLES / "sa_plus").source
    scene = scene_from_dict(source | {"camera": camera} | sections, folder=str(SAMPLES / "sa_plus"))
    shift, columns = ("shift_x_px", "shift_y_px"), {"x_px": part.shape[1], "y_px": part.shape[0]}
    if flipped is not None:
        contacts = part.contacts.assign(**{flipped: columns[flipped] - 1 - part.contacts[flipped]})
        name = shift[list(columns).index(flipped)]
        part = replace(part.with_contacts(contacts), row=part.row | {name: -part.row[name]})
    one = replace(series, scene=scene, parts=[part])
    return one.posed().run


def coupled_and_uncoupled(run):
    scores = compare_run(run, need_asperities(run.scene, "a test")).scores
    table = scores.pivot_table(index="frame", columns="model", values="f1")
    return table["coupled"].to_numpy(), table["uncoupled"].to_numpy()


# sa_plus against its truth, no tuning


def test_contacts_are_found_and_nothing_else(sample_run, truth):
    for frame in sample_run.frames["frame"]:
        measured, true, i, j = pairs_with_truth(sample_run, truth, frame)
        large, large_true = measured["radius_px"] >= 2, true["radius_px"] >= 2
        assert np.isin(np.flatnonzero(large), i).mean() >= 0.98
        assert np.isin(np.flatnonzero(large_true), j).mean() >= 0.98


def test_area_and_forces_at_every_load(sample_run, truth):
    area = truth.groupby("frame")["area_m2"].sum()
    frames = sample_run.frames.set_index("frame")
    np.testing.assert_allclose(frames["area_m2"], area[frames.index], rtol=0.02)
    np.testing.assert_allclose(frames["force_sum_N"], frames["load_N"], rtol=0.05)


def test_every_contact_has_its_own_asperity_and_force(sample_run, truth):
    for frame in sample_run.frames["frame"]:
        measured, true, i, j = pairs_with_truth(sample_run, truth, frame)
        assert measured["asperity"][i].tolist() == true["asperity"][j].tolist()
        assert measured["force_N"].notna().all()


def test_stated_uncertainty_of_the_radius_is_the_scatter(sample_run, truth):
    pulls = []
    for frame in sample_run.frames["frame"]:
        measured, true, i, j = pairs_with_truth(sample_run, truth, frame)
        error = measured["radius_px"].to_numpy()[i] - true["radius_px"].to_numpy()[j]
        # of the error that a contact and a frame show; what no fit can see comes on top
        variance = measured["radius_std_px"] ** 2 - measured["edge_shift_px"] ** 2
        pulls.append(error / np.sqrt(variance.to_numpy())[i])
    inside = np.mean(np.abs(np.concatenate(pulls)) < 1)
    # 881 contacts: a share of 0.68 scatters by 0.016; the blur and contrast they share scatter more
    assert 0.55 < inside < 0.8


def test_coupled_model_agrees_and_the_uncoupled_does_not(sample_run):
    coupled, uncoupled = coupled_and_uncoupled(sample_run)
    assert coupled.min() >= 0.97
    assert uncoupled[-1] < 0.9


# the pose used for rendering is handed over to nobody


@pytest.mark.parametrize(
    "camera",
    [
        {"pixel_size_m": 6.06e-6, "centre_m": [0.005 + 21e-6, 0.005 - 21e-6], "rotation_deg": 0.5},
        {"pixel_size_m": 5.94e-6, "centre_m": [0.005 - 21e-6, 0.005 - 21e-6], "rotation_deg": -0.5},
    ],
)
def test_a_wrong_pose_in_the_scene_is_put_right(sample_series, camera):
    run = last_frame_seen_by(sample_series, camera)
    assert run.pose.fitted
    coupled, uncoupled = coupled_and_uncoupled(run)
    assert coupled[0] >= 0.97
    assert uncoupled[0] < 0.9
    assert run.pose.pose.pixel_size == pytest.approx(PIXEL, rel=1e-4)
    assert run.frames["force_sum_N"][0] == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize(("flipped", "turn"), [("y_px", 0.0), ("x_px", 180.0)])
def test_a_mirrored_image_is_recognised(sample_series, flipped, turn):
    camera = {"pixel_size_m": PIXEL, "rotation_deg": turn}
    run = last_frame_seen_by(sample_series, camera, flipped=flipped)
    assert run.pose.pose.mirrored
    assert coupled_and_uncoupled(run)[0][0] >= 0.97


def test_without_fitting_the_pose_a_wrong_one_spoils_matches_and_forces(sample_series):
    camera = {"pixel_size_m": 6.06e-6, "centre_m": [0.00503, 0.005], "rotation_deg": 0.5}
    run = last_frame_seen_by(sample_series, camera, measure={"pose": "given"})
    assert coupled_and_uncoupled(run)[0][0] < 0.6
    # the pixel size enters the force to the third power: 1.01^3
    assert run.frames["force_sum_N"][0] == pytest.approx(0.5 * 1.01**3, rel=5e-3)


# frames that the estimator's model does not contain

SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.005, 0.005]},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.01, "seed": 77},
    "camera": {"pixel_size_m": PIXEL},
    "effects": {"model": "paper"},
    "simulate": {
        "loads_N": [0.2],
        "shape": [820, 1000],
        "texture": 0.02,
        "vignetting": 0.15,
        "light_drift": 0.02,
        "position_drift_px": 0.3,
        "electrons_per_level": 20,
        "read_noise_electrons": 10,
        "seed": 78,
    },
}
# largest errors of area and force; on other seeds `benchmarks/run.py chain.accuracy` gives: halo 1.9 and
# 3.5 %, Airy 1.4 and 2.4 %, spread 0.6 and 0.7 %, film 3.8 and 5.1 %: its rim adds to the radius
FOREIGN = {
    "halo": ({"psf": "halo"}, "off", 0.03, 0.05),
    "airy": ({"psf": "airy"}, "off", 0.02, 0.04),
    "spread": ({"brightness_spread": 0.05}, "off", 0.02, 0.03),
    "film": ({}, "on", 0.06, 0.08),
}
WITH_ITS_RIM = (0.01, 0.015)


def errors_of_sums(folder, film):
    """Relative errors of area and force of the frame of a folder, measured with the film on or off."""
    source = read_scene(folder).source
    scene = scene_from_dict(source | {"effects": {"model": "paper", "film": film}}, folder=str(folder))
    run, truth = measure_series(scene, workers=1), pd.read_csv(folder / "truth.csv")
    _, true, _, j = pairs_with_truth(run, truth, "frame_1.tif")
    assert np.isin(np.flatnonzero(true["radius_px"] >= 2), j).mean() >= 0.98
    area = run.frames["area_m2"][0] / true["area_m2"].sum() - 1
    return area, run.frames["force_sum_N"][0] / run.frames["load_N"][0] - 1


@pytest.mark.parametrize("name", FOREIGN)
def test_frames_foreign_to_the_estimator(name, tmp_path):
    optics, film, *limits = FOREIGN[name]
    effects = {"effects": SCENE["effects"] | {"film": film}}
    scene = scene_from_dict(SCENE | {"simulate": SCENE["simulate"] | optics} | effects)
    write_simulation(scene, need_asperities(scene, "a test"), tmp_path)
    found = np.abs(errors_of_sums(tmp_path, "off"))
    assert (found < limits).all()
    if film == "on":
        assert found[1] > 0.02  # the bias is real: a disk is not this edge
        assert (np.abs(errors_of_sums(tmp_path, "on")) < WITH_ITS_RIM).all()
