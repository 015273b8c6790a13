"""Images that nobody made for contacts do no harm; `tests/fuzz/fuzz_images.py` runs hundreds."""

import numpy as np
import pytest
from any_images import METHODS, faults, made_images, reference_of

IMAGES = made_images(96)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", IMAGES)
def test_any_image_is_measured_without_harm(name, method):
    names = sorted(IMAGES)
    other = IMAGES[names[(names.index(name) + 3) % len(names)]]
    number = names.index(name)
    kind, polarity = ("none", "right", "wrong")[number % 3], ("bright", "dark")[number % 2]
    assert not faults(
        IMAGES[name],
        reference_of(kind, IMAGES[name], other),
        method=method,
        polarity=polarity,
        least_rise=-np.inf,
    )
