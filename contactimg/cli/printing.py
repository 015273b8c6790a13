"""What commands print for a person: progress bars and tables."""

import logging
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from math import inf, isnan
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click

from contactimg.engine.progress import shown_by

if TYPE_CHECKING:
    import pandas as pd

    from contactimg.effects.plan import Plan

Cells = Mapping[Any, Any]
"""Heading -> what stands in one row, or in all rows, below it; nothing for a number that is missing."""

WIDTH_OF_FILES = 160
"""Characters of a line where the output is a file or a pipe. Chosen: names of frames stay whole."""


def is_quiet() -> bool:
    """Whether the command that runs prints nothing but warnings and errors."""
    context = click.get_current_context(silent=True)
    return context is not None and context.params.get("quiet", False)


def say(*sentences: str, fault: bool = False) -> None:
    """Print the sentences that are not empty, one a line; of a quiet command those of a fault, as errors."""
    quiet = is_quiet()
    for sentence in sentences:
        if sentence and (fault or not quiet):
            click.echo(f"contactimg: {sentence}" if quiet else sentence, err=quiet)


@contextmanager
def progress_bars() -> Iterator[None]:
    """Show the loops inside the block as progress bars on standard error, one after another."""
    with ExitStack() as shown:  # an error leaves the generator of a loop open, and with it its bar

        @contextmanager
        def bar(text: str, total: int) -> Iterator[Callable[[], None]]:
            try:
                yield shown.enter_context(_progress(text, total))
            finally:
                shown.close()

        with shown_by(bar):
            yield


@contextmanager
def _progress(text: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar; call what it yields once per item."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from contactimg.compiled import telling_compilations

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), disable=is_quiet() or not total) as bar:
        task = bar.add_task(text, total=total)

        def tell(begun: int, declared: int) -> None:
            bar.update(task, description=f"{text} (compiling {begun} of at most {declared}, once)")

        with telling_compilations(tell):
            yield lambda: bar.update(task, advance=1, description=text)


def echo_frames(run: "pd.DataFrame", *, title: str) -> None:
    """Print the frames of a run in mN and mm^2, one line each; then what is to be said of them.

    Of a long run the first ones are printed, and how many more there are.
    """
    from contactimg.tables import FAILED, Status

    frames = run.head(1000)  # chosen: more than anybody reads there
    load, force = frames["load_N"], frames["force_sum_N"]
    columns = {
        "frame": frames["frame"],
        "status": frames["status"],
        "load mN": 1e3 * load,
        "contacts": frames["n_contacts"],
        "area mm²": [*map(_with_std, 1e6 * frames["area_m2"], 1e6 * frames["area_std_m2"])],
        "forces mN": [*map(_with_std, 1e3 * force, 1e3 * frames["force_sum_std_N"])],
        "forces/load": (force / load).where(load > 0),
    }
    echo_table(title, columns, left=2, forms={"load mN": "g", "forces/load": ".3f"})
    _echo_messages(frames)
    said = [status for status in Status if status.cure and (frames["status"] == status).any()]
    say(*(f'"{status}": {status.cure}' for status in said))
    if len(run) > len(frames):
        counts = ", ".join(f"{count:,} {status}" for status, count in run["status"].value_counts().items())
        more = f"and {len(run) - len(frames):,} more frames, in frames.csv; of all {len(run):,}: {counts}"
        say(more, fault=FAILED in counts)


def _echo_messages(frames: "pd.DataFrame") -> None:
    """Print what several frames have in common once, and one line of each frame that is not "ok"."""
    from contactimg.pipeline.results import alike_remarks
    from contactimg.tables import FAILED, NO_RESULT

    fine = set(frames.loc[frames["status"] == "ok", "frame"])
    useless = NO_RESULT if frames["status"].isin(NO_RESULT).all() else {FAILED}
    faulty = set(frames.loc[frames["status"].isin(useless), "frame"])
    whole = logging.getLogger("contactimg").isEnabledFor(logging.INFO)
    untold = 0
    for those, said in alike_remarks(frames, exact=(frames["status"] == "ok") | whole):
        many = "all frames" if len(those) == len(frames) else f"{len(those)} frames from {those[0]} on"
        text = f"{those[0] if len(those) == 1 else many}: {said}"
        if len(those) == 1 and those[0] in fine and not whole:
            untold += 1
            continue
        shown = text if whole else textwrap.shorten(text, WIDTH_OF_FILES, placeholder=" ... (--verbose)")
        say(shown, fault=not faulty.isdisjoint(those))
    if untold:
        say(f"remarks on {untold} of these frames are in frames.csv; --verbose prints them")


def echo_scores(scores: "pd.DataFrame", *, title: str) -> None:
    """Print the scores, one line per frame and model."""
    counts, ratios = ("measured", "predicted", "matched"), ("precision", "recall", "f1")
    shown = scores.rename(columns=lambda name: name.removeprefix("n_"))[["frame", "model", *counts, *ratios]]
    echo_table(title, shown, left=2, forms=dict.fromkeys(ratios, ".3f"))


