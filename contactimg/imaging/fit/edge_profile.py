"""The edge that the contacts of a frame share, learned from the frame where its residuals call for it.

A plain edge, a disk behind one Gaussian, is assumed first. If the residuals of all contacts together exclude
it (`contactimg.imaging.fit.edge_scores`), the family of edges that explains them best joins the fit, and so
on until no other family is significant. The difference between learned and plain profile of each contact is
subtracted from the image, which the plain fit then measures: at the solution the residuals of the learned
edge have no part along any derivative. What other frames of a series know of the edge enters as a prior.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.edge_scores import (
    FEW_CONTACTS,
    FEWEST_SCORES,
    FILM,
    PRIOR_STD,
    SHARED,
    SUSPICION,
    Edge,
    EdgeScores,
    Placement,
    SharedStep,
    edge_prior,
    evenly,
    isolated_disks,
    parameters_of,
    with_plain_edges,
)
from contactimg.imaging.fit.problem import RADIUS, WIDE_RADIUS_BLUR_WIDTHS, FitProblem
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior
from contactimg.imaging.profile.edge_shape import DOME, FAMILIES, FIELD, RESPONSE, RIM, SOFTNESS, TREND
from contactimg.imaging.profile.limits import FEW, FEWEST, ROUGH_STD, SETTLED_SIGMA
from contactimg.imaging.profile.optics import EdgeKnowledge, SharedOptics
from contactimg.timings import stage

Values = NDArray[np.float64]
Steps = dict[str, SharedStep]
"""Step of the shared quantities with one family more, by its name."""
Refine = Callable[[FitProblem, FittedDisks, OpticsPrior], JointFit]

ROUNDS = 16  # fits at most; accuracy and time: a frame with a plain edge needs none
INDISTINCT = ({"softness", "response"}, {"softness", "rim"})
"""Families of which only one is assumed: a soft rim that is not symmetric looks like a nonlinear response,
and light outside like a soft rim."""
WORSE_CHI_SQUARE_RATIO = 1.004
"""Chi-square over that with the plain edge above which a learned edge fits worse: the ratio of the
medians of all contacts, the median of their ratios and the ratio of their means. Chosen: real edges raised
one of them by up to 0.6 % by chance."""
USUAL_ODDS, PRIOR_ODDS = 0.1, {"response": 0.5}
"""Odds of each family against the plain edge before the frame is looked at. Chosen: one frame in ten has it;
of cameras that nobody calls linear one in three has a gamma or a tone curve."""
POSITIVE = {"softness", "rim"}
"""Families whose parameter cannot be negative: rims are soft, and the gap beside a contact shines."""
RELEVANT_SUM_SIGMA = 1.0
"""The same for the sum of the areas."""


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
        trend = float(edge.shape[TREND])
        parts.append(
            f"small contacts {abs(trend):.2g} {'brighter' if trend > 0 else 'dimmer'} than large ones"
        )
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


@stage("edge")
def learn_edge(
    problem: FitProblem,
    joint: JointFit,
    optics_prior: OpticsPrior,
    *,
    ratio: float,
    refine: Refine,
    given: SharedOptics,
    linear: bool = False,
) -> EdgeFit:
    """Learn the edge of a frame's contacts, and fit them with it.

    Parameters
    ----------
    problem : FitProblem
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

    Returns
    -------
    EdgeFit
        With a plain edge where nothing else is significant, where fewer than `FEW` are isolated,
        or too few of them wide; uncertainties include what is undecided. Unchanged where the pixels are too
        coarse for the rims.
    """
    lent, known = given.edge, given.known_edge is not None
    search = _Search(problem, optics_prior, Placement(problem.image.shape, ratio), lent, known, linear)
    plain = current = EdgeFit(problem, joint, LearnedEdge(Edge.plain(joint.fit.blur)))
    if problem.noise.rim > 0:
        return plain
    isolated = search.isolated(joint)
    if lent is not None and lent.families:
        plain = current = search.begin_with(joint, lent, refine)
    if len(isolated) < FEWEST_SCORES:
        return search.finish(current, search.unseen(current))
    scores = search.scores(current, evenly(isolated, FEW_CONTACTS))
    if len(scores.score) < FEWEST_SCORES:
        return search.finish(current, search.unseen(current))
    if not current.learned.families:
        # others fit any edge with another contrast
        wide = joint.fit.disks[isolated, RADIUS] > WIDE_RADIUS_BLUR_WIDTHS * joint.fit.blur
        if len(isolated) < FEW or np.count_nonzero(wide) < FEWEST:
            return search.finish(current, scores)
        others = search.others(current, scores)
        if not any(step.excess(FAMILIES[name], SUSPICION) > 1.0 for name, step in others.items()):
            return search.finish(current, scores, others, of=len(isolated))
    current, scores = search.learn(current, isolated, refine)
    if _fits_worse(current.joint.fit.chi_square, plain.joint.fit.chi_square):
        current, scores = plain, search.scores(plain, isolated)  # it does not fit better
    return search.finish(current, scores)


@dataclass(frozen=True, eq=False)
class _Search:
    """A frame in which an edge is searched.

    Parameters
    ----------
    problem : FitProblem
        With the original image.
    optics_prior : OpticsPrior
    placement : Placement
    lent : EdgeKnowledge or None
        What other frames say of the edge.
    known : bool
        Whether it is known where in its edge a contact ends.
    linear : bool
        Whether the camera is known to be linear.
    """

    problem: FitProblem
    optics_prior: OpticsPrior
    placement: Placement
    lent: EdgeKnowledge | None
    known: bool = False
    linear: bool = False

    def excluded(self, name: str, families: tuple[str, ...]) -> bool:
        """Whether a family is not looked for beside others."""
        if name in families or (self.linear and name == "response"):
            return True
        return any({name, *families} >= pair for pair in INDISTINCT)

    def isolated(self, joint: JointFit) -> NDArray[np.int64]:
        """Contacts with the contrast of the frame whose profile nothing disturbs."""
        disks = joint.fit.disks
        isolated = isolated_disks(self.problem, disks, blur=joint.fit.blur)
        return isolated[joint.prior.is_odd(disks)[isolated] < 0]

    def scores(self, current: EdgeFit, chosen: NDArray[np.int64]) -> EdgeScores:
        """The scores of some contacts, as far as no hole disturbs them."""
        joint, edge = current.joint, current.learned.edge
        problem = replace(self.problem, prior=joint.prior)
        scores = EdgeScores.of(problem, joint.fit.disks[chosen], edge, self.placement)
        return self._with_noise(scores, joint, chosen)

    def unseen(self, current: EdgeFit) -> EdgeScores:
        """The scores of contacts that all touch each other, whose edges may not be those assumed.

        Their information is the expected one, their scores are 0; where other frames lend their edge, these
        alone count.
        """
        joint, edge = current.joint, current.learned.edge
        chosen = evenly(np.arange(len(joint.fit.disks)), FEW_CONTACTS)
        problem = replace(self.problem, prior=joint.prior)
        scores = EdgeScores.expected(problem, joint.fit.disks[chosen], edge, self.placement)
        share = 0.0 if current.learned.families else 1.0
        scores = replace(scores, score=0.0 * scores.score, information=share * scores.information)
        return self._with_noise(scores, joint, chosen)

    def learn(
        self, current: EdgeFit, isolated: NDArray[np.int64], refine: Refine
    ) -> tuple[EdgeFit, EdgeScores]:
        """Add families and settle the edge, until no other family is significant."""
        for _ in range(ROUNDS):
            scores = self.scores(current, isolated)
            edge, families, prior = current.learned.edge, current.learned.families, self.prior(current)
            step = scores.step(parameters_of(families), prior)
            # blur and shape need no other fit; a parameter at its limit does not move any more
            change = (edge.moved(step.chosen, step.delta).shared - edge.shared)[step.chosen]
            rest = change[1:] @ np.linalg.solve(step.covariance[1:, 1:], change[1:])
            if not families or rest < SETTLED_SIGMA**2 * len(change):
                found = self.next_family(current, scores)
                if not found or len(scores.score) < FEW:
                    break
                families = (*families, found)
                step = scores.step(parameters_of(families), prior)
            moved = LearnedEdge(edge.moved(step.chosen, step.delta), families)
            current = self._fit_with(current.joint, moved, step, refine)
        return current, scores

    def _with_noise(self, scores: EdgeScores, joint: JointFit, chosen: NDArray[np.int64]) -> EdgeScores:
        """The scores with the variances of the fit, which include noise that neighbouring pixels share."""
        if len(scores.radius_std) != len(chosen) or not len(chosen):
            return scores
        ratio = joint.fit.std[chosen, RADIUS] / scores.radius_std
        return replace(scores, least_factor=max(float(np.median(ratio**2)), 1.0))

    def prior(self, current: EdgeFit, *, own: bool = False) -> tuple[Values, Values]:
        """Prior of the shared quantities, score and information; ``own``: without what other frames tell."""
        edge, optics, contrast = current.learned.edge, self.optics_prior, current.joint.contrast
        if own:
            here = np.array([np.log(contrast), edge.blur])
            optics = OpticsPrior(here, 1e-6 * np.diag([1.0, edge.blur**-2]))
        score, information = edge_prior(edge, optics, contrast)
        if self.lent is not None and not own:
            score[SHARED:FILM] += self.lent.score_at(edge.shape)
            information[SHARED:FILM, SHARED:FILM] += self.lent.information
        return score, information

    def others(self, current: EdgeFit, scores: EdgeScores) -> Steps:
        """The steps of the shared quantities with one family more, for each that may be there."""
        families, prior = current.learned.families, self.prior(current)
        names = [name for name in FAMILIES if not self.excluded(name, families)]
        return {name: scores.step(parameters_of((*families, name)), prior) for name in names}

    def next_family(self, current: EdgeFit, scores: EdgeScores) -> str:
        """The family that explains most of the residuals, if it is significant and matters."""
        best, most = "", 0.0
        for name, step in self.others(current, scores).items():
            if name in POSITIVE and step.delta[-1] <= 0.0:
                continue
            if step.gain > most and step.excess(FAMILIES[name]) > 1.0 and _matters(scores, step):
                best, most = name, step.gain
        return best

    def begin_with(self, joint: JointFit, lent: EdgeKnowledge, refine: Refine) -> EdgeFit:
        """The frame with the edge of other frames."""
        shape, chosen = lent.shape, parameters_of(lent.families)
        blur = lent.blur_px / self.problem.binning if "point spread" in lent.families else joint.fit.blur
        change = np.concatenate([[0.0, 0.0], shape])[chosen]
        step = SharedStep(chosen, change, np.zeros((len(chosen),) * 2), 0.0)
        return self._fit_with(joint, LearnedEdge(Edge(blur, shape), lent.families), step, refine)

    def _fit_with(self, joint: JointFit, learned: LearnedEdge, step: SharedStep, refine: Refine) -> EdgeFit:
        """Fit the disks with another edge, to which a step has led."""
        disks, edge = joint.fit.disks.copy(), learned.edge
        chosen, radius = step.chosen, disks[:, RADIUS]
        problem = replace(self.problem, prior=joint.prior)
        response = EdgeScores.expected(problem, disks, edge, self.placement, chosen).response[:, chosen]
        disks[:, RADIUS] = np.clip(radius + response @ step.delta, 0.5 * radius, 2.0 * radius)
        image = with_plain_edges(self.problem.image, disks, edge, self.placement)
        problem = replace(self.problem, image=image)
        fit = replace(joint.fit, disks=disks, blur=edge.blur)
        prior = self.optics_prior.with_exact_blur(edge.blur)
        return EdgeFit(problem, refine(problem, fit, prior), learned)

    def finish(
        self, current: EdgeFit, scores: EdgeScores, others: Steps | None = None, *, of: int = 0
    ) -> EdgeFit:
        """The fit with the uncertainties that the edge brings to all radii.

        ``scores`` may be those of a sample of ``of`` contacts; ``others`` are the steps with one family more.
        """
        families, joint = current.learned.families, current.joint
        step = scores.step(parameters_of(families), self.prior(current))
        if families:
            joint = self._learned(current, scores, step)
        share = max(of / max(len(scores.score), 1), 1.0)
        score, information = scores.total(step.chosen)
        # the others are expected to look the same: as significant together as the sample is
        score, information = np.sqrt(share) * score, share * information
        seen = int(np.count_nonzero(scores.score.any(axis=1)))
        knowledge = self._knowledge(current, score, information, max(of, seen))
        std = np.zeros(SHARED + len(current.learned.edge.shape))
        std[step.chosen] = np.sqrt(np.diag(step.covariance))
        undecided = np.zeros(len(joint.fit.disks))
        if len(scores.score) >= FEWEST_SCORES:
            others = self.others(current, scores) if others is None else others
            undecided = _undecided(joint.fit.disks[:, RADIUS], scores, step.gain, others)
        learned = replace(current.learned, std=std[SHARED:], knowledge=knowledge, undecided=undecided)
        return EdgeFit(current.problem, joint, learned)

    def _knowledge(self, current: EdgeFit, score: Values, information: Values, count: int) -> EdgeKnowledge:
        """The knowledge that the frame alone gives of its edges, whatever contrast and blur."""
        learned = current.learned
        others = np.array([0] if "point spread" in learned.families else [0, 1])
        cross = information[np.ix_(others, np.arange(SHARED, FILM))]
        along = np.linalg.solve(information[np.ix_(others, others)] + 1e-9 * np.eye(len(others)), cross)
        own = information[SHARED:FILM, SHARED:FILM] - cross.T @ along
        pull = score[SHARED:FILM] - along.T @ score[others]
        blur, shape = learned.edge.blur * self.problem.binning, learned.edge.shape
        return EdgeKnowledge(learned.families, blur, shape, own, own @ shape + pull, count)

    def _learned(self, current: EdgeFit, scores: EdgeScores, step: SharedStep) -> JointFit:
        """The fit with the uncertainties that a learned edge brings to all radii."""
        joint, edge, chosen = current.joint, current.learned.edge, step.chosen
        disks, problem = joint.fit.disks, replace(self.problem, prior=joint.prior)
        learned, plain = (
            EdgeScores.expected(problem, disks, each, self.placement, at)
            for each, at in ((edge, chosen), (Edge.plain(edge.blur), chosen[:1]))
        )
        response = learned.response
        own = joint.fit.std * np.maximum(learned.radius_std / plain.radius_std, 1.0)[:, None]
        shifts = response[:, chosen] @ np.linalg.cholesky(step.covariance)
        # a family describes an edge only so far
        modes = [*shifts.T[1:], ROUGH_STD * response[:, SHARED:FILM] @ edge.shape]
        if edge.shape[SOFTNESS] > 0 and not self.known:
            # where in its soft zone the rim of a contact lies cannot be seen
            modes.append(np.sqrt(edge.shape[SOFTNESS]) * disks[:, RADIUS])
        if edge.shape[RIM] and not self.known:
            # whether the light outside belongs to the contact cannot be seen
            modes.append(edge.shape[RIM] * response[:, SHARED + RIM])
        # what is common to all radii, as one error with the same effect on the sum of areas, and what is left
        every = np.column_stack(modes)
        along = every.T @ disks[:, RADIUS]
        along /= max(float(np.linalg.norm(along)), 1e-30)
        common = every @ along
        rest = np.sqrt(np.maximum(np.sum(every**2, axis=1) - common**2, 0.0))
        own[:, RADIUS] = np.hypot(own[:, RADIUS], rest)
        own_step = scores.step(chosen, self.prior(current, own=True))
        return replace(
            joint,
            fit=replace(joint.fit, std=own),
            covariance=_of_optics(step, edge),
            own_covariance=_of_optics(own_step, edge),
            radius_shifts=np.column_stack([shifts[:, 0], common]),
        )


def _undecided(radius: Values, scores: EdgeScores, without: float, others: Steps) -> Values:
    """Shift of the radii by the other family of edges that may change the areas most, px.

    Root mean square over a family that is present with the probability that its prior and the residuals of
    all contacts give it (Laplace's approximation): where they exclude it that is next to nothing, where they
    cannot tell it is what the family may be. ``without`` is the gain of the step without another family.
    Contacts whose scores are not known move as those of their radius.
    """
    most, shift, order = 0.0, np.zeros(len(radius)), np.argsort(scores.radius)
    for name, step in others.items():
        own = np.flatnonzero(np.isin(step.chosen - SHARED, FAMILIES[name]))
        known = np.linalg.slogdet(step.covariance[np.ix_(own, own)])[1]
        known -= 2.0 * float(np.sum(np.log(PRIOR_STD[list(FAMILIES[name])])))
        odds = PRIOR_ODDS.get(name, USUAL_ODDS) * np.exp(min(0.5 * (step.gain - without + known), 50.0))
        uncertain = np.zeros((len(step.chosen), len(own)))
        uncertain[own] = np.linalg.cholesky(step.covariance[np.ix_(own, own)])
        moves = np.sqrt(odds / (1.0 + odds)) * np.column_stack([step.delta, uncertain])
        moved = np.linalg.norm(scores.response[:, step.chosen] @ moves, axis=1)
        if float(scores.radius @ moved) > most:
            most = float(scores.radius @ moved)
            shift = np.interp(radius, scores.radius[order], moved[order])
    return shift


def _fits_worse(after: Values, before: Values) -> bool:
    """Whether the contacts have larger mean squared residuals than before; NaN for those not looked at."""
    known = np.isfinite(after) & np.isfinite(before)
    after, before = after[known], np.maximum(before[known], 1e-9)
    if not len(after):
        return False
    ratios = np.median(after) / np.median(before), np.median(after / before), np.mean(after) / np.mean(before)
    return float(min(ratios)) > WORSE_CHI_SQUARE_RATIO


def _of_optics(step: SharedStep, edge: Edge) -> Values:
    """Covariance of ln C and blur; the widths of a point spread function stand for the blur."""
    covariance = np.diag([0.0, (ROUGH_STD * edge.blur) ** 2])
    at = step.chosen < SHARED
    covariance[np.ix_(step.chosen[at], step.chosen[at])] = step.covariance[np.ix_(at, at)]
    return covariance


def _matters(scores: EdgeScores, step: SharedStep) -> bool:
    """Whether a step of the edge moves the radii, or the sum of the areas."""
    weights = scores.response[:, step.chosen]
    shift = weights @ step.delta
    single = np.sqrt(np.mean((shift / scores.radius_std) ** 2))
    # of a contact a weight proportional to a^(1/2) or more: the sum is about as well known as this
    whole = abs(np.sum(shift)) / np.sqrt(np.sum(scores.radius_std**2))
    return bool(single > SETTLED_SIGMA or whole > RELEVANT_SUM_SIGMA)
