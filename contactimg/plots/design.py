"""Figure of a designed surface: the wanted law, and the laws of the surfaces designed for it."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from contactimg.plots.axes import add_legend, axes_with_panel, scale_by_decades

LAWS: dict[str, dict[str, Any]] = {
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
    ax, below = axes_with_panel(ax)
    load, wanted = law["load_N"] * 1e3, law["wanted_area_m2"]
    ax.plot(load, wanted * 1e6, color="black", linewidth=1.3, label="wanted")
    if below is not None:
        below.axhline(0.0, color="black", linewidth=1.3)
    for panel, scaled in ((ax, lambda area: area * 1e6), (below, lambda area: 100 * (area / wanted - 1))):
        if panel is None:
            continue
        for column, style in LAWS.items():
            panel.plot(load, scaled(law[column]), linewidth=1.3, **style)
        low, high = (law["coupled_area_m2"] + sign * law["coupled_std_m2"] for sign in (-1, 1))
        band: dict[str, Any] = {"color": "#d55e00", "alpha": 0.2, "linewidth": 0}
        panel.fill_between(load, scaled(low), scaled(high), label="errors of the heights", **band)
    ax.set(ylabel="real contact area A (mm²)")
    add_legend(ax, above=below is not None)
    if below is not None:
        below.set(ylabel="A over wanted\nminus 1 (%)")
    (ax if below is None else below).set_xlabel("load P (mN)")
    return scale_by_decades(ax)
