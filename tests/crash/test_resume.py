"""A run that was ended is taken up: what was measured is not measured again, and the files are the same."""

import hashlib
import pickle
import shutil
import tracemalloc
from dataclasses import replace
from functools import wraps

import numpy as np
import pandas as pd
import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import EncodedResult, FrameStore, KeyList, open_experiment, provenance, read_scene
from contactimg.files.frame_store import STORE_FILE
from contactimg.files.records import decode, encode
from contactimg.imaging.profile.optics import Halo, SharedOptics
from contactimg.pipeline import measured_series, series
from contactimg.pipeline.measured_frame import MeasuredFrame, MeasuredFrames
from contactimg.pipeline.parallel import FailedFrame
from contactimg.pipeline.written_run import write_run
from contactimg.tables import CONTACTS, REJECTED
from contactimg.tradeoff.choice import Choice

TABLES = ("contacts.csv", "frames.csv", "rejected.csv")


@pytest.fixture
def measured(monkeypatch):
    """Names of the frames that are measured; the run is ended before the one with the number ``stop``."""
    calls, measure = [], series.measure_scene_frame
    calls_and_stop = {"calls": calls, "stop": None}

    @wraps(measure)
    def counting(frame, *arguments, **options):
        if calls_and_stop["stop"] == len(calls):
            raise KeyboardInterrupt
        calls.append(frame.name)
        return measure(frame, *arguments, **options)

    monkeypatch.setattr(series, "measure_scene_frame", counting)
    return calls_and_stop


def process(folder, out, *options):
    return main(
        ["process", str(folder), "-o", str(out), "--workers", "1", "--no-pictures", "--quiet", *options]
    )


def contents(out):
    return {name: (out / name).read_bytes() for name in TABLES}


def test_taken_up_after_any_frame(small_series, tmp_path, measured, capfd):
    calls = measured["calls"]
    assert process(small_series, tmp_path / "whole") == 0
    whole, expected = list(calls), contents(tmp_path / "whole")
    assert len(whole) > 3, "the series must have a second pass"
    for stop in range(len(whole)):
        out = tmp_path / f"out{stop}"
        calls.clear()
        measured["stop"] = stop
        assert process(small_series, out) == 2
        assert calls == whole[:stop]
        assert not (out / "contacts.csv").exists()
        calls.clear()
        measured["stop"] = None
        capfd.readouterr()
        assert process(small_series, out) == 0
        assert calls == whole[stop:]
        assert contents(out) == expected
        said = f"contactimg: {min(stop, 3)} of 3 frames were done by a run that was ended; the others are"
        assert capfd.readouterr().err == (f"{said} measured\n" if stop else "")
        assert [path.name for path in out.rglob(".*")] == []


def test_other_settings_frames_or_tables_are_measured_again(small_series, tmp_path, measured):
    calls, folder, out = measured["calls"], copy_of(small_series, tmp_path / "series"), tmp_path / "out"
    names, second_pass = ["frame_1.tif", "frame_2.tif", "frame_3.tif"], []

    def measured_now(*options, change=lambda: None):
        """After a run that was ended when all three frames were done once."""
        measured["stop"] = None
        calls.clear()
        process(folder, out)
        second_pass[:] = calls[3:]
        measured["stop"] = 3
        calls.clear()
        assert process(folder, out) == 2
        change()
        measured["stop"] = None
        calls.clear()
        process(folder, out, *options)
        return calls

    def other_frame():
        (folder / "frame_2.tif").write_bytes((folder / "frame_3.tif").read_bytes())

    def other_asperities():
        table = folder / "asperities.csv"
        table.write_text(table.read_text() + "0.5,0.5,0,1e-4\n")

    assert measured_now() == second_pass
    assert measured_now("--threshold", "0.4")[:3] == names
    assert measured_now("--reference", str(folder / "frame_1.tif"))[:2] == names[1:]
    assert measured_now(change=other_frame)[0] == "frame_2.tif"
    assert measured_now(change=other_asperities)[:3] == names


class InTwoParts:
    """A result in two parts."""

    def __init__(self, value):
        self.value = value

    def records(self):
        """The parts."""
        return {"value": self.value, "text": "é\n"}, ["second", self.value]


