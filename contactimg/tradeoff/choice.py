"""The cheapest measurement of a frame that meets a tolerance: the threshold if good enough, else the fit.

The error of the threshold is estimated on the frame itself (`contactimg.imaging.count.expected_error`) and
compared with the tolerance.
"""

from dataclasses import dataclass
from functools import partial
from math import hypot, inf

from numpy.typing import NDArray

from contactimg.effects.output_change import relative_change, stated_change
from contactimg.imaging.count.expected_error import estimate_true_radii
from contactimg.imaging.measure import CORRECTIONS, ImageMeasurement, measure_image
from contactimg.imaging.profile.film_rim import FilmSetting
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.scene import Scene


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
    film: FilmSetting | None = None,
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
    film : FilmSetting or None
        Bright rim that contacts may have, for the fit.

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
        threshold_std=scene.measure.threshold_std,
        full_scale=full_scale,
        blur_px=scene.measure.blur_px,
        optics=SharedOptics().with_edge(scene.measure.edge_shift_px, scene.measure.edge_shift_std_px),
        absent=scene.effects.switched_off(*CORRECTIONS),
    )
    output = scene.tolerance.output
    measurement, method = measure(method="threshold"), "threshold"
    error = estimate_count_error(measurement, output=output, blur_px=scene.measure.blur_px)
    if error > relative:
        measurement, method = measure(method="disk", film=film, shape=scene.measure.shape), "disk"
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
    counted, true = estimate_true_radii(
        measurement.foreground,
        disks[["x_px", "y_px", "radius_px"]].to_numpy(float),
        fraction=measurement.threshold,
        plateau=abs(measurement.contrast),
        noise=measurement.noise,
        blur_px=blur_px,
    )
    bias = relative_change(output, without=(counted**3, counted), complete=(true**3, true))
    return hypot(bias, stated_change(output, radius=disks["radius_px"], std=disks["radius_std_px"]))
