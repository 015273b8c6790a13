"""Least squares on pairs of contacts and asperities: the last step of every search for the camera's pose.

A similarity of the plane is linear in complex numbers, ``z' = alpha z + beta`` (``conj(z)`` if mirrored).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.pose.pairs import pair_points
from contactimg.pose.pose import Pose

MIN_PAIRS = 3
"""Theory: two pairs determine a similarity; a third one tests it."""

OUTLIER_SIGMA = 5.0
"""Distance of a pair, in robust standard deviations, beyond which it is dropped. Chosen by hand; sensitivity
not measured."""

MIN_REACH_PX = 0.25
"""Lower limit of that distance: exact points have no scatter. Chosen by hand; sensitivity not measured."""

MAD_TO_STD = 1.4826
"""Theory: standard deviation over median absolute deviation of a normal distribution."""

MAX_ITERATIONS = 50
"""Rounds of pairing and fitting; the pairs usually settle after a few."""


@dataclass(frozen=True)
class PoseFit:
    """A pose and how well it explains the points.

    Attributes
    ----------
    pose : Pose
        The fitted pose, or the guess when nothing better is significant.
    fitted : bool
        False if the guess was kept.
    n_points, n_matched : int
        Points given, and points that fall on a target.
    residual : float
        RMS distance of the matched pairs, m (nan if none).
    chance : float
        Number of matches expected if the targets had nothing to do with the points.
    length_relative_std : float
        Relative standard uncertainty of a fitted pixel size; 0 for one that was given.
    """

    pose: Pose
    fitted: bool
    n_points: int
    n_matched: int
    residual: float
    chance: float = 0.0
    length_relative_std: float = 0.0


def refine(
    points: NDArray[np.complex128],
    spots: NDArray[np.complex128],
    guess: Pose,
    start: tuple[complex, complex, bool],
    gate: float,
) -> PoseFit:
    """Least squares on one-to-one pairs: pair and fit in turn until the pairs no longer change."""
    alpha, beta, mirrored = start
    turned, reach, pairs = oriented(points, mirrored), 2 * gate, None
    for _ in range(MAX_ITERATIONS):
        i, j, distance = pair_points(as_real(alpha * turned + beta), as_real(spots), max_distance=reach)
        now = (tuple(i), tuple(j))
        if now == pairs or len(i) < MIN_PAIRS:
            break
        pairs = now
        design = np.column_stack([turned[i], np.ones(len(i))])
        alpha, beta = np.linalg.lstsq(design, spots[j])[0]
        robust_std = MAD_TO_STD * float(np.median(distance))
        reach = min(gate, max(OUTLIER_SIGMA * robust_std, MIN_REACH_PX * guess.pixel_size))
    area = np.ptp(spots.real) * np.ptp(spots.imag)
    chance = len(points) * len(spots) * np.pi * gate**2 / area if area > 0 else float(len(points))
    return PoseFit(
        pose=replace(
            guess,
            pixel_size=float(abs(alpha)),
            centre=(float(beta.real), float(beta.imag)),
            rotation=float(np.angle(alpha) if mirrored else -np.angle(alpha)),
            mirrored=mirrored,
        ),
        fitted=True,
        n_points=len(points),
        n_matched=len(i),
        residual=float(np.sqrt(np.mean(distance**2))) if len(i) else np.nan,
        length_relative_std=_scale_std(turned[i], distance) / float(abs(alpha)),
        chance=float(chance),
    )


def _scale_std(points: NDArray[np.complex128], distance: NDArray[np.float64]) -> float:
    """Standard uncertainty of the modulus of alpha from the residual distances of the pairs."""
    n = len(points)
    if n < MIN_PAIRS:
        return 0.0
    variance = float(np.sum(distance**2)) / (2 * n - 4)
    return float(np.sqrt(variance / np.sum(np.abs(points - points.mean()) ** 2)))


def as_complex(points: NDArray) -> NDArray[np.complex128]:
    """(n, 2) real -> (n,) complex."""
    return points[:, 0] + 1j * points[:, 1]


def as_real(points: NDArray) -> NDArray[np.float64]:
    """(n,) complex -> (n, 2) real."""
    return np.column_stack([points.real, points.imag])


def oriented(points: NDArray[np.complex128], mirrored: bool) -> NDArray[np.complex128]:  # noqa: FBT001
    """Pixel points, conjugated if the image is mirrored."""
    return points.conj() if mirrored else points
