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
    type=click.Choice(["all", "area", "force", "radius", "profile"]),
    help="The result that must be accurate: every one that is written, total contact area, local forces, "
    "contact radii or profiles.  [default: the scene's, else all]",
)
@click.option(
    "--auto", is_flag=True, help="Let the plan decide on every effect, whatever [effects] of the scene says."
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
    auto: bool,
    folder: str | None,
    quiet: bool,
) -> None:
    """Decide which physical effects matter for SCENE, a scene.toml or the folder that holds one.

    Prints for each effect of the mechanics, the optics and the sensor: the number that decides, whether it is
    computed, the relative change of the output if it were left out, and the computing time with it over that
    without it; then the times of the plan and of solutions as planned and with everything on. All effects
    that are left out change the output together by less than the tolerance. Effects that the section
    [effects] of the scene switches "on" or "off" stay so, unless --auto.

    Writes nothing, unless -o names a folder: then effects.csv and provenance.json.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg effects sample_data/sa_plus --auto
      contactimg effects sample_data/sa_plus --output force --tolerance 0.0001 -o plan
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, plausible, with_tolerance
        from contactimg.files import OutputFolder, provenance, read_scene, write_table
        from contactimg.pipeline.effects import computing_times, plan_effects
        from contactimg.scene import Effects
        from contactimg.tables import EFFECTS

    description = with_tolerance(plausible(read_scene(scene)), output=output, relative=tolerance)
    if auto:
        description = description.model_copy(update={"effects": Effects()})
    plan = plan_effects(description, load=load)
    if folder is not None:
        record = provenance(
            command=shared.command_line("effects"), scene=description, inputs=model_inputs(scene, description)
        )
        with OutputFolder(Path(folder), record) as out:
            write_table(plan.table(), EFFECTS, out.folder / "effects.csv")
    if not quiet:
        echo_plan(plan, title=f"{scene} at {plan.load:g} N: {plan.output} to {100 * plan.relative:g} %")
        click.echo(computing_times(description, plan))
        if folder is not None:
            click.echo(f"results in {folder}")
