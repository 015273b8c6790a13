"""The true change of the measured output when an effect is left out of synthetic frames, by measuring them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from contactimg.imaging.measure import measure_image
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.prediction import predict_contacts
from contactimg.render import render_contacts, render_reference
from contactimg.scene import Scene

POWER = {"radius": 1, "area": 2, "force": 3}


@dataclass(frozen=True)
class Photographed:
    """A scene's contacts, ready to be photographed with any choice of effects."""

    scene: Scene
    contacts: pd.DataFrame
    sphere_radius: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> "Photographed":
        asperities = need_asperities(scene, "a test")
        contacts = predict_contacts(scene, asperities, load=scene.simulate.loads[0]).contacts
        radii = contact_sites(asperities, scene)["radius_m"].to_numpy(float)
        return cls(scene, contacts, radii[contacts["asperity"].to_numpy(int)])

    def outputs(self, switches: dict[str, str], seeds: range) -> np.ndarray:
        """Measured output of a frame a seed."""
        effects = self.scene.effects.model_copy(update=switches)
        scene = self.scene.model_copy(update={"effects": effects})
        return np.array([self._output(scene, seed) for seed in seeds])

    def _output(self, scene: Scene, seed: int) -> float:
        simulate = scene.simulate.model_copy(update={"seed": scene.simulate.seed + seed})
        scene = scene.model_copy(update={"simulate": simulate})
        first, second = (np.random.default_rng([seed, k]) for k in (1, 2))
        frame = render_contacts(self.contacts, scene, rng=first, sphere_radius=self.sphere_radius).frame
        reference = render_reference(scene, rng=second)
        found = measure_image(
            frame.image,
            reference.image,
            method=scene.measure.method,
            threshold=scene.measure.threshold,
            polarity=scene.images.polarity,
            full_scale=frame.full_scale,
            blur_px=scene.measure.blur_px,
        ).disks
        radius = found["radius_px"].to_numpy(float)
        power = POWER[scene.tolerance.output]
        if power == 1:
            return float(radius.mean()) if len(radius) else 0.0
        return float(np.sum(radius**power))
