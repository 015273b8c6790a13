"""Onset of sliding: closed forms, two contacts by hand, many contacts against another bounded solver."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import lsq_linear

from contactimg import InputError, recover_shear_forces, solve_sliding_onset, tangential_compliance

MODULUS, NU, STRENGTH = 4e6, 0.5, 3e5
G = 1e6  # E*(1 - nu)/2
BODY = {"contact_modulus": MODULUS, "poisson_ratio": NU}
LAW = BODY | {"shear_strength": STRENGTH}


def table(x, y, radius):
    x, y, radius = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in (x, y, radius)))
    return pd.DataFrame({"x_m": x, "y_m": y, "radius_m": radius})


def pattern(rng, smallest=8e-6, largest=29e-6):
    """256 contacts, 150 um apart."""
    line = 150e-6 * np.arange(16)
    x, y = np.meshgrid(line, line)
    return table(x.ravel(), y.ravel(), rng.uniform(smallest, largest, 256))


def bounded_least_squares(onset, displacement):
    """The same minimum as ``|L' q - D L^-1 1|`` under bounds, by scipy's active set."""
    L = np.linalg.cholesky(onset.compliance)
    right = np.linalg.solve(L, np.full(len(L), displacement))
    return lsq_linear(L.T, right, bounds=(0, onset.strength), method="bvls", tol=1e-15).x


def test_one_contact_has_the_closed_forms():
    a = 20e-6
    onset = solve_sliding_onset(table(0, 0, a), **LAW)
    forces = onset.forces_at([0, 1e-6, 1.0])[:, 0]
    full = STRENGTH * np.pi * a**2
    np.testing.assert_allclose(forces, [0, 8 * G * a / (2 - NU) * 1e-6, full], rtol=1e-14)
    # full/stiffness = tau0 pi a (2 - nu)/(8 G) = 3.53 um
    assert onset.slip_displacement[0] == pytest.approx(STRENGTH * np.pi * a * (2 - NU) / (8 * G), rel=1e-14)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_compliance_of_one_contact_is_the_integral_of_the_point_force(nu):
    """u(0) of the traction q/(2 pi a sqrt(a^2 - r^2)): the angle averages cos^2 to a half."""
    a = 3.0
    traction = quad(lambda s: 1 / (2 * np.pi * a), 0, np.pi / 2)[0]  # r = a sin s, dr/sqrt(a^2 - r^2) = ds
    around = quad(lambda angle: (1 - nu) + nu * np.cos(angle) ** 2, 0, 2 * np.pi)[0]
    shear = 4.0 * (1 - nu) / 2
    C = tangential_compliance(table(0, 0, a), contact_modulus=4.0, poisson_ratio=nu)
    assert C[0, 0] == pytest.approx(traction * around / (2 * np.pi * shear), rel=1e-12)


def test_two_contacts_by_hand():
    """Along the load, then across it: C_12 = 1/(2 pi G r) and half of it at nu = 1/2."""
    r, radii = 100e-6, np.array([10e-6, 20e-6])
    contacts = table([0, r], 0, radii)
    for direction, factor in ((0.0, 1.0), (np.pi / 2, 0.5), (np.pi / 4, 0.75)):
        onset = solve_sliding_onset(contacts, direction=direction, **LAW)
        c1, c2 = 1.5 / (8 * G * radii)
        c12 = factor / (2 * np.pi * G * r)
        rate = np.array([c2 - c12, c1 - c12]) / (c1 * c2 - c12**2)
        limit = STRENGTH * np.pi * radii**2
        # the small one slips first, the other then follows c2 q2 = D - c12 q1
        first = limit[0] / rate[0]
        last = limit[1] * c2 + limit[0] * c12
        np.testing.assert_allclose(onset.slip_displacement, [first, last], rtol=1e-12)
        between = (first + last) / 2
        np.testing.assert_allclose(
            onset.forces_at(between)[0], [limit[0], (between - c12 * limit[0]) / c2], rtol=1e-12
        )
        assert list(onset.order) == [0, 1]


def test_many_contacts_agree_with_another_bounded_solver(rng):
    onset = solve_sliding_onset(pattern(rng), direction=0.3, **LAW)
    for displacement in np.quantile(onset.slip_displacement, [0.0, 0.02, 0.3, 0.7, 0.98]) * 1.0001:
        q = bounded_least_squares(onset, displacement)
        np.testing.assert_allclose(onset.forces_at(displacement)[0], q, rtol=1e-8, atol=1e-8 * q.max())
    assert onset.residual < 1e-12
    assert (onset.forces_at(1.0) == onset.strength).all()


def test_coupling_takes_most_of_the_force_of_independent_contacts(rng):
    """Radii of 8 to 29 um: condition number 8.7; at 1 um independent contacts bear 4.3 times the force."""
    onset = solve_sliding_onset(pattern(rng), **LAW)
    curve = onset.curve([1e-6]).iloc[0]
    assert 8 < np.linalg.cond(onset.compliance) < 9.5
    assert 4 < curve["independent_N"] / curve["force_N"] < 5
    assert curve["slipping"] == 0
    # the rim bears most and slips first
    x, y = (np.repeat([np.arange(16)], 16, 0), np.repeat(np.arange(16)[:, None], 16, 1))
    rim = ((x % 15 == 0) | (y % 15 == 0)).ravel()
    assert np.median(onset.slip_displacement[rim]) < np.median(onset.slip_displacement[~rim])


def test_independent_limit(rng):
    """Far apart the coupling is lost as a/r: 1e-3 here."""
    near = pattern(rng)
    far = near.assign(x_m=near["x_m"] * 1e5, y_m=near["y_m"] * 1e5)
    onset = solve_sliding_onset(far, **LAW)
    D = np.linspace(0, 2e-5, 9)
    np.testing.assert_allclose(onset.forces_at(D), onset.independent_forces_at(D), rtol=1e-2)


def test_units_may_change(rng):
    """Lengths by l, pressures by p: forces scale by p l^2."""
    contacts, length, pressure = pattern(rng).iloc[::9], 1e3, 7.0
    one = solve_sliding_onset(contacts, **LAW)
    other = solve_sliding_onset(
        contacts * length,
        shear_strength=STRENGTH * pressure,
        contact_modulus=MODULUS * pressure,
        poisson_ratio=NU,
    )
    np.testing.assert_allclose(
        other.forces_at(one.events * length), one.forces_at(one.events) * pressure * length**2, rtol=1e-9
    )


def test_a_contact_that_its_neighbours_carry_along_bears_nothing():
    """Between two large ones in the line of the load: a bound from below, and one that sticks later.

    8 a/(2 pi 1.5 r) = 0.816 of each large one's displacement reaches the middle, 0.408 the other large one:
    2 x 0.816/1.408 = 1.16 of the displacement of the glass.
    """
    contacts = table([0, -52e-6, 52e-6], 0, [1.5e-6, 50e-6, 50e-6])
    onset = solve_sliding_onset(contacts, **LAW)
    assert onset.forces_at(1e-6)[0, 0] == 0
    for displacement in np.linspace(0.05, 1.2, 9) * onset.slip_displacement.max():
        q = bounded_least_squares(onset, displacement)
        np.testing.assert_allclose(onset.forces_at(displacement)[0], q, rtol=1e-8, atol=1e-8 * q.max())


def test_forces_are_recovered_with_their_errors(rng):
    """400 draws of errors of displacements, radii and modulus: the standardised errors have variance 1."""
    contacts = pattern(rng).iloc[:40].reset_index(drop=True)
    truth = solve_sliding_onset(contacts, **LAW)
    q = truth.forces_at(2e-6)[0]
    u = truth.compliance @ q
    np.testing.assert_allclose(
        recover_shear_forces(contacts, u, displacement_std=0, **BODY).force, q, rtol=1e-10
    )
    scores, totals = [], []
    for _ in range(400):
        measured = contacts.assign(
            radius_m=contacts["radius_m"] * (1 + 0.02 * rng.standard_normal(40)),
            radius_std_m=contacts["radius_m"] * 0.02,
        )
        found = recover_shear_forces(
            measured,
            u + 2e-8 * rng.standard_normal(40),
            displacement_std=2e-8,
            contact_modulus=MODULUS * (1 + 0.03 * rng.standard_normal()),
            contact_modulus_std=0.03 * MODULUS,
            poisson_ratio=NU,
        )
        scores.append((found.force - q) / found.std)
        totals.append((found.total[0] - q.sum()) / found.total[1])
    # standard deviation of a variance over n independent draws: sqrt(2/n), 0.07 for 400
    assert np.mean(np.square(scores)) == pytest.approx(1, abs=0.15)
    assert np.var(totals) == pytest.approx(1, abs=4 * np.sqrt(2 / 400))
    assert np.mean(np.abs(scores) < 1.96) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("contacts", "said"),
    [
        (table([0, 3e-5, 3e-4], 0, 2e-5), "rows 0 and 1 overlap: they are 30 um apart"),
        (table([0, 1e-4], 0, [2e-5, 0]), "row 1, column 'radius_m' must be positive, got 0.0"),
        (table([0, np.nan], 0, 2e-5), "row 1, column 'x_m' must be finite, got nan"),
        (table([0, 1e-4], 0, [np.nan, 2e-5]), "row 0, column 'radius_m' must be positive, got nan"),
        (table([], [], []), "the table is empty"),
        (table([0], 0, 2e-5).drop(columns="y_m"), "column 'y_m' is missing"),
    ],
)
def test_contacts_that_break_a_rule_are_refused(contacts, said):
    with pytest.raises(InputError, match=said):
        solve_sliding_onset(contacts, **LAW)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"shear_strength": 0.0}, "shear_strength must be positive"),
        ({"shear_strength": np.nan}, "shear_strength must be finite"),
        ({"shear_strength": None}, "shear_strength must be a number"),
        ({"direction": np.nan}, "direction must be finite"),
        ({"contact_modulus": -1.0}, "contact_modulus must be positive"),
        ({"poisson_ratio": 0.6}, "poisson_ratio must be above -1 and at most 0.5"),
    ],
)
def test_constants_that_break_a_rule_are_refused(change, said):
    with pytest.raises(InputError, match=said):
        solve_sliding_onset(table(0, 0, 2e-5), **LAW | change)


def test_displacements_that_break_a_rule_are_refused():
    onset = solve_sliding_onset(table(0, 0, 2e-5), **LAW)
    for wrong in (-1e-6, np.nan, [[1e-6]]):
        with pytest.raises(InputError, match="displacements must be a list"):
            onset.curve(wrong)
    with pytest.raises(InputError, match="one for each of the 1 contacts"):
        recover_shear_forces(table(0, 0, 2e-5), [1e-6, 2e-6], displacement_std=0, **BODY)
    for wrong in ({"displacement_std": -1e-8}, {"displacement_std": 0, "contact_modulus_std": -1e5}):
        with pytest.raises(InputError, match="must not be negative or NaN"):
            recover_shear_forces(table(0, 0, 2e-5), 1e-6, **BODY | wrong)
