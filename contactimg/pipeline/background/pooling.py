"""Pool the background of a series from its frames."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from contactimg.errors import FrameError
from contactimg.files import FrameSource
from contactimg.imaging.background.pooled.agreement import Agreement, compare_views
from contactimg.imaging.background.pooled.rims import RimHistory, correct_radii
from contactimg.imaging.background.pooled.sums import PooledBackground
from contactimg.imaging.background.pooled.views import View, smooth_brightness
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.background.anchor import Anchor, Prepared, Series, prepare_view
from contactimg.pipeline.background.looks import (
    HIDDEN_PX,
    Look,
    OwnView,
    contribute_view,
    is_measured,
    look_of,
)
from contactimg.pipeline.background.measuring import FirstPass, Pool, measure_on_pool
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.pipeline.parallel import FailedFrame, for_each_frame

logger = logging.getLogger(__name__)


MOST_VIEWS = 16
"""Frames that the background is pooled from, evenly spread over the series. Chosen: what the background adds
to the variance of a radius is then 1/16 at best; more frames would take at most 3 % off its uncertainty."""


FEWEST_VIEWS = 3
"""Different frames that a pooled background needs."""


INSIDE_SCATTER = 1.5
"""Ratio of the scatter of the views inside to that outside the contacts, above which contacts are taken not
to show the surface (or not to be described by the model) and are left out. Theory: below 1 if they are."""


@dataclass(frozen=True, eq=False)
class SeriesBackground:
    """A pooled background, and how frames are measured on it.

    Parameters
    ----------
    measure : callable
        For `contactimg.pipeline.parallel.for_each_frame`, with the arguments of `arguments`.
    own : dict
        Frame -> what it contributed.
    first : sequence of MeasuredFrame
        The frames as measured with the reference.
    remarks : dict
        Frame -> what to say of it; under the empty name, what to say of each.
    ghosts : int
        Spots of the reference that look like contacts and that no frame confirms.
    """

    measure: Callable[..., MeasuredFrame]
    own: dict[str, OwnView]
    first: Sequence[MeasuredFrame]
    remarks: dict[str, str]
    ghosts: int = 0

    def arguments(self, k: int, optics: SharedOptics | None = None) -> tuple[Any, ...]:
        """What `measure` needs for the frame of this number, beside its pixels and the reference."""
        first = self.first[k]
        name = str(first.row["frame"])
        remark = "; ".join(text for text in (self.remarks.get(""), self.remarks.get(name)) if text)
        return optics, FirstPass(first, self.own.get(name), remark)


def pool_views(series: Series) -> SeriesBackground | None:
    """Pool the background of a series; None if too few different frames show it."""
    numbers = _choose_views(series.parts)
    anchor = Anchor.of(series, numbers)
    looks = {series.experiment.frames[k]: look_of(series.parts[k], series.options) for k in numbers}
    prepared = _prepare(series, anchor, looks)
    if anchor.is_reference and len(prepared) < 0.5 * len(looks):
        anchor = Anchor.of_frames(series, numbers)
        prepared = _prepare(series, anchor, looks)
    different, seen = {}, set()
    for source, part in prepared.items():
        if part.look.digest not in seen:
            seen.add(part.look.digest)
            different[source] = part
    if len(different) < FEWEST_VIEWS:
        logger.info("the background is not pooled: only %d different frames show it", len(different))
        return None
    return _Pooling(series, anchor, different).finish()


def _choose_views(parts: Sequence[MeasuredFrame]) -> list[int]:
    """Frames to pool, evenly spread over those that show a background."""
    usable = [k for k, part in enumerate(parts) if is_measured(part)]
    places = np.linspace(0, len(usable) - 1, min(MOST_VIEWS, len(usable)))
    return [usable[k] for k in np.unique(np.rint(places).astype(int))]


def _prepare(series: Series, anchor: Anchor, looks: dict[FrameSource, Look]) -> dict[FrameSource, Prepared]:
    """Frames placed on the anchor, without those that do not show its surface."""
    call = partial(prepare_view, anchor=anchor)
    jobs = list(looks.items())
    parts = for_each_frame(series.experiment, call, jobs, workers=series.workers)
    return {
        source: part
        for (source, _), part in zip(jobs, parts, strict=True)
        if isinstance(part, Prepared) and part.look.placement.found
    }


class _Pooling:
    """The second half: compare the views, add them up, correct the radii."""

    def __init__(self, series: Series, anchor: Anchor, prepared: dict[FrameSource, Prepared]) -> None:
        self.series, self.anchor, self.prepared = series, anchor, prepared
        self.brightness = smooth_brightness(anchor.image)
        self.shape = (anchor.image.shape[0], anchor.image.shape[1])
        self.first = int(anchor.is_reference)  # number of the first frame among the views

    def finish(self) -> SeriesBackground | None:
        """The pooled background; None if too few frames agree."""
        agreement = self._compare()
        good = {
            source: number
            for number, source in enumerate(self.prepared, start=self.first)
            if not agreement.left_out[number]
        }
        if len(good) < FEWEST_VIEWS:
            logger.info("the background is not pooled: only %d frames agree on it", len(good))
            return None
        own = {
            source: OwnView(k, self.prepared[source].look, agreement.used[n], agreement.light[n], np.empty(0))
            for k, (source, n) in enumerate(good.items())
        }
        pooled, own = self._add_up(agreement, own)
        looks = [one.look for one in own.values()]
        history = RimHistory(tuple(look.rims(self.shape) for look in looks))
        digests = tuple(look.digest for look in looks)
        pool = Pool(pooled, self.brightness, history, digests, self.series.options, self.anchor.source)
        return SeriesBackground(
            partial(measure_on_pool, pool=pool),
            {source.name: one for source, one in own.items()},
            self.series.parts,
            self._remarks(agreement, good),
            agreement.spots_of(0, sign=self.series.sign) if self.anchor.is_reference else 0,
        )

    def _compare(self) -> Agreement:
        """Compare the views; if contacts do not show the surface, they are left out of all."""
        agreement = self._agreement()
        rims = [part.look.rims(self.shape) for part in self.prepared.values()]
        ratios = [
            agreement.scatter_inside(one.x, one.y, one.radius + HIDDEN_PX, view=k)
            for k, one in enumerate(rims, start=self.first)
        ]
        if np.median(ratios) <= INSIDE_SCATTER:
            return agreement
        logger.info("contacts do not show the surface as their surroundings do: they are left out")
        looks = {source: part.look.with_contacts_hidden() for source, part in self.prepared.items()}
        self.prepared = _prepare(self.series, self.anchor, looks)
        return self._agreement()

    def _agreement(self) -> Agreement:
        """Compare the views as they are."""
        squares = [part.squares for part in self.prepared.values()]
        if self.anchor.is_reference:
            squares = [View.plain(self.anchor.image).squares(), *squares]
        return compare_views(np.stack(squares), sign=self.series.sign)

    def _add_up(
        self, agreement: Agreement, own: dict[FrameSource, OwnView]
    ) -> tuple[PooledBackground, dict[FrameSource, OwnView]]:
        """Add the views up and correct the radii in them."""
        pooled = PooledBackground.empty(self.shape)
        if self.anchor.is_reference:
            view = View.plain(self.anchor.image).restricted(agreement.used[0], agreement.light[0])
            pooled = pooled.plus(view, self.anchor.reference_count)
        sums = []
        call = partial(contribute_view, brightness=self.brightness)
        parts = for_each_frame(self.series.experiment, call, list(own.items()), workers=self.series.workers)
        for part in parts:
            if isinstance(part, FailedFrame):
                raise FrameError(str(part.row["message"]))
            pooled = pooled.plus(part.view)
            sums.append(part.sums)
        corrections = correct_radii(
            sums, pooled.mean(), pooled.count, self.brightness, noise=agreement.pixel_noise
        )
        for equations, correction in zip(sums, corrections, strict=True):
            pooled = pooled.changed_by(-equations.change(correction, self.shape))
        corrected = zip(own.items(), corrections, strict=True)
        return pooled, {source: replace(one, correction=change) for (source, one), change in corrected}

    def _remarks(self, agreement: Agreement, good: dict[FrameSource, int]) -> dict[str, str]:
        """What to say of the series, and of the frames that were left out."""
        logger.info("background pooled from %d frames%s", len(good), " and the reference" * self.first)
        left_out = "differs from the other frames: left out of the pooled background"
        remarks = {source.name: left_out for source in self.prepared if source not in good}
        if self.anchor.is_reference:
            if agreement.left_out[0]:
                remarks[""] = "the reference differs from all frames: left out of the pooled background"
        elif self.series.reference_fault:
            remarks[""] = f"{self.series.reference_fault}: not used"
        elif self.series.experiment.references:
            remarks[""] = "the reference does not show the surface of the frames: not used"
        return remarks
