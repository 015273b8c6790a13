"""Time the settings of a knob (a choice), each with its error against a converged result."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from contactimg.errors import ContactimgError
from contactimg.tables import TRADEOFF

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
    settings : tuple of Setting
    """

    name: str
    title: str
    output: str
    load: float
    settings: tuple[Setting, ...]


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
                answer = self._timed()
            self.error = float(self.setting.error(answer))
        except FAILURES as error:
            self.times.clear()
            self.reason = _sentence(error)

    def repeat(self) -> None:
        """Repeat the run for its time."""
        self._timed()

    def _timed(self) -> Any:
        start = self.clock()
        answer = self.setting.run()
        self.times.append(self.clock() - start)
        return answer

    @property
    def best(self) -> float:
        """Shortest time, s."""
        return min(self.times, default=math.inf)

    def row(self, knob: Knob, cheapest: float) -> dict[str, Any]:
        """The row of the table."""
        stored = self.setting.stored_time
        time = self.best if stored is None or self.reason else stored
        has_time = math.isfinite(time)
        return {
            "knob": knob.name,
            "setting": self.setting.name,
            "error": self.error,
            "time_s": time if has_time else math.nan,
            "time_ratio": time / cheapest if has_time and math.isfinite(cheapest) else math.nan,
            "output": knob.output,
            "reference": self.setting.reference,
            "load_N": knob.load,
            "message": self.reason or self.setting.message,
        }


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
    _repeat([run for run in runs if run.times], seconds)
    cheapest = min((run.best for run in runs), default=math.inf)
    table = pd.DataFrame([run.row(knob, cheapest) for run in runs])
    ran = np.array([bool(run.times) for run in runs])
    front = pd.array(mark_front(table["error"], table["time_s"].where(ran)), dtype="Int64")
    front[~ran] = pd.NA
    return TRADEOFF.conform(table.assign(pareto=front))


def _repeat(runs: Sequence[_Run], seconds: float) -> None:
    """Repeat the settings in turn, as long as the next run fits into the time that is left.

    The first run may include compilation, so all but slow settings are repeated at least once.
    """
    left = seconds
    for turn in range(1, MAX_RUNS):
        for run in runs:
            if run.best <= left or (turn == 1 and run.best <= MAX_REPEATED_S):
                run.repeat()
                left -= run.times[-1]


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


def _sentence(error: BaseException) -> str:
    """The message of an error, or its type."""
    return str(error) or type(error).__name__
