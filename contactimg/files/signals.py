"""Signals that ask a process to end: turned into an exception, or held back while files are moved."""

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

Handler = Callable[[int, FrameType | None], object] | int | None

_ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Raise what Ctrl-C raises, so that ``with`` and ``finally`` clean up."""
    raise KeyboardInterrupt


@contextmanager
def ending_cleanly() -> Iterator[None]:
    """Treat every signal that asks the process to end like Ctrl-C; ignored ones (``nohup``) stay ignored."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING}
    for number, handler in before.items():
        if handler == signal.SIG_DFL:
            signal.signal(number, _interrupt)
    try:
        yield
    finally:
        _restore(before)


@contextmanager
def signals_held() -> Iterator[None]:
    """Ignore signals that ask the process to end: it is about to end with a complete result."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, signal.SIG_IGN) for number in _ENDING}
    try:
        yield
    finally:
        _restore(before)


def _restore(handlers: Mapping[signal.Signals, Handler]) -> None:
    """Put back handlers; None stands for one that was not set from Python."""
    for number, handler in handlers.items():
        if handler is not None:
            signal.signal(number, handler)
