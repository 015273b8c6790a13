"""Measure the contacts of one frame: background, contrast, detection, disks, quality."""

from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.imaging.detect import estimate_blur
from contactimg.imaging.disks import CONTRAST, RADIUS, X, Y, DiskFit, Noise, Prior, fit_disks
from contactimg.imaging.edge import PIXEL_VARIANCE
from contactimg.imaging.light import BLOCK, background_mode, block_means
from contactimg.imaging.reference import Difference, estimate_background, subtract_reference
from contactimg.imaging.segment import label_components
from contactimg.imaging.separate import assemble_disks
from contactimg.imaging.threshold import (
    Contrast,
    choose_threshold,
    estimate_noise,
    find_polarity,
    measure_contrast,
)
from contactimg.tables import Flag

__all__ = ["ImageMeasurement", "measure_image"]

DISKS = {"label": "int64", "x_px": "float64", "y_px": "float64", "radius_px": "float64",
         "radius_std_px": "float64", "flags": "int64"}  # fmt: skip
REJECTED = {"x_px": "float64", "y_px": "float64", "radius_px": "float64", "reason": "str"}

NO_PIXELS = np.zeros((1, 1), np.uint8)
"""Marks for functions that take a mask: nothing is masked."""

WIDEST_BLUR = 3.2  # px: wider blurs are measured on binned pixels
COMPONENT_SIGMA = 8.0  # significance that a component of pixels must have
POOR_CHI_SQUARE = 1.5


