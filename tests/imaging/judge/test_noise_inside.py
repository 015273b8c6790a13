"""Noise of contacts as their insides show it."""

import numpy as np
import pytest
from contactimg.imaging.judge import shape_ladder
from contactimg.imaging.judge.noise_inside import gain_of_texture
from shape_frames import ellipse, frame

from contactimg.imaging.contrast.noise import Noise, NoiseCorrelation
from contactimg.imaging.measure import measure_image

PLACES = [(x, y, 10.0 + 0.5 * ((x + 2 * y) % 7)) for x in range(30, 260, 50) for y in range(30, 200, 50)]


def noise_of(monkeypatch, *, growth):
    """Noise that the ladder assumes on a frame of ellipses whose noise grows by ``growth`` over a contact."""
    seen, build = [], shape_ladder.ShapeScene.of
    monkeypatch.setattr(shape_ladder.ShapeScene, "of", lambda *args: seen.append(build(*args)) or seen[-1])
    rng = np.random.default_rng(4)
    shapes, angles = [ellipse(1.3)] * len(PLACES), rng.uniform(-1.5, 1.5, len(PLACES))
    image, reference, _ = frame(shapes, PLACES, angles=angles, rng=rng, shape=(200, 260), noise=2.6)
    light = np.clip(image / 16.0 - 80.0, 0.0, 100.0) / 100.0
    more = 16.0 * 2.6 * np.sqrt(growth * light) * rng.standard_normal(image.shape)
    measure_image((image + np.rint(more)).astype(np.uint16), reference)
    return seen[-1].problem.noise


@pytest.mark.parametrize(("growth", "expected"), [(0.0, 0.0), (0.5, 0.5), (1.25, 1.25)])
def test_noise_inside_contacts_is_what_is_seen(monkeypatch, growth, expected):
    noise = noise_of(monkeypatch, growth=growth)
    # 20 insides of 20 to 90 pixels, 1,000 degrees of freedom: 5 %, of 1 to 2.25 times the variance
    assert noise.slope == pytest.approx(expected, abs=0.3)
    assert noise.rim == 0.0


def test_texture_is_no_brighter_than_the_insides_show():
    correlation = NoiseCorrelation(np.array([4.0, 0.4, *np.zeros(9)]))
    expected = Noise(4.0, 1.25)
    assert gain_of_texture(expected, expected, correlation) == 2.25
    assert gain_of_texture(expected, Noise(4.0, 0.0), correlation) == 1.0
    # (g^2 - 1) 0.4 = 0.1 x 4
    assert gain_of_texture(expected, Noise(4.0, 0.1), correlation) == pytest.approx(np.sqrt(2.0))
