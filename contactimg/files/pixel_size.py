"""The pixel size that the header of an image states."""

import math
from contextlib import suppress
from pathlib import Path

import tifffile

_METRES = {
    "m": 1.0,
    "mm": 1e-3,
    "millimeter": 1e-3,
    "um": 1e-6,
    "µm": 1e-6,  # micro sign
    "μm": 1e-6,  # Greek mu
    "\\u00b5m": 1e-6,  # how ImageJ escapes the micro sign
    "micron": 1e-6,
    "microns": 1e-6,
    "micrometer": 1e-6,
    "nm": 1e-9,
}


def stated_pixel_size(path: str | Path) -> float | None:
    """Pixel size in m that a TIFF file of ImageJ or OME states; None where none or an unknown unit is stated.

    The resolution of plain TIFF files is ignored: it is that of a print (72 or 300 dots per inch).

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "frame.tif"
    ...     pixels = np.zeros((8, 8), np.uint8)
    ...     tifffile.imwrite(path, pixels, imagej=True, resolution=(0.125, 0.125), metadata={"unit": "um"})
    ...     stated_pixel_size(path)
    8e-06
    """
    if Path(path).suffix.lower() not in (".tif", ".tiff"):
        return None
    with suppress(Exception), tifffile.TiffFile(path) as tif:  # a damaged header states nothing
        size = _of_ome(tif) if tif.is_ome else _of_imagej(tif)
        if size is not None and math.isfinite(size) and size > 0:
            return size
    return None


def _of_imagej(tif: tifffile.TiffFile) -> float | None:
    """Pixels per unit stand in the resolution, the unit in the description."""
    unit = (tif.imagej_metadata or {}).get("unit", "")
    tag = tif.pages.first.tags.get("XResolution")
    if tag is None or str(unit).lower() not in _METRES:
        return None
    pixels, units = tag.value
    return _METRES[str(unit).lower()] / (pixels / units)


def _of_ome(tif: tifffile.TiffFile) -> float | None:
    """PhysicalSizeX of the first image, in µm unless its unit says otherwise."""
    image = tifffile.xml2dict(tif.ome_metadata or "")["OME"]["Image"]
    pixels = (image[0] if isinstance(image, list) else image)["Pixels"]
    return float(pixels["PhysicalSizeX"]) * _METRES[str(pixels.get("PhysicalSizeXUnit", "µm"))]
