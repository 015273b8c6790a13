"""The battery: what a measurement makes of many kinds of camera, light, optics and surface.

    python benchmarks/imaging_battery.py --counts 25,140 --seeds 1,2,3
    python benchmarks/imaging_battery.py --worlds "plain*,odd*" --tree . --tree ../base --csv battery.csv

Each frame is measured by the method under test, by the method "threshold", and by Otsu's threshold and
`label` on the measurement's own difference image (otsu) and on frame minus reference (raw, in the
better of both signs). Several trees (checkouts of contactimg) see the same frames, each in processes of its
own. A frame is

    right   sum of areas within 3 of its stated standard uncertainties, 85 % of the radii within 2 of theirs,
            recall and precision at least 0.95 (and the odd contact, if there is one, within 3.3)
    said    not right, and the status is not "ok"
    WRONG   not right, and the status is "ok"
    EXC     an exception, or more than a minute

and, beside that, BELOW where F1 is more than 0.02 below that of counting; AREA where, with "ok", the area is
further off than by counting and by more than 2 of its standard uncertainties; DOUBT where a frame with
contacts is right and the status not "ok". The table has a row a world and count, with the worst of the seeds;
time is in F = absdiff + threshold + connected components on the same frame.
"""

import argparse
import fnmatch
import importlib
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from skimage.filters import threshold_otsu
from skimage.measure import label

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from camera_worlds import SLOW, WORLDS, make_scene, visible_share

HERE = Path(__file__).resolve()
SHIFTS = ["contrast_shift_px", "blur_shift_px", "edge_shift_px"]
REACH_PX, REACH = 1.5, 0.5
"""A contact is matched within the larger of this distance and this share of its radius."""
STD_OF_SUM, STD_OF_ODD, COVERAGE, FOUND, BELOW = 3.0, 3.3, 0.85, 0.95, 0.02
PATIENCE_S = 60
START, END = "<!-- table: battery -->", "<!-- end -->"
"""Marks around the table in a page of the documentation."""
NOT_ON_PAGE = ("recall", "prec", "raw", "1 std", "2 std", "F")
"""Columns that are printed and do not stand on the page."""
OTSU_PIXELS = 4
ORDER = ["right", "said", "WRONG", "EXC"]


# ------------------------------------------------------------------------------------------ scores


def match(truth, found):
    """Index pairs (truth, found), the nearest first, one to one."""
    if not len(truth) or not len(found):
        return np.empty((0, 2), int)
    limit = np.maximum(REACH * truth.radius_px.to_numpy(), REACH_PX)
    points, tree = truth[["x_px", "y_px"]].to_numpy(), cKDTree(found[["x_px", "y_px"]].to_numpy())
    near = [
        (np.hypot(*(tree.data[j] - points[i])) / limit[i], i, j)
        for i, others in enumerate(tree.query_ball_point(points, limit))
        for j in others
    ]
    pairs, used = [], (set(), set())
    for _, i, j in sorted(near):
        if i not in used[0] and j not in used[1]:
            pairs.append((i, j))
            used[0].add(i)
            used[1].add(j)
    return np.array(pairs, int).reshape(-1, 2)


def finding(truth, found):
    """Pairs, recall, precision and F1; contacts that need not be found are neither required nor false."""
    pairs = match(truth, found)
    needed = truth.required.to_numpy(bool)
    hits = int(needed[pairs[:, 0]].sum())
    asserted = len(found) - (len(pairs) - hits)
    recall = hits / needed.sum() if needed.any() else 1.0
    precision = hits / asserted if asserted else 1.0
    return pairs, recall, precision, 2 * recall * precision / max(recall + precision, 1e-9)


def areas(found, shape):
    """Whole and visible area of each contact, px^2."""
    whole = np.pi * found.radius_px.to_numpy(float) ** 2
    if "area_px2" in found:
        stated = found.area_px2.to_numpy(float)
        whole = np.where(np.isfinite(stated), stated, whole)
    if "visible_area_px2" in found:
        visible = found.visible_area_px2.to_numpy(float)
        return whole, np.where(np.isfinite(visible), visible, whole)
    return whole, whole * visible_share(found.x_px, found.y_px, np.maximum(found.radius_px, 0.1), shape)


