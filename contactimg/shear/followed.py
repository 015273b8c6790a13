"""Each asperity of a series in each frame: its contact, or where it would touch; and the laws of these."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.shear.laws import Decrease, RateLaw, fit_decrease, fit_rate_law, half_axes_along
from contactimg.surfaces import of_asperities
from contactimg.tables import FOLLOWED, Status

Values = NDArray[np.float64]

MEASURED = [
    "x_m", "y_m", "radius_m", "radius_std_m", "semi_major_m", "semi_minor_m", "angle_rad", "area_m2",
    "force_N",
]  # fmt: skip
"""Columns that a followed asperity has from its contact."""

FEWEST_FRAMES = 3
"""Frames with a contact that its law needs. Theory: two parameters, and one frame that may differ."""


def follow_contacts(
    contacts: pd.DataFrame, frames: pd.DataFrame, loads: pd.DataFrame, asperities: pd.DataFrame
) -> pd.DataFrame:
    """The contacts of a series by asperity.

    Parameters
    ----------
    contacts, frames : DataFrame
        Tables of a run; places are those on the sample, from which the shift of each frame is taken off.
    loads : DataFrame
        Columns of `contactimg.tables.LOADS`.
    asperities : DataFrame
        Asperity table that the contacts are numbered by.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.FOLLOWED`: one row for each asperity that touches in some frame and each
        measured frame, without upper limits. Where it does not touch, its place is the one where it would:
        that of its contacts in other frames, moved with the contacts of this frame (medians). Frames without
        a pose are left out: the few of their contacts that fall on an asperity do so by chance.

    Examples
    --------
    >>> contacts = pd.DataFrame({"frame": ["a", "a", "b"], "asperity": [0, 1, 1], "x_m": [0.1, 1.1, 1.3],
    ...     "y_m": 0.0, "radius_m": 0.01, "area_m2": 3e-4})
    >>> frames = pd.DataFrame({"frame": ["a", "b"], "status": "ok", "load_N": 0.1, "n_contacts": [2, 1]})
    >>> loads = pd.DataFrame({"frame": ["a", "b"], "tangential_N": [0.0, 0.2]})
    >>> table = follow_contacts(contacts, frames, loads, pd.DataFrame({"x_m": [0.0, 1.0], "y_m": 0.0}))
    >>> table[["asperity", "frame", "touches", "x_m", "displacement_x_m"]].round(6)
       asperity frame  touches  x_m  displacement_x_m
    0         0     a     True  0.1               0.0
    1         0     b    False  0.3               NaN
    2         1     a     True  1.1               0.0
    3         1     b     True  1.3               0.2
    """
    posed = frames["n_contacts"].notna() & (frames["status"] != Status.NO_POSE)
    shots = frames.loc[posed, ["frame", "load_N"]]
    shots = shots.merge(
        loads.filter(["frame", "tangential_N", "time_s"]).drop_duplicates("frame"), how="left"
    )
    known = contacts[contacts["asperity"].notna() & contacts["frame"].isin(shots["frame"])]
    measured = known.filter(["frame", "asperity", *MEASURED]).astype({"asperity": int})
    touched = np.unique(measured["asperity"])
    keys = pd.DataFrame({"asperity": touched}).merge(shots, how="cross")
    table = keys.merge(measured.drop_duplicates(["frame", "asperity"]), how="left", on=["asperity", "frame"])
    table["touches"] = table["radius_m"].notna()
    for axis in ("x_m", "y_m") if len(table) else ():
        place = table[axis].to_numpy(float).reshape(len(touched), len(shots))
        first = place[np.arange(len(touched)), np.isfinite(place).argmax(axis=1)]
        table[f"displacement_{axis}"] = (place - first[:, None]).ravel()
        table[axis] = _expected(place, of_asperities(asperities[axis], pd.Series(touched))).ravel()
    return FOLLOWED.conform(table)


def _expected(place: Values, sites: Values) -> Values:
    """Places of asperities (rows) in frames (columns), missing ones as those of row and column say."""
    offset = place - sites[:, None]
    common = pd.DataFrame(offset).median().ffill().bfill().to_numpy(float)
    own = pd.DataFrame(offset - common).median(axis=1).to_numpy(float)
    return np.where(np.isnan(place), (sites + own)[:, None] + common, place)


@dataclass(frozen=True, eq=False)
class ShearLaws:
    """The behaviour of contacts at one normal load under a tangential load.

    Parameters
    ----------
    load : float, N
        Normal load of the frames.
    total : Decrease
        Of the sum of the contact areas.
    contacts : DataFrame
        One row a contact: ``asperity, area, area_std, rate, rate_std, correlation``, with ``rate`` (m^2/N^2)
        the decrease of its area with the square of its own share of the load.
    along, across : Decrease or None
        Of the mean half-axes, along the load and across it, of contacts that are ellipses in all frames; None
        if there are none.
    largest : float, N
        Largest tangential load.
    """

    load: float
    total: Decrease
    contacts: pd.DataFrame
    along: Decrease | None
    across: Decrease | None
    largest: float


def fit_shear_laws(
    followed: pd.DataFrame, frames: pd.DataFrame, *, direction: float = 0.0, confidence: float = 0.95
) -> ShearLaws:
    """Fit the laws of one normal load: the sum, each contact, the half-axes.

    Parameters
    ----------
    followed : DataFrame
        From `follow_contacts`, frames of one normal load.
    frames : DataFrame
        Frames table with the areas of these frames.
    direction : float, rad
        Of the tangential load in the image, as ``angle_rad``.
    confidence : float

    Returns
    -------
    ShearLaws

    Raises
    ------
    InputError
        If there are not three frames with two different tangential loads.

    Notes
    -----
    The force on a single contact is not measured. It is taken as its share of the area, ``q_i = Q A_i/A``
    without tangential load (equal mean shear stresses): ``A_i - alpha' Q^2`` then is ``A_i - alpha q_i^2``
    with ``alpha = alpha' (A/A_i)^2``. Contacts outside the image carry load too; where there are any,
    ``alpha`` is too small.
    """
    areas = frames.set_index("frame")[["area_m2", "area_std_m2"]]
    shots = (
        followed.drop_duplicates("frame")
        .set_index("frame")[["load_N", "tangential_N"]]
        .join(areas)
        .dropna(subset=["tangential_N", "area_m2"])
    )
    if len(shots) < FEWEST_FRAMES:
        raise InputError(
            f"laws under shear need {FEWEST_FRAMES} frames of one normal load with a tangential load, "
            f"got {len(shots)}"
        )
    loads = shots["tangential_N"]
    total = fit_decrease(loads, shots["area_m2"], std=_stated(shots["area_std_m2"]), confidence=confidence)
    part = followed[followed["touches"] & followed["frame"].isin(shots.index)]
    counts = part.groupby("asperity")["frame"].transform("size")
    rows = []
    for asperity, one in part[counts >= FEWEST_FRAMES].groupby("asperity"):
        if len(one["tangential_N"].abs().unique()) > 1:
            own = _stated(2 * np.pi * one["radius_m"] * one["radius_std_m"])
            scatter = 0.0 if (own > 0).all() else None
            law = fit_decrease(one["tangential_N"], one["area_m2"], std=own, scatter=scatter)
            start, rate, share = law.start, law.rate, (total.start.value / law.start.value) ** 2
            shared = share * rate.value, share * rate.std
            rows.append((asperity, start.value, start.std, *shared, law.correlation))
    contacts = pd.DataFrame(rows, columns=["asperity", "area", "area_std", "rate", "rate_std", "correlation"])
    # the half-axes of a disk say nothing of its shape
    axes = part["angle_rad"].notna().groupby(part["asperity"]).transform("all")
    whole = part[(counts == len(shots)) & axes]
    both = half_axes_along(*(whole[name] for name in MEASURED[4:7]), direction=direction)
    means = pd.DataFrame(dict(zip("xy", both, strict=True))).groupby(whole["frame"].to_numpy()).mean()
    along, across = (
        fit_decrease(loads, means[name].reindex(shots.index), confidence=confidence) if len(means) else None
        for name in "xy"
    )
    load, contacts, largest = float(shots["load_N"].mean()), contacts[contacts["area"] > 0], loads.abs().max()
    return ShearLaws(load, total, contacts, along, across, float(largest))


def _stated(std: pd.Series) -> pd.Series:
    """Standard uncertainties; none if one is unknown, whose value would count as exact beside others."""
    return std if std.notna().all() else pd.Series(0.0, std.index)


def fit_beta(laws: Sequence[ShearLaws], *, confidence: float = 0.95) -> RateLaw:
    """Fit ``alpha = beta A0^(-3/2)`` to the contacts of all normal loads; see `fit_rate_law`.

    What the contacts of a frame share (contrast, blur, edges, the tangential load) does not average out over
    them. It acts on the sum of their areas alike, so the relative uncertainty of its rate is added to that of
    beta.
    """
    if not laws:
        raise InputError("beta takes the laws of one normal load or more, got none")
    table = pd.concat([one.contacts for one in laws])
    law = fit_rate_law(
        table["area"],
        table["rate"],
        area_std=table["area_std"],
        rate_std=table["rate_std"],
        correlation=table["correlation"].clip(-1, 1),
        confidence=confidence,
    )
    known = sum((one.total.rate.value / one.total.rate.std) ** 2 for one in laws if one.total.rate.std > 0)
    shared = abs(law.beta.value) / np.sqrt(known) if known > 0 else 0.0
    return replace(law, beta=law.beta.widened(float(shared), confidence=confidence))
