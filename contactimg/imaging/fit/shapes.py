"""Contacts that are ellipses: found where a disk fits badly, fitted, and made round for all that follows.

The half-axes a >= b at the angle t enter as the radius r = sqrt(a b) of the circle of equal area and the
ellipticity e = ln(a/b)/2 (cos 2t, sin 2t), which is regular at the circle: a disk is e = 0, and the errors of
area and of shape do not mix.

An accepted ellipse is replaced in the image by the disk of equal area, so that contrast, blur and edge are
settled on disks alone and its residuals about the rim stay as they are.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.contact_pixels import look_at_pixels
from contactimg.imaging.fit.disks import FittedDisks, render_disks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, ContrastPrior, FitProblem, X, Y
from contactimg.imaging.kernels.ellipse_equations import sample_ellipse, sum_over_ellipse
from contactimg.imaging.kernels.pairs import count_touching
from contactimg.imaging.pixels.masks import Values, for_kernel
from contactimg.imaging.profile import limits

E1, E2, LIGHT = 3, 4, 5
"""Columns of the ellipticity and the contrast among the parameters of an ellipse, after x, y and radius."""

WIDEST_ELLIPTICITY = 1.2
"""Largest component of the ellipticity: ratio 11 along it. By hand: keeps a fit from needles."""
LEAST_ELONGATION = 1.03
"""Ratio of the axes of the counted pixels from which an ellipse is tried where a disk fits badly, and that of
the ellipse from which it is taken. By hand: a neighbour not found yet makes 1.02 of a disk of 20 px."""
EXACT_OPTICS = np.diag([1e-8, 1e-8])
"""Covariance of contrast and blur that are not in question. Accuracy: keeps it regular."""


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
    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    shifts: NDArray[np.float64]
    chi_square: NDArray[np.float64]

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
        slopes = np.zeros((3, len(self.parameters)))
        for row, sign in enumerate((1.0, -1.0)):
            half_axis = radius * np.exp(sign * eta)
            slopes[row, RADIUS] = half_axis / radius
            slopes[row, [E1, E2]] = sign * half_axis * along
        slopes[2, [E1, E2]] = np.array([-along[1], along[0]]) / (2.0 * eta)
        return np.sqrt(np.einsum("ij,jk,ik->i", slopes, self.total_covariance, slopes))


def fit_ellipse(
    window: FitProblem, start: NDArray[np.float64], *, blur: float, prior: tuple[float, float],
    covariance: NDArray[np.float64], inflation: float = 1.0,
) -> FittedEllipse:  # fmt: skip
    """Fit an ellipse to the pixels of a window, outliers linearly (Huber).

    Parameters
    ----------
    window : FitProblem
        Pixels about one contact, with all other contacts subtracted.
    start : ndarray, shape (6,)
        In the window.
    blur : float, px
        Standard deviation of the blurred edge.
    prior : (float, float)
        Mean and width of the contrast, grey levels.
    covariance : ndarray, shape (2, 2)
        Of (ln contrast, blur), which all contacts share.
    inflation : float
        Factor of the variances for noise that pixels share.
    """
    contrast, spread = prior[0], max(prior[1], limits.LEAST_FRACTION * prior[0])
    noise, valid = window.noise, for_kernel(window.valid)
    a, size = start[RADIUS], max(start[RADIUS], blur)
    limit = np.array([size, size, a + blur, 2 * WIDEST_ELLIPTICITY, 2 * WIDEST_ELLIPTICITY, 3.0 * contrast])
    low = np.array([-np.inf, -np.inf, min(0.5 * a, 0.1 * blur), *[-WIDEST_ELLIPTICITY] * 2, 0.3 * contrast])
    high = np.array([np.inf, np.inf, np.inf, *[WIDEST_ELLIPTICITY] * 2, 3.0 * contrast])
    p, best, least, damping = start, start, np.inf, 1e-3
    for _ in range(limits.ITERATIONS):
        products, right = np.empty((7, 7)), np.empty(6)
        variance = noise.variance, noise.slope / contrast
        sums = sum_over_ellipse(window.image, valid, p, blur, *variance, products, right)
        loss = sums[0] + ((p[LIGHT] - contrast) / spread) ** 2
        if not loss >= least:  # the first, or a better one; NaN ends as parameters that are not finite
            small, best, least, damping = least - loss < limits.SETTLED_SIGMA**2, p, loss, 0.1 * damping
            normal, by_blur, gradient, fitted = products[:6, :6], products[:6, 6], right, sums[1:]
            normal[LIGHT, LIGHT] += spread**-2.0
            gradient[LIGHT] += (contrast - p[LIGHT]) / spread**2
            if small:
                break
        else:
            damping = max(10.0 * damping, 1e-3)
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), gradient)
        p = np.clip(best + np.clip(step, -limit, limit), low, high)
        if damping < 0.1 and step @ gradient < limits.SETTLED_SIGMA**2:
            break
    # a regularisation treats all parameters alike
    sizes = np.array([blur, blur, blur, 0.1, 0.1, contrast])
    inverse = np.linalg.inv(normal + 1e-9 * np.trace(normal * sizes**2) * np.diag(sizes**-2.0))
    cross = np.column_stack([[0.0] * 5 + [-contrast / spread**2], by_blur])
    chi_square = np.array([total / count if count else np.nan for total, count in fitted])
    offset = np.array([*window.corner, 0.0, 0.0, 0.0, 0.0])
    scale = inflation * np.fmax(chi_square[0], 1.0)
    shifts = -inverse @ cross @ np.linalg.cholesky(covariance)
    return FittedEllipse(best + offset, scale * inverse, shifts, chi_square)


def render_ellipse(parameters: NDArray[np.float64], blur: float, shape: tuple[int, int]) -> Values:
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
    return np.asarray(parameters[LIGHT] * sample_ellipse(shape, parameters, blur)[:, :, 5], np.float32)


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Ellipses among the disks of a fit.

    Parameters
    ----------
    rows : ndarray of int, shape (m,)
        Row of each among the disks.
    fitted : list of FittedEllipse, m
    blur : float, px
        At which they were fitted, pixel included.
    """

    rows: NDArray[np.intp]
    fitted: list[FittedEllipse]
    blur: float = 1.0

    def kept(self, kept: NDArray[np.bool_]) -> "Ellipses":
        """The ellipses of the disks that stay, in their new rows."""
        new = np.cumsum(kept) - 1
        stay = [k for k, row in enumerate(self.rows) if kept[row]]
        return Ellipses(new[self.rows[stay]].astype(np.intp), [self.fitted[k] for k in stay], self.blur)


