"""The table of evidence of a frame, and the rules that reject, flag or measure each candidate in another way.

Every rule is a predicate on the columns of the table. A candidate is rejected for the first reason that
holds; flags are independent. Unusual brightness is a flag, never a reason. Where no model describes a
contact, its counted area is reported: a contact that is seen does not disappear.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipe

from contactimg.compiled import njit
from contactimg.imaging.detect import components, inscribed_disks
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.evidence.reference_dust import find_dust
from contactimg.imaging.fit.contact_pixels import look_at_pixels
from contactimg.imaging.fit.disks import WELL_FITTED_CHI_SQUARE, erase_disks
from contactimg.imaging.fit.method import FrameFit
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, X, Y
from contactimg.imaging.foreground import BRIGHT_STEP, Foreground
from contactimg.imaging.kernels.pairs import areas_beyond_chords, count_touching, label_groups
from contactimg.imaging.pixels.masks import Mask, clear_disks, for_kernel, touches
from contactimg.imaging.pixels.robust import AGREEMENT_SIGMA, CLIP_SIGMA, SIGNIFICANT_SIGMA
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.limits import (
    CLEAR_BLUR_WIDTHS,
    LONGEST_RADII,
    NEAR_BLUR_WIDTHS,
    POOR_CHI_SQUARE,
)
from contactimg.imaging.profile.optics import SharedOptics, combine_errors
from contactimg.tables import Flag, Reason
from contactimg.tables.outlines import Outline

DIRECTIONS, LEAST_SEEN = 32, 4
"""Directions in which the fall is read, two blur widths either side, and least number seen. By hand."""
SHARPEST_BLUR_PX, WIDEST_BLUR_PX = 1.0, 8.0
"""Limits of the blur used here: pixels are not interpolated, and no optics is as blurred as uneven light."""
Columns = dict[str, NDArray]
"""Columns of a table, arrays of the same length."""

PLACE = ("x_px", "y_px", "radius_px")
"""Columns that say where a candidate is."""
LOW_SIGNAL_SIGMA = 10.0
"""Light below which a contact has the flag LOW_SIGNAL. By hand: twice the detection limit."""
SPECK_BLUR_WIDTHS = 0.75
"""Radius over blur below which faint contacts are specks. Theory: they show a quarter of their contrast. By
hand: pieces of rings and reflections are narrower, contacts of half the brightness of the others wider."""
LEAST_VISIBLE = 0.1
"""Share of a disk inside the image below which it is not measured. By hand."""
RIM_FALL = 0.5
"""Least fall across the rim of a wide contact, of its contrast. Theory: 0.95 of a blurred edge; by hand:
a point spread function with heavy tails leaves 0.66, a fibre out of focus 0.35 to 0.45."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Contacts and rejected candidates of a frame, and what is known of them.

    Parameters
    ----------
    foreground : Foreground
    contacts, rejected : dict of arrays
    optics, own_optics : SharedOptics
        Contrast and blur on which the radii are based, and what the frame alone gives.
    unmatched : sequence of HandEdit
        Corrections by hand that meet no contact.
    smallest_px : float
        Radius of the smallest contact that the method detects.
    remark : str
        What the method says of itself.
    rim_height : float
        Height of counted contacts at their rims over the contrast.
    fit : FrameFit or None
    evidence : dict of arrays
        One row for each contact; empty for counted ones.
    unexplained : float
        Share of the bright pixels that belong to no contact.
    """

    foreground: Foreground
    contacts: Columns
    rejected: Columns
    optics: SharedOptics
    own_optics: SharedOptics
    unmatched: Sequence[HandEdit] = ()
    smallest_px: float = np.nan
    remark: str = ""
    rim_height: float = 1.0
    fit: FrameFit | None = None
    evidence: Columns = field(default_factory=dict)
    unexplained: float = 0.0

    @property
    def count(self) -> int:
        """Number of contacts."""
        return len(self.contacts["x_px"])

    def having(self, flag: Flag) -> NDArray[np.bool_]:
        """Which contacts have a flag, or all of several."""
        return np.asarray(self.contacts["flags"] & int(flag) == int(flag))

    def flagged(self, flag: Flag) -> int:
        """Number of such contacts."""
        return int(np.count_nonzero(self.having(flag)))


Rule = tuple[Reason, Callable[[Columns], NDArray[np.bool_]]]

RULES: list[Rule] = [
    (Reason.BY_HAND, lambda e: e["excluded"]),
    (Reason.OUT_OF_SIGHT, lambda e: e["visible"] < LEAST_VISIBLE),
    (Reason.NOISE, lambda e: e["light"] < np.where(e["misfit"], SIGNIFICANT_SIGMA, AGREEMENT_SIGMA)),
    (Reason.REFERENCE_DUST, lambda e: e["dust"]),
    (Reason.NO_RIM, lambda e: e["fall"] < RIM_FALL),
    # By hand: the mean inside over the surroundings, of the contrast fitted.
    (Reason.INVISIBLE, lambda e: e["rise"] < 0.25),
    # By hand: ratio of the axes of the counted pixels.
    (Reason.SCRATCH, lambda e: e["undescribed"] & (e["elongation"] > 3.5) & (e["border"] == 0)),
    (Reason.CHAIN, lambda e: e["chained"]),
]
"""Reasons of rejection, in order."""
FALSE_CANDIDATES = (Reason.INVISIBLE, Reason.SCRATCH, Reason.CHAIN)
"""Those that tell that something else than contacts is seen: in numbers they make the frame doubtful."""
HOLD_FOR_ALL = (Reason.BY_HAND, Reason.OUT_OF_SIGHT)
"""Those that hold for what was drawn by hand as well: no pixel shows what is out of sight."""

FLAGS: list[tuple[Flag, Callable[[Columns], NDArray[np.bool_]]]] = [
    (Flag.EDGE, lambda e: e["cut"]),
    (Flag.MERGED, lambda e: e["touching"] > 0),
    (Flag.SATURATED, lambda e: e["saturated"]),
    (Flag.TOO_SMALL, lambda e: e["radius"] - e["total_std"] < e["blur"]),
    (Flag.POOR_FIT, lambda e: e["poor"]),
    (Flag.LOW_SIGNAL, lambda e: e["signal"] < LOW_SIGNAL_SIGMA),
    (Flag.BRIGHTNESS, lambda e: e["odd"]),
    (Flag.COUNTED, lambda e: e["use_count"]),
    (Flag.DISAGREES, lambda e: np.abs(e["count_z"]) > CLIP_SIGMA),
    (Flag.MANUAL, lambda e: e["manual"]),
]
"""Flags of the contacts that are kept."""


def judge_contacts(
    foreground: Foreground, result: FrameFit, *, shape: str, linearity: float, film_unknown: bool
) -> Judged:
    """Contacts of a fit: rejected, flagged, and measured by their counted pixels where nothing else holds.

    ``linearity`` is the error of the camera's response at mid-level, of the contrast, that no fit can see: it
    moves every edge by ``linearity s sqrt(2 pi)``. Where nothing is known of an air film either, one that is
    too narrow to be seen may move it by a quarter of the blur.
    """
    problem, joint, binning = result.problem, result.joint, result.problem.binning
    e = _evidence(foreground, result, free=shape == "free")
    # By hand: of a shift by 0.17 of the blur no rim tells anything, twice as much is seen as soft edges.
    unseen_film = 0.25 / np.sqrt(3.0) if film_unknown else 0.0
    shift = np.hypot(linearity * np.sqrt(2.0 * np.pi), unseen_film)
    table = _columns(result, e, float(shift) * result.fit.blur)
    e["total_std"] = table["radius_std_px"] / binning
    places = np.column_stack([table[name] for name in PLACE])
    reason = np.where(np.isfinite(places).all(axis=1), "", Reason.NOISE).astype(object)
    for name, holds in RULES:
        now = holds(e) & (reason == "")
        reason[now & (~e["manual"] | (name in HOLD_FOR_ALL))] = name
    table["flags"] = np.sum([np.where(shown(e), int(flag), 0) for flag, shown in FLAGS], axis=0)
    found, kept = _join_parts(foreground, result, e, table, reason)
    places = np.column_stack([table[name] for name in PLACE])
    kept = kept[np.lexsort([table["x_px"][kept], table["y_px"][kept]])]
    contacts = {name: values[kept] for name, values in table.items()}
    contacts["visible_area_px2"] = visible_areas(contacts, foreground.image.shape)
    dropped = problem.in_frame(result.dropped[:, [X, Y]]), result.dropped[:, RADIUS] * binning
    every = np.vstack([np.column_stack(dropped), places[reason != ""]])
    why = np.append(np.full(len(result.dropped), Reason.UNNECESSARY, object), reason[reason != ""])
    placed = np.isfinite(every).all(axis=1)
    if joint is None:
        known = SharedOptics(foreground.contrast.plateau, np.nan, np.nan, result.fit.blur * binning, np.nan)
        shared = own = known
    else:
        shared, own = (
            replace(joint.optics(covariance, binning=binning), halo=result.halo)
            for covariance in (joint.covariance, joint.own_covariance)
        )
        own = replace(own, edge=None if result.edge is None else result.edge.knowledge)
    return Judged(
        foreground,
        contacts=contacts,
        rejected=dict(zip(PLACE, every[placed].T, strict=True)) | {"reason": why[placed]},
        optics=shared,
        own_optics=own,
        unmatched=[] if result.edited is None else result.edited.unmatched + result.edited.vanished(kept),
        smallest_px=result.smallest * binning,
        fit=result,
        evidence={name: values[kept] for name, values in e.items()},
        unexplained=_unexplained_share(foreground, result, found) if binning == 1 else 0.0,
    )


def _unexplained_share(foreground: Foreground, result: FrameFit, found: NDArray[np.intp]) -> float:
    """Share of the bright pixels, of every fourth row and column, that no contact explains.

    ``found`` are the rows of all disks whose light belongs to a contact, of which several may be parts, or to
    something excluded by hand.
    """
    problem, fit, bright = result.problem, result.fit, foreground.bright
    erase_disks(problem, fit, ~np.isin(np.arange(len(fit.disks)), found))
    model, image = (part[::BRIGHT_STEP, ::BRIGHT_STEP] for part in (fit.model, foreground.image))
    dark = (bright & (model < 0.2 * image)).astype(np.uint8)
    # the disks drawn in the place of ellipses do not reach their ends
    ends = [[*one.parameters[[X, Y]], one.half_axes[0]] for one in result.ellipses.fitted]
    clear_disks(dark, np.array(ends).reshape(-1, 3) / BRIGHT_STEP)
    return float(np.count_nonzero(dark) / max(int(np.count_nonzero(bright)), 1))


def _join_parts(
    foreground: Foreground, result: FrameFit, e: Columns, table: Columns, reason: NDArray[np.object_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Make one contact of free shape of those in a region that is no union of disks.

    It has the pixels of the region above half of the contrast. Contacts that touch leave a notch between
    them, and fill the region. Returned are the rows whose light is that of a contact or was excluded by hand,
    and those that stand for a contact: several disks of a bright region that are all within the noise are so
    because each can take the place of the others, and are not rejected. Excluding one part by hand excludes
    the whole contact.
    """
    joint = result.joint
    half = 0.5 * result.core_share * (result.problem.contrast if joint is None else joint.contrast)
    regions, runs = components.label_runs(foreground.image, half)
    x, y = np.nan_to_num(result.problem.in_frame(result.fit.disks[:, [X, Y]])).T
    a = result.fit.disks[:, RADIUS] * result.problem.binning
    own = components.component_of_pixels(runs, np.rint(x).astype(int), np.rint(y).astype(int))
    inside, noise = own >= 0, reason == Reason.NOISE
    alike, every = (np.bincount(own[inside & rows], minlength=len(regions)) for rows in (noise, inside))
    light = regions["flux"] / np.sqrt(np.maximum(regions["area"], 1.0))
    bright = (alike > 1) & (alike == every) & (light > SIGNIFICANT_SIGMA * foreground.noise)
    reason[inside & noise & np.append(bright, False)[own]] = ""
    by_hand = reason == Reason.BY_HAND
    found = np.flatnonzero((reason == "") | by_hand)
    own, kept = own[found], np.ones(len(found), np.bool_)
    for k in np.flatnonzero(np.bincount(own[own >= 0], minlength=len(regions)) > 1):
        rows, region = found[own == k], regions[k]
        area = np.pi * a[rows] ** 2
        poor, undescribed = (area @ e[name][rows] > 0.5 * area.sum() for name in ("poor", "undescribed"))
        if not poor:
            continue
        box, _ = components.window_of(region)
        j, i = np.ogrid[box]
        mask = components.mask_of_component(runs, k, (box[0].start, box[1].start), (len(j), i.size))
        drawn = np.any([np.hypot(i - x[row], j - y[row]) < a[row] for row in rows], axis=0)
        # speckles are no outline, the gaps of a packing are
        largest_hole = inscribed_disks.LARGEST_HOLE_SHARE * float(area.max())
        filled = inscribed_disks.fill(mask, inscribed_disks.find_holes(mask), largest_hole)
        apart = np.count_nonzero(drawn != (filled > 0)) / float(region["area"])
        # noise and mottling make inlets in an outline, which two contacts that touch do not leave
        # By hand: wider than a fifth of the radius are none, and two disks that touch gain 0.02 of their
        # convex hull.
        reach = round(0.2 * float(np.sqrt(region["area"] / np.pi)))
        ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        smooth = cv2.morphologyEx(np.pad(filled, 2 * reach + 1), cv2.MORPH_CLOSE, ellipse).astype(np.uint8)
        convex = inscribed_disks.share_of_hull(smooth, float(np.count_nonzero(smooth)))
        least = inscribed_disks.LEAST_CONVEX if undescribed or len(rows) > 2 else inscribed_disks.CONVEX_SHARE
        # By hand: mottled contacts that touch make up to 0.12, a packing of beads 0.09, islands of a random
        # surface 0.1 to 0.5.
        if convex > least or (undescribed and apart > 0.12):
            largest = int(rows[np.argmax(area)])
            _count_region(table, largest, rows, region, float(filled.sum()))
            kept[(own == k) & (found != largest)] = False
            reason[rows] = ""
            reason[largest] = Reason.BY_HAND if by_hand[rows].any() else ""
    return found, found[kept & (reason[found] == "")]


