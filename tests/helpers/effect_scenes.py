"""Scenes that span the switches of the mechanical effects, each with its load: small enough for seconds."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd

from contactimg import generate_asperities
from contactimg.effects.output_change import requested_outputs
from contactimg.effects.solve_without import MECHANICAL_EFFECTS, estimate_mechanics
from contactimg.scene import Scene, scene_from_dict

SA_LENS, RA_LENS = 0.1288, 0.013


def pattern(kind, *, side, coverage=None, seed=1):
    """Asperities of a kind on a square whose middle is the origin."""
    table = generate_asperities(kind, side=side, coverage=coverage, rng=np.random.default_rng(seed))
    return table.assign(x_m=table["x_m"] - side / 2, y_m=table["y_m"] - side / 2)


def caps(x, y, height=4e-5, radius=1e-4):
    """A few caps by hand."""
    return pd.DataFrame({"x_m": x, "y_m": y, "height_m": height, "radius_m": radius})


def hexagon(r):
    turn = np.arange(6) * np.pi / 3
    return caps(np.r_[0, r * np.cos(turn)], np.r_[0, r * np.sin(turn)])


# name: asperities, indenter's radius, [elastic] beyond E = 3 MPa, load
SCENES = {
    "SA+ 0.5 N": (lambda: pattern("SA", side=7e-3), SA_LENS, {"thickness_m": 0.015}, 0.5),
    "SA+ 0.1 N": (lambda: pattern("SA", side=5e-3), SA_LENS, {"thickness_m": 0.015}, 0.1),
    "SA+ 0.02 N": (lambda: pattern("SA", side=4e-3), SA_LENS, {"thickness_m": 0.015}, 0.02),
    "SA+ 1 mN": (lambda: pattern("SA", side=4e-3), SA_LENS, {"thickness_m": 0.015}, 1e-3),
    "SA+ tiny load": (lambda: pattern("SA", side=4e-3), SA_LENS, {"thickness_m": 0.015}, 1e-7),
    "SA+ large load": (lambda: pattern("SA", side=6e-3), SA_LENS, {"thickness_m": 0.015}, 1.2),
    "SA- 0.5 N": (lambda: pattern("SA", side=8e-3, coverage=0.1), SA_LENS, {"thickness_m": 0.015}, 0.5),
    "SA- 5 mN": (lambda: pattern("SA", side=5e-3, coverage=0.1), SA_LENS, {"thickness_m": 0.015}, 5e-3),
    "RA- dry": (lambda: pattern("RA-", side=1.6e-3), RA_LENS, {"thickness_m": 0.015}, 0.02),
    "RA- adhesive": (
        lambda: pattern("RA-", side=1.6e-3),
        RA_LENS,
        {"thickness_m": 0.015, "work_of_adhesion_J_m2": 0.05},
        0.02,
    ),
    "RA+ dry": (lambda: pattern("RA+", side=2e-3), RA_LENS, {"thickness_m": 0.015}, 0.2),
    "RA+ adhesive": (
        lambda: pattern("RA+", side=2e-3),
        RA_LENS,
        {"thickness_m": 0.015, "work_of_adhesion_J_m2": 0.05},
        0.1,
    ),
    "RA+ hardly adhesive": (
        lambda: pattern("RA+", side=2e-3),
        RA_LENS,
        {"work_of_adhesion_J_m2": 1e-5},
        0.1,
    ),
    "very adhesive, light": (
        lambda: pattern("RA+", side=2e-3),
        RA_LENS,
        {"work_of_adhesion_J_m2": 0.2},
        1e-3,
    ),
    "stiff and dilute": (
        lambda: pattern("SA", side=4e-3, coverage=0.05),
        SA_LENS,
        {"young_modulus_Pa": 1e9},
        0.01,
    ),
    "soft and dense": (
        lambda: pattern("SA", side=5e-3, coverage=0.45),
        SA_LENS,
        {"young_modulus_Pa": 3e5},
        0.02,
    ),
    "layer of 1 mm": (lambda: pattern("SA", side=5e-3), SA_LENS, {"thickness_m": 1e-3}, 0.1),
    "layer of 0.3 mm": (lambda: pattern("SA", side=4e-3), SA_LENS, {"thickness_m": 3e-4}, 0.02),
    "adhesive on a thin layer": (
        lambda: pattern("SA", side=4e-3, coverage=0.3),
        SA_LENS,
        {"thickness_m": 1e-3, "work_of_adhesion_J_m2": 0.02},
        0.02,
    ),
    "under a flat": (lambda: pattern("SA", side=2e-3), 1e6, {"thickness_m": 5e-3}, 0.05),
    "flat, adhesive, thin": (
        lambda: pattern("SA", side=2e-3),
        1e6,
        {"thickness_m": 1e-3, "work_of_adhesion_J_m2": 0.03},
        0.02,
    ),
    "close pair": (lambda: caps([0, 5e-5], [0.0, 0.0]), 1e6, {}, 1e-3),
    "unequal pair": (lambda: caps([0, 4.5e-5], [0.0, 0.0], [4e-5, 3.8e-5]), 1e6, {}, 1e-3),
    "hexagon": (lambda: hexagon(7e-5), 1e6, {}, 4e-3),
    "one asperity": (lambda: caps([0.0], [0.0]), SA_LENS, {"thickness_m": 0.015}, 1e-4),
    "one asperity, pressed far": (lambda: caps([0.0], [0.0]), SA_LENS, {"thickness_m": 0.015}, 8e-3),
}


def mechanical_scene(
    name: str, *, output: str = "area", relative: float = 0.01, effects: dict | None = None
) -> tuple[Scene, pd.DataFrame, float]:
    """A scene of the list with its asperities and load."""
    table, lens, elastic, load = SCENES[name]
    scene = scene_from_dict(
        {
            "indenter": {"radius_m": lens},
            "elastic": {"young_modulus_Pa": 3e6, **elastic},
            "tolerance": {"output": output, "relative": relative},
            "effects": effects or {},
        }
    )
    return scene, table(), load


def possible_effects(scene):
    """The mechanical effects that a scene can have, all at once."""
    adheres = scene.elastic.work_of_adhesion > 0
    able = {"adhesion": adheres, "full_coupling": not adheres, "layer": scene.elastic.thickness is not None}
    return {name for name in MECHANICAL_EFFECTS if able.get(name, True)}


@cache
def mechanics_of(name):
    """The estimates of a scene, of which the tolerance states the output alone."""
    scene, table, load = mechanical_scene(name)
    return estimate_mechanics(scene, table, load=load)


def for_output(name, scene, _table, *, load):
    """What `estimate_mechanics` gives for the scene of this name with another output."""
    found, outputs = mechanics_of(name), requested_outputs(scene.tolerance.output)
    estimates = (replace(e, change=max(e.changes[output] for output in outputs)) for e in found.estimates)
    return replace(found, estimates=tuple(estimates))
