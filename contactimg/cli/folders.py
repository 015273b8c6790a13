"""Commands on folders of frames: `init` describes them, `process` measures them, `check` tests that."""

import json
import shlex
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

from contactimg import files, pipeline, plots, tables
from contactimg.cli import options as shared
from contactimg.cli.printing import echo_frames, echo_table, say
from contactimg.cli.scenes import describe_use, plausible, refuse_idle, scene_of_folder
from contactimg.errors import InputError
from contactimg.scene import scene_from_dict, section_keys

if TYPE_CHECKING:
    import pandas as pd


METHOD = shared.SceneOption("--method", "measure", "method")
SHAPE = shared.SceneOption("--shape", "measure", "shape")
THRESHOLD = shared.SceneOption("--threshold", "measure", "threshold")

JOINED_FOLDER = "combined"
"""Inside the output folder of several folders: their tables as one."""


@shared.command(*shared.FRAMES, METHOD, SHAPE, THRESHOLD, shared.WORKERS, shared.CLUSTER)
def process(
    folders: Annotated[tuple[shared.Existing, ...], "FOLDER..."],
    *,
    scene: str | None,
    stated: shared.Stated,
    output: shared.Output = None,
    calibration: shared.Existing | None = None,
    pictures: Annotated[bool, "--pictures/--no-pictures"] = True,
    table_format: Annotated[Literal["csv", "parquet"], "--format"] = "csv",
) -> int:
    """Measure every frame of FOLDER: contacts, local forces, and a picture of each frame.

    The scene.toml in FOLDER describes the experiment; an option given here replaces the key of the same name.
    Without a scene.toml, --reference (or an image called reference) and --pixel-size-um are enough to measure
    contacts; forces need the modulus and the radii of the asperities.

    Writes contacts.csv (one row per contact), frames.csv (one row per frame), rejected.csv (candidates that
    are no contacts, with the reason), provenance.json, and the pictures in overlays/.

    With several FOLDERs each is measured as if alone, into a folder of its name inside the output folder;
    combined/ then holds all_contacts.csv and all_frames.csv, with the name of the folder in the column run.

    Exit codes: 0 done; 1 a frame failed, a slip is likely (it is named), or no frame has a result to rely on
    (all black, or without contact, without a pose or with forces off the load, for example), as frames.csv
    says; 2 nothing done.

    \b
    Examples:
      contactimg process sample_data/sa_plus -o results
      contactimg process my_frames --reference my_frames/no_contact.tif --pixel-size-um 6

    Parameters
    ----------
    calibration
        Take modulus, threshold and edge from this calibration.json (or its folder) of `calibrate`.
    pictures
        Draw the contacts on each frame, in the folder overlays.
    table_format
        Format of the tables. parquet: smaller and faster for long series; needs pyarrow.
    """
    from contactimg.plausibility import doubts_about_run, warn_of
    from contactimg.pose.apex import STATED

    record = files.read_calibration(calibration) if calibration else {}

    def measure(folder: str, output: str | Path | None) -> int:
        """Measure the frames of one folder; return the exit code."""
        described, inputs = scene_of_folder(folder, stated, scene_file=scene, calibration=record)
        option = {"kind": "threshold"} if "threshold" in stated.get("measure", {}) else {}
        for given, name in ((record, str(calibration)), (option, "--threshold")):
            refuse_idle(given, name, method=described.measure.method)
        files.require_format(table_format)
        experiment = files.open_experiment(described)
        acts = describe_use(record, method=described.measure.method)
        used = {"calibration": {"file": calibration, "record": record, "acts": acts}} if record else {}
        predictable = described.elastic and described.indenter and described.asperities
        how: dict[str, Any] = {"options": used, "then": "overlay" if predictable else ""}
        how |= {"inputs": [*inputs, *experiment.inputs], "main_files": files.RUN_TABLES}
        with shared.results_in(output, folder, described, **how) as out:
            series = pipeline.measure_parts(experiment, store=out.part_store())
            frames, facts = pipeline.write_run(series, out.folder, table_format)
            if pictures:
                pipeline.draw_overlays(series, experiment, out.folder / "overlays")
            counts = experiment.edits["action"].value_counts().to_dict()
            out.record |= facts | ({"edits": counts} if counts else {})
            echo_frames(frames, title=f"{folder}, method {described.measure.method}")
            law, film = str(facts.get("law") or ""), _film_sentence(frames, facts.get("film", {}))
            apex = series.apex.sentence() if series.apex and series.apex.known != STATED else ""
            say(acts and f"calibration {calibration}: {acts}", apex, law, film)
        doubted = warn_of(doubts_about_run(series.scene, frames, series.shown), folder)
        statuses = set(frames["status"])
        return int(doubted or tables.FAILED in statuses or statuses <= tables.NO_RESULT)

    if len(folders) == 1:
        return measure(folders[0], output)
    if output is None:
        raise click.UsageError("with several folders, give the output folder: -o OUT.")
    return _process_several(folders, Path(output), measure, table_format=table_format)


