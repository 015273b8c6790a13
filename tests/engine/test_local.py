"""A call that ends its process costs the others nothing, and is given up after a second time alone."""

import ctypes
import os
import signal
import sys
from concurrent.futures import Future
from contextlib import nullcontext
from functools import partial

import pytest
from small_calls import deadly_square, once_deadly, process_of
from small_series import copy_of

from contactimg import read_scene
from contactimg.engine import parallel
from contactimg.engine.cluster import WorkerEndedError
from contactimg.engine.parallel import in_parallel, sharing
from contactimg.engine.processes import ending_cleanly
from contactimg.errors import ContactimgError, InputError
from contactimg.files import open_experiment
from contactimg.pipeline import each_frame
from contactimg.pipeline.each_frame import FailedFrame, for_each_frame
from contactimg.timings import collect

COUNT = 30


def squares(function, lost=None):
    numbers = [(number,) for number in range(COUNT)]
    return list(in_parallel(function, numbers, count=COUNT, workers=2, lost=lost))


@pytest.mark.parametrize(("deadly", "timed"), [({COUNT - 1}, False), ({0, 17}, True)])
def test_calls_that_end_their_process_are_replaced_and_no_other(deadly, timed):
    with collect() if timed else nullcontext():
        found = squares(partial(deadly_square, deadly), lambda error, number: (number, str(error)))
    assert [found[k] for k in range(COUNT) if k not in deadly] == [
        k**2 for k in range(COUNT) if k not in deadly
    ]
    for number in deadly:
        assert found[number][0] == number
        assert found[number][1].startswith("ended its process, in the end with no other call beside it")


@pytest.mark.parametrize("workers", [0, -1, 2.5, "2"])
def test_workers_are_a_whole_number(workers):
    with pytest.raises(InputError, match=f"1 or more, or None, got {workers!r}"):
        in_parallel(abs, [(1,)], count=1, workers=workers)


def test_the_block_around_says_how_many_processes_share_the_calls():
    def processes():
        return set(in_parallel(process_of, [(0.05,)] * 8, count=8))

    assert processes() == {os.getpid()}
    with sharing(2):
        assert len(processes()) == 2
        with sharing(None):  # as around
            assert os.getpid() not in processes()
    assert processes() == {os.getpid()}


def test_no_more_processes_are_started_than_there_are_calls(monkeypatch):
    started, start = set(), parallel.get_reusable_executor

    def counting(*, max_workers, **options):
        started.add(max_workers)
        return start(max_workers=max_workers, **options)

    monkeypatch.setattr(parallel, "get_reusable_executor", counting)
    assert list(in_parallel(abs, [(-1,), (-2,)], count=2, workers=50)) == [1, 2]
    assert started == {2}


def test_a_process_ended_once_from_outside_costs_nothing(tmp_path):
    assert squares(partial(once_deadly, tmp_path)) == [k**2 for k in range(COUNT)]
    assert (tmp_path / "mark").exists()


class EndedOnce:
    """Workers, two of which are ended from outside before the first call is done."""

    def __init__(self):
        self.handed, self.broken = [], True

    def submit(self, function, name, number):
        future = Future()
        self.handed.append(number)
        self.broken &= number < parallel.AHEAD * 2 and self.handed.count(number) == 1
        if self.broken:
            future.set_exception(WorkerEndedError())
        else:
            future.set_result(function(name, number))
        return future

    processes, folder = (lambda _: 2), None
    wait, named = (lambda _, _futures: None), (lambda _, error: error)


def test_calls_that_ended_with_a_process_are_made_again_once_and_no_other():
    workers = EndedOnce()
    found = parallel._in_order(workers, partial(deadly_square, set()), ((k,) for k in range(COUNT)), None)
    assert list(found) == [k**2 for k in range(COUNT)]
    ended = set(range(parallel.AHEAD * 2))
    assert all(workers.handed.count(k) == (2 if k in ended else 1) for k in range(COUNT))


