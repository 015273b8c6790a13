"""``contactimg check``: contacts of known radius drawn into the frames, and measured again."""

from contactimg.cli import options as shared
from contactimg.cli.printing import echo_first_run, progress, say
from contactimg.timings import stage


@shared.command()
@shared.frames
@shared.scene_options(
    shared.SceneOption("--method", "measure", "method"),
    shared.SceneOption("--threshold", "measure", "threshold"),
)
def check(
    folder: shared.ExistingFolder,
    *,
    scene: str | None,
    stated: shared.Stated,
    output: shared.Output = None,
    seed: int = 1,
    workers: shared.Workers = None,
) -> int:
    """Draw contacts of known radius into the frames of FOLDER, measure them again, and say what comes out.

    The drawn contacts have the blur, the edge and the contrast that the frame shows, and lie where its own
    contacts leave room. Says which contacts are found, how far radii are off, and whether the stated
    uncertainties hold. Takes about twice as long as `process`.

    Writes check.csv (one row per class of radii), drawn.csv (one row per drawn contact), check.png (.svg,
    .pdf) and provenance.json.

    Exit codes: 0 done, 1 done but some frames could not be checked, 2 nothing done.

    \b
    Example:
      contactimg check sample_data/sa_plus -o check

    Parameters
    ----------
    seed
        Of the random radii and places.
    """
    with stage("loading"):
        from contactimg.cli.scenes import scene_of_folder
        from contactimg.files import open_experiment, write_figures, write_table
        from contactimg.pipeline.check import check_experiment
        from contactimg.plots import caption_of
        from contactimg.plots.check import plot_check
        from contactimg.tables import CHECK, DRAWN

    experiment = open_experiment(scene_of_folder(folder, stated, scene_file=scene))
    echo_first_run()
    with shared.results_in(
        output,
        folder,
        scene=experiment.scene,
        inputs=experiment.inputs,
        main_files=["check.csv", "drawn.csv"],
    ) as out:
        with progress("checking frames", len(experiment.frames)) as advance:
            result = check_experiment(experiment, seed=seed, workers=workers, advance=advance)
        write_table(result.classes, CHECK, out.folder / "check.csv")
        write_table(result.drawn, DRAWN, out.folder / "drawn.csv")
        write_figures(
            plot_check(result.drawn, result.classes), out.folder, "check", caption=caption_of("check")
        )
        out.record["sentence"] = result.sentence
        say("    radius, px  drawn  found  bias, px  rms, px  1 std  2 std")
        for row in result.classes.to_dict("records"):
            share, one, two = (100 * row[name] for name in ("completeness", "within_1_std", "within_2_std"))
            say(
                f"  {row['low_px']:5.2f} -{row['high_px']:5.2f} {row['drawn']:6d} {share:5.0f}% "
                f"{row['bias_px']:+9.3f} {row['rms_px']:8.3f} {one:5.0f}% {two:5.0f}%"
            )
        say(result.sentence)
        say(*(f"{row.frame}: not checked, {row.message}" for row in result.failed.itertuples()))
    return 1 if len(result.failed) else 0
