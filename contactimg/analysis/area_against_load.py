"""Real contact area against load: averages over places, and the exponent of A(P)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from contactimg.analysis.annuli import SECTORS, annulus_edges, annulus_moments
from contactimg.analysis.estimates import (
    Estimate,
    infinitesimal_covariance,
    of_another_surface,
    student_estimate,
)
from contactimg.analysis.load_cell import EXACT_LOADS, LoadCell, ZeroAverage, average_over_zeros
from contactimg.analysis.power_laws import PowerLaw, exponential, fit_power_law
from contactimg.analysis.radial_profiles import MIN_PLACES_FOR_SCATTER
from contactimg.errors import InputError
from contactimg.tables import AREA

Values = NDArray[np.float64]

LEAST_LOAD_SHARE = 0.02
"""Share of the smallest load that a zero leaves of it at least. Chosen: the logarithm of the load stays
finite; fits there are so bad that they have no weight."""

LEAST_RELATIVE_VARIANCE = 1e-12
"""Relative variance of an area below which it is exact. Chosen: rounding."""

AREA_SECTORS, FORCE_SECTORS = ([f"{name}_{k}" for k in range(SECTORS)] for name in ("area", "force"))

ONE_ANNULUS = 1.0
"""Width (m) of the annulus that holds all contacts. Chosen: wider than any sample."""

SAME_LOAD_TOLERANCE = 0.05
"""Relative difference of loads up to which places share one sampling error. Chosen: over it that
error falls by 2 %."""


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
    frames: pd.DataFrame,
    contacts: pd.DataFrame,
    *,
    place: str,
    centre: tuple[float, float] | None = None,
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
    groups = dict(list(contacts.groupby("frame")))
    none = contacts.iloc[:0]
    return pd.DataFrame(
        [
            {
                "place": place,
                "frame": row["frame"],
                "load": row["load_N"],
                "area": row["area_m2"],
                "area_std": np.nan_to_num(row["area_std_m2"], nan=0.0),
            }
            | _contact_sums(groups.get(row["frame"], none))
            | _sector_sums(groups.get(row["frame"], none), centre)
            for row in good.to_dict("records")
        ],
        columns=[
            "place",
            "frame",
            "load",
            "area",
            "area_std",
            *_contact_sums(none),
            *_sector_sums(none, None),
        ],
    )


def _contact_sums(contacts: pd.DataFrame) -> dict[str, float]:
    """Sums over the contacts of a frame."""
    ratio = contacts["radius_ratio"].dropna() if "radius_ratio" in contacts else pd.Series(dtype=float)
    return {
        "sampling_std": sampling_std(contacts),
        "n": len(contacts),
        "radius": float(contacts["radius_m"].sum()),
        "ratio": float(ratio.sum()),
        "n_ratio": len(ratio),
        "ratio_max": float(ratio.max()) if len(ratio) else np.nan,
    }


def _sector_sums(contacts: pd.DataFrame, centre: tuple[float, float] | None) -> dict[str, float]:
    """Area and force of the contacts of a frame in each sector about the centre."""
    areas, forces = np.full((2, SECTORS), np.nan)
    if centre is not None and len(contacts) and contacts[["x_m", "y_m", "force_N"]].notna().all(axis=None):
        edges = annulus_edges(contacts, centre=centre, width=ONE_ANNULUS)
        moments = annulus_moments(contacts, centre=centre, edges=edges[[0, -1]], sectors=SECTORS)
        areas, forces = np.pi * moments["aa"].to_numpy(float), moments["p"].to_numpy(float)
    return dict(zip(AREA_SECTORS, areas, strict=True)) | dict(zip(FORCE_SECTORS, forces, strict=True))


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
        if number < 0 or loads[k] > lowest * (1 + tolerance):
            number, lowest = number + 1, loads[k]
        groups[k] = number
    return groups


def area_by_load(
    areas: pd.DataFrame,
    groups: NDArray[np.intp],
    *,
    model: str,
    asperity_density: float = np.nan,
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
    spacing = 1 / np.sqrt(asperity_density)
    rows = []
    for _, part in areas.groupby(np.asarray(groups)):
        places = part.groupby("place")[["load", "area"]].mean()
        n = len(places)
        measured = np.sqrt(np.mean(part["area_std"] ** 2) / len(part))
        sampled = np.sqrt(np.mean(part["sampling_std"] ** 2) / n)
        scatter = float(places["area"].std(ddof=1)) if n > 1 else np.nan
        contacts, ratios = part["n"].sum(), part["n_ratio"].sum()
        radius = part["radius"].sum() / contacts if contacts else np.nan
        rows.append(
            {
                "model": model,
                "load_N": places["load"].mean(),
                "n_frames": len(part),
                "n_places": n,
                "area_m2": places["area"].mean(),
                "area_std_m2": scatter / np.sqrt(n)
                if n >= MIN_PLACES_FOR_SCATTER
                else np.hypot(measured, sampled),
                "area_scatter_m2": scatter,
                "n_contacts": part["n"].mean(),
                "mean_radius_m": radius,
                "spacing_over_radius": spacing / radius,
                "radius_ratio_mean": part["ratio"].sum() / ratios if ratios else np.nan,
                "radius_ratio_max": part["ratio_max"].max(),
            }
        )
    return AREA.conform(pd.DataFrame(rows)) if rows else AREA.empty()


def fit_area_law(
    areas: pd.DataFrame,
    *,
    load_relative_std: float = 0.0,
    load_std: float = 0.0,
    load_cell: LoadCell = EXACT_LOADS,
    confidence: float = 0.95,
) -> PowerLaw:
    """Exponent of ``A ~ P^m`` with errors in both.

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
        The interval applies to the surface: with several places it comes from the scatter between them, with
        one from that between its sectors, or if forces or centre are not known from `sampling_std`. The zero
        of the loads is averaged over (`contactimg.analysis.load_cell`): its mean is taken off the loads, and
        what is not known of it is in the intervals; the gain is in that of the amplitude. ``here`` leaves out
        the sampling of places; ``another_surface`` adds that of another surface's places.

    Raises
    ------
    InputError
        If fewer than two different loads are left.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Figs. 4 and 5.
    """
    good = areas[(areas["load"] > 0) & (areas["area"] > 0)]
    if good["load"].nunique() < 2:
        raise InputError(
            "an exponent of A(P) needs two different loads with contacts at least, "
            f"got {good['load'].nunique()}"
        )
    load, area = good["load"].to_numpy(float), good["area"].to_numpy(float)
    errors = {
        "x_std": np.hypot(load_relative_std * load, load_std),
        "y_std": np.hypot(good["area_std"].to_numpy(float), _common_sampling_std(good)),
        "places": good["place"].tolist(),
        "confidence": confidence,
    }
    law = fit_power_law(load, area, **errors)
    std = _measured_std(load, area, errors, law, good["area_std"].to_numpy(float))
    law = _with_scatter_of_sectors(law, good, _weights(load, area, errors, law), std)
    width = load_cell.zero_width(load)
    if width > 0:
        average = _zero_average(load, area, errors, law, width)
        law = fit_power_law(load - average.zero, area, **errors)
        law = replace(law, exponent=_widened(law.exponent, average.std[1], confidence), zero=average.zero)
        law = replace(
            law, amplitude=_widened(law.amplitude, average.std[0] * law.amplitude.value, confidence)
        )
        std = float(np.hypot(std, average.std[1]))
    value = law.exponent.value
    law = replace(law, here=_widened(Estimate(value, 0.0, value, value), std, confidence))
    another = of_another_surface(law.exponent, measured_std=std)
    gain = load_cell.gain_std * law.exponent.value * law.amplitude.value
    return replace(law, amplitude=_widened(law.amplitude, gain, confidence), another_surface=another)


def _with_scatter_of_sectors(law: PowerLaw, areas: pd.DataFrame, weight: Values, measured: float) -> PowerLaw:
    """The law of one place with the uncertainty that the scatter between its sectors tells, if there are any.

    A sector that bears more than its share of the load changes the load along the law, and the area by what
    is beyond. The errors of the measurement and the scatter about the law that they do not explain are added.
    """
    sectors = areas[[*AREA_SECTORS, *FORCE_SECTORS]].to_numpy(float) if AREA_SECTORS[0] in areas else np.nan
    if law.n_places > 1 or law.freedom < 1 or not np.isfinite(sectors).all():
        return law
    a, p = np.split(sectors, 2, axis=1)
    x, share = np.log(areas["load"].to_numpy(float) / law.reference), weight / weight.sum()
    lever = share * (x - share @ x)
    lever /= lever @ x
    beyond = a / a.sum(axis=1, keepdims=True) - law.exponent.value * p / p.sum(axis=1, keepdims=True)
    influences = np.column_stack([(share - share @ x * lever) @ beyond, lever @ beyond])
    covariance = infinitesimal_covariance(influences)
    excess = law.scatter**2 * np.array([share @ share + (share @ x) ** 2 * lever @ lever, lever @ lever])
    std = np.sqrt(np.diag(covariance) + excess + [0.0, measured**2])
    freedom = SECTORS - 1 if law.scatter == 0 else min(SECTORS - 1, law.freedom)
    offset, exponent = (
        student_estimate(float(value), float(s), freedom=freedom, confidence=law.confidence)
        for value, s in zip((np.log(law.amplitude.value), law.exponent.value), std, strict=True)
    )
    return replace(law, exponent=exponent, amplitude=exponential(offset))


def _common_sampling_std(areas: pd.DataFrame) -> Values:
    """Sampling errors of the areas, of one relative size at each load.

    With those of each place, places whose area is larger by chance would have the larger weight.
    """
    area = areas["area"].to_numpy(float)
    groups = group_loads(areas["load"].to_numpy(float), tolerance=SAME_LOAD_TOLERANCE)
    relative = pd.Series((areas["sampling_std"].to_numpy(float) / area) ** 2)
    return np.asarray(area * np.sqrt(relative.groupby(groups).transform("mean").to_numpy(float)), np.float64)


def _weights(load: Values, area: Values, errors: Mapping[str, Any], law: PowerLaw) -> Values:
    """Of the logarithms of the areas in the fit."""
    variance = (errors["y_std"] / area) ** 2 + (law.exponent.value * errors["x_std"] / load) ** 2
    return np.asarray(1 / np.maximum(variance + law.scatter**2, LEAST_RELATIVE_VARIANCE), np.float64)


def _measured_std(
    load: Values, area: Values, errors: Mapping[str, Any], law: PowerLaw, area_std: Values
) -> float:
    """Standard deviation of the exponent by the errors of the measured areas and loads alone."""
    weight, x = _weights(load, area, errors, law), np.log(load)
    lever = weight * (x - weight @ x / weight.sum())
    relative = np.hypot(area_std / area, law.exponent.value * errors["x_std"] / load)
    return float(np.sqrt(np.sum((lever * relative) ** 2)) / (lever @ x))


def _zero_average(
    load: Values, area: Values, errors: Mapping[str, Any], law: PowerLaw, width: float
) -> ZeroAverage:
    """Weighted lines through the logarithms for every zero: ln A at the reference, and the exponent."""
    weight, y = _weights(load, area, errors, law), np.log(area)

    def line(zero: float) -> tuple[Values, float]:
        x = np.log((load - zero) / law.reference)
        middle, mean = weight @ x / weight.sum(), weight @ y / weight.sum()
        slope = (weight * (x - middle)) @ (y - mean) / (weight @ (x - middle) ** 2)
        rest = y - mean - slope * (x - middle)
        misfit = float(weight @ rest**2)
        # the scatter is estimated from the same residuals, unless stated errors explain them all
        log = -0.5 * law.freedom * np.log(max(misfit, 1e-300)) if law.scatter > 0 else -0.5 * misfit
        return np.array([mean - slope * middle, slope]), log

    return average_over_zeros(line, width, largest=float(load.min()) * (1 - LEAST_LOAD_SHARE))


def _widened(estimate: Estimate, std: float, confidence: float) -> Estimate:
    """The estimate with one more standard uncertainty, in quadrature."""
    reach = float(stats.norm.ppf((1 + confidence) / 2)) * std
    low, high = (
        estimate.value + sign * float(np.hypot(limit - estimate.value, reach))
        for sign, limit in ((-1, estimate.low), (1, estimate.high))
    )
    return Estimate(estimate.value, float(np.hypot(estimate.std, std)), low, high)
