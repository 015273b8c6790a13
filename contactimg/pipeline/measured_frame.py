"""One frame's part of a run, in pixels; its tables may be left in a part file."""

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.files import read_part
from contactimg.imaging.fit.film_choice import FilmVerdict
from contactimg.imaging.profile.optics import SharedOptics
from contactimg.pipeline.parallel import FailedFrame
from contactimg.tables import CONTACTS, OUTLINES, REJECTED, SHARED_SHIFTS
from contactimg.tradeoff.choice import Choice

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class FrameTables:
    """The tables of a measured frame.

    Parameters
    ----------
    contacts, rejected : DataFrame
    outlines : DataFrame
        Of its contacts of free shape.
    """

    contacts: pd.DataFrame = field(default_factory=CONTACTS.empty)
    rejected: pd.DataFrame = field(default_factory=REJECTED.empty)
    outlines: pd.DataFrame = field(default_factory=OUTLINES.empty)


@dataclass(frozen=True)
class SumOfCubes:
    """Standard uncertainties of the sum of the cubes of the radii of a frame's contacts, by their source.

    Parameters
    ----------
    contacts : int
        Number of contacts.
    own : float, px^3
        From the independent errors of the radii.
    contrast, blur : float, px^3
        From what the contacts share: the contrast with the correlated blur, and the rest of the blur.
    edge : float, px^3
        From what the frame does not decide about its edges.
    """

    contacts: int
    own: float
    contrast: float
    blur: float
    edge: float

    @classmethod
    def of(cls, contacts: pd.DataFrame) -> "SumOfCubes":
        """Those of a contacts table."""
        slope = 3.0 * contacts["radius_px"].to_numpy(float) ** 2
        shifts = contacts[list(SHARED_SHIFTS)].to_numpy(float)
        alone = np.maximum(contacts["radius_std_px"].to_numpy(float) ** 2 - np.sum(shifts**2, axis=1), 0.0)
        return cls(len(contacts), float(np.sqrt(slope**2 @ alone)), *map(float, slope @ shifts))


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """One frame's part of a run.

    Parameters
    ----------
    row : dict
        Its row of the frames table.
    shape : (int, int) or None
        Rows and columns; None for a frame that failed.
    where : FrameTables, str or None
        Its tables, or the part file that holds them.
    own_optics : SharedOptics or None
        Contrast (grey levels) and blur that the frame alone shows; None where it shows nothing.
    level : float
        Grey level of its background; 0 where that was subtracted before.
    choice : Choice or None
        How it was measured and why, where that was chosen for a tolerance.
    film : FilmVerdict or None
        What its rims say of an air film; None where none was looked for.
    cubes : SumOfCubes or None
        None for a frame that failed.
    """

    row: dict[str, Any]
    shape: tuple[int, int] | None
    where: FrameTables | str | None
    own_optics: SharedOptics | None = None
    level: float = 0.0
    choice: Choice | None = None
    film: FilmVerdict | None = None
    cubes: SumOfCubes | None = None

    @classmethod
    def failed(cls, failure: FailedFrame) -> "MeasuredFrame":
        """The part of a frame that could not be measured: empty tables and a row that says why."""
        return cls(failure.row, None, FrameTables())

    @property
    def tables(self) -> FrameTables:
        """Its tables, read from the part file each time if they are there."""
        if isinstance(self.where, FrameTables):
            return self.where
        tables: FrameTables = read_part(str(self.where), 1)
        return tables

    @property
    def contacts(self) -> pd.DataFrame:
        """Its contacts."""
        return self.tables.contacts

    @property
    def relative_optics(self) -> SharedOptics | None:
        """Its own optics with the contrast divided by the background, so that drifts of the lamp cancel."""
        return None if self.own_optics is None else self.own_optics.scaled(1.0 / (self.level or 1.0))

    def with_contacts(self, contacts: pd.DataFrame) -> "MeasuredFrame":
        """Return the frame with other contacts."""
        return replace(self, where=replace(self.tables, contacts=contacts), cubes=SumOfCubes.of(contacts))

    def with_remarks(self, *remarks: object) -> "MeasuredFrame":
        """Return the frame with remarks added to its message, if there are any."""
        message = "; ".join(str(text) for text in (self.row["message"], *remarks) if text)
        return replace(self, row=self.row | {"message": message})

    def parts(self) -> tuple["MeasuredFrame", FrameTables]:
        """Return the frame without its tables, and the tables; most steps of a series need the first only."""
        return replace(self, where=None), self.tables

    def kept_in(self, path: Path) -> "MeasuredFrame":
        """Return the frame with its tables left in a part file."""
        return replace(self, where=str(path))

    def log(self, before: str = "") -> None:
        """Log one line about the frame."""
        if logger.isEnabledFor(logging.INFO):
            numbers = (f"{key} {value:.4g}" for key, value in self.row.items() if isinstance(value, float))
            count = self.row.get("n_contacts", pd.NA)
            head = f"{self.row['frame']}: {self.row['status']}, {0 if pd.isna(count) else count} contacts, "
            logger.info("%s%s", before, head + ", ".join(numbers))
