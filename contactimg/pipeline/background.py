"""The background of a series, pooled from its frames, in place of the single reference.

Two passes: the frames are measured with the reference as it is; the contacts found are divided out of each
frame, what is left is registered and averaged, the radii are corrected together with it
(`contactimg.imaging.background.pooled`), and every frame is measured again on the mean of the others.
"""

import hashlib
import logging
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError
from contactimg.files import Experiment, FrameSource, PartStore
from contactimg.frame import Frame
from contactimg.imaging.background.find_illumination import BackgroundLevel
from contactimg.imaging.background.pooled.agreement import Agreement, compare_views
from contactimg.imaging.background.pooled.rims import RimHistory, Rims, RimSums, correct_radii
from contactimg.imaging.background.pooled.sums import PooledBackground
from contactimg.imaging.background.pooled.views import (
    Placement,
    View,
    place_frame,
    smooth_brightness,
    to_anchor,
    view_background,
)
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.measure import BACKGROUND_IS
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.film_rim import FilmRim, rim_table
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.frame import Edits, FrameOptions, MeasuredFrame, measure_scene_frame
from contactimg.pipeline.inputs import read_reference
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
from contactimg.scene import Scene
from contactimg.tables import SHARED_SHIFTS

logger = logging.getLogger(__name__)

FEWEST_FRAMES = 5
"""Frames from which on the background is pooled without being asked for. Chosen: each has four others."""

MOST_VIEWS = 16
"""Frames that the background is pooled from, evenly spread over the series. Chosen: what the background adds
to the variance of a radius is then 1/16 at best; more frames would take at most 3 % off its uncertainty."""

FEWEST_VIEWS = 3
"""Different frames that a pooled background needs."""

INSIDE_SCATTER = 1.5
"""Ratio of the scatter of the views inside to that outside the contacts, above which contacts are taken not
to show the surface (or not to be described by the model) and are left out. Theory: below 1 if they are."""

FEWEST_FALSE_SPOTS = 3
"""Spots like contacts from which on a reference is not used at all. Chosen: a grain that has moved makes
one spot or two, a reference taken in contact many."""

LEAST_GAIN = 1.01
"""Ratio of the noise of the difference before and after, above which the pooled background is used. Chosen:
the noise is known to 0.6 %."""

HIDDEN_PX = 5.0
"""Margin around what a frame hides: three and a half blur widths of the usual optics. Chosen by hand."""

_MARGIN = np.array([0.0, 0.0, HIDDEN_PX])


# --- a frame as a view of the background


@dataclass(frozen=True, eq=False)
class ViewRecipe:
    """How a frame is turned into a view of the background.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius (px), relative contrast of the contacts to divide out.
    radius_std : ndarray, shape (n,)
    hidden : ndarray, shape (m, 3)
        x, y, radius (px) of what cannot be divided out.
    blur : float
        Standard deviation of the profile's Gaussian, pixel included; NaN without contacts to divide out.
    film : FilmRim or None
        Around the contacts, where they were fitted with it.
    placement : Placement
        On the anchor.
    digest : bytes
        Of the pixels.
    """

    disks: NDArray[np.float64]
    radius_std: NDArray[np.float64]
    hidden: NDArray[np.float64]
    blur: float
    film: FilmRim | None = None
    placement: Placement = field(default_factory=Placement.unknown)
    digest: bytes = b""

    @classmethod
    def of(cls, part: MeasuredFrame, options: FrameOptions) -> "ViewRecipe":
        """The contacts of a frame, to be divided out if their optics are known, else to be left out."""
        tables, optics = part.tables, part.own_optics
        places, rejected = (
            table[["x_px", "y_px", "radius_px"]].to_numpy(float)
            for table in (tables.contacts, tables.rejected)
        )
        contrast = blur = np.nan
        described = options.scene.measure.method == "disk"
        if optics is not None and np.isfinite([optics.blur_px, optics.contrast]).all() and part.level > 0:
            contrast = np.sign(part.row["contrast"]) * optics.contrast / part.level
            blur = float(np.sqrt(optics.blur_px**2 + PIXEL_VARIANCE))
            described &= optics.halo is None
        else:
            described = False
        taken = options.film is not None and part.film is not None and part.film.taken
        recipe = cls(
            np.column_stack([places, np.full(len(places), contrast)]),
            np.nan_to_num(tables.contacts["radius_std_px"].to_numpy(float), nan=1.0),
            rejected[np.isfinite(rejected).all(axis=1)] + _MARGIN,
            blur,
            options.film.rim if taken and options.film else None,
        )
        return recipe if described else recipe.with_contacts_hidden()

    def with_contacts_hidden(self) -> "ViewRecipe":
        """The same with the contacts left out instead of divided out."""
        hidden = np.concatenate([self.hidden, self.disks[:, :3] + _MARGIN])
        return replace(self, disks=self.disks[:0], radius_std=self.radius_std[:0], hidden=hidden)

    def rims(self, shape: tuple[int, int]) -> Rims:
        """The contacts on the anchor."""
        x, y = to_anchor(self.disks[:, 0], self.disks[:, 1], self.placement.alignment, shape)
        contrast = float(self.disks[0, 3]) if len(self.disks) else 1.0
        blur = self.blur if np.isfinite(self.blur) else 1.0
        return Rims(x, y, self.disks[:, 2], self.radius_std, contrast, blur)

    def without_contacts(self, image: NDArray) -> NDArray[np.float32]:
        """The image divided by the light of its contacts."""
        image = np.asarray(image, np.float32)
        if not len(self.disks):
            return image
        table = None if self.film is None else rim_table(self.film, self.blur)
        model = render_disks(self.disks, self.blur, (image.shape[0], image.shape[1]), profile=table)
        return np.asarray(image / np.maximum(1.0 + model, np.float32(0.05)), np.float32)

    def view(self, image: NDArray) -> View:
        """What the image shows of the background."""
        return view_background(self.without_contacts(image), self.placement, self.hidden)


