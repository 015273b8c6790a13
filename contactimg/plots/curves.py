"""Curves of what the contacts say together."""

import pandas as pd
from matplotlib.axes import Axes

from contactimg.plots.axes import new_axes

__all__ = ["plot_area"]


def plot_area(frames: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the real contact area (mm^2) against load (mN), with error bars, on logarithmic axes.

    Parameters
    ----------
    frames : DataFrame
        The frames table; rows without load or area are left out.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    good = frames[(frames["load_N"] > 0) & (frames["area_m2"] > 0)]
    ax.errorbar(
        good["load_N"] * 1e3,
        good["area_m2"] * 1e6,
        yerr=good["area_std_m2"] * 1e6,
        fmt="o",
        color="C0",
        capsize=3,
    )
    ax.set(xscale="log", yscale="log", xlabel="load P (mN)", ylabel="real contact area A (mm²)")
    return ax
