"""The law of local force for measured contacts, and the forces by it.

What Hertz's formula would leave out decides.
The same switches as for a prediction, ``sphere_profile``, ``adhesion`` and ``layer``, and the same tolerance;
here the radii are measured, so that each change is known without solving anything.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.effects.output_change import EffectEstimate
from contactimg.effects.plan import decide
from contactimg.errors import InputError
from contactimg.mechanics.checks import non_negative
from contactimg.models.asperity_laws import AdhesiveLaw, Caps
from contactimg.scene import Scene

Values = NDArray[np.float64]

LAW_WORDS = {"hertz": "Hertz", "sphere": "Hertz with the exact profile of a sphere", "jkr": "JKR adhesion"}
"""Part of the name of a law -> what it means."""

EFFECT_WORDS = {
    "sphere_profile": "the exact profile of the sphere",
    "adhesion": "adhesion",
    "layer": "the support of the layer under a contact",
}
"""Effect on the local forces -> what it is called in a sentence."""

ForceLaw = Literal["hertz", "sphere"]
"""Hertz's law of a paraboloid, or the sphere's exact law (Sneddon)."""


def law_name(scene: Scene) -> str:
    """The name in tables of the law of the local forces of a scene whose switches are set.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> law_name(scene_from_dict({"effects": {"sphere_profile": "on", "adhesion": "on"}}))
    'sphere+jkr'
    """
    return scene.effects.law + ("+jkr" if scene.effects.adhesion == "on" else "")


@dataclass(frozen=True)
class LawPlan:
    """The law of the local forces of a run.

    Parameters
    ----------
    scene : Scene
        With ``sphere_profile``, ``adhesion`` and ``layer`` "on" or "off".
    left_out : dict
        Effect that is left out -> relative change of the forces by it, in the worst frame.
    switched_off : tuple of str
        Those of them that the scene itself leaves out.
    messages : tuple of str
        One sentence for each other switch that contradicts the estimates.
    """

    scene: Scene
    left_out: dict[str, float]
    switched_off: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()

    def sentence(self) -> str:
        """The law, and what it leaves out."""
        law = law_name(self.scene)
        words = ", ".join(LAW_WORDS[part] for part in law.split("+"))
        words += ", on the layer" if self.scene.effects.layer == "on" else ""
        losses = [
            f"left out{', as the scene says' if effect in self.switched_off else ''}: "
            f"{EFFECT_WORDS[effect]} ({100 * change:.2g} % of the forces)"
            for effect, change in self.left_out.items()
        ]
        left = "; ".join(losses) or "nothing that acts on them is left out"
        return "; ".join([f"local forces by the law {law} ({words})", left, *self.messages])


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
        ``sphere_profile, adhesion, layer``: relative change of the forces, ``sum |change| / sum |force|``
        over the contacts with a force.
    """
    a, every = contacts["radius_m"], scene.with_effects(dict.fromkeys(EFFECT_WORDS, "on"))

    def forces(*left_out: str) -> Values:
        settings = law_settings(every.with_effects(dict.fromkeys(left_out, "off")))
        pressed, pulled, _ = force_parts(a, sphere_radius, **settings)
        return pressed - pulled

    complete = forces()
    changes = {name: np.abs(complete - forces(name)) for name in EFFECT_WORDS}
    changes["complete"] = np.abs(forces("adhesion") if scene.effects.adhesion == "off" else complete)
    table = pd.DataFrame(changes)
    table[~np.isfinite(complete)] = 0.0
    frames = table.groupby(contacts["frame"].to_numpy()).sum()
    return frames.div(frames.pop("complete"), axis="index").replace(np.inf, 0.0).fillna(0.0)


