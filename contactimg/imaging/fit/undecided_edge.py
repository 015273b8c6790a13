"""Edges that the contacts of a frame do not exclude, and what they mean for the radii.

Few contacts, or small ones, do not show whether their edge is plain. Every family of edges
(`contactimg.imaging.profile.edge_shape.FAMILIES`) therefore remains possible with the probability that its
prior and the residuals of all contacts give it. With the score S and the information H of the shared
quantities, and an assumption that leaves the parameters c free and sets the others to d,

    ln Z = S'd - d'Hd/2 + s'(H_cc + P)^-1 s/2 + ln(det P/det(H_cc + P))/2,

s being ``(S - Hd)_c`` and the score of the prior, P the information of the prior (Laplace's approximation,
exact for a linear problem). The prior of a
family that is present vanishes at the plain edge, ``p(x) ~ (x/t)^2 N(x; 0, t^2)``: a departure too small to
matter is not worth a name, and many contacts exclude a family quickly (V. E. Johnson and D. Rossell, J. R.
Stat. Soc. B 72 (2010) 143, doi:10.1111/j.1467-9868.2009.00730.x, "moment
priors").
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from contactimg.imaging.fit.edge_scores import SHARED, Edge, parameters_of
from contactimg.imaging.profile.edge_shape import FAMILIES, FIELD, RIM, SOFTNESS

Values = NDArray[np.float64]

USUAL_SIZE = np.array([0.3] * 5 + [0.005, 0.2, 0.55] + [0.2] * 5 + [0.15, 0.2])
"""Usual sizes t of the parameters of an edge where a family is present. Chosen: what lenses, cameras and
contacts do: point spread functions that a defocus or a halo changes by a third; rims as soft as 7 % of the
radius; domes of 20 %; a gamma of 1/2; a blur that varies by 20 %; small contacts dimmer by 15 %;
rims of 20 % of the contrast."""
PRIOR_ODDS = dict.fromkeys(FAMILIES, 0.1) | {"rim": 0.3, "response": 0.15}
"""Odds of each family against the plain edge before the frame is looked at. Chosen: one frame in ten has it;
light outside the rims, which few contacts cannot show at all, three in ten, and a gamma, which cameras have
unless it is switched off, three in twenty. What is not decided goes with the square root of these odds."""
POSITIVE = {"softness": SOFTNESS, "rim": RIM}
"""Families whose parameter cannot be negative: rims are soft, and the gap beside a contact shines."""
LEAST_PROBABILITY = 1e-6  # of an assumption that is looked at; accuracy


@dataclass(frozen=True, eq=False)
class EdgeEvidence:
    """What contacts say of the quantities that all share, ``q = (ln C, s, parameters of the edge)``.

    Parameters
    ----------
    edge : Edge
        About which scores and information are taken.
    score, information : ndarray, shapes (17,), (17, 17)
        Of all contacts together, in units of the variances that they show; without priors.
    radius : ndarray, shape (m,), px
        Of the contacts that were looked at.
    response : ndarray, shape (m, 17)
        Derivatives of their radii by q, px.
    """

    edge: Edge
    score: Values
    information: Values
    radius: Values
    response: Values

    def response_of(self, radius: Values, field: Values) -> Values:
        """Responses of other contacts, shape (n, 17), from those of equal radius.

        ``field`` are their places, see `contactimg.imaging.profile.edge_shape.PlacedDisks`.
        """
        order = np.argsort(self.radius, kind="stable")
        known, values = self.radius[order], self.response[order]
        response = np.column_stack([np.interp(radius, known, column) for column in values.T])
        at = slice(SHARED + FIELD.start, SHARED + FIELD.stop)
        response[:, at] = self.edge.blur * field * response[:, [1]]
        return response


@dataclass(frozen=True, eq=False)
class Assumption:
    """Some families of edges, and what the frame says if they are those that are present.

    Parameters
    ----------
    families : tuple of str
    log_weight : float
        Logarithm of prior odds times evidence.
    delta : ndarray, shape (17,)
        Most probable shared quantities minus those of the evidence.
    covariance : ndarray, shape (17, 17)
        Of those that are free, zero elsewhere.
    inflation : dict
        Family -> factor of the second moments of its only parameter by the prior that vanishes at zero.
    softness : float
        Expected square of the softness; 0 without it.
    """

    families: tuple[str, ...]
    log_weight: float
    delta: Values
    covariance: Values
    inflation: dict[str, float]
    softness: float

    @classmethod
    def of(
        cls, families: tuple[str, ...], evidence: EdgeEvidence, optics: tuple[Values, Values]
    ) -> "Assumption":
        """Of an evidence and the prior of contrast and blur, (score, information)."""
        chosen, shape = parameters_of(families), evidence.edge.shape
        size = SHARED + len(shape)
        offset, prior, pull = np.zeros(size), np.zeros((size, size)), np.zeros(size)
        offset[SHARED:] = -shape
        offset[chosen] = 0.0
        prior[SHARED:, SHARED:] = np.diag(USUAL_SIZE**-2)
        prior[:SHARED, :SHARED], pull[:SHARED], pull[SHARED:] = optics[1], optics[0], -shape / USUAL_SIZE**2
        score, information = evidence.score, evidence.information
        here = np.ix_(chosen, chosen)
        whole = (score - information @ offset + pull)[chosen]
        covariance = np.linalg.inv(information[here] + prior[here])
        logs = np.linalg.slogdet(prior[here])[1] + np.linalg.slogdet(covariance)[1]
        free = chosen[chosen >= SHARED] - SHARED
        logs += whole @ covariance @ whole - np.sum((shape[free] / USUAL_SIZE[free]) ** 2)
        log_weight = float(score @ offset - 0.5 * offset @ information @ offset + 0.5 * logs)
        everything = np.zeros((size, size))
        everything[here] = covariance
        delta = offset
        delta[chosen] += covariance @ whole
        value, variance = shape + delta[SHARED:], np.diag(everything)[SHARED:]
        inflation, softness = {}, 0.0
        for name in families:
            at = list(FAMILIES[name])
            mean = float(np.mean((value[at] ** 2 + variance[at]) / USUAL_SIZE[at] ** 2))
            log_weight += np.log(PRIOR_ODDS[name] * mean)
            if len(at) == 1:
                t = value[at[0]] ** 2 / variance[at[0]]
                inflation[name] = float((t**2 + 6 * t + 3) / (t + 1) ** 2)
            if name in POSITIVE:
                log_weight += np.log(2.0 * ndtr(np.sqrt(t) * np.sign(value[at[0]])) + 1e-300)
            if name == "softness":
                softness = float(inflation[name] * (value[SOFTNESS] ** 2 + variance[SOFTNESS]))
        return cls(families, log_weight, delta, everything, inflation, softness)


def alternatives(families: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Families of assumptions that differ by one: one more, one less, one exchanged."""
    others = [name for name in FAMILIES if name not in families]
    for dropped in ("", *families):
        kept = tuple(name for name in families if name != dropped)
        if dropped:
            yield kept
        yield from ((*kept, name) for name in others)


