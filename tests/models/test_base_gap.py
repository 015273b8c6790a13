"""The gap between the base planes against a brute-force evaluation, and the warnings below zero."""

import numpy as np
import pandas as pd
import pytest

from contactimg.cli import main
from contactimg.compiled import njit
from contactimg.errors import InputError, ModelRangeError
from contactimg.models.adhesive import solve_adhesive
from contactimg.models.interacting import solve_interacting
from contactimg.prediction import find_touching_load, predict_average, predict_contacts
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities

RA_LENS, SA_LENS = 0.013, 0.1288
SIDE = 0.004
MIDDLE = (SIDE / 2, SIDE / 2)
WHERE = {"contact_modulus": 4e6, "apex": MIDDLE}


def scene_of(lens, *, apex=MIDDLE, **sections):
    return scene_from_dict(
        {
            "indenter": {"radius_m": lens, "apex_m": list(apex)},
            "elastic": {"young_modulus_Pa": 3e6},
            "effects": {"model": "paper"},
        }
        | sections
    )


def pattern(kind, seed, **options):
    return generate_asperities(kind, side=SIDE, rng=np.random.default_rng(seed), **options)


@njit()
def add_displacements(gap, points, contacts):
    """Add what Hertzian contacts ``x, y, radius, composite radius`` displace the surface by at points."""
    for k in range(gap.size):
        for x, y, a, curved in contacts:
            r = np.hypot(points[0, k] - x, points[1, k] - y)
            q = min(a / r, 1.0)
            gap[k] += ((2 * a**2 - r**2) * np.arcsin(q) + r * a * np.sqrt(1 - q**2)) / (np.pi * curved)


def brute_force_gap(table, solution, lens, *, apex=MIDDLE, step=12e-6, reach=9e-4, on_rim=45):
    """Smallest gap on a dense grid and at points on the rims of the caps, by Johnson's formula for Hertz.

    It is written with contact radii and radii of curvature, where the package takes forces.
    """
    x, y, height, radius = (table[name].to_numpy() for name in ("x_m", "y_m", "height_m", "radius_m"))
    base = np.sqrt(2 * radius * height - height**2)
    steps = np.arange(-reach, reach, step)
    px, py = (v.ravel() for v in np.meshgrid(apex[0] + steps, apex[1] + steps))
    rows = solution.touching
    turn = np.linspace(0, 2 * np.pi, on_rim)[:, None]
    px = np.concatenate([px, (x[rows] + 1.000001 * base[rows] * np.cos(turn)).ravel()])
    py = np.concatenate([py, (y[rows] + 1.000001 * base[rows] * np.sin(turn)).ravel()])
    free = np.hypot(px - apex[0], py - apex[1]) < 1.5 * reach
    for row in np.flatnonzero(np.hypot(x - apex[0], y - apex[1]) < 1.5 * reach):
        free &= (px - x[row]) ** 2 + (py - y[row]) ** 2 >= base[row] ** 2
    px, py = px[free], py[free]
    from_apex = (x - apex[0]) ** 2 + (y - apex[1]) ** 2
    first_touch = np.max(height - from_apex / (2 * (radius + lens)))
    gap = first_touch - solution.indentation + ((px - apex[0]) ** 2 + (py - apex[1]) ** 2) / (2 * lens)
    names = ("x", "y", "radius", "composite_radius")
    contacts = np.column_stack([getattr(solution, name)[rows] for name in names])
    add_displacements(gap, np.stack([px, py]), contacts)
    return float(gap.min())


def test_gap_between_caps_agrees_with_brute_force():
    table = pattern("RA-", 103)
    for load in (0.05, 0.3):
        solution = solve_interacting(table, load=load, indenter_radius=RA_LENS, **WHERE)
        expected = brute_force_gap(table, solution, RA_LENS)
        # the brute-force grid of 12 um misses a minimum by g'' (6 um)^2/2, some nm
        assert solution.base_gap.least == pytest.approx(expected, abs=2e-8)
        assert solution.validity.planes_touch == (expected < 0)


