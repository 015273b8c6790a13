"""What the scene's own measurement reads off a test strip, and how far apart two readings are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.optics_strip import Strip, expose_strip, strip_light
from contactimg.imaging.measure import measure_image
from contactimg.optics.recipe import Recipe
from contactimg.scene import Scene

__all__ = ["POWER", "Reader", "Reading"]

Values = NDArray[np.float64]

POWER = {"radius": 1, "area": 2, "force": 3}
"""Power of the radius that each output is."""

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
        count = min(len(self.amount), len(other.amount))
        step = other.amount[:count] - self.amount[:count]
        chance = step.var(axis=0, ddof=1) / count if count > 1 else np.zeros(step.shape[1])
        return self._relative(step.mean(axis=0), -chance if self.power == 1 else np.zeros_like(chance))

    def noise_change(self, still: "Reading", *, share: float) -> float:
        """Change of the output, root mean square, by a part of the noise with this share of its variance.

        ``still`` is the reading without noise: it gives the bias, contacts lost included, and the
        realisations give the scatter.
        """
        bias = self.amount.mean(axis=0) - still.amount.mean(axis=0)
        return self._relative(share * bias, share * self.amount.var(axis=0, ddof=1))

    def noise_bias(self, still: "Reading") -> float:
        """Change of the output in expectation by all noise, relative."""
        bias = self.amount.mean(axis=0) - still.amount.mean(axis=0)
        return self._relative(bias, np.zeros_like(bias))

    def _relative(self, bias: Values, variance: Values) -> float:
        """A change of each contact's amount, and the variance of it, in terms of the output."""
        weight, mean = self.strip.weight, self.amount.mean(axis=0)
        if self.power == POWER["radius"]:
            square = float(weight @ (bias**2 + variance))
            return _ratio(np.sqrt(max(square, 0.0)), float(np.sqrt(weight @ mean**2)))
        value = self._value
        square = float((weight * value) @ bias) ** 2 + float((weight * value**2) @ variance)
        return _ratio(np.sqrt(square), float((weight * value) @ mean))

    @property
    def _value(self) -> Values:
        """What a unit of each contact's amount counts in the output: forces go as a^3/R."""
        known = self.power == POWER["force"] and bool(np.isfinite(self.strip.sphere_radius).all())
        return 1 / self.strip.sphere_radius if known else np.ones(self.strip.weight.size)


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
        self._amount: dict[tuple[frozenset[str], int], Values] = {}

    def read(self, effects: frozenset[str], *, realisations: int) -> Reading:
        """Measure the strip with these effects of the optics and the sensor, under so much chance."""
        power = POWER[self.scene.tolerance.output]
        recipe = Recipe(self.scene.need("simulate", "a test strip"), effects)
        keys = [(effects, k) for k in range(realisations)]
        for key in keys:
            if key not in self._amount:
                self._amount[key] = self._amounts(recipe, key[1], power)
        return Reading(self.strip, np.array([self._amount[key] for key in keys]), power)

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
