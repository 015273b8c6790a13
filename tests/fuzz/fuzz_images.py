"""Measure images that nobody made for contacts: photographs, text, noise, with and without a reference.

Run by hand: ``python tests/fuzz/fuzz_images.py --count 200 --seed 1 --folder IMAGES --output TABLE.csv``.
Images take turns; size (4 kilopixels to ``--pixels``), depth, reference, method and polarity are random. A
short version is in ``tests/imaging/judge/test_any_image.py``.
"""

import argparse
import itertools
import signal
import sys
import time
import traceback
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from any_images import (
    DEPTHS,
    METHODS,
    POLARITIES,
    REFERENCES,
    Looked,
    look_at,
    made_images,
    more_images,
    photographs,
    reference_of,
    sized,
    stored_as,
)

SUFFIXES = (".png", ".jpg", ".tif")
SMALLEST_PX = 64**2
FLOOR_S = 0.2
"""Processor time that any image may take, s: below a tenth of a megapixel the limit is this."""

FLOOR_TIMED_S = 0.03
"""Processor time that the floor is timed for, s: a few ticks of the clock."""


def images_in(folder: Path | None) -> dict[str, np.ndarray]:
    """The images in a folder, as grey levels of 8 bit; of a stack the first page."""
    out = {}
    for path in sorted(folder.rglob("*")) if folder else []:
        known = path.suffix.lower() in SUFFIXES
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if known else None
        if image is not None and min(image.shape) >= 32:
            out[f"{path.parent.name}/{path.name}"] = image
    return out


def floor_seconds(image: np.ndarray) -> float:
    """Processor time that OpenCV takes to smooth, threshold and label an image as 8 bit, s."""
    eight = cv2.normalize(image.astype(np.float32), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    start, rounds = time.process_time(), 0
    while time.process_time() - start < FLOOR_TIMED_S:
        rounds += 1
        smooth = cv2.GaussianBlur(eight, (0, 0), 1.5)
        _, mask = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        cv2.connectedComponentsWithStats(mask)
    return (time.process_time() - start) / rounds


def no_answer(*_: object) -> None:
    """Called when a case takes too long."""
    raise TimeoutError("no answer")


def compile_all(image: np.ndarray) -> None:
    """Measure an image in every depth, without and with a reference: what is compiled then is not timed."""
    for depth, method, kind in itertools.product(DEPTHS, METHODS, ("none", "right")):
        reference = stored_as(depth, reference_of(kind, image, image))
        look_at(stored_as(depth, image), reference, method=method, polarity="bright")


def run_case(number: int, images: dict[str, np.ndarray], options: argparse.Namespace) -> dict:
    """One row of the table."""
    rng, names = np.random.default_rng([options.seed, number]), sorted(images)
    name, other = names[number % len(names)], images[names[rng.integers(len(names))]]
    choices = (REFERENCES, METHODS, POLARITIES, DEPTHS)
    kind, method, polarity, depth = (str(rng.choice(part)) for part in choices)
    pixels = int(np.exp(rng.uniform(np.log(SMALLEST_PX), np.log(options.pixels))))
    image = sized(images[name], pixels, rng)
    reference = stored_as(depth, reference_of(kind, image, other))
    image = stored_as(depth, image)
    floor = floor_seconds(image)
    signal.setitimer(signal.ITIMER_PROF, options.patience)
    start = time.process_time()
    try:
        seen = look_at(image, reference, method=method, polarity=polarity)
    except Exception:
        seen = None
        trouble = traceback.format_exc(limit=-3)
    seconds = time.process_time() - start
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    row = {"case": number, "image": name, "pixels": image.size, "depth": depth, "reference": kind}
    row |= {"method": method, "polarity": polarity, "s": seconds, "s_per_MP": seconds / image.size * 1e6}
    row |= {"floors": seconds / floor, "slow": seconds > max(options.limit * image.size / 1e6, FLOOR_S)}
    return row | (_judged(seen) if seen else {"fault": trouble})


def _judged(seen: Looked) -> dict:
    """What a measurement says, and what is wrong with it."""
    result = seen.result
    return {
        "status": result.status,
        "contacts": len(result.disks),
        "poor": seen.poor,
        "invisible": seen.invisible,
        "contrast": result.contrast,
        "fault": "; ".join(seen.faults),
        "message": result.message,
    }


def main() -> int:
    """Run the cases and print what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--pixels", type=int, default=1_500_000, help="largest area of an image, px")
    parser.add_argument("--limit", type=float, default=1.5, help="processor time, s per megapixel")
    parser.add_argument("--patience", type=float, default=60.0, help="processor time of a case at most, s")
    parser.add_argument("--folder", type=Path, help="further images")
    parser.add_argument("--output", type=Path, help="CSV, one row a case")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    signal.signal(signal.SIGPROF, no_answer)
    images = photographs() | made_images(400) | more_images(400) | images_in(options.folder)
    compile_all(images["coins"])
    rows, kinds = [], Counter()
    for number in range(options.first, options.first + options.count):
        row = run_case(number, images, options)
        rows.append(row)
        kinds["fault"] += bool(row["fault"])
        kinds["slow"] += bool(row["slow"])
        if row["slow"] or row["fault"]:
            print(", ".join(f"{key} {value}" for key, value in row.items() if key != "message"), flush=True)
        if options.output:
            pd.DataFrame(rows).to_csv(options.output, index=False)
    print(f"{options.count} cases of seed {options.seed}: {kinds['fault']} faults, {kinds['slow']} slow")
    return int(kinds["fault"] > 0)


if __name__ == "__main__":
    sys.exit(main())
