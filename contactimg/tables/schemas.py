"""Schemas: every table that contactimg reads or writes, with the dtype, meaning and unit of each column."""

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pandas.api.extensions import ExtensionArray
from pandas.api.types import pandas_dtype

from contactimg.errors import InputError

# With pyarrow installed pandas would keep text as Arrow strings, which cannot hold file names that are not
# UTF-8; tables must not depend on what else is installed.
pd.set_option("mode.string_storage", "python")

Column = tuple[str, str]
"""Of a column: its dtype, and its meaning with the unit."""

RUN_MODELS = ("measured", "predicted")
"""Names that an analysis gives to the contacts of a run itself: those of `process` and those of `predict`."""
EMPTY_CELLS = {"float64": np.nan, "int64": 0, "Int64": pd.NA, "bool": False, "str": ""}
"""What stands in the cells of a column that is not given, for each dtype."""
VARIANTS = ("_excess_scatter", "_p_value")
"""Endings of quantities of `RESULTS` that are other intervals of a result, or judge it; not printed."""


class Schema:
    """Names, dtypes and meaning of a table's columns.

    Parameters
    ----------
    name : str
        File name without extension.
    description : str
        One sentence: what the table holds and what a row is.
    **first : (str, str)
        Columns that every version has written: each its dtype and its meaning with the unit.

    Notes
    -----
    A new column takes an entry here and the place that computes it: whatever reads, writes, checks or
    documents tables follows the schema.
    """

    def __init__(self, name: str, description: str, /, **first: Column) -> None:
        self.name, self.description, self.first = name, description, first
        self.later: dict[str, Column] = {}

    def and_later(self, **later: Column) -> "Schema":
        """The schema with these columns as what later versions added: a file of a run need not have them."""
        schema = Schema(self.name, self.description, **self.first)
        schema.later = later
        return schema

    @cached_property
    def columns(self) -> dict[str, Column]:
        """All columns in the order of the table."""
        return {**self.first, **self.later}

    def filled(self, table: pd.DataFrame) -> "Schema":
        """The schema without those later columns in which a table has nothing."""
        later = {name: self.later[name] for name in self.later if name in table and table[name].notna().any()}
        return self.and_later(**later)

    def empty(self) -> pd.DataFrame:
        """A table with every column and no row."""
        return self._without_rows.copy()

    @cached_property
    def _without_rows(self) -> pd.DataFrame:
        return self._assembled(pd.DataFrame())

    @cached_property
    def _dtypes(self) -> list[object]:
        return [pandas_dtype(dtype) for dtype, _ in self.columns.values()]

    def conform(self, table: pd.DataFrame | Mapping[str, object]) -> pd.DataFrame:
        """Give the rows exactly the columns of this schema, in order; a column not given is empty.

        Raises
        ------
        InputError
            If a column is not in the schema or a value does not fit the column's dtype.
        """
        given = table if isinstance(table, pd.DataFrame) else pd.DataFrame(table)
        unknown = [name for name in given.columns if name not in self.columns]
        if unknown:
            known = ", ".join(self.columns)
            raise InputError(f"{self.name}: unknown column {unknown[0]!r}; the columns are {known}")
        if list(given.columns) == list(self.columns) and list(given.dtypes) == self._dtypes:
            whole = given.reset_index(drop=True)  # several times as fast as to assemble the columns anew
            whole.attrs = {}
            return whole
        return self._assembled(given)

    def joined(self, tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
        """Tables of this schema as one; those without rows are left out, so that they change no dtypes."""
        return self.conform(pd.concat([table for table in tables if len(table)] or [self.empty()]))

    def _assembled(self, given: pd.DataFrame) -> pd.DataFrame:
        return pd.DataFrame(
            {name: self._column(given, name, dtype) for name, (dtype, _) in self.columns.items()},
            index=pd.RangeIndex(len(given)),
        )

    def _column(self, given: pd.DataFrame, name: str, dtype: str) -> ArrayLike | ExtensionArray:
        if name not in given:
            return pd.Series(EMPTY_CELLS[dtype], given.index, pandas_dtype(dtype)).array
        column = given[name]
        try:
            return column.array if column.dtype == dtype else column.astype(pandas_dtype(dtype)).array
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.name}: column {name!r} must hold {dtype} values ({error})") from None


