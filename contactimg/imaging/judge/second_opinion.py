"""A second opinion on every contact, free of the model of its edge.

**Light.** Any symmetric point spread function moves light without creating any: the light of a contact
above the background, divided by the contrast, is its area, whatever its shape. Each contact sums the pixels
whose nearest rim is its own, out to where its blurred rim has ended. The level of the background is that of
the ring around it, as far as such rings differ by more than their noise; the contrast is that inside the
contact's own core, or for a contact too small to have one the median of the others.

**Half height.** Behind a blur of standard deviation s the level line at half the contact's own height
encloses the area ``A - pi s^2`` of any shape without holes that is wide against s: a rim of curvature k is
displaced by ``-k s^2/2``, and the curvature of a closed line integrates to ``2 pi``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import estimate_noise
from contactimg.imaging.kernels.contact_light import (
    COLUMNS,
    CORE_LIGHT,
    CORE_SEEN,
    LIGHT,
    MISSING,
    RING_LIGHT,
    RING_SEEN,
    SEEN,
    area_above,
    find_outshone,
    stand_out,
    sum_light,
)
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.pixels.blocks import BLOCK, block_means
from contactimg.imaging.pixels.masks import Mask, for_kernel
from contactimg.imaging.pixels.robust import robust_std
from contactimg.timings import stage

Values = NDArray[np.float64]

REGION_BLUR_WIDTHS = 4.0
"""Distance from the rim at which the region ends. Theory: 3e-5 of the edge's height is left there."""
SURROUNDINGS_BLUR_WIDTHS = 2.5
"""Distance at which a contact no longer brightens its surroundings. Theory: 0.6 % of the edge's height."""
RING_PX = 3.0
"""Width of the ring beyond the region. Chosen: as many pixels as the region of a small contact has."""
CORE_BLUR_WIDTHS = 3.0
"""Distance of the core from the rim. Theory: 0.13 % of the edge's height is missing there."""
LARGEST_CORE_RADII = 0.5
"""Largest core, radii of the contact. Chosen: it lies inside squares and ellipses of 1.5 : 1 as well."""
LEAST_CORE_BLUR_WIDTHS = 0.5
"""Radius of the smallest core. Chosen: contacts from 3.5 blur widths on show their own contrast."""
FEWEST_CORES = 3
"""Contacts with a core that a frame needs to show its contrast. Chosen, as for the fit."""
HALF_HEIGHT_TO_NOISE = 12.0
"""Contrast over noise below which noise notches the level line: twice six standard deviations."""
BLUR_RELATIVE_STD = 0.1
"""Relative uncertainty of the blur in the shift of the level line. Chosen: also for edges of other shapes."""
ALONE_BLUR_WIDTHS = 6.0
"""Gap to a neighbour that leaves the level line where it is. Theory: 0.13 % of its edge is left halfway."""
CHORD_DEFICIT_PX2 = 0.5
"""Area between a circle and the chords that marching squares lay in it. Theory: a chord l cuts off
``l^3/(12 a)``; in squares of a pixel, crossed in any direction, the mean of l^3 is 3/4, that of l is pi/4."""
OUTLIER_SIGMA = 4.0
"""Distance of a value from the others beyond which it stands for itself. False-alarm rate: 6e-5."""
CHI_SQUARE_MEDIAN = 0.4549
"""Median of the square of a standard normal deviate. Theory."""
WIDE_RING_PX = (3.0, 10.0)
"""Distances from the rim between which a contact is compared with all that is there. Chosen: the first beyond
the blurred edge of most frames, the second for as many pixels as a small contact and its rim have."""
OUTSHONE_FRACTION = 1e-4
"""Of the contrast, by which a contact must be brighter. Accuracy: sums of single precision."""
LEAST_BLUR_PX = 0.5
"""Smallest blur that regions are laid out for: a pixel is a blur of 0.29 px, and rims lie between pixels."""
FEWEST_BLOCKS = 30
"""Background blocks that give the scatter of their means: to 13 % (theory: 1/sqrt(2 n))."""
UNKNOWN_CORRELATION = 4.0
"""Factor of the variance of a sum for noise that pixels share, where such blocks are too few. Chosen."""


