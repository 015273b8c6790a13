"""Time the settings of a choice, each with its error against a converged result, and recommend one.

A choice between settings is called a knob. Each setting of a knob is run, the fast ones several times in
turn, and its result is compared with the truth of a rendered frame or with the finest model.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from contactimg.engine.progress import counted
from contactimg.errors import ContactimgError, InputError
from contactimg.tables import TRADEOFF

Clock = Callable[[], float]

MAX_RUNS = 7
"""Largest number of runs of a setting. Chosen by hand."""

FAILURES = (ContactimgError, ArithmeticError, ImportError, MemoryError, np.linalg.LinAlgError)
"""Errors of a setting that do not stop the others."""


OUTPUT_WORDS = {
    "all": "every output",
    "profile": "the forces",
    "area": "A",
    "force": "the forces",
    "radius": "the radii",
}

NEGLIGIBLE_TIME_FRACTION = 0.02
"""Relative extra time that is called none. Chosen by hand."""


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
    message : str
        Note for the table.
    """

    name: str
    run: Callable[[], Any]
    error: Callable[[Any], float]
    reference: str
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


def measure_knob(knob: Knob, *, seconds: float, clock: Clock = perf_counter) -> pd.DataFrame:
    """Run every setting of a knob; repeat fast ones in turn and take the shortest time.

    Parameters
    ----------
    knob : Knob
    seconds : float
        Time for all repetitions, s, in addition to the first run of each setting.
    clock : callable
        Returns seconds: wall time, or `time.process_time` on a shared machine.

    Returns
    -------
    DataFrame
        Columns of `TRADEOFF`, one row per setting; a setting that fails has a message instead of numbers.
    """
    settings = knob.settings
    times: list[list[float]] = [[] for _ in settings]
    errors, reasons = [math.nan] * len(settings), [""] * len(settings)

    def timed(k: int) -> Any:
        began = clock()
        answer = settings[k].run()
        times[k].append(clock() - began)
        return answer

    for k, setting in counted(enumerate(settings), f"settings of {knob.name}", len(settings)):
        try:
            errors[k] = float(setting.error(timed(k)))
        except FAILURES as error:
            times[k].clear()
            reasons[k] = str(error) or type(error).__name__
    left = seconds
    for turn in range(1, MAX_RUNS):
        for k, taken in enumerate(times):
            # the first run may include compilation, so that all but slow settings are repeated once
            if taken and min(taken) <= (seconds if turn == 1 else left):
                timed(k)
                left -= taken[-1]
    own = pd.Series([min(taken, default=math.nan) for taken in times])
    columns = {
        "setting": [setting.name for setting in settings],
        "error": errors,
        "time_s": own,
        "time_ratio": own / own.min(),
        "reference": [setting.reference for setting in settings],
        "message": [why or s.message for s, why in zip(settings, reasons, strict=True)],
        "pareto": pd.Series(mark_front(pd.Series(errors), own), dtype="Int64").mask(own.isna()),
    }
    common: dict[str, Any] = {"knob": knob.name, "output": knob.output, "load_N": knob.load}
    return TRADEOFF.conform(pd.DataFrame(columns).assign(**common))


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
    clock : callable
        As for `measure_knob`.

    Raises
    ------
    InputError
        If no setting can be run.
    """
    tables = [measure_knob(knob, seconds=seconds / len(knobs), clock=clock) for knob in knobs]
    rows = TRADEOFF.conform(pd.concat(tables, ignore_index=True))
    if rows["time_s"].isna().all():
        names = ", ".join(dict.fromkeys(rows["knob"]))
        raise InputError(f"no setting of {names} could be run: {rows['message'].iloc[0]}")
    sentences = {
        knob.name: knob_sentence(knob.title, table, relative=relative)
        for knob, table in zip(knobs, tables, strict=True)
    }
    return Tradeoff(rows, sentences, relative, dict(left_out or {}))


def knob_sentence(title: str, table: pd.DataFrame, *, relative: float) -> str:
    """The setting to use for a tolerance, its cost, and the cost of a tenth of the error.

    Parameters
    ----------
    title : str
        Title of the knob.
    table : DataFrame
        Rows of one knob, columns of `contactimg.tables.TRADEOFF`.
    relative : float
        Relative error that is allowed.

    Examples
    --------
    >>> table = pd.DataFrame({
    ...     "setting": ["rough", "fine"], "error": [4e-3, 2e-5], "time_s": [3e-3, 0.1], "pareto": [1, 1],
    ...     "output": ["area", "area"],
    ... })
    >>> print(knob_sentence("grid", table, relative=0.01))
    grid: for 1 % on A take rough (0.4 %, 3 ms); 0.1 % needs fine (0.002 %, 100 ms), 33 times the time
    """
    front = front_of(table)
    if front.empty:
        return f"{title}: no setting could be run"
    what = f"{title}: for {error_text(relative)} on {OUTPUT_WORDS[str(front['output'].iloc[0])]}"
    chosen = cheapest(front, relative)
    if chosen is None:
        best = front.iloc[-1]
        return f"{what} no setting serves; the best is {_described(best)}"
    return f"{what} take {_described(chosen)}; {_tenth_of_error(front, chosen, relative)}"


def front_of(table: pd.DataFrame) -> pd.DataFrame:
    """The settings that no other one beats in error and time, the fastest first."""
    return table[table["pareto"] == 1].sort_values("time_s")


def cheapest(front: pd.DataFrame, error: float) -> pd.Series | None:
    """The fastest setting within an error."""
    within = front[front["error"] <= error]
    return None if within.empty else within.iloc[0]


def _tenth_of_error(front: pd.DataFrame, chosen: pd.Series, relative: float) -> str:
    """The cost of a tenth of the tolerance, or of the error that is already reached."""
    goal = relative / 10
    better = cheapest(front, goal)
    if better is not None and better["setting"] == chosen["setting"]:
        goal = float(chosen["error"]) / 10
        better = cheapest(front, goal)
        if better is None:
            return "no setting is ten times better"
    if better is None:
        best = front.iloc[-1]
        more = f", at best {_described(best)}" if best["setting"] != chosen["setting"] else ""
        return f"no setting reaches {error_text(goal)}{more}"
    ratio = float(better["time_s"] / chosen["time_s"])
    cost = "at no extra time" if ratio < 1 + NEGLIGIBLE_TIME_FRACTION else f"{ratio:.2g} times the time"
    return f"{error_text(goal)} needs {_described(better)}, {cost}"


def _described(row: pd.Series) -> str:
    return f"{row['setting']} ({error_text(row['error'])}, {time_text(row['time_s'])})"


def error_text(error: float) -> str:
    """A relative error in per cent with two digits; a small one as a power of ten."""
    if error == 0:
        return "no error"
    return f"{100 * error:.2g} %" if error >= 1e-6 else f"{error:.0e}"


def time_text(seconds: float) -> str:
    """A time with two digits in min, s, ms or us."""
    if math.isnan(seconds):
        return "no time"
    for unit, size in (("min", 60.0), ("s", 1.0), ("ms", 1e-3)):
        if seconds >= 0.995 * size:
            return f"{_two_digits(seconds / size)} {unit}"
    return f"{_two_digits(seconds * 1e6)} us"


def _two_digits(value: float) -> str:
    """A number rounded to two digits, written out."""
    return f"{float(f'{value:.2g}'):g}"
