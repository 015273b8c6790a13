"""Measure the frames of an experiment one by one, and some again with what all frames say together."""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.files import Experiment, FrameSource
from contactimg.frame import Frame
from contactimg.imaging.fit.pooling import gain_of_pooling, pool_optics
from contactimg.imaging.measure import ImageMeasurement, measure_image
from contactimg.imaging.profile.film_rim import FilmRim
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.optics.recipe import lamp
from contactimg.pipeline.frame_options import failed_row, frame_options
from contactimg.pipeline.local_forces import common_radius
from contactimg.pipeline.measure import contacts_table, rejected_table
from contactimg.pipeline.parallel import in_parallel
from contactimg.scene import Scene, Simulate
from contactimg.tables import CONTACTS, REJECTED
from contactimg.tradeoff.choice import Choice, measure_cheapest

logger = logging.getLogger(__name__)

WORTH = 1.5  # times smaller the uncertainty of the sum of a^3 must become for a frame to be measured again


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """One frame's part of a run, in pixels.

    Parameters
    ----------
    contacts, rejected : DataFrame
    row : dict
        Of the frames table.
    shape : (int, int) or None
        Rows and columns; None for a frame that failed.
    own : SharedOptics or None
        What the frame alone shows of contrast and blur, grey levels; None where it shows nothing.
    level : float
        Of its background; 0 where that was subtracted before.
    choice : Choice or None
        How it was measured and why, where that was chosen for a tolerance.
    """

    contacts: pd.DataFrame
    rejected: pd.DataFrame
    row: dict[str, Any]
    shape: tuple[int, int] | None
    own: SharedOptics | None = None
    level: float = 0.0
    choice: Choice | None = None

    @property
    def relative(self) -> SharedOptics | None:
        """What it shows, with the contrast over the level of its background, which cancels drifts."""
        return None if self.own is None else self.own.scaled(1.0 / (self.level or 1.0))

    def chosen(self, choice: Choice | None) -> "MeasuredFrame":
        """The same with the choice of the method and what it says."""
        if choice is None:
            return self
        message = "; ".join(text for text in (self.row["message"], str(choice)) if text)
        return replace(self, row=self.row | {"message": message}, choice=choice)

    def summary(self) -> str:
        """One line about the frame."""
        numbers = (f"{key} {value:.4g}" for key, value in self.row.items() if isinstance(value, float))
        return f"{self.row['frame']}: {self.row['status']}, {len(self.contacts)} contacts, " + ", ".join(
            numbers
        )


def film_rim(scene: Scene, sites: pd.DataFrame | None) -> FilmRim | None:
    """The rim that the air film draws around contacts, where the scene switches it on.

    Parameters
    ----------
    scene : Scene
        ``[effects] film = "on"``; the light is that of ``[simulate] film_*`` (or its defaults, a white LED,
        glass and PDMS).
    sites : DataFrame or None
        Composite summits of the asperities: the film of the mean radius is drawn.

    Raises
    ------
    InputError
        If the pixel size or the asperities' radius is not known.
    """
    if scene.effects.film != "on" or scene.measure.method != "disk":
        return None
    camera = scene.need("camera", 'measuring with [effects] film = "on"')
    radius = common_radius(scene, sites)
    if not np.isfinite(radius) and sites is not None and len(sites):
        radius = float(sites["radius_m"].mean())
    if not np.isfinite(radius):
        raise InputError(
            '[effects] film = "on" needs the radius of the asperities; give [asperities] radius_m, or a file '
            'with it, or set film = "off"'
        )
    light = lamp(scene.simulate if scene.simulate is not None else Simulate())
    return FilmRim(light, radius, camera.pixel_size)


def measure_frames(
    experiment: Experiment,
    *,
    film: FilmRim | None,
    relative: float | None,
    workers: int | None,
    advance: Callable[[], None],
) -> tuple[list[MeasuredFrame], tuple[int, int]]:
    """Measure every frame on its own, then again those that need the contrast and blur of the others.

    Parameters
    ----------
    experiment : Experiment
    film : FilmRim or None
    relative : float or None
        Tolerance of the scene's output, for which each frame's method is chosen.
    workers : int or None
    advance : callable
        Called once a frame, in order.

    Returns
    -------
    parts : list of MeasuredFrame
        In order; a frame that cannot be measured has a row that says why.
    shape : (int, int)
        Of the frames.

    Raises
    ------
    InputError
        If no frame at all could be measured; the message gives the first reason.
    """
    parts, nothing = [], [None] * len(experiment.frames)
    for part in _measure(experiment, experiment.frames, nothing, film, relative, workers=workers):
        logger.info("%s", part.summary())
        parts.append(part)
        advance()
    parts, shape = _same_size(parts)
    method = experiment.scene.measure.method
    fitted = [(part.choice.method if part.choice else method) == "disk" for part in parts]
    shown = [part.relative for part, disks in zip(parts, fitted, strict=True) if disks]
    pooled = pool_optics([optics for optics in shown if optics is not None])
    if pooled is not None:
        # a pixel count takes each frame's own plateau
        again = [k for k, part in enumerate(parts) if fitted[k] and _needs(part, pooled)]
        sources = [experiment.frames[k] for k in again]
        known = [pooled.scaled(parts[k].level or 1.0) for k in again]
        for k, part in zip(
            again, _measure(experiment, sources, known, film, None, workers=workers), strict=True
        ):
            logger.info("with the contrast and blur of the series: %s", part.summary())
            parts[k] = part.chosen(parts[k].choice)
    return parts, shape


