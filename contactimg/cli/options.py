"""Commands made of functions, options that several commands share, and options that stand for scene keys."""

import inspect
import logging
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import click

from contactimg.cli.printing import QUIET, echo_timings, say
from contactimg.timings import collect

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from contactimg.files import OutputFolder
    from contactimg.scene import Scene

Function = Callable[..., Any]
Decorator = Callable[[Function], Function]

DEFAULT_FOLDER = "contactimg_out"


class Command(click.Command):
    """A command that a signal to end stops as cleanly as Ctrl-C."""

    def invoke(self, context: click.Context) -> Any:
        """Run the command."""
        from contactimg.engine.processes import ending_cleanly

        with ending_cleanly():
            return super().invoke(context)


def command(group: click.Group | None = None, said: str = "") -> Callable[[Function], Command]:
    """Make a command of a function; ``said`` is what the help of its group says of it.

    Each parameter that no other decorator makes an option of becomes one, a positional parameter an argument.
    The signature gives name, type and default; beside the type stand, in ``Annotated``, bounds (a click
    type), the flag where it is not the name, and a meaning that several commands share. Other meanings stand
    under Parameters in the docstring; the rest of the docstring is the help of the command.
    """

    def declare(function: Function) -> Command:
        text, _, section = str(inspect.getdoc(function)).partition("\n\nParameters\n----------\n")
        meanings = dict(re.findall(r"^(\w+)\n((?:    .*\n?)+)", section, re.MULTILINE))
        shared = quiet(verbose(timings(function))).__click_params__[::-1]  # type: ignore[attr-defined]
        done = {"stated", *(param.name for param in shared)}
        own = [
            _parameter(parameter, meanings.get(parameter.name, ""))
            for parameter in inspect.signature(function).parameters.values()
            if parameter.name not in done and parameter.kind is not parameter.VAR_KEYWORD
        ]
        arguments = [param for param in own if isinstance(param, click.Argument)]
        options = [param for param in own if isinstance(param, click.Option)]
        made = Command(
            function.__name__.replace("_", "-"),
            callback=function,
            params=[*arguments, *options, *shared],
            help=text,
            short_help=said or None,
        )
        if group is not None:
            group.add_command(made)
        return made

    return declare


def _parameter(parameter: inspect.Parameter, meaning: str) -> click.Parameter:
    """The option or the argument for one parameter of a command."""
    plain, *notes = _parts(parameter.annotation)
    many = get_origin(plain) is tuple
    if many:
        plain, *more = _parts(get_args(plain)[0])
        notes += more
    words = get_args(plain) if get_origin(plain) is Literal else ()
    bounds = next((note for note in notes if isinstance(note, click.ParamType)), None)
    said = next((note for note in notes if isinstance(note, str) and not note.startswith("-")), "")
    flags = next((note for note in notes if isinstance(note, str) and note.startswith("-")), "")
    settings: dict[str, Any] = {"type": bounds or (click.Choice(words) if words else plain)}
    required = parameter.default is parameter.empty
    if not required:
        settings["default"] = parameter.default
    if parameter.kind is parameter.POSITIONAL_OR_KEYWORD:
        settings |= {"metavar": said or None, "nargs": -1 if many else 1, "required": required}
        return click.Argument([parameter.name], **settings)
    if plain is bool:
        settings = {"default": parameter.default, "is_flag": True}
    settings["required"] = required
    names = flags.split(" ") if flags else [f"--{parameter.name.replace('_', '-')}"]
    help_text = said or " ".join(meaning.split())
    return click.Option([*names, parameter.name], multiple=many, help=help_text, **settings)


def _parts(annotation: Any) -> tuple[Any, ...]:
    """The plain type of an annotation, None apart, and what is noted beside it."""
    if get_origin(annotation) is Annotated:
        inner, *notes = get_args(annotation)
        return (*_parts(inner), *notes)
    if get_origin(annotation) in (UnionType, Union):
        return _parts(get_args(annotation)[0])
    return (annotation,)


def together(*decorators: Decorator) -> Decorator:
    """Several decorators as one, in the order in which they would stand above a function."""

    def decorate(function: Function) -> Function:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


