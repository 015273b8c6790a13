"""Measure the contacts of one frame.

The steps: check the input, pair frame and reference, subtract the background, find the foreground, measure
its contacts by one of the two methods, look at them once more, judge the frame, tabulate.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import FrameError, InputError
from contactimg.imaging.background.difference_image import DifferenceImage, plain_difference
from contactimg.imaging.background.find_illumination import BackgroundLevel
from contactimg.imaging.background.no_reference import estimate_background, estimate_either_background
from contactimg.imaging.background.subtract import subtract_reference
from contactimg.imaging.contrast.polarity import find_polarity
from contactimg.imaging.count.method import measure_by_count
from contactimg.imaging.count.threshold import choose_threshold
from contactimg.imaging.fit.edge_profile import WORSE_CHI_SQUARE_RATIO
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.imaging.fit.method import FirstDisks, measure_by_fit
from contactimg.imaging.fit.quality import FittedDetections
from contactimg.imaging.fit.settings import POOR_CHI_SQUARE
from contactimg.imaging.judge.climbed_table import Outlines
from contactimg.imaging.judge.pierced import contrast_beside_holes, may_have_holes
from contactimg.imaging.judge.review import Review, review
from contactimg.imaging.judge.shape_ladder import SHAPES, misfit_as_ellipses
from contactimg.imaging.judge.status import LIGHT_CHANGE, RESOLVED, Verdict, judge
from contactimg.imaging.pixels.blocks import block_means
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.pixels.freed_memory import keep_freed_memory
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.film_rim import FilmSetting, Rim
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.imaging.reject.detections import (
    CONTACT_COLUMNS,
    PLACE,
    SHAPE_COLUMNS,
    Columns,
    Detections,
    no_detections,
    shape_columns,
    without_edge_shift,
)
from contactimg.imaging.reject.foreground import Foreground, find_foreground
from contactimg.imaging.shapes.hand_edits import HandEdit, remark_on
from contactimg.tables import Flag

CORRECTIONS = ("position_drift", "dust")
"""Corrections that can be left out where their cause is known to be absent."""

BACKGROUND_IS: dict[str, BackgroundLevel] = {"bright": "lowest", "dark": "highest", "auto": "nearest_one"}
"""Level of the background among those of a frame, by the polarity of the contacts."""


@dataclass(frozen=True, eq=False)
class PreparedImage:
    """A frame without its background, which can be measured more than once."""

    foreground: Foreground
    difference: DifferenceImage


@dataclass(frozen=True, eq=False)
class ImageMeasurement:
    """Contacts, rejected candidates, optics and status of one frame.

    Parameters
    ----------
    disks : DataFrame
        One row an asserted contact: label, x_px, y_px, radius_px, radius_std_px, flags
        (`contactimg.tables.Flag`), contrast_shift_px, blur_shift_px, edge_shift_px
        (`contactimg.tables.CONTACTS`).
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
    status : str
        "ok", or the defect of the frame.
    message : str
        Remarks on the frame for the user; empty if there is nothing to say.
    difference : ndarray of float32, shape (rows, columns)
        Frame minus registered background, corrected for illumination; for pictures.
    optics : SharedOptics
        Contrast and blur on which the radii are based, with their uncertainties.
    own_optics : SharedOptics
        The same with the uncertainties that this frame alone gives, without prior knowledge.
    level : float
        Median grey level of the background; 0 if it had been subtracted already.
    smallest_px : float
        Radius of the smallest contact that the method detects; NaN if that is not known.
    measurable : bool
        Whether "no contact" is a result; False if the frame does not allow one.
    foreign : Mask
        1 on foreign objects and their blurred rims.
    outlines : tuple of (int, list of ndarray)
        Row of each contact of free shape, and its outlines (x, y), px; the first is the outer one.
    prepared : PreparedImage or None
        What was measured, for `count_again`.
    film : FilmVerdict or None
        What the rims say of an air film; None where none was looked for.
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
    outlines: Outlines = ()
    prepared: PreparedImage | None = None
    film: FilmVerdict | None = None

    @property
    def foreground(self) -> NDArray[np.float32]:
        """The difference with contacts positive, and 0 on foreign objects."""
        signed = self.difference * np.float32(np.sign(self.contrast))
        return signed if self.foreign is None else np.where(self.foreign, np.float32(0.0), signed)

    @property
    def resolved(self) -> bool:
        """Whether the frame itself shows the contrast of its contacts."""
        return bool(self.own_optics.contrast_relative_std < RESOLVED)


