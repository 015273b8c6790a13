"""Measure the contacts of one frame: background, contrast, detection, disks, quality."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtri

from contactimg.errors import FrameError, InputError
from contactimg.imaging.background.difference_image import DifferenceImage, plain_difference
from contactimg.imaging.background.no_reference import estimate_background, estimate_either_background
from contactimg.imaging.background.subtract import subtract_reference
from contactimg.imaging.contrast.polarity import find_polarity
from contactimg.imaging.count.method import TYPICAL_BLUR, count_contacts
from contactimg.imaging.count.threshold import choose_threshold
from contactimg.imaging.fit.method import fit_contacts
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.film_rim import Rim
from contactimg.imaging.profile.optics import SharedOptics, combine_errors
from contactimg.imaging.reject.detections import Fitted
from contactimg.imaging.reject.dirt import absent_in_frame
from contactimg.imaging.reject.foreground import Foreground, find_foreground
from contactimg.imaging.reject.foreign_objects import NOTHING_FOREIGN
from contactimg.imaging.status import LIGHT_CHANGE, RESOLVED, judge
from contactimg.tables import Flag

CORRECTIONS = ("position_drift", "dust")
"""What a frame need not be searched for where it is known to be absent."""

PLACE = ("x_px", "y_px", "radius_px")
DISKS = {"x_px": "float64", "y_px": "float64", "radius_px": "float64", "radius_std_px": "float64",
         "flags": "int64", "contrast_shift_px": "float64", "blur_shift_px": "float64"}  # fmt: skip
NOTHING = np.empty(0)

CUT = 1.3  # radii from the centre of what is counted: a hole that close cuts the contact


@dataclass(frozen=True, eq=False)
class ImageMeasurement:
    """What a frame shows.

    Parameters
    ----------
    disks : DataFrame
        One row an asserted contact: label, x_px, y_px, radius_px, radius_std_px, flags
        (`contactimg.tables.Flag`), contrast_shift_px, blur_shift_px (`contactimg.tables.CONTACTS`).
    rejected : DataFrame
        x_px, y_px, radius_px, reason of candidates that are no contact.
    contrast : float
        Plateau minus background, grey levels; negative for contacts darker than the background.
    noise : float
        Standard deviation of one pixel of the difference, grey levels.
    threshold : float
        Fraction of the contrast that was used; NaN where none applies.
    blur_px : float
        Standard deviation of the point spread function; NaN where none was determined.
    shift_x_px, shift_y_px : float
        Position in the frame minus position in the reference; NaN without reference.
    polarity : str
        "bright" or "dark", as measured.
    status : str
        "ok", or what is wrong with the frame.
    message : str
        One sentence for a person; empty if there is nothing to say.
    difference : ndarray of float32, shape (rows, columns)
        Registered, light-corrected frame minus background, for pictures.
    optics : SharedOptics
        Contrast and blur that the radii stand for, with their uncertainties.
    own_optics : SharedOptics
        The same with the uncertainties that this frame alone leaves, without what was known beforehand.
    level : float
        Median grey level of the background; 0 where it was subtracted before.
    smallest_px : float
        Radius of a contact that just stands out: what is smaller is not seen. NaN if that is not known.
    measurable : bool
        False if nothing can be said about contacts: no contact found is then no measurement.
    foreign : Mask
        1 on objects that are no contacts and on their blurred rims.
    """

    disks: pd.DataFrame
    rejected: pd.DataFrame
    contrast: float
    noise: float
    threshold: float
    blur_px: float
    shift_x_px: float
    shift_y_px: float
    polarity: str
    status: str
    message: str
    difference: NDArray[np.float32]
    optics: SharedOptics
    own_optics: SharedOptics
    level: float
    smallest_px: float
    measurable: bool
    foreign: Mask

    @property
    def foreground(self) -> NDArray[np.float32]:
        """The difference with contacts positive, and 0 on what is foreign."""
        signed = self.difference * np.float32(np.sign(self.contrast))
        return signed if self.foreign is None else np.where(self.foreign, np.float32(0.0), signed)

    @property
    def resolved(self) -> bool:
        """Whether the frame itself shows how bright its contacts are."""
        return bool(self.own_optics.contrast_relative_std < RESOLVED)


def measure_image(
    image: NDArray,
    reference: NDArray | None = None,
    *,
    method: str = "disk",
    polarity: str = "auto",
    threshold: float | str | None = None,
    full_scale: float | None = None,
    blur_px: float | None = None,
    optics: SharedOptics | None = None,
    film: Rim | None = None,
    absent: Collection[str] = (),
) -> ImageMeasurement:
    """Measure the contacts of one frame.

    Parameters
    ----------
    image, reference : ndarray, shape (rows, columns)
        Grey levels, uint8, uint16 or float; non-finite pixels are holes. Without a reference the background
        is estimated from the image itself.
    method : {"disk", "threshold"}
        Fit of blurred disks, or the area of the pixels above the threshold.
    polarity : {"bright", "dark", "auto"}
        Whether contacts are brighter or darker than the background.
    threshold : float, "auto" or None
        Fraction of the contrast for ``"threshold"`` (None: 0.5).
    full_scale : float or None
        Grey level at which the sensor saturates; None: that of the pixel type.
    blur_px : float or None
        Standard deviation of the point spread function, px; None: found from the frame.
    optics : SharedOptics or None
        What is known of contrast and blur beforehand (from other frames, say), with uncertainties: the frame
        adds what it shows itself. A ``blur_px`` that is given is exact and takes its place.
    film : Rim or None
        Bright rim that the air film draws around the contacts, for ``"disk"``:
        `contactimg.imaging.profile.film_rim.FilmRim` or `contactimg.imaging.profile.film_rim.PlainRim`;
        None: the edge is sharp.
    absent : collection of str
        Of `CORRECTIONS`, what the frame is known not to show and is not looked for: ``"position_drift"`` (the
        reference is taken where it lies), ``"dust"`` (nothing is rejected as dirt).

    Returns
    -------
    ImageMeasurement

    Raises
    ------
    FrameError
        If the reference has another shape than the image.
    InputError
        If an option has a value that it cannot have.

    Examples
    --------
    >>> y, x = np.mgrid[0:64, 0:64]
    >>> image = (50 + 100 / (1 + np.exp(np.hypot(x - 30, y - 33) - 8))).astype(np.uint8)
    >>> found = measure_image(image, np.full((64, 64), 50, np.uint8)).disks
    >>> [float(found[name].iloc[0].round(0)) for name in ("x_px", "y_px", "radius_px")]
    [30.0, 33.0, 8.0]
    """
    _check(image, reference, method, polarity, absent)
    known = _known(optics, blur_px)
    frame_pair = FramePair.of(image, _same_levels(image, reference), full_scale)
    difference, sign = _subtract(frame_pair, polarity, registered="position_drift" in absent)
    difference = replace(difference, dust_free="dust" in absent)
    frame_pair = frame_pair if difference.valid is None else frame_pair.within(difference.valid)
    seen = find_foreground(frame_pair, difference, sign, known.scaled(1.0 / frame_pair.unit))
    contrast, frame_pair = seen.contrast, seen.frame_pair
    fraction = choose_threshold(seen.image, contrast, threshold)
    found = Fitted(dict.fromkeys(DISKS, NOTHING), NOTHING_FOREIGN.rejected, seen.known, seen.known)
    if contrast.plateau > 0:
        if method == "threshold":
            found = _count(seen, difference, fraction)
        else:
            found = fit_contacts(
                seen.image, frame_pair, difference,
                contrast=contrast, noise=seen.noise, known=seen.known, film=film,
            )  # fmt: skip
    status, message, measurable = judge(frame_pair, difference, seen, found)
    return ImageMeasurement(
        disks=_disks_table(found),
        rejected=_rejected_table(seen.foreign.rejected, found.rejected),
        contrast=sign * found.optics.contrast * frame_pair.unit if contrast.plateau > 0 else 0.0,
        noise=seen.noise * frame_pair.unit,
        threshold=fraction if method == "threshold" else float("nan"),
        blur_px=found.optics.blur_px,
        shift_x_px=difference.shift.x_px if difference.shift else float("nan"),
        shift_y_px=difference.shift.y_px if difference.shift else float("nan"),
        polarity="bright" if sign > 0 else "dark",
        status=status,
        message=message,
        difference=difference.image
        if frame_pair.unit == 1.0
        else difference.image * np.float32(frame_pair.unit),
        optics=found.optics.scaled(frame_pair.unit),
        own_optics=found.own.scaled(frame_pair.unit),
        level=difference.level * frame_pair.unit,
        smallest_px=found.smallest_px,
        measurable=measurable,
        foreign=seen.foreign.mask,
    )


def _disks_table(found: Fitted) -> pd.DataFrame:
    """The contacts, numbered from 1, marked if their frame does not show how bright they are."""
    count = len(found.contacts["x_px"])
    unseen = 0 if found.own.contrast_relative_std < RESOLVED else int(Flag.NO_PLATEAU)
    columns = {name: np.asarray(found.contacts[name], dtype) for name, dtype in DISKS.items()}
    return pd.DataFrame(
        {"label": np.arange(1, count + 1, dtype=np.int64), **columns, "flags": columns["flags"] | unseen}
    )


def _rejected_table(*parts: dict[str, NDArray]) -> pd.DataFrame:
    """The rejected candidates of several tables."""
    columns = {name: np.concatenate([part[name] for part in parts]).astype(float) for name in PLACE}
    reasons = np.concatenate([part["reason"].astype(object) for part in parts])
    return pd.DataFrame({**columns, "reason": pd.array(reasons, dtype="str")})


def _known(optics: SharedOptics | None, blur_px: float | None) -> SharedOptics:
    """What is known beforehand, checked."""
    known = SharedOptics() if optics is None else optics
    if blur_px is not None:
        known = replace(known, blur_px=blur_px, blur_std_px=0.0, correlation=0.0)
    for name, value in (("contrast", known.contrast), ("blur_px", known.blur_px)):
        if not np.isnan(value) and not 0 < value < np.inf:
            raise InputError(f"a {name} that is handed over must be a positive number, got {value!r}")
    return known


def _count(seen: Foreground, difference: DifferenceImage, fraction: float) -> Fitted:
    """The paper's measurement, with what an error of the contrast does to it."""
    contrast, frame_pair = seen.contrast, seen.frame_pair
    contacts, rejected = count_contacts(
        seen.image, fraction=fraction, contrast=contrast, noise=seen.noise, saturated=frame_pair.saturated
    )
    cut = frame_pair.near_hole(contacts["x_px"], contacts["y_px"], CUT * contacts["radius_px"] + 1.5)
    contacts["flags"] = contacts["flags"] | np.where(cut, int(Flag.EDGE), 0)
    dust = absent_in_frame(
        frame_pair.frame, seen.image, difference, np.column_stack([contacts[name] for name in PLACE])
    )
    gone = np.full(np.count_nonzero(dust), "dust in the reference")
    rejected = {
        "reason": np.append(rejected["reason"], gone),
        **{name: np.append(rejected[name], contacts[name][dust]) for name in PLACE},
    }
    contacts = {name: values[~dust] for name, values in contacts.items()}
    # the threshold is a fraction of the contrast: where it cuts the rim of a wide contact moves with it
    slope = np.exp(-0.5 * ndtri(fraction) ** 2) / (np.sqrt(2 * np.pi) * TYPICAL_BLUR)
    shift = np.full(len(contacts["x_px"]), -fraction * contrast.std / contrast.plateau / slope)
    contacts["radius_std_px"] = combine_errors(contacts["radius_std_px"], shift[:, None])
    contacts |= {"contrast_shift_px": shift, "blur_shift_px": np.zeros(len(shift))}
    optics = SharedOptics(contrast.plateau, contrast.std, blur_std_px=np.nan)
    # the middle of a blurred disk reaches 1 - exp(-a^2/(2 s^2)) of the contrast
    smallest = TYPICAL_BLUR * np.sqrt(-2.0 * np.log1p(-fraction))
    own = SharedOptics(max(seen.shown.plateau, 1e-9), seen.shown.std, blur_std_px=np.nan)
    return Fitted(contacts, rejected, optics, own, float(smallest))


