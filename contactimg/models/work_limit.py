"""Bound the work of one solution: terms of the coupling sums are counted, and too many are refused."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from contactimg.errors import ConvergenceError, InputError

MAX_TERMS = 2e7
"""Most terms of one solution: under a minute. A term is two displacements of one asperity in fast sums, 1 to
2.4 us; before near pairs were stored it was one sum for two sets of forces. The environment variable
`MAX_TERMS_VARIABLE` replaces it."""

MAX_TERMS_VARIABLE = "CONTACTIMG_MAX_TERMS"
"""Environment variable with the largest number of terms of one solution."""

PRODUCTS_PER_TERM = 4000
"""Multiplications of a stored matrix in the time of one term. Measured: 0.5 ns each."""

FACTORISATION_PER_TERM = 1.5e5
"""Cube of the size of a matrix whose Cholesky factorisation takes as long as one term. Measured: 0.7 s for
size 4000."""


@dataclass
class _Work:
    """Terms allowed and taken."""

    most: float
    taken: float = 0.0


_work: ContextVar[_Work | None] = ContextVar("work", default=None)


def max_terms() -> float:
    """The largest number of terms of one solution.

    Raises
    ------
    InputError
        If the environment variable holds no positive number.
    """
    stated = os.environ.get(MAX_TERMS_VARIABLE)
    if stated is None:
        return MAX_TERMS
    try:
        number = float(stated)
    except ValueError:
        number = 0.0
    if not number >= 1:
        raise InputError(f"{MAX_TERMS_VARIABLE} must be a positive number, got {stated!r}")
    return number


@contextmanager
def limit_work() -> Iterator[None]:
    """Count the terms of one solution until the context ends."""
    before = _work.set(_Work(max_terms()))
    try:
        yield
    finally:
        _work.reset(before)


def count_terms(terms: float) -> None:
    """Count terms; `ConvergenceError` beyond what one solution may take."""
    work = _work.get()
    if work is None:
        return
    work.taken += terms
    if work.taken > work.most:
        raise ConvergenceError(
            f"the contact forces did not converge in {work.most:.3g} terms of the coupling sums, the most of "
            "one solution (about a minute): lower the load, take a part of the pattern, or set "
            f"{MAX_TERMS_VARIABLE} to a larger number"
        )


def count_matrix(size: int, *, products: int = 0, factorisations: int = 0) -> None:
    """Count products with a stored matrix, and its factorisations, as terms that take as long."""
    count_terms(products * size**2 / PRODUCTS_PER_TERM + factorisations * size**3 / FACTORISATION_PER_TERM)
