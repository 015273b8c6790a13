"""Fit the circle of a wide contact, to a hundredth of a pixel.

The light across the edge, air film included (`contactimg.optics.wide_edge`), is fitted to the means of the
image over sectors and rings. Free are centre, radius, ellipse, contrast, background, blur and a wide halo. A
Cauchy loss reduces the weight of dust and scratches, and the scatter of the sectors gives the uncertainty of
the radius.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import fft, optimize, special
from threadpoolctl import threadpool_limits

from contactimg.errors import FrameError
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX
from contactimg.imaging.pixels.robust import CLIP_SIGMA, MAD_TO_STD
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.limits import LEAST_FRACTION
from contactimg.imaging.smooth.find_circle import RING_PX, SECTORS, SHORTEST_ARC, Circle, EdgeSamples
from contactimg.optics.film import ExcessTable
from contactimg.optics.wide_edge import EdgeLight, edge_light

Values = NDArray[np.float64]

Loss = Literal["linear", "cauchy"]

WIDEST_FILM_PX = 80.0
"""Width of film whose fringes are sampled, and on both sides for the blur: four of the widest. By hand."""
WIDEST_BLUR_PX = 20.0
"""Upper limit of the blur, and of the width by which a halo exceeds it, in the fit."""
ELLIPSE_ARC = 0.75
"""Fraction of the circumference from which on an ellipse is told from a shifted circle. Chosen by hand."""
LINE_STEP_PX = 0.1
"""Step of the light across the edge: linear interpolation of a line blurred by 1 px errs by 3e-4."""


@dataclass(frozen=True)
class EdgeModel:
    """The quantities that determine the light at the edge: pixel size, sphere and lamp.

    Parameters
    ----------
    pixel_size, sphere_radius : float, m
    excess : ExcessTable
        Of the air film under the lamp.
    """

    pixel_size: float
    sphere_radius: float
    excess: ExcessTable

    def light(self, radius_px: float, opening: float) -> EdgeLight:
        """Light across the edge of a contact."""
        radius = radius_px * self.pixel_size
        return edge_light(radius, sphere_radius=self.sphere_radius, opening=opening, excess=self.excess)

    def film_px(self, radius_px: float) -> float:
        """Width of the film's fringes without adhesion, at most."""
        return min(self.light(radius_px, 0.0).reach / self.pixel_size, WIDEST_FILM_PX)


@dataclass(frozen=True, eq=False)
class _Line:
    """Spectrum of the light of the film along a line across the edge; a blur multiplies it."""

    grid: Values
    spectrum: NDArray[np.complex128]

    @classmethod
    def of(cls, light: EdgeLight, pixel_size: float) -> "_Line":
        reach = light.reach / pixel_size
        count = fft.next_fast_len(int((reach + 2 * WIDEST_FILM_PX) / LINE_STEP_PX), real=True)
        means = light.film_means(-WIDEST_FILM_PX * pixel_size, LINE_STEP_PX * pixel_size, count)
        grid = np.asarray((np.arange(count) + 0.5) * LINE_STEP_PX - WIDEST_FILM_PX, float)
        return cls(grid, fft.rfft(means))

    def blurred(self, outside: Values, blur: float) -> Values:
        """Light at distances outside the edge, px: a blurred step and the blurred film."""
        step = special.ndtr(-outside / blur)
        if not self.spectrum.any():
            return step
        return step + np.interp(outside, self.grid, _blurred_film(self, blur), left=0.0, right=0.0)


@lru_cache(maxsize=4)  # derivatives by most numbers of an edge leave its blur and that of its halo unchanged
def _blurred_film(line: _Line, blur: float) -> Values:
    """The light of the film on the grid of the line."""
    damping = np.exp(-2 * (np.pi * blur * fft.rfftfreq(len(line.grid), LINE_STEP_PX)) ** 2)
    return np.asarray(fft.irfft(line.spectrum * damping, len(line.grid)), float)


