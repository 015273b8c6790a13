"""One self-contained HTML page about a run: its pictures, its tables, and the results of other commands."""

import base64
import io
import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from PIL import Image

from contactimg import __version__, files
from contactimg.analysis.estimates import Estimate
from contactimg.errors import InputError
from contactimg.files.atomic import read_bytes
from contactimg.files.output import command_of
from contactimg.files.runs import is_out_of_date
from contactimg.pipeline.pictures import file_stem
from contactimg.pipeline.pooled_background import evenly_spread
from contactimg.plots import CAPTIONS, caption_of, plot_area
from contactimg.plots.numbers import in_display_units, number_with_std, numbers_of, plain_number
from contactimg.report import summary
from contactimg.tables import FAILED, RESULTS, RUN_MODELS, SCORES, VARIANTS, Flag

logger = logging.getLogger(__name__)

FIGURE_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}
"""Endings of figures and their types, the preferred one first."""
Record = dict[str, Any]
"""What provenance.json says of one result."""
SHOWN_COMMANDS = ("overlay", "analyse", "calibrate")
"""Commands whose outputs are part of the page."""
PICTURE_BYTES = 2_400_000
"""Size of all pictures of frames together. Chosen: the page and its print stay below 5 MB."""
LEAST_WIDTH_PX = 480
"""Pictures are not made narrower. Chosen: the screen of a phone."""


@dataclass(frozen=True)
class Picture:
    """An image in the page: its caption (plain text) and its content (a data URI)."""

    caption: str
    source: str


@dataclass(frozen=True, eq=False)
class Part:
    """The output of another command for this run.

    Parameters
    ----------
    command : str
        The command line.
    pictures : list of Picture
    table : DataFrame
    area : Picture or None
        A(P), of an analysis of this run alone.
    """

    command: str
    pictures: list[Picture]
    table: pd.DataFrame
    area: Picture | None = None


