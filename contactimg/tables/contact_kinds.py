"""How contacts are drawn: colours by their flags, and dashes for eyes and printers without colours.

All colours are of the palette of Okabe and Ito, which colour-blind eyes tell apart.
"""

from dataclasses import asdict, dataclass

from contactimg.tables.flags import Flag

CONTACT_COLOUR, FLAGGED_COLOUR, MANUAL_COLOUR, REJECTED_COLOUR = "#56b4e9", "#f0e442", "#cc79a7", "#d55e00"
"""Colours of contacts, flagged ones, those drawn by hand and rejected candidates."""
CUT_COLOUR, TOUCHING_COLOUR = "#e69f00", "#009e73"
"""Colours of contacts that are not wholly seen, and of those that touch."""

_DOUBTFUL = Flag.POOR_FIT | Flag.DISAGREES | Flag.LOW_SIGNAL | Flag.NO_PLATEAU | Flag.COUNTED
_CUT = Flag.EDGE | Flag.SATURATED | Flag.TOO_SMALL
_TOUCHING = Flag.MERGED | Flag.OVERLAP


@dataclass(frozen=True)
class Kind:
    """How contacts of one kind are drawn.

    Parameters
    ----------
    name : str
    colour : str
        As ``#rrggbb``.
    dashes : tuple of float, px
        Lengths of dash and gap; empty for a full line.
    flags : Flag
        A contact is of the first kind with one of its flags; the last kind has none.
    """

    name: str
    colour: str
    dashes: tuple[float, ...]
    flags: Flag

    @property
    def record(self) -> dict[str, object]:
        """The kind as the page of `review` takes it."""
        names = [str(flag.name) for flag in Flag if flag & self.flags]
        return asdict(self) | {"flags": int(self.flags), "flag_names": names}


def kinds_of_contacts() -> list[Kind]:
    """Kinds of contacts; one is of the first kind with one of its flags.

    Examples
    --------
    >>> [kind.name for kind in kinds_of_contacts()]
    ['by hand', 'doubtful', 'cut or not resolved', 'touching', 'beyond Hertz', 'contact']
    """
    return [
        Kind("by hand", MANUAL_COLOUR, (), Flag.MANUAL),
        Kind("doubtful", FLAGGED_COLOUR, (8, 4), _DOUBTFUL),
        Kind("cut or not resolved", CUT_COLOUR, (4, 4), _CUT),
        Kind("touching", TOUCHING_COLOUR, (14, 4), _TOUCHING),
        Kind("beyond Hertz", CONTACT_COLOUR, (6, 3), Flag.BEYOND_HERTZ),
        Kind("contact", CONTACT_COLOUR, (), Flag(0)),
    ]


def kind_of_rejected() -> Kind:
    """How rejected candidates are drawn."""
    return Kind("rejected", REJECTED_COLOUR, (), Flag(0))
