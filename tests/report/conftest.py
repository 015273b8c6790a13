"""A run for the tests of the report."""

import pytest
from small_series import copy_of

from contactimg.cli import main

HOSTILE = '<script>alert(1)<b>&".tif'


@pytest.fixture(scope="session")
def finished(small_series, tmp_path_factory):
    """A run with a hostile name and a failed frame, an analysis in its folder and a comparison inside."""
    top = tmp_path_factory.mktemp("report")
    series, folder = copy_of(small_series, top / "series"), top / "run"
    (series / "frame_1.tif").rename(series / HOSTILE)
    (series / "frame_2.tif").write_bytes(b"no image")
    loads = (series / "loads.csv").read_text(encoding="utf-8")
    quoted = '"' + HOSTILE.replace('"', '""') + '"'
    (series / "loads.csv").write_text(loads.replace("frame_1.tif", quoted), encoding="utf-8")
    scene = (series / "scene.toml").read_text(encoding="utf-8")
    (series / "scene.toml").write_text(scene.replace('"frame_*.tif"', '"*.tif"'), encoding="utf-8")
    assert main(["process", str(series), "-o", str(folder), "--quiet", "--workers", "1"]) == 1
    assert main(["overlay", str(folder), "--quiet"]) == 0
    assert main(["analyse", str(folder), "-o", str(folder), "--quiet", "--workers", "1"]) == 0
    return folder
