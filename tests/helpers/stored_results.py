"""Results in the store of a run that another process is writing."""

from pathlib import Path


def stored_results(out: Path) -> int:
    """Number of part files inside an output folder; 0 while there is none."""
    return sum(not path.name.startswith(".") for path in out.rglob(".contactimg.frames/*"))
