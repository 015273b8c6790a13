"""Annuli in the image, averages over places, and the laws against the local pressure."""

import numpy as np
import pandas as pd
import pytest

from contactimg.analysis.annuli import (
    FieldOfView,
    annulus_edges,
    annulus_moments,
    density_beside,
    sum_moments,
)
from contactimg.analysis.area_power_law import (
    area_by_load,
    fit_area_law,
    frame_areas,
    group_loads,
    sampling_std,
)
from contactimg.analysis.contacts_against_pressure import fit_contact_law, pressure_points
from contactimg.analysis.radial_profiles import (
    average_profile,
    hertz_profile,
    normalise_profile,
    radial_profile,
    ring_profile,
)
from contactimg.errors import InputError
from contactimg.models.greenwood_tripp import solve_greenwood_tripp
from contactimg.models.height_distributions import UniformHeights
from contactimg.pose import Pose
from contactimg.tables import CONTACTS

ORIGIN = (0.0, 0.0)
POSE = Pose((100, 160), 1e-5, centre=(2e-4, -1e-4), rotation=0.4, mirrored=True)


def contacts(x, y, radius=1e-5, force=1e-3):
    n = len(x)
    return CONTACTS.conform(
        {
            "frame": ["f"] * n,
            "x_m": x,
            "y_m": y,
            "radius_m": np.broadcast_to(radius, n),
            "force_N": np.broadcast_to(force, n),
        }
    )


def test_discs_in_an_image():
    field = FieldOfView(POSE)
    assert field.disc_area(POSE.centre, 1e-4) == pytest.approx(np.pi * 1e-8, rel=1e-12)  # inside
    assert field.disc_area(POSE.centre, 1.0) == pytest.approx(100 * 160 * 1e-10, rel=1e-12)  # all of it
    edge = tuple(float(v) for v in POSE.to_sample(-0.5, 40.0))
    assert field.disc_area(edge, 1e-4) == pytest.approx(np.pi * 1e-8 / 2, rel=1e-9)
    assert field.disc_area(edge, 0.0) == 0.0
    # moved by ten pixels, 1e-4 m, the image shows all of it
    assert FieldOfView(POSE, (10.0, 0.0)).disc_area(edge, 1e-4) == pytest.approx(np.pi * 1e-8, rel=1e-9)


def test_disc_in_an_image_counts_its_pixels():
    centre, radius = (6e-4, 2e-4), 5e-4
    x_px, y_px = np.meshgrid(np.arange(160), np.arange(100))
    x, y = POSE.to_sample(x_px.ravel(), y_px.ravel())
    inside = np.hypot(x - centre[0], y - centre[1]) < radius
    # pixels on the circle, some 150 of them, are right to half a pixel each at random: 150^0.5/2 = 6 of 4000
    assert FieldOfView(POSE).disc_area(centre, radius) == pytest.approx(inside.sum() * 1e-10, abs=4 * 6e-10)
    assert FieldOfView(POSE).holds(x, y).all()
    assert not FieldOfView(POSE).holds(*POSE.to_sample(np.array([-0.6, 3.0]), np.array([3.0, 99.6]))).any()


def lattice(spacing=2e-5):
    steps = spacing * (np.arange(-60, 60) + 0.31)
    x, y = (part.ravel() for part in np.meshgrid(steps, steps))
    return contacts(x, y)


def test_annuli_count_as_far_as_they_are_seen():
    table, field = lattice(), FieldOfView(Pose((100, 160), 1e-5))
    edges = 1e-4 * np.arange(9)
    seen = radial_profile(table, centre=(1e-4, 5e-5), edges=edges, frame="f", model="measured", field=field)
    area = np.diff([field.disc_area((1e-4, 5e-5), r) for r in edges])
    # a lattice fluctuates on the boundary of the region only: less than the root of its number of points
    number = area / 4e-10
    np.testing.assert_allclose(seen["density_per_m2"] * 4e-10, 1.0, atol=(1 / np.sqrt(number)).max())
    inside = table[field.holds(table["x_m"], table["y_m"])]
    wrong = radial_profile(inside, centre=(1e-4, 5e-5), edges=edges, frame="f", model="measured")
    assert wrong["density_per_m2"].iloc[-1] * 4e-10 < 0.5  # without clipping the annulus seems half empty


