"""What pictures of frames cost: `process` with and without them, side by side, in alternate turns.

    python benchmarks/pictures.py --frames 24 --turns 3

The frames are links to those of sample_data/sa_plus (1600 x 1200 pixels), or of another scene. Printed:
seconds of each turn, the ratio of the medians, and drawing over the time without pictures.
"""

import argparse
import csv
import tempfile
from itertools import cycle
from pathlib import Path
from statistics import median
from time import perf_counter

from contactimg.cli import main
from contactimg.timings import collect

SAMPLE = Path(__file__).parents[1] / "sample_data" / "sa_plus"
PICTURES = "pictures"


def make_series(sample: Path, folder: Path, count: int) -> Path:
    """A series of links to the frames of a sample."""
    series = folder / "series"
    series.mkdir()
    frames = sorted(sample.glob("frame_*"))
    for path in sample.iterdir():
        if path not in frames and path.name != "loads.csv" and path.is_file():
            (series / path.name).symlink_to(path)
    with (sample / "loads.csv").open(newline="") as file:
        loads = {row["frame"]: row["load_N"] for row in csv.DictReader(file)}
    rows = []
    for number, frame in zip(range(count), cycle(frames), strict=False):
        name = f"frame_{number:04d}{frame.suffix}"
        (series / name).symlink_to(frame)
        rows.append((name, loads[frame.name]))
    with (series / "loads.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("frame", "load_N"), *rows])
    return series


def run(series: Path, target: Path, workers: int, *, pictures: bool) -> tuple[float, float]:
    """Seconds of one run, and those of its pictures."""
    options = ["--quiet", "--workers", str(workers)] + ([] if pictures else ["--no-pictures"])
    start = perf_counter()
    with collect() as timings:
        main(["process", str(series), "-o", str(target), *options])
    return perf_counter() - start, timings.seconds[PICTURES]


def measure(options: argparse.Namespace) -> None:
    """Run in turns and print."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        series = make_series(options.sample, folder, options.frames)
        run(series, folder / "warm", options.workers, pictures=True)  # compiles, reads the files once
        times: dict[bool, list[float]] = {False: [], True: []}
        drawing = []
        for turn in range(options.turns):
            for pictures in (False, True):
                target = folder / f"{turn}_{pictures}"
                seconds, drawn = run(series, target, options.workers, pictures=pictures)
                times[pictures].append(seconds)
                drawing += [drawn] if pictures else []
    without, with_pictures = (median(times[pictures]) for pictures in (False, True))
    print(f"without: {[round(seconds, 2) for seconds in times[False]]} s")
    print(f"with:    {[round(seconds, 2) for seconds in times[True]]} s")
    drawn = median(drawing)
    print(f"ratio {with_pictures / without:.3f}; drawing over the time without {drawn / without:.3f}")
    print(f"a frame {1e3 * without / options.frames:.0f} ms, a picture {1e3 * drawn / options.frames:.0f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--sample", type=Path, default=SAMPLE)
    measure(parser.parse_args())
