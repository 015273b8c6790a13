"""How honest the estimates of the effects of optics and sensor are, and what the plan saves.

    python benchmarks/run.py effects_honesty_optics.scenes --seeds 3 --names plain

For every scene of tests/helpers/optics_scenes.py and every effect that it can show: the true change of the
measured output when that effect is left out of all, from frames rendered with and without, against the
estimate; then what the plan leaves out, the change by all of it together, and the time to render."""

import time
from functools import partial

import numpy as np
from optics_scenes import CHANGES, optics_scene
from optics_truth import NOISE, Photographed
from shared import times_by_turns

from contactimg.effects.plan import decide
from contactimg.effects.render_without import OPTICS, estimate_optics
from contactimg.render import render_contacts


def render_time(photographed, shown):
    """Processor time of a frame with these effects, best of three."""
    scene, sphere_radius = photographed.with_effects(shown), photographed.sphere_radius
    rng = np.random.default_rng(0)
    work = partial(render_contacts, photographed.contacts, scene, rng=rng, sphere_radius=sphere_radius)
    return min(times_by_turns([work], 3)[0])


def judge(name, seeds):
    """Print one scene; return factor between estimate and truth by effect, where either matters."""
    scene = optics_scene(name)
    photographed, tolerance = Photographed.of(scene), scene.tolerance.relative
    start = time.process_time()
    estimates = {e.effect: e for e in estimate_optics(scene, photographed.contacts)}
    planning = time.process_time() - start
    everything = photographed.everything
    complete = photographed.amounts(everything, seeds)
    print(f"{name}: {scene.tolerance.output}, {scene.measure.method}, {len(photographed.contacts)} contacts")
    factors = {}
    for effect in (e for e in OPTICS if e in everything):
        without = photographed.amounts(everything - {effect}, seeds)
        truth, error = photographed.change(complete, without, noise=effect in NOISE)
        guess = estimates[effect].change
        mark = ""
        if max(truth - 2 * error, guess) > tolerance:
            low, high = max(truth - 2 * error, 1e-9), truth + 2 * error
            factor = guess / high if guess > high else min(guess / low, 1.0)
            factors[effect] = max(factor, 1 / max(factor, 1e-9))
            mark = f"factor {factors[effect]:.2f}"
        print(
            f"  {effect:15s} true {100 * truth:6.2f} +- {100 * error:.2f} %"
            f"  estimated {100 * guess:6.2f} % {mark}"
        )
    chosen = [estimates[e] for e in OPTICS if e in everything]
    decisions, _ = decide(chosen, scene.effects, scene.tolerance)
    kept = frozenset(d.effect for d in decisions if d.on)
    together, error = photographed.change(complete, photographed.amounts(kept, seeds), noise=False)
    slow, fast = render_time(photographed, everything), render_time(photographed, kept)
    print(
        f"  kept: {', '.join(sorted(kept)) or 'none'}; all else together {100 * together:.2f} +- "
        f"{100 * error:.2f} % of {100 * tolerance:g} %; rendering {slow / fast:.1f} times faster; "
        f"the estimates take {planning / slow:.1f} frames",
        flush=True,
    )
    return factors


def scenes(seeds: int = 6, names: tuple[str, ...] = ()) -> None:
    """Every scene, or those of the names."""
    worst: dict[str, tuple[float, str]] = {}
    for name in names or CHANGES:
        for effect, factor in judge(name, range(seeds)).items():
            worst[effect] = max(worst.get(effect, (0.0, "")), (factor, name))
    print("worst factor between estimate and truth (two standard errors allowed for):")
    for effect, (factor, name) in worst.items():
        print(f"  {effect:15s} {factor:.2f}  ({name})")
