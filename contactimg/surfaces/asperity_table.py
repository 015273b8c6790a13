"""Tables of asperities: their check, and the composite plane under a lens.

A table has the columns of `contactimg.tables.ASPERITIES`: ``x_m, y_m, height_m, radius_m``, one row a
spherical cap. A cap of height ``h`` and radius ``R`` covers a disc of radius ``sqrt(2 R h - h^2)``; the
generated patterns place these discs at random without overlap, largest first.
"""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import InputError
from contactimg.tables import ASPERITIES

Values = NDArray[np.float64]

LENGTH_RANGE_M = (1e-15, 1e9)
"""Range of radii; coordinates and heights are limited by its upper end. Theory: the powers of lengths that
the models form stay within floating-point numbers."""


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
    """The table with the columns of `ASPERITIES` that it fills, as float64, once it keeps the rules.

    Parameters
    ----------
    asperities : DataFrame
        Columns ``x_m, y_m, height_m, radius_m``; others are left out.

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
    missing = [name for name in ASPERITIES.first if name not in asperities]
    if missing:
        raise InputError(
            f"asperities: column {missing[0]!r} is missing; it needs {', '.join(ASPERITIES.first)}"
        )
    columns = {name: _finite_column(asperities, name) for name in ASPERITIES.first}
    radius = columns["radius_m"]
    if (row := _first(radius <= 0)) is not None:
        raise InputError(
            f"asperities: row {row}, column 'radius_m' must be positive, got {float(radius[row])!r}"
        )
    low, high = LENGTH_RANGE_M
    for name, values in columns.items():
        row = _first(np.abs(values) > high)
        if row is None and values is radius:
            row = _first(values < low)
        if row is not None:
            raise InputError(
                f"asperities: row {row}, column {name!r} must be a length up to {high:g} m (radii from "
                f"{low:g} m), got {float(values[row])!r}; check its unit"
            )
    return columns


def _first(wrong: NDArray[np.bool_]) -> int | None:
    """The first row that is wrong; None if none is."""
    return int(np.argmax(wrong)) if wrong.any() else None


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
    beyond = _first(~np.isfinite(values))
    if beyond is not None:
        raise InputError(
            f"asperities: row {beyond}, column {name!r} must be finite, got {float(values[beyond])!r}"
        )
    return values


def of_asperities(values: ArrayLike, rows: pd.Series) -> Values:
    """The values of the asperities that contacts lie on, NaN where a contact is on none.

    Parameters
    ----------
    values : array_like, shape (n,)
        One value an asperity.
    rows : Series
        Column ``asperity`` of contacts, empty for those on none.

    Raises
    ------
    InputError
        If a contact names an asperity that the table does not have.

    Examples
    --------
    >>> of_asperities([1e-4, 2e-4], pd.Series([1, None])).tolist()
    [0.0002, nan]
    """
    known, values = rows.notna().to_numpy(), np.asarray(values, dtype=np.float64)
    chosen = rows[known].to_numpy(dtype=np.intp)
    if chosen.size and not 0 <= chosen.min() <= chosen.max() < len(values):
        wrong = chosen.max() if chosen.min() >= 0 else chosen.min()
        raise InputError(
            f"contacts.csv names asperity {wrong}, but their table has {len(values)} rows; repeat `process` "
            "with this table"
        )
    result = np.full(len(rows), np.nan)
    result[known] = values[chosen]
    return result


def composite_apexes(
    asperities: pd.DataFrame, *, indenter_radius: float, apex: tuple[float, float] = (0.0, 0.0)
) -> pd.DataFrame:
    """The summits of asperities and lens combined, exact for parabolic caps under a parabolic lens.

    Radius ``R Rl/(R + Rl)``, apex at ``x Rl/(R + Rl)`` from the lens's apex, height ``h - r^2/(2 (R + Rl))``:
    the cap meets the lens not above its own summit but where both slopes agree.

    Parameters
    ----------
    asperities : DataFrame
        As for `check_asperities`.
    indenter_radius : float, m
        ``Rl``; infinite for a flat, under which the caps are their own composites.
    apex : (float, float), m
        Where the lens's apex stands over the sample.

    Returns
    -------
    DataFrame
        The same rows: where a first contact lies, with which height and which radius.

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
    return pd.DataFrame(composite_columns(asperities, indenter_radius=indenter_radius, apex=apex))


def composite_columns(
    asperities: pd.DataFrame, *, indenter_radius: float, apex: tuple[float, float]
) -> dict[str, Values]:
    """The columns of `composite_apexes`."""
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
    nearness = R / indenter_radius  # R/Rl: zero under a flat
    drop = squared / (2 * R) * (nearness / (1 + nearness))
    return {
        "x_m": x0 + dx / (1 + nearness),
        "y_m": y0 + dy / (1 + nearness),
        "height_m": table["height_m"] - drop,
        "radius_m": R / (1 + nearness),
    }
