"""Files that claim to be large, and records of a run that are damaged: one sentence, and no memory taken."""

import json
import struct
import zlib

import numpy as np
import pytest
import tifffile
from small_series import copy_of

from contactimg.cli import main
from contactimg.errors import FrameError, InputError
from contactimg.files import decoders, list_frames, read_calibration, read_frames, read_run


def png(columns, rows):
    """A PNG whose header claims a size and whose data are a few bytes."""

    def chunk(name, data):
        return struct.pack(">L", len(data)) + name + data + struct.pack(">L", zlib.crc32(name + data))

    head = chunk(b"IHDR", struct.pack(">LLBBBBB", columns, rows, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")


def bmp(columns, rows):
    return struct.pack("<2sLLLLllHHLLllLL", b"BM", 54, 0, 54, 40, columns, rows, 1, 24, 0, 0, 0, 0, 0, 0)


def seq(columns, rows, count=1, used_bits=8):
    sizes = (columns, rows, 8, used_bits, columns * rows % 2**32, 100, count, 0, columns * rows % 2**31 + 8)
    return struct.pack("<L24sll512s9Ld8L", 0xFEED, b"N", 5, 1024, b"", *sizes, 25.0, *[0] * 8).ljust(
        9000, b"\0"
    )


def tiff_with(tmp_path, **tags):
    """A TIFF with other numbers in its header."""
    path = tmp_path / "source.tif"
    tifffile.imwrite(path, np.zeros((64, 64), np.uint8), tile=(16, 16), compression="zlib", metadata=None)
    with tifffile.TiffFile(path, mode="r+") as tif:
        for name, value in tags.items():
            tif.pages[0].tags[name].overwrite(value)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("a.png", lambda _: png(60000, 60000)),
        ("a.png", lambda _: png(2**31 - 1, 2**31 - 1)),
        ("a.bmp", lambda _: bmp(60000, 60000)),
        ("a.seq", lambda _: seq(60000, 60000)),
        ("a.tif", lambda folder: tiff_with(folder, ImageWidth=60000, ImageLength=60000)),
        ("a.tif", lambda folder: tiff_with(folder, TileWidth=60000 // 16 * 16, TileLength=60000 // 16 * 16)),
    ],
)
def test_an_image_beyond_the_limit_is_refused_before_it_is_decoded(tmp_path, name, make):
    (tmp_path / name).write_bytes(make(tmp_path))
    with pytest.raises(FrameError, match=r"says \d+ x \d+ pixels, more than 200000000; .*cut it into parts"):
        list_frames(tmp_path / name)[0].read()


def test_an_image_up_to_the_limit_is_read(tmp_path, monkeypatch):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((20, 30), np.uint8))
    monkeypatch.setattr(decoders, "MAX_PIXELS", 600)
    assert read_frames(tmp_path / "a.tif")[0].shape == (20, 30)
    monkeypatch.setattr(decoders, "MAX_PIXELS", 599)
    with pytest.raises(FrameError, match="30 x 20 pixels, more than 599"):
        read_frames(tmp_path / "a.tif")[0]


def test_a_sequence_that_announces_millions_of_images_lists_those_it_holds_and_one(tmp_path):
    (tmp_path / "a.seq").write_bytes(seq(10, 10, count=2**32 - 1))
    assert len(list_frames(tmp_path / "a.seq")) == (9000 - 8192) // 108 + 1


def test_a_tiff_whose_pages_form_a_ring_ends(tmp_path):
    tifffile.imwrite(
        tmp_path / "a.tif", np.zeros((2, 8, 8), np.uint8), photometric="minisblack", metadata=None
    )
    with tifffile.TiffFile(tmp_path / "a.tif") as tif:
        first, last = tif.pages[0].offset, tif.pages[1].offset
        entries = len(tif.pages[1].tags)
    data = bytearray((tmp_path / "a.tif").read_bytes())
    data[last + 2 + 12 * entries : last + 6 + 12 * entries] = first.to_bytes(4, "little")
    (tmp_path / "a.tif").write_bytes(data)
    sources = list_frames(tmp_path / "a.tif")
    assert len(sources) <= len(data) // 18 + 2
    assert sources[1].read().shape == (8, 8)
    with pytest.raises(FrameError, match="cannot be read"):
        sources[-1].read()


def test_a_sequence_with_more_used_bits_than_bits(tmp_path):
    (tmp_path / "a.seq").write_bytes(seq(10, 10, used_bits=2**31))
    with pytest.raises(FrameError, match="contradicts itself"):
        list_frames(tmp_path / "a.seq")[0].read()


@pytest.fixture(scope="module")
def run(small_series, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    assert (
        main(["process", str(small_series), "-o", str(out), "--workers", "1", "--no-pictures", "--quiet"])
        == 0
    )
    return out


@pytest.fixture
def folder(run, tmp_path):
    """A copy of the run that a test may spoil."""
    return copy_of(run, tmp_path / "run")


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (["pose"], 0.5, "damaged"),
        (["pose"], {"rows": 3}, "damaged .*'columns'"),
        (["pose", "centre_m"], [1.0], "damaged"),
        (["pose", "pixel_size_m"], float("inf"), "pixel size must be a positive length"),
        (["pose", "rows"], "x", "damaged .*'x'"),
        (["pose", "rows"], float("inf"), "damaged .*infinity"),
        (["command"], None, "damaged"),
        (["configuration"], [], "damaged"),
        (["configuration", "options"], 3, "damaged"),
        (["configuration", "options"], {"calibration": {"file": "a"}}, "damaged .*'record'"),
        (
            ["configuration", "options"],
            {"calibration": {"file": "a", "record": {"centre_x": 3}}},
            "centre_x must hold a value, got 3",
        ),
        (["schema_version"], "1", "damaged"),
        (["sha256"], 0.5, "damaged"),
    ],
)
def test_damaged_provenance_is_one_sentence(folder, capfd, place, value, said):
    record = json.loads((folder / "provenance.json").read_text())
    holder = record
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = value
    (folder / "provenance.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=said):
        read_run(folder)
    for command in ("analyse", "overlay", "report"):
        assert main([command, str(folder), "--quiet"]) == 2
        assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        (
            "contacts.csv",
            ("frame_2.tif", "frame_9.tif"),
            "names frame 'frame_9.tif', which frames.csv does not",
        ),
        ("frames.csv", ("frame_2.tif", "frame_1.tif"), "names frame 'frame_1.tif' more than once"),
        ("contacts.csv", ("frame_1.tif,1,", f"frame_1.tif,{10**30},"), "must be a whole number of at most"),
        ("contacts.csv", ("frame_1.tif,1,", "frame_1.tif,2,"), "2 of frame 'frame_1.tif' more than once"),
        ("provenance.json", ("{", "["), "is damaged .*; repeat the run"),
    ],
)
def test_tables_that_do_not_belong_together(folder, name, change, said):
    text = (folder / name).read_text()
    assert change[0] in text
    (folder / name).write_text(text.replace(*change))
    with pytest.raises(InputError, match=said):
        read_run(folder)


@pytest.mark.parametrize("command", ["analyse", "overlay"])
@pytest.mark.parametrize(
    ("cell", "said"),
    [
        (("asperity", "7000"), "names asperity 7000, but their table has"),
        (("radius_px", "-3.0"), "column radius_px must not be negative; repeat the run"),
    ],
)
def test_a_value_that_cannot_be_is_one_sentence(command, cell, said, folder, capfd):
    lines = (folder / "contacts.csv").read_text().splitlines()
    cells = lines[1].split(",")
    cells[lines[0].split(",").index(cell[0])] = cell[1]
    (folder / "contacts.csv").write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]) + "\n")
    assert main([command, str(folder), "--quiet"]) == 2
    assert said in capfd.readouterr().err


@pytest.mark.parametrize("value", [None, "3", True, [1]])
def test_a_calibration_whose_number_is_none(tmp_path, value):
    (tmp_path / "calibration.json").write_text(json.dumps({"young_modulus": {"value": value}}))
    with pytest.raises(InputError, match="the value of young_modulus must be a number"):
        read_calibration(tmp_path)
