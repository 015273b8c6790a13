"""``contactimg simulate``: a scene to synthetic frames with their truth table."""

from pathlib import Path

import click

from contactimg.cli.common import command_line, output_option, progress, quiet_option, verbose_option
from contactimg.timings import stage

__all__ = ["simulate"]


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

    description = read_scene(scene)
    smooth = description.asperities is None
    asperities = None if smooth else need_asperities(description, "simulating frames")
    target = Path(output) if output is not None else Path(description.folder) / "contactimg_out"
    record = provenance(
        command=command_line("simulate"), scene=description, inputs=model_inputs(scene, description)
    )
    count = 1 + len(description.need("simulate", "simulating frames").loads)
    with (
        OutputFolder(target, record, main_files=["truth.csv", "scene.toml"]) as out,
        progress("making frames", count, quiet=quiet) as advance,
    ):
        write_simulation(description, asperities, out.folder, advance=advance)
    if not quiet:
        click.echo(f"{count - 1} frames and their truth in {target}")
