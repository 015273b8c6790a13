"""Fill the template of the page; the HTML needs no network and no other file."""

import io
import json
from collections.abc import Sequence
from math import isfinite, isnan
from pathlib import Path

import jinja2
from matplotlib.axes import Axes

from contactimg import __version__
from contactimg.errors import InputError
from contactimg.plots import plot_area
from contactimg.report.contents import Contents, gather_contents
from contactimg.report.embedding import Picture, data_uri
from contactimg.tables import Flag


def build_report(folder: str | Path, *, others: Sequence[str | Path] = (), max_pictures: int = 40) -> str:
    """Write one self-contained HTML page about a run.

    Parameters
    ----------
    folder : str or Path
        Output of `process`.
    others : sequence of str or Path
        Outputs of `overlay`, `analyse` and `calibrate` to show as well; those inside the folder of the run
        are included anyway.
    max_pictures : int
        Largest number of pictures of frames in each set.

    Returns
    -------
    str
        HTML with embedded images. Every text from the run is escaped; a content security policy blocks the
        network.

    Raises
    ------
    InputError
        If the folder holds no complete run, or one of the others no output of these commands.
    """
    contents = gather_contents(
        Path(folder), others=[Path(other) for other in others], max_pictures=max_pictures
    )
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("contactimg", "report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": _number, "with_std": _with_std}
    html = environment.get_template("page.html.j2").render(
        contents=contents,
        frames=contents.run.frames.to_dict("records"),
        flag_names=[str(flag.name) for flag in Flag],
        area_figure=_area_figure(contents),
        provenance=json.dumps(contents.run.provenance, indent=2),
        version=__version__,
    )
    return html.encode("utf-8", "replace").decode("utf-8")  # file names may hold bytes that are no valid text


def _area_figure(contents: Contents) -> Picture | None:
    """Area against load, if a frame has both."""
    frames = contents.run.frames
    if not ((frames["load_N"] > 0) & (frames["area_m2"] > 0)).any():
        return None
    return Picture("Real contact area of each frame against load.", _as_svg(plot_area(frames)))


def _as_svg(ax: Axes) -> str:
    """The figure of the axes as a data URI."""
    buffer, figure = io.BytesIO(), ax.get_figure(root=True)
    if figure is None:
        raise InputError("the axes belong to no figure; draw them on one")
    figure.savefig(buffer, format="svg")
    return data_uri("image/svg+xml", buffer.getvalue())


def _number(value: float | None, factor: float = 1.0, form: str = "{:.4g}") -> str:
    """A number times a factor; empty for NaN or None."""
    if value is None or isnan(value):
        return ""
    return form.format(value * factor) if isfinite(value) else str(value)


def _with_std(value: float | None, std: float | None, factor: float = 1.0) -> str:
    """A number with its standard uncertainty."""
    if not _number(value) or not _number(std):
        return _number(value, factor)
    return f"{_number(value, factor)} ± {_number(std, factor, '{:.2g}')}"
