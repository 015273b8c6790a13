"""The edge that the contacts of a frame share, learned from the frame where its residuals call for it.

A plain edge, a disk behind one Gaussian, is assumed first. A family of other edges has the odds

    ln odds = ln prior odds + delta' V^-1 delta/2 + ln(det V/det S)/2,

with delta the step of its parameters that suits all isolated contacts best, V its covariance and S that of
its prior (Laplace's approximation). The family with the largest odds joins, if they exceed `TAKEN_ODDS` and
Newton's steps settle what the rims then share, and so on until no other family is that probable. The
difference between learned and plain profile of each contact is subtracted from the image, which the plain fit
then measures: at the solution the residuals of the learned edge have no part along any derivative. What is
not taken changes the radii with the probability that it has, which is part of the uncertainties. What other
frames of a series know of the edge enters as a prior.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.problem import CONTRAST, RADIUS, WIDE_RADIUS_BLUR_WIDTHS, FitProblem
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior, as_common_error
from contactimg.imaging.fit.shared_scores import (
    EVERY,
    SharedScores,
    SharedStep,
    evenly,
    isolated_disks,
    rim_residuals,
    rim_scores,
    with_plain_edges,
)
from contactimg.imaging.pixels.robust import SOME
from contactimg.imaging.profile.edge_shape import (
    DOME,
    FAMILIES,
    FIELD,
    LIGHT,
    PRIOR_STD,
    RESPONSE,
    RIM,
    SHARED,
    SOFTNESS,
    TREND,
    Edge,
)
from contactimg.imaging.profile.limits import FEW, FEWEST, ITERATIONS, ROUGH_STD, ROUNDS, SETTLED_SIGMA
from contactimg.imaging.profile.optics import EdgeKnowledge, SharedOptics

Values = NDArray[np.float64]
Refine = Callable[[FitProblem, FittedDisks, OpticsPrior], JointFit]

INDISTINCT = ({"softness", "response"}, {"softness", "rim"}, {"softness", "point spread"})
"""Families of which only one is assumed: a soft rim that is not symmetric looks like a nonlinear response,
light outside like a soft rim, and soft rims of equally large contacts like a point spread function."""
TAKEN_ODDS = 100.0
"""Odds at which an edge that nothing but the rims speaks for is taken. Chosen: one that is not there is drawn
in one such frame of a hundred; what is not taken remains in the uncertainties."""


@dataclass(frozen=True, eq=False)
class LearnedEdge:
    """The edges that the frame shows.

    Parameters
    ----------
    edge : Edge
    families : tuple of str
        That take part, keys of `contactimg.imaging.profile.edge_shape.FAMILIES`; empty for a plain edge.
    std : ndarray
        Standard uncertainties of the parameters of the edge; 0 for those that take no part.
    undecided : ndarray, shape (n,), px
        Change of the radii by the other edge that would change the areas most.
    knowledge : EdgeKnowledge or None
        What the frame alone says of its edges, for others.
    """

    edge: Edge
    families: tuple[str, ...] = ()
    std: Values = field(default_factory=lambda: np.zeros(0))
    undecided: Values = field(default_factory=lambda: np.zeros(0))
    knowledge: EdgeKnowledge | None = None

    @property
    def gamma(self) -> tuple[float, float]:
        """Exponent of the camera's response and its uncertainty; (1, 0) for a linear one."""
        if "response" not in self.families:
            return 1.0, 0.0
        return 1.0 - float(self.edge.shape[RESPONSE]), float(self.std[RESPONSE])


