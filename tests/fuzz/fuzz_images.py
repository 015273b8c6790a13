"""Measure images that nobody made for contacts: photographs, text, noise, with and without a reference.

Run by hand: ``python tests/fuzz/fuzz_images.py --count 200 --seed 1``. A short version is in
``tests/imaging/judge/test_any_image.py``.
"""

import argparse
import sys
import time
import traceback
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from any_images import METHODS, POLARITIES, REFERENCES, faults, made_images, photographs, reference_of


def crop(image, rng, largest):
    """A random part of an image, at most ``largest`` pixels in area."""
    rows, columns = image.shape
    scale = min(1.0, (largest / (rows * columns)) ** 0.5)
    size = max(int(rows * scale), 32), max(int(columns * scale), 32)
    top, left = (
        int(rng.integers(0, whole - part + 1)) for whole, part in zip(image.shape, size, strict=True)
    )
    return np.ascontiguousarray(image[top : top + size[0], left : left + size[1]])


def main() -> int:
    """Run the cases and print what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--pixels", type=int, default=120_000, help="largest area of an image, px")
    parser.add_argument("--limit", type=float, default=1.5, help="processor time, s per megapixel")
    parser.add_argument("--folder", type=Path, help="further images")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    images = photographs() | made_images(400)
    for path in sorted(options.folder.rglob("*")) if options.folder else []:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is not None and min(image.shape) >= 32:
            images[path.name] = image
    rng, names, kinds = np.random.default_rng(options.seed), sorted(images), Counter()
    for number in range(options.count):
        name, other = names[number % len(names)], images[names[rng.integers(len(names))]]
        kind, method, polarity = (str(rng.choice(part)) for part in (REFERENCES, METHODS, POLARITIES))
        image = crop(images[name], rng, options.pixels)
        start = time.process_time()
        try:
            found = faults(image, reference_of(kind, image, other), method=method, polarity=polarity)
        except Exception:
            found = [traceback.format_exc(limit=-3)]
        seconds = (time.process_time() - start) / image.size * 1e6
        if seconds > options.limit:
            kinds["slow"] += 1
            print(
                f"case {number}: {name} {kind} {method} {polarity}: {seconds:.1f} s per megapixel", flush=True
            )
        for text in found:
            kinds["fault"] += 1
            print(f"case {number}: {name} {image.shape} {kind} {method} {polarity}: {text}", flush=True)
    print(f"{options.count} cases of seed {options.seed}: {kinds['fault']} faults, {kinds['slow']} slow")
    return int(kinds["fault"] > 0)


if __name__ == "__main__":
    sys.exit(main())
