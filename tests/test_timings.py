"""Stages add up to the time that passed, those of worker processes are added, and off they cost nothing."""

import re
import time
from collections import Counter

import click
import pytest
from loky import get_reusable_executor

from contactimg import timings as module
from contactimg.cli import main
from contactimg.engine.parallel import in_parallel
from contactimg.timings import OTHER, WAITING, Timings, collect, stage


def spend(seconds):
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def is_collecting():
    """Whether a stage would find somebody who collects."""
    return module._collector.get() is not None


@stage("working")
def work(seconds):
    spend(seconds)
    return seconds


def test_inner_stages_are_taken_out_of_outer_ones_and_all_add_up():
    start = time.perf_counter()
    with collect() as timings:
        with stage("outer"):
            spend(0.02)
            with stage("inner"):
                spend(0.03)
            spend(0.01)
        spend(0.005)
    passed = time.perf_counter() - start
    # spending is exact from below; a busy machine only adds
    assert timings.seconds["inner"] >= 0.03
    assert timings.seconds["outer"] >= 0.03
    assert timings.seconds[OTHER] >= 0.005
    assert sum(timings.seconds.values()) <= passed
    # the clock is read once for the end of one stage and the start of the next: only this test's own two
    # readings lie outside
    assert sum(timings.seconds.values()) == pytest.approx(passed, abs=2e-3)
    assert timings.calls == Counter(outer=1, inner=1)


def test_a_stage_may_be_entered_in_itself():
    @stage("deep")
    def descend(levels):
        return 0 if levels == 0 else 1 + descend(levels - 1)

    with collect() as timings:
        assert descend(3) == 3
    assert timings.calls["deep"] == 4


def test_a_stage_ends_with_an_error():
    with collect() as timings:
        with pytest.raises(ZeroDivisionError), stage("failing"):
            raise ZeroDivisionError
        with stage("after"):
            spend(0.01)
    assert timings.seconds["after"] >= 0.01
    assert timings.seconds["failing"] < 0.01


def test_nothing_is_collected_unless_asked_for():
    assert not is_collecting()
    work(0.0)
    with collect() as timings:
        assert is_collecting()
    work(0.0)
    assert not timings.calls


def test_a_stage_that_nobody_collects_costs_microseconds():
    def loop(count=2000):
        start = time.perf_counter()
        for _ in range(count):
            with stage("idle"):
                pass
        return (time.perf_counter() - start) / count

    # about 0.3 us on a quiet core; a stage stands for a millisecond or more
    assert min(loop() for _ in range(5)) < 1e-5


@pytest.fixture
def own_processes():
    """Worker processes that no other test meets: loky takes what these load later for a leak and warns."""
    get_reusable_executor().shutdown(wait=True)
    yield
    get_reusable_executor().shutdown(wait=True)


@pytest.mark.usefixtures("own_processes")
def test_the_stages_of_processes_are_added():
    with collect() as timings:
        results = list(in_parallel(work, [(0.05,)] * 4, count=4, workers=2))
    assert results == [0.05] * 4
    assert timings.calls["working"] == 4
    assert timings.seconds["working"] >= 0.2
    assert timings.seconds[WAITING] >= 0.1  # two processes share them


def test_one_process_waits_for_no_other():
    with collect() as timings:
        list(in_parallel(work, [(0.01,)] * 3, count=3, workers=None))
    assert timings.calls["working"] == 3
    assert timings.seconds["working"] >= 0.03
    assert WAITING not in timings.seconds


def test_rows_are_sorted_with_the_rest_last():
    timings = Timings()
    timings.seconds.update({"short": 1.0, OTHER: 5.0, "long": 2.0})
    assert [row[0] for row in timings.rows()] == ["long", "short", OTHER]


ROW = re.compile(r"^ ?(\S.*?)  +(?:(\d+) +)?([\d.]+) +[\d.]+%", re.MULTILINE)


def printed(text):
    """Stage -> (calls, seconds) of the table, and the total."""
    stages = {name: (int(calls or 0), float(seconds)) for name, calls, seconds in ROW.findall(text)}
    return stages, stages.pop("total")[1]


def test_process_prints_its_stages(small_series, tmp_path, capsys):
    out = str(tmp_path / "out")
    assert main(["process", str(small_series), "-o", out, "--quiet", "--timings", "--workers", "1"]) == 0
    stages, total = printed(capsys.readouterr().err)
    named = {"reading", "registration", "light", "detection", "fit", "pose", "forces", "pictures", "writing"}
    assert named <= set(stages)
    assert stages["quality"][0] >= 3  # some frames are measured again with what others show
    assert stages["forces"][0] == 1  # a block of frames; the pictures take them from the tables
    # printed with three decimals: half a millisecond a line
    seconds = sum(seconds for _, seconds in stages.values())
    assert seconds == pytest.approx(total, abs=5e-4 * (len(stages) + 1))


def test_predict_prints_its_stages(small_series, tmp_path, capsys):
    arguments = ["predict", str(small_series), "--load-N", "0.02", "-o", str(tmp_path / "out")]
    assert main([*arguments, "--quiet", "--timings"]) == 0
    stages, _ = printed(capsys.readouterr().err)
    assert {"candidates", "Newton", "coupling sums", "profile", "writing"} <= set(stages)
    assert not is_collecting()


def test_every_command_has_the_option(capsys):
    from contactimg.cli import COMMANDS, commands

    for name in COMMANDS:
        command = commands.get_command(click.Context(commands), name)
        subcommands = getattr(command, "commands", {"": command})
        for sub in subcommands:
            assert main([name, *([sub] if sub else []), "--help"]) == 0
            assert "--timings" in capsys.readouterr().out


def test_without_the_option_nothing_is_printed(small_series, tmp_path, capsys):
    main(["predict", str(small_series), "--load-N", "0.02", "-o", str(tmp_path / "out"), "--quiet"])
    assert capsys.readouterr().err == ""