def test_sectors_share_what_an_annulus_holds():
    field, centre = FieldOfView(POSE), (5e-4, 2e-4)
    edges = 1e-4 * np.arange(9)
    whole = annulus_moments(lattice(), centre=centre, edges=edges, field=field)
    parts = annulus_moments(lattice(), centre=centre, edges=edges, field=field, sectors=8)
    assert len(parts) == 8 * len(whole)
    pd.testing.assert_frame_equal(sum_moments([parts]), sum_moments([whole]))
    # a lattice has one contact an elementary cell in the visible part of every sector, up to its boundary
    expected = parts["area"] / 4e-10
    assert (parts["n"] - expected).abs().max() < 4 * np.sqrt(expected.max())
    assert (parts["area"] == 0).sum() > 0  # some sectors are out of sight
    moved = lattice()[lambda t: (t["x_m"] > centre[0]) & (t["y_m"] > centre[1])]  # the first quadrant
    there = annulus_moments(moved, centre=centre, edges=edges, sectors=8).groupby("sector")["n"].sum()
    assert (there[2:] == 0).all()
    assert (there[:2] > 0).all()


def test_an_annulus_out_of_sight_is_empty_not_zero():
    field = FieldOfView(Pose((100, 160), 1e-5))
    profile = radial_profile(
        lattice(), centre=ORIGIN, edges=[0.0, 1e-4, 9.5e-4, 1e-3], frame="f", model="measured", field=field
    )
    assert profile["density_per_m2"].notna().tolist() == [True, True, False]
    assert profile["pressure_Pa"].isna().tolist() == [False, False, True]


def test_a_contact_outside_the_image_does_not_count():
    field = FieldOfView(Pose((100, 160), 1e-5))
    moments = annulus_moments(
        contacts([0.0, 0.0], [0.0, 6e-4]), centre=ORIGIN, edges=[0.0, 1e-3], field=field
    )
    assert moments["n"].tolist() == [1.0]


def test_a_contact_on_an_edge_is_held():
    edges = annulus_edges(contacts([3e-4], [0.0]), centre=ORIGIN, width=1e-4)
    assert annulus_moments(contacts([3e-4], [0.0]), centre=ORIGIN, edges=edges)["n"].sum() == 1


def test_unknown_forces_leave_the_pressure_empty():
    def pressure(force):
        table = contacts([1e-5, 1.1e-4, 1.2e-4], [0.0, 0.0, 0.0], force=force)
        profile = radial_profile(table, centre=ORIGIN, edges=1e-4 * np.arange(4), frame="f", model="measured")
        assert profile["density_per_m2"].notna().all()
        return profile["pressure_Pa"] * np.pi * 1e-8

    assert pressure(np.full(3, np.nan)).isna().all()
    known = pressure(np.array([np.nan, 1e-3, np.nan]))
    assert known.isna().tolist() == [True, False, False]
    assert known[1:].tolist() == pytest.approx([1e-3 / 3, 0.0])


def test_places_are_averaged_by_the_area_that_is_seen(rng):
    edges = 1e-4 * np.arange(4)
    tables = [contacts(*rng.normal(0, 1e-4, (2, 50)), force=rng.random(50)) for _ in range(4)]
    places = [annulus_moments(table, centre=ORIGIN, edges=edges) for table in tables]
    alone = np.array(
        [average_profile([place], frame="f", model="measured")["pressure_Pa"] for place in places]
    )
    profile = average_profile(places, frame="f", model="measured")
    np.testing.assert_allclose(profile["pressure_Pa"], alone.mean(axis=0), rtol=1e-12)
    # four places: the standard error of their mean
    np.testing.assert_allclose(profile["pressure_std_Pa"], alone.std(axis=0, ddof=1) / 2, rtol=1e-12)
    # two places: sqrt(sum p^2) of all contacts over the area of both
    few = average_profile(places[:2], frame="f", model="measured")
    squares = sum_moments(places[:2])["pp"]
    np.testing.assert_allclose(few["pressure_std_Pa"], np.sqrt(squares) / (2 * places[0]["area"]), rtol=1e-12)


