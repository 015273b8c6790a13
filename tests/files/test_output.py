"""Output folders: whole or as before, one run at a time, with provenance that gives the run back."""

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import contactimg
from contactimg import InputError, read_scene
from contactimg.files import (
    OutputFolder,
    atomic,
    open_experiment,
    provenance,
    read_records,
    read_run,
    replacing,
    write_frame,
    write_json,
    write_table,
)
from contactimg.frame import Frame
from contactimg.tables import CONTACTS, FRAMES

RECORD = {"schema_version": 1, "command": "contactimg process a", "configuration": {"options": {}}}


def run(folder, files, *, record=RECORD, fail=False):
    """A run that writes the given files, and perhaps fails half-way."""
    with OutputFolder(folder, record) as out:
        for name, text in files.items():
            (out.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (out.folder / name).write_text(text)
        if fail:
            raise RuntimeError("half-way")


def content(folder):
    """Every file, hidden ones too, without the provenance."""
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and path.name != "provenance.json"
    }


# ---------------------------------------------------------------- whole files


def test_file_keeps_its_old_content_if_writing_fails(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(RuntimeError, match="half-way"), replacing(tmp_path / "a.txt") as part:  # noqa: PT012
        part.write_text("ne")
        raise RuntimeError("half-way")
    assert content(tmp_path) == {"a.txt": "old"}


@pytest.mark.skipif(os.name != "posix", reason="folders are flushed on POSIX alone")
def test_a_folder_that_the_system_does_not_flush_is_no_fault(tmp_path, monkeypatch):
    real = os.fsync

    def refuse(handle, kind):
        if stat.S_IFMT(os.fstat(handle).st_mode) == kind:
            raise OSError(errno.EINVAL, "Invalid argument")
        real(handle)

    (tmp_path / "a").write_text("whole")
    monkeypatch.setattr(os, "fsync", lambda handle: refuse(handle, stat.S_IFDIR))
    atomic.flush_to_disk(tmp_path / "a")
    monkeypatch.setattr(os, "fsync", lambda handle: refuse(handle, stat.S_IFREG))
    with pytest.raises(OSError, match="Invalid argument"):
        atomic.flush_to_disk(tmp_path / "a")


def test_two_writers_of_one_file_do_not_disturb_each_other(tmp_path):
    path, seen = tmp_path / "a.txt", []
    first_has_begun, first_may_end = threading.Event(), threading.Event()

    def write_first():
        with replacing(path) as part:
            part.write_text("first")
            first_has_begun.set()
            first_may_end.wait(10.0)
            seen.append(part.read_text())

    thread = threading.Thread(target=write_first)
    thread.start()
    first_has_begun.wait(10.0)
    with replacing(path) as part:
        part.write_text("second")
    assert content(tmp_path)["a.txt"] == "second"
    first_may_end.set()
    thread.join()
    assert seen == ["first"]
    assert content(tmp_path) == {"a.txt": "first"}


def test_file_has_the_permissions_of_the_process(tmp_path):
    before = os.umask(0o027)
    try:
        atomic.write_text("x", tmp_path / "a.txt")
    finally:
        os.umask(before)
    if os.name == "posix":
        assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


def test_json_of_numpy_values_is_json(tmp_path):
    data = {
        "a": np.float64(0.1),
        "b": np.arange(3),
        "c": [np.nan, np.inf, 1.0],
        "d": Path("x/y"),
        "e": np.int64(2),
        "f": {"g": np.array([np.nan])},
        "h": True,
        "i": (1, None),
    }
    write_json(data, tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "a": 0.1,
        "b": [0, 1, 2],
        "c": [None, None, 1.0],
        "d": "x/y",
        "e": 2,
        "f": {"g": [None]},
        "h": True,
        "i": [1, None],
    }


# ---------------------------------------------------------------- the folder


def test_nothing_is_in_place_before_the_end(tmp_path):
    with OutputFolder(tmp_path / "out", RECORD) as out:
        (out.folder / "a.txt").write_text("1")
        assert [p for p in out.path.iterdir() if not p.name.startswith(".")] == []
    assert content(tmp_path / "out") == {"a.txt": "1"}
    assert json.loads((tmp_path / "out" / "provenance.json").read_text())["outputs"] == ["a.txt"]


def test_a_new_run_replaces_the_earlier_one_and_keeps_what_no_run_wrote(tmp_path):
    out = tmp_path / "out"
    run(out, {"a.txt": "1", "pictures/old.png": "1", "pictures/both.png": "1"})
    (out / "notes.md").write_text("mine")
    run(out, {"a.txt": "2", "pictures/both.png": "2"})
    assert content(out) == {"a.txt": "2", "pictures/both.png": "2", "notes.md": "mine"}
    run(out, {"a.txt": "3"})
    assert content(out) == {"a.txt": "3", "notes.md": "mine"}
    assert not (out / "pictures").exists()


def test_a_run_may_keep_a_part_of_the_earlier_one(tmp_path):
    out = tmp_path / "out"
    run(out, {"a.txt": "1", "fiji/a.zip": "1", "labels/a.tif": "1"})
    with OutputFolder(out, RECORD, keeps=["fiji"]) as folder:
        (folder.folder / "a.txt").write_text("2")
    assert content(out) == {"a.txt": "2", "fiji/a.zip": "1"}
    assert read_records(out)[0]["outputs"] == ["a.txt", "fiji/a.zip"]
    run(out, {"a.txt": "3"})
    assert content(out) == {"a.txt": "3"}


def test_a_failed_run_leaves_the_earlier_one(tmp_path):
    out = tmp_path / "out"
    run(out, {"a.txt": "1", "old.txt": "1"})
    before = (out / "provenance.json").read_bytes()
    with pytest.raises(RuntimeError, match="half-way"):
        run(out, {"a.txt": "2", "new.txt": "2"}, fail=True)
    assert content(out) == {"a.txt": "1", "old.txt": "1"}
    assert (out / "provenance.json").read_bytes() == before


def test_a_failed_first_run_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError, match="half-way"):
        run(tmp_path / "deep" / "out", {"a.txt": "1"}, fail=True)
    assert list(tmp_path.iterdir()) == []


