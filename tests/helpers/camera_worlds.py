"""Rendered frames of contacts in many kinds of camera, light, optics and surface, with exact truth.

The renderer shares nothing with `contactimg`. Contacts are painted on a grid of quarter pixels with smooth
rims, averaged to half pixels, blurred there by the point spread function and averaged over each pixel. The
light of a pixel is ``level * V * (1 + T) * (1 + C c)`` with the illumination V, the texture of the surface T,
the relative contrast C and the blurred coverage c; the reference has no c, and its texture is shifted by a
fraction of a pixel. Shot noise, read noise, response, quantisation and what the file went through follow.

A world is a `World` (what differs from the plain one) in `WORLDS`; ``make_scene(world, count, seed)`` renders
it.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
import pandas as pd
import scipy.fft

PAINT = 4
"""Points of the painted grid in a pixel, each way."""
BLUR = 2
"""Points of the blurred grid in a pixel, each way."""
MARGIN = 24
"""Pixels rendered beyond the frame."""
BORDER = 30
"""Width of a black border, px."""
SHAPES = {25: (300, 400), 140: (600, 800), 450: (900, 1200)}
"""Rows and columns for a number of contacts."""
SMALLEST_PX, SMALLEST_PART, FAINTEST = 1.2, 0.5, 8.0
"""A contact counts as visible above this radius, share inside the frame and signal over noise."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A frame, its reference or None, and the contacts on it.

    ``truth`` has a row for each contact: x_px, y_px, radius_px (of the disk of equal area), brightness (1: as
    most), area_px2 (whole), visible (share inside the frame), snr, odd (the contact that the world is about),
    required (a measurement must find it).
    """

    frame: np.ndarray
    reference: np.ndarray | None
    truth: pd.DataFrame
    full_scale: float | None = None
    polarity: str = "auto"


def nothing(*_arguments):
    """Leave everything as it is."""


def unchanged(image):
    return image


# ---------------------------------------------------------------------------------------- optics


def gaussian(sigma):
    """Blur by a Gaussian of standard deviation ``sigma`` px, less what averaging to half pixels adds."""
    width = np.sqrt(sigma**2 - 1 / (12 * BLUR**2)) * BLUR
    return lambda fine: cv2.GaussianBlur(fine, (0, 0), width, borderType=cv2.BORDER_REPLICATE)


BLURRED = gaussian(1.4)


def mixed(*parts):
    """Sum of Gaussians: (share, sigma) or (share, sigma, place in x) each; the centroid stays."""
    total = sum(part[0] for part in parts)
    centre = sum(part[0] * part[2] for part in parts if len(part) > 2) / total

    def blur(fine):
        out = np.zeros_like(fine)
        for share, sigma, *place in parts:
            dx = (place[0] if place else 0.0) - centre
            move = np.float32([[1, 0, dx * BLUR], [0, 1, 0]])
            moved = cv2.warpAffine(fine, move, fine.shape[::-1]) if dx else fine
            out += np.float32(share / total) * gaussian(sigma)(moved)
        return out

    return blur


def kernel(profile, reach, sigma=0.6):
    """Convolution with ``profile(r)``, r in px up to ``reach``, and a Gaussian."""
    y, x = np.mgrid[-reach * BLUR : reach * BLUR + 1, -reach * BLUR : reach * BLUR + 1] / BLUR
    values = np.asarray(profile(np.hypot(x, y)), np.float32)
    values /= values.sum(dtype=float)
    sharp = gaussian(sigma)
    return lambda fine: sharp(cv2.filter2D(fine, -1, values, borderType=cv2.BORDER_REPLICATE))


def pillbox(radius):
    return kernel(lambda r: np.clip((radius - r) * BLUR + 0.5, 0, 1), int(radius) + 1)


def moffat(width, power):
    return kernel(lambda r: (1 + (r / width) ** 2) ** -power, MARGIN)


def across(first, last, steps=12):
    """Gaussian blur that grows from ``first`` px at the left to ``last`` px at the right."""

    def blur(fine):
        out = gaussian(first)(fine)
        sigma = np.linspace(first, last, fine.shape[1])
        levels = np.linspace(first**2, last**2, steps)
        place = np.interp(sigma**2, levels, np.arange(steps))
        result = np.zeros_like(fine)
        for k, level in enumerate(levels):
            share = np.clip(1 - np.abs(place - k), 0, 1).astype(np.float32)
            columns = np.flatnonzero(share)
            part = np.s_[:, max(columns[0] - 40, 0) : columns[-1] + 41]
            more = np.sqrt(max(level - first**2, 1e-6)) * BLUR
            result[part] += share[part[1]] * cv2.GaussianBlur(out[part], (0, 0), more)
        return result

    return blur


# ------------------------------------------------------------------------- the air film outside a contact


def spectrum(light):
    """Wavelengths, um, and weights: a laser line, a band of 20 nm, a white light-emitting diode."""
    if light == "laser":
        return np.array([0.56]), np.array([1.0])
    wave = np.linspace(0.45, 0.68, 231) if light == "white" else np.linspace(0.53, 0.59, 121)
    width = 0.07 if light == "white" else 0.020 / (2 * np.sqrt(np.log(2)))
    weight = np.exp(-(((wave - 0.56) / width) ** 2))
    return wave, weight / weight.sum()


def film_reflectance(phase, front=1.52, back=1.41):
    """Of an air film between two solids, at normal incidence."""
    r12, r23 = (front - 1) / (front + 1), (1 - back) / (1 + back)
    both = 2 * r12 * r23 * np.cos(phase)
    return (r12**2 + r23**2 + both) / (1 + r12**2 * r23**2 + both)


@lru_cache(maxsize=4)
def film_excess(light):
    """Transmitted light over a gap (um), 1 in contact and 0 for a wide film, as a table."""
    wave, weight = spectrum(light)
    gap = np.linspace(0, 12, 12001)
    reflected = sum(w * film_reflectance(4 * np.pi * gap / one) for one, w in zip(wave, weight, strict=True))
    far = film_reflectance(np.linspace(0, 2 * np.pi, 1000, endpoint=False)).mean()
    return gap, (far - reflected) / (far - film_reflectance(0.0))


def hertz_gap(r, a, sphere):
    """Gap outside a Hertz contact of radius a, exact."""
    t = np.minimum(a / r, 1.0)
    raised = ((2 * a**2 - r**2) * np.arcsin(t) + r * a * np.sqrt(1 - t**2)) / (np.pi * sphere)
    return r**2 / (2 * sphere) - a**2 / sphere + raised


def fringes(a, light, pixel_um, sphere_um=100.0):
    """Excess at r (px) from the centre, averaged over a point of the painted grid, and its reach."""
    wave, _ = spectrum(light)
    r = np.arange(a, a + 60, 0.01)
    gap = hertz_gap(r * pixel_um, a * pixel_um, sphere_um)
    period = wave.mean() / 2 / np.maximum(np.gradient(gap, r), 1e-9)
    excess = np.interp(gap, *film_excess(light)) * np.clip((period - 1.2) / 0.6, 0, 1)
    seen = np.flatnonzero(np.abs(excess) > 1e-3)
    reach = float(r[min(seen[-1] + 50, len(r) - 1)])
    r, excess = np.r_[0, r], np.r_[1.0, excess]
    total = np.r_[0, np.cumsum((excess[1:] + excess[:-1]) / 2 * np.diff(r))]
    half = 0.5 / PAINT

    def average(distance):
        return (np.interp(distance + half, r, total) - np.interp(distance - half, r, total)) / (2 * half)

    return average, reach


# --------------------------------------------------------------------------------------- contacts


def log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


@dataclass(frozen=True)
class Layout:
    """How contacts lie; lengths in px, shares of their number.

    ``pairs`` of them are close (gap 0.5 to 2), ``touching`` of them touch, ``cut`` of them lie across the
    border; they cover the share ``covered`` of the frame if that is given. ``region(x, y, a, shape)`` says
    where they may be.
    """

    radii: tuple[float, float] = (1.5, 20.0)
    pairs: float = 0.06
    touching: float = 0.0
    cut: float = 0.0
    covered: float | None = None
    space: float = 5.0
    region: Callable = lambda x, y, a, shape: np.full(np.shape(x), fill_value=True)
    shape: tuple[int, int] | None = None
    lattice: float = 0.0

    def place(self, count, rng):
        """The shape of the frame and the contacts x, y, a."""
        a = log_uniform(rng, *self.radii, count)
        shape = self.shape or frame_shape(count)
        if self.covered:
            rows = np.sqrt(0.75 * np.pi * np.sum(a**2) / self.covered)
            shape = round(rows), round(rows / 0.75)
        if self.lattice:
            return self._on_lattice(a, rng)
        number = [round(count * share / 2) for share in (self.pairs, self.touching)]
        gaps = [*rng.uniform(0.5, 2.0, number[0]), *np.zeros(number[1])]
        units = [(a[2 * i], a[2 * i + 1], gap) for i, gap in enumerate(gaps)]
        units += [(one, 0.0, 0.0) for one in a[2 * len(gaps) :]]
        border = rng.random(len(units)) < self.cut
        placed = np.empty((0, 3))
        for i in sorted(range(len(units)), key=lambda i: -units[i][0] - units[i][1]):
            placed = np.vstack([placed, self._fit_in(units[i], placed, shape, rng, across=border[i])])
        return shape, placed

    def _fit_in(self, unit, placed, shape, rng, *, across):
        """A contact or a pair where nothing else is; nothing if there is no room."""
        a, b, gap = unit
        rows, columns = shape
        for _ in range(60):
            x, y = rng.uniform(0, columns - 1, 300), rng.uniform(0, rows - 1, 300)
            if across:
                side, offset = rng.integers(0, 4, 300), rng.uniform(-0.8, 0.8, 300) * a
                x = np.select([side == 0, side == 1], [offset, columns - 1 + offset], x)
                y = np.select([side == 2, side == 3], [offset, rows - 1 + offset], y)
            angle = rng.uniform(0, 2 * np.pi, 300)
            both = [(x, y, a)]
            if b:
                reach = a + b + gap
                both.append((x + reach * np.cos(angle), y + reach * np.sin(angle), b))
            good = np.full(300, fill_value=True)
            for cx, cy, c in both:
                edge = -np.inf if across else c + 4.0
                good &= (cx >= edge) & (cx <= columns - 1 - edge) & (cy >= edge) & (cy <= rows - 1 - edge)
                good &= self.region(cx, cy, c, shape)
                apart = np.hypot(cx[:, None] - placed[:, 0], cy[:, None] - placed[:, 1]) - placed[:, 2]
                good &= np.all(apart > c + self.space, axis=1)
            if good.any():
                k = int(np.argmax(good))
                return np.array([(cx[k], cy[k], c) for cx, cy, c in both])
        return np.empty((0, 3))

    def _on_lattice(self, a, rng):
        """A square lattice with a broad empty border."""
        columns = int(np.ceil(np.sqrt(len(a) * 4 / 3)))
        rows = int(np.ceil(len(a) / columns))
        i, j = np.divmod(np.arange(len(a)), columns)
        place = (np.stack([j, i]) + 3.0) * self.lattice + rng.uniform(-1, 1, (2, len(a)))
        shape = int((rows + 5) * self.lattice), int((columns + 5) * self.lattice)
        return shape, np.stack([*place, a], axis=1)


def frame_shape(count):
    rows = 600 * np.sqrt(max(count, 20) / 140)
    return SHAPES.get(count, (round(rows), round(rows / 0.75)))


def visible_share(x, y, a, shape):
    """Share of the area of each disk that is inside the frame."""
    x, y, a = (np.asarray(v, float)[:, None] for v in (x, y, a))
    t = (np.arange(400) + 0.5) / 200 - 1
    half = np.sqrt(1 - t**2)
    inside = (x + a * t >= -0.5) & (x + a * t <= shape[1] - 0.5)
    top, bottom = np.clip(y - a * half, -0.5, shape[0] - 0.5), np.clip(y + a * half, -0.5, shape[0] - 0.5)
    return np.sum(inside * (bottom - top), axis=1) / np.sum(2 * a * half, axis=1)


# Interiors: brightness at dx, dy (px, arrays on the painted grid) inside a contact of radius a, and net area.


def uniform(dx, dy, a, rng):
    return 1.0, 1.0


def dome(dx, dy, a, rng):
    return 1 - 0.2 * np.minimum((dx**2 + dy**2) / a**2, 1), 1.0


def bowl(dx, dy, a, rng):
    return 1 + 0.2 * np.minimum((dx**2 + dy**2) / a**2, 1), 1.0


def mottled(amplitude, correlation):
    """Random brightness of standard deviation ``amplitude``, correlated over some px."""

    def inside(dx, dy, a, rng):
        width = correlation * PAINT
        noise = rng.standard_normal(np.broadcast(dx, dy).shape, np.float32)
        smooth = cv2.GaussianBlur(noise, (0, 0), width) * (2 * np.sqrt(np.pi) * width)
        return np.maximum(1 + amplitude * smooth, 0), 1.0

    return inside


def pierced(dx, dy, a, rng):
    """Contacts above 5 px have a hole of 0.3 of their radius."""
    if a < 5:
        return 1.0, 1.0
    angle, hole = rng.uniform(0, 2 * np.pi), 0.3 * a
    distance = np.hypot(dx - 0.4 * a * np.cos(angle), dy - 0.4 * a * np.sin(angle))
    return np.clip((distance - hole) * PAINT + 0.5, 0, 1), 1 - 0.3**2


# Alterations of the table of contacts, in place.


def scaled(share, factor):
    """A ``share`` of the contacts has another brightness, a number or a range."""

    def alter(truth, rng):
        which = rng.permutation(len(truth))[: round(share * len(truth))]
        truth.loc[which, "brightness"] = rng.uniform(*factor, len(which)) if np.ndim(factor) else factor

    return alter


def spread(std):
    def alter(truth, rng):
        truth["brightness"] = np.clip(1 + std * rng.standard_normal(len(truth)), 0.25, 1.9)

    return alter


def odd_one(factor):
    """One contact of about 9 px has another brightness."""

    def alter(truth, rng):
        k = int(np.argmin(np.abs(truth.radius_px - 9)))
        truth.loc[k, "odd"] = True
        truth.loc[k, "brightness"] = factor

    return alter


def stretched(ratio):
    def alter(truth, rng):
        truth["aspect"] = ratio
        truth["angle"] = rng.uniform(0, np.pi, len(truth))

    return alter


def paint_contacts(truth, shape, world, rng):
    """Brightness on the painted grid, with the margin; sets the net area of each contact."""
    fine = np.zeros([(n + 2 * MARGIN) * PAINT for n in shape], np.float32)
    if world.fringes:
        for x, y, a, factor in truth[["x_px", "y_px", "radius_px", "brightness"]].itertuples(index=False):
            average, reach = fringes(a, *world.fringes)
            part, dx, dy = _patch(fine, x, y, reach)
            part += np.float32(factor) * average(np.hypot(dx, dy)).astype(np.float32)
    net = np.ones(len(truth))
    for i, (x, y, a, factor, aspect, angle) in enumerate(
        truth[["x_px", "y_px", "radius_px", "brightness", "aspect", "angle"]].itertuples(index=False)
    ):
        # a ramp of width w over the rim has the area of the disk of a^2 + w^2 / 12
        long, short = np.sqrt(a**2 - 1 / (12 * PAINT**2)) * np.sqrt([aspect, 1 / aspect])
        part, dx, dy = _patch(fine, x, y, long + 1)
        if not part.size:
            continue
        p, q = dx * np.cos(angle) + dy * np.sin(angle), dy * np.cos(angle) - dx * np.sin(angle)
        s = np.maximum(np.hypot(p / long, q / short), 1e-9)
        slope = np.maximum(np.hypot(p / long**2, q / short**2), 1e-9) / s
        cover = np.clip((1 - s) / slope * PAINT + 0.5, 0, 1)
        inside, net[i] = world.interior(dx, dy, a, rng)
        part += (cover * (factor * inside - part)).astype(np.float32)
    truth["area_px2"] = np.pi * truth.radius_px**2 * net
    truth["radius_px"] *= np.sqrt(net)
    return fine


def _patch(fine, x, y, reach):
    """A view of the grid around a place, and the distances from it, px."""
    centre = [(v + MARGIN + 0.5) * PAINT - 0.5 for v in (y, x)]
    spans = []
    for c, size in zip(centre, fine.shape, strict=True):
        low, high = int(np.ceil(c - reach * PAINT)), int(np.floor(c + reach * PAINT)) + 1
        spans.append(slice(min(max(low, 0), size), min(max(high, 0), size)))
    dy, dx = ((np.arange(s.start, s.stop) - c) / PAINT for s, c in zip(spans, centre, strict=True))
    return fine[spans[0], spans[1]], dx[None, :], dy[:, None]


def blurred_cover(fine, psf):
    """The painted grid as the pixels of the frame see it."""
    half = cv2.resize(fine, None, fx=BLUR / PAINT, fy=BLUR / PAINT, interpolation=cv2.INTER_AREA)
    seen = psf(half)
    seen = cv2.resize(seen, None, fx=1 / BLUR, fy=1 / BLUR, interpolation=cv2.INTER_AREA)
    return seen[MARGIN:-MARGIN, MARGIN:-MARGIN]


# ------------------------------------------------------------------------------- surface and light


def surface(shape, rms, rng, *, dusty=True):
    """Texture in two sizes and dark dust, as a function that gives it moved by (dx, dy) px."""
    rows, columns = (scipy.fft.next_fast_len(n + 16, real=True) for n in shape)
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)).astype(np.float32)
    power = 0.0
    for sigma, share in ((1.7, 0.75), (8.0, 0.25)):
        part = np.exp(-((2 * np.pi * sigma * frequency) ** 2))
        power = power + share / (part.mean()) * part
    noise = rng.standard_normal((rows, columns), np.float32)
    waves = scipy.fft.rfft2(noise) * np.sqrt(power) * np.float32(rms)
    number = round(shape[0] * shape[1] / 25_000) if dusty else 0
    dust = random_spots(shape, rng, number, (0.8, 2.5), (-0.3, -0.05))

    def moved(dx, dy):
        phase = np.fft.rfftfreq(columns) * dx + np.fft.fftfreq(rows)[:, None] * dy
        field_ = scipy.fft.irfft2(waves * np.exp(-2j * np.pi * phase).astype(np.complex64), (rows, columns))
        field_ = np.ascontiguousarray(field_[: shape[0], : shape[1]])
        return draw_spots(field_, dust + np.array([dx, dy, 0, 0]))

    return moved


def random_spots(shape, rng, number, sizes, heights):
    """Rows x, y, standard deviation, height."""
    return np.stack(
        [
            rng.uniform(0, shape[1], number),
            rng.uniform(0, shape[0], number),
            rng.uniform(*sizes, number),
            rng.uniform(*heights, number),
        ],
        axis=1,
    )


def draw_spots(image, spots):
    """Add Gaussian spots."""
    for x, y, size, height in spots:
        reach = int(4 * size) + 2
        left, top = max(int(x) - reach, 0), max(int(y) - reach, 0)
        part = image[top : max(int(y) + reach + 1, 0), left : max(int(x) + reach + 1, 0)]
        gx = np.exp(-(((np.arange(part.shape[1]) + left - x) / size) ** 2) / 2)
        gy = np.exp(-(((np.arange(part.shape[0]) + top - y) / size) ** 2) / 2)
        part += (height * gy[:, None] * gx).astype(np.float32)
    return image


def moved_dust(shape, rng):
    """Dark specks, and bright ones sharper than the optics, of the frame alone."""
    number = max(round(shape[0] * shape[1] / 12_000), 6)
    dark = random_spots(shape, rng, number, (0.8, 2.5), (-0.5, -0.1))
    bright = random_spots(shape, rng, number // 2, (0.4, 0.5), (0.3, 1.0))
    return draw_spots(np.zeros(shape, np.float32), np.vstack([dark, bright]))


def dirt(shape, rng):
    """Specks of both signs and scratches on a plate."""
    number = round(shape[0] * shape[1] / 1500)
    image = draw_spots(np.zeros(shape, np.float32), random_spots(shape, rng, number, (0.6, 1.6), (-0.3, 0.4)))
    lines = np.zeros(shape, np.float32)
    for _ in range(6):
        ends = rng.uniform(0, shape[1], 2), rng.uniform(0, shape[0], 2)
        (x, x2), (y, y2) = np.rint(ends).astype(int)
        cv2.line(lines, (int(x), int(y)), (int(x2), int(y2)), float(rng.uniform(0.1, 0.3)), 1, cv2.LINE_AA)
    return image + cv2.GaussianBlur(lines, (0, 0), 0.8)


# Light over the frame, a factor; u and v go from -1 to 1, shape is the frame's.


def vignetting(u, v, shape):
    return 1 - 0.1 * (u**2 + v**2)


def stop_radius(shape):
    return 0.48 * min(shape)


def field_stop(u, v, shape):
    """A round stop of soft edge; a hundredth of the light outside."""
    r = np.hypot(u * shape[1] / 2, v * shape[0] / 2)
    return vignetting(u, v, shape) * (0.01 + 0.99 * np.clip((stop_radius(shape) - r) / 2 + 0.5, 0, 1))


def in_stop(x, y, a, shape):
    centre = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    return np.hypot(x - centre[0], y - centre[1]) + a + 5 < stop_radius(shape)


def image_circle(u, v, shape):
    """The circle that a lens lights, which ends slowly in the corners."""
    return vignetting(u, v, shape) / (1 + np.exp((np.hypot(u, v * shape[0] / shape[1]) - 0.96) * 7))


def black_border(u, v, shape):
    left, top = ((1 - np.abs(w)) * n / 2 for w, n in ((u, shape[1]), (v, shape[0])))
    return vignetting(u, v, shape) * np.where(np.minimum(left, top) > BORDER, 1.0, 0.01)


def in_border(x, y, a, shape):
    gap = BORDER + a + 5
    return (x > gap) & (x < shape[1] - gap) & (y > gap) & (y < shape[0] - gap)


def black_band(u, v, shape):
    return vignetting(u, v, shape) * np.where(v > -0.8, 1.0, 0.01)


def under_band(x, y, a, shape):
    return y > 0.1 * shape[0] + a + 5


def step(u, v, shape):
    return np.where(u + 0.2 * v > 0.1, 1.12, 1.0)


def gradient(u, v, shape):
    return 1 + 0.12 * u + 0.05 * v**2


def moved_lamp(u, v, shape):
    return 0.7 + 0.3 * u - 0.1 * v**2


def patch(u, v, shape):
    return np.where((np.abs(u + 0.3) < 0.35) & (np.abs(v - 0.2) < 0.4), 1.15, 1.0)


def plate(u, v, shape):
    """A round plate, lighter than the table, with a bright rim and a gradient."""
    r = np.hypot(u * shape[1] / 2, v * shape[0] / 2) / stop_radius(shape)
    return (0.5 + 0.5 * (r < 1) + 0.3 * np.exp(-(((r - 1) / 0.01) ** 2))) * (1 + 0.15 * u)


def bands(rows, rng):
    """Factor of each row by mains light and by a noisy amplifier."""
    wave = 0.03 * np.sin(2 * np.pi * np.arange(rows) / rng.uniform(25, 60) + rng.uniform(0, 6.3))
    return 1 + wave + 0.01 * rng.standard_normal(rows)


# ----------------------------------------------------------------------------------- camera and file


def s_curve(strength):
    """A tone curve steeper in the middle; ``strength`` 1 has no slope at the ends."""
    return lambda grey: grey - 255 * strength * np.sin(2 * np.pi * np.clip(grey, 0, 255) / 255) / (2 * np.pi)


def gamma(power):
    return lambda grey: 255 * (np.maximum(grey, 0) / 255) ** power


def jpeg(quality):
    def store(image):
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)

    return store


def clahe(image):
    return cv2.createCLAHE(2.0, (8, 8)).apply(image)


def white_margin(image):
    """A white frame drawn over the image where `in_border` allows no contact."""
    out = np.full_like(image, 255)
    out[BORDER:-BORDER, BORDER:-BORDER] = image[BORDER:-BORDER, BORDER:-BORDER]
    return out


def black_level(image):
    """The image by a camera whose black level lies at the background: half of its pixels are 0."""
    return cv2.subtract(image, np.full_like(image, 73))


def thresholded(image):
    """Two levels, by Otsu's threshold behind a Gaussian."""
    return cv2.threshold(cv2.GaussianBlur(image, (0, 0), 1), 0, 255, cv2.THRESH_OTSU)[1]


