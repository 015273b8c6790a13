"""``contactimg calibrate``: modulus and adhesion, threshold, plateau, from folders of frames."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from contactimg.cli import shared_options as shared
from contactimg.cli.printing import echo_first_run, progress
from contactimg.cli.shared_options import FrameOptions, SceneOptions
from contactimg.errors import InputError
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.calibration.coverage_estimate import CoverageEstimate
    from contactimg.files import Experiment
    from contactimg.pipeline.calibrate.result import Calibrated

Command = Callable[..., Any]

ONE_OF_TWO = (
    "threshold and modulus cannot both be fitted to the same load curve, because slope 1 fixes only a "
    "relation between them; give a threshold that was calibrated on another sample (--calibration FILE or "
    "--threshold T)"
)


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions(FrameOptions):
    """Options that every calibration has."""

    output: str | None
    workers: int | None
    quiet: bool


@dataclass(frozen=True, kw_only=True)
class ElasticOptions(CalibrationOptions):
    """Options of a calibration that needs Young's modulus."""

    jkr: str | None
    young_modulus_mpa: float | None
    young_modulus_std_mpa: float | None


@dataclass(frozen=True, kw_only=True)
class ThresholdOptions(ElasticOptions):
    """Options of a calibration at a fixed threshold."""

    calibration: str | None
    threshold: float | None


def common_options(command: Command) -> Command:
    """Add the argument and the options that every calibration has."""
    for option in (
        shared.verbose,
        shared.quiet,
        shared.cluster,
        shared.workers,
        shared.output("FOLDER"),
        shared.frames,
        click.argument("folder", type=shared.existing_folder),
    ):
        command = option(command)
    return command


def elastic_options(command: Command) -> Command:
    """Add the options that give Young's modulus."""
    std = click.option(
        "--young-modulus-std-MPa", type=float, help="Standard uncertainty of the modulus, in MPa."
    )
    value = click.option("--young-modulus-MPa", type=float, help="Young's modulus of the rubber, in MPa.")
    file = click.option(
        "--jkr",
        type=click.Path(exists=True),
        help="Take Young's modulus from this calibration.json (or its folder) of `calibrate jkr`.",
    )
    return file(value(std(command)))


@click.group(short_help="Calibrate the modulus, the threshold or the plateau on a folder of frames.")
def calibrate() -> None:
    """Calibrate the modulus, the threshold or the plateau on a FOLDER of frames with its scene.toml.

    Each calibration writes calibration.json (every number with its standard uncertainty and unit, which
    quantities were fixed and which were fitted, and the quality of the fit), tables as CSV and figures.
    `contactimg process --calibration FILE` uses the result.

    The usual order: jkr on a smooth sample, threshold on a textured sample of the same rubber, modulus on
    other samples. Where the radii of the asperities are not known, plateau gives the range of thresholds.

    Exit codes: 0 done, 1 done but some frames failed, 2 nothing done.
    """


@calibrate.command(short_help="Young's modulus, work of adhesion and centre from a smooth contact.")
@common_options
@shared.gather(CalibrationOptions)
def jkr(*, folder: str, options: CalibrationOptions) -> int:
    """Fit Young's modulus and the work of adhesion to frames of a smooth contact at three or more loads.

    Measures the radius of the circular contact on each frame of FOLDER and fits the JKR law to radius against
    load. Writes calibration.json (young_modulus in Pa, work_of_adhesion in J/m^2, centre_x and centre_y in
    pixels), circles.csv (load and radius of each frame), provenance.json and figures.

    \b
    Example:
      contactimg calibrate jkr sample_data/smooth_jkr -o jkr
    """
    with stage("loading"):
        from contactimg.pipeline.calibrate.jkr import run_jkr

    experiment = _open(folder, options, {}, pulled=True)
    return _calibrate("jkr", folder, options, experiment, run_jkr)