def test_file_of_a_person_with_the_name_of_an_output_is_kept(tmp_path, caplog):
    out = tmp_path / "out"
    run(out, {"a.txt": "1"})
    (out / "b.txt").write_text("mine")
    run(out, {"a.txt": "2", "b.txt": "2"})
    assert content(out) == {"a.txt": "2", "b.txt": "2", "b.txt.bak": "mine"}
    assert caplog.messages == [f"{out / 'b.txt'} was not written by a run; it is kept as b.txt.bak"]


def test_leftovers_of_a_killed_run_do_not_stay(tmp_path):
    (tmp_path / "out" / ".contactimg.part").mkdir(parents=True)
    (tmp_path / "out" / ".contactimg.part" / "half.csv").write_text("lost")
    (tmp_path / "out" / ".contactimg.lock").touch()
    run(tmp_path / "out", {"a.txt": "1"})
    assert content(tmp_path / "out") == {"a.txt": "1"}


def test_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "scene.toml").write_text("mine")
    with pytest.raises(InputError) as caught:
        run(tmp_path, {"a.txt": "1"})
    assert str(caught.value) == (
        f"{tmp_path}: holds files but no earlier run (among them scene.toml); "
        "choose a new or empty output folder"
    )
    assert content(tmp_path) == {"scene.toml": "mine"}


def test_output_of_another_command_is_not_replaced(tmp_path):
    """The contacts that `predict` made are no leftovers of `process`."""
    other = RECORD | {"command": "contactimg predict scene.toml"}
    run(tmp_path / "out", {"contacts.csv": "x", "profile.csv": "x"}, record=other)
    sentence = (
        f"{tmp_path / 'out'}: holds the output of 'contactimg predict' (contacts.csv), which "
        "'contactimg process' does not replace; choose another output folder"
    )
    with pytest.raises(InputError) as caught:
        run(tmp_path / "out", {"contacts.csv": "y", "rejected.csv": "y"})
    assert str(caught.value) == sentence
    with (
        pytest.raises(InputError) as caught,
        OutputFolder(tmp_path / "out", RECORD, main_files=["contacts.csv"]),
    ):
        pytest.fail("refused before any work is done")
    assert str(caught.value) == sentence
    assert content(tmp_path / "out") == {"contacts.csv": "x", "profile.csv": "x"}
    run(tmp_path / "out", {"contacts.csv": "z"}, record=other | {"command": "contactimg predict other.toml"})
    assert content(tmp_path / "out") == {"contacts.csv": "z"}