NO_ELLIPSES = Ellipses(np.zeros(0, np.intp), [])


def find_ellipses(
    problem: FitProblem, fit: FittedDisks, prior: ContrastPrior, covariance: NDArray[np.float64], *,
    everywhere: bool = False, among: NDArray[np.bool_] | None = None, rows: NDArray[np.intp] | None = None,
    elongation: tuple[float, float] = (LEAST_ELONGATION, np.inf), known: Ellipses = NO_ELLIPSES,
) -> Ellipses:  # fmt: skip
    """Ellipses where no disk describes a contact, ``everywhere``, or of some ``rows``.

    ``covariance`` is that of (ln contrast, blur); ``among`` are the disks that may be ellipses, those whose
    counted pixels have axes of a ratio between the two of ``elongation``. Fits of ``known`` ellipses
    start from these where they describe the pixels.
    """
    chosen = rows
    if chosen is None:
        chosen = poor_disks(fit, 0.0 if everywhere else limits.POOR_CHI_SQUARE)
        chosen = chosen if among is None else chosen[among[chosen]]
        if not everywhere and len(chosen):
            looked = look_at_pixels(problem, fit, rows=chosen)
            low, high = elongation
            chosen = chosen[(looked.elongation > low) & (looked.elongation < high) & (looked.border == 0.0)]
    # The widest 400 bound the work.
    chosen = chosen[np.argsort(-fit.disks[chosen, RADIUS], kind="stable")][:400]
    kept, fitted, starts = [], [], dict(zip(known.rows.tolist(), known.fitted, strict=True))
    for row in chosen:
        ellipse = _fit_one(problem, fit, prior, covariance, int(row), starts.get(int(row)))
        if ellipse is None:
            continue
        least, disk = float(ellipse.chi_square[0]), float(fit.chi_square[row])
        # By hand: well below the disk, unless the ellipse fits well.
        better = least < min(max(0.7 * disk, limits.POOR_CHI_SQUARE), disk)
        better &= np.exp(2.0 * ellipse.ellipticity) > LEAST_ELONGATION
        if everywhere or rows is not None or (better and ellipse.significance > limits.TWO_SIGNIFICANT):
            kept.append(int(row))
            fitted.append(ellipse)
    return Ellipses(np.array(kept, np.intp), fitted, fit.blur)


