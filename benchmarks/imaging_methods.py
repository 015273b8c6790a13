"""Error against time of every method, on the same frames, by turns."""

import sys
import time
import warnings
from pathlib import Path

import imaging_rivals as rivals
import numpy as np
import pandas as pd
from imaging_frames import Optics
from imaging_scores import BINS, markdown, number, put_table, score, shoot, summarise
from imaging_speed import LARGEST, compare, label_with_opencv

from contactimg.imaging.measure import measure_image

STORED = Path(__file__).parent / "imaging_methods.csv"
QUICK = 1.0  # s: faster methods are timed several times a frame
REPEATS = 7


def contactimg_threshold(frame, reference):
    return measure_image(frame, reference, method="threshold", polarity="bright", full_scale=255).disks


def contactimg_disk(frame, reference):
    return measure_image(frame, reference, method="disk", polarity="bright", full_scale=255).disks


METHODS = {
    "OpenCV threshold": rivals.opencv_threshold,
    "scikit-image regions": rivals.skimage_regions,
    "scikit-image watershed": rivals.skimage_watershed,
    "watershed, area lookup": rivals.area_lookup,
    "watershed, intensity in cells": rivals.voronoi_intensity,
    "SEP": rivals.sep_extract,
    "photutils deblend": rivals.photutils_deblend,
    "trackpy": rivals.trackpy_locate,
    "OpenCV HoughCircles": rivals.opencv_hough,
    "OpenCV SimpleBlob": rivals.opencv_blobs,
    "LoG blobs": rivals.laplacian_blobs,
    "DoG blobs": rivals.difference_blobs,
    "scipy least squares": rivals.scipy_least_squares,
    "contactimg threshold": contactimg_threshold,
    "contactimg disk": contactimg_disk,
}


def compare_methods(seed, *, frames=3):
    """Measure, store, tabulate; methods whose package is not installed keep their stored row."""
    shots = [shoot(Optics(), seed + k) for k in range(frames)]
    rows = {}
    stored = pd.read_csv(STORED, index_col="method") if STORED.exists() else pd.DataFrame()
    for name, method in METHODS.items():
        try:
            rows[name] = _measure(method, shots)
        except ImportError as missing:
            print(f"{name}: {missing.name} is not installed, the stored row stands", file=sys.stderr)
            if name in stored.index:
                rows[name] = stored.loc[name].to_dict()
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("method")
    table.to_csv(STORED, float_format="%.6g")
    put_table("methods", _lines(table))
    return table


def _measure(method, shots):
    """Scores of all frames and time over that of F, the best of several of each, taken by turns."""
    best, floor, scores = np.inf, np.inf, []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # other packages' words
        method(shots[0].frame[:400, :400].copy(), shots[0].reference[:400, :400].copy())  # compiles
        for shot in shots:
            for _ in range(REPEATS):
                floor = min(floor, _seconds(label_with_opencv, shot)[0])
                spent, disks = _seconds(method, shot)
                best = min(best, spent)
                if spent > QUICK:
                    break
            if not isinstance(disks, pd.DataFrame):
                disks = pd.DataFrame(disks, columns=["x_px", "y_px", "radius_px"])
            scores.append(score(shot, disks))
    summary = summarise(scores)
    return {
        "f1": summary["f1"],
        "rms_px": summary["rms"],
        "ratio": summary["ratio"],
        **{f"ratio_{k}": value for k, value in enumerate(summary["ratios"])},
        **{name: summary[name] for name in ("lost", "lost_close", "close", "lost_touching", "touching")},
        "time": best / floor,
    }


def _seconds(method, shot):
    """Processor time: other processes on a shared machine do not count."""
    start = time.process_time()
    result = method(shot.frame, shot.reference)
    return time.process_time() - start, result


def _lines(table):
    header = [
        "method",
        "F1",
        "RMS px",
        "RMS/CRB",
        *(f"{name} px" for name in BINS),
        "lost close",
        "lost touching",
        "time / F",
    ]
    rows = [
        [
            f"**{name}**" if name.startswith("contactimg") else name,
            f"{row.f1:.3f}",
            number(row.rms_px),
            number(row.ratio),
            *(number(row[f"ratio_{k}"]) for k in range(4)),
            f"{row.lost_close:.0f}/{row.close:.0f}",
            f"{row.lost_touching:.0f}/{row.touching:.0f}",
            number(row.time),
        ]
        for name, row in table.iterrows()
    ]
    return markdown(header, rows)


def tabulate_speed(seed, *, repeats=9):
    """Times of the package's two methods over F, for small and large crowds."""
    rows = []
    for count in (50, 500, 2000, 5000):
        largest = LARGEST.get(count, 30.0)
        times, placed = compare(count, largest=largest, repeats=repeats, seed=seed)
        ratios = [number(times[name] / times["F"]) for name in ("threshold", "disk")]
        rows.append([placed, f"1.5-{largest:g} px", *ratios])
    put_table("speed", markdown(["contacts", "radii", "threshold / F", "disk / F"], rows))
