"""Common ground of all tests: seeded chance, a headless plot backend, floating-point errors raised."""

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
