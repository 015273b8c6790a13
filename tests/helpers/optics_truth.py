"""The true change of the measured output when effects are left out of synthetic frames: by rendering."""

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from contactimg.effects.output_change import POWER
from contactimg.effects.render_without import OPTICS, film_rim
from contactimg.imaging.fit.film_choice import film_makes_contrast
from contactimg.imaging.measure import measure_image
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.prediction import predict_contacts
from contactimg.render import render_contacts, render_reference
from contactimg.scene import Scene

NOISE = {"shot_noise", "read_noise", "quantisation"}


@dataclass(frozen=True)
class Photographed:
    """A scene's contacts, to be photographed with any choice of effects."""

    scene: Scene
    contacts: pd.DataFrame
    sphere_radius: np.ndarray
    known: dict[tuple[frozenset[str], range], np.ndarray] = field(default_factory=dict)
    """What `amounts` has measured."""

    @classmethod
    def of(cls, scene: Scene) -> "Photographed":
        asperities = need_asperities(scene, "a test")
        contacts = predict_contacts(scene, asperities, load=scene.simulate.loads[0]).contacts
        radii = contact_sites(asperities, scene)["radius_m"].to_numpy(float)
        return cls(scene, contacts, radii[contacts["asperity"].to_numpy(int)])

    @property
    def everything(self) -> frozenset[str]:
        """Effects that the scene can show; the film where its light makes the contrast."""
        simulate = self.scene.simulate
        shown = set(OPTICS)
        if not simulate.electrons_per_level:
            shown -= {"shot_noise", "read_noise"}
        if not film_makes_contrast(film_rim(simulate), simulate.contrast_levels / simulate.background_levels):
            shown -= {"film"}
        return frozenset(shown)

    def with_effects(self, shown: frozenset[str]) -> Scene:
        """The scene with exactly these effects."""
        switches = {name: "on" if name in shown else "off" for name in OPTICS}
        effects = self.scene.effects.model_copy(update=switches)
        return self.scene.model_copy(update={"effects": effects})

    def amounts(self, shown: frozenset[str], seeds: range) -> np.ndarray:
        """Measured ``a^power`` of each contact, one row a seed."""
        if (shown, seeds) not in self.known:
            scene = self.with_effects(shown)
            self.known[shown, seeds] = np.array([self._amounts(scene, seed) for seed in seeds])
        return self.known[shown, seeds]

    def _amounts(self, scene: Scene, seed: int) -> np.ndarray:
        simulate = scene.simulate.model_copy(update={"seed": scene.simulate.seed + seed})
        scene = scene.model_copy(update={"simulate": simulate})
        first, second = (np.random.default_rng([seed, k]) for k in (1, 2))
        shot = render_contacts(self.contacts, scene, rng=first, sphere_radius=self.sphere_radius)
        reference = render_reference(scene, rng=second)
        found = measure_image(
            shot.frame.image,
            reference.image,
            method=scene.measure.method,
            threshold=scene.measure.threshold,
            polarity=scene.images.polarity,
            full_scale=shot.frame.full_scale,
            blur_px=scene.measure.blur_px,
        ).disks
        true = shot.contacts[["x_px", "y_px", "radius_px"]].to_numpy(float)
        x, y, radius = (found[name].to_numpy(float) for name in ("x_px", "y_px", "radius_px"))
        outside = np.hypot(x[:, None] - true[:, 0], y[:, None] - true[:, 1]) - true[:, 2]
        power = POWER[scene.tolerance.output]
        return np.bincount(outside.argmin(axis=1), radius**power, minlength=len(true)).astype(float)

    def change(self, complete: np.ndarray, without: np.ndarray, *, noise: bool) -> tuple[float, float]:
        """Relative change of the output and its standard error; as the estimates define it."""
        step, count = without - complete, len(complete)
        output = self.scene.tolerance.output
        if output == "radius":
            size = np.sum(complete.mean(axis=0) ** 2)
            squares = np.sum(step**2, axis=1) / size
            chance = np.sum(step.var(axis=0, ddof=1)) / count / size
            square = squares.mean() if noise else max(np.sum(step.mean(axis=0) ** 2) / size - chance, 0.0)
            return float(np.sqrt(square)), float(np.sqrt(chance))
        value = 1 / self.sphere_radius if output == "force" else np.ones(step.shape[1])
        sums = step @ value / np.mean(complete @ value)
        error = sums.std(ddof=1) / np.sqrt(count)
        return float(np.sqrt(np.mean(sums**2)) if noise else abs(sums.mean())), float(error)


def true_change(photographed: Photographed, effect: str, seeds: range) -> tuple[float, float]:
    """Change of the output if one effect is left out of all, and its standard error."""
    everything = photographed.everything
    complete = photographed.amounts(everything, seeds)
    without = photographed.amounts(everything - {effect}, seeds)
    return photographed.change(complete, without, noise=effect in NOISE)
