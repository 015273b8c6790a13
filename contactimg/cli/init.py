"""``contactimg init``: a first scene.toml for a folder of frames."""

import json
import re
import shlex
import textwrap
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from contactimg.cli import options as shared
from contactimg.cli.printing import say
from contactimg.errors import InputError
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.files import FrameSource

QUESTIONS = (
    shared.SceneOption("--pixel-size-um", "camera", "pixel_size_m", default=""),
    shared.SceneOption("--lens-radius-mm", "indenter", "radius_m", default=""),
    shared.SceneOption("--young-modulus-MPa", "elastic", "young_modulus_Pa", default=""),
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

REFERENCE = re.compile(
    r"(reference|ref|background|bg|empty|blank|unloaded|(no|non|without)[ _-]?contact)s?"
    r"([ _-]?(frame|image))?([ _-]?\d+)?"
)
"""Name of an image, without its ending, that shows the sample without contact."""

TRIED_TABLES = 20
"""CSV files that are tried as tables. Chosen: a folder of results is not searched for long."""


@shared.command()
@shared.scene_options(*QUESTIONS)
@shared.no_plausibility
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
    with stage("loading"):
        from contactimg.cli.scenes import plausible
        from contactimg.files import SCENE_FILE, open_experiment, write_text
        from contactimg.scene import scene_from_dict

    path = Path(folder) / SCENE_FILE
    if path.exists() and not force:
        raise InputError(f"{path}: is there already; edit it, or replace it with --force")
    known, remarks = _recognise(Path(folder))
    say("\n  ".join(remarks))
    for question in QUESTIONS:
        value = stated.get(question.section, {}).get(question.key)
        found = known.get(question.section, {}).get(question.key)
        if value is None:
            value = found if no_input else _ask(question, found)
        known[question.section] = known.get(question.section, {}) | {question.key: value}
    for keys in known.values():
        for key in [key for key, value in keys.items() if value in (None, "", [])]:
            del keys[key]
    known = {name: keys for name, keys in known.items() if keys}
    open_experiment(plausible(scene_from_dict(known, name="the answers", folder=folder)), pulled=True)
    write_text(_template(known), path)
    say(f"wrote {path}; look at it, then run: contactimg process {shlex.quote(folder)}")
    return 0


def _recognise(folder: Path) -> tuple[shared.Stated, list[str]]:
    """Keys of a scene that names, tables and headers tell, and what to say of them; no pixels are read."""
    from contactimg.files import list_frames, read_asperities, read_loads
    from contactimg.files.experiment import is_correction
    from contactimg.files.pixel_size import stated_pixel_size

    images = list_frames(folder)
    references = [one for one in images if REFERENCE.fullmatch(one.path.stem.lower())]
    corrections = [one for one in images if is_correction(one.path)]
    frames = [one for one in images if one not in references and one not in corrections]
    frames = [one for one in frames if one.path.name.startswith("frame_")] or frames  # as `open_experiment`
    if not frames:
        raise InputError(f"{folder}: there is no frame besides {references[0].name}; add the frames")
    found = {"reference": _files(references)}
    for kind in ("dark", "flat", "mask"):
        found[kind] = _files(one for one in corrections if one.path.stem.lower().startswith(kind))
    loads, asperities, unloaded = "", "", False
    for table in sorted(folder.glob("*.csv"))[:TRIED_TABLES]:
        with suppress(InputError):
            if not loads:
                unloaded = bool((read_loads(table, pulled=True)["load_N"] == 0).any())
                loads = table.name
        with suppress(InputError):
            if not asperities:
                read_asperities(table)
                asperities = table.name
    known: shared.Stated = {
        "asperities": {"file": asperities},
        "camera": {"pixel_size_m": stated_pixel_size(frames[0].path)},
        "images": {
            "reference": found["reference"][0] if len(found["reference"]) == 1 else found["reference"],
            "frames": [frames[0].name] if len(frames) == 1 else None,
            "loads": loads,
            "dark": _one_or_glob(found["dark"]),
            "flat": _one_or_glob(found["flat"]),
            "mask": found["mask"][0] if len(found["mask"]) == 1 else None,
        },
    }
    named = frames[0].name if len(frames) == 1 else f"{frames[0].name} ... {frames[-1].name}"
    reference = ", ".join(found["reference"])
    remarks = [
        f"{folder}: {len(frames)} frame{'s' * (len(frames) > 1)} ({named})",
        f"reference: {reference or 'none; name the frame without contact in [images] reference'}",
        f"loads: {loads or 'none; write loads.csv with the columns frame, load_N'}",
        f"asperities: {asperities or 'none; forces need their radii'}",
    ]
    for kind, said in (("dark", "dark frame"), ("flat", "flat field"), ("mask", "mask")):
        if found[kind]:
            remarks.append(f"{said}: {', '.join(found[kind])}")
    if len(found["mask"]) > 1:
        remarks.append("which mask belongs to which frame is for [images] mask to say")
    if unloaded and not reference:
        remarks.append("loads has a frame of load 0: it may serve as the reference")
    return known, remarks


def _files(sources: "Iterable[FrameSource]") -> list[str]:
    """Names of the files of the frames, each once."""
    return list(dict.fromkeys(one.path.name for one in sources))


def _one_or_glob(names: list[str]) -> str | None:
    """The only name, a glob for several, or None; all begin with the word that they were recognised by."""
    return None if not names else names[0] if len(names) == 1 else f"{names[0][:4]}*{Path(names[0]).suffix}"


def _ask(question: shared.SceneOption, found: float | None) -> float | None:
    """The answer in SI units, what was found being the default; None for an empty one."""
    from contactimg.scene import scene_from_dict

    def answer(typed: str) -> float | None:
        if not typed.strip():
            return None
        try:
            value = question.in_scene(float(typed.replace(",", ".")))
            scene_from_dict({question.section: {question.key: value}})
        except ValueError as error:  # the prompt asks again
            raise click.UsageError(str(error)) from None
        return float(value)

    text = question.meaning.split(";")[0].rstrip(".")
    default = "" if found is None else f"{found / question.unit[2]:.6g}"
    try:
        value: float | None = click.prompt(
            text, default=default, show_default=bool(default), value_proc=answer
        )
    except click.Abort as end:
        if isinstance(end.__context__, EOFError):
            raise InputError(f"no answer to: {text}; give {question.flag}, or use --no-input") from None
        raise
    return value


def _template(known: shared.Stated) -> str:
    """Text of a scene file: what is known, and as comments the other keys that most experiments need."""
    from contactimg.scene import section_keys

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
