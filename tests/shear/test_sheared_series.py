"""A sheared series as a user runs it: asperities.csv, upper limits, laws and figures against the truth."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers import sheared_series as series

from contactimg import tables
from contactimg.cli import main
from contactimg.files import open_experiment, read_scene
from contactimg.pipeline.analyse.analysis import AnalysisOptions, analyse_places
from contactimg.pipeline.frame import FrameOptions, film_setting, measure_scene_frame
from contactimg.pipeline.pooled_background import contacts_of


@pytest.fixture(scope="module")
def sheared(tmp_path_factory):
    """The small series, its analysis, the run and the truth."""
    folder = tmp_path_factory.mktemp("sheared") / "series"
    folder.mkdir()
    return folder, *series.analysed(folder, series.SMALL)


def test_contacts_are_followed_and_displacements_found(sheared):
    _, analysis, place, truth = sheared
    followed = analysis.sheared.followed
    # every asperity that touches in some frame, in every frame, and no contact that is none
    assert len(followed) == 4 * followed["asperity"].nunique() >= 4 * 28
    both = series.with_truth(followed, truth)
    assert both.loc[both["touches"], "x_m_true"].notna().all()
    assert place.contacts["asperity"].notna().all()
    # contacts have moved by twice the distance up to which they are paired without a common shift
    assert followed["displacement_x_m"].max() > 30e-6
    moved = both[both["moved"] & (both["radius_px"] >= series.RESOLVED_PX)]
    assert len(moved) > 40
    rms = np.sqrt(np.mean(moved[["error_x_m", "error_y_m"]].to_numpy() ** 2))
    assert rms < 0.05


def test_half_axes_lie_within_their_uncertainties(sheared):
    _, _, place, truth = sheared
    errors = series.axis_errors(place.contacts, truth)
    for name in ("along", "across"):
        z = errors[name].dropna()
        # some 100 values: 68 +- 4.7 % and 95 +- 2.2 %, three times
        assert len(z) > 80
        assert 0.54 < (z.abs() < 1).mean() < 0.83
        assert (z.abs() < 1.96).mean() > 0.88


def test_upper_limits_hold_and_are_below_the_detection_limit(sheared):
    _, analysis, place, truth = sheared
    both = series.with_truth(analysis.sheared.followed, truth)
    away = both[~both["touches"]]
    assert len(away) >= 8
    held = away["radius_upper_m"] >= away["radius_m_true"].fillna(0.0)
    # 95 % of n, less three standard deviations
    assert held.mean() > 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(away))
    assert both.loc[both["touches"], "radius_upper_m"].isna().all()
    detected = place.frames["detection_limit_px"].max() * series.PIXEL
    assert away["radius_upper_m"].median() < detected


def test_beta_exponent_and_strength_lie_within_their_intervals(sheared):
    _, analysis, _, truth = sheared
    rows = {row[0]: row[1] for row in analysis.sheared.rows()}
    true = {
        "shear_beta": series.BETA,
        "shear_rate_exponent": -1.5,
        "shear_strength_at_largest": series.true_strength(truth, series.SMALL),
    }
    for name, value in true.items():
        # 95 % intervals; half as wide again, of three on one seed
        reach = 1.5 * (rows[name].high - rows[name].low) / 2
        assert abs(rows[name].value - value) < reach, name
    # across the load the axis stays, along it it shrinks: beta sum(A)^-2 Q^2 A^2 A^(-5/2) a = const
    along, across = rows["shear_axis_along_rate"], rows["shear_axis_across_rate"]
    total = rows["shear_area"].value
    assert along.value == pytest.approx(series.BETA / np.sqrt(np.pi) / total**2, abs=4 * along.std)
    assert abs(across.value) < 4 * across.std


def test_ellipses_are_not_divided_out_of_a_pooled_background_as_disks(sheared):
    folder, _, place, _ = sheared
    experiment = open_experiment(read_scene(folder))
    part = measure_scene_frame(
        experiment.frames[2].read(),
        experiment.references[0].read().image,
        options=FrameOptions(place.scene, film_setting(place.scene, None)),
    )
    shapes, view = (
        part.contacts["shape"],
        contacts_of(part, FrameOptions(place.scene, film_setting(place.scene, None))),
    )
    assert (shapes == "ellipse").sum() > 20
    assert len(view.disks) == (shapes == "disk").sum() > 0
    assert len(view.hidden) == (shapes == "ellipse").sum() + len(part.tables.rejected)


def test_analyse_writes_the_table_and_figures(sheared, tmp_path):
    folder = sheared[0]
    assert (
        main(["analyse", str(folder / "contactimg_out"), "-o", str(tmp_path), "--no-models", "--quiet"]) == 0
    )
    table = pd.read_csv(tmp_path / "asperities.csv")
    assert table.columns.tolist() == list(tables.FOLLOWED.first)
    assert table["touches"].dtype == bool
    assert sorted(table["time_s"].unique()) == [0.0, 0.5, 1.0, 1.5]
    numbers = pd.read_csv(tmp_path / "results.csv").set_index("quantity").loc["shear_beta"]
    assert (numbers["unit"], numbers["confidence"]) == ("m5/N2", 0.95)
    assert numbers["low"] < numbers["value"] < numbers["high"]
    assert (tmp_path / "sheared_areas.svg").exists()


def test_without_images_the_limit_is_that_of_detection(sheared):
    place = replace(sheared[2], experiment=None)
    found = analyse_places([place], AnalysisOptions(models=False)).sheared
    away = found.followed[~found.followed["touches"]]
    limits = place.frames.set_index("frame")["detection_limit_px"] * place.pose.pixel_size
    assert away["radius_upper_m"].to_numpy() == pytest.approx(away["frame"].map(limits).to_numpy())
