"""How well full coupling itself is known: estimated from its own terms, and by boundary elements.

A tolerance below this error is not reached by any level of the model, and the plan says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from contactimg.effects.mechanics.loaded_scene import LoadedScene

SECOND_ORDER = 4.5
"""Relative error of a contact's force with full coupling over the square of the relative change of its radius
of curvature by the neighbours. Measured: pairs of boundary elements, r/a 2.2 to 3.2, give 4.2 to 5."""

COMPARED = {"area": 2.5e-4, "force": 1.5e-5, "radius": 1.3e-4, "profile": 1.5e-5}
"""Relative difference between full coupling and boundary elements on the pattern SA+ at 0.02-0.5 N, grid of 1
um: the largest. The area's is what the grid resolves; the radius has half of it."""

COMPARED_UNEQUAL = {"area": 2.9e-3, "force": 3.0e-4, "radius": 1.5e-3, "profile": 3.0e-4}
"""The same for caps of unequal radii: boundary elements of RA+ at 0.6 N on 768^2 points differ by 0.29 % of
the area and 0.030 % of the forces, and have not converged; the truth may be nearer."""

EQUAL_RADII_SPREAD = 0.05
"""Standard deviation of the radii over their mean up to which a pattern counts as one of equal caps. Chosen:
SA has 0, RA 0.25 to 0.3; sensitivity none."""


@dataclass(frozen=True)
class ModelError:
    """Relative error of the complete model, as far as it is known.

    Parameters
    ----------
    errors : mapping
        Output -> relative error.
    source : str
        Where the numbers come from.
    """

    errors: Mapping[str, float]
    source: str

    def missed(self, outputs: tuple[str, ...], tolerance: float) -> str:
        """A sentence if an output cannot be promised to a tolerance; else empty."""
        beyond = {name: self.errors[name] for name in outputs if self.errors.get(name, 0.0) > tolerance}
        if not beyond:
            return ""
        worst = ", ".join(f"{name} to {100 * error:.2g} %" for name, error in beyond.items())
        return f"{100 * tolerance:g} % is not reached: the model is known for {worst} ({self.source})"


def estimate_model_error(loaded: LoadedScene) -> ModelError:
    """The error of the complete model at a load."""
    radii = loaded.problem.radius
    equal = float(np.std(radii)) <= EQUAL_RADII_SPREAD * float(np.mean(radii))
    compared, source = (
        (COMPARED, "boundary elements of SA+ at 0.02-0.5 N")
        if equal
        else (COMPARED_UNEQUAL, "boundary elements of RA+, not converged")
    )
    own = _second_order(loaded)
    errors = {name: max(error, own) for name, error in compared.items()}
    if own > compared["force"]:
        source += ", and the square of the curvature of the neighbours' field"
    if loaded.own_law:
        source += f"; for asperities {loaded.own_law} there is no solution to compare with"
    if loaded.adheres:
        source += "; with adhesion there is no solution to compare with"
    return ModelError(errors, source)


def _second_order(loaded: LoadedScene) -> float:
    """What full coupling leaves out of the forces: the mean square of its own change of the curvature."""
    if not loaded.coupled or loaded.engulfed_pair is not None:
        return 0.0
    response, radius, _ = loaded.fully_coupled
    bending = loaded.sample.problem.radius / radius - 1
    total = float(response.force.sum())
    return SECOND_ORDER * float(response.force @ bending**2) / total if total > 0 else 0.0