@dataclass(frozen=True, eq=False)
class OwnView:
    """What a frame itself contributed to the pooled background.

    Parameters
    ----------
    number : int
        Number of the frame among those pooled.
    recipe : ViewRecipe
    used, light : ndarray
        Of the `contactimg.imaging.background.pooled.agreement.Agreement`.
    correction : ndarray, shape (n,), px
        Of the radii.
    """

    number: int
    recipe: ViewRecipe
    used: NDArray[np.bool_]
    light: NDArray[np.float32]
    correction: NDArray[np.float64]


def prepare_view(
    frame: Frame,
    _reference: NDArray | None,
    recipe: ViewRecipe,
    *,
    anchor: NDArray,
    background_is: BackgroundLevel,
    registered: bool,
) -> tuple[ViewRecipe, NDArray[np.float32]] | None:
    """Place a frame on the anchor and bin what it shows of the background; None if it does not show it."""
    placement = place_frame(frame.image, anchor, background_is=background_is, registered=registered)
    if placement is None or not placement.found:
        return None
    recipe = replace(recipe, placement=placement, digest=digest_of(frame.image))
    return recipe, recipe.view(frame.image).squares()


def contribute_view(
    frame: Frame, _reference: NDArray | None, own: OwnView, *, brightness: NDArray[np.float32]
) -> tuple[View, RimSums]:
    """The view of a frame, its slow light corrected and only where it is used, and its equations."""
    view = own.recipe.view(frame.image).restricted(own.used, own.light)
    rims = own.recipe.rims((view.image.shape[0], view.image.shape[1]))
    return view, RimSums.of(rims, view.image, brightness, view.seen > 0)


def digest_of(image: NDArray) -> bytes:
    """Digest of the pixels: a copy of a frame has the same noise."""
    return hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()


def _is_measured(part: MeasuredFrame) -> bool:
    """Whether a frame shows a background."""
    return part.shape is not None and not pd.isna(part.row["n_contacts"]) and part.level > 0


# --- a frame on the mean of the others


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


FirstPass = tuple[MeasuredFrame, OwnView | None, str]
"""A frame as measured with the reference, or without one; what it contributed, if anything; a remark."""


