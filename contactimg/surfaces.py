"""Asperity tables: the patterns SA, RA- and RA+, their check, and the composite plane under a lens.

A table has the columns of `contactimg.tables.ASPERITIES`: ``x_m, y_m, height_m, radius_m``, one row a
spherical cap. A cap of height ``h`` and radius ``R`` covers a disc of radius ``sqrt(2 R h - h^2)``; the
generated patterns place these discs at random without overlap, largest first.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError
from contactimg.tables import ASPERITIES

Values = NDArray[np.float64]

LENGTH_RANGE_M = (1e-15, 1e9)
"""Range of radii; coordinates and heights are limited by its upper end. Theory: the powers of lengths that
the models form stay within floating-point numbers."""

BASE_COLUMN = "base_m"
"""Column of the height of the sample below a summit, over the plane of reference; flat without it."""

MAX_CAPS = 2_000_000
"""Most caps of a generated pattern, unless told otherwise: about 10 s of placing. Chosen by hand."""

MAX_REDRAWS = 1000
"""Most rounds of drawing again those values that give no cap. Chosen by hand: with 1 % of valid values, one
of 10^4 caps is left after 1000 rounds. Theory: 10^4 x 0.99^1000 = 0.4."""


def base_radius(height: ArrayLike, radius: ArrayLike) -> Values:
    """Radius of the disc that a spherical cap covers: ``sqrt(2 R h - h^2)``.

    Parameters
    ----------
    height : array_like, m
        ``h``; a cap higher than its radius covers the disc of the radius.
    radius : array_like, m
        ``R``.

    Returns
    -------
    ndarray, m

    Examples
    --------
    >>> float(base_radius(40e-6, 100e-6)) * 1e6
    80.0
    """
    R = np.asarray(radius, dtype=np.float64)
    h = np.clip(np.asarray(height, dtype=np.float64), 0.0, R)
    return np.sqrt(h * (2 * R - h))


def check_asperities(asperities: pd.DataFrame) -> pd.DataFrame:
    """The table with exactly the columns of `ASPERITIES`, as float64, once it keeps the rules.

    Parameters
    ----------
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``, and ``base_m`` on a curved sample; others are left out.

    Returns
    -------
    DataFrame
        A new table, rows in the same order, numbered from 0.

    Raises
    ------
    InputError
        Naming the missing column, or row and column of the first value that is not a finite number or of the
        first radius that is not positive.

    Examples
    --------
    >>> import pandas as pd
    >>> check_asperities(pd.DataFrame({"x_m": [0], "y_m": [0], "height_m": [4e-5], "radius_m": [1e-4]}))
       x_m  y_m  height_m  radius_m
    0  0.0  0.0   0.00004    0.0001
    """
    return pd.DataFrame(_checked_columns(asperities))


def _checked_columns(asperities: pd.DataFrame) -> dict[str, Values]:
    """The columns of `check_asperities`."""
    if not isinstance(asperities, pd.DataFrame):
        raise InputError(
            f"asperities must be a table (DataFrame) with columns {', '.join(ASPERITIES.columns)}, "
            f"got {type(asperities).__name__}"
        )
    missing = [name for name in ASPERITIES.columns if name not in asperities]
    if missing:
        raise InputError(
            f"asperities: column {missing[0]!r} is missing; it needs {', '.join(ASPERITIES.columns)}"
        )
    columns = {name: _finite_column(asperities, name) for name in ASPERITIES.columns}
    bad = np.flatnonzero(~(columns["radius_m"] > 0))
    if bad.size:
        raise InputError(
            f"asperities: row {bad[0]}, column 'radius_m' must be positive, "
            f"got {float(columns['radius_m'][bad[0]])!r}"
        )
    low, high = LENGTH_RANGE_M
    for name, values in columns.items():
        beyond = np.flatnonzero((np.abs(values) > high) | (values < low if name == "radius_m" else False))
        if beyond.size:
            raise InputError(
                f"asperities: row {beyond[0]}, column {name!r} must be a length up to {high:g} m (radii from "
                f"{low:g} m), got {float(values[beyond[0]])!r}; check its unit"
            )
    if BASE_COLUMN in asperities:
        columns[BASE_COLUMN] = _finite_column(asperities, BASE_COLUMN)
    return columns


def _finite_column(table: pd.DataFrame, name: str) -> Values:
    """A column as float64, or an error that names the row."""
    try:
        values = table[name].to_numpy(dtype=np.float64)
    except (TypeError, ValueError):
        numbers = pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        row = int(np.flatnonzero(np.isnan(numbers))[0]) if np.isnan(numbers).any() else 0
        raise InputError(
            f"asperities: row {row}, column {name!r} must be a number, got {table[name].iloc[row]!r}"
        ) from None
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise InputError(
            f"asperities: row {bad[0]}, column {name!r} must be finite, got {float(values[bad[0]])!r}"
        )
    return values


def composite_apexes(
    asperities: pd.DataFrame, *, indenter_radius: float, apex: tuple[float, float] = (0.0, 0.0)
) -> pd.DataFrame:
    """The summits of asperities and lens combined, exact for parabolic caps under a parabolic lens.

    Radius ``R Rl/(R + Rl)``, apex at ``x Rl/(R + Rl)`` from the lens's apex, height ``h - r^2/(2 (R + Rl))``:
    the cap meets the lens not above its own summit but where both slopes agree.

    Parameters
    ----------
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``.
    indenter_radius : float, m
        ``Rl``; infinite for a flat, under which the caps are their own composites.
    apex : (float, float), m
        Where the lens's apex stands over the sample.

    Returns
    -------
    DataFrame
        The same columns and rows: where a first contact lies, with which height and which radius.

    Raises
    ------
    InputError
        If the table breaks a rule (`check_asperities`), the indenter's radius is not positive, or all
        asperities lie farther from the apex than that radius.

    Notes
    -----
    Leaving the difference out costs 0.06-0.08 % of the load on the pattern SA+ at 0.02-0.5 N.

    Examples
    --------
    >>> import pandas as pd
    >>> cap = pd.DataFrame({"x_m": [1e-3], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    >>> composite_apexes(cap, indenter_radius=9.9e-3)
           x_m  y_m   height_m  radius_m
    0  0.00099  0.0  -0.00001  0.000099
    """
    table = _checked_columns(asperities)
    if not float(indenter_radius) > 0:
        raise InputError(f"indenter_radius must be positive (inf for a flat), got {indenter_radius!r} m")
    x0, y0 = (float(value) for value in apex)
    if not (np.isfinite(x0) and np.isfinite(y0)):
        raise InputError(f"apex must be two finite coordinates, got {apex!r} m")
    R = table["radius_m"]
    dx, dy = table["x_m"] - x0, table["y_m"] - y0
    squared = dx**2 + dy**2
    if squared.size and np.sqrt(squared.min()) > indenter_radius:
        raise InputError(
            f"no asperity lies under the indenter: the nearest is {np.sqrt(squared.min()):.3g} m from its "
            f"apex at {apex!r} m, farther than its radius of {indenter_radius:.3g} m; "
            "check x_m, y_m and the apex"
        )
    base = table.get(BASE_COLUMN, 0.0)
    nearness = R / indenter_radius  # R/Rl: zero under a flat
    drop = squared / (2 * R) * (nearness / (1 + nearness))
    return pd.DataFrame(
        {
            "x_m": x0 + dx / (1 + nearness),
            "y_m": y0 + dy / (1 + nearness),
            "height_m": table["height_m"] + base - drop,
            "radius_m": R / (1 + nearness),
        }
    )


class CapLaw(Protocol):
    """Distribution of the heights and radii of caps."""

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Values, Values]:
        """Heights and radii (m) of ``count`` caps."""


@dataclass(frozen=True)
class UniformCaps:
    """Caps of equal radius with uniformly distributed heights, as on SA.

    Parameters
    ----------
    height_low, height_high : float, m
    radius : float, m

    Examples
    --------
    >>> height, radius = UniformCaps(30e-6, 60e-6, radius=1e-4).draw(2, np.random.default_rng(1))
    >>> bool((height > 30e-6).all() and (height < 60e-6).all()), radius.tolist()
    (True, [0.0001, 0.0001])
    """

    height_low: float
    height_high: float
    radius: float

    def __post_init__(self) -> None:
        if not 0 <= self.height_low < self.height_high < np.inf:
            raise InputError(
                "heights of caps need 0 <= height_low < height_high, "
                f"got {self.height_low!r} and {self.height_high!r} m"
            )
        _check_positive(self, "radius")

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Values, Values]:
        """Heights and radii (m) of ``count`` caps."""
        return rng.uniform(self.height_low, self.height_high, count), np.full(count, self.radius)


@dataclass(frozen=True)
class GaussianCaps:
    """Caps of normally distributed heights and radii, independent of each other, as on RA-.

    Values that give no cap (height not positive, radius not above the height) are drawn again.

    Parameters
    ----------
    height_mean, height_std, radius_mean, radius_std : float, m
    """

    height_mean: float
    height_std: float
    radius_mean: float
    radius_std: float

    def __post_init__(self) -> None:
        _check_positive(self, "height_mean", "height_std", "radius_mean", "radius_std")
        if not self.height_mean < self.radius_mean:
            raise InputError(
                "caps lower than their radius need height_mean below radius_mean, "
                f"got {self.height_mean!r} and {self.radius_mean!r} m"
            )

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Values, Values]:
        """Heights and radii (m) of ``count`` caps."""
        height = _positive_normal(self.height_mean, self.height_std, count, rng)
        radius = _positive_normal(self.radius_mean, self.radius_std, count, rng)
        for _ in range(MAX_REDRAWS):
            if not (low := radius <= height).any():
                return height, radius
            radius[low] = _positive_normal(self.radius_mean, self.radius_std, int(low.sum()), rng)
        raise InputError(
            f"radii of {self.radius_mean:g} +- {self.radius_std:g} m hardly ever exceed the heights, "
            f"{self.height_mean:g} +- {self.height_std:g} m; check the four numbers"
        )


@dataclass(frozen=True)
class DropletCaps:
    """Caps of normally distributed heights and equal contact angle, ``R = h/(1 - cos theta)``, as on RA+.

    Parameters
    ----------
    height_mean, height_std : float, m
        Heights that are not positive are drawn again.
    contact_angle : float, rad
        ``theta``, between 0 and pi.
    """

    height_mean: float
    height_std: float
    contact_angle: float

    def __post_init__(self) -> None:
        _check_positive(self, "height_mean", "height_std", "contact_angle")
        if not self.contact_angle < np.pi:
            raise InputError(f"contact_angle must lie below pi, got {self.contact_angle!r} rad")

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Values, Values]:
        """Heights and radii (m) of ``count`` caps."""
        height = _positive_normal(self.height_mean, self.height_std, count, rng)
        return height, height / (1 - np.cos(self.contact_angle))


def _check_positive(law: "CapLaw", *names: str) -> None:
    """Refuse a law of which one of the named parameters is not positive and finite."""
    for name in names:
        if not 0 < getattr(law, name) < np.inf:
            raise InputError(f"{name} must be positive and finite, got {getattr(law, name)!r}")


def _positive_normal(mean: float, std: float, count: int, rng: np.random.Generator) -> Values:
    """Normal draws, the non-positive ones drawn again."""
    values = rng.normal(mean, std, count)
    while (low := values <= 0).any():  # the mean is positive: half of the values or more are accepted
        values[low] = rng.normal(mean, std, int(low.sum()))
    return values


_PATTERNS: dict[str, tuple[CapLaw, float]] = {
    "SA": (UniformCaps(30e-6, 60e-6, radius=100e-6), 0.4),
    "RA-": (GaussianCaps(9.0e-6, 2.4e-6, radius_mean=49.6e-6, radius_std=12.8e-6), 0.34),
    "RA+": (DropletCaps(29.6e-6, 10.1e-6, contact_angle=np.radians(57.0)), 0.41),
}
"""Name of a surface -> law of its caps, and covered fraction."""


def generate_asperities(
    kind: str | CapLaw,
    *,
    side: float,
    rng: np.random.Generator,
    coverage: float | None = None,
    max_tries: int = 100_000,
    max_caps: int = MAX_CAPS,
) -> pd.DataFrame:
    """A random pattern of non-overlapping caps on the square ``[0, side]^2``.

    Caps are drawn until their base discs cover the wanted fraction of the square, then placed largest first,
    each uniformly at random where its disc touches no other and does not leave the square.

    Parameters
    ----------
    kind : {"SA", "RA-", "RA+"} or CapLaw
        ``"SA"``: R = 100 um, heights uniform in 30-60 um. ``"RA-"``: h = 9.0 +- 2.4 um, R = 49.6 +- 12.8 um,
        independent. ``"RA+"``: h = 29.6 +- 10.1 um, R = h/(1 - cos 57 deg). Normal laws, cut at zero. Others:
        a law (`UniformCaps`, `GaussianCaps`, `DropletCaps`).
    side : float, m
        Side of the square.
    rng : numpy.random.Generator
        Source of chance; the same state gives the same pattern.
    coverage : float, optional
        Covered fraction of the square; by default 0.4, 0.34 and 0.41 for the three kinds. A law has none.
    max_tries : int
        Places tried for one cap before giving up.
    max_caps : int
        Most caps of a pattern; more are refused before they are drawn.

    Returns
    -------
    DataFrame
        Columns ``x_m, y_m, height_m, radius_m``; rows from the largest base disc down.

    Raises
    ------
    InputError
        If an argument breaks its rule, the pattern would have more than ``max_caps`` caps, or the coverage
        cannot be reached: random placement of equal discs jams at 0.547, and a square of few discs before
        that.

    Notes
    -----
    The number of caps is the one whose covered area is nearest to the wanted one, so the coverage is met to
    half a disc.

    References
    ----------
    Yashima et al., Soft Matter 11 (2015) 871, doi:10.1039/C4SM02346C, Experimental and table 1.

    Examples
    --------
    >>> import numpy as np
    >>> pattern = generate_asperities("SA", side=2e-3, rng=np.random.default_rng(1))
    >>> discs = base_radius(pattern["height_m"], pattern["radius_m"])
    >>> round(float(np.pi * (discs**2).sum() / 2e-3**2), 2)
    0.4
    """
    law, fraction = _law_and_coverage(kind, coverage)
    if not (np.isfinite(side) and side > 0):
        raise InputError(f"side must be a positive length, got {side!r} m")
    if not LENGTH_RANGE_M[0] <= side <= LENGTH_RANGE_M[1]:
        raise InputError(
            f"side must lie between {LENGTH_RANGE_M[0]:g} and {LENGTH_RANGE_M[1]:g} m, got {side!r} m"
        )
    height, radius = _draw_to_cover(law, fraction * side**2, max_caps, rng)
    disc = base_radius(height, radius)
    order = np.argsort(-disc, kind="stable")
    height, radius, disc = height[order], radius[order], disc[order]
    x, y, placed = _place_discs(disc / side, max_tries, rng)
    if placed < len(disc):
        reached = np.pi * np.sum(disc[:placed] ** 2) / side**2
        raise InputError(
            f"coverage {fraction:g} cannot be reached on a square of {side:g} m: after {placed} of "
            f"{len(disc)} caps (coverage {reached:.3f}) {max_tries} places were tried in vain; "
            "random placement without overlap jams near 0.5, ask for less or for a larger square"
        )
    return pd.DataFrame({"x_m": x * side, "y_m": y * side, "height_m": height, "radius_m": radius})


def _law_and_coverage(kind: str | CapLaw, coverage: float | None) -> tuple[CapLaw, float]:
    """The law of the caps and the fraction of the square they shall cover."""
    if not isinstance(kind, str):
        law, default = kind, None
    elif kind in _PATTERNS:
        law, default = _PATTERNS[kind]
    else:
        raise InputError(f"kind must be one of {', '.join(map(repr, _PATTERNS))}, or a law, got {kind!r}")
    fraction = default if coverage is None else coverage
    if fraction is None:
        raise InputError("coverage must be given with a law of caps, which has no default")
    if not 0 < fraction < 1:
        raise InputError(f"coverage must lie between 0 and 1 (exclusive), got {coverage!r}")
    return law, float(fraction)


def _draw_to_cover(
    law: CapLaw, area: float, max_caps: int, rng: np.random.Generator
) -> tuple[Values, Values]:
    """Draw the number of caps, at least one, whose discs together come nearest to the area."""
    height, radius = law.draw(64, rng)
    while (total := np.sum(np.pi * base_radius(height, radius) ** 2)) <= area:
        expected = len(height) * area / total if total > 0 else np.inf
        if expected > max_caps:
            raise InputError(
                f"the pattern would have {expected:.3g} caps, more than max_caps = {max_caps}; check "
                "the side and the units of the caps, or raise max_caps"
            )
        more = law.draw(int(1.05 * len(height) * max(area / total - 1, 0.05)) + 1, rng)
        height, radius = np.concatenate([height, more[0]]), np.concatenate([radius, more[1]])
    covered = np.cumsum(np.pi * base_radius(height, radius) ** 2)
    count = int(np.searchsorted(covered, area))
    below = covered[count - 1] if count else 0.0
    count += int(covered[count] - area < area - below or count == 0)
    return height[:count], radius[:count]


@njit(cache=True)
def _place_discs(disc, max_tries, rng):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Random sequential adsorption on the unit square with a cell list; places, and how many discs fit.

    Cells are as wide as the largest disc's diameter, so that discs that may touch lie in adjacent cells.
    """
    count = disc.size
    x, y = np.zeros(count), np.zeros(count)
    cells = max(1, min(int(1.0 / (2.0 * disc[0])), int(np.sqrt(count)) + 1))
    head, after = np.full((cells, cells), -1), np.full(count, -1)
    for i in range(count):
        free = False
        room = 1.0 - 2.0 * disc[i]
        for _ in range(max_tries if room >= 0.0 else 0):
            xi, yi = disc[i] + room * rng.random(), disc[i] + room * rng.random()
            row, column = min(int(yi * cells), cells - 1), min(int(xi * cells), cells - 1)
            free = True
            for near_row in range(max(row - 1, 0), min(row + 2, cells)):
                for near_column in range(max(column - 1, 0), min(column + 2, cells)):
                    j = head[near_row, near_column]
                    while j >= 0 and free:
                        reach = disc[i] + disc[j]
                        free = (xi - x[j]) ** 2 + (yi - y[j]) ** 2 >= reach * reach
                        j = after[j]
            if free:
                x[i], y[i] = xi, yi
                after[i], head[row, column] = head[row, column], i
                break
        if not free:
            return x, y, i
    return x, y, count