def _count_region(table: Columns, row: int, parts: NDArray[np.intp], region: np.void, area: float) -> None:
    """Put a region of an area in the place of a contact, with the uncertainties and flags of its parts."""
    radius, std = np.sqrt(area / np.pi), float(np.linalg.norm(table["area_std_px2"][parts]))
    major, minor, angle = components.half_axes(region)
    ratio = np.sqrt(major / minor)
    flags = np.bitwise_or.reduce(table["flags"][parts]) | int(Flag.POOR_FIT | Flag.COUNTED)
    values = {
        "x_px": region["x"], "y_px": region["y"], "radius_px": radius, "perimeter_px": 2.0 * np.pi * radius,
        "radius_std_px": std / (2.0 * np.pi * radius), "area_px2": area, "area_std_px2": std,
        "visible_area_px2": area, "semi_major_px": radius * ratio, "semi_minor_px": radius / ratio,
        "angle_rad": angle, "shape": "free", "flags": flags,
    }  # fmt: skip
    for name, value in values.items():
        table[name][row] = value


def _evidence(foreground: Foreground, result: FrameFit, *, free: bool) -> Columns:
    """The table: one row for each disk of the fit; lengths in px of the fit."""
    problem, fit, joint, edited = result.problem, result.fit, result.joint, result.edited
    disks, blur, nothing = fit.disks, fit.blur, np.zeros(len(fit.disks), np.bool_)
    radius, contrast = disks[:, RADIUS], disks[:, CONTRAST]
    std = np.where(fit.std[:, RADIUS] > 0, fit.std[:, RADIUS], np.inf)
    looked = look_at_pixels(problem, fit)
    chi_square = np.minimum(fit.chi_square, looked.rim_chi_square)
    poor, undescribed = chi_square > POOR_CHI_SQUARE, chi_square > WELL_FITTED_CHI_SQUARE
    plateau = np.where(np.isfinite(looked.plateau), looked.plateau, contrast)
    again = np.flatnonzero(undescribed | free)
    if len(again):  # at half of their own plateau
        looked = looked.updated(again, look_at_pixels(problem, fit, half=0.5 * plateau, rows=again))
    height, core = np.maximum(contrast, 1e-9), result.core_share
    slope = height / (blur * np.sqrt(2.0 * np.pi))
    place = PIXEL_VARIANCE + fit.brightness**-1 * problem.noise.variance / slope**2
    count_std = np.sqrt(2.0 * np.pi * np.maximum(radius, 1.0) * place)
    surrounded = np.isfinite(looked.ring)
    ring = np.where(surrounded, looked.ring, 0.0)
    mean = looked.light / np.maximum(np.pi * radius**2, 1.0)
    ellipse = np.isin(np.arange(len(disks)), result.ellipses.rows)
    # counted pixels of small contacts say little about their area
    resolved = radius > 1.5 * blur
    count_z = np.where(resolved, (looked.area - looked.expected) / count_std, 0.0)
    hollow = (looked.core_chi_square > WELL_FITTED_CHI_SQUARE) & (np.abs(count_z) > CLIP_SIGMA)
    # a misfit that most contacts do not share is that of its own shape; compression makes one that they share
    usual = max(float(np.median(chi_square)) if len(disks) else 1.0, 1.0)
    shaped = chi_square > WELL_FITTED_CHI_SQUARE * usual
    differs = shaped | (np.abs(count_z) > AGREEMENT_SIGMA)
    use_count = ((undescribed & ~ellipse & differs) | hollow) & resolved
    places = np.column_stack([problem.in_frame(disks[:, [X, Y]]), radius * problem.binning])
    x, y, (rows, columns) = disks[:, X], disks[:, Y], problem.image.shape
    gap = np.minimum.reduce([x + 0.5, columns - 0.5 - x, y + 0.5, rows - 0.5 - y])  # to the border
    reach = radius + NEAR_BLUR_WIDTHS * blur
    cut = (gap < reach) | touches(problem.valid, 0, disks, reach)
    # the uncertainty of a radius at a known contrast over that at the contrast of the fit
    covariance = np.linalg.pinv(fit.information[:, :4, :4], hermitian=True)
    variance = covariance[:, RADIUS, RADIUS] * covariance[:, CONTRAST, CONTRAST]
    known = 1.0 - covariance[:, RADIUS, CONTRAST] ** 2 / np.maximum(variance, 1e-300)
    chained, signal = nothing.copy(), radius / (2.0 * std)
    # two of them may be a pair of small contacts, unless they are even smaller
    faint = (radius < blur) & (signal < LOW_SIGNAL_SIGMA)
    group = label_groups(disks[faint], CLEAR_BLUR_WIDTHS * blur)
    most = np.where(radius[faint] < SPECK_BLUR_WIDTHS * blur, 1, 2)
    chained[faint] = np.bincount(group)[group] > most
    return {
        "radius": radius,
        "std": std,
        "blur": np.full(len(disks), blur),
        "signal": signal,
        "light": radius / (2.0 * std * np.sqrt(np.clip(known, 1e-6, 1.0))),
        "rise": np.where(np.isfinite(looked.plateau), plateau - ring, 2.0 * (mean - ring)) / height,
        "dust": find_dust(foreground, places, blur),
        "fall": _fall_of_rims(foreground, places, blur * problem.binning, core * plateau) / (core * height),
        "visible": np.where(gap > -radius, np.where(cut, looked.visible, 1.0), 0.0),
        "poor": poor,
        "misfit": poor & (shaped | (problem.rounding == 0.0)),
        "undescribed": undescribed,
        "counted": looked.area,
        "expected": looked.expected,
        "count_std": count_std,
        "count_z": count_z,
        "use_count": (use_count | free) & (looked.area > 0),
        "border": looked.border,
        "elongation": looked.elongation,
        "surrounded": surrounded,
        "x": looked.x,
        "y": looked.y,
        "odd": nothing if joint is None else joint.prior.is_odd(disks) >= 0,
        "brightness": contrast / (problem.contrast if joint is None else joint.contrast),
        "ellipse": ellipse,
        "touching": count_touching(disks, blur),
        "chained": chained,
        "cut": cut,
        "saturated": touches(problem.saturated, 1, disks, radius),
        "excluded": nothing if edited is None else edited.excluded,
        "manual": nothing if edited is None else edited.new,
    }


