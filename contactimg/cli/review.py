"""``contactimg review``: a local page to check and correct the contacts of a run."""

import click

from contactimg.cli import shared_options as shared
from contactimg.timings import stage


@click.command(short_help="Check and correct the contacts of a run on a local web page.")
@click.argument("run", type=shared.existing_folder)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Port of this machine to serve the page on.  [default: any that is free]",
)
@click.option("--no-browser", is_flag=True, help="Print the address of the page and open no browser.")
@click.option(
    "--origin",
    default="",
    metavar="ADDRESS",
    help="Scheme and host of a proxy through which the page is opened: https://hub.example.org.",
)
@shared.workers
@shared.verbose
def review(*, run: str, port: int, no_browser: bool, origin: str, workers: int | None) -> int:
    """Open a page that shows the frames of RUN, an output folder of `process`, with contacts to correct.

    The page is served to this machine only, under an address with a random token; Ctrl-C ends it. On another
    machine, forward the port (ssh -L 8765:127.0.0.1:8765) and open the address there, or name the proxy
    (--origin). Corrections go to
    edits.csv, each before the page says so; a threshold that is chosen goes to scene.toml. Nothing else is
    written: run `contactimg process` again for tables and pictures with the corrections.

    \b
    Examples:
      contactimg review results
      contactimg review results --port 8765 --no-browser
    """
    with stage("loading"):
        import webbrowser
        from contextlib import closing
        from pathlib import Path
        from threading import Thread

        from contactimg.errors import InputError
        from contactimg.review import ReviewServer, Session

    with closing(Session(Path(run), workers=workers)) as session:
        try:
            server = ReviewServer(session, port, origin=origin)
        except OSError as error:
            raise InputError(f"port {port} cannot be used ({error.strerror}); choose another one") from None
        with server:
            click.echo(f"review of {run}: {server.address}")
            click.echo(f"edits go to {session.edits.path}; Ctrl-C ends the review")
            if not no_browser:
                # a browser in the terminal returns only when it is left
                Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                click.echo("review ended; run `contactimg process` again for tables with the edits")
    return 0
