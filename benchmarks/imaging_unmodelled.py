"""Frames that the model of the imaging does not describe: what is wrong then, and whether the result says so.

    python benchmarks/imaging_unmodelled.py                       # docs/imaging_unmodelled.md
    python benchmarks/imaging_unmodelled.py defocus ghosts        # some of the cases, printed

The contacts are those of an SA+ surface under a sphere at three loads, rendered with point spread functions,
shapes, lamps and cameras that the fit does not know, by code that shares nothing with the package.
"""

import argparse
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pandas as pd
import tifffile
from imaging_scores import ROOT, markdown
from scipy.spatial import cKDTree

from contactimg import generate_asperities, measure_series, scene_from_dict, solve_loads

PAGE = ROOT / "docs" / "imaging_unmodelled.md"
SEED = 61_000

LOADS = (0.02, 0.2, 0.5)  # N
SIDE, FINE = 1000, 4  # px; points of the rendering per pixel
PIXEL_SIZE = 6e-6  # m
LEVEL, CONTRAST, TEXTURE, VIGNETTING, BLUR_PX = 80.0, 1.25, 0.02, 0.2, 1.4
ELECTRONS_PER_LEVEL, READ_NOISE = 20.0, 10.0  # contrast over noise 38
KERNEL_PX = 14

ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE]
U, V = (COLUMNS - SIDE / 2) / SIDE, (ROWS - SIDE / 2) / SIDE


@dataclass(frozen=True)
class Shape:
    """How the coverage of a contact differs from a disk; all lengths relative to its radius."""

    elongation: float = 1.0
    hole_area: float = 0.0
    softness: float = 0.0
    dome: float = 0.0
    outer_rim: float = 0.0
    small_contrast: float = 0.0


@dataclass(frozen=True)
class Case:
    """One kind of frame.

    Parameters
    ----------
    name : str
    shape : Shape
    spread : callable
        Kernel of the point spread function on the fine grid.
    lamps : callable
        Light on the frame and on the reference, each of the size of the frame.
    level, contrast : float
        Background, grey levels; brightness of the contacts relative to it.
    camera : callable
        What becomes of the grey levels (frame, rng), before they are rounded.
    also_reference : bool
        Whether the reference is taken through the same.
    ghosts : float
        Brightness of fifteen contacts that the reference shows, relative to the background.
    """

    name: str
    shape: Shape = Shape()
    spread: Callable[[], np.ndarray] | None = None
    lamps: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None
    level: float = LEVEL
    contrast: float = CONTRAST
    camera: Callable[[np.ndarray, np.random.Generator], np.ndarray] = lambda grey, _: grey
    also_reference: bool = True
    ghosts: float = 0.0


def contacts_at(load, seed):
    """Columns x, y, a (px) of the contacts inside the frame."""
    rng = np.random.default_rng(seed)
    asperities = generate_asperities("SA", side=8e-3, rng=rng)
    (solution,) = solve_loads(
        asperities, indenter_radius=0.1288, contact_modulus=4e6, loads=[load], apex=(4e-3, 4e-3)
    )
    table = solution.contacts()
    x, y = ((table[name] - 4e-3) / PIXEL_SIZE + (SIDE - 1) / 2 for name in ("x_m", "y_m"))
    disks = pd.DataFrame({"x": x, "y": y, "a": table["radius_m"] / PIXEL_SIZE})
    margin = 1.6 * disks["a"] + 8
    inside = disks[["x", "y"]].gt(margin, axis=0).all(axis=1) & disks[["x", "y"]].lt(
        SIDE - 1 - margin, axis=0
    ).all(axis=1)
    return disks[inside & (disks["a"] > 0.5)].reset_index(drop=True)


def paint(disks, shape, rng):
    """Coverage on the fine grid, and the area of each contact, px^2."""
    fine, areas = np.zeros((SIDE * FINE, SIDE * FINE), np.float32), []
    for x, y, a in disks.to_numpy():
        centre, radius = np.array([x + 0.5, y + 0.5]) * FINE - 0.5, a * FINE
        reach = int(1.6 * radius + 8 + shape.softness * radius)
        x0, y0 = np.maximum(centre.astype(int) - reach, 0)
        x1, y1 = np.minimum(centre.astype(int) + reach + 1, SIDE * FINE)
        cover, area = _paint_one(
            np.arange(x0, x1) - centre[0], np.arange(y0, y1) - centre[1], radius, shape, rng
        )
        np.maximum(fine[y0:y1, x0:x1], cover.astype(np.float32), out=fine[y0:y1, x0:x1])
        areas.append(area)
    return fine, np.array(areas)


