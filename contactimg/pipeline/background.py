"""The background of a series, pooled from its frames, in place of the single reference.

Two passes: the frames are measured with the reference as it is; the contacts found are divided out of each
frame, what is left is registered and averaged, the radii are corrected together with it
(`contactimg.imaging.background.pooled`), and every frame is measured again on the mean of the others.
"""

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError
from contactimg.files import Experiment, PartStore
from contactimg.frame import Frame
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
from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.measure import BACKGROUND_IS
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.film_rim import FilmRim, rim_table
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.frame import Edits, FrameOptions, MeasuredFrame, measure_scene_frame
from contactimg.pipeline.inputs import read_reference
from contactimg.pipeline.parallel import FailedFrame, for_each_frame
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

OF_ELLIPSES = ("semi_major_std_px", "semi_minor_std_px", "angle_std_rad")

_MARGIN = np.array([0.0, 0.0, HIDDEN_PX])


# --- a frame as a view of the background


@dataclass(frozen=True, eq=False)
class FrameView:
    """How a frame is turned into a view of the background, and what the view contributes to it.

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
    placement : Placement or None
        On the anchor, once it is found.
    digest : bytes
        Of the pixels: a copy of a frame has the same noise.
    used, light : ndarray
        Of the `contactimg.imaging.background.pooled.agreement.Agreement`.
    correction : ndarray, shape (n,), px
        Of the radii.
    """

    disks: NDArray[np.float64]
    radius_std: NDArray[np.float64]
    hidden: NDArray[np.float64]
    blur: float
    film: FilmRim | None = None
    placement: Placement | None = None
    digest: bytes = b""
    used: NDArray[np.bool_] | None = None
    light: NDArray[np.float32] | None = None
    correction: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, part: MeasuredFrame, options: FrameOptions) -> "FrameView":
        """The contacts of a frame, to be divided out if they are disks of known optics, else to be left out.

        An ellipse divided out as a disk would leave a ring in every frame, which takes its ellipticity away.
        """
        tables, optics = part.tables, part.own_optics
        disk = (tables.contacts["shape"] == "disk").to_numpy(bool)
        places, rejected = (
            table[["x_px", "y_px", "radius_px"]].to_numpy(float)
            for table in (tables.contacts, tables.rejected)
        )
        contrast = blur = np.nan
        if optics is not None and part.level > 0:
            contrast = np.sign(part.row["contrast"]) * optics.contrast / part.level
            blur = float(np.sqrt(optics.blur_px**2 + PIXEL_VARIANCE))
        rim = part.film is not None and part.film.taken and options.film is not None
        hidden = np.concatenate([rejected[np.isfinite(rejected).all(axis=1)], places[~disk]])
        view = cls(
            np.column_stack([places[disk], np.full(int(disk.sum()), contrast)]),
            np.nan_to_num(tables.contacts["radius_std_px"].to_numpy(float)[disk], nan=1.0),
            hidden + _MARGIN,
            blur,
            options.film.rim if rim and options.film else None,
        )
        known = np.isfinite(contrast * blur) and optics is not None and optics.halo is None
        return view if known and options.scene.measure.method == "disk" else view.with_contacts_hidden()

    def with_contacts_hidden(self) -> "FrameView":
        """The same with the contacts left out instead of divided out."""
        hidden = np.concatenate([self.hidden, self.disks[:, :3] + _MARGIN])
        return replace(self, disks=self.disks[:0], radius_std=self.radius_std[:0], hidden=hidden)

    def rims(self, shape: tuple[int, int]) -> Rims:
        """The contacts on the anchor."""
        if self.placement is None:
            raise ValueError("a view that was not placed has no rims on the anchor")
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

    def shown_by(self, image: NDArray) -> View:
        """What the image shows of the background, its slow light corrected and only where it is used."""
        if self.placement is None:
            raise ValueError("a view that was not placed shows nothing of the anchor")
        view = view_background(self.without_contacts(image), self.placement, self.hidden)
        return view if self.used is None or self.light is None else view.restricted(self.used, self.light)


PlacedView = tuple[FrameView, NDArray[np.float32]]
"""A view with its placement, and the means over squares of what it shows."""


