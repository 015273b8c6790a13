"""Frames: formats, grey conversion, full scale, order, names, laziness, a sentence for every bad file."""

import pickle
import struct
import subprocess
import sys
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import imagecodecs
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from contactimg import Frame, FrameError, InputError, read_frames
from contactimg.files import FrameSource, list_frames, write_frame
from contactimg.files.sources import SUFFIXES, natural_key
from contactimg.scene import Camera

DATA = Path(__file__).parents[1] / "data" / "files_formats"
ROWS, COLUMNS = 37, 53  # not square, no multiple of a tile


@pytest.fixture
def levels(rng):
    """12-bit grey levels."""
    return rng.integers(0, 4096, (ROWS, COLUMNS)).astype(np.uint16)


@pytest.fixture
def colour(rng):
    return rng.integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)


def write_tiff(path, array, **options):
    options = {"photometric": "minisblack"} | options
    tifffile.imwrite(path, array, **options)
    return path


def only_frame(path):
    (frame,) = read_frames(path)
    return frame


def failure(path, index=0):
    with pytest.raises(FrameError) as caught:
        read_frames(path)[index]
    assert "\n" not in str(caught.value)
    return str(caught.value)


def luma(colour):
    return colour[..., 0] * 0.299 + colour[..., 1] * 0.587 + colour[..., 2] * 0.114


# ---------------------------------------------------------------- TIFF


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
def test_tiff_keeps_dtype_and_values_in_both_byte_orders(tmp_path, levels, dtype, byteorder):
    array = (levels // 16).astype(dtype)
    frame = only_frame(write_tiff(tmp_path / "a.tif", array, byteorder=byteorder))
    assert frame.image.dtype == dtype
    assert frame.image.dtype.isnative
    np.testing.assert_array_equal(frame.image, array)
    assert frame.full_scale == {"uint8": 255, "uint16": 65535}.get(dtype)


@pytest.mark.parametrize(
    ("stored", "read"),
    [
        ("int8", "float32"),
        ("int16", "float32"),
        ("float16", "float32"),
        ("int32", "float64"),
        ("uint32", "float64"),
    ],
)
def test_tiff_of_other_dtypes_is_read_exactly(tmp_path, stored, read):
    array = np.array([[0, 1, 2], [3, 99, 127]]).astype(stored)
    if stored in ("int32", "uint32"):
        array[0, 0] = 2**31 - 1  # not a float32
    if stored in ("int8", "int16"):
        array[0, 0] = -100
    frame = only_frame(write_tiff(tmp_path / "a.tif", array))
    assert frame.image.dtype == read
    np.testing.assert_array_equal(frame.image, array.astype(float))


@pytest.mark.parametrize("compression", ["lzw", "zlib", "packbits", "zstd", "lzma"])
def test_tiff_compressions(tmp_path, levels, compression):
    frame = only_frame(write_tiff(tmp_path / "a.tif", levels, compression=compression))
    np.testing.assert_array_equal(frame.image, levels)


def test_tiled_tiff(tmp_path, levels):
    np.testing.assert_array_equal(
        only_frame(write_tiff(tmp_path / "a.tif", levels, tile=(16, 16))).image, levels
    )


def test_packed_12_bit_tiff_has_the_full_scale_of_12_bits(tmp_path):
    # two samples of 12 bits in three bytes: 0xABC, 0x123 | 0xFFF, 0x001
    pixels = bytes([0xAB, 0xC1, 0x23, 0xFF, 0xF0, 0x01])
    entries = [(256, 3, 2), (257, 3, 2), (258, 3, 12), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1)]
    entries += [(278, 3, 2), (279, 4, len(pixels))]
    body = struct.pack("<2sHL", b"II", 42, 14) + pixels + struct.pack("<H", len(entries))
    body += b"".join(struct.pack("<HHLL", tag, kind, 1, value) for tag, kind, value in entries) + bytes(4)
    (tmp_path / "a.tif").write_bytes(body)
    frame = only_frame(tmp_path / "a.tif")
    np.testing.assert_array_equal(frame.image, [[0xABC, 0x123], [0xFFF, 0x001]])
    assert frame.full_scale == 4095


@pytest.mark.parametrize(
    ("stated", "full_scale"),
    [(4095, 4095), (1023, 1023), (65535, 65535), (3000, 65535), (1, 65535)],
    ids=["12 bits", "10 bits", "16 bits", "a brightest pixel", "nonsense"],
)
def test_max_sample_value_is_believed_where_a_camera_can_have_it(tmp_path, levels, stated, full_scale):
    path = write_tiff(tmp_path / "a.tif", levels, extratags=[(281, "H", 1, stated, True)])
    assert only_frame(path).full_scale == full_scale