def echo_results(results: "pd.DataFrame", *, title: str) -> None:
    """Print one row a quantity: that of the runs with its interval, and those of the models beside it.

    Variants of a quantity and what its fit is judged by stay in results.csv.
    """
    from contactimg.plots.numbers import in_display_units
    from contactimg.tables import VARIANTS

    table = in_display_units(results)
    table = table[~table["quantity"].str.endswith(VARIANTS)]
    if table.empty:
        return
    own, rows = table["model"].iloc[0], []
    for quantity, part in table.groupby("quantity", sort=False):
        found = dict.fromkeys(table["model"], "")
        found |= zip(part["model"], map(_with_std, part["value"], part["std"]), strict=True)
        ends = part.loc[part["model"] == own, ["low", "high"]].dropna().to_numpy(float)
        interval = "".join(f"{low:.4g} ... {high:.4g}" for low, high in ends)
        head = {"quantity": str(quantity), own: found.pop(own), "interval": interval}
        rows.append(head | found | {"unit": part["unit"].iloc[0]})
    echo_table(title, rows, left=1)


def echo_plan(plan: "Plan", *, title: str) -> None:
    """Print the decision on each effect, what matters most first; then limits and messages."""
    table = plan.table().sort_values("change", ascending=False, kind="stable")
    columns = {
        "effect": table["effect"],
        "number that decides": table["reason"],
        "decision": table["decision"] + table["switch"].map({"on": " (scene)", "off": " (scene)"}).fillna(""),
        "if left out": (100 * table["change"]).map("{:.2g} %".format),
    }
    echo_table(title, columns, left=3)
    say(*plan.limits, *plan.messages)


def echo_tradeoff(table: "pd.DataFrame") -> None:
    """Print one table per choice; a star marks the settings that no other one beats in error and time."""
    from contactimg.tradeoff.measure import error_text, time_text

    for knob, part in table.groupby("knob", sort=False):
        usual = part["reference"].iloc[0]
        other = ("against " + part["reference"]).where(part["reference"] != usual, "")
        columns = {
            "setting": part["pareto"].map({1: "* "}).fillna("  ") + part["setting"],
            "": part["message"].where(part["error"].isna(), other),
            "error": part["error"].map(error_text, na_action="ignore"),
            "time": part["time_s"].map(time_text, na_action="ignore"),
            "ratio": part["time_ratio"],
        }
        output = part["output"].iloc[0]
        what = "largest error of any output" if output == "all" else f"error of the {output}"
        echo_table(f"{knob}: {what}, compared with: {usual}", columns, left=2, forms={"ratio": ".3g"})


def echo_timings(seconds: Mapping[str, float]) -> None:
    """Print the steps on standard error, the longest first: seconds and share; those below 1 % as one."""
    total = sum(seconds.values())
    long = {step: time for step, time in seconds.items() if time >= 0.01 * total}
    steps = sorted(long.items(), key=lambda step: -step[1])
    steps += [("steps below 1 %", total - sum(long.values())), ("total", total)]
    rows = [{"step": name, "s": time, "share": time / total} for name, time in steps]
    echo_table("where the time went", rows, left=1, forms={"s": ".3f", "share": ".1%"}, stderr=True)


def echo_table(
    title: str,
    rows: "pd.DataFrame | Sequence[Cells] | Cells",
    *,
    left: int,
    forms: Mapping[str, str] = MappingProxyType({}),
    stderr: bool = False,
) -> None:
    """Print a table without its empty columns; the first ``left`` columns are text, the others numbers.

    ``rows`` are a table, its rows, or its columns by their headings. ``forms`` says how the numbers below a
    heading are written.
    """
    if is_quiet() and not stderr:
        return
    import pandas as pd
    from rich import box
    from rich.console import Console
    from rich.table import Table

    cells = pd.DataFrame(rows, dtype=object)
    for head in map(str, cells):
        cells[head] = ["" if pd.isna(one) else format(one, forms.get(head, "")) for one in cells[head]]
    grid = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for place, head in enumerate(map(str, cells)):
        if cells[head].any():
            grid.add_column(head, justify="left" if place < left else "right", overflow="fold")
    for row in cells.loc[:, cells.any()].itertuples(index=False):
        grid.add_row(*row)
    console = Console(highlight=False, markup=False, stderr=stderr)
    if not console.is_terminal:
        console.width = max(console.width, WIDTH_OF_FILES)
    console.print(grid)


def _with_std(value: float, std: float) -> str:
    """A value as in figures, or with the uncertainty of its last digits in brackets: 0.0510(12)."""
    from contactimg.plots.numbers import decimals, number_with_std

    places = decimals(std) if 0 < std < inf else 0
    if places > 0 and 1e-3 <= abs(value) < 1e5:
        return f"{value:.{places}f}({std * 10**places:.0f})"
    return "" if isnan(value) else number_with_std(value, std)
