"""New axes on figures outside of pyplot: no window and no global state."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

FIGURE_INCHES = (4.6, 3.5)
"""Width and height of a figure. Chosen: text of 10 and 8.3 pt is 7 and 6 pt in a column of 85 mm."""
PANEL_INCHES = 1.2
"""Height that a panel of residuals adds."""
LEGEND_ROW_INCHES = 0.165
"""Height of a row of a legend of 8.3 pt."""
DENSE_DECADES, SPARSE_DECADES = 0.7, 2.2
"""Logarithmic axes shorter than the first have ticks at every digit, longer than the second only at powers of
ten. Chosen by eye."""
LINEAR_DECADES = 0.25
"""Shorter ones have ticks at even distances. Chosen by eye."""


def new_axes() -> Axes:
    """Axes on a new figure outside of pyplot."""
    return new_figure(FIGURE_INCHES).add_subplot()


def axes_with_panel(ax: Axes | None) -> tuple[Axes, Axes, Axes]:
    """Axes on a new figure, a low panel under them for residuals, and the lower of them, for the abscissa.

    Given axes have no panel: theirs is drawn on a figure that nobody sees.
    """
    if ax is not None:
        return ax, new_axes(), ax
    width, height = FIGURE_INCHES
    figure = new_figure((width, height + PANEL_INCHES))
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=(height - 0.6, PANEL_INCHES))
    top.tick_params(labelbottom=False)
    below.margins(y=0.15)  # the marks do not touch the frame
    return top, below, below


def new_figure(size: tuple[float, float]) -> Figure:
    """A figure outside of pyplot that is laid out when it is drawn, ``size`` in inches."""
    # 220 pixels per inch are 300 in a column of 85 mm
    figure = Figure(figsize=size, dpi=220.0, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_legend(ax: Axes, *, above: bool, columns: int = 1, **options: Any) -> None:
    """Add a legend: inside, or above the axes, where it hides nothing, on a figure made higher by as much."""
    options |= {"ncols": columns, "fontsize": "small", "title_fontsize": "small"}
    if not above:
        ax.legend(**options)
        return
    entries = options["handles"] if "handles" in options else ax.get_legend_handles_labels()[0]
    if not entries:
        return
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    ax.legend(frameon=False, alignment="left", **place, **options)
    rows = -(-len(entries) // columns) + ("title" in options)
    figure = ax.get_figure(root=True)
    if isinstance(figure, Figure):
        figure.set_figheight(figure.get_figheight() + LEGEND_ROW_INCHES * rows)


def bar_lengths(std: pd.Series, unit: float = 1.0) -> NDArray[np.float64]:
    """Lengths of error bars; zero where the uncertainty is not known."""
    return np.nan_to_num(std.to_numpy(float), nan=0.0) * unit


def scale_by_decades(ax: Axes, *, axes: str = "xy") -> Axes:
    """Set logarithmic axes (``"x"``, ``"y"`` or both) with plain numbers, at 1, 2 and 5 where they fit."""
    for name in axes:
        ax.set(**{f"{name}scale": "log"})
        low, high = getattr(ax, f"get_{name}lim")()
        axis = getattr(ax, f"{name}axis")
        decades = float(np.log10(high / low))
        subs: tuple[float, ...] = (1.0, 2.0, 5.0) if decades < SPARSE_DECADES else (1.0,)
        if decades < DENSE_DECADES:
            subs = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
        axis.set_major_locator(MaxNLocator(5) if decades < LINEAR_DECADES else LogLocator(subs=subs))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    return ax
