"""Measure the small image as the scene says, and compare two measurements."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.optics.sample_image import REALISATIONS, SampleImage, expose_sample, sample_light
from contactimg.effects.output_change import POWER
from contactimg.imaging.measure import measure_image
from contactimg.optics.render_settings import RenderSettings
from contactimg.scene import Scene

Values = NDArray[np.float64]

GEOMETRY = {"blur", "film", "edge_roughness", "supersampling"}
"""Effects on the light before it reaches the sensor."""


@dataclass(frozen=True, eq=False)
class SampleMeasurement:
    """The contacts as measured on the small image.

    Parameters
    ----------
    sample : SampleImage
    amount : ndarray, shape (realisations, n)
        Measured ``a^power`` of each contact, in pixels; 0 if it was not detected.
    power : int
        Power of the radius that the output is proportional to (`POWER`).
    """

    sample: SampleImage
    amount: Values
    power: int

    @property
    def lost(self) -> float:
        """Number of contacts of the frame that are not detected."""
        return float(self.sample.weight @ np.mean(self.amount == 0, axis=0))

    def change(self, other: "SampleMeasurement") -> float:
        """Expected relative change of the output from ``other`` to this measurement.

        Areas and forces are compared as sums, radii as the root mean square over the contacts.
        """
        step = other.amount - self.amount
        return self._relative(
            step.mean(axis=0), chance=_variance_of_mean(step), scatter=np.zeros(step.shape[1])
        )

    def noise_change(self, other: "SampleMeasurement", *, bias: float, scatter: float) -> float:
        """Root-mean-square change of the output by one source of noise.

        ``other`` is the measurement without the largest source of noise. The source in question has ``bias``
        times the bias of the largest one (including lost contacts) and ``scatter`` times the variance of this
        measurement.
        """
        step = other.amount - self.amount
        return self._relative(
            bias * step.mean(axis=0),
            chance=bias**2 * _variance_of_mean(step),
            scatter=scatter * self.amount.var(axis=0, ddof=1),
        )

    def _relative(self, bias: Values, *, chance: Values, scatter: Values) -> float:
        """Convert changes of the contacts into a relative change of the output.

        ``chance`` is the variance of the bias, ``scatter`` the variance of each contact.
        """
        weight, mean = self.sample.weight, self.amount.mean(axis=0)
        if self.power == POWER["radius"]:
            square = float(weight @ (bias**2 - chance + scatter))
            return _ratio(np.sqrt(max(square, 0.0)), float(np.sqrt(weight @ mean**2)))
        value = weight * self._value
        systematic = float(value @ bias) ** 2 - float(value**2 @ chance)
        square = max(systematic, 0.0) + float((value * self._value) @ scatter)
        return _ratio(np.sqrt(square), float(value @ mean))

    @property
    def _value(self) -> Values:
        """Weight of each contact in the output: forces are proportional to a^3/R."""
        known = self.power == POWER["force"] and bool(np.isfinite(self.sample.sphere_radius).all())
        return 1 / self.sample.sphere_radius if known else np.ones(self.sample.weight.size)


def _variance_of_mean(step: Values) -> Values:
    """Variance of the mean over the realisations."""
    return np.asarray(step.var(axis=0, ddof=1) / len(step))


def _ratio(change: float, size: float) -> float:
    """The ratio of change and size; 0 for zero over zero, 1 for a change of nothing."""
    return float(change / size) if size > 0 else float(change > 0)


class SampleMeasurer:
    """Measures one small image with any choice of effects; results are kept.

    Parameters
    ----------
    scene : Scene
        The section ``[measure]`` states the method.
    sample : SampleImage
    """

    def __init__(self, scene: Scene, sample: SampleImage) -> None:
        self.scene, self.sample = scene, sample
        self._lights: dict[frozenset[str], Values] = {}
        self._measurements: dict[frozenset[str], SampleMeasurement] = {}

    def measure(self, effects: frozenset[str]) -> SampleMeasurement:
        """Measure the image with these effects, for each realisation of the noise."""
        if effects not in self._measurements:
            power = POWER[self.scene.tolerance.output]
            settings = RenderSettings(self.scene.need("simulate", "a sample image"), effects)
            amounts = [self._amounts(settings, k, power) for k in range(REALISATIONS)]
            self._measurements[effects] = SampleMeasurement(self.sample, np.array(amounts), power)
        return self._measurements[effects]

    def _amounts(self, settings: RenderSettings, realisation: int, power: int) -> Values:
        """Measured ``a^power`` of each contact."""
        frame, reference = expose_sample(self.sample, self._light(settings), settings, realisation)
        full_scale = 2.0**settings.simulate.bit_depth - 1 if "saturation" in settings.effects else None
        options = self.scene.measure
        disks = measure_image(
            frame,
            reference,
            method=options.method,
            polarity=self.scene.images.polarity,
            threshold=options.threshold,
            full_scale=full_scale,
            blur_px=options.blur_px,
        ).disks
        contact = self.sample.nearest_contact(disks["x_px"].to_numpy(float), disks["y_px"].to_numpy(float))
        radius = disks["radius_px"].to_numpy(float)
        return np.bincount(contact, radius**power, minlength=self.sample.weight.size).astype(float)

    def _light(self, settings: RenderSettings) -> Values:
        """The light of the image, computed once for each set of effects on it."""
        key = settings.effects & GEOMETRY
        if key not in self._lights:
            self._lights[key] = sample_light(self.sample, settings)
        return self._lights[key]
