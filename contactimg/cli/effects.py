"""``contactimg effects``: which effects a scene calls for, with the number that decides."""

from pathlib import Path

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_plan
from contactimg.timings import stage


@click.command(short_help="Decide which physical effects matter for a scene.")
@click.argument("scene", type=click.Path(exists=True))
@shared.load
@click.option(
    "--tolerance",
    type=float,
    help="Relative change of the output that is allowed, for example 0.01 for 1 %.  [default: the scene's, "
    "else 0.01]",
)
@click.option(
    "--output",
    type=click.Choice(["area", "force", "radius"]),
    help="The result that must be accurate: total contact area, local forces or contact radii.  [default: "
    "the scene's, else area]",
)
@click.option(
    "-o",
    "folder",
    type=click.Path(file_okay=False),
    help="Folder for effects.csv; without it nothing is written.",
)
@shared.quiet
@shared.verbose
def effects(
    *,
    scene: str,
    load: float | None,
    tolerance: float | None,
    output: str | None,
    folder: str | None,
    quiet: bool,
) -> None:
    """Decide which physical effects matter for SCENE, a scene.toml or the folder that holds one.

    Prints for each effect of the mechanics, the optics and the sensor: the relative change of the output if
    it were left out, whether it is computed, and how much longer the computation takes with it. All effects
    that are left out change the output together by less than the tolerance. Effects that the section
    [effects] of the scene switches "on" or "off" stay so.

    Writes nothing, unless -o names a folder: then effects.csv and provenance.json.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg effects sample_data/sa_plus --load-N 0.5
      contactimg effects sample_data/sa_plus --output force --tolerance 0.0001 -o plan
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, plausible, with_tolerance
        from contactimg.files import OutputFolder, provenance, read_scene, write_table
        from contactimg.pipeline.effects import plan_effects
        from contactimg.tables import EFFECTS

    description = with_tolerance(plausible(read_scene(scene)), output=output, relative=tolerance)
    plan = plan_effects(description, load=load)
    if folder is not None:
        record = provenance(
            command=shared.command_line("effects"), scene=description, inputs=model_inputs(scene, description)
        )
        with OutputFolder(Path(folder), record) as out:
            write_table(plan.table(), EFFECTS, out.folder / "effects.csv")
    if not quiet:
        echo_plan(plan, title=f"{scene} at {plan.load:g} N: {plan.output} to {100 * plan.relative:g} %")
        if folder is not None:
            click.echo(f"results in {folder}")
