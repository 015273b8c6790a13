"""What the radius of counted pixels is uncertain by: counting, noise, contrast, and the threshold itself.

The pixels above a threshold make the radius r at which the blurred contact crosses it, not the radius a of
the contact (`contactimg.imaging.profile.threshold_radius`). ``r - a`` has the same sign in all contacts: at
half height it is ``-s^2/(2 a)`` behind a blur s, elsewhere about the distance of a straight rim from the
threshold. Counting does not correct for it. Everything else moves r through the slope of the rim where it
crosses.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive, ndtr, ndtri

from contactimg.imaging.detect.candidates import ODD_RATIO
from contactimg.imaging.detect.inscribed_disks import SMALLEST_INSCRIBED
from contactimg.imaging.fit.contact_pixels import measure_rise
from contactimg.imaging.pixels.masks import nearest_pixels
from contactimg.imaging.pixels.robust import AGREEMENT_SIGMA, SOME, robust_std
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.limits import FEWEST, REACH_BLUR_WIDTHS, SHOWN_BLUR_WIDTHS
from contactimg.imaging.profile.optics import combine_errors
from contactimg.imaging.profile.threshold_radius import disk_radius

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Crossing:
    """The place where rims cross a threshold.

    Parameters
    ----------
    fraction : float
        Threshold as a fraction of the contrast.
    contrast, contrast_std : float
        Grey levels.
    blur_px : float
        Standard deviation of the blurred edge, pixel included.
    noise : float
        Of a pixel, grey levels.
    fraction_std : float
        Standard uncertainty of a fraction that was calibrated; 0 for one that was chosen.
    largest_ratio : float
        Of the contrast that the contacts may have to that assumed; 1 where they show it.
    """

    fraction: float
    contrast: float
    contrast_std: float
    blur_px: float
    noise: float
    fraction_std: float = 0.0
    largest_ratio: float = 1.0


def rim_errors(
    radius_px: Values, height: Values, crossing: Crossing, *, rim_height: float = 1.0
) -> dict[str, Values]:
    """Uncertainties of counted radii: columns of contacts.

    Parameters
    ----------
    radius_px : ndarray, shape (n,)
        ``sqrt(area/pi)`` of the counted pixels.
    height : ndarray, shape (n,)
        Their mean grey level above the background; NaN where it is not known.
    crossing : Crossing
    rim_height : float
        Of `height_at_rims`.

    Returns
    -------
    dict of arrays
        ``contrast_shift_px`` is the change if the contrast of the frame is one standard uncertainty higher;
        where contacts do not show it, the root mean square error for all contrasts that they may have.
        ``edge_shift_px`` is the radius at the threshold minus that of the contact behind the blur, less what
        noise takes of the pixels inside; of a calibrated threshold, which took both into account, the change
        if it is one standard uncertainty
        higher. ``radius_std_px`` contains both, and what each contact has alone: counting, noise, and a
        contrast of its own.

    Examples
    --------
    >>> half = Crossing(0.5, contrast=100.0, contrast_std=1.0, blur_px=1.4, noise=2.0)
    >>> errors = rim_errors(np.array([2.0, 10.0]), np.array([80.0, 95.0]), half)
    >>> errors["radius_std_px"].round(2), errors["edge_shift_px"].round(2)
    (array([0.49, 0.11]), array([-0.48, -0.1 ]))
    """
    f, contrast = crossing.fraction, crossing.contrast
    true = disk_radius(radius_px, blur_px=crossing.blur_px, fraction=f)
    s = crossing.blur_px
    straight = np.exp(-0.5 * ndtri(f) ** 2) / (np.sqrt(2.0 * np.pi) * s)
    slope = true / s**2 * np.exp(-0.5 * ((true - radius_px) / s) ** 2) * ive(1, true * radius_px / s**2)
    # Chosen: uncertainties stay finite where a contact hardly reaches the threshold.
    slope = contrast * np.maximum(slope, 0.1 * straight)
    # the relative scatter of the contrasts of wide contacts, from their mean heights
    wide, scatter = (radius_px > REACH_BLUR_WIDTHS * s) & np.isfinite(height), 0.0
    if np.count_nonzero(wide) >= FEWEST:
        full = 1.0 - 2.0 * s / radius_px[wide] * _missing(f)
        scatter = robust_std(height[wide] / (contrast * full))
    spread = f * contrast * scatter / slope
    counting = (PIXEL_VARIANCE + (crossing.noise / slope) ** 2) / (2.0 * np.pi * np.maximum(radius_px, 0.5))
    own = np.hypot(np.sqrt(counting), spread)
    calibrated = crossing.fraction_std > 0
    # noise takes this share of the pixels inside below the threshold, and joins none outside to them
    lost = ndtr(-(1.0 - f) * contrast / max(crossing.noise, 1e-9))
    edge = -crossing.fraction_std * contrast / slope if calibrated else radius_px - true * (1.0 + 0.5 * lost)
    # of disks with the same light, uniform between the radius at the contrast assumed and that at the largest
    # possible one, whose square is smaller by the ratio of the contrasts: the root mean square distance
    far, near = radius_px - true / np.sqrt(crossing.largest_ratio), radius_px - true
    unseen = np.sqrt(np.maximum(far**2 + far * near + near**2, 0.0) / 3.0) * (crossing.largest_ratio > 1.0)
    unseen = np.sqrt(np.maximum(unseen**2 - edge**2, 0.0))
    shift = -np.hypot(f * crossing.contrast_std / slope, unseen)
    if rim_height != 1.0:
        fractions = np.clip([f, f / rim_height], 0.01, 0.99)
        edge = np.sign(rim_height - 1.0) * np.hypot(edge, s * float(np.ptp(ndtri(fractions))))
    return {
        "radius_std_px": combine_errors(own, np.stack([shift, edge], axis=1)),
        "contrast_shift_px": shift,
        "blur_shift_px": np.zeros(len(shift)),
        "edge_shift_px": edge,
    }


def count_at_own(image: NDArray[np.float32], contacts: dict[str, NDArray], crossing: Crossing) -> Values:
    """Radii of contacts of another brightness at the same fraction of their own contrast; NaN for others.

    Their own contrast is that of their mean height. The pixels counted are those connected with the middle.
    """
    radius, f, s = contacts["radius_px"], crossing.fraction, crossing.blur_px
    own = contacts["height"] / np.maximum(1.0 - 2.0 * s / np.maximum(radius, s) * _missing(f), 0.1)
    out, ratio = np.full(len(radius), np.nan), own / crossing.contrast
    odd = (radius > SHOWN_BLUR_WIDTHS * s) & (np.maximum(ratio, 1.0 / np.maximum(ratio, 1e-9)) > ODD_RATIO)
    for k in np.flatnonzero(odd):
        x, y, reach = contacts["x_px"][k], contacts["y_px"][k], 2.0 * radius[k] + REACH_BLUR_WIDTHS * s
        box = tuple(slice(max(int(at - reach), 0), int(at + reach) + 1) for at in (y, x))
        above = cv2.blur(image[box], (3, 3)) > f * own[k]
        labels = cv2.connectedComponents(above.astype(np.uint8))[1]
        middle = labels[nearest_pixels(x - box[1].start, y - box[0].start, labels.shape)]
        out[k] = np.sqrt(np.count_nonzero(labels == middle) / np.pi) if middle else 0.0
    return out


def height_at_rims(image: NDArray[np.float32], contacts: dict[str, NDArray], crossing: Crossing) -> float:
    """Height that wide contacts have at their rims, over the contrast; 1 where they are uniform.

    The mean inside half of the radius and that in a ring inside the rim give a parabola, which is continued
    to the rim. Contacts brighter in the middle are counted at another fraction of the height of their rims.
    """
    radius, s = contacts["radius_px"], crossing.blur_px
    wide = np.flatnonzero((radius > REACH_BLUR_WIDTHS * s) & np.isfinite(contacts["height"]))
    if len(wide) < FEWEST:
        return 1.0
    wide = wide[:: max(len(wide) // SOME, 1)]
    falls = np.empty(len(wide))
    for k, row in enumerate(wide):
        a = float(radius[row])
        low, high = 0.5 * a, a - 2.5 * s  # ring that is read. Theory: 1 % of the edge is missing at its end
        step = (high - low) / 3.0
        inner = low - 3.0 * step
        place = np.array([[contacts["x_px"][row], contacts["y_px"][row], inner]])
        rise = float(measure_rise(image, place, step)[0])
        squares = (low**2 + high**2) / 2.0, (inner - 0.5 * step) ** 2 / 2.0
        falls[k] = rise * (a**2 - squares[0]) / (squares[0] - squares[1]) / crossing.contrast
    known = np.isfinite(falls)
    if np.count_nonzero(known) < FEWEST:
        return 1.0
    fall = float(np.median(falls[known]))
    chance = AGREEMENT_SIGMA * robust_std(falls[known]) / np.sqrt(np.count_nonzero(known))
    # By hand: a fall by 0.05 of the contrast moves half height by a twentieth of the blur.
    return float(np.clip(1.0 - fall, 0.6, 1.4)) if abs(fall) > 0.05 + chance else 1.0


def blur_of_heights(radius_px: Values, height: Values, fraction: float) -> float:
    """Blur that makes the counted pixels as dim as they are in the mean, pixel included, px.

    Parameters
    ----------
    radius_px : ndarray, shape (n,)
    height : ndarray, shape (n,)
        Mean of their pixels over the contrast; NaN where it is not known.
    fraction : float
        Threshold as a fraction of the contrast.

    Returns
    -------
    float
        Median over the contacts of two pixels and more; infinite if there are none.
    """
    known = (radius_px > SMALLEST_INSCRIBED) & np.isfinite(height)
    if not known.any():
        return float("inf")
    dim = 0.5 * radius_px[known] * (1.0 - height[known]) / _missing(fraction)
    return max(float(np.median(dim)), PIXEL_VARIANCE**0.5)


def _missing(fraction: float) -> float:
    """Height that is missing along a rim that ends at a fraction f: ``phi(z) - z Phi(-z)``, ``Phi(z) = f``.

    In the mean over a disk of radius r that is ``2 s/r`` of it.
    """
    z = float(ndtri(fraction))
    return float(np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi) - z * ndtr(-z))
