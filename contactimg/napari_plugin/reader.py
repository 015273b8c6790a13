"""A run folder as layers of napari: frames, contacts, holes and rejected candidates."""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from dask import delayed
from dask.array import from_delayed
from dask.array import stack as stack_of
from numpy.typing import NDArray

from contactimg.errors import InputError
from contactimg.files import FrameSource, FrameTables, Run, main_tables, read_run
from contactimg.files.exports import napari_shapes
from contactimg.pipeline.export import frame_sources
from contactimg.tables import CONTACTS, flag_names
from contactimg.tables.outlines import REJECTED_COLOUR, kind_of

Layer = tuple[Any, dict[str, Any], str]
"""Data, properties and kind of a layer, as napari takes them."""

FRAMES_KEY = "contactimg_frames"
"""Key of the metadata of the layer of contacts: name -> tables of the frames in the stack, as opened."""
FEATURES = ["frame", "label", "radius_px", "radius_std_px", "force_N"]
"""Columns of contacts.csv that napari shows for a contact, besides its flags."""


def run_reader(path: str | Sequence[str]) -> Callable[[str], list[Layer]] | None:
    """The function that reads a path, or None for what is no run folder.

    napari asks for every path that is opened.

    Parameters
    ----------
    path : str or sequence of str

    Returns
    -------
    callable or None
        `read_run_layers`.
    """
    if not isinstance(path, str) or not (Path(path) / "provenance.json").is_file():
        return None
    return read_run_layers if main_tables([Path(path)])[0].is_file() else None


def read_run_layers(path: str) -> list[Layer]:
    """The layers of a run: frames, contacts, holes (if any) and rejected candidates (if any).

    Parameters
    ----------
    path : str
        Output folder of `process` or `predict`.

    Returns
    -------
    list of (data, properties, kind)
        The first axis is the number of the frame among those that were measured, the others are row and
        column, px. The contacts are ellipses and polygons with their columns of `FEATURES` and flags.

    Raises
    ------
    InputError
        If the folder holds no complete run.
    """
    run = read_run(path)
    names = [str(name) for name in run.frames.loc[run.frames["n_contacts"].notna(), "frame"]]
    frames, number = dict(run.by_frame()), {name: k for k, name in enumerate(names)}
    shown = {name: frames[name] for name in names}
    camera = run.scene.camera
    pixel_um = 1.0 if camera is None else 1e6 * camera.pixel_size
    common = {"scale": (1.0, pixel_um, pixel_um)}
    contacts, holes = _contact_layers(shown)
    layers = [*_image_layer(run, names), contacts]
    layers += [layer for layer in (holes, _rejected_layer(run, number)) if len(layer[0])]
    return [(data, common | properties, kind) for data, properties, kind in layers]


def _contact_layers(shown: dict[str, FrameTables]) -> tuple[Layer, Layer]:
    """The contacts, and the holes in them."""
    data: list[NDArray[np.float64]] = []
    kinds: list[str] = []
    holes: list[NDArray[np.float64]] = []
    for k, tables in enumerate(shown.values()):
        for (kind, points), *inner in map(napari_shapes, tables.shapes):
            data.append(_in_stack(points, k))
            kinds.append(kind)
            holes += [_in_stack(hole, k) for _, hole in inner]
    table = CONTACTS.joined(tables.contacts for tables in shown.values())
    features = table[FEATURES].reset_index(drop=True).assign(flags=flag_names(table["flags"]))
    style, known = {"face_color": "transparent", "edge_width": 0.5}, {FRAMES_KEY: shown}
    colours = [kind_of(int(flags)).colour for flags in table["flags"]]
    drawn = {"name": "contacts", "shape_type": kinds, "features": features, "edge_color": colours}
    inside = {"name": "holes", "shape_type": "path", "edge_color": "white", **style}
    return (data, drawn | style | {"metadata": known}, "shapes"), (holes, inside, "shapes")


def _rejected_layer(run: Run, number: dict[str, int]) -> Layer:
    table = run.rejected
    table = table[table["frame"].isin(list(number))].reset_index(drop=True)
    points = np.column_stack([table["frame"].map(number), table["y_px"], table["x_px"]]).astype(float)
    properties = {
        "name": "rejected",
        "features": table[["frame", "radius_px", "reason"]],
        "size": np.maximum(2 * table["radius_px"].to_numpy(float), 2.0),
        "face_color": "transparent",
        "border_color": REJECTED_COLOUR,
    }
    return points, properties, "points"


def _image_layer(run: Run, names: list[str]) -> list[Layer]:
    """The frames as a stack that is read as it is looked at; a warning instead if they are not found."""
    try:
        sources = frame_sources(run)
        missing = [name for name in names if name not in sources]
        if missing or not names:
            raise InputError(f"{run.folder}: the frame {missing[0]} is not found" if missing else "no frames")
        first = sources[names[0]].read().image
    except InputError as error:
        warnings.warn(f"the frames are not shown: {error}", stacklevel=2)
        return []
    read = delayed(_pixels, pure=True)
    stack = [from_delayed(read(sources[name]), first.shape, first.dtype) for name in names]
    low, high = float(first.min()), float(first.max())
    properties = {"name": "frames", "contrast_limits": (low, max(high, low + 1.0))}
    return [(stack_of(stack), properties, "image")]


def _pixels(source: FrameSource) -> NDArray:
    return source.read().image


def _in_stack(points: NDArray[np.float64], number: int) -> NDArray[np.float64]:
    """Points (x, y) as (number of the frame, row, column)."""
    return np.column_stack([np.full(len(points), float(number)), points[:, 1], points[:, 0]])