def _process_several(
    folders: tuple[str, ...], target: Path, measure: Callable[..., int], *, table_format: "files.TableFormat"
) -> int:
    """Measure several folders and join their tables; return the exit code."""
    names, codes = [Path(folder).resolve().name for folder in folders], dict[str, int]()
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"two folders are called {twice}; give each folder once, and rename one of the two")
    if JOINED_FOLDER in names:
        raise InputError(f"{JOINED_FOLDER} is the folder of the joined tables; rename the folder of frames")
    for folder, name in zip(folders, names, strict=True):
        try:
            codes[name] = measure(folder, target / name)
        except InputError as error:  # a folder that fails loses nothing else
            click.echo(f"contactimg: {folder} is left out: {error}", err=True)
    if not codes:
        raise InputError("none of the folders could be measured")
    runs, joined = {name: target / name for name in codes}, target / JOINED_FOLDER
    pipeline.write_joined_tables(runs, joined, command=shared.command_line(), table_format=table_format)
    say(f"tables of all {len(codes)} folders in {joined}")
    return max(*codes.values(), int(len(codes) < len(names)))


def _film_sentence(frames: "pd.DataFrame", films: dict[str, dict[str, Any]]) -> str:
    """One sentence where an air film changes areas by more than their uncertainty; nothing otherwise."""
    import pandas as pd

    from contactimg.imaging.fit.film_choice import DECIDED_DOUBT

    table = pd.DataFrame.from_dict(films, orient="index", columns=["doubt", "taken", "area_change"])
    doubtful = table[table["doubt"] > DECIDED_DOUBT].join(frames.set_index("frame"))
    beyond = doubtful["area_change"].abs() * doubtful["area_m2"] > doubtful["area_std_m2"]
    changes = 100 * doubtful["area_change"][beyond]
    if changes.empty:
        return ""
    other = "without" if doubtful["taken"].any() else "with"
    return (
        f"air film: {other} it the areas of {len(changes)} frames would change by {min(changes):+.2g} to "
        f'{max(changes):+.2g} %, beyond their uncertainty; state [effects] film = "on" or "off" if you know'
    )


# --- check


