"""The command line: each command parses its options, calls the package and prints.

A module is imported when a command of it is called. `options` holds what the commands share, `scenes` makes
the scene of a command, `printing` prints tables and progress bars. An error is one sentence on standard error
and exit code 2.
"""

import gc
import logging
import sys
from collections.abc import Sequence
from importlib import import_module

import click

from contactimg import __version__
from contactimg.engine.processes import ending_cleanly
from contactimg.errors import ContactimgError

__all__ = ["main"]

COMMANDS = {
    "init": ("folders", "Write a first scene.toml for a folder of frames."),
    "asperities": ("surfaces", "Find the asperities on a profilometer's height map."),
    "process": ("folders", "Measure the contacts on every frame of a folder."),
    "check": ("folders", "Test the measurement on contacts of known radius drawn into your own frames."),
    "calibrate": ("calibrate", "Calibrate the modulus, the threshold or the plateau on a folder of frames."),
    "predict": ("models", "Predict the contacts at given loads with a contact model."),
    "design": ("surfaces", "Design a surface whose contact area follows a wanted law of the load."),
    "overlay": ("runs", "Compare measured with predicted contacts, frame by frame."),
    "simulate": ("models", "Render synthetic frames of a scene, with the true contacts."),
    "effects": ("models", "Decide which physical effects matter for a scene."),
    "tradeoff": ("models", "Measure how much computing time accuracy costs."),
    "analyse": ("runs", "Area laws, profiles, contact laws and friction of one or several runs."),
    "report": ("runs", "Write one self-contained HTML page about a run."),
    "review": ("runs", "Check and correct the contacts of a run on a local web page."),
    "export": ("runs", "Write a run for ImageJ, napari and Excel."),
    "selftest": ("models", "Solve hard contact problems whose answers are known, and compare."),
    "import-rois": ("runs", "Bring regions corrected in ImageJ back as edits.csv."),
}
"""Command -> its module, and what it does."""


class Commands(click.Group):
    """The commands, each imported when it is called."""

    def list_commands(self, _context: click.Context) -> list[str]:
        """Names of all commands, in the order of the alphabet."""
        return sorted(COMMANDS)

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        """The command of that name."""
        if name not in COMMANDS:
            return None
        module = import_module(f"contactimg.cli.{COMMANDS[name][0]}")
        found: click.Command = getattr(module, name.replace("-", "_"))
        return found

    def format_commands(self, _context: click.Context, formatter: click.HelpFormatter) -> None:
        """List what each command does."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in sorted(COMMANDS)])


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True},
)
@click.version_option(__version__, prog_name="contactimg")
def commands() -> None:
    """Measure the microcontacts on micrographs, compute local forces, compare with contact models.

    A folder of frames that holds a scene.toml is measured with one command; a second one compares the result
    with the predictions of the contact models:

    \b
        contactimg process sample_data/sa_plus -o results
        contactimg overlay results

    `contactimg COMMAND --help` shows the options of a command with examples. Every command writes into a
    folder of its own, with provenance.json (version, command, scene and input files); a command that fails
    leaves this folder as it was.

    Exit codes: 0 done; 1 done with a reservation, which the command names (a frame failed, no frame has a
    result, a likely slip of the input, a test not passed); 2 nothing done.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; return its exit code: 0 done, 1 done with a reservation, 2 nothing done."""
    usual = gc.get_threshold()
    # new objects after which memory is searched for cycles; measured: Python's 700 cost `process` 0.35 s,
    # most of it while libraries are imported, whose objects all stay; its peak of memory is the same
    gc.set_threshold(100_000)
    logging.basicConfig(format="contactimg: %(message)s", force=True)
    logging.getLogger("contactimg").setLevel(logging.WARNING)
    try:
        arguments = sys.argv[1:] if argv is None else list(argv)
        with ending_cleanly():  # also if it is a signal that ends it
            result = commands.main(arguments, "contactimg", obj=arguments, standalone_mode=False)
        return int(result or 0)
    except click.ClickException as error:
        error.show()
    except (ContactimgError, OSError) as error:
        sys.stderr.write(f"contactimg: {error}\n")
    except (click.Abort, KeyboardInterrupt):
        said = "interrupted; earlier results are as they were, and `process` takes up what it measured"
        sys.stderr.write(f"contactimg: {said}\n")
    finally:
        gc.set_threshold(*usual)
    return 2
