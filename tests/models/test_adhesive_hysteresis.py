"""Loading and unloading of adhesive asperities against a minimisation of their energy; what cycles lose."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize

from contactimg import solve_adhesive, solve_adhesive_path

E, W = 4e6, 0.05
FLAT = {"indenter_radius": np.inf, "contact_modulus": E, "work_of_adhesion": W}
R = np.array([1.0, 0.8, 1.3, 1.0, 0.6]) * 1e-4
X = np.array([0.0, 1.0, 2.1, 0.4, 1.5]) * 1e-4
Y = np.array([0.0, 0.3, -0.2, 1.0, 1.2]) * 1e-4
GAP = np.array([0.0, 0.9, 0.6, 1.9, 1.4]) * 1e-6
TABLE = pd.DataFrame({"x_m": X, "y_m": Y, "height_m": 4e-5 - GAP, "radius_m": R})


def energy(logs, rows, load):
    """Total energy of contacts of given radii under a load, and penetrations of all asperities.

    At given radii the contacts are linear: p_i = 2 E* (a_i delta_i - a_i^3/(3 R_i)), delta = D - g - C p.
    """
    a, r, g = np.exp(logs), R[rows], GAP[rows]
    distance = np.hypot(X[:, None] - X, Y[:, None] - Y)
    compliance = 1 / (np.pi * E * np.where(distance > 0, distance, np.inf))
    inner = compliance[np.ix_(rows, rows)]
    n = a.size
    matrix = np.zeros((n + 1, n + 1))
    matrix[:n, :n] = np.eye(n) + 2 * E * a[:, None] * inner
    matrix[:n, n] = -2 * E * a
    matrix[n, :n] = 1
    right = np.append(2 * E * (-a * g - a**3 / (3 * r)), load)
    scale = 2 * E * a.mean()
    matrix[:, n] /= scale
    *force, depth = np.linalg.solve(matrix, right)
    force, depth = np.array(force), depth / scale
    delta = depth - g - inner @ force
    own = E * (a * delta**2 - 2 * a**3 * delta / (3 * r) + a**5 / (5 * r**2))
    total = own.sum() + 0.5 * force @ inner @ force - np.pi * W * np.sum(a**2) - load * depth
    return total, depth - GAP - compliance[:, rows] @ force


def scaled_energy(logs, rows, load):
    """The energy in units of the work of adhesion of a square of 10 um."""
    return energy(logs, rows, load)[0] / (W * 1e-10)


def settle(radius, load):
    """Slide down to the nearest local minimum; contacts that vanish break, asperities that overlap touch."""
    rows, logs = np.flatnonzero(radius), np.log(radius[radius > 0])
    for _ in range(20):
        found = minimize(scaled_energy, logs, (rows, load), method="BFGS", options={"gtol": 1e-7})
        logs = found.x
        alive = np.exp(logs) > 1e-7
        if not alive.all():
            rows, logs = rows[alive], logs[alive]
            continue
        overlap = energy(logs, rows, load)[1]
        overlap[rows] = -1
        new = np.flatnonzero(overlap > 0)
        if not new.size:
            result = np.zeros(R.size)
            result[rows] = np.exp(logs)
            return result
        rows = np.append(rows, new)
        logs = np.append(logs, np.log(np.cbrt(2 * np.pi * W * R[new] ** 2 / E)))
        order = np.argsort(rows)
        rows, logs = rows[order], logs[order]
    raise AssertionError("no minimum")


def test_both_branches_are_the_local_minima_of_the_energy():
    loads = [5e-5, 2e-4, 6e-4, 2e-4, 5e-5, -1e-5]
    radius = solve_adhesive(TABLE, load=loads[0], **FLAT).radius
    sums = []
    for load, solution in zip(loads, solve_adhesive_path(TABLE, loads=loads, **FLAT), strict=True):
        radius = settle(radius, load)
        # gradients by differences of 1e-8: energies are flat to 1e-16, radii to some 1e-5
        np.testing.assert_allclose(solution.radius, radius, rtol=3e-4)
        sums.append(solution.area)
    # the branches differ: more area on the way down
    assert sums[4] > 1.05 * sums[0]


def test_pull_off_under_a_load_is_three_halves_pi_w_r():
    one = TABLE.iloc[:1]
    pull = 1.5 * np.pi * W * R[0]
    *_, held = solve_adhesive_path(one, loads=[1e-3, 0.0, -0.99999 * pull], **FLAT)
    assert held.radius[0] > 0
    with pytest.raises(Exception, match="pull-off"):
        list(solve_adhesive_path(one, loads=[1e-3, 0.0, -1.00001 * pull], **FLAT))


def test_a_cycle_loses_the_sum_of_the_losses_of_its_contacts():
    depths = np.concatenate([np.linspace(-6e-7, 1.2e-6, 300), np.linspace(1.2e-6, -6e-7, 300)])
    # energy of the contact: -(3/10) E* a^5/R^2 after jump-in at depth 0, (16/5) E* a^5/R^2 before pull-off;
    # a^3 = 2 pi w R^2/E* times 1 and 1/16
    both = 0.3 + 3.2 * 16 ** (-5 / 3)
    losses = [both * (2 * np.pi * W) ** (5 / 3) * r ** (4 / 3) / E ** (2 / 3) for r in R[:3]]
    loads, previous = [], None
    for depth in depths:
        previous = solve_adhesive(TABLE.iloc[:3], indentation=depth, start=previous, coupling="none", **FLAT)
        loads.append(previous.load)
    # three jumps in and three off of about 2e-5 N, each located to half a step of 6 nm
    work = np.trapezoid(loads, depths)
    assert work == pytest.approx(sum(losses), abs=6 * 2e-5 * 3e-9)
    assert sum(losses) > 2e-11
