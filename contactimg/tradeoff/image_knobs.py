"""The knobs for images: method that measures the contacts, and sampling of rendered frames."""

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage
from skimage.feature import peak_local_max
from skimage.segmentation import watershed

from contactimg.effects.output_change import relative_change, stated_change
from contactimg.errors import InputError
from contactimg.imaging.measure import ImageMeasurement, measure_image
from contactimg.imaging.profile.blurred_disk import PIXEL_VARIANCE
from contactimg.imaging.profile.threshold_radius import disk_radius
from contactimg.models.solution import InteractingSolution
from contactimg.pose.pairs import pair_points
from contactimg.prediction import solve_scene
from contactimg.render import Rendered, render_contacts, render_reference
from contactimg.scene import Scene
from contactimg.tradeoff.case import Case, OwnFrame
from contactimg.tradeoff.knobs import Knob, Setting

Values = NDArray[np.float64]
Disks = Values  # x, y, radius (px), one row per disk


class Shot(NamedTuple):
    """A frame to measure: pixels, those of the reference, and the grey level of saturation."""

    image: NDArray
    reference: NDArray | None
    full_scale: float | None


Method = Callable[[Scene, Shot], Disks]

HALF_HEIGHT = 0.5  # threshold as a fraction of the contrast
SAME_CONTACT_PX = 2.0
"""Disks whose centres are closer than this, or than the radius, are the same contact. Chosen by hand."""

DEPTHS, CONVERGED_DEPTH = (1, 2, 3, 4, 8), 16

SAMPLING_NOISE_LEVELS = 1.0
"""Noise of the frames that compare samplings, in grey levels; the same in all. Chosen by hand."""

SENSOR = ("vignetting", "light_drift", "position_drift", "shot_noise", "quantisation", "saturation", "dust")
"""Effects that do not depend on the sampling and are switched off."""

DISK = "fit of blurred disks"


def image_knob(case: Case) -> Knob:
    """The methods that measure contacts, on a frame rendered from the scene, else on one of its frames."""
    return _own_knob(case, case.measured) if case.measured is not None else _rendered_knob(case)


def _rendered_knob(case: Case) -> Knob:
    """The methods on a rendered frame, whose true contacts are known."""
    solution = cache(lambda: _contacts(case))
    shots = cache(lambda: (_render(case.scene, solution()), _blank(case.scene)))

    def run(measure: Method) -> Disks:
        rendered, reference = shots()
        return measure(case.scene, Shot(rendered.frame.image, reference, rendered.frame.full_scale))

    def error(found: Disks) -> float:
        radii = solution().composite_radius[solution().touching]
        return _disk_change(case.output, found, _table(shots()[0].contacts), radii)

    settings = [
        Setting(name, partial(run, measure), error, "truth of the frame") for name, measure in METHODS.items()
    ]
    return Knob("image", "measurement of a frame", case.output, case.load, tuple(settings))


def _own_knob(case: Case, own: OwnFrame) -> Knob:
    """The methods on a measured frame, with the fit of disks as the reference."""
    blank = None if own.reference is None else own.reference.image
    shot = Shot(own.frame.image, blank, own.frame.full_scale)
    reference = cache(lambda: _fit_disks(case.scene, shot))
    stated = "its own stated uncertainty"

    def error(found: Disks) -> float:
        return _disk_change(case.output, found, reference(), np.ones(len(reference())))

    def own_error(_found: Disks) -> float:
        return _stated_error(case, shot)

    settings = [
        Setting(name, partial(measure, case.scene, shot), error, f"{DISK}, no truth known")
        for name, measure in METHODS.items()
        if name != DISK
    ]
    settings.append(Setting(DISK, partial(_fit_disks, case.scene, shot), own_error, stated))
    return Knob("image", f"measurement of {own.frame.name}", case.output, own.load, tuple(settings))


def _stated_error(case: Case, shot: Shot) -> float:
    """Standard uncertainty of the output as the fit states it."""
    disks = _measure(case.scene, "disk", shot).disks
    if not len(disks):
        raise InputError("no contact was found on the frame")
    return stated_change(case.output, radius=disks["radius_px"], std=disks["radius_std_px"])


def _disk_change(output: str, measured: Disks, expected: Disks, sphere_radius: Values) -> float:
    """Relative error of the output of measured disks; forces as ``a^3/R``.

    A disk without a partner is compared with no contact; its radius of curvature is the mean one.
    """
    if not len(measured):
        raise InputError("no contact was measured")
    reach = max(SAME_CONTACT_PX, float(expected[:, 2].max(initial=0.0)))
    i, j, distance = pair_points(measured[:, :2], expected[:, :2], max_distance=reach)
    same = distance <= np.maximum(SAME_CONTACT_PX, expected[j, 2])
    i, j = i[same], j[same]
    strangers = np.setdiff1d(np.arange(len(measured)), i)
    radius = np.zeros(len(expected) + strangers.size)
    radius[j], radius[len(expected) :] = measured[i, 2], measured[strangers, 2]
    complete = np.concatenate([expected[:, 2], np.zeros(strangers.size)])
    curvature = np.concatenate([sphere_radius, np.full(strangers.size, np.mean(sphere_radius))])
    pairs = [(a**3 / curvature, a) for a in (radius, complete)]
    return relative_change(output, without=pairs[0], complete=pairs[1])


def _measure(scene: Scene, method: str, shot: Shot) -> ImageMeasurement:
    """Measure a frame with a method, the other options as in the scene."""
    return measure_image(
        shot.image,
        shot.reference,
        method=method,
        polarity=scene.images.polarity,
        threshold=HALF_HEIGHT,
        full_scale=shot.full_scale,
        blur_px=scene.measure.blur_px,
    )


