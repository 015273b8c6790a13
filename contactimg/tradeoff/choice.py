"""The cheapest measurement of a frame that meets a tolerance: the threshold if good enough, else the fit.

The error of the threshold is found by fitting disks to a part of the frame, in which many contacts lie.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import hypot, inf

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.optics import busiest_quarter
from contactimg.effects.output_change import relative_change, stated_change
from contactimg.errors import InputError
from contactimg.imaging.measure import ImageMeasurement
from contactimg.pose.pairs import pair_points

Values = NDArray[np.float64]

METHODS = {"threshold": "pixels above the threshold", "disk": "fit of blurred disks"}
"""Method -> name in the table."""

SAME_CONTACT_PX = 2.0
"""Disks whose centres are closer than this, or than the radius, are the same contact. Chosen by hand."""

SAFETY_FACTOR = 1.1
"""Factor on the error found in a part of the frame. Measured: on the sample frames the error there is 0.96 to
1.13 of that of the frame."""

FEWEST_CONTACTS = 20
"""Contacts that a quarter holds at least if it stands for the whole. Chosen by hand."""


@dataclass(frozen=True)
class Choice:
    """How a frame was measured, and why.

    Parameters
    ----------
    method : {"threshold", "disk"}
    error : float
        Estimated relative error of the threshold; infinite where it cannot be told.
    stated : float
        Relative uncertainty that the chosen measurement states.
    relative : float
        The tolerance.
    output : str
        What the errors are of.

    Examples
    --------
    >>> print(Choice("disk", error=0.077, stated=0.002, relative=0.01, output="area"))
    disk: the threshold would be off by 7.7 % of the area, more than 1 %
    """

    method: str
    error: float
    stated: float
    relative: float
    output: str

    def __str__(self) -> str:
        off = f"{100 * self.error:.2g} % of the {self.output}" if self.error < inf else "an unknown amount"
        if self.method == "threshold":
            return f"threshold: off by an estimated {off}, within {100 * self.relative:g} %"
        missed = f"; the fit states {100 * self.stated:.2g} % itself" if self.stated > self.relative else ""
        return f"disk: the threshold would be off by {off}, more than {100 * self.relative:g} %{missed}"


def measure_cheapest(
    image: NDArray,
    reference: NDArray | None,
    *,
    measure: Callable[..., ImageMeasurement],
    relative: float,
    output: str,
) -> tuple[ImageMeasurement, Choice]:
    """Count pixels above the threshold; fit disks if that is estimated to miss the tolerance.

    Parameters
    ----------
    image, reference : ndarray, shape (rows, columns)
    measure : callable
        Measures an image with its reference by a ``method``.
    relative : float
        Tolerance of the output.
    output : str

    Returns
    -------
    ImageMeasurement, Choice
    """
    fit = partial(measure, method="disk")
    measurement, method = measure(image, reference, method="threshold", film=None), "threshold"
    error = count_error(measurement.disks, image, reference, fit=fit, output=output)
    if error > relative:
        measurement, method = fit(image, reference), "disk"
    disks = measurement.disks
    stated = stated_change(output, radius=disks["radius_px"], std=disks["radius_std_px"])
    return measurement, Choice(method, error, stated, relative, output)


def count_error(
    counted: pd.DataFrame,
    image: NDArray,
    reference: NDArray | None,
    *,
    fit: Callable[..., ImageMeasurement],
    output: str,
) -> float:
    """Relative error of the output that disks counted by threshold leave.

    Parameters
    ----------
    counted : DataFrame
        Disks counted on the frame.
    image, reference : ndarray, shape (rows, columns)
    fit : callable
        Fits disks to an image with its reference.
    output : str
        All contacts count as of one radius of curvature.

    Returns
    -------
    float
        Infinite if nothing is counted, or no contact is fitted in the part of the frame.

    Notes
    -----
    The difference to the fit and the stated uncertainty of the count add in squares. `SAFETY_FACTOR` allows
    for a part with other contacts than the whole.
    """
    if not len(counted):
        return inf
    x, y, a = (counted[name].to_numpy(float) for name in ("x_px", "y_px", "radius_px"))
    _, rows, columns = busiest_quarter(x, y, a, np.ones(x.size, bool), fewest=FEWEST_CONTACTS)
    part = rows, columns
    fitted = fit(image[part], None if reference is None else reference[part]).disks
    if not len(fitted):
        return inf
    fitted = fitted.assign(x_px=fitted["x_px"] + columns.start, y_px=fitted["y_px"] + rows.start)
    counted_there, fitted = (_inside(table, rows, columns) for table in (counted, fitted))
    if not (len(counted_there) and len(fitted)):
        return inf
    stated = stated_change(output, radius=counted["radius_px"], std=counted["radius_std_px"])
    return SAFETY_FACTOR * hypot(disk_change(output, counted_there, fitted), stated)


def _inside(disks: pd.DataFrame, rows: slice, columns: slice) -> pd.DataFrame:
    """Disks that lie wholly inside a part of a frame."""
    x, y, a = (disks[name].to_numpy(float) for name in ("x_px", "y_px", "radius_px"))
    inside = (x - a > columns.start) & (x + a < columns.stop - 1) & (y - a > rows.start)
    return disks[inside & (y + a < rows.stop - 1)]


def disk_change(
    output: str, measured: pd.DataFrame, expected: pd.DataFrame, sphere_radius: Values | None = None
) -> float:
    """Relative error of the output of measured disks; forces as ``a^3/R``.

    A disk without a partner is compared with no contact; its radius of curvature is the mean one.
    """
    if not len(measured):
        raise InputError("no contact was measured")
    found, true = (table[["x_px", "y_px", "radius_px"]].to_numpy(float) for table in (measured, expected))
    curvature = np.ones(len(true)) if sphere_radius is None else sphere_radius
    reach = max(SAME_CONTACT_PX, float(true[:, 2].max(initial=0.0)))
    i, j, distance = pair_points(found[:, :2], true[:, :2], max_distance=reach)
    same = distance <= np.maximum(SAME_CONTACT_PX, true[j, 2])
    i, j = i[same], j[same]
    strangers = np.delete(found[:, 2], i)
    radius = np.concatenate([np.zeros(len(true)), strangers])
    radius[j] = found[i, 2]
    complete = np.concatenate([true[:, 2], np.zeros(strangers.size)])
    mean = float(np.mean(curvature)) if curvature.size else 1.0
    curvature = np.concatenate([curvature, np.full(strangers.size, mean)])
    pairs = [(a**3 / curvature, a) for a in (radius, complete)]
    return relative_change(output, without=pairs[0], complete=pairs[1])
