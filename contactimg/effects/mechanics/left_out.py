"""What the outputs lose if several mechanical effects are left out together.

Each effect is known by the responses of the approximate state without it and with it. Their differences are
small and add up to first order: the complete state is the approximate one plus what it lacks, and the state
without some effects is the complete one minus their differences.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.mechanics.approximate_state import Response
from contactimg.effects.mechanics.loaded_scene import LoadedScene
from contactimg.effects.output_change import WRITTEN
from contactimg.models.adhesive_asperity_law import AdhesiveLaw
from contactimg.models.asperity_laws import Caps

Pair = tuple[Response, Response]
"""Responses without an effect and with it."""

DOUBTFUL_STEPS = 2.0
"""An asperity may touch with an effect and not without if its penetration is below this many times what the
effect changes. Chosen: the estimates of penetrations are good to a factor of two."""


def _combined(start: Response, pair: Pair, sign: int) -> Response:
    """A response plus (sign 1) or minus (sign -1) the difference that an effect makes."""
    without, complete = pair
    return Response(
        start.force + sign * (complete.force - without.force),
        start.contact_radius + sign * (complete.contact_radius - without.contact_radius),
        start.penetration + sign * (complete.penetration - without.penetration),
        start.indentation + sign * (complete.indentation - without.indentation),
    )


def _touching(response: Response) -> Response:
    """The response with contacts exactly where the penetration is positive."""
    touches = response.penetration > 0
    smallest = np.finfo(float).tiny
    return Response(
        np.where(touches, response.force, 0.0),
        np.where(touches, np.maximum(response.contact_radius, smallest), 0.0),
        response.penetration,
        response.indentation,
    )


@dataclass(frozen=True, eq=False)
class EffectChanges:
    """The changes of the outputs by each effect, alone and together.

    Parameters
    ----------
    loaded : LoadedScene
    pairs : dict
        Effect -> responses without it and with it; effects that do nothing are absent.
    complete : Response
        With every effect.
    alone : dict
        Effect -> output -> relative change if only this effect is left out.
    """

    loaded: LoadedScene
    pairs: dict[str, Pair]
    complete: Response
    alone: dict[str, dict[str, float]]

    @classmethod
    def between(cls, loaded: LoadedScene, pairs: dict[str, Pair | None]) -> "EffectChanges":
        """The changes between pairs of responses; None for an effect that does nothing."""
        acting = {effect: pair for effect, pair in pairs.items() if pair is not None}
        effects, complete = loaded.scene.effects, loaded.with_adhesion
        present = {
            "coupling": loaded.coupled,
            "adhesion": loaded.adheres,
            "layer": effects.layer != "off",
        }
        for effect, pair in acting.items():
            if not present.get(effect, False):
                complete = _combined(complete, pair, 1)
        nothing = dict.fromkeys(WRITTEN, 0.0)
        alone = {effect: nothing | _changes(loaded, acting.get(effect)) for effect in pairs}
        return cls(loaded, acting, complete, alone)

    def together(self, dropped: Collection[str]) -> dict[str, float]:
        """Relative change of each output if some effects are left out; full coupling is part of coupling."""
        left = [name for name in self.pairs if name in dropped]
        if "coupling" in left and "full_coupling" in left:
            left.remove("full_coupling")
        if not left:
            return dict.fromkeys(WRITTEN, 0.0)
        without = self.complete
        for name in left:
            without = _combined(without, self.pairs[name], -1)
        return self.loaded.changes(_touching(without), _touching(self.complete))

    def doubtful(self, effect: str) -> dict[str, float]:
        """What the outputs change by if all contacts that may form or vanish with an effect do."""
        if effect not in self.pairs:
            return {}
        without, complete = self.pairs[effect]
        step = np.abs(complete.penetration - without.penetration)
        near = np.flatnonzero(np.abs(self.complete.penetration) < DOUBTFUL_STEPS * step)
        contacts = int(np.count_nonzero(self.complete.penetration > 0))
        share = near.size / max(contacts, 1)
        found = {"contacts": share, "profile": share}
        return found | (self._jumps(near) if self.loaded.adheres and contacts else {})

    def _jumps(self, rows: NDArray[np.intp]) -> dict[str, float]:
        """What the outputs change by if adhesive contacts form or vanish, with a finite radius (JKR).

        At zero penetration a contact pulls by ``(4/3) pi w R``, which the others bear.
        """
        loaded, there = self.loaded, self.complete.penetration > 0
        caps = loaded.sample.problem.caps
        a, R = self.complete.contact_radius[there], caps.radius[there]
        jump = AdhesiveLaw(loaded.adhesion, 0.0).touch_radius(Caps(caps.radius[rows]))
        pull = float(4 / 3 * np.pi * loaded.adhesion * caps.radius[rows].sum())
        deepest = max(abs(self.complete.indentation), float(np.max(a**2 / R)))
        area = float(np.sum(jump**2) / np.sum(a**2))
        return {
            "area": area,
            "radius": float(np.sqrt(area)),
            "force": 2 * pull / float(np.abs(self.complete.force).sum()),
            "hertz": float(np.sum(jump**3 / caps.radius[rows]) / np.sum(a**3 / R)),
            "indentation": pull / float(2 * a.sum()) / deepest,
        }


def _changes(loaded: LoadedScene, pair: Pair | None) -> dict[str, float]:
    """The changes of the outputs by one effect; none where it does nothing."""
    return {} if pair is None else loaded.changes(*pair)
