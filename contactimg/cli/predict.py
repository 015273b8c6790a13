"""``contactimg predict``: what the models say of a scene at given loads."""

from pathlib import Path
from typing import Any

import click

from contactimg.cli.common import command_line, echo_frames, output_option, quiet_option, verbose_option
from contactimg.timings import stage


@click.command(short_help="Contacts that the models predict at given loads.")
@click.argument("scene", type=click.Path(exists=True))
@click.option("--load-N", "loads", type=float, multiple=True, required=True, help="Load, N; repeatable.")
@output_option
@click.option(
    "--model",
    type=click.Choice(["interacting", "gw", "gt"]),
    default="interacting",
    show_default=True,
    help="Every asperity, or the averages of Greenwood-Williamson or Greenwood-Tripp.",
)
@click.option(
    "--coupling",
    type=click.Choice(["auto", "none", "asymptotic", "hertz", "full"]),
    default="auto",
    show_default=True,
    help="How asperities act on each other. auto: as the plan of the effects decides; a level: the paper's "
    "model with it, in which other effects act only where the scene switches them on.",
)
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0, min_open=True),
    help="Relative error of the output: the cheapest effects, coupling and residual that meet it.  [default: "
    "the scene's for the effects, rounding for the residual]",
)
@click.option("--annulus-mm", type=float, default=0.25, show_default=True, help="Width of profile annuli.")
@quiet_option
@verbose_option
def predict(
    *,
    scene: str,
    loads: tuple[float, ...],
    output: str | None,
    model: Any,
    coupling: Any,
    tolerance: float | None,
    annulus_mm: float,
    quiet: bool,
) -> int:
    """Predict the contacts of SCENE, a scene.toml or the folder that holds one, at each load.

    Which mechanical effects are computed is planned for each load (see `contactimg effects`). Writes
    contacts.csv, frames.csv, profile.csv and provenance.json, which holds the plans. With --tolerance the
    plan takes the cheapest effects and coupling that meet it, and says which.

    \b
    Example:
      contactimg predict sample_data/sa_plus --load-N 0.1 --load-N 0.5 -o coupled
      contactimg predict sample_data/sa_plus --load-N 0.5 --model gt -o averages
      contactimg predict sample_data/sa_plus --load-N 0.5 --tolerance 0.05 -o quick
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, with_tolerance
        from contactimg.files import OutputFolder, provenance, read_scene
        from contactimg.pipeline.predict import (
            choice_sentence,
            plan_records,
            predict_loads,
            write_predictions,
        )
        from contactimg.tables import FAILED

    description = with_tolerance(read_scene(scene), output=None, relative=tolerance)
    target = Path(output) if output is not None else Path(description.folder) / "contactimg_out"
    options = {"loads_N": list(loads), "model": model, "coupling": coupling, "annulus_mm": annulus_mm}
    options["tolerance"] = tolerance
    record = provenance(
        command=command_line("predict"),
        scene=description,
        options=options,
        inputs=model_inputs(scene, description),
    )
    with OutputFolder(target, record, main_files=["contacts.csv", "frames.csv"]) as out:
        predictions = predict_loads(
            description,
            loads,
            model=model,
            coupling=coupling,
            annulus=annulus_mm * 1e-3,
            relative=tolerance,
        )
        frames = write_predictions(predictions, description, out.folder)
        out.record["plans"] = plan_records(predictions)
    if not quiet:
        echo_frames(
            frames,
            title=f"{scene}, model {model}" + (f", coupling {coupling}" if model == "interacting" else ""),
        )
        if tolerance is not None:
            for prediction in predictions:
                click.echo(choice_sentence(prediction, relative=tolerance))
        click.echo(f"results in {target}")
    return int((frames["status"] == FAILED).any())
