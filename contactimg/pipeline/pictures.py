"""Pictures of a run: measured outlines on each frame, predictions over them."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from numpy.typing import NDArray

from contactimg.plots import (
    COUPLED,
    HERTZ,
    MEASURED,
    UNCOUPLED,
    legend_of_circles,
    plot_circles,
    plot_image,
    plot_scale_bar,
)
from contactimg.pose import Pose

__all__ = ["draw_measured", "draw_predicted"]


def draw_measured(
    image: NDArray, contacts: pd.DataFrame, *, pose: Pose | None, title: str, ax: Axes | None = None
) -> Axes:
    """Draw the outlines of the measured contacts on their frame.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    contacts : DataFrame
        This frame's contacts.
    pose : Pose or None
        For the scale bar.
    title : str
        Title of the legend.
    ax : Axes, optional
        Default: new axes of the image's size.
    """
    ax = plot_image(image, ax=ax)
    circles = [_measured(contacts, ax)]
    return _finish(ax, circles, pose, title)


def draw_predicted(
    image: NDArray,
    contacts: pd.DataFrame,
    predicted: dict[str, pd.DataFrame],
    hertz_circle: tuple[float, float, float] | None,
    *,
    pose: Pose,
    shift_px: tuple[float, float],
    title: str,
) -> Axes:
    """Draw measured and predicted contacts and the Hertz circle on a frame, as in the paper's Fig. 6.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    contacts : DataFrame
        This frame's measured contacts.
    predicted : dict
        Contacts tables of the ``"coupled"`` and the ``"uncoupled"`` model.
    hertz_circle : (x, y, radius) or None
        Apparent contact of the smooth sphere, sample coordinates, m.
    pose : Pose
        Pose over the reference frame.
    shift_px : (float, float)
        Position in this frame minus position in the reference.
    title : str
        Title of the legend.
    """
    ax = plot_image(image)
    circles = []
    for model, color in (("uncoupled", UNCOUPLED), ("coupled", COUPLED)):
        if model in predicted:
            circles.append(
                _in_pixels(predicted[model], pose, shift_px, ax=ax, color=color, label=f"predicted, {model}")
            )
    circles.append(_measured(contacts, ax))
    if hertz_circle is not None:
        x, y, radius = (np.atleast_1d(value) for value in hertz_circle)
        circle = pd.DataFrame({"x_m": x, "y_m": y, "radius_m": radius})
        circles.append(
            _in_pixels(
                circle, pose, shift_px, ax=ax, color=HERTZ, label="Hertz, smooth sphere", linestyle="--"
            )
        )
    return _finish(ax, circles, pose, title)


def _measured(contacts: pd.DataFrame, ax: Axes) -> EllipseCollection:
    """Outlines of measured contacts."""
    return plot_circles(
        contacts["x_px"],
        contacts["y_px"],
        contacts["radius_px"],
        ax=ax,
        color=MEASURED,
        linewidth=0.9,
        label=f"measured ({len(contacts)})",
    )


def _in_pixels(
    contacts: pd.DataFrame,
    pose: Pose,
    shift_px: tuple[float, float],
    *,
    ax: Axes,
    color: str,
    label: str,
    linestyle: str = "-",
) -> EllipseCollection:
    """Outlines of contacts given in sample coordinates."""
    x, y = pose.to_pixels(contacts["x_m"], contacts["y_m"])
    return plot_circles(
        x + shift_px[0],
        y + shift_px[1],
        contacts["radius_m"].to_numpy(float) / pose.pixel_size,
        ax=ax,
        color=color,
        linewidth=0.9,
        linestyle=linestyle,
        label=f"{label} ({len(contacts)})" if len(contacts) > 1 else label,
    )


def _finish(ax: Axes, circles: list[EllipseCollection], pose: Pose | None, title: str) -> Axes:
    """Legend and scale bar."""
    legend_of_circles(circles, ax=ax, title=title)
    if pose is not None:
        plot_scale_bar(pose, ax=ax)
    return ax