@calibrate.command(short_help="The threshold at which the local forces add up to the load.")
@common_options
@elastic_options
@shared.gather(ElasticOptions)
def threshold(*, folder: str, options: ElasticOptions) -> int:
    """Find the threshold at which the local forces of a sample of known modulus add up to the load.

    Young's modulus is that of --jkr or --young-modulus-MPa, else that of the scene. Writes calibration.json
    (threshold as a fraction of the contrast), forces.csv (load and sum of the forces of each frame),
    curve.csv (slope against threshold), provenance.json and figures.

    \b
    Example:
      contactimg calibrate threshold sample_data/sa_plus --young-modulus-MPa 3 -o threshold
    """
    with stage("loading"):
        from contactimg.files import read_calibration, shares_frames
        from contactimg.pipeline.calibrate.force_sums import run_threshold

    experiment = _open(folder, options, _modulus(options))
    record = read_calibration(options.jkr) if options.jkr else {}
    if record.get("kind") == "modulus" and shares_frames(record, _fingerprints(experiment)):
        raise InputError(ONE_OF_TWO)
    used = {"jkr": record} if record else {}
    return _calibrate("threshold", folder, options, experiment, run_threshold, used=used)


@calibrate.command(short_help="Young's modulus at which the local forces add up to the load.")
@common_options
@click.option(
    "--calibration",
    type=click.Path(exists=True),
    help="Take the threshold from this calibration.json (or its folder) of `calibrate threshold`.",
)
@click.option("--threshold", type=float, help="Threshold as a fraction of the contrast, from 0 to 1.")
@elastic_options
@shared.gather(ThresholdOptions)
def modulus(*, folder: str, options: ThresholdOptions) -> int:
    """Find Young's modulus at which the local forces add up to the load, with the threshold fixed.

    The threshold is that of --calibration or --threshold, else that of the scene. The result is compared with
    the modulus of --jkr, --young-modulus-MPa or the scene, and a note says if it lies outside the uncertainty
    of that one. Writes calibration.json (young_modulus in Pa), forces.csv (load and sum of the forces of each
    frame), provenance.json and a figure.

    \b
    Example:
      contactimg calibrate modulus my_sample --calibration threshold/calibration.json
    """
    with stage("loading"):
        from contactimg.files import read_calibration, shares_frames
        from contactimg.pipeline.calibrate.force_sums import run_modulus

    experiment = _open(folder, options, _modulus(options))
    record = read_calibration(options.calibration) if options.calibration else {}
    if "threshold" in record.get("fitted", []) and shares_frames(record, _fingerprints(experiment)):
        raise InputError(ONE_OF_TWO)
    run = partial(run_modulus, threshold=_fixed_threshold(experiment, record, options.threshold))
    used: dict[str, Any] = {"jkr": read_calibration(options.jkr)} if options.jkr else {}
    if record:
        used["calibration"] = record
    if options.threshold is not None:
        used["threshold"] = options.threshold
    return _calibrate("modulus", folder, options, experiment, run, used=used)


@calibrate.command(short_help="The range of thresholds over which the contact area hardly changes.")
@common_options
@shared.gather(CalibrationOptions)
def plateau(*, folder: str, options: CalibrationOptions) -> int:
    """Find the range of thresholds over which the total contact area hardly changes.

    For samples whose asperity radii are not known; the two ends of the range give the error bar of the area.
    Writes calibration.json (threshold, threshold_low and threshold_high as fractions of the contrast),
    curve.csv (area against threshold), areas.csv (area of each frame), provenance.json and a figure.

    \b
    Example:
      contactimg calibrate plateau sample_data/ra_plus
    """
    with stage("loading"):
        from contactimg.pipeline.calibrate.force_sums import run_plateau

    return _calibrate("plateau", folder, options, _open(folder, options, {}), run_plateau)


def _open(
    folder: str, options: CalibrationOptions, elastic: dict[str, float], *, pulled: bool = False
) -> "Experiment":
    """The frames of a folder; ``elastic`` replaces keys of that section of the scene."""
    with stage("loading"):
        from contactimg.cli.scenes import scene_of_folder
        from contactimg.files import open_experiment
        from contactimg.scene import scene_from_dict

    given = {field.name: getattr(options, field.name) for field in fields(FrameOptions)}
    scene = scene_of_folder(folder, SceneOptions(**given))
    if elastic:
        data = {**scene.source, "elastic": {**scene.source.get("elastic", {}), **elastic}}
        scene = scene_from_dict(data, name="the options and the scene", folder=scene.folder)
    return open_experiment(scene, pulled=pulled)


