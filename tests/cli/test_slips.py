"""Slips of a first day, without a scene file: each is named, with exit code 1 or 2."""

import cv2
import pandas as pd
import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.plausibility import doubts_about_run
from contactimg.scene import scene_from_dict
from contactimg.tables import FRAMES

WHOLE = ("--pixel-size-um", "6", "--lens-radius-mm", "128.8", "--young-modulus-MPa", "3")


def loads_by(change):
    def slip(folder):
        loads = pd.read_csv(folder / "loads.csv")
        loads["load_N"] = change(loads["load_N"])
        loads.to_csv(folder / "loads.csv", index=False)

    return slip


def exchanged(folder):
    (folder / "reference.tif").rename(folder / "other.tif")
    (folder / "frame_3.tif").rename(folder / "reference.tif")
    (folder / "other.tif").rename(folder / "frame_3.tif")


def smaller_reference(folder):
    image = cv2.imread(str(folder / "reference.tif"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(folder / "reference.tif"), image[:-10])


def nothing(_folder):
    pass


SLIPS = {
    "mm typed as um": (nothing, ("--pixel-size-um", "0.006"), "mm, typed as µm"),
    "um typed as mm": (nothing, ("--pixel-size-um", "6000"), "was it given in mm?"),
    "grams": (loads_by(lambda load: load / 9.80665e-3), (), "load in mN or grams"),
    "mN": (loads_by(lambda load: 1e3 * load), (), "load in mN or grams"),
    "order": (loads_by(lambda load: load[::-1].to_numpy()), (), "order of the loads reversed"),
    "lens": (nothing, ("--lens-radius-mm", "40"), "another lens"),
    "lens in um": (nothing, ("--lens-radius-mm", "128800"), "was it given in mm or µm"),
    "modulus in Pa": (nothing, ("--young-modulus-MPa", "3e6"), "young_modulus_Pa"),
    "reference and frame": (exchanged, (), "is named as the reference"),
    "size of the reference": (smaller_reference, (), "reference"),
}


@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_is_named(name, small_series, tmp_path, capsys, caplog):
    folder = copy_of(small_series, tmp_path / "frames")
    (folder / "scene.toml").unlink()
    spoil, options, sentence = SLIPS[name]
    spoil(folder)
    code = main(["init", str(folder), "--no-input", *WHOLE, *options])
    if code == 0:
        code = main(["process", str(folder), "--no-pictures"])
    said = capsys.readouterr()
    assert code in (1, 2)
    assert sentence in said.err + said.out + caplog.text


@pytest.mark.parametrize(
    ("ratio", "slip"),
    [
        (9.8e-3, "given in grams"),
        (9.8, "given in kilograms"),
        (1.1e-3, "given in mN"),
        (1e3, "given in kN"),
        (8.0, "twice that of the frames (binning), or were"),  # the cube of 2
        (0.125, "half that of the frames (binning)"),
    ],
)
def test_forces_far_off_the_load_tell_the_slip(ratio, slip):
    frames = FRAMES.conform(
        pd.DataFrame({"frame": ["a", "b"], "n_contacts": 5, "load_N": [0.1, 0.2], "area_m2": [1e-8, 2e-8]})
    )
    frames["force_sum_N"] = ratio * frames["load_N"]
    assert slip in " ".join(doubts_about_run(scene_from_dict({}), frames, None))


def test_a_folder_without_a_slip_is_not_doubted(small_series, tmp_path, caplog):
    folder = copy_of(small_series, tmp_path / "frames")
    (folder / "scene.toml").unlink()
    assert main(["init", str(folder), "--no-input", *WHOLE]) == 0
    assert main(["process", str(folder), "--no-pictures"]) == 0
    assert "probably" not in caplog.text


def test_a_wrong_apex_stops_overlay_and_analyse_unless_told_to_go_on(small_series, tmp_path, capsys):
    folder, out = copy_of(small_series, tmp_path / "frames"), tmp_path / "out"
    for name in ("scene.toml", "frame_2.tif", "frame_3.tif"):
        (folder / name).unlink()
    assert main(["init", str(folder), "--no-input", *WHOLE, "--apex-mm", "2.5 2.5"]) == 0
    assert main(["process", str(folder), "--no-pictures", "-o", str(out)]) == 0
    for command in ("overlay", "analyse"):
        assert main([command, str(out)]) == 2
        said = "[indenter] apex_m, or the centre of the calibration used: the contacts show the apex at (0.00"
        assert said in capsys.readouterr().err
        assert main([command, str(out), "--no-plausibility"]) == 0
