"""Find the camera anywhere over the sample, where the stated pose leads nowhere."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter
from scipy.special import bdtrc

from contactimg.pose.fit import MIN_PAIRS, PoseFit, as_complex, as_real, factor_of, oriented, refine
from contactimg.pose.pairs import pairing_distance
from contactimg.pose.pose import Pose

VOTING_POINTS = 40
"""Contacts that vote, those closest together: few turn little when the rotation is a step off. Chosen: all
rotations of a frame of 100 contacts over 2,500 asperities then take seconds."""

LEAST_VOTING_POINTS = 10
"""Fewer contacts do not vote: by the false-alarm rate they could not be accepted anyway."""

LARGEST_TURN_RAD = np.deg2rad(3.0)
"""Rotations that are tried around each of the quarter turns. Chosen: a camera that was aligned by hand."""

LARGEST_SCALE_ERROR = 0.03
"""Largest relative error of the stated pixel size that is tried. Chosen: a stage micrometer read badly."""

MOST_VOTES = 600
"""Rotations times scales that are tried at most; where contacts lie too far apart for that, fewer of them
vote. Chosen: ten seconds."""

REFINED_CANDIDATES = 5
"""Shifts with the most votes that are refined. Chosen by hand; the true one has many times the votes of
others."""

FALSE_ALARM_RATE = 1e-6
"""Probability that a pose is accepted although asperities and contacts have nothing to do with each other."""

BLOCK_REACH = 1.5 * np.sqrt(2)
"""From the middle of a block of three by three cells to its corner, in cells; theory."""

AMBIGUOUS_FRACTION = 0.8
"""A pose is not accepted if another one explains this fraction of its matches (a lattice). Chosen by hand."""


def search_everywhere(x_px: ArrayLike, y_px: ArrayLike, targets: ArrayLike, guess: Pose) -> PoseFit | None:
    """Search the pose among all positions over the sample: first as turned as stated, then at quarter turns.

    Parameters
    ----------
    x_px, y_px : array_like, shape (n,)
        Contact centres.
    targets : array_like, shape (m, 2)
        Where contacts can be, in sample coordinates, m.
    guess : Pose
        Its pixel size must be right to `LARGEST_SCALE_ERROR`; its centre is not used.

    Returns
    -------
    PoseFit or None
        None if no pose is significant, or several explain the contacts equally well.

    Notes
    -----
    Votes of the contacts that lie closest together, for each rotation and scale on a grid, as in
    `contactimg.pose.fit.fit_pose`. A pose is accepted if so many matches would be chance with a probability
    below `FALSE_ALARM_RATE`, all positions and rotations that were tried counted.
    """
    points = as_complex(np.column_stack([x_px, y_px]) - guess.image_centre)
    spots = as_complex(np.asarray(targets, float).reshape(-1, 2))
    if len(points) < MIN_PAIRS or len(spots) < MIN_PAIRS:
        return None
    gate = pairing_distance(as_real(spots), guess)
    for quarter_turns in ((0,), (1, 2, 3)):
        found = _best_pose(points, spots, guess, gate, quarter_turns)
        if found is not None:
            return found
    return None


def _best_pose(
    points: NDArray[np.complex128],
    spots: NDArray[np.complex128],
    guess: Pose,
    gate: float,
    quarter_turns: tuple[int, ...],
) -> PoseFit | None:
    """The pose that explains most contacts, if it is significant and the only one."""
    middle, grid = _voters(points, guess, gate, quarter_turns)
    if not grid:
        return None
    candidates = [(*_vote(middle, spots, alpha, mirrored, gate), alpha, mirrored) for alpha, mirrored in grid]
    candidates.sort(key=lambda candidate: -candidate[0])
    fits = [
        refine(points, spots, guess, (alpha, beta, mirrored), gate)
        for _, beta, alpha, mirrored in candidates[:REFINED_CANDIDATES]
    ]
    fits.sort(key=lambda fit: -fit.n_matched)
    best = fits[0]
    area = np.ptp(spots.real) * np.ptp(spots.imag)
    trials = max(area / gate**2, 1.0) * len(grid)
    chance = min(best.chance / len(points), 1.0)
    if bdtrc(best.n_matched - 1, len(points), chance) * trials > FALSE_ALARM_RATE:
        return None
    others = [fit for fit in fits[1:] if _differs(fit.pose, best.pose, gate)]
    if any(fit.n_matched > AMBIGUOUS_FRACTION * best.n_matched for fit in others):
        return None
    return replace(best, fitted=True)


def _voters(
    points: NDArray[np.complex128], guess: Pose, gate: float, quarter_turns: tuple[int, ...]
) -> tuple[NDArray[np.complex128], list[tuple[complex, bool]]]:
    """Points that vote, and what they vote on; nothing if there are too few of them."""
    ranked = points[np.argsort(np.abs(points - _densest(points)))]
    for count in range(min(VOTING_POINTS, len(points)), LEAST_VOTING_POINTS - 1, -5):
        grid = list(_grid(ranked[:count], guess, gate, quarter_turns))
        if len(grid) <= MOST_VOTES:
            return ranked[:count], grid
    return ranked[:0], []


def _densest(points: NDArray[np.complex128]) -> complex:
    """The point whose neighbours are closest together."""
    distance = np.sort(np.abs(points[:, None] - points[None, :]), axis=1)
    return complex(points[np.argmin(distance[:, min(VOTING_POINTS, len(points)) - 1])])


def _grid(
    points: NDArray[np.complex128], guess: Pose, gate: float, quarter_turns: tuple[int, ...]
) -> Iterator[tuple[complex, bool]]:
    """Rotations and scales, mirrored or not, in steps that move no point by more than a pairing distance."""
    reach = max(float(np.abs(points - points.mean()).max()) * guess.pixel_size, gate)
    turns, scales = (
        np.linspace(-limit, limit, 2 * int(np.ceil(limit * reach / gate)) + 1)
        for limit in (LARGEST_TURN_RAD, LARGEST_SCALE_ERROR)
    )
    for mirrored, quarter, turn, scale in product(
        (guess.mirrored, not guess.mirrored), quarter_turns, turns, scales
    ):
        yield factor_of(guess, quarter * np.pi / 2 + turn, scale, mirrored), mirrored


def _vote(
    points: NDArray[np.complex128],
    spots: NDArray[np.complex128],
    alpha: complex,
    mirrored: bool,  # noqa: FBT001
    cell: float,
) -> tuple[int, complex]:
    """Number of pairs of a point and a target that agree on a shift, and the shift on which most do."""
    turned = alpha * oriented(points, mirrored)
    shifts = (spots[None, :] - turned[:, None]).ravel()
    low = complex(shifts.real.min(), shifts.imag.min())
    column, row = ((shifts - low).real // cell).astype(int), ((shifts - low).imag // cell).astype(int)
    shape = (row.max() + 1, column.max() + 1)
    counts = (
        np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float32)
    )
    smooth = uniform_filter(counts, 3, mode="constant")
    i, j = np.unravel_index(int(smooth.argmax()), shape)
    peak = low + cell * complex(j + 0.5, i + 0.5)
    close = np.abs(shifts - peak) < BLOCK_REACH * cell
    beta = complex(np.median(shifts[close].real), np.median(shifts[close].imag))
    return int(close.sum()), beta


def _differs(one: Pose, other: Pose, gate: float) -> bool:
    """Whether two poses show the middle or a corner of the image at places apart."""
    corners = np.array([[0.0, 0.0], one.image_centre, 2 * one.image_centre]).T
    apart = np.subtract(one.to_sample(*corners), other.to_sample(*corners))
    return bool(np.hypot(*apart).max() > gate)
