"""Memory and time of `process` on long series of small frames, killed three times on the way (Linux).

    python benchmarks/long_series.py --frames 1000 10000
    python benchmarks/long_series.py --frames 1000 100000 --stored

Frames of 400 x 300 pixels with a few contacts; the files are links to 200 different ones. Printed for each
length: peak memory of the parent and of the largest worker; wall time, and processor time of all processes, a
frame (all runs together); whether every frame is in the tables once. With ``--stored`` the measurement of a
frame is replaced by a stored result; reading, keeping, resuming and writing are as they are.
"""

import argparse
import csv
import importlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from contactimg.cli import main
from contactimg.files.part_store import PARTS_FOLDER
from contactimg.pipeline import series

FILES = 200
KILLED_AT = (0.2, 0.5, 0.8)  # of the frames
LOOK_EVERY_SECONDS = 0.2

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


@dataclass
class Peak:
    """Largest memory seen, MB, and processor time of each process, s."""

    parent: float = 0.0
    worker: float = 0.0
    seconds: dict[int, float] = field(default_factory=dict)

    def look(self, parent: int) -> None:
        """Look at the peaks that the system has noted for a process and its children."""
        self.parent = max(self.parent, _peak_memory(parent))
        self.seconds[parent] = _processor_seconds(parent) or self.seconds.get(parent, 0.0)
        children = Path(f"/proc/{parent}/task/{parent}/children")
        try:
            numbers = children.read_text().split()
        except OSError:
            return
        for number in map(int, numbers):
            self.worker = max(self.worker, _peak_memory(number))
            self.seconds[number] = _processor_seconds(number) or self.seconds.get(number, 0.0)


def _peak_memory(process: int) -> float:
    """VmHWM of a process, MB; 0 if it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), 0.0)


def _processor_seconds(process: int) -> float:
    """User and system time of a process, s; 0 if it is gone."""
    try:
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def make_files(folder: Path) -> None:
    """Simulate the different frames."""
    loads = ", ".join(f"{0.004 + 2e-5 * number:.5f}" for number in range(FILES))
    (folder / "scene.toml").write_text(SCENE.format(loads=loads))
    if main(["simulate", str(folder / "scene.toml"), "-o", str(folder / "files"), "--quiet"]):
        sys.exit("the frames cannot be made")


def make_series(files: Path, folder: Path, count: int, background: str) -> None:
    """A series of links to the files."""
    folder.mkdir()
    frames = sorted(files.glob("frame_*.tif"))
    for number in range(count):
        (folder / f"frame_{number:06d}.tif").symlink_to(frames[number % len(frames)])
    for name in ("reference.tif", "asperities.csv"):
        shutil.copy(files / name, folder)
    text = (files / "scene.toml").read_text().replace('loads = "loads.csv"\n', "")
    (folder / "scene.toml").write_text(text.replace("[images]\n", f'[images]\nbackground = "{background}"\n'))


def run(folder: Path, out: Path, peak: Peak, *, stored: bool, until: int | None) -> int:
    """Process the series; end it when the store holds ``until`` frames. Return the exit code."""
    words = [sys.executable, __file__, "--process", str(folder), str(out), *(["--stored"] if stored else [])]
    child = subprocess.Popen(words)  # noqa: S603
    while child.poll() is None:
        peak.look(child.pid)
        if until is not None and _stored_frames(out / PARTS_FOLDER) >= until:
            child.send_signal(signal.SIGKILL)
        time.sleep(LOOK_EVERY_SECONDS)
    return child.returncode


def _stored_frames(store: Path) -> int:
    """Part files in a store."""
    return sum(1 for _ in store.iterdir()) if store.is_dir() else 0


def process(folder: str, out: str, *, stored: bool) -> int:
    """In a process of its own: the command."""
    if stored:
        measure = series.measure_scene_frame

        def measure_once(frame, reference, optics=None, *, options):
            # a worker gets a new copy of this function with every frame: what it keeps belongs to a module
            known = vars(importlib.import_module("contactimg.pipeline.series"))
            if "stored_part" not in known:
                known["stored_part"] = measure(frame, reference, optics, options=options)
            part = known["stored_part"]
            renamed = part.with_contacts(part.contacts.assign(frame=frame.name))
            return replace(renamed, row=part.row | {"frame": frame.name})

        series.measure_scene_frame = measure_once
    return main(["process", folder, "-o", out, "--workers", "2", "--no-pictures", "--quiet"])


def measure_length(top: Path, count: int, options: argparse.Namespace) -> str:
    """One line of the table."""
    folder, out, peak = top / f"series_{count}", top / f"out_{count}", Peak()
    make_series(top / "files", folder, count, "reference" if options.stored else options.background)
    start = time.monotonic()
    for share in KILLED_AT:
        run(folder, out, peak, stored=options.stored, until=int(share * count))
    code = run(folder, out, peak, stored=options.stored, until=None)
    seconds = time.monotonic() - start
    with (out / "frames.csv").open(newline="") as file:
        names = [row["frame"] for row in csv.DictReader(file)]
    right = code in (0, 1) and names == sorted(path.name for path in folder.glob("frame_*.tif"))
    shutil.rmtree(folder)
    state = "all frames once" if right else f"WRONG: exit code {code}, {len(names)} rows"
    return (
        f"{count:8d} {peak.parent:10.0f} {peak.worker:10.0f} {1000 * seconds / count:12.1f} "
        f"{1000 * sum(peak.seconds.values()) / count:12.1f} "
        f"{(out / 'contacts.csv').stat().st_size / 1e6:12.1f}  {state}"
    )


def parse() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, nargs="+", default=[1000, 10000])
    parser.add_argument("--stored", action="store_true", help="measure no frame but the first")
    parser.add_argument("--background", choices=["auto", "reference"], default="auto")
    parser.add_argument("--process", nargs=2, help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    options = parse()
    if options.process:
        sys.exit(process(*options.process, stored=options.stored))
    with tempfile.TemporaryDirectory() as name:
        make_files(Path(name))
        print(
            f"{'frames':>8s} {'parent MB':>10s} {'worker MB':>10s} {'ms a frame':>12s} {'CPU ms':>12s} "
            f"{'contacts MB':>12s}"
        )
        for length in options.frames:
            print(measure_length(Path(name), length, options), flush=True)
