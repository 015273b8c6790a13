"""What a referee asks of a figure: units at the axes, text of 6 pt in print, legends that hide no data."""

import re
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb

from contactimg.analysis.estimates import CoverageEstimate
from contactimg.analysis.friction import fit_shear_stress
from contactimg.analysis.power_laws import fit_broken_law, fit_power_law
from contactimg.analysis.topography import describe_topography
from contactimg.plots import (
    plot_areas,
    plot_forces,
    plot_friction,
    plot_jkr,
    plot_plateau,
    plot_pressure_law,
    plot_profile,
    plot_slopes,
    plot_topography,
)
from contactimg.plots.overlay import FONT_FRACTION
from contactimg.plots.tradeoff import plot_tradeoff
from contactimg.tables import AREA, FRICTION, NORMALISED, PRESSURE_LAW, TOPOGRAPHY, TRADEOFF

LOAD = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.5])
THRESHOLDS = np.linspace(0.05, 0.95, 19)
MODELS = ["measured", "coupled", "uncoupled", "gt"]
COLUMN_MM, PAGE_MM = 85.0, 170.0
WITHOUT_UNIT = (
    "over",
    "fraction",
    "relative error",
    "per asperity",
    "|d ln A/d threshold|",
    "contacts per mm²",
)


def areas():
    parts = [AREA.conform({"model": [name] * 6, "load_N": LOAD,
                           "area_m2": (1 - 0.02 * k) * 1.6e-6 * LOAD**0.9,
                           "area_std_m2": 2e-8 * LOAD}) for k, name in enumerate(MODELS)]  # fmt: skip
    return plot_areas(pd.concat(parts), {"measured": fit_power_law(LOAD, 1.6e-6 * LOAD**0.9)})


def profile():
    r = np.linspace(0.1, 1.5, 8)
    models = enumerate([*MODELS, "hertz"])
    parts = [NORMALISED.conform({"model": [name] * 8, "load_N": [0.5] * 8, "r_over_hertz_radius": r,
                                 "pressure_over_hertz": 1.6 * np.exp(-((k / 9 + r) ** 2)),
                                 "pressure_std_over_hertz": 0.4, "hertz_pressure_Pa": 4e4,
                                 "hertz_radius_m": 2e-3}) for k, name in models]  # fmt: skip
    return plot_profile(pd.concat(parts))


def pressure_law(quantity):
    p = np.geomspace(5e2, 5e4, 12)
    part = {"pressure_Pa": p, "density_per_m2": 1e5 * p**0.4, "density_ratio": 5e-3 * p**0.4,
            "mean_radius_m": 5e-6 * p**0.2, "density_std_per_m2": 1e6, "mean_radius_std_m": 1e-6}  # fmt: skip
    table = pd.concat([PRESSURE_LAW.conform({"model": [name] * 12} | part) for name in MODELS[:2]])
    y = part[{"density": "density_per_m2", "mean_radius": "mean_radius_m"}[quantity]]
    law = fit_broken_law(p, y * (1 + 0.01 * np.cos(7 * np.arange(12))), y_std=0.1 * y)
    return plot_pressure_law(table, {(quantity, name): law for name in MODELS[:2]}, quantity)


def friction():
    area = 1.6e-6 * LOAD**0.9
    table = {"load_N": LOAD, "area_m2": area, "area_std_m2": 0.01 * area, "velocity_m_s": [0.0] + [5e-4] * 5}
    table = FRICTION.conform(table | {"friction_N": 4e5 * area + 2e-3 * np.cos(9 * LOAD)})
    return plot_friction(table, fit_shear_stress(table), None)


def topography():
    radius = np.linspace(30e-6, 90e-6, 12)
    table = pd.DataFrame({"height_m": 0.45 * radius, "radius_m": radius})
    table = TOPOGRAPHY.conform(table)
    return plot_topography(table, describe_topography(table))


def jkr():
    points = pd.DataFrame(
        {"load_N": LOAD, "radius_m": 3e-3 * LOAD ** (1 / 3), "residual_N": 1e-3 * np.cos(9 * LOAD)}
    )
    points = points.assign(branch=["loading"] * 4 + ["unloading"] * 2, used=[True] * 5 + [False])
    return plot_jkr(points, points, fitted=["E = 3.030 (2.959 to 3.101) MPa"])


def slopes():
    return plot_slopes(THRESHOLDS, 2.8 - 2.5 * THRESHOLDS, 0 * THRESHOLDS + 0.1, found=0.72)


def forces():
    return plot_forces(LOAD, 1.05 * LOAD, slope=CoverageEstimate(1.05, 0.01, 1.03, 1.07))


