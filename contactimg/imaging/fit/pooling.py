"""Contrast, blur and edge of a series of frames.

Contacts transmit a fraction of the light, so the ratio of their contrast to the background level is the same
in every frame, as is the blur, up to slow changes. Frames are weighted by their own variances plus the
variance between frames.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from contactimg.imaging.pixels.robust import MAD_TO_STD, SIGNIFICANT_SIGMA
from contactimg.imaging.profile.edge_shape import FAMILIES, LARGEST
from contactimg.imaging.profile.limits import FEWEST, ROUGH_STD
from contactimg.imaging.profile.optics import EdgeKnowledge, SharedOptics


def pool_optics(frames: Iterable[SharedOptics]) -> SharedOptics | None:
    """The contrast and blur that frames have in common.

    Parameters
    ----------
    frames : iterable of SharedOptics
        From each frame alone, contrasts relative to the background level.

    Returns
    -------
    SharedOptics or None
        For one more frame: the uncertainties include the scatter between frames. None if no frame determines
        its contrast to a tenth.

    Examples
    --------
    >>> frames = [SharedOptics(1.25, 0.01, 0.0, 1.40, 0.01), SharedOptics(1.27, 0.02, 0.0, 1.42, 0.02)]
    >>> pooled = pool_optics(frames)
    >>> round(pooled.contrast, 3), round(pooled.blur_px, 3)
    (1.254, 1.404)
    """
    kept = [frame for frame in frames if frame.contrast_relative_std < ROUGH_STD]
    if not kept:
        return None
    best = min(kept, key=lambda frame: frame.contrast_relative_std)
    contrasts, blurs, blur_stds = np.array([[x.contrast, x.blur_px, x.blur_std_px] for x in kept]).T
    relative_stds = np.array([frame.contrast_relative_std for frame in kept])
    log_contrast, contrast_std, contrast_shared = _mean(np.log(contrasts), relative_stds)
    blur, blur_std, blur_shared = _mean(blurs, blur_stds)
    level = float(np.exp(log_contrast))
    return SharedOptics(
        contrast=level,
        contrast_std=level * contrast_std,
        spread=level * best.spread / best.contrast,
        blur_px=blur,
        blur_std_px=blur_std,
        correlation=best.correlation * contrast_shared * blur_shared,
        halo=best.halo,
        relative=best.relative,
    )


def pool_edges(frames: Sequence[EdgeKnowledge]) -> EdgeKnowledge | None:
    """The edge from all frames that share it with the one that has most contacts.

    Parameters
    ----------
    frames : sequence of EdgeKnowledge
        From each frame alone.

    Returns
    -------
    EdgeKnowledge or None
        With variances that include the scatter between frames; None if no frame shows enough contacts.
    """
    donors = [frame for frame in frames if frame.count >= FEWEST]
    if not donors:
        return None
    best = max(donors, key=lambda frame: frame.count)
    # the widths of a point spread function go with the blur of their own frame
    donors = [best] if "point spread" in best.families else [x for x in donors if x.families == best.families]
    information = np.sum([frame.information for frame in donors], axis=0)
    vector = np.sum([frame.vector for frame in donors], axis=0)
    at = np.array([k for name in best.families for k in FAMILIES[name]], int)
    shape = np.zeros(len(vector))
    shape[at] = np.linalg.solve(information[np.ix_(at, at)], vector[at])
    shape = np.clip(shape, -LARGEST, LARGEST)
    scatter = 1.0
    if len(at) and len(donors) > 1:
        away = np.array([frame.shape - shape for frame in donors])
        squares = sum(x @ frame.information @ x for x, frame in zip(away, donors, strict=True))
        scatter = max(float(squares) / (len(at) * (len(donors) - 1)), 1.0)
    return EdgeKnowledge(
        best.families, best.blur_px, shape, information / scatter, vector / scatter,
        sum(frame.count for frame in donors),
    )  # fmt: skip


def _mean(values: NDArray[np.float64], stds: NDArray[np.float64]) -> tuple[float, float, float]:
    """Weighted mean of the values without outliers, with a variance between frames (Paule and Mandel).

    Returned with it are the standard deviation of one more value about it, and the part of that due to the
    mean. Outliers lie off the weighted median by more than a few standard deviations, their own and those of
    the scatter. The variance between frames is such that the weighted sum of squares equals its expectation
    (doi:10.6028/jres.087.022).
    """
    order = np.argsort(values)
    weight = np.cumsum(1.0 / stds[order] ** 2)
    away = np.abs(values - values[order][np.searchsorted(weight, 0.5 * weight[-1])])
    kept = away <= SIGNIFICANT_SIGMA * np.hypot(stds, MAD_TO_STD * np.median(away))
    values, stds = values[kept], stds[kept]

    def excess_chi_square(variance_between: float) -> float:
        variance = stds**2 + variance_between
        centre = np.average(values, weights=1 / variance)
        return float(np.sum((values - centre) ** 2 / variance)) - (len(values) - 1)

    largest = float(np.ptp(values)) ** 2
    bracketed = largest > 0 and excess_chi_square(0.0) > 0 > excess_chi_square(largest)
    between = brentq(excess_chi_square, 0.0, largest) if bracketed else 0.0
    weights = 1.0 / (stds**2 + between)
    statistical = 1.0 / float(weights.sum())
    total = statistical + between
    mean = float(np.average(values, weights=weights))
    return mean, float(np.sqrt(total)), float(np.sqrt(statistical / total))
