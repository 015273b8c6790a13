"""From contact radii to local forces, contact by contact, and the sums over a frame.

The uncertainty of a sum has three parts: the independent uncertainties of the contacts, which add in
quadrature; those of contrast, blur and edges, which all contacts of a frame share (``contrast_shift_px``,
``blur_shift_px`` and ``edge_shift_px`` state how each radius changes with them) and which add linearly; and
those of the modulus and of the pixel size, which are common to everything.

Contacts below the detection limit add to the area and the force of a frame. A contact of radius ``a`` on a
sphere of radius ``R`` is pressed in by ``a^2/R``. Summits just touched are as many per depth as those a
little deeper, whatever the heights' distribution, as long as it is smooth on that scale: the density of
contacts in ``u = a^2`` is uniform near zero. That density is counted just above the detection limit and
extended below it, with its trend where that is no chance. The light of a small contact is proportional to
``u``, and what stands out of the noise by `FALSE_ALARM_SIGMA` is detected in half of the cases, so that a
share ``Phi(FALSE_ALARM_SIGMA (u/u_half - 1))`` of the contacts is found.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import exprel

from contactimg.effects.local_law import force_parts, law_name, law_settings
from contactimg.imaging.detect.peaks import FALSE_ALARM_SIGMA
from contactimg.mechanics.layer import LARGEST_RATIO
from contactimg.models.validity import HERTZ_LIMIT
from contactimg.scene import Scene
from contactimg.surfaces import of_asperities
from contactimg.tables import FRAMES, SHARED_SHIFTS, Flag

Values = NDArray[np.float64]

SUMS = (
    ("area_m2", "visible_area_m2", "area_std_m2"),
    ("force_sum_N", "force_N", "force_sum_std_N"),
    ("force_hertz_sum_N", "force_hertz_N", None),
)
"""Columns of the table of frames that are sums, what is summed over the contacts, and their uncertainty."""

WINDOW = (1.5, 5.5)
"""Range of ``u/u_half`` in which contacts are counted. From 1.5 on all are found (three standard deviations);
chosen: the upper end, a balance between counting and the trend of the distribution, which the two halves of
the window give."""

PRIOR_COUNT = 0.5
"""Contacts added to those of the window (Jeffreys' prior of a count): an empty window then still gives an
uncertainty."""


@dataclass(frozen=True)
class Total:
    """A sum over the contacts of a frame, with its standard uncertainty."""

    value: float
    std: float


NOTHING = Total(0.0, 0.0)


def assign_forces(
    contacts: pd.DataFrame,
    sphere_radius: ArrayLike,
    *,
    contact_modulus: float,
    modulus_relative_std: float = 0.0,
    **settings: Any,
) -> pd.DataFrame:
    """Fill ``force_N``, ``force_std_N`` and ``force_hertz_N``; flag ``BEYOND_HERTZ``.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with ``radius_m``, and ``radius_std_m`` and ``flags`` if known; not changed.
    sphere_radius : array_like, shape (n,) or scalar
        Composite radius ``R Rl/(R + Rl)`` of each contact's asperity, m; NaN where it is not known, which
        leaves the force empty.
    contact_modulus : float
        E*, Pa.
    modulus_relative_std : float
        Relative standard uncertainty of E*; it enters every force alike.
    **settings
        The law: those of `contactimg.effects.local_law.force_parts`.

    Returns
    -------
    DataFrame
        The same table with forces, negative where adhesion outweighs the pressure.

    Raises
    ------
    InputError
        If there is no such law.

    Notes
    -----
    Hertz holds while a/R <= 0.33, the sphere's law for linear elasticity at a/R < 1, that of a layer up to
    `LARGEST_RATIO` thicknesses; beyond these two there is no force. The variance of a force is
    ``(std(a) dp/da)^2 + (p std(E)/E)^2``; with adhesion the modulus counts as for the part that presses.

    References
    ----------
    Yashima et al., eq. (1). Sneddon, doi:10.1016/0020-7225(65)90019-4, section 6. Johnson, Kendall, Roberts,
    doi:10.1098/rspa.1971.0141.

    Examples
    --------
    >>> table = pd.DataFrame({"radius_m": [3e-5], "radius_std_m": [3e-7], "flags": [0]})
    >>> assign_forces(table, 1e-4, contact_modulus=4e6)["force_N"].tolist()
    [0.00144]
    """
    a = contacts["radius_m"].to_numpy(float)
    R = np.broadcast_to(np.asarray(sphere_radius, float), a.shape)
    hertzian = force_parts(a, R, contact_modulus=contact_modulus)[0]
    pressed, pulled, slope = force_parts(a, R, contact_modulus=contact_modulus, **settings)
    std = np.hypot(slope * _relative_radius_std(contacts), modulus_relative_std * pressed)
    beyond, too_wide = int(Flag.BEYOND_HERTZ), a > LARGEST_RATIO * settings.get("thickness", np.inf)
    known = np.asarray(contacts.get("flags", 0), np.int64)
    flags = known & ~beyond | np.where((a > HERTZ_LIMIT * R) | too_wide, beyond, 0)
    forces = {"force_N": pressed - pulled, "force_std_N": std}
    forces = {name: np.where(too_wide, np.nan, values) for name, values in forces.items()}
    return contacts.assign(**forces, force_hertz_N=hertzian, flags=flags)


def visible_areas(contacts: pd.DataFrame) -> pd.Series:
    """Area of each contact that the image shows (m^2); all of it where a table does not say."""
    whole = contacts["area_m2"]
    return contacts["visible_area_m2"].fillna(whole) if "visible_area_m2" in contacts else whole


def total(
    contacts: pd.DataFrame,
    terms: ArrayLike,
    slope: ArrayLike,
    *,
    unseen: Total = NOTHING,
    length_relative_std: float = 0.0,
    modulus_relative_std: float = 0.0,
    modulus_edge_correlation: float = 0.0,
) -> Total:
    """Sum over the contacts of a frame, such as that of their areas (m^2) or of their local forces (N).

    Parameters
    ----------
    contacts : DataFrame
        Contacts table of one frame.
    terms : array_like, shape (n,)
        What is summed; a contact without a value does not count.
    slope : array_like, shape (n,)
        ``d term/d ln a`` of each contact: of an area twice the area, of a force see `local_forces`.
    unseen : Total
        Part of the contacts that were not detected: not in the sum, but in its uncertainty.
    length_relative_std : float
        Relative standard uncertainty of the length of a pixel.
    modulus_relative_std : float
        Relative standard uncertainty of the modulus, to which all terms are proportional.
    modulus_edge_correlation : float
        Correlation of the errors of the modulus and of the edges (``edge_shift_px`` being the change by one
        standard uncertainty): that of a threshold that was calibrated with this modulus.

    Returns
    -------
    Total
        NaN if there are contacts but none has a value; zero if there is no contact.
    """
    terms = np.asarray(terms, float)
    known = np.isfinite(terms)
    if len(terms) and not known.any():
        return Total(np.nan, np.nan)
    its, value, slopes = contacts[known], float(terms[known].sum()), np.asarray(slope, float)[known]
    relative = _relative_shifts(its)
    own = np.maximum(_relative_radius_std(its) ** 2 - np.sum(relative**2, axis=1), 0.0)
    shared, modulus = slopes @ relative, modulus_relative_std * value
    # the sum lacks the value of the unseen part as well
    parts = [*shared, modulus, length_relative_std * slopes.sum(), unseen.value, unseen.std]
    edge = shared[SHARED_SHIFTS.index("edge_shift_px")]
    variance = np.sum(slopes**2 * own) + np.sum(np.square(parts))
    variance += 2 * modulus_edge_correlation * modulus * edge
    return Total(value, float(np.sqrt(max(variance, 0.0))))


def _relative_radius_std(contacts: pd.DataFrame) -> Values:
    """Relative standard uncertainty of the radii; 0 where none is stated."""
    std = np.asarray(contacts.get("radius_std_m", np.nan), float) / contacts["radius_m"].to_numpy(float)
    return np.nan_to_num(std, nan=0.0)


def _relative_shifts(contacts: pd.DataFrame) -> Values:
    """Relative change of the radii with the errors that a frame's contacts share; 0 where not stated."""
    shifts = contacts.reindex(columns=[*SHARED_SHIFTS, "radius_px"]).to_numpy(float)
    return np.nan_to_num(shifts[:, :-1] / shifts[:, -1:], nan=0.0)


def fill_forces(
    scene: Scene,
    contacts: pd.DataFrame,
    frames: pd.DataFrame,
    sites: pd.DataFrame | None,
    *,
    pixel_size: float,
    length_relative_std: float = 0.0,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fill the local forces of a run, and area and force sum of each frame.

    Parameters
    ----------
    scene : Scene
        With ``[effects] sphere_profile = "on"`` the sphere's exact law replaces Hertz's; with
        ``adhesion = "on"`` contacts adhere, with ``layer = "on"`` the support below them acts
        (`contactimg.effects.local_law.decide_law` sets the three). Without ``[elastic]`` there are no forces.
    contacts, frames : DataFrame
        The tables of a run; a frame without a number of contacts was not measured and gets no sums.
    sites : DataFrame or None
        Composite summits of the asperities.
    pixel_size : float, m
    length_relative_std : float
        Relative standard uncertainty of the pixel size.

    Returns
    -------
    contacts, frames : DataFrame

    Notes
    -----
    The uncertainties of the sums allow for the contacts that are too small to be detected
    (`contactimg.forces`); these are not in the sums but beside them.
    """
    elastic, stds = scene.elastic, {"length_relative_std": length_relative_std}
    slope, law = np.zeros(len(contacts)), law_name(scene)
    if elastic is not None:
        contacts, slope = local_forces(scene, contacts, sites)
        stds["modulus_relative_std"] = elastic.young_modulus_std / elastic.young_modulus
        if scene.measure.method == "threshold":
            stds["modulus_edge_correlation"] = scene.measure.threshold_modulus_correlation
    groups, rows = contacts.groupby("frame").indices, frames.to_dict("records")
    for row in rows:
        if pd.isna(row["n_contacts"]):
            continue
        which = groups.get(row["frame"], np.empty(0, np.intp))
        its, smallest = contacts.iloc[which], row["smallest_px"] * pixel_size
        missing = unseen_sum(its, np.pi * its["radius_m"] ** 2, smallest, power=1.0)
        if not len(its) and smallest > 0:  # known no better than one contact of that radius
            missing = Total(0.0, np.pi * smallest**2)
        shown = visible_areas(its)
        area = total(its, shown, 2 * shown, unseen=missing, length_relative_std=length_relative_std)
        row |= {"area_m2": area.value, "area_std_m2": area.std}
        if np.isfinite(smallest):
            row |= {"unseen_area_m2": missing.value, "unseen_area_std_m2": missing.std}
        if elastic is None:
            continue
        lacking = unseen_sum(its, its["force_N"], smallest, power=1.5)
        force = total(its, its["force_N"], slope[which], unseen=lacking, **stds)
        row |= {"force_sum_N": force.value, "force_sum_std_N": force.std}
        # NaN if no contact has a force
        row["force_hertz_sum_N"] = its["force_hertz_N"].sum(min_count=min(len(its), 1))
        row["law"] = law if len(its) and np.isfinite(force.value) else ""
        if np.isfinite(smallest) and np.isfinite(force.value):
            row |= {"unseen_force_N": lacking.value, "unseen_force_std_N": lacking.std}
    return contacts, FRAMES.conform(pd.DataFrame(rows, columns=list(FRAMES.columns)))


def sums_of_contacts(contacts: pd.DataFrame, frames: pd.DataFrame) -> pd.DataFrame:
    """The frames with number, area and forces as the contacts have them now.

    Parameters
    ----------
    contacts, frames : DataFrame
        The tables of a run, of which one may have been changed by hand.

    Returns
    -------
    DataFrame
        A frame that was not measured, or whose sums are those of its contacts to rounding, is as it was. The
        others get the sums of their contacts; their standard uncertainties keep their ratio to the sum, or
        stay as they were where the sum is zero. A force is NaN where there are contacts but none has one.
    """
    groups = contacts.assign(visible_area_m2=visible_areas(contacts)).groupby("frame")
    new = frames.reset_index(drop=True).copy()
    measured = new["n_contacts"].notna().to_numpy()
    new.loc[measured, "n_contacts"] = groups.size().reindex(new["frame"][measured], fill_value=0).to_numpy()
    for total, part, std in SUMS:
        stated = frames[total].to_numpy(float)
        # NaN if no contact of a frame has one
        summed = groups[part].sum(min_count=1).reindex(new["frame"], fill_value=0.0).to_numpy(float)
        # sums in another order differ by 1e-16 times the number of terms
        other = measured & np.isfinite(stated) & ~np.isclose(summed, stated, rtol=1e-9, atol=0)
        new.loc[other, total] = summed[other]
        scaled = other & (stated > 0) & ~(summed <= 0)
        if std is not None:
            new.loc[scaled, std] *= summed[scaled] / stated[scaled]
    return new


def local_forces(
    scene: Scene, contacts: pd.DataFrame, sites: pd.DataFrame | None
) -> tuple[pd.DataFrame, Values]:
    """The contacts with their forces by the law of the scene's switches, and ``d p/d ln a`` (N) of each.

    Parameters
    ----------
    scene : Scene
        With ``[elastic]``; see `fill_forces`.
    contacts : DataFrame
    sites : DataFrame or None
        Composite summits of the asperities.
    """
    elastic, settings = scene.need("elastic", "computing local forces"), law_settings(scene)
    relative = elastic.young_modulus_std / elastic.young_modulus
    radii = sphere_radii(contacts, scene, sites)
    slope = force_parts(contacts["radius_m"].to_numpy(float), radii, **settings)[2]
    return assign_forces(contacts, radii, modulus_relative_std=relative, **settings), slope


def sphere_radii(contacts: pd.DataFrame, scene: Scene, sites: pd.DataFrame | None) -> Values:
    """Composite radius R of each contact: that of its asperity, or of all, or NaN."""
    common = common_radius(scene, sites)
    if sites is None:
        return np.full(len(contacts), common)
    own = of_asperities(sites["radius_m"], contacts["asperity"])
    return np.where(np.isnan(own), common, own)


def common_radius(scene: Scene, sites: pd.DataFrame | None) -> float:
    """Composite radius (m) that holds for contacts without an asperity of their own; NaN if radii differ."""
    if scene.common_radius is not None:
        return scene.common_radius
    radii = np.empty(0) if sites is None else sites["radius_m"].to_numpy(float)
    return float(radii.mean()) if len(radii) and np.ptp(radii) <= 1e-6 * radii.max() else np.nan


# --- contacts below the detection limit


def unseen_sum(contacts: pd.DataFrame, terms: ArrayLike, smallest: float, *, power: float) -> Total:
    """Estimate what the contacts too small to be detected would add to a sum.

    Parameters
    ----------
    contacts : DataFrame
        Those of one frame, with ``radius_m``.
    terms : array_like, shape (n,)
        What is summed, which goes with ``u^power``; its ratio to that is the mean of the smaller contacts.
    smallest : float, m
        Radius of which half of the contacts are detected.
    power : float
        1 for an area, 3/2 for a force.

    Returns
    -------
    Total
        Nothing where no contact has a value, or the limit is not known.

    Examples
    --------
    >>> uniform = pd.DataFrame({"radius_m": 1e-6 * np.sqrt(np.arange(1.25, 30, 0.5))})
    >>> areas = np.pi * uniform["radius_m"] ** 2
    >>> found = unseen_sum(uniform, areas, 1e-6, power=1.0)  # 2 contacts per unit of u/u_half, and a half
    >>> round(found.value / (np.pi * 1e-12), 2)
    1.09
    """
    terms, radius = np.asarray(terms, float), contacts["radius_m"].to_numpy(float)
    known = np.isfinite(terms)
    if not smallest > 0 or not known.any():
        return NOTHING
    ratio = (radius / smallest) ** 2
    low, middle, high = halves = np.linspace(*WINDOW, 3)
    width, small = high - low, known & (ratio < high)
    alike = small if small.any() else known
    factor = float(np.mean(terms[alike] / radius[alike] ** (2 * power)))
    near, far = np.histogram(ratio, halves)[0]
    number, trend = near + far + PRIOR_COUNT, near - far
    # a straight line and an exponential through the two halves, to where the missing area is; shrunk as far
    # as the trend is chance (2/3: mean of u/u_half over the unseen area, of a uniform density up to 1)
    reach = (middle - 2 / 3) / (0.25 * width**2)
    shrunk = trend**2 / (trend**2 + number)
    line = max(number / width + shrunk * reach * trend, PRIOR_COUNT / width)  # per u_half
    rate = shrunk * np.log((near + PRIOR_COUNT) / (far + PRIOR_COUNT)) / (0.5 * width)
    steeper = number / width * np.exp(rate * (low - 2 / 3)) / exprel(-rate * width)
    density = np.sqrt(line * steeper)
    variance = number / width**2 + (shrunk * reach) ** 2 * number + ((1 - shrunk) * reach * trend) ** 2
    variance = variance * steeper / line + (steeper - line) ** 2
    scale = abs(factor) * smallest ** (2 * power)
    own = density * _missed_moment(2 * power)  # the unseen are a number of independent contacts themselves
    std = scale * np.sqrt(variance * _missed_moment(power) ** 2 + own)
    return Total(float(np.sign(factor) * scale * _missed_moment(power) * density), float(std))


def _missed_moment(power: float) -> float:
    """``int x^power (1 - Phi(s (x - 1))) dx`` from 0, to second order in ``1/s``: ``E[X^(p+1)]/(p+1)``."""
    return (1 + 0.5 * (power + 1) * power / FALSE_ALARM_SIGMA**2) / (power + 1)
