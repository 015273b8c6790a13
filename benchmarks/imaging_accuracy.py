"""How accurate and how fast the imaging is: every table and figure of docs/imaging.md.

    OMP_NUM_THREADS=1 python benchmarks/imaging_accuracy.py            # everything, about ten minutes
    OMP_NUM_THREADS=1 python benchmarks/imaging_accuracy.py methods    # one part

The methods of other packages need ``pip install photutils sep trackpy``; without them their stored rows stand
(benchmarks/imaging_methods.csv). Seeds other than the default are for development: the published figures come
from frames that nothing was tuned on.
"""

import argparse

import cv2
import imaging_beads
import imaging_conditions
import imaging_crowds
import imaging_detection
import imaging_figures
import imaging_film
import imaging_methods

SEED = 52_000


def methods(seed):
    imaging_figures.plot_methods(imaging_methods.compare_methods(seed))


def conditions(seed):
    imaging_conditions.tabulate_conditions(seed + 1000)


def crowds(seed):
    imaging_crowds.tabulate_crowds(seed + 5000)


def detection(seed):
    imaging_detection.count_false_alarms(seed + 3000)
    curves = imaging_detection.measure_completeness(seed)
    imaging_figures.plot_completeness(curves, imaging_detection.expected_share)


def film(seed):
    imaging_film.compare_film(seed)


def speed(seed):
    imaging_methods.tabulate_speed(seed)


def beads(_seed):
    imaging_beads.show_beads()


PARTS = {part.__name__: part for part in (methods, conditions, crowds, detection, film, speed, beads)}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()
    if unknown := set(arguments.parts) - set(PARTS):
        parser.error(f"unknown part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    cv2.setNumThreads(1)
    for name in arguments.parts or PARTS:
        PARTS[name](arguments.seed)


if __name__ == "__main__":
    main()
