"""Contacts of free shape in a fitted frame: their contrast, their light, the uncertainty of their areas."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contactimg.imaging.count.free_shape import Plateau, measure_free_shape, measure_plateau
from contactimg.imaging.judge.shape_rows import FreeContact
from contactimg.imaging.judge.shape_scene import GroupView, ShapeScene
from contactimg.imaging.pixels.robust import MAD_TO_STD

FEWEST_CORES = 3
"""Contacts with a plateau from which the contrast is learned anew. Chosen, as for the fit."""
CORE_OUTLIER_SIGMA = 4.0
"""Robust standard deviations beyond which a plateau is another's. False-alarm rate: 6e-5."""


@dataclass(frozen=True)
class CommonContrast:
    """Contrast of the contacts.

    Parameters
    ----------
    mean, std, spread : float
        With its standard uncertainty, and its spread from contact to contact, grey levels.
    """

    mean: float
    std: float
    spread: float

    @classmethod
    def of(cls, scene: ShapeScene, views: Sequence[GroupView]) -> "CommonContrast":
        """From the plateaus of contacts that are no disks, which disks misjudge; else that of the fit."""
        cores = [(part.level, _plateau_variance(scene, part)) for part in map(_plateau, views) if part.pixels]
        if len(cores) < FEWEST_CORES:
            optics = scene.optics
            std = optics.contrast * float(np.sqrt(optics.covariance[0, 0]))
            return cls(optics.contrast, std, optics.spread)
        level, variance = np.array(cores).T
        away = np.abs(level - np.median(level))
        near = away <= CORE_OUTLIER_SIGMA * MAD_TO_STD * np.median(away) + 1e-9
        level, variance = level[near], variance[near]
        excess = max(float(np.var(level, ddof=1)) - float(np.mean(variance)), 0.0) if len(level) > 1 else 0.0
        weight = 1.0 / (variance + excess)
        mean = float(np.average(level, weights=weight))
        return cls(mean, float(np.sqrt(1.0 / weight.sum())), float(np.sqrt(excess)))


def _plateau(view: GroupView) -> Plateau:
    """Level well inside a contact."""
    return measure_plateau(view.window.image, view.component, blur=view.scene.optics.blur)


def _plateau_variance(scene: ShapeScene, plateau: Plateau) -> float:
    """Of the mean of its pixels."""
    gain = 1.0 + scene.problem.noise.slope
    return gain * float(scene.area_noise.variance_of_mean(np.array([plateau.pixels]))[0])


def measure_by_light(view: GroupView, common: CommonContrast) -> FreeContact:
    """Measure a group of pixels as one contact, by its light over the contrast.

    The contrast is that of its own plateau as far as contrasts scatter, else the common one.
    """
    scene, window = view.scene, view.window
    plateau, contrast, share, own_variance = _plateau(view), common.mean, 0.0, 0.0
    if plateau.pixels:
        own_variance = _plateau_variance(scene, plateau)
        share = common.spread**2 / (common.spread**2 + own_variance)
        contrast += share * (plateau.level - contrast)
    shape = measure_free_shape(
        window.image, view.component, contrast=contrast, blur=scene.optics.blur, valid=window.valid
    )
    mean_variance = float(scene.area_noise.variance_of_mean(np.array([shape.pixels]))[0])
    mean_variance *= 1.0 + view.noise.slope * min(shape.area / max(shape.pixels, 1), 1.0)
    # the plateau and the light share the noise of their pixels
    variance = (shape.pixels - 2.0 * shape.area * share) * shape.pixels * mean_variance
    variance += shape.area**2 * (share**2 * own_variance + ((1.0 - share) * common.spread) ** 2)
    return FreeContact(
        shape,
        area_std=float(np.sqrt(max(variance, 0.0))) / contrast,
        area_shift=-shape.area * (1.0 - share) * common.std / contrast,
    )