def place_view(
    frame: Frame,
    _reference: NDArray | None,
    view: FrameView,
    *,
    anchor: NDArray,
    sign: int,
    registered: bool,
) -> PlacedView | None:
    """Place a frame on the anchor and bin what it shows of the background; None if it does not show it."""
    level = BACKGROUND_IS["bright" if sign > 0 else "dark"]
    placement = place_frame(frame.image, anchor, background_is=level, registered=registered)
    if placement is None or not placement.found:
        return None
    view = replace(view, placement=placement, digest=_digest_of(frame.image))
    return view, view.shown_by(frame.image).squares()


def contribute_view(
    frame: Frame, _reference: NDArray | None, own: FrameView, *, brightness: NDArray[np.float32]
) -> tuple[View, RimSums]:
    """The view of a frame, and its equations."""
    view = own.shown_by(frame.image)
    rims = own.rims((view.image.shape[0], view.image.shape[1]))
    return view, RimSums.of(rims, view.image, brightness, view.seen > 0)


def _digest_of(image: NDArray) -> bytes:
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


FirstPass = tuple[MeasuredFrame, FrameView | None, str]
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
    if own is None and _digest_of(frame.image) in pool.digests:
        if optics is None:
            return first
        return measure_scene_frame(frame, reference, optics, edits, options=pool.options)
    background, number = pool.background, None
    if own is not None and own.correction is not None:
        view, sums = contribute_view(frame, reference, own, brightness=pool.brightness)
        background = background.changed_by(sums.change(own.correction, background.count.shape)).minus(view)
        number = pool.digests.index(own.digest)
    measured = measure_scene_frame(frame, background.mean(), optics, edits, options=pool.options)
    measured = _with_excess(measured, background, pool, but=number)
    views, source = int(np.median(background.count[::4, ::4])), f" {pool.source}" if pool.source else ""
    text = f"background pooled from {views} images{source}: noise {first.row['noise']:.3g} -> "
    text += f"{measured.row['noise']:.3g} grey levels"
    stds = [part.contacts["radius_std_px"].median() for part in (first, measured)]
    if np.isfinite(stds).all():
        text += f", uncertainty of a radius {stds[0]:.2g} -> {stds[1]:.2g} px"
    return measured.with_remarks(text, remark)


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
    # relative to what the background adds to the variance of a pixel on average
    usual = float(np.mean(1.0 / np.maximum(pool.background.count[::4, ::4], 1)))
    factor = (1.0 + excess) / (1.0 + usual)
    shared = np.sum(contacts[list(SHARED_SHIFTS)].fillna(0.0).to_numpy(float) ** 2, axis=1)
    own = np.maximum(std**2 - shared, 0.0)
    axes = {name: contacts[name] * np.sqrt(factor) for name in OF_ELLIPSES}
    return measured.with_contacts(
        contacts.assign(radius_std_px=np.where(own > 0, np.sqrt(shared + own * factor), std), **axes)
    )


# --- the pool of a series


