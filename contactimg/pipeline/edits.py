"""Corrections by hand of an experiment: which frame gets which."""

import logging
from collections.abc import Collection, Mapping
from typing import Any

import pandas as pd

from contactimg.errors import InputError
from contactimg.files import Experiment, edit_points
from contactimg.files.corrections import EVERY_FRAME
from contactimg.imaging.detect.hand_edits import ACTIONS, HandEdit

logger = logging.getLogger(__name__)


def edits_by_frame(experiment: Experiment, *, relative: float | None) -> dict[str, tuple[HandEdit, ...]]:
    """Name of a frame -> corrections to its contacts, in the order of the table.

    An edit of a frame that is not there is logged as a warning.

    Raises
    ------
    InputError
        If contacts are to be corrected and the method is chosen by a tolerance, which may change from frame
        to frame.
    """
    edits: dict[str, list[HandEdit]] = {}
    names = [source.name for source in experiment.frames] if len(experiment.edits) else []
    known = {EVERY_FRAME, *names}
    for number, row in enumerate(experiment.edits.to_dict("records"), start=1):
        if row["frame"] not in known:
            logger.warning(
                "edits: row %s (%s) is for the frame %s, which is not there; the edit has no effect",
                number, row["action"], row["frame"],
            )  # fmt: skip
        elif row["action"] in ACTIONS:
            edit = _edit_of_row(row, number)
            for name in names if row["frame"] == EVERY_FRAME else [row["frame"]]:
                edits.setdefault(name, []).append(edit)
    if edits and relative is not None:
        raise InputError("edits correct the contacts of one method; leave out --tolerance, or the edits")
    return {name: tuple(rows) for name, rows in edits.items()}


def check_frames(edits: pd.DataFrame, names: Collection[str]) -> None:
    """Raise `InputError` if an edit is for a frame that is not there."""
    unknown = edits.loc[~edits["frame"].isin([EVERY_FRAME, *names]), "frame"]
    if len(unknown):
        raise InputError(f"edits: there is no frame {unknown.iloc[0]!r}")


def _edit_of_row(row: Mapping[Any, Any], number: int) -> HandEdit:
    """One row of the table as the measurement takes it."""
    points = edit_points(row["points"])
    return HandEdit(row["action"], number, row["x_px"], row["y_px"], row["radius_px"], points)


def edits_record(edits: pd.DataFrame) -> dict[str, Any]:
    """What the provenance says of the corrections: how many of each kind; empty without any."""
    counts = edits["action"].value_counts()
    return {"edits": {str(action): int(count) for action, count in counts.items()}} if len(edits) else {}
