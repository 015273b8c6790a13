"""Figure of a trade-off: error against time, one panel per choice."""

import textwrap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from contactimg.plots.axes import new_axes, new_figure, scale_by_decades
from contactimg.plots.laws import MARKER_SIZE
from contactimg.tradeoff.knobs import KNOBS
from contactimg.tradeoff.measure import cheapest, front_of, knob_sentence

MARKS: tuple[tuple[int, dict[str, str], str], ...] = (
    (1, {"marker": "o", "color": "tab:blue"}, "no other is faster and more accurate"),
    (0, {"marker": "o", "color": "grey", "markerfacecolor": "none"}, "another is faster and more accurate"),
)
"""Value of the column ``pareto``, marker style, meaning."""

# Layout, chosen by eye
PANEL_INCHES = (4.6, 3.4)  # width and height of a panel with its key
LABEL_CHARACTERS, SENTENCE_CHARACTERS = 20, 60  # in a line of the key and of a title


def plot_knob(table: pd.DataFrame, *, relative: float, ax: Axes | None = None) -> Axes:
    """Plot the error of the settings of one choice against their time.

    Parameters
    ----------
    table : DataFrame
        Rows of one knob, columns of `contactimg.tables.TRADEOFF`. Rows without numbers are left out; an error
        of 0 is drawn a decade below the smallest other one.
    relative : float
        Tolerance to draw as a line.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = new_axes() if ax is None else ax
    known = table[table["error"].notna() & table["time_s"].notna()].sort_values("time_s")
    x, error = known["time_s"].to_numpy(float), known["error"].to_numpy(float)
    y = np.where(error > 0, error, error.min(where=error > 0, initial=1.0) / 10)
    mark = known["pareto"].to_numpy(int)
    ax.plot(x[mark == 1], y[mark == 1], "-", color="tab:blue", linewidth=1, alpha=0.4)
    for value, style, label in MARKS:
        ax.plot(x[mark == value], y[mark == value], linestyle="none", label=label, **style)  # type: ignore[arg-type]
    label = f"tolerance {100 * relative:g} %"
    ax.axhline(relative, color="tab:green", linestyle="--", linewidth=1, label=label)
    chosen = cheapest(front_of(table), relative)
    if chosen is not None:
        point = [chosen["time_s"]], y[x == chosen["time_s"]][:1]
        ax.plot(*point, marker="*", markersize=11, color="tab:orange", linestyle="none", label="recommended")
    name, output = (str(table[column].iloc[0]) for column in ("knob", "output"))
    label = "largest relative error of an output" if output == "all" else f"relative error of the {output}"
    ax.set(yscale="log", xlabel="time (s)", ylabel=label)
    title = KNOBS[name][0] if name in KNOBS else name
    sentence = knob_sentence(title, table, relative=relative).split(";")[0]
    sentence = textwrap.fill(sentence.removeprefix(f"{title}: "), SENTENCE_CHARACTERS)
    ax.set_title(f"{title}\n{sentence}", fontsize="small", loc="left")
    key = []
    for number, (place, name) in enumerate(zip(zip(x, y, strict=True), known["setting"], strict=True), 1):
        offset: dict[str, Any] = {"xytext": (MARKER_SIZE, MARKER_SIZE), "textcoords": "offset points"}
        ax.annotate(str(number), place, fontsize="small", **offset)
        text = textwrap.fill(name, LABEL_CHARACTERS)
        key.append(Line2D([], [], linestyle="none", marker=f"${number}$", color="black", label=text))
    if key:
        beside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
        ax.legend(handles=key, fontsize="small", **beside)
    ax.margins(x=0.1, y=0.15)
    return scale_by_decades(ax, axes="x") if len(known) else ax  # without numbers an axis has no decades


def plot_tradeoff(table: pd.DataFrame, *, relative: float) -> Axes:
    """Plot all choices on one figure.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.TRADEOFF`.
    relative : float
        Tolerance to draw as a line.

    Returns
    -------
    Axes
        The first panel; its figure holds the others.
    """
    groups = [part for _, part in table.groupby("knob", sort=False)]
    width, height = PANEL_INCHES
    figure = new_figure((width * len(groups), height))
    panels = list(figure.subplots(1, len(groups), squeeze=False).ravel())
    entries: dict[str, Artist] = {}
    for ax, part in zip(panels, groups, strict=True):
        handles, labels = plot_knob(part, relative=relative, ax=ax).get_legend_handles_labels()
        entries |= zip([str(label) for label in labels], handles, strict=True)
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": len(groups)}
    figure.legend(entries.values(), entries.keys(), fontsize="small", frameon=False, **place)
    return panels[0]