def _calibrate(
    kind: str,
    folder: str,
    options: CalibrationOptions,
    experiment: "Experiment",
    run: Callable[..., "Calibrated"],
    *,
    used: dict[str, Any] | None = None,
) -> int:
    """Run a calibration, write and print its result; return the exit code.

    ``used`` holds the earlier results that it builds on, for the provenance.
    """
    with stage("loading"):
        from contactimg.files import OutputFolder, provenance
        from contactimg.pipeline.calibrate.result import write_calibration

    target = shared.output_path(options.output, folder)
    record = provenance(
        command=shared.command_line(f"calibrate {kind}"),
        scene=experiment.scene,
        options=used or {},
        inputs=experiment.inputs,
    )
    echo_first_run(quiet=options.quiet)
    with OutputFolder(target, record, main_files=["calibration.json"]) as out:
        with progress("measuring frames", len(experiment.frames), quiet=options.quiet) as advance:
            result = run(experiment, workers=options.workers, advance=advance)
        write_calibration(result, out.folder, frames=record["inputs"])
    if not options.quiet:
        _echo(result, title=f"{folder}, calibrate {kind}")
        click.echo(f"results in {target}")
    return 1 if result.failed else 0


def _echo(result: "Calibrated", *, title: str) -> None:
    """Print each number with its uncertainty, and the notes."""
    from contactimg.report.units import display_unit

    click.echo(title)
    for name, entry in result.record.items():
        if isinstance(entry, dict) and {"value", "std", "unit"} <= set(entry):
            factor, unit = display_unit(entry["value"], entry["unit"])
            numbers = f"{entry['value'] * factor:.6g} ± {entry['std'] * factor:.2g}"
            click.echo(f"  {name:26} {numbers} {unit}".rstrip())
    _echo_uncertainties(result)
    for note in result.notes:
        click.echo(f"  {note}")


def _echo_uncertainties(result: "Calibrated") -> None:
    """Print what each source of error does to the result, where the calibration knows."""
    if "uncertainties.csv" not in result.tables:
        return
    _, table = result.tables["uncertainties.csv"]
    click.echo(f"  {'what may be off':38} {'by':>12}   {'E':>8} {'w':>8}")
    for row in table.to_dict("records"):
        size = (
            f"{row['size']:.2g} {row['unit']}" if row["unit"] in ("N", "m") else f"{100 * row['size']:.2g} %"
        )
        size = "" if row["unit"] == "std" else size
        changes = " ".join(f"{100 * row[name]:+7.2f}%" for name in ("young_modulus", "work_of_adhesion"))
        click.echo(f"  {row['source']:38} {size:>12}   {changes} {row['state']}")


def _modulus(options: ElasticOptions) -> dict[str, float]:
    """The keys of the section [elastic] that the options replace."""
    from contactimg.files import read_calibration

    value, std = options.young_modulus_mpa, options.young_modulus_std_mpa
    if options.jkr and value is not None:
        raise InputError("--jkr and --young-modulus-MPa both give the modulus; keep one of the two")
    if options.jkr:
        record = read_calibration(options.jkr)
        if "young_modulus" not in record:
            raise InputError(
                f"{options.jkr}: holds no young_modulus; give the calibration.json of `calibrate jkr`"
            )
        entry = record["young_modulus"]
        return {"young_modulus_Pa": entry["value"], "young_modulus_std_Pa": entry.get("std") or 0.0}
    if value is None:
        if std is not None:
            raise InputError("--young-modulus-std-MPa needs --young-modulus-MPa; give both")
        return {}
    return {"young_modulus_Pa": value * 1e6, "young_modulus_std_Pa": (std or 0.0) * 1e6}


def _fixed_threshold(
    experiment: "Experiment", record: dict[str, Any], option: float | None
) -> "CoverageEstimate | None":
    """The threshold of the calibration, the option or the scene; None for the method "disk"."""
    from contactimg.calibration.coverage_estimate import CoverageEstimate

    if "threshold" in record and option is not None:
        raise InputError("--calibration and --threshold both give the threshold; keep one of the two")
    if "threshold" in record:
        value, std = record["threshold"]["value"], float(record["threshold"].get("std") or 0.0)
        return CoverageEstimate.of_normal(value, std)
    scene = experiment.scene
    stated = scene.source.get("measure", {}).get("threshold")
    if option is None and isinstance(stated, float | int) and scene.measure.method == "threshold":
        option = float(stated)
    if option is not None:
        return CoverageEstimate(option, 0.0, option, option)
    if scene.measure.method == "disk":
        return None
    raise InputError(ONE_OF_TWO)


def _fingerprints(experiment: "Experiment") -> list[dict[str, Any]]:
    """The inputs of an experiment with their sha256."""
    from contactimg.files import provenance

    inputs: list[dict[str, Any]] = provenance(command="", inputs=experiment.inputs)["inputs"]
    return inputs
