"""What the parts of the imaging that are for frames of any kind cost, and what they give.

    python benchmarks/imaging_ablation_points.py          # table of docs/imaging_ablation.md

Each part is switched off as in `imaging_ablation_cases`, over the frames of `imaging_unmodelled` at 0.2 N,
over disks without blur (`imaging_sharp`), and over a series of frames before one surface. What counts is the
sum of the areas over its stated uncertainty, whether the status tells, and the coverage of the radii.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pandas as pd
import tifffile
from imaging_ablation_cases import Case, check_names, give, mark_none, without
from imaging_scores import ROOT, markdown
from imaging_sharp import PARTS, degrade, read_pages, true_disks
from imaging_unmodelled import (
    CASES,
    LEVEL,
    PIXEL_SIZE,
    SEED,
    Shape,
    blurred,
    contacts_at,
    exposed,
    gaussian,
    moved,
    paint,
    render,
    rounded,
    texture,
    vignetting,
)
from scipy.spatial import cKDTree

from contactimg import measure_series, scene_from_dict
from contactimg.imaging.fit.edge_profile import EdgeFit
from contactimg.imaging.fit.edge_scores import Edge
from contactimg.imaging.fit.learned_edge import LearnedEdge
from contactimg.imaging.judge.agreement import Agreement
from contactimg.imaging.judge.shape_ladder import Climb

PAGE = ROOT / "docs" / "imaging_ablation.md"
LOAD = 0.2  # N
SERIES_LOADS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3)  # N
SHARP = ((0.0, 0.0), (0.0, 3.0), (0.3, 1.0), (0.6, 3.0))  # blur (px), noise (grey levels)
TOO_FAR = 3.0  # stated standard uncertainties


def disagree_never(_foreground, _difference, detections, _blur):
    """Second opinion: none."""
    count = len(detections.contacts["x_px"])
    return Agreement(np.full(count, np.nan), np.zeros(count, np.bool_), np.zeros(count))


def stay_disks(detections, **_):
    """Ladder of shapes: disks."""
    return Climb(detections)


def keep_plain_edge(problem, joint, _prior, **_):
    """Learned edge: a plain one, and nothing undecided."""
    return EdgeFit(problem, joint, LearnedEdge(Edge.plain(joint.fit.blur)))


NO_EDGE = {
    "fit.method.learn_edge": keep_plain_edge,
    "judge.shape_ladder.learn_edge_of_ellipses": give(None),
}
POINTS = {
    "opinion": Case("second opinion", {"judge.review._compare": disagree_never}),
    "unseen": Case("contacts that are not seen", {"judge.review._is_unseen": mark_none(1)}),
    "coarse": Case(
        "edges sharper than pixels", {"fit.method.allow_for_coarse_rims": lambda problem, *_, **__: problem}
    ),
    "work": Case(
        "bounded work: ten times as much",
        {
            "fit.work.WORK_PER_PIXEL": 300.0,
            "judge.shape_ladder.WORK_PER_PIXEL": 6.0,
            "judge.ellipse_edge.WORK_PER_PIXEL": 40.0,
        },
    ),
    "ladder": Case("ellipses and free shapes", {"judge.review.climb": stay_disks}),
    "edge": Case("learned edge", NO_EDGE),
    "ellipses": Case("edge learned from ellipses", {"judge.shape_ladder.learn_edge_of_ellipses": give(None)}),
    "pooled": Case(
        "background of the series",
        {"pipeline.series.measure_on_background": lambda _experiment, _options, parts, **_: (parts, None)},
    ),
}


@dataclass(frozen=True, eq=False)
class Shots:
    """Frames of one kind before one reference.

    Parameters
    ----------
    kind : str
        "usual", "odd", "sharp" or "series".
    frames : list of ndarray
    reference : ndarray or None
    truth : list of (DataFrame, ndarray)
        Places and true areas (px^2) of the contacts of each.
    """

    kind: str
    frames: list
    reference: np.ndarray | None
    truth: list

    def measure(self):
        """Run, and the processor time over the frames, s per megapixel."""
        with TemporaryDirectory() as folder:
            for k, frame in enumerate(self.frames):
                tifffile.imwrite(Path(folder) / f"frame_{k}.tif", frame)
            images = {"frames": "frame_*.tif", "polarity": "dark" if self.kind == "sharp" else "bright"}
            if self.reference is not None:
                tifffile.imwrite(Path(folder) / "reference.tif", self.reference)
                images["reference"] = "reference.tif"
            scene = scene_from_dict({"camera": {"pixel_size_m": PIXEL_SIZE}, "images": images}, folder=folder)
            start = time.process_time()
            run = measure_series(scene, workers=1)
            seconds = time.process_time() - start
        return run, seconds / sum(frame.size / 1e6 for frame in self.frames)

    def score(self):
        """One row a frame, and the pulls and errors (px) of the radii."""
        run, seconds = self.measure()
        rows, pulls, errors = [], [], []
        for k, (disks, areas) in enumerate(self.truth):
            row = run.frames.iloc[k]
            found = run.contacts[run.contacts["frame"] == row["frame"]]
            total = areas.sum() * PIXEL_SIZE**2
            away = abs(row["area_m2"] - total) / row["area_std_m2"] if row["area_std_m2"] > 0 else np.inf
            rows.append({"kind": self.kind, "ok": row["status"] == "ok", "away": away, "seconds": seconds})
            if len(found):
                distance, near = cKDTree(disks[["x", "y"]]).query(found[["x_px", "y_px"]].to_numpy(float))
                radius = np.sqrt(areas / np.pi)[near]
                hit = distance < np.maximum(0.5 * radius, 1.5)
                error = (found["radius_px"].to_numpy() - radius)[hit]
                errors.append(error)
                pulls.append(np.abs(error) / found["radius_std_px"].to_numpy()[hit])
        return rows, np.concatenate([*pulls, np.zeros(0)]), np.concatenate([*errors, np.zeros(0)])


def odd_frames():
    """The frames of `imaging_unmodelled`, the one as the model among them as "usual"."""
    for number, case in enumerate(CASES):
        disks = contacts_at(LOAD, SEED)
        frame, reference, areas = render(case, disks, np.random.default_rng([SEED, number]))
        yield Shots("odd" if number else "usual", [frame], reference, [(disks, areas)])


def sharp_frames():
    """Disks of two grey levels, and with a little blur and noise."""
    for number, (blur, noise) in enumerate(SHARP):
        for _, image in read_pages(PARTS, 0, 700):
            truth = true_disks(image)
            disks = pd.DataFrame(truth[:, :2], columns=["x", "y"])
            frame = degrade(image, blur, noise, 0.0, np.random.default_rng(number))
            yield Shots("sharp", [frame], None, [(disks, np.pi * truth[:, 2] ** 2)])


def series_frames():
    """Frames before one surface that drifts, at six loads."""
    rng = np.random.default_rng(SEED)
    surface, frames, truth = texture(rng), [], []
    for k, load in enumerate(SERIES_LOADS):
        disks = contacts_at(load, SEED)
        fine, areas = paint(disks, Shape(), rng)
        drifted = moved(surface, 0.37 * k, -0.23 * k)
        light = LEVEL * vignetting() * (1 + drifted) * (1 + 1.25 * blurred(fine, gaussian()))
        frames.append(rounded(exposed(light, rng)))
        truth.append((disks, areas))
    yield Shots("series", frames, rounded(exposed(LEVEL * vignetting() * (1 + surface), rng)), truth)


def summarise(scores):
    """Numbers of all frames of a kind."""
    rows = pd.DataFrame([row for part, _, _ in scores for row in part])
    pulls, errors = (np.concatenate([score[k] for score in scores]) for k in (1, 2))
    return {
        "seconds": rows["seconds"].mean(),
        "false": int((rows["ok"] & (rows["away"] > TOO_FAR)).sum()),
        "said": int((~rows["ok"]).sum()),
        "frames": len(rows),
        "cover": f"{100 * np.mean(pulls < 1):.0f} {100 * np.mean(pulls < 2):.0f}",
        "rms": float(np.sqrt(np.mean(errors**2))),
    }


HEADER = [
    "switched off", "frames", "time off/on", '"ok", but off by more than 3 std', "another status",
    "within ±1, ±2 std, %", "RMS of the radii, px",
]  # fmt: skip


def compare(key, kinds, usual):
    """Rows of one part: each kind of frames on which it may matter, and the time on usual ones."""
    rows = []
    for kind, shots, on in kinds:
        with without(POINTS[key]):
            off = summarise([each.score() for each in shots])
        pairs = [f"{on[name]} → {off[name]}" for name in ("false", "said", "cover")]
        name = f"{on['frames']} {kind}"
        ratio = f"{off['seconds'] / on['seconds']:.2f}"
        rows.append([POINTS[key].name, name, ratio, *pairs, f"{on['rms']:.3f} → {off['rms']:.3f}"])
    with without(POINTS[key]):
        rest = min(usual.score()[0][0]["seconds"] for _ in range(REPEATS))
    rows[0][2] += f" (usual frame {rest / min(usual.score()[0][0]['seconds'] for _ in range(REPEATS)):.2f})"
    return rows


REPEATS = 5  # of a usual frame, of which the fastest counts
KINDS = {"opinion": ("odd", "sharp"), "unseen": ("odd",), "coarse": ("sharp",), "work": ("odd",),
         "ladder": ("odd",), "edge": ("odd",), "ellipses": ("odd",), "pooled": ("series",)}  # fmt: skip


def main():
    """Print the table and write it to the page."""
    cv2.setNumThreads(1)
    check_names(POINTS.values())
    shots = [*odd_frames(), *sharp_frames(), *series_frames()]
    usual = shots[0]
    usual.score()  # compiles
    kinds = {}
    for kind in ("odd", "sharp", "series"):
        some = [each for each in shots if each.kind == kind]
        kinds[kind] = (kind, some, summarise([each.score() for each in some]))
    rows = [row for key in POINTS for row in compare(key, [kinds[kind] for kind in KINDS[key]], usual)]
    text = "\n".join(markdown(HEADER, rows))
    print(text)
    before, _, rest = PAGE.read_text(encoding="utf-8").partition("<!-- points -->")
    after = rest.partition("<!-- end of points -->")[2]
    PAGE.write_text(f"{before}<!-- points -->\n{text}\n<!-- end of points -->{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
