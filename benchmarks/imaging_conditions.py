"""Accuracy of the disk method by size, as it assumes and where the frame is not what it assumes."""

from imaging_frames import Optics
from imaging_scores import BINS, markdown, number, put_table, score, shoot, summarise

from contactimg.imaging.measure import measure_image

DIM = Optics(level=200.0, contrast=0.07, camera=(100.0, 141.0))  # contrast 14, noise 2 grey levels
SPREAD = Optics(spread=0.05)
CONDITIONS = {
    "as assumed: blur 1.4 px, contrast/noise 38": Optics(),
    "blur 0.8 px": Optics(sigma=0.8),
    "blur 2.0 px": Optics(sigma=2.0),
    "contrast/noise 15": Optics(camera="low"),
    "contrast/noise 104": Optics(camera="high"),
    "contrast 14 levels, noise 2": DIM,
    "20 % of the light in a halo of 8 px": Optics(halo=0.2),
    "5 % brightness spread": SPREAD,
    "light changed by 2 % across the frame": Optics(drift=0.02),
    "soft edge of 1 px": Optics(softness=1.0),
    "soft edge of 2 px": Optics(softness=2.0),
    "soft edge of 3 px": Optics(softness=3.0),
}


def tabulate_conditions(seed, *, frames=3, pooled=10):
    """Tables of the conditions; the first, as assumed, over ``pooled`` frames and in detail."""
    summaries = {}
    for k, (name, optics) in enumerate(CONDITIONS.items()):
        number_of_frames = pooled if k == 0 else frames
        summaries[name] = measure_condition(optics, range(seed + 100 * k, seed + 100 * k + number_of_frames))
        if optics is SPREAD:
            summaries[f"{name}, bounds that know no more"] = measure_condition(
                optics, range(seed + 100 * k, seed + 100 * k + frames), spread=optics.spread
            )
        print(name, number(summaries[name]["ratio"]), flush=True)
    put_table("conditions", _accuracy(summaries))
    put_table("errors", _errors(summaries))
    put_table("matched", _detail(next(iter(summaries.values()))))
    return summaries


def measure_condition(optics, seeds, *, spread=0.0):
    """Scores of frames taken through the same optics, pooled.

    Bounds are those of a sharp edge, and of contrasts that are the same but for a ``spread``.
    """
    scores = []
    for seed in seeds:
        shot = shoot(optics, seed, spread=spread)
        disks = measure_image(
            shot.frame, shot.reference, polarity="bright", full_scale=optics.full_scale
        ).disks
        scores.append(score(shot, disks))
    return summarise(scores)


def _accuracy(summaries):
    header = [
        "frames rendered with",
        "F1",
        "false a frame",
        "lost close",
        "lost touching",
        "RMS/CRB",
        *(f"{name} px" for name in BINS),
    ]
    rows = [
        [
            name,
            f"{s['f1']:.4f}",
            number(s["false"] / s["frames"]),
            f"{s['lost_close']}/{s['close']}",
            f"{s['lost_touching']}/{s['touching']}",
            number(s["ratio"], 3),
            *(number(ratio, 3) for ratio in s["ratios"]),
        ]
        for name, s in summaries.items()
    ]
    return markdown(header, rows)


def _errors(summaries):
    header = [
        "frames rendered with",
        *(f"bias {name} px" for name in BINS),
        "sum of a³: mean",
        "worst",
        "within ±1 std",
        "±2 std",
    ]
    rows = [
        [
            name,
            *(f"{bias:+.4f}" for bias in s["biases"]),
            f"{100 * s['cubes']:+.2f} %",
            f"{100 * s['cubes_worst']:+.2f} %",
            *(f"{100 * share:.0f} %" for share in s["within"]),
        ]
        for name, s in summaries.items()
    ]
    return markdown(header, rows)


def _detail(s):
    header = ["radius", "contacts", "RMS/CRB", "bias px", "its std", "within ±1 std", "±2 std"]
    rows = [
        [
            f"{BINS[k]} px",
            s["numbers"][k],
            number(s["ratios"][k], 3),
            f"{s['biases'][k]:+.4f}",
            f"{s['bias_stds'][k]:.4f}",
            *(f"{100 * s['within_bins'][j][k]:.1f} %" for j in (0, 1)),
        ]
        for k in range(len(BINS))
    ]
    everything = [
        sum(s["numbers"]),
        number(s["ratio"], 3),
        "",
        "",
        *(f"{100 * share:.1f} %" for share in s["within"]),
    ]
    return markdown(header, [*rows, ["all", *everything]])
