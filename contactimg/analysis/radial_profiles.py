"""Profiles: pressure, density and radius of the contacts against the distance from the centre."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import special

from contactimg.analysis.annuli import MIN_PLACES_FOR_SCATTER, FieldOfView, annulus_moments, sum_moments
from contactimg.analysis.estimates import COVERAGE, NORMAL_95
from contactimg.errors import InputError
from contactimg.mechanics import hertz
from contactimg.tables import NORMALISED, PROFILE

Values = NDArray[np.float64]

TAIL = (1 - COVERAGE) / 2
"""Probability on either side of an interval."""


def radial_profile(
    contacts: pd.DataFrame,
    *,
    centre: tuple[float, float],
    edges: ArrayLike,
    frame: str,
    model: str,
    field: FieldOfView | None = None,
) -> pd.DataFrame:
    """Average the contacts of one frame over annuli.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table of one frame with ``x_m, y_m, radius_m, force_N``.
    centre : (float, float)
        Centre of the apparent contact, sample coordinates, m.
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    frame, model : str
        Entered in the columns of that name.
    field : FieldOfView, optional
        What the camera sees: an annulus counts as far as it lies in the image. Default: everything.

    Returns
    -------
    DataFrame
        Profile table, one row an annulus: see `average_profile`.

    Raises
    ------
    InputError
        If the edges do not increase.

    Examples
    --------
    >>> import pandas as pd
    >>> one = pd.DataFrame({"x_m": [1e-4], "y_m": [0.0], "radius_m": [1e-5], "force_N": [1e-3]})
    >>> profile = radial_profile(one, centre=(0.0, 0.0), edges=[0.0, 2.5e-4], frame="f", model="measured")
    >>> round(float(profile["pressure_Pa"].iloc[0]))  # 1 mN over pi (0.25 mm)^2
    5093
    """
    moments = annulus_moments(contacts, centre=centre, edges=edges, field=field)
    return average_profile([moments], frame=frame, model=model)


def average_profile(places: Sequence[pd.DataFrame], *, frame: str, model: str) -> pd.DataFrame:
    """Average annuli over places.

    Parameters
    ----------
    places : sequence of DataFrame
        One table of `annulus_moments` a place, all with the same edges; one at least.
    frame, model : str
        Entered in the columns of that name.

    Returns
    -------
    DataFrame
        Profile table, one row an annulus, ``r_m`` its middle. Sums over all places are divided by the area
        that was seen in all of them. An annulus seen without contacts has zero pressure, density and area
        fraction, and an empty mean radius; one that was not seen is empty; the pressure is empty where
        contacts have no force. ``pressure_std_Pa`` is the standard error of the mean: from four places on by
        their scatter, below that by that of their sectors, and of fewer than four of these what independent
        contacts give, ``sqrt(sum p_i^2)/area``; of an annulus without contacts that of an upper limit, at
        95 % three contacts with the mean force of the nearest.
        ``pressure_low_Pa`` and ``pressure_high_Pa`` bound the 95 % interval, which is not symmetric: that of
        `weighted_count_interval`, in which the contact missed by chance is the heaviest of the annulus and
        the nearest with contacts; a variance from a scatter is widened by Student's factor. The upper limit
        is empty where no annulus has a contact, whose force would have to be known.

    Raises
    ------
    InputError
        If there is no place, or the edges differ.

    Notes
    -----
    Counting takes the contacts for independent. On simulated SA+ and SA- patterns the scatter between
    places is 0.5-0.9 of it where nearly every asperity touches (their number hardly fluctuates) and
    1.0-1.3 of it in the outermost annuli.
    """
    edges = {(tuple(place["inner"]), tuple(place["outer"])) for place in places}
    if len(edges) != 1:
        got = f"{len(edges)} different sets of edges"
        raise InputError(f"places are averaged over the same annuli, got {got}")
    inner, outer, area, n, n_forces, a, aa, load, squares, _ = sum_moments(places).to_numpy(float).T
    seen, some = (np.where(values > 0, values, np.nan) for values in (area, n))
    # contacts without any force, in the annulus or in all annuli
    unknown = (n_forces == 0) & ((n > 0) | (n.any() and not n_forces.any()))
    variance, student = _load_variance(places, squares)
    heaviest = squares / np.where(load == 0, np.inf, np.abs(load))
    heaviest = np.maximum(heaviest, _largest_beside(heaviest, n_forces))
    low, high = weighted_count_interval(load, student**2 * variance, heaviest)
    # no contacts are found in 5 % of the places where -ln 0.05 are expected, 1.96 standard uncertainties, of
    # the mean force of the nearest annuli that have some, the larger of the two
    mean = np.abs(load) / np.maximum(n_forces, 1.0)
    unseen = float(-np.log(0.05)) / NORMAL_95 * _largest_beside(mean, n_forces)
    std = np.hypot(np.sqrt(variance), np.where(n > 0, 0.0, unseen))
    loads = {"pressure_Pa": load, "pressure_std_Pa": std, "pressure_low_Pa": low, "pressure_high_Pa": high}
    columns = {
        "r_m": (inner + outer) / 2,
        "density_per_m2": n / seen,
        "mean_radius_m": a / some,
        "area_fraction": np.pi * aa / seen,
    }
    pressures = {name: np.where(unknown, np.nan, values / seen) for name, values in loads.items()}
    return PROFILE.conform(pd.DataFrame(columns | pressures).assign(frame=frame, model=model))


def _load_variance(places: Sequence[pd.DataFrame], squares: Values) -> tuple[Values, float]:
    """Variance (N^2) of the load on annuli, and Student's factor on its root.

    From the scatter between places, or between the sectors of few places; if there are too few, by counting:
    the sums of the squares of the forces.
    """
    together = pd.concat([place.assign(place=k) for k, place in enumerate(places)])
    by_place = len(places) >= MIN_PLACES_FOR_SCATTER
    block = ["place"] if by_place else ["place", "sector"]
    parts = together.groupby(["inner", "outer", *block], sort=True)[["p", "area"]].sum()
    groups = 1 if by_place else len(places)  # sectors scatter about their own place
    p, seen = (parts[name].to_numpy(float).reshape(len(squares), groups, -1) for name in ("p", "area"))
    n = p.shape[2]
    if n < MIN_PLACES_FOR_SCATTER:
        return squares, 1.0
    area = seen.sum(axis=2, keepdims=True)
    # of the ratio of sums p/area, linearised
    away = p - seen * p.sum(axis=2, keepdims=True) / np.where(area > 0, area, 1.0)
    student = float(special.stdtrit(groups * (n - 1), 1 - TAIL)) / NORMAL_95
    return np.asarray(n / (n - 1) * np.sum(away**2, axis=(1, 2)), np.float64), student


def _largest_beside(values: Values, n_forces: Values) -> Values:
    """The larger of the values of the nearest annuli with forces on either side; 0 if there are none."""
    known = pd.Series(values).where(n_forces > 0)
    sides = [known.ffill().shift(), known.bfill().shift(-1)]
    return pd.concat(sides, axis=1).max(axis=1).fillna(0.0).to_numpy()


def weighted_count_interval(
    total: ArrayLike, variance: ArrayLike, one_more: ArrayLike
) -> tuple[Values, Values]:
    """The 95 % interval of the mean of a sum ``sum w_i`` over a Poisson number of contacts.

    Parameters
    ----------
    total : array_like, shape (n,)
        The sums found.
    variance : array_like, shape (n,)
        Their variances: ``sum w_i^2`` of independent contacts, or from a scatter.
    one_more : array_like, shape (n,)
        Weight of the contact that may have been missed by chance; the largest weight is on the safe side.

    Returns
    -------
    low, high : ndarray, shape (n,)
        Of a sum without contacts from 0 to the upper limit ``-ln(0.025) one_more``; NaN for
        the limit if ``one_more`` is not positive. Symmetric where weights of both signs all but cancel.

    References
    ----------
    Fay, Feuer, Statist. Med. 16 (1997) 791, the gamma interval; for equal weights that of Garwood,
    Biometrika 28 (1936) 437, which is exact.

    Examples
    --------
    Three contacts, then none, of weight 1:

    >>> low, high = weighted_count_interval([3.0, 0.0], [3.0, 0.0], [1.0, 1.0])
    >>> low.round(3).tolist(), high.round(3).tolist()
    ([0.619, 0.0], [8.767, 3.689])
    """
    y, v, w = np.broadcast_arrays(*(np.asarray(part, np.float64) for part in (total, variance, one_more)))
    # Theory: positive weights leave (sum w)^2/sum w^2 >= 1, so that less comes from weights of both signs,
    # for which no gamma distribution stands. Chosen: half of the bound leaves room for the estimate of the
    # variance from few places.
    few = (y**2 < 0.5 * v) | (y < 0)
    reach = NORMAL_95 * np.sqrt(v)
    positive = np.where(y > 0, y, np.nan)
    scale = np.where(v > 0, v, np.nan) / positive
    low = np.where(v > 0, np.nan_to_num(scale * special.gammaincinv(positive / scale, TAIL), nan=0.0), y)
    more, more_variance = y + w, v + w**2
    upper = np.where(more_variance > 0, more_variance, np.nan) / np.where(more > 0, more, np.nan)
    high = upper * special.gammaincinv(more / upper, 1 - TAIL)
    return np.where(few, y - reach, low), np.where(few, y + reach, high)


def hertz_profile(
    edges: ArrayLike, *, load: float, sphere_radius: float, contact_modulus: float, frame: str
) -> pd.DataFrame:
    """Hertz's pressure of the smooth sphere, averaged over annuli.

    Parameters
    ----------
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    load : float, N
    sphere_radius : float, m
    contact_modulus : float, Pa
    frame : str
        Entered in the column of that name.

    Returns
    -------
    DataFrame
        Profile table of the model ``hertz``; the one contact has no density.

    Notes
    -----
    The load within ``r`` is ``P (1 - (1 - r^2/a^2)^{3/2})``; its differences over the areas are exact means.

    Examples
    --------
    >>> a = float(hertz.radius(0.5, sphere_radius=0.1288, contact_modulus=4e6))
    >>> inside = hertz_profile([0.0, a], load=0.5, sphere_radius=0.1288, contact_modulus=4e6, frame="f")
    >>> round(float(inside["pressure_Pa"].iloc[0] * 3.14159265 * a**2), 6)
    0.5
    """
    edges = np.asarray(edges, dtype=np.float64)
    a = float(hertz.radius(load, sphere_radius=sphere_radius, contact_modulus=contact_modulus))
    within = load * (1 - np.maximum(1 - (edges / a) ** 2, 0.0) ** 1.5)
    covered = np.pi * np.diff(np.minimum(edges, a) ** 2)
    area = np.pi * np.diff(edges**2)
    columns = {"pressure_Pa": np.diff(within) / area, "area_fraction": covered / area}
    table = pd.DataFrame({"r_m": (edges[1:] + edges[:-1]) / 2, **columns})
    return PROFILE.conform(table.assign(frame=frame, model="hertz"))


def ring_profile(rings: pd.DataFrame, edges: ArrayLike, *, frame: str) -> pd.DataFrame:
    """A statistical model's profile, averaged over annuli.

    Parameters
    ----------
    rings : DataFrame
        Profile table on fine radii, from 0 to where the pressure is zero.
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    frame : str
        Entered in the column of that name.

    Returns
    -------
    DataFrame
        Profile table; the mean radius is that of the contacts of the annulus.

    Notes
    -----
    ``int f 2 pi r dr`` over an annulus with ``f`` linear in ``r`` between the radii: exact for such ``f``.
    """
    r, edges = rings["r_m"].to_numpy(float), np.asarray(edges, dtype=np.float64)
    density = rings["density_per_m2"].to_numpy(float)
    radius = np.nan_to_num(rings["mean_radius_m"].to_numpy(float), nan=0.0)
    area = np.pi * np.diff(edges**2)

    def mean(f: Values) -> Values:  # of f linear between the r and 0 beyond
        mesh = np.union1d(r, edges[edges < r[-1]])
        left, right = np.interp(mesh[:-1], r, f), np.interp(mesh[1:], r, f)
        sums = np.pi * np.diff(mesh) * (mesh[:-1] * (2 * left + right) + mesh[1:] * (left + 2 * right)) / 3
        return np.diff(np.interp(edges, mesh, np.concatenate([[0.0], np.cumsum(sums)]))) / area

    eta = mean(density)
    columns = {name: mean(rings[name].to_numpy(float)) for name in ("pressure_Pa", "area_fraction")}
    mean_radius = mean(density * radius) / np.where(eta > 0, eta, np.nan)
    columns |= {"r_m": (edges[1:] + edges[:-1]) / 2, "density_per_m2": eta, "mean_radius_m": mean_radius}
    return PROFILE.conform(pd.DataFrame(columns).assign(frame=frame, model=rings["model"].iloc[0]))


def normalise_profile(
    profile: pd.DataFrame, *, load: float, sphere_radius: float, contact_modulus: float
) -> pd.DataFrame:
    """A profile over Hertz's largest pressure ``p0`` and contact radius ``aH`` of the smooth sphere.

    Parameters
    ----------
    profile : DataFrame
        Profile table of one load.
    load : float, N
        Positive.
    sphere_radius : float, m
    contact_modulus : float, Pa

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.NORMALISED`, row for row.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Fig. 6 d-f.
    """
    R, E = sphere_radius, contact_modulus
    a = float(hertz.radius(load, sphere_radius=R, contact_modulus=E))
    p0 = float(hertz.peak_pressure(load, sphere_radius=R, contact_modulus=E))
    kinds = ("pressure", "pressure_std", "pressure_low", "pressure_high")
    table = profile[["frame", "model"]].assign(
        load_N=load,
        hertz_radius_m=a,
        hertz_pressure_Pa=p0,
        r_over_hertz_radius=profile["r_m"] / a,
        **{f"{name}_over_hertz": profile[f"{name}_Pa"] / p0 for name in kinds},
    )
    return NORMALISED.conform(table)