def test_places_with_other_annuli_are_refused():
    places = [
        annulus_moments(contacts([0.0], [0.0]), centre=ORIGIN, edges=[0.0, width]) for width in (1.0, 2.0)
    ]
    with pytest.raises(InputError, match="2 different sets"):
        average_profile(places, frame="f", model="measured")
    with pytest.raises(InputError, match="0 different sets"):
        average_profile([], frame="f", model="measured")


SMOOTH = {"sphere_radius": 0.1288, "contact_modulus": 4e6}


@pytest.mark.parametrize("width", [2.5e-4, 1e-2])  # many annuli; all contacts in one
def test_hertz_over_annuli_bears_the_load_in_any_unit(width):
    edges = width * np.arange(15)
    profile = hertz_profile(edges, load=0.5, frame="f", **SMOOTH)
    assert np.sum(profile["pressure_Pa"] * np.pi * np.diff(edges**2)) == pytest.approx(0.5, rel=1e-12)
    # lengths times l, pressures times p: the load times p l^2
    scaled = {"sphere_radius": 3 * 0.1288, "contact_modulus": 7 * 4e6}
    other = hertz_profile(3 * edges, load=7 * 9 * 0.5, frame="f", **scaled)
    np.testing.assert_allclose(other["pressure_Pa"], 7 * profile["pressure_Pa"], rtol=1e-9, atol=1e-6)


def test_rings_over_annuli_bear_the_load():
    rings = solve_greenwood_tripp(
        UniformHeights(30e-6, 60e-6),
        density=18.45e6,
        radius=100e-6,
        indenter_radius=0.1288,
        contact_modulus=4e6,
        load=0.2,
        rings=80,
    )
    edges = 2.5e-4 * np.arange(14)
    profile = ring_profile(rings.profile("f"), edges, frame="f")
    area = np.pi * np.diff(edges**2)
    # the solver's residual, 1e-11 of the load
    assert np.sum(profile["pressure_Pa"] * area) == pytest.approx(0.2, rel=1e-9)
    # area by the same rings, piecewise linear in the area fraction
    assert np.sum(profile["area_fraction"] * area) == pytest.approx(rings.area, rel=1e-9)
    assert (profile["mean_radius_m"].dropna().diff().dropna() < 0).all()
    assert profile["model"].unique().tolist() == ["gt"]


def test_normalised_hertz_is_one_at_the_centre_and_zero_at_the_edge():
    edges = 1e-6 * np.arange(4001)
    profile = hertz_profile(edges, load=0.5, frame="f", **SMOOTH)
    table = normalise_profile(profile, load=0.5, **SMOOTH)
    inside = table["r_over_hertz_radius"] < 0.99
    expected = np.sqrt(1 - table["r_over_hertz_radius"][inside] ** 2)
    # an annulus is w = 1/2294 of the radius wide: w^2 p''/24 is 2e-5 of p at 0.99
    np.testing.assert_allclose(table["pressure_over_hertz"][inside], expected, rtol=3e-5)
    assert (table["pressure_over_hertz"][table["r_over_hertz_radius"] > 1.001] == 0).all()


