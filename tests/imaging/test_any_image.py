"""Images that nobody made for contacts do no harm; `tests/fuzz/fuzz_images.py` runs hundreds."""

import time

import numpy as np
import pytest
from any_images import METHODS, faults, made_images, more_images, odd_images, photographs, reference_of, sized

from contactimg.imaging.measure import measure_image

IMAGES, ODD = made_images(96), odd_images(96)


@pytest.mark.parametrize("name", IMAGES)
def test_any_image_is_measured_without_harm(name):
    names = sorted(IMAGES)
    number = names.index(name)
    method = METHODS[number % len(METHODS)]
    other = IMAGES[names[(number + 3) % len(names)]]
    kind, polarity = ("none", "right", "wrong")[number % 3], ("bright", "dark")[number % 2]
    assert not faults(IMAGES[name], reference_of(kind, IMAGES[name], other), method=method, polarity=polarity)


@pytest.mark.parametrize("name", ODD)
def test_what_a_laboratory_may_save_is_measured_without_harm(name):
    number = sorted(ODD).index(name)
    other, kind = ODD[sorted(ODD)[number - 7]], ("none", "right", "wrong")[number % 3]
    for method, polarity in zip(METHODS, ("bright", "dark"), strict=True):
        assert not faults(ODD[name], reference_of(kind, ODD[name], other), method=method, polarity=polarity)


@pytest.fixture(scope="module")
def other_things():
    """Pictures that show no contacts."""
    made, seen = made_images(120), photographs()
    return {
        "text": made["text"],
        "checkerboard": more_images(84)["plain checkerboard"],
        "coins": sized(seen["coins"], 19_000, np.random.default_rng(1)),
        "portrait": sized(seen["astronaut"], 19_000, np.random.default_rng(2)),
        "cell": sized(seen["cell"], 19_000, np.random.default_rng(4)),
        "stripes": made["stripes"],
    }


@pytest.mark.parametrize("name", ["text", "checkerboard", "coins", "portrait", "cell", "stripes"])
def test_a_picture_of_other_things_ends_soon_and_is_not_ok(other_things, name):
    start = time.process_time()
    result = measure_image(other_things[name])
    # an ordinary frame of this size takes 0.03 s; the slowest machine is ten times slower
    assert time.process_time() - start < 6.5
    assert result.status != "ok"
    assert result.message


def test_no_contrast_that_contacts_show_is_beyond_what_the_frame_spans():
    """Sharp dots as floats of no stated full scale: the fit once took 1.6 times the highest pixel."""
    dots = more_images(200)["plain dots"] / np.float32(255)
    result = measure_image(dots, polarity="bright")
    assert len(result.disks) > 100
    assert abs(result.contrast) <= np.ptp(dots) * (1 + 1e-6)
