"""Common ground of all tests: seeded chance, a headless plot backend, floating-point errors raised."""

import gc
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
gc.disable()  # until the tests are collected


WITHOUT_IMAGES = {Path(__file__).parent / name for name in ("analysis", "mechanics", "models")}
LONG = {Path(__file__).parent / name for name in ("test_documentation.py", "test_notebooks.py")}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of two processes, which begin with half of the tests each, one compiles what measures images.

    The second half begins with tests that need none of that; later it finds the machine code stored. Then the
    longest come: the last of the tests, which either process may take, are short.
    """
    parts: tuple[list[pytest.Item], ...] = [], [], []
    for item in items:
        parts[1 if WITHOUT_IMAGES & set(item.path.parents) else 2 * (item.path in LONG)].append(item)
    rest, other, long = parts
    half = len(items) // 2
    items[:] = [*rest[:half], *other, *long, *rest[half:]]


def pytest_collection_finish() -> None:
    """Modules and tests live as long as the process: to search them for garbage again and again is in vain.

    That took a tenth of the time of the tests.
    """
    gc.enable()
    gc.freeze()


@pytest.fixture(autouse=True)
def _floating_point_errors_are_raised():
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20140801)


@pytest.fixture(scope="session", autouse=True)
def _figures_are_svg_alone_and_processes_are_started_only_where_asked_for():
    """SVG is the fastest of the formats; `tests/plots/test_figures.py` asks for all of them.

    Other processes would compete with those of the tests; `tests/engine` asks for them.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("contactimg.files.figures.FIGURE_FORMATS", ("svg",))
        patch.setattr("contactimg.engine.parallel.cpu_count", lambda: 1)
        yield


@pytest.fixture(scope="session", autouse=True)
def figures_without_layout():
    """Figures are drawn where they stand: to lay them out takes most of the time; `tests/plots` does."""
    from contactimg.plots import axes

    class Plain(axes.Figure):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options | {"layout": None})

    figure = axes.Figure
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(axes, "Figure", Plain)
        yield figure


@pytest.fixture
def figures_stay_unwritten(monkeypatch):
    """Figures are made, but in no format: for tests of what is beside them."""
    monkeypatch.setattr("contactimg.files.figures.FIGURE_FORMATS", ())


@pytest.fixture(scope="session")
def small_series(tmp_path_factory) -> Path:
    """Folder of a small synthetic series; copy it before you change it."""
    from small_series import write_small_series

    return write_small_series(tmp_path_factory.mktemp("small") / "series")


@pytest.fixture(scope="session")
def tiny_series(tmp_path_factory) -> Path:
    """Folder of three frames of 120 x 90 pixels; copy it before you change it."""
    from small_series import TINY, write_small_series

    return write_small_series(tmp_path_factory.mktemp("tiny") / "series", TINY)
