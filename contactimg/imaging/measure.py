"""Measure the contacts of one frame.

The steps: check the input, pair frame and reference, take out what the sensor adds, subtract the
background, find and measure the contacts by one of the two methods, decide on each and on the frame,
tabulate.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import FrameError, InputError, finite_number
from contactimg.frame import as_pixels, full_scale_of_type
from contactimg.imaging.background.alignment import UNKNOWN
from contactimg.imaging.background.illumination import DifferenceImage, plain_difference
from contactimg.imaging.background.no_reference import estimate_background
from contactimg.imaging.background.subtract import remove_background
from contactimg.imaging.count.method import choose_threshold, measure_by_count
from contactimg.imaging.detect.hand_edits import HandEdit, remark_on
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX
from contactimg.imaging.evidence.reference_dust import find_dust
from contactimg.imaging.evidence.rules import PLACE, Judged, judge_contacts
from contactimg.imaging.evidence.status import LIGHT_CHANGE, judge_frame
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.imaging.fit.method import measure_by_fit
from contactimg.imaging.foreground import Foreground, find_foreground
from contactimg.imaging.pixels.field_of_view import find_margin, find_unlit
from contactimg.imaging.pixels.frame_pair import FramePair, keep_freed_memory
from contactimg.imaging.pixels.masks import Mask, exclude
from contactimg.imaging.pixels.sensor_defects import divide_by_mosaic, mosaic_gains, repair_defects
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, LONGEST_RADII, RESOLVED
from contactimg.imaging.profile.optics import KnownEdge, SharedOptics
from contactimg.tables import CONTACTS, Flag, Reason

CHOICES = {
    "method": ("disk", "threshold"),
    "polarity": ("bright", "dark", "auto"),
    "shape": ("auto", "disk", "ellipse", "free"),
    "registration": ("strips", "whole"),
}
"""Values of the options that have a few."""
CORRECTIONS = ("position_drift", "dust", "film")
"""What is corrected, or allowed for, unless its cause is known to be absent."""
LINEARITY = 0.01
"""Error of an unknown camera's response at mid-level, of the contrast. By hand: usual for CCD cameras."""
SI = ("_m", "_m2", "_N")
"""Endings of what a frame alone does not tell."""
NUMBERS = [
    name for name, (kind, _) in CONTACTS.columns.items() if kind == "float64" and not name.endswith(SI)
]
"""Columns of the contacts of a frame that are numbers; the others are label, shape and flags."""


