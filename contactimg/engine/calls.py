"""Calls of one function, in several processes or on the cluster in use, with the results in order."""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any, TypeVar

from joblib import Parallel, delayed, effective_n_jobs
from joblib.externals.loky.process_executor import BrokenProcessPool

from contactimg.engine.cluster import cluster_in_use
from contactimg.engine.worker_life import live_with_parent
from contactimg.errors import ContactimgError
from contactimg.timings import collect_call, gather, is_collecting

Result = TypeVar("Result")

FEW_CALLS = 4
"""Below this number of calls starting processes costs more than it gains. Chosen by hand; sensitivity not
measured."""


def in_parallel(
    function: Callable[..., Result],
    arguments: Iterable[tuple[Any, ...]],
    *,
    count: int,
    workers: int | None,
    lost: Callable[..., Result] | None = None,
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
        Processes; None for one per core, or only this one for fewer than `FEW_CALLS` calls. On a cluster
        (`contactimg.engine.cluster.on_cluster`) its workers take the calls instead.
    lost : callable, optional
        On a cluster, called with the error and the arguments of a call that ended one worker after the other:
        gives the result in its place. Default: the error is raised.

    Raises
    ------
    ContactimgError
        If a worker process was ended from outside, or the cluster has gone.

    Notes
    -----
    Local workers end with this process, whatever ends it (`contactimg.engine.worker_life`).
    """
    cluster = cluster_in_use()
    if cluster is None:
        if workers is None:
            workers = 1 if count < FEW_CALLS else -1
        processes = effective_n_jobs(workers)
        if processes == 1:
            return (function(*item) for item in arguments)
    if not is_collecting():
        return (
            _local(function, arguments, workers)
            if cluster is None
            else cluster.call(function, arguments, lost)
        )
    jobs = ((function, *item) for item in arguments)
    if cluster is None:
        return gather(_local(collect_call, jobs, workers), processes=processes)

    def lost_in_time(error: ContactimgError, _function: object, *item: Any) -> Any:
        if lost is None:
            raise error
        return collect_call(lost, error, *item)

    return gather(cluster.call(collect_call, jobs, lost_in_time), processes=cluster.processes())


def _local(
    function: Callable[..., Result], arguments: Iterable[tuple[Any, ...]], workers: int | None
) -> Iterator[Result]:
    """The results of processes of this machine."""
    pool = Parallel(
        n_jobs=workers,
        backend="loky",
        return_as="generator",
        pre_dispatch="2*n_jobs",
        initializer=live_with_parent,
        initargs=(os.getpid(),),
    )
    return _closing(pool(delayed(function)(*item) for item in arguments))


def _closing(results: Generator[Result]) -> Iterator[Result]:
    """The results; if the caller is interrupted, the calls that still run are ended with their processes."""
    try:
        yield from results
    except BrokenProcessPool:
        raise ContactimgError(
            "a worker process was ended from outside, perhaps because memory ran out; start the command "
            "again, with fewer --workers if memory is short"
        ) from None
    finally:
        results.close()
