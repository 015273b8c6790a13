"""Run the notebooks: with their full ensembles for notebooks/results, with small ones for what they show.

    python benchmarks/run.py notebook_results.full --names 02 05
    python benchmarks/run.py notebook_results.tables
    python benchmarks/run.py notebook_results.small

The names are the beginnings of notebooks; without any, all are run.
"""

import base64
import io
import os
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import nbformat
import pandas as pd
from nbclient import NotebookClient
from PIL import Image
from shared import ROOT, markdown, with_table

NOTEBOOKS = ROOT / "notebooks"
RESULTS = NOTEBOOKS / "results"
RUNS = RESULTS / "runs.csv"
MODELS = ROOT / "docs" / "models.md"
LIBRARIES = ("contactimg", "numpy", "scipy", "pandas", "numba")
WIDTH_PX, COLOURS = 900, 48  # of the figures that a notebook stores
HEAD = """# Full results of the notebooks

Written by `python benchmarks/run.py notebook_results.full` from the tables beside it; do not edit. The seed
is 2015 in every notebook. `ours` is what the notebook finds, `std` its standard uncertainty or scatter as the
notebook says, `paper` what Yashima et al., *Soft Matter* **11** (2015) 871,
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

Nothing here was measured on a real contact between lens and rubber: no frame of one is among the data (the
camera images of `sample_data/pins` have no loads or radii).
"""


def with_results() -> list[Path]:
    """The notebooks that store full results: all but the first, which has no ensemble."""
    return [
        path for path in sorted(NOTEBOOKS.glob("*.ipynb")) if "CONTACTIMG_FULL" in path.read_text("utf-8")
    ]


def chosen(paths: list[Path], names: tuple[str, ...]) -> Iterator[Path]:
    """The paths whose names begin with one of the names; all without any."""
    return (path for path in paths if not names or path.name.startswith(tuple(names)))


def executed(path: Path) -> nbformat.NotebookNode:
    """A notebook that was run in its folder."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=None, resources={"metadata": {"path": str(NOTEBOOKS)}}).execute()
    return notebook


def run(path: Path) -> dict[str, object]:
    """Run a notebook with its full ensembles; when it was run, how long it took and with what."""
    start, processor = time.perf_counter(), os.times()
    executed(path)
    after = os.times()
    used = after.children_user + after.children_system - processor.children_user - processor.children_system
    seconds = {"seconds": round(time.perf_counter() - start), "processor_seconds": round(used)}
    return {"notebook": path.stem} | seconds | {name: version(name) for name in LIBRARIES}


def page() -> str:
    """The text of results/README.md."""
    runs = pd.read_csv(RUNS, dtype=str).fillna("").sort_values("notebook")
    parts = [HEAD, markdown_of(runs) + "\n"]
    for path in with_results():
        table = pd.read_csv(RESULTS / f"{path.stem}.csv").fillna({"paper": "", "paper_is": "", "note": ""})
        numbers = {
            column: table[column].map(lambda x: "" if pd.isna(x) else f"{x:.4g}")
            for column in ("ours", "std")
        }
        parts += [f"## [{path.stem}](../{path.name})\n", markdown_of(table.assign(**numbers)) + "\n"]
    return "\n".join(parts)


def markdown_of(table: pd.DataFrame) -> str:
    """A table of text in Markdown."""
    return markdown(list(table.columns), table.to_numpy().tolist())


def models_page() -> str:
    """The text of docs/models.md with the tables of notebooks 03 and 04."""
    text = MODELS.read_text("utf-8")
    for name, table in (("pressures", _pressures()), ("exponents", _exponents())):
        text = with_table(text, name, markdown_of(table.map(str)))
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


def full(names: tuple[str, ...] = ()) -> None:
    """Write the full results of the notebooks that have some, and the pages of their tables."""
    os.environ["CONTACTIMG_FULL"] = "1"  # which the kernels inherit
    for path in chosen(with_results(), names):
        row = run(path)
        print(f"{row['notebook']}: {row['seconds']} s, {row['processor_seconds']} s of processor")
        before = pd.read_csv(RUNS, dtype=str) if RUNS.exists() else pd.DataFrame(columns=list(row))
        others = before[before["notebook"] != row["notebook"]]
        pd.concat([others, pd.DataFrame([row])]).sort_values("notebook").to_csv(RUNS, index=False)
    tables()


def tables() -> None:
    """Write results/README.md and the tables of docs/models.md anew."""
    (RESULTS / "README.md").write_text(page(), encoding="utf-8")
    MODELS.write_text(models_page(), encoding="utf-8")


def small(names: tuple[str, ...] = ()) -> None:
    """Store the notebooks as they run with their small ensembles, below 400 kB each."""
    for path in chosen(sorted(NOTEBOOKS.glob("*.ipynb")), names):
        notebook = executed(path)
        reduce_outputs(notebook)
        nbformat.write(notebook, path)
        print(f"{path.name}: {path.stat().st_size // 1024} kB")


def reduce_outputs(notebook: nbformat.NotebookNode) -> None:
    """Make the figures small, and drop what tells when and where a notebook ran."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = smaller(data["image/png"])
        cell["outputs"] = [o for o in cell.get("outputs", []) if o.get("name") != "stderr"]
        if cell.cell_type != "code":
            cell.pop("outputs")


def smaller(figure: str) -> str:
    """A PNG in base64 with few colours, at most `WIDTH_PX` wide."""
    image = Image.open(io.BytesIO(base64.b64decode(figure))).convert("RGB")
    if image.width > WIDTH_PX:
        size = (WIDTH_PX, round(image.height * WIDTH_PX / image.width))
        image = image.resize(size, Image.Resampling.LANCZOS)
    out = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode()
