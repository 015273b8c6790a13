"""Pictures of a run: outlines of the measured contacts on each frame, predictions over them."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from contactimg.engine.parallel import in_parallel
from contactimg.errors import FrameError
from contactimg.files import Experiment, FrameSource, FrameTables, write_palette_image
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.pooled_background import evenly_spread
from contactimg.plots import overlay
from contactimg.tables import Status
from contactimg.tables.outlines import KINDS_OF_CONTACTS, REJECTED_COLOUR, Outline, kind_of

Values = NDArray[np.float64]

GAP_PX = 2.0
"""Distance of the ring from the contact. Chosen: leaves the rim free up to a blur of 1.4 px."""
MARKS: dict[str, tuple[str, tuple[float, ...], float, float]] = {
    "matched": (overlay.MEASURED, (), 0.0, 1.5),
    "measured, not predicted": (overlay.COUPLED, (), GAP_PX, 3.0),
    "predicted, not measured": (overlay.UNCOUPLED, (9.0, 6.0), 0.0, 3.0),
}
"""Kind of a contact under a prediction -> colour, dashes, gap and width of its line."""
PREDICTED = "predicted"
"""All contacts of a model, which the inset shows."""
LEAST_PANEL_PX, INSET_ZOOM = 800, 3
"""Width of the picture of one model, two of which stand side by side, and what an inset is enlarged by."""
LEAST_SQUARE_PX = 3.0
"""Half side of the smallest square about a rejected candidate."""


def draw_overlays(series: MeasuredSeries, experiment: Experiment, folder: Path) -> None:
    """Draw contacts and rejected candidates on every frame that could be measured, as PNG files.

    Parameters
    ----------
    series : MeasuredSeries
    experiment : Experiment
    folder : Path
        Is made.
    """
    pixel_size = None if series.pose is None else series.pose.pose.pixel_size
    names = [part.row["frame"] for part in series.parts if part.row["status"] != Status.FAILED]
    shown = (one for block in series.blocks() for one in block.run.by_frame())
    drawings = ((name, partial(draw_measured, shown=tables)) for name, tables in shown)
    draw_frames(experiment, names, drawings, folder, pixel_size=pixel_size)


def draw_frames(
    experiment: Experiment,
    names: Collection[str],
    drawings: Iterable[tuple[str, Callable[..., overlay.Picture]]],
    folder: Path,
    *,
    pixel_size: float | None,
) -> None:
    """Read frames of an experiment again, and write what a function draws of each, as PNG files.

    Parameters
    ----------
    experiment : Experiment
    names : collection of str
        Of the frames that are drawn.
    drawings : iterable of (str, callable)
        Name of a frame, and the function of its image and of the `View` that draws it.
    folder : Path
        Is made.
    pixel_size : float or None, m
    """
    folder.mkdir()
    sources = {source.name: source for source in experiment.frames if source.name in names}
    stretch = series_stretch(list(sources.values()))

    def draw(name: str, drawing: Callable[..., overlay.Picture]) -> None:
        """Read one frame again and draw it; its name and its load, where that is known, are the title."""
        load = experiment.load_of(name)
        title = f"{name}, {1e3 * load:g} mN" if np.isfinite(load) else name
        view = overlay.View(stretch, title=title, pixel_size=pixel_size)
        picture = drawing(sources[name].read().image, view=view)
        write_palette_image(picture.indices, picture.palette, folder / f"{file_stem(name)}.png")

    jobs = (job for job in drawings if job[0] in sources)
    deque(in_parallel(draw, jobs, count=len(sources), shown="drawing overlays"), maxlen=0)


def series_stretch(sources: Sequence[FrameSource]) -> tuple[float, float]:
    """Grey levels that are shown black and white in every frame of a series."""
    levels = list[float]()
    for source in evenly_spread(sources, 8):  # chosen: a fraction of a second
        with suppress(FrameError):
            levels += overlay.black_and_white(source.read().image)
    low, high = min(levels, default=0.0), max(levels, default=255.0)
    return low, high if high > low else low + 1.0


def file_stem(frame: str) -> str:
    """Name of a file that is made of a frame, without extension.

    Examples
    --------
    >>> file_stem("stack.tif[3]"), file_stem("frame_1.tif")
    ('stack.tif_3', 'frame_1.tif')
    """
    return frame.replace("[", "_").replace("]", "")


def draw_measured(image: NDArray, shown: FrameTables, view: overlay.View) -> overlay.Picture:
    """Draw contacts, by what their flags say, and rejected candidates on their frame.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    shown : FrameTables
    view : overlay.View
    """
    kinds = [kind_of(flags) for flags in shown.contacts["flags"]]
    outlines, layers = shown.shapes, []
    for kind in KINDS_OF_CONTACTS:
        part = [outline for outline, own in zip(outlines, kinds, strict=True) if own is kind]
        if part or not kind.flags:
            label = f"{kind.name} ({len(part)})"
            layers.append(overlay.Layer(part, kind.colour, label, kind.dashes, GAP_PX))
    if len(shown.rejected):
        places = shown.rejected[["x_px", "y_px", "radius_px"]].to_numpy(float).tolist()
        squares = [Outline(0, x, y, max(r, LEAST_SQUARE_PX), max(r, LEAST_SQUARE_PX)) for x, y, r in places]
        label = f"rejected ({len(squares)})"
        layers.append(overlay.Layer(squares, REJECTED_COLOUR, label, gap_px=GAP_PX, width=0.5, square=True))
    return overlay.draw_overlay(image, layers[::-1], view)


def draw_predicted(
    image: NDArray,
    marked: Mapping[str, Mapping[str, list[Outline]]],
    hertz_circle: Sequence[Outline] = (),
    *,
    view: overlay.View,
) -> overlay.Picture:
    """Draw for each model which contacts are measured and predicted, as in the paper's Fig. 6, and an inset.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
    marked : mapping
        Model -> kind, one of `MARKS` or `PREDICTED` -> these contacts of the frame.
    hertz_circle : sequence of Outline
        Apparent contact of the smooth sphere.
    view : overlay.View
        Of the whole frame; the picture shows the part that holds every contact.
    """

    def places(kinds: Iterable[str]) -> Values:
        shown = [one for contacts in marked.values() for kind in kinds for one in contacts[kind]]
        return np.array([(one.x, one.y) for one in shown]).reshape(-1, 2)

    every, away = places(MARKS), places([kind for kind in MARKS if kind != "matched"])
    x, y = every.T
    part, top, left = overlay.crop_to(image, x, y, margin_px=0.05 * max(image.shape))
    zoom = max(1, -(-LEAST_PANEL_PX // part.shape[1]))
    low, high = view.stretch
    # half as bright, by hand: lines on the rims of bright contacts stand out in print
    view = replace(view, stretch=(low, low + 2 * (high - low)), top=top, left=left, zoom=zoom)
    rows, columns = part.shape
    size = np.maximum([columns // INSET_ZOOM, rows // INSET_ZOOM // 2], 1)
    corner = _busiest(away if len(away) else every, size) - (left, top)
    u, v = np.clip(corner, 0, (columns, rows) - size).astype(int).tolist()
    inset = replace(view, top=top + v, left=left + u, zoom=INSET_ZOOM * zoom, pixel_size=None)
    rim = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * size + (left + u, top + v)
    box = Outline(0, float(rim[0, 0]), float(rim[0, 1]), 0.0, 0.0, lines=(rim,))
    smooth = "Hertz, smooth sphere" if hertz_circle else ""
    circle = overlay.Layer(hertz_circle, overlay.HERTZ, smooth, (16.0, 10.0))
    rectangle = overlay.Layer([box], overlay.HERTZ, "")
    pictures = []
    for model, kinds in marked.items():
        layers = [
            overlay.Layer(kinds[kind], colour, f"{kind} ({len(kinds[kind])})", dashes, gap, width)
            for kind, (colour, dashes, gap, width) in MARKS.items()
        ]
        named = replace(view, title=f"{view.title}, {model}")
        whole = overlay.draw_overlay(part, [*layers, circle, rectangle], named)
        unnamed = [replace(layer, label="") for layer in layers]
        rims = overlay.Layer(kinds[PREDICTED], overlay.HERTZ, "predicted", (5.0, 5.0), width=0.7)
        title = f"the white rectangle, {INSET_ZOOM} times as large"
        cut = part[v : v + size[1], u : u + size[0]]
        pictures.append([whole, overlay.draw_overlay(cut, [*unnamed, rims], replace(inset, title=title))])
    return overlay.join_pictures(pictures)


def _busiest(points: Values, size: NDArray[Any]) -> Values:
    """Upper left corner of the part of that size, about one of the points, that holds most of them."""
    if not len(points):
        return np.zeros(2)
    tree = KDTree(2 * points / size)
    held = tree.query_ball_point(tree.data, 1.0, p=np.inf, return_length=True)
    return np.asarray(points[np.argmax(held)] - size / 2, np.float64)
