"""``contactimg calibrate``: modulus and adhesion, threshold, plateau, from folders of frames."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from contactimg.cli.common import (
    command_line,
    output_option,
    progress,
    quiet_option,
    verbose_option,
    workers_option,
)
from contactimg.errors import InputError
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.calibration.coverage_estimate import CoverageEstimate
    from contactimg.files import Experiment
    from contactimg.pipeline.calibrate.result import Calibrated
    from contactimg.scene import Scene

Run = Callable[..., "Calibrated"]

folder_argument = click.argument("folder", type=click.Path(exists=True, file_okay=False))
scene_option = click.option(
    "--scene", type=click.Path(exists=True, dir_okay=False), help="Scene file instead of FOLDER's."
)
jkr_option = click.option(
    "--jkr", type=click.Path(exists=True), help="Result of `calibrate jkr`, which has the modulus."
)
modulus_option = click.option("--young-modulus-MPa", type=float, help="Measured modulus, MPa.")
modulus_std_option = click.option(
    "--young-modulus-std-MPa", type=float, help="Its standard uncertainty, MPa."
)


def common_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The arguments and options that every calibration has."""
    for option in (
        verbose_option,
        quiet_option,
        workers_option,
        output_option,
        scene_option,
        folder_argument,
    ):
        command = option(command)
    return command


@click.group(short_help="Modulus and adhesion, threshold, plateau from frames.")
def calibrate() -> None:
    """The paper's calibrations, each on a FOLDER of frames with its scene.toml.

    Each writes calibration.json (every number with its standard uncertainty and unit, what was fixed and what
    fitted, the quality of the fit), tables and figures. `process --calibration FILE` uses the result.
    """


@calibrate.command()
@common_options
def jkr(*, folder: str, **given: Any) -> int:
    """Modulus, work of adhesion and centre from frames of the smooth contact at three loads or more.

    \b
    Example:
      contactimg calibrate jkr sample_data/smooth_jkr -o jkr
    """
    with stage("loading"):
        from contactimg.pipeline.calibrate.jkr import run_jkr

    return _run("jkr", folder, given, {}, run_jkr, pulled=True)


@calibrate.command()
@common_options
@jkr_option
@modulus_option
@modulus_std_option
def threshold(*, folder: str, **given: Any) -> int:
    """The threshold at which the local forces of a sample of known modulus add up to the load.

    \b
    Example:
      contactimg calibrate threshold sample_data/sa_plus --young-modulus-MPa 3 -o threshold
    """
    with stage("loading"):
        from contactimg.files import read_calibration, shares_frames
        from contactimg.pipeline.calibrate.threshold import run_threshold

    record = read_calibration(given["jkr"]) if given["jkr"] else {}

    def run(experiment: "Experiment", **options: Any) -> "Calibrated":
        if record.get("kind") == "modulus" and shares_frames(record, _fingerprints(experiment)):
            raise InputError(BOTH)
        return run_threshold(experiment, **options)

    return _run("threshold", folder, given, _modulus(given), run)


BOTH = (
    "threshold and modulus cannot both be fitted on one load curve: slope 1 fixes only a line in the plane "
    "of the two; give a threshold calibrated on another sample (--calibration FILE or --threshold T)"
)


@calibrate.command()
@common_options
@click.option("--calibration", type=click.Path(exists=True), help="Result of `calibrate threshold`.")
@click.option("--threshold", type=float, help="Threshold that is kept, fraction of the contrast.")
@jkr_option
@modulus_option
@modulus_std_option
def modulus(*, folder: str, **given: Any) -> int:
    """The modulus at which the local forces add up to the load, the threshold kept.

    Says when it lies outside the uncertainty of the modulus measured before (the scene's, --jkr or
    --young-modulus-MPa).

    \b
    Example:
      contactimg calibrate modulus my_sample --calibration threshold/calibration.json
    """
    with stage("loading"):
        from contactimg.files import read_calibration, shares_frames
        from contactimg.pipeline.calibrate.modulus import run_modulus

    record = read_calibration(given["calibration"]) if given["calibration"] else {}

    def run(experiment: "Experiment", **options: Any) -> "Calibrated":
        if "threshold" in record.get("fitted", []) and shares_frames(record, _fingerprints(experiment)):
            raise InputError(BOTH)
        kept = _kept_threshold(experiment.scene, record, given["threshold"])
        return run_modulus(experiment, threshold=kept, **options)

    return _run("modulus", folder, given, _modulus(given), run)


@calibrate.command()
@common_options
def plateau(*, folder: str, **given: Any) -> int:
    """The thresholds between which the total area changes only marginally, for radii that are not known.

    \b
    Example:
      contactimg calibrate plateau sample_data/ra_plus
    """
    with stage("loading"):
        from contactimg.pipeline.calibrate.plateau import run_plateau

    return _run("plateau", folder, given, {}, run_plateau)


