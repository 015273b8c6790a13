"""How a frame of a series is turned into a view of the background."""

import hashlib
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.frame import Frame
from contactimg.imaging.background.pooled.rims import Rims, RimSums
from contactimg.imaging.background.pooled.views import Placement, View, to_anchor, view_background
from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.film_rim import Rim, rim_table
from contactimg.pipeline.frame import FrameOptions
from contactimg.pipeline.measured_frame import MeasuredFrame

HIDDEN_PX = 5.0
"""Margin around what a frame hides: three and a half blur widths of the usual optics. Chosen by hand."""


@dataclass(frozen=True, eq=False)
class Look:
    """How a frame is turned into a view of the background.

    Parameters
    ----------
    placement : Placement
    disks : ndarray, shape (n, 4)
        x, y, radius (px), relative contrast of the contacts to divide out.
    radius_std : ndarray, shape (n,)
    hidden : ndarray, shape (m, 3)
        x, y, radius (px) of what cannot be divided out.
    blur : float
        Standard deviation of the profile's Gaussian, pixel included; NaN without contacts to divide out.
    digest : bytes
        Of the pixels.
    film : Rim or None
        Around the contacts, where they were fitted with it.
    """

    placement: Placement
    disks: NDArray[np.float64]
    radius_std: NDArray[np.float64]
    hidden: NDArray[np.float64]
    blur: float
    digest: bytes = b""
    film: Rim | None = None

    def rims(self, shape: tuple[int, int]) -> Rims:
        """The contacts on the anchor."""
        x, y = to_anchor(self.disks[:, 0], self.disks[:, 1], self.placement.alignment, shape)
        contrast = float(self.disks[0, 3]) if len(self.disks) else 1.0
        blur = self.blur if np.isfinite(self.blur) else 1.0
        return Rims(x, y, self.disks[:, 2], self.radius_std, contrast, blur)

    def with_contacts_hidden(self) -> "Look":
        """The same with the contacts left out instead of divided out."""
        margin = np.array([0.0, 0.0, HIDDEN_PX])
        hidden = np.concatenate([self.hidden, self.disks[:, :3] + margin])
        return replace(self, disks=self.disks[:0], radius_std=self.radius_std[:0], hidden=hidden)


@dataclass(frozen=True, eq=False)
class OwnView:
    """What a frame itself contributed to the pooled background."""

    number: int
    look: Look
    used: NDArray[np.bool_]
    light: NDArray[np.float32]
    correction: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contribution:
    """The view of a frame and its part in the equations of the radii."""

    view: View
    sums: RimSums


def is_measured(part: MeasuredFrame) -> bool:
    """Whether a frame shows a background."""
    return part.shape is not None and not pd.isna(part.row["n_contacts"]) and part.level > 0


def look_of(part: MeasuredFrame, options: FrameOptions) -> Look:
    """The contacts of a frame, to be divided out if their optics are known, else to be left out."""
    contacts, optics = part.contacts, part.own_optics
    places = contacts[["x_px", "y_px", "radius_px"]].to_numpy(float)
    rejected = part.tables.rejected[["x_px", "y_px", "radius_px"]].to_numpy(float)
    hidden = rejected[np.isfinite(rejected).all(axis=1)] + np.array([0.0, 0.0, HIDDEN_PX])
    known = optics is not None and np.isfinite([optics.blur_px, optics.contrast]).all() and part.level > 0
    contrast = np.sign(part.row["contrast"]) * optics.contrast / part.level if known and optics else np.nan
    blur = float(np.sqrt(optics.blur_px**2 + PIXEL_VARIANCE)) if known and optics else np.nan
    disks = np.column_stack([places, np.full(len(places), contrast)])
    std = np.nan_to_num(contacts["radius_std_px"].to_numpy(float), nan=1.0)
    placement = Placement.unknown()
    taken = options.film is not None and part.film is not None and part.film.taken
    look = Look(
        placement, disks, std, hidden, blur, film=options.film.rim if taken and options.film else None
    )
    described = known and options.scene.measure.method == "disk" and (optics is None or optics.halo is None)
    return look if described else look.with_contacts_hidden()


def divide_contacts_out(image: NDArray[np.float32], look: Look) -> NDArray[np.float32]:
    """The image divided by the light of its contacts."""
    if not len(look.disks):
        return image
    table = None if look.film is None else rim_table(look.film, look.blur)
    model = render_disks(look.disks, look.blur, (image.shape[0], image.shape[1]), profile=table)
    return np.asarray(image / np.maximum(1.0 + model, np.float32(0.05)), np.float32)


def view_of(image: NDArray, look: Look) -> View:
    """The view of a frame."""
    flat = divide_contacts_out(np.asarray(image, np.float32), look)
    return view_background(flat, look.placement, look.hidden)


def contribute_view(
    frame: Frame,
    _reference: NDArray | None,
    own: OwnView,
    *,
    brightness: NDArray[np.float32],
) -> Contribution:
    """View of a frame in which the slow light is corrected and only the squares used are seen."""
    view = view_of(frame.image, own.look).restricted(own.used, own.light)
    return Contribution(
        view, RimSums.of(own.look.rims(view.image.shape), view.image, brightness, view.seen > 0)
    )


def digest_of(image: NDArray) -> bytes:
    """Of the pixels: a copy of a frame has the same noise."""
    return hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()