def measure_on_pool(
    frame: Frame,
    reference: NDArray | None,
    optics: SharedOptics | None,
    edits: Edits,
    before: FirstPass,
    *,
    pool: Pool,
) -> MeasuredFrame:
    """Measure a frame on the mean of the other views; a copy of another frame as in the first pass."""
    first, own, remark = before
    measure = partial(measure_scene_frame, options=pool.options)
    if own is None and digest_of(frame.image) in pool.digests:
        return first if optics is None else measure(frame, reference, optics, edits)
    background = pool.background
    if own is not None:
        view, sums = contribute_view(frame, reference, own, brightness=pool.brightness)
        background = background.changed_by(sums.change(own.correction, background.count.shape)).minus(view)
    measured = measure(frame, background.mean(), optics, edits)
    measured = _with_excess(measured, background, pool, but=None if own is None else own.number)
    said = _describe(first, measured, int(np.median(background.count[::4, ::4])), pool.source)
    return measured.with_remarks(said, remark)


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
    x, y, radius, std = contacts[["x_px", "y_px", "radius_px", "radius_std_px"]].to_numpy(float).T
    sharp = float(np.sqrt((blur if np.isfinite(blur) else 1.0) ** 2 + PIXEL_VARIANCE))
    rims = Rims(x - shift[0], y - shift[1], radius, std, 1.0, sharp)
    excess = pool.history.excess_variance(rims, background.views_at(rims.x, rims.y, radius), but=but)
    factor = (1.0 + excess) / (1.0 + pool.mean_excess)
    shared = np.sum(contacts[list(SHARED_SHIFTS)].fillna(0.0).to_numpy(float) ** 2, axis=1)
    own = np.maximum(std**2 - shared, 0.0)
    return measured.with_contacts(
        contacts.assign(radius_std_px=np.where(own > 0, np.sqrt(shared + own * factor), std))
    )


# --- the pool of a series


@dataclass(frozen=True, eq=False)
class SeriesBackground:
    """A pooled background, and what the frames of the series are to it.

    Parameters
    ----------
    pool : Pool
    first : sequence of MeasuredFrame
        The frames as measured with the reference.
    own : dict
        Frame -> what it contributed.
    remarks : dict
        Frame -> what to say of it; under the empty name, what to say of each.
    false_spots : int
        Spots of the reference that look like contacts and that no frame confirms.
    """

    pool: Pool
    first: Sequence[MeasuredFrame]
    own: dict[str, OwnView]
    remarks: dict[str, str]
    false_spots: int

    def before(self, k: int) -> FirstPass:
        """What `measure_on_pool` needs for the frame of this number, beside optics and edits."""
        name = str(self.first[k].row["frame"])
        remark = "; ".join(text for text in (self.remarks.get(""), self.remarks.get(name)) if text)
        return self.first[k], self.own.get(name), remark


def measure_on_background(
    experiment: Experiment,
    options: FrameOptions,
    edits: dict[str, tuple[HandEdit, ...]],
    parts: list[MeasuredFrame],
    *,
    workers: int | None,
    store: PartStore | None = None,
) -> tuple[list[MeasuredFrame], SeriesBackground | None]:
    """Measure the frames of a series again, on the background that they show together.

    Parameters
    ----------
    experiment : Experiment
    options : FrameOptions
    edits : dict
        Name of a frame -> corrections by hand to its contacts.
    parts : list of MeasuredFrame
        The frames as measured with the reference of the scene, or without one.
    workers : int or None
        As for `contactimg.engine.calls.in_parallel`.
    store : PartStore, optional
        As for `contactimg.pipeline.parallel.for_each_frame`.

    Returns
    -------
    parts : list of MeasuredFrame
        As given where the background could not be pooled or, unless the scene asks for it, gains nothing.
    background : SeriesBackground or None
        None if ``parts`` are as given.
    """
    if not _is_wanted(options.scene, parts):
        return parts, None
    again, fault, frames = list(parts), "", experiment.frames
    try:
        background = _pool_views(_Pooling(experiment, options, again, workers))
        if background is not None and background.false_spots >= FEWEST_FALSE_SPOTS:
            fault = f"the reference shows {background.false_spots} spots like contacts that no frame confirms"
            logger.warning("%s; it is not used", fault)
            jobs: list[tuple[Any, ...]] = [(frame, edits.get(frame.name, ())) for frame in frames]
            alone = partial(_measure_alone, options=options)
            new = for_each_frame(experiment, alone, jobs, workers=workers, store=store)
            again = [
                old if isinstance(part, FailedFrame) or not _is_measured(old) else part
                for old, part in zip(parts, new, strict=True)
            ]
            background = _pool_views(_Pooling(experiment, options, again, workers, fault))
    except FrameError as error:  # a file that could be read a moment ago
        logger.warning("the background is not pooled: %s", error)
        return parts, None
    if background is None:
        return parts, None
    numbers = [k for k, part in enumerate(again) if _is_measured(part)]
    jobs = [(frames[k], None, edits.get(frames[k].name, ()), background.before(k)) for k in numbers]
    measure = partial(measure_on_pool, pool=background.pool)
    second = for_each_frame(experiment, measure, jobs, workers=workers, store=store)
    again, ratios = list(again), array("d")
    for k, part in zip(numbers, second, strict=True):
        if not isinstance(part, FailedFrame):
            again[k] = part
            if part.row["noise"] > 0:
                ratios.append(parts[k].row["noise"] / part.row["noise"])
    optional = options.scene.images.background == "auto" and not fault
    if optional and not (ratios and np.median(ratios) > LEAST_GAIN):
        logger.info("the pooled background gains nothing; the reference is used")
        return parts, None
    for part in again:
        part.log("on the pooled background: ")
    return again, background


