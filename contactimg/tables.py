"""The tables that flow through contactimg: one schema per table, and the quality flags of a contact."""

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pandas.api.extensions import ExtensionArray

from contactimg.errors import InputError

FAILED = "failed"
"""Status of a frame or load without an answer."""

RUN_MODELS = ("measured", "predicted")
"""What an analysis calls the contacts of the runs themselves, those of `process` and those of `predict`."""


class Flag(enum.IntFlag):
    """What qualifies an accepted contact; several may hold at once."""

    EDGE = enum.auto()
    """The contact, or its blurred rim, is cut by the border of the image or by a hole in it."""
    MERGED = enum.auto()
    """Separated from a neighbour it touches; its radius leans on that separation."""
    SATURATED = enum.auto()
    """Some of its pixels are at the sensor's full scale."""
    TOO_SMALL = enum.auto()
    """Too small for the optics: its radius less its uncertainty is below the blur's standard deviation."""
    POOR_FIT = enum.auto()
    """The pixels differ from the fitted disk by more than the noise allows."""
    BEYOND_HERTZ = enum.auto()
    """a/R above 0.33: Hertz's law is used outside its range."""
    OVERLAP = enum.auto()
    """Model contacts closer than the sum of their radii: they would merge."""
    LOW_SIGNAL = enum.auto()
    """Signal close to the detection limit."""
    NO_PLATEAU = enum.auto()
    """The contacts of its frame do not show their brightness; the radius leans on that of other frames, or on
    a guess, and its uncertainty says so."""


def flag_names(flags: Iterable[int]) -> list[str]:
    """Flag names joined by ``|`` for each row, as in the CSV files."""
    return ["|".join(str(flag.name) for flag in Flag if flag & int(value)) for value in flags]


@dataclass(frozen=True)
class Schema:
    """Names, dtypes and meaning of a table's columns.

    Parameters
    ----------
    name : str
        File name without extension.
    columns : mapping
        Column name -> (dtype, meaning).
    """

    name: str
    columns: Mapping[str, tuple[str, str]]

    def empty(self) -> pd.DataFrame:
        """A table with every column and no row."""
        return pd.DataFrame({name: pd.Series(dtype=dtype) for name, (dtype, _) in self.columns.items()})

    def conform(self, table: pd.DataFrame | Mapping[str, object]) -> pd.DataFrame:
        """The same rows with exactly this schema's columns, in order; a column not given is empty.

        Raises
        ------
        InputError
            If a column is not in the schema or a value does not fit the column's dtype.
        """
        given = table if isinstance(table, pd.DataFrame) else pd.DataFrame(table)
        unknown = [name for name in given.columns if name not in self.columns]
        if unknown:
            raise InputError(
                f"{self.name}: unknown column {unknown[0]!r}; the columns are {', '.join(self.columns)}"
            )
        return pd.DataFrame(
            {name: self._column(given, name, dtype) for name, (dtype, _) in self.columns.items()},
            index=pd.RangeIndex(len(given)),
        )

    def _column(self, given: pd.DataFrame, name: str, dtype: str) -> ArrayLike | ExtensionArray:
        if name not in given:
            return _empty_cells(len(given), dtype)
        column = given[name]
        try:
            return column.array if column.dtype == dtype else column.astype(dtype).array
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.name}: column {name!r} must hold {dtype} values ({error})") from None


def _empty_cells(count: int, dtype: str) -> ArrayLike | ExtensionArray:
    """A column in which nothing is given."""
    if dtype in ("float64", "int64"):
        return np.full(count, np.nan if dtype == "float64" else 0, dtype)
    if dtype == "Int64":
        return pd.arrays.IntegerArray(np.zeros(count, np.int64), np.ones(count, np.bool_))
    return pd.array([""] * count, dtype=dtype)


CONTACTS = Schema(
    "contacts",
    {
        "frame": ("str", "file name of the frame, or name of the load"),
        "label": ("Int64", "number of the contact in its frame, from 1"),
        "x_px": ("float64", "column of the centre"),
        "y_px": ("float64", "row of the centre"),
        "radius_px": ("float64", "contact radius"),
        "radius_std_px": ("float64", "its standard uncertainty, what all contacts share included"),
        "x_m": ("float64", "sample coordinate of the centre"),
        "y_m": ("float64", "sample coordinate of the centre"),
        "radius_m": ("float64", "contact radius a"),
        "radius_std_m": ("float64", "its standard uncertainty"),
        "area_m2": ("float64", "contact area"),
        "asperity": ("Int64", "row number, from 0, in the asperity table"),
        "force_N": ("float64", "local normal force p"),
        "force_std_N": ("float64", "its standard uncertainty"),
        "flags": ("int64", "sum of Flag members; names joined by | in the CSV"),
        "contrast_shift_px": (
            "float64",
            "change of the radius if the contrast of the frame's contacts is one standard uncertainty higher",
        ),
        "blur_shift_px": (
            "float64",
            "change of the radius if, at that contrast, the blur is one standard uncertainty wider",
        ),
    },
)

