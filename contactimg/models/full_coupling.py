"""Full coupling: the neighbours' displacement field over the width of a contact.

Coupling ``hertz`` replaces the neighbours' point forces by Hertz's pressure. Coupling ``full`` takes the
displacement about each summit as far as the fifth power of ``a/r``:

- its slope ``G`` shifts the contact sideways, by ``-R G`` for a paraboloid, to where the deformed surface and
  the cap are closest; displacements are then taken between the shifted contacts;
- its average over all directions, ``T rho^2/2 + c rho^4``, adds to the profile of the cap;
- its saddle makes the contact elliptic: to second order that bears more force on a larger area, and the
  ellipse displaces the others less along its short axis.

Below ``r/a`` of about 3 ``hertz`` alone is less accurate than point forces, because it removes only one of
several errors that partly cancel.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.compiled import njit
from contactimg.mechanics import sphere
from contactimg.models.asperity_laws import AdhesiveLaw, Caps, LayerLaw, SphereLaw
from contactimg.models.coupling import Fields
from contactimg.models.newton_iteration import ContactSystem, Iterate, evaluate_iterate

Values = NDArray[np.float64]

MAX_PREVIOUS_CORRECTIONS = 4
"""Previous corrections used by Anderson mixing. Chosen by hand: it affects the number of steps only."""

MIN_CURVATURE_FACTOR = 0.1
"""Least ``1 + R T``. Chosen by hand, to keep the radius positive on the way to a solution."""

MAX_SADDLE_RATIO = 0.5
"""Largest ratio of saddle and mean curvature on the way to a solution. Chosen by hand: a series in it."""

MAX_RATIO = 0.99
"""Largest ``a/R`` of a sphere in these corrections, which diverge at its equator. Chosen by hand."""


@dataclass(frozen=True, eq=False)
class CapCorrection:
    """The changes of the caps by the fields of their neighbours.

    Parameters
    ----------
    shift_x, shift_y : ndarray, shape (n,)
        Sideways shifts of the forces.
    rise : ndarray, shape (n,)
        Rise of the gaps where displacements are taken at the summits.
    shifted_rise : ndarray, shape (n,)
        The same where they are taken at the shifted places.
    bends : ndarray, shape (n, 2)
        `Caps.bends`.
    """

    shift_x: Values
    shift_y: Values
    rise: Values
    shifted_rise: Values
    bends: Values

    @classmethod
    def of(cls, fields: Fields, radius: Values, contact_radius: Values, aspect: float) -> "CapCorrection":
        """The correction by given fields; ``aspect`` is 0 for paraboloids, `SphereLaw.aspect` for spheres.

        A slope ``G`` or a saddle ``t`` moves the edge and adds to the force at a given indentation: to second
        order ``a G^2/k`` and ``4/9 a^3 t^2/k``, by the reciprocal theorem. The area follows from the
        stiffness, which is that of a flat punch. A circle of lower gap and smaller curvature has both.
        """
        curvatures = np.stack([1 / radius, np.zeros_like(radius), 1 / radius])
        if aspect:
            ratio = np.minimum(aspect * contact_radius / radius, MAX_RATIO)
            value, growth, mean = sphere.scaled_curvatures(ratio)
            curvatures = np.stack([value / radius, growth * aspect**2 / radius**3, mean / radius])
        saddles = bounded_saddle(fields, radius)
        terms = _correction_terms(np.stack(fields), saddles, radius, contact_radius, curvatures)
        return cls(terms[0], terms[1], terms[2], terms[3], bends=np.ascontiguousarray(terms[4:].T))


@njit(cache=True, error_model="numpy")
def _correction_terms(fields, saddles, radius, contact_radius, curvatures):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The fields of `CapCorrection`, row by row; the bends are the last two."""
    terms = np.empty((6, radius.size))
    for i in range(radius.size):
        excess, slope_x, slope_y, curvature, quartic = fields[:5, i]
        value, growth, mean = curvatures[:, i]
        squared, quartic = contact_radius[i] ** 2, max(quartic, 0.0)
        sloping, steeper = (slope_x * slope_x + slope_y * slope_y) / value, growth / value
        # the edge on the profile that the neighbours have bent
        bent = max(value + curvature, MIN_CURVATURE_FACTOR * value) + 16 / 3 * quartic * squared
        n = (growth + 32 / 3 * quartic) * squared / bent
        saddle = (saddles[0, i] ** 2 + saddles[1, i] ** 2) / bent
        # a gap of rho^3 cos(phi) over a circle of radius a shifts the force like a slope of 0.8 a^2
        tilt_x = slope_x + 0.8 * squared * fields[7, i]
        tilt_y = slope_y + 0.8 * squared * fields[8, i]
        rise = excess - (0.5 + 0.25 * steeper * squared) * sloping - (1 + n) / 9 * squared * saddle
        bend = curvature + 0.75 * sloping * steeper - (1 - n) / 3 * saddle
        terms[0, i], terms[1, i], terms[2, i] = -tilt_x / mean, -tilt_y / mean, rise
        terms[3, i] = rise + (slope_x * tilt_x + slope_y * tilt_y) / mean
        terms[4, i] = max(bend, (MIN_CURVATURE_FACTOR - 1) / radius[i])
        terms[5, i] = quartic
    return terms