def std_of_sum(result, visible):
    """Standard uncertainty of the sum of areas: own errors in quadrature, shared ones linearly, the unseen.

    The columns ``*_shift_px`` are the changes of the radii by one standard uncertainty of what the contacts
    of a frame share.
    """
    disks = result.disks
    radius = disks.radius_px.to_numpy(float)
    std = np.nan_to_num(disks.radius_std_px.to_numpy(float)) / radius
    if "area_std_px2" in disks:
        stated = disks.area_std_px2.to_numpy(float) / (2 * disks.area_px2.to_numpy(float))
        std = np.where(np.isfinite(stated), stated, std)
    shared = disks[[name for name in SHIFTS if name in disks]].to_numpy(float) / radius[:, None]
    shared = np.nan_to_num(shared)
    own = np.maximum(std**2 - np.sum(shared**2, axis=1), 0)
    variance = np.sum((2 * visible) ** 2 * own) + np.sum((2 * visible @ shared) ** 2)
    return float(np.sqrt(variance + unseen_rms(result) ** 2))


def unseen_rms(result):
    """Area that contacts below the stated detection limit may have, px^2."""
    try:
        unseen_sum = importlib.import_module("contactimg.forces").unseen_sum
        smallest = float(getattr(result, "smallest_px", np.nan))
        disks = result.disks.assign(radius_m=result.disks.radius_px)
        if not len(disks) and smallest > 0:
            return float(np.pi * smallest**2)
        return float(unseen_sum(disks, np.pi * disks.radius_m**2, smallest, power=1.0).rms)
    except (ImportError, AttributeError, TypeError, ValueError):
        return 0.0


def raw_difference(scene):
    """Frame minus reference at the same median level, or minus its own median."""
    frame = scene.frame.astype(np.float32)
    if scene.reference is None:
        return frame - np.median(frame)
    return frame - scene.reference * (np.median(frame) / max(np.median(scene.reference), 1.0))


def otsu(image):
    """Otsu's threshold, and the regions above it that are connected."""
    image = np.nan_to_num(np.asarray(image, np.float32))
    if np.ptp(image) == 0:
        return pd.DataFrame(columns=["x_px", "y_px", "radius_px"], dtype=float)
    regions = label(image > threshold_otsu(image))
    rows, columns = np.nonzero(regions)
    which = regions[rows, columns]
    area = np.bincount(which)
    keep = area >= OTSU_PIXELS
    x, y = (np.bincount(which, at)[keep] / area[keep] for at in (columns, rows))
    return pd.DataFrame({"x_px": x, "y_px": y, "radius_px": np.sqrt(area[keep] / np.pi)})


def counted_error(truth, found, expected, shape):
    """F1 and relative error of the sum of areas of a count."""
    _, _, _, f1 = finding(truth, found)
    total = areas(found, shape)[1].sum() if len(found) else 0.0
    return f1, total / expected - 1 if expected else 0.0


def score(scene, result, counted=None, *, raw=True):
    """The numbers of one frame, with those of the raw difference or without."""
    truth, disks, shape = scene.truth, result.disks.reset_index(drop=True), scene.frame.shape
    pairs, recall, precision, f1 = finding(truth, disks)
    i, j = pairs.T
    expected = (truth.area_px2 * truth.visible)[truth.required | truth.index.isin(i)].sum()
    row = {
        "true": int(truth.required.sum()), "found": len(disks), "recall": recall, "precision": precision,
        "f1": f1, "status": str(result.status), "message": result.message, "rejected": len(result.rejected),
        "contrast": result.contrast, "blur": getattr(result, "blur_px", np.nan),
        "noise": result.noise, "limit": getattr(result, "smallest_px", np.nan),
    }  # fmt: skip
    sign = -1.0 if result.polarity == "dark" else 1.0
    row["f1_otsu"], row["area_otsu"] = counted_error(truth, otsu(sign * result.difference), expected, shape)
    if raw:
        both = [counted_error(truth, otsu(s * raw_difference(scene)), expected, shape) for s in (1, -1)]
        row["f1_raw"], row["area_raw"] = max(both)
    if counted is not None:
        row["f1_threshold"], row["area_threshold"] = counted_error(truth, counted.disks, expected, shape)
    visible = areas(disks, shape)[1] if len(disks) else np.zeros(0)
    std = std_of_sum(result, visible) if len(disks) else unseen_rms(result)
    row["area"] = visible.sum() / expected - 1 if expected else 0.0
    row["area_z"] = (visible.sum() - expected) / std if expected and std > 0 else 0.0
    if expected and not len(disks):
        row["area_z"] = -np.inf
    error = np.sqrt(areas(disks, shape)[0][j] / np.pi) - truth.radius_px.to_numpy()[i]
    pull = np.abs(error / disks.radius_std_px.to_numpy(float)[j])
    for name, limit in (("cover1", 1), ("cover2", 2)):
        row[name] = float(np.mean(pull <= limit)) if len(pull) else 1.0
    row["rms"] = float(np.sqrt(np.mean(error**2))) if len(error) else np.nan
    row["bias"] = float(np.mean(error)) if len(error) else np.nan
    row["rms_small"] = float(np.sqrt(np.mean(error[truth.radius_px.to_numpy()[i] < 3] ** 2 if len(i) else 0)))
    odd = np.flatnonzero(truth.odd)
    row["odd_z"] = np.nan
    if len(odd):
        at = np.flatnonzero(i == odd[0])
        row["odd_z"] = error[at[0]] / disks.radius_std_px.to_numpy(float)[j[at[0]]] if len(at) else np.inf
    return row | verdict(row)


