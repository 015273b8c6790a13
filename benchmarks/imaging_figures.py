"""Figures of the accuracy of the imaging."""

import matplotlib.pyplot as plt
import numpy as np
from imaging_scores import ROOT
from matplotlib.lines import Line2D

FOLDER = ROOT / "docs" / "figures"
OURS, OTHERS, LIMIT = "#c1121f", "#33658a", "#666666"
FOUND = ((0.95, "full", "F1 ≥ 0.95"), (0.9, "left", "0.90-0.95"), (0.0, "none", "< 0.90"))
# where a label stands about its marker: horizontal and vertical alignment
BESIDE = {
    "OpenCV threshold": ("left", "top"),
    "scikit-image watershed": ("left", "center"),
    "scikit-image regions": ("left", "bottom"),
    "OpenCV SimpleBlob": ("left", "bottom"),
    "photutils deblend": ("left", "bottom"),
    "SEP": ("right", "center"),
    "watershed, area lookup": ("right", "center"),
    "watershed, intensity in cells": ("left", "top"),
    "LoG blobs": ("right", "bottom"),
    "DoG blobs": ("left", "bottom"),
    "trackpy": ("right", "bottom"),
    "contactimg threshold": ("center", "bottom"),
}


def plot_methods(table, *, name="imaging_methods.png"):
    """Error in multiples of the bound against time in multiples of the floor."""
    figure, axes = plt.subplots(figsize=(9.0, 5.2), layout="constrained")
    axes.set(xscale="log", yscale="log", xlim=(0.4, 1500), ylim=(0.7, 900))
    for drawn in (axes.axhline, axes.axvline):
        drawn(1.0, color=LIMIT, linestyle="--", linewidth=1.2, zorder=0)
    axes.text(1400, 0.97, "bound: Cramér-Rao, frame and one reference", color=LIMIT, ha="right", va="top")
    axes.text(
        0.97,
        1.3,
        "floor: OpenCV subtracts,\nthresholds and labels",
        color=LIMIT,
        ha="right",
        va="bottom",
        rotation=90,
    )
    for method, row in table.iterrows():
        ours = method.startswith("contactimg")
        style = next(style for least, style, _ in FOUND if row.f1 >= least)
        axes.plot(
            row.time, row.ratio, "o", color=OURS if ours else OTHERS, fillstyle=style,
            markersize=11 if ours else 8, zorder=3,
        )  # fmt: skip
        across, along = BESIDE.get(method, ("left", "center"))
        axes.annotate(
            method,
            (row.time, row.ratio),
            xytext=(
                {"left": 8, "center": 0, "right": -8}[across],
                {"top": -5, "center": 0, "bottom": 5}[along],
            ),
            textcoords="offset points",
            ha=across,
            va=along,
            color=OURS if ours else "black",
            fontweight="bold" if ours else "normal",
            fontsize=11 if ours else 9.5,
        )
    handles = [
        Line2D([], [], marker="o", linestyle="", color=OTHERS, fillstyle=style, label=text)
        for _, style, text in FOUND
    ]
    axes.legend(handles=handles, title="contacts found", loc="upper right", frameon=False, ncols=3)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_xlabel("time of one frame of 500 contacts, over that of OpenCV's floor")
    axes.set_ylabel("RMS error of the radius, over its bound")
    axes.grid(visible=True, which="major", color="0.92")
    axes.spines[["top", "right"]].set_visible(False)
    save(figure, name)


def plot_completeness(curves, expected, *, name="imaging_completeness.png"):
    """Share of contacts that are found against radius; dotted, ``expected(contrast, radius)``."""
    figure, axes = plt.subplots(figsize=(8.0, 4.4), layout="constrained")
    colours = plt.colormaps["viridis"](np.linspace(0.0, 0.9, curves.contrast.nunique()))
    fine = np.geomspace(curves.radius.min(), curves.radius.max(), 200)
    for colour, (contrast, curve) in zip(colours, curves.groupby("contrast"), strict=True):
        axes.plot(fine, [expected(contrast, a) for a in fine], ":", color=colour, linewidth=1.5)
        axes.errorbar(
            curve.radius, curve.found, yerr=curve.found_std, fmt="o-", color=colour, markersize=5,
            label=f"{contrast:g}",
        )  # fmt: skip
    axes.plot([], [], ":", color="black", label="filter alone")
    axes.set(xlabel="contact radius (px)", ylabel="share of contacts found", ylim=(-0.03, 1.06))
    axes.legend(title="contrast / noise", frameon=False, loc="lower right")
    axes.grid(visible=True, color="0.92")
    axes.spines[["top", "right"]].set_visible(False)
    save(figure, name)


def save(figure, name):
    FOLDER.mkdir(parents=True, exist_ok=True)
    figure.savefig(FOLDER / name, dpi=130)
    plt.close(figure)
    print(f"docs/figures/{name}")