def option(name: str, annotation: Any, default: Any = None) -> Decorator:
    """An option as a parameter of a command would make it, for several commands."""
    kind = inspect.Parameter.KEYWORD_ONLY
    made = _parameter(inspect.Parameter(name, kind, default=default, annotation=annotation), "")

    def decorate(function: Function) -> Function:
        # where click collects the options of a function
        function.__dict__.setdefault("__click_params__", []).append(made)
        return function

    return decorate


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
Workers = Annotated[
    Count | None,
    "Number of processes that work in parallel.  [default: one; one per CPU core as soon as that saves time]",
]
OneWorker = Annotated[Count, "Number of processes that work in parallel."]
Load = Annotated[
    float | None, "--load-N", "Normal load in newtons.  [default: the largest that the scene states]"
]
Annulus = Annotated[float, "Width of the rings around the apex over which profiles are averaged, in mm."]


def _preparing(
    flag: str, help_text: str, **more: Any
) -> Callable[[Callable[[click.Context, Any], None]], Decorator]:
    """An option that prepares the run of a command and is not handed to it, made of what it does."""

    def declare(act: Callable[[click.Context, Any], None]) -> Decorator:
        def callback(context: click.Context, _parameter: click.Parameter, value: Any) -> None:
            if value:
                act(context, value)

        settings = more or {"is_flag": True}
        return click.option(flag, expose_value=False, callback=callback, help=help_text, **settings)

    return declare


@_preparing("--timings", "Print a table at the end: how long each stage took, in seconds.")
def timings(context: click.Context, _value: Any) -> None:
    """Time the stages."""
    times = context.with_resource(collect())
    context.call_on_close(lambda: echo_timings(times))


@_preparing("--quiet", "Print nothing but warnings and errors: no tables, no progress bars.")
def quiet(context: click.Context, _value: Any) -> None:
    """Say nothing."""
    context.meta[QUIET] = True


@_preparing("--verbose", "Report each step on standard error.")
def verbose(_context: click.Context, _value: Any) -> None:
    """Say more."""
    logging.getLogger("contactimg").setLevel(logging.INFO)


@_preparing(
    "--no-plausibility",
    "Warn about values that physics makes doubtful (a length in mm, say) instead of refusing them.",
)
def no_plausibility(context: click.Context, _value: Any) -> None:
    """Refuse no doubtful value."""
    from contactimg.plausibility import doubts_as_warnings

    context.with_resource(doubts_as_warnings())


@_preparing(
    "--cluster",
    "Work on the cluster of a dask.distributed scheduler, instead of --workers: its address, for example "
    "tcp://host:8786, or its scheduler file.",
    metavar="ADDRESS",
)
def cluster(context: click.Context, address: str) -> None:
    """Let a cluster take the calls."""
    from contactimg.engine.cluster import on_cluster

    context.with_resource(on_cluster(address))


# --- the results of a command


def command_line() -> str:
    """The command that runs, as a shell reads it."""
    context = click.get_current_context()
    typed = context.find_root().obj or []
    return shlex.join(["contactimg", *typed]) if typed else context.command_path


def options_given() -> dict[str, Any]:
    """The options of the command that runs, without those that do not change its result."""
    context = click.get_current_context()
    names = {str(param.name) for param in context.command.params if isinstance(param, click.Option)}
    names -= {"output", "folder", "workers"}
    return {name: value for name, value in context.params.items() if name in names}


@contextmanager
def results_in(
    output: str | Path | None,
    parent: str | Path,
    *,
    scene: "Scene | None" = None,
    options: dict[str, Any] | None = None,
    inputs: Iterable[Path] = (),
    main_files: Sequence[str] = (),
    keeps: Sequence[str] = (),
    then: str = "",
) -> Iterator["OutputFolder"]:
    """The output folder of the command that runs, with its provenance; written completely or not at all.

    Parameters
    ----------
    output : path-like or None
        The folder; by default that of the usual name inside ``parent``.
    parent : path-like
    scene : Scene or None
        What was computed or measured.
    options : dict or None
        What else the result depends on, if it is not the options of the command.
    inputs : iterable of Path
        The files that were read.
    main_files : sequence of str
        Files that the command certainly writes.
    keeps : sequence of str
        Files and folders of an earlier run of it that stay.
    then : str
        The command that usually follows, for the run that is written or read.
    """
    from contactimg.files import OutputFolder, provenance

    options = options_given() if options is None else options
    record = provenance(command=command_line(), scene=scene, options=options, inputs=inputs)
    target = Path(output or Path(parent) / DEFAULT_FOLDER)
    with OutputFolder(target, record, main_files=main_files, keeps=keeps) as out:
        yield out
    command = f"; then: contactimg {then} {shlex.quote(str(target if then == 'overlay' else parent))}"
    say(f"results in {target}{command if then else ''}")


