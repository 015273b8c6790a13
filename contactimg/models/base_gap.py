"""The gap between the lens and the base plane of the asperities, anywhere between the caps.

The undeformed lens, lowered by the indentation, minus the surface of the rubber, displaced by all contacts:

    gap(x, y) = h + r^2/(2 Rl) - z(x, y) - D + sum_i u_i,

with ``h`` the height of the lens's apex at first touch, ``z`` the shape of the sample and ``u_i`` the
displacement by the pressure of contact ``i``. Where it is negative the base planes touch, and the model
lacks the load that they carry. Below the caps there is no gap between planes. Outside them the gap has no
maximum, and a minimum in each hollow: it is evaluated with point forces on a grid, and the lowest places are
followed to their minima with the full displacement by Hertz's pressure.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.errors import InputError
from contactimg.models.conditions import ContactConditions
from contactimg.models.coupling import Kernel, displacement_excess, layer_deficit
from contactimg.models.fast_coupling import FastCoupling
from contactimg.timings import stage

Values = NDArray[np.float64]

NODES_PER_SPACING = 2.0
"""Nodes of the grid along the mean spacing of the caps. Chosen: one hollow holds a few."""

FEWEST_NODES, MOST_REFINEMENTS = 24, 4
"""Nodes along the longer side at least, and halvings of the grid until some node lies between caps."""

BOX_MARGIN = 3.0
"""Mean spacings about the places that the lens can have reached. Chosen: some node in between is free."""

FOLLOWED, STEP_HALVINGS = 16, 5
"""Places that are followed to their minimum, and halvings of the step on the way. Measured on RA-, RA+ and
SA: twice as many find the same minimum to 1 nm."""

MAX_TOUCHING_SHARE = 0.5
"""Share of the base within the nominal contact that may touch. Chosen: beyond, the contacts of the asperities
are no longer what bears the load."""

NEARLY_COVERED, RIM_PLACES = 1.3, 6
"""Base radius over contact radius from which on no place next to a cap is looked at, and places about one.
Chosen: Hertz's gap at 1.3 contact radii is a tenth of the penetration."""

MOST_PAIRS = 3e7
"""Pairs of a node and a contact that are summed one by one. Chosen by time: 0.05 s."""

SUM_ACCURACY = 1e-4
"""Relative accuracy of the sums on the grid beyond."""


@dataclass(frozen=True)
class BaseGap:
    """Smallest gap between the base planes, and where it is; NaN if no plane is left between the caps.

    Attributes
    ----------
    least : float, m
        Negative where the planes touch.
    x, y : float, m
    touching_share : float
        Share of the base within the nominal contact, the circle about the contacts, at which planes touch.
    """

    least: float
    x: float
    y: float
    touching_share: float

    @property
    def beyond_models(self) -> bool:
        """Whether so much of the base touches that a model of asperities has no meaning."""
        return self.touching_share > MAX_TOUCHING_SHARE

    @property
    def sentence(self) -> str:
        """Sentence on base planes that touch: the place, the depth and the share of the base."""
        return (
            f"the planes touch: between the asperities, at ({self.x * 1e3:.4g}, {self.y * 1e3:.4g}) mm, the "
            f"lens lies {-self.least * 1e6:.3g} um below the rubber, and on {self.touching_share:.2g} of the "
            "base within the nominal contact; the load that they carry is left out"
        )


