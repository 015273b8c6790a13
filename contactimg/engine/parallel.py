"""Calls of one function in this process, in several of this machine or on a cluster; results in order."""

import os
import pickle
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from functools import lru_cache
from itertools import islice
from multiprocessing import parent_process
from numbers import Integral
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

import cloudpickle
from loky import cpu_count, get_reusable_executor
from loky.backend import resource_tracker
from loky.process_executor import BrokenProcessPool

from contactimg.engine.cluster import ENDED, WorkerEndedError, cluster_in_use
from contactimg.engine.processes import end_workers, keep_workers, live_with_parent, workers_wait
from contactimg.engine.progress import counted, holding
from contactimg.errors import ContactimgError, InputError
from contactimg.timings import Seconds, add, collect, is_collecting

Result = TypeVar("Result")
Job = tuple[Any, ...]

_workers: ContextVar[int | None] = ContextVar("contactimg_workers", default=None)

START_SECONDS = 6.0
"""Time that calls must save before processes are started for them without being asked for. Measured: each
process needs about 3 s of processor time to import the package and to load its compiled functions; twice that
leaves room for an estimate from one call."""

AHEAD = 4
"""Calls for each process that are made before the oldest result is taken. Chosen: a call that takes as long
as four others keeps no process waiting, that many results fit into memory, and when a process was ended, no
more calls are made again one by one."""

MOST_FAILURES = 8
"""Calls in a row, each of which ended its process alone, after which no other is made. Chosen: then it is not
the calls, and each failure costs seconds, in which processes start."""


def sharing(workers: int | None) -> AbstractContextManager[None]:
    """Let so many processes share the calls of `in_parallel` inside the block; None: as around it."""
    return holding(_workers, _workers.get() if workers is None else workers)


