"""All summits of a height map."""

from collections import Counter
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage, signal
from scipy.spatial import KDTree
from skimage.morphology import local_maxima, reconstruction
from skimage.segmentation import watershed

from contactimg.engine.progress import counted
from contactimg.errors import InputError
from contactimg.pose.apex import SIGNIFICANT_STDS
from contactimg.pose.pairs import MAD_TO_STD
from contactimg.summits.base import FORM_TERMS, ROUNDS, Base, Form, HeightMap, fit_base
from contactimg.tables import SUMMITS

Values = NDArray[np.float64]
Labels = NDArray[np.intp]

SMOOTHING_PX = 1.0
"""Standard deviation of the Gaussian before summits are looked for, px. Chosen: it leaves caps of three
pixels and takes two thirds of white noise away; positions and radii come from the heights as measured."""


STEEP = np.tan(np.radians(2.0))
"""Slope of the base above which the map should be levelled first. Theory: taking a plane of slope t off
changes radii by up to 3 t^2/2, 0.2 % at 2 degrees."""

RARE_SIGMAS = 4.5
"""Standard deviations beyond which pixels are spikes, and that the curvature of a summit must exceed. Theory:
1 of 150,000 normal values."""

SETTLED = 1e-9
"""Change of the heights, over the depth of a fit, at which it has converged. Theory: of Newton's method the
next one is about the square of it."""

MIN_PIXELS = 12
"""Fewest pixels of a fit: three for each of its parameters."""


LAGS = 4
"""Distance in pixels up to which residuals may be correlated (filters and interpolation of the instrument).
Chosen: the optics of profilometers blur over 1 to 4 px."""


def sphere_heights(sphere: Values, x: Values, y: Values) -> Values:
    """Heights ``z0 - k r^2 / (1 + sqrt(1 - k^2 r^2))`` of a sphere near its summit, m.

    Parameters
    ----------
    sphere : ndarray, shape (4,)
        x, y and z0 of the summit (m), and the curvature ``k`` (1/m), the inverse of the radius.
    x, y : ndarray, m
        Beyond the equator the heights are those at the equator.
    """
    x0, y0, z0, curvature = sphere
    squared = (x - x0) ** 2 + (y - y0) ** 2
    root = np.sqrt(np.clip(1 - curvature**2 * squared, 0.0, None))
    return np.asarray(z0 - curvature * squared / (1 + root))


@dataclass(frozen=True)
class SphereFit:
    """A sphere with the uncertainties of its parameters.

    Parameters
    ----------
    sphere : ndarray, shape (4,)
        x, y, z and curvature, see `sphere_heights`.
    covariance : ndarray, shape (4, 4)
        Of these, for residuals that are white.
    pixels : ndarray of bool
        Which of the pixels were fitted.
    residuals : ndarray, m
        Of all pixels.
    scatter : float, m
        Standard deviation of the residuals of the fitted pixels.
    factor : float
        By which the variance of a mean of residuals exceeds that of white noise.
    """

    sphere: Values
    covariance: Values
    pixels: NDArray[np.bool_]
    residuals: Values
    scatter: float
    factor: float = 1.0


Fits = tuple[SphereFit, SphereFit | None]
"""The spheres through a patch and through its upper half."""


def fit_sphere(points: Values, start: Values, *, depth: float, noise: float) -> SphereFit | None:
    """Fit a sphere to the pixels whose height on the sphere is less than ``depth`` below the summit.

    Parameters
    ----------
    points : ndarray, shape (3, n), m
        x, y and height of the pixels of a region.
    start : ndarray, shape (4,)
        The sphere to begin with.
    depth : float, m
        How far the fit reaches down.
    noise : float, m
        Least standard deviation of the residuals at which pixels are taken for spikes.

    Returns
    -------
    SphereFit or None
        None where fewer than `MIN_PIXELS` pixels are left or they do not define a summit.
    """
    sphere, before, x, y, z = start, np.empty(0, np.bool_), *points
    for _ in range(ROUNDS):
        fitted = sphere_heights(sphere, x, y)
        residuals, chosen = z - fitted, fitted > sphere[2] - depth
        if chosen.sum() >= MIN_PIXELS:
            off = np.abs(residuals - np.median(residuals[chosen]))
            chosen &= off < RARE_SIGMAS * max(MAD_TO_STD * float(np.median(off[chosen])), noise, 1e-300)
        if chosen.sum() < MIN_PIXELS:
            return None
        dx, dy = x[chosen] - sphere[0], y[chosen] - sphere[1]
        squared = dx**2 + dy**2
        root = np.sqrt(np.clip(1 - sphere[3] ** 2 * squared, 0.01, None))
        slope, one = sphere[3] / root, np.ones_like(dx)
        jacobian = np.stack([slope * dx, slope * dy, one, -squared / (root * (1 + root))], axis=1)
        scale = np.sqrt((jacobian**2).mean(axis=0)) + 1e-300
        jacobian /= scale
        normal = jacobian.T @ jacobian
        if not np.linalg.cond(normal) <= 1e12:
            return None
        step = np.linalg.solve(normal, jacobian.T @ residuals[chosen]) / scale
        sphere, curvature = sphere + step, sphere[3]
        sphere[3] = min(max(sphere[3], curvature / 2), 2 * curvature)
        if np.array_equal(chosen, before) and np.all(np.abs(step) * scale <= SETTLED * depth):
            break
        before = chosen
    residuals = z - sphere_heights(sphere, x, y)
    scatter = float(np.sqrt((residuals[chosen] ** 2).sum() / (chosen.sum() - 4)))
    covariance = np.linalg.inv(normal) / np.outer(scale, scale) * scatter**2
    return SphereFit(sphere, covariance, chosen, residuals, scatter)


