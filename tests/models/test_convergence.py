"""Solvers prove their answer: converged means checked on the final numbers; anything else is said."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from model_cases import draw_case, verdict

from contactimg import (
    ContactimgError,
    ConvergenceError,
    GaussianHeights,
    InputError,
    ModelRangeError,
    generate_asperities,
    jkr,
    solve_adhesive,
    solve_greenwood_tripp,
    solve_greenwood_williamson,
    solve_interacting,
)
from contactimg.models import adhesive
from contactimg.models.convergence import CONVERGED, MAX_RELATIVE_ERROR, check_finite, judge
from contactimg.models.dense_balance import BalanceEquations
from contactimg.models.greenwood_williamson import ring_weights
from contactimg.models.scaled_problem import ScaledProblem
from contactimg.surfaces import GaussianCaps, UniformCaps

FLAT = {"indenter_radius": np.inf, "contact_modulus": 4e6}
LENS = {"indenter_radius": 0.1288, "contact_modulus": 4e6, "apex": (1.5e-3, 1.5e-3)}


def caps(x, y=0.0, height=4e-5, radius=1e-4):
    x = np.asarray(x, dtype=float)
    columns = {"x_m": x, "y_m": y, "height_m": height, "radius_m": radius}
    return pd.DataFrame({name: np.broadcast_to(np.asarray(v, float), x.shape) for name, v in columns.items()})


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32))
def test_random_problems_are_solved_or_refused(seed):
    outcome, why = verdict(draw_case(np.random.default_rng(seed)))
    assert outcome != "FAULT", why


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    load=st.floats(-15, 3),
    modulus=st.floats(-3, 9),
    size=st.floats(-8, 1),
    coupling=st.sampled_from(["none", "asymptotic", "hertz", "full"]),
    law=st.sampled_from(["hertz", "sphere"]),
)
def test_one_asperity_of_any_scale_bears_its_load(load, modulus, size, coupling, law):
    table = caps([0.0], height=0.4 * 10**size, radius=10**size)
    arguments = {"indenter_radius": np.inf, "contact_modulus": 10**modulus, "coupling": coupling, "law": law}
    solution = solve_interacting(table, load=10**load, **arguments)
    assert solution.status == CONVERGED
    assert solution.load == pytest.approx(10**load, rel=MAX_RELATIVE_ERROR)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    work=st.floats(-9, 1),
    pull=st.floats(-0.95, 1e3).filter(lambda pull: abs(pull) > 1e-3),
    modulus=st.floats(4, 9),
    size=st.floats(-8, 0),
)
def test_one_adhesive_asperity_of_any_scale_is_jkr(work, pull, modulus, size):
    R, E, w = 10**size, 10**modulus, 10**work
    load = pull * 1.5 * np.pi * w * R
    table = caps([0.0], height=0.4 * R, radius=R)
    solution = solve_adhesive(table, load=load, work_of_adhesion=w, indenter_radius=np.inf, contact_modulus=E)
    assert solution.status == CONVERGED
    assert solution.load == pytest.approx(load, rel=MAX_RELATIVE_ERROR)
    radius = float(jkr.radius(load, sphere_radius=R, contact_modulus=E, work_of_adhesion=w))
    # near pull-off the radius goes as the root of the load's error: sqrt(1e-8/0.05) at 0.95 of it
    assert solution.radius[0] == pytest.approx(radius, rel=1e-3)


# what used to be called converged, or to fail without a sentence


def test_a_load_that_no_contact_bears_is_not_called_converged():
    table = caps(
        [1.22e-7, 9.56e-9, 4.37e-7],
        height=[8.66e-8, 8.66e-10, 8.66e-10],
        radius=[1.65e-8, 2.85e-11, 8.44e-10],
    )
    with pytest.raises(ContactimgError):
        solve_adhesive(
            table,
            indenter_radius=3.69e-6,
            contact_modulus=1.74e6,
            apex=(1.9e-7, 0.0),
            thickness=9.24e-12,
            work_of_adhesion=0.27,
            load=1.8e-16,
        )


@pytest.mark.parametrize("coupling", ["none", "asymptotic"])
@pytest.mark.parametrize("load", [1e-16, 1e-13, 1e-9])
def test_loads_far_below_the_adhesive_forces_are_balanced_or_stated(coupling, load):
    table = caps([0.0, 3e-4, 7e-4], height=[4e-5, 3.9e-5, 3.99e-5])
    solution = solve_adhesive(table, load=load, coupling=coupling, work_of_adhesion=0.05, **FLAT)
    if solution.status == CONVERGED:
        assert solution.load == pytest.approx(load, rel=MAX_RELATIVE_ERROR)
    else:
        assert load < 1e-12
        assert "below the accuracy of the adhesive forces" in solution.status


@pytest.mark.parametrize("law", ["hertz", "sphere"])
def test_coincident_adhesive_asperities_are_named(law):
    table = caps([1e-3, 0, 0])
    with pytest.raises(ModelRangeError, match="rows 1 and 2 are at the same place"):
        solve_adhesive(table, load=1e-3, law=law, work_of_adhesion=0.05, **FLAT)
    alone = solve_adhesive(table, load=1e-3, coupling="none", law=law, work_of_adhesion=0.05, **FLAT)
    assert alone.status == CONVERGED


def test_a_crowd_of_adhesive_contacts_is_refused_quickly():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 1.7e-9, (2, 300))
    table = caps(x, y, 5.5e-10, 10 ** rng.uniform(-11, -6, 300))
    with pytest.raises(ContactimgError, match=r"lower the load or merge|would overlap"):
        solve_adhesive(table, load=0.0, work_of_adhesion=7e-9, **FLAT)


def test_an_absurd_load_on_many_asperities_is_refused_quickly():
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 1e-2, (2, 5000))
    with pytest.raises(ModelRangeError, match="of 5000 contacts would overlap a neighbour"):
        solve_interacting(caps(x, y, rng.uniform(3e-5, 6e-5, 5000)), load=1e12, **FLAT)


@pytest.mark.parametrize("law", ["hertz", "sphere"])
@pytest.mark.parametrize("load", [2e-15, 1e-12])
def test_radii_over_twelve_decades_bear_a_tiny_load(law, load):
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 1e-2, (2, 60))
    table = caps(x, y, rng.uniform(3e-5, 6e-5, 60), 10 ** rng.uniform(-10, 2, 60))
    for coupling in ("none", "asymptotic"):
        solution = solve_interacting(table, load=load, coupling=coupling, law=law, **FLAT)
        assert solution.status == CONVERGED
        assert solution.load == pytest.approx(load, rel=MAX_RELATIVE_ERROR)


def test_arguments_outside_the_range_are_refused_with_it():
    table = caps([0.0])
    for options, text in (
        ({"load": 1e-70}, "load must lie between 1e-60 and 1e"),
        ({"load": 1.0, "contact_modulus": 1e200}, "contact_modulus must lie between"),
        ({"indentation": 1e300}, "indentation must lie between"),
        ({"load": 1.0, "thickness": 1e-200}, "thickness must lie between"),
    ):
        with pytest.raises(ModelRangeError, match=text):
            solve_interacting(table, **{**FLAT, **options})
    with pytest.raises(ModelRangeError, match="work_of_adhesion must lie between"):
        solve_adhesive(table, load=1.0, work_of_adhesion=1e-200, **FLAT)
    for column in ("x_m", "height_m", "radius_m"):
        with pytest.raises(InputError, match=f"column '{column}' must be a length up to"):
            solve_interacting(table.assign(**{column: 1e170}), load=1.0, **FLAT)
    far = solve_interacting(table, indenter_radius=1e250, contact_modulus=4e6, load=1e-3)
    assert far.status == CONVERGED


@pytest.mark.parametrize("solve", [solve_greenwood_williamson, solve_greenwood_tripp])
def test_statistical_models_over_many_decades(solve):
    heights = GaussianHeights(0.0, 3e-6)
    where = {"density": 18e6, "radius": 1e-4, "indenter_radius": 0.1288, "contact_modulus": 4e6}
    for load in (1e-6, 1.0, 1e3):
        solution = solve(heights, load=load, **where)
        assert solution.status == CONVERGED
        # a closed form and its discretisation on 400 rings, or equal by construction
        assert ring_weights(solution.r) @ solution.pressure == pytest.approx(load, rel=1e-4)
    for changed, text in (
        ({"load": 1e-70}, "load must lie between"),
        ({"indenter_radius": 1e200}, "indenter_radius must lie between"),
    ):
        with pytest.raises(ModelRangeError, match=text):
            solve(heights, **{"load": 1.0, **where, **changed})


def test_a_pattern_of_too_many_caps_is_refused_before_it_is_drawn(rng):
    with pytest.raises(InputError, match=r"would have .* caps, more than max_caps = 2000000"):
        generate_asperities("SA", side=1.0, rng=rng)
    with pytest.raises(InputError, match="more than max_caps = 10"):
        generate_asperities("SA", side=2e-3, max_caps=10, rng=rng)
    with pytest.raises(InputError, match="side must lie between"):
        generate_asperities(UniformCaps(1e-6, 2e-6, radius=1e-5), side=1e-40, coverage=0.1, rng=rng)
    narrow = GaussianCaps(9.9e-5, 1e-9, radius_mean=1e-4, radius_std=1e-10)
    assert len(generate_asperities(narrow, side=2e-3, coverage=0.1, rng=rng))
    impossible = GaussianCaps(1e-6, 1e-4, radius_mean=1.1e-6, radius_std=1e-9)
    with pytest.raises(InputError, match="hardly ever exceed the heights"):
        generate_asperities(impossible, side=2e-3, coverage=0.1, rng=rng)


# the checks themselves: each must be able to fail


def test_each_check_can_fail():
    with pytest.raises(ModelRangeError, match="force of the solution is inf"):
        check_finite({"indentation": 1.0, "force": np.array([1.0, np.inf])})
    assert judge({"load": 1e-7, "depths": 0.0}, 1e-12) == CONVERGED
    assert "load has a relative error of 0.001" in judge({"load": 1e-3, "depths": 0.0}, 1e-2)
    for error in (2e-6, np.nan, np.inf):
        with pytest.raises(ConvergenceError, match="depths of the solution has a relative error"):
            judge({"load": 0.0, "depths": error}, 1e-12)


@pytest.mark.parametrize("quantity", ["force", "radius", "indentation"])
def test_a_wrong_number_is_noticed(monkeypatch, quantity):
    """Change one number of the record: the recomputation must disagree."""
    record = ScaledProblem.record

    def wrong(self, *args, **keywords):
        solution = record(self, *args, **keywords)
        value = getattr(solution, quantity)
        if quantity == "radius":
            return replace(solution, radius=np.where(np.arange(value.size) == value.argmax(), 0.0, value))
        return replace(solution, **{quantity: value * (1 + 1e-5)})

    monkeypatch.setattr(ScaledProblem, "record", wrong)
    table = generate_asperities("SA", side=3e-3, rng=np.random.default_rng(6))
    for coupling in ("none", "asymptotic", "full"):
        with pytest.raises(ConvergenceError):
            solve_interacting(table, load=0.05, coupling=coupling, **LENS)


def test_a_loose_tolerance_is_stated():
    table = generate_asperities("SA", side=3e-3, rng=np.random.default_rng(6))
    solution = solve_interacting(table, load=0.05, tolerance=0.05, **LENS)
    assert solution.residual > 1e-5
    assert solution.status.startswith("within the tolerance of 0.05 only")


def test_newton_steps_of_all_field_updates_are_bounded_together(monkeypatch):
    # 300 caps of radii over many decades under full coupling: 72,000 steps before they were counted together
    most, taken = 100, []
    monkeypatch.setattr(adhesive, "MAX_TOTAL_STEPS", most)
    direction = BalanceEquations.direction
    monkeypatch.setattr(BalanceEquations, "direction", lambda *given: taken.append(1) or direction(*given))
    case = draw_case(np.random.default_rng([2026112388, 4794]))
    outcome, why = verdict(case)
    assert outcome == "refused"
    assert f"no contacts were found in equilibrium in {most} Newton steps" in why
    # of each set of contacts that breaks, one direction more than steps is tried
    assert len(taken) < most + 2 * len(case.table)


@pytest.mark.parametrize("kind", [np.float32, np.float16, lambda load: np.array([load])])
def test_loads_of_other_types_are_solved_in_double_precision(kind):
    load, table = kind(0.25), caps([0.0, 3e-4])
    expected = solve_interacting(table, load=0.25, **FLAT)
    assert solve_interacting(table, load=load, **FLAT).indentation == expected.indentation
    averaged = {"density": 1.8e7, "radius": 1e-4, "indenter_radius": 0.1288, "contact_modulus": 4e6}
    heights = GaussianHeights(0.0, 6e-6)
    for solve in (solve_greenwood_tripp, solve_greenwood_williamson):
        assert solve(heights, load=load, **averaged).area == solve(heights, load=0.25, **averaged).area
