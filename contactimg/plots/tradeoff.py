"""Error against time, a panel a knob."""

import textwrap
from itertools import pairwise

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from contactimg.plots.axes import new_axes

__all__ = ["plot_knob", "plot_tradeoff"]

TITLES = {
    "image": "measurement of a frame",
    "model": "contact model",
    "solver": "tolerance of the solver",
    "sums": "coupling sums over many contacts",
    "rings": "rings of Greenwood-Tripp",
    "patterns": "patterns of an ensemble",
    "supersampling": "sampling of rendered frames",
}

LOWEST = 1e-16
"""Error at which smaller ones are drawn: rounding."""

PANEL = (5.2, 4.0)
"""Width and height of a panel, inches."""

COLUMNS = 2
LABEL_WIDTH = 22  # characters


def plot_knob(table: pd.DataFrame, *, relative: float | None = None, ax: Axes | None = None) -> Axes:
    """Plot the error of a knob's settings against their time, the front marked.

    Parameters
    ----------
    table : DataFrame
        Of the schema `contactimg.tradeoff.knobs.TRADEOFF`, of one knob; rows without numbers are left out.
    relative : float, optional
        Tolerance, drawn as a line.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    known = table[table["error"].notna() & table["time_s"].notna()].sort_values("time_s")
    x, y = known["time_s"].to_numpy(float), np.maximum(known["error"].to_numpy(float), LOWEST)
    front = (known["pareto"] == 1).to_numpy(bool)
    ax.plot(x[front], y[front], "-", color="tab:blue", linewidth=1, drawstyle="steps-post")
    ax.plot(x[front], y[front], "o", color="tab:blue", label="cheapest for its error")
    ax.plot(x[~front], y[~front], "o", color="grey", markerfacecolor="none", label="beaten in both")
    if relative is not None:
        ax.axhline(relative, color="tab:green", linestyle="--", linewidth=1, label=f"{100 * relative:g} %")
    name = str(table["knob"].iloc[0])
    output = str(table["output"].iloc[0])
    ax.set(xscale="log", yscale="log", xlabel="time (s)", ylabel=f"relative error of the {output}")
    ax.set_title(TITLES.get(name, name), fontsize="medium")
    _leave_room(ax, x, np.append(y, [] if relative is None else relative))
    _label(ax, x, y, known["setting"].tolist())
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(numticks=8))
        axis.set_minor_formatter(NullFormatter())
    return ax


def plot_tradeoff(table: pd.DataFrame, *, relative: float | None = None) -> Axes:
    """Plot all knobs on one figure.

    Parameters
    ----------
    table : DataFrame
        Of the schema `contactimg.tradeoff.knobs.TRADEOFF`.
    relative : float, optional
        Tolerance, drawn as a line.

    Returns
    -------
    Axes
        The first panel; its figure holds the others.
    """
    groups = [part for _, part in table.groupby("knob", sort=False)]
    columns = min(COLUMNS, len(groups))
    rows = -(-len(groups) // columns)
    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows), layout="constrained", dpi=130)
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, part in zip(panels, groups, strict=False):
        plot_knob(part, relative=relative, ax=ax)
    for ax in panels[len(groups) :]:
        ax.axis("off")
    panels[0].legend(fontsize="small", loc="best")
    return panels[0]


def _leave_room(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Limits with room for the labels, half a decade or more."""
    if not len(x):
        return
    span = max(np.log10(x.max() / x.min()), 0.5)
    ax.set_xlim(x.min() / 10 ** (0.12 * span), x.max() * 10 ** (0.45 * span))
    height = max(np.log10(y.max() / y.min()), 0.5)
    ax.set_ylim(y.min() / 10 ** (0.15 * height), y.max() * 10 ** (0.15 * height))


def _label(ax: Axes, x: np.ndarray, y: np.ndarray, names: list[str]) -> None:
    """Names right of the points, moved up or down from each other where they would overlap."""
    low, high = np.log10(ax.get_ylim())
    heights = [1 + _lines(name).count("\n") for name in names]
    place = (np.log10(y) - low) / (high - low)
    wanted, line = place.copy(), 0.045
    order = np.argsort(-place, kind="stable")
    for before, after in pairwise(order):
        apart = line * (heights[before] + heights[after]) / 2
        wanted[after] = min(wanted[after], wanted[before] - apart)
    lowest = wanted.min(initial=np.inf)
    if lowest < 0.02 and len(wanted):
        wanted += 0.02 - lowest
    for name, a, b, height in zip(names, x, y, wanted, strict=True):
        ax.annotate(
            _lines(name),
            (a, b),
            xytext=(9, (height - (np.log10(b) - low) / (high - low)) * 72 * PANEL[1] * 0.75),
            textcoords="offset points",
            fontsize=7,
            va="center",
        )


def _lines(name: str) -> str:
    """A name on as many lines as its length wants."""
    return textwrap.fill(name, LABEL_WIDTH)
