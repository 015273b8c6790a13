"""Measure the trade-off of a case: the knobs that apply, one table, one sentence per knob."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import pandas as pd

from contactimg.errors import InputError
from contactimg.tables import TRADEOFF
from contactimg.tradeoff.case import Case
from contactimg.tradeoff.image_knobs import image_knob, supersampling_knob
from contactimg.tradeoff.knobs import Knob, measure_knob
from contactimg.tradeoff.model_knobs import model_knob, pattern_knob, ring_knob, solver_knob
from contactimg.tradeoff.recommendations import knob_sentence
from contactimg.tradeoff.sum_knob import sum_knob


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """Errors and times of the settings of every knob.

    Parameters
    ----------
    table : DataFrame
        Columns of `contactimg.tables.TRADEOFF`.
    sentences : dict
        Knob -> recommended setting, as a sentence.
    relative : float
        Tolerance that the sentences refer to.
    left_out : dict
        Knob -> reason why it does not apply to the scene.
    """

    table: pd.DataFrame
    sentences: dict[str, str]
    relative: float
    left_out: dict[str, str]


def _need_mechanics(case: Case) -> str:
    """What the scene lacks for contact models; empty for nothing."""
    missing = [
        name
        for name, section in (
            ("[indenter]", case.scene.indenter),
            ("[elastic]", case.scene.elastic),
            ("[asperities] with a file or a generator", case.asperities),
        )
        if section is None
    ]
    if missing:
        return f"needs {', '.join(missing)}"
    return "" if case.load > 0 else "needs a load above 0"


def _need_averages(case: Case) -> str:
    """What the scene lacks for the statistical models, which need no table."""
    if case.scene.indenter is None or case.scene.elastic is None or case.scene.asperities is None:
        return "needs [indenter], [elastic] and [asperities]"
    stated = case.scene.asperities.height_law is not None and case.scene.asperities.radius is not None
    if case.asperities is None and not stated:
        return "needs a table of asperities, or the parameters of a height law"
    return "" if case.load > 0 else "needs a load above 0"


def _need_frames(case: Case) -> str:
    """What the scene lacks to measure a frame."""
    if case.measured is not None:
        return ""
    return _need_rendering(case) + " or frames of its own" if _need_rendering(case) else ""


def _need_rendering(case: Case) -> str:
    """What the scene lacks to render a frame."""
    missing = [f"[{name}]" for name in ("camera", "simulate") if getattr(case.scene, name) is None]
    return f"needs {' and '.join(missing)}" if missing else _need_mechanics(case)


KNOBS: dict[str, tuple[Callable[[Case], Knob], Callable[[Case], str]]] = {
    "image": (image_knob, _need_frames),
    "model": (model_knob, _need_mechanics),
    "solver": (solver_knob, _need_mechanics),
    "sums": (sum_knob, _need_mechanics),
    "rings": (ring_knob, _need_averages),
    "patterns": (pattern_knob, _need_mechanics),
    "supersampling": (supersampling_knob, _need_rendering),
}
"""Knob -> function that builds it, and function that says what a case lacks for it."""


def applicable_knobs(case: Case, names: Sequence[str] = ()) -> tuple[list[Knob], dict[str, str]]:
    """The knobs that apply to a case, and why the others do not.

    Parameters
    ----------
    case : Case
    names : sequence of str
        Names from `KNOBS`; all if empty.

    Raises
    ------
    InputError
        If no knob applies (with the reasons) or a name is unknown.
    """
    unknown = [name for name in names if name not in KNOBS]
    if unknown:
        raise InputError(f"knob must be one of {', '.join(map(repr, KNOBS))}, got {unknown[0]!r}")
    wanted = {name: KNOBS[name] for name in KNOBS if not names or name in names}
    left_out = {name: lacks for name, (_, need) in wanted.items() if (lacks := need(case))}
    if len(left_out) == len(wanted):
        by_reason = {lacks: [k for k in left_out if left_out[k] == lacks] for lacks in left_out.values()}
        reasons = (f"{', '.join(names)}: {lacks}" for lacks, names in by_reason.items())
        raise InputError(f"nothing to trade accuracy against time on; {'; '.join(reasons)}")
    return [build(case) for name, (build, _) in wanted.items() if name not in left_out], left_out


def _check_any_ran(tables: Sequence[pd.DataFrame]) -> None:
    """Raise `InputError` if every setting failed."""
    rows = pd.concat(tables, ignore_index=True)
    if rows["time_s"].isna().all():
        knobs = ", ".join(dict.fromkeys(rows["knob"]))
        raise InputError(f"no setting of {knobs} could be run: {rows['message'].iloc[0]}")


def run_knobs(
    knobs: Sequence[Knob],
    *,
    relative: float,
    seconds: float,
    left_out: dict[str, str] | None = None,
    advance: Callable[[], None] | None = None,
    clock: Callable[[], float] = perf_counter,
) -> Tradeoff:
    """Measure knobs one after another.

    Parameters
    ----------
    knobs : sequence of Knob
    relative : float
        Relative error that the sentences are for.
    seconds : float
        Time for the repetitions of all knobs, s, in addition to the first run of each setting.
    left_out : dict, optional
        Passed on to the result.
    advance : callable, optional
        Called once per setting.
    clock : callable
        As for `measure_knob`.

    Raises
    ------
    InputError
        If no setting can be run.
    """
    each = seconds / len(knobs)
    tables = [measure_knob(knob, seconds=each, advance=advance, clock=clock) for knob in knobs]
    _check_any_ran(tables)
    sentences = {
        knob.name: knob_sentence(knob.title, table, relative=relative)
        for knob, table in zip(knobs, tables, strict=True)
    }
    return Tradeoff(
        TRADEOFF.conform(pd.concat(tables, ignore_index=True)), sentences, relative, dict(left_out or {})
    )
