"""Write a measured series to a folder, a few frames at a time."""

from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.effects.local_law import LawPlan
from contactimg.files import TableFormat, TableWriter
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.run import pose_record
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED
from contactimg.tradeoff.choice import Choice

MOST_SHOWN = 1000
"""Frames of a run whose rows stay in memory, for the terminal. Chosen: more than anybody reads there."""


@dataclass(frozen=True)
class WrittenRun:
    """What stays in memory of a run that was written.

    Attributes
    ----------
    frames : DataFrame
        The first rows of the frames table, at most about `MOST_SHOWN`.
    statuses : Counter
        Status -> number of frames, of all.
    measurable : bool
        Whether any frame shows something that can be measured.
    law : LawPlan or None
        Law of the local forces; None without forces.
    films : dict
        Frame -> what its rims say of an air film, where one was looked for.
    record : dict
        What the provenance must state.
    """

    frames: pd.DataFrame
    statuses: Counter[str]
    measurable: bool
    law: LawPlan | None
    films: dict[str, FilmVerdict]
    record: dict[str, Any]


def write_run(series: MeasuredSeries, folder: Path, table_format: TableFormat = "csv") -> WrittenRun:
    """Write contacts, frames, rejected and, if any, outlines, a few frames at a time."""
    shown, statuses, measurable, law = [FRAMES.empty()], Counter[str](), False, None
    films, choices = dict[str, FilmVerdict](), dict[str, Choice]()
    with ExitStack() as stack:
        tables = [
            stack.enter_context(TableWriter(schema, folder, table_format))
            for schema in (CONTACTS, FRAMES, REJECTED, OUTLINES)
        ]
        for block in series.blocks():
            for table in tables:
                table.add(getattr(block, table.schema.name))
            if statuses.total() < MOST_SHOWN:
                shown.append(block.frames)
            statuses.update(block.frames["status"])
            measurable |= bool(block.frames[["area_m2", "n_contacts"]].notna().any(axis=None))
            films |= block.films
            choices |= block.choices
            law = law or block.law
    if not tables[-1].rows:
        tables[-1].path.unlink()
    frames = FRAMES.conform(pd.concat(shown[1:] or shown, ignore_index=True))
    record = _record(series, law, films, choices)
    return WrittenRun(frames, statuses, measurable, law, films, record)


def _record(
    series: MeasuredSeries,
    law: LawPlan | None,
    films: dict[str, FilmVerdict],
    choices: dict[str, Choice],
) -> dict[str, Any]:
    """What the provenance must state of a series."""
    record: dict[str, Any] = {} if series.pose is None else {"pose": pose_record(series.pose)}
    if law is not None:
        record["law"] = law.sentence()
    if films:
        record["film"] = {frame: asdict(verdict) for frame, verdict in films.items()}
    if choices:
        record["methods"] = {frame: asdict(choice) for frame, choice in choices.items()}
    return record
