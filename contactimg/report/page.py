"""Fill the template of the page; the HTML needs no network and no other file."""

import json
from collections.abc import Sequence
from math import isnan, nan
from pathlib import Path

import jinja2
import pandas as pd
from matplotlib.axes import Axes

from contactimg import __version__
from contactimg.analysis.estimates import Estimate
from contactimg.files import figure_bytes
from contactimg.plots import CAPTIONS, plot_area
from contactimg.plots.numbers import number_with_std, plain_number
from contactimg.report.contents import Contents, gather_contents
from contactimg.report.embedding import Picture, data_uri
from contactimg.report.summary import Exponent, summarise
from contactimg.tables import RUN_MODELS


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
    figure, exponent = _area(contents)
    overlays = list(contents.overlays)
    html = environment.get_template("page.html.j2").render(
        contents=contents,
        summary=summarise(contents.run, exponent, contents.out_of_date),
        frames=contents.run.frames.to_dict("records"),
        area_figure=figure,
        first_overlay=overlays.pop(len(overlays) // 2) if overlays else None,
        overlays=overlays,
        provenance=json.dumps(contents.run.provenance, indent=2),
        version=__version__,
    )
    return html.encode("utf-8", "replace").decode("utf-8")  # file names may hold bytes that are no valid text


def _area(contents: Contents) -> tuple[Picture | None, Exponent | None]:
    """The figure of A(P) and its exponent: of an analysis of this run alone, else of the run itself."""
    for part in contents.analyses:
        if part.area is not None and part.table is not None:
            return part.area, _exponent_of(part.table)
    law, frames = contents.law, contents.run.frames
    if not ((frames["load_N"] > 0) & (frames["area_m2"] > 0)).any():
        return None, None
    model = "predicted" if contents.run.command == "predict" else "measured"
    figure = Picture(CAPTIONS["area"], _as_svg(plot_area(frames, law, model=model)))
    return figure, None if law is None else Exponent(law.exponent, law.confidence, law.n_points)


def _exponent_of(results: pd.DataFrame) -> Exponent | None:
    """The exponent of the run among the results of an analysis."""
    mine = (results["quantity"] == "area_exponent") & results["model"].isin(RUN_MODELS)
    for row in results[mine].to_dict("records"):
        estimate = Estimate(row["value"], row["std"], row["low"], row["high"])
        return Exponent(estimate, row["confidence"], int(row["n_points"]))
    return None


def _as_svg(ax: Axes) -> str:
    """The figure of the axes as a data URI."""
    return data_uri("image/svg+xml", figure_bytes(ax, "svg"))


def _number(value: float | None, factor: float = 1.0) -> str:
    """A number times a factor; empty for NaN or None."""
    return "" if value is None or isnan(value) else plain_number(value * factor)


def _with_std(value: float | None, std: float | None, factor: float = 1.0) -> str:
    """A number with its standard uncertainty; empty for NaN or None."""
    if value is None or isnan(value):
        return ""
    return number_with_std(value * factor, (nan if std is None else std) * factor)
