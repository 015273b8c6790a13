"""The background of a series, pooled from its frames, in place of the single reference.

Some frames are measured with the reference as it is; the contacts found are divided out of each, what is left
is registered and averaged, and the radii are corrected together with it (`contactimg.imaging.pooled`). Every
frame is then measured on the mean of the others.
"""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError
from contactimg.files import Experiment
from contactimg.frame import Frame
from contactimg.imaging import pooled
from contactimg.imaging.background.subtract import BACKGROUND_IS
from contactimg.imaging.pixels.robust import ROUGH_RATIO
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.each_frame import FailedFrame, for_each_frame
from contactimg.pipeline.frame import Edits, FrameOptions, MeasuredFrame, measure_scene_frame
from contactimg.pipeline.inputs import read_reference
from contactimg.tables import SHARED_SHIFTS

logger = logging.getLogger(__name__)

Item = TypeVar("Item")

FEWEST_FRAMES = 5
"""Frames from which on the background is pooled without being asked for. Chosen: each has four others."""

MOST_VIEWS = 16
"""Frames, evenly spread over the series, that are measured before the others, show the background and tell
contrast, blur and edge. Chosen: the background then adds 1/16 to the variance of a radius at best; more
frames would take at most 3 % off its uncertainty."""

FEWEST_VIEWS = 3
"""Different frames that a pooled background needs."""

BRIGHT_FRACTION = 0.1
"""Fraction of a contact from which on it counts that the reference has half the contrast there. Chosen: that
of a contact which has grown threefold in radius; of the contacts of the sample data none has so much."""

OF_ELLIPSES = ("semi_major_std_px", "semi_minor_std_px", "angle_std_rad")

REFERENCE = -1
"""Number of the reference among the views; those of the frames are their places in the series."""

PlacedView = tuple[pooled.PlacedFrame, NDArray[np.float32]]
"""A frame on the anchor, and the means over squares of what it shows of the background."""


@dataclass(frozen=True, eq=False)
class Pool:
    """The pooled background of a series, as the processes that measure need it.

    Parameters
    ----------
    background : PooledBackground
        Sums of all views, the rings of the wrong radii taken out.
    views : tuple of PlacedFrame
        With corrected radii.
    options : FrameOptions
    source : str
        Whose coordinates the background has, if not those of the reference.
    remark : str
        On all frames of the series; empty where there is nothing to say.
    differing : list of str
        Names of the frames that differ from the others.
    needed : bool
        It is used whether or not it gains: it was asked for, or the reference is at fault.
    before : dict
        Name of a frame that was measured before -> its noise (grey levels) and the median uncertainty of its
        radii (px).
    """

    background: pooled.PooledBackground
    views: tuple[pooled.PlacedFrame, ...]
    options: FrameOptions
    source: str
    remark: str
    differing: list[str]
    needed: bool
    before: dict[str, tuple[float, float]]

    def gains(self, after: Mapping[int, MeasuredFrame]) -> bool:
        """Whether it is needed, or the frames measured on it show less noise than before."""
        rows = [part.row for part in after.values() if part.row["noise"] > 0]
        ratios = [self.before[row["frame"]][0] / row["noise"] for row in rows]
        # 1 % is chosen: the noise is known to 0.6 %
        return self.needed or bool(ratios and np.median(ratios) > 1.01)

    def without(self, image: NDArray) -> tuple[pooled.PooledBackground, list[pooled.Contacts]]:
        """The sums without the view of an image (or of a copy of it), and the contacts of the other views."""
        digest, background, others = pooled.digest_of(image), self.background, []
        for own in self.views:
            if own.digest == digest:
                background = background.plus(own.view(image), -1)
            else:
                others.append(own.on_anchor(background.count.shape))
        return background, others


def _noise_and_std(part: MeasuredFrame) -> tuple[float, float]:
    """Noise of a frame (grey levels) and median uncertainty of its radii (px)."""
    return part.row["noise"], float(part.contacts["radius_std_px"].median())


def is_measured(part: MeasuredFrame) -> bool:
    """Whether a frame shows a background."""
    return part.shape is not None and not pd.isna(part.row["n_contacts"]) and part.level > 0


# --- what is done with each frame


