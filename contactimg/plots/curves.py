"""Figures of an analysis: area laws, profiles, contact laws, friction, topography."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from contactimg.analysis.broken_power_laws import BrokenLaw
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import ShearStress
from contactimg.analysis.power_laws import PowerLaw
from contactimg.analysis.topography import Topography
from contactimg.plots.axes import new_axes, scale_by_decades
from contactimg.tables import RUN_MODELS

STYLES: dict[str, dict[str, Any]] = {
    "measured": {"color": "black", "marker": "o", "linestyle": "none", "label": "measured"},
    "predicted": {"color": "black", "marker": "s", "linestyle": "none", "label": "predicted"},
    "coupled": {"color": "#d55e00", "linestyle": "--", "label": "coupled asperities"},
    "uncoupled": {"color": "#e69f00", "linestyle": "-.", "label": "uncoupled asperities"},
    "gt": {"color": "#0072b2", "linestyle": "-", "label": "Greenwood-Tripp"},
    "hertz": {"color": "black", "linestyle": ":", "label": "Hertz"},
}
"""Line style of each model; colours of the palette of Okabe and Ito, which colour-blind eyes tell apart."""


def plot_area(frames: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the real contact area (mm^2) against load (mN), with error bars, on logarithmic axes.

    Parameters
    ----------
    frames : DataFrame
        The table of frames; rows without load or area are left out.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    good = frames[(frames["load_N"] > 0) & (frames["area_m2"] > 0)]
    ax.errorbar(
        good["load_N"] * 1e3,
        good["area_m2"] * 1e6,
        yerr=good["area_std_m2"] * 1e6,
        fmt="o",
        color="C0",
        capsize=3,
    )
    ax.set(xlabel="load P (mN)", ylabel="real contact area A (mm²)")
    scale_by_decades(ax)
    return ax


def plot_areas(areas: pd.DataFrame, laws: Mapping[str, PowerLaw], *, ax: Axes | None = None) -> Axes:
    """Plot area against load for runs and models, with the power law fitted to the runs.

    Parameters
    ----------
    areas : DataFrame
        Columns of `contactimg.tables.AREA`.
    laws : mapping
        Model -> law; the legend shows the exponents.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    for model, part in areas[areas["area_m2"] > 0].groupby("model", sort=False):
        style = dict(STYLES[str(model)])
        if model in laws:
            exponent = laws[str(model)].exponent
            style["label"] += f", $m$ = {exponent.value:.3f} ± {exponent.std:.3f}"
        errors: dict[str, Any] = {}
        if model in RUN_MODELS:
            errors = {"xerr": _bars(part["load_std_N"], 1e3), "yerr": _bars(part["area_std_m2"], 1e6)}
        ax.errorbar(part["load_N"] * 1e3, part["area_m2"] * 1e6, capsize=3, **errors, **style)
    for law in (laws[model] for model in RUN_MODELS if model in laws):
        load = np.geomspace(law.low, law.high, 2)
        ax.plot(load * 1e3, law.value(load) * 1e6, color="grey", linewidth=0.8)
    ax.set(xlabel="load P (mN)", ylabel="real contact area A (mm²)")
    scale_by_decades(ax)
    ax.legend(fontsize="small")
    return ax


def _bars(std: pd.Series, unit: float) -> np.ndarray:
    """Lengths of error bars; zero where the uncertainty is not known."""
    return np.nan_to_num(std.to_numpy(float), nan=0.0) * unit


