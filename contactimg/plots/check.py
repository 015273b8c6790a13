"""Figure of a check: completeness and errors of drawn contacts against their radius."""

import pandas as pd
from matplotlib.axes import Axes

from contactimg.plots.axes import axes_with_panel, scale_by_decades


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
    top, below = axes_with_panel(ax)
    radius = classes["radius_px"].to_numpy(float)
    top.plot(radius, classes["completeness"], "o-", color="tab:blue")
    top.axhline(0.5, color="grey", linewidth=0.8, linestyle=":")
    top.set(xscale="log", ylim=(-0.05, 1.08), ylabel="share found")
    last = top
    if below is not None:
        found = drawn[drawn["found"] == 1]
        error = (found["measured_px"] - found["radius_px"]).to_numpy(float)
        below.plot(found["radius_px"], error, ".", color="grey", markersize=3, alpha=0.6)
        below.errorbar(radius, classes["bias_px"], classes["rms_px"], fmt="o", color="tab:blue", capsize=2)
        below.axhline(0.0, color="grey", linewidth=0.8)
        below.set_ylabel("error / px")
        last = below
    scale_by_decades(last, axes="x")
    last.set_xlabel("true radius / px")
    return top