@dataclass(frozen=True, eq=False)
class AreaNoise:
    """Noise of sums over pixels, as the background shows it: with all that neighbouring pixels share.

    Parameters
    ----------
    pixels : ndarray, shape (k,)
        Number of pixels of a block.
    variance : ndarray, shape (k,)
        Of the means over such blocks, squared grey levels.
    """

    pixels: Values
    variance: Values

    @classmethod
    def of(cls, image: NDArray[np.float32], background: NDArray[np.bool_], noise: float) -> "AreaNoise":
        """From the background blocks of an image, and the standard deviation of one of its pixels."""
        pixels, variance = [1.0], [noise**2]
        means, used, side = block_means(image), background, BLOCK
        if used.shape != means.shape:
            used = np.zeros(means.shape, np.bool_)
        while np.count_nonzero(used) >= FEWEST_BLOCKS and side <= 4 * BLOCK:
            pixels.append(float(side**2))
            variance.append(max(robust_std(means[used]) ** 2, noise**2 / side**2))
            means, side = block_means(means, side=2), 2 * side
            rows, columns = used.shape[0] // 2, used.shape[1] // 2
            used = np.asarray(used[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).all(axis=(1, 3)))
            means = means[:rows, :columns]
        if len(pixels) == 1:
            pixels, variance = [1.0, BLOCK**2], [noise**2, UNKNOWN_CORRELATION * noise**2 / BLOCK**2]
        return cls(np.array(pixels), np.array(variance))

    def variance_of_mean(self, pixels: Values) -> Values:
        """Variance of the mean of so many neighbouring pixels; that of the largest block beyond it."""
        logs = np.interp(np.log(np.maximum(pixels, 1.0)), np.log(self.pixels), np.log(self.variance + 1e-30))
        return np.exp(logs)


@dataclass(frozen=True, eq=False)
class Scenery:
    """What the second opinion is taken from.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        Difference image, contacts positive, grey levels.
    valid : Mask
        0 for pixels that are not seen.
    noise : AreaNoise
        Of its background.
    level : float
        Grey level of the background, by which contacts multiply the texture; 0 if it is not known.
    """

    image: NDArray[np.float32]
    valid: Mask
    noise: AreaNoise
    level: float

    @classmethod
    def of(
        cls, image: NDArray[np.float32], *, valid: Mask, background: NDArray[np.bool_], level: float
    ) -> "Scenery":
        """From a difference image and its background blocks (`contactimg.imaging.pixels.blocks`)."""
        return cls(image, valid, AreaNoise.of(image, background, estimate_noise(image, background)), level)

    def gain(self, height: Values) -> Values:
        """Factor of the noise at a height above the background: contacts brighten its texture as well."""
        return 1.0 + np.maximum(height, 0.0) / self.level if self.level > 0 else np.ones(len(height))


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """Areas of contacts from their light and at half height, without a model of the edge.

    Parameters
    ----------
    light_area, light_area_std : ndarray, shape (n,), px^2
        Light above the background over the contrast, and its standard uncertainty: noise as the background
        shows it (with what pixels share), level of the background, contrast. NaN where a part of the contact
        is not seen, or where neither it nor three others are
        wide enough to show the contrast.
    half_area, half_area_std : ndarray, shape (n,), px^2
        Area at half the contact's own height, corrected for the blur, and its standard uncertainty. NaN for
        contacts without a core (narrower than 3.5 blur widths), with a neighbour within six blur widths, cut
        by the border, or in noise above a twelfth of the contrast.
    contrast, contrast_std : ndarray, shape (n,), grey levels
        Used for each contact: its own, weighted against the mean of all.
    common_contrast, common_contrast_std : float, grey levels
        Of the contacts with a core; NaN for fewer than three.
    """

    light_area: Values
    light_area_std: Values
    half_area: Values
    half_area_std: Values
    contrast: Values
    contrast_std: Values
    common_contrast: float
    common_contrast_std: float


