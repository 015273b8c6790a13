"""Calls for worker processes, of the standard library alone, so that a worker starts quickly."""

import os
import signal
import time


def deadly_square(deadly, number):
    """The square; end the process for some of the numbers."""
    if number in deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return number**2


def once_deadly(folder, number):
    """The square; end the process the first time that number 3 comes."""
    mark = folder / "mark"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def process_of(seconds):
    """The number of the process that a call was made in."""
    time.sleep(seconds)
    return os.getpid()
