"""Measure one frame: from pixels to a contacts table, either directly or as its scene says."""

import warnings
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.errors import FrameWarning, InputError
from contactimg.frame import Frame
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.measure import CORRECTIONS, LINEARITY, ImageMeasurement, measure_image
from contactimg.imaging.profile.film_rim import FilmSetting
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.measured_frame import FrameTables, MeasuredFrame, SumOfCubes
from contactimg.pose import Pose
from contactimg.scene import Scene
from contactimg.tables import CONTACTS, OUTLINES, REJECTED, Status
from contactimg.tradeoff.choice import measure_cheapest

POINTS_IN_DISK = 4096
"""Points that the visible part of a contact is counted with. Measured: to 0.3 % of the contact's area."""


def measure_frame(
    frame: Frame | NDArray,
    reference: Frame | NDArray | None = None,
    *,
    pixel_size: float,
    method: Literal["threshold", "disk"] = "disk",
    polarity: Literal["bright", "dark", "auto"] = "auto",
    threshold: float | Literal["auto"] | None = None,
    contrast: float | None = None,
    blur_px: float | None = None,
    shape: Literal["auto", "disk", "ellipse", "free"] = "auto",
) -> pd.DataFrame:
    """Measure the contacts on one frame.

    Parameters
    ----------
    frame : Frame or ndarray, shape (rows, columns)
        The frame with contacts.
    reference : Frame or ndarray, optional
        The non-contact frame, of the same shape. Without it the background is estimated from the frame.
    pixel_size : float
        Sample length per pixel, m. Sample coordinates have their origin at the image centre.
    method : {"disk", "threshold"}
        Model fit, or the paper's pixel count.
    polarity : {"auto", "bright", "dark"}
        Whether contacts are brighter or darker than the reference.
    threshold : float or "auto", optional
        Fraction of the contact contrast; default 0.5.
    contrast : float, optional
        Plateau of the contacts minus background, grey levels, if known (from frames with larger contacts,
        say); default: estimated from the frame.
    blur_px : float, optional
        Standard deviation of the optical blur; default: estimated from the frame.
    shape : {"auto", "disk", "ellipse", "free"}
        Shape of the contacts, for ``"disk"``; ``"auto"`` leaves disks only where the pixels call for it.

    Returns
    -------
    DataFrame
        The contacts table, one row a contact; without contacts, an empty table with all its columns. Its
        ``attrs`` hold the ``status`` of the frame (`contactimg.tables.Status`) and its ``message``.

    Warns
    -----
    FrameWarning
        Unless the status is "ok": the message says why, and what to do.

    Notes
    -----
    A contact as small as the blur does not show its full brightness, so its radius depends on the contrast.
    If no contact is larger and the contrast is not given, uncertainties are large and the contacts carry the
    flag ``NO_PLATEAU``. A series (`contactimg.measure_series`) takes the contrast from its other frames.

    Raises
    ------
    InputError
        If the pixel size, the contrast or the blur is not a positive number, or an option has another value.
    FrameError
        If the reference has another shape than the frame.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[:60, :80]
    >>> noise = np.random.default_rng(1).normal(0, 1, (2, 60, 80))
    >>> spot = 100 / (1 + np.exp(1.5 * (np.hypot(x - 41.3, y - 28.6) - 9.5)))
    >>> table = measure_frame(50 + spot + noise[0], 50 + noise[1], pixel_size=1e-6)
    >>> len(table), round(float(table["radius_px"].iloc[0]), 1)
    (1, 9.5)
    >>> table.attrs["status"]
    'ok'
    """
    pixel_size = _positive("pixel_size", pixel_size, "the sample length that one pixel covers, in m")
    optics = SharedOptics()
    if contrast is not None:
        optics = SharedOptics(_positive("contrast", contrast, "plateau minus background in grey levels"))
    if blur_px is not None:
        blur_px = _positive("blur_px", blur_px, "the standard deviation of the blur in pixels")
    frame = frame if isinstance(frame, Frame) else Frame(np.asarray(frame))
    image = reference.image if isinstance(reference, Frame) else reference
    measurement = measure_image(
        frame.image,
        image,
        method=method,
        polarity=polarity,
        threshold=threshold,
        full_scale=frame.full_scale,
        blur_px=blur_px,
        optics=optics,
        shape=shape,
    )
    pose = Pose(frame.shape, pixel_size)
    contacts = locate_contacts(contacts_table(measurement, frame.name), pose, shift_px=(0.0, 0.0))
    contacts.attrs |= {"status": str(measurement.status), "message": measurement.message}
    if measurement.status != Status.OK:
        text = measurement.message or "see contactimg.tables.Status"
        warnings.warn(f"{frame.name or 'frame'}: {measurement.status}: {text}", FrameWarning, stacklevel=2)
    return contacts