def test_planes_of_the_dense_lens_touch_where_the_paper_stops():
    """The paper predicts RA- up to 0.2 N only; patterns scatter by the height of their highest caps."""
    scene, loads = scene_of(RA_LENS), []
    for seed in range(100, 105):
        table = pattern("RA-", seed)
        loads.append(find_touching_load(scene, table, coupling="asymptotic"))
    assert 0.15 < np.median(loads) < 0.25
    assert all(0.14 < load < 0.4 for load in loads)
    before, after = (
        predict_contacts(scene, table, load=factor * loads[-1], coupling="asymptotic").frames.iloc[0]
        for factor in (0.98, 1.02)
    )
    assert (before["status"], after["status"]) == ("ok", "approximate")
    assert before["min_gap_m"] > 0 > after["min_gap_m"]
    assert "the planes touch" in after["message"]
    assert "the planes touch" not in before["message"]


def test_many_contacts_take_fast_sums():
    table = generate_asperities("SA", side=0.03, coverage=0.4, rng=np.random.default_rng(3))
    where = {"contact_modulus": 4e6, "apex": (0.015, 0.015)}
    solution = solve_interacting(table, load=4.0, indenter_radius=0.5, **where)
    found = solution.base_gap
    assert solution.touching.size > 1500
    r = np.hypot(solution.x - found.x, solution.y - found.y)[solution.touching]
    grids = {"step": 5e-5, "reach": 3e-3, "on_rim": 15}
    near = brute_force_gap(table, solution, 0.5, apex=(0.015, 0.015), **grids)
    assert found.least == pytest.approx(near, abs=2e-8)
    assert r.min() > 0


def test_ring_of_caps_touches_before_its_caps_do():
    """At 1 mm the lens of 13 mm has risen by 38.5 um, caps are 30 um high: its apex is 8.2 um too low."""
    turn = np.pi / 6 * np.arange(12)
    ring = pd.DataFrame(
        {"x_m": 1e-3 * np.cos(turn), "y_m": 1e-3 * np.sin(turn), "height_m": 30e-6, "radius_m": 1e-4}
    )
    scene = scene_of(RA_LENS, apex=(0.0, 0.0))
    row = predict_contacts(scene, ring, load=1e-9).frames.iloc[0]
    # 30e-6 - (1e-3)^2/(2 (0.013 + 1e-4)) = -8.168e-6
    assert row["min_gap_m"] == pytest.approx(-8.168e-6, abs=1e-8)
    assert row["status"] == "approximate"
    assert "at (0, 0) mm" in row["message"] or "at (-0, 0) mm" in row["message"]
    assert find_touching_load(scene, ring) == 0.0
    with pytest.raises(InputError, match="the interacting model needs a table of asperities"):
        find_touching_load(scene, None)


def test_sparse_pattern_warns_and_says_how_much_touches():
    table = pattern("SA", 1, coverage=0.02)
    row = predict_contacts(scene_of(SA_LENS), table, load=0.2).frames.iloc[0]
    assert row["status"] == "approximate"
    assert row["min_gap_m"] < -2e-6
    assert "of the base within the nominal contact" in row["message"]


def test_mostly_touching_planes_are_refused():
    with pytest.raises(ModelRangeError, match=r"planes touch.* of the base within the nominal contact"):
        predict_contacts(scene_of(SA_LENS), pattern("SA", 1, coverage=0.02), load=3.0)


def test_gap_follows_a_change_of_units():
    """Lengths times l, stresses times s: the gap is l times as large."""
    table, length, stress = pattern("SA", 7, coverage=0.3), 1e-6, 1e5
    scaled = table * length
    plain, other = (
        solve_interacting(
            one,
            load=0.3 * s * k**2,
            indenter_radius=SA_LENS * k,
            contact_modulus=4e6 * s,
            apex=(MIDDLE[0] * k, MIDDLE[1] * k),
            thickness=1e-3 * k,
        ).base_gap
        for one, k, s in ((table, 1.0, 1.0), (scaled, length, stress))
    )
    assert other.least == pytest.approx(plain.least * length, rel=1e-6)
    assert other.x == pytest.approx(plain.x * length, rel=1e-3)


