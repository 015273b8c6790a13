"""Find the pose of the camera that makes measured contacts coincide with the asperities they belong to.

A similarity of the plane is linear in complex numbers, ``z' = alpha z + beta`` (``conj(z)`` if mirrored).
Once the pairs are known, the pose follows from linear least squares; finding the pairs is the hard part and
comes first.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter
from scipy.spatial import KDTree
from scipy.special import bdtrc

from contactimg.errors import InputError
from contactimg.pose import pairs
from contactimg.pose.pose import Pose

Points = NDArray[np.complex128]
"""Places in the plane, x + iy."""

MIN_PAIRS = 3
"""Theory: two pairs determine a similarity; a third one tests it."""

NEARLY_ALL = 0.9
"""The search ends where this fraction of the voting contacts agree, and two poses are ambiguous if one
explains this fraction of what the other does (a lattice). A frame with fewer contacts on asperities gets a
remark. Chosen by hand; sensitivity not measured."""

SIGNIFICANT_FRACTION = 0.5
"""A pose must explain this fraction of the points to replace the guess, or to agree with a prediction.
Chosen: a right one explains 0.9, one with a wrong apex next to nothing."""

LARGEST_TURN_RAD = np.deg2rad(3.0)
"""Rotations that are tried around each of the quarter turns. Chosen: a camera that was aligned by hand."""

LARGEST_SCALE_ERROR = 0.03
"""Largest relative error of the stated pixel size that is tried. Chosen: a stage micrometer read badly."""

MOST_VOTES = 600
"""Rotations times scales that are tried at most; where contacts lie too far apart for that, fewer of them
vote. Chosen: ten seconds."""

FALSE_ALARM_RATE = 1e-6
"""Probability that a pose is accepted although asperities and contacts have nothing to do with each other."""


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
        Points given, and points that fall on a target of the fitted pose.
    residual : float
        RMS distance of the matched pairs, m (nan if none).
    length_relative_std : float
        Relative standard uncertainty of a fitted pixel size; 0 for one that was given.
    """

    pose: Pose
    fitted: bool = False
    n_points: int = 0
    n_matched: int = 0
    residual: float = np.nan
    length_relative_std: float = 0.0


def fit_pose(
    x_px: ArrayLike, y_px: ArrayLike, targets: ArrayLike, guess: Pose, *, largest_shift: float
) -> PoseFit:
    """Find the camera's pose from measured contacts and the asperities they belong to.

    It is looked for near the guess, then anywhere over the sample, in the end also at quarter turns. The
    pairs are found by voting: for each rotation and scale on a grid, a histogram counts the shifts between
    contacts and targets. Those with the most votes are refined by least squares on one-to-one pairs.

    Parameters
    ----------
    x_px, y_px : array_like, shape (n,)
        Contact centres. A few per cent may be spurious, any number may be missing.
    targets : array_like, shape (m, 2)
        Where contacts can be, in sample coordinates (the composite apexes of the asperities), m.
    guess : Pose
        The pose as the scene states it.
    largest_shift : float, m
        Error of the place of the image centre up to which a pose is near the guess. Rotation and scale may
        err by `LARGEST_TURN_RAD` and `LARGEST_SCALE_ERROR`, and the image may be mirrored.

    Returns
    -------
    PoseFit
        The guess, and ``fitted`` is False, if no pose is significant, or if several far from the guess
        explain the contacts equally well.

    Raises
    ------
    InputError
        If a place is not finite.

    Notes
    -----
    A pose is significant if it explains `SIGNIFICANT_FRACTION` of the contacts, and if so many matches would
    be chance with a probability below `FALSE_ALARM_RATE`, all positions and rotations that were tried
    counted.
    """
    places = np.column_stack([x_px, y_px]) - guess.image_centre, np.asarray(targets, float).reshape(-1, 2)
    wrong = np.concatenate([one[~np.isfinite(one)] for one in places])
    if len(wrong):
        raise InputError(f"a pose needs finite x_px, y_px and targets, got {wrong[0]}; leave these rows out")
    gate, (points, spots) = pairs.pairing_distance(places[1], guess), map(as_complex, places)
    searches = ((largest_shift, (0,)), (np.inf, (0,)), (np.inf, (1, 2, 3)))
    enough = min(len(points), len(spots)) >= MIN_PAIRS
    fits = (_search(points, spots, guess, gate, where) for where in searches if enough)
    return next((found for found in fits if found is not None), PoseFit(guess, n_points=len(points)))


