"""Ensembles of a scene: averages of the single patterns, resumed and shared without changing a bit."""

import numpy as np
import pandas as pd
import pytest
from local_cluster import files_of

from contactimg.cli import main
from contactimg.pipeline import predict as ensemble_module
from contactimg.pipeline.inputs import generated_asperities
from contactimg.pipeline.predict import Ensemble, predict_ensemble
from contactimg.prediction import predict_contacts
from contactimg.scene import scene_from_dict

SIDE, LOADS, PATTERNS = 0.002, (0.005, 0.02), 5
SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0007, 0.0012]},  # not the middle
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": SIDE, "seed": 3},
}
TEXT = """
[indenter]
radius_m = 0.1288
apex_m = [0.0007, 0.0012]
[elastic]
young_modulus_Pa = 3.0e6
[asperities]
generate = "SA"
coverage = 0.4
side_m = 0.002
seed = 3
"""


@pytest.fixture(scope="module")
def scene():
    return scene_from_dict(SCENE)


def test_averages_are_those_of_the_single_patterns(scene):
    found = predict_ensemble(scene, LOADS, patterns=PATTERNS, coupling="asymptotic", annulus=2.5e-4)
    for load, prediction in zip(LOADS, found, strict=True):
        own = [
            predict_contacts(scene, generated_asperities(scene, k), load=load, coupling="asymptotic")
            for k in range(PATTERNS)
        ]
        area = np.array([one.frames["area_m2"].iloc[0] for one in own])
        row = prediction.frames.iloc[0]
        assert row["status"] == "ok"
        assert row["area_m2"] == pytest.approx(area.mean(), rel=1e-12)
        assert row["area_std_m2"] == pytest.approx(area.std(ddof=1) / np.sqrt(PATTERNS), rel=1e-6)
        assert row["force_sum_N"] == pytest.approx(load, rel=1e-9)
        pressures = pd.concat([one.profile for one in own]).groupby("r_m")["pressure_Pa"].sum() / PATTERNS
        mean = prediction.profile.set_index("r_m")["pressure_Pa"]
        pd.testing.assert_series_equal(mean, pressures.reindex(mean.index), rtol=1e-10)
        assert len(mean) == len(pressures)


def test_the_place_of_the_indenter_counts(scene):
    """At a corner a quarter of the pattern lies under the lens, so that its summits carry more each."""
    corner = scene_from_dict(SCENE | {"indenter": {"radius_m": 0.1288, "apex_m": [0.0, 0.0]}})
    inside, outside = (
        predict_ensemble(one, LOADS[1:], patterns=4, coupling="none", annulus=2.5e-4)[0].frames.iloc[0]
        for one in (scene, corner)
    )
    assert outside["indentation_m"] > inside["indentation_m"]
    assert outside["area_m2"] < inside["area_m2"]


def run(folder, out, *options):
    words = ["predict", str(folder), "--load-N", "0.005", "--load-N", "0.02", "--patterns", str(PATTERNS)]
    return main([*words, "-o", str(out), "--quiet", *options])


def test_a_run_that_was_ended_goes_on(tmp_path, monkeypatch, capfd):
    (tmp_path / "scene.toml").write_text(TEXT)
    solve, solved = Ensemble.solve, []

    def ended(self, index):
        if index == 3:
            raise KeyboardInterrupt
        return solve(self, index)

    def counted(self, index):
        solved.append(index)
        return solve(self, index)

    monkeypatch.setattr(ensemble_module.Ensemble, "solve", ended)
    assert run(tmp_path, tmp_path / "out") != 0
    monkeypatch.setattr(ensemble_module.Ensemble, "solve", counted)
    assert run(tmp_path, tmp_path / "out") == 0
    assert "3 of 5 patterns were done by a run that was ended" in capfd.readouterr().err
    assert solved == [3, 4]
    monkeypatch.undo()
    assert run(tmp_path, tmp_path / "whole") == 0
    assert files_of(tmp_path / "out") == files_of(tmp_path / "whole")


def test_patterns_without_a_solution_are_counted(scene, monkeypatch):
    solve = Ensemble.solve

    def some(self, index):
        return ["no answer"] * len(self.loads) if index < 2 else solve(self, index)

    monkeypatch.setattr(ensemble_module.Ensemble, "solve", some)
    row = predict_ensemble(scene, LOADS[:1], patterns=4, coupling="none", annulus=2.5e-4)[0].frames.iloc[0]
    assert row["status"] == "approximate"
    assert "average over 2 random patterns" in row["message"]
    assert "2 patterns without a solution are left out: no answer" in row["message"]


def test_refusals(tmp_path, capfd):
    (tmp_path / "scene.toml").write_text(TEXT)
    assert run(tmp_path, tmp_path / "out", "--model", "gt") == 2
    assert "is an average over patterns itself" in capfd.readouterr().err
    (tmp_path / "scene.toml").write_text(TEXT.split("[asperities]", maxsplit=1)[0])
    assert run(tmp_path, tmp_path / "out") == 2
    assert "an ensemble needs random patterns: state generate" in capfd.readouterr().err
