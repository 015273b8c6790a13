"""What to say of a measured frame: its status, and sentences for a person."""

import numpy as np

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.contrast.plateau import measure_contrast
from contactimg.imaging.pixels.binned_image import BinnedImage
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.reject.detections import Fitted
from contactimg.imaging.reject.foreground import Foreground
from contactimg.tables import Flag

RESOLVED = 0.05
"""Relative uncertainty of the contrast from which on a frame does not show it: 2.5 % of a small radius, 7.5 %
of a force."""
LIGHT_CHANGE = 1.5
"""A background this many times brighter or darker than the reference's is suspicious."""

ENOUGH = 3  # contacts of which a third fit poorly: not their fault


def judge(
    frame_pair: FramePair, difference: DifferenceImage, foreground: Foreground, found: Fitted
) -> tuple[str, str, bool]:
    """Status and message of the frame, and whether it can be measured at all."""
    if frame_pair.trivial:
        # a frame that is its own reference shows as little contact as that; the others show nothing at all
        return frame_pair.defect, frame_pair.message, frame_pair.defect == "identical to reference"
    count, status = len(found.contacts["x_px"]), frame_pair.defect
    notes = [frame_pair.message, difference.remark]
    if frame_pair.reference is None and not frame_pair.defect:
        notes.append("no reference: the background was estimated from the frame")
    ratio = float(difference.illumination.coefficients[0, 0])
    changed = difference.ratio and not 1 / LIGHT_CHANGE < ratio < LIGHT_CHANGE
    if changed:
        status = status or "light changed"
        who = "contacts fill" if count else "one contact fills"
        notes.append(
            f"the background is {ratio:.2g} times the reference: the light changed or {who} the frame"
        )
    elif not count:
        status = status or "no contact"
        notes.append(_why_nothing(foreground, frame_pair.unit))
    elif difference.registration_failed:
        status = status or "not registered"
    notes += [
        foreground.doubt(frame_pair.unit),
        _poor_fits(found),
        _unresolved(found, foreground.known, frame_pair.unit),
    ]
    return status or "ok", "; ".join(note for note in notes if note), bool(count or not changed)


def _poor_fits(found: Fitted) -> str:
    """What to say where many contacts are no disks."""
    flags = np.asarray(found.contacts["flags"], np.int64)
    poor = np.count_nonzero(flags & int(Flag.POOR_FIT))
    if flags.size < ENOUGH or poor <= flags.size / 3:
        return ""
    blur = found.optics.blur_px
    return f"{poor} of {flags.size} contacts do not look like disks behind a blur of {blur:.2g} px"


def _why_nothing(foreground: Foreground, unit: float) -> str:
    """What to say of a frame without contacts."""
    if foreground.shown.resolved:
        level = foreground.shown.plateau * unit
        return f"something stands out by {level:.3g} grey levels, but is no contact behind the optics assumed"
    if not measure_contrast(BinnedImage.of(-foreground.image), foreground.noise).resolved:
        return "nothing stands out of the noise"
    found, other = ("brighter", "darker")[:: foreground.sign]
    return f"nothing {found} than the background stands out, but something {other}: is the polarity right?"


def _unresolved(found: Fitted, known: SharedOptics, unit: float) -> str:
    """What to say of a frame with contacts that does not show its contrast."""
    if not len(found.contacts["x_px"]) or found.own.contrast_relative_std < RESOLVED:
        return ""
    optics = found.optics.scaled(unit)
    source = "handed over" if np.isfinite(known.contrast) else "estimated from their light"
    return (
        "the contacts are too small to show their brightness: radii lean on a contrast of "
        f"{optics.contrast:.3g} +- {optics.contrast_std:.2g} grey levels {source}"
    )
