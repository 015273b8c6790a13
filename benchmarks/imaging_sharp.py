"""Black disks of one size on white, as the reference images of ISO/TR 19672 show them: sharp, blurred, noisy.

    python benchmarks/imaging_sharp.py FOLDER          # StrictMonodisperse_*px.tif, one page of each
    python benchmarks/imaging_sharp.py                 # the parts of them that the tests use
    python benchmarks/imaging_sharp.py FOLDER --page 7 --table     # the tables of docs/uncertainty.md

The images are those of github ISO-TC24-SC4-WG8/TR-19672 (MIT): two grey levels, no blur, no noise, tens of
disks a page that do not touch; the number in the file name is the diameter. Truth is the area of the dark
pixels. The bound is that of Cramer and Rao for the mean radius, contrast and blur being unknown: no estimate
of it is better, whatever the method.
"""

import argparse
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import tifffile
from imaging_bound import mean_radius_bound
from imaging_scores import ROOT, markdown, put_table
from scipy.spatial import cKDTree

from contactimg.forces import SHARED_SHIFTS
from contactimg.imaging.measure import measure_image

PARTS = ROOT / "tests" / "data" / "sharp_disks"
BLURS_PX = (0.0, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0)
NOISES = (0.0, 1.0, 3.0, 10.0)  # grey levels


def read_pages(folder, page, side):
    """Name and pixels of one page of each set, its top left part of a side at most."""
    for path in sorted(folder.glob("StrictMonodisperse_*px.tif")):
        yield path.stem.split("_")[1], tifffile.imread(path, key=page)[:side, :side]
    for path in sorted(folder.glob("diameter_*px.png")):
        yield path.stem.split("_")[1], cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


def true_disks(image):
    """x, y and radius by area of the dark components."""
    _, _, stats, centres = cv2.connectedComponentsWithStats((image < 128).view(np.uint8))
    return np.column_stack([centres[1:], np.sqrt(stats[1:, cv2.CC_STAT_AREA] / np.pi)])


def degrade(image, blur, noise, sharpening, rng):
    """The image blurred, sharpened by an unsharp mask, and with noise; 8 bits."""
    light = image.astype(np.float32)
    if blur:
        # to seven standard deviations: the usual four change the kurtosis by 0.014, as a disk of 0.7 widths
        light = cv2.GaussianBlur(light, (2 * int(np.ceil(7 * blur)) + 1,) * 2, blur)
    if sharpening:
        light += sharpening * (light - cv2.GaussianBlur(light, (0, 0), 1.5))
    return np.clip(np.rint(light + noise * rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Score:
    """What was found on one frame; errors and uncertainties relative to the mean radius."""

    found: int
    false: int
    status: str
    mean: float = np.nan
    pull: float = np.nan
    scatter: float = np.nan
    stated: float = np.nan
    largest: float = np.nan
    seconds: float = np.nan

    @property
    def wrong(self):
        """Whether the frame is "ok" although a radius or their mean is off by three stated deviations."""
        return self.status == "ok" and bool(max(self.largest, abs(self.pull)) > 3)

    def line(self, count):
        """Everything in one line."""
        notes = " ".join([self.status, "WRONG" * self.wrong, "LOST" * (self.found < count)])
        return (
            f"{self.found} of {count}, {self.false} false, mean {100 * self.mean:+.2f} % "
            f"({self.pull:+.1f} std), scatter {100 * self.scatter:.2f} %, stated {100 * self.stated:.2f} %, "
            f"largest {self.largest:.1f} std, {self.seconds:.2f} s, {notes}"
        )

    def cell(self, bound):
        """Error of the mean, what is stated of one radius, and the bound, %."""
        if not self.found:
            return f"none, {self.status}"
        status = "" if self.status == "ok" else f" {self.status}"
        return f"{100 * self.mean:+.2f} ± {100 * self.stated:.2g} ({100 * bound:.2g}){status}"


def score(image, truth, method):
    """What is found on a frame."""
    start = time.process_time()
    found = measure_image(image, method=method, polarity="dark")
    seconds = time.process_time() - start
    disks = found.disks
    if not len(disks):
        return Score(0, 0, found.status)
    distance, nearest = cKDTree(truth[:, :2]).query(disks[["x_px", "y_px"]])
    near = distance < np.maximum(0.5 * truth[nearest, 2], 1.0)
    hits, disks = nearest[near], disks[near]
    std = disks["radius_std_px"].to_numpy()
    error = disks["radius_px"].to_numpy() - truth[hits, 2]
    shared = disks[list(SHARED_SHIFTS)].to_numpy()
    own = np.maximum(std**2 - np.sum(shared**2, axis=1), 0.0)
    mean_std = np.sqrt(own.sum() + np.sum(shared.sum(axis=0) ** 2)) / len(error)
    radius = truth[:, 2].mean()
    return Score(
        len(set(hits)), int(np.count_nonzero(~near)), str(found.status), error.mean() / radius,
        error.mean() / mean_std, error.std() / radius, np.median(std) / radius, np.abs(error / std).max(),
        seconds,
    )  # fmt: skip


def main():
    """Print a line for each blur, noise and method."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=PARTS)
    parser.add_argument("--page", type=int, default=0)
    parser.add_argument("--side", type=int, default=2048, help="part of each page, px")
    parser.add_argument("--sharpening", type=float, default=0.0, help="strength of an unsharp mask of 1.5 px")
    parser.add_argument("--blur", type=float, nargs="*", default=BLURS_PX, help="px")
    parser.add_argument("--noise", type=float, nargs="*", default=NOISES, help="grey levels")
    parser.add_argument("--table", action="store_true", help="put the tables on docs/uncertainty.md")
    parser.add_argument("--method", nargs="*", default=("disk", "threshold"))
    args = parser.parse_args()
    cv2.setNumThreads(1)
    tables = {method: [] for method in args.method}
    for name, image in read_pages(args.folder, args.page, args.side):
        truth = true_disks(image)
        mean, count = float(truth[:, 2].mean()), len(truth)
        for blur, method in product(args.blur, args.method):
            row = [f"{mean:.2f}", f"{blur:g}"]
            for noise in args.noise:
                rng = np.random.default_rng([args.page, int(10 * blur), int(noise)])
                result = score(degrade(image, blur, noise, args.sharpening, rng), truth, method)
                bound = mean_radius_bound(mean, blur, noise, contrast=255.0, count=count) / mean
                case = f"{name:7s} blur {blur:3.1f} noise {noise:4.1f} {method:9s}"
                print(f"{case} {result.line(count)}, bound {100 * bound:.3f} %", flush=True)
                row.append(result.cell(bound))
            tables[method].append(row)
    if args.table:
        header = ["radius px", "blur px", *(f"noise {noise:g}" for noise in args.noise)]
        for method, rows in tables.items():
            lines = markdown(header, sorted(rows, key=lambda row: (-float(row[0]), float(row[1]))))
            put_table(f"sharp disks, {method}", lines, page=ROOT / "docs/uncertainty.md")


if __name__ == "__main__":
    main()
