"""Results in the store of a run that another process is writing."""

import sqlite3
from contextlib import closing
from pathlib import Path


def stored_results(out: Path) -> int:
    """Number of results in the store inside an output folder; 0 while there is none."""
    for file in out.rglob("frames.sqlite"):
        try:
            with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as database:
                return database.execute("SELECT count(*) FROM results WHERE part = 0").fetchone()[0]
        except sqlite3.OperationalError:  # it is being made
            return 0
    return 0