def measure_image(
    image: NDArray,
    reference: NDArray | None = None,
    *,
    method: str = "disk",
    polarity: str = "auto",
    threshold: float | str | None = None,
    threshold_std: float = 0.0,
    full_scale: float | None = None,
    blur_px: float | None = None,
    optics: SharedOptics | None = None,
    film: FilmSetting | Rim | None = None,
    absent: Collection[str] = (),
    edits: Sequence[HandEdit] = (),
    shape: str = "auto",
) -> ImageMeasurement:
    """Measure the contacts of one frame.

    Parameters
    ----------
    image, reference : ndarray, shape (rows, columns)
        Grey levels, uint8, uint16 or float; non-finite pixels are holes. Without a reference the background
        is estimated from the image itself.
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
    film : FilmSetting, Rim or None
        Bright rim that the air film draws around the contacts, for ``"disk"``, and whether it is drawn
        (`contactimg.imaging.profile.film_rim.FilmSetting`; a rim alone is); None: the edge is sharp.
    absent : collection of str
        Those of `CORRECTIONS` to leave out because their cause is absent: ``"position_drift"`` (the reference
        is not registered), ``"dust"`` (nothing is rejected as dirt).
    edits : sequence of HandEdit
        Corrections by hand (`contactimg.imaging.shapes.hand_edits`); those that meet no contact are named in
        the message.
    shape : {"auto", "disk", "ellipse", "free"}
        Shape of the contacts, for ``"disk"``: "auto" takes a disk until the pixels of a contact call for an
        ellipse or a free shape (`contactimg.imaging.judge.shape_ladder`).

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
    >>> disks = measure_image(image, np.full((64, 64), 50, np.uint8)).disks
    >>> [float(disks[name].iloc[0].round(0)) for name in ("x_px", "y_px", "radius_px")]
    [30.0, 33.0, 8.0]
    """
    _check(image, reference, method, polarity, absent)
    if shape not in SHAPES:
        raise InputError(f'shape must be "auto", "disk", "ellipse" or "free", got {shape!r}')
    keep_freed_memory()
    prior = _prior_optics(optics, blur_px)
    frame_pair = FramePair.of(image, _match_levels(image, reference), full_scale)
    difference, sign = _subtract_background(frame_pair, polarity, registered="position_drift" in absent)
    difference = replace(difference, dust_free="dust" in absent)
    frame_pair = frame_pair if difference.valid is None else frame_pair.within(difference.valid)
    foreground = find_foreground(frame_pair, difference, sign, prior.scaled(1.0 / frame_pair.unit))
    fraction = choose_threshold(foreground.image, foreground.contrast, threshold)
    prepared = PreparedImage(foreground, difference)
    if method == "threshold" or not foreground.contrast.plateau > 0:
        counted = count_again(prepared, fraction, fraction_std=threshold_std, edits=edits)
        return counted if method == "threshold" else replace(counted, threshold=float("nan"))
    seen = _fitted(prepared, shape, _film_setting(film), edits)
    return _judged(prepared, seen, float("nan"))


def count_again(
    prepared: PreparedImage,
    fraction: float,
    *,
    fraction_std: float = 0.0,
    edits: Sequence[HandEdit] = (),
) -> ImageMeasurement:
    """What `measure_image` gives with the method "threshold" at this fraction of the contrast."""
    foreground = prepared.foreground
    if foreground.contrast.plateau > 0:
        detections = measure_by_count(
            foreground, prepared.difference, fraction=fraction, fraction_std=fraction_std, edits=edits
        )
    else:
        detections = replace(no_detections(foreground.prior_optics), unmatched=edits)
    return _judged(prepared, review(foreground, prepared.difference, detections, shape="disk"), fraction)


