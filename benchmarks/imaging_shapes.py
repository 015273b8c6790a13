"""The ladder of shapes against truth: half-axes, angles and areas of ellipses and of free shapes.

    python benchmarks/imaging_shapes.py ellipses --frames 12 --seed 77     # printed
    python benchmarks/imaging_shapes.py "free and disks" --frames 8 --seed 77

`frame` renders contacts of known outline, `measured` joins them with what the package finds.

The frames are drawn as polygons on a grid of four points a pixel, each the mean of four times four, then
blurred and binned, by code that shares nothing with the package. Errors are in units of the stated standard
uncertainty.
"""

import argparse
import time
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from scipy.signal import fftconvolve
from scipy.spatial import cKDTree
from skimage.draw import polygon

from contactimg.imaging.measure import measure_image

ROWS, COLUMNS, FINE, FINER = 600, 800, 4, 4  # px; points of the blur per pixel, points of a shape per point
LEVEL, CONTRAST, DEPTH = 80.0, 100.0, 16  # grey levels; sixteenths of a level are stored
GAP_BLURS, MARGIN_PX = 8.0, 12.0
TURN = np.linspace(0, 2 * np.pi, 400, endpoint=False)
CIRCLE = np.column_stack([np.cos(TURN), np.sin(TURN)])
BLURS, CONTRASTS = (0.8, 1.4, 2.2, 3.0), (15.0, 38.0, 100.0)
RATIOS = (1.05, 1.1, 1.2, 1.35, 1.5, 2.0)


@dataclass(frozen=True)
class Optics:
    """How the frame is seen: blur (px), contrast over noise, and the kind of the point spread function."""

    blur: float = 1.4
    contrast_to_noise: float = 38.0
    spread: str = "gauss"


@dataclass(frozen=True)
class Population:
    """Which contacts a frame has.

    Parameters
    ----------
    kinds : tuple of str
        Names of `OUTLINES`, or "ellipse 1.3".
    radii : (float, float)
        Of the circle of equal area, px.
    count : int
    """

    kinds: tuple[str, ...]
    radii: tuple[float, float] = (3.0, 20.0)
    count: int = 70


def _wavy(*waves):
    """Circle whose radius has waves of (amplitude, number, phase)."""
    radius = 1 + sum(height * np.cos(number * TURN + phase) for height, number, phase in waves)
    return CIRCLE * radius[:, None]


def _corners(number):
    """Regular polygon."""
    turn = 2 * np.pi / number * np.arange(number)
    return np.column_stack([np.cos(turn), np.sin(turn)])


def _bone():
    """Two circles and a bar between them."""
    neck = np.arcsin(0.45)
    right, left = np.linspace(neck - np.pi, np.pi - neck, 200), np.linspace(neck, 2 * np.pi - neck, 200)
    ends = [(1.3 + np.cos(right), np.sin(right)), (np.cos(left) - 1.3, np.sin(left))]
    return np.vstack([np.column_stack(end) for end in ends])


def _crescent():
    """A circle from which another one bites."""
    open_, bite = np.arccos(0.6071), np.arctan2(0.7946, 0.6071 - 0.7)
    outer, inner = np.linspace(open_, 2 * np.pi - open_, 300), np.linspace(2 * np.pi - bite, bite, 200)
    return np.vstack(
        [
            np.column_stack([np.cos(outer), np.sin(outer)]),
            np.column_stack([0.7 + 0.8 * np.cos(inner), 0.8 * np.sin(inner)]),
        ]
    )


OUTLINES = {
    "disk": [CIRCLE],
    "ring": [CIRCLE, 0.5 * CIRCLE],
    "thin ring": [CIRCLE, 0.7 * CIRCLE],
    "hole": [CIRCLE, 0.316 * CIRCLE + np.array([0.19, 0.0])],
    "triangle": [_corners(3)],
    "square": [_corners(4)],
    "hexagon": [_corners(6)],
    "star": [_wavy((0.25, 5, 0.0))],
    "blob": [_wavy((0.2, 2, 1.0), (0.12, 3, 0.0), (0.1, 4, 2.0))],
    "bone": [_bone()],
    "crescent": [_crescent()],
}
FREE = tuple(name for name in OUTLINES if name != "disk")
HOLES = {"ring": 1, "thin ring": 1, "hole": 1}


def outline_of(kind):
    """Closed lines about an area; the first is the outer one."""
    if kind.startswith("ellipse"):
        stretch = np.sqrt(float(kind.split()[1]))
        return [CIRCLE * [stretch, 1 / stretch]]
    return OUTLINES[kind]