def _check(
    image: NDArray, reference: NDArray | None, method: str, polarity: str, absent: Collection[str]
) -> None:
    """Refuse what cannot be measured."""
    if not set(absent) <= set(CORRECTIONS):
        raise InputError(f"absent must name some of {', '.join(CORRECTIONS)}, got {sorted(absent)}")
    if image.ndim != 2 or image.size == 0:
        raise FrameError(f"an image must have two dimensions and at least one pixel, got shape {image.shape}")
    if reference is not None and reference.shape != image.shape:
        raise FrameError(
            f"the reference must have the size of the frame, {image.shape[1]} x {image.shape[0]} pixels, "
            f"got {' x '.join(str(n) for n in reference.shape[::-1])}"
        )
    if method not in ("disk", "threshold"):
        raise InputError(f'method must be "disk" or "threshold", got {method!r}')
    if polarity not in ("bright", "dark", "auto"):
        raise InputError(f'polarity must be "bright", "dark" or "auto", got {polarity!r}')


def _subtract(frame_pair: FramePair, polarity: str, *, registered: bool) -> tuple[DifferenceImage, int]:
    """Difference image and the sign that makes contacts positive."""
    frame, reference = frame_pair.frame, frame_pair.reference
    if frame_pair.trivial:
        plain = np.subtract(frame, frame if reference is None else reference, dtype=np.float32)
        return plain_difference(plain), -1 if polarity == "dark" else 1
    if reference is not None:
        background_is = {"bright": "lowest", "dark": "highest", "auto": "nearest_one"}[polarity]
        difference = subtract_reference(
            frame, reference, valid=frame_pair.valid, background_is=background_is, registered=registered
        )
    elif polarity == "auto":
        return estimate_either_background(np.asarray(frame, np.float32), valid=frame_pair.valid)
    else:
        seen = np.asarray(frame, np.float32)
        difference = estimate_background(seen, valid=frame_pair.valid, dark=polarity == "dark")
    if polarity != "auto":
        return difference, 1 if polarity == "bright" else -1
    blocks = block_means(difference.image)
    scatter = 1.4826 * float(np.median(np.abs(blocks - np.median(blocks))))
    return difference, 1 if find_polarity(blocks, scatter) == "bright" else -1


def _same_levels(image: NDArray, reference: NDArray | None) -> NDArray | None:
    """The reference in grey levels about those of the frame, where it was stored with another depth."""
    if reference is None or reference.dtype == image.dtype:
        return reference
    levels = [float(np.nanmedian(np.where(np.isfinite(part), part, np.nan))) for part in
              (np.asarray(array[::8, ::8], float) for array in (image, reference))
              if np.isfinite(part).any()]  # fmt: skip
    if len(levels) < 2 or min(levels) <= 0 or 1 / LIGHT_CHANGE < levels[0] / levels[1] < LIGHT_CHANGE:
        return reference
    return np.asarray(reference, np.float32) * np.float32(levels[0] / levels[1])
