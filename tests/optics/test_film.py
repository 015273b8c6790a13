"""The air film: closed forms at one wavelength, the thick film, the excess, and the edge that it shifts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, least_squares
from scipy.special import i0e

from contactimg import InputError
from contactimg.mechanics import hertz
from contactimg.optics.film import Light, excess_table, thick_transmission, transmission

UM = 1e-6
R = 100 * UM
LED = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))


def test_contact_transmits_as_one_interface():
    # no film left: one interface between n1 and n3, R = ((n1-n3)/(n1+n3))^2
    assert float(transmission(0.0, light=LED)) == pytest.approx(
        1 - ((1.52 - 1.41) / (1.52 + 1.41)) ** 2, rel=1e-14
    )


def test_quarter_wave_film_of_one_colour():
    # a line 1e-4 wide: c = -1 at g = lambda/4, Rf = ((r12 - r23)/(1 - r12 r23))^2; the width changes c by
    # (4 pi g dlambda/lambda^2)^2/2 = (pi 1e-4)^2/2 = 5e-8
    line = Light(1.52, 1.41, 560e-9, 1e-12, (560e-9 - 5.6e-11, 560e-9 + 5.6e-11))
    r12, r23 = 0.52 / 2.52, -0.41 / 2.41
    expected = 1 - ((r12 - r23) / (1 - r12 * r23)) ** 2
    assert float(transmission(140e-9, light=line)) == pytest.approx(expected, abs=1e-7)


def test_thick_film_is_the_average_over_the_phase():
    # mean over one period of a single colour; trapezium on a period converges faster than any power
    gaps = np.arange(4096) / 4096 * 280e-9
    line = Light(1.52, 1.41, 560e-9, 1e-12, (560e-9 - 1e-13, 560e-9 + 1e-13))
    assert transmission(gaps, light=line).mean() == pytest.approx(thick_transmission(LED), abs=1e-6)


@pytest.mark.parametrize("bandwidth_nm", [70, 10, 3, 1, 0.3])
def test_spectrum_average_against_adaptive_quadrature(bandwidth_nm):
    gap = 3.3 * UM
    r12, r23 = LED.reflections

    def weight(wavelength_nm):
        return np.exp(-(((wavelength_nm - 560) / bandwidth_nm) ** 2))

    def reflected(wavelength_nm):
        beat = 2 * r12 * r23 * np.cos(4 * np.pi * gap * 1e9 / wavelength_nm)
        return weight(wavelength_nm) * (r12**2 + r23**2 + beat) / (1 + (r12 * r23) ** 2 + beat)

    band = max(450, 560 - 8 * bandwidth_nm), min(680, 560 + 8 * bandwidth_nm)
    total = quad(weight, *band, epsabs=0)[0]
    expected = 1 - quad(reflected, *band, limit=200, epsabs=0, epsrel=1e-11)[0] / total
    lamp = replace(LED, bandwidth=bandwidth_nm * 1e-9)
    # in a table of gaps the nodes are those of the largest one
    for gaps in (np.array([gap]), np.array([gap, 3 * gap])):
        assert float(transmission(gaps, light=lamp)[0]) == pytest.approx(expected, abs=1e-11)


def test_contrast_and_first_dark_fringe():
    contact, thick = float(transmission(0.0, light=LED)), thick_transmission(LED)
    darkest = transmission(np.linspace(0, 0.3 * UM, 3001), light=LED).min()
    # half a unit of the last digit given: 6.8 % of the incident light, 7.3 % of the background, 13 %, -0.9
    assert contact - thick == pytest.approx(0.068, abs=5e-4)
    assert (contact - thick) / thick == pytest.approx(0.073, abs=5e-4)
    assert contact - darkest == pytest.approx(0.13, abs=5e-3)
    assert (darkest - thick) / (contact - thick) == pytest.approx(-0.90, abs=5e-3)


def test_table_interpolates_the_excess_to_its_accuracy():
    contact, thick = float(transmission(0.0, light=LED)), thick_transmission(LED)
    table = excess_table(LED)
    gaps = np.linspace(0, 0.999 * table.longest_gap, 7919)  # out of step with the table
    exact = (transmission(gaps, light=LED) - thick) / (contact - thick)
    assert np.abs(table(gaps) - exact).max() < 1e-4  # the accuracy it promises
    beyond = (transmission(np.linspace(1, 4, 5001) * table.longest_gap, light=LED) - thick) / (
        contact - thick
    )
    assert np.abs(beyond).max() <= 5e-3  # the tolerance at which it ends
    assert table(0.0) == 1
    assert table(2 * table.longest_gap) == 0


def test_excess_depends_on_lengths_only_through_their_ratios():
    # change of units: all lengths, of the mechanics and of the light, times l
    scale = 1e3
    big = Light(1.52, 1.41, 560e-9 * scale, 70e-9 * scale, (450e-9 * scale, 680e-9 * scale))
    r = np.linspace(0, 40 * UM, 200)
    small = excess_table(LED).around_contact(r, radius=10 * UM, sphere_radius=R)
    large = excess_table(big).around_contact(r * scale, radius=10 * UM * scale, sphere_radius=R * scale)
    np.testing.assert_allclose(large, small, atol=1e-9)  # rounding of phases of some 100 rad, interpolated


def test_one_profile_serves_every_contact():
    r = np.linspace(0, 60 * UM, 50)
    radii, spheres = np.array([[5 * UM], [20 * UM]]), np.array([[50 * UM], [100 * UM]])
    gaps = hertz.gap(r, radius=radii, sphere_radius=spheres)
    for row, (a, sphere) in enumerate(zip(radii.ravel(), spheres.ravel(), strict=True)):
        np.testing.assert_allclose(
            gaps[row], hertz.gap(r, radius=a, sphere_radius=sphere), rtol=1e-12, atol=1e-22
        )


def test_halo_has_ended_at_its_reach():
    table = excess_table(LED)
    radii = np.array([0.5, 5, 45]) * UM
    reach = table.reach(radius=radii, sphere_radius=R)
    assert (hertz.gap(reach, radius=radii, sphere_radius=R) >= table.longest_gap).all()
    # and not far beyond where it ends: g <= r^2/(2R) - (what is left of the cap) never exceeds r^2/(2R)
    assert (reach[0] - np.sqrt(2 * R * table.longest_gap)) / reach[0] < 1e-2


@pytest.mark.parametrize(
    ("radius", "stated"), [(5, 1.41), (10, 1.12), (20, 0.89), (30, 0.77), (45, 0.68)], ids="a={}".format
)
def test_half_level_radius_exceeds_the_contact(radius, stated):
    table = excess_table(LED)
    half = brentq(
        lambda r: float(table.around_contact(r * UM, radius=radius * UM, sphere_radius=R)) - 0.5,
        radius,
        radius + 2,
    )
    # one unit of the last digit: from the formula 1.407, 1.116, 0.884, 0.772, 0.674 um
    assert half - radius == pytest.approx(stated, abs=0.01)


@pytest.mark.parametrize("radius", [5, 10, 20, 30, 45])
def test_integrated_to_the_first_zero_a_little_less(radius):
    table = excess_table(LED)
    r = np.linspace(0, radius + 3, 30001)
    light = table.around_contact(r * UM, radius=radius * UM, sphere_radius=R)
    half = r[np.flatnonzero(light < 0.5)[0]] - radius
    zero = np.flatnonzero(light < 0)[0]
    integrated = np.sqrt(2 * np.trapezoid((light * r)[:zero], r[:zero])) - radius
    assert integrated / half == pytest.approx(0.955, abs=0.01)  # 3.9 to 4.6 % less


def blurred(light, r, h, at, sigma):
    """Radial image after a Gaussian blur: (1/s^2) int f(t) t exp(-(r^2+t^2)/2s^2) I0(r t/s^2) dt."""
    kernel = i0e(np.outer(at, r) / sigma**2) * np.exp(-((at[:, None] - r) ** 2) / (2 * sigma**2))
    return kernel @ (light * r) * h / sigma**2


@pytest.mark.parametrize(
    ("radius", "stated"), [(5, 10.6), (10, 4.8), (20, 1.9), (30, 1.1), (45, 0.7)], ids="a={}".format
)
def test_blurred_edge_shifts_a_disk_fit(radius, stated):
    # contrast and blur (8.4 um) known, radius free, least squares over the plane
    sigma, h = 8.4, 0.05
    r = (np.arange(int((radius + 60) / h)) + 0.5) * h
    at = np.arange(0, radius + 50, 1.0)
    film = excess_table(LED).around_contact(r * UM, radius=radius * UM, sphere_radius=R)
    seen = blurred(film, r, h, at, sigma)

    def misfit(a):
        disk = np.clip((a - r) / h + 0.5, 0, 1)
        return (blurred(disk, r, h, at, sigma) - seen) * np.sqrt(at)

    fit = least_squares(misfit, [radius]).x[0]
    # from the formula 10.54, 4.74, 1.94, 1.13, 0.66 %: one unit of the last digit
    assert 100 * (fit / radius - 1) == pytest.approx(stated, abs=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"index_elastic": 1.0}, "index of air"),
        ({"band": (680e-9, 450e-9)}, "two increasing positive wavelengths"),
        ({"band": (650e-9, 680e-9), "bandwidth": 10e-9}, "sends no light into the band"),
    ],
)
def test_impossible_light_is_refused(change, message):
    given = {
        "index_indenter": 1.52,
        "index_elastic": 1.41,
        "wavelength": 560e-9,
        "bandwidth": 70e-9,
        "band": (450e-9, 680e-9),
    }
    with pytest.raises(InputError, match=message):
        Light(**given | change)


def test_laser_is_refused():
    laser = Light(1.52, 1.41, 560e-9, 1e-12, (559.99e-9, 560.01e-9))
    with pytest.raises(InputError, match="too coherent"):
        excess_table(laser)
