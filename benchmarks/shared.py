"""What several benchmarks need: the paper's scene, times by turns, tables of pages."""

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from contactimg.scene import Scene, scene_from_dict

ROOT = Path(__file__).parents[1]

PIXEL = 6.0e-6  # m
FAULTS = {
    "blur_px": 1.4,
    "vignetting": 0.15,
    "texture": 0.02,
    "dust_count": 30,
    "light_drift": 0.02,
    "position_drift_px": 0.3,
    "electrons_per_level": 20,
    "read_noise_electrons": 10,
}


def pattern_scene(
    seed: int,
    *,
    side: float = 0.01,
    coverage: float = 0.4,
    modulus: float = 3.0e6,
    effects: dict[str, str] | None = None,
    **simulate: Any,
) -> Scene:
    """The paper's lens on a square of its pattern SA+, seen by a camera with its faults; lengths in metres.

    Further keywords are those of ``[simulate]``.
    """
    return scene_from_dict(
        {
            "indenter": {"radius_m": 0.1288, "apex_m": [side / 2, side / 2]},
            "elastic": {"young_modulus_Pa": modulus},
            "asperities": {"generate": "SA", "coverage": coverage, "side_m": side, "seed": seed},
            "camera": {"pixel_size_m": PIXEL},
            "effects": {"model": "paper"} | (effects or {}),
            "simulate": FAULTS | {"seed": seed} | simulate,
        }
    )


def times_by_turns(works: Sequence[Callable[[], object]], repeats: int) -> list[list[float]]:
    """Seconds of processor time of each function, called by turns; the first is not counted."""
    times: list[list[float]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, taken in zip(works, times, strict=True):
            start = time.thread_time()
            work()
            if turn:
                taken.append(time.thread_time() - start)
    return times


def markdown(header: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def put_table(page: str | Path, name: str, text: str) -> None:
    """Print a text and put it between ``<!-- table: NAME -->`` and ``<!-- end -->`` on a page."""
    print(f"\n{name}\n{text}", flush=True)
    Path(page).write_text(with_table(Path(page).read_text(encoding="utf-8"), name, text), encoding="utf-8")


def with_table(page: str, name: str, text: str) -> str:
    """The text of a page with another table of this name."""
    begin = f"<!-- table: {name} -->\n"
    before, after = page.split(begin)
    return f"{before}{begin}{text}\n{after[after.index('<!-- end -->') :]}"
