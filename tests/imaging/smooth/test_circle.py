"""The circle of a wide contact, the film around it, and the frames that are made of both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from contactimg.errors import FrameError, InputError
from contactimg.imaging.smooth.find_circle import find_circle, sample_edge
from contactimg.imaging.smooth.fit_circle import EdgeModel, choose_opening, fit_circle
from contactimg.mechanics import hertz, jkr
from contactimg.optics.film import Light, excess_table
from contactimg.optics.wide_edge import edge_light, film_opening
from contactimg.render import render_smooth_contact
from contactimg.scene import scene_from_dict

LED = Light(1.52, 1.41, 560e-9, 70e-9, (450e-9, 680e-9))
LENS = 0.1288
NOISE = 1.0
PIXEL = 12e-6
MODEL = EdgeModel(PIXEL, LENS, excess_table(LED))


def test_jkr_gap_has_hertz_and_a_flat_punch_in_it():
    """The displacement under a flat punch of load F: (F/(pi E* a)) asin(a/r), by Sneddon."""
    a, E, w = 1.5e-3, 4e6, 0.05
    r = a * np.array([1.001, 1.1, 2.0, 10.0])
    law = {"sphere_radius": LENS, "contact_modulus": E}
    pull = hertz.load(a, **law) - jkr.load(a, work_of_adhesion=w, **law)
    raised = pull / (np.pi * E * a) * (np.pi / 2 - np.arcsin(a / r))
    expected = hertz.gap(r, radius=a, sphere_radius=LENS) + raised
    # asin near 1 loses half the digits of r - a
    assert jkr.gap(r, radius=a, work_of_adhesion=w, **law) == pytest.approx(expected, rel=1e-9)
    assert jkr.gap(a, radius=a, work_of_adhesion=w, **law) == 0


@pytest.mark.parametrize("w", [0.0, 0.002, 0.05])
def test_film_along_the_line_is_that_of_the_gap(w):
    a, E = 1.5e-3, 4e6
    excess = excess_table(LED)
    light = edge_light(
        a,
        sphere_radius=LENS,
        opening=film_opening(contact_modulus=E, work_of_adhesion=w),
        excess=excess,
    )
    x = np.linspace(0, light.reach, 200_001)
    gap = jkr.gap(a + x, radius=a, sphere_radius=LENS, contact_modulus=E, work_of_adhesion=w)
    fine = np.cumsum((excess(gap)[1:] + excess(gap)[:-1]) / 2) * (x[1] - x[0])
    cells = light.film_means(0.0, light.reach / 10, 10)
    expected = np.diff(np.append(0.0, fine[19_999::20_000])) / (light.reach / 10)
    # 300 midpoints over some 12 fringes: (2 pi/25)^2/24 of the excess
    assert cells == pytest.approx(expected, abs=3e-3)


def test_hertz_edge_has_no_adhesion():
    light = edge_light(1.5e-3, sphere_radius=LENS, opening=0.0, excess=MODEL.excess)
    middle = (light.edges[1:] + light.edges[:-1]) / 2
    gap = hertz.gap(1.5e-3 + middle, radius=1.5e-3, sphere_radius=LENS)
    assert light.excess == pytest.approx(MODEL.excess(gap), abs=2e-3)  # nodes lie midway in the square root
    with pytest.raises(InputError, match="not negative"):
        edge_light(1.5e-3, sphere_radius=LENS, opening=-1.0, excess=MODEL.excess)


def frame(scene_changes, *, load=0.05, w=0.05, film="on", shape=(330, 350)):
    """Difference image of one smooth contact without camera noise, and its truth."""
    scene = scene_from_dict(
        {
            "indenter": {"radius_m": LENS, "apex_m": [3e-5, -4.1e-5]},
            "elastic": {"young_modulus_Pa": 3e6, "work_of_adhesion_J_m2": w},
            "camera": {"pixel_size_m": PIXEL, "centre_m": [0.0, 0.0]},
            "effects": {"film": film, "quantisation": "off", "saturation": "off"},
            "simulate": {"shape": shape, "contrast_levels": 60.0} | scene_changes,
        }
    )
    shot = render_smooth_contact(load, scene, rng=np.random.default_rng(3))
    return shot.frame.image.astype(np.float32) - np.float32(80.0), shot.contacts.iloc[0]


@pytest.mark.parametrize("w", [0.0, 0.002, 0.05])
def test_the_film_of_a_rendered_contact_is_that_of_the_gap(w):
    image, truth = frame({"blur_px": 0.0}, w=w)
    part = (np.arange(40) + 0.5) / 40 - 0.5  # of a pixel
    a = truth["radius_m"]
    for row in (150, 170, 200):
        y = row + part[:, np.newaxis, np.newaxis] - truth["y_px"]
        x = np.arange(image.shape[1])[:, np.newaxis] + part - truth["x_px"]
        r = PIXEL * np.hypot(x, y)
        law = {"sphere_radius": LENS, "contact_modulus": 4e6, "work_of_adhesion": w}
        gap = jkr.gap(np.maximum(r, a), radius=a, **law)
        expected = np.where(r < a, 1.0, MODEL.excess(gap)).mean(axis=(0, 2))
        # eight points a pixel and axis beside an edge that falls within one of them
        assert image[row] / 60 == pytest.approx(expected, abs=0.1)
        assert image[row].mean() / 60 == pytest.approx(expected.mean(), abs=1e-3)


def edge_of(image):
    """Samples along the edge of a contact, whose circle is found in two passes."""
    rough = find_circle(image, 60.0)
    outside = MODEL.film_px(rough.radius_px) + 12
    for _ in range(2):
        samples = sample_edge(image, rough, outside_px=outside, noise=NOISE)
        rough = fit_circle(samples, MODEL, opening=np.inf)
    return sample_edge(image, rough, outside_px=outside, noise=NOISE)


def measured(image, opening=None):
    samples = edge_of(image)
    opening = choose_opening([samples], MODEL).value if opening is None else opening
    return fit_circle(samples, MODEL, opening=opening), opening


def errors(circle, truth):
    return [getattr(circle, name) - truth[name] for name in ("x_px", "y_px", "radius_px")]


@pytest.mark.parametrize(
    "case",
    [{"film": "off"}, {"scene_changes": {"psf": "airy"}}],
    ids=["sharp", "Airy"],
)
def test_circle_whatever_the_optics(case, rng):
    image, truth = frame(**({"scene_changes": {}} | case))
    image += (NOISE * rng.standard_normal(image.shape)).astype(np.float32)
    circle, _ = measured(image)
    assert_right(circle, truth)


def assert_right(circle, truth):
    # 1 level of 60 over 800 px of edge gives 0.002 px; the rest is what the estimator's model lacks
    assert np.abs(errors(circle, truth)).max() < 0.04
    assert 0.0005 < circle.radius_std_px < 0.01


def test_without_the_film_in_the_model_the_radius_is_wrong(rng):
    """Hertz's film behind a halo: half the contrast lies 25 um, two pixels, outside the edge."""
    image, truth = frame({"psf": "halo"}, w=0.0)
    image += (NOISE * rng.standard_normal(image.shape)).astype(np.float32)
    samples = edge_of(image)
    opening = choose_opening([samples], MODEL).value
    circle, blind = (fit_circle(samples, MODEL, opening=one) for one in (opening, np.inf))
    assert opening == 0.0
    assert_right(circle, truth)
    assert abs(circle.radius_px - truth["radius_px"]) < 0.02
    assert blind.radius_px - truth["radius_px"] > 1.5


