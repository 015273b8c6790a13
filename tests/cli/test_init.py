"""`contactimg init`: what a folder's files are, the questions, and the scene file that `process` takes."""

import io

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from small_series import copy_of

from contactimg.cli import main
from contactimg.files import open_experiment, read_scene
from contactimg.files.decoders import stated_pixel_size

FLAT_GREY = np.full((40, 50), 80, np.uint8)


@pytest.fixture
def frames(small_series, tmp_path):
    """The small series without its scene."""
    folder = copy_of(small_series, tmp_path / "frames")
    (folder / "scene.toml").unlink()
    return folder


def test_the_scene_of_a_folder_of_frames_holds_what_the_files_and_options_say(frames, capsys):
    options = ("--pixel-size-um", "6", "--lens-radius-mm", "128.8", "--young-modulus-MPa", "3", "--no-input")
    assert main(["init", str(frames), *options]) == 0
    assert "contactimg process" in capsys.readouterr().out
    scene = read_scene(frames)
    assert (scene.camera.pixel_size, scene.indenter.radius, scene.elastic.young_modulus) == (
        6e-6,
        0.1288,
        3e6,
    )
    experiment = open_experiment(scene)
    assert experiment.references[0].name == "reference.tif"
    assert experiment.asperities is not None
    assert experiment.loads["load_N"].notna().all()


def test_a_place_that_is_no_pair_of_numbers_is_refused_in_one_sentence(frames, capsys):
    lens = ("--lens-radius-mm", "128.8", "--no-input")
    assert main(["init", str(frames), *lens, "--apex-mm", "5 about6"]) == 2
    said = capsys.readouterr().err
    assert said == "contactimg: the answers: [indenter] apex_m[1] must be a number, got 'about6'\n"


def test_what_nobody_knows_is_a_comment_that_becomes_a_key(frames):
    assert main(["init", str(frames), "--no-input", "--quiet"]) == 0
    text = (frames / "scene.toml").read_text()
    assert "# pixel_size_m =" in text
    assert read_scene(frames).camera is None
    text = text.replace("# [camera]", "[camera]").replace("# pixel_size_m =", "pixel_size_m = 6.0e-6")
    (frames / "scene.toml").write_text(text)
    assert read_scene(frames).camera.pixel_size == 6e-6


def test_answers_are_asked_for_again_and_enter_means_not_known(frames, monkeypatch):
    answers = iter(["six", "-1", "5,9", "", "3"])
    monkeypatch.setattr("click.termui.visible_prompt_func", lambda *_: next(answers))
    assert main(["init", str(frames)]) == 0
    scene = read_scene(frames)
    assert (scene.camera.pixel_size, scene.indenter, scene.elastic.young_modulus) == (5.9e-6, None, 3e6)


def test_which_column_is_the_load_is_asked_for(frames, monkeypatch, capsys):
    loads = pd.read_csv(frames / "loads.csv")
    rows = [f"{row.frame}\t{1e3 * row.load_N:g}\t7" for row in loads.itertuples()]
    (frames / "loads.csv").unlink()
    (frames / "Kraft.lvm").write_text("LabVIEW\n\nBild\tKraft [mN]\tOffset [mN]\n" + "\n".join(rows) + "\n")
    answers = iter(["other", "Kraft [mN]", "6", "", "", ""])
    monkeypatch.setattr("click.termui.visible_prompt_func", lambda *_: next(answers))
    assert main(["init", str(frames)]) == 0
    assert "loads from 'Kraft [mN]'" in capsys.readouterr().out
    found = open_experiment(read_scene(frames)).loads
    assert found["load_N"].tolist() == pytest.approx(loads["load_N"].tolist())


