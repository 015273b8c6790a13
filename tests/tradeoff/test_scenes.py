"""Trade-offs of whole scenes, and the command that chooses the cheapest model for a tolerance."""

import json
import shutil

import pandas as pd
import pytest
from small_series import SCENE, TINY

from contactimg import (
    measure_tradeoff,
    plan_effects,
    read_scene,
    scene_from_dict,
)
from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import read_table, write_scene
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.tradeoff import prepare_tradeoff
from contactimg.prediction import solve_scene
from contactimg.tables import TRADEOFF
from contactimg.tradeoff.knobs import KNOBS
from contactimg.tradeoff.measure import run_knobs

NAMES = list(KNOBS)


@pytest.fixture(scope="module")
def scene():
    return scene_from_dict(SCENE)


@pytest.fixture(scope="module")
def found(scene):
    """Every knob, each setting run twice."""
    knobs, left_out = prepare_tradeoff(scene)
    assert not left_out
    return run_knobs(knobs, relative=0.01, seconds=0.0)


def errors(found, knob):
    part = found.table[found.table["knob"] == knob]
    return dict(zip(part["setting"], part["error"], strict=True))


def test_every_knob_has_rows_sentences_and_references(found):
    assert list(dict.fromkeys(found.table["knob"])) == NAMES == list(found.sentences)
    assert (found.table["reference"] != "").all()
    assert set(found.table["load_N"].dropna()) == {0.05}
    assert found.table["error"].notna().all()
    assert found.table["time_s"].gt(0).all()


def test_models_come_closer_with_each_level(found):
    model = errors(found, "model")
    assert model["uncoupled"] > 2 * model["coupled by point forces"] > 0
    assert 0 < model["fully coupled"] < 1e-4


def test_the_reference_of_full_coupling_is_not_itself(found):
    row = found.table.set_index("setting").loc["fully coupled"]
    assert row["reference"] == "solutions of the whole contact problem"


def test_the_image_methods_are_compared_with_the_truth(found):
    image = errors(found, "image")
    assert set(found.table.loc[found.table["knob"] == "image", "reference"]) == {"truth of the frame"}
    # small contacts lose s^2/a^2 at half height
    assert image["pixels above the threshold"] > 0.05
    assert image["fit of blurred disks"] < 0.01


def test_contacts_outside_the_frame_are_no_error_of_its_measurement():
    # 2 of 7 contacts lie outside this frame, and two are cut by its edge
    asked = scene_from_dict(TINY | {"tolerance": {"output": "area"}})
    knobs, _ = prepare_tradeoff(asked, knobs=["image"])
    image = errors(run_knobs(knobs, relative=0.01, seconds=0.0), "image")
    assert image["fit of blurred disks"] < 0.01
    assert 0.05 < image["pixels above the threshold"] < 0.2


def test_the_output_can_be_forces_or_radii(scene):
    for output in ("force", "radius"):
        asked = scene.model_copy(update={"tolerance": scene.tolerance.model_copy(update={"output": output})})
        knobs, _ = prepare_tradeoff(asked, knobs=["model", "image"])
        result = run_knobs(knobs, relative=0.01, seconds=0.0)
        assert set(result.table["output"]) == {output}
        model = errors(result, "model")
        assert model["uncoupled"] > model["coupled by point forces"]
    assert errors(result, "model")["fully coupled"] < 5e-4


def test_failures_alone_are_an_error(scene):
    with pytest.raises(InputError, match=r"no setting of model could be run: .* lower the load"):
        measure_tradeoff(scene, load=1e3, knobs="model")


def test_a_load_is_a_number(scene):
    with pytest.raises(InputError, match="load must be a number of N, got 'a'"):
        measure_tradeoff(scene, load="a")
    with pytest.raises(InputError, match="load must be a number of N, got 'a'"):
        plan_effects(scene, load="a")


def test_zero_load_is_a_sentence(scene):
    with pytest.raises(InputError, match="needs a load above 0"):
        prepare_tradeoff(scene, load=0.0)


def test_a_load_must_be_finite(scene):
    with pytest.raises(InputError, match="load must be finite"):
        prepare_tradeoff(scene, load=float("nan"))


