"""What makes unloading differ from loading: adhesion hysteresis, a drift of the load's zero, or of its gain.

Each adds one parameter to the fit. One is fitted where an F test at 1 % says that the frames need it; where
two explain them, the better one is, and its rival enters the uncertainty with its probability.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from contactimg.calibration.jkr_fit import EXACT_CHI_SQUARE, JkrSeries, least_squares

FALSE_ALARM_RATE = 0.01
"""False-alarm rate: probability that a series without a departure gets one of a kind."""

NEGLIGIBLE_DOUBT = 0.01
"""Probability of a rival below which it is not fitted. Chosen by hand: it would add at most a tenth of the
difference between the two to the uncertainty."""

HYSTERESIS, ZERO_DRIFT, GAIN_DRIFT = "hysteresis of adhesion", "drift of the zero", "drift of the gain"


@dataclass(frozen=True, eq=False)
class Departure:
    """What was added to the law of the plain series.

    Parameters
    ----------
    name : str
        One of the three names, or empty.
    series : JkrSeries
        With its parameter.
    rival : Departure or None
        The next best, where it is not negligible.
    doubt : float
        Probability of the rival.
    """

    name: str
    series: JkrSeries
    rival: "Departure | None" = None
    doubt: float = 0.0


def ramp(count: int) -> NDArray[np.float64]:
    """Time of each frame, from -1/2 to 1/2: a drift is its change over the series."""
    return np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(count)


def choose_departure(series: JkrSeries, branch: NDArray[np.str_], used: NDArray[np.bool_]) -> Departure:
    """The series with a hysteresis or a drift where the frames show one.

    Parameters
    ----------
    series : JkrSeries
        All frames, in the order in which they were taken.
    branch : ndarray of str, shape (n,)
        From `contactimg.calibration.loading_branches.classify_branches`.
    used : ndarray of bool, shape (n,)

    Returns
    -------
    Departure
    """
    none, freedom = Departure("", series), int(used.sum()) - series.physical - 2
    plain = least_squares(series.part(used))
    if freedom < 1 or plain < EXACT_CHI_SQUARE:
        return none
    found = []
    for candidate in _candidates(series, branch, used):
        rest = least_squares(candidate.series.part(used))
        ratio = (plain - rest) / max(rest / freedom, np.finfo(float).tiny)
        if stats.f.sf(ratio, 1, freedom) < FALSE_ALARM_RATE:
            found.append((max(rest, EXACT_CHI_SQUARE), candidate))
    if not found:
        return none
    found.sort(key=lambda pair: pair[0])
    (least, best), others = found[0], found[1:]
    if not others:
        return best
    odds = float((least / others[0][0]) ** (used.sum() / 2))  # likelihoods maximised over the noise
    doubt = odds / (1 + odds)
    return best if doubt < NEGLIGIBLE_DOUBT else replace(best, rival=others[0][1], doubt=doubt)


def _candidates(series: JkrSeries, branch: NDArray[np.str_], used: NDArray[np.bool_]) -> list[Departure]:
    """The departures that the order of the loads can show: loads that return to where they were."""
    time = ramp(len(series.load))
    apart = np.column_stack([branch == "loading", branch == "unloading"]).astype(float)
    counts = apart[used].sum(axis=0)
    found = []
    if counts.min() >= 2 and counts.sum() == used.sum():
        found.append(Departure(HYSTERESIS, replace(series, branches=apart)))
    steps = np.diff(series.load[used])
    if (steps > 0).any() and (steps < 0).any():
        found.append(Departure(ZERO_DRIFT, replace(series, drift=time[:, None])))
        found.append(Departure(GAIN_DRIFT, replace(series, drift=(time * series.load)[:, None])))
    return found
