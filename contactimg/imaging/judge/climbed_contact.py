"""A contact on the ladder of shapes: the disks it was, and the ellipse or the light that it became."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.count.free_shape import LEAST_HOLE_BLUR_WIDTHS
from contactimg.imaging.fit.ellipse import FittedEllipse
from contactimg.imaging.judge.free_contacts import CommonContrast, measure_by_light
from contactimg.imaging.judge.shape_rows import FreeContact
from contactimg.imaging.judge.shape_scene import GroupView
from contactimg.imaging.shapes.holes import hole_areas

LARGEST_HOLE_SHARE = 0.01
"""Share of the area of the outline above which holes make its shape free. Chosen: dirt is less."""


@dataclass(frozen=True, eq=False)
class ClimbedContact:
    """What became of a group of disks.

    Parameters
    ----------
    members : ndarray of int
        The disks.
    view : GroupView
    ellipse : FittedEllipse
        Fitted to the group; `FittedEllipse.unknown` where none was.
    free : FreeContact or None
        Measured where an ellipse does not describe it.
    kind : str
        "disk", "ellipse" or "free".
    """

    members: NDArray[np.intp]
    view: GroupView
    ellipse: FittedEllipse
    kind: str
    free: FreeContact | None = None

    @classmethod
    def of(cls, view: GroupView) -> "ClimbedContact":
        """Disks to which no ellipse was fitted."""
        return cls(view.members, view, FittedEllipse.unknown(), "disk")

    def measured_by_light(self, contrast: CommonContrast) -> "ClimbedContact":
        """The same as a contact of free shape."""
        return replace(self, kind="free", free=measure_by_light(self.view, contrast))

    @property
    def is_free(self) -> bool:
        """Whether it has a hole, or is a region of three disks or more that is no ellipse."""
        return self.has_hole or (len(self.members) > 2 and self.kind != "ellipse")

    @property
    def has_hole(self) -> bool:
        """Whether it has a hole that reaches half height and is larger than dirt."""
        pixels, least = (
            self.view.component,
            np.pi * (LEAST_HOLE_BLUR_WIDTHS * self.view.scene.optics.blur) ** 2,
        )
        area = sum(hole for hole in hole_areas(pixels) if hole > least)
        return bool(area > LARGEST_HOLE_SHARE * np.count_nonzero(pixels))