@stage("second opinion")
def measure_again(scenery: Scenery, disks: Values, *, blur_px: float) -> SecondOpinion:
    """Measure the areas of contacts once more, from what the image shows without a model of the edge.

    Parameters
    ----------
    scenery : Scenery
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px): where the contacts are. Areas depend on the radius only through the pixels that are
        summed; a radius wrong by less than two blur widths changes nothing.
    blur_px : float
        Standard deviation of the blurred edge; pixels are laid out by it, and areas at half height are
        corrected for it.

    Returns
    -------
    SecondOpinion

    Notes
    -----
    Light is shared between contacts that touch along the line halfway between their rims. Light is not area
    where the plateau of a contact is not flat (saturated, domed) or the camera is not linear.

    Examples
    --------
    A square of 12 px, of which neither measure knows that it is no disk:

    >>> import cv2
    >>> image = np.zeros((48, 48), np.float32)
    >>> image[18:30, 18:30] = 100.0
    >>> image = cv2.GaussianBlur(image, (0, 0), 1.2)
    >>> scenery = Scenery.of(image, valid=None, background=np.ones((6, 6), bool), level=0.0)
    >>> opinion = measure_again(scenery, np.array([[23.5, 23.5, 7.0]]), blur_px=1.2)
    >>> opinion.light_area.round(0), opinion.half_area.round(0)
    (array([144.]), array([144.]))
    """
    disks = np.ascontiguousarray(disks[:, :3], float)
    blur = max(blur_px, LEAST_BLUR_PX)
    sums = _sum_pixels(scenery, disks, blur)
    background = _Population.of(*_mean_and_variance(sums[:, RING_LIGHT], sums[:, RING_SEEN], scenery.noise))
    contrast = _contrasts(sums, background, scenery)
    light, light_std = _light_areas(sums, contrast, background, scenery)
    levels = background.value + 0.5 * contrast.value
    shown = (sums[:, CORE_SEEN] > 0) & (sums[:, MISSING] == 0)
    shown &= contrast.value > HALF_HEIGHT_TO_NOISE * np.sqrt(scenery.noise.variance[0])
    shown[find_pairs(disks, ALONE_BLUR_WIDTHS / 2 * blur).ravel()] = False
    half = np.empty(len(disks))
    reach = REGION_BLUR_WIDTHS * blur
    area_above(scenery.image, disks, np.where(shown, levels, np.nan), reach, half)
    half += np.pi * blur**2 + CHORD_DEFICIT_PX2
    rim = 2.0 * np.pi * disks[:, 2]
    noise = scenery.noise.variance_of_mean(2.0 * blur * rim) * scenery.gain(0.5 * contrast.value) ** 2
    half_std = _half_area_std(rim, contrast, background, blur, noise)
    return SecondOpinion(
        light, light_std, half, half_std, contrast.value, contrast.std, contrast.common, contrast.common_std,
    )  # fmt: skip


def measure_rise(
    image: NDArray[np.float32], valid: Mask, disks: Values, *, blur_px: float, prominence: float = np.inf
) -> tuple[Values, Values]:
    """How far each contact stands out of its surroundings, and what these scatter.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive, 0 at holes.
    valid : Mask
        0 at holes.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur_px : float
        Standard deviation of the blurred edge.
    prominence : float
        Rise over scatter beyond which neither matters.

    Returns
    -------
    rise, scatter : ndarray, shape (n,), grey levels
        Mean inside the contact minus the median of its surroundings, and their robust standard deviation; NaN
        where no surroundings are seen. Beyond ``prominence`` bounds of both may be given: at least the rise,
        at most the scatter.
    """
    blur = max(blur_px, LEAST_BLUR_PX)
    near, far = SURROUNDINGS_BLUR_WIDTHS * blur, REGION_BLUR_WIDTHS * blur + RING_PX
    places = np.ascontiguousarray(disks[:, :3], float)
    rise, scatter = stand_out(image, for_kernel(valid), places, near, far, prominence).T
    return rise, scatter


