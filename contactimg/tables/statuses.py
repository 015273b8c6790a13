"""Statuses: what the column ``status`` of a table can say of a frame or load as a whole."""

import enum
from typing import Self


class Status(enum.StrEnum):
    """State of a frame or load. ``ok`` means that the measurement describes the frame.

    Every other status comes with a sentence in the column ``message``, and here with its ``cure``. A frame
    whose status is neither ``ok`` nor ``failed`` was measured as far as that is possible.
    """

    cure: str

    def __new__(cls, name: str, cure: str = "") -> Self:
        """A status with what to do about it."""
        status = str.__new__(cls, name)
        status._value_, status.cure = name, cure
        return status

    OK = "ok"
    """The frame was measured, or the load solved, without reservation."""
    FAILED = "failed", "read the reason in the column message; frames that cannot be read are exported again"
    """No result: the frame could not be read or measured, or the model has no solution at this load."""
    APPROXIMATE = "approximate", "ask for a lower load if planes touch, a wider tolerance, or smaller steps"
    """The model's equations hold only within the tolerance that was asked for, the base planes touch, or
    contacts broke on the way to an adhesive solution."""
    NO_CONTACT = "no contact", 'check the reference and [images] polarity ("auto" finds it); take more light'
    """The frame was measured and no contact stands out of the noise."""
    LIGHT_CHANGED = "light changed", "take the reference with the lamp and the exposure of the frames"
    """The background is 1.5 times brighter or darker than the reference, or more: the illumination changed,
    or contacts fill most of the frame."""
    NOT_REGISTERED = "not registered", "take the reference at the place of the frames, or leave it out"
    """The frame could not be aligned with its reference, or only a part of it, as where rows were lost;
    background may remain in the difference."""
    HOLES = (
        "holes",
        "if the mask is meant, mind that contacts below it are not counted, and those of models are",
    )
    """Some pixels of the frame or of its reference have no finite value; they are left out."""
    ALL_HOLES = "all holes", "check the mask, and how the frame was exported"
    """No pixel has a finite value."""
    BLACK = "black", "check lamp and shutter"
    """Every pixel is zero: no light reached the sensor."""
    WHITE = "white", "shorten the exposure"
    """Every pixel is at the full scale of the sensor."""
    CONSTANT = "constant", "check how the frame was exported"
    """All pixels have the same value, neither zero nor full scale."""
    IDENTICAL = "identical to reference", "name the frame without contact as the reference"
    """The frame is identical to its reference, so no contact can show."""
    BAD_REFERENCE = "reference without light", "take the reference again with light"
    """The reference is black everywhere, or at full scale where the frame is not; the background was
    estimated from the frame."""
    POOR_FIT = "poor fit", '[measure] shape = "free" fits outlines, method = "threshold" counts pixels'
    """More than a fifth of the contacts, or the only ones, are not the disks that were fitted: their pixels
    differ by more than the noise allows. Of counted regions: most are no ellipses."""
    DISAGREES = "areas disagree", "state gamma and air film if you know them; the uncertainties cover both"
    """The areas of many contacts, or of all together, differ from those measured without a model of the edge,
    by more than the errors. The uncertainties cover both."""
    FALSE_CANDIDATES = "false candidates", "exclude what is no contact by hand in `contactimg review`"
    """Much of what was measured proved to be no contact that can be seen, a piece of a scratch, or letters in
    the frame; others may be left among the contacts."""
    UNRESOLVED = "unresolved", "split or add contacts in `contactimg review`, mask dirt, store without loss"
    """Part of the light belongs to no contact that was found: groups of contacts were not resolved,
    something that is no contact stands out, compression hides small contacts, a part of the frame has no
    light or no reference, or the fit was cut off because the frame would have cost more than one of its size
    may."""
    WRONG_REFERENCE = "wrong reference", "name the frame without contact, of the same place, as the reference"
    """The reference does not belong to the frame: it is brighter in patches (contacts, another place)."""
    SATURATED = "saturated", "shorten the exposure; state [camera] full_scale_levels of a 12-bit sensor"
    """More than a fifth of the contacts are at the full scale of the sensor, which hides how bright they are;
    the radii depend on that."""
    LIGHT_NOT_FOLLOWED = "light not followed", "take a reference under the same light, or mask reflections"
    """The background is uneven by more than noise after all corrections: changes of the light are left."""
    LITTLE_BACKGROUND = "little background", "take a reference, or a wider field of view"
    """The light could be followed on next to no background although contacts leave room, no background is
    seen around most contacts, or the frame has fewer than eight rows or columns."""
    NONLINEAR = "nonlinear response", "switch the camera's gamma off, or state [camera] gamma"
    """The edges of the contacts look like those of a camera whose grey levels are not proportional to light
    (a gamma). The radii take it into account as far as the edges show it; ``[camera] gamma`` settles it."""
    FILM = "film contradicted", 'leave [effects] film "auto", or lower [measure] film_doubt if it is known'
    """``[effects] film`` is set by hand, and the rims of the contacts say the opposite; the uncertainties
    cover both."""
    SOFT = "soft edges", "focus; calibrate the edge on contacts of known load (`contactimg calibrate`)"
    """The width of the edges, or the light just outside, grows with the contacts, or the blur is about as
    wide as counted contacts. Where in it a contact ends cannot be seen in one image; the uncertainties,
    common to all contacts, include that. Or a known shift of the edge takes more than half of the radius of
    some contacts."""

    NO_POSE = "no pose", "check asperities and pixel_size_m; know rotation_deg to 3 degrees of a quarter turn"
    """Fewer than half of the contacts fall on an asperity of the table, wherever the camera may look:
    contacts have no asperities. Radii and areas do not depend on that."""
    OFF_LOAD = "forces off load", "check unit and zero of the loads, modulus, pixel size, asperities' radii"
    """The local forces add up to less than two thirds or more than one and a half times the load, beyond the
    errors, or bear one where there is none: the modulus, the load or its zero, the pixel size or the radii of
    the asperities are not what the scene says. Less is no fault where contacts reach the border of the frame.
    Radii and areas in pixels do not depend on that."""


FAILED = Status.FAILED
_NOTHING_SEEN = {Status.ALL_HOLES, Status.BLACK, Status.WHITE, Status.CONSTANT, Status.IDENTICAL}
NO_RESULT = frozenset({FAILED, Status.NO_CONTACT, Status.NO_POSE, Status.OFF_LOAD, *_NOTHING_SEEN})
"""Statuses of frames that have no result to rely on, or not the one that the scene asks for."""
