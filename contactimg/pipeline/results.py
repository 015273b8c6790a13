"""What every command leaves in its folder: tables, figures with their captions, and a calibration."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import pandas as pd

from contactimg.analysis.load_cell import LoadCell
from contactimg.files import write_figures, write_table
from contactimg.plots import caption_of
from contactimg.scene import Scene
from contactimg.tables import Schema, Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes  # takes half a second, and `process` draws no axes

NamedTable = tuple[Schema, pd.DataFrame]
"""A table, and the schema whose name its file has."""

NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")


def write_results(
    folder: Path, tables: Iterable[NamedTable], figures: Mapping[str, "Axes"] = MappingProxyType({})
) -> None:
    """Write tables as CSV and figures in every format.

    Parameters
    ----------
    folder : Path
        Exists.
    tables : iterable of (Schema, DataFrame)
        Each goes into a file of the name of its schema.
    figures : mapping
        Name without ending -> axes.
    """
    for schema, table in tables:
        write_table(table, schema, folder / f"{schema.name}.csv")
    for name, ax in figures.items():
        write_figures(ax, folder, name, caption=caption_of(name))


@dataclass(frozen=True)
class Calibrated:
    """The result of a calibration.

    Parameters
    ----------
    record : dict
        Contents of ``calibration.json``.
    tables : list of (Schema, DataFrame)
    figures : dict
        Name without ending -> axes.
    failed : bool
        Whether a frame could not be measured.
    """

    record: dict[str, Any]
    tables: list[NamedTable]
    figures: dict[str, "Axes"]
    failed: bool = False


def alike_remarks(
    frames: pd.DataFrame, *, exact: pd.Series | bool = False
) -> list[tuple[tuple[str, ...], str]]:
    """The remarks on frames, those of the same frames joined, with the names of these frames.

    Parameters
    ----------
    frames : DataFrame
        With ``frame, message``.
    exact : Series of bool, or bool
        Whose remarks are the same only if their numbers are; of the others those of the first are given.

    Examples
    --------
    >>> said = ["a.tif: the lamp is 1.1 of the reference", "", "the lamp is 1.2 of the reference; a hair"]
    >>> table = pd.DataFrame({"frame": ["a.tif", "b.tif", "c.tif"], "message": said})
    >>> alike_remarks(table)[0]
    (('a.tif', 'c.tif'), 'the lamp is 1.1 of the reference (numbers of the first)')
    """
    alike: dict[str, list[tuple[str, str]]] = {}
    whole = frames.assign(exact=exact)[["frame", "message", "exact"]].fillna({"message": ""})
    for frame, message, by_numbers in whole.itertuples(index=False):
        for remark in filter(None, message.split("; ")):
            said = remark.removeprefix(frame).lstrip(": ")
            kind = said if by_numbers else NUMBER.sub("#", said)
            alike.setdefault(kind, []).append((frame, said))
    joined: dict[tuple[str, ...], list[str]] = {}
    for remarks in alike.values():
        names, texts = zip(*remarks, strict=True)
        differ = " (numbers of the first)" if len(set(texts)) > 1 else ""
        joined.setdefault(names, []).append(texts[0] + differ)
    return [(names, "; ".join(texts)) for names, texts in joined.items()]


def frame_notes(frames: pd.DataFrame) -> list[str]:
    """The remarks on frames, each once: with the frame, or with the number of frames."""
    return [
        f"{those[0] if len(those) == 1 else f'{len(those)} frames'}: {text}"
        for those, text in alike_remarks(frames)
    ]


def reservations(frames: pd.DataFrame) -> list[str]:
    """Tell what to be wary of in frames that are used although their status is not "ok"."""
    cures, doubtful = {str(one): one.cure for one in Status}, frames[frames["status"] != Status.OK]
    said = [f'used with the status "{status}": {cures.get(status, "")}' for status in doubtful["status"]]
    return frame_notes(doubtful.assign(message=pd.array(said, dtype="str")))


def cell_notes(scene: Scene) -> list[str]:
    """Notes on what was assumed of the load cell because the scene does not state it."""
    if scene.load.gain_std is not None:
        return []
    gain = LoadCell.stated(scene.load).gain_std
    return [f"load cell: gain_std = {gain:g} assumed, which the uncertainties include; state it in [load]"]
