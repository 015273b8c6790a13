"""Where the time of a run goes, by the step of the method that is at work.

A thread looks every few milliseconds at what is computed, and charges the time since its last look to the
innermost function of this package: no code is marked, none becomes slower. Worker processes watch their own
calls, whose times are added to those of this process.
"""

import sys
import threading
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from time import perf_counter
from types import FrameType

OTHER, WAITING = "other", "waiting for processes"
"""Time outside of this package, and that in which this process waits for the results of others."""

Seconds = dict[str, float]
"""Name of a step, as of its folder or module -> time in it without that of the steps inside, s."""

_watched: ContextVar[Seconds | None] = ContextVar("contactimg_timings", default=None)


def _step(frame: FrameType | None) -> str:
    """The step of the innermost function of this package: imaging.fit, models.coupling, files.sources."""
    while frame is not None:
        package, *steps = str(frame.f_globals.get("__name__", "")).split(".")
        if package == __package__ and steps not in ([], ["timings"]):
            return WAITING if steps[0] == "engine" else ".".join(steps[:2])
        frame = frame.f_back
    return OTHER


@contextmanager
def collect() -> Iterator[Seconds]:
    """Time the steps of what this thread computes inside the block.

    Yields
    ------
    dict
        Step -> seconds, complete after the block.

    Examples
    --------
    >>> with collect() as seconds:
    ...     found = sum(range(1000))
    >>> list(seconds)
    ['other']
    """
    seconds: Seconds = defaultdict(float)
    thread, ended = threading.get_ident(), threading.Event()

    def look() -> None:
        done, since = False, perf_counter()
        while not done:
            done, now = ended.wait(0.005), perf_counter()  # s, chosen: a look takes some microseconds
            seconds[_step(sys._current_frames().get(thread))] += now - since
            since = now

    watch = threading.Thread(target=look, daemon=True, name="timings")
    watch.start()
    token = _watched.set(seconds)
    try:
        yield seconds
    finally:
        _watched.reset(token)
        ended.set()
        watch.join()


def is_collecting() -> bool:
    """Whether somebody wants to know the times."""
    return _watched.get() is not None


def add(seconds: Mapping[str, float]) -> None:
    """Add the times of a call in another process to those that are collected."""
    collected = _watched.get()
    if collected is not None:
        for step, value in seconds.items():
            collected[step] += value
