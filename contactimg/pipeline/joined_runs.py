"""Tables of several runs as one, with the name of the run in the first column."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from contactimg.files import OutputFolder, provenance, read_run, write_table
from contactimg.tables import CONTACTS, FRAMES, Schema


def write_joined_tables(runs: Mapping[str, Path], target: Path, *, command: str) -> None:
    """Write all_contacts.csv and all_frames.csv of several runs.

    Parameters
    ----------
    runs : mapping
        Name -> output folder of `process`.
    target : Path
        The folder to write, with its provenance.
    command : str
        For the provenance.

    Raises
    ------
    InputError
        If a run cannot be read or the folder cannot be written.
    """
    tables = {name: read_run(folder) for name, folder in runs.items()}
    inputs = [folder / f"{schema.name}.csv" for folder in runs.values() for schema in (CONTACTS, FRAMES)]
    with OutputFolder(
        target, provenance(command=command, inputs=inputs), main_files=["all_frames.csv"]
    ) as out:
        for schema, parts in (
            (CONTACTS, {name: run.contacts for name, run in tables.items()}),
            (FRAMES, {name: run.frames for name, run in tables.items()}),
        ):
            whole = pd.concat([part.assign(run=name) for name, part in parts.items()], ignore_index=True)
            joined = with_run(schema)
            write_table(whole, joined, out.folder / f"{joined.name}.csv")


def with_run(schema: Schema) -> Schema:
    """The schema of the joined table: the column run, then those of the schema."""
    run = {"run": ("str", "name of the folder of frames")}
    return Schema(f"all_{schema.name}", run | dict(schema.columns), schema.description)
