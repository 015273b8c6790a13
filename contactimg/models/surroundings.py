"""Surroundings of a table of asperities: the mean field of a pattern that goes on beyond its rim.

A contact region that runs off the table lacks the contacts beyond. Greenwood and Tripp's model of the same
asperities at the same load says what they would carry on average. As surroundings of the table they are mean
asperities on a square lattice outside its rectangle, each with the force of its cell; they bear their share
of the load and displace the surface below the asperities of the table.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.models.conditions import CELLS_PER_SPACING, ContactConditions
from contactimg.models.coupling import Kernel
from contactimg.models.greenwood_tripp import solve_greenwood_tripp
from contactimg.models.greenwood_williamson import RingSolution, solve_greenwood_williamson
from contactimg.models.height_distributions import SampleHeights
from contactimg.surfaces import composite_apexes

Values = NDArray[np.float64]

HEIGHTS = 300
"""Heights that stand for those of the table, at even quantiles. Chosen: the mean field is smooth."""


MOST_CELLS = 400
"""Most cells of the lattice along one side: beyond, cells are larger. Chosen: 0.02 s."""


@dataclass(frozen=True, eq=False)
class MeanField:
    """The mean field of the asperities of a table around it, under a lens at a load.

    Parameters
    ----------
    asperities : DataFrame
    rectangle : ndarray, shape (2, 2), m
        Limits in x and in y of what the table fills.
    conditions : ContactConditions
    coupled : bool
        Whether the contacts displace each other.
    """

    asperities: pd.DataFrame
    rectangle: Values
    conditions: ContactConditions
    coupled: bool = True

    @cached_property
    def spacing(self) -> float:
        """Mean distance of the asperities, m."""
        return float(np.sqrt(np.prod(np.ptp(self.rectangle, axis=1)) / len(self.asperities)))

    @cached_property
    def rings(self) -> RingSolution:
        """The averages at the whole load."""
        radius, lens = float(self.asperities["radius_m"].mean()), self.conditions.indenter_radius
        heights = np.quantile(self.asperities["height_m"], (np.arange(HEIGHTS) + 0.5) / HEIGHTS)
        solve = solve_greenwood_tripp if self.coupled else solve_greenwood_williamson
        return solve(
            SampleHeights(heights),
            density=1 / self.spacing**2,
            radius=radius * lens / (radius + lens),
            indenter_radius=lens,
            contact_modulus=self.conditions.contact_modulus,
            load=self.conditions.load or 0.0,
        )

    @cached_property
    def _cells(self) -> tuple[Values, Values, float]:
        """Centres of the cells outside the rectangle and in reach of the lens, distance from the apex."""
        sides = np.ptp(self.rectangle, axis=1)
        step = sides / np.ceil(CELLS_PER_SPACING * sides / self.spacing)
        step = np.maximum(step, 2 * self.rings.r[-1] / MOST_CELLS)
        centres = []
        for (low, _), size, at in zip(self.rectangle, step, self.conditions.apex, strict=True):
            reach = np.floor((at - low + np.array([-1, 1]) * self.rings.r[-1]) / size)
            centres.append(low + size * (np.arange(reach[0], reach[1] + 1) + 0.5))
        x, y = (v.ravel() for v in np.meshgrid(*centres))
        places, (low, high) = np.stack([x, y]), self.rectangle.T[:, :, None]
        places = places[:, ~np.all((places > low) & (places < high), axis=0)]
        return places, np.hypot(*(places - np.array(self.conditions.apex)[:, None])), float(np.prod(step))

    def _over_cells(self, values: Values) -> Values:
        """Values of the rings times the area of each cell outside."""
        _, r, area = self._cells
        return np.interp(r, self.rings.r, values, right=0.0) * area

    @cached_property
    def load(self) -> float:
        """Load that the asperities outside carry, N."""
        return min(float(self._over_cells(self.rings.pressure).sum()), self.rings.load)

    @cached_property
    def area(self) -> float:
        """Contact area outside, m^2."""
        return float(self._over_cells(self.rings.area_fraction).sum())

    @property
    def share(self) -> float:
        """Share of the load that is carried outside."""
        return self.load / self.rings.load

    @cached_property
    def sources(self) -> Values:
        """Positions (m) and forces (N) of the loaded cells, shape (3, k)."""
        forces = self._over_cells(self.rings.pressure)
        return np.stack([*self._cells[0], forces])[:, forces > 0]

    def displacement(self, x: Values, y: Values) -> Values:
        """Displacement of the surface at places in the rectangle by the forces outside, m."""
        c, force = self.conditions, self.sources[2] / self.conditions.contact_modulus
        return Kernel.of_thickness(c.thickness, c.poisson_ratio).displacement(x, y, self.sources[:2], force)

    def around(self, asperities: pd.DataFrame) -> pd.DataFrame:
        """The table on the surface as the forces outside have displaced it: its summits lie lower."""
        sunk = self.displacement(*asperities[["x_m", "y_m"]].to_numpy(float).T)
        return asperities.assign(height_m=asperities["height_m"] - sunk)

    def sinking(self, asperities: pd.DataFrame) -> float:
        """Excess (m) of the indentation from first touch over that of the table `around`."""
        c = self.conditions
        alone, sunk = (
            composite_apexes(one, indenter_radius=c.indenter_radius, apex=c.apex)
            for one in (asperities, self.around(asperities))
        )
        return float(alone["height_m"].max() - sunk["height_m"].max())

    def rim_share(self, x: Values, y: Values, force: Values) -> float:
        """Share of the load of contacts that is on those within one mean spacing of the table's rim."""
        total = float(force.sum())
        if not total > 0:
            return 0.0
        places, (low, high) = np.stack([x, y]), self.rectangle.T[:, :, None]
        depth = np.minimum(places - low, high - places).min(axis=0)
        return float(force[depth < self.spacing].sum()) / total
