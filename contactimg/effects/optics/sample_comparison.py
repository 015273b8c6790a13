"""Compare measurements of the small image with and without an effect."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.optics.sample_image import SampleImage
from contactimg.effects.optics.sample_measurement import SampleMeasurement, SampleMeasurer
from contactimg.effects.output_change import POWER
from contactimg.scene import Scene, Simulate

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampleComparison:
    """Measurements of the small image with all effects of a scene, or without one of them.

    Parameters
    ----------
    scene : Scene
    contacts : DataFrame, contacts schema
        All contacts of the scene, lengths in m.
    measurer : SampleMeasurer
    base : frozenset of str
        Effects that the frame shows if none is left out.
    """

    scene: Scene
    contacts: pd.DataFrame
    measurer: SampleMeasurer
    base: frozenset[str]

    @property
    def simulate(self) -> Simulate:
        """The section [simulate]: optics and sensor."""
        section: Simulate = self.scene.need("simulate", "the effects of optics and sensor")
        return section

    @property
    def sample(self) -> SampleImage:
        """The small image."""
        return self.measurer.sample

    @property
    def power(self) -> int:
        """Power of the radius that the requested output is proportional to."""
        return POWER[self.scene.tolerance.output]

    @property
    def pixel_um(self) -> float:
        """Pixel size, um."""
        return self.sample.pixel_size * 1e6

    @property
    def mean_radius(self) -> float:
        """Mean radius of the contacts in the frame, px."""
        return float(np.average(self.sample.radius_px, weights=self.sample.weight))

    def measurement(self, *, without: str = "") -> SampleMeasurement:
        """The measurement with all effects of the frame, or without one of them."""
        return self.measurer.measure(self.base - {without})

    def change(self, effect: str) -> float:
        """Expected relative change of the output if a systematic effect is left out."""
        return self.with_effect(effect).measurement().change(self.measurement(without=effect))

    def noise_change(self, shares: dict[str, float], share: float, *, scatter: float | None = None) -> float:
        """Root-mean-square change of the output by one source of noise.

        ``shares`` are the fractions of the variance of all sources, ``share`` the fraction of this one. Lost
        contacts, errors of the plateau and the scatter of fits are proportional to the variance; the scatter
        of a pixel count is proportional to the standard deviation. With ``scatter = 0`` only the bias is
        computed.
        """
        largest = max(shares, key=lambda name: shares[name])
        if scatter is None:
            scatter = np.sqrt(share) if self.scene.measure.method == "threshold" else share
        without = self.measurement(without=largest)
        return self.measurement().noise_change(without, bias=share / shares[largest], scatter=scatter)

    def with_effect(self, effect: str) -> "SampleComparison":
        """The comparison for a frame that shows one more effect."""
        return replace(self, base=self.base | {effect})

    def scattered(self, step: Values) -> float:
        """Relative change of the output if each radius changes independently at random by a relative step."""
        sample, amount = self.sample, self.sample.radius_px**self.power
        if self.power == POWER["radius"]:
            return float(np.sqrt(sample.weight @ (step * amount) ** 2 / (sample.weight @ amount**2)))
        spread = np.sqrt(sample.weight @ (self.power * step * amount) ** 2)
        return float(spread / (sample.weight @ amount))
