"""Candidates for contacts: regions above half of their own plateau, each described without a model.

Regions are found at half of the contrast that most of them have. A region much brighter is outlined again at
half of its own plateau, and what stands out of the noise below half of the common contrast is outlined at
half of its own. Round regions are one disk; the others are covered by inscribed disks.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.detect.components import component_of_pixels, label_runs, window_of
from contactimg.imaging.detect.inscribed_disks import (
    LARGEST_WHOLE_HOLES,
    as_one_contact,
    disks_in_region,
    fill,
    find_holes,
    is_round,
)
from contactimg.imaging.pixels.blocks import SignedImage
from contactimg.imaging.pixels.masks import Values
from contactimg.imaging.pixels.robust import LIGHT_SIGMA, SIGNIFICANT_SIGMA, quantile
from contactimg.imaging.profile.limits import FEW, NOISY_RATIO, SMALL_AREA_PX2

WIDE_PX2 = 30.0
"""Area above half height of a region that shows its plateau: a radius of two blur widths of 1.5 px. Theory:
1 - exp(-2) = 86 % of it at the centre."""
SPECK_PX2 = 10.0
"""Area above half height of a speck. By hand: dust of 2 px behind a blur of 1 px."""
DARK_FRACTION = 0.2
"""Level below the background, of the contrast, from which a spot is dark. By hand."""
ODD_RATIO = 1.3
"""Plateau over the common contrast, or its inverse, from which a region is outlined at its own half.
Theory: the edge at the wrong level is then off by a quarter of a blur width."""
FAINT_RATIO = 0.7  # plateau over the common contrast up to which a region is faint. By hand
WEIGHT_CAP = 8.0
"""Area over the median one up to which a region counts in the contrast. By hand: no single one decides."""


Regions = tuple[NDArray[np.void], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
"""Regions above a level, their runs of pixels, plateaus, and areas above half of these (pixels)."""
Outlined = tuple[NDArray | float, NDArray[np.float64], bool]
"""The plateau of a region, the disks in it, and whether it is one ellipse."""


@dataclass(frozen=True)
class Contrast:
    """Plateau that most regions have, above the background.

    Parameters
    ----------
    plateau : float
        Grey levels; 0 where nothing stands out.
    resolved : bool
        Whether regions wide enough to show it were found.
    std : float
        Standard uncertainty, grey levels.
    """

    plateau: float
    resolved: bool
    std: float = float("nan")

    def within(self, largest: float) -> "Contrast":
        """The contrast, with a plateau that does not exceed the largest possible one."""
        return replace(self, plateau=min(self.plateau, largest))


@dataclass(frozen=True, eq=False)
class Candidates:
    """Disks that may be contacts.

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        x, y, radius (px), largest first.
    plateau : ndarray, shape (n,)
        Of the region that each lies in, grey levels.
    whole : ndarray of bool, shape (n,)
        Whether the region is no disk, but one ellipse as a whole.
    """

    places: NDArray[np.float64]
    plateau: NDArray[np.float64]
    whole: NDArray[np.bool_]


def measure_contrast(image: SignedImage) -> Contrast:
    """The plateau that most regions of a difference image have."""
    spots = Contrast(0.0, resolved=False)
    for side in (2, 4, 8):
        coarse, floor, (_, runs, plateau, half_area) = image.squares(side)[0], *_shown_by(image, side)
        # By hand; theory: noise alone reaches 1.3 in a million pixels.
        clear = plateau > 1.5 * floor
        if not clear.any():
            continue
        wide = clear & (half_area > WIDE_PX2 / 4)  # squares: those of a spot are no plateau
        if wide.any():
            values, areas = plateau[wide], half_area[wide]
            middle = _weighted_median(values, np.minimum(areas, WEIGHT_CAP * np.median(areas)))
            usual = values[np.abs(values / middle - 1.0) < ODD_RATIO - 1.0]
            middle = _core_level(coarse, runs, np.where(wide, plateau, 0.0), middle)
            spread = float(np.std(usual)) if len(usual) > 1 else 0.05 * middle
            std = spread / np.sqrt(max(len(usual), 1)) + 0.005 * middle
            return Contrast(middle, resolved=True, std=std)
        if not spots.plateau:
            peak = quantile(plateau, 0.95)
            spots = Contrast(peak, resolved=False, std=peak * np.log(10.0) / np.sqrt(12.0))
        if float(plateau.max()) > 3.0 * floor:
            break  # coarser squares only dilute it
    return spots


def dark_spots(image: SignedImage, contrast: float) -> NDArray[np.float64]:
    """Areas (px^2) of the spots, larger than specks, that are darker than the background.

    ``contrast`` is that of the contacts.
    """
    coarse, noise = image.squares(2)
    floor = max(SIGNIFICANT_SIGMA * noise, DARK_FRACTION * contrast)
    area = 4.0 * _with_plateaus(-coarse, floor)[3]
    return area[area > SPECK_PX2]


def find_candidates(seen: SignedImage, contrast: float, *, blur: float) -> Candidates:
    """Disks in the regions that stand out of a difference image.

    Parameters
    ----------
    seen : SignedImage
    contrast : float
        Common contrast, grey levels.
    blur : float, px
        Standard deviation of the blur, for smoothing where the contrast is low.
    """
    image, noise = seen.image, seen.noise
    smooth, smooth_noise = image, noise
    if contrast < NOISY_RATIO * noise:
        smooth = cv2.GaussianBlur(image, (0, 0), blur, borderType=cv2.BORDER_REPLICATE).astype(np.float32)
        smooth_noise = noise / (2.0 * np.sqrt(np.pi) * blur)
    level = max(0.5 * contrast, SIGNIFICANT_SIGMA * smooth_noise)
    regions, runs, plateau, half_area = _with_plateaus(smooth, level)
    faint, ragged, width = _faint_regions(seen, level, regions)
    bright = (plateau > ODD_RATIO * contrast) & (half_area > WIDE_PX2) & ~ragged
    shown = ~bright & ~ragged & (regions["area"] > SMALL_AREA_PX2)
    one = is_round(regions, smooth.shape) & shown
    round_ones = regions[one]
    places = np.column_stack([round_ones["x"], round_ones["y"], np.sqrt(round_ones["area"] / np.pi)])
    found: list[Outlined] = [(plateau[one], places, False)]
    for k in np.flatnonzero(shown & ~one):
        disks, whole = disks_in_region(regions[k], k, runs, smooth.shape)
        lower = _whole_at_lower_level(regions[k], smooth, level) if len(disks) > 1 else None
        found.append((plateau[k], disks, whole) if lower is None else (plateau[k], lower, True))
    for k in np.flatnonzero(bright):
        found += _at_own_half(regions[k], smooth, level, float(plateau[k]))
    for height, disks, whole in faint:
        # the disk that the blur reduces to this fraction of its height
        share = np.minimum(height / contrast, 0.99)
        small = float(blur * np.sqrt(-2.0 * np.log1p(-share))) if contrast > height else 0.0
        spot = np.sqrt(2.0 * np.log(2.0)) * np.sqrt(blur**2 + 0.25 * small**2 + width**2)
        # A wider one has a brightness of its own. By hand: pixels and noise make 1.1.
        if len(disks) == 1 and disks[0, 2] < 1.15 * spot:
            disks[0, 2] = small
            found.append((contrast, disks, False))
        else:
            found.append((height, disks, whole))
    disks = np.vstack([part for _, part, _ in found])
    heights = np.concatenate([np.broadcast_to(height, len(part)) for height, part, _ in found])
    wholes = np.concatenate([np.full(len(part), whole) for _, part, whole in found])
    order = np.argsort(-disks[:, 2], kind="stable")
    return Candidates(disks[order], heights[order], wholes[order])


def _whole_at_lower_level(region: np.void, image: Values, level: float) -> NDArray[np.float64] | None:
    """The disk of a region that is one ellipse at a lower level, which mottling does not cut up, or None."""
    # By hand: 0.6 of the first level, and up to 4 px beyond the first outline.
    box, corner = window_of(region, 4)
    above = (image[box] > 0.6 * level).astype(np.uint8)
    labels = cv2.connectedComponents(above, connectivity=8)[1]
    peak = labels[int(region["peak_y"]) - box[0].start, int(region["peak_x"]) - box[1].start]
    own = np.asarray(labels == peak).astype(np.uint8)
    if any(side.any() for side in (own[0], own[-1], own[:, 0], own[:, -1])):
        return None
    disk = as_one_contact(fill(own, find_holes(own), LARGEST_WHOLE_HOLES * own.sum()), own)
    return None if disk is None else disk + corner


def _core_level(
    image: NDArray[np.float32], runs: NDArray[np.int64], plateau: NDArray[np.float64], middle: float
) -> float:
    """Median of the pixels of the usual regions all of whose neighbours are above half height.

    No region counts more than `WEIGHT_CAP` usual ones. Where there are too few such pixels: ``middle``.
    """
    used = np.where(np.abs(plateau / middle - 1.0) < ODD_RATIO - 1.0, plateau, np.inf)
    # Accuracy: 1500 runs of pixels know a median to 1 % of the scatter.
    values, owner = _core_pixels(image, runs[:: max(len(runs) // 1500, 1)], used)
    if len(values) < FEW:
        return middle
    count = np.bincount(owner)
    cap = WEIGHT_CAP * np.median(count[count > 0])
    return _weighted_median(values, np.minimum(1.0, cap / count[owner]))


@njit(cache=True)
def _core_pixels(image, runs, plateau):
    """Pixels whose neighbours all exceed half of the plateau of their region, and its number."""
    rows, columns = image.shape
    total = 0
    for i in range(len(runs)):
        total += runs[i, 2] - runs[i, 1] + 1
    values, owner, n = np.empty(total, np.float64), np.empty(total, np.int64), 0
    for i in range(len(runs)):
        y, first, last, k = runs[i, 0], runs[i, 1], runs[i, 2], runs[i, 3]
        half = 0.5 * plateau[k]
        if y == 0 or y == rows - 1 or not np.isfinite(half):
            continue
        for x in range(max(first, 1), min(last, columns - 2) + 1):
            core = True
            for j in range(y - 1, y + 2):
                for m in range(x - 1, x + 2):
                    core &= image[j, m] > half
            if core:
                values[n], owner[n] = image[y, x], k
                n += 1
    return values[:n], owner[:n]


def _weighted_median(values: NDArray, weights: NDArray) -> float:
    """The value at which half of the weight is reached."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _with_plateaus(image: NDArray[np.float32], level: float) -> Regions:
    """Regions above a level, their runs of pixels, plateaus, and areas above half of these (pixels)."""
    regions, runs = label_runs(image, float(level))
    plateau, half_area = np.zeros((2, len(regions)))
    _measure_plateaus(image, runs, regions["peak"].astype(np.float64), plateau, half_area)
    return regions, runs, plateau, half_area


