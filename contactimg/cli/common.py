"""What the commands share: options, progress bars, the summary table."""

import logging
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import floor, isnan, log10
from typing import TYPE_CHECKING, Any

import click

from contactimg.timings import Timings, collect, stage

if TYPE_CHECKING:
    import pandas as pd

    from contactimg.effects.plan import Plan

output_option = click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False),
    help="Output folder.  [default: contactimg_out inside the folder]",
)
quiet_option = click.option("--quiet", is_flag=True, help="Print errors only.")


def _be_verbose(_context: click.Context, _parameter: click.Parameter, value: bool) -> None:  # noqa: FBT001
    """Let the package's log through from the level INFO."""
    if value:
        logging.getLogger("contactimg").setLevel(logging.INFO)


verbose_option = click.option(
    "--verbose", is_flag=True, expose_value=False, callback=_be_verbose, help="Say more about each step."
)


def _time_stages(context: click.Context, _parameter: click.Parameter, value: bool) -> None:  # noqa: FBT001
    """Time the stages of the command and print them when it ends."""
    if value:
        timings = context.with_resource(collect())
        context.call_on_close(lambda: _echo_timings(timings))


timings_option = click.option(
    "--timings",
    is_flag=True,
    expose_value=False,
    callback=_time_stages,
    help="Say at the end where the time went.",
)
"""Of every command: `contactimg.cli` adds it."""

workers_option = click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=None,
    help="Processes that share the frames.  [default: one a core, one for fewer than 4 frames]",
)

Advance = Callable[[], None]


def command_line(command: str) -> str:
    """The command, for the provenance, as a shell reads it."""
    typed = click.get_current_context().find_root().obj or []
    return shlex.join(["contactimg", *typed]) if typed else f"contactimg {command}"


@contextmanager
def progress(text: str, total: int, *, quiet: bool) -> Iterator[Advance]:
    """A progress bar on stderr; what it yields is called once an item."""
    with stage("loading"):
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(text, total=total)
        yield lambda: bar.advance(task)


def echo_frames(frames: "pd.DataFrame", *, title: str) -> None:
    """Print the frames table as a person reads it: mN, mm^2, one line a frame."""
    heads = ("frame", "status", "load mN", "contacts", "area mm²", "forces mN", "forces/load")
    _echo_table(title, heads, [_cells(row) for row in frames.to_dict("records")], left=2)
    for row in frames[frames["message"] != ""].to_dict("records"):
        click.echo(f"{row['frame']}: {row['message']}")


def echo_scores(scores: "pd.DataFrame", *, title: str) -> None:
    """Print the scores, one line a frame and model."""
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
    """Print the numbers of an analysis with their intervals."""
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
        for row in results.to_dict("records")
    ]
    _echo_table(title, heads, rows, left=2)


def echo_plan(plan: "Plan", *, title: str) -> None:
    """Print what the plan says of each effect, and its sentences."""
    heads = ("effect", "decision", "if left out", "cost", "reason")
    rows = [
        [
            row["effect"],
            row["decision"] if row["switch"] == "auto" else f"{row['decision']}, as ordered",
            f"{100 * row['change']:.2g} %",
            f"{row['cost']:.3g} x",
            row["reason"],
        ]
        for row in plan.table().to_dict("records")
    ]
    _echo_table(title, heads, rows, left=len(heads))
    for sentence in (*plan.limits, *plan.messages):
        click.echo(sentence)


def echo_tradeoff(table: "pd.DataFrame") -> None:
    """Print a table a knob: its settings with error and time; a star where none is cheaper and better."""
    from contactimg.tradeoff.sentences import error_text, time_text

    for knob, part in table.groupby("knob", sort=False):
        reference = part["reference"].iloc[0]
        rows = [
            [
                ("* " if row["pareto"] == 1 else "  ") + row["setting"],
                row["message"] if isnan(row["error"]) else _other(row["reference"], reference),
                "" if isnan(row["error"]) else error_text(row["error"]),
                "" if isnan(row["time_s"]) else time_text(row["time_s"]),
                _number(row["time_ratio"], "{:.3g}"),
            ]
            for row in part.to_dict("records")
        ]
        title = f"{knob}: error of the {part['output'].iloc[0]} against {reference}"
        _echo_table(title, ("setting", "", "error", "time", "ratio"), rows, left=2)


def _other(reference: str, usual: str) -> str:
    """A reference that is not the usual one."""
    return "" if reference == usual else f"against {reference}"


def _echo_timings(timings: Timings) -> None:
    """Print the stages on stderr: calls, seconds and share of the whole."""
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
    """Print a table; its first columns are text."""
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
    Console(highlight=False, markup=False, stderr=stderr).print(table)


def _cells(row: dict[str, Any]) -> list[str]:
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
    decimals = max(0, 1 - floor(log10(std)))
    return f"{value:.{decimals}f}({std * 10**decimals:.0f})" if decimals else f"{value:.0f} ± {std:.0f}"
