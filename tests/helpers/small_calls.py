"""Calls for worker processes, which import little, so that a worker starts quickly."""

import os
import signal
import time
from types import FunctionType


def spend(seconds, before=None):
    """Compute for some time, after another call."""
    if before is not None:
        before()
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass
    return seconds


def spend_in(module, seconds, before=None):
    """Compute for some time in a function of a module of that name."""
    return FunctionType(spend.__code__, {"__name__": module, "time": time}, argdefs=(None,))(seconds, before)


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


def slow_square(folder, number):
    """The square; says that it has begun, in a file with the process number."""
    (folder / f"{number}").write_text(str(os.getpid()))
    time.sleep(0.1)
    return number**2


def deadly_frame(frame, _reference):
    """End the worker for one of the frames."""
    if frame.name == "frame_2.tif":
        os.kill(os.getpid(), signal.SIGKILL)
    return frame.name


def refused(number):
    """Refuse the number, or need what is not installed."""
    if number < 0:
        import no_such_library  # noqa: F401
    from contactimg.errors import InputError

    raise InputError(f"{number} is odd")
