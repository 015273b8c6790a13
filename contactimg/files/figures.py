"""Write figures to files."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from contactimg.errors import InputError
from contactimg.files.atomic import replacing
from contactimg.timings import stage


@stage("pictures")
def write_figure(ax: Axes, path: str | Path) -> None:
    """Write the figure that holds these axes as PNG, SVG or PDF (by the extension), completely or not at all.

    Parameters
    ----------
    ax : Axes
    path : str or Path
        The file; its folder must exist.

    Raises
    ------
    InputError
        If the axes belong to no figure, or the file cannot be written.
    """
    figure = ax.get_figure(root=True)
    if not isinstance(figure, Figure):
        raise InputError(f"{path}: the axes belong to no figure; draw them on one")
    with replacing(path) as part:
        figure.savefig(part, format=Path(path).suffix.removeprefix("."))
