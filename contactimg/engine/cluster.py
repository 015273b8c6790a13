"""Calls on the workers of a dask.distributed scheduler, by its own futures, with the results in order."""

import logging
import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import chdir, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from contactimg.engine.installation import difference, installation
from contactimg.errors import ContactimgError, InputError, finite_number

if TYPE_CHECKING:
    from distributed import Client, Future

PATIENCE_SECONDS = 45.0
"""How long a run waits for a scheduler that does not answer, or without any worker. Chosen: a run that cannot
go on ends within a minute; `PATIENCE_VARIABLE` replaces it, for workers that wait in the queue of a batch
system."""

PATIENCE_VARIABLE = "CONTACTIMG_CLUSTER_WAIT_S"
"""Environment variable with the patience in seconds."""

CALLS_PER_PROCESS = 4
"""Calls that are handed out at a time, per process of the cluster. Chosen: no process waits while the results
of a slow call before them are awaited; sensitivity not measured."""

SENDING_TRIES = 3
"""Times that a function is sent while workers are being ended. Chosen by hand; changes no result."""

_LOOK_EVERY_SECONDS = 2.0  # whether there is still a worker
_CLOSE_SECONDS = 5.0  # chosen: a connection that cannot be closed in this time is left to the system

_one_at_a_time = threading.Lock()
_in_use: ContextVar["Cluster | None"] = ContextVar("contactimg_cluster", default=None)


class ClusterError(ContactimgError):
    """The cluster cannot be used, or has gone."""


@dataclass(frozen=True)
class _Task:
    """What all calls have in common: it travels once to each worker.

    Parameters
    ----------
    function : callable
    folder : str
        Working directory of the command, in which relative paths are read.
    installation : dict
        Of the command: workers must have the same.
    """

    function: Callable[..., Any]
    folder: str
    installation: dict[str, str]

    def call(self, arguments: tuple[Any, ...]) -> Any:
        """Call the function, on a worker."""
        other = difference(self.installation, installation())
        if other:
            raise ClusterError(f"the command and a worker of the cluster differ: {other}; install the same")
        if not Path(self.folder).is_dir():
            raise ClusterError(
                f"a worker of the cluster has no folder {self.folder}; command and workers must see frames "
                "and results under the same path (a shared folder)"
            )
        # figures and the working directory belong to the process: its threads take turns
        with _one_at_a_time, chdir(self.folder):
            return self.function(*arguments)


def _call(name: str, arguments: tuple[Any, ...]) -> Any:
    """A call on a worker, of the task that it has under a name."""
    from distributed import get_worker

    common: Any = get_worker().plugins[name]
    return common.task.call(arguments)


