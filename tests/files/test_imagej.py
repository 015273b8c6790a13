"""ImageJ regions: both directions, by roifile always and by ImageJ itself where it is installed."""

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import tifffile
from roifile import ROI_TYPE, ImagejRoi

from contactimg.errors import InputError
from contactimg.files.exports import (
    Region,
    polygon_region,
    read_regions,
    region_of,
    write_overlay,
    write_regions,
)
from contactimg.tables.outlines import Outline

IMAGEJ = Path("/usr/share/java/ij.jar")  # of Debian's libij-java
HAS_IMAGEJ = IMAGEJ.exists() and shutil.which("javac") is not None and shutil.which("java") is not None


@pytest.fixture
def regions(rng):
    places = np.column_stack(
        [rng.uniform(0, 4000, 500), rng.uniform(0, 3000, 500), rng.uniform(0.4, 80, 500)]
    )
    return [
        Region(k, x, y, a, a, name=f"contact_{k:04d}", colour="#56b4e9")
        for k, (x, y, a) in enumerate(places.tolist())
    ]


def check(found, regions, *, moved=0.0):
    assert [region.name for region in found] == [region.name for region in regions]
    for region, original in zip(found, regions, strict=True):
        assert abs(region.x - original.x - moved) < 1e-3
        assert abs(region.y - original.y) < 1e-3
        assert abs(region.radius - original.radius) < 1e-3


def test_ovals_come_back(regions, tmp_path):
    write_regions(regions, tmp_path / "a.zip")
    check(read_regions(tmp_path / "a.zip"), regions)


def test_the_same_regions_give_the_same_bytes(regions, tmp_path):
    for name in ("a.zip", "b.zip"):
        write_regions(regions, tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_polygons_come_back(tmp_path):
    corners = np.array([(1.25, 2.5), (11.75, 2.5), (11.75, 7.0), (1.25, 7.0)])
    write_regions([polygon_region("box", corners)], tmp_path / "a.zip")
    (box,) = read_regions(tmp_path / "a.zip")
    np.testing.assert_allclose(box.polygon[:-1], corners, atol=1e-4)
    assert math.pi * box.radius**2 == pytest.approx(10.5 * 4.5, rel=1e-6)
    assert (box.x, box.y) == pytest.approx((6.5, 4.75))


def test_a_region_of_several_outlines_is_not_taken_for_its_box(tmp_path):
    """Such as of a selection by a threshold: two triangles, far smaller than the box around both."""
    roi = ImagejRoi(roitype=ROI_TYPE.RECT, right=100, bottom=100, name="dust")
    path = [0, 0, 0, 1, 9, 0, 1, 0, 9, 4, 0, 100, 100, 1, 91, 100, 1, 100, 91, 4]  # move, lines, close
    roi.multi_coordinates, roi.shape_roi_size = np.array(path, np.float32), len(path)
    (tmp_path / "a.roi").write_bytes(roi.tobytes())
    with pytest.raises(InputError, match=r"a\.roi: holds a region of several outlines \(dust\); split it"):
        read_regions(tmp_path / "a.roi")


def test_the_overlay_of_a_tiff_comes_back(regions, tmp_path, rng):
    image = rng.integers(0, 255, (30, 40)).astype(np.uint8)
    write_overlay(image, regions, tmp_path / "a.tif", pixel_size=6e-6)
    check(read_regions(tmp_path / "a.tif"), regions)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        assert (file.asarray() == image).all()
        tag = file.pages[0].tags["XResolution"].value
        assert tag[1] / tag[0] == pytest.approx(6.0)  # um per pixel
        assert file.imagej_metadata["unit"] == "um"


@pytest.mark.skipif(not HAS_IMAGEJ, reason="needs ImageJ (libij-java) and a Java compiler")
def test_imagej_itself_reads_and_writes_the_same_disks(regions, tmp_path):
    source = tmp_path / "ImagejRoundTrip.java"
    source.write_text(Path(__file__).with_name("imagej_round_trip.java").read_text(encoding="utf-8"))
    subprocess.run(["javac", "-cp", str(IMAGEJ), str(source)], check=True, timeout=120)  # noqa: S603, S607
    write_regions(regions, tmp_path / "a.zip")
    run = ["java", "-Djava.awt.headless=true", "-cp", f"{IMAGEJ}:{tmp_path}", "ImagejRoundTrip"]
    done = subprocess.run(  # noqa: S603
        [*run, str(tmp_path / "a.zip"), str(tmp_path / "b.zip")],
        check=True, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    lines = [line.split(",") for line in done.stdout.splitlines()]
    assert len(lines) == 500
    for (name, oval, *box), region in zip(lines, regions, strict=True):
        x, y, width, height = map(float, box)
        assert (name, oval) == (region.name, "true")
        assert abs(x + width / 2 - 0.5 - region.x) < 1e-3
        assert abs(y + height / 2 - 0.5 - region.y) < 1e-3
        assert abs(math.sqrt(width * height) / 2 - region.radius) < 1e-3
    check(read_regions(tmp_path / "b.zip"), regions, moved=1.25)


def test_ellipses_and_shapes_with_holes_are_polygons_of_their_area():
    ellipse = region_of(Outline(1, 20.0, 30.0, 9.0, 4.0, 0.7), name="a")
    assert (ellipse.x, ellipse.y) == pytest.approx((20.0, 30.0))
    assert math.pi * ellipse.radius**2 == pytest.approx(math.pi * 36.0, rel=3e-4)
    far = ellipse.polygon[0] - [20.0, 30.0]
    assert far == pytest.approx([9 * math.cos(0.7), 9 * math.sin(0.7)])
    square = np.array([(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0), (0.0, 0.0)])
    hole = square[::-1] / 4 + 3.0
    pierced = region_of(Outline(2, 4.0, 4.0, 4.4, 4.4, lines=(square, hole)), name="b")
    assert math.pi * pierced.radius**2 == pytest.approx(64 - 4)
    assert len(pierced.polygon) == 4 + 4 + 2 + 1
