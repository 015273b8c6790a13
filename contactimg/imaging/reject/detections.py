"""What a method found: contacts, and candidates that are none, each with its reason."""

from dataclasses import dataclass

from numpy.typing import NDArray

from contactimg.imaging.profile.optics import SharedOptics


@dataclass(frozen=True, eq=False)
class Fitted:
    """The contacts of a frame, and what they share.

    Parameters
    ----------
    contacts : dict of arrays
        Columns x_px, y_px, radius_px, radius_std_px, contrast_shift_px, blur_shift_px, flags.
    rejected : dict of arrays
        Columns x_px, y_px, radius_px, reason.
    optics : SharedOptics
        Contrast and blur that the radii stand for.
    own : SharedOptics
        The same with the uncertainties that the frame alone would leave.
    smallest_px : float
        Radius of a contact that just stands out of the noise; NaN if that is not known.
    """

    contacts: dict[str, NDArray]
    rejected: dict[str, NDArray]
    optics: SharedOptics
    own: SharedOptics
    smallest_px: float = float("nan")