def exact_moments(pressures, weight=200.0):
    """Annuli of 1 mm^2 whose contacts follow density ~ p^0.4 and radius ~ p^0.2 exactly."""
    p = np.asarray(pressures, float)
    n = weight * (p / 1e4) ** 0.4
    a = 25e-6 * (p / 1e4) ** 0.2
    force = p * 1e-6
    sums = {
        "n": n,
        "n_forces": n,
        "a": n * a,
        "aa": 1.1 * n * a**2,
        "p": force,
        "pp": 1.5 * force**2 / n,
        "ap": force * a,
    }
    edges = 1e-3 * np.arange(len(p) + 1)
    return pd.DataFrame({"inner": edges[:-1], "outer": edges[1:], "area": 1e-6} | sums)


def test_greenwood_williamson_is_found_in_contacts_that_obey_it():
    loads = [{"a": exact_moments(np.geomspace(100, 1e4, 8))}, {"a": exact_moments(np.geomspace(3e3, 5e4, 6))}]
    for quantity, exponent in (("density", 0.4), ("mean_radius", 0.2)):
        law = fit_contact_law(loads, quantity)
        assert law.single.exponent.value == pytest.approx(exponent, abs=1e-6)
        assert not law.supported
        assert law.single.n_points == 12  # not the outermost of either load: no contact lies beyond it


def test_points_have_the_errors_of_counting():
    points = pressure_points(exact_moments([1e4]))
    # 200 contacts; relative variances 1/n, 1.5/n, 1.1/n - 1/n
    assert points["density_std"][0] / points["density"][0] == pytest.approx(200**-0.5)
    assert points["pressure_std"][0] / points["pressure"][0] == pytest.approx((1.5 / 200) ** 0.5)
    assert points["mean_radius_std"][0] / points["mean_radius"][0] == pytest.approx((0.1 / 200) ** 0.5)
    assert points["density_correlation"][0] == pytest.approx(1.5**-0.5)


def test_annuli_with_few_contacts_or_no_forces_are_left_out():
    moments = exact_moments([1e4, 1e4, 1e4])
    moments.loc[0, "n"], moments.loc[1, "n_forces"] = 4, 0
    assert pressure_points(moments)["n"].tolist() == [200.0]


def test_the_annuli_beside_an_annulus_decide_where_its_own_number_is_chance():
    moments = exact_moments([1e4] * 6)
    moments.loc[1, "n_forces"] = 0
    moments["n"] = [6, 200, 210, 4, 7, 1]
    # beside each: 200, sqrt(6 210) = 35, sqrt(200 4) = 28, sqrt(210 7) = 38, sqrt(4 1) = 2, none beyond
    assert pressure_points(moments, by_those_beside=True)["n"].tolist() == [6.0, 210.0, 4.0]
    moments.loc[3, "area"] /= 10  # ten times as dense for those beside it, and 3.8 expected in it
    kept = pressure_points(moments, by_those_beside=True)["n"]
    assert kept.tolist() == [6.0, 210.0, 7.0]  # beside the fifth sqrt(40 1) = 6.3


def test_density_beside_is_exact_for_exponential_profiles_and_takes_one_side_where_the_other_is_unseen():
    density = np.exp(-0.7 * np.arange(5))
    area = np.array([1.0, 3.0, 5.0, 7.0, 9.0])
    beside = density_beside(density * area, area)
    np.testing.assert_allclose(beside[1:4], density[1:4], rtol=1e-14)
    assert beside[[0, 4]].tolist() == [pytest.approx(density[1], rel=1e-14), 0.0]
    area[2] = 0.0
    np.testing.assert_allclose(density_beside(density * area, area)[[1, 3]], density[[0, 4]], rtol=1e-14)


