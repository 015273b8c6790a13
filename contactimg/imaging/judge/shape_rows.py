"""Columns of contacts that are no disks, and what to say of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.imaging.count.free_shape import FreeShape
from contactimg.imaging.fit.ellipse import RADIUS, FittedEllipse, X, Y
from contactimg.imaging.fit.problem import FitProblem
from contactimg.imaging.judge.common_distortion import Distortion
from contactimg.imaging.reject.detections import perimeter_of_ellipse


@dataclass(frozen=True, eq=False)
class FreeContact:
    """A contact of any shape with the uncertainty of its area.

    Parameters
    ----------
    shape : FreeShape
        In the window.
    area_std : float, px^2
        Without what all contacts share.
    area_shift : float, px^2
        Change with one standard uncertainty of the common contrast.
    """

    shape: FreeShape
    area_std: float
    area_shift: float


def ellipse_row(ellipse: FittedEllipse, problem: FitProblem, *, elongated: bool) -> dict[str, float | str]:
    """Columns of a contact measured as an ellipse; not ``elongated``: of the disk of its area."""
    binning = problem.binning
    radius, shifts = float(ellipse.parameters[RADIUS]), ellipse.shifts[RADIUS]
    std = float(np.sqrt(ellipse.total_covariance[RADIUS, RADIUS]))
    major, minor = (float(axis) for axis in (ellipse.half_axes if elongated else (radius, radius)))
    axes_std = ellipse.shape_std if elongated else np.full(3, np.nan)
    x, y = problem.in_frame(ellipse.parameters[[X, Y]])
    return {
        "shape": "ellipse" if elongated else "disk",
        "x_px": x,
        "y_px": y,
        "radius_px": radius * binning,
        "radius_std_px": std * binning,
        "contrast_shift_px": float(shifts[0]) * binning,
        "blur_shift_px": float(shifts[1]) * binning,
        "semi_major_px": float(major) * binning,
        "semi_minor_px": float(minor) * binning,
        "angle_rad": ellipse.angle if elongated else np.nan,
        "semi_major_std_px": float(axes_std[0]) * binning,
        "semi_minor_std_px": float(axes_std[1]) * binning,
        "angle_std_rad": float(axes_std[2]),
        "perimeter_px": perimeter_of_ellipse(float(major), float(minor)) * binning,
        "holes": 0,
    }


def free_row(free: FreeContact, problem: FitProblem, corner: tuple[int, int]) -> dict[str, float | str]:
    """Columns of a contact measured by its light, in the window whose first pixel is ``corner`` (x, y)."""
    shape, binning = free.shape, problem.binning
    radius = float(np.sqrt(max(shape.area, 0.0) / np.pi))
    per_area = 1.0 / (2.0 * np.pi * max(radius, 1e-9))
    std = float(np.hypot(free.area_std, free.area_shift))
    x, y = problem.in_frame(np.array([shape.x + corner[0], shape.y + corner[1]]))
    return {
        "shape": "free",
        "x_px": x,
        "y_px": y,
        "radius_px": radius * binning,
        "radius_std_px": std * per_area * binning,
        "contrast_shift_px": free.area_shift * per_area * binning,
        "blur_shift_px": 0.0,
        "edge_shift_px": 0.0,
        "semi_major_px": shape.semi_major * binning,
        "semi_minor_px": shape.semi_minor * binning,
        "angle_rad": shape.angle,
        "semi_major_std_px": np.nan,
        "semi_minor_std_px": np.nan,
        "angle_std_rad": np.nan,
        "perimeter_px": shape.perimeter * binning,
        "holes": shape.holes,
    }


def describe_shapes(
    shapes: NDArray, distortion: Distortion | None, *, unheard: int, holes: bool = False
) -> str:
    """How many contacts are no disks, and what they share.

    ``unheard`` groups were not asked; ``holes``: most contacts have some.
    """
    parts = []
    if holes:
        parts.append(
            "most contacts have holes that the blur fills: their areas are those of their light over the "
            "contrast beside the holes"
        )
    if distortion is not None:
        degrees = np.degrees(distortion.angle)
        parts.append(
            f"all contacts are elongated alike, {distortion.ratio:.3f} : 1 at {degrees:.0f} degrees "
            "from x towards y: that is the camera's, and their areas do not depend on it"
        )
    ellipses, free = (int(np.count_nonzero(shapes == kind)) for kind in ("ellipse", "free"))
    named = [(ellipses, "ellipse"), (free, "free")]
    if ellipses + free:
        texts = [_count_text(number, kind) for number, kind in named if number]
        parts.append(" and ".join(texts) + ": a disk does not describe them")
    if unheard:
        parts.append(f"{unheard} more were left as disks, as too many call for another shape")
    return "; ".join(parts)


def _count_text(number: int, kind: str) -> str:
    """How many contacts have a shape."""
    if kind == "ellipse":
        return "1 contact is an ellipse" if number == 1 else f"{number} contacts are ellipses"
    return "1 contact has a free shape" if number == 1 else f"{number} contacts have free shapes"
