"""How accurate the whole chain is: surface, model, rendered frames, measured contacts, matches.

Each line is a series of frames rendered with something the estimator's model does not contain, or processed
with a scene that is wrong about the camera; the worst load counts.

    python benchmarks/chain_accuracy.py [--seed N]
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from pattern_scene import pattern_scene

from contactimg.files import list_frames, read_scene, write_frame, write_scene
from contactimg.frame import Frame
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.overlay import compare_run
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.pose.pairs import pair_points

LOADS_N = [0.02, 0.2, 0.5]
RENDERED = {
    "matched": {},
    "20 % of the light in a wide halo": {"psf": "halo"},
    "Airy PSF": {"psf": "airy"},
    "5 % brightness spread": {"brightness_spread": 0.05},
    "soft edge, 1 px": {"edge_softness_px": 1.0},
    "rough edge, 0.3 px": {"edge_roughness_px": 0.3},
    "halo + spread + rough edge": {"psf": "halo", "brightness_spread": 0.05, "edge_roughness_px": 0.3},
    "air film": {"film": True},
}
WRONG_POSE = {
    "pixel_size_m": 6.06e-6,
    "centre_m": [0.005 + 21e-6, 0.005 - 21e-6],
    "rotation_deg": 0.5,
}


def render(folder: Path, changes: dict, seed: int) -> None:
    """Write the frames of the scene with some changes."""
    changes = dict(changes)
    effects = {"film": "on"} if changes.pop("film", False) else {}
    scene = pattern_scene(seed, effects=effects, loads_N=LOADS_N, **changes)
    folder.mkdir()
    write_simulation(scene, need_asperities(scene, "a test"), folder)


def mirror(folder: Path) -> None:
    """Turn every image upside down; the scene and the truth's metres do not know."""
    for source in list_frames(folder):
        frame = source.read()
        write_frame(
            Frame(np.ascontiguousarray(cv2.flip(frame.image, 0)), frame.name, frame.full_scale), source.path
        )


def judge(folder: Path) -> dict[str, float]:
    """Process a folder and compare with its truth; worst over the loads."""
    scene = read_scene(folder)
    run = measure_series(scene, workers=1)
    truth = pd.read_csv(folder / "truth.csv")
    scores = compare_run(run, need_asperities(scene, "a test")).scores
    rows = []
    for row in run.frames.to_dict("records"):
        true = truth[truth["frame"] == row["frame"]]
        measured = run.contacts[run.contacts["frame"] == row["frame"]]
        columns = ["x_m", "y_m"]
        i, j, _ = pair_points(measured[columns], true[columns], max_distance=12e-6)
        large_true, large = true["radius_px"] >= 2, measured["radius_px"] >= 2
        rows.append(
            {
                "precision": np.isin(np.flatnonzero(large), i).mean(),
                "recall": np.isin(np.flatnonzero(large_true), j).mean(),
                "area": row["area_m2"] / true["area_m2"].sum() - 1,
                "force": row["force_sum_N"] / row["load_N"] - 1,
                "radius": np.sqrt(
                    np.mean((measured["radius_m"].to_numpy()[i] - true["radius_m"].to_numpy()[j]) ** 2)
                ),
            }
        )
    table, f1 = pd.DataFrame(rows), scores.pivot_table(index="frame", columns="model", values="f1")
    return {
        "precision": table["precision"].min(),
        "recall": table["recall"].min(),
        "area %": 100 * table["area"].iloc[table["area"].abs().argmax()],
        "force %": 100 * table["force"].iloc[table["force"].abs().argmax()],
        "radius RMS um": 1e6 * table["radius"].max(),
        "f1 coupled": f1["coupled"].min(),
        "f1 uncoupled, 0.5 N": f1["uncoupled"].iloc[-1],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    seed = parser.parse_args().seed
    results = {}
    with tempfile.TemporaryDirectory() as top:
        for number, (name, changes) in enumerate(RENDERED.items()):
            folder = Path(top) / str(number)
            render(folder, changes, seed)
            if "film" in changes:
                results[f"{name}, rim in the edge model"] = judge(folder)
                write_scene(read_scene(folder).source | {"effects": {"film": "off"}}, folder / "scene.toml")
            results[name] = judge(folder)
        folder = Path(top) / "0"
        scene = read_scene(folder).source
        write_scene(scene | {"camera": WRONG_POSE}, folder / "scene.toml")
        results["matched; pose wrong by 30 um, 0.5 deg, 1 %"] = judge(folder)
        write_scene(scene, folder / "scene.toml")
        mirror(folder)
        results["matched; image mirrored, scene says it is not"] = judge(folder)
    print(pd.DataFrame(results).T.to_string(float_format="{:.3f}".format))


if __name__ == "__main__":
    main()
