"""Sheared series with known contacts: how far asperities.csv and the laws under shear are from the truth.

Two hundred contacts, twelve frames of 1000 x 960 pixels: nine with a rising tangential load at one normal
load, three at smaller normal loads, where asperities leave contact. `tests/shear/test_sheared_series.py`
checks the same on a small series.

    python benchmarks/sheared_series.py [FOLDER] [--small] [--seed N]
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from contactimg.pipeline.analyse.analysis import write_analysis

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from sheared_series import (
    BETA,
    PIXEL,
    RESOLVED_PX,
    SMALL,
    analysed,
    axis_errors,
    true_strength,
    with_truth,
)

FULL = {
    "side_m": 0.0058, "shape": [960, 1000], "loads_N": [0.3] * 9 + [0.2, 0.1, 0.04],
    "tangential_N": [0.0, 0.04, 0.06, 0.08, 0.1, 0.11, 0.12, 0.13, 0.14, 0.06, 0.03, 0.01],
}  # fmt: skip


def compare(analysis, place, truth, size):
    """Figures of a series: what was found against the truth."""
    both = with_truth(analysis.sheared.followed, truth)
    figures = {"contacts": both["asperity"].nunique(), "frames": both["frame"].nunique()}
    figures["contacts that are none"] = int((both["touches"] & both["x_m_true"].isna()).sum())
    moved = both[both["moved"]]
    resolved = moved[moved["radius_px"] >= RESOLVED_PX]
    names = ["error_x_m", "error_y_m"]
    for name, part in (("all", moved), (f"radius from {RESOLVED_PX:g} px", resolved)):
        rms = float(np.sqrt(np.mean(part[names].to_numpy() ** 2)))
        figures[f"displacements, {name}"] = f"{len(part)}, rms {rms:.3g} px"
    figures["common error of a frame, px"] = float(resolved.groupby("frame")[names].mean().abs().max().max())
    errors = axis_errors(place.contacts, truth)
    for name in ("along", "across"):
        z = errors[name].dropna()
        shares = [100 * float((z.abs() < limit).mean()) for limit in (1.0, 1.96)]
        figures[f"half-axes {name}"] = (
            f"{len(z)} of {len(errors)} with a std: within 1 {shares[0]:.1f} %, within 1.96 "
            f"{shares[1]:.1f} %, mean {z.mean():.2f}"
        )
    away = both[~both["touches"]]
    held = away["radius_upper_m"] >= away["radius_m_true"].fillna(0.0)
    there = away["radius_m_true"].notna()
    figures["upper limits"] = (
        f"{len(away)}, hold {100 * held.mean():.1f} %, {int(there.sum())} over a contact"
    )
    figures["of these hold"] = f"{int(held[there].sum())}"
    figures["limit, detection limit, px"] = (
        f"{away['radius_upper_m'].median() / PIXEL:.3g}, {place.frames['detection_limit_px'].median():.3g}"
    )
    rows = {row[0]: row[1] for row in analysis.sheared.rows()}
    true = {
        "shear_beta": BETA,
        "shear_rate_exponent": -1.5,
        "shear_strength_at_largest": true_strength(truth, size),
    }
    for name, value in true.items():
        one = rows[name]
        inside = "inside" if one.low <= value <= one.high else "OUTSIDE"
        figures[name] = f"{one.value:.5g} ({one.low:.5g} ... {one.high:.5g}), true {value:.5g}: {inside}"
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp())
    folder.mkdir(exist_ok=True)
    size, began = SMALL if options.small else FULL, time.perf_counter()
    analysis, place, truth = analysed(folder, size, options.seed)
    if options.folder:
        (folder / "analysis").mkdir(exist_ok=True)
        write_analysis(analysis, folder / "analysis")
    for name, value in compare(analysis, place, truth, size).items():
        print(f"{name:>34}: {value:.3g}" if isinstance(value, float) else f"{name:>34}: {value}")
    print(f"{'seconds':>34}: {time.perf_counter() - began:.0f}")


if __name__ == "__main__":
    main()