def verdict(row):
    right = (
        abs(row["area_z"]) <= STD_OF_SUM
        and row["cover2"] >= COVERAGE
        and min(row["recall"], row["precision"]) >= FOUND
        and not abs(row["odd_z"]) > STD_OF_ODD
    )
    ok = row["status"] == "ok"
    f1 = [row[name] for name in ("f1_threshold", "f1_otsu", "f1_raw") if name in row]
    area = [abs(row[name]) for name in ("area_threshold", "area_otsu") if name in row]
    below = row["f1"] < max(f1) - BELOW
    worse = abs(row["area"]) > min(area) and abs(row["area_z"]) > 2
    notes = [word for word, true in (("BELOW", below), ("AREA", ok and worse)) if true]
    if right and not ok and row["true"]:
        notes.append("DOUBT")
    return {"verdict": "right" if right else "WRONG" if ok else "said", "notes": " ".join(notes)}


def picture(scene, disks, file):
    """The frame, enlarged, with found contacts in green, false ones in red, lost ones in yellow."""
    scale = 3 if max(scene.frame.shape) < 1000 else 2
    grey = cv2.convertScaleAbs(scene.frame, alpha=255 / max(scene.frame.max(), 1))
    image = cv2.cvtColor(cv2.resize(grey, None, fx=scale, fy=scale), cv2.COLOR_GRAY2BGR)
    i, j = match(scene.truth, disks).T
    false = disks.drop(index=disks.index[j])
    for table, colour in (
        (disks, (0, 200, 0)),
        (false, (0, 0, 255)),
        (scene.truth.drop(index=i), (0, 255, 255)),
    ):
        for x, y, a in table[["x_px", "y_px", "radius_px"]].to_numpy():
            centre = round((x + 0.5) * scale), round((y + 0.5) * scale)
            cv2.circle(image, centre, max(round(a * scale), 1), colour, 1, cv2.LINE_AA)
    cv2.imwrite(str(file), image)


def floor_time(scene):
    """F: the least of three runs on the same frame, s."""
    reference = scene.reference
    if reference is None:
        reference = np.full_like(scene.frame, np.median(scene.frame))
    times = []
    for _ in range(3):
        start = time.process_time()
        difference = cv2.absdiff(scene.frame, reference)
        cv2.connectedComponentsWithStats(cv2.compare(difference, 30, cv2.CMP_GT))
        times.append(time.process_time() - start)
    return min(times)


# ------------------------------------------------------------------------------------- one checkout


def measure(case):
    """The row of one world, count and seed, in the tree at the head of `sys.path`."""
    world, count, seed, options = case
    row = {"world": world, "count": count, "seed": seed}
    scene = make_scene(world, count, seed)
    signal.signal(signal.SIGALRM, _out_of_time)
    signal.alarm(PATIENCE_S)
    try:
        measure_image = importlib.import_module("contactimg.imaging.measure").measure_image
        known = {"polarity": scene.polarity, "full_scale": scene.full_scale}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            times = []
            for _ in range(options.repeat):
                start = time.process_time()
                result = measure_image(scene.frame, scene.reference, method=options.method, **known)
                times.append(time.process_time() - start)
            counted = None
            if options.method != "threshold":
                counted = measure_image(scene.frame, scene.reference, method="threshold", **known)
            row |= score(scene, result, counted)
        if options.pictures and row["verdict"] != "right":
            folder = Path(options.pictures)
            folder.mkdir(parents=True, exist_ok=True)
            picture(scene, result.disks.reset_index(drop=True), folder / f"{world} {count} {seed}.png")
        row |= {"F": min(times) / floor_time(scene), "ms": 1e3 * min(times)}
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}:{last.lineno}"
        row |= {
            "verdict": "EXC",
            "notes": "",
            "message": f"{type(error).__name__}: {error} ({place})",
            "status": "exception",
        }
        if options.verbose:
            traceback.print_exc()
    finally:
        signal.alarm(0)
    return row


