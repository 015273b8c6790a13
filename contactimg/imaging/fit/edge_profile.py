"""The edge that the contacts of a frame share, learned from the frame where its residuals call for it.

A plain edge, a disk behind one Gaussian, is assumed first. If the residuals of all contacts together exclude
it (`contactimg.imaging.fit.edge_scores`), the family of edges that explains them best joins the fit, and so
on until no other family is significant. The difference between learned and plain profile of each contact is
subtracted from the image, which the plain fit then measures: at the solution the residuals of the learned
edge have no part along any derivative.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.edge_scores import (
    FEW_CONTACTS,
    FEWEST_CONTACTS,
    FINE_STEPS_PER_BLUR,
    SHARED,
    Edge,
    EdgeScores,
    Placement,
    SharedStep,
    edge_prior,
    evenly,
    isolated_disks,
    parameters_of,
)
from contactimg.imaging.fit.problem import RADIUS, FitProblem, touches
from contactimg.imaging.fit.settings import FEWEST_WIDE_DISKS, WIDE_RADIUS_BLUR_WIDTHS
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior
from contactimg.imaging.kernels.radial_sums import add_profiles
from contactimg.imaging.profile.edge_shape import (
    DOME,
    FAMILIES,
    FIELD,
    LARGEST,
    RESPONSE,
    SOFTNESS,
    TREND,
    BlurredDisks,
    edge_profile,
)
from contactimg.timings import stage

Values = NDArray[np.float64]
Refine = Callable[[FitProblem, FittedDisks, OpticsPrior], JointFit]

ROUNDS = 16  # fits at most; accuracy and time: a frame with a plain edge needs none
SETTLED_SIGMA = 0.2
"""Step of the shared quantities, in their uncertainties, at which they have settled. Accuracy."""
LONGEST_SHAPE_STEP = 0.5  # of the largest magnitude of a parameter; accuracy
LONGEST_BLUR_STEP = 0.25  # relative; accuracy
UNDEFINED_BLUR_FRACTION = 0.1
"""Relative uncertainty stated for the blur of a point spread function that is no Gaussian. Chosen: it says
that no number describes it; the radii do not depend on it."""
RELEVANT_SIGMA = 0.2
"""Shift of the radii, in their uncertainties, below which a significant edge changes nothing. Chosen: it
lowers a coverage of 68 % by one per cent."""
SHARPEST_BLUR_PX = 0.75
"""Blur, pixel included, below which a misfit at the rims is that of coarse pixels (`coarse_rims`), not of the
edge. Chosen: the edge then rises within 1.5 px."""
INDISTINCT = {"softness", "response"}
"""Families of which only one is assumed: a soft rim that is not symmetric looks like a nonlinear response."""
RELEVANT_SUM_SIGMA = 1.0
"""The same for the sum of the areas."""


@dataclass(frozen=True, eq=False)
class LearnedEdge:
    """What the frame says of its edges.

    Parameters
    ----------
    edge : Edge
    families : tuple of str
        That take part, keys of `contactimg.imaging.profile.edge_shape.FAMILIES`; empty for a plain edge.
    std : ndarray
        Standard uncertainties of the parameters of the edge; 0 for those that take no part.
    """

    edge: Edge
    families: tuple[str, ...] = ()
    std: Values = field(default_factory=lambda: np.zeros(0))

    @property
    def gamma(self) -> tuple[float, float]:
        """Exponent of the camera's response and its uncertainty; (1, 0) for a linear one."""
        if "response" not in self.families:
            return 1.0, 0.0
        return 1.0 - float(self.edge.shape[RESPONSE]), float(self.std[RESPONSE])


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """A frame's problem with the difference to the plain edge subtracted, its fit, and the edge."""

    problem: FitProblem
    joint: JointFit
    learned: LearnedEdge


