"""The compiled sums over the pixels of a disk against the same sums written out with scipy."""

import numpy as np
import pytest
from scipy import special

from contactimg.imaging.kernels.model_image import add_disk
from contactimg.imaging.kernels.normal_equations import (
    CHI_SQUARE,
    CROSS,
    FIT_BLUR_WIDTHS,
    GRADIENT,
    LARGEST_TERM,
    PIXEL_COUNT,
    SUMS,
    sum_disk,
    sum_pair,
    unpack_sums,
)
from contactimg.imaging.pixels.masks import for_kernel
from contactimg.imaging.profile.blurred_disk import blurred_disk, disk_table

SHAPE = (90, 120)
S, VARIANCE, SLOPE, RIM = 1.43, 4.0, 0.004, 0.7
DISKS = {
    "small": (40.3, 31.8, 0.7, 100.0),
    "usual": (60.2, 45.6, 5.3, 90.0),
    "wide": (58.7, 44.1, 31.0, 110.0),
    "at the border": (2.4, 50.2, 8.0, 100.0),
    "in a corner": (118.0, 88.5, 20.0, 100.0),
    "outside": (-4.0, 30.0, 6.0, 100.0),
    "larger than the image": (60.0, 45.0, 100.0, 100.0),
}


def derivatives(disk):
    """Derivatives of a disk's image with respect to x, y, a, c and s at every pixel, and the distances."""
    x, y, a, c = disk
    dy, dx = np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([y, x])[:, None, None]
    r = np.hypot(dx, dy)
    gauss = a / S**2 * np.exp(-((r - a) ** 2) / (2 * S**2))
    by_a, by_r = c * gauss * special.ive(0, r * a / S**2), -c * gauss * special.ive(1, r * a / S**2)
    outwards = by_r / np.maximum(r, 1e-9)
    by_s = -(a * by_a + r * by_r) / S
    return np.stack([-dx * outwards, -dy * outwards, by_a, blurred_disk(r, a, S), by_s]), r


def written_out(image, disk, weight):
    """Normal matrix with the blur as fifth parameter, right side, chi-square and count."""
    slopes, r = derivatives(disk)
    usable = (r <= disk[2] + FIT_BLUR_WIDTHS * S) & (weight > 0)
    rim = RIM * 4 * slopes[3] * (1 - slopes[3])
    w = usable / (VARIANCE * (1 + SLOPE * disk[3] * slopes[3] + rim))
    residual = np.where(usable, image, 0.0)
    information = np.einsum("uij,ij,vij->uv", slopes, w, slopes)
    rim = usable & (r >= disk[2] - FIT_BLUR_WIDTHS * S)
    chi = np.minimum(residual**2 * w, LARGEST_TERM)[rim].sum()
    return information, np.einsum("uij,ij->u", slopes, w * residual), chi, np.count_nonzero(rim)


def noise(slope=SLOPE, rim=RIM):
    """An array, as the fit hands it over: for a tuple all would be compiled once more."""
    return np.array([VARIANCE, slope, rim])


def summed(image, model, disk, weight, *, isolated, every=1):
    out = np.zeros(SUMS)
    sum_disk(
        image,
        model,
        weight,
        np.array(disk),
        S,
        noise(),
        isolated,
        False,
        every,
        disk_table(),
        out,
    )
    normal, right = np.zeros((4, 4)), np.zeros(4)
    unpack_sums(out, normal, right)
    full = np.zeros((5, 5))
    full[:4, :4], full[4] = normal, out[CROSS : CROSS + 5]
    full[:4, 4] = full[4, :4]
    return full, np.append(right, out[GRADIENT + 4]), out[CHI_SQUARE], out[PIXEL_COUNT]


@pytest.fixture
def residual(rng):
    return rng.normal(0.0, 2.0, SHAPE).astype(np.float32)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", DISKS)
