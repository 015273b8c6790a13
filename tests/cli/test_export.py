"""`export` and `import-rois`: what other programs get, and what comes back."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import openpyxl
import pandas as pd
import pytest
import tifffile

from contactimg import Flag, read_run
from contactimg.cli import main
from contactimg.files import read_edits
from contactimg.files.exports import label_image, read_regions, write_regions, write_workbook
from contactimg.tables import CONTACTS, FRAMES, OUTLINES
from contactimg.tables.outlines import contact_outlines


@pytest.fixture(scope="module")
def folder(small_series, tmp_path_factory):
    target = tmp_path_factory.mktemp("export") / "series"
    shutil.copytree(small_series, target)
    run = ["process", str(target), "-o", str(target / "run"), "--quiet", "--no-pictures"]
    assert main(run) == 0
    assert main(["export", str(target / "run"), "--quiet"]) == 0
    return target


def test_every_format_is_written(folder):
    export = folder / "run" / "export"
    names = {path.relative_to(export).as_posix() for path in export.rglob("*") if path.is_file()}
    frame = "frame_1.tif"
    assert names >= {
        "contacts.xlsx",
        "provenance.json",
        f"fiji/{frame}.zip",
        f"fiji/{frame}_overlay.tif",
        f"labels/{frame}_labels.tif",
        f"napari/{frame}_points.csv",
        f"napari/{frame}_shapes.csv",
    }


def test_an_export_of_one_format_keeps_the_others(folder, tmp_path):
    out = tmp_path / "out"
    for chosen in ("--fiji", "--xlsx", "--fiji"):
        assert main(["export", str(folder / "run"), "-o", str(out), chosen, "--quiet"]) == 0
        assert (out / "fiji" / "frame_1.tif.zip").is_file()
    assert {path.name for path in out.iterdir()} == {"fiji", "contacts.xlsx", "provenance.json"}


def test_the_workbook_has_units_and_every_number(folder):
    run = read_run(folder / "run")
    book = openpyxl.load_workbook(folder / "run" / "export" / "contacts.xlsx")
    assert book.sheetnames == ["frames", "contacts", "rejected", "columns"]
    sheet = book["contacts"]
    header = [cell.value for cell in sheet[1]]
    assert {"x (px)", "radius (µm)", "area (µm²)", "force (mN)"} <= set(header)
    values = pd.DataFrame(list(sheet.values)[1:], columns=header)
    for name, column, factor in (("radius (µm)", "radius_m", 1e6), ("force (mN)", "force_N", 1e3)):
        np.testing.assert_allclose(values[name].astype(float), run.contacts[column] * factor, rtol=1e-14)
    assert sheet.freeze_panes == "A2"


def test_text_that_looks_like_a_formula_stays_text(tmp_path):
    frames = FRAMES.conform({"frame": ["=1+1.tif", "bell\x07.tif"], "status": ["ok", "ok"]})
    write_workbook([(FRAMES, frames)], tmp_path / "a.xlsx", units="mm")
    sheet = openpyxl.load_workbook(tmp_path / "a.xlsx")["frames"]
    assert [sheet["A2"].value, sheet["A2"].data_type] == ["=1+1.tif", "s"]
    assert sheet["A3"].value == "bell\ufffd.tif"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("soffice") is None, reason="needs LibreOffice")
def test_libreoffice_opens_the_workbook(folder, tmp_path):
    source = folder / "run" / "export" / "contacts.xlsx"
    convert = ["soffice", "--headless", "--convert-to", "csv", "--outdir", str(tmp_path), str(source)]
    subprocess.run(convert, check=True, timeout=180, capture_output=True)  # noqa: S603
    assert "frame" in (tmp_path / "contacts.csv").read_text(encoding="utf-8")


def test_labels_count_the_pixels_of_each_contact(folder):
    contacts = read_run(folder / "run").contacts
    contacts = contacts[contacts["frame"] == "frame_3.tif"]
    labels = tifffile.imread(folder / "run" / "export" / "labels" / "frame_3.tif_labels.tif")
    assert set(np.unique(labels)) == {0, *contacts["label"]}
    alone = contacts[(contacts["flags"] == 0) & (contacts["radius_px"] > 4)]
    for label, radius in alone[["label", "radius_px"]].to_numpy():
        assert (labels == label).sum() == pytest.approx(np.pi * radius**2, rel=0.1)


def test_a_contact_between_pixel_centres_has_one_pixel():
    contacts = CONTACTS.conform({"label": [3], "x_px": [1.4], "y_px": [1.4], "radius_px": [0.3]})
    assert (label_image(contact_outlines(contacts), (4, 4)) == 3).sum() == 1


def test_labels_fill_ellipses_and_leave_out_holes():
    contacts = CONTACTS.conform(
        {
            "label": [1, 2], "x_px": [20.0, 60.0], "y_px": [20.0, 20.0], "radius_px": [8.0, 10.0],
            "shape": ["ellipse", "free"], "semi_major_px": [16.0, 1.0], "semi_minor_px": [4.0, 1.0],
            "angle_rad": [np.pi / 4, 0.0],
        }
    )  # fmt: skip
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    lines = np.vstack([[60.1, 20.0] + 10.2 * square, [60.1, 20.0] + 4.2 * square[::-1]])
    outlines = OUTLINES.conform(
        {"label": [2] * 10, "outline": [0] * 5 + [1] * 5, "point": range(10), "x_px": lines[:, 0],
         "y_px": lines[:, 1]}
    )  # fmt: skip
    labels = label_image(contact_outlines(contacts, outlines), (50, 90))
    assert (labels == 1).sum() == pytest.approx(np.pi * 64, rel=0.03)
    assert labels[30, 30] == 1  # down and to the right: a positive angle
    assert labels[10, 30] == 0
    assert (labels == 2).sum() == 21**2 - 9**2
    outer = outlines[outlines["outline"] == 0]
    without_hole = label_image(contact_outlines(contacts, outer), (50, 90))
    assert (without_hole == 2).sum() == 21**2


def test_changes_made_in_imagej_come_back_as_edits_that_process_applies(folder, tmp_path):
    run = read_run(folder / "run")
    frame = "frame_3.tif"
    before = run.contacts[run.contacts["frame"] == frame].sort_values("radius_px", ascending=False)
    regions = read_regions(folder / "run" / "export" / "fiji" / f"{frame}.zip")
    largest, second = (f"contact_{label:04d}" for label in before["label"].iloc[:2])
    moved = [
        replace(region, x=region.x + 1.0) if region.name == second else region
        for region in regions
        if region.name != largest
    ]
    write_regions(moved, tmp_path / f"{frame}.zip")
    assert main(["import-rois", str(folder / "run"), str(tmp_path / f"{frame}.zip"), "--quiet"]) == 0
    edits = read_edits(folder / "edits.csv")
    assert edits["action"].tolist() == ["exclude", "exclude", "add"]
    assert main(["process", str(folder), "-o", str(tmp_path / "new"), "--quiet", "--no-pictures"]) == 0
    after = read_run(tmp_path / "new").contacts
    after = after[after["frame"] == frame]
    assert len(after) == len(before) - 1
    by_hand = after[after["flags"] >= int(Flag.MANUAL)]
    assert by_hand["radius_px"].iloc[0] == pytest.approx(before["radius_px"].iloc[1], abs=0.02)


def test_unchanged_regions_change_nothing(folder, tmp_path, capsys):
    file = folder / "run" / "export" / "fiji" / "frame_2.tif.zip"
    assert main(["import-rois", str(folder / "run"), str(file), "-o", str(tmp_path / "e.csv")]) == 0
    assert "nothing was changed" in capsys.readouterr().out
    assert not (tmp_path / "e.csv").exists()


def test_a_region_with_another_name_is_a_new_one(folder, tmp_path):
    regions = read_regions(folder / "run" / "export" / "fiji" / "frame_2.tif.zip")
    renamed = [
        replace(region, name="contact_1") if region.name == "contact_0001" else region for region in regions
    ]
    write_regions(renamed, tmp_path / "frame_2.tif.zip")
    run, file, out = str(folder / "run"), str(tmp_path / "frame_2.tif.zip"), tmp_path / "e.csv"
    assert main(["import-rois", run, file, "-o", str(out), "--quiet"]) == 0
    edits = read_edits(out)
    assert edits["action"].tolist() == ["exclude", "add"]
    np.testing.assert_allclose(edits["x_px"].iloc[0], edits["x_px"].iloc[1], atol=1e-3)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [("other.zip", "name the frame with --frame"), ("frame_1.tif.zip", "is not an ImageJ ROI file")],
)
def test_a_file_that_cannot_be_used_gets_one_sentence(folder, tmp_path, name, sentence, capsys):
    (tmp_path / name).write_bytes(b"nothing")
    assert main(["import-rois", str(folder / "run"), str(tmp_path / name)]) == 2
    told = capsys.readouterr().err
    assert sentence in told
    assert "nothing" not in told  # the bytes of the file
