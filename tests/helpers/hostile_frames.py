"""Random frames that no camera should give, for the tests that nothing breaks."""

import cv2
import numpy as np

SHAPES = [
    (1, 1),
    (1, 7),
    (1, 300),
    (300, 1),
    (2, 2),
    (3, 3),
    (2, 100),
    (5, 9),
    (8, 8),
    (16, 16),
    (17, 15),
    (64, 64),
]


def stripes(x, y, rng):
    period, angle = rng.uniform(2, 60), rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
    return (x * np.cos(angle) + y * np.sin(angle)) % period < period * rng.uniform(0.1, 0.9)


def checkerboard(x, y, rng):
    side = rng.integers(1, 40)
    return (x // side + y // side) % 2


def ramp(x, y, rng):
    angle = rng.uniform(0, 2 * np.pi)
    field = np.cos(angle) * x + np.sin(angle) * y
    return (field - field.min()) / max(np.ptp(field), 1e-9)


def clouds(x, y, rng):
    field = cv2.GaussianBlur(rng.standard_normal(x.shape), (0, 0), rng.uniform(0.5, 30))
    return (field - field.min()) / max(np.ptp(field), 1e-9)


def blobs(x, y, rng):
    field = np.zeros(x.shape)
    for _ in range(rng.integers(1, 60)):
        a = np.exp(rng.uniform(np.log(0.3), np.log(max(x.shape))))
        cx, cy = rng.uniform(-a, x.shape[1] + a), rng.uniform(-a, x.shape[0] + a)
        steps = (np.hypot(x - cx, y - cy) - a) / rng.uniform(0.2, 5)
        field = np.maximum(field, 1 / (1 + np.exp(np.clip(steps, -50, 50))))
    return field


def rings(x, y, rng):
    square = (x - x.shape[1] / 2) ** 2 + (y - x.shape[0] / 2) ** 2
    return np.sin(square / rng.uniform(5, 500)) ** 2


PATTERNS = [
    stripes,
    checkerboard,
    ramp,
    clouds,
    blobs,
    rings,
    lambda x, y, rng: rng.random(x.shape),
    lambda x, y, rng: rng.random(x.shape) < rng.choice([0.001, 0.01, 0.1, 0.5]),
    lambda x, y, rng: x > x.shape[1] // 2,
    lambda x, y, rng: x != rng.integers(x.shape[1]),
    lambda x, y, rng: y == rng.integers(x.shape[0]),
    lambda x, y, rng: (x == x.shape[1] // 2) & (y == x.shape[0] // 3),
    lambda x, y, rng: np.hypot(x - x.shape[1] / 2, y - x.shape[0] / 2) < rng.uniform(0.1, 0.8) * min(x.shape),
    lambda x, y, rng: np.ones(x.shape),
]


def holed(image, rng):
    image = image.copy()
    for value in (np.inf, -np.inf, np.nan):
        image[rng.random(image.shape) < 0.01] = value
    return image


TYPES = [
    lambda image, rng: np.clip(np.rint(image), 0, 255).astype(np.uint8),
    lambda image, rng: np.clip(np.rint(image), 0, 255).astype(np.uint8),
    lambda image, rng: (np.clip(image, 0, 255) * 257).astype(np.uint16),
    lambda image, rng: image * 1e30,
    lambda image, rng: (image * 1e28).astype(np.float32),
    lambda image, rng: -image,
    lambda image, rng: image > 100,
    holed,
    lambda image, rng: image * 10.0 ** rng.uniform(-30, 30),
    lambda image, rng: image.astype(np.float32) - 100,
]


def hostile_frame(seed):
    """A frame, a reference or None, and options of the measurement."""
    rng = np.random.default_rng(seed)
    shape = SHAPES[rng.integers(len(SHAPES))] if rng.random() < 0.4 else tuple(rng.integers(20, 130, 2))

    def pattern():
        y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
        low, high = rng.uniform(0, 120), rng.uniform(60, 255)
        field = low + (high - low) * PATTERNS[rng.integers(len(PATTERNS))](x, y, rng).astype(float)
        return field + (rng.random() < 0.5) * rng.uniform(0, 10) * rng.standard_normal(shape)

    frame, reference = pattern(), None
    kind = rng.random()
    if kind < 0.55:
        reference = pattern()
    elif kind < 0.8:
        reference = rng.uniform(10, 200) + 2 * rng.standard_normal(shape)
    elif kind < 0.85:
        reference = frame + rng.standard_normal(shape)
    convert = TYPES[rng.integers(len(TYPES))]
    options = {
        "method": str(rng.choice(["disk", "disk", "threshold"])),
        "polarity": str(rng.choice(["auto", "bright", "dark"])),
        "threshold": [None, "auto", 0.05, 0.95][rng.integers(4)],
        "blur_px": float(rng.uniform(0.2, 8)) if rng.random() < 0.2 else None,
    }
    return convert(frame, rng), None if reference is None else convert(reference, rng), options


def dirty_plate(rng, *, shape=(600, 800), count=400):
    """A stand-in for a real plate of bright dots on a dark field: frame, and x, y, radius of its dots.

    Dots of 1.5 to 5 px that stand apart, half of them half as bright; dust, fibres and streaks of wiping, an
    uneven glow, and no reference.
    """
    rows, columns = shape
    yy, xx = np.mgrid[0:rows, 0:columns].astype(np.float32)
    light = 18 + 14 * xx / columns + 10 * np.exp(-((xx - 0.3 * columns) ** 2 + yy**2) / (0.4 * columns) ** 2)
    dots, cells = [], np.argwhere(np.ones((rows // 30, columns // 30), bool))
    for row, column in rng.permutation(cells)[:count]:
        x, y = 30 * column + 15 + rng.uniform(-6, 6), 30 * row + 15 + rng.uniform(-6, 6)
        radius, height = rng.uniform(1.5, 5.0), rng.choice([60.0, 120.0])
        near = (slice(30 * row, 30 * row + 30), slice(30 * column, 30 * column + 30))
        light[near] += height * np.clip(radius - np.hypot(xx[near] - x, yy[near] - y) + 0.5, 0, 1)
        dots.append((x, y, radius))
    dirt = np.zeros(shape, np.float32)
    for _ in range(150):
        x, y, angle = rng.uniform(0, columns), rng.uniform(0, rows), rng.uniform(0, 180)
        axes = (int(rng.integers(0, 2)), int(rng.integers(0, 2)))
        cv2.ellipse(dirt, (int(x), int(y)), axes, angle, 0, 360, float(rng.uniform(5, 40)), -1)
    for _ in range(12):
        start, end = rng.uniform(0, 1, (2, 2)) * (columns, rows)
        cv2.line(dirt, start.astype(int).tolist(), end.astype(int).tolist(), float(rng.uniform(4, 20)), 1)
    light = cv2.GaussianBlur(light, (0, 0), 1.0) + cv2.GaussianBlur(dirt, (0, 0), 1.0)
    noisy = light + rng.normal(0, 1.0, shape) * np.sqrt(1.0 + light / 20.0)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), np.array(dots)
