"""Greenwood-Tripp: a rough sphere on an elastic half-space; its asperities obey Greenwood-Williamson.

On each ring the sphere lies at the depth ``x(r) = D - r^2/(2 Rl) - w(r)`` below the highest summits, and the
pressure is ``p = K sqrt(R) eta0 F_{3/2}(x)``, with ``w`` the displacement of the half-space by ``p``. A
pressure piecewise linear between the rings is a superposition of uniform discs, ``w(r) = int -p'(c) W(r, c)
dc``. The displacement ``W`` by a disc of radius ``c`` is a complete elliptic integral, continuous at ``c =
r``; a quadrature graded towards ``c = r`` integrates the logarithm in its slope.

Newton's method on the depths, with the load as one more equation. Dimensionless: lengths along the surface in
Hertz's contact radius, heights in Hertz's indentation, ``E* = 1``.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipe, ellipk

from contactimg.errors import ConvergenceError
from contactimg.mechanics import hertz
from contactimg.models.convergence import refuse_beyond_floats, relative_error
from contactimg.models.dense_balance import Balance, BalanceEquations
from contactimg.models.greenwood_williamson import AsperityLayer, RingSolution, check_rings, ring_weights
from contactimg.models.height_distributions import HeightLaw

Values = NDArray[np.float64]


@refuse_beyond_floats
def solve_greenwood_tripp(
    heights: HeightLaw,
    *,
    density: float,
    radius: float,
    indenter_radius: float,
    contact_modulus: float,
    load: float,
    rings: int = 200,
    tolerance: float = 1e-10,
    max_iterations: int = 30,
) -> RingSolution:
    """Solve for a sphere with random asperities on an elastic half-space: the average of the coupled model.

    Parameters
    ----------
    heights : HeightLaw
        `UniformHeights`, `GaussianHeights` or `SampleHeights`.
    density : float, 1/m^2
    radius : float, m
        Composite radius of the asperities.
    indenter_radius : float, m
    contact_modulus : float, Pa
    load : float, N
        Positive.
    rings : int
        Number of rings; they are denser at the edge of the loaded region, where the pressure falls.
    tolerance : float
        Largest accepted residual, the error of a depth over the largest depth.
    max_iterations : int
        Newton steps before giving up.

    Returns
    -------
    RingSolution

    Raises
    ------
    InputError
        If an argument breaks its rule.
    ConvergenceError
        If the residual stays above the tolerance.

    Notes
    -----
    With 200 rings pressures are right to about 1e-4 of the largest. Every ring obeys Greenwood-Williamson
    to rounding. Hertz's pressure is reached as the roughness vanishes and ``density sqrt(radius)`` grows.

    References
    ----------
    Greenwood, Tripp, J. Appl. Mech. 34 (1967) 153, doi:10.1115/1.3607616; Yashima et al.,
    doi:10.1039/C4SM02346C, section "Multi-asperity contact models".

    Examples
    --------
    >>> from contactimg.models.height_distributions import UniformHeights
    >>> s = solve_greenwood_tripp(
    ...     UniformHeights(30e-6, 60e-6), density=18.45e6, radius=100e-6,
    ...     indenter_radius=0.1288, contact_modulus=4e6, load=0.5,
    ... )
    >>> round(s.indentation * 1e6, 1), round(s.area * 1e6, 3)
    (58.3, 0.857)
    """
    layer = AsperityLayer(heights, density, radius, contact_modulus)
    check_rings(indenter_radius, load, rings)
    scale, taken = _ScaledLayer(layer, indenter_radius, load), 0
    radii, equations, state = scale.start(rings)
    for last in (False, True):
        state, steps = equations.solve(state, tolerance=tolerance, most_steps=max_iterations - taken)
        taken += steps
        if not state.residual <= tolerance:
            raise ConvergenceError(
                f"the rings did not converge: residual {state.residual:.3g} after {steps} Newton steps, "
                f"tolerance {tolerance:.3g}; take more rings, or allow a larger tolerance"
            )
        if not last:
            radii, equations, state = scale.fitted(radii, state)
    r, depth = radii * scale.length, state.variable * scale.height
    displacement = (state.indentation - radii**2 / 2 - state.variable) * scale.height
    weights = ring_weights(r)
    area = float(weights @ layer.area_fraction(depth))
    solution = RingSolution("gt", layer, r, depth, displacement, load, area, taken, state.residual)
    # the equations recomputed in SI units
    lowered = equations.matrix @ (solution.pressure / scale.pressure) * scale.height
    error = state.indentation * scale.height - r**2 / (2 * indenter_radius) - lowered - depth
    errors = {
        "sum of the forces": relative_error(float(weights @ solution.pressure), load),
        "depths": float(np.max(np.abs(error)) / np.max(np.abs(depth))),
    }
    return solution.proved(errors, tolerance)


class _ScaledLayer:
    """The layer in units of the smooth contact: ``x - D + r^2/2 + A p(x) = 0`` and ``v p(x) = 4/3``.

    ``A p`` are the displacements by the pressures of the rings, ``v`` the areas of the rings.

    Hertz's radius ``length`` and indentation ``height`` (m); ``pressure`` is ``E* height/length`` (Pa).
    ``sinking`` is the penetration of the layer under Hertz's peak pressure, ``edge`` the half-width of the
    transition around Hertz's circle (Appendix A's annulus for a gap of ``sinking``), at most 1, ``uncoupled``
    the depth of the uncoupled model at the axis, all in these units.
    """

    def __init__(self, layer: AsperityLayer, indenter_radius: float, load: float) -> None:
        smooth = {"sphere_radius": indenter_radius, "contact_modulus": layer.contact_modulus}
        self.layer, self.length = layer, float(hertz.radius(load, **smooth))
        self.height = self.length**2 / indenter_radius
        self.pressure = layer.contact_modulus * self.height / self.length
        self.sinking = max(float(layer.depth(hertz.peak_pressure(load, **smooth))) / self.height, 1e-12)
        self.edge = min(1.0, (3 * np.pi / (8 * np.sqrt(2)) * self.sinking) ** (2 / 3))
        self.uncoupled = max(layer.deepest(load, indenter_radius) / self.height, 0.0)

    def response(self, depth: Values) -> tuple[Values, Values]:
        """The depths and the pressures there."""
        return depth, self.layer.pressure(depth * self.height) / self.pressure

    def slopes(self, depth: Values) -> tuple[Values, Values]:
        """The derivatives of these by the depth."""
        stiffness = self.layer.stiffness(depth * self.height)
        return np.ones_like(depth), stiffness * (self.height / self.pressure)

    def on_rings(self, r: Values) -> BalanceEquations:
        """The equations of the contacts on given radii."""
        return BalanceEquations(self, _displacement_matrix(r), r**2 / 2, ring_weights(r), 4 / 3)

    def start(self, count: int) -> tuple[Values, BalanceEquations, Balance]:
        """The better of two starts: Hertz's contact with compressed asperities, and the uncoupled model.

        The rings reach to the end of the larger of the two.
        """
        r = _mesh(self.edge, max(1.02 * np.sqrt(2 * self.uncoupled), 1 + 3 * self.edge), count)
        equations, states = self.on_rings(r), []
        smooth = self.sinking * np.maximum(1 - r**2, 0.0) ** 0.2 - hertz.gap(r, radius=1.0, sphere_radius=1.0)
        for depth in (smooth, self.uncoupled - r**2 / 2):
            # the indentation for which the pressure-weighted mean error vanishes
            state = equations.at(depth, 0.0)
            share = equations.weights * (np.maximum(state.force, 1e-12 * state.force.max()) + 1e-300)
            states.append(equations.at(depth, float(share @ state.error / share.sum())))
        return r, equations, min(states, key=lambda state: state.merit)

    def fitted(self, r: Values, state: Balance) -> tuple[Values, BalanceEquations, Balance]:
        """Rings that end just outside the loaded region, with the state interpolated to them."""
        last = int(np.flatnonzero(state.force > 1e-14 * state.force.max())[-1])
        end = 1.02 * r[last + 1] if last + 1 < r.size else 1.5 * r[-1]
        mesh = _mesh(self.edge, max(end, 1 + self.edge), r.size)
        depth = np.interp(mesh, r, state.variable) - np.maximum(mesh**2 - r[-1] ** 2, 0.0) / 2
        equations = self.on_rings(mesh)
        return mesh, equations, equations.at(depth, state.indentation)


def _mesh(edge: float, end: float, count: int) -> Values:
    """Radii from 0 to ``end`` with a spacing proportional to ``edge/3`` plus the distance from 1."""
    if edge >= 0.5:
        return np.linspace(0.0, end, count)
    fine = edge / 3
    place = np.linspace(-np.log1p(1 / fine), np.log1p((end - 1) / fine), count)
    r = 1 + np.sign(place) * fine * np.expm1(np.abs(place))
    r[0] = 0.0
    return r


def _displacement_matrix(r: Values) -> Values:
    """Displacements at radii by piecewise linear pressures given at the same radii."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    s = 0.5 * (nodes + 1)
    place, weight = s**2 * (3 - 2 * s), 3 * s * (1 - s) * weights  # graded towards both ends
    discs = r[:-1, None] + np.diff(r)[:, None] * place
    mean = _disc_displacement(r[:, None, None], discs) @ weight
    matrix = np.zeros((r.size, r.size))
    matrix[:, :-1] += mean  # p falls from ring to ring: -p' dc = (p_j - p_{j+1}) over the interval
    matrix[:, 1:] -= mean
    matrix[:, -1] += _disc_displacement(r, r[-1])
    return matrix


def _disc_displacement(r: Values, c: Values | float) -> Values:
    """Displacement at ``r`` by unit pressure on a disc of radius ``c`` (Johnson, Contact Mechanics, 3.4)."""
    larger = np.maximum(r, c)
    m = np.minimum((np.minimum(r, c) / larger) ** 2, 1 - 1e-15)
    shape, outside = ellipe(m), np.broadcast_to(r > c, m.shape)
    shape[outside] -= (1 - m[outside]) * ellipk(m[outside])
    return 4 / np.pi * larger * shape
