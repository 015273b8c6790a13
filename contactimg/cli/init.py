"""``contactimg init``: a first scene.toml for a folder of frames."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from contactimg.cli import shared_options as shared
from contactimg.errors import InputError
from contactimg.timings import stage

if TYPE_CHECKING:
    from contactimg.files.folder_guess import FolderGuess

Sections = dict[str, dict[str, Any]]


@click.command(short_help="Write a first scene.toml for a folder of frames.")
@click.argument("folder", type=shared.existing_folder)
@click.option(
    "--pixel-size-um", type=shared.positive_number, help="Length on the sample of one pixel, in µm."
)
@click.option("--lens-radius-mm", type=shared.positive_number, help="Radius of curvature of the lens, in mm.")
@click.option(
    "--young-modulus-MPa", type=shared.positive_number, help="Young's modulus of the rubber, in MPa."
)
@click.option("--no-input", is_flag=True, help="Ask nothing: what is not known stays a comment.")
@click.option("--force", is_flag=True, help="Replace a scene.toml that is there.")
@shared.quiet
def init(
    *,
    folder: str,
    pixel_size_um: float | None,
    lens_radius_mm: float | None,
    young_modulus_mpa: float | None,
    no_input: bool,
    force: bool,
    quiet: bool,
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
    """
    with stage("loading"):
        from contactimg.cli.scenes import plausible
        from contactimg.files import SCENE_FILE, open_experiment, write_text
        from contactimg.files.folder_guess import guess_folder
        from contactimg.scene import scene_from_dict, scene_template

    path = Path(folder) / SCENE_FILE
    if path.exists() and not force:
        raise InputError(f"{path}: is there already; edit it, or replace it with --force")
    guess = guess_folder(folder)
    if not quiet:
        _echo_guess(folder, guess)
    numbers = [
        _ask("length on the sample of one pixel, in µm", pixel_size_um, guess.pixel_size_m, 1e-6, no_input),
        _ask("radius of curvature of the lens, in mm", lens_radius_mm, None, 1e-3, no_input),
        _ask("Young's modulus of the rubber, in MPa", young_modulus_mpa, None, 1e6, no_input),
    ]
    known = _sections(guess, *numbers)
    open_experiment(plausible(scene_from_dict(known, name="the answers", folder=folder)), pulled=True)
    write_text(scene_template(known), path)
    if not quiet:
        click.echo(f"wrote {path}; look at it, then run: contactimg process {folder}")
    return 0


def _ask(text: str, given: float | None, found: float | None, unit: float, no_input: bool) -> float | None:  # noqa: FBT001
    """A number in SI units: as given, else as answered, with what was found as the default."""
    if given is not None:
        return _in_si(given, unit)
    if no_input:
        return found
    default = "" if found is None else f"{found / unit:.6g}"
    try:
        answer = click.prompt(
            text, default=default, show_default=bool(default), value_proc=_positive_or_nothing
        )
    except click.Abort as end:
        if isinstance(end.__context__, EOFError):
            raise InputError(
                f"no answer to the question for the {text}; give it as an option, or use --no-input"
            ) from None
        raise
    return None if answer is None else _in_si(answer, unit)


def _in_si(value: float, unit: float) -> float:
    """The value in SI units, without the digits that the multiplication adds."""
    return float(f"{value * unit:.12g}")


def _positive_or_nothing(text: str) -> float | None:
    """The number typed, None for an empty answer; the prompt asks again after a `click.UsageError`."""
    number = text.replace(",", ".").strip()
    return shared.positive_number(number) if number else None


def _sections(
    guess: "FolderGuess", pixel: float | None, radius: float | None, modulus: float | None
) -> Sections:
    """Keys of a scene that are known."""
    images = {
        "reference": _one_or_all(guess.references),
        "frames": list(guess.frames) if len(guess.frames) == 1 else None,
        "loads": guess.loads,
        "dark": _one_or_glob(guess.darks),
        "flat": _one_or_glob(guess.flats),
        "mask": guess.masks[0] if len(guess.masks) == 1 else None,
    }
    sections: Sections = {
        "indenter": {"radius_m": radius},
        "elastic": {"young_modulus_Pa": modulus},
        "asperities": {"file": guess.asperities},
        "camera": {"pixel_size_m": pixel},
        "images": images,
    }
    known = {
        name: {key: value for key, value in keys.items() if value is not None}
        for name, keys in sections.items()
    }
    return {name: keys for name, keys in known.items() if keys}


def _one_or_all(names: tuple[str, ...]) -> str | list[str] | None:
    """The only name, all of several, or None."""
    return None if not names else names[0] if len(names) == 1 else list(names)


def _one_or_glob(names: tuple[str, ...]) -> str | None:
    """The only name, a glob for several, or None; all begin with the word that they were recognised by."""
    return None if not names else names[0] if len(names) == 1 else f"{names[0][:4]}*{Path(names[0]).suffix}"


def _echo_guess(folder: str, guess: "FolderGuess") -> None:
    """Print what was recognised, and what was not."""
    first, last = guess.frames[0], guess.frames[-1]
    named = f"{first} ... {last}" if len(guess.frames) > 1 else first
    click.echo(f"{folder}: {len(guess.frames)} frame{'s' * (len(guess.frames) > 1)} ({named})")
    for what, names, without in (
        ("reference", guess.references, "none; name the frame without contact in [images] reference"),
        (
            "loads",
            (guess.loads,) if guess.loads else (),
            "none; write loads.csv with the columns frame, load_N",
        ),
        ("asperities", (guess.asperities,) if guess.asperities else (), "none; forces need their radii"),
        ("dark frame", guess.darks, ""),
        ("flat field", guess.flats, ""),
        ("mask", guess.masks, ""),
    ):
        if names or without:
            click.echo(f"  {what}: {', '.join(names) or without}")
    if len(guess.masks) > 1:
        click.echo("  which mask belongs to which frame is for [images] mask to say")
    if 0.0 in guess.load_N and not guess.references:
        click.echo("  loads has a frame of load 0: it may serve as the reference")
