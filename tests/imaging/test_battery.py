"""The battery of camera worlds: no frame is wrong and called "ok", and none is found worse than by counting.

A frame is right if the sum of the visible areas is within three of its stated standard uncertainties, 85 % of
the radii are within two of theirs, and recall and precision reach 0.95 (`benchmarks/imaging_battery.py`).
"""

import sys
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from camera_worlds import WORLDS, make_scene

from contactimg.imaging.measure import measure_image
from contactimg.imaging.profile.film_rim import FilmRim, FilmSetting
from contactimg.optics.film import Light

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from imaging_battery import BELOW, score

SEEDS = {25: 11, 140: 12}
"""None of those on which the engine was worked; with 140 contacts every third world: the benchmark has
all."""
CASES = [(name, 25) for name in WORLDS]
CASES += [pytest.param(name, 140, marks=pytest.mark.slow) for name in list(WORLDS)[::3]]


@cache
def measured(world, count):
    """The numbers of one frame, as the benchmark has them."""
    scene = make_scene(world, count, SEEDS[count])
    options = {"polarity": scene.polarity, "full_scale": scene.full_scale}
    result = measure_image(scene.frame, scene.reference, **options)
    assert result.status == "ok" or result.message
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # means over no contacts
        return score(scene, result, raw=False)


@pytest.mark.parametrize(("world", "count"), CASES)
def test_a_frame_is_right_or_says_that_it_is_not_and_is_found_no_worse_than_by_otsu(world, count):
    """No frame is wrong and called "ok", and none is found worse than by Otsu's threshold."""
    row = measured(world, count)
    shown = {name: row[name] for name in ("area", "area_z", "cover2", "recall", "precision", "odd_z")}
    assert row["verdict"] in ("right", "said"), shown
    assert row["f1"] >= row["f1_otsu"] - BELOW, shown


@pytest.mark.parametrize("light", ["laser", "white"])
def test_a_stated_film_makes_narrow_fringes_right(light):
    """Fringes that no pixel shows move the radii by 0.2 px, unless the scene says that there is a film."""
    scene = make_scene(f"Newton {light} 3 um", 25, SEEDS[25])
    width = {"laser": 3e-9, "white": 70e-9}[light]
    rim = FilmRim(Light(1.52, 1.41, 560e-9, width, (450e-9, 680e-9)), 100e-6, 3e-6)
    result = measure_image(scene.frame, scene.reference, polarity=scene.polarity, film=FilmSetting(rim, "on"))
    row = score(scene, result, raw=False)
    assert row["verdict"] == "right", (row["area_z"], row["cover2"])
    assert abs(row["bias"]) < 0.12 < abs(measured(f"Newton {light} 3 um", 25)["bias"])


def test_an_unseen_film_is_allowed_for_unless_it_is_known_to_be_absent():
    """Fringes that no pixel shows are within the error stated for all edges; whoever has no film drops it."""
    scene = make_scene("Newton laser 3 um", 25, SEEDS[25])
    unknown, absent = (
        measure_image(scene.frame, scene.reference, polarity=scene.polarity, absent=names).disks
        for names in ((), ("film",))
    )
    assert unknown["radius_px"].equals(absent["radius_px"])
    bias = measured("Newton laser 3 um", 25)["bias"]
    assert 2.0 * absent["edge_shift_px"].median() < bias < 2.0 * unknown["edge_shift_px"].median()
