"""Contacts within the air film that looks like contact, with the film in the edge model and without it.

The film is computed here once more, from Fresnel's coefficients and Hertz's gap, and painted finely.
"""

from functools import cache
from itertools import pairwise

import cv2
import numpy as np
import pandas as pd
from imaging_frames import Optics, expose, match
from imaging_scores import markdown, put_table, root_mean_square

from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.film_rim import FilmRim
from contactimg.optics.film import Light

SPHERE = 100.0  # um
INDEX, RUBBER, WAVELENGTH, BANDWIDTH, BAND = 1.52, 1.41, 0.560, 0.070, (0.450, 0.680)  # um
BLUR = 1.4  # px
CELL, FINE = {1.0: 180, 6.0: 46}, {1.0: 6, 6.0: 12}  # px a contact, points a pixel; by um a pixel
SIZES = (5.0, 10.0, 20.0, 30.0, 45.0)  # um
SHAPE = (760, 1100)
CAMERA = Optics(level=120.0, contrast=0.6, camera=(40.0, 10.0))  # contrast/noise 36


def compare_film(seed, *, frames=2):
    """Table of relative errors by contact radius and pixel size."""
    lines = []
    for pixel in CELL:
        shots = [shoot_film(pixel, np.random.default_rng(seed + k)) for k in range(frames)]
        light = Light(INDEX, RUBBER, 1e-6 * WAVELENGTH, 1e-6 * BANDWIDTH, (1e-6 * BAND[0], 1e-6 * BAND[1]))
        known = FilmRim(light, 1e-6 * SPHERE, 1e-6 * pixel)
        for label, film in (("sharp", None), ("with the film", known)):
            lines.append([f"{pixel:g} µm", label, *_errors(shots, film, pixel)])
    bins = [f"{low:g}-{high:g} µm" for low, high in pairwise(SIZES)]
    header = ["pixel", "edge model", *(f"bias {name}" for name in bins), "RMS of a", "sum of a³", "found"]
    put_table("film", markdown(header, lines))


def _errors(shots, film, pixel):
    """Mean relative error by size, RMS, relative error of the sum of cubes, number found."""
    parts, cubes, truths = [], [], 0
    for frame, reference, truth in shots:
        disks = measure_image(frame, reference, polarity="bright", full_scale=255, film=film).disks
        true, found = match(truth, disks).T
        a = truth.radius_px.to_numpy()[true]
        parts.append(pd.DataFrame({"a": a * pixel, "error": disks.radius_px.to_numpy()[found] / a - 1}))
        cubes.append(np.sum(disks.radius_px**3) / np.sum(truth.radius_px**3) - 1)
        truths += len(truth)
    rows = pd.concat(parts)
    size = np.digitize(rows.a, SIZES[1:-1])
    biases = [f"{100 * rows.error[size == k].mean():+.2f} %" for k in range(len(SIZES) - 1)]
    return [
        *biases,
        f"{100 * root_mean_square(rows.error):.2f} %",
        f"{100 * np.mean(cubes):+.2f} %",
        f"{len(rows)}/{truths}",
    ]


def shoot_film(pixel, rng):
    """Frame, reference and truth of contacts on a grid, radii evenly spread in the logarithm."""
    cell, (rows, columns) = CELL[pixel], SHAPE
    brightness = np.zeros((rows, columns), np.float32)
    truth = []
    for top in range(0, rows - cell, cell):
        for left in range(0, columns - cell, cell):
            a = np.exp(rng.uniform(*np.log([SIZES[0], SIZES[-1]]))) / pixel
            x, y = cell / 2 + rng.uniform(-1, 1, 2)
            brightness[top : top + cell, left : left + cell] = _paint(x, y, a, pixel)
            truth.append((left + x, top + y, a))
    light = CAMERA.level * (1 + CAMERA.contrast * brightness)
    dark = np.full_like(light, CAMERA.level)
    names = ["x_px", "y_px", "radius_px"]
    return expose(light, CAMERA, rng), expose(dark, CAMERA, rng), pd.DataFrame(truth, columns=names)


def _paint(x, y, a, pixel):
    """One cell: contact and rings, blurred, averaged over pixels."""
    k, n = FINE[pixel], CELL[pixel]
    place = (np.arange(n * k) + 0.5) / k - 0.5
    r = np.hypot(place - x, (place - y)[:, None])
    nodes = np.linspace(a, n, 4000)
    rings = np.interp(hertz_gap(nodes * pixel, a * pixel), *_excess())
    fine = np.where(r < a, 1.0, np.interp(r, nodes, rings)).astype(np.float32)
    fine = cv2.GaussianBlur(fine, (0, 0), BLUR * k, borderType=cv2.BORDER_REPLICATE)
    return fine.reshape(n, k, n, k).mean(axis=(1, 3))


def hertz_gap(r, a):
    """Gap outside a Hertz contact of radius ``a``, um."""
    lift = (2 * a**2 - r**2) * np.arcsin(np.minimum(a / r, 1.0)) + a * np.sqrt(np.maximum(r**2 - a**2, 0.0))
    return r**2 / (2 * SPHERE) - a**2 / SPHERE + lift / (np.pi * SPHERE)


@cache
def _excess():
    """Gaps (um) and the brightness there: 1 in contact, 0 far away."""
    gap = np.concatenate([np.linspace(0, 6, 6001), [1e3]])
    first, second = (INDEX - 1) / (INDEX + 1), (1 - RUBBER) / (1 + RUBBER)

    def transmitted(phase):
        both = first**2 + second**2 + 2 * first * second * np.cos(phase)
        return 1 - both / (1 + (first * second) ** 2 + 2 * first * second * np.cos(phase))

    wavelength = np.linspace(*BAND, 461)
    lamp = np.exp(-(((wavelength - WAVELENGTH) / BANDWIDTH) ** 2))
    seen = transmitted(4 * np.pi * gap[:-1, None] / wavelength) @ lamp / lamp.sum()
    far = transmitted(np.linspace(0, 2 * np.pi, 1000, endpoint=False)).mean()
    return gap, np.append((seen - far) / (seen[0] - far), 0.0)
