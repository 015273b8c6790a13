"""Scenes on which the estimates of the effects are held against the truth: one thing is unusual in each."""

from typing import Any

from contactimg.scene import Scene, scene_from_dict

BASE: dict[str, dict[str, Any]] = {
    "tolerance": {"output": "area"},
    "effects": {"model": "paper"},
    "indenter": {"radius_m": 0.1288, "apex_m": [0.0012, 0.0012]},
    "elastic": {"young_modulus_Pa": 3.0e6},
    "asperities": {"generate": "SA", "coverage": 0.4, "side_m": 0.0024, "seed": 5},
    "camera": {"pixel_size_m": 6.0e-6},
    "simulate": {
        "loads_N": [0.05],
        "shape": [400, 420],
        "blur_px": 1.4,
        "vignetting": 0.15,
        "texture": 0.02,
        "dust_count": 4,
        "light_drift": 0.02,
        "position_drift_px": 0.3,
        "electrons_per_level": 20.0,
        "read_noise_electrons": 10.0,
        "edge_roughness_px": 0.1,
        "seed": 3,
    },
}
COUNT = {"measure": {"method": "threshold"}}
LOW_MAGNIFICATION = {
    "camera": {"pixel_size_m": 15e-6},
    "simulate": {"shape": [160, 180], "blur_px": 1.0},
}
LOW_LIGHT = {
    "simulate": {
        "electrons_per_level": 2.0,
        "read_noise_electrons": 6.0,
        "background_levels": 60.0,
        "contrast_levels": 40.0,
    }
}
STRONG_BLUR = {"simulate": {"blur_px": 3.0}}
SMALL = {"simulate": {"loads_N": [0.002], "blur_px": 1.0}}
FILM = {
    "simulate": {"background_levels": 200.0, "contrast_levels": 14.6, "texture": 0.005, "dust_count": 2},
}
FINE_FILM = {
    "camera": {"pixel_size_m": 3e-6},
    "simulate": {"background_levels": 150.0, "contrast_levels": 11.0, "texture": 0.004, "shape": [600, 640]}
    | {"loads_N": [0.02], "electrons_per_level": 80.0},
}
SATURATED = {"simulate": {"background_levels": 150.0, "contrast_levels": 170.0}}
BARELY_SATURATED = {"simulate": {"background_levels": 160.0, "contrast_levels": 100.0}}
DUSTY = {"simulate": {"dust_count": 400}}
MOVING = {"simulate": {"position_drift_px": 20.0}}
LIGHT = {"simulate": {"light_drift": 0.3, "vignetting": 0.6}}
ROUGH = {"simulate": {"edge_roughness_px": 1.0}}
FEW_LEVELS = {
    "simulate": {"background_levels": 20.4, "contrast_levels": 4.0, "vignetting": 0.0, "texture": 0.0}
    | {"dust_count": 0, "electrons_per_level": 0.0, "read_noise_electrons": 0.0, "light_drift": 0.0},
}
TWELVE_BIT = {
    "simulate": {"bit_depth": 12, "background_levels": 1200.0, "contrast_levels": 1500.0}
    | {"electrons_per_level": 4.0, "read_noise_electrons": 12.0},
}
DARK = {"images": {"polarity": "dark"}, "simulate": {"background_levels": 120.0, "contrast_levels": -60.0}}
RIGID = {
    "indenter": {"radius_m": 0.013, "apex_m": [0.0008, 0.0008]},
    "asperities": {"generate": "RA-", "coverage": 0.34, "side_m": 0.0016, "textured": "rigid", "seed": 2},
    "camera": {"pixel_size_m": 3.0e-6},
    "simulate": {"loads_N": [0.02], "shape": [500, 520], "blur_px": 1.2},
}

CHANGES: dict[str, list[dict[str, Any]]] = {
    "plain": [],
    "plain, counted": [COUNT],
    "plain, counted, force": [COUNT, {"tolerance": {"output": "force"}}],
    "low magnification": [LOW_MAGNIFICATION],
    "low magnification, counted": [LOW_MAGNIFICATION, COUNT],
    "low light": [LOW_LIGHT],
    "low light, counted": [LOW_LIGHT, COUNT],
    "strong blur": [STRONG_BLUR],
    "strong blur, counted": [STRONG_BLUR, COUNT],
    "strong blur, counted, radius": [STRONG_BLUR, COUNT, {"tolerance": {"output": "radius"}}],
    "small contacts": [SMALL],
    "small contacts, counted": [SMALL, COUNT],
    "small contacts, force": [SMALL, {"tolerance": {"output": "force"}}],
    "film": [FILM],
    "film, counted": [FILM, COUNT],
    "film, force": [FILM, {"tolerance": {"output": "force"}}],
    "film, fine pixels": [FINE_FILM],
    "film, fine pixels, counted": [FINE_FILM, COUNT],
    "saturated": [SATURATED],
    "saturated, counted": [SATURATED, COUNT],
    "barely saturated": [BARELY_SATURATED],
    "dusty": [DUSTY],
    "dusty, counted": [DUSTY, COUNT],
    "moving": [MOVING],
    "moving, counted": [MOVING, COUNT],
    "changing light": [LIGHT],
    "changing light, counted": [LIGHT, COUNT],
    "rough edge": [ROUGH],
    "rough edge, counted": [ROUGH, COUNT],
    "few levels": [FEW_LEVELS],
    "few levels, counted": [FEW_LEVELS, COUNT],
    "twelve bits": [TWELVE_BIT],
    "dark contacts": [DARK],
    "rigid asperities": [RIGID],
    "low threshold": [{"measure": {"method": "threshold", "threshold": 0.25}}],
}


def optics_scene(name: str) -> Scene:
    """One of the scenes, its seeds and loads included."""
    data = {section: dict(keys) for section, keys in BASE.items()}
    for change in CHANGES[name]:
        for section, keys in change.items():
            data[section] = data.get(section, {}) | keys
    return scene_from_dict(data, name=name)
