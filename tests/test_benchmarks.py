"""The ablation of the imaging replaces names of the package: they must exist."""

import importlib
from pathlib import Path

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


def test_the_ablation_replaces_names_that_exist(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    cases = importlib.import_module("imaging_ablation_cases")
    assert len(cases.CASES) > 40
    cases.check_names()
    points = importlib.import_module("imaging_ablation_points")
    cases.check_names(points.POINTS.values())