def is_outshone(
    image: NDArray[np.float32], disks: Values, *, contrast: float, spare_crowds: bool
) -> NDArray[np.bool_]:
    """Which contacts are no brighter than the median of a wide ring around them.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive.
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    contrast : float
        Grey levels.
    spare_crowds : bool
        Leave out those whose ring other contacts fill for the most part, and that outshine the rest of it.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    places, margin = np.ascontiguousarray(disks[:, :3], float), OUTSHONE_FRACTION * abs(contrast)
    return np.asarray(find_outshone(image, places, WIDE_RING_PX, margin, spare_crowds) == 1)


def _sum_pixels(scenery: Scenery, disks: Values, blur: float) -> Values:
    """Rows of `contactimg.imaging.kernels.contact_light.sum_light`, laid out for a blur."""
    core = np.maximum(disks[:, 2] - CORE_BLUR_WIDTHS * blur, 0.0)
    core = np.minimum(core, LARGEST_CORE_RADII * disks[:, 2])
    core[core < LEAST_CORE_BLUR_WIDTHS * blur] = 0.0
    region = REGION_BLUR_WIDTHS * blur
    limits = np.array([region, region + RING_PX])
    sums = np.zeros((len(disks), COLUMNS))
    sum_light(scenery.image, for_kernel(scenery.valid), disks, core, limits, sums)
    return sums


@dataclass(frozen=True, eq=False)
class _Population:
    """Values of all contacts, each drawn to the mean of all as far as their scatter is noise.

    Parameters
    ----------
    value, std : ndarray, shape (n,)
        With the excess scatter t a value of variance s^2 weighs ``t^2/(t^2 + s^2)`` against the mean. One far
        from all others stays as it is.
    common, common_std : float
        Median of the values that are known, and its standard uncertainty; NaN if none is.
    """

    value: Values
    std: Values
    common: float
    common_std: float

    @classmethod
    def of(cls, values: Values, variance: Values) -> "_Population":
        """From values and their variances, infinite where a value is not known."""
        known = np.isfinite(variance)
        if not known.any():
            nothing = np.full(len(values), np.nan)
            return cls(nothing, nothing, np.nan, np.nan)
        middle, own = float(np.median(values[known])), np.where(known, variance, 0.0)
        excess = _excess_variance((values[known] - middle) ** 2, variance[known])
        total = own + excess
        common_variance = np.pi / 2 * float(np.mean(total[known])) / np.count_nonzero(known)
        share = np.where(known, excess / np.maximum(total, 1e-30), 0.0)
        share[known & ((values - middle) ** 2 > OUTLIER_SIGMA**2 * total)] = 1.0
        left = np.where(known, share * own, excess) + (1.0 - share) ** 2 * common_variance
        value = np.where(known, middle + share * (values - middle), middle)
        return cls(value, np.sqrt(left), middle, float(np.sqrt(common_variance)))


def _excess_variance(squares: Values, variance: Values) -> float:
    """Variance that must be added so that the squared deviations have the median of a chi-square, 0.455.

    Half of the deviations need more than that to fall below this median.
    """
    return max(float(np.median(squares / CHI_SQUARE_MEDIAN - variance)), 0.0)


def _mean_and_variance(total: Values, pixels: Values, noise: AreaNoise) -> tuple[Values, Values]:
    """Mean of sums over pixels, and its variance; infinite without a pixel."""
    mean = np.divide(total, pixels, out=np.zeros(len(pixels)), where=pixels > 0)
    return mean, np.where(pixels > 0, noise.variance_of_mean(pixels), np.inf)


def _contrasts(sums: Values, background: _Population, scenery: Scenery) -> _Population:
    """Contrast of each contact: that of its core, and of the population."""
    core, variance = _mean_and_variance(sums[:, CORE_LIGHT], sums[:, CORE_SEEN], scenery.noise)
    height = core - background.value
    variance = variance * scenery.gain(height) ** 2 + background.std**2
    variance[~(height > 0)] = np.inf
    known = np.isfinite(variance)
    if np.count_nonzero(known) < FEWEST_CORES:
        value, std = (np.where(known, part, np.nan) for part in (height, np.sqrt(variance)))
        return _Population(value, std, np.nan, np.nan)
    return _Population.of(height, variance)


def _light_areas(
    sums: Values, contrast: _Population, background: _Population, scenery: Scenery
) -> tuple[Values, Values]:
    """Light over contrast, and its standard uncertainty."""
    seen = sums[:, SEEN]
    area = (sums[:, LIGHT] - seen * background.value) / contrast.value
    inside = np.clip(area / np.maximum(seen, 1.0), 0.0, 1.0)
    gain = 1.0 + inside * (scenery.gain(contrast.value) ** 2 - 1.0)
    noise = scenery.noise.variance_of_mean(seen) * gain
    variance = seen**2 * (noise + background.std**2) + (area * contrast.std) ** 2
    std = np.sqrt(variance) / contrast.value
    unseen = (sums[:, MISSING] > 0) | (seen == 0)
    return np.where(unseen, np.nan, area), np.where(unseen, np.nan, std)


def _half_area_std(
    rim: Values, contrast: _Population, background: _Population, blur: float, noise: Values
) -> Values:
    """Standard uncertainty of areas at half height, from the lengths of their rims.

    A level off by e displaces the line by e over the slope of the edge, ``C/(sqrt(2 pi) s)``.
    """
    slope = contrast.value / (np.sqrt(2.0 * np.pi) * blur)
    level = np.sqrt((0.5 * contrast.std) ** 2 + background.std**2 + noise)
    return np.hypot(rim * level / slope, 2.0 * np.pi * blur**2 * BLUR_RELATIVE_STD)
