"""Curves: what is drawn, in which units, and what the legend says."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import fit_shear_stress
from contactimg.analysis.power_laws import fit_broken_law, fit_power_law
from contactimg.analysis.topography import describe_topography
from contactimg.plots import plot_areas, plot_friction, plot_pressure_law, plot_profile, plot_topography
from contactimg.plots.laws import motion_of
from contactimg.tables import AREA, FRICTION, NORMALISED, PRESSURE_LAW, TOPOGRAPHY


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_areas_are_in_square_millimetres_with_exponents():
    load = np.array([0.1, 0.2, 0.4])
    table = AREA.conform(
        {"model": ["measured"] * 3 + ["gt"], "load_N": [*load, 0.1], "area_m2": [*load * 1e-6, 2e-7]}
    )
    ax = plot_areas(table, {"measured": fit_power_law(load, load * 1e-6)})
    points = ax.containers[0].lines[0]
    assert points.get_xdata().tolist() == pytest.approx([100, 200, 400])
    assert points.get_ydata().tolist() == pytest.approx([0.1, 0.2, 0.4])
    assert set(labels(ax)) == {"measured, $m$ = 1", "Greenwood-Tripp", "power law fitted to the points"}
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    below = ax.figure.axes[1]
    assert "mN" in below.get_xlabel()
    assert "mm²" in ax.get_ylabel()
    assert "%" in below.get_ylabel()


def test_curves_that_coincide_part_in_the_panel_below():
    load = np.array([0.1, 0.2, 0.4])
    law = fit_power_law(load - 0.01, load - 0.01)  # of a load cell that reads 10 mN too much
    models = {"measured": 1.0, "coupled": 1.01, "uncoupled": 0.99}
    parts = [AREA.conform({"model": [name] * 3, "load_N": load, "area_m2": share * (load - 0.01)})
             for name, share in models.items()]  # fmt: skip
    ax = plot_areas(pd.concat(parts), {"measured": dataclasses.replace(law, zero=0.01)})
    below = ax.figure.axes[1]
    away = [container.lines[0].get_ydata() for container in below.containers]
    for found, share in zip(away, models.values(), strict=True):
        assert found.tolist() == pytest.approx([100 * (share - 1)] * 3, abs=1e-9)
    assert below.get_shared_x_axes().joined(ax, below)
    assert len(plot_areas(parts[0], {}).figure.axes) == 1  # without a law there is nothing to differ from


def test_profile_shows_hertz_as_a_curve_and_leaves_out_unknown_pressures():
    table = NORMALISED.conform(
        {
            "model": ["measured", "measured", "hertz", "coupled"],
            "load_N": [0.2] * 4,
            "r_over_hertz_radius": [0.1, 0.3, 0.1, 0.1],
            "pressure_over_hertz": [0.7, np.nan, 0.99, np.nan],
        }
    )
    ax = plot_profile(table)
    measured, hertz = (container.lines[0] for container in ax.containers)
    assert (measured.get_xdata().tolist(), measured.get_ydata().tolist()) == ([0.1], [0.7])
    assert (hertz.get_ydata()[0], hertz.get_ydata()[-1]) == (1.0, 0.0)
    assert "200 mN" in ax.get_legend().get_title().get_text()
    assert labels(ax) == ["measured", "Hertz"]


@pytest.mark.parametrize("density", [np.nan, 2e7])
def test_density_is_over_the_asperities_where_they_are_known(density):
    p = np.geomspace(1e2, 1e4, 8)
    eta = 1e7 * (p / 1e4) ** 0.4
    table = PRESSURE_LAW.conform(
        {"model": ["measured"] * 8, "pressure_Pa": p, "density_per_m2": eta, "density_ratio": eta / density}
    )
    laws = {("density", "measured"): fit_broken_law(p, eta, y_std=0.1 * eta)}
    ax = plot_pressure_law(table, laws, "density")
    last = ax.containers[0].lines[0].get_ydata()[-1]
    assert last == pytest.approx(10.0 if np.isnan(density) else 0.5)  # per mm², or 1e7/2e7
    law = next(line for line in ax.lines if len(line.get_xdata()) == 100)
    assert law.get_ydata()[-1] == pytest.approx(last, rel=1e-6)
    assert ("mm²" in ax.get_ylabel()) == bool(np.isnan(density))
    assert any("$m$ = 0.400" in label for label in labels(ax))


def test_a_supported_break_is_named():
    p = np.geomspace(1.0, 1e4, 20)
    a = 1e-5 * np.where(p < 50, (p / 50) ** 0.37, (p / 50) ** 0.2)
    table = PRESSURE_LAW.conform({"model": ["coupled"] * 20, "pressure_Pa": p, "mean_radius_m": a})
    laws = {("mean_radius", "coupled"): fit_broken_law(p, a, y_std=1e-3 * a)}
    ax = plot_pressure_law(table, laws, "mean_radius")
    assert any("$p^{0.37}$, $p^{0.20}$, $p^*$ = 0.05 kPa" in label for label in labels(ax))
    assert "µm" in ax.get_ylabel()


def test_friction_is_drawn_against_the_area_with_the_smooth_contact_beside_it():
    area, force = np.array([2e-7, 1e-7]), [-0.1, 0.05]
    table = FRICTION.conform({"load_N": [0.2, 0.1], "friction_N": force, "area_m2": area, "area_std_m2": 0.0})
    ax = plot_friction(table, fit_shear_stress(table), Estimate(0.25e6, 0, 0, 0))
    rough, smooth = (line.get_xydata() for line in ax.lines[:2])
    points = ax.containers[0].lines[0].get_xydata()
    assert points.ravel().tolist() == pytest.approx([0.2, 100, 0.1, 50])  # without the direction
    assert rough[1, 1] / rough[1, 0] == pytest.approx(500)  # mN/mm² of 0.5 MPa
    assert smooth[1, 1] / smooth[1, 0] == pytest.approx(250)
    assert "smooth contact, 0.25 MPa" in labels(ax)
    below = ax.figure.axes[1]
    assert "mm²" in below.get_xlabel()
    assert below.containers[0].lines[0].get_ydata().tolist() == pytest.approx([0, 0], abs=1e-9)


def test_static_forces_and_sliding_are_told_apart():
    speed = {"velocity_m_s": [0.0, 5e-4, np.nan], "friction_N": [0.2, 0.1, 0.1], "area_m2": [2e-7] * 3}
    table = FRICTION.conform(speed)
    assert motion_of(table).tolist() == ["static", "sliding", "friction"]
    assert set(motion_of(table.drop(columns="velocity_m_s"))) == {"friction"}
    ax = plot_friction(table, fit_shear_stress(table), None)
    assert labels(ax)[1:] == ["sliding", "static", "friction"]
    marks = [container.lines[0].get_marker() for container in ax.containers]
    assert len(set(marks)) == 3


@pytest.mark.parametrize("one_angle", [True, False])
def test_topography_has_a_line_only_if_there_is_one_angle(one_angle):
    radius = np.linspace(30e-6, 90e-6, 12)
    height = radius * (1 - np.cos(np.radians(57))) if one_angle else np.tile([9e-6, 10e-6], 6)
    table = TOPOGRAPHY.conform(pd.DataFrame({"height_m": height, "radius_m": radius}))
    ax = plot_topography(table, describe_topography(table))
    assert ax.containers[0].lines[0].get_xdata().tolist() == pytest.approx((radius * 1e6).tolist())
    assert len(labels(ax)) == 1 + one_angle
    assert any("57" in label for label in labels(ax)) == one_angle
