"""Contacts drawn on their frames."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from contactimg.plots.axes import image_axes
from contactimg.pose import Pose

MEASURED, COUPLED, UNCOUPLED, HERTZ = "#35b5ff", "#3fe04f", "#ff4040", "#ffffff"
"""Colours of measured contacts, of the two predictions, and of the Hertz circle (the paper's Fig. 6)."""


def crop_to(image: NDArray, x_px: NDArray, y_px: NDArray, *, margin_px: float) -> tuple[NDArray, int, int]:
    """Part of an image that holds all points and a margin, and its first row and column.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    x_px, y_px : ndarray, shape (n,)
        Column and row of each point; without points the whole image is returned.
    margin_px : float
    """
    if len(x_px) == 0:
        return image, 0, 0
    rows, columns = image.shape
    top, left = max(0, int(np.min(y_px) - margin_px)), max(0, int(np.min(x_px) - margin_px))
    bottom = min(rows, int(np.max(y_px) + margin_px) + 1)
    right = min(columns, int(np.max(x_px) + margin_px) + 1)
    return image[top:bottom, left:right], top, left


def plot_image(image: NDArray, *, top: int = 0, left: int = 0, ax: Axes | None = None) -> Axes:
    """Show an image in grey, pixel centres at integers, stretched between its 0.5 and 99.8 % levels.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels; holes may be NaN.
    top, left : int
        Row and column of its first pixel, if it is a part of a larger image.
    ax : Axes, optional
        Default: new axes of the image's size.

    Returns
    -------
    Axes
    """
    ax = image_axes(image.shape) if ax is None else ax
    sample = np.asarray(image[:: max(1, image.shape[0] // 500), :: max(1, image.shape[1] // 500)], float)
    sample = sample[np.isfinite(sample)]
    low, high = np.percentile(sample, [0.5, 99.8]) if sample.size else (0.0, 1.0)
    rows, columns = image.shape
    extent = (left - 0.5, left + columns - 0.5, top + rows - 0.5, top - 0.5)
    ax.imshow(image, cmap="gray", vmin=low, vmax=max(high, low + 1), interpolation="nearest", extent=extent)
    ax.set_axis_off()
    return ax


def plot_circles(
    x: NDArray | pd.Series,
    y: NDArray | pd.Series,
    radius: NDArray | pd.Series,
    *,
    ax: Axes,
    label: str = "",
    **style: Any,
) -> EllipseCollection:
    """Draw outlines of circles given in data units, and enter them in the legend under ``label``.

    Parameters
    ----------
    x, y, radius : array_like, shape (n,)
        Same unit as the axes (pixels on an image).
    ax : Axes
    label : str
        Text of the legend; empty for none.
    **style
        Of the collection: ``color``, ``linewidth``, ``linestyle``.
    """
    diameter = 2 * np.asarray(radius, float)
    color = style.pop("color", MEASURED)
    circles = EllipseCollection(
        diameter,
        diameter,
        np.zeros_like(diameter),
        units="xy",
        offsets=np.column_stack([np.asarray(x, float), np.asarray(y, float)]),
        offset_transform=ax.transData,
        facecolors="none",
        edgecolors=color,
        label=label,
        **style,
    )
    ax.add_collection(circles, autolim=False)
    return circles


def plot_scale_bar(pose: Pose, *, ax: Axes) -> Axes:
    """Draw a bar of a round length, up to a sixth of the axes wide, in the lower right corner."""
    left, right = ax.get_xlim()
    bottom, top = ax.get_ylim()
    target = (right - left) * pose.pixel_size / 6
    decade = 10.0 ** np.floor(np.log10(target))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= target)
    width = length / pose.pixel_size
    x, y = right - 0.04 * (right - left) - width, bottom + 0.05 * (top - bottom)
    ax.plot([x, x + width], [y, y], color="white", linewidth=3, solid_capstyle="butt")
    text = f"{length * 1e3:g} mm" if length >= 1e-3 else f"{length * 1e6:g} µm"
    y += 0.012 * (top - bottom)
    ax.text(x + width / 2, y, text, color="white", ha="center", va="bottom", fontsize=_font_size(ax))
    return ax


def legend_of_circles(circles: Sequence[EllipseCollection], *, ax: Axes, title: str = "") -> None:
    """Legend with one line a collection: the collections themselves have no handle that shows an outline."""
    handles = [
        Line2D(
            [],
            [],
            color=mpl.colors.to_hex(c.get_edgecolor()[0]),
            linestyle=c.get_linestyle()[0],
            label=str(c.get_label()),
        )
        for c in circles
    ]
    style = {"labelcolor": "white", "facecolor": "black", "framealpha": 0.6, "fontsize": _font_size(ax)}
    legend = ax.legend(handles=handles, title=title, loc="upper left", **style)
    # titles hold names of files, in which a $ is a $
    legend.get_title().set(color="white", fontsize=_font_size(ax), parse_math=False)


def _font_size(ax: Axes) -> float:
    """Size of letters that can be read when the whole picture is looked at."""
    return 0.0065 * float(ax.bbox.width)
