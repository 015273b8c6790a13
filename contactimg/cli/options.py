"""Commands made of functions, options that several commands share, and options that stand for scene keys."""

import inspect
import logging
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import click

from contactimg import files
from contactimg.cli.printing import echo_timings, progress_bars, say
from contactimg.scene import Scene, section_keys
from contactimg.timings import collect

DEFAULT_FOLDER = "contactimg_out"

Stated = dict[str, dict[str, Any]]
"""Section -> key -> value: what the options of a command state in place of the scene file."""


def command(*options: click.Parameter) -> Callable[[Callable[..., Any]], click.Command]:
    """Make a command of a function.

    Each parameter becomes an option, a positional parameter an argument. The signature gives name, type and
    default; beside the type stand, in ``Annotated``, bounds (a click type), the flag where it is not the
    name, and a meaning that several commands share. Other meanings stand under Parameters in the docstring;
    the rest of the docstring is the help of the command. Further ``options`` come as they are; what those
    that stand for keys of the scene state is the parameter ``stated``.
    """

    def declare(function: Callable[..., Any]) -> click.Command:
        text, _, section = str(inspect.getdoc(function)).partition("\n\nParameters\n----------\n")
        meanings = dict(re.findall(r"^(\w+)\n((?:    .*\n?)+)", section, re.MULTILINE))
        keys = [option for option in options if isinstance(option, SceneOption)]
        prepared = {str(option.name) for option in (*options, *EVERYWHERE)} & set(PREPARING)
        own = [
            _parameter(parameter, meanings.get(parameter.name, ""))
            for parameter in inspect.signature(function).parameters.values()
            if parameter.name not in {"stated", *(option.name for option in options)}
            and parameter.kind is not parameter.VAR_KEYWORD
        ]

        @wraps(function)
        def call(**values: Any) -> Any:
            _prepare(click.get_current_context(), {name: values.pop(name) for name in prepared})
            stated: Stated = {}
            for option in keys:
                value = values.pop(str(option.name))
                if value not in (None, ()):
                    stated.setdefault(option.section, {})[option.key] = option.in_scene(value)
            with progress_bars():
                return function(**values, **({"stated": stated} if keys else {}))

        return click.Command(
            function.__name__.replace("_", "-"),
            callback=call,
            params=sorted([*own, *options, *EVERYWHERE], key=lambda param: isinstance(param, click.Option)),
            help=text,
        )

    return declare


def _parameter(parameter: inspect.Parameter, meaning: str) -> click.Parameter:
    """The option or the argument for one parameter of a command."""
    plain, *notes = _kinds(parameter.annotation)
    many = get_origin(plain) is tuple
    if many:
        plain, *more = _kinds(get_args(plain)[0])
        notes += more
    words = get_args(plain) if get_origin(plain) is Literal else ()
    bounds = next((note for note in notes if isinstance(note, click.ParamType)), None)
    said = next((note for note in notes if isinstance(note, str) and not note.startswith("-")), "")
    flags = next((note for note in notes if isinstance(note, str) and note.startswith("-")), "")
    required = parameter.default is parameter.empty
    settings: dict[str, Any] = {"type": bounds or (click.Choice(words) if words else plain)}
    settings |= {"required": required} | ({} if required else {"default": parameter.default})
    if parameter.kind is parameter.POSITIONAL_OR_KEYWORD:
        return click.Argument([parameter.name], metavar=said or None, nargs=-1 if many else 1, **settings)
    names = flags.split(" ") if flags else [f"--{parameter.name.replace('_', '-')}"]
    help_text = said or " ".join(meaning.split())
    settings |= {"is_flag": plain is bool, "multiple": many, "help": help_text}
    return click.Option([*names, parameter.name], **settings)


def _kinds(annotation: Any) -> list[Any]:
    """The types that an annotation allows, each with what is noted beside it."""
    if get_origin(annotation) is Annotated:
        inner, *notes = get_args(annotation)
        return [*_kinds(inner), *notes]
    if get_origin(annotation) in (UnionType, Union):
        return [kind for part in get_args(annotation) for kind in _kinds(part)]
    return [annotation]


