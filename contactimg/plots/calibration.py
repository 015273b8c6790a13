"""Figures of the calibrations: the measured points with the fitted law or number."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from contactimg.plots.axes import new_axes

Values = NDArray[np.float64]

MARKERS = {"loading": "^", "unloading": "v", "": "o"}


def plot_jkr(points: pd.DataFrame, curve: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot contact radii (mm) against load (mN) with the fitted JKR law.

    Parameters
    ----------
    points : DataFrame
        load_N, radius_m, branch, used.
    curve : DataFrame
        load_N, radius_m of the law.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    ax.plot(curve["load_N"] * 1e3, curve["radius_m"] * 1e3, color="C1", label="JKR fit")
    for branch, part in points[points["used"].astype(bool)].groupby("branch"):
        marker = MARKERS[str(branch)]
        ax.plot(
            part["load_N"] * 1e3, part["radius_m"] * 1e3, marker, color="C0", label=str(branch) or "measured"
        )
    _mark_left_out(points, "radius_m", 1e3, ax)
    ax.set(xlabel="load P (mN)", ylabel="contact radius a (mm)")
    ax.legend()
    return ax


def plot_jkr_residuals(points: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the difference between the measured loads and the fitted law (mN).

    Parameters
    ----------
    points : DataFrame
        load_N, residual_N, branch, used.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    ax.axhline(0.0, color="C1")
    for branch, part in points[points["used"].astype(bool)].groupby("branch"):
        marker, label = MARKERS[str(branch)], str(branch) or "measured"
        ax.plot(part["load_N"] * 1e3, part["residual_N"] * 1e3, marker, color="C0", label=label)
    _mark_left_out(points, "residual_N", 1e3, ax)
    ax.set(xlabel="load P (mN)", ylabel="measured minus fitted load (mN)")
    ax.legend()
    return ax


def _mark_left_out(points: pd.DataFrame, column: str, factor: float, ax: Axes) -> None:
    """Mark the frames that the fit does not use with crosses."""
    left_out = points[~points["used"].astype(bool)]
    if len(left_out):
        ax.plot(
            left_out["load_N"] * 1e3, left_out[column] * factor, "x", color="C3", label="not used in the fit"
        )


def plot_slopes(
    thresholds: Values, slopes: Values, stds: Values, *, found: float, ax: Axes | None = None
) -> Axes:
    """Plot the slope of the sum of the forces against the load, for each threshold.

    Parameters
    ----------
    thresholds, slopes, stds : ndarray, shape (m,)
    found : float
        Calibrated threshold; NaN for none.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    ax.fill_between(thresholds, slopes - stds, slopes + stds, color="C0", alpha=0.25, linewidth=0)
    ax.plot(thresholds, slopes, color="C0", label="slope")
    ax.axhline(1.0, color="0.5", linewidth=1)
    if np.isfinite(found):
        ax.axvline(found, color="C1", label=f"calibrated threshold {found:.3f}")
    ax.set(
        xlabel="threshold (fraction of the contrast)",
        ylabel="sum of the forces over load (slope)",
        ylim=(0, 2.5),
    )
    ax.legend()
    return ax


def plot_forces(load: Values, forces: Values, *, ax: Axes | None = None) -> Axes:
    """Plot the sums of the forces against the loads (mN) with the line of slope 1.

    Parameters
    ----------
    load, forces : ndarray, shape (n,), N
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    top = 1.05e3 * float(np.max(load, initial=0.0))
    ax.plot([0, top], [0, top], color="0.5", linewidth=1, label="sum equals load")
    ax.plot(np.asarray(load) * 1e3, np.asarray(forces) * 1e3, "o", color="C0", label="measured")
    ax.set(xlabel="load P (mN)", ylabel="sum of the local forces (mN)")
    ax.legend()
    return ax


def plot_plateau(
    thresholds: Values, areas: Values, *, low: float, high: float, ax: Axes | None = None
) -> Axes:
    """Plot total areas (mm^2) against the threshold with the plateau shaded.

    Parameters
    ----------
    thresholds : ndarray, shape (m,)
    areas : ndarray, shape (m, n), m^2
    low, high : float
        Ends of the plateau.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    ax.plot(thresholds, areas * 1e6)
    ax.axvspan(low, high, color="0.85", label=f"plateau from {low:.3f} to {high:.3f}")
    ax.set(yscale="log", xlabel="threshold (fraction of the contrast)", ylabel="total contact area A (mm²)")
    ax.legend()
    return ax
