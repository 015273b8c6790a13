"""Frames per second of `process` without pictures, against measuring decoded frames in a loop.

    python benchmarks/throughput.py --frames 400
    python benchmarks/throughput.py --frames 60 --workers 2 --uncompressed

The frames are links to those of sample_data/sa_plus (1600 x 1200 pixels), on their reference. Two runs of
different lengths give the rate after start-up: the frames that one has more over the time that it takes
longer. Beside it: the rate of the same measurements of decoded frames in a loop, likewise from two lengths,
times the number of processes, with one loop alone and with as many loops side by side as the run has
processes, which share the memory of the machine as they do. Each frame is measured alone and again with the
optics of the series, which the loop does too.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import tifffile

from contactimg.files import open_experiment, read_scene
from contactimg.pipeline import series
from contactimg.pipeline.inputs import read_reference
from contactimg.pipeline.parallel import for_each_frame

SAMPLES = Path(__file__).parents[1] / "sample_data" / "sa_plus"
SHORT = 0.2  # frames of the short run over those of the long one


def make_series(folder: Path, count: int, *, compressed: bool = True) -> None:
    """A series of links to the sample frames, or to copies of them that are not compressed."""
    folder.mkdir()
    frames = sorted(SAMPLES.glob("frame_*.tif"))
    if not compressed:
        frames = [_uncompressed(path, folder.parent) for path in frames]
    for number in range(count):
        (folder / f"frame_{number:05d}.tif").symlink_to(frames[number % len(frames)])
    for name in ("reference.tif", "asperities.csv"):
        (folder / name).symlink_to(SAMPLES / name)
    text = (SAMPLES / "scene.toml").read_text(encoding="utf-8").replace('loads = "loads.csv"\n', "")
    text = text.replace("[images]\n", '[images]\nbackground = "reference"\n')
    (folder / "scene.toml").write_text(text, encoding="utf-8")


def _uncompressed(path: Path, folder: Path) -> Path:
    """A copy of a frame that is not compressed, as cameras write them."""
    copy = folder / path.name
    if not copy.exists():
        tifffile.imwrite(copy, tifffile.imread(path))
    return copy


def time_run(top: Path, count: int, workers: int) -> float:
    """Wall time of the command."""
    folder, out = top / f"series_{count}", top / f"out_{count}"
    words = ["process", str(folder), "-o", str(out), "--workers", str(workers), "--no-pictures", "--quiet"]
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "contactimg", *words], check=True)  # noqa: S603
    return time.perf_counter() - start


def seconds_of_loop(folder: Path) -> float:
    """Wall time of all measurements of a series, in a loop over its decoded frames in this process."""
    calls = measurements(folder)
    experiment = open_experiment(read_scene(folder))
    reference = read_reference(experiment)
    image = None if reference is None else reference.image
    spent = 0.0
    for measure, source, *arguments in calls:
        frame = source.read()
        start = time.perf_counter()
        measure(frame, image, *arguments)
        spent += time.perf_counter() - start
    return spent


def seconds_side_by_side(folder: Path, processes: int) -> float:
    """Mean wall time of `seconds_of_loop` in several processes at once."""
    words = [sys.executable, __file__, "--loop", str(folder)]
    loops = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(processes)]  # noqa: S603
    return sum(float(loop.communicate()[0]) for loop in loops) / processes


def measurements(folder: Path) -> list[tuple[Any, ...]]:
    """What a run of the series measures, in order: function, frame, and further arguments."""
    made = []

    def noted(experiment: Any, measure: Any, jobs: Any = None, **options: Any) -> Any:
        chosen = [(source,) for source in experiment.frames] if jobs is None else list(jobs)
        made.extend((measure, *job) for job in chosen)
        return for_each_frame(experiment, measure, jobs, **options)

    with patch.object(series, "for_each_frame", noted):
        series.measure_parts(open_experiment(read_scene(folder)))
    return made


def main() -> None:
    """Print the rates and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--uncompressed", action="store_true", help="frames as cameras write them")
    parser.add_argument("--loop", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.loop:
        print(seconds_of_loop(options.loop))
        return
    few = max(int(SHORT * options.frames), 2 * options.workers)
    counts, top = (few, options.frames), Path(tempfile.mkdtemp(prefix="throughput_"))
    folders = [top / f"series_{count}" for count in counts]
    try:
        for count, folder in zip(counts, folders, strict=True):
            make_series(folder, count, compressed=not options.uncompressed)
        runs = [time_run(top, count, options.workers) for count in counts]
        loops = {n: [seconds_side_by_side(folder, n) for folder in folders] for n in (1, options.workers)}
    finally:
        shutil.rmtree(top)
    more = options.frames - few
    rate = more / (runs[1] - runs[0])
    print(f"process: {few} frames {runs[0]:.1f} s, {options.frames} frames {runs[1]:.1f} s")
    print(f"after start-up {rate:.2f} frames/s")
    for number, seconds in loops.items():
        full = options.workers * more / (seconds[1] - seconds[0])
        print(
            f"{number} loops side by side: {few} frames {seconds[0]:.1f} s, {options.frames} frames "
            f"{seconds[1]:.1f} s; {options.workers} x loop {full:.2f} frames/s; ratio {rate / full:.3f}"
        )


if __name__ == "__main__":
    main()
