"""The whole chain from surface to matches, on frames of the paper's pattern SA+ with a camera's faults.

    python benchmarks/run.py chain.accuracy --seed 40
    python benchmarks/run.py chain.coverage --seed 201 --frames 30
    python benchmarks/run.py chain.series --seed 201

Frames of 1600 x 1200 pixels of 6 um, contrast 100 grey levels, noise 2.1; each has another pattern, noise and
texture. Cases are frames rendered with something that the estimator's model does not contain.
"""

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from shared import PIXEL, pattern_scene

from contactimg.files import list_frames, read_scene, write_frame, write_scene
from contactimg.forces import assign_forces, total, visible_areas
from contactimg.frame import Frame
from contactimg.pipeline.frame import measure_frame
from contactimg.pipeline.inputs import contact_sites, need_asperities
from contactimg.pipeline.overlay import compare_run
from contactimg.pipeline.series import measure_series
from contactimg.pipeline.simulate import write_simulation
from contactimg.pose.pairs import pair_points
from contactimg.prediction import predict_contacts
from contactimg.render import render_contacts, render_reference
from contactimg.scene import Scene

LOADS_N = [0.02, 0.2, 0.5]
SERIES_N = [1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.02, 0.05, 0.2, 0.5]
CASES: dict[str, dict[str, Any]] = {
    "as assumed": {},
    "20 % of the light in a wide halo": {"psf": "halo"},
    "Airy PSF": {"psf": "airy"},
    "5 % brightness spread": {"brightness_spread": 0.05},
    "soft edge, 1 px": {"edge_softness_px": 1.0},
    "rough edge, 0.3 px": {"edge_roughness_px": 0.3},
    "halo + spread + rough edge": {"psf": "halo", "brightness_spread": 0.05, "edge_roughness_px": 0.3},
    "air film": {"effects": {"film": "on"}},
}
COVERED = (
    "as assumed",
    "20 % of the light in a wide halo",
    "Airy PSF",
    "rough edge, 0.3 px",
    "5 % brightness spread",
)
WRONG_POSE = {"pixel_size_m": 6.06e-6, "centre_m": [0.005 + 21e-6, 0.005 - 21e-6], "rotation_deg": 0.5}


def render(folder: Path, scene: Scene) -> None:
    """Write the frames of a scene."""
    folder.mkdir()
    write_simulation(scene, need_asperities(scene, "a benchmark"), folder)


def mirror(folder: Path) -> None:
    """Turn every image upside down; the scene and the truth's metres do not know."""
    for source in list_frames(folder):
        frame = source.read()
        turned = np.ascontiguousarray(cv2.flip(frame.image, 0))
        write_frame(Frame(turned, frame.name, frame.full_scale), source.path)


def compare(folder: Path) -> dict[str, float]:
    """Process a folder and compare it with its truth; the worst of the loads counts."""
    scene = read_scene(folder)
    run, truth = measure_series(scene, workers=1), pd.read_csv(folder / "truth.csv")
    rows = []
    for row in run.frames.to_dict("records"):
        true = truth[truth["frame"] == row["frame"]]
        measured = run.contacts[run.contacts["frame"] == row["frame"]]
        i, j, _ = pair_points(measured[["x_m", "y_m"]], true[["x_m", "y_m"]], max_distance=12e-6)
        radii = measured["radius_m"].to_numpy()[i] - true["radius_m"].to_numpy()[j]
        rows.append(
            {
                "precision": np.isin(np.flatnonzero(measured["radius_px"] >= 2), i).mean(),
                "recall": np.isin(np.flatnonzero(true["radius_px"] >= 2), j).mean(),
                "area": row["area_m2"] / true["area_m2"].sum() - 1,
                "force": row["force_sum_N"] / row["load_N"] - 1,
                "radius": np.sqrt(np.mean(radii**2)),
            }
        )
    scores = compare_run(run, need_asperities(scene, "a benchmark")).scores
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


