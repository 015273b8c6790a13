"""Figures of an analysis: laws, with what they leave over under them, and profiles over the surface."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import ShearStress
from contactimg.analysis.power_laws import BrokenLaw, PowerLaw
from contactimg.analysis.topography import Topography
from contactimg.plots.axes import add_legend, axes_with_panel, bar_lengths, new_axes, scale_by_decades
from contactimg.plots.numbers import number_with_interval, number_with_std, plain_number
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

MODEL_MARKS: dict[str, Any] = {"marker": "s", "markersize": 6, "markerfacecolor": "none"}
"""Marks of models are open, so that measured points show inside."""

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


# --- over the surface: pressure profiles, contact laws, topography, shear


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
        r, p = known[["r_over_hertz_radius", "pressure_over_hertz"]].to_numpy(float).T
        if model == "hertz":
            r = np.linspace(0.0, 1.0, 200)
            p = np.sqrt(1 - r**2)
        if len(r) == 0:
            continue
        bars: dict[str, Any] = {"linewidth": 1.3}
        if model in RUN_MODELS:
            bars = {"yerr": bar_lengths(known["pressure_std_over_hertz"], 1.0), "markersize": MARKER_SIZE}
        ax.errorbar(r, p, capsize=2, **bars, **STYLES[str(model)])
    load = normalised["load_N"].iloc[0] if len(normalised) else np.nan
    ax.set(xlabel="distance from the apex over Hertz radius, $r/a_H$", xlim=(0, None), ylim=(0, None))
    ax.set_ylabel("pressure over largest\nHertz pressure, $p/p_0$")
    ax.legend(fontsize="small", title=f"load P = {plain_number(load * 1e3)} mN", title_fontsize="small")
    return ax


def plot_pressure_law(
    points: pd.DataFrame, laws: Mapping[tuple[str, str], BrokenLaw], quantity: str, *, ax: Axes | None = None
) -> Axes:
    """Plot the density or the mean radius of the contacts against the local pressure (kPa).

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
    alone, ax = ax is None, new_axes() if ax is None else ax
    column, std, unit, label = _pressure_axis(points, quantity)
    for model, part in points.groupby("model", sort=False):
        own = {"markersize": 3.5} if model in RUN_MODELS else MODEL_MARKS
        style = STYLES[str(model)] | own | {"linestyle": "none", "elinewidth": 0.8}
        law = laws.get((quantity, str(model)))
        if law is not None and law.supported:
            pressure = plain_number(law.break_x.value * 1e-3, digits=3)
            below, above = (f"$p^{{{one.value:.2f}}}$" for one in (law.low_exponent, law.high_exponent))
            style["label"] += f", {below}, {above}, $p^*$ = {pressure} kPa"
        elif law is not None:
            style["label"] += f", $\\sim p^m$, $m$ = {number_with_interval(law.single.exponent)}"
        errors = bar_lengths(part[std], unit) if model in RUN_MODELS else None
        ax.errorbar(part["pressure_Pa"] * 1e-3, part[column] * unit, yerr=errors, **style)
        if law is not None:
            p = np.geomspace(law.single.low, law.single.high, 100)
            values = law.value(p) if law.supported else law.single.value(p)
            line = "-" if model in RUN_MODELS else "--"
            ax.plot(p * 1e-3, values * unit, line, color=style["color"], linewidth=1.2)
    ax.set(xlabel="local pressure p (kPa)", ylabel=label)
    scale_by_decades(ax)
    title: dict[str, Any] = {}
    single = [law for (name, _), law in laws.items() if name == quantity and not law.supported]
    if single:
        percent = 100 * single[0].single.confidence
        title = {"title": f"power laws, exponent $m$ with its {percent:g} % interval:"}
    add_legend(ax, above=alone, **title)
    return ax


def _pressure_axis(points: pd.DataFrame, quantity: str) -> tuple[str, str, float, str]:
    """Columns of a quantity and its uncertainty, the factor to its unit, and the axis label."""
    if quantity == "mean_radius":
        return "mean_radius_m", "mean_radius_std_m", 1e6, "mean contact radius (µm)"
    density = 1 / (points["density_ratio"] / points["density_per_m2"]).median()
    if np.isfinite(density):
        return "density_per_m2", "density_std_per_m2", 1 / density, "contacts per asperity, $\\eta/\\eta_0$"
    return "density_per_m2", "density_std_per_m2", 1e-6, "contacts per mm²"


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
    x_std, y_std = (bar_lengths(table[name], 1e6) for name in ("radius_std_m", "height_std_m"))
    marks: dict[str, Any] = {"fmt": "o", "markersize": MARKER_SIZE, "elinewidth": 0.9, "color": "black"}
    marks["label"] = f"{topography.n_points} asperities"
    ax.errorbar(table["radius_m"] * 1e6, table["height_m"] * 1e6, xerr=x_std, yerr=y_std, **marks)
    if topography.one_angle:
        radius = np.array([0.0, table["radius_m"].max()])
        angle = topography.contact_angle
        label = f"$\\theta$ = {number_with_std(*np.degrees([angle.value, angle.std]).tolist())}°"
        ax.plot(radius * 1e6, topography.slope.value * radius * 1e6, color="#d55e00", label=label)
    ax.legend(fontsize="small")
    ax.set(xlabel="radius of curvature R (µm)", ylabel="height h (µm)", xlim=(0, None), ylim=(0, None))
    return ax


def plot_sheared_areas(followed: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Plot the area of each contact against the tangential load, coloured by its size.

    Parameters
    ----------
    followed : DataFrame
        Columns of `contactimg.tables.FOLLOWED`; rows without contact or tangential load are not drawn. A line
        joins the frames of a contact in the order of its tangential loads at each normal load.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    known = followed[followed["touches"] & followed["tangential_N"].notna()]
    known = known.assign(force=known["tangential_N"].abs() * 1e3, area=known["area_m2"] * 1e12)
    keys = ["place"] if known.get("place", pd.Series(dtype=str)).ne("").any() else []
    lines, sizes = [], []
    for _, part in known.groupby([*keys, "load_N", "asperity"], dropna=False):
        points = part.sort_values("force")[["force", "area"]].to_numpy(float)
        lines.append(points)
        sizes.append(float(np.sqrt(points[:, 1].max() / np.pi)))
    if lines:
        norm = LogNorm(min(sizes), max(*sizes, 1.001 * min(sizes)))
        ax.add_collection(LineCollection(lines, array=sizes, cmap="viridis", norm=norm, linewidths=0.8))
        x, y = np.concatenate(lines).T
        ax.scatter(x, y, c=np.repeat(sizes, [len(one) for one in lines]), cmap="viridis", norm=norm, s=6)
        scale = ax.figure.colorbar(ScalarMappable(norm, "viridis"), ax=ax, label="largest radius (µm)")
        scale_by_decades(scale.ax, axes="y")
        ax.autoscale()
    scale_by_decades(ax, axes="y")
    ax.set(xlabel="tangential load |Q| (mN)", ylabel="contact area (µm²)")
    ax.xaxis.set_major_locator(MaxNLocator(6))
    return ax