def contribute_view(
    frame: Frame, _reference: NDArray | None, own: pooled.PlacedFrame, *, brightness: NDArray[np.float32]
) -> tuple[pooled.View, pooled.RimSums]:
    """The view of a frame, and its equations."""
    view = own.view(frame.image)
    return view, pooled.RimSums.of(own.on_anchor(brightness.shape), view, brightness)


def measure_on_pool(
    frame: Frame, _reference: NDArray | None, optics: SharedOptics | None, edits: Edits, *, pool: Pool
) -> MeasuredFrame:
    """Measure a frame on the mean of the other views; of one measured before, say what that changed."""
    background, others = pool.without(frame.image)
    measured = measure_scene_frame(frame, background.mean(), optics, edits, options=pool.options)
    measured = _with_excess(measured, pool, background, others)
    views = int(np.median(background.count[::4, ::4]))
    text = f"background pooled from {views} images{pool.source}"
    if frame.name in pool.before:
        (noise, std), (less, lower) = pool.before[frame.name], _noise_and_std(measured)
        text += f": noise {noise:.3g} -> {less:.3g} grey levels"
        if np.isfinite([std, lower]).all():
            text += f", uncertainty of a radius {std:.2g} -> {lower:.2g} px"
    differs = "differs from the other frames: left out of the pooled background"
    return measured.with_remarks(text, pool.remark, differs if frame.name in pool.differing else "")


def _with_excess(
    measured: MeasuredFrame, pool: Pool, background: pooled.PooledBackground, others: list[pooled.Contacts]
) -> MeasuredFrame:
    """The uncertainties of the radii with what the background at each rim adds to that of the others."""
    table = measured.contacts
    if not len(table):
        return measured
    shift = np.nan_to_num([measured.row["shift_x_px"], measured.row["shift_y_px"]], nan=0.0)
    blur = measured.own_optics.blur_px if measured.own_optics is not None else np.nan
    sharp = float(np.sqrt((blur if np.isfinite(blur) else 1.0) ** 2 + PIXEL_VARIANCE))
    disks = table[["x_px", "y_px", "radius_px", "radius_std_px"]].to_numpy(float) - [*shift, 0.0, 0.0]
    views = background.views_at(*disks.T[:3])
    excess = pooled.excess_variance(pooled.Contacts(disks, np.empty((0, 3)), blur=sharp), views, others)
    # relative to what the background adds to the variance of a pixel on average
    usual = float(np.mean(1.0 / np.maximum(pool.background.count[::4, ::4], 1)))
    factor = (1.0 + excess) / (1.0 + usual)
    shared = np.sum(table[list(SHARED_SHIFTS)].fillna(0.0).to_numpy(float) ** 2, axis=1)
    own = np.maximum(disks[:, 3] ** 2 - shared, 0.0)
    axes = {name: table[name] * np.sqrt(factor) for name in OF_ELLIPSES}
    std = np.where(own > 0, np.sqrt(shared + own * factor), disks[:, 3])
    return measured.with_contacts(table.assign(radius_std_px=std, **axes))


# --- the pool of a series


def contacts_of(part: MeasuredFrame, options: FrameOptions) -> pooled.Contacts:
    """The contacts of a frame, to be divided out if they are disks of known optics, else to be left out.

    An ellipse divided out as a disk would leave a ring in every frame, which takes its ellipticity away.
    """
    tables, optics, scene = part.tables, part.own_optics, options.scene
    columns = ["x_px", "y_px", "radius_px"]
    disk = (tables.contacts["shape"] == "disk").to_numpy(bool)
    std = np.nan_to_num(tables.contacts["radius_std_px"].to_numpy(float), nan=1.0)
    places = np.column_stack([tables.contacts[columns].to_numpy(float), std])
    rejected = tables.rejected[columns].dropna().to_numpy(float)
    contacts = pooled.Contacts(places[disk], np.concatenate([rejected, places[~disk, :3]]))
    if optics is None or optics.halo is not None or scene.measure.method != "disk":
        return contacts.left_out()
    contrast = float(np.sign(part.row["contrast"]) * optics.contrast / part.level)
    blur = float(np.sqrt(optics.blur_px**2 + PIXEL_VARIANCE))
    film = options.film.rim if options.film and part.film is not None and part.film.taken else None
    known = np.isfinite(contrast * blur)
    return replace(contacts, contrast=contrast, blur=blur, film=film) if known else contacts.left_out()


