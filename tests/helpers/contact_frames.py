"""Frames with known disks for the imaging tests, made without anything of `contactimg`.

A disk is painted on a grid several times finer than the pixels with an anti-aliased rim, blurred there by
the point spread function, and averaged over each pixel; area and centroid are the disk's to better than 1e-3.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
import pandas as pd

FINITE = (
    "x_px", "y_px", "radius_px", "radius_std_px", "contrast_shift_px", "blur_shift_px", "edge_shift_px",
    "area_px2", "area_std_px2", "visible_area_px2", "semi_major_px", "semi_minor_px",
)  # fmt: skip
"""Columns of the contacts of a frame that are numbers whatever the frame shows."""
CAMERAS = {"low": (3.0, 6.0), "mid": (20.0, 10.0), "high": (150.0, 16.0)}


@dataclass(frozen=True)
class Optics:
    """What the camera makes of the coverage; lengths in pixels, levels in grey levels."""

    shape: tuple[int, int] = (1200, 1600)
    level: float = 80.0
    contrast: float = 1.25
    sigma: float = 1.4
    halo: float = 0.0
    halo_sigma: float = 8.0
    softness: float = 0.0
    spread: float = 0.0
    camera: str | tuple[float, float] = "mid"
    vignetting: float = 0.2
    texture: float = 0.02
    dust: int = 40
    drift: float = 0.0
    shift: tuple[float, float] = (-0.4, 0.3)
    gain: float = 1.0 / 0.98
    full_scale: float = 255.0
    oversampling: int = 4
    extra: dict = field(default_factory=dict)


def coverage(x, y, radius, weight, optics):
    """Sum of ``weight`` times each disk's coverage, blurred and averaged over pixels."""
    k = optics.oversampling
    rows, columns = optics.shape
    fine = np.zeros((rows * k, columns * k), np.float32)
    for xi, yi, ai, wi in zip(x, y, radius, weight, strict=True):
        cx, cy, a = (xi + 0.5) * k - 0.5, (yi + 0.5) * k - 0.5, ai * k
        soft = max(optics.softness * k, 1.0)
        x0, x1 = max(int(cx - a - soft - 2), 0), min(int(cx + a + soft + 3), columns * k)
        y0, y1 = max(int(cy - a - soft - 2), 0), min(int(cy + a + soft + 3), rows * k)
        if x0 >= x1 or y0 >= y1:
            continue
        r = np.hypot(np.arange(x0, x1) - cx, (np.arange(y0, y1) - cy)[:, None])
        rim = np.clip((a - r) / soft + 0.5, 0, 1).astype(np.float32)
        patch = fine[y0:y1, x0:x1]
        np.maximum(patch, wi * rim, out=patch)
    core = cv2.GaussianBlur(fine, (0, 0), optics.sigma * k, borderType=cv2.BORDER_REPLICATE)
    if optics.halo:
        wide = cv2.GaussianBlur(fine, (0, 0), optics.halo_sigma * k, borderType=cv2.BORDER_REPLICATE)
        core = (1 - optics.halo) * core + optics.halo * wide
    return core.reshape(rows, k, columns, k).mean(axis=(1, 3))


def surface_texture(optics, rng):
    """Relative brightness of the surface: correlated texture and dark dust, on a grid with a margin."""
    rows, columns = optics.shape
    field_ = np.zeros((rows + 32, columns + 32), np.float32)
    if optics.texture:
        for sigma, share in ((1.7, 0.75), (8.0, 0.25)):
            part = cv2.GaussianBlur(rng.standard_normal(field_.shape).astype(np.float32), (0, 0), sigma)
            field_ += optics.texture * np.sqrt(share) / part.std() * part
    for _ in range(optics.dust):
        cx, cy = rng.uniform(20, columns), rng.uniform(20, rows)
        size, depth = rng.uniform(0.8, 2.5), rng.uniform(0.05, 0.3)
        yy, xx = np.mgrid[-12:13, -12:13]
        r0, c0 = int(cy), int(cx)
        patch = field_[max(r0 - 12, 0) : r0 + 13, max(c0 - 12, 0) : c0 + 13]
        spot = depth * np.exp(-(xx**2 + yy**2) / (2 * size**2))
        patch -= spot[: patch.shape[0], : patch.shape[1]].astype(np.float32)
    return field_


def sub_pixel_shift(image, dx, dy):
    """The periodic image moved by (dx, dy), exactly, in Fourier space."""
    ky = np.fft.fftfreq(image.shape[0])[:, None]
    kx = np.fft.rfftfreq(image.shape[1])[None, :]
    phase = np.exp(-2j * np.pi * (kx * dx + ky * dy))
    return np.fft.irfft2(np.fft.rfft2(image) * phase, image.shape).astype(np.float32)


