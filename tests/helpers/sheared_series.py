"""Sheared series of known contacts, measured and analysed, and how far the result is from the truth."""

from pathlib import Path

import numpy as np
import pandas as pd

from contactimg.cli import main
from contactimg.pipeline.analyse.analysis import Analysis, AnalysisOptions, analyse_places
from contactimg.pipeline.analyse.places import Place, open_place
from contactimg.pipeline.inputs import need_asperities
from contactimg.pipeline.simulate import write_simulation
from contactimg.scene import Scene, scene_from_dict
from contactimg.shear.laws import half_axes_along

PIXEL, BETA, DIRECTION_DEG = 6e-6, 5e-17, 20.0
LARGEST_MOTION = 40e-6
RESOLVED_PX = 2.0
"""Radius from which on the noise of these frames lets a place be known to 0.05 px."""

SMALL = {
    "side_m": 0.0021, "shape": [340, 360], "loads_N": [0.025, 0.025, 0.025, 0.007],
    "tangential_N": [0.0, 0.007, 0.012, 0.002],
}  # fmt: skip
"""About 30 contacts, 4 frames."""


def scene_of(size: dict, seed: int = 7) -> Scene:
    """The scene of a series: all contacts lie in the image."""
    middle = [size["side_m"] / 2] * 2
    return scene_from_dict(
        {
            "indenter": {"radius_m": 0.1288, "apex_m": middle},
            "elastic": {"young_modulus_Pa": 3e6},
            "asperities": {"generate": "SA", "coverage": 0.4, "side_m": size["side_m"], "seed": seed},
            "camera": {"pixel_size_m": PIXEL, "linearity": 0.0, "centre_m": middle},
            "effects": {"model": "paper"},
            "measure": {"shape": "ellipse", "registration": "whole", "film_doubt": 0.0},
            "load": {"tangential_direction_deg": DIRECTION_DEG},
            "simulate": {
                "loads_N": size["loads_N"], "tangential_N": size["tangential_N"], "interval_s": 0.5,
                "shear_beta_m5_N2": BETA, "shear_compliance_m_N": LARGEST_MOTION / max(size["tangential_N"]),
                "shape": size["shape"], "blur_px": 1.4, "texture": 0.02, "light_drift": 0.02,
                "position_drift_px": 0.3, "electrons_per_level": 20, "read_noise_electrons": 10, "seed": seed,
            },
        }
    )  # fmt: skip


def analysed(folder: Path, size: dict, seed: int = 7) -> tuple[Analysis, Place, pd.DataFrame]:
    """Simulate, process and analyse a series; its analysis, the run and the true contacts."""
    scene = scene_of(size, seed)
    write_simulation(scene, need_asperities(scene, "a sheared series"), folder)
    assert main(["process", str(folder), "--quiet", "--no-pictures", "--workers", "1"]) == 0
    place = open_place(folder / "contactimg_out")
    analysis = analyse_places([place], AnalysisOptions(models=False))
    return analysis, place, pd.read_csv(folder / "truth.csv")


def with_truth(followed: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Rows of asperities.csv beside the true contacts, with the errors of the displacements, px."""
    both = followed.merge(truth, on=["frame", "asperity"], how="left", suffixes=("", "_true"))
    for axis in ("x_m", "y_m"):
        first = both[both["touches"]].drop_duplicates("asperity").set_index("asperity")[f"{axis}_true"]
        true = both[f"{axis}_true"] - both["asperity"].map(first)
        both[f"error_{axis}"] = ((both[f"displacement_{axis}"] - true) / PIXEL).astype(float)
    both["moved"] = (
        both["touches"]
        & both["x_m_true"].notna()
        & both.assign(n=both["touches"]).groupby("asperity")["n"].cumsum().gt(1)
    )
    return both


def axis_errors(contacts: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Errors of the half-axes along and across the load over their uncertainties; NaN without one."""
    both = contacts.merge(truth, on=["frame", "asperity"], suffixes=("", "_true"))
    direction = np.deg2rad(DIRECTION_DEG)
    turned = (np.cos(both["angle_rad"] - direction) ** 2).fillna(1.0)
    major, minor = both["semi_major_std_px"] ** 2, both["semi_minor_std_px"] ** 2
    axes = half_axes_along(
        both["semi_major_px"], both["semi_minor_px"], both["angle_rad"], direction=direction
    )
    along = (axes[0] - both["semi_minor_px_true"].fillna(both["radius_px_true"])) / np.sqrt(
        major * turned + minor * (1 - turned)
    )
    across = (axes[1] - both["semi_major_px_true"].fillna(both["radius_px_true"])) / np.sqrt(
        major * (1 - turned) + minor * turned
    )
    return pd.DataFrame({"along": along, "across": across, "radius_px": both["radius_px_true"]})


def true_strength(truth: pd.DataFrame, size: dict) -> float:
    """Largest tangential load over the true area there, Pa."""
    k = int(np.argmax(size["tangential_N"]))
    frame = sorted(truth["frame"].unique())[k]
    return size["tangential_N"][k] / float(truth.loc[truth["frame"] == frame, "area_m2"].sum())