def test_chance_in_the_numbers_does_not_make_the_law_flatter():
    """Few contacts an annulus, of which the number and each force are drawn: eta ~ p^0.7."""
    rng = np.random.default_rng(11)
    pressure = np.geomspace(300, 2e4, 24)
    mean_force, area = 1e-4 * (pressure / 2e3) ** 0.3, 4e-7 * (pressure / 2e3) ** -0.5
    found = []
    for _ in range(60):
        number = rng.poisson(area * pressure / mean_force)
        forces = [force * rng.exponential(size=n) for n, force in zip(number, mean_force, strict=True)]
        moments = exact_moments(pressure).assign(area=area, n=number, n_forces=number, a=1e-5 * number)
        moments["p"], moments["pp"] = [f.sum() for f in forces], [(f**2).sum() for f in forces]
        moments["aa"], moments["ap"] = 1e-10 * number, 1e-5 * moments["p"]
        found.append(fit_contact_law([{"one": moments}], "density").single.exponent.value)
    assert np.mean(found) == pytest.approx(0.7, abs=0.02)


def test_four_places_give_their_scatter():
    rng = np.random.default_rng(4)
    pressures = np.geomspace(100, 5e4, 9)
    places = {}
    for k in range(4):
        moments = exact_moments(pressures)
        tilt = (pressures / 2e3) ** rng.normal(0, 0.02)
        places[str(k)] = moments.assign(n=moments["n"] * tilt, a=moments["a"] * tilt, aa=moments["aa"] * tilt)
    law = fit_contact_law([places], "density")
    assert law.single.n_places == 4
    # exponents differ by 0.02: the standard error is 0.01, known from four places to 1/sqrt(6)
    assert law.single.exponent.std == pytest.approx(0.01, rel=2 / np.sqrt(6))
    assert fit_contact_law([{k: places[k] for k in "012"}], "density").single.n_places == 1


def test_unknown_quantity_and_no_load_are_refused():
    with pytest.raises(InputError, match="'density', 'mean_radius'"):
        fit_contact_law([], "area")
    with pytest.raises(InputError, match="one load"):
        fit_contact_law([], "density")


def test_loads_are_grouped_whatever_their_order():
    assert group_loads([0.5, 0.02, 0.0205, 0.5, 0.0, 0.0211], tolerance=0.05).tolist() == [3, 1, 1, 3, 0, 2]
    assert group_loads([], tolerance=0.05).tolist() == []
    assert group_loads([2.0, 1.0, 2.0], tolerance=0.0).tolist() == [1, 0, 1]
    assert group_loads([-0.1, 0.2, -0.1, -0.098], tolerance=0.05).tolist() == [0, 1, 0, 0]
    with pytest.raises(InputError, match="must not be negative"):
        group_loads([1.0], tolerance=-0.1)


def test_sampling_grows_with_the_root_of_the_number_and_the_square_of_the_size(rng):
    radii = pd.DataFrame({"radius_m": rng.uniform(5e-6, 40e-6, 50)})
    four = pd.concat([radii] * 4)
    assert sampling_std(four) == pytest.approx(2 * sampling_std(radii), rel=1e-12)
    assert sampling_std(3 * radii) == pytest.approx(9 * sampling_std(radii), rel=1e-12)
    assert sampling_std(radii[:0]) == 0.0


def frames(loads, areas):
    names = [f"{k}.tif" for k in range(len(loads))]
    return pd.DataFrame({"frame": names, "load_N": loads, "area_m2": areas, "area_std_m2": 1e-10})


def test_areas_average_frames_first_then_places():
    one = frame_areas(frames([0.1, 0.1], [1e-7, 3e-7]), CONTACTS.empty(), place="one")
    two = frame_areas(frames([0.1], [8e-7]), CONTACTS.empty(), place="two")
    table = area_by_load(pd.concat([one, two]), np.zeros(3, int), model="measured")
    # place one has 2e-7 on the average
    assert table["area_m2"].tolist() == pytest.approx([5e-7])
    assert table["area_scatter_m2"].tolist() == pytest.approx([np.std([2e-7, 8e-7], ddof=1)])
    assert table[["n_frames", "n_places"]].iloc[0].tolist() == [3, 2]
    assert table["area_std_m2"].tolist() == pytest.approx(
        [1e-10 / np.sqrt(3)]
    )  # no contacts: measurement alone


