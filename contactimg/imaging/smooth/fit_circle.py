"""Fit the circle of a wide contact, to a hundredth of a pixel.

The light across the edge, air film included (`contactimg.optics.wide_edge`), is fitted to the means of the
image over sectors and rings. Free are centre, radius, contrast, background, blur and a wide halo. A Cauchy
loss reduces the weight of dust and scratches, and the scatter of the sectors gives the uncertainty of the
radius.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import fft, optimize, special

from contactimg.errors import FrameError
from contactimg.imaging.pixels.robust import MAD_TO_STD
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.smooth.find_circle import RING_PX, SECTORS, SHORTEST_ARC, Circle, EdgeSamples
from contactimg.optics.film import ExcessTable
from contactimg.optics.wide_edge import EdgeLight, edge_light

Values = NDArray[np.float64]

WIDEST_FILM_PX = 80.0
"""Width of the film up to which its fringes are sampled. Chosen by hand."""
OUTLIER_SIGMA = 3.0
"""Residual at which the Cauchy loss halves the weight of a sample, standard deviations."""
SCAN_OCTAVES = (-2.0, 4.0, 19)
"""Openings that are tried: first and last power of two times the natural opening, and how many."""
PARAMETER_COST = 2.0
"""Decrease of chi-square that a further parameter must bring. Theory: Akaike,
doi:10.1109/TAC.1974.1100705."""
PASSES = 2
"""Fits, the later ones without stray sectors."""
WIDEST_BLUR_PX = 20.0
"""Upper limit of the blur in the fit."""
HALO_START = (0.02, 5.0)
"""Fraction of the light in the halo, and width by which it exceeds the blur (px), from which the fit
starts."""
HALO_MOST, HALO_WIDTH_PX = 0.5, (2.0, 20.0)
"""Limits of the two in the fit."""
MODEL_ERROR = 1e-3
"""Of the contrast: error of the model through tables and straight edges."""
STRAY_SECTOR_SIGMA = 5.0
"""Robust standard deviations from the median beyond which a sector is left out. False-alarm rate 6e-7 a
sector (theory: normal errors)."""
ELLIPSE_PASSES, ELLIPSE_SIGMA, LEAST_ELLIPSE_PX = 5, 3.72, 0.02
"""Fits of an ellipse, each about the edge that the last one straightened; size in its standard deviations
from which it is no chance (theory: Rayleigh's law at a false-alarm rate of 1e-3); size that does no harm."""
ROBUST_ITERATIONS = 5
"""Iterations of the robust harmonics."""
ELLIPSE_ARC = 0.75
"""Fraction of the circumference from which on an ellipse is told from a shifted circle. Chosen by hand."""
LINE_STEP_PX = 0.1
"""Step of the light across the edge: linear interpolation of a line blurred by 1 px errs by 3e-4."""
FAR_PX = 60.0
"""Length on both sides of the film for the blur: three times the widest."""


@dataclass(frozen=True)
class EdgeModel:
    """What determines the light at the edge: pixel size, sphere and lamp.

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
        return edge_light(
            radius_px * self.pixel_size,
            sphere_radius=self.sphere_radius,
            opening=opening,
            excess=self.excess,
        )

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
        count = fft.next_fast_len(int((reach + 2 * FAR_PX) / LINE_STEP_PX), real=True)
        means = light.film_means(-FAR_PX * pixel_size, LINE_STEP_PX * pixel_size, count)
        return cls(np.asarray((np.arange(count) + 0.5) * LINE_STEP_PX - FAR_PX, float), fft.rfft(means))

    def blurred(self, outside: Values, blur: float) -> Values:
        """Light at distances outside the edge, px: a blurred step and the blurred film."""
        step = special.ndtr(-outside / blur)
        if not self.spectrum.any():
            return step
        frequency = fft.rfftfreq(len(self.grid), LINE_STEP_PX)
        film = fft.irfft(self.spectrum * np.exp(-2 * (np.pi * blur * frequency) ** 2), len(self.grid))
        return step + np.interp(outside, self.grid, film, left=0.0, right=0.0)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A circle, its numbers (shift, radius, contrast, background, blur, halo, its width) and its film."""

    circle: Circle
    numbers: Values
    line: _Line


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
    ellipse = np.zeros(2)
    for _ in range(ELLIPSE_PASSES):
        found, step = _fit_round(_straightened(samples, ellipse), model, opening, blur_px)
        if not np.hypot(*step) > max(ELLIPSE_SIGMA * found.ellipse_std_px, LEAST_ELLIPSE_PX):
            break
        ellipse = ellipse + step
    along, across = found.ellipse_px
    return replace(found, ellipse_px=(along + float(ellipse[0]), across + float(ellipse[1])))


def _straightened(samples: EdgeSamples, ellipse: Values) -> EdgeSamples:
    """The samples as they would lie about a circle if the edge is an ellipse."""
    excess = ellipse[0] * np.cos(2 * samples.azimuth) + ellipse[1] * np.sin(2 * samples.azimuth)
    return replace(samples, distance=samples.distance - excess)


def _fit_round(
    samples: EdgeSamples, model: EdgeModel, opening: float, blur_px: float | None
) -> tuple[Circle, Values]:
    """The circle, and the second harmonic of the edge about it, good for large ones as well."""
    used = np.ones(len(samples.value), bool)
    for _ in range(PASSES):
        kept = _subset(samples, used)
        _refuse_short(np.unique(kept.sector))
        fitted = _fit(kept, model, opening, blur_px)
        offsets, azimuths, numbers = _sector_offsets(kept, fitted)
        _refuse_short(numbers)
        spread = MAD_TO_STD * float(np.median(np.abs(offsets - np.median(offsets))))
        stray = np.abs(offsets - np.median(offsets)) > STRAY_SECTOR_SIGMA * max(spread, 1e-6)
        if not stray.any():
            break
        used &= ~np.isin(samples.sector, numbers[stray])
    found = _with_uncertainty(fitted.circle, offsets[~stray], azimuths[~stray])
    plain, azimuths, _ = _sector_offsets(samples, fitted, tame=False)
    return found, _second_harmonic(plain, azimuths) if found.arc > ELLIPSE_ARC else np.zeros(2)


def _refuse_short(sectors: NDArray[np.intp]) -> None:
    """Raise if too few sectors show the edge."""
    if len(sectors) < SHORTEST_ARC * SECTORS:
        raise FrameError(f"less than {SHORTEST_ARC:.0%} of the contact's edge can be used")


def _second_harmonic(offsets: Values, azimuths: Values) -> Values:
    """Cosine and sine part of the offsets of all sectors, without regard to outlying ones."""
    waves = [f(k * azimuths) for k in (1, 2) for f in (np.cos, np.sin)]
    design, weight = np.column_stack([np.ones(len(azimuths)), *waves]), np.ones(len(azimuths))
    for _ in range(ROBUST_ITERATIONS):
        root = np.sqrt(weight)
        numbers = np.linalg.lstsq(design * root[:, None], offsets * root, rcond=None)[0]
        rest = offsets - design @ numbers
        spread = MAD_TO_STD * float(np.median(np.abs(rest)))
        weight = 1 / (1 + (rest / max(OUTLIER_SIGMA * spread, 1e-6)) ** 2)
    return np.asarray(numbers[3:])


def _subset(samples: EdgeSamples, used: NDArray[np.bool_]) -> EdgeSamples:
    """Some of the samples."""
    names = ("azimuth", "distance", "value", "weight", "sector")
    return replace(samples, **{name: getattr(samples, name)[used] for name in names})


def _fit(
    samples: EdgeSamples, model: EdgeModel, opening: float, blur_px: float | None, *, centred: bool = False
) -> _Fitted:
    """Robust least squares for centre (unless centred), radius, contrast, background, blur and halo."""
    high, low = np.percentile(samples.value, [90, 10])
    if not high > low:
        raise FrameError("the light is the same on both sides of the contact's edge")
    blur = float(np.hypot(1.5 if blur_px is None else blur_px, PIXEL_VARIANCE**0.5))
    line, radius = _film_about(samples.outline_px, model, opening, blur)
    start = np.array([0.0, 0.0, radius, high - low, low, blur, *HALO_START])
    cos, sin = np.cos(samples.azimuth), np.sin(samples.azimuth)
    free = slice(2 if centred else 0, None)

    def residuals(moved: Values) -> Values:
        p = np.append(start[: free.start], moved)
        outside = samples.distance - p[0] * cos - p[1] * sin - p[2]
        return samples.weight * (_profile(outside, p, line) - samples.value)

    unbound = np.full(5, np.inf)
    lowest = np.array(
        [*-unbound[:2], 0.5 * radius, *-unbound[:2], PIXEL_VARIANCE**0.5, 0.0, HALO_WIDTH_PX[0]]
    )
    highest = np.array([*unbound, WIDEST_BLUR_PX, HALO_MOST, HALO_WIDTH_PX[1]])
    start = np.clip(start, lowest, highest)
    fit = optimize.least_squares(
        residuals,
        start[free],
        bounds=(lowest[free], highest[free]),
        loss="cauchy",
        f_scale=OUTLIER_SIGMA,
        x_scale=[1.0, 1.0, 1.0, high - low, high - low, 1.0, 0.1, 2.0][free],
        xtol=1e-7,
        ftol=1e-7,
        max_nfev=50,
    )
    p = np.append(start[: free.start], fit.x)
    misfit = float(np.sqrt(2 * fit.cost / max(len(samples.value) - len(fit.x), 1)))
    return _Fitted(_fitted_circle(samples.circle, p, misfit), p, line)


def _fitted_circle(rough: Circle, p: Values, misfit: float) -> Circle:
    """The circle of the fitted numbers, which are relative to the centre of the rough one."""
    return replace(
        rough,
        x_px=rough.x_px + float(p[0]),
        y_px=rough.y_px + float(p[1]),
        radius_px=float(p[2]),
        contrast=float(p[3]),
        background=float(p[4]),
        blur_px=float(np.sqrt(max(p[5] ** 2 - PIXEL_VARIANCE, 0.0))),
        misfit=misfit,
    )


def _film_about(outline_px: float, model: EdgeModel, opening: float, blur: float) -> tuple[_Line, float]:
    """The film's light and the radius of the contact whose outline at half contrast is given, px."""
    radius = outline_px
    for _ in range(2):  # a radius 5 % too large makes a gap 2 % too wide, and that a radius good to 0.1 %
        line = _Line.of(model.light(radius, opening), model.pixel_size)
        grid = line.grid[line.grid > -3 * blur]
        radius = outline_px - float(grid[(line.blurred(grid, blur) < 0.5).argmax()])
    return line, radius


def _profile(outside: Values, p: Values, line: _Line) -> Values:
    """Grey level at distances outside the edge, blurred by a core and a wide halo.

    A round edge lies inside a straight one by ``blur^2/(2 a)`` at half its height.
    """
    _, _, radius, contrast, background, blur, halo, width = p
    wide = float(np.hypot(blur, width))
    core_light = line.blurred(outside + blur**2 / (2 * radius), blur)
    halo_light = line.blurred(outside + wide**2 / (2 * radius), wide)
    return background + contrast * ((1 - halo) * core_light + halo * halo_light)


def _sector_offsets(
    samples: EdgeSamples, fitted: _Fitted, *, tame: bool = True
) -> tuple[Values, Values, NDArray[np.intp]]:
    """How far the edge lies outside the circle in each sector that shows it, its direction and its number.

    ``tame`` gives samples far off less weight: dust, but also an edge that lies a blur away.
    """
    p, line = fitted.numbers, fitted.line
    outside = samples.distance - p[0] * np.cos(samples.azimuth) - p[1] * np.sin(samples.azimuth) - p[2]
    rest = samples.weight * (samples.value - _profile(outside, p, line))
    step = 0.1 * p[5]
    fall = (_profile(outside - step, p, line) - _profile(outside + step, p, line)) * (
        samples.weight / (2 * step)
    )
    trust = 1 / (1 + (rest / OUTLIER_SIGMA) ** 2) if tame else np.ones_like(rest)
    numbers, inverse = np.unique(samples.sector, return_inverse=True)
    slope = np.bincount(inverse, trust * fall**2)
    shown = slope > 0  # not where all samples lie far from the edge
    offset = np.bincount(inverse, trust * fall * rest)[shown] / slope[shown]
    azimuth = (np.bincount(inverse, samples.azimuth) / np.bincount(inverse))[shown]
    return offset, azimuth, numbers[shown]


def _with_uncertainty(found: Circle, offsets: Values, azimuths: Values) -> Circle:
    """The circle with the uncertainties that the scatter of its sectors implies."""
    waves = [f(k * azimuths) for k in (1, 2) for f in (np.cos, np.sin)]
    design = np.column_stack([np.ones(len(azimuths)), *waves])
    arc = len(offsets) / SECTORS
    # of a short arc an ellipse cannot be told from a shift: the circle's three numbers only
    design = design if arc > ELLIPSE_ARC else design[:, :3]
    numbers = np.linalg.lstsq(design, offsets, rcond=None)[0]
    rest = offsets - design @ numbers
    variance = float(rest @ rest) / max(len(rest) - len(numbers), 1)
    spread = variance * np.diag(np.linalg.inv(design.T @ design))
    found = replace(
        found,
        radius_std_px=float(np.sqrt(spread[0])),
        centre_std_px=float(np.sqrt(max(spread[1], spread[2]))),
        arc=arc,
    )
    if arc <= ELLIPSE_ARC:
        return found
    ellipse = (float(numbers[3]), float(numbers[4]))
    return replace(found, ellipse_px=ellipse, ellipse_std_px=float(np.sqrt(max(spread[3], spread[4]))))


@dataclass(frozen=True)
class Opening:
    """How fast a film opens, and the next best answer.

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
        return sum(
            _fit(one, model, opening, None, centred=True).circle.misfit ** 2 * len(one.value) for one in among
        )

    scale = _natural_opening(means[0].circle.radius_px * model.pixel_size, model)
    logs = np.linspace(*SCAN_OCTAVES)
    best = int(np.argmin([cost(scale * 2.0**k, means[:1]) for k in logs]))
    bracket = (logs[max(best - 1, 0)], logs[min(best + 1, len(logs) - 1)])
    refined = optimize.minimize_scalar(
        lambda k: cost(scale * 2.0**k), bounds=bracket, method="bounded", options={"xatol": 0.02}
    )
    simple_cost, simple = min((cost(opening), opening) for opening in (0.0, np.inf))
    # a further parameter must reduce chi-square by more than its cost
    free_cost, free = float(refined.fun) + PARAMETER_COST, scale * 2.0 ** float(refined.x)
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
    kept = rings[rest <= OUTLIER_SIGMA * spread].groupby("ring")
    means, stds, count = kept.mean(), kept["value"].std(ddof=0), kept.size()
    there = count > SECTORS / 8
    variance = (stds**2 + float(np.median(stds[there])) ** 2) / count
    error = np.sqrt(variance[there].to_numpy())
    return replace(
        samples,
        azimuth=np.zeros(len(error)),
        distance=means.loc[there, "distance"].to_numpy(),
        value=means.loc[there, "value"].to_numpy(),
        weight=1 / np.maximum(error, MODEL_ERROR * float(np.ptp(means["value"]))),
        sector=np.zeros(len(error), np.intp),
    )


def _natural_opening(radius: float, model: EdgeModel) -> float:
    """Opening at which adhesion contributes as much as curvature where the gap is a quarter wave."""
    gap = model.excess.light.wavelength / 4
    curved = 8 * np.sqrt(2 * radius) / (3 * np.pi * model.sphere_radius)  # g = curved x^{3/2}
    return float(gap / 2 / (2 / np.pi * np.sqrt(2) * np.sqrt((gap / 2 / curved) ** (2 / 3))))
