"""The gap between the lens and the base plane of the asperities, anywhere between the caps.

The undeformed lens, lowered by the indentation, minus the surface of the rubber, displaced by all contacts:

    gap(x, y) = h + r^2/(2 Rl) - D + sum_i u_i,

with ``h`` the height of the lens's apex at first touch and ``u_i`` the displacement by the pressure of
contact ``i``. Where it is negative the base planes touch, and the model
lacks the load that they carry. Below the caps there is no gap between planes. Outside them the gap has no
maximum, and a minimum in each hollow: it is evaluated with point forces on a grid, and the lowest places are
followed to their minima with the full displacement by Hertz's pressure.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.errors import InputError
from contactimg.models.conditions import CELLS_PER_SPACING, ContactConditions
from contactimg.models.coupling import Kernel, displacement_excess, layer_deficit
from contactimg.models.fast_coupling import SINGLE_ACCURACY, FastCoupling

Values = NDArray[np.float64]


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
        Positions, forces (N) and radii of their contacts, lengths in m; point forces around the table, whose
        radius is zero, come after them.
    """

    conditions: ContactConditions
    indentation: float
    first_touch: float
    discs: Values
    rows: NDArray[np.intp]
    contacts: Values

    @cached_property
    def _force(self) -> Values:
        """The forces over ``E*``."""
        return self.contacts[2] / self.conditions.contact_modulus

    @cached_property
    def _kernel(self) -> Kernel:
        return Kernel.of_thickness(self.conditions.thickness, self.conditions.poisson_ratio)

    def undeformed(self, places: Values) -> Values:
        """The gap at places (2, k) without the displacement of the rubber."""
        away = places - np.array(self.conditions.apex)[:, None]
        lens = np.sum(away**2, axis=0) / (2 * self.conditions.indenter_radius)
        return self.first_touch - self.indentation + lens

    def with_point_forces(self, places: Values) -> Values:
        """The gap at places (2, k) with the displacement by point forces."""
        k, force, sources = self._kernel, self._force, self.contacts[:2]
        if places.shape[1] * force.size > MOST_PAIRS:
            both = np.concatenate([sources, places], axis=1)
            with suppress(InputError):  # so unevenly spread that the modes would not fit into memory
                sums = FastCoupling(both[0], both[1], k, SINGLE_ACCURACY)
                padded = np.pad(force, (0, places.shape[1]))
                return self.undeformed(places) + sums.displacement(padded)[force.size :]
        return self.undeformed(places) + k.displacement(places[0], places[1], sources, force)

    def smallest(self) -> BaseGap:
        """The smallest gap within the rectangle of the caps and the apex of the lens."""
        free, step = (np.zeros((2, 0)), 0.0) if not self.discs.size else self._free_nodes()
        if not free.size:
            return BaseGap(np.nan, np.nan, np.nan, 0.0)
        force, k, bare = self._force, self._kernel, self.undeformed(free)
        rise = np.inf if force.min(initial=0.0) < 0 else k.largest_rise() * float(force.sum()) / np.pi
        some = np.argsort(bare)[:: max(1, bare.size // 64)]
        bound = max(float(self.with_point_forces(free[:, some]).min()), 0.0)
        near = np.flatnonzero(bare <= bound + rise)
        gap = self.with_point_forces(free[:, near])
        places = np.concatenate([free[:, near[np.argsort(gap)[:FOLLOWED]]], self._rims()], axis=1)
        low, high = self._box.T[:, :, None]
        middles, reach = self.discs[:2], self.discs[2]
        apex, lens = self.conditions.apex, 0.5 / self.conditions.indenter_radius
        steps = 0.5 * step * 0.5 ** np.arange(STEP_HALVINGS)
        bare = np.array([*self._box.ravel(), *apex, *self.undeformed(np.array([apex]).T), lens])
        caps = self.discs[:, ((middles + reach >= low) & (middles - reach <= high)).all(axis=0)]
        contacts = np.stack([*self.contacts[:2], force / np.pi, self.contacts[3]])
        found = _follow(places, steps, bare, caps, contacts, (k.thinness, k.value, k.slope))
        best = int(np.argmin(found[2]))
        x, y, least = (float(part[best]) for part in found)
        return BaseGap(least, x, y, self._share(free, near[gap < 0]) if least < 0 else 0.0)

    def _rims(self) -> Values:
        """Places just outside caps that their contact nearly covers, where the gap falls with the load.

        A contact that is wider than its cap reaches the plane about it.
        """
        covered = self.discs[2, self.rows] / self.contacts[3, : self.rows.size]
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
        if np.isinf(lens) or self.contacts[2].min(initial=0.0) < 0:
            return box
        reach = np.sqrt(2 * lens * max(self.indentation, 0.0)) + BOX_MARGIN * self._spacing
        apex = np.array(self.conditions.apex)[:, None]
        return np.clip(box, apex - reach, apex + reach)

    def _free_nodes(self) -> tuple[Values, float]:
        """Nodes (2, k) of a grid that no cap covers, and its step."""
        sides = np.ptp(self._box, axis=1)
        step = min(self._spacing / CELLS_PER_SPACING, float(sides.max()) / FEWEST_NODES)
        for _ in range(MOST_REFINEMENTS if step > 0 else 0):
            free = np.ones(tuple((sides / step).astype(int) + 1), dtype=np.bool_)
            _cover(free, self._box[:, 0], step, self.discs)
            if free.any():
                return self._box[:, :1] + step * np.stack(np.nonzero(free)), step
            step /= 2
        return np.zeros((2, 0)), step

    def _share(self, places: Values, touching: NDArray[np.intp]) -> float:
        """Share of the places within the circle about the contacts that touch, 1 if there are none."""
        own = self.contacts[:, : self.rows.size]
        if not own.size:
            return 1.0
        size = own[3] ** 3
        middle = (own[:2] @ size / size.sum())[:, None]
        inside = np.hypot(*(places - middle)) <= float(np.hypot(*(own[:2] - middle)).max())
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

    ``bare`` holds the limits of the box, the apex, the undeformed gap there and half the lens's curvature.
    """
    if px < bare[0] or px > bare[1] or py < bare[2] or py > bare[3]:
        return np.inf
    for k in range(caps.shape[1]):
        dx, dy = px - caps[0, k], py - caps[1, k]
        if dx * dx + dy * dy < caps[2, k] * caps[2, k]:
            return np.inf
    dx, dy = px - bare[4], py - bare[5]
    gap = bare[6] + bare[7] * (dx * dx + dy * dy)
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
        x, y = places[0, k], places[1, k]
        best = _gap_at(x, y, bare, caps, contacts, layer)
        for step in steps:
            moved = True
            while moved:
                moved = False
                for dx, dy in ((step, 0.0), (0.0, step), (-step, 0.0), (0.0, -step)):
                    trial = _gap_at(x + dx, y + dy, bare, caps, contacts, layer)
                    if trial < best:
                        x, y, best, moved = x + dx, y + dy, trial, True
        result[0, k], result[1, k], result[2, k] = x, y, best
    return result