def measure_on_background(
    experiment: Experiment,
    options: FrameOptions,
    edits: dict[str, Edits],
    parts: list[MeasuredFrame],
    *,
    workers: int | None,
    store: PartStore | None = None,
) -> tuple[list[MeasuredFrame], Callable[..., MeasuredFrame] | None, list[FirstPass]]:
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
    measure : callable or None
        `measure_on_pool` with the pool; None if ``parts`` are as given.
    before : list of FirstPass
        What it takes of each frame.
    """
    wish, numbers = options.scene.images.background, [k for k, part in enumerate(parts) if _is_measured(part)]
    enough = len(numbers) >= FEWEST_FRAMES and options.scene.measure.method == "disk"
    if not (enough if wish == "auto" else wish == "pooled" and len(numbers) > 1):
        return parts, None, []
    again, fault, frames = list(parts), "", experiment.frames
    corrections = [edits.get(frame.name, ()) for frame in frames]
    try:
        found = _pool_views(experiment, options, again, workers=workers)
        if found is not None and found[2] >= FEWEST_FALSE_SPOTS:
            fault = f"the reference shows {found[2]} spots like contacts that no frame confirms"
            logger.warning("%s; it is not used", fault)
            alone = partial(_measure_alone, options=options)
            jobs = list(zip(frames, corrections, strict=True))
            new = for_each_frame(experiment, alone, jobs, workers=workers, store=store)
            for k, part in enumerate(new):
                if not isinstance(part, FailedFrame) and _is_measured(parts[k]):
                    again[k] = part
            found = _pool_views(experiment, options, again, workers=workers, fault=fault)
    except FrameError as error:  # a file that could be read a moment ago
        logger.warning("the background is not pooled: %s", error)
        return parts, None, []
    if found is None:
        return parts, None, []
    pool, before, _ = found
    measure = partial(measure_on_pool, pool=pool)
    numbers = [k for k, part in enumerate(again) if _is_measured(part)]
    second = [(frames[k], None, corrections[k], before[k]) for k in numbers]
    ratios = []
    for k, part in zip(
        numbers, for_each_frame(experiment, measure, second, workers=workers, store=store), strict=True
    ):
        if not isinstance(part, FailedFrame):
            again[k] = part
            if part.row["noise"] > 0:
                ratios.append(parts[k].row["noise"] / part.row["noise"])
    if wish == "auto" and not fault and not (ratios and np.median(ratios) > LEAST_GAIN):
        logger.info("the pooled background gains nothing; the reference is used")
        return parts, None, []
    for part in again:
        part.log("on the pooled background: ")
    return again, measure, before


def _measure_alone(
    frame: Frame, _reference: NDArray | None, edits: Edits, *, options: FrameOptions
) -> MeasuredFrame:
    """Measure a frame without its reference."""
    return measure_scene_frame(frame, None, None, edits, options=options)


Placed = dict[int, PlacedView]
"""Number of a frame -> its view, with the placement."""


def _place_views(
    experiment: Experiment,
    options: FrameOptions,
    views: dict[int, FrameView],
    anchor: NDArray,
    *,
    sign: int,
    workers: int | None,
) -> Placed:
    """The views placed on an anchor; without those that do not show its surface, and copies of a frame."""
    registered = bool(options.scene.effects.switched_off("position_drift"))
    call = partial(place_view, anchor=anchor, sign=sign, registered=registered)
    jobs = [(experiment.frames[k], view) for k, view in views.items()]
    found = zip(views, for_each_frame(experiment, call, jobs, workers=workers), strict=True)
    placed = {k: one for k, one in found if one is not None and not isinstance(one, FailedFrame)}
    different = {view.digest: k for k, (view, _) in reversed(placed.items())}.values()
    return {k: one for k, one in placed.items() if k in different}


def _pool_views(
    experiment: Experiment,
    options: FrameOptions,
    parts: list[MeasuredFrame],
    *,
    workers: int | None,
    fault: str = "",
) -> tuple[Pool, list[FirstPass], int] | None:
    """The pooled background of a series; None if too few different frames show it, or agree on it.

    The views take coordinates and light of an anchor: the reference, or the frame with the least contact,
    its contacts divided out, where there is no reference, it is at fault or shows another surface.

    Returns
    -------
    pool : Pool
    before : list of FirstPass
        Of every frame.
    spots : int
        Spots of the reference that look like contacts and that no frame confirms.
    """
    frames, usable = experiment.frames, [k for k, part in enumerate(parts) if _is_measured(part)]
    light = sum(np.sign(parts[k].row["contrast"]) * parts[k].row["n_contacts"] for k in usable)
    sign = 1 if light >= 0 else -1  # whether most contacts are brighter than the background
    chosen = np.rint(np.linspace(0, len(usable) - 1, min(MOST_VIEWS, len(usable)))).astype(int)
    views = {k: FrameView.of(parts[k], options) for k in (usable[n] for n in np.unique(chosen))}
    place = partial(_place_views, experiment, options, sign=sign, workers=workers)
    reference, shown = None if fault else read_reference(experiment), Placed()
    if reference is not None and np.ptp(reference.image[np.isfinite(reference.image)]) > 0:
        shown = place(views, reference.image)
    if reference is not None and 0 < len(views) <= 2 * len(shown):
        anchor, source, count = reference.image, "", len(experiment.references)
    else:
        least = min(views, key=lambda k: float(np.sum(parts[k].contacts["radius_px"] ** 2)))
        anchor, count = views[least].without_contacts(frames[least].read().image), 0
        source = f"in the coordinates of {frames[least].name}"
        shown = place(views, anchor)
    if len(shown) < FEWEST_VIEWS:
        logger.info("the background is not pooled: only %d different frames show it", len(shown))
        return None
    first = View.plain(anchor) if count else None
    shape = (anchor.shape[0], anchor.shape[1])
    shown, agreement = _compare(shown, first, shape, sign, partial(place, anchor=anchor))
    own = {
        k: replace(view, used=agreement.used[n], light=agreement.light[n])
        for n, (k, (view, _)) in enumerate(shown.items(), start=int(count > 0))
        if not agreement.left_out[n]
    }
    if len(own) < FEWEST_VIEWS:
        logger.info("the background is not pooled: only %d frames agree on it", len(own))
        return None
    pooled, brightness = PooledBackground.empty(shape), smooth_brightness(anchor)
    if first is not None:
        pooled = pooled.plus(first.restricted(agreement.used[0], agreement.light[0]), count)
    pooled, own = _add_up(experiment, pooled, own, brightness, noise=agreement.pixel_noise, workers=workers)
    logger.info("background pooled from %d frames%s", len(own), " and the reference" if count else "")
    remark = ""
    if count and agreement.left_out[0]:
        remark = "the reference differs from all frames: left out of the pooled background"
    elif fault or (experiment.references and not count):
        remark = f"{fault or 'the reference does not show the surface of the frames'}: not used"
    differs = "differs from the other frames: left out of the pooled background"
    remarks = ([remark, differs * (k in shown and k not in own)] for k in range(len(parts)))
    before = [
        (part, own.get(k), "; ".join(filter(None, said)))
        for k, (part, said) in enumerate(zip(parts, remarks, strict=True))
    ]
    history = RimHistory(tuple(view.rims(shape) for view in own.values()))
    digests = tuple(view.digest for view in own.values())
    pool = Pool(pooled, brightness, history, digests, options, source)
    return pool, before, agreement.spots_of(0, sign=sign) if count else 0


def _compare(
    shown: Placed, first: View | None, shape: tuple[int, int], sign: int, place: Callable[..., Placed]
) -> tuple[Placed, Agreement]:
    """Where the views, the reference first, agree; contacts that hide the surface are left out of all."""
    reference = [] if first is None else [first.squares()]
    squares = [*reference, *(squares for _, squares in shown.values())]
    agreement, ratios = compare_views(np.stack(squares), sign=sign), []
    for n, (view, _) in enumerate(shown.values(), start=len(reference)):
        rims = view.rims(shape)
        ratios.append(agreement.scatter_inside(rims.x, rims.y, rims.radius + HIDDEN_PX, view=n))
    if np.median(ratios) <= INSIDE_SCATTER:
        return shown, agreement
    logger.info("contacts do not show the surface as their surroundings do: they are left out")
    shown = place({k: view.with_contacts_hidden() for k, (view, _) in shown.items()})
    squares = [*reference, *(squares for _, squares in shown.values())]
    return shown, compare_views(np.stack(squares), sign=sign)


def _add_up(
    experiment: Experiment,
    pooled: PooledBackground,
    own: dict[int, FrameView],
    brightness: NDArray[np.float32],
    *,
    noise: float,
    workers: int | None,
) -> tuple[PooledBackground, dict[int, FrameView]]:
    """The sum of the views, and the views with the corrections of the radii."""
    equations, shape = list[RimSums](), brightness.shape
    contribute = partial(contribute_view, brightness=brightness)
    jobs = [(experiment.frames[k], view) for k, view in own.items()]
    for part in for_each_frame(experiment, contribute, jobs, workers=workers):
        if isinstance(part, FailedFrame):
            raise FrameError(str(part.row["message"]))
        pooled = pooled.plus(part[0])
        equations.append(part[1])
    corrections = correct_radii(equations, pooled.mean(), pooled.count, brightness, noise=noise)
    for sums, correction in zip(equations, corrections, strict=True):
        pooled = pooled.changed_by(-sums.change(correction, shape))
    return pooled, {k: replace(own[k], correction=one) for k, one in zip(own, corrections, strict=True)}