def _measure_alone(
    frame: Frame, _reference: NDArray | None, edits: Edits, *, options: FrameOptions
) -> MeasuredFrame:
    """Measure a frame without its reference."""
    return measure_scene_frame(frame, None, None, edits, options=options)


def _is_wanted(scene: Scene, parts: list[MeasuredFrame]) -> bool:
    """Whether the scene asks for a pooled background, or leaves the choice and the series is long enough."""
    wish, count = scene.images.background, sum(_is_measured(part) for part in parts)
    if wish == "auto":
        return scene.measure.method == "disk" and count >= FEWEST_FRAMES
    return wish == "pooled" and count > 1


@dataclass(eq=False)
class _Pooling:
    """The background of a series in the making.

    Parameters
    ----------
    experiment : Experiment
    options : FrameOptions
    parts : sequence of MeasuredFrame
        Every frame, measured.
    workers : int or None
    reference_fault : str
        Why the reference is not used; empty if it is, or if there is none.

    Attributes
    ----------
    anchor : ndarray
        The image whose coordinates and light the views take: the reference, or the frame with the least
        contact, its contacts divided out.
    reference_count : int
        Images that the anchor is the mean of if it is the reference, else 0.
    source : str
        What the anchor is, for messages; empty for the reference.
    views : dict
        Frame -> how it is turned into a view, and what that shows of each square.
    """

    experiment: Experiment
    options: FrameOptions
    parts: Sequence[MeasuredFrame]
    workers: int | None
    reference_fault: str = ""

    def __post_init__(self) -> None:
        usable = [k for k, part in enumerate(self.parts) if _is_measured(part)]
        light = sum(np.sign(self.parts[k].row["contrast"]) * self.parts[k].row["n_contacts"] for k in usable)
        self.sign = 1 if light >= 0 else -1  # whether most contacts are brighter than the background
        places = np.linspace(0, len(usable) - 1, min(MOST_VIEWS, len(usable)))
        self.numbers = [usable[k] for k in np.unique(np.rint(places).astype(int))]
        self.views: dict[FrameSource, tuple[ViewRecipe, NDArray[np.float32]]] = {}
        reference = None if self.reference_fault else read_reference(self.experiment)
        if reference is None or not np.ptp(reference.image[np.isfinite(reference.image)]) > 0:
            self.take_frame_as_anchor()
        else:
            self.anchor, self.source = reference.image, ""
            self.reference_count = len(self.experiment.references)

    def take_frame_as_anchor(self) -> None:
        """Place the views on the frame with the least contact."""
        areas = [float(np.sum(self.parts[k].contacts["radius_px"] ** 2)) for k in self.numbers]
        number = self.numbers[int(np.argmin(areas))]
        frame = self.experiment.frames[number]
        recipe = ViewRecipe.of(self.parts[number], self.options)
        self.anchor, self.reference_count = recipe.without_contacts(frame.read().image), 0
        self.source = f"in the coordinates of {frame.name}"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.anchor.shape[0], self.anchor.shape[1]

    def prepare(self, recipes: dict[FrameSource, ViewRecipe]) -> None:
        """Place frames on the anchor; those that do not show its surface are left out."""
        place = partial(
            prepare_view,
            anchor=self.anchor,
            background_is=BACKGROUND_IS["bright" if self.sign > 0 else "dark"],
            registered=bool(self.options.scene.effects.switched_off("position_drift")),
        )
        jobs = list(recipes.items())
        found = for_each_frame(self.experiment, place, jobs, workers=self.workers)
        self.views = {
            frame: part
            for (frame, _), part in zip(jobs, found, strict=True)
            if part is not None and not isinstance(part, FailedFrame)
        }

    def compare(self) -> Agreement:
        """Where the views agree; if contacts do not show the surface, they are left out of all."""
        agreement, first = self._agreement(), int(self.reference_count > 0)
        rims = [recipe.rims(self.shape) for recipe, _ in self.views.values()]
        ratios = [
            agreement.scatter_inside(one.x, one.y, one.radius + HIDDEN_PX, view=k)
            for k, one in enumerate(rims, start=first)
        ]
        if np.median(ratios) <= INSIDE_SCATTER:
            return agreement
        logger.info("contacts do not show the surface as their surroundings do: they are left out")
        self.prepare({frame: recipe.with_contacts_hidden() for frame, (recipe, _) in self.views.items()})
        return self._agreement()

    def _agreement(self) -> Agreement:
        """Where the views, the reference first, agree as they are."""
        squares = [shown for _, shown in self.views.values()]
        if self.reference_count:
            squares = [View.plain(self.anchor).squares(), *squares]
        return compare_views(np.stack(squares), sign=self.sign)

    def add_up(
        self, agreement: Agreement, own: dict[FrameSource, OwnView], brightness: NDArray[np.float32]
    ) -> tuple[PooledBackground, dict[FrameSource, OwnView]]:
        """The sum of the views, and the views with the corrections of the radii."""
        pooled = PooledBackground.empty(self.shape)
        if self.reference_count:
            view = View.plain(self.anchor).restricted(agreement.used[0], agreement.light[0])
            pooled = pooled.plus(view, self.reference_count)
        equations: list[RimSums] = []
        call = partial(contribute_view, brightness=brightness)
        for part in for_each_frame(self.experiment, call, list(own.items()), workers=self.workers):
            if isinstance(part, FailedFrame):
                raise FrameError(str(part.row["message"]))
            pooled = pooled.plus(part[0])
            equations.append(part[1])
        noise = agreement.pixel_noise
        corrections = correct_radii(equations, pooled.mean(), pooled.count, brightness, noise=noise)
        for sums, correction in zip(equations, corrections, strict=True):
            pooled = pooled.changed_by(-sums.change(correction, self.shape))
        corrected = zip(own.items(), corrections, strict=True)
        return pooled, {frame: replace(one, correction=change) for (frame, one), change in corrected}

    def remarks(self, agreement: Agreement, good: dict[FrameSource, int]) -> dict[str, str]:
        """What to say of the series, and of the frames that were left out."""
        left_out = "differs from the other frames: left out of the pooled background"
        remarks = {frame.name: left_out for frame in self.views if frame not in good}
        if self.reference_count:
            if agreement.left_out[0]:
                remarks[""] = "the reference differs from all frames: left out of the pooled background"
        elif self.reference_fault:
            remarks[""] = f"{self.reference_fault}: not used"
        elif self.experiment.references:
            remarks[""] = "the reference does not show the surface of the frames: not used"
        return remarks