def test_without_a_camera_the_models_remain():
    data = {name: part for name, part in SCENE.items() if name not in ("camera", "simulate")}
    knobs, left_out = prepare_tradeoff(scene_from_dict(data), load=0.05)
    assert [knob.name for knob in knobs] == ["model"]
    assert left_out["image"] == "needs [camera], [simulate] or frames of its own"


def test_a_scene_without_anything_is_a_sentence():
    with pytest.raises(InputError, match="nothing to trade accuracy against time on; image: needs"):
        measure_tradeoff(scene_from_dict({}))


def test_an_unknown_knob_is_named(scene):
    with pytest.raises(InputError, match=r"knob must be one of 'image', .*, got 'colour'"):
        prepare_tradeoff(scene, knobs=["colour"])


def test_own_frames_take_the_fit_as_the_converged_answer(small_series, tmp_path):
    folder = tmp_path / "bare"
    shutil.copytree(small_series, folder)
    (folder / "scene.toml").write_text(
        '[camera]\npixel_size_m = 6e-6\n[images]\nreference = "reference.tif"\nframes = "frame_*.tif"\n'
        "[measure]\nblur_px = 1.4\n"
    )
    found = measure_tradeoff(read_scene(folder), load=0.02)
    table = found.table.set_index("setting")
    assert set(table["knob"]) == {"image"}
    assert set(table["load_N"]) == {0.02}
    assert (
        table.loc["pixels above the threshold", "reference"]
        == "fit of blurred disks (the truth is not known)"
    )
    assert table.loc["fit of blurred disks", "reference"] == "its own stated uncertainty"
    assert 0 < table.loc["fit of blurred disks", "error"] < table.loc["pixels above the threshold", "error"]


# --- the command ----------------------------------------------------------------------------------------


def test_the_command_writes_table_and_figures(small_series, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["tradeoff", str(small_series), "-o", str(out), "--knob", "model", "--load-N", "0.02"]
    assert main(arguments) == 0
    printed = " ".join(capsys.readouterr().out.split())  # tables fold at the width of the terminal
    assert "model: error of the area, compared with: the same asperities" in printed
    assert "for 1 % on A take" in printed
    table = read_table(out / "tradeoff.csv", TRADEOFF)
    assert set(table["knob"]) == {"model"}
    assert table["pareto"].sum() >= 1
    assert (out / "tradeoff.svg").stat().st_size > 1000
    assert "model" in json.loads((out / "provenance.json").read_text())["sentences"]


def test_the_command_says_why_nothing_applies(small_series, tmp_path, capsys):
    assert main(["tradeoff", str(small_series), "-o", str(tmp_path / "out"), "--load-N", "0"]) == 2
    assert "needs a load above 0" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- the cheapest for a tolerance -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def planned_series(small_series, tmp_path_factory):
    """The series with a scene that orders no effect, so that the plan decides."""
    folder = tmp_path_factory.mktemp("planned")
    shutil.copy(small_series / "asperities.csv", folder)
    data = {name: part for name, part in read_scene(small_series).source.items() if name != "effects"}
    write_scene(data, folder / "scene.toml")
    return folder


def predict(series, tmp_path, tolerance):
    out = tmp_path / f"out_{tolerance}"
    arguments = ["predict", str(series), "--load-N", "0.05", "-o", str(out)]
    assert main([*arguments, "--tolerance", str(tolerance)]) == 0
    return float(pd.read_csv(out / "frames.csv")["area_m2"].iloc[0])


@pytest.mark.parametrize(
    ("tolerance", "level"),
    [(0.3, "no coupling"), (0.002, "coupling by point forces"), (1e-6, "full coupling")],
)
def test_predict_takes_the_cheapest_model_that_serves(planned_series, tmp_path, capsys, tolerance, level):
    area = predict(planned_series, tmp_path, tolerance)
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{level} for {100 * tolerance:g} % of the area" in printed
    assert ("is not reached: the model itself errs by about" in printed) == (tolerance < 1e-5)
    # converged: everything of the mechanics that this scene can have, solved to rounding
    scene = read_scene(planned_series)
    on = scene.effects.model_copy(update={"sphere_profile": "on"})
    converged = solve_scene(
        scene.model_copy(update={"effects": on}),
        need_asperities(scene, "a test"),
        load=0.05,
        coupling="full",
    ).area
    assert abs(area / converged - 1) < tolerance
