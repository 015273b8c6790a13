"""Figures of an analysis over the surface: pressure profiles, contact laws, topography, shear."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator

from contactimg.analysis.power_laws import BrokenLaw
from contactimg.analysis.topography import Topography
from contactimg.plots.axes import add_legend, bar_lengths, new_axes, scale_by_decades
from contactimg.plots.laws import MARKER_SIZE, STYLES
from contactimg.plots.numbers import number_with_interval, number_with_std, plain_number
from contactimg.tables import RUN_MODELS

MODEL_MARKS: dict[str, Any] = {"marker": "s", "markersize": 6, "markerfacecolor": "none"}
"""Marks of models are open, so that measured points show inside."""


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
