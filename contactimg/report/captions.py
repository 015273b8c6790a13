"""Captions of pictures of frames: sentences with the numbers of the frame."""

import pandas as pd

from contactimg.files import Run
from contactimg.plots.numbers import number_with_std, plain_number


def frame_caption(run: Run, frame: str) -> str:
    """What is seen on a frame: its load, contacts and area.

    Parameters
    ----------
    run : Run
    frame : str
        Of the table of frames.
    """
    row = run.frames[run.frames["frame"] == frame].iloc[0]
    parts = [f"{frame}{_load(row)}"]
    if pd.notna(row["n_contacts"]):
        count = int(row["n_contacts"])
        parts.append("one contact" if count == 1 else f"{count} contacts")
    if pd.notna(row["area_m2"]):
        parts.append(f"area {number_with_std(1e6 * row['area_m2'], 1e6 * row['area_std_m2'])} mm²")
    return f"{', '.join(parts)}; status {row['status']}."


def comparison_caption(run: Run, frame: str) -> str:
    """What is seen on a frame with predictions.

    Parameters
    ----------
    run : Run
    frame : str
        Of the table of frames.
    """
    load = _load(run.frames[run.frames["frame"] == frame].iloc[0])
    return f"Measured and predicted contacts on {frame}{load}."


def _load(row: pd.Series) -> str:
    """The load, where it is known."""
    return f" at {plain_number(1e3 * row['load_N'])} mN" if pd.notna(row["load_N"]) else ""
