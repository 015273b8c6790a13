"""What each mechanism of the measurement earns: the battery with one mechanism after the other left out.

    python benchmarks/imaging_ablation.py --counts 25 --seeds 31
    python benchmarks/imaging_ablation.py --only "halo,wide residuals" --page docs/imaging_results.md
    OMP_NUM_THREADS=1 python benchmarks/imaging_ablation.py --costs

A mechanism is left out by putting a function that does nothing in its place. The table says how many frames
are right, said or WRONG (see `imaging_battery`) and the mean F1, then which worlds come out otherwise than
with everything; a mechanism without a line that changes earns nothing on these frames.
"""

import argparse
import importlib
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import imaging_battery as battery
from contact_frames import Optics, render, scatter
from imaging_speed import label_with_opencv, seconds

START, END = "<!-- table: ablation -->", "<!-- end -->"
"""Marks around the table in a page of the documentation."""
BASE = "contactimg.imaging."


def plain_edge(search):
    """The edge of a disk behind one Gaussian."""
    edge = importlib.import_module(BASE + "fit.learned_edge")
    return edge.EdgeFit(search.problem, search.joint, edge.LearnedEdge(search.plain))


def fall_of_disks(foreground, disks, blur, _plateau):
    """The fall across the rim of each disk, whatever the outline of its region."""
    rules = importlib.import_module(BASE + "evidence.rules")
    return rules.measure_fall(foreground.image, foreground.frame_pair.valid, disks, min(max(blur, 1.0), 8.0))


def no_rule(name):
    """The rules of rejection without one."""
    rules = importlib.import_module(BASE + "evidence.rules").RULES
    return [rule for rule in rules if rule[0].name != name]


def mechanisms():
    """What is left out: names of places (module, attribute) and what stands there instead."""
    nothing = {"remove_halo": lambda problem, fit, **_: (problem, fit, None, np.empty((0, 3)))}
    foreign = importlib.import_module(BASE + "detect.bars_and_scratches").NONE
    table = {
        "better covers of groups": [("fit.assemble", "Assembly.improve_covers", lambda _self: None)],
        "coarser look at groups": [("fit.split_and_join", "_simpler", lambda *_a: None)],
        "one ellipse for touching disks": [("fit.assemble", "Assembly.join_ellipses", lambda _self: None)],
        "falls along outlines": [("evidence.rules", "_fall_of_rims", fall_of_disks)],
        "wide residuals": [("fit.assemble", "Assembly.add_wide_residuals", lambda _self: None)],
        "faint regions": [
            ("detect.candidates", "_faint_regions", lambda *a: ([], np.zeros(len(a[2]), np.bool_), 0.0))
        ],
        "outlines at a lower level": [("detect.candidates", "_whole_at_lower_level", lambda *_a: None)],
        "contrasts that no contact shows": [("fit.shared_optics", "_is_unseen", lambda *_a: False)],
        "halo": [("fit.method", "remove_halo", nothing["remove_halo"])],
        "learned edge": [("fit.learned_edge", "EdgeSearch.learn", plain_edge)],
        "coarse rims": [
            (room, "allow_for_coarse_rims", lambda problem, *_a, **_o: problem)
            for room in ("fit.assemble", "fit.method")
        ],
        "ellipses": [
            ("fit.method", "_Frame.with_ellipses", lambda _self, plain, **_: plain),
            ("fit.assemble", "Assembly.find_ellipses", lambda _self, *_: None),
        ],
        "foreign objects": [("foreground", "find_foreign", lambda *_a, **_o: foreign)],
        "uneven background": [
            ("background." + room, "even_out", lambda difference, **_: difference)
            for room in ("subtract", "no_reference")
        ],
        "flicker": [("background.even_out", "_without_flicker", lambda difference, *_a: difference)],
        "colour mosaic": [("measure", "mosaic_gains", lambda *_a: None)],
        "regions without light": [("measure", "find_unlit", lambda *_a: None)],
        "white margins": [("measure", "find_margin", lambda *_a: None)],
        "clipped blocks": [
            (room, "find_clipped", lambda *_a: None)
            for room in ("background.subtract", "background.no_reference")
        ],
        "envelope of the light": [("background.no_reference", "_flat_behind_envelope", lambda *_a: None)],
        "dark spots": [("evidence.status", "dark_spots", lambda *_a: np.zeros(0))],
    }
    for reason in ("REFERENCE_DUST", "NO_RIM", "INVISIBLE", "SCRATCH", "NOISE"):
        table[f"rule: {reason.lower().replace('_', ' ')}"] = [("evidence.rules", "RULES", no_rule(reason))]
    return table


