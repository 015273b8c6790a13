"""A run for other programs, and regions that were drawn there as corrections by hand."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from contactimg.engine.progress import counted
from contactimg.errors import InputError
from contactimg.files import FrameSource, FrameTables, Run, exports, open_experiment
from contactimg.pipeline.pictures import file_stem
from contactimg.tables import CONTACTS, EDITS, FRAMES, REJECTED
from contactimg.tables.outlines import REJECTED_COLOUR, kind_of

Regions = Iterable[exports.Region]

REJECTED_PREFIX = "rejected_"
"""Prefix of the names of regions that are no contacts; they may be deleted or kept."""


def export_run(run: Run, folder: Path, *, formats: Collection[str], units: str) -> None:
    """Write the tables of a run in other formats.

    Parameters
    ----------
    run : Run
    folder : Path
        Where to write; exists.
    formats : collection of {"fiji", "napari", "labels", "xlsx"}
    units : {"um", "mm", "m"}
        Of the workbook.

    Raises
    ------
    InputError
        If the frames are needed and not found, or a table does not fit.
    """
    if "xlsx" in formats:
        tables = [(FRAMES, run.frames), (CONTACTS, run.contacts), (REJECTED, run.rejected)]
        exports.write_workbook(tables, folder / "contacts.xlsx", units=units)
    for name in {"fiji", "napari", "labels"} & set(formats):
        (folder / name).mkdir()
    sources = frame_sources(run) if {"fiji", "labels"} & set(formats) else {}
    for frame, shown in counted(run.by_frame(), "exporting frames", len(run.frames)):
        shapes, stem = shown.shapes, file_stem(frame)
        image = sources[frame].read().image if frame in sources else None
        if "napari" in formats:
            exports.write_napari_shapes(shapes, folder / "napari" / f"{stem}_shapes.csv")
            exports.write_napari_points(shown.contacts, folder / "napari" / f"{stem}_points.csv")
        if "fiji" in formats:
            regions = contact_regions(shown) + rejected_regions(shown.rejected)
            exports.write_regions(regions, folder / "fiji" / f"{stem}.zip")
            if image is not None:
                file, camera = folder / "fiji" / f"{stem}_overlay.tif", run.scene.camera
                pixel_size = None if camera is None else camera.pixel_size
                exports.write_overlay(image, regions, file, pixel_size=pixel_size)
        if "labels" in formats and image is not None:
            exports.write_labels(shapes, image.shape, folder / "labels" / f"{stem}_labels.tif")


def contact_regions(shown: FrameTables) -> list[exports.Region]:
    """Contacts of one frame as regions, named and coloured by what they are."""
    return [
        exports.region_of(outline, name=region_name(outline.label), colour=kind_of(int(flags)).colour)
        for outline, flags in zip(shown.shapes, shown.contacts["flags"], strict=True)
    ]


def rejected_regions(rejected: pd.DataFrame) -> list[exports.Region]:
    """Rejected candidates of one frame as regions."""
    regions = []
    places = rejected[["x_px", "y_px", "radius_px"]].to_numpy(float).tolist()
    for number, ((x, y, r), reason) in enumerate(zip(places, rejected["reason"], strict=True), start=1):
        name = f"{REJECTED_PREFIX}{number:04d} {reason.partition(':')[0]}".replace("/", " ")
        regions.append(exports.Region(0, x, y, max(r, 1.0), max(r, 1.0), name=name, colour=REJECTED_COLOUR))
    return regions


def region_name(label: int) -> str:
    """Name of the region of a contact: its label.

    Examples
    --------
    >>> region_name(12)
    'contact_0012'
    """
    return f"contact_{label:04d}"


def frame_sources(run: Run) -> dict[str, FrameSource]:
    """The frames of a run as they were recorded, by name; without those that failed.

    Raises
    ------
    InputError
        If the run is a prediction, or the frames are not found.
    """
    if run.command == "predict":
        raise InputError(f"{run.folder}: has no frames; only --napari and --xlsx can be exported")
    frames = open_experiment(run.scene).frames
    failed = set(run.frames.loc[run.frames["n_contacts"].isna(), "frame"])
    return {frame.name: replace(frame, correct=None) for frame in frames if frame.name not in failed}


def edits_from_regions(run: Run, path: Path, *, frame: str | None, author: str, time: str) -> pd.DataFrame:
    """Edits that turn an exported frame into the regions of a file.

    Parameters
    ----------
    run : Run
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
    tables = dict(run.by_frame())
    stems = {file_stem(name): name for name in tables}
    name = frame or stems.get(path.stem) or stems.get(path.stem.removesuffix("_overlay"), "")
    if name not in tables:
        called = f"{path}: no frame of {run.folder} is called {frame or 'so'}"
        raise InputError(f"{called}; name the frame with --frame")
    shown, corrected = tables[name], exports.read_regions(path)
    edits = edits_between(shown.contacts, contact_regions(shown), corrected, program="ImageJ")
    return edits.assign(frame=name, author=author, time=time)


def edits_between(contacts: pd.DataFrame, before: Regions, after: Regions, *, program: str) -> pd.DataFrame:
    """Edits that turn the regions of a frame's contacts into those that came back.

    Parameters
    ----------
    contacts : DataFrame
        Of one frame, columns of `contactimg.tables.CONTACTS`.
    before, after : iterable of Region
        As exported, and as corrected; contacts are known by their names (`region_name`).
    program : str
        In which they were changed, for the column reason.

    Returns
    -------
    DataFrame
        Columns of `contactimg.tables.EDITS`, without frame, author and time.
    """
    names = contacts["label"].map(region_name)
    places = contacts[["x_px", "y_px"]].astype(float).set_axis(names).T.to_dict()
    known, rows = {region.name: region for region in before}, list[dict[str, object]]()
    for region in after:
        if region.name.startswith(REJECTED_PREFIX):
            continue
        place, why = places.pop(region.name, None), "drawn"  # only the first of its name is that contact
        if place is not None:
            ours = (region, known[region.name])
            now, old = ((one.x, one.y, one.semi_major, one.semi_minor) for one in ours)
            # chosen: well above the rounding of ImageJ's numbers (1e-4 px), well below what a hand can mean
            if np.abs(np.subtract(now, old)).max() < 0.02:
                continue
            why = "moved"
            rows.append(place | {"action": "exclude", "reason": f"moved in {program}"})
        new = {"x_px": region.x, "y_px": region.y, "radius_px": region.radius}
        rows.append(new | {"action": "add", "reason": f"{why} in {program}"})
    gone = [place | {"action": "exclude", "reason": f"deleted in {program}"} for place in places.values()]
    columns = ["action", "x_px", "y_px", "radius_px", "reason"]
    return EDITS.conform(pd.DataFrame([*gone, *rows], columns=columns))
