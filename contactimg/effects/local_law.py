"""The law of local force for measured contacts, and the forces by it.

What Hertz's formula would leave out decides.
The same switches as for a prediction, ``sphere_profile`` and ``adhesion``, and the same tolerance; here the
radii are measured, so that each change is known without solving anything.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.effects.output_change import EffectEstimate
from contactimg.effects.plan import decide
from contactimg.errors import InputError
from contactimg.mechanics import hertz, sphere
from contactimg.mechanics.checks import non_negative
from contactimg.mechanics.layer import LARGEST_RATIO, layer_factors
from contactimg.scene import Scene

Values = NDArray[np.float64]

LAW_WORDS = {"hertz": "Hertz", "sphere": "Hertz with the exact profile of a sphere", "jkr": "JKR adhesion"}
"""Part of the name of a law -> what it means."""

EFFECT_WORDS = {"sphere_profile": "the exact profile of the sphere", "adhesion": "adhesion"}
"""Effect on the local forces -> what it is called in a sentence."""

HERTZ_EXPONENT = 3.0
"""Theory: p ~ a^3 (Hertz)."""

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
        ``sphere_profile, adhesion``: relative change of the forces, ``sum |change| / sum |force|`` over the
        contacts with a force; ``radius_m``: the largest one.
    """
    elastic = scene.need("elastic", "computing local forces")
    a, modulus = contacts["radius_m"].to_numpy(float), elastic.contact_modulus
    parabola = pressing_force(a, sphere_radius, contact_modulus=modulus)
    exact = pressing_force(a, sphere_radius, contact_modulus=modulus, law="sphere")
    pull = adhesive_pull(a, contact_modulus=modulus, work_of_adhesion=elastic.work_of_adhesion)
    complete = exact - (0.0 if scene.effects.adhesion == "off" else pull)
    forces = np.abs(np.column_stack([exact - parabola, pull, complete]))
    forces[~np.isfinite(complete)] = 0.0
    table = pd.DataFrame(forces, columns=["sphere_profile", "adhesion", "complete"])
    frames = table.groupby(contacts["frame"].to_numpy()).sum()
    changes = frames.div(frames.pop("complete"), axis="index").replace(np.inf, 0.0).fillna(0.0)
    return changes.assign(radius_m=contacts.groupby("frame")["radius_m"].max())


def decide_law(scene: Scene, evidence: pd.DataFrame) -> LawPlan:
    """Decide on the law of the local forces: one for all frames, that which the worst of them calls for.

    ``evidence`` is that of all frames, from `law_evidence`.
    """
    elastic, worst = scene.need("elastic", "computing local forces"), evidence.max().fillna(0.0).to_dict()
    estimates = []
    for name in EFFECT_WORDS:
        changes = dict.fromkeys(("force", "profile"), worst[name])
        estimates.append(EffectEstimate(name, worst[name], "from the measured radii", changes))
    decisions, messages = decide(estimates, scene.effects, scene.tolerance)
    switches = {d.effect: "on" if d.on and (d.change > 0 or d.switch == "on") else "off" for d in decisions}
    left_out = {d.effect: d.change for d in decisions if switches[d.effect] == "off" and d.change > 0}
    switched_off = tuple(d.effect for d in decisions if d.switch == "off" and d.effect in left_out)
    others = [text for text in messages if not text.startswith(switched_off)]
    if elastic.thickness is not None:
        ratio = worst["radius_m"] / elastic.thickness
        pressing, _ = layer_factors(min(ratio, LARGEST_RATIO), poisson_ratio=elastic.poisson_ratio)
        if (error := float(1 - 1 / pressing)) > scene.tolerance.relative:
            others.append(
                f"contact radii reach {ratio:.2g} of the layer's thickness: the support under a contact "
                "itself is not in the law, and forces are low by "
                f"{'more than' if ratio > LARGEST_RATIO else 'up to'} {100 * error:.2g} %"
            )
    return LawPlan(scene.with_effects(switches), left_out, switched_off, tuple(others))


