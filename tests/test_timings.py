"""The times of the steps add up to the time that passed, and those of worker processes are added."""

import re
import time

import click
import pytest
from loky import get_reusable_executor
from small_calls import spend, spend_in

from contactimg.cli import main
from contactimg.engine.parallel import in_parallel
from contactimg.timings import OTHER, WAITING, collect, is_collecting


def test_inner_steps_are_taken_out_of_outer_ones_and_all_add_up():
    start = time.perf_counter()
    with collect() as seconds:
        spend_in("contactimg.models.coupling", 0.06)
        spend_in(
            "contactimg.imaging.fit.disks", 0.1, before=lambda: spend_in("contactimg.files.tables", 0.08)
        )
        spend(0.05)
    passed = time.perf_counter() - start
    # a step is known to one look, and to the longest that a look waits for the interpreter: 5 ms each
    spent = {"models.coupling": 0.06, "imaging.fit": 0.1, "files.tables": 0.08, OTHER: 0.05}
    for step, least in spent.items():
        assert seconds[step] > least - 0.011
    assert set(seconds) == set(spent)
    # two readings of the clock and the end of a thread lie outside
    assert sum(seconds.values()) == pytest.approx(passed, abs=0.02)


def fail_while_collecting():
    assert is_collecting()
    spend_in("contactimg.models.coupling", 0.03)
    raise ZeroDivisionError


def test_nothing_is_collected_unless_asked_for_or_after_an_error():
    assert not is_collecting()
    with pytest.raises(ZeroDivisionError), collect() as seconds:
        fail_while_collecting()
    assert not is_collecting()
    assert seconds["models.coupling"] > 0.02


@pytest.fixture
def own_processes():
    """Worker processes that no other test meets: loky takes what these load later for a leak and warns."""
    get_reusable_executor().shutdown(wait=True)
    yield
    get_reusable_executor().shutdown(wait=True)


@pytest.mark.usefixtures("own_processes")
def test_the_steps_of_processes_are_added():
    jobs = [("contactimg.models.coupling", 0.05)] * 4
    with collect() as seconds:
        results = list(in_parallel(spend_in, jobs, count=4, workers=2))
    assert results == [0.05] * 4
    assert seconds["models.coupling"] > 4 * 0.04
    assert seconds[WAITING] > 0.08  # two processes share them


def test_one_process_waits_for_no_other():
    with collect() as seconds:
        list(in_parallel(spend_in, [("contactimg.models.coupling", 0.03)] * 3, count=3, workers=None))
    assert seconds["models.coupling"] > 0.06
    assert seconds[WAITING] < 0.03


ROW = re.compile(r"^ ?(\S.*?)  +([\d.]+) +[\d.]+%", re.MULTILINE)


def printed(text):
    """Step -> seconds of the table, and the total."""
    steps = {name: float(seconds) for name, seconds in ROW.findall(text)}
    return steps, steps.pop("total")


def test_process_prints_its_steps(small_series, tmp_path, capsys):
    out = str(tmp_path / "out")
    assert main(["process", str(small_series), "-o", out, "--quiet", "--timings", "--workers", "1"]) == 0
    steps, total = printed(capsys.readouterr().err)
    assert {"imaging.fit", "imaging.background"} <= set(steps)  # shorter ones may be between two looks
    # printed with three decimals: half a millisecond a line
    assert sum(steps.values()) == pytest.approx(total, abs=5e-4 * (len(steps) + 1))


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
