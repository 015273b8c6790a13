"""Any image: what the two methods make of images that nobody took of contacts.

    python benchmarks/imaging_any_image.py --output cases.csv           # docs/imaging_any_image.md
    python benchmarks/imaging_any_image.py --folder IMAGES              # with further images, printed only
    python benchmarks/imaging_any_image.py --words noise small          # some kinds, printed only

Each image is measured without a reference, with itself denoised and with another image as the reference, as
bright, dark and either contacts, by both methods. Nothing is random: the same images each time.

A case beyond its time is measured again, in turns with a fixed measurement (the floor): what the floor takes
over its least time of the whole run is what other programs make of the processor time.
"""

import argparse
import functools
import itertools
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from imaging_figures import FOLDER, save
from imaging_scores import ROOT, markdown, put_table
from PIL import Image

from contactimg.imaging.measure import measure_image
from contactimg.pipeline.frame import outlines_table
from contactimg.plots.overlay import Layer, View, draw_overlay
from contactimg.tables.outlines import contact_outlines

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from any_images import (
    DEPTHS,
    METHODS,
    POLARITIES,
    REFERENCES,
    look_at,
    made_images,
    more_images,
    odd_images,
    photographs,
    reference_of,
    sized,
    stored_as,
)

PAGE = ROOT / "docs" / "imaging_any_image.md"
LIMIT_S, FLOOR_S = 1.5, 0.2
"""Processor time of a megapixel, and the time that any image may take, s."""
PATIENCE_S = 60.0
TRIES, FLOOR_TIMES = 4, 12
"""Measurements of a case beyond its time, of which the fastest against its floor counts; and of the floor."""
SIDE, PART_PX = 200, 60_000
FAINT = 1.0
"""Height over the scatter of the ring around it below which a contact is doubtful. Chosen."""
KINDS = {
    "noise": (
        "noise", "salt", "clouds", "row noise", "pink noise", "shot noise", "fine blobs", "coarse blobs",
    ),
    "stripes, checkerboards, grids": (
        "stripes", "checkerboard", "grid", "touching squares", "plain checkerboard", "scratches", "steps",
    ),
    "gradients": ("gradient", "plain gradient", "vignette"),
    "text": ("text",),
    "shapes": ("rings", "squares", "mesh of rings", "plain dots"),
    "constant, two levels": ("two halves", "black"),
    "what a laboratory may save": (
        "annulus", "bayer", "cones", "disks", "dithered", "domes", "equalised", "label mask", "log floats",
        "median filtered", "newton rings", "plot", "posterised", "qr", "ruler", "scale bar", "star field",
        "stars and crosses", "triangles", "upside down",
    ),
}  # fmt: skip
ODD = {
    "negative": lambda v: -3.0 + 2.0 * v,
    "tiny": lambda v: 1e-9 * v,
    "huge": lambda v: 1e9 * v,
    "offset": lambda v: 1e4 + v,
    "double": lambda v: v.astype(np.float64) ** 3,
    "smallest": lambda v: 1e-40 * v,
}
"""Floats that no camera gives, of grey levels between 0 and 1."""
SMALL = ((8, 8), (16, 16), (9, 31), (4, 2000), (2000, 4), (1, 300))


@dataclass(frozen=True, eq=False)
class Item:
    """An image as 8 bit, its kind, and the way in which it is stored: a depth, or one of `ODD`."""

    kind: str
    name: str
    image: np.ndarray
    store: str = "uint8"

    def stored(self, image):
        """An image in the same depth."""
        if image is None or self.store in DEPTHS:
            return stored_as(self.store, image)
        odd = ODD[self.store](image.astype(np.float64) / 255)
        return odd if self.store in ("double", "smallest") else odd.astype(np.float32)


