"""Frames of disks that differ from what the method "disk" assumes: optics, camera, contacts or reference."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from contact_frames import Optics, expose, scatter, sub_pixel_shift, surface_texture

K = 4
"""Fine grid: points for one pixel each way."""
Grid = np.ndarray


def disk(r, theta, a):
    """Uniform, with a rim anti-aliased over one point of the fine grid."""
    return np.clip((a - r) * K + 0.5, 0, 1)


def dome(r, theta, a):
    return disk(r, theta, a) * (1 + 0.2 * np.clip(1 - (r / a) ** 2, 0, 1))


def bowl(r, theta, a):
    return disk(r, theta, a) * (1 + 0.2 * np.clip(r / a, 0, 1) ** 2)


def holed(r, theta, a):
    """A hole off the centre, a tenth of the area."""
    x, y = r * np.cos(theta) - 0.4 * a, r * np.sin(theta)
    return disk(r, theta, a) * (1 - disk(np.hypot(x, y), theta, np.sqrt(0.1) * a))


def rimmed(r, theta, a):
    """With a rim half as bright outside, a tenth of the radius wide."""
    return disk(r, theta, a) + 0.5 * (disk(r, theta, 1.1 * a) - disk(r, theta, a))


def soft(r, theta, a):
    return np.clip((a - r) / (0.3 * a) + 0.5, 0, 1)


def ellipse(r, theta, a):
    """Half-axes 1.3 : 1, with the area of the disk."""
    stretch = np.sqrt(1.3)
    return disk(np.hypot(r * np.cos(theta) / stretch, r * np.sin(theta) * stretch), theta, a)


def small_dim(r, theta, a):
    return disk(r, theta, a) * (0.85 if a < 6 else 1.0)


def cover(truth, shape, paint: Callable[[Grid, Grid, float], Grid]):
    """The contacts on the fine grid, as a factor of the contrast."""
    fine = np.zeros((shape[0] * K, shape[1] * K), np.float32)
    for x, y, a in truth[["x_px", "y_px", "radius_px"]].itertuples(index=False):
        reach = 1.6 * a + 2
        left, right = max(int((x - reach) * K), 0), min(int((x + reach + 1) * K), fine.shape[1])
        top, bottom = max(int((y - reach) * K), 0), min(int((y + reach + 1) * K), fine.shape[0])
        dx = (np.arange(left, right) + 0.5) / K - 0.5 - x
        dy = ((np.arange(top, bottom) + 0.5) / K - 0.5 - y)[:, None]
        patch = paint(np.hypot(dx, dy), np.arctan2(dy, dx), a)
        part = fine[top:bottom, left:right]
        np.maximum(part, patch.astype(np.float32), out=part)
    return fine


def gaussian(fine, sigma=1.4):
    return cv2.GaussianBlur(fine, (0, 0), sigma * K)


def defocused(fine):
    """Behind a uniform disk of 3 px radius and a little blur."""
    y, x = np.mgrid[-3 * K : 3 * K + 1, -3 * K : 3 * K + 1]
    kernel = (np.hypot(x, y) <= 3 * K).astype(np.float32)
    return gaussian(cv2.filter2D(fine, -1, kernel / kernel.sum()), 0.6)


def coma(fine):
    """A bright core with a tail to one side."""
    out = 0.5 * gaussian(fine, 1.0)
    for step, share in ((1.0, 0.2), (2.0, 0.15), (3.2, 0.1), (4.5, 0.05)):
        moved = np.roll(fine, round(step * K), axis=1)
        out += share * gaussian(moved, 0.8 + 0.4 * step)
    return out


def varying(fine):
    """Blur from 1.0 px on the left to 2.0 px on the right."""
    share = np.linspace(0, 1, fine.shape[1], dtype=np.float32)
    return (1 - share) * gaussian(fine, 1.0) + share * gaussian(fine, 2.0)


def ghosts(optics, rng):
    """Fifteen contacts of another place, as the reference shows them."""
    other = scatter(15, optics, rng, radii=(6, 25), pairs=0, touching=0)
    return gaussian(cover(other, optics.shape, disk))


CASES: dict[str, dict] = {
    "as assumed": {},
    "gamma": {"response": lambda light: 255 * (light / 255) ** 0.45},
    "dim reference": {"reference": lambda u, v: 0.8 * (1 + 0.1 * u)},
    "holes": {"paint": holed},
    "ellipses": {"paint": ellipse},
    "soft in proportion": {"paint": soft},
    "small ones dim": {"paint": small_dim},
    "dome": {"paint": dome},
    "bowl": {"paint": bowl},
    "bright rim": {"paint": rimmed},
    "defocus": {"psf": defocused},
    "coma": {"psf": coma},
    "varying blur": {"psf": varying},
    "interlaced": {"interlaced": True},
    "gradient 12 %": {"light": lambda u, v: 1 + 0.24 * u},
    "vignette moved": {"light": lambda u, v: 1 - 0.8 * (u - 0.3) ** 2 - 0.8 * v**2},
    "saturated": {"response": lambda light: np.minimum(1.75 * light, 255)},
    "ghosts": {"ghosts": True},
    "row noise": {"row_noise": 1.5},
    "wrong reference": {"other_surface": True},
}


def degraded_pair(name, truth, optics: Optics, seed):
    """Frame and reference of a case."""
    case, rng = CASES[name], np.random.default_rng(seed)
    rows, columns = optics.shape
    yy, xx = np.mgrid[0:rows, 0:columns]
    u, v = (xx - (columns - 1) / 2) / columns, (yy - (rows - 1) / 2) / columns
    fine = case.get("psf", gaussian)(cover(truth, optics.shape, case.get("paint", disk)))
    seen = fine.reshape(rows, K, columns, K).mean(axis=(1, 3))
    if case.get("interlaced"):
        seen[1::2] = np.roll(seen[1::2], 2, axis=1)
    texture = surface_texture(optics, rng)
    crop = (slice(16, 16 + rows), slice(16, 16 + columns))
    moved = sub_pixel_shift(texture, 0.4, -0.3)[crop]
    if case.get("other_surface"):
        moved = surface_texture(replace(optics, texture=0.05), rng)[crop]
    light = optics.level * (1 - optics.vignetting * (u**2 + v**2) / 0.4)
    frame = (
        light * case.get("light", lambda u, v: 1.0)(u, v) * (1 + texture[crop]) * (1 + optics.contrast * seen)
    )
    reference = light / optics.gain * (1 + moved) * case.get("reference", lambda u, v: 1.0)(u, v)
    if case.get("ghosts"):
        fine = ghosts(optics, rng)
        reference = reference * (1 + optics.contrast * fine.reshape(rows, K, columns, K).mean(axis=(1, 3)))
    respond = case.get("response", lambda light: light)
    frame = respond(frame) + case.get("row_noise", 0.0) * rng.standard_normal((rows, 1))
    return expose(frame, optics, rng), expose(respond(reference), optics, rng)
