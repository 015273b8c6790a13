"""How processes end: worker processes with their parent, a command that is asked to end with all in order.

This module imports only the standard library: a new worker is covered at once, and the command line starts
quickly.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

_LOOK_EVERY_SECONDS = 0.3  # chosen: a worker outlives its parent by less than 2 s with room to spare
_ENDING = [one for one in signal.Signals if one.name in {"SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"}]

_asked_to_end = threading.Event()
_executors: list[Any] = []
"""The executor whose processes wait for calls, if there is one."""


def live_with_parent(parent: int) -> None:
    """End this worker process when the process ``parent`` is gone; leave Ctrl-C to the parent.

    Notes
    -----
    On Linux the kernel ends the worker, also within a long call of compiled code. Elsewhere on POSIX systems,
    and in addition, a thread looks who the parent is now. Windows does not change the parent of orphans:
    nothing is done there.
    """
    with suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # 1 is PR_SET_PDEATHSIG
    if os.name == "posix":
        threading.Thread(target=_watch, args=(parent,), daemon=True, name="parent watch").start()


def _watch(parent: int) -> None:
    """End this process at once when it has another parent."""
    while os.getppid() == parent:
        time.sleep(_LOOK_EVERY_SECONDS)
    os._exit(1)


def keep_workers(executor: Any) -> None:
    """Let the processes of an executor wait for the next calls, until `end_workers`."""
    _executors[:] = [executor]


def workers_wait() -> bool:
    """Whether processes were started and wait for calls."""
    return bool(_executors)


def end_workers() -> None:
    """End the processes that wait for calls, now, with whatever they still do."""
    while _executors:
        _executors.pop().shutdown(wait=True, kill_workers=True)


@contextmanager
def ending_cleanly() -> Iterator[None]:
    """Treat every signal that asks the process to end like Ctrl-C, and end its workers with it.

    Signals that are ignored (``nohup``) stay ignored.
    """
    try:
        with _handled(_interrupt, only=(signal.SIG_DFL, signal.default_int_handler)):
            yield
    finally:
        _asked_to_end.clear()
        end_workers()


def end_if_asked() -> None:
    """Raise `KeyboardInterrupt` in the main thread if the process was asked to end.

    An exception that a signal raises within a callback of the compiler is lost there: the compiler then fails
    for a reason of its own, and the process would go on.
    """
    if _asked_to_end.is_set() and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


@contextmanager
def signals_held() -> Iterator[None]:
    """Ignore signals that ask the process to end: it is about to end with a complete result."""
    with _handled(signal.SIG_IGN):
        yield


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Raise what Ctrl-C raises, so that ``with`` and ``finally`` clean up."""
    _asked_to_end.set()
    raise KeyboardInterrupt


@contextmanager
def _handled(handler: Callable[..., Any] | int, only: tuple[Any, ...] = ()) -> Iterator[None]:
    """Handle the signals that end a process in this way, where the handler was one of ``only`` if given."""
    in_main = threading.current_thread() is threading.main_thread()  # no other one can handle any
    before = {number: signal.getsignal(number) for number in _ENDING if in_main}
    for number, old in before.items():
        if not only or old in only:
            signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            if old is not None:  # None stands for one that was not set from Python
                signal.signal(number, old)
