"""What the ladder of shapes sees: the fitted frame, the groups in which it asks, and their windows."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from contactimg.imaging.contrast.noise import RADII, Noise, NoiseCorrelation
from contactimg.imaging.count.free_shape import find_component
from contactimg.imaging.fit.disks import render_disks
from contactimg.imaging.fit.ellipse import CommonOptics, Window
from contactimg.imaging.fit.problem import RADIUS, FitProblem, X, Y
from contactimg.imaging.fit.quality import FrameFit
from contactimg.imaging.fit.shared_optics import JointFit
from contactimg.imaging.judge.noise_inside import gain_of_texture, noise_of_insides
from contactimg.imaging.judge.second_opinion import AreaNoise
from contactimg.imaging.judge.shape_calls import OVERLAP_BLUR_WIDTHS, OVERLAP_SHARE, usual_chi_square
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.pixels.masks import exclude
from contactimg.imaging.profile.blurred_disk import END_BLUR_WIDTHS, INNER_BLUR_WIDTHS
from contactimg.imaging.reject.scratches import find_chains
from contactimg.imaging.detect.overlap import find_overlaps

WINDOW_MARGIN_BLUR_WIDTHS = 4.0
"""Of a window about what it shows. Theory: a blurred edge is 3e-5 there."""
FIRST_MARGIN_BLUR_WIDTHS = 5.5
"""Of the first look for the pixels of a contact about its disks. Chosen: doubled where too small."""
MOST_DOUBLINGS = 3
"""Looks with twice the margin. Chosen: a contact eight times as long as its disks is none."""
OTHERS_REACH_BLUR_WIDTHS = 2.0
"""Pixels closer than that to another contact, and closer than to one's own, are not one's own. Chosen."""
CALLED_OVERLAP_BLUR_WIDTHS, CALLED_OVERLAP_SHARE = 0.3, 0.14
"""The same for two disks that both fit badly. Chosen: disks along a ring overlap by 0.15 to 0.2 radii."""
BAD_CHI_SQUARE = 2.8
"""Mean squared residual, over the usual one, of two disks that any overlap makes one contact. Chosen: few
of the disks of touching beads exceed it."""
LARGEST_GROUP = 60
"""Disks of the largest group that may be one contact. Chosen: a ring 60 times as long as wide."""
FEWEST_OF_REGION, CALLED_SHARE = 3, 0.5
"""Disks of a region, and the share of them that must call, for it to be asked as one contact. Chosen: of
disks that touch few call."""
TOUCHING_BLUR_WIDTHS = 1.0
"""Gap between disks that may be pieces of one contact. Chosen: no level line at half height parts them."""
CHAIN_CALLED_SHARE = 0.8
"""Share of the disks along a ring that must call. Chosen: contacts that touch about a gap fit as disks."""
SMOOTHED_CONTRAST_TO_NOISE = 12.0
"""Below, the image is smoothed before its pixels are connected. Chosen: twice six standard deviations."""


@dataclass(frozen=True, eq=False)
class ShapeScene:
    """A fitted frame, in pixels of the fit.

    Parameters
    ----------
    problem : FitProblem
    image : ndarray of float32, shape (rows, columns)
        Without the film and whatever else the profile of a contact has beyond a blurred disk.
    disks : ndarray, shape (n, 4)
    chi_square : ndarray, shape (n,)
    optics : CommonOptics
    correlation : NoiseCorrelation
    gain : float
        By which a contact makes what neighbouring pixels share, the texture, brighter.
    """

    problem: FitProblem
    image: NDArray[np.float32]
    disks: NDArray[np.float64]
    chi_square: NDArray[np.float64]
    optics: CommonOptics
    correlation: NoiseCorrelation
    gain: float

    @classmethod
    def of(cls, frame_fit: FrameFit, joint: JointFit) -> "ShapeScene":
        """From the fit of a frame and of its contrast and blur."""
        problem, fit = frame_fit.problem, frame_fit.fit
        image, shape = problem.image, problem.image.shape
        if problem.profile.outer > INNER_BLUR_WIDTHS or not len(problem.profile.powers):
            plain, full = (
                render_disks(fit.disks, fit.blur, shape, profile=edge) for edge in (None, problem.profile)
            )
            image = image - (full - plain)
        optics = CommonOptics(joint.contrast, joint.spread, fit.blur, joint.covariance)
        noise = noise_of_insides(problem, fit)
        gain = gain_of_texture(problem.noise, noise, joint.correlation)
        problem = replace(problem, noise=noise)
        return cls(problem, image, fit.disks, fit.chi_square, optics, joint.correlation, gain)

    @cached_property
    def area_noise(self) -> AreaNoise:
        """Noise of sums over pixels."""
        return AreaNoise.of(self.image, self.problem.background, self.problem.pixel_noise)

    def without_others(self, box: tuple[slice, slice], members: NDArray[np.intp]) -> NDArray[np.float32]:
        """The image in a window, with all disks but some subtracted."""
        part, corner = self.image[box], np.array([box[1].start, box[0].start, 0.0, 0.0])
        disks, reach = self.disks - corner, self.disks[:, RADIUS] + END_BLUR_WIDTHS * self.optics.blur
        rows, columns = part.shape
        near = (disks[:, X] > -reach) & (disks[:, X] < columns + reach)
        near &= (disks[:, Y] > -reach) & (disks[:, Y] < rows + reach)
        near[members] = False
        return part - render_disks(disks[near], self.optics.blur, part.shape)

    def inflation(self, radius: float) -> float:
        """Factor of the variance of a rim of this radius for noise that pixels share."""
        return float(np.interp(np.log(max(radius, 1e-9) / self.optics.blur), *self._inflation_of_radii))

    @cached_property
    def _inflation_of_radii(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same at the radii between which it is interpolated: their logarithms in blur widths, and it."""
        return np.log(RADII), self.inflations(RADII * self.optics.blur)

    def inflations(self, radii: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same of rims of several radii."""
        return self.correlation.rim_inflation(
            radii, self.optics.blur, noise=self.problem.noise, gain=self.gain
        )

    def groups(self, called: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
        """Groups of disks that may be one contact each, those with a called member."""
        blur = self.optics.blur
        deep = find_overlaps(self.disks, OVERLAP_BLUR_WIDTHS * blur, OVERLAP_SHARE)
        near = find_overlaps(self.disks, CALLED_OVERLAP_BLUR_WIDTHS * blur, CALLED_OVERLAP_SHARE)
        any_overlap = find_overlaps(self.disks, 0.0, 0.0)
        bad = self.chi_square > BAD_CHI_SQUARE * usual_chi_square(self.chi_square)
        pairs = np.vstack([
            deep, near[called[near].all(axis=1)], any_overlap[bad[any_overlap].all(axis=1)],
            self._regions(any_overlap, called), self._closed_chains(called),
            *(np.column_stack([chain[:-1], chain[1:]])
              for chain in find_chains(self.image, self.disks, blur_px=blur)),
        ])  # fmt: skip
        labels = self._completed(_components(pairs, len(self.disks)), called)
        groups = [np.flatnonzero(labels == label) for label in np.unique(labels[called])]
        return [members for members in groups if len(members) <= LARGEST_GROUP]

    def _regions(self, touching: NDArray[np.intp], called: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Pairs that link the disks of each region in which most of them call."""
        labels = _components(touching, len(self.disks))
        size, calling = np.bincount(labels), np.bincount(labels, weights=called)
        asked = (size >= FEWEST_OF_REGION) & (calling >= CALLED_SHARE * size)
        return touching[asked[labels[touching[:, 0]]]] if len(touching) else touching

    def _completed(self, labels: NDArray[np.int32], called: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Groups with the disks that touch two of their members, which would take light from them."""
        touching = find_pairs(self.disks, 0.5 * TOUCHING_BLUR_WIDTHS * self.optics.blur)
        both = np.vstack([touching, touching[:, ::-1]])
        calling = np.bincount(labels, weights=called) > 0
        alone = np.bincount(labels)[labels] == 1
        disk, group = both[:, 0], labels[both[:, 1]]
        wanted = alone[disk] & ~alone[both[:, 1]] & calling[group]
        joined, count = np.unique(np.column_stack([disk, group])[wanted], axis=0, return_counts=True)
        labels = labels.copy()
        for number, label in joined[count > 1]:
            labels[number] = label
        return labels

    def _closed_chains(self, called: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Pairs that link the disks of each chain that closes about a hole, if most of them call.

        Disks along a narrow ring touch, but need not overlap.
        """
        blur, kept = self.optics.blur, [np.zeros((0, 2), np.intp)]
        touching = find_pairs(self.disks, 0.5 * TOUCHING_BLUR_WIDTHS * blur)
        touching = touching[called[touching].any(axis=1)]
        labels = _components(touching, len(self.disks))
        for label in np.unique(labels[touching[:, 0]]) if len(touching) else ():
            chain, pairs = self.disks[labels == label], touching[labels[touching[:, 0]] == label]
            away = np.hypot(*(chain[:, :2] - chain[:, :2].mean(axis=0)).T) - chain[:, RADIUS]
            closes = len(pairs) >= len(chain) >= FEWEST_OF_REGION and away.min() > blur
            if closes and np.mean(called[labels == label]) >= CHAIN_CALLED_SHARE:
                kept.append(pairs)
        return np.vstack(kept)

    def view(self, members: NDArray[np.intp]) -> "GroupView | None":
        """The window about a group of disks; None where its pixels cannot be told from the rest."""
        margin = FIRST_MARGIN_BLUR_WIDTHS * self.optics.blur
        for _ in range(MOST_DOUBLINGS):
            view = GroupView.of(self, members, margin)
            if view is None or view.complete:
                return view
            margin *= 2.0
        return None


@dataclass(frozen=True, eq=False)
class GroupView:
    """The pixels about a group of disks.

    Parameters
    ----------
    scene : ShapeScene
    members : ndarray of int
    window : Window
        With all other disks subtracted; pixels of theirs are not valid.
    component : ndarray of bool, shape of the window
        The group's own pixels above half height.
    complete : bool
        Whether they lie well inside the window, or at the border of the image.
    """

    scene: ShapeScene
    members: NDArray[np.intp]
    window: Window
    component: NDArray[np.bool_]
    complete: bool

    @classmethod
    def of(cls, scene: ShapeScene, members: NDArray[np.intp], margin: float) -> "GroupView | None":
        """With a margin (px) about the disks."""
        disks, problem, blur = scene.disks[members], scene.problem, scene.optics.blur
        box = _box(disks, margin, scene.image.shape)
        shape = scene.image[box].shape
        if not min(shape, default=0):
            return None
        corner = np.array([box[1].start, box[0].start, 0.0, 0.0])
        image = scene.without_others(box, members)
        brightness = float(np.median(problem.brightness_at(disks)))
        window = Window.of(problem, box, image, brightness)
        noisy = scene.optics.contrast < SMOOTHED_CONTRAST_TO_NOISE * problem.pixel_noise
        component = find_component(
            window.image, 0.5 * scene.optics.contrast, _cores(disks - corner, shape),
            smoothing=blur if noisy else 0.0,
        )  # fmt: skip
        if not component.any():
            return None
        window = replace(window, valid=_own_pixels(scene, members, window, component))
        reach = int(WINDOW_MARGIN_BLUR_WIDTHS * blur)
        near = cv2.dilate(component.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=reach)
        # a window that ends with the image cannot show more
        open_sides = (
            near[0].any() and box[0].start > 0, near[-1].any() and box[0].stop < scene.image.shape[0],
            near[:, 0].any() and box[1].start > 0, near[:, -1].any() and box[1].stop < scene.image.shape[1],
        )  # fmt: skip
        return cls(scene, members, window, component, not any(open_sides))

    @property
    def noise(self) -> Noise:
        """Of a pixel here."""
        return self.window.noise

    def with_light(self, added: NDArray[np.float32]) -> "GroupView":
        """With the light of another image of the frame added."""
        (left, top), (rows, columns) = self.window.corner, self.window.image.shape
        image = self.window.image + added[top : top + rows, left : left + columns]
        return replace(self, window=replace(self.window, image=image))

    def squared_residuals(self, model: NDArray) -> NDArray[np.float64]:
        """Of a model image, over their variance; 0 where a pixel is not valid."""
        contrast = self.scene.optics.contrast
        level = np.maximum(model, 0.0) / contrast
        variance = self.noise.variance * (1.0 + self.noise.slope * level)
        squares = np.square(self.window.image - model) / variance
        return squares if self.window.valid is None else np.where(self.window.valid > 0, squares, 0.0)

    def disk_model(self) -> NDArray[np.float32]:
        """Image of the disks of the group."""
        corner = np.array([*self.window.corner, 0.0, 0.0])
        disks = self.scene.disks[self.members] - corner
        return render_disks(disks, self.scene.optics.blur, self.window.image.shape)


def _components(pairs: NDArray[np.intp], count: int) -> NDArray[np.int32]:
    """Number of the group of each disk, where pairs belong to the same."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def _box(disks: NDArray, margin: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of the image within a margin of some disks."""
    reach = disks[:, RADIUS] + margin
    low = np.maximum(np.floor((disks[:, :2].T - reach).min(axis=1)), 0).astype(int)
    high = np.maximum(np.ceil((disks[:, :2].T + reach).max(axis=1)).astype(int) + 1, 0)
    return slice(int(low[1]), min(int(high[1]), shape[0])), slice(int(low[0]), min(int(high[0]), shape[1]))


def _cores(disks: NDArray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The pixels inside some disks."""
    x, y = np.arange(shape[1]), np.arange(shape[0])[:, None]
    cores = np.zeros(shape, np.bool_)
    for disk in disks:
        cores |= np.hypot(x - disk[0], y - disk[1]) <= max(disk[RADIUS], 1.0)
    return cores


def _own_pixels(
    scene: ShapeScene, members: NDArray[np.intp], window: Window, component: NDArray[np.bool_]
) -> NDArray[np.uint8] | None:
    """1 for the valid pixels of a window that are not those of other contacts."""
    shape, (left, top), reach = (
        window.image.shape,
        window.corner,
        OTHERS_REACH_BLUR_WIDTHS * scene.optics.blur,
    )
    disks = np.delete(scene.disks, members, axis=0)
    x, y, a = disks[:, 0] - left, disks[:, 1] - top, disks[:, RADIUS] + reach
    near = (x > -a) & (y > -a) & (x < shape[1] + a) & (y < shape[0] + a)
    if not near.any():
        return window.valid
    own = cv2.distanceTransform((~component).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    valid = np.ones(shape, np.uint8)
    for disk in np.column_stack([x, y, disks[:, RADIUS]])[near]:
        part = _box(disk[None], reach, shape)
        columns, rows = np.arange(part[1].start, part[1].stop), np.arange(part[0].start, part[0].stop)
        away = np.hypot(columns - disk[0], rows[:, None] - disk[1]) - disk[2]
        valid[part][(away < reach) & (away < own[part])] = 0
    return exclude(window.valid, 1 - valid)