def law_settings(scene: Scene) -> dict[str, Any]:
    """The keywords of `force_parts` for a scene whose switches are set."""
    elastic, effects = scene.need("elastic", "computing local forces"), scene.effects
    layer = effects.layer == "on" and elastic.thickness is not None
    return {
        "contact_modulus": elastic.contact_modulus,
        "law": effects.law,
        "work_of_adhesion": elastic.work_of_adhesion if effects.adhesion == "on" else 0.0,
        "thickness": elastic.thickness if layer else np.inf,
        "poisson_ratio": elastic.poisson_ratio,
    }


def decide_law(scene: Scene, evidence: pd.DataFrame) -> LawPlan:
    """Decide on the law of the local forces: one for all frames, that which the worst of them calls for.

    Whichever output the scene asks for, the change of the forces counts: the law acts on nothing else.
    ``evidence`` is that of all frames, from `law_evidence`.
    """
    worst = evidence.max().fillna(0.0).to_dict()
    estimates = [EffectEstimate(name, worst[name], "from the measured radii") for name in EFFECT_WORDS]
    decisions, messages = decide(estimates, scene.effects, scene.tolerance)
    switches = {d.effect: "on" if d.on and (d.change > 0 or d.switch == "on") else "off" for d in decisions}
    left_out = {d.effect: d.change for d in decisions if switches[d.effect] == "off" and d.change > 0}
    switched_off = tuple(d.effect for d in decisions if d.switch == "off" and d.effect in left_out)
    others = [text for text in messages if not text.startswith(switched_off)]
    return LawPlan(scene.with_effects(switches), left_out, switched_off, tuple(others))


def force_parts(
    radius: ArrayLike,
    sphere_radius: ArrayLike,
    *,
    contact_modulus: float,
    law: ForceLaw = "hertz",
    work_of_adhesion: float = 0.0,
    thickness: float = np.inf,
    poisson_ratio: float = 0.5,
) -> Values:
    """Force (N) that presses contacts to their radius, the adhesive pull, and their growth with ``ln a``.

    Hertz: ``p = 4 E* a^3/(3 R)``; sphere: ``p = E* [(a^2 + R^2)/2 ln((R + a)/(R - a)) - a R]``; JKR: the pull
    ``sqrt(8 pi w E* a^3)``. On a layer both have the factors of `contactimg.mechanics.layer.layer_factors`.

    Parameters
    ----------
    radius, sphere_radius : array_like, m
        They broadcast.
    contact_modulus : float, Pa
    law : {"hertz", "sphere"}
    work_of_adhesion : float, J/m^2
    thickness : float, m
        Infinite for a half-space. The factors of contacts wider than `LARGEST_RATIO` thicknesses are those of
        this width.
    poisson_ratio : float
        Of the layer.

    Returns
    -------
    ndarray, shape (3, n)
        Pressing force, pull, and the derivative of their difference; NaN where a radius is not known, and by
        the sphere's law for a contact as wide as its sphere.

    Raises
    ------
    InputError
        If there is no such law, or the work of adhesion is negative.

    Examples
    --------
    >>> force_parts([3e-5], 1e-4, contact_modulus=4e6).round(8).tolist()
    [[0.00144], [0.0], [0.00432]]
    """
    if law not in get_args(ForceLaw):
        raise InputError(f'law must be "hertz" or "sphere", got {law!r}')
    w = float(non_negative("work_of_adhesion", work_of_adhesion, "J/m^2"))
    a, R = np.broadcast_arrays(np.asarray(radius, float), np.asarray(sphere_radius, float))
    held = a < (R if law == "sphere" else np.where(np.isfinite(R), np.inf, np.nan))
    parts, caps, a = np.full((3, *a.shape), np.nan), Caps(R[held]), a[held]
    body = {"aspect": float(law == "sphere"), "thickness": thickness, "poisson_ratio": poisson_ratio}
    pressed, whole = AdhesiveLaw(0.0, **body).force(a, caps), AdhesiveLaw(w / contact_modulus, **body)
    growth = a * whole.slopes(a, caps)[0]
    parts[:, held] = contact_modulus * np.stack([pressed, pressed - whole.force(a, caps), growth])
    return parts
