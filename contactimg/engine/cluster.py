"""Calls on the workers of a dask.distributed scheduler, by its own futures."""

import hashlib
import logging
import platform
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, wait
from contextlib import chdir, contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactimg.engine.progress import holding
from contactimg.errors import ContactimgError, InputError

if TYPE_CHECKING:
    from distributed import Client

LIBRARIES = ("numpy", "scipy", "numba", "pandas", "opencv-python-headless", "scikit-image", "finufft")
"""Libraries that compute numbers."""

PATIENCE = "distributed.comm.timeouts.connect"
"""Setting of dask: how long a run waits for a scheduler that does not answer, or without any worker."""

ENDED = "ended {}, in the end with no other call beside it, perhaps because memory ran out"
"""What is said of a call that ended its worker."""

_one_at_a_time = threading.Lock()
cluster_in_use: ContextVar["Cluster | None"] = ContextVar("contactimg_cluster", default=None)
"""The cluster of the `on_cluster` around."""


class ClusterError(ContactimgError):
    """The cluster cannot be used, or has gone."""


class WorkerEndedError(ContactimgError):
    """The worker process of a call was ended, by the call itself or from outside."""


@cache
def source_digest() -> str:
    """SHA-256 of the code of contactimg: two versions under development have the same number."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def installation() -> dict[str, str]:
    """Name -> version of whatever computes numbers."""
    versions = {name: version(name) for name in LIBRARIES}
    return {"contactimg": source_digest()[:12], "python": platform.python_version()} | versions


def _call(
    installed: dict[str, str], folder: Path, function: Callable[..., Any], file: str, *arguments: Any
) -> Any:
    """A call on a worker, which must have the same installation and see the file that the call needs.

    ``folder`` is the working directory of the command, in which relative paths are read.
    """
    here = installation()
    names = [name for name in installed if installed[name] != here.get(name)]
    if names:
        differ = ", ".join(f"{name} {installed[name]} against {here.get(name)}" for name in names)
        raise ClusterError(f"the command and a worker of the cluster differ: {differ}; install the same")
    if not Path(file).is_file():
        raise ClusterError(
            f"a worker of the cluster does not see the files in {folder}, where the command was started; "
            "command and workers must see frames and results under the same path (a shared folder)"
        )
    # figures and the working directory belong to the process: its threads take turns
    with _one_at_a_time, chdir(folder):
        return function(file, *arguments)


class Cluster:
    """The workers of a dask.distributed scheduler.

    Parameters
    ----------
    client : distributed.Client
    place : str
        Address or scheduler file, for messages.
    """

    def __init__(self, client: "Client", place: str) -> None:
        self.client, self.place = client, place
        self.folder = Path.cwd()  # of files for the workers, which all must see
        self._executor = client.get_executor(pure=False)

    def processes(self) -> int:
        """Threads of all workers now; one at least."""
        with self._failures_named():
            return max(1, sum(self.client.nthreads().values()))

    def submit(self, function: Callable[..., Any], file: str, *arguments: Any) -> Future:
        """Hand a call to the workers that needs a file.

        What many calls share lies in a file and is no result that they depend on: this may be lost with the
        only worker that has it, and distributed 2026.8 may then wait for ever for another one to fetch it.
        """
        with self._failures_named(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sending large graph", category=UserWarning)
            return self._executor.submit(_call, installation(), self.folder, function, file, *arguments)

    def wait(self, futures: list[Future[Any]]) -> None:
        """Wait until calls have ended, in whatever way, as long as there are workers."""
        import dask

        limit, seen = dask.config.get(PATIENCE), time.monotonic()
        while wait(futures, timeout=2.0).not_done:  # s, chosen by hand: how often workers are looked for
            with self._failures_named():
                seen = time.monotonic() if self.client.nthreads() else seen
            if time.monotonic() - seen > dask.utils.parse_timedelta(limit):
                raise ClusterError(
                    f"the cluster at {self.place} has had no worker for {limit}; start workers and the same "
                    f"command again, or let dask wait longer, by its setting {PATIENCE}"
                )

    def named(self, error: BaseException) -> BaseException:
        """The error of a call, or what it says about the cluster."""
        from distributed import KilledWorker

        if isinstance(error, CancelledError):  # its scheduler has gone
            return self._gone(error)
        if isinstance(error, KilledWorker):
            return WorkerEndedError(ENDED.format("every worker of the cluster that tried it"))
        if isinstance(error, ModuleNotFoundError):
            return ClusterError(f"a worker of the cluster has {error}; install contactimg there")
        return error

    def _gone(self, error: BaseException) -> ClusterError:
        return ClusterError(
            f"the cluster at {self.place} cannot go on ({type(error).__name__}: {error}); if its "
            "scheduler has gone, start it and the same command again"
        )

    @contextmanager
    def _failures_named(self) -> Iterator[None]:
        """Turn the errors of a connection into a sentence."""
        from distributed.client import ClosedClientError

        try:
            yield
        except (CancelledError, ClosedClientError, OSError, RuntimeError) as error:
            raise self._gone(error) from None


@contextmanager
def on_cluster(place: str) -> Iterator[Cluster]:
    """Let the workers of a cluster take the calls of `contactimg.engine.parallel.in_parallel`.

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
        from distributed import Client
    except ImportError:
        raise InputError("a cluster needs dask.distributed: pip install distributed") from None
    if "://" not in place and not Path(place).is_file():
        raise InputError(f"--cluster {place}: no address (tcp://host:8786) and no such scheduler file")
    where = {"address" if "://" in place else "scheduler_file": place}
    for name in ("distributed", "distributed.client"):  # what it reports is in the errors here
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(**where, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no scheduler answers at {place} ({type(error).__name__}: {error}); "
            "start one with: dask scheduler"
        ) from None
    cluster = Cluster(client, place)
    try:
        with holding(cluster_in_use, cluster):
            yield cluster
    finally:
        with suppress(Exception):  # the scheduler may have gone
            client.close(timeout=5.0)  # chosen: what is not closed then is left to the system
