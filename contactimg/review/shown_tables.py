"""The tables that the page shows: those of the run, or of the last time it was measured again."""

from dataclasses import dataclass
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
COLUMNS = (
    "label", "x_px", "y_px", "radius_px", "radius_std_px", "flags", "shape", "semi_major_px", "semi_minor_px",
    "angle_rad", "area_m2", "force_N", "force_std_N", "x_m", "y_m", "asperity",
)  # fmt: skip
"""Of the contacts, that the page uses."""


@dataclass(frozen=True, eq=False)
class ShownTables:
    """Tables of a run, read from its folder.

    Parameters
    ----------
    folder : Path
    contacts, rejected, outlines : dict
        Name of a frame -> its rows.
    frames : DataFrame
    """

    folder: Path
    contacts: dict[str, pd.DataFrame]
    rejected: dict[str, pd.DataFrame]
    outlines: dict[str, pd.DataFrame]
    frames: pd.DataFrame

    @classmethod
    def read(cls, folder: Path) -> "ShownTables":
        """Those in a folder; a run need not have rejected candidates or outlines."""
        tables = {
            name: read_run_table(folder, schema, infinite=True, optional=True)
            for name, schema in TABLES.items()
        }
        groups = {name: _by_frame(tables[name]) for name in TABLES if name != "frames.csv"}
        return cls(
            folder,
            groups["contacts.csv"],
            groups["rejected.csv"],
            groups["outlines.csv"],
            tables["frames.csv"],
        )

    @classmethod
    def of_part(cls, part: MeasuredFrame) -> "ShownTables":
        """Those of one frame, which are in no folder."""
        name, row = str(part.row["frame"]), FRAMES.conform(pd.DataFrame([part.row]))
        tables = part.tables
        return cls(Path(), {name: tables.contacts}, {name: tables.rejected}, {name: tables.outlines}, row)

    def of_frame(self, name: str) -> dict[str, Any]:
        """Contacts, rejected candidates, outlines and the row of one frame, for the page."""
        row = self.frames[self.frames["frame"] == name]
        return {
            "row": None if row.empty else _plain(row).iloc[0].to_dict(),
            "contacts": _columns(self.contacts.get(name, CONTACTS.empty()), COLUMNS),
            "rejected": _columns(
                self.rejected.get(name, REJECTED.empty()), ("x_px", "y_px", "radius_px", "reason")
            ),
            "outlines": _lines(self.outlines.get(name, OUTLINES.empty())),
        }

    def summary(self, name: str) -> dict[str, Any]:
        """Name, status, number of contacts and load of a frame."""
        return {"name": name, "status": "not measured", "n_contacts": None, "load_N": None} | self._rows.get(
            name, {}
        )

    @cached_property
    def _rows(self) -> dict[str, dict[str, Any]]:
        """Name of a frame -> status, number of contacts and load."""
        names = ["status", "n_contacts", "load_N"]
        columns = [_plain(self.frames[names])[name].tolist() for name in names]
        rows = (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))
        return dict(zip(self.frames["frame"].tolist(), rows, strict=True))

    def text(self, name: str) -> bytes:
        """The file of a table; empty if the run has none."""
        path = self.folder / name
        return path.read_bytes() if path.exists() else b""


def _by_frame(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Name of a frame -> its rows."""
    return {str(name): part for name, part in table.groupby("frame", sort=False)}


def _plain(table: pd.DataFrame) -> pd.DataFrame:
    """With None for what JSON does not have."""
    return table.astype(object).where(table.notna(), None).replace([np.inf, -np.inf], None)


def _columns(table: pd.DataFrame, names: tuple[str, ...]) -> dict[str, list[Any]]:
    """Columns as lists."""
    plain = _plain(table[list(names)])
    return {name: plain[name].tolist() for name in names}


def _lines(outlines: pd.DataFrame) -> dict[str, list[list[list[float]]]]:
    """Label of a contact -> its outlines, each a list of x, y."""
    lines: dict[str, list[list[list[float]]]] = {}
    for (label, _), part in outlines.groupby(["label", "outline"]):
        lines.setdefault(str(label), []).append(part[["x_px", "y_px"]].to_numpy(float).tolist())
    return lines