def plateau():
    curves = np.linspace(1e-7, 1e-6, 6) * np.exp(-THRESHOLDS)[:, None]
    names = [f"P = {1e3 * load:g} mN" for load in LOAD]
    return plot_plateau(THRESHOLDS, curves, low=0.3, high=0.6, names=names)


def tradeoff():
    settings = {"knob": "model", "output": "all",
                "setting": ["uncoupled", "Greenwood-Williamson", "Greenwood-Tripp",
                "coupled by point forces", "fully coupled"],
                "error": [0.5, 0.5, 0.06, 1.7e-3, 2.5e-4],
                "time_s": [2e-3, 0.03, 0.2, 5e-3, 0.014],
                "pareto": [1, 0, 0, 1, 1]}  # fmt: skip
    table = TRADEOFF.conform(settings)
    return plot_tradeoff(pd.concat([table, table.assign(knob="image")]), relative=0.01)


FIGURES = {
    "area": areas, "profile": profile, "density": lambda: pressure_law("density"),
    "mean_radius": lambda: pressure_law("mean_radius"), "friction": friction, "topography": topography,
    "jkr": jkr, "slopes": slopes, "forces": forces, "plateau": plateau, "tradeoff": tradeoff,
}  # fmt: skip


@pytest.fixture(scope="module", params=FIGURES)
def drawn(request):
    """Name and axes of a figure, laid out."""
    ax = FIGURES[request.param]()
    ax.figure.draw_without_rendering()
    return request.param, ax


def own_axes(figure):
    """Axes with those at the right and on top."""
    return [part for ax in figure.axes for part in (ax, *ax.child_axes) if part.axison]


def test_every_axis_says_what_it_shows_and_in_which_unit(drawn):
    name, ax = drawn
    for part in own_axes(ax.figure):
        for side in (part.xaxis, part.yaxis):
            if not any(
                tick.label1.get_visible() or tick.label2.get_visible() for tick in side.get_major_ticks()
            ):
                continue
            if not side.get_visible() or (part in ax.child_axes and side.get_label_text() == ""):
                continue  # an axis at the right has no x axis of its own
            text = side.get_label_text().replace("\n", " ")
            unit = re.search(r"\((mN|mm|µm|mm²|kPa|MPa|%|s)\)$", text)
            assert unit or any(word in text for word in WITHOUT_UNIT), (name, text)


def test_text_is_large_enough_in_print(drawn):
    name, ax = drawn
    width_pt = 72 / 25.4 * (PAGE_MM if name == "tradeoff" else COLUMN_MM)
    scale = width_pt / (72 * ax.figure.get_figwidth())
    assert FONT_FRACTION * 72 / 25.4 * COLUMN_MM >= 6.0
    texts = [
        text for text in ax.figure.findobj(lambda artist: hasattr(artist, "get_fontsize")) if text.get_text()
    ]
    smallest = min(texts, key=lambda text: text.get_fontsize())
    assert scale * smallest.get_fontsize() >= 5.95, (name, smallest.get_text())


def test_legends_hide_no_data(drawn):
    name, ax = drawn
    legend = ax.get_legend()
    if legend is None:  # outside of the axes
        assert ax.figure.legends, name
        return
    box = legend.get_window_extent()
    for part in ax.figure.axes:
        for line in part.lines:
            shown = line.get_transform().transform(line.get_xydata())
            if len(shown) > 2:  # lines across the axes run behind the legend
                assert box.count_contains(shown) == 0, (name, line)


def test_no_text_runs_into_another_or_out_of_the_figure(drawn):
    name, ax = drawn
    texts = [
        text for part in own_axes(ax.figure) for text in (*part.texts, part.xaxis.label, part.yaxis.label)
    ]
    for legend in (ax.get_legend(), *ax.figure.legends):
        texts += legend.get_texts() if legend else []
    boxes = [text.get_window_extent() for text in texts if text.get_text() and text.get_visible()]
    for k, box in enumerate(boxes):
        assert 0 <= box.x0 <= box.x1 <= ax.figure.bbox.width, (name, texts[k].get_text())
        assert not any(box.overlaps(other) for other in boxes[:k]), (name, texts[k].get_text())


def test_curves_of_a_plateau_are_told_apart_in_grey():
    lines = [line for line in plateau().lines if line.get_label().startswith("P")]
    grey = [float(np.dot((0.299, 0.587, 0.114), to_rgb(line.get_color()))) for line in lines]
    assert max(grey) < 0.6  # on the shade of 0.87
    assert all(one.get_linestyle() != two.get_linestyle() for one, two in pairwise(lines))
