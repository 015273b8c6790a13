"""``contactimg effects``: which effects a scene calls for, with the number that decides."""

from pathlib import Path

import click

from contactimg.cli.common import command_line, echo_plan, quiet_option, verbose_option
from contactimg.timings import stage


@click.command(short_help="Which effects a scene calls for, with the number that decides.")
@click.argument("scene", type=click.Path(exists=True))
@click.option("--load-N", "load", type=float, help="Load, N.  [default: the largest that the scene states]")
@click.option(
    "--tolerance", type=float, help="Relative change that is allowed.  [default: the scene's, else 0.01]"
)
@click.option(
    "--output",
    type=click.Choice(["area", "force", "radius"]),
    help="What must be accurate.  [default: the scene's, else area]",
)
@click.option("-o", "folder", type=click.Path(file_okay=False), help="Write effects.csv to this folder.")
@quiet_option
@verbose_option
def effects(
    *,
    scene: str,
    load: float | None,
    tolerance: float | None,
    output: str | None,
    folder: str | None,
    quiet: bool,
) -> None:
    """Weigh the effects of SCENE, a scene.toml or the folder that holds one.

    Prints for each effect of the mechanics, the optics and the sensor by how much the requested output would
    change if it were left out, whether it is computed, and what that costs. What is left out changes the
    output by less than the tolerance all together; what [effects] in the scene orders is obeyed.

    \b
    Example:
      contactimg effects sample_data/sa_plus --load-N 0.5
      contactimg effects sample_data/sa_plus --output force --tolerance 0.0001 -o plan
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, with_tolerance
        from contactimg.files import OutputFolder, provenance, read_scene, write_table
        from contactimg.pipeline.plan import plan_effects
        from contactimg.tables import EFFECTS

    description = with_tolerance(read_scene(scene), output=output, relative=tolerance)
    plan = plan_effects(description, load=load)
    if folder is not None:
        record = provenance(
            command=command_line("effects"), scene=description, inputs=model_inputs(scene, description)
        )
        with OutputFolder(Path(folder), record) as out:
            write_table(plan.table(), EFFECTS, out.folder / "effects.csv")
    if not quiet:
        echo_plan(plan, title=f"{scene} at {plan.load:g} N: {plan.output} to {plan.relative:g}")
        if folder is not None:
            click.echo(f"results in {folder}")