def _needs(part: MeasuredFrame, pooled: SharedOptics) -> bool:
    """Whether the uncertainty of the sum of a^3 becomes much smaller with what the series knows.

    A frame that shows no contact may show a faint one to who knows how bright it has to be.
    """
    own = part.relative
    if part.shape is None or pd.isna(part.row["n_contacts"]):
        return False
    if own is None or not len(part.contacts):
        return True
    contacts = part.contacts
    slope = 3.0 * contacts["radius_px"].to_numpy(float) ** 2
    shifts = contacts[["contrast_shift_px", "blur_shift_px"]].to_numpy(float)
    alone = np.maximum(contacts["radius_std_px"].to_numpy(float) ** 2 - np.sum(shifts**2, axis=1), 0.0)
    return gain_of_pooling(slope @ shifts, float(np.sqrt(slope**2 @ alone)), own, pooled) > WORTH


def _measure(
    experiment: Experiment,
    sources: Sequence[FrameSource],
    known: Iterable[SharedOptics | None],
    film: FilmRim | None,
    relative: float | None,
    *,
    workers: int | None,
) -> Iterator[MeasuredFrame]:
    """The frames' parts in order, a few frames in memory at a time."""
    reference = experiment.reference.read().image if experiment.reference is not None else None
    measure = partial(
        _measure_source, reference=reference, scene=experiment.scene, film=film, relative=relative
    )
    jobs = zip(sources, known, strict=True)
    return in_parallel(measure, jobs, count=len(sources), workers=workers)


def _measure_source(
    source: FrameSource,
    optics: SharedOptics | None,
    *,
    reference: NDArray | None,
    scene: Scene,
    film: FilmRim | None,
    relative: float | None,
) -> MeasuredFrame:
    """Read and measure one frame; a failure becomes a row."""
    try:
        frame = source.read()
        measurement, choice = _measure_frame(
            frame, reference, scene, film=film, relative=relative, optics=optics
        )
    except Exception as error:  # whatever it is, the other frames are not concerned
        return _failure(source.name, error)
    contacts, rejected = contacts_table(measurement, source.name), rejected_table(measurement, source.name)
    own = measurement.own_optics if len(measurement.disks) else None
    row = _row(measurement, source.name)
    return MeasuredFrame(contacts, rejected, row, frame.shape, own, measurement.level).chosen(choice)


def _measure_frame(
    frame: Frame,
    reference: NDArray | None,
    scene: Scene,
    *,
    film: FilmRim | None,
    relative: float | None,
    optics: SharedOptics | None,
) -> tuple[ImageMeasurement, Choice | None]:
    """Measure one frame by the scene's method, or by the cheapest that meets a tolerance."""
    options = frame_options(frame, scene)
    if relative is not None:
        full_scale = options["full_scale"]
        return measure_cheapest(
            frame.image, reference, scene=scene, relative=relative, full_scale=full_scale, film=film
        )
    measurement = measure_image(
        frame.image,
        reference,
        method=scene.measure.method if optics is None else "disk",
        threshold=scene.measure.threshold,
        blur_px=scene.measure.blur_px,
        optics=optics,
        film=film,
        **options,
    )
    return measurement, None


def _row(measurement: ImageMeasurement, name: str) -> dict[str, Any]:
    """The frame's row; without a number of contacts where nothing could be measured."""
    return {
        "frame": name,
        "status": measurement.status,
        "n_contacts": len(measurement.disks) if measurement.measurable else pd.NA,
        "threshold": measurement.threshold,
        "contrast": measurement.contrast,
        "noise": measurement.noise,
        "shift_x_px": measurement.shift_x_px,
        "shift_y_px": measurement.shift_y_px,
        "message": measurement.message,
        "smallest_px": measurement.smallest_px,
    }


def _failure(name: str, error: Exception) -> MeasuredFrame:
    """The part of a frame that could not be measured."""
    return MeasuredFrame(CONTACTS.empty(), REJECTED.empty(), failed_row(name, error), shape=None)


def _same_size(parts: list[MeasuredFrame]) -> tuple[list[MeasuredFrame], tuple[int, int]]:
    """The parts of the frames of the usual size, the others as failures, and that size."""
    sizes = Counter(part.shape for part in parts if part.shape is not None)
    if not sizes:
        raise InputError(f"no frame could be measured; the first: {parts[0].row['message']}")
    (rows, columns), _ = sizes.most_common(1)[0]
    checked = []
    for part in parts:
        if part.shape not in (None, (rows, columns)):
            odd = f"has {part.shape[1]} x {part.shape[0]} pixels, the other frames {columns} x {rows}"
            checked.append(_failure(part.row["frame"], FrameError(odd)))
        else:
            checked.append(part)
    return checked, (rows, columns)
