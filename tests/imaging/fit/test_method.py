"""The steps of the method "disk" from one attempt to the next."""

from types import SimpleNamespace

import numpy as np
import pytest

from contactimg.imaging.contrast.noise import Noise
from contactimg.imaging.fit.method import _next_start, _Start
from contactimg.imaging.fit.problem import ContrastPrior, FitProblem


def polynomial(level, slope):
    coefficients = np.zeros((4, 4))
    coefficients[0, :2] = level, slope
    return coefficients


def test_a_later_attempt_removes_each_illumination_once():
    first, second = polynomial(5.0, 1.0), polynomial(-2.0, 3.0)
    image = np.full((64, 96), 7.0, np.float32)
    problem = FitProblem(image, Noise(1.0), ContrastPrior.loose(100.0))
    start = _Start(problem.without_background(first), blur=1.4, free_blur=True)
    result = SimpleNamespace(problem=start.problem.without_background(second), edge=None, has_film=False)
    joint = SimpleNamespace(contrast=80.0, fit=SimpleNamespace(blur=1.5), wide_contrast=80.0)
    following = _next_start(start, result, joint)
    assert following.problem.removed_background == pytest.approx(first + second)
    assert following.problem.image == pytest.approx(
        problem.without_background(first + second).image, abs=1e-4
    )
    assert following.contrast == 80.0
