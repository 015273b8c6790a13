"""Remove the dimensions from a contact problem, and restore them in its solution."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError, ModelRangeError
from contactimg.models.proof import INDENTATION_RANGE_M, LOAD_RANGE_N, MODULUS_RANGE_PA, check_range
from contactimg.models.solution import InteractingSolution, Outcome
from contactimg.surfaces import LENGTH_RANGE_M, composite_apexes
from contactimg.timings import stage

Values = NDArray[np.float64]


@dataclass(frozen=True)
class ContactConditions:
    """Indenter, elastic body and prescribed load or indentation, in SI units.

    Parameters
    ----------
    indenter_radius : float, m
    contact_modulus : float, Pa
    apex : (float, float), m
    thickness : float, m
        Infinite for a half-space.
    load, indentation : float or None
        Exactly one is given.
    """

    indenter_radius: float
    contact_modulus: float
    apex: tuple[float, float]
    thickness: float
    load: float | None
    indentation: float | None

    def check(self) -> None:
        """Refuse values that define no contact problem."""
        if not (np.isfinite(self.contact_modulus) and self.contact_modulus > 0):
            raise InputError(f"contact_modulus must be a positive modulus, got {self.contact_modulus!r} Pa")
        if not self.thickness > 0:
            raise InputError(f"thickness must be positive (inf for a half-space), got {self.thickness!r} m")
        if (self.load is None) == (self.indentation is None):
            raise InputError(
                f"give exactly one of load and indentation, got load={self.load!r} "
                f"and indentation={self.indentation!r}"
            )
        for name, value in (("load", self.load), ("indentation", self.indentation)):
            if value is not None and not np.isfinite(value):
                raise InputError(f"{name} must be finite, got {value!r}")
        check_range("contact_modulus", self.contact_modulus, MODULUS_RANGE_PA, "Pa")
        check_range("thickness", self.thickness, LENGTH_RANGE_M, "m")
        check_range("load", self.load, LOAD_RANGE_N, "N")
        check_range("indentation", self.indentation, INDENTATION_RANGE_M, "m")


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
    apexes : DataFrame
        The composite apexes in the order of the table, m.
    height : ndarray, m
        Heights above the plane they stand on, in the order of the table.
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
    apexes: pd.DataFrame
    height: Values

    @property
    def base_gap(self) -> Values:
        """Depth of each apex below the highest of the table, m."""
        height = self.apexes["height_m"].to_numpy()
        return height.max() - height[self.order]

    @property
    def radius_unit(self) -> float:
        """Composite radius of the highest asperity of the table, m."""
        return self.length**2 / self.depth

    @property
    def touches(self) -> bool:
        """Whether the prescribed load or indentation brings any asperity into contact."""
        if self.load:
            if not self.order.size:
                raise InputError("the asperity table is empty: nothing can bear the load")
            return True
        return bool(self.order.size) and self.indentation > 0

    def untouched(self, *, coupling: str, thickness: float) -> InteractingSolution:
        """The solution without contacts."""
        nothing = np.zeros(self.order.size)
        return self.record(
            nothing,
            nothing,
            self.indentation - self.gap,
            Outcome(self.indentation * self.depth, coupling, thickness, iterations=0, residual=0.0),
        )

    def part(self, rows: NDArray[np.bool_] | slice) -> "ScaledProblem":
        """The same problem with a selection of its asperities."""
        return replace(
            self,
            x=self.x[rows],
            y=self.y[rows],
            gap=self.gap[rows],
            radius=self.radius[rows],
            order=self.order[rows],
        )

    def duplicates(self) -> tuple[int, int] | None:
        """Rows in the table of two asperities at the same place; None if there are none."""
        x, y = self.x, self.y
        if not np.any(np.diff(np.sort(x)) == 0):
            return None
        order = np.lexsort((y, x))
        same = np.flatnonzero((np.diff(x[order]) == 0) & (np.diff(y[order]) == 0))
        if not same.size:
            return None
        first, second = sorted(int(self.order[order[same[0] + k]]) for k in (0, 1))
        return first, second

    def refuse_duplicates(self) -> None:
        """Raise `ModelRangeError` if two asperities are at the same place."""
        duplicates = self.duplicates()
        if duplicates is not None:
            raise ModelRangeError(
                f"asperities: rows {duplicates[0]} and {duplicates[1]} are at the same place; coupled, "
                "either of them could bear the force; remove one"
            )

    def scattered(self, values: Values, *, fill: float = 0.0) -> Values:
        """Values in the order of the table, with ``fill`` for asperities that are not part of the problem."""
        result = np.full(self.height.size, fill)
        result[self.order] = values
        return result

    def record(
        self, force: Values, contact_radius: Values, penetration: Values, outcome: Outcome
    ) -> InteractingSolution:
        """The solution in SI units, from dimensionless arrays."""
        return InteractingSolution(
            force=self.scattered(force * self.force_unit),
            radius=self.scattered(contact_radius * self.length),
            x=self.apexes["x_m"].to_numpy(),
            y=self.apexes["y_m"].to_numpy(),
            composite_radius=self.apexes["radius_m"].to_numpy(),
            height=self.height,
            penetration=self.scattered(penetration * self.depth, fill=-np.inf),
            load=float(np.sum(force)) * self.force_unit,
            indentation=outcome.indentation,
            coupling=outcome.coupling,
            thickness=outcome.thickness,
            status=outcome.status,
            iterations=outcome.iterations,
            residual=outcome.residual,
            branch=outcome.branch,
        )


def check_choice(name: str, value: str, allowed: Collection[str]) -> None:
    """Refuse a value that is not among the allowed ones."""
    if value not in allowed:
        raise InputError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


@stage("candidates")
def scale_problem(
    asperities: pd.DataFrame, setting: ContactConditions, *, depth: float | None = None
) -> ScaledProblem:
    """Make a table of asperities dimensionless; ``depth`` is the unit of height (m).

    The default unit is the prescribed indentation, or the indentation at which the highest asperity alone
    would bear the prescribed load.
    """
    setting.check()
    apexes = composite_apexes(asperities, indenter_radius=setting.indenter_radius, apex=setting.apex)
    height, radius = apexes["height_m"].to_numpy(), apexes["radius_m"].to_numpy()
    order = np.argsort(-height, kind="stable")
    highest = float(radius[order[0]]) if order.size else 1.0
    if depth is None:
        depth = _natural_depth(setting, highest) or highest
    length = float(np.sqrt(highest * depth))
    unit = setting.contact_modulus * length * depth
    return ScaledProblem(
        x=apexes["x_m"].to_numpy()[order] / length,
        y=apexes["y_m"].to_numpy()[order] / length,
        gap=(height[order[:1]] - height[order]) / depth,
        radius=radius[order] / highest,
        load=None if setting.load is None else setting.load / unit,
        indentation=0.0 if setting.indentation is None else setting.indentation / depth,
        order=order,
        length=length,
        depth=depth,
        force_unit=unit,
        apexes=apexes,
        height=asperities["height_m"].to_numpy(dtype=np.float64),
    )


def _natural_depth(setting: ContactConditions, highest: float) -> float:
    """Unit of height for a load or an indentation, m; zero if neither is positive."""
    if setting.load is None:
        return max(float(setting.indentation or 0.0), 0.0)
    return float(max(0.75 * setting.load / setting.contact_modulus / np.sqrt(highest), 0.0) ** (2 / 3))
