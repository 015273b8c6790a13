"""Noise of contacts, as their insides show it.

The fit takes the noise of a contact for that of the background times its brightness: shot noise, and texture
that a contact makes brighter. A camera whose noise does not depend on the light makes less, and uncertainties
are too large by that. It also takes what rims of disks leave for noise of the rim; of ellipses it is not.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import Noise, NoiseCorrelation
from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import RADIUS, FitProblem, X, Y, touches
from contactimg.imaging.kernels.quadrupole import INSIDE_BLUR_WIDTHS

WIDEST_INSIDE_RADII = 0.7
"""Where the inside ends, radii of the contact. Theory: the minor half-axis of an ellipse of 2 : 1."""
LEAST_INSIDE_PX = 1.5
"""Radius of the smallest inside that is looked at. Chosen: nine pixels."""
FEWEST_PIXELS = 100
"""Pixels inside all contacts below which they say nothing. Theory: they give the variance to 14 %."""
MOST_INSIDES = 60  # contacts that are looked at; for time
CLEARLY_LESS_SIGMA = 3.0
"""Deviation of the noise inside from that expected from which on it counts. False-alarm rate: 1e-3."""


def noise_of_insides(problem: FitProblem, fit: FittedDisks) -> Noise:
    """The noise without that of the rims, and inside contacts no larger than it is seen to be.

    Parameters
    ----------
    problem : FitProblem
    fit : FittedDisks
        Of this problem.

    Returns
    -------
    Noise
        That of the problem, but for its rims, where too few pixels lie inside contacts or where these show no
        less.
    """
    noise = replace(problem.noise, rim=0.0)
    variance, pixels = _inside(problem, fit)
    if pixels < FEWEST_PIXELS:
        return noise
    seen = variance / noise.variance
    if seen > (1.0 + noise.slope) * (1.0 - CLEARLY_LESS_SIGMA * np.sqrt(2.0 / pixels)):
        return noise
    return replace(noise, slope=max(seen - 1.0, 0.0))


def gain_of_texture(expected: Noise, seen: Noise, correlation: NoiseCorrelation) -> float:
    """Factor by which contacts make brighter what neighbouring pixels share.

    At most all that the insides show beyond the noise of the background, and no more than ``expected``.
    """
    gain, shared = 1.0 + expected.slope, float(correlation.covariance[1])
    if seen.slope >= expected.slope or shared <= 0.0:
        return gain
    return min(gain, float(np.sqrt(1.0 + seen.slope * seen.variance / shared)))


def _inside(problem: FitProblem, fit: FittedDisks) -> tuple[float, int]:
    """Median of the variances well inside contacts, at the brightness 1, and its degrees of freedom."""
    reach = WIDEST_INSIDE_RADII * fit.disks[:, RADIUS] - INSIDE_BLUR_WIDTHS * fit.blur
    wide = np.argsort(-reach, kind="stable")[:MOST_INSIDES]
    wide = wide[reach[wide] > LEAST_INSIDE_PX]
    # what is at the full scale of the sensor has no noise
    wide = wide[~touches(problem.saturated, 1, fit.disks[wide], reach[wide])]
    brightness = problem.brightness_at(fit.disks[wide])
    variances, degrees = [], []
    for disk, far, light in zip(fit.disks[wide], reach[wide], brightness, strict=True):
        values = _values_within(problem.image, disk, float(far))
        if len(values) > 1:
            degrees.append(len(values) - 1)
            # the median of chi-square with n degrees of freedom is n (1 - 2/(9 n))^3 (Wilson and Hilferty)
            middle = (1.0 - 2.0 / (9.0 * degrees[-1])) ** 3
            variances.append(float(np.var(values, ddof=1) * light) / middle)
    if not degrees:
        return float("nan"), 0
    order = np.argsort(variances)
    half = np.cumsum(np.array(degrees)[order]) >= 0.5 * sum(degrees)
    return float(np.array(variances)[order][np.argmax(half)]), int(sum(degrees))


def _values_within(
    image: NDArray[np.float32], disk: NDArray[np.float64], reach: float
) -> NDArray[np.float32]:
    """Pixels of the image within a distance of the centre of a disk."""
    top, left = max(int(disk[Y] - reach), 0), max(int(disk[X] - reach), 0)
    part = image[top : int(disk[Y] + reach) + 2, left : int(disk[X] + reach) + 2]
    y, x = np.ogrid[: part.shape[0], : part.shape[1]]
    return part[np.hypot(x + left - disk[X], y + top - disk[Y]) <= reach]