def pressing_force(
    radius: ArrayLike, sphere_radius: ArrayLike, *, contact_modulus: float, law: ForceLaw = "hertz"
) -> Values:
    """Force (N) that presses contacts to their radius, without adhesion.

    Hertz: ``p = 4 E* a^3/(3 R)``; sphere: ``p = E* [(a^2 + R^2)/2 ln((R + a)/(R - a)) - a R]``.

    Parameters
    ----------
    radius, sphere_radius : array_like, m
        They broadcast.
    contact_modulus : float, Pa
    law : {"hertz", "sphere"}

    Returns
    -------
    ndarray
        NaN where a radius is not known, and by the sphere's law for a contact as wide as its sphere.

    Raises
    ------
    InputError
        If there is no such law.

    Examples
    --------
    >>> pressing_force([3e-5], 1e-4, contact_modulus=4e6).round(8)
    array([0.00144])
    """
    if law not in ("hertz", "sphere"):
        raise InputError(f'law must be "hertz" or "sphere", got {law!r}')
    a, R = np.broadcast_arrays(np.asarray(radius, float), np.asarray(sphere_radius, float))
    known, force = np.isfinite(a) & np.isfinite(R), np.full(a.shape, np.nan)
    if law == "sphere":
        known &= np.where(known, a, 0.0) < np.where(known, R, 1.0)
        force[known] = contact_modulus * R[known] ** 2 * sphere.scaled_load(a[known] / R[known])
    else:
        force[known] = hertz.load(a[known], sphere_radius=R[known], contact_modulus=contact_modulus)
    return force


def force_exponents(radius: ArrayLike, sphere_radius: ArrayLike, *, law: ForceLaw = "hertz") -> Values:
    """Exponent ``d ln p/d ln a`` of the force law at each contact: 3 for Hertz, more for the sphere.

    Parameters
    ----------
    radius, sphere_radius : array_like, m
        They broadcast.
    law : {"hertz", "sphere"}

    Returns
    -------
    ndarray
        NaN where a radius is not known, or where the law gives no force (a contact as wide as its sphere).

    Examples
    --------
    >>> force_exponents([1e-6, 5e-5], 1e-4, law="sphere").round(3)
    array([3.   , 3.258])
    """
    a, R = np.broadcast_arrays(np.asarray(radius, float), np.asarray(sphere_radius, float))
    exponent = np.where(np.isfinite(a) & np.isfinite(R), HERTZ_EXPONENT, np.nan)
    if law == "sphere":
        ratio = np.where(np.isfinite(exponent), a, 0.0) / np.where(np.isfinite(exponent), R, 1.0)
        inside = (ratio > 0) & (ratio < 1)
        s = ratio[inside]
        # dP/ddelta = 2 E* a and ddelta/da = atanh(s) + s/(1 - s^2), s = a/R
        exponent[inside] = 2 * s**2 * (np.arctanh(s) + s / (1 - s**2)) / sphere.scaled_load(s)
        exponent[ratio >= 1] = np.nan
    return exponent


def adhesive_pull(radius: ArrayLike, *, contact_modulus: float, work_of_adhesion: float) -> Values:
    """Force (N) by which adhesion reduces the load on a contact: ``sqrt(8 pi w E* a^3)`` (JKR).

    Parameters
    ----------
    radius : array_like, m
    contact_modulus : float, Pa
    work_of_adhesion : float, J/m^2

    Examples
    --------
    >>> adhesive_pull([2e-5], contact_modulus=4e6, work_of_adhesion=0.05).round(7)
    array([0.0002005])
    """
    w = non_negative("work_of_adhesion", work_of_adhesion, "J/m^2")
    return np.sqrt(8 * np.pi * w * contact_modulus * np.asarray(radius, float) ** 3)
