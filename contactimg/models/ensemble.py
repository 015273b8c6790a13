"""Ensembles of random patterns, each solved at several loads."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactimg.engine.parallel import in_parallel
from contactimg.errors import InputError
from contactimg.models.composite_summits import CompositeSummits
from contactimg.models.interacting import COUPLINGS, solve_loads
from contactimg.models.solution import InteractingSolution
from contactimg.surfaces import CapLaw, generate_asperities


@dataclass(frozen=True, eq=False)
class EnsembleMember:
    """One pattern, solved at all loads and levels of coupling.

    Parameters
    ----------
    index : int
        Number of the pattern, from 0.
    solutions : dict
        ``(coupling, load)`` -> `InteractingSolution`.
    """

    index: int
    solutions: dict[tuple[str, float], InteractingSolution]


DrawnSurface = Callable[[np.random.Generator], tuple[CapLaw, float]]
"""Draws the law of the caps and the covered fraction of one pattern."""


def solve_ensemble(
    kind: str | CapLaw | DrawnSurface,
    *,
    patterns: int,
    loads: Sequence[float],
    side: float,
    indenter_radius: float,
    contact_modulus: float,
    seed: int,
    coverage: float | None = None,
    contact_modulus_std: float = 0.0,
    couplings: Sequence[str] = ("none", "asymptotic"),
    first: int = 0,
    workers: int = 1,
) -> Iterator[EnsembleMember]:
    """Solve random patterns under a lens centred on each, one after the other.

    Parameters
    ----------
    kind : {"SA", "RA-", "RA+"}, CapLaw or callable
        As in `contactimg.generate_asperities`: places, heights and radii are drawn anew for each pattern. A
        function of a `numpy.random.Generator` that returns a law and a covered fraction, such as
        ``functools.partial(contactimg.draw_surface, "RA-")``, draws these anew as well.
    patterns : int
        Number of patterns.
    loads : sequence of float, N
    side : float, m
        Side of the square pattern.
    indenter_radius : float, m
    contact_modulus : float, Pa
    seed : int
        Pattern ``k`` depends only on the seed and on ``k``, not on the number of patterns or workers.
    coverage : float, optional
    contact_modulus_std : float, Pa
        Of a normal law from which the modulus of each pattern is drawn; 0 for the same modulus.
    couplings : sequence of str
        Levels of coupling to solve for.
    first : int
        Number of the first pattern that is solved: with that of a run that was ended it goes on.
    workers : int
        Processes; -1 for all cores. Within `contactimg.engine.cluster.on_cluster` those of the cluster.

    Yields
    ------
    EnsembleMember
        In the order of the patterns, each as soon as it is solved; only a few are held in memory.

    Raises
    ------
    InputError
        If an argument breaks its rule.

    Examples
    --------
    >>> members = solve_ensemble(
    ...     "SA", patterns=2, loads=[0.02], side=4e-3, indenter_radius=0.1288, contact_modulus=4e6, seed=1
    ... )
    >>> [len(member.solutions) for member in members]
    [2, 2]
    """
    if patterns < 0 or isinstance(patterns, bool):
        raise InputError(f"patterns must not be negative, got {patterns!r}")
    if not 0 <= first <= patterns or isinstance(first, bool):
        raise InputError(f"first must be between 0 and the number of patterns {patterns}, got {first!r}")
    unknown = [level for level in couplings if level not in COUPLINGS]
    if unknown:
        raise InputError(f"couplings must be among {', '.join(map(repr, COUPLINGS))}, got {unknown[0]!r}")
    sweep, couplings = [float(load) for load in loads], tuple(couplings)
    where: dict[str, Any] = {"indenter_radius": indenter_radius, "apex": (side / 2, side / 2)}

    def solve(index: int) -> EnsembleMember:  # with its own random stream, the child of the seed by its index
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        modulus = contact_modulus
        if contact_modulus_std:
            modulus = float(rng.normal(contact_modulus, contact_modulus_std))
        law, covered = kind(rng) if callable(kind) else (kind, coverage)
        pattern = generate_asperities(law, side=side, coverage=covered, rng=rng)
        summits = CompositeSummits.of(pattern, **where)
        solutions = {}
        for coupling in couplings:
            found = solve_loads(summits, loads=sweep, contact_modulus=modulus, coupling=coupling, **where)
            solutions.update({(coupling, load): one for load, one in zip(sweep, found, strict=True)})
        return EnsembleMember(index, solutions)

    members = ((k,) for k in range(first, patterns))
    yield from in_parallel(solve, members, count=patterns - first, workers=workers)
