"""What commands print for a person: progress bars and tables."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import floor, isnan, log10
from typing import TYPE_CHECKING, Any

import click

from contactimg.timings import Timings, stage

if TYPE_CHECKING:
    import pandas as pd

    from contactimg.effects.plan import Plan

Advance = Callable[[], None]

WIDTH_OF_FILES = 160
"""Characters of a line where the output is a file or a pipe. Chosen: names of frames stay whole."""


@contextmanager
def progress(text: str, total: int, *, quiet: bool) -> Iterator[Advance]:
    """Show a progress bar on standard error; call what it yields once per item."""
    with stage("loading"):
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(text, total=total)
        yield lambda: bar.advance(task)


def echo_first_run(*, quiet: bool) -> None:
    """Say on standard error that the first run compiles."""
    with stage("loading"):
        from contactimg.imaging.kernels.stored import kernels_are_stored
    if not quiet and not kernels_are_stored():
        click.echo("first run: compiling the numerical code, once; this takes one to two minutes", err=True)


def echo_frames(frames: "pd.DataFrame", *, title: str, statuses: Mapping[str, int] | None = None) -> None:
    """Print the frames in mN and mm^2, one line each, without empty columns; then the messages.

    With ``statuses`` (status -> number of frames, of all) it is said how many more there are.
    """
    heads = ("frame", "status", "load mN", "contacts", "area mm²", "forces mN", "forces/load")
    rows = [_cells(row) for row in frames.to_dict("records")]
    filled = [k for k in range(len(heads)) if k < 2 or any(row[k] for row in rows)]
    _echo_table(title, [heads[k] for k in filled], [[row[k] for k in filled] for row in rows], left=2)
    for row in frames[frames["message"] != ""].to_dict("records"):
        click.echo(f"{row['frame']}: {row['message']}")
    total = sum((statuses or {}).values())
    if total > len(frames):
        counts = ", ".join(f"{count:,} {status}" for status, count in (statuses or {}).items())
        click.echo(f"and {total - len(frames):,} more frames, in frames.csv; of all {total:,}: {counts}")


def echo_scores(scores: "pd.DataFrame", *, title: str) -> None:
    """Print the scores, one line per frame and model."""
    heads = ("frame", "model", "measured", "predicted", "matched", "precision", "recall", "f1")
    rows = [
        [
            row["frame"],
            row["model"],
            *(str(row[name]) for name in ("n_measured", "n_predicted", "n_matched")),
            *(_number(row[name], "{:.3f}") for name in ("precision", "recall", "f1")),
        ]
        for row in scores.to_dict("records")
    ]
    _echo_table(title, heads, rows, left=2)


def echo_results(results: "pd.DataFrame", *, title: str) -> None:
    """Print the results of an analysis with their confidence intervals."""
    from contactimg.report.units import in_display_units

    heads = ("quantity", "model", "value", "interval", "unit", "points")
    rows = [
        [
            row["quantity"],
            row["model"],
            _brief(row["value"], row["std"]),
            "" if isnan(row["low"]) else f"{row['low']:.4g} ... {row['high']:.4g}",
            row["unit"],
            str(row["n_points"]),
        ]
        for row in in_display_units(results).to_dict("records")
    ]
    _echo_table(title, heads, rows, left=2)


def echo_plan(plan: "Plan", *, title: str) -> None:
    """Print the decision on each effect, then the limits and messages of the plan."""
    heads = ("effect", "number that decides", "decision", "if left out", "time")
    rows = [
        [
            row["effect"],
            row["reason"],
            row["decision"] if row["switch"] == "auto" else f"{row['decision']} (scene)",
            f"{100 * row['change']:.2g} %",
            f"{row['cost']:.2g} x",
        ]
        for row in plan.table().to_dict("records")
    ]
    _echo_table(title, heads, rows, left=3)
    for sentence in (*plan.limits, *plan.messages):
        click.echo(sentence)


def echo_tradeoff(table: "pd.DataFrame") -> None:
    """Print one table per choice; a star marks the settings that no other one beats in error and time."""
    from contactimg.tradeoff.recommendations import error_text, time_text

    for knob, part in table.groupby("knob", sort=False):
        reference = part["reference"].iloc[0]
        rows = [
            [
                ("* " if row["pareto"] == 1 else "  ") + row["setting"],
                row["message"] if isnan(row["error"]) else _other_reference(row["reference"], reference),
                "" if isnan(row["error"]) else error_text(row["error"]),
                "" if isnan(row["time_s"]) else time_text(row["time_s"]),
                _number(row["time_ratio"], "{:.3g}"),
            ]
            for row in part.to_dict("records")
        ]
        output = {"all": "worst output"}.get(part["output"].iloc[0], part["output"].iloc[0])
        title = f"{knob}: error of the {output} against {reference}"
        _echo_table(title, ("setting", "", "error", "time", "ratio"), rows, left=2)


def _other_reference(reference: str, usual: str) -> str:
    """Name the reference of a setting if it is not the one in the title."""
    return "" if reference == usual else f"against {reference}"


def echo_timings(timings: Timings) -> None:
    """Print the stages on standard error: calls, seconds and fraction of the total time."""
    stages = timings.rows()
    total = sum(seconds for _, _, seconds in stages)
    rows = [
        [name, str(calls) if calls else "", f"{seconds:.3f}", f"{seconds / total:.1%}"]
        for name, calls, seconds in [*stages, ("total", 0, total)]
    ]
    _echo_table("where the time went", ("stage", "calls", "s", "share"), rows, left=1, stderr=True)


def _echo_table(
    title: str, heads: Sequence[str], rows: list[list[str]], *, left: int, stderr: bool = False
) -> None:
    """Print a table; the first ``left`` columns are text, the others numbers."""
    with stage("loading"):
        from rich import box
        from rich.console import Console
        from rich.table import Table

    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    for k, head in enumerate(heads):
        table.add_column(head, justify="left" if k < left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, stderr=stderr)
    if not console.is_terminal:
        console.width = max(console.width, WIDTH_OF_FILES)
    console.print(table)


def _cells(row: Mapping[Hashable, Any]) -> list[str]:
    """The cells of one frame."""
    ratio = row["force_sum_N"] / row["load_N"] if row["load_N"] > 0 else float("nan")
    return [
        row["frame"],
        row["status"],
        _number(1e3 * row["load_N"]),
        str(row["n_contacts"]) if isinstance(row["n_contacts"], int) else "",
        _with_std(1e6 * row["area_m2"], 1e6 * row["area_std_m2"]),
        _with_std(1e3 * row["force_sum_N"], 1e3 * row["force_sum_std_N"]),
        _number(ratio, "{:.3f}"),
    ]


def _number(value: float, form: str = "{:g}") -> str:
    """A number, or nothing for NaN."""
    return "" if isnan(value) else form.format(value)


def _brief(value: float, std: float) -> str:
    """A value with its uncertainty, as short as its size allows."""
    if isnan(value) or 1e-3 <= abs(value) < 1e5 or not std > 0:
        return _with_std(value, std)
    return f"{value:.4g} ± {std:.2g}"


def _with_std(value: float, std: float) -> str:
    """A value with the uncertainty of its last digits in brackets: 0.0510(12) is 0.0510 ± 0.0012."""
    if isnan(value):
        return ""
    if not std > 0:
        return f"{value:.4g}"
    decimals = max(0, 1 - floor(log10(float(f"{std:.1e}"))))
    return f"{value:.{decimals}f}({std * 10**decimals:.0f})" if decimals else f"{value:.0f} ± {std:.0f}"
