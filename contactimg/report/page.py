"""The page: contents and template to HTML that needs no network and no other file."""

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
    """One self-contained HTML page of a run.

    Parameters
    ----------
    folder : str or Path
        Output of `process`.
    others : sequence of str or Path
        Outputs of `overlay`, `analyse` and `calibrate` to show too; those inside the run's folder are found.
    max_pictures : int
        Most pictures of frames in each set.

    Returns
    -------
    str
        HTML. Every text from the run is escaped; images are inside; the page forbids itself the network.

    Raises
    ------
    InputError
        If the folder holds no complete run, or another one no output of such a command.
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
    return html.encode("utf-8", "replace").decode("utf-8")  # names of files may hold bytes that are no text


def _area_figure(contents: Contents) -> Picture | None:
    """A(P), if a frame has load and area."""
    frames = contents.run.frames
    if not ((frames["load_N"] > 0) & (frames["area_m2"] > 0)).any():
        return None
    return Picture("real contact area against load", _as_svg(plot_area(frames)))


def _as_svg(ax: Axes) -> str:
    """The figure of the axes as a data URI."""
    buffer, figure = io.BytesIO(), ax.get_figure(root=True)
    if figure is None:
        raise InputError("these axes belong to no figure")
    figure.savefig(buffer, format="svg")
    return data_uri("image/svg+xml", buffer.getvalue())


def _number(value: float | None, factor: float = 1.0, form: str = "{:.4g}") -> str:
    """A number in another unit; nothing where there is none."""
    if value is None or isnan(value):
        return ""
    return form.format(value * factor) if isfinite(value) else str(value)


def _with_std(value: float | None, std: float | None, factor: float = 1.0) -> str:
    """A number with its standard uncertainty."""
    if not _number(value) or not _number(std):
        return _number(value, factor)
    return f"{_number(value, factor)} ± {_number(std, factor, '{:.2g}')}"
