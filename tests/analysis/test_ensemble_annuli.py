"""Ensembles over annuli: nothing is lost, groups add up, both means of the radius."""

import numpy as np
import pandas as pd
import pytest

from contactimg import InputError, annulus_moments, gather_annuli, solve_ensemble

SIDE, LOADS = 4e-3, [0.005, 0.02]
CENTRE = (SIDE / 2, SIDE / 2)
EDGES = np.linspace(0.0, 3e-3, 31)  # beyond the corners: every contact lies inside


def members(patterns=5):
    return solve_ensemble(
        "SA", patterns=patterns, loads=LOADS, side=SIDE, indenter_radius=0.1288, contact_modulus=4e6, seed=8
    )


def test_groups_hold_every_contact_and_the_load():
    sums = gather_annuli(members(), centre=CENTRE, edges=EDGES, groups=2)
    assert set(sums) == {(coupling, load) for coupling in ("none", "asymptotic") for load in LOADS}
    for (_, load), tables in sums.items():
        assert [table["patterns"].iloc[0] for table in tables.values()] == [3, 2]
        for table in tables.values():
            count = table["patterns"].iloc[0]
            # the solver's residual is 1e-12 of the load
            assert table["p"].sum() == pytest.approx(count * load, rel=1e-11)
            np.testing.assert_allclose(table["area"], count * np.pi * np.diff(EDGES**2), rtol=1e-12)


def test_groups_add_up_to_the_whole():
    whole, parts = (gather_annuli(members(), centre=CENTRE, edges=EDGES, groups=n) for n in (1, 3))
    for key, tables in whole.items():
        together = sum(table.drop(columns=["inner", "outer"]) for table in parts[key].values())
        pd.testing.assert_frame_equal(together, tables["0"].drop(columns=["inner", "outer"]), rtol=1e-12)


def test_means_part_where_annuli_are_empty():
    """Against the patterns one by one."""
    table = gather_annuli(members(), centre=CENTRE, edges=EDGES)["asymptotic", LOADS[1]]["0"]
    own = [
        annulus_moments(member.solutions["asymptotic", LOADS[1]].contacts(), centre=CENTRE, edges=EDGES)
        for member in members()
    ]
    radii = [np.where(one["n"] > 0, one["a"] / np.maximum(one["n"], 1), 0.0) for one in own]
    np.testing.assert_allclose(table["own_radius"], np.sum(radii, axis=0), rtol=1e-12)
    np.testing.assert_array_equal(table["occupied"], np.sum([one["n"] > 0 for one in own], axis=0))
    partly = table[(table["occupied"] > 0) & (table["occupied"] < table["patterns"])]
    assert len(partly)
    smallest = partly["own_radius"] / partly["occupied"]
    assert np.all(partly["own_radius"] / partly["patterns"] < smallest)


def test_refusals():
    with pytest.raises(InputError, match="groups must be at least 1"):
        gather_annuli(members(), centre=CENTRE, edges=EDGES, groups=0)
    with pytest.raises(InputError, match="one pattern and one load"):
        gather_annuli(members(0), centre=CENTRE, edges=EDGES)
