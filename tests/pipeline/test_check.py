"""Contacts drawn into frames tell what becomes of the frames' own contacts."""

import numpy as np
import pandas as pd
import pytest
from camera_worlds import make_scene
from contact_frames import match

from contactimg.errors import InputError
from contactimg.files import open_experiment, write_frame
from contactimg.frame import Frame
from contactimg.imaging.measure import measure_image
from contactimg.pipeline.check import check_experiment
from contactimg.scene import scene_from_dict

FOREIGN = ("low light", "Bayer")
"""Frames of a renderer that shares no code with the package."""


def experiment_of(scenes, folder, **measure):
    names = []
    for k, scene in enumerate(scenes):
        for name, image in ((f"frame_{k}.tif", scene.frame), ("reference.tif", scene.reference)):
            write_frame(Frame(image, name), folder / name)
        names.append(f"frame_{k}.tif")
    data = {
        "camera": {"pixel_size_m": 1e-6, "linearity": 0.0},
        "images": {"frames": names, "reference": "reference.tif", "polarity": scenes[0].polarity},
        "measure": measure,
    }
    return open_experiment(scene_from_dict(data, folder=str(folder)))


@pytest.mark.parametrize("world", FOREIGN)
def test_drawn_contacts_tell_the_errors_of_the_frames_own(world, tmp_path):
    scene = make_scene(world, 140, 51)
    result = check_experiment(experiment_of([scene], tmp_path))
    disks = measure_image(scene.frame, scene.reference, polarity=scene.polarity, linearity=0.0).disks
    truth = scene.truth[scene.truth.required].reset_index(drop=True)
    pairs = match(truth, disks)
    low = float(result.drawn["radius_px"].min())
    wanted = truth["radius_px"].to_numpy() > low
    completeness = np.isin(np.flatnonzero(wanted), pairs[:, 0]).mean()
    drawn = result.drawn[result.drawn["radius_px"] > truth["radius_px"].min()]
    share = drawn["found"].mean()
    std = np.sqrt((drawn["found"].sum() + 1) * ((1 - drawn["found"]).sum() + 1)) / len(drawn) ** 1.5
    assert abs(share - completeness) < 3 * std + 1 / len(truth)
    error = disks["radius_px"].to_numpy()[pairs[:, 1]] - truth["radius_px"].to_numpy()[pairs[:, 0]]
    own = error[(truth["radius_px"].to_numpy()[pairs[:, 0]] > 2)]
    found = result.drawn[(result.drawn["found"] == 1) & (result.drawn["radius_px"] > 2)]
    other = (found["measured_px"] - found["radius_px"]).to_numpy()
    both = np.hypot(np.std(own) / np.sqrt(len(own)), np.std(other) / np.sqrt(len(other)))
    assert abs(np.mean(other) - np.mean(own)) < 3 * both
    assert np.sqrt(np.mean(other**2)) == pytest.approx(np.sqrt(np.mean(own**2)), rel=0.6)


def test_a_blur_that_is_set_wrong_shows_as_bias(tmp_path):
    scene = make_scene("plain", 140, 51)
    right = check_experiment(experiment_of([scene], tmp_path)).drawn
    wrong = check_experiment(experiment_of([scene], tmp_path, method="threshold", threshold=0.3)).drawn
    bias = [
        float((part["measured_px"] - part["radius_px"])[part["radius_px"] > 4].mean())
        for part in (right, wrong)
    ]
    # pixels above 0.3 of the contrast reach 0.52 blur widths beyond the rim
    assert abs(bias[0]) < 0.02
    assert bias[1] > 0.4


def test_classes_count_every_drawn_contact_once_and_the_same_seed_draws_the_same(tmp_path):
    experiment = experiment_of([make_scene("plain", 25, 51)], tmp_path)
    result, again = (check_experiment(experiment) for _ in range(2))
    assert result.classes["drawn"].sum() == len(result.drawn)
    assert result.classes["found"].sum() == result.drawn["found"].sum()
    assert "are found" in result.sentence
    pd.testing.assert_frame_equal(result.drawn, again.drawn)


def test_frames_without_contacts_are_refused_with_the_reason(tmp_path):
    scene = make_scene("plain", 25, 51)
    for name in ("frame_0.tif", "reference.tif"):
        write_frame(Frame(scene.reference, name), tmp_path / name)
    data = {
        "camera": {"pixel_size_m": 1e-6},
        "images": {"frames": "frame_*.tif", "reference": "reference.tif"},
    }
    experiment = open_experiment(scene_from_dict(data, folder=str(tmp_path)))
    with pytest.raises(InputError, match="no frame shows contacts like which others could be drawn"):
        check_experiment(experiment)
