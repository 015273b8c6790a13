"""The work of one solution is bounded: loads beyond any model are refused at once, others in time."""

import numpy as np
import pytest

from contactimg import ConvergenceError, InputError, ModelRangeError, generate_asperities, solve_interacting
from contactimg.models.fast_coupling import FastCoupling
from contactimg.models.work_limit import MAX_TERMS_VARIABLE, count_terms, limit_work

SIDE, LENS = 0.03, 1e5


@pytest.fixture(scope="module")
def pattern():
    """Twelve thousand caps: too many for a stored matrix."""
    return generate_asperities("SA", side=SIDE, coverage=0.3, rng=np.random.default_rng(5))


def solve(pattern, load, **options):
    middle = (SIDE / 2, SIDE / 2)
    return solve_interacting(
        pattern, indenter_radius=LENS, contact_modulus=4e6, load=load, apex=middle, **options
    )


def test_a_load_at_which_most_contacts_overlap_is_refused_at_once(pattern, monkeypatch):
    """Half the modulus as mean pressure: 2300 sums and a minute before, for contacts that would merge."""
    sums = []
    exact = FastCoupling.displacement
    monkeypatch.setattr(FastCoupling, "displacement", lambda *a: sums.append(1) or exact(*a))
    with pytest.raises(ModelRangeError, match="would overlap a neighbour") as refused:
        solve(pattern, 0.5 * 4e6 * SIDE**2)
    assert len(sums) <= 2
    bearable = float(str(refused.value).split("to some ")[1].split(" N")[0])
    assert 0.05 < bearable / (4e6 * SIDE**2) < 0.5
    assert solve(pattern, 0.3 * bearable).status == "converged"


def test_terms_beyond_the_limit_are_refused_and_the_limit_can_be_raised(pattern, monkeypatch):
    load = 0.01 * 4e6 * SIDE**2
    monkeypatch.setenv(MAX_TERMS_VARIABLE, "1e5")
    with pytest.raises(ConvergenceError, match=f"set {MAX_TERMS_VARIABLE} to a larger number"):
        solve(pattern, load)
    monkeypatch.setenv(MAX_TERMS_VARIABLE, "1e7")
    assert solve(pattern, load).status == "converged"


def test_a_stored_matrix_counts_as_well(pattern, monkeypatch):
    monkeypatch.setenv(MAX_TERMS_VARIABLE, "10")
    with pytest.raises(ConvergenceError, match="terms of the coupling sums"):
        solve(pattern[:500], 1.0)


def test_terms_count_within_a_solution_only():
    count_terms(1e30)
    with limit_work(), pytest.raises(ConvergenceError):
        count_terms(1e30)


@pytest.mark.parametrize("stated", ["many", "0", "-3", "nan"])
def test_a_limit_that_is_no_number_is_refused(pattern, monkeypatch, stated):
    monkeypatch.setenv(MAX_TERMS_VARIABLE, stated)
    with pytest.raises(InputError, match=MAX_TERMS_VARIABLE):
        solve(pattern, 1.0)
