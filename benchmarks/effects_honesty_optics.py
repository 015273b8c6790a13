"""How honest the estimates of the effects of optics and sensor are, and what the plan saves.

    python benchmarks/effects_honesty_optics.py [--seeds N] [SCENE ...]

For every scene of tests/helpers/optics_scenes.py and every effect that it can show: the true change of the
measured output when that effect is left out of all, from frames rendered with and without, against the
estimate; then what the plan leaves out, the change by all of it together, and the time to render."""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from optics_scenes import CHANGES, optics_scene
from optics_truth import NOISE, Photographed

from contactimg.effects.optics import OPTICS, estimate_optics
from contactimg.effects.plan import decide
from contactimg.render import render_contacts


def render_time(photographed, shown):
    """CPU time of a frame with these effects, best of three."""
    scene = photographed.with_effects(shown)
    times = []
    for _ in range(3):
        start = time.process_time()
        render_contacts(
            photographed.contacts,
            scene,
            rng=np.random.default_rng(0),
            sphere_radius=photographed.sphere_radius,
        )
        times.append(time.process_time() - start)
    return min(times)


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
    decisions, _ = decide(
        [estimates[e] for e in OPTICS if e in everything], scene.effects, tolerance=tolerance
    )
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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("scenes", nargs="*", help="default: all")
    arguments = parser.parse_args()
    worst: dict[str, tuple[float, str]] = {}
    for name in arguments.scenes or CHANGES:
        for effect, factor in judge(name, range(arguments.seeds)).items():
            worst[effect] = max(worst.get(effect, (0.0, "")), (factor, name))
    print("worst factor between estimate and truth (two standard errors allowed for):")
    for effect, (factor, name) in worst.items():
        print(f"  {effect:15s} {factor:.2f}  ({name})")


if __name__ == "__main__":
    main()