def _paint_one(x, y, radius, shape, rng):
    """Coverage of one contact, and its area, px^2."""
    x, y = np.meshgrid(x, y)
    angle, stretch = rng.uniform(0, np.pi), np.sqrt(shape.elongation)
    along = (x * np.cos(angle) + y * np.sin(angle)) / stretch
    across = (-x * np.sin(angle) + y * np.cos(angle)) * stretch
    r = np.hypot(along, across)
    cover, area = np.clip((radius - r) / (1 + shape.softness * radius) + 0.5, 0, 1), np.pi * radius**2
    if shape.hole_area:
        count = max(1, round(radius / FINE / 4))
        hole = radius * np.sqrt(shape.hole_area / count)
        for _ in range(count):
            out, turn = np.sqrt(rng.uniform()) * max(radius - hole - 2, 0), rng.uniform(0, 2 * np.pi)
            cover *= 1 - np.clip(hole - np.hypot(x - out * np.cos(turn), y - out * np.sin(turn)) + 0.5, 0, 1)
        area = cover.sum()
    cover = cover * (
        1 + abs(shape.dome) * np.clip((r / radius) ** 2 if shape.dome < 0 else 1 - (r / radius) ** 2, 0, 1)
    )
    cover *= 1 + shape.small_contrast * np.exp(-radius / FINE / 4)
    if shape.outer_rim:
        width = 0.5 * shape.outer_rim * radius
        ring = 0.35 * np.clip(1 - np.abs(r - radius - width) / (width + 0.5), 0, 1) * (r > radius)
        cover = np.maximum(cover, ring)
    return cover, area / FINE**2


def gaussian(sigma=BLUR_PX):
    """Gaussian of a standard deviation in px."""
    return _normalised(np.exp(-(_radius_px() ** 2) / 2 / sigma**2))


def disk(outer=3.0, inner=0.0):
    """Out of focus: a disk, or a ring, px."""
    r = _radius_px()
    return _normalised(cv2.GaussianBlur(((r < outer) & (r >= inner)).astype(float), (0, 0), 0.6 * FINE))


def moffat():
    """Long tails, as of the atmosphere."""
    return _normalised((1 + (_radius_px() / 2.0) ** 2) ** -2.5)


def coma(waves=0.2):
    """RMS coma of a diffraction-limited lens."""
    n = 512
    q = np.fft.fftfreq(n) * n / 40
    rho, angle = np.hypot(q, q[:, None]), np.arctan2(q[:, None], q)
    phase = waves * np.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(angle)
    spot = np.fft.fftshift(np.abs(np.fft.fft2((rho < 1) * np.exp(2j * np.pi * phase))) ** 2)
    spot = cv2.resize(spot.astype(np.float32), None, fx=1.2, fy=1.2)
    middle, half = spot.shape[0] // 2, _radius_px().shape[0] // 2
    part = spot[middle - half : middle + half + 1, middle - half : middle + half + 1]
    return _normalised(cv2.GaussianBlur(part, (0, 0), 0.6 * FINE))


def _radius_px():
    """Distance from the centre of a kernel."""
    half = KERNEL_PX * FINE // 2
    return np.hypot(*np.mgrid[-half : half + 1, -half : half + 1]) / FINE


def _normalised(kernel):
    """Of sum one."""
    return (kernel / kernel.sum()).astype(np.float32)


def blurred(fine, kernel):
    """Through the point spread function and averaged over each pixel."""
    image = cv2.filter2D(fine, -1, cv2.flip(kernel, -1), borderType=cv2.BORDER_CONSTANT)
    return image.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3))


def blurred_unevenly(fine, low=1.0, high=2.0, steps=9):
    """Blur that grows from left to right."""
    images = np.stack([blurred(fine, gaussian(sigma)) for sigma in np.linspace(low, high, steps)])
    place = (U + 0.5) * (steps - 1)
    left = np.minimum(place.astype(int), steps - 2)
    low, high = (np.take_along_axis(images, index[None], 0)[0] for index in (left, left + 1))
    return low + (place - left) * (high - low)


def vignetting(centre=0.0):
    """A lamp whose light falls towards the corners."""
    return 1 - VIGNETTING * ((U - centre) ** 2 + V**2) / 0.5


def texture(rng):
    """Relative brightness of the surface."""
    total = np.zeros((SIDE, SIDE), np.float32)
    for sigma, share in ((1.7, 0.75), (8.0, 0.25)):
        part = cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)).astype(np.float32), (0, 0), sigma)
        total += TEXTURE * np.sqrt(share) * part / part.std()
    return total


