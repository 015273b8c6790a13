"""The napari plugin: its manifest, a run as layers, and corrections on the layers as edits.csv."""

import importlib
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from review_runs import moved, process
from small_series import copy_of

import contactimg.napari_plugin
from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import read_edits, read_run
from contactimg.napari_plugin.reader import run_reader
from contactimg.napari_plugin.writer import write_corrections
from contactimg.tables import Flag

MANIFEST = Path(contactimg.napari_plugin.__file__).with_name("napari.yaml")


@pytest.fixture(scope="module")
def run(small_series, tmp_path_factory):
    folder = copy_of(small_series, tmp_path_factory.mktemp("napari") / "series")
    return process(folder, folder / "run")


@pytest.fixture
def layers(run):
    return {
        properties["name"]: (data, properties, kind)
        for data, properties, kind in run_reader(str(run))(str(run))
    }


def test_the_manifest_names_what_there_is():
    contributions = yaml.safe_load(MANIFEST.read_text())["contributions"]
    commands = {command["id"]: command["python_name"] for command in contributions["commands"]}
    named = {one["command"] for kind in ("readers", "writers") for one in contributions[kind]}
    assert named == set(commands)
    for name in commands.values():
        module, _, function = name.partition(":")
        assert callable(getattr(importlib.import_module(module), function))
    entry = {point.value for point in entry_points(group="napari.manifest") if point.name == "contactimg"}
    assert entry == {"contactimg.napari_plugin:napari.yaml"}


def test_only_a_run_folder_is_read(run, tmp_path):
    assert run_reader(str(tmp_path)) is None
    assert run_reader([str(run)]) is None
    assert run_reader(str(run / "contacts.csv")) is None


def test_layers_are_the_frames_and_the_contacts_where_they_were_measured(run, layers):
    tables = read_run(run)
    frames, contacts = layers["frames"], layers["contacts"]
    assert frames[0].shape[0] == len(tables.frames)
    assert len(contacts[0]) == len(tables.contacts)
    centres = np.array([points.mean(axis=0) for points in contacts[0]])
    np.testing.assert_allclose(centres[:, 1], tables.contacts["y_px"], atol=1e-9)
    np.testing.assert_allclose(centres[:, 2], tables.contacts["x_px"], atol=1e-9)
    number = {name: k for k, name in enumerate(tables.frames["frame"])}
    np.testing.assert_array_equal(centres[:, 0], tables.contacts["frame"].map(number))
    k = int(centres[0, 0])
    row, column = np.rint(centres[0, 1:]).astype(int)
    image = np.asarray(frames[0][k])
    assert image[row, column] > np.median(image)
    assert contacts[1]["scale"] == frames[1]["scale"]


def test_frames_that_are_gone_leave_the_contacts(run, tmp_path):
    series = moved(run.parent, tmp_path / "series")
    for frame in series.glob("frame_*.tif"):
        frame.unlink()
    with pytest.warns(UserWarning, match="frames are not shown"):
        layers = run_reader(str(series / "run"))(str(series / "run"))
    assert layers[0][1]["name"] == "contacts"


def test_corrections_become_edits_that_process_applies(run, layers, tmp_path):
    series = copy_of(run.parent, tmp_path / "series")
    data, properties, _ = layers["contacts"]
    target = series / "edits.csv"
    assert write_corrections(str(target), data, properties) == []
    assert not target.exists()
    table = read_run(run).contacts
    shifted = [points + np.array([0.0, 3.0, 0.0]) if k == 1 else points for k, points in enumerate(data)][1:]
    new = data[0] + np.array([0.0, 0.0, 5.0])  # with the features of the one it was copied from
    features = pd.concat(
        [properties["features"].iloc[1:], properties["features"].iloc[1:2]], ignore_index=True
    )
    changed = properties | {"features": features, "shape_type": [*properties["shape_type"][1:], "ellipse"]}
    for _ in range(2):  # a second time adds nothing
        assert write_corrections(str(target), [*shifted, new], changed) == [str(target)]
    edits = read_edits(target)
    assert edits["action"].tolist() == ["exclude", "exclude", "add", "add"]
    assert edits["y_px"].iloc[2] == pytest.approx(table["y_px"].iloc[1] + 3.0)
    assert edits["x_px"].iloc[3] == pytest.approx(table["x_px"].iloc[0] + 5.0)
    np.testing.assert_allclose(edits["radius_px"].iloc[2:], table["radius_px"].iloc[[1, 0]], rtol=1e-9)
    options = ["--quiet", "--no-pictures", "--workers", "1"]
    assert main(["process", str(series), "-o", str(tmp_path / "again"), *options]) == 0
    again = read_run(tmp_path / "again").contacts
    assert any(int(flags) & Flag.MANUAL for flags in again["flags"])


def test_a_layer_may_be_saved_again_after_the_run_was_made_anew(run, tmp_path):
    series = moved(run.parent, tmp_path / "series")
    ((data, properties),) = [
        one[:2]
        for one in run_reader(str(series / "run"))(str(series / "run"))
        if one[1]["name"] == "contacts"
    ]
    target, keep = series / "edits.csv", slice(1, None)
    less = properties | {name: properties[name][keep] for name in ("features", "shape_type")}
    write_corrections(str(target), data[keep], less)
    process(series, series / "run")
    # now the labels of the first frame are other ones, but nothing else was changed on the layer
    write_corrections(str(target), data[keep], less)
    assert read_edits(target)["action"].tolist() == ["exclude"]


def test_another_layer_is_refused(tmp_path):
    with pytest.raises(InputError, match="open a run folder"):
        write_corrections(str(tmp_path / "edits.csv"), [np.zeros((4, 3))], {"metadata": {}})
