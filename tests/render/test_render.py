"""Synthetic frames: what the scene asks for is what the picture shows, and nothing else."""

import numpy as np
import pandas as pd
import pytest

from contactimg import InputError, scene_from_dict
from contactimg.render import render_contacts, render_frame, render_reference, render_smooth_contact

ELASTIC = {"young_modulus_Pa": 3e6, "work_of_adhesion_J_m2": 0.05}
SHAPE = (60, 80)
PLAIN = {"shape": SHAPE, "blur_px": 0.0, "background_levels": 80.0, "contrast_levels": 100.0}
NO_CONTACT = pd.DataFrame({"x_px": [], "y_px": [], "radius_px": []})


def make_scene(effects=None, camera=None, **simulate):
    data = {"effects": effects or {}, "simulate": PLAIN | simulate}
    if camera is not None:
        data["camera"] = {"pixel_size_m": 6e-6} | camera
    return scene_from_dict(data)


def exact_scene(effects=None, **keys):
    """A scene whose pixels are not rounded, so that predictions can be compared to rounding of float32."""
    return make_scene({"quantisation": "off", "saturation": "off"} | (effects or {}), **keys)


def one_contact(x=30.0, y=20.0, radius=5.0):
    return pd.DataFrame({"x_px": [x], "y_px": [y], "radius_px": [radius]})


def shoot(contacts, scene, seed=1, **keys):
    return render_contacts(contacts, scene, rng=np.random.default_rng(seed), **keys)


def image_of(contacts, scene, seed=1, **keys):
    return shoot(contacts, scene, seed, **keys).frame.image.astype(float)


def centroid(light):
    rows, columns = np.indices(light.shape)
    return (light * columns).sum() / light.sum(), (light * rows).sum() / light.sum()


# --- levels -------------------------------------------------------------------------------------------------


def test_levels_of_background_and_contact():
    image = image_of(one_contact(), make_scene())
    assert image[20, 30] == 180  # 80 + 100
    assert image[50, 70] == 80
    assert image.shape == SHAPE


def test_light_of_a_contact_is_its_area_times_the_contrast():
    image = image_of(one_contact(30.3, 20.7, 4.2), exact_scene())
    # 1e-3 px^2 is asked for; float32 pixels round by up to 180 2^-24 = 1e-5 levels each
    assert (image - 80).sum() / 100 == pytest.approx(np.pi * 4.2**2, abs=1e-4)


def test_dark_contacts():
    image = image_of(one_contact(), make_scene(contrast_levels=-30.0))
    assert image[20, 30] == 50


def test_frame_carries_its_name_and_scale():
    frame = render_frame(one_contact(), make_scene(), rng=np.random.default_rng(1), name="frame_3.tif")
    assert (frame.name, frame.full_scale, frame.image.dtype) == ("frame_3.tif", 255.0, np.uint8)
    twelve = render_reference(make_scene(bit_depth=12), rng=np.random.default_rng(1))
    assert (twelve.name, twelve.full_scale, twelve.image.dtype) == ("reference", 4095.0, np.uint16)


def test_same_chance_same_picture():
    scene = make_scene(texture=0.02, dust_count=3, electrons_per_level=20, position_drift_px=0.3)
    first, again = shoot(one_contact(), scene), shoot(one_contact(), scene)
    other = shoot(one_contact(), scene, seed=2)
    assert (first.frame.image == again.frame.image).all()
    pd.testing.assert_frame_equal(first.contacts, again.contacts)
    assert (first.frame.image != other.frame.image).any()


