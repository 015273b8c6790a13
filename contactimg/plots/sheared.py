"""Figures of contacts under a tangential load: areas of single contacts, and one contact as a strip."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from contactimg.plots.axes import new_axes, new_figure, scale_by_decades
from contactimg.plots.images import plot_image

STRIP_INCHES, MOST_IN_A_ROW = 1.1, 6
"""Side of a picture of the strip, and pictures beside each other. Chosen by eye."""


def plot_sheared_areas(followed: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the area of each contact against the tangential load, coloured by its size.

    Parameters
    ----------
    followed : DataFrame
        Columns of `contactimg.tables.FOLLOWED`; rows without contact or tangential load are not drawn. A line
        joins the frames of a contact in the order of its tangential loads at each normal load.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    known = followed[followed["touches"] & followed["tangential_N"].notna()]
    known = known.assign(force=known["tangential_N"].abs() * 1e3, area=known["area_m2"] * 1e12)
    keys = ["place"] if known.get("place", pd.Series(dtype=str)).ne("").any() else []
    lines, sizes = [], []
    for _, part in known.groupby([*keys, "load_N", "asperity"], dropna=False):
        points = part.sort_values("force")[["force", "area"]].to_numpy(float)
        lines.append(points)
        sizes.append(float(np.sqrt(points[:, 1].max() / np.pi)))
    if lines:
        norm = LogNorm(min(sizes), max(*sizes, 1.001 * min(sizes)))
        ax.add_collection(LineCollection(lines, array=sizes, cmap="viridis", norm=norm, linewidths=0.8))
        x, y = np.concatenate(lines).T
        ax.scatter(x, y, c=np.repeat(sizes, [len(one) for one in lines]), cmap="viridis", norm=norm, s=6)
        scale = ax.figure.colorbar(ScalarMappable(norm, "viridis"), ax=ax, label="largest radius (µm)")
        scale_by_decades(scale.ax, axes="y")
        ax.autoscale()
    scale_by_decades(ax, axes="y")
    ax.set(xlabel="tangential load |Q| (mN)", ylabel="contact area (µm²)")
    ax.xaxis.set_major_locator(MaxNLocator(6))
    return ax


def plot_strip(pictures: Sequence[tuple[str, NDArray]]) -> Axes:
    """Show pictures of one contact side by side, all with the same grey levels.

    Parameters
    ----------
    pictures : sequence of (str, ndarray)
        Name and pixels of each, one at least.

    Returns
    -------
    Axes
        The first of one a picture.
    """
    columns = min(len(pictures), MOST_IN_A_ROW)
    rows = -(-len(pictures) // columns)
    figure = new_figure((STRIP_INCHES * columns, (STRIP_INCHES + 0.2) * rows))
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    low = min(float(np.nanmin(pixels)) for _, pixels in pictures)
    high = max(float(np.nanmax(pixels)) for _, pixels in pictures)
    for ax in every[len(pictures) :]:
        ax.set_axis_off()
    for ax, (name, pixels) in zip(every, pictures, strict=False):
        plot_image(pixels, ax=ax).images[0].set_clim(low, high)
        ax.set_title(name, fontsize="small")
    return every[0]
