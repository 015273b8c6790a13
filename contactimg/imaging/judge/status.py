"""Judge a measured frame: its status, remarks for the user, and whether it can be measured at all."""

from dataclasses import dataclass

import numpy as np

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.plateau import measure_contrast
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.reject.detections import Detections
from contactimg.imaging.reject.foreground import Foreground
from contactimg.tables import Flag, Status

RESOLVED = 0.05
"""Relative standard uncertainty of the contrast above which a frame counts as not showing it. Chosen: 5 % of
the contrast make 2.5 % of the radius of a small contact and 7.5 % of its force."""

LIGHT_CHANGE = 1.5
"""Ratio of the background to the reference, or its inverse, above which the light has changed. Chosen by
hand; sensitivity not measured."""

POOR_FIT_FRACTION = 1 / 3
"""Fraction of poor fits above which the frame is remarked on, and ..."""
POOR_FIT_LEAST_CONTACTS = 3
"""... the least number of contacts for that. Both chosen by hand; they only decide on a remark."""


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


def judge(foreground: Foreground, difference: DifferenceImage, detections: Detections) -> Verdict:
    """Status, remarks and measurability of a frame."""
    frame_pair = foreground.frame_pair
    if frame_pair.trivial:
        # a frame equal to its reference does show that there is no contact; the others show nothing
        return Verdict(
            frame_pair.defect, frame_pair.message, measurable=frame_pair.defect == Status.IDENTICAL
        )
    count, status = len(detections.contacts["x_px"]), frame_pair.defect
    remarks = [frame_pair.message, difference.remark]
    if frame_pair.reference is None and not frame_pair.defect:
        remarks.append("no reference: the background was estimated from the frame")
    ratio = float(difference.illumination.coefficients[0, 0])
    light_changed = difference.ratio and not 1 / LIGHT_CHANGE < ratio < LIGHT_CHANGE
    if light_changed:
        status = status or Status.LIGHT_CHANGED
        contacts = "contacts fill" if count else "one contact fills"
        remarks.append(
            f"the background is {ratio:.2g} times the reference: the light changed or {contacts} the frame"
        )
    elif not count:
        status = status or Status.NO_CONTACT
        remarks.append(_explain_no_contact(foreground))
    elif difference.registration_failed:
        status = status or Status.NOT_REGISTERED
    remarks += [foreground.remark, _remark_poor_fits(detections), _remark_contrast(foreground, detections)]
    message = "; ".join(remark for remark in remarks if remark)
    return Verdict(status or Status.OK, message, measurable=bool(count or not light_changed))


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


def _remark_poor_fits(detections: Detections) -> str:
    """Remark if many contacts are not disks."""
    flags = np.asarray(detections.contacts["flags"], np.int64)
    poor = np.count_nonzero(flags & int(Flag.POOR_FIT))
    if flags.size < POOR_FIT_LEAST_CONTACTS or poor <= POOR_FIT_FRACTION * flags.size:
        return ""
    blur = detections.optics.blur_px
    return f"{poor} of {flags.size} contacts do not look like disks behind a blur of {blur:.2g} px"


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
