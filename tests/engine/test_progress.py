"""Loops are counted where somebody asks, and their bars end with the command, whatever ends it."""

import threading
from contextlib import contextmanager

import pytest

from contactimg.cli.printing import progress_bars
from contactimg.engine.parallel import in_parallel
from contactimg.engine.progress import counted, shown_by
from contactimg.errors import InputError


def test_only_loops_with_a_text_are_shown_to_who_asks():
    shown = []

    @contextmanager
    def bar(text, count):
        shown.append((text, count))
        yield lambda: shown.append("turn")

    assert list(counted("ab", "reading", 2)) == ["a", "b"]
    with shown_by(bar):
        assert list(counted("ab", "", 2)) == ["a", "b"]
        calls = in_parallel(str.upper, [("a",), ("b",)], count=2, workers=1, shown="spelling")
        assert list(calls) == ["A", "B"]
    assert shown == [("spelling", 2), "turn", "turn"]


def bars():
    """The threads of bars that have not ended; those that are about to are waited for."""
    threads = [one for one in threading.enumerate() if type(one).__name__ == "_RefreshThread"]
    for one in threads:
        one.join(1)
    return [one for one in threads if one.is_alive()]


def fail_while(text):
    for _ in counted("ab", text, 2):
        assert bars()
        raise InputError("no frame")


def test_a_bar_ends_with_the_loop_or_with_the_error_that_ends_the_command(capsys):
    with progress_bars():
        assert list(counted("ab", "reading", 2)) == ["a", "b"]
        assert not bars()
    with pytest.raises(InputError), progress_bars():
        fail_while("measuring")
    assert not bars()
    said = capsys.readouterr().err
    assert "reading" in said
    assert "measuring" in said
