"""``contactimg init``: a first scene.toml for a folder of frames."""

import json
import shlex
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from contactimg import files, tables
from contactimg.cli import options as shared
from contactimg.cli.printing import say
from contactimg.cli.scenes import plausible
from contactimg.errors import InputError
from contactimg.scene import scene_from_dict, section_keys

QUESTIONS = (
    shared.SceneOption("--pixel-size-um", "camera", "pixel_size_m", default=""),
    shared.SceneOption("--lens-radius-mm", "indenter", "radius_m", default=""),
    shared.SceneOption("--young-modulus-MPa", "elastic", "young_modulus_Pa", default=""),
)
APEX = shared.SceneOption(
    "--apex-mm", "indenter", "apex_m", "Two numbers in quotes.", "found from the contacts"
)

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
) -> int:
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
    pixel_size = files.stated_pixel_size(found.frames[0].path)
    known: shared.Stated = found.keys | ({"camera": {"pixel_size_m": pixel_size}} if pixel_size else {})
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
    return 0


def _ask_loads(folder: Path) -> None:
    """Ask which column of a table is the load where several may be, and write that one to loads.csv."""
    found = files.recognise_folder(folder)
    for name in [] if found.loads else found.ignored:
        try:
            files.read_load_table(folder / name)
        except files.AmbiguousLoadsError as error:
            chosen = click.prompt(f"which column of {name} is the load", type=click.Choice(error.columns))
            table, columns = files.read_load_table(folder / name, column=chosen)
            files.write_table(table, tables.LOADS, folder / "loads.csv")
            say(f"wrote {folder / 'loads.csv'}: {columns} of {name}")
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