def correlation_factor(residuals: Values) -> float:
    """Factor by which the variance of a mean of neighbouring residuals exceeds that of white noise.

    Parameters
    ----------
    residuals : ndarray, shape (rows, columns)
        NaN outside the fitted pixels.

    Returns
    -------
    float
        Sum of the autocorrelation over lags within `LAGS` px, at least 1.
    """
    valid = np.isfinite(residuals).astype(np.float64)
    values = np.where(valid > 0, residuals, 0.0)
    products, pairs = (signal.correlate(np.pad(one, LAGS), one, mode="valid") for one in (values, valid))
    mean = products / np.maximum(pairs, 1.0)
    near = (np.hypot(*np.mgrid[-LAGS : LAGS + 1, -LAGS : LAGS + 1]) <= LAGS) & (pairs > 0.5)
    own = float(mean[LAGS, LAGS])
    return max(1.0, float(mean[near].sum()) / own) if own > 0 else 1.0


@dataclass(frozen=True)
class FoundSummits:
    """The summits of a map, and what is doubtful about it.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.SUMMITS`, the highest first.
    noise : float, m
        Standard deviation of a pixel of the base.
    left_out : dict of str to int
        Why summits are not in the table, and how many.
    warnings : list of str
        What is doubtful about the map.
    """

    table: pd.DataFrame
    noise: float
    left_out: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def find_summits(
    surface: HeightMap, *, form: Form = "plane", least_height: float = 0.0, depth: float = 0.5
) -> FoundSummits:
    """Find the summits of a map and fit a sphere to the top of each.

    The base is fitted first and taken off; what stands out of it is divided along the valleys, and a sphere
    is fitted by least squares to the pixels of each region that lie less than ``depth`` times the height
    below the summit. Spikes are left out. Uncertainties come from the residuals and their correlation; where
    the upper half of a patch gives another sphere than the whole, the difference is part of them.

    Parameters
    ----------
    surface : HeightMap
    form : {"plane", "sphere", "none"}
        What is taken off the heights first.
    least_height : float, m
        Lower summits are left out.
    depth : float
        How far the fit of a sphere reaches down, as a share of the height of the summit above the base.

    Returns
    -------
    FoundSummits

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    An asperity on the flank of a larger one, without a maximum of its own, is not found. Of one that the edge
    of the map cuts, the part on the map is fitted if the summit lies on it. Heights are above the base below
    the summit; x and y count from the centre of the map, y downwards.

    Examples
    --------
    >>> x = np.arange(-20, 21) * 1e-6
    >>> squared = x[:, None] ** 2 + x**2
    >>> cap = np.maximum(np.sqrt(np.maximum((5e-5) ** 2 - squared, 0)) - 4.7e-5, 0)
    >>> found = find_summits(HeightMap(cap, (1e-6, 1e-6)))
    >>> found.table[["height_m", "radius_m"]].round(9).to_dict("records")
    [{'height_m': 3e-06, 'radius_m': 5e-05}]
    """
    if not 0 < depth <= 1:
        raise InputError(f"the depth of the fit must be above 0 and at most 1, got {depth!r}")
    if not (np.isfinite(least_height) and least_height >= 0):
        raise InputError(f"the least height must be 0 or more, got {least_height!r} m")
    if form not in FORM_TERMS:
        raise InputError(f"form must be one of {', '.join(map(repr, FORM_TERMS))}, got {form!r}")
    surface, cut_off = _without_clipped(surface)
    base = fit_base(surface, form)
    heights = surface.heights - base.heights
    labels, smoothed = _divide(heights, base, least_height)
    points = np.stack([*np.meshgrid(surface.x, surface.y), heights])
    fits, left_out, windows = list[Fits](), Counter[str](), ndimage.find_objects(labels)
    for number, window in enumerate(counted(windows, "fitting summits", len(windows)), start=1):
        mine, part = labels[window] == number, points[:, *window]
        peak, inside = np.where(mine, smoothed[window], -np.inf), mine & np.isfinite(part[2])
        fit = _fit_patch(part, inside, peak, float(np.prod(surface.pixel_size)), depth, base.noise)
        reason = _why_not(fit, surface, least_height)
        if fit is None or reason:
            left_out[reason] += 1
        else:
            fits.append(fit)
    kept = _without_twins(fits, depth)
    left_out["second summits of one asperity"] = len(fits) - len(kept)
    factor = float(np.median([whole.factor for whole, _ in kept])) if kept else 1.0
    rows = [_row(*fit, base, factor) for fit in kept]
    table = SUMMITS.conform(pd.DataFrame(rows, columns=[*SUMMITS.columns]))
    table = table.sort_values("height_m", ascending=False, ignore_index=True)
    return FoundSummits(table, base.noise, dict(+left_out), cut_off + _doubts(surface, base, table))


