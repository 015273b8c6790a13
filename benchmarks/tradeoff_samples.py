"""What accuracy costs on the sample scenes: the figures and tables of docs/tradeoff.md.

python benchmarks/run.py tradeoff_samples.tables

Times are processor times of one core, by turns in this process. Boundary elements run if ContactMechanics is
installed.
"""

import time

import cv2
from shared import ROOT, markdown, put_table

from contactimg import read_scene
from contactimg.files import figure_bytes
from contactimg.pipeline.tradeoff import REPETITION_SECONDS, prepare_tradeoff
from contactimg.plots.tradeoff import plot_tradeoff
from contactimg.tradeoff.measure import error_text, run_knobs, time_text

SCENES = {"sa_plus": "sa_plus", "ra_plus": "ra_plus.toml"}
HEADER = ("knob", "setting", "largest error", "time", "ratio", "against")


def measure(name):
    """Measure all knobs of a sample scene; write its figures and its table."""
    scene = read_scene(ROOT / "sample_data" / SCENES[name])
    knobs, _ = prepare_tradeoff(scene)
    found = run_knobs(
        knobs,
        relative=scene.tolerance.relative,
        seconds=2 * REPETITION_SECONDS,
        clock=time.process_time,
    )
    ax = plot_tradeoff(found.table, relative=found.relative)
    (ROOT / "docs" / "figures" / f"tradeoff_{name}.png").write_bytes(figure_bytes(ax, "png"))
    page = ROOT / "docs" / "tradeoff.md"
    put_table(page, f"{name} settings", markdown(HEADER, rows(found.table)))
    put_table(page, f"{name} sentences", "\n".join(f"- {text}" for text in found.sentences.values()))


def rows(table):
    """Cells of the settings that have numbers, the front in bold."""
    for row in table[table["error"].notna()].to_dict("records"):
        star = "**" if row["pareto"] == 1 else ""
        yield (
            row["knob"],
            f"{star}{row['setting']}{star}",
            error_text(row["error"]),
            time_text(row["time_s"]),
            f"{row['time_ratio']:.3g}",
            row["reference"],
        )


def tables() -> None:
    """Both scenes."""
    cv2.setNumThreads(1)
    for name in SCENES:
        measure(name)
