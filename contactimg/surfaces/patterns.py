"""Random patterns of spherical caps: SA, RA- and RA+, or caps of any law."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.errors import InputError
from contactimg.surfaces.asperity_table import LENGTH_RANGE_M, base_radius

Values = NDArray[np.float64]

MAX_REDRAWS = 1000
"""Most rounds of drawing again those values that give no cap. Chosen by hand: with 1 % of valid values, one
of 10^4 caps is left after 1000 rounds. Theory: 10^4 x 0.99^1000 = 0.4."""


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


_PATTERNS: dict[str, tuple[UniformCaps | GaussianCaps | DropletCaps, float]] = {
    "SA": (UniformCaps(30e-6, 60e-6, radius=100e-6), 0.4),
    "RA-": (GaussianCaps(9.0e-6, 2.4e-6, radius_mean=49.6e-6, radius_std=12.8e-6), 0.34),
    "RA+": (DropletCaps(29.6e-6, 10.1e-6, contact_angle=np.radians(57.0)), 0.41),
}
"""Name of a surface -> law of its caps, and covered fraction."""

_MEASURED = {"RA-": (293, 0.02), "RA+": (119, 0.05)}
"""Name of a measured surface -> number of asperities measured, and uncertainty of the covered fraction."""

CONTACT_ANGLE_STD = np.radians(2.0)
"""Uncertainty of the contact angle: 57 deg from h(R), 55 deg measured on water."""


def draw_surface(kind: str, rng: np.random.Generator) -> tuple[CapLaw, float]:
    """Law of the caps and covered fraction of a surface, drawn within what Table 1 leaves uncertain.

    Means of heights and radii with their standard errors, the contact angle and the covered fraction with
    their uncertainties; SA is milled to a design and has none.

    Parameters
    ----------
    kind : {"SA", "RA-", "RA+"}
    rng : numpy.random.Generator

    Examples
    --------
    >>> law, coverage = draw_surface("RA-", np.random.default_rng(1))
    >>> round(law.height_mean * 1e6, 2), round(coverage, 3)
    (9.05, 0.347)
    """
    _law_and_coverage(kind, None)  # refuses a name that is none
    law, coverage = _PATTERNS[kind]
    count, coverage_std = _MEASURED.get(kind, (1, 0.0))
    if not isinstance(law, UniformCaps):
        law = replace(law, height_mean=rng.normal(law.height_mean, law.height_std / np.sqrt(count)))
    if isinstance(law, GaussianCaps):
        law = replace(law, radius_mean=rng.normal(law.radius_mean, law.radius_std / np.sqrt(count)))
    if isinstance(law, DropletCaps):
        law = replace(law, contact_angle=rng.normal(law.contact_angle, CONTACT_ANGLE_STD))
    return law, float(rng.normal(coverage, coverage_std))


def generate_asperities(
    kind: str | CapLaw,
    *,
    side: float,
    rng: np.random.Generator,
    coverage: float | None = None,
    max_tries: int = 100_000,
    max_caps: int = 2_000_000,
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