def describe_edge(learned: LearnedEdge, *, binning: int) -> str:
    """A sentence about an edge that is not plain; empty for a plain one."""
    edge, parts = learned.edge, []
    if "point spread" in learned.families:
        parts.append("a point spread function that is not a Gaussian")
    if "softness" in learned.families:
        width = np.sqrt(max(float(edge.shape[SOFTNESS]), 0.0))
        parts.append(
            f"a width that grows with the contact ({width:.2g} of the radius): a soft rim cannot be told "
            "from a larger contact"
        )
    if "rim" in learned.families:
        what = "light" if edge.shape[RIM] > 0 else "shadow"
        parts.append(
            f"{what} just outside the contacts ({abs(edge.shape[RIM]):.2g} of the contrast over a tenth of "
            "the radius), which cannot be told from a larger or smaller contact"
        )
    if "plateau" in learned.families:
        middle = "brighter" if edge.shape[DOME] > 0 else "darker"
        parts.append(f"contacts {middle} in the middle (by {abs(edge.shape[DOME]):.2g} of the contrast)")
    if "blur field" in learned.families:
        x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
        terms = np.stack([x, y, x**2 - 1 / 3, x * y, y**2 - 1 / 3], axis=-1)
        blur = edge.blur * binning * (1 + terms @ edge.shape[FIELD])
        parts.append(f"a blur between {blur.min():.2g} and {blur.max():.2g} px over the frame")
    if "contrast" in learned.families:
        trend, what = abs(edge.shape[TREND]), "brighter" if edge.shape[TREND] > 0 else "dimmer"
        parts.append(f"small contacts {trend:.2g} {what} than large ones")
    if "response" in learned.families:
        gamma, std = learned.gamma
        parts.append(
            f"the camera's response looks nonlinear: gamma about {gamma:.2f} +- {std:.2f} "
            "(set [camera] gamma, or switch it off in the camera)"
        )
    return "" if not parts else "the edges show " + ", and ".join(parts)


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """A frame's problem with the difference to the plain edge subtracted, its fit, and the edge."""

    problem: FitProblem
    joint: JointFit
    learned: LearnedEdge


@dataclass(frozen=True, eq=False)
class Rims:
    """Isolated disks (x, y, radius, contrast) at a common contrast and an edge, and the last step to them.

    They are ``settled`` unless Newton's steps did not suffice.
    """

    disks: Values
    contrast: float
    edge: Edge
    step: SharedStep
    settled: bool = True


class Option(NamedTuple):
    """One family more: the step with it, the logarithm of its odds, and Wald's statistic of its values."""

    step: SharedStep
    log_odds: float
    wald: float


def parameters_of(families: tuple[str, ...]) -> NDArray[np.int64]:
    """Places of ln C, s and the parameters of families; a point spread function has widths of its own."""
    columns = [SHARED + k for name in families for k in FAMILIES[name]]
    return np.array([0, *columns] if "point spread" in families else [0, 1, *columns])


