"""What each special case of the imaging earns: each switched off, over the conditions where it may matter.

    NUMBA_NUM_THREADS=1 python benchmarks/imaging_ablation.py                    # docs/imaging_ablation.md
    NUMBA_NUM_THREADS=1 python benchmarks/imaging_ablation.py halo covers --frames 5 --real FOLDER

The cases are in `imaging_ablation_cases`, the conditions in `imaging_ablation_frames`. A part of the cases or
of the conditions is printed only; all of them are written to the page.
"""

import argparse
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from imaging_ablation_cases import CASES, check_names, count_lines, switched_off, watched
from imaging_ablation_frames import (
    Condition,
    all_conditions,
    pair,
)
from imaging_scores import EDGES, ROOT, markdown, number

PAGE = ROOT / "docs" / "imaging_ablation.md"
SEED = 52_000

# changes that are shown: of F1, of the worst RMS/CRB (relative), of the worst bias (px), of the coverage;
# by hand for two frames of 125 contacts, of which one makes 0.004 of F1 and of the coverage
LEAST_F1, LEAST_RATIO, LEAST_BIAS, LEAST_COVERAGE = 0.004, 0.05, 0.01, 0.03
MOST_ROWS = 6  # conditions of one case in the table: those that change most
FEWEST = 10  # contacts of a size bin whose RMS and bias count
ON_EVERY = 3  # cases between two measurements with everything on, for the ratio of times
HEADER = [
    "switched off",
    "lines",
    "time off/on: median; extreme",
    "condition",
    "F1",
    "worst RMS/CRB",
    "worst bias px",
    "within ±1, ±2 std, %",
    "status",
]


def score(condition: Condition, results: list) -> dict[str, Any]:
    """Numbers of all frames of a condition."""
    rows, found, true, matched = [], 0, 0, 0
    for shot, result in zip(condition.shots, results, strict=True):
        i, j = pair(shot.truth, result.disks).T
        disks = result.disks.iloc[j]
        radius = shot.truth.radius_px.to_numpy()[i]
        rows.append(pd.DataFrame({"radius": radius, "bound": shot.bounds[i],
                                  "error": disks.radius_px.to_numpy() - radius,
                                  "std": disks.radius_std_px.to_numpy()}))  # fmt: skip
        found, true, matched = found + len(result.disks), true + len(shot.truth), matched + len(i)
    table = pd.concat(rows, ignore_index=True)
    bins = [part for _, part in table.groupby(np.digitize(table.radius, EDGES)) if len(part) >= FEWEST]
    ratios = [float(np.sqrt(np.mean((part.error / part.bound) ** 2))) for part in bins]
    biases = [float(part.error.mean()) for part in bins]
    known = table.dropna(subset="bound")
    pull = (known.error / known["std"]).abs()
    return {
        "f1": 2 * matched / max(found + true, 1),
        "ratio": np.max(ratios, initial=0.0) or np.nan,
        "rms": float(np.sqrt(np.mean(table.error**2))),
        "bias": max(biases, key=abs, default=np.nan),
        "one": float((pull < 1).mean()) if len(pull) else np.nan,
        "two": float((pull < 2).mean()) if len(pull) else np.nan,
        "status": ", ".join(sorted({result.status for result in results})),
        "disks": [result.disks for result in results],
    }


def measure(condition: Condition) -> tuple[list, float]:
    """Results of all frames of a condition, and the processor time."""
    start = time.process_time()
    results = condition.measure()
    return results, time.process_time() - start


@dataclass(frozen=True)
class Change:
    """One condition with everything on and with a case off."""

    key: str
    condition: str
    on: dict[str, Any]
    off: dict[str, Any]
    time: float

    @property
    def same(self) -> bool:
        """Whether not a bit of the tables is different."""
        return all(a.equals(b) for a, b in zip(self.on["disks"], self.off["disks"], strict=True))

    @property
    def size(self) -> float:
        """How many times the least change that is more than chance; the largest of all numbers."""
        if self.same:
            return 0.0
        on, off = self.on, self.off
        ratio = abs(np.log(off["ratio"] / on["ratio"])) / LEAST_RATIO
        rms = abs(np.log(max(off["rms"], 1e-9) / max(on["rms"], 1e-9))) / LEAST_RATIO
        parts = [
            abs(off["f1"] - on["f1"]) / LEAST_F1,
            ratio if np.isfinite(ratio) else rms,
            abs(off["bias"] - on["bias"]) / LEAST_BIAS,
            *(abs(off[name] - on[name]) / LEAST_COVERAGE for name in ("one", "two")),
            10.0 * (on["status"] != off["status"]),
        ]
        return float(np.nanmax(parts))

    def cells(self) -> list[str]:
        """F1, worst RMS over bound or RMS, worst bias, coverage and status; on and off."""
        on, off = self.on, self.off
        name, unit = ("ratio", "") if np.isfinite(on["ratio"]) else ("rms", " px")
        shares = [f"{100 * part['one']:.0f} {100 * part['two']:.0f}" for part in (on, off)]
        return [
            f"{on['f1']:.3f} → {off['f1']:.3f}",
            f"{number(on[name], 3)} → {number(off[name], 3)}{unit}",
            f"{on['bias']:+.3f} → {off['bias']:+.3f}",
            " → ".join(shares) if np.isfinite(on["one"]) else "",
            on["status"] if on["status"] == off["status"] else f"{on['status']} → {off['status']}",
        ]