def _pool_views(pooling: _Pooling) -> SeriesBackground | None:
    """The pooled background of a series; None if too few different frames show it, or agree on it."""
    parts, frames = pooling.parts, pooling.experiment.frames
    recipes = {frames[k]: ViewRecipe.of(parts[k], pooling.options) for k in pooling.numbers}
    pooling.prepare(recipes)
    if pooling.reference_count and len(pooling.views) < 0.5 * len(recipes):
        pooling.take_frame_as_anchor()
        pooling.prepare(recipes)
    by_digest = {recipe.digest: frame for frame, (recipe, _) in reversed(pooling.views.items())}
    pooling.views = {frame: view for frame, view in pooling.views.items() if frame in by_digest.values()}
    if len(pooling.views) < FEWEST_VIEWS:
        logger.info("the background is not pooled: only %d different frames show it", len(pooling.views))
        return None
    agreement, first = pooling.compare(), int(pooling.reference_count > 0)
    good = {frame: n for n, frame in enumerate(pooling.views, start=first) if not agreement.left_out[n]}
    if len(good) < FEWEST_VIEWS:
        logger.info("the background is not pooled: only %d frames agree on it", len(good))
        return None
    own = {
        frame: OwnView(k, pooling.views[frame][0], agreement.used[n], agreement.light[n], np.empty(0))
        for k, (frame, n) in enumerate(good.items())
    }
    brightness = smooth_brightness(pooling.anchor)
    pooled, own = pooling.add_up(agreement, own, brightness)
    history = RimHistory(tuple(one.recipe.rims(pooling.shape) for one in own.values()))
    digests = tuple(one.recipe.digest for one in own.values())
    logger.info("background pooled from %d frames%s", len(good), " and the reference" * first)
    return SeriesBackground(
        Pool(pooled, brightness, history, digests, pooling.options, pooling.source),
        parts,
        {frame.name: one for frame, one in own.items()},
        pooling.remarks(agreement, good),
        agreement.spots_of(0, sign=pooling.sign) if first else 0,
    )