def test_stated_full_scale_wins(tmp_path, levels):
    (source,) = list_frames(write_tiff(tmp_path / "a.tif", levels))
    camera = Camera(pixel_size_m=6e-6, full_scale_levels=4095.0)
    assert replace(source, camera=camera).read().full_scale == 4095


def test_a_full_scale_below_the_levels_of_a_frame_is_refused(tmp_path):
    """Pixels scatter by a few per cent where they saturate, and one of a thousand may be hot."""
    levels = np.linspace(0, 1000, 5000).astype(np.uint16).reshape(50, 100)
    levels[0, :5] = 65535
    (source,) = list_frames(write_tiff(tmp_path / "a.tif", levels))

    def read(stated):
        return replace(source, camera=Camera(pixel_size_m=6e-6, full_scale_levels=stated)).read()

    assert read(970.0).full_scale == 970
    with pytest.raises(FrameError, match=r"a\.tif has grey levels up to 65535, and .*_levels = 255: give"):
        read(255.0)


def test_pages_are_named_from_0_and_read_one_by_one(tmp_path, levels):
    stack = np.stack([levels, levels + 1, levels + 2])
    frames = read_frames(write_tiff(tmp_path / "s.tif", stack))
    assert frames.names == ["s.tif[0]", "s.tif[1]", "s.tif[2]"]
    for k, frame in enumerate(frames):
        assert frame.name == f"s.tif[{k}]"
        np.testing.assert_array_equal(frame.image, stack[k])


def test_thumbnails_are_no_frames(tmp_path, levels):
    with tifffile.TiffWriter(tmp_path / "a.tif") as tif:
        tif.write(levels[::4, ::4], photometric="minisblack", subfiletype=1)
        tif.write(levels, photometric="minisblack")
    frame = only_frame(tmp_path / "a.tif")
    assert frame.name == "a.tif"
    np.testing.assert_array_equal(frame.image, levels)


def test_thumbnail_between_pages(tmp_path, levels):
    with tifffile.TiffWriter(tmp_path / "s.tif") as tif:
        for k in range(2):
            tif.write(levels + k, photometric="minisblack", metadata=None)
            tif.write(levels[::4, ::4], photometric="minisblack", subfiletype=1, metadata=None)
    frames = read_frames(tmp_path / "s.tif")
    assert frames.names == ["s.tif[0]", "s.tif[1]"]
    np.testing.assert_array_equal([frame.image for frame in frames], [levels, levels + 1])


def cut_chain(path, to):
    """Let the first page of a TIFF name another place for the second."""
    with tifffile.TiffFile(path) as tif:
        place = tif.pages[0].offset + 2 + 12 * len(tif.pages[0].tags)
        order = tif.byteorder
    data = bytearray(path.read_bytes())
    data[place : place + 4] = struct.pack(order + "I", to)
    path.write_bytes(data)


def test_imagej_stack_with_one_page_header(tmp_path, levels):
    stack = np.stack([levels, levels + 1, levels + 2])
    tifffile.imwrite(tmp_path / "s.tif", stack, imagej=True)
    cut_chain(tmp_path / "s.tif", to=0)  # as ImageJ writes stacks beyond 4 GB
    frames = read_frames(tmp_path / "s.tif")
    assert frames.names == ["s.tif[0]", "s.tif[1]", "s.tif[2]"]
    np.testing.assert_array_equal([frame.image for frame in frames], stack)


def test_imagej_stack_with_one_page_header_cut_short(tmp_path, levels):
    tifffile.imwrite(tmp_path / "s.tif", np.stack([levels] * 3), imagej=True)
    cut_chain(tmp_path / "s.tif", to=0)
    with tifffile.TiffFile(tmp_path / "s.tif") as tif:
        start = tif.series[0].dataoffset
    data = (tmp_path / "s.tif").read_bytes()
    (tmp_path / "s.tif").write_bytes(data[: start + 2 * levels.nbytes + 100])
    assert len(read_frames(tmp_path / "s.tif")) == 3
    np.testing.assert_array_equal(read_frames(tmp_path / "s.tif")[1].image, levels)
    missing = levels.nbytes - 100
    assert failure(tmp_path / "s.tif", 2) == (
        f"s.tif[2] cannot be read: the file is truncated: {missing} bytes are missing"
    )


def test_colour_becomes_unrounded_luma(tmp_path, colour):
    frame = only_frame(write_tiff(tmp_path / "a.tif", colour, photometric="rgb"))
    assert frame.image.dtype == np.float32
    assert frame.full_scale == 255
    # three products and two sums below 256, then one rounding to float32
    np.testing.assert_allclose(frame.image, luma(colour), rtol=np.finfo(np.float32).eps)