FRAME = ("str", "file name of the frame with its extension; page k of a stack is name[k]")
FRAME_OR_LOAD = ("str", "file name of the frame, or for a prediction the name of the load")
LOAD = ("float64", "applied normal load P, N; positive in compression")
MODEL = ("str", "whose contacts: measured, predicted (by predict), coupled, uncoupled, gw, gt or hertz")
MESSAGE = ("str", "remarks about this row in plain words; empty if there are none")

CONTACTS = Schema(
    "contacts",
    "One row per contact that was measured on a frame or predicted at a load.",
    frame=FRAME_OR_LOAD,
    label=("Int64", "number of the contact in its frame, from 1"),
    x_px=("float64", "column of the centre, px; 0 is the centre of the leftmost pixel"),
    y_px=("float64", "row of the centre, px, downwards; 0 is the centre of the top pixel"),
    radius_px=("float64", "contact radius, px"),
    radius_std_px=("float64", "standard uncertainty of radius_px, px, including what contacts share"),
    x_m=("float64", "sample coordinate x of the centre, m"),
    y_m=("float64", "sample coordinate y of the centre, m"),
    radius_m=("float64", "contact radius a, m"),
    radius_std_m=("float64", "standard uncertainty of radius_m, m"),
    area_m2=("float64", "contact area, m^2; of a contact that the border cuts, all of it"),
    asperity=("Int64", "row number of its asperity in the asperity table, from 0; empty if unmatched"),
    force_N=("float64", "local normal force p, N; negative where adhesion outweighs the pressure"),
    force_std_N=("float64", "standard uncertainty of force_N, N"),
    flags=("int64", "quality flags: sum of Flag members; in CSV files their names joined by |"),
    contrast_shift_px=("float64", "change of radius_px, px, by one std of the contrast"),
    blur_shift_px=("float64", "change of radius_px, px, by one std of the blur at the same contrast"),
).and_later(
    edge_shift_px=("float64", "change of radius_px, px, by one std of the edges"),
    force_hertz_N=("float64", "local force by Hertz's formula K a^3/R, whatever force_N follows, N"),
    shape=("str", "disk, ellipse or free: what describes its pixels; empty where it was not asked"),
    area_px2=("float64", "contact area, px^2: pi radius_px^2, whatever the shape"),
    area_std_px2=("float64", "standard uncertainty of area_px2, px^2, including what contacts share"),
    visible_area_px2=("float64", "part of area_px2 inside the image and up to the chord with others, px^2"),
    visible_area_m2=("float64", "part of area_m2 inside the image and up to the chord with others, m^2"),
    semi_major_px=("float64", "major half-axis, px; of a free shape by its second moments"),
    semi_minor_px=("float64", "minor half-axis, px"),
    angle_rad=("float64", "angle of the major axis in the image, from +x towards +y, rad"),
    semi_major_m=("float64", "major half-axis, m"),
    semi_minor_m=("float64", "minor half-axis, m"),
    semi_major_std_px=("float64", "standard uncertainty of semi_major_px, px; ellipses only"),
    semi_minor_std_px=("float64", "standard uncertainty of semi_minor_px, px; ellipses only"),
    angle_std_rad=("float64", "standard uncertainty of angle_rad, rad; ellipses only"),
    perimeter_px=("float64", "perimeter of the fitted disk or ellipse, px; empty where pixels were counted"),
)

SHARED_SHIFTS = ("contrast_shift_px", "blur_shift_px", "edge_shift_px")
"""Columns of the errors of radii that all contacts of a frame share, so that they add up in sums."""

