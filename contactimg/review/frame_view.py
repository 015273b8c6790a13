"""What the page shows of one frame: pictures, the pixels and the model about a contact, threshold curves."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.calibration.area_plateau import find_plateau
from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameTables
from contactimg.frame import Frame
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX
from contactimg.imaging.fit.shapes import render_ellipse
from contactimg.imaging.measure import ImageMeasurement, count_again
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.pipeline.calibrate.thresholds import THRESHOLDS
from contactimg.pipeline.frame import Edits, FrameOptions, count_pixels, film_setting, measure_prepared
from contactimg.pipeline.inputs import asperities_and_sites, read_reference
from contactimg.tables.outlines import Outline

Image = NDArray[np.float32]

LIGHT_TOP = 1.25
"""Fraction of the contrast that is 255 in a picture of the light of the contacts."""
MARGIN_BLUR_WIDTHS, MARGIN_RADII, LEAST_MARGIN_PX = 4.0, 0.8, 5.0
"""Margin of a window about its contact. Chosen: the blurred edge ends there, and neighbours show."""
LARGEST_SIDE_PX = 512
"""Largest side of a window; of a larger contact the middle is shown."""
OVERSAMPLING = 4
"""Pixels each way in which a free shape is drawn before it is blurred. Accuracy: 1/8 px."""


@dataclass(frozen=True, eq=False)
class FrameView:
    """A frame measured on its own, without corrections of its contacts.

    Parameters
    ----------
    frame : Frame
    reference : ndarray or None
    counted : ImageMeasurement
        By the method "threshold" at half height.
    blur : float, px
        Standard deviation of the point spread function.
    options : FrameOptions
        How the frames of the run are measured.
    """

    frame: Frame
    reference: NDArray | None
    counted: ImageMeasurement
    blur: float
    options: FrameOptions

    @classmethod
    def of(cls, experiment: Experiment, number: int) -> "FrameView":
        """Measure the frame of this number, with the masks of its scene."""
        reference, frame = read_reference(experiment), experiment.frames[number].read()
        _, sites = asperities_and_sites(experiment)
        options = FrameOptions(experiment.scene, film_setting(experiment.scene, sites))
        shown = frame, reference, options.scene
        blur = measure_prepared(*shown, method="disk", film=options.film).optics.blur_px
        counted = count_pixels(*shown)
        return cls(frame, reference, counted, blur if np.isfinite(blur) else DEFAULT_BLUR_PX, options)

    @property
    def light(self) -> Image:
        """Frame minus background over the contrast: 0 background, 1 contact."""
        contrast = self.counted.contrast
        return self.counted.difference * np.float32(1 / contrast if contrast else 0.0)

    def curves(self, edits: Edits, pixel_size: float | None) -> dict[str, Any]:
        """Number and area of the contacts against the threshold.

        Parameters
        ----------
        edits : tuple of HandEdit
            Corrections of the contacts of this frame.
        pixel_size : float or None, m
            With it areas are in m^2, else in px^2.

        Returns
        -------
        dict
            thresholds; counts and areas by `process` with the method "threshold" and the edits; scanned_areas
            that `calibrate threshold` and `calibrate plateau` see, without edits; unit of the areas; plateau:
            its lowest threshold, that of the slowest fall and the highest one, None where there is none.
        """
        counts, areas, scanned, shown = [], [], [], (self.frame, self.reference, self.options.scene)
        for threshold in THRESHOLDS.tolist():
            disks = count_pixels(*shown, threshold=threshold, edits=edits).disks
            seen = count_again(self.counted.foreground, threshold).disks if self.counted.contrast else disks
            counts.append(len(disks))
            areas.append(float(np.pi * np.sum(disks["radius_px"] ** 2)))
            scanned.append(float(np.pi * np.sum(seen["radius_px"] ** 2)))
        try:
            found = find_plateau(THRESHOLDS, scanned)
            plateau = (found.threshold_low, found.threshold, found.threshold_high)
        except InputError:
            plateau = None
        unit = 1.0 if pixel_size is None else pixel_size**2
        return {
            "thresholds": THRESHOLDS.tolist(),
            "counts": counts,
            "areas": [area * unit for area in areas],
            "scanned_areas": [area * unit for area in scanned],
            "unit": "px2" if pixel_size is None else "m2",
            "plateau": plateau,
        }

    def window(self, shown: FrameTables, label: int) -> dict[str, Any]:
        """Pixels about the contact with a label, and the model that the table states.

        Parameters
        ----------
        shown : FrameTables
            Of the frame, as the page shows them.
        label : int
            Label of a contact in the table.

        Returns
        -------
        dict
            columns, rows; pixels and model (base64 of int16, thousandths of the contrast); noise over the
            contrast.
        """
        shapes = shown.shapes
        one = next(shape for shape in shapes if shape.label == label)
        margin = max(MARGIN_BLUR_WIDTHS * self.blur, MARGIN_RADII * one.semi_major, LEAST_MARGIN_PX)
        half = min(one.semi_major + margin, LARGEST_SIDE_PX / 2)
        light = self.light
        rows, columns = light.shape
        x, y = min(max(one.x, 0), columns - 1), min(max(one.y, 0), rows - 1)
        left, top = max(int(x - half), 0), max(int(y - half), 0)
        pixels = light[top : int(y + half) + 2, left : int(x + half) + 2]
        others = [shape for shape in shapes if shape is not one]
        parts = [draw_contacts(few, self.blur, (left, top), pixels.shape) for few in ([one], others) if few]
        seen = [part.ravel() for part in parts if part.any()]
        design = np.array(seen, np.float32).reshape(len(seen), pixels.size).T
        values = np.linalg.lstsq(design, pixels.ravel(), rcond=None)[0]
        noise = self.counted.noise / abs(self.counted.contrast) if self.counted.contrast else 0.0
        return {
            "columns": pixels.shape[1],
            "rows": pixels.shape[0],
            "pixels": _packed(pixels),
            "model": _packed((design @ values).reshape(pixels.shape)),
            "noise": noise,
        }


def picture(image: NDArray, stretch: tuple[float, float]) -> bytes:
    """A PNG of an image between two grey levels; pixels without a value are black."""
    low, high = stretch
    scaled = (np.asarray(image, np.float32) - np.float32(low)) * np.float32(255.0 / (high - low))
    grey = np.clip(np.nan_to_num(scaled, nan=0.0, posinf=255.0, neginf=0.0), 0.0, 255.0)
    ok, data = cv2.imencode(".png", np.rint(grey).astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise FrameError("the picture cannot be encoded")
    return data.tobytes()


def draw_contacts(
    shapes: Sequence[Outline], blur: float, corner: tuple[int, int], size: tuple[int, ...]
) -> Image:
    """Draw blurred contacts of brightness 1 in a window.

    Parameters
    ----------
    shapes : sequence of Outline
        Contacts anywhere; those that do not reach into the window are left out.
    blur : float, px
        Standard deviation of the point spread function.
    corner : (int, int)
        Column and row of the first pixel of the window.
    size : (int, int)
        Rows and columns of the window.

    Examples
    --------
    >>> image = draw_contacts([Outline(1, 9.0, 9.0, 5.0, 5.0)], 1.0, (0, 0), (19, 19))
    >>> bool(image[9, 9] > 0.999), bool(abs(image.sum() / (25 * np.pi) - 1) < 1e-3)
    (True, True)
    """
    margin = int(np.ceil(MARGIN_BLUR_WIDTHS * blur)) + 1  # light from outside the window
    fine = np.zeros([(side + 2 * margin) * OVERSAMPLING for side in size], np.float32)
    image, wide = np.zeros(size, np.float32), float(np.hypot(blur, PIXEL_VARIANCE**0.5))
    for shape in shapes:
        if shape.lines:
            moved = [(line - corner + margin + 0.5) * OVERSAMPLING - 0.5 for line in shape.lines]
            corners, filled = [np.rint(line).astype(np.int32) for line in moved], np.zeros_like(fine)
            cv2.fillPoly(filled, corners, 1.0)
            cv2.polylines(filled, corners, True, 0.5)  # noqa: FBT003 - pixels on the line are half inside
            fine += filled
            continue
        place, reach = np.array([shape.x, shape.y]) - corner, shape.semi_major + margin
        if (place > -reach).all() and (place < np.array(size[::-1]) + reach).all():
            stretch, turn = np.log(shape.semi_major / shape.semi_minor) / 2, 2 * shape.angle
            ellipticity = stretch * np.cos(turn), stretch * np.sin(turn)
            radius = np.sqrt(shape.semi_major * shape.semi_minor)
            image += render_ellipse(np.array([*place, radius, *ellipticity, 1.0]), wide, (size[0], size[1]))
    blurred = cv2.GaussianBlur(fine, (0, 0), max(blur * OVERSAMPLING, 0.3))
    small = cv2.resize(blurred, None, fx=1 / OVERSAMPLING, fy=1 / OVERSAMPLING, interpolation=cv2.INTER_AREA)
    return image + np.asarray(small[margin : margin + size[0], margin : margin + size[1]], np.float32)


def _packed(image: NDArray) -> str:
    """Base64 of thousandths as int16, little-endian."""
    top = np.iinfo(np.int16).max
    scaled = np.clip(np.nan_to_num(np.asarray(image, float) * 1000), -top, top)
    return base64.b64encode(np.rint(scaled).astype("<i2").tobytes()).decode()
