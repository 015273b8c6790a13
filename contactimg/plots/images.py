"""Draw contacts on frames."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from numpy.typing import ArrayLike, NDArray

from contactimg.plots.axes import new_axes
from contactimg.plots.overlay import MEASURED, black_and_white


def plot_image(image: NDArray, *, top: int = 0, left: int = 0, ax: Axes | None = None) -> Axes:
    """Show an image in grey between its 0.5 and 99.8 % quantiles, with pixel centres at integers.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels; may contain NaN.
    top, left : int
        Row and column of the first pixel, if the image is cropped from a larger one.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    low, high = black_and_white(image) or (0.0, 1.0)
    rows, columns = image.shape
    extent = (left - 0.5, left + columns - 0.5, top + rows - 0.5, top - 0.5)
    ax.imshow(image, cmap="gray", vmin=low, vmax=max(high, low + 1), interpolation="nearest", extent=extent)
    ax.set_axis_off()
    return ax


def plot_circles(
    x: ArrayLike, y: ArrayLike, radius: ArrayLike, *, ax: Axes, color: str = MEASURED, **style: Any
) -> EllipseCollection:
    """Draw outlines of circles in data units.

    Parameters
    ----------
    x, y, radius : array_like, shape (n,)
        In the unit of the axes (pixels on an image).
    ax : Axes
    color : str
    **style
        Of the outlines: ``label``, ``linewidth``, ``linestyle``.
    """
    style |= {"offsets": np.column_stack([x, y]).astype(float), "offset_transform": ax.transData}
    style |= {"units": "xy", "facecolors": "none", "edgecolors": color}
    sizes = 2 * np.asarray(radius, float)
    circles = EllipseCollection(sizes, sizes, np.zeros_like(sizes), **style)
    ax.add_collection(circles, autolim=False)
    return circles
