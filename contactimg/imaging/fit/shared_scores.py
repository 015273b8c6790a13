"""Scores of contacts on what they share, and the step of it that suits all of them best.

Each contact has a score on the shared quantities ``q = (ln C, s, parameters of the edge)``: the derivative of
its log-likelihood, with its own parameters p eliminated. With N the normal matrix of p, B its cross terms
with q and K the terms of q alone, the information of the contact on q and the response of p are

    J = K - B' N^-1 B,        dp/dq = -N^-1 B.

The shared quantities that suit all contacts best differ from those assumed by

    delta = (sum J)^-1 sum score,        covariance H^-1 (sum e e') H^-1,   e = score - J delta,

(a Gauss-Newton step; the covariance is that of the scatter from contact to contact, which holds whatever the
noise, drawn to H^-1 where contacts are few). Variances are as large as the contacts disagree.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.problem import CONTRAST, RADIUS, FitProblem, X, Y
from contactimg.imaging.kernels.pairs import find_pairs
from contactimg.imaging.kernels.radial_sums import add_profiles, sum_residuals
from contactimg.imaging.pixels.masks import for_kernel, touches
from contactimg.imaging.pixels.robust import SIGNIFICANT_SIGMA
from contactimg.imaging.profile.blurred_disk import INNER_BLUR_WIDTHS, blurred_disks
from contactimg.imaging.profile.edge_shape import (
    FINE_STEPS_PER_BLUR,
    INNER_NODES,
    LIGHT,
    PARAMETERS,
    SHARED,
    Edge,
    Nodes,
)
from contactimg.imaging.profile.limits import EDGE_BLUR_WIDTHS, FAINT_FRACTION, FEW

Values = NDArray[np.float64]

SMALLEST_BLUR_WIDTHS = 0.5  # radius of contacts that are looked at; smaller ones show no edge
OWN = 3  # contrast and radius of a contact, and the background about it
EVERY = np.arange(SHARED + LIGHT)
"""What contacts without a film may share."""


@dataclass(frozen=True, eq=False)
class SharedStep:
    """Step of the shared quantities that suits all contacts best.

    Parameters
    ----------
    chosen : ndarray of int
        Which of the shared quantities take part.
    delta : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    """

    chosen: NDArray[np.int64]
    delta: Values
    covariance: Values


@dataclass(frozen=True, eq=False)
class SharedScores:
    """Scores of contacts on q shared quantities, and how their p own parameters follow them.

    Parameters
    ----------
    score : ndarray, shape (m, q)
        0, like what follows, for the shared quantities that were not asked for.
    information : ndarray, shape (m, q, q)
    response : ndarray, shape (m, p, q)
        Derivative of the own parameters by the shared quantities.
    own_step : ndarray, shape (m, p)
        Newton step of the own parameters at the shared quantities assumed.
    own_std : ndarray, shape (m, p)
        Their standard uncertainties, for independent pixels and known shared quantities.
    least_factor : float
        Factor of the variances at least, for noise that neighbouring pixels share.
    """

    score: Values
    information: Values
    response: Values
    own_step: Values
    own_std: Values
    least_factor: float = 1.0

    @classmethod
    def eliminated(
        cls, normal: Values, gradient: Values, cross: Values, score: Values, information: Values,
        least_factor: float = 1.0,
    ) -> "SharedScores":  # fmt: skip
        """Scores from the normal equations of own (p) and shared (q) parameters of each contact.

        Parameters
        ----------
        normal, gradient, cross : ndarray, shapes (m, p, p), (m, p), (m, p, q)
            Of the own parameters, with their priors, and between them and the shared ones.
        score, information : ndarray, shapes (m, q), (m, q, q)
            Of the shared ones alone.
        least_factor : float
        """
        inverse = np.linalg.inv(normal)
        response = -inverse @ cross
        return cls(
            score + (gradient[:, None] @ response)[:, 0],
            information + np.swapaxes(cross, 1, 2) @ response,
            response,
            (inverse @ gradient[:, :, None])[:, :, 0],
            np.sqrt(np.maximum(np.einsum("iuu->iu", inverse), 0.0)),
            least_factor,
        )

    def total(self, chosen: NDArray[np.int64]) -> tuple[Values, Values, float, Values]:
        """Score and information of all contacts, factor of their variances, and what each score leaves."""
        score, information = self.score[:, chosen], self.information[:, chosen][:, :, chosen]
        whole, total = score.sum(axis=0), information.sum(axis=0)
        loose = np.linalg.inv(total + 1e-9 * np.diag(np.diag(total) + 1e-12))
        # what each would still change after the step that suits all best
        rest = score - information @ (loose @ whole)
        factor = max(float(np.vdot(rest @ loose, rest)) / len(chosen), self.least_factor)
        return whole, total, factor, rest

    def step(self, chosen: NDArray[np.int64], prior: tuple[Values, Values]) -> SharedStep:
        """The step of some shared quantities; ``prior`` is (score, information) of a prior of all of them."""
        here = np.ix_(chosen, chosen)
        whole, total, factor, rest = self.total(chosen)
        n, k = rest.shape
        posterior = np.linalg.inv(total / factor + prior[1][here])
        expected = (FEW + k) / n * factor * total
        scatter = (rest.T @ rest + expected) * n / (n + FEW) / factor**2 + prior[1][here]
        delta = posterior @ (whole / factor + prior[0][chosen])
        return SharedStep(chosen, delta, posterior @ scatter @ posterior)


def isolated_disks(problem: FitProblem, disks: Values, *, blur: float) -> NDArray[np.int64]:
    """Contacts whose profile no neighbour and no border disturbs, from the narrowest to the widest."""
    reach, (rows, columns) = INNER_BLUR_WIDTHS * blur, problem.image.shape
    alone = np.ones(len(disks), np.bool_)
    alone[find_pairs(disks, 0.5 * (reach + EDGE_BLUR_WIDTHS * blur)).ravel()] = False
    x, y, margin = disks[:, X], disks[:, Y], disks[:, RADIUS] + reach
    alone &= (x > margin) & (y > margin) & (x < columns - 1 - margin) & (y < rows - 1 - margin)
    chosen = np.flatnonzero(alone & (disks[:, RADIUS] > SMALLEST_BLUR_WIDTHS * blur))
    # 250 at most, for time.
    chosen = evenly(chosen[np.argsort(disks[chosen, RADIUS], kind="stable")], 250)
    # a plateau that is cut off by the sensor looks like another edge
    return chosen[~touches(problem.saturated, 1, disks, disks[:, RADIUS])[chosen]]


def evenly(chosen: NDArray, most: int) -> NDArray:
    """Choose at most so many of the contacts, evenly spread over them."""
    count = min(len(chosen), most)
    return chosen[np.linspace(0, len(chosen) - 1, count).round().astype(int)]


def rim_residuals(problem: FitProblem, disks: Values, edge: Edge) -> Values:
    """Residuals of isolated disks at the nodes about their rims; NaN for disks with many masked pixels."""
    nodes = Nodes.about(disks, problem.image.shape, edge.blur)
    fine = Nodes.about(disks, problem.image.shape, edge.blur, per_blur=FINE_STEPS_PER_BLUR)
    # By hand: half of the contrast cuts foreign objects, not an edge of another shape.
    clip = max(SIGNIFICANT_SIGMA * problem.pixel_noise, 0.5 * problem.contrast)
    return np.asarray(
        sum_residuals(
            problem.image, for_kernel(problem.valid), disks, nodes.inner, edge.profile(fine),
            (fine.step, nodes.step), nodes.distance.shape[1] - INNER_NODES, clip,
        )
    )  # fmt: skip


def rim_scores(
    problem: FitProblem, disks: Values, edge: Edge, chosen: NDArray[np.int64] = EVERY, *,
    rest: Values | float = 0.0, least_factor: float = 1.0,
) -> SharedScores:  # fmt: skip
    """Scores of disks (x, y, radius, contrast); own are contrast, radius and background.

    ``chosen``: which shared quantities, ln C the first; ``rest``: residuals at the nodes, none expected.
    """
    nodes, n = Nodes.about(disks, problem.image.shape, edge.blur), len(disks)
    profile, contrast, tight = edge.profile(nodes), problem.prior.mean, 1.0 / problem.prior.std**2
    variance = problem.noise.variance / problem.brightness_at(disks)[:, None]
    weight = 1.0 / (variance * problem.noise.at(np.clip(profile, 0.0, 1.0)))
    # nodes reach equally far from every centre: those of small contacts would lie among other rims
    weight[nodes.distance > nodes.radius + INNER_BLUR_WIDTHS * edge.blur] = 0.0
    # own contrast, background and radius, then the blur and the parameters of the edge
    slopes = disks[:, CONTRAST, None, None] * edge.derivatives(nodes, profile, chosen[1:])
    own = profile[:, None], slopes[:, :1], np.ones_like(slopes[:, :1])
    columns = np.concatenate([*own, slopes[:, 1:]], axis=1)
    products = columns @ np.swapaxes(columns * (weight * nodes.areas)[:, None], 1, 2)
    gradient, excess = (columns @ (weight * rest)[:, :, None])[:, :, 0], disks[:, CONTRAST] - contrast
    normal, by_edge, size = products[:, :OWN, :OWN], chosen[1:], SHARED + len(PARAMETERS)
    normal[:, 0, 0] += tight
    normal[:, 2, 2] += 1.0 / (FAINT_FRACTION * contrast) ** 2
    gradient[:, 0] -= tight * excess
    cross, score, information = np.zeros((n, OWN, size)), np.zeros((n, size)), np.zeros((n, size, size))
    cross[:, 0, 0], cross[:, :, by_edge] = -tight * contrast, products[:, :OWN, OWN:]
    score[:, 0], score[:, by_edge] = tight * contrast * excess, gradient[:, OWN:]
    information[:, 0, 0] = tight * contrast**2
    information[:, by_edge[:, None], by_edge] = products[:, OWN:, OWN:]
    return SharedScores.eliminated(normal, gradient[:, :OWN], cross, score, information, least_factor)


def with_plain_edges(image: NDArray[np.float32], disks: Values, edge: Edge) -> NDArray[np.float32]:
    """The image of the same disks (x, y, radius, contrast) with a plain edge of the same blur."""
    nodes = Nodes.about(disks, image.shape, edge.blur, per_blur=FINE_STEPS_PER_BLUR, reach=edge.reach)
    image, plain = image.copy(), blurred_disks(nodes.distance, nodes.radius, edge.blur)
    add_profiles(image, disks, nodes.inner, plain - edge.profile(nodes), nodes.step)
    return image
