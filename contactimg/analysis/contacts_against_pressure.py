"""Density and radius of the contacts against the local pressure: their power laws, free of common errors.

Number and load of an annulus fluctuate together, less than those of independent contacts, and by how much
depends on the surface: least squares with errors on both axes would need these covariances. The pressure of
the annuli beside an annulus is known without its own contacts. With that as the instrument the errors of an
annulus cancel on the average, whatever their covariance.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from contactimg.analysis.annuli import MIN_PLACES_FOR_SCATTER, MOMENTS, density_beside
from contactimg.analysis.estimates import Estimate, bootstrap_estimates, bootstrap_std, bootstrap_weights
from contactimg.analysis.linear_fit import Basis, line, solve_moments, two_lines
from contactimg.analysis.power_laws import BrokenLaw, PowerLaw, break_places, broken_law, exponential
from contactimg.errors import InputError

Values = NDArray[np.float64]
Tables = Mapping[str, pd.DataFrame]

QUANTITIES = ("density", "mean_radius")

SUMS = ("area", "n", "n_forces", "a", "p")


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
    area, n, _, a, aa, p, pp, ap = (kept[name].to_numpy(float) for name in MOMENTS)
    p_variance, a_variance = pp / p**2, np.maximum(aa / a**2 - 1 / n, 0.0)
    mixed, product = ap / (a * p) - 1 / n, np.sqrt(a_variance * p_variance)
    columns = {
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
    return pd.DataFrame(columns)


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
        ``single`` law is the one to read. Intervals hold the exponent of this surface, whatever its places.
        Without four places, or sectors of places, nothing tells the uncertainty, and no break is supported.

    Raises
    ------
    InputError
        If there is no such quantity, no load, there are too few annuli with contacts, or their pressures do
        not follow those beside them.

    Notes
    -----
    ``m = sum w (z - <z>) y / sum w (z - <z>) x`` with ``x = ln p``, ``y`` the logarithm of the quantity,
    ``z`` that of the pressure beside (`contactimg.analysis.annuli.density_beside`) and ``w`` the square of
    the number of contacts that the annuli beside let expect. Two laws that meet have the terms of two lines
    in place of that of one; p* is where the weighted squares of the residuals are least. The uncertainties
    are those of a bootstrap over places, or over sectors of fewer than four: all loads of a block change
    their weight together, as the same asperities touch. A break is supported where the difference of the two
    exponents over its standard deviation exceeds what chance gives at any of the breaks tried (Davies).

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Fig. 7 and Appendix B: 2/5 and 1/5 for
    uniform heights; Durbin, Rev. Int. Stat. Inst. 22 (1954) 23, doi:10.2307/1401917, section 4: instrumental
    variables where both axes have errors.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"quantity must be one of {', '.join(map(repr, QUANTITIES))}, got {quantity!r}")
    if not loads:
        raise InputError("a contact law needs at least one load")
    by_place = min(len(places) for places in loads) >= MIN_PLACES_FOR_SCATTER
    tables, blocks = _sums_of_blocks(loads, by_place=by_place)
    weights, known = np.ones((1, blocks)), blocks >= MIN_PLACES_FOR_SCATTER
    if known:
        weights = np.concatenate([weights, bootstrap_weights(blocks)])
    rows = _coordinates([weights @ table for table in tables], quantity, min_contacts)
    x, y, z, w = rows[:, 0]
    if x.size < 2 or not w @ ((z - w @ z / w.sum()) * x) > 0:
        raise InputError(
            "an exponent against the pressure needs annuli of different pressure beside others with enough "
            f"contacts, got {x.size} of them; allow fewer contacts or wider annuli"
        )
    low, reference, high = (float(np.exp(value)) for value in (x.min(), x.mean(), x.max()))
    rows[[0, 2]] -= np.log(reference)
    lines = _fitted(line, rows)
    scatter = float(np.sqrt(np.average((y - line(x, 0) @ lines[0]) ** 2, weights=w)))
    offset, exponent = (Estimate(float(value), np.nan, -np.inf, np.inf) for value in lines[0])
    if known:
        offset, exponent = bootstrap_estimates(lines[0], lines[1:], blocks=blocks, confidence=confidence)
    amplitude, places = exponential(offset), blocks if by_place else 1
    single = PowerLaw(exponent, amplitude, reference, low, high, scatter, x.size, places, confidence)
    # Chosen: 200 replicates know the interval of a break to 7 %, in a fifth of a second.
    return _broken(single, rows[:, :201], blocks) if known else _unbroken(single)


def _unbroken(single: PowerLaw) -> BrokenLaw:
    """A law of which nothing tells whether it breaks."""
    anywhere = Estimate(single.reference, np.nan, 0.0, np.inf)
    return BrokenLaw(single.exponent, single.exponent, anywhere, single.amplitude.value, single, 1.0)


def _broken(single: PowerLaw, rows: Values, blocks: int) -> BrokenLaw:
    """Two laws that meet; the first row of coordinates is that of the whole, the others the replicates."""
    try:
        breaks = break_places(rows[0, 0])
    except InputError:
        return _unbroken(single)
    ends = np.sort(rows[[0, 2]], axis=-1)  # both laws need points in every row
    breaks = breaks[(breaks > ends[..., 1].max()) & (breaks < ends[..., -2].min())]
    if breaks.size < 2:
        return _unbroken(single)
    fits, (x, y, _, w) = np.array([_fitted(two_lines(place), rows) for place in breaks]), rows
    laws = [(two_lines(u)(x, 0) @ fit[..., None])[..., 0] for u, fit in zip(breaks, fits, strict=True)]
    best = np.argmin([np.sum(w * (y - law) ** 2, axis=-1) for law in laws], axis=0)
    chosen = np.column_stack([fits[best, np.arange(len(best))], breaks[best]])  # height, slopes and place
    lines = bootstrap_estimates(chosen[0, 1:], chosen[1:, 1:], blocks=blocks, confidence=single.confidence)
    # chi-square of the difference of the exponents at each break, as if its spread were known
    difference, tiny = fits[..., 1] - fits[..., 2], np.finfo(float).tiny
    spread = bootstrap_std(difference[:, 1:], blocks=blocks)
    tail = special.stdtr(blocks - 1, -np.abs(difference[:, 0]) / np.maximum(spread, tiny))
    gain = np.asarray(special.ndtri(np.maximum(tail, tiny)) ** 2)
    return broken_law(single, lines, gain, breaks, level=float(chosen[0, 0]))


def _sums_of_blocks(loads: Sequence[Tables], *, by_place: bool) -> tuple[list[Values], int]:
    """Sums over the annuli of each block at each load, shape (sums, blocks, annuli); number of blocks."""
    named = [(k, *place) for k, places in enumerate(loads) for place in places.items()]
    together = pd.concat([table.assign(load=k, block=name) for k, name, table in named], ignore_index=True)
    if not by_place and "sector" in together:
        together["block"] += ":" + together["sector"].astype(str)
    blocks = np.unique(together["block"].to_numpy(str))
    cells, tables = pd.MultiIndex.from_product([SUMS, blocks]), []
    for _, part in together.groupby("load", sort=True):
        table = part.pivot_table(list(SUMS), ["inner", "outer"], "block", aggfunc="sum")
        sums = table.reindex(columns=cells).fillna(0.0).to_numpy().T
        tables.append(sums.reshape(len(SUMS), len(blocks), -1))
    return tables, len(blocks)


def _coordinates(sums: Sequence[Values], quantity: str, min_contacts: float) -> Values:
    """Logarithms of pressure, quantity and pressure beside; weights; shape (4, rows, annuli of all loads).

    Of the annuli whose neighbours in the first row let expect enough contacts.
    """
    columns = []
    for area, n, n_forces, a, p in sums:
        expected, beside = density_beside(n, area) * area, density_beside(p, area)
        kept = ((expected >= min_contacts) & (n_forces > 0) & (p > 0) & (area > 0) & (beside > 0))[0]
        over, under = (n, area) if quantity == "density" else (a, n)
        quotients = [p[:, kept] / area[:, kept], over[:, kept] / under[:, kept], beside[:, kept]]
        # Theory: the power 1 has the least variance if the law is a power law. Chosen: laws of Gaussian
        # heights are curved, and with 1 the outermost annuli, far away in ln p, decide by chance; with 2 the
        # exponent of one place and that of 24 agree to 0.001 (RA-) and 0.009 (RA+) instead of 0.015 and
        # 0.035, for 5 % more scatter.
        columns.append([*np.log(quotients), expected[:, kept] ** 2])
    return np.concatenate(columns, axis=-1)


def _fitted(basis: Basis, coordinates: Values) -> Values:
    """Parameters of each row of coordinates, with the pressure beside as the instrument."""
    x, y, z, w = coordinates
    return solve_moments(basis(z, 0), basis(x, 0), y, w / w.sum(axis=-1, keepdims=True))
