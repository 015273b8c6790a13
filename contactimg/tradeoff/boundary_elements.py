"""Solve a case with boundary elements (ContactMechanics, optional: ``pip install contactimg[bem]``).

The rigid height map (parabolic caps on a plane minus the paraboloid of the sphere) is pressed on a half-space
with free boundaries; the pressure is constant on square pixels.
"""

import numpy as np
from numpy.typing import NDArray

from contactimg.errors import ConvergenceError, InputError
from contactimg.models.solution import InteractingSolution
from contactimg.tradeoff.case import Case

Values = NDArray[np.float64]

GRIDS = (128, 256, 512, 1024)
"""Points per side of the grids."""

RESOLUTION = {"force": 1e-5, "area": 5e-4, "radius": 2.5e-4, "profile": 1e-5, "all": 5e-4}
"""Relative error of the stored solution on a grid of ``h`` = 1 um.

Forces: from the differences between grids. Areas: the pixel size adds ``5 h^2/12`` to a mean ``a^2`` of 880
um^2.
"""

GRID_SIDE_FACTOR = 1.1
"""Side of the grid over the side of the loaded region. Chosen by hand; sensitivity not measured."""

PENETRATION_TOLERANCE = 1e-12
"""Allowed penetration over the height of the map. Chosen near rounding error."""

MAX_STEPS = 3000
"""Largest number of iterations. A safety limit, chosen by hand."""


def solve_boundary(case: Case, loaded: InteractingSolution, *, points: int) -> tuple[Values, Values]:
    """Forces and contact radii of all asperities of a case, by boundary elements.

    Parameters
    ----------
    case : Case
        With a half-space, without adhesion; caps are treated as paraboloids.
    loaded : InteractingSolution
        A solution that gives the size of the loaded region.
    points : int
        Points per side of the grid.

    Returns
    -------
    force, radius : ndarray, shape (n,), N and m
        Radii are from the second moment of the pressure, ``a^2 = (5/2) <r^2>`` for a Hertz contact.

    Raises
    ------
    ImportError
        If ContactMechanics is not installed.
    InputError
        If the scene switches on an effect that is not implemented here.
    ConvergenceError
        If the iteration does not converge.
    """
    try:
        from ContactMechanics import FreeFFTElasticHalfSpace  # noqa: PLC0415 - optional
        from ContactMechanics.Systems import NonSmoothContactSystem  # noqa: PLC0415 - optional
        from SurfaceTopography import Topography  # noqa: PLC0415 - optional
    except ImportError:
        raise ImportError("ContactMechanics is not installed: pip install 'contactimg[bem]'") from None
    _refuse_effects(case)
    modulus = case.scene.need("elastic", "boundary elements").contact_modulus
    x, y, owner, height, side = _height_map(case, loaded, points)
    half_space = FreeFFTElasticHalfSpace((points, points), modulus, (side, side))
    system = NonSmoothContactSystem(half_space, Topography(height, physical_sizes=(side, side)))
    result = system.minimize_proxy(
        external_force=case.load, pentol=PENETRATION_TOLERANCE * float(np.ptp(height)), maxiter=MAX_STEPS
    )
    if not result.success:
        raise ConvergenceError(f"boundary elements did not converge in {MAX_STEPS} steps; use a coarser grid")
    force = np.asarray(system.substrate.force)[:points, :points]
    return _collect(x, y, owner, force, count=loaded.force.size)


def _refuse_effects(case: Case) -> None:
    """Raise for effects that are not implemented here."""
    on = [
        name for name in ("adhesion", "layer", "sphere_profile") if getattr(case.scene.effects, name) == "on"
    ]
    if on:
        raise InputError(f"boundary elements here have no {' and no '.join(on)}; switch off to compare")


def _height_map(
    case: Case, loaded: InteractingSolution, points: int
) -> tuple[Values, Values, NDArray[np.intp], Values, float]:
    """Coordinates about the apex, cap on each pixel (-1 for none), heights, and side of the grid."""
    indenter = case.scene.need("indenter", "boundary elements")
    if case.asperities is None:
        raise InputError("the scene has no asperities")
    rows = loaded.touching
    reach = np.maximum(np.abs(loaded.x[rows] - indenter.apex[0]), np.abs(loaded.y[rows] - indenter.apex[1]))
    side = 2 * GRID_SIDE_FACTOR * float((reach + loaded.radius[rows]).max())
    places = side * ((np.arange(points) + 0.5) / points - 0.5)
    height, owner = np.zeros((points, points)), np.full((points, points), -1)
    caps = case.asperities[["x_m", "y_m", "height_m", "radius_m"]].to_numpy(float)
    for row, (x_summit, y_summit, summit, radius) in enumerate(caps):
        centre = x_summit - indenter.apex[0], y_summit - indenter.apex[1]
        base = np.sqrt(2 * radius * summit)
        i, j = (np.flatnonzero(np.abs(places - c) <= base) for c in centre)
        if not (i.size and j.size):
            continue
        part = np.ix_(i, j)
        square = (places[i, None] - centre[0]) ** 2 + (places[None, j] - centre[1]) ** 2
        bump = summit - square / (2 * radius)
        higher = bump > height[part]
        height[part] = np.where(higher, bump, height[part])
        owner[part] = np.where(higher, row, owner[part])
    x, y = np.meshgrid(places, places, indexing="ij")
    if np.isfinite(indenter.radius):
        height -= (x**2 + y**2) / (2 * indenter.radius)
    return x, y, owner, height, side


def _collect(
    x: Values, y: Values, owner: NDArray[np.intp], force: Values, *, count: int
) -> tuple[Values, Values]:
    """Force and radius of each cap from the forces on its pixels."""
    on_caps = owner >= 0
    rows, f = owner[on_caps], force[on_caps]

    def summed(values: Values) -> Values:
        return np.asarray(np.bincount(rows, values, minlength=count), np.float64)

    total = summed(f)
    over = np.where(total > 0, total, 1.0)
    mean_x, mean_y = summed(f * x[on_caps]) / over, summed(f * y[on_caps]) / over
    square = summed(f * (x[on_caps] ** 2 + y[on_caps] ** 2)) / over - mean_x**2 - mean_y**2
    return total, np.sqrt(2.5 * np.maximum(square, 0.0)) * (total > 0)
