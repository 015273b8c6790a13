"""``contactimg calibrate`` from folders of frames to calibration.json, and `process` with it."""

import hashlib
import json

import numpy as np
import pandas as pd
import pytest
from small_series import break_measurement, copy_of

import contactimg.effects.render_without as optics_module
from contactimg.analysis.estimates import CoverageEstimate
from contactimg.calibration.jkr import mean_centre
from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import (
    list_frames,
    open_experiment,
    read_calibration,
    read_frames,
    read_scene,
    write_frame,
    write_scene,
)
from contactimg.frame import Frame
from contactimg.pipeline.calibrate import thresholds
from contactimg.pipeline.calibrate.jkr import measure_circles
from contactimg.pipeline.calibrate.thresholds import measure_thresholds
from contactimg.pipeline.results import frame_notes
from contactimg.pipeline.series import measure_parts
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict

E, W = 2.83e6, 0.043
SMOOTH = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.005, 0.005]},
    "elastic": {"young_modulus_Pa": E, "work_of_adhesion_J_m2": W},
    "camera": {"pixel_size_m": 24e-6, "centre_m": [0.00507, 0.00494]},
    "effects": {"film": "on"},
    "simulate": {
        "loads_N": [0.2, -0.01, 0.0, 0.05, 0.5, 0.02],
        "shape": [270, 300],
        "contrast_levels": 60.0,
        "texture": 0.01,
        "dust_count": 10,
        "position_drift_px": 0.3,
        "electrons_per_level": 20,
        "read_noise_electrons": 10,
        "seed": 11,
    },
}


SHARP = SMOOTH | {
    "camera": SMOOTH["camera"] | {"pixel_size_m": 48e-6},
    "effects": {"film": "off"},
    "simulate": SMOOTH["simulate"] | {"shape": [135, 150]},
}


def write_smooth(folder, scene):
    """Frames of a smooth contact; the scene beside them says nothing of modulus and adhesion."""
    folder.mkdir()
    write_simulation(scene_from_dict(scene), None, folder)
    made = read_scene(folder).source
    told = {name: made[name] for name in ("indenter", "camera", "images")}
    write_scene(told if scene is SMOOTH else told | {"effects": scene["effects"]}, folder / "scene.toml")
    return folder


@pytest.fixture(scope="module")
def smooth_frames(tmp_path_factory):
    """With an air film, whose opening is fitted."""
    return write_smooth(tmp_path_factory.mktemp("smooth") / "frames", SMOOTH)


@pytest.fixture(scope="module")
def sharp_frames(tmp_path_factory):
    """Without a film, and with half as many pixels across, which takes a fraction of the time."""
    return write_smooth(tmp_path_factory.mktemp("sharp") / "frames", SHARP)


@pytest.fixture(scope="module")
def jkr_result(smooth_frames, tmp_path_factory):
    """Result of `calibrate jkr` on the frames with a film."""
    out = tmp_path_factory.mktemp("jkr") / "out"
    assert run("calibrate", "jkr", smooth_frames, "-o", out, "--quiet", "--workers", 1) == 0
    return out


@pytest.fixture(scope="module")
def threshold_result(small_series, tmp_path_factory):
    """Result of `calibrate threshold` on the small series, by the pixel count."""
    top = tmp_path_factory.mktemp("threshold")
    folder = copy_of(small_series, top / "frames")
    with_scene(folder, measure={"method": "threshold"})
    assert main(["calibrate", "threshold", str(folder), "-o", str(top / "out"), "--quiet"]) == 0
    return folder, top / "out"


def test_a_remark_on_all_frames_is_said_once():
    frames = pd.DataFrame({"frame": ["a.tif", "b.tif", "c.tif"], "message": "no reference"})
    assert frame_notes(frames) == ["3 frames: no reference"]


def test_nothing_is_said_of_the_brightness_of_a_contact_that_shows_its_plateau(jkr_result):
    assert not [note for note in read_calibration(jkr_result)["notes"] if "their brightness" in note]


def with_scene(folder, **sections):
    source = {name: dict(keys) for name, keys in read_scene(folder).source.items()}
    for name, keys in sections.items():
        source[name] = source.get(name, {}) | keys
    write_scene(source, folder / "scene.toml")


def run(*words):
    return main([str(word) for word in words])