@dataclass(frozen=True, eq=False)
class GapField:
    """The gap as a function of the place, in SI units.

    Parameters
    ----------
    conditions : ContactConditions
    indentation, first_touch : float, m
        ``D`` and ``h``.
    discs : ndarray, shape (3, n), m
        Positions of the caps and radii of the discs that they cover.
    rows : ndarray of int
        The caps in contact.
    contacts : ndarray, shape (4, m)
        Positions, forces (N) and radii of their contacts, lengths in m.
    base : ndarray or None
        Height of the sample below each cap where it is not flat, m.
    """

    conditions: ContactConditions
    indentation: float
    first_touch: float
    discs: Values
    rows: NDArray[np.intp]
    contacts: Values
    base: Values | None = None

    @cached_property
    def _base_terms(self) -> Values:
        """Coefficients of 1, x, y, x^2, x y, y^2 about the apex, of the sample's shape and of the lens."""
        lens = 0.5 / self.conditions.indenter_radius
        terms = np.array([self.first_touch - self.indentation, 0.0, 0.0, lens, 0.0, lens])
        if self.base is not None:
            size = float(np.ptp(self.discs[:2], axis=1).max()) or 1.0
            dx, dy = (self.discs[:2] - np.array(self.conditions.apex)[:, None]) / size
            powers = np.stack([np.ones_like(dx), dx, dy, dx**2, dx * dy, dy**2], axis=1)
            shape = np.linalg.lstsq(powers, self.base, rcond=None)[0]
            terms -= shape / size ** np.array([0, 1, 1, 2, 2, 2])
        return terms

    @cached_property
    def _sources(self) -> tuple[Values, Values, Values]:
        """Positions of the contacts and their forces over ``E*``."""
        x, y, force, _ = self.contacts
        return x, y, force / self.conditions.contact_modulus

    @cached_property
    def _kernel(self) -> Kernel:
        return Kernel.of_thickness(self.conditions.thickness, self.conditions.poisson_ratio)

    def undeformed(self, x: Values, y: Values) -> Values:
        """The gap without the displacement of the rubber."""
        dx, dy = x - self.conditions.apex[0], y - self.conditions.apex[1]
        c = self._base_terms
        return c[0] + dx * (c[1] + c[3] * dx + c[4] * dy) + dy * (c[2] + c[5] * dy)

    @property
    def _largest_rise(self) -> float:
        """Largest rise of the rubber, m: infinite where contacts pull."""
        force = self._sources[2]
        if force.min(initial=0.0) < 0:
            return np.inf
        return self._kernel.largest_rise() * float(force.sum()) / np.pi

    def _with_point_forces(self, places: Values) -> Values:
        """The gap at places with the displacement by point forces."""
        x, y = places
        return self.undeformed(x, y) + self._displacement(x, y)

    def _displacement(self, x: Values, y: Values) -> Values:
        """Displacement of the rubber by point forces."""
        sx, sy, force = self._sources
        k = self._kernel
        if x.size * sx.size > MOST_PAIRS:
            both = np.concatenate([sx, x]), np.concatenate([sy, y])
            try:
                sums = FastCoupling(*both, k, SUM_ACCURACY)
            except InputError:  # so unevenly spread that the modes would not fit into memory
                pass
            else:
                return sums.displacement(np.concatenate([force, np.zeros_like(x)]))[sx.size :]
        return k.displacement(x, y, np.stack([sx, sy]), force)

    @stage("base gap")
    def smallest(self) -> BaseGap:
        """The smallest gap within the rectangle of the caps and the apex of the lens."""
        nothing = BaseGap(np.nan, np.nan, np.nan, 0.0)
        if not self.discs.size:
            return nothing
        x, y, step = self._free_nodes()
        if not x.size:
            return nothing
        free = np.stack([x, y])
        some = np.argsort(self.undeformed(*free))[:: max(1, x.size // 64)]
        bound = max(float(self._with_point_forces(free[:, some]).min()), 0.0)
        near = np.flatnonzero(self.undeformed(*free) <= bound + self._largest_rise)
        gap = self._with_point_forces(free[:, near])
        places = np.concatenate([free[:, near[np.argsort(gap)[:FOLLOWED]]], self._rims()], axis=1)
        contacts = np.stack([*self._sources, self.contacts[3]])
        low, high = self._box[:, :1], self._box[:, 1:]
        contacts[2] /= np.pi
        found = _follow(
            places,
            0.5 * step * 0.5 ** np.arange(STEP_HALVINGS),
            np.concatenate([self._box.ravel(), self.conditions.apex, self._base_terms]),
            self.discs[
                :,
                ((self.discs[:2] + self.discs[2] >= low) & (self.discs[:2] - self.discs[2] <= high)).all(
                    axis=0
                ),
            ],
            contacts,
            (self._kernel.thinness, self._kernel.value, self._kernel.slope),
        )
        best = int(np.argmin(found[2]))
        px, py, least = (float(part[best]) for part in found)
        return BaseGap(least, px, py, self._share(x, y, near[gap < 0]) if least < 0 else 0.0)

    def _rims(self) -> Values:
        """Places just outside caps that their contact nearly covers, where the gap falls with the load.

        A contact that is wider than its cap reaches the plane about it.
        """
        covered = self.discs[2, self.rows] / self.contacts[3]
        low = np.argsort(covered)[:FOLLOWED]
        low = low[covered[low] < NEARLY_COVERED]
        turn = 2 * np.pi / RIM_PLACES * np.arange(RIM_PLACES)
        around = np.stack([np.cos(turn), np.sin(turn)])[:, :, None] * (1 + 1e-9)
        discs = self.discs[:, self.rows[low]]
        return (discs[:2, None] + around * discs[2]).reshape(2, -1)

    @cached_property
    def _spacing(self) -> float:
        """Mean spacing of the caps, m."""
        sides = np.ptp(self._rectangle, axis=1)
        area = max(float(np.prod(sides)), 1e-12 * float(sides.max()) ** 2)
        return float(np.sqrt(area / self.discs.shape[1]))

    @cached_property
    def _rectangle(self) -> Values:
        """Limits in x and in y of the discs of all caps and of the apex."""
        apex, radius = self.conditions.apex, self.discs[2]
        low = np.minimum((self.discs[:2] - radius).min(axis=1), apex)
        return np.stack([low, np.maximum((self.discs[:2] + radius).max(axis=1), apex)], axis=1)

    @cached_property
    def _box(self) -> Values:
        """The part of the rectangle in which the smallest gap can be.

        A load that only presses lowers the gap everywhere: it is nowhere larger than before the load.
        """
        box, lens = self._rectangle, self.conditions.indenter_radius
        if self.base is not None or np.isinf(lens) or self.contacts[2].min(initial=0.0) < 0:
            return box
        reach = np.sqrt(2 * lens * max(self.indentation, 0.0)) + BOX_MARGIN * self._spacing
        apex = np.array(self.conditions.apex)[:, None]
        return np.clip(box, apex - reach, apex + reach)

    def _free_nodes(self) -> tuple[Values, Values, float]:
        """Nodes of a grid that no cap covers, and its step."""
        sides = np.ptp(self._box, axis=1)
        step = min(self._spacing / NODES_PER_SPACING, float(sides.max()) / FEWEST_NODES)
        if not step > 0:
            return np.zeros(0), np.zeros(0), 0.0
        for _ in range(MOST_REFINEMENTS):
            free = np.ones(tuple((sides / step).astype(int) + 1), dtype=np.bool_)
            _cover(free, self._box[:, 0], step, self.discs)
            if free.any():
                break
            step /= 2
        x, y = self._box[:, :1] + step * np.stack(np.nonzero(free))
        return x, y, step

    def _share(self, x: Values, y: Values, touching: NDArray[np.intp]) -> float:
        """Share of the places within the circle about the contacts that touch, 1 if there are none."""
        places, size = self.contacts[:2], self.contacts[3] ** 3
        if not size.any():
            return 1.0
        middle = places @ size / size.sum()
        reach = float(np.hypot(*(places - middle[:, None])).max())
        inside = np.hypot(x - middle[0], y - middle[1]) <= reach
        return float(inside[touching].sum() / inside.sum()) if inside.any() else 1.0


@njit(cache=True)
def _cover(free, corner, step, discs):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Clear the nodes of a grid that lie in any disc."""
    for k in range(discs.shape[1]):
        x, y, b = discs[0, k] - corner[0], discs[1, k] - corner[1], discs[2, k]
        for i in range(max(int((x - b) / step), 0), min(int((x + b) / step) + 1, free.shape[0])):
            for j in range(max(int((y - b) / step), 0), min(int((y + b) / step) + 1, free.shape[1])):
                if (i * step - x) ** 2 + (j * step - y) ** 2 < b * b:
                    free[i, j] = False


@njit(cache=True)
def _gap_at(px, py, bare, caps, contacts, layer):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """The gap at one place, with Hertz's pressure of each contact; infinite outside the box and below a cap.

    ``bare`` holds the limits of the box, the apex and the terms of the undeformed gap.
    """
    if px < bare[0] or px > bare[1] or py < bare[2] or py > bare[3]:
        return np.inf
    for k in range(caps.shape[1]):
        dx, dy = px - caps[0, k], py - caps[1, k]
        if dx * dx + dy * dy < caps[2, k] * caps[2, k]:
            return np.inf
    dx, dy = px - bare[4], py - bare[5]
    gap = bare[6] + dx * (bare[7] + bare[9] * dx + bare[10] * dy) + dy * (bare[8] + bare[11] * dy)
    thinness, value, slope = layer
    for k in range(contacts.shape[1]):
        dx, dy = px - contacts[0, k], py - contacts[1, k]
        r, strength = np.sqrt(dx * dx + dy * dy), contacts[2, k]
        if r > 0.0:
            gap += strength / r * (1.0 + displacement_excess(contacts[3, k] / r))
        if thinness > 0.0:
            gap -= strength * layer_deficit(r, thinness, value, slope)[0]
    return gap


@njit(cache=True)
def _follow(places, steps, bare, caps, contacts, layer):  # type: ignore[no-untyped-def]  # noqa: PLR0917  # pragma: no cover
    """Places moved along x and y, in smaller and smaller steps, while the gap falls; with their gaps."""
    result = np.empty((3, places.shape[1]))
    for k in range(places.shape[1]):
        x, y = places[:, k]
        best = _gap_at(x, y, bare, caps, contacts, layer)
        for step in steps:
            moved = True
            while moved:
                moved = False
                for dx, dy in ((step, 0.0), (0.0, step), (-step, 0.0), (0.0, -step)):
                    trial = _gap_at(x + dx, y + dy, bare, caps, contacts, layer)
                    if trial < best:
                        x, y, best, moved = x + dx, y + dy, trial, True
        result[:, k] = x, y, best
    return result
