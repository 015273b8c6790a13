"""Common ground of all tests: seeded chance, a headless plot backend, floating-point errors raised."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")


@pytest.fixture(autouse=True)
def _floating_point_errors_are_raised():
    with np.errstate(all="raise", under="ignore"):
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20140801)


@pytest.fixture(scope="session")
def small_series(tmp_path_factory) -> Path:
    """Folder of a small synthetic series; copy it before you change it."""
    from small_series import write_small_series

    return write_small_series(tmp_path_factory.mktemp("small") / "series")