def filled(folder):
    """A store of three results that was not closed, and their keys."""
    record = {"inputs": [{"path": str(folder / "a.tif"), "sha256": "01" * 32}]}
    store = FrameStore(folder / "store", record)
    keys = [store.key(store.common("s", []), folder / "a.tif", k) for k in range(3)]
    for k, key in enumerate(keys):
        store.put(key, EncodedResult.of(InTwoParts(k)))
    return store, keys


def test_results_whose_writing_was_cut_off_are_dropped(tmp_path):
    _store, keys = filled(tmp_path)
    log = next((tmp_path / "store").glob("*-wal")).read_bytes()
    held = []
    for cut in (*range(0, len(log), 997), len(log)):
        copy = tmp_path / f"cut_{cut}"
        copy.mkdir()
        (copy / STORE_FILE).write_bytes((tmp_path / "store" / STORE_FILE).read_bytes())
        (copy / f"{STORE_FILE}-wal").write_bytes(log[: len(log) - cut])
        again = FrameStore(copy, {})
        held.append([key in again for key in keys])
        for k, key in enumerate(keys):
            if key in again:
                assert again.get(key) == {"value": k, "text": "é\n"}
                assert again.get(key, 1) == ["second", k]
        again.put(keys[2], EncodedResult.of("new"))
        assert again.get(keys[2]) == "new"
        again.close()
    assert [True, True, True] in held
    assert [True, True, False] in held
    assert all(found == sorted(found, reverse=True) for found in held)


def test_a_damaged_store_is_started_again_or_named(tmp_path, caplog, monkeypatch):
    store, keys = filled(tmp_path)
    store.close()
    file = tmp_path / "store" / STORE_FILE
    whole = file.read_bytes()
    file.write_bytes(b"something else" * 100)
    again = FrameStore(file.parent, {})
    assert [key in again for key in keys] == [False, False, False]
    again.remove()
    monkeypatch.setattr(shutil, "rmtree", lambda _: None)  # it cannot be deleted
    file.parent.mkdir()
    file.write_bytes(b"something else" * 100)
    with pytest.raises(InputError, match="is not a database; delete"):
        FrameStore(file.parent, {})
    monkeypatch.undo()
    assert "the frames are measured again" in caplog.text
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(whole.replace(b'["second",2]', b'["second",3]'))
    again = FrameStore(file.parent, {})
    assert again.get(keys[1], 1) == ["second", 1]
    with pytest.raises(InputError, match="is damaged; delete"):
        again.get(keys[2], 1)


def test_a_file_without_digest_is_not_stored(tmp_path):
    store = FrameStore(tmp_path, {"inputs": [{"path": str(tmp_path / "a.tif"), "sha256": None}]})
    assert store.key(store.common("s", []), tmp_path / "a.tif", 1) is None
    assert store.common("s", [tmp_path / "b.csv"]) is None
    assert store.common(object(), []) is None


def test_records_come_back_bit_for_bit():
    contacts = CONTACTS.conform(
        pd.DataFrame({"frame": ["a", "b"], "x_px": [0.1, np.nan], "asperity": [3, pd.NA], "flags": [1, 0]})
    )
    optics = SharedOptics(0.1 + 0.2, np.float64(1e-300), 5e-324, 1 / 3, halo=Halo(0.1, np.inf))
    row = {"frame": "a", "n_contacts": pd.NA, "noise": np.float32(0.1), "shift_x_px": -0.0}
    part = MeasuredFrame(contacts, REJECTED.empty(), row, (3, 4), optics)
    again = decode(encode(part))
    pd.testing.assert_frame_equal(again.contacts, contacts, check_exact=True)
    pd.testing.assert_frame_equal(again.rejected, part.rejected)
    assert again.row["n_contacts"] is pd.NA
    assert again.own_optics == optics
    assert again.shape == (3, 4)
    assert repr(again.row["shift_x_px"]) == "-0.0"
    array = np.array([[1.5, np.nan]], np.float32)
    np.testing.assert_array_equal(decode(encode(array)), array)
    assert decode(encode(array)).dtype == np.float32


@pytest.mark.parametrize(
    "text", ['{"@":"record","class":"os:system","fields":{}}', '{"@":"x"}', "{}", '{"@":"record","class":1}']
)
def test_a_damaged_record_is_an_error(text):
    with pytest.raises(ValueError, match="is no"):
        decode(text)


