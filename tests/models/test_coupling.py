"""Dense and fast sums agree, for every kernel and field; so do the solutions on both sides of the switch."""

import numpy as np
import pytest

from contactimg import generate_asperities, solve_interacting
from contactimg.models import contact_solver
from contactimg.models.coupling import (
    DenseCoupling,
    Kernel,
    NewtonSystem,
    NotPositiveDefinite,
    conjugate_gradients,
)
from contactimg.models.fast_coupling import CellPreconditioner, FastCoupling
from contactimg.models.scaled_problem import ScaledProblem
from contactimg.models.validity import close_pairs

ACCURACY = 1e-8  # sums are asked for to 1e-9 of the largest term


@pytest.fixture(scope="module")
def points():
    rng = np.random.default_rng(4)
    x, y = rng.random((2, 3000)) * np.array([[1.0], [0.6]])  # not square: swapped axes would show
    return x, y, rng.random(3000) * (rng.random(3000) < 0.4)


@pytest.mark.parametrize("thickness", [np.inf, 0.4, 0.05])
def test_displacements_agree(points, thickness):
    x, y, force = points
    kernel = Kernel.of_thickness(thickness)
    dense = DenseCoupling(x, y, kernel).displacement(force)
    fast = FastCoupling(x, y, kernel).displacement(force)
    np.testing.assert_allclose(fast, dense, atol=ACCURACY * np.abs(dense).max())


BORDERS = [None, 0.0, 0.3]  # by how much the sum of the forces is to rise, if the load is prescribed


@pytest.mark.parametrize("border", BORDERS)
def test_newton_systems_agree(points, border):
    x, y, force = points
    active = np.flatnonzero(force)
    scale = np.full(active.size, 0.002)  # definite down to a distance of 0.002^2/pi
    kernel = Kernel.of_thickness(np.inf)
    fast = FastCoupling(x, y, kernel)
    system = NewtonSystem(scale, np.sin(7 * x[active]), border)
    dense = DenseCoupling(x, y, kernel).solve_newton_system(active, system, 1e-10)
    few = fast.solve_newton_system(active, system, 1e-10)
    np.testing.assert_allclose(few[0], dense[0], atol=1e-9)
    np.testing.assert_allclose(few[1], dense[1], rtol=1e-9)
    everything = np.arange(x.size)
    system = NewtonSystem(np.full(x.size, 0.002), np.sin(7 * x), border)
    dense = DenseCoupling(x, y, kernel).solve_newton_system(everything, system, 1e-10)
    krylov = fast.solve_newton_system(everything, system, 1e-10)
    np.testing.assert_allclose(krylov[0], dense[0], atol=ACCURACY)
    np.testing.assert_allclose(krylov[1], dense[1], rtol=1e-7)


def test_indefinite_systems_are_noticed():
    kernel = Kernel.of_thickness(np.inf)
    close = DenseCoupling(np.array([0.0, 0.5]), np.zeros(2), kernel)
    # 2 a/(pi r) = 1 is the limit for two contacts: a = 0.785 at r = 0.5
    below, above = (np.sqrt(np.full(2, 2 * a)) for a in (0.78, 0.79))
    close.solve_newton_system(np.arange(2), NewtonSystem(below, below), 1e-10)
    with pytest.raises(NotPositiveDefinite):
        close.solve_newton_system(np.arange(2), NewtonSystem(above, above), 1e-10)


@pytest.mark.parametrize("border", BORDERS)
def test_many_contacts_by_conjugate_gradients_as_by_elimination(points, border):
    x, y, _ = (values[:200] for values in points)
    coupling = DenseCoupling(x, y, Kernel.of_thickness(np.inf))
    scale = 0.1 * np.sqrt(np.min(np.hypot(x[:, None] - x, y[:, None] - y) + np.eye(200), axis=1))
    matrix = np.eye(200) + scale[:, None] * coupling.matrix * scale
    system = NewtonSystem(scale, np.sin(7 * x), border)
    assert np.linalg.cond(matrix) < 100
    expected = bordered_solution(matrix, system)
    found = coupling.solve_newton_system(np.arange(200), system, 1e-10)
    rough = coupling.solve_newton_system(np.arange(200), system, 1e-3)
    function = conjugate_gradients(matrix.__matmul__, system, 1e-10, lambda side: side / np.diag(matrix))[:2]
    for solution, rise in (found, function):
        np.testing.assert_allclose(solution, expected[:-1], atol=1e-8 * np.abs(expected).max())
        np.testing.assert_allclose(rise, expected[-1], rtol=1e-8)
    assert not np.array_equal(found[0], rough[0])  # only as accurate as asked for