# --- where contacts stand -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        # image centre (39.5, 29.5); the contact 12 px along +x and 7 px along +y of the sample from the
        # centre
        ({}, (51.5, 36.5)),
        ({"mirrored": True}, (51.5, 22.5)),  # +y up
        ({"rotation_deg": 90.0}, (32.5, 41.5)),  # +x turns to +y (down), +y to -x
        ({"rotation_deg": 90.0, "mirrored": True}, (46.5, 41.5)),  # first the flip, then the turn
        ({"centre_m": [0.005 + 12e-6 * 6, 0.005]}, (39.5, 36.5)),
    ],
    ids=["plain", "mirrored", "rotated", "both", "centre"],
)
def test_pose_places_the_contact(camera, expected):
    scene = exact_scene(camera={"centre_m": [0.005, 0.005]} | camera, blur_px=1.0)
    contacts = pd.DataFrame({"x_m": [0.005 + 12 * 6e-6], "y_m": [0.005 + 7 * 6e-6], "radius_m": [3.3 * 6e-6]})
    shot = shoot(contacts, scene)
    # the light's centroid: the requirement, 1e-3 px
    np.testing.assert_allclose(centroid(shot.frame.image.astype(float) - 80), expected, atol=1e-3)
    np.testing.assert_allclose(shot.contacts[["x_px", "y_px"]].to_numpy()[0], expected, atol=1e-9)
    assert shot.contacts["radius_px"][0] == pytest.approx(3.3, rel=1e-12)
    assert shot.contacts["x_m"][0] == contacts["x_m"][0]


def test_pixels_given_win_over_metres_row_by_row():
    contacts = pd.DataFrame(
        {
            "x_px": [20.0, np.nan],
            "y_px": [10.0, np.nan],
            "radius_px": [3.0, np.nan],
            "x_m": [0.0, 0.0],
            "y_m": [0.0, 0.0],
            "radius_m": [1e-3, 24e-6],
        }
    )
    truth = shoot(contacts, make_scene(camera={})).contacts
    np.testing.assert_allclose(
        truth[["x_px", "y_px", "radius_px"]], [[20, 10, 3], [39.5, 29.5, 4]], rtol=1e-12
    )


def test_drift_moves_contacts_by_the_shift_reported():
    scene = exact_scene(position_drift_px=0.3, blur_px=1.0)
    still = exact_scene(blur_px=1.0)
    before = centroid(image_of(one_contact(), still) - 80)
    shifts = []
    for seed in range(40):
        shot = shoot(one_contact(), scene, seed)
        moved = np.subtract(centroid(shot.frame.image.astype(float) - 80), before)
        shift = (shot.shift_x_px, shot.shift_y_px)
        np.testing.assert_allclose(moved, shift, atol=1e-3)
        assert shot.contacts["x_px"][0] == 30.0 + shift[0]
        assert shot.contacts["y_px"][0] == 20.0 + shift[1]
        shifts.append(shift)
    # standard deviation of 80 normal draws: 0.3 to a relative 1/sqrt(160) = 8 %, four of those
    assert np.std(shifts) == pytest.approx(0.3, rel=0.32)


def test_texture_and_dust_move_with_the_contacts():
    scene = exact_scene(texture=0.02, position_drift_px=1.5)
    shot = shoot(NO_CONTACT, scene, seed=4)
    reference = render_reference(scene, rng=np.random.default_rng(0)).image
    assert abs(shot.shift_x_px) > 0.2
    assert abs(shot.shift_y_px) > 0.2
    # 60 and 80 are sizes of the transform itself: the spectra differ by the phase of the shift alone
    before, after = np.fft.fft2(reference / 80 - 1), np.fft.fft2(shot.frame.image / 80 - 1)
    fy, fx = np.fft.fftfreq(60)[:, None], np.fft.fftfreq(80)
    inner = (np.abs(fy) < 0.5) & (np.abs(fx) < 0.5)
    expected = before * np.exp(-2j * np.pi * (fx * shot.shift_x_px + fy * shot.shift_y_px))
    # sums of 4800 pixels rounded to 2^-24
    np.testing.assert_allclose(after[inner], expected[inner], atol=4800 * 2**-24)

    dusty = exact_scene(dust_count=1, position_drift_px=1.5, seed=5, blur_px=1.0)
    grain = centroid(80 - render_reference(dusty, rng=np.random.default_rng(0)).image.astype(float))
    shot = shoot(NO_CONTACT, dusty, seed=4)
    moved = np.subtract(centroid(80 - shot.frame.image.astype(float)), grain)
    np.testing.assert_allclose(moved, (shot.shift_x_px, shot.shift_y_px), atol=1e-3)


