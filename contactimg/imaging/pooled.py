"""A background pooled from several frames, or the mean of several references.

Each place is taken from the frames that show it.

In: frames, an anchor image (the reference, say) and the contacts of the frames. Out: sums, from which the
background for each frame follows without that frame itself: its own noise would cancel in the difference.

A contact multiplies the background by its light, so a frame divided by the light of its contacts shows the
background under them as well, as far as their radii are known: an error of a radius leaves a ring. Rings and
background follow together from least squares over all frames. With the views ``b_k = s + T_k d_k`` of the
background ``s``, templates ``T_k`` of the rims and corrections ``d_k`` of the radii, ``s`` is the mean
of the ``n`` corrected views, and ``T_k' T_k d_k - sum over l of T_k' T_l d_l / n = T_k' (b_k - mean of b)``.
What the unknown background adds to the variance of a radius follows from how many views show its rim without
such a rim of their own.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from contactimg.imaging.background.alignment import (
    Alignment,
    filter_rows_and_columns,
    move_image,
    move_mask,
    shift_kernel,
)
from contactimg.imaging.background.divide import FULL_DIRT_SIGMA
from contactimg.imaging.background.find_illumination import BackgroundLevel
from contactimg.imaging.background.illumination import DARKEST_FRACTION, Illumination
from contactimg.imaging.background.subtract import subtract_reference
from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.pixels.blocks import block_means, to_pixels
from contactimg.imaging.pixels.field_of_view import EDGE_REACH_PX
from contactimg.imaging.pixels.frame_pair import FramePair
from contactimg.imaging.pixels.masks import Flags, Values, mean_of_seen, nearest_pixels
from contactimg.imaging.pixels.robust import (
    AGREEMENT_SIGMA,
    CLIP_SIGMA,
    ROUGH_RATIO,
    SOME,
    finite_values,
    robust_std,
)
from contactimg.imaging.profile.blurred_disk import disk_table, look_up
from contactimg.imaging.profile.film_rim import FilmRim, rim_table
from contactimg.imaging.profile.limits import FIT_BLUR_WIDTHS, LEAST_FRACTION, LEAST_VISIBLE, SAME_PLACE_RADII

SQUARE_PX = 4
"""Side of the squares on which frames are compared, and radius around a place that no frame shows from which
it is filled. Chosen: as wide as the blurred rim of a contact."""
LIGHT_PX = 64
"""Standard deviation of the Gaussian over which slow differences of the light are followed, twice the side
of the square over which the brightness of the anchor is averaged. Chosen: much wider than a contact, narrower
than the cubic that describes the light of a frame."""
UNSEEN_VIEWS = 0.1
"""Views that a place is worth which none shows, or none without a rim of its own. Chosen: texture of 2 %
behind a blur of 1.4 px, filled in, counts ten times the noise of a pixel; the prior of radii gives 0.08."""
RIM_POINTS = 24
"""Points of a rim at which the number of views is looked up. Chosen: one each 2 px on the usual contacts."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts of a frame, whose light is divided out, and what else it shows besides the background.

    Parameters
    ----------
    disks : ndarray, shape (n, 4)
        x, y, radius and its standard uncertainty (px) of the contacts to divide out.
    hidden : ndarray, shape (m, 3)
        x, y, radius (px) of what cannot be divided out.
    contrast : float
        Light of a contact relative to the background, negative for dark ones.
    blur : float, px
        Standard deviation of the profile's Gaussian, pixel included.
    film : FilmRim or None
        Around the contacts, where they were fitted with it.
    """

    disks: NDArray[np.float64]
    hidden: NDArray[np.float64]
    contrast: float = 1.0
    blur: float = 1.0
    film: FilmRim | None = None

    def left_out(self) -> "Contacts":
        """The view with the disks left out instead of divided out."""
        return replace(self, disks=self.disks[:0], hidden=np.concatenate([self.hidden, self.disks[:, :3]]))

    def divided_out(self, image: NDArray) -> Values:
        """The image divided by the light of the disks."""
        if not len(self.disks):
            return np.asarray(image, np.float32)
        table = None if self.film is None else rim_table(self.film, self.blur)
        disks = np.column_stack([self.disks[:, :3], np.full(len(self.disks), self.contrast)])
        model = render_disks(disks, self.blur, (image.shape[0], image.shape[1]), profile=table)
        return np.asarray(image / np.maximum(1.0 + model, np.float32(DARKEST_FRACTION)), np.float32)

    def moved(self, alignment: Alignment, shape: tuple[int, ...]) -> "Contacts":
        """The disks in the coordinates of the anchor, for the alignment of the frame against it."""
        matrix, offset = alignment.to_reference((shape[0], shape[1]))
        places = self.disks[:, :2] @ matrix.T + offset
        return replace(self, disks=np.column_stack([places, self.disks[:, 2:]]))

    def templates(self, brightness: Values, used: Flags) -> sparse.csc_array:
        """Change of the view per pixel of radius, a column a contact.

        Parameters
        ----------
        brightness : ndarray, shape (rows, columns)
            Of the background, smooth, grey levels.
        used : ndarray of bool, same shape
            Where the view is used.
        """
        x, y, radius, _ = self.disks.T
        half = np.ceil(radius + FIT_BLUR_WIDTHS * self.blur).astype(np.int64)
        side = 2 * half + 1
        contact = np.repeat(np.arange(len(x)), side**2)
        number = np.arange(len(contact)) - np.repeat(np.cumsum(side**2) - side**2, side**2)
        px = (np.rint(x).astype(np.int64) - half)[contact] + number % side[contact]
        py = (np.rint(y).astype(np.int64) - half)[contact] + number // side[contact]
        r, a, s = np.hypot(px - x[contact], py - y[contact]), radius[contact], self.blur
        inside = (px >= 0) & (py >= 0) & (px < used.shape[1]) & (py < used.shape[0])
        near = (np.abs(r - a) < FIT_BLUR_WIDTHS * s) & inside
        near[near] = used[py[near], px[near]]
        contact, px, py, r, a = (part[near] for part in (contact, px, py, r, a))
        covered, slope = look_up(disk_table().values, r[:, None], a[:, None], s, 2)[..., 0]
        value = brightness[py, px] * self.contrast * (slope / s) / (1.0 + self.contrast * covered)
        at = (py * used.shape[1] + px, contact)
        return sparse.csc_array((value.astype(np.float32), at), (used.size, len(x)))


@dataclass(frozen=True, eq=False)
class View:
    """The background as one frame shows it.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
        The frame in the coordinates and in the light of the anchor, grey levels.
    seen : ndarray of uint8, shape (rows, columns)
        1 where it shows background.
    """

    image: Values
    seen: NDArray[np.uint8]

    @classmethod
    def plain(cls, image: NDArray) -> "View":
        """The view of an image without contacts; non-finite pixels are holes."""
        finite = np.isfinite(image)
        return cls(np.where(finite, image, 0.0).astype(np.float32), finite.astype(np.uint8))

    def restricted(self, used: Flags, light: Values) -> "View":
        """Seen only in the squares that are used, and corrected for its slow light (`Agreement`)."""
        slow = to_pixels(light, self.image.shape, side=SQUARE_PX, interpolation=cv2.INTER_LINEAR)
        # the neighbours of what is left out are left out too
        good = cv2.erode(used.astype(np.uint8), np.ones((3, 3), np.uint8))
        return View(self.image - slow, self.seen & to_pixels(good, self.image.shape, side=SQUARE_PX))

    def squares(self) -> Values:
        """Means over squares of `SQUARE_PX`; NaN where the frame shows too little of a square."""
        enough = block_means(self.seen.astype(np.float32), side=SQUARE_PX) >= LEAST_VISIBLE
        return np.where(enough, block_means(self.image, self.seen, side=SQUARE_PX), np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class Placement:
    """The place of a frame on the anchor, and its light relative to it.

    Parameters
    ----------
    alignment : Alignment
        Of the frame against the anchor; no shift where the images do not determine it.
    illumination : Illumination
        Ratio frame/anchor of the background.
    """

    alignment: Alignment
    illumination: Illumination

    @classmethod
    def of(
        cls, image: NDArray, anchor: NDArray, *, background_is: BackgroundLevel, registered: bool = False
    ) -> "Placement | None":
        """Find where a frame lies on the anchor and how its light differs.

        Parameters
        ----------
        image, anchor : ndarray, shape (rows, columns)
            Grey levels; non-finite pixels are holes.
        background_is : BackgroundLevel
            Which level is background.
        registered : bool
            No shift is looked for.

        Returns
        -------
        Placement or None
            None if the frame shows nothing or another surface than the anchor, as far as that has any
            texture, or the anchor is too dark to divide by.
        """
        pair = FramePair.of(image, anchor, None)
        if pair.trivial or pair.reference is None:
            return None
        difference = subtract_reference(
            pair.frame, pair.reference, valid=pair.valid, background_is=background_is, registered=registered
        )
        if difference is None or difference.alignment is None or difference.registration_failed:
            return None
        return cls(difference.alignment, difference.illumination)

    def view(self, image: NDArray, hidden: NDArray[np.float64]) -> View:
        """The image outside hidden disks (x, y, radius, px), as the anchor would show it."""
        shape, finite = (image.shape[0], image.shape[1]), np.isfinite(image)
        seen, bits = finite.astype(np.uint8), 4
        for disk in np.rint(np.asarray(hidden) * 2**bits).astype(int).tolist():
            cv2.circle(seen, disk[:2], disk[2], 0, cv2.FILLED, cv2.LINE_8, bits)
        flat = np.asarray(image, np.float32) / self.illumination.ratio_at_rows(np.arange(shape[0]), shape)
        if not finite.all():
            flat = np.where(finite, flat, np.float32(np.median(flat[finite])))
        back = _inverse(self.alignment)
        return View(_move(np.asarray(flat, np.float32), back), move_mask(seen, back))


@dataclass(frozen=True, eq=False)
class PlacedFrame:
    """The steps that turn a frame into its view of the background.

    Parameters
    ----------
    contacts : Contacts
    placement : Placement or None
        None for the anchor itself.
    digest : bytes
        Of the pixels: a copy of a frame has the same noise.
    used, light : ndarray or None
        Of the `Agreement`, once it is known.
    """

    contacts: Contacts
    placement: Placement | None
    digest: bytes
    used: Flags | None = None
    light: Values | None = None

    @classmethod
    def seen(
        cls, image: NDArray, contacts: Contacts | None = None, placement: Placement | None = None
    ) -> tuple["PlacedFrame", Values]:
        """An image on the anchor, and the means over squares of what it shows; the anchor has no contacts."""
        own = cls(contacts or Contacts(np.empty((0, 4)), np.empty((0, 3))), placement, digest_of(image))
        return own, own.view(image).squares()

    def corrected(self, correction: NDArray[np.float64]) -> "PlacedFrame":
        """The frame with corrections of its radii, px."""
        disks = self.contacts.disks + np.outer(correction, [0.0, 0.0, 1.0, 0.0])
        return replace(self, contacts=replace(self.contacts, disks=disks))

    def view(self, image: NDArray) -> View:
        """The view of the image, its slow light corrected and only where it is used."""
        hidden = self.contacts.hidden + np.array([0.0, 0.0, EDGE_REACH_PX])
        flat = self.contacts.divided_out(image)
        view = View.plain(flat) if self.placement is None else self.placement.view(flat, hidden)
        return view if self.used is None or self.light is None else view.restricted(self.used, self.light)

    def on_anchor(self, shape: tuple[int, ...]) -> Contacts:
        """Its contacts in the coordinates of the anchor."""
        placement = self.placement
        return self.contacts if placement is None else self.contacts.moved(placement.alignment, shape)


def digest_of(image: NDArray) -> bytes:
    """A digest of the pixels."""
    return hashlib.blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()


# --- where the views agree


@dataclass(frozen=True, eq=False)
class Agreement:
    """The squares in which the views agree: overlooked contacts, dirt and bad frames stand out.

    Parameters
    ----------
    used : ndarray of bool, shape (views, square rows, square columns)
        Whether a view is used in a square.
    light : ndarray of float32, same shape
        By how much a view is brighter than the others, slowly varying; grey levels.
    deviation : ndarray of float32, same shape
        Of the squares of a view, its light corrected, from the median of the views; NaN where not seen.
    pixel_noise : float
        Standard deviation of a pixel of a view, from the scatter of the squares.
    """

    used: Flags
    light: Values
    deviation: Values
    pixel_noise: float

    @property
    def left_out(self) -> Flags:
        """Views that do not agree with the others as a whole."""
        return np.asarray(~self.used.any(axis=(1, 2)))

    def scatter_inside(self, contacts: Contacts, *, view: int) -> float:
        """Scatter of a view in the squares of its contacts (on the anchor), over that in the others."""
        near, known = self._squares_of(contacts), np.isfinite(self.deviation[view])
        inside, outside = self.deviation[view][known & near], self.deviation[view][known & ~near]
        if min(len(inside), len(outside)) < SOME:
            return 0.0
        return robust_std(inside, centre=0.0) / max(robust_std(outside, centre=0.0), 1e-9)

    def _squares_of(self, contacts: Contacts) -> Flags:
        """The squares of contacts (on the anchor) and their surroundings."""
        here = np.zeros([SQUARE_PX * size for size in self.used.shape[1:]], np.uint8)
        for x, y, radius in np.rint(contacts.disks[:, :3]).astype(int).tolist():
            cv2.circle(here, (x, y), radius + int(EDGE_REACH_PX), 1, cv2.FILLED)
        return np.asarray(block_means(here, side=SQUARE_PX) > LEAST_VISIBLE)


def compare_views(squares: Sequence[Values], *, sign: int) -> Agreement:
    """Compare what the frames of a series show of the background.

    Parameters
    ----------
    squares : sequence of ndarray, shape (square rows, square columns)
        `View.squares` of each.
    sign : int
        1 if contacts are brighter than the background, else -1: where views differ, contacts that were
        overlooked show in the brighter (darker) ones.
    """
    views = np.stack(squares)
    views[:, np.isnan(views).all(axis=0)] = 0.0
    light = np.stack([_slow(view) for view in views - np.nanmedian(views, axis=0)])
    flat = views - light
    deviation = flat - np.nanmedian(flat, axis=0)
    shown = [finite_values(part) for part in deviation]
    scatter = np.array([robust_std(part, centre=0.0) if part.size else np.inf for part in shown])
    usual = float(np.median(scatter[np.isfinite(scatter)])) if np.isfinite(scatter).any() else 0.0
    good = (scatter <= ROUGH_RATIO * usual)[:, None, None]
    ordered = np.sort(np.where(good, sign * flat, np.float32(np.nan)), axis=0)  # NaN last
    second_lowest = np.where(np.isfinite(ordered[2:3]).any(axis=0), ordered[:2][-1], ordered[0])
    # of 24 normal deviates the second lowest lies 1.6 below the mean: 10^-5 of the squares are left out
    used = ~(np.abs(sign * flat - second_lowest) > FULL_DIRT_SIGMA * usual)
    return Agreement(used & good, light, deviation, SQUARE_PX * usual)


def _slow(image: Values) -> Values:
    """The image, NaN where it is not known, blurred by `LIGHT_PX`; outliers count little."""
    known = np.isfinite(image)
    if not known.any():
        return np.zeros(image.shape, np.float32)
    middle, limit = np.float32(np.median(image[known])), CLIP_SIGMA * robust_std(image[known]) + 1e-6
    blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=LIGHT_PX / SQUARE_PX, borderType=cv2.BORDER_REFLECT)
    mean, weight = mean_of_seen(blur, np.clip(image, middle - limit, middle + limit), known)
    return np.where(weight > 1e-2, mean, middle).astype(np.float32)


# --- their mean


@dataclass(frozen=True, eq=False)
class PooledBackground:
    """Sums of the views of a background, from which the mean of all but one follows.

    Parameters
    ----------
    total : ndarray of float32, shape (rows, columns)
        Sum of the views that show a pixel, grey levels.
    count : ndarray of int16, shape (rows, columns)
        How many do.
    """

    total: Values
    count: NDArray[np.int16]

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> "PooledBackground":
        """The sums without any view."""
        return cls(np.zeros(shape, np.float32), np.zeros(shape, np.int16))

    def plus(self, view: View, weight: int = 1) -> "PooledBackground":
        """The sums with one view more, which counts like ``weight`` views; -1 takes it out again."""
        seen = view.seen.astype(np.int16) * np.int16(weight)
        return PooledBackground(self.total + view.image * seen, self.count + seen)

    def without_rings(self, templates: sparse.csc_array, correction: NDArray) -> "PooledBackground":
        """The sums without the rings that the errors of the radii of one view leave; minus: with them."""
        rings = (templates @ correction.astype(np.float32)).reshape(self.total.shape)
        return replace(self, total=(self.total - rings).astype(np.float32))

    def mean(self) -> Values:
        """The background; where no view shows it, what surrounds the place."""
        image = np.asarray(self.total / np.maximum(self.count, 1), np.float32)
        unknown = (self.count == 0).astype(np.uint8)
        if not unknown.any():
            return image
        return np.asarray(cv2.inpaint(image, unknown, SQUARE_PX, cv2.INPAINT_TELEA), np.float32)

    def views_at(self, x: NDArray, y: NDArray, radius: NDArray) -> NDArray[np.float64]:
        """Number of views at each rim (px on the anchor): the harmonic mean over its points."""
        angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        x, y = (z[:, None] + radius[:, None] * part for z, part in ((x, np.cos(angles)), (y, np.sin(angles))))
        count = self.count[nearest_pixels(x, y, self.count.shape)]
        return np.asarray(1.0 / np.mean(1.0 / np.maximum(count, UNSEEN_VIEWS), axis=1))


def smooth_brightness(anchor: NDArray) -> Values:
    """The anchor without its detail, grey levels."""
    window = (LIGHT_PX // 2 + 1, LIGHT_PX // 2 + 1)
    known = np.isfinite(anchor)
    return mean_of_seen(lambda part: cv2.blur(part, window), np.asarray(anchor, np.float32), known)[0]


def average_references(images: Sequence[NDArray]) -> tuple[Values, list[int]]:
    """Register references on the first of them and average them, without those that differ from the others.

    Parameters
    ----------
    images : sequence of ndarray, shape (rows, columns)
        At least two, of equal shape; grey levels, non-finite pixels are holes.

    Returns
    -------
    mean : ndarray of float32, shape (rows, columns)
        In the coordinates and in the light of the first.
    left_out : list of int
        Numbers of the references that differ from the others as a whole or in many places.
    """
    first, copies = images[0], {k for k, image in enumerate(images) if k and np.array_equal(image, images[0])}
    views = {0: View.plain(first)}
    for number in set(range(1, len(images))) - copies:
        placement = Placement.of(images[number], first, background_is="most_common")
        if placement is not None:
            views[number] = placement.view(images[number], np.empty((0, 3)))
    agreement = compare_views([view.squares() for view in views.values()], sign=1)
    # Chosen: three times what dust and chance make; a contact of 30 px on a megapixel makes as many.
    differs = (~agreement.used & np.isfinite(agreement.deviation)).mean(axis=(1, 2)) > 0.003
    pooled, used = PooledBackground.empty(first.shape), set(copies)
    for k, (number, view) in enumerate(views.items()):
        if not differs[k] or differs.all():
            pooled = pooled.plus(view.restricted(agreement.used[k], agreement.light[k]))
            used.add(number)
    return pooled.mean(), [k for k in range(len(images)) if k not in used]


# --- radii and background together


@dataclass(frozen=True, eq=False)
class RimSums:
    """Sums that one view adds to the equations of the radii.

    Parameters
    ----------
    templates : sparse array, shape (pixels, n)
    products : ndarray, shape (n,)
        Of the templates with the view, minus the brightness of the anchor.
    prior : ndarray, shape (n,)
        Inverse variance of each correction beforehand, px^-2: as far as two measures of a radius agree.
    """

    templates: sparse.csc_array
    products: NDArray[np.float64]
    prior: NDArray[np.float64]

    @classmethod
    def of(cls, contacts: Contacts, view: View, brightness: Values) -> "RimSums":
        """The sums of a view with these contacts on the anchor."""
        templates = contacts.templates(brightness, view.seen > 0)
        products = templates.T @ (view.image - brightness).ravel().astype(np.float64)
        return cls(templates, products, 1.0 / np.maximum(AGREEMENT_SIGMA * contacts.disks[:, 3], 1e-3) ** 2)


def correct_radii(
    views: Sequence[RimSums], pooled: PooledBackground, brightness: Values, *, noise: float
) -> list[NDArray[np.float64]]:
    """Corrections of the radii of each view from all views together, px.

    Parameters
    ----------
    views : sequence of RimSums
    pooled : PooledBackground
        Sums of the views and of other images.
    brightness : ndarray, shape (rows, columns)
        As given to `RimSums.of`.
    noise : float
        Standard deviation of a pixel of a view, grey levels.
    """
    sizes = [len(view.products) for view in views]
    if not sum(sizes):
        return [np.zeros(size) for size in sizes]
    templates = sparse.hstack([view.templates for view in views], format="csc").astype(np.float64)
    share = sparse.diags_array(1.0 / np.maximum(pooled.count.ravel(), 1).astype(np.float64))
    own = sparse.block_diag([view.templates.T @ view.templates for view in views], format="csr")
    prior = noise**2 * np.concatenate([view.prior for view in views])
    matrix = (own - templates.T @ (share @ templates) + sparse.diags_array(prior)).tocsr()
    shown = templates.T @ (pooled.mean() - brightness).ravel()
    right = np.concatenate([view.products for view in views]) - shown
    scale = sparse.diags_array(1.0 / np.maximum(matrix.diagonal(), 1e-12))
    solution, _ = cg(matrix, right, rtol=LEAST_FRACTION, maxiter=500, M=scale)
    return np.split(solution, np.cumsum(sizes)[:-1])


def excess_variance(
    contacts: Contacts, views_at_rim: NDArray[np.float64], others: Sequence[Contacts]
) -> NDArray[np.float64]:
    """The share that the uncertainty of the background adds to the variance of each radius.

    Parameters
    ----------
    contacts : Contacts
        Of a frame, on the anchor.
    views_at_rim : ndarray, shape (n,)
        Number of other views at their rims.
    others : sequence of Contacts
        Of the other views, on the anchor.

    Returns
    -------
    ndarray, shape (n,)
        ``1/n`` for ``n`` views of the rim, of which a view with the same rim, whose radius is not known
        either, counts none and one with a similar rim in part.

    Examples
    --------
    >>> def at(*radii):
    ...     disks = np.array([[20.0 * k, 0.0, a, 0.1] for k, a in enumerate(radii)])
    ...     return Contacts(disks, np.empty((0, 3)), 1.0, 1.4)
    >>> excess_variance(at(5, 5), np.array([4.0, 3.0]), [at(90, 5), at(90, 5)]).round(2).tolist()
    [0.25, 1.0]

    Where rims of all views cover the pixels, little more than the prior is known of the radius:

    >>> excess_variance(at(5), np.array([0.2]), [at(5)] * 5).round(1).tolist()
    [10.0]
    """
    radius, same = contacts.disks[:, 2], np.zeros(len(contacts.disks))
    for other in others:
        if len(other.disks) and len(radius):
            distance, nearest = cKDTree(other.disks[:, :2]).query(contacts.disks[:, :2])
            found = other.disks[nearest, 2]
            near = distance < SAME_PLACE_RADII * np.maximum(found, radius)
            same += near * np.exp(-((found - radius) ** 2) / (4 * contacts.blur**2))
    return 1.0 / np.maximum(views_at_rim - same, UNSEEN_VIEWS)


def _inverse(alignment: Alignment) -> Alignment:
    """The alignment of the anchor against the frame.

    Examples
    --------
    >>> both = _inverse(Alignment(1.0, 2.0, 0.1, 0.3, 1.1)).after(Alignment(1.0, 2.0, 0.1, 0.3, 1.1))
    >>> [abs(round(value, 9)) for value in (both.x_px, both.y_px, both.rotation, both.scale)]
    [0.0, 0.0, 0.0, 1.0]
    """
    turn, scale = -alignment.rotation, 1.0 / alignment.scale
    shift = -scale * complex(alignment.x_px, alignment.y_px) * np.exp(1j * turn)
    return replace(alignment, x_px=float(shift.real), y_px=float(shift.imag), rotation=turn, scale=scale)


def _move(image: Values, alignment: Alignment) -> Values:
    """The image moved, with its noise nearly white."""
    if not alignment.is_shift:
        return move_image(image, alignment)
    columns, rows = round(alignment.x_px), round(alignment.y_px)
    whole = replace(alignment, x_px=float(columns), y_px=float(rows))
    moved = move_image(image, whole, interpolation=cv2.INTER_NEAREST)
    left = alignment.x_px - columns, alignment.y_px - rows
    return moved if left == (0.0, 0.0) else filter_rows_and_columns(moved, *map(shift_kernel, left))
