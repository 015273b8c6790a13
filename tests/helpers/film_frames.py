"""Frames of contacts with the air film around them, or without, on a grid, made without the renderer."""

from functools import lru_cache

import cv2
import numpy as np
import pandas as pd

from contactimg.optics.film import Light, excess_table

LED = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))
SPHERE_M = 100e-6
FINE = 4
CELL_PX = 64


@lru_cache(maxsize=6)
def film_frame(pixel_size, *, film, seed, grid=(5, 7), radii=(3.0, 12.0), contrast=0.9):
    """Frame, reference and truth; ``contrast`` is relative to the background of 100 grey levels."""
    rng = np.random.default_rng(seed)
    rows, columns = (n * CELL_PX for n in grid)
    fine, truth = np.zeros((rows * FINE, columns * FINE), np.float32), []
    for i, j in np.ndindex(*grid):
        a = float(np.exp(rng.uniform(*np.log(radii))))
        x, y = CELL_PX * (j + 0.5) + rng.uniform(-3, 3), CELL_PX * (i + 0.5) + rng.uniform(-3, 3)
        truth.append((x, y, a, 0))
        place = (np.arange(CELL_PX * FINE) + 0.5) / FINE - 0.5
        r = np.hypot(CELL_PX * j + place - x, (CELL_PX * i + place - y)[:, None])
        inside = np.clip((a - r) * FINE + 0.5, 0, 1)
        nodes = np.linspace(a, a + CELL_PX, 3000)
        ring = excess_table(LED).around_contact(
            nodes * pixel_size, radius=a * pixel_size, sphere_radius=SPHERE_M
        )
        around = (1 - inside) * np.interp(r, nodes, ring) if film else 0.0
        cell = np.s_[
            CELL_PX * FINE * i : CELL_PX * FINE * (i + 1), CELL_PX * FINE * j : CELL_PX * FINE * (j + 1)
        ]
        fine[cell] = inside + around
    light = cv2.GaussianBlur(fine, (0, 0), 1.4 * FINE).reshape(rows, FINE, columns, FINE).mean(axis=(1, 3))
    frame = 100 * (1 + contrast * light) + rng.normal(0, min(2.0, 2.0 * contrast), light.shape)
    reference = 100 + rng.normal(0, min(0.5, 0.5 * contrast), light.shape)
    table = pd.DataFrame(truth, columns=["x_px", "y_px", "radius_px", "kind"])
    return frame.astype(np.float32), reference.astype(np.float32), table