class LeftOut:
    """A context in which a mechanism does nothing."""

    def __init__(self, places):
        self.places = places

    def __enter__(self):
        self.before = []
        for room, name, instead in self.places:
            owner = importlib.import_module(BASE + room)
            *owners, last = name.split(".")
            for one in owners:
                owner = getattr(owner, one)
            self.before.append((owner, last, owner.__dict__[last]))
            setattr(owner, last, instead)

    def __exit__(self, *_error):
        for owner, name, value in reversed(self.before):
            setattr(owner, name, value)


def line(name, rows, base):
    """One line of the table."""
    good = rows[(rows.verdict != "EXC") & (rows.true > 0)]
    counts = {word: int((rows.verdict == word).sum()) for word in battery.ORDER}
    merged = rows.merge(base, on=["world", "count", "seed"], suffixes=("", "_all"))
    rank = {word: k for k, word in enumerate(battery.ORDER)}
    change = merged.verdict.map(rank) - merged.verdict_all.map(rank)
    fall = merged.f1_all - merged.f1
    worse = merged[(change > 0) | (fall > 0.02)].world
    better = merged[(change < 0) | (fall < -0.02)].world
    return {
        "left out": name, **counts, "F1": f"{good.f1.mean():.4f}", "F": f"{good.F.median():.1f}",
        "worse": ", ".join(dict.fromkeys(worse)), "better": ", ".join(dict.fromkeys(better)),
    }  # fmt: skip


def costs(table, chosen, *, count=500, largest=30.0, rounds=31):
    """Time in F that a plain frame takes less without a mechanism: the least of some by turns."""
    measure, optics = importlib.import_module(BASE + "measure").measure_image, Optics()
    rng = np.random.default_rng(count)
    images = render(scatter(count, optics, rng, radii=(1.5, largest)), optics, rng)
    options = {"polarity": "bright", "full_scale": 255}
    table = table | {"": [], "all of these": [place for name in chosen for place in table[name]]}
    least = dict.fromkeys(["", *chosen, "all of these"], np.inf)
    cv2.setNumThreads(1)
    base = min(seconds(label_with_opencv, *images) for _ in range(rounds))
    for _ in range(rounds):
        for name in least:
            with LeftOut(table[name]):
                least[name] = min(least[name], seconds(measure, *images, **options))
    whole = least.pop("")
    print(f"{count} contacts of 1.5 to {largest:g} px: {whole / base:.1f} F, less without")
    for name in sorted(least, key=least.__getitem__):
        print(f"  {(whole - least[name]) / base:5.2f} F  {name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--worlds", default="*")
    parser.add_argument("--counts", default="25")
    parser.add_argument("--seeds", default="31")
    parser.add_argument("--only", help="names of mechanisms, separated by commas")
    parser.add_argument("--costs", action="store_true", help="what each takes of the time of a plain frame")
    parser.add_argument("--page", help="page of the documentation whose table is written anew")
    given = parser.parse_args()
    options = battery.parse(["--worlds", given.worlds, "--counts", given.counts, "--seeds", given.seeds])
    cases = [(*case, options) for case in battery.choose_cases(options)]
    table = mechanisms()
    chosen = [part.strip() for part in given.only.split(",")] if given.only else list(table)
    if given.costs:
        costs(table, chosen)
        return
    base = battery.measure_all(cases, options)
    lines = [line("nothing", base, base)]
    print(lines[0], flush=True)
    for name in chosen:
        with LeftOut(table[name]):
            lines.append(line(name, battery.measure_all(cases, options), base))
        print(lines[-1], flush=True)
    rows = [list(lines[0]), ["---"] * len(lines[0]), *(list(one.values()) for one in lines)]
    text = "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows)
    print(text)
    if given.page:
        page = Path(given.page)
        before, rest = page.read_text(encoding="utf-8").split(START)
        page.write_text(f"{before}{START}\n\n{text}\n\n{END}{rest.split(END, 1)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
