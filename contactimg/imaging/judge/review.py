"""A second look at the detections of either method: reject what is not seen, flag what disagrees."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.fit.quality import FittedDetections
from contactimg.imaging.judge.agreement import Agreement, compare
from contactimg.imaging.judge.background_left import BackgroundLeft, inspect_background
from contactimg.imaging.judge.climbed_table import Outlines
from contactimg.imaging.judge.counted_light import compare_some
from contactimg.imaging.judge.free_contacts import CommonContrast
from contactimg.imaging.judge.second_opinion import (
    LEAST_BLUR_PX,
    REGION_BLUR_WIDTHS,
    RING_PX,
    Scenery,
    is_outshone,
    measure_again,
    measure_rise,
)
from contactimg.imaging.judge.shape_ladder import climb
from contactimg.imaging.pixels.masks import Mask, clear_disks
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.optics import combine_errors
from contactimg.imaging.reject.detections import PLACE, Columns, CountedDetections, Detections
from contactimg.imaging.reject.foreground import Foreground
from contactimg.imaging.reject.scratches import find_scratches
from contactimg.tables import Flag, Reason
from contactimg.timings import stage

LEAST_PROMINENCE = 1.5
"""Mean inside over the median of the surroundings, in units of their scatter, of a contact that is seen.
Chosen: 1.7 is the least on frames with 14 levels of contrast and noise of 2, where contacts are just
detected."""
CLEAR_RISE_FRACTION, CLEAR_RISE_PROMINENCE = 0.5, 0.5
"""A contact that rises by this fraction of the contrast need exceed the scatter of its surroundings less:
neighbours, cut contacts and rests of uneven light scatter more than noise. Chosen on touching beads."""
LARGEST_CONTRAST_STD = 0.05
"""Relative uncertainty of a contrast that a frame shows. Chosen, as for the status."""
OWN_RISE_FRACTION, MOST_LOOKED_AT = 0.5, 60
"""Part of its rise over the background that a contact must show in the frame without the reference; contacts
that are looked at. Chosen: half-way between the frame alone and the reference alone, not measured; for
time."""
VISIBILITY_ROUNDS = 6
"""Rounds of looking at the contacts that are left: a rejected one belongs to the surroundings of the next."""
USUAL_BLUR_PX = 1.4
"""Blur assumed where none was determined: that of the paper's frames."""
BRIGHT_FRACTION = 0.5
"""Of the contrast, above which a pixel must belong to a contact. As for the threshold."""
BRIGHT_SIGMA = 5.0
"""Standard deviations of the noise that it must exceed as well. False-alarm rate 3e-7 a pixel."""
SAMPLE_STEP = 4
"""Pixels between those that are looked at, each way; affects the time alone."""
RIM_BLUR_WIDTHS = 2.0
"""Distance from the rim up to which a contact explains light. Theory: 2 % of the edge's height is left."""


@dataclass(frozen=True, eq=False)
class Review:
    """What a second look found.

    Parameters
    ----------
    detections : Detections
        With what is not seen among the rejected, flags of disagreement, and uncertainties that cover it.
    agreement : Agreement or None
        Between fit or count and second opinion; None without contacts.
    invisible, scratched : int
        Contacts rejected because they are not seen, or as pieces of scratches.
    unexplained : float
        Share of the bright pixels that belong to no contact and no rejected object.
    background : BackgroundLeft
    shapes : str
        Remark on contacts that are no disks; empty if all are.
    outlines : tuple of (int, list of ndarray)
        Row of each contact of free shape, and its outlines (x, y), px.
    ellipse_misfit : float
        See `contactimg.imaging.judge.climbed_table.Climb`.
    of_reference : float
        Share of the contacts that the reference makes: the frame itself does not show them.
    unsurrounded : float
        Share of the contacts around which no background is seen.
    """

    detections: Detections
    agreement: Agreement | None = None
    invisible: int = 0
    scratched: int = 0
    unexplained: float = 0.0
    background: BackgroundLeft = field(default_factory=BackgroundLeft)
    shapes: str = ""
    outlines: Outlines = ()
    ellipse_misfit: float = float("nan")
    of_reference: float = 0.0
    unsurrounded: float = 0.0


