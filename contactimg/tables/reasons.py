"""Reasons of rejection: what the column ``reason`` of ``rejected.csv`` can say."""

import enum


class Reason(enum.StrEnum):
    """Why a candidate is not a contact."""

    NOISE = "noise"
    """The summed light of its pixels does not stand out of the noise."""
    HOT_PIXEL = "hot pixel"
    """One or two pixels whose neighbours are much darker than any optics could make them."""
    TOO_SHARP = "hot pixel or streak: sharper than the optics"
    """A narrow object whose brightest pixel stands far above the pixels on both sides of it."""
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
    """One of a chain of small disks between which the image does not fall: a line or an arc."""
    UNNECESSARY = "not needed to explain the pixels"
    """The fit describes the pixels as well without it."""
    BY_HAND = "excluded by hand"
    """A line of edits.csv says that it is no contact; its light is still taken into account."""
