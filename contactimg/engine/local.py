"""Calls of one function in processes of this machine, with the results in order."""

import os
import pickle
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
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

_THREADS = (
    "BLIS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


def call_in_processes(
    function: Callable[..., Result], arguments: Iterable[tuple[Any, ...]], processes: int
) -> Iterator[Result]:
    """Call a function for each tuple of arguments; see `contactimg.engine.calls.in_parallel`.

    A caller that is slower than the processes holds them up: no more than `AHEAD` results for each process
    wait in memory. If the caller is interrupted, the calls that still run are ended with their processes.
    """
    executor = get_reusable_executor(
        max_workers=processes,
        timeout=IDLE_SECONDS,
        initializer=live_with_parent,
        initargs=(os.getpid(),),
        env={name: os.environ.get(name, str(max(1, cpu_count() // processes))) for name in _THREADS},
    )
    calls = deque[Future[Result]]()
    with _written(function) as file:
        try:
            for item in arguments:
                calls.append(executor.submit(_call, file, *item))
                if len(calls) == AHEAD * processes:
                    yield calls.popleft().result()
            while calls:
                yield calls.popleft().result()
        except BrokenProcessPool:
            raise ContactimgError(
                "a worker process was ended from outside, perhaps because memory ran out; start the command "
                "again, with fewer --workers if memory is short"
            ) from None
        finally:
            if calls:
                executor.shutdown(kill_workers=True)


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