def bordered_solution(matrix, system):
    """``z`` and the rise, by elimination of the whole system."""
    if system.missing is None:
        return np.append(np.linalg.solve(matrix, system.side), 0.0)
    scale = system.scale
    whole = np.block([[matrix, -scale[:, None]], [scale[None, :], np.zeros((1, 1))]])
    return np.linalg.solve(whole, np.append(system.side, system.missing))


@pytest.mark.parametrize("radius", [0.78, 0.79])
def test_one_unstable_pair_among_many_contacts(radius):
    x = np.r_[0.0, 0.5, 100.0 * np.arange(1, 120)]
    everything, scale = np.arange(x.size), np.sqrt(np.r_[2 * radius, 2 * radius, np.full(119, 1e-3)])
    coupling = DenseCoupling(x, np.zeros_like(x), Kernel.of_thickness(np.inf))
    system = NewtonSystem(scale, np.r_[1.0, -1.0, np.ones(119)])
    if radius < np.pi / 4:  # 2 a/(pi r) = 1 is the limit for two contacts
        coupling.check_definite(everything, scale)
        coupling.solve_newton_system(everything, system, 1e-10)
        return
    with pytest.raises(NotPositiveDefinite):
        coupling.check_definite(everything, scale)
    with pytest.raises(NotPositiveDefinite):
        coupling.solve_newton_system(everything, system, 1e-10)


@pytest.mark.parametrize("coupling", ["asymptotic", "full"])
@pytest.mark.parametrize("thickness", [np.inf, 5e-3])
def test_solutions_agree_across_the_switch(coupling, thickness):
    table = generate_asperities("SA", side=4e-3, rng=np.random.default_rng(2))
    where = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (2e-3, 2e-3), "thickness": thickness}
    dense, fast = (
        solve_interacting(table, load=0.3, coupling=coupling, method=method, **where)
        for method in ("dense", "fast")
    )
    np.testing.assert_allclose(fast.force, dense.force, atol=ACCURACY * 0.3)
    assert fast.indentation == pytest.approx(dense.indentation, rel=ACCURACY)


def test_contacts_that_the_screening_missed_come_back(monkeypatch):
    table = generate_asperities("SA", side=4e-3, rng=np.random.default_rng(2))
    where = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (2e-3, 2e-3), "load": 0.3}
    dense = solve_interacting(table, method="dense", **where)
    monkeypatch.setattr(contact_solver, "SCREENING_RESIDUAL", np.inf)
    monkeypatch.setattr(contact_solver, "SCREENING_GAP_FRACTION", 0.0)
    sizes = []
    part = ScaledProblem.part

    def watched(self, rows):
        chosen = part(self, rows)
        sizes.append(chosen.gap.size)
        return chosen

    monkeypatch.setattr(ScaledProblem, "part", watched)
    fast = solve_interacting(table, method="fast", **where)
    # some were missed, and taken in
    assert sizes[1] < sizes[2], sizes
    np.testing.assert_allclose(fast.force, dense.force, atol=ACCURACY * 0.3)


@pytest.mark.slow
def test_switch_is_automatic_and_large_sets_converge():
    table = generate_asperities("SA", side=3e-2, rng=np.random.default_rng(2))
    where = {"indenter_radius": 5.0, "contact_modulus": 4e6, "apex": (1.5e-2, 1.5e-2), "load": 6.0}
    solution = solve_interacting(table, **where)
    assert len(table) > 16000
    assert solution.touching.size > 4000
    assert solution.residual <= 1e-12
    dense = solve_interacting(table, **{**where, "load": 0.3}, method="dense")
    fast = solve_interacting(table, **{**where, "load": 0.3}, method="fast")
    np.testing.assert_allclose(fast.force, dense.force, atol=ACCURACY * 0.3)


