"""The scene: keys with units in, SI attributes out, and one sentence for every broken rule."""

import math
import pickle
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contactimg import InputError, scene_from_dict
from contactimg.scene import Effects, Scene

NAN, INF = float("nan"), float("inf")
LIGHT_KEYS = (
    "allowed keys: film_index_indenter, film_index_elastic, film_wavelength_nm, film_bandwidth_nm, "
    "film_range_nm"
)
SECTIONS = "indenter, elastic, asperities, camera, light, images, load, measure, tolerance, effects, simulate"


def refusal(data):
    with pytest.raises(InputError) as caught:
        scene_from_dict(data, name="scene.toml")
    sentence = str(caught.value)
    assert sentence.startswith("scene.toml: ")
    assert "\n" not in sentence
    return sentence.removeprefix("scene.toml: ")


def test_keys_carry_units_and_attributes_are_si():
    scene = scene_from_dict(
        {
            "indenter": {"radius_m": 0.1288, "apex_m": [0.005, 0.004]},
            "elastic": {"young_modulus_Pa": 3.0e6, "poisson_ratio": 0.5, "thickness_m": 0.015},
            "camera": {"pixel_size_m": 6e-6, "rotation_deg": 90, "mirrored": True, "full_scale_levels": 4095},
            "images": {"frames": ["a.tif", "b*.tif"], "polarity": "dark"},
            "measure": {"threshold": "auto"},
            "simulate": {"loads_N": [0, 0.5], "shape": [12, 16]},
        }
    )
    assert scene.indenter.apex == (0.005, 0.004)
    assert scene.elastic.contact_modulus == pytest.approx(4e6, rel=1e-15)  # 3e6/(1 - 0.25)
    assert scene.camera.rotation == pytest.approx(math.pi / 2, rel=1e-15)
    assert (scene.camera.pixel_size, scene.camera.full_scale) == (6e-6, 4095)
    assert (scene.images.frames, scene.images.polarity) == (["a.tif", "b*.tif"], "dark")
    assert scene.measure.threshold == "auto"
    assert (scene.simulate.loads, scene.simulate.shape) == ([0.0, 0.5], (12, 16))


def test_defaults_are_those_of_the_contract():
    scene = scene_from_dict({"camera": {"pixel_size_m": 6e-6}})
    assert (scene.indenter, scene.elastic, scene.asperities, scene.simulate) == (None, None, None, None)
    assert (scene.camera.centre, scene.camera.rotation, scene.camera.mirrored) == (None, 0.0, False)
    assert (scene.images.reference, scene.images.polarity) == (None, "bright")
    assert (scene.measure.method, scene.measure.threshold) == ("disk", 0.5)
    assert (scene.tolerance.output, scene.tolerance.relative) == ("all", 0.01)
    assert set(scene.effects.switches().values()) == {"auto"}
    assert len(Effects().switches()) == 17


def test_image_is_centred_on_the_apex_unless_a_centre_is_given():
    data = {"indenter": {"radius_m": 1, "apex_m": [1e-3, 2e-3]}, "camera": {"pixel_size_m": 6e-6}}
    assert scene_from_dict(data).pose((3, 5)).centre == (1e-3, 2e-3)
    data["camera"]["centre_m"] = [0, 3e-3]
    pose = scene_from_dict(data).pose((3, 5))
    assert (pose.centre, pose.shape, pose.pixel_size) == ((0, 3e-3), (3, 5), 6e-6)


def test_a_shift_of_the_edge_needs_its_uncertainty():
    with pytest.raises(InputError, match=r"edge_shift_px = 0.5 needs edge_shift_std_px"):
        scene_from_dict({"measure": {"edge_shift_px": 0.5}})
    exact = scene_from_dict({"measure": {"edge_shift_px": 0.5, "edge_shift_std_px": 0.0}})
    assert exact.measure.edge_shift_px == 0.5


