"""Commands on the output of `process`: `overlay`, `analyse`, `report`, `review`, `export`, `import-rois`."""

from pathlib import Path
from typing import Annotated, Literal

import click

from contactimg import files, pipeline, tables
from contactimg.cli import options as shared
from contactimg.cli.printing import echo_results, echo_scores, say
from contactimg.cli.scenes import plausible
from contactimg.errors import InputError


@shared.command(shared.NO_PLAUSIBILITY, shared.WORKERS)
def overlay(
    run: shared.ExistingFolder, *, output: shared.Output = None, min_radius_px: shared.NonNegative = 1.0
) -> int:
    """Compare the contacts of RUN, an output folder of `process`, with those that the model predicts.

    The contacts are predicted at the load of each frame, once with elastic coupling between the asperities
    and once without.

    Writes scores.csv (precision and recall of each frame and model), matches.csv (pairs of a measured and a
    predicted contact), provenance.json, and a picture of each frame in overlays/: for either model matched
    contacts blue, those that it misses orange, those that it alone has in yellow dashes, and an inset.

    Exit codes: 0 done, 1 no prediction for some frames (each is named, with the reason), 2 nothing done, also
    where fewer than half of the contacts match or these show the apex of the lens elsewhere.

    \b
    Example:
      contactimg overlay results

    Parameters
    ----------
    min_radius_px
        Smallest contact radius that counts, in pixels: smaller predicted contacts need not be found on the
        frame.
    """
    measured = files.read_run(run)
    pose = measured.need_pose()
    experiment = files.open_experiment(plausible(measured.scene))
    asperities = pipeline.need_asperities(measured.scene, "predicting contacts")
    inputs = [*files.main_tables([Path(run)]), *experiment.inputs]
    main_files = ["scores.csv", "matches.csv"]
    with shared.results_in(output, run, measured.scene, inputs, main_files=main_files, then="analyse") as out:
        comparison = pipeline.compare_run(measured, asperities, min_radius_px=min_radius_px)
        counts = comparison.scores[comparison.scores["model"] == "coupled"]
        numbers = {name: int(counts[f"n_{name}"].sum()) for name in ("measured", "predicted", "matched")}
        pipeline.doubt_match(measured, pose, asperities, run, **numbers)
        made = [(tables.MATCHES, comparison.matches), (tables.SCORES, comparison.scores)]
        pipeline.write_results(out.folder, made)
        out.record["expected_errors"] = {frame: plan.error_record for frame, plan in comparison.plans.items()}
        pipeline.draw_comparison(comparison, measured, experiment, out.folder / "overlays")
        echo_scores(comparison.scores, title=f"{run}: measured against predicted contacts")
        say(*(f"{frame}: {plan.sentence()}" for frame, plan in comparison.plans.items()))
        say(*pipeline.reservations(measured.frames[measured.frames["frame"].isin(comparison.seen)]))
    for frame, reason in comparison.left_out.items():
        click.echo(f"contactimg: {frame}: no prediction, {reason}", err=True)
    return 1 if comparison.left_out else 0