def _search(
    points: Points, spots: Points, guess: Pose, gate: float, where: tuple[float, tuple[int, ...]]
) -> PoseFit | None:
    """The pose that explains most contacts, if it is significant and, wherever it may be, the only one.

    ``where`` tells how far from the guess its centre may be (m), and at which quarter turns.
    """
    (reach, quarters), tree = where, KDTree(as_real(spots))
    if near := np.isfinite(reach):
        middle, grid = points, _grid(points, guess, gate, quarters)
    else:
        middle, grid = _voters(points, guess, gate, quarters)
    centre, votes = complex(*guess.centre), list[tuple[int, complex, complex, bool]]()

    def shifts(alpha: complex, mirrored: bool) -> Points:  # noqa: FBT001
        moved = alpha * oriented(middle, mirrored)
        if not near:
            return (spots - moved[:, None]).ravel()
        about = KDTree(as_real(moved + centre))
        close = about.sparse_distance_matrix(tree, reach + gate, output_type="coo_matrix")
        return spots[close.col] - moved[close.row]

    for alpha, mirrored in grid:
        count, beta = _vote(shifts(alpha, mirrored), gate)
        votes.append((count, alpha, beta, mirrored))
        if count >= NEARLY_ALL * len(middle):
            break
    # five by hand: the true shift has many times the votes of others
    starts = [vote[1:] for vote in sorted(votes, key=lambda vote: -vote[0])[:5]]
    fits = [_refine(points, spots, guess, start, gate) for start in starts]
    best, (alpha, beta, mirrored) = max(zip(fits, starts, strict=True), key=lambda pair: pair[0].n_matched)
    # as many shifts were tried as pairing distances fit into the area
    area = float(np.ptp(spots.real) * np.ptp(spots.imag))
    chance = min(len(spots) * np.pi * gate**2 / area, 1.0) if area > 0 else 1.0
    trials = len(votes) * min(area, np.pi * reach**2) / gate**2
    by_chance = bdtrc(best.n_matched - 1, len(points), chance) * trials
    if best.n_matched < SIGNIFICANT_FRACTION * len(points) or by_chance > FALSE_ALARM_RATE:
        return None
    if near:
        return best
    # on a lattice another shift explains as much
    left = shifts(alpha, mirrored)
    _, other = _vote(left[np.abs(left - beta) > 2 * gate], gate)
    fits.append(_refine(points, spots, guess, (alpha, other, mirrored), gate))
    as_good = [fit.pose for fit in fits if fit.n_matched > NEARLY_ALL * best.n_matched]
    return None if any(_differs(pose, best.pose, gate) for pose in as_good) else best


def _voters(
    points: Points, guess: Pose, gate: float, quarters: tuple[int, ...]
) -> tuple[Points, list[tuple[complex, bool]]]:
    """Points that vote, and what they vote on: fewer points where these would be too many poses."""
    # those closest together turn little when the rotation is a step off; 40 are chosen: all rotations of 100
    # contacts over 2,500 asperities then take seconds
    count = min(40, len(points))
    distance = KDTree(as_real(points)).query(as_real(points), k=[count])[0]
    ranked = points[np.argsort(np.abs(points - points[np.argmin(distance)]))]
    while True:
        grid = _grid(ranked[:count] - ranked[:count].mean(), guess, gate, quarters)
        if len(grid) <= MOST_VOTES or count <= pairs.FEWEST_CONTACTS:
            return ranked[:count], grid[:MOST_VOTES]
        count -= 5


def _differs(one: Pose, other: Pose, gate: float) -> bool:
    """Whether two poses show the middle or a corner of the image at places apart."""
    corners = np.array([[0.0, 0.0], one.image_centre, 2 * one.image_centre]).T
    apart = np.subtract(one.to_sample(*corners), other.to_sample(*corners))
    return bool(np.hypot(*apart).max() > gate)


def _grid(points: Points, guess: Pose, gate: float, quarters: tuple[int, ...]) -> list[tuple[complex, bool]]:
    """Factors of poses that are turned and scaled against the guess, mirrored or not, nearest to it first.

    No step moves one of the points (px) by more than a pairing distance.
    """
    reach = max(float(np.abs(points).max()) * guess.pixel_size, gate)
    turns, scales = (
        np.linspace(-limit, limit, 2 * int(np.ceil(limit * reach / gate)) + 1)
        for limit in (LARGEST_TURN_RAD, LARGEST_SCALE_ERROR)
    )
    grid, factors = sorted(product(turns, scales), key=lambda item: abs(item[0]) + abs(item[1])), []
    mirrors = (guess.mirrored, not guess.mirrored)
    for mirrored, quarter, (turn, scale) in product(mirrors, quarters, grid):
        # image = R(rotation) F sample / size, so sample = F R(-rotation) image size
        angle = (guess.rotation + quarter * np.pi / 2 + turn) * (1 if mirrored else -1)
        factors.append((complex(guess.pixel_size * (1 + scale) * np.exp(1j * angle)), mirrored))
    return factors


