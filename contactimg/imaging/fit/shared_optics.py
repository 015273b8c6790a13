"""Brightness and blur, which all contacts of a frame share: what a frame tells about them, and their errors.

A disk has a centre, a radius and a contrast of its own, p; contrasts scatter about a common value C with a
known spread, and the blur s is common. With N the normal matrix of p (its prior included) and B its cross
terms with q = (ln C, s), the frame's information about q and the response of each disk to q are

    J = sum (K - B' N^-1 B),        dp/dq = -N^-1 B,

K being the terms of q alone. A wide contact shows its contrast, which sharpens J; a small one, of which only
the light is seen, has a radius that goes as C^(-1/2) and says little about C. Several small ones together
still may: the maximum of the likelihood over q is found by Newton's steps with J, the disks fitted in
between, and what is known of q beforehand enters as a normal prior.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.disks import CONTRAST, RADIUS, DiskFit, Drawing, Prior, fit_disks
from contactimg.imaging.pixels.masks import Mask
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE, EdgeTable
from contactimg.imaging.profile.optics import SharedOptics

EXACT = 1e-4  # relative width of a prior that is said to be exact
STEPS = 20
LONGEST = 0.4, 0.25  # step of ln C, and of the blur relative to it
LINEAR = 0.003  # relative step up to which disks follow in proportion: what that leaves is its square
FINE = 0.003  # of its standard deviation: error of a radius at which a fit tells how the optics should change
SIGNIFICANT = 0.2  # of the uncertainty of the sum of a^3: a smaller step is not worth another fit
PLATEAU = 0.02  # relative: error of the contrast that wide contacts show where edges are not those assumed
DISAGREE = 2.0  # factor of the variance of the votes from which on edges are not those assumed
VOTES = 10  # contacts whose scatter tells how much too small the errors from noise alone are


@dataclass(frozen=True, eq=False)
class Settled:
    """Disks at the most probable common contrast and blur.

    Parameters
    ----------
    fit : DiskFit
    contrast, spread : float
        Grey levels.
    shown : float
        Contrast that wide contacts show; NaN if there are none.
    covariance : ndarray, shape (2, 2)
        Of (ln contrast, blur in px of the fit, pixel included), what was known before included.
    own : ndarray, shape (2, 2)
        The same from this frame alone, as far as it tells anything.
    modes : ndarray, shape (n, 2)
        Change of each radius (px) by one standard uncertainty of the contrast, the blur following as the fit
        would have it, and of the rest of the blur: two independent errors common to all disks.
    """

    fit: DiskFit
    contrast: float
    spread: float
    shown: float
    covariance: NDArray[np.float64]
    own: NDArray[np.float64]
    modes: NDArray[np.float64]

    def optics(self, covariance: NDArray[np.float64], *, binning: int) -> SharedOptics:
        """Contrast and blur with errors of a given covariance, in pixels of the frame."""
        sigma = np.sqrt(max(self.fit.blur**2 - PIXEL_VARIANCE, 0.0))
        std = np.sqrt(np.diag(covariance))
        return SharedOptics(
            contrast=self.contrast,
            contrast_std=self.contrast * float(std[0]),
            spread=self.spread,
            blur_px=float(sigma) * binning,
            blur_std_px=float(std[1] * self.fit.blur / max(sigma, 0.1)) * binning,
            correlation=float(covariance[0, 1] / (std[0] * std[1])),
        )


@dataclass(frozen=True, eq=False)
class Known:
    """Normal prior of (ln contrast, blur in px of the fit) in the form of its information.

    Parameters
    ----------
    mean : ndarray, shape (2,)
    information : ndarray, shape (2, 2)
        Zero where nothing is known.
    """

    mean: NDArray[np.float64]
    information: NDArray[np.float64]

    @classmethod
    def of(cls, optics: SharedOptics, *, contrast: float, blur: float, binning: int) -> "Known":
        """What is known beforehand, in the lengths of a fit to pixels binned ``binning`` by ``binning``.

        Where nothing is known, ``contrast`` and ``blur`` are the brightest light seen and a guess: contacts
        are up to ten times as bright as what the blur leaves of them, and the guess is good to a factor 2.
        """
        known = np.isfinite([optics.contrast, optics.blur_px])
        mean = np.array([np.log(contrast) + 0.5 * np.log(10.0), blur])
        std = np.array([np.log(10.0) / np.sqrt(12.0), 0.5 * blur])
        if known[0]:
            mean[0] = np.log(optics.contrast)
            std[0] = max(optics.contrast_relative_std, EXACT)
        if known[1]:
            mean[1] = np.hypot(optics.blur_px / binning, np.sqrt(PIXEL_VARIANCE))
            slope = optics.blur_px / binning**2 / mean[1]
            std[1] = max(optics.blur_std_px * slope, EXACT * mean[1])
        correlation = np.eye(2)
        if known.all():
            correlation[0, 1] = correlation[1, 0] = optics.correlation
        return cls(mean, np.asarray(np.linalg.inv(correlation * np.outer(std, std)), float))

    def with_blur(self, blur: float) -> "Known":
        """The same with a blur that is not in question."""
        information = np.diag([self.information[0, 0], 1.0 / (EXACT * blur) ** 2])
        return Known(np.array([self.mean[0], blur]), information)


def settle_optics(
    image: NDArray[np.float32],
    valid: Mask,
    fit: DiskFit,
    *,
    noise: Noise,
    prior: Prior,
    brightness: NDArray[np.float64],
    known: Known,
    inflation: NDArray[np.float64],
    shown: float,
    table: EdgeTable | None = None,
) -> Settled:
    """Find the common contrast and blur that explain an image best, and the disks with them.

    Parameters
    ----------
    image, valid, noise, brightness, table
        As for `contactimg.imaging.fit.disks.fit_disks`.
    fit : DiskFit
        With the prior; at least one disk.
    prior : Prior
        Its mean is where contrasts start, its width their spread.
    known : Known
    inflation : ndarray, shape (n,)
        Factor of the variances for what the noise model leaves out.
    shown : float
        Contrast that wide contacts show; NaN if there are none.

    Returns
    -------
    Settled
        A frame whose contrast and blur are right to a fraction of the errors keeps its fit as it is.
    """
    contrast, relative = float(prior.mean[0]), float(prior.std[0] / prior.mean[0])
    per_level, least = noise.slope / contrast, float(np.median(inflation))
    blur, before = fit.blur, np.zeros(2)
    for remaining in reversed(range(STEPS)):
        terms = _Terms.of(fit, contrast=contrast, relative=relative)
        scatter = terms.scatter(least)
        # where contacts disagree, edges are not those assumed; the plateau of wide contacts does not care
        plateau = np.isfinite(shown) * max(1.0 - DISAGREE / scatter, 0.0) / PLATEAU**2
        own = terms.information.sum(axis=0) / scatter + np.diag([plateau, 0.0])
        gradient = terms.gradient.sum(axis=0) / scatter
        gradient[0] += plateau * np.log(shown / contrast) if plateau else 0.0
        gradient += known.information @ (known.mean - np.array([np.log(contrast), blur]))
        covariance = np.linalg.inv(own + known.information)
        step = covariance @ gradient
        if not remaining or not _matters(step, fit, terms, covariance):
            break
        step *= 0.5 if step @ before < 0 else 1.0
        before = step = np.clip(step, [-LONGEST[0], -LONGEST[1] * blur], [LONGEST[0], LONGEST[1] * blur])
        contrast, blur = contrast * float(np.exp(step[0])), blur + float(step[1])
        if abs(step[0]) < LINEAR and abs(step[1]) < LINEAR * blur:
            fit = fit.replace(disks=fit.disks + terms.follow @ step, blur=blur)
            break
        disks = fit.disks.copy()
        disks[:, RADIUS] = np.maximum(disks[:, RADIUS] + terms.response @ step, 0.3 * disks[:, RADIUS])
        disks[:, CONTRAST] *= np.exp(step[0])
        n = len(disks)
        fit = fit_disks(
            image, valid, disks, blur=blur, noise=Noise(noise.variance, per_level * contrast),
            prior=Prior(np.full(n, contrast), np.full(n, relative * contrast)), brightness=brightness,
            free_blur=False, iterations=6, tolerance=FINE, table=table,
            drawing=Drawing.partly(image.shape, n),
        )  # fmt: skip
    least_information = np.diag(1e-6 / np.array([1.0, blur]) ** 2)
    modes = terms.response @ np.linalg.cholesky(covariance)
    return Settled(
        fit, contrast, relative * contrast, shown, covariance, np.linalg.inv(own + least_information), modes
    )


def _matters(step: NDArray, fit: DiskFit, terms: "_Terms", covariance: NDArray) -> bool:
    """Whether a step changes the sum of a^3 by more than a fraction of its uncertainty."""
    weights = 3.0 * fit.disks[:, RADIUS] ** 2
    slope = weights @ terms.response
    common = slope @ covariance @ slope
    return bool((slope @ step) ** 2 > SIGNIFICANT**2 * (common + np.sum((weights * fit.std[:, RADIUS]) ** 2)))


@dataclass(frozen=True, eq=False)
class _Terms:
    """What each disk tells about (ln contrast, blur), and how its parameters follow them."""

    information: NDArray[np.float64]  # (n, 2, 2)
    gradient: NDArray[np.float64]  # (n, 2)
    follow: NDArray[np.float64]  # (n, 4, 2)

    @property
    def response(self) -> NDArray[np.float64]:
        """How the radius follows, shape (n, 2)."""
        return self.follow[:, RADIUS]

    @classmethod
    def of(cls, fit: DiskFit, *, contrast: float, relative: float) -> "_Terms":
        """From the last normal equations of a fit with this contrast and relative spread as its prior."""
        tight = 1.0 / (relative * contrast) ** 2
        excess = fit.disks[:, CONTRAST] - contrast
        own = fit.information[:, :4, :4].copy()
        cross = np.zeros((len(own), 4, 2))
        cross[:, 3, 0], cross[:, :, 1] = -tight * contrast, fit.information[:, :4, 4]
        # a disk outside the image or under a mask tells nothing: keep its matrix regular
        own += 1e-9 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(4)
        follow = -np.asarray(np.linalg.solve(own, cross), float)
        information = np.swapaxes(cross, 1, 2) @ follow
        information[:, 0, 0] += tight * contrast**2
        information[:, 1, 1] += fit.information[:, 4, 4]
        gradient = np.stack([tight * contrast * excess, fit.pull], axis=-1)
        return cls(_without_negative(information), gradient, follow)

    def scatter(self, least: float) -> float:
        """Factor of the variances: how much more the disks disagree than their noise explains."""
        if len(self.gradient) < VOTES:
            return max(least, 1.0)
        total = np.linalg.inv(self.information.sum(axis=0))
        # what each would still change after the step that suits them all
        rest = self.gradient - self.information @ (total @ self.gradient.sum(axis=0))
        return max(least, 0.5 * float(np.einsum("ni,ij,nj->", rest, total, rest)), 1.0)


def _without_negative(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Symmetric matrices with the negative eigenvalues, which rounding leaves, set to zero."""
    values, vectors = np.linalg.eigh(matrices)
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2))
