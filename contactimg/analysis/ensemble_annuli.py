"""Ensembles of solved patterns: their contacts summed over annuli, as those of measured places are."""

from collections.abc import Iterable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from contactimg.analysis.annuli import annulus_moments
from contactimg.errors import InputError
from contactimg.models.ensemble import EnsembleMember
from contactimg.models.solution import InteractingSolution


def gather_annuli(
    members: Iterable[EnsembleMember], *, centre: tuple[float, float], edges: ArrayLike, groups: int = 1
) -> dict[tuple[str, float], dict[str, pd.DataFrame]]:
    """Sum the contacts of many patterns over annuli, one pattern after the other.

    Parameters
    ----------
    members : iterable of EnsembleMember
        From `contactimg.solve_ensemble`; one at least. None is kept.
    centre : (float, float), m
        Centre of the apparent contact.
    edges : array_like, shape (n + 1,)
        Increasing radii that bound the annuli, m.
    groups : int
        Patterns are dealt in turn to this many groups: the scatter between them is the uncertainty of what
        all of them give. An ensemble of fewer patterns has a group each.

    Returns
    -------
    dict
        ``(coupling, load)`` -> name of the group -> sums over its patterns: the columns of `annulus_moments`
        (``area`` is that of the annulus times the patterns) and ``patterns``; ``occupied``, how many of them
        have a contact in the annulus; ``own_radius`` (m), the sum of each pattern's own mean contact radius
        there, zero where it has none. In the form that `contactimg.fit_contact_law` takes for places, and the
        tables of one load in that of `contactimg.average_profile`.

    Raises
    ------
    InputError
        If there are no members, or fewer than one group.

    Notes
    -----
    ``a/n`` is the mean radius of all contacts, ``own_radius/patterns`` the mean over patterns in which an
    annulus without contacts counts as one with contacts of radius zero. They part where many are empty.

    Examples
    --------
    >>> from contactimg import solve_ensemble
    >>> members = solve_ensemble(
    ...     "SA", patterns=4, loads=[0.02], side=4e-3, indenter_radius=0.1288, contact_modulus=4e6, seed=1
    ... )
    >>> sums = gather_annuli(members, centre=(2e-3, 2e-3), edges=[0.0, 1e-3, 3e-3], groups=2)
    >>> [round(float(group["p"].sum()), 6) for group in sums["asymptotic", 0.02].values()]  # 2 x 0.02 N
    [0.04, 0.04]
    """
    if groups < 1:
        raise InputError(f"groups must be at least 1, got {groups!r}")
    edges = np.asarray(edges, dtype=np.float64)
    sums: dict[tuple[str, float], dict[str, pd.DataFrame]] = {}
    for member in members:
        name = str(member.index % groups)
        for key, solution in member.solutions.items():
            one = _one_pattern(annulus_moments(_bare_contacts(solution), centre=centre, edges=edges))
            so_far = sums.setdefault(key, {})
            so_far[name] = so_far[name] + one if name in so_far else one
    if not sums:
        raise InputError("an ensemble needs one pattern and one load at least")
    ends = {"inner": edges[:-1], "outer": edges[1:], "sector": 0}
    return {
        key: {name: pd.DataFrame(ends).join(table) for name, table in tables.items()}
        for key, tables in sums.items()
    }


def _bare_contacts(solution: InteractingSolution) -> pd.DataFrame:
    """The columns of the contacts that annuli need: the whole table would cost more than the solution."""
    rows = solution.touching
    return pd.DataFrame(
        {
            "x_m": solution.x[rows],
            "y_m": solution.y[rows],
            "radius_m": solution.radius[rows],
            "force_N": solution.force[rows],
        }
    )


def _one_pattern(moments: pd.DataFrame) -> pd.DataFrame:
    """What one pattern adds to each annulus."""
    n, a = moments["n"].to_numpy(float), moments["a"].to_numpy(float)
    return moments.drop(columns=["inner", "outer", "sector"]).assign(
        patterns=1.0, occupied=(n > 0).astype(float), own_radius=a / np.maximum(n, 1.0)
    )