OUTLINES = Schema(
    "outlines",
    "Outlines at half height of the contacts of free shape, one row per point; only where there are any.",
    frame=FRAME,
    label=("Int64", "label of the contact in its frame"),
    outline=("Int64", "number of the outline in its contact: 0 outside, from 1 for holes"),
    point=("Int64", "number of the point along the outline, from 0; the last is the first again"),
    x_px=("float64", "column of the point, px"),
    y_px=("float64", "row of the point, px"),
)

REJECTED = Schema(
    "rejected",
    "One row per candidate that was rejected.",
    frame=FRAME,
    x_px=("float64", "column of the centre, px"),
    y_px=("float64", "row of the centre, px"),
    radius_px=("float64", "radius that the candidate would have had, px"),
    reason=("str", "why the candidate is not a contact, one of Reason"),
)

FRAMES = Schema(
    "frames",
    "One row per frame or load, in order.",
    frame=FRAME_OR_LOAD,
    status=("str", "ok, or what is wrong with the frame: one of the documented statuses"),
    load_N=LOAD,
    n_contacts=("Int64", "number of contacts; empty if nothing could be measured"),
    area_m2=("float64", "real contact area A, m^2: sum over the contacts of what the image shows"),
    area_std_m2=("float64", "standard uncertainty of area_m2, m^2"),
    force_sum_N=("float64", "sum of the local forces, N"),
    force_sum_std_N=("float64", "standard uncertainty of force_sum_N, N"),
    threshold=("float64", "threshold used, as a fraction of the contrast"),
    contrast=("float64", "plateau of the contacts minus background, grey levels"),
    noise=("float64", "standard deviation of the noise in one pixel of the difference, grey levels"),
    shift_x_px=("float64", "position in the frame minus position in the reference along x, px"),
    shift_y_px=("float64", "position in the frame minus position in the reference along y, px"),
    indentation_m=("float64", "indentation from first touch in the model, m; empty if measured"),
    message=MESSAGE,
    smallest_px=("float64", "the same as detection_limit_px, px"),
).and_later(
    detection_limit_px=("float64", "radius of which half of the contacts are detected, px"),
    unseen_area_m2=("float64", "area of contacts too small to be detected, m^2; not in area_m2"),
    unseen_area_std_m2=("float64", "standard uncertainty of unseen_area_m2, m^2"),
    unseen_force_N=("float64", "estimated force on them, N; not in force_sum_N"),
    unseen_force_std_N=("float64", "standard uncertainty of unseen_force_N, N"),
    force_hertz_sum_N=("float64", "sum of the local forces by Hertz's formula, N"),
    law=("str", "law of the local forces: hertz or sphere, +jkr where contacts adhere"),
    blur_px=("float64", "standard deviation of the optical blur, px; empty where none was fitted"),
    min_gap_m=("float64", "smallest gap of lens and rubber between the caps, m; touching below 0"),
)

LOADS = Schema(
    "loads",
    "Loads of the frames, given by the experimenter or written by simulate.",
    frame=FRAME,
    load_N=LOAD,
    friction_N=("float64", "friction force Q, N"),
    velocity_m_s=("float64", "sliding velocity, m/s"),
).and_later(
    tangential_N=("float64", "tangential load Q of a contact that does not slide, N"),
    time_s=("float64", "time of the frame, s"),
)

EDITS = Schema(
    "edits",
    "Corrections by hand, applied in order; one row per correction.",
    frame=("str", "file name of the frame as in contacts.csv, or * for all frames"),
    action=("str", "what is done: exclude, add, split, merge or mask"),
    x_px=("float64", "column of the contact that is meant, or of the centre of the masked disk, px"),
    y_px=("float64", "row of the same, px"),
    radius_px=("float64", "radius of the contact to add, or of the masked disk, px"),
    points=("str", "x y;x y;... px: centres of the parts, contacts to merge, or corners of the mask"),
    author=("str", "who made the edit"),
    time=("str", "when it was made"),
    reason=("str", "why it was made"),
)