def _without_clipped(surface: HeightMap) -> tuple[HeightMap, list[str]]:
    """The map with holes where the instrument cut the heights off, and a sentence about them.

    A sphere has as many pixels in each step of the height: more at the largest one lie above the range. Where
    most pixels are at the largest height, they are the base of a map without noise.
    """
    heights = surface.heights
    largest = np.nanmax(heights, initial=-np.inf)
    top = heights == largest
    next_lower = np.max(heights, initial=-np.inf, where=heights < largest)
    # Theory: a sphere has as many pixels at its largest height as at the next lower one.
    clipped, fewest = int(np.count_nonzero(top)), 3.0 * np.count_nonzero(heights == next_lower)
    if not max(MIN_PIXELS, fewest) <= clipped <= heights.size // 2 or not np.isfinite(next_lower):
        return surface, []
    text = (
        f"{clipped} pixels have the largest height, {1e6 * largest:.4g} um: the instrument cut off what is "
        "higher; summits there follow from the heights below"
    )
    return replace(surface, heights=np.where(top, np.nan, heights)), [text]


def _divide(heights: Values, base: Base, least_height: float) -> tuple[Labels, Values]:
    """One region of pixels for each summit, and the heights without spikes and with less noise.

    What stands out of the base is divided along the valleys, without summits below ``least_height``.
    """
    missing, filled = ~np.isfinite(heights), heights
    if missing.any():
        nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
        filled = heights[tuple(nearest)]
    scale = float(np.abs(filled).max()) or 1.0
    median = cv2.medianBlur((filled / scale).astype(np.float32), 5).astype(np.float64) * scale
    smoothed: Values = ndimage.gaussian_filter(median, SMOOTHING_PX, mode="nearest")
    # the median of 25 normal numbers scatters by sqrt(pi/2/25) of their standard deviation
    noise, below = 0.25 * base.noise, -smoothed[smoothed < 0]
    if base.seen and below.size:
        noise = MAD_TO_STD * float(np.median(below))
    # Theory: of 10^7 pixels none rises by 6 standard deviations of the smoothed noise by chance.
    rise = 6.0 * max(noise, 1e-9 * float(np.ptp(smoothed)))
    flooded = reconstruction(np.maximum(smoothed - rise, 0.0), np.maximum(smoothed, 0.0))
    tops = local_maxima(flooded) & (flooded > max(0.0, least_height - rise))
    markers, _ = ndimage.label(tops, structure=np.ones((3, 3)))
    return watershed(-smoothed, markers, mask=smoothed > rise).astype(np.intp), smoothed


def _fit_patch(  # noqa: PLR0917 - the pixels of a region and how they are fitted
    points: Values, inside: NDArray[np.bool_], smoothed: Values, area: float, depth: float, noise: float
) -> Fits | None:
    """The spheres through a region and through its upper half; None where it holds no summit to be fitted.

    The first is guessed: at the highest smoothed pixel, with the curvature that the area of the upper half
    gives; ``area`` is that of a pixel.
    """
    top = np.unravel_index(int(np.argmax(smoothed)), smoothed.shape)
    height, chosen = float(smoothed[top]), points[:, inside]
    upper = float((smoothed > height / 2).sum()) * area
    sphere = np.array([points[0][top], points[1][top], height, np.pi * height / upper])
    for _ in range(2):  # the second time the height is known, and so is the depth
        whole = fit_sphere(chosen, sphere, depth=depth * sphere[2], noise=noise)
        sphere = sphere if whole is None else whole.sphere
    if whole is None:
        return None
    residuals = np.full(inside.shape, np.nan)
    residuals[inside] = np.where(whole.pixels, whole.residuals, np.nan)
    half = fit_sphere(chosen, sphere, depth=depth / 2 * sphere[2], noise=noise)
    return replace(whole, factor=correlation_factor(residuals)), half


