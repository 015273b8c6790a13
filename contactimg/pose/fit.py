"""Find the pose of the camera that makes measured contacts coincide with the asperities they belong to.

A similarity of the plane is linear in complex numbers, ``z' = alpha z + beta`` (``conj(z)`` if mirrored).
Once the pairs are known, the pose follows from linear least squares; finding the pairs is the hard part and
comes first.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from contactimg.pose.pairs import pair_points, pairing_distance
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


COMPLETE_FRACTION = 0.9
"""The search ends with a pose that explains this fraction of the points. Chosen by hand; sensitivity not
measured."""

SIGNIFICANT_FRACTION = 0.5
"""A pose must explain this fraction of the points to replace the guess. Chosen by hand; sensitivity not
measured."""

CHANCE_SIGMA = 5.0
"""False-alarm rate: a pose must exceed the matches expected by chance by this many Poisson standard
deviations."""

POINTS_PER_VOTE = 3
"""One point in this many must agree on a shift. Chosen by hand; sensitivity not measured."""


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


@dataclass(frozen=True)
class PoseSearch:
    """Largest differences between the true pose and the guess.

    Parameters
    ----------
    shift : float
        Largest error of the position of the image centre, m.
    rotation : float
        Largest error of the rotation, rad.
    scale : float
        Largest relative error of the pixel size.
    mirror : bool
        Whether the mirrored pose is tried when the guessed one explains too few points.
    """

    shift: float
    rotation: float = np.deg2rad(3.0)
    scale: float = 0.03
    mirror: bool = True


def fit_pose(
    x_px: ArrayLike, y_px: ArrayLike, targets: ArrayLike, guess: Pose, *, search: PoseSearch
) -> PoseFit:
    """Find the camera's pose from measured contacts and the asperities they belong to.

    The pairs are found by voting: for each rotation and scale on a grid around the guess, a histogram counts
    the shifts between points and targets, and its fullest cell gives a candidate. Candidates are refined by
    least squares on one-to-one pairs, those closest to the guess first, until one explains nearly all points.
    If no candidate is significant, the guess is kept and ``fitted`` is False.

    Parameters
    ----------
    x_px, y_px : array_like, shape (n,)
        Contact centres. A few per cent may be spurious, any number may be missing.
    targets : array_like, shape (m, 2)
        Where contacts can be, in sample coordinates (the composite apexes of the asperities), m.
    guess : Pose
        The pose as the scene states it.
    search : PoseSearch
        Largest errors of the guess.

    Returns
    -------
    PoseFit
    """
    points = (
        np.asarray(x_px, float)
        - guess.image_centre[0]
        + 1j * (np.asarray(y_px, float) - guess.image_centre[1])
    )
    spots = as_complex(np.asarray(targets, float).reshape(-1, 2))
    gate = pairing_distance(as_real(spots), guess)
    best = PoseFit(guess, fitted=False, n_points=len(points), n_matched=0, residual=np.nan)
    if len(points) < MIN_PAIRS or len(spots) < MIN_PAIRS:
        return best
    tree = KDTree(as_real(spots))
    for start in _candidates(points, tree, guess, search, gate):
        fit = refine(points, spots, guess, start, gate)
        if fit.n_matched > best.n_matched:
            best = fit
        if best.n_matched >= COMPLETE_FRACTION * len(points):
            break
    by_chance = best.chance + CHANCE_SIGMA * np.sqrt(best.chance)
    significant = best.n_matched >= max(MIN_PAIRS, SIGNIFICANT_FRACTION * len(points), by_chance)
    return best if significant else replace(best, pose=guess, fitted=False, length_relative_std=0.0)


def _candidates(
    points: NDArray[np.complex128], tree: KDTree, guess: Pose, search: PoseSearch, gate: float
) -> Iterator[tuple[complex, complex, bool]]:
    """Similarities (alpha, beta, mirrored) worth refining, nearest to the guess first."""
    reach = float(np.abs(points).max()) * guess.pixel_size
    step = gate / max(reach, gate)
    turns = _outward(search.rotation, step)
    scales = _outward(search.scale, step)
    grid = sorted(((abs(t) + abs(s), t, s) for t in turns for s in scales), key=lambda item: item[0])
    for mirrored in (guess.mirrored, not guess.mirrored) if search.mirror else (guess.mirrored,):
        turned = oriented(points, mirrored)
        for _, turn, scale in grid:
            alpha = factor_of(guess, turn, scale, mirrored)
            shift = _vote(alpha * turned + complex(*guess.centre), tree, search.shift + gate, gate)
            if shift is not None:
                yield alpha, complex(*guess.centre) + shift, mirrored


def _outward(limit: float, step: float) -> list[float]:
    """0, +-step, +-2 step ... up to the limit."""
    n = int(np.ceil(limit / step)) if limit > 0 else 0
    return [k * limit / n for k in range(-n, n + 1)] if n else [0.0]


def _vote(points: NDArray[np.complex128], tree: KDTree, reach: float, cell: float) -> complex | None:
    """The shift on which most pairs (point, target) agree, if more than a third of the points do."""
    pairs = KDTree(as_real(points)).sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    if pairs.nnz == 0:
        return None
    shifts = tree.data[pairs.col] - as_real(points)[pairs.row]
    n = int(np.ceil(reach / cell)) + 1
    count, x, y = np.histogram2d(shifts[:, 0], shifts[:, 1], bins=2 * n, range=[[-n * cell, n * cell]] * 2)
    i, j = np.unravel_index(int(count.argmax()), count.shape)
    peak = np.array([(x[i] + x[i + 1]) / 2, (y[j] + y[j + 1]) / 2])
    close = np.linalg.norm(shifts - peak, axis=1) < 1.5 * cell
    if close.sum() < max(MIN_PAIRS, len(points) / POINTS_PER_VOTE):
        return None
    return complex(*np.median(shifts[close], axis=0))


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


def factor_of(guess: Pose, turn: float, scale: float, mirrored: bool) -> complex:  # noqa: FBT001
    """The factor alpha of a pose that is turned (rad) and scaled against the guess."""
    # image = R(rotation) F sample / size, so sample = F R(-rotation) image size
    angle = (guess.rotation + turn) * (1 if mirrored else -1)
    return complex(guess.pixel_size * (1 + scale) * np.exp(1j * angle))


def as_complex(points: NDArray) -> NDArray[np.complex128]:
    """(n, 2) real -> (n,) complex."""
    return points[:, 0] + 1j * points[:, 1]


def as_real(points: NDArray) -> NDArray[np.float64]:
    """(n,) complex -> (n, 2) real."""
    return np.column_stack([points.real, points.imag])


def oriented(points: NDArray[np.complex128], mirrored: bool) -> NDArray[np.complex128]:  # noqa: FBT001
    """Pixel points, conjugated if the image is mirrored."""
    return points.conj() if mirrored else points