def in_parallel(
    function: Callable[..., Result],
    arguments: Iterable[Job],
    *,
    count: int,
    workers: int | None = None,
    lost: Callable[..., Result] | None = None,
    shown: str = "",
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
    workers : int, optional
        Processes, no more than calls; default: those of the `sharing` around. Without any this process makes
        the first calls, and one process per core makes the others as soon as that saves more time than the
        start of processes takes. On a cluster (`contactimg.engine.cluster.on_cluster`) its workers take the
        calls instead.
    lost : callable, optional
        Called with the error and the arguments of a call that ended its worker among others and again alone:
        gives the result in its place. Default: the error is raised.
    shown : str
        As for `contactimg.engine.progress.counted`.

    Raises
    ------
    InputError
        If there is no whole number of processes.
    ContactimgError
        If calls end their workers and there is no ``lost``, or several of them in a row do; if the cluster
        has gone.

    Notes
    -----
    Local workers end with this process, whatever ends it (`contactimg.engine.processes`).
    """
    workers = _workers.get() if workers is None else workers
    if workers is not None and not (isinstance(workers, Integral) and workers >= 1):
        raise InputError(f"workers must be a whole number of processes, 1 or more, or None, got {workers!r}")
    items = iter(arguments)
    several = parent_process() is None  # a process that was started for calls starts none
    processes = min(cpu_count() if workers is None else workers, max(count, 1)) if several else 1

    def alone() -> Iterator[Result]:
        """Results from this process, until several processes are the faster ones for what is left."""
        for done, item in enumerate(items, start=1):
            begin = perf_counter()
            result = function(*item)
            saved = (count - done) * (perf_counter() - begin) * (1 - 1 / processes)
            yield result
            # the first call may have loaded compiled functions, so that its time is not that of the others;
            # chosen for processes that wait: several times what it takes to write a function to a file and to
            # read it
            if done > 1 and saved > (0.5 if workers_wait() else START_SECONDS):
                yield from _in_order(_Processes(processes), function, items, lost)

    asked = _Processes(processes) if several and workers is not None and workers > 1 else None
    takers = cluster_in_use.get() or asked
    results = alone() if takers is None else _in_order(takers, function, items, lost)
    return counted(results, shown, count)


def _in_order(
    workers: Any, function: Callable[..., Result], jobs: Iterator[Job], lost: Callable[..., Result] | None
) -> Iterator[Result]:
    """Results of workers (`_Processes` or a `contactimg.engine.cluster.Cluster`) in order.

    A caller that is slower than they are holds them up: no more than `AHEAD` results for each process wait in
    memory. If the caller stops, the calls that still run are dropped.

    A process that ends takes all calls with it that were handed over. Each of these is made again alone when
    it is its turn: one that ends its process then too is the cause.
    """
    calls, failures = deque[tuple[Job, Future[tuple[Result, Seconds]]]](), 0
    with _stored((function, is_collecting()), workers.folder) as name:
        try:
            while True:
                for item in islice(jobs, max(AHEAD * workers.processes() - len(calls), 0)):
                    calls.append((item, workers.submit(_call, name, *item)))
                if not calls:
                    return
                item, future = calls.popleft()
                try:
                    try:
                        result = _result(workers, future)
                    except WorkerEndedError:
                        workers.wait([other for _, other in calls])
                        result = _result(workers, workers.submit(_call, name, *item))
                    failures = 0
                except WorkerEndedError as error:
                    failures += 1
                    if lost is None or failures == MOST_FAILURES:
                        raise ContactimgError(
                            "a worker process was ended from outside, perhaps because memory ran out; start "
                            "the command again, with fewer --workers if memory is short"
                        ) from error
                    result = lost(error, *item)
                yield result
        finally:
            if calls:
                end_workers()


def _result(workers: Any, future: Future[tuple[Result, Seconds]]) -> Result:
    """The result of a call when it is there; its error in the words of the workers."""
    workers.wait([future])
    try:
        result, seconds = future.result()
    except Exception as error:
        raise workers.named(error) from None
    add(seconds)
    return result


class _Processes:
    """Processes of this machine that take calls, started anew when one of them was ended."""

    folder: Path | None = None
    """Where files for the processes lie: in the usual folder of temporary files."""

    def __init__(self, count: int) -> None:
        self._count = count

    def processes(self) -> int:
        return self._count

    def _executor(self) -> Any:
        threads = str(max(1, cpu_count() // self._count))
        libraries = ("BLIS", "MKL", "NUMBA", "OMP", "OPENBLAS", "VECLIB")
        names = [f"{library}_NUM_THREADS" for library in libraries]
        executor = get_reusable_executor(
            max_workers=self._count,
            timeout=300,  # s, chosen: longer than a command works alone between two passes
            initializer=live_with_parent,
            initargs=(os.getpid(),),
            env={name: os.environ.get(name, threads) for name in names},
        )
        keep_workers(executor)
        return executor

    def submit(self, function: Callable[..., Result], *arguments: Any) -> Future[Result]:
        """Hand a call to the processes, to new ones if one of them ends while it is handed over."""
        with suppress(BrokenProcessPool):
            return self._executor().submit(function, *arguments)
        return self._executor().submit(function, *arguments)

    def wait(self, futures: list[Future[Any]]) -> None:
        """Wait until calls have ended: a process of this machine that has gone ends its calls."""
        wait(futures)

    def named(self, error: BaseException) -> BaseException:
        ended = isinstance(error, BrokenProcessPool)
        return WorkerEndedError(ENDED.format("its process")) if ended else error


@contextmanager
def _stored(call: tuple[Callable[..., Any], bool], folder: Path | None) -> Iterator[str]:
    """A file with a function, and whether it is timed, which each worker reads once: it may hold images.

    The file is deleted when this process ends, whatever ends it.
    """
    handle, name = tempfile.mkstemp(prefix=".contactimg_", suffix=".pickle", dir=folder)
    resource_tracker.register(name, "file")
    try:
        with os.fdopen(handle, "wb") as file:
            cloudpickle.dump(call, file, protocol=pickle.HIGHEST_PROTOCOL)
        yield name
    finally:
        resource_tracker.maybe_unlink(name, "file")


def _call(file: str, *arguments: Any) -> tuple[Any, Seconds]:
    """The result of the function of a file, in a worker, and the times of its steps if they are asked for."""
    function, timed = _read(file)
    with collect() if timed else nullcontext(Seconds()) as seconds:
        return function(*arguments), seconds


@lru_cache(1)
def _read(file: str) -> tuple[Callable[..., Any], bool]:
    """The content of a file."""
    call: tuple[Callable[..., Any], bool] = pickle.loads(Path(file).read_bytes())  # noqa: S301 - by `_stored`
    return call
