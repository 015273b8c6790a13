"""Common ground of all tests: seeded chance, a headless plot backend, floating-point errors raised."""

import os

# one thread a test process: threads of the linear algebra and of OpenCV would compete with the other process
# (fits of circles took three times the processor time with two threads); set before numpy is imported
for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")
cv2.setNumThreads(1)


@pytest.fixture(autouse=True)
def _floating_point_errors_are_raised():
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20140801)


@pytest.fixture
def svg_only(monkeypatch) -> None:
    """Commands write figures as SVG alone, the fastest of the formats."""
    monkeypatch.setattr("contactimg.files.figures.FIGURE_FORMATS", ("svg",))


@pytest.fixture(scope="session")
def small_series(tmp_path_factory) -> Path:
    """Folder of a small synthetic series; copy it before you change it."""
    from small_series import write_small_series

    return write_small_series(tmp_path_factory.mktemp("small") / "series")