REJECTED = Schema(
    "rejected",
    {
        "frame": ("str", "file name of the frame"),
        "x_px": ("float64", "column of the centre"),
        "y_px": ("float64", "row of the centre"),
        "radius_px": ("float64", "radius it would have had"),
        "reason": ("str", "why it is no contact"),
    },
)

FRAMES = Schema(
    "frames",
    {
        "frame": ("str", "file name of the frame, or name of the load"),
        "status": ("str", "ok, or what was wrong"),
        "load_N": ("float64", "applied normal load P"),
        "n_contacts": ("Int64", "number of contacts"),
        "area_m2": ("float64", "real contact area A"),
        "area_std_m2": ("float64", "its standard uncertainty"),
        "force_sum_N": ("float64", "sum of the local forces"),
        "force_sum_std_N": ("float64", "its standard uncertainty"),
        "threshold": ("float64", "threshold used, as a fraction of the contrast"),
        "contrast": ("float64", "plateau minus background, grey levels"),
        "noise": ("float64", "standard deviation of one pixel of the difference, grey levels"),
        "shift_x_px": ("float64", "position in the frame minus position in the reference"),
        "shift_y_px": ("float64", "position in the frame minus position in the reference"),
        "indentation_m": ("float64", "model indentation"),
        "message": ("str", "what a person should know about this frame"),
        "smallest_px": ("float64", "radius of a contact that just stands out; smaller ones are not seen"),
    },
)

LOADS = Schema(
    "loads",
    {
        "frame": ("str", "file name of the frame"),
        "load_N": ("float64", "applied normal load P"),
        "friction_N": ("float64", "friction force Q"),
        "velocity_m_s": ("float64", "sliding velocity"),
    },
)

ASPERITIES = Schema(
    "asperities",
    {
        "x_m": ("float64", "sample coordinate of the summit"),
        "y_m": ("float64", "sample coordinate of the summit"),
        "height_m": ("float64", "height above the base plane"),
        "radius_m": ("float64", "radius of curvature R"),
    },
)

MATCHES = Schema(
    "matches",
    {
        "frame": ("str", "file name of the frame"),
        "measured_label": ("Int64", "label of the measured contact"),
        "asperity": ("Int64", "row number, from 0, in the asperity table"),
        "distance_m": ("float64", "from measured to predicted centre"),
        "radius_measured_m": ("float64", "measured contact radius"),
        "radius_predicted_m": ("float64", "predicted contact radius"),
        "force_measured_N": ("float64", "measured local force"),
        "force_predicted_N": ("float64", "predicted local force"),
    },
)

SCORES = Schema(
    "scores",
    {
        "frame": ("str", "file name of the frame"),
        "model": ("str", "coupled, uncoupled, gw, gt, hertz or measured"),
        "n_measured": ("Int64", "measured contacts"),
        "n_predicted": ("Int64", "predicted contacts"),
        "n_matched": ("Int64", "pairs"),
        "precision": ("float64", "n_matched / n_predicted"),
        "recall": ("float64", "n_matched / n_measured"),
        "f1": ("float64", "harmonic mean of precision and recall"),
        "position_rms_m": ("float64", "RMS distance of the pairs"),
        "radius_rms_m": ("float64", "RMS difference of radius of the pairs"),
    },
)

PROFILE = Schema(
    "profile",
    {
        "frame": ("str", "file name of the frame, or name of the load"),
        "model": ("str", "coupled, uncoupled, gw, gt, hertz, measured or predicted"),
        "r_m": ("float64", "distance from the centre of the apparent contact"),
        "pressure_Pa": ("float64", "contact pressure p"),
        "density_per_m2": ("float64", "contacts per unit area eta"),
        "mean_radius_m": ("float64", "mean contact radius"),
        "area_fraction": ("float64", "contact area per unit area"),
        "pressure_std_Pa": ("float64", "standard uncertainty of the pressure"),
    },
)

