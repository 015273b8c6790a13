"""The image whose coordinates and light the views of a series take, and frames placed on it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.files import Experiment, PartStore
from contactimg.frame import Frame
from contactimg.imaging.background.find_illumination import BackgroundLevel
from contactimg.imaging.background.pooled.views import Placement, place_frame
from contactimg.imaging.measure import BACKGROUND_IS
from contactimg.pipeline.background.looks import (
    Look,
    digest_of,
    divide_contacts_out,
    is_measured,
    look_of,
    view_of,
)
from contactimg.pipeline.frame import FrameOptions
from contactimg.pipeline.inputs import read_reference
from contactimg.pipeline.measured_frame import MeasuredFrame


@dataclass(frozen=True, eq=False)
class Series:
    """A series of which every frame has been measured.

    Parameters
    ----------
    experiment : Experiment
    options : FrameOptions
    parts : sequence of MeasuredFrame
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`.
    reference_fault : str
        Why the reference is not used; empty if it is, or if there is none.
    store : PartStore, optional
        As for `contactimg.pipeline.parallel.for_each_frame`.
    """

    experiment: Experiment
    options: FrameOptions
    parts: Sequence[MeasuredFrame]
    workers: int | None
    reference_fault: str = ""
    store: PartStore | None = None

    @property
    def sign(self) -> int:
        """1 if most contacts are brighter than the background, else -1."""
        light = sum(
            np.sign(part.row["contrast"]) * part.row["n_contacts"] for part in self.parts if is_measured(part)
        )
        return 1 if light >= 0 else -1


@dataclass(frozen=True, eq=False)
class Anchor:
    """The image whose coordinates and light the views take.

    Parameters
    ----------
    image : ndarray
        The reference, or the frame with the least contact, its contacts divided out.
    reference_count : int
        Images that it is the mean of if it is the reference, else 0.
    background_is : BackgroundLevel
    registered : bool
        Whether frames are known to lie on it.
    source : str
        What it is, for messages; empty for the reference.
    """

    image: NDArray
    reference_count: int
    background_is: BackgroundLevel
    registered: bool
    source: str = ""

    @property
    def is_reference(self) -> bool:
        """Whether it is the reference."""
        return self.reference_count > 0

    @classmethod
    def of(cls, series: Series, numbers: list[int]) -> "Anchor":
        """The reference if there is one that shows anything, else one of some frames."""
        frame = None if series.reference_fault else read_reference(series.experiment)
        if frame is None or not np.ptp(frame.image[np.isfinite(frame.image)]) > 0:
            return cls.of_frames(series, numbers)
        return cls(frame.image, len(series.experiment.references), *_known(series))

    @classmethod
    def of_frames(cls, series: Series, numbers: list[int]) -> "Anchor":
        """The frame with the least contact among some."""
        areas = [float(np.sum(series.parts[k].contacts["radius_px"] ** 2)) for k in numbers]
        number = numbers[int(np.argmin(areas))]
        source = series.experiment.frames[number]
        look = look_of(series.parts[number], series.options)
        flat = divide_contacts_out(np.asarray(source.read().image, np.float32), look)
        return cls(flat, 0, *_known(series), source=f"in the coordinates of {source.name}")


def _known(series: Series) -> tuple[BackgroundLevel, bool]:
    """Which level is background, and whether the frames are known to be registered."""
    registered = bool(series.options.scene.effects.switched_off("position_drift"))
    return BACKGROUND_IS["bright" if series.sign > 0 else "dark"], registered


@dataclass(frozen=True, eq=False)
class Prepared:
    """A frame placed on the anchor, with what the comparison of the views needs."""

    look: Look
    squares: NDArray[np.float32]


def prepare_view(frame: Frame, _reference: NDArray | None, look: Look, *, anchor: Anchor) -> Prepared:
    """Place a frame on the anchor and bin what it shows of the background."""
    placement = place_frame(
        frame.image, anchor.image, background_is=anchor.background_is, registered=anchor.registered
    )
    look = replace(look, placement=placement or Placement.unknown(), digest=digest_of(frame.image))
    if not look.placement.found:
        return Prepared(look, np.empty((0, 0), np.float32))
    return Prepared(look, view_of(frame.image, look).squares())
