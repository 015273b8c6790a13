"""Commands whose forces, rims and averages are those of caps refuse a scene of other asperities."""

import pytest

from contactimg.errors import InputError
from contactimg.files import open_experiment, read_scene
from contactimg.pipeline.calibrate.threshold_scan import measure_thresholds
from contactimg.pipeline.effects import plan_effects
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import plan_simulation, simulate_series
from contactimg.pipeline.tradeoff import prepare_tradeoff
from contactimg.scene import scene_from_dict

POWER = {"profile_exponent": 4.0, "profile_width_m": 3e-5, "profile_drop_m": 4e-6}
POINTS = {"profile_points_m": [[0.0, 0.0], [1e-5, 1e-8], [2e-5, 8e-8], [4e-5, 4e-7]]}
COMMANDS = {
    "process": lambda scene, asperities: measure_series(scene, workers=1),
    "calibrate": lambda scene, asperities: measure_thresholds(open_experiment(scene), [0.5], workers=1),
    "simulate": lambda scene, asperities: next(simulate_series(scene, asperities)),
    "plan of simulate": plan_simulation,
    "effects": lambda scene, asperities: plan_effects(scene, load=0.02),
    "tradeoff": lambda scene, asperities: prepare_tradeoff(scene, load=0.02),
    "overlay": lambda scene, asperities: contact_sites(asperities, scene),
}


@pytest.mark.parametrize("profile", [POWER, POINTS], ids=["power law", "table"])
@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_made_for_caps_refuses_a_stated_profile(small_series, command, profile):
    plain = read_scene(small_series)
    data = {section: dict(keys) for section, keys in plain.source.items()}
    data["asperities"] = data["asperities"] | profile
    data["simulate"] = {"loads_N": [0.02], "shape": [64, 64]}
    scene = scene_from_dict(data, folder=plain.folder)
    with pytest.raises(InputError, match=r"states a profile, which only `predict` takes"):
        COMMANDS[command](scene, need_asperities(plain, "a test"))
