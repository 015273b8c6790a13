"""Options that several commands share, and how a command receives many options as one record."""

import logging
import shlex
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Any

import click

from contactimg.cli.printing import echo_timings
from contactimg.timings import collect, stage

DEFAULT_FOLDER = "contactimg_out"

existing_file = click.Path(exists=True, dir_okay=False)
existing_folder = click.Path(exists=True, file_okay=False)
positive_number = click.FloatRange(min=0, min_open=True)
non_negative_number = click.FloatRange(min=0)


def gather(record: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Hand the options whose names are fields of a dataclass to the command as one record, ``options``."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def call(**values: Any) -> Any:
            options = record(**{field.name: values.pop(field.name) for field in fields(record)})
            return command(options=options, **values)

        return call

    return decorate


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """Options that say what the frames are, in place of keys of a scene file; None where one is not given."""

    scene: str | None = None
    reference: tuple[str, ...] = ()
    frames: str | None = None
    loads: str | None = None
    polarity: str | None = None
    pixel_size_um: float | None = None


@dataclass(frozen=True, kw_only=True)
class SceneOptions(FrameOptions):
    """The options of `FrameOptions`, and those that say how the frames are measured."""

    calibration: str | None = None
    method: str | None = None
    shape: str | None = None
    threshold: str | None = None


def output(parent: str) -> Callable[[Any], Any]:
    """The option -o; by default the results go into a folder inside ``parent``."""
    return click.option(
        "-o",
        "--output",
        type=click.Path(file_okay=False),
        help=f"Folder for the results; created if needed.  [default: {DEFAULT_FOLDER} inside {parent}]",
    )


def output_path(output: str | None, parent: str | Path) -> Path:
    """The folder that the results go to."""
    return Path(output) if output is not None else Path(parent) / DEFAULT_FOLDER


quiet = click.option(
    "--quiet", is_flag=True, help="Print nothing but warnings and errors: no tables, no progress bars."
)


def _be_verbose(_context: click.Context, _parameter: click.Parameter, value: bool) -> None:  # noqa: FBT001
    """Let the package's log through from the level INFO."""
    if value:
        logging.getLogger("contactimg").setLevel(logging.INFO)


verbose = click.option(
    "--verbose",
    is_flag=True,
    expose_value=False,
    callback=_be_verbose,
    help="Report each step on standard error.",
)


def _time_stages(context: click.Context, _parameter: click.Parameter, value: bool) -> None:  # noqa: FBT001
    """Time the stages of the command and print them when it ends."""
    if value:
        timings = context.with_resource(collect())
        context.call_on_close(lambda: echo_timings(timings))


timings = click.option(
    "--timings",
    is_flag=True,
    expose_value=False,
    callback=_time_stages,
    help="Print a table at the end: how long each stage took, in seconds.",
)
"""Of every command: `contactimg.cli` adds it."""


def _doubt_as_warning(context: click.Context, _parameter: click.Parameter, value: bool) -> None:  # noqa: FBT001
    """Print doubts about the scene as warnings."""
    if value:
        with stage("loading"):
            from contactimg.plausibility import doubts_as_warnings
        context.with_resource(doubts_as_warnings())


no_plausibility = click.option(
    "--no-plausibility",
    is_flag=True,
    expose_value=False,
    callback=_doubt_as_warning,
    help="Warn about values that physics makes doubtful (a length in mm, say) instead of refusing them.",
)

workers = click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=None,
    help="Number of processes that work in parallel.  [default: one, and one per CPU core as soon as that "
    "saves time]",
)


def _use_cluster(context: click.Context, _parameter: click.Parameter, value: str | None) -> None:
    """Hand the work of the command to a cluster until it ends."""
    if value is not None:
        with stage("loading"):
            from contactimg.engine.cluster import on_cluster
        context.with_resource(on_cluster(value))


cluster = click.option(
    "--cluster",
    metavar="ADDRESS",
    expose_value=False,
    callback=_use_cluster,
    help="Work on the cluster of a dask.distributed scheduler, instead of --workers: its address, for "
    "example tcp://host:8786, or its scheduler file.",
)
one_worker = click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of processes that work in parallel.",
)
scene = click.option("--scene", type=existing_file, help="Scene file to use instead of scene.toml in FOLDER.")


def frames(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `FrameOptions`."""
    options = (
        scene,
        click.option(
            "--reference",
            type=click.Path(),
            multiple=True,
            help="Frame without contact; it is subtracted. Given several times, the frames are averaged.",
        ),
        click.option(
            "--frames",
            help='Pattern for the names of the frames in FOLDER, for example "frame_*.tif" (with quotes).',
        ),
        click.option(
            "--loads",
            type=click.Path(),
            help="CSV file with the columns frame and load_N (or load_mN).",
        ),
        click.option(
            "--pixel-size-um",
            type=float,
            help="Length on the sample that one pixel covers, in micrometres.",
        ),
        click.option(
            "--polarity",
            type=click.Choice(["bright", "dark", "auto"]),
            help="Whether contacts are brighter or darker than the reference.  [default: the scene's, else "
            "bright]",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


load = click.option(
    "--load-N",
    "load",
    type=float,
    help="Normal load in newtons.  [default: the largest that the scene states]",
)
annulus = click.option(
    "--annulus-mm",
    type=float,
    default=0.25,
    show_default=True,
    help="Width of the rings around the apex over which profiles are averaged, in mm.",
)


def min_radius(effect: str) -> Callable[[Any], Any]:
    """The option for the smallest contact that counts."""
    return click.option(
        "--min-radius-px",
        type=non_negative_number,
        default=1.0,
        show_default=True,
        help=f"Smallest contact radius that counts, in pixels: {effect}.",
    )


def command_line(command: str) -> str:
    """The command, for the provenance, as a shell reads it."""
    typed = click.get_current_context().find_root().obj or []
    return shlex.join(["contactimg", *typed]) if typed else f"contactimg {command}"
