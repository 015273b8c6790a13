"""End commands at random moments, over an earlier result, and look at what is left (Linux).

    python tests/crash/kill_runs.py --count 200 --seed 7

A command runs over the result of an earlier run with other
options and gets SIGKILL, SIGTERM or SIGINT: after a random time, or before a random one of its operations on
files in the output folder. Then: is the folder, as the next command reads it, the earlier or the new result;
does a process live 2 s later; does the same command, run again, give the files of an undisturbed run and
leave no temporary file? Exit code 1 if a case fails.
"""

import argparse
import hashlib
import importlib
import json
import os
import pkgutil
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

import contactimg
from contactimg.cli import main
from contactimg.files import finish_commit

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
OPERATIONS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod"}
MARK = "CONTACTIMG_KILL_CASE"
OLD_TIME = 1e9  # of the files of the earlier result
ORPHAN_SECONDS = 2.0
LIMIT_SECONDS = 120.0

SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0004, 0.0003]},
    "elastic": {"young_modulus_Pa": 3.0e6, "young_modulus_std_Pa": 0.03e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.0008, "seed": 3},
    "camera": {"pixel_size_m": 6.0e-6},
    "simulate": {
        "loads_N": [0.002, 0.004, 0.008],
        "shape": [90, 120],
        "blur_px": 1.4,
        "electrons_per_level": 20,
        "read_noise_electrons": 10,
        "seed": 7,
    },
}
SMOOTH = {
    "indenter": {"radius_m": 0.01},
    "elastic": {"young_modulus_Pa": 2.0e6, "work_of_adhesion_J_m2": 0.03},
    "camera": {"pixel_size_m": 6.0e-6},
    "simulate": SCENE["simulate"] | {"loads_N": [2e-4, 4e-4, 6e-4, 8e-4, 1e-3], "shape": [120, 130]},
}


@dataclass
class Command:
    """A command with the options of the earlier and of the killed run; ``{in}`` is the folder of inputs."""

    name: str
    before: list[str]
    killed: list[str]
    needs: str = ""
    seconds: float = 0.0
    operations: int = 0
    code: int = 0
    files: dict[str, str] = field(default_factory=dict)
    volatile: set[str] = field(default_factory=set)


COMMANDS = [
    Command(
        "simulate", ["simulate", "{in}/scene.toml", "-o", "out"], ["simulate", "{in}/other.toml", "-o", "out"]
    ),
    Command(
        "process",
        ["process", "{in}/frames", "-o", "out", "--workers", "2", "--method", "threshold"],
        ["process", "{in}/frames", "-o", "out", "--workers", "2"],
    ),
    Command(
        "parquet",
        ["process", "{in}/frames", "-o", "out", "--workers", "2"],
        ["process", "{in}/frames", "-o", "out", "--workers", "2", "--format", "parquet"],
    ),
    Command(
        "predict",
        ["predict", "{in}/scene.toml", "--load-N", "0.002", "-o", "out"],
        ["predict", "{in}/scene.toml", "--load-N", "0.004", "--load-N", "0.008", "-o", "out"],
    ),
    Command(
        "overlay",
        ["overlay", "{in}/run", "-o", "out", "--workers", "1", "--min-radius-px", "0.5"],
        ["overlay", "{in}/run", "-o", "out", "--workers", "1"],
    ),
    Command(
        "effects",
        ["effects", "{in}/scene.toml", "-o", "out", "--tolerance", "0.01"],
        ["effects", "{in}/scene.toml", "-o", "out", "--tolerance", "0.1"],
    ),
    Command(
        "tradeoff",
        ["tradeoff", "{in}/scene.toml", "-o", "out", "--knob", "model", "--tolerance", "0.02"],
        ["tradeoff", "{in}/scene.toml", "-o", "out", "--knob", "model"],
    ),
    Command(
        "analyse",
        ["analyse", "{in}/run", "-o", "out", "--annulus-mm", "0.1"],
        ["analyse", "{in}/run", "-o", "out", "--annulus-mm", "0.05"],
    ),
    Command(
        "calibrate",
        [
            "calibrate",
            "jkr",
            "{in}/smooth",
            "-o",
            "out",
            "--workers",
            "2",
            "--scene",
            "{in}/smooth/scene.toml",
        ],
        ["calibrate", "jkr", "{in}/smooth", "-o", "out", "--workers", "2"],
    ),
    Command(
        "report",
        ["report", "{in}/run", "-o", "out/report.html", "--max-pictures", "1"],
        ["report", "{in}/run", "-o", "out/report.html", "--max-pictures", "2"],
    ),
]


@dataclass(frozen=True)
class Stop:
    """A signal, after a time or before a file operation (counted from 1)."""

    signal: signal.Signals
    after: float | None = None
    operation: int | None = None


