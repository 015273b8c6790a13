"""Judge a measured frame: its status, remarks for the user, and whether it can be measured at all."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.plateau import measure_contrast
from contactimg.imaging.fit.quality import FittedDetections
from contactimg.imaging.judge.interlaced import displacement_of_rows
from contactimg.imaging.judge.review import Review, unfinished
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.reject.detections import CountedDetections, Detections
from contactimg.imaging.reject.foreground import Foreground
from contactimg.tables import Flag, Status

RESOLVED = 0.05
"""Relative standard uncertainty of the contrast above which a frame counts as not showing it. Chosen: 5 % of
the contrast make 2.5 % of the radius of a small contact and 7.5 % of its force."""

LIGHT_CHANGE = 1.5
"""Ratio of the background to the reference, or its inverse, above which the light has changed. Chosen by
hand; sensitivity not measured."""

FLAGGED_FRACTION = 0.2
"""Fraction of poor fits, or of saturated contacts, that spoils a frame. Chosen."""
FLAGGED_LEAST_CONTACTS = 3
"""Least number of contacts for that. Chosen: one odd contact of two says nothing about a frame; but where no
contact fits, however few, none is measured."""
FALSE_FRACTION, FALSE_LEAST = 0.05, 3
"""Fraction of what was measured and number of candidates that prove to be no contact, above which others may
be among the contacts. Chosen: frames as assumed have none."""
UNEXPLAINED_FRACTION = 0.05
"""Share of the bright pixels that belong to nothing, above which contacts are missing. Chosen: frames as
assumed have 1e-3 at most."""
LARGEST_DARK_SHARE = 0.004
"""Share of dark blocks above which the reference is that of another place. Chosen: 0 on frames as assumed,
0.013 with fifteen contacts in the reference."""
LARGEST_REFERENCE_SHARE = 0.5
"""Share of the contacts that the frame itself does not show above which the reference is that of another
place. Chosen: most of them; the frames of the sample data stay below it."""
LARGEST_UNSURROUNDED_SHARE = 0.5
"""Share of the contacts without a pixel of background around them above which the frame shows too little.
Chosen: most of them; 0 on frames as assumed."""
ALL_UNSURROUNDED = 0.99
"""The same where there are one or two contacts: all of them."""
LEAST_SIDE_PX = 8
"""Rows and columns that a frame needs. Theory: a contact of one pixel behind a blur of one, and two blur
widths of background on either side."""
LARGEST_UNEVENNESS = 0.02
"""Unevenness of the background over the contrast above which the light was not followed. Chosen: it moves the
radius of a contact of two blur widths by 1 %; 0.007 at most on frames as assumed."""
LEAST_FOUND_SHARE = 0.85
"""Share of the free background on which the light was followed, at least. Chosen: 0.97 at least on frames as
assumed, 0.71 and less where a change of the light was not followed."""
LARGEST_EDGE_SHARE = 0.5
"""Distance between threshold and rim over the radius, in the median, above which counted pixels are no
contacts to measure. Chosen: the area is uncertain by a factor of two; 0.15 at most on six frames of the
sample data, 0.7 to 18 on the photographs and clouds it was chosen on."""
LARGEST_LACK, FEWEST_SHAPES = 0.03, 2
"""Share of the area that a counted region lacks against the ellipse of its second moments, in the median, and
regions that show it. Theory: 0.045 for a square, 0.17 for a triangle, 0.054 for half a disk. Chosen: 0.01 at
most on frames as assumed, those of touching contacts included."""
LEAST_FREE_SHARE = 0.02
"""Share of the frame that contacts must leave free for a statement on the background. Chosen: 600 blocks of
1600 x 1200 pixels."""


@dataclass(frozen=True)
class Verdict:
    """Status of a frame.

    Parameters
    ----------
    status : str
        "ok", or the most important defect.
    message : str
        Remarks for the user, joined by semicolons.
    measurable : bool
        Whether "no contact" is a result; False if the frame does not allow one.
    """

    status: str
    message: str
    measurable: bool


def judge(foreground: Foreground, difference: DifferenceImage, seen: Review) -> Verdict:
    """Status, remarks and measurability of a frame."""
    frame_pair, detections = foreground.frame_pair, seen.detections
    if frame_pair.trivial:
        # a frame equal to its reference does show that there is no contact; the others show nothing
        return Verdict(
            frame_pair.defect, frame_pair.message, measurable=frame_pair.defect == Status.IDENTICAL
        )
    count = len(detections.contacts["x_px"])
    ratio = float(difference.illumination.coefficients[0, 0])
    light_changed = bool(difference.ratio and not 1 / LIGHT_CHANGE < ratio < LIGHT_CHANGE)
    fit = detections.frame_fit if isinstance(detections, FittedDetections) else None
    refused = bool(not count and fit is not None and fit.problem.work.refused)
    defects: list[tuple[str, str]] = [(frame_pair.defect, frame_pair.message)]
    if light_changed:
        contacts = "contacts fill" if count else "one contact fills"
        text = f"the background is {ratio:.2g} times the reference: the light changed or {contacts} the frame"
        defects.append((Status.LIGHT_CHANGED, text))
    elif refused:
        defects.append((Status.UNRESOLVED, ""))
    elif not count:
        defects.append((Status.NO_CONTACT, _explain_no_contact(foreground)))
    elif difference.registration_failed:
        defects.append((Status.NOT_REGISTERED, ""))
    defects += _background_defects(difference, seen)
    defects += _camera_defects(foreground) if count else []
    defects += [(detections.status, detections.remark), *_contact_defects(seen)]
    defects += _too_little_seen(foreground, seen)
    remarks = [difference.remark, foreground.remark, _remark_contrast(foreground, detections)]
    remarks += [_remark_unresolved(detections), seen.shapes]
    if frame_pair.reference is None and not frame_pair.defect:
        remarks.insert(0, "no reference: the background was estimated from the frame")
    message = "; ".join(text for text in [*(text for _, text in defects), *remarks] if text)
    status = next((status for status, _ in defects if status), Status.OK)
    return Verdict(status, message, measurable=bool(count or not (light_changed or refused)))


def _remark_unresolved(detections: Detections) -> str:
    """Remark if groups were left as they are."""
    count = detections.unresolved_groups
    if not count:
        return ""
    groups = "groups of contacts are" if count > 1 else "group of contacts is"
    return f"{count} {groups} not explained by any disks and left as fitted first"


def _too_little_seen(foreground: Foreground, seen: Review) -> list[tuple[str, str]]:
    """A frame that does not show the background of its contacts, with its sentence."""
    count, (rows, columns) = len(seen.detections.contacts["x_px"]), foreground.image.shape
    if count and min(rows, columns) < LEAST_SIDE_PX:
        text = (
            f"the frame has {rows} x {columns} pixels: contacts and the background around them need "
            f"{LEAST_SIDE_PX} each way"
        )
        return [(Status.LITTLE_BACKGROUND, text)]
    most = LARGEST_UNSURROUNDED_SHARE if count >= FLAGGED_LEAST_CONTACTS else ALL_UNSURROUNDED
    if count and seen.unsurrounded > most:
        text = (
            f"no background is seen around {100 * seen.unsurrounded:.0f} % of the contacts: most of the "
            "frame is masked or saturated, or contacts fill it"
        )
        return [(Status.LITTLE_BACKGROUND, text)]
    return []


def _background_defects(difference: DifferenceImage, seen: Review) -> list[tuple[str, str]]:
    """What is wrong with the background: statuses with their sentences, gravest first."""
    left, defects = seen.background, list[tuple[str, str]]()
    if left.free_share < LEAST_FREE_SHARE:
        return []
    if difference.ratio and left.dark_share > LARGEST_DARK_SHARE:
        text = (
            f"{100 * left.dark_share:.3g} % of the background stand out of the reference the wrong way, by a "
            "fifth of the contrast and more: does the reference show contacts, or another place?"
        )
        defects.append((Status.WRONG_REFERENCE, text))
    if seen.of_reference > LARGEST_REFERENCE_SHARE:
        text = (
            f"{100 * seen.of_reference:.0f} % of the contacts are in the reference, not in the frame: is it "
            "that of another place?"
        )
        defects.append((Status.WRONG_REFERENCE, text))
    if left.found_share < LEAST_FOUND_SHARE:
        text = (
            f"the light was followed on {100 * left.found_share:.0f} % only of the background that contacts "
            "leave free: it changed in a way that was not followed"
        )
        defects.append((Status.LITTLE_BACKGROUND, text))
    if left.uneven > LARGEST_UNEVENNESS:
        text = f"the background is uneven by {100 * left.uneven:.3g} % of the contrast after all corrections"
        defects.append((Status.LIGHT_NOT_FOLLOWED, text))
    return defects


def _camera_defects(foreground: Foreground) -> list[tuple[str, str]]:
    """What is wrong with the camera: statuses with their sentences."""
    displaced = displacement_of_rows(foreground.image)
    if not displaced:
        return []
    text = (
        f"odd rows are displaced by {displaced:+.2g} px against even ones: the camera interlaces its rows, "
        "and the image moved; measure one field alone, every second row"
    )
    return [(Status.INTERLACED, text)]


def _contact_defects(seen: Review) -> list[tuple[str, str]]:
    """What is wrong with the contacts: statuses with their sentences, gravest first."""
    defects: list[tuple[str, str]] = []
    false = seen.invisible + seen.scratched
    flags = np.asarray(seen.detections.contacts["flags"], np.int64)
    if false >= FALSE_LEAST and false > FALSE_FRACTION * (flags.size + false):
        text = (
            f"{false} of {flags.size + false} candidates proved to be no contacts ({seen.invisible} do not "
            f"stand out of their surroundings, {seen.scratched} are pieces of scratches); others may be left"
        )
        defects.append((Status.FALSE_CANDIDATES, text))
    if text := _ran_out_of_work(seen.detections):
        defects.append((Status.UNRESOLVED, text))
    if seen.unexplained > UNEXPLAINED_FRACTION:
        text = (
            f"{100 * seen.unexplained:.3g} % of the pixels that stand out belong to no contact that was found"
        )
        defects.append((Status.UNRESOLVED, text))
    if saturated := _many(flags, Flag.SATURATED):
        text = (
            f"{saturated} of {flags.size} contacts are at the full scale of the sensor: expose less, "
            "the radii depend on a brightness that is not seen"
        )
        defects.append((Status.SATURATED, text))
    all_poor = flags.size * bool(np.all(flags & int(Flag.POOR_FIT)))
    if poor := _many(flags, Flag.POOR_FIT) or all_poor:
        blur = seen.detections.optics.blur_px
        text = f"{poor} of {flags.size} contacts do not look like disks behind a blur of {blur:.2g} px"
        defects.append((Status.POOR_FIT, text))
    if text := _unlike_ellipses(seen.detections):
        defects.append((Status.POOR_FIT, text))
    if text := _blurred_away(seen.detections):
        defects.append((Status.SOFT, text))
    if seen.agreement is not None and (text := seen.agreement.remark(seen.detections.contacts["radius_px"])):
        defects.append((Status.DISAGREES, text))
    return defects


def _blurred_away(detections: Detections) -> str:
    """What to say of counted pixels whose rims are about as wide as they are; empty if they are not."""
    if not isinstance(detections, CountedDetections):
        return ""
    radius, shift = (np.asarray(detections.contacts[name]) for name in ("radius_px", "edge_shift_px"))
    share = np.abs(shift) / radius
    if share.size < FLAGGED_LEAST_CONTACTS or np.median(share) <= LARGEST_EDGE_SHARE:
        return ""
    return (
        f"the radius is {np.median(radius):.2g} px in the median behind a blur of "
        f"{detections.rim_blur_px:.2g} px: either these are no contacts, or pixels above a "
        "threshold do not tell their areas"
    )


def _unlike_ellipses(detections: Detections) -> str:
    """What to say of counted regions of which most are no ellipses; empty if most are.

    An outline ``a (1 + e(angle))`` encloses less than the ellipse of its second moments, by the share
    ``4 <e^2>``; pixels and noise at the rim, of which the uncertainty of the radius tells, make part of it.
    """
    if not isinstance(detections, CountedDetections):
        return ""
    contacts = {name: np.asarray(values) for name, values in detections.contacts.items()}
    square = contacts["radius_px"] ** 2
    own = contacts["radius_std_px"] ** 2 - contacts["edge_shift_px"] ** 2 - contacts["contrast_shift_px"] ** 2
    rim = np.maximum(2.0 * np.pi * contacts["radius_px"] * own, PIXEL_VARIANCE)
    expected = 4.0 * rim / np.maximum(square, 1e-9)
    ellipse = contacts["semi_major_px"].astype(float) * contacts["semi_minor_px"].astype(float)
    lacking = 1.0 - square / np.maximum(ellipse, 1e-9) - expected
    shown = (expected < LARGEST_LACK) & np.isfinite(lacking)
    shown &= (contacts["flags"] & int(Flag.EDGE | Flag.SATURATED | Flag.MANUAL)) == 0
    if np.count_nonzero(shown) < FEWEST_SHAPES or np.median(lacking[shown]) <= LARGEST_LACK:
        return ""
    count, departure = np.count_nonzero(lacking[shown] > LARGEST_LACK), 0.5 * LARGEST_LACK**0.5
    return (
        f"{count} of {np.count_nonzero(shown)} counted regions depart from ellipses by more than "
        f"{100 * departure:.0f} % of their radius: they are no contacts, or were cut into parts that are none"
    )


def _ran_out_of_work(detections: Detections) -> str:
    """What to say of a fit that was cut off; empty for one that was not."""
    fit = detections.frame_fit if isinstance(detections, FittedDetections) else None
    if fit is None or not fit.problem.work.ran_out:
        return ""
    work, unsettled = fit.problem.work, int(np.count_nonzero(unfinished(detections)))
    if work.refused and not len(detections.contacts["x_px"]):
        return (
            "nothing was fitted: the disks that would explain what stands out overlap so much that one step "
            "of their fit would take longer than a frame of this size may"
        )
    return (
        "the fit was cut off, for it would have taken longer than a frame of this size may: "
        f"{unsettled} of {len(detections.contacts['x_px'])} contacts had not settled (their "
        f"uncertainties cover the areas of their light), {work.unresolved_groups} groups were left "
        "as fitted first"
    )


def _many(flags: NDArray[np.int64], flag: Flag) -> int:
    """Number of contacts with a flag; 0 if it is a small fraction of them."""
    count = int(np.count_nonzero(flags & int(flag)))
    return count if flags.size >= FLAGGED_LEAST_CONTACTS and count > FLAGGED_FRACTION * flags.size else 0


def _explain_no_contact(foreground: Foreground) -> str:
    """Why a frame has no contacts."""
    if foreground.measured_contrast.resolved:
        level = foreground.measured_contrast.plateau * foreground.frame_pair.unit
        return f"something stands out by {level:.3g} grey levels, but it is no contact for the assumed optics"
    if not measure_contrast(BinnedImage.of(-foreground.image), foreground.noise).resolved:
        return "nothing stands out of the noise"
    expected, opposite = ("brighter", "darker")[:: foreground.sign]
    return (
        f"nothing {expected} than the background stands out, but something {opposite}: is the polarity right?"
    )


def _remark_contrast(foreground: Foreground, detections: Detections) -> str:
    """Remark if the radii depend on a contrast that the frame does not show."""
    resolved = detections.own_optics.contrast_relative_std < RESOLVED
    if resolved or not len(detections.contacts["x_px"]):
        return ""
    optics = detections.optics.scaled(foreground.frame_pair.unit)
    source = "given" if np.isfinite(foreground.prior_optics.contrast) else "estimated from their light"
    return (
        "the contacts are too small to show their brightness: the radii depend on a contrast of "
        f"{optics.contrast:.3g} +- {optics.contrast_std:.2g} grey levels, {source}"
    )