def test_film_tells_the_adhesion(rng):
    image, truth = frame({}, w=0.002)
    image += (NOISE * rng.standard_normal(image.shape)).astype(np.float32)
    circle, opening = measured(image)
    # fringes place the gap to some per cent; the opening goes as the root of w
    assert opening == pytest.approx(film_opening(contact_modulus=4e6, work_of_adhesion=0.002), rel=0.05)
    assert_right(circle, truth)


def test_dust_and_a_scratch_do_not_matter(rng):
    image, truth = frame({})
    image += (NOISE * rng.standard_normal(image.shape)).astype(np.float32)
    for angle in rng.uniform(0, 2 * np.pi, 12):  # grains on the very edge
        x = truth["x_px"] + truth["radius_px"] * np.cos(angle)
        y = truth["y_px"] + truth["radius_px"] * np.sin(angle)
        image[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3] -= 40
    image[:, 150:153] += 50
    dirty, _ = measured(image, opening=np.inf)
    assert np.abs(errors(dirty, truth)).max() < 0.05
    assert dirty.arc < 1


def test_half_a_contact_is_enough(rng):
    image, truth = frame({}, film="off")
    image += (NOISE * rng.standard_normal(image.shape)).astype(np.float32)
    cut = image[:, : int(truth["x_px"])]
    circle, _ = measured(np.ascontiguousarray(cut), opening=np.inf)
    assert 0.4 < circle.arc < 0.55
    # half the edge: centre and radius are correlated, four times the uncertainty of a whole circle
    assert np.abs(errors(circle, truth)).max() < 5 * max(circle.radius_std_px, circle.centre_std_px)


