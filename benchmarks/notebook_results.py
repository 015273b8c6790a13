"""Make the full results of the notebooks: run each with its full ensembles, one core, and list its tables.

    python benchmarks/notebook_results.py [NAME ...] [--tables]

NAMEs are the beginnings of notebooks ("02 05"); without any, all that have results are run. Each writes its
tables and figures to notebooks/results. ``--tables`` runs nothing and only writes results/README.md and the
tables of docs/models.md anew.
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
MODELS = NOTEBOOKS.parent / "docs" / "models.md"
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

| `ours_is` | means |
| --- | --- |
| simulated | it comes from a model; no image is involved |
| rendered | measured on frames that were drawn from the contacts of a model or of boundary elements |
| circular | it is compared with what was put in: agreement tests the method, not the physics |

| `paper_is` | means |
| --- | --- |
| measured | the paper measured it |
| simulated | it is a simulation of the paper's, too |
| stated | the paper says so, or calculates it, without a number of its own data |

Nothing here was measured on a real contact: there are no such frames in this repository.
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
    runs = pd.read_csv(RUNS, dtype=str).fillna("").sort_values("notebook")
    parts = [HEAD, markdown(runs)]
    for path in with_results():
        table = pd.read_csv(RESULTS / f"{path.stem}.csv").fillna({"paper": "", "paper_is": "", "note": ""})
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


def models_page() -> str:
    """The text of docs/models.md with the tables of notebooks 03 and 04."""
    text = MODELS.read_text("utf-8")
    for name, table in (("pressures", _pressures()), ("exponents", _exponents())):
        begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
        before, after = text.split(begin)
        text = before + begin + markdown(table.map(str)) + after[after.index(end) :]
    return text


def _pressures() -> pd.DataFrame:
    """p/p0 in the innermost annulus, and that of Greenwood-Tripp at the centre."""
    table = pd.read_csv(RESULTS / "03_pressure_profiles.csv")
    names = {
        "p/p0 in the innermost annulus, coupled": "coupled",
        "p/p0 in the innermost annulus, uncoupled": "uncoupled",
        "p/p0 in the innermost annulus, gt": "Greenwood-Tripp",
        "p/p0 at the very centre, gt": "the same at the centre",
    }
    table = table[table["quantity"].isin(names)]
    values = table.pivot_table(index="note", columns="quantity", values="ours", sort=False)[list(names)]
    return values.rename(columns=names).rename_axis(index="P").reset_index().round(3)


def _exponents() -> pd.DataFrame:
    """Exponents of density and mean radius in three ranges of pressure, with those of the paper."""
    table = pd.read_csv(RESULTS / "04_density_and_radius.csv").fillna({"paper": ""})
    rows = {}
    for column, name in (("eta(p)", "density"), ("mean radius(p)", "mean radius")):
        part = table[table["quantity"] == f"exponent of {column}, coupled"].set_index("note")
        rows[name] = part["ours"].map("{:.3f}".format) + " ± " + part["std"].map("{:.3f}".format)
        rows[f"{name}, paper"] = part["paper"]
    return pd.DataFrame(rows).rename_axis(index="pressure").reset_index()


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
    MODELS.write_text(models_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
