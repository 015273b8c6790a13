"""Edges that are not a disk behind one Gaussian: a few parameters shared by all contacts.

With P(r; a, s) the blurred uniform disk, the brightness of a contact is ``R(M(r; a, s_i) + d D(r; a, s_i))``:

- *blur*: ``s_i^2 = s^2 (1 + b . (x, y, x^2 - 1/3, x y, y^2 - 1/3))^2 + q a^2``, a blur that varies over the
  field and an edge whose width grows with the contact;
- *point spread*: ``M = P(s) + sum_j w_j [P(rho_j s) - P(s)]``, a sum of Gaussians of fixed widths. It
  conserves light, so that the area is that of the light;
- *plateau*: ``D`` is the blurred ``1/2 - r^2/a^2``, brighter in the middle for ``d > 0``, of mean 0;
- *rim*: plus ``h [P(r; 1.1 a) - P(r; a)]``, light (h > 0) or shadow just outside;
- *contrast*: times ``1 + e/(1 + (a/3 s)^2)``, for small contacts brighter (e > 0) or dimmer than large ones;
- *response*: ``R(m) = ((1 + c m)^g - 1)/((1 + c)^g - 1)``, g = 1 - p, for a camera whose grey levels go as
  the g-th power of the light, and contacts of contrast c relative to the background.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, STEPS_PER_BLUR_WIDTH, disk_table
from contactimg.imaging.profile.limits import LEAST_FRACTION, SHOWN_BLUR_WIDTHS

Values = NDArray[np.float64]

WIDTH_RATIOS = (0.5, 0.7, 1.4, 2.0, 2.9)
"""Widths rho of the Gaussians of a point spread function, over the blur. Chosen: steps of sqrt(2), which a
sum of Gaussians hardly resolves."""

PARAMETERS = (
    *(f"width_{ratio:g}" for ratio in WIDTH_RATIOS),
    "softness", "dome", "response", "blur_x", "blur_y", "blur_xx", "blur_xy", "blur_yy",
    "trend", "rim",
)  # fmt: skip
"""Parameters w, q, d, p, the components of b, e, and h."""
WEIGHTS, SOFTNESS, DOME, RESPONSE, FIELD, TREND, RIM = slice(0, 5), 5, 6, 7, slice(8, 13), 13, 14

FAMILIES = {
    "point spread": (0, 1, 2, 3, 4),
    "softness": (SOFTNESS,),
    "plateau": (DOME,),
    "response": (RESPONSE,),
    "blur field": (8, 9, 10, 11, 12),
    "contrast": (TREND,),
    "rim": (RIM,),
}
"""Parameters that a departure from the plain edge has."""

PRIOR_STD = np.array([1.0] * 5 + [0.1, 0.5, 0.6] + [0.5] * 5 + [0.5, 0.5])
"""Normal prior of the parameters about 0. Chosen: wide against what optics do; keeps steps finite."""
LARGEST = np.array([4.0] * 5 + [0.2, 1.0, 0.8] + [0.7] * 5 + [0.7, 1.0])
"""Largest magnitudes. Chosen: beyond, the profile is no edge of a contact any more."""

RIM_RADII = 0.1  # width of a rim outside. Chosen: with its height, what a blur leaves of other widths
DEFECT_STEP = 0.02  # of the derivative by the response; accuracy
NARROWEST_BLUR_RATIO = 0.4  # of a blur that varies over the field, to its mean; accuracy: keeps it positive


@dataclass(frozen=True, eq=False)
class PlacedDisks:
    """Disks of which profiles are computed at nodes of the distance from the centre.

    Parameters
    ----------
    radius : ndarray, shape (n, 1), px
    field : ndarray, shape (n, 5)
        ``x, y, x^2 - 1/3, x y, y^2 - 1/3`` of each centre, with x and y from -1 to 1 across the image.
    distance : ndarray, shape (n, k), px
    ratio : float
        Contrast over background level; negative for dark contacts.
    """

    radius: Values
    field: Values
    distance: Values
    ratio: float

    def widened(self, step: float) -> "PlacedDisks":
        """The disks with radii larger by ``step``."""
        return PlacedDisks(self.radius + step, self.field, self.distance, self.ratio)


@dataclass(frozen=True, eq=False)
class BlurredDisks:
    """Profile of blurred disks and its derivatives, shape (n, k) each.

    Parameters
    ----------
    p, by_a, by_r : ndarray
        ``P``, ``s dP/da``, ``s dP/dr``.
    """

    p: Values
    by_a: Values
    by_r: Values

    @classmethod
    def of(cls, disks: PlacedDisks, blur: Values | float) -> "BlurredDisks":
        """Interpolated in the table of the plain disk; ``blur`` has shape (n, 1) or is common."""
        return cls(*look_up(disk_table().values, disks, blur))

    def by_s(self, disks: PlacedDisks) -> Values:
        """``s dP/ds``, times s over the unit of length."""
        return -(disks.radius * self.by_a + disks.distance * self.by_r)

    def dome(self, disks: PlacedDisks, blur: Values | float) -> Values:
        """The blurred ``1/2 - r^2/a^2``; products with x become x + s^2 d/dx under a Gaussian."""
        a, r = disks.radius, disks.distance
        squares = (r**2 + 2 * blur**2) * self.p + blur * (r * self.by_r - a * self.by_a)
        return 0.5 * self.p - squares / a**2


def blurred_profile(disks: PlacedDisks, blur: Values | float) -> Values:
    """``P`` of `BlurredDisks` alone, in a third of the time."""
    return look_up(disk_table().values, disks, blur, 1)[0]


def look_up(table: NDArray[np.float32], disks: PlacedDisks, blur: Values | float, count: int = 3) -> Values:
    """The first of ``P``, ``s dP/da``, ``s dP/dr`` from the values of an edge table, shape (count, n, k)."""
    radius = np.array(disks.radius[:, 0])
    s = np.array(np.broadcast_to(np.asarray(blur, float), disks.radius.shape)[:, 0])
    return np.asarray(_interpolate(table, radius, s, disks.distance, count))


@njit(cache=True, error_model="numpy")
def _interpolate(table, radius, blur, distance, count):
    """Profile and derivatives from the table of the plain disk, shape (count, n, k)."""
    out = np.zeros((count, *distance.shape))
    rows, columns = table.shape[:2]
    for i in range(len(radius)):
        a, s = radius[i], blur[i]
        row = s / (s + a) * (rows - 1)
        k = min(int(row), rows - 2)
        f = row - k
        for n in range(distance.shape[1]):
            column = ((distance[i, n] - a) / s + INNER_BLUR_WIDTHS) * STEPS_PER_BLUR_WIDTH
            if column <= 0.0:
                out[0, i, n] = 1.0
            elif column < columns - 1:
                j = int(column)
                g = column - j
                for m in range(count):
                    low = table[k, j, m] + g * (table[k, j + 1, m] - table[k, j, m])
                    high = table[k + 1, j, m] + g * (table[k + 1, j + 1, m] - table[k + 1, j, m])
                    out[m, i, n] = low + f * (high - low)
    return out


def respond(profile: Values, defect: float, ratio: float) -> Values:
    """Grey levels over contrast of a camera of exponent ``1 - defect`` that shows a contrast ratio."""
    if defect == 0.0:
        return profile
    gamma = 1.0 - defect
    light = max(1.0 + ratio, LEAST_FRACTION) ** (1.0 / gamma) - 1.0
    return np.asarray((np.maximum(1.0 + light * profile, LEAST_FRACTION) ** gamma - 1.0) / ratio)


def edge_profile(disks: PlacedDisks, blur: float, shape: Values) -> Values:
    """Brightness of contacts over their contrast, shape (n, k).

    Parameters
    ----------
    disks : PlacedDisks
    blur : float, px
        Pixel included.
    shape : ndarray
        Values of `PARAMETERS`.
    """
    relative = np.maximum(1.0 + disks.field @ shape[FIELD], NARROWEST_BLUR_RATIO)[:, None]
    variance = (blur * relative) ** 2 + shape[SOFTNESS] * disks.radius**2
    s = np.sqrt(np.maximum(variance, (NARROWEST_BLUR_RATIO * blur) ** 2))
    profile = plain = blurred_profile(disks, s)
    if shape[WEIGHTS].any():
        profile = profile * (1.0 - shape[WEIGHTS].sum())
        for weight, ratio in zip(shape[WEIGHTS], WIDTH_RATIOS, strict=True):
            if weight:
                profile += weight * blurred_profile(disks, ratio * s)
    if shape[DOME]:
        profile = profile + shape[DOME] * BlurredDisks.of(disks, s).dome(disks, s)
    if shape[RIM]:
        profile = profile + shape[RIM] * (blurred_profile(_with_rims(disks), s) - plain)
    if shape[TREND]:
        profile = profile * (1.0 + shape[TREND] * _smallness(disks, blur))
    return respond(profile, float(shape[RESPONSE]), disks.ratio)


def _with_rims(disks: PlacedDisks) -> PlacedDisks:
    """Disks as wide as the rims outside them."""
    return PlacedDisks((1.0 + RIM_RADII) * disks.radius, disks.field, disks.distance, disks.ratio)


def _smallness(disks: PlacedDisks, blur: float) -> Values:
    """1 for small contacts, 0 for large ones, shape (n, 1)."""
    return 1.0 / (1.0 + (disks.radius / (SHOWN_BLUR_WIDTHS * blur)) ** 2)


def edge_templates(disks: PlacedDisks, blur: float, shape: Values, chosen: Sequence[int]) -> Values:
    """Derivatives of the profile by some of the blur (0, px) and `PARAMETERS` (from 1), shape (n, m, k).

    At the plain edge, except that by the response, which is far from linear.
    """
    plain, defect = BlurredDisks.of(disks, blur), float(shape[RESPONSE])
    by_s = plain.by_s(disks) / blur**2

    def by_parameter(k: int) -> Values:
        if k < WEIGHTS.stop:
            return blurred_profile(disks, WIDTH_RATIOS[k] * blur) - plain.p
        if FIELD.start <= k < FIELD.stop:
            return by_s * blur * disks.field[:, [k - FIELD.start]]
        if k == SOFTNESS:
            return by_s * disks.radius**2 / (2 * blur)
        if k == DOME:
            return plain.dome(disks, blur)
        if k == RESPONSE:
            above, below = (respond(plain.p, defect + x, disks.ratio) for x in (DEFECT_STEP, -DEFECT_STEP))
            return (above - below) / (2 * DEFECT_STEP)
        if k == TREND:
            return plain.p * _smallness(disks, blur)
        return blurred_profile(_with_rims(disks), blur) - plain.p

    out = np.empty((len(disks.radius), len(chosen), disks.distance.shape[1]))
    for column, k in enumerate(chosen):
        out[:, column] = by_parameter(k - 1) if k else by_s
    return out
