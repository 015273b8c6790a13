"""Measure a frame on the background that the other frames of its series show."""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactimg.files import fingerprint
from contactimg.frame import Frame
from contactimg.imaging.background.pooled.rims import RimHistory, Rims
from contactimg.imaging.background.pooled.sums import PooledBackground
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.background.looks import OwnView, contribute_view, digest_of
from contactimg.pipeline.frame import FrameOptions, measure_scene_frame
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.tables import SHARED_SHIFTS


@dataclass(frozen=True, eq=False)
class Pool:
    """The pooled background as the processes that measure need it."""

    background: PooledBackground
    brightness: NDArray[np.float32]
    history: RimHistory
    digests: tuple[bytes, ...]
    options: FrameOptions
    source: str

    @property
    def mean_excess(self) -> float:
        """What the background adds to the variance of a pixel, relative to it, on average."""
        return float(np.mean(1.0 / np.maximum(self.background.count[::4, ::4], 1)))

    @cached_property
    def _digest(self) -> str:
        """Of everything but the options."""
        parts = [getattr(self, field.name) for field in fields(self) if field.name != "options"]
        return fingerprint(parts)

    def of_all(self) -> tuple[Any, ...]:
        """Digest and options on which the measurement of every frame depends."""
        return self._digest, self.options.of_all()

    def of_frame(self, name: str) -> tuple[Any, ...]:
        """Options on which one frame alone depends."""
        return self.options.of_frame(name)


@dataclass(frozen=True, eq=False)
class FirstPass:
    """What the first pass left of a frame.

    Parameters
    ----------
    part : MeasuredFrame
        As measured with the reference, or without one.
    own : OwnView or None
        What it contributed to the pooled background; None if nothing.
    remark : str
        To add to its message.
    """

    part: MeasuredFrame
    own: OwnView | None
    remark: str

    def of_frame(self, _name: str) -> tuple[Any, ...]:
        """What the second measurement depends on besides the pixels and the settings, in short."""
        return self.part.row, self.own, self.remark


def measure_on_pool(
    frame: Frame,
    reference: NDArray | None,
    optics: SharedOptics | None,
    first: FirstPass,
    *,
    pool: Pool,
) -> MeasuredFrame:
    """Measure a frame on the mean of the other views; a copy of another frame as in the first pass."""
    own, options = first.own, pool.options
    if own is None and digest_of(frame.image) in pool.digests:
        return (
            first.part if optics is None else measure_scene_frame(frame, reference, optics, options=options)
        )
    background = pool.background
    if own is not None:
        part = contribute_view(frame, reference, own, brightness=pool.brightness)
        background = background.changed_by(part.sums.change(own.correction, background.count.shape))
        background = background.minus(part.view)
    measured = measure_scene_frame(frame, background.mean(), optics, options=options)
    measured = _with_excess(measured, background, pool, but=None if own is None else own.number)
    said = _describe(first.part, measured, int(np.median(background.count[::4, ::4])), pool.source)
    return measured.with_remarks(said, first.remark)


def _describe(before: MeasuredFrame, after: MeasuredFrame, views: int, source: str) -> str:
    """What the pooled background is and what it gains."""
    text = f"background pooled from {views} images{f' {source}' if source else ''}: noise "
    text += f"{before.row['noise']:.3g} -> {after.row['noise']:.3g} grey levels"
    stds = [part.contacts["radius_std_px"].median() for part in (before, after)]
    if not np.isfinite(stds).all():
        return text
    return f"{text}, uncertainty of a radius {stds[0]:.2g} -> {stds[1]:.2g} px"


def _with_excess(
    measured: MeasuredFrame, background: PooledBackground, pool: Pool, *, but: int | None
) -> MeasuredFrame:
    """The uncertainties of the radii with what the background at each rim adds to that of the others."""
    contacts = measured.contacts
    if not len(contacts):
        return measured
    shift = np.nan_to_num([measured.row["shift_x_px"], measured.row["shift_y_px"]], nan=0.0)
    blur = measured.own_optics.blur_px if measured.own_optics is not None else np.nan
    rims = Rims(
        contacts["x_px"].to_numpy(float) - shift[0],
        contacts["y_px"].to_numpy(float) - shift[1],
        contacts["radius_px"].to_numpy(float),
        contacts["radius_std_px"].to_numpy(float),
        1.0,
        float(np.sqrt((blur if np.isfinite(blur) else 1.0) ** 2 + PIXEL_VARIANCE)),
    )
    views = background.views_at(rims.x, rims.y, rims.radius)
    excess = pool.history.excess_variance(rims, views, but=but)
    factor = (1.0 + excess) / (1.0 + pool.mean_excess)
    shifts = contacts[list(SHARED_SHIFTS)]
    shared = np.sum(shifts.fillna(0.0).to_numpy(float) ** 2, axis=1)
    own = np.maximum(rims.radius_std**2 - shared, 0.0)
    std = np.where(own > 0, np.sqrt(shared + own * factor), rims.radius_std)
    return measured.with_contacts(contacts.assign(radius_std_px=std))