def poor_disks(fit: FittedDisks, chi_square: float = limits.POOR_CHI_SQUARE) -> NDArray[np.intp]:
    """Disks that touch no other, wide enough to show a shape, which fit worse than that."""
    radius = fit.disks[:, RADIUS]
    # Up to 250 px: the bound of the work on one contact.
    wide = (radius > fit.blur) & (radius < 250.0) & (fit.chi_square > chi_square)
    return np.flatnonzero(wide & (count_touching(fit.disks, fit.blur) == 0))


def _fit_one(
    problem: FitProblem, fit: FittedDisks, prior: ContrastPrior, covariance: NDArray[np.float64], row: int,
    known: FittedEllipse | None,
) -> FittedEllipse | None:  # fmt: skip
    """An ellipse in the place of one disk, all others subtracted.

    The fit starts from the ``known`` ellipse if that describes the pixels, else from the disk.
    """
    x, y, a, c = fit.disks[row]
    reach = 1.5 * a + limits.REACH_BLUR_WIDTHS * fit.blur
    rows, columns = problem.image.shape
    left, top = max(int(x - reach), 0), max(int(y - reach), 0)
    box = slice(top, min(int(y + reach) + 2, rows)), slice(left, min(int(x + reach) + 2, columns))
    if box[0].stop - top < 4 or box[1].stop - left < 4:
        return None
    own = np.array([[x - left, y - top, a, c]])
    disk = render_disks(own, fit.blur, problem.image[box].shape, profile=problem.profile)
    image = np.asarray(problem.image[box] - fit.model[box] + disk, np.float32)
    window = problem.window(box, image, float(fit.brightness[row]))
    if known is None or not known.chi_square[0] < limits.POOR_CHI_SQUARE:
        moments = cv2.moments((window.image > 0.5 * c).astype(np.uint8), binaryImage=True)
        angle = 0.5 * np.arctan2(2 * moments["mu11"], moments["mu20"] - moments["mu02"])
        start = np.array([*own[0, :2], a, 0.1 * np.cos(2 * angle), 0.1 * np.sin(2 * angle), c])
    else:
        start = known.parameters - np.array([left, top, 0.0, 0.0, 0.0, 0.0])
    (mean,), (spread,) = prior.of_disks(fit.disks[[row]], fit.blur)
    # variances are larger by the noise that pixels share
    chi_square = max(float(fit.chi_square[row]), 1.0)
    bare = float(np.linalg.pinv(fit.information[row, :4, :4])[RADIUS, RADIUS])
    if not bare > 0.0:  # no pixel shows it
        return None
    ellipse = fit_ellipse(
        window, start, blur=fit.blur, prior=(float(mean), float(spread)), covariance=covariance,
        inflation=max(float(fit.std[row, RADIUS] ** 2) / (bare * chi_square), 1.0),
    )  # fmt: skip
    finite = np.isfinite(ellipse.parameters).all() and np.isfinite(ellipse.covariance).all()
    return ellipse if finite else None


def made_round(
    problem: FitProblem, fit: FittedDisks, ellipses: Ellipses, sign: float = 1.0
) -> tuple[FitProblem, NDArray[np.float64]]:
    """The image with each ellipse replaced by the disk of equal area, and the disks to start from.

    With ``sign`` -1 the disks are replaced by the ellipses again.
    """
    image, disks = problem.image.copy(), fit.disks.copy()
    for row, ellipse in zip(ellipses.rows, ellipses.fitted, strict=True):
        x, y, a, _, _, c = ellipse.parameters
        reach = 1.2 * float(ellipse.half_axes[0]) + limits.REACH_BLUR_WIDTHS * fit.blur
        left, top = max(int(x - reach), 0), max(int(y - reach), 0)
        part = image[top : max(int(y + reach) + 2, 0), left : max(int(x + reach) + 2, 0)]
        if not part.size:
            continue
        corner = np.array([left, top, 0.0, 0.0, 0.0, 0.0])
        disk = render_disks(np.array([[x - left, y - top, a, c]]), ellipses.blur, part.shape)
        shown = render_ellipse(ellipse.parameters - corner, ellipses.blur, part.shape)
        part += np.float32(sign) * (disk - shown)
        disks[row, [X, Y, RADIUS, CONTRAST]] = x, y, a, c
    return replace(problem, image=image), disks