def option(name: str, annotation: Any, default: Any = None) -> click.Parameter:
    """An option as a parameter of a command would make it, for several commands."""
    kind = inspect.Parameter.KEYWORD_ONLY
    return _parameter(inspect.Parameter(name, kind, default=default, annotation=annotation), "")


# --- types and meanings of parameters that several commands share

ExistingFile = Annotated[str, click.Path(exists=True, dir_okay=False)]
ExistingFolder = Annotated[str, click.Path(exists=True, file_okay=False)]
Existing = Annotated[str, click.Path(exists=True)]
Positive = Annotated[float, click.FloatRange(min=0, min_open=True)]
NonNegative = Annotated[float, click.FloatRange(min=0)]
Count = Annotated[int, click.IntRange(min=1)]
NewFile = Annotated[str, click.Path(dir_okay=False), "-o --output"]
NewFolder = Annotated[str, click.Path(file_okay=False), "-o --output"]
Output = Annotated[
    NewFolder | None,
    f"Folder for the results; created if needed.  [default: {DEFAULT_FOLDER} in the folder that is read]",
]
Load = Annotated[float | None, "--load-N", "Normal load in newtons.  [default: the largest of the scene]"]
Annulus = Annotated[float, "Width of the rings around the apex over which profiles are averaged, in mm."]


EVERYWHERE = (
    option("quiet", Annotated[bool, "Print only warnings and errors: no tables, no progress bars."]),
    option("verbose", Annotated[bool, "Report each step on standard error."]),
    option("timings", Annotated[bool, "Print at the end how long each step took, in seconds."]),
)
"""Options that every command has."""

NO_PLAUSIBILITY = click.Option(
    ["--no-plausibility"],
    is_flag=True,
    help="Warn about values that physics makes doubtful (a length in mm, say) instead of refusing them.",
)

PROCESSES = "Number of processes that work in parallel."
WORKERS = option(
    "workers",
    Annotated[Count | None, f"{PROCESSES}  [default: one; one per CPU core as soon as that saves time]"],
)
ONE_WORKER = option("workers", Annotated[Count, PROCESSES], 1)

CLUSTER = click.Option(
    ["--cluster"],
    metavar="ADDRESS",
    help="Work on the cluster of a dask.distributed scheduler, instead of --workers: its address, for "
    "example tcp://host:8786, or its scheduler file.",
)

PREPARING = ("quiet", "verbose", "timings", "no_plausibility", "workers", "cluster")
"""Options that prepare the run of a command: no result depends on them, and no command takes them."""


def _prepare(context: click.Context, asked: dict[str, Any]) -> None:
    """Do what `PREPARING` options ask for, as long as the command runs."""
    if asked["verbose"]:
        logging.getLogger("contactimg").setLevel(logging.INFO)
    if asked["timings"]:
        times = context.with_resource(collect())
        context.call_on_close(lambda: echo_timings(times))
    if asked.get("no_plausibility"):
        from contactimg.plausibility import doubts_as_warnings

        context.with_resource(doubts_as_warnings())
    if asked.get("workers"):
        from contactimg.engine.parallel import sharing

        context.with_resource(sharing(asked["workers"]))
    if asked.get("cluster"):
        from contactimg.engine.cluster import on_cluster

        context.with_resource(on_cluster(asked["cluster"]))


# --- the results of a command


def command_line() -> str:
    """The command that runs, as a shell reads it."""
    context = click.get_current_context()
    typed = context.find_root().obj or []
    return shlex.join(["contactimg", *typed]) if typed else context.command_path


