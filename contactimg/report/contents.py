"""Gather what the page of a run shows: its tables and pictures, and the results of other commands on it."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactimg.analysis.area_against_load import fit_area_law, frame_areas
from contactimg.analysis.load_cell import EXACT_LOADS, LoadCell
from contactimg.analysis.power_laws import PowerLaw
from contactimg.errors import InputError
from contactimg.files import (
    PROVENANCE_FILE,
    Run,
    finish_commit,
    read_calibration,
    read_records,
    read_run,
    read_run_table,
    read_table,
)
from contactimg.files.runs import is_out_of_date
from contactimg.pipeline.pictures import picture_name
from contactimg.plots import caption_of
from contactimg.report.captions import comparison_caption, frame_caption
from contactimg.report.embedding import Picture, PictureEmbedder, embed_figure
from contactimg.report.units import in_display_units
from contactimg.tables import FAILED, REJECTED, RESULTS, SCORES, Flag

logger = logging.getLogger(__name__)

FIGURE_FORMATS = (".svg", ".png")
"""Formats of figures, the preferred one first."""

SHOWN_COMMANDS = frozenset({"overlay", "analyse", "calibrate"})
"""Commands whose outputs are part of the page."""

PICTURE_BYTES = 2_400_000
"""Of all pictures of frames together. Chosen: the page and its print stay below 5 MB with the figures."""


@dataclass(frozen=True, eq=False)
class Part:
    """The output of another command for this run.

    Parameters
    ----------
    command : str
        The command line.
    pictures : list of Picture
    table : DataFrame or None
    area : Picture or None
        A(P), of an analysis of this run alone.
    """

    command: str
    pictures: list[Picture]
    table: pd.DataFrame | None
    area: Picture | None = None


@dataclass(frozen=True, eq=False)
class Contents:
    """Everything that the page shows.

    Parameters
    ----------
    run : Run
    flags : DataFrame
        ``flag, count, share``: flags that occur, and how many contacts carry each.
    rejected : DataFrame
        ``reason`` and ``count`` of rejected candidates.
    failed : DataFrame
        Rows of the table of frames that could not be measured.
    law : PowerLaw or None
        Power law of area against load; None if the run has too few loads.
    overlays : list of Picture
        Frames with their contacts; the middle one is on the first page.
    overlays_total : int
        Number of overlays in the run.
    comparisons, analyses, calibrations : list of Part
        Outputs of ``overlay``, ``analyse`` and ``calibrate``.
    out_of_date : list of str
        For each output that was made from other tables than the run holds now, a sentence that says so.
    """

    run: Run
    flags: pd.DataFrame
    rejected: pd.DataFrame
    failed: pd.DataFrame
    law: PowerLaw | None
    overlays: list[Picture]
    overlays_total: int
    comparisons: list[Part]
    analyses: list[Part]
    calibrations: list[Part]
    out_of_date: list[str]


@dataclass(frozen=True)
class _Output:
    """What a command wrote into a folder."""

    place: Path
    record: dict[str, Any]

    @property
    def command(self) -> str:
        """The command line."""
        return str(self.record.get("command", ""))

    @property
    def kind(self) -> str:
        """The name of the command."""
        return [*self.command.split(), "", ""][1]

    @property
    def figures(self) -> list[Path]:
        """The figures, each in one format."""
        names = [Path(str(name)) for name in self.record.get("outputs", [])]
        best = {
            name.stem: self.place / name
            for ending in reversed(FIGURE_FORMATS)
            for name in names
            if name.suffix == ending and len(name.parts) == 1
        }
        return [best[stem] for stem in sorted(best) if best[stem].is_file()]


def gather_contents(folder: Path, *, others: Sequence[Path], max_pictures: int) -> Contents:
    """Read a run and the outputs of other commands for it.

    Parameters
    ----------
    folder : Path
        Output of `process`.
    others : sequence of Path
        Outputs of `overlay`, `analyse` or `calibrate`; those inside the folder of the run are included
        anyway.
    max_pictures : int
        Largest number of pictures of frames; of a longer series, evenly spaced ones.

    Raises
    ------
    InputError
        If the folder holds no complete run, or one of the others no output of these commands.
    """
    for place in (folder, *(path for path in folder.glob("*") if path.is_dir()), *others):
        finish_commit(place)
    run = read_run(folder)
    outputs, out_of_date = _current_outputs(folder, others)
    overlays = _pictures_of(folder / "overlays", run.frames["frame"])
    shown = _evenly_spaced(overlays, max_pictures)
    compared = [_pictures_of(output.place / "overlays", run.frames["frame"]) for output in outputs]
    number = len(shown) + sum(min(len(pairs), max_pictures) for pairs in compared)
    embedder = PictureEmbedder(PICTURE_BYTES // max(number, 1))
    parts: dict[str, list[Part]] = {"overlay": [], "analyse": [], "calibrate": []}
    for output in outputs:
        parts[output.kind].append(_part(output, run, max_pictures, embedder))
    return Contents(
        run=run,
        flags=_flag_counts(run.contacts),
        rejected=_rejected(folder),
        failed=run.frames[run.frames["status"] == FAILED],
        law=_area_law(run),
        overlays=[embedder.embed(path, caption=frame_caption(run, frame)) for frame, path in shown],
        overlays_total=len(overlays),
        comparisons=parts["overlay"],
        analyses=parts["analyse"],
        calibrations=[*_used_calibration(run), *parts["calibrate"]],
        out_of_date=out_of_date,
    )


def _current_outputs(folder: Path, others: Sequence[Path]) -> tuple[list[_Output], list[str]]:
    """Outputs of other commands, and a sentence for each that was made from other tables than the run's."""
    found, out_of_date = list[_Output](), list[str]()
    for place in [*_places_of_outputs(folder), *others]:
        outputs = [output for output in _outputs(place) if output.kind in SHOWN_COMMANDS]
        if not outputs:
            command = _outputs(place)[0].command
            raise InputError(f"{place}: is the output of {command!r}, not of overlay, analyse or calibrate")
        for output in outputs:
            if output.kind != "calibrate" and is_out_of_date(output.record, folder):
                out_of_date.append(_refusal(output))
                logger.warning(out_of_date[-1])
            else:
                found.append(output)
    return found, out_of_date