def test_commands_share_a_folder_as_long_as_their_files_differ(tmp_path):
    out = tmp_path / "out"
    overlay, analyse = ({"command": f"contactimg {name} run"} for name in ("overlay", "analyse"))
    run(out, {"scores.csv": "1", "matches.csv": "1"}, record=RECORD | overlay)
    run(out, {"results.csv": "2"}, record=RECORD | analyse)
    assert content(out) == {"scores.csv": "1", "matches.csv": "1", "results.csv": "2"}
    run(out, {"scores.csv": "3"}, record=RECORD | overlay)  # replaces its own files, and only these
    assert content(out) == {"scores.csv": "3", "results.csv": "2"}
    assert [record["outputs"] for record in read_records(out)] == [["scores.csv"], ["results.csv"]]
    assert [record["command"] for record in read_records(out)] == [overlay["command"], analyse["command"]]


def test_two_calibrations_are_two_tasks(tmp_path):
    jkr, threshold = ({"command": f"contactimg calibrate {kind} frames"} for kind in ("jkr", "threshold"))
    run(tmp_path / "out", {"calibration.json": "1"}, record=RECORD | jkr)
    with pytest.raises(InputError, match="holds the output of 'contactimg calibrate jkr'"):
        run(tmp_path / "out", {"calibration.json": "2"}, record=RECORD | threshold)


@pytest.mark.parametrize("damage", ["{", "[]", '{"outputs": 3}', "{}"])
def test_folder_with_a_damaged_provenance_is_refused(tmp_path, damage):
    (tmp_path / "provenance.json").write_text(damage)
    with pytest.raises(InputError, match=r"holds files but no earlier run \(among them provenance\.json\)"):
        run(tmp_path, {"a.txt": "1"})


def test_provenance_that_points_outside_deletes_nothing_there(tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    (tmp_path / "out").mkdir()
    outputs = ["../precious.txt", str(tmp_path / "precious.txt")]
    (tmp_path / "out" / "provenance.json").write_text(json.dumps(RECORD | {"inputs": [], "outputs": outputs}))
    run(tmp_path / "out", {"a.txt": "1"})
    assert (tmp_path / "precious.txt").read_text() == "mine"


def test_output_folder_that_is_a_file(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError) as caught:
        run(tmp_path / "out", {"a.txt": "1"})
    assert str(caught.value) == (
        f"{tmp_path / 'out'}: cannot be written (File exists); choose another output folder"
    )
    with pytest.raises(
        InputError, match=r"cannot be written \(Not a directory\); choose another output folder$"
    ):
        run(tmp_path / "out" / "below", {"a.txt": "1"})


def test_output_folder_without_permission(tmp_path, monkeypatch):
    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)  # a mode would not stop an administrator
    with pytest.raises(InputError) as caught:
        run(tmp_path / "out", {"a.txt": "1"})
    assert str(caught.value) == (
        f"{tmp_path / 'out'}: cannot be written (Permission denied); choose another output folder"
    )


def test_two_runs_at_the_same_time(tmp_path):
    sentence = (
        f"{tmp_path / 'out'}: another run is writing there; wait for it or choose another output folder"
    )
    with OutputFolder(tmp_path / "out", RECORD) as out:
        (out.folder / "a.txt").write_text("first")
        with pytest.raises(InputError) as caught:
            run(tmp_path / "out", {"a.txt": "second"})
        assert str(caught.value) == sentence
    assert content(tmp_path / "out") == {"a.txt": "first"}
    run(tmp_path / "out", {"a.txt": "third"})
    assert content(tmp_path / "out") == {"a.txt": "third"}


HOLDER = """
import sys, time
from pathlib import Path
from contactimg.files import OutputFolder
with OutputFolder(Path(sys.argv[1]), {}) as out:
    print("holding", flush=True)
    time.sleep(60)
"""


def test_lock_holds_between_processes_and_ends_with_a_killed_one(tmp_path):
    out = tmp_path / "out"
    with subprocess.Popen(  # noqa: S603
        [sys.executable, "-c", HOLDER, str(out)], stdout=subprocess.PIPE, text=True
    ) as holder:
        try:
            assert holder.stdout.readline() == "holding\n"
            with pytest.raises(InputError, match="another run is writing there"):
                run(out, {"a.txt": "1"})
        finally:
            holder.kill()
            holder.wait()
    run(out, {"a.txt": "2"})
    assert content(out) == {"a.txt": "2"}


# ---------------------------------------------------------------- provenance, reading back


@pytest.fixture
def experiment(tmp_path):
    """A folder of two frames with scene and loads."""
    folder = tmp_path / "data"
    folder.mkdir()
    for k in range(2):
        write_frame(Frame(np.full((3, 4), k, np.uint8)), folder / f"frame_{k}.tif")
    (folder / "loads.csv").write_text("frame,load_N\nframe_0.tif,0.1\nframe_1.tif,0.2\n")
    (folder / "scene.toml").write_text("[camera]\npixel_size_m = 6e-6\nrotation_deg = 0.5\n")
    return open_experiment(read_scene(folder))


