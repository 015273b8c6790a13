"""Greenwood-Williamson: independent asperities of random height, under a flat or under a sphere.

Where the other surface lies at a depth ``x`` below the highest summits, ``eta = eta0 F_0(x)`` contacts per
unit area bear the pressure ``p = K sqrt(R) eta0 F_{3/2}(x)`` (`contactimg.models.height_distributions`).
Under a sphere each ring has its own depth ``x``.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError
from contactimg.models import convergence
from contactimg.models.height_distributions import HeightLaw
from contactimg.models.newton_iteration import MAX_DOUBLINGS
from contactimg.models.validity import HERTZ_LIMIT
from contactimg.surfaces import LENGTH_RANGE_M
from contactimg.tables import PROFILE

Values = NDArray[np.float64]


@dataclass(frozen=True)
class AsperityLayer:
    """A nominally flat surface with asperities of equal radius and random height.

    Parameters
    ----------
    heights : HeightLaw
    density : float, 1/m^2
        ``eta0``.
    radius : float, m
        ``R`` of every asperity.
    contact_modulus : float, Pa
        ``E*``; ``K = 4 E*/3``.

    References
    ----------
    Greenwood, Williamson, Proc. R. Soc. A 295 (1966) 300, doi:10.1098/rspa.1966.0242; Yashima et al.,
    doi:10.1039/C4SM02346C, Appendix B.

    Examples
    --------
    For uniform heights of width ``s`` the pressure grows as ``(2/5) K sqrt(R) eta0 x^{5/2}/s``:

    >>> from contactimg.models.height_distributions import UniformHeights
    >>> layer = AsperityLayer(UniformHeights(0.0, 30e-6), density=18e6, radius=100e-6, contact_modulus=4e6)
    >>> round(float(layer.pressure(10e-6)), 3), round(0.4 * 16e6 / 3 * 1e-2 * 18e6 * 1e-5**2.5 / 30e-6, 3)
    (4047.715, 4047.715)
    """

    heights: HeightLaw
    density: float
    radius: float
    contact_modulus: float

    def __post_init__(self) -> None:
        for name in ("density", "radius", "contact_modulus"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name} must be positive, got {value!r}")

    @property
    def strength(self) -> float:
        """Pressure over ``F_{3/2}``: ``K sqrt(R) eta0``."""
        return float(4 / 3 * self.contact_modulus * np.sqrt(self.radius) * self.density)

    def pressure(self, depth: ArrayLike) -> Values:
        """Contact pressure at a depth (m) of the other surface below the highest summits, Pa."""
        return self.strength * self.heights.moment(depth, 1.5)

    def stiffness(self, depth: ArrayLike) -> Values:
        """Rise of the pressure with the depth, Pa/m."""
        return 1.5 * self.strength * self.heights.moment(depth, 0.5)

    def contact_density(self, depth: ArrayLike) -> Values:
        """Contacts per unit area, 1/m^2."""
        return self.density * self.heights.moment(depth, 0)

    def area_fraction(self, depth: ArrayLike) -> Values:
        """Contact area per unit area."""
        return np.pi * self.radius * self.density * self.heights.moment(depth, 1)

    def mean_radius(self, depth: ArrayLike) -> Values:
        """Mean contact radius, m; nan where nothing touches."""
        touching = self.heights.moment(depth, 0)
        total = np.sqrt(self.radius) * self.heights.moment(depth, 0.5)
        return np.where(touching > 0, total / np.where(touching > 0, touching, 1.0), np.nan)

    def strain(self, depth: float) -> float:
        """Mean ``a/R`` of the contacts at a depth, weighted with their forces: ``F_2/(F_{3/2} sqrt(R))``."""
        force = float(self.heights.moment(depth, 1.5))
        return float(self.heights.moment(depth, 2)) / (force * np.sqrt(self.radius)) if force > 0 else 0.0

    def depth(self, pressure: ArrayLike) -> Values:
        """Depth (m) at which the layer bears a positive pressure (Pa), the inverse of `pressure`."""
        return depth_of(self.heights, np.asarray(pressure, dtype=np.float64) / self.strength, 1.5)

    def deepest(self, load: float, indenter_radius: float) -> float:
        """Depth (m) at the axis of a sphere under a load (N), the half-space being rigid."""
        # with x = x0 - r^2/(2 Rl) the sum over rings, int 2 pi r p(x) dr, is 2 pi Rl int p(x) dx
        moment = 2.5 * load / (2 * np.pi * indenter_radius * self.strength)
        return float(depth_of(self.heights, np.array(moment), 2.5))


def depth_of(heights: HeightLaw, value: Values, power: float) -> Values:
    """Depth at which ``F_n`` has a positive value, for ``n > 1``.

    ``F_n`` is convex and grows with the depth, so from a larger depth Newton descends to the root. The depth
    is negative where the value is reached above the top already (Gaussian heights).
    """
    if not np.all(value > 0):
        raise InputError("a depth exists for positive pressures and loads only")
    depth = np.full(np.shape(value), 1e-12 * heights.width + np.finfo(float).tiny)
    for _ in range(MAX_DOUBLINGS):
        if not np.any(short := heights.moment(depth, power) < value):
            break
        depth = np.where(short, 2 * depth, depth)
    for _ in range(200):
        step = (heights.moment(depth, power) - value) / (power * heights.moment(depth, power - 1))
        depth = depth - step
        if np.all(np.abs(step) <= 1e-14 * np.abs(depth)):
            break
    return depth


@dataclass(frozen=True, eq=False)
class RingSolution:
    """Averages over rings around the axis of the sphere at one load.

    Parameters
    ----------
    model : str
        ``"gw"`` or ``"gt"``.
    layer : AsperityLayer
    r : ndarray, m
        Radii of the rings.
    depth : ndarray, m
        Depth of the sphere below the highest summits, which move with the half-space.
    displacement : ndarray, m
        Displacement of the half-space by the pressure; zero for ``"gw"``.
    load : float, N
    area : float, m^2
        Real contact area.
    iterations : int
    residual : float
        Largest error of a depth over the largest depth, or relative error of the load; 0 for ``"gw"``, a
        closed form.
    status : str
        ``"converged"`` if the final numbers have passed every check of `contactimg.models.convergence`;
        otherwise a sentence that says what does not hold.
    """

    model: str
    layer: AsperityLayer
    r: Values
    depth: Values
    displacement: Values
    load: float
    area: float
    iterations: int = 0
    residual: float = 0.0
    status: str = convergence.CONVERGED

    @cached_property
    def pressure(self) -> Values:
        """Pressure of each ring, Pa."""
        return self.layer.pressure(self.depth)

    @cached_property
    def density(self) -> Values:
        """Contacts per unit area, 1/m^2."""
        return self.layer.contact_density(self.depth)

    @cached_property
    def mean_radius(self) -> Values:
        """Mean contact radius, m; nan where nothing touches."""
        return self.layer.mean_radius(self.depth)

    @cached_property
    def area_fraction(self) -> Values:
        """Contact area per unit area."""
        return self.layer.area_fraction(self.depth)

    @property
    def indentation(self) -> float:
        """Indentation from the reference height of the distribution, m."""
        heights = self.layer.heights
        return float(self.depth[0] + self.displacement[0]) - (heights.top - heights.reference)

    @property
    def base_gap(self) -> float:
        """Smallest distance of the sphere from the plane that heights count from; negative if they touch."""
        return self.layer.heights.top - float(self.depth.max())

    @property
    def strain(self) -> float:
        """Mean ``a/R`` of the contacts, weighted with their forces, at the axis."""
        return self.layer.strain(float(self.depth.max()))

    def proved(self, errors: dict[str, float], tolerance: float = 0.0) -> "RingSolution":
        """The solution with its status, once its numbers are finite and the errors are small."""
        names = ("r", "depth", "pressure", "density", "area_fraction", "indentation", "area")
        convergence.check_finite({name.replace("_", " "): getattr(self, name) for name in names})
        return replace(self, status=convergence.judge(errors, tolerance))

    def limits(self) -> list[str]:
        """One sentence for each assumption of the model that does not hold."""
        sentences = []
        if self.strain > HERTZ_LIMIT:
            sentences.append(
                f"at the axis the load is borne at a mean a/R of {self.strain:.2f}, above {HERTZ_LIMIT}: "
                "beyond Hertz's law"
            )
        if self.base_gap < 0:
            sentences.append(
                f"the planes touch: at the axis the lens lies {-self.base_gap * 1e6:.3g} um below the plane "
                f"of the asperities, and on {self.touching_share:.2g} of the base within the nominal contact"
                "; the load that they carry is left out"
            )
        return sentences

    @property
    def touching_share(self) -> float:
        """Share of the base within the loaded region that touches."""
        touching = self.r[self.depth > self.depth.max() + self.base_gap]
        loaded = self.r[self.pressure > 0]
        return float((touching.max(initial=0.0) / loaded.max(initial=self.r[-1] * 1e-9)) ** 2)

    def profile(self, frame: str = "") -> pd.DataFrame:
        """The rings as a table of the schema `PROFILE`."""
        columns = {
            "r_m": self.r,
            "pressure_Pa": self.pressure,
            "density_per_m2": self.density,
            "mean_radius_m": self.mean_radius,
            "area_fraction": self.area_fraction,
        }
        return PROFILE.conform(pd.DataFrame(columns).assign(frame=frame, model=self.model))


def ring_weights(r: Values) -> Values:
    """Quadrature weights at the radii: ``int 2 pi r f dr``, exact for piecewise linear ``f``."""
    width = np.diff(r)
    weights = np.zeros_like(r)
    weights[:-1] += np.pi * width * (2 * r[:-1] + r[1:]) / 3
    weights[1:] += np.pi * width * (r[:-1] + 2 * r[1:]) / 3
    return weights


@convergence.refuse_beyond_floats
def solve_greenwood_williamson(
    heights: HeightLaw,
    *,
    density: float,
    radius: float,
    indenter_radius: float,
    contact_modulus: float,
    load: float,
    rings: int = 400,
) -> RingSolution:
    """Independent random asperities under a sphere: the average of the uncoupled model.

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

    Returns
    -------
    RingSolution

    Raises
    ------
    InputError
        If an argument breaks its rule.

    Examples
    --------
    >>> from contactimg.models.height_distributions import UniformHeights
    >>> s = solve_greenwood_williamson(
    ...     UniformHeights(30e-6, 60e-6), density=18.45e6, radius=100e-6,
    ...     indenter_radius=0.1288, contact_modulus=4e6, load=0.5,
    ... )
    >>> round(s.indentation * 1e6, 2), round(s.load, 9)
    (30.94, 0.5)
    """
    layer = AsperityLayer(heights, density, radius, contact_modulus)
    check_rings(indenter_radius, load, rings)
    deepest = layer.deepest(load, indenter_radius)
    reach = max(deepest, 0.01 * heights.width)
    place = np.linspace(0.0, 1.0, rings)
    r = np.sqrt(2 * indenter_radius * reach) * place
    force = 2 * np.pi * indenter_radius * layer.strength * float(heights.moment(deepest, 2.5)) / 2.5
    area = np.pi**2 * indenter_radius * radius * density * float(heights.moment(deepest, 2))
    depth = deepest - reach * place**2  # 0 at the end of a loaded region, without a rounding error
    solution = RingSolution("gw", layer, r, depth, np.zeros_like(r), load, area)
    return solution.proved({"sum of the forces": convergence.relative_error(force, load)})


def check_rings(indenter_radius: float, load: float, rings: int) -> None:
    """Refuse arguments for which there is no ring solution."""
    if not (np.isfinite(indenter_radius) and indenter_radius > 0):
        raise InputError(f"indenter_radius must be positive and finite, got {indenter_radius!r} m")
    if not (np.isfinite(load) and load > 0):
        raise InputError(f"load must be positive, got {load!r} N")
    convergence.check_range("indenter_radius", indenter_radius, LENGTH_RANGE_M, "m")
    convergence.check_range("load", load, convergence.LOAD_RANGE_N, "N")
    if rings < 8:
        raise InputError(f"rings must be at least 8, got {rings!r}")