@shared.command(shared.NO_PLAUSIBILITY, shared.WORKERS, shared.CLUSTER)
def analyse(
    runs: Annotated[tuple[shared.ExistingFolder, ...], "RUN [RUN ...]"],
    *,
    output: shared.Output = None,
    calibration: shared.Existing | None = None,
    annulus_mm: shared.Annulus = 0.25,
    load_tolerance: shared.NonNegative = 0.05,
    load_std_N: shared.NonNegative = 0.0,
    load_relative_std: shared.NonNegative = 0.0,
    friction_std_N: shared.NonNegative = 0.0,
    min_radius_px: shared.NonNegative = 1.0,
    models: Annotated[bool, "--models/--no-models"] = True,
    smooth: shared.ExistingFolder | None = None,
) -> None:
    """Analyse one or several RUNs (output folders of `process` or `predict`) together.

    Several runs are places on one surface, pressed by one lens; their results are averaged.

    Writes area.csv (contact area against load), profile.csv and profile_normalised.csv (pressure against
    distance from the apex), pressure_law.csv (density and mean radius of the contacts against local
    pressure), friction.csv, asperities.csv (each asperity in each frame, with displacement or upper limit),
    results.csv (exponents and other numbers with confidence intervals), provenance.json, and the figures as
    PNG, SVG and PDF.

    Exit codes: 0 done, 2 nothing done, also where fewer than half of the contacts match those of the model.

    \b
    Examples:
      contactimg analyse results
      contactimg analyse place_*/contactimg_out --calibration jkr/calibration.json -o analysis

    Parameters
    ----------
    calibration
        Take the centre of the contact from this calibration.json (or its folder) of `calibrate jkr`.
    load_tolerance
        Frames whose loads differ by less than this fraction are averaged as one load.
    load_std_N
        Standard uncertainty of a load, in newtons.
    load_relative_std
        Standard uncertainty of a load as a fraction of the load; added in quadrature.
    friction_std_N
        Standard uncertainty of a friction force, in newtons.
    min_radius_px
        Smallest contact radius that counts, in pixels: smaller contacts, measured or predicted, are left out
        of the profiles.
    models
        Compare with the contact models, solved for the same surfaces and loads.
    smooth
        Output folder of `process` for a smooth lens; its shear stress is the one to compare with.
    """
    settings = pipeline.AnalysisOptions(
        annulus=annulus_mm * 1e-3,
        load_tolerance=load_tolerance,
        load_relative_std=load_relative_std,
        load_std=load_std_N,
        friction_std=friction_std_N,
        min_radius_px=min_radius_px,
        models=models,
        smooth=None if smooth is None else pipeline.open_place(smooth),
    )
    centre = None if calibration is None else pipeline.read_centre(calibration)
    places = [pipeline.open_place(run, centre_px=centre) for run in runs]
    folders = [Path(run) for run in runs]
    inputs = [path for one in folders for path in (*files.main_tables([one]), one / files.PROVENANCE_FILE)]
    inputs += [] if calibration is None else [files.calibration_file(calibration)]
    then = "report" if len(runs) == 1 else ""
    with shared.results_in(output, runs[0], None, inputs, main_files=["results.csv"], then=then) as out:
        analysis = pipeline.analyse_places(places, settings)
        results = pipeline.write_analysis(analysis, out.folder)
        out.record["notes"] = [*pipeline.differences(places), *analysis.notes]
        echo_results(results, title=", ".join(runs))
        say(*analysis.notes)


@shared.command()
def report(
    run: shared.ExistingFolder,
    *,
    output: shared.NewFile | None = None,
    others: Annotated[tuple[shared.ExistingFolder, ...], "--with"] = (),
    max_pictures: shared.Count = 40,
) -> None:
    """Write an HTML page about RUN, an output folder of `process`, that needs no network and no other file.

    It shows the summary of the run, contact area against load, the overlays (with zoom), the flags, failed
    frames and the provenance; scores, analysis and calibration from folders inside RUN or named by --with.

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg report results
      contactimg report results --with analysis --with jkr -o run.html

    Parameters
    ----------
    output
        HTML file to write.  [default: report.html in RUN]
    others
        Include this output folder of overlay, analyse or calibrate; repeat the option for more. Those inside
        RUN are included anyway.
    max_pictures
        Largest number of frames to show; of a longer series, evenly spaced ones.
    """
    from contactimg.report import build_report

    target = Path(output or Path(run) / "report.html")
    files.write_text(build_report(run, others=others, max_pictures=max_pictures), target)
    say(f"report in {target}")


@shared.command()
def review(
    run: shared.ExistingFolder,
    *,
    port: Annotated[int | None, click.IntRange(0, 65535)] = None,
    no_browser: bool = False,
    workers: Annotated[shared.Count | None, shared.PROCESSES] = None,
) -> None:
    """Open a page that shows the frames of RUN, an output folder of `process`, with contacts to correct.

    The page is served to this machine only, under an address with a random token; Ctrl-C ends it. On another
    machine, forward the port (ssh -L 8765:127.0.0.1:8765) and open the address there. Corrections go to
    edits.csv, each before the page says so; a threshold that is chosen goes to scene.toml. Nothing else is
    written: run `contactimg process` again for tables and pictures with the corrections.

    \b
    Examples:
      contactimg review results
      contactimg review results --port 8765 --no-browser

    Parameters
    ----------
    port
        Port of this machine to serve the page on.  [default: any that is free]
    no_browser
        Print the address of the page and open no browser.
    """
    import webbrowser
    from contextlib import closing
    from threading import Thread

    from contactimg.review import ReviewServer, Session

    with closing(Session(Path(run), workers=workers)) as session:
        try:
            server = ReviewServer(session, port or 0)
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror}); choose another one") from None
        with server:
            click.echo(f"review of {run}: {server.address}")
            click.echo(f"edits go to {session.edits.path}; Ctrl-C ends the review")
            if not no_browser:
                # a browser in the terminal returns only when it is left
                Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                click.echo("review ended; run `contactimg process` again for tables with the edits")


