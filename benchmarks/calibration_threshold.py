"""Closed loops of threshold and modulus: calibrate on one sample, measure a second one made elsewhere.

Both samples are rendered with a modulus of their own; the analysis of the first knows it, that of the second
starts from one that is 4 % off. Each line renders both with something the pixel count knows nothing of.

    python benchmarks/run.py calibration_threshold.closed_loop --seed 1 --side-mm 10
"""

import tempfile
from pathlib import Path

import pandas as pd
from shared import PIXEL, pattern_scene

from contactimg.analysis.estimates import CoverageEstimate
from contactimg.calibration.threshold_and_modulus import load_slope
from contactimg.files import open_experiment, read_scene
from contactimg.pipeline.calibrate.thresholds import run_modulus, run_threshold
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import Scene, scene_from_dict

TRUE = (2.6e6, 3.3e6)
"""Moduli of the two samples, Pa."""
RENDERED = {
    "matched": {},
    "20 % of the light in a wide halo": {"psf": "halo"},
    "Airy PSF": {"psf": "airy"},
    "5 % brightness spread": {"brightness_spread": 0.05},
    "half the contrast": {"contrast_levels": 50.0},
    "air film": {"film": True},
}


def make_sample(folder: Path, modulus: float, seed: int, side: float, changes: dict) -> None:
    """Render a sample's frames."""
    changes = dict(changes)
    film = changes.pop("film", False)
    columns = min(1600, int(side / PIXEL * 1.1))
    scene = pattern_scene(
        seed,
        side=side,
        modulus=modulus,
        effects={"film": "on" if film else "auto"},
        loads_N=[0.02, 0.05, 0.1, 0.2, 0.4],
        shape=[min(1200, columns), columns],
        **changes,
    )
    folder.mkdir()
    write_simulation(scene, need_asperities(scene, "a benchmark"), folder)


def scene_with(folder: Path, modulus: float, std: float, **measure: object) -> Scene:
    """The folder's scene with another modulus and way to measure."""
    data = {section: dict(keys) for section, keys in read_scene(folder).source.items()}
    data["elastic"] |= {"young_modulus_Pa": modulus, "young_modulus_std_Pa": std}
    data["measure"] = measure
    return scene_from_dict(data, folder=str(folder))


def judge(top: Path, seed: int, side: float, changes: dict) -> dict[str, float]:
    """Calibrate on the first sample, judge on the second."""
    first, second = top / "first", top / "second"
    make_sample(first, TRUE[0], seed, side, changes)
    make_sample(second, TRUE[1], seed + 1000, side, changes)
    known = scene_with(first, TRUE[0], 0.01 * TRUE[0], method="threshold")
    found = run_threshold(open_experiment(known)).record["threshold"]
    threshold = CoverageEstimate(found["value"], found["std"], found["low_95"], found["high_95"])
    result = {"threshold": found["value"], "std": found["std"]}
    for shift in (0.0, 0.1):
        level = threshold.value + shift
        run = measure_series(scene_with(second, TRUE[1], 0.0, method="threshold", threshold=level))
        slope = load_slope(run.frames["force_sum_N"], run.frames["load_N"]).value
        worst = (run.frames["force_sum_N"] / run.frames["load_N"] - 1).abs().max()
        result |= {f"slope % (+{shift:g})": 100 * (slope - 1), f"worst % (+{shift:g})": 100 * worst}
    guess = scene_with(second, 0.96 * TRUE[1], 0.03 * TRUE[1], method="threshold")
    tuned = run_modulus(open_experiment(guess), threshold=threshold).record["young_modulus"]
    result["modulus %"] = 100 * (tuned["value"] / TRUE[1] - 1)
    result["stated %"] = 100 * tuned["std"] / TRUE[1]
    disk = measure_series(scene_with(second, TRUE[1], 0.0))
    result["disk slope %"] = 100 * (load_slope(disk.frames["force_sum_N"], disk.frames["load_N"]).value - 1)
    return result


def closed_loop(seed: int = 1, side_mm: float = 10.0) -> None:
    """Every line of the table."""
    results = {}
    for name, changes in RENDERED.items():
        with tempfile.TemporaryDirectory() as top:
            results[name] = judge(Path(top), seed, side_mm * 1e-3, changes)
        print(name, results[name], flush=True)
    print(pd.DataFrame(results).T.to_string(float_format="{:.3f}".format))