def test_the_outline_of_a_hole_is_none_of_the_contact():
    image, truth = frame({}, film="off")
    valid = np.ones(image.shape, np.bool_)
    valid[:, : int(truth["x_px"] - 0.2 * truth["radius_px"])] = False
    image[~valid] = 0.0
    found = find_circle(image, 60.0, valid=valid)
    # a rough circle is good to about a pixel
    assert np.hypot(found.x_px - truth["x_px"], found.y_px - truth["y_px"]) < 1.5
    assert found.radius_px == pytest.approx(truth["radius_px"], abs=1.5)
    # points of the circle at cos t > -0.2: 1 - acos(0.2)/pi
    assert found.arc == pytest.approx(0.56, abs=0.03)


@pytest.mark.parametrize("hidden", [0.3, 0.9])
def test_sectors_that_show_no_edge_are_left_out(hidden):
    image, truth = frame({}, film="off")
    rough = find_circle(image, 60.0)
    samples = sample_edge(image, rough, outside_px=20.0, noise=NOISE)
    away = samples.sector < hidden * (samples.sector.max() + 1)
    samples = replace(
        samples, distance=samples.distance + 500.0 * away, value=np.where(away, 0.0, samples.value)
    )
    if hidden > 0.5:
        with pytest.raises(FrameError, match="the contact's edge"):
            fit_circle(samples, MODEL, opening=np.inf)
    else:
        assert np.abs(errors(fit_circle(samples, MODEL, opening=np.inf), truth)).max() < 0.05


def test_an_edge_without_any_sample_is_refused():
    image, _ = frame({}, film="off")
    samples = sample_edge(image, find_circle(image, 60.0), outside_px=20.0, noise=NOISE)
    names = ("azimuth", "distance", "value", "weight", "sector")
    none = replace(samples, **{name: getattr(samples, name)[:0] for name in names})
    with pytest.raises(FrameError, match="of the contact's edge"):
        fit_circle(none, MODEL, opening=np.inf)


@pytest.mark.parametrize(
    ("draw", "sentence"),
    [
        (lambda x, y: 0 * x * y, "nothing stands out"),
        (
            lambda x, y: 60.0 * (np.hypot(x - 60, y - 50) < 5),
            "edge is not in the field|no wide smooth contact",
        ),
        (
            lambda x, y: 60.0 * ((np.abs(x - 60) < 55) & (np.abs(y - 50) < 15)),
            "no circle|no wide smooth contact",
        ),
        (lambda x, y: 60.0 * (np.hypot(x + 52, y - 50) < 60), "of the contact's edge"),
    ],
    ids=["empty", "dot", "bar", "arc"],
)
def test_frames_without_a_circle_are_refused(draw, sentence):
    y, x = np.mgrid[0:100, 0:120]
    with pytest.raises(FrameError, match=sentence):
        find_circle(draw(x, y).astype(np.float32), 60.0)


@pytest.mark.parametrize("axes", [(1.0066, 0.0), (1.02, 0.7), (1.0, 0.0)])
def test_an_ellipse_is_measured_with_its_mean_radius(axes):
    """Axes b q and b/q, b = 60 px: the outline exceeds the circle by 0.4 and 1.2 px, at most half a blur."""
    stretched, angle = axes
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:180, :200]
    dx, dy = columns - 101.3, rows - 88.6
    u, v = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
    scaled = np.hypot(u / stretched, v * stretched)
    gradient = np.hypot(u / stretched**2, v * stretched**2) / np.maximum(scaled, 1e-9)
    outside = (scaled - 60.0) / gradient
    image = 60 * ndtr(-outside / 1.8) + NOISE * rng.standard_normal(rows.shape)
    rough = find_circle(image.astype(np.float32), 60.0)
    samples = sample_edge(image.astype(np.float32), rough, outside_px=12.0, noise=NOISE)
    found = fit_circle(samples, MODEL, opening=np.inf)
    # half height of a blurred round edge lies blur^2/(2 a) inside it; 380 px of edge at contrast/noise 60:
    # 3e-3 px
    assert found.radius_px == pytest.approx(60.0 + 1.8**2 / 120, abs=0.015)
    expected = 30 * (stretched - 1 / stretched) * np.array([np.cos(2 * angle), np.sin(2 * angle)])
    assert found.ellipse_px == pytest.approx(tuple(expected), abs=0.03)
    assert found.ellipse_std_px < 0.02