# --- static things ------------------------------------------------------------------------------------------


def test_static_things_are_the_same_in_all_frames():
    scene = make_scene(texture=0.05, dust_count=10, vignetting=0.2, blur_px=1.4, seed=3)
    reference = render_reference(scene, rng=np.random.default_rng(0)).image
    for seed in (1, 2):
        assert (shoot(NO_CONTACT, scene, seed).frame.image == reference).all()
    other = make_scene(texture=0.05, dust_count=10, vignetting=0.2, blur_px=1.4, seed=4)
    assert (render_reference(other, rng=np.random.default_rng(0)).image != reference).any()


@pytest.mark.parametrize("blur", [0.0, 1.4])
def test_texture_has_its_strength_and_its_correlation(blur):
    scene = exact_scene(texture=0.02, blur_px=blur, shape=(480, 640))
    texture = render_reference(scene, rng=np.random.default_rng(0)).image / 80 - 1
    # the field's own sample variance is set; 480 and 640 are sizes of the transform, so nothing is cropped
    assert texture.std() == pytest.approx(0.02, rel=1e-5)
    assert abs(texture.mean()) < 1e-6
    neighbour = np.mean(texture[:, 1:] * texture[:, :-1]) / 0.02**2
    # white noise seen through a Gaussian: exp(-1/(4 s^2)); 3e5 / (4 pi s^2 = 25) independent values give 1 %
    assert neighbour == pytest.approx(np.exp(-1 / (4 * blur**2)) if blur else 0.0, abs=0.03)


def test_vignetting_is_quadratic_from_the_centre():
    image = render_reference(exact_scene(vignetting=0.2), rng=np.random.default_rng(0)).image / 80
    assert image[0, 0] == pytest.approx(0.8, abs=1e-6)
    assert image[-1, -1] == pytest.approx(0.8, abs=1e-6)
    # half way to the corner a quarter of the fall
    rows, columns = np.indices(SHAPE)
    square = ((rows - 29.5) ** 2 + (columns - 39.5) ** 2) / (29.5**2 + 39.5**2)
    np.testing.assert_allclose(image, 1 - 0.2 * square, atol=1e-6)


def test_vignetting_dims_contacts_too():
    image = image_of(one_contact(5.0, 5.0, 4.0), exact_scene(vignetting=0.5))
    assert image[5, 5] / render_reference(exact_scene(vignetting=0.5), rng=np.random.default_rng(0)).image[
        5, 5
    ] == pytest.approx(180 / 80, rel=1e-6)


def test_dust_only_darkens():
    clean = render_reference(exact_scene(), rng=np.random.default_rng(0)).image
    dusty = render_reference(exact_scene(dust_count=15), rng=np.random.default_rng(0)).image
    shadow = (1 - dusty / clean).sum() / 15
    assert dusty.max() <= 80
    # mean over the grains of opacity pi r^2, opacity uniform in 0.2-0.8, r log-uniform in 0.5-3 px:
    # 0.5 pi (9 - 0.25)/(2 ln 6) = 3.84; standard deviation of one about 4.2, of the mean of 15 about 1.1
    assert shadow == pytest.approx(3.84, abs=3.5)
    assert (dusty < 78).sum() >= 15


def test_light_drift_scales_the_frame_against_the_reference():
    scene = exact_scene(light_drift=0.02)
    reference = render_reference(scene, rng=np.random.default_rng(0)).image
    np.testing.assert_allclose(image_of(NO_CONTACT, scene), 1.02 * reference, rtol=1e-6)


# --- the contacts' looks ------------------------------------------------------------------------------------


