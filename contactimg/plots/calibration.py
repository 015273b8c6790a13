"""Figures of calibrations and checks: measured points with a fitted law or the truth, and what is left."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from contactimg.analysis.estimates import CoverageEstimate
from contactimg.plots.axes import add_legend, axes_with_panel, new_axes, scale_by_decades
from contactimg.plots.laws import MARKER_SIZE
from contactimg.plots.numbers import number_with_interval

Values = NDArray[np.float64]

LAW, POINTS, OTHER = "#d55e00", "#0072b2", "0.5"
"""Colours of a fitted law, of measured points (palette of Okabe and Ito), and of what is to compare."""

BRANCHES: dict[str, dict[str, Any]] = {
    "": {"marker": "o", "label": "measured"},
    "loading": {"marker": "^"},
    "unloading": {"marker": "v", "markerfacecolor": "none"},
    "not used in the fit": {"marker": "x", "color": "0.2"},
}
"""Marks of the branches of a loading cycle; open ones, so that branches that coincide are told apart."""

LARGEST_SLOPE = 4.0
"""Slopes beyond are not shown. Chosen: a threshold that makes the forces so large is of no use."""

DASHES = ("-", "--", "-.")
"""Lines of neighbouring curves of a plateau figure, which merge in grey."""

LABELLED_CURVES = 8
"""Most curves of a plateau figure that are labelled; of more, evenly spaced ones. Chosen by eye."""


def plot_jkr(
    points: pd.DataFrame, curve: pd.DataFrame, *, fitted: Sequence[str] = (), ax: Axes | None = None
) -> Axes:
    """Plot contact radii (mm) against load (mN) with the fitted JKR law.

    Parameters
    ----------
    points : DataFrame
        load_N, radius_m, branch, used, and residual_N for the panel.
    curve : DataFrame
        load_N, radius_m of the law.
    fitted : sequence of str
        Lines for the legend: the fitted values.
    ax : Axes, optional
        By default new axes with `plot_jkr_residuals` in a panel below; only these have it.

    Returns
    -------
    Axes
    """
    ax, below, last = axes_with_panel(ax)
    label = "\n".join(["JKR fit", *fitted])
    ax.plot(curve["load_N"] * 1e3, curve["radius_m"] * 1e3, color=LAW, linewidth=1.2, label=label)
    _plot_branches(points, "radius_m", ax)
    ax.set(ylabel="contact radius a (mm)")
    ax.legend(fontsize="small")
    plot_jkr_residuals(points, ax=below)
    below.set_ylabel("measured minus\nfitted load (mN)")
    last.set_xlabel("load P (mN)")
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
    alone, ax = ax is None, new_axes() if ax is None else ax
    ax.axhline(0.0, color=LAW, linewidth=1.2)
    _plot_branches(points, "residual_N", ax)
    ax.set(xlabel="load P (mN)", ylabel="measured minus fitted load (mN)")
    if alone:
        ax.legend(fontsize="small")
    return ax


def _plot_branches(points: pd.DataFrame, column: str, ax: Axes) -> None:
    """Plot a column against the load, both times 1000, with the marks of `BRANCHES`."""
    branches = points["branch"].where(points["used"].astype(bool), "not used in the fit")
    for branch, marks in BRANCHES.items():
        part = points[branches == branch]
        if len(part):
            style: dict[str, Any] = {"color": POINTS, "linestyle": "none", "markersize": MARKER_SIZE}
            ax.plot(part["load_N"] * 1e3, part[column] * 1e3, **style | {"label": branch} | marks)


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
    alone, ax = ax is None, new_axes() if ax is None else ax
    ax.fill_between(thresholds, slopes - stds, slopes + stds, color=POINTS, alpha=0.25, linewidth=0)
    lines = ax.plot(thresholds, slopes, color=POINTS, label="slope ± standard uncertainty")
    ax.axhline(1.0, color=OTHER, linewidth=1)
    if np.isfinite(found):
        label = f"slope 1 at threshold {found:.3f}"
        lines.append(ax.axvline(found, color=LAW, linewidth=1.2, label=label))
    top = 1.05 * float(np.nanmax(slopes + stds, initial=1.0))
    ax.set(xlabel="threshold (fraction of the contrast)", ylabel="sum of the forces over load (slope)")
    ax.set_ylim(0, min(top, LARGEST_SLOPE))
    add_legend(ax, above=alone, handles=lines)
    return ax


def plot_forces(
    load: Values,
    forces: Values,
    *,
    slope: CoverageEstimate | None = None,
    fitted: Sequence[str] = (),
    ax: Axes | None = None,
) -> Axes:
    """Plot the sums of the forces against the loads (mN) with the line of slope 1.

    Parameters
    ----------
    load, forces : ndarray, shape (n,), N
    slope : CoverageEstimate, optional
        Fitted slope, for a second line.
    fitted : sequence of str
        Lines for the legend: other fitted values.
    ax : Axes, optional
        By default new axes with the differences from the load in a panel below; only these have it.

    Returns
    -------
    Axes
    """
    ax, below, last = axes_with_panel(ax)
    load, forces = 1e3 * np.asarray(load, float), 1e3 * np.asarray(forces, float)
    ends = np.array([0.0, 1.05 * float(np.max(load, initial=0.0))])
    for panel, less in ((ax, 0.0), (below, 1.0)):  # the sum, and the sum minus the load
        label = "\n".join(["sum equals load", *fitted])
        wide: dict[str, Any] = {"color": "0.8", "linewidth": 4}  # seen under the fitted line
        panel.plot(ends, (1 - less) * ends, label=label, **wide)
        if slope is not None:
            label = f"slope {number_with_interval(slope)}"
            panel.plot(ends, (slope.value - less) * ends, "--", color=LAW, linewidth=1.2, label=label)
        panel.plot(load, forces - less * load, "o", color=POINTS, markersize=MARKER_SIZE, label="measured")
    ax.set_ylabel("sum of the local forces (mN)")
    ax.legend(fontsize="small")
    below.set_ylabel("sum minus\nload (mN)")
    last.set_xlabel("load P (mN)")
    return ax


def plot_plateau(
    thresholds: Values,
    areas: Values,
    *,
    low: float,
    high: float,
    names: Sequence[str] = (),
    ax: Axes | None = None,
) -> Axes:
    """Plot total areas (mm^2) against the threshold with the plateau shaded.

    Parameters
    ----------
    thresholds : ndarray, shape (m,)
    areas : ndarray, shape (m, n), m^2
    low, high : float
        Ends of the plateau.
    names : sequence of str
        What each of the n curves is called, for the legend.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    alone, ax = ax is None, new_axes() if ax is None else ax
    shade = ax.axvspan(low, high, color="0.87", label=f"plateau from {low:.3f} to {high:.3f}")
    shown = np.where(areas > 0, areas * 1e6, np.nan)
    order = np.argsort(np.nan_to_num(shown).mean(axis=0), kind="stable")
    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.7, max(len(order), 1)))
    named = set(np.unique(np.linspace(0, len(order) - 1, LABELLED_CURVES).round().astype(int)).tolist())
    lines: list[Any] = [shade]
    for rank, k in enumerate(order[::-1]):
        marks: dict[str, Any] = {"color": colours[len(order) - 1 - rank], "linewidth": 1.2}
        (line,) = ax.plot(thresholds, shown[:, k], DASHES[rank % len(DASHES)], **marks)
        if len(names) and rank in named:
            line.set_label(names[k])
            lines.append(line)
    ax.set(xlabel="threshold (fraction of the contrast)", ylabel="total contact area A (mm²)")
    scale_by_decades(ax, axes="y")
    add_legend(ax, above=alone, columns=2, handles=lines)
    return ax


def plot_check(drawn: pd.DataFrame, classes: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot what became of contacts that were drawn into frames.

    Parameters
    ----------
    drawn, classes : DataFrame
        Columns of `contactimg.tables.DRAWN` and of `contactimg.tables.CHECK`.
    ax : Axes, optional
        Without it a panel below shows the errors of the radii.

    Returns
    -------
    Axes
    """
    top, below, last = axes_with_panel(ax)
    radius = classes["radius_px"].to_numpy(float)
    top.plot(radius, classes["completeness"], "o-", color="tab:blue")
    top.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
    top.set(xscale="log", ylim=(-0.05, 1.08), ylabel="share found")
    found = drawn[drawn["found"] == 1]
    error = (found["measured_px"] - found["radius_px"]).to_numpy(float)
    below.plot(found["radius_px"], error, ".", color="grey", markersize=3, alpha=0.6)
    below.errorbar(radius, classes["bias_px"], classes["rms_px"], fmt="o", color="tab:blue", capsize=2)
    below.axhline(0.0, color="grey", linewidth=0.8)
    below.set_ylabel("error / px")
    scale_by_decades(last, axes="x")
    last.set_xlabel("true radius / px")
    return top
