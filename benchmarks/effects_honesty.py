"""How honest the plan of the mechanical effects is, and what it saves.

    python benchmarks/run.py effects_honesty.scenes   # estimate against truth, every scene, output, effect
    python benchmarks/run.py effects_honesty.cost     # auto against everything on, by turns in one process

The truth is the change of the output when one effect is switched off and all others are on.
"""

from functools import partial

import numpy as np
from effect_scenes import SCENES, mechanical_scene, possible_effects
from shared import times_by_turns

from contactimg import solve_adhesive, solve_interacting
from contactimg.effects.output_change import OUTPUTS, relative_change
from contactimg.effects.plan import make_plan
from contactimg.effects.solve_without import MECHANICAL_EFFECTS, estimate_mechanics

LOOK_FROM = 2e-3
"""Changes below it, true and estimated, are not compared: single contacts decide them."""


def solve(scene, table, load, effects):
    """Forces and radii with these effects and no others."""
    elastic = scene.elastic
    level = "full" if "full_coupling" in effects else "asymptotic"
    where = {
        "indenter_radius": scene.indenter.radius,
        "contact_modulus": elastic.contact_modulus,
        "apex": scene.indenter.apex,
        "load": load,
        "coupling": level if "coupling" in effects else "none",
        "law": "sphere" if "sphere_profile" in effects else "hertz",
        "thickness": elastic.thickness if "layer" in effects else np.inf,
    }
    if "adhesion" in effects:
        solution = solve_adhesive(table, work_of_adhesion=elastic.work_of_adhesion, **where)
    else:
        solution = solve_interacting(table, **where)
    return solution.force, solution.radius


def compare(scene, table, load):
    """Rows of effect, output, truth and estimate."""
    all_on = possible_effects(scene)
    complete = solve(scene, table, load, all_on)
    without = {effect: solve(scene, table, load, all_on - {effect}) for effect in all_on}
    for output in OUTPUTS:
        tolerance = scene.tolerance.model_copy(update={"output": output})
        asked = scene.model_copy(update={"tolerance": tolerance})
        for estimate in estimate_mechanics(asked, table, load=load).estimates:
            if estimate.effect in all_on:
                truth = relative_change(output, without=without[estimate.effect], complete=complete)
                yield estimate.effect, output, truth, estimate.change


def factor(truth, estimate):
    """By what factor an estimate is off, from one."""
    return max(truth / estimate, estimate / truth) if truth > 0 and estimate > 0 else np.inf


def scenes():
    """Stated and true change of each effect in each scene."""
    print("| scene, area | " + " | ".join(MECHANICAL_EFFECTS) + " | on at 1 % |")
    print("|---|" + "---|" * (len(MECHANICAL_EFFECTS) + 1))
    found = []
    for name in SCENES:
        scene, table, load = mechanical_scene(name)
        rows = list(compare(scene, table, load))
        found += [(factor(t, e), t, e, name, effect, output) for effect, output, t, e in rows]
        cells = {effect: f"{100 * e:.2g} / {100 * t:.2g}" for effect, o, t, e in rows if o == "area"}
        on = [d.effect for d in make_plan(scene, table, load=load).decisions if d.on]
        print(
            f"| {name} | "
            + " | ".join(cells.get(e, "") for e in MECHANICAL_EFFECTS)
            + f" | {', '.join(on)} |"
        )
    for least in (1e-2, 5e-3, LOOK_FROM, 1e-3):
        counted = [row for row in found if max(row[1], row[2]) > least]
        off, truth, estimate, *where = max(counted)
        beyond = sum(row[0] > 3 for row in counted)
        print(
            f"above {least:g}: {len(counted)} comparisons, {beyond} off by more than 3, worst {off:.2f} "
            f"({', '.join(where)}: {estimate:.2g} for {truth:.2g})"
        )


def planned(scene, table, load):
    """Plan and solve as the plan says; the change against everything on follows from the answer."""
    plan = make_plan(scene, table, load=load)
    return solve(scene, table, load, {d.effect for d in plan.decisions if d.on})


def cost():
    """Time of plan and solution over that of the solution with everything on."""
    print("| scene | auto / everything on | of which the plan | change of A |")
    print("|---|---|---|---|")
    totals = np.zeros(3)
    for name in SCENES:
        scene, table, load = mechanical_scene(name)
        all_on = possible_effects(scene)
        works = (
            partial(planned, scene, table, load),
            partial(make_plan, scene, table, load=load),
            partial(solve, scene, table, load, all_on),
        )
        took = [min(times) for times in times_by_turns(works, 7)]
        totals += took
        change = relative_change(
            "area", without=planned(scene, table, load), complete=solve(scene, table, load, all_on)
        )
        print(f"| {name} | {took[0] / took[2]:.2f} | {took[1] / took[2]:.2f} | {100 * change:.2f} % |")
    print(f"| all together | {totals[0] / totals[2]:.2f} | {totals[1] / totals[2]:.2f} | |")