@dataclass(frozen=True, eq=False)
class EdgeSearch:
    """A frame in which an edge is searched.

    Parameters
    ----------
    problem : FitProblem
        With the original image.
    joint : JointFit
        Of it, with a plain edge.
    optics_prior : OpticsPrior
    ratio : float
        Contrast over background level; negative for dark contacts.
    refine : callable
        Fits the disks of a problem anew: ``refine(problem, fit, optics_prior)``.
    given : SharedOptics
        What other frames say of the edge, and whether a reference contact has told where in its edge a
        contact ends.
    linear : bool
        Whether the camera is known to be linear.
    """

    problem: FitProblem
    joint: JointFit
    optics_prior: OpticsPrior
    ratio: float
    refine: Refine
    given: SharedOptics
    linear: bool = False

    @property
    def plain(self) -> Edge:
        """A disk behind the blur of the fit."""
        return Edge.plain(self.joint.fit.blur, self.ratio)

    @cached_property
    def isolated(self) -> NDArray[np.int64]:
        """Contacts with the contrast of the frame whose profile nothing disturbs."""
        disks = self.joint.fit.disks
        isolated = isolated_disks(self.problem, disks, blur=self.joint.fit.blur)
        return isolated[self.joint.prior.is_odd(disks)[isolated] < 0]

    def at(self, contrast: float) -> FitProblem:
        """The problem at another common contrast."""
        return replace(self.problem, prior=self.joint.prior.at(contrast))

    def scores(self, rims: Rims, chosen: NDArray[np.int64] = EVERY) -> tuple[SharedScores, Rims]:
        """Scores of those of the rims that no hole disturbs, and these rims."""
        problem = self.at(rims.contrast)
        rest = rim_residuals(problem, rims.disks, rims.edge)
        whole = np.isfinite(rest[:, 0])
        rims = replace(rims, disks=rims.disks[whole])
        factor = self.joint.least_factor
        return rim_scores(problem, rims.disks, rims.edge, chosen, rest=rest[whole], least_factor=factor), rims

    def prior(self, edge: Edge, contrast: float, *, own: bool = False) -> tuple[Values, Values]:
        """Prior of the shared quantities, score and information; ``own``: without what other frames tell."""
        information = np.diag([0.0, 0.0, *PRIOR_STD**-2.0])
        score = -information @ edge.shared
        information[:SHARED, :SHARED] = 1e-6 * np.diag([1.0, edge.blur**-2])
        if own:
            return score, information
        information[:SHARED, :SHARED] = self.optics_prior.information
        score[:SHARED] = self.optics_prior.score(contrast, edge.blur)
        if self.given.edge is not None:
            score[SHARED:] += self.given.edge.score_at(edge.shape)
            information[SHARED:, SHARED:] += self.given.edge.information
        return score, information

    def settle(self, start: Rims, families: tuple[str, ...]) -> Rims:
        """The maximum of the likelihood of isolated rims over what families share.

        Each rim has a radius, a contrast and a background of its own.
        """
        chosen, every = parameters_of(families), start.disks
        rims = replace(start, disks=evenly(every, SOME))  # until they have settled, for time
        last, share = np.zeros(len(chosen)), 1.0
        most = np.log(min(self.problem.largest_contrast, self.problem.shown_contrast))
        for _ in range(ITERATIONS):
            scores, rims = self.scores(rims, chosen)
            if not len(rims.disks):
                break
            step = scores.step(chosen, self.prior(rims.edge, rims.contrast))
            # steps that go to and fro become shorter
            share = 0.5 * share if last @ np.linalg.solve(step.covariance, step.delta) < 0.0 else 1.0
            delta = share * step.delta
            beyond = max(delta[0] - most + np.log(rims.contrast), 0.0)
            # the others follow a contrast at its limit
            delta -= beyond * step.covariance[:, 0] / step.covariance[0, 0]
            edge = rims.edge.moved(chosen, delta)
            # a parameter at its limit does not move any more
            delta[1:] = (edge.shared - rims.edge.shared)[chosen[1:]]
            last, own = delta, scores.own_step + scores.response[:, :, chosen] @ delta
            disks = _moved(rims.disks, own)
            rims = Rims(disks, rims.contrast * float(np.exp(delta[0])), edge, step)
            far = float(np.max(np.abs(own[:, 1]) / scores.own_std[:, 1]))
            if delta @ np.linalg.solve(step.covariance, delta) < SETTLED_SIGMA**2 and far < 0.5:
                if len(every) <= SOME:
                    return rims
                rims, every = replace(rims, disks=every), every[:0]
        return replace(rims, settled=False)

    def start(self, edge: Edge, joint: JointFit | None = None) -> Rims:
        """The isolated rims of a fit at an edge."""
        joint = joint or self.joint
        chosen, covariance = np.array([0, 1]), np.diag([1.0, edge.blur**2])
        step = SharedStep(chosen, np.zeros(2), covariance)
        return Rims(joint.fit.disks[self.isolated], joint.contrast, edge, step)

    def options(self, scores: SharedScores, rims: Rims, families: tuple[str, ...]) -> dict[str, Option]:
        """The families that may be there besides some."""
        found, prior = {}, self.prior(rims.edge, rims.contrast)
        for name, columns in FAMILIES.items():
            absent = name == "film" or (self.linear and name == "response")
            if absent or name in families or any({name, *families} >= pair for pair in INDISTINCT):
                continue
            step = scores.step(parameters_of((*families, name)), prior)
            own = slice(-len(columns), None)
            part, covariance = step.delta[own], step.covariance[own, own]
            wald = float(part @ np.linalg.solve(covariance, part))
            known = np.linalg.slogdet(covariance)[1] - 2.0 * np.sum(np.log(PRIOR_STD[list(columns)]))
            # Chosen: one frame in ten has such an edge; of cameras that nobody calls linear one in three has
            # a gamma or a tone curve.
            odds = np.log(0.5 if name == "response" else 0.1) + 0.5 * (wald + known)
            found[name] = Option(step, float(odds), wald)
        return found

    def learn(self) -> EdgeFit:
        """Learn the edge of a frame's contacts, and fit them with it.

        Returns
        -------
        EdgeFit
            With a plain edge where nothing else is significant, where fewer than `FEW` are isolated,
            or too few of them wide; uncertainties include what is undecided. Unchanged where the pixels are
            too coarse for the rims.
        """
        plain = EdgeFit(self.problem, self.joint, LearnedEdge(self.plain))
        if self.problem.noise.rim > 0:
            return plain
        lent = self.given.edge
        if lent is not None and lent.families:
            spread = "point spread" in lent.families
            blur = lent.blur_px / self.problem.binning if spread else self.joint.fit.blur
            edge = replace(self.plain, blur=blur, shape=lent.shape)
            plain = self._fit_with(plain, self.start(edge), lent.families)
        rims, count = self.start(plain.learned.edge, plain.joint), len(self.isolated)
        scores, rims = self.scores(replace(rims, disks=evenly(rims.disks, SOME)))
        if len(rims.disks) < FEWEST:
            return self._finish(plain, *self._unseen(plain))
        if not plain.learned.families:
            # others fit any edge with another contrast
            wide = self.joint.fit.disks[self.isolated, RADIUS] > WIDE_RADIUS_BLUR_WIDTHS * self.joint.fit.blur
            if count < FEW or np.count_nonzero(wide) < FEWEST:
                return self._finish(plain, scores, rims)
            options, share = self.options(scores, rims, ()), count / len(rims.disks)
            more = [option.log_odds + 0.5 * (share - 1.0) * option.wald for option in options.values()]
            if max(more) < np.log(TAKEN_ODDS):
                return self._finish(plain, scores, rims, options, of=count)
        scores, rims, families = self._explain(plain)
        current = self._fit_with(plain, rims, families) if families else plain
        misfit, before = (np.median(each.joint.fit.chi_square) for each in (current, plain))
        # Chosen: real edges raised it by up to 0.2 %, one learned from disks of whole pixels by 1.5 %.
        if misfit > 1.004 * before:
            current = plain
            scores, rims = self.scores(self.start(plain.learned.edge, plain.joint))
        return self._finish(current, scores, rims)

    def _explain(self, current: EdgeFit) -> tuple[SharedScores, Rims, tuple[str, ...]]:
        """Settle the rims of a fit, adding families until no other is probable."""
        rims, families = self.start(current.learned.edge, current.joint), current.learned.families
        rims = self.settle(rims, families) if families else rims
        while True:
            scores, rims = self.scores(rims)
            found = {
                name: option.log_odds
                for name, option in self.options(scores, rims, families).items()
                if option.log_odds > np.log(TAKEN_ODDS)
                # rims are soft, and the gap beside a contact shines: neither can be negative
                and (name not in {"softness", "rim"} or option.step.delta[-1] > 0.0)
            }
            for name in sorted(found, key=found.__getitem__, reverse=True):
                more = self.settle(rims, (*families, name))
                if more.settled and len(more.disks) >= FEW:
                    rims, families = more, (*families, name)
                    break
            else:
                return scores, rims, families

    def _unseen(self, current: EdgeFit) -> tuple[SharedScores, Rims]:
        """The scores of contacts that all touch each other, whose edges may not be those assumed.

        Their information is the expected one, their scores are 0; where other frames lend their edge, these
        alone count.
        """
        disks, edge = evenly(current.joint.fit.disks, SOME), current.learned.edge
        rims = replace(self.start(edge, current.joint), disks=disks)
        scores = rim_scores(self.at(rims.contrast), disks, edge, least_factor=self.joint.least_factor)
        share = 0.0 if current.learned.families else 1.0
        return replace(scores, score=0.0 * scores.score, information=share * scores.information), rims

    def _fit_with(self, current: EdgeFit, rims: Rims, families: tuple[str, ...]) -> EdgeFit:
        """Fit the disks with the edge of the rims."""
        joint, edge, chosen = current.joint, rims.edge, parameters_of(families)
        change = (edge.shared - current.learned.edge.shared)[chosen]
        change[0] = np.log(rims.contrast / joint.contrast)
        scores = rim_scores(self.at(joint.contrast), joint.fit.disks, edge, chosen)
        disks = _moved(joint.fit.disks, scores.response[:, :, chosen] @ change)
        exact = self.optics_prior.with_exact_blur(edge.blur)
        for _ in range(ROUNDS):
            problem = replace(self.problem, image=with_plain_edges(self.problem.image, disks, edge))
            joint = self.refine(problem, replace(joint.fit, disks=disks, blur=edge.blur), exact)
            moved = (joint.fit.disks - disks)[:, RADIUS] / joint.fit.std[:, RADIUS]
            disks = joint.fit.disks
            if np.median(np.abs(moved)) < 0.5 * SETTLED_SIGMA:
                break
        return EdgeFit(problem, joint, LearnedEdge(edge, families))

    def _finish(
        self, current: EdgeFit, scores: SharedScores, rims: Rims, options: dict[str, Option] | None = None,
        *, of: int = 0,
    ) -> EdgeFit:  # fmt: skip
        """The fit with the uncertainties that the edge brings to all radii.

        ``scores`` and ``options`` are those of ``rims``, which may be a sample of ``of`` contacts.
        """
        learned, joint = current.learned, current.joint
        step = scores.step(parameters_of(learned.families), self.prior(rims.edge, rims.contrast))
        if learned.families:
            joint = self.with_uncertainties(current, scores, step)
        std = np.zeros(SHARED + len(PRIOR_STD))
        std[step.chosen] = np.sqrt(np.diag(step.covariance))
        undecided = np.zeros(len(joint.fit.disks))
        if len(rims.disks) >= FEWEST:
            options = options or self.options(scores, rims, learned.families)
            undecided = _undecided(joint.fit.disks[:, RADIUS], rims.disks[:, RADIUS], scores, options)
        knowledge = self._knowledge(learned, scores, of)
        learned = replace(learned, std=std[SHARED:], knowledge=knowledge, undecided=undecided)
        return EdgeFit(current.problem, joint, learned)

    def _knowledge(self, learned: LearnedEdge, scores: SharedScores, of: int) -> EdgeKnowledge:
        """The knowledge that the frame alone gives of its edges, whatever contrast and blur."""
        _, _, factor, _ = scores.total(parameters_of(learned.families))
        # a sample stands for all: they are expected to be together as significant as it is
        share = max(of / max(len(scores.score), 1), 1.0)
        score, information = np.sqrt(share) * scores.score.sum(axis=0), share * scores.information.sum(axis=0)
        others = np.array([0] if "point spread" in learned.families else [0, 1])
        cross = information[others, SHARED:] / factor
        inner = information[np.ix_(others, others)] / factor + 1e-9 * np.eye(len(others))
        along = np.linalg.solve(inner, cross)
        own = information[SHARED:, SHARED:] / factor - cross.T @ along
        pull = (score[SHARED:] - along.T @ score[others]) / factor
        blur, shape = learned.edge.blur * self.problem.binning, learned.edge.shape
        count = max(of, int(np.count_nonzero(scores.score.any(axis=1))))
        return EdgeKnowledge(learned.families, blur, shape, own, own @ shape + pull, count)

    def with_uncertainties(self, current: EdgeFit, scores: SharedScores, step: SharedStep) -> JointFit:
        """The fit with the uncertainties that a learned edge brings to all radii."""
        joint, edge, chosen = current.joint, current.learned.edge, step.chosen
        disks, problem, shape = joint.fit.disks, self.at(joint.contrast), edge.shape
        learned = rim_scores(problem, disks, edge, np.union1d(chosen, SHARED + np.flatnonzero(shape[:LIGHT])))
        plain = rim_scores(problem, disks, Edge.plain(edge.blur), chosen[:1])
        response = learned.response[:, 1]
        own = joint.fit.std * np.maximum(learned.own_std / plain.own_std, 1.0)[:, [1]]
        shifts = response[:, chosen] @ np.linalg.cholesky(step.covariance)
        # a family describes an edge only so far
        modes = [*shifts.T[1:], ROUGH_STD * response[:, SHARED:] @ shape]
        if self.given.known_edge is None:
            # neither where in its soft zone the rim of a contact lies can be seen, nor whether the light
            # outside belongs to the contact
            modes.append(np.sqrt(max(shape[SOFTNESS], 0.0)) * disks[:, RADIUS])
            modes.append(shape[RIM] * response[:, SHARED + RIM])
        common, rest = as_common_error(np.column_stack(modes), disks[:, RADIUS])
        own[:, RADIUS] = np.hypot(own[:, RADIUS], rest)
        alone = scores.step(chosen, self.prior(edge, joint.contrast, own=True))
        return replace(
            joint,
            fit=replace(joint.fit, std=own),
            covariance=_of_optics(step, edge),
            own_covariance=_of_optics(alone, edge),
            radius_shifts=np.column_stack([shifts[:, 0], common]),
        )