def _run(
    kind: str,
    folder: str,
    given: dict[str, Any],
    elastic: dict[str, float],
    run: Run,
    *,
    pulled: bool = False,
) -> int:
    """Open the folder, calibrate, write, print."""
    with stage("loading"):
        from contactimg.cli.scenes import scene_of_folder
        from contactimg.files import OutputFolder, open_experiment, provenance, read_calibration
        from contactimg.pipeline.calibrate.result import write_calibration
        from contactimg.scene import scene_from_dict

    scene = scene_of_folder(folder, {"scene": given["scene"]})
    if elastic:
        data = {**scene.source, "elastic": {**scene.source.get("elastic", {}), **elastic}}
        scene = scene_from_dict(data, name="the options and the scene", folder=scene.folder)
    experiment = open_experiment(scene, pulled=pulled)
    target = Path(given["output"]) if given["output"] is not None else Path(folder) / "contactimg_out"
    used = {name: read_calibration(given[name]) for name in ("jkr", "calibration") if given.get(name)}
    kept = {} if given.get("threshold") is None else {"threshold": given["threshold"]}
    record = provenance(
        command=command_line(f"calibrate {kind}"),
        scene=scene,
        options=used | kept,
        inputs=experiment.inputs,
    )
    count, quiet = len(experiment.frames), given["quiet"]
    with OutputFolder(target, record, main_files=["calibration.json"]) as out:
        with progress("measuring frames", count, quiet=quiet) as advance:
            result = run(experiment, workers=given["workers"], advance=advance)
        write_calibration(result, out.folder, frames=record["inputs"])
    if not quiet:
        _echo(result, title=f"{folder}, calibrate {kind}")
        click.echo(f"results in {target}")
    return 1 if result.failed else 0


def _echo(result: "Calibrated", *, title: str) -> None:
    """Print each number with its uncertainty, and the notes."""
    click.echo(title)
    for name, entry in result.record.items():
        if isinstance(entry, dict) and {"value", "std", "unit"} <= set(entry):
            unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
            click.echo(f"  {name:26} {entry['value']:.6g} ± {entry['std']:.2g}{unit}")
    for note in result.notes:
        click.echo(f"  {note}")


def _modulus(given: dict[str, Any]) -> dict[str, float]:
    """The elastic section's keys that the options give."""
    from contactimg.files import read_calibration

    if given["jkr"] and given["young_modulus_mpa"] is not None:
        raise InputError("--jkr and --young-modulus-MPa both give the modulus; keep one of the two")
    if given["jkr"]:
        record = read_calibration(given["jkr"])
        if "young_modulus" not in record:
            raise InputError(f"{given['jkr']}: holds no young_modulus; give the result of `calibrate jkr`")
        entry = record["young_modulus"]
        return {"young_modulus_Pa": entry["value"], "young_modulus_std_Pa": entry.get("std") or 0.0}
    if given["young_modulus_mpa"] is None:
        if given["young_modulus_std_mpa"] is not None:
            raise InputError("--young-modulus-std-MPa needs --young-modulus-MPa")
        return {}
    return {
        "young_modulus_Pa": given["young_modulus_mpa"] * 1e6,
        "young_modulus_std_Pa": (given["young_modulus_std_mpa"] or 0.0) * 1e6,
    }


def _kept_threshold(scene: "Scene", record: dict[str, Any], value: float | None) -> "CoverageEstimate | None":
    """The threshold that is kept: the calibration's, the option's or the scene's; None for disks."""
    from contactimg.calibration.coverage_estimate import CoverageEstimate

    if "threshold" in record and value is not None:
        raise InputError("--calibration and --threshold both give the threshold; keep one of the two")
    if "threshold" in record:
        entry = record["threshold"]
        std = float(entry.get("std") or 0.0)
        return CoverageEstimate(entry["value"], std, entry["value"] - 1.96 * std, entry["value"] + 1.96 * std)
    if value is not None:
        return CoverageEstimate(value, 0.0, value, value)
    stated = scene.source.get("measure", {}).get("threshold")
    if isinstance(stated, float | int) and scene.measure.method == "threshold":
        return CoverageEstimate(float(stated), 0.0, float(stated), float(stated))
    if scene.measure.method == "disk":
        return None
    raise InputError(BOTH)


def _fingerprints(experiment: "Experiment") -> list[dict[str, Any]]:
    """The inputs of an experiment with their sha256."""
    from contactimg.files import provenance

    inputs: list[dict[str, Any]] = provenance(command="", inputs=experiment.inputs)["inputs"]
    return inputs
