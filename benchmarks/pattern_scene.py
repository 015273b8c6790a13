"""The scene that benchmarks render: the paper's lens on its pattern SA+, seen by a camera with its faults."""

from typing import Any

from contactimg.scene import Scene, scene_from_dict

__all__ = ["PIXEL", "pattern_scene"]

MODULUS = 3.0e6  # Pa
PIXEL = 6.0e-6  # m
FAULTS = {
    "blur_px": 1.4,
    "vignetting": 0.15,
    "texture": 0.02,
    "dust_count": 30,
    "light_drift": 0.02,
    "position_drift_px": 0.3,
    "electrons_per_level": 20,
    "read_noise_electrons": 10,
}


def pattern_scene(
    seed: int,
    *,
    side: float = 0.01,
    coverage: float = 0.4,
    modulus: float = MODULUS,
    effects: dict[str, str] | None = None,
    **simulate: Any,
) -> Scene:
    """A square of the pattern with its side in metres; further keywords are those of ``[simulate]``."""
    return scene_from_dict(
        {
            "indenter": {"radius_m": 0.1288, "apex_m": [side / 2, side / 2]},
            "elastic": {"young_modulus_Pa": modulus},
            "asperities": {"generate": "SA", "coverage": coverage, "side_m": side, "seed": seed},
            "camera": {"pixel_size_m": PIXEL},
            "effects": {"model": "paper"} | (effects or {}),
            "simulate": FAULTS | {"seed": seed} | simulate,
        }
    )
