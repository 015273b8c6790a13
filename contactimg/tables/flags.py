"""Quality flags of a measured or predicted contact, and reasons of rejection."""

import enum
from collections.abc import Iterable
from functools import cache
from typing import Self


class Flag(enum.IntFlag):
    """Remarks on an accepted contact, of which several may be set at once.

    The column ``flags`` holds their sum; the CSV files hold their names, joined by ``|``.
    ``cure`` says what to do about a flag.
    """

    cure: str

    def __new__(cls, value: int, cure: str = "") -> Self:
        """A flag with what to do about it."""
        flag = int.__new__(cls, value)
        flag._value_, flag.cure = value, cure
        return flag

    EDGE = 1 << 0, "centre the contacts in the field of view; areas outside are not seen"
    """The contact, or its blurred rim, is cut by the border of the image or by a hole in the image."""
    MERGED = 1 << 1, "look at the picture; split or merge by hand in `contactimg review`"
    """The contact touches a neighbour in the image; its radius depends on how the two were separated."""
    SATURATED = 1 << 2, "shorten the exposure"
    """Some of its pixels are at the full scale of the sensor."""
    TOO_SMALL = 1 << 3, "magnify more, or leave it out of laws (`analyse --min-radius-px`)"
    """Not resolved: the radius minus its uncertainty is below the standard deviation of the blur."""
    POOR_FIT = 1 << 4, "look at the picture; exclude it by hand if it is no contact"
    """The pixels differ from the fitted disk by more than the noise allows, or the fit was cut off because
    the frame would have taken too long: the uncertainty then covers the area of the contact's light."""
    BEYOND_HERTZ = 1 << 5, "the law of the exact sphere holds further; its force is uncertain"
    """The contact is wider than 0.33 radii of its asperity, the range of Hertz's law, or than two thicknesses
    of the layer below it, beyond which there is no law and no force."""
    OVERLAP = 1 << 6, "lower the load, or take areas from the measurement"
    """Two model contacts are closer than the sum of their radii: in reality they would merge."""
    LOW_SIGNAL = 1 << 7, "take more light, or average frames"
    """The signal of the contact is close to the detection limit."""
    NO_PLATEAU = 1 << 8, "measure it in a series with larger contacts"
    """No contact of the frame is large enough to show the plateau brightness; the radius depends on the
    contrast of other frames or on an estimate, and its uncertainty includes that."""
    DISAGREES = 1 << 9, "its uncertainty covers both; check focus and gamma if many disagree"
    """Its area by light or at half height, free of the model of the edge, differs from that of the fit by
    more than the errors; its uncertainty covers both."""
    MANUAL = 1 << 10, "nothing"
    """Added, split or merged by hand (edits.csv), then measured from the pixels like the others."""
    BRIGHTNESS = 1 << 11, "nothing, if few; else check the light"
    """Its plateau disagrees with the contrast of the frame: it is measured with its own. The method
    "threshold" counts it at the level of the others; its uncertainty reaches to the count at its own."""
    COUNTED = 1 << 12, "nothing; its uncertainty is that of a pixel count"
    """No model describes it: its area is that of its pixels above half of its own plateau."""


def flag_names(flags: Iterable[int]) -> list[str]:
    """Flag names joined by ``|`` for each row, as in the CSV files."""
    return [_names(int(value)) for value in flags]


@cache
def _names(value: int) -> str:
    """The names in one value: few values occur, in many rows."""
    return "|".join(str(flag.name) for flag in Flag(value))


class Reason(enum.StrEnum):
    """Why a candidate is not a contact."""

    NOISE = "noise"
    """The summed light of its pixels does not stand out of the noise."""
    LONG = "long: neither a disk nor a group of disks"
    """A bar, hair or scratch."""
    REFERENCE_DUST = "dust in the reference"
    """The frame itself does not show it: dust that darkens the reference has gone."""
    OUT_OF_SIGHT = "almost all of it lies outside the image or in a hole"
    """Too little of its area is visible to call it a disk."""
    NO_RIM = "no rim: the brightness hardly falls across its edge"
    """A wide disk without an edge: uneven illumination."""
    INVISIBLE = "not seen: hardly brighter inside than around it"
    """The mean inside exceeds that of its surroundings by less than a quarter of its contrast (for dark
    contacts: falls short of it)."""
    SCRATCH = "piece of a scratch"
    """It fits badly and is far longer than wide."""
    CHAIN = "one of several faint specks side by side"
    """Far narrower than the blur and hardly above the noise, beside another such speck: a piece of a ring, a
    reflection, or other light wider than they are."""
    UNNECESSARY = "not needed to explain the pixels"
    """The fit describes the pixels as well without it."""
    BY_HAND = "excluded by hand"
    """A line of edits.csv says that it is no contact; its light is still taken into account."""