def test_provenance_says_what_a_repetition_needs(experiment):
    record = provenance(
        command="contactimg process data",
        scene=experiment.scene,
        options={"workers": 2},
        inputs=experiment.inputs,
    )
    assert record["schema_version"] == 1
    assert record["command"] == "contactimg process data"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", record["created"])
    assert record["versions"]["contactimg"] == contactimg.__version__
    assert record["versions"]["numpy"] == np.__version__
    assert {"python", "tifffile", "opencv-python-headless"} <= set(record["versions"])
    assert "pytest" not in record["versions"]
    configuration = record["configuration"]
    assert configuration["options"] == {"workers": 2}
    assert configuration["scene"]["camera"]["pixel_size_m"] == 6e-6
    assert configuration["scene"]["measure"]["threshold"] == 0.5  # a default
    names = [Path(entry["path"]).name for entry in record["inputs"]]
    assert names == ["frame_0.tif", "frame_1.tif", "loads.csv"]
    data = list(experiment.inputs)[2].read_bytes()
    assert record["inputs"][2]["sha256"] == hashlib.sha256(data).hexdigest()
    assert record["inputs"][2]["bytes"] == len(data)


def test_provenance_of_an_input_that_vanished(tmp_path):
    (entry,) = provenance(command="", inputs=[tmp_path / "gone.tif"])["inputs"]
    assert (entry["sha256"], entry["error"]) == (None, "No such file or directory")


CONTACTS_TABLE = CONTACTS.conform(
    pd.DataFrame({"frame": ["frame_0.tif"] * 2, "label": [1, 2], "x_px": [1 / 3, np.pi], "flags": [0, 5]})
)
FRAMES_TABLE = FRAMES.conform(pd.DataFrame({"frame": ["frame_0.tif"], "status": ["ok"], "n_contacts": [2]}))


def write_run(experiment, folder):
    with OutputFolder(folder, provenance(command="x", scene=experiment.scene)) as out:
        write_table(CONTACTS_TABLE, CONTACTS, out.folder / "contacts.csv")
        write_table(FRAMES_TABLE, FRAMES, out.folder / "frames.csv")
    return folder


def test_run_is_read_back(experiment, tmp_path):
    result = read_run(write_run(experiment, tmp_path / "data" / "contactimg_out"))
    pd.testing.assert_frame_equal(result.contacts, CONTACTS_TABLE, check_exact=True)
    pd.testing.assert_frame_equal(result.frames, FRAMES_TABLE, check_exact=True)
    assert result.scene.configuration == experiment.scene.configuration
    assert open_experiment(result.scene).load_of("frame_1.tif") == 0.2
    assert result.provenance["outputs"] == ["contacts.csv", "frames.csv"]


def test_run_finds_its_frames_after_the_whole_folder_moved(experiment, tmp_path):
    write_run(experiment, tmp_path / "data" / "contactimg_out")
    shutil.move(tmp_path / "data", tmp_path / "elsewhere")
    result = read_run(tmp_path / "elsewhere" / "contactimg_out")
    assert open_experiment(result.scene).frames[1].read().image[0, 0] == 1


def test_folder_without_a_run(tmp_path):
    with pytest.raises(InputError) as caught:
        read_run(tmp_path)
    assert str(caught.value) == f"{tmp_path}: holds no run of contactimg (provenance.json is missing)"


@pytest.mark.parametrize("text", ["{", "[]", '{"schema_version": "a", "configuration": {}}', "{}"])
def test_run_with_a_damaged_provenance(tmp_path, text):
    (tmp_path / "provenance.json").write_text(text)
    with pytest.raises(InputError, match=r"provenance\.json: is damaged \(.*\); repeat the run$"):
        read_run(tmp_path)


def test_run_of_a_newer_version(tmp_path):
    (tmp_path / "provenance.json").write_text('{"schema_version": 99, "configuration": {}}')
    with pytest.raises(
        InputError, match=r"was written by a newer contactimg \(schema 99, this one reads 1\)$"
    ):
        read_run(tmp_path)


def test_run_without_its_tables(tmp_path):
    run(tmp_path / "out", {})
    with pytest.raises(InputError, match=r"holds what `process` wrote, and no contacts\.csv; give"):
        read_run(tmp_path / "out")
