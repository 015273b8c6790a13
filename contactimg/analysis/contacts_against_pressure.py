"""Density and radius of the contacts against the local pressure, and the two power laws they follow."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from contactimg.analysis.annuli import sum_moments
from contactimg.analysis.broken_power_laws import BrokenLaw, fit_broken_law
from contactimg.analysis.estimates import Estimate, jackknife_covariance, student_estimate
from contactimg.analysis.radial_profiles import MIN_PLACES_FOR_SCATTER
from contactimg.errors import InputError

QUANTITIES = ("density", "mean_radius")


def pressure_points(moments: pd.DataFrame, *, min_contacts: float = 5) -> pd.DataFrame:
    """Pressure, density and mean radius of the contacts in annuli, with their counting errors.

    Parameters
    ----------
    moments : DataFrame
        From `annulus_moments` or `sum_moments`.
    min_contacts : float
        Annuli with fewer contacts are left out. Either choice has a bias: a low limit because logarithms of
        few contacts are biased, a high one because it selects annuli that have more contacts by chance. On
        simulated SA+ patterns (GW: 0.4 and 0.2) five give 0.380 and 0.210 for one place, 0.407 and 0.201 for
        four; ten give 0.373 and 0.212, 0.398 and 0.203.

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
    kept = moments[(moments["n"] >= min_contacts) & (moments["n_forces"] > 0) & (moments["area"] > 0)]
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
        Per load: name of the place -> its table of `annulus_moments`.
    quantity : {"density", "mean_radius"}
        Contacts per unit area, or mean contact radius.
    min_contacts : float
        As for `pressure_points`, of all places together.
    confidence : float
        Of the intervals.

    Returns
    -------
    BrokenLaw
        The annuli of all loads are its points. Where they do not support a break (`BrokenLaw.supported`) its
        ``single`` law is the one to read. With four places or more at every load the exponents'
        uncertainties come from leaving out one place at a time, which holds what the loads of one place have
        in common; with fewer they are those of independent contacts.

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
    law = _fit_pooled(loads, quantity, min_contacts, confidence)
    if min(len(places) for places in loads) < MIN_PLACES_FOR_SCATTER:
        return law
    names = sorted({name for places in loads for name in places})
    count = len(names)
    rests = [[{k: v for k, v in places.items() if k != name} for places in loads] for name in names]
    without = [_fit_pooled(rest, quantity, min_contacts, confidence) for rest in rests]

    def renewed(values: list[Estimate], whole: Estimate) -> Estimate:
        std = float(np.sqrt(jackknife_covariance([[value.value] for value in values])[0, 0]))
        return student_estimate(whole.value, std, freedom=count - 1, confidence=confidence)

    single = renewed([part.single.exponent for part in without], law.single.exponent)
    return replace(
        law,
        single=replace(law.single, exponent=single, n_places=count),
        low_exponent=renewed([part.low_exponent for part in without], law.low_exponent),
        high_exponent=renewed([part.high_exponent for part in without], law.high_exponent),
    )


def _fit_pooled(
    loads: Sequence[Mapping[str, pd.DataFrame]], quantity: str, min_contacts: float, confidence: float
) -> BrokenLaw:
    """The law of the annuli of all loads, each pooled over the places."""
    points = pd.concat(
        [pressure_points(sum_moments(places.values()), min_contacts=min_contacts) for places in loads],
        ignore_index=True,
    )
    return fit_broken_law(
        points["pressure"],
        points[quantity],
        x_std=points["pressure_std"],
        y_std=points[f"{quantity}_std"],
        correlation=points[f"{quantity}_correlation"],
        confidence=confidence,
    )
