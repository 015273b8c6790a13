"""The air film is worth a sentence where it changes an area beyond the uncertainty, and none elsewhere."""

import pandas as pd
import pytest

from contactimg.cli.folders import _film_sentence


@pytest.mark.parametrize(
    ("change", "doubt", "said"), [(-0.03, 0.4, True), (-0.008, 0.4, False), (-0.03, 1e-9, False)]
)
def test_only_a_change_beyond_the_uncertainty_is_said(change, doubt, said):
    frames = pd.DataFrame({"frame": ["a"], "area_m2": [1e-7], "area_std_m2": [1e-9]})  # 1 %
    films = {"a": {"area_change": change, "doubt": doubt, "taken": False}}
    assert bool(_film_sentence(frames, films)) is said