def _vote(shifts: Points, cell: float) -> tuple[int, complex]:
    """Number of pairs of a point and a target that agree on a shift, and the shift on which most do."""
    if not shifts.size:
        return 0, 0j
    i, j = (np.floor(part / cell).astype(np.intp) for part in (shifts.real, shifts.imag))
    i, j = i - i.min(), j - j.min()
    shape = int(i.max()) + 1, int(j.max()) + 1
    numbers = np.bincount(i * shape[1] + j, minlength=shape[0] * shape[1])
    counts = numbers.reshape(shape).astype(np.float32)
    row, column = np.unravel_index(int(uniform_filter(counts, 3, mode="constant").argmax()), shape)
    close = shifts[(np.abs(i - row) <= 1) & (np.abs(j - column) <= 1)]
    return close.size, complex(np.median(close.real), np.median(close.imag))


def _refine(
    points: Points, spots: Points, guess: Pose, start: tuple[complex, complex, bool], gate: float
) -> PoseFit:
    """Least squares on one-to-one pairs: pair and fit in turn until the pairs no longer change."""
    alpha, beta, mirrored = start
    turned, reach, before = oriented(points, mirrored), 2 * gate, None
    for _ in range(pairs.ROUNDS):
        i, j, distance = pairs.pair_points(as_real(alpha * turned + beta), as_real(spots), max_distance=reach)
        now = (tuple(i), tuple(j))
        if len(i) < MIN_PAIRS:
            return PoseFit(guess, n_points=len(points))
        if now == before:
            break
        before = now
        design = np.column_stack([turned[i], np.ones(len(i))])
        alpha, beta = np.linalg.lstsq(design, spots[j])[0]
        left = np.abs(alpha * turned[i] + beta - spots[j])
        std = float(np.median(left)) / np.sqrt(2 * np.log(2))  # of a coordinate: Rayleigh's law
        reach = min(gate, max(pairs.OUTLIER_SIGMA * std, pairs.MIN_PAIRING_PX * guess.pixel_size))
    size, turn = float(abs(alpha)), float(np.angle(alpha) if mirrored else -np.angle(alpha))
    centre = (float(beta.real), float(beta.imag))
    pose = replace(guess, pixel_size=size, centre=centre, rotation=turn, mirrored=mirrored)
    squares, spread = np.sum(distance**2), np.sum(np.abs(turned[i] - turned[i].mean()) ** 2)
    size_std = np.sqrt(squares / (2 * len(i) - 4) / spread)  # of the modulus of alpha
    quality = {"residual": float(np.sqrt(squares / len(i))), "length_relative_std": float(size_std / size)}
    return PoseFit(pose, fitted=True, n_points=len(points), n_matched=len(i), **quality)


def as_complex(points: NDArray) -> Points:
    """(n, 2) real -> (n,) complex."""
    return points[:, 0] + 1j * points[:, 1]


def as_real(points: NDArray) -> NDArray[np.float64]:
    """(n,) complex -> (n, 2) real."""
    return np.column_stack([points.real, points.imag])


def oriented(points: Points, mirrored: bool) -> Points:  # noqa: FBT001
    """Pixel points, conjugated if the image is mirrored."""
    return points.conj() if mirrored else points


def common_shift(points: ArrayLike, targets: ArrayLike, *, near: float, far: float) -> NDArray[np.float64]:
    """The shift (x, y) by which most points lie from a target, within a distance ``near``; at most ``far``.

    Examples
    --------
    >>> targets = np.array([[0.0, 0.0], [5.0, 1.0], [2.0, 7.0]])
    >>> common_shift(targets + [1.5, 0.5], targets, near=0.2, far=4.0)
    array([1.5, 0.5])
    """
    points, targets = (np.asarray(one, float).reshape(-1, 2) for one in (points, targets))
    close = KDTree(points).sparse_distance_matrix(KDTree(targets), far, output_type="coo_matrix")
    _, shift = _vote(as_complex(points[close.row] - targets[close.col]), near)
    return np.array([shift.real, shift.imag])
