"""The short part of the fuzzing of files; `fuzz_files.py` is the long one."""

import os

import pytest
from file_cases import make_samples
from fuzz_files import PIXELS, in_a_child, kind_of

from contactimg.files import decoders

pytestmark = pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux")  # noqa: PTH110


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    return make_samples(tmp_path_factory.mktemp("samples"))


@pytest.mark.parametrize(
    ("kinds", "count"),
    [(["tiff", "still", "seq", "video", "scene", "table"], 36), (["run"], 3)],
)
def test_mutated_files_are_read_or_refused(samples, monkeypatch, kinds, count):
    monkeypatch.setattr(decoders, "MAX_PIXELS", PIXELS)
    for number in range(count):
        text = in_a_child(number, 15, kind_of(number, kinds), samples, limit=60.0)
        assert text in {"read", "refused"}, f"case {number} of seed 15: {text}"
