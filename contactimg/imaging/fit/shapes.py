"""Contacts that are ellipses: found where a disk fits badly, measured, and made round for all that follows.

An accepted ellipse is replaced in the image by the disk of equal area, so that contrast, blur and edge are
settled on disks alone and its residuals about the rim stay as they are.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.detect.overlap import count_touching
from contactimg.imaging.fit.contact_pixels import look_at_pixels
from contactimg.imaging.fit.disks import FittedDisks, render_disks
from contactimg.imaging.fit.ellipse import CommonOptics, FittedEllipse, Window, fit_ellipse, render_ellipse
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, ContrastPrior, FitProblem, X, Y

POOR_CHI_SQUARE = 1.5
"""Mean chi-square about the rim above which a disk does not describe a contact. By hand."""
LEAST_ELONGATION = 1.12
"""Ratio of the axes of the counted pixels from which an ellipse is tried. By hand: pixels and noise make
1.05."""
ELLIPSE_SIGNIFICANCE = 30.0
"""``e' V^-1 e`` of an ellipticity that is not chance. False-alarm rate 3e-7: chi-square of two degrees of
freedom."""
BETTER_RATIO = 0.7
"""Chi-square of an ellipse over that of the disk that it must go below, unless it fits well. By hand."""
MOST_ELLIPSES = 400
"""Ellipses tried in a frame: the bound of the work; the widest first."""
REACH_BLUR_WIDTHS = 5.0
"""Margin of the window about a contact, besides half of its radius. Accuracy."""
LARGEST_RADIUS_PX = 250.0
"""Radius up to which an ellipse is fitted: the bound of the work on one contact."""
EXACT_OPTICS = np.diag([1e-8, 1e-8])
"""Covariance of contrast and blur that are not in question. Accuracy: keeps it regular."""


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
    problem: FitProblem,
    fit: FittedDisks,
    prior: ContrastPrior,
    covariance: NDArray[np.float64],
    *,
    everywhere: bool = False,
    among: NDArray[np.bool_] | None = None,
    rows: NDArray[np.intp] | None = None,
) -> Ellipses:
    """Ellipses where no disk describes a contact, ``everywhere``, or of some ``rows``.

    ``covariance`` is that of (ln contrast, blur); ``among`` are the disks that may be ellipses.
    """
    chosen = rows
    if chosen is None:
        tried = count_touching(fit.disks, fit.blur) == 0
        tried &= (fit.disks[:, RADIUS] > fit.blur) & (fit.disks[:, RADIUS] < LARGEST_RADIUS_PX)
        tried = tried if among is None else tried & among
        chosen = np.flatnonzero(tried if everywhere else tried & (fit.chi_square > POOR_CHI_SQUARE))
        if not everywhere and len(chosen):
            looked = look_at_pixels(problem, fit, rows=chosen)
            chosen = chosen[(looked.elongation > LEAST_ELONGATION) & (looked.border == 0.0)]
    chosen = chosen[np.argsort(-fit.disks[chosen, RADIUS], kind="stable")][:MOST_ELLIPSES]
    kept, fitted = [], []
    for row in chosen:
        ellipse = _fit_one(problem, fit, prior, covariance, int(row))
        if ellipse is not None and (
            everywhere or rows is not None or _is_better(ellipse, float(fit.chi_square[row]))
        ):
            kept.append(int(row))
            fitted.append(ellipse)
    return Ellipses(np.array(kept, np.intp), fitted, fit.blur)


def _is_better(ellipse: FittedEllipse, disk_chi_square: float) -> bool:
    """Whether an ellipse describes a contact that its disk does not."""
    chi_square = float(ellipse.chi_square[0])
    better = (
        chi_square < max(BETTER_RATIO * disk_chi_square, POOR_CHI_SQUARE) and chi_square < disk_chi_square
    )
    return bool(better and ellipse.significance > ELLIPSE_SIGNIFICANCE)


def _fit_one(
    problem: FitProblem, fit: FittedDisks, prior: ContrastPrior, covariance: NDArray[np.float64], row: int
) -> FittedEllipse | None:
    """An ellipse in the place of one disk, all others subtracted."""
    x, y, a, c = fit.disks[row]
    reach = 1.5 * a + REACH_BLUR_WIDTHS * fit.blur
    rows, columns = problem.image.shape
    box = (
        slice(max(int(y - reach), 0), min(int(y + reach) + 2, rows)),
        slice(max(int(x - reach), 0), min(int(x + reach) + 2, columns)),
    )
    if box[0].stop - box[0].start < 4 or box[1].stop - box[1].start < 4:
        return None
    own = np.array([[x - box[1].start, y - box[0].start, a, c]])
    disk = render_disks(own, fit.blur, problem.image[box].shape, profile=problem.profile)
    window = Window.of(problem, box, problem.image[box] - fit.model[box] + disk, float(fit.brightness[row]))
    moments = cv2.moments((window.image > 0.5 * c).astype(np.uint8), binaryImage=True)
    angle = 0.5 * np.arctan2(2 * moments["mu11"], moments["mu20"] - moments["mu02"])
    start = np.array([x, y, a, 0.1 * np.cos(2 * angle), 0.1 * np.sin(2 * angle), c])
    (mean,), (spread,) = prior.of_disks(fit.disks[[row]], fit.blur)
    optics = CommonOptics(float(mean), float(spread), fit.blur, covariance)
    ellipse = fit_ellipse(window, start, optics, inflation=_inflation(fit, row))
    return (
        ellipse if np.isfinite(ellipse.parameters).all() and np.isfinite(ellipse.covariance).all() else None
    )


def _inflation(fit: FittedDisks, row: int) -> float:
    """Factor of the variances of one contact for noise that pixels share."""
    chi_square = max(float(fit.chi_square[row]), 1.0)
    bare = float(np.linalg.pinv(fit.information[row, :4, :4])[RADIUS, RADIUS])
    return max(float(fit.std[row, RADIUS] ** 2) / max(bare * chi_square, 1e-300), 1.0)


def made_round(
    problem: FitProblem, fit: FittedDisks, ellipses: Ellipses, sign: float = 1.0
) -> tuple[FitProblem, NDArray[np.float64]]:
    """The image with each ellipse replaced by the disk of equal area, and the disks to start from.

    With ``sign`` -1 the disks are replaced by the ellipses again.
    """
    image, disks = problem.image.copy(), fit.disks.copy()
    for row, ellipse in zip(ellipses.rows, ellipses.fitted, strict=True):
        x, y, a, _, _, c = ellipse.parameters
        reach = 1.2 * float(ellipse.half_axes[0]) + REACH_BLUR_WIDTHS * fit.blur
        left, top = max(int(x - reach), 0), max(int(y - reach), 0)
        part = image[top : max(int(y + reach) + 2, 0), left : max(int(x + reach) + 2, 0)]
        if not part.size:
            continue
        corner = np.array([left, top, 0.0, 0.0, 0.0, 0.0])
        disk = render_disks(np.array([[x - left, y - top, a, c]]), ellipses.blur, part.shape)
        part += np.float32(sign) * (
            disk - render_ellipse(ellipse.parameters - corner, ellipses.blur, part.shape)
        )
        disks[row, [X, Y, RADIUS, CONTRAST]] = x, y, a, c
    return replace(problem, image=image), disks