class Cluster:
    """The workers of a dask.distributed scheduler.

    Parameters
    ----------
    client : distributed.Client
    place : str
        Address or scheduler file, for messages.
    """

    def __init__(self, client: "Client", place: str) -> None:
        self._client = client
        self._place = place

    def processes(self) -> int:
        """Threads of all workers now; one at least."""
        return max(1, sum(self._client.nthreads().values()))

    def call(
        self,
        function: Callable[..., Any],
        arguments: Iterable[tuple[Any, ...]],
        lost: Callable[..., Any] | None = None,
    ) -> Iterator[Any]:
        """Call a function for each tuple of arguments; results in order, a few in memory at a time.

        Parameters
        ----------
        function : callable
            Sent once; known under its name on the workers.
        arguments : iterable of tuple
            Taken as they are needed.
        lost : callable, optional
            Called with the error and the arguments of a call that ended one worker after the other; gives the
            result in its place.

        Raises
        ------
        ClusterError
            If the scheduler has gone, or no worker is there for `PATIENCE_SECONDS`.
        """
        pending: deque[tuple[tuple[Any, ...], Future]] = deque()
        rest, task = iter(arguments), _Task(function, str(Path.cwd()), installation())
        with self._sent(task) as name:
            while True:
                with self._failures_named():
                    room = max(CALLS_PER_PROCESS * self.processes() - len(pending), 0 if pending else 1)
                for item in islice(rest, room):
                    with self._failures_named():
                        pending.append((item, self._submit(name, item)))
                if not pending:
                    return
                # what is pending when the caller stops is dropped: the scheduler forgets such calls
                item, future = pending.popleft()
                if self._was_killed(future):
                    future = self._alone(name, item, [other for _, other in pending])
                yield self._result(item, future, lost)

    @contextmanager
    def _sent(self, task: _Task) -> Iterator[str]:
        """The name under which all workers have a task, those that come later as well.

        A task that calls depend on as on a result is lost with the only worker that has it: distributed
        2026.8 then may wait for ever for another worker that was just about to fetch it.
        """
        from contactimg.engine.cluster_plugin import CommonTask

        name = f"contactimg-{uuid4().hex}"
        with self._failures_named():
            for _ in range(SENDING_TRIES - 1):
                with suppress(OSError):  # a worker was ended just then
                    self._client.register_plugin(CommonTask(task), name=name)
                    break
            else:
                self._client.register_plugin(CommonTask(task), name=name)
        try:
            yield name
        finally:
            scheduler: Any = self._client.scheduler
            with suppress(Exception):  # it may have gone
                self._client.sync(
                    scheduler.unregister_worker_plugin, name=name, callback_timeout=_CLOSE_SECONDS
                )

    def _submit(self, name: str, arguments: tuple[Any, ...]) -> "Future":
        """A future of a call."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sending large graph", category=UserWarning)
            return self._client.submit(_call, name, arguments, pure=False)

    def _was_killed(self, future: "Future") -> bool:
        """Whether a call was on one ended worker after the other, by its own doing or that of others."""
        from distributed import KilledWorker

        with self._failures_named():
            return isinstance(self._error_of(future), KilledWorker)

    def _alone(self, name: str, arguments: tuple[Any, ...], others: list["Future"]) -> "Future":
        """A call with nothing else on the cluster: whatever ends its workers now is its own doing."""
        with self._failures_named():
            for other in others:
                self._error_of(other)
            return self._submit(name, arguments)

    def _result(self, arguments: tuple[Any, ...], future: "Future", lost: Callable[..., Any] | None) -> Any:
        """The result of a call when it is there."""
        if not self._was_killed(future):
            with self._failures_named():
                error = self._error_of(future)
                if error is None:
                    return future.result()
            if isinstance(error, ModuleNotFoundError):
                raise ClusterError(f"a worker of the cluster has {error}; install contactimg there")
            raise error
        failure = ClusterError(
            "ended every worker of the cluster that tried it, in the end alone, perhaps because memory ran "
            "out there"
        )
        if lost is None:
            raise failure
        return lost(failure, *arguments)

    def _error_of(self, future: "Future") -> Exception | None:
        """The error of a future, or None, when it is there; waits as long as there are workers."""
        limit, seen = patience(), time.monotonic()
        while True:
            with suppress(TimeoutError):
                return future.exception(timeout=_LOOK_EVERY_SECONDS)
            if self._client.nthreads():
                seen = time.monotonic()
            elif time.monotonic() - seen > limit:
                raise ClusterError(
                    f"the cluster at {self._place} has had no worker for {limit:g} s; start workers and the "
                    f"same command again, or set {PATIENCE_VARIABLE} to wait longer"
                )

    @contextmanager
    def _failures_named(self) -> Iterator[None]:
        """Turn the errors of a connection into a sentence."""
        from distributed.client import ClosedClientError

        try:
            yield
        except ContactimgError:
            raise
        except (CancelledError, ClosedClientError, OSError, RuntimeError) as error:
            raise ClusterError(
                f"the cluster at {self._place} cannot go on ({type(error).__name__}: {error}); if its "
                "scheduler has gone, start it and the same command again"
            ) from None


def cluster_in_use() -> Cluster | None:
    """The cluster of the `on_cluster` around."""
    return _in_use.get()


def patience() -> float:
    """How long to wait for scheduler and workers, s.

    Raises
    ------
    InputError
        If the environment variable holds no positive number.
    """
    seconds = finite_number(os.environ.get(PATIENCE_VARIABLE, PATIENCE_SECONDS), PATIENCE_VARIABLE, "seconds")
    if seconds <= 0:
        raise InputError(f"{PATIENCE_VARIABLE} must be positive, got {seconds:g} s")
    return seconds


@contextmanager
def on_cluster(place: str) -> Iterator[Cluster]:
    """Let the workers of a cluster take the calls of `contactimg.engine.calls.in_parallel`.

    Parameters
    ----------
    place : str
        Address of the scheduler, ``tcp://host:8786``, or path of its scheduler file.

    Yields
    ------
    Cluster

    Raises
    ------
    InputError
        If dask.distributed is not installed or the place is neither.
    ClusterError
        If no scheduler answers.

    Notes
    -----
    Workers must see input and output folders under the same paths, and have the same versions.
    """
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise InputError(
            'a cluster needs dask.distributed; install it with: pip install "contactimg[cluster]"'
        ) from None
    where = _place_of(place)
    for name in ("distributed", "distributed.client"):  # what it reports is in the errors here
        logging.getLogger(name).setLevel(logging.CRITICAL)
    limit = patience()
    with dask.config.set({"distributed.comm.timeouts.connect": limit}):
        try:
            client = Client(**where, timeout=limit, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"no scheduler answers at {place} ({type(error).__name__}: {error}); "
                "start one with: dask scheduler"
            ) from None
        token = _in_use.set(Cluster(client, place))
        try:
            yield Cluster(client, place)
        finally:
            _in_use.reset(token)
            with suppress(Exception):  # the scheduler may have gone
                client.close(timeout=_CLOSE_SECONDS)


def _place_of(place: str) -> dict[str, str]:
    """The arguments of a client for an address or a scheduler file."""
    if "://" in place:
        return {"address": place}
    if not Path(place).is_file():
        raise InputError(
            f"--cluster {place}: neither an address such as tcp://host:8786 nor a scheduler file that exists"
        )
    return {"scheduler_file": place}
