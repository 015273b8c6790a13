"""Frames with known contacts, what a measurement makes of them, and tables of both.

Frames come from the tests' own renderer, which shares nothing with the package.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from imaging_bound import radius_bounds
from imaging_frames import CAMERAS, match, render, scatter

ROOT = Path(__file__).parents[1]

EDGES = (3.0, 6.0, 15.0)
BINS = ("< 3", "3-6", "6-15", "> 15")
CLOSE, TOUCHING = 1, 2  # kinds of `scatter`


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame, its reference, the contacts on it and the bounds of their radii."""

    frame: np.ndarray
    reference: np.ndarray
    truth: pd.DataFrame
    bounds: np.ndarray


def shoot(optics, seed, *, count=500, radii=(1.5, 30.0), spread=0.0):
    """One frame of ``count`` contacts with its reference; bounds for contrasts of a relative ``spread``."""
    rng = np.random.default_rng(seed)
    truth = scatter(count, optics, rng, radii=radii)
    frame, reference = render(truth, optics, rng)
    return Shot(frame, reference, truth, radius_bounds(truth, optics, CAMERAS, spread=spread))


def score(shot, disks):
    """One row a true contact (error and stated std NaN where lost), and the frame's counts."""
    pairs = match(shot.truth, disks)
    rows = pd.DataFrame(
        {
            "radius": shot.truth.radius_px,
            "kind": shot.truth.kind,
            "bound": shot.bounds,
            "error": np.nan,
            "std": np.nan,
        }
    )
    true, found = pairs.T
    rows.loc[true, "error"] = disks.radius_px.to_numpy()[found] - rows.radius.to_numpy()[true]
    if "radius_std_px" in disks:
        rows.loc[true, "std"] = disks.radius_std_px.to_numpy()[found]
    rows["bin"] = np.digitize(rows.radius, EDGES)
    cubes = float(np.sum(disks.radius_px**3) / np.sum(shot.truth.radius_px**3) - 1)
    return rows, {"found": len(disks), "true": len(rows), "matched": len(pairs), "cubes": cubes}


def summarise(scores):
    """Numbers of several frames pooled."""
    rows = pd.concat([part for part, _ in scores], ignore_index=True)
    counts = pd.DataFrame([part for _, part in scores])
    hit = rows.dropna(subset="error")
    ratio, pull = hit.error / hit.bound, (hit.error / hit["std"]).abs()
    total = counts.sum()
    lost = rows.error.isna()
    return {
        "f1": 2 * total.matched / (total.found + total.true),
        "false": int(total.found - total.matched),
        "lost": int(lost.sum()),
        "lost_close": int((lost & (rows.kind == CLOSE)).sum()),
        "lost_touching": int((lost & (rows.kind == TOUCHING)).sum()),
        "close": int((rows.kind == CLOSE).sum()),
        "touching": int((rows.kind == TOUCHING).sum()),
        "rms": root_mean_square(hit.error),
        "ratio": root_mean_square(ratio),
        "ratios": [root_mean_square(ratio[hit.bin == k]) for k in range(4)],
        "biases": [float(hit.error[hit.bin == k].mean()) for k in range(4)],
        "bias_stds": [float(hit.error[hit.bin == k].sem()) for k in range(4)],
        "numbers": [int((hit.bin == k).sum()) for k in range(4)],
        "within": [float((pull < k).mean()) for k in (1, 2)],
        "within_bins": [[float((pull[hit.bin == b] < k).mean()) for b in range(4)] for k in (1, 2)],
        "cubes": float(counts.cubes.mean()),
        "cubes_worst": float(counts.cubes.iloc[counts.cubes.abs().argmax()]),
        "frames": len(scores),
    }


def root_mean_square(values):
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def number(value, digits=2, *, sign=False):
    """Text of a number with so many significant digits; a dash where there is none."""
    if not np.isfinite(value):
        return "-"
    value = float(f"{value:.{digits - 1}e}")
    if value and abs(value) >= 10 ** (digits - 1):
        return f"{value:{'+' if sign else ''},.0f}".replace(",", " ")
    decimals = digits - 1 - (int(np.floor(np.log10(abs(value)))) if value else 0)
    return f"{value:{'+' if sign else ''}.{decimals}f}"


def markdown(header, rows):
    """Lines of a table."""
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(str(cell) for cell in row) + " |" for row in rows),
    ]


def put_table(name, lines, *, page=ROOT / "docs/imaging.md"):
    """Print a table and put it between the marks of that name on the page."""
    print("\n".join(["", name, *lines]), flush=True)
    text = page.read_text(encoding="utf-8")
    begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
    before, after = text.split(begin)
    page.write_text(before + begin + "\n".join(lines) + "\n" + after[after.index(end) :], encoding="utf-8")
