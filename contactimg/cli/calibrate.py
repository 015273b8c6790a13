"""``contactimg calibrate``: modulus and adhesion, threshold, plateau, from folders of frames."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Annotated, Any

import click

from contactimg import files, pipeline
from contactimg.cli import options as shared
from contactimg.cli.printing import say
from contactimg.cli.scenes import results_of, scene_of_folder
from contactimg.errors import InputError

ONE_OF_TWO = (
    "threshold and modulus cannot both be fitted to the same load curve, because slope 1 fixes only a "
    "relation between them; give a threshold that was calibrated on another sample (--calibration FILE or "
    "--threshold T)"
)

RUNNING = (*shared.FRAMES, shared.CLUSTER, shared.option("output", shared.Output), shared.WORKERS)
"""Options that every calibration has, beside those of its signature."""

MODULUS = (
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


@shared.command(*RUNNING)
def jkr(folder: shared.ExistingFolder, **common: Any) -> int:
    """Fit modulus and work of adhesion to a smooth contact.

    Measures the radius of the circular contact on each frame of FOLDER, at three or more loads, and fits the
    JKR law to radius against load. Writes calibration.json (young_modulus in Pa, work_of_adhesion in J/m^2,
    centre_x and centre_y in pixels), circles.csv (load and radius of each frame), provenance.json and
    figures.

    \b
    Example:
      contactimg calibrate jkr sample_data/smooth_jkr -o jkr
    """
    return _calibrate(folder, pipeline.run_jkr, pulled=True, **common)


@shared.command(*RUNNING, *MODULUS)
def threshold(folder: shared.ExistingFolder, *, stated: shared.Stated, jkr: Jkr = None, **common: Any) -> int:
    """Find the threshold at which local forces add up to the load.

    The sample has a known modulus: that of --jkr or --young-modulus-MPa, else that of the scene. Writes
    calibration.json (threshold as a fraction of the contrast), forces.csv (load and sum of the forces of each
    frame), curve.csv (slope against threshold), provenance.json and figures.

    \b
    Example:
      contactimg calibrate threshold sample_data/sa_plus --young-modulus-MPa 3 -o threshold
    """
    record = files.read_calibration(jkr) if jkr else {}
    return _calibrate(
        folder,
        pipeline.run_threshold,
        stated=_with_modulus(stated, jkr, record),
        used={"jkr": record},
        other_frames=record if record.get("kind") == "modulus" else {},
        **common,
    )


@shared.command(*RUNNING, *MODULUS)
def modulus(
    folder: shared.ExistingFolder,
    *,
    stated: shared.Stated,
    calibration: shared.Existing | None = None,
    threshold: Annotated[float | None, click.FloatRange(0, 1, min_open=True, max_open=True)] = None,
    jkr: Jkr = None,
    **common: Any,
) -> int:
    """Find Young's modulus at which local forces add up to the load.

    The threshold is fixed: that of --calibration or --threshold, else that of the scene. The result is
    compared with the modulus of --jkr, --young-modulus-MPa or the scene, and a note says if it lies outside
    the uncertainty of that one. Writes calibration.json (young_modulus in Pa), forces.csv (load and sum of
    the forces of each frame), provenance.json and a figure.

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
    record = files.read_calibration(calibration) if calibration else {}
    compared = files.read_calibration(jkr) if jkr else {}

    def run(experiment: files.Experiment, **how: Any) -> pipeline.Calibrated:
        """Calibrate with the threshold of the calibration, the option or the scene; disks have none."""
        from contactimg.analysis.estimates import CoverageEstimate

        found = results_of(record).get("threshold")
        if found is not None and threshold is not None:
            raise InputError("--calibration and --threshold both give the threshold; keep one of the two")
        if found is None and (threshold is not None or experiment.scene.measure.method != "disk"):
            of_scene = experiment.scene.source.get("measure", {}).get("threshold")
            given = of_scene if threshold is None else threshold
            if not isinstance(given, float | int):
                raise InputError(ONE_OF_TWO)
            found = float(given), 0.0
        fixed = None if found is None else CoverageEstimate.of_normal(*found)
        return pipeline.run_modulus(experiment, threshold=fixed, **how)

    return _calibrate(
        folder,
        run,
        stated=_with_modulus(stated, jkr, compared),
        used={"jkr": compared, "calibration": record, "threshold": threshold},
        other_frames=record if "threshold" in record.get("fitted", []) else {},
        **common,
    )