@shared.command(*shared.FRAMES, METHOD, THRESHOLD, shared.WORKERS)
def check(
    folder: shared.ExistingFolder,
    *,
    scene: str | None,
    stated: shared.Stated,
    output: shared.Output = None,
    seed: Annotated[int, click.IntRange(min=0)] = 1,
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
    described, inputs = scene_of_folder(folder, stated, scene_file=scene)
    experiment, main_files = files.open_experiment(described), ["check.csv", "drawn.csv"]
    inputs += experiment.inputs
    with shared.results_in(output, folder, described, inputs, main_files=main_files) as out:
        result = pipeline.check_experiment(experiment, seed=seed)
        found = [(tables.CHECK, result.classes), (tables.DRAWN, result.drawn)]
        pipeline.write_results(out.folder, found, {"check": plots.plot_check(result.drawn, result.classes)})
        out.record["sentence"] = result.sentence
        forms = {"low_px": ".2f", "high_px": ".2f", "drawn": "", "completeness": ".0%", "bias_px": "+.3f"}
        forms |= {"rms_px": ".3f", "within_1_std": ".0%", "within_2_std": ".0%"}
        echo_table(f"{folder}, contacts drawn", result.classes[[*forms]], left=0, forms=forms)
        say(result.sentence)
        say(*(f"not checked: {row.message}" for row in result.failed.itertuples()))
    return 1 if len(result.failed) else 0


# --- init

QUESTIONS = (
    shared.SceneOption("--pixel-size-um", "camera", "pixel_size_m", default=""),
    shared.SceneOption("--lens-radius-mm", "indenter", "radius_m", default=""),
    shared.SceneOption("--young-modulus-MPa", "elastic", "young_modulus_Pa", default=""),
)
APEX = shared.SceneOption("--apex-mm", "indenter", "apex_m", "Two numbers quoted.", "found from the contacts")

SHOWN = {
    "indenter": ("radius_m", "apex_m"),
    "elastic": ("young_modulus_Pa", "young_modulus_std_Pa", "poisson_ratio", "thickness_m"),
    "asperities": ("file", "textured"),
    "camera": ("pixel_size_m", "centre_m", "rotation_deg", "full_scale_levels", "gamma"),
    "images": ("reference", "frames", "loads", "polarity", "mask", "dark", "flat"),
    "measure": ("method", "threshold", "shape"),
}
"""Section -> the keys that most experiments need."""


@shared.command(*QUESTIONS, APEX, shared.NO_PLAUSIBILITY)
def init(
    folder: shared.ExistingFolder, *, stated: shared.Stated, no_input: bool = False, force: bool = False
) -> None:
    """Look at the files of FOLDER, ask for what they do not say, and write a scene.toml with comments.

    Frames, reference, dark frame, flat field and mask are recognised by their names, tables of loads and
    asperities by their columns, the pixel size by the header of ImageJ and OME files. At each question, Enter
    alone means "not known".

    Exit codes: 0 done, 2 nothing done.

    \b
    Examples:
      contactimg init my_frames
      contactimg init my_frames --no-input --pixel-size-um 6 --lens-radius-mm 128.8

    Parameters
    ----------
    no_input
        Ask nothing: what is not known stays a comment.
    force
        Replace a scene.toml that is there.
    """
    path = Path(folder) / files.SCENE_FILE
    if path.exists() and not force:
        raise InputError(f"{path}: is there already; edit it, or replace it with --force")
    if not no_input:
        _ask_loads(Path(folder))
    found = files.recognise_folder(folder)
    say("\n  ".join(_remarks(folder, found)))
    sides = files.stated_pixel_size(found.frames[0].path)
    known: shared.Stated = found.keys | ({"camera": {"pixel_size_m": sides[0]}} if sides else {})
    for section, keys in stated.items():
        known[section] = known.get(section, {}) | keys
    for question in () if no_input else QUESTIONS:  # the contacts show the apex better than a person does
        if question.key not in stated.get(question.section, {}):
            answer = _ask(question, known.get(question.section, {}).pop(question.key, None))
            known.setdefault(question.section, {}).update({} if answer is None else {question.key: answer})
    known = {section: keys for section, keys in known.items() if keys}
    scene = scene_from_dict(known, name="the answers", folder=folder)
    files.open_experiment(plausible(scene), pulled=True)
    files.write_text(_template(known), path)
    say(f"wrote {path}; look at it, then run: contactimg process {shlex.quote(folder)}")


def _ask_loads(folder: Path) -> None:
    """Ask which column of a table is the load where several may be, and write that one to loads.csv."""
    found = files.recognise_folder(folder)
    for name in [] if found.loads else found.ignored:
        try:
            files.read_loads(folder / name, pulled=True)
        except files.AmbiguousLoadsError as error:
            chosen = click.prompt(f"which column of {name} is the load", type=click.Choice(error.columns))
            table = files.read_loads(folder / name, pulled=True, column=chosen)
            files.write_table(table, tables.LOADS, folder / "loads.csv")
            say(f"wrote {folder / 'loads.csv'}: {table.attrs['columns']} of {name}")
            return
        except InputError:
            continue


def _remarks(folder: str, found: "files.FolderFiles") -> Iterator[str]:
    """Remarks on what the files of a folder were taken for."""
    frames, reference, masks = found.frames, found.images["reference"], found.images["mask"]
    named = frames[0].name if len(frames) == 1 else f"{frames[0].name} ... {frames[-1].name}"
    loads = f"{found.loads} ({found.columns})" if found.columns else found.loads
    yield f"{folder}: {len(frames)} frame{'s' * (len(frames) > 1)} ({named})"
    yield f"reference: {', '.join(reference) or 'none; name the frame without contact in [images] reference'}"
    yield f"loads: {loads or 'none; write loads.csv with the columns frame and load_N, load_mN or load_g'}"
    yield f"asperities: {found.asperities or 'none; forces need their radii'}"
    for kind, said in (("dark", "dark frame"), ("flat", "flat field"), ("mask", "mask")):
        if found.images[kind]:
            yield f"{said}: {', '.join(found.images[kind])}"
    if len(masks) > 1:
        yield "which mask belongs to which frame is for [images] mask to say"
    if found.unloaded and not reference:
        yield "loads has a frame of load 0: it may serve as the reference"
    if found.ignored:
        yield f"not used: {', '.join(found.ignored)}"


def _ask(question: shared.SceneOption, found: float | None) -> Any:
    """The answer in SI units, what was found being the default; None for an empty one."""

    def answer(typed: str) -> Any:
        if not typed.strip():
            return None
        try:
            value = question.in_scene(float(typed.replace(",", ".")))
            scene_from_dict({question.section: {question.key: value}})
        except ValueError as error:  # the prompt asks again
            raise click.UsageError(str(error)) from None
        return value

    text = question.meaning.split(";")[0].rstrip(".")
    default = "" if found is None else f"{found / question.size:.6g}"
    try:
        return click.prompt(text, default=default, show_default=bool(default), value_proc=answer)
    except click.Abort as end:
        if isinstance(end.__context__, EOFError):
            raise InputError(f"no answer to: {text}; give {question.opts[0]}, or use --no-input") from None
        raise


def _template(known: shared.Stated) -> str:
    """Text of a scene file: what is known, and as comments the other keys that most experiments need."""
    lines = [
        "# What this experiment is. Lines that begin with # are not read: take the # away where a value is",
        "# known, and before the name of its section.",
    ]
    for section, keys in SHOWN.items():
        lines += ["", f"[{section}]" if known.get(section) else f"# [{section}]"]
        for key in keys:
            field = section_keys(section)[key]
            lines += textwrap.wrap(str(field.description), 100, initial_indent="# ", subsequent_indent="# ")
            value = known.get(section, {}).get(key)
            default = None if field.is_required() else field.default
            shown = default if value is None else value
            text = "" if shown is None else json.dumps(shown, ensure_ascii=False)  # on one line, as in TOML
            lines.append(f"{'# ' if value is None else ''}{key} = {text}".rstrip())
    return "\n".join(lines) + "\n"
