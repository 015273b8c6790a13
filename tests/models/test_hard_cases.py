"""The hard cases hold, their stored truths are found again, and a wrong answer is seen."""

import numpy as np
import pytest
from hard_problems import ALL_CASES, GROUPS, LAYER_FORCES

from contactimg.cli import main
from contactimg.errors import ModelRangeError
from contactimg.models import hard_cases
from contactimg.models.hard_cases import CASES, LAYER_FORCE, MODULUS, PAIR_AREA, Outcome, run_cases

MANY = [name for name in ALL_CASES if name.startswith("pattern of")]


@pytest.mark.parametrize("name", [name for name in ALL_CASES if name not in MANY])
def test_hard_case(name):
    outcome = ALL_CASES[name]()
    assert outcome.passed, outcome


@pytest.mark.slow
def test_a_hundred_thousand_caps():
    assert ALL_CASES[MANY[0]]().passed


def test_self_test_prints_a_table_and_its_exit_code_says_whether_all_hold(monkeypatch, capsys):
    some = dict(list(CASES.items())[:4])
    monkeypatch.setattr(hard_cases, "CASES", some)
    assert main(["selftest"]) == 0
    assert "4 of 4 hold" in capsys.readouterr().out

    def refuse():
        raise ModelRangeError("it cannot be solved; lower the load")

    for wrong in (
        refuse,
        lambda: Outcome("converged", 1e-3, 1e-9, "closed form"),
        lambda: Outcome("approximate", np.nan, 0.0, ""),
    ):
        monkeypatch.setattr(hard_cases, "CASES", some | {"wrong": wrong})
        assert main(["selftest"]) == 1
        assert "4 of 5 hold, 1 do not" in capsys.readouterr().out


@pytest.mark.parametrize("words", ["planes touch", "no such words"])
def test_a_refusal_must_say_why(words):
    def refuse():
        raise ModelRangeError("the planes touch; lower the load")

    assert hard_cases.refused(refuse, words, "").passed == (words == "planes touch")
    assert not hard_cases.refused(lambda: None, words, "").passed


def test_a_changed_law_is_seen(monkeypatch):
    """The sums one by one know nothing of the solver: a modulus that is off by 1e-6 fails."""
    monkeypatch.setitem(hard_cases.FLAT, "contact_modulus", MODULUS * (1 + 1e-6))
    some = {name: CASES[name] for name in ("one cap, Hertz, 0.001 N", "SA+ of 10 mm under a lens, 1 N")}
    assert run_cases(some)["passed"].tolist() == [False, False]


def test_the_self_test_compares_with_the_stored_solutions():
    assert (LAYER_FORCES[2e-5, 0.5, 4e-6], GROUPS[2, 2.1]) == (LAYER_FORCE, PAIR_AREA)


@pytest.mark.parametrize("key", LAYER_FORCES, ids=str)
def test_stored_forces_on_layers_are_those_of_boundary_elements(key):
    from test_layer_law import boundary_elements

    thickness, ratio, depth = key
    found = MODULUS * boundary_elements(depth, thickness, ratio, count=300)
    assert found == pytest.approx(LAYER_FORCES[key], rel=2e-5)  # 300 rings instead of 800


@pytest.mark.slow
def test_a_stored_area_of_groups_is_a_spectral_solution():
    from spectral_contacts import CapProblem, solve_caps

    count, distance = key = 2, 2.1
    a = 0.02
    place = a * distance * np.arange(2).astype(complex)
    load = count * 4 / 3 * a**3

    def gap(row, x, y):
        return ((x - place[row].real) ** 2 + (y - place[row].imag) ** 2) / 2

    start = np.full(count, load / count), np.full(count, a)
    answer = solve_caps(CapProblem(gap, place, load, 1.3 * a**2), *start, degree=8)
    assert answer.area.sum() == pytest.approx(GROUPS[key], rel=1e-6)