def battery(folder):
    """All images."""
    photos, made = photographs(), made_images(SIDE) | more_images(SIDE) | odd_images(SIDE)
    items = [Item("photographs", name, image) for name, image in photos.items()]
    for name, store in itertools.product(photos, DEPTHS[1:]):
        part = sized(photos[name], PART_PX, np.random.default_rng(len(name)))
        items.append(Item("parts of photographs", name, part, store))
    items += [
        Item(kind, name, made[name], s) for kind, names in KINDS.items() for name in names for s in DEPTHS
    ]
    patterns = ("noise", "clouds", "checkerboard", "text", "plain dots", "gradient")
    items += [Item("floats of odd ranges", name, made[name], store) for name in patterns for store in ODD]
    for name, (rows, columns) in itertools.product(patterns, SMALL):
        tiled = np.tile(made[name], (rows // SIDE + 1, columns // SIDE + 1))[:rows, :columns]
        items.append(Item("tiny and thin", f"{name} {rows} x {columns}", np.ascontiguousarray(tiled)))
    items += [Item("constant, two levels", name, image) for name, image in flat_images().items()]
    items += [Item("saturated", name, image) for name, image in saturated_images(photos, made).items()]
    return items + [Item("further images", name, image) for name, image in images_in(folder).items()]


def flat_images():
    """Constant images, and such of two levels."""
    flat = {f"level {k}": np.full((SIDE, SIDE), k, np.uint8) for k in (1, 128, 254, 255)}
    rng = np.random.default_rng(5)
    flat["one level apart"] = (100 + (rng.random((SIDE, SIDE)) < 0.5)).astype(np.uint8)
    flat["one pixel"] = np.zeros((SIDE, SIDE), np.uint8)
    flat["one pixel"][70, 90] = 255
    return flat


def saturated_images(photos, made):
    """Images of which much is at full scale."""
    chosen = {name: photos[name] for name in ("coins", "camera", "brick", "cell")}
    chosen |= {name: made[name] for name in ("noise", "clouds", "vignette", "plain dots")}
    return {name: cv2.convertScaleAbs(image, alpha=2.5) for name, image in chosen.items()}


def images_in(folder):
    """The images in a folder, as grey levels of 8 bit; of a stack the first page."""
    found = {}
    for path in sorted(folder.rglob("*")) if folder else []:
        known = path.suffix.lower() in (".png", ".jpg", ".tif")
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if known else None
        if image is not None and min(image.shape) >= 32:
            found[f"{path.parent.name}/{path.name}"] = image
    return found


def looked(item, other, reference, method, polarity):
    """The image and what is seen on it."""
    background = item.stored(reference_of(reference, item.image, other.image))
    known = item.store in DEPTHS
    image = item.stored(item.image)
    return image, look_at(image, background, method=method, polarity=polarity, known_scale=known)


def case(item, other, reference, method, polarity):
    """One row: what was measured and what is wrong with it."""
    row = {"kind": item.kind, "image": item.name, "store": item.store, "pixels": item.image.size}
    row |= {"reference": reference, "method": method, "polarity": polarity, "other": other.name}
    limit, beat = max(LIMIT_S * item.image.size / 1e6, FLOOR_S), np.nan
    signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
    try:
        seen = looked(item, other, reference, method, polarity)[1]
        seconds = seen.seconds
        if seconds > limit:
            again = [
                (looked(item, other, reference, method, polarity)[1].seconds, floor()) for _ in range(TRIES)
            ]
            seconds, beat = min(again, key=lambda pair: pair[0] / pair[1])
    except Exception:
        return row | {"fault": traceback.format_exc(limit=-3), "exception": True}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    result = seen.result
    return row | {
        "s": seconds,
        "floor": beat,
        "exception": False,
        "contacts": len(result.disks),
        "invisible": seen.invisible,
        "faint": int(np.count_nonzero(seen.rises < FAINT)),
        "least rise": seen.rises.min(initial=np.inf),
        "poor": seen.poor,
        "status": result.status,
        "contrast": result.contrast,
        "beyond": any("beyond" in fault for fault in seen.faults),
        "not shown": seen.not_shown,
        "ok but poor": any(fault.startswith("ok although") for fault in seen.faults),
        "fault": "; ".join(seen.faults),
        "message": result.message,
    }


def run(items, others):
    """All cases of all images; ``others`` are wrong references."""
    names, rows, floors = sorted(others), [], []
    for number, item in enumerate(items):
        other = others[names[(number * 7 + 3) % len(names)]]
        if other.name == item.name:
            other = others[names[(number * 7 + 4) % len(names)]]
        rows += [
            case(item, other, *setting) for setting in itertools.product(REFERENCES, METHODS, POLARITIES)
        ]
        floors.append(floor())
        print(f"{number + 1} of {len(items)}: {item.kind}, {item.name}, {item.store}", end="\r", flush=True)
    return timed(pd.DataFrame(rows), min(floors))


def floor():
    """Processor time of a fixed measurement, s, from several: the clock has steps of some milliseconds."""
    image, start = _floor_image(), time.process_time()
    for _ in range(FLOOR_TIMES):
        measure_image(image, polarity="bright", method="threshold")
    return (time.process_time() - start) / FLOOR_TIMES


@functools.cache
def _floor_image():
    """What the fixed measurement is made of."""
    return more_images(SIDE)["plain dots"]


def timed(rows, least_floor):
    """The rows with times as on a machine that does nothing else, and whether they are within the limit."""
    limit = np.maximum(LIMIT_S * rows["pixels"] / 1e6, FLOOR_S)
    idle = rows["s"] * least_floor / rows["floor"].fillna(least_floor)
    return rows.assign(
        **{"clocked slow": rows["s"] > limit, "s": idle, "s per MP": idle / rows["pixels"] * 1e6},
        slow=idle > limit,
    )


HEADER = [
    "images", "number", "measurements", "s per megapixel, worst", "smaller than 0.13 megapixels: s, worst",
    "too slow", "exceptions", "contrast beyond the range", "of contacts too small to show theirs",
    "invisible contacts", "ok with poor fits",
    "ok, of them with contacts", "faint contacts under ok",
]  # fmt: skip


def table(rows):
    """One line a kind of image, and all."""
    lines = []
    for kind, part in [*rows.groupby("kind", sort=False), ("all", rows)]:
        large, ok = part["pixels"] * LIMIT_S / 1e6 >= FLOOR_S, part["status"] == "ok"
        worst = part.loc[large, "s per MP"].max() if large.any() else np.nan
        least = part.loc[~large, "s"].max() if (~large).any() else np.nan
        with_contacts = np.count_nonzero(ok & (part["contacts"] > 0))
        lines.append(
            [
                kind,
                len(part[["image", "store"]].drop_duplicates()) if kind != "all" else _count(rows),
                len(part),
                "-" if np.isnan(worst) else f"{worst:.2f}",
                "-" if np.isnan(least) else f"{least:.2f}",
                int(part["slow"].sum()),
                int(part["exception"].sum()),
                int(part["beyond"].sum()),
                int(part["not shown"].sum()),
                int(part["invisible"].sum()),
                int(part["ok but poor"].sum()),
                f"{np.count_nonzero(ok)}, {with_contacts}",
                int(part.loc[ok, "faint"].sum()),
            ]
        )
    return lines


def _count(rows):
    """Number of images."""
    return len(rows[["kind", "image", "store"]].drop_duplicates())


def worst_ten(rows):
    """Five cases that take longest for their limit, five with most doubtful contacts and a status near ok."""
    limit = np.maximum(LIMIT_S * rows["pixels"] / 1e6, FLOOR_S)
    done = rows[~rows["exception"]].assign(share=rows["s"] / limit)
    done["doubtful"] = done["faint"] + done["poor"] * done["contacts"]
    done["ok"] = done["status"] == "ok"
    images = ["kind", "image"]
    slow = done.sort_values("share", ascending=False, kind="stable").drop_duplicates(images).head(5)
    order = ["ok", "doubtful", "contacts"]
    rest = done.drop(slow.index).sort_values(order, ascending=False, kind="stable")
    return pd.concat([slow, rest.drop_duplicates(images).head(5)])


WORST = ["image", "reference", "method, polarity", "s", "of the limit", "status", "contacts", "poor", "faint"]


def worst_table(worst):
    """One line a case."""
    return [
        [
            f"{row['image']}, {row['store']}",
            row["reference"] if row["reference"] != "wrong" else f"{row['other']}",
            f"{row['method']}, {row['polarity']}",
            f"{row['s']:.2f}",
            f"{row['share']:.0%}",
            row["status"],
            int(row["contacts"]),
            f"{row['poor']:.0%}",
            int(row["faint"]),
        ]
        for row in worst.to_dict("records")
    ]


def draw_worst(worst, items, name="imaging_any_image.png"):
    """The ten with what was measured on them, as small multiples."""
    by_key = {(item.kind, item.name, item.store): item for item in items}
    others = {item.name: item for item in items if item.kind == "photographs"}
    figure, axes = plt.subplots(2, 5, figsize=(12.5, 5.6), layout="constrained")
    for place, row in zip(axes.flat, worst.to_dict("records"), strict=False):
        item = by_key[row["kind"], row["image"], row["store"]]
        setting = (row["reference"], row["method"], row["polarity"])
        image, seen = looked(item, others.get(row["other"], item), *setting)
        lines = contact_outlines(seen.result.disks, outlines_table(seen.result, "any"))
        stretch = (float(image.min()), float(max(image.max(), image.min() + 1e-12)))
        picture = draw_overlay(image, [Layer(lines, "#e63946", f"{len(lines)} contacts")], View(stretch))
        place.imshow(picture.rgb, interpolation="antialiased")
        title = f"{row['image']}, reference {row['reference']}\n"
        title += f"{row['method']}, {row['polarity']}: {row['status']}"
        place.set_title(title, fontsize=8)
        place.set_axis_off()
    save(figure, name)
    path = FOLDER / name
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)


def write(rows, worst, items, *, publish):
    """Print the tables; write page and figure if all images were measured."""
    tables = {"any image": markdown(HEADER, table(rows)), "worst ten": markdown(WORST, worst_table(worst))}
    for name, lines in tables.items():
        if publish:
            put_table(name, lines, page=PAGE)
        else:
            print("\n".join(["", name, *lines]))
    if publish:
        draw_worst(worst, items)


def no_answer(*_):
    """Called when a case takes too long."""
    raise TimeoutError("no answer")


def main():
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, help="further images")
    parser.add_argument(
        "--words", nargs="*", default=[], help="kinds that contain one of these; default: all"
    )
    parser.add_argument("--output", type=Path, help="CSV, one row a case")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    signal.signal(signal.SIGPROF, no_answer)
    items = battery(options.folder)
    coins = next(item for item in items if item.name == "coins")
    for store, method, kind in itertools.product(DEPTHS, METHODS, ("none", "right")):  # compiles
        looked(Item("", "", coins.image, store), coins, kind, method, "bright")
    chosen = [i for i in items if not options.words or any(word in i.kind for word in options.words)]
    rows = run(chosen, {item.name: item for item in items if item.kind == "photographs"})
    if options.output:
        rows.to_csv(options.output, index=False)
    print("beyond the limit as clocked:", int(rows["clocked slow"].sum()))
    write(rows, worst_ten(rows), items, publish=not (options.words or options.folder))
    for row in rows[rows["fault"] != ""].to_dict("records"):
        print({key: row[key] for key in row if key != "message"})


if __name__ == "__main__":
    main()
