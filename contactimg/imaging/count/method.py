"""The method "threshold": count the pixels above a fraction of the contrast, as the paper does.

A contact is a connected component of the pixels above ``background + fraction (plateau - background)``; its
radius is ``sqrt(area/pi)``. Components that consist of several contacts are split. The uncertainty of a
radius has five parts (`rim_errors`): counting, noise, the scatter of the contrasts, the uncertainty of the
contrast, and the distance of the threshold from the rim of the contact behind the blur; the last two are
shared by all contacts.
"""

from collections.abc import Sequence
from dataclasses import replace
from numbers import Real

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.imaging.count.by_hand import edit_counts
from contactimg.imaging.count.rim_errors import (
    Crossing,
    blur_of_heights,
    count_at_own,
    height_at_rims,
    rim_errors,
)
from contactimg.imaging.count.split_touching import split_components
from contactimg.imaging.detect.candidates import SPECK_PX2, Contrast
from contactimg.imaging.detect.components import half_axes, sides_cut
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX, LEAST_VARIANCE_PX2, estimate_blur
from contactimg.imaging.evidence.reference_dust import find_dust
from contactimg.imaging.evidence.rules import PLACE, Columns, Judged
from contactimg.imaging.fit.unseen_contrast import LARGEST_CONTRAST_RATIO, PLATEAU_STD_FRACTION
from contactimg.imaging.foreground import Foreground
from contactimg.imaging.pixels.frame_pair import SPAN_LEVELS
from contactimg.imaging.pixels.masks import Flags, touches
from contactimg.imaging.pixels.robust import LIGHT_SIGMA
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.limits import FEWEST, SHOWN_BLUR_WIDTHS, SMALL_AREA_PX2
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.tables import Flag, Reason

DEFAULT_FRACTION = 0.5
"""Threshold where none is given: half height, where the radius of a wide disk depends least on its blur."""


def measure_by_count(
    foreground: Foreground, *, fraction: float, fraction_std: float = 0.0, edits: Sequence[HandEdit] = ()
) -> Judged:
    """Count the pixels of the contacts of a frame.

    Parameters
    ----------
    foreground : Foreground
    fraction : float
        Threshold as a fraction of the contrast.
    fraction_std : float
        Its standard uncertainty, where it was calibrated.
    edits : sequence of HandEdit
        Corrections by hand to what was found.

    Notes
    -----
    The radius is that of the counted pixels, whatever the blur; ``edge_shift_px`` says how far that is from
    the rim.
    """
    contrast, pair, image = foreground.contrast, foreground.frame_pair, foreground.image
    if not contrast.plateau > 0:
        nothing: Columns = dict.fromkeys((*PLACE, "radius_std_px", "visible_area_px2", "reason"), np.empty(0))
        nothing["flags"] = np.empty(0, np.int64)
        prior = foreground.prior_optics
        return Judged(foreground, nothing, nothing, prior, prior, unmatched=edits)
    plateau, noise = contrast.plateau, foreground.noise
    contacts, rejected = count_contacts(image, fraction=fraction, plateau=plateau, noise=noise)
    blur = _blur_of(foreground, contacts, fraction)
    contacts, by_hand, unmatched = edit_counts(contacts, edits, image, fraction * contrast.plateau)
    x, y, radius, flags = (contacts[name] for name in (*PLACE, "flags"))
    # Longer parts of a split component are no disks. By hand: of a hundred parts of contacts that touch, one
    # to four are longer.
    long = contacts["semi_major_px"] > 1.4 * contacts["semi_minor_px"]
    long &= flags & int(Flag.MERGED) > 0
    places = np.column_stack([x, y, radius])
    cut = touches(pair.valid, 0, places, radius + 2.0 * DEFAULT_BLUR_PX)  # a hole so near spoils the rim
    full = touches(pair.saturated, 1, places, radius)
    for flag, shown in ((Flag.POOR_FIT, long), (Flag.EDGE, cut), (Flag.SATURATED, full)):
        contacts["flags"] = contacts["flags"] | np.where(shown, int(flag), 0)
    dust = find_dust(foreground, places, blur) & (flags & int(Flag.MANUAL) == 0)
    gone = {name: contacts[name][dust] for name in PLACE}
    gone["reason"] = np.full(np.count_nonzero(dust), Reason.REFERENCE_DUST)
    rejected = {name: np.concatenate([part[name] for part in (rejected, gone, by_hand)]) for name in gone}
    contacts = {name: values[~dust] for name, values in contacts.items()}
    radius, height = contacts["radius_px"], contacts["height"]
    crossing = Crossing(fraction, contrast.plateau, contrast.std, blur, foreground.noise, fraction_std)
    crossing, own_std = _with_unseen_contrast(foreground, radius, crossing)
    rim_height = height_at_rims(image, contacts, crossing)
    contacts |= rim_errors(radius, height, crossing, rim_height=rim_height)
    own_radius = count_at_own(image, contacts, crossing)
    odd = np.isfinite(own_radius)
    contacts["flags"] |= np.where(odd, int(Flag.BRIGHTNESS), 0)
    apart = np.where(odd, own_radius - radius, 0.0)
    contacts["radius_std_px"] = np.hypot(contacts["radius_std_px"], apart)
    # of a contact cut by the border the pixels counted are those that are seen
    contacts["visible_area_px2"] = np.pi * radius**2
    return Judged(
        foreground,
        contacts,
        rejected,
        optics=SharedOptics(contrast.plateau, crossing.contrast_std, blur_std_px=np.nan),
        own_optics=SharedOptics(max(foreground.shown.plateau, 1e-9), own_std, blur_std_px=np.nan),
        unmatched=unmatched,
        # the centre of a disk of radius a behind a blur s reaches 1 - exp(-a^2/(2 s^2)) of the contrast
        smallest_px=float(blur * np.sqrt(-2.0 * np.log1p(-fraction))),
        remark=_remark_on_threshold(contacts, crossing),
        rim_height=rim_height,
    )


