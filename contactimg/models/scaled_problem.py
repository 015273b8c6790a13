"""Remove the dimensions from a contact problem, and restore them in its solution."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.models.solution import InteractingSolution
from contactimg.surfaces import composite_apexes
from contactimg.timings import stage

Values = NDArray[np.float64]

MIN_LOAD_N = 1e-100
"""Least load. Theory: the indentation goes as P^(2/3) and its powers must stay above 1e-308, the least
float."""


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
        if self.load and abs(self.load) < MIN_LOAD_N:
            raise InputError(f"load must be 0 or above {MIN_LOAD_N:g} N, got {self.load!r} N")


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
            indentation=self.indentation * self.depth,
            coupling=coupling,
            thickness=thickness,
            status="converged",
            iterations=0,
            residual=0.0,
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

    def scattered(self, values: Values, *, fill: float = 0.0) -> Values:
        """Values in the order of the table, with ``fill`` for asperities that are not part of the problem."""
        result = np.full(self.height.size, fill)
        result[self.order] = values
        return result

    def record(
        self, force: Values, contact_radius: Values, penetration: Values, **facts: object
    ) -> InteractingSolution:
        """The solution with dimensions; ``facts`` are its remaining fields."""
        return InteractingSolution(
            force=self.scattered(force * self.force_unit),
            radius=self.scattered(contact_radius * self.length),
            x=self.apexes["x_m"].to_numpy(),
            y=self.apexes["y_m"].to_numpy(),
            composite_radius=self.apexes["radius_m"].to_numpy(),
            height=self.height,
            penetration=self.scattered(penetration * self.depth, fill=-np.inf),
            load=float(np.sum(force)) * self.force_unit,
            **facts,  # type: ignore[arg-type]
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
