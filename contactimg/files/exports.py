"""Contacts for other programs: regions of ImageJ, layers of napari, label images, workbooks of Excel.

ImageJ counts from the corner of the first pixel, this package and napari from its centre: 0.5 px lie between
the two.
"""

import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray
from openpyxl import Workbook
from openpyxl.cell import WriteOnlyCell
from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE
from roifile import ROI_OPTIONS, ROI_TYPE, ImagejRoi, roiread

from contactimg.errors import InputError
from contactimg.files.atomic import first_names, read_bytes, replacing, write_text
from contactimg.files.decoders import LOSSLESS
from contactimg.tables import Schema, flag_names
from contactimg.tables.outlines import Outline

CORNER_TO_CENTRE_PX = 0.5
"""Position in ImageJ minus position here, px."""


@dataclass(frozen=True, eq=False)
class Region(Outline):
    """One region of interest: an oval, or a polygon, whose centre is its centroid.

    Parameters
    ----------
    name : str
    image : int
        Number of the image in a stack that it belongs to, from 1; 0 for all.
    colour : str
        Of its outline, ``#rrggbb``; empty for ImageJ's own.
    """

    name: str = ""
    image: int = 0
    colour: str = ""

    @property
    def radius(self) -> float:
        """Radius of the disk of the same area, px."""
        return float(np.sqrt(self.semi_major * self.semi_minor))


def region_of(outline: Outline, *, name: str, colour: str = "") -> Region:
    """The region of a contact: an oval, or a polygon for a tilted ellipse or a free shape.

    Examples
    --------
    >>> region_of(Outline(3, 10.0, 20.0, 5.0, 4.0, 0.5), name="a").polygon[0].tolist()
    [14.387912809451864, 22.397127693021016]
    """
    tilted = outline.semi_major != outline.semi_minor and outline.angle != 0.0
    polygon = polygon_region(name, outline.polygon[:-1]) if outline.lines or tilted else None
    return replace(polygon or Region(**vars(outline), name=name), colour=colour)


def read_regions(path: str | Path) -> list[Region]:
    """Read the regions of a .roi or .zip file, or of the overlay of a TIFF that ImageJ wrote.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no region with an area, or one of several outlines.
    """
    path = Path(path)
    read_bytes(path)  # says what hinders
    try:
        rois = roiread(path)
    except Exception:  # whatever a damaged file makes of the decoder
        cure = "save the regions with the ROI Manager (.roi, .zip), or the frame with its overlay as TIFF"
        raise InputError(f"{path}: is not an ImageJ ROI file; {cure}") from None
    rois = rois if isinstance(rois, list) else [rois]
    if composite := [roi.name or "one without a name" for roi in rois if roi.composite]:
        cure = "split it in the ROI Manager (More > Split), or give its mask as an image (Create Mask)"
        raise InputError(f"{path}: holds a region of several outlines ({first_names(composite)}); {cure}")
    regions = [region for roi in rois if (region := _region(roi)) is not None]
    if not regions:
        raise InputError(f"{path}: holds no region with an area (oval, rectangle, polygon or freehand)")
    return regions


def write_regions(regions: Iterable[Region], path: str | Path) -> None:
    """Write regions as a .zip file for ImageJ's ROI Manager, whole or not at all."""
    with replacing(path) as target, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for region in regions:
            # a fixed date: the same regions give the same bytes
            archive.writestr(zipfile.ZipInfo(f"{region.name}.roi"), imagej_roi(region).tobytes())


def imagej_roi(region: Region) -> ImagejRoi:
    """The region in ImageJ's own form, with sub-pixel coordinates."""
    if region.lines:
        roi = ImagejRoi.frompoints(region.polygon[:-1] + CORNER_TO_CENTRE_PX, name=region.name)
        roi.roitype = ROI_TYPE.POLYGON
    else:
        roi = ImagejRoi()
        roi.version, roi.roitype, roi.name = 228, ROI_TYPE.OVAL, region.name
        roi.options = ROI_OPTIONS.SUB_PIXEL_RESOLUTION
        roi.xd = region.x - region.semi_major + CORNER_TO_CENTRE_PX
        roi.yd = region.y - region.semi_minor + CORNER_TO_CENTRE_PX
        roi.widthd, roi.heightd = 2 * region.semi_major, 2 * region.semi_minor
        roi.left, roi.top = int(np.floor(roi.xd)), int(np.floor(roi.yd))
        roi.right = int(np.ceil(roi.xd + roi.widthd))
        roi.bottom = int(np.ceil(roi.yd + roi.heightd))
    roi.position = roi.t_position = region.image
    if region.colour:
        roi.stroke_color = bytes([255, *bytes.fromhex(region.colour[1:])])
    return roi


