"""Contrast and blur of a series: what the frames that show them say together, and which frames need it.

Contacts transmit a fraction of the light, so their contrast over the background's level is the same in every
frame, as is the blur, up to slow changes. Frames are weighted by their own uncertainties and by how much more
they scatter than these explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from contactimg.imaging.profile.optics import SharedOptics

LINEAR = 0.1  # relative uncertainty of a contrast up to which its distribution is about normal
OUTLIER = 5.0  # standard deviations from which on a frame does not count


def pool_optics(frames: Sequence[SharedOptics]) -> SharedOptics | None:
    """The contrast and blur that frames have in common.

    Parameters
    ----------
    frames : sequence of SharedOptics
        What each frame alone shows, contrasts relative to the level of the background.

    Returns
    -------
    SharedOptics or None
        Its uncertainties hold for one more frame: they include how much frames differ. None if no frame knows
        its contrast to a tenth.

    Examples
    --------
    >>> frames = [SharedOptics(1.25, 0.01, 0.0, 1.40, 0.01), SharedOptics(1.27, 0.02, 0.0, 1.42, 0.02)]
    >>> pooled = pool_optics(frames)
    >>> round(pooled.contrast, 3), round(pooled.blur_px, 3)
    (1.254, 1.404)
    """
    known = [frame for frame in frames if frame.contrast_relative_std < LINEAR]
    if not known:
        return None
    contrast = _mean(
        np.log([frame.contrast for frame in known]),
        np.array([frame.contrast_relative_std for frame in known]),
    )
    blur = _mean(
        np.array([frame.blur_px for frame in known]), np.array([frame.blur_std_px for frame in known])
    )
    best = min(known, key=lambda frame: frame.contrast_relative_std)
    level = float(np.exp(contrast.value))
    return SharedOptics(
        contrast=level,
        contrast_std=level * contrast.std,
        spread=level * best.spread / best.contrast,
        blur_px=blur.value,
        blur_std_px=blur.std,
        correlation=best.correlation * contrast.shared * blur.shared,
        halo=best.halo,
    )


def gain_of_pooling(
    sums: NDArray[np.float64], own_part: float, own: SharedOptics, pooled: SharedOptics
) -> float:
    """How many times smaller the uncertainty of a sum over contacts gets with the pooled contrast and blur.

    Parameters
    ----------
    sums : ndarray, shape (2,)
        Change of the sum by one standard uncertainty of the contrast (the blur following), and by one of the
        rest of the blur, as the frame alone knows them.
    own_part : float
        Standard uncertainty of the sum from errors of its own of each contact.
    own, pooled : SharedOptics
        What the frame knows alone (a contrast relative to the background), and what all frames know.

    Returns
    -------
    float
        1 if the frame gains nothing.
    """
    covariance = _covariance(own)
    slope = np.linalg.solve(np.linalg.cholesky(covariance).T, sums)
    better = np.linalg.inv(np.linalg.inv(covariance) + np.linalg.inv(_covariance(pooled)))
    common = float(slope @ covariance @ slope), float(slope @ better @ slope)
    return float(np.sqrt((common[0] + own_part**2) / max(common[1] + own_part**2, 1e-300)))


def _covariance(optics: SharedOptics) -> NDArray[np.float64]:
    """Of (ln contrast, blur)."""
    std = np.array([optics.contrast_relative_std, optics.blur_std_px])
    return np.outer(std, std) * np.array([[1.0, optics.correlation], [optics.correlation, 1.0]])


@dataclass(frozen=True)
class _Mean:
    """Weighted mean, what one more value would scatter about it, and the part of that which is the mean's."""

    value: float
    std: float
    shared: float


def _mean(values: NDArray[np.float64], stds: NDArray[np.float64]) -> _Mean:
    """Mean of the usual values, which scatter by more than their uncertainties say (Paule and Mandel)."""
    kept = _usual(values, stds)
    values, stds = values[kept], stds[kept]

    def surplus(excess: float) -> float:
        variance = stds**2 + excess
        centre = np.average(values, weights=1 / variance)
        return float(np.sum((values - centre) ** 2 / variance)) - (len(values) - 1)

    largest = float(np.ptp(values)) ** 2
    excess = brentq(surplus, 0.0, largest) if largest > 0 and surplus(0.0) > 0 > surplus(largest) else 0.0
    weights = 1.0 / (stds**2 + excess)
    statistical = 1.0 / float(weights.sum())
    total = statistical + excess
    return _Mean(
        float(np.average(values, weights=weights)),
        float(np.sqrt(total)),
        float(np.sqrt(statistical / total)),
    )


def _usual(values: NDArray[np.float64], stds: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Values within a few standard deviations, their own and those of the scatter, of the weighted median."""
    order = np.argsort(values)
    weight = np.cumsum(1.0 / stds[order] ** 2)
    away = np.abs(values - values[order][np.searchsorted(weight, 0.5 * weight[-1])])
    return np.asarray(away <= OUTLIER * np.hypot(stds, 1.4826 * np.median(away)))
