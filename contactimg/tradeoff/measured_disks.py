"""Disks measured on a frame by each method, and the relative error of one set against another."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.effects.output_change import relative_change
from contactimg.errors import InputError
from contactimg.imaging.measure import measure_image
from contactimg.pose.pairs import pair_points
from contactimg.scene import Scene

Values = NDArray[np.float64]

DISK = "fit of blurred disks"
COUNT = "threshold at half height"
CORRECTED = "threshold, radius of the blurred disk"
METHODS = (COUNT, CORRECTED, DISK)

HALF_HEIGHT = 0.5
"""Threshold as a fraction of the contrast."""

SAME_CONTACT_PX = 2.0
"""Disks whose centres are closer than this, or than the radius, are the same contact. Chosen by hand."""


class Shot(NamedTuple):
    """A frame to measure: pixels, those of the reference, and the grey level of saturation."""

    image: NDArray
    reference: NDArray | None
    full_scale: float | None


def measure_disks(scene: Scene, method: str, shot: Shot) -> pd.DataFrame:
    """Disks of a frame by one of `METHODS`, the other options as in the scene."""
    disks = measure_image(
        shot.image,
        shot.reference,
        method="disk" if method == DISK else "threshold",
        polarity=scene.images.polarity,
        threshold=HALF_HEIGHT,
        full_scale=shot.full_scale,
        blur_px=scene.measure.blur_px,
    ).disks
    if method != CORRECTED:
        return disks
    blur = scene.measure.blur_px
    if blur is None and scene.simulate is not None and scene.effects.blur != "off":
        blur = scene.simulate.blur_px
    if not blur:
        raise InputError("the blur is not known: give blur_px in [measure]")
    # half height lies (s^2 + 1/12)/(2 a) inside the edge of a wide disk of radius a
    radius = disks["radius_px"]
    return disks.assign(radius_px=(radius + np.sqrt(radius**2 + 2 * (blur**2 + 1 / 12))) / 2)


def disk_change(
    output: str, measured: pd.DataFrame, expected: pd.DataFrame, sphere_radius: Values | None = None
) -> float:
    """Relative error of the output of measured disks; forces as ``a^3/R``.

    A disk without a partner is compared with no contact; its radius of curvature is the mean one.
    """
    if not len(measured):
        raise InputError("no contact was measured")
    found, true = (table[["x_px", "y_px", "radius_px"]].to_numpy(float) for table in (measured, expected))
    curvature = np.ones(len(true)) if sphere_radius is None else sphere_radius
    reach = max(SAME_CONTACT_PX, float(true[:, 2].max(initial=0.0)))
    i, j, distance = pair_points(found[:, :2], true[:, :2], max_distance=reach)
    same = distance <= np.maximum(SAME_CONTACT_PX, true[j, 2])
    i, j = i[same], j[same]
    strangers = np.delete(found[:, 2], i)
    radius = np.concatenate([np.zeros(len(true)), strangers])
    radius[j] = found[i, 2]
    complete = np.concatenate([true[:, 2], np.zeros(strangers.size)])
    mean = float(np.mean(curvature)) if curvature.size else 1.0
    curvature = np.concatenate([curvature, np.full(strangers.size, mean)])
    pairs = [(a**3 / curvature, a) for a in (radius, complete)]
    return relative_change(output, without=pairs[0], complete=pairs[1])