def test_rows_are_computed_when_they_are_needed_and_are_those_of_the_matrix(points):
    x, y, force = (values[:600] for values in points)
    force = np.where(np.arange(x.size) % 3 == 0, force, 0.0)
    r = np.hypot(x[:, None] - x, y[:, None] - y)
    np.fill_diagonal(r, np.inf)
    coupling = DenseCoupling(x, y, Kernel.of_thickness(np.inf))
    np.testing.assert_allclose(coupling.displacement(force), force @ (1 / (np.pi * r)), rtol=1e-13)
    assert coupling._known.sum() == np.count_nonzero(force)
    np.testing.assert_allclose(coupling.matrix, 1 / (np.pi * r), rtol=1e-15)
    assert coupling._known.all()
    own = np.linspace(1.0, 2.0, x.size)
    np.testing.assert_array_equal(
        DenseCoupling(x, y, Kernel.of_thickness(np.inf), own=own).matrix, coupling.matrix + np.diag(own)
    )


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_the_inverse_root_is_that_of_double_precision(unit):
    x = np.r_[0.0, unit * np.geomspace(1e-4, 1e6, 100)]
    matrix = DenseCoupling(x, np.zeros_like(x), Kernel.of_thickness(np.inf)).matrix
    np.testing.assert_allclose(matrix[0, 1:], 1 / (np.pi * x[1:]), rtol=4e-16)


def test_cells_take_the_large_eigenvalues_out_of_a_newton_system():
    """What many contacts share is solved on the cells: the rest is as near the identity on any extent."""
    rng = np.random.default_rng(5)
    kernel, largest = Kernel.of_thickness(np.inf), {}
    for side in (30, 60):  # contacts of radius 1 on a jittered lattice of 4 radii
        place = 4.0 * np.stack(np.meshgrid(np.arange(side // 2), np.arange(side // 2))).reshape(2, -1)
        x, y = place + rng.uniform(-0.5, 0.5, place.shape)
        scale = np.sqrt(2 * rng.uniform(0.8, 1.0, x.size))
        system = np.eye(x.size) + scale[:, None] * DenseCoupling(x, y, kernel).matrix * scale
        cells = CellPreconditioner.of(x, y, kernel, scale)
        columns = [cells(column) for column in system.T]
        conditioned = np.abs(np.linalg.eigvals(np.column_stack(columns)))
        largest[side] = np.linalg.eigvalsh(system)[-1], conditioned.max() / conditioned.min()
    assert largest[60][0] > 1.8 * largest[30][0] > 11
    assert max(ratio for _, ratio in largest.values()) < 6, largest


@pytest.mark.parametrize("spread", ["even", "a line", "a cluster", "unequal"])
def test_close_pairs_are_all_of_them(spread):
    rng = np.random.default_rng(3)
    x, y = rng.random((2, 400)) * {"a line": np.array([[1.0], [0.0]])}.get(spread, 1.0)
    reach = rng.uniform(0.02, 0.06, 400) * (rng.random(400) < 0.6)
    if spread == "a cluster":
        x, y = np.append(x * 1e-3, 1.0), np.append(y * 1e-3, 1.0)
        reach = 1e-3 * np.append(reach, 0.05)
    if spread == "unequal":
        reach[::50] *= 10
    i, j, distance = close_pairs(x, y, reach)
    apart, wanted = np.hypot(x[:, None] - x, y[:, None] - y), np.maximum(reach[:, None], reach)
    assert {(min(k), max(k)) for k in zip(i, j, strict=True)} == set(
        zip(*np.nonzero(np.triu(apart <= wanted, 1)), strict=True)
    )
    assert i.size == np.triu(apart <= wanted, 1).sum()
    assert np.all(reach[i] >= reach[j])
    np.testing.assert_allclose(distance, apart[i, j], rtol=1e-12)
