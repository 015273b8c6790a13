"""What every command leaves in its folder: tables, and figures with their captions."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import pandas as pd
from matplotlib.axes import Axes

from contactimg.files import write_figures, write_table
from contactimg.plots import caption_of
from contactimg.tables import Schema


def write_results(
    folder: Path,
    tables: Mapping[str, tuple[Schema, pd.DataFrame]],
    figures: Mapping[str, Axes] = MappingProxyType({}),
) -> None:
    """Write tables as CSV and figures in every format.

    Parameters
    ----------
    folder : Path
        Exists.
    tables, figures : mapping
        Name without ending -> schema and table, or axes.
    """
    for name, (schema, table) in tables.items():
        write_table(table, schema, folder / f"{name}.csv")
    for name, ax in figures.items():
        write_figures(ax, folder, name, caption=caption_of(name))