def _without_twins(fits: list[Fits], depth: float) -> list[Fits]:
    """The fits from the one with the most pixels down, without those whose summit is that of one before."""
    fits = sorted(fits, key=lambda fit: -int(fit[0].pixels.sum()))
    spheres, kept = np.reshape([whole.sphere for whole, _ in fits], (-1, 4)), set[int]()
    # Two fits whose summits are nearer than half of the radius of their patches are one asperity.
    reach = 0.5 * np.sqrt(2 * depth * spheres[:, 2] / spheres[:, 3])
    for k, near in enumerate(KDTree(spheres[:, :2]).query_ball_point(spheres[:, :2], reach)):
        if kept.isdisjoint(near):
            kept.add(k)
    return [fits[k] for k in sorted(kept)]


def _why_not(fit: Fits | None, surface: HeightMap, least_height: float) -> str:
    """Why a summit is left out; empty where it is not."""
    if fit is None:
        return "too few pixels for a sphere"
    whole, _ = fit
    *place, height, curvature = whole.sphere
    if np.any(np.abs(place) - np.abs([surface.x[0], surface.y[0]]) > np.array(surface.pixel_size) / 2):
        return "summits beyond the edge of the map"
    if not curvature > RARE_SIGMAS * np.sqrt(whole.covariance[3, 3] * whole.factor):
        return "no curvature beyond the noise"
    return "lower than the least height" if height < least_height else ""


def _row(whole: SphereFit, half: SphereFit | None, base: Base, factor: float) -> tuple[object, ...]:
    """The columns of `SUMMITS` in their order."""
    x, y, height, curvature = whole.sphere
    count = int(whole.pixels.sum())
    # of count/factor independent residuals the fit takes four away, from their scatter and their correlation
    fewer = count / max(count - 4 * factor, count / 4)
    stds = np.sqrt(np.diag(whole.covariance) * factor) * fewer
    bends, message = _misfit(whole, half, factor)
    height_std, radius_std = np.hypot(stds[2:], bends) / [1, curvature**2]
    height_std = np.hypot(height_std, base.std)
    place = x, y, height, 1 / curvature
    return *place, height_std, radius_std, *stds[:2], whole.scatter, count, message


def _misfit(whole: SphereFit, half: SphereFit | None, factor: float) -> tuple[Values, str]:
    """The change of height and curvature between the upper half and the whole, beyond their errors."""
    if half is None:
        return np.zeros(2), "few pixels: whether it is a sphere was not tested"
    change = (half.sphere - whole.sphere)[2:]
    # of least squares over a part and over all, the variance of the difference is the difference of variances
    scale = (whole.scatter / half.scatter) ** 2 if half.scatter > 0 else 1.0
    variance = np.diag(half.covariance * scale - whole.covariance)[2:] * factor
    spread = np.maximum(variance, (SETTLED * whole.sphere[2:]) ** 2)
    if np.all(change**2 <= SIGNIFICANT_STDS**2 * spread):
        return np.zeros(2), ""
    # the error by the next order of the form is in proportion to the depth: twice as large for the whole
    excess = 2.0 * np.sqrt(np.maximum(change**2 - spread, 0.0))
    height, radius = 100 * (half.sphere / whole.sphere)[2:] ** [1, -1] - 100
    apart = f"{radius:+.2g} and {height:+.2g} %"
    return excess, f"no sphere: radius and height of the upper half differ by {apart}"


def _doubts(surface: HeightMap, base: Base, table: pd.DataFrame) -> list[str]:
    warnings = []
    if not base.seen:
        warnings.append(
            "no base is seen between the asperities: heights are above the mean surface, whose place depends "
            "on how much of the asperities is on the map"
        )
    rises = np.abs(base.heights[[0, -1], [-1, 0]] - base.heights[0, 0])
    slope = float(np.max(rises / [np.ptp(surface.x), np.ptp(surface.y)]))
    if slope > STEEP:
        warnings.append(
            f"the base is inclined by {np.degrees(np.arctan(slope)):.1f} degrees: level the map, or take "
            f"radii to be uncertain by {150 * slope**2:.1f} %"
        )
    odd = int(table["message"].str.startswith("no sphere").sum())
    if odd > 0.05 * len(table):
        warnings.append(f"no sphere: {odd} of {len(table)} summits; their uncertainties allow for it")
    return warnings
