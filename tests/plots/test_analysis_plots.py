"""Curves: what is drawn, in which units, and what the legend says."""

import numpy as np
import pandas as pd
import pytest

from contactimg.analysis.broken_power_laws import fit_broken_law
from contactimg.analysis.estimates import Estimate
from contactimg.analysis.friction import fit_shear_stress
from contactimg.analysis.power_laws import fit_power_law
from contactimg.analysis.topography import describe_topography
from contactimg.plots import plot_areas, plot_friction, plot_pressure_law, plot_profile, plot_topography
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
    assert labels(ax) == ["measured, $m$ = 1.000 ± 0.000", "Greenwood-Tripp"]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert "mN" in ax.get_xlabel()
    assert "mm²" in ax.get_ylabel()


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
    assert "200 mN" in ax.get_title()
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
    assert any("p^{0.400" in label for label in labels(ax))


def test_a_supported_break_is_named():
    p = np.geomspace(1.0, 1e4, 20)
    a = 1e-5 * np.where(p < 50, (p / 50) ** 0.37, (p / 50) ** 0.2)
    table = PRESSURE_LAW.conform({"model": ["coupled"] * 20, "pressure_Pa": p, "mean_radius_m": a})
    laws = {("mean_radius", "coupled"): fit_broken_law(p, a, y_std=1e-3 * a)}
    ax = plot_pressure_law(table, laws, "mean_radius")
    assert any("$p^{0.37}$, $p^{0.20}$, $p^*$ = 50 Pa" in label for label in labels(ax))
    assert "µm" in ax.get_ylabel()


def test_friction_is_in_millinewtons_with_the_smooth_contact_beside_it():
    table = FRICTION.conform(
        {"load_N": [0.2, 0.1], "friction_N": [-0.1, 0.05], "area_m2": [2e-7, 1e-7], "area_std_m2": [0, 0]}
    )
    ax = plot_friction(table, fit_shear_stress(table), Estimate(0.25e6, 0, 0, 0))
    measured, rough, smooth = (line.get_ydata().tolist() for line in ax.lines)
    assert measured == pytest.approx([50, 100])  # by load, without the direction
    assert rough == pytest.approx([50, 100])
    assert smooth == pytest.approx([25, 50])
    assert labels(ax)[2] == "smooth contact, 0.250 MPa"


@pytest.mark.parametrize("one_angle", [True, False])
def test_topography_has_a_line_only_if_there_is_one_angle(one_angle):
    radius = np.linspace(30e-6, 90e-6, 12)
    height = radius * (1 - np.cos(np.radians(57))) if one_angle else np.tile([9e-6, 10e-6], 6)
    table = TOPOGRAPHY.conform(pd.DataFrame({"height_m": height, "radius_m": radius}))
    ax = plot_topography(table, describe_topography(table))
    assert ax.containers[0].lines[0].get_xdata().tolist() == pytest.approx((radius * 1e6).tolist())
    assert (ax.get_legend() is not None) == one_angle
    if one_angle:
        assert "57.0" in labels(ax)[0]