MATCHES = Schema(
    "matches",
    "One row per pair of a measured contact and one predicted by the coupled model.",
    frame=FRAME,
    measured_label=("Int64", "label of the measured contact"),
    asperity=("Int64", "row number of the asperity in the asperity table, from 0"),
    distance_m=("float64", "distance between the measured and the predicted centre, m"),
    radius_measured_m=("float64", "measured contact radius, m"),
    radius_predicted_m=("float64", "predicted contact radius, m"),
    force_measured_N=("float64", "measured local force, N"),
    force_predicted_N=("float64", "predicted local force, N"),
)

SCORES = Schema(
    "scores",
    "How well a model predicts the contacts of a frame, one row per frame and model.",
    frame=FRAME,
    model=MODEL,
    n_measured=("Int64", "number of measured contacts that count"),
    n_predicted=("Int64", "number of predicted contacts that count"),
    n_matched=("Int64", "number of pairs"),
    precision=("float64", "n_matched / n_predicted"),
    recall=("float64", "n_matched / n_measured"),
    f1=("float64", "harmonic mean of precision and recall"),
    position_rms_m=("float64", "RMS distance between the centres of the pairs, m"),
    radius_rms_m=("float64", "RMS difference between the radii of the pairs, m"),
)

PROFILE = Schema(
    "profile",
    "Radial profiles: one row per annulus, frame and model.",
    frame=FRAME_OR_LOAD,
    model=MODEL,
    r_m=("float64", "distance of the annulus from the centre of the apparent contact, m"),
    pressure_Pa=("float64", "contact pressure p averaged over the annulus, Pa"),
    density_per_m2=("float64", "number of contacts per unit area eta, 1/m^2"),
    mean_radius_m=("float64", "mean contact radius, m"),
    area_fraction=("float64", "real contact area per unit of apparent area"),
    pressure_std_Pa=("float64", "standard uncertainty of pressure_Pa, Pa"),
    pressure_low_Pa=("float64", "lower end of the 95 % interval of pressure_Pa, Pa"),
    pressure_high_Pa=("float64", "upper end; of an annulus without contacts its upper limit, Pa"),
)

NORMALISED = Schema(
    "profile_normalised",
    "Pressure profiles divided by Hertz's radius and maximum pressure.",
    frame=FRAME_OR_LOAD,
    model=MODEL,
    load_N=("float64", "applied normal load P, N, averaged over the places"),
    hertz_radius_m=("float64", "Hertz contact radius a_H of the smooth sphere at this load, m"),
    hertz_pressure_Pa=("float64", "maximum Hertz pressure p_0 of the smooth sphere, Pa"),
    r_over_hertz_radius=("float64", "distance from the centre over a_H"),
    pressure_over_hertz=("float64", "pressure over p_0"),
    pressure_std_over_hertz=("float64", "standard uncertainty of pressure_over_hertz"),
    pressure_low_over_hertz=("float64", "lower end of the 95 % interval of pressure_over_hertz"),
    pressure_high_over_hertz=("float64", "upper end of the 95 % interval of pressure_over_hertz"),
)

AREA = Schema(
    "area",
    "Real contact area against load, one row per load and model.",
    model=MODEL,
    load_N=("float64", "applied normal load P, N, averaged over the frames"),
    load_std_N=("float64", "standard uncertainty of load_N, N"),
    n_frames=("Int64", "number of frames at this load"),
    n_places=("Int64", "number of places where they were taken"),
    area_m2=("float64", "real contact area A, m^2, averaged over the places"),
    area_std_m2=("float64", "standard uncertainty of area_m2, m^2"),
    area_scatter_m2=("float64", "standard deviation of A between places, m^2"),
    n_contacts=("float64", "mean number of contacts per frame"),
    mean_radius_m=("float64", "mean contact radius a, m"),
    spacing_over_radius=("float64", "L/a: mean spacing of the asperities 1/sqrt(eta_0) over a"),
    radius_ratio_mean=("float64", "mean of a/R, contact radius over asperity radius"),
    radius_ratio_max=("float64", "largest a/R"),
)

