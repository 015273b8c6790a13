"""``contactimg simulate``: synthetic frames of a scene with the table of their true contacts."""

from typing import TYPE_CHECKING

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import progress
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.scene import Scene


@click.command(short_help="Render synthetic frames of a scene, with the true contacts.")
@click.argument("scene", type=click.Path(exists=True))
@shared.output("the folder of SCENE")
@click.option(
    "--plan",
    "optics",
    is_flag=True,
    help="Render an effect of optics or sensor only if leaving it out would change a requested output by "
    "more than allowed, instead of all that [simulate] states.",
)
@shared.one_worker
@shared.cluster
@shared.quiet
@shared.verbose
def simulate(*, scene: str, output: str | None, optics: bool, workers: int, quiet: bool) -> None:
    """Make synthetic frames of SCENE, a scene.toml or the folder that holds one.

    The section [simulate] of the scene describes loads, optics and sensor. Without a section [asperities] the
    rubber is smooth, and each frame shows one circular JKR contact (input for `contactimg calibrate jkr`).

    Optics and sensor are rendered as [simulate] states them, unless [effects] switches them off. A mechanical
    effect that is "auto" is computed if leaving it out would change an output that [tolerance] requests by
    more than allowed there; `contactimg effects SCENE` prints the numbers.

    Writes reference.tif, frame_*.tif, loads.csv, asperities.csv, truth.csv (the contacts.csv that a perfect
    measurement would give), provenance.json and scene.toml, which says for each effect whether the frames
    show it. `contactimg process` reads this folder as it is.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg simulate scene.toml -o frames
      contactimg process frames
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, plausible
        from contactimg.files import OutputFolder, provenance, read_scene
        from contactimg.pipeline.inputs import need_asperities
        from contactimg.pipeline.simulate import plan_simulation, write_simulation
        from contactimg.prediction import load_name

    description = plausible(read_scene(scene))
    smooth = description.asperities is None
    asperities = None if smooth else need_asperities(description, "simulating frames")
    target = shared.output_path(output, description.folder)
    record = provenance(
        command=shared.command_line("simulate"), scene=description, inputs=model_inputs(scene, description)
    )
    count = 1 + len(description.need("simulate", "simulating frames").loads)
    planned = plan_simulation(description, asperities, optics=optics)
    record["plans"] = {load_name(plan.load): plan.record for plan in planned.plans}
    record["expected_errors"] = {load_name(plan.load): plan.error_record for plan in planned.plans}
    record["effects"] = planned.scene.effects.switches()
    with (
        OutputFolder(target, record, main_files=["truth.csv", "scene.toml"]) as out,
        progress("making frames", count, quiet=quiet) as advance,
    ):
        write_simulation(planned.scene, asperities, out.folder, workers=workers, advance=advance)
    if not quiet:
        for plan in planned.plans:
            click.echo(plan.sentence())
        click.echo(_shown(planned.scene))
        click.echo(f"{count - 1} frames and the true contacts in {target}")


def _shown(scene: "Scene") -> str:
    """One line: which effects the frames show and which were left out."""
    switches = scene.effects.switches()
    shown, left_out = ([name for name, switch in switches.items() if switch == on] for on in ("on", "off"))
    sensor = {"shot_noise", "read_noise", "quantisation"}
    ideal = "; the frames are floating-point numbers without noise" if sensor <= set(left_out) else ""
    return f"computed: {', '.join(shown) or 'none'}; left out: {', '.join(left_out) or 'none'}{ideal}"
