"""A cluster of a scheduler and two workers on this machine: equal results, with workers or command killed."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest
from small_series import SCENE

from contactimg import InputError, solve_ensemble
from contactimg.cli import main
from contactimg.engine.calls import in_parallel
from contactimg.engine.cluster import on_cluster
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict

pytest.importorskip("distributed")

MODULE = Path(__file__).parent
TIME_LIMIT_S = 60.0
TINY = SCENE | {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0004, 0.0003]},
    "asperities": SCENE["asperities"] | {"side_m": 0.0008},
    "simulate": SCENE["simulate"] | {"loads_N": [0.002, 0.004, 0.008], "shape": [90, 120]},
}
QUIET = {"PYTHONWARNINGS": "ignore"}


def start(stack, *arguments, **variables):
    """A process of the cluster, ended with the stack."""
    paths = os.pathsep.join([str(MODULE.parents[1]), str(MODULE), str(MODULE.parent / "helpers")])
    environment = os.environ | QUIET | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"} | variables
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def end():
        for number in (signal.SIGTERM, signal.SIGKILL):
            try:
                os.killpg(process.pid, number)
                process.wait(3)
            except (ProcessLookupError, subprocess.TimeoutExpired):
                pass
        process.wait(10)

    stack.callback(end)
    return process


def wait_until(condition, seconds=TIME_LIMIT_S):
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, "does not happen"
        time.sleep(0.02)


def start_scheduler(stack, folder):
    file = folder / "scheduler.json"
    options = ["--port", "0", "--no-dashboard", "--host", "127.0.0.1", "--scheduler-file", str(file)]
    return start(stack, "distributed.cli.dask_scheduler", *options), file


def start_worker(stack, file, folder):
    options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder)]
    return start(stack, "distributed.cli.dask_worker", "--scheduler-file", str(file), *options)


class Parts:
    """Scheduler and workers."""

    def __init__(self, stack, folder):
        folder.mkdir()
        self.stack, self.folder = stack, folder
        self.scheduler, self.file = start_scheduler(stack, folder)
        wait_until(self.file.exists)
        self.workers = [start_worker(stack, self.file, folder) for _ in range(2)]


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    with ExitStack() as stack:
        yield Parts(stack, tmp_path_factory.mktemp("cluster") / "parts")


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    """Three frames of 120 x 90 pixels."""
    folder, scene = tmp_path_factory.mktemp("tiny") / "series", scene_from_dict(TINY)
    folder.mkdir()
    write_simulation(scene, need_asperities(scene, "a test"), folder)
    return folder


def slow_square(folder, number):
    """The square; says that it has begun, in a file with the process number."""
    (folder / f"{number}").write_text(str(os.getpid()))
    time.sleep(0.1)
    return number**2


def fail(number):
    raise InputError(f"{number} is odd")


def files_of(folder):
    """Name -> bytes of what a command wrote, without the record of when and how."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "provenance.json"
    }


def test_commands_give_the_same_bytes(parts, series, tmp_path, monkeypatch):
    monkeypatch.chdir(series.parent)  # relative paths hold on the workers too
    commands = {
        "process": ["process", series.name, "--no-pictures"],
        "simulate": ["simulate", series.name],
        "predict": ["predict", series.name, "--load-N", "0.002", "--load-N", "0.004"],
    }
    found = {}
    for place, options in (("here", ["--workers", "1"]), ("there", ["--cluster", str(parts.file)])):
        for name, words in commands.items():
            assert main([*words, "-o", str(tmp_path / place / name), "--quiet", *options]) == 0, name
        found[place] = files_of(tmp_path / place)
    assert len(found["there"]) > 12
    assert found["there"] == found["here"]


def test_an_ensemble_goes_to_the_cluster_and_can_go_on(parts):
    where = {"side": 4e-3, "indenter_radius": 0.1288, "contact_modulus": 4e6, "seed": 1, "loads": [0.02]}
    whole = list(solve_ensemble("SA", patterns=3, **where))
    with on_cluster(str(parts.file)):
        rest = list(solve_ensemble("SA", patterns=3, first=1, **where))
    assert [member.index for member in rest] == [1, 2]
    for one, other in zip(whole[1:], rest, strict=True):
        for key, solution in one.solutions.items():
            assert solution.force.tobytes() == other.solutions[key].force.tobytes()


def test_an_error_of_a_call_is_raised_here(parts):
    with on_cluster(str(parts.file)), pytest.raises(InputError, match="2 is odd"):
        list(in_parallel(fail, [(2,)], count=1, workers=None))


def test_a_killed_worker_costs_nothing_but_time(parts, tmp_path):
    spare = start_worker(parts.stack, parts.file, parts.folder)

    def started():
        return {path.read_text() for path in tmp_path.iterdir()}

    with on_cluster(str(parts.file)) as cluster:
        wait_until(lambda: cluster.processes() == 3)
        results = in_parallel(
            partial(slow_square, tmp_path), [(k,) for k in range(30)], count=30, workers=None
        )
        first = next(results)
        wait_until(lambda: str(spare.pid) in started())
        spare.kill()
        assert [first, *results] == [k**2 for k in range(30)]


def client(stack, series, file, out, **variables):
    words = ["contactimg", "process", str(series), "-o", str(out), "--no-pictures", "--cluster", str(file)]
    return start(stack, *words, **variables)


def test_the_client_killed_and_the_run_taken_up(parts, series, tmp_path, capfd):
    out = tmp_path / "out"
    with ExitStack() as stack:
        first = client(stack, series, parts.file, out)
        wait_until(lambda: any(out.rglob("frames.txt")))
        first.kill()
        first.wait()
    assert not (out / "contacts.csv").exists()
    words = ["process", str(series), "--no-pictures", "--quiet", "-o"]
    assert main([*words, str(out), "--cluster", str(parts.file)]) == 0
    assert "of 3 frames were done by a run that was ended" in capfd.readouterr().err
    assert main([*words, str(tmp_path / "whole"), "--workers", "1"]) == 0
    assert files_of(out) == files_of(tmp_path / "whole")
