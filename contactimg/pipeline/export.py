"""A run in the formats of other programs: ImageJ, napari, label images, Excel."""

import re
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files import FrameSource, RunFolder, open_experiment, read_run_table
from contactimg.files.imagej import Region, region_of, write_overlay_tiff, write_regions
from contactimg.files.labels import write_labels
from contactimg.files.napari_tables import write_napari_points, write_napari_shapes
from contactimg.files.workbook import write_workbook
from contactimg.tables import CONTACTS, FRAMES, OUTLINES, REJECTED, Flag
from contactimg.tables.contact_kinds import (
    CONTACT_COLOUR,
    FLAGGED_COLOUR,
    MANUAL_COLOUR,
    REJECTED_COLOUR,
)
from contactimg.tables.outlines import contact_outlines

_NAME = re.compile(r"contact_(\d+)")


def export_run(
    run: RunFolder,
    folder: Path,
    *,
    formats: Collection[str],
    units: str,
    advance: Callable[[], None] | None = None,
) -> None:
    """Write the tables of a run in other formats.

    Parameters
    ----------
    run : RunFolder
    folder : Path
        Where to write; exists.
    formats : collection of {"fiji", "napari", "labels", "xlsx"}
    units : {"um", "mm", "m"}
        Of the workbook.
    advance : callable, optional
        Called once a frame.

    Raises
    ------
    InputError
        If the frames are needed and not found, or a table does not fit.
    """
    if "xlsx" in formats:
        tables = [(FRAMES, run.frames), (CONTACTS, run.contacts), (REJECTED, rejected_of(run))]
        write_workbook(tables, _about(run), folder / "contacts.xlsx", units=units)
    per_frame = [name for name in ("fiji", "napari", "labels") if name in formats]
    for name in per_frame:
        (folder / name).mkdir()
    sources = frame_sources(run) if {"fiji", "labels"} & set(formats) else {}
    groups = dict(list(run.contacts.groupby("frame")))
    refused = dict(list(rejected_of(run).groupby("frame")))
    lines = dict(list(run.outlines.groupby("frame")))
    for frame in run.frames["frame"]:
        contacts, rejected = groups.get(frame, CONTACTS.empty()), refused.get(frame, REJECTED.empty())
        outlines = lines.get(frame, OUTLINES.empty())
        stem = file_stem(frame)
        image = sources[frame].read().image if frame in sources else None
        if "napari" in formats:
            write_napari_shapes(contacts, outlines, folder / "napari" / f"{stem}_shapes.csv")
            write_napari_points(contacts, folder / "napari" / f"{stem}_points.csv")
        if "fiji" in formats:
            regions = contact_regions(contacts, outlines) + rejected_regions(rejected)
            _write_fiji(run, image, regions, folder / "fiji" / stem)
        if "labels" in formats and image is not None:
            write_labels(contacts, image.shape, outlines, folder / "labels" / f"{stem}_labels.tif")
        if advance is not None:
            advance()


def rejected_of(run: RunFolder) -> pd.DataFrame:
    """The rejected candidates of a run; none for a prediction."""
    return read_run_table(run.folder, REJECTED, optional=True)


def file_stem(frame: str) -> str:
    """Name of the exported files of a frame, without extension.

    Examples
    --------
    >>> file_stem("stack.tif[3]"), file_stem("frame_1.tif")
    ('stack.tif_3', 'frame_1.tif')
    """
    return frame.replace("[", "_").replace("]", "")


def contact_regions(contacts: pd.DataFrame, outlines: pd.DataFrame) -> list[Region]:
    """Contacts of one frame as regions, named and coloured by what they are."""
    shapes = contact_outlines(contacts, outlines)
    return [
        region_of(outline, name=region_name(outline.label), colour=contact_colour(int(flags)))
        for outline, flags in zip(shapes, contacts["flags"], strict=True)
    ]


def rejected_regions(rejected: pd.DataFrame) -> list[Region]:
    """Rejected candidates of one frame as regions."""
    regions = []
    places = rejected[["x_px", "y_px", "radius_px"]].to_numpy(float).tolist()
    for number, ((x, y, radius), reason) in enumerate(zip(places, rejected["reason"], strict=True), start=1):
        name = f"rejected_{number:04d} {reason.partition(':')[0]}".replace("/", " ")
        regions.append(Region(name, x, y, max(radius, 1.0), max(radius, 1.0), colour=REJECTED_COLOUR))
    return regions


def region_name(label: int) -> str:
    """Name of the region of a contact: its label.

    Examples
    --------
    >>> region_name(12), label_of("contact_0012"), label_of("0123-0456")
    ('contact_0012', 12, None)
    """
    return f"contact_{label:04d}"


def label_of(name: str) -> int | None:
    """Label of the contact with a region of this name; None for a region drawn anew."""
    match = _NAME.fullmatch(name)
    return int(match[1]) if match else None


def contact_colour(flags: int) -> str:
    """Colour of a contact: by hand, flagged, or neither."""
    if flags & Flag.MANUAL:
        return MANUAL_COLOUR
    return FLAGGED_COLOUR if flags else CONTACT_COLOUR


def _write_fiji(run: RunFolder, image: NDArray | None, regions: list[Region], stem: Path) -> None:
    """Regions for the ROI Manager, and the frame with the same regions as its overlay."""
    write_regions(regions, stem.with_name(f"{stem.name}.zip"))
    if image is not None:
        camera = None if run.scene is None else run.scene.camera
        pixel_size = None if camera is None else camera.pixel_size
        write_overlay_tiff(image, regions, stem.with_name(f"{stem.name}_overlay.tif"), pixel_size=pixel_size)


def frame_sources(run: RunFolder) -> dict[str, FrameSource]:
    """The frames of a run as they were recorded, by name; without those that failed.

    Raises
    ------
    InputError
        If the run is a prediction, or the frames are not found.
    """
    if run.scene is None or run.command == "predict":
        raise InputError(f"{run.folder}: has no frames; only --napari and --xlsx can be exported")
    frames = open_experiment(run.scene).frames
    failed = set(run.frames.loc[run.frames["n_contacts"].isna(), "frame"])
    return {frame.name: replace(frame, correct=None) for frame in frames if frame.name not in failed}


def _about(run: RunFolder) -> dict[str, str]:
    """What the first sheet of the workbook says."""
    counts = run.frames["n_contacts"].sum(skipna=True)
    versions = run.provenance.get("versions", {})
    return {
        "run": str(run.folder.resolve()),
        "command": str(run.provenance.get("command", "")),
        "made": str(run.provenance.get("created", "")),
        "contactimg": str(versions.get("contactimg", "")),
        "frames": str(len(run.frames)),
        "contacts": str(int(np.nan_to_num(float(counts)))),
        "cells": "hold all digits; the format shows a few",
    }