def _columns(result: FrameFit, e: Columns, shift: float) -> Columns:
    """Columns of the contacts in pixels of the frame, for all disks of the fit.

    ``shift`` is the standard uncertainty, px, of the place of every edge that no fit can see.
    """
    problem, fit, binning = result.problem, result.fit, result.problem.binning
    n, radius, std, counted = len(fit.disks), e["radius"].copy(), e["std"].copy(), e["use_count"]
    shifts = np.zeros((n, 2)) if result.joint is None else result.joint.radius_shifts.copy()
    film = np.zeros(n) if result.film is None else result.film.errors(radius)
    # the count knows no model of the edge: where both differ, the edge assumed may not be the one there is
    used, apart, apart_std = excess_of_counts(e)
    common = abs(apart) > AGREEMENT_SIGMA * apart_std
    rims = float(np.sum(2.0 * np.pi * radius[used]))
    edge = np.sqrt(shift**2 + film**2 + (abs(apart) / rims if common else 0.0) ** 2)
    if result.known_edge is not None:  # a reference contact has told what no fit can see
        edge = np.hypot(film, result.known_edge.shift_std_px / binning)
    if result.edge is not None and len(result.edge.undecided) == n:
        edge = np.hypot(edge, result.edge.undecided)
    x, y, area = fit.disks[:, X].copy(), fit.disks[:, Y].copy(), np.pi * radius**2
    major, minor, angle = radius.copy(), radius.copy(), np.full(n, np.nan)
    shape = np.full(n, "disk", object)
    spread = np.full((3, n), np.nan)
    perimeter, visible = 2.0 * np.pi * radius, area.copy()
    for row, ellipse in zip(result.ellipses.rows, result.ellipses.fitted, strict=True):
        scale = radius[row] / ellipse.parameters[RADIUS]
        major[row], minor[row] = scale * ellipse.half_axes
        angle[row], shape[row] = ellipse.angle, "ellipse"
        spread[:, row] = ellipse.shape_std
        perimeter[row] = 4.0 * major[row] * ellipe(1.0 - (minor[row] / major[row]) ** 2)
        std[row] = max(std[row], float(np.sqrt(ellipse.covariance[RADIUS, RADIUS])))
    if counted.any():
        k = np.flatnonzero(counted)
        # what the count misses or adds for a disk of this size and blur, or what is not seen of it, it does
        # for the contact as well; but no model that fails doubles a count
        count = e["counted"][k]
        hidden = np.minimum(area[k] * (1.0 - e["visible"][k]), count)
        seen = count + np.clip(area[k] * e["visible"][k] - e["expected"][k], -0.5 * count, 0.5 * count)
        part, visible[k] = seen + hidden, seen
        x[k], y[k], shape[k] = e["x"][k], e["y"][k], "free"
        error = np.hypot(e["count_std"][k], 0.5 * (part - area[k]))
        area[k], radius[k] = part, np.sqrt(part / np.pi)
        std[k] = error / (2.0 * np.pi * np.maximum(radius[k], 0.5))
        ratio = np.sqrt(np.maximum(e["elongation"][k], 1.0))
        major[k], minor[k] = radius[k] * ratio, radius[k] / ratio
        shifts[k] = 0.0
    poor = e["poor"] & ~counted
    error = (e["counted"] - e["expected"]) / (2.0 * np.pi * np.maximum(radius, 0.5))
    std = np.where(poor & (np.abs(e["count_z"]) > AGREEMENT_SIGMA), np.hypot(std, error), std)
    total = combine_errors(std, np.column_stack([shifts, edge]))
    return {
        "x_px": problem.in_frame(x),
        "y_px": problem.in_frame(y),
        "radius_px": radius * binning,
        "radius_std_px": total * binning,
        "contrast_shift_px": shifts[:, 0] * binning,
        "blur_shift_px": shifts[:, 1] * binning,
        "edge_shift_px": edge * binning,
        "shape": shape,
        "area_px2": area * binning**2,
        "area_std_px2": 2.0 * np.pi * radius * total * binning**2,
        "visible_area_px2": visible * binning**2,
        "semi_major_px": major * binning,
        "semi_minor_px": minor * binning,
        "angle_rad": angle,
        "semi_major_std_px": spread[0] * binning,
        "semi_minor_std_px": spread[1] * binning,
        "angle_std_rad": spread[2],
        "perimeter_px": perimeter * binning,
    }


