"""Fit of one blurred ellipse to the pixels of a contact, with the blur and the contrast of its frame.

The half-axes a >= b at the angle t enter as the radius r = sqrt(a b) of the circle of equal area and the
ellipticity e = ln(a/b)/2 (cos 2t, sin 2t), which is regular at the circle: a disk is e = 0, and the errors of
area and of shape do not mix.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.problem import FitProblem
from contactimg.imaging.fit.shared_optics import DiskScores
from contactimg.imaging.kernels.ellipse_equations import (
    PARAMETERS,
    draw_ellipse,
    eliminate_parameters,
    fit_one_ellipse,
)
from contactimg.imaging.pixels.masks import Mask, for_kernel

X, Y, RADIUS, E1, E2, CONTRAST = range(PARAMETERS)
"""Parameters of an ellipse."""

ITERATIONS = 12
"""Damped Gauss-Newton steps at most. Accuracy: four are usual."""
LEAST_SPREAD_FRACTION = 1e-3
"""Smallest spread of the contrasts assumed, of the contrast. Accuracy: keeps the prior finite."""


@dataclass(frozen=True, eq=False)
class CommonOptics:
    """What all contacts of a frame share, in pixels of the fit.

    Parameters
    ----------
    contrast, spread : float
        Common contrast, and its spread from contact to contact, grey levels.
    blur : float
        Standard deviation of the blurred edge, px.
    covariance : ndarray, shape (2, 2)
        Of (ln contrast, blur).
    """

    contrast: float
    spread: float
    blur: float
    covariance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Window:
    """Pixels about one contact, with all other contacts subtracted.

    Parameters
    ----------
    image : ndarray of float32, shape (rows, columns)
    valid : Mask
    corner : (int, int)
        Column and row of its first pixel in the image.
    noise : Noise
        At the brightness of this place.
    """

    image: NDArray[np.float32]
    valid: Mask
    corner: tuple[int, int]
    noise: Noise

    @classmethod
    def of(
        cls, problem: FitProblem, box: tuple[slice, slice], image: NDArray[np.float32], brightness: float
    ) -> "Window":
        """The pixels of a box of the problem, with other values there."""
        part = problem.window(box, np.ascontiguousarray(image, np.float32), brightness)
        return cls(part.image, part.valid, (box[1].start, box[0].start), part.noise)


@dataclass(frozen=True, eq=False)
class FittedEllipse:
    """An ellipse fitted to the pixels of a window.

    Parameters
    ----------
    parameters : ndarray, shape (6,)
        x, y (px of the image), radius of the circle of equal area (px), the two components of the
        ellipticity, contrast.
    covariance : ndarray, shape (6, 6)
        From the noise of its own pixels, as far as it fits them.
    shifts : ndarray, shape (6, 2)
        Changes with one standard uncertainty of the common contrast, and of the remaining one of the blur.
    chi_square : ndarray, shape (2,)
        Mean squared residual over its variance, about the rim and inside it (NaN without such pixels).
    pixels : int
        About the rim.
    scores : DiskScores
        Of the common contrast and blur, for `settle_on_ellipses`; one row.
    loss : float
        Sum over the window, outliers linearly, and of the prior.
    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    shifts: NDArray[np.float64]
    chi_square: NDArray[np.float64]
    pixels: int
    scores: DiskScores
    loss: float

    @classmethod
    def unknown(cls) -> "FittedEllipse":
        """The ellipse where none was fitted."""
        square, nothing = np.full((PARAMETERS, PARAMETERS), np.nan), np.full((1, PARAMETERS, 2), np.nan)
        scores = DiskScores(nothing[:, 0], nothing[:, :2], nothing)
        return cls(square[0], square, nothing[0], square[0, :2], 0, scores, float("nan"))

    @property
    def ellipticity(self) -> float:
        """``ln(a/b)/2``."""
        return float(np.hypot(*self.parameters[[E1, E2]]))

    @property
    def angle(self) -> float:
        """Angle of the major axis, from +x towards +y, between -pi/2 and pi/2, rad."""
        return float(0.5 * np.arctan2(self.parameters[E2], self.parameters[E1]))

    @property
    def half_axes(self) -> NDArray[np.float64]:
        """Major and minor half-axis, px."""
        return np.asarray(self.parameters[RADIUS] * np.exp([self.ellipticity, -self.ellipticity]))

    @property
    def total_covariance(self) -> NDArray[np.float64]:
        """The covariance with the part of contrast and blur."""
        return np.asarray(self.covariance + self.shifts @ self.shifts.T)

    @property
    def significance(self) -> float:
        """``e' V^-1 e``: distributed for a disk as chi-square of two degrees of freedom."""
        e1, e2 = self.parameters[E1 : E2 + 1]
        (v11, v12), (_, v22) = self.total_covariance[E1 : E2 + 1, E1 : E2 + 1]
        return float((v22 * e1 * e1 - 2.0 * v12 * e1 * e2 + v11 * e2 * e2) / (v11 * v22 - v12 * v12))

    @property
    def shape_std(self) -> NDArray[np.float64]:
        """Standard uncertainties of major and minor half-axis (px) and of the angle (rad)."""
        eta, radius = max(self.ellipticity, 1e-9), self.parameters[RADIUS]
        along = self.parameters[[E1, E2]] / eta
        slopes = np.zeros((3, PARAMETERS))
        for row, sign in enumerate((1.0, -1.0)):
            half_axis = radius * np.exp(sign * eta)
            slopes[row, RADIUS] = half_axis / radius
            slopes[row, [E1, E2]] = sign * half_axis * along
        slopes[2, [E1, E2]] = np.array([-along[1], along[0]]) / (2.0 * eta)
        return np.sqrt(np.einsum("ij,jk,ik->i", slopes, self.total_covariance, slopes))


