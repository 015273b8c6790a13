"""One frame prepared for closer looks: its light over the contrast of its contacts, its blur and noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactimg.files import Experiment
from contactimg.frame import Frame
from contactimg.imaging.count.threshold import DEFAULT_FRACTION
from contactimg.imaging.measure import ImageMeasurement, PreparedImage, count_again
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.detect.rim_blur import estimate_blur
from contactimg.pipeline.edits import edits_by_frame
from contactimg.pipeline.effects import film_setting, resolve_measurement
from contactimg.pipeline.frame import FrameOptions, measure_prepared, measure_scene_frame
from contactimg.pipeline.inputs import contact_sites, read_reference, scene_asperities
from contactimg.pipeline.measured_frame import MeasuredFrame


@dataclass(frozen=True, eq=False)
class FrameLight:
    """A frame measured on its own, without corrections of its contacts, and what was measured.

    Parameters
    ----------
    frame : Frame
        With the corrections and masks of its scene.
    prepared : PreparedImage
    counted : ImageMeasurement
        By the method "threshold" at half height.
    blur : float, px
        Standard deviation of the blurred edge, pixel included.
    """

    frame: Frame
    prepared: PreparedImage
    counted: ImageMeasurement
    blur: float

    @classmethod
    def of(cls, experiment: Experiment, number: int) -> "FrameLight":
        """Measure the frame of this number by the method of its scene."""
        scene, options = experiment.scene, frame_options(experiment)
        frame, reference = experiment.frames[number].read(), read_reference(experiment)
        measurement = measure_prepared(
            frame,
            None if reference is None else reference.image,
            options.scene,
            method=scene.measure.method,
            threshold=scene.measure.threshold,
            blur_px=scene.measure.blur_px,
            options=options,
        )
        prepared = measurement.prepared
        if prepared is None:
            raise TypeError("a measurement keeps what was measured")
        blur = measurement.blur_px
        if np.isfinite(blur):
            blur = float(np.hypot(blur, PIXEL_VARIANCE**0.5))
        elif measurement.contrast:
            blur = estimate_blur(prepared.foreground.image, prepared.foreground.contrast.plateau)
        return cls(frame, prepared, count_again(prepared, DEFAULT_FRACTION), blur)

    @property
    def image(self) -> NDArray[np.float32]:
        """Frame minus background over the contrast: 0 background, 1 contact."""
        foreground = self.prepared.foreground
        plateau = foreground.contrast.plateau
        return foreground.image * np.float32(1.0 / plateau if plateau > 0 else 0.0)

    @property
    def noise(self) -> float:
        """Of a pixel, over the contrast; 0 where nothing stands out."""
        foreground = self.prepared.foreground
        return foreground.noise / foreground.contrast.plateau if foreground.contrast.plateau > 0 else 0.0


def frame_options(
    experiment: Experiment, edits: dict[str, tuple[HandEdit, ...]] | None = None
) -> FrameOptions:
    """How the frames of an experiment are measured one by one, with corrections of their contacts."""
    scene = experiment.scene
    asperities = None if scene.camera is None else scene_asperities(scene)
    sites = None if asperities is None else contact_sites(asperities, scene)
    resolved = resolve_measurement(scene)
    return FrameOptions(resolved, film_setting(resolved, sites), edits=edits or {})


def measure_alone(experiment: Experiment, number: int) -> MeasuredFrame:
    """One frame with its corrections, measured without the rest of its series."""
    reference = read_reference(experiment)
    return measure_scene_frame(
        experiment.frames[number].read(),
        None if reference is None else reference.image,
        options=frame_options(experiment, edits_by_frame(experiment, relative=None)),
    )
