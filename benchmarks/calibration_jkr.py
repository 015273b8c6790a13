"""How well modulus, adhesion and centre come out of a smooth contact, and how honest the intervals are.

python benchmarks/run.py calibration_jkr.intervals --seeds 100 --seed 1  # loads and radii with noise
python benchmarks/run.py calibration_jkr.errors --seeds 50       # zero, gain, lens or layer that are off
python benchmarks/run.py calibration_jkr.frames --seed 1         # rendered, modulus and adhesion hidden
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from contactimg.analysis.load_cell import LoadCell
from contactimg.calibration.jkr import calibrate_jkr
from contactimg.files import list_frames, open_experiment, read_scene, write_frame, write_table
from contactimg.frame import Frame
from contactimg.mechanics import jkr
from contactimg.mechanics.layer import layer_factors
from contactimg.pipeline.calibrate.jkr import run_jkr
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import scene_from_dict
from contactimg.tables import LOADS

MODULUS, ADHESION, LENS = 3.0e6, 0.05, 0.1288
LAW = {"sphere_radius": LENS, "contact_modulus": MODULUS / 0.75, "work_of_adhesion": ADHESION}
LOADS_N = {
    "3 loads": [0.02, 0.1, 0.5],
    "5 loads": [0.02, 0.05, 0.1, 0.2, 0.5],
    "6 loads": [0.02, 0.05, 0.1, 0.2, 0.35, 0.5],
    "8 loads, two of them pulls or none": [-0.01, 0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5],
    "12 loads, even": np.linspace(0.04, 0.5, 12).tolist(),
}
FRAMES = {
    "film of JKR": {},
    "no film": {"film": "off"},
    "w = 5 mJ/m2, wide film": {"w": 0.005},
    "halo": {"psf": "halo"},
    "Airy PSF": {"psf": "airy"},
    "contrast 14 levels": {"contrast_levels": 14.0},
    "200 grains of dust": {"dust_count": 200},
    "vignetting 40 %": {"vignetting": 0.4},
    "blur 3 px": {"blur_px": 3.0},
    "other lamp: 530 nm, 100 nm wide": {"w": 0.005, "lamp": (530.0, 100.0)},
    "no film, soft edge of 1 px": {"film": "off", "edge_softness_px": 1.0},
    "no film, edge rough by 0.5 px": {"film": "off", "edge_roughness_px": 0.5},
    "contact leaves the field": {"centre_m": [0.0041, -0.0023]},
    "zero off by 2 mN": {"zero": 2e-3},
    "gain 1 % high": {"gain": 0.01},
    "lens astigmatic by 2 %": {"astigmatism": 0.02},
}
ERRORS = {
    "none": {},
    "zero off by 2 mN": {"zero": 2e-3},
    "gain 1 % high": {"gain": 0.01},
    "gain 1 % low": {"gain": -0.01},
    "lens astigmatic by 2 %, one radius stated": {"astigmatism": 0.02},
    "the three together": {"zero": 2e-3, "gain": 0.01, "astigmatism": 0.02},
    "zero drifts by 2 mN": {"drift": 2e-3},
    "gain drifts by 1 %": {"gain_drift": 0.01},
    "layer of 15 mm, not stated": {"layer": 15e-3},
    "layer of 5 mm, not stated": {"layer": 5e-3},
    "layer of 5 mm, stated": {"layer": 5e-3, "thickness": 5e-3},
}
SERIES = {
    "5 loads": LOADS_N["5 loads"],
    "12 loads": LOADS_N["12 loads, even"],
    "5 loads up and down": LOADS_N["5 loads"] + LOADS_N["5 loads"][-2::-1],
}


def show(table: pd.DataFrame) -> None:
    """Print a table."""
    print(table.to_string(float_format="{:.3f}".format))


def draw(loads: np.ndarray, noise: float, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Loads as a sensor reads them: noise relative to each load, or to the largest."""
    scale = np.abs(loads) if kind == "each" else loads.max()
    return loads + noise * scale * rng.standard_normal(loads.size)


