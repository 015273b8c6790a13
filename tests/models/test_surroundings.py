"""Contact regions that run off the table: what is said of them, and the mean field around the table."""

import functools

import numpy as np
import pandas as pd
import pytest

from contactimg.errors import InputError
from contactimg.models.conditions import ContactConditions
from contactimg.models.surroundings import MeanField
from contactimg.prediction import predict_contacts, table_rectangle
from contactimg.scene import scene_from_dict
from contactimg.surfaces import generate_asperities

LENS, APEX = 0.1288, (0.005, 0.005)
HALF = 0.002


def scene_of(*, apex=APEX, effects=None, **asperities):
    return scene_from_dict(
        {
            "indenter": {"radius_m": LENS, "apex_m": list(apex)},
            "elastic": {"young_modulus_Pa": 3e6, "work_of_adhesion_J_m2": 0.02},
            "effects": {"model": "paper"} | (effects or {}),
            "asperities": {"file": "asperities.csv"} | asperities,
        }
    )


@functools.cache
def whole_and_part(seed):
    whole = generate_asperities("SA", side=0.01, coverage=0.4, rng=np.random.default_rng(seed))
    inside = (whole[["x_m", "y_m"]] - 0.005).abs().max(axis=1).to_numpy() < HALF
    return whole, whole[inside].reset_index(drop=True), np.flatnonzero(inside)


def inner(prediction, rows):
    contacts = prediction.contacts[prediction.contacts["asperity"].isin(rows)]
    return np.array([contacts["area_m2"].sum(), contacts["force_N"].sum()])


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
def test_mean_field_replaces_the_pattern_around_a_part(coupling):
    """The pattern beyond is random: 100 contacts of 1 mN outside scatter by 0.01 N, 2.5 % of the inner load.

    The mean of eight patterns scatters by 0.9 %.
    """
    ratios, bare = [], []
    for seed in range(8):
        whole, part, rows = whole_and_part(seed)
        expected = inner(predict_contacts(scene_of(), whole, load=0.5, coupling=coupling), rows)
        for surroundings, found in (("mean_field", ratios), ("none", bare)):
            scene = scene_of(surroundings=surroundings)
            prediction = predict_contacts(scene, part, load=0.5, coupling=coupling)
            found.append(inner(prediction, range(len(part))) / expected)
    assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=0.02)
    assert np.std(ratios, axis=0).max() < 0.035
    assert np.abs(np.mean(bare, axis=0) - 1).max() > 0.02


def test_a_region_that_runs_off_the_table_is_said():
    whole, part, _ = whole_and_part(1)
    inside = predict_contacts(scene_of(), whole, load=0.5, coupling="asymptotic").frames.iloc[0]
    assert "runs off the table" not in inside["message"]
    for apex in (APEX, (0.0075, 0.005)):  # the second stands beside the table
        row = predict_contacts(scene_of(apex=apex), part, load=0.5, coupling="asymptotic").frames.iloc[0]
        assert row["status"] == "approximate"
        assert "within one mean spacing of its rim" in row["message"]
        assert "mean field outside would carry" in row["message"]
    light = predict_contacts(scene_of(), part, load=0.005, coupling="asymptotic").frames.iloc[0]
    assert light["status"] == "ok"
    assert "table" not in light["message"]


def test_the_mean_field_bears_its_share_and_nothing_where_the_table_is_large():
    whole, part, _ = whole_and_part(2)
    row = predict_contacts(scene_of(surroundings="mean_field"), part, load=0.5).frames.iloc[0]
    assert "a mean field carries" in row["message"]
    carried = float(row["message"].split("carries ")[1].split(" N")[0])
    assert row["force_sum_N"] + carried == pytest.approx(0.5, rel=1e-3)
    assert row["load_N"] == 0.5
    alone, around = (
        predict_contacts(scene_of(surroundings=s), whole, load=0.1, coupling="full").frames.iloc[0]
        for s in ("none", "mean_field")
    )
    assert around["area_m2"] == pytest.approx(alone["area_m2"], rel=1e-6)
    assert around["indentation_m"] == pytest.approx(alone["indentation_m"], rel=1e-6)


def test_all_of_a_pattern_that_is_a_mean_field_adds_up():
    """Of a rectangle without extent everything is outside: the whole load and area of the rings."""
    whole, _, _ = whole_and_part(3)
    where = ContactConditions(LENS, 4e6, APEX, np.inf, 0.2, None)
    full = MeanField(whole, np.array([[0.0, 0.01], [0.0, 0.01]]), where)
    assert full.load == 0.0
    beside = MeanField(whole, np.array([[0.02, 0.03], [0.02, 0.03]]), where)
    assert beside.load == pytest.approx(0.2, rel=2e-3)
    assert beside.area == pytest.approx(beside.rings.area, rel=5e-3)
    # at 15 mm the field is that of one force: P/(pi E* r)
    r = np.hypot(0.015, 0.015)
    sunk = beside.displacement(np.array([0.02]), np.array([0.02]))
    assert float(sunk[0]) == pytest.approx(0.2 / (np.pi * 4e6 * r), rel=0.02)


def test_the_mean_field_opens_the_gap_between_the_planes():
    """What lies beyond the part sinks its surface by 1 um: the gap is that of the whole within 0.05 um."""
    whole, part, _ = whole_and_part(1)
    expected, around, bare = (
        predict_contacts(scene_of(surroundings=kind), table, load=0.5, coupling="asymptotic")
        .frames["min_gap_m"]
        .iloc[0]
        for kind, table in (("none", whole), ("mean_field", part), ("none", part))
    )
    assert around == pytest.approx(expected, abs=5e-8)
    assert bare < expected - 5e-7


def test_what_has_no_mean_field_is_refused():
    _, part, _ = whole_and_part(4)
    scene = scene_of(surroundings="mean_field")
    with pytest.raises(InputError, match="needs at least 20 asperities"):
        predict_contacts(scene, part.iloc[:5], load=0.01)
    sticky = scene_of(surroundings="mean_field", effects={"adhesion": "on"})
    with pytest.raises(InputError, match="without adhesion"):
        predict_contacts(sticky, part, load=0.01)


def test_the_rectangle_of_a_generated_pattern_is_its_square():
    _, part, _ = whole_and_part(4)
    generated = scene_of(file=None, generate="SA", side_m=0.01).asperities
    assert table_rectangle(generated, part).tolist() == [[0.0, 0.01], [0.0, 0.01]]
    found = table_rectangle(scene_of().asperities, part)
    assert np.abs(found - [[0.003, 0.007], [0.003, 0.007]]).max() < 2e-4


def test_a_tiny_table_under_a_large_lens_is_quickly_judged():
    places = 1e-5 * np.arange(6.0)
    x, y = (v.ravel() for v in np.meshgrid(places, places))
    table = pd.DataFrame({"x_m": x, "y_m": y, "height_m": 4e-5, "radius_m": 1e-6})
    row = predict_contacts(scene_of(apex=(0.0, 0.0)), table, load=1e-6, coupling="none").frames.iloc[0]
    assert row["n_contacts"] == 36
