"""A full disk, or a frame that changes: one sentence, the earlier result stays, the run can be taken up."""

import re
from functools import wraps

import pytest
from small_series import copy_of

from contactimg.cli import main
from contactimg.pipeline import series as series_module

resource = pytest.importorskip("resource")

TABLES = ("contacts.csv", "frames.csv", "rejected.csv", "provenance.json")
LIMITS = (0, 1_000, 3_000)  # bytes a file may have: none, below and within the tables


def process(series, out, *options):
    """Count the pixels of the frames: what is written, and when, is that of a fit."""
    words = ["process", str(series), "-o", str(out), "--workers", "1", "--no-pictures", "--quiet"]
    return main([*words, "--method", "threshold", *options])


def contents(out, names=TABLES):
    return {name: (out / name).read_bytes() for name in names}


@pytest.fixture
def disk_of(request):
    """Limit the size of files as a full disk does, also for the test process itself."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (before[1] if size is None else size, before[1]))

    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_loses_nothing(tiny_series, tmp_path, disk_of, capsys):
    series, out = copy_of(tiny_series, tmp_path / "series"), tmp_path / "out"
    assert process(series, out, "--threshold", "0.3") == 0
    earlier = contents(out)
    ended = 0
    for size in LIMITS:
        capsys.readouterr()
        disk_of(size)
        code = process(series, out)
        disk_of(None)
        if code == 0:
            continue
        ended += 1
        said = capsys.readouterr().err
        assert code == 2
        assert re.search(
            "cannot be written( or read)? [(](File too large|disk I/O error)[)]", said
        )  # SQLite's
        assert "Traceback" not in said
        assert contents(out) == earlier
    assert ended >= 2
    assert process(series, out) == 0
    assert process(series, tmp_path / "whole") == 0
    assert contents(out, TABLES[:3]) == contents(tmp_path / "whole", TABLES[:3])
    assert [path.name for path in out.rglob(".*")] == []


def test_a_frame_that_changes_while_the_command_runs(tiny_series, tmp_path, monkeypatch, capsys):
    series, out = copy_of(tiny_series, tmp_path / "series"), tmp_path / "out"
    assert process(series, out, "--threshold", "0.3") == 0
    earlier, measure = contents(out), series_module.measure_scene_frame

    @wraps(measure)
    def late(frame, *arguments, **options):
        if frame.name == "frame_3.tif":
            (series / "frame_1.tif").write_bytes((series / "frame_2.tif").read_bytes())
        return measure(frame, *arguments, **options)

    monkeypatch.setattr(series_module, "measure_scene_frame", late)
    capsys.readouterr()
    assert process(series, out) == 2
    said = capsys.readouterr().err
    assert "frame_1.tif changed while the command ran; start the command again" in said
    assert contents(out) == earlier
    monkeypatch.undo()
    assert process(series, out) == 0
    assert process(series, tmp_path / "whole") == 0
    assert contents(out, TABLES[:3]) == contents(tmp_path / "whole", TABLES[:3])