def test_needed_section_is_asked_for():
    with pytest.raises(
        InputError, match=r"^turning pixels into metres needs a section \[camera\] in the scene; add it$"
    ):
        scene_from_dict({}).pose((3, 5))


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("camera.pixel_size_m", "6e-6", "must be a number, got '6e-6'"),
        ("camera.pixel_size_m", True, "must be a number, got True"),
        ("camera.pixel_size_m", [6e-6], "must be a number, got [6e-06]"),
        ("camera.pixel_size_m", 0, "must be greater than 0, got 0"),
        ("camera.pixel_size_m", -6e-6, "must be greater than 0, got -6e-06"),
        ("camera.pixel_size_m", NAN, "must be a finite number, got nan"),
        ("camera.pixel_size_m", INF, "must be a finite number, got inf"),
        ("camera.mirrored", 1, "must be true or false, got 1"),
        ("camera.mirrored", "yes", "must be true or false, got 'yes'"),
        ("camera.centre_m", [1, 2, 3], "must have no more than 2 items, got [1, 2, 3]"),
        ("camera.centre_m", 3, "must be a list, got 3"),
        ("camera.centre_m[1]", [0, "a"], "must be a number, got 'a'"),
        ("camera.centre_m[1]", [0], "is missing; add it"),
        ("camera.full_scale_levels", 0, "must be greater than 0, got 0"),
        ("simulate.loads_N", 0.1, "must be a list, got 0.1"),
        ("simulate.loads_N[2]", [0.1, 0.2, False], "must be a number, got False"),
        ("simulate.shape[0]", [3.5, 4], "must be a whole number, got 3.5"),
        ("simulate.shape[1]", [3, 0], "must be greater than or equal to 1, got 0"),
        ("simulate.bit_depth", 9, "must be 8, 10, 12, 14 or 16, got 9"),
        ("simulate.seed", -1, "must be greater than or equal to 0, got -1"),
        ("simulate.seed", True, "must be a whole number, got True"),
        ("simulate.supersampling", 17, "must be less than or equal to 16, got 17"),
        ("images.frames", 3, "must be a file, a glob or a list of these, got 3"),
        ("images.frames", [], "must be a file, a glob or a list of these, got []"),
        ("images.frames", ["a", 3], "must be a file, a glob or a list of these, got ['a', 3]"),
        ("images.frames", "", "must be a file, a glob or a list of these, got ''"),
        ("images.reference", "", "must be a file, a glob or a list of these, got ''"),
        ("images.reference", 3, "must be a file, a glob or a list of these, got 3"),
        ("images.polarity", "up", "must be 'bright', 'dark' or 'auto', got 'up'"),
        ("measure.threshold", 1.0, 'must be a number between 0 and 1 (exclusive) or "auto", got 1.0'),
        ("measure.threshold", "0.5", "must be a number between 0 and 1 (exclusive) or \"auto\", got '0.5'"),
        ("measure.threshold", True, 'must be a number between 0 and 1 (exclusive) or "auto", got True'),
        ("measure.method", "disc", "must be 'threshold' or 'disk', got 'disc'"),
        ("elastic.poisson_ratio", 0.6, "must be less than or equal to 0.5, got 0.6"),
        ("elastic.poisson_ratio", -1, "must be greater than -1, got -1"),
        ("asperities.coverage", 1, "must be less than 1, got 1"),
        ("effects.film", True, "must be 'auto', 'on' or 'off', got True"),
    ],
)
def test_value_that_is_refused(key, value, sentence):
    section, name = key.split(".")
    required = {"camera": {"pixel_size_m": 6e-6}, "elastic": {"young_modulus_Pa": 3e6}}
    data = {section: required.get(section, {}) | {name.partition("[")[0]: value}}
    assert refusal(data) == f"[{section}] {name} {sentence}"


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ({"camera": {}}, "[camera] pixel_size_m is missing; add it"),
        ({"camera": 3}, "[camera] must be a section of keys, got 3"),
        ({"camera": [{}]}, "[camera] must be a section of keys, got [{}]"),
        (
            {"indentor": {}},
            f"unknown section [indentor]; did you mean 'indenter'? (allowed sections: {SECTIONS})",
        ),
        ({"xyz": 3}, f"unknown section [xyz] (allowed sections: {SECTIONS})"),
        (
            {"light": {"wavelength_nm": 560}},
            f"[light] has no key 'wavelength_nm'; did you mean 'film_wavelength_nm'? ({LIGHT_KEYS})",
        ),
        (
            {"tolerance": {"realtive": 0.1}},
            "[tolerance] has no key 'realtive'; did you mean 'relative'? (allowed keys: output, relative)",
        ),
        (
            {"tolerance": {"relative": -1, "unit": "m"}},  # the unknown key comes first
            "[tolerance] has no key 'unit' (allowed keys: output, relative)",
        ),
        (
            {"asperities": {"file": "a.csv", "generate": "SA"}},
            "[asperities]: file and generate are both given; keep one of the two",
        ),
        (
            {"asperities": {"height_min_m": 2e-5, "height_max_m": 1e-5}},
            "[asperities]: height_max_m (1e-05) must not be below height_min_m (2e-05)",
        ),
    ],
)
def test_scene_that_is_refused(data, sentence):
    assert refusal(data) == sentence


