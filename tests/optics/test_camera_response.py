"""The response of the camera: power laws and tables, and where frames are linearised."""

import numpy as np
import pytest

from contactimg import FrameError, InputError, scene_from_dict
from contactimg.files import open_experiment, write_frame
from contactimg.frame import Frame
from contactimg.optics.sensor import linear_light, linearise
from contactimg.scene import Camera


def camera(**keys):
    return Camera(pixel_size_m=6e-6, **keys)


def encode(light, gamma, full_scale=255.0):
    return np.rint(full_scale * (light / full_scale) ** gamma)


@pytest.mark.parametrize(("dtype", "full_scale"), [(np.uint8, 255.0), (np.uint16, 4095.0)])
def test_a_power_law_is_undone_to_a_step_of_the_digitisation(dtype, full_scale):
    light = np.linspace(0.05, 1.0, 600).reshape(20, 30) * full_scale
    frame = Frame(encode(light, 0.45, full_scale).astype(dtype), "f", full_scale)
    linear = linearise(frame, camera(gamma=0.45))
    # half a level of the encoded image, times the largest slope dL/dg = 1/gamma
    assert np.abs(linear.image - light).max() <= 0.5 / 0.45
    assert linear.image.dtype == np.float32
    assert linear.full_scale == full_scale
    assert (linear.image[frame.image >= full_scale] >= full_scale).all()


def test_a_table_of_the_same_curve_gives_the_same_light():
    levels = np.linspace(0, 255, 52)
    table = camera(response=list(zip(levels.tolist(), (7.0 * (levels / 255) ** 2).tolist(), strict=True)))
    everything = np.arange(256.0)
    power = linear_light(everything, camera(gamma=0.5), full_scale=255.0)
    np.testing.assert_allclose(linear_light(everything, table, full_scale=255.0), power, atol=0.02)


def test_beyond_its_ends_a_table_goes_straight_on():
    table = camera(response=((10.0, 1.0), (20.0, 2.0), (30.0, 3.0)))
    light = linear_light([0.0, 15.0, 60.0], table, full_scale=60.0)
    np.testing.assert_allclose(light, [0.0, 15.0, 60.0], atol=1e-12)


def test_an_image_of_floats_needs_its_full_scale():
    with pytest.raises(FrameError, match="give \\[camera\\] full_scale_levels"):
        linearise(Frame(np.ones((3, 4)), "f"), camera(gamma=0.5))


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"gamma": 0.5, "response": [[0, 0], [255, 1]]}, "gamma and response are both given"),
        ({"response": [[0, 0]]}, "two or more pairs"),
        ({"response": [[0, 0], [255, 0]]}, "both increasing"),
        ({"response": []}, "two or more pairs"),
    ],
)
def test_a_response_without_sense_is_refused(keys, sentence):
    with pytest.raises(InputError, match=sentence):
        scene_from_dict({"camera": {"pixel_size_m": 6e-6} | keys})


def test_every_frame_and_the_reference_of_a_scene_are_linearised(tmp_path):
    light = np.linspace(20.0, 200.0, 48).reshape(6, 8)
    for name in ("reference.tif", "frame_1.tif"):
        write_frame(Frame(encode(light, 0.45).astype(np.uint8), name, 255.0), tmp_path / name)
    images = {"reference": "reference.tif"}
    for keys, expected in (({"gamma": 0.45}, light), ({}, encode(light, 0.45))):
        data = {"camera": {"pixel_size_m": 6e-6} | keys, "images": images}
        experiment = open_experiment(scene_from_dict(data, folder=str(tmp_path)))
        for source in (experiment.references[0], *experiment.frames):
            assert np.abs(source.read().image - expected).max() <= 0.5 / 0.45
