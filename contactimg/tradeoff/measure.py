"""Time the settings of a choice, each with its error against a converged result.

A choice between settings is called a knob. Each setting of a knob is run, the fast ones several times in
turn, and its result is compared with the truth of a rendered frame or with the finest model.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from contactimg.errors import ContactimgError, InputError
from contactimg.tables import TRADEOFF
from contactimg.tradeoff.recommendations import knob_sentence

Clock = Callable[[], float]

MAX_RUNS = 7
"""Largest number of runs of a setting. Chosen by hand."""

MAX_REPEATED_S = 10.0
"""Time above which a setting is not repeated to exclude the time of compilation. Chosen by hand."""

FAILURES = (ContactimgError, ArithmeticError, ImportError, MemoryError, np.linalg.LinAlgError)
"""Errors of a setting that do not stop the others."""


@dataclass(frozen=True, eq=False)
class Setting:
    """One setting of a knob.

    Parameters
    ----------
    name : str
    run : callable
        The computation that is timed; its result is the argument of ``error``.
    error : callable
        Returns the relative error of the result; not timed.
    reference : str
        What the result is compared with.
    stored_time : float, s, or None
        Time of an earlier computation; the setting is not run, and ``error`` gets None.
    message : str
        Note for the table.
    """

    name: str
    run: Callable[[], Any]
    error: Callable[[Any], float]
    reference: str
    stored_time: float | None = None
    message: str = ""


@dataclass(frozen=True, eq=False)
class Knob:
    """A choice between settings.

    Parameters
    ----------
    name : str
        Name in the table and on the command line.
    title : str
        Title in figures and sentences.
    output : str
        Quantity that the errors refer to.
    load : float, N
        NaN if the load does not matter.
    settings : sequence of Setting
    """

    name: str
    title: str
    output: str
    load: float
    settings: Sequence[Setting]


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """Errors and times of the settings of every knob.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.TRADEOFF`.
    sentences : dict
        Knob -> recommended setting, as a sentence.
    relative : float
        Tolerance that the sentences refer to.
    left_out : dict
        Knob -> reason why it does not apply to the scene.
    """

    table: pd.DataFrame
    sentences: dict[str, str]
    relative: float
    left_out: dict[str, str]


@dataclass(eq=False)
class _Run:
    """The measurement of one setting."""

    setting: Setting
    clock: Clock
    times: list[float] = field(default_factory=list)
    error: float = math.nan
    reason: str = ""

    def start(self) -> None:
        """First run, whose result is compared with the reference."""
        answer = None
        try:
            if self.setting.stored_time is None:
                answer = self.repeat()
            self.error = float(self.setting.error(answer))
        except FAILURES as error:
            self.times.clear()
            self.reason = str(error) or type(error).__name__

    def repeat(self) -> Any:
        """Run the setting and keep the time that it takes."""
        began = self.clock()
        answer = self.setting.run()
        self.times.append(self.clock() - began)
        return answer

    @property
    def best(self) -> float:
        """Shortest time, s; infinite if it has not run."""
        return min(self.times, default=math.inf)


def measure_knob(
    knob: Knob,
    *,
    seconds: float,
    advance: Callable[[], None] | None = None,
    clock: Clock = perf_counter,
) -> pd.DataFrame:
    """Run every setting of a knob; repeat fast ones in turn and take the shortest time.

    Parameters
    ----------
    knob : Knob
    seconds : float
        Time for all repetitions, s, in addition to the first run of each setting.
    advance : callable, optional
        Called once per setting.
    clock : callable
        Returns seconds: wall time, or `time.process_time` on a shared machine.

    Returns
    -------
    DataFrame
        Columns of `TRADEOFF`, one row per setting; a setting that fails has a message instead of numbers.
    """
    runs = [_Run(setting, clock) for setting in knob.settings]
    for run in runs:
        run.start()
        if advance is not None:
            advance()
    ran = [run for run in runs if run.times]
    left = seconds
    for turn in range(1, MAX_RUNS):
        for run in ran:
            # the first run may include compilation, so that all but slow settings are repeated once
            if run.best <= left or (turn == 1 and run.best <= MAX_REPEATED_S):
                run.repeat()
                left -= run.times[-1]
    stored = [None if run.reason else run.setting.stored_time for run in runs]
    times = [run.best if time is None else time for run, time in zip(runs, stored, strict=True)]
    table = pd.DataFrame(
        {
            "knob": knob.name,
            "setting": [run.setting.name for run in runs],
            "error": [run.error for run in runs],
            "time_s": times,
            "output": knob.output,
            "reference": [run.setting.reference for run in runs],
            "load_N": knob.load,
            "message": [run.reason or run.setting.message for run in runs],
        }
    ).replace({"time_s": {math.inf: math.nan}})
    table["time_ratio"] = table["time_s"] / min((run.best for run in ran), default=math.nan)
    timed = np.array([bool(run.times) for run in runs])
    front = pd.array(mark_front(table["error"], table["time_s"].where(timed)), dtype="Int64")
    front[~timed] = pd.NA
    return TRADEOFF.conform(table.assign(pareto=front))


def mark_front(error: Sequence[float] | pd.Series, time: Sequence[float] | pd.Series) -> list[int]:
    """1 for each setting that no other one beats in error and time together, else 0.

    Parameters
    ----------
    error, time : sequence of float
        NaN if not comparable; then the mark is 0.

    Examples
    --------
    >>> mark_front([0.1, 0.01, 0.02, 0.001], [1.0, 2.0, 3.0, float("nan")])
    [1, 1, 0, 0]
    """
    errors, times = np.asarray(error, float), np.asarray(time, float)
    order, best = np.lexsort((errors, times)), math.inf
    front = [0] * len(errors)
    for row in order:
        if np.isfinite(times[row]) and errors[row] < best:
            front[row], best = 1, errors[row]
    return front


def run_knobs(
    knobs: Sequence[Knob],
    *,
    relative: float,
    seconds: float,
    left_out: dict[str, str] | None = None,
    advance: Callable[[], None] | None = None,
    clock: Clock = perf_counter,
) -> Tradeoff:
    """Measure knobs one after another.

    Parameters
    ----------
    knobs : sequence of Knob
    relative : float
        Relative error that the sentences are for.
    seconds : float
        Time for the repetitions of all knobs, s, in addition to the first run of each setting.
    left_out : dict, optional
        Passed on to the result.
    advance : callable, optional
        Called once per setting.
    clock : callable
        As for `measure_knob`.

    Raises
    ------
    InputError
        If no setting can be run.
    """
    each = seconds / len(knobs)
    tables = [measure_knob(knob, seconds=each, advance=advance, clock=clock) for knob in knobs]
    rows = TRADEOFF.conform(pd.concat(tables, ignore_index=True))
    if rows["time_s"].isna().all():
        names = ", ".join(dict.fromkeys(rows["knob"]))
        raise InputError(f"no setting of {names} could be run: {rows['message'].iloc[0]}")
    sentences = {
        knob.name: knob_sentence(knob.title, table, relative=relative)
        for knob, table in zip(knobs, tables, strict=True)
    }
    return Tradeoff(rows, sentences, relative, dict(left_out or {}))
