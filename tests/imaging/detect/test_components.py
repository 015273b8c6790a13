"""Run-length labelling against `scipy.ndimage`."""

import numpy as np
import pytest
from scipy import ndimage

from contactimg.imaging.count.split_touching import _share
from contactimg.imaging.detect.components import label_components


@pytest.mark.parametrize("density", [0.05, 0.3, 0.6])
@pytest.mark.parametrize("shape", [(1, 40), (37, 1), (48, 61)])
def test_components_are_those_of_scipy(rng, density, shape):
    image = rng.random(shape).astype(np.float32)
    level = 1 - density
    labels, count = ndimage.label(image > level, np.ones((3, 3)))
    found = label_components(image, level)
    assert len(found) == count
    index = np.arange(1, count + 1)
    order = [int(labels[c["peak_y"], c["peak_x"]]) for c in found]
    assert sorted(order) == list(index)
    for name, truth in {
        "area": ndimage.sum_labels(np.ones(shape), labels, order),
        "flux": ndimage.sum_labels(image.astype(float), labels, order),
        "peak": ndimage.maximum(image, labels, order),
        "x": [c[1] for c in ndimage.center_of_mass(np.ones(shape), labels, order)],
        "y": [c[0] for c in ndimage.center_of_mass(np.ones(shape), labels, order)],
    }.items():
        assert np.allclose(found[name], truth, rtol=1e-6, atol=1e-9), name
    boxes = ndimage.find_objects(labels)
    for c, label in zip(found, order, strict=True):
        rows, columns = boxes[label - 1]
        assert (c["top"], c["bottom"], c["left"], c["right"]) == (
            rows.start, rows.stop - 1, columns.start, columns.stop - 1
        )  # fmt: skip


def test_a_spiral_is_one_component():
    # union of runs that meet only rows later
    image = np.array(
        [[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 0, 1, 0, 1], [1, 0, 1, 1, 1], [1, 0, 0, 0, 0]], np.float32
    )
    (only,) = label_components(image, 0.5)
    assert only["area"] == image.sum()


def test_nothing_above_the_level_is_an_empty_result():
    assert len(label_components(np.zeros((4, 4), np.float32), 0.5)) == 0


def test_pixels_go_to_the_disk_with_the_least_power(rng):
    disks = np.column_stack([rng.uniform(0, 60, 40), rng.uniform(0, 40, 40), rng.uniform(2, 9, 40)])
    y, x = np.mgrid[0:40, 0:60]
    powers = [(x - cx) ** 2 + (y - cy) ** 2 - a**2 for cx, cy, a in disks]
    parts = _share(np.ones(x.shape, np.float32), disks)
    nearest = np.argmin(powers, axis=0)
    assert parts["area"].tolist() == np.bincount(nearest.ravel(), minlength=40).tolist()
