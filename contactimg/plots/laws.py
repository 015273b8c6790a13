"""Figures of laws with the fit's residuals under them: area against load, friction against area."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import ShearStress
from contactimg.analysis.power_laws import PowerLaw
from contactimg.plots.axes import add_legend, axes_with_panel, bar_lengths, new_axes, scale_by_decades
from contactimg.plots.numbers import number_with_interval, number_with_std
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

MARKER_SIZE = 4.5
"""Size of the marks of measured points, pt."""

LINE_POINTS = 100
"""Points of a drawn law."""

MOTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("sliding", {"marker": "o", "color": "black"}),
    ("static", {"marker": "s", "color": "#d55e00", "markerfacecolor": "none"}),
    ("friction", {"marker": "D", "color": "black"}),
)
"""Marks of frames that slide, that are at rest, and whose velocity is not known."""


def plot_area(
    frames: pd.DataFrame, law: PowerLaw | None = None, *, model: str = "measured", ax: Axes | None = None
) -> Axes:
    """Plot the real contact area (mm^2) of each frame against load (mN) on logarithmic axes.

    Parameters
    ----------
    frames : DataFrame
        The table of frames; rows without load or area are left out.
    law : PowerLaw, optional
        Drawn as a line, with the differences from it in a panel below.
    model : {"measured", "predicted"}
        What the legend calls the frames.
    ax : Axes, optional
        By default new axes; only these have the panel.

    Returns
    -------
    Axes
    """
    good = frames[(frames["load_N"] > 0) & (frames["area_m2"] > 0)]
    table = good[["load_N", "area_m2", "area_std_m2"]].assign(model=model, load_std_N=np.nan)
    return plot_areas(table, {} if law is None else {model: law}, ax=ax)


def plot_areas(areas: pd.DataFrame, laws: Mapping[str, PowerLaw], *, ax: Axes | None = None) -> Axes:
    """Plot area against load for runs and models, with the power law fitted to the runs.

    Parameters
    ----------
    areas : DataFrame
        Columns of `contactimg.tables.AREA`.
    laws : mapping
        Model -> law; the legend shows the exponents and their intervals.
    ax : Axes, optional
        By default new axes with `plot_area_residuals` in a panel below; only these have it.

    Returns
    -------
    Axes
    """
    law = next((laws[model] for model in RUN_MODELS if model in laws), None)
    ax, below = (new_axes(), None) if law is None and ax is None else axes_with_panel(ax)
    for model, part in areas[areas["area_m2"] > 0].groupby("model", sort=False):
        style = _style(str(model))
        if model in laws:
            style["label"] += f", $m$ = {number_with_interval(laws[str(model)].exponent)}"
        ax.errorbar(part["load_N"] * 1e3, part["area_m2"] * 1e6, **_error_bars(part, str(model)), **style)
    if law is not None:
        load = np.geomspace(areas["load_N"].min(), areas["load_N"].max(), LINE_POINTS)
        area, label = _law_at(law, load), "power law fitted to the points"
        ax.plot(load * 1e3, area * 1e6, color="0.5", linewidth=2.5, alpha=0.5, zorder=0, label=label)
    ax.set(ylabel="real contact area A (mm²)")
    title: dict[str, Any] = {}
    if law is not None:
        title = {"title": f"$A \\sim P^m$, $m$ with its {100 * law.confidence:g} % interval:"}
    add_legend(ax, above=below is not None, **title)
    if below is not None and law is not None:
        plot_area_residuals(areas, law, ax=below)
    (ax if below is None else below).set_xlabel("load P (mN)")
    return scale_by_decades(ax)


def plot_area_residuals(areas: pd.DataFrame, law: PowerLaw, *, ax: Axes | None = None) -> Axes:
    """Plot how far areas lie from a power law (%), against load; curves that coincide in A(P) part here.

    Parameters
    ----------
    areas : DataFrame
        Columns of `contactimg.tables.AREA`.
    law : PowerLaw
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    for model, part in areas[areas["area_m2"] > 0].groupby("model", sort=False):
        reference = _law_at(law, part["load_N"].to_numpy(float))
        away = 100 * (part["area_m2"].to_numpy(float) / reference - 1)
        bars = bar_lengths(part["area_std_m2"], 100.0) / reference if model in RUN_MODELS else None
        ax.errorbar(part["load_N"] * 1e3, away, yerr=bars, capsize=2, **_style(str(model)))
    ax.set(xlabel="load P (mN)", ylabel="A over fit\nminus 1 (%)")
    return scale_by_decades(ax, axes="x")


