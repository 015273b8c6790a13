"""The composite summits of asperities under a lens: what all loads have in common."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.surfaces import base_radius, composite_columns

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CompositeSummits:
    """A checked table of asperities combined with a lens; the solvers take it in place of the table.

    It spares the checks at every load but the first.

    Parameters
    ----------
    apexes : dict
        Columns of `contactimg.surfaces.composite_apexes`, in the order of the table.
    height : ndarray, m
        Heights above the plane they stand on, in the order of the table.
    discs : ndarray, shape (3, n), m
        Position of each cap on the base and radius of the disc that it covers there.
    place : tuple
        Radius of the lens and position of its apex, m.
    """

    apexes: dict[str, Values]
    height: Values
    discs: Values
    place: tuple[float, tuple[float, float]]

    @classmethod
    def of(
        cls,
        asperities: "pd.DataFrame | CompositeSummits",
        *,
        indenter_radius: float,
        apex: tuple[float, float],
    ) -> "CompositeSummits":
        """The summits of a table under a lens; those of the same lens are returned as they are."""
        place = (indenter_radius, apex)
        if isinstance(asperities, CompositeSummits):
            if asperities.place != place:
                raise InputError(
                    f"the composite summits are those under a lens of {asperities.place[0]!r} m with its "
                    f"apex at {asperities.place[1]!r} m, not of {indenter_radius!r} m at {apex!r} m; hand "
                    "over the table"
                )
            return asperities
        apexes = composite_columns(asperities, indenter_radius=indenter_radius, apex=apex)
        x, y, height = asperities[["x_m", "y_m", "height_m"]].to_numpy(dtype=np.float64).T
        discs = np.stack([x, y, base_radius(height, asperities["radius_m"])])
        return cls(apexes, height, discs, place)

    def __len__(self) -> int:
        return self.height.size

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """Rows of the table, the highest composite summit first."""
        return np.argsort(-self.apexes["height_m"], kind="stable")

    @cached_property
    def ordered(self) -> dict[str, Values]:
        """The composite apexes, from the highest."""
        return {name: values[self.order] for name, values in self.apexes.items()}
