"""The edge that contacts share, learned where many of them are ellipses.

To disks that are fitted to ellipses every rim looks soft and uneven: what else the edges show is lost in
that, or taken for something else. Here ellipses with contrast and blur settled on them
(`contactimg.imaging.judge.ellipse_optics`) take the place of the disks in the search of
`contactimg.imaging.fit.edge_profile`. The edge of an ellipse is that of the circle of equal area, as far off
its rim (`contactimg.imaging.kernels.ellipse_equations.rim_distance`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.edge_profile import EdgeFit, learn_edge
from contactimg.imaging.fit.edge_scores import MOST_CONTACTS, Edge, EdgeScores, Placement, evenly
from contactimg.imaging.fit.ellipse import CommonOptics, FittedEllipse, Window, fit_ellipse
from contactimg.imaging.fit.problem import RADIUS, ContrastPrior, FitProblem
from contactimg.imaging.fit.quality import FrameFit
from contactimg.imaging.fit.settings import POOR_CHI_SQUARE
from contactimg.imaging.fit.shared_optics import JointFit, OpticsPrior
from contactimg.imaging.fit.work import Work
from contactimg.imaging.judge.climbed_contact import ClimbedContact
from contactimg.imaging.judge.ellipse_optics import (
    LEAST_INFORMATION,
    OpticsChange,
    prior_information,
    settle_on_ellipses,
)
from contactimg.imaging.judge.shape_scene import ShapeScene
from contactimg.imaging.profile.optics import SharedOptics

Values = NDArray[np.float64]

AS_DISK, AS_ELLIPSE = [0, 1, 2, 5, 3, 4], [0, 1, 2, 4, 5, 3]
"""Parameters of an ellipse in the order of a disk, the ellipticity last; and back."""
MOST_WITNESSES = 60  # ellipses that contrast and blur are settled on; for time
WORK_PER_PIXEL = 4.0
"""Pixels of windows that are fitted, over those of the image, at which no edge is learned. Chosen: 300
contacts with a gamma take 2.5; 0.2 us each."""
MOST_LEARNERS = MOST_CONTACTS
HOPELESS_SHARE = 0.75
"""Part of the median misfit beyond `POOR_CHI_SQUARE` that an edge may leave for more to be tried. Chosen: an
annular aperture leaves none, coma 0.95."""


@dataclass(frozen=True, eq=False)
class EllipseEdge:
    """Contacts with the edge that disks and ellipses share.

    Parameters
    ----------
    fit : EdgeFit
        Its disks have the components of their ellipticity as well.
    rows : ndarray of int
        Row of each among the disks of the frame.
    ellipses : list of FittedEllipse
        Of each contact that was given, behind this edge.
    added : ndarray of float32 or None
        What makes the edges of the image plain; None where they are.
    """

    fit: EdgeFit
    rows: NDArray[np.intp]
    ellipses: list[FittedEllipse]
    added: NDArray[np.float32] | None

    @property
    def radius_px(self) -> NDArray[np.float64]:
        """Of each contact, pixels of the fit."""
        return self.fit.joint.fit.disks[:, RADIUS]

    @property
    def own_std(self) -> NDArray[np.float64]:
        """Uncertainty of each radius that no other shares."""
        return self.fit.joint.fit.std[:, RADIUS]

    @property
    def shifts(self) -> NDArray[np.float64]:
        """Changes of all radii by contrast, blur and edge, one standard uncertainty of each."""
        undecided = self.fit.learned.undecided
        undecided = undecided if len(undecided) else np.zeros(len(self.rows))
        return np.column_stack([self.fit.joint.radius_shifts, undecided])


def learn_edge_of_ellipses(
    scene: ShapeScene,
    frame_fit: FrameFit,
    change: OpticsChange,
    contacts: Sequence[ClimbedContact],
    others: NDArray[np.intp],
) -> EllipseEdge | None:
    """Learn the edge of a frame many of whose contacts are ellipses.

    Parameters
    ----------
    scene : ShapeScene
        With the contrast and blur that ellipses say.
    frame_fit : FrameFit
        Of the disks, with a plain edge.
    change : OpticsChange
    contacts : sequence of ClimbedContact
        That climbed, fitted behind these optics.
    others : ndarray of int
        Disks that fit and that touch no other.

    Returns
    -------
    EllipseEdge or None
        None where disks show no edge either: a frame with a film, or by hand.
    """
    edge, joint = frame_fit.edge, frame_fit.joint
    if joint is None or edge is None or edge.families:
        return None
    joint = _without_rim_noise(joint, frame_fit, scene)
    crowd = _Crowd(scene, joint, change, contacts, others)
    prior = OpticsPrior(np.array([np.log(joint.contrast), joint.fit.blur]), crowd.known)
    first = crowd.joint_fit(scene.optics, crowd.first_disks(change), range(crowd.climbed))
    problem = replace(scene.problem, image=scene.image, work=Work(WORK_PER_PIXEL * scene.image.size))
    search = partial(
        learn_edge, problem, first, prior, ratio=frame_fit.ratio, refine=crowd.refine,
        given=SharedOptics(edge=frame_fit.lent_edge, known_edge=frame_fit.known_edge), among=crowd.learners,
    )  # fmt: skip
    found = search()
    if found.learned.families and not problem.work.is_done:
        found = crowd.settled(found)
        fits = [crowd.fits[k] for k in range(len(contacts))]
        if np.nanmedian([part.chi_square[0] for part in fits]) < POOR_CHI_SQUARE:
            return EllipseEdge(found, crowd.rows, fits, found.problem.image - scene.image)
    if found.learned.families:  # an edge that leaves such misfits, or that does not settle, is not theirs
        found = search(new_families=False)
    return EllipseEdge(found, crowd.rows, [part.ellipse for part in contacts], None)


def _without_rim_noise(joint: JointFit, frame_fit: FrameFit, scene: ShapeScene) -> JointFit:
    """The fit with the uncertainties of disks whose rims are as noisy as those of ellipses.

    What disks leave at the rims of ellipses was taken for noise of all rims.
    """
    if not frame_fit.problem.noise.rim > 0:
        return joint
    placement = Placement(scene.image.shape, frame_fit.ratio)
    edge, prior = Edge.plain(joint.fit.blur), ContrastPrior(joint.contrast, joint.spread)
    noisy, clean = (
        EdgeScores.expected(replace(problem, prior=prior), joint.fit.disks, edge, placement).radius_std
        for problem in (frame_fit.problem, scene.problem)
    )
    std = joint.fit.std * np.minimum(clean / noisy, 1.0)[:, None]
    return replace(joint, fit=replace(joint.fit, std=std))


class _Crowd:
    """All contacts of a frame: those that climbed first, then disks that may have a window, then the rest.

    Attributes
    ----------
    scene : ShapeScene
    before : JointFit
        Of the disks.
    known : ndarray, shape (2, 2)
        Information of what was known of contrast and blur before.
    misfit : float
        Least mean squared residual over its variance that is believed.
    rows : ndarray of int
        Row of each contact among the disks of the frame.
    learners : ndarray of int
        Contacts that the edge is learned from.
    inflation : ndarray
        Factor of the variances of each for noise that pixels share.
    views : dict
        Contact -> window.
    fits : dict
        Contact -> ellipse in its window, of late.
    contrast : float
        Common contrast, of late.
    climbed, alone : int
        Number of those that climbed, and of these and those that may have a window.
    plain_misfit : float
        Median of the mean squared residuals of those that climbed, with a plain edge.
    """

    def __init__(
        self,
        scene: ShapeScene,
        before: JointFit,
        change: OpticsChange,
        contacts: Sequence[ClimbedContact],
        others: NDArray[np.intp],
    ):
        self.scene, self.before, self.misfit = scene, before, min(change.misfit, 1.0)
        self.known, self.contrast = prior_information(before, scene.optics), scene.optics.contrast
        self.views = {k: part.view for k, part in enumerate(contacts)}
        self.fits = {k: part.ellipse for k, part in enumerate(contacts)}
        free = np.ones(len(scene.disks), np.bool_)
        main = [int(part.members[np.argmax(scene.disks[part.members, RADIUS])]) for part in contacts]
        for part in contacts:
            free[part.members] = False
        alone = [int(row) for row in others if free[row]]
        free[alone] = False
        self.climbed, self.alone = len(main), len(main) + len(alone)
        self.rows = np.array([*main, *alone, *np.flatnonzero(free)], np.intp)
        size = scene.disks[self.rows[: self.alone], RADIUS]
        self.learners = np.sort(evenly(np.argsort(size, kind="stable"), MOST_LEARNERS))
        self.inflation = scene.inflations(scene.disks[self.rows, RADIUS])
        self.plain_misfit = float(np.nanmedian([part.chi_square[0] for part in self.fits.values()]))

    def first_disks(self, change: OpticsChange) -> Values:
        """The contacts as they are, behind the contrast and blur that ellipses say."""
        step, _ = change.shifts(self.before)
        disks = np.zeros((len(self.rows), len(AS_DISK)))
        disks[:, :4] = self.scene.disks[self.rows]
        disks[:, RADIUS] = np.maximum(disks[:, RADIUS] + step[self.rows], 0.5 * disks[:, RADIUS])
        return disks

    def refine(self, problem: FitProblem, fit: FittedDisks, prior: OpticsPrior) -> JointFit:
        """Fit the learners to another image, as `contactimg.imaging.fit.edge_profile` asks.

        The others follow by their derivatives, until `settled`.
        """
        learners = self._learners_seen()
        added = problem.image - self.scene.image
        windows = {k: self.views[k].with_light(added).window for k in learners}
        some = learners[:: -(-len(learners) // MOST_WITNESSES)]

        def refit(fits: Sequence[FittedEllipse], other: CommonOptics) -> list[FittedEllipse]:
            parts = zip(some, fits, strict=True)
            return [self._fit(k, windows[k], part.parameters, other) for k, part in parts]

        optics = replace(self.scene.optics, blur=fit.blur, contrast=self.contrast)
        witnesses = [self._fit(k, windows[k], fit.disks[k, AS_ELLIPSE], optics) for k in some]
        problem.work.count_fit(2.0 * sum(float(w.image.size) for w in windows.values()), cut_off=False)
        change = settle_on_ellipses(witnesses, refit, optics, prior.information)
        optics = optics if change is None else change.optics
        self.contrast = optics.contrast
        self.fits |= {k: self._fit(k, windows[k], fit.disks[k, AS_ELLIPSE], optics) for k in learners}
        if self._is_hopeless(learners):
            problem.work.give_up()
        return self.joint_fit(optics, fit.disks, learners)

    def _is_hopeless(self, learners: Sequence[int]) -> bool:
        """Whether those that climbed are poor fits, and hardly better ones than with a plain edge."""
        misfit = np.nanmedian([self.fits[k].chi_square[0] for k in learners if k < self.climbed])
        beyond = max(self.plain_misfit - POOR_CHI_SQUARE, 0.0)
        return bool(misfit - POOR_CHI_SQUARE > HOPELESS_SHARE * beyond)

    def _learners_seen(self) -> list[int]:
        """The learners that have a window."""
        new = {int(k): self.scene.view(self.rows[k : k + 1]) for k in self.learners if k not in self.views}
        self.views |= {k: view for k, view in new.items() if view is not None}
        return [int(k) for k in self.learners if k in self.views]

    def settled(self, found: EdgeFit) -> EdgeFit:
        """All contacts with windows fitted behind an edge; disks follow it as exactly as ellipses."""
        joint, added = found.joint, found.problem.image - self.scene.image
        self.learners = np.arange(self.alone)
        optics = replace(self.scene.optics, blur=joint.fit.blur, contrast=joint.contrast)
        disks = joint.fit.disks.copy()
        for k in self._learners_seen():
            window = self.views[k].with_light(added).window
            self.fits[k] = self._fit(k, window, disks[k, AS_ELLIPSE], optics)
            disks[k] = self.fits[k].parameters[AS_DISK]
        return replace(found, joint=replace(joint, fit=replace(joint.fit, disks=disks)))

    def joint_fit(self, optics: CommonOptics, disks: Values, fitted: Sequence[int]) -> JointFit:
        """The contacts as a joint fit of disks: those that were fitted, the others as they are.

        The mean squared residual is NaN for all but those that climbed: of disks it is not known before.
        """
        fit = self.before.fit
        disks, std, misfit = disks.copy(), fit.std[self.rows], np.full(len(self.rows), np.nan)
        response = self.before.radius_shifts @ np.linalg.inv(np.linalg.cholesky(self.before.covariance))
        shifts = response[self.rows] @ np.linalg.cholesky(optics.covariance)
        for k, part in self.fits.items():
            std[k], shifts[k] = np.sqrt(np.diag(part.covariance)[AS_DISK[:4]]), part.shifts[RADIUS]
        for k in fitted:
            disks[k] = self.fits[k].parameters[AS_DISK]
            misfit[k] = self.fits[k].chi_square[0] if k < self.climbed else np.nan
        own = np.linalg.inv(optics.covariance) - self.known
        own += np.diag(LEAST_INFORMATION / np.array([1.0, optics.blur]) ** 2)
        return replace(
            self.before, own_covariance=np.asarray(np.linalg.inv(own), float),
            fit=replace(fit, disks=disks, std=std, chi_square=misfit, blur=optics.blur),
            contrast=optics.contrast, spread=optics.spread, covariance=optics.covariance,
            radius_shifts=shifts,
        )  # fmt: skip

    def _fit(self, k: int, window: Window, start: Values, optics: CommonOptics) -> FittedEllipse:
        """The ellipse, or the disk, of one window."""
        return fit_ellipse(
            window, start, optics, inflation=float(self.inflation[k]), misfit=self.misfit,
            circular=k >= self.climbed,
        )  # fmt: skip
