"""Memory and time of `process` on long series of small frames that are killed twice on the way (Linux).

    python benchmarks/long_series.py --frames 1000 10000

Frames of 400 x 300 pixels with a few contacts; the files are links to 200 different ones. The shortest series
is also run undisturbed, which says when to kill the others. For each length it prints the peak memory of the
command and of its largest worker, the wall time a frame (all runs together), and whether every frame is in
the tables once.
"""

import argparse
import csv
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from contactimg.cli import main as contactimg

FILES = 200
KILLED_AT = (0.3, 0.6)  # shares of the expected time
SECONDS_BETWEEN_READINGS = 0.2

SCENE = """
[indenter]
radius_m = 0.1288
apex_m = [0.0012, 0.0009]
[elastic]
young_modulus_Pa = 3.0e6
[asperities]
generate = "SA"
coverage = 0.05
side_m = 0.0024
seed = 3
[camera]
pixel_size_m = 6.0e-6
[effects]
model = "paper"
[simulate]
loads_N = [{loads}]
shape = [300, 400]
blur_px = 1.4
electrons_per_level = 20
read_noise_electrons = 10
seed = 7
"""


def make_files(folder: Path) -> Path:
    """Simulate the different frames."""
    loads = ", ".join(f"{0.004 + 2e-5 * number:.5f}" for number in range(FILES))
    (folder / "scene.toml").write_text(SCENE.format(loads=loads))
    if contactimg(["simulate", str(folder / "scene.toml"), "-o", str(folder / "files"), "--quiet"]):
        sys.exit("the frames cannot be made")
    return folder / "files"


def make_series(files: Path, folder: Path, count: int) -> None:
    """A series of links to the files."""
    folder.mkdir()
    frames = sorted(files.glob("frame_*.tif"))
    for number in range(count):
        (folder / f"frame_{number:06d}.tif").symlink_to(frames[number % len(frames)])
    for name in ("reference.tif", "asperities.csv"):
        shutil.copy(files / name, folder)
    text = (files / "scene.toml").read_text().replace('loads = "loads.csv"\n', "")
    (folder / "scene.toml").write_text(text)


def peak_megabytes(process: int) -> float:
    """Largest memory that a process has had; 0 if it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), 0.0)


def children_of(process: int) -> list[int]:
    """Processes that a process has started and that live."""
    try:
        return [int(child) for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    except OSError:
        return []


def run(folder: Path, out: Path, peaks: list[float], until: float = float("inf")) -> tuple[int, float]:
    """Process the series, kill it after a time (s), and return the exit code and the time taken."""
    words = ["process", str(folder), "-o", str(out), "--workers", "2", "--no-pictures", "--quiet"]
    start = time.monotonic()
    child = subprocess.Popen([sys.executable, "-m", "contactimg", *words])  # noqa: S603
    while child.poll() is None:
        workers = [peak_megabytes(worker) for worker in children_of(child.pid)]
        peaks[:] = max(peaks[0], peak_megabytes(child.pid)), max([peaks[1], *workers])
        if time.monotonic() - start > until:
            child.kill()
        time.sleep(SECONDS_BETWEEN_READINGS)
    return child.returncode, time.monotonic() - start


def measure_length(top: Path, files: Path, count: int, seconds_a_frame: float | None) -> float:
    """Print one line of the table; return the time a frame."""
    folder, out, peaks, spent = top / f"series_{count}", top / f"out_{count}", [0.0, 0.0], 0.0
    make_series(files, folder, count)
    for share in KILLED_AT if seconds_a_frame else ():
        spent += run(folder, out, peaks, until=share * seconds_a_frame * count)[1]
    code, last = run(folder, out, peaks)
    spent = (spent + last) / count
    with (out / "frames.csv").open(newline="") as file:
        names = [row["frame"] for row in csv.DictReader(file)]
    right = code in (0, 1) and names == sorted(path.name for path in folder.glob("frame_*.tif"))
    state = "all frames once" if right else f"WRONG: exit code {code}, {len(names)} rows"
    print(f"{count:8d} {peaks[0]:10.0f} {peaks[1]:10.0f} {1e3 * spent:12.1f}  {state}", flush=True)
    shutil.rmtree(folder)
    shutil.rmtree(out)
    return spent


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10000])
    lengths = sorted(parser.parse_args().frames)
    with tempfile.TemporaryDirectory() as name:
        files = make_files(Path(name))
        print(f"{'frames':>8s} {'parent MB':>10s} {'worker MB':>10s} {'ms a frame':>12s}")
        rate = measure_length(Path(name), files, lengths[0], None)
        for length in lengths:
            measure_length(Path(name), files, length, rate)