def fit_circle(
    samples: EdgeSamples, model: EdgeModel, *, opening: float, blur_px: float | None = None
) -> Circle:
    """Fit the circle to samples of the image about it.

    Parameters
    ----------
    samples : EdgeSamples
    model : EdgeModel
    opening : float, sqrt(m)
        How fast the film opens (`contactimg.optics.wide_edge`); infinity for no film.
    blur_px : float, optional
        Standard deviation of the blur to start from.

    Returns
    -------
    Circle

    Raises
    ------
    FrameError
        If too little of the edge is visible.
    """
    numbers = _visible(samples.sector)
    line, start = _start(samples, model, opening, blur_px)
    # without the loss at first, so that an edge far from the rough circle counts; last without stray sectors
    passes: tuple[Loss, ...] = ("linear", "cauchy", "cauchy")
    for loss in passes:
        used = np.isin(samples.sector, numbers)
        names = ("azimuth", "distance", "value", "weight", "sector")
        kept = replace(samples, **{name: getattr(samples, name)[used] for name in names})
        arc = len(np.unique(kept.sector)) / SECTORS
        # of a short arc an ellipse cannot be told from a shift
        fixed = [] if arc > ELLIPSE_ARC else [3, 4]
        start, misfit = _fit(kept, line, start, fixed=fixed, loss=loss)
        offsets, azimuths, shown = _sector_offsets(kept, start, line)
        numbers = _visible(shown)
        if loss == "cauchy":
            off = np.abs(offsets - np.median(offsets))
            near = off <= CLIP_SIGMA * max(MAD_TO_STD * float(np.median(off)), 1e-6)
            offsets, azimuths, numbers = offsets[near], azimuths[near], numbers[near]
            if near.all():
                break
    return _fitted_circle(samples.circle, start, misfit, offsets, azimuths)


def _visible(sectors: NDArray[np.intp]) -> NDArray[np.intp]:
    """The sectors that show the edge, each once, unless they are too few for a circle."""
    numbers = np.unique(sectors)
    if len(numbers) < SHORTEST_ARC * SECTORS:
        raise FrameError(f"less than {SHORTEST_ARC:.0%} of the contact's edge can be used")
    return numbers


def _start(
    samples: EdgeSamples, model: EdgeModel, opening: float, blur_px: float | None
) -> tuple[_Line, Values]:
    """The film's light, and shift, radius, ellipse, contrast, background, blur and halo to start from."""
    high, low = np.percentile(samples.value, [90, 10])
    if not high > low:
        raise FrameError("the light is the same on both sides of the contact's edge")
    blur = float(np.hypot(DEFAULT_BLUR_PX if blur_px is None else blur_px, PIXEL_VARIANCE**0.5))
    radius = samples.circle.radius_px
    for _ in range(2):  # a radius 5 % too large makes a gap 2 % too wide, and that a radius good to 0.1 %
        line = _Line.of(model.light(radius, opening), model.pixel_size)
        grid = line.grid[line.grid > -3 * blur]
        half = grid[(line.blurred(grid, blur) < 0.5).argmax()]
        radius = samples.circle.radius_px - float(half)
    return line, np.array([0.0, 0.0, radius, 0.0, 0.0, high - low, low, blur, 0.02, 5.0])


@threadpool_limits.wrap(limits=1, user_api="blas")  # threads make the decomposition of narrow matrices slower
def _fit(
    samples: EdgeSamples, line: _Line, start: Values, *, fixed: list[int], loss: Loss
) -> tuple[Values, float]:
    """Least squares for the numbers of the edge but the fixed ones, and the misfit."""
    free = np.setdiff1d(np.arange(len(start)), fixed)
    contrast = abs(start[5])
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    # the blur, the light in the halo and the width by which it exceeds the blur
    low[2], low[7:] = 0.5 * start[2], (PIXEL_VARIANCE**0.5, 0.0, 2.0)
    high[7:] = WIDEST_BLUR_PX, 0.5, WIDEST_BLUR_PX
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1.0, contrast, contrast, 1.0, 0.1, 2.0])
    start = np.clip(start, low, high)

    def residuals(moved: Values) -> Values:
        p = start.copy()
        p[free] = moved
        return samples.weight * (_profile(_outside(samples, p), p, line) - samples.value)

    fit = optimize.least_squares(
        residuals, start[free], bounds=(low[free], high[free]), loss=loss, f_scale=CLIP_SIGMA,
        x_scale=scale[free], xtol=1e-7, ftol=1e-5, max_nfev=50,
    )  # fmt: skip
    p = start.copy()
    p[free] = fit.x
    return p, float(np.sqrt(2 * fit.cost / max(len(samples.value) - len(free), 1)))