def _region(roi: ImagejRoi) -> Region | None:
    """A region with an area; None for points and lines."""
    image = max(roi.position, roi.t_position, roi.z_position, 0)
    if roi.roitype in (ROI_TYPE.OVAL, ROI_TYPE.RECT):
        box = roi.left, roi.top, roi.right - roi.left, roi.bottom - roi.top
        x, y, width, height = (roi.xd, roi.yd, roi.widthd, roi.heightd) if roi.subpixelrect else box
        if not (width > 0 and height > 0):
            return None
        if roi.roitype == ROI_TYPE.OVAL:
            centre = x + width / 2 - CORNER_TO_CENTRE_PX, y + height / 2 - CORNER_TO_CENTRE_PX
            return Region(0, *centre, width / 2, height / 2, name=roi.name, image=image)
        corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])
    elif roi.roitype in (ROI_TYPE.POLYGON, ROI_TYPE.FREEHAND, ROI_TYPE.TRACED, ROI_TYPE.NOROI):
        corners = np.asarray(roi.coordinates(), float)
    else:
        return None
    return polygon_region(roi.name, corners - CORNER_TO_CENTRE_PX, image=image)


def polygon_region(name: str, corners: NDArray[np.float64], *, image: int = 0) -> Region | None:
    """The region inside a polygon (corners in px); None if it has no area."""
    if len(corners) < 3:
        return None
    x, y = corners.T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    cross = x * next_y - next_x * y
    area = cross.sum() / 2
    if abs(area) < 1e-9:
        return None
    centre_x, centre_y = (float((a + b) @ cross / (6 * area)) for a, b in ((x, next_x), (y, next_y)))
    radius, closed = float(np.sqrt(abs(area) / np.pi)), np.vstack([corners, corners[:1]])
    return Region(0, centre_x, centre_y, radius, radius, lines=(closed,), name=name, image=image)


def write_overlay(image: NDArray, regions: Iterable[Region], path: Path, *, pixel_size: float | None) -> None:
    """Write a frame as a TIFF that ImageJ opens with the regions as its overlay, whole or not at all.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels.
    regions : iterable of Region
    path : Path
    pixel_size : float or None
        Sample length per pixel, m: ImageJ then measures in um.
    """
    image = image if image.dtype in (np.uint8, np.uint16) else np.asarray(image, np.float32)
    metadata: dict[str, Any] = {"Overlays": [imagej_roi(region).tobytes() for region in regions]}
    metadata |= {} if pixel_size is None else {"unit": "um"}
    resolution = None if pixel_size is None else (1e-6 / pixel_size, 1e-6 / pixel_size)
    with replacing(path) as part:
        tifffile.imwrite(part, image, imagej=True, metadata=metadata, resolution=resolution)


# --- label images, and layers of napari


def label_image(outlines: Sequence[Outline], shape: tuple[int, ...]) -> NDArray[np.uint16 | np.uint32]:
    """The label of the contact in which the centre of each pixel lies, 0 in none.

    Where contacts overlap, the smaller one has the pixel. A contact without the centre of a pixel gets the
    nearest pixel.

    Examples
    --------
    >>> label_image([Outline(7, 2.0, 1.0, 1.1, 1.1)], (3, 4)).tolist()
    [[0, 0, 7, 0], [0, 7, 7, 7], [0, 0, 7, 0]]
    """
    from skimage.draw import polygon  # noqa: PLC0415 - slow to import, seldom needed

    highest = max((outline.label for outline in outlines), default=0)
    labels = np.zeros(shape, np.uint16 if highest < 2**16 else np.uint32)
    for outline in sorted(outlines, key=lambda one: -one.semi_major * one.semi_minor):
        x, y = outline.polygon.T.copy()  # the columns of a table cannot be written to, as `polygon` wants
        rows, columns = polygon(y, x, shape)
        if not len(rows):
            nearest = np.clip(np.rint([outline.y, outline.x]), 0, np.array(shape) - 1)
            rows, columns = nearest.astype(int)[:, np.newaxis]
        labels[rows, columns] = outline.label
    return labels


def write_labels(outlines: Sequence[Outline], shape: tuple[int, ...], path: Path) -> None:
    """Write the label image of one frame as a TIFF, whole or not at all."""
    labels = label_image(outlines, shape)
    with replacing(path) as part:
        tifffile.imwrite(part, labels, **LOSSLESS)


def write_napari_shapes(outlines: Sequence[Outline], path: Path) -> None:
    """Write the outlines of the contacts of one frame as a shapes layer.

    An ellipse is given by the four corners around it; a free shape is a polygon, each of its holes a path.
    """
    shapes = [shape for outline in outlines for shape in napari_shapes(outline)]
    rows = [
        (index, kind, vertex, y, x)
        for index, (kind, points) in enumerate(shapes)
        for vertex, (x, y) in enumerate(points.tolist())
    ]
    table = pd.DataFrame(rows, columns=["index", "shape-type", "vertex-index", "axis-0", "axis-1"])
    write_text(table.to_csv(index=False, lineterminator="\n"), path)