@stage("second look")
def review(
    foreground: Foreground,
    difference: DifferenceImage,
    detections: Detections,
    *,
    shape: str = "auto",
    beside_holes: CommonContrast | None = None,
) -> Review:
    """Look at the pixels of the detections once more.

    ``shape`` as for `contactimg.imaging.measure`, ``beside_holes`` as for
    `contactimg.imaging.judge.shape_ladder.climb`.
    """
    places = _places(detections)
    if not len(places):
        left = _inspect(foreground, difference, detections)
        return Review(detections, unexplained=_unexplained(foreground, detections), background=left)
    blur, by_hand, looked_at = _edge_blur(detections), _has_flag(detections, Flag.MANUAL), detections
    unseen = _is_unseen(foreground, places, blur, _clear_rise(foreground, detections)) & ~by_hand
    unseen |= _is_outshone(foreground, difference, detections)
    superfluous = _rejected_places(detections)[detections.rejected["reason"] == Reason.UNNECESSARY, :2]
    scratch = find_scratches(foreground.image, places, blur_px=blur, candidates=superfluous)
    scratch &= ~unseen & ~by_hand
    reasons = np.where(unseen, Reason.INVISIBLE, Reason.SCRATCH)
    detections = _without(detections, unseen | scratch, reasons)
    looked = _look_at_fit(
        foreground, difference, detections, looked_at=looked_at, shape=shape, beside_holes=beside_holes
    )
    detections, agreement = looked.detections, looked.agreement
    if isinstance(detections, CountedDetections) and len(_places(detections)):
        agreement = compare_some(_scenery(foreground, difference, detections), detections)
        detections = _with_shared_shift(detections, agreement)
    of_reference, unsurrounded = _look_at_some(foreground, _places(detections), blur)
    return replace(
        looked,
        detections=detections,
        agreement=agreement,
        invisible=looked.invisible + int(np.count_nonzero(unseen)),
        scratched=int(np.count_nonzero(scratch)),
        unexplained=_unexplained(foreground, detections),
        background=_inspect(foreground, difference, detections),
        of_reference=of_reference,
        unsurrounded=unsurrounded,
    )


def _look_at_fit(
    foreground: Foreground,
    difference: DifferenceImage,
    detections: Detections,
    *,
    looked_at: Detections,
    shape: str,
    beside_holes: CommonContrast | None,
) -> Review:
    """The shapes of fitted contacts and a second opinion on each, without what is then seen to be none.

    What is still as it was when it was ``looked_at`` is not looked at again.
    """
    if not isinstance(detections, FittedDetections) or not len(_places(detections)):
        return Review(detections)
    climbed = climb(detections, shape=shape, beside_holes=beside_holes)
    found: Detections = climbed.detections
    outlines, agreement, invisible = climbed.outlines, None, 0
    if found is not looked_at:
        lost = _is_lost(foreground, difference, found, outlines)
        found, outlines = _without_climbed(found, outlines, lost)
        invisible += int(np.count_nonzero(lost))
    # where holes make the insides dimmer, these do not show the contrast
    if isinstance(found, FittedDetections) and beside_holes is None and len(_places(found)):
        agreement = _compare(foreground, difference, found, _edge_blur(found))
        found = _with_disagreement(found, agreement)
        doubted = _has_flag(found, Flag.DISAGREES)
        if doubted.any():
            lost = _is_lost(foreground, difference, found, outlines) & doubted
            found, outlines = _without_climbed(found, outlines, lost)
            agreement, invisible = agreement.of(~lost), invisible + int(np.count_nonzero(lost))
    return Review(
        found,
        agreement,
        invisible=invisible,
        shapes=climbed.remark,
        outlines=outlines,
        ellipse_misfit=climbed.misfit,
    )


def _inspect(foreground: Foreground, difference: DifferenceImage, detections: Detections) -> BackgroundLeft:
    """The background that contacts and rejected objects leave free."""
    return inspect_background(
        foreground.image,
        foreground.frame_pair.valid,
        difference.illumination.background,
        np.vstack([_places(detections), _rejected_places(detections)]),
        reach_px=REGION_BLUR_WIDTHS * _edge_blur(detections),
        contrast=foreground.contrast.plateau,
    )


def _clear_rise(foreground: Foreground, detections: Detections) -> float:
    """Rise of a contact that is clearly seen, grey levels; peaks of noise may pass for a higher plateau."""
    contrast = foreground.contrast.plateau
    if detections.own_optics.contrast_relative_std < LARGEST_CONTRAST_STD:
        contrast = min(contrast, detections.optics.contrast)
    return CLEAR_RISE_FRACTION * contrast


def _is_unseen(foreground: Foreground, places: NDArray, blur: float, clear: float) -> NDArray[np.bool_]:
    """Which contacts do not stand out of their surroundings, those without what was rejected included."""
    unseen = np.zeros(len(places), np.bool_)
    for _ in range(VISIBILITY_ROUNDS):
        kept = np.flatnonzero(~unseen)
        more = _is_flat(foreground, places[kept], blur, clear)
        if not more.any():
            break
        unseen[kept[more]] = True
    return unseen


