"""Schemas of the tables that `contactimg calibrate` writes."""

from contactimg.tables.schemas import FRAME, LOAD, MESSAGE, Schema

CIRCLES = Schema(
    "circles",
    {
        "frame": FRAME,
        "status": ("str", "ok, or what is wrong with the frame: one of the documented statuses"),
        "load_N": LOAD,
        "x_px": ("float64", "column of the centre of the contact, px"),
        "y_px": ("float64", "row of the centre of the contact, px"),
        "centre_std_px": ("float64", "standard uncertainty of x_px and of y_px, px"),
        "radius_px": ("float64", "contact radius, px"),
        "radius_m": ("float64", "contact radius a, m"),
        "radius_std_m": ("float64", "standard uncertainty of radius_m, m"),
        "shift_x_px": ("float64", "position in the frame minus position in the reference along x, px"),
        "shift_y_px": ("float64", "position in the frame minus position in the reference along y, px"),
        "axis_ratio": ("float64", "larger over smaller axis of the contact; empty if the arc is short"),
        "axis_ratio_std": ("float64", "standard uncertainty of axis_ratio"),
        "angle_rad": ("float64", "angle of the larger axis, from +x towards +y, -pi/2 to pi/2, rad"),
        "contrast": ("float64", "contact minus background, grey levels"),
        "blur_px": ("float64", "standard deviation of the optical blur, px"),
        "arc": ("float64", "fraction of the circumference that was used"),
        "misfit": ("float64", "root mean square residual over the standard deviation of the noise"),
        "branch": ("str", "loading or unloading, where the order of the loads tells; else empty"),
        "fitted_N": ("float64", "load at which the fitted law gives this radius, N"),
        "residual_N": ("float64", "load_N minus fitted_N, N"),
        "used": ("Int64", "1 if the frame takes part in the fit, 0 if not"),
        "message": MESSAGE,
    },
    "Contact circles of a smooth sphere from `calibrate jkr`, one row per frame.",
)

UNCERTAINTIES = Schema(
    "uncertainties",
    {
        "source": ("str", "what may be off"),
        "size": ("float64", "its standard uncertainty, or the error that is assumed, in `unit`"),
        "unit": ("str", "unit of size"),
        "young_modulus": ("float64", "relative change of Young's modulus by it"),
        "work_of_adhesion": ("float64", "relative change of the work of adhesion by it"),
        "state": ("str", "allowed for or fitted (both in the stated uncertainties), or not included"),
    },
    "What each source of error does to the result of `calibrate jkr`, one row per source.",
)

THRESHOLD_CURVE = Schema(
    "curve",
    {
        "threshold": ("float64", "threshold as a fraction of the contact contrast"),
        "slope": ("float64", "slope of force sum against load, least squares through the origin"),
        "slope_std": ("float64", "standard uncertainty of slope"),
        "area_m2": ("float64", "contact area summed over all frames, m^2"),
        "fall_rate": ("float64", "-d ln A/d threshold: relative decrease of the area per unit of threshold"),
    },
    "What the measurement gives at each threshold, from `calibrate threshold` and `calibrate plateau`.",
)

FORCE_SUMS = Schema(
    "forces",
    {
        "frame": FRAME,
        "load_N": LOAD,
        "area_m2": ("float64", "contact area at the calibrated threshold, m^2"),
        "area_std_m2": ("float64", "half the difference of the areas at the two ends of the plateau, m^2"),
        "force_sum_N": ("float64", "sum of the local forces at the calibrated threshold, N"),
        "message": MESSAGE,
    },
    "Area and force sum of each frame at the calibrated threshold (forces.csv, areas.csv).",
)
