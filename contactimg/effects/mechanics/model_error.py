"""How well full coupling itself is known: from its own terms, by solutions of the whole contact problem.

A tolerance below this error is not reached by any level of the model, and the plan says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from contactimg.effects.mechanics.loaded_scene import LoadedScene
from contactimg.effects.output_change import WRITTEN

SECOND_ORDER = {
    "area": 0.27,
    "force": 0.08,
    "radius": 0.25,
    "hertz": 0.4,
    "profile": 0.08,
    "indentation": 0.03,
}
"""Error of full coupling in each output over the mean square of the relative change of the curvature, mean
and saddle, by the neighbours, weighted by the forces. Measured: the largest of RA+, RA-, SA+, flats and pairs
that nearly touch, against solutions of the whole contact problem (`benchmarks/models_truth.py`)."""


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
        worst = ", ".join(f"{100 * error:.2g} % in {WRITTEN[name]}" for name, error in beyond.items())
        return f"{100 * tolerance:g} % is not reached: the model itself errs by about {worst} ({self.source})"


def estimate_model_error(loaded: LoadedScene) -> ModelError:
    """The error of the complete model at a load."""
    squared = _mean_square(loaded)
    source = "estimated from the square of what the neighbours change of the curvatures"
    if loaded.own_law:
        source += f"; for asperities {loaded.own_law} there is no solution to compare with"
    if loaded.adheres:
        source += "; with adhesion compared on pairs and hexagons only"
    return ModelError({name: factor * squared for name, factor in SECOND_ORDER.items()}, source)


def _mean_square(loaded: LoadedScene) -> float:
    """Mean square, weighted by the forces, of the relative change of the curvatures."""
    if not loaded.coupled or loaded.engulfed_pair is not None:
        return 0.0
    force = loaded.state.all_candidates().force
    total = float(force.sum())
    return float(force @ loaded.field_terms.squared) / total if total > 0 else 0.0