def _places_of_outputs(folder: Path) -> list[Path]:
    """The folder of the run and those inside it, as far as they have outputs of other commands."""
    places = [folder, *(path.parent for path in sorted(folder.glob(f"*/{PROVENANCE_FILE}")))]
    return [place for place in places if SHOWN_COMMANDS & {output.kind for output in _outputs(place)}]


def _outputs(place: Path) -> list[_Output]:
    """What commands wrote into a folder."""
    try:
        return [_Output(place, record) for record in read_records(place)]
    except (OSError, ValueError):
        raise InputError(f"{place}: holds no output of contactimg") from None


def _refusal(output: _Output) -> str:
    """The sentence for an output that is out of date."""
    return (
        f"{output.place}: was made by '{output.command}' from tables that the run no longer holds, and is "
        "left out; repeat that command"
    )


def _part(output: _Output, run: Run, max_pictures: int, embedder: PictureEmbedder) -> Part:
    """Pictures and table of a command."""
    place = output.place
    if output.kind == "overlay":
        pairs = _evenly_spaced(_pictures_of(place / "overlays", run.frames["frame"]), max_pictures)
        pictures = [embedder.embed(path, caption=comparison_caption(run, frame)) for frame, path in pairs]
        return Part(output.command, pictures, read_table(place / "scores.csv", SCORES))
    if output.kind == "calibrate":
        table = _numbers(read_calibration(place))
    else:
        table = read_table(place / "results.csv", RESULTS, infinite=True)
    figures = {path.stem: embed_figure(path, caption=_caption(path)) for path in output.figures}
    alone = output.kind == "analyse" and not (table["n_places"] > 1).any()
    area = figures.pop("area", None) if alone else None
    return Part(output.command, list(figures.values()), in_display_units(table), area)


def _caption(path: Path) -> str:
    """The caption of a figure; its file name if there is none."""
    return caption_of(path.stem) or path.stem


def _numbers(record: Mapping[str, Any]) -> pd.DataFrame:
    """The table of the numbers of a calibration."""
    rows = [
        {"quantity": name, "value": entry["value"], "std": entry.get("std"), "unit": entry.get("unit", "")}
        for name, entry in record.items()
        if isinstance(entry, dict) and {"value", "unit"} <= set(entry)
    ]
    return pd.DataFrame(rows, columns=["quantity", "value", "std", "unit"])


def _used_calibration(run: Run) -> list[Part]:
    """The calibration that the run was measured with, from its provenance."""
    used = run.provenance["configuration"].get("options", {}).get("calibration")
    return (
        [Part(f"used by this run: {used['file']}", [], in_display_units(_numbers(used["record"])))]
        if used
        else []
    )


def _pictures_of(folder: Path, frames: pd.Series) -> list[tuple[str, Path]]:
    """Names of the frames that have a picture, and its file."""
    pairs = [(str(frame), folder / picture_name(str(frame))) for frame in frames]
    return [(frame, path) for frame, path in pairs if path.is_file()]


def _evenly_spaced(pairs: list[tuple[str, Path]], most: int) -> list[tuple[str, Path]]:
    """At most ``most`` evenly spaced pairs, with the first and the last one."""
    if len(pairs) <= most:
        return pairs
    return [pairs[k] for k in np.unique(np.linspace(0, len(pairs) - 1, most).round().astype(int))]


def _flag_counts(contacts: pd.DataFrame) -> pd.DataFrame:
    """Flags that occur, and the number and the share of the contacts that carry each."""
    values = contacts["flags"].to_numpy(np.int64)
    counts = {str(flag.name): int(np.count_nonzero(values & int(flag))) for flag in Flag}
    rows = [(name, count, count / len(values)) for name, count in counts.items() if count]
    return pd.DataFrame(rows, columns=["flag", "count", "share"])


def _rejected(folder: Path) -> pd.DataFrame:
    """Number of candidates rejected for each reason."""
    table = read_run_table(folder, REJECTED, optional=True)
    return table.groupby("reason", as_index=False).size().rename(columns={"size": "count"})


def _area_law(run: Run) -> PowerLaw | None:
    """The power law of area against load, if the run has enough loads."""
    try:
        lens = None if run.scene is None else run.scene.indenter
        centre = None if lens is None else lens.apex
        areas = frame_areas(run.frames, run.contacts, place=str(run.folder), centre=centre)
        measured = run.scene is not None and not run.frames["indentation_m"].notna().any()
        cell = LoadCell.stated(run.scene.load) if measured and run.scene is not None else EXACT_LOADS
        return fit_area_law(areas, load_cell=cell)
    except InputError:
        return None
