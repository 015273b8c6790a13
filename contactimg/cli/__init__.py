"""The command line: parse, call, print. An error is one sentence on stderr and exit code 2."""

import logging
import sys
from collections.abc import Sequence

import click

from contactimg import __version__
from contactimg.cli.analyse import analyse
from contactimg.cli.calibrate import calibrate
from contactimg.cli.common import timings_option
from contactimg.cli.effects import effects
from contactimg.cli.overlay import overlay
from contactimg.cli.predict import predict
from contactimg.cli.process import process
from contactimg.cli.report import report
from contactimg.cli.simulate import simulate
from contactimg.cli.tradeoff import tradeoff
from contactimg.errors import ContactimgError

__all__ = ["main"]


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="contactimg")
def commands() -> None:
    """From contact micrographs to microcontacts, local forces and contact-model overlays.

    A folder of frames with its scene.toml is measured by one command:

    \b
        contactimg process sample_data/sa_plus -o results
        contactimg overlay results

    Exit codes: 0 done, 1 done but some frames failed or none could be measured, as their rows say, 2 nothing
    done.
    """


for command in (process, calibrate, predict, overlay, simulate, effects, tradeoff, analyse, report):
    commands.add_command(command)
    for one in command.commands.values() if isinstance(command, click.Group) else (command,):
        timings_option(one)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code: 0 done, 1 some frames failed, 2 nothing done."""
    logging.basicConfig(format="contactimg: %(message)s", force=True)
    logging.getLogger("contactimg").setLevel(logging.WARNING)
    try:
        arguments = sys.argv[1:] if argv is None else list(argv)
        result = commands.main(args=arguments, obj=arguments, prog_name="contactimg", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return 2
    except (ContactimgError, OSError) as error:
        sys.stderr.write(f"contactimg: {error}\n")
        return 2
    except (click.Abort, KeyboardInterrupt):
        sys.stderr.write("contactimg: interrupted; nothing was written\n")
        return 2
    return int(result) if isinstance(result, int) else 0