def undecided_modes(
    evidence: EdgeEvidence,
    families: tuple[str, ...],
    optics: tuple[Values, Values],
    *,
    radius: Values,
    field: Values,
) -> Values:
    """Independent errors of the radii because the frame does not decide between edges.

    Parameters
    ----------
    evidence : EdgeEvidence
        About the edge that was assumed.
    families : tuple of str
        That were assumed to be present.
    optics : (ndarray, ndarray)
        Prior of ln C and s: score and information.
    radius, field : ndarray, shapes (n,), (n, 5)
        Of all contacts.

    Returns
    -------
    ndarray, shape (n, k), px
        Each column weighted by the probability of its assumption.
    """
    assumed = Assumption.of(families, evidence, optics)
    others = [Assumption.of(each, evidence, optics) for each in alternatives(families)]
    logs = np.array([each.log_weight for each in (assumed, *others)])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    response, modes = evidence.response_of(radius, field), [np.zeros((len(radius), 1))]
    for weight, other in zip(weights[1:], others, strict=True):
        if weight > LEAST_PROBABILITY:
            modes.append(np.sqrt(weight) * _modes_of(other, assumed, response))
            modes.append(np.sqrt(weight * np.sqrt(other.softness)) * radius[:, None])
    return np.column_stack(modes)


def _modes_of(other: Assumption, assumed: Assumption, response: Values) -> Values:
    """Shift of the radii from one assumption to another, and its uncertainty beyond that of the first."""
    shift = response @ (other.delta - assumed.delta)
    new = [name for name in other.families if name not in assumed.families]
    modes, scale = [shift], 1.0
    for name in new:
        at = SHARED + np.array(FAMILIES[name])
        block = other.covariance[np.ix_(at, at)]
        # what follows the new parameters: their own response, and that of what is fitted along
        along = response @ (other.covariance[:, at] @ np.linalg.inv(block))
        modes += list((along @ np.linalg.cholesky(block)).T)
        scale *= other.inflation.get(name, 1.0)
    return np.sqrt(scale) * np.stack(modes, axis=1)
