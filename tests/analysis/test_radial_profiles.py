"""Profiles: annuli by hand, conservation of force, number and area."""

import numpy as np
import pandas as pd
import pytest

from contactimg.analysis.annuli import annulus_edges, annulus_moments
from contactimg.analysis.radial_profiles import average_profile, radial_profile
from contactimg.errors import InputError
from contactimg.tables import CONTACTS


def contacts(x, y, radius, force):
    radius = np.asarray(radius, float)
    return CONTACTS.conform(
        {"x_m": x, "y_m": y, "radius_m": radius, "area_m2": np.pi * radius**2, "force_N": force}
    )


def profile(table, edges, centre=(0.0, 0.0)):
    return radial_profile(table, centre=centre, edges=edges, frame="f", model="measured")


def test_two_annuli_by_hand():
    table = contacts([1.0, 11.5, 10.0], [2.0, 2.0, 3.5], [0.1, 0.2, 0.4], [3.0, 5.0, 7.0])
    rows = profile(table, [0.0, 1.0, 2.0], centre=(10.0, 2.0))
    # distances from (10, 2): 9 (outside), 1.5, 1.5; the outer annulus has the area 3 pi
    assert rows["density_per_m2"].tolist() == [0.0, pytest.approx(2 / (3 * np.pi))]
    assert rows["pressure_Pa"].tolist() == [0.0, pytest.approx(12 / (3 * np.pi))]
    assert rows["pressure_std_Pa"][1] == pytest.approx(np.sqrt(25 + 49) / (3 * np.pi))
    assert np.isnan(rows["mean_radius_m"][0])
    assert rows["mean_radius_m"][1] == pytest.approx(0.3)


def test_force_number_and_area_are_conserved(rng):
    table = contacts(*rng.normal(size=(2, 300)), rng.random(300), rng.random(300))
    edges = annulus_edges(table, centre=(0.1, -0.2), width=0.25)
    rows = profile(table, edges, centre=(0.1, -0.2))
    area = np.pi * np.diff(edges**2)
    assert np.sum(rows["pressure_Pa"] * area) == pytest.approx(table["force_N"].sum(), rel=1e-12)
    assert np.sum(rows["density_per_m2"] * area) == pytest.approx(300, rel=1e-12)
    assert np.sum(rows["area_fraction"] * area) == pytest.approx(table["area_m2"].sum(), rel=1e-12)


@pytest.mark.parametrize("places", [1, 5])
def test_an_annulus_without_contacts_has_an_upper_limit(places):
    """-ln(0.05) = 3.00 contacts of the larger of the neighbours' mean forces at 95 %, over 1.96 as a std."""
    radius = np.array([0.5, 0.6, 2.5])
    table = pd.DataFrame({"x_m": radius, "y_m": 0.0, "radius_m": 0.1, "force_N": [1.0, 3.0, 0.5]})
    moments = [annulus_moments(table, centre=(0.0, 0.0), edges=np.arange(5.0))] * places
    rows = average_profile(moments, frame="f", model="measured")
    area = np.pi * np.diff(np.arange(5.0) ** 2) * places
    assert rows["pressure_Pa"].tolist()[1::2] == [0.0, 0.0]
    assert rows["pressure_std_Pa"][1] == pytest.approx(-np.log(0.05) / 1.959964 * 2.0 / area[1])
    assert rows["pressure_std_Pa"][3] == pytest.approx(-np.log(0.05) / 1.959964 * 0.5 / area[3])
    # the interval of 95 % ends at -ln(0.025) contacts, of the forces' weighted mean 10/4 N and of 0.5 N
    assert rows["pressure_low_Pa"].tolist()[1::2] == [0.0, 0.0]
    assert rows["pressure_high_Pa"][1] == pytest.approx(-np.log(0.025) * 2.5 / area[1])
    assert rows["pressure_high_Pa"][3] == pytest.approx(-np.log(0.025) * 0.5 / area[3])


def test_no_contacts_is_one_empty_annulus():
    edges = annulus_edges(CONTACTS.empty(), centre=(0.0, 0.0), width=0.25)
    rows = profile(CONTACTS.empty(), edges)
    assert edges.tolist() == [0.0, 0.25]
    assert rows["pressure_Pa"].tolist() == [0.0]


@pytest.mark.parametrize("edges", [[0.0], [1.0, 0.5], [0.0, 0.0]])
def test_edges_must_increase(edges):
    with pytest.raises(InputError, match="must increase"):
        profile(CONTACTS.empty(), edges)


def test_width_must_be_positive():
    with pytest.raises(InputError, match="width of an annulus must be positive"):
        annulus_edges(CONTACTS.empty(), centre=(0.0, 0.0), width=0.0)


def test_a_contact_at_the_end_of_the_world_is_refused():
    far = CONTACTS.conform(pd.DataFrame({"frame": ["a"], "x_m": [1e300], "y_m": [0.0]}))
    with pytest.raises(InputError, match="check x_m and y_m"):
        annulus_edges(far, centre=(0.0, 0.0), width=1e-4)


def place_of(x, y, force):
    table = pd.DataFrame({"x_m": x, "y_m": y, "radius_m": 1.0, "force_N": force})
    return annulus_moments(table, centre=(0.0, 0.0), edges=np.arange(1.0, 12.0), sectors=8)


def test_sectors_tell_how_much_less_regular_contacts_fluctuate_than_independent_ones(rng):
    """Two per sector and annulus, as regular as rows, and the same number anywhere."""
    ring = np.repeat(np.arange(1.5, 11.0), 16)
    regular = 2 * np.pi * (np.tile(np.arange(16), 10) + 0.5) / 16
    alike, anywhere = [], []
    for _ in range(40):
        for angle, found in ((regular, alike), (rng.uniform(0, 2 * np.pi, ring.size), anywhere)):
            moments = place_of(ring * np.cos(angle), ring * np.sin(angle), np.ones(ring.size))
            std = average_profile([moments], frame="f", model="m")["pressure_std_Pa"].to_numpy()
            found.append(
                std * moments.groupby("inner")["area"].sum().to_numpy() / 4.0
            )  # sqrt(16) by counting
    assert np.max(alike) < 1e-12  # rounding
    # a variance from 3 annuli of 7 degrees of freedom, 40 times over, some 130 of them independent
    assert np.mean(np.square(anywhere)) == pytest.approx(1.0, abs=3 * np.sqrt(2 / (7 * 10 * 40)))


def test_one_contact_is_as_uncertain_as_if_counted():
    moments = place_of([3.5], [0.0], [2.0])
    row = average_profile([moments], frame="f", model="m").iloc[2]
    assert row["pressure_std_Pa"] == pytest.approx(row["pressure_Pa"], rel=1e-12)