def _remark_on_threshold(contacts: Columns, crossing: Crossing) -> str:
    """A remark on the distance between threshold and rims, if it is most of the uncertainties."""
    shift, std = contacts["edge_shift_px"], contacts["radius_std_px"]
    if crossing.fraction_std > 0 or not len(shift) or np.median(shift**2 / std**2) < 0.5:
        return ""
    middle = float(np.median(shift))
    changed = "larger" if middle > 0 else "smaller"
    return (
        f"pixels above {crossing.fraction:.2g} of the contrast make radii {changed} than those of the "
        f"contacts, by {abs(middle):.2g} px in the median behind a blur of {crossing.blur_px:.2g} px, which "
        "the uncertainties include"
    )


def _with_unseen_contrast(
    foreground: Foreground, radius_px: NDArray[np.float64], crossing: Crossing
) -> tuple[Crossing, float]:
    """The crossing with what contacts hide of their contrast, and the error of that measured."""
    shown = foreground.shown
    if not len(radius_px):
        return crossing, shown.std
    widest = float(np.sort(radius_px)[-FEWEST:].min()) / crossing.blur_px
    room = foreground.largest_contrast / max(shown.plateau, 1e-9)
    if widest > SHOWN_BLUR_WIDTHS and shown.resolved:
        # the centre of a disk of radius a behind a blur s lacks exp(-a^2/(2 s^2)) of its contrast
        own, ratio = float(np.hypot(shown.std, np.exp(-0.5 * widest**2) * shown.plateau)), 1.0
    else:
        ratio = float(np.clip(room, 1.0, LARGEST_CONTRAST_RATIO))
        own = max(np.log(ratio) / np.sqrt(12.0), PLATEAU_STD_FRACTION) * shown.plateau
    if np.isfinite(foreground.prior_optics.contrast):
        return crossing, own
    std = own if ratio == 1.0 else PLATEAU_STD_FRACTION * shown.plateau
    return replace(crossing, contrast_std=std, largest_ratio=ratio), own


def _blur_of(foreground: Foreground, contacts: Columns, fraction: float) -> float:
    """Standard deviation of the blur, pixel included, px: the prior one, else from the slope of the rims.

    Rims sharper than the pixels have no slope; the light of their contacts shows it.
    """
    plateau, prior = foreground.contrast.plateau, foreground.prior_optics.blur_px
    if np.isfinite(prior):
        return float(np.hypot(prior, PIXEL_VARIANCE**0.5))
    by_light = blur_of_heights(contacts["radius_px"], contacts["height"] / plateau, fraction)
    return by_light if by_light < LEAST_VARIANCE_PX2**0.5 else estimate_blur(foreground.image, plateau)


