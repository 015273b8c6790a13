"""Every status and flag has a cure, and the terminal prints that of each status which is not "ok"."""

import pandas as pd

from contactimg.cli.printing import echo_frames
from contactimg.tables import FRAMES, Flag, Status


def test_every_status_and_flag_has_a_cure():
    assert [one for one in (*Status, *Flag) if not one.cure] == [Status.OK]


def test_the_cure_of_a_status_is_printed_once(capsys):
    rows = {"frame": ["a", "b", "c"], "status": ["ok", "saturated", "saturated"], "message": ""}
    echo_frames(FRAMES.conform(pd.DataFrame(rows)), title="a run")
    assert capsys.readouterr().out.count(Status.SATURATED.cure) == 1


def test_remarks_that_differ_in_numbers_only_are_printed_once_where_frames_are_not_ok(capsys):
    messages = [f"the lamp is {1 + 0.1 * k:.1f} of the reference" for k in range(3)]
    rows = {"frame": ["a", "b", "c"], "status": ["ok", "soft edges", "soft edges"], "message": messages}
    echo_frames(FRAMES.conform(pd.DataFrame(rows)), title="a run")
    printed = capsys.readouterr().out
    assert "2 frames from b on: the lamp is 1.1 of the reference (numbers of the first)\n" in printed
    assert printed.count("the lamp is") == 1