def test_exponent_leaves_out_what_has_no_logarithm():
    areas = frame_areas(
        frames([0.0, 0.1, 0.2, 0.4, np.nan, 0.3], [1e-8, 1e-7, 0.0, 4e-7, 1e-7, np.nan]),
        CONTACTS.empty(),
        place="p",
    )
    law = fit_area_law(areas)
    assert law.n_points == 2
    assert law.exponent.value == pytest.approx(1.0)
    with pytest.raises(InputError, match="two different loads with contacts at least, got 1"):
        fit_area_law(areas[areas["load"] <= 0.2])


def place_in_sectors(rng, share):
    """Six loads; each of eight sectors bears a share of the load, and has an area ~ its load^0.9."""
    loads = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.5])
    angle = 2 * np.pi * (np.arange(8) + 0.5) / 8
    tables = []
    for k, load in enumerate(loads):
        part = share + 0.02 * (5 - k) * rng.standard_normal(8)
        force = load * part / part.sum()
        area = 2e-7 * force**0.9 * (1 + 0.01 * (5 - k) * rng.standard_normal(8))
        table = {"x_m": 1e-3 * np.cos(angle), "y_m": 1e-3 * np.sin(angle), "radius_m": np.sqrt(area / np.pi)}
        tables.append(pd.DataFrame(table | {"force_N": force, "frame": f"{k}.tif"}))
    together = pd.concat(tables, ignore_index=True)
    total = (np.pi * together["radius_m"] ** 2).groupby(together["frame"]).sum()
    return frame_areas(frames(loads, total.to_numpy()), together, place="a", centre=ORIGIN)


def test_sectors_of_one_place_tell_how_well_the_exponent_of_the_area_is_known(rng):
    laws = [fit_area_law(place_in_sectors(rng, np.ones(8))) for _ in range(50)]
    held = np.mean([law.exponent.low <= 0.9 <= law.exponent.high for law in laws])
    # three binomial standard deviations of 50 at 95 %
    assert held > 0.95 - 0.093
    values = [law.exponent.value for law in laws]
    ratio = np.mean([law.exponent.std for law in laws]) / np.std(values, ddof=1)
    # a standard deviation of 50 values is good to 10 %; contacts alike have no counting error, so that the
    # scatter about the law counts a second time, sqrt(2) at most
    assert 1 - 3 * 0.1 < ratio < np.sqrt(2) * (1 + 3 * 0.1)


def test_sectors_that_share_load_and_area_alike_leave_the_measurement_alone(rng):
    areas = place_in_sectors(rng, np.ones(8))
    even = areas.assign(**{f"{name}_{k}": areas[f"{name}_0"] for name in ("area", "force") for k in range(8)})
    even["area"] = 1e-6 * even["load"] ** 0.9
    law = fit_area_law(even)
    doubled = fit_area_law(even.assign(area_std=2 * even["area_std"]))
    assert doubled.exponent.std == pytest.approx(2 * law.exponent.std, rel=0.1)
    unknown = fit_area_law(even.assign(force_3=np.nan))  # without forces, contacts are counted
    assert unknown.exponent.std > law.exponent.std


def test_a_place_with_more_area_by_chance_has_no_larger_weight():
    rng = np.random.default_rng(8)
    loads = np.tile([0.02, 0.1, 0.5], 300)
    relative = np.tile([0.3, 0.1, 0.1], 300)
    noise = 1 + relative * rng.standard_normal(loads.size)
    areas = pd.DataFrame({"place": np.repeat(np.arange(300), 3).astype(str), "load": loads})
    areas["area"] = 1e-6 * loads**0.9 * noise
    areas["area_std"], areas["sampling_std"] = 0.0, relative * areas["area"] / noise**0.5
    law = fit_area_law(areas)
    # E[ln(1 + e)] = -s^2/2 at the smallest load tilts the law by s^2/2 over some ln 5 to ln 25
    assert law.exponent.value == pytest.approx(0.9 + 0.045 / np.log(10), abs=3 * law.exponent.std + 0.01)
