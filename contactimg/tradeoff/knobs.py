"""A knob: the settings of one choice, timed by turns, each with its error against a converged answer."""

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

TURNS = 7
"""Most runs of a setting."""

SLOW = 10.0
"""Seconds above which a setting is not run again for what loading took."""

FAILURES = (ContactimgError, ArithmeticError, ImportError, MemoryError, np.linalg.LinAlgError)
"""What a setting may fail with and leave the others alone."""


@dataclass(frozen=True, eq=False)
class Setting:
    """One setting of a knob.

    Parameters
    ----------
    name : str
    run : callable
        The work that is timed; what it returns goes to ``error``.
    error : callable
        Relative error of that answer; not timed.
    reference : str
        What the error is against.
    stored_time : float, s, or None
        Time taken elsewhere: the setting is not run, ``error`` gets None.
    message : str
        What to know about it.
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
        As in the table and on the command line.
    title : str
        For a person.
    output : str
        What the errors are of.
    load : float, N
        NaN where none enters.
    settings : tuple of Setting
    """

    name: str
    title: str
    output: str
    load: float
    settings: tuple[Setting, ...]


@dataclass(eq=False)
class _Run:
    """A setting while it is measured."""

    setting: Setting
    clock: Clock
    times: list[float] = field(default_factory=list)
    error: float = math.nan
    reason: str = ""

    def start(self) -> None:
        """The first run, whose answer is compared with the reference."""
        answer = None
        try:
            if self.setting.stored_time is None:
                answer = self._timed()
            self.error = float(self.setting.error(answer))
        except FAILURES as error:
            self.times.clear()
            self.reason = _sentence(error)

    def repeat(self) -> None:
        """One more run for its time."""
        self._timed()

    def _timed(self) -> Any:
        begun = self.clock()
        answer = self.setting.run()
        self.times.append(self.clock() - begun)
        return answer

    @property
    def best(self) -> float:
        """Shortest time, s."""
        return min(self.times, default=math.inf)

    def row(self, knob: Knob, cheapest: float) -> dict[str, Any]:
        """The row of the table."""
        stored = self.setting.stored_time
        time = self.best if stored is None or self.reason else stored
        known = math.isfinite(time)
        return {
            "knob": knob.name,
            "setting": self.setting.name,
            "error": self.error,
            "time_s": time if known else math.nan,
            "time_ratio": time / cheapest if known and math.isfinite(cheapest) else math.nan,
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
    """Run every setting of a knob, the fast ones by turns for the best of several times.

    Parameters
    ----------
    knob : Knob
    seconds : float
        What all repetitions may take together; the first run of each setting comes on top.
    advance : callable, optional
        Called once a setting.
    clock : callable
        Seconds that pass: of the wall, or `time.process_time` on a machine that is shared.

    Returns
    -------
    DataFrame
        Of the schema `TRADEOFF`, one row a setting; one that fails has a message in place of its numbers.
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
    """Turn after turn, as long as the next run of a setting fits into what is left.

    The first run may have loaded compiled functions, so all but the slowest get a second one.
    """
    left = seconds
    for turn in range(1, TURNS):
        for run in runs:
            if run.best <= left or (turn == 1 and run.best <= SLOW):
                run.repeat()
                left -= run.times[-1]


def mark_front(error: Sequence[float] | pd.Series, time: Sequence[float] | pd.Series) -> list[int]:
    """1 for each setting that no other one beats in error and time together, else 0.

    Parameters
    ----------
    error, time : sequence of float
        NaN: not comparable, and not on the front.

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
    """What an error says, or its kind."""
    return str(error) or type(error).__name__