def fault_of_reference(parts: Iterable[MeasuredFrame], reference: NDArray | None) -> str:
    """Why the reference cannot serve: it shows contacts and other candidates of a frame, too; else empty.

    Twice what chance makes is taken off: what the same places have on the reference turned by half a turn.
    """
    if reference is None:
        return ""
    (rows, columns), counts = reference.shape, [0]
    smooth = pooled.smooth_brightness(reference)
    fine = cv2.blur(np.where(np.isfinite(reference), reference, smooth).astype(np.float32), (3, 3))
    excess = fine / np.maximum(smooth, 1e-9) - 1.0
    for part in parts:
        if not (is_measured(part) and part.row["contrast"]):
            continue
        tables, names = part.tables, ["x_px", "y_px", "radius_px"]
        places = pd.concat([tables.contacts[names], tables.rejected[names]]).dropna().to_numpy(float)
        x, y, radius = (places - np.nan_to_num([part.row["shift_x_px"], part.row["shift_y_px"], 0.0])).T
        sums, shown = cv2.integral((excess * part.level / part.row["contrast"] > 0.5).astype(np.uint8)), []
        for column, row in ((x, y), (columns - 1 - x, rows - 1 - y)):
            left, right = np.clip(np.rint([column - radius, column + radius + 1]), 0, columns).astype(int)
            top, bottom = np.clip(np.rint([row - radius, row + radius + 1]), 0, rows).astype(int)
            bright = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
            least = BRIGHT_FRACTION * np.pi * np.maximum(radius, 2.0) ** 2
            shown.append(int(np.count_nonzero(bright > least)))
        counts.append(shown[0] - 2 * shown[1])
    spots = max(counts)
    # three are chosen: a grain that has moved makes one or two, a reference taken in contact many
    return f"the reference shows {spots} spots like contacts" if spots >= 3 else ""


def evenly_spread(items: Sequence[Item], most: int) -> list[Item]:
    """Choose at most so many of the items, evenly spread over them, the first and the last among them."""
    places = np.linspace(0, len(items) - 1, min(most, len(items)))
    return [items[k] for k in np.rint(places).astype(int).tolist()]


def pool_background(
    experiment: Experiment, options: FrameOptions, parts: Mapping[int, MeasuredFrame], *, fault: str = ""
) -> Pool | None:
    """The background that the frames of a series show together.

    The views take coordinates and light of an anchor: the reference, or the frame with the least contact,
    its contacts divided out, where there is no reference or it shows another surface.

    Parameters
    ----------
    experiment : Experiment
    options : FrameOptions
    parts : mapping of int to MeasuredFrame
        Frames of these numbers as measured with the reference of the experiment, or without one.
    fault : str
        Why the reference of the scene is left out, if it is.

    Returns
    -------
    Pool or None
        None where the background is not to be pooled, or too few different frames show it or agree on it.
    """
    wish, count = options.scene.images.background, sum(map(is_measured, parts.values()))
    enough = count >= FEWEST_FRAMES and options.scene.measure.method == "disk"
    if not (enough if wish == "auto" else wish == "pooled" and count > 1):
        return None
    try:
        anchor, source, shown, agreement = _place_views(experiment, options, parts)
        views = {
            k: replace(own, used=agreement.used[n], light=agreement.light[n])
            for n, (k, (own, _)) in enumerate(shown.items())
            if not agreement.left_out[n]
        }
        reference = views.pop(REFERENCE, None)
        if len(views) < FEWEST_VIEWS:
            raise FrameError(f"only {len(views)} different frames show it and agree on it")
        brightness, equations = pooled.smooth_brightness(anchor), list[pooled.RimSums]()
        total = pooled.PooledBackground.empty(brightness.shape)
        if reference is not None:
            total = total.plus(reference.view(anchor), len(experiment.references))
        call = partial(contribute_view, brightness=brightness)
        for result in _each(experiment, call, views).values():
            if isinstance(result, FailedFrame):
                raise FrameError(str(result.row["message"]))
            total = total.plus(result[0])
            equations.append(result[1])
        corrections = pooled.correct_radii(equations, total, brightness, noise=agreement.pixel_noise)
        for sums, correction in zip(equations, corrections, strict=True):
            total = total.without_rings(sums.templates, correction)
    except FrameError as error:
        logger.info("the background is not pooled: %s", error)
        return None
    remark = ""
    if REFERENCE in shown and reference is None:
        remark = "the reference differs from all frames: left out of the pooled background"
    elif fault or (experiment.references and REFERENCE not in shown):
        remark = f"{fault or 'the reference does not show the surface of the frames'}: not used"
    return Pool(
        background=total,
        views=tuple(map(pooled.PlacedFrame.corrected, views.values(), corrections)),
        options=options,
        source=source,
        remark=remark,
        differing=[experiment.frames[k].name for k in shown if k != REFERENCE and k not in views],
        needed=bool(fault) or wish == "pooled",
        before={str(part.row["frame"]): _noise_and_std(part) for part in parts.values()},
    )