def _moved(disks: Values, own: Values) -> Values:
    """Disks after a step of contrast and radius, each at most by a factor of two."""
    moved, at = disks.copy(), [CONTRAST, RADIUS]
    moved[:, at] = np.clip(disks[:, at] + own[:, :2], 0.5 * disks[:, at], 2.0 * disks[:, at])
    return moved


def _undecided(radius: Values, seen: Values, scores: SharedScores, options: dict[str, Option]) -> Values:
    """Shift of the radii, px, by the other family of edges that may change the areas most.

    Root mean square over a family that is present with the probability that its odds give: where the
    residuals exclude it that is next to nothing, where they cannot tell it is what the family may be.
    Contacts whose scores are not known move as those of their radius, ``seen``.
    """
    most, shift, order = 0.0, np.zeros(len(radius)), np.argsort(seen)
    for name, (step, log_odds, _) in options.items():
        own = slice(-len(FAMILIES[name]), None)
        uncertain = np.zeros((len(step.chosen), len(FAMILIES[name])))
        uncertain[own] = np.linalg.cholesky(step.covariance[own, own])
        moves = np.sqrt(special.expit(log_odds)) * np.column_stack([step.delta, uncertain])
        moved = np.linalg.norm(scores.response[:, 1, step.chosen] @ moves, axis=1)
        if float(seen @ moved) > most:
            most, shift = float(seen @ moved), np.interp(radius, seen[order], moved[order])
    return shift


def _of_optics(step: SharedStep, edge: Edge) -> Values:
    """Covariance of ln C and blur; the widths of a point spread function stand for the blur."""
    covariance = np.diag([0.0, (ROUGH_STD * edge.blur) ** 2])
    at = step.chosen < SHARED
    covariance[np.ix_(step.chosen[at], step.chosen[at])] = step.covariance[np.ix_(at, at)]
    return covariance
