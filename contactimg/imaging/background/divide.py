"""Divide a frame by its reference without adding the reference's noise.

The reference shows the texture and dirt of the surface, which are wanted, and noise, which is not. Its
detail, the difference of a narrow and a wide Gaussian blur, is therefore multiplied by the gain that fits it
best to the frame, by least squares (a Wiener filter of one band). Where the detail is as large as that of
dirt, the reference is used unfiltered.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.alignment import Alignment
from contactimg.imaging.background.divide_rows import DIRT_SIGMA, NO_DIRT, REACH, divide_rows
from contactimg.imaging.background.illumination import Illumination
from contactimg.imaging.background.resample import filter_rows_and_columns, shift_kernel
from contactimg.imaging.pixels.blocks import block_means, is_background
from contactimg.imaging.pixels.robust import median, robust_std

# Constants without a stated origin were chosen by hand on rendered frames; their sensitivity is not measured.
DARKEST_FRACTION = 0.1
"""Of the median level of the reference: where it is darker, it is not divided by."""

NARROW_PX, WIDE_PX = (0.7, 1.2), 6.0
"""Standard deviations of the Gaussians: two narrow ones, of which the one that fits the frame better is used,
and the wide one. Chosen by hand. With 0.7 px alone the RMS of radii of 0.8-2.2 px was 0.041 px, with both
0.037 px, with a filter of four bands 0.038 px; 796 contacts (docs/imaging_ablation.md)."""

BINNED_PX = 4
"""Side of the blocks whose means get the wide blur. Chosen for speed."""

BINNING_VARIANCE = 1.0 / 12.0 + 1.0 / 6.0
"""Variance (blocks squared) that binning and linear interpolation add to a Gaussian.