def intervals(seeds: int = 100, seed: int = 1) -> None:
    """Share of seeds whose 95 % intervals hold the truth, and errors; with a right and a stated zero."""
    rows = []
    for name, values in LOADS_N.items():
        loads = np.array(values)
        cases = [(n, k, z) for n in (0.002, 0.01, 0.1) for k in ("each", "largest") for z in (0.0, 2.5e-3)]
        for noise, kind, zero_std in cases:
            found, refused = [], 0
            for number in range(seed, seed + seeds):
                rng = np.random.default_rng(number)
                radius = jkr.radius(loads, **LAW)
                std = 3e-5 * radius
                try:
                    found.append(
                        calibrate_jkr(
                            draw(loads, noise, kind, rng) + zero_std * rng.standard_normal(),
                            radius + std * rng.standard_normal(loads.size),
                            radius_std=std,
                            sphere_radius=LENS,
                            poisson_ratio=0.5,
                            load_cell=LoadCell(zero_std, gain_std=0.0),  # 1 % would hide the rest
                        )
                    )
                except ValueError:
                    refused += 1
            E, w = [f.young_modulus for f in found], [f.work_of_adhesion for f in found]
            row = {
                "loads": name,
                "noise %": 100 * noise,
                "of": kind,
                "zero mN": 1e3 * zero_std,
                "E covered": np.mean([e.low <= MODULUS <= e.high for e in E]),
                "w covered": np.mean([v.low <= ADHESION <= v.high for v in w]),
                "E worst %": 100 * max(abs(e.value / MODULUS - 1) for e in E),
                "w worst %": 100 * max(abs(v.value / ADHESION - 1) for v in w),
                "E std %": 100 * np.median([e.std for e in E]) / MODULUS,
                "w std %": 100 * np.median([v.std for v in w]) / ADHESION,
                "refused": refused,
            }
            rows.append(row)
            print(row, flush=True)
    show(pd.DataFrame(rows))


def read_series(loads: np.ndarray, error: dict, rng: np.random.Generator) -> dict:
    """Loads and radii with noise and a common error, as `calibrate_jkr` takes them."""
    radius = jkr.radius(loads, **LAW)
    true = loads
    if "layer" in error:  # the load at which the layer's contact has this radius
        pressing, adhesive = layer_factors(radius / error["layer"])
        K = 4 / 3 * LAW["contact_modulus"]
        true = pressing * K * radius**3 / LENS - adhesive * np.sqrt(6 * np.pi * ADHESION * K * radius**3)
    time = np.linspace(-0.5, 0.5, len(loads))
    scale = 1 + error.get("gain", 0.0) + error.get("gain_drift", 0.0) * time
    std = 3e-5 * radius + 1e-7
    bend = error.get("astigmatism", 0.0) / 2
    return {
        "load": draw(true * scale, 0.002, "each", rng)
        + error.get("zero", 0.0)
        + error.get("drift", 0.0) * time,
        "radius": radius + std * rng.standard_normal(len(loads)),
        "radius_std": std,
        "sphere_radius": LENS * (1 + bend),
        "sphere_radius_std": LENS * bend / np.sqrt(3),
        "thickness": error.get("thickness"),
        "poisson_ratio": 0.5,
        "load_cell": LoadCell(zero_std=2.5e-3),
    }


def errors(seeds: int = 50) -> None:
    """Share of series within two stated standard uncertainties when all loads or the lens are off.

    The scene states a zero to 2.5 mN; the gain is taken as known to 1 %.
    """
    rows = []
    for series, values in SERIES.items():
        for name, error in ERRORS.items():
            found = [
                calibrate_jkr(**read_series(np.array(values), error, np.random.default_rng([2, seed])))
                for seed in range(seeds)
            ]
            row: dict = {"loads": series, "error": name}
            for quantity, truth in (("young_modulus", MODULUS), ("work_of_adhesion", ADHESION)):
                values_ = np.array([getattr(one, quantity).value for one in found]) / truth - 1
                stds = np.array([getattr(one, quantity).std for one in found]) / truth
                symbol = quantity[0].replace("y", "E")
                row |= {
                    f"{symbol} in 2 std": np.mean(np.abs(values_) <= 2 * stds),
                    f"{symbol} off %": 100 * values_.mean(),
                    f"{symbol} worst %": 100 * np.abs(values_).max(),
                    f"{symbol} std %": 100 * np.median(stds),
                }
            row["zero seen"] = np.mean([one.load_zero_seen for one in found])
            row["departure"] = np.mean([bool(one.departure) for one in found])
            rows.append(row)
            print(row, flush=True)
    show(pd.DataFrame(rows))


def stretch(folder: Path, astigmatism: float, centre: tuple[float, float]) -> None:
    """Make the contacts of rendered frames the ellipses of an astigmatic lens, about their centre."""
    stretched = (1 + astigmatism) ** (1 / 3)  # axes as radii to the power 2/3, their product unchanged
    x, y = centre
    affine = np.array([[stretched, 0, x * (1 - stretched)], [0, 1 / stretched, y * (1 - 1 / stretched)]])
    for source in list_frames(folder):
        frame = source.read()
        image = cv2.warpAffine(
            frame.image.astype(np.float32),
            affine,
            frame.shape[::-1],
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REFLECT,
        )
        image = np.clip(np.round(image), 0, 255).astype(frame.image.dtype)
        write_frame(Frame(image, frame.name, frame.full_scale), source.path)


