"""A run that was ended is taken up: what was measured is not measured again, and the files are the same."""

import pickle
import sys
from dataclasses import dataclass
from functools import wraps
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.errors import InputError
from contactimg.files import PartStore, fingerprint, open_experiment, provenance, read_scene
from contactimg.pipeline import measured_series, series
from contactimg.pipeline.measured_series import write_run
from contactimg.tables import Flag

TABLES = ("contacts.csv", "frames.csv", "rejected.csv")
MOST_BYTES = 4000  # of a frame: 0.4 GB for a series of 100,000, which may take 1 GB with everything else


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


def test_taken_up_after_any_frame(tiny_series, tmp_path, measured, capfd):
    calls = measured["calls"]
    assert process(tiny_series, tmp_path / "whole") == 0
    whole, expected = list(calls), contents(tmp_path / "whole")
    assert len(whole) > 3, "the series must have a second pass"
    # in the first pass, and in the second; the next test ends the run between them
    for stop in (1, len(whole) - 1):
        out = tmp_path / f"out{stop}"
        calls.clear()
        measured["stop"] = stop
        assert process(tiny_series, out) == 2
        assert calls == whole[:stop]
        assert not (out / "contacts.csv").exists()
        calls.clear()
        measured["stop"] = None
        capfd.readouterr()
        assert process(tiny_series, out) == 0
        assert calls == whole[stop:]
        assert contents(out) == expected
        said = f"contactimg: {min(stop, 3)} of 3 frames were done by a run that was ended; the others are"
        assert capfd.readouterr().err == f"{said} measured\n"
        assert [path.name for path in out.rglob(".*")] == []


def test_other_settings_frames_or_tables_are_measured_again(tiny_series, tmp_path, measured):
    calls, folder = measured["calls"], copy_of(tiny_series, tmp_path / "series")
    names = ["frame_1.tif", "frame_2.tif", "frame_3.tif"]

    def measured_now(*options, change=lambda: None, most=3):
        """The first frames after a run that was ended before its second pass."""
        out = tmp_path / f"out{len(list(tmp_path.iterdir()))}"
        measured["stop"] = 3
        calls.clear()
        assert process(folder, out) == 2
        change()
        measured["stop"] = most
        calls.clear()
        process(folder, out, *options)
        return calls

    def other_frame():
        (folder / "frame_2.tif").write_bytes((folder / "frame_3.tif").read_bytes())

    def other_asperities():
        table = folder / "asperities.csv"
        table.write_text(table.read_text() + "1.9e-3,1.9e-3,0,1e-4\n")

    assert process(folder, tmp_path / "whole") == 0
    second = calls[3:]
    assert second
    assert measured_now(most=None) == second
    assert measured_now("--method", "threshold") == names
    assert measured_now("--reference", str(folder / "frame_1.tif"))[:2] == names[1:]
    assert measured_now(change=other_frame)[:1] == ["frame_2.tif"]
    assert measured_now(change=other_asperities) == names


@dataclass(frozen=True)
class Settings:
    """Whatever a result may depend on."""

    value: object
    folder: Path = Path("a/b")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (0.1 + 0.2, 0.3),
        (np.float64(0.1), np.nextafter(0.1, 1)),
        (np.array([1.0, 2.0]), np.array([1.0, 2.5])),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.zeros(2, np.float32), np.zeros(2)),
        ({"a": 1}, {"a": 2}),
        (pd.NA, ""),
        (b"a", b"b"),
        ({1, 2}, {1, 3}),
        (Flag.EDGE, Flag.MERGED),
    ],
)
def test_what_a_result_depends_on_decides_its_name(one, other):
    assert fingerprint(Settings(one)) != fingerprint(Settings(other))
    assert fingerprint(Settings(one)) == fingerprint(Settings(one))
    assert fingerprint({"a": one, "b": 2}) == fingerprint({"b": 2, "a": one})


def test_what_has_no_fingerprint_is_an_error_of_the_program():
    with pytest.raises(TypeError, match="a object cannot be written as JSON"):
        fingerprint([object()])


def squares(store, names, calls, numbers=range(3)):
    """The squares of numbers through a store."""

    def square(number):
        calls.append(number)
        return number**2

    jobs = [(number,) for number in numbers]
    return list(store.results(square, jobs, names, lost=None))


