"""New axes on figures outside of pyplot: no window and no global state."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter


def new_axes(*, size: tuple[float, float] = (6.0, 4.5)) -> Axes:
    """Axes on a new figure outside of pyplot, ``size`` in inches."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def image_axes(shape: tuple[int, int], *, dpi: float = 100.0) -> Axes:
    """Axes that fill a new figure, 1600 screen pixels or wider, a whole number per image pixel."""
    rows, columns = shape
    zoom = max(1, int(np.ceil(1600 / columns)))
    figure = Figure(figsize=(zoom * columns / dpi, zoom * rows / dpi), dpi=dpi)
    FigureCanvasAgg(figure)
    return figure.add_axes((0, 0, 1, 1))


def scale_by_decades(ax: Axes) -> Axes:
    """Set logarithmic axes with plain numbers at 1, 2 and 5."""
    ax.set(xscale="log", yscale="log")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    return ax
