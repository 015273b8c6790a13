"""Measuring a frame keeps one core busy: no small matrix product wakes the threads of a library."""

import os
import subprocess
import sys

import pytest

CODE = """
import time
import cv2
import numpy as np
from contact_frames import Optics, render, scatter
from contactimg.imaging.measure import measure_image

cv2.setNumThreads(1)
optics, rng = Optics(shape=(1200, 1600)), np.random.default_rng(7)
frame, reference = render(scatter(40, optics, rng), optics, rng)
for known in (reference, None):
    measure_image(frame, known)  # compiles
    ratios = []
    for _ in range(4):  # what the first call has woken still waits during the next one
        process, thread = time.process_time(), time.thread_time()
        measure_image(frame, known)
        ratios.append((time.process_time() - process) / (time.thread_time() - thread))
    print(min(ratios))
"""


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: there are no other threads")
def test_a_frame_is_measured_on_one_thread():
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    command = [sys.executable, "-c", CODE]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)  # noqa: S603
    # threads that wait for more work take as much time as this one
    ratios = [float(line) for line in run.stdout.split()]
    assert len(ratios) == 2
    assert max(ratios) < 1.25
