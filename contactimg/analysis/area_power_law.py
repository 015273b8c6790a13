"""Real contact area against load: averages over places, and the exponent of A(P)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from contactimg.analysis.annuli import MIN_PLACES_FOR_SCATTER, SECTORS, annulus_moments
from contactimg.analysis.estimates import bootstrap_estimates, bootstrap_weights
from contactimg.analysis.linear_fit import Points, fit_line
from contactimg.analysis.load_cell import EXACT_LOADS, LoadCell
from contactimg.analysis.power_laws import PowerLaw, exponential, logarithms
from contactimg.errors import InputError
from contactimg.tables import AREA

Values = NDArray[np.float64]


CONTACT_SUMS = ("sampling_std", "n", "radius", "ratio", "n_ratio", "ratio_max")
AREA_SECTORS, FORCE_SECTORS = ([f"{name}_{k}" for k in range(SECTORS)] for name in ("area", "force"))


def sampling_std(contacts: pd.DataFrame) -> float:
    """Standard deviation of the area between places at one load, estimated from the contacts of one place.

    Parameters
    ----------
    contacts : DataFrame
        Contacts of one frame with ``radius_m``.

    Returns
    -------
    float, m^2
        0 without contacts.

    Notes
    -----
    Independent contacts, of which the load prescribes the sum of ``p ~ a^3``: the variance of
    ``sum pi a^2`` at a given ``sum a^3`` is ``sum (pi a^2 - b a^3)^2`` with ``b = pi sum a^5/sum a^6``.
    Against the scatter of simulated patterns it is 1.0-1.5 times too large on SA surfaces, 1.2-1.5 on RA- and
    1.2-4 on RA+.

    Examples
    --------
    >>> import pandas as pd
    >>> equal = pd.DataFrame({"radius_m": [1e-5, 1e-5, 1e-5]})  # the load fixes the number, so the area
    >>> sampling_std(equal)
    0.0
    """
    a = contacts["radius_m"].to_numpy(float)
    if not len(a):
        return 0.0
    size = a / a.max()
    slope = np.sum(size**5) / np.sum(size**6)
    return float(np.pi * a.max() ** 2 * np.sqrt(np.sum((size**2 - slope * size**3) ** 2)))


def frame_areas(
    frames: pd.DataFrame, contacts: pd.DataFrame, *, place: str, centre: tuple[float, float] | None = None
) -> pd.DataFrame:
    """Loads, areas and contact sums of the frames of one place, for A(P).

    Parameters
    ----------
    frames, contacts : DataFrame
        Tables of one run.
    place : str
        Name of the place.
    centre : (float, float), optional
        Of the apparent contact, sample coordinates, m: about it the contacts are divided into sectors, whose
        scatter tells what another place would give.

    Returns
    -------
    DataFrame
        One row a frame that has a load and an area, in order: ``place, frame, load, area, area_std,
        sampling_std, n, radius`` (sum of the contact radii), ``ratio, n_ratio, ratio_max`` (sum, number and
        largest of a/R where ``contacts`` has a column ``radius_ratio``), ``area_0 ... force_0 ...`` (of each
        sector; NaN without a centre, or if a force is not known), in SI units. Frames without load or area
        (failed ones) are left out.
    """
    good = frames[frames["load_N"].notna() & frames["area_m2"].notna()]
    groups, none = dict(list(contacts.groupby("frame"))), contacts.iloc[:0]
    rows, names = [], ("place", "frame", "load", "area", "area_std")
    for row in good.to_dict("records"):
        own = groups.get(row["frame"], none)
        ratio = own.reindex(columns=["radius_ratio"])["radius_ratio"].dropna()
        sums = sampling_std(own), len(own), own["radius_m"].sum(), ratio.sum(), len(ratio), ratio.max()
        sectors = np.full((2, SECTORS), np.nan)
        if centre is not None and len(own) and own[["x_m", "y_m", "force_N"]].notna().all(axis=None):
            whole = annulus_moments(own, centre=centre, edges=[0.0, np.inf], sectors=SECTORS)
            sectors = np.stack([np.pi * whole["aa"], whole["p"]])
        measured = row["load_N"], row["area_m2"], np.nan_to_num(row["area_std_m2"], nan=0.0)
        rows.append([place, row["frame"], *measured, *sums, *sectors.ravel()])
    return pd.DataFrame(rows, columns=[*names, *CONTACT_SUMS, *AREA_SECTORS, *FORCE_SECTORS])


def group_loads(loads: Sequence[float] | Values, *, tolerance: float) -> NDArray[np.intp]:
    """Numbers of groups of nearly equal loads, from the lowest.

    Parameters
    ----------
    loads : array_like, shape (n,), N
        In any order.
    tolerance : float
        Relative: no load of a group exceeds its lowest by more.

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    InputError
        If the tolerance is negative.

    Examples
    --------
    >>> group_loads([0.2, 0.02, 0.201, 0.5], tolerance=0.05).tolist()
    [1, 0, 1, 2]
    """
    if not tolerance >= 0:
        raise InputError(f"the tolerance of a load must not be negative, got {tolerance!r}")
    loads = np.asarray(loads, dtype=np.float64)
    groups, number, lowest = np.zeros(len(loads), np.intp), -1, -np.inf
    for k in np.argsort(loads, kind="stable"):
        if number < 0 or loads[k] > lowest + tolerance * abs(lowest):
            number, lowest = number + 1, loads[k]
        groups[k] = number
    return groups


def area_by_load(
    areas: pd.DataFrame, groups: NDArray[np.intp], *, model: str, asperity_density: float = np.nan
) -> pd.DataFrame:
    """Average the frames of each load: frames of a place first, then places.

    Parameters
    ----------
    areas : DataFrame
        From `frame_areas`, of all places.
    groups : ndarray, shape (n,)
        From `group_loads`.
    model : str
        Entered in the column of that name.
    asperity_density : float, 1/m^2
        eta0, for ``spacing_over_radius``; NaN if it is not known.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.AREA`, one row a load. The uncertainty of the area is the standard error
        between places from four places on; below that measurement and `sampling_std` of the frames.
    """
    if areas.empty:
        return AREA.empty()
    squares = areas.assign(area_std=areas["area_std"] ** 2, sampling_std=areas["sampling_std"] ** 2)
    frames, places = squares.groupby(groups), areas.groupby([groups, "place"])[["load", "area"]].mean()
    of_places = places.groupby(level=0)
    n, mean, scatter = of_places.size(), of_places.mean(), of_places["area"].std()
    stated = np.sqrt(frames["area_std"].mean() / frames.size() + frames["sampling_std"].mean() / n)
    sums = frames[["n", "radius", "n_ratio", "ratio"]].sum()
    radius = sums["radius"] / sums["n"]
    columns = {
        "load_N": mean["load"],
        "n_frames": frames.size(),
        "n_places": n,
        "area_m2": mean["area"],
        "area_std_m2": (scatter / np.sqrt(n)).where(n >= MIN_PLACES_FOR_SCATTER, stated),
        "area_scatter_m2": scatter,
        "n_contacts": frames["n"].mean(),
        "mean_radius_m": radius,
        "spacing_over_radius": 1 / np.sqrt(asperity_density) / radius,
        "radius_ratio_mean": sums["ratio"] / sums["n_ratio"],
        "radius_ratio_max": frames["ratio_max"].max(),
    }
    return AREA.conform(pd.DataFrame(columns).assign(model=model))


def fit_area_law(
    areas: pd.DataFrame,
    *,
    load_relative_std: float = 0.0,
    load_std: float = 0.0,
    load_cell: LoadCell = EXACT_LOADS,
    confidence: float = 0.95,
) -> PowerLaw:
    """Exponent of ``A ~ P^m``: a weighted straight line through the logarithms, with the errors of both.

    Parameters
    ----------
    areas : DataFrame
        From `frame_areas`, of all places; frames without positive load and area are left out.
    load_relative_std : float
        Relative standard uncertainty of a load.
    load_std : float, N
        Absolute one; the two add in squares.
    load_cell : LoadCell
        How well the zero and the gain that all loads share are known; exact if not given.
    confidence : float
        Of the intervals.

    Returns
    -------
    PowerLaw
        The interval applies to the surface: that of a bootstrap over places, or over sectors of fewer than
        four places; if forces or centre are not known, Student's interval of the line. A zero whose
        uncertainty is stated is fitted, taken off the loads, and what is not known of it is in the intervals;
        the gain is in that of the amplitude.

    Raises
    ------
    InputError
        If fewer than two different loads are left, or the table is another one.

    Notes
    -----
    In a replicate a sector counts with its weight, both with its contacts' area and with the load that they
    bear: a sector that bears more than its share moves the point along the law, and only the rest counts.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Figs. 4 and 5.
    """
    needed = ("place", "load", "area", "area_std", "sampling_std")
    if lacking := [name for name in needed if name not in areas]:
        raise InputError(f"areas: column {lacking[0]!r} is missing; give the table of `frame_areas`")
    good = areas[(areas["load"] > 0) & (areas["area"] > 0)]
    if (loads := good["load"].nunique()) < 2:
        raise InputError(f"an exponent of A(P) needs two different loads with contacts at least, got {loads}")
    read, area, area_std = (good[name].to_numpy(float) for name in ("load", "area", "area_std"))
    # of one relative size at each load: else places whose area is larger by chance had the larger weight
    # Chosen: over 5 % of the load the sampling error that places share falls by 2 %.
    groups = group_loads(read, tolerance=0.05)
    sampled = pd.Series((good["sampling_std"].to_numpy(float) / area) ** 2).groupby(groups).transform("mean")
    sampling = area * np.sqrt(sampled.to_numpy(float))
    errors = np.hypot(load_relative_std * read, load_std), np.hypot(area_std, sampling)
    zero, zero_stds = _zero(read, area, errors, load_cell.zero_std)
    load = read - zero
    logs, reference = logarithms(load, area, *errors)
    fit = fit_line(logs)
    replicates, blocks = _replicates(good, logs)
    if blocks > 1:
        x, weights = np.asarray(logs.x), fit.weights
        lever = weights * (x - weights @ x / weights.sum())
        relative = np.hypot(area_std / area, fit.parameters[1] * np.asarray(logs.x_std))
        # the standard deviation of the exponent by the errors of the measured areas, loads and zero alone
        measured = np.hypot(np.sqrt(np.sum((lever * relative) ** 2)) / (lever @ x), zero_stds[1])
        lines = fit_line(replicates, scatter=fit.scatter).parameters
        offset, exponent = bootstrap_estimates(
            fit.parameters, lines, blocks=blocks, known_std=[0.0, measured], confidence=confidence
        )
    else:
        offset, exponent = (fit.estimate(k, confidence=confidence) for k in (0, 1))
        exponent = exponent.widened(zero_stds[1], confidence=confidence)
    gain = load_cell.gain_std * exponent.value
    offset = offset.widened(np.hypot(zero_stds[0], gain), confidence=confidence)
    amplitude, ends = exponential(offset), (float(load.min()), float(load.max()))
    counts = len(good), int(good["place"].nunique())
    return PowerLaw(exponent, amplitude, reference, *ends, fit.scatter, *counts, confidence, zero)


def _replicates(areas: pd.DataFrame, logs: Points) -> tuple[Points, int]:
    """The points in each replicate of a bootstrap, and its number of blocks; of one block there is none."""
    owner, places = pd.factorize(areas["place"])
    known = areas.reindex(columns=[*AREA_SECTORS, *FORCE_SECTORS]).notna().all(axis=None)
    if len(places) < MIN_PLACES_FOR_SCATTER and known:
        weights = bootstrap_weights(len(places) * SECTORS).reshape(-1, len(places), SECTORS)[:, owner]
        moved = []
        for names in (FORCE_SECTORS, AREA_SECTORS):
            share = areas[names].to_numpy(float) / areas[names].sum(axis=1).to_numpy(float)[:, None]
            moved.append(np.log(np.sum(weights * share, axis=-1)))
        x, y = np.asarray(logs.x) + moved[0], np.asarray(logs.y) + moved[1]
        return replace(logs, x=x, y=y), len(places) * SECTORS
    return replace(logs, weight=bootstrap_weights(len(places))[:, owner]), len(places)


def _zero(load: Values, area: Values, errors: tuple[Values, Values], zero_std: float) -> tuple[float, Values]:
    """The zero of the loads (N), and what not knowing it adds to the line's parameters.

    The line is fitted with zeros over the range that is expected; each counts with its probability there
    times the likelihood of the line.
    """
    if not zero_std:
        return 0.0, np.zeros(2)
    # Chosen: a tenth of the standard uncertainty apart, so that the mean and the spread of smooth functions
    # are exact to 1e-3 of it.
    zeros = zero_std * np.linspace(-5.0, 5.0, 101)
    zeros = zeros[zeros < load.min()]  # fits near its end are so bad that they have no weight
    logs, reference = logarithms(load, area, *errors)
    fit = fit_line(logs)
    points = replace(logs, x=np.log((load - zeros[:, None]) / reference))
    lines = fit_line(points, scatter=fit.scatter)
    chi_square = np.maximum(lines.chi_square, np.finfo(float).tiny)
    # a scatter that is estimated from the same residuals is not known beforehand
    misfit = fit.freedom * np.log(chi_square) if fit.scatter > 0 else chi_square
    weights = special.softmax(-0.5 * (misfit + (zeros / zero_std) ** 2))
    spread = np.sqrt(weights @ (lines.parameters - weights @ lines.parameters) ** 2)
    return float(weights @ zeros), spread
