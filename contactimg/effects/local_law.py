"""The law of local force for measured contacts: what Hertz's formula would leave out decides.

The same switches as for a prediction, ``sphere_profile`` and ``adhesion``, and the same tolerance; here the
radii are measured, so that each change is known without solving anything.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.output_change import EffectEstimate
from contactimg.effects.plan import decide
from contactimg.mechanics.contact_force import adhesive_pull, pressing_force
from contactimg.mechanics.layer_contact import LARGEST_RATIO, layer_factors
from contactimg.scene import Scene
from contactimg.scene.contact_sections import Elastic

Values = NDArray[np.float64]

LAW_WORDS = {
    "hertz": "Hertz",
    "sphere": "Hertz with the exact profile of a sphere",
    "jkr": "JKR adhesion",
}
"""Part of the name of a law -> what it means."""

EFFECT_WORDS = {"sphere_profile": "the exact profile of the sphere", "adhesion": "adhesion"}
"""Effect on the local forces -> what it is called in a sentence."""


def law_name(scene: Scene) -> str:
    """The name in tables of the law of the local forces of a scene whose switches are set.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> law_name(scene_from_dict({"effects": {"sphere_profile": "on", "adhesion": "on"}}))
    'sphere+jkr'
    """
    profile = "sphere" if scene.effects.sphere_profile == "on" else "hertz"
    return profile + ("+jkr" if scene.effects.adhesion == "on" else "")


@dataclass(frozen=True)
class LawPlan:
    """The law of the local forces of a run.

    Parameters
    ----------
    scene : Scene
        With ``sphere_profile`` and ``adhesion`` "on" or "off".
    left_out : dict
        Effect that is left out -> relative change of the forces by it, in the worst frame.
    switched_off : tuple of str
        Those of them that the scene itself leaves out.
    messages : tuple of str
        One sentence for each other switch that contradicts the estimates, and for a layer too thin.
    """

    scene: Scene
    left_out: dict[str, float]
    switched_off: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()

    def sentence(self) -> str:
        """The law, and what it leaves out."""
        law = law_name(self.scene)
        words = ", ".join(LAW_WORDS[part] for part in law.split("+"))
        left = "; ".join(map(self._loss, self.left_out)) or "nothing that acts on them is left out"
        return "; ".join([f"local forces by the law {law} ({words})", left, *self.messages])

    def _loss(self, effect: str) -> str:
        """A sentence on what is left out with an effect."""
        why = ", as the scene says" if effect in self.switched_off else ""
        return f"left out{why}: {EFFECT_WORDS[effect]} ({100 * self.left_out[effect]:.2g} % of the forces)"


def law_evidence(scene: Scene, contacts: pd.DataFrame, sphere_radius: Values) -> pd.DataFrame:
    """Tabulate the quantities that decide on the law of the local forces, one row a frame.

    Parameters
    ----------
    scene : Scene
    contacts : DataFrame
        With ``frame`` and ``radius_m``.
    sphere_radius : ndarray, m
        Composite radius of each contact's asperity; NaN where it is not known.

    Returns
    -------
    DataFrame
        ``sphere_profile, adhesion``: relative change of the forces, ``sum |change| / sum |force|`` over the
        contacts with a force; ``radius_m``: the largest one.
    """
    elastic = scene.need("elastic", "local forces")
    a, modulus = contacts["radius_m"].to_numpy(float), elastic.contact_modulus
    parabola = pressing_force(a, sphere_radius, contact_modulus=modulus)
    sphere = pressing_force(a, sphere_radius, contact_modulus=modulus, law="sphere")
    pull = adhesive_pull(a, contact_modulus=modulus, work_of_adhesion=elastic.work_of_adhesion)
    complete = sphere - (0.0 if scene.effects.adhesion == "off" else pull)
    forces = np.abs(np.column_stack([sphere - parabola, pull, complete]))
    forces[~np.isfinite(complete)] = 0.0
    table = pd.DataFrame(forces, columns=["sphere_profile", "adhesion", "complete"])
    frames = table.groupby(contacts["frame"].to_numpy()).sum()
    changes = frames.div(frames.pop("complete"), axis="index").replace(np.inf, 0.0).fillna(0.0)
    return changes.assign(radius_m=contacts.groupby("frame")["radius_m"].max())


def decide_law(scene: Scene, evidence: pd.DataFrame) -> LawPlan:
    """Decide on the law of the local forces: one for all frames, that which the worst of them calls for.

    ``evidence`` is that of all frames, from `law_evidence`.
    """
    elastic, worst = scene.need("elastic", "local forces"), evidence.max().fillna(0.0).to_dict()
    estimates = [
        EffectEstimate(
            name, worst[name], "from the measured radii", {"force": worst[name], "profile": worst[name]}
        )
        for name in EFFECT_WORDS
    ]
    tolerance = scene.tolerance
    decisions, messages = decide(
        estimates, scene.effects, tolerance=tolerance.relative, output=tolerance.output
    )
    switches = {d.effect: "on" if d.on and (d.change > 0 or d.switch == "on") else "off" for d in decisions}
    left_out = {d.effect: d.change for d in decisions if switches[d.effect] == "off" and d.change > 0}
    switched_off = tuple(d.effect for d in decisions if d.switch == "off" and d.effect in left_out)
    others = [text for text in messages if not text.startswith(switched_off)]
    if too_thin := _support_message(worst["radius_m"], elastic, tolerance.relative):
        others.append(too_thin)
    return LawPlan(scene.with_effects(switches), left_out, switched_off, tuple(others))


def _support_message(radius: float, elastic: Elastic, tolerance: float) -> str:
    """A sentence if the layer is so thin that its support acts on a single contact; else empty."""
    if elastic.thickness is None:
        return ""
    ratio = radius / elastic.thickness
    pressing, _ = layer_factors(min(ratio, LARGEST_RATIO), poisson_ratio=elastic.poisson_ratio)
    error = float(1 - 1 / pressing)
    if error <= tolerance:
        return ""
    return (
        f"contact radii reach {ratio:.2g} of the layer's thickness: the support under a contact itself is "
        f"not in the law, and forces are low by {'more than' if ratio > LARGEST_RATIO else 'up to'} "
        f"{100 * error:.2g} %"
    )