def bounded_saddle(fields: Fields, radius: Values) -> Values:
    """The saddle (2, n), at most `MAX_SADDLE_RATIO` of the mean curvature."""
    saddle = np.stack([fields.saddle_x, fields.saddle_y])
    largest = MAX_SADDLE_RATIO * np.maximum(1 + radius * fields.curvature, MIN_CURVATURE_FACTOR) / radius
    return saddle / np.maximum(1.0, np.hypot(*saddle) / largest)


def pressure_radius(contact_radius: Values, radius: Values, aspect: float) -> Values:
    """Radius of a Hertz contact whose pressure has the same second moment over its force.

    Theory: the second moment of a sphere's pressure is ``(2/5) a^2 (1 + (8/105) (a/R)^2)``, to that order.
    """
    return contact_radius * np.sqrt(1 + 8 / 105 * (aspect * contact_radius / radius) ** 2)


@dataclass(frozen=True, eq=False)
class FieldCorrection:
    """Adds the field corrections at an iterate to a system of point forces.

    The corrections depend on the forces and the forces on the
    corrections. The fixed point is approached with one Newton step between two updates, and the updates are
    extrapolated by Anderson mixing.

    Parameters
    ----------
    base : ContactSystem
        Point forces at the summits.
    x, y : ndarray
        The summits.
    full : bool
        Include all terms, not only Hertz's pressure.
    """

    base: ContactSystem
    x: Values
    y: Values
    full: bool
    _history: list[tuple[Values, Values]] = field(default_factory=list)
    _tried: list[Values] = field(default_factory=list)

    @property
    def aspect(self) -> float:
        """Unit of height over unit of length for spheres; 0 for paraboloids."""
        law = self.base.law.contact if isinstance(self.base.law, LayerLaw) else self.base.law
        return law.aspect if isinstance(law, SphereLaw | AdhesiveLaw) else 0.0

    def apply(self, system: ContactSystem, at: Iterate) -> tuple[ContactSystem, Iterate]:
        """The system corrected with the fields at an iterate, and that iterate evaluated in it."""
        contact_radius = at.contact_radius
        if isinstance(system.law, LayerLaw):  # of which the iterate has half the stiffness
            contact_radius = system.law.contact_radius(at.penetration(system), system.caps)
        if not self.full:
            fields = system.coupling.fields(at.force, contact_radius)
            refined = replace(self.base, gap=self.base.gap + self._extrapolated(fields.excess))
            return refined, evaluate_iterate(refined, at.force, at.indentation, at.displacement)
        radius, saddle = self.base.caps.radius, None
        if self._tried:
            saddle = bounded_saddle(Fields(*self._tried[-1].reshape(len(Fields._fields), -1)), radius)
        wide = pressure_radius(contact_radius, radius, self.aspect)
        computed = np.stack(system.coupling.fields(at.force, wide, saddle))
        fields = Fields(*self._extrapolated(computed.ravel()).reshape(computed.shape))
        terms = CapCorrection.of(fields, radius, contact_radius, self.aspect)
        refined = replace(
            self.base,
            gap=self.base.gap + terms.shifted_rise,
            caps=Caps(radius, bends=terms.bends),
            coupling=system.coupling.at_positions(self.x + terms.shift_x, self.y + terms.shift_y),
        )
        displacement = refined.coupling.displacement(at.force)
        return refined, evaluate_iterate(refined, at.force, at.indentation, displacement)

    def _extrapolated(self, computed: Values) -> Values:
        """The next corrections to try; ``computed`` are those that follow from the last ones tried."""
        if self._tried:
            self._history.append((self._tried.pop(), computed))
            del self._history[: -MAX_PREVIOUS_CORRECTIONS - 1]
            before, after = (np.stack(part) for part in zip(*self._history, strict=True))
            errors, computed = after - before, after[-1]
            if len(after) > 1:  # Anderson mixing: the combination whose error is least
                changes = np.diff(errors, axis=0)
                weights = np.linalg.lstsq(changes @ changes.T, changes @ errors[-1], rcond=1e-16)[0]
                computed = after[-1] - weights @ np.diff(after, axis=0)
        self._tried.append(computed)
        return computed
