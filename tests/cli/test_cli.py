"""The command line: what it writes, what it says, and that bad input costs one sentence and nothing else."""

import json
import logging
import re
import shlex
import subprocess
import sys

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from local_cluster import files_of
from small_series import TINY, break_measurement, copy_of, write_small_series

from contactimg.cli import COMMANDS, main
from contactimg.cli.printing import echo_frames
from contactimg.cli.scenes import scene_of_folder
from contactimg.files import open_experiment
from contactimg.pipeline import measured_series
from contactimg.tables import CONTACTS, FRAMES, MATCHES, PROFILE, REJECTED, SCORES


@pytest.fixture
def series(small_series, tmp_path):
    return copy_of(small_series, tmp_path / "series")


@pytest.fixture(scope="module")
def finished(small_series, tmp_path_factory):
    """The series with its results in the folder of the usual name; copy it before you change it."""
    folder = copy_of(small_series, tmp_path_factory.mktemp("finished") / "series")
    assert process(folder) == 0
    return folder


def process(folder, *options):
    return main(["process", str(folder), "--workers", "1", "--quiet", "--no-pictures", *map(str, options)])


COUNTED = ("--method", "threshold")
"""Options of runs whose claim does not depend on the fit, which takes half of their time."""


def frames_of(out):
    return pd.read_csv(out / "frames.csv").set_index("frame")


def failure(capsys, code):
    """The sentence of a command that did nothing."""
    assert code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("contactimg: ")
    return lines[0]


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


# what the commands write


def test_process_writes_the_fixed_columns_and_pictures(series, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["process", str(series), "-o", str(out), "--workers", "1"]) == 0
    for schema in (CONTACTS, FRAMES, REJECTED):
        assert pd.read_csv(out / f"{schema.name}.csv").columns.tolist() == list(schema.columns)
    frames = frames_of(out)
    assert frames.index.tolist() == ["frame_1.tif", "frame_2.tif", "frame_3.tif"]
    assert (frames["status"] == "ok").all()
    assert sorted(path.name for path in (out / "overlays").iterdir()) == [
        f"frame_{k}.tif.png" for k in (1, 2, 3)
    ]
    assert cv2.imread(str(out / "overlays" / "frame_1.tif.png")).shape[1] >= 1600
    printed = capsys.readouterr()
    assert "frame_3.tif" in printed.out
    record = json.loads((out / "provenance.json").read_text())
    assert record["pose"]["fitted"]
    assert {item["path"].rsplit("/", 1)[-1] for item in record["inputs"]} >= {"reference.tif", "loads.csv"}


def test_output_defaults_to_a_folder_inside_and_a_second_run_replaces_the_first(finished, tmp_path):
    series = copy_of(finished, tmp_path / "series")
    first = (series / "contactimg_out" / "contacts.csv").read_bytes()
    assert process(series) == 0
    assert (series / "contactimg_out" / "contacts.csv").read_bytes() == first


def test_forces_add_up_to_the_load(finished):
    frames = frames_of(finished / "contactimg_out")
    np.testing.assert_allclose(frames["force_sum_N"], frames["load_N"], rtol=0.03)


def test_workers_do_not_change_the_result(tmp_path, monkeypatch):
    """Neither of frames, pooled background and frames measured on it, nor of the blocks of the tables."""
    series, (one, two) = write_small_series(tmp_path / "series", TINY), (tmp_path / "one", tmp_path / "two")
    named = 'reference = "reference.tif"\n'
    edit(series / "scene.toml", named, named + 'background = "pooled"\n')
    monkeypatch.setattr(measured_series, "BLOCK_FRAMES", 1)
    for out, workers in ((one, 1), (two, 2)):
        assert process(series, "-o", out, "--workers", workers) == 0
    assert frames_of(one)["message"].str.contains("background pooled from").all()
    assert "contacts.csv" in files_of(one)
    assert files_of(one) == files_of(two)


