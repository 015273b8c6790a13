"""From fitted disks to the table of contacts: rejections, flags, uncertainties in pixels of the frame."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.background.difference_image import DifferenceImage
from contactimg.imaging.fit.disks import FittedDisks
from contactimg.imaging.fit.film_choice import WeighedFilm
from contactimg.imaging.fit.learned_edge import LearnedEdge, describe_edge
from contactimg.imaging.fit.problem import RADIUS, FitProblem, X, Y, touches
from contactimg.imaging.fit.settings import (
    EDGE_GAP_BLUR_WIDTHS,
    LEAST_LIGHT_SIGMA,
    LOW_SIGNAL_SIGMA,
    POOR_CHI_SQUARE,
    SIGNIFICANT_LIGHT_SIGMA,
)
from contactimg.imaging.fit.shared_optics import JointFit
from contactimg.imaging.profile.optics import EdgeKnowledge, Halo, KnownEdge, SharedOptics, combine_errors
from contactimg.imaging.reject.detections import PLACE, Columns, Detections
from contactimg.imaging.reject.foreground import Foreground
from contactimg.imaging.reject.implausible_disks import reject_disks
from contactimg.imaging.detect.hand_edits import EditedDisks, HandEdit
from contactimg.imaging.detect.overlap import count_touching
from contactimg.tables import Flag, Reason, Status


@dataclass(frozen=True, eq=False)
class FrameFit:
    """The disks of a frame, detected at one contrast and fitted.

    Parameters
    ----------
    problem : FitProblem
        As fitted in the end, without halo and remaining illumination.
    fit : FittedDisks
    dropped : ndarray, shape (m, 3)
        x, y, radius (px) of disks that were tried and are not needed.
    smallest : float, px
        Radius of the smallest isolated disk that stands out of the noise.
    halo : Halo or None
    joint : JointFit or None
        Of contrast and blur; None if there is no disk.
    edited : EditedDisks or None
        Which disks were changed by hand; None if none was.
    edge : LearnedEdge or None
        That the contacts share; None where none was learned.
    film : WeighedFilm or None
        What the rims say of an air film; None where none was looked for.
    known_edge : KnownEdge or None
        What a reference contact has told of the edge, px of the frame.
    ratio : float
        Contrast over background level; negative for dark contacts.
    lent_edge : EdgeKnowledge or None
        What other frames say of the edge, for contacts that are no disks.
    """

    problem: FitProblem
    fit: FittedDisks
    dropped: NDArray[np.float64]
    smallest: float
    halo: Halo | None
    joint: JointFit | None
    edited: EditedDisks | None = None
    edge: LearnedEdge | None = None
    film: WeighedFilm | None = None
    known_edge: KnownEdge | None = None
    ratio: float = 0.0
    lent_edge: EdgeKnowledge | None = None

    @property
    def has_film(self) -> bool:
        """Whether the contacts were fitted with a film."""
        return self.film is not None and self.film.verdict.taken

    @property
    def radius_shifts(self) -> NDArray[np.float64]:
        """See `JointFit`."""
        return np.zeros((0, 2)) if self.joint is None else self.joint.radius_shifts

    @property
    def edge_shift(self) -> NDArray[np.float64]:
        """Change of each radius (px) by one standard uncertainty of the edges that all contacts share.

        By what the frame does not decide about them, by the choice between film and none, and by the
        reference contact.
        """
        radius = self.fit.disks[:, RADIUS]
        nothing = self.edge is None or not len(self.edge.undecided)
        undecided = np.zeros(len(radius)) if self.edge is None or nothing else self.edge.undecided
        film = np.zeros(len(radius)) if self.film is None else self.film.errors(radius)
        known = 0.0 if self.known_edge is None else self.known_edge.shift_std_px / self.problem.binning
        return np.copysign(np.sqrt(undecided**2 + film**2 + known**2), undecided)


@dataclass(frozen=True, eq=False)
class FittedDetections(Detections):
    """Detections with the fit that they come from, for a second look at the pixels.

    Parameters
    ----------
    frame_fit : FrameFit
    rows : ndarray of int, shape (n,)
        Row of each contact among the disks of the fit.
    """

    frame_fit: FrameFit | None = None
    rows: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))


def report_contacts(
    result: FrameFit, foreground: Foreground, difference: DifferenceImage, *, contrast: float
) -> FittedDetections:
    """Tables of the contacts and of the rejected disks; ``contrast`` is the one to reject at."""
    problem, binning = result.problem, result.problem.binning
    contacts, rows = _tabulate(result)
    disks = np.column_stack([contacts[name] for name in PLACE])
    blur = result.fit.blur * binning
    reasons = reject_disks(
        foreground.frame_pair, foreground.image, difference, disks, blur=blur, contrast=contrast
    )
    unmatched: list[HandEdit] = []
    if result.edited is not None:
        reasons, unmatched = _decide_by_hand(result.edited, rows, contacts, reasons)
    bad = reasons != ""
    unnecessary = result.dropped
    places = np.column_stack([problem.in_frame(unnecessary[:, [X, Y]]), unnecessary[:, RADIUS] * binning])
    rejected: Columns = dict(zip(PLACE, np.vstack([places, disks[bad]]).T, strict=True))
    rejected["reason"] = np.append(np.full(len(places), Reason.UNNECESSARY), reasons[bad])
    if result.joint is None:
        optics = own = SharedOptics(contrast, np.nan, np.nan, blur, np.nan)
    else:
        optics, own = (
            replace(result.joint.optics(covariance, binning=binning), halo=result.halo)
            for covariance in (result.joint.covariance, result.joint.own_covariance)
        )
        own = replace(own, edge=None if result.edge is None else result.edge.knowledge)
    accepted = {name: values[~bad] for name, values in contacts.items()}
    smallest, unresolved = result.smallest * binning, problem.work.unresolved_groups
    return FittedDetections(
        accepted, rejected, optics, own, smallest, unmatched, unresolved, *_edge_verdict(result), result,
        rows[~bad],
    )  # fmt: skip


def with_edge(
    detections: FittedDetections, edge: LearnedEdge, joint: JointFit, added: NDArray[np.float32] | None
) -> FittedDetections:
    """The detections with an edge that was learned after the disks were fitted.

    ``joint`` has the contrast and the blur that go with it; ``added`` makes the edges of the image plain,
    None where they are.
    """
    if detections.frame_fit is None:
        return detections
    problem = detections.frame_fit.problem
    problem = problem if added is None else replace(problem, image=problem.image + added)
    result = replace(detections.frame_fit, edge=edge, problem=problem)
    remark, status = _edge_verdict(result)
    optics, own = (
        replace(joint.optics(covariance, binning=problem.binning), halo=result.halo)
        for covariance in (joint.covariance, joint.own_covariance)
    )
    own = replace(own, edge=edge.knowledge)
    return replace(detections, optics=optics, own_optics=own, remark=remark, status=status, frame_fit=result)


def _decide_by_hand(
    edited: EditedDisks, rows: NDArray[np.intp], contacts: Columns, reasons: NDArray[np.str_]
) -> tuple[NDArray[np.str_], list[HandEdit]]:
    """Reasons of rejection as the hand decides, and corrections without a contact; sets flags in place."""
    new = edited.new[rows]
    contacts["flags"] = contacts["flags"] | np.where(new, int(Flag.MANUAL), 0)
    by_hand = np.where(edited.excluded[rows], str(Reason.BY_HAND), np.where(new, "", reasons))
    return by_hand, edited.unmatched + edited.vanished(rows)


def _edge_verdict(result: FrameFit) -> tuple[str, str]:
    """Remark on the edges, and the status that they give the frame; empty for plain ones."""
    film = None if result.film is None else result.film.verdict
    remarks, status = [film.remark() if film is not None else ""], ""
    if result.edge is not None:
        families = result.edge.families
        soft = {"softness", "rim"} & set(families) and result.known_edge is None
        status = Status.NONLINEAR if "response" in families else Status.SOFT if soft else ""
        remarks.append(describe_edge(result.edge, binning=result.problem.binning))
    if film is not None and film.contradicted:
        status = Status.FILM
    return "; ".join(text for text in remarks if text), status


def _tabulate(result: FrameFit) -> tuple[Columns, NDArray[np.intp]]:
    """Columns of all disks in pixels of the frame, with flags, from top to bottom, and their rows."""
    problem, disks = result.problem, result.fit.disks
    # a disk without pixels is not known at all
    std = np.where(result.fit.std[:, RADIUS] > 0, result.fit.std[:, RADIUS], np.inf)
    shifts, binning = result.radius_shifts, problem.binning
    gap, light = _gap_to_border(disks, problem.image.shape), disks[:, RADIUS] / (2 * std)
    everything = np.column_stack([shifts, result.edge_shift])
    contacts = {
        "x_px": problem.in_frame(disks[:, X]),
        "y_px": problem.in_frame(disks[:, Y]),
        "radius_px": disks[:, RADIUS] * binning,
        "radius_std_px": combine_errors(std, everything) * binning,
        "contrast_shift_px": shifts[:, 0] * binning,
        "blur_shift_px": shifts[:, 1] * binning,
        "edge_shift_px": result.edge_shift * binning,
        "flags": _flags(result, gap, light),
    }
    finite = np.isfinite(np.stack(list(contacts.values()))).all(axis=0)
    # what fits badly must stand out of its own misfit as clearly as a contact out of the noise
    poor = result.fit.chi_square > POOR_CHI_SQUARE
    visible = light > np.where(poor, SIGNIFICANT_LIGHT_SIGMA, LEAST_LIGHT_SIGMA)
    kept = np.flatnonzero(finite & (gap > -disks[:, RADIUS]) & visible)
    order = kept[np.lexsort([contacts["x_px"][kept], contacts["y_px"][kept]])]
    return {name: values[order] for name, values in contacts.items()}, order


def _flags(result: FrameFit, gap: NDArray, light: NDArray) -> NDArray[np.int64]:
    """Flags of all disks, from their distance to the border and their light over its uncertainty."""
    problem, fit, disks = result.problem, result.fit, result.fit.disks
    radius, reach = disks[:, RADIUS], disks[:, RADIUS] + EDGE_GAP_BLUR_WIDTHS * fit.blur
    conditions = {
        Flag.EDGE: (gap < reach) | touches(problem.valid, 0, disks, reach),
        Flag.MERGED: count_touching(disks, fit.blur) > 0,
        Flag.SATURATED: touches(problem.saturated, 1, disks, radius),
        Flag.TOO_SMALL: radius - combine_errors(fit.std[:, RADIUS], result.radius_shifts) < fit.blur,
        Flag.POOR_FIT: fit.chi_square > POOR_CHI_SQUARE,
        Flag.LOW_SIGNAL: light < LOW_SIGNAL_SIGMA,
    }
    flags = np.zeros(len(disks), np.int64)
    for flag, holds in conditions.items():
        flags |= np.where(holds, int(flag), 0)
    return flags


def _gap_to_border(disks: NDArray, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Distance of the centres to the border of the image, negative outside."""
    x, y, (rows, columns) = disks[:, X], disks[:, Y], shape
    return np.asarray(np.minimum.reduce([x + 0.5, columns - 0.5 - x, y + 0.5, rows - 0.5 - y]))