def _is_flat(foreground: Foreground, places: NDArray, blur: float, clear: float) -> NDArray[np.bool_]:
    """Which contacts do not stand out of their surroundings, the other contacts left out."""
    rise, scatter = measure_rise(
        foreground.image, foreground.frame_pair.valid, places, blur_px=blur, prominence=LEAST_PROMINENCE
    )
    least = np.where(rise > clear, CLEAR_RISE_PROMINENCE, LEAST_PROMINENCE)
    return np.asarray((rise <= 0.0) | (rise < least * scatter))


def _look_at_some(foreground: Foreground, places: NDArray, blur: float) -> tuple[float, float]:
    """Shares of the contacts that only the reference makes, and of those without background around them."""
    if not len(places):
        return 0.0, 0.0
    pair, some = foreground.frame_pair, places[:: -(-len(places) // MOST_LOOKED_AT)]
    rise = measure_rise(foreground.image, pair.valid, some, blur_px=blur)[0]
    unsurrounded = float(np.mean(np.isnan(rise)))
    if pair.reference is None:
        return 0.0, unsurrounded
    frame = np.zeros(pair.frame.shape, np.float32)  # filled where it is looked at, for time
    reach = some[:, 2] + REGION_BLUR_WIDTHS * max(blur, LEAST_BLUR_PX) + RING_PX + 2.0
    low = np.maximum(some[:, :2] - reach[:, None], 0.0).astype(int)
    high = np.maximum(some[:, :2] + reach[:, None] + 1.0, 0.0).astype(int)
    for (left, top), (right, bottom) in zip(low.tolist(), high.tolist(), strict=True):
        frame[top:bottom, left:right] = pair.frame[top:bottom, left:right]
    own = measure_rise(frame, pair.valid, some, blur_px=blur)[0]
    return float(np.mean(foreground.sign * own < OWN_RISE_FRACTION * rise)), unsurrounded


def _is_outshone(
    foreground: Foreground, difference: DifferenceImage, detections: Detections
) -> NDArray[np.bool_]:
    """Which contacts are no brighter than what lies around them, other contacts included.

    In a crowd that can be so of a contact as well: one whose fit has settled, and fits, stays if its light is
    clear and the second opinion, where there is one already, agrees.
    """
    image = difference.image if foreground.sign > 0 else -difference.image
    contrast, places = foreground.contrast.plateau, _places(detections)
    outshone = is_outshone(image, places, contrast=contrast, spare_crowds=False)
    if isinstance(detections, FittedDetections) and outshone.any():
        alone = is_outshone(image, places, contrast=contrast, spare_crowds=True)
        doubtful = _has_flag(detections, Flag.POOR_FIT | Flag.LOW_SIGNAL | Flag.DISAGREES)
        outshone &= doubtful | unfinished(detections) | alone
    return outshone & ~_has_flag(detections, Flag.MANUAL)


def _is_lost(
    foreground: Foreground, difference: DifferenceImage, detections: Detections, outlines: Outlines
) -> NDArray[np.bool_]:
    """`_is_outshone`, but for contacts with a hole, which are dark in it."""
    lost = _is_outshone(foreground, difference, detections)
    lost[[row for row, lines in outlines if len(lines) > 1]] = False
    return lost


def _has_flag(detections: Detections, flag: Flag) -> NDArray[np.bool_]:
    """Which contacts have a flag."""
    return (np.asarray(detections.contacts["flags"], np.int64) & int(flag)) > 0


def _places(detections: Detections) -> NDArray[np.float64]:
    """x, y, radius of the contacts, px."""
    return np.column_stack([np.asarray(detections.contacts[name], float) for name in PLACE])


def _rejected_places(detections: Detections) -> NDArray[np.float64]:
    """The same of the rejected objects."""
    return np.column_stack([np.asarray(detections.rejected[name], float) for name in PLACE])


def _edge_blur(detections: Detections) -> float:
    """Standard deviation of the blurred edge, pixel included."""
    if isinstance(detections, CountedDetections):
        return detections.rim_blur_px
    blur = detections.optics.blur_px
    return float(np.hypot(blur if np.isfinite(blur) else USUAL_BLUR_PX, PIXEL_VARIANCE**0.5))


def _without(detections: Detections, bad: NDArray[np.bool_], reasons: NDArray) -> Detections:
    """The detections with some contacts among the rejected."""
    if not bad.any():
        return detections
    rejected: Columns = {
        name: np.append(detections.rejected[name], detections.contacts[name][bad]) for name in PLACE
    }
    rejected["reason"] = np.append(detections.rejected["reason"].astype(object), reasons[bad])
    contacts = {name: values[~bad] for name, values in detections.contacts.items()}
    if isinstance(detections, FittedDetections):
        return replace(detections, contacts=contacts, rejected=rejected, rows=detections.rows[~bad])
    return replace(detections, contacts=contacts, rejected=rejected)


def _without_climbed(
    detections: Detections, outlines: Outlines, bad: NDArray[np.bool_]
) -> tuple[Detections, Outlines]:
    """Detections and the outlines of contacts of free shape without some contacts that are not seen."""
    row = np.cumsum(~bad) - 1
    left = tuple((int(row[k]), lines) for k, lines in outlines if not bad[k])
    return _without(detections, bad, np.where(bad, Reason.INVISIBLE, "")), left


def _compare(
    foreground: Foreground, difference: DifferenceImage, detections: FittedDetections, blur: float
) -> Agreement:
    """Second opinion and fit."""
    places = _places(detections)
    opinion = measure_again(_scenery(foreground, difference, detections), places, blur_px=blur)
    if "shape" in detections.contacts:  # the second opinion lays its pixels out for disks
        climbed = detections.contacts["shape"] != "disk"
        opinion.light_area[climbed] = opinion.half_area[climbed] = np.nan
    return compare(opinion, places[:, 2], blur_px=blur)


def _scenery(foreground: Foreground, difference: DifferenceImage, detections: Detections) -> Scenery:
    """The image that was measured: a fitted one without halo and remaining illumination."""
    image, fit = foreground.image, detections.frame_fit if isinstance(detections, FittedDetections) else None
    if fit is not None and fit.problem.binning == 1:
        image = fit.problem.image
    valid: Mask = foreground.frame_pair.valid
    background = difference.illumination.background
    return Scenery.of(image, valid=valid, background=background, level=difference.level)


def _with_shared_shift(detections: Detections, agreement: Agreement) -> Detections:
    """Counted radii with uncertainties that cover what their light says of all of them."""
    if not agreement.is_shared:
        return detections
    contacts = dict(detections.contacts)
    before = contacts["edge_shift_px"]
    after = np.where(np.sign(agreement.shared_px) == -np.sign(before), before - agreement.shared_px, before)
    after = np.where(np.abs(after) < np.abs(agreement.shared_px), -agreement.shared_px, after)
    own = np.sqrt(np.maximum(contacts["radius_std_px"] ** 2 - before**2, 0.0))
    contacts |= {"edge_shift_px": after, "radius_std_px": np.hypot(own, after)}
    return replace(detections, contacts=contacts)


def unfinished(detections: Detections) -> NDArray[np.bool_]:
    """Contacts whose fit was cut off before it had settled, because the work would have been too much."""
    fit = detections.frame_fit if isinstance(detections, FittedDetections) else None
    if fit is None or not fit.problem.work.ran_out or not isinstance(detections, FittedDetections):
        return np.zeros(len(detections.contacts["x_px"]), np.bool_)
    return ~fit.fit.settled[detections.rows]


def _with_disagreement(detections: Detections, agreement: Agreement) -> Detections:
    """Flags, and uncertainties that cover fit and second opinion.

    What all contacts share is no error of each: it enters once.
    """
    contacts = dict(detections.contacts)
    by_light = contacts.get("shape", np.full(len(agreement.shared_px), "disk")) == "free"
    # light over contrast is what the edge of the others is compared with: it has no edge of its own
    shared, cut_off = np.where(by_light, 0.0, agreement.shared_px), unfinished(detections)
    beyond = agreement.difference_px - shared
    own = np.where(agreement.disagrees, beyond, np.where(cut_off, np.nan_to_num(beyond), 0.0))
    contacts["flags"] = contacts["flags"] | np.where(cut_off, int(Flag.POOR_FIT), 0)
    contacts["flags"] = contacts["flags"] | np.where(agreement.disagrees, int(Flag.DISAGREES), 0)
    contacts["edge_shift_px"] = np.hypot(contacts["edge_shift_px"], shared)
    contacts["radius_std_px"] = combine_errors(contacts["radius_std_px"], np.stack([own, shared], axis=1))
    return replace(detections, contacts=contacts)


def _unexplained(foreground: Foreground, detections: Detections) -> float:
    """Share of the bright pixels, of a sample, that lie in no contact and in no rejected object."""
    level = np.float32(max(BRIGHT_FRACTION * foreground.contrast.plateau, BRIGHT_SIGMA * foreground.noise))
    image = foreground.image[::SAMPLE_STEP, ::SAMPLE_STEP]
    bright = (image > level).view(np.uint8)
    total = int(np.count_nonzero(bright))
    if not total or not level > 0:
        return 0.0
    places = np.vstack([_extents(detections.contacts), _extents(detections.rejected)])
    places[:, 2] += RIM_BLUR_WIDTHS * _edge_blur(detections)
    clear_disks(bright, places / SAMPLE_STEP)
    return np.count_nonzero(bright) / total


def _extents(table: Columns) -> NDArray[np.float64]:
    """x, y and the largest distance of the rim from there, px."""
    extent = table.get("semi_major_px", table["radius_px"])
    return np.column_stack([np.asarray(part, float) for part in (table["x_px"], table["y_px"], extent)])
