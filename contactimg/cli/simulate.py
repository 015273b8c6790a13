"""``contactimg simulate``: a scene to synthetic frames with their truth table."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from contactimg.cli.common import command_line, output_option, progress, quiet_option, verbose_option
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.scene import Scene


@click.command(short_help="Synthetic frames of a scene with their truth.")
@click.argument("scene", type=click.Path(exists=True))
@output_option
@quiet_option
@verbose_option
def simulate(*, scene: str, output: str | None, quiet: bool) -> None:
    """Make synthetic frames of SCENE, a scene.toml or the folder that holds one.

    Its section [simulate] describes loads, optics and sensor. Writes reference.tif, frame_*.tif, loads.csv,
    asperities.csv, truth.csv and scene.toml: a folder that `process` takes as it is. Without a section
    [asperities] the flat is smooth: one contact by JKR a frame, a folder for `calibrate jkr`.

    Effects that [effects] leaves at "auto" are shown where leaving them out would change the output that
    [tolerance] names by more than it allows; `contactimg effects SCENE` prints the numbers. The scene.toml
    that is written says of each effect whether it is in the frames.

    \b
    Example:
      contactimg simulate scene.toml -o frames
      contactimg process frames
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs
        from contactimg.files import OutputFolder, provenance, read_scene
        from contactimg.pipeline.inputs import need_asperities
        from contactimg.pipeline.simulate import write_simulation
        from contactimg.pipeline.simulation_plan import plan_simulation
        from contactimg.prediction import load_name

    description = read_scene(scene)
    smooth = description.asperities is None
    asperities = None if smooth else need_asperities(description, "simulating frames")
    target = Path(output) if output is not None else Path(description.folder) / "contactimg_out"
    record = provenance(
        command=command_line("simulate"), scene=description, inputs=model_inputs(scene, description)
    )
    count = 1 + len(description.need("simulate", "simulating frames").loads)
    planned = plan_simulation(description, asperities)
    record["plans"] = {load_name(plan.load): plan.record for plan in planned.plans}
    record["effects"] = planned.scene.effects.model_dump()
    with (
        OutputFolder(target, record, main_files=["truth.csv", "scene.toml"]) as out,
        progress("making frames", count, quiet=quiet) as advance,
    ):
        write_simulation(planned.scene, asperities, out.folder, advance=advance)
    if not quiet:
        click.echo(_shown(planned.scene))
        click.echo(f"{count - 1} frames and their truth in {target}")


def _shown(scene: "Scene") -> str:
    """One line on what the frames show and what was left out."""
    switches = scene.effects.model_dump()
    shown, left_out = ([name for name, switch in switches.items() if switch == on] for on in ("on", "off"))
    sensor = {"shot_noise", "read_noise", "quantisation"}
    ideal = "; the frames are floating-point numbers without noise" if sensor <= set(left_out) else ""
    return f"computed: {', '.join(shown) or 'none'}; left out: {', '.join(left_out) or 'none'}{ideal}"
