"""Pictures of a run: outlines of the measured contacts on each frame, predictions over them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.engine.calls import in_parallel
from contactimg.errors import FrameError
from contactimg.files import Experiment, FrameSource, write_palette_image
from contactimg.pipeline.frame import FrameTables
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.plots import COUPLED, HERTZ, MEASURED, UNCOUPLED, crop_to
from contactimg.plots.overlay import Layer, Picture, View, draw_overlay
from contactimg.pose import Pose
from contactimg.tables import Status
from contactimg.tables.outlines import REJECTED_COLOUR, Outline, contact_outlines, kinds_of_contacts
from contactimg.timings import stage

Values = NDArray[np.float64]

QUANTILES = (0.005, 0.998)
"""Of the grey levels, shown black and white."""
SAMPLED_FRAMES, SAMPLE_SIDE = 8, 500
"""Frames, and pixels of each along a side, that the stretch is taken from. Chosen: a fraction of a second."""
GAP_PX = 2.0
"""Distance of the ring from the contact. Chosen: leaves the rim free up to a blur of 1.4 px."""
DIMMED = 0.5
"""Brightness of frames under predictions. Chosen: lines on the rims of bright contacts stand out in print."""
LEAST_SQUARE_PX = 3.0
"""Half side of the smallest square about a rejected candidate."""


def draw_overlays(
    series: MeasuredSeries,
    experiment: Experiment,
    folder: Path,
    *,
    workers: int | None,
    numbers: bool = False,
    advance: Callable[[], None] | None = None,
) -> None:
    """Draw contacts and rejected candidates on every frame that could be measured, as PNG files.

    Parameters
    ----------
    series : MeasuredSeries
    experiment : Experiment
    folder : Path
        Is made.
    workers : int or None
        Processes that share the frames.
    numbers : bool
        Whether the label of each contact stands beside it.
    advance : callable, optional
        Called once a frame.
    """
    folder.mkdir()
    pixel_size = None if series.pose is None else series.pose.pose.pixel_size
    failed = {part.row["frame"] for part in series.parts if part.row["status"] == Status.FAILED}
    sources = [source for source in experiment.frames if source.name not in failed]
    stretch = series_stretch(sources)
    measured = ((name, shown) for name, shown in _shown(series) if name not in failed)
    jobs = (
        (source, shown, view_of(name, experiment, stretch, pixel_size), folder, numbers)
        for source, (name, shown) in zip(sources, measured, strict=True)
    )
    for _ in in_parallel(_draw_frame, jobs, count=len(sources), workers=workers):
        if advance is not None:
            advance()


def _shown(series: MeasuredSeries) -> Iterator[tuple[str, FrameTables]]:
    """Each frame with what is drawn on it."""
    for block in series.blocks():
        tables = (block.contacts, block.rejected, block.outlines)
        groups = [dict(list(table.groupby("frame"))) for table in tables]
        for name in block.frames["frame"]:
            parts = (group.get(name, table[:0]) for group, table in zip(groups, tables, strict=True))
            yield str(name), FrameTables(*parts)


@stage("pictures")
def series_stretch(sources: Sequence[FrameSource]) -> tuple[float, float]:
    """Grey levels that are shown black and white in every frame of a series."""
    step = max(1, len(sources) // SAMPLED_FRAMES)
    levels = []
    for source in sources[::step]:
        try:
            image = source.read().image
        except FrameError:
            continue
        strides = [max(1, size // SAMPLE_SIDE) for size in image.shape]
        sample = image[:: strides[0], :: strides[1]].astype(float)
        sample = sample[np.isfinite(sample)]
        if sample.size:
            levels.append(np.quantile(sample, QUANTILES))
    if not levels:
        return 0.0, 255.0
    low, high = float(np.min(levels, axis=0)[0]), float(np.max(levels, axis=0)[1])
    return low, high if high > low else low + 1.0


def file_stem(frame: str) -> str:
    """Name of a file that is made of a frame, without extension.

    Examples
    --------
    >>> file_stem("stack.tif[3]"), file_stem("frame_1.tif")
    ('stack.tif_3', 'frame_1.tif')
    """
    return frame.replace("[", "_").replace("]", "")


def view_of(
    frame: str, experiment: Experiment, stretch: tuple[float, float], pixel_size: float | None
) -> View:
    """A whole frame, with its name and load, where that is known, as title."""
    load = experiment.load_of(frame)
    title = f"{frame}, {1e3 * load:g} mN" if np.isfinite(load) else frame
    return View(stretch, title=title, pixel_size=pixel_size)


@stage("pictures")
def _draw_frame(source: FrameSource, shown: FrameTables, view: View, folder: Path, numbers: bool) -> None:  # noqa: FBT001 - a job
    """Read one frame again and draw it."""
    write_picture(draw_measured(source.read().image, shown, view, numbers=numbers), folder, source.name)


def write_picture(picture: Picture, folder: Path, frame: str) -> None:
    """Write the picture of a frame."""
    write_palette_image(picture.indices, picture.palette, folder / f"{file_stem(frame)}.png")


def draw_measured(image: NDArray, shown: FrameTables, view: View, *, numbers: bool = False) -> Picture:
    """Draw contacts, by what their flags say, and rejected candidates on their frame.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    shown : FrameTables
    view : View
    numbers : bool
        Whether the label of each contact stands beside it.
    """
    outlines = contact_outlines(shown.contacts, shown.outlines)
    flags = shown.contacts["flags"].to_numpy(np.int64)
    free = np.ones(len(flags), bool)
    layers = []
    for kind in kinds_of_contacts():
        mine = free & ((flags & kind.flags) > 0 if kind.flags else True)
        free &= ~mine
        if mine.any() or not kind.flags:
            part = [outlines[k] for k in np.flatnonzero(mine)]
            label = f"{kind.name} ({len(part)})"
            layers.append(Layer(part, kind.colour, label, kind.dashes, GAP_PX, numbered=numbers))
    if len(shown.rejected):
        places = shown.rejected[["x_px", "y_px", "radius_px"]].to_numpy(float).tolist()
        squares = [Outline(0, x, y, max(r, LEAST_SQUARE_PX), max(r, LEAST_SQUARE_PX)) for x, y, r in places]
        label = f"rejected ({len(squares)})"
        layers.append(Layer(squares, REJECTED_COLOUR, label, gap_px=GAP_PX, width=0.5, square=True))
    return draw_overlay(image, layers[::-1], view)


def draw_predicted(
    image: NDArray,
    contacts: list[Outline],
    predicted: dict[str, pd.DataFrame],
    hertz_circle: tuple[float, float, float] | None,
    *,
    pose: Pose,
    shift_px: tuple[float, float],
    view: View,
) -> Picture:
    """Draw measured and predicted contacts and the Hertz circle on a frame, as in the paper's Fig. 6.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    contacts : list of Outline
        This frame's measured contacts.
    predicted : dict
        Contacts tables of the ``"coupled"`` and the ``"uncoupled"`` model, with the columns in px.
    hertz_circle : (x, y, radius) or None
        Apparent contact of the smooth sphere, sample coordinates, m.
    pose : Pose
        Pose over the reference frame.
    shift_px : (float, float)
        Position in this frame minus position in the reference.
    view : View
        Of the whole frame; the picture shows the part that holds every contact.
    """
    layers = [Layer(contacts, MEASURED, f"measured ({len(contacts)})", width=1.6)]
    # dashed, so that the measured contact shows where they coincide
    for model, colour, dashes in (("uncoupled", UNCOUPLED, (4.0, 8.0)), ("coupled", COUPLED, (8.0, 8.0))):
        if model in predicted:
            seen = contact_outlines(predicted[model])
            layers.append(Layer(seen, colour, f"predicted, {model} ({len(seen)})", dashes, width=0.7))
    if hertz_circle is not None:
        circle = pd.DataFrame([hertz_circle], columns=["x_m", "y_m", "radius_m"])
        layers.append(Layer(_in_pixels(circle, pose, shift_px), HERTZ, "Hertz, smooth sphere", (16.0, 10.0)))
    seen = [outline for layer in layers if layer.colour != HERTZ for outline in layer.outlines]
    x, y = (np.array([getattr(outline, name) for outline in seen]) for name in ("x", "y"))
    part, top, left = crop_to(image, x, y, margin_px=0.05 * max(image.shape))
    low, high = view.stretch
    dimmed = low, low + (high - low) / DIMMED
    return draw_overlay(part, layers, replace(view, stretch=dimmed, top=top, left=left))


def _in_pixels(contacts: pd.DataFrame, pose: Pose, shift_px: tuple[float, float]) -> list[Outline]:
    """Disks (px) of contacts given in sample coordinates."""
    x, y = pose.to_pixels(contacts["x_m"], contacts["y_m"])
    radius = contacts["radius_m"].to_numpy(float) / pose.pixel_size
    places = np.column_stack([x + shift_px[0], y + shift_px[1], radius]).tolist()
    return [Outline(0, x, y, radius, radius) for x, y, radius in places]
