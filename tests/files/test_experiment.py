"""A scene and the files it names: found, ordered, checked against each other, or one sentence."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from contactimg import Frame, InputError, read_scene, scene_from_dict
from contactimg.files import open_experiment, write_frame, write_scene
from contactimg.tables import LOADS


@pytest.fixture
def folder(tmp_path):
    """Three frames, a reference, loads and asperities."""
    for k in (1, 2, 10):
        write_frame(Frame(np.full((3, 4), k, np.uint16)), tmp_path / f"frame_{k}.tif")
    write_frame(Frame(np.zeros((3, 4), np.uint16)), tmp_path / "reference.tif")
    rows = "frame_10.tif,0.5\nframe_1.tif,0.02\nframe_2.tif,0.1\n"
    (tmp_path / "loads.csv").write_text(f"frame,load_N\n{rows}")
    (tmp_path / "asperities.csv").write_text("x_m,y_m,height_m,radius_m\n0,0,4e-5,1e-4\n")
    return tmp_path


def experiment_of(folder, **sections):
    return open_experiment(scene_from_dict(sections, folder=str(folder)))


def refusal(folder, **sections):
    with pytest.raises(InputError) as caught:
        experiment_of(folder, **sections)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def names(experiment):
    return [frame.name for frame in experiment.frames]


# ---------------------------------------------------------------- the scene file


def test_scene_is_read_from_a_folder_or_a_file(tmp_path):
    text = "\ufeff[camera]\npixel_size_m = 6.0e-6  # 6 µm\n"
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    (tmp_path / "other.toml").write_text(text, encoding="utf-8")
    for path in (tmp_path, str(tmp_path), tmp_path / "scene.toml", tmp_path / "other.toml"):
        scene = read_scene(path)
        assert scene.camera.pixel_size == 6e-6
        assert scene.folder == str(tmp_path)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (
            b"[camera]\npixel_size_m = \n",
            "is not valid TOML: Invalid value (at line 2, column 16): pixel_size_m =",
        ),
        (
            b"[camera]\n[camera]\n",
            "is not valid TOML: Cannot declare ('camera',) twice (at line 2, column 8): [camera]",
        ),
        (b"a = '\xb5'\n", "is not UTF-8 text; save it in UTF-8"),
        (b"[camera]\npixel_size_m = -6e-6\n", "[camera] pixel_size_m must be greater than 0, got -6e-06"),
        (b"[camera]\npixel_size_m = 0\n", "[camera] pixel_size_m must be greater than 0, got 0"),
        (
            b"[camera]\npixel_size_um = 6\n",
            (
                "[camera] has no key 'pixel_size_um'; did you mean 'pixel_size_m'? (allowed keys: "
                "pixel_size_m, centre_m, rotation_deg, mirrored, full_scale_levels, gamma, response, "
                "linearity)"
            ),
        ),
    ],
)
def test_scene_that_is_refused(tmp_path, content, sentence):
    (tmp_path / "scene.toml").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_scene(tmp_path)
    assert str(caught.value) == f"{tmp_path / 'scene.toml'}: {sentence}"


@pytest.mark.parametrize(
    ("camera", "sentence"),
    [
        ({}, "no areas in m2 and no forces; state [camera] pixel_size_m (f.tif states pixels of 3 µm)"),
        ({"camera": {"pixel_size_m": 6e-6}}, "f.tif states pixels of 3 µm, the scene pixels of 6 µm"),
        ({"camera": {"pixel_size_m": 3.1e-6}}, ""),
    ],
)
def test_a_pixel_size_that_headers_contradict_is_told(tmp_path, caplog, camera, sentence):
    pixels, resolution = np.zeros((20, 30), np.uint8), (1 / 3, 1 / 3)
    tifffile.imwrite(tmp_path / "f.tif", pixels, imagej=True, resolution=resolution, metadata={"unit": "um"})
    open_experiment(scene_from_dict(camera, folder=str(tmp_path)))
    assert sentence in caplog.text
    assert bool(caplog.text) == bool(sentence)


def test_no_scene_file(tmp_path):
    with pytest.raises(InputError) as caught:
        read_scene(tmp_path)
    assert str(caught.value) == (
        f"{tmp_path / 'scene.toml'}: there is no such scene file; write one, or give its path"
    )
    (tmp_path / "scene.toml").mkdir()
    with pytest.raises(
        InputError, match=r"scene\.toml: cannot be read \(Is a directory\)$|Permission denied"
    ):
        read_scene(tmp_path)


def test_written_scene_is_read_back(tmp_path):
    data = {
        "camera": {"pixel_size_m": 1 / 3e5, "rotation_deg": -0.25},
        "simulate": {"loads_N": [0.02, 0.5], "shape": [3, 4]},
    }
    write_scene(data, tmp_path / "scene.toml")
    assert read_scene(tmp_path).source == data
    with pytest.raises(InputError, match=r"unknown section \[camra\]"):
        write_scene({"camra": {}}, tmp_path / "scene.toml")
    assert read_scene(tmp_path).source == data


def test_configuration_is_a_scene_file_of_its_own(tmp_path):
    scene = scene_from_dict(
        {"indenter": {"radius_m": 0.1288}, "asperities": {"generate": "SA", "coverage": 0.4}}
    )
    write_scene(scene.configuration, tmp_path / "scene.toml")
    assert read_scene(tmp_path).configuration == scene.configuration
    assert json.loads(json.dumps(scene.configuration)) == scene.configuration


# ---------------------------------------------------------------- frames and reference


def test_frames_in_natural_order_with_loads_in_theirs(folder):
    experiment = experiment_of(
        folder, images={"reference": "reference.tif"}, asperities={"file": "asperities.csv"}
    )
    assert names(experiment) == ["frame_1.tif", "frame_2.tif", "frame_10.tif"]
    assert list(experiment.loads) == list(LOADS.columns)
    assert experiment.loads["frame"].tolist() == names(experiment)
    assert experiment.loads["load_N"].tolist() == [0.02, 0.1, 0.5]
    assert experiment.load_of("frame_10.tif") == 0.5
    assert np.isnan(experiment.load_of("no such frame"))
    assert experiment.references[0].read().image.max() == 0
    assert len(experiment.asperities) == 1
    assert [path.name for path in experiment.inputs] == [
        "reference.tif",
        *names(experiment),
        "loads.csv",
        "asperities.csv",
    ]


def test_what_a_scene_leaves_out(folder):
    experiment = experiment_of(folder)
    assert names(experiment) == ["frame_1.tif", "frame_2.tif", "frame_10.tif"]
    assert (experiment.references, experiment.asperities) == ((), None)
    for path in folder.glob("frame_*"):
        path.rename(folder / path.name.replace("frame", "shot"))
    (folder / "loads.csv").unlink()
    experiment = experiment_of(folder, images={"reference": "reference.tif"})
    assert names(experiment) == ["shot_1.tif", "shot_2.tif", "shot_10.tif"]
    assert experiment.loads["load_N"].isna().all()


@pytest.mark.parametrize("frames", ["*.tif", "sub/../*.tif"])
@pytest.mark.parametrize("reference", ["reference.tif", "./reference.tif", "sub/../reference.tif"])
def test_reference_is_no_frame_even_if_the_glob_matches_it(folder, reference, frames):
    (folder / "sub").mkdir()
    experiment = experiment_of(folder, images={"reference": reference, "frames": frames})
    assert names(experiment) == ["frame_1.tif", "frame_2.tif", "frame_10.tif"]


@pytest.mark.parametrize("frames", [".", "*.tif", ["frame_1.tif", "frame_2.tif", "frame_10.tif", "R*.tif"]])
def test_a_file_called_reference_is_no_frame_even_if_no_reference_is_named(folder, frames, caplog):
    (folder / "reference.tif").rename(folder / "Reference.tif")
    experiment = experiment_of(folder, images={"frames": frames})
    assert experiment.references == ()
    assert names(experiment) == ["frame_1.tif", "frame_2.tif", "frame_10.tif"]
    assert "Reference.tif is not measured as a frame; name it as the reference" in caplog.text


def test_a_file_called_reference_is_a_frame_where_it_is_named_as_one(folder):
    experiment = experiment_of(folder, images={"frames": ["reference.tif", "frame_1.tif"]})
    assert experiment.references == ()
    assert names(experiment) == ["reference.tif", "frame_1.tif"]


def test_a_folder_with_nothing_but_a_reference(folder):
    for path in folder.glob("frame_*"):
        path.unlink()
    assert refusal(folder) == f"{folder}: there is no frame besides the reference reference.tif"


def test_tables_called_frame_are_no_frames(folder):
    for path in folder.glob("frame_*"):
        path.rename(folder / path.name.replace("frame", "img"))
    (folder / "loads.csv").rename(folder / "frame_times.csv")
    experiment = experiment_of(folder, images={"reference": "reference.tif"})
    assert names(experiment) == ["img_1.tif", "img_2.tif", "img_10.tif"]


def test_page_of_a_stack_as_reference(folder):
    with_pages = folder / "s.tif"
    import tifffile

    tifffile.imwrite(
        with_pages, np.arange(3 * 20).reshape(3, 4, 5).astype(np.uint8), photometric="minisblack"
    )
    (folder / "loads.csv").unlink()
    experiment = experiment_of(folder, images={"reference": "s.tif[0]", "frames": "s.tif"})
    assert experiment.references[0].read().image[0, 0] == 0
    assert names(experiment) == ["s.tif[1]", "s.tif[2]"]
    assert list(experiment.inputs) == [with_pages]
    path = folder / "s.tif[3]"
    sentence = f"[images] reference: {path}: there is no such image; name one of s.tif[0] ... s.tif[2]"
    assert refusal(folder, images={"reference": "s.tif[3]", "frames": "s.tif"}) == sentence
    sentence = f"{folder}: there is no frame besides the reference s.tif[0], s.tif[1], s.tif[2]"
    assert refusal(folder, images={"reference": "s.tif", "frames": "s.tif"}) == sentence


@pytest.mark.parametrize(
    ("reference", "expected"),
    [
        (["reference.tif", "frame_1.tif"], ["reference.tif", "frame_1.tif"]),
        (["reference.tif", "reference.tif"], ["reference.tif"]),
        ("frame_1*.tif", ["frame_1.tif", "frame_10.tif"]),
    ],
)
def test_several_references(folder, reference, expected):
    (folder / "loads.csv").unlink(missing_ok=True)
    experiment = experiment_of(folder, images={"reference": reference})
    assert [source.name for source in experiment.references] == expected
    assert not set(expected) & set(names(experiment))
    assert {source.path for source in experiment.references} <= set(experiment.inputs)


def test_missing_reference_among_several(folder):
    sentence = f"[images] reference: {folder / 'other.tif'}: there is no such file or folder"
    assert refusal(folder, images={"reference": ["reference.tif", "other.tif"]}) == sentence


def test_absolute_paths(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    images = {"reference": str(folder / "reference.tif"), "frames": f"{folder}/frame_*.tif"}
    images |= {"loads": str(folder / "loads.csv")}
    experiment = experiment_of(elsewhere, images=images)
    assert experiment.load_of("frame_2.tif") == 0.1
    assert experiment.references[0].path == folder / "reference.tif"


def test_reference_that_is_missing(folder):
    sentence = f"[images] reference: {folder / 'dark.tif'}: there is no such file or folder"
    assert refusal(folder, images={"reference": "dark.tif"}) == sentence
    assert refusal(folder, images={"reference": "dark.tif[0]"}) == sentence


def test_single_images_of_a_stack_as_frames(folder):
    import tifffile

    stack = np.arange(3 * 20).reshape(3, 4, 5).astype(np.uint8)
    (folder / "loads.csv").unlink()
    for name in ("s.tif", "dark.tif"):  # a file that is named is a frame, whatever it is called
        tifffile.imwrite(folder / name, stack, photometric="minisblack")
        experiment = experiment_of(folder, images={"frames": [f"{name}[2]", f"{name}[0]"]})
        assert names(experiment) == [f"{name}[2]", f"{name}[0]"]
        assert [frame.read().image[0, 0] for frame in experiment.frames] == [40, 0]


def test_frames_that_are_not_there(folder):
    start = f"{folder / 'shot_*.tif'} matches no image file; looked for .tif,"
    assert refusal(folder, images={"frames": "shot_*.tif"}).startswith(start)
    for path in folder.glob("frame_*"):
        path.unlink()
    assert refusal(folder, images={"reference": "reference.tif"}) == (
        f"{folder}: there is no frame besides the reference reference.tif"
    )
    (folder / "reference.tif").unlink()
    assert refusal(folder).startswith(f"{folder} holds no image file; looked for .tif,")


def test_full_scale_of_the_camera_holds_for_every_frame(folder):
    camera = {"pixel_size_m": 6e-6, "full_scale_levels": 4095}
    experiment = experiment_of(folder, camera=camera, images={"reference": "reference.tif"})
    sources = [experiment.references[0], *experiment.frames]
    assert {source.read().full_scale for source in sources} == {4095}


# ---------------------------------------------------------------- loads and asperities


def test_frame_without_load_and_load_without_frame_are_told(folder, caplog):
    rows = "".join(f"lost_{k}.tif,1\n" for k in range(5))
    (folder / "loads.csv").write_text(f"frame,load_N\nframe_2.tif,0.1\n{rows}")
    experiment = experiment_of(folder, camera={"pixel_size_m": 6e-6})
    np.testing.assert_array_equal(experiment.loads["load_N"], [np.nan, 0.1, np.nan])
    lost = "lost_0.tif, lost_1.tif, lost_2.tif and 2 more"
    assert caplog.messages == [
        f"{folder / 'loads.csv'} has loads for frames that are not there: {lost}",
        f"{folder / 'loads.csv'} has no load for the frames: frame_1.tif, frame_10.tif",
    ]


def test_a_load_of_a_name_that_two_frames_share_is_refused(folder):
    write_frame(Frame(np.zeros((3, 4), np.uint16)), folder / "frame_2.tiff")
    (folder / "loads.csv").write_text("frame,load_N\nframe_1,0.1\nframe_2,0.2\n")
    several = "frame_2 means several frames (frame_2.tif, frame_2.tiff): give the whole name"
    assert refusal(folder) == f"{folder / 'loads.csv'}: {several}"


def test_loads_of_other_frames_altogether(folder):
    (folder / "loads.csv").write_text("frame,load_N\nframe_7,0.1\n")
    assert refusal(folder) == (
        f"{folder / 'loads.csv'}: none of its frames (frame_7) is among those read "
        "(frame_1.tif, frame_2.tif, frame_10.tif)"
    )


@pytest.mark.parametrize("sections", [{"images": {"loads": "l.csv"}}, {"asperities": {"file": "l.csv"}}])
def test_named_table_that_is_missing(folder, sections):
    sentence = f"{folder / 'l.csv'}: cannot be read (No such file or directory)"
    assert refusal(folder, **sections) == sentence


def test_relative_paths_are_those_of_the_scene_file(folder, monkeypatch, tmp_path_factory):
    (folder / "scene.toml").write_text('[images]\nreference = "reference.tif"\nframes = ["frame_2.tif"]\n')
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    experiment = open_experiment(read_scene(folder))
    assert names(experiment) == ["frame_2.tif"]
    monkeypatch.chdir(folder.parent)
    assert names(open_experiment(read_scene(Path(folder.name)))) == ["frame_2.tif"]


def test_loads_may_name_frames_in_other_capitals_or_composed_accents(tmp_path):
    for name in ("\u00d6l_1.TIF", "b_2.tif", "B_2.tif"):
        write_frame(Frame(np.ones((4, 5), np.uint8)), tmp_path / name)
    (tmp_path / "loads.csv").write_text("frame,load_N\nO\u0308l_1.tif,1\nb_2.tif,2\n", encoding="utf-8")
    experiment = open_experiment(scene_from_dict({}, folder=str(tmp_path)))
    assert experiment.load_of("\u00d6l_1.TIF") == 1.0
    assert experiment.load_of("b_2.tif") == 2.0
    assert experiment.load_of("B_2.tif") != 2.0


def test_loads_may_name_frames_by_path_or_without_extension(tmp_path):
    for name in ("a_1.tif", "a_2.tif", "b.tif"):
        write_frame(Frame(np.ones((4, 5), np.uint8)), tmp_path / name)
    table = tmp_path / "loads.csv"
    table.write_text("frame,load_mN\nC:\\data\\a_1.tif,10\na_2,20\nraw/b,30\n", encoding="utf-8")
    experiment = open_experiment(scene_from_dict({}, folder=str(tmp_path)))
    assert [experiment.load_of(name) for name in ("a_1.tif", "a_2.tif", "b.tif")] == [0.01, 0.02, 0.03]
    table.write_text("frame,load_N\na_1,1\na_1.tif,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"2 rows mean the frame a_1\.tif"):
        open_experiment(scene_from_dict({}, folder=str(tmp_path)))
