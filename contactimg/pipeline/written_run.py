"""Write a measured series to a folder, a few frames at a time."""

from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.effects.local_law import LawPlan
from contactimg.files import TableFormat, TableWriter
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.run import pose_record
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED


@dataclass(frozen=True)
class WrittenRun:
    """What stays in memory of a run that was written.

    Attributes
    ----------
    frames : DataFrame
        The frames table.
    law : LawPlan or None
        Law of the local forces; None without forces.
    record : dict
        What the provenance must state.
    """

    frames: pd.DataFrame
    law: LawPlan | None
    record: dict[str, Any]


def write_run(series: MeasuredSeries, folder: Path, table_format: TableFormat = "csv") -> WrittenRun:
    """Write contacts, frames, rejected and, if any, outlines, a few frames at a time."""
    frames, law = [FRAMES.empty()], None
    with ExitStack() as stack:
        tables = [
            stack.enter_context(TableWriter(schema, folder, table_format))
            for schema in (CONTACTS, FRAMES, REJECTED, OUTLINES)
        ]
        for block in series.blocks():
            for table in tables:
                table.add(getattr(block, table.schema.name))
            frames.append(block.frames)
            law = law or block.law
    if not tables[-1].rows:
        tables[-1].path.unlink()
    whole = FRAMES.conform(pd.concat(frames[1:] or frames, ignore_index=True))
    return WrittenRun(whole, law, _record(series, law))


def _record(series: MeasuredSeries, law: LawPlan | None) -> dict[str, Any]:
    """What the provenance must state of a series."""
    record: dict[str, Any] = {} if series.pose is None else {"pose": pose_record(series.pose)}
    if law is not None:
        record["law"] = law.sentence()
    if series.films:
        record["film"] = {frame: asdict(verdict) for frame, verdict in series.films.items()}
    if series.choices:
        record["methods"] = {frame: asdict(choice) for frame, choice in series.choices.items()}
    return record
