"""Images that nobody made for contacts, and what must hold of their measurement all the same."""

import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from contact_frames import FINITE
from hostile_frames import checkerboard, clouds, ramp, rings, stripes

from contactimg.imaging.measure import ImageMeasurement, measure_image
from contactimg.tables import Flag

METHODS, POLARITIES = ("disk", "threshold"), ("bright", "dark", "auto")
REFERENCES = ("none", "right", "wrong")
DEPTHS = ("uint8", "uint16", "float32", "binary")
SINGLE = 2.0**-22
"""Relative error of a difference of two single-precision numbers, two roundings."""
SMALLEST = 2.0**-148
"""Distance of two of the smallest single-precision numbers, twice."""
MOST_POOR = 0.2
"""Share of poor fits above which a frame must not be ok."""


def made_images(side: int) -> dict[str, np.ndarray]:
    """Noise, stripes, gradients, text and checkerboards."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[0:side, 0 : side + side // 3].astype(float)

    def levels(field):
        field = np.asarray(field, float)
        return np.clip(40 + 170 * field + rng.normal(0, 3, x.shape), 0, 255).astype(np.uint8)

    text = np.zeros(x.shape, np.uint8)
    for row in range(20, side, 24):
        cv2.putText(text, "contact 0.42 mN", (5, row), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1)
    patterns = {
        "noise": 0.5 + 0.15 * rng.standard_normal(x.shape),
        "salt": rng.random(x.shape) < 0.01,
        "clouds": clouds(x, y, rng),
        "stripes": stripes(x, y, rng),
        "checkerboard": checkerboard(x, y, rng),
        "gradient": ramp(x, y, rng),
        "rings": rings(x, y, rng),
        "text": text / 255,
        "scratches": np.abs(np.sin(x / 37) * 20 + y - side / 2) < 1,
    }
    return {name: levels(field) for name, field in patterns.items()}


def more_images(side: int) -> dict[str, np.ndarray]:
    """More of them: noise of other kinds, plain patterns without noise, grids, crowds of shapes."""
    rng = np.random.default_rng(8)
    y, x = np.mgrid[0:side, 0 : side + side // 3].astype(float)
    white = rng.standard_normal(x.shape)
    steps = np.kron(rng.random((side // 32 + 1, side // 24 + 1)), np.ones((32, 32)))[
        : x.shape[0], : x.shape[1]
    ]
    squares = ((x % 24 < 9) & (y % 24 < 9)).astype(float)
    patterns = {
        "row noise": 0.5 + 0.1 * rng.standard_normal((side, 1)) + 0.01 * white,
        "pink noise": clouds(x, y, rng) + 0.2 * cv2.GaussianBlur(white, (0, 0), 2.0),
        "shot noise": rng.poisson(2.0, x.shape) / 12,
        "fine blobs": cv2.GaussianBlur(white, (0, 0), 1.5) > 0.1,
        "coarse blobs": cv2.GaussianBlur(white, (0, 0), 6.0) > 0.03,
        "grid": (x % 32 < 2) | (y % 32 < 2),
        "squares": squares,
        "touching squares": (x // 12 + y // 12) % 2,
        "plain checkerboard": (x // 3 + y // 3) % 2,
        "plain gradient": x / x.max(),
        "two halves": x > side // 2,
        "vignette": 1 - ((x / side - 0.6) ** 2 + (y / side - 0.5) ** 2),
        "steps": steps[: x.shape[0], : x.shape[1]],
        "mesh of rings": np.abs(np.hypot(x % 40 - 20, y % 40 - 20) - 12) < 2,
        "plain dots": np.hypot(x % 17 - 8, y % 17 - 8) < 3,
        "black": np.zeros(x.shape),
    }
    return {
        name: np.clip(20 + 200 * np.broadcast_to(np.asarray(field, float), x.shape), 0, 255).astype(np.uint8)
        for name, field in patterns.items()
    }


def odd_images(side: int) -> dict[str, np.ndarray]:
    """What a laboratory may save as an image: drawings, filtered frames, contacts of other profiles."""
    rng = np.random.default_rng(9)
    y, x = np.mgrid[0:side, 0 : side + side // 3].astype(float)
    r, noise = np.hypot(x - side / 1.5, y - side / 2), rng.normal(0, 0.015, x.shape)
    spots = rng.uniform([0.05, 0.05, 3.0], [1.25, 0.95, 14.0], (20, 3)) * [side, side, 1.0]
    away = np.array([np.hypot(x - cx, y - cy) / a for cx, cy, a in spots])
    disks = 0.2 + 0.5 * cv2.GaussianBlur((away < 1).any(axis=0).astype(float), (0, 0), 1.4) + noise
    tile = np.hypot(x % 40 - 20, y % 40 - 20)
    cross = ((np.abs(x % 40 - 20) < 3) | (np.abs(y % 40 - 20) < 3)) & (tile < 12)
    rings = np.cos(r**2 / 160) * np.exp(-r / 90)
    stars = sum(
        min(0.1 * m, 4.0) * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 3.4)
        for m, cx, cy in zip(
            rng.pareto(1.5, 250), *rng.uniform(0, [[1.3 * side], [side]], (2, 250)), strict=True
        )
    )
    mosaic = np.where(x % 2 + y % 2 == 2, 1.0, np.where(y % 2 == 1, 0.85, 0.7))
    patterns = {
        "annulus": 0.2 + 0.6 * (np.abs(r - 60) < 10) + noise,
        "bayer": disks * mosaic,
        "cones": 0.2 + 0.6 * np.clip(1 - away / 1.6, 0, 1).max(axis=0) + noise,
        "disks": disks,
        "dithered": rng.random(x.shape) < disks,
        "domes": 0.2 + 0.6 * np.sqrt(np.clip(1 - away**2, 0, 1)).max(axis=0) + noise,
        "equalised": disks.ravel().argsort().argsort().reshape(x.shape) / x.size,
        "label mask": np.max([(part < 1) * (k + 1) for k, part in enumerate(away)], axis=0) / 220,
        "log floats": 1.0 + np.log(np.maximum(disks, 0.05)) / 3,
        "median filtered": cv2.medianBlur((200 * disks).astype(np.uint8), 9) / 200,
        "newton rings": 0.4 + 0.16 * rings + 0.25 * (r < 20) + noise,
        "plot": _plot(side) / 220,
        "posterised": np.floor(3 * disks) / 3,
        "qr": np.kron(rng.random((side // 8 + 1, side // 6 + 1)) < 0.5, np.ones((8, 8)))[:side, : x.shape[1]],
        "ruler": 1 - 0.9 * ((x % 5 < 1) & (y < 40 + 6.0 * (x % 25 < 1) + 6.0 * (x % 50 < 1)) & (y > 20)),
        "scale bar": np.where((y > side - 20) & (y < side - 14) & (x > side), 1.1, disks),
        "star field": 0.06 + stars + noise,
        "stars and crosses": 0.2 + 0.6 * cross + noise,
        "triangles": 0.2 + 0.6 * ((x % 40 + y % 40 < 28) & (x % 40 > 3) & (y % 40 > 3)) + noise,
        "upside down": 1 - disks,
    }
    return {
        name: np.clip(20 + 200 * np.asarray(field, float), 0, 255).astype(np.uint8)
        for name, field in patterns.items()
    }


def _plot(side: int) -> np.ndarray:
    """A drawn diagram of ten curves in a frame."""
    image = np.full((side, side + side // 3), 40, np.uint8)
    cv2.rectangle(image, (20, 20), (side + 40, side - 20), 200, 2)
    for k in range(10):
        end = (side + 40, side - 20 - int(1.5 * k * k))
        cv2.line(image, (20, side - 20 - 16 * k), end, 150, 1, cv2.LINE_AA)
    return image


def photographs() -> dict[str, np.ndarray]:
    """The images that scikit-image is installed with, as grey levels."""
    import skimage

    folder, out = Path(skimage.__file__).parent / "data", {}
    for path in sorted(folder.glob("*.*")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is not None and min(image.shape) >= 32:
            out[path.stem] = image
    faces = np.load(folder / "lfw_subset.npy")[:100].reshape(10, 10, 25, 25)
    out["faces"] = (255 * faces.transpose(0, 2, 1, 3).reshape(250, 250)).astype(np.uint8)
    depth = np.nan_to_num(np.load(folder / "motorcycle_disp.npz")["arr_0"], posinf=0.0)
    out["depth"] = np.clip(4 * depth, 0, 255).astype(np.uint8)
    return out


def reference_of(kind: str, image: np.ndarray, other: np.ndarray) -> np.ndarray | None:
    """None, the denoised image itself, or another image."""
    if kind == "none":
        return None
    if kind == "right":
        return cv2.medianBlur(image, 5)
    return cv2.resize(other, image.shape[::-1])


def stored_as(depth: str, image: np.ndarray | None) -> np.ndarray | None:
    """An image of 8 bit in another number of grey levels."""
    if image is None or depth == "uint8":
        return image
    if depth == "binary":
        return np.where(image > np.median(image), 255, 0).astype(np.uint8)
    return image.astype(np.uint16) * 257 if depth == "uint16" else image.astype(np.float32) / 255


def sized(image: np.ndarray, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """A random part of an image of about so many pixels; a smaller image is mirrored at its borders."""
    rows, columns = image.shape
    scale = (pixels / image.size) ** 0.5
    size = max(int(rows * scale), 32), max(int(columns * scale), 32)
    padding = [(0, max(whole - part, 0)) for whole, part in zip(size, image.shape, strict=True)]
    image = np.pad(image, padding, mode="symmetric") if np.any(padding) else image
    top, left = (
        int(rng.integers(0, whole - part + 1)) for whole, part in zip(image.shape, size, strict=True)
    )
    return np.ascontiguousarray(image[top : top + size[0], left : left + size[1]])


def stand_out(difference, disks, sign):
    """Mean inside each disk minus the median of a ring around it, in units of the ring's robust scatter."""
    out = np.full(len(disks), np.inf)
    y, x = np.mgrid[0 : difference.shape[0], 0 : difference.shape[1]]
    for k, (cx, cy, a) in enumerate(disks):
        box = tuple(
            slice(max(int(c - a - 12), 0), min(int(c + a + 13), size))
            for c, size in zip((cy, cx), difference.shape, strict=True)
        )
        r = np.hypot(x[box] - cx, y[box] - cy)
        inside, ring = difference[box][r <= max(a, 0.75)], difference[box][(r > a + 3) & (r < a + 10)]
        if inside.size and ring.size > 8:
            scatter = 1.4826 * np.median(np.abs(ring - np.median(ring)))
            least = 1e-6 * max(float(np.abs(ring).max()), float(np.abs(inside).max()), 1e-300)
            out[k] = sign * (inside.mean() - np.median(ring)) / max(scatter, least)
    return out


