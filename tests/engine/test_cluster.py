"""A cluster of a scheduler and workers on this machine: equal results, and every part killed."""

import time
from contextlib import ExitStack
from functools import partial

import pandas as pd
import pytest
from local_cluster import TIME_LIMIT_S, LocalCluster, files_of, start, wait_until
from small_calls import deadly_frame, refused, slow_square
from stored_results import stored_results

from contactimg import InputError, solve_ensemble
from contactimg.cli import main
from contactimg.engine import cluster as cluster_module
from contactimg.engine.cluster import PATIENCE, ClusterError, on_cluster
from contactimg.engine.parallel import in_parallel
from contactimg.files import open_experiment, read_scene
from contactimg.pipeline.analyse.places import grouped, open_place, predict_places
from contactimg.pipeline.each_frame import FailedFrame, for_each_frame

dask = pytest.importorskip("dask")
pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    with ExitStack() as stack:
        # a worker that measures frames loads all machine code first: one is enough for that
        yield LocalCluster(stack, tmp_path_factory.mktemp("cluster") / "parts", workers=1)


def test_commands_give_the_same_bytes(parts, tiny_series, tmp_path, monkeypatch):
    monkeypatch.chdir(tiny_series.parent)  # relative paths hold on the workers too
    here, there = tmp_path / "here", tmp_path / "there"
    commands = {
        "process": ["process", tiny_series.name, "--pictures"],
        "simulate": ["simulate", tiny_series.name],
        "predict": ["predict", tiny_series.name, "--load-N", "0.002", "--load-N", "0.004"],
    }
    for folder, options in ((here, ["--workers", "1"]), (there, ["--cluster", str(parts.file)])):
        for name, words in commands.items():
            assert main([*words, "-o", str(folder / name), "--quiet", *options]) == 0, name
    found = files_of(there)
    assert {name.split("/")[0] for name in found} == set(commands)
    assert sum(name.startswith("process/overlays/") for name in found) == 3
    assert found == files_of(here)
    place = grouped([open_place(here / "process")], tolerance=0.05)
    with on_cluster(str(parts.file)):  # what `analyse` computes besides sums and figures
        (one,), _ = predict_places(place, "coupled")
    (other,), _ = predict_places(place, "coupled")
    pd.testing.assert_frame_equal(one.contacts, other.contacts, check_exact=True)


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
    with on_cluster(str(parts.file)):
        with pytest.raises(InputError, match="2 is odd"):
            list(in_parallel(refused, [(2,)], count=1, workers=None))
        with pytest.raises(ClusterError, match="has No module named 'no_such_library'; install"):
            list(in_parallel(refused, [(-1,)], count=1, workers=None))


def test_another_version_on_a_worker_is_refused(parts, monkeypatch):
    monkeypatch.setattr(cluster_module, "installation", lambda: {"numpy": "0.1"})
    with (
        on_cluster(str(parts.file)),
        pytest.raises(ClusterError, match=r"numpy 0.1 against .*install the same"),
    ):
        list(in_parallel(refused, [(2,)], count=1, workers=None))


def test_a_killed_worker_costs_nothing_but_time(parts, tmp_path):
    spare = parts.start_worker()

    def started():
        return {path.read_text() for path in tmp_path.iterdir()}

    with on_cluster(str(parts.file)) as cluster:
        wait_until(lambda: cluster.processes() == 2)
        results = in_parallel(
            partial(slow_square, tmp_path), [(k,) for k in range(30)], count=30, workers=None
        )
        first = next(results)
        wait_until(lambda: str(spare.pid) in started())
        spare.kill()
        # without the second attempt the calls that were on the worker would be given up
        assert [first, *results] == [k**2 for k in range(30)]


def test_no_call_waits_for_a_result_that_a_worker_may_lose(parts, tmp_path, monkeypatch):
    def look(dask_scheduler):
        return [len(task.dependencies) for task in dask_scheduler.tasks.values()]

    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    with on_cluster(str(parts.file)) as cluster:
        call = partial(slow_square, tmp_path)
        results = in_parallel(call, [(k,) for k in range(12)], count=12, workers=None)
        assert next(results) == 0
        needed = cluster.client.run_on_scheduler(look)
        assert needed
        assert not any(needed)
        assert len(list(here.iterdir())) == 1  # the function
        assert list(results) == [k**2 for k in range(1, 12)]
    assert not list(here.iterdir())


def test_the_client_killed_and_the_run_taken_up(parts, tiny_series, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)  # a killed client leaves the file of its function there
    out, options = tmp_path / "out", ["--no-pictures", "--quiet", "--cluster", str(parts.file)]
    words = ["process", str(tiny_series), "-o"]
    with ExitStack() as stack:
        first = start(stack, "contactimg", *words, str(out), *options)
        wait_until(lambda: stored_results(out))
        first.kill()
        first.wait()
    assert not (out / "contacts.csv").exists()
    assert main([*words, str(out), *options]) == 0
    assert "of 3 frames were done by a run that was ended" in capfd.readouterr().err
    assert main([*words, str(tmp_path / "whole"), *options[:2], "--workers", "1"]) == 0
    assert files_of(out) == files_of(tmp_path / "whole")


def test_a_frame_that_ends_its_workers_fails_and_the_others_are_kept(parts, tiny_series):
    experiment = open_experiment(read_scene(tiny_series))
    parts.workers += [parts.start_worker(), parts.start_worker()]
    with on_cluster(str(parts.file)) as cluster:
        wait_until(lambda: cluster.processes() == 3)
        first, lost, last = for_each_frame(experiment, deadly_frame)
    assert (first, last) == ("frame_1.tif", "frame_3.tif")
    assert isinstance(lost, FailedFrame)
    assert lost.row["status"] == "failed"
    assert lost.row["message"].startswith("frame_2.tif: its measurement ended every worker of the cluster")
    # among others it is tried once, and once alone
    wait_until(lambda: sum(worker.poll() is None for worker in parts.workers) == 1)


def test_without_workers_or_scheduler_a_run_ends(parts, tmp_path, capfd):
    """The last test of the cluster: it ends the workers and the scheduler."""

    def squares(count):
        return in_parallel(
            partial(slow_square, tmp_path), [(k,) for k in range(count)], count=2, workers=None
        )

    for worker in parts.workers:
        worker.kill()
    with on_cluster(str(parts.file)) as cluster, dask.config.set({PATIENCE: "1s"}):
        wait_until(lambda: not cluster.client.nthreads())
        with pytest.raises(ClusterError, match="has had no worker for 1s"):
            list(squares(1))
    parts.start_worker()
    with on_cluster(str(parts.file)):
        results = squares(1000)
        assert [next(results), next(results)] == [0, 1]
        parts.scheduler.kill()
        begin = time.monotonic()
        with pytest.raises(ClusterError, match=r"cannot go on \(.*start it and the same command again"):
            list(results)
    assert time.monotonic() - begin < TIME_LIMIT_S
    with dask.config.set({PATIENCE: "1s"}):
        assert main(["process", str(tmp_path), "--cluster", "tcp://127.0.0.1:9"]) == 2
    assert "no scheduler answers at tcp://127.0.0.1:9" in capfd.readouterr().err
    assert main(["process", str(tmp_path), "--cluster", "nothing.json"]) == 2
    assert "no such scheduler file" in capfd.readouterr().err
