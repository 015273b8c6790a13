"""Frames whose edges, contrast or camera depart from blurred uniform disks, made without `contactimg`.

Contacts are painted four times finer than the pixels, blurred there by a sampled point spread function, and
averaged over pixels; noise, texture and reference are those of `contact_frames`.
"""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
from contact_frames import Optics, expose, scatter, sub_pixel_shift, surface_texture

FINE = 4
SHAPE = (600, 800)
OPTICS = Optics(shape=SHAPE, dust=0)


def pupil_psf(sigma_px, phase, aperture=None, size=129):
    """Point spread function of a pupil with a phase (waves) on the fine grid; ``sigma_px`` of its core."""
    # the Airy core of f-number N has sigma = 0.45 lambda N: a pupil of radius rho has lambda N = size/(2 rho)
    rho = size / (2 * sigma_px * FINE / 0.45)
    v, u = np.mgrid[:size, :size] - size // 2
    r, angle = np.hypot(u, v) / rho, np.arctan2(v, u)
    inside = (r <= 1) & (r >= (aperture or 0.0))
    field = np.where(inside, np.exp(2j * np.pi * phase(r, angle)), 0)
    psf = np.abs(np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(field)))) ** 2
    return (psf / psf.sum()).astype(np.float32)


def disk_psf(radius_px):
    """Defocus: a uniform disk, on the fine grid."""
    half = int(radius_px * FINE) + 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    psf = np.clip(radius_px * FINE + 0.5 - np.hypot(x, y), 0, 1)
    return (psf / psf.sum()).astype(np.float32)


def paint(truth, *, profile, reach, weight, shape=SHAPE, ratios=None, angles=None):
    """Sum of ``weight * profile(r, a)`` (px) on the fine grid, the larger value where contacts overlap.

    ``ratios`` and ``angles`` of the half-axes make ellipses of the same area; r is then that of the circle.
    """
    ratios, angles = (np.full(len(truth), 1.0) if part is None else part for part in (ratios, angles))
    rows, columns = shape
    fine = np.zeros((rows * FINE, columns * FINE), np.float32)
    contacts = zip(truth.x_px, truth.y_px, truth.radius_px, weight, ratios, angles, strict=True)
    for x, y, a, w, ratio, angle in contacts:
        stretch = np.sqrt(ratio)
        cx, cy, far = (x + 0.5) * FINE - 0.5, (y + 0.5) * FINE - 0.5, stretch * (a + reach(a)) * FINE + 2
        x0, x1 = max(int(cx - far), 0), min(int(cx + far) + 2, columns * FINE)
        y0, y1 = max(int(cy - far), 0), min(int(cy + far) + 2, rows * FINE)
        dx, dy = np.arange(x0, x1) - cx, (np.arange(y0, y1) - cy)[:, None]
        along, across = dx * np.cos(angle) + dy * np.sin(angle), dy * np.cos(angle) - dx * np.sin(angle)
        r = np.hypot(along / stretch, across * stretch) / FINE
        patch = fine[y0:y1, x0:x1]
        np.maximum(patch, (w * profile(r, a)).astype(np.float32), out=patch)
    return fine


def hard(r, a):
    return np.clip((a - r) * FINE + 0.5, 0, 1)


def gaussian(fine, sigma_px):
    return cv2.GaussianBlur(fine, (0, 0), sigma_px * FINE, borderType=cv2.BORDER_REPLICATE)


def binned(fine):
    rows, columns = (size // FINE for size in fine.shape)
    return fine.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3))


def varying_blur(fine, low, high):
    """Blur that grows from the left to the right border."""
    levels = np.linspace(low, high, 6)
    place = np.linspace(0, 5, fine.shape[1])
    total = np.zeros_like(fine)
    for k, sigma in enumerate(levels):
        total += gaussian(fine, sigma) * np.clip(1 - np.abs(place - k), 0, 1).astype(np.float32)
    return total


def dome(depth):
    """Brighter in the middle by ``depth`` (negative: at the rim), mean over the disk 1."""
    return lambda r, a: hard(r, a) * (1 + depth * (0.5 - np.minimum(r / a, 1) ** 2))


def coma_psf(waves, sigma_px):
    return pupil_psf(sigma_px, lambda r, angle: waves * (3 * r**3 - 2 * r) * np.cos(angle))


