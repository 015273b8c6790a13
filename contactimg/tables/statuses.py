"""Statuses: what the column ``status`` of a table can say of a frame or load as a whole."""

import enum


class Status(enum.StrEnum):
    """State of a frame or load. ``ok`` means that the measurement describes the frame.

    Every other status comes with a sentence in the column ``message``. A frame whose status is neither ``ok``
    nor ``failed`` was measured as far as that is possible.
    """

    OK = "ok"
    """The frame was measured, or the load solved, without reservation."""
    FAILED = "failed"
    """No result: the frame could not be read or measured, or the model has no solution at this load."""
    APPROXIMATE = "approximate"
    """The model's equations hold only within the tolerance that was asked for, or contacts broke on the way
    to an adhesive solution."""
    NO_CONTACT = "no contact"
    """The frame was measured and no contact stands out of the noise."""
    LIGHT_CHANGED = "light changed"
    """The background is 1.5 times brighter or darker than the reference, or more: the illumination changed,
    or contacts fill most of the frame."""
    NOT_REGISTERED = "not registered"
    """The frame could not be aligned with its reference; background may remain in the difference."""
    HOLES = "holes"
    """Some pixels of the frame or of its reference have no finite value; they are left out."""
    ALL_HOLES = "all holes"
    """No pixel has a finite value."""
    BLACK = "black"
    """Every pixel is zero: no light reached the sensor."""
    WHITE = "white"
    """Every pixel is at the full scale of the sensor."""
    CONSTANT = "constant"
    """All pixels have the same value, neither zero nor full scale."""
    IDENTICAL = "identical to reference"
    """The frame is identical to its reference, so no contact can show."""
    BAD_REFERENCE = "reference without light"
    """The reference is black or at full scale everywhere; the background was estimated from the frame."""
    POOR_FIT = "poor fit"
    """More than a fifth of the contacts, or the only ones, are not the disks that were fitted: their pixels
    differ by more than the noise allows. Of counted regions: most are no ellipses."""
    DISAGREES = "areas disagree"
    """The areas of many contacts, or of all together, differ from those measured without a model of the edge,
    by more than the errors. The uncertainties cover both."""
    FALSE_CANDIDATES = "false candidates"
    """Much of what was measured proved to be no contact that can be seen, or a piece of a scratch; others may
    be left among the contacts."""
    UNRESOLVED = "unresolved"
    """Part of the light belongs to no contact that was found: groups of contacts were not resolved,
    something that is no contact stands out, or the fit was cut off because the frame would have cost more
    than one of its size may."""
    WRONG_REFERENCE = "wrong reference"
    """The reference does not belong to the frame: it is brighter in patches (contacts, another place)."""
    SATURATED = "saturated"
    """More than a fifth of the contacts are at the full scale of the sensor, which hides how bright they are;
    the radii depend on that."""
    LIGHT_NOT_FOLLOWED = "light not followed"
    """The background is uneven by more than noise after all corrections: changes of the light are left."""
    LITTLE_BACKGROUND = "little background"
    """The light could be followed on next to no background although contacts leave room, no background is
    seen around most contacts, or the frame has fewer than eight rows or columns."""
    NONLINEAR = "nonlinear response"
    """The edges of the contacts look like those of a camera whose grey levels are not proportional to light
    (a gamma). The radii take it into account as far as the edges show it; ``[camera] gamma`` settles it."""
    FILM = "film contradicted"
    """``[effects] film`` is set by hand, and the rims of the contacts say the opposite; the uncertainties
    cover both."""
    SOFT = "soft edges"
    """The width of the edges, or the light just outside, grows with the contacts, or the blur is about as
    wide as counted contacts. Where in it a contact ends cannot be seen in one image; the uncertainties,
    common to all contacts, include that."""

    NO_POSE = "no pose"
    """Fewer than half of the contacts fall on an asperity of the table, wherever the camera may look:
    contacts have no asperities. Radii and areas do not depend on that."""
    OFF_LOAD = "forces off load"
    """The local forces add up to less than two thirds or more than one and a half times the load, beyond the
    errors: the modulus, the load or its zero, the pixel size or the radii of the asperities are not what the
    scene says. Radii and areas in pixels do not depend on that."""


FAILED = Status.FAILED
NO_RESULT = frozenset(
    {
        Status.FAILED,
        Status.NO_CONTACT,
        Status.ALL_HOLES,
        Status.BLACK,
        Status.WHITE,
        Status.CONSTANT,
        Status.IDENTICAL,
        Status.NO_POSE,
        Status.OFF_LOAD,
    }
)
"""Statuses of frames that have no result to rely on, or not the one that the scene asks for."""

CURES = {
    Status.FAILED: "read the reason in the column message; frames that cannot be read are exported again",
    Status.APPROXIMATE: "ask for a wider tolerance, or for smaller steps of the load",
    Status.NO_CONTACT: 'check the reference and [images] polarity ("auto" finds it); take more light',
    Status.LIGHT_CHANGED: "take the reference with the lamp and the exposure of the frames",
    Status.NOT_REGISTERED: "take the reference at the place of the frames, or leave it out",
    Status.HOLES: "nothing, if the mask is meant; contacts below it are not counted",
    Status.ALL_HOLES: "check the mask, and how the frame was exported",
    Status.BLACK: "check lamp and shutter",
    Status.WHITE: "shorten the exposure",
    Status.CONSTANT: "check how the frame was exported",
    Status.IDENTICAL: "name the frame without contact as the reference",
    Status.BAD_REFERENCE: "take the reference again with light",
    Status.POOR_FIT: 'look at the picture; [measure] shape = "free" fits outlines, "threshold" counts pixels',
    Status.DISAGREES: "state gamma and air film if you know them; the uncertainties cover both areas",
    Status.FALSE_CANDIDATES: "look at the picture; exclude what is no contact in `contactimg review`",
    Status.UNRESOLVED: "look at the picture; split or add contacts in `contactimg review`, or mask dirt",
    Status.WRONG_REFERENCE: "name the frame without contact, of the same place, as the reference",
    Status.SATURATED: "shorten the exposure; state [camera] full_scale_levels for 12 bits in 16-bit files",
    Status.LIGHT_NOT_FOLLOWED: "take a reference under the same light, or mask reflections",
    Status.LITTLE_BACKGROUND: "take a reference, or a wider field of view",
    Status.NONLINEAR: "switch the camera's gamma off, or state [camera] gamma",
    Status.FILM: 'leave [effects] film "auto", or lower [measure] film_doubt if it is known',
    Status.SOFT: "focus; calibrate the edge on contacts of known load (`contactimg calibrate`)",
    Status.NO_POSE: "check the asperity table and [camera] pixel_size_m; rotation must be known to 3 degrees "
    "of a quarter turn",
    Status.OFF_LOAD: "check unit and zero of the loads, young_modulus_Pa, pixel_size_m and the asperities' "
    "radii",
}
"""Status -> what to do about it: what the terminal and the page of messages say."""
