"""Remove the dimensions from a contact problem, and restore them in its solution."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError, ModelRangeError
from contactimg.models.asperity_laws import Caps
from contactimg.models.composite_summits import CompositeSummits
from contactimg.models.conditions import ContactConditions
from contactimg.models.convergence import CONVERGED
from contactimg.models.solution import InteractingSolution

Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """Dimensionless asperities in order of height, the highest first.

    The units are ``length`` along the surface, ``depth`` for heights and ``E* length depth`` for forces. With
    ``length^2 = R depth``, ``R`` the radius of the highest asperity, a paraboloid keeps its equation.

    Parameters
    ----------
    x, y, gap, radius : ndarray
        Composite apexes; ``gap`` is the depth below the highest apex.
    load : float or None
        None if the indentation is prescribed.
    indentation : float
        The prescribed indentation; 0 if the load is prescribed.
    order : ndarray
        Rows of the asperities in the table.
    length, depth, force_unit : float
    summits : CompositeSummits
        In the order of the table, m.
    conditions : ContactConditions
    """

    x: Values
    y: Values
    gap: Values
    radius: Values
    load: float | None
    indentation: float
    order: NDArray[np.intp]
    length: float
    depth: float
    force_unit: float
    summits: CompositeSummits
    conditions: ContactConditions

    @property
    def caps(self) -> Caps:
        """The quantities of each asperity that its law needs."""
        return Caps(self.radius)

    @property
    def touches(self) -> bool:
        """Whether the prescribed load or indentation brings any asperity into contact."""
        if self.load:
            if not self.order.size:
                raise InputError("the asperity table is empty: nothing can bear the load")
            return True
        return bool(self.order.size) and self.indentation > 0

    def untouched(self, *, coupling: str) -> InteractingSolution:
        """The solution without contacts."""
        nothing = np.zeros(self.order.size)
        gaps = self.indentation - self.gap
        how = {"coupling": coupling, "iterations": 0, "residual": 0.0}
        return self.record(nothing, nothing, gaps, self.indentation, **how)

    def part(self, rows: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "ScaledProblem":
        """Select some asperities of the problem."""
        names = ("x", "y", "gap", "radius", "order")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def refuse_duplicates(self) -> None:
        """Raise `ModelRangeError` if two asperities are at the same place."""
        x, y = self.x, self.y
        if not np.any(np.diff(np.sort(x)) == 0):
            return
        order = np.lexsort((y, x))
        same = np.flatnonzero((np.diff(x[order]) == 0) & (np.diff(y[order]) == 0))
        if same.size:
            first, second = sorted(int(self.order[order[same[0] + k]]) for k in (0, 1))
            raise ModelRangeError(
                f"asperities: rows {first} and {second} are at the same place; coupled, "
                "either of them could bear the force; remove one"
            )

    def scattered(self, values: Values, *, fill: float = 0.0) -> Values:
        """Values in the order of the table, with ``fill`` for asperities that are not part of the problem."""
        result = np.full(len(self.summits), fill)
        result[self.order] = values
        return result

    def record(
        self, force: Values, contact_radius: Values, penetration: Values, indentation: float, **how: Any
    ) -> InteractingSolution:
        """The solution in SI units, from dimensionless numbers; ``how`` it was found goes into the record."""
        return InteractingSolution(
            force=self.scattered(force * self.force_unit),
            radius=self.scattered(contact_radius * self.length),
            summits=self.summits,
            conditions=self.conditions,
            penetration=self.scattered(penetration * self.depth, fill=-np.inf),
            load=float(np.sum(force)) * self.force_unit,
            indentation=indentation * self.depth,
            status=CONVERGED,
            **how,
        )


def check_choice(name: str, value: str, allowed: Collection[str]) -> None:
    """Refuse a value that is not among the allowed ones."""
    if value not in allowed:
        raise InputError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


def scale_problem(
    asperities: pd.DataFrame | CompositeSummits, setting: ContactConditions, *, depth: float | None = None
) -> ScaledProblem:
    """Make asperities, or their composite summits, dimensionless; ``depth`` is the unit of height (m).

    The default unit is the prescribed indentation, or the indentation at which the highest asperity alone
    would bear the prescribed load.
    """
    setting.check()
    summits = CompositeSummits.of(asperities, indenter_radius=setting.indenter_radius, apex=setting.apex)
    x, y, height, radius = (summits.ordered[name] for name in ("x_m", "y_m", "height_m", "radius_m"))
    highest = float(radius[0]) if radius.size else 1.0
    if depth is None:
        depth = max(setting.indentation or 0.0, 0.0)
        if setting.load is not None:
            bearing = 0.75 * max(setting.load, 0.0) / setting.contact_modulus / np.sqrt(highest)
            depth = float(bearing ** (2 / 3))
        depth = depth or highest
    length = float(np.sqrt(highest * depth))
    unit = setting.contact_modulus * length * depth
    return ScaledProblem(
        x=x / length,
        y=y / length,
        gap=(height[:1] - height) / depth,
        radius=radius / highest,
        load=None if setting.load is None else setting.load / unit,
        indentation=(setting.indentation or 0.0) / depth,
        order=summits.order,
        length=length,
        depth=depth,
        force_unit=unit,
        summits=summits,
        conditions=setting,
    )