def _out_of_time(*_arguments):
    raise TimeoutError(f"more than {PATIENCE_S} s")


def measure_all(cases, options):
    """Rows of all cases, in this process or in workers."""
    cv2.setNumThreads(1)
    measure(("plain", 25, 0, options))  # compiled code is loaded
    if options.workers == 1:
        rows = map(measure, cases)
    else:
        pool = multiprocessing.get_context("fork").Pool(options.workers)
        rows = pool.imap(measure, cases)
    done = []
    for row in rows:
        done.append(row)
        if options.verbose:
            print(
                f"{row['world']} {row['count']} {row['seed']}: {row['verdict']}", file=sys.stderr, flush=True
            )
    return pd.DataFrame(done)


# --------------------------------------------------------------------------------------- the command


def odd_note(pull):
    """The odd contacts' worst error in its std; of many, the shares within 1 and 2 std, and the lost."""
    note = f"odd {pull[pull.abs().idxmax()]:+.1f}"
    if len(pull) > 5:
        inside = "/".join(f"{100 * (pull.abs() <= n).mean():.0f}" for n in (1, 2))
        note += f" ({inside} %, {np.isinf(pull).sum()} lost)"
    return note


def worst(group):
    """One line of the table: the worst of the seeds."""
    last = group.loc[group.verdict.map(ORDER.index).idxmax()]
    share = f" {(group.verdict == last.verdict).sum()}/{len(group)}" if len(group) > 1 else ""
    line = {"verdict": last.verdict + share}
    group = group[group.verdict != "EXC"]
    if group.empty:
        return pd.Series(line | {"status": last.message})
    furthest = group.loc[group.area_z.abs().idxmax()]
    notes = sorted(set(" ".join(group.notes).split()))
    if group.odd_z.notna().any():
        notes.append(odd_note(group.odd_z))
    number = {
        "F1": group.f1.min(), "recall": group.recall.min(), "prec": group.precision.min(),
        "thr": group.get("f1_threshold", group.f1).max(), "otsu": group.f1_otsu.max(),
        "raw": group.f1_raw.max(), "area %": 100 * furthest.area, "/std": furthest.area_z,
        "1 std": group.cover1.min(), "2 std": group.cover2.min(), "rms": group.rms.max(),
        "F": group.F.median(),
    }  # fmt: skip
    digits = {"area %": 1, "/std": 1, "F": 1, "rms": 3}
    line |= {name: f"{value:.{digits.get(name, 2)}f}" for name, value in number.items()}
    return pd.Series(line | {"notes": " ".join(notes), "status": ", ".join(sorted(set(group.status)))})


def report(rows, left_out=()):
    """The table and the totals as text; on a page without some columns and the status "ok"."""
    rows = rows.assign(notes=[note if isinstance(note, str) else "" for note in rows.notes])
    keys = ["world", *(name for name in ("count", "tree") if (rows[name] != rows[name].iloc[0]).any())]
    lines = {key: worst(group) for key, group in rows.groupby(keys, sort=False)}
    table = pd.DataFrame(list(lines.values())).fillna("").drop(columns=list(left_out))
    if left_out:
        table["status"] = table["status"].replace("ok", "")
    table.insert(0, "world", [" ".join(str(part) for part in key) for key in lines])
    widths = {name: max(len(name), *(len(str(v)) for v in table[name])) for name in table}
    left = ("world", "verdict", "notes", "status")

    def line(values):
        cells = zip(values, widths.items(), strict=True)
        parts = (f"{v:<{w}}" if name in left else f"{v:>{w}}" for v, (name, w) in cells)
        return "  ".join(parts).rstrip()

    text = [line(table.columns), *(line(values) for values in table.itertuples(index=False))]
    for tree, part in rows.groupby("tree", sort=False):
        good = part[(part.verdict != "EXC") & (part.true > 0)]
        counts = ", ".join(f"{(part.verdict == name).sum()} {name}" for name in ORDER)
        notes = ", ".join(
            f"{part.notes.str.contains(name).sum()} {name}" for name in ("BELOW", "AREA", "DOUBT")
        )
        means = {"F1": "f1", "threshold": "f1_threshold", "Otsu": "f1_otsu", "raw Otsu": "f1_raw"}
        mean = ", ".join(f"{k} {good[v].mean():.3f}" for k, v in means.items() if v in good)
        text.append(
            f"\n{tree}: {len(part)} frames: {counts}; {notes}; mean F1: {mean}; {good.F.median():.1f} F"
        )
        for kind in ("WRONG", "EXC"):
            names = part[part.verdict == kind].groupby("world", sort=False).size()
            text.append(f"  {kind}: " + (", ".join(f"{w} ({n})" for w, n in names.items()) or "none"))
    return "\n".join(text)


