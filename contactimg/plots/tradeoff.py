"""Figure of a trade-off: error against time, one panel per choice."""

import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from contactimg.plots.axes import FIGURE_DPI, new_axes
from contactimg.tradeoff.knobs import KNOBS
from contactimg.tradeoff.measure import cheapest, front_of, knob_sentence

Values = NDArray[np.float64]

MARKS: tuple[tuple[int, dict[str, str], str], ...] = (
    (1, {"marker": "o", "color": "tab:blue"}, "no other is faster and more accurate"),
    (0, {"marker": "o", "color": "grey", "markerfacecolor": "none"}, "another is faster and more accurate"),
    (-1, {"marker": "D", "color": "grey", "markerfacecolor": "none"}, "stored result, not run here"),
)
"""Value of the column ``pareto`` (-1 for empty), marker style, meaning."""

# Layout, chosen by eye
PANEL_INCHES = (4.0, 3.9)  # width and height of a panel: two are as wide as a page of 170 mm times 1.2
PANEL_COLUMNS = 2
LABEL_FONT = 7.2  # pt, 6 pt on a page of 170 mm
LABEL_CHARACTERS = 20  # in a line
SENTENCE_CHARACTERS = 66  # in a line of a title
LINE_HEIGHT_FRACTION = 0.045  # of the height of a panel
CHARACTER_WIDTH_FRACTION = 0.0185  # of the width of a panel
MARK_FRACTION = 0.012  # half side of a mark
LABEL_GAP_FRACTION = 0.03  # between a point and its label
LIFTS = (0.0, -0.7, 0.7, -1.4, 1.4, -2.1, 2.1, -3.0, 3.0)  # of a label, lines
PLAIN_DECADES = 2.5  # time axes shorter than this are labelled at 1, 2 and 5, longer ones at powers of ten


def plot_knob(table: pd.DataFrame, *, relative: float | None = None, ax: Axes | None = None) -> Axes:
    """Plot the error of the settings of one choice against their time.

    Parameters
    ----------
    table : DataFrame
        Rows of one knob, columns of `contactimg.tables.TRADEOFF`. Rows without numbers are left out; an error
        of 0 is drawn a decade below the smallest other one.
    relative : float, optional
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
    mark = known["pareto"].fillna(-1).to_numpy(int)
    ax.plot(x[mark == 1], y[mark == 1], "-", color="tab:blue", linewidth=1, alpha=0.4)
    for value, style, label in MARKS:
        ax.plot(x[mark == value], y[mark == value], linestyle="none", label=label, **style)  # type: ignore[arg-type]
    if relative is not None:
        ax.axhline(
            relative, color="tab:green", linestyle="--", linewidth=1, label=f"tolerance {100 * relative:g} %"
        )
    chosen = None if relative is None else cheapest(front_of(table), relative)
    if chosen is not None:
        point = [chosen["time_s"]], y[x == chosen["time_s"]][:1]
        ax.plot(*point, marker="*", markersize=11, color="tab:orange", linestyle="none", label="recommended")
    name, output = (str(table[column].iloc[0]) for column in ("knob", "output"))
    label = "largest relative error of an output" if output == "all" else f"relative error of the {output}"
    ax.set(xscale="log", yscale="log", xlabel="time (s)", ylabel=label)
    title = KNOBS[name][0] if name in KNOBS else name
    if relative is not None:
        sentence = knob_sentence(title, table, relative=relative).split(";")[0]
        title += "\n" + textwrap.fill(sentence.removeprefix(f"{title}: "), SENTENCE_CHARACTERS)
    ax.set_title(title, fontsize=LABEL_FONT, loc="left")
    if len(known):
        _leave_room(ax, x, np.append(y, [] if relative is None else relative))
        _label(ax, x, y, known["setting"].tolist())
    return ax


def plot_tradeoff(table: pd.DataFrame, *, relative: float | None = None) -> Axes:
    """Plot all choices on one figure.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.TRADEOFF`.
    relative : float, optional
        Tolerance to draw as a line.

    Returns
    -------
    Axes
        The first panel; its figure holds the others.
    """
    groups = [part for _, part in table.groupby("knob", sort=False)]
    columns = min(PANEL_COLUMNS, len(groups))
    rows = -(-len(groups) // columns)
    figure = Figure(
        figsize=(PANEL_INCHES[0] * columns, PANEL_INCHES[1] * rows), layout="constrained", dpi=FIGURE_DPI
    )
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for ax, part in zip(panels, groups, strict=False):
        plot_knob(part, relative=relative, ax=ax)
    for ax in panels[len(groups) :]:
        ax.axis("off")
    entries = {
        label: handle
        for ax in panels[: len(groups)]
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        entries.values(),
        entries.keys(),
        loc="outside lower center",
        ncols=columns,
        fontsize="small",
        frameon=False,
    )
    return panels[0]


def _leave_room(ax: Axes, x: Values, y: Values) -> None:
    """Set limits that leave room for the labels to the right of the points."""
    wide = max(np.log10(x.max() / x.min()), 0.8)  # a shorter axis would have no labels
    high = max(np.log10(y.max() / y.min()), 0.5)
    ax.set_xlim(x.min() / 10 ** (0.1 * wide), x.max() * 10 ** (0.55 * wide))
    ax.set_ylim(y.min() / 10 ** (0.12 * high), y.max() * 10 ** (0.12 * high))
    if wide < PLAIN_DECADES:
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())


def _label(ax: Axes, x: Values, y: Values, names: list[str]) -> None:
    """Write the names beside the points, where they cover the least of each other and of the points."""
    texts = [textwrap.fill(name, LABEL_CHARACTERS) for name in names]
    places = ax.transAxes.inverted().transform(ax.transData.transform(np.column_stack([x, y])))
    taken = np.column_stack([places - MARK_FRACTION, places + MARK_FRACTION])
    for k in np.lexsort((x, -y)):
        lines = texts[k].split("\n")
        size = CHARACTER_WIDTH_FRACTION * max(map(len, lines)), LINE_HEIGHT_FRACTION * len(lines)
        boxes = np.array([_beside(places[k], size, side, lift) for lift in LIFTS for side in (1, -1)])
        outside = np.prod(size) - _shared_areas(boxes, np.array([[0.0, 0.0, 1.0, 1.0]]))
        best = boxes[np.argmin(np.round(outside + _shared_areas(boxes, taken), 6))]
        taken = np.vstack([taken, best])
        ax.text(
            best[0],
            (best[1] + best[3]) / 2,
            texts[k],
            transform=ax.transAxes,
            fontsize=LABEL_FONT,
            va="center",
            linespacing=1.0,
        )


def _beside(place: Values, size: tuple[float, float], side: int, lift: float) -> Values:
    """Left, lower, right and upper end of a label right (1) or left (-1) of a point, lifted by lines."""
    low = place[1] + lift * LINE_HEIGHT_FRACTION - size[1] / 2
    left = place[0] + (LABEL_GAP_FRACTION if side > 0 else -LABEL_GAP_FRACTION - size[0])
    return np.array([left, low, left + size[0], low + size[1]])


def _shared_areas(boxes: Values, others: Values) -> Values:
    """How much of each box, shape (n, 4), others cover in all."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.prod(np.maximum(high - low, 0.0), axis=2).sum(axis=1)
