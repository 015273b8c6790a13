"""The command line: one module per command; each parses its options, calls the package and prints.

`options` holds what the commands share, `scenes` turns a folder and options into a scene, `printing` prints
tables and progress bars. An error is one sentence on standard error and exit code 2.
"""

import logging
import sys
from collections.abc import Sequence

import click

from contactimg import __version__
from contactimg.cli import shared_options as shared
from contactimg.cli.analyse import analyse
from contactimg.cli.asperities import asperities
from contactimg.cli.calibrate import calibrate
from contactimg.cli.effects import effects
from contactimg.cli.export import export
from contactimg.cli.import_rois import import_rois
from contactimg.cli.init import init
from contactimg.cli.overlay import overlay
from contactimg.cli.predict import predict
from contactimg.cli.process import process
from contactimg.cli.report import report
from contactimg.cli.review import review
from contactimg.cli.simulate import simulate
from contactimg.cli.tradeoff import tradeoff
from contactimg.engine.processes import ending_cleanly
from contactimg.errors import ContactimgError

__all__ = ["main"]

INTERRUPTED = "interrupted; earlier results are as they were, and `process` takes up what it measured"
"""What a command says that was asked to end."""


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
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

    Exit codes: 0 done, 1 done but some frames failed (their rows say why), 2 nothing done.
    """


for command in (
    init,
    asperities,
    process,
    calibrate,
    predict,
    overlay,
    simulate,
    effects,
    tradeoff,
    analyse,
    report,
    review,
    export,
    import_rois,
):
    commands.add_command(command)
    for leaf in command.commands.values() if isinstance(command, click.Group) else (command,):
        shared.timings(leaf)
        if command not in (analyse, asperities, report, review):
            shared.no_plausibility(leaf)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; return its exit code: 0 done, 1 some frames failed, 2 nothing done."""
    logging.basicConfig(format="contactimg: %(message)s", force=True)
    logging.getLogger("contactimg").setLevel(logging.WARNING)
    try:
        arguments = sys.argv[1:] if argv is None else list(argv)
        with ending_cleanly():
            result = commands.main(
                args=arguments, obj=arguments, prog_name="contactimg", standalone_mode=False
            )
    except click.ClickException as error:
        error.show()
        return 2
    except (ContactimgError, OSError) as error:
        sys.stderr.write(f"contactimg: {error}\n")
        return 2
    except (click.Abort, KeyboardInterrupt):
        sys.stderr.write(f"contactimg: {INTERRUPTED}\n")
        return 2
    return int(result) if isinstance(result, int) else 0
