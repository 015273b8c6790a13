"""Contrast and blur of a frame most of whose contacts are ellipses, from the ellipses themselves.

A disk behind a blur s that is fitted to an ellipse of half-axes a e^h, a e^-h sees its rim at ``a h cos 2t``
about its own, of mean square ``a^2 h^2/2``: the common blur of such disks is too wide by about
``a^2 h^2/(4 s)``, half-axes of ellipses behind it too small, and misfits look like another edge.
The same Newton steps that settle contrast and blur on disks (`contactimg.imaging.fit.shared_optics`) settle
them here on ellipses. The disks that remain follow by their derivatives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.ellipse import CommonOptics, FittedEllipse
from contactimg.imaging.fit.shared_optics import NARROWEST, DiskScores, JointFit
from contactimg.imaging.judge.common_distortion import FEWEST_CONTACTS
from contactimg.imaging.pixels.robust import MAD_TO_STD, median

Values = NDArray[np.float64]

LEAST_ELLIPSE_SHARE = 0.2
"""Share of the contacts that must be ellipses. Chosen: fewer hardly change the blur of all, of which they
would have to be the only witnesses."""
LEAST_INFORMATION = 1e-6  # on ln C and ln s; accuracy: keeps what ellipses do not determine finite
STEPS = 5  # Newton steps at most; accuracy: three are usual
SETTLED_STD = 0.1  # step over its standard uncertainty that ends them; accuracy
LONGEST_STEP = np.array([0.1, 0.3])  # of ln C, and of the blur relative to it; as `LONGEST_BLUR_STEP`
OUTLIER_RATIO = 3.0
"""Mean squared residual over the median of all beyond which a contact is no witness. Chosen: free shapes."""
WITNESSED = ("score", "information")  # of each contact
CLIPPED_SIGMA = 4.0
"""The same of its score, in standard deviations. False-alarm rate: 6e-5."""


@dataclass(frozen=True, eq=False)
class OpticsChange:
    """What ellipses say of contrast and blur that disks did not.

    Parameters
    ----------
    optics : CommonOptics
    step : ndarray, shape (2,)
        Change of (ln contrast, blur).
    misfit : float
        Median of the mean squared residuals over their variance.
    """

    optics: CommonOptics
    step: Values
    misfit: float

    def shifts(self, joint: JointFit) -> tuple[Values, Values]:
        """Change of the radius of each disk of a joint fit (px), and its shifts by the new uncertainties."""
        response = joint.radius_shifts @ np.linalg.inv(np.linalg.cholesky(joint.covariance))
        return response @ self.step, response @ np.linalg.cholesky(self.optics.covariance)


def settle_on_ellipses(
    ellipses: Sequence[FittedEllipse],
    refit: Callable[[Sequence[FittedEllipse], CommonOptics], list[FittedEllipse]],
    optics: CommonOptics,
    known: Values,
) -> OpticsChange | None:
    """Find the contrast and the blur that suit ellipses best.

    Parameters
    ----------
    ellipses : sequence of FittedEllipse
        Behind the present optics.
    refit : callable
        Fits the same ellipses behind other optics.
    optics : CommonOptics
        From the disks.
    known : ndarray, shape (2, 2)
        Information of what was known of (ln contrast, blur) before.

    Returns
    -------
    OpticsChange or None
        None if the ellipses are too few.
    """
    if sum(each.pixels > 0 for each in ellipses) < FEWEST_CONTACTS:
        return None
    now, current, total = optics, list(ellipses), np.zeros(2)
    for _ in range(STEPS):
        score, information = _witnesses(current).total(1.0, np.nan)
        covariance = np.asarray(np.linalg.inv(information + known), float)
        now = replace(now, covariance=covariance)
        step = covariance @ (score - known @ total)
        if float(step @ (information + known) @ step) < SETTLED_STD**2:
            break
        longest = LONGEST_STEP * [1.0, now.blur]
        step = np.clip(step, np.maximum(-longest, [-np.inf, NARROWEST - now.blur]), longest)
        total = total + step
        now = CommonOptics(
            now.contrast * float(np.exp(step[0])),
            now.spread,
            now.blur + float(step[1]),
            covariance,
        )
        current = refit(current, now)
    misfit = float(np.nanmedian([each.chi_square[0] for each in current]))
    return OpticsChange(now, total, misfit)


def prior_information(joint: JointFit, optics: CommonOptics) -> Values:
    """How much of (ln contrast, blur) was known before a joint fit of disks."""
    known = np.linalg.inv(joint.covariance) - np.linalg.inv(joint.own_covariance)
    return np.asarray(known + np.diag(LEAST_INFORMATION / np.array([1.0, optics.blur]) ** 2))


def _witnesses(ellipses: Sequence[FittedEllipse]) -> DiskScores:
    """Scores of the ellipses that fit as well as most, and that agree with most on the blur."""
    misfit = np.array([each.chi_square[0] for each in ellipses])
    fits = misfit <= OUTLIER_RATIO * np.nanmedian(misfit)
    parts = [each.scores for each, good in zip(ellipses, fits, strict=True) if good]
    score, information = (np.concatenate([getattr(part, name) for part in parts]) for name in WITNESSED)
    # the step of the blur that suits each alone, in its standard deviations
    certain = np.sqrt(np.maximum(information[:, 1, 1], 1e-30))
    blur = score[:, 1] / certain**2
    away = np.abs(blur - median(blur)) * certain
    near = away <= CLIPPED_SIGMA * max(MAD_TO_STD * median(away), 1.0)
    response = np.concatenate([part.response for part in parts])
    return DiskScores(score[near], information[near], response[near])
