"""Worker processes that end with the process that started them, also if that one is killed.

This module imports only the standard library, so that a new worker is covered at once.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from contextlib import suppress

_LOOK_EVERY_SECONDS = 0.3  # chosen: a worker outlives its parent by less than 2 s with room to spare
_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux' prctl


def live_with_parent(parent: int) -> None:
    """End this worker process when the process ``parent`` is gone; leave Ctrl-C to the parent.

    Parameters
    ----------
    parent : int
        Process number.

    Notes
    -----
    On Linux the kernel ends the worker. Elsewhere on POSIX systems, and in addition, a thread looks who the
    parent is now. Windows does not change the parent of orphans; nothing is done there.
    """
    with suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.name == "posix":
        threading.Thread(target=_watch, args=(parent,), daemon=True, name="parent watch").start()


def _watch(parent: int) -> None:
    """End this process at once when it has another parent."""
    while os.getppid() == parent:
        time.sleep(_LOOK_EVERY_SECONDS)
    os._exit(1)
