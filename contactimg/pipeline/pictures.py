"""Pictures of a run: outlines of the measured contacts on each frame, predictions over them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from numpy.typing import NDArray

from contactimg.files import Experiment, FrameSource, write_figure
from contactimg.pipeline.parallel import in_parallel
from contactimg.pipeline.run import Run
from contactimg.plots import (
    COUPLED,
    HERTZ,
    MEASURED,
    UNCOUPLED,
    crop_to,
    legend_of_circles,
    plot_circles,
    plot_image,
    plot_outlines,
    plot_scale_bar,
)
from contactimg.pose import Pose
from contactimg.tables import CONTACTS, OUTLINES, Status
from contactimg.tables.outlines import Outline, contact_outlines
from contactimg.timings import stage

Values = NDArray[np.float64]


def draw_overlays(
    run: Run,
    experiment: Experiment,
    folder: Path,
    *,
    workers: int | None,
    advance: Callable[[], None] | None = None,
) -> None:
    """Draw the measured contacts on every frame that could be measured, as PNG files."""
    folder.mkdir()
    failed = set(run.frames.loc[run.frames["status"] == Status.FAILED, "frame"])
    pose = None if run.pose is None else run.pose.pose
    sources = [source for source in experiment.frames if source.name not in failed]
    groups = dict(list(run.contacts.groupby("frame")))
    lines = dict(list(run.outlines.groupby("frame")))
    jobs = (
        (
            source,
            contact_outlines(
                groups.get(source.name, CONTACTS.empty()), lines.get(source.name, OUTLINES.empty())
            ),
            pose,
            folder,
        )
        for source in sources
    )
    for _ in in_parallel(_draw_frame, jobs, count=len(sources), workers=workers):
        if advance is not None:
            advance()


def picture_name(frame: str) -> str:
    """File name of the picture of a frame."""
    return frame.replace("[", "_").replace("]", "") + ".png"


@stage("pictures")
def _draw_frame(source: FrameSource, contacts: list[Outline], pose: Pose | None, folder: Path) -> None:
    """Read one frame again and draw it."""
    ax = draw_measured(source.read().image, contacts, pose=pose, title=source.name)
    write_figure(ax, folder / picture_name(source.name))


def draw_measured(
    image: NDArray, contacts: list[Outline], *, pose: Pose | None, title: str, ax: Axes | None = None
) -> Axes:
    """Draw the outlines of the measured contacts on their frame.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    contacts : list of Outline
        This frame's contacts.
    pose : Pose or None
        For the scale bar.
    title : str
        Title of the legend.
    ax : Axes, optional
        Default: new axes of the image's size.
    """
    circles = [_measured(contacts, ax := plot_image(image, ax=ax))]
    return _finish(ax, circles, pose, title)


def draw_predicted(
    image: NDArray,
    contacts: list[Outline],
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
    contacts : list of Outline
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
    ax = _region(image, contacts, predicted)
    circles = []
    for model, color, width in (("uncoupled", UNCOUPLED, 1.2), ("coupled", COUPLED, 2.4)):
        if model in predicted:
            x, y, radius = _in_pixels(predicted[model], pose, shift_px)
            label = f"predicted, {model} ({len(x)})" if len(x) > 1 else f"predicted, {model}"
            circles.append(plot_circles(x, y, radius, ax=ax, color=color, linewidth=width, label=label))
    circles.append(_measured(contacts, ax))
    if hertz_circle is not None:
        x, y, radius = (np.atleast_1d(value) for value in hertz_circle)
        circle = pd.DataFrame({"x_m": x, "y_m": y, "radius_m": radius})
        x, y, radius = _in_pixels(circle, pose, shift_px)
        label = "Hertz, smooth sphere"
        circles.append(
            plot_circles(x, y, radius, ax=ax, color=HERTZ, linewidth=1.5, linestyle="--", label=label)
        )
    return _finish(ax, circles, pose, title)


def _region(image: NDArray, contacts: list[Outline], predicted: dict[str, pd.DataFrame]) -> Axes:
    """The part of the image that holds every contact."""
    measured = [[contact.x for contact in contacts], [contact.y for contact in contacts]]
    x, y = (
        np.concatenate([known, *(table[name].to_numpy(float) for table in predicted.values())])
        for known, name in zip(measured, ("x_px", "y_px"), strict=True)
    )
    part, top, left = crop_to(image, x, y, margin_px=0.05 * max(image.shape))
    return plot_image(part, top=top, left=left)


def _measured(contacts: list[Outline], ax: Axes) -> EllipseCollection:
    """Outlines of measured contacts."""
    label = f"measured ({len(contacts)})"
    return plot_outlines(contacts, ax=ax, color=MEASURED, linewidth=0.9, label=label)


def _in_pixels(
    contacts: pd.DataFrame, pose: Pose, shift_px: tuple[float, float]
) -> tuple[Values, Values, Values]:
    """Column, row and radius (px) of contacts given in sample coordinates."""
    x, y = pose.to_pixels(contacts["x_m"], contacts["y_m"])
    return x + shift_px[0], y + shift_px[1], contacts["radius_m"].to_numpy(float) / pose.pixel_size


def _finish(ax: Axes, circles: list[EllipseCollection], pose: Pose | None, title: str) -> Axes:
    """Legend and scale bar."""
    legend_of_circles(circles, ax=ax, title=title)
    if pose is not None:
        plot_scale_bar(pose, ax=ax)
    return ax
