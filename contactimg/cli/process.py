"""``contactimg process``: a folder of frames to contacts, forces and overlays."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from contactimg.scene import Scene


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
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0, min_open=True),
    help="Relative error of the output: the cheapest method that meets it, frame by frame.",
)
@click.option("--pictures/--no-pictures", default=True, help="Draw an overlay of each frame.")
@workers_option
@quiet_option
@verbose_option
def process(
    *,
    folder: str,
    output: str | None,
    tolerance: float | None,
    pictures: bool,
    workers: int | None,
    quiet: bool,
    **options: Any,
) -> int:
    """Measure every frame of FOLDER: contacts, local forces, overlays.

    What the scene.toml in FOLDER says holds unless an option says otherwise; without one, --reference (or an
    image called reference) and --pixel-size-um are enough. With --tolerance each frame is measured by the
    threshold if its error, which is estimated on the frame, stays below it, else by the fit of disks; the
    provenance holds the decisions. Writes contacts.csv, frames.csv, rejected.csv, provenance.json and a
    picture of each frame in overlays/. The exit code is 1 if a frame failed, and also if no frame shows
    anything that can be measured, because all are black or white, say: their rows tell why.

    \b
    Examples:
      contactimg process sample_data/sa_plus -o results
      contactimg process my_frames --reference my_frames/dark.tif --pixel-size-um 6
      contactimg process sample_data/ra_plus --tolerance 0.05 -o quick
    """
    with stage("loading"):
        from contactimg.cli.scenes import calibration_options, scene_of_folder, with_tolerance
        from contactimg.files import OutputFolder, open_experiment, provenance
        from contactimg.pipeline.overlays import draw_overlays
        from contactimg.pipeline.run import write_run
        from contactimg.pipeline.series import measure_experiment
        from contactimg.tables import FAILED

    if tolerance is not None and options["method"] is not None:
        raise click.UsageError("--tolerance chooses the method and --method names it; keep one of the two.")
    scene = with_tolerance(scene_of_folder(folder, options), output=None, relative=tolerance)
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
            run = measure_experiment(experiment, relative=tolerance, workers=workers, advance=advance)
        out.record |= write_run(run, out.folder)
        if pictures:
            with progress("drawing overlays", count, quiet=quiet) as advance:
                draw_overlays(run, experiment, out.folder / "overlays", workers=workers, advance=advance)
    if not quiet:
        echo_frames(run.frames, title=f"{folder}, method {_method(scene, tolerance)}")
        click.echo(f"results in {target}")
    nothing = run.frames["area_m2"].isna().all() and run.frames["n_contacts"].isna().all()
    return int(nothing or (run.frames["status"] == FAILED).any())


def _method(scene: "Scene", tolerance: float | None) -> str:
    """How the frames were measured, for the title."""
    return scene.measure.method if tolerance is None else f"chosen for {100 * tolerance:g} %"
