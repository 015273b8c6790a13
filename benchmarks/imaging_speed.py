"""Time of a whole measurement of one decoded frame, in multiples of what OpenCV alone needs to subtract,
threshold and label it.

F = ``cv2.absdiff`` + ``threshold`` + ``connectedComponentsWithStats`` on the same frame and reference, same
core, taken in turn with the measurement. Run with ``OMP_NUM_THREADS=1 python benchmarks/imaging_speed.py``.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from contact_frames import Optics, render, scatter

from contactimg.imaging.measure import measure_image

# px: the larger crowds fit only as smaller disks; at equal radii 2000 contacts would cover the frame
LARGEST = {1000: 20.0, 2000: 12.0, 5000: 5.0}
WHOLE, QUARTER = (1200, 1600), (600, 800)  # rows and columns; at a quarter of the contacts, as crowded
LARGE = (4096, 4096)  # nothing may grow faster than the frame


def label_with_opencv(frame, reference):
    difference = cv2.absdiff(frame, reference)
    _, mask = cv2.threshold(difference, 45, 255, cv2.THRESH_BINARY)
    return cv2.connectedComponentsWithStats(mask)


def seconds(function, *arguments, **options):
    """Processor time: other processes on a shared machine do not count."""
    start = time.process_time()
    function(*arguments, **options)
    return time.process_time() - start


def compare(count, *, largest, repeats, seed, shape=WHOLE):
    """Best times of F, ``threshold`` and ``disk`` for ``count`` contacts, s."""
    optics = Optics(shape=shape)
    rng = np.random.default_rng(seed)
    truth = scatter(count, optics, rng, radii=(1.5, largest))
    frame, reference = render(truth, optics, rng)
    times = {"F": [], "threshold": [], "disk": []}
    for method in ("threshold", "disk"):
        measure_image(frame, reference, method=method, polarity="bright")  # compiles or loads
    for _ in range(repeats):
        times["F"].append(seconds(label_with_opencv, frame, reference))
        for method in ("threshold", "disk"):
            times[method].append(
                seconds(measure_image, frame, reference, method=method, polarity="bright", full_scale=255)
            )
    return {name: min(values) for name, values in times.items()}, len(truth)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--counts", type=int, nargs="+", default=[50, 200, 500, 1000, 2000, 5000])
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print("image      contacts  radii (px)    F (ms)  threshold/F   disk/F")
    cases = [(s, n) for n in arguments.counts for s in (QUARTER, WHOLE)]
    for shape, count in [*cases, (LARGE, 300), (LARGE, 5000)]:
        largest = 20.0 if shape == LARGE else LARGEST.get(count, 30.0)
        few = count // 4 if shape == QUARTER else count
        times, placed = compare(few, largest=largest, repeats=arguments.repeats, seed=count, shape=shape)
        base = times["F"]
        print(
            f"{shape[1]}x{shape[0]:<5d} {placed:8d}  1.5-{largest:<8.0f} {1e3 * base:7.1f}  "
            f"{times['threshold'] / base:11.2f}  {times['disk'] / base:7.2f}"
        )


if __name__ == "__main__":
    main()
