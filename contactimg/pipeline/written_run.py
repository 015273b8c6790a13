"""Write a measured series to a folder, a few frames at a time."""

from array import array
from collections import Counter
from collections.abc import Container, ItemsView, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from contactimg.effects.local_law import LawPlan
from contactimg.files import EncodedRows, TableFormat, TableWriter
from contactimg.imaging.fit.film_choice import summarise_films
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.pipeline.measured_series import MeasuredSeries
from contactimg.pipeline.run import Run, pose_record
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED

_TABLES = (CONTACTS, FRAMES, REJECTED, OUTLINES)

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
    film : str
        What the rims say of an air film, in a line; empty where none was looked for.
    record : dict
        What the provenance must state.
    """

    frames: pd.DataFrame
    statuses: Counter[str]
    measurable: bool
    law: LawPlan | None
    film: str
    record: dict[str, Any]


def write_run(series: MeasuredSeries, folder: Path, table_format: TableFormat = "csv") -> WrittenRun:
    """Write contacts, frames, rejected and, if any, outlines, a few frames at a time."""
    shown, statuses, measurable, law = [FRAMES.empty()], Counter[str](), False, None
    films, choices = _OfFrames(series.parts, "film"), _OfFrames(series.parts, "choice")
    with ExitStack() as stack:
        tables = [stack.enter_context(TableWriter(schema, folder, table_format)) for schema in _TABLES]
        for block in series.of_blocks(partial(_EncodedBlock.of, table_format)):
            for table, rows in zip(tables, block.tables, strict=True):
                table.append(rows)
            films.add(statuses.total(), block.frames["frame"], block.films)
            choices.add(statuses.total(), block.frames["frame"], block.choices)
            if statuses.total() < MOST_SHOWN:
                shown.append(block.frames)
            statuses.update(block.frames["status"])
            measurable |= bool(block.frames[["area_m2", "n_contacts"]].notna().any(axis=None))
            law = law or block.law
    if not tables[-1].rows:
        tables[-1].path.unlink()
    frames = FRAMES.conform(pd.concat(shown[1:] or shown, ignore_index=True))
    record: dict[str, Any] = {} if series.pose is None else {"pose": pose_record(series.pose)}
    if law is not None:
        record["law"] = law.sentence()
    record |= {name: found for name, found in (("film", films), ("methods", choices)) if found}
    film = summarise_films(films.found()) if films else ""
    return WrittenRun(frames, statuses, measurable, law, film, record)


@dataclass(frozen=True, eq=False)
class _EncodedBlock:
    """A block as it is written: made in any process."""

    tables: tuple[EncodedRows, ...]
    frames: pd.DataFrame
    law: LawPlan | None
    films: frozenset[str]
    choices: frozenset[str]

    @classmethod
    def of(cls, table_format: TableFormat, run: Run) -> "_EncodedBlock":
        """The tables of a block encoded, and the names of frames with a film or a choice."""
        tables = tuple(EncodedRows.of(getattr(run, schema.name), schema, table_format) for schema in _TABLES)
        return cls(tables, run.frames, run.law, frozenset(run.films), frozenset(run.choices))


class _OfFrames(Mapping[str, dict[str, Any]]):
    """Frame -> what its measurement says of a matter, for the provenance; made when it is asked for."""

    def __init__(self, parts: Sequence[MeasuredFrame], matter: str) -> None:
        self._parts, self._matter = parts, matter
        self._numbers = array("q")

    def add(self, first: int, frames: Iterable[str], concerned: Container[str]) -> None:
        """Add frames that begin at a number, those that the matter concerns."""
        self._numbers.extend(k for k, name in enumerate(frames, first) if name in concerned)

    def __len__(self) -> int:
        return len(self._numbers)

    def __iter__(self) -> Iterator[str]:
        return (self._parts[k].row["frame"] for k in self._numbers)

    def __getitem__(self, frame: str) -> dict[str, Any]:
        for name, found in zip(self, self.found(), strict=True):
            if name == frame:
                return asdict(found)
        raise KeyError(frame)

    def items(self) -> "_Items":
        """Frames with what their measurements say, each read once."""
        return _Items(self)

    def found(self) -> Iterator[Any]:
        """What the measurements say, as it is."""
        return (getattr(self._parts[k], self._matter) for k in self._numbers)


class _Items(ItemsView[str, dict[str, Any]]):
    """Items of `_OfFrames`."""

    _mapping: _OfFrames

    def __iter__(self) -> Iterator[tuple[str, dict[str, Any]]]:
        return (
            (name, asdict(found)) for name, found in zip(self._mapping, self._mapping.found(), strict=True)
        )