def test_without_a_replacement_the_error_is_raised_and_the_processes_work_again():
    with pytest.raises(ContactimgError, match="a worker process was ended from outside"):
        squares(partial(deadly_square, {3}))
    assert squares(partial(deadly_square, set())) == [k**2 for k in range(COUNT)]


def test_calls_that_all_end_their_process_are_not_tried_for_ever(monkeypatch):
    monkeypatch.setattr(parallel, "MOST_FAILURES", 2)
    given_up = []
    with pytest.raises(ContactimgError, match="a worker process was ended from outside"):
        squares(partial(deadly_square, set(range(COUNT))), lambda _error, number: given_up.append(number))
    assert len(given_up) == 1


def test_a_process_that_ends_while_a_call_is_handed_over_costs_nothing(monkeypatch):
    executor_of, broken = parallel.get_reusable_executor, []

    def broken_once(*args, **named):
        executor = executor_of(*args, **named)
        if not broken:
            broken.append(executor.submit(os.kill, executor.submit(os.getpid).result(), signal.SIGKILL))
            broken[0].exception()
        return executor

    monkeypatch.setattr(parallel, "get_reusable_executor", broken_once)
    assert squares(partial(deadly_square, set())) == [k**2 for k in range(COUNT)]
    assert broken


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def test_by_default_processes_are_started_only_if_that_saves_time(monkeypatch):
    def processes(count, seconds):
        with ending_cleanly():
            return list(in_parallel(process_of, [(seconds,)] * count, count=count, workers=None))

    monkeypatch.setattr(parallel, "cpu_count", lambda: 2)
    # at most 5 x 0.02 s x (1 - 1/2) = 0.05 s could be saved
    assert set(processes(6, 0.02)) == {os.getpid()}
    monkeypatch.setattr(parallel, "START_SECONDS", 0.1)
    found = processes(40, 0.02)  # 38 x 0.02 s x 1/2 = 0.38 s
    assert found[:2] == [os.getpid()] * 2
    assert os.getpid() not in found[2:]


def test_processes_end_with_the_command():
    with ending_cleanly():
        found = set(in_parallel(process_of, [(0.05,)] * 8, count=8, workers=2))
        assert all(map(is_running, found))
    assert not any(map(is_running, found))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("fails", [True, False])
def test_an_end_that_is_asked_for_within_a_callback_of_c_is_not_lost(
    small_series, tmp_path, monkeypatch, number, fails
):
    """Python discards what a signal raises there; the compiler, which has such, then fails or goes on."""
    monkeypatch.setattr(sys, "unraisablehook", lambda _: None)
    experiment, measured = open_experiment(read_scene(copy_of(small_series, tmp_path / "series"))), []

    def measure(frame, _reference):
        measured.append(frame.name)
        ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(number))()
        if fails:
            raise RuntimeError("no compiled object yet")
        return frame.name

    with pytest.raises(KeyboardInterrupt), ending_cleanly():
        list(for_each_frame(experiment, measure))
    assert measured == ["frame_1.tif"]


def test_a_frame_that_ended_its_process_fails_and_the_others_are_kept(small_series, monkeypatch):
    """What becomes of the frame; the tests above end processes, and `test_cluster.py` some with a frame."""

    def ending(function, jobs, *, lost, **_):
        for source, *more in jobs:
            ended = source.name == "frame_2.tif"
            yield lost(WorkerEndedError("ended its process"), source) if ended else function(source, *more)

    monkeypatch.setattr(each_frame, "in_parallel", ending)
    experiment = open_experiment(read_scene(small_series))
    parts = list(for_each_frame(experiment, lambda frame, _reference: frame.name))
    assert len(parts) == 3
    assert (parts[0], parts[2]) == ("frame_1.tif", "frame_3.tif")
    assert isinstance(parts[1], FailedFrame)
    assert parts[1].row["message"].startswith("frame_2.tif: its measurement ended its process")