def dead_lines(image):
    """Dead and hot columns, a dead row, hot pixels; the same of each frame of a shape."""
    rng, out = np.random.default_rng(7), image.copy()
    columns = rng.permutation(image.shape[1])[:5]
    out[:, columns[:3]], out[:, columns[3:]] = 0, 255
    out[rng.integers(image.shape[0]), :] = 0
    out[rng.integers(0, image.shape[0], 30), rng.integers(0, image.shape[1], 30)] = 255
    return out


def hot_pixels(image):
    """Four pixels of a thousand black or at full scale, others in each frame."""
    rng, out = np.random.default_rng(zlib.crc32(image.tobytes())), image.copy()
    chance = rng.random(image.shape)
    out[chance < 0.002], out[chance > 0.998] = 0, 255
    return out


BAYER = np.array([[0.6, 1.0], [1.0, 0.75]])


# --------------------------------------------------------------------------------------- the renderer


@dataclass(frozen=True)
class World:
    """What is seen and with what; lengths in px, levels in grey levels of 8 bit.

    Parameters
    ----------
    layout : Layout
    alter : function(truth, rng)
        Changes brightness, aspect, angle of the contacts.
    interior : function(dx, dy, a, rng) -> (brightness, share of the area)
    fringes : (str, float) or None
        Light and um in a pixel: the air film around caps of 100 um radius.
    psf : function(half-pixel grid) -> the same, blurred
    light, own_light : function(u, v, shape) -> factor
        Of frame and reference; of the frame alone.
    specks : function(shape, rng) -> relative light added to the frame alone, or None
    texture, dusty, moves : float, bool, float
        Of the surface, rms; dark dust on it; both move with the sample, by up to ``moves`` px in x and y.
    same_surface : bool
        The reference shows the same part of the surface.
    level, contrast : float
        Background; plateau minus background (None: 45 to 80).
    electrons, read, noise_blur : float
        Electrons of a grey level, read noise in electrons, correlation length of the noise.
    gains : array or None
        Of the colour filters.
    rows : function(rows, rng) -> factor, or None
        New in each exposure.
    response : function(grey) -> grey
    file : function(image) -> image
        What was done to frame and reference before they were stored.
    scale : float
        Stored level of a grey level; above 1 in 16 bit.
    """

    layout: Layout = field(default_factory=Layout)
    alter: Callable = nothing
    interior: Callable = uniform
    fringes: tuple[str, float] | None = None
    psf: Callable = BLURRED
    light: Callable = vignetting
    own_light: Callable | None = None
    specks: Callable | None = None
    texture: float = 0.02
    dusty: bool = True
    moves: float = 0.5
    same_surface: bool = True
    level: float = 80.0
    contrast: float | None = None
    electrons: float = 20.0
    read: float = 10.0
    noise_blur: float = 0.0
    gains: np.ndarray | None = None
    rows: Callable | None = None
    response: Callable = unchanged
    file: Callable = unchanged
    scale: float = 1.0
    reference: bool = True
    full_scale: float | None = None
    polarity: str = "auto"

    def __call__(self, count, rng):
        """Render a scene."""
        shape, placed = self.layout.place(count, rng)
        truth = pd.DataFrame(placed, columns=["x_px", "y_px", "radius_px"])
        contrast = self.contrast if self.contrast is not None else rng.uniform(45, 80)
        truth = truth.assign(brightness=1.0, aspect=1.0, angle=0.0, odd=False)
        self.alter(truth, rng)
        truth["visible"] = visible_share(truth.x_px, truth.y_px, truth.radius_px, shape)
        cover = blurred_cover(paint_contacts(truth, shape, self, rng), self.psf)
        v, u = (np.linspace(-1, 1, n, dtype=np.float32) for n in shape)
        light = np.asarray(self.light(u[None, :], v[:, None], shape), np.float32) * self.level
        texture = surface(shape, self.texture, rng, dusty=self.dusty)
        frame = light * (1 + texture(0, 0)) * (1 + contrast / self.level * cover)
        if self.own_light:
            frame *= np.asarray(self.own_light(u[None, :], v[:, None], shape), np.float32)
        if self.specks:
            frame *= 1 + self.specks(shape, rng)
        if not self.same_surface:
            texture = surface(shape, self.texture, rng, dusty=self.dusty)
        reference = 0.98 * light * (1 + texture(*rng.uniform(-self.moves, self.moves, 2)))
        self._judge_visibility(truth, contrast)
        return Scene(
            self.expose(frame, rng),
            self.expose(reference, rng) if self.reference else None,
            truth,
            self.full_scale,
            self.polarity,
        )

    def noise_variance(self, light):
        return np.maximum(light, 0) / self.electrons + (self.read / self.electrons) ** 2

    def expose(self, light, rng):
        """The stored image of ``light``, grey levels."""
        if self.gains is not None:
            tiles = [-(-n // m) for n, m in zip(light.shape, self.gains.shape, strict=True)]
            light = light * np.tile(self.gains, tiles)[: light.shape[0], : light.shape[1]]
        if self.rows:
            light = light * self.rows(len(light), rng)[:, None]
        noise = rng.standard_normal(light.shape, np.float32)
        if self.noise_blur:
            noise = cv2.GaussianBlur(noise, (0, 0), self.noise_blur)
            noise /= noise.std()
        grey = self.response(light + np.sqrt(self.noise_variance(light)) * noise)
        full = np.rint(255 * self.scale) if self.scale == 1 else 256 * self.scale - 1
        dtype = np.uint8 if self.scale == 1 else np.uint16
        return self.file(np.clip(np.rint(grey * self.scale), 0, full).astype(dtype))

    def _judge_visibility(self, truth, contrast):
        """Signal over noise of a matched filter behind a blur of 1.4 px, and whether it must be found."""
        noise = np.sqrt((1 + self.reference) * (self.noise_variance(self.level) + 1 / 12))
        signal = np.abs(truth.brightness * contrast) * truth.area_px2
        truth["snr"] = signal / (noise * np.sqrt(truth.area_px2 + 4 * np.pi * 1.4**2))
        truth["required"] = (
            (truth.radius_px >= SMALLEST_PX) & (truth.visible > SMALLEST_PART) & (truth.snr >= FAINTEST)
        )


def flat(level, *, same=False):
    """Frame and reference without contact, all of one level or one exposure."""

    def render(count, rng):
        world = World(layout=Layout(pairs=0))
        empty = world(0, rng).truth
        shape = frame_shape(count)
        if same:
            image = world.expose(80 * (1 + surface(shape, 0.02, rng)(0, 0)), rng)
            return Scene(image, image.copy(), empty)
        image = np.full(shape, level, np.uint8)
        return Scene(image, world.expose(np.full(shape, 80.0, np.float32), rng), empty)

    return render


def no_contact(world):
    return lambda count, rng: replace(world, layout=Layout(pairs=0, shape=frame_shape(count)))(0, rng)


def sparse(**kwargs):
    return Layout(pairs=0, **kwargs)


PLAIN = World()
WORLDS: dict[str, Callable] = {
    "plain": PLAIN,
    "plain, no ref": World(reference=False),
    "low light": World(electrons=3, read=6),
    "pairs": World(layout=Layout(pairs=0.4, touching=0.3)),
    "crowd": World(layout=Layout(radii=(1.5, 30), pairs=0.1, covered=0.49, space=0.7)),
    "crowd, no ref": World(
        layout=Layout(radii=(1.5, 30), pairs=0.1, covered=0.49, space=0.7), reference=False
    ),
    "contrast 14": World(level=190.0, contrast=14.0, electrons=150.0, read=16.0, texture=0.005),
    "few wide": World(layout=Layout(radii=(12, 24), pairs=0)),
    # light that ends
    "field stop": World(layout=Layout(region=in_stop), light=field_stop),
    "field stop, no ref": World(layout=Layout(region=in_stop), light=field_stop, reference=False),
    "border": World(layout=Layout(region=in_border), light=black_border),
    "border, no ref": World(layout=Layout(region=in_border), light=black_border, reference=False),
    "margin": World(layout=Layout(region=in_border), file=white_margin),
    "margin, no ref": World(layout=Layout(region=in_border), file=white_margin, reference=False),
    "image circle": World(light=image_circle),
    "image circle, no ref": World(light=image_circle, reference=False),
    "band, no ref": World(layout=Layout(region=under_band), light=black_band, reference=False),
    # camera
    "Bayer": World(gains=BAYER, electrons=30),
    "Bayer, no ref": World(gains=BAYER, electrons=30, reference=False),
    "10 bit in 16": World(scale=4.0),
    "clipped": World(level=110.0, contrast=190.0),
    "S curve mild": World(response=s_curve(0.12)),
    "S curve strong": World(response=s_curve(0.5)),
    "gamma 0.45": World(response=gamma(0.45)),
    "correlated noise": World(noise_blur=0.8),
    "dead columns": World(file=dead_lines),
    "clipped background": World(file=black_level),
    "clipped background, no ref": World(file=black_level, reference=False),
    "thresholded, no ref": World(file=thresholded, reference=False),
    "flicker": World(rows=bands),
    # files that were filtered or compressed
    "median 3": World(file=lambda image: cv2.medianBlur(image, 3)),
    "median 5": World(file=lambda image: cv2.medianBlur(image, 5)),
    "bilateral": World(file=lambda image: cv2.bilateralFilter(image, 7, 30, 3)),
    "CLAHE": World(file=clahe),
    "JPEG 20": World(file=jpeg(20)),
    "JPEG 45": World(file=jpeg(45)),
    "JPEG 70": World(file=jpeg(70)),
    "JPEG 90": World(file=jpeg(90)),
    # optics
    "sharp": World(psf=gaussian(0.7)),
    "defocus": World(psf=pillbox(3.0)),
    "halo": World(psf=mixed((0.9, 1.4), (0.1, 8.0))),
    "coma": World(
        psf=mixed((0.5, 1.0), (0.2, 1.2, 1.0), (0.15, 1.6, 2.0), (0.1, 2.1, 3.2), (0.05, 2.6, 4.5))
    ),
    "heavy tails": World(psf=moffat(1.6, 1.6)),
    "heavier tails": World(psf=moffat(1.0, 1.25)),
    "blur 1 to 3": World(psf=across(1.0, 3.0)),
    # contacts
    "dome": World(interior=dome),
    "bowl": World(interior=bowl),
    "mottled": World(interior=mottled(0.3, 2.5)),
    "speckled": World(interior=mottled(0.6, 0.8)),
    "holes": World(interior=pierced),
    "ellipses 1.3": World(layout=sparse(), alter=stretched(1.3)),
    "ellipses 2": World(layout=sparse(), alter=stretched(2.0)),
    "cut": World(layout=sparse(cut=0.4)),
    # brightness
    "spread 30 %": World(alter=spread(0.3)),
    "20 % at half": World(alter=scaled(0.2, 0.5)),
    "15 % at 0.35": World(alter=scaled(0.15, 0.35)),
    "20 % dark": World(alter=scaled(0.2, (-0.8, -0.4))),
    "dark contacts": World(contrast=-50.0),
    "odd x 0.2": World(layout=sparse(radii=(4, 20)), alter=odd_one(0.2)),
    "odd x 0.5": World(layout=sparse(radii=(4, 20)), alter=odd_one(0.5)),
    "odd x 0.85": World(layout=sparse(radii=(4, 20)), alter=odd_one(0.85)),
    "odd x 1.5": World(layout=sparse(radii=(4, 20)), alter=odd_one(1.5)),
    "odd x 2.6": World(layout=sparse(radii=(4, 20)), alter=odd_one(2.6), contrast=60.0),
    # background of the frame alone
    "step": World(own_light=step),
    "patch": World(own_light=patch),
    "gradient": World(own_light=gradient),
    "gradient, no ref": World(own_light=gradient, reference=False),
    "moved lamp": World(own_light=moved_lamp),
    "moved dust": World(specks=moved_dust),
    "sample moved 12 px": World(moves=12.0),
    "other surface": World(same_surface=False),
    # pictures of other things
    "dots": World(
        layout=sparse(radii=(5, 6), lattice=20.0),
        light=black_border,
        level=220.0,
        contrast=-190.0,
        texture=0.0,
        psf=gaussian(1.0),
        reference=False,
    ),
    "plate": World(
        layout=sparse(radii=(4, 9), region=in_stop),
        light=plate,
        level=70.0,
        contrast=50.0,
        specks=dirt,
        reference=False,
    ),
    # nothing to measure
    "black": flat(0),
    "white": flat(255),
    "reference itself": flat(80, same=True),
    "noise only": no_contact(PLAIN),
    "noise only, no ref": no_contact(World(reference=False, dusty=False)),
    "wide in a stop, no ref": World(
        layout=Layout(radii=(8, 40), covered=0.15, region=in_stop),
        light=field_stop,
        contrast=100.0,
        reference=False,
    ),
    "noisy JPEG 70, no ref": World(electrons=4, texture=0.005, contrast=25.0, file=jpeg(70), reference=False),
}
for _light in ("laser", "20 nm", "white"):
    for _pixel_um in (1.0, 3.0):
        WORLDS[f"Newton {_light} {_pixel_um:.0f} um"] = World(layout=sparse(), fringes=(_light, _pixel_um))
WORLDS["hot pixels"] = World(file=hot_pixels)
WORLDS["hot pixels, no ref"] = World(file=hot_pixels, reference=False)
SLOW = {"6500 dots": (WORLDS["dots"], 6500), "240 spots": (WORLDS["plate"], 240)}
"""Further worlds with a number of their own."""


def make_scene(world, count, seed):
    """The scene of a world of `WORLDS` or `SLOW`, the same for the same arguments."""
    render = WORLDS.get(world)
    if render is None:
        render, count = SLOW[world]
    return render(count, np.random.default_rng([zlib.crc32(world.encode()), count, seed]))
