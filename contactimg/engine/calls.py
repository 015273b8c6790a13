"""Calls of one function, in several processes or on the cluster in use, with the results in order."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from multiprocessing import parent_process
from typing import Any, TypeVar

from loky import cpu_count

from contactimg.engine.cluster import cluster_in_use
from contactimg.engine.local import call_in_processes
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
        Called with the error and the arguments of a call that ended its worker among others and again alone:
        gives the result in its place. Default: the error is raised.

    Raises
    ------
    ContactimgError
        If calls end their workers and there is no ``lost``, or several of them in a row do; if the cluster
        has gone.

    Notes
    -----
    Local workers end with this process, whatever ends it (`contactimg.engine.worker_life`).
    """
    cluster = cluster_in_use()
    processes = _processes(count, workers) if cluster is None else cluster.processes()
    if cluster is None and processes == 1:
        return (function(*item) for item in arguments)
    call = partial(call_in_processes, processes=processes) if cluster is None else cluster.call
    if not is_collecting():
        return call(function, arguments, lost)

    def lost_in_time(error: ContactimgError, _function: object, *item: Any) -> Any:
        if lost is None:
            raise error
        return collect_call(lost, error, *item)

    jobs = ((function, *item) for item in arguments)
    return gather(call(collect_call, jobs, lost_in_time), processes=processes)


def _processes(count: int, workers: int | None) -> int:
    """Processes of this machine that share calls; a process that was started for calls starts none itself."""
    if parent_process() is not None:
        return 1
    if workers is None:
        workers = 1 if count < FEW_CALLS else -1
    return workers if workers > 0 else max(1, cpu_count() + 1 + workers)
