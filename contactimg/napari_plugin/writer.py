"""Contacts that were moved, deleted or drawn in napari, written as edits.csv."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files import FrameTables
from contactimg.files.corrections import EditsFile
from contactimg.files.exports import Region, napari_shapes, polygon_region
from contactimg.napari_plugin.reader import FRAMES_KEY
from contactimg.pipeline.export import edits_between, region_name
from contactimg.tables import EDITS


def write_corrections(path: str, data: Sequence[Any], properties: dict[str, Any]) -> list[str]:
    """Write what was changed on the layer of contacts of a run, as rows of edits.csv.

    Parameters
    ----------
    path : str
        The table to write; rows are added to what is there, each correction once. `process` applies
        ``edits.csv`` beside the frames.
    data : sequence of ndarray, shape (n, 3)
        Points of the shapes: number of the frame, row, column.
    properties : dict
        Of the layer, as napari hands them over: ``metadata``, ``features``, ``shape_type``.

    Returns
    -------
    list of str
        The path; empty if nothing was changed.

    Raises
    ------
    InputError
        If the layer is not that of the contacts of a run.

    Notes
    -----
    What was changed is told by the tables as they were opened: `process` may have written others since, in
    which the labels mean other contacts.
    """
    shown = properties.get("metadata", {}).get(FRAMES_KEY)
    if not shown:
        raise InputError(
            "this layer does not hold the contacts of a run; open a run folder and correct those"
        )
    drawn = _regions_by_frame(data, properties, len(shown))
    edits = [
        _edits(tables, regions).assign(frame=name, author="", time="")
        for (name, tables), regions in zip(shown.items(), drawn, strict=True)
    ]
    rows = EDITS.joined(edits)
    target = EditsFile(Path(path))
    new = rows[~_keys(rows).isin(_keys(target.read()))]
    if len(new):
        target.insert(new.assign(time=datetime.now(UTC).isoformat(timespec="seconds")))
    return [path] if len(rows) else []


def _edits(shown: FrameTables, corrected: list[Region]) -> pd.DataFrame:
    drawn = ((region_name(outline.label), napari_shapes(outline)[0]) for outline in shown.shapes)
    exported = [region for name, outer in drawn if (region := _region(name, *outer)) is not None]
    return edits_between(shown.contacts, exported, corrected, program="napari")


def _regions_by_frame(data: Sequence[Any], properties: dict[str, Any], count: int) -> list[list[Region]]:
    """The shapes with an area as regions, frame by frame; new ones carry no label of a contact."""
    labels = pd.DataFrame(properties.get("features", {})).get("label", pd.Series([np.nan] * len(data)))
    kinds = properties.get("shape_type", "polygon")
    kinds = [kinds] * len(data) if isinstance(kinds, str) else kinds
    by_frame: list[list[Region]] = [[] for _ in range(count)]
    for points, kind, label in zip(data, kinds, labels, strict=True):
        place = np.asarray(points, float)
        frame = int(np.clip(np.rint(place[0, 0]), 0, count - 1))
        name = "" if pd.isna(label) else region_name(int(label))
        region = _region(name, kind, place[:, :0:-1])
        if region is not None:
            by_frame[frame].append(region)
    return by_frame


def _region(name: str, kind: str, points: NDArray[np.float64]) -> Region | None:
    """The region of a shape with the points (x, y): the disk of equal area; None without an area."""
    if kind != "ellipse":
        return polygon_region(name, points)
    along, across = points[1] - points[0], points[2] - points[1]
    area = abs(along[0] * across[1] - along[1] * across[0]) / 4.0  # over pi
    centre = points.mean(axis=0)
    radius = float(np.sqrt(area))
    x, y = centre.tolist()
    return Region(0, x, y, radius, radius, name=name) if radius > 0 else None


def _keys(edits: pd.DataFrame) -> pd.MultiIndex:
    """Frame, action and place of each correction: two that share them are the same."""
    place = edits[["x_px", "y_px", "radius_px"]].astype(float).round(6).fillna(-1.0)
    return pd.MultiIndex.from_frame(edits[["frame", "action"]].join(place))