NORMALISED = Schema(
    "profile_normalised",
    {
        "frame": ("str", "file name of the frame, or name of the load"),
        "model": ("str", "coupled, uncoupled, gw, gt, hertz, measured or predicted"),
        "load_N": ("float64", "applied normal load P, mean of the places"),
        "hertz_radius_m": ("float64", "contact radius aH of the smooth sphere at this load"),
        "hertz_pressure_Pa": ("float64", "its largest pressure p0"),
        "r_over_hertz_radius": ("float64", "distance from the centre over aH"),
        "pressure_over_hertz": ("float64", "pressure over p0"),
        "pressure_std_over_hertz": ("float64", "its standard uncertainty"),
    },
)

AREA = Schema(
    "area",
    {
        "model": ("str", "coupled, uncoupled, gt, measured or predicted"),
        "load_N": ("float64", "applied normal load P, mean of the frames"),
        "load_std_N": ("float64", "its standard uncertainty"),
        "n_frames": ("Int64", "frames at this load"),
        "n_places": ("Int64", "places they were taken at"),
        "area_m2": ("float64", "real contact area A, mean of the places"),
        "area_std_m2": ("float64", "its standard uncertainty"),
        "area_scatter_m2": ("float64", "standard deviation between places"),
        "n_contacts": ("float64", "contacts in a frame, mean"),
        "mean_radius_m": ("float64", "mean contact radius a"),
        "spacing_over_radius": ("float64", "L/a, mean distance of asperities 1/sqrt(eta0) over a"),
        "radius_ratio_mean": (
            "float64",
            "contact radius over radius of curvature of its asperity, a/R, mean",
        ),
        "radius_ratio_max": ("float64", "largest a/R"),
    },
)

PRESSURE_LAW = Schema(
    "pressure_law",
    {
        "frame": ("str", "file name of the frame, or name of the load"),
        "model": ("str", "coupled, gt, measured or predicted"),
        "load_N": ("float64", "applied normal load P, mean of the places"),
        "r_m": ("float64", "distance of the annulus from the centre"),
        "n_contacts": ("float64", "contacts in it, all places together"),
        "pressure_Pa": ("float64", "contact pressure p"),
        "pressure_std_Pa": ("float64", "its standard uncertainty"),
        "density_per_m2": ("float64", "contacts per unit area eta"),
        "density_std_per_m2": ("float64", "its standard uncertainty"),
        "density_ratio": ("float64", "contacts per asperity, eta/eta0"),
        "density_ratio_std": ("float64", "its standard uncertainty"),
        "mean_radius_m": ("float64", "mean contact radius"),
        "mean_radius_std_m": ("float64", "its standard uncertainty"),
    },
)

FRICTION = Schema(
    "friction",
    {
        "place": ("str", "folder of the run"),
        "frame": ("str", "file name of the frame"),
        "load_N": ("float64", "applied normal load P"),
        "velocity_m_s": ("float64", "sliding velocity"),
        "friction_N": ("float64", "friction force Q"),
        "area_m2": ("float64", "real contact area A"),
        "area_std_m2": ("float64", "its standard uncertainty"),
        "stress_Pa": ("float64", "Q/A"),
    },
)

TOPOGRAPHY = Schema(
    "topography",
    {
        "height_m": ("float64", "height h of an asperity"),
        "radius_m": ("float64", "its radius of curvature R"),
        "height_std_m": ("float64", "standard uncertainty of the height"),
        "radius_std_m": ("float64", "standard uncertainty of the radius"),
    },
)

RESULTS = Schema(
    "results",
    {
        "quantity": ("str", "what was found"),
        "model": (
            "str",
            "measured, predicted (by `predict`), or the model whose contacts were analysed in the same way",
        ),
        "value": ("float64", "its value"),
        "std": ("float64", "its standard uncertainty"),
        "low": ("float64", "lower limit of the confidence interval"),
        "high": ("float64", "upper limit of the confidence interval"),
        "unit": ("str", "unit of the four numbers before"),
        "confidence": ("float64", "probability that the interval holds the truth"),
        "range_low": ("float64", "smallest abscissa that was fitted"),
        "range_high": ("float64", "largest abscissa that was fitted"),
        "range_unit": ("str", "unit of the two numbers before"),
        "n_points": ("Int64", "points that were fitted"),
        "n_places": ("Int64", "places they come from"),
        "note": ("str", "how it is defined, and what a person should know about it"),
    },
)
