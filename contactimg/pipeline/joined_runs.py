"""Tables of several runs as one, with the name of the run in the first column."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from contactimg.files import OutputFolder, TableFormat, TableWriter, main_tables, provenance, read_run
from contactimg.tables import CONTACTS, FRAMES, Schema


def write_joined_tables(
    runs: Mapping[str, Path], target: Path, *, command: str, table_format: TableFormat = "csv"
) -> None:
    """Write the tables all_contacts and all_frames of several runs.

    Parameters
    ----------
    runs : mapping
        Name -> output folder of `process`.
    target : Path
        The folder to write, with its provenance.
    command : str
        For the provenance.
    table_format : {"csv", "parquet"}

    Raises
    ------
    InputError
        If a run cannot be read or the folder cannot be written.
    """
    tables = {name: read_run(folder) for name, folder in runs.items()}
    record = provenance(command=command, inputs=main_tables(runs.values()))
    with OutputFolder(target, record, main_files=[f"all_frames.{table_format}"]) as out:
        for schema, parts in (
            (CONTACTS, {name: run.contacts for name, run in tables.items()}),
            (FRAMES, {name: run.frames for name, run in tables.items()}),
        ):
            whole = pd.concat([part.assign(run=name) for name, part in parts.items()], ignore_index=True)
            with TableWriter(with_run(schema), out.folder, table_format) as table:
                table.add(whole)


def with_run(schema: Schema) -> Schema:
    """The schema of the joined table: the column run, then those of the schema."""
    run = {"run": ("str", "name of the folder of frames")}
    return Schema(f"all_{schema.name}", run | dict(schema.columns), schema.description)
