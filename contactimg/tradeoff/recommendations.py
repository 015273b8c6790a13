"""Recommend a setting: the table of a knob in one sentence."""

import math

import pandas as pd

DIGIT = 10.0  # factor on the error of one more digit

TITLES = {
    "image": "measurement of a frame",
    "model": "contact model",
    "solver": "tolerance of the solver",
    "sums": "coupling sums over many contacts",
    "rings": "rings of Greenwood-Tripp",
    "patterns": "patterns of an ensemble",
    "supersampling": "sampling of rendered frames",
}
"""Knob -> what its settings choose."""

OUTPUTS = {
    "all": "every output",
    "profile": "the forces",
    "area": "A",
    "force": "the forces",
    "radius": "the radii",
    "displacement": "a sum",
}

NEGLIGIBLE_TIME_FRACTION = 0.02
"""Relative extra time that is called none. Chosen by hand."""


def knob_sentence(title: str, table: pd.DataFrame, *, relative: float) -> str:
    """The setting to use for a tolerance, its cost, and the cost of one more digit.

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
    grid: for 1 % on A take rough (0.4 %, 3 ms); the next digit takes fine (0.002 %, 100 ms), 33 times the
    time
    """
    front = front_of(table)
    if front.empty:
        return f"{title}: no setting could be run"
    what = f"{title}: for {error_text(relative)} on {OUTPUTS[str(front['output'].iloc[0])]}"
    chosen = cheapest(front, relative)
    if chosen is None:
        best = front.iloc[-1]
        return f"{what} no setting serves; the best is {_described(best)}"
    return f"{what} take {_described(chosen)}; {_next_digit(front, chosen, relative)}"


def front_of(table: pd.DataFrame) -> pd.DataFrame:
    """The settings that no other one beats in error and time, the fastest first."""
    return table[table["pareto"] == 1].sort_values("time_s")


def cheapest(front: pd.DataFrame, error: float) -> pd.Series | None:
    """The fastest setting within an error."""
    within = front[front["error"] <= error]
    return None if within.empty else within.iloc[0]


def _next_digit(front: pd.DataFrame, chosen: pd.Series, relative: float) -> str:
    """The cost of a tenth of the tolerance, or of the error that is already reached."""
    goal = relative / DIGIT
    better = cheapest(front, goal)
    if better is not None and better["setting"] == chosen["setting"]:
        better = cheapest(front, float(chosen["error"]) / DIGIT)
        if better is None:
            return "no setting is ten times better"
    if better is None:
        best = front.iloc[-1]
        more = f", at best {_described(best)}" if best["setting"] != chosen["setting"] else ""
        return f"no setting gives the next digit{more}"
    ratio = float(better["time_s"] / chosen["time_s"])
    cost = "at no extra time" if ratio < 1 + NEGLIGIBLE_TIME_FRACTION else f"{ratio:.2g} times the time"
    return f"the next digit takes {_described(better)}, {cost}"


def _described(row: pd.Series) -> str:
    """A setting with its error and time."""
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
