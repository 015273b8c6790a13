"""Laws of contacts under a tangential load ``Q``: area, half-axes, static friction, an adhesive sphere.

`shear_contacts` applies them to the contacts of a model. The contact area of rubber shrinks as ``A = A0 -
alpha Q^2`` before it slides, and ``alpha = beta A0^(-3/2)`` from microcontacts to smooth spheres; both are
laws of measurement, and a fit of them tells no mechanism: adhesion (Papangelo and Ciavarella) and finite
deformation (Lengiewicz et al.) both give such a decrease.

References
----------
Sahli et al., PNAS 115 (2018) 471, doi:10.1073/pnas.1706434115. Sahli et al., Phys. Rev. Lett. 122 (2019)
214301, doi:10.1103/PhysRevLett.122.214301. Papangelo, Ciavarella, J. Mech. Phys. Solids 124 (2019) 159,
arXiv:1809.10676. Lengiewicz et al., J. Mech. Phys. Solids 143 (2020) 104056,
doi:10.1016/j.jmps.2020.104056.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.analysis.estimates import Estimate, student_estimate
from contactimg.analysis.linear_fit import Basis, Points, fit_line, fit_linear, fit_proportional
from contactimg.errors import ConvergenceError, InputError, ModelRangeError
from contactimg.mechanics.checks import checked_poisson_ratio, non_negative, positive
from contactimg.scene import Scene

Values = NDArray[np.float64]

EXPONENT = -1.5
"""Exponent of ``alpha`` over ``A0``, from experiments over four decades of area (Sahli et al. 2018)."""

MOST_STEPS, STEP_TOLERANCE = 60, 1e-9
"""Steps of the free exponent, and the step at which it has converged. Chosen: Gauss-Newton needs some ten."""

SEEN_SIGMA = 2.0
"""Standard uncertainties by which the decrease must differ from none for its exponent to be stated."""

LARGEST_STEP = 0.5
"""Largest change of the exponent in a step. Chosen: a fraction of any exponent to expect."""


@dataclass(frozen=True, eq=False)
class Decrease:
    """Parameters of ``y = y0 - k Q^2``, for an area or a half-axis.

    Parameters
    ----------
    start : Estimate
        Value without tangential load.
    rate : Estimate
        ``k``: ``alpha`` in m^2/N^2 of an area, in m/N^2 of a half-axis; below 0 where it grows.
    correlation : float
        Of the errors of both.
    scatter : float
        Standard deviation of y that the stated errors do not explain.
    n_points : int
    """

    start: Estimate
    rate: Estimate
    correlation: float
    scatter: float
    n_points: int


def fit_decrease(
    tangential: ArrayLike,
    values: ArrayLike,
    *,
    std: ArrayLike = 0.0,
    scatter: float | None = None,
    confidence: float = 0.95,
) -> Decrease:
    """Fit ``y = y0 - k Q^2`` to the area of a contact, to the sum of areas, or to a half-axis.

    Parameters
    ----------
    tangential : array_like, N
        Tangential load ``Q`` of each frame, two different magnitudes at least; its sign has no influence.
    values : array_like, m^2 or m
        Areas or half-axes.
    std : array_like
        Standard uncertainty of each value.
    scatter : float, optional
        Standard deviation of the values beyond the stated errors; default: estimated from the residuals.
    confidence : float
        Of the intervals: Student's, of one degree of freedom for each point beyond two.

    Returns
    -------
    Decrease
        Points with NaN are left out.

    Raises
    ------
    InputError
        If there are not two different magnitudes of the load.

    References
    ----------
    Sahli et al., PNAS 115 (2018) 471, doi:10.1073/pnas.1706434115.

    Examples
    --------
    >>> law = fit_decrease([0.0, 0.1, 0.2], [2.0e-8, 1.9e-8, 1.6e-8])
    >>> float(f"{law.start.value:.6g}"), float(f"{law.rate.value:.6g}")
    (2e-08, 1e-06)
    """
    load, value, error = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(v, float)) for v in (tangential, values, std))
    )
    known = np.isfinite(load) & np.isfinite(value) & np.isfinite(error)
    load, value, error = load[known], value[known], error[known]
    if np.unique(np.abs(load)).size < 2:
        raise InputError(
            "a law of the tangential load needs values at two or more different tangential loads, "
            f"got {np.unique(np.abs(load)).size}"
        )
    fit = fit_line(Points(-(load**2), value, y_std=error), scatter=scatter)
    start, rate = (fit.estimate(k, confidence=confidence) for k in (0, 1))
    correlation = float(fit.covariance[0, 1]) / max(start.std * rate.std, np.finfo(float).tiny)
    return Decrease(start, rate, correlation, fit.scatter, int(known.sum()))


@dataclass(frozen=True, eq=False)
class RateLaw:
    """``alpha = beta A0^(-3/2)`` over contacts, and the same with a free exponent.

    Parameters
    ----------
    beta : Estimate, m^5/N^2
        With the exponent -3/2.
    exponent : Estimate
        Where it is free; NaN if the contacts do not tell it.
    scatter : float, m^2/N^2
        Standard deviation of alpha beyond the stated errors, at the geometric mean of the areas; at others it
        is in proportion to the law with the exponent -3/2.
    n_points : int
    """

    beta: Estimate
    exponent: Estimate
    scatter: float
    n_points: int


def fit_rate_law(
    area: ArrayLike,
    rate: ArrayLike,
    *,
    area_std: ArrayLike = 0.0,
    rate_std: ArrayLike = 0.0,
    correlation: ArrayLike = 0.0,
    confidence: float = 0.95,
) -> RateLaw:
    """Fit ``alpha = beta A0^(-3/2)``, and the exponent, to contacts of different size.

    The fit is one of ``alpha`` itself, not of its logarithm: values below zero, as errors make them of small
    contacts, count as they are.

    Parameters
    ----------
    area, rate : array_like, m^2 and m^2/N^2
        ``A0`` and ``alpha`` of each contact, two or more; from `fit_decrease`.
    area_std, rate_std, correlation : array_like
        Standard uncertainties, and the correlation of both errors of a contact.
    confidence : float
        Of the intervals.

    Returns
    -------
    RateLaw

    Raises
    ------
    InputError
        If there are fewer than two contacts, or an area is not positive.

    References
    ----------
    Sahli et al., PNAS 115 (2018) 471, doi:10.1073/pnas.1706434115: exponent -3/2 over four decades of area.

    Examples
    --------
    >>> area = np.array([1e-9, 4e-9, 1e-8])
    >>> law = fit_rate_law(area, 2e-16 * area**-1.5)
    >>> float(f"{law.beta.value:.6g}"), round(law.exponent.value, 6)
    (2e-16, -1.5)
    """
    size = np.atleast_1d(positive("area", area, "m^2"))
    if size.size < 2:
        raise InputError(f"the law of alpha over contacts needs two contacts or more, got {size.size}")
    unit = float(np.exp(np.log(size).mean()))
    size, size_std = size / unit, np.asarray(area_std, float) / unit
    points = Points(size, rate, size_std, rate_std, correlation, spread=size**EXPONENT)
    fit, factor = fit_linear(_power_terms(EXPONENT), points), unit**-EXPONENT
    beta = fit.estimate(0, confidence=confidence)
    beta = Estimate(*(factor * part for part in (beta.value, beta.std, beta.low, beta.high)))
    return RateLaw(beta, _free_exponent(points, confidence), fit.scatter, size.size)


def _power_terms(exponent: float, *, free: bool = False) -> Basis:
    """The term ``x^m``, and with a free exponent also its derivative by m, ``x^m ln x``."""

    def terms(x: Values, order: int) -> Values:
        power = x**exponent
        first = exponent * power / x if order else power
        if not free:
            return first[..., None]
        return np.stack([first, first * np.log(x) + (power / x if order else 0.0)], -1)

    return terms


def _free_exponent(points: Points, confidence: float) -> Estimate:
    """The exponent m of ``y = b x^m``, by fits of ``b x^m + (b dm) x^m ln x``; NaN where none is seen."""
    unknown = Estimate(np.nan, np.nan, np.nan, np.nan)
    exponent = EXPONENT
    if np.ptp(np.asarray(points.x)) == 0:
        return unknown
    for _ in range(MOST_STEPS):
        try:
            fit = fit_linear(_power_terms(exponent, free=True), points)
        except ConvergenceError:
            return unknown
        amplitude, product = fit.parameters.tolist()
        step = product / amplitude if amplitude else np.inf
        exponent += float(np.clip(step, -LARGEST_STEP, LARGEST_STEP))
        if abs(step) < STEP_TOLERANCE:
            if not abs(amplitude) > SEEN_SIGMA * np.sqrt(fit.covariance[0, 0]):
                return unknown
            std = float(np.sqrt(fit.covariance[1, 1])) / abs(amplitude)
            return student_estimate(exponent, std, freedom=fit.freedom, confidence=confidence)
    return unknown


def static_friction(area: ArrayLike, *, rate: ArrayLike, strength: float) -> Values:
    """Tangential load at which a contact of ``A = A0 - alpha Q^2`` slides: ``Qs = sigma A(Qs)``.

        Qs = (-1 + sqrt(1 + 4 alpha sigma^2 A0))/(2 alpha sigma)
           = 2 sigma A0/(1 + sqrt(1 + 4 alpha sigma^2 A0)),

    the second form without cancellation, down to ``Qs = sigma A0`` of ``alpha = 0``.

    Parameters
    ----------
    area : array_like, m^2
        ``A0``, without tangential load.
    rate : array_like, m^2/N^2
        ``alpha``; below 0 if the contact grows.
    strength : float, Pa
        ``sigma``, friction force over contact area at the onset of sliding.

    Returns
    -------
    ndarray, N

    Raises
    ------
    InputError
        If the area is negative or the strength not positive.
    ModelRangeError
        If a contact grows so fast that it never slides.

    References
    ----------
    Sahli et al., PNAS 115 (2018) 471, doi:10.1073/pnas.1706434115.

    Examples
    --------
    >>> round(float(static_friction(1e-6, rate=0.0, strength=0.34e6)), 6)
    0.34
    >>> force = static_friction(1e-6, rate=2e-6, strength=0.34e6)
    >>> round(float(force / (1e-6 - 2e-6 * force**2)))
    340000
    """
    size, sigma = non_negative("area", area, "m^2"), positive("strength", strength, "Pa")
    square = 1 + 4 * np.asarray(rate, float) * sigma**2 * size
    if not np.all(square >= 0):
        raise ModelRangeError(
            "a contact that grows as fast as this one never slides: alpha must not be below "
            f"-1/(4 sigma^2 A0), got {float(np.min(np.asarray(rate, float))):.6g} m^2/N^2"
        )
    return 2 * sigma * size / (1 + np.sqrt(square))


def fit_strength(
    decrease: Decrease, static_friction: float, *, std: float = 0.0, confidence: float = 0.95
) -> Estimate:
    """Shear strength ``sigma = Qs/(A0 - alpha Qs^2)`` from a measured static friction force.

    Parameters
    ----------
    decrease : Decrease
        Of the area that carries the force.
    static_friction : float, N
        ``Qs``, the tangential load at the onset of sliding.
    std : float, N
        Its standard uncertainty.
    confidence : float
        Of the interval, that of a normal distribution.

    Returns
    -------
    Estimate, Pa
        Errors of `decrease` and of the force are taken as independent.

    Raises
    ------
    InputError
        If the force is not positive.
    ModelRangeError
        If no area is left at this force.

    Examples
    --------
    >>> law = fit_decrease([0.0, 0.1, 0.2], [1.0e-6, 0.98e-6, 0.92e-6])
    >>> round(fit_strength(law, 0.25).value)
    285714
    """
    force, force_std = positive("static_friction", static_friction, "N"), float(non_negative("std", std, "N"))
    area = decrease.start.value - decrease.rate.value * force**2
    if not area > 0:
        raise ModelRangeError(f"no contact area is left at a tangential load of {force:.6g} N")
    parts = np.array([-decrease.start.std, force**2 * decrease.rate.std]) / area
    mixed = 2 * decrease.correlation * float(parts.prod())
    from_force = force_std / force * (1 + 2 * decrease.rate.value * force**2 / area)
    relative = float(np.sqrt(max(float(parts @ parts) + mixed, 0.0) + from_force**2))
    sigma = force / area
    return student_estimate(sigma, sigma * relative, freedom=np.inf, confidence=confidence)


def half_axes_along(
    semi_major: ArrayLike, semi_minor: ArrayLike, angle: ArrayLike, *, direction: float
) -> tuple[Values, Values]:
    """Half-axes of ellipses along a direction and across it, by their second moments.

    ``a_along^2 = a^2 cos^2(t) + b^2 sin^2(t)`` with the angle ``t`` between direction and major axis: exact
    where the axes lie along and across, and without a jump where a nearly round contact has no clear axis.

    Parameters
    ----------
    semi_major, semi_minor : array_like
        Half-axes.
    angle : array_like, rad
        Of the major axis, NaN for a disk.
    direction : float, rad
        Of the tangential load, from the same axis.

    Returns
    -------
    along, across : ndarray

    Examples
    --------
    >>> along, across = half_axes_along([3.0], [2.0], [np.pi / 2], direction=0.0)
    >>> along.round(6).tolist(), across.round(6).tolist()
    ([2.0], [3.0])
    """
    major, minor, turn = (np.asarray(one, float) for one in (semi_major, semi_minor, angle))
    share = np.where(np.isnan(turn), 1.0, np.cos(turn - direction) ** 2)
    rest = 1 - share
    return np.sqrt(major**2 * share + minor**2 * rest), np.sqrt(major**2 * rest + minor**2 * share)


def local_friction(
    radius: ArrayLike, *, strength: Estimate, radius_std: ArrayLike = 0.0
) -> tuple[Values, Values]:
    """Friction force of each contact, ``q_i = tau0 pi a_i^2``, and its standard uncertainty.

    Parameters
    ----------
    radius : array_like, m
        Contact radii ``a_i``.
    strength : Estimate, Pa
        Shear stress ``tau0``, the same for all contacts; its error is common to all of them.
    radius_std : array_like, m

    Returns
    -------
    force, std : ndarray, N

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, eq. (4), applied to each contact.

    Examples
    --------
    >>> force, std = local_friction([20e-6], strength=Estimate(0.4e6, 0.01e6, 0.38e6, 0.42e6))
    >>> (1e6 * force).round(1).tolist(), (1e6 * std).round(1).tolist()
    ([502.7], [12.6])
    """
    a = non_negative("radius", radius, "m")
    own = strength.value * 2 * np.pi * a * np.asarray(radius_std, float)
    return strength.value * np.pi * a**2, np.hypot(own, strength.std * np.pi * a**2)


@dataclass(frozen=True)
class AdhesiveSphere:
    """An adhesive sphere under a normal and a tangential load, with weak coupling of the modes.

    The rim is in equilibrium where ``G_I + lambda G_T = w``, with the energy release rate of the normal mode,
    ``G_I = (P_H - P)^2/(8 pi E* a^3)``, and that of both shear modes, averaged along the rim, ``G_T = kappa
    T^2/(8 pi E* a^3)``; ``P_H = 4 E* a^3/(3 R)`` and ``kappa = (2 - nu)/(2 (1 - nu))``. Hence

        P_H = P + 3 pi w R + sqrt(6 pi w R P + (3 pi w R)^2 - lambda kappa T^2).

    Parameters
    ----------
    sphere_radius : float, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2
    poisson_ratio : float
    mode_coupling : float
        ``lambda``, 0 for JKR; 1 is the law of Savkoor and Briggs: contacts shrink far more than is observed.

    Notes
    -----
    An empirical law of one parameter: lambda is fitted, and by the authors who propose it perhaps not a
    property of the interface. A contact that follows the law does not prove its mechanism. The contact stays
    round, and no part of it slips.

    References
    ----------
    Papangelo, Ciavarella, J. Mech. Phys. Solids 124 (2019) 159, arXiv:1809.10676. Savkoor,
    Briggs, Proc. R. Soc. A 356 (1977) 103, doi:10.1098/rspa.1977.0123.

    Examples
    --------
    >>> sphere = AdhesiveSphere(9.42e-3, 2.1e6, 0.027, 0.5, mode_coupling=0.002)
    >>> round(float(sphere.radius(0.05, 0.0)) * 1e6, 1), round(float(sphere.radius(0.05, 0.2)) * 1e6, 1)
    (611.8, 598.1)
    """

    sphere_radius: float
    contact_modulus: float
    work_of_adhesion: float
    poisson_ratio: float
    mode_coupling: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (("sphere_radius", "m"), ("contact_modulus", "Pa"), ("work_of_adhesion", "J/m^2")):
            positive(name, getattr(self, name), unit)
        checked_poisson_ratio(self.poisson_ratio)
        non_negative("mode_coupling", self.mode_coupling, "")

    @property
    def kappa(self) -> float:
        """Tangential over normal energy release rate of equal forces, ``(2 - nu)/(2 (1 - nu))``."""
        return (2 - self.poisson_ratio) / (2 * (1 - self.poisson_ratio))

    @property
    def _scale(self) -> float:
        """The load ``3 pi w R``."""
        return 3 * np.pi * self.work_of_adhesion * self.sphere_radius

    def largest_tangential(self, load: ArrayLike) -> Values:
        """Tangential load (N) where the law ends: ``Tc^2 = [6 pi w R P + (3 pi w R)^2]/(lambda kappa)``.

        Infinite without coupling; NaN for a load below pull-off.
        """
        normal = 2 * self._scale * np.asarray(load, float) + self._scale**2
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(normal / (self.mode_coupling * self.kappa))

    def radius(self, load: ArrayLike, tangential: ArrayLike) -> Values:
        """Contact radius (m) under the loads P and T (N).

        Raises
        ------
        ModelRangeError
            If a tangential load lies beyond `largest_tangential`, or a load below pull-off.
        """
        P, T = np.asarray(load, float), np.asarray(tangential, float)
        bound = self._scale * (2 * P + self._scale)
        square = bound - self.mode_coupling * self.kappa * T**2
        if not np.all(square >= -1e-12 * np.abs(bound)):  # rounding at the end of the law
            raise ModelRangeError(
                f"no contact in equilibrium: the law ends at a tangential load of "
                f"{float(np.min(self.largest_tangential(P))):.6g} N (of pull-off below 0)"
            )
        hertz = P + self._scale + np.sqrt(np.maximum(square, 0.0))
        return np.cbrt(0.75 * self.sphere_radius / self.contact_modulus * hertz)

    def fit_mode_coupling(
        self, load: ArrayLike, tangential: ArrayLike, radius: ArrayLike, *, radius_std: ArrayLike = 0.0
    ) -> Estimate:
        """Fit lambda to measured radii: ``6 pi w R P_H - (P_H - P)^2 = lambda kappa T^2`` is linear in it.

        Parameters
        ----------
        load, tangential, radius : array_like, N, N and m
            Of each frame, some with a tangential load.
        radius_std : array_like, m

        Returns
        -------
        Estimate
            With a 95 % interval, given radius, modulus and work of adhesion of this sphere, whose errors it
            does not contain: take them from contacts without tangential load (`contactimg.calibrate_jkr`).
        """
        P, T, a, std = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(one, float)) for one in (load, tangential, radius, radius_std))
        )
        positive("radius", a, "m")
        hertz = 4 * self.contact_modulus * a**3 / (3 * self.sphere_radius)
        slope = (2 * self._scale - 2 * (hertz - P)) * 3 * hertz / a
        released = 2 * self._scale * hertz - (hertz - P) ** 2
        fit = fit_proportional(Points(self.kappa * T**2, released, y_std=np.abs(slope) * std))
        return fit.estimate(0)


def shear_contacts(contacts: pd.DataFrame, scene: Scene, *, tangential: float) -> pd.DataFrame:
    """The contacts of a scene under a tangential load.

    Contact i carries ``q_i = Q A_i/sum A``. Its half-axis along the load shrinks by the factor ``1 - beta
    A_i^(-5/2) q_i^2``, so that its area is ``A_i - beta A_i^(-3/2) q_i^2``; the one across stays. All
    contacts move by the same distance along the load.

    Parameters
    ----------
    contacts : DataFrame, contacts schema
        All contacts that carry the load, disks in m.
    scene : Scene
        ``[simulate] shear_beta_m5_N2, shear_compliance_m_N`` and ``[load] tangential_direction_deg``.
    tangential : float, N
        ``Q``; its sign is the sense of the displacement.

    Returns
    -------
    DataFrame, contacts schema
        Ellipses with their angle on the sample; contacts whose area vanishes are left out.

    Notes
    -----
    For frames of known contacts, not a model of the mechanics: forces and indentations stay those without
    tangential load.
    """
    simulate, direction = scene.need("simulate", "shearing contacts"), scene.load.tangential_direction
    area = contacts["area_m2"].to_numpy(float)
    share = area / area.sum() if area.sum() > 0 else area
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 1 - simulate.shear_beta * area ** (EXPONENT - 1) * (tangential * share) ** 2
    stays = ratio > 0
    radius, ratio = contacts["radius_m"].to_numpy(float)[stays], ratio[stays]
    step = simulate.shear_compliance * tangential
    sheared = contacts.loc[stays].assign(
        x_m=contacts["x_m"][stays] + step * np.cos(direction),
        y_m=contacts["y_m"][stays] + step * np.sin(direction),
        radius_m=radius * np.sqrt(ratio),
        area_m2=area[stays] * ratio,
    )
    if not (ratio < 1).any():
        return sheared
    return sheared.assign(
        shape="ellipse",
        semi_major_m=radius,
        semi_minor_m=radius * ratio,
        angle_rad=(direction + np.pi) % np.pi - np.pi / 2,  # across the load, from -pi/2 to pi/2
    )