def _law_at(law: PowerLaw, load: NDArray[np.float64]) -> NDArray[np.float64]:
    """Areas of a law; without a value at loads below the zero of the load cell."""
    pressed = load - law.zero
    return law.value(np.where(pressed > 0, pressed, np.nan))


def _style(model: str) -> dict[str, Any]:
    return {"markersize": MARKER_SIZE, "linewidth": 1.3, "elinewidth": 0.9} | STYLES[model]


def _error_bars(part: pd.DataFrame, model: str) -> dict[str, Any]:
    """Error bars of the runs; models have none."""
    if model not in RUN_MODELS:
        return {}
    bars = {"xerr": bar_lengths(part["load_std_N"], 1e3), "yerr": bar_lengths(part["area_std_m2"], 1e6)}
    return bars | {"capsize": 2}


def plot_friction(
    friction: pd.DataFrame, stress: ShearStress, smooth: Estimate | None, *, ax: Axes | None = None
) -> Axes:
    """Plot the friction force (mN) against the real contact area (mm^2), with ``Q = tau0 A``.

    Parameters
    ----------
    friction : DataFrame
        Columns of `contactimg.tables.FRICTION`. Frames of velocity 0 are marked as static friction; without
        velocities all are marked alike.
    stress : ShearStress
    smooth : Estimate or None, Pa
        Shear stress of the smooth contact, for a second line.
    ax : Axes, optional
        By default new axes with the differences from the law in a panel below; only these have it.

    Returns
    -------
    Axes
    """
    ax, below = axes_with_panel(ax)
    largest = float(friction["area_m2"].max())
    _draw_shear_lines(stress, smooth, largest, ax)
    for motion, style in MOTIONS:
        part = friction[motion_of(friction) == motion]
        if part.empty:
            continue
        area, force = part["area_m2"].to_numpy(float), part["friction_N"].abs().to_numpy(float)
        marks: dict[str, Any] = {"linestyle": "none", "markersize": MARKER_SIZE, "label": motion} | style
        bars = bar_lengths(part["area_std_m2"], 1e6)
        ax.errorbar(area * 1e6, force * 1e3, xerr=bars, capsize=2, **marks)
        if below is not None:
            below.errorbar(
                area * 1e6, (force - stress.stress.value * area) * 1e3, xerr=bars, capsize=2, **marks
            )
    ax.set(ylabel="friction force Q (mN)", ylim=(0, None))
    title = f"$\\tau_0$ with its {100 * stress.confidence:g} % interval (grey):"
    add_legend(ax, above=below is not None, title=title)
    if below is not None:
        _shade_interval(stress, largest, stress.stress.value, below)
        below.axhline(0.0, color="0.5", linewidth=0.8)
        below.set_ylabel("$Q - \\tau_0 A$ (mN)")
    (ax if below is None else below).set(xlabel="real contact area A (mm²)", xlim=(0, None))
    return ax


def motion_of(friction: pd.DataFrame) -> pd.Series:
    """Of each frame: "sliding", "static" at velocity 0, "friction" where the velocity is not known."""
    unknown = pd.Series(np.nan, index=friction.index)
    velocity = friction.get("velocity_m_s", unknown)
    named = np.where(velocity.isna(), "friction", np.where(velocity == 0, "static", "sliding"))
    return pd.Series(named, index=friction.index)


def _shade_interval(stress: ShearStress, largest: float, subtracted: float, ax: Axes) -> None:
    """Shade the interval of the fitted law minus that of a given shear stress (Pa)."""
    low, high = stress.stress.low - subtracted, stress.stress.high - subtracted
    if np.isfinite([low, high]).all():
        area = np.array([0.0, 1.05 * largest])
        ax.fill_between(area * 1e6, low * area * 1e3, high * area * 1e3, color="0.85", linewidth=0)


def _draw_shear_lines(stress: ShearStress, smooth: Estimate | None, largest: float, ax: Axes) -> None:
    """The fitted law with its interval, and that of the smooth contact."""
    area = np.array([0.0, 1.05 * largest])
    fitted = stress.stress
    _shade_interval(stress, largest, 0.0, ax)
    text = number_with_interval(fitted, factor=1e-6)
    label = f"$\\tau_0 A$, $\\tau_0$ = {text} MPa"
    ax.plot(area * 1e6, fitted.value * area * 1e3, color="0.4", linewidth=1.2, label=label)
    if smooth is not None:
        label = f"smooth contact, {number_with_std(smooth.value / 1e6, smooth.std / 1e6)} MPa"
        ax.plot(area * 1e6, smooth.value * area * 1e3, "--", color="#0072b2", linewidth=1.2, label=label)