@dataclass(frozen=True, eq=False)
class ImageMeasurement:
    """What a frame shows.

    Parameters
    ----------
    disks : DataFrame
        One row an asserted contact: label, x_px, y_px, radius_px, radius_std_px, flags (`contactimg.tables.Flag`).
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
    film: object | None = None,
) -> ImageMeasurement:
    """Measure the contacts of one frame.

    Parameters
    ----------
    image, reference : ndarray, shape (rows, columns)
        Grey levels, uint8, uint16 or float; non-finite pixels are holes. Without a reference the background is
        estimated from the image itself.
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
    film : object or None
        Description of the air film about the contacts.

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
    pixels = _Pixels.of(image, reference, full_scale)
    difference, sign = _subtract(pixels, polarity)
    signed = difference.image if sign > 0 else -difference.image
    noise = estimate_noise(signed, difference.light.background, BLOCK)
    contrast = measure_contrast(signed, noise)
    fraction = choose_threshold(signed, contrast, threshold)
    blur = float("nan")
    disks, rejected = _empty(DISKS), _empty(REJECTED)
    if contrast.plateau > 0 and not pixels.trivial:
        if method == "threshold":
            disks, rejected = _count_pixels(signed, pixels, contrast, noise, fraction)
        else:
            disks, rejected, blur = _fit(signed, pixels, difference, contrast, noise, blur_px)
    shift = difference.shift
    status, message = _judge(pixels, disks)
    return ImageMeasurement(
        disks=disks,
        rejected=rejected,
        contrast=sign * contrast.plateau,
        noise=noise,
        threshold=fraction if method == "threshold" else float("nan"),
        blur_px=blur,
        shift_x_px=shift.x_px if shift else float("nan"),
        shift_y_px=shift.y_px if shift else float("nan"),
        polarity="bright" if sign > 0 else "dark",
        status=status,
        message=message,
        difference=difference.image,
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


@dataclass(frozen=True, eq=False)
class _Pixels:
    """A frame and its reference as floats without holes, and what was found wrong with them."""

    frame: NDArray[np.float32]
    reference: NDArray[np.float32] | None
    valid: NDArray[np.uint8] | None
    saturated: NDArray[np.uint8]
    defect: str

    @property
    def trivial(self) -> bool:
        """No information on contacts in it."""
        return self.defect in ("black", "white", "identical to reference", "constant", "all holes")

    @classmethod
    def of(cls, image: NDArray, reference: NDArray | None, full_scale: float | None) -> "_Pixels":
        scale = _full_scale(image, full_scale)
        valid = None
        arrays = [image] if reference is None else [image, reference]
        if any(array.dtype.kind == "f" for array in arrays):
            good = np.logical_and.reduce([np.isfinite(array) for array in arrays])
            if not good.all():
                valid = good.astype(np.uint8)
        floats = [_filled(array, valid) for array in arrays]
        saturated = NO_PIXELS
        if np.isfinite(scale) and (image.max() >= scale if valid is None else floats[0].max() >= scale):
            saturated = (floats[0] >= scale).astype(np.uint8)
        return cls(
            floats[0],
            floats[1] if reference is not None else None,
            valid,
            saturated,
            _defect(floats, valid, scale),
        )


def _full_scale(image: NDArray, full_scale: float | None) -> float:
    """Saturation level: as given, or that of the integer type; infinite for floats."""
    if full_scale is not None:
        return float(full_scale)
    return float(np.iinfo(image.dtype).max) if image.dtype.kind == "u" else float("inf")


def _filled(array: NDArray, valid: NDArray | None) -> NDArray[np.float32]:
    """As float32, holes filled with the median of the rest."""
    if valid is None:
        return array.astype(np.float32)
    good = valid > 0
    fill = float(np.median(array[good])) if good.any() else 0.0
    return np.where(good, np.nan_to_num(array, nan=fill, posinf=fill, neginf=fill), fill).astype(np.float32)


def _defect(floats: list[NDArray], valid: NDArray | None, scale: float) -> str:
    """What is wrong with a frame as a whole; empty if nothing."""
    frame = floats[0]
    if valid is not None and not valid.any():
        return "all holes"
    low, high = float(frame.min()), float(frame.max())
    if low == high:
        return "black" if high <= 0 else ("white" if high >= scale else "constant")
    if len(floats) == 2 and np.array_equal(floats[0], floats[1]):
        return "identical to reference"
    return "holes" if valid is not None else ""


def _subtract(pixels: _Pixels, polarity: str) -> tuple[Difference, int]:
    """Difference image and the sign that makes contacts positive."""
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


def _count_pixels(
    signed: NDArray, pixels: _Pixels, contrast: Contrast, noise: float, fraction: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Connected components above the threshold, radius from their area."""
    if pixels.valid is not None:
        signed = np.where(pixels.valid > 0, signed, 0.0).astype(np.float32)
    found = label_components(signed, fraction * contrast.plateau, marks=pixels.saturated)
    significance = found["flux"] / np.sqrt(found["area"]) / max(noise, 1e-6)
    real = significance > COMPONENT_SIGMA
    radius = np.sqrt(found["area"] / np.pi)
    rejected = pd.DataFrame(
        {"x_px": found["x"][~real], "y_px": found["y"][~real], "radius_px": radius[~real], "reason": "noise"}
    ).astype(REJECTED)
    kept = found[real]
    rows, columns = signed.shape
    edge = (
        (kept["left"] == 0)
        | (kept["top"] == 0)
        | (kept["right"] == columns - 1)
        | (kept["bottom"] == rows - 1)
    )
    flags = (
        np.where(edge, int(Flag.EDGE), 0)
        | np.where(kept["marked"] > 0, int(Flag.SATURATED), 0)
        | np.where(kept["area"] < 4, int(Flag.TOO_SMALL), 0)
    )
    # counting pixels on a grid: the area scatters as the square root of the rim's pixels over twelve; on top, the noise
    rim = 2 * np.pi * radius[real]
    slope = contrast.plateau / 3.0
    std = np.sqrt(rim * (PIXEL_VARIANCE + (noise / slope) ** 2)) / rim
    disks = pd.DataFrame(
        {
            "label": np.arange(1, len(kept) + 1),
            "x_px": kept["x"],
            "y_px": kept["y"],
            "radius_px": radius[real],
            "radius_std_px": std,
            "flags": flags,
        }
    ).astype(DISKS)
    return disks, rejected


def _fit(
    signed: NDArray,
    pixels: _Pixels,
    difference: Difference,
    contrast: Contrast,
    noise: float,
    blur_px: float | None,
) -> tuple[pd.DataFrame, pd.DataFrame, float]:
    """Blurred-disk fit, on binned pixels where the blur is wide."""
    blur = (
        estimate_blur(signed, contrast.plateau) if blur_px is None else np.hypot(blur_px, PIXEL_VARIANCE**0.5)
    )
    bin_ = int(blur / (WIDEST_BLUR / 2)) if blur > WIDEST_BLUR else 1
    weight = NO_PIXELS if pixels.valid is None else pixels.valid
    background = np.repeat(np.repeat(difference.light.background, BLOCK, 0), BLOCK, 1)
    background = background[: signed.shape[0], : signed.shape[1]].astype(np.uint8)
    image = signed
    if bin_ > 1:
        size = (max(signed.shape[1] // bin_, 1), max(signed.shape[0] // bin_, 1))
        crop = (slice(0, size[1] * bin_), slice(0, size[0] * bin_))
        image = cv2.resize(signed[crop], size, interpolation=cv2.INTER_AREA)
        background = cv2.resize(background[crop], size, interpolation=cv2.INTER_NEAREST)
        if weight.shape == signed.shape:
            weight = cv2.resize(weight[crop], size, interpolation=cv2.INTER_NEAREST)
        sample = image[background > 0]
        if len(sample) > 100:
            noise = 1.4826 * float(np.median(np.abs(sample - np.median(sample))))
        blur = blur / bin_
    model = Noise(max(noise, 0.05) ** 2, 1.0)
    assembly = assemble_disks(
        image, weight, background, plateau=contrast.plateau, noise=model, blur=blur, free_blur=blur_px is None
    )
    fit = _refit(image, weight, assembly.fit, model, blur_px is None)
    return _tabulate(fit, assembly.dropped, image.shape, bin_, pixels, contrast)


def _refit(image: NDArray, weight: NDArray, start: DiskFit, noise: Noise, free_blur: bool) -> DiskFit:
    """Final fit with the frame's own contrast and spread of contrasts."""
    disks = start.disks
    n = len(disks)
    if not n:
        return start
    large = (disks[:, RADIUS] > 3 * start.blur) & (start.chi_square < 4)
    mean, spread = np.median(disks[:, CONTRAST]), 0.1 * np.median(disks[:, CONTRAST])
    if large.sum() >= 3:
        values, stds = disks[large, CONTRAST], start.std[large, CONTRAST]
        mean = float(np.average(values, weights=1 / stds**2))
        inner = (
            np.abs(values - np.median(values))
            < 5 * 1.4826 * np.median(np.abs(values - np.median(values))) + 1e-9
        )
        excess = np.var(values[inner]) - np.mean(stds[inner] ** 2)
        spread = float(np.sqrt(max(excess, 0.0) + (1e-3 * mean) ** 2))
    prior = Prior(np.full(n, mean), np.full(n, spread))
    return fit_disks(
        image,
        weight,
        disks,
        blur=start.blur,
        noise=noise,
        prior=prior,
        brightness=np.ones(n),
        free_blur=free_blur,
    )


def _tabulate(
    fit: DiskFit, dropped: NDArray, shape: tuple[int, int], bin_: int, pixels: _Pixels, contrast: Contrast
) -> tuple[pd.DataFrame, pd.DataFrame, float]:
    """Table of the disks in pixels of the frame, with flags."""
    disks = fit.disks
    rows, columns = shape
    reach = disks[:, RADIUS] + 2 * fit.blur
    edge = (
        (disks[:, X] < reach) | (disks[:, X] > columns - 1 - reach)
        | (disks[:, Y] < reach) | (disks[:, Y] > rows - 1 - reach)
    )  # fmt: skip
    inside = (
        (disks[:, X] > -0.5)
        & (disks[:, X] < columns - 0.5)
        & (disks[:, Y] > -0.5)
        & (disks[:, Y] < rows - 0.5)
    )
    light = disks[:, RADIUS] / (2 * fit.std[:, RADIUS])
    real = np.isfinite(disks).all(axis=1) & np.isfinite(fit.std[:, RADIUS]) & (light > 3) & (inside | edge)
    flags = (
        np.where(edge, int(Flag.EDGE), 0)
        | np.where(disks[:, RADIUS] < fit.blur, int(Flag.TOO_SMALL), 0)
        | np.where(fit.chi_square > POOR_CHI_SQUARE, int(Flag.POOR_FIT), 0)
        | np.where(light < 10, int(Flag.LOW_SIGNAL), 0)
    )
    order = np.lexsort((disks[real, X], disks[real, Y]))
    scale, offset = bin_, (bin_ - 1) / 2
    table = pd.DataFrame(
        {
            "label": np.arange(1, int(real.sum()) + 1),
            "x_px": disks[real, X][order] * scale + offset,
            "y_px": disks[real, Y][order] * scale + offset,
            "radius_px": disks[real, RADIUS][order] * scale,
            "radius_std_px": fit.std[real, RADIUS][order] * scale,
            "flags": flags[real][order],
        }
    ).astype(DISKS)
    rejected = pd.DataFrame(
        {
            "x_px": dropped[:, 0] * scale + offset,
            "y_px": dropped[:, 1] * scale + offset,
            "radius_px": dropped[:, 2] * scale,
            "reason": "not needed to explain the pixels",
        }
    ).astype(REJECTED)
    blur = float(np.sqrt(max(fit.blur**2 - PIXEL_VARIANCE, 0.0))) * scale
    return table, rejected, blur


def _judge(pixels: _Pixels, disks: pd.DataFrame) -> tuple[str, str]:
    """Status and message of the frame."""
    messages = {
        "black": "the frame is black: no light reached the sensor",
        "white": "the frame is white: every pixel is at full scale",
        "constant": "every pixel of the frame has the same value",
        "identical to reference": "the frame is identical to its reference: no contact can show",
        "all holes": "the frame has no finite pixel",
        "holes": "pixels without a finite value were left out",
    }
    if pixels.defect:
        return pixels.defect, messages[pixels.defect]
    if not len(disks):
        return "no contrast", "nothing stands out of the noise"
    return (
        "ok",
        "" if pixels.reference is not None else "no reference: the background was estimated from the frame",
    )


def _empty(columns: dict[str, str]) -> pd.DataFrame:
    return pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in columns.items()})
