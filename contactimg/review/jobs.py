"""Measuring again beside the page: one job at a time in a thread of its own."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from queue import SimpleQueue
from threading import Condition, Thread

from contactimg.errors import ContactimgError

logger = logging.getLogger(__name__)

Work = Callable[[Callable[[], None]], None]
"""A job is called with a function that it calls once a frame."""
SECONDS = 30.0
"""Time that a request may take to arrive, and that answers and a cancelled job have to end when the server is
closed. Chosen: longer than a frame takes."""


@dataclass(frozen=True)
class JobState:
    """How far a job is.

    Parameters
    ----------
    number : int
        Counts jobs from 1; 0 before the first.
    running : bool
    done, total : int
        Frames.
    error : str
        Why it failed; empty if it did not.
    """

    number: int = 0
    running: bool = False
    done: int = 0
    total: int = 0
    error: str = ""


class CancelledError(Exception):
    """The job is to end."""


class Jobs:
    """Runs one job at a time.

    Notes
    -----
    The thread lives as long as the process: worker processes end with the thread that started them.
    """

    def __init__(self) -> None:
        self.state = JobState()
        self._changed, self._cancelled = Condition(), False
        self._queue: SimpleQueue[Work] = SimpleQueue()
        Thread(target=self._work, daemon=True, name="review job").start()

    def start(self, work: Work, *, total: int) -> bool:
        """Start a job; False if one is running."""
        with self._changed:
            if self.state.running:
                return False
            self._cancelled = False
            self.state = JobState(self.state.number + 1, running=True, total=total)
            self._queue.put(work)
            return True

    def wait(self, seconds: float | None = None) -> JobState:
        """The state when the job that runs, if any, has ended."""
        with self._changed:
            self._changed.wait_for(lambda: not self.state.running, seconds)
            return self.state

    def close(self) -> None:
        """End the job that runs, after the frame it is at."""
        self._cancelled = True
        self.wait(SECONDS)

    def _work(self) -> None:
        while True:
            work = self._queue.get()
            error = ""
            try:
                work(self._advance)
            except CancelledError:
                error = "cancelled"
            except ContactimgError as reason:
                error = str(reason)
            except Exception as reason:  # the page must hear of it, whatever it is
                logger.exception("the job ended")
                error = f"{type(reason).__name__}: {reason}"
            with self._changed:
                self.state = replace(self.state, running=False, error=error)
                self._changed.notify_all()

    def _advance(self) -> None:
        """Note that a frame is done, and end the job here if it was cancelled."""
        if self._cancelled:
            raise CancelledError
        with self._changed:
            self.state = replace(self.state, done=min(self.state.done + 1, self.state.total))
