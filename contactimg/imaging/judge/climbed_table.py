"""The table of the contacts of a frame with the shapes to which they climbed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.fit.ellipse import FittedEllipse
from contactimg.imaging.fit.quality import FittedDetections, with_edge
from contactimg.imaging.fit.settings import POOR_CHI_SQUARE
from contactimg.imaging.fit.shared_optics import JointFit
from contactimg.imaging.judge.climbed_contact import ClimbedContact
from contactimg.imaging.judge.common_distortion import Distortion
from contactimg.imaging.judge.ellipse_edge import EllipseEdge
from contactimg.imaging.judge.ellipse_optics import OpticsChange
from contactimg.imaging.judge.free_contacts import CommonContrast
from contactimg.imaging.judge.shape_rows import ellipse_row, free_row
from contactimg.imaging.judge.shape_scene import GroupView, ShapeScene
from contactimg.imaging.reject.detections import Columns, shape_columns
from contactimg.tables import Flag

Outlines = tuple[tuple[int, list[NDArray[np.float64]]], ...]
"""Row of a contact, and its outlines (x, y)."""
SHARED_PARTS = ("contrast_shift_px", "blur_shift_px", "edge_shift_px")  # of the uncertainty of a radius


@dataclass(frozen=True, eq=False)
class Climb:
    """Contacts with their shapes.

    Parameters
    ----------
    detections : FittedDetections
        Their contacts have the columns of `contactimg.imaging.reject.shape_columns` as well.
    remark : str
        How many contacts are no disks, and a distortion that all share; empty if there is nothing to say.
    outlines : list of (int, list of ndarray)
        Row of a contact of free shape, and its outlines (x, y), px of the frame.
    misfit : float
        Median of the mean squared residuals of the contacts as ellipses, over their variance, where contrast
        and blur were settled on them; NaN where most are disks.
    """

    detections: FittedDetections
    remark: str = ""
    outlines: Outlines = ()
    misfit: float = float("nan")


@dataclass(frozen=True, eq=False)
class ClimbedTable:
    """What the contacts of a frame have in common after the climb.

    Parameters
    ----------
    detections : FittedDetections
        As disks.
    scene : ShapeScene
    joint : JointFit
    row_of : ndarray of int
        Row of each disk among the contacts; -1 for a disk that is none.
    change : OpticsChange or None
        What ellipses say of contrast and blur.
    edge : EllipseEdge or None
        That disks and ellipses show together.
    distortion : Distortion or None
        That all contacts share.
    elongated : callable
        Whether the ellipticity of a `FittedEllipse` is significant.
    beside_holes : CommonContrast or None
        Contrast of the contacts, where most have holes.
    """

    detections: FittedDetections
    scene: ShapeScene
    joint: JointFit
    row_of: NDArray[np.intp]
    change: OpticsChange | None
    edge: EllipseEdge | None
    distortion: Distortion | None
    elongated: Callable[[FittedEllipse], bool]
    beside_holes: CommonContrast | None = None

    def with_shapes(self, climbed: Sequence[ClimbedContact]) -> tuple[FittedDetections, Outlines]:
        """The contacts with what became of each group, and the outlines of those of free shape."""
        columns = shape_columns(self._contacts())
        dropped = np.zeros(len(self.detections.rows), np.bool_)
        outlines = []
        for contact in climbed:
            members = contact.members[self.row_of[contact.members] >= 0]
            rows = self.row_of[members]
            row = int(rows[np.argmax(self.scene.disks[members, 2])])
            if contact.kind == "disk" and (len(rows) > 1 or not self._is_common(contact)):
                continue
            dropped[rows] = True
            dropped[row] = False
            values = self._values(contact)
            if contact.kind != "free" and self.edge is not None:
                values |= {name: columns[name][row] for name in ("radius_px", "radius_std_px", *SHARED_PARTS)}
            elif contact.kind != "free":
                edge = columns["edge_shift_px"][row]
                values["radius_std_px"] = float(np.hypot(float(values["radius_std_px"]), edge))
            flags = int(np.bitwise_or.reduce(columns["flags"][rows]))
            for name, value in values.items():
                columns[name][row] = value
            columns["flags"][row] = self._new_flags(contact, flags)
            if contact.free is not None:
                outlines.append(
                    (row, [self._in_frame(contact.view, line) for line in contact.free.shape.outlines])
                )
        kept = np.flatnonzero(~dropped)
        place = np.cumsum(~dropped) - 1
        detections = replace(
            self.detections,
            contacts={name: values[kept] for name, values in columns.items()},
            rows=self.detections.rows[kept],
        )
        if self.edge is not None:
            detections = with_edge(detections, self.edge.fit.learned, self.edge.fit.joint, self.edge.added)
        if self.beside_holes is not None:
            detections = _with_optics(detections, self.beside_holes)
        lines = tuple((int(place[row]), polygons) for row, polygons in outlines)
        return detections, lines

    def _contacts(self) -> Columns:
        """Columns of the contacts as disks, behind the contrast and blur that ellipses say."""
        contacts = self.detections.contacts
        if self.beside_holes is not None:
            return _with_contrast(contacts, self.detections.optics.contrast, self.beside_holes)
        if self.change is None:
            return contacts
        binning = self.scene.problem.binning
        step, shifts = (binning * part[self.detections.rows] for part in self.change.shifts(self.joint))
        old = np.stack([contacts[name] for name in SHARED_PARTS], axis=1)
        new = np.column_stack([shifts, contacts["edge_shift_px"]])
        own = np.maximum(contacts["radius_std_px"] ** 2 - np.sum(old**2, axis=1), 0.0)
        radius = np.maximum(contacts["radius_px"] + step, 0.5 * contacts["radius_px"])
        if self.edge is not None:
            rows, listed = self.row_of[self.edge.rows], self.row_of[self.edge.rows] >= 0
            radius[rows[listed]] = binning * self.edge.radius_px[listed]
            own[rows[listed]] = (binning * self.edge.own_std[listed]) ** 2
            new[rows[listed]] = binning * self.edge.shifts[listed]
        changed = dict(zip(SHARED_PARTS, new.T, strict=True))
        changed["radius_px"] = radius
        changed["radius_std_px"] = np.sqrt(own + np.sum(new**2, axis=1))
        return {**contacts, **changed}

    def _is_common(self, contact: ClimbedContact) -> bool:
        """Whether a contact is a disk that the camera distorts: its ellipse gives the area."""
        return self.distortion is not None and self.elongated(contact.ellipse)

    def _values(self, contact: ClimbedContact) -> dict[str, float | str]:
        """Columns of a contact that climbed."""
        problem = self.scene.problem
        if contact.free is not None:
            return free_row(contact.free, problem, contact.view.window.corner)
        return ellipse_row(contact.ellipse, problem, elongated=contact.kind == "ellipse")

    def _new_flags(self, contact: ClimbedContact, flags: int) -> int:
        """Flags of the new shape: what was said of the disks no longer holds."""
        old = Flag.POOR_FIT | Flag.MERGED if len(contact.members) > 1 else Flag.POOR_FIT
        poor = contact.kind != "free" and bool(contact.ellipse.chi_square[0] > POOR_CHI_SQUARE)
        return (flags & ~int(old)) | (int(Flag.POOR_FIT) if poor else 0)

    def _in_frame(self, view: GroupView, line: NDArray[np.float64]) -> NDArray[np.float64]:
        """An outline in pixels of the frame."""
        return self.scene.problem.in_frame(line + np.array(view.window.corner))


def _with_contrast(contacts: Columns, before: float, common: CommonContrast) -> Columns:
    """Columns of disks with the same light and another contrast."""
    radius = contacts["radius_px"] * np.sqrt(before / common.mean)
    shift = -0.5 * radius * common.std / common.mean
    old = np.stack([contacts[name] for name in SHARED_PARTS], axis=1)
    own = np.maximum(contacts["radius_std_px"] ** 2 - np.sum(old**2, axis=1), 0.0)
    std = np.sqrt(own + shift**2 + np.sum(old[:, 1:] ** 2, axis=1))
    return {**contacts, "radius_px": radius, "radius_std_px": std, "contrast_shift_px": shift}


def _with_optics(detections: FittedDetections, common: CommonContrast) -> FittedDetections:
    """Detections whose contrast is that beside the holes."""
    optics, own = (
        replace(each, contrast=common.mean, contrast_std=common.std)
        for each in (detections.optics, detections.own_optics)
    )
    return replace(detections, optics=optics, own_optics=own)


def flag_unheard(detections: FittedDetections, unheard: Sequence[NDArray[np.intp]]) -> FittedDetections:
    """The detections; what calls for another shape and was not asked is no disk that fits."""
    contacts = dict(detections.contacts)
    if unheard:
        flags = contacts["flags"].copy()
        flags[np.concatenate(unheard)] |= int(Flag.POOR_FIT)
        contacts["flags"] = flags
    return replace(detections, contacts=contacts)