def test_brightness_spread_between_contacts():
    x, y = np.meshgrid(np.arange(8, 192, 8.0), np.arange(8, 152, 8.0))
    contacts = pd.DataFrame({"x_px": x.ravel(), "y_px": y.ravel(), "radius_px": 2.0})
    image = image_of(contacts, exact_scene(brightness_spread=0.05, shape=(160, 200)))
    peaks = (image[y.ravel().astype(int), x.ravel().astype(int)] - 80) / 100
    # 414 contacts: relative error of a standard deviation 1/sqrt(828) = 3.5 %, and four times that
    assert peaks.std() == pytest.approx(0.05, rel=0.14)
    assert peaks.mean() == pytest.approx(1, abs=4 * 0.05 / np.sqrt(414))


def test_edge_roughness_keeps_the_area():
    contact = one_contact(40.0, 30.0, 15.0)
    rough = image_of(contact, exact_scene(edge_roughness_px=0.8)) - 80
    smooth = image_of(contact, exact_scene()) - 80
    assert rough.sum() / 100 == pytest.approx(np.pi * 15**2, abs=0.5)  # sectors cut across cells: 1e-3 of 707
    assert np.abs(rough - smooth).max() > 50
    # RMS of the edge from the area between the two outlines, E|d| = sqrt(2/pi) rms for a normal edge; one
    # edge has 14 amplitudes: relative error of its rms 1/sqrt(28) = 19 %, three of those
    between = np.abs(rough - smooth).sum() / 100 / (2 * np.pi * 15)
    assert between == pytest.approx(np.sqrt(2 / np.pi) * 0.8, rel=0.57)


def test_roughness_spares_small_contacts():
    image = image_of(one_contact(40.0, 30.0, 1.0), exact_scene(edge_roughness_px=5.0)) - 80
    assert np.isfinite(image).all()
    assert image.sum() / 100 == pytest.approx(np.pi, rel=0.02)


def test_soft_edge_adds_a_rim():
    image = image_of(one_contact(), exact_scene(edge_softness_px=2.0)) - 80
    assert image.sum() / 100 == pytest.approx(np.pi * (25 + 10 + 4 / 3), abs=1e-3)
    assert image[20, 36] == pytest.approx(50, abs=2)  # half way out of the rim


@pytest.mark.parametrize("psf", ["gaussian", "halo", "airy"])
def test_every_psf_keeps_the_light_and_softens_the_edge(psf):
    # far enough from the border for the halo: 5 x 4 px
    contact = one_contact(70.0, 60.0)
    sharp = image_of(contact, exact_scene(shape=(120, 140))) - 80
    image = image_of(contact, exact_scene(shape=(120, 140), blur_px=1.4, psf=psf, halo_sigma_px=4.0)) - 80
    assert image.sum() == pytest.approx(sharp.sum(), rel=1e-4)
    # 2 px inside the edge: light is lost to the blur, more of it to a halo (20 %) or rings than to a Gaussian
    # tail
    assert (sharp - image)[60, 73] > {"gaussian": 3, "halo": 15, "airy": 5}[psf]


def film_scene(pixel_size=1e-6, **keys):
    return scene_from_dict(
        {
            "indenter": {"radius_m": 0.1288},
            "asperities": {"radius_m": 1e-4},
            "camera": {"pixel_size_m": pixel_size},
            "effects": {"film": "on", "quantisation": "off"},
            "simulate": PLAIN | {"background_levels": 150.0} | keys,
        }
    )


def test_film_shows_a_dark_ring_and_a_wider_contact():
    # a contact of 10 um at 0.25 um a pixel, centred on the left border
    image = (image_of(one_contact(0.0, 30.0, 40.0), film_scene(0.25e-6)) - 150) / 100
    profile = image[30]
    assert profile[0] == pytest.approx(1, abs=1e-6)
    # stated for R = 100 um: half level 1.12 um outside the edge, then a ring of -0.90. A pixel averages
    # h^2/24 e'' = 0.0026 um^2 e'', |e''| < 10 / um^2, and a line through two pixels has as much
    place = np.flatnonzero(profile < 0.5)[0]
    half = place - 1 + (profile[place - 1] - 0.5) / (profile[place - 1] - profile[place])
    assert half * 0.25 == pytest.approx(11.12, abs=0.03)
    assert profile.min() == pytest.approx(-0.90, abs=0.03)


