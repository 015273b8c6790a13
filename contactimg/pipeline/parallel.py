"""The one door to several processes."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from joblib import Parallel, delayed, effective_n_jobs

from contactimg.timings import collect_call, gather, is_collecting

Result = TypeVar("Result")
FEW = 4
"""Below this number of items starting processes costs more than it gains."""


def in_parallel(
    function: Callable[..., Result], arguments: Iterable[tuple[Any, ...]], *, count: int, workers: int | None
) -> Iterator[Result]:
    """Call a function for each tuple of arguments and yield the results in order, a few in memory at a time.

    Parameters
    ----------
    function : callable
        Must not depend on the order of the calls.
    arguments : iterable of tuple
        Taken as they are needed.
    count : int
        Number of calls.
    workers : int or None
        Processes; None for one a core, or this one alone for fewer than four calls. With an active
        `joblib.parallel_config` its backend is used (Dask's, say, for a cluster).
    """
    if workers is None:
        workers = 1 if count < FEW else -1
    pool = Parallel(n_jobs=workers, return_as="generator", pre_dispatch="2*n_jobs")
    processes = effective_n_jobs(workers)
    if processes == 1 or not is_collecting():
        return pool(delayed(function)(*item) for item in arguments)
    timed = pool(delayed(collect_call)(function, *item) for item in arguments)
    return gather(timed, processes=processes)
