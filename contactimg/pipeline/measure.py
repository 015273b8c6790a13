"""Measure one frame: pixels to a contacts table."""

from numbers import Real
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.frame import Frame
from contactimg.imaging.measure import ImageMeasurement, measure_image
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pose import Pose
from contactimg.tables import CONTACTS, REJECTED


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
        Plateau of the contacts above the background, grey levels, where it is known (from frames with larger
        contacts, say); default: estimated from the frame.
    blur_px : float, optional
        Standard deviation of the optical blur; default: estimated from the frame.

    Returns
    -------
    DataFrame
        The contacts table, one row a contact; without contacts, an empty table with all its columns.

    Notes
    -----
    Contacts as small as the blur do not show how bright they are, and their radii lean on the contrast: where
    no contact is larger and it is not given, uncertainties are wide and contacts flagged ``NO_PLATEAU``. A
    series (`contactimg.measure_series`) takes it from its other frames.

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
    )
    pose = Pose(frame.shape, pixel_size)
    return locate_contacts(contacts_table(measurement, frame.name), pose, shift_px=(0.0, 0.0))


def _positive(name: str, value: object, hint: str) -> float:
    """The value as a positive number, or one sentence on what it has to be."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not (np.isfinite(value) and value > 0):  # type: ignore[operator, call-overload]
        raise InputError(f"measure_frame: {name} must be a positive number, got {value!r}; give {hint}")
    return float(value)  # type: ignore[arg-type]


def contacts_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The measured disks as a contacts table, in pixels only."""
    return CONTACTS.conform(measurement.disks.assign(frame=name))


def rejected_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The rejected candidates as a table."""
    return REJECTED.conform(measurement.rejected.assign(frame=name))


def locate_contacts(contacts: pd.DataFrame, pose: Pose, *, shift_px: tuple[float, float]) -> pd.DataFrame:
    """Fill the columns in metres of a contacts table.

    Parameters
    ----------
    contacts : DataFrame
        Contacts table with pixel columns; not changed.
    pose : Pose
        Pose of the camera over the reference frame.
    shift_px : (float, float)
        Position in the frame minus position in the reference, (x, y).
    """
    if not np.isfinite(shift_px).all():
        raise InputError(f"the shift of a frame must be finite, got {shift_px}")
    x, y = pose.to_sample(contacts["x_px"] - shift_px[0], contacts["y_px"] - shift_px[1])
    radius = contacts["radius_px"].to_numpy(float) * pose.pixel_size
    return contacts.assign(
        x_m=x,
        y_m=y,
        radius_m=radius,
        radius_std_m=contacts["radius_std_px"].to_numpy(float) * pose.pixel_size,
        area_m2=np.pi * radius**2,
    )
