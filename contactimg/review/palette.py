"""Colours of the contacts on the page by their flags, and dashes for eyes and printers without colours."""

from contactimg.pipeline.export import CONTACT_COLOUR, FLAGGED_COLOUR, MANUAL_COLOUR, REJECTED_COLOUR
from contactimg.tables import Flag

CUT_COLOUR, TOUCHING_COLOUR = "#e69f00", "#009e73"
"""Of contacts that are not wholly seen, and of those that touch: the palette of Okabe and Ito."""
Kind = dict[str, object]

_DOUBTFUL = Flag.POOR_FIT | Flag.DISAGREES | Flag.LOW_SIGNAL | Flag.NO_PLATEAU
_CUT = Flag.EDGE | Flag.SATURATED | Flag.TOO_SMALL
_TOUCHING = Flag.MERGED | Flag.OVERLAP


def kinds_of_contacts() -> list[Kind]:
    """Name, colour, dashes (px) and flags of each kind; a contact is of the first with one of its flags.

    Examples
    --------
    >>> [kind["name"] for kind in kinds_of_contacts()]
    ['by hand', 'doubtful', 'cut or not resolved', 'touching', 'beyond Hertz', 'contact']
    """
    return [
        _kind("by hand", MANUAL_COLOUR, [], Flag.MANUAL),
        _kind("doubtful", FLAGGED_COLOUR, [8, 4], _DOUBTFUL),
        _kind("cut or not resolved", CUT_COLOUR, [4, 4], _CUT),
        _kind("touching", TOUCHING_COLOUR, [14, 4], _TOUCHING),
        _kind("beyond Hertz", CONTACT_COLOUR, [6, 3], Flag.BEYOND_HERTZ),
        _kind("contact", CONTACT_COLOUR, [], Flag(0)),
    ]


def kind_of_rejected() -> Kind:
    """The same for rejected candidates."""
    return _kind("rejected", REJECTED_COLOUR, [], Flag(0))


def flag_values() -> dict[str, int]:
    """Name of a flag -> its value."""
    return {str(flag.name): int(flag) for flag in Flag}


def _kind(name: str, colour: str, dashes: list[int], flags: Flag) -> Kind:
    names = [str(flag.name) for flag in Flag if flag & flags]
    return {"name": name, "colour": colour, "dashes": dashes, "flags": int(flags), "flag_names": names}
