"""What the table of evidence says of the frame as a whole: one status, and sentences that say what to do."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.candidates import ODD_RATIO, dark_spots, measure_contrast
from contactimg.imaging.detect.rim_blur import DEFAULT_BLUR_PX
from contactimg.imaging.evidence import rules
from contactimg.imaging.evidence.background_left import UNEVENNESS, inspect_background
from contactimg.imaging.fit.learned_edge import describe_edge
from contactimg.imaging.fit.method import FrameFit
from contactimg.imaging.foreground import Foreground
from contactimg.imaging.kernels.pairs import EDGE_BLUR_WIDTHS
from contactimg.imaging.pixels.blocks import BLOCK, SignedImage
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.limits import CLEAR_BLUR_WIDTHS, FEWEST, RESOLVED
from contactimg.tables import Flag, Reason, Status

SPOILED_SHARE = 0.2
"""Share of contacts flagged, or of free background not followed, that spoils a frame. By hand."""
DOUBTED_SHARE = 0.05
"""Share of the candidates that prove to be no contacts, or of the bright pixels that belong to none, above
which others may be false or missing. By hand."""
LIGHT_CHANGE = 1.5
"""Ratio of the background to the reference, or its inverse, above which the light has changed. By hand."""
HIDDEN_SHARE = 0.02
"""Share of the frame under hairs and scratches, or not covered or not lit by the reference, above which
contacts may be missing. By hand: one of twenty contacts of a usual frame. Contacts must leave as much of it
free for a statement on the background."""
FEWEST_DOUBTED, DOUBTED_AREA = 2, 0.02
"""Spots that are faint, of the other sign, or at the full scale of the sensor and no disks, from which they
are doubted; and area of the latter two over that of the contacts above which they are. By hand: dust that has
moved makes 0.007-0.025, letters 0.02-0.09."""
FAINT = 0.25
"""Brightness over that of the frame's contacts below which several spots are doubted. By hand: light that two
surfaces of glass reflect makes 0.002, of four or coated mirrors up to 0.2."""
WAVES = 0.06
"""The same within 32 px: fringes, or a texture. By hand: a texture of 2 % of the light, without a reference,
makes 0.02 at a contrast of 0.6."""


def judge_frame(seen: rules.Judged) -> tuple[str, str, bool]:
    """Status, message and measurability of a frame.

    Returns
    -------
    status : str
        "ok", or the most important defect.
    message : str
        Sentences for the user, joined by semicolons.
    measurable : bool
        Whether "no contact" is a result; False if the frame does not allow one.
    """
    pair, difference = seen.foreground.frame_pair, seen.foreground.difference
    if pair.trivial:
        # a frame equal to its reference does show that there is no contact; the others show nothing
        return pair.defect, pair.message, pair.defect == Status.IDENTICAL
    found = [*_light(seen), *_contacts(seen)]
    remarks = [difference.remark, *_remarks(seen)]
    if pair.reference is None and not pair.defect:
        remarks.insert(0, "no reference: the background was estimated from the frame")
    message = "; ".join(filter(None, [pair.message, *(text for _, text in found), *remarks]))
    statuses = [pair.defect, *(status for status, _ in found)]
    # holes do not spoil what is seen beside them
    status = next(filter(None, sorted(statuses, key=Status.HOLES.__eq__)), Status.OK)
    empty = Status.LIGHT_CHANGED not in statuses and _left_out(seen.foreground) < SPOILED_SHARE
    return status, message, bool(seen.count or empty)


def _left_out(foreground: Foreground) -> float:
    """Share of the frame that stands out of the background or is hidden by what does, without contacts."""
    mask = foreground.foreign.mask
    hidden = 0.0 if mask is None else float(np.mean(mask))
    return hidden + float(np.mean(foreground.bright)) * foreground.shown.resolved


def _light(seen: rules.Judged) -> Iterator[tuple[str, str]]:
    """Defects of light, reference and background, gravest first."""
    foreground, difference = seen.foreground, seen.foreground.difference
    rows, columns = foreground.image.shape
    ratio = float(difference.illumination.coefficients[0, 0])
    if difference.ratio and not 1 / LIGHT_CHANGE < ratio < LIGHT_CHANGE:
        what = "contacts fill" if seen.count else "one contact fills"
        text = f"the background is {ratio:.2g} times the reference: the light changed or {what} the frame"
        yield Status.LIGHT_CHANGED, text
    elif not seen.count:
        lost = _left_out(foreground) > HIDDEN_SHARE
        yield Status.UNRESOLVED if lost else Status.NO_CONTACT, _why_no_contact(foreground)
    if difference.registration_failed:
        yield Status.NOT_REGISTERED, ""
    if (moved := difference.alignment) is not None and moved.known:
        if not (moved.consistent or difference.rounding):  # compression takes texture here and there
            text = (
                "frame and reference agree in a part of the image only: rows of the frame were lost, or part "
                "of the surface moved"
            )
            yield Status.NOT_REGISTERED, text
        bare = abs(moved.x_px) / columns + abs(moved.y_px) / rows
        if bare > HIDDEN_SHARE:
            text = (
                f"the reference lies {np.hypot(moved.x_px, moved.y_px):.3g} px away and leaves "
                f"{100 * bare:.2g} % of the frame bare: contacts there were left out"
            )
            yield Status.UNRESOLVED, text
    if (dark := foreground.frame_pair.lit_in_one) > HIDDEN_SHARE:
        text = (
            f"{100 * dark:.2g} % of the pixels are lit in one of frame and reference alone: contacts there "
            "were left out"
        )
        yield Status.UNRESOLVED, text
    if min(rows, columns) < BLOCK and seen.count:
        text = f"the frame has {rows} x {columns} pixels: contacts and their background need {BLOCK} each way"
        yield Status.LITTLE_BACKGROUND, text
    yield from _background(seen)
    yield from _grey_levels(foreground)


def _background(seen: rules.Judged) -> Iterator[tuple[str, str]]:
    """Defects of the background that is left outside the contacts and what the blur spreads of them."""
    foreground, fit = seen.foreground, seen.fit
    blur = DEFAULT_BLUR_PX if fit is None else fit.fit.blur * fit.problem.binning
    by_hand = seen.rejected["reason"] == Reason.BY_HAND  # no background either
    places = [np.append(seen.contacts[name], seen.rejected[name][by_hand]) for name in rules.PLACE]
    left = inspect_background(
        foreground.image, foreground.frame_pair.valid, foreground.difference.illumination.background,
        np.column_stack(places),
        reach_px=EDGE_BLUR_WIDTHS * blur, contrast=foreground.contrast.plateau,
    )  # fmt: skip
    if seen.count and fit is None and left.free_share < HIDDEN_SHARE:
        text = f"the light of contacts leaves {100 * left.free_share:.2g} % of the frame for the background"
        yield Status.LITTLE_BACKGROUND, text
    elif left.free_share >= HIDDEN_SHARE:
        # By hand: fifteen contacts in the reference make 0.013.
        if foreground.difference.ratio and left.dark_share > 0.004:
            text = (
                f"{100 * left.dark_share:.3g} % of the background stand out of the reference the wrong way, "
                "by a fifth of the contrast and more: does the reference show contacts, or another place?"
            )
            yield Status.WRONG_REFERENCE, text
        if left.found_share < 1.0 - SPOILED_SHARE:
            text = (
                f"the light was followed on {100 * left.found_share:.0f} % only of the background that "
                "contacts leave free: it changed in a way that was not followed"
            )
            yield Status.LITTLE_BACKGROUND, text
        if left.uneven > UNEVENNESS or left.waves > WAVES:
            share = 100 * max(left.uneven, left.waves)
            text = f"the background is uneven by {share:.3g} % of the contrast after all corrections"
            yield Status.LIGHT_NOT_FOLLOWED, text


def _grey_levels(foreground: Foreground) -> Iterator[tuple[str, str]]:
    """Defects of frames that were stored with too few grey levels."""
    contrast, pair = foreground.contrast.plateau, foreground.frame_pair
    if (rounding := foreground.difference.rounding) > UNEVENNESS * contrast:
        text = (
            "the levels are rounded, by compression or few bits: the mean of a block of pixels is known to "
            f"{rounding * pair.unit:.2g} grey levels, and small contacts may be lost"
        )
        yield Status.UNRESOLVED, text
    # By hand: with fewer, an edge is that of whole pixels.
    if 0 < contrast < 4.0 * pair.step:
        steps = max(contrast / pair.step, 1.0)
        text = (
            f"background and contacts are {steps:.2g} steps of the grey levels apart: "
            "where between two pixels an edge lies is not seen, nor what a threshold has left out"
        )
        yield Status.UNRESOLVED, text


def _contacts(seen: rules.Judged) -> Iterator[tuple[str, str]]:
    """Defects of the contacts, gravest first."""
    if seen.fit is not None:
        blur, given = seen.optics.blur_px, seen.foreground.prior_optics.blur_px
        if blur > rules.WIDEST_BLUR_PX and seen.count < FEWEST and not np.isfinite(given):
            text = f"what stands out is blurred over {blur:.2g} px, as light is, and no image of contacts"
            yield Status.LIGHT_NOT_FOLLOWED, text
        yield from _edges(seen.fit, seen.contacts["radius_px"])
        if seen.fit.limited:
            yield Status.UNRESOLVED, "more spots stand out than are fitted in a frame of this size"
    yield from _false_candidates(seen)
    if which := _spoiled(seen, Flag.SATURATED):
        text = (
            f"{which} are at the full scale of the sensor: expose less, the radii "
            "depend on a brightness that is not seen"
        )
        yield Status.SATURATED, text
    drawn = Flag.SATURATED | Flag.POOR_FIT
    which = _spoiled(seen, drawn, fewest=FEWEST_DOUBTED, many=DOUBTED_SHARE, much=DOUBTED_AREA)
    if seen.fit is not None and which:
        text = (
            f"{which} are at the full scale of the sensor and no disks: letters and marks that a program "
            "draws into a frame look like that"
        )
        yield Status.FALSE_CANDIDATES, text
    if which := _spoiled(seen, Flag.POOR_FIT):
        text = f"{which} are not described by blurred disks or ellipses"
        given = seen.foreground.prior_optics.blur_px
        yield Status.POOR_FIT, text + (f" behind a blur of {given:.2g} px" if np.isfinite(given) else "")
    counted = Flag.COUNTED | Flag.DISAGREES
    if seen.fit is not None and seen.flagged(counted) >= FEWEST and (which := _spoiled(seen, counted)):
        yield Status.DISAGREES, f"{which} have counted areas that are far from those of the fit"
    if seen.rim_height != 1.0:
        text = (
            f"the contacts have {100 * seen.rim_height:.0f} % of their height at their rims, which moves the "
            "pixel count by what the uncertainties include"
        )
        yield Status.DISAGREES, text
    if seen.count and seen.evidence:
        yield from _fitted(seen.evidence)
    faint = seen.having(Flag.TOO_SMALL | Flag.LOW_SIGNAL)
    specks = faint & (seen.contacts["radius_px"] < rules.SPECK_BLUR_WIDTHS * seen.optics.blur_px)
    n, few, odd = (int(np.count_nonzero(one)) for one in (faint, specks, faint & seen.having(Flag.POOR_FIT)))
    many = n >= FEWEST and (n > SPOILED_SHARE * seen.count or few > DOUBTED_SHARE * seen.count)
    if many or FEWEST_DOUBTED <= odd > DOUBTED_SHARE * seen.count:
        text = f"{n} of {seen.count} contacts are no wider than the blur and hardly stand out of the noise"
        yield Status.FALSE_CANDIDATES, text


def _spoiled(
    seen: rules.Judged, flag: Flag, *, fewest: int = FEWEST, many: float = SPOILED_SHARE, much: float = 0.5
) -> str:
    """Say how many contacts have a flag, if they are so many, or so large, that they spoil the frame."""
    n, area = seen.flagged(flag), seen.contacts["visible_area_px2"]
    share = float(area[seen.having(flag)].sum() / max(area.sum(), 1e-9))
    spoiled = (n >= fewest and (n > many * seen.count or share > much)) or share > 0.5
    return f"{n} of {seen.count} contacts, {100 * share:.3g} % of the area," if spoiled else ""


def _fitted(e: rules.Columns) -> Iterator[tuple[str, str]]:
    """Defects that the evidence of all contacts together shows, gravest first."""
    alone = e["touching"] == 0
    disks = np.count_nonzero(~alone & ~e["ellipse"])
    if disks >= 2 and np.count_nonzero(e["ellipse"] & alone) > 0.5 * alone.sum():
        text = f"most contacts are ellipses, and {disks} disks touch: two of them may be one ellipse"
        yield Status.UNRESOLVED, text
    used, apart, std = rules.excess_of_counts(e)
    share, z = apart / max(float(e["expected"][used].sum()), 1.0), apart / max(std, 1e-9)
    # By hand: a hundredth of the area shows another edge than the one assumed.
    if np.count_nonzero(used) >= FEWEST and abs(z) >= SIGNIFICANT_SIGMA and abs(share) >= 0.01:
        text = (
            f"the pixels above half height make areas {100 * share:+.2g} % of those of the fit ({z:+.2g} "
            "standard errors): the edge of the contacts is not the one assumed"
        )
        yield Status.DISAGREES, text
    # Theory: 0.95 of the height; by hand: unsharp masks of 0.5, 1 and 2 make 0.97, 1.1 and 1.5, the last with
    # areas wrong by a fifth, and contacts of speckles 1.14.
    high = (e["fall"] / e["brightness"])[np.isfinite(e["fall"])] > 1.25
    if len(high) >= FEWEST and np.mean(high) > 0.5:
        text = "most rims fall by 1.25 of the contrast and more: a camera that sharpens makes such"
        yield Status.NONLINEAR, text
    bare = 1.0 - float(np.mean(e["surrounded"]))
    if bare > (0.5 if len(alone) >= FEWEST else 0.99):
        yield Status.LITTLE_BACKGROUND, f"no background is seen around {100 * bare:.0f} % of the contacts"


def _false_candidates(seen: rules.Judged) -> Iterator[tuple[str, str]]:
    """Candidates that were taken for contacts and are none, or were not taken and may be."""
    foreground, reasons = seen.foreground, Counter(seen.rejected["reason"])
    dust = reasons[Reason.REFERENCE_DUST]
    false = sum(reasons[reason] for reason in rules.FALSE_CANDIDATES)
    if dust > 0.5 * (dust + seen.count) and dust >= FEWEST:
        text = (
            f"{dust} of {dust + seen.count} spots are in the reference, not in the frame: is it that of "
            "another place?"
        )
        yield Status.WRONG_REFERENCE, text
    if false >= FEWEST and false > DOUBTED_SHARE * (false + seen.count):
        text = (
            f"{false} of {false + seen.count} candidates proved to be no contacts; others may be left among "
            "the contacts"
        )
        yield Status.FALSE_CANDIDATES, text
    mask = foreground.foreign.mask
    if mask is not None and (hidden := float(np.mean(mask))) > HIDDEN_SHARE:
        percent = f"{100 * hidden:.2g} %"
        text = f"hairs, scratches or bars hide {percent} of the frame: what they cross was left out"
        yield Status.UNRESOLVED, text
    if seen.unexplained > DOUBTED_SHARE:
        percent = f"{100 * seen.unexplained:.3g} %"
        text = f"{percent} of the pixels that stand out belong to no contact that was found"
        yield Status.UNRESOLVED, text
    if seen.evidence and seen.count:
        brightness = seen.evidence["brightness"]  # a second image draws the common contrast down
        faint = int(np.count_nonzero(brightness < FAINT * max(np.quantile(brightness, 0.75), 1.0)))
        if faint >= FEWEST_DOUBTED and faint > DOUBTED_SHARE * seen.count:
            text = (
                f"{faint} of {seen.count} contacts have less than {FAINT:g} of the brightness of the others: "
                "reflections and dirt look like that"
            )
            yield Status.FALSE_CANDIDATES, text
    small = seen.flagged(Flag.TOO_SMALL)
    if foreground.frame_pair.reference is None and FEWEST <= small > DOUBTED_SHARE * seen.count:
        text = (
            f"{small} of {seen.count} contacts are no wider than the blur: without a reference specks of "
            "dirt look the same"
        )
        yield Status.FALSE_CANDIDATES, text
    dark = dark_spots(foreground.seen, foreground.contrast.plateau)
    area = np.pi * float(np.sum(seen.contacts["radius_px"] ** 2))
    # without a reference, a single one may be a speck of dust
    large = dark.sum() > DOUBTED_SHARE * area and foreground.frame_pair.reference is not None
    if large or (len(dark) >= FEWEST_DOUBTED and dark.sum() > DOUBTED_AREA * area):
        against = "darker" if foreground.sign > 0 else "brighter"
        text = (
            f"{len(dark)} spot{'s are' if len(dark) > 1 else ' is'} {against} than the background, "
            f"{seen.count} are contacts: measure those with the other polarity, or see whether the reference "
            "shows them"
        )
        yield Status.UNRESOLVED, text


def _edges(fit: FrameFit, radius: NDArray[np.float64]) -> Iterator[tuple[str, str]]:
    """The statuses and remarks that the edges of contacts of some radii (px) give."""
    if fit.film is not None:
        verdict = fit.film.verdict
        yield Status.FILM if verdict.contradicted else "", verdict.remark()
    if fit.edge is not None:
        families = set(fit.edge.families)
        known = fit.known_edge is not None
        soft = bool({"softness", "rim"} & families) and not known
        status = Status.NONLINEAR if "response" in families else Status.SOFT if soft else ""
        yield status, describe_edge(fit.edge, binning=fit.problem.binning)
    if fit.known_edge is not None:
        shift, count = fit.known_edge.shift_px, len(radius)
        if n := int(np.count_nonzero(shift > 0.5 * radius)):
            text = f"the shift of the edge, {shift:.3g} px, is more than half of the radius of {n} of {count}"
            yield Status.SOFT if n > DOUBTED_SHARE * count else "", f"{text} contacts"


def _remarks(seen: rules.Judged) -> Iterator[str]:
    """The remarks that are worth knowing without being a defect."""
    foreground = seen.foreground
    unit, valid = foreground.frame_pair.unit, foreground.frame_pair.valid
    yield seen.remark
    if valid is not None and (hidden := 1.0 - float(np.mean(valid))) > HIDDEN_SHARE:
        percent = f"{100 * hidden:.2g} %"
        yield f"{percent} of the frame were left out: no light, a margin, a foreign object or a mask"
    refused = foreground.refused
    compared = [
        ("a contrast of {:.3g} grey levels", seen.optics.contrast * unit, refused.contrast * unit),
        ("a blur of {:.3g} px", seen.optics.blur_px, refused.blur_px),
    ]
    if known := [part for part in compared if np.isfinite(part[2])]:
        here = " and ".join(text.format(value) for text, value, _ in known)
        there = " and ".join(f"{value:.3g}" for _, _, value in known)
        yield f"the frame shows {here}, not the {there} given or shown by other frames, which were not used"
    given, shown = foreground.prior_optics.contrast, foreground.shown
    wide = seen.contacts["radius_px"] > CLEAR_BLUR_WIDTHS * DEFAULT_BLUR_PX
    # no radius depends on the contrast where every contact shows its plateau
    independent = shown.resolved and wide.all()
    if seen.count and shown.resolved and given > ODD_RATIO * shown.plateau:
        yield (
            f"the radii depend on a contrast of {given * unit:.3g} grey levels, given, of which the frame "
            f"shows {shown.plateau * unit:.3g}"
        )
    elif seen.count and seen.own_optics.contrast_relative_std > RESOLVED and not independent:
        source = "given" if np.isfinite(given) else "estimated from their light"
        joint = None if seen.fit is None else seen.fit.joint
        contrast = foreground.contrast.plateau if joint is None else joint.contrast
        why = "few to settle" if wide.any() else "small to show"
        yield (
            f"the contacts are too {why} their brightness: the radii depend on a contrast of "
            f"{contrast * unit:.3g} grey levels, {source}"
        )
    if n := seen.flagged(Flag.BRIGHTNESS):
        yield f"{n} of {seen.count} contacts have a brightness of their own"
    if seen.fit is not None and (n := seen.flagged(Flag.COUNTED)):
        yield f"the areas of {n} of {seen.count} contacts are those of their counted pixels"


def _why_no_contact(foreground: Foreground) -> str:
    """One sentence on a frame in which nothing was found."""
    if foreground.shown.resolved:
        level = foreground.shown.plateau * foreground.frame_pair.unit
        return f"something stands out by {level:.3g} grey levels, but it is no contact for the assumed optics"
    one = foreground.seen
    opposite = measure_contrast(SignedImage(-one.image, one.noise, one.valid, rounding=one.rounding))
    if not opposite.resolved:
        return "nothing stands out of the noise"
    same, other = ("brighter", "darker")[:: foreground.sign]
    return f"nothing {same} than the background stands out, but something {other}: is the polarity right?"
