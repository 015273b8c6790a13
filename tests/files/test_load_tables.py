"""Loads as laboratories write them, and what a folder's files are."""

from time import perf_counter

import cv2
import numpy as np
import pytest

from contactimg.errors import InputError
from contactimg.files import open_experiment, read_loads
from contactimg.files.experiment import recognise_folder
from contactimg.scene import scene_from_dict

GRAM = 9.80665e-3  # N that a gram weighs

TABLES = {
    "LabVIEW": ("LabVIEW Measurement\nSeparator\tTab\n\nX_Value\tBild\tKraft [mN]\n0,0\t{0}\t12,5\n", 0.0125),
    "Excel, German": ("Bild;Kraft [mN];Reibung [mN]\n{0};12,5;3\n", 0.0125),
    "French, newtons": ("essai du 3 mai\n\nFichier\tForce normale [N]\n{0}\t0,0125\n", 0.0125),
    "grams": ("image,weight (g)\n{0},2.5\n", 2.5 * GRAM),
    "CSV, load_g": ("frame,load_g\n{0},2.5\n", 2.5 * GRAM),
    "white space": ("# rig 2\nframe  load/mN\n{0}  12.5\n", 0.0125),
    "numpy": ("# frame load_mN\n{0} 12.5\n", 0.0125),
    "micronewtons": ("Datei;Last [µN]\n{0};12500\n", 0.0125),
}


def frames_in(folder, names):
    for name in names:
        cv2.imwrite(str(folder / name), np.full((20, 30), 80, np.uint8))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("frame", ["Img000123.tif", "Img000123", "123", r"C:\rig\Img000123.tif"])
def test_a_table_of_any_form_gives_the_load_of_a_frame(tmp_path, name, encoding, frame):
    text, load = TABLES[name]
    frames_in(tmp_path, ["Img000123.tif", "Img000124.tif"])
    (tmp_path / "table.lvm").write_bytes(text.format(frame).encode(encoding))
    scene = scene_from_dict({"images": {"loads": "table.lvm"}}, folder=str(tmp_path))
    assert open_experiment(scene).load_of("Img000123.tif") == pytest.approx(load, rel=1e-12)


def test_an_umlaut_in_the_code_of_western_windows_is_that_of_the_frame(tmp_path):
    frames_in(tmp_path, ["Größe 1.tif", "Größe 2.tif"])
    (tmp_path / "loads.csv").write_bytes("frame;load_N\nGröße 1.tif;0,1\nGröße 2.tif;0,2\n".encode("cp1252"))
    scene = scene_from_dict({"images": {"loads": "loads.csv"}}, folder=str(tmp_path))
    assert open_experiment(scene).loads["load_N"].tolist() == [0.1, 0.2]


def test_rows_without_a_frame_follow_the_order_and_must_be_as_many(tmp_path):
    frames_in(tmp_path, ["a2.tif", "a10.tif"])
    (tmp_path / "k.txt").write_text("X_Value\tKraft [mN]\n0\t1\n1\t2\n")
    scene = scene_from_dict({"images": {"loads": "k.txt"}}, folder=str(tmp_path))
    assert open_experiment(scene).loads["load_N"].tolist() == [0.001, 0.002]
    frames_in(tmp_path, ["a11.tif"])
    with pytest.raises(InputError, match="2 rows that name no frame, and there are 3 frames"):
        open_experiment(scene)


def test_a_table_of_one_column_gives_loads_and_none_that_are_empty(tmp_path):
    """White space parts ``Kraft [mN]`` in two columns, of which the one with the unit has no number."""
    frames_in(tmp_path, ["a2.tif", "a10.tif"])
    (tmp_path / "k.txt").write_text("rig 2\n\nKraft [mN]\n1,5\n2\n")
    scene = scene_from_dict({"images": {"loads": "k.txt"}}, folder=str(tmp_path))
    assert open_experiment(scene).loads["load_N"].tolist() == [0.0015, 0.002]
    (tmp_path / "k.txt").write_text("Bild Kraft [mN]\na2.tif 1.5\na10.tif 2\n")
    with pytest.raises(InputError, match=r"load_N must be a number, got 'a2\.tif 1\.5'"):
        open_experiment(scene)


