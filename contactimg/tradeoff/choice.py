"""The cheapest measurement of a frame that meets a tolerance: the threshold if good enough, else the fit.

What the threshold gets wrong is estimated on the frame itself: the radii of blurred disks that cross the
threshold where it counted (`contactimg.imaging.profile.threshold_radius`), contacts that do not reach it
but a lower one, contacts that it joins, and the stated uncertainty.
"""

from dataclasses import dataclass
from functools import partial
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

from contactimg.effects.output_change import relative_change, stated_change
from contactimg.imaging.contrast.plateau import Contrast
from contactimg.imaging.count.method import count_contacts
from contactimg.imaging.measure import CORRECTIONS, ImageMeasurement, measure_image
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.film_rim import Rim
from contactimg.imaging.profile.threshold_radius import disk_radius
from contactimg.imaging.shapes.inscribed_disks import find_inscribed
from contactimg.imaging.shapes.rim_blur import estimate_blur
from contactimg.scene import Scene

Values = NDArray[np.float64]

FAINT = 0.4
"""Of the threshold: where contacts that do not reach it are looked for."""


@dataclass(frozen=True)
class Choice:
    """How a frame was measured, and why.

    Parameters
    ----------
    method : {"threshold", "disk"}
    error : float
        Estimated relative error of the threshold; infinite where it cannot be told.
    stated : float
        Relative uncertainty that the chosen measurement states.
    relative : float
        The tolerance.
    output : str
        What the errors are of.

    Examples
    --------
    >>> print(Choice("disk", error=0.077, stated=0.002, relative=0.01, output="area"))
    disk: the threshold would be off by 7.7 % of the area, more than 1 %
    """

    method: str
    error: float
    stated: float
    relative: float
    output: str

    def __str__(self) -> str:
        off = f"{100 * self.error:.2g} % of the {self.output}" if self.error < inf else "an unknown amount"
        if self.method == "threshold":
            return f"threshold: off by an estimated {off}, within {100 * self.relative:g} %"
        missed = f"; the fit states {100 * self.stated:.2g} % itself" if self.stated > self.relative else ""
        return f"disk: the threshold would be off by {off}, more than {100 * self.relative:g} %{missed}"


def measure_cheapest(
    image: NDArray,
    reference: NDArray | None,
    *,
    scene: Scene,
    relative: float,
    full_scale: float | None,
    film: Rim | None = None,
) -> tuple[ImageMeasurement, Choice]:
    """Count pixels above the threshold; fit disks if that is estimated to miss the tolerance.

    Parameters
    ----------
    image, reference : ndarray, shape (rows, columns)
    scene : Scene
        ``[measure]``, ``[images]`` and ``[tolerance] output``; the method is what is chosen here.
    relative : float
        Tolerance of the output.
    full_scale : float or None
    film : Rim or None
        Bright rim around the contacts, for the fit.

    Returns
    -------
    ImageMeasurement, Choice
    """
    measure = partial(
        measure_image,
        image,
        reference,
        polarity=scene.images.polarity,
        threshold=scene.measure.threshold,
        full_scale=full_scale,
        blur_px=scene.measure.blur_px,
        absent=scene.effects.switched_off(*CORRECTIONS),
    )
    output = scene.tolerance.output
    measurement, method = measure(method="threshold"), "threshold"
    error = estimate_count_error(measurement, output=output, blur_px=scene.measure.blur_px)
    if error > relative:
        measurement, method = measure(method="disk", film=film), "disk"
    disks = measurement.disks
    stated = stated_change(output, radius=disks["radius_px"], std=disks["radius_std_px"])
    return measurement, Choice(method, error, stated, relative, output)


def estimate_count_error(
    measurement: ImageMeasurement, *, output: str, blur_px: float | None = None
) -> float:
    """Relative error of the output that a measurement by threshold leaves.

    Parameters
    ----------
    measurement : ImageMeasurement
        By the method ``threshold``.
    output : {"area", "force", "radius"}
        All contacts count as of one radius of curvature.
    blur_px : float, optional
        Standard deviation of the point spread function; default: from the slopes of the rims.

    Returns
    -------
    float
        Infinite if nothing is counted, or the frame does not show its contrast.

    Notes
    -----
    Bias and scatter add in squares. Disks with sharp edges are assumed; an error of the contrast counts as
    the measurement states it.
    """
    disks = measurement.disks
    if not len(disks) or not measurement.resolved:
        return inf
    signed = measurement.foreground
    signed[~np.isfinite(signed)] = 0.0
    plateau, fraction = abs(measurement.contrast), measurement.threshold
    blur = estimate_blur(signed, plateau) if blur_px is None else hypot(blur_px, PIXEL_VARIANCE**0.5)
    counted = disks[["x_px", "y_px", "radius_px"]].to_numpy(float)
    radius, complete = _parted(counted, find_inscribed(signed, fraction * plateau, smoothing=0.0, valid=None))
    complete = disk_radius(complete, blur_px=blur, fraction=fraction)
    missed = disk_radius(_missed(signed, measurement, counted), blur_px=blur, fraction=FAINT * fraction)
    radius = np.concatenate([radius, np.zeros(missed.size)])
    complete = np.concatenate([complete, missed])
    bias = relative_change(output, without=(radius**3, radius), complete=(complete**3, complete))
    return hypot(bias, stated_change(output, radius=counted[:, 2], std=disks["radius_std_px"]))


def _parted(counted: Values, inscribed: Values) -> tuple[Values, Values]:
    """Counted radii, and those of the contacts behind them, row by row.

    A component with several inscribed disks is one contact in the first list and several in the second.
    """
    if not len(inscribed):
        return counted[:, 2], counted[:, 2]
    apart = np.hypot(inscribed[:, None, 0] - counted[None, :, 0], inscribed[:, None, 1] - counted[None, :, 1])
    owner = np.argmin(apart - counted[None, :, 2], axis=1)
    number = np.bincount(owner, minlength=len(counted))
    joined = number > 1
    parts = inscribed[joined[owner]]
    # parts keep the area that was counted for them together
    square = np.bincount(owner, inscribed[:, 2] ** 2, minlength=len(counted))
    scale = counted[:, 2] / np.sqrt(np.where(square > 0, square, 1.0))
    radii = parts[:, 2] * scale[owner[joined[owner]]]
    alone = counted[~joined, 2]
    radius = np.concatenate([alone, counted[joined, 2], np.zeros(radii.size)])
    complete = np.concatenate([alone, np.zeros(int(joined.sum())), radii])
    return radius, complete


def _missed(signed: NDArray[np.float32], measurement: ImageMeasurement, counted: Values) -> Values:
    """Radii at a lower threshold of the contacts that do not reach the one used."""
    faint, _ = count_contacts(
        signed,
        fraction=FAINT * measurement.threshold,
        contrast=Contrast(abs(measurement.contrast), resolved=True),
        noise=measurement.noise,
    )
    places = np.column_stack([faint[name] for name in ("x_px", "y_px", "radius_px")])
    if not len(places):
        return np.empty(0)
    apart = np.hypot(places[:, None, 0] - counted[None, :, 0], places[:, None, 1] - counted[None, :, 1])
    alone = (apart > places[:, None, 2] + 1).all(axis=1)
    return places[alone, 2]