def _positive(name: str, value: object, hint: str) -> float:
    """The value as a positive number, or an `InputError` that says what to give."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not (np.isfinite(value) and value > 0):  # type: ignore[operator, call-overload]
        raise InputError(f"measure_frame: {name} must be a positive number, got {value!r}; give {hint}")
    return float(value)  # type: ignore[arg-type]


@dataclass(frozen=True)
class FrameOptions:
    """How the frames of a scene are measured.

    Parameters
    ----------
    scene : Scene
        Its ``[measure]``, ``[images]`` and ``[effects]`` apply.
    film : FilmSetting or None
        Rim that the air film may draw around the contacts.
    relative : float or None
        Tolerance of the scene's output, for which each frame's method is chosen; None for the scene's method.
    edits : dict
        Name of a frame -> corrections by hand to its contacts.
    """

    scene: Scene
    film: FilmSetting | None = None
    relative: float | None = None
    edits: dict[str, tuple[HandEdit, ...]] = field(default_factory=dict)

    def of_all(self) -> "FrameOptions":
        """These options without the edits, which concern single frames."""
        return replace(self, edits={})

    def of_frame(self, name: str) -> tuple[HandEdit, ...]:
        """Those that concern one frame."""
        return self.edits.get(name, ())


def measure_scene_frame(
    frame: Frame,
    reference: NDArray | None,
    optics: SharedOptics | None = None,
    *,
    options: FrameOptions,
) -> MeasuredFrame:
    """Measure one frame by the scene's method, or by the cheapest one that meets a tolerance.

    Parameters
    ----------
    frame : Frame
    reference : ndarray or None
        Pixels of the reference.
    optics : SharedOptics, optional
        Contrast and blur from other frames; disks are then fitted, whatever the scene's method.
    options : FrameOptions
    """
    scene, choice = options.scene, None
    if options.relative is not None and optics is None:
        measurement, choice = measure_cheapest(
            frame.image,
            reference,
            scene=scene,
            relative=options.relative,
            full_scale=full_scale(frame, scene),
            film=options.film,
        )
    else:
        measurement = measure_prepared(
            frame,
            reference,
            scene,
            method=scene.measure.method if optics is None else "disk",
            threshold=scene.measure.threshold,
            blur_px=scene.measure.blur_px,
            optics=optics,
            options=options,
        )
    tables = FrameTables(
        contacts_table(measurement, frame.name),
        rejected_table(measurement, frame.name),
        outlines_table(measurement, frame.name),
    )
    return MeasuredFrame(
        frame_row(measurement, frame.name),
        frame.shape,
        tables,
        measurement.own_optics if len(measurement.disks) else None,
        measurement.level,
        choice,
        measurement.film,
        SumOfCubes.of(tables.contacts),
    ).with_remarks(choice or "")


def measure_prepared(
    frame: Frame,
    reference: NDArray | None,
    scene: Scene,
    *,
    method: str,
    threshold: float | str | None = None,
    blur_px: float | None = None,
    optics: SharedOptics | None = None,
    options: FrameOptions | None = None,
) -> ImageMeasurement:
    """Measure a frame with the polarity, the full scale and the corrections of its scene.

    Every command measures frames this way: a number calibrated on frames applies only to frames that were
    prepared alike. The other parameters are those of `contactimg.imaging.measure.measure_image`.
    """
    return measure_image(
        frame.image,
        reference,
        method=method,
        polarity=scene.images.polarity,
        threshold=threshold,
        threshold_std=scene.measure.threshold_std,
        full_scale=full_scale(frame, scene),
        blur_px=blur_px,
        optics=(optics or SharedOptics()).with_edge(
            scene.measure.edge_shift_px, scene.measure.edge_shift_std_px
        ),
        film=None if options is None else options.film,
        shape=scene.measure.shape,
        absent=scene.effects.switched_off(*CORRECTIONS),
        linearity=scene.camera.linearity if scene.camera else LINEARITY,
        edits=() if options is None else options.edits.get(frame.name, ()),
    )


def full_scale(frame: Frame, scene: Scene) -> float | None:
    """Grey level of saturation: that of the frame, infinite with ``[effects] saturation = "off"``.

    Examples
    --------
    >>> from contactimg.scene import scene_from_dict
    >>> frame = Frame(np.zeros((3, 4), np.uint8), full_scale=255)
    >>> full_scale(frame, scene_from_dict({"effects": {"saturation": "off"}}))
    inf
    """
    return np.inf if scene.effects.saturation == "off" else frame.full_scale


def frame_row(measurement: ImageMeasurement, name: str) -> dict[str, Any]:
    """The frame's row of the frames table; without a number of contacts where nothing could be measured."""
    return {
        "frame": name,
        "status": measurement.status,
        "n_contacts": len(measurement.disks) if measurement.measurable else pd.NA,
        "threshold": measurement.threshold,
        "contrast": measurement.contrast,
        "noise": measurement.noise,
        "shift_x_px": measurement.shift_x_px,
        "shift_y_px": measurement.shift_y_px,
        "message": measurement.message,
        "smallest_px": measurement.smallest_px,
        "detection_limit_px": measurement.smallest_px,
    }