@contextmanager
def results_in(
    output: str | Path | None,
    parent: str | Path,
    scene: Scene | None = None,
    inputs: Iterable[Path] = (),
    *,
    options: dict[str, Any] | None = None,
    main_files: Sequence[str] = (),
    keeps: Sequence[str] = (),
    then: str = "",
) -> Iterator["files.OutputFolder"]:
    """The output folder of the command that runs, with its provenance; written completely or not at all.

    Parameters
    ----------
    output : path-like or None
        The folder; by default that of the usual name inside ``parent``.
    parent : path-like
    scene : Scene or None
        What was computed or measured.
    inputs : iterable of Path
        The files that were read.
    options : dict or None
        What else the result depends on, if it is not the options of the command.
    main_files : sequence of str
        Files that the command certainly writes.
    keeps : sequence of str
        Files and folders of an earlier run of it that stay.
    then : str
        The command that usually follows, for the run that is written or read.
    """
    if options is None:
        context = click.get_current_context()
        names = {param.name for param in context.command.params if isinstance(param, click.Option)}
        names -= {"output", "folder", *PREPARING}  # which do not change the result
        options = {name: value for name, value in context.params.items() if name in names}
    record = files.provenance(command=command_line(), scene=scene, options=options, inputs=inputs)
    target = Path(output or Path(parent) / DEFAULT_FOLDER)
    with files.OutputFolder(target, record, main_files=main_files, keeps=keeps) as out:
        yield out
    command = f"; then: contactimg {then} {shlex.quote(str(target if then == 'overlay' else parent))}"
    say(f"results in {target}{command if then else ''}")


# --- options that stand for keys of a scene

UNITS = {"um": ("m", "µm", 1e-6), "mm": ("m", "mm", 1e-3), "MPa": ("Pa", "MPa", 1e6)}
"""Unit at the end of an option -> that of the key, how it is printed, and its size."""


class SceneOption(click.Option):
    """An option that stands for a key of the scene: type, bounds, meaning and default are those of the key.

    Parameters
    ----------
    flag : str
        With the unit in which the value is given.
    section, key : str
        As in the scene file.
    note : str
        What the help adds to the meaning of the key.
    default : str or None
        What holds where the option is not given, if it is not the scene's value.
    """

    def __init__(self, flag: str, section: str, key: str, note: str = "", default: str | None = None) -> None:
        self.section, self.key, field = section, key, section_keys(section)[key]
        unit, printed, self.size = UNITS.get(flag.rsplit("-", 1)[-1], ("", "", 1.0))
        # an option without a unit leaves the meaning as it is
        self.meaning = re.sub(rf", {unit}\b", f", {printed}", str(field.description))
        if default is None and field.default is not None and not field.is_required():
            default = f"the scene's, else {field.default}"
        kinds = _kinds(field.annotation)
        words = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
        super().__init__(
            [flag, flag.removeprefix("--").replace("-", "_")],
            type=number if float in kinds else click.Choice(words) if words else str,
            multiple=key == "reference",
            help=f"{self.meaning} {note}".strip() + (f"  [default: {default}]" if default else ""),
        )

    def in_scene(self, value: Any) -> Any:
        """The value as the key holds it."""
        if isinstance(value, float):
            return float(f"{value * self.size:.15g}")  # without the digits that the multiplication adds
        if isinstance(value, str) and self.size != 1 and len(value.split()) > 1:
            return [self.in_scene(number(word)) for word in value.split()]
        return list(value) if isinstance(value, tuple) else value


def number(value: str) -> float | str:
    """A number; a word is left to the rules of the scene, whose sentence says what is allowed."""
    try:
        return float(value)
    except ValueError:
        return value


FRAMES = (
    option("scene", Annotated[ExistingFile | None, "Scene file to use instead of scene.toml in FOLDER."]),
    SceneOption("--reference", "images", "reference", "Can be repeated."),
    SceneOption("--frames", "images", "frames", 'A glob stands in quotes: "frame_*.tif".'),
    SceneOption("--loads", "images", "loads"),
    SceneOption("--pixel-size-um", "camera", "pixel_size_m"),
    SceneOption("--polarity", "images", "polarity"),
    NO_PLAUSIBILITY,
)
"""Options that say what the frames are, in place of keys of a scene file."""