def _table(disks: pd.DataFrame) -> Disks:
    """Centres and radii."""
    return disks[["x_px", "y_px", "radius_px"]].to_numpy(float)


def _fit_disks(scene: Scene, shot: Shot) -> Disks:
    """The method ``disk``."""
    return _table(_measure(scene, "disk", shot).disks)


def _count(scene: Scene, shot: Shot) -> Disks:
    """The method ``threshold``."""
    return _table(_measure(scene, "threshold", shot).disks)


def _count_corrected(scene: Scene, shot: Shot) -> Disks:
    """The method ``threshold``, with the radius of the blurred disk that has the counted area."""
    blur = scene.measure.blur_px
    if blur is None and scene.simulate is not None and scene.effects.blur != "off":
        blur = scene.simulate.blur_px
    if not blur:
        raise InputError("the blur is not known: give blur_px in [measure]")
    x, y, radius = _count(scene, shot).T
    return np.column_stack(
        [x, y, disk_radius(radius, blur_px=float(np.hypot(blur, np.sqrt(PIXEL_VARIANCE))))]
    )


def _count_split(scene: Scene, shot: Shot) -> Disks:
    """The method ``threshold``, with touching contacts separated by a watershed."""
    measurement = _measure(scene, "threshold", shot)
    mask = measurement.foreground > HALF_HEIGHT * abs(measurement.contrast)
    distance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    smooth = ndimage.gaussian_filter(distance, 1.0)
    peaks = peak_local_max(smooth, min_distance=2, labels=ndimage.label(mask, np.ones((3, 3)))[0])
    markers = np.zeros(mask.shape, np.int32)
    markers[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    labels = watershed(-smooth, markers, mask=mask)
    area = np.bincount(labels.ravel(), minlength=len(peaks) + 1)[1:]
    kept = np.flatnonzero(area) + 1
    centres = np.asarray(ndimage.center_of_mass(mask, labels, kept)).reshape(-1, 2)
    found = np.column_stack([centres[:, 1], centres[:, 0], np.sqrt(area[kept - 1] / np.pi)])
    return found[_asserted(found, _table(measurement.disks))]


def _asserted(parts: Disks, whole: Disks) -> NDArray[np.bool_]:
    """Which parts lie in a contact of the measurement, and are neither noise nor hot pixels."""
    apart = np.hypot(parts[:, None, 0] - whole[None, :, 0], parts[:, None, 1] - whole[None, :, 1])
    return np.asarray((apart <= SAME_CONTACT_PX + 2 * whole[None, :, 2]).any(axis=1))


METHODS: dict[str, Method] = {
    "threshold at half height": _count,
    "threshold, radius of the blurred disk": _count_corrected,
    "threshold, touching contacts parted": _count_split,
    DISK: _fit_disks,
}


def _contacts(case: Case) -> InteractingSolution:
    """The contacts that are rendered."""
    if case.asperities is None:
        raise InputError("the scene has no asperities")
    coupling = "none" if case.scene.effects.coupling == "off" else "asymptotic"
    return solve_scene(case.scene, case.asperities, load=case.load, coupling=coupling)


def _render(scene: Scene, solution: InteractingSolution) -> Rendered:
    """Render a frame of the contacts."""
    rng = np.random.default_rng(scene.need("simulate", "rendering a frame").seed)
    radii = solution.composite_radius[solution.touching]
    return render_contacts(solution.contacts("rendered"), scene, rng=rng, sphere_radius=radii)


def _blank(scene: Scene) -> NDArray:
    """Render the reference frame."""
    seed = scene.need("simulate", "rendering a frame").seed
    return render_reference(scene, rng=np.random.default_rng([seed, 1])).image


def supersampling_knob(case: Case) -> Knob:
    """The samples per pixel of the renderer, without effects that do not depend on them."""
    solution = cache(lambda: _contacts(case))

    def run(depth: int) -> Rendered:
        return _render(_without_sensor(case.scene, depth), solution())

    reference = cache(lambda: _measure_rendered(case.scene, run(CONVERGED_DEPTH)))

    def error(answer: Rendered) -> float:
        radii = np.ones(len(reference()))
        return _disk_change(case.output, _measure_rendered(case.scene, answer), reference(), radii)

    settings = tuple(
        Setting(
            f"{depth} a pixel",
            partial(run, depth),
            error,
            f"{CONVERGED_DEPTH} a pixel, both measured by {DISK}",
        )
        for depth in DEPTHS
    )
    return Knob("supersampling", "sampling of rendered frames", case.output, case.load, settings)


def _without_sensor(scene: Scene, depth: int) -> Scene:
    """The scene with this sampling and little noise, without texture, drift and dust."""
    effects = dict.fromkeys(SENSOR, "off") | {"read_noise": "on", "supersampling": "on"}
    camera = {
        "texture": 0.0,
        "electrons_per_level": 1.0,
        "read_noise_electrons": SAMPLING_NOISE_LEVELS,
        "supersampling": depth,
    }
    simulate = scene.need("simulate", "rendering a frame").model_copy(update=camera)
    return scene.model_copy(
        update={"effects": scene.effects.model_copy(update=effects), "simulate": simulate}
    )


def _measure_rendered(scene: Scene, rendered: Rendered) -> Disks:
    """Measure a rendered frame against a flat reference."""
    background = scene.need("simulate", "rendering a frame").background_levels
    flat = np.full_like(rendered.frame.image, background)
    return _fit_disks(scene, Shot(rendered.frame.image, flat, rendered.frame.full_scale))
