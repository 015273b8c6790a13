"""The paper's measurement: pixels above a threshold, their area as the radius of a contact."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.plateau import Contrast
from contactimg.imaging.count.split_touching import split_components
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.optics import SharedOptics, combine_errors
from contactimg.imaging.reject.detections import PLACE, Columns, Detections
from contactimg.imaging.reject.dirt import absent_in_frame
from contactimg.imaging.reject.foreground import Foreground
from contactimg.tables import Flag, Reason
from contactimg.timings import stage

SIGNIFICANT = 8.0  # standard deviations of the summed light of a component; noise alone stays below 6
HOT = 0.2  # a lone pixel whose neighbours reach less of its height is a hot pixel: no optics is that sharp
TYPICAL_BLUR = 1.4  # px, for the slope of the rim in the uncertainty
SMALLEST = 4  # pixels
SPECK, AROUND = 12, 3  # pixels of what may be noise on a soft slope, and how far off the slope shows
QUIET = 12.0  # contrast/noise below which noise notches the components
CUT = 1.3  # radii from the centre of what is counted: a hole that close cuts the contact


def measure_by_count(foreground: Foreground, difference: DifferenceImage, *, fraction: float) -> Detections:
    """The paper's measurement, with what an error of the contrast does to it."""
    contrast, frame_pair = foreground.contrast, foreground.frame_pair
    contacts, rejected = count_contacts(
        foreground.image,
        fraction=fraction,
        contrast=contrast,
        noise=foreground.noise,
        saturated=frame_pair.saturated,
    )
    cut = frame_pair.near_hole(contacts["x_px"], contacts["y_px"], CUT * contacts["radius_px"] + 1.5)
    contacts["flags"] = contacts["flags"] | np.where(cut, int(Flag.EDGE), 0)
    places = np.column_stack([contacts[name] for name in PLACE])
    dust = absent_in_frame(frame_pair.frame, foreground.image, difference, places)
    gone = np.full(np.count_nonzero(dust), Reason.REFERENCE_DUST)
    rejected = {
        "reason": np.append(rejected["reason"], gone),
        **{name: np.append(rejected[name], contacts[name][dust]) for name in PLACE},
    }
    contacts = {name: values[~dust] for name, values in contacts.items()}
    # the threshold is a fraction of the contrast: where it cuts the rim of a wide contact moves with it
    slope = np.exp(-0.5 * ndtri(fraction) ** 2) / (np.sqrt(2 * np.pi) * TYPICAL_BLUR)
    shift = np.full(len(contacts["x_px"]), -fraction * contrast.std / contrast.plateau / slope)
    contacts["radius_std_px"] = combine_errors(contacts["radius_std_px"], shift[:, None])
    contacts |= {"contrast_shift_px": shift, "blur_shift_px": np.zeros(len(shift))}
    optics = SharedOptics(contrast.plateau, contrast.std, blur_std_px=np.nan)
    # the middle of a blurred disk reaches 1 - exp(-a^2/(2 s^2)) of the contrast
    smallest = TYPICAL_BLUR * np.sqrt(-2.0 * np.log1p(-fraction))
    measured = foreground.measured_contrast
    own = SharedOptics(max(measured.plateau, 1e-9), measured.std, blur_std_px=np.nan)
    return Detections(contacts, rejected, optics, own, float(smallest))


@stage("counting")
def count_contacts(
    image: NDArray[np.float32],
    *,
    fraction: float,
    contrast: Contrast,
    noise: float,
    saturated: Mask = None,
) -> tuple[Columns, Columns]:
    """Connected components above ``fraction`` of the contrast, ``radius = sqrt(area/pi)``.

    Components that are several contacts share their pixels among them.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive, holes 0.
    fraction : float
        Threshold as a fraction of the contrast.
    contrast : Contrast
    noise : float
        Standard deviation of a pixel.
    saturated : Mask
        Pixels at full scale.

    Returns
    -------
    contacts, rejected : dict of arrays
        Columns x_px, y_px, radius_px, radius_std_px, flags; and x_px, y_px, radius_px, reason.

    Notes
    -----
    The uncertainty is that of counting (each pixel of the rim is in or out, variance 1/12 px^2 of its
    position) and of the noise on the slope of a rim blurred by 1.4 px; not the bias of the threshold.
    """
    level = fraction * contrast.plateau
    noisy = contrast.plateau < QUIET * noise
    found, split = split_components(image, level, marks=saturated, smoothing=TYPICAL_BLUR if noisy else 0.0)
    hot = (found["area"] <= 2) & (_surroundings(image, found) < HOT * found["peak"])
    light = found["flux"] - found["area"] * np.maximum(_slope_under(image, found), 0.0)
    weak = light < SIGNIFICANT * noise * np.sqrt(found["area"])
    radius = np.sqrt(found["area"] / np.pi)
    bad = hot | weak
    rejected = {
        "x_px": found["x"][bad],
        "y_px": found["y"][bad],
        "radius_px": radius[bad],
        "reason": np.where(hot[bad], Reason.HOT_PIXEL, Reason.NOISE),
    }
    kept, split, radius = found[~bad], split[~bad], radius[~bad]
    rows, columns = image.shape
    edge = (
        (kept["left"] == 0)
        | (kept["top"] == 0)
        | (kept["right"] == columns - 1)
        | (kept["bottom"] == rows - 1)
    )
    flags = (
        np.where(edge, int(Flag.EDGE), 0)
        | np.where(kept["marked"] > 0, int(Flag.SATURATED), 0)
        | np.where(kept["area"] < SMALLEST, int(Flag.TOO_SMALL), 0)
        | np.where(split, int(Flag.MERGED), 0)
    )
    slope = contrast.plateau / (np.sqrt(2 * np.pi) * TYPICAL_BLUR)
    std = np.sqrt((PIXEL_VARIANCE + (noise / slope) ** 2) / (2 * np.pi * radius))
    contacts = {
        "x_px": kept["x"],
        "y_px": kept["y"],
        "radius_px": radius,
        "radius_std_px": std,
        "flags": flags,
    }
    return contacts, rejected


def _surroundings(image: NDArray[np.float32], found: NDArray[np.void]) -> NDArray[np.float64]:
    """Mean of the four neighbours of each component's highest pixel (the border repeats)."""
    rows, columns = image.shape
    x, y = found["peak_x"], found["peak_y"]
    return 0.25 * (
        image[y, np.maximum(x - 1, 0)]
        + image[y, np.minimum(x + 1, columns - 1)]
        + image[np.maximum(y - 1, 0), x]
        + image[np.minimum(y + 1, rows - 1), x]
    ).astype(float)


def _slope_under(image: NDArray[np.float32], found: NDArray[np.void]) -> NDArray[np.float64]:
    """Median of eight points about each speck: about its own level on a slope, 0 beside a single contact."""
    out = np.zeros(len(found))
    specks = np.flatnonzero(found["area"] <= SPECK)
    part, (rows, columns) = found[specks], image.shape
    x = np.stack([part["left"] - AROUND, part["peak_x"], part["right"] + AROUND])
    y = np.stack([part["top"] - AROUND, part["peak_y"], part["bottom"] + AROUND])
    grid = image[np.clip(y, 0, rows - 1)[:, None], np.clip(x, 0, columns - 1)[None]].reshape(9, -1)
    out[specks] = np.median(np.delete(grid, 4, axis=0), axis=0)
    return out