def refusal(capsys, *words):
    assert run(*words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def within(entry, truth):
    return entry["low_95"] <= truth <= entry["high_95"]


def test_jkr_finds_what_the_scene_hides(smooth_frames, jkr_result):
    record = read_calibration(jkr_result)
    # exact loads, radii to some hundredths of a pixel of 24 um on 55-120 px: 5e-4 of a, three times that in E
    assert record["young_modulus"]["value"] == pytest.approx(E, rel=2e-3)
    assert record["work_of_adhesion"]["value"] == pytest.approx(W, rel=5e-3)
    pose = scene_from_dict(SMOOTH).pose((270, 300))
    x, y = pose.to_pixels(0.005, 0.005)
    assert (record["centre_x"]["value"], record["centre_y"]["value"]) == pytest.approx((x, y), abs=0.2)
    assert (record["young_modulus"]["unit"], record["work_of_adhesion"]["unit"]) == ("Pa", "J/m^2")
    names = {"young_modulus", "work_of_adhesion", "centre_x", "centre_y", "edge_shift"}
    assert set(record["fitted"]) == names
    assert within(record["edge_shift"], 0.0)  # exact loads settle it to 0.1 px
    assert record["fixed"] == {"sphere_radius_m": 0.1288, "poisson_ratio": 0.5}
    assert {"jkr.svg", "circles.csv"} <= {path.name for path in jkr_result.iterdir()}
    circles = pd.read_csv(jkr_result / "circles.csv")
    truth = pd.read_csv(smooth_frames / "truth.csv")
    assert (circles["radius_px"] - truth["radius_px"]).abs().max() < 0.05


def test_options_take_the_place_of_keys_as_in_process(sharp_frames, tmp_path):
    folder = copy_of(sharp_frames, tmp_path / "frames")
    frames = ("--frames", "frame_[145].tif", "--quiet", "--workers", 1)
    with_scene(folder, images={"reference": "reference.tif", "frames": "frame_*.tif", "loads": "loads.csv"})
    (folder / "reference.tif").rename(folder / "light.tif")
    (folder / "loads.csv").rename(tmp_path / "forces.csv")
    scene = read_scene(folder).source
    pixel_um = scene["camera"]["pixel_size_m"] * 1e6
    options = (
        "--reference",
        folder / "light.tif",
        "--loads",
        tmp_path / "forces.csv",
    )
    options = (*options, "--pixel-size-um", pixel_um, "--polarity", "bright", *frames)
    write_scene({name: scene[name] for name in ("indenter", "effects")}, folder / "scene.toml")
    assert run("calibrate", "jkr", folder, "-o", tmp_path / "out", *options) == 0
    assert run("calibrate", "jkr", sharp_frames, "-o", tmp_path / "as_ever", *frames) == 0
    given, stated = (read_calibration(tmp_path / name)["young_modulus"] for name in ("out", "as_ever"))
    assert given["value"] == pytest.approx(stated["value"], rel=1e-12)


def test_jkr_says_so_where_the_opening_of_the_film_is_chance(jkr_result):
    record = read_calibration(jkr_result)
    assert record["quality"]["film_opening_doubt"] > 0.1
    for name, truth in (("young_modulus", E), ("work_of_adhesion", W)):
        assert abs(record[name]["value"] - truth) < 3 * record[name]["std"]


def test_one_bad_frame_is_named_and_the_others_count(sharp_frames, tmp_path, capsys):
    folder = copy_of(sharp_frames, tmp_path / "frames")
    bad = next(source for source in list_frames(folder) if source.name == "frame_4.tif")
    frame = bad.read()
    write_frame(Frame(np.zeros_like(frame.image), frame.name, frame.full_scale), bad.path)
    assert run("calibrate", "jkr", folder, "-o", tmp_path / "out", "--workers", 1) == 1
    assert "frame_4.tif" in capsys.readouterr().out
    record = read_calibration(tmp_path / "out")
    assert record["young_modulus"]["value"] == pytest.approx(E, rel=2e-3)
    assert record["quality"]["frames_used"] == 5


def test_a_circle_half_of_which_no_light_reaches_is_measured_on_the_other_half(sharp_frames, tmp_path):
    folder = copy_of(sharp_frames, tmp_path / "frames")
    truth = pd.read_csv(folder / "truth.csv")
    dark = int(truth["x_px"].min()) - 12
    for path in (*folder.glob("frame_*.tif"), folder / "reference.tif"):
        (source,) = list_frames(path)
        frame = source.read()
        image = frame.image.copy()
        image[:, :dark] = 0
        write_frame(Frame(image, frame.name, frame.full_scale), path)
    found = measure_circles(open_experiment(read_scene(folder), pulled=True)).table
    off = found["radius_px"] - truth["radius_px"]
    assert (off.abs() < 5.0 * found["radius_std_m"] / 48e-6).all()
    assert (found["arc"] < 0.6).all()


def test_calibrations_prepare_frames_as_process_does(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "frames")
    with_scene(folder, measure={"method": "threshold", "threshold": 0.5})
    found = []
    for effects in ({}, {"position_drift": "off", "dust": "off", "saturation": "off"}):
        with_scene(folder, effects=effects)
        experiment = open_experiment(read_scene(folder))
        frames = measure_parts(experiment).run.frames
        series = measure_thresholds(experiment, [0.5])
        columns = ["contrast", "noise", "shift_x_px", "shift_y_px", "n_contacts"]
        pd.testing.assert_frame_equal(series.frames[columns], frames[columns])
        np.testing.assert_allclose(series.areas[0], frames["area_m2"], rtol=1e-12)
        np.testing.assert_allclose(series.forces[0], frames["force_sum_N"], rtol=1e-12)
        found.append(frames)
    assert (found[0]["shift_x_px"] != 0).all()
    assert (found[1]["shift_x_px"] == 0).all()  # the switch changes what is measured


def test_a_bar_counts_at_no_threshold(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "frames")
    for source in open_experiment(read_scene(folder)).frames:
        image = source.read().image.copy()
        image[4:9, 20:330] = np.minimum(image[4:9, 20:330].astype(int) + 90, 255)  # no contact is there
        write_frame(Frame(image), source.path)
    with_scene(folder, measure={"method": "threshold", "threshold": 0.5})
    with_scene(
        folder, effects={"dust": "on"}, images={"frames": "frame_[23].tif"}
    )  # frame_1 shows no plateau
    experiment = open_experiment(read_scene(folder))
    run, series = (
        measure_parts(experiment).run,
        measure_thresholds(experiment, [0.3, 0.5, 0.7]),
    )
    assert run.rejected["reason"].str.startswith("long").sum() == 2
    np.testing.assert_allclose(series.areas[1], run.frames["area_m2"], rtol=1e-12)
    assert (np.diff(series.areas, axis=0) < 0).all()
    assert series.areas.max() < 1.5e-7  # the bar alone covers 5.6e-8 m2 of each frame


def test_circles_are_measured_on_frames_prepared_as_process_does(sharp_frames, tmp_path):
    folder = copy_of(sharp_frames, tmp_path / "frames")
    loads = pd.read_csv(folder / "loads.csv").iloc[[0, 3, 4]]
    loads.to_csv(folder / "loads.csv", index=False)
    with_scene(folder, images={"frames": loads["frame"].tolist()})
    with_scene(folder, effects={"position_drift": "off"}, measure={"method": "threshold"})
    experiment = open_experiment(read_scene(folder))
    circles = measure_circles(experiment).table
    frames = measure_parts(experiment).run.frames
    columns = ["frame", "shift_x_px", "shift_y_px"]
    pd.testing.assert_frame_equal(circles[columns], frames[columns])
    assert (frames["shift_x_px"] == 0).all()


@pytest.mark.parametrize("measure", [measure_circles, measure_thresholds, measure_parts])
def test_full_scale_is_that_of_the_scene_in_every_command(measure, monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(optics_module, "measure_image", lambda *_, **options: seen.append(options) or 1 / 0)
    write_frame(Frame(np.zeros((20, 30), np.uint8)), tmp_path / "frame_1.tif")
    base = {"camera": {"pixel_size_m": 6e-6}, "indenter": {"radius_m": 0.1, "apex_m": [0.0, 0.0]}}
    for switch, full_scale in (("auto", 255), ("off", np.inf)):
        scene = scene_from_dict(base | {"effects": {"saturation": switch}}, folder=str(tmp_path))
        with pytest.raises(InputError, match=r"frame_1.tif: cannot be measured \(ZeroDivisionError: "):
            measure(open_experiment(scene))
        assert seen.pop()["full_scale"] == full_scale


def test_a_frame_that_breaks_a_calibration_is_one_failed_row(small_series, monkeypatch, tmp_path, capsys):
    folder = copy_of(small_series, tmp_path / "frames")
    with_scene(folder, images={"frames": "frame_[23].tif"})
    break_measurement(monkeypatch)
    bad = next(source for source in list_frames(folder) if source.name == "frame_2.tif")
    write_frame(Frame(np.full(bad.read().shape, 7, np.uint8)), bad.path)
    assert run("calibrate", "plateau", folder, "-o", tmp_path / "out", "--workers", 1) == 1
    assert "frame_2.tif: cannot be measured (LinAlgError: singular)" in capsys.readouterr().out


def test_jkr_refusals_say_why(sharp_frames, tmp_path, capsys):
    """One sentence and no folder; `tests/calibration/test_calibration.py` has every refusal."""
    folder = copy_of(sharp_frames, tmp_path / "frames")
    loads = pd.read_csv(folder / "loads.csv").iloc[[0, 3, 4]]
    with_scene(folder, images={"frames": loads["frame"].tolist()})
    loads.assign(load_N=0.1).to_csv(folder / "loads.csv", index=False)
    sentence = "three different loads or more, got 1"
    assert sentence in refusal(capsys, "calibrate", "jkr", folder, "-o", tmp_path / "out", "--quiet")
    assert not (tmp_path / "out").exists()


def test_a_refusal_names_the_frames_that_show_no_circle(sharp_frames, tmp_path, capsys):
    folder = copy_of(sharp_frames, tmp_path / "frames")
    for k in (1, 3, 4, 5):
        (folder / f"frame_{k}.tif").write_bytes((folder / "reference.tif").read_bytes())
    error = refusal(capsys, "calibrate", "jkr", folder, "-o", tmp_path / "out", "--quiet", "--workers", 1)
    assert "three different loads or more, got 2" in error
    assert "4 frames without a circle, the first: frame_1.tif" in error


def test_pulls_mean_nothing_to_process(sharp_frames, tmp_path, capsys):
    error = refusal(capsys, "process", sharp_frames, "-o", tmp_path / "out", "--quiet")
    assert "load_N of frame_2.tif must not be negative, got -0.01" in error


def test_threshold_gives_slope_one(threshold_result):
    _, out = threshold_result
    record = read_calibration(out)
    assert record["slope"]["value"] == pytest.approx(1.0, abs=1e-9)
    assert record["fitted"] == ["threshold"]
    assert record["fixed"]["young_modulus"]["value"] == 3e6
    # frames with a linear edge cross half the contrast at the true radius; small contacts lie a little above
    assert 0.4 < record["threshold"]["value"] < 0.5
    curve = pd.read_csv(out / "curve.csv")
    assert (np.diff(curve["slope"]) < 0).all()
    off = np.interp(record["threshold"]["value"] + 0.1, curve["threshold"], curve["slope"])
    assert off < 0.9  # a threshold that is wrong by 0.1 breaks the slope
    assert {"slope_threshold.svg", "forces.svg"} <= {path.name for path in out.iterdir()}


def test_process_with_the_calibration(threshold_result, tmp_path):
    folder, out = threshold_result
    words = ["process", folder, "--calibration", out / "calibration.json", "-o", tmp_path / "run"]
    assert run(*words, "--quiet", "--no-pictures") == 0
    frames = pd.read_csv(tmp_path / "run" / "frames.csv")
    record = read_calibration(out)
    assert frames["threshold"].unique() == pytest.approx([record["threshold"]["value"]], rel=1e-12)
    slope = (frames["force_sum_N"] @ frames["load_N"]) / (frames["load_N"] @ frames["load_N"])
    # between two thresholds 0.025 apart the slope is taken as linear: 0.025^2/8 of its curvature, about 3.
    # The calibration finds the pose at one half, `process` at the threshold: their pixel sizes differ by
    # 1.6e-4 here, and forces go as its cube. A count changes by steps of a pixel, forces going as A^(3/2)
    pixels = frames["area_m2"].max() / read_scene(folder).source["camera"]["pixel_size_m"] ** 2
    assert slope == pytest.approx(1.0, abs=3e-4 + 5e-4 + 1.5 / pixels)
    provenance = json.loads((tmp_path / "run" / "provenance.json").read_text())
    used = provenance["configuration"]["options"]["calibration"]["record"]
    assert used["threshold"] == record["threshold"]


@pytest.mark.usefixtures("figures_stay_unwritten")
def test_one_load_is_said_to_show_no_scatter(threshold_result, tmp_path, capsys):
    words = ["--frames", "frame_3.tif", "--threshold", "0.5", "-o", tmp_path / "one"]
    assert run("calibrate", "modulus", threshold_result[0], *words) == 0
    assert "one load does not show the scatter" in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("figures_stay_unwritten")
def test_a_calibration_is_handed_on_whole(threshold_result, tmp_path, capsys):
    folder = copy_of(threshold_result[0], tmp_path / "frames")
    with_scene(folder, elastic={"young_modulus_Pa": 2.85e6})
    words = ["--young-modulus-MPa", 3.0, "--young-modulus-std-MPa", 0.1, "-o", tmp_path / "made"]
    assert run("calibrate", "threshold", folder, *words, "--quiet") == 0
    record = read_calibration(tmp_path / "made")
    capsys.readouterr()
    words = ["process", folder, "--calibration", tmp_path / "made", "-o", tmp_path / "run", "--no-pictures"]
    assert run(*words) == 0
    used = "modulus 3 +- 0.1 MPa on the forces; threshold"
    assert used in capsys.readouterr().out
    provenance = json.loads((tmp_path / "run" / "provenance.json").read_text())
    assert provenance["configuration"]["options"]["calibration"]["acts"].startswith(used)
    frames = pd.read_csv(tmp_path / "run" / "frames.csv")
    slope = (frames["force_sum_N"] @ frames["load_N"]) / (frames["load_N"] @ frames["load_N"])
    assert slope == pytest.approx(1.0, abs=3e-3)  # with the 2.85 MPa of the scene 5 % off
    # the threshold's uncertainty is part of that of the area: as much as moving it does
    higher = record["threshold"]["value"] + record["threshold"]["std"]
    words = ["--threshold", higher, "--method", "threshold", "-o", tmp_path / "moved"]
    assert run("process", folder, *words, "--quiet", "--no-pictures") == 0
    moved = pd.read_csv(tmp_path / "moved" / "frames.csv")
    change = (1 - moved["area_m2"] / frames["area_m2"]).to_numpy()
    stated = (frames["area_std_m2"] / frames["area_m2"]).to_numpy()
    assert change.min() > 0.01
    assert (stated > 0.6 * change).all()
    assert stated[-1] == pytest.approx(change[-1], rel=0.4)  # the others do not show their contrast
    # an error of the modulus and that of the threshold found with it partly cancel in a^3 ~ A^1.5
    forces = (frames["force_sum_std_N"] / frames["force_sum_N"]).to_numpy()
    assert forces[-1] < 0.8 * np.hypot(1.5 * stated[-1], 0.1 / 3.0)


def test_modulus_with_the_threshold_of_another_sample(threshold_result, small_series, tmp_path, capsys):
    folder, out = threshold_result
    record = read_calibration(out) | {"frames": []}
    (tmp_path / "calibration.json").write_text(json.dumps(record))
    words = ["calibrate", "modulus", folder, "--young-modulus-MPa", 2.2, "--young-modulus-std-MPa", 0.02]
    words += ["-o", tmp_path / "modulus"]
    assert run(*words, "--calibration", tmp_path) == 0
    assert "outside the measured 2.2 +- 0.02 MPa" in capsys.readouterr().out
    found = read_calibration(tmp_path / "modulus")
    # the slope is interpolated between thresholds 0.025 apart, at which single pixels come and go
    assert found["young_modulus"]["value"] == pytest.approx(3e6, rel=1.5e-3)
    assert found["slope"]["value"] == pytest.approx(2.2 / 3.0, rel=1.5e-3)
    assert found["compatible"] is False


def test_two_samples_may_share_a_dark_frame_but_no_frame(threshold_result, tmp_path, capsys):
    folder = copy_of(threshold_result[0], tmp_path / "frames")
    write_frame(Frame(np.zeros((340, 360), np.uint8)), folder / "dark.tif")
    with_scene(folder, images={"dark": "dark.tif"})
    for name, code in (("dark.tif", 0), ("reference.tif", 2), ("frame_1.tif", 2)):
        used = {"path": name, "sha256": hashlib.sha256((folder / name).read_bytes()).hexdigest()}
        record = read_calibration(threshold_result[1]) | {"frames": [used]}
        (tmp_path / "calibration.json").write_text(json.dumps(record))
        words = ["--calibration", tmp_path, "-o", tmp_path / "modulus", "--frames", "frame_[13].tif"]
        assert run("calibrate", "modulus", folder, *words, "--quiet") == code
    assert "calibrated on another sample" in capsys.readouterr().err


def test_the_modulus_is_that_of_the_forces_of_process_with_their_uncertainty(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "frames")
    with_scene(folder, images={"frames": "frame_3.tif"}, load={"gain_std": 0.0})
    experiment = open_experiment(read_scene(folder))
    (row,) = measure_parts(experiment).run.frames.to_dict("records")
    stated, relative = experiment.scene.elastic, row["force_sum_std_N"] / row["force_sum_N"]
    record = thresholds.run_modulus(experiment, threshold=None).record
    assert record["method"] == "disk"
    value = stated.young_modulus * row["load_N"] / row["force_sum_N"]
    assert record["young_modulus"]["value"] == pytest.approx(value, rel=1e-12)
    # without the modulus' own
    own = (relative**2 - (stated.young_modulus_std / stated.young_modulus) ** 2) ** 0.5
    assert record["young_modulus"]["std"] == pytest.approx(own * value, rel=1e-6)
    # at a threshold that is not calibrated its distance from the rims is most of it, and its error
    higher = CoverageEstimate.of_normal(0.6, 0.0)
    found = thresholds.run_modulus(experiment, threshold=higher).record["young_modulus"]
    assert 0.05 < found["value"] / value - 1 < 2 * found["std"] / value < 1.5


@pytest.mark.parametrize("kind", ["threshold", "modulus", "plateau"])
def test_a_frame_without_contact_is_named(kind, small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "frames")
    (folder / "frame_1.tif").write_bytes((folder / "reference.tif").read_bytes())
    assert run("calibrate", kind, folder, "-o", tmp_path / "out", "--quiet", "--workers", 1) == 1
    said = "frame_1.tif: the frame is identical to its reference: no contact can show"
    assert said in read_calibration(tmp_path / "out")["notes"]


def test_dark_contacts_give_the_modulus_of_bright_ones(small_series, tmp_path):
    folder, found = copy_of(small_series, tmp_path / "frames"), []
    for polarity in ("bright", "dark"):
        with_scene(folder, images={"polarity": polarity})
        record = thresholds.run_modulus(open_experiment(read_scene(folder)), threshold=None).record
        found.append((record["young_modulus"], record["quality"]["frames_used"]))
        for path in folder.glob("*.tif"):  # the negatives
            write_frame(Frame(255 - read_frames(path)[0].image), path)
    (bright, count), (dark, dark_count) = found
    assert count == dark_count == 3
    assert dark["value"] == pytest.approx(bright["value"], abs=bright["std"])


def test_a_frame_whose_contacts_have_no_forces_is_left_out_and_named(small_series, tmp_path, capsys):
    folder = copy_of(small_series, tmp_path / "frames")
    table = pd.read_csv(folder / "asperities.csv")
    table["radius_m"] *= 1 + 1e-5 * np.arange(len(table))  # so that a contact needs its own asperity
    table.to_csv(folder / "asperities.csv", index=False)
    words = ["calibrate", "threshold", folder, "--quiet", "--workers", 1]
    assert run(*words, "--frames", "frame_[13].tif", "-o", tmp_path / "two") == 0
    experiment = open_experiment(read_scene(folder))
    reference, source = experiment.references[0].read().image, experiment.frames[1]
    image = source.read().image
    elsewhere = reference.astype(int) + np.roll(image.astype(int) - reference, (37, 23), (0, 1))[::-1]
    write_frame(Frame(np.clip(elsewhere, 0, 255).astype(image.dtype), name=source.name), source.path)
    assert run(*words, "-o", tmp_path / "all") == 1
    record = read_calibration(tmp_path / "all")
    (said,) = (note for note in record["notes"] if note.startswith("frame_2.tif: left out"))
    assert "fewer than half of its contacts have a force" in said
    assert "contacts fall on an asperity" in said
    assert record["threshold"] == read_calibration(tmp_path / "two")["threshold"]
    with_scene(folder, measure={"pose": "given"})
    capsys.readouterr()
    run("calibrate", "modulus", folder, "--frames", "frame_2.tif", "-o", tmp_path / "one", "--quiet")
    error = capsys.readouterr().err
    assert "no local force is known" in error
    assert "[camera] pixel_size_m and centre_m, and [indenter] apex_m" in error


def test_both_on_one_curve_are_refused(threshold_result, tmp_path, capsys):
    folder, out = threshold_result
    both = "cannot both be fitted to the same load curve"
    assert both in refusal(
        capsys, "calibrate", "modulus", folder, "--calibration", out, "-o", tmp_path / "a", "--quiet"
    )
    assert both in refusal(capsys, "calibrate", "modulus", folder, "-o", tmp_path / "a", "--quiet")


@pytest.mark.parametrize("option", ["--young-modulus-MPa", "--young-modulus-std-MPa"])
def test_a_modulus_or_its_uncertainty_stated_twice_is_refused(option, threshold_result, tmp_path, capsys):
    folder, out = threshold_result
    words = ["calibrate", "threshold", folder, "--jkr", out, option, 0.1, "-o", tmp_path / "out"]
    assert f"--jkr and {option} both give" in refusal(capsys, *words)


def test_no_threshold_brackets_one(threshold_result, tmp_path, capsys):
    folder = copy_of(threshold_result[0], tmp_path / "frames")
    with_scene(folder, images={"frames": "frame_3.tif"})
    pd.read_csv(folder / "loads.csv")[-1:].to_csv(folder / "loads.csv", index=False)
    words = ["calibrate", "threshold", folder, "-o", tmp_path / "out", "--quiet", "--young-modulus-MPa", 300]
    assert "no threshold between 0.05 and 0.95 gives slope 1" in refusal(capsys, *words)
    pd.DataFrame({"frame": ["frame_3.tif"], "load_N": [0.0]}).to_csv(folder / "loads.csv", index=False)
    assert "no load presses" in refusal(capsys, *words)


def test_plateau(small_series, tmp_path):
    folder = copy_of(small_series, tmp_path / "frames")
    (folder / "loads.csv").unlink()
    with_scene(folder, images={})
    source = read_scene(folder).source
    source["images"].pop("loads", None)
    del source["elastic"]
    write_scene(source, folder / "scene.toml")
    assert run("calibrate", "plateau", folder, "-o", tmp_path / "out", "--quiet") == 0
    record = read_calibration(tmp_path / "out")
    low, high = (record[name]["value"] for name in ("threshold_low", "threshold_high"))
    assert 0.05 <= low < record["threshold"]["value"] < high <= 0.95
    areas = pd.read_csv(tmp_path / "out" / "areas.csv")
    truth = pd.read_csv(folder / "truth.csv").groupby("frame")["area_m2"].sum()
    inside = (areas["area_m2"] - truth.loc[areas["frame"]].to_numpy()).abs() <= areas["area_std_m2"]
    assert inside.all()
    assert (tmp_path / "out" / "plateau.svg").exists()


def test_calibration_that_is_none(small_series, tmp_path, capsys):
    (tmp_path / "a.json").write_text('{"threshold": {"value": "0.4", "unit": ""}}')
    words = ["process", small_series, "--calibration", tmp_path / "a.json", "-o", tmp_path / "out"]
    assert "the value of threshold must be a number, got '0.4'" in refusal(capsys, *words)


def test_centre_in_whose_pixels():
    still = pd.DataFrame({"x_px": [10.0, 10.01, 9.99], "y_px": 20.0, "centre_std_px": 0.01})
    shift = np.array([0.5, -0.4, 0.2])
    moving = still.assign(x_px=still["x_px"] + shift)
    for table, moves in ((still, False), (moving, True)):
        x, y, moved = mean_centre(table.assign(shift_x_px=shift, shift_y_px=0.0))
        assert (x.value, y.value) == pytest.approx((10, 20), abs=0.01)
        assert moved == moves
