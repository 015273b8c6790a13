"""A dask.distributed scheduler and workers on this machine, each a process that a test may kill."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

TESTS = Path(__file__).parents[1]
TIME_LIMIT_S = 60.0


def start(stack: ExitStack, *arguments: str, **variables: str) -> subprocess.Popen:
    """A Python module in a process of its own, ended with the stack."""
    paths = os.pathsep.join(str(path) for path in (TESTS.parent, TESTS / "helpers"))
    environment = os.environ | {"PYTHONPATH": paths, "PYTHONWARNINGS": "ignore", "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", *arguments],
        env=environment | variables,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def end() -> None:
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(process.pid, number)
                process.wait(3)
            except (ProcessLookupError, subprocess.TimeoutExpired):
                pass
        process.wait(10)

    stack.callback(end)
    return process


def wait_until(condition, seconds: float = TIME_LIMIT_S) -> None:
    """Wait, but not for ever."""
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "does not happen"
        time.sleep(0.02)


class LocalCluster:
    """A scheduler, its file and its workers, in a new folder.

    A call whose worker is ended is given up by the scheduler after ``failures`` more.
    """

    def __init__(self, stack: ExitStack, folder: Path, *, workers: int = 2, failures: int = 0) -> None:
        folder.mkdir()
        self.stack, self.folder, self.file = stack, folder, folder / "scheduler.json"
        options = ["--port", "0", "--no-dashboard", "--host", "127.0.0.1", "--scheduler-file", str(self.file)]
        allowed = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(failures)}
        self.scheduler = start(stack, "distributed.cli.dask_scheduler", *options, **allowed)
        wait_until(self.file.exists)
        self.workers = [self.start_worker() for _ in range(workers)]

    def start_worker(self) -> subprocess.Popen:
        """One more worker, which nothing starts again."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder)]
        file = ["--scheduler-file", str(self.file)]
        return start(self.stack, "distributed.cli.dask_worker", *file, *options)


def files_of(folder: Path) -> dict[str, bytes]:
    """Name -> bytes of what a command wrote, without the record of when and how."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "provenance.json"
    }