def test_a_result_that_is_whole_is_not_computed_again_and_a_damaged_one_is(tmp_path, caplog):
    store, calls = PartStore(tmp_path / "store", {}), []
    names = [store.name(store.common("squares"), None, number) for number in range(3)]
    assert squares(store, names, calls) == [0, 1, 4]
    assert squares(PartStore(tmp_path / "store", {}), names, calls) == [0, 1, 4]
    assert calls == [0, 1, 2]
    whole = (tmp_path / "store" / names[1]).read_bytes()
    for cut in range(len(whole)):
        calls.clear()
        (tmp_path / "store" / names[1]).write_bytes(whole[:cut])
        assert squares(store, names, calls) == [0, 1, 4]
        assert calls == [1]
    assert "is damaged (" in caplog.text
    assert sorted(path.name for path in (tmp_path / "store").iterdir()) == sorted(names)


def test_other_inputs_settings_or_versions_have_other_names(tmp_path):
    record = {"versions": {"numpy": "1"}, "inputs": [{"path": str(tmp_path / "a.tif"), "sha256": "01"}]}
    other = {"versions": {"numpy": "2"}, "inputs": record["inputs"]}
    third = record | {"inputs": [{"path": str(tmp_path / "a.tif"), "sha256": "02"}]}
    names = set()
    for one in (record, other, third):
        store = PartStore(tmp_path / "store", one)
        for settings in ("s", "t"):
            common = store.common(settings, [tmp_path / "a.tif"])
            names |= {store.name(common, tmp_path / "a.tif", job) for job in (1, 2)}
    assert len(names) == 3 * 2 * 2
    assert not (tmp_path / "store").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="sets the place of a user's files as Linux does")
def test_parts_of_another_user_are_not_read(tmp_path, monkeypatch):
    calls = []

    def names_of(user):
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / user))
        store = PartStore(tmp_path / "store", {})
        return [store.name(store.common("squares"), None, 3)]

    mine = names_of("me")
    assert squares(PartStore(tmp_path / "store", {}), mine, calls, [3]) == [9]
    assert names_of("me") == mine
    assert names_of("somebody") != mine
    (tmp_path / "file").touch()
    assert names_of("file") != names_of("file")  # no place for a secret
    assert calls == [3]


def test_a_file_without_digest_is_not_kept(tmp_path):
    store = PartStore(tmp_path / "s", {"inputs": [{"path": str(tmp_path / "a.tif"), "sha256": None}]})
    assert store.name(store.common("s"), tmp_path / "a.tif", 1) is None
    calls = []
    assert squares(store, [None], calls, [3]) == [9]
    assert squares(store, [None], calls, [3]) == [9]
    assert calls == [3, 3]


def test_a_store_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "store").write_text("a file of a person")
    with pytest.raises(InputError, match=r"store: cannot be written \(File exists\)"):
        squares(PartStore(tmp_path / "store", {}), ["a"], [], [1])


@pytest.fixture
def stored(tiny_series, tmp_path):
    """An experiment with a new store."""
    experiment = open_experiment(read_scene(tiny_series))
    record = provenance(command="contactimg process", scene=experiment.scene, inputs=experiment.inputs)
    return experiment, PartStore(tmp_path / "store", record)


def test_frames_leave_their_tables_in_the_store(stored):
    experiment, store = stored
    kept = series.measure_parts(experiment, store=store)
    held = series.measure_parts(experiment)
    for part, whole in zip(kept.parts, held.parts, strict=True):
        assert Path(part.where).parent == store.folder
        for name in ("contacts", "rejected", "outlines"):
            one, other = getattr(part.tables, name), getattr(whole.tables, name)
            pd.testing.assert_frame_equal(one, other, check_exact=True)
        assert repr(part.row) == repr(whole.row)
        assert part.with_remarks("remark").row["message"].endswith("remark")
    pd.testing.assert_frame_equal(kept.run.contacts, held.run.contacts, check_exact=True)
    pd.testing.assert_frame_equal(kept.run.frames, held.run.frames, check_exact=True)


def test_blocks_of_frames_give_the_tables_of_all(tiny_series, tmp_path, monkeypatch):
    parts = series.measure_parts(open_experiment(read_scene(tiny_series)))
    whole = parts.run
    monkeypatch.setattr(measured_series, "BLOCK_FRAMES", 1)
    for folder in ("alone", "together"):
        (tmp_path / folder).mkdir()
        frames, _ = write_run(parts, tmp_path / folder)
        pd.testing.assert_frame_equal(frames, whole.frames, check_exact=True)
        monkeypatch.undo()
    for name in TABLES:
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "together" / name).read_bytes()


def test_of_a_frame_in_a_store_little_stays_in_memory(stored):
    experiment, store = stored
    parts = series.measure_parts(experiment, store=store).parts
    assert all(len(pickle.dumps(part)) < MOST_BYTES for part in parts)