def enclosed(points):
    """Area in a polygon."""
    x, y = points.T
    return abs(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def length(points):
    """Circumference of a polygon."""
    return np.hypot(*(points - np.roll(points, -1, axis=0)).T).sum()


def draw(population, blur, rng, distortion=None):
    """Coverage on the fine grid, and the contacts: kind, x, y, r (of equal area), angle, area, perimeter."""
    fine, rows, placed = np.zeros((ROWS * FINE, COLUMNS * FINE), np.float32), [], np.zeros((0, 3))
    for radius in np.sort(np.exp(rng.uniform(*np.log(population.radii), population.count)))[::-1]:
        kind, angle = population.kinds[rng.integers(len(population.kinds))], rng.uniform(0, np.pi)
        lines = outline_of(kind)
        area = enclosed(lines[0]) - sum(enclosed(hole) for hole in lines[1:])
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        lines = [radius * np.sqrt(np.pi / area) * line @ turn for line in lines]
        if distortion is not None:
            lines = [line @ distortion.T for line in lines]
        extent = np.hypot(*lines[0].T).max()
        place = _free_place(placed, extent, GAP_BLURS * blur, rng)
        if place is None:
            continue
        placed = np.vstack([placed, [*place, extent]])
        centre = _add(fine, lines, place)
        area = enclosed(lines[0]) - sum(enclosed(hole) for hole in lines[1:])
        rows.append((kind, *centre, np.sqrt(area / np.pi), angle, area, sum(length(line) for line in lines)))
    return fine, pd.DataFrame(rows, columns=["kind", "x", "y", "r", "angle", "area", "perimeter"])


def _free_place(placed, extent, gap, rng):
    """A place that touches no other contact; None if there is none."""
    for _ in range(400):
        margin = extent + MARGIN_PX
        place = rng.uniform([margin, margin], [COLUMNS - margin, ROWS - margin])
        if np.all(np.hypot(*(placed[:, :2] - place).T) > placed[:, 2] + extent + gap):
            return place
    return None


def _add(fine, lines, place):
    """Draw one contact; returns its centre of area, px."""
    reach = int(np.hypot(*lines[0].T).max()) + 2
    corner = np.floor(place).astype(int) - reach
    patch = np.zeros(((2 * reach + 1) * FINE * FINER,) * 2, np.float32)
    for number, line in enumerate(lines):
        column, row = ((line + place - corner + 0.5) * FINE * FINER - 0.5).T
        patch[polygon(row, column, patch.shape)] = 0.0 if number else 1.0
    y, x = (np.average(np.arange(len(patch)), weights=patch.sum(axis=axis)) for axis in (1, 0))
    small = patch.reshape(len(patch) // FINER, FINER, -1, FINER).mean(axis=(1, 3))
    fine[_box(corner[1], small), _box(corner[0], small)] += small
    return (np.array([x, y]) + 0.5) / (FINE * FINER) - 0.5 + corner


def _box(start, patch):
    """Slice of the fine grid that a patch covers."""
    return slice(start * FINE, start * FINE + len(patch))


def kernel(optics):
    """Point spread function on the fine grid."""
    reach = int(12 * optics.blur * FINE)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / FINE / optics.blur
    r = np.hypot(x, y)
    if optics.spread == "moffat":
        part = (1 + (r / 1.1775) ** 2 * (2 ** (1 / 3.0) - 1)) ** -3.0
    elif optics.spread == "defocus":
        part = cv2.GaussianBlur((r < 1.6).astype(float), (0, 0), 0.6 * FINE * optics.blur)
    else:
        part = np.exp(-0.5 * r**2)
    return (part / part.sum()).astype(np.float32)


def frame(population, optics, rng, distortion=None):
    """Frame and reference, and the contacts in them."""
    fine, truth = draw(population, optics.blur, rng, distortion)
    if optics.spread == "gauss":
        light = cv2.GaussianBlur(fine, (0, 0), optics.blur * FINE, borderType=cv2.BORDER_REPLICATE)
    else:
        light = fftconvolve(fine, kernel(optics), mode="same")
    cover = light.reshape(ROWS, FINE, COLUMNS, FINE).mean(axis=(1, 3))
    noise = CONTRAST / optics.contrast_to_noise
    y, x = np.mgrid[:ROWS, :COLUMNS]
    lamp = 1 - 0.15 * ((x / COLUMNS - 0.5) ** 2 + (y / COLUMNS - 0.5) ** 2) / 0.25
    shots = [
        lamp * (LEVEL + CONTRAST * part) + rng.normal(0, noise, (ROWS, COLUMNS)) for part in (cover, 0.0)
    ]
    return *(np.clip(np.rint(part * DEPTH), 0, 65535).astype(np.uint16) for part in shots), truth


def measured(population, optics, rng, *, shape="auto", distortion=None):
    """The true contacts, each with the measured one nearest to it, and the time per megapixel."""
    image, reference, truth = frame(population, optics, rng, distortion)
    start = time.process_time()
    found = measure_image(image, reference, shape=shape)
    seconds = (time.process_time() - start) / image.size * 1e6
    if not len(found.disks):
        return truth.assign(found=False, status=found.status, extra=0), found
    places = found.disks[["x_px", "y_px"]].to_numpy()
    distance, index = cKDTree(places).query(truth[["x", "y"]].to_numpy())
    joined = pd.concat([truth, found.disks.iloc[index].reset_index(drop=True)], axis=1)
    joined["found"] = distance < np.maximum(2.0, 0.5 * truth["r"])
    joined["extra"] = max(len(found.disks) - int(joined["found"].sum()), 0)
    return joined.assign(
        blur=optics.blur,
        cn=optics.contrast_to_noise,
        spread=optics.spread,
        status=found.status,
        seconds=seconds,
    ), found


ELLIPSES = tuple(f"ellipse {ratio}" for ratio in RATIOS)
CROWDS = {
    "ellipses": (ELLIPSES, (3.0, 20.0), BLURS[:3], (12, 30, 70)),
    "ellipses and disks": (ELLIPSES + ("disk",) * 24, (3.0, 20.0), BLURS[:3], (90, 30, 70)),
    "free": (FREE, (4.0, 20.0), BLURS, (12, 30, 70)),
    "free and disks": (FREE + ("disk",) * 20, (4.0, 20.0), BLURS, (12, 30, 70)),
}
"""Kinds, radii, blurs and numbers of contacts of a frame."""


def crowd(name, seed, frames):
    """All contacts of some frames, each of another blur, noise and number of contacts."""
    kinds, radii, blurs, counts = CROWDS[name]
    tables = []
    for k in range(frames):
        rng = np.random.default_rng([seed, k])
        optics = Optics(rng.choice(blurs), rng.choice(CONTRASTS))
        table, _ = measured(Population(kinds, radii, int(rng.choice(counts))), optics, rng)
        tables.append(table.assign(frame=k))
    return pd.concat(tables, ignore_index=True)


def pulls(table):
    """Errors of the contacts found over their stated standard uncertainties."""
    found = table[table["found"]]
    ratio = found["kind"].str.extract(r"ellipse (.*)")[0].astype(float).fillna(1.0)
    turn = (found["angle_rad"] - found["angle"] + np.pi / 2) % np.pi - np.pi / 2
    return pd.DataFrame(
        {
            "kind": found["kind"].str.split().str[0].where(ratio > 1, found["kind"]),
            "shape": found["shape"],
            "major": (found["semi_major_px"] - found["r"] * np.sqrt(ratio)) / found["semi_major_std_px"],
            "minor": (found["semi_minor_px"] - found["r"] / np.sqrt(ratio)) / found["semi_minor_std_px"],
            "angle": turn / found["angle_std_rad"],
            "area": (found["radius_px"] - found["r"]) / found["radius_std_px"],
        }
    )


def main():
    """Print how often the truth lies within one and two standard uncertainties."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0])
    parser.add_argument("crowd", choices=CROWDS)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seed", type=int, default=77)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    table = crowd(arguments.crowd, arguments.seed, arguments.frames)
    print("found %:", (100 * table.groupby("kind")["found"].mean()).round().astype(int).to_dict())
    errors = pulls(table)
    for key in (["shape"], ["kind"], ["kind", "shape"]):
        for name, part in errors.groupby(key):
            numbers = [part[column].dropna().abs() for column in ("major", "minor", "angle", "area")]
            shown = [
                f"{100 * np.mean(x < 1):.0f} {100 * np.mean(x < 2):.0f}" if len(x) else "-" for x in numbers
            ]
            print(f"{', '.join(name):28s}{len(part):6d}", " | ".join(shown))


if __name__ == "__main__":
    main()