def test_single_cap_under_a_flat():
    """Between lens and plane, beside the cap: h - D + u(r), with u = 2 a^3/(3 pi R r) at a distance."""
    cap = pd.DataFrame({"x_m": [0.0], "y_m": [0.0], "height_m": [4e-5], "radius_m": [1e-4]})
    solution = solve_interacting(cap, indenter_radius=np.inf, contact_modulus=4e6, load=1e-4)
    found, a = solution.base_gap, float(solution.radius[0])
    r = np.hypot(found.x, found.y)
    # corners of the rectangle about the disc of radius 80 um are the farthest places
    assert r == pytest.approx(80e-6 * np.sqrt(2), rel=0.05)
    far = 4 * a**3 / (3 * np.pi * 1e-4 * r) * (1 + 0.1 * (a / r) ** 2)
    assert found.least == pytest.approx(4e-5 - a**2 / 1e-4 + far, rel=1e-4)


def test_adhesive_contacts_have_a_gap():
    table = pattern("SA", 7, coverage=0.3)
    adhering = solve_adhesive(table, load=0.02, indenter_radius=SA_LENS, work_of_adhesion=0.02, **WHERE)
    plain = solve_interacting(table, load=0.02, indenter_radius=SA_LENS, **WHERE)
    assert 0 < adhering.base_gap.least < plain.base_gap.least


def average_scene(**asperities):
    uniform = {
        "density_per_m2": 18e6,
        "radius_m": 1e-4,
        "height_law": "uniform",
        "height_min_m": 30e-6,
        "height_max_m": 60e-6,
    }
    return scene_of(SA_LENS, asperities=uniform | asperities)


@pytest.mark.parametrize("table", [None, pd.DataFrame()])
def test_a_touching_load_of_averages_needs_a_radius(table):
    section = average_scene().source["asperities"]
    unstated = scene_of(SA_LENS, asperities={name: section[name] for name in section if name != "radius_m"})
    with pytest.raises(InputError, match=r"needs radius_m in \[asperities\], or a table"):
        find_touching_load(unstated, table, model="gw")


def test_averages_state_the_gap_of_their_mean_planes():
    scene = average_scene()
    touching = find_touching_load(scene, None, model="gw")
    for factor, touches in ((0.97, False), (1.1, True)):
        row = predict_average(scene, None, load=factor * touching, model="gw").frames.iloc[0]
        assert row["min_gap_m"] == pytest.approx(60e-6 - row["indentation_m"], abs=1e-12)
        assert ("the planes touch" in row["message"]) == touches
        assert row["status"] == ("approximate" if touches else "ok")
        assert "borne at a mean a/R of" in row["message"]
    light = predict_average(scene, None, load=0.01, model="gt").frames.iloc[0]
    assert light["message"] == ""
    assert light["min_gap_m"] > 40e-6
    with pytest.raises(ModelRangeError, match="planes touch"):
        predict_average(average_scene(radius_m=1e-3), None, load=1000.0, model="gw")


def test_touching_load_from_the_command_line(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(
        "[indenter]\nradius_m = 0.013\napex_m = [0.002, 0.002]\n[elastic]\nyoung_modulus_Pa = 3e6\n"
        '[asperities]\ngenerate = "RA-"\nside_m = 0.004\nseed = 5\n[effects]\nmodel = "paper"\n'
    )
    arguments = ["predict", str(tmp_path), "--touching-load", "--coupling", "asymptotic"]
    assert main([*arguments, "--load-N", "0.05", "-o", str(tmp_path / "out")]) == 0
    assert "the base planes touch from 0.1658 N on" in capsys.readouterr().out
    frames = pd.read_csv(tmp_path / "out" / "frames.csv")
    assert frames["min_gap_m"][0] > 1e-6
    assert abs(frames["min_gap_m"][1]) < 2e-8


def test_without_a_base_plane_there_is_no_touching_load():
    places = np.linspace(-3e-5, 3e-5, 7)
    x, y = (v.ravel() for v in np.meshgrid(places, places))
    crowd = pd.DataFrame({"x_m": x, "y_m": y, "height_m": 4e-5, "radius_m": 1e-4})
    scene = scene_of(0.1, apex=(0.0, 0.0))
    with pytest.raises((InputError, ModelRangeError)):
        find_touching_load(scene, crowd.iloc[:0])
