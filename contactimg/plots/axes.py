"""New axes that no window or global state knows about."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["image_axes", "new_axes"]


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