def _place_views(
    experiment: Experiment, options: FrameOptions, parts: Mapping[int, MeasuredFrame]
) -> tuple[NDArray, str, dict[int, PlacedView], pooled.Agreement]:
    """The anchor, whose coordinates it has, the views on it, the reference first, and where these agree.

    A `FrameError` says if too few frames show its surface.
    """
    frames, usable = experiment.frames, [k for k, part in parts.items() if is_measured(part)]
    light = sum(np.sign(parts[k].row["contrast"]) * parts[k].row["n_contacts"] for k in usable)
    sign = 1 if light >= 0 else -1  # whether most contacts are brighter than the background
    contacts = {k: contacts_of(parts[k], options) for k in evenly_spread(usable, MOST_VIEWS)}
    registered = bool(options.scene.effects.switched_off("position_drift"))
    level = BACKGROUND_IS["bright" if sign > 0 else "dark"]

    def place(contacts: dict[int, pooled.Contacts], anchor: NDArray) -> dict[int, PlacedView]:
        """The series without frames that do not show the surface of the anchor, and copies of a frame."""

        def placed(frame: Frame, _reference: NDArray | None, own: pooled.Contacts) -> PlacedView | None:
            placement = pooled.Placement.of(frame.image, anchor, background_is=level, registered=registered)
            return None if placement is None else pooled.PlacedFrame.seen(frame.image, own, placement)

        found = _each(experiment, placed, contacts)
        shown = {k: one for k, one in found.items() if one is not None and not isinstance(one, FailedFrame)}
        first = {own.digest: k for k, (own, _) in reversed(shown.items())}
        return {k: one for k, one in shown.items() if first[one[0].digest] == k}

    reference, source, shown = read_reference(experiment), "", dict[int, PlacedView]()
    if reference is not None and np.ptp(reference[np.isfinite(reference)]) > 0:
        anchor = reference
        shown = {REFERENCE: pooled.PlacedFrame.seen(anchor)} | place(contacts, anchor)
    if len(contacts) > 2 * len(shown.keys() - {REFERENCE}):
        least = min(contacts, key=lambda k: float(np.sum(parts[k].contacts["radius_px"] ** 2)))
        anchor = contacts[least].divided_out(frames[least].read().image)
        source = f" in the coordinates of {frames[least].name}"
        shown = place(contacts, anchor)
    own = {k: one.contacts for k, (one, _) in shown.items() if k != REFERENCE}
    if len(own) < FEWEST_VIEWS:
        raise FrameError(f"only {len(own)} different frames show it")
    agree = partial(pooled.compare_views, sign=sign)
    agreement = agree([squares for _, squares in shown.values()])
    scatter = [
        agreement.scatter_inside(one.on_anchor(anchor.shape), view=n)
        for n, (k, (one, _)) in enumerate(shown.items())
        if k != REFERENCE
    ]
    if np.median(scatter) > ROUGH_RATIO:  # below 1 if contacts show the surface as modelled
        logger.info("contacts do not show the surface as their surroundings do: they are left out")
        shown |= place({k: disks.left_out() for k, disks in own.items()}, anchor)
        agreement = agree([squares for _, squares in shown.values()])
    return anchor, source, shown, agreement


def _each(experiment: Experiment, call: Callable[..., Any], arguments: dict[int, Any]) -> dict[int, Any]:
    """The results of a call for frames of these numbers, each with its argument."""
    jobs = [(experiment.frames[k], argument) for k, argument in arguments.items()]
    return dict(zip(arguments, for_each_frame(experiment, call, jobs), strict=True))
