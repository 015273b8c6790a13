"""``contactimg calibrate``: modulus and adhesion, threshold, plateau, from folders of frames."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import click

from contactimg.cli import options as shared
from contactimg.cli.printing import echo_first_run, progress, say
from contactimg.errors import InputError

if TYPE_CHECKING:
    from contactimg.calibration.coverage_estimate import CoverageEstimate
    from contactimg.files import Experiment
    from contactimg.pipeline.calibrate.result import Calibrated

ONE_OF_TWO = (
    "threshold and modulus cannot both be fitted to the same load curve, because slope 1 fixes only a "
    "relation between them; give a threshold that was calibrated on another sample (--calibration FILE or "
    "--threshold T)"
)


running = shared.together(
    shared.frames,
    shared.cluster,
    shared.option("output", shared.Output),
    shared.option("workers", shared.Workers),
)
"""Options that every calibration has, beside those of its signature."""

modulus_options = shared.scene_options(
    shared.SceneOption("--young-modulus-MPa", "elastic", "young_modulus_Pa"),
    shared.SceneOption("--young-modulus-std-MPa", "elastic", "young_modulus_std_Pa", default=""),
)

Jkr = Annotated[
    shared.Existing | None,
    "Take Young's modulus from this calibration.json (or its folder) of `calibrate jkr`.",
]


@click.group()
def calibrate() -> None:
    """Calibrate the modulus, the threshold or the plateau on a FOLDER of frames with its scene.toml.

    Each calibration writes calibration.json (every number with its standard uncertainty and unit, which
    quantities were fixed and which were fitted, and the quality of the fit), tables as CSV and figures.
    `contactimg process --calibration FILE` uses the result.

    The usual order: jkr on a smooth sample, threshold on a textured sample of the same rubber, modulus on
    other samples. Where the radii of the asperities are not known, plateau gives the range of thresholds.

    Exit codes: 0 done, 1 done but some frames failed, 2 nothing done.
    """


@shared.command(calibrate, "Young's modulus, work of adhesion and centre from a smooth contact.")
@running
def jkr(folder: shared.ExistingFolder, **common: Any) -> int:
    """Fit Young's modulus and the work of adhesion to frames of a smooth contact at three or more loads.

    Measures the radius of the circular contact on each frame of FOLDER and fits the JKR law to radius against
    load. Writes calibration.json (young_modulus in Pa, work_of_adhesion in J/m^2, centre_x and centre_y in
    pixels), circles.csv (load and radius of each frame), provenance.json and figures.

    \b
    Example:
      contactimg calibrate jkr sample_data/smooth_jkr -o jkr
    """
    from contactimg.pipeline.calibrate.jkr import run_jkr

    return _calibrate("jkr", folder, run_jkr, pulled=True, **common)


@shared.command(calibrate, "The threshold at which the local forces add up to the load.")
@running
@modulus_options
def threshold(folder: shared.ExistingFolder, *, stated: shared.Stated, jkr: Jkr = None, **common: Any) -> int:
    """Find the threshold at which the local forces of a sample of known modulus add up to the load.

    Young's modulus is that of --jkr or --young-modulus-MPa, else that of the scene. Writes calibration.json
    (threshold as a fraction of the contrast), forces.csv (load and sum of the forces of each frame),
    curve.csv (slope against threshold), provenance.json and figures.

    \b
    Example:
      contactimg calibrate threshold sample_data/sa_plus --young-modulus-MPa 3 -o threshold
    """
    from contactimg.files import read_calibration
    from contactimg.pipeline.calibrate.thresholds import run_threshold

    record = read_calibration(jkr) if jkr else {}
    return _calibrate(
        "threshold",
        folder,
        run_threshold,
        stated=_with_modulus(stated, jkr),
        used={"jkr": record} if record else {},
        other_frames=record if record.get("kind") == "modulus" else None,
        **common,
    )


@shared.command(calibrate, "Young's modulus at which the local forces add up to the load.")
@running
@modulus_options
def modulus(
    folder: shared.ExistingFolder,
    *,
    stated: shared.Stated,
    calibration: shared.Existing | None = None,
    threshold: float | None = None,
    jkr: Jkr = None,
    **common: Any,
) -> int:
    """Find Young's modulus at which the local forces add up to the load, with the threshold fixed.

    The threshold is that of --calibration or --threshold, else that of the scene. The result is compared with
    the modulus of --jkr, --young-modulus-MPa or the scene, and a note says if it lies outside the uncertainty
    of that one. Writes calibration.json (young_modulus in Pa), forces.csv (load and sum of the forces of each
    frame), provenance.json and a figure.

    \b
    Example:
      contactimg calibrate modulus my_sample --calibration threshold/calibration.json

    Parameters
    ----------
    calibration
        Take the threshold from this calibration.json (or its folder) of `calibrate threshold`.
    threshold
        Threshold as a fraction of the contrast, from 0 to 1.
    """
    from contactimg.files import read_calibration
    from contactimg.pipeline.calibrate.thresholds import run_modulus

    record = read_calibration(calibration) if calibration else {}

    def run(experiment: "Experiment", **how: Any) -> "Calibrated":
        return run_modulus(experiment, threshold=_fixed_threshold(experiment, record, threshold), **how)

    used = {"jkr": read_calibration(jkr) if jkr else {}, "calibration": record, "threshold": threshold}
    return _calibrate(
        "modulus",
        folder,
        run,
        stated=_with_modulus(stated, jkr),
        used={name: value for name, value in used.items() if value not in ({}, None)},
        other_frames=record if "threshold" in record.get("fitted", []) else None,
        **common,
    )


@shared.command(calibrate, "The range of thresholds over which the contact area hardly changes.")
@running
def plateau(folder: shared.ExistingFolder, **common: Any) -> int:
    """Find the range of thresholds over which the total contact area hardly changes.

    For samples whose asperity radii are not known; the two ends of the range give the error bar of the area.
    Writes calibration.json (threshold, threshold_low and threshold_high as fractions of the contrast),
    curve.csv (area against threshold), areas.csv (area of each frame), provenance.json and a figure.

    \b
    Example:
      contactimg calibrate plateau sample_data/ra_plus
    """
    from contactimg.pipeline.calibrate.thresholds import run_plateau

    return _calibrate("plateau", folder, run_plateau, **common)


def _calibrate(
    kind: str,
    folder: str,
    run: Callable[..., "Calibrated"],
    *,
    scene: str | None,
    stated: shared.Stated,
    output: str | None,
    workers: int | None,
    pulled: bool = False,
    used: dict[str, Any] | None = None,
    other_frames: Mapping[str, Any] | None = None,
) -> int:
    """Run a calibration, write and print its result; return the exit code.

    ``used`` holds the earlier results that it builds on, for the provenance; the calibration ``other_frames``
    must not have used the same ones.
    """
    from contactimg.cli.scenes import scene_of_folder
    from contactimg.files import open_experiment, shares_frames
    from contactimg.pipeline.calibrate.result import write_calibration

    experiment = open_experiment(scene_of_folder(folder, stated, scene_file=scene), pulled=pulled)
    echo_first_run()
    with shared.results_in(
        output,
        folder,
        scene=experiment.scene,
        options=used or {},
        inputs=experiment.inputs,
        main_files=["calibration.json"],
    ) as out:
        if other_frames and shares_frames(other_frames, out.record["inputs"]):
            raise InputError(ONE_OF_TWO)
        with progress("measuring frames", len(experiment.frames)) as advance:
            result = run(experiment, workers=workers, advance=advance)
        write_calibration(result, out.folder, frames=out.record["inputs"])
        _echo(result, title=f"{folder}, calibrate {kind}")
    return 1 if result.failed else 0


def _echo(result: "Calibrated", *, title: str) -> None:
    """Print each number with its uncertainty, and the notes."""
    from contactimg.report.units import display_unit

    say(title)
    for name, entry in result.record.items():
        if isinstance(entry, dict) and {"value", "std", "unit"} <= set(entry):
            factor, unit = display_unit(entry["value"], entry["unit"])
            numbers = f"{entry['value'] * factor:.6g} ± {entry['std'] * factor:.2g}"
            say(f"  {name:26} {numbers} {unit}".rstrip())
    say(*(f"  {note}" for note in result.notes))


def _with_modulus(stated: shared.Stated, jkr: str | None) -> shared.Stated:
    """The keys that options state, with the modulus of a calibration; a modulus brings its uncertainty."""
    from contactimg.files import read_calibration

    elastic = stated.get("elastic", {})
    if jkr:
        if "young_modulus_Pa" in elastic:
            raise InputError("--jkr and --young-modulus-MPa both give the modulus; keep one of the two")
        record = read_calibration(jkr)
        if "young_modulus" not in record:
            raise InputError(f"{jkr}: holds no young_modulus; give the calibration.json of `calibrate jkr`")
        entry = record["young_modulus"]
        elastic = {"young_modulus_Pa": entry["value"], "young_modulus_std_Pa": entry.get("std") or 0.0}
    elif "young_modulus_Pa" in elastic:
        elastic = {"young_modulus_std_Pa": 0.0} | elastic
    elif elastic:
        raise InputError("--young-modulus-std-MPa needs --young-modulus-MPa; give both")
    return stated | {"elastic": elastic}


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