def count_contacts(
    image: NDArray[np.float32], *, fraction: float, plateau: float, noise: float
) -> tuple[Columns, Columns]:
    """Connected components above ``fraction`` of the contrast, ``radius = sqrt(area/pi)``.

    Components that consist of several contacts are split; the parts share the pixels.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Difference image, contacts positive, holes 0.
    fraction : float
        Threshold as a fraction of the contrast.
    plateau : float
        Contrast of the contacts.
    noise : float
        Standard deviation of a background pixel.

    Returns
    -------
    contacts, rejected : dict of arrays
        Columns x_px, y_px, radius_px, flags, height (mean grey level, NaN for parts), and those of the
        shapes; and x_px, y_px, radius_px, reason.
    """
    components, split = split_components(image, fraction * plateau, noise=noise)
    light = components["flux"] - components["area"] * np.maximum(_level_around(image, components), 0.0)
    bad = light < LIGHT_SIGMA * noise * np.sqrt(components["area"])
    radius = np.sqrt(components["area"] / np.pi)
    rejected = {
        "x_px": components["x"][bad],
        "y_px": components["y"][bad],
        "radius_px": radius[bad],
        "reason": np.full(np.count_nonzero(bad), Reason.NOISE.value, object),
    }
    kept, split = components[~bad], split[~bad]
    contacts = {
        "x_px": kept["x"],
        "y_px": kept["y"],
        "radius_px": radius[~bad],
        "flags": _flags(kept, split, image.shape),
        "height": np.where(split, np.nan, kept["flux"] / np.maximum(kept["area"], 1)),
    }
    axes = zip(("semi_major_px", "semi_minor_px", "angle_rad"), half_axes(kept), strict=True)
    rest = {"shape": np.full(len(kept), "free", object), "perimeter_px": np.full(len(kept), np.nan)}
    return contacts | dict(axes) | rest, rejected


def _flags(components: NDArray[np.void], split: Flags, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Flags of components, those that touch the border of an image of that shape included."""
    return (
        int(Flag.EDGE) * np.any(sides_cut(components, shape), axis=0)
        + int(Flag.TOO_SMALL) * (components["area"] < SMALL_AREA_PX2)
        + int(Flag.MERGED) * split
    )


def _level_around(image: NDArray[np.float32], components: NDArray[np.void]) -> NDArray[np.float64]:
    """Median of eight pixels around each speck: its own level on a slope, about 0 if it stands alone.

    0 for components larger than a speck.
    """
    out = np.zeros(len(components))
    specks = np.flatnonzero(components["area"] <= SPECK_PX2)
    part, (rows, columns) = components[specks], image.shape
    x = np.stack([part["left"] - 3, part["peak_x"], part["right"] + 3])  # 3 px from the speck, by hand
    y = np.stack([part["top"] - 3, part["peak_y"], part["bottom"] + 3])
    grid = image[np.clip(y, 0, rows - 1)[:, None], np.clip(x, 0, columns - 1)[None]].reshape(9, -1)
    out[specks] = np.median(np.delete(grid, 4, axis=0), axis=0)
    return out


def choose_threshold(image: NDArray[np.float32], contrast: Contrast, threshold: float | str | None) -> float:
    """The fraction to use: a number as given, `DEFAULT_FRACTION` for None, Otsu's for ``"auto"``.

    Otsu's separates two classes of pixels with least variance inside both (doi:10.1109/TSMC.1979.4310076).

    Raises
    ------
    InputError
        If it is not a fraction between 0 and 1.
    """
    auto = isinstance(threshold, str) and threshold == "auto"
    if threshold is None or (auto and contrast.plateau <= 0):
        return DEFAULT_FRACTION
    if auto:
        scaled = np.clip(image * (SPAN_LEVELS / contrast.plateau), 0, 255).astype(np.uint8)
        level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        # outside this range noise makes contacts or takes them away
        return float(np.clip((level + 0.5) / SPAN_LEVELS, 0.05, 0.95))
    if not (isinstance(threshold, Real) and 0 < threshold < 1):
        raise InputError(f'threshold must be a fraction between 0 and 1 or "auto", got {threshold!r}')
    return float(threshold)