Theory: the variances of a box and of a triangle."""

BLUR_PX = 1.0  # the gain suits an image blurred by this: finer detail is lost in the blur of the contacts
STRIP_ROWS = 16  # height of the strips that the gain is measured in, without their margins
MARGIN_PX = 2 * REACH  # rows and columns around a strip that its two filters need
STRIP_PLACES = (0.125, 0.375, 0.625, 0.875)  # of the strips, as a fraction of the height of the image
SAMPLE_SPACING_PX = 4  # pixels that far apart are independent behind `BLUR_PX`
FEWEST_SAMPLES = 60  # pixels: of fewer, no gain is measured and it is 1
GAIN_LIMITS = (0.0, 1.5)  # theory: signal/(signal + noise) is between 0 and 1; above, room for its error
OUTLIER_SIGMA = 6.0  # pixels of the frame that differ by more from the reference are not used for the gain


def divide_by_reference(
    frame: NDArray,
    reference: NDArray,
    half: NDArray[np.float32],
    illumination: Illumination,
    *,
    residual: Alignment,
    level: float,
) -> NDArray[np.float32]:
    """``level (F/(g R) - 1)`` of the frame F, the ratio g of the illuminations, and the filtered reference R.

    Parameters
    ----------
    frame, reference : ndarray, shape (rows, columns)
        Grey levels of any type.
    half : ndarray, shape (rows / 2, columns / 2)
        Means of the reference over 2 x 2 pixels, see `contactimg.imaging.pixels.blocks.block_means`; NaN in
        holes.
    illumination : Illumination
        Ratio frame/reference of the background.
    residual : Alignment
        Shift of the frame against the reference, less than a pixel.
    level : float
        Grey level of the background of the reference.
    """
    reference, wide = np.ascontiguousarray(reference), _blur_widely(half, residual)
    shifts = (residual.x_px, residual.y_px)
    filters = [np.stack([shifted_gaussian(shift, width) for shift in shifts]) for width in NARROW_PX]
    sharp = np.stack([shift_kernel(shift) for shift in shifts]).astype(np.float32)
    fits = _fit_detail(frame, reference, filters, wide, illumination)
    (_, gain, scatter), narrow = min(zip(fits, filters, strict=True), key=lambda pair: pair[0][0])
    numbers = np.array([gain, 1.0 / scatter, level, DARKEST_FRACTION * level], np.float32)
    out = np.empty(frame.shape, np.float32)
    polynomials = illumination.row_polynomials(frame.shape)
    divide_rows(out, np.ascontiguousarray(frame), reference, wide, *polynomials, narrow, sharp, numbers)
    return out


def shifted_gaussian(shift: float, width: float) -> NDArray[np.float32]:
    """Filter that moves by ``shift`` px and blurs by a standard deviation of ``width`` px, up to 2 px.

    Examples
    --------
    >>> offsets, taps = np.arange(-4, 5), shifted_gaussian(-0.25, 1.0)
    >>> float(np.round(taps @ offsets, 2))
    0.25
    """
    kernel = np.exp(-((np.arange(-REACH, REACH + 1) + shift) ** 2) / (2 * width**2))
    return np.asarray(kernel / kernel.sum(), np.float32)


def _blur_widely(half: NDArray[np.float32], residual: Alignment) -> NDArray[np.float32]:
    """The reference moved and blurred by `WIDE_PX`, without NaN; its shape is rounded up to whole blocks."""
    finite = np.isfinite(half)
    binned = block_means(half, None if finite.all() else finite.astype(np.uint8), side=BINNED_PX // 2)
    width = float(np.sqrt((WIDE_PX / BINNED_PX) ** 2 - BINNING_VARIANCE))
    filters = [shifted_gaussian(shift / BINNED_PX, width) for shift in (residual.x_px, residual.y_px)]
    finite = np.isfinite(binned)
    smooth = filter_rows_and_columns(np.where(finite, binned, np.float32(0.0)), *filters)
    if not finite.all():
        smooth /= np.maximum(filter_rows_and_columns(finite, *filters), np.float32(1e-3))
    size = (BINNED_PX * binned.shape[1], BINNED_PX * binned.shape[0])
    return np.asarray(cv2.resize(smooth, size), np.float32)


def _fit_detail(
    frame: NDArray,
    reference: NDArray,
    filters: list[NDArray[np.float32]],
    wide: NDArray[np.float32],
    illumination: Illumination,
) -> list[tuple[float, float, float]]:
    """Misfit, gain and robust scatter of the detail of each filter, from the background in strips of rows.

    The gain is measured behind a blur of `BLUR_PX` as in the image of a contact.
    """
    shape, blur = (frame.shape[0], frame.shape[1]), [shifted_gaussian(0.0, BLUR_PX)] * 2
    rows = min(STRIP_ROWS + 2 * MARGIN_PX, shape[0])
    inside, x = slice(MARGIN_PX, -MARGIN_PX, SAMPLE_SPACING_PX), np.arange(shape[1])
    samples = []
    for top in sorted({int((shape[0] - rows) * place) for place in STRIP_PLACES}):
        strip, y = slice(top, top + rows), np.arange(top, top + rows)
        coarse = wide[strip, : shape[1]]
        details = [filter_rows_and_columns(reference[strip], *narrow) - coarse for narrow in filters]
        target = frame[strip] / illumination.ratio_at_rows(y, shape) - coarse
        images = [*details, *(filter_rows_and_columns(image, *blur) for image in (*details, target))]
        mask = is_background(illumination.background, y[inside], x[inside], shape)
        samples.append([image[inside, inside][mask] for image in images])
    *pairs, target = np.concatenate(samples, axis=1)
    if len(target) < FEWEST_SAMPLES:
        return [(0.0, 1.0, NO_DIRT)] * len(filters)
    details, blurred = pairs[: len(filters)], pairs[len(filters) :]
    return [_fit_gain(*pair, target) for pair in zip(details, blurred, strict=True)]


def _fit_gain(
    detail: NDArray[np.float32], blurred: NDArray[np.float32], target: NDArray[np.float32]
) -> tuple[float, float, float]:
    """Mean squared misfit of the blurred detail to the target, its gain, and its scatter, all without dirt.

    Examples
    --------
    >>> detail = np.array([-1.0, -2.0, 0.0, 2.0, 50.0])
    >>> _fit_gain(detail, detail, 0.5 * detail)
    (0.0, 0.5, 2.9652)
    """
    target = target - median(target)
    scatter = robust_std(detail, centre=0.0)
    usable = np.abs(target) < OUTLIER_SIGMA * robust_std(target, centre=0.0)
    usable &= np.abs(detail) < DIRT_SIGMA * scatter
    blurred, target = blurred[usable], target[usable]
    power = float(blurred @ blurred)
    if not power > 1e-12 * len(target):
        return 0.0, 1.0, NO_DIRT
    gain = float(np.clip(blurred @ target / power, *GAIN_LIMITS))
    return float(np.mean((target - gain * blurred) ** 2)), gain, scatter
