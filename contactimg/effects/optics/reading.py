"""What the scene's own measurement reads off a test strip, and how far apart two readings are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.change import POWER
from contactimg.effects.optics.strip import REALISATIONS, Strip, expose_strip, strip_light
from contactimg.imaging.measure import measure_image
from contactimg.optics.recipe import Recipe
from contactimg.scene import Scene

Values = NDArray[np.float64]

GEOMETRY = {"blur", "film", "edge_roughness", "supersampling"}
"""Effects that the light itself shows, before the sensor."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What was read off a strip.

    Parameters
    ----------
    strip : Strip
    amount : ndarray, shape (realisations, n)
        Measured ``a^power`` of each contact, px; 0 where it was lost.
    power : int
        Of `POWER`.
    """

    strip: Strip
    amount: Values
    power: int

    @property
    def lost(self) -> float:
        """Contacts of the frame that are not found."""
        return float(self.strip.weight @ np.mean(self.amount == 0, axis=0))

    def change(self, other: "Reading") -> float:
        """Relative change of the output from ``other`` to this reading, in expectation.

        Sums of areas and forces are compared, radii contact by contact, in the mean square.
        """
        step = other.amount - self.amount
        return self._relative(step.mean(axis=0), chance=_chance(step), scatter=np.zeros(step.shape[1]))

    def noise_change(self, other: "Reading", *, bias: float, scatter: float) -> float:
        """Change of the output by a part of the noise, root mean square over realisations.

        ``other`` is the reading without the largest source of noise: that part has ``bias`` times its bias,
        contacts lost included, and ``scatter`` times the variance of this reading.
        """
        step = other.amount - self.amount
        return self._relative(
            bias * step.mean(axis=0),
            chance=bias**2 * _chance(step),
            scatter=scatter * self.amount.var(axis=0, ddof=1),
        )

    def _relative(self, bias: Values, *, chance: Values, scatter: Values) -> float:
        """A change of each contact's amount in terms of the output.

        ``chance`` is the variance of the bias as the strip gives it, ``scatter`` that of each contact of the
        frame.
        """
        weight, mean = self.strip.weight, self.amount.mean(axis=0)
        if self.power == POWER["radius"]:
            square = float(weight @ (bias**2 - chance + scatter))
            return _ratio(np.sqrt(max(square, 0.0)), float(np.sqrt(weight @ mean**2)))
        value = weight * self._value
        systematic = float(value @ bias) ** 2 - float(value**2 @ chance)
        square = max(systematic, 0.0) + float((value * self._value) @ scatter)
        return _ratio(np.sqrt(square), float(value @ mean))

    @property
    def _value(self) -> Values:
        """What a unit of each contact's amount counts in the output: forces go as a^3/R."""
        known = self.power == POWER["force"] and bool(np.isfinite(self.strip.sphere_radius).all())
        return 1 / self.strip.sphere_radius if known else np.ones(self.strip.weight.size)


def _chance(step: Values) -> Values:
    """Variance of the mean over realisations."""
    return np.asarray(step.var(axis=0, ddof=1) / len(step))


def _ratio(change: float, size: float) -> float:
    """A change over a size; nothing over nothing is no change."""
    return float(change / size) if size > 0 else float(change > 0)


class Reader:
    """Reads one strip under any choice of effects.

    Parameters
    ----------
    scene : Scene
        Its ``[measure]`` says how.
    strip : Strip
    """

    def __init__(self, scene: Scene, strip: Strip) -> None:
        self.scene, self.strip = scene, strip
        self._lights: dict[frozenset[str], Values] = {}
        self._readings: dict[frozenset[str], Reading] = {}

    def read(self, effects: frozenset[str]) -> Reading:
        """Measure the strip with these effects of optics and sensor, each realisation of the noise."""
        if effects not in self._readings:
            power = POWER[self.scene.tolerance.output]
            recipe = Recipe(self.scene.need("simulate", "a test strip"), effects)
            amounts = [self._amounts(recipe, k, power) for k in range(REALISATIONS)]
            self._readings[effects] = Reading(self.strip, np.array(amounts), power)
        return self._readings[effects]

    def _amounts(self, recipe: Recipe, realisation: int, power: int) -> Values:
        """Measured ``a^power`` of each contact of the strip."""
        frame, reference = expose_strip(self.strip, self._light(recipe), recipe, realisation)
        full_scale = 2.0**recipe.simulate.bit_depth - 1 if "saturation" in recipe.effects else None
        measure = self.scene.measure
        disks = measure_image(
            frame,
            reference,
            method=measure.method,
            polarity=self.scene.images.polarity,
            threshold=measure.threshold,
            full_scale=full_scale,
            blur_px=measure.blur_px,
        ).disks
        owner = self.strip.owner(disks["x_px"].to_numpy(float), disks["y_px"].to_numpy(float))
        radius = disks["radius_px"].to_numpy(float)
        return np.bincount(owner, radius**power, minlength=self.strip.weight.size).astype(float)

    def _light(self, recipe: Recipe) -> Values:
        """The light of the strip, once for each choice of what it shows."""
        key = recipe.effects & GEOMETRY
        if key not in self._lights:
            self._lights[key] = strip_light(self.strip, recipe)
        return self._lights[key]