def _outside(samples: EdgeSamples, p: Values) -> Values:
    """Distances of samples outside the fitted edge, px."""
    return samples.distance - p[:5] @ samples.waves


def _profile(outside: Values, p: Values, line: _Line) -> Values:
    """Grey level at distances outside the edge, blurred by a core and a wide halo.

    A round edge lies inside a straight one by ``blur^2/(2 a)`` at half its height.
    """
    radius, contrast, background, blur, halo, width = p[[2, 5, 6, 7, 8, 9]]
    wide = float(np.hypot(blur, width))
    core_light = line.blurred(outside + blur**2 / (2 * radius), blur)
    halo_light = line.blurred(outside + wide**2 / (2 * radius), wide)
    return background + contrast * ((1 - halo) * core_light + halo * halo_light)


def _sector_offsets(samples: EdgeSamples, p: Values, line: _Line) -> tuple[Values, Values, NDArray[np.intp]]:
    """The distance of the edge outside the fitted one in each sector that shows it; direction and number.

    Samples far off, of dust, have less weight.
    """
    outside = _outside(samples, p)
    rest = samples.weight * (samples.value - _profile(outside, p, line))
    step = 0.1 * p[7]
    fall = _profile(outside - step, p, line) - _profile(outside + step, p, line)
    fall *= samples.weight / (2 * step)
    trust = 1 / (1 + (rest / CLIP_SIGMA) ** 2)
    numbers, inverse = np.unique(samples.sector, return_inverse=True)
    slope = np.bincount(inverse, trust * fall**2)
    shown = slope > 0  # not where all samples lie far from the edge
    offset = np.bincount(inverse, trust * fall * rest)[shown] / slope[shown]
    azimuth = (np.bincount(inverse, samples.azimuth) / np.bincount(inverse))[shown]
    return offset, azimuth, numbers[shown]


def _fitted_circle(rough: Circle, p: Values, misfit: float, offsets: Values, azimuths: Values) -> Circle:
    """The circle of the fitted numbers, with the uncertainties that the scatter of its sectors implies.

    The numbers are relative to the centre of the rough circle.
    """
    waves = [f(k * azimuths) for k in (1, 2) for f in (np.cos, np.sin)]
    arc = len(offsets) / SECTORS
    whole = arc > ELLIPSE_ARC
    design = np.column_stack([np.ones(len(azimuths)), *waves])[:, : 5 if whole else 3]
    numbers = np.linalg.lstsq(design, offsets, rcond=None)[0]
    rest = offsets - design @ numbers
    variance = float(rest @ rest) / max(len(rest) - len(numbers), 1)
    stds = np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design))).tolist()
    x, y, radius, along, across, contrast, background, blur = p[:8].tolist()
    return Circle(
        rough.x_px + x,
        rough.y_px + y,
        radius,
        radius_std_px=stds[0],
        centre_std_px=max(stds[1:3]),
        contrast=contrast,
        background=background,
        blur_px=float(np.sqrt(max(blur**2 - PIXEL_VARIANCE, 0.0))),
        arc=arc,
        misfit=misfit,
        ellipse_px=(along, across) if whole else (np.nan, np.nan),
        ellipse_std_px=max(stds[3:]) if whole else np.inf,
    )