def test_film_takes_the_radius_of_curvature_from_the_scene():
    contact = one_contact(40.0, 30.0, 10.0)
    composite = 1 / (1 / 1e-4 + 1 / 0.1288)
    scene = image_of(contact, film_scene())
    np.testing.assert_array_equal(scene, image_of(contact, film_scene(), sphere_radius=composite))
    np.testing.assert_array_equal(scene, image_of(contact, film_scene(), sphere_radius=[composite]))
    assert np.abs(scene - image_of(contact, film_scene(), sphere_radius=2e-4)).max() > 10


def test_film_with_rough_edges_and_no_contacts_in_view():
    dark = image_of(one_contact(500.0, 30.0, 10.0), film_scene())
    np.testing.assert_array_equal(dark, 150.0)
    rough = image_of(one_contact(40.0, 30.0, 10.0), film_scene(edge_roughness_px=0.5))
    smooth = image_of(one_contact(40.0, 30.0, 10.0), film_scene())
    assert np.abs(rough - smooth).max() > 10


def test_an_ellipse_is_as_large_as_its_axes_whatever_its_radius():
    axes = {"shape": "ellipse", "semi_major_px": 8.0, "semi_minor_px": 6.0, "angle_rad": 0.3}
    shot = shoot(one_contact(40.0, 30.0, 5.0).assign(**axes), exact_scene())
    light = shot.frame.image.astype(float) - 80
    # an edge of 1024 sectors: 1e-3 of the area
    assert light.sum() / 100 == pytest.approx(np.pi * 48, rel=1e-3)
    assert shot.contacts["radius_px"][0] == pytest.approx(48**0.5)


@pytest.mark.parametrize("change", [{"angle_rad": np.nan}, {"semi_major_px": np.nan}, {"semi_minor_px": 0.0}])
def test_an_ellipse_without_its_axes_is_refused(change):
    axes = {"shape": "ellipse", "semi_major_px": 8.0, "semi_minor_px": 6.0, "angle_rad": 0.3} | change
    with pytest.raises(InputError, match="row 0 is an ellipse and needs half-axes above 0 and an angle"):
        shoot(one_contact().assign(**axes), make_scene())


@pytest.mark.parametrize(("blur_px", "supersampling"), [(0.0, 1), (1.4, 3), (1.4, 4), (3.0, 4)])
def test_the_middle_of_a_wide_contact_is_bright_also_where_it_is_that_of_a_pixel(blur_px, supersampling):
    keys = {"shape": (181, 201), "blur_px": blur_px, "supersampling": supersampling}
    sections = {"indenter": {"radius_m": 0.1288}, "elastic": ELASTIC, "camera": {"pixel_size_m": 24e-6}}
    sharp = {"film": "on", "quantisation": "off", "saturation": "off"}
    scene = scene_from_dict({**sections, "simulate": PLAIN | keys, "effects": sharp})
    shot = render_smooth_contact(0.0, scene, rng=np.random.default_rng(1))
    image, (x, y, radius) = shot.frame.image, shot.contacts[["x_px", "y_px", "radius_px"]].to_numpy()[0]
    assert (x, y) == (100.0, 90.0)
    rows, columns = np.indices(image.shape)
    inside = np.hypot(columns - x, rows - y) < radius - 5 * blur_px - 1
    np.testing.assert_allclose(image[inside], 180.0, rtol=1e-5)
    np.testing.assert_allclose(image, image[::-1, ::-1], rtol=1e-5)