def build_report(folder: str | Path, *, others: Sequence[str | Path] = (), max_pictures: int = 40) -> str:
    """Write one self-contained HTML page about a run.

    Parameters
    ----------
    folder : str or Path
        Output of `process`.
    others : sequence of str or Path
        Outputs of `overlay`, `analyse` and `calibrate` to show as well; those inside the folder of the run
        are included anyway.
    max_pictures : int
        Largest number of pictures of frames in each set; of a longer series, evenly spaced ones.

    Returns
    -------
    str
        HTML with embedded images. Every text from the run is escaped; a content security policy blocks the
        network.

    Raises
    ------
    InputError
        If the folder holds no complete run, or one of the others no output of these commands.
    """
    folder, places = Path(folder), [Path(other) for other in others]
    for place in (folder, *(path for path in folder.glob("*") if path.is_dir()), *places):
        files.finish_commit(place)
    run = files.read_run(folder)
    outputs, out_of_date = _current_outputs(folder, places)
    pictures = _pictures_in(folder, run)
    shown = evenly_spread(pictures, max_pictures)
    compared = sum(min(len(_pictures_in(place, run)), max_pictures) for place, _ in outputs)
    most_bytes = PICTURE_BYTES // max(len(shown) + compared, 1)
    overlays = [
        embed_picture(path, caption=summary.caption_of_frame(run, frame), most_bytes=most_bytes)
        for frame, path in shown
    ]
    parts: dict[str, list[Part]] = {command: [] for command in SHOWN_COMMANDS}
    used = run.provenance["configuration"].get("options", {}).get("calibration")
    if used:
        table = in_display_units(numbers_of(used["record"]))
        parts["calibrate"].append(Part(f"used by this run: {used['file']}", [], table))
    for place, record in outputs:
        part = _show_output(place, record, run, max_pictures=max_pictures, most_bytes=most_bytes)
        parts[command_of(record)].append(part)
    figure, exponent = _area(run, parts["analyse"])
    counts = {str(flag.name): int((run.contacts["flags"] & int(flag) != 0).sum()) for flag in Flag}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("contactimg", "report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": _number, "with_std": _with_std}
    html = environment.get_template("page.html.j2").render(
        run=run,
        title=summary.title(run),
        facts=summary.facts(run),
        headlines=[*([] if exponent is None else [exponent]), *summary.headlines(run)],
        warnings=summary.warnings(run, out_of_date),
        frames=run.frames.to_dict("records"),
        area_figure=figure,
        first_overlay=overlays.pop(len(overlays) // 2) if overlays else None,
        overlays=overlays,
        n_overlays=len(shown),
        n_pictures=len(pictures),
        comparisons=parts["overlay"],
        analyses=parts["analyse"],
        variants=VARIANTS,
        calibrations=parts["calibrate"],
        flags=[(name, count, count / len(run.contacts)) for name, count in counts.items() if count],
        rejected=list(run.rejected.groupby("reason").size().items()),
        failed=run.frames[run.frames["status"] == FAILED].to_dict("records"),
        provenance=json.dumps(run.provenance, indent=2),
        version=__version__,
    )
    return html.encode("utf-8", "replace").decode("utf-8")  # file names may hold bytes that are no valid text


def _area(run: files.Run, analyses: list[Part]) -> tuple[Picture | None, summary.Headline | None]:
    """The figure of A(P) and its exponent, of an analysis of this run alone; else the areas of the run."""
    for part in analyses:
        if part.area is not None:
            mine = (part.table["quantity"] == "area_exponent") & part.table["model"].isin(RUN_MODELS)
            for row in part.table[mine].to_dict("records"):
                estimate = Estimate(row["value"], row["std"], row["low"], row["high"])
                return part.area, summary.exponent_headline(estimate, row["confidence"], int(row["n_points"]))
            return part.area, None
    if not ((run.frames["load_N"] > 0) & (run.frames["area_m2"] > 0)).any():
        return None, None
    model = "predicted" if run.command == "predict" else "measured"
    svg = files.figure_bytes(plot_area(run.frames, model=model), "svg")
    return Picture(CAPTIONS["area"], _data_uri("image/svg+xml", svg)), None


def _number(value: float | None, factor: float = 1.0) -> str:
    """A number times a factor; empty for NaN or None."""
    return "" if value is None or isnan(value) else plain_number(value * factor)


def _with_std(value: float | None, std: float | None, factor: float = 1.0) -> str:
    """A number with its standard uncertainty; empty for NaN or None."""
    if value is None or isnan(value):
        return ""
    return number_with_std(value * factor, (nan if std is None else std) * factor)


def _current_outputs(folder: Path, others: Sequence[Path]) -> tuple[list[tuple[Path, Record]], list[str]]:
    """Folder and record of the outputs of other commands for a run; a sentence for each that is out of date.

    Parameters
    ----------
    folder : Path
        Output of `process`; outputs of `overlay`, `analyse` and `calibrate` inside it are found.
    others : sequence of Path
        Further outputs of these commands.

    Raises
    ------
    InputError
        If one of the others holds no output of these commands.
    """
    inside = [folder, *(path.parent for path in sorted(folder.glob(f"*/{files.PROVENANCE_FILE}")))]
    found, out_of_date = list[tuple[Path, Record]](), list[str]()
    for place in [*inside, *others]:
        try:
            records = files.read_records(place)
        except (OSError, ValueError):
            raise InputError(f"{place}: holds no output of contactimg") from None
        shown = [record for record in records if command_of(record) in SHOWN_COMMANDS]
        if not shown and place in others:
            made = str(records[0].get("command", ""))
            raise InputError(f"{place}: is the output of {made!r}, not of overlay, analyse or calibrate")
        for record in shown:
            if command_of(record) != "calibrate" and is_out_of_date(record, folder):
                out_of_date.append(
                    f"{place}: was made by '{record['command']}' from tables that the run no longer holds, "
                    "and is left out; repeat that command"
                )
                logger.warning(out_of_date[-1])
            else:
                found.append((place, record))
    return found, out_of_date


def _show_output(place: Path, record: Record, run: files.Run, *, max_pictures: int, most_bytes: int) -> Part:
    """Pictures and table of a command; pictures of frames take at most so many bytes each."""
    kind, command = command_of(record), str(record["command"])
    if kind == "overlay":
        pictures = [
            embed_picture(path, caption=summary.caption_of_comparison(run, frame), most_bytes=most_bytes)
            for frame, path in evenly_spread(_pictures_in(place, run), max_pictures)
        ]
        return Part(command, pictures, files.read_table(place / "scores.csv", SCORES))
    if kind == "calibrate":
        table = numbers_of(files.read_calibration(place))
    else:
        table = files.read_table(place / "results.csv", RESULTS, infinite=True)
    names = [Path(str(name)) for name in record.get("outputs", [])]
    best = {  # each figure in one format
        name.stem: place / name
        for ending in reversed(FIGURE_TYPES)
        for name in names
        if name.suffix == ending and len(name.parts) == 1
    }
    found = {stem: best[stem] for stem in sorted(best) if best[stem].is_file()}
    figures = {
        stem: Picture(caption_of(stem) or stem, _data_uri(FIGURE_TYPES[path.suffix], read_bytes(path)))
        for stem, path in found.items()
    }
    alone = kind == "analyse" and not (table["n_places"] > 1).any()
    area = figures.pop("area", None) if alone else None
    return Part(command, list(figures.values()), in_display_units(table), area)


def _pictures_in(folder: Path, run: files.Run) -> list[tuple[str, Path]]:
    """Names of the frames of a run that have a picture in a folder, and its file."""
    pairs = [(str(name), folder / "overlays" / f"{file_stem(str(name))}.png") for name in run.frames["frame"]]
    return [(name, path) for name, path in pairs if path.is_file()]


def embed_picture(path: Path, *, caption: str, most_bytes: int) -> Picture:
    """Embed a picture as JPEG; where it takes more than so many bytes, it is made smaller.

    Raises
    ------
    InputError
        If the file is no image that can be read.
    """
    try:
        with Image.open(path) as file:
            image = file.convert("RGB")
    except OSError as error:
        raise InputError(f"{path}: cannot be read as an image ({error})") from None
    width, content = image.width, _as_jpeg(image)
    while len(content) > most_bytes and width > LEAST_WIDTH_PX:
        width = max(LEAST_WIDTH_PX, int(0.95 * width * (most_bytes / len(content)) ** 0.5))
        size = width, round(image.height * width / image.width)
        content = _as_jpeg(image.resize(size, Image.Resampling.LANCZOS))
    return Picture(caption, _data_uri("image/jpeg", content))


def _as_jpeg(image: Image.Image) -> bytes:
    """An image as JPEG with colours at full resolution, so that thin lines keep theirs.

    Browsers print JPEG as it is and other formats without compression. Outlines stay sharp at this quality.
    """
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=82, subsampling=0, optimize=True)
    return buffer.getvalue()


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