@shared.command(shared.NO_PLAUSIBILITY)
def export(
    run: shared.ExistingFolder,
    *,
    output: shared.NewFolder | None = None,
    fiji: bool = False,
    napari: bool = False,
    labels: bool = False,
    xlsx: bool = False,
    units: Literal["um", "mm", "m"] = "um",
) -> None:
    """Write RUN, an output folder of `process`, in the formats of ImageJ, napari and Excel.

    Without a choice of formats all of them are written; those of an earlier export that are not chosen stay.
    Regions that were moved, deleted or added in ImageJ come back with `contactimg import-rois`.

    \b
    Examples:
      contactimg export results --fiji
      contactimg export results --xlsx --units mm -o for_excel

    Parameters
    ----------
    output
        Folder for the files; created if needed.  [default: export inside RUN]
    fiji
        ImageJ: regions of each frame (.zip), frames with overlay (.tif).
    napari
        napari: a shapes and a points layer of each frame (.csv).
    labels
        Label images: the pixels of each contact hold its label (.tif).
    xlsx
        An Excel workbook with one sheet a table.
    units
        Lengths and areas of the workbook; forces are in mN, with m in N.
    """
    chosen = {"fiji": fiji, "napari": napari, "labels": labels, "xlsx": xlsx}
    formats = tuple(name for name, on in chosen.items() if on) or tuple(chosen)
    others = ["contacts.xlsx" if name == "xlsx" else name for name in chosen if name not in formats]
    source = files.read_run(run)
    inputs = files.main_tables([source.folder])
    target = output or Path(run) / "export"
    main_files = ["contacts.xlsx"] if "xlsx" in formats else []
    with shared.results_in(target, run, source.scene, inputs, main_files=main_files, keeps=others) as out:
        pipeline.export_run(source, out.folder, formats=formats, units=units)


@shared.command(shared.NO_PLAUSIBILITY)
def import_rois(
    run: shared.ExistingFolder,
    file: shared.ExistingFile,
    *,
    frame: str | None = None,
    output: shared.NewFile | None = None,
    author: str = "",
) -> None:
    """Compare the ImageJ regions in FILE with the contacts of RUN and write the changes to edits.csv.

    FILE is what `contactimg export --fiji` wrote for one frame and ImageJ saved again (ROI Manager, Save). A
    region that was deleted excludes its contact, a new one adds a contact, a moved one does both. Then run
    `contactimg process` again: it measures the contacts from the pixels.

    \b
    Examples:
      contactimg import-rois results results/export/fiji/frame_1.tif.zip
      contactimg process my_frames

    Parameters
    ----------
    frame
        The frame that the regions belong to.  [default: as the name of FILE says]
    output
        Table of edits; rows are added to what is there.  [default: the one that the scene of RUN uses,
        edits.csv beside the frames]
    author
        For the column author.
    """
    from datetime import UTC, datetime

    source = files.read_run(run)
    time = datetime.now(UTC).isoformat(timespec="seconds")
    edits = pipeline.edits_from_regions(source, Path(file), frame=frame, author=author, time=time)
    target = Path(output or files.edits_file(source.scene))
    if len(edits):
        files.EditsFile(target).insert(edits)
    counts = edits["action"].value_counts()
    told = ", ".join(f"{counts.get(action, 0)} {action}" for action in ("exclude", "add"))
    say(f"{told} in {target}; run `contactimg process` again" if len(edits) else "nothing was changed")