def test_sums_of_a_disk(name, masked, residual, rng):
    disk, model = DISKS[name], np.zeros(SHAPE, np.float32)
    weight = (rng.random(SHAPE) > 0.02).astype(np.uint8) if masked else np.ones(SHAPE, np.uint8)
    add_disk(model, np.array(disk), S, disk_table(), 1.0)
    image = model + residual
    holes = np.where(weight > 0, image, np.float32(np.nan))
    information, right, chi, count = written_out(residual, disk, weight)
    size = np.sqrt(np.diag(information)) + 1e-9  # what noise does to the right side
    sizes = np.outer(size, size)
    for isolated in (False, True):
        found = summed(holes, model, disk, weight if masked else for_kernel(None), isolated=isolated)
        # tables are interpolated between radii: 1 % of what a disk of half the blur says about the blur
        np.testing.assert_allclose(found[0] / sizes, information / sizes, atol=0.01)
        np.testing.assert_allclose(found[1] / size, right / size, atol=0.03)
        assert found[2] == pytest.approx(chi, rel=5e-3)
        assert found[3] == count


@pytest.mark.parametrize("masked", [False, True])
def test_a_disk_far_wider_than_its_rim_stays_finite(masked, residual):
    """Hundreds of blur widths inside the rim, where the edge's polynomials overflow."""
    disk, s, model = np.array([60.0, 45.0, 3000.0, 100.0]), 0.4, np.zeros(SHAPE, np.float32)
    add_disk(model, disk, s, disk_table(), 1.0)
    assert np.all(model == 100.0)
    weight = np.ones(SHAPE, np.uint8)
    weight[0, 0] = not masked
    out = np.zeros(SUMS)
    sum_disk(residual + model, model, weight, disk, s, noise(slope=0.0), False, False, 1, disk_table(), out)
    assert np.all(np.isfinite(out))
    assert out[9] == pytest.approx(np.count_nonzero(weight) / VARIANCE, rel=1e-5)
    assert out[GRADIENT + 3] == pytest.approx(residual[weight > 0].sum() / VARIANCE, rel=1e-4)
    assert out[PIXEL_COUNT] == 0


def test_one_row_in_two_stands_for_both(residual):
    disk, model = DISKS["wide"], np.zeros(SHAPE, np.float32)
    whole = summed(residual, model, disk, for_kernel(None), isolated=False)
    half = summed(residual, model, disk, for_kernel(None), isolated=False, every=2)
    assert half[3] == pytest.approx(0.5 * whole[3], rel=0.02)
    np.testing.assert_allclose(np.diag(half[0]), np.diag(whole[0]), rtol=0.02)


@pytest.mark.parametrize(
    ("one", "two"), [("usual", "wide"), ("at the border", "larger than the image"), ("small", "usual")]
)
def test_sums_of_a_pair(one, two, rng):
    one, two = DISKS[one], DISKS[two]
    weight = (rng.random(SHAPE) > 0.02).astype(np.uint8)
    model = np.zeros(SHAPE, np.float32)
    (first, r1), (second, r2) = derivatives(one), derivatives(two)
    both = (r1 <= one[2] + FIT_BLUR_WIDTHS * S) & (r2 <= two[2] + FIT_BLUR_WIDTHS * S) & (weight > 0)
    expected = np.einsum("uij,ij,vij->uv", first[:4], both / VARIANCE, second[:4])
    block = np.full((4, 4), np.nan)
    sum_pair(model, weight, np.array(one), np.array(two), S, noise(rim=0.0), disk_table(), block)
    sizes = [np.sqrt(np.diag(written_out(model, disk, weight)[0]))[:4] for disk in (one, two)]
    np.testing.assert_allclose(block / np.outer(*sizes), expected / np.outer(*sizes), atol=3e-3)


def test_a_disk_drawn_and_erased_leaves_nothing():
    model = np.zeros(SHAPE, np.float32)
    for sign in (1.0, -1.0):
        for disk in DISKS.values():
            add_disk(model, np.array(disk), S, disk_table(), sign)
    assert np.abs(model).max() < 1e-4
