"""Figures of laws with what they leave over under them: area against load, also designed, and friction."""

from collections.abc import Callable, Mapping
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

Values = NDArray[np.float64]
Shown = Callable[[Values, Values], Values]
"""What a panel shows of values at places: themselves in its unit, or what a law leaves over."""

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

LINE_POINTS = 200
"""Points of a drawn law. Chosen: its bends look smooth."""

MOTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("sliding", {"marker": "o", "color": "black"}),
    ("static", {"marker": "s", "color": "#d55e00", "markerfacecolor": "none"}),
    ("friction", {"marker": "D", "color": "black"}),
)
"""Marks of frames that slide, that are at rest, and whose velocity is not known."""


def plot_area(frames: pd.DataFrame, *, model: str = "measured", ax: Axes | None = None) -> Axes:
    """Plot the real contact area (mm^2) of each frame against load (mN) on logarithmic axes.

    Parameters
    ----------
    frames : DataFrame
        The table of frames; rows without load or area are left out.
    model : {"measured", "predicted"}
        What the legend calls the frames.
    ax : Axes, optional
        By default new axes.

    Returns
    -------
    Axes
    """
    good = frames[(frames["load_N"] > 0) & (frames["area_m2"] > 0)]
    table = good[["load_N", "area_m2", "area_std_m2"]].assign(model=model, load_std_N=np.nan)
    return plot_areas(table, {}, ax=ax)


def plot_areas(areas: pd.DataFrame, laws: Mapping[str, PowerLaw], *, ax: Axes | None = None) -> Axes:
    """Plot area against load for runs and models, with the power law fitted to the runs.

    Parameters
    ----------
    areas : DataFrame
        Columns of `contactimg.tables.AREA`.
    laws : mapping
        Model -> law; the legend shows the exponents and their intervals.
    ax : Axes, optional
        By default new axes with the differences from the law (%) in a panel below, where curves that coincide
        part; only these have it.

    Returns
    -------
    Axes
    """
    law = next((laws[model] for model in RUN_MODELS if model in laws), None)
    ax, below, last = axes_with_panel(new_axes() if law is None and ax is None else ax)
    views: list[tuple[Axes, Shown]] = [(ax, lambda _, area: area * 1e6)]
    if law is not None:
        views.append((below, lambda load, area: 100 * (area / _law_at(law, load) - 1)))
    for panel, shown in views:
        for model, part in areas[areas["area_m2"] > 0].groupby("model", sort=False):
            load, area = part["load_N"].to_numpy(float), part["area_m2"].to_numpy(float)
            style = {"markersize": MARKER_SIZE, "linewidth": 1.3, "elinewidth": 0.9} | STYLES[str(model)]
            if model in laws:
                style["label"] += f", $m$ = {number_with_interval(laws[str(model)].exponent)}"
            if model in RUN_MODELS:  # models have no error bars
                style |= {"xerr": bar_lengths(part["load_std_N"], 1e3), "capsize": 2}
                style["yerr"] = shown(load, area + bar_lengths(part["area_std_m2"])) - shown(load, area)
            panel.errorbar(load * 1e3, shown(load, area), **style)
        scale_by_decades(panel, axes="x")
    title: dict[str, Any] = {}
    if law is not None:
        load = np.geomspace(areas["load_N"].min(), areas["load_N"].max(), LINE_POINTS)
        line: dict[str, Any] = {"color": "0.5", "linewidth": 2.5, "alpha": 0.5, "zorder": 0}
        ax.plot(load * 1e3, _law_at(law, load) * 1e6, label="power law fitted to the points", **line)
        title = {"title": f"$A \\sim P^m$, $m$ with its {100 * law.confidence:g} % interval:"}
    below.axhline(0.0, color="0.5", linewidth=0.8)
    below.set_ylabel("A over fit\nminus 1 (%)")
    ax.set_ylabel("real contact area A (mm²)")
    add_legend(ax, above=last is below, **title)
    last.set_xlabel("load P (mN)")
    return scale_by_decades(ax)


