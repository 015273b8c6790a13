"""The knob for coupling sums over many contacts: the accuracy of the non-uniform FFT."""

from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.models.coupling import Kernel
from contactimg.models.fast_coupling import FastCoupling
from contactimg.tradeoff.case import Case
from contactimg.tradeoff.knobs import Knob, Setting

Values = NDArray[np.float64]

ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-9)
POINTS, MORE_POINTS = 20_000, 200_000
CHECKED_POINTS = 400
"""Number of points at which the sums are compared with direct ones. Chosen to bound the time."""


def sum_knob(case: Case) -> Knob:
    """Accuracy of one sum over random points, too many for a stored matrix."""
    count = MORE_POINTS if case.fine else POINTS
    rng = np.random.default_rng(0)
    x, y, force = rng.random(count), rng.random(count), rng.random(count)
    checked = rng.choice(count, CHECKED_POINTS, replace=False)
    direct = cache(lambda: _direct_sum(x, y, force, checked))

    def error(answer: Values) -> float:
        difference = answer[checked] - direct()
        return float(np.sqrt(np.mean(difference**2) / np.mean(direct() ** 2)))

    settings = [
        Setting(
            f"accuracy {accuracy:.0e}",
            partial(_sum_once, x, y, force, accuracy),
            error,
            f"direct sums at {CHECKED_POINTS} of {count} points",
            message="set-up and one sum",
        )
        for accuracy in ACCURACIES
    ]
    return Knob("sums", f"coupling sums over {count} contacts", "displacement", np.nan, tuple(settings))


def _sum_once(x: Values, y: Values, force: Values, accuracy: float) -> Values:
    """Displacements by forces, including the set-up."""
    return FastCoupling(x, y, Kernel.of_thickness(np.inf), accuracy).displacement(force)


@njit(cache=True)
def _direct_sum(x, y, force, rows):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """``sum_j q_j/(pi r_ij)`` over all other points, for the given rows."""
    total = np.zeros(rows.size)
    for k in range(rows.size):
        i = rows[k]
        for j in range(x.size):
            if j != i:
                total[k] += force[j] / (np.pi * np.sqrt((x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2))
    return total
