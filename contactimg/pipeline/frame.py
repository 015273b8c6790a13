"""Measure one frame: from pixels to a contacts table, either directly or as its scene says."""

import logging
import warnings
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from contactimg.effects.render_without import measuring
from contactimg.errors import FrameWarning, InputError
from contactimg.files import FrameTables, read_part
from contactimg.frame import Frame, as_pixels, full_scale_of_type
from contactimg.imaging.detect.hand_edits import HandEdit
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.imaging.measure import LINEARITY, ImageMeasurement
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.optics.render_settings import lamp
from contactimg.pipeline.each_frame import FailedFrame
from contactimg.plausibility import doubts_about_scene, settle
from contactimg.pose import Pose
from contactimg.scene import Scene, scene_from_dict
from contactimg.tables import CONTACTS, OUTLINES, REJECTED, Status

logger = logging.getLogger(__name__)

Edits = tuple[HandEdit, ...]
"""Corrections by hand to the contacts of a frame, in the order of their table."""


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
    linearity: float = LINEARITY,
    film: Literal["auto", "off"] = "auto",
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
    linearity : float
        Standard uncertainty of the camera's response at mid-level, of the contrast; 0 for a camera that is
        known to be linear.
    film : {"auto", "off"}
        ``"off"``: no air film shines beside the contacts. Otherwise ``radius_std_px`` allows for one that is
        too narrow to be seen, 0.14 of the blur.

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
        If the pixel size, the contrast or the blur is not a positive number, or an option has another value,
        or the pixel size is that of no microscope (`contactimg.plausibility`).
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
    if contrast is not None and not (isinstance(contrast, Real) and 0 < contrast < np.inf):
        raise InputError(f"measure_frame: contrast must be a positive number of levels, got {contrast!r}")
    measure = {"method": method, "shape": shape, "threshold": threshold, "blur_px": blur_px}
    keys = {
        "camera": {"pixel_size_m": pixel_size, "linearity": linearity},
        "images": {"polarity": polarity},
        "measure": {name: value for name, value in measure.items() if value is not None},
        "effects": {"film": film},
    }
    scene = scene_from_dict(keys, name="measure_frame")
    settle(doubts_about_scene(scene), "measure_frame")
    optics = None if contrast is None else SharedOptics(contrast)
    if not isinstance(frame, Frame):
        frame = Frame(frame, full_scale=full_scale_of_type(frame))
    image = reference.image if isinstance(reference, Frame) else reference
    image = None if image is None else as_pixels(image)
    measurement = measure_prepared(frame, image, scene, optics=optics, film=film_setting(scene, None))
    pose = Pose(frame.shape, pixel_size)
    contacts = locate_contacts(contacts_table(measurement, frame.name), pose, shift_px=(0.0, 0.0))
    contacts.attrs |= {"status": str(measurement.status), "message": measurement.message}
    if measurement.status != Status.OK:
        text = measurement.message or "see contactimg.tables.Status"
        warnings.warn(f"{frame.name or 'frame'}: {measurement.status}: {text}", FrameWarning, stacklevel=2)
    return contacts


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """One frame's part of a run.

    Parameters
    ----------
    row : dict
        Its row of the frames table.
    shape : (int, int) or None
        Rows and columns; None for a frame that failed.
    where : FrameTables or str
        Its tables, or the part file that holds them.
    own_optics : SharedOptics or None
        Contrast (grey levels) and blur that the frame alone shows; None where it shows nothing.
    level : float
        Grey level of its background; 0 where that was subtracted before.
    film : FilmVerdict or None
        What its rims say of an air film; None where none was looked for.
    unmatched : tuple of HandEdit
        Corrections that meet no contact.
    """

    row: dict[str, Any]
    shape: tuple[int, int] | None
    where: FrameTables | str
    own_optics: SharedOptics | None = None
    level: float = 0.0
    film: FilmVerdict | None = None
    unmatched: Edits = ()

    @classmethod
    def of(cls, result: "MeasuredFrame | FailedFrame") -> "MeasuredFrame":
        """The part as it is; of a frame that could not be measured empty tables and a row that says why."""
        return cls(result.row, None, FrameTables()) if isinstance(result, FailedFrame) else result

    @property
    def tables(self) -> FrameTables:
        """Its tables, read from the part file each time if they are there."""
        where = self.where if isinstance(self.where, FrameTables) else read_part(self.where).where
        return cast("FrameTables", where)

    @property
    def contacts(self) -> pd.DataFrame:
        """Its contacts."""
        return self.tables.contacts

    @property
    def relative_optics(self) -> SharedOptics | None:
        """Its own optics with the contrast divided by the background."""
        own = self.own_optics
        return None if own is None else replace(own.scaled(1.0 / (self.level or 1.0)), relative=True)

    def with_contacts(self, contacts: pd.DataFrame) -> "MeasuredFrame":
        """Return the frame with other contacts."""
        return replace(self, where=replace(self.tables, contacts=contacts))

    def with_remarks(self, *remarks: object) -> "MeasuredFrame":
        """Return the frame with remarks added to its message, if there are any."""
        message = "; ".join(str(text) for text in (self.row["message"], *remarks) if text)
        return replace(self, row=self.row | {"message": message})

    def kept_in(self, path: Path) -> "MeasuredFrame":
        """Return the frame with its tables left in a part file."""
        return replace(self, where=str(path))

    def log(self, before: str = "") -> None:
        """Log one line about the frame."""
        numbers = ", ".join(f"{name} {x:.4g}" for name, x in self.row.items() if isinstance(x, float))
        count = self.row.get("n_contacts", pd.NA)
        found = f"{self.row['status']}, {0 if pd.isna(count) else count} contacts, {numbers}"
        logger.info("%s%s: %s", before, self.row["frame"], found)


