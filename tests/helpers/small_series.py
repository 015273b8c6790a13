"""A small synthetic series, processed in a fraction of a second: 2 mm, 70 asperities, three loads."""

import shutil
from pathlib import Path

import numpy as np

import contactimg.effects.render_without as optics_module
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict

SCENE = {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.001, 0.001]},
    "elastic": {"young_modulus_Pa": 3.0e6, "young_modulus_std_Pa": 0.03e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.002, "seed": 3},
    "camera": {"pixel_size_m": 6.0e-6, "linearity": 0.0},
    "effects": {"model": "paper", "film": "off"},  # to look for one takes half of the time
    "measure": {"film_doubt": 0.0},  # what is rendered is known
    "tolerance": {"output": "area"},
    "simulate": {
        "loads_N": [0.005, 0.02, 0.05],
        "shape": [340, 360],
        "blur_px": 1.4,
        "texture": 0.02,
        "light_drift": 0.02,
        "position_drift_px": 0.3,
        "electrons_per_level": 20,
        "read_noise_electrons": 10,
        "seed": 7,
    },
}

TINY = SCENE | {
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0004, 0.0003]},
    "asperities": SCENE["asperities"] | {"side_m": 0.0008},
    "simulate": SCENE["simulate"] | {"loads_N": [0.002, 0.004, 0.008], "shape": [90, 120]},
}
"""Three frames of 120 x 90 pixels, for runs that are repeated often."""


def write_small_series(folder: Path, scene: dict = SCENE, **simulate) -> Path:
    """Write the series of a scene, with other keys of [simulate], into a new folder."""
    folder.mkdir(parents=True)
    described = scene_from_dict(scene | {"simulate": scene["simulate"] | simulate})
    write_simulation(described, need_asperities(described, "a test"), folder)
    return folder


def copy_of(folder: Path, target: Path) -> Path:
    """A copy that a test may spoil."""
    shutil.copytree(folder, target)
    return target


def break_measurement(monkeypatch) -> None:
    """Let the measurement break on images whose brightest pixel is 7."""
    measure = optics_module.measure_image

    def breaking(image, *arguments, **options):
        if image.max() == 7:
            raise np.linalg.LinAlgError("singular")
        return measure(image, *arguments, **options)

    monkeypatch.setattr(optics_module, "measure_image", breaking)
