"""Kill each part of a cluster in mid-run with SIGKILL, and look at what is left.

    python tests/crash/kill_cluster.py --rounds 3 --seed 7

A scheduler and two workers on this machine take the work of `process`. A worker, the command or the scheduler
is killed at a random time. A run that lost a worker must give the files of `--workers 1`; the others must end
within a minute, by themselves or because they were killed, and give these files when they are started again.
Exit code 1 if a case fails.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
from local_cluster import TIME_LIMIT_S, LocalCluster, files_of, wait_until
from small_series import SCENE
from stored_results import stored_results

from contactimg.cli import main
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict

VICTIMS = ("worker", "command", "scheduler")
FRAMES = 12
START_LIMIT_S = 300.0  # kernels may have to be compiled
SERIES = SCENE | {
    "simulate": SCENE["simulate"] | {"loads_N": np.linspace(0.004, 0.05, FRAMES).tolist()},
}
COMMANDS = {
    "process": ["process", "series", "--no-pictures"],
}


def begin(words: list[str]) -> subprocess.Popen:
    """The command in a process of its own."""
    environment = os.environ | {"PYTHONWARNINGS": "ignore"}
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "contactimg", *words],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def case(name: str, victim: str, expected: dict[str, bytes], rng: np.random.Generator) -> tuple[str, float]:
    """What is wrong after one kill, or nothing, and how long the command then took (s)."""
    with tempfile.TemporaryDirectory() as top, ExitStack() as stack:
        out, parts = Path(top) / "out", LocalCluster(stack, Path(top) / "parts", failures=3)
        words = [*COMMANDS[name], "-o", str(out), "--quiet", "--cluster"]
        command = begin([*words, str(parts.file)])
        stack.callback(command.kill)
        wait_until(lambda: stored_results(out) or command.poll() is not None, START_LIMIT_S)
        time.sleep(rng.uniform(0.0, 1.0))
        if command.poll() is not None:
            return "it ended before anything was killed", 0.0
        {"worker": parts.workers[0], "command": command, "scheduler": parts.scheduler}[victim].kill()
        start = time.monotonic()
        try:
            _, said = command.communicate(timeout=TIME_LIMIT_S)
        except subprocess.TimeoutExpired:
            return "it hangs", TIME_LIMIT_S
        seconds = time.monotonic() - start
        if victim == "worker":
            wrong = "" if command.returncode == 0 and files_of(out) == expected else f"other files; {said}"
            return wrong, seconds
        if victim == "scheduler" and (
            command.returncode != 2 or "Traceback" in said or "start it" not in said
        ):
            return f"it does not end with a sentence: {said}", seconds
        if any(out.glob("*.csv")):
            return "it left a part of a result", seconds
        if victim == "scheduler":
            parts = LocalCluster(stack, Path(top) / "again", failures=3)
        again = begin([*words, str(parts.file)])
        stack.callback(again.kill)
        _, said = again.communicate(timeout=2 * TIME_LIMIT_S)
        if "were done by a run that was ended" not in said:
            return f"it begins anew: {said}", seconds
        return "" if again.returncode == 0 and files_of(out) == expected else f"other files; {said}", seconds


def run(rounds: int, seed: int) -> int:
    """The number of cases that fail."""
    rng, failed = np.random.default_rng(seed), 0
    with tempfile.TemporaryDirectory() as top:
        os.chdir(top)
        scene = scene_from_dict(SERIES)
        for name in ("series",):
            Path(name).mkdir()
        write_simulation(scene, need_asperities(scene, "a test"), Path("series"))
        for name, words in COMMANDS.items():
            if main([*words, "-o", f"whole_{name}", "--quiet", "--workers", "1"]) != 0:
                return 1
            expected = files_of(Path(f"whole_{name}"))
            for victim in VICTIMS * rounds:
                wrong, seconds = case(name, victim, expected, rng)
                failed += bool(wrong)
                line = f"{name}, {victim} killed: {wrong or 'well'}, ended {seconds:.1f} s later"
                print(line, flush=True)  # noqa: T201
    return failed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=1, help="kills of each part, for each command")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.exit(bool(run(options.rounds, options.seed)))