@njit(cache=True)
def _measure_plateaus(image, runs, peak, plateau, half_area):
    """Mean of the pixels near the peak of each region, above 3/4 of it, and its area above half of it."""
    count = np.zeros(len(peak))
    for i in range(len(runs)):
        y, first, last, k = runs[i, 0], runs[i, 1], runs[i, 2], runs[i, 3]
        number, total = _sum_above(image[y, first : last + 1], np.float32(0.75 * peak[k]))
        count[k] += number
        plateau[k] += total
    for k in range(len(peak)):
        plateau[k] /= max(count[k], 1.0)
    for i in range(len(runs)):
        y, first, last, k = runs[i, 0], runs[i, 1], runs[i, 2], runs[i, 3]
        half_area[k] += _sum_above(image[y, first : last + 1], np.float32(0.5 * plateau[k]))[0]


@njit(cache=True, fastmath=True, forceinline=True)
def _sum_above(line, level):
    """Number and sum of the pixels of a line above a level, without a branch: vector instructions."""
    number = total = zero = np.float32(0.0)
    for x in range(len(line)):
        above = np.float32(1.0) if line[x] > level else zero
        number += above
        total += above * line[x]
    return number, total


def _outlined(
    window: NDArray[np.float32], corner: NDArray[np.float64], level: float, least: float = 0.0
) -> list[Outlined]:
    """Regions of a window of an image above half of their plateaus that are larger than an area (px^2).

    ``corner`` is the place (x, y, 0) of the first pixel of the window.
    """
    parts, runs = label_runs(window, level)
    found = (disks_in_region(parts[k], k, runs, window.shape) for k in np.flatnonzero(parts["area"] > least))
    return [(2.0 * level, disks + corner, whole) for disks, whole in found]


