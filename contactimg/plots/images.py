"""Draw contacts on frames."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from contactimg.plots.axes import image_axes
from contactimg.pose import Pose
from contactimg.tables.outlines import Outline

MEASURED, COUPLED, UNCOUPLED, HERTZ = "#56b4e9", "#d55e00", "#f0e442", "#ffffff"
"""Colours of measured contacts, of the two predictions, and of the Hertz circle: of the palette of Okabe and
Ito, chosen so that they differ in grey as well."""


def crop_to(image: NDArray, x_px: NDArray, y_px: NDArray, *, margin_px: float) -> tuple[NDArray, int, int]:
    """Crop an image to the points and a margin; also return the first row and column.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    x_px, y_px : ndarray, shape (n,)
        Column and row of each point; without a point of finite coordinates the whole image is returned.
    margin_px : float
    """
    points = np.column_stack([y_px, x_px]).astype(float)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return image, 0, 0
    last = np.array(image.shape) - 1
    top, left = np.clip(points.min(axis=0) - margin_px, 0, last).astype(int).tolist()
    bottom, right = np.clip(points.max(axis=0) + margin_px, 0, last).astype(int).tolist()
    return image[top : bottom + 1, left : right + 1], top, left


def plot_image(image: NDArray, *, top: int = 0, left: int = 0, ax: Axes | None = None) -> Axes:
    """Show an image in grey between its 0.5 and 99.8 % quantiles, with pixel centres at integers.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels; may contain NaN.
    top, left : int
        Row and column of the first pixel, if the image is cropped from a larger one.
    ax : Axes, optional
        By default new axes of the size of the image.

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
    """Draw outlines of circles in data units.

    Parameters
    ----------
    x, y, radius : array_like, shape (n,)
        In the unit of the axes (pixels on an image).
    ax : Axes
    label : str
        Text for the legend; empty for none.
    **style
        Of the outlines: ``color``, ``linewidth``, ``linestyle``.
    """
    places = np.column_stack([np.asarray(part, float) for part in (x, y, radius)]).tolist()
    disks = [Outline(0, x_px, y_px, radius_px, radius_px) for x_px, y_px, radius_px in places]
    return plot_outlines(disks, ax=ax, label=label, **style)


def plot_outlines(
    outlines: Sequence[Outline], *, ax: Axes, label: str = "", **style: Any
) -> EllipseCollection:
    """Draw contacts as they were measured: circles, ellipses and, for free shapes, their lines.

    Parameters
    ----------
    outlines : sequence of Outline
    ax : Axes
    label : str
        Text for the legend; empty for none.
    **style
        Of the outlines: ``color``, ``linewidth``, ``linestyle``.

    Returns
    -------
    EllipseCollection
        Circles and ellipses, for the legend.
    """
    color = style.pop("color", MEASURED)
    lines = [line for outline in outlines for line in outline.lines]
    if lines:
        ax.add_collection(LineCollection(lines, colors=color, **style), autolim=False)
    round_ = [outline for outline in outlines if not outline.lines]
    ellipses = EllipseCollection(
        [2 * outline.semi_major for outline in round_],
        [2 * outline.semi_minor for outline in round_],
        [np.degrees(outline.angle) for outline in round_],
        units="xy",
        offsets=np.array([(outline.x, outline.y) for outline in round_]).reshape(-1, 2),
        offset_transform=ax.transData,
        facecolors="none",
        edgecolors=color,
        label=label,
        **style,
    )
    ax.add_collection(ellipses, autolim=False)
    return ellipses


def plot_scale_bar(pose: Pose, *, ax: Axes) -> Axes:
    """Draw a scale bar in the lower right corner, 1, 2 or 5 units long, at most a sixth of the width."""
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
    """Add a legend with one line per collection, which matplotlib does not draw for outlines."""
    handles = []
    for outlines in circles:
        color = mpl.colors.to_hex(np.asarray(outlines.get_edgecolor())[0])
        style: Any = outlines.get_linestyle()[0]
        handles.append(Line2D([], [], color=color, linestyle=style, label=str(outlines.get_label())))
    size = _font_size(ax)
    legend = ax.legend(
        handles=handles,
        title=title,
        loc="upper left",
        labelcolor="white",
        facecolor="black",
        framealpha=0.6,
        fontsize=size,
    )
    # titles hold file names, in which a $ is no formula
    legend.get_title().set(color="white", fontsize=size, parse_math=False)


def _font_size(ax: Axes) -> float:
    """Font size: 6 pt where the axes are a column of 85 mm wide."""
    return 72 * float(ax.bbox.width) / ax.figure.dpi / 40
