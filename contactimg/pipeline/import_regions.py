"""Regions that come back from other programs as corrections by hand: moved, deleted and added contacts."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from contactimg.errors import InputError
from contactimg.files import RunFolder
from contactimg.files.imagej import Region, read_regions
from contactimg.pipeline.export import contact_regions, file_stem, label_of
from contactimg.tables import EDITS

SAME_PX = 0.02
"""Largest change of position or radius of a region that counts as none. Chosen: well above the rounding of
ImageJ's numbers (1e-4 px), well below what a hand can mean."""
REJECTED_PREFIX = "rejected_"
"""Of the names of regions that are no contacts; they may be deleted or kept."""


def edits_from_regions(
    run: RunFolder, path: Path, *, frame: str | None, author: str = "", time: str = ""
) -> pd.DataFrame:
    """What was changed between an exported frame and the regions of a file.

    Parameters
    ----------
    run : RunFolder
        The run that was exported.
    path : Path
        ImageJ regions of one frame (.zip, .roi, or a TIFF with its overlay).
    frame : str or None
        The frame they belong to; None: as the name of the file says.
    author, time : str
        For the columns of that name.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.EDITS`: a deleted contact is excluded, a new region added, a moved one
        both.

    Raises
    ------
    InputError
        If the file or its frame is not known.
    """
    frame = _frame_of(run, path) if frame is None else frame
    if frame not in set(run.frames["frame"]):
        raise InputError(f"{run.folder}: has no frame {frame!r}")
    contacts = run.contacts[run.contacts["frame"] == frame]
    lines = run.outlines
    exported = contact_regions(contacts, lines[lines["frame"] == frame])
    edits = edits_between(contacts, exported, read_regions(path), program="ImageJ")
    return edits.assign(frame=frame, author=author, time=time)


def edits_between(
    contacts: pd.DataFrame, exported: Iterable[Region], corrected: Iterable[Region], *, program: str
) -> pd.DataFrame:
    """What was changed between the regions of a frame's contacts and those that came back.

    Parameters
    ----------
    contacts : DataFrame
        Of one frame, columns of `contactimg.tables.CONTACTS`.
    exported, corrected : iterable of Region
        Before and after; contacts are known by their names (`contactimg.pipeline.export.region_name`).
    program : str
        In which they were changed, for the column reason.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.EDITS`, without frame, author and time.
    """
    columns = ["label", "x_px", "y_px", "radius_px"]
    places = {
        int(label): (x, y, radius) for label, x, y, radius in contacts[columns].astype(float).to_numpy()
    }
    before = {region.name: region for region in exported}
    rows: list[dict[str, object]] = []
    kept: set[int] = set()
    for region in corrected:
        if region.name.startswith(REJECTED_PREFIX):
            continue
        label = label_of(region.name)
        if label is None or label not in places or label in kept:
            rows.append(_row("add", (region.x, region.y, region.radius), f"drawn in {program}"))
            continue
        kept.add(label)
        if not _same(region, before[region.name]):
            rows.append(_row("exclude", places[label], f"moved in {program}"))
            rows.append(_row("add", (region.x, region.y, region.radius), f"moved in {program}"))
    gone = [_row("exclude", places[label], f"deleted in {program}") for label in sorted(places.keys() - kept)]
    return EDITS.conform(pd.DataFrame([*gone, *rows], columns=["action", *_PLACE, "reason"]))


_PLACE = ("x_px", "y_px", "radius_px")


def _row(action: str, place: tuple[float, float, float], reason: str) -> dict[str, object]:
    """One correction; the radius only where it is used."""
    radius = place[2] if action == "add" else np.nan
    return {"action": action, "x_px": place[0], "y_px": place[1], "radius_px": radius, "reason": reason}


def _same(region: Region, exported: Region) -> bool:
    """Whether a region is as it was exported."""
    names = ("x", "y", "radius_x", "radius_y")
    return all(abs(getattr(region, name) - getattr(exported, name)) < SAME_PX for name in names)


def _frame_of(run: RunFolder, path: Path) -> str:
    """The frame whose exported file has this name."""
    for frame in run.frames["frame"]:
        if path.stem in (file_stem(frame), f"{file_stem(frame)}_overlay"):
            return str(frame)
    raise InputError(f"{path}: its name is not that of an exported frame; name the frame with --frame")
