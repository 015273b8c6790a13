"""What the method "threshold" gets wrong on a frame: estimate the radii behind what was counted.

A threshold errs in three ways that the frame itself shows: the radius at which a blurred disk crosses the
threshold is not that of the disk (`contactimg.imaging.profile.threshold_radius`); contacts fainter than the
threshold are missed; contacts that touch are joined.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.count.method import count_at_fraction
from contactimg.imaging.detect.inscribed_disks import find_inscribed
from contactimg.imaging.detect.rim_blur import estimate_blur
from contactimg.imaging.evidence.rules import PLACE
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.threshold_radius import disk_radius

Values = NDArray[np.float64]

LOWER_THRESHOLD_RATIO = 0.4
"""Ratio of the lower threshold, at which missed contacts are looked for, to the one used. Chosen by hand;
sensitivity not measured."""
MISSED_MARGIN_PX = 1.0
"""A component at the lower threshold is a missed contact if no counted centre lies within its radius and this
margin."""


class RadiusPairs(NamedTuple):
    """Counted radii and estimates of the true ones, row by row, px.

    Parameters
    ----------
    counted : ndarray, shape (n,)
        0 for a contact that was missed, and for the parts of a joined one.
    true : ndarray, shape (n,)
        0 for a joined contact, whose parts have rows of their own.
    """

    counted: Values
    true: Values


def estimate_true_radii(
    image: NDArray[np.float32],
    disks: Values,
    *,
    fraction: float,
    plateau: float,
    noise: float,
    blur_px: float | None = None,
) -> RadiusPairs:
    """Estimate the radii of the contacts that a threshold counted, joined or missed.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive; non-finite pixels are holes.
    disks : ndarray, shape (n, 3)
        x, y, radius (px) as counted.
    fraction : float
        Threshold as a fraction of the contrast.
    plateau, noise : float
        Contrast and standard deviation of a background pixel, grey levels of the image.
    blur_px : float, optional
        Standard deviation of the point spread function; default: from the slopes of the rims.

    Returns
    -------
    RadiusPairs

    Notes
    -----
    Disks with sharp edges behind a Gaussian blur are assumed.

    Examples
    --------
    >>> y, x = np.mgrid[0:64, 0:64]
    >>> image = (100 / (1 + np.exp(1.7 * (np.hypot(x - 30, y - 33) - 10)))).astype(np.float32)
    >>> radii = estimate_true_radii(
    ...     image, np.array([[30.0, 33.0, 9.9]]), fraction=0.5, plateau=100.0, noise=0.5, blur_px=1.0
    ... )
    >>> radii.counted.round(2), radii.true.round(2)
    (array([9.9]), array([9.95]))
    """
    image = np.where(np.isfinite(image), image, np.float32(0.0))
    blur = estimate_blur(image, plateau) if blur_px is None else float(np.hypot(blur_px, PIXEL_VARIANCE**0.5))
    inscribed = find_inscribed(image, fraction * plateau, smoothing=0.0, valid=None)
    counted, crossing = _separate_joined(disks, inscribed)
    lower = LOWER_THRESHOLD_RATIO * fraction
    missed = _find_missed(image, disks, fraction=lower, plateau=plateau, noise=noise)
    true = disk_radius(crossing, blur_px=blur, fraction=fraction)
    missed = disk_radius(missed, blur_px=blur, fraction=lower)
    return RadiusPairs(np.concatenate([counted, np.zeros(missed.size)]), np.concatenate([true, missed]))


def _separate_joined(disks: Values, inscribed: Values) -> RadiusPairs:
    """Counted radii, and radii at the threshold with joined contacts separated.

    A counted disk that holds several inscribed disks is one row of the first and several of the second.
    """
    radius = disks[:, 2]
    if not len(inscribed):
        return RadiusPairs(radius, radius)
    distance = np.hypot(inscribed[:, None, 0] - disks[None, :, 0], inscribed[:, None, 1] - disks[None, :, 1])
    owner = np.argmin(distance - radius[None, :], axis=1)
    joined = np.bincount(owner, minlength=len(disks)) > 1
    # the parts keep the area that was counted for them together
    square = np.bincount(owner, inscribed[:, 2] ** 2, minlength=len(disks))
    scale = radius / np.sqrt(np.where(square > 0, square, 1.0))
    is_part = joined[owner]
    parts = inscribed[is_part, 2] * scale[owner[is_part]]
    return RadiusPairs(
        np.concatenate([radius[~joined], radius[joined], np.zeros(parts.size)]),
        np.concatenate([radius[~joined], np.zeros(np.count_nonzero(joined)), parts]),
    )


def _find_missed(
    image: NDArray[np.float32], disks: Values, *, fraction: float, plateau: float, noise: float
) -> Values:
    """Radii, at a lower threshold, of the contacts that do not reach the one used."""
    contacts = count_at_fraction(image, fraction=fraction, plateau=plateau, noise=noise)
    x, y, radius = (contacts[name] for name in PLACE)
    distance = np.hypot(x[:, None] - disks[None, :, 0], y[:, None] - disks[None, :, 1])
    return np.asarray(radius[(distance > radius[:, None] + MISSED_MARGIN_PX).all(axis=1)])