LIGHT = {"film_wavelength_nm": 530.0, "film_range_nm": [500.0, 560.0]}


@pytest.mark.parametrize(
    "data",
    [
        {"light": LIGHT},
        {"simulate": LIGHT},
        {"light": LIGHT, "simulate": {"shape": [3, 4]}},
        {"light": {"film_wavelength_nm": 530.0}, "simulate": {"film_range_nm": [500.0, 560.0]}},
        {"light": LIGHT, "simulate": LIGHT},
    ],
)
def test_the_lamp_is_the_same_in_light_and_in_its_aliases(data):
    scene = scene_from_dict(data)
    expected = scene_from_dict({"light": LIGHT}).light.model_dump()
    assert expected["film_wavelength_nm"] == 530.0
    assert scene.light.model_dump() == expected
    if scene.simulate is not None:
        assert {key: getattr(scene.simulate, key) for key in expected} == expected
    assert scene_from_dict(scene.configuration).light == scene.light


def test_two_different_lamps_are_refused():
    data = {"light": {"film_wavelength_nm": 530.0}, "simulate": {"film_wavelength_nm": 560.0}}
    assert refusal(data) == (
        "[light] film_wavelength_nm (530.0) and [simulate] film_wavelength_nm (560.0) differ; "
        "keep one of the two"
    )


def test_every_key_says_what_it_means():
    for section, field in Scene.model_fields.items():
        model = next(iter(get_args(field.annotation)), field.annotation)
        assert (model.__doc__ or "").strip(), section
        for key, rule in model.model_fields.items():
            assert (rule.description or "").endswith("."), f"[{section}] {key}"


def test_internal_names_are_no_keys():
    assert refusal({"camera": {"pixel_size": 6e-6, "pixel_size_m": 6e-6}}).startswith(
        "[camera] has no key 'pixel_size'; did you mean 'pixel_size_m'?"
    )


@given(
    st.floats(1e-9, 1e3),
    st.floats(-360, 360),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    st.booleans(),
)
def test_configuration_gives_the_same_scene(pixel_size, rotation, centre, mirrored):
    camera = {"pixel_size_m": pixel_size, "rotation_deg": rotation, "centre_m": centre, "mirrored": mirrored}
    scene = scene_from_dict({"camera": camera})
    again = scene_from_dict(scene.configuration)
    # degrees -> radians -> degrees -> radians: three products, each right to half a unit in the last place
    assert again.camera.rotation == pytest.approx(scene.camera.rotation, rel=2e-15, abs=1e-300)
    assert again.camera.model_copy(update={"rotation": scene.camera.rotation}) == scene.camera


def test_configuration_states_no_more_than_the_scene():
    scene = scene_from_dict({"indenter": {"radius_m": 0.1}, "asperities": {"file": "caps.csv"}})
    again = scene_from_dict(scene.configuration)
    assert "apex" not in again.indenter.model_fields_set
    assert "side" not in again.asperities.model_fields_set
    stated = {"indenter": {"radius_m": 0.1, "apex_m": [0.0, 0.0]}, "asperities": {"side_m": 0.01}}
    again = scene_from_dict(scene_from_dict(stated).configuration)
    assert "apex" in again.indenter.model_fields_set
    assert "side" in again.asperities.model_fields_set


def test_scene_travels_to_workers_with_its_folder():
    scene = scene_from_dict({"camera": {"pixel_size_m": 6e-6}}, folder="somewhere")
    again = pickle.loads(pickle.dumps(scene))  # noqa: S301
    assert (again, again.folder, again.source) == (scene, "somewhere", scene.source)


def test_a_scene_does_not_change():
    scene = scene_from_dict({"camera": {"pixel_size_m": 6e-6}})
    with pytest.raises(ValueError, match="frozen"):
        scene.camera.pixel_size = 1.0
    assert isinstance(scene, Scene)
