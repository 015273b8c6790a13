"""``contactimg process``: a folder of frames to contacts, forces and overlays."""

from pathlib import Path
from typing import Any

import click

from contactimg.cli.common import (
    command_line,
    echo_frames,
    output_option,
    progress,
    quiet_option,
    verbose_option,
    workers_option,
)
from contactimg.timings import stage

__all__ = ["process"]


@click.command(short_help="A folder of frames to contacts, local forces and overlays.")
@click.argument("folder", type=click.Path(exists=True))
@output_option
@click.option("--scene", type=click.Path(exists=True, dir_okay=False), help="Scene file instead of FOLDER's.")
@click.option("--reference", type=click.Path(), help="The non-contact frame.")
@click.option("--frames", help="Glob of the frames, relative to FOLDER.")
@click.option("--loads", type=click.Path(), help="CSV with columns frame, load_N.")
@click.option("--pixel-size-um", type=float, help="Sample length of one pixel, um.")
@click.option("--method", type=click.Choice(["disk", "threshold"]), help="Model fit, or the pixel count.")
@click.option("--threshold", help='Fraction of the contact contrast, or "auto".')
@click.option("--polarity", type=click.Choice(["bright", "dark", "auto"]), help="Contacts against reference.")
@click.option("--calibration", type=click.Path(exists=True), help="calibration.json: modulus, threshold.")
@click.option("--pictures/--no-pictures", default=True, help="Draw an overlay of each frame.")
@workers_option
@quiet_option
@verbose_option
def process(
    *, folder: str, output: str | None, pictures: bool, workers: int | None, quiet: bool, **options: Any
) -> int:
    """Measure every frame of FOLDER: contacts, local forces, overlays.

    What the scene.toml in FOLDER says holds unless an option says otherwise; without one, --reference and
    --pixel-size-um are enough. Writes contacts.csv, frames.csv, rejected.csv, provenance.json and a picture
    of each frame in overlays/.

    \b
    Examples:
      contactimg process sample_data/sa_plus -o results
      contactimg process my_frames --reference my_frames/dark.tif --pixel-size-um 6
    """
    with stage("loading"):
        from contactimg.cli.scenes import calibration_options, scene_of_folder
        from contactimg.files import OutputFolder, open_experiment, provenance
        from contactimg.pipeline.process import draw_overlays, write_run
        from contactimg.pipeline.series import FAILED, measure_experiment

    scene = scene_of_folder(folder, options)
    experiment = open_experiment(scene)
    count = len(experiment.frames)
    record = provenance(
        command=command_line("process"),
        scene=scene,
        options=calibration_options(options["calibration"]),
        inputs=experiment.inputs,
    )
    target = Path(output) if output is not None else Path(folder) / "contactimg_out"
    with OutputFolder(target, record, main_files=["contacts.csv", "frames.csv"]) as out:
        with progress("measuring frames", count, quiet=quiet) as advance:
            run = measure_experiment(experiment, workers=workers, advance=advance)
        out.record |= write_run(run, out.folder)
        if pictures:
            with progress("drawing overlays", count, quiet=quiet) as advance:
                draw_overlays(run, experiment, out.folder / "overlays", workers=workers, advance=advance)
    if not quiet:
        echo_frames(run.frames, title=f"{folder}, method {scene.measure.method}")
        click.echo(f"results in {target}")
    return 1 if (run.frames["status"] == FAILED).any() else 0
