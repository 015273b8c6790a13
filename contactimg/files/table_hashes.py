"""Hashes of tables: whether they were changed, and whether a derived result is out of date."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

RUN_TABLES = ("contacts.csv", "frames.csv", "contacts.parquet", "frames.parquet")
"""The tables that other results are derived from, in either format."""


def table_hashes(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the tables among files; pictures and records have none.

    Parameters
    ----------
    folder : Path
    names : iterable of str
        Relative to the folder.
    """
    return {name: _sha256(folder / name) for name in names if name.endswith((".csv", ".parquet"))}


def changed_tables(record: Mapping[str, Any], folder: Path) -> list[str]:
    """Names of the tables of a run that were changed since it wrote them; none if its hashes are not known.

    Parameters
    ----------
    record : mapping
        Of the run, from its provenance.json.
    folder : Path
        The output folder of the run.
    """
    hashes = record.get("sha256")
    if not isinstance(hashes, dict):
        return []
    return [name for name in RUN_TABLES if name in hashes and hashes[name] != _sha256(folder / name)]


def is_out_of_date(record: Mapping[str, Any], run: Path) -> bool:
    """Whether a result was made from other tables than those that a run holds now.

    Parameters
    ----------
    record : mapping
        Of the derived result; its inputs have the hashes of the tables it was made from.
    run : Path
        The output folder of the run.
    """
    used = [entry for entry in record.get("inputs", []) if isinstance(entry, dict)]
    return any(
        hashes and _sha256(run / name) not in hashes
        for name in RUN_TABLES
        for hashes in [{entry.get("sha256") for entry in used if Path(str(entry.get("path"))).name == name}]
    )


def _sha256(path: Path) -> str:
    """SHA-256 of a file; of a missing one, a word that equals no hash."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "missing"
