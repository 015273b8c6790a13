"""Edges that are not a disk behind one Gaussian: a few parameters shared by all contacts.

With P(r; a, s) the blurred uniform disk, the brightness of a contact is ``R(M(r; a, s_i))``, where the light
M and the camera's response R depart from P and the identity by families of parameters:

- *point spread*: ``+ sum_j w_j [P(rho_j s) - P(s)]``, a sum of Gaussians of fixed widths. It
  conserves light, so that the area is that of the light;
- *softness*, *blur field*: ``s_i^2 = s^2 (1 + b . (x, y, x^2 - 1/3, x y, y^2 - 1/3))^2 + q a^2``, an edge
  whose width grows with the contact, and a blur that varies over the field;
- *plateau*: plus d times the blurred ``1/2 - r^2/a^2``, brighter in the middle for ``d > 0``, of mean 0;
- *rim*: plus ``h [P(r; 1.1 a) - P(r; a)]``, light (h > 0) or shadow just outside;
- *film*: plus f times the light of an air film (`film_rim`);
- *contrast*: times ``1 + e/(1 + (a/3 s)^2)``, for small contacts brighter (e > 0) or dimmer than large ones;
- *response*: ``R(m) = ((1 + c m)^g - 1)/((1 + c)^g - 1)``, g = 1 - p, for a camera whose grey levels go as
  the g-th power of the light, and contacts of contrast c relative to the background.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.profile import blurred_disk, limits
from contactimg.imaging.profile.film_rim import FilmRim, film_table

Values = NDArray[np.float64]


class Parameter(NamedTuple):
    """A parameter of the edge.

    Parameters
    ----------
    family : str
        The departure from the plain edge that it is part of.
    prior_std : float
        Of its normal prior about 0. Chosen: wide against what optics do; keeps steps finite.
    largest : float
        Its largest magnitude. Chosen: beyond, the profile is no edge of a contact any more.
    """

    family: str
    prior_std: float
    largest: float


PARAMETERS = (
    *[Parameter("point spread", 1.0, 4.0)] * 5,
    Parameter("softness", 0.1, 0.2),
    Parameter("plateau", 0.5, 1.0),
    Parameter("response", 0.6, 0.8),
    *[Parameter("blur field", 0.5, 0.7)] * 5,
    Parameter("contrast", 0.5, 0.7),
    Parameter("rim", 0.5, 1.0),
    Parameter("film", np.inf, 10.0),
)
"""Parameters w, q, d, p, the components of b, e, h and f."""
WEIGHTS, SOFTNESS, DOME, RESPONSE, FIELD, TREND, RIM, LIGHT = slice(0, 5), 5, 6, 7, slice(8, 13), 13, 14, 15
FAMILIES = {
    name: tuple(k for k, parameter in enumerate(PARAMETERS) if parameter.family == name)
    for name in dict.fromkeys(parameter.family for parameter in PARAMETERS)
}
"""Places of the parameters of each family."""
PRIOR_STD, LARGEST = np.array([parameter[1:] for parameter in PARAMETERS]).T

SHARED = 2
"""ln C and the blur come before the parameters of the edge in what contacts share."""

INNER_NODES = 6
"""Equal steps from the centre of a disk to its rim. Accuracy: the plateau of a contact is smooth."""
FINE_STEPS_PER_BLUR = 16  # nodes of profiles; theory: linear interpolation errs by (1/16)^2/8 * 0.24 = 1e-4


@dataclass(frozen=True, eq=False)
class Nodes:
    """Distances from the centres of disks, from 0 to beyond the rims, at which profiles are given.

    Parameters
    ----------
    radius : ndarray, shape (n, 1), px
    field : ndarray, shape (n, 5)
        ``x, y, x^2 - 1/3, x y, y^2 - 1/3`` of each centre, with x and y from -1 to 1 across the image.
    distance : ndarray, shape (n, k), px
        `INNER_NODES` equal steps to ``inner``, then steps of ``step``.
    inner : ndarray, shape (n,), px
    step : float, px
    """

    radius: Values
    field: Values
    distance: Values
    inner: Values
    step: float

    @classmethod
    def about(
        cls, disks: Values, shape: tuple[int, ...], blur: float, *, per_blur: int = 4,
        reach: float = blurred_disk.INNER_BLUR_WIDTHS,
    ) -> "Nodes":  # fmt: skip
        """Nodes about disks (x, y, radius) in an image of some shape, up to ``reach`` blur widths beyond.

        Examples
        --------
        >>> Nodes.about(np.array([[50.0, 50.0, 20.0]]), (100, 100), 2.0).distance[0, :9]
        array([ 0. ,  2. ,  4. ,  6. ,  8. , 10. , 12. , 12.5, 13. ])
        """
        x, y = (2.0 * disks[:, k] / max(shape[1 - k] - 1.0, 1.0) - 1.0 for k in (0, 1))
        inner, step = np.maximum(disks[:, 2] - limits.CLEAR_BLUR_WIDTHS * blur, 0.0), blur / per_blur
        beyond = step * np.arange(round((limits.CLEAR_BLUR_WIDTHS + reach) * per_blur) + 1)
        inside = inner[:, None] * (np.arange(INNER_NODES) / INNER_NODES)
        return cls(
            disks[:, [2]], np.stack([x, y, x**2 - 1 / 3, x * y, y**2 - 1 / 3], axis=-1),
            np.hstack([inside, inner[:, None] + beyond]), inner, step,
        )  # fmt: skip

    @property
    def areas(self) -> Values:
        """Area of the ring that belongs to each node, px^2, shape (n, k)."""
        return np.asarray(2.0 * np.pi * self.distance * np.gradient(self.distance, axis=1))


@dataclass(frozen=True, eq=False)
class Edge:
    """Blur and shape of the edge that all contacts share.

    Parameters
    ----------
    blur : float, px
        Pixel included.
    shape : ndarray
        Values of `PARAMETERS`.
    ratio : float
        Contrast over background level, which a response depends on; negative for dark contacts.
    film : FilmRim or None
        Air film that may shine beside the contacts.
    """

    blur: float
    shape: Values
    ratio: float = 1.0
    film: FilmRim | None = None

    @classmethod
    def plain(cls, blur: float, ratio: float = 1.0) -> "Edge":
        """A disk behind one Gaussian."""
        return cls(blur, np.zeros(len(PARAMETERS)), ratio)

    @property
    def shared(self) -> Values:
        """The shared quantities: ln C, which is 0 here, blur and shape."""
        return np.array([0.0, self.blur, *self.shape])

    def with_light(self, light: float) -> "Edge":
        """The edge with so much light of its film."""
        shape = self.shape.copy()
        shape[LIGHT] = light
        return replace(self, shape=shape)

    def moved(self, chosen: NDArray[np.int64], delta: Values) -> "Edge":
        """The edge after a step of some shared quantities, within limits."""
        change, longest = np.zeros(SHARED + len(PARAMETERS)), limits.LONGEST_STEP * self.blur
        change[chosen] = delta
        blur = max(self.blur + float(np.clip(change[1], -longest, longest)), blurred_disk.PIXEL_VARIANCE**0.5)
        steps = np.clip(change[SHARED:], -limits.LONGEST_STEP * LARGEST, limits.LONGEST_STEP * LARGEST)
        return replace(self, blur=blur, shape=np.clip(self.shape + steps, -LARGEST, LARGEST))

    @property
    def reach(self) -> float:
        """Distance beyond the rim up to which the edge changes anything, blur widths."""
        return (
            film_table(self.film, self.blur).outer
            if self.film and self.shape[LIGHT]
            else blurred_disk.INNER_BLUR_WIDTHS
        )

    def profile(self, nodes: Nodes) -> Values:
        """Brightness of contacts over their contrast, shape (n, k)."""
        shape, a, r = self.shape, nodes.radius, nodes.distance
        relative = 1.0 + (nodes.field @ shape[FIELD])[:, None]
        variance = (self.blur * relative) ** 2 + shape[SOFTNESS] * a**2
        s = np.sqrt(np.maximum(variance, (0.4 * self.blur) ** 2))  # accuracy: stays positive
        plain = light = blurred_disk.blurred_disks(r, a, s)
        # Widths rho over the blur. Chosen: steps of sqrt(2), which a sum of Gaussians hardly resolves.
        for weight, ratio in zip(shape[WEIGHTS], (0.5, 0.7, 1.4, 2.0, 2.9), strict=True):
            if weight:
                light = light + weight * (blurred_disk.blurred_disks(r, a, ratio * s) - plain)
        if shape[DOME]:
            light = light + shape[DOME] * blurred_dome(r, a, s)
        if shape[RIM]:
            # Chosen: with its height, a rim of a tenth of the radius is what a blur leaves of other widths.
            light = light + shape[RIM] * (blurred_disk.blurred_disks(r, (1.0 + 0.1) * a, s) - plain)
        if shape[LIGHT] and self.film is not None:
            table = film_table(self.film, self.blur).values
            light = light + shape[LIGHT] * (blurred_disk.look_up(table, r, a, self.blur)[0] - plain)
        if shape[TREND]:
            light = light * (1.0 + shape[TREND] / (1.0 + (a / (limits.SHOWN_BLUR_WIDTHS * self.blur)) ** 2))
        return self._respond(light) if shape[RESPONSE] else light

    def _respond(self, light: Values) -> Values:
        """Grey levels over contrast of a camera of exponent ``1 - p``."""
        gamma = 1.0 - float(self.shape[RESPONSE])
        full = max(1.0 + self.ratio, limits.LEAST_FRACTION) ** (1.0 / gamma) - 1.0
        return np.asarray((np.maximum(1.0 + full * light, limits.LEAST_FRACTION) ** gamma - 1.0) / self.ratio)

    def derivatives(self, nodes: Nodes, profile: Values, chosen: NDArray[np.int64]) -> Values:
        """Derivatives of the profile by the radius and some of the shared quantities, shape (n, 1 + m, k)."""
        out = np.empty((len(profile), 1 + len(chosen), profile.shape[1]))
        step = limits.LEAST_FRACTION * self.blur
        out[:, 0] = (self.profile(replace(nodes, radius=nodes.radius + step)) - profile) / step
        steps = limits.LEAST_FRACTION * np.array([1.0, self.blur, *np.minimum(PRIOR_STD, 1.0)])
        for column, k in enumerate(chosen, 1):
            changed = self.shared
            changed[k] += steps[k]
            other = replace(self, blur=float(changed[1]), shape=changed[SHARED:])
            out[:, column] = (other.profile(nodes) - profile) / steps[k]
        return out


def blurred_dome(r: Values, a: Values, s: Values | float) -> Values:
    """The blurred ``1/2 - r^2/a^2``; products with x become x + s^2 d/dx under a Gaussian."""
    p, by_a, by_r = blurred_disk.look_up(blurred_disk.disk_table().values, r, a, s, 3)
    return np.asarray(0.5 * p - ((r**2 + 2 * s**2) * p + s * (r * by_r - a * by_a)) / a**2)
