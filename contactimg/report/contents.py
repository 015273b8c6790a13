"""What the page of a run shows: its tables, pictures, and the results of other commands beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.analysis.area_against_load import fit_area_law, frame_areas
from contactimg.analysis.power_laws import PowerLaw
from contactimg.errors import InputError
from contactimg.files import (
    PROVENANCE_FILE,
    RunFolder,
    read_calibration,
    read_records,
    read_run,
    read_table,
)
from contactimg.pipeline.pictures import picture_name
from contactimg.report.embedding import Picture, embed_figure, embed_picture
from contactimg.tables import FAILED, REJECTED, RESULTS, SCORES, Flag

FIGURES = (".svg", ".png")
"""Formats of figures, the preferred one first."""


@dataclass(frozen=True, eq=False)
class Part:
    """The output of another command on the run.

    Parameters
    ----------
    command : str
        As typed.
    pictures : list of Picture
    table : DataFrame or None
    """

    command: str
    pictures: list[Picture]
    table: pd.DataFrame | None


@dataclass(frozen=True, eq=False)
class Contents:
    """All that the page shows.

    Parameters
    ----------
    run : RunFolder
    flags : DataFrame
        ``frame`` and one column a flag: contacts that carry it.
    rejected : DataFrame
        ``reason`` and ``count`` of rejected candidates.
    failed : DataFrame
        Rows of the frames table that could not be measured.
    law : PowerLaw or None
        Exponent of A(P); None where the run has too few loads.
    overlays : list of Picture
        Frames with their contacts.
    overlays_total : int
        How many there are.
    comparisons, analyses, calibrations : list of Part
        Outputs of ``overlay``, ``analyse`` and ``calibrate``.
    """

    run: RunFolder
    flags: pd.DataFrame
    rejected: pd.DataFrame
    failed: pd.DataFrame
    law: PowerLaw | None
    overlays: list[Picture]
    overlays_total: int
    comparisons: list[Part]
    analyses: list[Part]
    calibrations: list[Part]


def gather_contents(folder: Path, *, others: Sequence[Path], max_pictures: int) -> Contents:
    """Read a run and what other commands made of it.

    Parameters
    ----------
    folder : Path
        Output of `process`.
    others : sequence of Path
        Outputs of `overlay`, `analyse` or `calibrate`; those in folders inside the run's are found.
    max_pictures : int
        Most pictures of frames; of more, as many evenly chosen.

    Raises
    ------
    InputError
        If the folder holds no complete run, or another one no output of such a command.
    """
    run = read_run(folder)
    overlays = _pictures_of(folder / "overlays", run.frames["frame"])
    parts: dict[str, list[Part]] = {"overlay": [], "analyse": [], "calibrate": []}
    for place in [*_found(folder), *others]:
        found = [(kind, command) for kind, command in _kinds(place) if kind in parts]
        if not found:
            command = _kinds(place)[0][1]
            raise InputError(f"{place}: is the output of {command!r}, not of overlay, analyse or calibrate")
        for kind, command in found:
            parts[kind].append(_part(kind, command, place, run, max_pictures))
    return Contents(
        run=run,
        flags=_flag_counts(run.contacts, run.frames["frame"]),
        rejected=_rejected(folder),
        failed=run.frames[run.frames["status"] == FAILED],
        law=_area_law(run),
        overlays=_embedded(_thinned(overlays, max_pictures)),
        overlays_total=len(overlays),
        comparisons=parts["overlay"],
        analyses=parts["analyse"],
        calibrations=[*_used_calibration(run), *parts["calibrate"]],
    )


def _found(folder: Path) -> list[Path]:
    """Outputs of other commands in folders inside the run's."""
    places = [path.parent for path in sorted(folder.glob(f"*/{PROVENANCE_FILE}"))]
    shown = {"overlay", "analyse", "calibrate"}
    return [place for place in places if shown & {kind for kind, _ in _kinds(place)}]


def _kinds(place: Path) -> list[tuple[str, str]]:
    """The commands that wrote into a folder: name, and as typed."""
    try:
        commands = [str(record.get("command", "")) for record in read_records(place)]
    except (OSError, ValueError):
        raise InputError(f"{place}: holds no output of contactimg") from None
    return [([*command.split(), "", ""][1], command) for command in commands]


def _part(kind: str, command: str, place: Path, run: RunFolder, max_pictures: int) -> Part:
    """What a command left behind."""
    if kind == "overlay":
        pictures = _thinned(_pictures_of(place / "overlays", run.frames["frame"]), max_pictures)
        return Part(command, _embedded(pictures), read_table(place / "scores.csv", SCORES))
    if kind == "calibrate":
        table = _numbers(read_calibration(place))
    else:
        table = read_table(place / "results.csv", RESULTS, infinite=True)
    return Part(command, [embed_figure(path, caption=path.stem) for path in _figures(place)], table)


def _figures(place: Path) -> list[Path]:
    """The figures of a folder, each once."""
    best: dict[str, Path] = {}
    for ending in reversed(FIGURES):
        best |= {path.stem: path for path in place.glob(f"*{ending}")}
    return [best[stem] for stem in sorted(best)]


def _numbers(record: Mapping[str, Any]) -> pd.DataFrame:
    """The numbers of a calibration."""
    rows = [
        {"quantity": name, "value": entry["value"], "std": entry.get("std"), "unit": entry.get("unit", "")}
        for name, entry in record.items()
        if isinstance(entry, dict) and {"value", "unit"} <= set(entry)
    ]
    return pd.DataFrame(rows, columns=["quantity", "value", "std", "unit"])


def _used_calibration(run: RunFolder) -> list[Part]:
    """The calibration that the run was measured with, which travels in its provenance."""
    used = run.provenance["configuration"].get("options", {}).get("calibration")
    return [Part(f"used by this run: {used['file']}", [], _numbers(used["record"]))] if used else []


def _pictures_of(folder: Path, frames: pd.Series) -> list[tuple[str, Path]]:
    """Name of the frame and file of its picture, where there is one."""
    pairs = [(str(frame), folder / picture_name(str(frame))) for frame in frames]
    return [(frame, path) for frame, path in pairs if path.is_file()]


def _thinned(pairs: list[tuple[str, Path]], most: int) -> list[tuple[str, Path]]:
    """At most so many, evenly chosen, the first and the last among them."""
    if len(pairs) <= most:
        return pairs
    return [pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, most).round().astype(int))]


def _embedded(pairs: list[tuple[str, Path]]) -> list[Picture]:
    """The pictures themselves."""
    return [embed_picture(path, caption=frame) for frame, path in pairs]


def _flag_counts(contacts: pd.DataFrame, frames: pd.Series) -> pd.DataFrame:
    """How many contacts of each frame carry each flag."""
    values = contacts["flags"].to_numpy(np.int64)
    table = pd.DataFrame({str(flag.name): (values & int(flag)) > 0 for flag in Flag})
    counts = table.groupby(contacts["frame"].to_numpy()).sum().reindex(frames, fill_value=0)
    return counts.rename_axis("frame").reset_index()


def _rejected(folder: Path) -> pd.DataFrame:
    """How many candidates were rejected for each reason."""
    path = folder / "rejected.csv"
    table = read_table(path, REJECTED) if path.is_file() else REJECTED.empty()
    return table.groupby("reason", as_index=False).size().rename(columns={"size": "count"})


def _area_law(run: RunFolder) -> PowerLaw | None:
    """The exponent of A(P), if the run has loads enough."""
    try:
        return fit_area_law(frame_areas(run.frames, run.contacts, place=str(run.folder)))
    except InputError:
        return None