@dataclass
class Looked:
    """A measurement of any image, what is wrong with it, and the processor time that it took, s.

    ``not_shown``: the contrast is beyond the pixels, and the frame says that no contact shows it.
    """

    result: ImageMeasurement
    invisible: int = 0
    poor: float = 0.0
    faults: list[str] = field(default_factory=list)
    rises: np.ndarray = field(default_factory=lambda: np.zeros(0))
    seconds: float = 0.0
    not_shown: bool = False


def look_at(image, reference, *, method, polarity, least_rise=0.0, known_scale=True) -> Looked:
    """Measure an image and look for what must not be.

    The values of a float image lie between 0 and 1, unless the scale is not known: then no contrast may
    exceed what lies between the lowest and the highest pixel of both images, to single precision, unless the
    frame says of all contacts that they are too small to show it (`NO_PLATEAU`).
    """
    levels = 1.0 if image.dtype.kind == "f" else float(np.iinfo(image.dtype).max)
    if not known_scale:
        both = [image] if reference is None else [image, reference]
        high, low = float(max(part.max() for part in both)), float(min(part.min() for part in both))
        levels = high - low + SINGLE * max(abs(high), abs(low)) + SMALLEST
    full_scale, start = levels if known_scale else None, time.process_time()
    result = measure_image(image, reference, method=method, polarity=polarity, full_scale=full_scale)
    seconds, disks, found = time.process_time() - start, result.disks, []
    hidden = bool(len(disks)) and bool((disks["flags"].to_numpy() & int(Flag.NO_PLATEAU) > 0).all())
    beyond = abs(result.contrast) > levels * (1 + 1e-9)
    if beyond and (known_scale or not hidden):
        found.append(f"contrast {result.contrast:.4g} beyond the range")
    places = disks[["x_px", "y_px", "radius_px"]].to_numpy()
    if not np.isfinite(disks[list(FINITE)].to_numpy(float)).all():
        found.append("numbers that are not finite")
    rise = stand_out(result.difference, places, np.sign(result.contrast) or 1)
    rise[[row for row, lines in result.outlines() if len(lines) > 1]] = np.inf  # rings: dark inside
    invisible = int(np.count_nonzero(rise <= least_rise))
    if invisible and result.status == "ok":
        found.append(f"{invisible} of {len(rise)} contacts do not stand out")
    poor = np.mean(disks["flags"].to_numpy() & int(Flag.POOR_FIT) > 0) if len(disks) else 0.0
    if (poor == 1.0 or (poor > MOST_POOR and len(disks) >= 3)) and result.status == "ok":
        found.append(f"ok although {poor:.0%} are poor fits")
    if result.status != "ok" and not result.message:
        found.append(f"status {result.status} without a sentence")
    return Looked(result, invisible, float(poor), found, rise, seconds, beyond and hidden)


def faults(image, reference, *, method, polarity, least_rise=0.0):
    """What is wrong with the measurement of an image: a list of sentences, empty if nothing."""
    return look_at(image, reference, method=method, polarity=polarity, least_rise=least_rise).faults