def test_a_scene_that_is_there_and_an_implausible_answer_are_refused(frames, capsys):
    assert main(["init", str(frames), "--no-input", "--lens-radius-mm", "128800"]) == 2
    assert "radius_m" in capsys.readouterr().err
    assert main(["init", str(frames), "--no-input", "--pixel-size-um", "0"]) == 2
    assert "pixel_size_m must be greater than 0, got 0.0" in capsys.readouterr().err
    assert not (frames / "scene.toml").exists()
    (frames / "scene.toml").write_text("[camera]\npixel_size_m = 6e-6\n")
    assert main(["init", str(frames), "--no-input"]) == 2
    assert "--force" in capsys.readouterr().err
    assert "6e-6" in (frames / "scene.toml").read_text()
    assert main(["init", str(frames), "--no-input", "--force"]) == 0


def test_a_question_that_nobody_can_answer_names_the_option(frames, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert main(["init", str(frames)]) == 2
    error = capsys.readouterr().err
    assert "--no-input" in error
    assert "one pixel" in error
    assert not (frames / "scene.toml").exists()


def test_names_say_what_an_image_is(tmp_path, capsys):
    names = ("a_01", "a_02", "no contact", "Background_2", "dark_1", "dark_2", "flat", "mask_frame")
    for name in names:
        cv2.imwrite(str(tmp_path / f"{name}.png"), FLAT_GREY)
    assert main(["init", str(tmp_path), "--no-input"]) == 0
    said = capsys.readouterr().out
    assert "2 frames (a_01.png ... a_02.png)" in said
    assert "dark frame: dark_1.png, dark_2.png" in said
    scene = read_scene(tmp_path)
    assert set(scene.images.reference) == {"no contact.png", "Background_2.png"}
    assert (scene.images.flat, scene.images.mask) == ("flat.png", "mask_frame.png")
    experiment = open_experiment(scene)
    assert [frame.name for frame in experiment.frames] == ["a_01.png", "a_02.png"]
    assert len(experiment.references) == len(experiment.frames[0].correct.dark) == 2


@pytest.mark.parametrize(
    ("unit", "metres"), [("um", 1e-6), ("micron", 1e-6), ("mm", 1e-3), ("nm", 1e-9), ("inch", None)]
)
def test_imagej_states_the_pixel_size(tmp_path, unit, metres):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, FLAT_GREY, imagej=True, resolution=(1 / 6, 1 / 6), metadata={"unit": unit})
    expected = None if metres is None else pytest.approx((6 * metres, 6 * metres), rel=1e-6)
    assert stated_pixel_size(path) == expected
    tifffile.imwrite(path, FLAT_GREY, imagej=True, resolution=(1 / 6, 1 / 12), metadata={"unit": unit})
    expected = None if metres is None else pytest.approx((6 * metres, 12 * metres), rel=1e-6)
    assert stated_pixel_size(path) == expected


def test_pixels_that_are_no_squares_are_said(tmp_path, capsys):
    resolution = (1 / 6, 1 / 12)
    for name in ("a.tif", "b.tif"):
        tifffile.imwrite(
            tmp_path / name, FLAT_GREY, imagej=True, resolution=resolution, metadata={"unit": "um"}
        )
    assert main(["init", str(tmp_path), "--no-input"]) == 0
    said = capsys.readouterr().err
    assert "a.tif states pixels of 6 µm by 12 µm: they are taken as square; resample the frames" in said


def test_ome_states_the_pixel_size_and_a_print_resolution_is_none(tmp_path, caplog):
    path = tmp_path / "a.ome.tif"
    stated = {"axes": "YX", "PhysicalSizeX": 5.9}
    for more, height in (({}, 5.9e-6), ({"PhysicalSizeY": 7100, "PhysicalSizeYUnit": "nm"}, 7.1e-6)):
        tifffile.imwrite(path, FLAT_GREY, ome=True, metadata=stated | more)
        assert stated_pixel_size(path) == pytest.approx((5.9e-6, height))
    tifffile.imwrite(tmp_path / "b.tif", FLAT_GREY, resolution=(300, 300), resolutionunit="INCH")
    assert stated_pixel_size(tmp_path / "b.tif") is None
    for damaged in (path.read_bytes()[:200], b"II*\0broken"):
        (tmp_path / "c.tif").write_bytes(damaged)
        assert stated_pixel_size(tmp_path / "c.tif") is None
    assert caplog.text == ""