@pytest.mark.parametrize("first", [0, 1])
def test_images_of_a_movie_go_by_their_number(tmp_path, first):
    cv2.imwritemulti(str(tmp_path / "m.tif"), [np.full((20, 30), k, np.uint8) for k in (70, 80, 90)])
    rows = "".join(f"{k + first};{10 * k}\n" for k in range(3))
    (tmp_path / "k.csv").write_text(f"Frame;Load [mN]\n{rows}")
    scene = scene_from_dict({"images": {"frames": "m.tif", "loads": "k.csv"}}, folder=str(tmp_path))
    assert open_experiment(scene).load_of("m.tif[2]") == 0.02


def test_a_table_without_a_unit_offers_the_names_and_shows_the_columns(tmp_path):
    (tmp_path / "k.csv").write_text("Bild;Kraft\n1;2\n")
    with pytest.raises(InputError, match=r"load_mN, load_g, .* the columns are Bild, Kraft"):
        read_loads(tmp_path / "k.csv")
    (tmp_path / "k.csv").write_text("Bild;Kraft oben [mN];Kraft unten [mN]\n1;2;3\n")
    with pytest.raises(InputError, match="2 columns may be the load"):
        read_loads(tmp_path / "k.csv")


def test_a_cell_that_is_no_number_is_named_by_its_line(tmp_path, caplog):
    (tmp_path / "k.txt").write_text("rig 2\n\nBild\tKraft [mN]\na.tif\tNaN\nb.tif\t1,5\n")
    loads = read_loads(tmp_path / "k.txt")["load_N"]
    assert np.isnan(loads[0])
    frames_in(tmp_path, ["a.tif", "b.tif"])
    open_experiment(scene_from_dict({"images": {"loads": "k.txt"}}, folder=str(tmp_path)))
    assert "has no load for the frames: a.tif" in caplog.text
    assert loads[1] == 0.0015
    (tmp_path / "k.txt").write_text("rig 2\n\nBild\tKraft [mN]\na.tif\t1,5\nb.tif\tx\n")
    with pytest.raises(InputError, match=r"k\.txt: line 5, column load_N must be a number, got 'x'"):
        read_loads(tmp_path / "k.txt")


def test_rows_below_one_of_another_width_are_said_to_be_left_out(tmp_path, caplog):
    (tmp_path / "k.txt").write_text("Bild\tKraft [mN]\na.tif\t1\n\n")
    assert "remark" not in read_loads(tmp_path / "k.txt").attrs
    (tmp_path / "k.txt").write_text("Bild\tKraft [mN]\na.tif\t1\nb.tif\t2\t3\nc.tif\t4\n")
    frames_in(tmp_path, ["a.tif"])
    experiment = open_experiment(scene_from_dict({"images": {"loads": "k.txt"}}, folder=str(tmp_path)))
    assert experiment.loads["load_N"].tolist() == [0.001]
    assert caplog.messages[0] == f"{tmp_path / 'k.txt'}: is read up to line 2; a row below has another width"


def test_a_long_table_without_loads_is_passed_over_at_once(tmp_path):
    frames_in(tmp_path, ["p1.tif"])
    (tmp_path / "track.txt").write_text("".join(f"{k}\t{k / 7:.3f}\t{k / 9:.3f}\n" for k in range(6000)))
    begin = perf_counter()
    assert recognise_folder(tmp_path).ignored == ["track.txt"]
    assert perf_counter() - begin < 10  # s; a look at all that is below each line would take a minute


def test_files_of_a_folder_are_told_by_name_and_content(tmp_path):
    frames_in(tmp_path, ["p1.tif", "p2.tif", "ref.tif", "dark_1.png", "flat.png"])
    (tmp_path / "Weg.lvm").write_text("X_Value\tWeg [mm]\n0\t1\n1\t2\n")
    (tmp_path / "Kraft.lvm").write_text("Bild\tKraft [mN]\np1\t0\np2\t2\n")
    (tmp_path / "caps.txt").write_text("x_um\ty_um\theight_um\tradius_um\n1\t2\t3\t100\n")
    found = recognise_folder(tmp_path)
    assert [frame.name for frame in found.frames] == ["p1.tif", "p2.tif"]
    assert (found.loads, found.asperities, found.unloaded) == ("Kraft.lvm", "caps.txt", True)
    assert found.images == {
        "reference": ["ref.tif"],
        "dark": ["dark_1.png"],
        "flat": ["flat.png"],
        "mask": [],
    }
    assert found.ignored == ["Weg.lvm"]