def compare(condition: Condition, keys: Iterable[str]) -> list[Change]:
    """Every case off in turn that comes into play, the time by turns with everything on."""
    keys = [key for key in keys if not condition.cases or key in condition.cases]
    with watched(keys) as called:
        results, _ = measure(condition)
    on, on_time = score(condition, results), np.inf
    changes = []
    for k, key in enumerate(key for key in keys if key in called):
        if k % ON_EVERY == 0:
            _, on_time = measure(condition)
        with switched_off(key):
            results, off_time = measure(condition)
        changes.append(Change(key, condition.name, on, score(condition, results), off_time / on_time))
    return changes


def summarise(key: str, changes: list[Change]) -> list[list[Any]]:
    """Rows of the table of one case: the conditions that change most, and the time over all."""
    times = [change.time for change in changes]
    extreme = changes[int(np.argmax(np.abs(np.log(times))))]
    time_ = f"{number(float(np.median(times)))}; {number(extreme.time)} ({extreme.condition})"
    large = sorted((change for change in changes if change.size >= 1), key=lambda change: -change.size)
    rows = [["", "", "", change.condition, *change.cells()] for change in large[:MOST_ROWS]]
    if not rows:
        other = sum(not change.same for change in changes)
        what = (
            f"within chance on {len(changes)} conditions"
            if other
            else f"the same on {len(changes)} conditions"
        )
        rows = [["", "", "", what, *[""] * 5]]
    rows[0][:3] = [CASES[key].name, count_lines(key) or "", time_]
    return rows


def tabulate(keys: Iterable[str], changes: list[Change]) -> list[str]:
    """Lines of the table; a case that comes into play on no condition is an error."""
    rows = []
    for key in keys:
        own = [change for change in changes if change.key == key]
        if not own:
            raise RuntimeError(f"{key}: no condition calls {', '.join(CASES[key].replacements)}")
        rows += summarise(key, own)
    return markdown(HEADER, rows)


def report(changes: list[Change], seconds: float) -> None:
    """Print a condition and what changes on it."""
    on = changes[0].on
    numbers = [number(on[key], 3) for key in ("f1", "ratio", "rms", "bias", "one", "two")]
    print(changes[0].condition, *numbers, on["status"], f"{seconds:.0f} s", flush=True)
    for change in changes:
        if change.size >= 1:
            print("   ", change.key, *change.cells(), f"time {change.time:.2f}", flush=True)


def main() -> None:
    """Run the cases that are named, or all, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; default: all")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--frames", type=int, default=2, help="frames a condition")
    parser.add_argument("--only", default="", help="conditions whose names contain this")
    parser.add_argument("--real", type=Path, help="folder with dots/dot_pattern_02.jpg and _05.jpg")
    arguments = parser.parse_args()
    if unknown := set(arguments.cases) - set(CASES):
        parser.error(f"unknown case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    cv2.setNumThreads(1)
    check_names()
    keys = arguments.cases or list(CASES)
    changes: list[Change] = []
    for condition in all_conditions(arguments.seed, arguments.frames, arguments.only, arguments.real):
        start = time.perf_counter()
        if here := compare(condition, keys):
            report(here, time.perf_counter() - start)
            changes += here
    lines = tabulate({change.key: None for change in changes} if arguments.only else keys, changes)
    print("\n".join(lines))
    if not (arguments.cases or arguments.only):
        write_page(lines, arguments.frames)


def write_page(lines: list[str], frames: int) -> None:
    """Put the table on its page."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- table -->\n", "<!-- end -->"
    before, rest = text.split(begin)
    after = rest[rest.index(end) :]
    note = f"{frames} frames a condition."
    PAGE.write_text("\n".join([before + begin + note, "", *lines, after]), encoding="utf-8")


if __name__ == "__main__":
    main()