CASES = {
    "plain": {},
    "gamma": {"gamma": 0.45},
    "defocus": {"psf": lambda: disk_psf(2.8)},
    "defocus_weak": {"psf": lambda: disk_psf(1.8), "then": 0.8},
    "annular": {"psf": lambda: pupil_psf(1.2, lambda r, _: 0 * r, aperture=0.6)},
    "coma": {"psf": lambda: coma_psf(0.2, 1.2)},
    "soft": {
        "profile": lambda r, a: np.clip((a - r) / (0.3 * a) + 0.5, 0, 1), "reach": lambda a: 0.3 * a
    },
    "small_dim": {"trend": -0.15},
    "small_bright": {"trend": 0.15},
    "dome": {"profile": dome(0.2)},
    "bowl": {"profile": dome(-0.2)},
    "rim": {
        "profile": lambda r, a: np.maximum(hard(r, a), np.clip(1 - (r - a) / (0.1 * a), 0, 1) * (r > a)),
        "reach": lambda a: 0.1 * a,
    },
    "blur_field": {"blur": lambda fine: varying_blur(fine, 1.0, 2.0)},
    "interlaced": {"interlaced": 2.0},
    "saturated": {"full_scale": 160.0},
    "airy": {"psf": lambda: pupil_psf(1.4, lambda r, _: 0 * r)},
}  # fmt: skip


def edge_frame(case, *, seed, n=150, optics=OPTICS, radii=(2.0, 30.0), film=None, ratio=1.0):
    """Frame, reference and truth of one case of `CASES`; ``film(distance_px, a)`` is an excess outside.

    ``ratio`` of the half-axes makes ellipses of any orientation.
    """
    rng = np.random.default_rng(seed)
    keys = CASES[case]
    truth = scatter(n, optics, rng, radii=radii)
    profile, reach = keys.get("profile", hard), keys.get("reach", lambda a: 0.0)
    if film is not None:
        profile, reach = (lambda r, a: np.maximum(hard(r, a), (r > a) * film(r - a, a))), lambda a: 12.0
    weight = 1 + keys.get("trend", 0.0) * np.exp(-truth.radius_px.to_numpy() / 5.0)
    turned = {}
    if ratio != 1.0:
        turned = {"ratios": np.full(len(truth), ratio), "angles": rng.uniform(0, np.pi, len(truth))}
    fine = paint(truth, profile=profile, reach=reach, weight=weight, shape=optics.shape, **turned)
    if "blur" in keys:
        fine = keys["blur"](fine)
    elif "psf" in keys:
        fine = cv2.filter2D(fine, -1, keys["psf"]()[::-1, ::-1], borderType=cv2.BORDER_REPLICATE)
        fine = gaussian(fine, keys["then"]) if "then" in keys else fine
    else:
        fine = gaussian(fine, optics.sigma)
    cover = binned(fine)
    if "interlaced" in keys:
        moved = sub_pixel_shift(cover, keys["interlaced"], 0.0)
        cover[1::2] = moved[1::2]
    full_scale = keys.get("full_scale", optics.full_scale)
    frame, reference = expose_pair(cover, replace(optics, full_scale=full_scale), rng)
    if "gamma" in keys:
        frame, reference = (encode(image, keys["gamma"], rng) for image in (frame, reference))
    return frame, reference, truth


def expose_pair(cover, optics, rng):
    """Camera frame and reference of a coverage."""
    rows, columns = optics.shape
    yy, xx = np.mgrid[0:rows, 0:columns]
    u, v = (xx - (columns - 1) / 2) / columns, (yy - (rows - 1) / 2) / columns
    light = optics.level * (1 - optics.vignetting * (u**2 + v**2) / (0.25 + 0.25 * (rows / columns) ** 2))
    texture = surface_texture(optics, rng)
    crop = (slice(16, 16 + rows), slice(16, 16 + columns))
    moved = sub_pixel_shift(texture, -optics.shift[0], -optics.shift[1])[crop]
    frame = light * (1 + texture[crop]) * (1 + optics.contrast * cover)
    reference = light / optics.gain * (1 + moved)
    return expose(frame, optics, rng), expose(reference, optics, rng)


def encode(image, gamma, rng):
    """8-bit image of a camera with a gamma, from a linear one (whose own steps are dithered away)."""
    linear = np.clip(image + rng.uniform(-0.5, 0.5, image.shape), 0, 255)
    return np.rint(255 * (linear / 255) ** gamma).astype(np.uint8)


def errors(truth: pd.DataFrame, disks: pd.DataFrame):
    """Indices of matched pairs, errors of the radii in px."""
    from contact_frames import match

    pairs = match(truth, disks)
    error = disks.radius_px.to_numpy()[pairs[:, 1]] - truth.radius_px.to_numpy()[pairs[:, 0]]
    return pairs, error