def moved(image, dx, dy):
    """Shifted by a fraction of a pixel, exactly."""
    phase = np.exp(-2j * np.pi * (np.fft.rfftfreq(SIDE)[None] * dx + np.fft.fftfreq(SIDE)[:, None] * dy))
    return np.fft.irfft2(np.fft.rfft2(image) * phase, (SIDE, SIDE))


def exposed(light, rng):
    """Shot noise and read noise, grey levels."""
    electrons = rng.poisson(np.maximum(light, 0) * ELECTRONS_PER_LEVEL) + rng.normal(
        0, READ_NOISE, light.shape
    )
    return electrons / ELECTRONS_PER_LEVEL


def rounded(grey):
    """Eight bits."""
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def gamma_encoded(grey, _, gamma=0.45, white=300.0):
    """A camera that stores a power of the light."""
    return 255 * (np.clip(grey, 0, None) / white) ** gamma


def interlaced(grey, _, px=2):
    """Every second row read while the image moves."""
    grey = grey.copy()
    grey[1::2] = np.roll(grey[1::2], px, axis=1)
    return grey


def row_noise(grey, rng, levels=1.5):
    """Noise that the pixels of a row share."""
    return grey + levels * rng.standard_normal((SIDE, 1))


def hot_pixels(grey, rng, share=1e-4):
    """Pixels at full scale."""
    return np.where(rng.random(grey.shape) < share, 255.0, grey)