@dataclass(frozen=True)
class Opening:
    """The rate at which a film opens, and the next best answer.

    Parameters
    ----------
    value : float, sqrt(m)
    rival : float, sqrt(m)
        An edge without film, or a film, where ``value`` is the other.
    doubt : float
        Probability of the rival against the value (Akaike's weight), at most 1/2.
    """

    value: float
    rival: float
    doubt: float


def choose_opening(samples: Sequence[EdgeSamples], model: EdgeModel) -> Opening:
    """Determine how fast the film around wide contacts opens, from their images alone.

    Parameters
    ----------
    samples : sequence of EdgeSamples
        Of one or several frames of the same bodies.
    model : EdgeModel

    Returns
    -------
    Opening
        The ``q`` (`contactimg.optics.wide_edge.film_opening`) of the best fit: 0 for Hertz's wide film,
        infinity if an edge without film fits as well as any.

    Notes
    -----
    Scanned on a logarithmic scale about the opening at which adhesion and curvature contribute alike to the
    first fringe, then refined; fringes make many local optima, hence the scan.
    """
    means = [_azimuthal_mean(one) for one in samples]

    def cost(opening: float, among: Sequence[EdgeSamples] = means) -> float:
        chi_square = 0.0
        for one in among:
            line, start = _start(one, model, opening, None)
            misfit = _fit(one, line, start, fixed=[0, 1, 3, 4], loss="cauchy")[1]
            chi_square += misfit**2 * len(one.value)
        return chi_square

    # adhesion contributes as much as curvature where the gap is a quarter wave
    gap, radius = model.excess.light.wavelength / 4, means[0].circle.radius_px * model.pixel_size
    curved = 8 * np.sqrt(2 * radius) / (3 * np.pi * model.sphere_radius)  # g = curved x^{3/2}
    scale = float(gap / 2 / (2 / np.pi * np.sqrt(2) * np.sqrt((gap / 2 / curved) ** (2 / 3))))
    logs = np.linspace(-2.0, 4.0, 19)  # powers of two times the natural opening
    best = int(np.argmin([cost(scale * 2.0**k, means[:1]) for k in logs]))
    bracket = (logs[max(best - 1, 0)], logs[min(best + 1, len(logs) - 1)])
    refined = optimize.minimize_scalar(
        lambda k: cost(scale * 2.0**k), bounds=bracket, method="bounded", options={"xatol": 0.02}
    )
    simple_cost, simple = min((cost(opening), opening) for opening in (0.0, np.inf))
    # a further parameter must reduce chi-square by 2: Akaike, doi:10.1109/TAC.1974.1100705
    free_cost, free = float(refined.fun) + 2.0, scale * 2.0 ** float(refined.x)
    (least, value), (more, rival) = sorted([(simple_cost, simple), (free_cost, free)])
    odds = float(np.exp(-0.5 * (more - least)))
    return Opening(value, rival, odds / (1 + odds))


def _azimuthal_mean(samples: EdgeSamples) -> EdgeSamples:
    """Samples averaged over all sectors ring by ring, without outliers."""
    ring = np.floor(samples.distance / RING_PX).astype(np.intp)
    ring -= ring.min()
    rings = pd.DataFrame({"ring": ring, "value": samples.value, "distance": samples.distance})
    rest = (rings["value"] - rings.groupby("ring")["value"].transform("median")).abs()
    spread = MAD_TO_STD * rest.groupby(ring).transform("median")
    kept = rings[rest <= CLIP_SIGMA * spread].groupby("ring")
    means, stds, count = kept.mean(), kept["value"].std(ddof=0), kept.size()
    there = count > SECTORS / 8
    variance = (stds**2 + float(np.median(stds[there])) ** 2) / count
    error = np.sqrt(variance[there].to_numpy())
    return replace(
        samples,
        azimuth=np.zeros(len(error)),
        distance=means.loc[there, "distance"].to_numpy(),
        value=means.loc[there, "value"].to_numpy(),
        weight=1 / np.maximum(error, LEAST_FRACTION * float(np.ptp(means["value"]))),
        sector=np.zeros(len(error), np.intp),
    )