def test_grey_stored_as_colour_is_kept_exactly(tmp_path, levels):
    path = write_tiff(tmp_path / "a.tif", np.stack([levels] * 3, axis=-1), photometric="rgb")
    np.testing.assert_array_equal(only_frame(path).image, levels)


def test_planar_colour_is_that_of_interleaved_colour(tmp_path, colour):
    planes = np.ascontiguousarray(np.moveaxis(colour, -1, 0))
    # as other programs write it: without the description of an array
    planar = write_tiff(tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate", metadata=None)
    interleaved = write_tiff(tmp_path / "i.tif", colour, photometric="rgb")
    np.testing.assert_array_equal(only_frame(planar).image, only_frame(interleaved).image)


@pytest.mark.parametrize("count", [3, 4])
def test_few_grey_pages_that_were_tagged_as_planes_of_a_colour_are_frames(tmp_path, levels, count):
    stack = np.stack([levels + k for k in range(count)])
    # what tifffile makes of a stack of three or four pages, if nobody says that they are grey
    write_tiff(tmp_path / "s.tif", stack, photometric="rgb", planarconfig="separate")
    with tifffile.TiffFile(tmp_path / "s.tif") as tif:
        assert len(tif.pages) == 1
        assert tif.pages[0].photometric == tifffile.PHOTOMETRIC.RGB
    frames = read_frames(tmp_path / "s.tif")
    assert frames.names == [f"s.tif[{k}]" for k in range(count)]
    np.testing.assert_array_equal([frame.image for frame in frames], stack)
    assert frames[0].image.dtype == np.uint16
    assert frames[0].full_scale == 65535


def test_transparency_is_dropped(tmp_path, colour, rng):
    alpha = rng.integers(0, 256, (ROWS, COLUMNS, 1)).astype(np.uint8)
    plain = only_frame(write_tiff(tmp_path / "a.tif", colour, photometric="rgb")).image
    rgba = np.concatenate([colour, alpha], axis=-1)
    path = write_tiff(tmp_path / "b.tif", rgba, photometric="rgb", extrasamples=["unassalpha"])
    np.testing.assert_array_equal(only_frame(path).image, plain)
    grey = np.concatenate([colour[..., :1], alpha], axis=-1)
    path = write_tiff(tmp_path / "c.tif", grey, extrasamples=["unassalpha"], planarconfig="contig")
    np.testing.assert_array_equal(only_frame(path).image, colour[..., 0])


def test_colours_of_a_palette_are_no_grey_levels(tmp_path, colour):
    shades = np.stack([np.arange(256), np.arange(256)[::-1], np.full(256, 7)]).astype(np.uint16)
    path = write_tiff(tmp_path / "a.tif", colour[..., 0], photometric="palette", colormap=257 * shades)
    with pytest.raises(FrameError, match="photometric type PALETTE are not supported"):
        only_frame(path)


def test_black_and_white_is_0_and_255(tmp_path, levels):
    bright = levels > 2000
    frame = only_frame(write_tiff(tmp_path / "a.tif", bright))
    np.testing.assert_array_equal(frame.image, np.where(bright, 255, 0))
    assert frame.full_scale == 255


@pytest.mark.parametrize("dtype", ["bool", "uint8", "uint16"])
def test_white_is_zero_is_turned_round(tmp_path, levels, dtype):
    array = levels > 2000 if dtype == "bool" else (levels // 16).astype(dtype)
    frame = only_frame(write_tiff(tmp_path / "a.tif", array, photometric="miniswhite"))
    full = {"bool": 255, "uint8": 255, "uint16": 65535}[dtype]
    levels_read = array.astype(int) * (255 if dtype == "bool" else 1)
    np.testing.assert_array_equal(frame.image, full - levels_read)


def test_white_of_twelve_bits_is_turned_round_within_them(tmp_path, levels):
    tag = (281, "H", 1, 4095, True)  # MaxSampleValue
    frame = only_frame(write_tiff(tmp_path / "a.tif", levels, photometric="miniswhite", extratags=[tag]))
    assert frame.full_scale == 4095
    np.testing.assert_array_equal(frame.image, 4095 - levels.astype(int))


def test_holes_of_a_float_tiff_stay_holes(tmp_path, levels):
    array = levels.astype(np.float32)
    array[3, 5] = np.nan
    frame = only_frame(write_tiff(tmp_path / "a.tif", array))
    np.testing.assert_array_equal(frame.image, array)
    assert frame.full_scale is None


def test_big_endian_stack_of_a_microscope():
    frames = read_frames(DATA / "stuck_crop.tif")
    assert frames.names == [f"stuck_crop.tif[{k}]" for k in range(5)]
    assert [int(frame.image.sum()) for frame in frames] == [2550021, 2561770, 2561702, 2563301, 2567095]
    assert [int(frame.image[3, 7]) for frame in frames] == [496, 494, 498, 496, 499]


# ---------------------------------------------------------------- PNG, BMP, JPEG


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_png_keeps_grey_levels(tmp_path, levels, dtype):
    array = (levels // 16).astype(np.uint8) if dtype == "uint8" else levels * np.uint16(16)
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(array))
    frame = only_frame(tmp_path / "a.png")
    assert frame.image.dtype == dtype
    np.testing.assert_array_equal(frame.image, array)
    assert frame.full_scale == {"uint8": 255, "uint16": 65535}[dtype]


def test_16_bit_colour_png_keeps_16_bits(tmp_path, levels):
    colour = np.stack([levels, levels * 2, levels * 3], axis=-1).astype(np.uint16)
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(colour))
    frame = only_frame(tmp_path / "a.png")
    np.testing.assert_allclose(frame.image, luma(colour), rtol=np.finfo(np.float32).eps)
    assert frame.full_scale == 65535


BMP_MODES = ["1", "L", "P", "RGB", "RGBA"]


@pytest.mark.parametrize(
    ("suffix", "mode"),
    [(".png", mode) for mode in [*BMP_MODES, "LA"]] + [(".bmp", mode) for mode in BMP_MODES],
)
def test_png_and_bmp_of_every_mode_give_the_same_grey(tmp_path, colour, suffix, mode):
    image = Image.fromarray(colour).convert(mode)
    image.save(tmp_path / f"a{suffix}")
    rgb = np.asarray(image.convert("RGB"))
    expected = rgb[..., 0] if mode in ("1", "L", "LA") else luma(rgb)
    frame = only_frame(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(frame.image, expected, rtol=np.finfo(np.float32).eps)
    assert frame.full_scale == 255


def test_grey_jpeg(tmp_path):
    smooth = np.add.outer(np.arange(ROWS), 2 * np.arange(COLUMNS)).astype(np.uint8)
    Image.fromarray(smooth).save(tmp_path / "a.JPG", quality=100)
    frame = only_frame(tmp_path / "a.JPG")
    assert frame.image.dtype == np.uint8
    # at quality 100 every cosine amplitude is rounded to an integer: an error of a few levels at most
    np.testing.assert_allclose(frame.image, smooth, atol=3)


def test_content_decides_between_png_jpeg_and_bmp(tmp_path, colour):
    Image.fromarray(colour[..., 0]).save(tmp_path / "jpeg_called.png", format="JPEG")
    assert only_frame(tmp_path / "jpeg_called.png").shape == (ROWS, COLUMNS)


# ---------------------------------------------------------------- Norpix


def norpix(images, *, bits=8, used_bits=None, version=5, count=None, kind=100, compression=0, pad=64):
    """A sequence as StreamPix lays it out."""
    rows, columns = images[0].shape
    size = rows * columns * bits // 8
    head = struct.pack("<L", 0xFEED) + "Norpix seq".encode("utf-16-le").ljust(24, b"\0")
    head += struct.pack("<ll", version, 1024) + bytes(512)
    count = len(images) if count is None else count
    head += struct.pack("<9L", columns, rows, bits, used_bits or bits, size, kind, count, 0, size + pad)
    head += struct.pack("<d8L", 25.0, 0, 0, 0, 0, 0, 0, 0, compression)
    body = b"".join(image.astype(f"<u{bits // 8}").tobytes() + b"T" * pad for image in images)
    return head.ljust(8192 if version >= 5 else 1024, b"\0") + body


def test_norpix_sequence_of_streampix():
    frames = read_frames(DATA / "sample_norpix6.seq")
    assert frames.names == [f"sample_norpix6.seq[{k}]" for k in range(6)]
    assert {frame.shape for frame in frames} == {(32, 36)}
    # sums and pixels as another reader (PIMS 0.7) gives them
    assert [int(frame.image.sum()) for frame in frames] == [143624, 145308, 145151, 146869, 144205, 143798]
    assert (frames[2].image[5, 9], frames[5].image[31, 31]) == (122, 247)
    assert frames[0].full_scale == 255


@pytest.mark.parametrize(("bits", "used_bits"), [(8, 8), (16, 12), (16, 16)])
@pytest.mark.parametrize("version", [3, 5])
def test_norpix_bits_and_versions(tmp_path, levels, bits, used_bits, version):
    images = [(levels // 16 if bits == 8 else levels) + k for k in range(3)]
    images = [np.minimum(image, 2**used_bits - 1) for image in images]
    (tmp_path / "a.seq").write_bytes(norpix(images, bits=bits, used_bits=used_bits, version=version))
    frames = read_frames(tmp_path / "a.seq")
    np.testing.assert_array_equal([frame.image for frame in frames], images)
    assert frames[1].full_scale == 2**used_bits - 1
    assert frames[1].image.dtype == f"uint{bits}"


def test_norpix_recording_that_was_not_closed_is_counted_by_its_size(tmp_path, levels):
    (tmp_path / "a.seq").write_bytes(norpix([levels // 16] * 3, count=0))
    assert len(read_frames(tmp_path / "a.seq")) == 3


def test_truncated_norpix_loses_only_what_is_missing(tmp_path, levels):
    data = norpix([levels // 16] * 3)
    (tmp_path / "a.seq").write_bytes(data[: -(levels.size + 64 - 10)])
    frames = read_frames(tmp_path / "a.seq")
    assert len(frames) == 3
    np.testing.assert_array_equal(frames[1].image, levels // 16)
    assert failure(tmp_path / "a.seq", 2) == (
        f"a.seq[2] cannot be read: the file is truncated: {levels.size - 10} bytes are missing"
    )


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (
            {"compression": 1},
            "compressed Norpix sequences are not supported; export it uncompressed or as TIFF",
        ),
        (
            {"kind": 200},
            "only monochrome Norpix sequences of 8 or 16 bits are supported, got image format 200 of 8 bits",
        ),
        ({"pad": -ROWS * COLUMNS}, "the header of the Norpix sequence contradicts itself"),
    ],
)
def test_norpix_that_is_not_supported(tmp_path, levels, options, reason):
    (tmp_path / "a.seq").write_bytes(norpix([levels // 16], **options))
    assert failure(tmp_path / "a.seq") == f"a.seq cannot be read: {reason}"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"hello", "the file is too short for the header of a Norpix sequence"),
        (b"hello" * 400, "the content is not that of a Norpix sequence"),
    ],
)
def test_text_called_seq(tmp_path, content, reason):
    (tmp_path / "a.seq").write_bytes(content)
    assert failure(tmp_path / "a.seq") == f"a.seq cannot be read: {reason}"


# ---------------------------------------------------------------- video


def write_video(path, codec, grey):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 10, (64, 48), isColor=True)
    assert writer.isOpened()
    for level in grey:
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize(
    ("codec", "suffix", "tolerance"),
    # FFV1 is lossless; the others round amplitudes and convert to YUV: within half a step of 5 levels
    [("FFV1", ".avi", 0), ("MJPG", ".avi", 2.5), ("mp4v", ".mp4", 2.5)],
)
def test_video_gives_the_frame_asked_for(tmp_path, codec, suffix, tolerance):
    grey = 10 + 5 * np.arange(40)
    frames = read_frames(write_video(tmp_path / f"v{suffix}", codec, grey))
    assert frames.names == [f"v{suffix}[{k}]" for k in range(40)]
    for k in (39, 0, 13, 14, 2):  # out of order
        frame = frames[k]
        assert frame.shape == (48, 64)
        assert frame.full_scale == 255
        np.testing.assert_allclose(frame.image, grey[k], atol=tolerance)


def test_video_colours_are_red_green_blue(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    writer.write(np.full((48, 64, 3), (200, 100, 20), np.uint8))  # OpenCV: blue, green, red
    writer.release()
    frame = only_frame(tmp_path / "v.avi")
    # 0.299 20 + 0.587 100 + 0.114 200 = 87.48, in the order of the bytes 120.8; JPEG rounds by a few levels
    np.testing.assert_allclose(frame.image, 87.48, atol=3)


def test_truncated_video_fails_where_it_ends(tmp_path):
    path = write_video(tmp_path / "v.avi", "MJPG", 10 + 5 * np.arange(40))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert failure(path, -1) == ("v.avi[39] cannot be read: the video is truncated or damaged at this image")
    assert read_frames(path)[0].shape == (48, 64)


def test_video_stays_silent_also_after_opencv_has_spoken(tmp_path):
    """FFmpeg takes its log level once, so a program that used OpenCV before must be silenced too."""
    path = write_video(tmp_path / "v.avi", "MJPG", 10 + 5 * np.arange(40))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    program = (
        "import sys, cv2; from contactimg import read_frames, FrameError\n"
        "cv2.VideoCapture(sys.argv[1]).read()\n"
        "sys.stderr.write('BEFORE'); sys.stderr.flush()\n"
        "try: read_frames(sys.argv[1])[39]\n"
        "except FrameError: pass\n"
        "sys.stderr.write('AFTER')\n"
    )
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
    )
    assert done.stderr.endswith("BEFOREAFTER")


# ---------------------------------------------------------------- bad files


@pytest.mark.parametrize(
    ("suffix", "reason"),
    [
        (".tif", "the content is not that of a TIFF image"),
        (".png", "the content is not that of a PNG, JPEG or BMP image"),
        (".jpg", "the content is not that of a PNG, JPEG or BMP image"),
        (".bmp", "the content is not that of a PNG, JPEG or BMP image"),
        (".avi", "the content is not that of a video that OpenCV can decode"),
    ],
)
def test_text_called_like_an_image(tmp_path, capfd, suffix, reason):
    path = tmp_path / f"notes{suffix}"
    path.write_text("frame, load\n1, 2\n" * 20)
    assert failure(path) == f"notes{suffix} cannot be read: {reason}"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", [".tif", ".png", ".jpg", ".bmp", ".seq", ".avi"])
def test_empty_file(tmp_path, capfd, suffix):
    (tmp_path / f"a{suffix}").touch()
    assert failure(tmp_path / f"a{suffix}") == f"a{suffix} cannot be read: the file is empty (0 bytes)"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
@pytest.mark.parametrize("share", [0.0005, 0.02, 0.5, 0.99])
def test_truncated_tiff(tmp_path, capfd, rng, compression, share):
    noise = rng.integers(0, 65536, (200, 120)).astype(np.uint16)
    path = write_tiff(tmp_path / "a.tif", noise, compression=compression)
    path.write_bytes(path.read_bytes()[: max(5, int(share * path.stat().st_size))])
    assert failure(path).startswith("a.tif cannot be read: the file is truncated")
    assert capfd.readouterr() == ("", "")


def test_a_tiff_without_pages_is_damaged(tmp_path):
    (tmp_path / "a.tif").write_bytes(b"II*\0broken")
    assert failure(tmp_path / "a.tif").startswith("a.tif cannot be read: the file is truncated or damaged")


def test_truncated_tiff_says_how_much_is_missing(tmp_path, levels):
    path = write_tiff(tmp_path / "a.tif", levels)
    path.write_bytes(path.read_bytes()[:-10])
    assert failure(path) == "a.tif cannot be read: the file is truncated: 10 bytes are missing"


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp"])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_truncated_still(tmp_path, capfd, colour, suffix, share):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(colour).save(path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    assert failure(path).startswith(f"a{suffix} cannot be read: ")
    assert capfd.readouterr() == ("", "")


def test_broken_chain_of_pages_is_not_a_shorter_series(tmp_path, caplog, levels):
    path = write_tiff(tmp_path / "s.tif", np.stack([levels] * 3), metadata=None)
    cut_chain(path, to=path.stat().st_size + 1000)
    frames = read_frames(path)
    assert len(frames) == 2
    np.testing.assert_array_equal(frames[0].image, levels)
    assert failure(path, 1) == "s.tif[1] cannot be read: the file is truncated or damaged after page 0"
    assert not caplog.records


def test_flipped_bit_in_compressed_data(tmp_path, rng):
    path = write_tiff(tmp_path / "a.tif", rng.integers(0, 9, (200, 120)).astype(np.uint8), compression="zlib")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    assert failure(path).startswith("a.tif cannot be read: ")


@pytest.mark.parametrize(
    ("array", "options", "reason"),
    [
        (np.ones((4, 5), "c8"), {}, "pixels of type complex64 are not supported"),
        (np.ones((4, 5), "u8"), {}, "pixels of type uint64 are not supported"),
        (
            np.ones((4, 5, 4), "u1"),
            {"photometric": "separated"},
            "pixels of photometric type SEPARATED are not supported: save it as grey levels",
        ),
        (
            np.ones((4, 5), "u1"),
            {"photometric": "cfa"},
            "pixels of photometric type CFA are not supported: save it as grey levels",
        ),
        (
            np.ones((4, 5, 2), "u1"),
            {"planarconfig": "contig"},
            "2 channels are neither grey nor red-green-blue",
        ),
        (
            np.ones((4, 5), "f4"),
            {"photometric": "miniswhite"},
            "inverted grey levels of type float32 are not supported",
        ),
        (
            np.ones((3, 32, 48), "u1"),
            {"volumetric": True, "tile": (1, 16, 16)},
            "an image with axes ZYX is not a plane of pixels",
        ),
    ],
)
def test_tiff_without_grey_levels(tmp_path, array, options, reason):
    path = write_tiff(tmp_path / "a.tif", array, **options)
    assert failure(path) == f"a.tif cannot be read: {reason}"


def test_cmyk_jpeg(tmp_path, colour):
    Image.fromarray(colour).convert("CMYK").save(tmp_path / "a.jpg")
    assert failure(tmp_path / "a.jpg") == "a.jpg cannot be read: colours of type CMYK are not supported"


def test_file_that_vanished_after_it_was_listed(tmp_path, levels):
    frames = read_frames(write_tiff(tmp_path / "a.tif", levels))
    (tmp_path / "a.tif").unlink()
    with pytest.raises(FrameError, match=r"^a\.tif cannot be read: No such file or directory$"):
        frames[0]


def test_folder_in_place_of_a_file(tmp_path):
    with pytest.raises(FrameError, match=r"^a\.tif cannot be read: it is a folder, not a file$"):
        FrameSource("a.tif", tmp_path).read()


def test_one_bad_file_does_not_concern_the_others(tmp_path, levels):
    for k in range(3):
        write_tiff(tmp_path / f"frame_{k}.tif", levels + k)
    (tmp_path / "frame_1.tif").write_text("lost")
    frames = read_frames(tmp_path)
    assert len(frames) == 3
    assert [frames[0].image[0, 0], frames[2].image[0, 0]] == [levels[0, 0], levels[0, 0] + 2]
    with pytest.raises(FrameError, match="frame_1"):
        frames[1]


# ---------------------------------------------------------------- lists, order, names


def test_natural_order_and_what_is_passed_over(tmp_path, levels):
    for name in ("frame_10.tif", "frame_2.TIF", "frame_1.png", ".hidden.tif", "Frame_3.bmp"):
        image = (levels // 16).astype(np.uint8)
        if name.lower().endswith("tif"):
            write_tiff(tmp_path / name, image)
        else:
            Image.fromarray(image).save(tmp_path / name)
    for name in ("loads.csv", "scene.toml", "notes.txt", "Thumbs.db"):
        (tmp_path / name).write_text("x")
    (tmp_path / "contactimg_out").mkdir()
    write_tiff(tmp_path / "contactimg_out" / "overlay.tif", levels)
    (tmp_path / "folder.tif").mkdir()
    assert read_frames(tmp_path).names == ["frame_1.png", "frame_2.TIF", "Frame_3.bmp", "frame_10.tif"]
    assert read_frames(f"{tmp_path}/frame_*").names == ["frame_1.png", "frame_2.TIF", "frame_10.tif"]
    given = [tmp_path / "frame_10.tif", str(tmp_path / "frame_1.png")]
    assert read_frames(given).names == ["frame_10.tif", "frame_1.png"]
    assert [s.name for s in list_frames(["frame_10.tif", "*.bmp"], folder=tmp_path)] == [
        "frame_10.tif",
        "Frame_3.bmp",
    ]


def test_file_name_with_the_characters_of_a_glob(tmp_path, levels):
    folder = tmp_path / "run [1]"
    folder.mkdir()
    write_tiff(folder / "a[1].tif", levels)
    assert read_frames(folder / "a[1].tif").names == ["a[1].tif"]
    assert [source.name for source in list_frames("*.tif", folder=folder)] == ["a[1].tif"]


@given(st.lists(st.text(), max_size=6))
def test_natural_key_is_a_total_order_on_any_text(names):
    ordered = sorted(names, key=natural_key)
    shuffled = names[1:] + names[:1]
    assert sorted(shuffled, key=natural_key) == ordered


@given(st.integers(0, 10**20), st.integers(0, 10**20))
def test_natural_key_orders_numbers_by_value(first, second):
    assert (natural_key(f"f{first}.tif") < natural_key(f"f{second}.tif")) == (first < second)


def test_empty_folder(tmp_path):
    (tmp_path / "loads.csv").write_text("frame,load_N\n")
    with pytest.raises(InputError) as caught:
        read_frames(tmp_path)
    assert str(caught.value) == f"{tmp_path} holds no image file; looked for {', '.join(SUFFIXES)}"


def test_glob_that_matches_nothing(tmp_path):
    with pytest.raises(InputError) as caught:
        list_frames("frame_*.tif", folder=tmp_path)
    assert str(caught.value) == (
        f"{tmp_path / 'frame_*.tif'} matches no image file; looked for {', '.join(SUFFIXES)}"
    )


def test_no_such_file_empty_list_and_foreign_extension(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.tif: there is no such file or folder$"):
        read_frames(tmp_path / "nowhere.tif")
    with pytest.raises(
        InputError, match=r"^the list of frames is empty; name at least one file, folder or glob$"
    ):
        read_frames([])
    (tmp_path / "a.doc").touch()
    with pytest.raises(
        InputError, match=r"a\.doc: frames have one of the extensions \.tif, .*, got '\.doc'$"
    ):
        read_frames(tmp_path / "a.doc")


def test_two_frames_of_one_name(tmp_path, levels):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_tiff(tmp_path / folder / "a.tif", levels)
    with pytest.raises(
        InputError, match=r"^2 frames are called a\.tif \(.*one.*and.*two.*\); rename one of them$"
    ):
        read_frames(f"{tmp_path}/*/a.tif")
    with pytest.raises(InputError, match=r"^2 frames are called a\.tif .*; name it once$"):
        list_frames([tmp_path / "one" / "a.tif"] * 2)


def test_listing_reads_no_image_and_reading_keeps_none(tmp_path, levels, monkeypatch):
    for k in range(4):
        write_tiff(tmp_path / f"frame_{k}.tif", levels)
    reads = []
    original = FrameSource.read
    monkeypatch.setattr(FrameSource, "read", lambda self: reads.append(self.name) or original(self))
    frames = read_frames(tmp_path)
    part = frames[1:3]
    assert (len(frames), len(part), part.names, reads) == (4, 2, ["frame_1.tif", "frame_2.tif"], [])
    assert next(iter(part)).name == "frame_1.tif"
    assert reads == ["frame_1.tif"]
    assert frames[0] is not frames[0]
    with pytest.raises(IndexError):
        frames[4]


def test_sources_travel_to_workers(tmp_path, levels):
    stack = np.stack([levels, levels + 1, levels + 2])
    sources = list_frames(write_tiff(tmp_path / "s.tif", stack))
    assert len(pickle.dumps(sources[2])) < 1000
    assert pickle.loads(pickle.dumps(sources[2])) == sources[2]  # noqa: S301
    with ThreadPoolExecutor(2) as pool:
        sums = list(pool.map(lambda source: int(source.read().image.sum()), sources))
    assert sums == [int(image.sum()) for image in stack]


# ---------------------------------------------------------------- writing


@pytest.mark.parametrize(
    ("dtype", "full_scale"),
    [("uint8", 255.0), ("uint16", 4095.0), ("uint16", 65535.0), ("float32", None), ("float64", None)],
)
def test_written_frame_is_read_back(tmp_path, levels, dtype, full_scale):
    frame = Frame((levels // 16 if dtype == "uint8" else levels).astype(dtype), "a.tif", full_scale)
    write_frame(frame, tmp_path / "a.tif")
    again = only_frame(tmp_path / "a.tif")
    np.testing.assert_array_equal(again.image, frame.image)
    assert (again.image.dtype, again.full_scale, again.name) == (frame.image.dtype, full_scale, "a.tif")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), frame.image)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_writing_is_compressed_and_repeatable(tmp_path):
    smooth = Frame(np.add.outer(np.arange(300), np.arange(200)).astype(np.uint16), "", 4095.0)
    write_frame(smooth, tmp_path / "a.tif")
    write_frame(smooth, tmp_path / "b.tif")
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
    assert (tmp_path / "a.tif").stat().st_size < smooth.image.nbytes / 10


def test_a_link_to_a_file_that_is_gone_is_a_frame_that_cannot_be_read(tmp_path, levels):
    write_tiff(tmp_path / "frame_1.tif", levels)
    (tmp_path / "frame_2.tif").symlink_to(tmp_path / "gone.tif")
    for path in (tmp_path, tmp_path / "frame_*.tif"):
        frames = list_frames(path)
        assert [frame.name for frame in frames] == ["frame_1.tif", "frame_2.tif"]
        with pytest.raises(FrameError, match=r"frame_2\.tif cannot be read: No such file"):
            frames[1].read()


def test_a_long_series_is_listed_in_little_memory(tmp_path, levels):
    """The list of 10^5 frames must not decide about the memory of a run."""
    write_tiff(tmp_path / "frame_00000.tif", levels)
    for number in range(1, 1000):
        (tmp_path / f"frame_{number:05d}.tif").symlink_to(tmp_path / "frame_00000.tif")
    list_frames(tmp_path)
    tracemalloc.start()
    frames = list_frames(tmp_path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(frames) == 1000
    # a tenth of what a frame may take: 1 GB for 10^5 of them
    assert most < 1000 * len(frames)
