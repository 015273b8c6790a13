"""Density and radius of the contacts against the local pressure, and the two power laws they follow."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.analysis.annuli import density_beside, sum_moments
from contactimg.analysis.broken_power_laws import BrokenLaw, fit_broken_law
from contactimg.analysis.estimates import (
    Estimate,
    jackknife_covariance,
    of_another_surface,
    student_estimate,
)
from contactimg.analysis.power_laws import PowerLaw, fit_power_law
from contactimg.analysis.pressure_exponents import fit_pressure_exponent
from contactimg.analysis.radial_profiles import MIN_PLACES_FOR_SCATTER
from contactimg.errors import InputError

Law = TypeVar("Law", PowerLaw, BrokenLaw)

Values = NDArray[np.float64]

QUANTITIES = ("density", "mean_radius")
_ERRORS = ("pressure", *QUANTITIES)

EXPECTED_COUNT_PASSES = 2
"""Times that the numbers of contacts to expect are fitted. Measured: a third changes no exponent by a tenth
of its uncertainty."""


def pressure_points(
    moments: pd.DataFrame, *, min_contacts: float = 5, by_those_beside: bool = False
) -> pd.DataFrame:
    """Pressure, density and mean radius of the contacts in annuli, with their counting errors.

    Parameters
    ----------
    moments : DataFrame
        From `annulus_moments` in one sector, or from `sum_moments`: one row an annulus, from the centre on.
    min_contacts : float
        Annuli with fewer contacts are left out.
    by_those_beside : bool
        Leave out an annulus if those beside it let expect fewer contacts in it, whatever its own number is:
        the own number selects annuli that have more contacts by chance.

    Returns
    -------
    DataFrame
        One row an annulus that is kept: ``r`` (m), ``n``, ``pressure`` (Pa), ``density`` (1/m^2),
        ``mean_radius`` (m), their ``_std`` and the correlations ``density_correlation`` and
        ``mean_radius_correlation`` with the pressure.

    Notes
    -----
    The contacts of an annulus are taken as independent draws of ``(a, p)`` with a Poisson number: relative
    variances ``1/n`` (density), ``sum p^2/(sum p)^2`` (pressure), ``sum a^2/(sum a)^2 - 1/n`` (radius), and
    covariances with the pressure ``1/n`` and ``sum a p/(sum a sum p) - 1/n``.
    """
    decisive = moments["n"].to_numpy(float)
    if by_those_beside:
        area = moments["area"].to_numpy(float)
        decisive = density_beside(decisive, area) * area
    kept = moments[(decisive >= min_contacts) & (moments["n_forces"] > 0) & (moments["area"] > 0)]
    n, a, p, area = (kept[name].to_numpy(float) for name in ("n", "a", "p", "area"))
    p_variance = kept["pp"].to_numpy(float) / p**2
    a_variance = np.maximum(kept["aa"].to_numpy(float) / a**2 - 1 / n, 0.0)
    mixed = kept["ap"].to_numpy(float) / (a * p) - 1 / n
    product = np.sqrt(a_variance * p_variance)
    return pd.DataFrame(
        {
            "r": (kept["inner"] + kept["outer"]).to_numpy(float) / 2,
            "n": n,
            "pressure": p / area,
            "density": n / area,
            "mean_radius": a / n,
            "pressure_std": p / area * np.sqrt(p_variance),
            "density_std": n / area / np.sqrt(n),
            "mean_radius_std": a / n * np.sqrt(a_variance),
            "density_correlation": np.clip(1 / np.sqrt(n * p_variance), -1.0, 1.0),
            "mean_radius_correlation": np.clip(mixed / np.where(product > 0, product, np.inf), -1.0, 1.0),
        }
    )


def fit_contact_law(
    loads: Sequence[Mapping[str, pd.DataFrame]],
    quantity: str,
    *,
    min_contacts: float = 5,
    confidence: float = 0.95,
) -> BrokenLaw:
    """Fit two power laws of a quantity against the local pressure, which meet at a pressure p*.

    Parameters
    ----------
    loads : sequence of mapping
        Per load: name of the place -> its table of `annulus_moments`, in sectors for fewer than four places.
    quantity : {"density", "mean_radius"}
        Contacts per unit area, or mean contact radius.
    min_contacts : float
        Fewest contacts, of all places together, that the annuli beside an annulus let expect in it.
    confidence : float
        Of the intervals.

    Returns
    -------
    BrokenLaw
        The annuli of all loads are its points. Where they do not support a break (`BrokenLaw.supported`) its
        ``single`` law is the one to read: exponent and amplitude of
        `contactimg.analysis.pressure_exponents.fit_pressure_exponent`, the rest that of the least-squares
        line. Intervals hold the exponent of this surface, whatever its places; ``single.another_surface`` the
        one of another surface of the same kind at as many places. The exponents below and above a break have
        uncertainties by leaving out one place at a time; of fewer than four places, one sector of a place.
        All loads of a place are left out together. Of tables that are not in sectors, and where a place
        without a sector has too few annuli, uncertainties are those of independent contacts.

    Raises
    ------
    InputError
        If there is no such quantity, no load, or there are too few annuli with contacts.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Fig. 7 and Appendix B: 2/5 and 1/5 for
    uniform heights.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"quantity must be one of {', '.join(map(repr, QUANTITIES))}, got {quantity!r}")
    if not loads:
        raise InputError("a contact law needs at least one load")
    law = _fit(fit_broken_law, _pooled_points(loads, min_contacts), quantity, confidence)
    law = replace(law, single=_single_law(law.single, loads, quantity, min_contacts))
    rests = _without_one_place(loads) or _without_one_sector(loads)
    if not (law.supported and rests):
        return law
    try:
        points = [_pooled_points(rest, min_contacts * (1 - 1 / len(rests))) for rest in rests]
        return _left_out(law, points, quantity, confidence)
    except InputError:
        return law