def plot_profile(normalised: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the pressure against the distance from the apex, both relative to a smooth Hertz contact.

    Parameters
    ----------
    normalised : DataFrame
        Columns of `contactimg.tables.NORMALISED`, of one load.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    for model, part in normalised.groupby("model", sort=False):
        known = part[part["pressure_over_hertz"].notna()]
        r = known["r_over_hertz_radius"].to_numpy()
        p = known["pressure_over_hertz"].to_numpy()
        if model == "hertz":
            r = np.linspace(0.0, 1.0, 200)
            p = np.sqrt(1 - r**2)
        if len(r) == 0:
            continue
        bars: dict[str, Any] = (
            {"yerr": _bars(known["pressure_std_over_hertz"], 1.0)} if model in RUN_MODELS else {}
        )
        ax.errorbar(r, p, capsize=3, **bars, **STYLES[str(model)])
    load = normalised["load_N"].iloc[0] if len(normalised) else np.nan
    ax.set(
        xlabel="distance from the apex over Hertz radius, $r/a_H$",
        ylabel="pressure over largest Hertz pressure, $p/p_0$",
        title=f"load P = {load * 1e3:.4g} mN",
        xlim=(0, None),
        ylim=(0, None),
    )
    ax.legend(fontsize="small")
    return ax


def plot_pressure_law(
    points: pd.DataFrame, laws: Mapping[tuple[str, str], BrokenLaw], quantity: str, *, ax: Axes | None = None
) -> Axes:
    """Plot the density or the mean radius of the contacts against the local pressure.

    Parameters
    ----------
    points : DataFrame
        Columns of `contactimg.tables.PRESSURE_LAW`.
    laws : mapping
        (Quantity, model) -> law; two power laws are drawn if the data support a break, else one.
    quantity : {"density", "mean_radius"}
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    column, std, unit, label = _pressure_axis(points, quantity)
    for model, part in points.groupby("model", sort=False):
        style = {"marker": "x"} | STYLES[str(model)] | {"linestyle": "none"}
        errors = _bars(part[std], unit)
        ax.errorbar(part["pressure_Pa"], part[column] * unit, yerr=errors, markersize=4, **style)
        law = laws.get((quantity, str(model)))
        if law is not None:
            p = np.geomspace(law.low, law.high, 100)
            values = law.value(p) if law.supported else law.single.value(p)
            ax.plot(p, values * unit, color=style["color"], linewidth=1, label=_law_text(law))
    ax.set(xlabel="local pressure p (Pa)", ylabel=label)
    scale_by_decades(ax)
    ax.legend(fontsize="small")
    return ax


def _pressure_axis(points: pd.DataFrame, quantity: str) -> tuple[str, str, float, str]:
    """Columns of a quantity and its uncertainty, the factor to its unit, and the axis label."""
    if quantity == "mean_radius":
        return "mean_radius_m", "mean_radius_std_m", 1e6, "mean contact radius (µm)"
    density = 1 / (points["density_ratio"] / points["density_per_m2"]).median()
    if np.isfinite(density):
        return "density_per_m2", "density_std_per_m2", 1 / density, "contacts per asperity, $\\eta/\\eta_0$"
    return "density_per_m2", "density_std_per_m2", 1e-6, "contacts per mm²"


def _law_text(law: BrokenLaw) -> str:
    """The exponents, for the legend."""
    if not law.supported:
        return f"$p^{{{law.single.exponent.value:.3f} ± {law.single.exponent.std:.3f}}}$"
    low, high = law.low_exponent.value, law.high_exponent.value
    return f"$p^{{{low:.2f}}}$, $p^{{{high:.2f}}}$, $p^*$ = {law.break_x.value:.3g} Pa"


def plot_friction(
    friction: pd.DataFrame, stress: ShearStress, smooth: Estimate | None, *, ax: Axes | None = None
) -> Axes:
    """Plot the friction force against the load, with ``tau0 A`` of the fit and of the smooth contact.

    Parameters
    ----------
    friction : DataFrame
        Columns of `contactimg.tables.FRICTION`.
    stress : ShearStress
    smooth : Estimate or None, Pa
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    table = friction.sort_values("load_N")
    load, area = table["load_N"] * 1e3, table["area_m2"]
    ax.plot(load, table["friction_N"].abs() * 1e3, "o", color="black", label="measured")
    label = f"$\\tau_0 A$, $\\tau_0$ = {stress.stress.value / 1e6:.3f} ± {stress.stress.std / 1e6:.3f} MPa"
    ax.plot(load, stress.stress.value * area * 1e3, "-", color="black", label=label)
    if smooth is not None:
        label = f"smooth contact, {smooth.value / 1e6:.3f} MPa"
        ax.plot(load, smooth.value * area * 1e3, "--", color="black", label=label)
    ax.set(xlabel="load P (mN)", ylabel="friction force Q (mN)", xlim=(0, None), ylim=(0, None))
    ax.legend(fontsize="small")
    return ax


def plot_topography(table: pd.DataFrame, topography: Topography, *, ax: Axes | None = None) -> Axes:
    """Plot the height of asperities against their radius, with the line of the contact angle if there is one.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.TOPOGRAPHY`.
    topography : Topography
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    ax.errorbar(
        table["radius_m"] * 1e6,
        table["height_m"] * 1e6,
        xerr=_bars(table["radius_std_m"], 1e6),
        yerr=_bars(table["height_std_m"], 1e6),
        fmt="o",
        markersize=4,
        color="black",
    )
    if topography.one_angle:
        radius = np.array([0.0, table["radius_m"].max()])
        angle = np.degrees([topography.contact_angle.value, topography.contact_angle.std])
        label = f"$\\theta$ = {angle[0]:.1f} ± {angle[1]:.1f}°"
        ax.plot(radius * 1e6, topography.slope.value * radius * 1e6, color="tab:red", label=label)
        ax.legend()
    ax.set(xlabel="radius of curvature R (µm)", ylabel="height h (µm)", xlim=(0, None), ylim=(0, None))
    return ax
