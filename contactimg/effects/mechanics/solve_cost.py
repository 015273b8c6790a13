"""Time that the solver needs for an effect: a formula fitted to timed solutions of 7 to 100 000 contacts.

Times are in ms on one core, for ``n`` asperities in the table and ``m`` contacts; only their ratios are used.
The error is a factor of two to three at most in the range timed (`benchmarks/effects_honesty.py`).
"""

FAST_SUM_FACTOR = 1.5e-2
FAST_SUM_POWER = 1.23
"""Coupled solution with fast sums, in ms: factor times contacts to the power; fitted to timed solutions."""


def solve_cost(effect: str, *, asperities: int, contacts: float) -> float:
    """Time of a solution with the effect divided by the time without any effect.

    Parameters
    ----------
    effect : {"coupling", "full_coupling", "layer", "sphere_profile", "adhesion"}
    asperities : int
        In the table.
    contacts : float

    Examples
    --------
    >>> solve_cost("full_coupling", asperities=1844, contacts=300) > solve_cost(
    ...     "coupling", asperities=1844, contacts=300
    ... )
    True
    """
    m = contacts
    cheapest = 0.6 + 1.4e-4 * asperities
    fast = FAST_SUM_FACTOR * m**FAST_SUM_POWER
    extra = {
        "coupling": 0.5 + min(3.5e-5 * m**2 + 2e-8 * m**3, fast),
        "full_coupling": 1.0 + min(1.5e-4 * m**2, 3 * fast),
        "layer": min(6e-5 * m**2, fast),
        "sphere_profile": 2.5 + 0.02 * m,
        "adhesion": 1.5 + 2.4e-7 * m**3,
    }[effect]
    return 1 + extra / cheapest
