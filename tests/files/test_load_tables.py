"""Loads with other separators, units and names of frames, and what a folder's files are."""

import cv2
import numpy as np
import pytest

from contactimg.files import open_experiment
from contactimg.files.folder import recognise_folder
from contactimg.scene import scene_from_dict

GRAM = 9.80665e-3  # N that a gram weighs

TABLES = {
    "comma": ("frame,load_N\n{0},0.0125\n", 0.0125),
    "Excel, German": ("frame;load_mN;friction_mN\n{0};12,5;3\n", 0.0125),
    "tabs, grams": ("frame\tload_g\n{0}\t2,5\n", 2.5 * GRAM),
}


def frames_in(folder, names):
    for name in names:
        cv2.imwrite(str(folder / name), np.full((20, 30), 80, np.uint8))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("frame", ["Img000123.tif", "Img000123", r"C:\rig\Img000123.tif"])
def test_a_table_of_each_form_gives_the_load_of_a_frame(tmp_path, name, encoding, frame):
    text, load = TABLES[name]
    frames_in(tmp_path, ["Img000123.tif", "Img000124.tif"])
    (tmp_path / "table.txt").write_bytes(text.format(frame).encode(encoding))
    scene = scene_from_dict({"images": {"loads": "table.txt"}}, folder=str(tmp_path))
    assert open_experiment(scene).load_of("Img000123.tif") == pytest.approx(load, rel=1e-12)


def test_files_of_a_folder_are_told_by_name_and_content(tmp_path):
    frames_in(tmp_path, ["p1.tif", "p2.tif", "ref.tif", "dark_1.png", "flat.png"])
    (tmp_path / "path.csv").write_text("time_s;path_mm\n0;1\n1;2\n")
    (tmp_path / "force.tsv").write_text("frame\tload_mN\np1\t0\np2\t2\n")
    (tmp_path / "caps.txt").write_text("x_um\ty_um\theight_um\tradius_um\n1\t2\t3\t100\n")
    found = recognise_folder(tmp_path)
    assert [frame.name for frame in found.frames] == ["p1.tif", "p2.tif"]
    assert (found.loads, found.asperities, found.unloaded) == ("force.tsv", "caps.txt", True)
    assert found.images == {
        "reference": ["ref.tif"],
        "dark": ["dark_1.png"],
        "flat": ["flat.png"],
        "mask": [],
    }
    assert found.ignored == ["path.csv"]