# --- options that stand for keys of a scene

Stated = dict[str, dict[str, Any]]
"""Section -> key -> value: what the options of a command state in place of the scene file."""

UNITS = {"um": ("m", "µm", 1e-6), "mm": ("m", "mm", 1e-3), "MPa": ("Pa", "MPa", 1e6)}
"""Unit at the end of an option -> that of the key, how it is printed, and its size."""


@dataclass(frozen=True)
class SceneOption:
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

    flag: str
    section: str
    key: str
    note: str = ""
    default: str | None = None

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.flag.removeprefix("--").replace("-", "_")

    @property
    def unit(self) -> tuple[str, str, float]:
        """Unit of the key, the option's as it is printed, and its size."""
        return UNITS.get(self.flag.rsplit("-", 1)[-1], ("", "", 1.0))

    @property
    def field(self) -> "FieldInfo":
        """The key in the description of the scene."""
        from contactimg.scene import section_keys

        return section_keys(self.section)[self.key]

    @property
    def meaning(self) -> str:
        """Description of the key, in the unit of the option."""
        unit, printed, _ = self.unit
        text = str(self.field.description)
        return re.sub(rf", {unit}\b", f", {printed}", text) if unit else text

    def in_scene(self, value: Any) -> Any:
        """The value as the key holds it."""
        if isinstance(value, float):
            return float(f"{value * self.unit[2]:.15g}")  # without the digits that the multiplication adds
        if isinstance(value, str) and self.unit[0] and len(value.split()) > 1:
            return [self.in_scene(float(word)) for word in value.split()]
        return list(value) if isinstance(value, tuple) else value

    def decorate(self, function: Function) -> Function:
        """Add the option to a command."""
        default = self.default
        if default is None and self.field.default is not None and not self.field.is_required():
            default = f"the scene's, else {self.field.default}"
        words = [word for word in _kinds(self.field.annotation) if isinstance(word, str)]
        number = float in _kinds(self.field.annotation)
        return click.option(
            self.flag,
            self.name,
            type=_NumberOrWord() if number else click.Choice(words) if words else str,
            multiple=self.key == "reference",
            help=f"{self.meaning} {self.note}".strip() + (f"  [default: {default}]" if default else ""),
        )(function)


class _NumberOrWord(click.ParamType):
    """A number; a word is left to the rules of the scene, whose sentence says what is allowed."""

    name = "number"

    def convert(self, value: Any, _param: click.Parameter | None, _ctx: click.Context | None) -> Any:
        try:
            return float(value)
        except ValueError:
            return value


def _kinds(annotation: Any) -> list[Any]:
    """The plain types and the words that an annotation allows."""
    if get_origin(annotation) is None:
        return [annotation]
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [kind for part in get_args(annotation) for kind in _kinds(part)]


def scene_options(*options: SceneOption) -> Decorator:
    """Add options that stand for keys of the scene; the command gets those that are given as ``stated``."""

    def decorate(function: Function) -> Function:
        @wraps(function)
        def call(**values: Any) -> Any:
            stated: Stated = values.pop("stated", {})
            for option in options:
                value = values.pop(option.name)
                if value not in (None, ()):
                    stated.setdefault(option.section, {})[option.key] = option.in_scene(value)
            return function(stated=stated, **values)

        return together(*(option.decorate for option in options))(call)

    return decorate


frames = together(
    click.option(
        "--scene",
        type=click.Path(exists=True, dir_okay=False),
        help="Scene file to use instead of scene.toml in FOLDER.",
    ),
    scene_options(
        SceneOption("--reference", "images", "reference", "Can be repeated."),
        SceneOption("--frames", "images", "frames", 'A glob stands in quotes: "frame_*.tif".'),
        SceneOption("--loads", "images", "loads"),
        SceneOption("--pixel-size-um", "camera", "pixel_size_m"),
        SceneOption("--polarity", "images", "polarity"),
    ),
    no_plausibility,
)
"""Options that say what the frames are, in place of keys of a scene file."""
