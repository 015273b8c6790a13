"""The tables that the page shows: those of the run, or of the last time it was measured again."""

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.files import read_run_table
from contactimg.pipeline.measured_frame import MeasuredFrame
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Schema

TABLES: dict[str, Schema] = {
    "contacts.csv": CONTACTS,
    "frames.csv": FRAMES,
    "rejected.csv": REJECTED,
    "outlines.csv": OUTLINES,
}
"""Files that the page may read from the folder of a run."""
CONTACT_COLUMNS = (
    "label", "x_px", "y_px", "radius_px", "radius_std_px", "flags", "shape", "semi_major_px", "semi_minor_px",
    "angle_rad", "area_m2", "force_N", "force_std_N", "x_m", "y_m", "asperity",
)  # fmt: skip
"""Columns of the contacts that the page uses."""


class ShownTables:
    """Tables of a run, frame by frame.

    Parameters
    ----------
    tables : dict
        Name of a file of `TABLES` -> its table.
    folder : Path or None
        Folder that holds the files.
    """

    def __init__(self, tables: dict[str, pd.DataFrame], folder: Path | None = None) -> None:
        self.folder, self._frames = folder, tables["frames.csv"]
        self._parts = {
            name: {str(frame): part for frame, part in table.groupby("frame", sort=False)}
            for name, table in tables.items()
            if name != "frames.csv"
        }

    @classmethod
    def read(cls, folder: Path, **known: pd.DataFrame) -> "ShownTables":
        """Read a run, which need not have rejected candidates or outlines; ``frames`` may be given."""
        read = {
            name: read_run_table(folder, schema, infinite=True, optional=True)
            for name, schema in TABLES.items()
            if schema.name not in known
        }
        return cls(read | {f"{name}.csv": table for name, table in known.items()}, folder)

    @classmethod
    def of_part(cls, part: MeasuredFrame) -> "ShownTables":
        """The tables of one frame, which are in no folder."""
        row = FRAMES.conform(pd.DataFrame([part.row]))
        return cls(
            dict(
                zip(
                    TABLES,
                    (part.tables.contacts, row, part.tables.rejected, part.tables.outlines),
                    strict=True,
                )
            )
        )

    def rows(self, name: str, frame: str) -> pd.DataFrame:
        """The rows of a table that are about one frame."""
        part = self._parts[name].get(frame)
        return TABLES[name].empty() if part is None else part

    def of_frame(self, frame: str) -> dict[str, Any]:
        """Contacts, rejected candidates, outlines and the row of one frame, for the page."""
        lines: dict[str, list[Any]] = {}
        for (label, _), part in self.rows("outlines.csv", frame).groupby(["label", "outline"]):
            lines.setdefault(str(label), []).append(part[["x_px", "y_px"]].to_numpy(float).tolist())
        contacts, rejected = (self.rows(name, frame) for name in ("contacts.csv", "rejected.csv"))
        return {
            "row": next(iter(plain_rows(self._frames[self._frames["frame"] == frame])), None),
            "contacts": _plain(contacts[list(CONTACT_COLUMNS)]).to_dict("list"),
            "rejected": _plain(rejected.drop(columns="frame")).to_dict("list"),
            "outlines": lines,
        }

    @cached_property
    def summaries(self) -> dict[str, dict[str, Any]]:
        """Name of a frame -> its status, number of contacts and load."""
        rows = plain_rows(self._frames[["status", "n_contacts", "load_N"]])
        return dict(zip(self._frames["frame"].tolist(), rows, strict=True))

    def text(self, name: str) -> bytes:
        """The file of a table; empty if the run has none."""
        path = None if self.folder is None else self.folder / name
        return path.read_bytes() if path is not None and path.exists() else b""


def _plain(table: pd.DataFrame) -> pd.DataFrame:
    """A table with None for what JSON does not have."""
    return table.astype(object).where(table.notna(), None).replace([np.inf, -np.inf], None)


def plain_rows(table: pd.DataFrame) -> list[dict[Any, Any]]:
    """Rows with None for what JSON does not have."""
    return _plain(table).to_dict("records")