@shared.command(*RUNNING)
def plateau(folder: shared.ExistingFolder, **common: Any) -> int:
    """Find the range of thresholds where the area falls most slowly.

    For samples whose asperity radii are not known; the two ends of the range give the error bar of the area.
    Writes calibration.json (threshold, threshold_low and threshold_high as fractions of the contrast),
    curve.csv (area against threshold), areas.csv (area of each frame), provenance.json and a figure.

    \b
    Example:
      contactimg calibrate plateau sample_data/ra_plus
    """
    return _calibrate(folder, pipeline.run_plateau, **common)


for kind in (jkr, threshold, modulus, plateau):
    calibrate.add_command(kind)


def _calibrate(
    folder: str,
    run: Callable[..., "pipeline.Calibrated"],
    *,
    scene: str | None,
    stated: shared.Stated,
    output: str | None,
    pulled: bool = False,
    used: Mapping[str, Any] = MappingProxyType({}),
    other_frames: Mapping[str, Any] = MappingProxyType({}),
) -> int:
    """Run a calibration, write and print its result; return the exit code.

    ``used`` holds the earlier results that it builds on, for the provenance; the calibration ``other_frames``
    must not have used the same ones.
    """
    described, inputs = scene_of_folder(folder, stated, scene_file=scene)
    experiment = files.open_experiment(described, pulled=pulled)
    inputs += experiment.inputs
    options = {name: value for name, value in used.items() if value not in ({}, None)}
    main_files = [files.CALIBRATION_FILE]
    with shared.results_in(output, folder, described, inputs, options=options, main_files=main_files) as out:
        # a dark frame, a flat field or a mask may be that of every sample
        images = {source.path.name for source in (*experiment.frames, *experiment.references)}
        used_before = {one.get("sha256") for one in other_frames.get("frames", [])}
        if used_before & files.input_hashes(out.record["inputs"], images):
            raise InputError(ONE_OF_TWO)
        result = run(experiment)
        record = result.record | {"frames": out.record["inputs"]}
        files.write_json(record, out.folder / files.CALIBRATION_FILE)
        pipeline.write_results(out.folder, result.tables, result.figures)
        from contactimg.plots.numbers import in_display_units, numbers_of

        say(f"{folder}, calibrate {click.get_current_context().info_name}")
        for row in in_display_units(numbers_of(result.record)).itertuples():
            say(f"  {row.quantity:26} {row.value:.6g} ± {row.std:.2g} {row.unit}".rstrip())
        say(*(f"  {note}" for note in result.record["notes"]))
    return 1 if result.failed else 0


def _with_modulus(stated: shared.Stated, jkr: str | None, record: Mapping[str, Any]) -> shared.Stated:
    """The keys that options state, with the modulus of a calibration; a modulus brings its uncertainty."""
    elastic = stated.get("elastic", {})
    if jkr:
        if elastic:
            given = "--young-modulus-MPa" if "young_modulus_Pa" in elastic else "--young-modulus-std-MPa"
            raise InputError(f"--jkr and {given} both give the modulus and its uncertainty; leave out one")
        if "young_modulus" not in record:
            raise InputError(f"{jkr}: holds no young_modulus; give the calibration.json of `calibrate jkr`")
        value, std = results_of(record)["young_modulus"]
        return stated | {"elastic": {"young_modulus_Pa": value, "young_modulus_std_Pa": std}}
    if "young_modulus_Pa" in elastic:
        return stated | {"elastic": {"young_modulus_std_Pa": 0.0} | elastic}
    if elastic:
        raise InputError("--young-modulus-std-MPa needs --young-modulus-MPa; give both")
    return stated
