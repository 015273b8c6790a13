"""``contactimg predict``: what the models say of a scene at given loads."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_frames, progress
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.files import OutputFolder
    from contactimg.prediction import Prediction, Prescribed
    from contactimg.scene import Scene


@dataclass(frozen=True, kw_only=True)
class PredictOptions:
    """What is predicted, and how accurately."""

    model: Any
    coupling: Any
    tolerance: float | None
    annulus_mm: float
    displacements_um: tuple[float, ...] = ()
    patterns: int | None = None

    @property
    def displacements(self) -> list[float]:
        """Displacements of the stage, m."""
        return [displacement / 1e6 for displacement in self.displacements_um]

    @property
    def title(self) -> str:
        """The model in words."""
        level = f", coupling {self.coupling}" if self.model == "interacting" else ""
        many = f", {self.patterns:,} patterns" if self.patterns else ""
        return f"model {self.model}{level}{many}"


@click.command(short_help="Predict the contacts at given loads with a contact model.")
@click.argument("scene", type=click.Path(exists=True))
@click.option(
    "--load-N",
    "loads",
    type=float,
    multiple=True,
    help="Normal load in newtons; repeat the option for more loads.",
)
@click.option(
    "--displacement-um",
    "displacements_um",
    type=float,
    multiple=True,
    help="Displacement of the stage from first touch, um, instead of a load: the indentation, or with "
    "[load] stiffness_N_m in the scene what a load cell of this stiffness leaves of it. Can be repeated.",
)
@shared.output("the folder of SCENE")
@click.option(
    "--model",
    type=click.Choice(["interacting", "gw", "gt"]),
    default="interacting",
    show_default=True,
    help="interacting: every asperity of the table. gw, gt: the averages of Greenwood and Williamson, or of "
    "Greenwood and Tripp.",
)
@click.option(
    "--coupling",
    type=click.Choice(["auto", "none", "asymptotic", "hertz", "full"]),
    default="auto",
    show_default=True,
    help="Elastic coupling between the asperities. auto: as the plan of the effects decides. Any other "
    "level: the paper's model with this coupling; other effects only where the scene switches them on.",
)
@click.option(
    "--tolerance",
    type=shared.positive_number,
    help="Relative error that is allowed, for example 0.05: effects, coupling and solver accuracy are the "
    "cheapest that meet it.  [default: the scene's tolerance for the effects, rounding error for the solver]",
)
@click.option(
    "--patterns",
    type=click.IntRange(min=1),
    help="Average over this many random patterns like the one that [asperities] generates. A run that is "
    "ended goes on when it is started again.",
)
@shared.annulus
@shared.one_worker
@shared.cluster
@shared.quiet
@shared.verbose
@shared.gather(PredictOptions)
def predict(
    *,
    scene: str,
    loads: tuple[float, ...],
    output: str | None,
    workers: int,
    quiet: bool,
    options: PredictOptions,
) -> int:
    """Predict the contacts of SCENE, a scene.toml or the folder that holds one, at each load or displacement.

    For each load a plan decides which mechanical effects are computed (see `contactimg effects`).

    Writes contacts.csv (one row per predicted contact), frames.csv (one row per load), profile.csv (pressure
    against distance from the apex) and provenance.json with the plans.

    Exit codes: 0 done, 1 no solution at some of the loads (frames.csv says why), 2 nothing done.

    \b
    Examples:
      contactimg predict sample_data/sa_plus --load-N 0.1 --load-N 0.5 -o coupled
      contactimg predict sample_data/sa_plus --load-N 0.5 --model gt -o averages
      contactimg predict sample_data/sa_plus --load-N 0.5 --tolerance 0.05 -o quick
      contactimg predict ensemble --load-N 0.05 --patterns 8000 --workers 4 -o average
    """
    with stage("loading"):
        from contactimg.cli.scenes import model_inputs, plausible, with_tolerance
        from contactimg.files import RUN_TABLES, OutputFolder, provenance, read_scene
        from contactimg.pipeline.predict import (
            choice_sentence,
            error_records,
            plan_records,
            prescriptions,
            write_predictions,
        )
        from contactimg.tables import FAILED

    description = with_tolerance(plausible(read_scene(scene)), output=None, relative=options.tolerance)
    target = shared.output_path(output, description.folder)
    record = provenance(
        command=shared.command_line("predict"),
        scene=description,
        options={"loads_N": list(loads)} | asdict(options),
        inputs=model_inputs(scene, description),
    )
    prescribed = prescriptions(description, loads, options.displacements)
    with OutputFolder(target, record, main_files=RUN_TABLES) as out:
        predictions = _predictions(description, prescribed, options, workers=workers, out=out, quiet=quiet)
        frames = write_predictions(predictions, description, out.folder)
        out.record["plans"] = plan_records(predictions)
        out.record["expected_errors"] = error_records(predictions)
    if not quiet:
        echo_frames(frames, title=f"{scene}, {options.title}")
        for prediction in predictions:
            if prediction.plan is not None:
                click.echo(choice_sentence(prediction, relative=options.tolerance))
        click.echo(f"results in {target}")
    return int((frames["status"] == FAILED).any())


def _predictions(
    scene: "Scene",
    loads: "list[Prescribed]",
    options: PredictOptions,
    *,
    workers: int,
    out: "OutputFolder",
    quiet: bool,
) -> "list[Prediction]":
    """The predictions at each load: of the scene's own pattern, or averaged over many."""
    with stage("loading"):
        from contactimg.errors import InputError
        from contactimg.pipeline.ensemble import predict_ensemble
        from contactimg.pipeline.predict import predict_loads, refuse_repeated, solver_tolerance
    annulus = options.annulus_mm * 1e-3
    if options.patterns is None:
        return predict_loads(
            scene,
            loads,
            model=options.model,
            coupling=options.coupling,
            annulus=annulus,
            relative=options.tolerance,
            workers=workers,
        )
    if options.model != "interacting":
        raise InputError(f'model "{options.model}" is an average over patterns itself; leave out --patterns')
    refuse_repeated(loads)
    with progress("solving patterns", options.patterns, quiet=quiet) as advance:
        return predict_ensemble(
            scene,
            loads,
            patterns=options.patterns,
            coupling=options.coupling,
            annulus=annulus,
            tolerance=None if options.tolerance is None else solver_tolerance(options.tolerance),
            workers=workers,
            store=out.part_store(),
            advance=advance,
        )
