"""Accuracy where contacts cover most of the frame: lattices, from loose ones to those that leave no gap."""

import numpy as np
import pandas as pd
from imaging_frames import Optics, match, render
from imaging_scores import markdown, number, put_table

from contactimg.imaging.measure import measure_image

OPTICS = Optics(shape=(600, 800))
CROWDS = {  # pitch and radius, px
    "5 px every 24 px": (24.0, 5.0),
    "5 px every 18 px": (18.0, 5.0),
    "5 px every 14 px": (14.0, 5.0),
    "10 px every 25 px": (25.0, 10.0),
    "10 px every 23 px": (23.0, 10.0),
    "20 px every 42 px": (42.0, 20.0),
    "10 px every 21.5 px": (21.5, 10.0),
    "5 px every 11.5 px": (11.5, 5.0),
}
SPREAD = 0.02  # of the radii, and of the pitch by which places are off


def tabulate_crowds(seed, *, frames=3):
    """Table of what is found in triangular lattices of contacts that fill the frame."""
    rows = [_measure(name, *crowd, range(seed, seed + frames)) for name, crowd in CROWDS.items()]
    header = [
        "contacts",
        "covered",
        "nearest gap px",
        "found",
        "bias px",
        "RMS px",
        "stated px",
        "±2 std",
        "statuses",
    ]
    put_table("crowds", markdown(header, rows))


def place_contacts(pitch, radius, rng, *, shape=OPTICS.shape):
    """A triangular lattice all over the frame, slightly irregular."""
    down = np.arange(pitch / 2, shape[0], pitch * np.sqrt(0.75))
    across = [np.arange(pitch / 2 * (1 + k % 2), shape[1], pitch) for k in range(len(down))]
    x, y = np.concatenate(across), np.repeat(down, [len(row) for row in across])
    x, y = (place + 0.5 * SPREAD * pitch * rng.uniform(-1, 1, len(x)) for place in (x, y))
    return pd.DataFrame(
        {"x_px": x, "y_px": y, "radius_px": radius * rng.uniform(1 - SPREAD, 1 + SPREAD, len(x)), "kind": 0}
    )


def _measure(name, pitch, radius, seeds):
    """A row of the table: all frames of one lattice."""
    errors, stds, found, placed, statuses = [], [], 0, 0, []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = place_contacts(pitch, radius, rng)
        frame, reference = render(truth, OPTICS, rng)
        measured = measure_image(frame, reference, polarity="bright", full_scale=OPTICS.full_scale)
        pairs = match(truth, measured.disks)
        true, told = truth.iloc[pairs[:, 0]], measured.disks.iloc[pairs[:, 1]]
        errors.append(told["radius_px"].to_numpy() - true["radius_px"].to_numpy())
        stds.append(told["radius_std_px"].to_numpy())
        found, placed = found + len(pairs), placed + len(truth)
        statuses.append(measured.status)
    cover = f"{100 * np.pi * radius**2 / (pitch**2 * np.sqrt(0.75)):.0f} %"
    errors, stds = np.concatenate(errors), np.concatenate(stds)
    scores = ["-"] * 4
    if len(errors):
        scores = [
            f"{errors.mean():+.4f}",
            number(np.sqrt(np.mean(errors**2))),
            number(np.median(stds)),
            f"{100 * np.mean(np.abs(errors) < 2 * stds):.0f} %",
        ]
    row = [name, cover, number(pitch - 2 * radius), f"{found}/{placed}", *scores]
    print(*row, statuses, flush=True)
    return [*row, ", ".join(sorted(set(statuses)))]