def run(arguments: list[str], work: Path, *, stop: Stop | None = None, mark: str = "") -> tuple[int, int]:
    """Run a command in a child; return its wait status and, if it ended by itself, its file operations."""
    inputs, reader_writer = work.parent / "in", os.pipe()
    child = os.fork()
    if child == 0:
        _be_the_command(
            [item.replace("{in}", str(inputs)) for item in arguments], work, stop, mark, reader_writer[1]
        )
    os.close(reader_writer[1])
    if stop is not None and stop.after is not None:
        time.sleep(stop.after)
        os.kill(child, stop.signal)
    status = _wait(child)
    with os.fdopen(reader_writer[0], "rb") as pipe:
        count = pipe.read()
    return status, int(count or 0)


def _wait(child: int) -> int:
    """The wait status of a child; one that does not end is killed and counts as -1."""
    limit = time.monotonic() + LIMIT_SECONDS
    while time.monotonic() < limit:
        process, status = os.waitpid(child, os.WNOHANG)
        if process:
            return status
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -1


def _be_the_command(arguments: list[str], work: Path, stop: Stop | None, mark: str, writer: int) -> None:
    """In the child: run the command line and end."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    os.chdir(work)
    os.environ |= {MARK: mark, "TMPDIR": str(work / "tmp"), "JOBLIB_TEMP_FOLDER": str(work / "tmp")}
    tempfile.tempdir = None
    nowhere = os.open(os.devnull, os.O_RDWR)
    if not os.environ.get("KILL_RUNS_SHOW"):
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
    os.set_inheritable(writer, False)
    out, count = str(work / "out"), 0

    def count_operation(event: str, values: tuple[object, ...]) -> None:
        nonlocal count
        if event not in OPERATIONS:
            return
        inside = isinstance(values[0], str | os.PathLike) and os.path.abspath(values[0]).startswith(out)  # noqa: PTH100
        if inside:
            count += 1
            if stop is not None and stop.operation == count:
                os.kill(os.getpid(), stop.signal)

    code = 99
    try:
        sys.addaudithook(count_operation)
        code = main(arguments)
        os.write(writer, str(count).encode())
        # what a Python process does at its end: loky's workers are told to go
        from loky.process_executor import _python_exit

        _python_exit()
    finally:
        os._exit(code)


def content(out: Path) -> dict[str, str]:
    """File -> digest; of provenance.json without the time."""
    files = {}
    for path in _visible(out):
        data = path.read_bytes()
        if path.name == "provenance.json":
            data = json.dumps(json.loads(data) | {"created": ""}).encode()
        files[path.relative_to(out).as_posix()] = hashlib.sha256(data).hexdigest()
    return files


def _visible(out: Path) -> list[Path]:
    """Files that are not hidden or in a hidden folder."""
    files = [path for path in out.rglob("*") if path.is_file()]
    return [path for path in files if not any(part.startswith(".") for part in path.relative_to(out).parts)]


def living(mark: str) -> list[int]:
    """Processes of a case."""
    wanted, found = f"{MARK}={mark}".encode(), []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                data = (folder / "environ").read_bytes()
            except OSError:
                continue
            if wanted in data.split(b"\0"):
                found.append(int(folder.name))
    return found


def prepare(top: Path) -> None:
    """Make the inputs, and the earlier and the undisturbed result of every command."""
    inputs = top / "in"
    inputs.mkdir()
    (inputs / "scene.toml").write_text(tomli_w.dumps(SCENE))
    other = SCENE | {"simulate": SCENE["simulate"] | {"seed": 8, "loads_N": [0.001, 0.002, 0.004]}}
    (inputs / "other.toml").write_text(tomli_w.dumps(other))
    (inputs / "smooth.toml").write_text(tomli_w.dumps(SMOOTH))
    first = top / "first"
    (first / "tmp").mkdir(parents=True)
    for arguments in (
        ["simulate", "{in}/scene.toml", "-o", "{in}/frames"],
        ["simulate", "{in}/smooth.toml", "-o", "{in}/smooth"],
        ["process", "{in}/frames", "-o", "{in}/run", "--workers", "2"],
    ):
        status, _ = run(arguments, first)
        if os.waitstatus_to_exitcode(status) != 0:
            sys.exit(f"cannot be prepared: {arguments}")


def prepare_command(command: Command, top: Path) -> None:
    """Make its earlier result, and learn what an undisturbed run takes and writes."""
    earlier = top / f"{command.name}_earlier"
    (earlier / "tmp").mkdir(parents=True)
    (earlier / "out").mkdir()
    run(command.before, earlier)
    for path in earlier.rglob("*"):
        os.utime(path, (OLD_TIME, OLD_TIME))
    results = []
    for number in range(2):
        work = top / f"{command.name}_whole{number}"
        shutil.copytree(earlier, work)
        start = time.monotonic()
        status, command.operations = run(command.killed, work)
        command.seconds = time.monotonic() - start
        command.code = os.waitstatus_to_exitcode(status)
        results.append(content(work / "out"))
    command.files = results[0]
    command.volatile = {name for name in results[0] if results[0][name] != results[1].get(name)}
    if command.code not in (0, 1) or not command.operations:
        sys.exit(f"{command.name}: exit code {command.code}, {command.operations} file operations")


def faults_of(command: Command, top: Path, number: int, stop: Stop) -> tuple[list[str], str]:
    """What is wrong after a killed run, and which result stands."""
    work, mark = top / f"case{number}", f"{os.getpid()}_{number}"
    shutil.copytree(top / f"{command.name}_earlier", work)
    earlier = content(work / "out")
    faults = []
    if run(command.killed, work, stop=stop, mark=mark)[0] == -1:
        faults.append("does not end")
    limit = time.monotonic() + ORPHAN_SECONDS
    while (left := living(mark)) and time.monotonic() < limit:
        time.sleep(0.05)
    if left:
        faults.append("orphans")
    for process in left:
        os.kill(process, signal.SIGKILL)
    finish_commit(work / "out")
    state = _state(command, work / "out", earlier)
    if state == "mix":
        faults.append("mix")
    status, _ = run(command.killed, work)
    if os.waitstatus_to_exitcode(status) != command.code or _state(command, work / "out", earlier) != "new":
        faults.append("next run")
    if any(work.rglob(".*")) or any((work / "tmp").iterdir()):
        faults.append("temporary files")
    if not faults:
        shutil.rmtree(work)
    return faults, state


def _state(command: Command, out: Path, earlier: dict[str, str]) -> str:
    """Whether the files are those of the earlier run, of an undisturbed one, or something else."""
    found = content(out)
    old = {path.stat().st_mtime == OLD_TIME for path in _visible(out)}
    if found == earlier and old == {True}:
        return "earlier"
    same = all(
        found.get(name) == digest for name, digest in command.files.items() if name not in command.volatile
    )
    return "new" if old == {False} and same and set(found) == set(command.files) else "mix"


def draw(command: Command, rng: np.random.Generator, signals: Sequence[signal.Signals]) -> Stop:
    """A signal at a random moment of the command, or before a random one of its file operations."""
    number = signals[rng.integers(len(signals))]
    if rng.random() < 0.5:
        return Stop(number, operation=int(rng.integers(1, command.operations + 1)))
    return Stop(number, after=float(rng.uniform(0.0, command.seconds)))


def _shares(commands: list[Command]) -> NDArray[np.float64]:
    """How often each command is taken: slow ones less often."""
    shares = np.array([command.seconds**-0.5 for command in commands])
    return shares / shares.sum()


def run_cases(options: argparse.Namespace, top: Path, report: Callable[[str], None]) -> int:
    """Run the cases and print the counts; return the number of cases with a fault."""
    prepare(top)
    commands = [command for command in COMMANDS if not options.command or command.name in options.command]
    for command in commands:
        prepare_command(command, top)
        report(f"{command.name}: {command.seconds:.1f} s, {command.operations} file operations")
    counts: Counter[tuple[str, str, str]] = Counter()
    bad = 0
    for number in range(options.first, options.first + options.count):
        rng = np.random.default_rng([options.seed, number])
        command = commands[rng.choice(len(commands), p=_shares(commands))]
        signals = [signal.Signals[name] for name in options.signal or []]
        stop = draw(command, rng, signals or SIGNALS)
        faults, state = faults_of(command, top, number, stop)
        name = stop.signal.name
        counts[command.name, name, "killed"] += 1
        counts[command.name, name, state] += 1
        counts.update((command.name, name, fault) for fault in faults)
        bad += bool(faults)
        if faults:
            report(f"case {number}: {command.name}, {stop}: {', '.join(faults)}")
    kinds = sorted({kind for _, _, kind in counts})
    report(f"{'command':10s} {'signal':8s}" + "".join(f"{kind:>16s}" for kind in kinds))
    for command, name in sorted({key[:2] for key in counts}):
        report(f"{command:10s} {name:8s}" + "".join(f"{counts[command, name, kind]:16d}" for kind in kinds))
    report(f"{options.count} cases of seed {options.seed}: {bad} with a fault")
    return bad


def preload() -> None:
    """Import every module of the package once, for all children."""
    for module in pkgutil.walk_packages(contactimg.__path__, "contactimg."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def parse() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--command", action="append", help="only this command; repeat the option for more")
    names = [number.name for number in SIGNALS]
    parser.add_argument("--signal", action="append", choices=names, help="only this signal; repeat for more")
    parser.add_argument("--keep", action="store_true", help="keep the folders of cases with a fault")
    return parser.parse_args()


if __name__ == "__main__":
    preload()
    place = Path(tempfile.mkdtemp(prefix="kill_runs_"))
    try:
        failed = run_cases(parse(), place, lambda line: print(line, flush=True))  # noqa: T201
    finally:
        if not parse().keep:
            shutil.rmtree(place, ignore_errors=True)
    sys.exit(int(failed > 0))