def _single_law(
    line: PowerLaw, loads: Sequence[Mapping[str, pd.DataFrame]], quantity: str, min_contacts: float
) -> PowerLaw:
    """The one power law without the bias of least squares; places or sectors tell its uncertainty."""
    found = fit_pressure_exponent(
        loads,
        quantity,
        reference=line.reference,
        min_contacts=min_contacts,
        confidence=line.confidence,
    )
    exponent, amplitude = found.exponent, found.amplitude
    if not np.isfinite(exponent.std):
        exponent, amplitude = (
            _moved(own, new.value)
            for own, new in zip((line.exponent, line.amplitude), (exponent, amplitude), strict=True)
        )
    fewest = min(len(places) for places in loads)
    return replace(
        line,
        exponent=exponent,
        amplitude=amplitude,
        n_places=found.n_blocks if fewest >= MIN_PLACES_FOR_SCATTER else 1,
        another_surface=of_another_surface(exponent),
    )


def _moved(estimate: Estimate, value: float) -> Estimate:
    """The estimate with its interval about another value."""
    away = value - estimate.value
    return Estimate(value, estimate.std, estimate.low + away, estimate.high + away)


Rests = list[list[dict[str, pd.DataFrame]]]


def _without_one_place(loads: Sequence[Mapping[str, pd.DataFrame]]) -> Rests:
    """The loads without each of the places in turn; empty for few places."""
    if min(len(places) for places in loads) < MIN_PLACES_FOR_SCATTER:
        return []
    names = sorted({name for places in loads for name in places})
    whole = [{name: sum_moments([table]) for name, table in places.items()} for places in loads]
    return [[{k: v for k, v in places.items() if k != name} for places in whole] for name in names]


def _without_one_sector(loads: Sequence[Mapping[str, pd.DataFrame]]) -> Rests:
    """The loads without each sector of each place in turn; empty if the tables are not in sectors."""
    tables = [(name, table) for places in loads for name, table in places.items() if "sector" in table]
    blocks = sorted({(name, int(k)) for name, table in tables for k in table["sector"].unique()})
    if len(blocks) < MIN_PLACES_FOR_SCATTER:
        return []
    return [
        [{k: v[v["sector"] != sector] if k == name else v for k, v in places.items()} for places in loads]
        for name, sector in blocks
    ]


def _left_out(law: BrokenLaw, rests: list[pd.DataFrame], quantity: str, confidence: float) -> BrokenLaw:
    """Exponents about a break with uncertainties from the remaining points, one block left out at a time."""

    def renewed(whole: Estimate, values: list[Estimate]) -> Estimate:
        std = float(np.sqrt(jackknife_covariance([[value.value] for value in values])[0, 0]))
        return student_estimate(whole.value, std, freedom=len(values) - 1, confidence=confidence)

    parts = [_fit(fit_broken_law, points, quantity, confidence) for points in rests]
    return replace(
        law,
        low_exponent=renewed(law.low_exponent, [part.low_exponent for part in parts]),
        high_exponent=renewed(law.high_exponent, [part.high_exponent for part in parts]),
    )


def _pooled_points(loads: Sequence[Mapping[str, pd.DataFrame]], min_contacts: float) -> pd.DataFrame:
    """The annuli of all loads, each pooled over the places."""
    return pd.concat(
        [
            pressure_points(sum_moments(places.values()), min_contacts=min_contacts, by_those_beside=True)
            for places in loads
        ],
        ignore_index=True,
    )


def _fit(law: Callable[..., Law], points: pd.DataFrame, quantity: str, confidence: float) -> Law:
    """One or two power laws of a quantity, with the errors of both axes."""
    expected = points
    for _ in range(EXPECTED_COUNT_PASSES):
        counted = _fit_axes(fit_power_law, expected, "density", confidence)
        expected = _with_expected_errors(points, counted.value(points["pressure"]))
    return _fit_axes(law, expected, quantity, confidence)


def _fit_axes(law: Callable[..., Law], points: pd.DataFrame, quantity: str, confidence: float) -> Law:
    return law(
        points["pressure"],
        points[quantity],
        x_std=points["pressure_std"],
        y_std=points[f"{quantity}_std"],
        correlation=points[f"{quantity}_correlation"],
        confidence=confidence,
    )


def _with_expected_errors(points: pd.DataFrame, density: Values) -> pd.DataFrame:
    """The points with the counting errors of the contacts that a density (1/m^2) lets expect.

    With those of the contacts that were counted, an annulus that has more by chance would weigh more than one
    that has fewer, and exponents of one place would be too small by up to a stated uncertainty. The scatter
    from contact to contact is that of all annuli.
    """
    n = points["n"].to_numpy(float)
    expected = n / points["density"].to_numpy(float) * density

    def per_contact(variance: Values) -> float:
        return float(np.sum(n**2 * variance) / np.sum(n))

    relative = {name: (points[f"{name}_std"] / points[name]).to_numpy(float) for name in _ERRORS}
    variance = {name: per_contact(value**2) for name, value in relative.items()}
    renewed = {f"{name}_std": points[name] * np.sqrt(variance[name] / expected) for name in _ERRORS}
    for name in QUANTITIES:
        product = relative["pressure"] * relative[name] * points[f"{name}_correlation"].to_numpy(float)
        scale = np.sqrt(variance["pressure"] * variance[name])
        correlation = per_contact(product) / scale if scale > 0 else 0.0
        renewed[f"{name}_correlation"] = np.full(n.size, np.clip(correlation, -1.0, 1.0))
    return points.assign(**renewed)