def napari_shapes(outline: Outline) -> list[tuple[str, NDArray[np.float64]]]:
    """Napari's shapes for one contact, each its type and points (x, y): the contact, then its holes."""
    if outline.lines:
        return [("polygon", outline.lines[0][:-1]), *(("path", hole) for hole in outline.lines[1:])]
    a, b, angle = outline.semi_major, outline.semi_minor, outline.angle
    along = a * np.array([np.cos(angle), np.sin(angle)])
    across = b * np.array([-np.sin(angle), np.cos(angle)])
    corners = np.array([-along - across, along - across, along + across, across - along])
    return [("ellipse", corners + np.array([outline.x, outline.y]))]


def write_napari_points(contacts: pd.DataFrame, path: Path) -> None:
    """Write the centres as a points layer, with label, radius, force and flags as properties."""
    layer = contacts[["y_px", "x_px", "label", "radius_px", "radius_std_px", "force_N"]].assign(
        flags=flag_names(contacts["flags"])
    )
    layer = layer.rename(columns={"y_px": "axis-0", "x_px": "axis-1"}).reset_index(drop=True)
    write_text(layer.rename_axis("index").to_csv(lineterminator="\n"), path)


# --- workbooks of Excel: one sheet a table, units in the headers, in units that people use

_FORCE, _STRESS = ("mN", 1e3), ("MPa", 1e-6)
UNITS = {
    "um": {"_m": ("µm", 1e6), "_m2": ("µm²", 1e12), "_N": _FORCE, "_Pa": _STRESS},
    "mm": {"_m": ("mm", 1e3), "_m2": ("mm²", 1e6), "_N": _FORCE, "_Pa": _STRESS},
    "m": {"_m": ("m", 1.0), "_m2": ("m²", 1.0), "_N": ("N", 1.0), "_Pa": ("Pa", 1.0)},
}
"""Name of a system of units -> ending of a column's name -> unit, how many are one of the column's."""
_SAME = {"_px": ("px", 1.0), "_px2": ("px²", 1.0), "_rad": ("rad", 1.0)}


def heading(column: str, units: str) -> tuple[str, float]:
    """Header of a column, and the factor of its values.

    Examples
    --------
    >>> heading("radius_std_m", "um"), heading("x_px", "um"), heading("flags", "um")
    (('radius std (µm)', 1000000.0), ('x (px)', 1.0), ('flags', 1.0))
    """
    for ending, (unit, factor) in (UNITS[units] | _SAME).items():
        if column.endswith(ending):
            return f"{column.removesuffix(ending).replace('_', ' ')} ({unit})", factor
    return column.replace("_", " "), 1.0


def write_workbook(tables: Sequence[tuple[Schema, pd.DataFrame]], path: Path, *, units: str) -> None:
    """Write tables as a workbook, whole or not at all.

    Parameters
    ----------
    tables : sequence of (Schema, DataFrame)
        One sheet each, in order, then a sheet that explains the columns.
    path : Path
        The file, with the extension .xlsx.
    units : {"um", "mm", "m"}
        Units of lengths, areas and forces.

    Raises
    ------
    InputError
        If a table has more rows than a sheet can hold.
    """
    sheets, meanings = {}, []
    for schema, table in tables:
        if len(table) >= 2**20:  # the limit of Excel, header included
            raise InputError(f"{path}: {len(table):,} rows of {schema.name} do not fit a sheet; use the CSV")
        cells = schema.conform(table)
        if "flags" in cells:
            cells = cells.assign(flags=flag_names(cells["flags"]))
        for name, (dtype, meaning) in schema.columns.items():
            head, factor = heading(name, units)
            meanings.append([schema.name, head, name, meaning])
            if dtype == "float64":
                cells[name] *= factor
        sheets[schema.name] = cells.rename(columns=lambda name: heading(name, units)[0])
    sheets["columns"] = pd.DataFrame(meanings, columns=["sheet", "column", "name in the CSV", "meaning"])
    book = Workbook(write_only=True)
    for name, cells in sheets.items():
        sheet = book.create_sheet(name)
        sheet.freeze_panes = "A2"  # the header stays in view
        rows = cells.astype(object).where(cells.notna(), None).to_numpy().tolist()
        for row in [list(cells.columns), *rows]:
            sheet.append([_cell(sheet, value) for value in row])
    with replacing(path) as part, part.open("wb") as file:
        book.save(file)


def _cell(sheet: Any, value: Any) -> Any:
    """A cell, text as text even if it looks like a formula."""
    if not isinstance(value, str):
        return value
    text = ILLEGAL_CHARACTERS_RE.sub("\ufffd", value.encode("utf-8", "replace").decode())
    cell = WriteOnlyCell(sheet, text)
    cell.data_type = "s"
    return cell
