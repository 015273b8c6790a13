"""Measure the contacts of one frame: background, contrast, detection, disks, quality."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.imaging.counting import count_contacts
from contactimg.imaging.fitting import fit_contacts
from contactimg.imaging.light import block_means
from contactimg.imaging.noise import estimate_noise
from contactimg.imaging.pixels import Pixels
from contactimg.imaging.reference import (
    Difference,
    estimate_background,
    subtract_reference,
    unregistered,
)
from contactimg.imaging.rim import Rim
from contactimg.imaging.threshold import Contrast, choose_threshold, find_polarity, measure_contrast

__all__ = ["ImageMeasurement", "measure_image"]

DISKS = {"label": "int64", "x_px": "float64", "y_px": "float64", "radius_px": "float64",
         "radius_std_px": "float64", "flags": "int64"}  # fmt: skip
REJECTED = {"x_px": "float64", "y_px": "float64", "radius_px": "float64", "reason": "str"}

LIGHT_CHANGE = 1.5  # a background this many times brighter or darker than the reference's is suspicious


@dataclass(frozen=True, eq=False)
class ImageMeasurement:
    """What a frame shows.

    Parameters
    ----------
    disks : DataFrame
        One row an asserted contact: label, x_px, y_px, radius_px, radius_std_px, flags
        (`contactimg.tables.Flag`).
    rejected : DataFrame
        x_px, y_px, radius_px, reason of candidates that are no contact.
    contrast : float
        Plateau minus background, grey levels; negative for contacts darker than the background.
    noise : float
        Standard deviation of one pixel of the difference, grey levels.
    threshold : float
        Fraction of the contrast that was used; NaN where none applies.
    blur_px : float
        Standard deviation of the point spread function; NaN where none was determined.
    shift_x_px, shift_y_px : float
        Position in the frame minus position in the reference; NaN without reference.
    polarity : str
        "bright" or "dark", as measured.
    status : str
        "ok", or what is wrong with the frame.
    message : str
        One sentence for a person; empty if there is nothing to say.
    difference : ndarray of float32, shape (rows, columns)
        Registered, light-corrected frame minus background, for pictures.
    """

    disks: pd.DataFrame
    rejected: pd.DataFrame
    contrast: float
    noise: float
    threshold: float
    blur_px: float
    shift_x_px: float
    shift_y_px: float
    polarity: str
    status: str
    message: str
    difference: NDArray[np.float32]


def measure_image(
    image: NDArray,
    reference: NDArray | None = None,
    *,
    method: str = "disk",
    polarity: str = "auto",
    threshold: float | str | None = None,
    full_scale: float | None = None,
    blur_px: float | None = None,
    film: Rim | None = None,
) -> ImageMeasurement:
    """Measure the contacts of one frame.

    Parameters
    ----------
    image, reference : ndarray, shape (rows, columns)
        Grey levels, uint8, uint16 or float; non-finite pixels are holes. Without a reference the background
        is estimated from the image itself.
    method : {"disk", "threshold"}
        Fit of blurred disks, or the area of the pixels above the threshold.
    polarity : {"bright", "dark", "auto"}
        Whether contacts are brighter or darker than the background.
    threshold : float, "auto" or None
        Fraction of the contrast for ``"threshold"`` (None: 0.5).
    full_scale : float or None
        Grey level at which the sensor saturates; None: that of the pixel type.
    blur_px : float or None
        Standard deviation of the point spread function, px; None: found from the frame.
    film : Rim or None
        Bright rim that the air film draws around the contacts, for ``"disk"``:
        `contactimg.imaging.rim.FilmRim` or `contactimg.imaging.rim.PlainRim`; None: the edge is sharp.

    Returns
    -------
    ImageMeasurement

    Raises
    ------
    FrameError
        If the reference has another shape than the image.
    InputError
        If an option has a value that it cannot have.

    Examples
    --------
    >>> y, x = np.mgrid[0:64, 0:64]
    >>> image = (50 + 100 / (1 + np.exp(np.hypot(x - 30, y - 33) - 8))).astype(np.uint8)
    >>> found = measure_image(image, np.full((64, 64), 50, np.uint8)).disks
    >>> [float(found[name].iloc[0].round(0)) for name in ("x_px", "y_px", "radius_px")]
    [30.0, 33.0, 8.0]
    """
    _check(image, reference, method, polarity)
    pixels = Pixels.of(image, reference, full_scale)
    difference, sign = _subtract(pixels, polarity)
    pixels = pixels if difference.valid is None else pixels.within(difference.valid)
    signed = difference.image if sign > 0 else -difference.image
    noise = estimate_noise(signed, difference.light.background)
    contrast = Contrast(0.0, resolved=False) if pixels.trivial else measure_contrast(signed, noise)
    fraction = choose_threshold(signed, contrast, threshold)
    blur = float("nan")
    disks, rejected = pd.DataFrame(columns=list(DISKS)), pd.DataFrame(columns=list(REJECTED))
    if contrast.plateau > 0:
        if pixels.valid is not None:
            signed = np.where(pixels.valid > 0, signed, np.float32(0.0))
        if method == "threshold":
            disks, rejected = count_contacts(
                signed, fraction=fraction, contrast=contrast, noise=noise, saturated=pixels.saturated
            )
        else:
            disks, rejected, blur = fit_contacts(
                signed, pixels, difference, contrast=contrast, noise=noise, blur_px=blur_px, film=film
            )
    disks = disks.assign(label=np.arange(1, len(disks) + 1))
    status, message = _judge(pixels, difference, len(disks))
    return ImageMeasurement(
        disks=disks[list(DISKS)].astype(DISKS).reset_index(drop=True),
        rejected=rejected.astype(REJECTED).reset_index(drop=True),
        contrast=sign * contrast.plateau * pixels.unit,
        noise=noise * pixels.unit,
        threshold=fraction if method == "threshold" else float("nan"),
        blur_px=blur,
        shift_x_px=difference.shift.x_px if difference.shift else float("nan"),
        shift_y_px=difference.shift.y_px if difference.shift else float("nan"),
        polarity="bright" if sign > 0 else "dark",
        status=status,
        message=message,
        difference=difference.image if pixels.unit == 1.0 else difference.image * np.float32(pixels.unit),
    )


def _check(image: NDArray, reference: NDArray | None, method: str, polarity: str) -> None:
    """Refuse what cannot be measured."""
    if image.ndim != 2 or image.size == 0:
        raise FrameError(f"an image must have two dimensions and at least one pixel, got shape {image.shape}")
    if reference is not None and reference.shape != image.shape:
        raise FrameError(
            f"the reference must have the size of the frame, {image.shape[1]} x {image.shape[0]} pixels, "
            f"got {' x '.join(str(n) for n in reference.shape[::-1])}"
        )
    if method not in ("disk", "threshold"):
        raise InputError(f'method must be "disk" or "threshold", got {method!r}')
    if polarity not in ("bright", "dark", "auto"):
        raise InputError(f'polarity must be "bright", "dark" or "auto", got {polarity!r}')


def _subtract(pixels: Pixels, polarity: str) -> tuple[Difference, int]:
    """Difference image and the sign that makes contacts positive."""
    if pixels.trivial:
        plain = pixels.frame - (pixels.frame if pixels.reference is None else pixels.reference)
        return unregistered(plain), -1 if polarity == "dark" else 1
    if pixels.reference is not None:
        prefer = {"bright": "low", "dark": "high", "auto": "one"}[polarity]
        difference = subtract_reference(pixels.frame, pixels.reference, valid=pixels.valid, prefer=prefer)
    else:
        prefer = {"bright": "low", "dark": "high", "auto": "common"}[polarity]
        difference = estimate_background(pixels.frame, valid=pixels.valid, prefer=prefer)
    if polarity != "auto":
        return difference, 1 if polarity == "bright" else -1
    blocks = block_means(difference.image)
    scatter = 1.4826 * float(np.median(np.abs(blocks - np.median(blocks))))
    return difference, 1 if find_polarity(blocks, scatter) == "bright" else -1


def _judge(pixels: Pixels, difference: Difference, count: int) -> tuple[str, str]:
    """Status and message of the frame."""
    if pixels.defect:
        return pixels.defect, pixels.message
    ratio = float(difference.light.coefficients[0, 0])
    if difference.ratio and not 1 / LIGHT_CHANGE < ratio < LIGHT_CHANGE:
        who = "contacts fill" if count else "one contact fills"
        message = f"the background is {ratio:.2g} times the reference: the light changed or {who} the frame"
        return "light changed", message
    if not count:
        return "no contrast", "nothing stands out of the noise"
    if difference.unregistered:
        return "not registered", difference.remark
    return (
        "ok",
        difference.remark
        if pixels.reference is not None
        else "no reference: the background was estimated from the frame",
    )