def _law_at(law: PowerLaw, load: Values) -> Values:
    """Areas of a law; without a value at loads below the zero of the load cell."""
    pressed = load - law.zero
    return law.value(np.where(pressed > 0, pressed, np.nan))


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
    ax, below, last = axes_with_panel(ax)
    fitted, ends = stress.stress, np.array([0.0, 1.05 * float(friction["area_m2"].max())])
    label = f"$\\tau_0 A$, $\\tau_0$ = {number_with_interval(fitted, factor=1e-6)} MPa"
    lines: list[tuple[float, dict[str, Any]]] = [(fitted.value, {"color": "0.4", "label": label})]
    if smooth is not None:
        label = f"smooth contact, {number_with_std(smooth.value / 1e6, smooth.std / 1e6)} MPa"
        lines.append((smooth.value, {"color": "#0072b2", "linestyle": "--", "label": label}))
    views: tuple[tuple[Axes, Shown], ...] = (
        (ax, lambda _, force: force * 1e3),
        (below, lambda area, force: (force - fitted.value * area) * 1e3),
    )
    for panel, shown in views:
        if np.isfinite([fitted.low, fitted.high]).all():
            interval = shown(ends, fitted.low * ends), shown(ends, fitted.high * ends)
            panel.fill_between(ends * 1e6, *interval, color="0.85", linewidth=0)
        for value, style in lines if panel is ax else lines[:1]:
            panel.plot(ends * 1e6, shown(ends, value * ends), linewidth=1.2, **style)
        for motion, style in MOTIONS:
            part = friction[motion_of(friction) == motion]
            if len(part):
                area, force = part["area_m2"].to_numpy(float), part["friction_N"].abs().to_numpy(float)
                marks: dict[str, Any] = {"linestyle": "none", "markersize": MARKER_SIZE, "capsize": 2}
                marks |= {"label": motion, "xerr": bar_lengths(part["area_std_m2"], 1e6)} | style
                panel.errorbar(area * 1e6, shown(area, force), **marks)
    ax.set(ylabel="friction force Q (mN)", ylim=(0, None))
    title = f"$\\tau_0$ with its {100 * stress.confidence:g} % interval (grey):"
    add_legend(ax, above=last is below, title=title)
    below.set_ylabel("$Q - \\tau_0 A$ (mN)")
    last.set(xlabel="real contact area A (mm²)", xlim=(0, None))
    return ax


def motion_of(friction: pd.DataFrame) -> pd.Series:
    """Say how each frame moves: "sliding", "static" at velocity 0, "friction" where that is not known."""
    velocity = friction.reindex(columns=["velocity_m_s"])["velocity_m_s"]
    named = np.where(velocity.isna(), "friction", np.where(velocity == 0, "static", "sliding"))
    return pd.Series(named, index=friction.index)


DESIGNED_LAWS: dict[str, dict[str, Any]] = {
    "independent_area_m2": {
        "color": "#e69f00",
        "linestyle": ":",
        "label": "designed for independent contacts,\nif they were independent",
    },
    "uncorrected_area_m2": {"color": "#e69f00", "linestyle": "-.", "label": "the same with coupled contacts"},
    "coupled_area_m2": {"color": "#d55e00", "linestyle": "--", "label": "designed for coupled contacts"},
}
"""Column of the table of laws -> style of its line."""


def plot_design(law: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the wanted and the designed areas (mm^2) against load (mN), the scatter from heights as a band.

    Parameters
    ----------
    law : DataFrame
        Columns of `contactimg.tables.DESIGNED`.
    ax : Axes, optional
        By default new axes with the differences from the wanted law in a panel below; only these have it.

    Returns
    -------
    Axes
    """
    ax, below, last = axes_with_panel(ax)
    load, wanted = law["load_N"] * 1e3, law["wanted_area_m2"]
    ax.plot(load, wanted * 1e6, color="black", linewidth=1.3, label="wanted")
    below.axhline(0.0, color="black", linewidth=1.3)
    for panel, scaled in ((ax, lambda area: area * 1e6), (below, lambda area: 100 * (area / wanted - 1))):
        for column, style in DESIGNED_LAWS.items():
            panel.plot(load, scaled(law[column]), linewidth=1.3, **style)
        low, high = (law["coupled_area_m2"] + sign * law["coupled_std_m2"] for sign in (-1, 1))
        band: dict[str, Any] = {"color": "#d55e00", "alpha": 0.2, "linewidth": 0}
        panel.fill_between(load, scaled(low), scaled(high), label="errors of the heights", **band)
    ax.set(ylabel="real contact area A (mm²)")
    add_legend(ax, above=last is below)
    below.set(ylabel="A over wanted\nminus 1 (%)")
    last.set_xlabel("load P (mN)")
    return scale_by_decades(ax)