PRESSURE_LAW = Schema(
    "pressure_law",
    "Contact density and mean contact radius against local pressure, one row per annulus.",
    frame=FRAME_OR_LOAD,
    model=MODEL,
    load_N=("float64", "applied normal load P, N, averaged over the places"),
    r_m=("float64", "distance of the annulus from the centre, m"),
    n_contacts=("float64", "number of contacts in the annulus, all places together"),
    pressure_Pa=("float64", "local contact pressure p, Pa"),
    pressure_std_Pa=("float64", "standard uncertainty of pressure_Pa, Pa"),
    density_per_m2=("float64", "number of contacts per unit area eta, 1/m^2"),
    density_std_per_m2=("float64", "standard uncertainty of density_per_m2, 1/m^2"),
    density_ratio=("float64", "eta/eta_0: contacts per asperity"),
    density_ratio_std=("float64", "standard uncertainty of density_ratio"),
    mean_radius_m=("float64", "mean contact radius, m"),
    mean_radius_std_m=("float64", "standard uncertainty of mean_radius_m, m"),
)

FRICTION = Schema(
    "friction",
    "Friction force and real contact area, one row per frame.",
    place=("str", "folder of the run"),
    frame=FRAME,
    load_N=LOAD,
    **{name: LOADS.first[name] for name in ("velocity_m_s", "friction_N")},
    area_m2=("float64", "real contact area A, m^2"),
    area_std_m2=("float64", "standard uncertainty of area_m2, m^2"),
    stress_Pa=("float64", "mean shear stress |Q|/A, Pa"),
)

FOLLOWED = Schema(
    "asperities",
    "Each asperity that touches in some frame, in each measured frame; from `analyse`.",
    asperity=("Int64", "row number of the asperity in the asperity table, from 0"),
    frame=FRAME,
    load_N=LOAD,
    **LOADS.later,
    x_m=("float64", "sample coordinate x of the contact, or of where it would be, m"),
    y_m=("float64", "sample coordinate y of the same, m"),
    radius_m=("float64", "contact radius a, m; empty where it does not touch"),
    radius_std_m=("float64", "standard uncertainty of radius_m, m"),
    **{name: CONTACTS.later[name] for name in ("semi_major_m", "semi_minor_m", "angle_rad")},
    area_m2=("float64", "contact area, m^2"),
    force_N=("float64", "local normal force p, N"),
    displacement_x_m=("float64", "x_m minus that in the first frame in which it touches, m"),
    displacement_y_m=("float64", "y_m minus that in the first frame in which it touches, m"),
    touches=("bool", "whether a contact was measured on it"),
    radius_upper_m=("float64", "where none was: 95 % upper limit of its radius, m"),
).and_later(place=("str", "folder of the run; only where several are analysed together"))

RESULTS = Schema(
    "results",
    "Numbers of an analysis, one row each.",
    quantity=("str", "name of the number"),
    model=MODEL,
    value=("float64", "value of the quantity, in `unit`"),
    std=("float64", "standard uncertainty of the value, in `unit`"),
    low=("float64", "lower limit of the confidence interval, in `unit`"),
    high=("float64", "upper limit of the confidence interval, in `unit`"),
    unit=("str", "unit of value, std, low and high"),
    confidence=("float64", "confidence level of the interval"),
    range_low=("float64", "smallest fitted abscissa, in `range_unit`"),
    range_high=("float64", "largest fitted abscissa, in `range_unit`"),
    range_unit=("str", "unit of range_low and range_high"),
    n_points=("Int64", "number of fitted points"),
    n_places=("Int64", "number of places they come from"),
    note=("str", "definition of the quantity and remarks"),
)