def visible_areas(contacts: Columns, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Area of each contact that the image shows, px^2; that of a contact of free shape as it was counted.

    Disks and ellipses end at the border of the image, and at the chord that they have in common with others:
    where contacts overlap, the areas add up to that of their union.
    """
    x, y, radius, major, minor = (contacts[name] for name in (*PLACE, "semi_major_px", "semi_minor_px"))
    low, high = np.full(2, -0.5), np.array([shape[1] - 0.5, shape[0] - 0.5])
    visible, angle = contacts["area_px2"].copy(), np.nan_to_num(contacts["angle_rad"])
    for k in np.flatnonzero(np.minimum.reduce([x - low[0], y - low[1], high[0] - x, high[1] - y]) < major):
        polygon = Outline(0, x[k], y[k], major[k], minor[k], angle[k]).polygon
        # what lies outside falls onto the border, where it has no area
        outlines = polygon.T, np.clip(polygon, low, high).T
        whole, inside = (u[:-1] @ v[1:] - u[1:] @ v[:-1] for u, v in outlines)
        visible[k] *= inside / whole
    fitted = contacts["shape"] != "free"
    visible[fitted] -= areas_beyond_chords(np.column_stack([x, y, radius])[fitted])
    return np.where(fitted, np.maximum(visible, 0.0), contacts["visible_area_px2"])


def excess_of_counts(e: Columns) -> tuple[NDArray[np.bool_], float, float]:
    """Contacts whose pixels are counted alone, how many more than the fit expects, and the standard error."""
    used = ~e["use_count"] & ~e["cut"] & (e["touching"] == 0) & (e["radius"] > 2.0 * e["blur"])
    apart, std = e["counted"][used] - e["expected"][used], e["count_std"][used]
    return used, float(np.sum(apart)), float(np.sqrt(np.sum(std**2)))


def measure_fall(
    image: NDArray[np.float32], valid: Mask, disks: NDArray[np.float64], blur: float, *, half: int = 0
) -> NDArray[np.float64]:
    """Fall of the brightness across the rim of each disk, in the units of the image.

    The 70th percentile of its falls in `DIRECTIONS`, to the nearest of those that are seen. Infinite for
    narrow disks and those of which too little is seen.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Contacts positive.
    valid : Mask
    disks : ndarray, shape (n, >= 3)
        x, y, radius (px).
    blur : float, px
    half : int
        The brightness is the mean over a square of ``2 half + 1`` pixels.

    Examples
    --------
    >>> y, x = np.mgrid[0:100, 0:100]
    >>> far, disks = np.hypot(x - 50, y - 50), np.array([[50.0, 50.0, 30.0], [50.0, 50.0, 3.0]])
    >>> measure_fall(1.0 * (far < 30), None, disks, 1.5).tolist()
    [1.0, inf]
    >>> measure_fall(np.exp(-(far**2) / 1800), None, disks[:1], 1.5).round(2).tolist()
    [0.12]
    """
    out, wide = np.full(len(disks), np.inf), np.flatnonzero(disks[:, 2] > CLEAR_BLUR_WIDTHS * blur)
    pixels = np.asarray(image, np.float32)
    falls, count = _falls_across(pixels, for_kernel(valid), disks[wide], NEAR_BLUR_WIDTHS * blur, half)
    falls, enough = np.sort(falls), count >= LEAST_SEEN
    # By hand: up to 30 % of the rim may touch neighbours.
    chosen = np.rint(0.7 * (count[enough] - 1)).astype(int)
    out[wide[enough]] = falls[enough, chosen]
    return out


@njit(cache=True)
def _falls_across(image, valid, disks, reach, half):
    """Falls across the rim of each disk in each direction, infinite where not seen, and how many are seen."""
    rows, columns = image.shape
    falls, count = np.full((len(disks), DIRECTIONS), np.inf), np.zeros(len(disks), np.int64)
    for i in range(len(disks)):
        for k in range(DIRECTIONS):
            fall, seen, turn = 0.0, True, 2.0 * np.pi * k / DIRECTIONS
            for sign in (1.0, -1.0):  # inside, outside
                r = disks[i, 2] - sign * reach
                column, row = round(disks[i, 0] + r * np.cos(turn)), round(disks[i, 1] + r * np.sin(turn))
                seen &= 0 <= row < rows and 0 <= column < columns
                seen = seen and not (valid.shape == image.shape and valid[row, column] == 0)
                for j in range(row - half, row + half + 1) if seen else range(0):
                    for m in range(column - half, column + half + 1):
                        fall += sign * image[min(max(j, 0), rows - 1), min(max(m, 0), columns - 1)]
            if seen:
                falls[i, k] = fall / (2 * half + 1) ** 2
                count[i] += 1
    return falls, count


def _fall_of_rims(
    foreground: Foreground, disks: NDArray[np.float64], blur: float, plateau: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`measure_fall`, across the outlines at half of their plateaus for regions that are no disks."""
    image, valid = foreground.image, foreground.frame_pair.valid
    blur = min(max(blur, SHARPEST_BLUR_PX), WIDEST_BLUR_PX)
    # noise would raise the percentile of the falls, most for faint disks
    fall = measure_fall(image, valid, disks, blur, half=1)
    for row in np.flatnonzero(fall < RIM_FALL * plateau):
        x, y, reach = disks[row, 0], disks[row, 1], LONGEST_RADII * disks[row, 2] + CLEAR_BLUR_WIDTHS * blur
        box = tuple(slice(max(int(at - reach), 0), max(int(at + reach) + 1, 0)) for at in (y, x))
        window = cv2.GaussianBlur(image[box], (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
        labels = cv2.connectedComponents((window > 0.5 * plateau[row]).astype(np.uint8))[1]
        middle = round(y) - box[0].start, round(x) - box[1].start
        inside = all(0 <= at < size for at, size in zip(middle, window.shape, strict=True))
        if not (inside and labels[middle]):
            continue
        own = (labels == labels[middle]).astype(np.uint8)
        depth = cv2.distanceTransform(own, cv2.DIST_L2, cv2.DIST_MASK_5)
        depth -= cv2.distanceTransform(1 - own, cv2.DIST_L2, cv2.DIST_MASK_5)
        seen = np.ones(window.shape, np.bool_) if valid is None else valid[box] > 0
        near = [window[seen & (np.abs(depth + side * NEAR_BLUR_WIDTHS * blur) < 1.0)] for side in (-1.0, 1.0)]
        if min(map(len, near)) >= LEAST_SEEN:
            fall[row] = max(fall[row], float(np.median(near[0]) - np.median(near[1])))
    return fall
