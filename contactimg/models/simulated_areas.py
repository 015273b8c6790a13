"""Real contact areas of an ensemble of random patterns, and the bands they fill (Figs. 4 and 5)."""

from collections.abc import Iterable

import pandas as pd

from contactimg.errors import InputError
from contactimg.models.ensemble import EnsembleMember


def tabulate_areas(members: Iterable[EnsembleMember]) -> pd.DataFrame:
    """Contact area of each pattern at each load.

    Parameters
    ----------
    members : iterable of EnsembleMember
        As `contactimg.solve_ensemble` yields them.

    Returns
    -------
    DataFrame
        One row a pattern, coupling and load: ``pattern, coupling, load_N, area_m2, n_contacts``.
    """
    rows = [
        (member.index, coupling, load, solution.area, solution.touching.size)
        for member in members
        for (coupling, load), solution in member.solutions.items()
    ]
    return pd.DataFrame(rows, columns=["pattern", "coupling", "load_N", "area_m2", "n_contacts"])


def area_bands(areas: pd.DataFrame, *, share: float = 0.95) -> pd.DataFrame:
    """Band that a share of the patterns fills at each load.

    Parameters
    ----------
    areas : DataFrame
        As `tabulate_areas` returns it.
    share : float
        Between 0 and 1: the quantiles are those that leave half of the rest on either side.

    Returns
    -------
    DataFrame
        One row a coupling and load: ``coupling, load_N, low_m2, mean_m2, high_m2``.

    Raises
    ------
    InputError
        If the share is not between 0 and 1.

    Examples
    --------
    >>> areas = pd.DataFrame({"coupling": "none", "load_N": 0.1, "area_m2": [1.0, 2.0, 3.0]})
    >>> area_bands(areas, share=0.5).iloc[0, 2:].tolist()
    [1.5, 2.0, 2.5]
    """
    if not 0 < share < 1:
        raise InputError(f"share must be between 0 and 1, got {share!r}")
    groups = areas.groupby(["coupling", "load_N"], sort=False)["area_m2"]
    low, high = (groups.quantile(0.5 + sign * share / 2) for sign in (-1, 1))
    bands = pd.DataFrame({"low_m2": low, "mean_m2": groups.mean(), "high_m2": high})
    return bands.reset_index()
