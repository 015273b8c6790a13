"""Calls of one function in processes of this machine, with the results in order."""

import os
import pickle
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import cloudpickle
from loky import cpu_count, get_reusable_executor
from loky.backend import resource_tracker
from loky.process_executor import BrokenProcessPool

from contactimg.engine.worker_life import live_with_parent
from contactimg.errors import ContactimgError

Result = TypeVar("Result")

IDLE_SECONDS = 300
"""After which a process without work ends. Chosen: longer than a command works alone between two passes."""

AHEAD = 8
"""Calls for each process that are made before the oldest result is taken. Chosen: a call that takes as long
as eight others keeps no process waiting, and that many results fit into memory."""

MOST_FAILURES = 8
"""Calls in a row, each of which ended its process alone, after which no other is made. Chosen: then it is not
the calls, and each failure costs seconds, in which processes start."""

_THREADS = (
    "BLIS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


def call_in_processes(
    function: Callable[..., Result],
    arguments: Iterable[tuple[Any, ...]],
    lost: Callable[..., Result] | None = None,
    *,
    processes: int,
) -> Iterator[Result]:
    """Call a function for each tuple of arguments; see `contactimg.engine.calls.in_parallel`.

    A caller that is slower than the processes holds them up: no more than `AHEAD` results for each process
    wait in memory. If the caller is interrupted, the calls that still run are ended with their processes.
    """
    with _written(function) as file:
        pool = _Pool(file, processes, lost)
        try:
            for item in arguments:
                pool.submit(item)
                if len(pool.calls) == AHEAD * processes:
                    yield pool.first()
            while pool.calls:
                yield pool.first()
        finally:
            if pool.calls:
                pool.end()


class _Pool:
    """Processes, started anew when one of them was ended, and the calls that were made and not yet taken."""

    def __init__(self, file: str, processes: int, lost: Callable[..., Any] | None) -> None:
        self.calls = deque[tuple[tuple[Any, ...], Future[Any]]]()
        self._file, self._processes, self._lost = file, processes, lost
        self._executor = self._started()
        self._failures = 0  # in a row

    def _started(self) -> Any:
        return get_reusable_executor(
            max_workers=self._processes,
            timeout=IDLE_SECONDS,
            initializer=live_with_parent,
            initargs=(os.getpid(),),
            env={
                name: os.environ.get(name, str(max(1, cpu_count() // self._processes))) for name in _THREADS
            },
        )

    def submit(self, item: tuple[Any, ...]) -> None:
        """Make a call."""
        self.calls.append((item, self._future(item)))

    def _future(self, item: tuple[Any, ...]) -> Future[Any]:
        try:
            future: Future[Any] = self._executor.submit(_call, self._file, *item)
        except BrokenProcessPool:
            self._executor = self._started()
            future = self._executor.submit(_call, self._file, *item)
        return future

    def first(self) -> Any:
        """The result of the oldest call, when it is there."""
        item, future = self.calls[0]
        try:
            found = self._result(item, future)
            self._failures = 0
        except BrokenProcessPool:
            found = self._given_up(item)
        self.calls.popleft()
        return found

    def _result(self, item: tuple[Any, ...], future: Future[Any]) -> Any:
        try:
            return future.result()
        except BrokenProcessPool:  # by any of the calls under way
            return self._alone(item).result()

    def _alone(self, item: tuple[Any, ...]) -> Future[Any]:
        """A call with nothing else in the processes: whatever ends its process now is its own doing."""
        wait([future for _, future in self.calls])
        return self._future(item)

    def _given_up(self, item: tuple[Any, ...]) -> Any:
        """What stands for the result of a call that ended its process alone."""
        self._failures += 1
        if self._lost is None or self._failures == MOST_FAILURES:
            raise ContactimgError(
                "a worker process was ended from outside, perhaps because memory ran out; start the command "
                "again, with fewer --workers if memory is short"
            )
        failure = ContactimgError(
            "ended its process, in the end with no other beside it, perhaps because memory ran out"
        )
        return self._lost(failure, *item)

    def end(self) -> None:
        """End the calls that still run, with their processes."""
        self._executor.shutdown(kill_workers=True)


@contextmanager
def _written(function: Callable[..., Any]) -> Iterator[str]:
    """A file with the function, which each process reads once: it may hold images.

    The file is deleted when this process ends, whatever ends it.
    """
    handle, name = tempfile.mkstemp(prefix="contactimg_", suffix=".pickle")
    resource_tracker.register(name, "file")
    try:
        with os.fdopen(handle, "wb") as file:
            cloudpickle.dump(function, file, protocol=pickle.HIGHEST_PROTOCOL)
        yield name
    finally:
        resource_tracker.maybe_unlink(name, "file")


def _call(file: str, *arguments: Any) -> Any:
    """In a process: call the function of a file."""
    return _function(file)(*arguments)


@lru_cache(1)
def _function(file: str) -> Callable[..., Any]:
    """The function of a file."""
    function: Callable[..., Any] = pickle.loads(Path(file).read_bytes())  # noqa: S301 - written by the parent
    return function