def parse(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--worlds", default="*", help="names or patterns, separated by commas")
    parser.add_argument("--counts", default="25,140,450")
    parser.add_argument("--seeds", default="1,2,3", help="1,2,3 or 1-50")
    parser.add_argument("--method", choices=("disk", "threshold"), default="disk")
    parser.add_argument("--tree", action="append", help="a checkout of contactimg; several are compared")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=1, help="measurements of a frame, the fastest counts")
    parser.add_argument("--csv", help="file for the numbers of all frames")
    parser.add_argument("--page", help="page of the documentation whose table is written anew")
    parser.add_argument("--pictures", help="folder for pictures of the frames that are not right")
    parser.add_argument("--verbose", action="store_true", help="each frame as it is done, and tracebacks")
    parser.add_argument("--list", action="store_true", help="the names of the worlds")
    parser.add_argument("--rows", help=argparse.SUPPRESS)  # file that a child writes
    return parser.parse_args(argv)


def numbers(text):
    """1,2,5-8 as a list."""
    spans = [part.split("-") for part in text.split(",")]
    return [n for span in spans for n in range(int(span[0]), int(span[-1]) + 1)]


def choose_cases(options):
    """World, count and seed of each frame; slow worlds only by name."""
    patterns = [part.strip() for part in options.worlds.split(",")]
    names = [name for name in WORLDS if any(fnmatch.fnmatch(name, p) for p in patterns)]
    slow = [name for name in SLOW if name in patterns]
    if not names + slow:
        sys.exit(f"no world is called {options.worlds}; --list names them")
    counts, seeds = numbers(options.counts), numbers(options.seeds)
    cases = [*itertools.product(names, counts, seeds)]
    return cases + [(name, SLOW[name][1], seed) for name in slow for seed in seeds]


def run_tree(tree, argv):
    """The rows of a child process that imports contactimg from ``tree``."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv"
        one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        environment = os.environ | one | {"PYTHONPATH": str(Path(tree).resolve())}
        command = [sys.executable, str(HERE), *argv, "--rows", str(file)]
        subprocess.run(command, env=environment, check=True)  # noqa: S603
        return pd.read_csv(file).assign(tree=Path(tree).resolve().name)


def main(argv=None):
    argv = sys.argv[1:] if argv is None else argv
    options = parse(argv)
    if options.list:
        print("\n".join([*WORLDS, *SLOW]))
        return
    cases = choose_cases(options)
    if options.rows:
        measure_all([(*case, options) for case in cases], options).to_csv(options.rows, index=False)
        return
    trees = options.tree or [HERE.parents[1]]
    rows = pd.concat([run_tree(tree, argv) for tree in trees], ignore_index=True)
    order = {name: k for k, name in enumerate([*WORLDS, *SLOW])}
    rows = rows.sort_values(
        ["world", "count"], key=lambda s: s.map(order) if s.name == "world" else s, kind="stable"
    )
    if options.csv:
        rows.to_csv(options.csv, index=False)
    text = report(rows)
    print(text)
    if options.page:
        before, _, rest = Path(options.page).read_text().partition(START)
        after = rest.partition(END)[2]
        brief = report(rows, NOT_ON_PAGE)
        Path(options.page).write_text(f"{before}{START}\n```text\n{brief}\n```\n{END}{after}")


if __name__ == "__main__":
    main()
