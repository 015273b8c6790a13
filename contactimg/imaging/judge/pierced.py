"""Contacts with holes that the blur fills: the contrast that they have beside their holes.

A hole narrower than the blur makes a contact dimmer there, and no level line shows it. Disks are then fitted
with a contrast that is too low, and their areas are too large by as much. The light of a contact over its
contrast is its area whatever its holes; only the contrast is needed. It follows from some contacts to which a
disk minus smaller disks is fitted, with contrast and blur common to all.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.ellipse import CONTRAST, RADIUS, X, Y, fit_ellipse
from contactimg.imaging.fit.quality import FittedDetections, FrameFit
from contactimg.imaging.fit.settings import POOR_CHI_SQUARE
from contactimg.imaging.judge.common_distortion import (
    ANGULAR_BINS,
    BAND_BLUR_WIDTHS,
    RADIAL_BINS,
    has_own_misfit,
)
from contactimg.imaging.judge.free_contacts import CommonContrast
from contactimg.imaging.judge.shape_scene import GroupView, ShapeScene
from contactimg.imaging.kernels.ellipse_equations import PARAMETERS
from contactimg.imaging.profile.edge_shape import BlurredDisks, PlacedDisks
from contactimg.tables import Flag

Values = NDArray[np.float64]

RADIUS_BLUR_WIDTHS = (2.5, 8.0)
"""Radii of contacts that tell of their holes. Chosen: a narrower one is a spot, whatever is in it, and a
wider one shows its contrast beside them."""
LEAST_POOR_SHARE = 0.3
"""Share of these that must fit badly as disks. Chosen: 0 on frames as assumed, 0.7 with holes in a tenth."""
FEWEST_WITNESSES = 5
"""Contacts with holes that show what they share. Chosen: with fewer, one odd contact decides."""
MOST_WITNESSES = 24  # contacts to which holes are fitted, the widest; for time
PROBE_STEP = 4  # of the witnesses, one in so many is asked first; for time
MOST_HOLES = 3  # in one of them; for time
FIRST_HOLE_BLUR_WIDTHS = 0.8  # radius that a hole starts with; accuracy
LEAST_GAIN = 25.0
"""Decrease of chi-square by a hole. Theory: 5 sigma."""
LEAST_EXPLAINED_SHARE = 0.5
"""Share of the witnesses that must have a hole and then fit. Chosen: most of them."""
LEAST_RISE = 0.03
"""Of the contrast over that of disks. Chosen: it changes areas by 3 %; less is left to each contact."""
LEAST_OWN_SHARE = 0.25
"""Share of the witnesses whose misfit must not be what all have in common. Chosen: coma leaves 0, an annular
aperture 0.1, holes 0.7 and, if all are in the middle, 0.15."""
ITERATIONS, OUTER_ITERATIONS = 8, 4  # of one contact, and of contrast and blur; accuracy
BRIGHTEST_SHARE = 0.9
"""Quantile of the brightest pixels of the witnesses that the contrast starts from. Accuracy."""
CONTRAST_RELATIVE_STD = 0.02
"""Standard uncertainty of the contrast because holes are no disks. Chosen."""


def contrast_beside_holes(detections: FittedDetections) -> CommonContrast | None:
    """Contrast of the contacts of a frame beside their holes; None where most have none.

    Parameters
    ----------
    detections : FittedDetections
        Fitted with a plain edge.
    """
    frame_fit = detections.frame_fit
    if frame_fit is None or frame_fit.joint is None:
        return None
    rows = _poor_wide(detections)
    if not len(rows):
        return None
    scene = ShapeScene.of(frame_fit, frame_fit.joint)
    views = [view for view in (scene.view(rows[k : k + 1]) for k in range(len(rows))) if view is not None]
    if len(views) < FEWEST_WITNESSES:
        return None
    if np.median([_misfit_as_ellipse(view) for view in views]) < POOR_CHI_SQUARE:
        return None
    return _settled(scene, [_Pierced.of(view) for view in views])


def may_have_holes(frame_fit: FrameFit) -> bool:
    """Whether so many of the wide disks of a frame fit badly that their holes are worth a look."""
    fit = frame_fit.fit
    wide = _is_wide(fit.disks, fit.blur)
    poor = int(np.count_nonzero(fit.chi_square[wide] > POOR_CHI_SQUARE))
    return poor >= max(FEWEST_WITNESSES, LEAST_POOR_SHARE * np.count_nonzero(wide))


def _is_wide(disks: Values, blur: float) -> NDArray[np.bool_]:
    """Which disks may tell of holes."""
    least, most = (bound * blur for bound in RADIUS_BLUR_WIDTHS)
    return np.asarray((disks[:, RADIUS] > least) & (disks[:, RADIUS] < most))


def _misfit_as_ellipse(view: GroupView) -> float:
    """Mean squared residual of the best ellipse over its variance: ellipses look like disks with holes."""
    start = np.zeros(PARAMETERS)
    start[[X, Y, RADIUS, CONTRAST]] = view.scene.disks[view.members[0]]
    return float(fit_ellipse(view.window, start, view.scene.optics, inflation=1.0).chi_square[0])


def _poor_wide(detections: FittedDetections) -> NDArray[np.intp]:
    """The widest contacts that fit badly, rows of the fit; none where they are few of the wide ones."""
    frame_fit = detections.frame_fit
    if frame_fit is None:
        return np.zeros(0, np.intp)
    fit, rows = frame_fit.fit, detections.rows
    apart = detections.contacts["flags"] & int(Flag.EDGE | Flag.MERGED | Flag.SATURATED | Flag.MANUAL) == 0
    wide = rows[apart & _is_wide(fit.disks[rows], fit.blur)]
    poor = wide[fit.chi_square[wide] > POOR_CHI_SQUARE]
    if len(poor) < max(FEWEST_WITNESSES, LEAST_POOR_SHARE * len(wide)):
        return np.zeros(0, np.intp)
    return poor[np.argsort(-fit.disks[poor, RADIUS], kind="stable")][:MOST_WITNESSES]


def _settled(scene: ShapeScene, contacts: list["_Pierced"]) -> CommonContrast | None:
    """Contrast and blur of all contacts by Newton steps."""
    start = max(
        float(np.quantile([part.brightest for part in contacts], BRIGHTEST_SHARE)), scene.optics.contrast
    )
    optics, information = np.array([np.log(start), scene.optics.blur]), np.zeros((2, 2))
    whole = [part.fitted(optics) for part in contacts]
    own = has_own_misfit([part.cells(optics) for part in whole], np.array([part.place for part in whole]))
    if np.mean(own) < LEAST_OWN_SHARE:
        return None
    if (
        np.mean([part.with_holes(optics).is_explained for part in whole[::PROBE_STEP]])
        < LEAST_EXPLAINED_SHARE
    ):
        return None
    contacts = [part.with_holes(optics) for part in whole]
    for _ in range(OUTER_ITERATIONS):
        sums = [part.shared(optics) for part in contacts]
        score, information = (np.sum([part[k] for part in sums], axis=0) for k in (0, 1))
        step = np.clip(np.linalg.solve(information, score), [-0.1, -0.3], [0.1, 0.3])
        optics = optics + step
        contacts = [part.fitted(optics) for part in contacts]
    misfit, explained = ([getattr(part, name) for part in contacts] for name in ("misfit", "is_explained"))
    contrast = float(np.exp(optics[0]))
    rise = contrast / scene.optics.contrast - 1.0
    if np.mean(explained) < LEAST_EXPLAINED_SHARE or rise < LEAST_RISE:
        return None
    variance = float(np.linalg.inv(information)[0, 0]) * max(float(np.median(misfit)), 1.0)
    std = contrast * float(np.hypot(np.sqrt(variance), CONTRAST_RELATIVE_STD))
    return CommonContrast(contrast, std, 0.0)


@dataclass(frozen=True, eq=False)
class _Pierced:
    """A disk minus smaller disks, fitted to the pixels of a contact.

    Parameters
    ----------
    x, y, level : ndarray, shape (k,)
        Of its pixels.
    noise : (float, float)
        Variance of a background pixel, and its relative growth over a contact.
    shapes : ndarray, shape (1 + h, 3)
        x, y, radius (px) of the disk and of its holes.
    place : ndarray, shape (2,)
        Of the contact in the image, px.
    misfit : float
        Mean squared residual over its variance.
    """

    x: Values
    y: Values
    level: Values
    noise: tuple[float, float]
    shapes: Values
    place: Values
    misfit: float = float("nan")

    @classmethod
    def of(cls, view: GroupView) -> "_Pierced":
        """Without holes."""
        window, member = view.window, view.scene.disks[view.members[0]]
        seen = np.ones(window.image.shape, np.bool_) if window.valid is None else window.valid > 0
        y, x = np.nonzero(seen)
        shape = member[:3] - [*window.corner, 0.0]
        noise = (view.noise.variance, view.noise.slope)
        level = window.image[seen].astype(float)
        return cls(x.astype(float), y.astype(float), level, noise, shape[None], member[:2])

    @property
    def brightest(self) -> float:
        """Level of its brightest pixels, without those that noise makes brightest."""
        return float(np.quantile(self.level, 1.0 - 4.0 / len(self.level)))

    @property
    def is_explained(self) -> bool:
        """Whether it has holes, and fits with them."""
        return len(self.shapes) > 1 and self.misfit < POOR_CHI_SQUARE

    def with_holes(self, optics: Values) -> "_Pierced":
        """With holes where what the fitted disk leaves calls for them."""
        best = self
        for _ in range(MOST_HOLES):
            more = replace(best, shapes=np.vstack([best.shapes, best.darkest(optics)])).fitted(optics)
            if (best.misfit - more.misfit) * len(self.x) < LEAST_GAIN:
                break
            best = more
        return best

    def cells(self, optics: Values) -> Values:
        """Mean of what the disk leaves, over the contrast, in cells about its rim; the numbers of pixels."""
        model, _ = self._model(optics)
        x, y, radius = self.shapes[0]
        place = (np.hypot(self.x - x, self.y - y) - radius) / optics[1]
        near = np.flatnonzero(place < BAND_BLUR_WIDTHS)
        ring = np.clip((place[near] / BAND_BLUR_WIDTHS + 1.0) / 2.0 * RADIAL_BINS, 0, None).astype(int)
        turn = np.arctan2(self.y[near] - y, self.x[near] - x) / (2.0 * np.pi) + 0.5
        cell = ring * ANGULAR_BINS + (turn * ANGULAR_BINS).astype(int) % ANGULAR_BINS
        count = np.bincount(cell, minlength=RADIAL_BINS * ANGULAR_BINS).astype(float)
        rest = (self.level - model)[near] / np.exp(optics[0])
        return np.stack([np.bincount(cell, rest, minlength=len(count)) / np.maximum(count, 1.0), count])

    def darkest(self, optics: Values) -> Values:
        """A hole where the pixels within a blur width are darkest against what is fitted, inside the disk."""
        model, _ = self._model(optics)
        centre_x, centre_y, radius = self.shapes[0]
        inside = np.hypot(self.x - centre_x, self.y - centre_y) < radius
        x, y, rest = self.x[inside], self.y[inside], (self.level - model)[inside]
        squares = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
        at = np.argmin(np.exp(squares * (-0.5 / optics[1] ** 2)) @ rest)
        return np.array([x[at], y[at], FIRST_HOLE_BLUR_WIDTHS * optics[1]])

    def fitted(self, optics: Values) -> "_Pierced":
        """Fitted behind a contrast and blur by damped Gauss-Newton steps."""
        best, damping = self, 1e-3
        model, slopes = best._model(optics)
        weight = self._weight(model, optics)
        loss = float(weight @ (self.level - model) ** 2)
        for _ in range(ITERATIONS):
            own = slopes[: best.shapes.size]
            normal, score = (own * weight) @ own.T, own @ (weight * (self.level - model))
            normal += np.diag(damping * np.diag(normal) + 1e-9)
            moved = best._moved(np.asarray(np.linalg.solve(normal, score), float), optics)
            other, its_slopes = moved._model(optics)
            new = float(weight @ (self.level - other) ** 2)
            if new > loss:
                damping = max(10.0 * damping, 1e-2)
                continue
            gain, best, model, slopes, loss = loss - new, moved, other, its_slopes, new
            damping *= 0.1
            if gain < 0.1:
                break
        return replace(best, misfit=loss / len(self.x))

    def shared(self, optics: Values) -> tuple[Values, Values]:
        """Score and information of (ln contrast, blur), its own quantities eliminated."""
        model, slopes = self._model(optics)
        weight, own = self._weight(model, optics), self.shapes.size
        normal, score = (slopes * weight) @ slopes.T, slopes @ (weight * (self.level - model))
        inner = normal[:own, :own] + 1e-6 * np.diag(np.diag(normal)[:own] + 1e-9)
        response = np.linalg.solve(inner, normal[:own, own:])
        information = normal[own:, own:] - normal[own:, :own] @ response
        return score[own:] - response.T @ score[:own], information

    def _weight(self, model: Values, optics: Values) -> Values:
        """Inverse variance of each pixel."""
        height = np.clip(model / np.exp(optics[0]), 0.0, 1.0)
        return np.asarray(1.0 / (self.noise[0] * (1.0 + self.noise[1] * height)))

    def _moved(self, step: Values, optics: Values) -> "_Pierced":
        """After a step, holes within the disk and no wider than half of it."""
        change = np.clip(step.reshape(-1, 3), -0.5 * optics[1], 0.5 * optics[1])
        shapes = self.shapes + change
        radius = shapes[0, 2]
        shapes[1:, 2] = np.clip(shapes[1:, 2], 0.2 * optics[1], 0.5 * radius)
        offset = shapes[1:, :2] - shapes[0, :2]
        far = np.maximum(np.hypot(*offset.T) / max(radius, 1e-9), 1.0)
        shapes[1:, :2] = shapes[0, :2] + offset / far[:, None]
        return replace(self, shapes=shapes)

    def _model(self, optics: Values) -> tuple[Values, Values]:
        """Levels, and their derivatives by all shapes, by the logarithm of the contrast and by the blur."""
        contrast, blur = float(np.exp(optics[0])), float(optics[1])
        dx, dy = (at - self.shapes[:, k, None] for k, at in enumerate((self.x, self.y)))
        distance, radius = np.hypot(dx, dy), self.shapes[:, 2:]
        disks = BlurredDisks.of(PlacedDisks(radius, np.zeros((len(radius), 5)), distance, 0.0), blur)
        height = contrast * np.where(np.arange(len(radius)) > 0, -1.0, 1.0)[:, None]
        outwards = -height * disks.by_r / (blur * np.maximum(distance, 1e-9))
        own = np.stack([outwards * dx, outwards * dy, height * disks.by_a / blur], axis=1)
        model = np.sum(height * disks.p, axis=0)
        by_blur = -np.sum(height * (radius * disks.by_a + distance * disks.by_r), axis=0) / blur**2
        return model, np.vstack([own.reshape(-1, len(self.x)), model, by_blur])