def test_overlay_writes_matches_and_scores_for_both_models(finished, tmp_path):
    assert main(["overlay", str(finished / "contactimg_out"), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    scores = pd.read_csv(tmp_path / "out" / "scores.csv")
    assert scores.columns.tolist() == list(SCORES.columns)
    assert scores.groupby("frame")["model"].apply(sorted).tolist() == [["coupled", "uncoupled"]] * 3
    assert (scores.loc[scores["model"] == "coupled", "f1"] > 0.97).all()
    matches = pd.read_csv(tmp_path / "out" / "matches.csv")
    assert matches.columns.tolist() == list(MATCHES.columns)
    assert len(list((tmp_path / "out" / "overlays").glob("*.png"))) == 3


def test_a_scene_that_was_changed_after_the_run_is_named(series, tmp_path, capsys):
    out = tmp_path / "out"
    assert process(series, "-o", out, *COUNTED) == 0
    edit(series / "scene.toml", "radius_m = 0.1288", "radius_m = 0.13")
    assert main(["overlay", str(out), "-o", str(tmp_path / "overlay"), "--quiet"]) == 0
    assert "scene.toml changed after the run; repeat it" in capsys.readouterr().err


def test_predict_writes_one_name_a_load(series, tmp_path):
    out = tmp_path / "out"
    assert (
        main(["predict", str(series), "--load-N", "0.02", "--load-N", "0.05", "-o", str(out), "--quiet"]) == 0
    )
    frames = frames_of(out)
    assert len(frames) == 2
    np.testing.assert_allclose(frames["force_sum_N"], frames["load_N"], rtol=1e-9)
    assert pd.read_csv(out / "contacts.csv")["frame"].nunique() == 2
    assert pd.read_csv(out / "profile.csv").columns.tolist() == list(PROFILE.columns)


def test_simulate_makes_a_folder_that_process_takes(series, tmp_path):
    assert main(["simulate", str(series), "-o", str(tmp_path / "again"), "--quiet"]) == 0
    assert (tmp_path / "again" / "truth.csv").read_bytes() == (series / "truth.csv").read_bytes()
    assert process(tmp_path / "again", "-o", tmp_path / "out") == 0


def test_frames_without_a_scene_are_measured_in_pixels_and_with_a_pixel_size_in_metres(series, tmp_path):
    for name in ("scene.toml", "loads.csv", "asperities.csv", "truth.csv"):
        (series / name).unlink()
    assert process(series, "-o", tmp_path / "px", *COUNTED) == 0
    contacts = pd.read_csv(tmp_path / "px" / "contacts.csv")
    assert contacts["radius_px"].notna().all()
    assert contacts["radius_m"].isna().all()
    assert process(series, "-o", tmp_path / "m", "--pixel-size-um", 6, *COUNTED) == 0
    metres = pd.read_csv(tmp_path / "m" / "contacts.csv")
    np.testing.assert_allclose(metres["radius_m"], 6e-6 * contacts["radius_px"], rtol=1e-12)


def test_a_reference_is_looked_for_in_the_folder_as_well(series, tmp_path):
    (series / "scene.toml").unlink()
    (series / "reference.tif").rename(series / "ref.tif")
    options = ["--reference", "ref.tif", "--loads", "loads.csv", "-o", tmp_path / "out"]
    assert process(series, *options, *COUNTED) == 0
    frames = frames_of(tmp_path / "out")
    assert frames.index.tolist() == ["frame_1.tif", "frame_2.tif", "frame_3.tif"]
    assert frames["load_N"].notna().all()


def test_python_m_contactimg_answers_help():
    run = subprocess.run(
        [sys.executable, "-m", "contactimg", "--help"], capture_output=True, text=True, check=True
    )
    assert "process" in run.stdout


@pytest.mark.parametrize("command", ["process", "predict", "overlay", "simulate"])
def test_help_shows_an_example_on_its_own_line(command, capsys):
    assert main([command, "--help"]) == 0
    assert re.search(rf"^ +contactimg {command} ", capsys.readouterr().out, re.MULTILINE)


# one bad frame is reported and does not stop the others


def truncated(path):
    path.write_bytes(path.read_bytes()[:5000])


def text_file(path):
    path.write_text("this is no image\n")


def other_size(path):
    tifffile.imwrite(path, np.zeros((20, 30), np.uint8))


@pytest.mark.parametrize("spoil", [truncated, text_file, other_size])
def test_a_bad_frame_is_named_and_the_others_are_measured(series, finished, tmp_path, capsys, spoil):
    spoil(series / "frame_2.tif")
    assert process(series, "-o", tmp_path / "out") == 1
    assert capsys.readouterr().err.startswith("contactimg: frame_2.tif: ")
    frames = frames_of(tmp_path / "out")
    assert frames.loc["frame_2.tif", "status"] == "failed"
    assert "frame_2.tif" in frames.loc["frame_2.tif", "message"]
    outs = (tmp_path / "out", finished / "contactimg_out")
    contacts, good = (pd.read_csv(out / "contacts.csv") for out in outs)
    good = good[good["frame"] != "frame_2.tif"].reset_index(drop=True)
    names = ["frame", "label", "asperity"]
    pd.testing.assert_frame_equal(contacts[names], good[names])
    # a frame of small contacts takes its contrast from the others, so it may move by a part of its error
    assert ((contacts["radius_px"] - good["radius_px"]).abs() < 0.2 * good["radius_std_px"]).all()


def black(image):
    return np.zeros_like(image)


def white(image):
    return np.full_like(image, 255)


def holed(image):
    image = image.astype(np.float32)
    image[100:110, 100:130] = np.nan
    return image


def test_odd_frames_are_measured_and_carry_a_status(series, tmp_path):
    image = tifffile.imread(series / "frame_3.tif")
    for change in (black, white, holed):
        tifffile.imwrite(series / f"frame_{change.__name__}.tif", change(image))
    assert process(series, "-o", tmp_path / "out") == 0
    status = frames_of(tmp_path / "out")["status"]
    assert (status.iloc[:3] == "ok").all()
    assert not set(status.iloc[3:]) & {"ok", "failed"}
    assert len(status) == 6


def test_reference_as_a_frame_has_no_contacts_and_a_status(series, tmp_path):
    (series / "frame_2.tif").write_bytes((series / "reference.tif").read_bytes())
    assert process(series, "-o", tmp_path / "out") == 0
    row = frames_of(tmp_path / "out").loc["frame_2.tif"]
    assert row["status"] != "ok"
    assert (row["n_contacts"], row["area_m2"], row["force_sum_N"]) == (0, 0, 0)


def test_a_reference_swapped_with_a_frame_is_not_success(series, tmp_path):
    frames = [series / f"frame_{k}.tif" for k in (1, 2, 3)]
    shown, empty = tifffile.imread(frames[2]), tifffile.imread(series / "reference.tif")
    tifffile.imwrite(series / "reference.tif", shown)
    for path in frames:
        tifffile.imwrite(path, empty)
    assert process(series, "-o", tmp_path / "out") == 1


def test_no_reference_is_said_once_for_all_frames(series, tmp_path, capsys):
    edit(series / "scene.toml", 'reference = "reference.tif"\n', "")
    (series / "reference.tif").unlink()
    words = ["process", str(series), "-o", str(tmp_path / "out"), "--workers", "1", "--no-pictures"]
    assert main([*words, *COUNTED]) == 0
    assert frames_of(tmp_path / "out")["message"].str.contains("background").all()
    printed = capsys.readouterr().out
    assert printed.count("no reference") == 1
    assert re.search("^all frames: .*no reference", printed, re.MULTILINE)


def test_a_frame_has_one_short_line_and_all_of_it_with_verbose(capsys):
    shared, own = "the light changed", "a remark of this frame alone, " + 20 * "at length "
    messages = [f"{shared}; {own}", shared, "how well it went"]
    statuses = ["poor fit", "ok", "ok"]
    frames = FRAMES.conform({"frame": ["a.tif", "b.tif", "c.tif"], "message": messages, "status": statuses})
    echo_frames(frames, title="three frames")
    printed = capsys.readouterr().out
    lines = printed.splitlines()
    assert "how well it went" not in printed
    assert "remarks on 1 of these frames are in frames.csv" in printed
    assert lines.count(f"2 frames from a.tif on: {shared}") == 1
    (line,) = [line for line in lines if line.startswith("a.tif: ")]
    assert line.endswith("... (--verbose)")
    assert len(line) <= 160
    logging.getLogger("contactimg").setLevel(logging.INFO)
    try:
        echo_frames(frames, title="three frames")
    finally:
        logging.getLogger("contactimg").setLevel(logging.WARNING)
    printed = capsys.readouterr().out
    assert f"a.tif: {own}".strip() in printed
    assert "c.tif: how well it went" in printed


# nothing done: one sentence, exit code 2, and an earlier run untouched


def in_scene(old, new):
    return lambda folder: edit(folder / "scene.toml", old, new)


def in_loads(old, new):
    return lambda folder: edit(folder / "loads.csv", old, new)


def small_reference(folder):
    other_size(folder / "reference.tif")


def no_reference(folder):
    (folder / "reference.tif").unlink()


def no_frames(folder):
    for path in folder.glob("frame_*.tif"):
        path.unlink()


def no_height(folder):
    edit(folder / "asperities.csv", "height_m", "hight")


def word_for_a_number(folder):
    lines = (folder / "asperities.csv").read_text().splitlines()
    lines[3] = lines[3].replace(lines[3].split(",")[1], "many", 1)
    (folder / "asperities.csv").write_text("\n".join(lines))


BAD_INPUT = {
    "pixel size 0": (in_scene("6e-06", "0.0"), r"pixel_size_m must be greater than 0, got 0\.0"),
    "pixel size negative": (in_scene("6e-06", "-6e-6"), "pixel_size_m must be greater than 0, got -6e-06"),
    "unknown key": (in_scene("pixel_size_m", "pixelsize_m"), r"no key 'pixelsize_m'.*pixel_size_m"),
    "unknown section": (in_scene("[camera]", "[kamera]"), r"unknown section \[kamera\].*camera"),
    "no TOML": (in_scene("[camera]", "[camera"), r"scene\.toml: is not valid TOML"),
    "duplicate load": (
        in_loads("frame_2.tif", "frame_1.tif"),
        r"loads\.csv: .*frame_1\.tif is there more than once",
    ),
    "word for a load": (
        in_loads("0.02", "heavy"),
        r"loads\.csv: line 3, column load_N must be a number, got 'heavy'",
    ),
    "no load column": (in_loads("load_N", "load"), r"loads\.csv: column load_N is missing"),
    "reference of another size": (
        small_reference,
        "frame_1.tif: the reference must have the size of the frame, 360 x 340 pixels, got 30 x 20",
    ),
    "reference missing": (
        no_reference,
        r"\[images\] reference: .*reference\.tif: there is no such file or folder",
    ),
    "no frames": (no_frames, "matches no image file"),
    "missing column": (no_height, r"asperities\.csv: column height_m is missing"),
    "word for a number": (
        word_for_a_number,
        r"asperities\.csv: line 4, column y_m must be a number, got 'many'",
    ),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_one_sentence_and_loses_nothing(finished, tmp_path, capsys, case):
    spoil, sentence = BAD_INPUT[case]
    series = copy_of(finished, tmp_path / "series")
    before = {path: path.read_bytes() for path in (series / "contactimg_out").rglob("*") if path.is_file()}
    spoil(series)
    capsys.readouterr()
    assert re.search(sentence, failure(capsys, process(series)))
    after = {path: path.read_bytes() for path in (series / "contactimg_out").rglob("*") if path.is_file()}
    assert after == before


def test_empty_folder(tmp_path, capsys):
    assert "no image file" in failure(capsys, process(tmp_path))


def test_output_that_cannot_be_a_folder(series, tmp_path, capsys):
    (tmp_path / "file").write_text("not a folder")
    assert "cannot be written" in failure(capsys, process(series, "-o", tmp_path / "file" / "out"))


def test_output_of_another_command_is_kept(finished, capsys):
    out = str(finished / "contactimg_out")
    code = main(["predict", str(finished), "--load-N", "0.02", "-o", out, "--quiet"])
    assert "choose" in failure(capsys, code)


def test_missing_load_is_a_warning_and_an_empty_cell(series, tmp_path, capsys):
    lines = (series / "loads.csv").read_text().splitlines()
    (series / "loads.csv").write_text("\n".join(lines[:-1]) + "\n")
    assert process(series, "-o", tmp_path / "out", *COUNTED) == 0
    assert "no load for the frames: frame_3.tif" in capsys.readouterr().err
    assert np.isnan(frames_of(tmp_path / "out").loc["frame_3.tif", "load_N"])


def test_every_frame_bad_is_nothing_done(series, tmp_path, capsys):
    for path in series.glob("frame_*.tif"):
        text_file(path)
    assert "no frame could be measured" in failure(capsys, process(series, "-o", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_frames_that_show_nothing_are_not_success(series, tmp_path, capsys):
    for path in series.glob("frame_*.tif"):
        tifffile.imwrite(path, np.full_like(tifffile.imread(path), 77))
    assert process(series, "-o", tmp_path / "out") == 1
    frames = frames_of(tmp_path / "out")
    assert set(frames["status"]) == {"constant"}
    assert frames["area_m2"].isna().all()
    capsys.readouterr()
    assert main(["process", "--help"]) == 0
    assert (
        "1 a frame failed, a slip is likely (it is named), or no frame has a result to rely on"
        in " ".join(capsys.readouterr().out.split())
    )


def test_overlay_without_a_load_is_nothing_done(series, tmp_path, capsys):
    (series / "loads.csv").unlink()
    assert 'loads = "loads.csv"\n' in (series / "scene.toml").read_text()
    edit(series / "scene.toml", 'loads = "loads.csv"\n', "")
    run, out = tmp_path / "run", tmp_path / "out"
    assert process(series, "-o", run, *COUNTED) == 0
    capsys.readouterr()
    sentence = failure(capsys, main(["overlay", str(run), "-o", str(out), "--quiet"]))
    assert "there is nothing to compare: no frame of the run has a load" in sentence
    assert not out.exists()


def test_names_with_the_signs_of_formulae_are_names(series, tmp_path):
    name = "a$_{b$.tif"  # between the signs, what mathtext refuses
    (series / "frame_2.tif").rename(series / name)
    edit(series / "scene.toml", 'frames = "frame_*.tif"', f'frames = ["{name}", "frame_3.tif"]')
    edit(series / "loads.csv", "frame_2.tif", name)
    run, out = tmp_path / "run", tmp_path / "out"
    assert main(["process", str(series), "-o", str(run), "--workers", "1", "--quiet", *COUNTED]) == 0
    assert main(["overlay", str(run), "-o", str(out), "--workers", "1", "--quiet"]) == 0
    for folder in (run, out):
        assert (folder / "overlays" / f"{name}.png").stat().st_size > 0


def test_the_provenance_holds_the_command_as_a_shell_reads_it(series, tmp_path):
    words = ["predict", str(series), "--load-N", "0.02", "-o", str(tmp_path / "two words"), "--quiet"]
    assert main(words) == 0
    record = json.loads((tmp_path / "two words" / "provenance.json").read_text())
    assert shlex.split(record["command"]) == ["contactimg", *words]


def test_overlay_of_no_run(tmp_path, capsys):
    assert "holds no run" in failure(capsys, main(["overlay", str(tmp_path)]))


def test_predict_negative_and_repeated_load(series, tmp_path, capsys):
    out = str(tmp_path / "out")
    assert "load" in failure(capsys, main(["predict", str(series), "--load-N", "-1", "-o", out]))
    repeated = ["predict", str(series), "--load-N", "1", "--load-N", "1", "-o", out]
    assert "more than once" in failure(capsys, main(repeated))


def test_a_pull_on_contacts_whose_adhesion_is_left_out_says_so(series, tmp_path, capsys):
    edit(series / "scene.toml", "[elastic]", "[elastic]\nwork_of_adhesion_J_m2 = 0.05")
    pull = ["predict", str(series), "--load-N", "-1e-4", "-o", str(tmp_path / "out"), "--coupling", "full"]
    assert "adhesion is left out here" in failure(capsys, main(pull))


def test_unknown_option_is_a_usage_error(capsys):
    assert main(["process", ".", "--no-such-option"]) == 2
    assert "no-such-option" in capsys.readouterr().err


def test_verbose_says_what_was_found_and_the_next_command_is_silent_again(series, tmp_path, capsys):
    assert process(series, "-o", tmp_path / "out", "--verbose") == 0
    said = capsys.readouterr().err
    assert re.search(r"frame_3\.tif: ok, \d+ contacts, .*contrast", said)
    assert "pose fitted" in said
    assert process(series, "-o", tmp_path / "out", *COUNTED) == 0
    assert capsys.readouterr().err == ""


def all_black(path):
    tifffile.imwrite(path, black(tifffile.imread(path)))


@pytest.mark.parametrize(("spoil", "code"), [(text_file, 1), (all_black, 0)])
def test_overlay_names_loads_without_an_answer_and_leaves_out_frames_not_measured(
    series, tmp_path, capsys, spoil, code
):
    spoil(series / "frame_2.tif")
    edit(series / "loads.csv", "0.05", "500.0")
    assert process(series, "-o", tmp_path / "run", "--no-plausibility", *COUNTED) == code
    options = ["-o", str(tmp_path / "out"), "--quiet", "--no-plausibility"]
    assert main(["overlay", str(tmp_path / "run"), *options]) == 1
    assert "frame_3.tif: no prediction, coupled:" in capsys.readouterr().err
    assert pd.read_csv(tmp_path / "out" / "scores.csv")["frame"].unique().tolist() == ["frame_1.tif"]


def test_overlay_scores_a_frame_that_is_gone_and_has_no_picture_of_it(series, tmp_path, capsys):
    assert process(series, "-o", tmp_path / "run", *COUNTED) == 0
    (series / "frame_2.tif").unlink()
    out = tmp_path / "out"
    assert main(["overlay", str(tmp_path / "run"), "-o", str(out), "--quiet"]) == 0
    assert "loads for frames that are not there: frame_2.tif" in capsys.readouterr().err
    assert pd.read_csv(out / "scores.csv")["frame"].nunique() == 3
    assert {path.name for path in (out / "overlays").iterdir()} == {"frame_1.tif.png", "frame_3.tif.png"}


def test_a_scene_from_elsewhere_is_for_the_frames_of_the_folder(series, small_series, tmp_path):
    for name in ("scene.toml", "asperities.csv", "frame_3.tif"):
        (series / name).unlink()
    out = tmp_path / "out"
    assert process(series, "--scene", small_series / "scene.toml", "-o", out, *COUNTED) == 0
    assert frames_of(out).index.tolist() == ["frame_1.tif", "frame_2.tif"]
    assert pd.read_csv(out / "contacts.csv")["force_N"].notna().all()


def test_a_scene_from_elsewhere_has_masks_and_dark_frames_beside_it(tmp_path):
    folder, other = tmp_path / "frames", tmp_path / "scenes"
    for file in (folder / "dark_1.tif", other / "dark_2.tif", other / "scratch.png"):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    mask = '{ "a.tif" = "scratch.png", "*" = [[[0, 0], [1, 1], [2, 0]]] }'
    (other / "scene.toml").write_text(f'[images]\ndark = ["dark_1.tif", "dark_2.tif"]\nmask = {mask}\n')
    images = scene_of_folder(folder, {}, scene_file=str(other / "scene.toml"))[0].images
    assert images.dark == ["dark_1.tif", str((other / "dark_2.tif").resolve())]
    scratch = str((other / "scratch.png").resolve())
    assert images.masks == {"a.tif": scratch, "*": [[(0, 0), (1, 1), (2, 0)]]}


def test_frames_that_are_named_may_lie_in_other_folders(series, tmp_path):
    series.rename(tmp_path / "day 1")
    scene, _ = scene_of_folder(tmp_path, {"images": {"frames": "day 1/frame_*.tif"}})
    assert len(open_experiment(scene).frames) == 3


def test_a_scene_from_elsewhere_takes_a_page_of_the_folders_stack_as_reference(series, tmp_path):
    pages = np.stack(
        [tifffile.imread(series / f"{name}.tif") for name in ("reference", "frame_1", "frame_2")]
    )
    folder, other = tmp_path / "stacks", tmp_path / "scenes"
    for place in (folder, other):
        place.mkdir()
    tifffile.imwrite(folder / "stack.tif", pages, photometric="minisblack")
    (other / "scene.toml").write_text(
        '[camera]\npixel_size_m = 6e-6\n[images]\nreference = "stack.tif[0]"\nframes = "stack.tif"\n'
    )
    out = tmp_path / "out"
    assert process(folder, "--scene", other / "scene.toml", "-o", out) == 0
    frames = frames_of(out)
    assert frames.index.tolist() == ["stack.tif[1]", "stack.tif[2]"]
    assert frames["message"].isna().all()  # or it would say that there is no reference


@pytest.mark.parametrize("scene", ["[camera]\npixel_size_m = 6e-6\n", None])
def test_a_file_called_reference_is_never_a_frame(series, tmp_path, scene):
    for name in ("scene.toml", "loads.csv"):
        (series / name).unlink()
    for path in series.glob("frame_*.tif"):
        path.rename(series / path.name.replace("frame", "img"))
    if scene is not None:
        (series / "scene.toml").write_text(scene)
    assert process(series, "-o", tmp_path / "out", *COUNTED) == 0
    frames = frames_of(tmp_path / "out")
    assert frames.index.tolist() == ["img_1.tif", "img_2.tif", "img_3.tif"]
    # a scene that names no reference has none; without a scene, the file's name says what it is
    said = frames["message"].astype(str).str.contains("no reference")
    assert (said if scene is not None else ~said).all()


def test_another_pattern_is_said_in_the_message(series, tmp_path):
    edit(series / "scene.toml", "6e-06", "9e-06")
    assert process(series, "-o", tmp_path / "out") == 1
    assert set(frames_of(tmp_path / "out")["status"]) == {"no pose"}
    assert frames_of(tmp_path / "out")["message"].str.match("only .* contacts fall on an asperity").all()


def test_a_frame_that_breaks_the_measurement_is_one_failed_row(series, tmp_path, monkeypatch):
    break_measurement(monkeypatch)
    tifffile.imwrite(series / "frame_2.tif", np.full((340, 360), 7, np.uint8))
    assert process(series, "-o", tmp_path / "out", *COUNTED) == 1
    row = frames_of(tmp_path / "out").loc["frame_2.tif"]
    assert (row["status"], row["message"]) == (
        "failed",
        "frame_2.tif: cannot be measured (LinAlgError: singular)",
    )


def test_frames_of_mixed_size_without_reference_name_the_odd_one(series, tmp_path):
    edit(series / "scene.toml", 'reference = "reference.tif"\n', "")
    (series / "reference.tif").unlink()
    other_size(series / "frame_2.tif")
    assert process(series, "-o", tmp_path / "out", *COUNTED) == 1
    message = frames_of(tmp_path / "out").loc["frame_2.tif", "message"]
    assert message == "frame_2.tif: has 30 x 20 pixels, the other frames 360 x 340"


ALL_COMMANDS = [[], *([name] for name in COMMANDS), *(["calibrate", kind] for kind in ("jkr", "threshold"))]
HEAVY = ("numpy", "pandas", "scipy", "matplotlib", "numba", "cv2", "tifffile", "rich")
HEAVY += ("contactimg.files.experiment",)


HELP = """
import contextlib, io, sys
from contactimg.cli import main
for words in {commands!r}:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main([*words, "--help"])
    loaded = [name for name in {heavy!r} if name in sys.modules]
    assert code == 0 and "--help" in said.getvalue() and not loaded, (words, code, loaded)
"""


def test_help_is_answered_without_what_a_command_needs(capsys):
    code = HELP.format(commands=ALL_COMMANDS, heavy=HEAVY)
    run = subprocess.run(  # noqa: S603 - this package
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert run.stderr.strip() == ""
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(re.search(rf"^  {name} +\w", said, re.MULTILINE) for name in COMMANDS)


def test_an_option_for_a_key_of_the_scene_is_checked_by_the_rules_of_the_key(series, tmp_path, capsys):
    options = ["-o", tmp_path / "out"]
    sentence = failure(capsys, process(series, "--pixel-size-um", "-6", *options))
    assert "[camera] pixel_size_m must be greater than 0, got -6e-06" in sentence
    assert "must be a number" in failure(capsys, process(series, "--pixel-size-um", "six", *options))
    assert 'or "auto"' in failure(capsys, process(series, "--threshold", "high", *options))
    sentence = failure(capsys, process(series, "--threshold", "0.4", *options))
    assert '--threshold: a threshold acts on the method "threshold" only' in sentence
    assert process(series, "--method", "area", *options) == 2
    assert "'threshold', 'disk'" in capsys.readouterr().err
