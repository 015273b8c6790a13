"""Make the full results of the notebooks: run each with its full ensembles, one core, and list its tables.

    python benchmarks/notebook_results.py [NAME ...] [--tables]

NAMEs are the beginnings of notebooks ("02 05"); without any, all that have results are run. Each writes its
tables and figures to notebooks/results. ``--tables`` runs nothing and only writes results/README.md anew.
"""

import argparse
import os
import time
from importlib.metadata import version
from pathlib import Path

import nbformat
import pandas as pd
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
RESULTS = NOTEBOOKS / "results"
RUNS = RESULTS / "runs.csv"
LIBRARIES = ("contactimg", "numpy", "scipy", "pandas", "numba")
KERNEL = {
    "CONTACTIMG_FULL": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
HEAD = """# Full results of the notebooks

Written by `python benchmarks/notebook_results.py` from the tables beside it; do not edit. The seed is 2015 in
every notebook. `ours` is what the notebook finds, `std` its standard uncertainty or scatter as the notebook
says, `paper` what Yashima et al., *Soft Matter* **11** (2015) 871,
[doi:10.1039/C4SM02346C](https://doi.org/10.1039/C4SM02346C), print.
"""


def with_results() -> list[Path]:
    """The notebooks that store full results: all but the first, which has no ensemble."""
    return [
        path for path in sorted(NOTEBOOKS.glob("*.ipynb")) if "CONTACTIMG_FULL" in path.read_text("utf-8")
    ]


def run(path: Path) -> dict[str, object]:
    """Run a notebook with its full ensembles; when it was run, how long it took and with what."""
    start, processor = time.perf_counter(), os.times()
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=None, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute()
    after = os.times()
    used = after.children_user + after.children_system - processor.children_user - processor.children_system
    seconds = {"seconds": round(time.perf_counter() - start), "processor_seconds": round(used)}
    return {"notebook": path.stem} | seconds | {name: version(name) for name in LIBRARIES}


def page() -> str:
    """The text of results/README.md."""
    runs = pd.read_csv(RUNS, dtype=str).sort_values("notebook")
    parts = [HEAD, markdown(runs)]
    for path in with_results():
        table = pd.read_csv(RESULTS / f"{path.stem}.csv").fillna({"paper": "", "note": ""})
        numbers = {
            column: table[column].map(lambda x: "" if pd.isna(x) else f"{x:.4g}")
            for column in ("ours", "std")
        }
        parts += [f"## [{path.stem}](../{path.name})\n", markdown(table.assign(**numbers))]
    return "\n".join(parts)


def markdown(table: pd.DataFrame) -> str:
    """A table of text in Markdown."""
    lines = [list(table.columns), ["---"] * len(table.columns), *table.to_numpy().tolist()]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="beginnings of the notebooks to run")
    parser.add_argument("--tables", action="store_true", help="run nothing")
    options = parser.parse_args()
    os.environ.update(KERNEL)  # which the kernels inherit
    chosen = [
        path for path in with_results() if not options.names or path.name.startswith(tuple(options.names))
    ]
    for path in [] if options.tables else chosen:
        row = run(path)
        print(f"{row['notebook']}: {row['seconds']} s, {row['processor_seconds']} s of processor")
        before = pd.read_csv(RUNS, dtype=str) if RUNS.exists() else pd.DataFrame(columns=list(row))
        others = before[before["notebook"] != row["notebook"]]
        pd.concat([others, pd.DataFrame([row])]).sort_values("notebook").to_csv(RUNS, index=False)
    (RESULTS / "README.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
