"""Runs analysed together, as a user does it: tables, numbers, figures, and the hard cases."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_series import copy_of

from contactimg import tables
from contactimg.cli import main
from contactimg.files import read_scene, write_scene
from contactimg.pipeline.analyse.analysis import AnalysisOptions, analyse_places, result_rows
from contactimg.pipeline.analyse.places import differences, open_place
from contactimg.pipeline.analyse.places import read_centre as read_centre_of

QUICK = ["--no-pictures", "--quiet", "--workers", "1"]


@pytest.fixture(scope="module")
def run(small_series, tmp_path_factory):
    """A run of the small series."""
    folder = tmp_path_factory.mktemp("analysis") / "run"
    assert main(["process", str(small_series), "-o", str(folder), *QUICK]) == 0
    return folder


@pytest.fixture(scope="module")
def alone(run):
    """The analysis of that run without models."""
    return analyse_places([open_place(run)], AnalysisOptions(models=False))


def analyse(*arguments):
    return main(["analyse", *map(str, arguments), "--quiet"])


def results(folder):
    table = pd.read_csv(folder / "results.csv")
    return table.set_index(["quantity", "model"])


def change_frames(run, target, **columns):
    """A copy of a run with other values in its frames table."""
    shutil.copytree(run, target)
    table = pd.read_csv(target / "frames.csv")
    table.assign(**columns).to_csv(target / "frames.csv", index=False)
    return target


def test_analysis_leaves_tables_figures_and_where_they_come_from(run, tmp_path):
    out = tmp_path / "out"
    assert analyse(run, "-o", out, "--workers", "1") == 0
    schemas = {
        schema.name: schema
        for schema in (tables.AREA, tables.PROFILE, tables.NORMALISED, tables.PRESSURE_LAW, tables.RESULTS)
    } | {"asperities": tables.FOLLOWED.and_later()}
    assert {path.stem for path in out.glob("*.csv")} == set(schemas)
    for name, schema in schemas.items():
        assert pd.read_csv(out / f"{name}.csv").columns.tolist() == list(schema.columns)
    figures = {"area", "profile_1", "profile_2", "profile_3", "density", "mean_radius"}
    assert {path.stem for path in out.glob("*.svg")} == figures
    record = json.loads((out / "provenance.json").read_text(encoding="utf-8"))
    assert record["configuration"]["options"]["annulus_mm"] == 0.25
    assert {Path(entry["path"]).name for entry in record["inputs"]} == {
        "contacts.csv",
        "frames.csv",
        "provenance.json",
    }


def test_measured_and_rendered_contacts_say_the_same(run):
    # the frames were rendered from the contacts of the coupled model
    found = analyse_places([open_place(run)], AnalysisOptions())
    measured, own = (found.area_laws[model].exponent for model in ("measured", "coupled"))
    assert abs(measured.value - own.value) < own.std
    table = found.profile.set_index(["frame", "r_m"])
    pair = table[table["model"] == "measured"].join(table[table["model"] == "coupled"].add_suffix("_own"))
    away = (pair["pressure_Pa"] - pair["pressure_Pa_own"]).abs()
    assert (away <= pair["pressure_std_Pa"]).all()
    # at the lowest load the image holds every annulus: pressure times area is the load
    first = found.profile[(found.profile["frame"] == "frame_1.tif") & (found.profile["model"] == "coupled")]
    area = 2 * np.pi * first["r_m"] * 2.5e-4
    assert np.sum(first["pressure_Pa"] * area) == pytest.approx(0.005, rel=1e-9)


def test_two_places_alike_are_one_place_twice(run, alone, tmp_path):
    twin = tmp_path / "twin"
    shutil.copytree(run, twin)
    other = replace(open_place(twin), images=frozenset())  # as if it showed other frames
    both = analyse_places([open_place(run), other], AnalysisOptions(models=False))
    pd.testing.assert_series_equal(both.area["area_m2"], alone.area["area_m2"])
    np.testing.assert_allclose(both.profile["pressure_Pa"], alone.profile["pressure_Pa"], rtol=1e-12)
    assert both.area["n_places"].tolist() == [2, 2, 2]
    assert both.area["area_scatter_m2"].tolist() == [0.0, 0.0, 0.0]
    # the same points twice: independent, as far as counting knows
    measured = both.profile["model"] == "measured"
    np.testing.assert_allclose(
        both.profile["pressure_std_Pa"][measured],
        alone.profile["pressure_std_Pa"][measured] / np.sqrt(2),
        rtol=1e-12,
    )


def with_scene(run, target, section, **keys):
    """A copy of a run, as if of other frames, whose scene states something else."""
    shutil.copytree(run, target)
    record = json.loads((target / "provenance.json").read_text(encoding="utf-8"))
    record["configuration"]["scene"][section] |= keys
    record["inputs"] = []
    (target / "provenance.json").write_text(json.dumps(record), encoding="utf-8")
    return target


@pytest.mark.usefixtures("figures_stay_unwritten")
def test_runs_of_different_lenses_or_surfaces_are_told_apart(run, tmp_path, capsys):
    shutil.copytree(run, tmp_path / "twin")
    assert list(differences([open_place(run), open_place(tmp_path / "twin")])) == []
    other = with_scene(run, tmp_path / "lens", "indenter", radius_m=0.2)
    assert analyse(run, other, "-o", tmp_path / "b", "--no-models") == 0
    assert "[indenter] radius_m is 0.1288 in" in capsys.readouterr().err
    record = json.loads((tmp_path / "b" / "provenance.json").read_text(encoding="utf-8"))
    assert "under one lens" in record["notes"][0]
    one, two = open_place(run), open_place(tmp_path / "twin")
    rough = one.asperities.assign(height_m=10 * one.asperities["height_m"])
    assert "heights above their median" in next(differences([one, replace(two, asperities=rough)]))
    for unknown in (two.asperities.assign(radius_m=np.nan), two.asperities[:0], None):
        assert list(differences([one, replace(two, asperities=unknown)])) == []


def test_a_run_given_twice_is_refused(run, tmp_path, capsys):
    (tmp_path / "link").symlink_to(run)
    for again in (run, f"{run}/", run / ".." / run.name, tmp_path / "link"):
        assert analyse(run, again, "-o", tmp_path / "out") == 2
        assert "are runs of the same frames" in capsys.readouterr().err
    shutil.copytree(run, tmp_path / "twin")  # or the frames were processed twice
    assert analyse(run, tmp_path / "twin", "-o", tmp_path / "out") == 2
    assert "are runs of the same frames" in capsys.readouterr().err
    assert analyse() == 2
    assert "RUN" in capsys.readouterr().err


def test_nothing_to_analyse_is_one_sentence(run, tmp_path, capsys):
    blank = change_frames(run, tmp_path / "blank", load_N=[0.0, np.nan, 0.0])
    assert analyse(blank, "-o", tmp_path / "out") == 2
    assert "no frame was measured at a known load above zero" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_loads_in_any_order_repeated_and_zero(run, tmp_path):
    mixed = change_frames(run, tmp_path / "mixed", load_N=[0.05, 0.0, 0.05])
    found = analyse_places([open_place(mixed)], AnalysisOptions(models=False))
    assert found.area["load_N"].tolist() == [0.05]
    assert found.area[["n_frames", "n_places"]].iloc[0].tolist() == [2, 1]
    assert found.area_laws == {}
    text = "; ".join(found.notes)
    assert "frame_2.tif: left out: its load is not above zero" in text
    assert "two different loads" in text
    measured = found.profile[found.profile["model"] == "measured"]
    assert measured["frame"].unique().tolist() == ["load_0.05N"]


def test_a_loaded_frame_without_contacts_is_named_and_left_out(run):
    place = open_place(run)
    hidden, none = place.frames["frame"] == "frame_2.tif", "nothing stands out of the noise"
    changes = {"status": "no contact", "area_m2": 0.0, "n_contacts": 0, "message": none}
    frames = place.frames.assign(**{name: place.frames[name].mask(hidden, changes[name]) for name in changes})
    contacts = place.contacts[place.contacts["frame"] != "frame_2.tif"]
    found = analyse_places([replace(place, frames=frames, contacts=contacts)], AnalysisOptions(models=False))
    assert found.area["load_N"].tolist() == [0.005, 0.05]
    assert "frame_2.tif" not in set(found.profile["frame"])
    assert f"frame_2.tif: left out: {none}" in "; ".join(found.notes)


def test_frames_used_with_a_reservation_are_named(run, alone):
    place = open_place(run)
    frames = place.frames.assign(status=["ok", "holes", "holes"])
    found = analyse_places([replace(place, frames=frames)], AnalysisOptions(models=False))
    notes = [note for note in found.notes if 'used with the status "holes"' in note]
    assert len(notes) == 1
    assert "2 frames" in notes[0]
    assert "contacts below it are not counted" in notes[0]
    assert not any("used with" in note for note in alone.notes)


def test_one_load_is_analysed_without_an_exponent(run, tmp_path):
    single = change_frames(run, tmp_path / "single", load_N=[np.nan, np.nan, 0.05])
    assert analyse(single, "-o", tmp_path / "out", "--no-models") == 0
    assert "area_exponent" not in results(tmp_path / "out").index.get_level_values(0)
    assert len(pd.read_csv(tmp_path / "out" / "area.csv")) == 1
    assert (tmp_path / "out" / "profile_1.svg").exists()


def test_noise_of_ten_percent_on_the_load_widens_the_interval_and_keeps_the_truth(run, alone, tmp_path):
    clean = alone.area_laws["measured"].exponent
    noisy = change_frames(run, tmp_path / "noisy", load_N=np.array([0.005, 0.02, 0.05]) * [1.1, 0.9, 1.08])
    options = AnalysisOptions(models=False, load_relative_std=0.1)
    exponent = analyse_places([open_place(noisy)], options).area_laws["measured"].exponent
    assert exponent.low < clean.value < exponent.high
    assert exponent.std > clean.std


def test_annuli_without_contacts_and_all_in_one(run):
    fine = analyse_places([open_place(run)], AnalysisOptions(annulus=2e-5, models=False)).profile
    measured = fine[(fine["model"] == "measured") & (fine["frame"] == "frame_1.tif")]
    empty = measured["density_per_m2"] == 0
    assert empty.any()
    assert (measured["pressure_Pa"][empty] == 0).all()
    assert measured["mean_radius_m"][empty].isna().all()
    wide = analyse_places([open_place(run)], AnalysisOptions(annulus=1e-2, models=False))
    assert wide.profile[wide.profile["model"] == "measured"].groupby("frame").size().tolist() == [1, 1, 1]
    assert wide.contact_laws == {}


def test_a_failed_frame_is_named_and_left_out(small_series, tmp_path):
    series = copy_of(small_series, tmp_path / "series")
    (series / "frame_2.tif").write_bytes(b"no image")
    assert main(["process", str(series), "-o", str(tmp_path / "run"), *QUICK]) == 1
    found = analyse_places([open_place(tmp_path / "run")], AnalysisOptions(models=False))
    assert found.area["load_N"].tolist() == [0.005, 0.05]
    assert any("frame_2.tif: left out" in note for note in found.notes)


def test_a_table_of_asperities_that_is_gone_is_named(run):
    found = analyse_places([replace(open_place(run), asperities=None)], AnalysisOptions())
    models = [note for note in found.notes if "no model curves" in note]
    assert len(models) == 1
    assert "asperities.csv, which cannot be read" in models[0]
    assert "lens" not in models[0]


def without_asperities(series):
    """Hide the asperities from the scene, as on a rough lens."""
    scene = dict(read_scene(series).source)
    scene["asperities"] = {"textured": "rigid", "density_per_m2": 1.75e7}
    write_scene(scene, series / "scene.toml")


@pytest.fixture(scope="module")
def rough_lens(small_series, tmp_path_factory):
    """A run without radii, with friction of 0.4 MPa."""
    top = tmp_path_factory.mktemp("rough")
    series = copy_of(small_series, top / "series")
    without_asperities(series)
    truth = pd.read_csv(series / "truth.csv").groupby("frame")["area_m2"].sum()
    loads = pd.read_csv(series / "loads.csv")
    loads.assign(friction_N=0.4e6 * truth[loads["frame"]].to_numpy(), velocity_m_s=5e-4).to_csv(
        series / "loads.csv", index=False
    )
    assert main(["process", str(series), "-o", str(top / "run"), *QUICK]) == 0
    return top / "run"


def test_unknown_radii_give_areas_and_densities_but_no_pressures(rough_lens, tmp_path):
    out = tmp_path / "out"
    assert analyse(rough_lens, "-o", out) == 0
    profile = pd.read_csv(out / "profile.csv")
    measured = profile[profile["model"] == "measured"]
    assert measured["pressure_Pa"].isna().all()
    assert (measured["density_per_m2"] > 0).any()
    assert not list(out.glob("profile_*.svg"))
    area = pd.read_csv(out / "area.csv")
    # L = 1/sqrt(1.75e7) = 239 um
    np.testing.assert_allclose(area["spacing_over_radius"] * area["mean_radius_m"], 1.75e7**-0.5, rtol=1e-12)
    notes = json.loads((out / "provenance.json").read_text(encoding="utf-8"))["notes"]
    assert any("no model curves" in note for note in notes)
    assert any("has a force" in note for note in notes)


def test_friction_gives_the_shear_stress_and_its_ratio(rough_lens, tmp_path):
    assert analyse(rough_lens, "-o", tmp_path / "out", "--smooth", rough_lens) == 0
    table = results(tmp_path / "out")
    stress, ratio = (table.loc[(name, "measured")] for name in ("shear_stress", "shear_stress_ratio"))
    assert stress["low"] < 0.4e6 < stress["high"]
    # areas are measured to a few percent at the lowest load and better above
    assert stress["value"] == pytest.approx(0.4e6, rel=0.02)
    assert ratio["value"] == pytest.approx(1.0)
    assert ("shear_stress_velocity_exponent", "measured") not in table.index  # one velocity
    assert len(pd.read_csv(tmp_path / "out" / "friction.csv")) == 3
    assert (tmp_path / "out" / "friction.svg").exists()


def test_friction_at_several_velocities_gives_an_exponent(rough_lens):
    place = open_place(rough_lens)
    slid = place.loads["frame"].isin(place.frames["frame"])
    speed = np.geomspace(1e-5, 1e-3, int(slid.sum()))
    area = place.loads["frame"].map(place.frames.set_index("frame")["area_m2"])
    loads = place.loads.assign(velocity_m_s=np.nan)
    loads.loc[slid, "velocity_m_s"] = speed
    loads = loads.assign(friction_N=4e5 * area * (loads["velocity_m_s"] / 1e-4) ** 0.1)
    law = analyse_places([replace(place, loads=loads)], AnalysisOptions(models=False)).velocity_law
    assert law.exponent.value == pytest.approx(0.1, abs=1e-6)
    none = analyse_places(
        [replace(place, loads=loads.assign(velocity_m_s=np.nan))], AnalysisOptions(models=False)
    )
    assert none.velocity_law is None


def calibration(path, **centre):
    record = {name: {"value": value, "std": 0.1, "unit": "px"} for name, value in centre.items()}
    path.write_text(json.dumps(record), encoding="utf-8")
    return path


def test_a_calibrated_centre_moves_the_annuli(run, alone, tmp_path, capsys):
    pose = open_place(run).pose
    x_px, y_px = pose.to_pixels(0.0011, 0.00095)
    file = calibration(tmp_path / "calibration.json", centre_x=float(x_px), centre_y=float(y_px))
    place = open_place(run, centre_px=read_centre_of(file))
    assert place.centre == pytest.approx((0.0011, 0.00095), rel=1e-9)
    assert place.scene.indenter.apex == place.centre  # the models press there too
    moved = analyse_places([place], AnalysisOptions(models=False))
    assert moved.profile["pressure_Pa"].iloc[0] != alone.profile["pressure_Pa"].iloc[0]
    assert analyse(run, "-o", tmp_path / "moved", "--calibration", tmp_path, "--no-models") == 0
    bare = calibration(tmp_path / "bare.json", threshold=0.5)
    assert analyse(run, "-o", tmp_path / "none", "--calibration", bare) == 2
    assert "centre_x" in capsys.readouterr().err


@pytest.fixture(scope="module")
def model(small_series, tmp_path_factory):
    """A prediction at the loads of the series."""
    loads = [part for load in (0.005, 0.02, 0.05) for part in ("--load-N", str(load))]
    folder = tmp_path_factory.mktemp("prediction") / "model"
    assert main(["predict", str(small_series), *loads, "-o", str(folder), "--quiet"]) == 0
    return folder


@pytest.mark.slow
def test_a_prediction_can_be_analysed_like_a_measurement(model):
    found = analyse_places([open_place(model)], AnalysisOptions())
    for name in ("exponent", "amplitude"):
        predicted, own = (getattr(found.area_laws[model], name).value for model in ("predicted", "coupled"))
        assert predicted == pytest.approx(own, rel=1e-9)


def test_what_was_predicted_is_not_called_measured(run, model, tmp_path, capsys):
    found = analyse_places([open_place(model)], AnalysisOptions(models=False))
    for table in (found.area, found.profile, found.normalised, found.pressure_law, result_rows(found)):
        models = set(table["model"])
        assert "predicted" in models
        assert models <= {"predicted", "hertz"}
    assert analyse(model, run, "-o", tmp_path / "both") == 2
    assert "measured and predicted runs are given together" in capsys.readouterr().err


def test_averages_of_a_statistical_model_are_predicted_areas(small_series, tmp_path):
    loads = [part for load in (0.02, 0.05) for part in ("--load-N", str(load))]
    model = tmp_path / "model"
    words = ["predict", str(small_series), *loads, "--model", "gt", "-o", str(model), "--quiet"]
    assert main(words) == 0
    areas = analyse_places([open_place(model)], AnalysisOptions(models=False)).area
    assert areas["model"].tolist() == ["predicted", "predicted"]
    np.testing.assert_allclose(areas["area_m2"], pd.read_csv(model / "frames.csv")["area_m2"], rtol=1e-12)


@pytest.mark.slow
def test_what_the_camera_cannot_show_must_not_count_on_one_side(run):
    def contacts(smallest):
        options = AnalysisOptions(annulus=1e-2, min_radius_px=smallest)
        table = analyse_places([open_place(run)], options).profile
        return table.set_index(["model", "frame"])["density_per_m2"]

    fair, naive = contacts(1.0), contacts(0.0)
    # two of some fifty contacts may lie at the limit itself
    np.testing.assert_allclose(fair["measured"], fair["coupled"], rtol=0.1)
    assert (naive["coupled"] >= naive["measured"]).all()
    assert naive["coupled"].sum() > fair["coupled"].sum()