@dataclass(frozen=True)
class FrameOptions:
    """The settings with which the frames of a scene are measured.

    Parameters
    ----------
    scene : Scene
        Its ``[measure]``, ``[images]`` and ``[effects]`` apply.
    film : FilmSetting or None
        Rim that the air film may draw around the contacts, from `film_setting`.
    """

    scene: Scene
    film: FilmSetting | None


def film_setting(scene: Scene, sites: pd.DataFrame | None) -> FilmSetting | None:
    """The rim that the air film may draw around contacts, and whether it is drawn.

    Under "auto" the pixels decide where pixel size and radius of the asperities are known; else there is no
    film.

    Parameters
    ----------
    scene : Scene
        The light is that of ``[light]`` (by default a white LED, glass and PDMS).
    sites : DataFrame or None
        Composite summits of the asperities: the film of the mean radius is drawn.

    Raises
    ------
    InputError
        If the film is switched on, and the pixel size or the asperities' radius is not known.
    """
    asked, radius = scene.effects.film, scene.common_radius
    if radius is None and sites is not None and len(sites):
        radius = float(sites["radius_m"].mean())
    if scene.measure.method != "disk" or (asked != "on" and None in (scene.camera, radius)):
        return None
    camera = scene.need("camera", 'measuring with [effects] film = "on"')
    if radius is None:
        cure = 'give [asperities] radius_m, or a file with it, or set film = "off"'
        raise InputError(f'[effects] film = "on" needs the radius of the asperities; {cure}')
    rim = FilmRim(lamp(scene.light), radius, camera.pixel_size)
    return FilmSetting(rim, asked, scene.measure.film_doubt)


def measure_scene_frame(
    frame: Frame,
    reference: NDArray | None,
    optics: SharedOptics | None = None,
    edits: Edits = (),
    *,
    options: FrameOptions,
) -> MeasuredFrame:
    """Measure one frame by the scene's method.

    Parameters
    ----------
    frame : Frame
    reference : ndarray or None
        Pixels of the reference.
    optics : SharedOptics, optional
        Contrast and blur from other frames.
    edits : tuple of HandEdit
    options : FrameOptions
    """
    scene, film = options.scene, options.film
    measurement = measure_prepared(frame, reference, scene, film=film, optics=optics, edits=edits)
    rejected = REJECTED.conform(measurement.rejected.assign(frame=frame.name))
    outlines = outlines_table(measurement, frame.name)
    tables = FrameTables(contacts_table(measurement, frame.name), rejected, outlines)
    row, own = frame_row(measurement, frame.name), measurement.own_optics if len(measurement.disks) else None
    level, film_seen, unmatched = measurement.level, measurement.film, tuple(measurement.unmatched)
    return MeasuredFrame(row, frame.shape, tables, own, level, film_seen, unmatched)


def measure_prepared(
    frame: Frame, reference: NDArray | None, scene: Scene, *, optics: SharedOptics | None = None, **other: Any
) -> ImageMeasurement:
    """Measure a frame as its scene says (`render_without.measuring`), with ``optics`` of other frames.

    ``other`` are further parameters of `contactimg.imaging.measure.measure_image`, instead of the scene's.
    """
    return measuring(scene, frame.full_scale, optics)(frame.image, reference, **other)


def count_pixels(
    frame: Frame, reference: NDArray | None, scene: Scene, *, threshold: float = 0.5, edits: Edits = ()
) -> ImageMeasurement:
    """Count the pixels of a frame above a fraction of the contrast, whatever the method of its scene."""
    how: dict[str, Any] = {"method": "threshold", "threshold": threshold, "blur_px": None}
    return measure_prepared(frame, reference, scene, edits=edits, **how)


def frame_row(measurement: ImageMeasurement, name: str) -> dict[str, Any]:
    """The frame's row of the frames table; without a number of contacts where nothing could be measured."""
    same = ["status", "threshold", "contrast", "noise", "shift_x_px", "shift_y_px", "message", "smallest_px"]
    row: dict[str, Any] = {"frame": name} | {column: getattr(measurement, column) for column in same}
    row["n_contacts"] = len(measurement.disks) if measurement.measurable else pd.NA
    return row | {"detection_limit_px": measurement.smallest_px, "blur_px": measurement.blur_px}


def contacts_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The measured disks as a contacts table, in pixels only."""
    return CONTACTS.conform(measurement.disks.assign(frame=name))


def outlines_table(measurement: ImageMeasurement, name: str) -> pd.DataFrame:
    """The outlines of the contacts of free shape as a table."""
    labels, parts = measurement.disks["label"].to_numpy(), list[pd.DataFrame]()
    for row, lines in measurement.outlines():
        for number, line in enumerate(lines):
            places = {"point": range(len(line)), "x_px": line[:, 0], "y_px": line[:, 1]}
            parts.append(pd.DataFrame(places | {"label": labels[row], "outline": number, "frame": name}))
    return OUTLINES.joined(parts)


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
    x, y = pose.to_sample(contacts["x_px"] - shift_x, contacts["y_px"] - shift_y)
    metres = {
        f"{name}_m{power}": contacts[f"{name}_px{power}"].to_numpy(float) * pose.pixel_size ** int(power or 1)
        for name, _, power in (column.rpartition("_px") for column in CONTACTS.columns)
        if f"{name}_m{power}" in CONTACTS.columns
    }
    return contacts.assign(**metres | {"x_m": x, "y_m": y, "area_m2": np.pi * metres["radius_m"] ** 2})