def fit_ellipse(
    window: Window,
    start: NDArray[np.float64],
    optics: CommonOptics,
    *,
    inflation: float,
    misfit: float = 1.0,
    circular: bool = False,
) -> FittedEllipse:
    """Fit an ellipse to the pixels of a window.

    Parameters
    ----------
    window : Window
    start : ndarray, shape (6,)
        In the image.
    optics : CommonOptics
    inflation : float
        Factor of the variances for noise that pixels share.
    misfit : float
        Least mean squared residual over its variance that is believed; less than 1 where all contacts show
        less noise than the background let expect.
    circular : bool
        Hold the ellipticity at that of the start.

    Returns
    -------
    FittedEllipse
    """
    offset = np.array([*window.corner, 0.0, 0.0, 0.0, 0.0])
    noise = np.array([window.noise.variance, window.noise.slope / optics.contrast])
    spread = max(optics.spread, LEAST_SPREAD_FRACTION * optics.contrast)
    prior = np.array([optics.contrast, spread])
    parameters, normal, score, chi_square, pixels, loss = fit_one_ellipse(
        window.image,
        for_kernel(window.valid),
        start - offset,
        optics.blur,
        noise,
        prior,
        circular,
        ITERATIONS,
    )
    inverse, response, own_score, information = eliminate_parameters(
        parameters, normal, score, optics.contrast, spread
    )
    shifts = response @ np.linalg.cholesky(optics.covariance)
    scale = inflation * max(float(chi_square[0]) if pixels else 1.0, misfit)
    scores = DiskScores(own_score[None], information[None], response[None])
    return FittedEllipse(
        parameters + offset, scale * inverse, shifts, chi_square, int(pixels), scores, float(loss)
    )


def render_ellipse(
    parameters: NDArray[np.float64], blur: float, shape: tuple[int, int]
) -> NDArray[np.float32]:
    """Image of one blurred ellipse.

    Parameters
    ----------
    parameters : ndarray, shape (6,)
    blur : float, px
        Standard deviation, pixel included.
    shape : (int, int)

    Examples
    --------
    >>> image = render_ellipse(np.array([16.0, 12.0, 6.0, 0.3, 0.0, 100.0]), 1.0, (25, 33))
    >>> float(image.sum().round(-1))  # pi 6^2 x 100
    11310.0
    """
    image = np.zeros(shape, np.float32)
    draw_ellipse(image, parameters, blur)
    return image
