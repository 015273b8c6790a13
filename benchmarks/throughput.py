"""Frames per second of `process` without pictures, against measuring decoded frames in a loop.

    python benchmarks/throughput.py --frames 400
    python benchmarks/throughput.py --frames 60 --workers 2

The frames are links to those of sample_data/sa_plus (1600 x 1200 pixels), on their reference. Two runs of
different lengths give the rate after start-up: the frames that one has more over the time that it takes
longer. Printed beside it: processes times the rate of the measurement of one frame in a loop, in one process,
before and after the runs; and the ratio. A frame that is measured again with the optics of the series counts
twice.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from contactimg.files import open_experiment, read_scene
from contactimg.pipeline.effects import film_setting, resolve_measurement
from contactimg.pipeline.frame import FrameOptions, measure_scene_frame
from contactimg.pipeline.inputs import contact_sites, read_reference, scene_asperities

SAMPLES = Path(__file__).parents[1] / "sample_data" / "sa_plus"
SHORT = 0.2  # frames of the short run over those of the long one
AGAIN = b"with the contrast, the blur and the edge of the series"  # in the log, of a second measurement
ROUNDS = 2  # over the frames, in each loop


def make_series(folder: Path, count: int) -> None:
    """A series of links to the sample frames."""
    folder.mkdir()
    frames = sorted(SAMPLES.glob("frame_*.tif"))
    for number in range(count):
        (folder / f"frame_{number:05d}.tif").symlink_to(frames[number % len(frames)])
    for name in ("reference.tif", "asperities.csv"):
        (folder / name).symlink_to(SAMPLES / name)
    text = (SAMPLES / "scene.toml").read_text(encoding="utf-8").replace('loads = "loads.csv"\n', "")
    text = text.replace("[images]\n", '[images]\nbackground = "reference"\n')
    (folder / "scene.toml").write_text(text, encoding="utf-8")


def time_run(top: Path, count: int, workers: int) -> tuple[float, int]:
    """Wall time of the command, and how many measurements it made."""
    series, out = top / f"series_{count}", top / f"out_{count}"
    make_series(series, count)
    words = ["process", str(series), "-o", str(out), "--workers", str(workers), "--no-pictures", "--verbose"]
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "contactimg", *words], check=True, capture_output=True)  # noqa: S603
    return time.perf_counter() - start, count + (done.stdout + done.stderr).count(AGAIN)


def seconds_a_frame(folder: Path) -> float:
    """Wall time of the measurement of a decoded frame, in a loop over the sample frames."""
    scene = read_scene(folder)
    experiment = open_experiment(scene)
    resolved = resolve_measurement(scene)
    asperities = scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    options = FrameOptions(resolved, film_setting(resolved, sites))
    reference = read_reference(experiment)
    image = None if reference is None else reference.image
    frames = [source.read() for source in experiment.frames]
    measure_scene_frame(frames[0], image, options=options)  # compiled before anything is timed
    start = time.perf_counter()
    for _ in range(ROUNDS):
        for frame in frames:
            measure_scene_frame(frame, image, options=options)
    return (time.perf_counter() - start) / (ROUNDS * len(frames))


def main() -> None:
    """Print the rates and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    few = max(int(SHORT * options.frames), 2 * options.workers)
    top = Path(tempfile.mkdtemp(prefix="throughput_"))
    try:
        make_series(top / "loop", len(list(SAMPLES.glob("frame_*.tif"))))
        loops = [seconds_a_frame(top / "loop")]
        (short, first), (long, all_of_them) = (
            time_run(top, count, options.workers) for count in (few, options.frames)
        )
        loops.append(seconds_a_frame(top / "loop"))
    finally:
        shutil.rmtree(top)
    rate = (all_of_them - first) / (long - short)
    full = options.workers * len(loops) / sum(loops)
    print(f"loop, before and after: {', '.join(f'{1e3 * seconds:.0f}' for seconds in loops)} ms a frame")
    print(
        f"process: {few} frames {short:.1f} s, {options.frames} frames {long:.1f} s ({all_of_them} measured)"
    )
    print(
        f"after start-up {rate:.2f} measurements/s; {options.workers} x loop {full:.2f}; "
        f"ratio {rate / full:.3f}"
    )


if __name__ == "__main__":
    main()
