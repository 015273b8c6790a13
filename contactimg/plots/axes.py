"""New axes that no window or global state knows about."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter


def new_axes(*, size: tuple[float, float] = (6.0, 4.5)) -> Axes:
    """Axes on a new figure that no window or global state knows about."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def image_axes(shape: tuple[int, int], *, dpi: float = 100.0) -> Axes:
    """Axes that fill a new figure: whole screen pixels for each of the image's, 1600 across or more."""
    rows, columns = shape
    zoom = max(1, int(np.ceil(1600 / columns)))
    figure = Figure(figsize=(zoom * columns / dpi, zoom * rows / dpi), dpi=dpi)
    FigureCanvasAgg(figure)
    return figure.add_axes((0, 0, 1, 1))


def scale_by_decades(ax: Axes) -> Axes:
    """Logarithmic axes with plain numbers at 1, 2 and 5."""
    ax.set(xscale="log", yscale="log")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    return ax