def render(folder: Path, changes: dict, seed: int) -> tuple[float, float]:
    """Write frames with a hidden modulus and adhesion; return them."""
    changes = dict(changes)
    rng = np.random.default_rng(seed)
    modulus, w = rng.uniform(2e6, 4e6), changes.pop("w", rng.uniform(0.03, 0.07))
    lamp = changes.pop("lamp", None)
    film, centre = changes.pop("film", "on"), changes.pop("centre_m", [0.0, 0.0])
    astigmatism = changes.pop("astigmatism", 0.0)
    data = {
        "indenter": {"radius_m": LENS, "apex_m": [3e-5, -4.1e-5]},
        "elastic": {"young_modulus_Pa": modulus, "work_of_adhesion_J_m2": w},
        "camera": {"pixel_size_m": 12e-6, "centre_m": centre},
        "effects": {"film": film},
        "simulate": {
            "loads_N": LOADS_N["6 loads"],
            "shape": [560, 640],
            "contrast_levels": 60.0,
            "vignetting": 0.15,
            "texture": 0.01,
            "dust_count": 30,
            "light_drift": 0.02,
            "position_drift_px": 0.3,
            "electrons_per_level": 20,
            "read_noise_electrons": 10,
            "seed": seed,
        }
        | changes,
    }
    if lamp is not None:
        data["simulate"] |= {"film_wavelength_nm": lamp[0], "film_bandwidth_nm": lamp[1]}
    write_simulation(scene_from_dict(data), None, folder)
    if astigmatism:
        pose = read_scene(folder).pose((560, 640))
        x, y = pose.to_pixels(3e-5, -4.1e-5)
        stretch(folder, astigmatism, (float(x), float(y)))
    return modulus, w


def measure(
    folder: Path, seed: int, *, zero: float = 0.0, gain: float = 0.0, gain_stated: bool = False
) -> dict:
    """Calibrate from the frames with 0.2 % of load noise; the scene knows lens and pixel size only.

    ``gain_stated`` says that the gain of the load cell is exact, where it is.
    """
    loads = pd.read_csv(folder / "loads.csv")
    read = draw((1 + gain) * loads["load_N"].to_numpy(), 0.002, "each", np.random.default_rng(seed + 1))
    loads["load_N"] = read + zero
    write_table(loads, LOADS, folder / "loads.csv")
    source = read_scene(folder).source
    data = {name: source[name] for name in ("indenter", "camera", "images")}
    data["load"] = {"zero_std_N": 2.5e-3} if zero else {}
    if gain_stated:  # 1 % would hide the rest
        data["load"]["gain_std"] = 0.0
    result = run_jkr(open_experiment(scene_from_dict(data, folder=str(folder)), pulled=True))
    circles = next(table for schema, table in result.tables if schema.name == "circles")
    return result.record | {"circles": circles}


def frames(seed: int = 1) -> None:
    """Errors of the whole way from frames to modulus, adhesion and centre."""
    rows = {}
    for name, changes in FRAMES.items():
        drawn = {key: value for key, value in changes.items() if key not in ("zero", "gain")}
        off = {key: changes[key] for key in ("zero", "gain") if key in changes}
        with tempfile.TemporaryDirectory() as top:
            folder = Path(top)
            modulus, w = render(folder, drawn, seed)
            truth = pd.read_csv(folder / "truth.csv")
            found = measure(folder, seed, gain_stated="gain" not in off, **off)
            pose = read_scene(folder).pose((560, 640))
        circles = found["circles"].set_index("frame").loc[truth["frame"]].reset_index(drop=True)
        x, y = pose.to_pixels(3e-5, -4.1e-5)
        E, v = found["young_modulus"], found["work_of_adhesion"]
        rows[name] = {
            "E %": 100 * (E["value"] / modulus - 1),
            "E std %": 100 * E["std"] / modulus,
            "w %": 100 * (v["value"] / w - 1),
            "w std %": 100 * v["std"] / w,
            "inside": E["low_95"] <= modulus <= E["high_95"] and v["low_95"] <= w <= v["high_95"],
            "radius px": (circles["radius_px"] - truth["radius_px"]).abs().max(),
            "stated px": (circles["radius_std_m"] / 12e-6).max(),
            "centre px": np.hypot(found["centre_x"]["value"] - x, found["centre_y"]["value"] - y),
            "frames": int(np.isfinite(circles["radius_px"]).sum()),
        }
        print(name, rows[name], flush=True)
    show(pd.DataFrame(rows).T)