# --- the sensor ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "effects"),
    [
        ({"electrons_per_level": 20.0}, {}),
        ({"electrons_per_level": 20.0, "read_noise_electrons": 30.0}, {}),
        ({"electrons_per_level": 20.0, "read_noise_electrons": 30.0}, {"shot_noise": "off"}),
        ({"electrons_per_level": 20.0, "read_noise_electrons": 30.0}, {"quantisation": "on"}),
    ],
    ids=["shot", "both", "read", "all"],
)
def test_noise_has_the_variance_of_its_electrons(keys, effects):
    # levels L: L/epl of the shots + (read/epl)^2 + 1/12 of the rounding; half the frame is contact
    scene = exact_scene(effects, shape=(200, 300), **keys)
    contact = one_contact(20000 + 149.5, 99.5, 20000.0)
    image = image_of(contact, scene)
    for level, pixels in ((80.0, image[:, :130]), (180.0, image[:, 170:])):
        expected = (keys.get("read_noise_electrons", 0.0) / 20) ** 2
        expected += level / 20 if effects.get("shot_noise") != "off" else 0.0
        expected += 1 / 12 if effects.get("quantisation") == "on" else 0.0
        count = pixels.size  # 26000: a variance is known to sqrt(2/n) = 0.9 %, a mean to sqrt(variance/n)
        assert pixels.var() == pytest.approx(expected, rel=4 * np.sqrt(2 / count))
        assert pixels.mean() == pytest.approx(level, abs=4 * np.sqrt(expected / count))


def test_noise_differs_from_frame_to_frame_and_from_the_reference():
    scene = make_scene(electrons_per_level=20.0, read_noise_electrons=10.0)
    rng = np.random.default_rng(1)
    frames = [render_frame(NO_CONTACT, scene, rng=rng).image for _ in range(2)]
    frames.append(render_reference(scene, rng=rng).image)
    for k in range(3):
        assert (frames[k] != frames[k - 1]).mean() > 0.5


def test_saturation_and_what_lies_beyond_it():
    bright = {"background_levels": 200.0, "contrast_levels": 100.0}
    assert image_of(one_contact(), make_scene(**bright)).max() == 255
    assert image_of(one_contact(), make_scene({"saturation": "off"}, **bright)).max() == 300
    assert image_of(one_contact(), make_scene(**bright | {"bit_depth": 10})).max() == 300
    assert image_of(one_contact(), make_scene({"quantisation": "off"}, **bright)).max() == 255


def test_quantisation_rounds():
    exact = image_of(one_contact(30.3, 20.7, 4.2), exact_scene())
    np.testing.assert_array_equal(image_of(one_contact(30.3, 20.7, 4.2), make_scene()), np.rint(exact))


# --- switches -----------------------------------------------------------------------------------------------

