"""A scene on trial: the effects it states, the strip they are tried on, and the readings with and without."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.change import POWER
from contactimg.effects.optics.reading import Reader, Reading
from contactimg.effects.optics.strip import Strip
from contactimg.scene import Scene, Simulate

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trial:
    """Readings of a scene's strip.

    Parameters
    ----------
    scene : Scene
    contacts : DataFrame, contacts schema
        All of them, lengths in m.
    reader : Reader
    base : frozenset of str
        Effects that the frame shows when nothing is left out.
    """

    scene: Scene
    contacts: pd.DataFrame
    reader: Reader
    base: frozenset[str]

    @property
    def simulate(self) -> Simulate:
        """Optics and sensor."""
        section: Simulate = self.scene.need("simulate", "the effects of optics and sensor")
        return section

    @property
    def strip(self) -> Strip:
        """The test strip."""
        return self.reader.strip

    @property
    def power(self) -> int:
        """Power of the radius that the requested output is."""
        return POWER[self.scene.tolerance.output]

    @property
    def pixel_um(self) -> float:
        """Pixel size, um."""
        return self.strip.pixel_size * 1e6

    @property
    def mean_radius(self) -> float:
        """Mean radius of the contacts in the frame, px."""
        return float(np.average(self.strip.radius_px, weights=self.strip.weight))

    def reading(self, *, without: str = "") -> Reading:
        """The strip with all that the frame shows, or with one effect left out."""
        return self.reader.read(self.base - {without})

    def change(self, effect: str) -> float:
        """Relative change of the output, in expectation, if a systematic effect is left out."""
        return self.with_effect(effect).reading().change(self.reading(without=effect))

    def noise_change(self, shares: dict[str, float], share: float, *, scatter: float | None = None) -> float:
        """Root-mean-square change of the output by a part of the noise.

        ``shares`` are those of the variance that each source of noise has, ``share`` that of the part.
        Contacts lost and a plateau misread go with the variance; so does the scatter of fits, while pixels
        that noise takes across a threshold go with its standard deviation; 0 for ``scatter`` leaves the bias.
        """
        largest = max(shares, key=lambda name: shares[name])
        if scatter is None:
            scatter = np.sqrt(share) if self.scene.measure.method == "threshold" else share
        without = self.reading(without=largest)
        return self.reading().noise_change(without, bias=share / shares[largest], scatter=scatter)

    def with_effect(self, effect: str) -> "Trial":
        """The same trial of a frame that shows one effect more."""
        return replace(self, base=self.base | {effect})

    def scattered(self, step: Values) -> float:
        """Change of the output if each radius changes at random, independently, by a relative step."""
        strip, amount = self.strip, self.strip.radius_px**self.power
        if self.power == POWER["radius"]:
            return float(np.sqrt(strip.weight @ (step * amount) ** 2 / (strip.weight @ amount**2)))
        spread = np.sqrt(strip.weight @ (self.power * step * amount) ** 2)
        return float(spread / (strip.weight @ amount))
