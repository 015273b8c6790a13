"""Freed memory is used again: a second array of the size of a frame costs no new pages."""

import platform
import subprocess
import sys

import pytest

CODE = """
import resource
import numpy as np
from contactimg.imaging.pixels.frame_pair import keep_freed_memory

if {kept}:
    keep_freed_memory()

def take():
    for size in (2, 3, 5):  # megabytes; numpy asks for huge pages from 4 MB on
        parts = [np.ones(size * 2**20, np.uint8) for _ in range(6)]
        del parts

take()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
take()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def new_pages(*, kept):
    """Pages that arrays need which were needed before, in a process of its own."""
    code = CODE.format(kept=kept)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    return int(run.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library decides by itself")
def test_pages_are_used_again():
    assert new_pages(kept=False) > 500  # a page is 4 kB: 2 MB alone are 512
    assert new_pages(kept=True) < 50