def contacts_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The measured disks as a contacts table, in pixels only."""
    disks = measurement.disks
    fitted = np.isnan(measurement.threshold)  # the pixels that a threshold counts lie inside the image
    visible = visible_areas(disks, measurement.difference.shape) if fitted else disks["area_px2"]
    return CONTACTS.conform(disks.assign(frame=name, visible_area_px2=visible))


def visible_areas(contacts: pd.DataFrame, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Area of each disk or ellipse inside an image of that shape (px^2), to 0.3 % of its area.

    Contacts of free shape are outlined inside the image.

    Examples
    --------
    >>> half = {"shape": "disk", "x_px": -0.5, "y_px": 9.0, "area_px2": 100.0, "angle_rad": np.nan}
    >>> table = pd.DataFrame([half | {"semi_major_px": 5.64, "semi_minor_px": 5.64}])
    >>> visible_areas(table, (20, 30)).round()
    array([50.])
    """
    visible = contacts["area_px2"].to_numpy(float, copy=True)
    count = np.arange(POINTS_IN_DISK)
    # points of equal areas on the unit disk, turned by the golden angle
    radius, turn = np.sqrt((count + 0.5) / POINTS_IN_DISK), np.pi * (3 - 5**0.5) * count
    u, v = radius * np.cos(turn), radius * np.sin(turn)
    reach = contacts["semi_major_px"]
    inside = (contacts["x_px"] - reach).gt(-0.5) & (contacts["x_px"] + reach).lt(shape[1] - 0.5)
    inside &= (contacts["y_px"] - reach).gt(-0.5) & (contacts["y_px"] + reach).lt(shape[0] - 0.5)
    for row in np.flatnonzero(~inside & (contacts["shape"] != "free")):
        contact = contacts.iloc[row]
        angle = np.nan_to_num(contact["angle_rad"])
        major, minor = contact["semi_major_px"] * u, contact["semi_minor_px"] * v
        x = contact["x_px"] + major * np.cos(angle) - minor * np.sin(angle)
        y = contact["y_px"] + major * np.sin(angle) + minor * np.cos(angle)
        seen = (np.abs(x - (shape[1] - 1) / 2) < shape[1] / 2) & (
            np.abs(y - (shape[0] - 1) / 2) < shape[0] / 2
        )
        visible[row] *= seen.mean()
    return visible


def outlines_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The outlines of the contacts of free shape as a table."""
    labels = measurement.disks["label"].to_numpy()
    parts = [
        pd.DataFrame(
            {
                "label": labels[row],
                "outline": number,
                "point": range(len(line)),
                "x_px": line[:, 0],
                "y_px": line[:, 1],
            }
        )
        for row, lines in measurement.outlines()
        for number, line in enumerate(lines)
    ]
    return (
        OUTLINES.conform(pd.concat(parts, ignore_index=True).assign(frame=name))
        if parts
        else OUTLINES.empty()
    )


def rejected_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The rejected candidates as a table."""
    return REJECTED.conform(measurement.rejected.assign(frame=name))


_LENGTHS_AND_AREAS = [
    (name, power)
    for name, _, power in (column.rpartition("_px") for column in CONTACTS.columns)
    if f"{name}_m{power}" in CONTACTS.columns
]
"""Columns that the table of contacts has in pixels and in metres, without their unit, and the power of it."""


def locate_contacts(
    contacts: pd.DataFrame, pose: Pose, *, shift_px: tuple[ArrayLike, ArrayLike]
) -> pd.DataFrame:
    """Fill the columns in metres of a contacts table.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with pixel columns; not changed.
    pose : Pose
        Pose of the camera over the reference frame.
    shift_px : (array_like, array_like)
        Position in the frame minus position in the reference, (x, y); one, or one for each contact.
    """
    shift_x, shift_y = (np.asarray(shift, float) for shift in shift_px)
    if not (np.isfinite(shift_x).all() and np.isfinite(shift_y).all()):
        raise InputError(f"the shift of a frame must be finite, got {shift_px}")
    x, y = pose.to_sample(contacts["x_px"] - shift_x, contacts["y_px"] - shift_y)
    metres = {
        f"{name}_m{power}": contacts[f"{name}_px{power}"].to_numpy(float) * pose.pixel_size ** int(power or 1)
        for name, power in _LENGTHS_AND_AREAS
    }
    return contacts.assign(**metres | {"x_m": x, "y_m": y, "area_m2": np.pi * metres["radius_m"] ** 2})