EFFECTS = Schema(
    "effects",
    "Which effects a scene calls for, one row per effect.",
    load_N=("float64", "load that the plan is for, N"),
    effect=("str", "name of the effect, as in [effects]"),
    change=("float64", "largest relative change of the requested outputs if the effect is left out"),
    tolerance=("float64", "limit on the sum of the changes of all effects that are left out"),
    decision=("str", "on, off, or not modelled"),
    switch=("str", "switch of the effect in the scene: auto, on or off"),
    reason=("str", "the numbers behind the decision"),
    change_area=("float64", "change of the total contact area; empty where not estimated"),
    change_force=("float64", "change of the local forces, sum |dp|/sum |p|"),
    change_radius=("float64", "change of the contact radii, root mean square over that of the radii"),
    change_hertz=("float64", "change of the forces by Hertz's formula, sum |dp|/sum p"),
    change_contacts=("float64", "contacts that form or vanish, over their number"),
    change_profile=("float64", "change of p(r) over its maximum, or of the counts of eta(r)"),
    change_indentation=("float64", "change of the indentation"),
)

TRADEOFF = Schema(
    "tradeoff",
    "Computing time and accuracy of every setting, one row each.",
    knob=("str", "name of the choice whose settings are compared"),
    setting=("str", "one setting of the choice"),
    error=("float64", "relative error of the output against the reference"),
    time_s=("float64", "computing time, s: the best of several runs taken in turn"),
    time_ratio=("float64", "time over that of the cheapest setting of the same choice"),
    pareto=("Int64", "1 if no other setting is both faster and more accurate; empty if not run here"),
    output=("str", "quantity whose error is given: area, force or radius"),
    reference=("str", "the converged answer that the error is measured against"),
    load_N=("float64", "applied normal load P, N; empty if no load enters"),
    message=("str", "why there is no number, or a remark about it"),
)

DRAWN = Schema(
    "drawn",
    "Contacts of known radius drawn into the frames, one row each.",
    frame=FRAME,
    x_px=("float64", "column of the centre of the drawn contact, px"),
    y_px=("float64", "row of the centre of the drawn contact, px"),
    radius_px=("float64", "true radius of the drawn contact, px"),
    contrast=("float64", "its contrast, grey levels"),
    found=("Int64", "1 if it was found, else 0"),
    measured_px=("float64", "measured radius, px; empty if it was not found"),
    measured_std_px=("float64", "stated standard uncertainty of measured_px, px"),
)

CHECK = Schema(
    "check",
    "What became of the drawn contacts, one row a class of radii.",
    low_px=("float64", "smallest true radius of the class, px"),
    high_px=("float64", "largest true radius of the class, px"),
    radius_px=("float64", "middle of the class, px"),
    drawn=("Int64", "number of contacts drawn"),
    found=("Int64", "number of them that were found"),
    completeness=("float64", "found over drawn"),
    bias_px=("float64", "mean of measured minus true radius, px"),
    rms_px=("float64", "root mean square of measured minus true radius, px"),
    within_1_std=("float64", "share whose error is below one stated standard uncertainty"),
    within_2_std=("float64", "share whose error is below two"),
)

ASPERITIES = Schema(
    "asperities",
    "One row per asperity, a spherical cap.",
    x_m=("float64", "sample coordinate x of the summit, m"),
    y_m=("float64", "sample coordinate y of the summit, m"),
    height_m=("float64", "height of the summit above the base plane, m"),
    radius_m=("float64", "radius of curvature R of the summit, m"),
)

SUMMITS = Schema(
    "asperities",
    "Summits of a height map from `asperities`, one row each; read wherever asperities are.",
    **ASPERITIES.first,
    height_std_m=("float64", "standard uncertainty of height_m, m"),
    radius_std_m=("float64", "standard uncertainty of radius_m, m"),
    x_std_m=("float64", "standard uncertainty of x_m, m"),
    y_std_m=("float64", "standard uncertainty of y_m, m"),
    residual_m=("float64", "standard deviation of the heights about the fitted sphere, m"),
    pixels=("Int64", "number of pixels that were fitted"),
    message=MESSAGE,
)

