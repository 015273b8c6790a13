"""Whether the plan keeps its tolerance in every written output, on scenes drawn at random.

    python benchmarks/run.py effects_outputs.outputs --count 60 --seed 1 --relative 0.01
    python benchmarks/run.py effects_outputs.outputs --count 100 --seed 1 --start 100 --csv part2.csv

Each scene is solved as planned and with everything on. Printed: the share of scenes in which an output is off
by more than the tolerance, the largest error, and how far the plan's own estimate is from it.
"""

import numpy as np
import pandas as pd
from effect_scenes import possible_effects

from contactimg import generate_asperities
from contactimg.effects.output_change import WRITTEN, Answer, output_changes
from contactimg.effects.plan import make_plan
from contactimg.effects.solve_without import MECHANICAL_EFFECTS
from contactimg.errors import ContactimgError
from contactimg.prediction import predict_contacts
from contactimg.scene import Scene, scene_from_dict
from contactimg.surfaces import composite_apexes

PATTERNS = ("SA+", "SA-", "RA+", "RA-", "flat SA+", "flat RA+")


def draw(number: int, seed: int) -> tuple[str, Scene, pd.DataFrame, float]:
    """Kind, scene, asperities and load of one case; loads over four decades.

    A third of the scenes adhere, a third lie on a thin layer of any Poisson's ratio, a ninth do both.
    """
    rng = np.random.default_rng([seed, number])
    adhesive, layered = number % 3 == 0, number // 3 % 3 == 0
    kind = str(rng.choice(PATTERNS))
    flat, pattern = kind.startswith("flat"), kind[-3:]
    rigid = pattern.startswith("RA")
    load = float(10 ** rng.uniform(-4, np.log10(0.6 if pattern != "RA-" else 0.2)))
    side = float(rng.uniform(1.5e-3, 2.2e-3) if rigid else rng.uniform(4e-3, 7e-3))
    table = generate_asperities(
        pattern if rigid else "SA", side=side, coverage={"SA-": 0.1, "SA+": 0.4}.get(pattern), rng=rng
    )
    elastic = {"young_modulus_Pa": float(rng.uniform(2e6, 4e6)), "thickness_m": 0.015}
    if adhesive:
        elastic["work_of_adhesion_J_m2"] = float(10 ** rng.uniform(-4, -1))
    if layered:
        elastic["thickness_m"] = float(10 ** rng.uniform(-4, -2))
        elastic["poisson_ratio"] = float(rng.choice([rng.uniform(0.3, 0.5), 0.5]))
    if flat:
        load *= 0.1
    indenter = {"radius_m": 1e3 if flat else (0.013 if rigid else 0.1288)}
    indenter["apex_m"] = [side / 2, side / 2]
    name = ", ".join([kind, *["adhesive"] * adhesive, *["layer"] * layered])
    return name, scene_from_dict({"indenter": indenter, "elastic": elastic}), table, load


def everything(scene: Scene) -> Scene:
    """The scene with every effect on that it can have."""
    able = possible_effects(scene)
    switches = {name: "on" if name in able else "off" for name in MECHANICAL_EFFECTS}
    return scene.model_copy(update={"effects": scene.effects.model_copy(update=switches)})


def answer(scene: Scene, table: pd.DataFrame, load: float) -> Answer:
    """Forces, radii and indentation with the scene's switches."""
    prediction = predict_contacts(scene, table, load=load)
    force, radius = np.zeros(len(table)), np.zeros(len(table))
    rows = prediction.contacts["asperity"].to_numpy(int)
    force[rows], radius[rows] = prediction.contacts["force_N"], prediction.contacts["radius_m"]
    return Answer(force, radius, float(prediction.frames["indentation_m"].iloc[0]))


def judge(number: int, seed: int, relative: float, output: str) -> dict[str, object]:
    """True and estimated error of each output of one scene as planned."""
    kind, scene, table, load = draw(number, seed)
    tolerance = scene.tolerance.model_copy(update={"relative": relative, "output": output})
    scene = scene.model_copy(update={"tolerance": tolerance})
    row: dict[str, object] = {"number": number, "kind": kind, "load_N": load}
    try:
        plan = make_plan(scene, table, load=load)
        complete = answer(everything(scene), table, load)
        planned = answer(plan.apply(scene), table, load)
    except ContactimgError as error:
        return row | {"refused": str(error)}
    sites = composite_apexes(table, indenter_radius=scene.indenter.radius, apex=scene.indenter.apex)
    x0, y0 = scene.indenter.apex
    distance = np.hypot(sites["x_m"] - x0, sites["y_m"] - y0).to_numpy(float)
    radius = sites["radius_m"].to_numpy(float)
    true = output_changes(distance, radius, without=planned, complete=complete)
    row |= {"refused": "", "contacts": int(np.count_nonzero(complete.radius)), "off": " ".join(plan.left_out)}
    for name in WRITTEN:
        row |= {f"true_{name}": true[name], f"said_{name}": plan.expected_errors[name]}
    return row


def report(rows: pd.DataFrame, relative: float) -> None:
    """Print the summary of all scenes."""
    solved = rows[rows["refused"] == ""]
    print(f"{len(solved)} scenes solved, {len(rows) - len(solved)} refused; tolerance {100 * relative:g} %")
    print("| output | scenes above | worst error % | estimates compared | worst factor | beyond 2 |")
    print("|---|---|---|---|---|---|")
    for name in WRITTEN:
        true, said = (solved[f"{kind}_{name}"].astype(float) for kind in ("true", "said"))
        large = np.maximum(true, said) > relative
        ratio = (said[large].clip(lower=1e-12) / true[large].clip(lower=1e-12)).to_numpy()
        factor = np.maximum(ratio, 1 / ratio)
        worst = f"{factor.max():.2f}" if factor.size else ""
        print(
            f"| {name} | {int((true > relative).sum())} | {100 * true.max():.3g} | {factor.size} | {worst} | "
            f"{int((factor > 2).sum())} |"
        )
    off = solved["off"].str.split().explode().value_counts()
    print("left out:", ", ".join(f"{name} {count}" for name, count in off.items()))
    wrong = solved[[f"true_{name}" for name in WRITTEN]].astype(float).max(axis=1) > relative
    print(solved[wrong].to_string(float_format="%.4g"))


def outputs(  # noqa: PLR0917 - options
    count: int = 60,
    start: int = 0,
    seed: int = 1,
    relative: float = 0.01,
    output: str = "all",
    csv: str | None = None,
) -> None:
    """Draw the scenes, judge them and report; ``csv`` is a file for the rows."""
    rows = pd.DataFrame([judge(k, seed, relative, output) for k in range(start, start + count)])
    if csv:
        rows.to_csv(csv, index=False)
    report(rows, relative)
