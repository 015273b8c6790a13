"""``contactimg process``: a folder of frames to contacts, forces and overlays."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_first_run, echo_frames, progress
from contactimg.cli.shared_options import SceneOptions
from contactimg.errors import InputError
from contactimg.timings import stage

if TYPE_CHECKING:
    import pandas as pd

    from contactimg.files import Experiment, OutputFolder, TableFormat
    from contactimg.scene import Scene

MOST_SHOWN = 1000
"""Frames of a run that are printed. Chosen: more than anybody reads there."""

JOINED_FOLDER = "combined"
"""Inside the output folder of several folders: their tables as one."""


@dataclass(frozen=True, kw_only=True)
class ProcessOptions(SceneOptions):
    """Options of `process`, for each of its folders."""

    tolerance: float | None
    pictures: bool
    numbers: bool
    format: "TableFormat"
    workers: int | None
    quiet: bool


@click.command(short_help="Measure the contacts on every frame of a folder.")
@click.argument("folders", metavar="FOLDER...", nargs=-1, required=True, type=click.Path(exists=True))
@shared.output("FOLDER")
@shared.frames
@click.option(
    "--method",
    type=click.Choice(["disk", "threshold"]),
    help="disk: fit the image of a blurred disk to each contact. threshold: count the pixels above a grey "
    "level, as the paper does.  [default: the scene's, else disk]",
)
@click.option(
    "--shape",
    type=click.Choice(["auto", "disk", "ellipse", "free"]),
    help="Shape of the contacts, for the method disk. auto: a disk, an ellipse or a free shape, as each "
    "contact calls for.  [default: the scene's, else auto]",
)
@click.option(
    "--threshold",
    help='Grey level between contact and background, as a fraction of the contrast (0 to 1), or "auto".',
)
@click.option(
    "--calibration",
    type=click.Path(exists=True),
    help="Take modulus, threshold and edge from this calibration.json (or its folder) of `calibrate`.",
)
@click.option(
    "--tolerance",
    type=shared.positive_number,
    help="Relative error that is allowed, for example 0.05. Each frame is measured by the fastest method "
    "whose estimated error is smaller.",
)
@click.option(
    "--pictures/--no-pictures",
    default=True,
    help="Draw the contacts on each frame, in the folder overlays.  [default: pictures]",
)
@click.option(
    "--numbers/--no-numbers",
    default=False,
    help="Write the label of each contact beside it on the pictures.  [default: no numbers]",
)
@click.option(
    "--format",
    type=click.Choice(["csv", "parquet"]),
    default="csv",
    show_default=True,
    help="Format of the tables. parquet: smaller and faster for long series; needs pyarrow.",
)
@shared.workers
@shared.cluster
@shared.quiet
@shared.verbose
@shared.gather(ProcessOptions)
def process(*, folders: tuple[str, ...], output: str | None, options: ProcessOptions) -> int:
    """Measure every frame of FOLDER: contacts, local forces, and a picture of each frame.

    The scene.toml in FOLDER describes the experiment; an option given here replaces the key of the same name.
    Without a scene.toml, --reference (or an image called reference) and --pixel-size-um are enough to measure
    contacts; forces need the modulus and the radii of the asperities.

    Writes contacts.csv (one row per contact), frames.csv (one row per frame), rejected.csv (candidates that
    are no contacts, with the reason), provenance.json, and the pictures in overlays/.

    With several FOLDERs each is measured as if alone, into a folder of its name inside the output folder;
    combined/ then holds all_contacts.csv and all_frames.csv, with the name of the folder in the column run.

    Exit codes: 0 done; 1 a frame failed, or no frame shows anything that can be measured (all black or white,
    for example), as frames.csv says; 2 nothing done.

    \b
    Examples:
      contactimg process sample_data/sa_plus -o results
      contactimg process my_frames --reference my_frames/no_contact.tif --pixel-size-um 6
      contactimg process sample_data/ra_plus --tolerance 0.05 -o quick
    """
    if options.tolerance is not None and options.method is not None:
        raise click.UsageError("--tolerance chooses the method, --method names it; give only one of the two.")
    if len(folders) == 1:
        return _process_folder(folders[0], shared.output_path(output, folders[0]), options)
    if output is None:
        raise click.UsageError("with several folders, give the output folder: -o OUT.")
    return _process_folders(folders, Path(output), options)


def _process_folders(folders: tuple[str, ...], target: Path, options: ProcessOptions) -> int:
    """Measure each folder into one of its own, and join the tables; a folder that fails loses nothing else.

    Raises
    ------
    InputError
        If two folders have the same name, or none can be measured.
    """
    with stage("loading"):
        from contactimg.pipeline.measured_series import write_joined_tables

    names = _distinct_names(folders)
    codes, errors = dict[str, int](), list[InputError]()
    for folder, name in zip(folders, names, strict=True):
        try:
            codes[name] = _process_folder(folder, target / name, options)
        except InputError as error:
            errors.append(error)
            click.echo(f"contactimg: {folder} is left out: {error}", err=True)
    if not codes:
        raise InputError("none of the folders could be measured")
    record = shared.command_line("process")
    write_joined_tables(
        {name: target / name for name in codes},
        target / JOINED_FOLDER,
        command=record,
        table_format=options.format,
    )
    if not options.quiet:
        click.echo(f"tables of all {len(codes)} folders in {target / JOINED_FOLDER}")
    return max(*codes.values(), int(bool(errors)))


def _distinct_names(folders: tuple[str, ...]) -> list[str]:
    """Names of the folders, for those of the results."""
    names = [Path(folder).resolve().name for folder in folders]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"two folders are called {twice}; give each folder once, and rename one of the two")
    if JOINED_FOLDER in names:
        raise InputError(f"{JOINED_FOLDER} is the folder of the joined tables; rename the folder of frames")
    return names


def _process_folder(folder: str, target: Path, options: ProcessOptions) -> int:
    """Measure the frames of one folder; return the exit code."""
    with stage("loading"):
        from contactimg.cli.scenes import calibration_record, scene_of_folder, with_tolerance
        from contactimg.files import RUN_TABLES, OutputFolder, open_experiment, provenance, require_format
        from contactimg.pipeline.edits import edits_record

    scene = with_tolerance(scene_of_folder(folder, options), output=None, relative=options.tolerance)
    require_format(options.format)
    experiment = open_experiment(scene)
    used = calibration_record(options.calibration, scene)
    record = provenance(
        command=shared.command_line("process"),
        scene=scene,
        options=used,
        inputs=experiment.inputs,
    )
    echo_first_run(quiet=options.quiet)
    with OutputFolder(target, record, main_files=RUN_TABLES) as out:
        frames, facts = _measure(experiment, out, options)
        out.record |= facts | edits_record(experiment.edits)
    if not options.quiet:
        title = f"{folder}, method {_method(scene, options.tolerance)}"
        echo_frames(frames.head(MOST_SHOWN), title=title, statuses=Counter(frames["status"]))
        calibration = used.get("calibration", {})
        if calibration:
            click.echo(f"calibration {calibration['file']}: {calibration['acts']}")
        for said in (facts.get("law"), facts.get("film_summary")):
            if said:
                click.echo(said)
        click.echo(f"results in {target}")
    return _exit_code(frames)


def _measure(
    experiment: "Experiment", out: "OutputFolder", options: ProcessOptions
) -> "tuple[pd.DataFrame, dict[str, Any]]":
    """Measure the frames, and write tables and pictures; the frames table, and facts for the provenance."""
    with stage("loading"):
        from contactimg.pipeline.measured_series import write_run
        from contactimg.pipeline.pictures import draw_overlays
        from contactimg.pipeline.series import measure_parts

    count = len(experiment.frames)
    with progress("measuring frames", count, quiet=options.quiet) as advance:
        series = measure_parts(
            experiment,
            relative=options.tolerance,
            workers=options.workers,
            advance=advance,
            store=out.part_store(),
        )
    frames, facts = write_run(series, out.folder, options.format)
    if options.pictures:
        with progress("drawing overlays", count, quiet=options.quiet) as advance:
            draw_overlays(
                series,
                experiment,
                out.folder / "overlays",
                workers=options.workers,
                numbers=options.numbers,
                advance=advance,
            )
    return frames, facts


def _exit_code(frames: "pd.DataFrame") -> int:
    """1 if a frame failed or none shows anything that can be measured, else 0."""
    from contactimg.tables import FAILED

    measurable = frames[["area_m2", "n_contacts"]].notna().any(axis=None)
    return int(not measurable or (frames["status"] == FAILED).any())


def _method(scene: "Scene", tolerance: float | None) -> str:
    """How the frames were measured, for the title."""
    return scene.measure.method if tolerance is None else f"chosen for {100 * tolerance:g} %"
