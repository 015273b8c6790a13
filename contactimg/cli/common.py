"""What the commands share: options, progress bars, the summary table."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import floor, isnan, log10
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "command_line",
    "echo_frames",
    "echo_scores",
    "output_option",
    "progress",
    "quiet_option",
    "workers_option",
]

output_option = click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False),
    help="Output folder.  [default: contactimg_out inside the folder]",
)
quiet_option = click.option("--quiet", is_flag=True, help="Print errors only.")
workers_option = click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=None,
    help="Processes that share the frames.  [default: one a core, one for fewer than 4 frames]",
)

Advance = Callable[[], None]


def command_line(command: str) -> str:
    """The command as typed, for the provenance."""
    typed = click.get_current_context().find_root().obj or []
    return " ".join(["contactimg", *typed]) if typed else f"contactimg {command}"


@contextmanager
def progress(text: str, total: int, *, quiet: bool) -> Iterator[Advance]:
    """A progress bar on stderr; what it yields is called once an item."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(text, total=total)
        yield lambda: bar.advance(task)


def echo_frames(frames: "pd.DataFrame", *, title: str) -> None:
    """Print the frames table as a person reads it: mN, mm^2, one line a frame."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column("frame", overflow="fold")
    for name in ("status", "load (mN)", "contacts", "area (mm²)", "sum of forces (mN)", "forces / load"):
        table.add_column(name, justify="left" if name == "status" else "right")
    for row in frames.to_dict("records"):
        table.add_row(*_cells(row))
    console = Console()
    console.print(table)
    for row in frames[frames["message"] != ""].to_dict("records"):
        console.print(f"{row['frame']}: {row['message']}", highlight=False, markup=False)


def echo_scores(scores: "pd.DataFrame", *, title: str) -> None:
    """Print the scores, one line a frame and model."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column("frame", overflow="fold")
    table.add_column("model")
    for name in ("measured", "predicted", "matched", "precision", "recall", "f1", "radius RMS (µm)"):
        table.add_column(name, justify="right")
    for row in scores.to_dict("records"):
        counts = [str(row[name]) for name in ("n_measured", "n_predicted", "n_matched")]
        shares = [_number(row[name], "{:.3f}") for name in ("precision", "recall", "f1")]
        table.add_row(
            row["frame"], row["model"], *counts, *shares, _number(1e6 * row["radius_rms_m"], "{:.2f}")
        )
    Console().print(table)


def _cells(row: dict[str, Any]) -> list[str]:
    """The cells of one frame."""
    ratio = row["force_sum_N"] / row["load_N"] if row["load_N"] > 0 else float("nan")
    return [
        row["frame"],
        row["status"],
        _number(1e3 * row["load_N"]),
        str(row["n_contacts"]).replace("<NA>", ""),
        _with_std(1e6 * row["area_m2"], 1e6 * row["area_std_m2"]),
        _with_std(1e3 * row["force_sum_N"], 1e3 * row["force_sum_std_N"]),
        _number(ratio, "{:.3f}"),
    ]


def _number(value: float, form: str = "{:g}") -> str:
    """A number, or nothing for NaN."""
    return "" if isnan(value) else form.format(value)


def _with_std(value: float, std: float) -> str:
    """Value ± uncertainty, the value to the decimals that the uncertainty leaves."""
    if isnan(value):
        return ""
    if not std > 0:
        return f"{value:.4g}"
    decimals = max(0, 1 - floor(log10(std)))
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"
