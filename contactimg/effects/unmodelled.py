"""What no switch can compute: by how much finite strain and the slope of the lens change the outputs."""

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.output_change import EffectEstimate, requested_outputs
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]

STRAIN_RATIO = (0.0, 0.052, 0.104, 0.209, 0.314, 0.421, 0.528, 0.637, 0.749)
OVER_HERTZ = (1.0, 0.997, 0.993, 0.988, 0.991, 1.000, 1.024, 1.057, 1.106)
OVER_SPHERE = (1.0, 0.996, 0.988, 0.971, 0.951, 0.926, 0.901, 0.864, 0.808)
"""a/R, and the load of a rigid sphere on incompressible neo-Hookean rubber at this contact radius over that
of Hertz's law and of the exact sphere's: axisymmetric finite elements (`benchmarks/finite_strain.py`), good
to 0.6 %, 1 % at the last. Beyond the table its last value stands for at least that much."""

SLOPE_FACTORS = {"area": 1.0, "force": 0.12}
"""Change of an output by the true geometry of caps on a lens, over the square of the largest slope of the
lens: 0.6 and 0.076 % on RA+ with slopes up to 0.08, from solutions of the whole problem (docs/models.md)."""


def unmodelled_effects(solution: InteractingSolution, *, law: str, output: str) -> tuple[EffectEstimate, ...]:
    """Estimates of the effects that every solution leaves out.

    Parameters
    ----------
    solution : InteractingSolution
        There is no estimate without contacts.
    law : {"hertz", "sphere"}
        That of the solution which is planned.
    output : str
        The output that must be accurate.

    Returns
    -------
    tuple of EffectEstimate
        ``finite_strain``: of area, radii and Hertz forces at the forces of the solution, and of the forces at
        its radii; ``cap_slope``: of area and forces.
    """
    if not solution.touching.size:
        return ()
    rows, (x0, y0) = solution.touching, solution.conditions.apex
    a, R, weight = solution.radius[rows], solution.composite_radius[rows], np.abs(solution.force[rows])
    load = strain_factor(a / R, law)
    area = a**2 * (load ** (-2 / 3) - 1)
    radius = a * (load ** (-1 / 3) - 1)
    strain = {
        "area": abs(float(area.sum() / np.sum(a**2))),
        "radius": float(np.sqrt(np.sum(radius**2) / np.sum(a**2))),
        "hertz": float(np.abs(a**3 / R * (1 / load - 1)).sum() / np.sum(a**3 / R)),
        "force": _unequal(load, weight),
    }
    widest = int(np.argmax(a / R))
    distance = np.hypot(solution.x[rows] - x0, solution.y[rows] - y0)
    slope = float(distance.max() / solution.conditions.indenter_radius)
    tilted = {name: factor * slope**2 for name, factor in SLOPE_FACTORS.items()}
    at = f"a/R up to {a[widest] / R[widest]:.2f}: rubber bears {load[widest]:.3f} of the law's force"
    under = f"slopes of the lens up to {slope:.2g} under the contacts"
    found = []
    for name, reason, changes in (("finite_strain", at, strain), ("cap_slope", under, tilted)):
        change = max(changes.get(wanted, 0.0) for wanted in requested_outputs(output))
        found.append(EffectEstimate(name, change, reason, changes))
    return tuple(found)


def strain_factor(ratio: Values, law: str) -> Values:
    """Load of neo-Hookean rubber at a contact radius over that of a law, at values of a/R.

    Examples
    --------
    >>> strain_factor(np.array([0.0, 0.209]), "sphere").tolist()
    [1.0, 0.971]
    """
    return np.interp(ratio, STRAIN_RATIO, OVER_SPHERE if law == "sphere" else OVER_HERTZ)


def _unequal(factor: NDArray, weight: NDArray) -> float:
    """Mean distance of the factors from their weighted mean, relative to it; 0 without any weight."""
    total = float(weight.sum())
    if not total > 0.0:
        return 0.0
    return float(weight @ np.abs(factor / (weight @ factor / total) - 1) / total)