TOPOGRAPHY = Schema(
    "topography",
    "Measured heights and radii of asperities, one row each.",
    **{name: SUMMITS.first[name] for name in ("height_m", "radius_m", "height_std_m", "radius_std_m")},
)

CIRCLES = Schema(
    "circles",
    "Contact circles of a smooth sphere from `calibrate jkr`, one row per frame.",
    frame=FRAME,
    **{name: FRAMES.first[name] for name in ("status", "load_N")},
    x_px=("float64", "column of the centre of the contact, px"),
    y_px=("float64", "row of the centre of the contact, px"),
    centre_std_px=("float64", "standard uncertainty of x_px and of y_px, px"),
    **{name: CONTACTS.first[name] for name in ("radius_px", "radius_m", "radius_std_m")},
    **{name: FRAMES.first[name] for name in ("shift_x_px", "shift_y_px")},
    axis_ratio=("float64", "larger over smaller axis of the contact; empty if the arc is short"),
    axis_ratio_std=("float64", "standard uncertainty of axis_ratio"),
    angle_rad=("float64", "angle of the larger axis, from +x towards +y, -pi/2 to pi/2, rad"),
    contrast=("float64", "contact minus background, grey levels"),
    blur_px=("float64", "standard deviation of the optical blur, px"),
    arc=("float64", "fraction of the circumference that was used"),
    misfit=("float64", "root mean square residual over the standard deviation of the noise"),
    branch=("str", "loading or unloading, where the order of the loads tells; else empty"),
    fitted_N=("float64", "load at which the fitted law gives this radius, N"),
    residual_N=("float64", "load_N minus fitted_N, N"),
    used=("Int64", "1 if the frame takes part in the fit, 0 if not"),
    message=MESSAGE,
)

THRESHOLD_CURVE = Schema(
    "curve",
    "What the measurement gives at each threshold, from `calibrate threshold` and `calibrate plateau`.",
    threshold=("float64", "threshold as a fraction of the contact contrast"),
    slope=("float64", "slope of force sum against load, least squares through the origin"),
    slope_std=("float64", "standard uncertainty of slope"),
    area_m2=("float64", "contact area summed over all frames, m^2"),
    fall_rate=("float64", "-d ln A/d threshold: relative decrease of the area per unit of threshold"),
)

FORCE_SUMS = Schema(
    "forces",
    "Area and force sum of each frame at the calibrated threshold (forces.csv, areas.csv).",
    frame=FRAME,
    load_N=LOAD,
    area_m2=("float64", "contact area at the calibrated threshold, m^2"),
    area_std_m2=("float64", "half the difference of the areas at the two ends of the plateau, m^2"),
    force_sum_N=("float64", "sum of the local forces at the calibrated threshold, N"),
    message=MESSAGE,
)

WANTED_LAW = Schema(
    "wanted",
    "A wanted law for `design`, one row per load; straight lines lie between the rows.",
    load_N=LOAD,
    area_m2=("float64", "wanted real contact area A at this load, m^2"),
    friction_N=("float64", "instead of the area: wanted friction force, N"),
)

DESIGNED = Schema(
    "law",
    "The wanted law and the laws of the surface that `design` found, one row per load.",
    load_N=LOAD,
    wanted_area_m2=("float64", "real contact area of the wanted law, m^2"),
    independent_area_m2=("float64", "area of the design for independent contacts, if they were so, m^2"),
    uncorrected_area_m2=("float64", "area of that design with contacts that displace each other, m^2"),
    coupled_area_m2=("float64", "area of the designed surface, contacts displacing each other, m^2"),
    coupled_std_m2=("float64", "root mean square change of coupled_area_m2 by errors of heights, m^2"),
    n_contacts=("Int64", "number of contacts of the designed surface"),
)