def _fitted(
    prepared: PreparedImage, shape: str, film: FilmSetting | None, edits: Sequence[HandEdit]
) -> Review:
    """What the method "disk" finds, after a second look.

    An edge that was learned from disks may only imitate the ellipses that the contacts are: a plain edge is
    taken where the ellipses fit as well with it, unless no ellipse describes them. Or it imitates holes: then
    all contacts are measured by their light.
    """
    foreground, difference = prepared.foreground, prepared.difference
    first = FirstDisks.of(foreground, difference, edits)
    if shape == "auto" and may_have_holes(first.fit):
        beside = contrast_beside_holes(first.detections(foreground, difference))
        if beside is not None:
            plain = measure_by_fit(
                foreground, difference, film=film, edits=edits, learns_edge=False, first=first
            )
            return review(foreground, difference, plain, shape=shape, beside_holes=beside)
    disks = measure_by_fit(foreground, difference, film=film, edits=edits, first=first)
    misfit = misfit_as_ellipses(disks, shape=shape) if _has_learned_edge(disks) else float("nan")
    if misfit < POOR_CHI_SQUARE:
        plain = measure_by_fit(foreground, difference, film=film, edits=edits, learns_edge=False, first=first)
        other = review(foreground, difference, plain, shape=shape)
        if other.ellipse_misfit <= WORSE_CHI_SQUARE_RATIO * misfit:
            return other
    del first  # its images are no longer needed
    return review(foreground, difference, disks, shape=shape)


def _has_learned_edge(detections: Detections) -> bool:
    """Whether the frame itself showed an edge that is not plain, at less work than it may cost."""
    fit = detections.frame_fit if isinstance(detections, FittedDetections) else None
    if fit is None or fit.edge is None or fit.problem.work.ran_out:
        return False
    return bool(fit.edge.families)


def _judged(prepared: PreparedImage, seen: Review, fraction: float) -> ImageMeasurement:
    """The result after a second look and a verdict on the frame."""
    foreground, difference = prepared.foreground, prepared.difference
    verdict = judge(foreground, difference, seen)
    result = _tabulate(foreground, difference, seen.detections, verdict, fraction)
    return replace(result, outlines=seen.outlines, prepared=prepared, film=_film_verdict(seen.detections))


def _tabulate(
    foreground: Foreground,
    difference: DifferenceImage,
    detections: Detections,
    verdict: Verdict,
    fraction: float,
) -> ImageMeasurement:
    """The result, in the grey levels of the frame."""
    unit, optics = foreground.frame_pair.unit, detections.optics
    # without a contact, the contrast is that of what stands out
    contrast = optics.contrast if len(detections.contacts["x_px"]) else foreground.seen(optics.contrast)
    edge = foreground.prior_optics.known_edge
    if edge is not None and isinstance(detections, FittedDetections):
        contacts = without_edge_shift(detections.contacts, edge.shift_px)
        detections = replace(detections, contacts=contacts)
    return ImageMeasurement(
        disks=_contacts_table(detections),
        rejected=_rejected_table(foreground.foreign.rejected, detections.rejected),
        contrast=foreground.sign * contrast * unit if foreground.contrast.plateau > 0 else 0.0,
        noise=foreground.noise * unit,
        threshold=fraction,
        blur_px=optics.blur_px,
        shift_x_px=difference.alignment.x_px if difference.alignment else float("nan"),
        shift_y_px=difference.alignment.y_px if difference.alignment else float("nan"),
        polarity="bright" if foreground.sign > 0 else "dark",
        status=verdict.status,
        message="; ".join(filter(None, (verdict.message, remark_on(detections.unmatched)))),
        difference=difference.image if unit == 1.0 else difference.image * np.float32(unit),
        optics=optics.scaled(unit),
        own_optics=detections.own_optics.scaled(unit),
        level=difference.level * unit,
        smallest_px=detections.smallest_px,
        measurable=verdict.measurable,
        foreign=foreground.foreign.mask,
    )