@stage("edge")
def learn_edge(
    problem: FitProblem, joint: JointFit, optics_prior: OpticsPrior, *, ratio: float, refine: Refine
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

    Returns
    -------
    EdgeFit
        The arguments unchanged where nothing is significant, where fewer than `FEWEST_CONTACTS` are isolated,
        where too few of them are wide, or where the pixels are too coarse for the rims.
    """
    edge = Edge.plain(joint.fit.blur)
    families: tuple[str, ...] = ()
    current = EdgeFit(problem, joint, LearnedEdge(edge))
    disks = joint.fit.disks
    isolated = isolated_disks(disks, problem.image.shape, blur=edge.blur)
    # a plateau that is cut off by the sensor looks like another edge
    isolated = isolated[~touches(problem.saturated, 1, disks, disks[:, RADIUS])[isolated]]
    if len(isolated) < FEWEST_CONTACTS or (problem.noise.rim > 0 and edge.blur < SHARPEST_BLUR_PX):
        return current
    wide = disks[isolated, RADIUS] > WIDE_RADIUS_BLUR_WIDTHS * edge.blur
    if np.count_nonzero(wide) < FEWEST_WIDE_DISKS:
        return current  # where no contact shows its contrast, any edge fits with another one
    search = _Search(problem, optics_prior, Placement(problem.image.shape, ratio))
    first = search.scores(joint, edge, evenly(isolated, FEW_CONTACTS))
    if len(first.score) < FEWEST_CONTACTS or not first.is_suspicious(search.prior(joint, edge)):
        return current
    for _ in range(ROUNDS):
        if problem.work.is_done:
            break
        scores = search.scores(current.joint, edge, isolated)
        if len(scores.score) < FEWEST_CONTACTS:
            return current
        prior = search.prior(current.joint, edge)
        step = scores.step(parameters_of(families), prior)
        moved = _moved(edge, step)
        if not families or _has_settled(edge, moved, step):
            found = search.next_family(scores, families, prior)
            if not found:
                break
            families = (*families, found)
            step = scores.step(parameters_of(families), prior)
            moved = _moved(edge, step)
        edge = moved
        current = search.refit(current.joint, edge, step, refine)
    if not families or np.median(current.joint.fit.chi_square) > np.median(joint.fit.chi_square):
        return EdgeFit(problem, joint, LearnedEdge(Edge.plain(joint.fit.blur)))  # it does not fit better
    return search.finish(current, edge, families, step)


@dataclass(frozen=True, eq=False)
class _Search:
    """A frame in which an edge is searched.

    Parameters
    ----------
    problem : FitProblem
        With the original image.
    optics_prior : OpticsPrior
    placement : Placement
    """

    problem: FitProblem
    optics_prior: OpticsPrior
    placement: Placement

    def _with_prior(self, joint: JointFit) -> FitProblem:
        """With the contrast and spread of a fit."""
        return replace(self.problem, prior=replace(self.problem.prior, mean=joint.contrast, std=joint.spread))

    def scores(self, joint: JointFit, edge: Edge, chosen: NDArray[np.int64]) -> EdgeScores:
        """Of some contacts, as far as no hole disturbs them."""
        disks = joint.fit.disks[chosen]
        return EdgeScores.of(self._with_prior(joint), disks, edge, self.placement)

    def prior(self, joint: JointFit, edge: Edge) -> tuple[Values, Values]:
        """Of the shared quantities: score and information."""
        prior = self.optics_prior
        score = prior.information @ (prior.mean - np.array([np.log(joint.contrast), edge.blur]))
        return edge_prior(edge, (score, prior.information))

    def next_family(self, scores: EdgeScores, families: tuple[str, ...], prior: tuple[Values, Values]) -> str:
        """The family that explains most of the residuals, if it is significant and matters."""
        best, most = "", 0.0
        for name, columns in FAMILIES.items():
            if name in families or {name, *families} >= INDISTINCT:
                continue
            step = scores.step(parameters_of((*families, name)), prior)
            if step.gain > most and step.excess(columns) > 1.0 and _matters(scores, step):
                best, most = name, step.gain
        return best

    def refit(self, joint: JointFit, edge: Edge, step: SharedStep, refine: Refine) -> EdgeFit:
        """Fit the disks with another edge."""
        disks = joint.fit.disks.copy()
        expected = EdgeScores.expected(self._with_prior(joint), disks, edge, self.placement)
        radius = disks[:, RADIUS]
        disks[:, RADIUS] = np.clip(
            radius + expected.response[:, step.chosen] @ step.delta, 0.5 * radius, 2.0 * radius
        )
        problem = self._corrected(disks, edge)
        fit = replace(joint.fit, disks=disks, blur=edge.blur)
        prior = self.optics_prior.with_exact_blur(edge.blur)
        return EdgeFit(problem, refine(problem, fit, prior), LearnedEdge(edge))

    def _corrected(self, disks: Values, edge: Edge) -> FitProblem:
        """The image of the same disks with a plain edge."""
        nodes = self.placement.place(disks, blur=edge.blur, per_blur=FINE_STEPS_PER_BLUR)
        plain = BlurredDisks.of(nodes.disks, edge.blur).p
        difference = plain - edge_profile(nodes.disks, edge.blur, edge.shape)
        image = self.problem.image.copy()
        add_profiles(image, disks, nodes.inner, difference, nodes.step)
        return replace(self.problem, image=image)

    def finish(self, current: EdgeFit, edge: Edge, families: tuple[str, ...], step: SharedStep) -> EdgeFit:
        """With the uncertainties that the learned edge brings to all radii."""
        joint, problem = current.joint, self._with_prior(current.joint)
        disks, chosen = joint.fit.disks, step.chosen
        learned = EdgeScores.expected(problem, disks, edge, self.placement)
        plain = EdgeScores.expected(problem, disks, Edge.plain(edge.blur), self.placement)
        own = joint.fit.std * np.maximum(learned.radius_std / plain.radius_std, 1.0)[:, None]
        modes = learned.response[:, chosen] @ np.linalg.cholesky(step.covariance)
        if edge.shape[SOFTNESS] > 0:
            # where in its soft zone the rim of a contact lies cannot be seen
            modes = np.column_stack([modes, np.sqrt(edge.shape[SOFTNESS]) * disks[:, RADIUS]])
        shifts, rest = _two_modes(modes, disks[:, RADIUS])
        own[:, RADIUS] = np.hypot(own[:, RADIUS], rest)
        everything = np.zeros((SHARED + len(edge.shape),) * 2)
        everything[np.ix_(chosen, chosen)] = step.covariance
        covariance = everything[:SHARED, :SHARED]
        if not covariance[1, 1]:  # the widths of the point spread function stand for the blur
            covariance[1, 1] = (UNDEFINED_BLUR_FRACTION * edge.blur) ** 2
        joint = replace(
            joint, fit=replace(joint.fit, std=own), covariance=covariance, own_covariance=covariance,
            radius_shifts=shifts,
        )  # fmt: skip
        std = np.sqrt(np.diag(everything)[SHARED:])
        return EdgeFit(current.problem, joint, LearnedEdge(edge, families, std))


def _two_modes(modes: Values, radius: Values) -> tuple[Values, Values]:
    """Errors common to all radii as two columns with the same effect on the sum of areas, and what is left.

    The first mode is kept; of the others the combination that changes the sum of areas.
    """
    others = modes[:, 1:]
    along = others.T @ radius
    along /= max(float(np.linalg.norm(along)), 1e-30)
    common = others @ along
    rest = np.sqrt(np.maximum(np.sum(others**2, axis=1) - common**2, 0.0))
    return np.column_stack([modes[:, 0], common]), rest


def _matters(scores: EdgeScores, step: SharedStep) -> bool:
    """Whether a step of the edge moves the radii, or the sum of the areas."""
    weights = scores.response[:, step.chosen]
    shift = weights @ step.delta
    single = np.sqrt(np.mean((shift / scores.radius_std) ** 2))
    # of a contact a weight proportional to a^(1/2) or more: the sum is about as well known as this
    whole = abs(np.sum(shift)) / np.sqrt(np.sum(scores.radius_std**2))
    return bool(single > RELEVANT_SIGMA or whole > RELEVANT_SUM_SIGMA)


def _has_settled(edge: Edge, moved: Edge, step: SharedStep) -> bool:
    """Whether blur and shape need no other fit; a parameter at its limit does not move any more."""
    change = np.concatenate([[0.0, moved.blur - edge.blur], moved.shape - edge.shape])[step.chosen]
    rest = change[1:] @ np.linalg.solve(step.covariance[1:, 1:], change[1:])
    return bool(rest < SETTLED_SIGMA**2 * len(change))


def _moved(edge: Edge, step: SharedStep) -> Edge:
    """The edge after a step, within limits."""
    delta = np.zeros(SHARED + len(edge.shape))
    delta[step.chosen] = step.delta
    longest = LONGEST_BLUR_STEP * edge.blur
    change = np.clip(delta[SHARED:], -LONGEST_SHAPE_STEP * LARGEST, LONGEST_SHAPE_STEP * LARGEST)
    shape = np.clip(edge.shape + change, -LARGEST, LARGEST)
    return Edge(edge.blur + float(np.clip(delta[1], -longest, longest)), shape)


def describe_edge(learned: LearnedEdge, *, binning: int) -> str:
    """What to say of an edge that is not plain; empty for a plain one."""
    edge, parts = learned.edge, []
    if "point spread" in learned.families:
        parts.append("a point spread function that is not a Gaussian")
    if "softness" in learned.families:
        width = np.sqrt(max(float(edge.shape[SOFTNESS]), 0.0))
        parts.append(
            f"a width that grows with the contact ({width:.2g} of the radius): a soft rim cannot be told "
            "from a larger contact"
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
            f"the camera's response looks nonlinear: gamma about {gamma:.2f} +- {std:.2f}; "
            "set [camera] gamma, or switch it off in the camera"
        )
    return "" if not parts else "the edges show " + "; ".join(parts)