@dataclass(frozen=True, eq=False)
class ImageMeasurement:
    """Contacts, rejected candidates, optics and status of one frame.

    Parameters
    ----------
    disks : DataFrame
        One row an asserted contact: label, shape, flags and `NUMBERS` (`contactimg.tables.CONTACTS`).
    rejected : DataFrame
        Candidates that are no contact: x_px, y_px, radius_px, reason (`contactimg.tables.Reason`).
    contrast : float
        Plateau minus background, grey levels; negative for contacts darker than the background.
    noise : float
        Standard deviation of one pixel of the difference, grey levels.
    threshold : float
        Fraction of the contrast above which pixels were counted; NaN for the method "disk".
    blur_px : float
        Standard deviation of the point spread function; NaN where none was determined.
    shift_x_px, shift_y_px : float
        Position in the frame minus position in the reference; NaN without reference.
    polarity : str
        "bright" or "dark", as measured.
    status, message : str
        "ok", or the defect of the frame; sentences for the user.
    difference : ndarray of float32, shape (rows, columns)
        Frame minus registered background, corrected for illumination; for pictures.
    optics, own_optics : SharedOptics
        Contrast and blur on which the radii are based, and what this frame alone gives.
    level : float
        Median grey level of the background; 0 if it had been subtracted already.
    smallest_px : float
        Radius of the smallest contact that the method detects; NaN if that is not known.
    measurable : bool
        Whether "no contact" is a result; False if the frame does not allow one.
    film : FilmVerdict or None
        What the rims say of an air film; None where none was looked for.
    foreground : Foreground
        What was measured, for `count_again`.
    unmatched : sequence of HandEdit
        Corrections that meet no contact.
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
    film: FilmVerdict | None
    foreground: Foreground
    unmatched: Sequence[HandEdit] = ()

    @property
    def resolved(self) -> bool:
        """Whether the frame itself shows the contrast of its contacts."""
        return bool(self.own_optics.contrast_relative_std < RESOLVED)

    def outlines(self) -> list[tuple[int, list[NDArray[np.float64]]]]:
        """Row of each contact of free shape, and its level lines (x, y) at half height, the outer first."""
        found = []
        image, rows = self.foreground.image, np.flatnonzero(self.disks["shape"] == "free")
        places = self.disks[list(PLACE)].to_numpy(float)
        if len(rows):
            from skimage.measure import find_contours  # noqa: PLC0415 - slow to import, seldom needed
        for row in rows.tolist():
            x, y, a = places[row]
            reach = LONGEST_RADII * a + EDGE_BLUR_WIDTHS * DEFAULT_BLUR_PX
            left, top = max(int(x - reach), 0), max(int(y - reach), 0)
            window = image[top : max(int(y + reach) + 2, 0), left : max(int(x + reach) + 2, 0)]
            if min(window.shape, default=0) < 2:
                continue
            lines = find_contours(np.pad(window, 1), 0.5 * float(np.quantile(window, 0.9)))
            # Noise makes outlines of fewer points. By hand.
            long = sorted((line for line in lines if len(line) > 8), key=len, reverse=True)
            if long:
                found.append((row, [line[:, ::-1] - 1.0 + np.array([left, top]) for line in long]))
        return found


def measure_image(
    image: ArrayLike,
    reference: ArrayLike | None = None,
    *,
    method: str = "disk",
    polarity: str = "auto",
    threshold: float | str | None = None,
    threshold_std: float = 0.0,
    full_scale: float | None = None,
    blur_px: float | None = None,
    optics: SharedOptics | None = None,
    film: FilmSetting | FilmRim | None = None,
    absent: Collection[str] = (),
    edits: Sequence[HandEdit] = (),
    shape: str = "auto",
    linearity: float = LINEARITY,
    registration: str = "strips",
) -> ImageMeasurement:
    """Measure the contacts of one frame.

    Parameters
    ----------
    image, reference : array_like, shape (rows, columns)
        Grey levels, uint8, uint16 or float; pixels that are not finite, or masked, are holes. Without a
        reference the background is estimated from the image itself.
    method : {"disk", "threshold"}
        Fit of blurred disks, or area of the pixels above a threshold.
    polarity : {"bright", "dark", "auto"}
        Whether contacts are brighter or darker than the background.
    threshold : float, "auto" or None
        Fraction of the contrast for ``"threshold"`` (None: 0.5).
    threshold_std : float
        Its standard uncertainty.
    full_scale : float or None
        Grey level at which the sensor saturates; None: that of the pixel type.
    blur_px : float or None
        Standard deviation of the point spread function, px; None: estimated from the frame.
    optics : SharedOptics or None
        Prior knowledge of contrast and blur with uncertainties (from other frames, say), which the fit
        combines with what the frame shows, and of the place of the edge. A ``blur_px`` is taken as exact and
        replaces the prior blur.
    film : FilmSetting, FilmRim or None
        Bright rim that the air film draws around the contacts, for ``"disk"``, and whether it is drawn
        (`contactimg.imaging.profile.film_rim.FilmSetting`; a rim alone is); None: none is looked for.
    absent : collection of str
        Those of `CORRECTIONS` to leave out because their cause is absent: ``"position_drift"`` (the reference
        is not registered), ``"dust"`` (nothing is rejected as dirt), ``"film"`` (``edge_shift_px`` contains
        nothing for an air film too narrow to be seen; without effect where ``film`` is given).
    edits : sequence of HandEdit
        Corrections by hand (`contactimg.imaging.detect.hand_edits`); those that meet no contact are named in
        the message.
    shape : {"auto", "disk", "ellipse", "free"}
        Shape of the contacts, for ``"disk"``: "auto" takes a disk, an ellipse where no disk describes a
        contact, and the counted area where neither does; "free" counts the pixels of all contacts.
    linearity : float
        Standard uncertainty of the camera's response at mid-level, of the contrast; no fit can see it, and
        ``edge_shift_px`` contains what it does to the edges. 0 for a camera that is known to be linear.
    registration : {"strips", "whole"}
        What of the image the shift against the reference is found from.

    Returns
    -------
    ImageMeasurement

    Raises
    ------
    FrameError
        If the reference has another shape than the image, or one of them holds no real numbers.
    InputError
        If an option has a value that it cannot have.

    Examples
    --------
    >>> y, x = np.mgrid[0:64, 0:64]
    >>> image = (50 + 100 / (1 + np.exp(np.hypot(x - 30, y - 33) - 8))).astype(np.uint8)
    >>> disks = measure_image(image, np.full((64, 64), 50, np.uint8)).disks
    >>> [float(disks[name].iloc[0].round(0)) for name in ("x_px", "y_px", "radius_px")]
    [30.0, 33.0, 8.0]
    """
    of_type = full_scale_of_type(image)
    image, reference = _grey_levels(image), None if reference is None else _grey_levels(reference)
    _check(image, reference, absent, method=method, polarity=polarity, shape=shape, registration=registration)
    _check_types(optics=(optics, SharedOptics), film=(film, FilmSetting, FilmRim), edits=(edits, Sequence))
    edits = () if edits is None else edits
    _check_types(**{f"edits[{n}]": (edit, HandEdit) for n, edit in enumerate(edits)})
    for name, fraction in (("linearity", linearity), ("threshold_std", threshold_std)):
        if not (isinstance(fraction, Real) and 0 <= fraction < 1):
            raise InputError(f"{name} must be a fraction of the contrast, 0 <= {name} < 1, got {fraction!r}")
    if full_scale is not None and not (isinstance(full_scale, Real) and full_scale > 0):
        raise InputError(f"full_scale must be a grey level above zero, got {full_scale!r}")
    full_scale = of_type if full_scale is None else full_scale
    keep_freed_memory()
    prior = _prior_optics(optics, blur_px)
    pair = _without_sensor(FramePair.of(image, _match_levels(image, reference), full_scale))
    registered, whole = "position_drift" in absent, registration == "whole"
    difference, sign = _subtract_background(pair, polarity, registered=registered, whole=whole)
    pair = pair if difference.valid is None else pair.within(difference.valid)
    per_level, dust = prior.relative and difference.level > 0, "dust" not in absent
    prior = replace(prior.scaled(difference.level if per_level else 1.0 / pair.unit), relative=False)
    foreground = find_foreground(pair, difference, sign, prior, dust=dust)
    fraction = choose_threshold(foreground.image, foreground.contrast, threshold)
    if method == "threshold" or not foreground.contrast.plateau > 0:
        counted = count_again(foreground, fraction, fraction_std=threshold_std, edits=edits)
        return counted if method == "threshold" else replace(counted, threshold=float("nan"))
    setting = film if film is None or isinstance(film, FilmSetting) else FilmSetting(film)
    fit = partial(measure_by_fit, film=setting, edits=edits, shape=shape, linear=linearity == 0.0)
    result = fit(foreground)
    if result.contradicts_prior:
        refused, prior = prior, SharedOptics(known_edge=prior.known_edge)
        foreground = replace(find_foreground(pair, difference, sign, prior, dust=dust), refused=refused)
        result = fit(foreground)
    unknown = film is None and "film" not in absent
    judged = judge_contacts(foreground, result, shape=shape, linearity=linearity, film_unknown=unknown)
    return _tabulate(judged)


def count_again(
    foreground: Foreground, fraction: float, *, fraction_std: float = 0.0, edits: Sequence[HandEdit] = ()
) -> ImageMeasurement:
    """The measurement of `measure_image` with the method "threshold" at this fraction of the contrast."""
    counted = measure_by_count(foreground, fraction=fraction, fraction_std=fraction_std, edits=edits)
    return _tabulate(counted, threshold=fraction)


def _tabulate(judged: Judged, threshold: float = float("nan")) -> ImageMeasurement:
    """The result, in the grey levels of the frame."""
    foreground, contacts, fit = judged.foreground, judged.contacts, judged.fit
    unit, difference = foreground.frame_pair.unit, foreground.difference
    status, message, measurable = judge_frame(judged)
    known = foreground.prior_optics.known_edge
    if known is not None and fit is not None:
        contacts = _without_shift(contacts, known)
    contrast = judged.optics.contrast
    if not judged.count:
        contrast = min(contrast, foreground.shown_contrast)
    alignment = difference.alignment or UNKNOWN
    shift = (alignment.x_px, alignment.y_px) if alignment.known else (float("nan"), float("nan"))
    foreign = _foreign(foreground)
    rejected = {name: np.concatenate([foreign[name], judged.rejected[name]]) for name in foreign}
    return ImageMeasurement(
        disks=_contacts_table(contacts, judged.own_optics),
        rejected=pd.DataFrame(
            {name: rejected[name].astype(float) for name in PLACE}
            | {"reason": pd.array(rejected["reason"].astype(object), dtype="str")}
        ),
        contrast=foreground.sign * contrast * unit if foreground.contrast.plateau > 0 else 0.0,
        noise=foreground.noise * unit,
        threshold=threshold,
        blur_px=judged.optics.blur_px,
        shift_x_px=shift[0],
        shift_y_px=shift[1],
        polarity="bright" if foreground.sign > 0 else "dark",
        status=status,
        message="; ".join(filter(None, (message, remark_on(judged.unmatched)))),
        difference=difference.image if unit == 1.0 else difference.image * np.float32(unit),
        optics=judged.optics.scaled(unit),
        own_optics=judged.own_optics.scaled(unit),
        level=difference.level * unit,
        smallest_px=judged.smallest_px,
        measurable=measurable,
        film=None if fit is None or fit.film is None else fit.film.verdict,
        foreground=foreground,
        unmatched=judged.unmatched,
    )


def _foreign(foreground: Foreground) -> dict[str, NDArray]:
    """The foreign objects; those that the frame itself does not show are dust in the reference."""
    foreign = foreground.foreign.rejected
    dust = find_dust(foreground, np.column_stack([foreign[name] for name in PLACE]), DEFAULT_BLUR_PX)
    return foreign | {"reason": np.where(dust, Reason.REFERENCE_DUST.value, foreign["reason"])}


def _contacts_table(contacts: dict[str, NDArray], own: SharedOptics) -> pd.DataFrame:
    """The contacts, numbered from 1, flagged if their frame does not show its contrast."""
    radius, std, n = contacts["radius_px"], contacts["radius_std_px"], len(contacts["x_px"])
    columns = {
        "shape": np.full(n, "disk", object),
        "area_px2": np.pi * radius**2,
        "area_std_px2": 2.0 * np.pi * radius * std,
        "semi_major_px": radius,
        "semi_minor_px": radius,
        "perimeter_px": 2.0 * np.pi * radius,
    } | contacts
    # one block of numbers: a table of single columns takes three times as long
    numbers = np.column_stack([columns.get(name, np.full(n, np.nan)) for name in NUMBERS])
    table = pd.DataFrame(numbers, columns=NUMBERS)
    table.insert(0, "label", np.arange(1, n + 1, dtype=np.int64))
    table["shape"] = pd.array(columns["shape"], dtype="str")
    no_plateau = 0 if own.contrast_relative_std < RESOLVED else int(Flag.NO_PLATEAU)
    table["flags"] = columns["flags"] | no_plateau
    return table


def _without_shift(contacts: dict[str, NDArray], known: KnownEdge) -> dict[str, NDArray]:
    """The contacts with the shift that a reference contact has told taken off their radii."""
    moved = {
        name: np.maximum(contacts[name] - known.shift_px, 0.1 * contacts[name])
        for name in ("radius_px", "semi_major_px", "semi_minor_px")
    }
    ratio = moved["radius_px"] / np.maximum(contacts["radius_px"], 1e-9)
    lengths, areas = ("perimeter_px", "area_std_px2"), ("area_px2", "visible_area_px2")
    powers = dict.fromkeys(lengths, ratio) | dict.fromkeys(areas, ratio**2)
    return contacts | moved | {name: contacts[name] * power for name, power in powers.items()}


def _without_sensor(pair: FramePair) -> FramePair:
    """The pair without regions that no light reaches, gains of a colour mosaic and defective pixels."""
    if pair.trivial:
        return pair
    images = [image for image in (pair.frame, pair.reference) if image is not None]
    gains = mosaic_gains(images[-1], pair.valid)
    if gains is not None:
        images = [divide_by_mosaic(image, gains) for image in images]
    repaired, defects = zip(*(repair_defects(image, pair.valid) for image in images), strict=True)
    saturated = None if pair.saturated is None else exclude(pair.saturated, defects[0])
    shown = [_lit(image, pair) for image in repaired]
    valid = shown[-1]
    if len(shown) > 1 and any(part is not None for part in shown):
        every = np.ones(pair.frame.shape, np.uint8)
        one, other = (every if part is None else part for part in shown)
        valid, pair = one & other, replace(pair, lit_in_one=float(np.mean(one != other)))
    if valid is not None and not valid.any():
        return pair
    frame, reference = (*repaired, None)[:2]
    return replace(pair, frame=frame, reference=reference, valid=valid, saturated=saturated)


def _lit(image: NDArray, pair: FramePair) -> Mask:
    """0 at the holes of a pair, and where no light reaches an image of it or a margin was drawn."""
    unlit = find_unlit(image, pair.valid), find_margin(image, pair.valid, pair.full_scale)
    return exclude(exclude(pair.valid, unlit[0]), unlit[1])


def _prior_optics(optics: SharedOptics | None, blur_px: float | None) -> SharedOptics:
    """Prior knowledge of contrast and blur, checked; a given blur is exact."""
    prior = SharedOptics() if optics is None else optics
    if blur_px is not None:
        blur_px = finite_number(blur_px, "blur_px", "px")
        prior = replace(prior, blur_px=blur_px, blur_std_px=0.0, correlation=0.0)
    # other frames may have shown edges as sharp as their pixels
    sharp = blur_px is None and prior.blur_px == 0
    for name, value in (("contrast", prior.contrast), ("blur_px", prior.blur_px)):
        if not (np.isnan(value) or 0 < value < np.inf or (name == "blur_px" and sharp)):
            raise InputError(f"a given {name} must be a positive number, got {value!r}")
    return prior


def _grey_levels(image: ArrayLike) -> NDArray:
    """The image as an array of numbers; masked pixels are holes."""
    levels = as_pixels(image)
    if levels.dtype.kind not in "buif":
        said = repr(image) if isinstance(image, str) else f"numbers of the type {levels.dtype}"
        hint = "contactimg.read_frames reads files"
        raise FrameError(f"an image must be an array of grey levels, got {said}; {hint}")
    return levels


def _check(image: NDArray, reference: NDArray | None, absent: Collection[str], **chosen: str) -> None:
    """Refuse what cannot be measured."""
    if not set(absent) <= set(CORRECTIONS):
        raise InputError(f"absent must name some of {', '.join(CORRECTIONS)}, got {sorted(absent)}")
    for name, value in chosen.items():
        if value not in CHOICES[name]:
            *others, last = (f'"{choice}"' for choice in CHOICES[name])
            raise InputError(f"{name} must be {', '.join(others)} or {last}, got {value!r}")
    if image.ndim != 2 or image.size == 0:
        raise FrameError(f"an image must have two dimensions and at least one pixel, got shape {image.shape}")
    if reference is not None and reference.shape != image.shape:
        raise FrameError(
            f"the reference must have the size of the frame, {image.shape[1]} x {image.shape[0]} pixels, "
            f"got {' x '.join(str(n) for n in reference.shape[::-1])}"
        )


def _check_types(**given: tuple[Any, ...]) -> None:
    """Refuse values of a wrong type; each name comes with a value, which may be None, and its types."""
    for name, (value, *types) in given.items():
        if value is not None and not isinstance(value, tuple(types)):
            names = " or ".join(kind.__name__ for kind in types)
            raise InputError(f"{name} must be of type {names}, got {value!r}")


def _subtract_background(pair: FramePair, polarity: str, **registration: bool) -> tuple[DifferenceImage, int]:
    """Difference image and the sign that makes contacts positive."""
    frame, reference = pair.frame, pair.reference
    if pair.trivial:
        plain = np.subtract(frame, frame if reference is None else reference, dtype=np.float32)
        return plain_difference(plain), -1 if polarity == "dark" else 1
    if reference is not None:
        return remove_background(frame, reference, valid=pair.valid, polarity=polarity, **registration)
    return estimate_background(frame, valid=pair.valid, polarity=polarity)


def _match_levels(image: NDArray, reference: NDArray | None) -> NDArray | None:
    """The reference, brought to the grey levels of the frame if it was stored with another bit depth."""
    if reference is None or reference.dtype == image.dtype:
        return reference
    samples = [np.asarray(array[::8, ::8], float) for array in (image, reference)]
    levels = [float(np.median(part[np.isfinite(part)])) for part in samples if np.isfinite(part).any()]
    if len(levels) < 2 or min(levels) <= 0 or 1 / LIGHT_CHANGE < levels[0] / levels[1] < LIGHT_CHANGE:
        return reference
    return np.asarray(reference, np.float32) * np.float32(levels[0] / levels[1])