def _contacts_table(detections: Detections) -> pd.DataFrame:
    """The contacts, numbered from 1, flagged if their frame does not show its contrast."""
    contacts = detections.contacts
    no_plateau = 0 if detections.own_optics.contrast_relative_std < RESOLVED else int(Flag.NO_PLATEAU)
    columns: dict[str, Any] = {
        name: np.asarray(contacts[name], dtype) for name, dtype in CONTACT_COLUMNS.items()
    }
    shapes = shape_columns(contacts)
    types: dict[str, Any] = dict(SHAPE_COLUMNS)
    for name, dtype in types.items():
        plain = dtype == "float64"  # the other types are those of pandas
        columns[name] = np.asarray(shapes[name], dtype) if plain else pd.array(shapes[name], dtype=dtype)
    columns["flags"] = columns["flags"] | no_plateau
    return pd.DataFrame({"label": np.arange(1, len(columns["flags"]) + 1, dtype=np.int64), **columns})


def _rejected_table(*parts: Columns) -> pd.DataFrame:
    """The rejected candidates of several tables."""
    columns = {name: np.concatenate([part[name] for part in parts]).astype(float) for name in PLACE}
    reasons = np.concatenate([part["reason"].astype(object) for part in parts])
    return pd.DataFrame({**columns, "reason": pd.array(reasons, dtype="str")})


def _film_verdict(detections: Detections) -> FilmVerdict | None:
    """What the rims say of an air film."""
    fit = detections.frame_fit if isinstance(detections, FittedDetections) else None
    return None if fit is None or fit.film is None else fit.film.verdict


def _film_setting(film: FilmSetting | Rim | None) -> FilmSetting | None:
    """A rim alone is drawn."""
    return film if film is None or isinstance(film, FilmSetting) else FilmSetting(film)


def _prior_optics(optics: SharedOptics | None, blur_px: float | None) -> SharedOptics:
    """Prior knowledge of contrast and blur, checked; a given blur is exact."""
    prior = SharedOptics() if optics is None else optics
    if blur_px is not None:
        prior = replace(prior, blur_px=blur_px, blur_std_px=0.0, correlation=0.0)
    for name, value in (("contrast", prior.contrast), ("blur_px", prior.blur_px)):
        if not np.isnan(value) and not 0 < value < np.inf:
            raise InputError(f"a given {name} must be a positive number, got {value!r}")
    return prior


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


def _subtract_background(
    frame_pair: FramePair, polarity: str, *, registered: bool
) -> tuple[DifferenceImage, int]:
    """Difference image and the sign that makes contacts positive."""
    frame, reference = frame_pair.frame, frame_pair.reference
    if frame_pair.trivial:
        plain = np.subtract(frame, frame if reference is None else reference, dtype=np.float32)
        return plain_difference(plain), -1 if polarity == "dark" else 1
    if reference is not None:
        difference = subtract_reference(
            frame,
            reference,
            valid=frame_pair.valid,
            background_is=BACKGROUND_IS[polarity],
            registered=registered,
        )
        if polarity == "auto":
            polarity = find_polarity(block_means(difference.image))
        return difference, -1 if polarity == "dark" else 1
    image = np.asarray(frame, np.float32)
    if polarity == "auto":
        return estimate_either_background(image, valid=frame_pair.valid)
    dark = polarity == "dark"
    return estimate_background(image, valid=frame_pair.valid, dark=dark), -1 if dark else 1


def _match_levels(image: NDArray, reference: NDArray | None) -> NDArray | None:
    """The reference, brought to the grey levels of the frame if it was stored with another bit depth."""
    if reference is None or reference.dtype == image.dtype:
        return reference
    samples = [np.asarray(array[::8, ::8], float) for array in (image, reference)]
    levels = [float(np.median(part[np.isfinite(part)])) for part in samples if np.isfinite(part).any()]
    if len(levels) < 2 or min(levels) <= 0 or 1 / LIGHT_CHANGE < levels[0] / levels[1] < LIGHT_CHANGE:
        return reference
    return np.asarray(reference, np.float32) * np.float32(levels[0] / levels[1])