def accuracy(seed: int = 1) -> None:
    """Each case, and scenes that are wrong about the camera."""
    results = {}
    with tempfile.TemporaryDirectory() as top:
        for number, (name, changes) in enumerate(CASES.items()):
            folder = Path(top) / str(number)
            render(folder, pattern_scene(seed, loads_N=LOADS_N, **changes))
            if "effects" in changes:
                results[f"{name}, rim in the edge model"] = compare(folder)
                write_scene(read_scene(folder).source | {"effects": {"film": "off"}}, folder / "scene.toml")
            results[name] = compare(folder)
        folder = Path(top) / "0"
        scene = read_scene(folder).source
        write_scene(scene | {"camera": WRONG_POSE}, folder / "scene.toml")
        results["pose wrong by 30 um, 0.5 deg, 1 %"] = compare(folder)
        write_scene(scene, folder / "scene.toml")
        mirror(folder)
        results["image mirrored, scene says it is not"] = compare(folder)
    print(pd.DataFrame(results).T.to_string(float_format="{:.3f}".format))


def pulls(seed: int, load: float, changes: dict[str, Any]) -> dict[str, float]:
    """Error over stated uncertainty, and relative error, of the two sums of one frame measured alone."""
    scene = pattern_scene(seed, **changes)
    asperities = need_asperities(scene, "a benchmark")
    truth = predict_contacts(scene, asperities, load=load).contacts
    radii = contact_sites(asperities, scene)["radius_m"].to_numpy()
    rngs = np.random.default_rng([seed, int(1e6 * load)]).spawn(2)
    own = radii[truth["asperity"].to_numpy(int)]
    frame = render_contacts(truth, scene, rng=rngs[0], sphere_radius=own).frame
    reference = render_reference(scene, rng=rngs[1])
    contacts = measure_frame(frame, reference, pixel_size=PIXEL, polarity="bright")
    found = assign_forces(contacts, float(radii.mean()), contact_modulus=scene.elastic.contact_modulus)
    row = {}
    for name, terms, exponent, true in (
        ("area", visible_areas(found), 2, truth["area_m2"].sum()),
        ("force", found["force_N"], 3, load),
    ):
        summed = total(found, terms, exponent * terms)
        row |= {
            f"{name} error": 100 * (summed.value / true - 1),
            f"{name} stated": 100 * summed.std / true,
            f"{name} pull": (summed.value - true) / summed.std,
        }
    return row


def coverage(seed: int = 1, frames: int = 30) -> None:
    """Mean and spread of errors (%) and pulls over many frames of each case and load, measured alone."""
    for name in COVERED:
        rows = []
        for load in LOADS_N:
            table = pd.DataFrame([pulls(seed + k, load, CASES[name]) for k in range(frames)])
            row: dict[str, float] = {"load": load}
            for what in ("area", "force"):
                row |= {
                    f"{what}: bias": table[f"{what} error"].mean(),
                    f"{what}: std": table[f"{what} error"].std(),
                    f"{what}: stated": table[f"{what} stated"].mean(),
                    f"{what}: pull": table[f"{what} pull"].mean(),
                    f"{what}: pull std": table[f"{what} pull"].std(),
                }
            rows.append(row)
        print(
            name,
            pd.DataFrame(rows).to_string(index=False, float_format="{:.2f}".format),
            sep="\n",
            flush=True,
        )


def series(seed: int = 1) -> None:
    """Errors of the sums of a series over five decades of load, and what is stated (%)."""
    for blur in (1.4, 2.5):
        with tempfile.TemporaryDirectory() as top:
            folder = Path(top) / "series"
            render(folder, pattern_scene(seed, blur_px=blur, loads_N=SERIES_N))
            frames = measure_series(read_scene(folder), workers=1).frames.set_index("frame")
            truth = pd.read_csv(folder / "truth.csv").groupby("frame")["area_m2"].sum()
        area, load = truth[frames.index], frames["load_N"]
        table = pd.DataFrame(
            {
                "load": load,
                "area: error": 100 * (frames["area_m2"] / area - 1),
                "area: stated": 100 * frames["area_std_m2"] / area,
                "force: error": 100 * (frames["force_sum_N"] / load - 1),
                "force: stated": 100 * frames["force_sum_std_N"] / load,
            }
        )
        print(
            f"blur {blur} px",
            table.to_string(index=False, float_format="{:.3g}".format),
            sep="\n",
            flush=True,
        )
