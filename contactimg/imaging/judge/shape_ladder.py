"""The ladder of shapes: a contact is a disk until its pixels say otherwise, then an ellipse, then any shape.

A contact calls for the ladder (`shape_calls`) if its fit is worse than usual, if its rim looks elongated, if
its inside is uneven, if its area by light differs from that of its disk, or if it overlaps another one, which
solids cannot. An ellipse replaces a disk if its ellipticity is significant, and several disks if it explains
their pixels as well. Where an ellipse does not describe them either, area and moments come from the light
(`free_contacts`). What all contacts share is the camera's (`common_distortion`). A frame in which no contact
calls keeps its disks, and only the calls cost time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.ellipse import (
    RADIUS,
    CommonOptics,
    FittedEllipse,
    X,
    Y,
    fit_ellipse,
    render_ellipse,
)
from contactimg.imaging.fit.quality import FittedDetections
from contactimg.imaging.fit.settings import POOR_CHI_SQUARE
from contactimg.imaging.fit.shared_optics import JointFit, hides_contrast
from contactimg.imaging.judge.climbed_contact import ClimbedContact
from contactimg.imaging.judge.climbed_table import Climb, ClimbedTable, flag_unheard
from contactimg.imaging.judge.common_distortion import (
    FEWEST_CONTACTS,
    Distortion,
    edge_cells,
    find_distortion,
    has_own_misfit,
)
from contactimg.imaging.judge.ellipse_edge import EllipseEdge, learn_edge_of_ellipses
from contactimg.imaging.judge.ellipse_optics import (
    LEAST_ELLIPSE_SHARE,
    OpticsChange,
    prior_information,
    settle_on_ellipses,
)
from contactimg.imaging.judge.ellipse_verdict import EllipseVerdict
from contactimg.imaging.judge.free_contacts import CommonContrast, measure_by_light
from contactimg.imaging.judge.shape_calls import find_calls, usual_chi_square
from contactimg.imaging.judge.shape_rows import describe_shapes
from contactimg.imaging.judge.shape_scene import GroupView, ShapeScene
from contactimg.tables import Flag
from contactimg.timings import stage

SHAPES = ("auto", "disk", "ellipse", "free")
"""What may be asked for."""

DISKS_SLACK = 9.0
"""Decrease of chi-square that overlapping disks must achieve against one ellipse. Theory: 3 sigma."""
CLOSE_SIGMA = 3.0
"""Excess of the mean squared residual, in its standard deviations, up to which one ellipse is preferred to
three disks or more, however well these fit. False-alarm rate: 1e-3."""
Part = TypeVar("Part")
SHARPEST_BLUR_PX = 0.65
"""Blur, pixel included, below which contacts stay disks: pixels are no Gaussians. Chosen: two pixels."""
LIGHT_SIGMA = 4.0
"""Difference of the area by light from that of the ellipse above which a shape is free. False-alarm: 6e-5."""
MOST_WITNESSES = 60  # ellipses that contrast and blur are settled on; for time
PROBED = 24
"""Contacts that are asked first where most of them call. Chosen: twice those that show a common misfit."""
LEAST_PIECE_RATIO = 0.5
"""Radius of a rejected disk over the widest of its group from which on it may be a piece of the same contact.
Chosen: disks along a ring are about as wide as each other, specks between touching beads 0.2 to 0.3."""
WORK_PER_PIXEL, LEAST_WORK_PX, WORK_PER_WINDOW_PX = 0.6, 100_000, 1500
"""Pixels of windows, over those of the image, at which the ladder stops, and at least; what a window costs
besides its own. Chosen: at most 1.2 s per megapixel, and 0.2 s, at 2 us a pixel and 3 ms a window, as on a
page of text; a third of that on crowds of ellipses."""
LEAST_WORK_SHARE = 0.25  # of it that is left by a fit that was cut off; chosen, for time


@stage("shapes")
def climb(
    detections: FittedDetections, *, shape: str = "auto", beside_holes: CommonContrast | None = None
) -> Climb:
    """Let the contacts that call for it climb from disks to ellipses to free shapes.

    Parameters
    ----------
    detections : FittedDetections
    shape : {"auto", "disk", "ellipse", "free"}
        "auto": as far as each contact calls for it; "disk": no further; "ellipse", "free": all contacts that
        far.
    beside_holes : CommonContrast or None
        Contrast of the contacts beside holes that most of them have: all are measured by their light.

    Returns
    -------
    Climb
    """
    ladder = _ladder(detections, shape if beside_holes is None else "free")
    if ladder is None:
        return Climb(detections)
    return ladder.result(ladder.climbed() if beside_holes is None else ladder.all_by_light(beside_holes))


@stage("shapes")
def misfit_as_ellipses(detections: FittedDetections, *, shape: str = "auto") -> float:
    """Misfit of some of the contacts as ellipses, behind an edge that was learned from disks.

    See `contactimg.imaging.judge.climbed_table.Climb`.

    Parameters
    ----------
    detections : FittedDetections
    shape : {"auto", "disk", "ellipse", "free"}
        As for `climb`.
    """
    ladder = _ladder(detections, shape)
    return float("nan") if ladder is None else ladder.misfit_of_some()


def _ladder(detections: FittedDetections, shape: str) -> "_Ladder | None":
    """That of a frame; None where no contact calls."""
    frame_fit = detections.frame_fit
    joint = None if frame_fit is None else frame_fit.joint
    if shape == "disk" or frame_fit is None or joint is None or not len(detections.rows):
        return None
    if shape == "auto" and frame_fit.fit.blur < SHARPEST_BLUR_PX:
        return None
    called, score_scale = find_calls(detections, frame_fit)
    if shape != "auto":
        called[:] = True
    called &= ~_flagged(detections, Flag.EDGE | Flag.MANUAL)
    if not called.any():
        return None
    scene = ShapeScene.of(frame_fit, joint)
    return _Ladder(detections, scene, joint, shape=shape, score_scale=score_scale, called=called)


def _flagged(detections: FittedDetections, flags: Flag) -> NDArray[np.bool_]:
    """Contacts with any of some flags."""
    return np.asarray((detections.contacts["flags"] & int(flags)) != 0)


def _some(parts: Sequence[Part], most: int) -> Sequence[Part]:
    """At most so many of them, in even steps."""
    return parts[:: -(-len(parts) // most)] if parts else parts


class _Ladder:
    """The climb of one frame.

    Attributes
    ----------
    detections : FittedDetections
    scene : ShapeScene
    joint : JointFit
    shape : str
    score_scale : float
        Usual score of an elongation over that of noise in independent pixels.
    called : ndarray of bool
        Contacts that call for the ladder.
    usual : float
        Mean squared residual of a contact that fits.
    row_of : ndarray of int
        Row of each disk among the contacts; -1 for a disk that is none, or that was set by hand.
    unheard : list of ndarray of int
        Rows of the groups last asked that were left as they are because the work was too much.
    change : OpticsChange or None
        What ellipses say of contrast and blur, where many contacts are ellipses.
    edge : EllipseEdge or None
        That disks and ellipses show together, where many contacts are ellipses.
    beside_holes : CommonContrast or None
        Contrast of the contacts, where most have holes.
    """

    def __init__(
        self,
        detections: FittedDetections,
        scene: ShapeScene,
        joint: JointFit,
        *,
        shape: str,
        score_scale: float,
        called: NDArray[np.bool_],
    ):
        self.detections, self.scene, self.joint, self.shape = detections, scene, joint, shape
        self.called = called
        self.usual = usual_chi_square(scene.chi_square)
        self.verdict = EllipseVerdict(scene, self.usual, score_scale)
        self.row_of = np.full(len(scene.disks), -1)
        self.row_of[detections.rows] = np.arange(len(detections.rows))
        self.row_of[detections.rows[_flagged(detections, Flag.MANUAL)]] = -1
        self.unheard: list[NDArray[np.intp]] = []
        self.change: OpticsChange | None = None
        self.edge: EllipseEdge | None = None
        self.distortion: Distortion | None = None
        self.contrast = CommonContrast.of(scene, [])
        self.beside_holes: CommonContrast | None = None

    def climbed(self) -> list[ClimbedContact]:
        """All groups with a contact that calls, with their new shapes.

        Where most contacts call, a few are asked first: if none of them climbs, it is the camera that calls.
        """
        groups, calling = self._groups(), np.count_nonzero(self.called)
        if self.shape == "auto" and calling > max(0.5 * len(self.called), 2 * PROBED):
            probe = self._climbed(_some(groups, PROBED))
            if all(contact.kind == "disk" for contact in probe):
                return probe
        return self._climbed(groups)

    def all_by_light(self, contrast: CommonContrast) -> list[ClimbedContact]:
        """All groups by their light over a contrast, without a look for ellipses."""
        self.contrast = self.beside_holes = contrast
        parts = (ClimbedContact.of(view) for view in self._views(self._groups()))
        return [part.measured_by_light(contrast) for part in parts]

    def misfit_of_some(self) -> float:
        """Misfit as ellipses of `MOST_WITNESSES` groups, where an edge was learned from disks."""
        if np.count_nonzero(self.called) < LEAST_ELLIPSE_SHARE * len(self.called):
            return float("nan")
        groups = self._groups()
        some = _some(groups, MOST_WITNESSES)
        found = self._asked(some)
        self._settle_optics(found, share=len(some) / max(len(groups), 1))
        return float("nan") if self.change is None else self.change.misfit

    def _listed(self, members: NDArray[np.intp]) -> NDArray[np.intp]:
        """Rows of those of some disks that are contacts."""
        rows = self.row_of[members]
        return rows[rows >= 0]

    def _rows(self, found: Sequence[ClimbedContact]) -> NDArray[np.intp]:
        """Rows of the contacts that were asked."""
        return self._listed(np.concatenate([part.members for part in found]))

    def _groups(self) -> list[NDArray[np.intp]]:
        """Disks that may be one contact each and that call."""
        disks = np.zeros(len(self.scene.disks), np.bool_)
        disks[self.detections.rows[self.called]] = True
        return self.scene.groups(disks)

    def _climbed(self, groups: Sequence[NDArray[np.intp]]) -> list[ClimbedContact]:
        """Groups with their new shapes."""
        return self._free(self._without_distortion(self._with_settled_optics(self._asked(groups))))

    def _asked(self, groups: Sequence[NDArray[np.intp]]) -> list[ClimbedContact]:
        """Groups as ellipses where these are better; a rejected disk by itself is no contact."""
        found = (part for view in self._views(groups) for part in self._ellipses(view))
        return [part for part in found if len(self._listed(part.members))]

    def _views(self, groups: Sequence[NDArray[np.intp]]) -> Iterator[GroupView]:
        """The windows about groups, as long as their work is not too much."""
        touching, frame_fit = _flagged(self.detections, Flag.MERGED), self.detections.frame_fit
        by_hand = frame_fit is not None and frame_fit.edited is not None
        work = self._share() * max(WORK_PER_PIXEL * self.scene.image.size, LEAST_WORK_PX)
        self.unheard = []
        for members in groups:
            # what touches a neighbour stays a disk: the light of the two cannot be told apart without a shape
            if len(members) == 1 and touching[self.row_of[members]].any():
                continue
            if self._has_specks(members) or (by_hand and (self.row_of[members] < 0).any()):
                continue
            if work < 0:
                self.unheard.append(self._listed(members))
                continue
            view = self.scene.view(members)
            work -= WORK_PER_WINDOW_PX + (0 if view is None else view.window.image.size)
            if view is not None:
                yield view

    def _has_specks(self, members: NDArray[np.intp]) -> bool:
        """Whether rejected disks between touching contacts tie these together."""
        rejected, radii = self.row_of[members] < 0, self.scene.disks[members, RADIUS]
        return bool(np.any(radii[rejected] < LEAST_PIECE_RATIO * radii.max()))

    def _share(self) -> float:
        """Share of the work that the fit leaves: all, unless it was cut off."""
        work = self.scene.problem.work
        return LEAST_WORK_SHARE if work.ran_out else 1.0

    def _ellipses(self, view: GroupView) -> list[ClimbedContact]:
        """The group as one ellipse, or each of its members as one; still disks where that is no better."""
        scene, members = self.scene, view.members
        ellipse = self._fit(view, members)
        if len(members) == 1 or self.shape == "free":
            wanted = self.shape == "ellipse" or self.verdict.is_elongated(ellipse)
            return [ClimbedContact(members, view, ellipse, "ellipse" if wanted else "disk")]
        model = self._model(view, ellipse)
        one, many = (
            float(np.minimum(view.squared_residuals(part), 100.0).sum())
            for part in (model, view.disk_model())
        )
        scale = self.usual * scene.inflation(float(ellipse.parameters[RADIUS]))
        # each disk has four quantities that follow the noise, an ellipse six
        slack = DISKS_SLACK + 4.0 * len(members) - 6.0
        if one - many < slack * scale and not self.verdict.is_poor(ellipse):
            return [ClimbedContact(members, view, ellipse, "ellipse")]
        close = ellipse.chi_square[0] < 1.0 + CLOSE_SIGMA * np.sqrt(2.0 / max(ellipse.pixels, 1))
        if len(members) > 2 and close:
            return [ClimbedContact(members, view, ellipse, "ellipse")]
        poor = self.scene.chi_square[members] > POOR_CHI_SQUARE * self.usual
        if len(members) > 2 or poor.all():
            return [ClimbedContact(members, view, ellipse, "disk")]
        alone = [scene.view(members[k : k + 1]) for k in range(len(members))]
        fits = [self._fit(part, part.members) for part in alone if part is not None]
        if len(fits) == len(members) and not any(self.verdict.is_poor(fit) for fit in fits):
            kind = {True: "ellipse", False: "disk"}
            return [
                ClimbedContact(part.members, part, fit, kind[self.verdict.is_elongated(fit)])
                for part, fit in zip(alone, fits, strict=True)
                if part is not None
            ]
        return [ClimbedContact(members, view, ellipse, "disk")] if poor.any() else []

    def _fit(self, view: GroupView, members: NDArray[np.intp]) -> FittedEllipse:
        """The ellipse that fits the pixels of a group best."""
        disks = self.scene.disks[members]
        area = disks[:, 2] ** 2
        start = np.zeros(6)
        start[[X, Y]] = np.average(disks[:, :2], axis=0, weights=area)
        start[RADIUS], start[5] = (
            np.sqrt(np.count_nonzero(view.component) / np.pi),
            self.scene.optics.contrast,
        )
        if len(members) == 1:
            start[:3], start[5] = disks[0, :3], disks[0, 3]
        inflation = self.scene.inflation(float(start[RADIUS]))
        return fit_ellipse(view.window, start, self.scene.optics, inflation=inflation)

    def _settle_optics(self, found: list[ClimbedContact], *, share: float = 1.0) -> list[int]:
        """Contrast and blur of the ellipses, where many of the contacts are; which are witnesses of them.

        Not where contacts are too small to show their contrast: their ellipses show no more of it. ``share``:
        of the contacts that call, those found.
        """
        at = [k for k, part in enumerate(found) if part.kind == "ellipse" or len(part.members) == 1]
        count = sum(part.kind == "ellipse" for part in found)
        if hides_contrast(self.joint.fit) or count < LEAST_ELLIPSE_SHARE * share * len(self.detections.rows):
            return []
        witnesses = _some([found[k] for k in at], MOST_WITNESSES)

        def refit(fits: Sequence[FittedEllipse], optics: CommonOptics) -> list[FittedEllipse]:
            return [self._refit(part.view, fit, optics) for part, fit in zip(witnesses, fits, strict=True)]

        fits, known = [part.ellipse for part in witnesses], prior_information(self.joint, self.scene.optics)
        self.change = settle_on_ellipses(fits, refit, self.scene.optics, known)
        return at

    def _with_settled_optics(self, found: list[ClimbedContact]) -> list[ClimbedContact]:
        """The contacts behind the contrast and blur of the ellipses, where many are ellipses."""
        at = self._settle_optics(found)
        if self.change is None:
            return found
        self.scene = replace(self.scene, optics=self.change.optics)
        self.verdict = replace(self.verdict, scene=self.scene)
        found = [replace(part, view=replace(part.view, scene=self.scene)) for part in found]
        for k in at:
            ellipse, single = self._refit(found[k].view, found[k].ellipse, self.scene.optics), found[k].kind
            if len(found[k].members) == 1 and self.shape == "auto":
                single = "ellipse" if self.verdict.is_elongated(ellipse) else "disk"
            found[k] = replace(found[k], ellipse=ellipse, kind=single)
        return self._with_learned_edge(found, at)

    def _with_learned_edge(self, found: list[ClimbedContact], at: list[int]) -> list[ClimbedContact]:
        """The contacts behind the edge that they show together, some of them as ellipses."""
        if self.change is None or self.detections.frame_fit is None:
            return found
        apart = _flagged(self.detections, Flag.EDGE | Flag.MANUAL | Flag.MERGED | Flag.SATURATED)
        # what called and was not heard is a disk for want of time: it would teach a wrong edge
        apart |= self.called & ~np.isin(np.arange(len(self.called)), self._rows(found))
        alone = self.detections.rows[~apart]
        climbed = [found[k] for k in at]
        self.edge = learn_edge_of_ellipses(self.scene, self.detections.frame_fit, self.change, climbed, alone)
        if self.edge is None or self.edge.added is None:
            return found
        for k, ellipse in zip(at, self.edge.ellipses, strict=True):
            view = found[k].view.with_light(self.edge.added)
            kind = "ellipse" if self.shape != "auto" or self.verdict.is_elongated(ellipse) else "disk"
            kind = found[k].kind if len(found[k].members) > 1 else kind
            found[k] = replace(found[k], ellipse=ellipse, view=view, kind=kind)
        return found

    def _refit(self, view: GroupView, fit: FittedEllipse, optics: CommonOptics) -> FittedEllipse:
        """The same ellipse behind other optics."""
        inflation = self.scene.inflation(float(fit.parameters[RADIUS]))
        misfit = 1.0 if self.change is None else min(self.change.misfit, 1.0)
        return fit_ellipse(view.window, fit.parameters, optics, inflation=inflation, misfit=misfit)

    def _model(self, view: GroupView, ellipse: FittedEllipse) -> NDArray[np.float32]:
        """Image of an ellipse in the window of its group."""
        parameters = ellipse.parameters - [*view.window.corner, 0.0, 0.0, 0.0, 0.0]
        return render_ellipse(parameters, self.scene.optics.blur, view.window.image.shape)

    def _without_distortion(self, found: list[ClimbedContact]) -> list[ClimbedContact]:
        """Ellipses that only show what all contacts share are disks."""
        if self.shape != "auto":
            return found
        ellipses = [contact for contact in found if contact.kind == "ellipse"]
        radii = self.detections.contacts["radius_px"] / self.scene.problem.binning
        self.distortion = find_distortion([contact.ellipse for contact in ellipses], radii)
        if self.distortion is None:
            return found
        agreeing = {id(part) for part, same in zip(ellipses, self.distortion.agreeing, strict=True) if same}
        return [replace(contact, kind="disk") if id(contact) in agreeing else contact for contact in found]

    def _free(self, found: list[ClimbedContact]) -> list[ClimbedContact]:
        """Contacts that an ellipse does not describe, measured by their light."""
        if self.shape == "ellipse":
            return found
        saturated = _flagged(self.detections, Flag.SATURATED)
        known = [k for k, part in enumerate(found) if not saturated[self._listed(part.members)].any()]
        if self.shape == "free":
            freed = known
        else:
            pierced = [k for k in known if found[k].is_free]
            poor = [k for k in known if k not in pierced and self.verdict.is_misshapen(found[k].ellipse)]
            places = np.array([found[k].ellipse.parameters[[X, Y]] for k in poor]).reshape(-1, 2)
            own = has_own_misfit([self._cells(found[k]) for k in poor], places)
            freed = pierced + [k for k, its_own in zip(poor, own, strict=True) if its_own]
        self.contrast = CommonContrast.of(self.scene, [found[k].view for k in freed])
        for k in freed:
            found[k] = found[k].measured_by_light(self.contrast)
        return self._by_light(found) if self.shape == "auto" else found

    def _by_light(self, found: list[ClimbedContact]) -> list[ClimbedContact]:
        """Contacts whose light is not that of their ellipse are free as well, unless most are like that."""
        uneven = [
            k for k, part in enumerate(found)
            if part.kind != "free" and len(part.members) == 1
            and self.verdict.is_uneven(part.ellipse)
        ]  # fmt: skip
        if len(uneven) >= max(FEWEST_CONTACTS, 0.5 * len(self.detections.rows)):
            return found
        for k in uneven:
            free = measure_by_light(found[k].view, self.contrast)
            radius, variance = (
                float(part)
                for part in (found[k].ellipse.parameters[RADIUS], found[k].ellipse.covariance[RADIUS, RADIUS])
            )
            std = np.hypot(free.area_std, 2.0 * np.pi * radius * np.sqrt(variance))
            if abs(free.shape.area - np.pi * radius**2) > LIGHT_SIGMA * std:
                found[k] = replace(found[k], kind="free", free=free)
        return found

    def _cells(self, contact: ClimbedContact) -> NDArray[np.float64]:
        """Residual of the ellipse in cells about its rim, over the contrast."""
        view = contact.view
        residual = (view.window.image - self._model(view, contact.ellipse)).astype(float)
        if view.window.valid is not None:
            residual[view.window.valid == 0] = np.nan
        residual /= self.scene.optics.contrast
        return edge_cells(residual, contact.ellipse, self.scene.optics.blur, view.window.corner)

    def result(self, climbed: list[ClimbedContact]) -> Climb:
        """The table of the contacts with what became of each group."""
        detections = flag_unheard(self.detections, self.unheard)
        table = ClimbedTable(
            detections, self.scene, self.joint, self.row_of, self.change, self.edge,
            self.distortion, self.verdict.is_elongated, self.beside_holes,
        )  # fmt: skip
        detections, outlines = table.with_shapes(climbed)
        listed = detections.contacts["shape"] if self.shape == "auto" else np.zeros(0)
        remark = describe_shapes(
            listed, self.distortion, unheard=len(self.unheard), holes=self.beside_holes is not None
        )
        return Climb(detections, remark, outlines, self._misfit())

    def _misfit(self) -> float:
        """See `Climb`."""
        if self.edge is not None and self.edge.ellipses:
            return float(np.nanmedian([part.chi_square[0] for part in self.edge.ellipses]))
        return float("nan") if self.change is None else self.change.misfit