EFFECTS = {
    "blur": ("blur_px", 1.4),
    "vignetting": ("vignetting", 0.3),
    "light_drift": ("light_drift", 0.05),
    "position_drift": ("position_drift_px", 0.5),
    "shot_noise": ("electrons_per_level", 20.0),
    "dust": ("dust_count", 5),
    "edge_roughness": ("edge_roughness_px", 0.5),
}
LIVELY = {
    "texture": 0.02,
    "electrons_per_level": 30.0,
    "read_noise_electrons": 8.0,
    "brightness_spread": 0.05,
    "seed": 2,
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_off_is_as_if_the_parameter_were_zero(effect):
    key, value = EFFECTS[effect]
    lively = LIVELY if effect != "shot_noise" else {"texture": 0.02, "brightness_spread": 0.05}
    auto = shoot(one_contact(), make_scene(**lively | {key: value})).frame.image
    on = shoot(one_contact(), make_scene({effect: "on"}, **lively | {key: value})).frame.image
    off = shoot(one_contact(), make_scene({effect: "off"}, **lively | {key: value})).frame.image
    zero = shoot(one_contact(), make_scene(**lively | {key: type(value)(0)})).frame.image
    np.testing.assert_array_equal(on, auto)
    np.testing.assert_array_equal(off, zero)
    assert (off != auto).any()


def test_read_noise_off_is_as_if_it_were_zero():
    on, off = (
        shoot(one_contact(), make_scene({"read_noise": switch}, **LIVELY)).frame.image
        for switch in ("on", "off")
    )
    zero = shoot(one_contact(), make_scene(**LIVELY | {"read_noise_electrons": 0.0})).frame.image
    np.testing.assert_array_equal(off, zero)
    assert (on != off).any()


def test_film_needs_to_be_switched_on():
    contact, scene = one_contact(40.0, 30.0, 10.0), film_scene()
    images = {}
    for switch in ("auto", "off", "on"):
        effects = scene.effects.model_copy(update={"film": switch})
        images[switch] = image_of(contact, scene.model_copy(update={"effects": effects}))
    np.testing.assert_array_equal(images["auto"], images["off"])
    assert np.abs(images["on"] - images["off"]).max() > 50


# --- edges of the range -------------------------------------------------------------------------------------


@pytest.mark.parametrize("supersampling", [1, 4])
def test_degenerate_contacts(supersampling):
    scene = make_scene(supersampling=supersampling, blur_px=1.4)
    empty = image_of(NO_CONTACT, scene)
    np.testing.assert_array_equal(empty, 80)
    np.testing.assert_array_equal(image_of(one_contact(radius=0.0), scene), empty)
    np.testing.assert_array_equal(image_of(one_contact(-60.0, 20.0), scene), empty)
    np.testing.assert_array_equal(image_of(one_contact(radius=1e4), scene), 180)
    assert image_of(one_contact(radius=0.2), scene).max() > 80
    assert image_of(one_contact(-2.0, 20.0), scene)[20, 0] > 80


def test_truth_has_a_row_for_every_contact():
    contacts = pd.DataFrame(
        {"x_px": [5.0, 500.0], "y_px": [5.0, 5.0], "radius_px": [0.0, 3.0], "label": [7, 8]}
    )
    truth = shoot(contacts, make_scene()).contacts
    assert truth["label"].to_list() == [7, 8]
    assert list(shoot(NO_CONTACT, make_scene()).contacts.columns) == list(truth.columns)


def test_what_was_handed_in_is_left_alone():
    contacts = one_contact()
    shoot(contacts, make_scene(position_drift_px=1.0))
    pd.testing.assert_frame_equal(contacts, one_contact())


@pytest.mark.parametrize(
    ("scene", "contacts", "message"),
    [
        (scene_from_dict({}), one_contact(), r"needs a section \[simulate\]"),
        (make_scene(), one_contact(radius=-1.0), "row 0 needs a finite centre and a radius"),
        (make_scene(), pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "radius_m": [1e-5]}), r"\[camera\]"),
        (make_scene(camera={}), pd.DataFrame({"x_m": [0.0], "y_m": [0.0]}), "radius_px = nan"),
        (make_scene({"shot_noise": "on"}), one_contact(), "shot_noise needs electrons_per_level above 0"),
        (make_scene(read_noise_electrons=5.0), one_contact(), "read_noise needs electrons_per_level above 0"),
        (make_scene(blur_px=3.0, psf="halo", halo_sigma_px=2.0), one_contact(), "halo_sigma_px must exceed"),
        (make_scene(blur_px=0.01), one_contact(), "blur_px must be 0 or at least"),
        (make_scene(contrast_levels=-90.0), one_contact(), "darker than black"),
        (film_scene(edge_softness_px=1.0), one_contact(), "edge_softness_px must be 0 with the film on"),
        (make_scene({"film": "on"}, camera={}), one_contact(), "radius of curvature"),
    ],
)
def test_what_makes_no_sense_is_refused(scene, contacts, message):
    with pytest.raises(InputError, match=message):
        render_frame(contacts, scene, rng=np.random.default_rng(1))


@pytest.mark.parametrize("radii", [[1e-4, 1e-4], 0.0, np.nan])
def test_radii_of_curvature_that_do_not_fit_are_refused(radii):
    with pytest.raises(InputError, match="sphere_radius must be"):
        render_frame(one_contact(), film_scene(), rng=np.random.default_rng(1), sphere_radius=radii)


def test_film_without_a_pixel_size_is_refused():
    with pytest.raises(InputError, match=r"air film needs a section \[camera\]"):
        render_frame(
            one_contact(), make_scene({"film": "on"}), rng=np.random.default_rng(1), sphere_radius=1e-4
        )