def expose(light, optics, rng):
    """Shot noise, read noise, quantisation and saturation of ``light`` (grey levels)."""
    camera = CAMERAS[optics.camera] if isinstance(optics.camera, str) else optics.camera
    electrons_per_level, read = camera
    electrons = rng.poisson(np.maximum(light, 0) * electrons_per_level) + rng.normal(0, read, light.shape)
    dtype = np.uint8 if optics.full_scale <= 255 else np.uint16
    return np.clip(np.rint(electrons / electrons_per_level), 0, optics.full_scale).astype(dtype)


def render(truth, optics, rng):
    """Frame and reference of the disks in ``truth`` (x_px, y_px, radius_px)."""
    rows, columns = optics.shape
    weight = 1 + optics.spread * rng.standard_normal(len(truth))
    cover = coverage(truth.x_px, truth.y_px, truth.radius_px, weight, optics)
    yy, xx = np.mgrid[0:rows, 0:columns]
    u, v = (xx - (columns - 1) / 2) / columns, (yy - (rows - 1) / 2) / columns
    light = optics.level * (1 - optics.vignetting * (u**2 + v**2) / (0.25 + 0.25 * (rows / columns) ** 2))
    texture = surface_texture(optics, rng)
    crop = (slice(16, 16 + rows), slice(16, 16 + columns))
    # position in frame = position in reference + shift, so the reference shows the texture moved by -shift
    moved = sub_pixel_shift(texture, -optics.shift[0], -optics.shift[1])[crop]
    drift = 1 + optics.drift * u * 2
    frame = light * drift * (1 + texture[crop]) * (1 + optics.contrast * cover)
    reference = light / optics.gain * (1 + moved)
    return expose(frame, optics, rng), expose(reference, optics, rng)


def scatter(n, optics, rng, *, radii=(1.5, 30.0), pairs=0.1, gaps=(0.5, 2.0), touching=0.02, margin=4.0):
    """Disks with log-uniform radii: isolated ones, close pairs and touching pairs (kind 0, 1, 2)."""
    rows, columns = optics.shape
    n_close, n_touch = round(n * pairs / 2), round(n * touching / 2)
    placed: list[tuple] = []
    kept = np.empty((n, 3))

    def draw():
        return np.exp(rng.uniform(*np.log(radii)))

    def free(x, y, a, space):
        inside = a + margin <= x <= columns - 1 - a - margin and a + margin <= y <= rows - 1 - a - margin
        if not inside:
            return False
        others_x, others_y, others_a = kept[: len(placed)].T
        return bool(np.all((others_x - x) ** 2 + (others_y - y) ** 2 > (others_a + a + space) ** 2))

    space = 4 * optics.sigma + 2
    kinds = [2] * n_touch + [1] * n_close + [0] * (n - 2 * n_touch - 2 * n_close)
    radii_drawn = [(draw(), draw()) for _ in kinds]
    order = sorted(range(len(kinds)), key=lambda i: -max(radii_drawn[i][: 2 if kinds[i] else 1]))
    for number, i in enumerate(order):
        kind, (a, b) = kinds[i], radii_drawn[i]
        for _ in range(20000):
            x, y = rng.uniform(0, columns), rng.uniform(0, rows)
            if not free(x, y, a, space):
                continue
            if kind == 0:
                kept[len(placed)] = x, y, a
                placed.append((x, y, a, 0, -1, np.nan))
                break
            gap = rng.uniform(*gaps) if kind == 1 else 0.0
            angle = rng.uniform(0, 2 * np.pi)
            x2, y2 = x + (a + b + gap) * np.cos(angle), y + (a + b + gap) * np.sin(angle)
            if free(x2, y2, b, space):
                kept[len(placed) : len(placed) + 2] = (x, y, a), (x2, y2, b)
                placed += [(x, y, a, kind, number, gap), (x2, y2, b, kind, number, gap)]
                break
    return pd.DataFrame(placed, columns=["x_px", "y_px", "radius_px", "kind", "pair_id", "gap_px"])


def match(truth, disks, *, reach=1.0):
    """Index pairs (truth, disk), nearest first, one to one, centres closer than max(``reach``, 0.5 a)."""
    from scipy.spatial import cKDTree

    if not len(truth) or not len(disks):
        return np.empty((0, 2), int)
    a = truth.radius_px.to_numpy()
    limit = np.maximum(reach, 0.5 * a)
    tree = cKDTree(disks[["x_px", "y_px"]].to_numpy())
    points = truth[["x_px", "y_px"]].to_numpy()
    candidates = [
        (np.hypot(*(tree.data[j] - points[i])) / limit[i], i, j)
        for i in range(len(truth))
        for j in tree.query_ball_point(points[i], limit[i])
        if 0.5 < disks.radius_px.iloc[j] / a[i] < 2
    ]
    used_i, used_j, pairs = set(), set(), []
    for _, i, j in sorted(candidates):
        if i not in used_i and j not in used_j:
            used_i.add(i)
            used_j.add(j)
            pairs.append((i, j))
    return np.array(pairs, int).reshape(-1, 2)