def compressed(grey, _, quality=75):
    """JPEG."""
    return cv2.imdecode(cv2.imencode(".jpg", rounded(grey), [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0)


def sharpened(grey, _, amount=1.0, sigma=1.5):
    """Unsharp mask."""
    return grey + amount * (grey - cv2.GaussianBlur(grey, (0, 0), sigma))


def lamp(change):
    """The frame's light multiplied by a change; the reference's is 2 % dimmer."""
    return lambda: (vignetting() * change(), 0.98 * vignetting())


CASES = [
    Case("as the model"),
    Case("camera gamma 0.45", camera=gamma_encoded),
    Case(
        "reference 20 % dimmer, gradient 10 %",
        lamps=lambda: (vignetting(), 0.8 * vignetting() * (1 + 0.2 * U)),
    ),
    Case("light gradient ±12 %", lamps=lamp(lambda: 1 + 0.24 * U)),
    Case("light gradient ±20 %", lamps=lamp(lambda: 1 + 0.40 * U)),
    Case("vignette moved by 300 px", lamps=lambda: (vignetting(0.3), 0.98 * vignetting())),
    Case("holes, 10 % of the area", Shape(hole_area=0.1)),
    Case("defocus", spread=disk),
    Case("annular aperture out of focus", spread=lambda: disk(3.0, 2.2)),
    Case("coma of 0.2 waves", spread=coma),
    Case("Moffat", spread=moffat),
    Case("interlaced, 2 px", camera=interlaced, also_reference=False),
    Case("ellipses 1.3 : 1", Shape(elongation=1.3)),
    Case("ellipses 1.3 : 1, gamma 0.45", Shape(elongation=1.3), camera=gamma_encoded),
    Case("ellipses 1.3 : 1, 20 % brighter in the middle", Shape(elongation=1.3, dome=0.2)),
    Case("ellipses 1.3 : 1, defocus", Shape(elongation=1.3), spread=disk),
    Case("edge softened by 0.3 a", Shape(softness=0.3)),
    Case("small contacts 15 % dimmer", Shape(small_contrast=-0.15)),
    Case("small contacts 15 % brighter", Shape(small_contrast=0.15)),
    Case("blur 1 to 2 px across the frame"),
    Case("saturated", level=125.0),
    Case("20 % brighter in the middle", Shape(dome=0.2)),
    Case("20 % brighter at the rim", Shape(dome=-0.2)),
    Case("bright rim outside, 0.1 a", Shape(outer_rim=0.1)),
    Case("15 ghosts in the reference", ghosts=0.15),
    Case("row noise of 1.5 levels", camera=row_noise),
    Case("hot pixels", camera=hot_pixels, also_reference=False),
    Case("JPEG", camera=compressed, also_reference=False),
    Case("unsharp mask", camera=sharpened),
    Case("14 levels of contrast", contrast=0.175),
]


def render(case, disks, rng):
    """Frame, reference and areas (px^2) of one case."""
    fine, areas = paint(disks, case.shape, rng)
    kernel = gaussian() if case.spread is None else case.spread()
    cover = blurred_unevenly(fine) if case.name.startswith("blur") else blurred(fine, kernel)
    lamp_frame, lamp_reference = lamp(lambda: 1.0)() if case.lamps is None else case.lamps()
    surface = texture(rng)
    frame = case.level * lamp_frame * (1 + surface) * (1 + case.contrast * cover)
    reference = case.level * lamp_reference * (1 + moved(surface, 0.4, -0.3))
    if case.ghosts:
        some = disks.sample(min(15, len(disks)), random_state=3)
        ghosts = paint(some.assign(x=some["x"] + 2, y=some["y"] + 1, a=0.9 * some["a"]), Shape(), rng)[0]
        reference = reference * (1 + case.ghosts * blurred(ghosts, gaussian()))
    frame, reference = exposed(frame, rng), exposed(reference, rng)
    frame = case.camera(frame, rng)
    reference = case.camera(reference, rng) if case.also_reference else reference
    return rounded(frame), rounded(reference), areas


def measured(frame, reference):
    """Run of a folder with one frame, and the processor time, s."""
    with TemporaryDirectory() as folder:
        tifffile.imwrite(Path(folder) / "frame_1.tif", frame)
        tifffile.imwrite(Path(folder) / "reference.tif", reference)
        images = {"reference": "reference.tif", "frames": "frame_*.tif"}
        scene = scene_from_dict({"camera": {"pixel_size_m": PIXEL_SIZE}, "images": images}, folder=folder)
        start = time.process_time()
        return measure_series(scene, workers=1), time.process_time() - start


def score(case, seed):
    """One row a load."""
    rows = []
    for load in LOADS:
        rng = np.random.default_rng([seed, zlib.crc32(case.name.encode()), int(1000 * load)])
        disks = contacts_at(load, seed)
        frame, reference, areas = render(case, disks, rng)
        run, seconds = measured(frame, reference)
        row, found = run.frames.iloc[0], run.contacts
        true_radius = np.sqrt(areas / np.pi)
        distance, nearest = cKDTree(disks[["x", "y"]]).query(
            found[["x_px", "y_px"]].to_numpy(float).reshape(-1, 2)
        )
        hit = distance < np.maximum(0.5 * true_radius[nearest], 1.5)
        error = np.abs(found["radius_px"].to_numpy()[hit] - true_radius[nearest[hit]])
        std = found["radius_std_px"].to_numpy()[hit]
        area = areas.sum() * PIXEL_SIZE**2
        rows.append(
            {
                "case": case.name,
                "load N": load,
                "area error %": 100 * (row["area_m2"] / area - 1),
                "in stated std": (row["area_m2"] - area) / row["area_std_m2"],
                "F1": 2 * len(set(nearest[hit])) / (len(disks) + len(found)),
                "within 1 std %": 100 * np.mean(error < std) if len(error) else np.nan,
                "within 2 std %": 100 * np.mean(error < 2 * std) if len(error) else np.nan,
                "status": row["status"],
                "s per megapixel": seconds / (frame.size / 1e6),
            }
        )
    return rows


def table(rows):
    """One line a case: each number at the three loads."""
    lines = []
    for name, part in pd.DataFrame(rows).groupby("case", sort=False):
        shown = [name]
        for column, form in (("area error %", "{:+.1f}"), ("in stated std", "{:+.1f}"), ("F1", "{:.2f}")):
            shown.append(" / ".join(form.format(value) for value in part[column]))
        one, two = part["within 1 std %"], part["within 2 std %"]
        shown.append(", ".join(f"{a:.0f} {b:.0f}" for a, b in zip(one, two, strict=True)))
        shown.append(" / ".join(part["status"]) if len(set(part["status"])) > 1 else part["status"].iloc[0])
        shown.append(f"{part['s per megapixel'].max():.2f}")
        lines.append(shown)
    return lines


HEADER = [
    "frames",
    "area error %",
    "in stated std",
    "F1",
    "within 1, 2 std %",
    "status",
    "s per megapixel, worst",
]


def main():
    """Print the table; write the page if all cases were measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", help="cases whose names contain one of these; default: all")
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    words = [word.lower() for word in arguments.words]
    chosen = [case for case in CASES if not words or any(word in case.name.lower() for word in words)]
    measured(*render(CASES[0], contacts_at(LOADS[0], 1), np.random.default_rng(1))[:2])  # compile
    rows = [row for case in chosen for row in score(case, arguments.seed)]
    text = "\n".join(markdown(HEADER, table(rows)))
    print(text)
    if not words and PAGE.exists():
        head = PAGE.read_text(encoding="utf-8").split("<!-- table -->")[0]
        PAGE.write_text(f"{head}<!-- table -->\n{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