def _at_own_half(region: np.void, image: NDArray[np.float32], level: float, plateau: float) -> list[Outlined]:
    """Disks of a bright region at half of its own plateau, and of what was beside it."""
    box, corner = window_of(region, 1)
    rest = image[box].copy()
    found = _outlined(rest, corner, 0.5 * plateau)
    for x, y, a in np.vstack([disks - corner for _, disks, _ in found]):
        cv2.circle(rest, (round(x), round(y)), int(np.ceil(1.15 * a + 2)), 0.0, cv2.FILLED)
    return found + _outlined(rest, corner, level, WIDE_PX2)


def _shown_by(seen: SignedImage, side: int) -> tuple[float, Regions]:
    """Level from which squares of a side stand out of their noise, and the regions above, outlined once."""
    if side not in seen.outlined:
        squares, noise = seen.squares(side)
        floor = max(SIGNIFICANT_SIGMA * noise, 1e-6)
        seen.outlined[side] = floor, _with_plateaus(squares, floor)
    floor, regions = seen.outlined[side]
    return floor, regions


def _faint_regions(
    seen: SignedImage, level: float, regions: NDArray[np.void]
) -> tuple[list[Outlined], NDArray[np.bool_], float]:
    """Regions that stand out of the noise and contain none found before, each in a window of its own.

    Those found before are pieces of a region whose own plateau lies about at the level at which they were
    outlined, where they are ragged: which of them is returned too, and the width (px) of the
    filter behind which the faint ones are outlined.
    """
    side, noise = 2, seen.squares(2)[1]
    # coarser squares where noise hides faint regions, as long as it falls: with white noise by half
    while side < 8 and not SIGNIFICANT_SIGMA * noise < FAINT_RATIO * level:
        wider_noise = seen.squares(2 * side)[1]
        # Theory: 0.5 for white noise, 1 for texture wider than the squares; by hand, near the former.
        if wider_noise > 0.6 * noise:
            break
        side, noise = 2 * side, wider_noise
    if not SIGNIFICANT_SIGMA * noise < level:
        return [], np.zeros(len(regions), np.bool_), 0.0
    support, runs, plateau, half_area = _shown_by(seen, side)[1]
    half_area = half_area * side**2
    # a few pixels of noise on a faint plateau reach the level as well
    where = component_of_pixels(runs, regions["peak_x"] // side, regions["peak_y"] // side)
    outlined = (where >= 0) & (regions["area"] > SMALL_AREA_PX2)
    covered = np.bincount(where[outlined], regions["area"][outlined], minlength=len(support))
    at_level = plateau < FAINT_RATIO * 2.0 * level
    # By hand: at half of the contrast noise decides pixel by pixel, and leaves pieces of a region.
    taken = (covered > 0) & ~(at_level & (covered < 0.6 * half_area))
    light = support["flux"] > LIGHT_SIGMA * noise * np.sqrt(support["area"])
    shown = light & ~taken & (half_area > WIDE_PX2)
    # Regions are outlined behind a filter of half the side of the squares that show them. By hand.
    found, width = list[Outlined](), 0.5 * side
    for k in np.flatnonzero(shown):
        box, corner = window_of(support[k], 1)
        part = seen.image[tuple(slice(side * at.start, side * at.stop) for at in box)]
        blurred = cv2.GaussianBlur(part, (0, 0), width, borderType=cv2.BORDER_REPLICATE)
        own = 0.5 * float(plateau[k])
        found += _outlined(np.asarray(blurred, np.float32), side * corner, own, 0.5 * WIDE_PX2)
    return found, np.append(shown, False)[where], width
