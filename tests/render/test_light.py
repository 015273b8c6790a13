"""Light of contacts on the pixels: exact areas, optics that lose nothing, the film against a quadrature."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import integrate, special

from contactimg import InputError
from contactimg.optics.coverage import disk_rectangle_area
from contactimg.optics.film import Light, excess_table
from contactimg.optics.psf import Halo, airy_psf, gaussian_psf, no_blur, sampling_for
from contactimg.optics.spots import Spots, spots_image, surround_with_film

SHAPE = (50, 70)
UM = 1e-6
LED = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))


def make_spots(x, y, radius, brightness=1.0, rim=0.0):
    x, y, radius, brightness = (
        np.atleast_1d(np.asarray(v, float)) for v in np.broadcast_arrays(x, y, radius, brightness)
    )
    return Spots(x, y, radius, brightness, np.zeros((x.size, 1)), rim)


def clipped_area(x, y, radius, shape):
    """Area of a disk inside the frame by adaptive quadrature over the columns."""
    top, bottom, left, right = -0.5, shape[0] - 0.5, -0.5, shape[1] - 0.5

    def chord(u):
        half = np.sqrt(max(radius**2 - (u - x) ** 2, 0.0))
        return max(min(y + half, bottom) - max(y - half, top), 0.0)

    low, high = max(left, x - radius), min(right, x + radius)
    if high <= low:
        return 0.0
    corners = [c for side in (top, bottom) for c in _crossings(x, y, radius, side) if low < c < high]
    return integrate.quad(chord, low, high, points=corners or None, limit=200, epsabs=1e-9)[0]


def _crossings(x, y, radius, side):
    half = radius**2 - (side - y) ** 2
    return [] if half <= 0 else [x - np.sqrt(half), x + np.sqrt(half)]


def centroid(image):
    rows, columns = np.indices(image.shape)
    return (image * columns).sum() / image.sum(), (image * rows).sum() / image.sum()


@settings(deadline=None, max_examples=200)
@example(left=0.0, width=1.0, top=0.0, height=1e-4, radius=1.0)  # y - y^3/6: 1.7e-13 below the rectangle
@given(
    left=st.floats(-3, 3),
    width=st.floats(0, 3),
    top=st.floats(-3, 3),
    height=st.floats(0, 3),
    radius=st.floats(0.01, 3),
)
def test_disk_and_rectangle_add_up(left, width, top, height, radius):
    # cutting a rectangle in two changes nothing, and the plane holds the whole disk
    area = disk_rectangle_area(left, left + width, top, top + height, radius)
    cut = left + 0.3 * width
    parts = disk_rectangle_area(left, cut, top, top + height, radius) + disk_rectangle_area(
        cut, left + width, top, top + height, radius
    )
    assert parts == pytest.approx(area, abs=1e-13)  # a few roundings of areas up to 30
    assert -1e-14 <= area <= min(width * height, np.pi * radius**2) + 1e-13
    assert disk_rectangle_area(-9.0, 9.0, -9.0, 9.0, radius) == pytest.approx(np.pi * radius**2, rel=1e-14)


def test_disk_and_rectangle_closed_forms():
    # unit disk: quarter pi/4; square inscribed 2; segment beyond x = 1/2: pi/3 - sqrt(3)/4
    half = np.sqrt(0.5)
    assert disk_rectangle_area(0.0, 1.0, 0.0, 1.0, 1.0) == pytest.approx(np.pi / 4, rel=1e-15)
    assert disk_rectangle_area(-half, half, -half, half, 1.0) == pytest.approx(2, rel=1e-15)
    assert disk_rectangle_area(0.5, 2.0, -2.0, 2.0, 1.0) == pytest.approx(
        np.pi / 3 - np.sqrt(3) / 4, rel=1e-14
    )


@pytest.mark.parametrize("sampling", [1, 3, 4])
@pytest.mark.parametrize("radius", [0.05, 0.3, 0.9, 1.0, 2.7, 8.0, 19.3])
def test_unblurred_disk_has_its_area(radius, sampling, rng):
    for x, y in rng.uniform([22, 22], [46, 26], (5, 2)):
        image = spots_image(make_spots(x, y, radius), shape=SHAPE, psf=no_blur(sampling=sampling))
        # exact but for rounding: some 1e3 cells of 1e-16 each
        assert image.sum() == pytest.approx(np.pi * radius**2, abs=1e-10)
        assert image.min() >= 0
        assert image.max() <= 1 + 1e-12


@pytest.mark.parametrize(
    ("x", "y", "radius"),
    [
        (-1.2, 20, 4),
        (69.9, 3.3, 5),
        (30, 49.5, 0.4),
        (35, -0.5, 3),
        (0, 0, 10),
        (69.5, 49.5, 2),
        (35, 25, 30),
    ],
)
def test_disk_cut_by_the_border_has_the_area_left(x, y, radius):
    image = spots_image(make_spots(x, y, radius), shape=SHAPE, psf=no_blur(sampling=2))
    assert image.sum() == pytest.approx(clipped_area(x, y, radius, SHAPE), abs=1e-7)  # of the quadrature
    assert image.sum() < np.pi * radius**2 - 0.1


def test_disk_larger_than_the_frame_fills_it():
    image = spots_image(make_spots(30, 20, 500), shape=SHAPE, psf=gaussian_psf(1.4, sampling=2))
    np.testing.assert_allclose(image, 1, atol=1e-6)  # what the kernel leaves out beyond 5 sigma


def test_blocks_join_without_a_seam():
    # a disk over many blocks against the same disk rendered in one pass of exact areas and a long filter
    spots, shape = make_spots(149.3, 101.6, 88.4), (200, 300)
    image = spots_image(spots, shape=shape, psf=gaussian_psf(1.4, sampling=2))
    rows, columns = np.indices(shape)
    distance = np.hypot(columns - 149.3, rows - 101.6)
    np.testing.assert_allclose(image[distance < 80], 1, atol=1e-6)
    np.testing.assert_allclose(image[distance > 97], 0, atol=1e-6)
    assert image.sum() == pytest.approx(np.pi * 88.4**2, rel=2e-6)


def test_empty_and_far_away():
    for spots in (make_spots([], [], []), make_spots([-40.0, 200.0], [20.0, 500.0], [5.0, 30.0])):
        assert not spots_image(spots, shape=SHAPE, psf=gaussian_psf(1.4, sampling=2)).any()


def test_radius_profile_of_a_blurred_disk():
    # the centre of a disk of radius a through a Gaussian: 1 - exp(-a^2/(2 s^2)); averaging over the pixel
    # adds (1/24) laplacian: laplacian at 0 = -(a^2/s^4) exp(-a^2/(2 s^2))  (from G * disk, L(0) = 2 pi a
    # dG/dr(a)).
    a, s = 2.0, 1.4
    image = spots_image(make_spots(30, 20, a), shape=SHAPE, psf=gaussian_psf(s, sampling=8))
    tail = np.exp(-(a**2) / (2 * s**2))
    # next term of the pixel average: (1/1920 + 1/576)/... of fourth derivatives, below 1e-3/s^4
    assert image[20, 30] == pytest.approx(1 - tail - (a**2 / s**4) * tail / 24, abs=3e-4)


PSFS = {
    "gaussian": (gaussian_psf(1.4, sampling=4), None),
    "halo": (gaussian_psf(1.4, sampling=4), Halo(0.2, 7.0)),
    "airy": (airy_psf(1.4, sampling=4), None),
    "fine": (gaussian_psf(0.3, sampling=4), None),
}


@pytest.mark.parametrize("kind", PSFS)
def test_blur_loses_no_light(kind):
    psf, halo = PSFS[kind]
    image = spots_image(make_spots(60.2, 58.7, 4.3), shape=(120, 130), psf=psf, halo=halo)
    assert image.sum() == pytest.approx(np.pi * 4.3**2, abs=1e-3)


@pytest.mark.parametrize("kind", ["gaussian", "halo", "airy"])
def test_shift_moves_the_centroid(kind):
    # a blur of 0.3 px is left out: 17 % of a cycle a pixel passes it, and aliases into any pixel's centroid
    psf, halo = PSFS[kind]
    centres = []
    for dx, dy in [(0, 0), (0.37, -0.21)]:
        spots = make_spots(60.2 + dx, 58.7 + dy, 3.3)
        centres.append(centroid(spots_image(spots, shape=(120, 130), psf=psf, halo=halo)))
    # the required 1e-3 px; the Gaussian keeps its centre to what it leaves out beyond 5 sigma
    np.testing.assert_allclose(np.subtract(centres[1], centres[0]), [0.37, -0.21], atol=1e-3)
    np.testing.assert_allclose(centres[0], [60.2, 58.7], atol=1e-3)


def test_gaussian_adds_its_variance():
    # second moment of a disk a^2/4 along an axis, of a pixel 1/12, of the optics s^2
    image = spots_image(make_spots(60.2, 58.7, 3.3), shape=(120, 130), psf=gaussian_psf(1.4, sampling=4))
    columns = np.arange(130)
    variance = (image * (columns - 60.2) ** 2).sum() / image.sum()
    # aliasing of the exact cells, 4 a pixel: 2 C'(4) sinc'(1)/4 2/(4 pi^2 pi a^2) = 1.1e-3, with the spectrum
    # of the disk |C| = sqrt(a) f^-1.5/pi, |C'| = 2 pi a |C|; 5e-3 would be missing if a cell were a point
    assert variance == pytest.approx(3.3**2 / 4 + 1 / 12 + 1.4**2, abs=1.1e-3)


def test_halo_adds_its_share_of_the_variance():
    image = spots_image(
        make_spots(60.2, 58.7, 3.3), shape=(120, 130), psf=gaussian_psf(1.4, sampling=4), halo=Halo(0.2, 7.0)
    )
    variance = (image * (np.arange(130) - 60.2) ** 2).sum() / image.sum()
    # as above, and the filter cut at 5 sigma: 1.5e-5 of 0.2 x 49
    assert variance == pytest.approx(3.3**2 / 4 + 1 / 12 + 1.4**2 + 0.2 * 49, abs=1.3e-3)


def test_airy_pattern_is_that_of_a_round_pupil():
    # encircled energy 1 - J0^2 - J1^2, within the fifth dark ring; 4.5 % of it outside the first, against
    # exp(-r^2/2) = 2.5 % of a Gaussian
    psf = airy_psf(4.0, sampling=1)
    kernel = psf.rows.T @ psf.columns
    half = kernel.shape[0] // 2
    r = np.hypot(*np.indices(kernel.shape) - half) / 4.0
    assert kernel[half, half] == pytest.approx(
        1 / (2 * np.pi * 16) / (1 - special.j0(16.4706) ** 2), rel=2e-3
    )
    for radius in (1.0, 1.5, 2.71, 4.0, 7.0):
        x = np.sqrt(2) * radius
        expected = (1 - special.j0(x) ** 2 - special.j1(x) ** 2) / (1 - special.j0(16.4706) ** 2)
        # counted in cells: the edge of the circle is right to a few cells of density below the peak
        assert kernel[r <= radius].sum() == pytest.approx(expected, abs=0.01)


def test_touching_disks_add_and_overlapping_ones_do_not():
    psf = no_blur(sampling=4)
    apart = spots_image(make_spots([20, 26], [20, 20], 3), shape=SHAPE, psf=psf)
    assert apart.sum() == pytest.approx(2 * 9 * np.pi, abs=1e-9)
    assert apart.max() <= 1 + 1e-12
    over = spots_image(make_spots([20, 24], [20, 20], 3), shape=SHAPE, psf=psf)
    lens = 2 * 9 * np.arccos(4 / 6) - 2 * np.sqrt(36 - 16)
    # two edges cross in two cells of area 1/16; the sum of both coverages errs by less than half of each
    assert over.sum() == pytest.approx(18 * np.pi - lens, abs=2 * 0.5 / 16)
    assert over.max() <= 1 + 1e-12


def test_disk_inside_another_changes_nothing():
    psf = no_blur(sampling=2)
    one = spots_image(make_spots(20, 20, 6), shape=SHAPE, psf=psf)
    two = spots_image(make_spots([20, 21], [20, 20], [6, 2]), shape=SHAPE, psf=psf)
    np.testing.assert_allclose(two, one, atol=1e-14)


def test_neighbours_do_not_see_each_other(rng):
    # groups are rendered apart: the picture of many is the sum of the pictures of each
    x, y = rng.uniform(5, 45, (2, 12))
    radius = rng.uniform(0.5, 1.5, 12)
    psf = gaussian_psf(1.0, sampling=2)
    keep = [0]
    for k in range(1, 12):  # leave out those that overlap
        if (np.hypot(x[keep] - x[k], y[keep] - y[k]) > radius[keep] + radius[k] + 1).all():
            keep.append(k)
    assert len(keep) > 5
    together = spots_image(make_spots(x[keep], y[keep], radius[keep]), shape=SHAPE, psf=psf)
    alone = sum(spots_image(make_spots(x[k], y[k], radius[k]), shape=SHAPE, psf=psf) for k in keep)
    np.testing.assert_allclose(together, alone, atol=1e-12)


@pytest.mark.parametrize("rim", [0.4, 1.0, 3.0])
def test_soft_edge_adds_the_area_of_its_rim(rim):
    # brightness falls linearly over w: area pi (a^2 + a w + w^2/3)
    a = 4.0
    image = spots_image(make_spots(30.3, 24.8, a, rim=rim), shape=SHAPE, psf=no_blur(sampling=4))
    assert image.sum() == pytest.approx(np.pi * (a**2 + a * rim + rim**2 / 3), abs=1e-9)


def film_spots(spots, pixel_size):
    return surround_with_film(spots, sphere_radius=100 * UM, pixel_size=pixel_size, excess=excess_table(LED))


@pytest.mark.parametrize("pixel_size", [1 * UM, 6 * UM])
@pytest.mark.parametrize("radius", [0.3, 5, 10, 20, 45])
def test_film_light_against_radial_quadrature(radius, pixel_size):
    # total light = int 2 pi r e(r) dr, in px^2
    spots = film_spots(make_spots(140.3, 130.8, radius * UM / pixel_size), pixel_size)
    image = spots_image(spots, shape=(260, 280), psf=no_blur(sampling=4))
    r = np.linspace(0, 130, 400001) * UM
    light = excess_table(LED).around_contact(r, radius=radius * UM, sphere_radius=100 * UM)
    expected = 2 * np.pi * np.trapezoid(light * r, r) / pixel_size**2
    # the figure asked of sharp disks, 1e-3 px^2, and at 1 um a pixel what the tables of gap and excess leave:
    # 1e-4 of the contrast on some 2 % of the halo, where the light falls steepest
    halo = np.pi * float(spots.extent_px[0]) ** 2
    assert image.sum() == pytest.approx(expected, abs=max(1e-3, 2e-6 * halo))


def test_film_of_a_point_contact_is_newtons():
    # a -> 0: g = r^2/(2R), whatever the contact adds is of order a^2
    spots = film_spots(make_spots(50, 40, 0.04), 0.25 * UM)
    image = spots_image(spots, shape=(81, 101), psf=no_blur(sampling=4))
    r = np.hypot(*(np.indices((81, 101)) - np.array([40, 50])[:, None, None])) * 0.25 * UM
    expected = excess_table(LED)(r**2 / (200 * UM))
    near = r < 6 * UM
    # mean over a pixel against its centre: (0.25 um)^2/24 |laplacian|, at most (4 pi r/(lambda R))^2 = 1.8 /
    # um^2
    np.testing.assert_allclose(image[near], expected[near], atol=5e-3)


def test_where_halos_meet_the_thinner_film_counts():
    near, far = make_spots(30, 24, 5), make_spots(47, 24, 5)
    both = make_spots([30, 47], [24, 24], 5)
    first, second, together = (
        spots_image(film_spots(s, 1 * UM), shape=SHAPE, psf=no_blur(sampling=2)) for s in (near, far, both)
    )
    np.testing.assert_allclose(together[:, :38], first[:, :38], atol=1e-12)
    np.testing.assert_allclose(together[:, 39:], second[:, 39:], atol=1e-12)
    assert np.abs(first[:, 39:] - second[:, 39:]).max() > 0.5


@pytest.mark.parametrize(("sigma", "samples"), [(0.0, 2), (1.4, 2), (0.4, 3), (1 / 16, 16)])
def test_sampling_follows_the_blur(sigma, samples):
    assert sampling_for(sigma, at_least=2) == samples


def test_too_fine_a_blur_is_refused():
    with pytest.raises(InputError, match=r"blur_px must be 0 or at least 0\.0625"):
        sampling_for(0.06, at_least=4)