def test_frames_leave_their_tables_in_the_store(small_series, tmp_path):
    experiment = open_experiment(read_scene(small_series))
    record = provenance(command="contactimg process", scene=experiment.scene, inputs=experiment.inputs)
    store = FrameStore(tmp_path / "store", record)
    kept = series.measure_parts(experiment, workers=1, store=store)
    held = series.measure_parts(experiment, workers=1)
    for shelved, part in zip(kept.parts, held.parts, strict=True):
        assert vars(shelved) == {}
        again = pickle.loads(pickle.dumps(shelved))  # noqa: S301
        assert type(again) is MeasuredFrame
        pd.testing.assert_frame_equal(again.contacts, part.contacts, check_exact=True)
        chosen = shelved.with_choice(Choice("disk", error=0.077, stated=0.002, relative=0.01, output="area"))
        assert vars(chosen) == {}
        assert chosen.whole().row["message"].endswith(str(chosen.choice))
    pd.testing.assert_frame_equal(kept.whole().contacts, held.whole().contacts, check_exact=True)


def test_blocks_of_frames_give_the_tables_of_all(small_series, tmp_path, monkeypatch):
    parts = series.measure_parts(open_experiment(read_scene(small_series)), workers=1)
    whole = parts.whole()
    monkeypatch.setattr(measured_series, "BLOCK_FRAMES", 1)
    for folder in ("alone", "together"):
        (tmp_path / folder).mkdir()
        written = write_run(parts, tmp_path / folder)
        pd.testing.assert_frame_equal(written.frames, whole.frames, check_exact=True)
        monkeypatch.undo()
    for name in TABLES:
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "together" / name).read_bytes()


@pytest.mark.parametrize("table_format", ["csv", "parquet"])
def test_blocks_are_the_same_from_any_process(small_series, tmp_path, monkeypatch, table_format):
    experiment = open_experiment(read_scene(small_series))
    record = provenance(command="contactimg process", scene=experiment.scene, inputs=experiment.inputs)
    store = FrameStore(tmp_path / "store", record)
    kept = series.measure_parts(experiment, workers=2, store=store)
    monkeypatch.setattr(measured_series, "BLOCK_FRAMES", 1)
    for folder, workers in (("one", 1), ("two", 2)):
        (tmp_path / folder).mkdir()
        write_run(replace(kept, workers=workers), tmp_path / folder, table_format)
    written = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert f"contacts.{table_format}" in written
    for name in written:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_of_frames_in_a_store_only_keys_are_held(small_series, tmp_path):
    experiment = open_experiment(read_scene(small_series))
    record = provenance(command="contactimg process", scene=experiment.scene, inputs=experiment.inputs)
    shelved = list(series.measure_parts(experiment, store=FrameStore(tmp_path / "store", record)).parts)
    failed = MeasuredFrame.failed(FailedFrame.of("frame_2.tif", ValueError("odd")))
    chosen = shelved[2].with_choice(Choice("disk", error=0.077, stated=0.002, relative=0.01, output="area"))
    frames = MeasuredFrames([*shelved, failed])
    frames[1], frames[2], frames[3] = failed, chosen, shelved[0]
    assert [part.row["frame"] for part in frames] == [shelved[k].row["frame"] for k in (0, 1, 2, 0)]
    assert frames[1] is failed
    assert frames[2] is chosen
    assert [part.row for part in frames[2:]] == [chosen.row, shelved[0].row]
    frames[1] = shelved[1]
    pd.testing.assert_frame_equal(frames[1].contacts, shelved[1].contacts, check_exact=True)
    pd.testing.assert_frame_equal(frames[-1].contacts, shelved[0].contacts, check_exact=True)
    with pytest.raises(IndexError):
        frames[4]


def test_a_list_of_keys_takes_little_memory_and_knows_where_there_is_none():
    made = [None if k % 3 == 0 else hashlib.sha256(bytes([k])).digest() for k in range(9)]
    keys = KeyList(made)
    assert list(keys) == made
    assert keys[-1] == made[-1]
    assert list(keys[2:7:2]) == made[2:7:2]
    keys[1], keys[3] = None, made[5]
    assert list(keys[:4]) == [None, None, made[2], made[5]]
    with pytest.raises(IndexError):
        keys[9]
    tracemalloc.start()
    many = KeyList(made[1] for _ in range(10_000))
    taken = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert len(many) == 10_000
    assert taken < 40 * len(many)
